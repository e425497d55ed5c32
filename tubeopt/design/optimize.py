"""Tube design: the question, and its answer."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, NamedTuple

import numpy as np

from ..arguments import renamed, typed
from ..bodies.obstacles import scene_of
from ..display import Displayed
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, finite, instance, whole
from ..files.field_metadata import Range, key
from ..solvers.blas import small
from ..solvers.time_limit import LONG_TIME_LIMIT, OutOfTimeError, check_time, limited, time_left, within
from ..stability import snap_free_certificate
from ..typing import Array, Progress, StatusEnum
from .evaluation import Attempt, Report
from .exchange import carry, certified_at, worst_cases
from .infeasibility import DesignNotFoundError, best_of
from .objectives import key_of
from .parameters import NAMES, UNITS
from .program import Added, Program, compile_task, recompiled
from .requirements import Avoid, SnapFree, SnapFreeInUse, of_kind
from .sensitivities import Dimension, Sensitivity, remarks, sensitivities
from .solve import Ranking, multistart, rank, solve_from
from .task import DesignedRobot, DesignTask
from .verify import Check, Verification, solve_again, verify


class DesignStatus(StatusEnum):
    """Status of a design, as a sentence."""

    SATISFIED = "the design satisfies all requirements"
    STOPPED = "the design satisfies all requirements; the search for a better one reached the time limit"
    BROKEN = "a design was found, but verification shows that it violates a requirement"


@dataclass(frozen=True)
class DesignStatistics:
    """Number of starts, number of rounds that added worst cases, and run time in seconds."""

    starts: int
    rounds: int
    seconds: float


@dataclass(frozen=True, eq=False)
class DesignSolution(Displayed):
    """Design that satisfies its task."""

    _brief = ("robot", "certificate", "objectives", "status")

    task: DesignTask
    """Task that the design solves."""
    robot: DesignedRobot
    """Robot with the designed tubes."""
    certificate: Annotated[float | None, "lower bound on the margin at all rotations; null if nothing is proved"]
    """Smallest certificate over the translations and the box of the certificate requirements; at home without any."""
    equilibria: Annotated[tuple[Equilibrium, ...], key("poses"), "the task poses"]
    """Equilibria, solved again by forward kinematics, in the order of the requirements."""
    objective: float
    """Value in its own sign, SI; with several objectives their weighted sum as minimised."""
    objectives: dict[str, float]
    """Value of each objective, by kind (custom ones by description), SI."""
    dimensions: Annotated[tuple[Dimension, ...], "free dimensions"]
    sensitivities: Annotated[tuple[Sensitivity, ...], key("binding"), "active requirements"]
    """Gain from relaxing each, the largest first."""
    ranking: Ranking
    """Designs of all starts."""
    rounds: Annotated[int, "number of times that worst cases were added"]
    added: Added
    """The worst cases that were added."""
    verification: Verification
    """Checks of all requirements by independent code."""
    seconds: Annotated[float, "run time, s"]
    out_of_time: bool = False
    """True if the time limit ended the search: a better design may be near."""

    @property
    def value(self) -> DesignedRobot:
        """Robot with the designed tubes."""
        return self.robot

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on the design.

        They name dimensions at a bound, tubes that hardly bend the arm, open obstacles, and an unusual search.
        """
        avoided = of_kind(self.task.requirements, Avoid)
        closed = (body for requirement in avoided for body in scene_of(requirement.obstacles).stands_for)
        late = ("the time limit ended the search: a better design may be near",) if self.out_of_time else ()
        return (
            *remarks(self.robot, self.dimensions),
            *(f"the clearance is from {body}" for body in closed),
            *late,
        )

    @property
    def status(self) -> DesignStatus:
        """Result of the final check of all requirements, and whether the search finished."""
        if not self.verification.satisfied:
            return DesignStatus.BROKEN
        return DesignStatus.STOPPED if self.out_of_time else DesignStatus.SATISFIED

    @property
    def statistics(self) -> DesignStatistics:
        """Starts, rounds and seconds of the search."""
        return DesignStatistics(self.ranking.starts, self.rounds, self.seconds)

    @property
    def attempt(self) -> Attempt:
        """Optimum of the program, a start for further designs."""
        return self.ranking.designs[0]


# Fraction of the time limit for the search; the design is verified in the remaining time.
SEARCH_FRACTION = 0.8

# Rounds of exchange. The worst case moves with the design, by less each round; where it still moves after twelve, a
# program with all cases so far is no better start than another task would be.
ROUNDS = 12

# Designs tried for one that withstands a force: bisection of (0, 1) to FORCE_ACCURACY takes 9, and the secant steps
# before a sufficient required margin is known a few more.
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
    starts: Annotated[int, Range(minimum=1)] = 1,
    seed: Annotated[int, Range(minimum=0)] = 0,
    workers: int = 1,
    turns: Annotated[int, Range(minimum=0)] = 6,
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
    for name, value, lower in (("starts", starts, 1), ("workers", workers, 1), ("seed", seed, 0), ("turns", turns, 0)):
        whole(name, value, lower)
    start_time = time.perf_counter()
    search = partial(_search, starts=starts, seed=seed, workers=workers, progress=progress)
    search_time = SEARCH_FRACTION * time_left()
    for certificate in of_kind(task.requirements, SnapFree):
        if certificate.max_force:
            design = _search_under_force(task, certificate, search, search_time)
            solution = solution_of(design.task, design.ranking, turns, start_time)
            return replace(
                solution,
                task=task,
                verification=Verification((*solution.verification.checks, design.check)),
                seconds=time.perf_counter() - start_time,
                out_of_time=design.out_of_time or solution.out_of_time,
            )
    with within(search_time):
        ranking = search(task, start=start)
    try:
        return solution_of(task, ranking, turns, start_time)
    except OutOfTimeError as error:
        error.best = ranking.designs[0]
        raise


def _search(
    task: DesignTask,
    start: Attempt | None = None,
    *,
    starts: int,
    seed: int,
    workers: int,
    progress: Progress | None,
) -> Ranking:
    """Designs of all starts, the best one first and with the worst cases added to its program."""
    report: Report | None = getattr(progress, "iteration", None)
    search = partial(multistart, seed=seed, workers=workers, progress=progress, report=report)
    added = None
    if start is None:
        ranking = search(compile_task(task), starts=starts)
    else:
        added = start.program.added
        ranking = rank([solve_from(recompiled(task, start.program), start.x, report, keep=True)])
    retries = task.solver.retries
    if not ranking.designs and starts < retries and not ranking.out_of_time:
        ranking = search(compile_task(task, added), starts=retries)
    best, rounds = add_worst_cases(best_of(ranking), report)
    # Designs whose program has the same unknowns come with the same cases; the others can only be listed.
    alike = [design for design in ranking.designs[1:] if design.program.layout is best.program.layout]
    designs = (best, *(alike or ranking.designs[1:]))
    return replace(ranking, designs=designs, out_of_time=ranking.out_of_time + best.out_of_time, rounds=rounds)


class _ForceDesign(NamedTuple):
    """Design that withstands the force of its task."""

    task: DesignTask
    """Task that requires a larger certificate instead of the force."""
    ranking: Ranking
    check: Check
    """Certificate under the force, N."""
    out_of_time: bool
    """True if the time limit ended the search."""


def _search_under_force(
    task: DesignTask, requirement: SnapFree, search: Callable[[DesignTask], Ranking], search_time: float
) -> _ForceDesign:
    """Design for a certificate under force, by bisection of the required certificate without force.

    The certificate under force is at most the one without force, and falls with it. So the required certificate without
    force (`required_margin`) is raised until the best design above it satisfies the requirement under force. That
    is computed anew for every such design (see `loaded_worst_case`). The result is the best design with that
    certificate without force; a design with a smaller one may withstand the force too.
    """
    force = f"{requirement.max_force * 1e3:g} mN"
    low = required_margin = requirement.margin
    best: _ForceDesign | None = None
    high = 1.0  # smallest required margin of a design that withstands the force; no certificate exceeds 1
    out_of_time = False
    try:
        with within(search_time):
            for _ in range(FORCE_ROUNDS):
                unloaded = replace(requirement, margin=required_margin, max_force=0.0)
                requirements = tuple(unloaded if each is requirement else each for each in task.requirements)
                unloaded_task = replace(task, requirements=requirements)
                try:
                    ranking = search(unloaded_task)
                except DesignNotFoundError as error:
                    head = f"no design was found that withstands {force}"
                    raise SolveError(
                        f"{head}; its certificate without force must be {required_margin:.4f}: {error}"
                    ) from error
                check_time()
                design = ranking.designs[0]
                certificate = min(
                    snap_free_certificate(design.robot, np.array(row), max_force=requirement.max_force)
                    for row in certified_at(design.program, design.robot)
                )
                shortfall = requirement.margin - certificate
                if shortfall <= 0:
                    name = f"certificate under forces on the tip of up to {force}"
                    best = _ForceDesign(unloaded_task, ranking, Check(name, f"{certificate:.5f}", True), False)
                    high = required_margin
                    if high - low <= FORCE_ACCURACY:
                        break
                    # Uses 90 % of the surplus: the two certificates fall at different rates.
                    required_margin = max((low + high) / 2, high + 0.9 * shortfall)
                else:
                    low = required_margin
                    required_margin = min(required_margin + 1.1 * shortfall + FORCE_ACCURACY / 2, (low + high) / 2)
    except OutOfTimeError:
        if best is None:
            raise
        out_of_time = True
    if best is None:
        raise SolveError(
            f"no design was found that is certified for {force}: the required certificate without force reached "
            f"{low:.4f}"
        )
    return best._replace(out_of_time=out_of_time)


def add_worst_cases(design: Attempt, report: Report | None = None) -> tuple[Attempt, int]:
    """Design that satisfies all cases of its requirements, and the number of rounds that added the worst cases.

    If a time limit ends the search, this is the last design.
    """
    rounds = 0
    while True:
        try:
            violation = worst_cases(design.program, design.x)
        except OutOfTimeError:
            return replace(design, out_of_time=True), rounds
        if not violation.description:
            return design, rounds
        if rounds >= ROUNDS:
            raise SolveError(f"worst cases remain after {rounds} rounds: {violation.description}")
        rounds += 1
        program, start = carry(design.program, violation.added, design.x, rounds)
        design = best_of(rank([solve_from(program, start, report, keep=True)]))


def solution_of(task: DesignTask, ranking: Ranking, turns: int, start_time: float) -> DesignSolution:
    """Verify the best design, and describe it; its run time counts from `start_time`."""
    best = ranking.designs[0]
    program, x, robot = best.program, best.x, best.robot
    equilibria = solve_again(program, robot, x)
    verification = verify(program, robot, x, equilibria, turns=turns)
    values = {key_of(objective): best.value(objective) for objective in task.objectives}
    certified = certified_at(program, robot) or (tuple(robot.home_translations.tolist()),)
    certificate = min(snap_free_certificate(robot, row) for row in certified)
    single = len(task.objectives) == 1 and task.objectives[0].weight == 1.0
    solution = DesignSolution(
        task=task,
        robot=robot,
        certificate=certificate if np.isfinite(certificate) else None,
        equilibria=equilibria,
        objective=next(iter(values.values())) if single else best.objective,
        objectives=values,
        dimensions=dimensions(program, x),
        sensitivities=sensitivities(best),
        ranking=ranking,
        rounds=ranking.rounds,
        added=program.added,
        verification=verification,
        seconds=time.perf_counter() - start_time,
        out_of_time=bool(ranking.out_of_time),
    )
    if not verification.satisfied:
        raise SolveError(f"verification of the design failed: {verification.violations}", solution)
    return solution


def dimensions(program: Program, x: Array) -> tuple[Dimension, ...]:
    """Free dimensions before and after, tube by tube."""
    space, tubes = program.layout.space, program.layout.space.tubes(x[: program.layout.designs])
    rows = []
    for k, (unknown, name) in enumerate(zip(space.unknowns, space.names, strict=True)):
        unit, factor = UNITS[unknown.field]
        tolerance = 1e-5 * space.scale[k]
        at_lower, at_upper = x[k] <= space.lower[k] + tolerance, x[k] >= space.upper[k] - tolerance
        bound = "lower" if at_lower else "upper" if at_upper else ""
        if unknown.pieces:
            rows.append(Dimension(name, unit, float(space.start[k]) * factor, float(x[k]) * factor, bound))
            continue
        for i in unknown.entries:
            if unknown.field in space.arranged:
                before, after = (
                    space.arranged[unknown.field][i],
                    space.arrangement(x[: len(space.start)])[unknown.field][i],
                )
            else:
                before, after = (getattr(each[i], unknown.field) for each in (space.robot_tubes, tubes))
            name = f"{NAMES[unknown.field]} of tube {i + 1}" if unknown.tubes else name
            rows.append(Dimension(name, unit, before * factor, after * factor, bound))
    return tuple(rows)


@dataclass(frozen=True, eq=False)
class FrontPoint:
    """Design of the front: required margin, objective in its own sign (SI), and the robot."""

    margin: float
    objective: float
    robot: DesignedRobot


@dataclass(frozen=True, eq=False)
class ParetoFront:
    """Designs in order of the required margin, up to the largest margin with a design."""

    task: DesignTask
    objective: Annotated[str, "objective that is traded for margin"]
    points: tuple[FrontPoint, ...]
    ended: Annotated[float | None, key("infeasible_from"), "smallest margin without a design"]
    """Smallest requested margin without a design; None if every margin has one."""
    out_of_time: bool = False
    """True if the time limit ended the front at that margin."""


def front_tasks(task: DesignTask, margins: Sequence[float]) -> list[tuple[float, DesignTask]]:
    """Margins in increasing order, each with the task that requires it."""
    if not len(margins):
        raise InputError("margins is empty; a front needs at least one")
    if len(task.objectives) > 1 or key_of(task.objectives[0]) == "margin":
        raise InputError("a front needs one objective, and that other than the margin itself")
    margined = SnapFree | SnapFreeInUse
    if not any(isinstance(each, margined) for each in task.requirements):
        raise InputError("a front needs a certificate or a margin in use among the requirements")
    tasks = []
    for margin in sorted(finite("a margin of the front", m) for m in margins):
        moved = (replace(each, margin=margin) if isinstance(each, margined) else each for each in task.requirements)
        tasks.append((margin, replace(task, requirements=tuple(moved))))
    return tasks


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
    """Best objective at each of several margins; each solve starts from the design before.

    Args:
        margins: required certificate or margin in use; solved in increasing order.
        start: a design for the smallest margin, or near it.
        time_limit: maximum run time, s; the front ends there.

    Raises:
        InputError: no margins, one that no certificate or pose can have, a task without certificate or margin in use,
            or with several objectives.
        SolveError: no design was found for the smallest margin.
    """
    objective = task.objectives[0]
    points: list[FrontPoint] = []
    tasks = front_tasks(task, margins)
    design = start
    for k, (margin, margin_task) in enumerate(tasks):
        if design is None:
            design = best_of(multistart(compile_task(margin_task), starts=4, seed=seed))
        else:
            design = solve_from(recompiled(margin_task, design.program), design.x, keep=True)
        try:
            if not design.feasible:
                raise SolveError(f"no design was found with a margin of at least {margin:g}")
            design, _ = add_worst_cases(design)
        except SolveError:
            if not points:
                raise
            return ParetoFront(task, key_of(objective), tuple(points), margin, design.out_of_time)
        if design.out_of_time and points:
            return ParetoFront(task, key_of(objective), tuple(points), margin, True)
        points.append(FrontPoint(margin, design.value(objective), design.robot))
        if progress is not None:
            progress(k + 1, len(tasks))
    return ParetoFront(task, key_of(objective), tuple(points), None)
