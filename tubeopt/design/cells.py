"""Orders of breakpoints. Inside one order everything is smooth in the unknowns; where a section closes there is a kink.

Optima often lie on kinks: two tubes that end together, a transition just at the plate. There no gradient method
converges. So the order is fixed, which makes the lengths of the sections constraints, and swapped where one that is
closed at the optimum would rather be passed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ..typing import Array
from .program import Program, evaluate, state_at
from .solve_one import Attempt, Report, attempt, improve
from .state import State


@dataclass(frozen=True)
class Order:
    """Order of the breakpoints of one pose or certificate: those beyond the plate, base to tip, and those behind it.

    Breakpoint 2 i is the transition of tube i, 2 i + 1 its end.
    """

    beyond: tuple[int, ...]
    behind: tuple[int, ...]


Cell = tuple[Order, ...]
"""An order for every pose, then for every translation of the certificate."""


def _breakpoints(state: State, k: int) -> tuple[Array, Array]:
    """Places (2 n,) of the breakpoints of one pose or certificate, m, and their change (2 n, X)."""
    layout = state.layout
    if k < len(layout.poses):
        transition, moved = state.joint_values(k)[1], state.joint_slopes(k)[1]
    else:
        transition = np.array(layout.certified[k - len(layout.poses)])
        moved = np.zeros((layout.n, layout.size))
    curved = np.array([tube.curved_length for tube in state.tubes])
    places = np.stack([transition, transition + curved], axis=1).ravel()
    slopes = np.stack([moved, moved + state.slopes["curved_length"]], axis=1)
    return places, slopes.reshape(-1, layout.size)


def cell_at(program: Program, x: Array) -> Cell:
    """The orders at x."""
    state = state_at(program, x)
    orders = []
    for k in range(len(program.layout.poses) + len(program.layout.certified)):
        places, _ = _breakpoints(state, k)
        ranked = np.argsort(places, kind="stable").tolist()
        orders.append(Order(tuple(i for i in ranked if places[i] > 0), tuple(i for i in ranked if places[i] <= 0)))
    return tuple(orders)


def cell_rows(program: Program, state: State, cell: Cell) -> tuple[Array, Array, list[tuple[int, int, int]]]:
    """Lengths of the sections of a cell in steps of 10 mm, >= 0 in it, their change, and what each is: the pose, and
    its breakpoints before and behind (-1 for the plate). Only those that can change."""
    values, slopes, what = [], [], []
    for k, order in enumerate(cell):
        places, moved = _breakpoints(state, k)
        places, moved = np.append(places, 0.0), np.vstack([moved, np.zeros(moved.shape[1])])
        pairs = [*pairwise((-1, *order.beyond)), *((i, -1) for i in order.behind)]
        for a, b in pairs:
            slope = moved[b] - moved[a]
            if np.abs(slope).max() > 1e-12:
                values.append((places[b] - places[a]) / 1e-2)
                slopes.append(slope / 1e-2)
                what.append((k, a, b))
    return np.array(values), np.reshape(slopes, (len(values), program.layout.size)), what


def swapped(cell: Cell, pose: int, a: int, b: int) -> Cell:
    """The cell beyond the kink where breakpoints a and b of a pose meet."""
    order = cell[pose]
    if a == -1:
        other = Order(order.beyond[1:], (*order.behind, b))
    elif b == -1:
        other = Order((a, *order.beyond), tuple(i for i in order.behind if i != a))
    else:
        k = order.beyond.index(a)
        other = Order((*order.beyond[:k], b, a, *order.beyond[k + 2 :]), order.behind)
    return (*cell[:pose], other, *cell[pose + 1 :])


def improve_by_cells(program: Program, start: Array, report: Report | None = None) -> Attempt:
    """The optimum in the cell of a start, then in its neighbours for as long as they are better."""
    cell = cell_at(program, start)
    best = _in_cell(program, start, cell, report)
    tried, orders = {cell}, program.task.solver.orders
    for _ in range(orders.most):
        values, slopes, what = cell_rows(program, state_at(program, best.x), cell)
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
    if evaluate(program, start) is None:
        return attempt(program, start, None)

    def rows(state: State) -> tuple[Array, Array]:
        return cell_rows(program, state, cell)[:2]

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
