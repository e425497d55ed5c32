"""Obstacles: bodies with a signed distance, positive outside, to keep an arm away from.

Every body says its distance three ways: `signed_distance` of NumPy points, exact; `gradient`, the unit vector away from
it; and `distance`, written with arithmetic alone, so that the same formula takes numbers, arrays and symbols of an
optimal control problem. There a kink (the edges of a box, the centre of a sphere) is rounded off within `SMOOTH`.
"""

from __future__ import annotations

import reprlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, ClassVar, Protocol

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..display import Displayed
from ..errors import InputError, positive, triple
from ..files.field_metadata import POSITIVE, Typical, check_usual, unit
from ..typing import Array
from .scene import scene_of

# Length (m) within which kinks of `distance` are rounded off, so that second derivatives exist for IPOPT; a distance
# changes by no more than a few times that.
SMOOTH = 1e-7

# Balls at most that cover a long body for the search of what is near: more balls are tighter, and each is asked.
PIECES = 16

Point3 = tuple[float, float, float]

# Of positions and radii of bodies, m.
AWAY, THICK = Typical(1e-6, 10.0), Typical(1e-5, 2.0)

Balls = tuple[Array, Array]
"""Centres (k, 3) and radii (k,) of balls that cover a body; m."""


class Obstacle(Protocol):
    """A body with a signed distance. Frozen and hashable, so that what is built for it can be cached."""

    def distance(self, x: Any, y: Any, z: Any) -> Any:
        """Smooth signed distance of points given by coordinates of any arithmetic kind, m."""

    def signed_distance(self, points: ArrayLike) -> Array:
        """(...) exact distance of points (..., 3) to the surface, m; negative inside."""

    def gradient(self, points: ArrayLike) -> Array:
        """(..., 3) unit vectors along which the distance of points (..., 3) grows."""

    def __hash__(self) -> int: ...


def checked_obstacles(obstacles: Any) -> tuple[Obstacle, ...]:
    """The obstacles as a tuple; raises InputError for what is no sequence of bodies."""
    try:
        bodies = tuple(obstacles)
    except TypeError:
        raise InputError(f"obstacles is {obstacles!r}; it must be a sequence of bodies, as [Sphere(...)]") from None
    for k, body in enumerate(bodies):
        if isinstance(body, type) or not hasattr(body, "signed_distance"):
            raise InputError(f"obstacle {k + 1} is {body!r}; it must be a body of tubeopt.bodies")
    return bodies


def root(square: Any) -> Any:
    """The square root, smooth at 0."""
    return (square + SMOOTH**2) ** 0.5


def greater(a: Any, b: Any) -> Any:
    """The greater of two, smooth where they are equal."""
    return (a + b + root((a - b) ** 2)) / 2


def unit_vectors(vectors: Array, otherwise: Array) -> Array:
    """Vectors (..., 3) over their length; `otherwise` (3,) where that is 0."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 0, vectors / np.where(length > 0, length, 1.0), otherwise)


def as_points(points: ArrayLike) -> Array:
    """Points (..., 3) as an array; raises InputError for another shape."""
    try:
        array = np.asarray(points, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"points is {reprlib.repr(points)}; it must be numbers, the last axis x, y, z") from None
    if array.shape[-1:] != (3,):
        raise InputError(f"points have shape {array.shape}; the last axis must be x, y, z")
    return array


class Measured(Displayed):
    """A body that its `numbers` stand for, so that many of a kind are measured at once."""

    SOLID = True
    """Whether `signed_distance` is outside of the body the distance from it, no bound of it."""

    def numbers(self) -> tuple[float, ...]:
        """What `distances` and `gradients` take for it."""
        raise NotImplementedError

    @staticmethod
    def distances(points: Array, numbers: Array) -> Array:
        """(...) distances of points (..., 3) from bodies of `numbers` (..., k), m."""
        raise NotImplementedError

    @staticmethod
    def gradients(points: Array, numbers: Array) -> Array:
        """(..., 3) unit vectors along which the distances of points (..., 3) from bodies of `numbers` (..., k) grow."""
        raise NotImplementedError

    def signed_distance(self, points: ArrayLike) -> Array:
        """(...) distance of points (..., 3), m."""
        return self.distances(as_points(points), np.array(self.numbers()))

    def gradient(self, points: ArrayLike) -> Array:
        """(..., 3) unit vectors along which the distance of points (..., 3) grows."""
        return self.gradients(as_points(points), np.array(self.numbers()))


class Axial(Measured):
    """A hull of two balls.

    Its distance is the least of those from the balls between both: exact outside; inside, the depth in the ball in
    which a point lies deepest, which is not above the distance from the surface.
    """

    CALLED: ClassVar[str]
    """In messages."""

    def __post_init__(self) -> None:
        for name, value in vars(self).copy().items():
            checked = positive if name.endswith("radius") else triple
            object.__setattr__(self, name, checked(f"{name} of the {self.CALLED}", value))
        check_usual(self, f"the {self.CALLED}")

    def ends(self) -> tuple[Point3, Point3, float, float]:
        """Centres and radii of the balls at both ends."""
        raise NotImplementedError

    @cached_property
    def _row(self) -> tuple[float, ...]:
        """Start (3), unit axis (3), length, radius at the start, its change per length, and over what that is the slope
        of the surface. Where one ball holds the other, it is alone."""
        start, end, begins, ends = self.ends()
        axis = np.subtract(end, start)
        length = float(np.linalg.norm(axis))
        change = ends - begins
        if abs(change) >= length:
            centre = end if change > 0 else start
            return (*centre, 0.0, 0.0, 0.0, 0.0, max(begins, ends), 0.0, 0.0)
        slope = change / length
        return (*start, *(axis / length).tolist(), length, begins, slope, slope / (1 - slope**2) ** 0.5)

    def distance(self, x: Any, y: Any, z: Any) -> Any:
        """Smooth signed distance, m."""
        a, b, c, u, v, w, length, radius, slope, lean = self._row
        x, y, z = x - a, y - b, z - c
        along = x * u + y * v + z * w
        square = (x - along * u) ** 2 + (y - along * v) ** 2 + (z - along * w) ** 2
        t = -greater(-greater(along + root(square) * lean, 0.0), -length) if length else 0.0
        return root(square + (along - t) ** 2) - radius - slope * t

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
        away, axis, lean = points - numbers[..., :3], numbers[..., 3:6], numbers[..., 9]
        t = (away * axis).sum(-1)
        if lean.any():
            t += np.linalg.norm(away - t[..., None] * axis, axis=-1) * lean
        t = np.clip(t, 0.0, numbers[..., 6])
        return away - t[..., None] * axis, numbers[..., 7] + numbers[..., 8] * t

    @staticmethod
    def distances(points: Array, numbers: Array) -> Array:
        """(...) distances of points (..., 3) from cones of `numbers` (..., 10), m."""
        away, radius = Axial._from_axis(points, numbers)
        return np.asarray(np.linalg.norm(away, axis=-1) - radius)

    @staticmethod
    def gradients(points: Array, numbers: Array) -> Array:
        """(..., 3) unit vectors along which the distances of points (..., 3) from cones of `numbers` (..., 10) grow."""
        axis = numbers[..., 3:6]
        aside = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis), axis=-1)])
        away, _ = Axial._from_axis(points, numbers)
        return unit_vectors(away, unit_vectors(aside, np.array([0.0, 0.0, 1.0])))


@dataclass(frozen=True)
class Sphere(Axial):
    """A ball.

    Raises:
        InputError: a number that is not finite, a radius that is not greater than 0.
    """

    centre: Annotated[Point3, unit("mm"), AWAY]
    radius: Annotated[float, unit("mm"), POSITIVE, THICK]

    CALLED = "sphere"

    ROUND = True
    """Whether the ball that covers the body is the body."""

    def ends(self) -> tuple[Point3, Point3, float, float]:
        """The centre twice and the radius twice: the sphere as a cone."""
        return self.centre, self.centre, self.radius, self.radius

    @staticmethod
    def distances(points: Array, numbers: Array) -> Array:
        """(...) signed distances of points (..., 3) from spheres of `numbers` (..., 10), m."""
        return np.asarray(np.linalg.norm(points - numbers[..., :3], axis=-1) - numbers[..., 7])


@dataclass(frozen=True)
class Capsule(Axial):
    """All points within `radius` of the segment from `start` to `end`.

    Raises:
        InputError: a number that is not finite, a radius that is not greater than 0.
    """

    start: Annotated[Point3, unit("mm"), AWAY]
    end: Annotated[Point3, unit("mm"), AWAY, "end point; equal to the start for a ball"]
    radius: Annotated[float, unit("mm"), POSITIVE, THICK]

    CALLED = "capsule"

    def ends(self) -> tuple[Point3, Point3, float, float]:
        """Centres and radii of the balls at both ends."""
        return self.start, self.end, self.radius, self.radius


@dataclass(frozen=True)
class RoundCone(Axial):
    """All points within balls whose centres and radii go linearly from those of one ball to those of another.

    Raises:
        InputError: a number that is not finite, a radius that is not greater than 0.
    """

    start: Point3
    """Centre, m."""
    end: Point3
    """Centre, m."""
    start_radius: float
    """m."""
    end_radius: float
    """m."""

    CALLED = "cone"

    def ends(self) -> tuple[Point3, Point3, float, float]:
        """Centres and radii of the balls at both ends."""
        return self.start, self.end, self.start_radius, self.end_radius


@dataclass(frozen=True)
class HalfSpace(Displayed):
    """Everything behind a plane.

    Raises:
        InputError: a number that is not finite, a normal without length.
    """

    point: Annotated[Point3, unit("mm"), AWAY, "any point of the plane"]
    normal: Annotated[Point3, "outward normal, towards the free side; any length"]

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", triple("point of the half-space", self.point))
        check_usual(self, "the half-space")
        normal = np.array(triple("normal of the half-space", self.normal))
        length = float(np.linalg.norm(normal))
        if length == 0:
            raise InputError("normal of the half-space is (0, 0, 0); it must have a direction")
        object.__setattr__(self, "normal", tuple((normal / length).tolist()))

    def distance(self, x: Any, y: Any, z: Any) -> Any:
        """Signed distance of a point from the plane, m; negative inside the obstacle."""
        (a, b, c), (u, v, w) = self.point, self.normal
        return (x - a) * u + (y - b) * v + (z - c) * w

    SOLID = True

    def signed_distance(self, points: ArrayLike) -> Array:
        """(...) distance of points (..., 3), m."""
        return np.asarray((as_points(points) - self.point) @ np.array(self.normal))

    def gradient(self, points: ArrayLike) -> Array:
        """(..., 3) the normal."""
        return np.broadcast_to(np.array(self.normal), as_points(points).shape).copy()


@dataclass(frozen=True)
class Box(Measured):
    """A cuboid along the axes of the plate.

    Raises:
        InputError: a number that is not finite, a corner `low` that is not below `high` along every axis.
    """

    low: Annotated[Point3, unit("mm"), AWAY, "corner with the smallest coordinates"]
    high: Annotated[Point3, unit("mm"), AWAY, "corner with the largest coordinates"]

    def __post_init__(self) -> None:
        object.__setattr__(self, "low", triple("low corner of the box", self.low))
        object.__setattr__(self, "high", triple("high corner of the box", self.high))
        for axis, a, b in zip("xyz", self.low, self.high, strict=True):
            if not a < b:
                raise InputError(f"corners of the box are {a:g} and {b:g} m along {axis}; low must be less than high")
        check_usual(self, "the box")

    def distance(self, x: Any, y: Any, z: Any) -> Any:
        """Smooth signed distance, m."""
        beyond = [
            root((value - (a + b) / 2) ** 2) - (b - a) / 2
            for value, a, b in zip((x, y, z), self.low, self.high, strict=True)
        ]
        outside = [greater(each, 0.0) for each in beyond]
        inside = greater(greater(beyond[0], beyond[1]), beyond[2])
        return root(outside[0] ** 2 + outside[1] ** 2 + outside[2] ** 2) - greater(-inside, 0.0)

    def balls(self) -> Balls:
        """The one through its corners."""
        low, high = np.array(self.low), np.array(self.high)
        return ((low + high) / 2)[None], np.array([np.linalg.norm(high - low) / 2])

    def numbers(self) -> tuple[float, ...]:
        """Coordinates of both corners, m."""
        return (*self.low, *self.high)

    @staticmethod
    def _beyond(points: Array, numbers: Array) -> tuple[Array, Array]:
        """How far points lie beyond the faces along each axis, and on which side of the middle."""
        low, high = numbers[..., :3], numbers[..., 3:]
        shifted = points - (low + high) / 2
        return np.abs(shifted) - (high - low) / 2, np.where(shifted < 0, -1.0, 1.0)

    @staticmethod
    def distances(points: Array, numbers: Array) -> Array:
        """(...) distances of points (..., 3) from boxes of `numbers` (..., 6), m."""
        beyond, _ = Box._beyond(points, numbers)
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
        return np.asarray(outside + np.minimum(beyond.max(-1), 0.0))

    @staticmethod
    def gradients(points: Array, numbers: Array) -> Array:
        """(..., 3) unit vectors to points (..., 3) from the nearest place of boxes of `numbers` (..., 6);
        inside, through the nearest face."""
        beyond, side = Box._beyond(points, numbers)
        nearest = np.eye(3)[np.argmax(beyond, axis=-1)] * side
        outside = np.maximum(beyond, 0.0) * side
        return np.where((beyond.max(-1) > 0)[..., None], unit_vectors(outside, np.array([0.0, 0.0, 1.0])), nearest)


def distance_of_numbers(body: Obstacle, x: Any, y: Any, z: Any, refusal: str) -> Array:
    """The `distance` of a body that has no formula for it; raises InputError with the `refusal` for symbols."""
    if not all(isinstance(value, (int, float, np.ndarray)) for value in (x, y, z)):
        raise InputError(refusal)
    return body.signed_distance(np.stack(np.broadcast_arrays(x, y, z), axis=-1).astype(float))


@typed
def nearest_distance(obstacles: Sequence[Obstacle], points: ArrayLike) -> Array:
    """(...) distance of points (..., 3) to the nearest of `obstacles`, m; infinite without any."""
    array = as_points(points)
    return scene_of(obstacles).nearest(array.reshape(-1, 3)).reshape(array.shape[:-1])
