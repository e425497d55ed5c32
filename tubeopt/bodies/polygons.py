"""Surfaces of plane polygons, cut into triangles that cover each polygon and nothing beyond it.

A convex polygon is cut into a fan. Another loses its ears one by one (manifold3d): a fan would cover what lies outside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError, extra
from ..typing import Array, Index, Mask

FLAT = 1e-5
"""Distance (m) of corners from their plane that rounding explains: two decimals of a mm, or six digits of a metre."""

ROUND = 1e-6
"""A turn (rad) to the other side, and the excess over a full turn, up to which a polygon is convex."""

PAIRS = 1 << 22
"""Pairs of sides that are compared at once: bounds the memory."""


@dataclass(frozen=True, eq=False)
class Polygons:
    """A surface as a file has it."""

    points: Array
    """(N, 3) in the unit of the file."""
    corners: Index
    """(sum of counts,) points of all polygons one behind the other, from 0."""
    counts: Index
    """(f,) corners of each."""

    @classmethod
    def of_faces(cls, points: ArrayLike, faces: list[list[int]]) -> Polygons:
        """A surface by points (N, 3) and the corners of each face."""
        corners = np.array([corner for face in faces for corner in face], dtype=int)
        return cls(np.array(points, dtype=float).reshape(-1, 3), corners, np.array(list(map(len, faces)), dtype=int))

    def triangles(self, scale: float) -> Index:
        """(g, 3) triangles, from 0, in the order of the polygons; `scale` is the unit of the points, m.

        Raises:
            InputError: a polygon with fewer than three corners, with a corner that is no point, that is not plane or
                that crosses itself; manifold3d is not installed and a polygon is not convex.
        """
        if len(self.corners) and not ((self.corners >= 0) & (self.corners < len(self.points))).all():
            raise InputError(f"it has polygons with corners outside its {len(self.points)} points")
        begins = np.cumsum(self.counts) - self.counts
        found, of = [np.zeros((0, 3), dtype=int)], [np.zeros(0, dtype=int)]
        for count in np.unique(self.counts):
            face = np.flatnonzero(self.counts == count)
            if count < 3:
                raise InputError(f"face {face[0] + 1} has {count} corners; it must have at least 3")
            corners = self.corners[begins[face, None] + np.arange(count)]
            cut = np.stack([np.zeros(count - 2, int), np.arange(1, count - 1), np.arange(2, count)], axis=1)
            fans = np.broadcast_to(cut, (len(face), count - 2, 3)).copy()
            if count > 3:
                plane, off = in_their_planes(self.points[corners] * scale)
                if off.max() > FLAT:
                    raise InputError(
                        f"face {face[off.argmax()] + 1} is not plane: one of its {count} corners is "
                        f"{off.max() * 1e3:.3g} mm from their plane, and at most {FLAT * 1e3:g} mm are allowed; "
                        "save the surface as triangles"
                    )
                for k in np.flatnonzero(~convex(plane)):
                    try:
                        fans[k] = without_ears(plane[k])
                    except InputError as error:
                        raise InputError(f"face {face[k] + 1} {error}") from None
            found.append(np.take_along_axis(corners[:, None], fans, axis=2).reshape(-1, 3))
            of.append(np.repeat(face, count - 2))
        return np.concatenate(found)[np.argsort(np.concatenate(of), kind="stable")]


def in_their_planes(corners: Array) -> tuple[Array, Array]:
    """(f, k, 2) polygons (f, k, 3) in the planes nearest to their corners, and (f,) how far a corner is from its plane;
    m."""
    away = corners - corners.mean(1, keepdims=True)
    axes = np.linalg.eigh(np.swapaxes(away, 1, 2) @ away)[1]
    seen = away @ axes
    return seen[..., 1:], np.abs(seen[..., 0]).max(1)


def convex(plane: Array) -> Mask:
    """(f,) whether polygons (f, k, 2) turn to one side everywhere, and once around."""
    side = np.roll(plane, -1, axis=1) - plane
    after = np.roll(side, -1, axis=1)
    turn = np.arctan2(_cross(side, after), (side * after).sum(-1))
    once = np.abs(np.abs(turn.sum(1)) - 2 * np.pi) < ROUND
    return np.asarray(once & ((turn > -ROUND).all(1) | (turn < ROUND).all(1)))


def without_ears(plane: Array) -> Index:
    """(k - 2, 3) triangles of one polygon (k, 2), turned as it is; its sides may touch.

    Raises:
        InputError: it crosses itself; manifold3d is not installed.
    """
    library = extra("manifold3d", "anatomy", "polygons that are not convex")
    turned = _cross(plane, np.roll(plane, -1, axis=0)).sum() < 0
    cut = np.asarray(library.triangulate([plane[::-1] if turned else plane]), dtype=int)
    cut = (len(plane) - 1 - cut)[:, ::-1] if turned else cut
    # A triangulation without a triangle that is turned over covers a polygon once where its sides do not cross.
    corner = plane[cut]
    area = _cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]) * (-1 if turned else 1)
    longest = np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2).max(1)
    if cut.shape != (len(plane) - 2, 3) or (area < -FLAT * longest).any() or crosses_itself(plane):
        raise InputError("crosses itself; its sides may meet at its corners only")
    return cut


def crosses_itself(plane: Array) -> bool:
    """Whether two sides of a polygon (k, 2) cross; those that only touch do not."""
    start, end = plane, np.roll(plane, -1, axis=0)
    size = float(np.ptp(plane, axis=0).max())
    rows = max(1, PAIRS // len(plane))
    for k in range(0, len(plane), rows):
        a, b = start[k : k + rows, None], end[k : k + rows, None]
        apart = _side(a, b, start, size) * _side(a, b, end, size) < 0
        if (apart & (_side(start, end, a, size) * _side(start, end, b, size) < 0)).any():
            return True
    return False


def _side(start: Array, end: Array, point: Array, size: float) -> Array:
    """On which side of lines points lie: 1, -1, or 0 within rounding of a polygon of this size."""
    across = _cross(end - start, point - start)
    return np.where(np.abs(across) <= 1e-9 * size * np.linalg.norm(end - start, axis=-1), 0.0, np.sign(across))


def _cross(a: Array, b: Array) -> Array:
    """(...) the vector product of vectors (..., 2)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
