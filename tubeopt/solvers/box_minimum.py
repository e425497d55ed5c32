"""Minimum of a convex quadratic within a box, by an active set that descends.

Least squares with other inequalities are in `compiled/quadratic.py`; their matrix has full rank.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..typing import Array, Mask
from .settings import BOX_CHANGES


class BoxMinimum(NamedTuple):
    """Minimum of a quadratic within a box."""

    x: Array
    """Minimiser (m,)."""
    inside: Mask
    """Mask (m,) of the components that are not at a bound."""


def minimum_in_box(
    square: Array,
    slope: Array,
    box: tuple[Array, Array],
    start: Array,
    *,
    solve: Callable[..., Any],
    round_off: Array | float,
) -> BoxMinimum | None:
    """Minimum of x'Sx / 2 + slope.x within a box (m,), by an active set; None where round-off prevents it.

    Components within their bounds move to their minimum, up to the first bound. Then the component with the largest
    gain leaves its bound. Every change lowers the objective, so that no active set returns (Nocedal and Wright, 2006,
    section 16.5).

    Args:
        square: S (m, m), positive semidefinite.
        start: any x (m,); close to the minimum it takes few changes.
        solve: solution of S x = b for a part of S.
        round_off: gradient (m,) that counts as none.
    """
    low, high = box
    x = np.clip(start, low, high)
    inside = (x > low) & (x < high)
    for _ in range(BOX_CHANGES * (len(x) + 1)):
        rows = np.flatnonzero(inside)
        if len(rows):
            target = solve(square[np.ix_(rows, rows)], -slope[rows] - square[rows] @ np.where(inside, 0.0, x))
            # Fraction of the move at which each component reaches its bound.
            move, bound = target - x[rows], np.where(target > x[rows], high[rows], low[rows])
            fraction = np.full(len(rows), np.inf)
            np.divide(bound - x[rows], move, out=fraction, where=move != 0)
            first = int(np.argmin(fraction))
            if fraction[first] < 1:
                x[rows] += fraction[first] * move
                x[rows[first]] = bound[first]
                inside[rows[first]] = False
                continue
            x[rows] = target
        gradient = slope + square @ x
        gain = np.where(inside | (low == high), 0.0, np.where(x == high, gradient, -gradient)) - round_off
        if not len(x) or gain.max() <= 0:
            return BoxMinimum(x, inside)
        inside[int(np.argmax(gain))] = True
    return None
