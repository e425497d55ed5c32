"""Straight tubes between a drive and a sheath: they leave the drive apart, and enter the sheath side by side.

A tube leaves the drive and enters the sheath along the arm's axis, aside by the shift e over the length H. Its length
in between is free, since it slides in the sheath. So its bending energy is stationary with respect to this length, too:
with the slope t of the tube and the largest slope T, in the middle,

    (dt/ds)^2 = c sin(T - t).

The tube pushes back along the axis with M^2 / (2 EI), M the moment at both ends. From one end to the middle, with
p = T - t, A = int_0^T cos p / sqrt(sin p) dp = 2 sqrt(sin T) and B = int_0^T sqrt(sin p) dp,

    H / 2 = (A cos T + B sin T) / sqrt(c),     e / 2 = (A sin T - B cos T) / sqrt(c).

For small shifts T = 3 e / (2 H), M = 6 EI e / H^2, and the force across is 12 EI e / H^3.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy


class BufferBend(NamedTuple):
    """Shape of a tube of bending stiffness EI in a buffer section."""

    slope: float
    """Largest angle to the axis, rad."""
    curvature: float
    """Largest curvature, at both ends, 1/m."""
    length: float
    """Length of the tube, m."""
    across: float
    """Force across the axis at both ends, per EI, 1/m^2."""
    along: float
    """Force along the axis that pushes the drive and the sheath apart, per EI, 1/m^2."""


def _incomplete(a: float, slope: float) -> float:
    """int_0^T (sin p)^(2 a - 1) dp up to the slope T, at most a right angle."""
    return float(scipy.special.betainc(a, 0.5, np.sin(slope) ** 2) * scipy.special.beta(a, 0.5) / 2)


def _half(slope: float) -> tuple[float, float]:
    """H sqrt(c) / 2 and e sqrt(c) / 2 of a largest slope."""
    a, b = 2 * np.sqrt(np.sin(slope)), _incomplete(0.75, slope)
    return a * np.cos(slope) + b * np.sin(slope), a * np.sin(slope) - b * np.cos(slope)


STEEPEST = _half(np.pi / 2)[1] / _half(np.pi / 2)[0]
"""Largest shift per length of a buffer: at 1.67 the tube stands across the axis in the middle."""


def buffer_bend(shift: float, length: float) -> BufferBend:
    """Shape of a tube that is moved aside by `shift`, at most STEEPEST times the `length` of the buffer, m."""
    if shift <= 0:
        return BufferBend(0.0, 0.0, length, 0.0, 0.0)

    def excess(slope: float) -> float:
        along, aside = _half(slope)
        return aside - along * shift / length

    slope = float(scipy.optimize.brentq(excess, 1e-9, np.pi / 2, xtol=1e-15))
    root = 2 * _half(slope)[0] / length  # sqrt(c)
    curvature = root * np.sqrt(np.sin(slope))
    own, across = 2 * _incomplete(0.25, slope) / root, root**2 / 2 * np.cos(slope)
    return BufferBend(slope, float(curvature), own, float(across), float(curvature**2 / 2))
