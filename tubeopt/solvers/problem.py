"""A nonlinear program of variables, constraints and blocks by name, solved by IPOPT in every order of breakpoints."""

from __future__ import annotations

import logging
from collections.abc import Container, Hashable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import InputError, SolveError, nearest
from ..typing import Array
from .named_program import (
    NAMED,
    Attempts,
    NamedProgram,
    ProblemSolution,
    ProblemStatistics,
    ProblemStatus,
    Watch,
)
from .order_swaps import Meeting, kept, order_name, order_rows, passing, restore
from .sampling import sobol
from .settings import AT_SOLUTION, NEAR_SOLUTION, Ipopt

LOGGER = logging.getLogger(__name__)

REORDERINGS = 8
"""Maximum number of swaps of breakpoints."""


class Problem(NamedProgram):
    """A nonlinear program with names, for IPOPT with exact second derivatives.

    Variables, constraints and parameters have a name each; a failed solve reports violated constraints by name.
    Quantities are in their own units; `scale` is their typical size.

    Args:
        name: name of the problem in messages.

    Example:
        >>> import tubeopt
        >>> problem = tubeopt.Problem("rod")
        >>> side = problem.variable("side", 2, guess=1.0, lower=0.0)
        >>> problem.subject_to("area", side[0] * side[1] >= 4.0)
        >>> problem.minimize(side[0] + side[1])
        >>> solution = problem.solve()
        >>> solution.value("side").round(6).tolist(), round(solution.multiplier("area"), 6)
        ([2.0, 2.0], 0.5)
    """

    def solve(
        self, solver: Ipopt | None = None, *, start: ProblemSolution | None = None, reorderings: int = REORDERINGS
    ) -> ProblemSolution:
        """Solve the program from its guesses, or from an earlier solution with its multipliers.

        If breakpoints of a block meet and press against each other, they are swapped if the objective then decreases
        to first order, and the solve continues from there. The new order is kept if the objective does not grow. After
        a failed solve breakpoints that meet are swapped, too.
        `statistics` covers all of it: iterations, solves, swaps, and the decrease of the objective by swaps.

        Args:
            solver: settings.
            start: a solution of this problem or of one with the same names; other variables keep their guess.
            reorderings: maximum number of swaps of breakpoints.

        Raises:
            SolveError: no optimum was found. The message names the worst constraints; `solution` is the last point.
        """
        return _announced(self, _solved(self, solver or Ipopt(), start, reorderings))

    def multistart(
        self, over: Sequence[str], count: int = 16, *, seed: int = 0, solver: Ipopt | None = None
    ) -> ProblemSolution:
        """The best of `count` solves, with starts that fill the bounds of the variables `over` evenly (Sobol).

        Every start includes the equilibria of the blocks at its joint values and dimensions.

        Raises:
            InputError: an unknown variable, or one without finite bounds.
            SolveError: no start reached an optimum. The message counts the results; `solution` is the nearest miss.
        """
        names = [over] if isinstance(over, str) else list(over)
        lower, upper = _box(self, names)
        if count < 1:
            raise InputError(f"count is {count}; it must be at least 1")
        best: tuple[ProblemSolution, list[object]] | None = None
        nearest_miss: ProblemSolution | None = None
        objectives, without_equilibrium, failed = [], 0, 0
        for point in lower + sobol(len(lower), count, seed) * (upper - lower):
            try:
                sizes = np.cumsum([len(self.variables[name].guess) for name in names])[:-1]
                _guess(self, dict(zip(names, np.split(point, sizes), strict=True)))
                for block in self.blocks:
                    block.start_at(lambda part: self.evaluate(part, {}, {}))
            except (InputError, SolveError):
                without_equilibrium += 1
                continue
            try:
                result = _solved(self, solver or Ipopt())
            except SolveError as error:
                failed += 1
                if nearest_miss is None or _violation(error.solution) < _violation(nearest_miss):
                    nearest_miss = error.solution
                continue
            objectives.append(result.objective)
            if best is None or result.objective < best[0].objective:
                best = result, _layouts(self)
        attempts = Attempts(count, len(objectives), without_equilibrium, failed, tuple(sorted(objectives)))
        if best is None:
            worst = f"; nearest: {self.failure(nearest_miss)}" if nearest_miss else ""
            raise SolveError(f"{self.name}: {attempts}{worst}", nearest_miss)
        restore(self, best[1])
        _guess(self, best[0].values)
        return _announced(self, replace(best[0], attempts=attempts))


def _solved(
    problem: NamedProgram, solver: Ipopt, start: ProblemSolution | None = None, reorderings: int = REORDERINGS
) -> ProblemSolution:
    """Optimum in the best order of breakpoints; raises SolveError without one."""
    solution = _in_best_order(problem, solver, start, reorderings)
    if solution.status is not ProblemStatus.SOLVED:
        solution = _retry(problem, solver, solution, reorderings)
        if (swaps := solution.statistics.reorderings) and swaps < reorderings:
            again = _in_best_order(problem, solver, solution, reorderings - swaps)
            if again.status is ProblemStatus.SOLVED:
                efforts, of = [solution.statistics, again.statistics], again.statistics
                solution = _with_effort(again, efforts, swaps + of.reorderings, of.gained)
    if solution.status is not ProblemStatus.SOLVED:
        solution = _with_cause(problem, solver, solution)
        raise SolveError(problem.failure(solution), solution)
    return solution


def _announced(problem: NamedProgram, solution: ProblemSolution) -> ProblemSolution:
    """The solution; a change of the order of breakpoints is logged."""
    of = solution.statistics
    if of.reorderings:
        LOGGER.warning(
            f"{problem.name}: breakpoints changed places, which lowered the objective by {of.gained:.3g} "
            f"({of.solves} solves, {of.iterations} iterations)"
        )
    return solution


def _in_best_order(problem: NamedProgram, solver: Ipopt, start: ProblemSolution | None, limit: int) -> ProblemSolution:
    """Solution after swapping breakpoints that are pushed past each other, as long as the objective does not grow.

    Only breakpoints that pass each other with a smaller objective, to first order, are swapped (`order_swaps`). The
    first swap interrupts the solver when it is close to the optimum of the order. Every pair of breakpoints is swapped
    at most once.
    """
    meeting = Meeting(problem) if limit else None
    swapped: set[object] = set()
    points: list[ProblemSolution] = []
    result = problem.attempt(solver, start=start, interrupt=meeting)
    efforts = [result.statistics]
    while not (worse := _is_worse(result, points)):
        passed: dict[Any, list[int]] = {}
        if meeting is not None and _interrupted(result):
            passed = meeting.passing
        elif len(points) < limit:
            passed = _passing_at(problem, result, swapped)
        if not passed:
            break
        points.append(result)
        layouts = _layouts(problem)
        for block, rows in passed.items():
            swapped.update(block.pair(row) for row in rows)
            block.reorder(result, rows)
        _begin_at(problem, result, passed)
        # The point is feasible and nearly optimal in the new order too, so the solve starts with the multipliers of
        # the old one. Only those of the order itself would hold the breakpoints together.
        names = {order_name(block) for block in passed}
        multipliers = {name: values for name, values in result.multipliers.items() if name not in names}
        again = replace(result, values={}, multipliers=multipliers)
        result = problem.attempt(solver, start=again, warm=NEAR_SOLUTION if _interrupted(result) else AT_SOLUTION)
        efforts.append(result.statistics)
    if worse and points:
        # The last swap did not help: back to the point before it.
        restore(problem, layouts)
        result = points.pop()
        if _interrupted(result):
            result = problem.attempt(solver, start=result, warm=NEAR_SOLUTION)
            efforts.append(result.statistics)
    gained = points[0].objective - result.objective if points else 0.0
    return _with_effort(result, efforts, len(points), gained)


def _passing_at(problem: NamedProgram, solution: ProblemSolution, swapped: Container[object]) -> dict[Any, list[int]]:
    """Rows of every block whose breakpoints coincide at an optimum and pass each other, without those `swapped`."""
    if all(block.pressing(solution) is None for block in problem.blocks):
        return {}
    closed = {block: block.closed(solution) for block in problem.blocks}
    order = order_rows(problem)[0]
    near = np.array([row in closed[block] for block, row in order])
    fresh = np.array([block.pair(row) not in swapped for block, row in order])
    return passing(problem, solution, near & fresh, near) if (near & fresh).any() else {}


def _is_worse(result: ProblemSolution, points: Sequence[ProblemSolution]) -> bool:
    """True for a failed solve, or for a larger objective than at the last point before a swap."""
    if result.status is not ProblemStatus.SOLVED and not _interrupted(result):
        return True
    if not points:
        return False
    before = points[-1].objective
    return result.objective > before + 1e-7 * max(1.0, abs(before))


def _interrupted(result: ProblemSolution) -> bool:
    """True if a `Meeting` stopped the solver."""
    return result.statistics.verdict == Watch.STOPPED


def _with_effort(
    result: ProblemSolution, efforts: Sequence[ProblemStatistics], reorderings: int, gained: float = 0.0
) -> ProblemSolution:
    """Result with the statistics of all attempts."""
    statistics = replace(
        result.statistics,
        iterations=sum(each.iterations for each in efforts),
        seconds=sum(each.seconds for each in efforts),
        solves=sum(each.solves for each in efforts),
        reorderings=reorderings,
        gained=gained,
    )
    return replace(result, statistics=statistics)


def _retry(problem: NamedProgram, solver: Ipopt, missed: ProblemSolution, limit: int) -> ProblemSolution:
    """Solution after swapping breakpoints that coincide at the end of a failed solve, one of every block at a time.

    If the order of breakpoints makes the problem infeasible, the solver ends where they meet. Returns the first
    success, or the first failure with the problem as it was.
    """
    layouts, first, efforts = _layouts(problem), missed, [missed.statistics]
    guesses = {name: each.guess for name, each in problem.variables.items()}
    visited = {_arrangement(problem)}
    for _ in range(limit):
        blocked = [block for block in problem.blocks if block.closed(missed)]
        for block in blocked:
            block.reorder(missed)
        if not blocked or _arrangement(problem) in visited:
            break
        visited.add(_arrangement(problem))
        _begin_at(problem, missed, blocked)
        missed = problem.attempt(solver)
        efforts.append(missed.statistics)
        if missed.status is ProblemStatus.SOLVED:
            return _with_effort(missed, efforts, len(efforts) - 1)
    restore(problem, layouts)
    _guess(problem, guesses)
    return _with_effort(first, efforts, 0)


def _with_cause(problem: NamedProgram, solver: Ipopt, failed: ProblemSolution) -> ProblemSolution:
    """Failed solution with the violations of the user's constraints at the equilibria of its joint values.

    The solver shares a contradiction among all constraints, and the equations of a block may be violated the most.
    """
    owned = tuple(block.label for block in problem.blocks if block.label)
    names = [name for name in problem.constraint_sizes if not name.startswith(owned)]
    try:
        with kept(problem):
            for block in problem.blocks:
                block.start_at(lambda part: problem.evaluate(part, failed.values, {}))
            at_equilibria = {
                name: each.guess if name.startswith(owned) else failed.values[name]
                for name, each in problem.variables.items()
            }
            violations = problem.violated(names, at_equilibria, 10 * solver.tolerance)
    except (InputError, SolveError):
        violations = ()
    equations = [each for each in failed.violations if each.name.startswith(owned)]
    return replace(failed, violations=(*violations, *equations)[:NAMED] if violations else failed.violations)


def _begin_at(problem: NamedProgram, solution: ProblemSolution, swapped: Iterable[Any]) -> None:
    """Start all variables at a solution but those of `swapped` blocks, which have set their own start."""
    owned = {name for name in solution.values for block in swapped if block.owns(name)}
    _guess(problem, {name: value for name, value in solution.values.items() if name not in owned})


def _guess(problem: NamedProgram, values: Mapping[str, Array]) -> None:
    """Set the start values of variables by name."""
    for name, value in values.items():
        problem.set_guess(name, value)


def _layouts(problem: NamedProgram) -> list[object]:
    return [block.layout for block in problem.blocks]


def _arrangement(problem: NamedProgram) -> Hashable:
    """Orders of the breakpoints of all blocks."""
    return tuple((block.layout.order.front, block.layout.order.behind) for block in problem.blocks)


def _box(problem: NamedProgram, names: list[str]) -> tuple[Array, Array]:
    """Bounds of variables as one column each."""
    variables = problem.variables
    for name in names:
        if name not in variables:
            raise InputError(f"over has {name!r}; there is no such variable{nearest(name, variables)}")
        if not np.isfinite([variables[name].lower, variables[name].upper]).all():
            raise InputError(f"variable {name!r} has no finite bounds; starts are spread between lower and upper")
    if not names:
        raise InputError("over is empty; it must name variables")
    lower, upper = (np.concatenate([getattr(variables[name], side) for name in names]) for side in ("lower", "upper"))
    return lower, upper


def _violation(solution: ProblemSolution) -> float:
    """Largest violation of a constraint over its scale, 0 if none is violated."""
    return solution.violations[0].relative if solution.violations else 0.0
