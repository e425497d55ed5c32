"""Least squares with linear inequalities, small and dense."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy

from ..typing import Array, Index, Mask

FEASIBLE = 1e-9
"""Share of the right-hand side by which an inequality may be missed before it counts as violated."""

ROUNDED = 1e-5
"""Share of the answer's distance from the free minimum by which it may miss an inequality."""


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """Minimiser x (m,), and which inequalities (k,) hold it back."""

    x: Array
    active: Mask


def constrained_least_squares(matrix: Array, right: Array, rows: Array, bounds: Array) -> LeastSquares | None:
    """min |matrix x - right| subject to rows x >= bounds, or None where no x satisfies these.

    Lawson and Hanson, Solving Least Squares Problems (1974), chapter 23: a QR factorisation makes it a problem of least
    distance, whose dual is a non-negative least-squares problem (`scipy.optimize.nnls`).

    Args:
        matrix: (r, m) of full column rank.   right: (r,).
        rows: (k, m).   bounds: (k,); -inf where there is none.
    """
    m = matrix.shape[1]
    # LAPACK itself: for matrices as small as these, NumPy takes longer to call it than it takes.
    factor = scipy.linalg.lapack.dgeqrf(np.column_stack([matrix, right]))[0][
        :m
    ]  # below the diagonal is what is not read
    r, free = factor[:, :m], factor[:, m]
    x, none = _solve(r, free), np.zeros(len(bounds), dtype=bool)
    missed = bounds - rows @ x
    if missed.max(initial=0.0) <= 0:
        return LeastSquares(x, none)
    kept = np.isfinite(bounds).nonzero()[0]
    cone = _solve(r, rows[kept].T, transposed=True).T
    if (told := _by_pivots(cone, missed[kept])) is not None:
        none[kept[told[1]]] = True
        return LeastSquares(_solve(r, free + told[0]), none)
    length, gap = np.sqrt((cone * cone).sum(1)), missed[kept]
    idle = length <= 1e-14 * max(1.0, length.max(initial=0.0))
    if idle.any():
        if (gap[idle] > FEASIBLE).any():
            return None
        kept, cone, length, gap = kept[~idle], cone[~idle], length[~idle], gap[~idle]
    gap, cone = gap / length, cone / length[:, None]
    scale = float(gap.max(initial=0.0))
    if scale <= 0:
        return LeastSquares(x, none)
    # Least |y| with cone y >= gap / scale: y is the residual of the dual over its last entry.
    dual, last = np.empty((m + 1, len(gap))), np.zeros(m + 1)
    dual[:m], dual[m], last[m] = cone.T, gap / scale, 1.0
    weights, _ = scipy.optimize.nnls(dual, last, maxiter=50 * len(gap))
    residual = dual @ weights
    residual[-1] -= 1.0
    if -residual[-1] <= FEASIBLE:
        return None
    y = -scale * residual[:-1] / residual[-1]
    x = _solve(r, free + y)
    # Where next to nothing satisfies them all, the dual is told by rounding.
    if (bounds[kept] - rows[kept] @ x > ROUNDED * length * math.sqrt(y @ y)).any():
        return None
    active = none.copy()
    active[kept[weights > 0]] = True
    return LeastSquares(x, active)


def _by_pivots(cone: Array, gap: Array) -> tuple[Array, Index] | None:
    """Least |y| (m,) with cone y >= gap, and which rows hold it: those that y = 0 violates, less those that would push
    the wrong way, and so on (Hintermueller, Ito and Kunisch, SIAM J. Optim. 13 (2002)). What it ends with is exact;
    None where it does not end at once, as where rows depend on each other."""
    held = gap > 0
    most = 1e-12 * gap.max(initial=0.0)  # by which rows that are held may be missed, by rounding
    for _ in range(4):  # beyond, all rows are looked at as one problem
        rows = held.nonzero()[0]
        face = cone[rows]
        if not 0 < len(rows) <= cone.shape[1]:
            return None
        _, weights, failed = scipy.linalg.lapack.dposv(face @ face.T, gap[rows])
        if failed:
            return None
        y = weights @ face
        push = gap - cone @ y > most
        if push[rows].any():  # rounding
            return None
        push[rows] = weights > 0
        if (push == held).all():
            return y, rows
        held = push
    return None


def _solve(r: Array, right: Array, *, transposed: bool = False) -> Array:
    """Solution of an upper triangular system."""
    return np.asarray(scipy.linalg.lapack.dtrtrs(r, right, trans=int(transposed))[0])
