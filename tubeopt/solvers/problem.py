"""A nonlinear program of variables, constraints and blocks by name, solved by IPOPT in every order of breakpoints."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..errors import InputError, SolveError, nearest
from ..typing import Array
from .named_program import Attempts, NamedProgram, ProblemSolution, ProblemStatus
from .sampling import sobol
from .settings import Ipopt


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
        self, solver: Ipopt | None = None, *, start: ProblemSolution | None = None, reorderings: int = 8
    ) -> ProblemSolution:
        """Solve the program from its guesses, or from an earlier solution with its multipliers.

        If breakpoints of a block meet at the optimum and their order has a multiplier, they are swapped. The problem is
        then solved again from there, as long as the objective does not grow. The same happens after a failed solve.
        `statistics` has the number of swaps and solves, and the decrease of the objective.

        Args:
            solver: settings.
            start: a solution of this problem or of one with the same names; other variables keep their guess.
            reorderings: maximum number of swaps of breakpoints.

        Raises:
            SolveError: no optimum was found. The message names the worst constraints; `solution` is the last point.
        """
        settings = solver or Ipopt()
        solution = self.attempt(settings, start=start)
        if solution.status is not ProblemStatus.SOLVED:
            solution = _retry(self, settings, solution, reorderings)
        if solution.status is not ProblemStatus.SOLVED:
            raise SolveError(self.failure(solution), solution)
        return _improve(self, settings, solution, reorderings)

    def multistart(
        self, over: Sequence[str], count: int = 16, *, seed: int = 0, solver: Ipopt | None = None
    ) -> ProblemSolution:
        """The best of `count` solves, with starts that fill the bounds of the variables `over` evenly (Sobol).

        Every start includes the equilibria of the blocks at its joint values and dimensions.

        Raises:
            InputError: an unknown variable, or one without finite bounds.
            SolveError: no start led to an optimum. The message counts the results; `solution` is the nearest miss.
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
                result = self.solve(solver)
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
        _restore(self, best[1])
        _guess(self, best[0].values)
        return replace(best[0], attempts=attempts)


def _improve(problem: NamedProgram, solver: Ipopt, solution: ProblemSolution, limit: int) -> ProblemSolution:
    """Swap breakpoints that press against each other and solve again, as long as the objective does not grow.

    A swap that changes nothing is kept as well: of several breakpoints at one position, all have to be swapped before
    the objective decreases. No arrangement is solved twice.
    """
    best, at, seconds, count, solves = solution, _layouts(problem), solution.statistics.seconds, 0, 1
    visited = {_arrangement(problem)}
    while count < limit:
        pressed = [(block, row) for block in problem.blocks if (row := block.pressing(best)) is not None]
        if not pressed:
            break
        for block, row in pressed:
            block.reorder(best, row)
        if _arrangement(problem) in visited:
            _restore(problem, at)
            break
        visited.add(_arrangement(problem))
        _begin_at(problem, best)
        # The point is feasible and nearly optimal in the new order too, so the solve starts with the multipliers of
        # the old one. Only those of the order itself would hold the breakpoints together.
        multipliers = {name: v for name, v in best.multipliers.items() if name not in order_names(problem)}
        result = problem.attempt(solver, start=replace(best, values={}, multipliers=multipliers))
        solves, seconds = solves + 1, seconds + result.statistics.seconds
        tolerance = 1e-7 * max(1.0, abs(best.objective))
        if result.status is not ProblemStatus.SOLVED or result.objective > best.objective + tolerance:
            _restore(problem, at)
            break
        best, at, count = result, _layouts(problem), count + 1
    gained = solution.objective - best.objective if count else 0.0
    statistics = replace(best.statistics, reorderings=count, seconds=seconds, solves=solves, gained=gained)
    return replace(best, statistics=statistics)


def order_names(problem: NamedProgram) -> set[str]:
    """Names of the constraints on the order of breakpoints."""
    return {f"{block.label}order of breakpoints" for block in problem.blocks}


def _retry(problem: NamedProgram, solver: Ipopt, missed: ProblemSolution, limit: int) -> ProblemSolution:
    """Swap breakpoints that meet at the end of a failed solve, one of every block at a time, and solve again.

    If the order of breakpoints makes the problem infeasible, the solver ends where they meet. Returns the first
    success, or the first failure with the problem as it was.
    """
    layouts, first = _layouts(problem), missed
    guesses = {name: each.guess for name, each in problem.variables.items()}
    visited = {_arrangement(problem)}
    for _ in range(limit):
        blocked = [block for block in problem.blocks if block.closed(missed)]
        for block in blocked:
            block.reorder(missed)
        if not blocked or _arrangement(problem) in visited:
            break
        visited.add(_arrangement(problem))
        _begin_at(problem, missed)
        missed = problem.attempt(solver)
        if missed.status is ProblemStatus.SOLVED:
            return missed
    _restore(problem, layouts)
    _guess(problem, guesses)
    return first


def _begin_at(problem: NamedProgram, solution: ProblemSolution) -> None:
    """Start the variables that belong to no block at a solution; blocks have set their own start."""
    owned = {name for name in solution.values for block in problem.blocks if block.owns(name)}
    _guess(problem, {name: value for name, value in solution.values.items() if name not in owned})


def _guess(problem: NamedProgram, values: Mapping[str, Array]) -> None:
    """Set the start of variables by name."""
    for name, value in values.items():
        problem.set_guess(name, value)


def _layouts(problem: NamedProgram) -> list[object]:
    return [block.layout for block in problem.blocks]


def _restore(problem: NamedProgram, layouts: list[object]) -> None:
    for block, layout in zip(problem.blocks, layouts, strict=True):
        if block.layout is not layout:
            block.restore(layout)


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
