"""Design for goals without derivatives, such as the reachable fraction of a region, for one robot or two.

Simplex searches over the free dimensions (Nelder and Mead 1965) from several starts, within the requirements of a task.
"""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from typing import Any, NamedTuple, Protocol

import numpy as np
import scipy

from ..arguments import renamed, typed
from ..display import Displayed
from ..errors import InputError, SolveError, instance, positive, whole
from ..robots.concentric import ConcentricRobot
from ..solvers.blas import small
from ..solvers.time_limit import TIME_LIMIT, OutOfTimeError, limited, within
from ..typing import Array, Delegate, Progress
from .evaluation import FEASIBLE, attempt, robot_at, violation
from .infeasibility import best_of
from .objectives import Objective
from .optimize import DesignSolution, DesignStatus, solution_of
from .program import Program, compile_task
from .requirements import SnapFree, of_kind
from .solve import multistart, rank, start_values, to_feasibility
from .task import DesignedRobot, DesignTask

# Part of every range. Scores of planning are steps of 1/count: a smaller simplex sees one value only and stops, a
# larger one leaves the requirements.
SIMPLEX_STEP = 0.2

# Part of the ranges: a thousandth of a range of curvature or length is below what can be made.
SIMPLEX_SIZE = 1e-3


class _Score(Protocol):
    @property
    def description(self) -> str:
        """Name of the value."""

    @property
    def ranges(self) -> Array:
        """Ranges (k, 2) of further unknowns, such as the position of a base plate, SI."""


class SearchObjective(_Score, Protocol):
    """Goal for one robot and k further unknowns, which start at 0."""

    def __call__(self, robot: ConcentricRobot, variables: Array) -> tuple[float, float]:
        """Score from 0 (best) to 1, which must differ between neighbours, and the value; larger values are better.

        Raises:
            InputError, SolveError: the robot cannot be evaluated. It counts as the worst.
        """


class PairObjective(_Score, Protocol):
    """Goal for two robots and k further unknowns, like `SearchObjective` for one."""

    def __call__(self, one: ConcentricRobot, other: ConcentricRobot, variables: Array) -> tuple[float, float]:
        """Score and value, as in `SearchObjective`."""


@dataclass(frozen=True, eq=False)
class Searched(Displayed):
    """Result of a search without derivatives."""

    _brief = ("objective", "before", "after", "tried")

    objective: str
    """Name of the value."""
    before: float
    """Value at the dimensions of the task."""
    after: float
    """Value of the best design."""
    variables: Array = field(repr=False)
    """Further unknowns (k,) of the best design, SI."""
    tried: int
    """Number of evaluated designs or pairs."""
    seconds: float
    """Run time, checks included."""

    @property
    def statistics(self) -> int:
        """Number of evaluated designs or pairs."""
        return self.tried


@dataclass(frozen=True, eq=False)
class SearchedDesign(Searched):
    """Best design of a search without derivatives."""

    solution: DesignSolution
    """Design, verified by independent code."""

    status = Delegate[DesignStatus]("solution")

    @property
    def value(self) -> DesignedRobot:
        """Designed robot."""
        return self.solution.robot


@dataclass(frozen=True, eq=False)
class SearchedPair(Searched):
    """Best two robots of a search without derivatives."""

    solutions: tuple[DesignSolution, DesignSolution]
    """Designs, verified by independent code."""

    @property
    def value(self) -> tuple[DesignedRobot, DesignedRobot]:
        """The two designed robots."""
        return self.solutions[0].robot, self.solutions[1].robot

    @property
    def status(self) -> DesignStatus:
        """Status of the final check of both robots; of the one that fails, otherwise success."""
        first, second = (solution.status for solution in self.solutions)
        return first if second is DesignStatus.SATISFIED else second


class _EndError(Exception):
    """The time limit is reached, or no better score is possible."""


class _Designs(NamedTuple):
    """Point of the search space, SI."""

    dimensions: list[Array]
    """Free dimensions (D,) of each robot."""
    variables: Array
    """Further unknowns (k,)."""


@dataclass(eq=False)
class _SimplexSearch:
    """Nelder-Mead search over the unit cube of all unknowns: dimensions of each robot, then further unknowns."""

    programs: tuple[Program, ...]
    goal: Any
    progress: Progress | None = None
    until: float = 0.0
    """End of the current search on the clock, s."""
    tried: int = 0
    score: float = np.inf
    value: float = np.nan
    best: _Designs | None = None
    """Designs with the smallest score up to now."""

    @property
    def ranges(self) -> Array:
        """Bounds (D + k, 2) of all unknowns."""
        spaces = [program.layout.space for program in self.programs]
        variables = np.reshape(np.asarray(self.goal.ranges, dtype=float), (-1, 2))
        return np.concatenate([*(np.column_stack([space.lower, space.upper]) for space in spaces), variables])

    def from_unit(self, u: Array) -> _Designs:
        """Designs at a point of the unit cube."""
        low, high = self.ranges.T
        # Clipped, since `to_unit` may leave the cube by round-off.
        x = low + np.clip(u, 0.0, 1.0) * (high - low)
        *dimensions, variables = np.split(x, np.cumsum([program.layout.designs for program in self.programs]))
        return _Designs(dimensions, variables)

    def to_unit(self, at: _Designs) -> Array:
        """Point of the unit cube of designs."""
        low, high = self.ranges.T
        # A range without width has no unit: its coordinate is 0, not 0 / 0.
        return np.asarray(
            (np.concatenate([*at.dimensions, at.variables]) - low) / np.where(high > low, high - low, 1.0)
        )

    def __call__(self, u: Array) -> float:
        """Score at a point of the unit cube; above 1 if a requirement is violated."""
        # 0 is the best score that `SearchObjective` allows, so nothing is left to search.
        if time.perf_counter() > self.until or self.score == 0:
            raise _EndError
        self.tried += 1
        if self.progress is not None:
            self.progress(self.tried, 0)
        at = self.from_unit(u)
        # Requirements come before the score: they need no planning. Their score is graded by the violation, from 1 to
        # 2, so that the simplex finds back to designs that satisfy them.
        worst = max(violation(program, x) for program, x in zip(self.programs, at.dimensions, strict=True))
        if worst > FEASIBLE:
            return 1.0 + min(worst, 1.0)
        score, value = self.evaluate(at)
        if score < self.score:
            self.score, self.value, self.best = score, value, at
        return score

    def evaluate(self, at: _Designs) -> tuple[float, float]:
        """Score and value of designs that satisfy their requirements."""
        try:
            robots = [robot_at(program, x) for program, x in zip(self.programs, at.dimensions, strict=True)]
            score, value = self.goal(*robots, at.variables)
        except (InputError, SolveError):
            # The worst score among designs that satisfy the requirements, still below that of any other design.
            return 1.0, 0.0
        return float(score), float(value)

    def minimise_from(self, start: _Designs, until: float) -> None:
        """Repeat simplex searches, each from the end of the previous one, while they improve the score."""
        # A simplex that is pressed against a requirement becomes flat, and cannot move along it: a new one can.
        self.until, previous, u = until, np.inf, self.to_unit(start)
        bounds = [(0.0, 1.0)] * len(u)
        with suppress(_EndError):
            while True:
                # Edges point into the cube, down from the upper half of a range: the bounds shorten none of them.
                simplex = np.vstack([u, u + np.diag(SIMPLEX_STEP * np.where(u > 0.5, -1, 1))])
                # scipy stops where both are satisfied: the simplex is small, and all its scores are equal. The counts
                # are out of reach, so that only the time limit ends a search early.
                options = {"xatol": SIMPLEX_SIZE, "fatol": 0.0, "maxfev": 10**6, "maxiter": 10**6}
                end = scipy.optimize.minimize(
                    self, u, method="Nelder-Mead", bounds=bounds, options={**options, "initial_simplex": simplex}
                )
                # `not <` in place of `>=`: a score that is NaN ends the search too.
                if not end.fun < previous - SIMPLEX_SIZE:
                    break
                u, previous = end.x, float(end.fun)


@renamed(seconds="time_limit")
@typed
@small
def search_design(
    task: DesignTask,
    objective: SearchObjective,
    *,
    time_limit: float = 180.0,
    starts: int = 1,
    seed: int = 0,
    turns: int = 6,
    progress: Progress | None = None,
) -> SearchedDesign:
    """The best robot found for a goal without derivatives, within the requirements of a task and a time limit.

    Every start is moved to a design that satisfies the requirements. A simplex search continues from there; designs
    that violate a requirement rank below all others. The result is the best design evaluated; it is not proved optimal.

    Args:
        task: free dimensions, and requirements on tubes and certificates; its objective is ignored.
        objective: the goal, for example `tubeopt.planning.RegionReach`.
        time_limit: search time, s, from the first start that satisfies the requirements, shared by all starts.
        starts: number of starts: the dimensions of the task, then random ones.
        turns: as for `optimize_design`.   progress: called with the number of evaluated designs, and 0.

    Raises:
        InputError: a task with poses, a certificate over a box or under a force, or numbers out of range.
        DesignNotFoundError: no start gives a design that satisfies the requirements.
        SolveError: the design violates a requirement when it is checked again.

    Examples:
        >>> import tubeopt
        >>> from tubeopt.design import Free
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> tip = tubeopt.forward_kinematics(robot, [0.0, 0.0]).tip_position
        >>> task = tubeopt.DesignTask(robot, free=[Free("curvature", (0,), 1.0, 20.0)], ordered=False)
        >>> wanted = tubeopt.RegionReach(([0.0, 0.0], None), [tip], count=10)
        >>> tubeopt.search_design(task, wanted, time_limit=10).after
        1.0
    """
    search = partial(_search, starts=starts, seed=seed, turns=turns, progress=progress)
    limit = positive("time_limit", time_limit) + TIME_LIMIT
    (solution,), result = search((task,), objective, search_time=time_limit, time_limit=limit)
    return SearchedDesign(**vars(result), solution=solution)


@renamed(seconds="time_limit")
@typed
@small
def search_pair(
    tasks: tuple[DesignTask, DesignTask],
    objective: PairObjective,
    *,
    time_limit: float = 180.0,
    starts: int = 1,
    seed: int = 0,
    turns: int = 6,
    progress: Progress | None = None,
) -> SearchedPair:
    """The best two robots found together for a goal without derivatives, each within the requirements of its own task.

    Args:
        tasks: one for each robot, as for `search_design`.
        objective: the goal, for example `tubeopt.planning.PairReach`.
        time_limit, starts, seed, turns, progress: as for `search_design`.

    Raises:
        InputError: not two tasks; tasks that `search_design` does not support; numbers out of range.
        DesignNotFoundError: no start gives designs that satisfy the requirements.
        SolveError: a design violates a requirement when it is checked again.

    Examples:
        >>> import tubeopt
        >>> from tubeopt.design import Free
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> task = tubeopt.DesignTask(robot, free=[Free("curvature", (0,), 1.0, 20.0)], ordered=False)
        >>> class Alike:
        ...     description, ranges = "likeness of curvatures", ()
        ...     def __call__(self, one, other, variables):
        ...         apart = abs(one.tubes[0].curvature - other.tubes[0].curvature) / 20
        ...         return apart, 1 - apart
        >>> float(tubeopt.search_pair((task, task), Alike(), time_limit=1).after)
        1.0
    """
    if not isinstance(tasks, (tuple, list)) or len(tasks) != 2:
        raise InputError(f"tasks are {tasks!r}; they must be two, one for each robot")
    search = partial(_search, starts=starts, seed=seed, turns=turns, progress=progress)
    limit = positive("time_limit", time_limit) + TIME_LIMIT
    (first, second), result = search(tuple(tasks), objective, search_time=time_limit, time_limit=limit)
    return SearchedPair(**vars(result), solutions=(first, second))


@limited
def _search(
    tasks: tuple[DesignTask, ...],
    objective: SearchObjective | PairObjective,
    *,
    search_time: float,
    starts: int,
    seed: int,
    turns: int,
    progress: Progress | None,
    time_limit: float = TIME_LIMIT,
) -> tuple[list[DesignSolution], Searched]:
    """The best designs, one for each task, and the value before and after.

    The time limit exceeds the search time, since it includes the first designs and the final checks.
    """
    for task in tasks:
        _check(task)
    for name, number, lower in (("starts", starts, 1), ("seed", seed, 0), ("turns", turns, 0)):
        whole(name, number, lower)
    start_time = time.perf_counter()
    # Designs that satisfy the requirements near the start: the objective of the task does not count.
    tasks = tuple(replace(task, objective=Objective("change")) for task in tasks)
    programs = tuple(compile_task(task) for task in tasks)
    search = _SimplexSearch(programs, objective, progress)
    # Further unknowns start at 0, or at the bound nearest to it.
    variables = np.clip(np.zeros(len(objective.ranges)), *np.reshape(objective.ranges, (-1, 2)).T)
    with within(time_limit - search_time):
        first = _Designs([best_of(multistart(program, starts=1, seed=seed)).x for program in programs], variables)
    with within(time_limit - search_time):
        _, before = search.evaluate(_Designs([program.layout.space.start for program in programs], variables))
    draws = zip(*(start_values(program, seed + k, starts)[1:] for k, program in enumerate(programs)), strict=True)
    # A generator: these starts are made feasible within the search time below, not before it.
    more = (_Designs([to_feasibility(*pair) for pair in zip(programs, draw, strict=True)], variables) for draw in draws)
    search_start = time.perf_counter()
    with within(search_time), suppress(OutOfTimeError):
        for k, start in enumerate(chain([first], more)):
            # The time that a start leaves over is used by the next ones.
            search.minimise_from(start, search_start + search_time * (k + 1) / starts)
    if search.best is None:  # the time limit came before the first score
        search.best, (_, search.value) = first, search.evaluate(first)
    attempts = [attempt(program, x) for program, x in zip(programs, search.best.dimensions, strict=True)]
    solutions = [solution_of(task, rank([end]), turns, start_time) for task, end in zip(tasks, attempts, strict=True)]
    seconds = time.perf_counter() - start_time
    return solutions, Searched(
        objective.description, before, search.value, search.best.variables, search.tried, seconds
    )


def _check(task: DesignTask) -> None:
    """Raise InputError for a task with requirements that this search does not support."""
    instance("task", task, DesignTask)
    if task.has_poses:
        raise InputError(
            "the task has poses; a derivative-free search supports requirements on tubes and certificates only"
        )
    for certificate in of_kind(task.requirements, SnapFree):
        if certificate.box is not None or certificate.max_force:
            raise InputError(
                "snap_free has a box or a force; a derivative-free search supports fixed translations without load only"
            )
