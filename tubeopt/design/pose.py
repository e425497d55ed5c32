"""One equilibrium with its derivatives with respect to the tubes and the joint values.

What is differentiated is the discrete solution itself (collocation, Magnus steps, smallest eigenvalue), so that the
derivatives are those of `forward_kinematics` on the same mesh, to round-off. The unknown theta obeys

    theta_i = alpha_i - C_i B M_i,    C_i = (|beta_i| + G) / kt_i,

with G the collocated min(s, r) and B the quadrature weights. Both depend on the lengths of the sections, so theta is
differentiated at fixed places *within* its piece, where it is smooth. The margin is a Rayleigh quotient: with y at its
minimum, y' C^-1 y = 1 and q = C^-1 y,  d mu = d(y' B V'' y) - (1 - mu) q' dC q.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.linalg import eigh
from numpy.typing import NDArray

from ..mechanics.shape import GAUSS_POINTS
from ..robots.assembly import Array, Assembly
from ..stability.certificate import pair_couplings
from ..transcription import arm as arms
from ..transcription.piece import ENDS, STEPS
from ..transcription.reduced import ReducedProblem
from ..transcription.steps import shape_steps
from .solved import Basis, Solved, mesh_basis

FLAT = 1 - 1e-9
"""Margin above which nothing softens: the greatest value, 1, which does not change."""


class Pose:
    """A solved pose: values at once, derivatives by LOCAL where they are asked for.

    n tubes, m shape points, L = 7 n. `position` (m, 3), `frame` (m, 3, 3), `arc_length` (m,); `theta` (m', n) and
    `bend` (m', 2), theta and curvature at both ends and three places inside every piece.
    """

    def __init__(self, solved: Solved) -> None:
        self.solved = solved
        self.problem = solved.problem
        self.margin = solved.margin
        self._n = solved.problem.assembly.n_tubes
        self._profile = arms.profile(solved.problem, solved.rotations, solved.state)
        self.arc_length = arms.arc_lengths(solved.problem.mesh)

    @property
    def position(self) -> Array:
        """(m, 3) of the shape points, m."""
        return self._steps[2]

    @property
    def frame(self) -> Array:
        """(m, 3, 3) Bishop frame at the shape points."""
        return self._steps[3]

    # --- values -------------------------------------------------------------------------------------------------------

    def _theta(self, x: Array) -> Array:
        return arms.rotations_at(self.problem, self._profile, tuple(x.tolist()))

    def _bend(self, theta: Array) -> Array:
        """u (P, X, 2) at theta (P, X, n)."""
        m = self.problem.piece_moment[:, None]
        total = self.problem.piece_stiffness.sum(1)[:, None, None]
        return np.asarray(np.stack([(m * np.cos(theta)).sum(2), (m * np.sin(theta)).sum(2)], axis=2) / total)

    @cached_property
    def _steps(self) -> tuple[Array, Array, Array, Array]:
        """Poses and slopes of all steps; position and frame at the shape points."""
        mesh, pieces = self.problem.mesh, len(self.problem.mesh.length)
        position, frame = np.zeros((STEPS * pieces + 1, 3)), np.zeros((STEPS * pieces + 1, 3, 3))
        frame[0] = np.eye(3)
        if not pieces:
            return np.zeros((0, 12)), np.zeros((0, 7, 12)), position, frame
        u = self._bend(self._theta(STEP_POINTS)).reshape(pieces * STEPS, 6)
        poses, slopes = (
            out.copy() for out in shape_steps(STEPS * pieces)(u, np.repeat(mesh.length / STEPS, STEPS)[:, None])
        )
        turn = poses[:, :9].reshape(-1, 3, 3).swapaxes(1, 2)
        for k in range(len(poses)):
            frame[k + 1] = frame[k] @ turn[k]
            position[k + 1] = position[k] + frame[k] @ poses[k, 9:]
        return poses, slopes.reshape(-1, 7, 12), position, frame

    @cached_property
    def theta(self) -> Array:
        """(P x 5, n) theta at ENDS of every piece."""
        return self._theta(ENDS).reshape(-1, self._n)

    @cached_property
    def bend(self) -> Array:
        """(P x 5, 2) curvature there, 1/m."""
        return self._bend(self._theta(ENDS)).reshape(-1, 2)

    # --- derivatives --------------------------------------------------------------------------------------------------

    @cached_property
    def basis(self) -> Basis:
        """Derivatives of the mesh."""
        return mesh_basis(self.problem.assembly, self.problem.mesh)

    @cached_property
    def _moment_slopes(self) -> tuple[Array, Array]:
        """(N, n, Q) explicit change of m_i, (N, Q) of sum kb, at the collocation points."""
        assembly, n = self.problem.assembly, self._n
        size = self.basis.local.shape[0]
        section = np.repeat(self.problem.mesh.section[self.problem.mesh.collocated], self.problem.mesh.tableau.degree)
        return _section_slopes(assembly, section, size, n)

    @cached_property
    def _torsion(self) -> tuple[Array, Array]:
        """(N, n, Q) change of theta and of M at the collocation points."""
        problem, state, n = self.problem, self.solved.state, self._n
        count, size = len(problem.weight), self.basis.local.shape[0]
        change = np.zeros((count, n, size))
        change[:, np.arange(n), np.arange(n)] = 1.0
        if not count:
            return change, change
        theta, m, kt = state.theta, problem.moment, problem.assembly.torsional_stiffness
        moved, stiffer = self._moment_slopes
        total = problem.stiffness.sum(1)
        wave = np.exp(1j * theta)
        u = (m * wave).sum(1) / total
        du = np.einsum("aj,ajq->aq", wave, moved) / total[:, None] - u[:, None] * stiffer / total[:, None]
        lever = np.imag(np.conj(u)[:, None] * wave)
        explicit = moved * lever[:, :, None] + m[:, :, None] * np.imag(np.conj(du)[:, None, :] * wave[:, :, None])
        pull = problem.weight[:, None] * state.moment
        weight = self._weight_slopes
        gained = problem.weight[:, None, None] * explicit + weight[:, None, :] * state.moment[:, :, None]
        green = _green(problem)
        for i in range(n):
            compliance = (problem.assembly.transmission[i] + green) / kt[i]
            change[:, i] -= compliance @ gained[:, i]
            change[:, i, n + i] -= pull[:, i].sum() / kt[i]
            change[:, i, 2 * n + i] += compliance @ pull[:, i] / kt[i]
            change[:, i] -= self._green_times(pull[:, i]) / kt[i]
        right = change[problem.point, problem.tube]
        solved = problem.factor @ np.linalg.solve(state.hessian, np.linalg.solve(problem.factor, right))
        change[problem.point, problem.tube] = solved
        stiffness = _stiffness(theta, m, total)
        return change, explicit + np.einsum("aij,ajq->aiq", stiffness, change)

    @cached_property
    def _weight_slopes(self) -> Array:
        """(N, Q) change of the quadrature weights."""
        mesh = self.problem.mesh
        return (
            np.repeat(self.basis.length[mesh.collocated], mesh.tableau.degree, axis=0)
            * np.tile(mesh.tableau.weights, int(mesh.collocated.sum()))[:, None]
        )

    @cached_property
    def _green_slopes(self) -> Array:
        """(Q, N, N) change of the collocated min(s, r); 0 but for the cuts."""
        mesh, n = self.problem.mesh, self._n
        k, count = mesh.tableau.degree, int(mesh.collocated.sum())
        start = np.repeat(self.basis.start[mesh.collocated], k, axis=0)
        length = np.repeat(self.basis.length[mesh.collocated], k, axis=0)
        s = start + np.tile(mesh.tableau.nodes, count)[:, None] * length
        index = np.arange(k * count)
        lower = np.minimum(index[:, None], index)
        local = np.tile(mesh.tableau.matrix @ (mesh.tableau.matrix / mesh.tableau.weights).T, (count, count))
        same = index[:, None] // k == index // k
        out = np.zeros((self.basis.local.shape[0], k * count, k * count))
        for q in range(5 * n, len(out)):
            out[q] = np.where(same, start[:, q, None] + length[:, q, None] * local, s[lower, q])
        return out

    def _green_times(self, vector: Array) -> Array:
        return np.asarray((self._green_slopes @ vector).T)

    @cached_property
    def _profile_slopes(self) -> tuple[Array, Array, Array]:
        """(P, n, Q) change of theta and w where each piece begins, (P, K, n, Q) of M / kt."""
        problem, mesh, n = self.problem, self.problem.mesh, self._n
        change_moment = self._torsion[1]
        kt = problem.assembly.torsional_stiffness
        size, t = self.basis.local.shape[0], mesh.tableau
        inner = np.zeros((len(mesh.length), t.degree, n, size))
        inner[mesh.collocated] = (change_moment / kt[:, None]).reshape(-1, t.degree, n, size)
        for i in range(n):
            inner[:, :, i, 2 * n + i] -= self._profile.moment[:, :, i] / kt[i]
        h, dh = mesh.length[:, None, None], self.basis.length[:, None, :]
        gain = np.einsum("k,pki->pi", t.weights, self._profile.moment)[:, :, None]
        lever = np.einsum("k,pki->pi", t.weights * (1 - t.nodes), self._profile.moment)[:, :, None]
        change = h * np.einsum("k,pkiq->piq", t.weights, inner) + dh * gain
        twist = -np.cumsum(change[::-1], axis=0)[::-1]
        turn = h * twist + dh * self._profile.twist[:, :, None] + 2 * h * dh * lever
        turn += h**2 * np.einsum("k,pkiq->piq", t.weights * (1 - t.nodes), inner)
        base = np.zeros((n, size))
        base[np.arange(n), np.arange(n)] = 1.0
        if len(twist):
            base += problem.assembly.transmission[:, None] * twist[0]
            base[np.arange(n), n + np.arange(n)] += self._profile.twist[0]
        return base + np.cumsum(turn, axis=0) - turn, twist, inner

    def _theta_slope(self, x: Array) -> Array:
        """(P, X, n, Q) change of theta at fractions x of every piece."""
        mesh, t = self.problem.mesh, self.problem.mesh.tableau
        rotation, twist, inner = self._profile_slopes
        h, dh = mesh.length[:, None, None, None], self.basis.length[:, None, None, :]
        at = x[None, :, None, None]
        twice = t.lagrange(x, integrals=2)
        out = rotation[:, None] + at * (h * twist[:, None] + dh * self._profile.twist[:, None, :, None])
        out = out + h**2 * np.einsum("xk,pkiq->pxiq", twice, inner)
        return np.asarray(out + 2 * h * dh * np.einsum("xk,pki->pxi", twice, self._profile.moment)[:, :, :, None])

    def _bend_slope(self, x: Array) -> tuple[Array, Array]:
        """(P, X, n, Q) change of theta and (P, X, 2, Q) of the curvature at fractions x of every piece."""
        problem, n = self.problem, self._n
        theta, change = self._theta(x), self._theta_slope(x)
        moved, stiffer = _section_slopes(problem.assembly, problem.mesh.section, change.shape[-1], n)
        total = problem.piece_stiffness.sum(1)[:, None, None]
        wave = np.exp(1j * theta)
        m = problem.piece_moment[:, None, :]
        u = (m * wave).sum(2)[:, :, None] / total
        du = np.einsum("pxj,pjq->pxq", wave, moved) + 1j * np.einsum("pxj,pxjq->pxq", m * wave, change)
        du = (du - u * stiffer[:, None, :]) / total
        return change, np.stack([du.real, du.imag], axis=2)

    @cached_property
    def bend_slopes(self) -> tuple[Array, Array]:
        """(P x 5, n, L) of `theta` and (P x 5, 2, L) of `bend`, at fixed places within the pieces."""
        change, du = self._bend_slope(ENDS)
        local = self.basis.local
        return (change @ local).reshape(-1, self._n, local.shape[1]), (du @ local).reshape(-1, 2, local.shape[1])

    @cached_property
    def shape_slopes(self) -> tuple[Array, Array, Array]:
        """(m, 3, L) change of position and of frame (turn vector), (m, L) of arc length, at the shape points."""
        pieces, local = len(self.problem.mesh.length), self.basis.local
        position, turn = (np.zeros((STEPS * pieces + 1, 3, local.shape[1])) for _ in range(2))
        arc = np.zeros((STEPS * pieces + 1, local.shape[1]))
        if not pieces:
            return position, turn, arc
        du = (self._bend_slope(STEP_POINTS)[1] @ local).reshape(pieces * STEPS, 6, -1)
        dh = np.repeat((self.basis.length @ local) / STEPS, STEPS, axis=0)[:, None]
        poses, slopes, _, frame = self._steps
        change = slopes.swapaxes(1, 2) @ np.concatenate([du, dh], axis=1)
        step = poses[:, :9].reshape(-1, 3, 3).swapaxes(1, 2)
        # dR R' is skew; its entries (2, 1), (0, 2), (1, 0) are the turn vector.
        spin = np.einsum("kcrq,kcm->krmq", change[:, :9].reshape(len(step), 3, 3, -1), step.swapaxes(1, 2))
        spin = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
        world = frame[:-1] @ poses[:, 9:, None]
        gain = frame[:-1] @ change[:, 9:]
        turned = frame[:-1] @ spin
        for k in range(len(step)):
            turn[k + 1] = turn[k] + turned[k]
            position[k + 1] = position[k] + gain[k] + np.cross(turn[k], world[k], axis=0)
        arc[1:] = np.cumsum(dh[:, 0], axis=0)
        return position, turn, arc

    @cached_property
    def margin_slope(self) -> Array:
        """(L,) change of the margin."""
        problem, state = self.problem, self.solved.state
        if not problem.size or self.margin >= FLAT:
            return np.zeros(self.basis.local.shape[1])
        vector = eigh(state.hessian)[1][:, 0]
        y = np.zeros_like(problem.moment)
        y.ravel()[problem.flat] = problem.factor @ vector
        wave, m, total = np.exp(1j * state.theta), problem.moment, problem.stiffness.sum(1)
        zero, one, two = ((m * y**k * wave).sum(1)[:, None] for k in range(3))
        form = ((np.conj(zero) * two).real - np.abs(one) ** 2)[:, 0] / total
        weight = wave * (np.conj(two) + np.conj(zero) * y**2 - 2 * np.conj(one) * y) / total[:, None]
        out = self._quotient_slope(vector, form, weight.real)
        by_theta = (1j * m * weight).real * problem.weight[:, None]
        return np.asarray((out + np.einsum("ai,aiq->q", by_theta, self._torsion[0])) @ self.basis.local)

    def _quotient_slope(self, vector: Array, form: Array, by_moment: Array) -> Array:
        """(Q,) change of a margin at fixed theta, from its eigenvector (U,) in z, the form y' V'' y (N,) and its
        derivative (N, n) with respect to m_i; the form is inversely proportional to sum kb."""
        problem, n = self.problem, self._n
        moved, stiffer = self._moment_slopes
        kt = problem.assembly.torsional_stiffness
        total = problem.stiffness.sum(1)
        value = float(problem.weight @ form)
        out = form @ self._weight_slopes + np.einsum("a,ai,aiq->q", problem.weight, by_moment, moved)
        out -= (problem.weight * form / total) @ stiffer
        y, q = np.zeros_like(problem.moment), np.zeros_like(problem.moment)
        y.ravel()[problem.flat] = problem.factor @ vector
        q.ravel()[problem.flat] = np.linalg.solve(problem.factor.T, vector)
        for i in range(n):
            longer = self._green_times(q[:, i]).T @ q[:, i] / kt[i]
            longer[n + i] += q[:, i].sum() ** 2 / kt[i]
            longer[2 * n + i] -= float(q[:, i] @ y[:, i]) / kt[i]
            out += value * longer
        return np.asarray(out)

    @cached_property
    def certificate(self) -> tuple[float, Array]:
        """mu_cert at this pose's translations, and its change (L,); of a double eigenvalue, that of one mode."""
        problem = self.problem
        nothing = np.zeros(self.basis.local.shape[1])
        if not problem.size:
            return 1.0, nothing
        pairs = pair_couplings(problem)
        laplacian = pairs - np.eye(self._n) * pairs.sum(2)[:, :, None]
        second = np.zeros(problem.size**2)
        second[problem.places] = laplacian.ravel()[problem.entries] * problem.entry_weight
        values, vectors = eigh(problem.factor.T @ second.reshape(problem.size, -1) @ problem.factor)
        value = 1.0 + float(values[0])
        if value >= FLAT:
            return 1.0, nothing
        y = np.zeros_like(problem.moment)
        y.ravel()[problem.flat] = problem.factor @ vectors[:, 0]
        gap = (y[:, :, None] - y[:, None, :]) ** 2
        total = problem.stiffness.sum(1)
        form = -0.5 * (pairs * gap).sum((1, 2))
        pull = np.abs(problem.moment)
        by_moment = -np.sign(problem.moment) * np.einsum("aj,aij->ai", pull, gap) / total[:, None]
        return value, np.asarray(self._quotient_slope(vectors[:, 0], form, by_moment) @ self.basis.local)


STEP_POINTS = ((np.arange(STEPS)[:, None] + GAUSS_POINTS) / STEPS).ravel()
"""Fractions of a piece at which the shape needs the curvature."""


def _section_slopes(assembly: Assembly, section: NDArray[np.intp], size: int, n: int) -> tuple[Array, Array]:
    """Explicit change of m_i (X, n, Q) and of sum kb (X, Q) on the given sections (X,)."""
    present, curved = assembly.present[section], assembly.curved[section]
    moved = np.zeros((len(section), n, size))
    stiffer = np.zeros((len(section), size))
    for i in range(n):
        moved[:, i, 3 * n + i] = assembly.curvature[i] * curved[:, i]
        moved[:, i, 4 * n + i] = assembly.bending_stiffness[i] * curved[:, i]
        stiffer[:, 3 * n + i] = present[:, i]
    return moved, stiffer


def _stiffness(theta: Array, m: Array, total: Array) -> Array:
    """(N, n, n) V'': dM_i / dtheta_j."""
    wave = m * np.exp(1j * theta)
    out = -(wave[:, :, None] * np.conj(wave)[:, None, :]).real / total[:, None, None]
    diagonal = np.arange(theta.shape[1])
    out[:, diagonal, diagonal] += (wave * np.conj(wave.sum(1))[:, None]).real / total[:, None]
    return np.asarray(out)


def _green(problem: ReducedProblem) -> Array:
    """(N, N) collocated min(s, r)."""
    mesh, t = problem.mesh, problem.mesh.tableau
    k = t.degree
    elements = np.flatnonzero(mesh.collocated)
    green = np.minimum(problem.arc_length[:, None], problem.arc_length)
    local = t.matrix @ (t.matrix / t.weights).T
    for e, piece in enumerate(elements):
        block = slice(e * k, (e + 1) * k)
        green[block, block] = mesh.start[piece] + mesh.length[piece] * local
    return np.asarray(green)
