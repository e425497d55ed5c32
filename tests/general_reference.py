"""Tubes of any precurvature and stiffness written once more, and solved by shooting: nothing of the library is used.

A tube is a list of pieces (length, u*, EI, GJ), each a function of the piece's own arc length; see the theory
page, "Tubes made of pieces". From the rotations and torques at the plate the equations are integrated to the tip by
DOP853 (SciPy) at 1e-12, and Newton's method, with differences, finds the torques that vanish at the tubes' ends.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import quad, solve_ivp

Array = NDArray[np.float64]
Function = Callable[[float], float]
Stretch = tuple[float, Callable[[float], Sequence[float]], Function, Function]
Bundle = Sequence[Sequence[Stretch]]
"""Tubes, inner to outer, of stretches from the held end: length, u* (3,), EI and GJ as functions of its arc length."""


@dataclass(frozen=True)
class Shot:
    """A solved bundle: tip and its frame, theta and torque at the plate, whether it is stable by the determinants."""

    tip: Array
    frame: Array
    theta: Array
    torque: Array
    stable: bool


def straight(length: float, bending: float, torsional: float) -> Stretch:
    """A straight stretch."""
    return length, lambda s: (0.0, 0.0, 0.0), lambda s: bending, lambda s: torsional


def _stretch(tube: Sequence[Stretch], place: float) -> tuple[Stretch, float]:
    """The stretch at an arc length from the held end, and where it begins."""
    start = 0.0
    for stretch in tube[:-1]:
        if place < start + stretch[0]:
            return stretch, start
        start += stretch[0]
    return tube[-1], start


def _cuts(bundle: Bundle, beta: Array) -> list[float]:
    points = {0.0}
    for tube, held in zip(bundle, beta, strict=True):
        s = held
        for stretch in tube:
            s += stretch[0]
            points.add(max(0.0, s))
    out = [0.0]
    for s in sorted(points):
        if s - out[-1] > 1e-11:
            out.append(s)
    return out


def behind_plate(tube: Sequence[Stretch], held: float) -> tuple[float, float]:
    """int ds / GJ and int u*_z from the held end to the plate."""
    compliance = wound = 0.0
    start = held
    for length, u, _, torsional in tube:
        stop = min(start + length, 0.0)
        if stop > start:
            compliance += quad(lambda s, kt=torsional: 1 / kt(s), 0, stop - start, epsabs=0, epsrel=1e-13, limit=200)[0]
            wound += quad(lambda s, u=u: u(s)[2], 0, stop - start, epsabs=1e-14, epsrel=1e-13, limit=200)[0]
        start += length
    return compliance, wound


class _Section:
    """The tubes between two breakpoints."""

    def __init__(self, bundle: Bundle, beta: Array, low: float, high: float) -> None:
        middle = (low + high) / 2
        self.parts = []
        for tube, held in zip(bundle, beta, strict=True):
            stretch, start = _stretch(tube, middle - held)
            reached = middle - held < sum(part[0] for part in tube)
            self.parts.append((stretch, held + start, reached))

    def pulls(self, s: float, theta: Array) -> tuple[Array, Array, Array, Array]:
        """a_i = EI e^{j theta} (u*_x + j u*_y), EI, GJ, u*_z of each tube."""
        n = len(self.parts)
        a, kb, kt, z = np.zeros(n, dtype=complex), np.zeros(n), np.ones(n), np.zeros(n)
        for i, ((_, u, bending, torsional), start, reached) in enumerate(self.parts):
            if reached:
                x = s - start
                ux, uy, z[i] = u(x)
                kb[i], kt[i] = bending(x), torsional(x)
                a[i] = kb[i] * complex(ux, uy) * complex(math.cos(theta[i]), math.sin(theta[i]))
        return a, kb, kt, z

    def rates(self, s: float, state: Array) -> Array:
        """(theta, t, R, p)'."""
        n = len(self.parts)
        theta, torque, frame = state[:n], state[n : 2 * n], state[2 * n : 2 * n + 9].reshape(3, 3)
        a, kb, kt, z = self.pulls(s, theta)
        u = a.sum() / kb.sum()
        hat = np.array([[0, 0, u.imag], [0, 0, -u.real], [-u.imag, u.real, 0]])
        slope = np.array([z[i] + torque[i] / kt[i] if self.parts[i][2] else 0.0 for i in range(n)])
        return np.concatenate([slope, (np.conj(u) * a).imag, (frame @ hat).ravel(), frame[:, 2]])

    def jacobi(self, s: float, theta: Array, fields: Array) -> Array:
        """Rates of the Jacobi fields (y above v, 2n x n) at rotations theta."""
        a, kb, kt, _ = self.pulls(s, theta)
        n = len(kb)
        stiff = -np.real(np.outer(a, np.conj(a))) / kb.sum() + np.diag(np.real(np.conj(a.sum() / kb.sum()) * a))
        y, v = fields[:n], fields[n:]
        reached = np.array([part[2] for part in self.parts])
        return np.concatenate([v / kt[:, None] * reached[:, None], stiff @ y])


Solved = list[tuple[_Section, float, float, Callable[[float], Array]]]


def _march(bundle: Bundle, beta: Array, start: Array, tolerance: float = 1e-12) -> tuple[Array, Solved]:
    """State at the tip, and every section with its dense solution."""
    state, out = start, []
    for low, high in pairwise(_cuts(bundle, beta)):
        section = _Section(bundle, beta, low, high)
        run = solve_ivp(
            section.rates, (low, high), state, method="DOP853", rtol=tolerance, atol=tolerance / 10, dense_output=True
        )
        state = run.y[:, -1]
        out.append((section, low, high, run.sol))
    return state, out


def shoot(bundle: Bundle, rotations: Sequence[float], beta: Sequence[float], torque: Sequence[float]) -> Shot:
    """The equilibrium with held ends at beta (m) turned by rotations (rad) that is nearest to torques at the plate."""
    alpha, held, t = (np.array(v, dtype=float) for v in (rotations, beta, torque))
    n = len(alpha)
    behind = [behind_plate(tube, b) for tube, b in zip(bundle, held, strict=True)]
    compliance, wound = np.array([c for c, _ in behind]), np.array([w for _, w in behind])

    def start(t: Array) -> Array:
        return np.concatenate([alpha + wound + compliance * t, t, np.eye(3).ravel(), np.zeros(3)])

    def left(t: Array, tolerance: float) -> Array:
        return _march(bundle, held, start(t), tolerance)[0][n : 2 * n]

    size = 1e-3 * max(1e-3, float(np.abs(t).max()))
    rough = left(t, 1e-8)
    slope = np.column_stack([(left(t + size * row, 1e-8) - rough) / size for row in np.eye(n)])
    for _ in range(8):
        state, sections = _march(bundle, held, start(t))
        step = np.linalg.solve(slope, -state[n : 2 * n])
        if np.abs(step).max() <= 1e-11 * np.abs(t).max() + 1e-14:
            break
        t = t + step
    return Shot(
        tip=state[-3:],
        frame=state[2 * n : 2 * n + 9].reshape(3, 3),
        theta=start(t)[:n],
        torque=t,
        stable=_stable(sections, compliance),
    )


def _stable(sections: Solved, compliance: Array) -> bool:
    """Whether det Y > 0 from the tip to the plate, and det(Y - C V) > 0 there."""
    n = len(compliance)
    fields = np.concatenate([np.eye(n), np.zeros((n, n))])
    for section, low, high, solution in reversed(sections):
        run = solve_ivp(
            lambda s, f, section=section, solution=solution: section.jacobi(
                s, solution(s)[:n], f.reshape(2 * n, n)
            ).ravel(),
            (high, low),
            fields.ravel(),
            rtol=1e-9,
            atol=1e-12,
            max_step=(high - low) / 8,
        )
        if any(np.linalg.det(y.reshape(2 * n, n)[:n]) <= 0 for y in run.y.T):
            return False
        fields = run.y[:, -1].reshape(2 * n, n)
    return bool(np.linalg.det(fields[:n] - np.diag(compliance) @ fields[n:]) > 0)
