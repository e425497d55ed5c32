"""Tube design: the question, and its answer."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated

import numpy as np

from ..arguments import renamed, typed
from ..bodies.obstacles import scene_of
from ..display import Displayed
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, finite, instance, whole
from ..files.field_metadata import Range, key
from ..robots.concentric import ConcentricRobot
from ..solvers.blas import small
from ..solvers.time_limit import LONG_TIME_LIMIT, LateError, check_time, limited, time_left, within
from ..stability import snap_free_certificate
from ..typing import Array, Progress, StatusEnum
from .evaluation import Attempt, Report
from .exchange import carry, certified_at, violations
from .infeasibility import DesignNotFoundError, best_of
from .objectives import key_of
from .parameters import NAMES, UNITS
from .program import Added, Program, compile_task, recompiled
from .requirements import Avoid, SnapFree, SnapFreeInUse, of_kind
from .sensitivities import Dimension, Sensitivity, remarks, sensitivities
from .solve import Ranking, multistart, rank, solve_from
from .task import DesignTask
from .verify import Check, Verification, solve_again, verify


class DesignStatus(StatusEnum):
    """What became of a design; every value reads as a sentence."""

    KEPT = "the design satisfies all requirements"
    STOPPED = "the design satisfies all requirements; the search for a better one reached the time limit"
    BROKEN = "a design was found, but verification shows that it violates a requirement"


@dataclass(frozen=True)
class DesignStatistics:
    """What a design took: starts, rounds in which worst cases were added, seconds."""

    starts: int
    rounds: int
    seconds: float


@dataclass(frozen=True, eq=False)
class DesignSolution(Displayed):
    """A design that meets its task."""

    _brief = ("robot", "certificate", "objectives", "status")

    task: DesignTask
    """The task."""
    robot: ConcentricRobot
    """The designed robot."""
    certificate: Annotated[float, "lower bound on the margin at all rotations"]
    """Smallest over the translations and the box for which the task demands a certificate, otherwise at home."""
    equilibria: Annotated[tuple[Equilibrium, ...], key("poses"), "the task poses"]
    """Equilibria, solved again by forward kinematics, in the order of the requirements."""
    objective: float
    """Value in its own sign, SI; with several objectives their weighted sum as minimised."""
    objectives: dict[str, float]
    """Value of each, by kind (own ones by their words), SI."""
    dimensions: Annotated[tuple[Dimension, ...], "free dimensions"]
    sensitivities: Annotated[tuple[Sensitivity, ...], key("binding"), "active requirements"]
    """Gain from relaxing each, the largest first."""
    ranking: Ranking
    """Designs of all starts."""
    rounds: Annotated[int, "number of times that worst cases were added"]
    added: Added
    """The worst cases that were added."""
    verification: Verification
    """All promises, checked again."""
    seconds: Annotated[float, "run time, s"]
    out_of_time: bool = False
    """True if the time limit ended the search: a better design may be near."""

    @property
    def value(self) -> ConcentricRobot:
        """The designed robot."""
        return self.robot

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on the design: dimensions at a bound, tubes that hardly bend the arm, open obstacles, an unusual
        search.
        """
        kept = of_kind(self.task.requirements, Avoid)
        said = (words for one in kept for words in scene_of(one.obstacles).stands_for)
        late = ("the time limit ended the search: a better design may be near",) if self.out_of_time else ()
        return (*remarks(self.robot, self.dimensions), *(f"the clearance is from {words}" for words in said), *late)

    @property
    def status(self) -> DesignStatus:
        """Result of the final check of all requirements, and whether the search finished."""
        if not self.verification.kept:
            return DesignStatus.BROKEN
        return DesignStatus.STOPPED if self.out_of_time else DesignStatus.KEPT

    @property
    def statistics(self) -> DesignStatistics:
        """Starts, rounds and seconds of the search."""
        return DesignStatistics(self.ranking.starts, self.rounds, self.seconds)

    @property
    def attempt(self) -> Attempt:
        """The optimum as the program sees it: where further designs may begin."""
        return self.ranking.designs[0]


# Of the time limit, for the search; what was found is checked in the rest.
SEARCH_SHARE = 0.8

# Rounds of exchange. The worst case moves with the design, by less each round; where it still moves after twelve, a
# program with all cases so far is no better start than another task would be.
ROUNDS = 12

# Designs tried for one that withstands a force: bisection of (0, 1) to FORCE_ACCURACY takes 9, and the secant steps
# before a floor that suffices is known a few more.
FORCE_ROUNDS = 16

# Of the required certificate without force. Half of it takes one design more, each as long as the whole search
# without force.
FORCE_ACCURACY = 2e-3


@typed
@small
@limited
def optimize_design(
    task: DesignTask,
    *,
    starts: Annotated[int, Range(least=1)] = 1,
    seed: Annotated[int, Range(least=0)] = 0,
    workers: int = 1,
    turns: Annotated[int, Range(least=0)] = 6,
    progress: Progress | None = None,
    start: Attempt | None = None,
    time_limit: float = LONG_TIME_LIMIT,
) -> DesignSolution:
    """The best robot that satisfies all requirements of a task, with its verification.

    Unknowns are the free dimensions and the joint values of the task poses; equilibria are solved inside. From every
    start, least squares find a feasible design, and IPOPT the best one near it. That is a local optimum; more starts
    search more widely. Requirements with infinitely many cases (a box of translations, joint paths, a workspace box)
    are added case by case where they are violated. At the end independent code checks everything again.

    Args:
        starts: number of starting points: the given dimensions and random ones. If none gives a feasible design, up to
            4 are tried.
        seed: random seed of starts, turns and samples.
        workers: processes for the starts.
        turns: number of random full turns, per row of translations, to test a certified robot for snaps. They go back
            and forth.
        progress: called with the number of starts done and of all. If it has a method `iteration` and there is one
            worker, that is called with stage and measure after each iteration.
        start: an earlier result for a task with the same unknowns, used as the start.
        time_limit: maximum run time, s. The best design found by then is returned with the status
            `DesignStatus.STOPPED`; a fifth of the time is reserved for its checks.

    Raises:
        InputError: no task, fewer than one start or worker, a seed or turns below 0. A custom requirement or
            objective with an invalid expression.
        DesignNotFoundError: (a SolveError) no start gives a feasible design. The message names the limits that were
            violated most, and limits that can be met.
        InfeasibleDesignError: (a DesignNotFoundError) no feasible design exists, which is proved.
        TimeLimitError: (a SolveError) the design found could not be checked in time.
        SolveError: worst cases did not end, or the design violates a requirement when it is checked again.

    Examples:
        >>> import tubeopt
        >>> from tubeopt.design import Free, Objective, SnapFree
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> free = [Free("curvature", (0, 1, 2), 0.5, 15.0)]
        >>> task = tubeopt.DesignTask(robot, free=free, requirements=[SnapFree(0.05)], objective=Objective("change"))
        >>> tubeopt.optimize_design(task).certificate > 0.0499
        True
    """
    instance("task", task, DesignTask)
    for name, value, least in (("starts", starts, 1), ("workers", workers, 1), ("seed", seed, 0), ("turns", turns, 0)):
        whole(name, value, least)
    began = time.perf_counter()
    search = partial(_searched, starts=starts, seed=seed, workers=workers, progress=progress)
    one = next((one for one in of_kind(task.requirements, SnapFree) if one.max_force), None)
    search_time = SEARCH_SHARE * time_left()
    if one is not None:
        return _certified_for_force(task, one, search, turns, began=began, search_time=search_time)
    with within(search_time):
        found = search(task, begin=start)
    try:
        return solution_of(task, found, turns, began)
    except LateError as late:
        late.best = found[0].designs[0]
        raise


def _searched(
    task: DesignTask,
    begin: Attempt | None = None,
    *,
    starts: int,
    seed: int,
    workers: int,
    progress: Progress | None,
) -> tuple[Ranking, int]:
    """All designs that were found, the best of them for the worst cases, and how often these were added."""
    report: Report | None = getattr(progress, "iteration", None)
    search = partial(multistart, seed=seed, workers=workers, progress=progress, report=report)
    added = None if begin is None else begin.program.added
    if begin is None:
        ranking = search(compile_task(task), starts=starts)
    else:
        ranking = rank([solve_from(recompiled(task, begin.program), begin.x, report, keep=True)])
    retries = task.solver.retries
    if not ranking.designs and starts < retries and not ranking.late:
        ranking = search(compile_task(task, added), starts=retries)
    best, rounds = add_worst_cases(best_of(ranking), report)
    others = [one for one in ranking.designs[1:] if one.program.layout is best.program.layout]
    late = ranking.late + best.late
    return replace(ranking, designs=(best, *(others or ranking.designs[1:])), late=late), rounds


def _certified_for_force(
    task: DesignTask,
    one: SnapFree,
    search: Callable[[DesignTask], tuple[Ranking, int]],
    turns: int,
    *,
    began: float,
    search_time: float,
) -> DesignSolution:
    """The design for a task that names a force; only the one that withstands it is verified.

    The certificate under force is at most that without, and falls with it. So the lower bound of that one is raised
    until the best design above it satisfies the other, which is computed anew for every such design (see
    `stability.loaded_certificate`). The answer is the best among designs of that certificate without force; another
    with a smaller one may withstand the force too.
    """
    known: dict[float, tuple[tuple[Ranking, int], Check]] = {}

    def loaded_certificate(floor: float) -> float:
        """Certificate under the force of the best design with at least `floor` without force."""
        try:
            found = search(_without_force(task, one, floor))
        except DesignNotFoundError as error:
            head = f"no design was found that withstands {one.max_force * 1e3:g} mN"
            raise SolveError(f"{head}; its certificate without force must be {floor:.4f}: {error}") from error
        best = found[0].designs[0]
        check_time()
        value, check = _under_force(best.program, best.robot, one)
        known[floor] = found, check
        return value

    try:
        with within(search_time):
            floor, late = _bisect_floor(one, loaded_certificate), False
    except LateError:
        kept = [floor for floor, (_, check) in known.items() if check.kept]
        if not kept:
            raise
        floor, late = min(kept), True
    found, check = known[floor]
    solution = solution_of(_without_force(task, one, floor), found, turns, began)
    verification = Verification((*solution.verification.checks, check))
    seconds, late = time.perf_counter() - began, late or solution.out_of_time
    return replace(solution, task=task, verification=verification, seconds=seconds, out_of_time=late)


def _without_force(task: DesignTask, one: SnapFree, floor: float) -> DesignTask:
    """The task with a floor of the certificate without force in place of the requirement."""
    plain = replace(one, margin=floor, max_force=0.0)
    return replace(task, requirements=tuple(plain if each is one else each for each in task.requirements))


def _under_force(program: Program, robot: ConcentricRobot, one: SnapFree) -> tuple[float, Check]:
    """The certificate of a design under the force that a requirement names, at all translations for which it was asked,
    and the check that says so."""
    rows = certified_at(program, robot)
    value = min(snap_free_certificate(robot, np.array(row), max_force=one.max_force) for row in rows)
    words = f"certificate under forces on the tip of up to {one.max_force * 1e3:g} mN"
    return value, Check(words, f"{value:.5f}", value >= one.margin)


def _bisect_floor(one: SnapFree, loaded_certificate: Callable[[float], float]) -> float:
    """The least certificate without force, to FORCE_ACCURACY, whose design has the required one under it."""
    low, high = one.margin, None
    floor = one.margin
    for _ in range(FORCE_ROUNDS):
        short = one.margin - loaded_certificate(floor)
        if short <= 0:
            high = floor
            if high - low <= FORCE_ACCURACY:
                return high
            # Uses 90 % of the surplus: the two certificates fall at different rates.
            floor = max((low + high) / 2, high + 0.9 * short)
            continue
        low = floor
        floor = min(floor + 1.1 * short + FORCE_ACCURACY / 2, (low + (1.0 if high is None else high)) / 2)
    if high is None:
        raise SolveError(
            f"no design was found that is certified for {one.max_force * 1e3:g} "
            f"mN: the required certificate without force reached {low:.4f}"
        )
    return high


def add_worst_cases(found: Attempt, report: Report | None = None) -> tuple[Attempt, int]:
    """A design for which all cases hold, and how many rounds of adding the worst of them that took; where a time limit
    ends that, the last one."""
    rounds = 0
    while True:
        try:
            added, why = violations(found.program, found.x)
        except LateError:
            return replace(found, late=True), rounds
        if not why:
            return found, rounds
        if rounds >= ROUNDS:
            raise SolveError(f"worst cases remain after {rounds} rounds: {why}")
        rounds += 1
        program, start = carry(found.program, added, found.x, rounds)
        found = best_of(rank([solve_from(program, start, report, keep=True)]))


def solution_of(task: DesignTask, found: tuple[Ranking, int], turns: int, began: float) -> DesignSolution:
    """The answer that the best of all designs is, checked again; how often worst cases were added to it, and the moment
    `began`, from which it is timed, are told with it."""
    ranking, rounds = found
    best = ranking.designs[0]
    program, x, robot = best.program, best.x, best.robot
    equilibria = solve_again(program, robot, x)
    verification = verify(program, robot, x, equilibria, turns=turns)
    values = {key_of(one): best.value(one) for one in task.objectives}
    certified = certified_at(program, robot) or (tuple(robot.home_translations.tolist()),)
    single = len(task.objectives) == 1 and task.objectives[0].weight == 1.0
    solution = DesignSolution(
        task=task,
        robot=robot,
        certificate=min(snap_free_certificate(robot, row) for row in certified),
        equilibria=equilibria,
        objective=next(iter(values.values())) if single else best.objective,
        objectives=values,
        dimensions=dimensions(program, x),
        sensitivities=sensitivities(best),
        ranking=ranking,
        rounds=rounds,
        added=program.added,
        verification=verification,
        seconds=time.perf_counter() - began,
        out_of_time=bool(ranking.late),
    )
    if not verification.kept:
        raise SolveError(f"verification of the design failed: {verification.broken}", solution)
    return solution


def dimensions(program: Program, x: Array) -> tuple[Dimension, ...]:
    """Free dimensions before and after, tube by tube."""
    space, tubes = program.layout.space, program.layout.space.tubes(x[: program.layout.designs])
    out = []
    for k, (one, name) in enumerate(zip(space.unknowns, space.names, strict=True)):
        unit, factor = UNITS[one.field]
        gap = 1e-5 * space.scale[k]
        bound = "lower" if x[k] <= space.lower[k] + gap else "upper" if x[k] >= space.upper[k] - gap else ""
        if one.pieces:
            out.append(Dimension(name, unit, float(space.start[k]) * factor, float(x[k]) * factor, bound))
            continue
        for i in one.tubes:
            before, after = (getattr(some[i], one.field) * factor for some in (space.robot_tubes, tubes))
            out.append(Dimension(f"{NAMES[one.field]} of tube {i + 1}", unit, before, after, bound))
    return tuple(out)


@dataclass(frozen=True, eq=False)
class FrontPoint:
    """One design of the front: margin demanded, objective in its own sign (SI), and the robot."""

    margin: float
    objective: float
    robot: ConcentricRobot


@dataclass(frozen=True, eq=False)
class ParetoFront:
    """Designs in order of the margin demanded, up to the greatest for which one was found."""

    task: DesignTask
    objective: Annotated[str, "objective that is traded for margin"]
    points: tuple[FrontPoint, ...]
    ended: Annotated[float | None, key("infeasible_from"), "smallest margin without a design"]
    """None where every requested margin has a design."""
    out_of_time: bool = False
    """Whether the time limit ended the front there."""


def front_tasks(task: DesignTask, margins: Sequence[float]) -> list[tuple[float, DesignTask]]:
    """Margins in order of size, each with the task in which it is demanded."""
    if not len(margins):
        raise InputError("margins is empty; a front needs at least one")
    if len(task.objectives) > 1 or key_of(task.objectives[0]) == "margin":
        raise InputError("a front needs one objective, and that other than the margin itself")
    margined = SnapFree | SnapFreeInUse
    if not any(isinstance(one, margined) for one in task.requirements):
        raise InputError("a front needs a certificate or a margin in use among the requirements")
    out = []
    for margin in sorted(finite("a margin of the front", m) for m in margins):
        asked = [replace(one, margin=margin) if isinstance(one, margined) else one for one in task.requirements]
        out.append((margin, replace(task, requirements=tuple(asked))))
    return out


@renamed(begin="start")
@typed
@limited
def pareto_front(
    task: DesignTask,
    margins: Sequence[float],
    *,
    start: Attempt | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    time_limit: float = LONG_TIME_LIMIT,
) -> ParetoFront:
    """The best objective at each of several margins, each solve warm-started from the one before.

    Args:
        margins: demanded of the certificate or in use; they are taken in order of size.
        start: an answer for the least of them, or near it.
        time_limit: s, on the clock, at which the front ends.

    Raises:
        InputError: no margins, one that no certificate or pose can have, a task without certificate or margin in use,
            or with several objectives.
        SolveError: no design was found for the least margin.
    """
    one = task.objectives[0]
    points: list[FrontPoint] = []
    here = start
    tasks = front_tasks(task, margins)
    for k, (margin, eased) in enumerate(tasks):
        if here is None:
            found = best_of(multistart(compile_task(eased), starts=4, seed=seed))
        else:
            found = solve_from(recompiled(eased, here.program), here.x, keep=True)
        try:
            if not found.feasible:
                raise SolveError(f"no design was found with a margin of at least {margin:g}")
            found, _ = add_worst_cases(found)
        except SolveError:
            if not points:
                raise
            return ParetoFront(task, key_of(one), tuple(points), margin, found.late)
        if found.late and points:
            return ParetoFront(task, key_of(one), tuple(points), margin, True)
        points.append(FrontPoint(margin, found.value(one), found.robot))
        here = found
        if progress is not None:
            progress(k + 1, len(tasks))
    return ParetoFront(task, key_of(one), tuple(points), None)
