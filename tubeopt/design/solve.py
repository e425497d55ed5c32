"""Solving a design program: from one start to feasibility, to the optimum, along its kinks; and from many starts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..errors import SolveError
from ..solvers.parallel.executors import executor, run_all
from ..solvers.time_limit import LateError
from ..typing import Array, Progress
from .cells import improve_by_cells
from .collocation import collocate
from .program import Program
from .solve_one import Attempt, Report, attempt, cubed, improve, prices, rows_at, to_feasibility, violation
from .starts import start_values, with_joints

METHODS = ("reduced", "collocation")
"""Ways to the optimum: with the equilibria solved inside, or as unknowns of one program of blocks."""


def solve(program: Program, start: Array, report: Report | None = None, method: str = "reduced") -> Attempt:
    """The best design from a start (X,), SI, by one of METHODS."""
    x = to_feasibility(program, np.clip(start, program.lower, program.upper), report)
    missed = violation(program, x)[0]
    solver = program.task.solver
    near, restarts = solver.optimum.near, solver.starts.restarts if program.layout.free_poses else 0
    for kick in range(restarts):
        if missed <= near:
            break
        random = np.random.default_rng([kick, program.layout.size])
        other = to_feasibility(program, with_joints(program, x[: program.layout.designs], random), report)
        if violation(program, other)[0] < missed:
            x, missed = other, violation(program, other)[0]
    if missed > near:
        return attempt(program, x, None)
    return _collocated(program, x, report) if method == "collocation" else best_from(program, x, report)


def _collocated(program: Program, x: Array, report: Report | None) -> Attempt:
    """The optimum of the collocated program from a design that is nearly feasible; where IPOPT does not converge to
    one, from the optimum of the reduced program, which is the answer where it does not converge from there either."""
    found = _tried(program, x)
    if found.feasible:
        return found
    reduced = best_from(program, x, report)
    if not reduced.feasible:
        return replace(reduced, worst=reduced.worst or found.worst)
    again = _tried(program, reduced.x)
    if again.feasible:
        return again
    return replace(reduced, remark=f"method 'collocation' failed at the {again.worst}; this is the design of 'reduced'")


def _tried(program: Program, x: Array) -> Attempt:
    try:
        return collocate(program, x)
    except SolveError as error:
        return Attempt(program, x, np.inf, np.inf, f"start of the collocated program ({error})", None)


def best_from(program: Program, x: Array, report: Report | None = None) -> Attempt:
    """The optimum from a design that is nearly feasible.

    IPOPT is let loose across all kinks first; where it does not converge, it ends in one order of breakpoints after the
    other.
    """
    return _to_the_rim(program, _in_the_cubes(program, x, report), report)


def _to_the_rim(program: Program, found: Attempt, report: Report | None) -> Attempt:
    """The optimum with whole balls around the targets, where the cubes inside them cost something."""
    if not np.isfinite(found.violation) or _price_of_cubes(program, found) <= program.task.solver.optimum.rim:
        return found
    other = improve(program, found.x, report, program.task.solver.optimum.ball_iterations, exact=True)
    if found.feasible and other.feasible:
        least = program.task.solver.orders.gain * max(abs(found.objective), 1e-3)
        return other if other.objective < found.objective - least else found
    return min(found, other, key=_worse)


def _price_of_cubes(program: Program, found: Attempt) -> float:
    """Relative gain of the objective, to first order, were the cubes to hold the balls; without prices inf where a cube
    binds, and 0 where none does."""
    solver = program.task.solver
    groups, _ = rows_at(program, found.x)
    balls = [group for group in groups if group.vector is not None]
    near = any((cubed(one).values < solver.optimum.rim * one.limit.value / one.limit.size).any() for one in balls)
    if not near:
        return 0.0
    if program.elastic:
        least = solver.relaxation.least_slack
        return np.inf if any(one.slack is not None and one.slack[0] > least for one in balls) else 0.0
    if not found.feasible or found.optimum is None or not found.optimum.success:
        return np.inf
    gains = [
        price * (np.sqrt(3) - 1) * group.limit.value / group.limit.size
        for group, price in zip(groups, prices(groups, found.optimum.multipliers), strict=True)
        if group.vector is not None
    ]
    return float(sum(gains) / max(abs(found.objective), 1e-3))


def _in_the_cubes(program: Program, x: Array, report: Report | None) -> Attempt:
    found = improve(program, x, report)
    if found.feasible and found.optimum is not None and found.optimum.success:
        return found
    candidates = [found, attempt(program, x, None)]
    if np.isfinite(found.violation) and not found.feasible:
        # IPOPT ended just outside.
        candidates.append(attempt(program, to_feasibility(program, found.x, report), None))
    best = min(candidates, key=_worse)
    return min(best, improve_by_cells(program, best.x, report), key=_worse)


def _worse(one: Attempt) -> tuple[bool, float]:
    return not one.feasible, one.objective if one.feasible else one.violation


NOTHING = "a first design, which time did not suffice for"
"""Where no design was looked at."""


@dataclass(frozen=True, eq=False)
class Ranking:
    """What became of all starts."""

    designs: tuple[Attempt, ...]
    """Feasible ones, the best first, each once."""
    found: tuple[int, ...]
    """From how many starts each was reached."""
    failures: dict[str, int]
    """How many starts ended infeasible, by the limit violated most."""
    failed: tuple[Attempt, ...]
    """Where, the least violated first."""

    late: int = 0
    """How many starts a time limit ended."""

    @property
    def starts(self) -> int:
        """Number of starts."""
        return sum(self.found) + sum(self.failures.values())


def solve_from(
    program: Program, start: Array, report: Report | None = None, method: str = "reduced", *, keep: bool = False
) -> Attempt:
    """`solve` on a copy of the program that remembers no poses of other starts, unless it is to `keep` them; the best
    on its way where a time limit ends it."""
    own = program if keep else replace(program, guesses={})
    try:
        return solve(own, start, report, method)
    except LateError:
        return cut_short(own)


def cut_short(program: Program) -> Attempt:
    """The best design that a search had passed when its time was over."""
    best = program.lately.best
    if best is None:
        return Attempt(program, program.lower, np.inf, np.inf, NOTHING, None, late=True)
    x = np.clip(best.x, program.lower, program.upper)
    return Attempt(program, x, best.objective, best.violation, best.worst, None, late=True)


def rank(attempts: Sequence[Attempt]) -> Ranking:
    """Feasible designs in order, duplicates merged; the others counted."""
    designs: list[Attempt] = []
    found: list[int] = []
    for one in sorted((a for a in attempts if a.feasible), key=lambda a: a.objective):
        k = next((k for k, other in enumerate(designs) if _same(one, other)), None)
        if k is None:
            designs.append(one)
            found.append(1)
        else:
            found[k] += 1
    failed = sorted((a for a in attempts if not a.feasible), key=lambda a: a.violation)
    failures = Counter(a.worst for a in failed)
    late = sum(a.late for a in attempts)
    return Ranking(tuple(designs), tuple(found), dict(failures.most_common()), tuple(failed), late)


def _same(a: Attempt, b: Attempt) -> bool:
    count = a.program.layout.designs
    gap = np.abs(a.x[:count] - b.x[:count]) / a.program.scale[:count]
    return bool(gap.max() < a.program.task.solver.starts.same_design)


def multistart(
    program: Program,
    *,
    starts: int = 1,
    seed: int = 0,
    workers: int = 1,
    progress: Progress | None = None,
    report: Report | None = None,
    method: str = "reduced",
) -> Ranking:
    """Solve from the task's own dimensions and from `starts` - 1 others, on so many processes; with one only, `report`
    is told of every iteration. `seed` is of the other dimensions and of the first joint values."""
    begin, workers = start_values(program, seed, starts), min(workers, starts)
    one = partial(solve_from, program, report=report if workers == 1 else None, method=method)
    with executor(workers) as pool:
        return rank(run_all(one, begin, pool, progress))
