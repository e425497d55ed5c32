"""Many starts of one program: the best that comes of them, and the count of what happened."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import scipy

from ..errors import InputError, SolveError, nearest
from ..typing import Array
from .named_program import NamedProgram
from .problem_solution import Attempts, ProblemSolution


def multistart(
    problem: NamedProgram, solve: Callable[[], ProblemSolution], over: Sequence[str], count: int, seed: int
) -> ProblemSolution:
    """See `Problem.multistart`; `solve` solves from where the problem begins."""
    names = [over] if isinstance(over, str) else list(over)
    lower, upper = _box(problem, names)
    if count < 1:
        raise InputError(f"count is {count}; it must be at least 1")
    points = scipy.stats.qmc.Sobol(len(lower), seed=seed).random_base2(int(np.ceil(np.log2(count))))[:count]
    best: tuple[ProblemSolution, list[object]] | None = None
    missed: ProblemSolution | None = None
    objectives, astray, failed = [], 0, 0
    for point in lower + points * (upper - lower):
        try:
            _begin_at(problem, names, point)
        except (InputError, SolveError):
            astray += 1
            continue
        try:
            found = solve()
        except SolveError as error:
            failed, missed = failed + 1, _nearer(missed, error.solution)
            continue
        objectives.append(found.objective)
        if best is None or found.objective < best[0].objective:
            best = found, [block.layout for block in problem.blocks]
    attempts = Attempts(count, len(objectives), astray, failed, tuple(sorted(objectives)))
    if best is None:
        worst = f"; nearest: {problem.failure(missed)}" if missed else ""
        raise SolveError(f"{problem.name}: {attempts}{worst}", missed)
    for block, laid in zip(problem.blocks, best[1], strict=True):
        if block.layout is not laid:
            block.restore(laid)
    for name, value in best[0].values.items():
        problem.set_guess(name, value)
    return replace(best[0], attempts=attempts)


def _box(problem: NamedProgram, names: list[str]) -> tuple[Array, Array]:
    """Bounds of the variables, one below the other."""
    known = problem.variables
    for name in names:
        if name not in known:
            raise InputError(f"over names {name!r}, which is no variable{nearest(name, known)}")
        if not np.isfinite([known[name].lower, known[name].upper]).all():
            raise InputError(f"variable {name!r} has no finite bounds; starts are spread between lower and upper")
    if not names:
        raise InputError("over is empty; it must name variables")
    lower, upper = (np.concatenate([getattr(known[name], side) for name in names]) for side in ("lower", "upper"))
    return lower, upper


def _begin_at(problem: NamedProgram, names: list[str], point: Array) -> None:
    """Guesses at a point, and every block at the equilibrium there."""
    sizes = np.cumsum([len(problem.variables[name].guess) for name in names])[:-1]
    for name, value in zip(names, np.split(point, sizes), strict=True):
        problem.set_guess(name, value)
    for block in problem.blocks:
        block.start_at(lambda part: problem.evaluate(part, {}, {}))


def _nearer(one: ProblemSolution | None, other: ProblemSolution | None) -> ProblemSolution | None:
    """The one whose worst violation is smaller."""
    if one is None or other is None:
        return other if one is None else one
    size = [each.violations[0].relative if each.violations else 0.0 for each in (one, other)]
    return one if size[0] <= size[1] else other
