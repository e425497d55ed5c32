"""How the stability margin of an equilibrium changes with the parameters that it is differentiated by.

The margin is the least Rayleigh quotient of the second variation over the torsional part; at its mode y, kept fixed
along the arm, the quotient changes only explicitly: with the cross-sections, the springs of the transmissions and the
breakpoints that move.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np
import scipy

from ..physics.certificate import worst_function
from ..transcription.buffered import mapped, section_function
from ..transcription.linear import Arm
from ..typing import Array

if TYPE_CHECKING:
    from .derivatives import Derivatives


class Variation(Protocol):
    """The part V'' of a second variation, at cross-sections with theta, kb, m (N, n)."""

    def matrix(self, theta: Array, kb: Array, m: Array) -> Array:
        """(N, n, n)."""

    def form(self, theta: Array, kb: Array, m: Array, y: Array) -> tuple[Array, Array]:
        """y' V'' y (N,) and its gradient (N, 3n) with respect to theta, kb and m."""


class AtSolution:
    """That of the margin of concentric tubes, at the solved rotations."""

    def matrix(self, theta: Array, kb: Array, m: Array) -> Array:
        """(N, n, n)."""
        count, n = theta.shape
        # CasADi stores dM_i / dtheta_j by columns; V'' is symmetric.
        return section_function("balance", count, n, False)(theta, kb, m)[1].reshape(count, n, n).copy()

    def form(self, theta: Array, kb: Array, m: Array, y: Array) -> tuple[Array, Array]:
        """y' V'' y (N,) and its gradient (N, 3n)."""
        count, n = theta.shape
        out = section_function("variation", count, n, False)(theta, kb, m, y)
        return out[0][:, 0].copy(), out[1].reshape(count, 3 * n).copy()


class AtWorst:
    """That of the certificate: at rotations which are worst for every pair of tubes."""

    def matrix(self, theta: Array, kb: Array, m: Array) -> Array:
        """(N, n, n)."""
        count, n = theta.shape
        return mapped(worst_function(n), count)(kb, m, np.zeros_like(kb))[0].reshape(count, n, n).copy()

    def form(self, theta: Array, kb: Array, m: Array, y: Array) -> tuple[Array, Array]:
        """y' V'' y (N,) and its gradient (N, 3n)."""
        count, n = theta.shape
        _, form, slope = mapped(worst_function(n), count)(kb, m, y)
        return form[:, 0].copy(), np.concatenate([np.zeros((count, n)), slope.reshape(count, 2 * n)], axis=1)


def quotient_change(of: Derivatives, value: float, variation: Variation, *, one_of_two: bool = False) -> Array:
    """(Q,) change, by carriages, of a least Rayleigh quotient that is `value`.

    Where it is a double eigenvalue it has no derivative: NaN, or, if `one_of_two`, that of one of its modes.
    """
    arm, n, released = of.arm, of.arm.n_tubes, 1 - value
    mode = _mode(arm, variation, value, one_of_two)
    if mode is None:
        return np.full(of.size, np.nan)
    y, base, inside, between = mode
    form, gradient = (part.reshape(*y.shape[:2], -1) for part in variation.form(*_flat(arm), y.reshape(-1, n)))
    weights = arm.length[:, None] * arm.tableau.weights
    total = -float((weights * form[..., 0]).sum()) / released
    by_data = np.einsum("pk,pkc->pc", weights, gradient[..., n:])
    out = np.einsum("pc,pcq->q", by_data, of.data[:, : 2 * n])
    if gradient[..., :n].any():
        out += np.einsum("pk,pki,pkiq->q", weights, gradient[..., :n], of.response.inner)
    kt = arm.torsional_stiffness
    # At fixed y(s) a longer transmission is a softer spring, kt / |beta|.
    out -= released * (kt * base**2) @ of.transmitted
    first = of.first("torsional_stiffness")
    if first is not None:
        twisted = np.einsum("pk,pki->i", weights, inside**2)
        out[first : first + n] += released * (twisted + arm.transmission * base**2)
    np.add.at(out, of.jumps.column, _gains(of, variation, between))
    return np.asarray(out / total)


def _flat(arm: Arm) -> tuple[Array, Array, Array]:
    """theta, kb, m (P K, n) at the points."""
    count, n = arm.tableau.degree, arm.n_tubes
    kb, m = (np.repeat(table, count, axis=0) for table in (arm.stiffness, arm.moment))
    return arm.inner.reshape(-1, n), kb, m


DOUBLE = 1e-9
"""Two eigenvalues closer than this are one, whose mode, and so derivative, is not told."""


def _mode(arm: Arm, variation: Variation, value: float, one_of_two: bool) -> tuple[Array, Array, Array, Array] | None:
    """The mode y (P, K, n) at the points, y' at the plate (n,) and at the points, and y (P + 1, n) between the pieces.

    It solves (1 - mu) y = -C B V'' y, with C the compliance of the tubes between points: by inverse iteration, since mu
    is known. None where there are two such modes and not one of them is asked for.
    """
    n, kt = arm.n_tubes, arm.torsional_stiffness
    rate = (variation.matrix(*_flat(arm)) / kt[:, None]).reshape(*arm.inner.shape, n)
    y = _eigenvector(_compliant(arm, rate), 1 - value, one_of_two)
    if y is None:
        return None
    y = y.reshape(arm.inner.shape)
    gain = (rate @ y[..., None])[..., 0] / (1 - value)
    h, t = arm.length[:, None], arm.tableau
    begin = -np.cumsum((h * (t.weights @ gain))[::-1], axis=0)[::-1]
    inside = begin[:, None] + h[..., None] * (t.adjoint @ gain)
    turned = np.cumsum(h * (t.weights @ inside), axis=0)
    between = arm.transmission * begin[0] + np.concatenate([np.zeros((1, n)), turned])
    return y, begin[0], inside, between


def _compliant(arm: Arm, rate: Array) -> Array:
    """(N n, N n) matrix -C B V'' of all points, from V'' / kt (P, K, n, n)."""
    t, (pieces, count, n, _) = arm.tableau, rate.shape
    s = (arm.start[:, None] + arm.length[:, None] * t.nodes).ravel()
    green = np.minimum(s[:, None], s)
    local = t.matrix @ (t.matrix / t.weights).T
    for k in range(pieces):
        block = slice(k * count, (k + 1) * count)
        green[block, block] = arm.start[k] + arm.length[k] * local
    weighted = (arm.length[:, None] * t.weights).ravel()[:, None, None] * rate.reshape(-1, n, n)
    reach = green[:, None, :] + arm.transmission[:, None]
    return np.asarray(-(reach[..., None] * weighted.swapaxes(0, 1)[None]).reshape(len(s) * n, len(s) * n))


def _eigenvector(matrix: Array, value: float, one_of_two: bool) -> Array | None:
    """The right eigenvector of a matrix whose eigenvalue is very nearly `value`; None where that is double, unless one
    of its vectors is asked for."""
    size = len(matrix)
    shifted = matrix.copy()
    # A shift that is the eigenvalue to the last digit would leave nothing to divide by.
    shifted.ravel()[:: size + 1] -= value * (1 + 1e-11)
    factors = scipy.linalg.lapack.dgetrf(shifted)[:2]
    start = np.cos(np.arange(size, dtype=float))
    right, left = start, start
    for _ in range(2):
        right, left = (
            scipy.linalg.lapack.dgetrs(*factors, right)[0],
            scipy.linalg.lapack.dgetrs(*factors, left, trans=1)[0],
        )
        right, left = right / np.abs(right).max(), left / np.abs(left).max()
    if one_of_two:
        return np.asarray(right)
    # Of what is left beside this mode, inverse iteration makes at most 1 / (distance to the next eigenvalue).
    other = np.sin(np.arange(size, dtype=float))
    other -= right * ((left @ other) / (left @ right))
    grown = scipy.linalg.lapack.dgetrs(*factors, other)[0]
    grown -= right * ((left @ grown) / (left @ right))
    return None if np.abs(grown).max() * DOUBLE > np.abs(other).max() else np.asarray(right)


def _gains(of: Derivatives, variation: Variation, y: Array) -> Array:
    """(J,) gain of y' V'' y at the jumps."""
    jumps, count = of.jumps, len(of.jumps)
    if not count:
        return np.zeros(0)
    kb, m = (np.concatenate([jumps.gained[k], jumps.lost[k]]) for k in range(2))
    kb[~kb.any(1)] = 1.0
    theta, mode = (np.concatenate([table[jumps.index]] * 2) for table in (of.states[0], y))
    form = variation.form(theta, kb, m, mode)[0]
    return np.asarray(of.side * (form[:count] - form[count:]))
