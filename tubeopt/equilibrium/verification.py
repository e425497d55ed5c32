"""A check of an equilibrium that shares nothing with the solver but the tubes: adaptive integration of the equations.

From the solved values at the plate, torsion and shape are integrated to the tip by DOP853 (SciPy) with tolerance 1e-12,
section by section, with the physics written out once more in NumPy; tubes made of pieces are read piece by piece.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy

from ..robots.assembly import Assembly
from ..robots.series import Quantity, Series
from ..robots.tubes import stretches
from ..typing import Array
from .result import Equilibrium, Verification, refuse_load

TOLERANCE = 1e-12

ROUND_OFF = 4e-16
"""Relative change of a curvature that is none."""


def verify_equilibrium(equilibrium: Equilibrium) -> Equilibrium:
    """The same equilibrium with its `verification` filled in; raises InputError for one under load."""
    refuse_load(equilibrium)
    assembly = equilibrium.robot.assembly(equilibrium.translations)
    n = assembly.n_tubes
    state = _base(equilibrium, assembly)
    base = state[:n] - _transmitted(equilibrium, assembly, state[n : 2 * n]) - equilibrium.rotations
    worst, loose = 0.0, 0.0
    for k in range(assembly.n_sections):
        stop = assembly.start[k] + assembly.length[k]
        state = _integrated(equilibrium, assembly, k, stop, state)
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
        state = _integrated(equilibrium, assembly, k, stop, state)
        theta = state[: assembly.n_tubes]
        if assembly.general:
            u = _Pieces(equilibrium, assembly, k).curvature(stop, theta)
        else:
            u = _curvature(assembly, k, theta)
    return state[-3:], u


class _Pieces:
    """A section of tubes made of pieces: what each tube is there, read from its pieces alone."""

    def __init__(self, equilibrium: Equilibrium, assembly: Assembly, section: int) -> None:
        middle = assembly.start[section] + assembly.length[section] / 2
        self.parts: list[tuple[float, tuple[Quantity, ...]] | None] = []
        for i, tube in enumerate(equilibrium.robot.tubes):
            begin, found = -float(assembly.transmission[i]), None
            for length, (x, y, z), kb, kt in stretches(tube):
                if begin <= middle < begin + length:
                    found = begin, (kb, kt, x, y, z)
                begin += length
            self.parts.append(found)

    def _each(self, s: float) -> Array:
        """(5, n) kb, kt, u*; kt 1 and 0 else where a tube has ended."""
        columns = [
            [0.0, 1.0, 0.0, 0.0, 0.0] if part is None else [_value(q, s - part[0]) for q in part[1]]
            for part in self.parts
        ]
        return np.array(columns).T

    def torque(self, s: float, torsion: Array) -> Array:
        """kt (theta' - u*_z) (n,)."""
        _, kt, _, _, z = self._each(s)
        return np.asarray(kt * (torsion - z))

    def curvature(self, s: float, theta: Array) -> Array:
        """u (2,)."""
        kb, _, x, y, _ = self._each(s)
        return _plane((kb * (x + 1j * y) * np.exp(1j * theta)).sum() / kb.sum())

    def rates(self, s: float, state: Array) -> Array:
        """(theta, t, R, p)' at an arc length."""
        n = len(self.parts)
        theta, torque, frame = state[:n], state[n : 2 * n], state[2 * n : 2 * n + 9].reshape(3, 3)
        kb, kt, x, y, z = self._each(s)
        pull = kb * (x + 1j * y) * np.exp(1j * theta)
        u = pull.sum() / kb.sum()
        there = np.array([part is not None for part in self.parts])
        hat = np.array([[0, 0, u.imag], [0, 0, -u.real], [-u.imag, u.real, 0]])
        return np.concatenate([(z + torque / kt) * there, (np.conj(u) * pull).imag, (frame @ hat).ravel(), frame[:, 2]])


def _plane(u: complex) -> Array:
    return np.array([u.real, u.imag])


def _transmitted(equilibrium: Equilibrium, assembly: Assembly, twist: Array) -> Array:
    """(n,) turn of the tubes between where they are held and the plate, rad."""
    if not assembly.general:
        return np.asarray(assembly.transmission * twist)
    out = np.zeros(assembly.n_tubes)
    for i, tube in enumerate(equilibrium.robot.tubes):
        begin, held = 0.0, float(assembly.transmission[i])
        for length, (_, _, z), _, kt in stretches(tube):
            stop = min(begin + length, held)
            if stop > begin:
                out[i] += scipy.integrate.quad(
                    lambda x, z=z, kt=kt, t=twist[i]: _value(z, x) + t / _value(kt, x),
                    0,
                    stop - begin,
                    epsrel=TOLERANCE,
                )[0]
            begin += length
    return out


def _value(quantity: Quantity, x: float) -> float:
    """A quantity at an arc length of its piece."""
    return quantity.value(x) if isinstance(quantity, Series) else quantity


def _base(equilibrium: Equilibrium, assembly: Assembly) -> Array:
    """(theta, w, R, p) at the plate; with tubes made of pieces w is the torque."""
    theta, torsion = equilibrium.rotation[:, 0], equilibrium.torsion[:, 0]
    if assembly.general:
        here = _Pieces(equilibrium, assembly, 0) if assembly.n_sections else None
        torque = torsion if here is None else here.torque(0.0, torsion)
        return np.concatenate([theta, torque, np.eye(3).ravel(), np.zeros(3)])
    return np.concatenate([theta, torsion / _stretch(assembly, 0, theta), np.eye(3).ravel(), np.zeros(3)])


def _integrated(equilibrium: Equilibrium, assembly: Assembly, section: int, stop: float, state: Array) -> Array:
    """The state at an arc length on a section, from that at its beginning."""
    run = scipy.integrate.solve_ivp(
        _Pieces(equilibrium, assembly, section).rates if assembly.general else _right_hand_side(assembly, section),
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
            u, before = total / (stiffness / _stretch_of(assembly, u)).sum(), u
            if np.abs(u - before).max() <= ROUND_OFF * np.abs(u).max():
                break
    return np.asarray(u)


def _stretch_of(assembly: Assembly, u: Array) -> Array:
    angle = assembly.offset_angle
    return np.asarray(1 + assembly.offset * (u[0] * np.sin(angle) - u[1] * np.cos(angle)))


def _stretch(assembly: Assembly, section: int, theta: Array) -> Array:
    if not assembly.n_sections:
        return np.ones(assembly.n_tubes)
    return _stretch_of(assembly, _curvature(assembly, section, theta))


def _right_hand_side(assembly: Assembly, section: int) -> Callable[[float, Array], Array]:
    """The rates (theta, w, R, p)' on a section, of the state at an arc length."""
    n, eccentric = assembly.n_tubes, assembly.eccentric
    pull = assembly.bending_stiffness * assembly.curvature * assembly.curved[section]
    stiffness = float(assembly.bending_stiffness @ assembly.present[section])
    give = pull / assembly.torsional_stiffness

    def rates(_: float, state: Array) -> Array:
        theta, w, frame = state[:n], state[n : 2 * n], state[2 * n : 2 * n + 9].reshape(3, 3)
        turn = np.exp(1j * theta)
        u = complex(*_curvature(assembly, section, theta)) if eccentric else complex(pull @ turn) / stiffness
        out = np.empty_like(state)
        out[:n] = _stretch_of(assembly, _plane(u)) * w if eccentric else w
        out[n : 2 * n] = give * (u.conjugate() * turn).imag
        x, y, z = frame.T
        out[2 * n : 2 * n + 9].reshape(3, 3).T[:] = -u.imag * z, u.real * z, u.imag * x - u.real * y
        out[2 * n + 9 :] = z
        return out

    return rates
