"""Precurvature and stiffness along the tubes of a bundle, as one table of polynomials that is read at any points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import accumulate

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from ..typing import Array, Mask
from .series import Quantity, Series, breaks_of, on_panels, zeros
from .tubes import Tube, stretches

QUANTITIES = ("bending_stiffness", "torsional_stiffness", "x", "y", "z", "wound")
"""What the table holds: EI, GJ, u*, and the integral of u*_z from the held end."""

QUADRATURE = 32
"""Gauss points of a panel for the torsional compliance: exact for what 64 coefficients resolve."""

DETAIL = 1e-9
"""Of the largest coefficient: smaller ones do not ask for a finer mesh."""


@dataclass(frozen=True, eq=False)
class CrossSections:
    """n tubes at X points of a bundle, (X, n) each: EI of the tubes present, m = EI |u*_xy|, the direction `phase` of
    their pull from where they are turned to without elastic torsion, GJ, and the natural twist u*_z with its integral
    `wound` from the held end. Where a tube is not present stiffness and moment are 0."""

    stiffness: Array
    moment: Array
    phase: Array
    torsional_stiffness: Array
    twist: Array
    wound: Array


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
        """Whether GJ is the same all along every panel."""
        return not self.coefficients[:, :, 1, 1:].any()

    @cached_property
    def _varied(self) -> Mask:
        """(n, B) whether there is anything along a panel that varies, the natural turn included."""
        return np.asarray(self.coefficients[..., 1:].any((2, 3)))

    def steady(self, low: Array, high: Array) -> Mask:
        """(P,) whether no tube varies along stretches from `low` to `high` (P, n) from the held ends, m."""
        panel, tube = self.panel(low), np.arange(self.n_tubes)
        return np.asarray(((panel == self.panel(high)) & ~self._varied[tube, panel]).all(1))

    def panel(self, place: Array) -> NDArray[np.intp]:
        """(X, n) panel of each tube at arc lengths (X, n) from its held end, m; those outside are of the nearest."""
        last = np.isfinite(self.breaks).sum(1) - 2
        found = (place[:, :, None] >= self.breaks[:, 1:]).sum(2)
        return np.asarray(np.minimum(found, last))

    def _panels_at(self, place: Array, inside: Array) -> tuple[Array, Array, Array]:
        """Coefficients (X, n, 6, D) of the panels that hold `inside` (X, n), where on them `place` (X, n) is, -1 to 1,
        and their lengths (X, n)."""
        panel, tube = self.panel(inside), np.arange(self.n_tubes)
        low, high = self.breaks[tube, panel], self.breaks[tube, panel + 1]
        x = np.clip((2 * place - low - high) / (high - low), -1.0, 1.0)
        return self.coefficients[tube, panel], x, high - low

    def values(self, place: Array, inside: Array | None = None) -> Array:
        """(6, X, n) QUANTITIES at arc lengths (X, n) from the held ends, m.

        Args:
            inside: (X, n) places on the same stretch by which the panel is chosen, where `place` may be at its end.
        """
        chosen = place if inside is None else inside
        if not self._varied.any():
            table = self.coefficients[np.arange(self.n_tubes), self.panel(chosen), :, 0]
            return np.ascontiguousarray(table.transpose(2, 0, 1))
        table, x, _ = self._panels_at(place, chosen)
        basis = np.stack([np.ones_like(x), x, *(np.empty_like(x) for _ in range(table.shape[-1] - 2))], axis=-1)
        for k in range(2, table.shape[-1]):
            basis[..., k] = 2 * x * basis[..., k - 1] - basis[..., k - 2]
        return np.asarray((table @ basis[..., None])[..., 0].transpose(2, 0, 1))

    def rates(self, place: Array, inside: Array) -> Array:
        """(6, X, n) derivatives of QUANTITIES by arc length, as `values`."""
        table, x, length = self._panels_at(place, inside)
        degree = table.shape[-1] - 1
        slopes = chebyshev.chebder(np.eye(degree + 1), axis=0).T
        basis = chebyshev.chebvander(x, degree)[..., :degree] @ slopes.T
        return np.asarray(((table @ basis[..., None])[..., 0] * (2 / length)[..., None]).transpose(2, 0, 1))

    def compliant(self, place: Array) -> Array:
        """(..., n) int ds / GJ of each tube from its held end to arc lengths (..., n), 1/(N m)."""
        tube, at = np.arange(self.n_tubes), place.reshape(-1, self.n_tubes)
        panel = self.panel(at)
        low = self.breaks[tube, panel]
        high = np.clip(at, low, self.breaks[tube, panel + 1])
        nodes, weights = (np.array([0.5]), np.ones(1)) if self._even else gauss_rule()
        s = low + (high - low) * nodes[:, None, None]
        inside = np.broadcast_to((low + high) / 2, s.shape)
        rate = 1 / self.values(s.reshape(-1, self.n_tubes), inside.reshape(-1, self.n_tubes))[1].reshape(s.shape)
        whole = self.compliance[tube, panel] + (high - low) * np.tensordot(weights, rate, 1)
        return np.asarray(whole.reshape(place.shape))

    def at(self, place: Array, inside: Array, present: Mask) -> CrossSections:
        """The tubes at arc lengths (X, n) from their held ends; `inside` as in `values`; (X, n) which are there."""
        bending, torsional, x, y, z, wound = self.values(place, inside)
        kb = bending * present
        return CrossSections(
            stiffness=kb,
            moment=kb * np.hypot(x, y),
            phase=wound + np.arctan2(y, x),
            torsional_stiffness=torsional,
            twist=z * present,
            wound=wound,
        )


@lru_cache(maxsize=1)
def gauss_rule() -> tuple[Array, Array]:
    """Nodes and weights (QUADRATURE,) on 0 to 1."""
    x, w = np.polynomial.legendre.leggauss(QUADRATURE)
    return (x + 1) / 2, w / 2


@dataclass(frozen=True)
class _Panel:
    """A stretch of a tube between two arc lengths from its held end, m, with the coefficients of QUANTITIES, and with
    direction, detail and twist as of `Lengthwise`; int ds / GJ along it; and where its bend changes sides, m."""

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
    """The table of a bundle of tubes."""
    panels = [_panels(tube) for tube in tubes]
    n, most = len(tubes), max(len(own) for own in panels)
    width = max(2, *(len(c) for own in panels for panel in own for c in panel.channels))
    breaks, table = np.full((n, most + 1), np.inf), np.zeros((n, most, len(QUANTITIES), width))
    direction, detail, twist = np.zeros((3, n, most))
    compliance = np.zeros((n, most + 1))
    for i, own in enumerate(panels):
        breaks[i, : len(own) + 1] = [0.0, *(panel.high for panel in own)]
        compliance[i, 1 : len(own) + 1] = list(accumulate(panel.compliance for panel in own))
        for name, values in (("direction", direction), ("detail", detail), ("twist", twist)):
            values[i, : len(own)] = [getattr(panel, name) for panel in own]
        for k, panel in enumerate(own):
            for q, coefficients in enumerate(panel.channels):
                table[i, k, q, : len(coefficients)] = coefficients
    bent = np.asarray(table[:, :, 2:4].any((2, 3)))
    cuts = tuple(_cuts(tube, own) for tube, own in zip(tubes, panels, strict=True))
    return Lengthwise(breaks, table, bent, direction, detail, twist, cuts, compliance)


def _direction(x: Array, y: Array) -> float:
    """The direction of (x, y) whose coefficients are in proportion, -pi/2 to pi/2; inf where they are not."""
    if not np.any(y):
        return 0.0
    size = max(len(x), len(y))
    a, b = (np.pad(c, (0, size - len(c))) for c in (x, y))
    k = int(np.argmax(np.hypot(a, b)))
    angle = float(np.arctan2(b[k], a[k]))
    across = np.cos(angle) * b - np.sin(angle) * a
    return angle if np.abs(across).max() <= 1e-15 * float(np.hypot(a, b)[k]) else float("inf")


def _zeros(x: Array, y: Array) -> list[float]:
    """Where in -1 .. 1 a bend in one plane changes sides, ends left out."""
    angle = _direction(x, y)
    if not np.isfinite(angle) or not (np.any(x) or np.any(y)):
        return []
    size = max(len(x), len(y))
    bend = sum(f * np.pad(c, (0, size - len(c))) for f, c in ((np.cos(angle), x), (np.sin(angle), y)))
    return sorted(zeros(np.asarray(bend), 1e-9).tolist())


def _degree(coefficients: Array) -> int:
    """Polynomial degree without what does not matter."""
    size = np.abs(coefficients)
    return int(np.flatnonzero(size >= DETAIL * size.max())[-1]) if size.any() else 0


def _panels(tube: Tube) -> list[_Panel]:
    """The panels of a tube from its held end."""
    out: list[_Panel] = []
    start, wound = 0.0, 0.0
    for length, precurvature, bending, torsional in stretches(tube):
        quantities = (bending, torsional, *precurvature)
        numbers = [float(q) for q in quantities if not isinstance(q, Series)]
        if len(numbers) == len(quantities):
            out.append(_constant(start, length, numbers, wound))
            wound += numbers[-1] * length
        else:
            varying = _varying(start, breaks_of(quantities, length), quantities, wound)
            out += varying
            wound = float(chebyshev.chebval(1.0, varying[-1].channels[-1]))
        start += length
    return out


def _constant(start: float, length: float, numbers: list[float], wound: float) -> _Panel:
    """The panel of a stretch along which nothing varies but the natural turn, `wound` at its beginning."""
    _, torsional, x, y, z = numbers
    half = z * length / 2
    turned = [wound + half, half] if z else [wound]
    return _Panel(
        start,
        start + length,
        [*([number] for number in numbers), turned],
        direction=math.atan2(y, x) if y else 0.0,
        detail=0.0,
        twist=abs(z),
        compliance=length / torsional,
    )


def _varying(start: float, breaks: Array, quantities: Sequence[Quantity], wound: float) -> list[_Panel]:
    """The panels of a stretch with breaks from its beginning, where the natural turn is `wound`."""
    out, (nodes, weights) = [], gauss_rule()
    for k, channels in enumerate(zip(*(on_panels(q, breaks) for q in quantities), strict=True)):
        low, length = start + breaks[k], breaks[k + 1] - breaks[k]
        turned = chebyshev.chebint(channels[4], lbnd=-1, scl=length / 2)
        turned[0] += wound
        wound = float(chebyshev.chebval(1.0, turned))
        out.append(
            _Panel(
                low,
                start + breaks[k + 1],
                [*channels, turned],
                direction=_direction(channels[2], channels[3]),
                detail=max(_degree(c) for c in channels) / length,
                twist=float(np.abs(channels[4]).sum()),
                compliance=length * float(weights @ (1 / chebyshev.chebval(2 * nodes - 1, channels[1]))),
                sides=tuple(low + length / 2 * (x + 1) for x in _zeros(channels[2], channels[3])),
            )
        )
    return out


def _cuts(tube: Tube, panels: list[_Panel]) -> tuple[float, ...]:
    """Where pieces of a tube begin and end, and where its bend changes sides, from its held end, m."""
    ends = accumulate((length for length, *_ in stretches(tube)), initial=0.0)
    return tuple(sorted([*ends, *(side for panel in panels for side in panel.sides)]))
