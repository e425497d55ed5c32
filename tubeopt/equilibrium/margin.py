"""How the stability margin of an equilibrium changes with the parameters that it is differentiated by.

The margin is the least Rayleigh quotient of the second variation over the torsional part; at its mode y, kept fixed
along the arm, the quotient changes only explicitly: with the cross-sections, the springs of the transmissions and the
breakpoints that move.
"""

from __future__ import annotations

import numpy as np
import scipy

from ..block.transcription.buffered import section_function
from ..block.transcription.green import green_of
from ..block.transcription.linear import Arm
from ..typing import Array
from .arm_change import ArmChange


def quotient_change(of: ArmChange, value: float) -> Array:
    """(Q,) change, by carriages, of the margin that is `value`; NaN where it is a double eigenvalue."""
    arm, n, released = of.arm, of.arm.n_tubes, 1 - value
    # A moment is a slope of V.
    mode = _mode(of, of.slopes.rate_slope[..., :n], value)
    if mode is None:
        return np.full(of.size, np.nan)
    y, base, inside, between = mode
    form, gradient = _form(*arm.flat, y.reshape(-1, n))
    weights = (arm.length[:, None] * arm.tableau.weights).ravel()
    gradient *= weights[:, None]
    out = gradient[:, :n].ravel() @ of.response.inner.reshape(-1, of.size)
    if of.reshaped:
        by_data = gradient[:, n:].reshape(arm.n_pieces, -1, 2 * n).sum(1)
        out += np.tensordot(by_data, of.data[:, : 2 * n], 2)
    kt = arm.torsional_stiffness
    # At fixed y(s) a longer transmission is a softer spring, kt / |beta|.
    out -= released * (kt * base**2) @ of.transmitted
    first = of.first("torsional_stiffness")
    if first is not None:
        twisted = weights @ inside.reshape(-1, n) ** 2
        out[first : first + n] += released * (twisted + arm.transmission * base**2)
    if len(of.jumps):
        ends = _form(of.jumps.twice(arm.states[0]), of.jumps.solid, of.jumps.moment, of.jumps.twice(between))
        out += of.side * of.jumps.gain(ends[0]) @ of.jumps.spread
    return np.asarray(out * (-released / (weights @ form)))


def _form(theta: Array, kb: Array, m: Array, y: Array) -> tuple[Array, Array]:
    """y' V'' y (N,) and its gradient (N, 3n) with respect to theta, kb and m."""
    count, n = theta.shape
    out = section_function("variation", count, n, False)(theta, kb, m, y)
    return out[0][:, 0].copy(), out[1].reshape(count, 3 * n).copy()


def _mode(of: ArmChange, rate: Array, value: float) -> tuple[Array, Array, Array, Array] | None:
    """The mode y (P, K, n) at the points, y' at the plate (n,) and at the points, and y (P + 1, n) between the pieces.

    It solves (1 - mu) y = -C B V'' y, with C the compliance of the tubes between points: by inverse iteration, since mu
    is known; `rate` (P, K, n, n) is V'' / kt. None where there are two such modes.
    """
    arm, t = of.arm, of.arm.tableau
    y = _eigenvector(_compliant(arm, rate), 1 - value)
    if y is None:
        return None
    y = y.reshape(arm.inner.shape)
    gain = (rate @ y[..., None])[..., 0] * (arm.length / (1 - value))[:, None, None]
    # y' vanishes at the tip, and y is |beta| y' at the plate.
    sums = np.cumsum((t.weights @ gain)[::-1], axis=0)[::-1]
    inside = t.adjoint @ gain - sums[:, None]
    turned = np.concatenate([-arm.transmission * sums[:1], arm.length[:, None] * (t.weights @ inside)])
    return y, -sums[0], inside, np.cumsum(turned, axis=0)


def _compliant(arm: Arm, rate: Array) -> Array:
    """(N n, N n) matrix -C B V'' of all points, from V'' / kt (P, K, n, n)."""
    n = arm.n_tubes
    weighted = (arm.length[:, None] * arm.tableau.weights).reshape(-1, 1, 1) * rate.reshape(-1, n, n)
    reach = green_of(arm.tableau, arm.start, arm.length)[:, None, :] + arm.transmission[:, None]
    size = len(weighted) * n
    return np.asarray(-(reach[..., None] * weighted.swapaxes(0, 1)[None]).reshape(size, size))


def _eigenvector(matrix: Array, value: float) -> Array | None:
    """The right eigenvector of a matrix whose eigenvalue is very nearly `value`; None where that is double."""
    size = len(matrix)
    # A shift that is the eigenvalue to the last digit would leave nothing to divide by.
    matrix.ravel()[:: size + 1] -= value * (1 + 1e-11)
    factors, pivots, _ = scipy.linalg.lapack.dgetrf(matrix.T, overwrite_a=True)
    angle = np.arange(size, dtype=float)
    start = np.column_stack([np.cos(angle), np.sin(angle)])
    grown = scipy.linalg.lapack.dgetrs(factors, pivots, start, trans=1)[0]
    right = scipy.linalg.lapack.dgetrs(factors, pivots, grown[:, 0] / np.abs(grown[:, 0]).max(), trans=1)[0]
    right /= np.abs(right).max()
    # Of what is left beside this mode, inverse iteration makes at most 1 / (distance to the next eigenvalue): two
    # that are closer than 1e-9 are one, whose mode, and so derivative, is not told.
    other = grown[:, 1] - right * ((right @ grown[:, 1]) / (right @ right))
    return None if np.abs(other).max() * 1e-9 > 1.0 else right
