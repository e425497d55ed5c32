"""A check of an equilibrium that shares nothing with the solver but the tubes: adaptive integration of the equations.

From the solved values at the plate, torque and shape are integrated to the tip by DOP853 (SciPy) with tolerance 1e-12,
section by section, with the physics written out once more in NumPy; every tube is read piece by piece.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from ..robots.assembly import Assembly
from ..robots.series import Quantity, at, vary
from ..robots.tubes import stretches
from ..typing import Array
from .result import Equilibrium, Verification, refuse_load, small_turn

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
        section, stop = _Section(equilibrium, assembly, k), assembly.start[k] + assembly.length[k]
        state = section.integrated(stop, state)
        solved = equilibrium.rotation[:, np.argmin(np.abs(equilibrium.arc_length - stop))]
        worst = max(worst, float(np.abs(state[:n] - solved).max()))
        ends = np.abs(assembly.end - stop) < 1e-12
        torsion = state[n : 2 * n] / section.tubes(stop)[1]
        loose = max(loose, float(np.abs(torsion[ends]).max(initial=0.0)))
    turn = state[2 * n : 2 * n + 9].reshape(3, 3).T @ equilibrium.tip_rotation
    return replace(
        equilibrium,
        verification=Verification(
            tip_position=float(np.linalg.norm(state[2 * n + 9 :] - equilibrium.tip_position)),
            tip_rotation=float(np.linalg.norm(small_turn(turn))),
            rotation=worst,
            end_torsion=loose,
            base_rotation=float(np.abs(base).max(initial=0.0)),
        ),
    )


def point_at(equilibrium: Equilibrium, arc_length: float) -> tuple[Array, Array]:
    """Position (3,), m, and curvature (2,) in the Bishop frame, 1/m, at an arc length, by the same integration."""
    assembly = equilibrium.robot.assembly(equilibrium.translations)
    state, u = _base(equilibrium, assembly), 0j
    for k in range(assembly.n_sections):
        stop = min(assembly.start[k] + assembly.length[k], arc_length)
        if k and stop <= assembly.start[k]:
            break
        section = _Section(equilibrium, assembly, k)
        state = section.integrated(stop, state)
        u = section.bent(section.tubes(stop), state[: assembly.n_tubes])[0]
    return state[-3:], np.array([u.real, u.imag])


class _Section:
    """A section of the arm: what each tube is there, read from its pieces alone."""

    def __init__(self, equilibrium: Equilibrium, assembly: Assembly, k: int) -> None:
        self.start, self.assembly = assembly.start[k], assembly
        middle = self.start + assembly.length[k] / 2
        self.parts: list[tuple[float, tuple[Quantity, ...]] | None] = []
        for i, tube in enumerate(equilibrium.robot.tubes):
            begin, found = -float(assembly.transmission[i]), None
            for length, (x, y, z), kb, kt in stretches(tube):
                if begin <= middle < begin + length:
                    found = begin, (kb, kt, x, y, z)
                begin += length
            self.parts.append(found)
        self.there = np.array([part is not None for part in self.parts])
        self.everywhere = None
        if not any(vary(part[1]) for part in self.parts if part is not None):
            self.everywhere = self.tubes(middle)

    def tubes(self, s: float) -> tuple[Array, ...]:
        """kb, kt, u*_x + j u*_y, u*_z (n,); kt 1 and 0 else where a tube has ended."""
        if self.everywhere is not None:
            return self.everywhere
        columns = [
            [0.0, 1.0, 0.0, 0.0, 0.0] if part is None else [at(q, s - part[0]) for q in part[1]] for part in self.parts
        ]
        kb, kt, x, y, z = np.array(columns).T
        return kb, kt, x + 1j * y, z

    def bent(self, tubes: tuple[Array, ...], theta: Array) -> tuple[complex, Array, Array]:
        """u_x + j u_y by fixed-point iteration on u sum kb / g(u) = sum kb u* e^(j theta), these pulls, and g (n,)."""
        kb, _, own, _ = tubes
        pull = kb * own * np.exp(1j * theta)
        total, g, assembly = complex(pull.sum()), np.ones(len(theta)), self.assembly
        u = total / kb.sum()
        for _ in range(60 if assembly.eccentric else 0):
            g = 1 + assembly.offset * (u.real * np.sin(assembly.offset_angle) - u.imag * np.cos(assembly.offset_angle))
            u, before = total / (kb / g).sum(), u
            if abs(u - before) <= ROUND_OFF * abs(u):
                break
        return u, pull, g

    def rates(self, s: float, state: Array) -> Array:
        """(theta, t, R, p)' at an arc length."""
        n = len(self.parts)
        theta, torque, frame = state[:n], state[n : 2 * n], state[2 * n : 2 * n + 9].reshape(3, 3)
        _, kt, _, z = tubes = self.tubes(s)
        u, pull, g = self.bent(tubes, theta)
        hat = np.array([[0, 0, u.imag], [0, 0, -u.real], [-u.imag, u.real, 0]])
        twist = g * (z + torque / kt) * self.there
        return np.concatenate([twist, (np.conj(u) * pull).imag, (frame @ hat).ravel(), frame[:, 2]])

    def integrated(self, stop: float, state: Array) -> Array:
        """The state at an arc length, from that at the beginning."""
        tight = {"rtol": TOLERANCE, "atol": TOLERANCE}
        run = scipy.integrate.solve_ivp(self.rates, (self.start, stop), state, method="DOP853", **tight)
        return np.asarray(run.y[:, -1])


def _base(equilibrium: Equilibrium, assembly: Assembly) -> Array:
    """(theta, t, R, p) at the plate: the torque is kt (theta' / g - u*_z)."""
    theta, torque = equilibrium.rotation[:, 0], equilibrium.torsion[:, 0]
    if assembly.n_sections:
        section = _Section(equilibrium, assembly, 0)
        _, kt, _, z = tubes = section.tubes(0.0)
        torque = kt * (torque / section.bent(tubes, theta)[2] - z)
    return np.concatenate([theta, torque, np.eye(3).ravel(), np.zeros(3)])


def _transmitted(equilibrium: Equilibrium, assembly: Assembly, torque: Array) -> Array:
    """(n,) turn of the tubes between where they are held and the plate, rad."""
    out = np.zeros(assembly.n_tubes)
    for i, tube in enumerate(equilibrium.robot.tubes):
        begin, held = 0.0, float(assembly.transmission[i])
        for length, (_, _, z), _, kt in stretches(tube):
            stop = min(begin + length, held)
            if stop > begin:
                out[i] += scipy.integrate.quad(
                    lambda x, z=z, kt=kt, t=torque[i]: at(z, x) + t / at(kt, x), 0, stop - begin, epsrel=TOLERANCE
                )[0]
            begin += length
    return out
