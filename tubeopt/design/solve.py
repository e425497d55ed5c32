"""Solving a design program from one start: to feasibility, to the optimum, and along its kinks."""

from __future__ import annotations

import numpy as np

from ..robots.assembly import Array
from .cells import improve_by_cells
from .program import Program
from .solve_one import FEASIBLE, Attempt, Report, attempt, improve, to_feasibility, violation
from .starts import with_joints

NEAR = 0.5
"""Violation, in steps of its limit, from which IPOPT is trusted to get inside."""

KICKS = 2
"""Times that other joint values are tried for dimensions from which least squares do not get near."""

FREE_ITERATIONS = 150
"""Iterations of IPOPT before it counts as stuck on a kink."""


def solve(program: Program, start: Array, report: Report | None = None) -> Attempt:
    """The best design from a start (X,), SI."""
    x = to_feasibility(program, np.clip(start, program.lower, program.upper), report)
    missed = violation(program, x)[0]
    for kick in range(KICKS if program.layout.free_poses else 0):
        if missed <= NEAR:
            break
        random = np.random.default_rng([kick, program.layout.size])
        other = to_feasibility(program, with_joints(program, x[: program.layout.designs], random), report)
        if violation(program, other)[0] < missed:
            x, missed = other, violation(program, other)[0]
    return attempt(program, x, None) if missed > NEAR else best_from(program, x, report)


def best_from(program: Program, x: Array, report: Report | None = None) -> Attempt:
    """The optimum from a design that is nearly feasible.

    IPOPT is let loose across all kinks first; where it does not converge, it ends in one order of breakpoints after the
    other.
    """
    found = improve(program, x, report, FREE_ITERATIONS)
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


__all__ = ["FEASIBLE", "Attempt", "Report", "solve"]
