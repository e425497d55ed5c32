"""What shows that no design can meet a task: bounds that hold for all designs in the ranges of the free dimensions.

A search that ends without a design shows nothing. These do:

- limits on dimensions that are linear in what is free, as lengths, walls and clearances: a linear program finds whether
  one design keeps all of them;
- the strain of a tube that is held straight, which grows with its curvature and its diameter;
- a target farther from the plate than the longest tube may get: no tube begins beyond the plate;
- the certificate where only curvatures are free: its coupling |c_ij| grows with the size of every curvature, the
  torsional part of the second variation has none of them, so that it is largest at the least curvatures.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import scipy

from ..errors import SolveError, without_unit_warnings
from ..physics.strain import surface_strain
from ..solvers.time_limit import LateError
from ..stability import snap_free_certificate
from ..typing import Array
from .constraints import Limit, relaxed
from .evaluation import FEASIBLE, Attempt, Rows, attempt, evaluate, evaluated_at, violation
from .parameters import TUBE_FIELDS, WHOLE
from .program import Program, elastic, points_of, recompiled
from .requirements import Coverage, Reach, SnapFree, Strain, of_kind
from .solve import LEAST_SLACK, NEARLY_FEASIBLE, Ranking, best_from, improve, to_feasibility
from .task import DesignTask, extreme_lengths

# Steps of a limit, or part of a margin, by which a bound must miss it: far above round-off of the bound, far below
# what a designer changes.
SURELY = 1e-6


def shown_infeasible(program: Program) -> str:
    """Why no design in the ranges of a task meets it, in words; "" where nothing of this kind shows it."""
    kinds = (_dimensions, _targets) if program.task.space.pieced else (_dimensions, _strains, _targets, _certificates)
    for kind in kinds:
        for words in kind(program):
            return words
    return ""


def _dimensions(program: Program) -> Iterator[str]:
    """Least violation t, in steps, of all rows a x + b + t >= 0 that are linear in the dimensions x."""
    space = program.layout.space
    rows: list[tuple[Limit, Array, float]] = []
    for statement in (each for stated in program.stated for each in stated):
        found = statement.expression
        fields = WHOLE if space.pieced else TUBE_FIELDS
        if not all(one.pose is None and one.name in fields for one in found.quantities):
            continue
        y = ca.SX.sym("y", found.value.size1_in(0))
        slope = ca.jacobian(found.value(y), y)
        if ca.depends_on(slope, y):
            continue
        maps = [_linear(program, one.name) for one in found.quantities]
        matrix, offset = (np.concatenate([each[k] for each in maps]) for k in (0, 1))
        slopes = np.array(ca.DM(slope)) @ matrix
        values = np.array(found.value(offset)).ravel()
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
        names = dict.fromkeys(f"{rows[k][0].words} {_at(rows[k][0])}" for k in against)
        yield f"the ranges of the dimensions exclude {' with '.join(names)}"


def _at(limit: Limit) -> str:
    return f"of at {'most' if limit.most else 'least'} {limit.shown()}"


def _linear(program: Program, name: str) -> tuple[Array, Array]:
    """Matrix (n, D) and offset (n,) by which a dimension of the tubes follows from x."""
    space = program.layout.space
    offset = np.array([getattr(tube, name) for tube in space.robot_tubes], dtype=float)
    matrix = np.zeros((len(offset), len(space.unknowns)))
    for k, one in enumerate(space.unknowns):
        for i in one.tubes if one.field == name else ():
            matrix[i, k] = offset[i] if one.scaled else 1.0
            offset[i] = 0.0
    return matrix, offset


def _least(program: Program, field: str) -> Array:
    """(n,) the least size of a dimension of the tubes that their ranges have, with its sign."""
    space = program.layout.space
    found = np.array([getattr(tube, field) for tube in space.robot_tubes], dtype=float)
    for one, *bounds in zip(space.unknowns, space.lower, space.upper, strict=True):
        for i in one.tubes if one.field == field else ():
            low, high = sorted(float(bound) * (found[i] if one.scaled else 1.0) for bound in bounds)
            found[i] = min(max(0.0, low), high)
    return found


def _strains(program: Program) -> Iterator[str]:
    for one in of_kind(program.task.requirements, Strain):
        curvature, outer = (_least(program, field).tolist() for field in ("curvature", "outer_diameter"))
        for i, (bend, diameter, most) in enumerate(zip(map(abs, curvature), outer, one.limits, strict=True)):
            if not one.straightened or bend * diameter >= 2:
                continue
            least = surface_strain(diameter / 2, bend, bend)
            if least > most * (1 + SURELY):
                yield (
                    f"tube {i + 1} held straight is strained by at least {100 * least:.4g} %, and {100 * most:.4g} % "
                    "is allowed"
                )


def _targets(program: Program) -> Iterator[str]:
    task = program.task
    most = extreme_lengths(task, "upper")
    longest = float((most["straight_length"] + most["curved_length"]).max())
    for one, points in zip(task.requirements, points_of(task.requirements, program.added), strict=True):
        tolerances = [target.tolerance for target in one.targets] if isinstance(one, Reach) else [
            one.tolerance if isinstance(one, Coverage) else 0.0] * len(points)  # fmt: skip
        for k, (point, tolerance) in enumerate(zip(points, tolerances, strict=True)):
            far = float(np.linalg.norm(point))
            if far - tolerance > longest + SURELY * longest:
                what = f"target {k + 1}" if isinstance(one, Reach) else "a corner of the workspace box"
                yield (
                    f"{what} is {far * 1e3:.4g} mm from the plate, and no tube gets longer than {longest * 1e3:.4g} mm"
                )


def _certificates(program: Program) -> Iterator[str]:
    space = program.layout.space
    if any(one.field != "curvature" for one in space.unknowns):
        return
    least = _least(program, "curvature").tolist()
    tubes = tuple(replace(tube, curvature=bend) for tube, bend in zip(space.robot_tubes, least, strict=True))
    with without_unit_warnings():
        robot = replace(program.task.robot, tubes=tubes)
    for one in of_kind(program.task.requirements, SnapFree):
        for row in program.layout.certified:
            most = snap_free_certificate(robot, np.array(row))
            if most < one.floor - max(SURELY, one.tolerance if one.box is not None else 0.0):
                yield (
                    f"the certified margin is at most {most:.4g} in the ranges of the curvatures, and {one.floor:.4g} "
                    "is demanded"
                )


# Each takes as long as a design. The starts that failed least come first, and are the nearest to the least relaxation.
RELAXED_STARTS = 2


@dataclass(frozen=True)
class Change:
    """One limit that must move: `requirement` and `part` as in `Rows`, by `amount` (SI, > 0) to `value`."""

    requirement: int
    part: int
    limit: Limit
    amount: float
    value: float

    @property
    def words(self) -> str:
        """What must happen, as a clause."""
        verb = "rise" if self.limit.most else "fall"
        return f"{self.limit.words} must {verb} from {self.limit.shown()} to {self.limit.shown(self.value)}"


@dataclass(frozen=True, eq=False)
class Relaxation:
    """A way to make a task feasible: limits that move, the task with them moved, and its verified feasible design."""

    changes: tuple[Change, ...]
    task: DesignTask
    attempt: Attempt

    @property
    def words(self) -> str:
        """All changes."""
        return " and ".join(change.words for change in self.changes)


class DesignNotFoundError(SolveError):
    """No search ended with a design that meets all requirements, which does not show that there is none; the message
    names the limits that were violated most, and with which other limits a design was found.

    relaxations: ways to make the task feasible: first the one with the least sum of moves, each in steps of its limit
    (`Limit.size`), then those in which one limit moves alone; each was verified by solving the relaxed task.
    """

    def __init__(self, message: str, relaxations: Sequence[Relaxation], closest: Attempt) -> None:
        super().__init__(message, closest)
        self.relaxations = tuple(relaxations)


class InfeasibleDesignError(DesignNotFoundError):
    """It is shown that no design meets all requirements (`design.infeasibility`); the message says how."""


def best_of(ranking: Ranking) -> Attempt:
    """The best design of all starts.

    Raises:
        InfeasibleDesignError: it is shown that there is none.
        DesignNotFoundError: none was found.
    """
    if ranking.designs:
        return ranking.designs[0]
    closest, starts = ranking.failed[0], ranking.starts
    shown = shown_infeasible(closest.program)
    limits = "; ".join(f"{count} failed most at {_with_article(name)}" for name, count in ranking.failures.items())
    tried = f"of {starts} starts, {limits}"
    if ranking.late:
        tried += f"; the time limit ended {ranking.late} of them"
    ways: list[Relaxation] = []
    with suppress(LateError):
        ways = smallest_relaxations(ranking.failed)
    eased = ", or ".join(way.words for way in ways) or "no relaxation was found that makes the task feasible"
    if shown:
        raise InfeasibleDesignError(f"no design meets all requirements, since {shown}; {tried}; {eased}", ways, closest)
    doubt = "no design was found that meets all requirements; one may still exist"
    raise DesignNotFoundError(f"{doubt}: {tried}; {eased}", ways, closest)


def _with_article(limit: str) -> str:
    return limit if limit.startswith(("a ", "an ")) else f"the {limit}"


def smallest_relaxations(failed: Sequence[Attempt]) -> list[Relaxation]:
    """The relaxation with the least sum of moves that is found near where starts failed, and up to three in which one
    limit moves alone."""
    sums: list[tuple[float, Program, Array, Array]] = []
    for one in failed[:RELAXED_STARTS]:
        found = evaluate(one.program, one.x)
        if found is not None:
            movable = np.array([group.limit.movable for group in found.groups], dtype=bool)
            eased = _elastic(one.program, one.x, movable)
            sums += [] if eased is None else [(float(eased[1].sum()), one.program, *eased)]
    if not sums:
        return []
    _, program, x, slack = min(sums, key=lambda item: item[0])
    together = _apply(program, x, slack)
    out = [] if together is None else [together]
    moved = np.flatnonzero(slack > LEAST_SLACK)
    groups = evaluated_at(program, x).groups
    values = [float(group.values.min()) for group in groups]
    near = [k for k in np.argsort(values) if groups[k].limit.movable]
    candidates = moved if len(moved) > 1 else np.array([k for k in near if k not in moved], dtype=int)
    for k in candidates[:3]:
        single = _elastic(program, x, np.arange(len(values)) == k)
        relaxation = None if single is None else _apply(program, *single)
        out += [] if relaxation is None else [relaxation]
    return out


def _elastic(program: Program, start: Array, may_move: Array) -> tuple[Array, Array] | None:
    """x and slack of every group (steps) with the least sum; None where no slack of the allowed groups suffices."""
    groups = evaluated_at(program, start).groups
    eased = elastic(program, may_move.tolist())
    slack = np.where(may_move, [max(0.0, -float(group.values.min())) + 1e-2 for group in groups], 0.0)
    begin = to_feasibility(eased, np.concatenate([start, slack]))
    if violation(eased, begin) > NEARLY_FEASIBLE:
        return None
    best = best_from(eased, begin)
    return (best.x[: len(start)], best.x[len(start) :]) if best.violation <= LEAST_SLACK else None


def _apply(program: Program, x: Array, slack: Array) -> Relaxation | None:
    """Move the limits, rounded outwards, and solve the relaxed task; None where it is not found feasible."""
    groups = evaluated_at(program, x).groups
    # Enlarged until the relaxed task is found feasible; rounded a little to the demanding side, so that a limit of
    # 160 mm is told as such.
    for factor, inwards in ((1.0, 0.01), (1.0, 0.0), (1.02, 0.0), (1.04, 0.0), (1.06, 0.0)):
        moves = [
            _change(group, factor * float(s) * group.limit.size, inwards)
            for group, s in zip(groups, slack, strict=True)
            if s > LEAST_SLACK
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


def apply_changes(task: DesignTask, changes: Sequence[Change]) -> DesignTask:
    """The task with limits moved."""
    requirements = list(task.requirements)
    for change in changes:
        if change.requirement < len(requirements):
            one = requirements[change.requirement]
            requirements[change.requirement] = relaxed(one, change.part, change.amount)
    return replace(task, requirements=tuple(requirements))


def _change(group: Rows, amount: float, inwards: float) -> Change:
    limit = group.limit
    sign = 1.0 if limit.most else -1.0
    shown = (limit.value + sign * amount) * limit.factor
    digits = 2 - int(np.floor(np.log10(max(abs(shown), 1e-12))))
    step = 10.0 ** -min(max(digits, 0), 8)
    rounded = (np.ceil(shown / step - inwards - 1e-9) if limit.most else np.floor(shown / step + inwards + 1e-9)) * step
    value = float(rounded / limit.factor)
    return Change(group.requirement, group.part, limit, abs(value - limit.value), value)
