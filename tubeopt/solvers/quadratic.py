"""Least squares with linear inequalities, small and dense: the quadratic program behind every constrained step.

The compiled kernel solves it by the dual method of Goldfarb and Idnani (`compiled/quadratic.c`), which the C library of
a servo includes too. Without a kernel, and for more variables than it has room for, it is a problem of least distance
for SciPy's non-negative least squares.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy

from ..typing import Array, Index
from .compiled.quadratic import MOST_VARIABLES, compiled_least_squares

FEASIBLE = 1e-9
"""Share of the right-hand side by which an inequality may be missed before it counts as violated."""

ROUNDED = 1e-5
"""Share of the answer's distance from the free minimum by which it may miss an inequality."""


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """Minimiser x (m,), and the numbers of the inequalities that hold it back."""

    x: Array
    active: Index


def constrained_least_squares(matrix: Array, right: Array, rows: Array, bounds: Array) -> LeastSquares | None:
    """min |matrix x - right| subject to rows x >= bounds, or None where no x satisfies these.

    Args:
        matrix: (r, m) of full column rank.   right: (r,).
        rows: (k, m).   bounds: (k,); -inf where there is none.
    """
    compiled = compiled_least_squares() if matrix.shape[1] <= MOST_VARIABLES else None
    if compiled is None:
        return by_least_distance(matrix, right, rows, bounds)
    result = compiled(matrix, right, rows, bounds)
    return None if result is None else LeastSquares(*result)


def by_least_distance(matrix: Array, right: Array, rows: Array, bounds: Array) -> LeastSquares | None:
    """The same by `scipy.optimize.nnls`: Lawson and Hanson, Solving Least Squares Problems (1974), chapter 23.

    A QR factorisation makes it a problem of least distance, whose dual is a non-negative least-squares problem.
    """
    m = matrix.shape[1]
    q, r = np.linalg.qr(matrix)
    x = scipy.linalg.solve_triangular(r, q.T @ right)
    kept = np.isfinite(bounds).nonzero()[0]
    cone = scipy.linalg.solve_triangular(r, rows[kept].T, trans=1).T
    length, gap = np.linalg.norm(cone, axis=1), (bounds - rows @ x)[kept]
    idle = length <= 1e-14 * length.max(initial=0.0)
    if (bounds[kept[idle]] > FEASIBLE).any():
        return None
    kept, cone, gap, length = kept[~idle], cone[~idle], gap[~idle], length[~idle]
    gap, cone = gap / length, cone / length[:, None]
    scale = float(gap.max(initial=0.0))
    if scale <= 0:
        return LeastSquares(x, np.zeros(0, dtype=int))
    # Least |y| with cone y >= gap / scale: y is the residual of the dual over its last entry.
    dual, last = np.vstack([cone.T, gap / scale]), np.append(np.zeros(m), 1.0)
    weights, _ = scipy.optimize.nnls(dual, last, maxiter=50 * len(gap))
    residual = dual @ weights - last
    if -residual[-1] <= FEASIBLE:
        return None
    y = -scale * residual[:-1] / residual[-1]
    x = x + scipy.linalg.solve_triangular(r, y)
    # Where next to nothing satisfies them all, rounding decides the dual.
    if (bounds[kept] - rows[kept] @ x > ROUNDED * length * math.sqrt(y @ y)).any():
        return None
    return LeastSquares(x, kept[weights > 0])
