"""Obstacles: bodies with a signed distance, positive outside, to keep an arm away from; many of them as one `Scene`.

Every body says its distance three ways: `signed_distance` of NumPy points, exact; `gradient`, the unit vector away from
it; and `distance`, written with arithmetic alone, so that the same formula takes numbers, arrays and symbols of an
optimal control problem. There a kink (the edges of a box, the centre of a sphere) is rounded off within `SMOOTH`.

A scene finds the nearest of many bodies with trees of their centres. A body that has `balls` (what covers it) and
`numbers` (a row of a table from which its kind computes distances, many at a time) is asked for its distance only from
points that it may be the nearest to. One that has `distance_within` only says what is less than that. Any other says
its distance from all points.
"""

from __future__ import annotations

import reprlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import chain
from typing import Annotated, Any, ClassVar, Protocol

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..arguments import typed
from ..display import Displayed
from ..errors import InputError, positive, triple
from ..files.field_metadata import POSITIVE, Typical, check_usual, unit
from ..typing import Array, Index

# Bodies of a kind that are all asked at once: up to so many that takes less than half as long as trees do.
BRUTE_FORCE_LIMIT = 16

# Balls in one tree differ in radius by no more than this factor: a tree is asked within the largest radius, and small
# balls would be found in vain.
SIZES = 2.0

# Points at once: bounds the memory.
CHUNK = 16384


@dataclass(frozen=True, eq=False)
class Layer:
    """Balls of similar size: their tree, the body that each is of, their radii and the largest of these."""

    tree: Any
    owner: Any
    radius: Array
    largest: float


@dataclass(frozen=True, eq=False)
class ObstacleGroup:
    """The bodies of one kind, at least one, and their numbers in the scene."""

    bodies: tuple[Any, ...]
    members: Index

    @property
    def kind(self) -> Any:
        """That tells distances from rows of `table`."""
        return type(self.bodies[0])

    @cached_property
    def table(self) -> Array:
        """(b, k) a row for each body."""
        return np.array([body.numbers() for body in self.bodies])

    @cached_property
    def layers(self) -> tuple[Layer, ...]:
        """The balls that cover the bodies."""
        parts = [body.balls() for body in self.bodies]
        owner = np.repeat(np.arange(len(parts)), [len(radius) for _, radius in parts])
        centre, radius = np.concatenate([c for c, _ in parts]), np.concatenate([r for _, r in parts])
        size = np.floor(np.log(radius / radius.min()) / np.log(SIZES)).astype(int)
        alike = [size == each for each in np.unique(size)]
        return tuple(
            Layer(scipy.spatial.cKDTree(centre[mine]), owner[mine], radius[mine], float(radius[mine].max()))
            for mine in alike
        )

    def nearest(self, points: Array, least: Array) -> Array:
        """(N,) distance of points (N, 3) from the nearest body where it is less than `least` (N,), else `least`."""
        if len(self.bodies) <= BRUTE_FORCE_LIMIT:
            return np.asarray(np.minimum(least, self.kind.distances(points, self.table[:, None]).min(0)))
        out = least.copy()
        for layer in self.layers:
            reach = np.maximum(out + layer.largest, 0.0)
            far, first = layer.tree.query(points, distance_upper_bound=reach.max(initial=0.0) * (1 + 1e-9) + 1e-300)
            rows = np.flatnonzero(np.isfinite(far) & (far - layer.largest < out))
            self._ask(layer, out, points, rows, first[rows])
            # The ball with the nearest centre may be a small one, and need not be filled to its rim.
            rows = rows[far[rows] < out[rows] + layer.largest]
            if len(rows) and not self._told(layer):
                found = layer.tree.query_ball_point(points[rows], out[rows] + layer.largest)
                count = [len(each) for each in found]
                self._ask(layer, out, points, np.repeat(rows, count), np.concatenate(found).astype(int))
        return out

    def pairs(self, points: Array, reach: Array) -> list[tuple[Index, Index]]:
        """Numbers of all bodies, and maybe of others, that come closer than `reach` (N,) to points (N, 3), and rows of
        these points."""
        if len(self.bodies) <= BRUTE_FORCE_LIMIT:
            body, row = np.nonzero(self.kind.distances(points, self.table[:, None]) < reach)
            return [(self.members[body], row)]
        found = []
        for layer in self.layers:
            near = layer.tree.query_ball_point(points, np.maximum(reach + layer.largest, 0.0), return_sorted=False)
            row = np.repeat(np.arange(len(points)), [len(each) for each in near])
            body = layer.owner[np.fromiter(chain.from_iterable(near), int, len(row))]
            found.append((self.members[body], row))
        return found

    def _told(self, layer: Layer) -> bool:
        """Whether the nearest centre is that of the nearest body: all of them are balls of one size."""
        return bool(getattr(self.kind, "ROUND", False)) and float(layer.radius.min()) == layer.largest

    def _ask(self, layer: Layer, out: Array, points: Array, rows: Any, balls: Any) -> None:
        """Lower `out` at rows of points to their distances from the bodies of balls."""
        np.minimum.at(out, rows, self.kind.distances(points[rows], self.table[layer.owner[balls]]))


@dataclass(frozen=True, eq=False)
class Scene:
    """Bodies with signed distances, as one; `bodies` may be named by their numbers, from 0."""

    bodies: tuple[Any, ...]

    def pairs(self, points: Array, reach: float | Array) -> tuple[Index, Index]:
        """Numbers of bodies and rows of points (N, 3): all bodies, and maybe others, that come closer to a point than
        `reach`, one number or (N,)."""
        crowds, rest = self._parts
        most = np.broadcast_to(reach, len(points))
        near = [np.flatnonzero(_within(self.bodies[k], points, most) < most) for k in rest]
        found = [(np.full(len(rows), k), rows) for k, rows in zip(rest, near, strict=True)]
        for crowd in crowds:
            found += crowd.pairs(points, most)
        none = np.zeros(0, dtype=int)
        return np.concatenate([none, *(body for body, _ in found)]), np.concatenate([none, *(row for _, row in found)])

    def close(self, points: Array, reach: float | Array) -> list[int]:
        """Numbers of all bodies, and maybe of others, that come closer than `reach`, one number or (N,), to points
        (N, 3)."""
        found: list[int] = np.unique(self.pairs(points, reach)[0]).tolist()
        return found

    def distances(self, chosen: Sequence[int] | Index, points: Array) -> Array:
        """(b, N) signed distances of points (N, 3) from some bodies, m."""
        chosen = np.asarray(chosen, dtype=int)
        out = np.empty((len(chosen), len(points)))
        for asked, rows, numbers in self._by_kind(chosen):
            out[rows] = asked.signed_distance(points) if numbers is None else asked.distances(points, numbers[:, None])
        return out

    def gradient(self, points: Array) -> Array:
        """(N, 3) unit vectors along which the distance of points (N, 3) from the nearest body grows."""
        return self.gradients(self.distances(range(len(self.bodies)), points).argmin(0), points)

    def pair_distances(self, chosen: Index, points: Array, within: Array) -> Array:
        """(c,) signed distance of each of points (c, 3) from its own body of `chosen` (c,), m, where it is less than
        `within` (c,), else no less than that."""
        out = np.empty(len(chosen))
        for asked, rows, numbers in self._by_kind(chosen):
            if numbers is None:
                out[rows] = _within(asked, points[rows], within[rows])
            else:
                out[rows] = asked.distances(points[rows], numbers)
        return out

    def gradients(self, chosen: Sequence[int] | Index, points: Array) -> Array:
        """(c, 3) unit vectors along which the distance of each of points (c, 3) from its own body of `chosen` (c,)
        grows."""
        chosen = np.asarray(chosen, dtype=int)
        out = np.empty((len(chosen), 3))
        for asked, rows, numbers in self._by_kind(chosen):
            out[rows] = asked.gradient(points[rows]) if numbers is None else asked.gradients(points[rows], numbers)
        return out

    def _by_kind(self, chosen: Index) -> Iterator[tuple[Any, Index, Array | None]]:
        """Kinds with a table, the rows of `chosen` whose bodies are of each, and their rows of the table; and bodies
        without, each with its own rows of `chosen` and None."""
        crowds, rest = self._parts
        crowd, place = self._places
        for c in np.unique(crowd[chosen]).tolist():
            rows = np.flatnonzero(crowd[chosen] == c)
            if c < len(crowds):
                yield crowds[c].kind, rows, crowds[c].table[place[chosen[rows]]]
            else:
                yield self.bodies[rest[c - len(crowds)]], rows, None

    @cached_property
    def _places(self) -> tuple[Index, Index]:
        """Of every body which crowd it is in, those in none behind the last, and the how many-th there."""
        crowds, rest = self._parts
        crowd, place = np.zeros((2, len(self.bodies)), dtype=int)
        crowd[rest] = len(crowds) + np.arange(len(rest))
        for c, each in enumerate(crowds):
            crowd[each.members], place[each.members] = c, np.arange(len(each.members))
        return crowd, place

    @cached_property
    def _parts(self) -> tuple[list[ObstacleGroup], list[int]]:
        """Crowds, and the numbers of all bodies that are in none."""
        kinds: dict[type, list[int]] = {}
        rest = []
        for k, body in enumerate(self.bodies):
            if hasattr(body, "balls") and hasattr(body, "numbers"):
                kinds.setdefault(type(body), []).append(k)
            else:
                rest.append(k)
        return [ObstacleGroup(tuple(self.bodies[k] for k in same), np.array(same)) for same in kinds.values()], rest

    @cached_property
    def solid(self) -> bool:
        """Whether all distances are those of bodies, not bounds of them."""
        return all(getattr(body, "SOLID", False) for body in self.bodies)

    @cached_property
    def stands_for(self) -> tuple[str, ...]:
        """What distances are from, in words, of all bodies that are no solids but points or open surfaces."""
        found = (getattr(body, "stands_for", "") for body in self.bodies)
        return tuple(dict.fromkeys(filter(None, found)))

    def at_most(self, points: Array) -> Array:
        """(N,) what the distance of points (N, 3) from the nearest body is not above, as far as it is told at once."""
        told = [body.at_most(points) for body in self._telling]
        return np.min(told, axis=0) if told else np.full(len(points), np.inf)

    @cached_property
    def _telling(self) -> list[Any]:
        return [body for body in self.bodies if hasattr(body, "at_most")]

    def nearest(self, points: Array, within: float | Array = np.inf) -> Array:
        """(N,) signed distance of points (N, 3) from the nearest body, m; `within`, one number or (N,), where it is
        more than that."""
        most = np.broadcast_to(within, len(points))
        chunks = (slice(k, k + CHUNK) for k in range(0, len(points), CHUNK))
        return np.concatenate([np.zeros(0), *(self._chunk(points[some], most[some]) for some in chunks)])

    def _chunk(self, points: Array, within: Array) -> Array:
        crowds, rest = self._parts
        out = within.copy()
        for k in rest:
            out = np.minimum(out, _within(self.bodies[k], points, out))
        for crowd in crowds:
            out = crowd.nearest(points, out)
        return out


# Distance (m) that a lookout sees farther than it must: it then serves several steps of a motion.
AHEAD = 10e-3


class Lookout:
    """Tells whether bodies are far from points that move little from call to call, mostly without looking: a distance
    changes by no more than its point moves. What it cannot tell, it looks for."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._points, self._least = np.zeros((0, 3)), np.zeros(0)

    def far(self, points: Array, reach: Array) -> bool:
        """Whether all bodies are farther than `reach` (N,) from points (N, 3), m."""
        if len(points) == len(self._points):
            way = points - self._points
            moved, spare = np.sqrt((way * way).sum(1)), self._least - reach
            if (spare > moved).all():
                return True
            if (spare <= -moved).any():
                return False
        self._points, self._least = points, self.scene.nearest(points, reach + AHEAD)
        return bool((self._least > reach).all())


def _within(body: Any, points: Array, least: Array) -> Array:
    """(N,) distance of points (N, 3) from a body where it is less than `least` (N,), else no less than it."""
    if hasattr(body, "distance_within"):
        return np.asarray(body.distance_within(points, least))
    return np.asarray(body.signed_distance(points))


class Same:
    """Bodies as a key: the same ones, not equal ones, which a mesh would take long to compare."""

    def __init__(self, bodies: Sequence[Any]) -> None:
        self.bodies = tuple(bodies)
        self._identity = tuple(map(id, self.bodies))

    def __hash__(self) -> int:
        return hash(self._identity)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and self._identity == other._identity


@lru_cache(maxsize=8)
def _scene(key: Same) -> Scene:
    return Scene(key.bodies)


def scene_of(bodies: Sequence[Any]) -> Scene:
    """The scene of bodies, its trees built once for the same bodies."""
    return _scene(Same(bodies))


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
