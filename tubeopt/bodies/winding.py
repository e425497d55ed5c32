"""Winding number of a closed surface of triangles: how often it goes around a point.

A ray from the point crosses the surface; each crossing counts 1 where the surface is left and -1 where it is entered.
The sum is 1 in a body, 0 outside and in its cavities, and 2 where two bodies overlap. Unlike the normal of the nearest
triangle it is right where surfaces cross each other or lie within one another.

A ray through an edge or a corner is taken for one beside it, by the same rule for all triangles there (simulation of
simplicity, Edelsbrunner and Muecke 1990). Where round-off may decide, another direction is asked.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from ..typing import Array, Index, Mask

_ANGLES = [0.7, 0.4, 1.1], [2.3, 0.5, 0.2], [1.2, 2.9, 0.8]
DIRECTIONS = scipy.spatial.transform.Rotation.from_euler("xyz", _ANGLES).as_matrix()
"""(3, 3, 3) axes of rays, asked one after the other: none are those along which many surfaces have edges."""

ROUND_OFF = 1e-13
"""Share of the square of the size below which round-off may decide on which side of an edge a ray passes."""

MOST_COLUMNS = 512
"""Columns in which triangles are looked up, along either side."""


@dataclass(frozen=True, eq=False)
class Rays:
    """A surface as parallel rays see it: corners (f, 3, 3) of its triangles, the third coordinate along the rays."""

    corners: Array

    @cached_property
    def _grid(self) -> tuple[Array, Array, int]:
        """Where columns begin (2,), their widths (2,), and how many there are along either side."""
        flat = self.corners[..., :2].reshape(-1, 2)
        low, count = flat.min(0), int(np.clip(np.sqrt(len(self.corners)), 1, MOST_COLUMNS))
        return low, np.maximum(np.ptp(flat, axis=0), 1e-300) / count, count

    @cached_property
    def _columns(self) -> tuple[Index, Index]:
        """Where the triangles of every column begin in a list (columns + 1,), and that list."""
        low, width, count = self._grid
        flat = self.corners[..., :2]
        first, last = (
            np.clip(np.floor((ends - low) / width).astype(int), 0, count - 1) for ends in (flat.min(1), flat.max(1))
        )
        spans = last - first + 1
        each = spans.prod(1)
        face = np.repeat(np.arange(len(each)), each)
        step = np.arange(len(face)) - np.repeat(np.cumsum(each) - each, each)
        x, y = first[face, 0] + step % spans[face, 0], first[face, 1] + step // spans[face, 0]
        column = y * count + x
        order = np.argsort(column, kind="stable")
        return np.searchsorted(column[order], np.arange(count * count + 1)), face[order]

    @cached_property
    def _sides(self) -> tuple[Array, Array, Array]:
        """Of every triangle, where its three sides begin and end (f, 3, 2), each from the lesser to the greater corner,
        so that two triangles compute the same of a side that they share; and 1, or -1 where that turns it (f, 3)."""
        begin = self.corners[..., :2]
        end = np.roll(begin, -1, axis=1)
        back = (begin[..., 0] > end[..., 0]) | ((begin[..., 0] == end[..., 0]) & (begin[..., 1] > end[..., 1]))
        return np.where(back[..., None], end, begin), np.where(back[..., None], begin, end), np.where(back, -1.0, 1.0)

    def winding(self, points: Array) -> tuple[Array, Mask]:
        """(N,) how often the surface goes around points (N, 3), and where round-off may have decided."""
        low, width, count = self._grid
        places = np.floor((points[:, :2] - low) / width).astype(int)
        seen = ((places >= 0) & (places <= count)).all(1)
        column = np.clip(places[:, 1], 0, count - 1) * count + np.clip(places[:, 0], 0, count - 1)
        starts, faces = self._columns
        each = np.where(seen, starts[column + 1] - starts[column], 0)
        row = np.repeat(np.arange(len(points)), each)
        face = faces[np.arange(len(row)) + np.repeat(starts[column] - np.cumsum(each) + each, each)]
        begin, end, sense = (table[face] for table in self._sides)
        side, away = end - begin, points[row, None, :2] - begin
        area = side[..., 0] * away[..., 1] - side[..., 1] * away[..., 0]
        left = np.where(area >= 0, sense, -sense)  # a ray through a side passes to the left of it
        hit = np.abs(left.sum(1)) == 3
        size = float(np.ptp(self.corners.reshape(-1, 3), axis=0).max())
        doubtful = (np.abs(area) <= ROUND_OFF * size**2).any(1)
        row_doubtful = np.bincount(row[doubtful], minlength=len(points)) > 0
        row, face, weight = row[hit], face[hit], np.roll((sense * area)[hit], -1, axis=1)
        height = (weight * self.corners[face, :, 2]).sum(1) / weight.sum(1)
        crossed = np.where(height > points[row, 2], left[hit, 0], 0.0)
        return np.asarray(np.bincount(row, crossed, len(points)), dtype=float), row_doubtful


def winding_number(rays: list[Rays], points: Array) -> Array:
    """(N,) winding numbers at points (N, 3) of a surface as `seen_along` has it."""
    out, asked = np.zeros(len(points)), np.arange(len(points))
    for direction, seen in zip(DIRECTIONS, rays, strict=True):
        out[asked], doubtful = seen.winding(_turned(points[asked], direction))
        asked = asked[doubtful]
        if not len(asked):
            break
    return out


def seen_along(corners: Array) -> list[Rays]:
    """A surface of triangles (f, 3, 3), by the rays of all DIRECTIONS."""
    return [Rays(_turned(corners, direction)) for direction in DIRECTIONS]


def _turned(points: Array, axes: Array) -> Array:
    """Points (..., 3) by their coordinates along axes (3, 3), number by number: equal points stay equal to the last
    digit, wherever they stand."""
    x, y, z = np.moveaxis(points, -1, 0)
    return np.stack([x * axis[0] + y * axis[1] + z * axis[2] for axis in axes], axis=-1)
