"""Roadmap for many plans of one robot among the same obstacles (lazy PRM, Bohlin and Kavraki 2000).

Its nodes are equilibria in the space of tip rotations and translations, in which a straight line is a motion without a
snap as long as it is stable. An edge is checked only when a path uses it, and the result is stored for the next query.
If bodies, margin or clearance change, the results are deleted; the nodes remain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from os import PathLike
from typing import Any

import numpy as np
import scipy

from ..arguments import typed
from ..bodies.obstacles import Obstacle, Same
from ..display import Displayed
from ..equilibrium.result import MIN_MARGIN
from ..errors import InputError, SolveError
from ..inverse.clock import Clock, OutOfTimeError
from ..inverse.search import PathResult
from ..robots.limits import JointLimits
from ..robots.robot import Robot
from ..typing import Array, Index
from .motion import DEFAULT_RATES
from .question import DEFAULT_PLAN, PlanOptions, PlanTask, plan_task

# Fewer can leave the graph disconnected; more are more motions to check.
NEIGHBOURS = 10
"""Number of nearest nodes that a node is connected to; twice as many for start and goals."""

# Points are integrated in one call, and many of them are refused.
DRAWN = 512
"""Number of random points per round."""


@dataclass(eq=False)
class Roadmap(Displayed):
    """Valid points in the tip coordinates of a robot, and edges between them."""

    points: Array
    """(N, m) points in the coordinates of the robot."""
    parameters: Array = field(repr=False)
    """Parameters of the robot; a saved map is only used for the same robot."""
    edges: Index = field(repr=False)
    """(E, 2) numbers of the points of every edge."""
    known: dict[tuple[int, int], bool] = field(default_factory=dict, repr=False)
    """Result of the check of each edge, for the last query."""
    last_requirements: tuple[Any, ...] = field(default=(), repr=False)
    """Requirements of the last query; `known` is valid for them."""
    tips: Array | None = field(default=None, repr=False)
    """(N, 3) tips of the points, m; computed when first needed."""

    def __len__(self) -> int:
        return len(self.points)

    def shortest_path(self, task: PlanTask, start: Array, goals: Sequence[Array], clock: Clock) -> PathResult:
        """The shortest valid path over the map from a point (m,) to the nearest goal.

        The result has no `points` if the map has no such path, or after the time limit.
        """
        self._match(task)
        count, ends = len(self.points), np.stack([start, *goals])
        scaled = np.concatenate([self.points, ends]) / task.scale
        neighbours = np.argsort(np.linalg.norm(scaled[count:, None] - scaled[:count], axis=2), axis=1)
        neighbours = neighbours[:, : 2 * NEIGHBOURS]
        to_ends = np.column_stack([np.repeat(np.arange(count, len(scaled)), neighbours.shape[1]), neighbours.ravel()])
        straight = np.column_stack([np.full(len(goals), count), count + 1 + np.arange(len(goals))])
        edges = np.concatenate([self.edges, to_ends, straight])
        length = np.linalg.norm(scaled[edges[:, 0]] - scaled[edges[:, 1]], axis=1) + 1e-9
        with_ends: dict[tuple[int, int], bool] = {}
        points = scaled * task.scale
        edges.sort(axis=1)
        name = edges @ [len(scaled), 1]
        open_ = ~np.isin(name, [a * len(scaled) + b for (a, b), holds in self.known.items() if not holds])
        tried = 0
        while not clock.over:
            nodes = _shortest(len(scaled), edges[open_], length[open_], count)
            if nodes is None:
                return PathResult(None, "roadmap", tried, why="the roadmap has no path")
            pairs = list(pairwise(nodes))
            # From both ends inwards: the first and the last edge are new to the roadmap.
            for a, b in sorted(pairs, key=lambda pair: min(pairs.index(pair), len(pairs) - 1 - pairs.index(pair))):
                low, high = sorted((a, b))
                if (low, high) in self.known or (low, high) in with_ends:
                    continue
                tried += 1
                holds = task.motion(points[a], points[b])
                if clock.left == 0:  # a check that ran out of time proves nothing
                    break
                (self.known if high < count else with_ends)[low, high] = holds
                if not holds:
                    open_ &= name != low * len(scaled) + high
                    break
            else:
                return PathResult(points[nodes], "roadmap", tried)
        return PathResult(None, "roadmap", tried, why="the time for the roadmap was over")

    def near(self, task: PlanTask, position: Array, count: int) -> Array:
        """(k, m) points of the roadmap with tips nearest to a position (3,), at most `count`; the nearest first."""
        self._match(task)
        if self.tips is None:
            self.tips = task.coordinates.arms(self.points, 0.0).tip
        far = np.linalg.norm(self.tips - position, axis=1)
        return np.asarray(self.points[np.argsort(far, kind="stable")[:count]])

    def _match(self, task: PlanTask) -> None:
        """Delete the results of edges if the requirements differ; raise InputError for another robot."""
        if not np.array_equal(task.coordinates.parameters, self.parameters):
            raise InputError("the roadmap is of another robot")
        if self.points.shape[1] != len(task.scale):
            raise InputError(
                "start or goal separates carriages that move together in the roadmap; plan without the roadmap"
            )
        reserves = task.margin_reserve, task.clearance_reserve
        requirements = (Same(task.obstacles), task.min_margin, task.clearance, task.min_clearance_reserve, *reserves)
        if requirements != self.last_requirements:
            self.known.clear()
        self.last_requirements = requirements

    def save(self, path: str | PathLike[str]) -> None:
        """Save points and edges as .npz, without the results of edges, which depend on the bodies."""
        np.savez_compressed(path, points=self.points, edges=self.edges, parameters=self.parameters)


def _shortest(size: int, edges: Index, length: Array, start: int) -> list[int] | None:
    """Nodes of the shortest path from node `start` to the nearest of the nodes after it; None without a path."""
    graph = scipy.sparse.csr_array((length, (edges[:, 0], edges[:, 1])), shape=(size, size))
    far, before = scipy.sparse.csgraph.dijkstra(graph, directed=False, indices=start, return_predecessors=True)
    goals = np.arange(start + 1, size)
    if not np.isfinite(far[goals]).any():
        return None
    path = [int(goals[np.argmin(far[goals])])]
    while path[-1] != start:
        path.append(int(before[path[-1]]))
    return path[::-1]


@typed
def build_roadmap(
    robot: Robot,
    *,
    obstacles: Sequence[Obstacle] = (),
    min_margin: float = MIN_MARGIN,
    limits: JointLimits | None = None,
    options: PlanOptions = DEFAULT_PLAN,
    count: int = 500,
) -> Roadmap:
    """Build a roadmap of `count` valid points, or of fewer if `options.time_limit` ends the search.

    Args:
        obstacles, min_margin, limits, options: as of `plan_trajectory`; of the options clearance, gaps, time limit and
            seed count.

    Raises:
        InputError: invalid numbers.
        SolveError: fewer than two points were found.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> len(tubeopt.build_roadmap(robot, count=20))
        20
    """
    return roadmap_of(plan_task(robot, obstacles, min_margin, DEFAULT_RATES, limits, options), count)


def roadmap_of(task: PlanTask, count: int) -> Roadmap:
    """Roadmap of `count` valid points, or of fewer if the clock ends; raises SolveError for fewer than two."""
    options, n = task.options, task.coordinates.space.robot.n_tubes
    random = np.random.default_rng(options.seed)
    space, valid, total = task.coordinates.space, list[Array](), 0
    shifts = space.sample(16 * DRAWN)[:, n:]
    while total < count and not task.clock.over:
        z = np.column_stack([random.uniform(-np.pi, np.pi, (DRAWN, n)), random.choice(shifts, DRAWN)])
        try:
            valid.append(z[task.holds(z)])
        except OutOfTimeError:
            break
        total += len(valid[-1])
    points = np.concatenate(valid)[:count] if valid else np.zeros((0, len(space.lower)))
    if len(points) < 2:
        raise SolveError(
            f"no roadmap was found within {options.time_limit:g} s: {len(points)} free configurations were found"
        )
    scaled = points / task.scale
    _, neighbours = scipy.spatial.cKDTree(scaled).query(scaled, k=min(NEIGHBOURS + 1, len(points)))
    edges = np.column_stack([np.repeat(np.arange(len(points)), neighbours.shape[1] - 1), neighbours[:, 1:].ravel()])
    return Roadmap(points, task.coordinates.parameters, np.unique(np.sort(edges, axis=1), axis=0))


@typed
def load_roadmap(path: str | PathLike[str]) -> Roadmap:
    """Load a roadmap from a file of `Roadmap.save`.

    Raises:
        InputError: no such file, or none of a roadmap.

    Examples:
        >>> import tempfile
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> with tempfile.TemporaryDirectory() as directory:
        ...     tubeopt.build_roadmap(robot, count=20).save(f"{directory}/roadmap.npz")
        ...     len(tubeopt.load_roadmap(f"{directory}/roadmap.npz"))
        20
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            return Roadmap(file["points"], file["parameters"], file["edges"])
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise InputError(f"{path}: cannot read the roadmap: {error}") from None
