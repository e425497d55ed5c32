"""Precurvature and stiffness along the tubes of a bundle, as one table of polynomials that is read at any points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from ..typing import Array, Mask
from .series import breaks_of, on_panels
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
        detail: (n, B) polynomial degree that matters, per length of the panel, 1/m.
        twist: (n, B) largest |u*_z|, 1/m.
        cuts: per tube, where its pieces begin and end, from the held end, m.
        compliance: (n, B + 1) int ds / GJ from the held end to each break, 1/(N m).
    """

    breaks: Array
    coefficients: Array
    bent: Mask
    detail: Array
    twist: Array
    cuts: tuple[tuple[float, ...], ...]
    compliance: Array

    @property
    def n_tubes(self) -> int:
        """Number of tubes n."""
        return len(self.breaks)

    def panel(self, place: Array) -> NDArray[np.intp]:
        """(X, n) panel of each tube at arc lengths (X, n) from its held end, m; those outside are of the nearest."""
        last = np.isfinite(self.breaks).sum(1) - 2
        found = (place[:, :, None] >= self.breaks[:, 1:]).sum(2)
        return np.asarray(np.minimum(found, last))

    def values(self, place: Array, inside: Array | None = None) -> Array:
        """(6, X, n) QUANTITIES at arc lengths (X, n) from the held ends, m.

        Args:
            inside: (X, n) places on the same stretch by which the panel is chosen, where `place` may be at its end.
        """
        panel = self.panel(place if inside is None else inside)
        tube = np.arange(self.n_tubes)
        low, high = self.breaks[tube, panel], self.breaks[tube, panel + 1]
        x = np.clip((2 * place - low - high) / (high - low), -1.0, 1.0)
        table = self.coefficients[tube, panel]
        basis = np.stack([np.ones_like(x), x, *(np.empty_like(x) for _ in range(table.shape[-1] - 2))], axis=-1)
        for k in range(2, table.shape[-1]):
            basis[..., k] = 2 * x * basis[..., k - 1] - basis[..., k - 2]
        return np.asarray((table @ basis[..., None])[..., 0].transpose(2, 0, 1))

    def compliant(self, place: Array) -> Array:
        """(n,) int ds / GJ of each tube from its held end to an arc length (n,), 1/(N m)."""
        tube = np.arange(self.n_tubes)
        panel = self.panel(place[None])[0]
        low = self.breaks[tube, panel]
        high = np.clip(place, low, self.breaks[tube, panel + 1])
        nodes, weights = _gauss()
        s = low + (high - low) * nodes[:, None]
        rate = 1 / self.values(s, np.broadcast_to((low + high) / 2, s.shape))[1]
        return np.asarray(self.compliance[tube, panel] + (high - low) * (weights @ rate))

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
def _gauss() -> tuple[Array, Array]:
    x, w = np.polynomial.legendre.leggauss(QUADRATURE)
    return (x + 1) / 2, w / 2


@lru_cache(maxsize=128)
def lengthwise(tubes: tuple[Tube, ...]) -> Lengthwise:
    """The table of a bundle of tubes."""
    panels = [_panels(tube) for tube in tubes]
    n, most = len(tubes), max(len(own) for own, _ in panels)
    width = max(2, *(len(c) for own, _ in panels for _, _, table in own for c in table))
    breaks, table = np.full((n, most + 1), np.inf), np.zeros((n, most, len(QUANTITIES), width))
    bent, detail, twist = np.zeros((n, most), dtype=bool), np.zeros((n, most)), np.zeros((n, most))
    compliance = np.zeros((n, most + 1))
    for i, (own, _) in enumerate(panels):
        breaks[i, 0] = 0.0
        for k, (low, high, channels) in enumerate(own):
            breaks[i, k + 1] = high
            for q, coefficients in enumerate(channels):
                table[i, k, q, : len(coefficients)] = coefficients
            bent[i, k] = any(np.any(c) for c in channels[2:4])
            detail[i, k] = max(_degree(c) for c in channels[:5]) / (high - low)
            twist[i, k] = float(np.abs(channels[4]).sum())
            nodes, weights = _gauss()
            rate = chebyshev.chebval(2 * nodes - 1, channels[1])
            compliance[i, k + 1] = compliance[i, k] + (high - low) * float(weights @ (1 / rate))
    cuts = tuple(tuple(cut) for _, cut in panels)
    return Lengthwise(breaks, table, bent, detail, twist, cuts, compliance)


def _degree(coefficients: Array) -> int:
    """Polynomial degree without what does not matter."""
    size = np.abs(coefficients)
    return int(np.flatnonzero(size >= DETAIL * size.max())[-1]) if size.any() else 0


def _panels(tube: Tube) -> tuple[list[tuple[float, float, list[Array]]], list[float]]:
    """Where panels begin and end, and the coefficients of QUANTITIES on them; where pieces begin and end."""
    out: list[tuple[float, float, list[Array]]] = []
    start, wound, cuts = 0.0, 0.0, [0.0]
    for length, precurvature, bending, torsional in stretches(tube):
        quantities = (bending, torsional, *precurvature)
        breaks = breaks_of(quantities, length)
        columns = [on_panels(q, breaks) for q in quantities]
        for k, channels in enumerate(zip(*columns, strict=True)):
            half = (breaks[k + 1] - breaks[k]) / 2
            turned = chebyshev.chebint(channels[4], lbnd=-1, scl=half)
            turned[0] += wound
            wound = float(chebyshev.chebval(1.0, turned))
            out.append((start + breaks[k], start + breaks[k + 1], [*channels, turned]))
        start += length
        cuts.append(start)
    return out, cuts
