"""Orders of breakpoints. Inside one order everything is smooth in the unknowns; where a section closes there is a kink.

Optima often lie on kinks: two tubes that end together, a transition just at the plate. There no gradient method
converges. So the order is fixed, which makes the lengths of the sections constraints, and swapped where one that is
closed at the optimum would rather be passed.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..typing import Array
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


def cell_of(state: State) -> Cell:
    """The orders in which breakpoints are."""
    orders = []
    for k in range(len(state.layout.poses) + len(state.layout.certified)):
        places, _ = _breakpoints(state, k)
        ranked = np.argsort(places, kind="stable").tolist()
        orders.append(Order(tuple(i for i in ranked if places[i] > 0), tuple(i for i in ranked if places[i] <= 0)))
    return tuple(orders)


def cell_rows(state: State, cell: Cell) -> tuple[Array, Array, list[tuple[int, int, int]]]:
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
    return np.array(values), np.reshape(slopes, (len(values), state.layout.size)), what


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
