"""Solving a design program from one start: to feasibility, to the optimum, to the rims of targets, along its kinks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import SolveError
from ..typing import Array
from .attempt import Attempt, Report, attempt, improve, prices, to_feasibility
from .cells import Cell, cell_of, cell_rows, swapped
from .collocation import collocate
from .program import Program
from .rows import cubed
from .starts import with_joints
from .state import State

METHODS = ("reduced", "collocation")
"""Ways to the optimum: with the equilibria solved inside, or as unknowns of one program of blocks."""


def solve(program: Program, start: Array, report: Report | None = None, method: str = "reduced") -> Attempt:
    """The best design from a start (X,), SI, by one of METHODS."""
    x = to_feasibility(program, np.clip(start, program.lower, program.upper), report)
    found = attempt(program, x)
    solver = program.task.solver
    near, restarts = solver.optimum.near, solver.starts.restarts if program.layout.free_poses else 0
    for kick in range(restarts):
        if found.violation <= near:
            break
        random = np.random.default_rng([kick, program.layout.size])
        begin = with_joints(program, found.x[: program.layout.designs], random)
        x = to_feasibility(program, begin, report)
        found = min(found, attempt(program, x), key=lambda one: one.violation)
    if found.violation > near:
        return found
    return _collocated(program, found.x, report) if method == "collocation" else best_from(program, found.x, report)


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
    groups = found.evaluated.groups
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
    candidates = [found, attempt(program, x)]
    if np.isfinite(found.violation) and not found.feasible:
        # IPOPT ended just outside.
        x = to_feasibility(program, found.x, report)
        candidates.append(attempt(program, x))
    best = min(candidates, key=_worse)
    return min(best, _through_cells(best, report), key=_worse)


def _worse(one: Attempt) -> tuple[bool, float]:
    return not one.feasible, one.objective if one.feasible else one.violation


def _through_cells(start: Attempt, report: Report | None) -> Attempt:
    """The optimum in the cell of a start, then in its neighbours for as long as they are better."""
    program, cell = start.program, cell_of(start.state)
    best = _in_cell(program, start.x, cell, report)
    tried, orders = {cell}, program.task.solver.orders
    for _ in range(orders.most):
        values, slopes, what = cell_rows(best.state, cell)
        if not best.feasible or not what:
            break
        prices = np.zeros(len(values)) if best.optimum is None else best.optimum.multipliers[-len(values) :]
        closed = [k for k in np.argsort(-prices) if values[k] * 1e-2 < orders.closed_section and prices[k] > 1e-8]
        better = None
        for k in closed:
            other = swapped(cell, *what[k])
            if other in tried:
                continue
            tried.add(other)
            begin = _across(program, best.x, values[k], slopes[k])
            found = _in_cell(program, begin, other, report)
            if found.feasible and found.objective < best.objective - orders.gain * max(abs(best.objective), 1e-3):
                better = other, found
                break
        if better is None:
            break
        cell, best = better
    return replace(best, program=program)


def _in_cell(program: Program, start: Array, cell: Cell, report: Report | None) -> Attempt:
    """The optimum in one cell."""

    def rows(state: State) -> tuple[Array, Array]:
        return cell_rows(state, cell)[:2]

    found = improve(program, start, report, rows=rows)
    if program.layout.free_poses or (found.optimum is not None and found.optimum.success):
        return found
    other = improve(program, start, report, rows=rows, strategy="patient")
    return min(found, other, key=lambda one: (not one.feasible, one.objective))


def _across(program: Program, x: Array, value: float, slope: Array) -> Array:
    """x moved as little as possible to where a section is open on the other side."""
    scaled = slope * program.scale
    step = -(value + program.task.solver.orders.opened_section / 1e-2) / float(scaled @ scaled)
    return np.clip(x + step * scaled * program.scale, program.lower, program.upper)
