"""A cut through bodies: what lies beyond a plane is taken away, and what the plane cuts is filled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...bodies.frames import Plane
from ...bodies.obstacles import Obstacle, nearest_distance
from ...errors import extra
from ...files.units import TO_MM
from ...typing import Array
from ..arm_surfaces import Part
from ..surfaces import Surface, two_of_four
from .scene import obstacle_parts

CELLS = 200
"""Cells of the filled section along the longer side of what is cut."""

ACROSS = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
"""Normals of planes across the axes of the plate."""

SECTION = "section"

SECTION_COLOUR = (205, 150, 120)


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
    told = ", ".join(f"{x:.3g}" for x in plane.normal + 0.0)
    across = next((name for name, axis in ACROSS.items() if (plane.normal == axis).all()), told)
    return f"cut across {across} at {plane.point @ plane.normal * TO_MM:.4g} mm: {twice / 2 * 1e4:.2f} cm2 of bodies"


def cut_surface(surface: Surface, plane: Plane) -> Surface:
    """The part of a surface up to a plane: triangles across it are cut there."""
    trimesh = extra("trimesh.intersections", "view", "bodies that are cut")
    vertices, faces, _ = trimesh.slice_faces_plane(
        surface.vertices, surface.faces.astype(np.int64), -plane.normal, plane.point
    )
    return Surface(vertices, faces.astype(np.uint32))


def section(obstacles: Sequence[Obstacle], plane: Plane, low: Array, high: Array) -> Surface:
    """What a plane cuts of bodies within a box: squares whose middles lie in one of them, facing beyond the plane."""
    corners = np.array([[(low, high)[k][i] for i, k in enumerate(each)] for each in np.ndindex(2, 2, 2)])
    side, frame = plane.height(corners), plane.frame
    if not side.min() <= 0 <= side.max():
        return _squares(np.zeros((0, 4, 3)))
    along = frame.seen(corners)[:, :2]
    size = max(float(np.ptp(along, axis=0).max()) / CELLS, 1e-6)
    u, v = (np.arange(a + size / 2, b, size) for a, b in zip(along.min(0), along.max(0), strict=True))
    middle = frame.placed(np.stack(np.broadcast_arrays(u[:, None], v[None], 0.0), axis=-1))
    within = ((middle >= low) & (middle <= high)).all(-1)
    inside = middle[within & (nearest_distance(obstacles, middle) < 0)]
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size / 2 @ frame.axes[:, :2].T
    return _squares(inside[:, None] + square)


def _squares(corners: Array) -> Surface:
    """Squares (k, 4, 3) that share no corners."""
    faces = np.arange(4 * len(corners), dtype=np.uint32).reshape(-1, 4)
    return Surface(corners.reshape(-1, 3), two_of_four(faces))
