"""The hull of two balls: a capsule whose radius goes linearly from one end to the other, of which ways are made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import positive
from ..typing import Array
from .obstacles import PIECES, Balls, Point3, as_points, greater, root, triple, unit_vectors


@dataclass(frozen=True)
class RoundCone:
    """All points within balls whose centres go from `start` to `end` and whose radii go linearly from `start_radius` to
    `end_radius`, m.

    Its distance is the least of those from the balls: exact outside; inside, the depth in the ball in which a point
    lies deepest, which is not above the distance from the surface.

    Raises:
        InputError: a number that is not finite, a radius that is not greater than 0.
    """

    start: Point3
    end: Point3
    start_radius: float
    end_radius: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", triple("start of the cone", self.start))
        object.__setattr__(self, "end", triple("end of the cone", self.end))
        for name in ("start_radius", "end_radius"):
            object.__setattr__(self, name, positive(f"{name} of the cone", getattr(self, name)))

    @cached_property
    def _row(self) -> tuple[float, ...]:
        """Start (3), unit axis (3), length, radius at the start, its change per length, and over what that is the slope
        of the surface. Where one ball holds the other, it is alone."""
        axis = np.subtract(self.end, self.start)
        length = float(np.linalg.norm(axis))
        change = self.end_radius - self.start_radius
        if abs(change) >= length:
            centre = self.end if change > 0 else self.start
            return (*centre, 0.0, 0.0, 0.0, 0.0, max(self.start_radius, self.end_radius), 0.0, 0.0)
        slope = change / length
        return (*self.start, *(axis / length).tolist(), length, self.start_radius, slope, slope / (1 - slope**2) ** 0.5)

    def distance(self, x: Any, y: Any, z: Any) -> Any:
        """Smooth signed distance, m."""
        a, b, c, u, v, w, length, radius, slope, lean = self._row
        x, y, z = x - a, y - b, z - c
        along = x * u + y * v + z * w
        square = (x - along * u) ** 2 + (y - along * v) ** 2 + (z - along * w) ** 2
        t = -greater(-greater(along + root(square) * lean, 0.0), -length) if length else 0.0
        return root(square + (along - t) ** 2) - radius - slope * t

    SOLID = True

    def balls(self) -> Balls:
        """Around pieces of the axis, no longer than the cone is thick, where that does not take too many."""
        start, axis, (length, radius, slope, _) = np.split(np.array(self._row), [3, 6])
        count = int(np.clip(np.ceil(length / (2 * min(radius, radius + slope * length))), 1, PIECES))
        ends = np.linspace(0.0, length, count + 1)
        middle, most = (ends[1:] + ends[:-1]) / 2, radius + np.maximum(slope * ends[1:], slope * ends[:-1])
        return start + middle[:, None] * axis, most + length / (2 * count)

    def numbers(self) -> tuple[float, ...]:
        """What `distances` takes."""
        return self._row

    @staticmethod
    def _from_axis(points: Array, numbers: Array) -> tuple[Array, Array]:
        """(..., 3) vectors to points from the centres of the balls they are nearest to, and (...) radii of these."""
        away, axis = points - numbers[..., :3], numbers[..., 3:6]
        along = (away * axis).sum(-1)
        aside = np.linalg.norm(away - along[..., None] * axis, axis=-1)
        t = np.clip(along + aside * numbers[..., 9], 0.0, numbers[..., 6])
        return away - t[..., None] * axis, numbers[..., 7] + numbers[..., 8] * t

    @staticmethod
    def distances(points: Array, numbers: Array) -> Array:
        """(...) distances of points (..., 3) from cones of `numbers` (..., 10), m."""
        away, radius = RoundCone._from_axis(points, numbers)
        return np.asarray(np.linalg.norm(away, axis=-1) - radius)

    def signed_distance(self, points: ArrayLike) -> Array:
        """(...) distance of points (..., 3), m."""
        return self.distances(as_points(points), np.array(self._row))

    @staticmethod
    def gradients(points: Array, numbers: Array) -> Array:
        """(..., 3) unit vectors along which the distances of points (..., 3) from cones of `numbers` (..., 10) grow."""
        axis = numbers[..., 3:6]
        aside = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis), axis=-1)])
        away, _ = RoundCone._from_axis(points, numbers)
        return unit_vectors(away, unit_vectors(aside, np.array([0.0, 0.0, 1.0])))

    def gradient(self, points: ArrayLike) -> Array:
        """(..., 3) unit vectors away from it; in the middle of a ball, one square to the axis."""
        return self.gradients(as_points(points), np.array(self._row))


def depth(cones: Sequence[RoundCone], points: Array) -> Array:
    """(...) how deep points (..., 3) lie in the ball of all cones in which they lie deepest, m; outside, negative, the
    distance from them."""
    return np.asarray(np.max([-cone.signed_distance(points) for cone in cones], axis=0))
