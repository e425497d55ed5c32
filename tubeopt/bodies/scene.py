"""Many bodies as one: the distance of many points from the nearest, looked for with trees of their centres.

A body that has `balls` (what covers it) and `numbers` (a row of a table from which its kind tells distances, many at a
time) is asked for its distance only from points that it may be the nearest to; one that has `distance_within` only says
what is less than that; any other says its distance from all points.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import chain
from typing import Any

import numpy as np
import scipy

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
