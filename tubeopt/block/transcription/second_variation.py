"""Stability of a solved torsion problem: margin, unstable directions, and the softest direction.

Of eccentric tubes the margin measures the distance of one equilibrium from a fold. Their equations, theta' = g w and
kt w' = M, are not those of an energy in the rotations alone. Linearised at a solution,

    y' = g v + w (g' y),   kt v' = M' y,   v = 0 at the tip,   y(0) = |beta| v(0),

and a nonzero solution y is a fold, where the joint rotations no longer determine the shape. The margin mu is the
fraction of their torsional stiffness that the tubes may lose, at a fixed state, before a solution exists. With the
collocated integrals P from the base and W to the tip,

    (1 - mu) y = K y,   K = -(1 - P w g')^-1 [Gamma + P (g - 1) W / kt] M',

and 1 - mu is the largest real eigenvalue of K, at most 1. K is the collocated equation itself, so the margin is 0
exactly where its Jacobian is singular. With d = 0 K is the symmetric -Gamma V'' in other coordinates, and the margin
the smallest eigenvalue of the second variation.

Tubes that are curved in the same sections form a block: tubes that pass an outer segment without being curved there are
bent by it but do not act on it, so that K is block triangular.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from ...typing import Array
from .reduced import Block, Evaluation, ReducedProblem, eccentric_sections

REAL = 1e-6
"""Imaginary part, relative to its size, below which an eigenvalue counts as real: round-off splits two that are almost
equal by as much. Only a real eigenvalue belongs to a fold."""

DOUBLE = 1e-9
"""Distance of two eigenvalues of a symmetric matrix below which they count as double, without a unique mode.

Round-off mixes modes by 1e-16 over their distance: by up to 1e-7.
"""

SEPARATE = 1e-6
"""Distance of two eigenvalues of another matrix, and cosine of left and right eigenvector, below which a mode has no
derivative."""


def margin(problem: ReducedProblem, state: Evaluation) -> float:
    """Smallest eigenvalue of the second variation relative to its torsional part, at most 1.

    For eccentric tubes see above.
    """
    if not problem.size:
        return 1.0
    if problem.assembly.eccentric:
        # K y = (1 - mu) y: the largest real eigenvalue is the first fold that softening meets.
        return 1.0 - float(softenings(problem, state.theta).max(initial=0.0))
    return least(state.hessian)


def least(matrix: Array) -> float:
    """Smallest eigenvalue of a symmetric matrix, at most 1."""
    if not len(matrix):
        return 1.0
    return min(1.0, float(scipy.linalg.lapack.dsyevr(matrix, compute_v=0, range="I", il=1, iu=1)[0][0]))


class Pair(NamedTuple):
    """Eigenvalue of smallest real part with its eigenvectors."""

    value: complex
    left: Array
    right: Array


def modes(matrix: Array, *, symmetric: bool, any_of_two: bool = False) -> Pair | None:
    """Eigenvalue of smallest real part, with left and right eigenvectors; of a complex pair, one of them.

    None if another eigenvalue has the same real part or where it is defective, unless any of the vectors will do.
    """
    if symmetric:
        values, columns, *_ = scipy.linalg.lapack.dsyevr(matrix, range="I", il=1, iu=min(2, len(matrix)))
        double = len(matrix) > 1 and values[1] - values[0] < DOUBLE
        return None if double and not any_of_two else Pair(float(values[0]), columns[:, 0], columns[:, 0])
    values, left, right = scipy.linalg.eig(matrix, left=True)
    order = np.lexsort((-values.imag, values.real))
    k, larger = order[0], order[1 + (abs(values[order[0]].imag) > 0) :]
    w, v = left[:, k], right[:, k]
    double = len(larger) > 0 and values[larger[0]].real - values[k].real < SEPARATE
    unusable = double or abs(np.vdot(w, v)) < SEPARATE
    return None if unusable and not any_of_two else Pair(complex(values[k]), w, v)


def stiffnesses(matrix: Array, *, symmetric: bool) -> Array:
    """Real parts of the eigenvalues (U,) of a matrix."""
    return np.asarray(np.linalg.eigvalsh(matrix) if symmetric else np.linalg.eigvals(matrix).real)


# --- tubes off the centreline -----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Mode:
    """Eigenvalue 1 - mu of the matrix K, with its left and right vectors."""

    value: float
    y: Array
    """Right vector (N, n), 0 outside its block."""
    zeta: Array
    """Left vector (N, n) of the equation before it is solved for y."""
    pairing: float
    """Product of both vectors with the matrix that the eigenvalue multiplies."""


@dataclass(frozen=True, eq=False)
class _Linearised:
    """Linearised equations of one block of k tubes at p points."""

    block: Block
    system: Array
    """Matrix 1 - P w g' (k p, k p) of the linearised equations, by tube, then by point."""
    compliance: Array
    """Torsional compliance Gamma + P (g - 1) W / kt (k, p, p) of each tube."""
    slope: Array
    """Derivative of the torsional moments by the angles, M' (p, k, k)."""

    def matrix(self) -> Array:
        """Matrix K (k p, k p) with the eigenvalues 1 - mu."""
        right = self.compliance[:, :, None, :] * self.slope.transpose(1, 2, 0)[:, None]
        return np.asarray(np.linalg.solve(self.system, -right.reshape(self.system.shape)))


def _linearise(problem: ReducedProblem, theta: Array) -> Iterator[_Linearised]:
    at = eccentric_sections(problem, theta)
    for block in problem.blocks:
        t, o = block.tubes, block.points
        k, p = len(t), len(o)
        diagonal = np.ix_(o, t, t)
        relative = at.g_slope[diagonal].transpose(1, 2, 0) * at.twist[np.ix_(o, t)].T[:, None, :]
        # P w g': a turn stretches the tubes, which turns them; it is subtracted from 1 below.
        matrix = -(block.up_to[:, o][None, :, None, :] * relative[:, None]).reshape(k * p, k * p)
        matrix.ravel()[:: k * p + 1] += 1.0
        yield _Linearised(block, matrix, at.rotation_by_torque(problem, block), at.slope[diagonal])


def _real(values: NDArray[Any]) -> Array:
    """Real eigenvalues; complex ones are replaced by 0, the eigenvalue without coupling."""
    return np.where(np.abs(values.imag) <= REAL * np.abs(values), values.real, 0.0)


def softenings(problem: ReducedProblem, theta: Array) -> Array:
    """Real eigenvalues of K of all blocks at theta (N, n): remaining fractions of torsional stiffness at folds."""
    # A product's eigenvalues do not change with the order of its factors, but for zeros.
    parts = [np.linalg.eigvals(_moment_matrix(block)) for block in _linearise(problem, theta)]
    return _real(np.concatenate(parts)) if parts else np.zeros(0)


def _moment_matrix(linear: _Linearised) -> Array:
    """Matrix K that acts on moments instead of y, without the last tube: at a cross-section the moments sum to 0."""
    size = len(linear.system) - len(linear.block.points)
    last = len(linear.block.tubes) - 1
    compliance, slope = linear.compliance, linear.slope
    columns = np.zeros((*compliance.shape[:2], last, compliance.shape[2]))
    for i in range(last):
        # M_last = -sum of the others: each unknown moment acts on its tube and, reversed, on the last.
        columns[i, :, i] = compliance[i]
        columns[last, :, i] = -compliance[last]
    moved = np.linalg.solve(linear.system, columns.reshape(len(linear.system), size)).reshape(
        *compliance.shape[:2], size
    )
    return -np.asarray(np.einsum("bij,jbm->ibm", slope[:, :last], moved).reshape(size, size))


def worst_mode(problem: ReducedProblem, theta: Array) -> Mode | None:
    """Mode with the largest eigenvalue, None without softening; its vectors are NaN if the eigenvalue is double."""
    best: tuple[float, _Linearised, Array, Array] | None = None
    following = 0.0
    for one in _linearise(problem, theta):
        matrix = one.matrix()
        values, vectors = np.linalg.eig(matrix)
        real = _real(values)
        order = np.argsort(-real)
        top = float(real[order[0]])
        # The next eigenvalue of this block or of another: a double one has no derivative.
        following = max(following, *real[order[1:2]].tolist(), top if best is not None and top <= best[0] else 0.0)
        if best is None or top > best[0]:
            following = max(following, 0.0 if best is None else best[0])
            best = top, one, vectors[:, order[0]].real, matrix
    if best is None or best[0] <= 0:
        return None
    value, one, right, matrix = best
    if value - following < 1e-9:
        return Mode(value, np.full_like(theta, np.nan), np.full_like(theta, np.nan), np.nan)
    values, vectors = np.linalg.eig(matrix.T)
    # Left vectors of K are the right ones of K'; the nearest eigenvalue is the same one.
    left = vectors[:, int(np.argmin(np.abs(values - value)))].real
    y, zeta = np.zeros_like(theta), np.zeros_like(theta)
    entries = np.ix_(one.block.points, one.block.tubes)
    y[entries] = right.reshape(len(one.block.tubes), -1).T
    zeta[entries] = np.linalg.solve(one.system.T, left).reshape(len(one.block.tubes), -1).T
    return Mode(value, y, zeta, float(left @ right))
