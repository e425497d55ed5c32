"""A reference that shares nothing with tubeopt but the dimensions of the tubes: shooting with DOP853 to round-off.

For concentric tubes the moments are sums over pairs, kt_i theta_i'' = sum_j c_ij sin(theta_i - theta_j) with
c_ij = m_i m_j / sum kb, so that the equations, their linearisation and the sections are written out here once more.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from tubeopt import ConcentricRobot

Array = NDArray[np.float64]

TOLERANCE = 3e-14
"""Relative and absolute tolerance of the integration: the least that DOP853 accepts without a warning is 2.2e-14."""


@dataclass(frozen=True, eq=False)
class Section:
    """A stretch [start, stop] of the arm with the coupling c (n, n) of its tubes, m_i (n,), and sum kb."""

    start: float
    stop: float
    coupling: Array
    moment: Array
    stiffness: float


@dataclass(frozen=True, eq=False)
class Reference:
    """Equilibrium by shooting: theta and theta' (n,) at the plate, theta (n,) at the tip, pose of the tip, and what
    the boundary conditions are off by (rad)."""

    rotation: Array
    torsion: Array
    tip_rotations: Array
    tip_position: Array
    tip_rotation: Array
    residual: float


def sections_of(robot: ConcentricRobot, translations: Array) -> tuple[Section, ...]:
    """The sections of a robot in front of the plate, base to tip."""
    kb = np.array([tube.bending_stiffness for tube in robot.tubes])
    kappa = np.array([tube.curvature for tube in robot.tubes])
    bend = np.asarray(translations, dtype=float)
    end = bend + [tube.curved_length for tube in robot.tubes]
    cuts = np.unique(np.clip(np.concatenate([[0.0], bend, end]), 0.0, None))
    out = []
    for start, stop in pairwise(cuts):
        middle = (start + stop) / 2
        reached = end > middle
        moment = np.where(reached & (bend < middle), kb * kappa, 0.0)
        stiffness = float(kb[reached].sum())
        out.append(Section(float(start), float(stop), np.outer(moment, moment) / stiffness, moment, stiffness))
    return tuple(out)


def shoot(
    robot: ConcentricRobot, rotations: Array, translations: Array, torsion: Array, *, iterations: int = 20
) -> Reference:
    """The equilibrium whose torsion at the plate is near `torsion` (n,): Newton with exact variational equations."""
    kt = np.array([tube.torsional_stiffness for tube in robot.tubes])
    lever = np.array([tube.straight_length for tube in robot.tubes]) - translations
    sections = sections_of(robot, translations)
    n = robot.n_tubes
    w = np.array(torsion, dtype=float)
    for _ in range(iterations):
        state, slope = _integrate(sections, kt, rotations + lever * w, w, lever)
        # Beyond a tube's end its torsion stays what it was there.
        step = np.linalg.solve(slope, -state[n : 2 * n])
        w = w + step
        if np.abs(step).max() <= 1e-14 * max(1.0, float(np.abs(w).max())):
            break
    state, _ = _integrate(sections, kt, rotations + lever * w, w, lever)
    length = sections[-1].stop if sections else 0.0
    return Reference(
        rotation=rotations + lever * w,
        torsion=w,
        tip_rotations=state[:n],
        tip_position=state[2 * n + 9 : 2 * n + 12],
        tip_rotation=state[2 * n : 2 * n + 9].reshape(3, 3),
        residual=float(np.abs(state[n : 2 * n]).max(initial=0.0)) * max(length, float(lever.max())),
    )


def _integrate(sections: tuple[Section, ...], kt: Array, theta: Array, w: Array, lever: Array) -> tuple[Array, Array]:
    """(theta, w, R, p) at the tip, and d w(tip) / d w(0) (n, n)."""
    n = len(kt)
    variation = np.concatenate([np.diag(lever), np.eye(n)])
    state = np.concatenate([theta, w, np.eye(3).ravel(), np.zeros(3), variation.ravel()])
    for section in sections:
        run = solve_ivp(
            lambda s, y, section=section: _slope(section, kt, y),
            (section.start, section.stop),
            state,
            method="DOP853",
            rtol=TOLERANCE,
            atol=TOLERANCE,
        )
        state = run.y[:, -1]
    return state, state[2 * n + 12 :].reshape(2 * n, n)[n:]


def _slope(section: Section, kt: Array, y: Array) -> Array:
    n = len(kt)
    theta, w, frame = y[:n], y[n : 2 * n], y[2 * n : 2 * n + 9].reshape(3, 3)
    apart = theta[:, None] - theta
    force = section.coupling * np.sin(apart)
    spring = section.coupling * np.cos(apart)
    stiffness = np.diag(spring.sum(1)) - spring
    ux, uy = (section.moment @ np.cos(theta), section.moment @ np.sin(theta)) / np.float64(section.stiffness)
    hat = np.array([[0.0, 0.0, uy], [0.0, 0.0, -ux], [-uy, ux, 0.0]])
    variation = y[2 * n + 12 :].reshape(2 * n, n)
    change = np.concatenate([variation[n:], (stiffness @ variation[:n]) / kt[:, None]])
    return np.concatenate([w, force.sum(1) / kt, (frame @ hat).ravel(), frame[:, 2], change.ravel()])
