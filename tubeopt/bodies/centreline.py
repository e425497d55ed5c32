"""The centreline of a way through an anatomy, and how wide it is there, from a distance field alone.

Among all ways between two places over the nodes of the lattice the one is taken whose length counts the more the closer
it comes to the wall: int ds / d^2, by Dijkstra's method, as in fast marching (Deschamps and Cohen 2001).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..display import Displayed
from ..errors import InputError, SolveError, positive, vector
from ..typing import Array, Index, Mask
from .corridors import Corridor
from .distance_field import DistanceField

# Nodes that are searched at most, in a few seconds by Dijkstra's method; otherwise every second, third, ... along
# each axis.
MOST = 400_000

# Power of the distance from the wall that divides a step. With 1 a path cuts corners; larger ones prefer wide
# detours.
POWER = 2


@dataclass(frozen=True, eq=False)
class Centreline(Displayed):
    """A line (K, 3) through a way, and what the distance from its wall is at least there, (K,), m."""

    points: Array
    """(K, 3) of the line, m."""
    radius: Array
    """(K,) that a ball around each point has at least, m."""

    @property
    def arc_length(self) -> Array:
        """(K,) m."""
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.points, axis=0), axis=1))])

    @property
    def corridor(self) -> Corridor:
        """The corridor around it that lies within the way all along.

        Between two points, h apart, the distance from the wall is not less than either end's less how far that is; a
        radius that goes linearly from one to the other exceeds this by (h^2 - change^2) / 2h at most, which is taken
        off.

        Raises:
            InputError: the way is no wider than that.
        """
        h = np.maximum(np.linalg.norm(np.diff(self.points, axis=0), axis=1), 1e-12)
        excess = np.maximum(h**2 - np.diff(self.radius) ** 2, 0.0) / (2 * h)
        radii = self.radius - np.maximum(np.append(excess, 0.0), np.insert(excess, 0, 0.0))
        return Corridor(tuple(map(tuple, self.points.tolist())), tuple(radii.tolist()))


def centreline(field: DistanceField, start: ArrayLike, end: ArrayLike, *, spacing: float = 1e-3) -> Centreline:
    """Centreline of a lumen from `start` to `end` (3,), m, in steps of about `spacing`, m.

    Raises:
        InputError: an end that is not free.
        SolveError: no free path connects them.
    """
    ends = np.stack([vector(name, place, 3, "x, y, z") for name, place in (("start", start), ("end", end))])
    positive("spacing", spacing)
    room = field.signed_distance(ends)
    for name, left in zip(("start", "end"), room.tolist(), strict=True):
        if left <= 0:
            raise InputError(f"{name} of the centreline lies {-left * 1e3:.3g} mm in the wall; it must be free")
    step = max(1, int(np.ceil((field.values.size / MOST) ** (1 / 3))))
    values = field.values[::step, ::step, ::step].astype(float)
    free = values > 0
    number = np.cumsum(free).reshape(free.shape) - 1
    nodes = field.frame.placed(np.argwhere(free) * step * field.spacing)
    graph = _steps(free, number, np.maximum(values[free], 1e-6), field.spacing * step)
    first, last = (int(np.argmin(np.linalg.norm(nodes - each, axis=1))) for each in ends)
    cost, before = scipy.sparse.csgraph.dijkstra(graph, directed=False, indices=first, return_predecessors=True)
    if not np.isfinite(cost[last]):
        raise SolveError("no free path connects the start of the centreline to its end")
    way = [last]
    while way[-1] != first:
        way.append(int(before[way[-1]]))
    return _smooth(field, np.concatenate([ends[:1], nodes[way[::-1]], ends[1:]]), spacing)


def _steps(free: Mask, number: Index, room: Array, spacing: Array) -> scipy.sparse.csr_array:
    """The cost of steps between free nodes and their 26 neighbours."""
    rows, columns, costs = [], [], []
    for offset in np.ndindex(3, 3, 3):
        shift = np.array(offset) - 1
        if tuple(shift) <= (0, 0, 0):  # one of either direction
            continue
        here, there = [], []
        for size, k in zip(free.shape, shift.tolist(), strict=True):
            here.append(slice(max(0, -k), size - max(0, k)))
            there.append(slice(max(0, k), size - max(0, -k)))
        both = free[tuple(here)] & free[tuple(there)]
        a, b = number[tuple(here)][both], number[tuple(there)][both]
        rows.append(a)
        columns.append(b)
        costs.append(np.linalg.norm(shift * spacing) * (room[a] ** -POWER + room[b] ** -POWER) / 2)
    shape = (len(room), len(room))
    return scipy.sparse.csr_array((np.concatenate(costs), (np.concatenate(rows), np.concatenate(columns))), shape=shape)


def _smooth(field: DistanceField, points: Array, spacing: float) -> Centreline:
    """A way over nodes as a smooth line of even steps."""
    for _ in range(4):
        inner = (points[:-2] + 2 * points[1:-1] + points[2:]) / 4
        points = np.concatenate([points[:1], inner, points[-1:]])
    mark = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0, mark[-1], max(2, int(np.ceil(mark[-1] / spacing)) + 1))
    line = np.column_stack([np.interp(at, mark, column) for column in points.T])
    return Centreline(line, field.signed_distance(line))
