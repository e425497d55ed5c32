"""A nonlinear program with names: composed of variables, constraints and blocks, solved by IPOPT."""

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

    Variables, constraints and parameters have a name each; a failed solve says by name what was violated. Everything is
    in its own units; `scale` is the size that it typically has.

    Args:
        name: what to call it in messages.

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

        Breakpoints of a block that meet at the optimum and press against each other are swapped. The solve then
        continues as long as the objective does not grow. The same happens at the end of a failed solve.

        Args:
            solver: settings.
            start: a solution of this problem or of one with the same names; other variables keep their guess.
            reorderings: maximum number of swaps of breakpoints.

        Raises:
            SolveError: no optimum was found. The message names the worst constraints; `solution` is the last point.
        """
        own = solver or Ipopt()
        solution = self.attempt(own, start=start)
        if solution.status is not ProblemStatus.SOLVED:
            solution = _retry(self, own, solution, reorderings)
        if solution.status is not ProblemStatus.SOLVED:
            raise SolveError(self.failure(solution), solution)
        return _improve(self, own, solution, reorderings)

    def multistart(
        self, over: Sequence[str], count: int = 16, *, seed: int = 0, solver: Ipopt | None = None
    ) -> ProblemSolution:
        """The best of `count` solves with starts that fill the bounds of the variables `over` evenly (Sobol).

        At every start the blocks begin at the equilibrium of their joint values and dimensions there.

        Raises:
            InputError: an unknown variable, or one without finite bounds.
            SolveError: no start led to an optimum. The message counts the results; `solution` is the nearest miss.
        """
        names = [over] if isinstance(over, str) else list(over)
        lower, upper = _box(self, names)
        if count < 1:
            raise InputError(f"count is {count}; it must be at least 1")
        best: tuple[ProblemSolution, list[object]] | None = None
        missed: ProblemSolution | None = None
        objectives, astray, failed = [], 0, 0
        for point in lower + sobol(len(lower), count, seed) * (upper - lower):
            try:
                _begin_at_point(self, names, point)
            except (InputError, SolveError):
                astray += 1
                continue
            try:
                result = self.solve(solver)
            except SolveError as error:
                failed, missed = failed + 1, _nearer(missed, error.solution)
                continue
            objectives.append(result.objective)
            if best is None or result.objective < best[0].objective:
                best = result, _layouts(self)
        attempts = Attempts(count, len(objectives), astray, failed, tuple(sorted(objectives)))
        if best is None:
            worst = f"; nearest: {self.failure(missed)}" if missed else ""
            raise SolveError(f"{self.name}: {attempts}{worst}", missed)
        _restore(self, best[1])
        _guess(self, best[0].values)
        return replace(best[0], attempts=attempts)


def _improve(problem: NamedProgram, solver: Ipopt, solution: ProblemSolution, limit: int) -> ProblemSolution:
    """Let breakpoints that press against each other change places, and keep the best that comes of it.

    A change that neither gains nor loses is kept as well: of several breakpoints at one place, one after the other has
    to move before anything is gained. No arrangement is visited twice.
    """
    best, at, seconds, count = solution, _layouts(problem), solution.statistics.seconds, 0
    seen = {_arrangement(problem)}
    while count < limit:
        pressed = [(block, row) for block in problem.blocks if (row := block.pressing(best)) is not None]
        if not pressed:
            break
        for block, row in pressed:
            block.reorder(best, row)
        if _arrangement(problem) in seen:
            _restore(problem, at)
            break
        seen.add(_arrangement(problem))
        _begin_at(problem, best)
        result = problem.attempt(solver)
        seconds += result.statistics.seconds
        slack = 1e-7 * max(1.0, abs(best.objective))
        if result.status is not ProblemStatus.SOLVED or result.objective > best.objective + slack:
            _restore(problem, at)
            break
        best, at, count = result, _layouts(problem), count + 1
    return replace(best, statistics=replace(best.statistics, reorderings=count, seconds=seconds))


def _retry(problem: NamedProgram, solver: Ipopt, missed: ProblemSolution, limit: int) -> ProblemSolution:
    """After a failed solve: let breakpoints that meet where it ended change places, one a time, and solve again.

    Where the order of breakpoints keeps the robot from what is demanded, the solver halts where they meet. Returns the
    first success, or the first failure with everything as it was.
    """
    laid, first = _layouts(problem), missed
    guesses = {name: each.guess for name, each in problem.variables.items()}
    seen = {_arrangement(problem)}
    for _ in range(limit):
        blocked = [block for block in problem.blocks if block.closed(missed)]
        for block in blocked:
            block.reorder(missed)
        if not blocked or _arrangement(problem) in seen:
            break
        seen.add(_arrangement(problem))
        _begin_at(problem, missed)
        missed = problem.attempt(solver)
        if missed.status is ProblemStatus.SOLVED:
            return missed
    _restore(problem, laid)
    _guess(problem, guesses)
    return first


def _begin_at(problem: NamedProgram, solution: ProblemSolution) -> None:
    """Start the variables that no block has set where a solution has them."""
    owned = {name for name in solution.values for block in problem.blocks if block.owns(name)}
    _guess(problem, {name: value for name, value in solution.values.items() if name not in owned})


def _guess(problem: NamedProgram, values: Mapping[str, Array]) -> None:
    """Start variables at these numbers."""
    for name, value in values.items():
        problem.set_guess(name, value)


def _layouts(problem: NamedProgram) -> list[object]:
    return [block.layout for block in problem.blocks]


def _restore(problem: NamedProgram, layouts: list[object]) -> None:
    for block, laid in zip(problem.blocks, layouts, strict=True):
        if block.layout is not laid:
            block.restore(laid)


def _arrangement(problem: NamedProgram) -> Hashable:
    """The orders of all breakpoints."""
    return tuple((block.layout.order.front, block.layout.order.behind) for block in problem.blocks)


def _box(problem: NamedProgram, names: list[str]) -> tuple[Array, Array]:
    """Bounds of the variables, one below the other."""
    known = problem.variables
    for name in names:
        if name not in known:
            raise InputError(f"over has {name!r}; there is no such variable{nearest(name, known)}")
        if not np.isfinite([known[name].lower, known[name].upper]).all():
            raise InputError(f"variable {name!r} has no finite bounds; starts are spread between lower and upper")
    if not names:
        raise InputError("over is empty; it must name variables")
    lower, upper = (np.concatenate([getattr(known[name], side) for name in names]) for side in ("lower", "upper"))
    return lower, upper


def _begin_at_point(problem: NamedProgram, names: list[str], point: Array) -> None:
    """Guesses at a point, and every block at the equilibrium there."""
    sizes = np.cumsum([len(problem.variables[name].guess) for name in names])[:-1]
    _guess(problem, dict(zip(names, np.split(point, sizes), strict=True)))
    for block in problem.blocks:
        block.start_at(lambda part: problem.evaluate(part, {}, {}))


def _nearer(one: ProblemSolution | None, other: ProblemSolution | None) -> ProblemSolution | None:
    """The one whose worst violation is smaller."""
    if one is None or other is None:
        return other if one is None else one
    size = [each.violations[0].relative if each.violations else 0.0 for each in (one, other)]
    return one if size[0] <= size[1] else other
