"""Centreline and radius of a passage in a distance field.

The path between two points over the nodes of the lattice minimises int ds / d^2, with the distance d from the wall, by
Dijkstra's method; as in fast marching (Deschamps and Cohen 2001).
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

# Largest number of nodes, for a few seconds of Dijkstra's method; of a finer lattice every second, third, ... node
# along each axis is used.
MAX_NODES = 400_000

# Power of the distance from the wall that divides a step. With 1 a path cuts corners; larger ones prefer wide
# detours.
POWER = 2


@dataclass(frozen=True, eq=False)
class Centreline(Displayed):
    """Centreline of a passage with lower bounds of its radius."""

    points: Array
    """Points of the line (K, 3), m."""
    radius: Array
    """Lower bounds of the distance from the wall (K,), m."""

    @property
    def arc_length(self) -> Array:
        """Arc length at the points (K,), m."""
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.points, axis=0), axis=1))])

    @property
    def corridor(self) -> Corridor:
        """Corridor around the centreline that lies within the passage.

        The distance from the wall changes by at most the distance between points. Between two points with distance h, a
        linear radius exceeds the resulting bound by at most (h^2 - change^2) / 2h, which is subtracted.

        Raises:
            InputError: the passage is too narrow for this.
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
    ends = np.stack([vector(name, point, 3, "x, y, z") for name, point in (("start", start), ("end", end))])
    positive("spacing", spacing)
    for name, distance in zip(("start", "end"), field.signed_distance(ends).tolist(), strict=True):
        if distance <= 0:
            raise InputError(f"{name} of the centreline lies {-distance * 1e3:.3g} mm in the wall; it must be free")
    step = max(1, int(np.ceil((field.values.size / MAX_NODES) ** (1 / 3))))
    values = field.values[::step, ::step, ::step].astype(float)
    free = values > 0
    number = np.cumsum(free).reshape(free.shape) - 1
    nodes = field.frame.placed(np.argwhere(free) * step * field.spacing)
    graph = _steps(free, number, np.maximum(values[free], 1e-6), field.spacing * step)
    first, last = (int(np.argmin(np.linalg.norm(nodes - point, axis=1))) for point in ends)
    cost, previous = scipy.sparse.csgraph.dijkstra(graph, directed=False, indices=first, return_predecessors=True)
    if not np.isfinite(cost[last]):
        raise SolveError("no free path connects the start of the centreline to its end")
    path = [last]
    while path[-1] != first:
        path.append(int(previous[path[-1]]))
    points = np.concatenate([ends[:1], nodes[path[::-1]], ends[1:]])
    # Four passes of a binomial filter remove the steps of the lattice.
    for _ in range(4):
        inner = (points[:-2] + 2 * points[1:-1] + points[2:]) / 4
        points = np.concatenate([points[:1], inner, points[-1:]])
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    even = np.linspace(0, s[-1], max(2, int(np.ceil(s[-1] / spacing)) + 1))
    line = np.column_stack([np.interp(even, s, column) for column in points.T])
    return Centreline(line, field.signed_distance(line))


def _steps(free: Mask, number: Index, distance: Array, spacing: Array) -> scipy.sparse.csr_array:
    """Costs of the steps between free nodes and their 26 neighbours; `distance` from each node to the wall."""
    rows, columns, costs = [], [], []
    for offset in np.ndindex(3, 3, 3):
        shift = np.array(offset) - 1
        if tuple(shift) <= (0, 0, 0):  # each pair once
            continue
        node, neighbour = [], []
        for size, k in zip(free.shape, shift.tolist(), strict=True):
            node.append(slice(max(0, -k), size - max(0, k)))
            neighbour.append(slice(max(0, k), size - max(0, -k)))
        both_free = free[tuple(node)] & free[tuple(neighbour)]
        a, b = number[tuple(node)][both_free], number[tuple(neighbour)][both_free]
        rows.append(a)
        columns.append(b)
        costs.append(np.linalg.norm(shift * spacing) * (distance[a] ** -POWER + distance[b] ** -POWER) / 2)
    shape = (len(distance), len(distance))
    return scipy.sparse.csr_array((np.concatenate(costs), (np.concatenate(rows), np.concatenate(columns))), shape=shape)
