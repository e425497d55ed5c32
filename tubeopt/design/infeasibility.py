"""Proofs that no design satisfies a task, from bounds over the ranges of the free dimensions.

A search that ends without a design proves nothing. These bounds do:

- limits that are linear in the free dimensions, such as lengths, walls and clearances: a linear program decides whether
  one design satisfies all of them;
- the strain of a straightened tube, which grows with its curvature and its diameter;
- a target farther from the plate than the longest tube may get: no tube begins beyond the plate;
- the certificate if only curvatures are free: its coupling |c_ij| grows with the size of every curvature, and the
  torsional part of the second variation has none of them, so that it is largest at the smallest curvatures.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import casadi as ca
import numpy as np
import scipy

from ..errors import SolveError, without_unit_warnings
from ..physics.strain import surface_strain
from ..robots.eccentric import BundleRobot
from ..solvers.time_limit import OutOfTimeError
from ..stability import snap_free_certificate
from ..typing import Array
from .constraints import Limit, relaxed
from .evaluation import FEASIBLE, Attempt, Rows, attempt, evaluate, evaluated_at, violation
from .parameters import TUBE_FIELDS, WHOLE
from .program import Program, elastic, points_of, recompiled
from .requirements import Coverage, Reach, SnapFree, Strain, of_kind
from .solve import NEARLY_FEASIBLE, SLACK_TOLERANCE, Ranking, best_from, improve, to_feasibility
from .task import DesignTask, extreme_lengths

# Steps of a limit, or part of a margin, by which a bound must miss it: far above round-off of the bound, far below
# what a designer changes.
SURELY = 1e-6


def shown_infeasible(program: Program) -> str:
    """Reason why no design in the ranges of a task satisfies it; "" if none of the bounds proves it."""
    kinds = (_dimensions, _targets) if program.task.space.pieced else (_dimensions, _strains, _targets, _certificates)
    for kind in kinds:
        for reason in kind(program):
            return reason
    return ""


def _dimensions(program: Program) -> Iterator[str]:
    """Smallest violation t, in steps, of all rows that are linear in the dimensions x.

    A row requires a x + b + t >= 0.
    """
    space = program.layout.space
    rows: list[tuple[Limit, Array, float]] = []
    for statement in (each for stated in program.stated for each in stated):
        expression = statement.expression
        fields = WHOLE if space.pieced else TUBE_FIELDS
        if not all(quantity.pose is None and quantity.name in fields for quantity in expression.quantities):
            continue
        y = ca.SX.sym("y", expression.value.size1_in(0))
        slope = ca.jacobian(expression.value(y), y)
        if ca.depends_on(slope, y):
            continue
        maps = [_linear(program, quantity.name) for quantity in expression.quantities]
        matrix, offset = (np.concatenate([each[k] for each in maps]) for k in (0, 1))
        slopes = np.array(ca.DM(slope)) @ matrix
        values = np.array(expression.value(offset)).ravel()
        rows += [
            (statement.limit, slopes[k] / statement.limit.size, values[k] / statement.limit.size)
            for k in range(len(values))
        ]
    if not rows:
        return
    size = len(space.lower)
    missed = scipy.optimize.linprog(
        np.append(np.zeros(size), 1.0),
        A_ub=-np.column_stack([np.array([slope for _, slope, _ in rows]), np.ones(len(rows))]),
        b_ub=np.array([value for *_, value in rows]),
        bounds=[*zip(space.lower, space.upper, strict=True), (0.0, None)],
    )
    if missed.status == 0 and missed.fun > SURELY:
        against = np.flatnonzero(missed.ineqlin.marginals < -1e-9)
        names = dict.fromkeys(f"{rows[k][0].description} {_at(rows[k][0])}" for k in against)
        yield f"the ranges of the dimensions exclude {' with '.join(names)}"


def _at(limit: Limit) -> str:
    return f"of at {'most' if limit.is_upper_bound else 'least'} {limit.shown()}"


def _linear(program: Program, name: str) -> tuple[Array, Array]:
    """Matrix (n, D) and offset (n,) of a dimension of the tubes as a linear function of x."""
    space = program.layout.space
    offset = np.array([getattr(tube, name) for tube in space.robot_tubes], dtype=float)
    matrix = np.zeros((len(offset), len(space.unknowns)))
    for k, unknown in enumerate(space.unknowns):
        for i in unknown.tubes if unknown.field == name else ():
            matrix[i, k] = offset[i] if unknown.scaled else 1.0
            offset[i] = 0.0
    return matrix, offset


def _smallest_values(program: Program, field: str) -> Array:
    """Value (n,) of a dimension with the smallest absolute value in its range, for each tube."""
    space = program.layout.space
    values = np.array([getattr(tube, field) for tube in space.robot_tubes], dtype=float)
    for unknown, *bounds in zip(space.unknowns, space.lower, space.upper, strict=True):
        for i in unknown.tubes if unknown.field == field else ():
            low, high = sorted(float(bound) * (values[i] if unknown.scaled else 1.0) for bound in bounds)
            values[i] = min(max(0.0, low), high)
    return values


def _strains(program: Program) -> Iterator[str]:
    for requirement in of_kind(program.task.requirements, Strain):
        curvature, outer = (_smallest_values(program, field).tolist() for field in ("curvature", "outer_diameter"))
        for i, (bend, diameter, limit) in enumerate(zip(map(abs, curvature), outer, requirement.limits, strict=True)):
            if not requirement.straightened or bend * diameter >= 2:
                continue
            strain = surface_strain(diameter / 2, bend, bend)
            if strain > limit * (1 + SURELY):
                yield (
                    f"tube {i + 1}, if straightened, is strained by at least {100 * strain:.4g} %, "
                    f"and {100 * limit:.4g} % "
                    "is allowed"
                )


def _targets(program: Program) -> Iterator[str]:
    task = program.task
    longest_tubes = extreme_lengths(task, "upper")
    longest = float((longest_tubes["straight_length"] + longest_tubes["curved_length"]).max())
    for requirement, points in zip(task.requirements, points_of(task.requirements, program.added), strict=True):
        tolerances = [target.tolerance for target in requirement.targets] if isinstance(requirement, Reach) else [
            requirement.tolerance if isinstance(requirement, Coverage) else 0.0] * len(points)  # fmt: skip
        for k, (point, tolerance) in enumerate(zip(points, tolerances, strict=True)):
            far = float(np.linalg.norm(point))
            if far - tolerance > longest + SURELY * longest:
                what = f"target {k + 1}" if isinstance(requirement, Reach) else "a corner of the workspace box"
                yield (
                    f"{what} is {far * 1e3:.4g} mm from the plate, and no tube gets longer than {longest * 1e3:.4g} mm"
                )


def _certificates(program: Program) -> Iterator[str]:
    space = program.layout.space
    if any(unknown.field != "curvature" for unknown in space.unknowns) or isinstance(space.robot, BundleRobot):
        return
    curvatures = _smallest_values(program, "curvature").tolist()
    tubes = tuple(replace(tube, curvature=bend) for tube, bend in zip(space.robot_tubes, curvatures, strict=True))
    with without_unit_warnings():
        robot = replace(program.task.robot, tubes=tubes)
    for requirement in of_kind(program.task.requirements, SnapFree):
        for row in program.layout.certified:
            largest = snap_free_certificate(robot, np.array(row))
            if largest < requirement.required_margin - max(
                SURELY, requirement.tolerance if requirement.box is not None else 0.0
            ):
                yield (
                    f"the certified margin is at most {largest:.4g} in the ranges of the curvatures, and "
                    f"{requirement.required_margin:.4g} is demanded"
                )


# Each takes as long as a design. The starts with the smallest violation come first, closest to the smallest relaxation.
RELAXED_STARTS = 2


@dataclass(frozen=True)
class LimitChange:
    """Relaxation of one limit (`requirement` and `part` as in `Rows`) by `amount` (SI, > 0) to `value`."""

    requirement: int
    part: int
    limit: Limit
    amount: float
    value: float

    @property
    def text(self) -> str:
        """Description as a clause."""
        verb = "rise" if self.limit.is_upper_bound else "fall"
        return f"{self.limit.description} must {verb} from {self.limit.shown()} to {self.limit.shown(self.value)}"


@dataclass(frozen=True, eq=False)
class Relaxation:
    """Relaxation that makes a task feasible: changes of limits, the relaxed task, and its verified feasible design."""

    changes: tuple[LimitChange, ...]
    task: DesignTask
    attempt: Attempt

    @property
    def text(self) -> str:
        """Description of all changes."""
        return " and ".join(change.text for change in self.changes)


class DesignNotFoundError(SolveError):
    """Error after a search without a design that satisfies all requirements; it is no proof of infeasibility.

    The message names the limits that were violated most, and limits with which a design was found.

    relaxations: relaxations that make the task feasible, each verified by solving the relaxed task. First the one with
    the smallest sum of changes, in steps of each limit (`Limit.size`), then those that change a single limit.
    """

    def __init__(self, message: str, relaxations: Sequence[Relaxation], closest: Attempt) -> None:
        super().__init__(message, closest)
        self.relaxations = tuple(relaxations)


class InfeasibleDesignError(DesignNotFoundError):
    """Error after a proof (`design.infeasibility`) that no design satisfies all requirements, with the reason."""


def best_of(ranking: Ranking) -> Attempt:
    """Best design of all starts.

    Raises:
        InfeasibleDesignError: no design exists, which is proved.
        DesignNotFoundError: no design was found.
    """
    if ranking.designs:
        return ranking.designs[0]
    closest, starts = ranking.failed[0], ranking.starts
    shown = shown_infeasible(closest.program)
    limits = "; ".join(
        f"{count} failed most at {name if name.startswith(('a ', 'an ')) else f'the {name}'}"
        for name, count in ranking.failures.items()
    )
    tried = f"of {starts} starts, {limits}"
    if ranking.out_of_time:
        tried += f"; the time limit ended {ranking.out_of_time} of them"
    relaxations: list[Relaxation] = []
    with suppress(OutOfTimeError):
        relaxations = smallest_relaxations(ranking.failed)
    eased = ", or ".join(each.text for each in relaxations) or "no relaxation was found that makes the task feasible"
    if shown:
        message = f"no design meets all requirements, since {shown}; {tried}; {eased}"
        raise InfeasibleDesignError(message, relaxations, closest)
    doubt = "no design was found that meets all requirements; one may still exist"
    raise DesignNotFoundError(f"{doubt}: {tried}; {eased}", relaxations, closest)


def smallest_relaxations(failed: Sequence[Attempt]) -> list[Relaxation]:
    """Relaxations of an infeasible task: with the smallest sum of changes, then up to three of a single limit."""
    solutions: list[_ElasticSolution] = []
    for end in failed[:RELAXED_STARTS]:
        evaluated = evaluate(end.program, end.x)
        if evaluated is not None:
            movable = np.array([group.limit.movable for group in evaluated.groups], dtype=bool)
            relaxed_end = _elastic(end.program, end.x, movable)
            solutions += [] if relaxed_end is None else [relaxed_end]
    if not solutions:
        return []
    smallest = min(solutions, key=lambda solution: solution.slack.sum())
    program, x, slack = smallest
    together = _apply(smallest)
    relaxations = [] if together is None else [together]
    moved = np.flatnonzero(slack > SLACK_TOLERANCE)
    groups = evaluated_at(program, x).groups
    values = [float(group.values.min()) for group in groups]
    by_value = [k for k in np.argsort(values) if groups[k].limit.movable]
    candidates = moved if len(moved) > 1 else np.array([k for k in by_value if k not in moved], dtype=int)
    for k in candidates[:3]:
        single = _elastic(program, x, np.arange(len(values)) == k)
        relaxation = None if single is None else _apply(single)
        relaxations += [] if relaxation is None else [relaxation]
    return relaxations


class _ElasticSolution(NamedTuple):
    """Optimum of a program with slacks."""

    program: Program
    """Program without slacks."""
    x: Array
    """Unknowns (X,), SI."""
    slack: Array
    """Relaxation of each group of rows, in steps of its limit."""


def _elastic(program: Program, start: Array, may_move: Array) -> _ElasticSolution | None:
    """Smallest sum of slacks over the groups that may be relaxed; None if no slack suffices."""
    groups = evaluated_at(program, start).groups
    eased = elastic(program, may_move.tolist())
    slack = np.where(may_move, [max(0.0, -float(group.values.min())) + 1e-2 for group in groups], 0.0)
    x = to_feasibility(eased, np.concatenate([start, slack]))
    if violation(eased, x) > NEARLY_FEASIBLE:
        return None
    best = best_from(eased, x)
    if best.violation > SLACK_TOLERANCE:
        return None
    return _ElasticSolution(program, *np.split(best.x, [len(start)]))


def _apply(solution: _ElasticSolution) -> Relaxation | None:
    """Relax the limits, rounded outwards, and solve the relaxed task; None if no feasible design is found."""
    program, x, slack = solution
    groups = evaluated_at(program, x).groups
    # Enlarged until the relaxed task is found feasible; rounded a little to the strict side first, so that a limit of
    # 160 mm is reported as such.
    for factor, inwards in ((1.0, 0.01), (1.0, 0.0), (1.02, 0.0), (1.04, 0.0), (1.06, 0.0)):
        moves = [
            _change(group, factor * float(s) * group.limit.size, inwards)
            for group, s in zip(groups, slack, strict=True)
            if s > SLACK_TOLERANCE
        ]
        if not moves:
            return None
        easier = recompiled(apply_changes(program.task, moves), program)
        result = attempt(easier, x)
        if not result.feasible:
            result = improve(easier, to_feasibility(easier, x))
        if result.violation <= FEASIBLE:
            return Relaxation(tuple(moves), easier.task, result)
    return None


def apply_changes(task: DesignTask, changes: Sequence[LimitChange]) -> DesignTask:
    """Task with changed limits."""
    requirements = list(task.requirements)
    for change in changes:
        if change.requirement < len(requirements):
            requirement = requirements[change.requirement]
            requirements[change.requirement] = relaxed(requirement, change.part, change.amount)
    return replace(task, requirements=tuple(requirements))


def _change(group: Rows, amount: float, inwards: float) -> LimitChange:
    limit = group.limit
    sign = 1.0 if limit.is_upper_bound else -1.0
    shown = (limit.value + sign * amount) * limit.factor
    digits = 2 - int(np.floor(np.log10(max(abs(shown), 1e-12))))
    step = 10.0 ** -min(max(digits, 0), 8)
    rounded = (
        np.ceil(shown / step - inwards - 1e-9) if limit.is_upper_bound else np.floor(shown / step + inwards + 1e-9)
    ) * step
    value = float(rounded / limit.factor)
    return LimitChange(group.requirement, group.part, limit, abs(value - limit.value), value)
