"""A check of an equilibrium that shares nothing with the solver but the tubes: adaptive integration of the equations.

From the solved values at the plate, torque, bending moment and shape are integrated to the tip by DOP853 (SciPy) with
tolerance 1e-12, from one breakpoint to the next, with the physics written out once more in NumPy; every tube is read
piece by piece. Loads are those of Rucker, Jones and Webster, IEEE T-RO 26 (2010): with the force n and the bending
moment m on the cross-sections, the torques t_i on them and what acts per length, f and l,

    u = (m + sum of pulls) / sum kb,    n' = -f,    m' = -u x t + n x e3 - l  in the Bishop frame,

and at the tip n and m are the force and the moment there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from ..robots.assembly import Assembly, cut
from ..robots.load import FORCE, MOMENT, Load, masses
from ..robots.series import Quantity, at, vary
from ..robots.tubes import stretches
from ..typing import Array
from .result import Equilibrium, Verification, refuse_friction, small_turn

TOLERANCE = 1e-12

ROUND_OFF = 4e-16
"""Relative change of a curvature that is none."""

SAME_PLACE = 1e-12
"""Distance (m) of places that are one: round-off of a length."""


def verify_equilibrium(equilibrium: Equilibrium) -> Equilibrium:
    """The same equilibrium with its `verification` filled in; raises InputError for one under friction."""
    refuse_friction(equilibrium)
    load = equilibrium.load or Load()
    assembly = cut(equilibrium.robot.assembly(equilibrium.translations), load.cuts())
    n = assembly.n_tubes
    state = _base(equilibrium, assembly)
    base = state[:n] - _transmitted(equilibrium, assembly, state[n : 2 * n]) - equilibrium.rotations
    worst, loose, bent = 0.0, 0.0, 0.0
    tip = int(np.argmax(assembly.end))
    for k in range(assembly.n_sections):
        section, stop = _Section(equilibrium, assembly, k), assembly.start[k] + assembly.length[k]
        state = section.integrated(stop, _past_points(assembly, load, assembly.start[k], state))
        solved = equilibrium.rotation[:, np.argmin(np.abs(equilibrium.arc_length - stop))]
        worst = max(worst, float(np.abs(state[:n] - solved).max()))
        ends = np.abs(assembly.end - stop) < SAME_PLACE
        beyond = _past_points(assembly, load, stop, state)
        torque = beyond[n : 2 * n].copy()
        if k == assembly.n_sections - 1:
            moment = _frame(state, n).T @ _at_tip(equilibrium, load.moment)
            torque[tip] -= moment[2]
            bent = float(np.abs(beyond[-5:-3] - moment[:2]).max() / section.tubes(stop)[0].sum())
        loose = max(loose, float(np.abs(torque / section.tubes(stop)[1])[ends].max(initial=0.0)))
    turn = _frame(state, n) @ equilibrium.tip_rotation.T
    return replace(
        equilibrium,
        verification=Verification(
            tip_position=float(np.linalg.norm(state[2 * n + 9 : 2 * n + 12] - equilibrium.tip_position)),
            tip_rotation=float(np.linalg.norm(small_turn(turn))),
            rotation=worst,
            end_torsion=loose,
            end_curvature=bent,
            base_rotation=float(np.abs(base).max(initial=0.0)),
        ),
    )


def point_at(equilibrium: Equilibrium, arc_length: float) -> tuple[Array, Array]:
    """Position (3,), m, and curvature (2,) in the Bishop frame, 1/m, at an arc length, by the same integration."""
    load = equilibrium.load or Load()
    assembly = cut(equilibrium.robot.assembly(equilibrium.translations), load.cuts())
    state, u, n = _base(equilibrium, assembly), 0j, assembly.n_tubes
    for k in range(assembly.n_sections):
        stop = min(assembly.start[k] + assembly.length[k], arc_length)
        if k and stop <= assembly.start[k]:
            break
        section = _Section(equilibrium, assembly, k)
        state = section.integrated(stop, _past_points(assembly, load, assembly.start[k], state))
        u = section.bent(section.tubes(stop), state)[0]
    return state[2 * n + 9 : 2 * n + 12], np.array([u.real, u.imag])


def _frame(state: Array, n: int) -> Array:
    """(3, 3) Bishop frame of a state."""
    return state[2 * n : 2 * n + 9].reshape(3, 3)


def _at_tip(equilibrium: Equilibrium, value: tuple[float, float, float]) -> Array:
    """(3,) force or moment at the tip in axes of the plate."""
    turning = equilibrium.load is not None and equilibrium.load.frame == "tip"
    return np.asarray((equilibrium.tip_rotation if turning else np.eye(3)) @ value)


def _past_points(assembly: Assembly, load: Load, s: float, state: Array) -> Array:
    """The state beyond the forces and moments that act at an arc length."""
    n, out = assembly.n_tubes, state.copy()
    for part in load.points:
        if abs(part.at - s) < SAME_PLACE:
            moment = _frame(state, n).T @ part.moment
            outermost = int(np.flatnonzero(assembly.end >= s - SAME_PLACE)[-1])
            out[n + outermost] -= moment[2]
            out[-5:-3] -= moment[:2]
            out[-3:] -= part.force
    return out


class _Section:
    """A section of the arm: what each tube is there, read from its pieces alone."""

    def __init__(self, equilibrium: Equilibrium, assembly: Assembly, k: int) -> None:
        self.start, self.assembly = assembly.start[k], assembly
        self.load = equilibrium.load or Load()
        self.mass = masses(equilibrium.robot.tubes, self.load) @ assembly.present[k]
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

    def bent(self, tubes: tuple[Array, ...], state: Array) -> tuple[complex, Array, Array]:
        """u_x + j u_y by fixed-point iteration on u sum kb / g(u) = m + sum kb u* e^(j theta), these pulls, and g."""
        kb, _, own, _ = tubes
        pull = kb * own * np.exp(1j * state[: len(kb)])
        total, g, assembly = complex(*state[-5:-3]) + complex(pull.sum()), np.ones(len(kb)), self.assembly
        u = total / kb.sum()
        for _ in range(60 if assembly.eccentric else 0):
            g = 1 + assembly.offset * (u.real * np.sin(assembly.offset_angle) - u.imag * np.cos(assembly.offset_angle))
            u, before = total / (kb / g).sum(), u
            if abs(u - before) <= ROUND_OFF * abs(u):
                break
        return u, pull, g

    def rates(self, s: float, state: Array) -> Array:
        """(theta, t, R, p, m, n)' at an arc length."""
        n = len(self.parts)
        torque, frame, force = state[n : 2 * n], _frame(state, n), state[-3:]
        _, kt, _, z = tubes = self.tubes(s)
        u, pull, g = self.bent(tubes, state)
        hat = np.array([[0, 0, u.imag], [0, 0, -u.real], [-u.imag, u.real, 0]])
        twist = g * (z + torque / kt) * self.there
        per_length = self.load.per_length(np.array(s))
        along, couple, whole = per_length[FORCE], frame.T @ per_length[MOMENT], torque[self.there].sum()
        if self.load.gravity is not None:
            along = along + self.mass * np.array(self.load.gravity)
        gain = (np.conj(u) * pull).imag
        gain[np.flatnonzero(self.there)[-1]] -= couple[2]
        own = frame.T @ force
        bend = [-u.imag * whole + own[1] - couple[0], u.real * whole - own[0] - couple[1]]
        return np.concatenate([twist, gain, (frame @ hat).ravel(), frame[:, 2], bend, -along])

    def integrated(self, stop: float, state: Array) -> Array:
        """The state at an arc length, from that at the beginning."""
        tight = {"rtol": TOLERANCE, "atol": TOLERANCE}
        run = scipy.integrate.solve_ivp(self.rates, (self.start, stop), state, method="DOP853", **tight)
        return np.asarray(run.y[:, -1])


def _base(equilibrium: Equilibrium, assembly: Assembly) -> Array:
    """(theta, t, R, p, m, n) behind the plate: the torque is kt (theta' / g - u*_z), with moments at the plate."""
    theta, slope, wrench = equilibrium.rotation[:, 0], equilibrium.torsion[:, 0], equilibrium.base_wrench
    n, none = len(theta), np.zeros(len(theta))
    state = np.concatenate([theta, none, np.eye(3).ravel(), np.zeros(3), wrench[3:5], wrench[:3]])
    if assembly.n_sections:
        section = _Section(equilibrium, assembly, 0)
        _, kt, _, z = tubes = section.tubes(0.0)
        # As on the arm, less what the points at the plate take away.
        beyond = _past_points(assembly, section.load, 0.0, state)
        state[n : 2 * n] = kt * (slope / section.bent(tubes, beyond)[2] - z) - beyond[n : 2 * n]
    return state


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
