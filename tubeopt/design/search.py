"""Designs for what has no derivative, as what planning finds out about a robot, or about two: simplex searches over the
free dimensions (Nelder and Mead 1965) from several starts, within the requirements of a task each."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, Protocol

import numpy as np
import scipy

from ..arguments import renamed, typed
from ..display import Displayed
from ..errors import InputError, SolveError, instance, positive, whole
from ..robots.concentric import ConcentricRobot
from ..solvers.blas import small
from ..solvers.time_limit import TIME_LIMIT, LateError, limited, within
from ..typing import Array, Delegate, Progress
from .evaluation import FEASIBLE, attempt, robot_at, violation
from .infeasibility import best_of
from .objectives import Objective
from .optimize import DesignSolution, DesignStatus, solution_of
from .program import Program, compile_task
from .requirements import SnapFree
from .solve import multistart, rank, start_values, to_feasibility
from .task import DesignTask

# Part of every range. Scores of planning are steps of 1/count: a smaller simplex sees one value only and stops, a
# larger one leaves the requirements.
SIMPLEX_STEP = 0.2

# Part of the ranges: a thousandth of a range of curvature or length is below what can be made.
SIMPLEX_SIZE = 1e-3


class _Asked(Protocol):
    @property
    def words(self) -> str:
        """What its value is called."""

    @property
    def ranges(self) -> Array:
        """(k, 2) least and greatest of its own numbers, SI."""


class Wanted(_Asked, Protocol):
    """What is asked of a robot, and of numbers of its own (k,), as where a plate stands, which begin as 0."""

    def __call__(self, robot: ConcentricRobot, own: Array) -> tuple[float, float]:
        """A score from 0, at best, to 1, which tells neighbours apart, and the value, of which more is better.

        Raises:
            InputError, SolveError: of this robot nothing can be told, which is the worst.
        """


class WantedOfPair(_Asked, Protocol):
    """What is asked of two robots, as `Wanted` of one."""

    def __call__(self, one: ConcentricRobot, other: ConcentricRobot, own: Array) -> tuple[float, float]:
        """Score and value, as of `Wanted`."""


@dataclass(frozen=True, eq=False)
class Searched(Displayed):
    """What was found for what has no derivative."""

    _brief = ("wanted", "before", "after", "tried")

    wanted: str
    """What was asked."""
    before: float
    """Its value of what was given."""
    after: float
    """Its value of what was found."""
    own: Array = field(repr=False)
    """(k,) its own numbers."""
    tried: int
    """Designs, or pairs, that were looked at."""
    seconds: float
    """Of all."""

    @property
    def statistics(self) -> int:
        """How many were looked at."""
        return self.tried


@dataclass(frozen=True, eq=False)
class SearchedDesign(Searched):
    """The best design that was found for what has no derivative."""

    solution: DesignSolution
    """The design, its requirements checked again by other code."""

    status = Delegate[DesignStatus]("solution")

    @property
    def value(self) -> ConcentricRobot:
        """The designed robot."""
        return self.solution.robot


@dataclass(frozen=True, eq=False)
class SearchedPair(Searched):
    """The best two robots that were found for what has no derivative."""

    solutions: tuple[DesignSolution, DesignSolution]
    """The designs, the requirements of each checked again by other code."""

    @property
    def value(self) -> tuple[ConcentricRobot, ConcentricRobot]:
        """The two designed robots."""
        return self.solutions[0].robot, self.solutions[1].robot

    @property
    def status(self) -> DesignStatus:
        """Result of the final check of both robots; the status of the one that fails, if any."""
        one, other = (solution.status for solution in self.solutions)
        return one if other is DesignStatus.KEPT else other


class Budget(NamedTuple):
    """Effort of a search without derivatives."""

    seconds: float
    """Search time, s, shared by all starts."""
    starts: int
    seed: int
    turns: int
    """Random full turns of the final check."""


class _EndError(Exception):
    """The time limit is reached, or no better score is possible."""


@dataclass(eq=False)
class _Search:
    """Scores at places u (D + k,) of the unit cube, and the best of them: of the dimensions of all programs, then of
    the own numbers of what is wanted."""

    programs: tuple[Program, ...]
    wanted: Any
    until: float = 0.0
    tried: int = 0
    score: float = np.inf
    value: float = np.nan
    best: Array | None = None
    progress: Callable[[int], object] | None = None

    @property
    def ranges(self) -> Array:
        """(D + k, 2) of all unknowns."""
        spaces = [program.layout.space for program in self.programs]
        own = np.reshape(np.asarray(self.wanted.ranges, dtype=float), (-1, 2))
        return np.concatenate([*(np.column_stack([space.lower, space.upper]) for space in spaces), own])

    def from_unit(self, u: Array) -> tuple[list[Array], Array]:
        """Dimensions of each robot, and own numbers, SI, at a point of the unit cube."""
        low, high = self.ranges.T
        # Clipped, since `to_unit` may leave the cube by round-off.
        x = low + np.clip(u, 0.0, 1.0) * (high - low)
        *designs, own = np.split(x, np.cumsum([program.layout.designs for program in self.programs]))
        return designs, own

    def to_unit(self, designs: Sequence[Array], own: Array) -> Array:
        """Point of the unit cube of dimensions and own numbers, SI."""
        low, high = self.ranges.T
        # A range without width has no unit: its coordinate is 0, not 0 / 0.
        return np.asarray((np.concatenate([*designs, own]) - low) / np.where(high > low, high - low, 1.0))

    def __call__(self, u: Array) -> float:
        """The score: beyond 1 where a requirement is not kept."""
        # 0 is the best score that `Wanted` allows, so nothing is left to search.
        if time.perf_counter() > self.until or self.score == 0:
            raise _EndError
        self.tried += 1
        if self.progress is not None:
            self.progress(self.tried)
        designs, own = self.from_unit(u)
        # Requirements come before the score: they need no planning. Their score is graded by the violation, from 1 to
        # 2, so that the simplex finds back to designs that satisfy them.
        short = max(violation(program, x) for program, x in zip(self.programs, designs, strict=True))
        if short > FEASIBLE:
            return 1.0 + min(short, 1.0)
        score, value = self.score_of(designs, own)
        if score < self.score:
            self.score, self.value, self.best = score, value, np.clip(u, 0.0, 1.0)
        return score

    def score_of(self, designs: Sequence[Array], own: Array) -> tuple[float, float]:
        """Score and value of designs that keep their requirements."""
        try:
            robots = [robot_at(program, x) for program, x in zip(self.programs, designs, strict=True)]
            score, value = self.wanted(*robots, own)
        except (InputError, SolveError):
            # The worst score among designs that satisfy the requirements, still below that of any other design.
            return 1.0, 0.0
        return float(score), float(value)

    def descend(self, u: Array, until: float) -> None:
        """Simplex searches, each from the end of the one before, while they improve the score."""
        # A simplex that is pressed against a requirement becomes flat, and cannot move along it: a new one can.
        self.until, before = until, np.inf
        # scipy stops where both are satisfied: the simplex is small, and all its scores are equal. The counts are out
        # of reach, so that only the time limit ends a search early.
        options = {"xatol": SIMPLEX_SIZE, "fatol": 0.0, "maxfev": 10**6, "maxiter": 10**6}
        bounds = [(0.0, 1.0)] * len(u)
        with suppress(_EndError):
            while True:
                # Edges point into the cube, down from the upper half of a range: the bounds shorten none of them.
                simplex = np.vstack([u, u + np.diag(SIMPLEX_STEP * np.where(u > 0.5, -1, 1))])
                some = {**options, "initial_simplex": simplex}
                found = scipy.optimize.minimize(self, u, method="Nelder-Mead", bounds=bounds, options=some)
                # `not <` in place of `>=`: a score that is NaN ends the search too.
                if not found.fun < before - SIMPLEX_SIZE:
                    break
                u, before = found.x, float(found.fun)


@renamed(seconds="time_limit")
@typed
@small
def search_design(
    task: DesignTask,
    wanted: Wanted,
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
        wanted: the goal, for example `tubeopt.planning.RegionReach`.
        time_limit: search time, s, from the first start that satisfies the requirements, shared by all starts.
        starts: number of starts: the dimensions of the task, then random ones.
        turns: as for `optimize_design`.   progress: called with the number of evaluated designs, and 0.

    Raises:
        InputError: a task with poses, a certificate over a box or under a force, or numbers out of range.
        DesignNotFoundError: no start leads to a design that satisfies the requirements.
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
    limit = positive("time_limit", time_limit) + TIME_LIMIT
    budget = Budget(time_limit, starts, seed, turns)
    (solution,), result = without_derivatives((task,), wanted, budget, progress, time_limit=limit)
    return SearchedDesign(**vars(result), solution=solution)


@renamed(seconds="time_limit")
@typed
@small
def search_pair(
    tasks: tuple[DesignTask, DesignTask],
    wanted: WantedOfPair,
    *,
    time_limit: float = 180.0,
    starts: int = 1,
    seed: int = 0,
    turns: int = 6,
    progress: Progress | None = None,
) -> SearchedPair:
    """The best two robots for what has no derivative, sized together, each within the requirements of its own task.

    Args:
        tasks: as of `search_design`, one for each robot.
        wanted: as `tubeopt.planning.PairReach`.
        time_limit, starts, seed, turns, progress: as of `search_design`.

    Raises:
        InputError: not two tasks; tasks as `search_design` refuses them; numbers that make no sense.
        DesignNotFoundError: no start leads to designs that keep the requirements.
        SolveError: a design breaks a promise when it is checked again.

    Examples:
        >>> import tubeopt
        >>> from tubeopt.design import Free
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> task = tubeopt.DesignTask(robot, free=[Free("curvature", (0,), 1.0, 20.0)], ordered=False)
        >>> class Alike:
        ...     words, ranges = "likeness of curvatures", ()
        ...     def __call__(self, one, other, own):
        ...         apart = abs(one.tubes[0].curvature - other.tubes[0].curvature) / 20
        ...         return apart, 1 - apart
        >>> float(tubeopt.search_pair((task, task), Alike(), time_limit=1).after)
        1.0
    """
    if not isinstance(tasks, (tuple, list)) or len(tasks) != 2:
        raise InputError(f"tasks are {tasks!r}; they must be two, one for each robot")
    limit = positive("time_limit", time_limit) + TIME_LIMIT
    budget = Budget(time_limit, starts, seed, turns)
    (one, other), result = without_derivatives(tuple(tasks), wanted, budget, progress, time_limit=limit)
    return SearchedPair(**vars(result), solutions=(one, other))


@limited
def without_derivatives(
    tasks: tuple[DesignTask, ...],
    wanted: Wanted | WantedOfPair,
    budget: Budget,
    progress: Progress | None,
    *,
    time_limit: float = TIME_LIMIT,
) -> tuple[list[DesignSolution], Searched]:
    """The best designs, one for each task, and their value before and after. The time limit exceeds the search time by
    the time for the first design and the checks."""
    seconds, starts, seed, turns = budget
    for task in tasks:
        _check(task)
    for name, number, least in (("starts", starts, 1), ("seed", seed, 0), ("turns", turns, 0)):
        whole(name, number, least)
    began = time.perf_counter()
    plain = [replace(task, objective=Objective("change")) for task in tasks]
    programs = tuple(compile_task(task) for task in plain)
    with within(time_limit - seconds):
        first = [best_of(multistart(program, starts=1, seed=seed)).x for program in programs]
    note = None if progress is None else lambda count: progress(count, 0)
    search = _Search(programs, wanted, progress=note)
    # Own numbers begin at 0, or at the bound nearest to it.
    zero = np.clip(np.zeros(len(wanted.ranges)), *np.reshape(wanted.ranges, (-1, 2)).T)
    with within(time_limit - seconds):
        _, before = search.score_of([program.layout.space.start for program in programs], zero)
    drawn = [start_values(program, seed + k, starts)[1:] for k, program in enumerate(programs)]
    # A generator: this work is done under the search time below, not before it.
    others = ([to_feasibility(*each) for each in zip(programs, some, strict=True)] for some in zip(*drawn, strict=True))
    begin = time.perf_counter()
    with within(seconds), suppress(LateError):
        for k, designs in enumerate([first, *others]):
            # The time that a start leaves over is used by the next ones.
            search.descend(search.to_unit(designs, zero), begin + seconds * (k + 1) / starts)
    if search.best is None:  # the time limit came before the first score
        search.best, (_, search.value) = search.to_unit(first, zero), search.score_of(first, zero)
    designs, own = search.from_unit(search.best)
    found = [attempt(program, x) for program, x in zip(programs, designs, strict=True)]
    solutions = [solution_of(task, (rank([each]), 0), turns, began) for task, each in zip(plain, found, strict=True)]
    spent = time.perf_counter() - began
    return solutions, Searched(wanted.words, before, search.value, own, search.tried, spent)


def _check(task: DesignTask) -> None:
    instance("task", task, DesignTask)
    if task.has_poses:
        raise InputError(
            "the task has poses; a derivative-free search supports requirements on tubes and certificates only"
        )
    for one in task.requirements:
        if isinstance(one, SnapFree) and (one.box is not None or one.max_force):
            raise InputError(
                "snap_free has a box or a force; a derivative-free search supports fixed translations without load only"
            )
