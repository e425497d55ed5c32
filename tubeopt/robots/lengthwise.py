"""Precurvature and stiffness along the tubes of a bundle: as polynomials, by their bounds, or in steps.

One table of polynomials (`Lengthwise`) is read at any points. On a part of one of its panels every quantity is a
polynomial, so that its Chebyshev coefficients c_k there bound it (`Variation`): it is no farther from c_0 than the sum
of |c_k|, k > 0. Parts are halved until that is close.

For expressions (`Steps`) a piece that varies along its length is cut into equal steps, each with the mean precurvature,
bending stiffness and torsional compliance of where it is. Its curve is off by no more than about |du*/ds| L h^2 / 12 in
steps of h.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import accumulate, pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from ..typing import Array, Mask
from .pieces import Piece, Quantity, Series, breaks_of, on_panels, part_of, values, vary, zeros
from .tubes import Tube, stretches

# What the table holds: EI, GJ, u*, and the integral of u*_z from the held end.
QUANTITIES = ("bending_stiffness", "torsional_stiffness", "x", "y", "z", "twist_angle")

# Gauss points of a panel for the torsional compliance 1 / GJ: exact up to degree 63, so for all that 64 coefficients
# resolve.
QUADRATURE = 32

# Relative to the largest coefficient: smaller ones need no finer mesh.
DETAIL = 1e-9


@dataclass(frozen=True, eq=False)
class CrossSections:
    """Cross-sections of n tubes at X arc lengths of an arm, (X, n) each; stiffness and moment are 0 beyond a tube.

    EI, m = EI |u*_xy|, the direction `phase` of the natural moment for a tube without elastic torsion, GJ, and the
    natural twist u*_z with its integral `twist_angle` from the clamped end.
    """

    stiffness: Array
    moment: Array
    phase: Array
    torsional_stiffness: Array
    twist: Array
    twist_angle: Array


class _PanelPoints(NamedTuple):
    """Points on panels."""

    coefficients: Array
    """Coefficients (X, n, 6, D) of the panels."""
    x: Array
    """Coordinates (X, n) on the panels, -1 to 1."""
    length: Array
    """Lengths (X, n) of the panels, m."""


@dataclass(frozen=True, eq=False)
class Lengthwise:
    """n tubes of up to B panels with up to D coefficients.

    Attributes:
        breaks: (n, B + 1) arc lengths from the held end where panels meet, m; inf behind the last.
        coefficients: (n, B, 6, D) of the Chebyshev polynomials of QUANTITIES.
        bent: (n, B) whether there is any bending precurvature.
        direction: (n, B) angle of that in the tube's own frame, rad, where it stays in one plane; else inf.
        detail: (n, B) polynomial degree that matters, per length of the panel, 1/m.
        twist: (n, B) largest |u*_z|, 1/m.
        cuts: per tube, where its pieces begin and end and where its precurvature changes sides, so that |u*_xy| has a
            kink, from the held end, m.
        compliance: (n, B + 1) int ds / GJ from the held end to each break, 1/(N m).
    """

    breaks: Array
    coefficients: Array
    bent: Mask
    direction: Array
    detail: Array
    twist: Array
    cuts: tuple[tuple[float, ...], ...]
    compliance: Array

    @property
    def n_tubes(self) -> int:
        """Number of tubes n."""
        return len(self.breaks)

    @cached_property
    def _even(self) -> bool:
        """True if GJ is constant along every panel."""
        return not self.coefficients[:, :, 1, 1:].any()

    @cached_property
    def _varied(self) -> Mask:
        """Mask (n, B) of the panels with a varying quantity, the natural rotation included."""
        return np.asarray(self.coefficients[..., 1:].any((2, 3)))

    def steady(self, low: Array, high: Array) -> Mask:
        """Mask (P,) of the intervals `low` to `high` (P, n), m from the clamped ends, without a tube that varies."""
        panel, tube = self.panel(low), np.arange(self.n_tubes)
        return np.asarray(((panel == self.panel(high)) & ~self._varied[tube, panel]).all(1))

    def panel(self, position: Array) -> NDArray[np.intp]:
        """Panels (X, n) of the tubes at arc lengths (X, n) from their clamped ends, m; outside, the nearest panel."""
        # Breaks behind the last panel of a shorter tube are inf, and not counted.
        last = np.isfinite(self.breaks).sum(1) - 2
        index = (position[:, :, None] >= self.breaks[:, 1:]).sum(2)
        return np.asarray(np.minimum(index, last))

    def _panels_at(self, position: Array, inside: Array) -> _PanelPoints:
        """Panels that contain positions `inside` (X, n), to be evaluated there."""
        panel, tube = self.panel(inside), np.arange(self.n_tubes)
        low, high = self.breaks[tube, panel], self.breaks[tube, panel + 1]
        # The panel becomes the interval -1 to 1 of the Chebyshev polynomials. Outside, T_k grows like (2 x)^k:
        # round-off is clipped.
        x = np.clip((2 * position - low - high) / (high - low), -1.0, 1.0)
        return _PanelPoints(self.coefficients[tube, panel], x, high - low)

    def values(self, position: Array, inside: Array | None = None) -> Array:
        """Values (6, X, n) of QUANTITIES at arc lengths (X, n) from the clamped ends, m.

        Args:
            inside: (X, n) places on the same stretch by which the panel is chosen, where `position` may be at its end.
        """
        chosen = position if inside is None else inside
        # Tubes of constant pieces have c_0 alone: no basis is needed.
        if not self._varied.any():
            table = self.coefficients[np.arange(self.n_tubes), self.panel(chosen), :, 0]
            return np.ascontiguousarray(table.transpose(2, 0, 1))
        table, x, _ = self._panels_at(position, chosen)
        # T_0 = 1, T_1 = x, T_k = 2 x T_(k-1) - T_(k-2). |T_k| <= 1, so that round-off does not grow.
        basis = np.stack([np.ones_like(x), x, *(np.empty_like(x) for _ in range(table.shape[-1] - 2))], axis=-1)
        for k in range(2, table.shape[-1]):
            basis[..., k] = 2 * x * basis[..., k - 1] - basis[..., k - 2]
        return np.asarray((table @ basis[..., None])[..., 0].transpose(2, 0, 1))

    def rates(self, position: Array, inside: Array) -> Array:
        """Derivatives (6, X, n) by arc length of QUANTITIES at arc lengths (X, n) from the clamped ends."""
        table, x, length = self._panels_at(position, inside)
        degree = table.shape[-1] - 1
        # Row k has the coefficients of T_k'. By arc length, d/ds = (2 / length) d/dx.
        slopes = chebyshev.chebder(np.eye(degree + 1), axis=0).T
        basis = chebyshev.chebvander(x, degree)[..., :degree] @ slopes.T
        return np.asarray(((table @ basis[..., None])[..., 0] * (2 / length)[..., None]).transpose(2, 0, 1))

    def compliant(self, position: Array) -> Array:
        """Torsional compliance (..., n), int ds / GJ, from the clamped ends to arc lengths (..., n), 1/(N m)."""
        tube, at = np.arange(self.n_tubes), position.reshape(-1, self.n_tubes)
        panel = self.panel(at)
        low = self.breaks[tube, panel]
        high = np.clip(at, low, self.breaks[tube, panel + 1])
        # Where GJ is constant along panels, one point integrates 1 / GJ exactly.
        nodes, weights = (np.array([0.5]), np.ones(1)) if self._even else gauss_rule()
        s = low + (high - low) * nodes[:, None, None]
        # A node near the end of a panel may round into the next one: the middle chooses the panel.
        inside = np.broadcast_to((low + high) / 2, s.shape)
        rate = 1 / self.values(s.reshape(-1, self.n_tubes), inside.reshape(-1, self.n_tubes))[1].reshape(s.shape)
        total = self.compliance[tube, panel] + (high - low) * np.tensordot(weights, rate, 1)
        return np.asarray(total.reshape(position.shape))

    def at(self, position: Array, inside: Array, present: Mask) -> CrossSections:
        """Cross-sections at arc lengths (X, n) from the clamped ends; `inside` as in `values`; `present` is (X, n)."""
        bending, torsional, x, y, z, twist_angle = self.values(position, inside)
        kb = bending * present
        # The natural twist turns the tube's frame by int u*_z ds, and u*_xy with it.
        return CrossSections(
            stiffness=kb,
            moment=kb * np.hypot(x, y),
            phase=twist_angle + np.arctan2(y, x),
            torsional_stiffness=torsional,
            twist=z * present,
            twist_angle=twist_angle,
        )


@lru_cache(maxsize=1)
def gauss_rule() -> tuple[Array, Array]:
    """Nodes and weights (QUADRATURE,) on 0 to 1."""
    x, w = np.polynomial.legendre.leggauss(QUADRATURE)
    return (x + 1) / 2, w / 2


@dataclass(frozen=True)
class _Panel:
    """Stretch of a tube between two arc lengths from its clamped end, m, with the coefficients of QUANTITIES.

    Direction, detail and twist are as in `Lengthwise`. It also has int ds / GJ, and the sign changes of its bend, m.
    """

    low: float
    high: float
    channels: Sequence[Sequence[float] | Array]
    direction: float
    detail: float
    twist: float
    compliance: float
    sides: tuple[float, ...] = ()


@lru_cache(maxsize=128)
def lengthwise(tubes: tuple[Tube, ...]) -> Lengthwise:
    """Table of a bundle of tubes, cached."""
    panels = [_panels(tube) for tube in tubes]
    n, count = len(tubes), max(len(tube_panels) for tube_panels in panels)
    # `values` always fills T_0 and T_1.
    width = max(2, *(len(c) for tube_panels in panels for panel in tube_panels for c in panel.channels))
    breaks, table = np.full((n, count + 1), np.inf), np.zeros((n, count, len(QUANTITIES), width))
    direction, detail, twist = np.zeros((3, n, count))
    compliance = np.zeros((n, count + 1))
    for i, tube_panels in enumerate(panels):
        breaks[i, : len(tube_panels) + 1] = [0.0, *(panel.high for panel in tube_panels)]
        compliance[i, 1 : len(tube_panels) + 1] = list(accumulate(panel.compliance for panel in tube_panels))
        for name, column in (("direction", direction), ("detail", detail), ("twist", twist)):
            column[i, : len(tube_panels)] = [getattr(panel, name) for panel in tube_panels]
        for k, panel in enumerate(tube_panels):
            for q, coefficients in enumerate(panel.channels):
                table[i, k, q, : len(coefficients)] = coefficients
    bent = np.asarray(table[:, :, 2:4].any((2, 3)))
    cuts = tuple(_cuts(tube, tube_panels) for tube, tube_panels in zip(tubes, panels, strict=True))
    return Lengthwise(breaks, table, bent, direction, detail, twist, cuts, compliance)


def _direction(x: Array, y: Array) -> float:
    """Angle of proportional coefficient vectors (x, y), -pi/2 to pi/2; inf if they are not proportional."""
    if not np.any(y):
        return 0.0
    size = max(len(x), len(y))
    a, b = (np.pad(c, (0, size - len(c))) for c in (x, y))
    # The largest pair gives the angle with the least round-off.
    k = int(np.argmax(np.hypot(a, b)))
    angle = float(np.arctan2(b[k], a[k]))
    # In one plane nothing remains perpendicular to the angle. More than round-off would be a bend in space.
    across = np.cos(angle) * b - np.sin(angle) * a
    return angle if np.abs(across).max() <= 1e-15 * float(np.hypot(a, b)[k]) else float("inf")


def _zeros(x: Array, y: Array) -> list[float]:
    """Positions in (-1, 1) at which a bend in one plane changes sign."""
    angle = _direction(x, y)
    if not np.isfinite(angle) or not (np.any(x) or np.any(y)):
        return []
    size = max(len(x), len(y))
    # In one plane |u*_xy| = |bend|, which has a kink where bend changes its sign.
    bend = sum(f * np.pad(c, (0, size - len(c))) for f, c in ((np.cos(angle), x), (np.sin(angle), y)))
    return sorted(zeros(np.asarray(bend), 1e-9).tolist())


def _degree(coefficients: Array) -> int:
    """Polynomial degree without negligible coefficients."""
    size = np.abs(coefficients)
    return int(np.flatnonzero(size >= DETAIL * size.max())[-1]) if size.any() else 0


def _panels(tube: Tube) -> list[_Panel]:
    """Panels of a tube from its clamped end."""
    out: list[_Panel] = []
    start, twist_angle = 0.0, 0.0
    for length, precurvature, bending, torsional in stretches(tube):
        quantities = (bending, torsional, *precurvature)
        numbers = [float(q) for q in quantities if not isinstance(q, Series)]
        if len(numbers) == len(quantities):
            out.append(_constant(start, length, numbers, twist_angle))
            twist_angle += numbers[-1] * length
        else:
            varying = _varying(start, breaks_of(quantities, length), quantities, twist_angle)
            out += varying
            twist_angle = float(chebyshev.chebval(1.0, varying[-1].channels[-1]))
        start += length
    return out


def _constant(start: float, length: float, numbers: list[float], twist_angle: float) -> _Panel:
    """Panel of constant quantities, with the natural rotation `twist_angle` at its start."""
    _, torsional, x, y, z = numbers
    half = z * length / 2
    # twist_angle + z s with s = (x + 1) length / 2.
    turned = [twist_angle + half, half] if z else [twist_angle]
    return _Panel(
        start,
        start + length,
        [*([number] for number in numbers), turned],
        direction=math.atan2(y, x) if y else 0.0,
        detail=0.0,
        twist=abs(z),
        compliance=length / torsional,
    )


def _varying(start: float, breaks: Array, quantities: Sequence[Quantity], twist_angle: float) -> list[_Panel]:
    """Panels of varying quantities between breaks, with the natural rotation `twist_angle` at the start."""
    out, (nodes, weights) = [], gauss_rule()
    for k, channels in enumerate(zip(*(on_panels(q, breaks) for q in quantities), strict=True)):
        low, length = start + breaks[k], breaks[k + 1] - breaks[k]
        # Integral of u*_z from the beginning of the panel; ds = (length / 2) dx.
        turned = chebyshev.chebint(channels[4], lbnd=-1, scl=length / 2)
        turned[0] += twist_angle
        twist_angle = float(chebyshev.chebval(1.0, turned))
        out.append(
            _Panel(
                low,
                start + breaks[k + 1],
                [*channels, turned],
                direction=_direction(channels[2], channels[3]),
                detail=max(_degree(c) for c in channels) / length,
                # |T_k| <= 1, so that the sum of |c_k| bounds |u*_z|.
                twist=float(np.abs(channels[4]).sum()),
                compliance=length * float(weights @ (1 / chebyshev.chebval(2 * nodes - 1, channels[1]))),
                sides=tuple(low + length / 2 * (x + 1) for x in _zeros(channels[2], channels[3])),
            )
        )
    return out


def _cuts(tube: Tube, panels: list[_Panel]) -> tuple[float, ...]:
    """Ends of the pieces of a tube, and sign changes of its bend, from its clamped end, m."""
    ends = accumulate((length for length, *_ in stretches(tube)), initial=0.0)
    return tuple(sorted([*ends, *(side for panel in panels for side in panel.sides)]))


# Cells of a piece along which something varies: each costs a row in every bound of a proof.
MAX_CELLS = 8

# Variation of stiffness or |kb u*_xy| along a cell, as a fraction of the largest on the piece, above which there are
# more cells: bounds of a product lose about as much as its factors vary.
CHANGE = 0.2

# Length (m) by which bounds hold beyond the ends of a cell, where the piece continues: points that round-off puts to
# the wrong side of a breakpoint are still covered.
BEYOND = 1e-8

# Fraction of the smallest value found that a lower bound of a stiffness must reach. Stiffness divides in all bounds,
# so that they lose up to a ninth by it.
CLOSE = 0.9

# Halvings of a part for its bounds, at most and at least. Chebyshev sums converge like the square of the length:
# twelve reduce the loss 1.6e7 times.
HALVINGS, MIN_HALVINGS = 12, 2

# Numbers that are found of a cell.
BOUNDS = 17


@dataclass(frozen=True, eq=False)
class Variation:
    """Bounds on the cells of n tubes, (n, C + 1); a piece without variation is one cell.

    The last cell is behind the end.

    a is kb u*_xy in the tube's own frame, and ' the derivative by arc length along the tube. Behind the end kt is what
    it was, and all else is 0.

    Attributes:
        cuts: (n, C) where cells end, from the held end, m; the first is the straight part. Tubes of fewer cells are
            filled up with cells without length.
        bending: (4, ...) kb from below, |kb'|, |kb''|, |kb'''|.
        torsional: kt from below.   compliance: (3, ...) |(1 / kt)'|, |(1 / kt)''|, |(1 / kt)'''|.
        moment: (4, ...) |a|, |a'|, |a''|, |a'''|.
        twist: (3, ...) |u*_z|, |u*_z'|, |u*_z''|.
        stiffest: (2, ...) kb and kt from above.
    """

    cuts: Array
    bending: Array
    torsional: Array
    compliance: Array
    moment: Array
    twist: Array
    stiffest: Array

    @property
    def still(self) -> bool:
        """True if no quantity varies along a cell."""
        return not any(rates.any() for rates in (self.bending[1:], self.compliance, self.moment[1:], self.twist[1:]))


@lru_cache(maxsize=128)
def variation(tubes: tuple[Tube, ...]) -> Variation:
    """The bounds of some tubes."""
    table = lengthwise(tubes)
    cells = [_cells(tube) for tube in tubes]
    longest = max(2, *(len(tube_cells) for tube_cells in cells))
    cuts = np.array([[cut for *_, cut in [*row, *[row[-1]] * (longest - len(row))]] for row in cells])
    bounds = np.zeros((BOUNDS, len(tubes), longest + 1))
    for i, tube_cells in enumerate(cells):
        for c, (low, high, _) in enumerate(tube_cells):
            bounds[:, i, c] = _bounds(table, i, low, high)
        # Cells that fill up have no length; they repeat the last one, so that no bound of theirs is 0.
        bounds[:, i, len(tube_cells) : longest] = bounds[:, i, len(tube_cells) - 1, None]
        # Behind the end kt stays what it was, since 1 / kt is taken there too.
        bounds[4, i, longest] = bounds[4, i, longest - 1]
    return Variation(
        cuts=cuts,
        bending=bounds[0:4],
        torsional=bounds[4],
        compliance=bounds[5:8],
        moment=bounds[8:12],
        twist=bounds[12:15],
        stiffest=bounds[15:],
    )


def _cells(tube: Tube) -> list[tuple[float, float, float]]:
    """Cells of a tube: two arc lengths between which the bounds of each apply, and its end, m."""
    cells, start = [], 0.0
    for length, precurvature, bending, torsional in stretches(tube):
        count = _count((*precurvature, bending, torsional), length)
        cuts = [*(start + length * k / count for k in range(count)), start + length]
        cells += [(max(low - BEYOND, start), min(high + BEYOND, start + length), high) for low, high in pairwise(cuts)]
        start += length
    # Cell 0 is the straight part in every tube, also where it has no length.
    return cells if tube.straight_length > 0 else [(*cells[0][:2], 0.0), *cells]


def _count(quantities: tuple[Quantity, ...], length: float) -> int:
    """Number of cells of a piece; `quantities` are precurvature x, y, z (1/m), kb and kt (N m^2) along it."""
    if not vary(quantities):
        return 1
    s = np.linspace(0.0, length, 16 * MAX_CELLS + 1)
    x, y, _, kb, kt = (values(q, s) for q in quantities)
    ranges = [(np.ptp(each), np.abs(each).max()) for each in (kb, kt, kb * np.hypot(x, y))]
    ratio = max(float(change / size) if size > 0 else 0.0 for change, size in ranges)
    return int(np.clip(np.ceil(ratio / CHANGE), 1, MAX_CELLS))


def _bounds(table: Lengthwise, tube: int, low: float, high: float) -> Array:
    """Bounds (BOUNDS,) on the properties of a tube between two arc lengths."""
    breaks = table.breaks[tube][np.isfinite(table.breaks[tube])]
    cells = []
    for panel, (first, last) in enumerate(pairwise(breaks)):
        a, b = max(low, first), min(high, last)
        # What a cell and a panel have in common by round-off is bounded from the other side.
        if b - a > BEYOND / 2:
            ends = (2 * np.array([a, b]) - first - last) / (last - first)
            cells += _parts(table.coefficients[tube, panel, :5], ends, last - first, HALVINGS)
    parts = np.array(cells)
    out: Array = parts.max(0)
    # kb and kt are bounded from below, everything else from above.
    out[[0, 4]] = parts[:, [0, 4]].min(0)
    return out


def _parts(coefficients: Array, ends: Array, length: float, halvings: int) -> list[Array]:
    """Bounds of quantities (5, D) on parts of an interval (2,) within -1 to 1 of a panel."""
    middle, half = ends.mean(), (ends[1] - ends[0]) / 2
    part = part_of(coefficients.T, ends).T
    values = chebyshev.chebval(chebyshev.chebpts1(coefficients.shape[1]), part.T)
    still = (coefficients[:, 1:] == 0).all(1)
    # Converting a constant adds round-off, which would count as a rate of change.
    part[still] = coefficients[still]
    bound = _bound(part, length * half / 2)
    # Values at Chebyshev points lie above the true minimum, the bound below it: this compares both ends.
    loose = (bound[[0, 4]] < CLOSE * values[:2].min(1)).any() or halvings > HALVINGS - MIN_HALVINGS
    if halvings and loose and not still.all():
        halves = np.array([ends[0], middle]), np.array([middle, ends[1]])
        return [part for each in halves for part in _parts(coefficients, each, length, halvings - 1)]
    return [bound]


def _bound(coefficients: Array, half: float) -> Array:
    """Bounds (BOUNDS,) of kb, kt, x, y and z (5, D) on -1 to 1, a stretch of twice `half`, m."""
    kb, kt, x, y, z = coefficients
    # |a|^2 = a_x^2 + a_y^2 is one polynomial. Its bound is closer than the bounds of both parts together.
    moment = [chebyshev.chebmul(kb, each) for each in (x, y)]
    square = chebyshev.chebadd(*(chebyshev.chebmul(each, each) for each in moment))
    (_, *bending), (_, kt1, kt2, kt3), twist = (_sizes(each, half) for each in (kb, kt, z))
    sides = [_sizes(each, half) for each in moment]
    # c_0 minus the sum of |c_k|, k > 0: a lower bound, since |T_k| <= 1 and c_0 > 0.
    low = [2 * each[0] - np.abs(each).sum() for each in (kb, kt)]
    # (1 / k)' = -k' / k^2. (1 / k)'' = 2 k'^2 / k^3 - k'' / k^2. (1 / k)''' = 6 k' k'' / k^3 - 6 k'^3 / k^4 - k''' /
    # k^2. Signs are dropped and k is its lower bound, so that each sum is an upper bound.
    one, two, three = kt1 / low[1], kt2 / low[1], kt3 / low[1]
    compliance = np.array([one, two + 2 * one**2, three + 6 * one * two + 6 * one**3]) / low[1]
    return np.array(
        [
            *(low[0], *bending),
            *(low[1], *compliance),
            *(np.abs(square).sum() ** 0.5, *np.hypot(*sides)[1:]),
            *twist[:3],
            *(np.abs(each).sum() for each in (kb, kt)),
        ]
    )


def _sizes(coefficients: Array, half: float) -> Array:
    """(4,) bounds of the size of a polynomial and of its first three derivatives by arc length."""
    orders = [coefficients]
    for _ in range(3):
        # d/ds = (1 / half) d/dx.
        orders.append(np.asarray(chebyshev.chebder(orders[-1]) / half, dtype=float))
    return np.array([np.abs(each).sum() for each in orders])


# Gauss points by which means along a step are taken: exact for polynomials up to degree 15.
NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)

# Steps of a piece that varies, and the fraction of its length by which its curve may be off: 2 um on 40 mm.
# Expressions, and the time to solve a program of them, grow with every step.
MIN_STEPS, MAX_STEPS, OFF = 4, 12, 5e-5


@dataclass(frozen=True, eq=False)
class Steps:
    """n tubes of up to C stretches; shorter chains are filled up with stretches without length.

    cuts: (n, C) where stretches end, from the held end, m; the first is the straight part.  bending, torsional,
    curvature, phase, twist: (n, C) EI, GJ, |u*_xy|, the direction of that in the tube's own frame, and u*_z.
    twist_angle: (n, C) natural turn where stretches begin.
    """

    cuts: Array
    bending: Array
    torsional: Array
    curvature: Array
    phase: Array
    twist: Array
    twist_angle: Array


def steps_of(tubes: Sequence[Tube]) -> Steps:
    """Stretches of tubes; for tubes that vary along a piece accurate to about 0.01 % of their length."""
    rows = []
    for tube in map(_in_steps, tubes):
        chain = stretches(tube)
        if tube.straight_length == 0:
            chain = [chain[0]._replace(length=0.0, precurvature=(0.0, 0.0, 0.0)), *chain]
        rows.append([(length, *u, bending, torsional) for length, u, bending, torsional in chain])
    longest = max(2, *(len(row) for row in rows))
    table = np.array([[*row, *[(0.0, *row[-1][1:])] * (longest - len(row))] for row in rows], dtype=float)
    length, x, y, z, bending, torsional = table.transpose(2, 0, 1)
    # The turn where a stretch begins: the sum without its own part.
    twist_angle = np.cumsum(length * z, axis=1) - length * z
    return Steps(
        cuts=np.cumsum(length, axis=1),
        bending=bending,
        torsional=torsional,
        curvature=np.hypot(x, y),
        phase=np.arctan2(y, x),
        twist=z,
        twist_angle=twist_angle,
    )


def varies(tubes: Sequence[Tube]) -> bool:
    """True if a quantity varies along a piece of a tube."""
    return any(vary((*u, *stiff)) for tube in tubes for _, u, *stiff in stretches(tube))


def _in_steps(tube: Tube) -> Tube:
    pieces = [part for piece in tube.pieces for part in _steps(piece)]
    if len(pieces) == len(tube.pieces):
        return tube
    return replace(tube, curvature=max(piece.largest_curvature for piece in pieces), pieces=tuple(pieces))


def _steps(piece: Piece) -> list[Piece]:
    parts = *piece.precurvature, piece.bending_stiffness, piece.torsional_stiffness
    if not vary(parts):
        return [piece]
    count = _step_count(piece)
    nodes = (np.arange(count)[:, None] + (NODES + 1) / 2) * (piece.length / count)
    x, y, z, kb = (_means(part, nodes) for part in parts[:4])
    # The moment hardly changes along a step, so that 1 / GJ is averaged for torsion. Tubes share one curvature, which
    # hardly changes either, so that EI is averaged for bending.
    kt = _means(piece.torsional_stiffness, nodes, -1)
    return [
        replace(piece, length=piece.length / count, precurvature=u, bending_stiffness=b, torsional_stiffness=t)
        for u, b, t in zip(zip(x, y, z, strict=True), kb, kt, strict=True)
    ]


def _step_count(piece: Piece) -> int:
    """Number of integration steps of a piece that varies."""
    s = np.linspace(0.0, piece.length, 8 * MAX_STEPS + 1)
    x, y, z = (values(q, s) for q in piece.precurvature)
    # A step turns with the mean of u*_z. The rest, at most half its range, moves u*_xy at this rate.
    turned = np.hypot(x, y).max() * np.ptp(z) / 2
    fast = float(np.hypot(np.gradient(x, s), np.gradient(y, s)).max() + turned)
    # |du*/ds| L h^2 / 12 <= OFF L with h = L / count, solved for count.
    return int(np.clip(np.ceil(piece.length * np.sqrt(fast / (12 * OFF))), MIN_STEPS, MAX_STEPS))


def _means(quantity: Quantity | None, nodes: Array, power: int = 1) -> list[Any]:
    """Mean of a quantity, or of its reciprocal, in every step."""
    if not isinstance(quantity, Series):
        return [quantity] * len(nodes)
    means: list[Any] = ((quantity(nodes) ** power @ WEIGHTS / 2) ** power).tolist()
    return means
