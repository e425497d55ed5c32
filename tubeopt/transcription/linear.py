"""The collocated torsion of an arm, linearised: how rotations and torsions along it answer to whatever changes.

The derivatives of a cross-section come from CasADi; here is the linear algebra of the collocation. A state is
(theta, w) where a piece begins; its change at the end of a piece is linear in that at its beginning and in the change
of the cross-section, and the boundary conditions at the plate and at the tip close the chain.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..errors import SolveError
from ..physics.shape import GAUSS_POINTS, step_function
from ..typing import Array
from .buffered import mapped, section_function
from .collocated import ENDS
from .tableau import Tableau, tableau


@dataclass(frozen=True, eq=False)
class Arm:
    """A solved equilibrium on P pieces with K points each; n tubes. What a derivative needs to know of it.

    start, length: (P,) m.  stiffness, moment: (P, n) kb_i of the tubes present and m_i of the tubes curved.
    torsional_stiffness, transmission: (n,).  place: offset and angle (n,), or nothing for concentric tubes.
    theta, twist: (P, n) where pieces begin.  inner: (P, K, n) theta at the points.
    position (4 P + 1, 3), frame (4 P + 1, 3, 3): at the shape points.
    """

    tableau: Tableau
    start: Array
    length: Array
    stiffness: Array
    moment: Array
    torsional_stiffness: Array
    transmission: Array
    place: tuple[Array, ...]
    theta: Array
    twist: Array
    inner: Array
    position: Array
    frame: Array

    @property
    def n_tubes(self) -> int:
        """Number of tubes n."""
        return len(self.transmission)

    @property
    def n_pieces(self) -> int:
        """Number of pieces P."""
        return len(self.length)


@dataclass(frozen=True, eq=False)
class Slopes:
    """Values and derivatives at X points of each piece; columns 3n are theta, kb, m.

    rate: (P, X, n) M / kt, `rate_slope` (P, X, n, 3n).  stretch: (P, X, n) g, `stretch_slope`.  `curvature` (P, X, 2),
    `curvature_slope` (P, X, 2, 3n).  `bending` (P, X) V, `bending_slope` (P, X, 3n).
    """

    rate: Array
    rate_slope: Array
    stretch: Array
    stretch_slope: Array
    curvature: Array
    curvature_slope: Array
    bending: Array
    bending_slope: Array


def slopes_at(arm: Arm, theta: Array) -> Slopes:
    """Cross-sections at theta (P, X, n), by CasADi."""
    pieces, count, n = theta.shape
    if not pieces:
        tubes, slopes = np.zeros((0, count, n)), np.zeros((0, count, n, 3 * n))
        u, bend = np.zeros((0, count, 2)), np.zeros((0, count, 2, 3 * n))
        return Slopes(tubes, slopes, tubes, slopes, u, bend, np.zeros((0, count)), np.zeros((0, count, 3 * n)))
    function = section_function("linear", pieces * count, n, bool(arm.place))
    kb, m = (np.repeat(table, count, axis=0) for table in (arm.stiffness, arm.moment))
    out = [part.copy() for part in function(theta.reshape(-1, n), kb, m, *arm.place)]
    # CasADi stores (rows, 3n) by columns: (points, 3n, rows).
    moment, stretch, u, bending = (out[k].reshape(pieces, count, -1) for k in range(4))
    by = [out[k].reshape(pieces, count, 3 * n, -1).swapaxes(2, 3) for k in range(4, 8)]
    kt = arm.torsional_stiffness
    return Slopes(moment / kt, by[0] / kt[:, None], stretch, by[1], u, by[2], bending[..., 0], by[3][:, :, 0])


@dataclass(frozen=True, eq=False)
class Chain:
    """Linear maps of every piece; columns of `data` are kb, m, kt (3n).

    inner_state (P, K n, 2n), inner_data (P, K n, 3n): of the rotations at the points.
    end_state (P, 2n, 2n), end_data (P, 2n, 3n): of theta and w where the piece ends.
    """

    inner_state: Array
    inner_data: Array
    end_state: Array
    end_data: Array


@lru_cache(maxsize=32)
def _kron_of(family: str, degree: int, n: int) -> tuple[Array, Array, Array]:
    t = tableau(family, degree)
    matrix, adjoint, weights = (np.asarray(np.kron(part, np.eye(n))) for part in (t.matrix, t.adjoint, t.weights))
    return matrix, adjoint, weights


def _kron(t: Tableau, n: int) -> tuple[Array, Array, Array]:
    """Matrix, adjoint and weights of a tableau for n tubes at once."""
    return _kron_of(t.family, t.degree, n)


@lru_cache(maxsize=64)
def _basis_of(family: str, degree: int, x: tuple[float, ...], integrals: int) -> Array:
    return tableau(family, degree).lagrange(x, integrals=integrals)


def _basis(t: Tableau, x: Array, integrals: int) -> Array:
    return _basis_of(t.family, t.degree, tuple(x.tolist()), integrals)


def _spread(matrix: Array, blocks: Array) -> Array:
    """(P, K n, K c) of sum_j: matrix (K, K) between points times blocks (P, K, n, c) at the second point."""
    pieces, count, n, c = blocks.shape
    out = matrix[None, :, None, :, None] * blocks.swapaxes(1, 2)[:, None]
    return np.asarray(out.reshape(pieces, count * n, count * c))


def _diagonal(values: Array) -> Array:
    """(..., n, n) of (..., n)."""
    return np.asarray(values[..., None] * np.eye(values.shape[-1]))


def chain_of(arm: Arm, at: Slopes) -> Chain:
    """The linear maps of all pieces."""
    t, n, pieces, count = arm.tableau, arm.n_tubes, arm.n_pieces, arm.tableau.degree
    h = arm.length[:, None, None]
    rate = at.rate_slope[..., :n]
    by_data = np.concatenate([at.rate_slope[..., n:], -_diagonal(at.rate / arm.torsional_stiffness)], axis=3)
    gained = by_data.reshape(pieces, count * n, 3 * n)
    adjoint = _kron(t, n)[1]
    # Of w at the points: by theta at the points, by the data.
    twist_inner, twist_data = h * _spread(t.adjoint, rate), h * (adjoint @ gained)
    stretch = at.stretch.reshape(pieces, count * n, 1)
    slope_inner, slope_data = stretch * twist_inner, stretch * twist_data
    slope_state = np.zeros((pieces, count * n, 2 * n))
    slope_state[:, :, n:] = (stretch.reshape(pieces, count, n, 1) * np.eye(n)).reshape(pieces, count * n, n)
    if arm.place:
        inside = arm.twist[:, None] + h * (t.adjoint @ at.rate)
        more = inside[..., None] * at.stretch_slope
        for k in range(count):
            block = slice(k * n, (k + 1) * n)
            slope_inner[:, block, block] += more[:, k, :, :n]
            slope_data[:, block, : 2 * n] += more[:, k, :, n:]
    spread = _kron(t, n)[0]
    matrix = np.eye(count * n) - h * (spread @ slope_inner)
    right_state = h * (spread @ slope_state)
    right_state[:, :, :n] += np.tile(np.eye(n), (count, 1))
    right = np.concatenate([right_state, h * (spread @ slope_data)], axis=2)
    solved = np.linalg.solve(matrix, right)
    return _ends(t, h, (rate, gained, slope_inner, slope_state, slope_data), solved)


def _ends(t: Tableau, h: Array, slopes: tuple[Array, ...], solved: Array) -> Chain:
    """The maps of the ends of the pieces from those of their points."""
    rate, gained, slope_inner, slope_state, slope_data = slopes
    pieces, count, n, _ = rate.shape
    state, data = solved[:, :, : 2 * n], solved[:, :, 2 * n :]
    weights = _kron(t, n)[2]
    turned = h * (weights @ slope_inner)
    moved = h * (t.weights[None, :, None, None] * rate).transpose(0, 2, 1, 3).reshape(pieces, n, count * n)
    identity = np.eye(n)
    end_state, end_data = np.zeros((pieces, 2 * n, 2 * n)), np.zeros((pieces, 2 * n, 3 * n))
    end_state[:, :n] = turned @ state + h * (weights @ slope_state)
    end_state[:, :n, :n] += identity
    end_state[:, n:] = moved @ state
    end_state[:, n:, n:] += identity
    end_data[:, :n] = turned @ data + h * (weights @ slope_data)
    end_data[:, n:] = moved @ data + h * (weights @ gained)
    return Chain(state, data, end_state, end_data)


@dataclass(frozen=True, eq=False)
class Response:
    """Change of an arm by Q parameters, at fixed arc lengths.

    state: (P + 1, 2n, Q) of theta and w at the breakpoints of the pieces, at the first point behind each.
    end: (P + 1, 2n, Q) of the same just ahead of each (they differ where a breakpoint moves).
    inner: (P, K, n, Q) of theta at the points.
    """

    state: Array
    end: Array
    inner: Array


def respond(arm: Arm, chain: Chain, base: Array, data: Array, jumps: Array) -> Response:
    """Solve the linearised boundary-value problem.

    Args:
        base: (n, Q) change of alpha + |beta| w(0) at fixed w(0).
        data: (P, 3n, Q) change of kb, m and kt of each piece.
        jumps: (P + 1, 2n, Q) what theta and w gain at each breakpoint at fixed arc lengths.
    """
    n, pieces, size = arm.n_tubes, arm.n_pieces, base.shape[1]
    # Columns: Q parameters, then n unit changes of w at the plate.
    state = np.zeros((pieces + 1, 2 * n, size + n))
    end = np.zeros_like(state)
    end[0, :n, :size] = base
    end[0, :n, size:] = np.diag(arm.transmission)
    end[0, n:, size:] = np.eye(n)
    forced = chain.end_data @ data
    for k in range(pieces + 1):
        state[k] = end[k]
        state[k, :, :size] += jumps[k]
        if k < pieces:
            end[k + 1] = chain.end_state[k] @ state[k]
            end[k + 1, :, :size] += forced[k]
    try:
        twist = -np.linalg.solve(state[-1, n:, size:], state[-1, n:, :size])
    except np.linalg.LinAlgError:
        raise SolveError("the equilibrium is a fold (margin 0), where derivatives are infinite") from None
    state, end = (table[..., :size] + table[..., size:] @ twist for table in (state, end))
    inner = chain.inner_state @ state[:-1] + chain.inner_data @ data
    return Response(state, end, inner.reshape(pieces, arm.tableau.degree, n, size))


def rotations_at(arm: Arm, at: Slopes, x: Array) -> Array:
    """theta (P, len(x), n) at fractions x of every piece."""
    t, h = arm.tableau, arm.length[:, None, None]
    theta = arm.theta[:, None] + x[:, None] * h * arm.twist[:, None] + h**2 * (_basis(t, x, 2) @ at.rate)
    if arm.place:
        inside = arm.twist[:, None] + h * (t.adjoint @ at.rate)
        theta = theta + h * (_basis(t, x, 1) @ ((at.stretch - 1) * inside))
    return np.asarray(theta)


def poses_inside(arm: Arm, at: Slopes) -> tuple[Array, Array]:
    """Frames (P, K, 3, 3) and positions (P, K, 3) at the points, by a step from the shape point before each."""
    nodes, n, steps = arm.tableau.nodes, arm.n_tubes, len(ENDS) - 1
    before = np.minimum((nodes * steps).astype(int), steps - 1)
    part = nodes - ENDS[before]
    x = (ENDS[before][:, None] + part[:, None] * GAUSS_POINTS).ravel()
    theta = rotations_at(arm, at, x).reshape(-1, n)
    kb, m = (np.repeat(table, len(x), axis=0) for table in (arm.stiffness, arm.moment))
    if not len(theta):
        return np.zeros((0, len(nodes), 3, 3)), np.zeros((0, len(nodes), 3))
    u = section_function("curvature", len(theta), n, bool(arm.place))(theta, kb, m, *arm.place)[0]
    step = mapped(step_function(), arm.n_pieces * len(nodes))
    turn, shift = step(u.reshape(-1, 6), (arm.length[:, None] * part).reshape(-1, 1))
    turn = turn.reshape(arm.n_pieces, len(nodes), 3, 3).swapaxes(2, 3)
    index = np.arange(arm.n_pieces)[:, None] * steps + before
    frame = arm.frame[index]
    moved = (frame @ shift.reshape(arm.n_pieces, len(nodes), 3, 1))[..., 0]
    return frame @ turn, arm.position[index] + moved


def rotation_rates_at(arm: Arm, at: Slopes, x: Array) -> Array:
    """theta' (P, len(x), n) at fractions x of every piece, rad/m."""
    t, h = arm.tableau, arm.length[:, None, None]
    slope = arm.twist[:, None] + h * (_basis(t, x, 1) @ at.rate)
    if arm.place:
        inside = arm.twist[:, None] + h * (t.adjoint @ at.rate)
        slope = slope + _basis(t, x, 0) @ ((at.stretch - 1) * inside)
    return np.asarray(slope)


def rotation_change(arm: Arm, at: Slopes, response: Response, data: Array, x: Array) -> Array:
    """(P, len(x), n, Q) change of theta at fractions x of every piece."""
    t, n, h = arm.tableau, arm.n_tubes, arm.length[:, None, None, None]
    inner = response.inner
    section = np.broadcast_to(data[:, None, : 2 * n], (*inner.shape[:2], 2 * n, data.shape[2]))
    columns = np.concatenate([inner, section], axis=2)
    rate = at.rate_slope @ columns - (at.rate / arm.torsional_stiffness)[..., None] * data[:, None, 2 * n :]
    start, twist = response.state[:-1, None, :n], response.state[:-1, None, n:]
    out = start + x[:, None, None] * h * twist + h**2 * along(_basis(t, x, 2), rate)
    if arm.place:
        inside = arm.twist[:, None] + h[..., 0] * (t.adjoint @ at.rate)
        turned = twist + h * along(t.adjoint, rate)
        extra = (at.stretch - 1)[..., None] * turned + inside[..., None] * (at.stretch_slope @ columns)
        out = out + h * along(_basis(t, x, 1), extra)
    return np.asarray(out)


def along(matrix: Array, values: Array) -> Array:
    """(P, X, n, Q) of a matrix (X, K) applied to the points of values (P, K, n, Q)."""
    pieces, count, n, size = values.shape
    return np.asarray((matrix @ values.reshape(pieces, count, n * size)).reshape(pieces, len(matrix), n, size))
