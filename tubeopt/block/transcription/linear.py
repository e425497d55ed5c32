"""The collocated torsion of an arm of tubes off the centreline, linearised: how rotations and torsions along it answer
to whatever changes.

The derivatives of a cross-section come from CasADi; here is the linear algebra of the collocation. A state is
(theta, w) where a piece begins; its change at the end of a piece is linear in that at its beginning and in the change
of the cross-section, and the boundary conditions at the plate and at the tip close the chain.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from ...errors import SolveError
from ...robots.assembly import Assembly
from ...typing import Array, Of
from .arm import ArmShape, Profile, turned_along
from .buffered import section_function
from .collocated import ENDS
from .tableau import Tableau, tableau


@dataclass(frozen=True, eq=False)
class Arm:
    """A solved equilibrium on P pieces with K points each; n tubes. What a derivative needs to know of it.

    start, length: (P,) m.  stiffness, moment: (P, n) kb_i of the tubes present and m_i of the tubes curved.
    theta, twist: (P, n) where pieces begin.  inner: (P, K, n) theta at the points.  shape: at the shape points, with
    the curvature of the piece that ends there.
    """

    tableau: Tableau
    assembly: Assembly
    start: Array
    length: Array
    stiffness: Array
    moment: Array
    theta: Array
    twist: Array
    inner: Array
    shape: ArmShape

    position, frame, curvature = Of[Array]("shape"), Of[Array]("shape"), Of[Array]("shape")
    torsional_stiffness, transmission = Of[Array]("assembly"), Of[Array]("assembly")

    @property
    def place(self) -> tuple[Array, ...]:
        """Offset and angle (n,) of the tubes."""
        return self.assembly.offset, self.assembly.offset_angle

    @cached_property
    def flat(self) -> tuple[Array, Array, Array]:
        """theta, kb, m (P K, n) at the points."""
        return self.inner.reshape(-1, self.n_tubes), *self.repeated(self.tableau.degree)

    def repeated(self, count: int) -> tuple[Array, Array]:
        """kb, m (P count, n) at `count` places of every piece."""
        return np.repeat(self.stiffness, count, axis=0), np.repeat(self.moment, count, axis=0)

    @cached_property
    def states(self) -> tuple[Array, Array]:
        """(P + 1, n) theta and w between the pieces."""
        tip = self.shape.rotation[:, -1][None]
        return np.concatenate([self.theta, tip]), np.concatenate([self.twist, np.zeros_like(tip)])

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
    function = section_function("linear", pieces * count, n, True)
    kb, m = arm.flat[1:] if theta is arm.inner else arm.repeated(count)
    out = [part.copy() for part in function(theta.reshape(-1, n), kb, m, *arm.place)]
    # CasADi stores (rows, 3n) by columns: (points, 3n, rows).
    moment, stretch, u, bending = (part.reshape(pieces, count, part.shape[1]) for part in out[:4])
    by = [part.reshape(pieces, count, 3 * n, part.shape[1]).swapaxes(2, 3) for part in out[4:8]]
    kt = arm.torsional_stiffness
    return Slopes(moment / kt, by[0] / kt[:, None], stretch, by[1], u, by[2], bending[..., 0], by[3][:, :, 0])


@dataclass(frozen=True, eq=False)
class Chain:
    """Linear maps of every piece; columns of `data` are kb, m, kt (3n), or none where these do not change.

    inner_state (P, K n, 2n), inner_data (P, K n, 3n): of the rotations at the points.
    end_state (P, 2n, 2n), end_data (P, 2n, 3n): of theta and w where the piece ends.
    """

    inner_state: Array
    inner_data: Array
    end_state: Array
    end_data: Array


@lru_cache(maxsize=32)
def _kron(family: str, degree: int, n: int) -> tuple[Array, Array, Array, Array]:
    """Matrix, adjoint and weights of a tableau for n tubes at once, and the same value at all of its points."""
    t = tableau(family, degree)
    parts = (t.matrix, t.adjoint, t.weights[None], np.ones((degree, 1)))
    matrix, adjoint, weights, same = (np.asarray(np.kron(part, np.eye(n))) for part in parts)
    return matrix, adjoint, weights, same


def _spread(matrix: Array, blocks: Array) -> Array:
    """(P, K n, K c) of sum_j: matrix (K, K) between points times blocks (P, K, n, c) at the second point."""
    pieces, count, n, c = blocks.shape
    out = matrix[None, :, None, :, None] * blocks.swapaxes(1, 2)[:, None]
    return np.asarray(out.reshape(pieces, count * n, count * c))


def _diagonal(matrices: Array) -> Array:
    """(P, r) view of the diagonals of matrices (P, r, c), c at least r."""
    rows, columns = matrices.shape[1:]
    return np.asarray(matrices.reshape(len(matrices), rows * columns)[:, : rows * columns : columns + 1])


def chain_of(arm: Arm, at: Slopes, *, dimensions: bool) -> Chain:
    """The linear maps of all pieces; with the columns of `data` where `dimensions` of the tubes change."""
    t, n, pieces, count = arm.tableau, arm.n_tubes, arm.n_pieces, arm.tableau.degree
    h = arm.length[:, None, None]
    spread, adjoint, weights, same = _kron(t.family, count, n)
    rate = at.rate_slope[..., :n]
    # Columns: theta, w where the piece begins, then the data. Of theta' / g at the points, by them and by the data.
    size = 2 * n + 3 * n * dimensions
    twist_inner = h * _spread(t.adjoint, rate)
    twist_given = np.zeros((pieces, count * n, size))
    twist_given[:, :, n : 2 * n] = same
    if dimensions:
        gained = np.zeros((pieces, count * n, 3 * n))
        by_data = gained.reshape(pieces, count, n, 3 * n)
        by_data[..., : 2 * n] = at.rate_slope[..., n:]
        by_data[..., range(n), range(2 * n, 3 * n)] = -at.rate / arm.torsional_stiffness
        twist_given[:, :, 2 * n :] = h * (adjoint @ gained)
    stretch = at.stretch.reshape(pieces, count * n, 1)
    twist_inner, twist_given = stretch * twist_inner, stretch * twist_given
    inside = arm.twist[:, None] + h * (t.adjoint @ at.rate)
    more = inside[..., None] * at.stretch_slope
    for k in range(count):
        block = slice(k * n, (k + 1) * n)
        twist_inner[:, block, block] += more[:, k, :, :n]
        if dimensions:
            twist_given[:, block, 2 * n : 4 * n] += more[:, k, :, n:]
    matrix = -h * (spread @ twist_inner)
    _diagonal(matrix)[:] += 1.0
    right = h * (spread @ twist_given)
    right[:, :, :n] += same
    inner = np.asarray(np.linalg.solve(matrix, right), dtype=float)
    moved = h * (t.weights[None, :, None, None] * rate).transpose(0, 2, 1, 3).reshape(pieces, n, count * n)
    end = np.empty((pieces, 2 * n, size))
    end[:, :n] = h * ((weights @ twist_inner) @ inner + weights @ twist_given)
    end[:, n:] = moved @ inner
    if dimensions:
        end[:, n:, 2 * n :] += h * (weights @ gained)
    _diagonal(end)[:] += 1.0
    return Chain(inner[:, :, : 2 * n], inner[:, :, 2 * n :], end[:, :, : 2 * n], end[:, :, 2 * n :])


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
    state, end = np.zeros((2, pieces + 1, 2 * n, size + n))
    end[0, :n, :size] = base
    for tube, transmission in enumerate(arm.transmission.tolist()):
        end[0, tube, size + tube] = transmission
        end[0, n + tube, size + tube] = 1.0
    dimensions = chain.end_data.shape[2] > 0
    forced = chain.end_data @ data if dimensions else None
    for k in range(pieces + 1):
        state[k] = end[k]
        state[k, :, :size] += jumps[k]
        if k < pieces:
            np.matmul(chain.end_state[k], state[k], out=end[k + 1])
            if forced is not None:
                end[k + 1, :, :size] += forced[k]
    *_, twist, singular = scipy.linalg.lapack.dgesv(-state[-1, n:, size:], state[-1, n:, :size])
    if singular:
        raise SolveError("the equilibrium is a fold (margin 0), where derivatives are infinite")
    state, end = (table[..., :size] + table[..., size:] @ twist for table in (state, end))
    inner = chain.inner_state @ state[:-1]
    if dimensions:
        inner += chain.inner_data @ data
    return Response(state, end, inner.reshape(pieces, arm.tableau.degree, n, size))


_ONE = np.ones((1, 1))
"""Compliance where a profile has w and M / kt in place of the torque and M."""


def _profile(arm: Arm, at: Slopes) -> Profile:
    """theta along the arm by w and M / kt at the points."""
    inside = arm.twist[:, None] + arm.length[:, None, None] * (arm.tableau.adjoint @ at.rate)
    return Profile(arm.theta, arm.twist, at.rate, _ONE, (at.stretch - 1) * inside)


def rotations_at(arm: Arm, at: Slopes, x: Array) -> Array:
    """theta (P, len(x), n) at fractions x of every piece."""
    return turned_along(arm.tableau, arm.length, _profile(arm, at), tuple(x.tolist()))


def rotation_rates_at(arm: Arm, at: Slopes, x: Array) -> Array:
    """theta' (P, len(x), n) at fractions x of every piece, rad/m."""
    t, of = arm.tableau, _profile(arm, at)
    even = of.torque[:, None] + arm.length[:, None, None] * (t.basis(tuple(x.tolist()), 1) @ of.moment)
    return np.asarray(even + t.basis(tuple(x.tolist()), 0) @ of.extra)


@lru_cache(maxsize=16)
def hermite(family: str, degree: int) -> Array:
    """(K, 9) values at the points from those at ENDS and slopes at ENDS but the first."""
    return interpolation(tableau(family, degree).nodes, ENDS, ENDS[1:])


def interpolation(x: Array, values: Array, slopes: Array) -> Array:
    """(len(x), v + s) value at x of the polynomial that is told by its values (v,) and slopes (s,) at given places."""
    power = np.arange(len(values) + len(slopes))
    rates = power * slopes[:, None] ** np.maximum(power - 1, 0)
    conditions = np.concatenate([values[:, None] ** power, rates])
    return np.asarray(np.linalg.solve(conditions.T, (x[:, None] ** power).T).T)


def poses_at_points(t: Tableau, length: Array, shape: tuple[Array, Array, Array]) -> tuple[Array, Array]:
    """Frames (P, K, 3, 3) and positions (P, K, 3) at the points of pieces of lengths (P,), from frames, positions and
    curvatures at the shape points: polynomials through those of a piece, with the slopes R hat(u) and R e3 there (where
    it begins, u is another one's)."""
    pieces, count = len(length), 2 * len(ENDS) - 1
    index = shape_points(pieces)
    frame, step = shape[0][index], length[:, None, None, None]
    turning = (shape[2][index] @ _HAT).reshape(frame.shape)
    frames = np.concatenate([frame, step * (frame @ turning)[:, 1:]], 1)
    places = np.concatenate([shape[1][index], step[..., 0] * frame[:, 1:, :, 2]], 1)
    matrix = hermite(t.family, t.degree)
    return (matrix @ frames.reshape(pieces, count, 9)).reshape(pieces, t.degree, 3, 3), matrix @ places


_HAT = np.array([[0.0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0]])
"""hat(u) by rows from (u_x, u_y)."""


@lru_cache(maxsize=64)
def shape_points(pieces: int) -> NDArray[np.intp]:
    """(P, 5) which of the shape points lie at ENDS of every piece."""
    steps = len(ENDS) - 1
    return np.asarray(np.arange(pieces)[:, None] * steps + np.arange(steps + 1), dtype=np.intp)


def rotation_change(arm: Arm, at: Slopes, response: Response, data: Array, x: Array) -> Array:
    """(P, len(x), n, Q) change of theta at fractions x of every piece."""
    t, n, h = arm.tableau, arm.n_tubes, arm.length[:, None, None, None]
    inner = response.inner
    section = np.broadcast_to(data[:, None, : 2 * n], (*inner.shape[:2], 2 * n, data.shape[2]))
    columns = np.concatenate([inner, section], axis=2)
    rate = at.rate_slope @ columns - (at.rate / arm.torsional_stiffness)[..., None] * data[:, None, 2 * n :]
    start, twist = np.split(response.state[:-1], 2, axis=1)

    def flat(values: Array) -> Array:
        return values.reshape(*values.shape[:-2], -1)

    inside = arm.twist[:, None] + h[..., 0] * (t.adjoint @ at.rate)
    turned = twist[:, None] + h * along(t.adjoint, rate)
    extra = flat((at.stretch - 1)[..., None] * turned + inside[..., None] * (at.stretch_slope @ columns))
    change = turned_along(t, arm.length, Profile(flat(start), flat(twist), flat(rate), _ONE, extra), tuple(x.tolist()))
    return change.reshape(*change.shape[:2], *start.shape[1:])


def along(matrix: Array, values: Array) -> Array:
    """(P, X, n, Q) of a matrix (X, K) applied to the points of values (P, K, n, Q)."""
    pieces, count, n, size = values.shape
    return np.asarray((matrix @ values.reshape(pieces, count, n * size)).reshape(pieces, len(matrix), n, size))


_ENDS = tuple(ENDS.tolist())


def cumulate(t: Tableau, values: Array) -> Array:
    """Integrals (m, ...) from the plate to every shape point of values (P, K, ...) at the points, per piece."""
    flat = values.reshape(*values.shape[:2], int(np.prod(values.shape[2:])))
    inner = (t.basis(_ENDS, 1) @ flat).reshape(len(flat), len(ENDS), *values.shape[2:])
    ends = np.concatenate([np.zeros((1, *inner.shape[2:])), np.cumsum(inner[:, -1], axis=0)])
    table = ends[:-1, None] + inner[:, 1:]
    return np.concatenate([ends[:1], table.reshape(-1, *table.shape[2:])])


_CROSS = np.array([[0.0, 0, 0, 0, 0, 1, 0, -1, 0], [0, 0, -1, 0, 0, 0, 1, 0, 0], [0, 1, 0, -1, 0, 0, 0, 0, 0]])
"""The matrix of c x a by rows, from a."""


def cross(columns: Array, arm: Array) -> Array:
    """(..., 3, c) cross product of every column with vectors (..., 3)."""
    return np.asarray((arm @ _CROSS).reshape(*arm.shape, 3) @ columns)
