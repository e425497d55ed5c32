"""Why no design was found: the smallest relaxation of the limits with which one was, in words, and verified."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ..errors import SolveError
from ..solvers.time_limit import LateError
from ..typing import Array
from .attempt import FEASIBLE, Attempt, attempt, evaluate, evaluated_at, improve, to_feasibility, violation
from .constraints import Limit, relaxed
from .infeasibility import shown_infeasible
from .multistart import Ranking
from .program import Program, elastic, recompiled
from .rows import Rows
from .solve import best_from
from .task import DesignTask


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
    for one in failed[: failed[0].program.task.solver.relaxation.starts]:
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
    moved = np.flatnonzero(slack > program.task.solver.relaxation.least_slack)
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
    if violation(eased, begin) > program.task.solver.optimum.near:
        return None
    best, enough = best_from(eased, begin), program.task.solver.relaxation.missing
    return (best.x[: len(start)], best.x[len(start) :]) if best.violation <= enough else None


def _apply(program: Program, x: Array, slack: Array) -> Relaxation | None:
    """Move the limits, rounded outwards, and solve the relaxed task; None where it is not found feasible."""
    groups = evaluated_at(program, x).groups
    # Enlarged until the relaxed task is found feasible; rounded a little to the demanding side, so that a limit of
    # 160 mm is told as such.
    for factor, inwards in ((1.0, 0.01), (1.0, 0.0), (1.02, 0.0), (1.04, 0.0), (1.06, 0.0)):
        moves = [
            _change(group, factor * float(s) * group.limit.size, inwards)
            for group, s in zip(groups, slack, strict=True)
            if s > program.task.solver.relaxation.least_slack
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
