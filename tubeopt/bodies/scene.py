"""Many bodies as one: the distance of many points from the nearest, looked for with trees of their centres.

A body that has `balls` (what covers it) and `numbers` (a row of a table from which its kind tells distances, many at a
time) is asked for its distance only from points that it may be the nearest to; one that has `distance_within` only says
what is less than that; any other says its distance from all points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import scipy

from ..typing import Array

FEW = 4
"""Bodies of a kind that are asked one by one."""

SIZES = 2.0
"""Balls in one tree differ in radius by no more than this factor, so that few of them are asked in vain."""

CHUNK = 16384
"""Points at once: bounds the memory."""


@dataclass(frozen=True, eq=False)
class Layer:
    """Balls of similar size: their tree, the body that each is of, their radii and the largest of these."""

    tree: Any
    owner: Any
    radius: Array
    largest: float


@dataclass(frozen=True, eq=False)
class Crowd:
    """Many bodies of one kind."""

    bodies: tuple[Any, ...]
    kind: Any
    table: Array
    layers: tuple[Layer, ...]

    @staticmethod
    def of(bodies: Sequence[Any]) -> Crowd:
        """Bodies of one kind, at least one."""
        parts = [body.balls() for body in bodies]
        owner = np.repeat(np.arange(len(parts)), [len(radius) for _, radius in parts])
        centre, radius = np.concatenate([c for c, _ in parts]), np.concatenate([r for _, r in parts])
        size = np.floor(np.log(radius / radius.min()) / np.log(SIZES)).astype(int)
        layers = []
        for each in np.unique(size):
            mine = size == each
            layers.append(
                Layer(scipy.spatial.cKDTree(centre[mine]), owner[mine], radius[mine], float(radius[mine].max()))
            )
        return Crowd(tuple(bodies), type(bodies[0]), np.array([body.numbers() for body in bodies]), tuple(layers))

    def nearest(self, points: Array, least: Array) -> Array:
        """(N,) distance of points (N, 3) from the nearest body where it is less than `least` (N,), else `least`."""
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

    def close(self, points: Array, reach: float) -> set[int]:
        """Numbers of all bodies, and maybe of others, that come closer than `reach` to some of points (N, 3)."""
        found: set[int] = set()
        for layer in self.layers:
            near = layer.tree.query_ball_point(points, reach + layer.largest)
            found.update(layer.owner[np.unique(np.concatenate(near).astype(int))].tolist())
        return found

    def _told(self, layer: Layer) -> bool:
        """Whether the nearest centre is that of the nearest body: all of them are balls of one size."""
        return bool(getattr(self.kind, "ROUND", False)) and float(layer.radius.min()) == layer.largest

    def _ask(self, layer: Layer, out: Array, points: Array, rows: Any, balls: Any) -> None:
        """Lower `out` at rows of points to their distances from the bodies of balls."""
        np.minimum.at(out, rows, self.kind.distances(points[rows], self.table[layer.owner[balls]]))


@dataclass(frozen=True, eq=False)
class Scene:
    """Bodies with signed distances, as one."""

    bodies: tuple[Any, ...]

    def close(self, points: Array, reach: float) -> tuple[Any, ...]:
        """All bodies, and maybe others, that come closer than `reach` to some of points (N, 3)."""
        crowds, rest = self._parts
        known = {id(body) for body in rest if (body.signed_distance(points) < reach).any()}
        for crowd in crowds:
            known |= {id(crowd.bodies[k]) for k in crowd.close(points, reach)}
        return tuple(body for body in self.bodies if id(body) in known)

    @cached_property
    def _parts(self) -> tuple[list[Crowd], list[Any]]:
        kinds: dict[type, list[Any]] = {}
        rest = []
        for body in self.bodies:
            if hasattr(body, "balls") and hasattr(body, "numbers"):
                kinds.setdefault(type(body), []).append(body)
            else:
                rest.append(body)
        crowds = []
        for same in kinds.values():
            if len(same) > FEW:
                crowds.append(Crowd.of(same))
            else:
                rest += same
        return crowds, rest

    def nearest(self, points: Array, within: float = np.inf) -> Array:
        """(N,) signed distance of points (N, 3) from the nearest body, m; `within` where it is more than that."""
        return np.concatenate(
            [np.zeros(0), *(self._chunk(points[k : k + CHUNK], within) for k in range(0, len(points), CHUNK))]
        )

    def _chunk(self, points: Array, within: float) -> Array:
        crowds, rest = self._parts
        out = np.full(len(points), within)
        for body in rest:
            if hasattr(body, "distance_within"):
                out = np.minimum(out, body.distance_within(points, out))
            else:
                out = np.minimum(out, body.signed_distance(points))
        for crowd in crowds:
            out = crowd.nearest(points, out)
        return out


class _Same:
    """Bodies as a key: the same ones, not equal ones, which a mesh would take long to compare."""

    def __init__(self, bodies: Sequence[Any]) -> None:
        self.bodies = tuple(bodies)
        self._identity = tuple(map(id, self.bodies))

    def __hash__(self) -> int:
        return hash(self._identity)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self._identity == other._identity


@lru_cache(maxsize=8)
def _scene(key: _Same) -> Scene:
    return Scene(key.bodies)


def scene_of(bodies: Sequence[Any]) -> Scene:
    """The scene of bodies, its trees built once for the same bodies."""
    return _scene(_Same(bodies))
