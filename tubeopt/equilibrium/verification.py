"""A check of an equilibrium that shares nothing with the solver but the tubes: adaptive integration of the equations.

From the solved values at the plate, torsion and shape are integrated to the tip by DOP853 (SciPy) with tolerance 1e-12,
section by section, with the physics written out once more in NumPy.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from ..robots.assembly import Assembly
from ..typing import Array
from .result import Equilibrium, Verification

TOLERANCE = 1e-12


def verify_equilibrium(equilibrium: Equilibrium) -> Equilibrium:
    """The same equilibrium with its `verification` filled in."""
    assembly = equilibrium.robot.assembly(equilibrium.translations)
    n = assembly.n_tubes
    state = _base(equilibrium, assembly)
    base = state[:n] - assembly.transmission * state[n : 2 * n] - equilibrium.rotations
    worst, loose = 0.0, 0.0
    for k in range(assembly.n_sections):
        stop = assembly.start[k] + assembly.length[k]
        state = _integrated(assembly, k, stop, state)
        solved = equilibrium.rotation[:, np.argmin(np.abs(equilibrium.arc_length - stop))]
        worst = max(worst, float(np.abs(state[:n] - solved).max()))
        ends = np.abs(assembly.end - stop) < 1e-12
        loose = max(loose, float(np.abs(state[n : 2 * n][ends]).max(initial=0.0)))
    turn = state[2 * n : 2 * n + 9].reshape(3, 3).T @ equilibrium.tip_rotation
    # For a small turn the antisymmetric part of R is the turn vector; arccos of the trace would lose half the digits.
    vector = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    return replace(
        equilibrium,
        verification=Verification(
            tip_position=float(np.linalg.norm(state[2 * n + 9 :] - equilibrium.tip_position)),
            tip_rotation=float(np.linalg.norm(vector)),
            rotation=worst,
            end_torsion=loose,
            base_rotation=float(np.abs(base).max(initial=0.0)),
        ),
    )


def point_at(equilibrium: Equilibrium, arc_length: float) -> tuple[Array, Array]:
    """Position (3,), m, and curvature (2,) in the Bishop frame, 1/m, at an arc length, by the same integration."""
    assembly = equilibrium.robot.assembly(equilibrium.translations)
    state, u = _base(equilibrium, assembly), np.zeros(2)
    for k in range(assembly.n_sections):
        stop = min(assembly.start[k] + assembly.length[k], arc_length)
        if k and stop <= assembly.start[k]:
            break
        state = _integrated(assembly, k, stop, state)
        u = _curvature(assembly, k, state[: assembly.n_tubes])
    return state[-3:], u


def _base(equilibrium: Equilibrium, assembly: Assembly) -> Array:
    """(theta, w, R, p) at the plate."""
    theta, torsion = equilibrium.rotation[:, 0], equilibrium.torsion[:, 0]
    return np.concatenate([theta, torsion / _stretch(assembly, 0, theta), np.eye(3).ravel(), np.zeros(3)])


def _integrated(assembly: Assembly, section: int, stop: float, state: Array) -> Array:
    """The state at an arc length on a section, from that at its beginning."""
    run = scipy.integrate.solve_ivp(
        lambda s, y: _right_hand_side(assembly, section, y),
        (assembly.start[section], stop),
        state,
        method="DOP853",
        rtol=TOLERANCE,
        atol=TOLERANCE,
    )
    return np.asarray(run.y[:, -1])


def _curvature(assembly: Assembly, section: int, theta: Array) -> Array:
    """u (2,) of one cross-section: fixed-point iteration on u sum kb / g(u) = sum kb kappa e."""
    stiffness = assembly.bending_stiffness * assembly.present[section]
    pull = assembly.bending_stiffness * assembly.curvature * assembly.curved[section]
    total = np.array([pull @ np.cos(theta), pull @ np.sin(theta)])
    u = total / stiffness.sum()
    if assembly.eccentric:
        for _ in range(60):
            u = total / (stiffness / _stretch_of(assembly, u)).sum()
    return np.asarray(u)


def _stretch_of(assembly: Assembly, u: Array) -> Array:
    angle = assembly.offset_angle
    return np.asarray(1 + assembly.offset * (u[0] * np.sin(angle) - u[1] * np.cos(angle)))


def _stretch(assembly: Assembly, section: int, theta: Array) -> Array:
    if not assembly.n_sections:
        return np.ones(assembly.n_tubes)
    return _stretch_of(assembly, _curvature(assembly, section, theta))


def _right_hand_side(assembly: Assembly, section: int, state: Array) -> Array:
    """(theta, w, R, p)' at one point."""
    n = assembly.n_tubes
    theta, w, frame = state[:n], state[n : 2 * n], state[2 * n : 2 * n + 9].reshape(3, 3)
    u = _curvature(assembly, section, theta)
    pull = assembly.bending_stiffness * assembly.curvature * assembly.curved[section]
    gain = pull * (u[0] * np.sin(theta) - u[1] * np.cos(theta)) / assembly.torsional_stiffness
    hat = np.array([[0, 0, u[1]], [0, 0, -u[0]], [-u[1], u[0], 0]])
    return np.concatenate([_stretch_of(assembly, u) * w, gain, (frame @ hat).ravel(), frame[:, 2]])
