"""Bound on the rotation of the tubes without a snap under a known dead load, proved from one equilibrium.

Unknowns are z and q of `block.transcription.loaded`: theta = alpha + L z, u = u0(theta) + q / sqrt(B K), with
u0 = sum a_i / K. At an equilibrium with the moment m of the load (dW/du = B m), joint turns d change the rotations by
eta = d + L dz, the angles of pairs by x, and the curvature by v. Let H be the Hessian of the loaded energy. Then

    H (dz, dq) = -N d + A' w h(x) - L' B R + sqrt(B / K) S,       N d: derivative of the gradient by alpha,
    R_i = (a_i'.m (1 - cos eta_i) - a_i.m (eta_i - sin eta_i)) / K + r_i,

with h of `snap_distance`, and remainders r_i and S of the work W = int n.t ds. The k-th derivative of the tangent t(s)
by the curvature is a sum over orders of rotations: t is an ordered product of them. So

    |D^k t(s) [v_1, ..., v_k]| <= Phi_1 ... Phi_k,       Phi = int_0^s |v| ds.

With V = int_0^s |v|, and V2 the same of v less its linear part, the moment changes by at most M = int_s^L |n| V, and by
S of at most int_s^L |n| (V2 + V^2 / 2) beside the linear part. So

    |r_i| <= |a_i| / K (|S| + 2 sin(|eta_i| / 2) M).

If the map takes a box [x, eta, dq] into itself for all d of a convex set, each d has an equilibrium in the box
(Brouwer). If the energy is strictly convex there, it is the only one in the box, stable, and depends continuously on d.
The second variation in the box is at least

    H + A' w (min cos(psi + x) - cos psi) A - L' B |a| / K (2 sin(|eta| / 2) |m| + M) L
      - int |n| (V Phi_0^2 + 2 Phi_0 Phi_1 + Phi_1^2),

where Phi_0 is of the change of curvature by (y, dq) as at the equilibrium, and Phi_1 of its change by eta,
|v_1| <= sum |a_i| / K 2 sin(|eta_i| / 2) |y_i|. A form with a matrix k of no negative entry is bounded by a diagonal
one: xi' k xi <= sum xi_j^2 (k g)_j / g_j for any g > 0 (Schur).

Integrals up to a point take in all of its element. The equations are the collocated ones, without the discretisation
error of the orientation.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from ..equilibrium.kinematics import point_of, to_equilibrium
from ..equilibrium.linearised import linearise
from ..equilibrium.result import Equilibrium
from ..typing import Array, Index
from .boxes import ROUND_OFF, Form, range_of_bend, range_of_cosine, widened


@dataclass(frozen=True, eq=False)
class LoadedForm(Form):
    """Equations of an equilibrium under dead forces: N points, T curved tubes at points, P pairs of them, n tubes.

    Boxes have R = P + T + 2 N rows: angles of the pairs, rotations of the tubes, unknowns of bending.
    """

    hessian: Array
    """Hessian (U + 2 N, U + 2 N) of the loaded energy."""
    rows: Array
    """(R, U + 2 N) changes of the rows by the unknowns."""
    G: Array
    """Compliance rows H^-1 rows' (R, R)."""
    J: Array
    """(R, n) changes of the rows by the rotations of the tubes."""
    defect: Array
    """(R,) changes that the residual of the equations stands for; about 1e-14."""
    psi: Array
    """Angles (P,) between the natural bends of pairs, rad."""
    w: Array
    """Couplings (P,) with quadrature weights, J."""
    point: Index
    """Points (T,) of the curved tubes."""
    bend: Array
    """(T,) natural curvatures |a| / K, 1/m."""
    along: Array
    """(T,) moment along a, N m."""
    across: Array
    """(T,) moment along a', N m."""
    weight: Array
    """Quadrature weights B (N,), m."""
    softness: Array
    """(N,) 1 / sqrt(B K)."""
    moment: Array
    """Sizes (N,) of the moments m, N m."""
    thrust: Array
    """(N,) B |n|, N m."""
    sweep: Array
    """(N, N) weights of the points up to the end of the element of each point, m."""
    guess: Array
    """(T + N,) positive estimate of the softest variation, for the bound by Schur."""

    @staticmethod
    def of(equilibrium: Equilibrium) -> LoadedForm:
        """Form of an equilibrium under dead forces."""
        # Solved again: an equilibrium that was saved, or found on another mesh, is right to 1e-9 only.
        solved = point_of(equilibrium)
        problem, state = solved.member.problem, solved.state
        by_turns = linearise(to_equilibrium(solved, "guess"), ("rotations",)).response
        torsion, D = problem.torsion, problem.softness
        point, tube = np.nonzero(torsion.moment)
        B, K, split = torsion.weight, torsion.stiffness.sum(1), torsion.size
        bend = np.abs(torsion.moment[point, tube]) / K[point]
        # A tube curved backwards pulls in the opposite direction.
        phi = (state.theta + torsion.phase + np.where(torsion.moment < 0, np.pi, 0.0))[point, tube]
        m = state.x[split:].reshape(-1, 2) * np.sqrt(K / B)[:, None]  # from the equations of q
        towards, beside = np.stack([np.cos(phi), np.sin(phi)]), np.stack([-np.sin(phi), np.cos(phi)])
        along, across = (np.einsum("ct,tc->t", way, m[point]) for way in (towards, beside))
        i, j = np.nonzero((point[:, None] == point) & (tube[:, None] < tube))
        psi, w = phi[i] - phi[j], (B * K)[point[i]] * bend[i] * bend[j]
        turning = np.hstack([problem.spread[point, tube], np.zeros((len(point), 2 * len(B)))])
        bending = np.eye(split + 2 * len(B))[split:]
        rows = np.vstack([turning[i] - turning[j], turning, bending])

        phi = by_turns.phi.reshape(*torsion.moment.shape, -1)
        bent = by_turns.bending_moment.reshape(len(B), 2, -1) * np.sqrt(B / K)[:, None, None]
        J = np.vstack([phi[point[i], tube[i]] - phi[point[j], tube[j]], phi[point, tube], bent.reshape(2 * len(B), -1)])

        response = np.linalg.solve(state.hessian, np.column_stack([rows.T, state.gradient]))
        G = rows @ response[:, :-1]

        element = np.arange(len(B)) // problem.mesh.tableau.degree
        y = np.linalg.norm(turning, axis=1) + 1e-9 * np.linalg.norm(turning)
        curved = np.bincount(point, bend * y, len(B)).max()
        return LoadedForm(
            hessian=state.hessian,
            rows=rows,
            G=G,
            J=J,
            defect=np.abs(rows @ response[:, -1]),
            psi=psi,
            w=w,
            point=point,
            bend=bend,
            along=along,
            across=across,
            weight=B,
            softness=D,
            moment=np.linalg.norm(m, axis=1),
            thrust=B * state.factor * np.linalg.norm(problem.force, axis=1),
            sweep=np.where(element <= element[:, None], B, 0.0),
            guess=np.concatenate([y, curved / D]),
        )

    @property
    def largest_force(self) -> float:
        """Largest force on a cross-section, N."""
        return float((self.thrust / self.weight).max(initial=0.0))

    def boxes(self, r: float) -> Array:
        """(2^n, 2 R) ranges of the changes J d of the rows over the parts of the cube |d_k| <= r, rad."""
        parts = (r * self.J * signs for signs in itertools.product((-1.0, 1.0), repeat=self.J.shape[1]))
        return np.array([np.concatenate([-np.minimum(p, 0).sum(1), np.maximum(p, 0).sum(1)]) for p in parts])

    def image(self, y: Array, u: Array) -> Array:
        """Box (..., 2 R) that contains the image of the box [x, eta, dq]."""
        pairs, tubes, bounds = *self._split(u), self._bounds(u)
        B, point = self.weight[self.point], self.point
        couplings = np.tile(self.w, 2) * range_of_bend(np.sin(self.psi), np.cos(self.psi), pairs)
        low, high = np.split(range_of_bend(self.across, -self.along, tubes), 2, axis=-1)
        unknown = bounds.rest[..., point] + bounds.turned * bounds.change[..., point]
        torques = [B * self.bend * (part + unknown) for part in (high, low)]  # -R
        shears = np.repeat(self.weight * self.softness * bounds.rest, 2, axis=-1)
        sides = np.split(couplings, 2, axis=-1)
        forces = [part for side, torque in zip(sides, torques, strict=True) for part in (side, torque, shears)]
        return np.asarray(y + widened(self.G, np.concatenate(forces, axis=-1)))

    def least_eigenvalue(self, u: Array) -> Array:
        """(S,) 1 where the second variation is proved to be positive in a box (S, 2 R), else -1."""
        (pairs, _), bounds, tubes = self._split(u), self._bounds(u), len(self.bend)
        low, high = np.split(pairs, 2, axis=-1)
        weaker = self.w * (range_of_cosine(self.psi - low, self.psi + high)[0] - np.cos(self.psi))
        softer = bounds.turned * self.moment[self.point] + bounds.change[..., self.point]
        softer = self.weight[self.point] * self.bend * softer
        out = np.empty(len(u))
        for k in range(len(u)):
            before = self._curving(self.bend, self.softness)
            after = self._curving(self.bend * bounds.turned[k], 0 * self.softness)
            # Phi_0 and Phi_1 of the estimate, and V, at the points; then the gradient of their form.
            phi = self.sweep @ before @ self.guess, self.sweep @ after @ self.guess
            thrust, V = self.thrust, bounds.swept[k]
            loss = before.T @ (self.sweep.T @ (thrust * (V * phi[0] + phi[1])))
            loss += after.T @ (self.sweep.T @ (thrust * (phi[0] + phi[1])))
            loss /= self.guess
            changes = [weaker[k], -softer[k] - loss[:tubes], -np.repeat(loss[tubes:], 2)]
            varied = self.hessian + (self.rows.T * np.concatenate(changes)) @ self.rows
            try:
                np.linalg.cholesky(varied - ROUND_OFF * np.eye(len(varied)))
                out[k] = 1.0
            except np.linalg.LinAlgError:
                out[k] = -1.0
        return out

    def _curving(self, by_tubes: Array, by_bending: Array) -> Array:
        """(N, T + N) sizes of the curvature by the sizes of variations."""
        out = np.zeros((len(self.weight), len(by_tubes) + len(by_bending)))
        out[self.point, np.arange(len(by_tubes))] = by_tubes
        out[:, len(by_tubes) :] = np.diag(by_bending)
        return out

    def _split(self, u: Array) -> tuple[Array, Array]:
        """Boxes of the pairs (..., 2 P), and of the tubes (..., 2 T)."""
        low, high = np.split(u, 2, axis=-1)
        ends = len(self.psi), len(self.psi) + len(self.bend)
        parts = (slice(0, ends[0]), slice(ends[0], ends[1]))
        pairs, tubes = (np.concatenate([low[..., part], high[..., part]], axis=-1) for part in parts)
        return pairs, tubes

    def _bounds(self, u: Array) -> Bounds:
        """Bounds in a box."""
        _, tubes = self._split(u)
        most = np.maximum(*np.split(np.minimum(tubes, np.pi), 2, axis=-1))
        turned = 2 * np.sin(most / 2)
        dq = np.maximum(*np.split(u, 2, axis=-1))[..., len(self.psi) + len(self.bend) :]
        size = np.linalg.norm(dq.reshape(*dq.shape[:-1], -1, 2), axis=-1)
        at = np.zeros((len(self.bend), len(self.weight)))
        at[np.arange(len(self.bend)), self.point] = self.bend
        V = (turned @ at + size * self.softness) @ self.sweep.T
        V2 = (np.hypot(1 - np.cos(most), most - np.sin(most)) @ at) @ self.sweep.T
        beyond = (self.sweep > 0) * self.thrust[:, None]  # (b, a): of points b in elements not before that of a
        return Bounds(turned, V, (V @ beyond), (V2 + V**2 / 2) @ beyond)


@dataclass(frozen=True)
class Bounds:
    """Bounds of a box (..., 2 R)."""

    turned: Array
    """(..., T) 2 sin(|eta| / 2)."""
    swept: Array
    """(..., N) V at the points."""
    change: Array
    """(..., N) M: change of the moment, N m."""
    rest: Array
    """(..., N) the part of it that is not linear, N m."""
