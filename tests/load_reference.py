"""Tubes under load by shooting: the equations of Rucker, Jones and Webster (IEEE T-RO 26 (2010)) integrated by DOP853.

A second writing of the physics, with general tubes: precurvature u*(x) of the curved part in the tube's own frame, and
bending and torsional stiffness EI(s), GJ(s), all functions of the arc length from where the curve begins (x) or the
tube is held (s).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import root

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RefTube:
    """One tube: straight and curved length, m; u*(x) (3,), EI(s), GJ(s), N m^2; mass per length, kg/m."""

    straight: float
    curved: float
    precurvature: Callable[[float], Any]
    bending: Callable[[float], float]
    torsional: Callable[[float], float]
    mass: float = 0.0

    @property
    def length(self) -> float:
        return self.straight + self.curved


def of_robot(robot: Any, masses: Sequence[float] | None = None) -> list[RefTube]:
    """The tubes of a robot whose tubes have one precurvature and one stiffness."""
    out = []
    for i, t in enumerate(robot.tubes):
        u, kb, kt = (t.curvature, 0.0, 0.0), t.bending_stiffness, t.torsional_stiffness
        mass = 0.0 if masses is None else masses[i]
        out.append(
            RefTube(t.straight_length, t.curved_length, lambda x, u=u: u, lambda s, k=kb: k, lambda s, k=kt: k, mass)
        )
    return out


@dataclass(frozen=True)
class RefLoad:
    """Dead loads in world axes: tip force and moment, points (s, force), gravity, constant load per length."""

    force: Any = (0.0, 0.0, 0.0)
    moment: Any = (0.0, 0.0, 0.0)
    points: tuple[tuple[float, Any], ...] = ()
    gravity: Any = (0.0, 0.0, 0.0)
    distributed: Any = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Shot:
    """An equilibrium: residual of the shooting, tip position (m) and frame, theta, torques and moment at the plate."""

    residual: float
    tip: Array
    frame: Array
    theta_base: Array
    torque_base: Array
    moment_base: Array
    unknown: Array
    end: Array


class Shooting:
    """Robot, joint values and load; `beta` (n,) m are where tubes are held."""

    def __init__(self, tubes: Sequence[RefTube], beta: Sequence[float], rotations: Sequence[float], load: RefLoad):
        self.tubes, self.beta, self.alpha, self.load = list(tubes), np.array(beta), np.array(rotations, float), load
        self.n = len(self.tubes)
        self.transition = self.beta + [t.straight for t in tubes]
        self.end = self.beta + [t.length for t in tubes]
        self.length = float(self.end.max())
        cuts = [0.0, *self.transition, *self.end, *(s for s, _ in load.points)]
        self.cuts = sorted({round(c, 13) for c in cuts if 0 <= c <= self.length + 1e-13})

    def _rates(self, s: float, y: Array, present: Array, curved: Array) -> Array:
        n = self.n
        theta, t, R = y[:n], y[n : 2 * n], y[2 * n + 3 : 2 * n + 12].reshape(3, 3)
        m, force = y[2 * n + 12 : 2 * n + 14], y[2 * n + 14 : 2 * n + 17]
        K, pull, a, slope, f = 0.0, np.zeros(2), np.zeros((n, 2)), np.zeros(n), np.array(self.load.distributed, float)
        for i, tube in enumerate(self.tubes):
            if not present[i]:
                continue
            kb, kt = tube.bending(s - self.beta[i]), tube.torsional(s - self.beta[i])
            u = np.array(tube.precurvature(s - self.transition[i]), float) if curved[i] else np.zeros(3)
            c, d = np.cos(theta[i]), np.sin(theta[i])
            a[i] = kb * (c * u[0] - d * u[1]), kb * (d * u[0] + c * u[1])
            K, pull, slope[i] = K + kb, pull + a[i], u[2] + t[i] / kt
            f = f + tube.mass * np.array(self.load.gravity)
        ux, uy = (m + pull) / K
        torque = (ux * a[:, 1] - uy * a[:, 0]) * present
        nu, whole = R.T @ force, float(t @ present)
        hat = np.array([[0, 0, uy], [0, 0, -ux], [-uy, ux, 0]])
        bend = (-uy * whole + nu[1], ux * whole - nu[0])
        return np.concatenate([slope, torque, R[:, 2], (R @ hat).ravel(), bend, -f])

    def _weight(self) -> Array:
        total = np.array(self.load.force, float) + np.array(self.load.distributed) * self.length
        for tube, e in zip(self.tubes, self.end, strict=True):
            total = total + max(0.0, e) * tube.mass * np.array(self.load.gravity)
        for _, f in self.load.points:
            total = total + np.array(f)
        return np.asarray(total)

    def march(self, unknown: Array, tolerance: float = 1e-12) -> tuple[Array, Array]:
        """Residual (n + 2,) at the tubes' ends, and the state at the tip."""
        n = self.n
        t0, m0 = unknown[:n], unknown[n:]
        theta = self.alpha.copy()
        for i, tube in enumerate(self.tubes):
            lo, hi = self.beta[i], 0.0
            if lo < 0:
                marks = [lo, *([self.transition[i]] if lo < self.transition[i] < 0 else []), hi]
                nodes, weights = np.polynomial.legendre.leggauss(40)
                for a, b in pairwise(marks):
                    for x, w in zip((a + b) / 2 + (b - a) / 2 * nodes, (b - a) / 2 * weights, strict=True):
                        wound = tube.precurvature(x - self.transition[i])[2] if x > self.transition[i] else 0.0
                        theta[i] += w * (wound + t0[i] / tube.torsional(x - lo))
        y = np.concatenate([theta, t0, np.zeros(3), np.eye(3).ravel(), m0, self._weight()])
        miss = np.zeros(n)
        last = int(np.argmax(self.end))
        for i in range(n):
            if self.end[i] <= 0:
                miss[i] = y[n + i]
        for a, b in pairwise(self.cuts):
            for s, f in self.load.points:
                if abs(s - a) < 1e-12:
                    y[2 * n + 14 :] -= f
            middle = (a + b) / 2
            present, curved = middle < self.end, (middle > self.transition) & (middle < self.end)
            out = solve_ivp(
                self._rates, (a, b), y, method="DOP853", rtol=tolerance, atol=tolerance * 1e-2, args=(present, curved)
            )
            y = out.y[:, -1]
            for i in range(n):
                if abs(self.end[i] - b) < 1e-12 and i != last:
                    miss[i] = y[n + i]
                    y[n + i] = 0.0
        R = y[2 * n + 3 : 2 * n + 12].reshape(3, 3)
        own = R.T @ np.array(self.load.moment, float)
        miss[last] = y[n + last] - own[2]
        return np.concatenate([miss, y[2 * n + 12 : 2 * n + 14] - own[:2]]), y

    def solve(self, start: Array | None = None) -> Shot:
        """The equilibrium near `start` (n + 2,): torques and bending moment at the plate."""
        x0 = np.zeros(self.n + 2) if start is None else np.array(start, float)
        # Torques of a tube are some 1e-3 N m: solve for them in those units.
        found = root(lambda x: self.march(x * 1e-3)[0] * 1e3, x0 * 1e3, method="hybr", options={"xtol": 1e-13})
        unknown = found.x * 1e-3
        miss, y = self.march(unknown)
        n = self.n
        R = y[2 * n + 3 : 2 * n + 12].reshape(3, 3)
        return Shot(
            float(np.abs(miss).max()), y[2 * n : 2 * n + 3], R, self.alpha, unknown[:n], unknown[n:], unknown, y
        )

    def _back(self, y: Array) -> tuple[list[Array], list[float]]:
        """States from the tip to the plate, 40 per section, and their arc lengths."""
        n, out, places = self.n, [], []
        for a, b in reversed(list(pairwise(self.cuts))):
            middle = (a + b) / 2
            present, curved = middle < self.end, (middle > self.transition) & (middle < self.end)
            s = np.linspace(b, a, 41)
            flow = solve_ivp(self._rates, (b, a), y, "DOP853", s, rtol=1e-11, atol=1e-13, args=(present, curved))
            out += list(flow.y.T)
            places += s.tolist()
            y = flow.y[:, -1].copy()
            for place, f in self.load.points:
                if abs(place - a) < 1e-12:
                    y[2 * n + 14 :] += f
        return out, places

    def determinants(self, shot: Shot) -> Array:
        """Of the Jacobi fields that leave the free tip, (S,) from the tip to the plate and with the transmissions: the
        equilibrium is stable if and only if all are positive (no conjugate point)."""
        n, step = self.n, 1e-6
        fields = []
        for k in range(n + 3):
            sides = []
            for sign in (1, -1):
                y = shot.end.copy()
                if k < n:
                    y[k] += sign * step
                else:
                    psi = np.zeros(3)
                    psi[k - n] = sign * step
                    turn = np.eye(3) + np.array([[0, -psi[2], psi[1]], [psi[2], 0, -psi[0]], [-psi[1], psi[0], 0]])
                    y[2 * n + 3 : 2 * n + 12] = (turn @ shot.frame).ravel()
                states, _ = self._back(y)
                sides.append(np.array(states))
            base = (sides[0] + sides[1]) / 2
            change = (sides[0] - sides[1]) / (2 * step)
            R = base[:, 2 * n + 3 : 2 * n + 12].reshape(-1, 3, 3)
            W = change[:, 2 * n + 3 : 2 * n + 12].reshape(-1, 3, 3) @ R.swapaxes(1, 2)
            turned = np.stack([W[:, 2, 1] - W[:, 1, 2], W[:, 0, 2] - W[:, 2, 0], W[:, 1, 0] - W[:, 0, 1]], 1) / 2
            fields.append(np.concatenate([change[:, :n], turned, change[:, n : 2 * n]], axis=1))
        table = np.array(fields).transpose(1, 2, 0)
        last = table[-1, : n + 3].copy()
        for i, tube in enumerate(self.tubes):
            if self.beta[i] < 0:
                last[i] -= -self.beta[i] / tube.torsional(0.0) * table[-1, n + 3 + i]
        return np.append(np.linalg.det(table[:, : n + 3]), np.linalg.det(last))
