"""Surfaces as triangles with shared vertices, which is what graphics hardware wants, and bodies as such."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..bodies.anatomy import Turned
from ..bodies.corridors import Corridor, MeshObstacle
from ..bodies.distance_field import DistanceField, surface_net
from ..bodies.obstacles import Box, Capsule, HalfSpace, Obstacle, Sphere
from ..errors import InputError
from ..typing import Array

Faces = NDArray[np.uint32]

SIDES = 32
"""Facets around a round body."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A surface as triangles with shared vertices."""

    vertices: Array
    """(v, 3) m."""
    faces: Faces
    """(f, 3): corners of every triangle, counter-clockwise from outside."""


@lru_cache(maxsize=64)
def grid_faces(rows: int, columns: int) -> Faces:
    """Triangles between neighbours of a grid of vertices, whose last column is next to the first: two and two of four
    corners."""
    k, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    ahead = (j + 1) % columns
    return two_of_four(
        np.stack([k * columns + j, k * columns + ahead, (k + 1) * columns + ahead, (k + 1) * columns + j], axis=-1)
    )


def two_of_four(corners: NDArray[np.integer]) -> Faces:
    """(2k, 3) triangles, two of each facet of four corners (..., 4)."""
    return corners[..., [0, 1, 2, 0, 2, 3]].reshape(-1, 3).astype(np.uint32)


def join(surfaces: list[Surface]) -> Surface:
    """All of them as one."""
    start = np.cumsum([0] + [len(each.vertices) for each in surfaces])
    faces = [each.faces + np.uint32(first) for each, first in zip(surfaces, start, strict=False)]
    return Surface(np.concatenate([each.vertices for each in surfaces]), np.concatenate(faces))


def obstacle_surface(obstacle: Obstacle, reach: float, *, sides: int = SIDES) -> Surface:
    """A body as triangles; of one without end, what lies within `reach` (m) of the plate; of a vessel, its wall.

    Raises:
        InputError: a body of unknown kind.
    """
    if isinstance(obstacle, Sphere):
        return swept(np.array([obstacle.centre, obstacle.centre]), np.full(2, obstacle.radius), sides=sides)
    if isinstance(obstacle, Capsule):
        return swept(np.array([obstacle.start, obstacle.end]), np.full(2, obstacle.radius), sides=sides)
    if isinstance(obstacle, Box):
        return _box(np.array(obstacle.low), np.array(obstacle.high))
    if isinstance(obstacle, HalfSpace):
        return _plane(np.array(obstacle.point), np.array(obstacle.normal), reach)
    if isinstance(obstacle, Corridor):
        line, radii = np.array(obstacle.centreline), obstacle.radii
        return join([swept(line[k : k + 2], radii[k : k + 2], sides=sides) for k in range(len(line) - 1)])
    if isinstance(obstacle, MeshObstacle):
        return Surface(np.array(obstacle.vertices), np.array(obstacle.faces, dtype=np.uint32))
    if isinstance(obstacle, DistanceField):
        vertices, faces = surface_net(obstacle)
        return Surface(vertices, two_of_four(faces))
    if isinstance(obstacle, Turned):
        inner = obstacle_surface(obstacle.body, reach, sides=sides)
        return Surface(obstacle.frame.seen(inner.vertices), inner.faces)
    raise InputError(f"there is no picture of a {type(obstacle).__name__}")


def swept(line: Array, radii: Array, *, sides: int = SIDES, capped: bool = True) -> Surface:
    """What lies around a polyline (k, 3) at distances (k,), m, with half balls at its ends if `capped`."""
    step = np.diff(line, axis=0)
    length = np.linalg.norm(step, axis=1)[:, None]
    along = np.where(length > 0, step / np.where(length > 0, length, 1.0), [0.0, 0.0, 1.0])
    middle = along[:-1] + along[1:]
    middle /= np.maximum(np.linalg.norm(middle, axis=1)[:, None], 1e-12)
    rings = list(zip(line, [along[0], *middle, along[-1]], radii, strict=True))
    if capped:
        lifts = np.linspace(0.0, np.pi / 2, sides // 4 + 1)
        first, last, begin, end = line[0], line[-1], along[0], along[-1]
        front = [(first - radii[0] * np.sin(x) * begin, begin, radii[0] * np.cos(x)) for x in lifts[:0:-1]]
        back = [(last + radii[-1] * np.sin(x) * end, end, radii[-1] * np.cos(x)) for x in lifts[1:]]
        rings = [*front, *rings, *back]
    angle = np.arange(sides) * 2 * np.pi / sides
    aside, vertices = axes_about(along[0])[0], []
    for centre, normal, radius in rings:
        aside = aside - (aside @ normal) * normal
        aside = aside / max(float(np.linalg.norm(aside)), 1e-12)
        around = np.cos(angle)[:, None] * aside + np.sin(angle)[:, None] * np.cross(normal, aside)
        vertices.append(centre + radius * around)
    return Surface(np.concatenate(vertices), grid_faces(len(rings), sides))


def revolved(profile: Array, *, sides: int = SIDES) -> Surface:
    """A body of revolution about z: radius and height (k, 2), from the top down along the outside."""
    angle = -np.arange(sides) * 2 * np.pi / sides
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(sides)])
    vertices = profile[:, 0, None, None] * ring + profile[:, 1, None, None] * np.array([0.0, 0.0, 1.0])
    return Surface(vertices.reshape(-1, 3), grid_faces(len(profile), sides))


def _box(low: Array, high: Array) -> Surface:
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    # Corners are not shared between sides, so that edges stay sharp.
    vertices = np.concatenate([corner[list(side)] for side in sides])
    return Surface(low + vertices * (high - low), two_of_four(np.arange(24).reshape(6, 4)))


def _plane(point: Array, normal: Array, reach: float) -> Surface:
    x, y, z = axes_about(normal / np.linalg.norm(normal))
    foot = z * float(point @ z)
    corners = [foot + reach * (a * x + b * y) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    faces = np.array([[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0]], dtype=np.uint32)
    return Surface(np.array(corners), faces)


def axes_about(z: Array) -> Array:
    """(3, 3) rows of a right-handed frame whose third axis is `z`."""
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(z, x), z])
