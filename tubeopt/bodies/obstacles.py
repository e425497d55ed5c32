"""Obstacles: bodies with a signed distance, positive outside, and a `Scene` of many of them.

Every body has its distance in three forms: `signed_distance` of NumPy points, exact; `gradient`, the unit vector away
from it; and `distance`, a formula for numbers, arrays and symbols of an optimal control problem. In the formula, a kink
(the edges of a box, the centre of a sphere) is rounded off within `SMOOTH`.

A scene finds the nearest of many bodies with trees of their centres. A body with `balls` (which cover it) and `numbers`
(its row of a table, from which its class computes many distances at once) is evaluated only at points to which it may
be the nearest. A body with `distance_within` is exact only below a given distance. Other bodies are evaluated at all
points.
"""

from __future__ import annotations

import reprlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import chain
from typing import Annotated, Any, ClassVar, NamedTuple, Protocol

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..arguments import typed
from ..display import Displayed
from ..errors import InputError, positive, triple
from ..files.field_metadata import POSITIVE, Typical, check_typical, unit
from ..typing import Array, Index

# Largest number of bodies of a class without a tree: below it, a table takes less than half the time of a tree.
BRUTE_FORCE_LIMIT = 16

# Largest ratio of radii in one tree: a query uses the largest radius, which returns many small balls in vain.
SIZES = 2.0

# Number of points per chunk, which bounds the memory.
CHUNK = 16384


@dataclass(frozen=True, eq=False)
class Layer:
    """Balls of similar size that cover bodies."""

    tree: Any
    """k-d tree of the centres."""
    owner: Any
    """Number of the body of each ball (k,)."""
    radius: Array
    """Radii (k,), m."""
    largest: float
    """Largest radius, m."""


@dataclass(frozen=True, eq=False)
class ObstacleGroup:
    """Bodies of one class, at least one, with their numbers in the scene."""

    bodies: tuple[Any, ...]
    members: Index

    @property
    def kind(self) -> Any:
        """Class of the bodies, which computes distances from rows of `table`."""
        return type(self.bodies[0])

    @cached_property
    def table(self) -> Array:
        """Table of the bodies' numbers, shape (b, k)."""
        return np.array([body.numbers() for body in self.bodies])

    @cached_property
    def layers(self) -> tuple[Layer, ...]:
        """Balls that cover the bodies, in layers of similar size."""
        parts = [body.balls() for body in self.bodies]
        owner = np.repeat(np.arange(len(parts)), [len(radius) for _, radius in parts])
        centre, radius = np.concatenate([c for c, _ in parts]), np.concatenate([r for _, r in parts])
        size = np.floor(np.log(radius / radius.min()) / np.log(SIZES)).astype(int)
        similar = [size == each for each in np.unique(size)]
        return tuple(
            Layer(scipy.spatial.cKDTree(centre[mask]), owner[mask], radius[mask], float(radius[mask].max()))
            for mask in similar
        )

    def nearest(self, points: Array, within: Array) -> Array:
        """Distances (N,) of points (N, 3) from the nearest body, m, or `within` (N,) if that is smaller."""
        if len(self.bodies) <= BRUTE_FORCE_LIMIT:
            return np.asarray(np.minimum(within, self.kind.distances(points, self.table[:, None]).min(0)))
        out = within.copy()

        def _lower(layer: Layer, rows: Any, balls: Any) -> None:
            np.minimum.at(out, rows, self.kind.distances(points[rows], self.table[layer.owner[balls]]))

        for layer in self.layers:
            reach = np.maximum(out + layer.largest, 0.0)
            far, first = layer.tree.query(points, distance_upper_bound=reach.max(initial=0.0) * (1 + 1e-9) + 1e-300)
            rows = np.flatnonzero(np.isfinite(far) & (far - layer.largest < out))
            _lower(layer, rows, first[rows])
            # Of spheres of one size, the nearest centre is that of the nearest body. Otherwise the ball with the
            # nearest centre may be a small one, and a body need not fill its balls.
            if getattr(self.kind, "ROUND", False) and float(layer.radius.min()) == layer.largest:
                continue
            rows = rows[far[rows] < out[rows] + layer.largest]
            if len(rows):
                near = layer.tree.query_ball_point(points[rows], out[rows] + layer.largest)
                _lower(layer, np.repeat(rows, [len(balls) for balls in near]), np.concatenate(near).astype(int))
        return out

    def pairs(self, points: Array, reach: Array) -> list[tuple[Index, Index]]:
        """Pairs of bodies and rows of points (N, 3) that are closer than `reach` (N,), and maybe others."""
        if len(self.bodies) <= BRUTE_FORCE_LIMIT:
            body, row = np.nonzero(self.kind.distances(points, self.table[:, None]) < reach)
            return [(self.members[body], row)]
        pairs = []
        for layer in self.layers:
            near = layer.tree.query_ball_point(points, np.maximum(reach + layer.largest, 0.0), return_sorted=False)
            row = np.repeat(np.arange(len(points)), [len(balls) for balls in near])
            body = layer.owner[np.fromiter(chain.from_iterable(near), int, len(row))]
            pairs.append((self.members[body], row))
        return pairs


class BodyRows(NamedTuple):
    """Bodies that are evaluated together."""

    body: Any
    """Class with `distances` and `gradients` of table rows, or a single body."""
    rows: Index
    """Rows of the request."""
    numbers: Array | None
    """Rows of the table; None for a single body."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Union of bodies with signed distances; bodies are numbered from 0."""

    bodies: tuple[Any, ...]

    def pairs(self, points: Array, reach: float | Array) -> tuple[Index, Index]:
        """Indices of bodies and of points (N, 3) closer than `reach`, one number or (N,); possibly with others.

        No pair within the distance is missing.
        """
        groups, single = self._parts
        limit = np.broadcast_to(reach, len(points))
        near = [np.flatnonzero(_distance_within(self.bodies[k], points, limit) < limit) for k in single]
        pairs = [(np.full(len(rows), k), rows) for k, rows in zip(single, near, strict=True)]
        for group in groups:
            pairs += group.pairs(points, limit)
        none = np.zeros(0, dtype=int)
        return np.concatenate([none, *(body for body, _ in pairs)]), np.concatenate([none, *(row for _, row in pairs)])

    def close(self, points: Array, reach: float | Array) -> list[int]:
        """Indices of all bodies closer to points (N, 3) than `reach`, a number or (N,), and possibly of others."""
        numbers: list[int] = np.unique(self.pairs(points, reach)[0]).tolist()
        return numbers

    def distances(self, chosen: Sequence[int] | Index, points: Array) -> Array:
        """Signed distances (b, N) of points (N, 3) from chosen bodies, m."""
        chosen = np.asarray(chosen, dtype=int)
        out = np.empty((len(chosen), len(points)))
        for body, rows, numbers in self._by_kind(chosen):
            out[rows] = body.signed_distance(points) if numbers is None else body.distances(points, numbers[:, None])
        return out

    def gradient(self, points: Array) -> Array:
        """Gradients (N, 3) of the distance of points (N, 3) from the nearest body."""
        return self.gradients(self.distances(range(len(self.bodies)), points).argmin(0), points)

    def pair_distances(self, chosen: Index, points: Array, within: Array) -> Array:
        """Signed distance (c,) of each point (c, 3) from its body of `chosen` (c,), m; exact below `within` (c,).

        Larger distances are replaced by a value of at least `within`.
        """
        out = np.empty(len(chosen))
        for body, rows, numbers in self._by_kind(chosen):
            if numbers is None:
                out[rows] = _distance_within(body, points[rows], within[rows])
            else:
                out[rows] = body.distances(points[rows], numbers)
        return out

    def gradients(self, chosen: Sequence[int] | Index, points: Array) -> Array:
        """Gradients (c, 3) of the distance of each point (c, 3) from its body of `chosen` (c,)."""
        chosen = np.asarray(chosen, dtype=int)
        out = np.empty((len(chosen), 3))
        for body, rows, numbers in self._by_kind(chosen):
            out[rows] = body.gradient(points[rows]) if numbers is None else body.gradients(points[rows], numbers)
        return out

    def _by_kind(self, chosen: Index) -> Iterator[BodyRows]:
        """Rows of `chosen` grouped by the class of their bodies, or by body if it belongs to no group."""
        groups, single = self._parts
        group, member = self._membership
        for g in np.unique(group[chosen]).tolist():
            rows = np.flatnonzero(group[chosen] == g)
            if g < len(groups):
                yield BodyRows(groups[g].kind, rows, groups[g].table[member[chosen[rows]]])
            else:
                yield BodyRows(self.bodies[single[g - len(groups)]], rows, None)

    @cached_property
    def _membership(self) -> tuple[Index, Index]:
        """Number of the group of every body, and the body's number in it; single bodies follow the last group."""
        groups, single = self._parts
        group, member = np.zeros((2, len(self.bodies)), dtype=int)
        group[single] = len(groups) + np.arange(len(single))
        for g, each in enumerate(groups):
            group[each.members], member[each.members] = g, np.arange(len(each.members))
        return group, member

    @cached_property
    def _parts(self) -> tuple[list[ObstacleGroup], list[int]]:
        """Groups, and the numbers of all bodies without a group."""
        kinds: dict[type, list[int]] = {}
        single = []
        for k, body in enumerate(self.bodies):
            if hasattr(body, "balls") and hasattr(body, "numbers"):
                kinds.setdefault(type(body), []).append(k)
            else:
                single.append(k)
        return [ObstacleGroup(tuple(self.bodies[k] for k in same), np.array(same)) for same in kinds.values()], single

    @cached_property
    def solid(self) -> bool:
        """True if all distances outside of bodies are exact, and no bounds."""
        return all(getattr(body, "SOLID", False) for body in self.bodies)

    @cached_property
    def stands_for(self) -> tuple[str, ...]:
        """Texts that say from what distances are measured, for points and open surfaces; empty for solids."""
        texts = (getattr(body, "stands_for", "") for body in self.bodies)
        return tuple(dict.fromkeys(filter(None, texts)))

    def at_most(self, points: Array) -> Array:
        """Upper bounds (N,) of the distance of points (N, 3) from the nearest body, m; inf without a fast bound."""
        bounds = [body.at_most(points) for body in self._bounded]
        return np.min(bounds, axis=0) if bounds else np.full(len(points), np.inf)

    @cached_property
    def _bounded(self) -> list[Any]:
        return [body for body in self.bodies if hasattr(body, "at_most")]

    def nearest(self, points: Array, within: float | Array = np.inf) -> Array:
        """Signed distances (N,) of points (N, 3) from the nearest body, m, cut at `within`, one number or (N,)."""
        limit = np.broadcast_to(within, len(points))
        groups, single = self._parts
        parts = [np.zeros(0)]
        for first in range(0, len(points), CHUNK):
            chunk = points[first : first + CHUNK]
            out = limit[first : first + CHUNK].copy()
            for k in single:
                out = np.minimum(out, _distance_within(self.bodies[k], chunk, out))
            for group in groups:
                out = group.nearest(chunk, out)
            parts.append(out)
        return np.concatenate(parts)


# Extra distance (m) of a search: its result then serves several steps of a motion.
AHEAD = 10e-3


class ClearanceMonitor:
    """Fast test of the clearance of points that move little from call to call.

    A distance changes by no more than its point moves, so that most calls need no search.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._points, self._clearance = np.zeros((0, 3)), np.zeros(0)

    def far(self, points: Array, reach: Array) -> bool:
        """True if all bodies are farther than `reach` (N,) from points (N, 3), m."""
        if len(points) == len(self._points):
            step = points - self._points
            moved, margin = np.sqrt((step * step).sum(1)), self._clearance - reach
            if (margin > moved).all():
                return True
            if (margin <= -moved).any():
                return False
        self._points, self._clearance = points, self.scene.nearest(points, reach + AHEAD)
        return bool((self._clearance > reach).all())


def _distance_within(body: Any, points: Array, within: Array) -> Array:
    """Distances (N,) of points (N, 3) from a body, exact below `within` (N,), otherwise at least that."""
    if hasattr(body, "distance_within"):
        return np.asarray(body.distance_within(points, within))
    return np.asarray(body.signed_distance(points))


class Same:
    """Cache key of bodies by identity: equality of meshes would take long to compute."""

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
    """Scene of bodies, cached with its trees."""
    return _scene(Same(bodies))


# Length (m) within which kinks of `distance` are rounded off, so that second derivatives exist for IPOPT. The error of
# a distance is a few times this length.
SMOOTH = 1e-7

# Largest number of balls that cover a long body: more balls are tighter, but each costs a query.
MAX_BALLS = 16

Point3 = tuple[float, float, float]

# Typical positions and radii of bodies, m.
AWAY, THICK = Typical(1e-6, 10.0), Typical(1e-5, 2.0)

Balls = tuple[Array, Array]
"""Centres (k, 3) and radii (k,) of balls that cover a body; m."""


class Obstacle(Protocol):
    """Body with a signed distance; hashable, so that its trees and programs can be cached."""

    def distance(self, x: Any, y: Any, z: Any) -> Any:
        """Smooth signed distance, m; coordinates may be numbers, arrays or symbols."""

    def signed_distance(self, points: ArrayLike) -> Array:
        """Exact signed distances (...) of points (..., 3), m; negative inside."""

    def gradient(self, points: ArrayLike) -> Array:
        """Gradients (..., 3) of the distance at points (..., 3), unit vectors."""

    def __hash__(self) -> int: ...


def checked_obstacles(obstacles: Any) -> tuple[Obstacle, ...]:
    """Convert obstacles to a tuple; raises InputError unless they are a sequence of bodies."""
    try:
        bodies = tuple(obstacles)
    except TypeError:
        raise InputError(f"obstacles is {obstacles!r}; it must be a sequence of bodies, as [Sphere(...)]") from None
    for k, body in enumerate(bodies):
        if isinstance(body, type) or not hasattr(body, "signed_distance"):
            raise InputError(f"obstacle {k + 1} is {body!r}; it must be a body of tubeopt.bodies")
    return bodies


def root(square: Any) -> Any:
    """Square root, smooth at 0."""
    return (square + SMOOTH**2) ** 0.5


def greater(a: Any, b: Any) -> Any:
    """Maximum of two values, smooth where they are equal."""
    return (a + b + root((a - b) ** 2)) / 2


def unit_vectors(vectors: Array, otherwise: Array) -> Array:
    """Normalise vectors (..., 3); a vector of length 0 becomes `otherwise` (3,)."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 0, vectors / np.where(length > 0, length, 1.0), otherwise)


def as_points(points: ArrayLike) -> Array:
    """Convert points to an array (..., 3); raises InputError for another shape."""
    try:
        array = np.asarray(points, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"points is {reprlib.repr(points)}; it must be numbers, the last axis x, y, z") from None
    if array.shape[-1:] != (3,):
        raise InputError(f"points have shape {array.shape}; the last axis must be x, y, z")
    return array


class TabulatedBody(Displayed):
    """Body that is described by numbers, so that many of its class are evaluated at once."""

    SOLID = True
    """True if `signed_distance` is exact outside of the body, and no bound."""

    def numbers(self) -> tuple[float, ...]:
        """Row of the table for `distances` and `gradients`."""
        raise NotImplementedError

    @staticmethod
    def distances(points: Array, numbers: Array) -> Array:
        """Signed distances (...) of points (..., 3) from bodies with `numbers` (..., k), m."""
        raise NotImplementedError

    @staticmethod
    def gradients(points: Array, numbers: Array) -> Array:
        """Gradients (..., 3) of the distances of points (..., 3) from bodies with `numbers` (..., k)."""
        raise NotImplementedError

    def signed_distance(self, points: ArrayLike) -> Array:
        """Signed distances (...) of points (..., 3), m."""
        return self.distances(as_points(points), np.array(self.numbers()))

    def gradient(self, points: ArrayLike) -> Array:
        """Gradients (..., 3) of the distance at points (..., 3), unit vectors."""
        return self.gradients(as_points(points), np.array(self.numbers()))


class Ends(NamedTuple):
    """Balls at both ends of a hull."""

    start: Point3
    """Centre, m."""
    end: Point3
    """Centre, m."""
    start_radius: float
    """Radius, m."""
    end_radius: float
    """Radius, m."""


class TwoBallHull(TabulatedBody):
    """Convex hull of two balls.

    Its distance is the smallest one from the balls between the ends. It is exact outside. Inside, it is the depth in
    the ball in which a point is deepest, which is at most the distance from the surface.
    """

    CALLED: ClassVar[str]
    """Name in messages."""

    def __post_init__(self) -> None:
        for name, value in vars(self).copy().items():
            checked = positive if name.endswith("radius") else triple
            object.__setattr__(self, name, checked(f"{name} of the {self.CALLED}", value))
        check_typical(self, f"the {self.CALLED}")

    def ends(self) -> Ends:
        """Balls at both ends."""
        raise NotImplementedError

    @cached_property
    def _row(self) -> tuple[float, ...]:
        """Start (3), unit axis (3), length, radius at the start, its change per length, and the slope of the surface.

        If one ball contains the other, the row describes it alone.
        """
        start, end, start_radius, end_radius = self.ends()
        axis = np.subtract(end, start)
        length = float(np.linalg.norm(axis))
        change = end_radius - start_radius
        if abs(change) >= length:
            centre = end if change > 0 else start
            return (*centre, 0.0, 0.0, 0.0, 0.0, max(start_radius, end_radius), 0.0, 0.0)
        slope = change / length
        return (*start, *(axis / length).tolist(), length, start_radius, slope, slope / (1 - slope**2) ** 0.5)

    def distance(self, x: Any, y: Any, z: Any) -> Any:
        """Smooth signed distance, m."""
        a, b, c, u, v, w, length, radius, slope, lean = self._row
        x, y, z = x - a, y - b, z - c
        along = x * u + y * v + z * w
        square = (x - along * u) ** 2 + (y - along * v) ** 2 + (z - along * w) ** 2
        t = -greater(-greater(along + root(square) * lean, 0.0), -length) if length else 0.0
        return root(square + (along - t) ** 2) - radius - slope * t

    def balls(self) -> Balls:
        """Balls around pieces of the axis, each at most as long as the body is thick unless that gives too many."""
        start, axis, (length, radius, slope, _) = np.split(np.array(self._row), [3, 6])
        count = int(np.clip(np.ceil(length / (2 * min(radius, radius + slope * length))), 1, MAX_BALLS))
        ends = np.linspace(0.0, length, count + 1)
        middle, largest = (ends[1:] + ends[:-1]) / 2, radius + np.maximum(slope * ends[1:], slope * ends[:-1])
        return start + middle[:, None] * axis, largest + length / (2 * count)

    def numbers(self) -> tuple[float, ...]:
        """Row of the table for the hull: start (3), axis (3), length, radius, its change per length, slope."""
        return self._row

    @staticmethod
    def _from_axis(points: Array, numbers: Array) -> tuple[Array, Array]:
        """Vectors (..., 3) to points from the centres of their nearest balls, and the radii (...) of these balls."""
        away, axis, lean = points - numbers[..., :3], numbers[..., 3:6], numbers[..., 9]
        t = (away * axis).sum(-1)
        if lean.any():
            t += np.linalg.norm(away - t[..., None] * axis, axis=-1) * lean
        t = np.clip(t, 0.0, numbers[..., 6])
        return away - t[..., None] * axis, numbers[..., 7] + numbers[..., 8] * t

    @staticmethod
    def distances(points: Array, numbers: Array) -> Array:
        """Signed distances (...) of points (..., 3) from hulls with `numbers` (..., 10), m."""
        away, radius = TwoBallHull._from_axis(points, numbers)
        return np.asarray(np.linalg.norm(away, axis=-1) - radius)

    @staticmethod
    def gradients(points: Array, numbers: Array) -> Array:
        """Gradients (..., 3) of the distances of points (..., 3) from hulls with `numbers` (..., 10)."""
        axis = numbers[..., 3:6]
        normal = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis), axis=-1)])
        away, _ = TwoBallHull._from_axis(points, numbers)
        return unit_vectors(away, unit_vectors(normal, np.array([0.0, 0.0, 1.0])))


@dataclass(frozen=True)
class Sphere(TwoBallHull):
    """Ball.

    Raises:
        InputError: a number that is not finite, a radius that is not greater than 0.
    """

    centre: Annotated[Point3, unit("mm"), AWAY]
    radius: Annotated[float, unit("mm"), POSITIVE, THICK]

    CALLED = "sphere"

    ROUND = True
    """True if the ball that covers the body is the body itself."""

    def ends(self) -> Ends:
        """Two equal balls."""
        return Ends(self.centre, self.centre, self.radius, self.radius)

    @staticmethod
    def distances(points: Array, numbers: Array) -> Array:
        """Signed distances (...) of points (..., 3) from spheres with `numbers` (..., 10), m."""
        return np.asarray(np.linalg.norm(points - numbers[..., :3], axis=-1) - numbers[..., 7])


@dataclass(frozen=True)
class Capsule(TwoBallHull):
    """Points within `radius` of the segment from `start` to `end`.

    Raises:
        InputError: a number that is not finite, a radius that is not greater than 0.
    """

    start: Annotated[Point3, unit("mm"), AWAY]
    end: Annotated[Point3, unit("mm"), AWAY, "end point; equal to the start for a ball"]
    radius: Annotated[float, unit("mm"), POSITIVE, THICK]

    CALLED = "capsule"

    def ends(self) -> Ends:
        """Balls at both ends."""
        return Ends(self.start, self.end, self.radius, self.radius)


@dataclass(frozen=True)
class RoundCone(TwoBallHull):
    """Union of balls whose centres and radii vary linearly between two balls.

    Raises:
        InputError: a number that is not finite, a radius that is not greater than 0.
    """

    start: Point3
    """Centre of the first ball, m."""
    end: Point3
    """Centre of the second ball, m."""
    start_radius: float
    """Radius of the first ball, m."""
    end_radius: float
    """Radius of the second ball, m."""

    CALLED = "cone"

    def ends(self) -> Ends:
        """Balls at both ends."""
        return Ends(self.start, self.end, self.start_radius, self.end_radius)


@dataclass(frozen=True)
class HalfSpace(Displayed):
    """Half-space behind a plane.

    Raises:
        InputError: a number that is not finite, a normal without length.
    """

    point: Annotated[Point3, unit("mm"), AWAY, "any point of the plane"]
    normal: Annotated[Point3, "outward normal, towards the free side; any length"]

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", triple("point of the half-space", self.point))
        check_typical(self, "the half-space")
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
        """Signed distances (...) of points (..., 3), m."""
        return np.asarray((as_points(points) - self.point) @ np.array(self.normal))

    def gradient(self, points: ArrayLike) -> Array:
        """Normal at all points, shape (..., 3)."""
        return np.broadcast_to(np.array(self.normal), as_points(points).shape).copy()


@dataclass(frozen=True)
class Box(TabulatedBody):
    """Cuboid along the axes of the base frame.

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
        check_typical(self, "the box")

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
        """Ball through the corners."""
        low, high = np.array(self.low), np.array(self.high)
        return ((low + high) / 2)[None], np.array([np.linalg.norm(high - low) / 2])

    def numbers(self) -> tuple[float, ...]:
        """Coordinates of both corners (6), m."""
        return (*self.low, *self.high)

    @staticmethod
    def _beyond(points: Array, numbers: Array) -> tuple[Array, Array]:
        """Distances of points beyond the faces along each axis, m, and signs of their sides of the centre."""
        low, high = numbers[..., :3], numbers[..., 3:]
        shifted = points - (low + high) / 2
        return np.abs(shifted) - (high - low) / 2, np.where(shifted < 0, -1.0, 1.0)

    @staticmethod
    def distances(points: Array, numbers: Array) -> Array:
        """Signed distances (...) of points (..., 3) from boxes with `numbers` (..., 6), m."""
        beyond, _ = Box._beyond(points, numbers)
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
        return np.asarray(outside + np.minimum(beyond.max(-1), 0.0))

    @staticmethod
    def gradients(points: Array, numbers: Array) -> Array:
        """Gradients (..., 3) of the distances of points (..., 3) from boxes with `numbers` (..., 6).

        Inside, they point to the nearest face.
        """
        beyond, side = Box._beyond(points, numbers)
        nearest = np.eye(3)[np.argmax(beyond, axis=-1)] * side
        outside = np.maximum(beyond, 0.0) * side
        return np.where((beyond.max(-1) > 0)[..., None], unit_vectors(outside, np.array([0.0, 0.0, 1.0])), nearest)


def distance_of_numbers(body: Obstacle, x: Any, y: Any, z: Any, refusal: str) -> Array:
    """Smooth distance of a body without a formula; raises InputError with the text `refusal` for symbols."""
    if not all(isinstance(value, (int, float, np.ndarray)) for value in (x, y, z)):
        raise InputError(refusal)
    return body.signed_distance(np.stack(np.broadcast_arrays(x, y, z), axis=-1).astype(float))


@typed
def nearest_distance(obstacles: Sequence[Obstacle], points: ArrayLike) -> Array:
    """Signed distances (...) of points (..., 3) from the nearest obstacle, m; infinite without obstacles."""
    array = as_points(points)
    return scene_of(obstacles).nearest(array.reshape(-1, 3)).reshape(array.shape[:-1])
