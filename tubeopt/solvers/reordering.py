"""Solves that go on where breakpoints meet: they change places as long as the objective gains by it."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace

from .named_program import NamedProgram
from .problem_solution import ProblemSolution, ProblemStatus
from .settings import Ipopt


def improve(problem: NamedProgram, solver: Ipopt, solution: ProblemSolution, limit: int) -> ProblemSolution:
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
        found = problem.attempt(solver)
        seconds += found.statistics.seconds
        slack = 1e-7 * max(1.0, abs(best.objective))
        if found.status is not ProblemStatus.SOLVED or found.objective > best.objective + slack:
            _restore(problem, at)
            break
        best, at, count = found, _layouts(problem), count + 1
    return replace(best, statistics=replace(best.statistics, reorderings=count, seconds=seconds))


def retry(problem: NamedProgram, solver: Ipopt, missed: ProblemSolution, limit: int) -> ProblemSolution:
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
    for name, guess in guesses.items():
        problem.set_guess(name, guess)
    return first


def _begin_at(problem: NamedProgram, solution: ProblemSolution) -> None:
    """Start the variables that no block has set where a solution has them."""
    for name, value in solution.values.items():
        if not any(block.owns(name) for block in problem.blocks):
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
