"""Bounds of precurvature and stiffness, and of how fast they change along tubes, on cells that tubes are cut into.

On a part of a panel of `Lengthwise` every quantity is a polynomial, so that its Chebyshev coefficients c_k there bound
it: it is no farther from c_0 than the sum of |c_k|, k > 0. Parts are halved until that is close.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.polynomial import chebyshev

from ..typing import Array
from .lengthwise import Lengthwise, lengthwise
from .series import Quantity, part_of, values, vary
from .tubes import Tube, stretches

MOST_CELLS = 8
"""Of a piece along which something varies."""

CHANGE = 0.2
"""Of stiffness or |kb u*_xy| along a cell, as a share of the largest on the piece, above which there are more."""

BEYOND = 1e-8
"""So far (m) bounds hold beyond the ends of a cell, where the piece goes on."""

CLOSE = 0.9
"""What a bound of a stiffness from below must be, as a share of the least that is found."""

HALVINGS, LEAST_HALVINGS = 12, 2
"""Of a part along which something varies, at most and at least."""

BOUNDS = 17
"""Numbers that are found of a cell."""


@dataclass(frozen=True, eq=False)
class Variation:
    """Bounds on the cells of n tubes; a piece along which nothing varies is one. (n, C + 1), the last behind the end.

    a is kb u*_xy in the tube's own frame, and ' the derivative by arc length along the tube. Behind the end kt is what
    it was, and all else is 0.

    Attributes:
        cuts: (n, C) where cells end, from the held end, m; the first is the straight part. Tubes of fewer cells are
            filled up with cells without length.
        bending: (4, ...) kb from below, |kb'|, |kb''|, |kb'''|.
        torsional: kt from below.   ease: (3, ...) |(1 / kt)'|, |(1 / kt)''|, |(1 / kt)'''|.
        pull: (4, ...) |a|, |a'|, |a''|, |a'''|.
        twist: (3, ...) |u*_z|, |u*_z'|, |u*_z''|.
        stiffest: (2, ...) kb and kt from above.
    """

    cuts: Array
    bending: Array
    torsional: Array
    ease: Array
    pull: Array
    twist: Array
    stiffest: Array

    @property
    def still(self) -> bool:
        """Whether nothing changes along any cell."""
        return not any(rates.any() for rates in (self.bending[1:], self.ease, self.pull[1:], self.twist[1:]))


@lru_cache(maxsize=128)
def variation(tubes: tuple[Tube, ...]) -> Variation:
    """The bounds of some tubes."""
    table = lengthwise(tubes)
    cells = [_cells(tube) for tube in tubes]
    most = max(2, *(len(own) for own in cells))
    cuts = np.array([[cut for *_, cut in [*own, *[own[-1]] * (most - len(own))]] for own in cells])
    bounds = np.zeros((BOUNDS, len(tubes), most + 1))
    for i, own in enumerate(cells):
        for c, (low, high, _) in enumerate(own):
            bounds[:, i, c] = _bounds(table, i, low, high)
        bounds[:, i, len(own) : most] = bounds[:, i, len(own) - 1, None]
        bounds[4, i, most] = bounds[4, i, most - 1]
    return Variation(cuts, bounds[0:4], bounds[4], bounds[5:8], bounds[8:12], bounds[12:15], bounds[15:])


def _cells(tube: Tube) -> list[tuple[float, float, float]]:
    """Between which arc lengths bounds must hold for every cell of a tube, and where it ends, m."""
    cells, start = [], 0.0
    for length, precurvature, bending, torsional in stretches(tube):
        count = _count((*precurvature, bending, torsional), length)
        cuts = [*(start + length * k / count for k in range(count)), start + length]
        cells += [(max(low - BEYOND, start), min(high + BEYOND, start + length), high) for low, high in pairwise(cuts)]
        start += length
    return cells if tube.straight_length > 0 else [(*cells[0][:2], 0.0), *cells]


def _count(quantities: tuple[Quantity, ...], length: float) -> int:
    """Cells of a piece with these x, y, z, kb and kt."""
    if not vary(quantities):
        return 1
    s = np.linspace(0.0, length, 16 * MOST_CELLS + 1)
    x, y, _, kb, kt = (values(q, s) for q in quantities)
    ranges = [(np.ptp(each), np.abs(each).max()) for each in (kb, kt, kb * np.hypot(x, y))]
    share = max(float(change / size) if size > 0 else 0.0 for change, size in ranges)
    return int(np.clip(np.ceil(share / CHANGE), 1, MOST_CELLS))


def _bounds(table: Lengthwise, tube: int, low: float, high: float) -> Array:
    """(BOUNDS,) of a tube from one arc length to another."""
    breaks = table.breaks[tube][np.isfinite(table.breaks[tube])]
    found = []
    for panel, (first, last) in enumerate(pairwise(breaks)):
        a, b = max(low, first), min(high, last)
        # What a cell and a panel have in common by round-off is bounded from the other side.
        if b - a > BEYOND / 2:
            ends = (2 * np.array([a, b]) - first - last) / (last - first)
            found += _parts(table.coefficients[tube, panel, :5], ends, last - first, HALVINGS)
    parts = np.array(found)
    out: Array = parts.max(0)
    out[[0, 4]] = parts[:, [0, 4]].min(0)
    return out


def _parts(coefficients: Array, ends: Array, length: float, halvings: int) -> list[Array]:
    """Bounds of quantities (5, D) on parts of what lies between two places (2,) of -1 to 1 on a panel of a length."""
    middle, half = ends.mean(), (ends[1] - ends[0]) / 2
    own = part_of(coefficients.T, ends).T
    values = chebyshev.chebval(chebyshev.chebpts1(coefficients.shape[1]), own.T)
    still = (coefficients[:, 1:] == 0).all(1)
    own[still] = coefficients[still]
    bound = _bound(own, length * half / 2)
    loose = (bound[[0, 4]] < CLOSE * values[:2].min(1)).any() or halvings > HALVINGS - LEAST_HALVINGS
    if halvings and loose and not still.all():
        halves = np.array([ends[0], middle]), np.array([middle, ends[1]])
        return [part for each in halves for part in _parts(coefficients, each, length, halvings - 1)]
    return [bound]


def _bound(coefficients: Array, half: float) -> Array:
    """(BOUNDS,) of kb, kt, x, y and z (5, D) on -1 to 1, which is a stretch of twice `half`, m."""
    kb, kt, x, y, z = coefficients
    pull = [chebyshev.chebmul(kb, each) for each in (x, y)]
    square = chebyshev.chebadd(*(chebyshev.chebmul(each, each) for each in pull))
    (_, *bending), (_, kt1, kt2, kt3), twist = (_sizes(each, half) for each in (kb, kt, z))
    sides = [_sizes(each, half) for each in pull]
    low = [2 * each[0] - np.abs(each).sum() for each in (kb, kt)]
    one, two, three = kt1 / low[1], kt2 / low[1], kt3 / low[1]
    ease = np.array([one, two + 2 * one**2, three + 6 * one * two + 6 * one**3]) / low[1]
    return np.array(
        [
            *(low[0], *bending),
            *(low[1], *ease),
            *(np.abs(square).sum() ** 0.5, *np.hypot(*sides)[1:]),
            *twist[:3],
            *(np.abs(each).sum() for each in (kb, kt)),
        ]
    )


def _sizes(coefficients: Array, half: float) -> Array:
    """(4,) bounds of the size of a polynomial and of its first three derivatives by arc length."""
    orders = [coefficients]
    for _ in range(3):
        orders.append(np.asarray(chebyshev.chebder(orders[-1]) / half, dtype=float))
    return np.array([np.abs(each).sum() for each in orders])
