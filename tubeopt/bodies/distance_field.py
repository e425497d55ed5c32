"""The distance from any closed body as a table on a lattice, read so that it is never more than it is.

At the nodes v_k of the cell around a point y the table holds no more than the distances d_k from the body. With the
weights w_k of trilinear interpolation y = sum w_k v_k, so that for the place p of the body that is nearest to y

    sum w_k max(d_k, 0)^2 <= sum w_k |v_k - p|^2 = |y - p|^2 + V,     V = sum over axes of t (1 - t) h^2,

t the fraction of the way through the cell along an axis and h its size there. So the distance from the body is at least
sqrt(sum w_k max(d_k, 0)^2 - V), which for a body that is a point is the distance itself, and elsewhere falls short by
at most V / (2 d), 0.1 mm at 1 mm from a plane in cells of 0.5 mm. Where the root has nothing to be taken of, a signed
distance, which changes by no more than its point moves, is at least sum w_k d_k - sqrt(V). Either bound is within
2 sqrt(V), at most the diagonal of a cell, of what it bounds.
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

# Length (m) by which the table is lowered, for the rounding of its numbers.
ROUND_OFF = 1e-9

# Sizes of a cell from the surface up to which gradients are those of distances, beyond it of their squares: near the
# surface a square has no slope, far away it is the smoother of both.
NEAR = 1.5

UP = np.array([0.0, 0.0, 1.0])

CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


class Source(Protocol):
    """What a table was made from."""

    def gradient(self, points: Array) -> Array:
        """(N, 3) unit vectors away from the body at points (N, 3), m from the first node along the lattice's axes."""


@dataclass(frozen=True, eq=False)
class DistanceField:
    """A body by its signed distance on a lattice, positive outside of it, where the arm may be."""

    values: Array = field(repr=False)
    """(a, b, c) at nodes, none more than the distance is, m."""
    spacing: Array
    """(3,) between nodes along the axes of the lattice, m."""
    frame: Frame = field(default_factory=Frame, repr=False)
    """Frame of the lattice in that of the plate; its origin is the first node."""
    node_error: float = 0.0
    """Largest error of the values, m; they are never too large."""
    bounded: bool = False
    """True if the body lies within the lattice; else it continues beyond."""
    name: str = "anatomy"
    source: Source | None = field(default=None, repr=False)
    """Source of exact gradients; None if there is only the table."""
    stands_for: str = ""
    """Reference of the distance for points or an open surface, as text; empty for a solid."""

    def __post_init__(self) -> None:
        shape = np.shape(self.values)
        if len(shape) != 3 or min(shape) < 2:
            raise InputError(f"values of the distance field have shape {shape}; it must be a table of 2 nodes at least")
        lowered = np.nextafter(np.asarray(self.values, dtype=np.float32) - np.float32(ROUND_OFF), np.float32(-np.inf))
        object.__setattr__(self, "values", lowered)
        object.__setattr__(self, "spacing", np.asarray(self.spacing, dtype=float))

    @property
    def error(self) -> float:
        """Largest error of `signed_distance`, m; it is never larger than the distance from the body."""
        return self.node_error + float(np.linalg.norm(self.spacing)) + 4 * ROUND_OFF

    @property
    def diagonal(self) -> float:
        """Distance from the first node to the last, m."""
        return float(np.linalg.norm((np.array(self.values.shape) - 1) * self.spacing))

    @property
    def lattice(self) -> DistanceField:
        """The body as a table: itself."""
        return self

    def in_frame(self, frame: Frame) -> DistanceField:
        """Copy in the axes of a frame that is given in those of the body."""
        seen = copy(self)  # with its tables
        object.__setattr__(seen, "frame", frame.of(self.frame))
        return seen

    @cached_property
    def _squares(self) -> Array:
        """(a, b, c) squares of the distances outside of the body, rounded down, m^2."""
        square = np.square(np.maximum(self.values, 0.0))
        return np.nextafter(square, np.float32(0.0))

    def _places(self, points: Array) -> tuple[Array, Array]:
        """(3, N) coordinates of points (N, 3) by nodes, moved into the lattice, and (N,) how far they were moved, m."""
        at = self.frame.seen(points) / self.spacing
        inside = np.clip(at, 0.0, np.array(self.values.shape) - 1.0)
        return inside.T, np.linalg.norm((at - inside) * self.spacing, axis=1)

    def _variance(self, at: Array) -> Array:
        """(N,) V at coordinates (3, N), m^2."""
        t = at - np.floor(at)
        return np.asarray((t * (1 - t) * self.spacing[:, None] ** 2).sum(0))

    def distance(self, x: Any, y: Any, z: Any) -> Any:
        """Numbers only: a table has no formula."""
        return distance_of_numbers(self, x, y, z, "a distance field has no formula for its distance")

    def signed_distance(self, points: ArrayLike) -> Array:
        """(...) what the distance of points (..., 3) from the body is at least, m; within the lattice short of it by
        `error` at most."""
        array = as_points(points)
        at, beyond = self._places(array.reshape(-1, 3))
        variance = self._variance(at)
        square = scipy.ndimage.map_coordinates(self._squares, at, order=1, output=float) - variance
        out = np.sqrt(np.maximum(square, 0.0))
        low = square <= 0
        if low.any():
            linear = scipy.ndimage.map_coordinates(self.values, at[:, low], order=1, output=float)
            out[low] = linear - np.sqrt(variance[low])
        outside = beyond > 0
        if self.bounded:  # the lattice is convex, and the way on to the body from its border makes no acute angle
            out[outside] = np.hypot(np.maximum(out[outside], 0.0), beyond[outside])
        else:
            out[outside] -= beyond[outside]
        return np.asarray(out.reshape(array.shape[:-1]))

    def at_most(self, points: Array) -> Array:
        """(N,) what the distance of points (N, 3) from the body is not above, m."""
        at, beyond = self._places(points)
        linear = scipy.ndimage.map_coordinates(self.values, at, order=1, output=float)
        return np.asarray(linear + np.sqrt(self._variance(at)) + self.node_error + 4 * ROUND_OFF + beyond)

    def gradient(self, points: ArrayLike) -> Array:
        """(..., 3) unit vectors along which the distance of points (..., 3) grows.

        With a source they are those of the distance itself, to round-off, wherever one place of the body is the
        nearest: elsewhere the distance has no gradient, and it is that of one of the nearest places. Without, see
        `_sloped`.
        """
        array = as_points(points)
        flat = array.reshape(-1, 3)
        if self.source is not None:
            out = self.source.gradient(self.frame.seen(flat)) @ self.frame.axes.T
        else:
            out = self._sloped(flat)
        return np.asarray(out.reshape(array.shape))

    def _sloped(self, points: Array) -> Array:
        """(N, 3) unit vectors by differences between neighbours of the nodes, interpolated: of squares of distances,
        which are quadratic about planes and points alike, and next to the surface, where squares have a kink, of the
        distances themselves; so too where their slope is nearer to the 1 that it must be than that of squares is to
        twice their root."""
        at, _ = self._places(points)
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
        root = 2 * np.sqrt(np.maximum(np.abs(square), ROUND_OFF**2))
        close = np.abs(linear) < NEAR * self.spacing.max()
        close |= np.abs(plain - 1) <= np.abs(squared / root - 1)
        out = unit_vectors(np.where(close[:, None], *slopes) @ self.frame.axes.T, UP)
        if self.bounded:  # as far as `signed_distance` is the hypotenuse of both
            away = points - self.frame.placed(at.T * self.spacing)
            out = unit_vectors(out * np.maximum(linear, 0.0)[:, None] + away, out)
        return out


# Cells along the longest side of a picture of the surface: its triangles grow with the square.
MOST = 72


def surface_net(field: DistanceField, *, most: int = MOST) -> tuple[Array, NDArray[np.intp]]:
    """Corners (v, 3), m, and facets (f, 4) by the numbers of their corners, seen counterclockwise from where the
    distance is positive: a corner in every cell that the surface passes, at the mean of where it crosses the cell's
    edges (Gibson 1998). Of a fine lattice only every so many nodes are looked at."""
    step = max(1, int(np.ceil(max(field.values.shape) / most)))
    values = field.values[::step, ::step, ::step].astype(float)
    cells = np.array(values.shape) - 1
    total, count = np.zeros((*cells, 3)), np.zeros(tuple(cells), dtype=int)
    crossings = []
    for axis in range(3):
        a, b = (np.take(values, range(k, cells[axis] + k), axis) for k in (0, 1))
        at = np.argwhere((a < 0) != (b < 0))
        low, high = a[tuple(at.T)], b[tuple(at.T)]
        place = at.astype(float)
        place[:, axis] += low / (low - high)
        beside = [k for k in range(3) if k != axis]
        corners = []
        for i, j in ((-1, -1), (0, -1), (0, 0), (-1, 0)):
            cell = at.copy()
            cell[:, beside] += (i, j)
            corners.append(cell)
            there = ((cell >= 0) & (cell < cells)).all(1)
            np.add.at(total, tuple(cell[there].T), place[there])
            np.add.at(count, tuple(cell[there].T), 1)
        around = np.stack(corners, axis=1)
        whole = ((around >= 0) & (around < cells)).all((1, 2))
        turned = (low < 0) == (axis != 1)  # the other two axes in order are left-handed for the second
        crossings.append(np.where(turned[:, None, None], around, around[:, ::-1])[whole])
    used = count > 0
    number = np.cumsum(used).reshape(used.shape) - 1
    facets = np.concatenate(crossings)
    vertices = total[used] / count[used][:, None] * step * field.spacing
    return field.frame.placed(vertices), number[tuple(np.moveaxis(facets, 2, 0))]
