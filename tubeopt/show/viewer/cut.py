"""A cut through bodies: what lies beyond a plane is taken away, and what the plane cuts is filled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...bodies.obstacles import Obstacle, nearest_distance
from ...files.units import TO_MM
from ...typing import Array
from ..surfaces import Faces, Surface
from .scene import obstacle_parts
from .surfaces import Part

CELLS = 200
"""Cells of the filled section along the longer side of what is cut."""

AXES = ("x", "y", "z")

SECTION = "section"

SECTION_COLOUR = (205, 150, 120)


@dataclass(frozen=True)
class Plane:
    """All points whose coordinate along an axis of the plate (0, 1, 2) is `at`, m."""

    axis: int
    at: float


def cut_parts(obstacles: Sequence[Obstacle], reach: float, plane: Plane | None) -> list[Part]:
    """Bodies to be shown, up to a plane if one is given, with the section that it makes of them."""
    parts = obstacle_parts(obstacles, reach)
    if plane is None or not parts:
        return parts
    corners = np.concatenate([part.surface.vertices for part in parts])
    cut = [replace(part, surface=cut_surface(part.surface, plane)) for part in parts]
    filled = section(obstacles, plane, corners.min(0), corners.max(0))
    return [part for part in (*cut, Part(SECTION, filled, SECTION_COLOUR)) if len(part.surface.faces)]


def cut_words(parts: Sequence[Part], plane: Plane | None) -> str:
    """How much a plane cuts of what is shown."""
    if plane is None:
        return ""
    corners = [part.surface.vertices[part.surface.faces] for part in parts if part.name == SECTION]
    twice = sum(np.linalg.norm(np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]), axis=1).sum() for c in corners)
    return f"cut across {AXES[plane.axis]} at {plane.at * TO_MM:g} mm: {twice / 2 * 1e4:.2f} cm2 of bodies"


def cut_surface(surface: Surface, plane: Plane) -> Surface:
    """The part of a surface up to a plane: triangles across it are cut there."""
    side = surface.vertices[:, plane.axis] - plane.at
    beyond = side[surface.faces] > 0
    count = beyond.sum(1)
    kept = [surface.vertices[surface.faces[count == 0]]]
    for many in (1, 2):  # corners beyond: the one that is alone comes first, the order around is kept
        some = surface.faces[count == many]
        alone = beyond[count == many] if many == 1 else ~beyond[count == many]
        order = (alone.argmax(1)[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(some, order, axis=1).T
        p, q = (_crossing(surface.vertices, side, a, other) for other in (b, c))
        if many == 1:
            kept += [np.stack([p, surface.vertices[b], surface.vertices[c]], axis=1)]
            kept += [np.stack([p, surface.vertices[c], q], axis=1)]
        else:
            kept += [np.stack([surface.vertices[a], p, q], axis=1)]
    return _of_corners(np.concatenate(kept))


def _crossing(vertices: Array, side: Array, a: Faces, b: Faces) -> Array:
    """(k, 3) where sides from corners a to corners b meet the plane."""
    share = side[a] / (side[a] - side[b])
    return np.asarray(vertices[a] + share[:, None] * (vertices[b] - vertices[a]))


def _of_corners(corners: Array) -> Surface:
    """Triangles (f, 3, 3) as a surface without shared vertices."""
    return Surface(corners.reshape(-1, 3), np.arange(3 * len(corners), dtype=np.uint32).reshape(-1, 3))


def section(obstacles: Sequence[Obstacle], plane: Plane, low: Array, high: Array) -> Surface:
    """What a plane cuts of bodies within a box: squares whose middles lie in one of them, facing beyond the plane."""
    if not low[plane.axis] <= plane.at <= high[plane.axis]:
        return _of_corners(np.zeros((0, 3, 3)))
    one, other = (plane.axis + 1) % 3, (plane.axis + 2) % 3  # right-handed with the axis
    size = max(float((high - low)[[one, other]].max()) / CELLS, 1e-6)
    u, v = (np.arange(low[k] + size / 2, high[k], size) for k in (one, other))
    middle = np.full((len(u), len(v), 3), plane.at)
    middle[..., one], middle[..., other] = u[:, None], v[None]
    inside = middle[nearest_distance(obstacles, middle) < 0]
    square = np.zeros((4, 3))
    square[:, [one, other]] = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size / 2
    corners = inside[:, None] + square
    return _of_corners(np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]]))
