"""How far any force on the tip can move a robot that no such force can snap: a bound for every shape and direction.

Where the certificate mu under forces of at most F is positive, the potential energy of every such force is convex, and
more: with T the elastic form of `loaded_certificate` in rotations and bending, whose second variation is at least mu T
everywhere, the equilibrium x_F under a force and the one without, x_0, are apart by D = x_F - x_0 with

    mu T(D) <= F . dp_L(D) <= F g(L),    |p_F(s) - p_0(s)| <= g(s) = int_0^s phi,    phi' = sum A_i |y_i| + |r|,

since the gradient of the potential energy vanishes at x_F and is minus that of the work at x_0, and tangents turn by no
more than curvatures differ, at most A_i |y_i| by tube i and |r| by bending. g(s) is at most kappa(s) T(D)^(1/2) with

    kappa(s)^2 = int_0^s (s - x)^2 / K dx + sum_i (|beta_i| m_i(0)^2 + int_0^s m_i^2 dx) / kt_i,
    m_i(x) = int_x^s (s - t) A_i dt,

so that the arm moves by at most F kappa(L) kappa(s) / mu.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from ..robots.assembly import Assembly
from ..robots.robot import Robot
from ..typing import Array
from .certificate import snap_free_certificate

GAUSS = np.polynomial.legendre.leggauss(3)
"""Exact for the polynomials of degree 4 that are integrated on every section."""


def deflection_bound(
    robot: Robot,
    translations: ArrayLike | None = None,
    *,
    max_force: float,
    arc_length: ArrayLike | None = None,
) -> Array:
    """(S,) how far points of the arm at most move, m, whatever pushes on the tip with up to `max_force`.

    For all rotations and for all forces that keep their direction, in any direction, put on the unloaded robot;
    infinite where the certificate under that force is not positive.

    Args:
        translations: (n,) m; default home.
        max_force: N.
        arc_length: (S,) m from the plate; by default the tip alone.

    Raises:
        InputError: as `snap_free_certificate` under a force; a point that is not on the arm.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/crl_ctr.yaml")
        >>> bool(tubeopt.deflection_bound(robot, [-0.02, 0, 0], max_force=0.001)[0] < 0.3e-3)
        True
    """
    shift = robot.home_translations if translations is None else np.asarray(translations, dtype=float)
    certificate = snap_free_certificate(robot, shift, max_force=max_force)
    assembly = robot.assembly(shift)
    length = assembly.total_length
    places = np.atleast_1d(np.array([length] if arc_length is None else arc_length, dtype=float))
    if not np.isfinite(places).all() or places.min(initial=0.0) < 0 or places.max(initial=0.0) > length * (1 + 1e-12):
        raise InputError(f"arc_length is {places.tolist()} m; points must lie on the arm, between 0 and {length:g} m")
    if not max_force:
        return np.zeros(len(places))
    if certificate <= 0:
        return np.full(len(places), np.inf)
    reach = np.array([_reach(assembly, s) for s in places])
    return max_force * _reach(assembly, length) * reach / certificate


def _reach(assembly: Assembly, s: float) -> float:
    """kappa(s), m / sqrt(J)."""
    stiffness = (assembly.bending_stiffness * assembly.present).sum(1)
    slope = np.abs(assembly.bending_stiffness * assembly.curvature * assembly.curved) / stiffness[:, None]
    # Up to s, sections from the tip to the plate; m grows by what each adds.
    begin = np.minimum(assembly.start, s)
    end = np.minimum(assembly.start + assembly.length, s)
    ahead = np.zeros(assembly.n_tubes)
    total = 0.0
    for k in reversed(range(assembly.n_sections)):
        a, b = begin[k], end[k]
        x = (a + b) / 2 + (b - a) / 2 * GAUSS[0]
        inside = ((s - x) ** 2 - (s - b) ** 2) / 2
        moment = ahead + slope[k] * inside[:, None]
        total += (
            (b - a)
            / 2
            * float(GAUSS[1] @ ((s - x) ** 2 / stiffness[k] + moment**2 @ (1 / assembly.torsional_stiffness)))
        )
        ahead = ahead + slope[k] * ((s - a) ** 2 - (s - b) ** 2) / 2
    return float(np.sqrt(total + assembly.transmission @ (ahead**2 / assembly.torsional_stiffness)))
