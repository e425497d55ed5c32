"""Distance from a closed body as a table on a lattice, interpolated to a lower bound.

At the nodes v_k of the cell around a point y, the table has lower bounds d_k of the distances from the body. The
weights w_k of trilinear interpolation satisfy y = sum w_k v_k, so that for the point p of the body nearest to y

    sum w_k max(d_k, 0)^2 <= sum w_k |v_k - p|^2 = |y - p|^2 + V,     V = sum over axes of t (1 - t) h^2,

with the coordinate t in the cell from 0 to 1 and its size h along an axis. So the distance from the body is at least
sqrt(sum w_k max(d_k, 0)^2 - V). This is exact for a body that is a point. Otherwise it is too small by at most
V / (2 d): 0.1 mm at 1 mm from a plane in cells of 0.5 mm. If the radicand is negative, the signed distance is at least
sum w_k d_k - sqrt(V), since it changes by no more than its point moves. Both bounds are within 2 sqrt(V) of the
distance, which is at most the diagonal of a cell.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from ..typing import Array
from .frames import Frame
from .obstacles import as_points, distance_of_numbers, unit_vectors

# Length (m) subtracted from the table, for the rounding of its numbers.
TABLE_ROUND_OFF = 1e-9

# Distance from the surface, in cells, below which gradients are differences of distances, above it of their squares:
# near the surface a square has no slope, far away it is smoother.
NEAR = 1.5

UP = np.array([0.0, 0.0, 1.0])

CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


class Source(Protocol):
    """Source body of a table of distances."""

    def gradient(self, points: Array) -> Array:
        """Gradients (N, 3) of the distance at points (N, 3), m from the first node in the axes of the lattice."""


@dataclass(frozen=True, eq=False)
class DistanceField:
    """Body given by its signed distance on a lattice, positive outside, where the arm may be."""

    values: Array = field(repr=False)
    """Lower bounds of the distance at the nodes (a, b, c), m."""
    spacing: Array
    """Spacing of the nodes along the axes of the lattice (3,), m."""
    frame: Frame = field(default_factory=Frame, repr=False)
    """Frame of the lattice in the frame of the plate; its origin is the first node."""
    node_error: float = 0.0
    """Largest error of the values, m; they are never too large."""
    bounded: bool = False
    """True if the body lies within the lattice; else it continues beyond."""
    name: str = "anatomy"
    source: Source | None = field(default=None, repr=False)
    """Source of exact gradients; None for a table alone."""
    stands_for: str = ""
    """Reference of the distance for points or an open surface, as text; empty for a solid."""

    def __post_init__(self) -> None:
        shape = np.shape(self.values)
        if len(shape) != 3 or min(shape) < 2:
            raise InputError(f"values of the distance field have shape {shape}; it must be a table of 2 nodes at least")
        # Rounded down, so that the table remains a lower bound.
        lowered = np.nextafter(
            np.asarray(self.values, dtype=np.float32) - np.float32(TABLE_ROUND_OFF), np.float32(-np.inf)
        )
        object.__setattr__(self, "values", lowered)
        object.__setattr__(self, "spacing", np.asarray(self.spacing, dtype=float))

    @property
    def error(self) -> float:
        """Largest error of `signed_distance`, m; it is never larger than the distance from the body."""
        return self.node_error + float(np.linalg.norm(self.spacing)) + 4 * TABLE_ROUND_OFF

    @property
    def diagonal(self) -> float:
        """Distance from the first node to the last, m."""
        return float(np.linalg.norm((np.array(self.values.shape) - 1) * self.spacing))

    @property
    def lattice(self) -> DistanceField:
        """Table of distances, which is the field itself."""
        return self

    def in_frame(self, frame: Frame) -> DistanceField:
        """Copy in a frame that is given in the frame of the body."""
        moved = copy(self)  # shares the tables
        object.__setattr__(moved, "frame", frame.of(self.frame))
        return moved

    @cached_property
    def _squares(self) -> Array:
        """Squared distances (a, b, c) outside of the body, rounded down, m^2."""
        square = np.square(np.maximum(self.values, 0.0))
        return np.nextafter(square, np.float32(0.0))

    def _clipped(self, points: Array) -> tuple[Array, Array]:
        """Coordinates (3, N) of points (N, 3) in nodes, clipped to the lattice, and their distances (N,) from it, m."""
        index = self.frame.seen(points) / self.spacing
        clipped = np.clip(index, 0.0, np.array(self.values.shape) - 1.0)
        return clipped.T, np.linalg.norm((index - clipped) * self.spacing, axis=1)

    def _variance(self, at: Array) -> Array:
        """Variance V, m^2, in the bound of the module's docstring, at coordinates (3, N)."""
        t = at - np.floor(at)
        return np.asarray((t * (1 - t) * self.spacing[:, None] ** 2).sum(0))

    def distance(self, x: Any, y: Any, z: Any) -> Any:
        """Signed distance for numbers; a table has no formula for symbols."""
        return distance_of_numbers(self, x, y, z, "a distance field has no formula for its distance")

    def signed_distance(self, points: ArrayLike) -> Array:
        """Lower bounds (...) of the distance of points (..., 3), m; in the lattice too small by at most `error`."""
        array = as_points(points)
        at, beyond = self._clipped(array.reshape(-1, 3))
        variance = self._variance(at)
        square = scipy.ndimage.map_coordinates(self._squares, at, order=1, output=float) - variance
        out = np.sqrt(np.maximum(square, 0.0))
        low = square <= 0
        if low.any():
            linear = scipy.ndimage.map_coordinates(self.values, at[:, low], order=1, output=float)
            out[low] = linear - np.sqrt(variance[low])
        outside = beyond > 0
        if self.bounded:  # the lattice is convex: the path over its nearest point turns by a right angle or more
            out[outside] = np.hypot(np.maximum(out[outside], 0.0), beyond[outside])
        else:
            out[outside] -= beyond[outside]
        return np.asarray(out.reshape(array.shape[:-1]))

    def at_most(self, points: Array) -> Array:
        """Upper bounds (N,) of the distance of points (N, 3) from the body, m."""
        at, beyond = self._clipped(points)
        linear = scipy.ndimage.map_coordinates(self.values, at, order=1, output=float)
        return np.asarray(linear + np.sqrt(self._variance(at)) + self.node_error + 4 * TABLE_ROUND_OFF + beyond)

    def gradient(self, points: ArrayLike) -> Array:
        """Gradients (..., 3) of the distance at points (..., 3), unit vectors.

        With a source they are exact. If several points of the body are equally near, the gradient belongs to one of
        them. Without a source, see `_interpolated_gradient`.
        """
        array = as_points(points)
        flat = array.reshape(-1, 3)
        if self.source is not None:
            out = self.source.gradient(self.frame.seen(flat)) @ self.frame.axes.T
        else:
            out = self._interpolated_gradient(flat)
        return np.asarray(out.reshape(array.shape))

    def _interpolated_gradient(self, points: Array) -> Array:
        """Gradients (N, 3) from interpolated differences between neighbouring nodes, unit vectors.

        Differences of squared distances are used, which are quadratic near planes and points. Next to the surface,
        where squares have a kink, differences of the distances are used; also if their slope is closer to its exact
        value 1 than that of the squares to twice their root.
        """
        at, _ = self._clipped(points)
        base = np.minimum(np.floor(at).astype(int), np.array(self.values.shape)[:, None] - 2)
        t = at - base
        corner = base[:, :, None] + CORNERS.T[:, None, :]
        weight = np.where(CORNERS.T[:, None, :] == 1, t[:, :, None], 1 - t[:, :, None]).prod(0)
        last = np.array(self.values.shape) - 1
        value = self.values[tuple(corner)].astype(float)
        linear, square = (weight * value).sum(1), (weight * value * np.abs(value)).sum(1)
        slopes = np.empty((2, at.shape[1], 3))
        for axis in range(3):
            ahead, behind = corner.copy(), corner.copy()
            ahead[axis] = np.minimum(corner[axis] + 1, last[axis])
            behind[axis] = np.maximum(corner[axis] - 1, 0)
            step = (ahead[axis] - behind[axis]) * self.spacing[axis]
            a, b = (self.values[tuple(each)].astype(float) for each in (ahead, behind))
            slopes[0, :, axis] = (weight * (a - b) / step).sum(1)
            slopes[1, :, axis] = (weight * (a * np.abs(a) - b * np.abs(b)) / step).sum(1)
        plain, squared = np.linalg.norm(slopes, axis=2)
        root = 2 * np.sqrt(np.maximum(np.abs(square), TABLE_ROUND_OFF**2))
        close = np.abs(linear) < NEAR * self.spacing.max()
        close |= np.abs(plain - 1) <= np.abs(squared / root - 1)
        out = unit_vectors(np.where(close[:, None], *slopes) @ self.frame.axes.T, UP)
        if self.bounded:  # outside of the lattice `signed_distance` is a hypotenuse
            away = points - self.frame.placed(at.T * self.spacing)
            out = unit_vectors(out * np.maximum(linear, 0.0)[:, None] + away, out)
        return out


# Largest number of cells along a side of a drawn surface: the number of triangles grows with its square.
MAX_CELLS = 72


def surface_net(field: DistanceField, *, max_cells: int = MAX_CELLS) -> tuple[Array, NDArray[np.intp]]:
    """Vertices (v, 3), m, and quadrilaterals (f, 4) of the surface, counterclockwise seen from outside.

    Every cell that the surface passes has one vertex, at the mean of the crossings of its edges (Gibson 1998). Of a
    fine lattice, every second, third, ... node is used.
    """
    step = max(1, int(np.ceil(max(field.values.shape) / max_cells)))
    values = field.values[::step, ::step, ::step].astype(float)
    cells = np.array(values.shape) - 1
    total, count = np.zeros((*cells, 3)), np.zeros(tuple(cells), dtype=int)
    crossings = []
    for axis in range(3):
        a, b = (np.take(values, range(k, cells[axis] + k), axis) for k in (0, 1))
        at = np.argwhere((a < 0) != (b < 0))
        low, high = a[tuple(at.T)], b[tuple(at.T)]
        crossing = at.astype(float)
        crossing[:, axis] += low / (low - high)
        other_axes = [k for k in range(3) if k != axis]
        corners = []
        for i, j in ((-1, -1), (0, -1), (0, 0), (-1, 0)):
            cell = at.copy()
            cell[:, other_axes] += (i, j)
            corners.append(cell)
            exists = ((cell >= 0) & (cell < cells)).all(1)
            np.add.at(total, tuple(cell[exists].T), crossing[exists])
            np.add.at(count, tuple(cell[exists].T), 1)
        around = np.stack(corners, axis=1)
        complete = ((around >= 0) & (around < cells)).all((1, 2))
        forward = (low < 0) == (axis != 1)  # the other two axes in order are left-handed for the second
        crossings.append(np.where(forward[:, None, None], around, around[:, ::-1])[complete])
    used = count > 0
    number = np.cumsum(used).reshape(used.shape) - 1
    facets = np.concatenate(crossings)
    vertices = total[used] / count[used][:, None] * step * field.spacing
    return field.frame.placed(vertices), number[tuple(np.moveaxis(facets, 2, 0))]
