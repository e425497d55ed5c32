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
    """Dead loads in world axes: tip force and moment, points (s, force), gravity, constant load per length; moments
    (s, moment) at places, and a constant one per length, whose part along the arm turns the outermost tube."""

    force: Any = (0.0, 0.0, 0.0)
    moment: Any = (0.0, 0.0, 0.0)
    points: tuple[tuple[float, Any], ...] = ()
    gravity: Any = (0.0, 0.0, 0.0)
    distributed: Any = (0.0, 0.0, 0.0)
    couples: tuple[tuple[float, Any], ...] = ()
    couple_per_length: Any = (0.0, 0.0, 0.0)


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
        cuts = [0.0, *self.transition, *self.end, *(s for s, _ in (*load.points, *load.couples))]
        self.cuts = sorted({round(c, 13) for c in cuts if 0 <= c <= self.length + 1e-13})

    def _rates(self, s: float, flat: Array, present: Array, curved: Array) -> Array:
        """Of several arms at once: (B * S,) states one after the other."""
        n = self.n
        y = flat.reshape(-1, 2 * n + 17)
        theta, t, R = y[:, :n], y[:, n : 2 * n], y[:, 2 * n + 3 : 2 * n + 12].reshape(-1, 3, 3)
        m, force = y[:, 2 * n + 12 : 2 * n + 14], y[:, 2 * n + 14 :]
        K, slope, f = 0.0, np.zeros_like(theta), np.array(self.load.distributed, float)
        a = np.zeros((n, 2, len(y)))
        for i, tube in enumerate(self.tubes):
            if not present[i]:
                continue
            kb, kt = tube.bending(s - self.beta[i]), tube.torsional(s - self.beta[i])
            u = tube.precurvature(s - self.transition[i]) if curved[i] else (0.0, 0.0, 0.0)
            c, d = np.cos(theta[:, i]), np.sin(theta[:, i])
            a[i] = kb * (c * u[0] - d * u[1]), kb * (d * u[0] + c * u[1])
            K += kb
            slope[:, i] = u[2] + t[:, i] / kt
            f = f + tube.mass * np.array(self.load.gravity)
        ux, uy = (m.T + a.sum(0)) / K
        torque = (ux * a[:, 1] - uy * a[:, 0]).T * present
        nu, whole = np.einsum("bji,bj->ib", R, force), t @ present
        along = R[:, :, 2]
        turned = np.stack(
            [-uy[:, None] * along, ux[:, None] * along, uy[:, None] * R[:, :, 0] - ux[:, None] * R[:, :, 1]], 2
        )
        couple = np.einsum("bji,j->ib", R, np.array(self.load.couple_per_length, float))
        bend = np.stack([-uy * whole + nu[1] - couple[0], ux * whole - nu[0] - couple[1]], 1)
        torque[:, np.flatnonzero(present)[-1]] -= couple[2]
        parts = slope, torque, along, turned.reshape(-1, 9), bend, np.broadcast_to(-f, (len(y), 3))
        return np.concatenate(parts, axis=1).ravel()

    def _weight(self) -> Array:
        total = np.array(self.load.force, float) + np.array(self.load.distributed) * self.length
        for tube, e in zip(self.tubes, self.end, strict=True):
            total = total + max(0.0, e) * tube.mass * np.array(self.load.gravity)
        for _, f in self.load.points:
            total = total + np.array(f)
        return np.asarray(total)

    def march(self, unknown: Array, tolerance: float = 1e-12) -> tuple[Array, Array]:
        """Residuals (B, n + 2) at the tubes' ends, and the states (B, S) at the tip, of several unknowns (B, n + 2)."""
        n, count = self.n, len(unknown)
        t0, m0 = unknown[:, :n], unknown[:, n:]
        theta = np.tile(self.alpha, (count, 1))
        nodes, weights = np.polynomial.legendre.leggauss(40)
        for i, tube in enumerate(self.tubes):
            lo = self.beta[i]
            if lo < 0:
                marks = [lo, *([self.transition[i]] if lo < self.transition[i] < 0 else []), 0.0]
                for a, b in pairwise(marks):
                    for x, w in zip((a + b) / 2 + (b - a) / 2 * nodes, (b - a) / 2 * weights, strict=True):
                        wound = tube.precurvature(x - self.transition[i])[2] if x > self.transition[i] else 0.0
                        theta[:, i] += w * (wound + t0[:, i] / tube.torsional(x - lo))
        same = np.tile(np.concatenate([np.zeros(3), np.eye(3).ravel()]), (count, 1))
        y = np.concatenate([theta, t0, same, m0, np.tile(self._weight(), (count, 1))], axis=1)
        miss = np.zeros((count, n))
        last = self._twisted(self.length)
        for i in range(n):
            if self.end[i] <= 0:
                miss[:, i] = y[:, n + i]
        for a, b in pairwise(self.cuts):
            for s, f in self.load.points:
                if abs(s - a) < 1e-12:
                    y[:, 2 * n + 14 :] -= f
            self._jump(y, a)
            y = self._along((a, b), y, tolerance)[-1]
            for i in range(n):
                if abs(self.end[i] - b) < 1e-12 and i != last:
                    miss[:, i] = y[:, n + i]
                    y[:, n + i] = 0.0
        R = y[:, 2 * n + 3 : 2 * n + 12].reshape(-1, 3, 3)
        own = np.einsum("bji,j->bi", R, np.array(self.load.moment, float))
        miss[:, last] = y[:, n + last] - own[:, 2]
        return np.concatenate([miss, y[:, 2 * n + 12 : 2 * n + 14] - own[:, :2]], axis=1), y

    def _jump(self, y: Array, at: float) -> None:
        """Past an arc length, the moments there no longer act."""
        n = self.n
        for s, couple in self.load.couples:
            if abs(s - at) < 1e-12:
                R = y[:, 2 * n + 3 : 2 * n + 12].reshape(-1, 3, 3)
                own = np.einsum("bji,j->bi", R, np.array(couple, float))
                y[:, 2 * n + 12 : 2 * n + 14] -= own[:, :2]
                y[:, n + self._twisted(at)] -= own[:, 2]

    def _twisted(self, at: float) -> int:
        """The tube that a moment along the arm twists: at the tip the innermost that ends there, else the outermost."""
        reached = np.flatnonzero(self.end >= at - 1e-9)
        return int(reached[0] if at > self.length - 1e-9 else reached[-1])

    def _along(self, ends: tuple[float, float], y: Array, tolerance: float, count: int = 2) -> Array:
        """States (count, B, S) of several arms along a section, from those (B, S) where it begins or ends."""
        middle = sum(ends) / 2
        present, curved = middle < self.end, (middle > self.transition) & (middle < self.end)
        s = np.linspace(*ends, count)
        flow = solve_ivp(
            self._rates, ends, y.ravel(), "DOP853", s, rtol=tolerance, atol=tolerance * 1e-2, args=(present, curved)
        )
        return np.asarray(flow.y.T.reshape(count, *y.shape))

    def solve(self, start: Array | None = None) -> Shot:
        """The equilibrium near `start` (n + 2,), torques and bending moment at the plate, by Newton's method with
        differences."""
        n = self.n
        unknown, step = np.zeros(n + 2) if start is None else np.array(start, float), 1e-8
        for _ in range(20):
            miss = self.march(unknown + step * np.concatenate([np.zeros((1, n + 2)), np.eye(n + 2)]))[0]
            change = np.linalg.solve((miss[1:] - miss[0]).T / step, -miss[0])
            unknown = unknown + change
            if np.abs(change).max() < 1e-8:
                break
        miss, states = self.march(unknown[None])
        y = states[0]
        R = y[2 * n + 3 : 2 * n + 12].reshape(3, 3)
        return Shot(
            float(np.abs(miss).max()), y[2 * n : 2 * n + 3], R, self.alpha, unknown[:n], unknown[n:], unknown, y
        )

    def _back(self, y: Array) -> Array:
        """States (P, B, S) of several arms from the tip (B, S) to the plate, 41 per section."""
        n, out = self.n, []
        for a, b in reversed(list(pairwise(self.cuts))):
            out.append(self._along((b, a), y, 1e-11, 41))
            y = out[-1][-1].copy()
            for position, f in self.load.points:
                if abs(position - a) < 1e-12:
                    y[:, 2 * n + 14 :] += f
        return np.concatenate(out)

    def determinants(self, shot: Shot) -> Array:
        """Of the Jacobi fields that leave the free tip, (S,) from the tip to the plate and with the transmissions: the
        equilibrium is stable if and only if all are positive (no conjugate point)."""
        n, step = self.n, 1e-6
        starts = np.tile(shot.end, (2 * (n + 3), 1))
        for k in range(n + 3):
            for y, size in zip(starts[2 * k : 2 * k + 2], (step, -step), strict=True):
                if k < n:
                    y[k] += size
                else:
                    psi = size * np.eye(3)[k - n]
                    turn = np.eye(3) + np.array([[0, -psi[2], psi[1]], [psi[2], 0, -psi[0]], [-psi[1], psi[0], 0]])
                    y[2 * n + 3 : 2 * n + 12] = (turn @ shot.frame).ravel()
        states = self._back(starts)
        up, down = states[:, ::2], states[:, 1::2]
        change = (up - down) / (2 * step)
        R = (up + down)[..., 2 * n + 3 : 2 * n + 12].reshape(*change.shape[:2], 3, 3) / 2
        W = change[..., 2 * n + 3 : 2 * n + 12].reshape(R.shape) @ R.swapaxes(2, 3)
        turned = (
            np.stack([W[..., 2, 1] - W[..., 1, 2], W[..., 0, 2] - W[..., 2, 0], W[..., 1, 0] - W[..., 0, 1]], 2) / 2
        )
        fields = np.concatenate([change[..., :n], turned, change[..., n : 2 * n]], axis=2)
        table = fields.transpose(0, 2, 1)
        last = table[-1, : n + 3].copy()
        for i, tube in enumerate(self.tubes):
            if self.beta[i] < 0:
                last[i] -= -self.beta[i] / tube.torsional(0.0) * table[-1, n + 3 + i]
        return np.append(np.linalg.det(table[:, : n + 3]), np.linalg.det(last))
