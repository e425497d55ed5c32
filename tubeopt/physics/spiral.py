"""Tubes that spiral around the centreline of a loose sheath.

A tube runs at the distance d from the centreline, in the direction phi that turns at the rate t = phi' (rad/m). With
the curvature u of the centreline in its Bishop frame, the stretch g = 1 + d a.u of a parallel tube, and components
along r (outwards) and q (around), both across the centreline, the tube has

    l = sqrt(g^2 + d^2 t^2)   length per length of the centreline,          tan b = d t / g   inclination,
    (u_r - b') r + (u_q cos b - t sin b) q   curvature,        u_q sin b - t (1 - cos b)   twist,

the last two per length of the centreline, in the Bishop frame that is inclined with the tube. Its own rotation theta in
this frame adds theta' to the twist. The terms follow from the rotation Q by b about -r: they are those of Q'u and Q'Q'.
b' is that of a constant curvature u.

Tubes that touch each other have more distance from the centreline, the more they spiral: two helices are closest not in
one cross-section, but where one is t dz behind.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy


class Strand(NamedTuple):
    """A tube that spirals, per length of the centreline."""

    length: Any
    """Length of the tube."""
    bend: Any
    """Curvature (2,) in the inclined Bishop frame, 1/m."""
    twist: Any
    """Twist of this frame about the tube, 1/m."""


def strand(u: Any, offset: Any, angle: Any, rate: Any) -> Strand:
    """A tube at the offset d (m) and angle phi (rad) that turns at a rate (rad/m), at the curvature u (2,), 1/m."""
    c, s = ca.cos(angle), ca.sin(angle)
    out, around = c * u[0] + s * u[1], c * u[1] - s * u[0]
    g, aside = 1 + offset * (s * u[0] - c * u[1]), offset * rate
    length = ca.sqrt(g**2 + aside**2)
    cosine, sine = g / length, aside / length
    # g' = d t u_r at a constant u, and b' = -d t g' / l^2.
    across = out + aside**2 * out / length**2
    along = around * cosine - rate * sine
    bend = ca.vertcat(c * across - s * along, s * across + c * along)
    return Strand(length, bend, around * sine - rate * (1 - cosine))


@lru_cache(maxsize=8)
def spiral_energy(n: int) -> ca.Function:
    """Elastic energy of n tubes that spiral, per length of the centreline, J/m.

    Args of the function: theta and theta' (n,), u (2,), rate, and kb, kt, precurvature, offset, angle (n,).
    """
    theta, turn, u, rate = ca.SX.sym("theta", n), ca.SX.sym("turn", n), ca.SX.sym("u", 2), ca.SX.sym("rate")
    kb, kt, natural, offset, angle = (ca.SX.sym(name, n) for name in ("kb", "kt", "natural", "offset", "angle"))
    energy = 0.0
    for i in range(n):
        tube = strand(u, offset[i], angle[i], rate)
        bent = tube.bend / tube.length - natural[i] * ca.vertcat(ca.cos(theta[i]), ca.sin(theta[i]))
        twist = (turn[i] + tube.twist) / tube.length
        energy += tube.length * (kb[i] * ca.sumsqr(bent) + kt[i] * twist**2) / 2
    return ca.Function("spiral_energy", [theta, turn, u, rate, kb, kt, natural, offset, angle], [energy])


def touching_offset(outer_diameter: float, rate: float, count: int = 3) -> float:
    """Distance (m) of `count` equal tubes from the centreline if neighbours touch and all spiral at a rate, rad/m."""
    apart = 2 * np.pi / count
    straight = outer_diameter / (2 * np.sin(apart / 2))

    def excess(offset: float) -> float:
        """Smallest distance between two neighbours over that of touching ones, squared, less 1."""

        def squared(behind: float) -> float:
            return float(2 * offset**2 * (1 - np.cos(apart + rate * behind)) + behind**2) / outer_diameter**2

        farthest = offset**2 * abs(rate)
        closest = scipy.optimize.minimize_scalar(
            squared, bounds=(-farthest, farthest), method="bounded", options={"xatol": 1e-9 * outer_diameter}
        )
        return float(closest.fun) - 1

    return float(scipy.optimize.brentq(excess, straight * (1 - 1e-9), 2 * straight, xtol=1e-13)) if rate else straight


def spiral_rate(outer_diameter: float, room: float, count: int = 3) -> float:
    """Rate (rad/m) at which `count` equal tubes that touch each other lie farther from the centreline by `room`, m."""
    straight = touching_offset(outer_diameter, 0.0, count)
    if room <= 0:
        return 0.0

    def excess(rate: float) -> float:
        return touching_offset(outer_diameter, rate, count) - straight - room

    # Small room grows with the square of the rate: offset^3 rate^2 / 8 for three tubes.
    rate = math.sqrt(8 * room / straight**3)
    while excess(rate) < 0:
        rate *= 2
    return float(scipy.optimize.brentq(excess, 0.0, rate, rtol=1e-9))
