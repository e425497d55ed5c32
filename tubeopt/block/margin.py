"""How the stability margin of an equilibrium changes with the parameters that it is differentiated by.

The margin is the least Rayleigh quotient of the second variation over the torsional part; at its mode y, kept fixed along
the arm, the quotient changes only explicitly: with the cross-sections, the springs of the transmissions and the
breakpoints that move.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import lu_factor, lu_solve

from ..robots.assembly import Array
from ..transcription.buffered import section_function
from .linear import Arm, slopes_at

if TYPE_CHECKING:
    from .derivatives import Derivatives


def margin_change(of: Derivatives) -> Array:
    """(Q,) change of the margin, by carriages; NaN where it is a double eigenvalue."""
    arm, n, released = of.arm, of.arm.n_tubes, 1 - of.value
    mode = _mode(of)
    if mode is None:
        return np.full(of.size, np.nan)
    y, base, inside, between = mode
    form, gradient = _variation(of, y)
    weights = arm.length[:, None] * arm.tableau.weights
    total = -float((weights * form).sum()) / released
    out = np.einsum("pk,pkc,pkcq->q", weights, gradient, of.columns)
    kt = arm.torsional_stiffness
    # At fixed y(s) a longer transmission is a softer spring, kt / |beta|.
    out -= released * (kt * base**2) @ of.transmitted
    first = of.first("torsional_stiffness")
    if first is not None:
        twisted = np.einsum("pk,pki->i", weights, inside**2)
        out[first : first + n] += released * (twisted + arm.transmission * base**2)
    np.add.at(out, of.jumps.column, _gains(of, between))
    return np.asarray(out / total)


DOUBLE = 1e-9
"""Two eigenvalues closer than this are one, whose mode, and so derivative, is not told."""


def _mode(of: Derivatives) -> tuple[Array, Array, Array, Array] | None:
    """The mode y (P, K, n) at the points, y' at the plate (n,) and at the points, and y (P + 1, n) between the pieces.

    It solves (1 - mu) y = -C B V'' y, with C the compliance of the tubes between points: by inverse iteration, since mu
    is known. None where there are two such modes.
    """
    arm, n = of.arm, of.arm.n_tubes
    # The margin is that of the tubes on the centreline, at the solved rotations.
    at = slopes_at(replace(arm, place=()), arm.inner) if arm.place else of.slopes
    rate = at.rate_slope[..., :n]
    y = _eigenvector(_compliant(arm, rate), 1 - of.value)
    if y is None:
        return None
    y = y.reshape(arm.inner.shape)
    gain = (rate @ y[..., None])[..., 0] / (1 - of.value)
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


def _eigenvector(matrix: Array, value: float) -> Array | None:
    """The right eigenvector of a matrix whose eigenvalue is very nearly `value`; None where that is double."""
    size = len(matrix)
    factors = lu_factor(matrix - value * np.eye(size), check_finite=False)
    start = np.cos(np.arange(size, dtype=float))
    right, left = start, start
    for _ in range(2):
        right, left = lu_solve(factors, right), lu_solve(factors, left, trans=1)
        right, left = right / np.abs(right).max(), left / np.abs(left).max()
    # Of what is left beside this mode, inverse iteration makes at most 1 / (distance to the next eigenvalue).
    other = np.sin(np.arange(size, dtype=float))
    other -= right * ((left @ other) / (left @ right))
    grown = lu_solve(factors, other)
    grown -= right * ((left @ grown) / (left @ right))
    return None if np.abs(grown).max() * DOUBLE > np.abs(other).max() else np.asarray(right)


def _variation(of: Derivatives, y: Array) -> tuple[Array, Array]:
    """y' V'' y (P, K) and its gradient (P, K, 3n) by theta, kb and m."""
    arm, n, count = of.arm, of.arm.n_tubes, y.shape[1]
    kb, m = (np.repeat(table, count, axis=0) for table in (arm.stiffness, arm.moment))
    out = section_function("variation", len(kb), n, False)(arm.inner.reshape(-1, n), kb, m, y.reshape(-1, n))
    return out[0].reshape(y.shape[:2]).copy(), out[1].reshape(*y.shape[:2], 3 * n).copy()


def _gains(of: Derivatives, y: Array) -> Array:
    """(J,) gain of y' V'' y at the jumps."""
    jumps, count = of.jumps, len(of.jumps)
    if not count:
        return np.zeros(0)
    kb, m = (np.concatenate([jumps.gained[k], jumps.lost[k]]) for k in range(2))
    kb[~kb.any(1)] = 1.0
    theta, mode = (np.concatenate([table[jumps.index]] * 2) for table in (of.states[0], y))
    form = section_function("variation", 2 * count, of.arm.n_tubes, False)(theta, kb, m, mode)[0][:, 0]
    return np.asarray(of.side * (form[:count] - form[count:]))
