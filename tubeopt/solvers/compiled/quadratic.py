"""Least squares with linear inequalities, small and dense: the quadratic program behind every constrained step.

The compiled kernel solves it by the dual method of Goldfarb and Idnani (`quadratic.c`), which the C library of
a servo includes too. Without a kernel, and for more variables than it has room for, it is a problem of least distance
for SciPy's non-negative least squares.
"""

from __future__ import annotations

import ctypes
import math
import threading
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
import scipy

from ...typing import Array, Index
from .library import MOST_TUBES, kernel_path, open_library
from .text import c_text

MOST_VARIABLES = 4 * MOST_TUBES
"""Largest number of variables, twice the joints of the largest robot with a kernel; SciPy solves larger problems."""

FEASIBLE = 1e-9
"""Allowed violation of an inequality as a fraction of its right-hand side."""

ROUNDED = 1e-5
"""Allowed violation of an inequality as a fraction of the solution's distance from the free minimum."""


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """Minimiser x (m,), and the indices of the active inequalities."""

    x: Array
    active: Index


def constrained_least_squares(matrix: Array, right: Array, rows: Array, bounds: Array) -> LeastSquares | None:
    """Minimum of |matrix x - right| subject to rows x >= bounds; None if no x satisfies the bounds.

    Args:
        matrix: (r, m) of full column rank.   right: (r,).
        rows: (k, m).   bounds: (k,); -inf if there is none.
    """
    compiled = compiled_least_squares() if matrix.shape[1] <= MOST_VARIABLES else None
    if compiled is None:
        return by_least_distance(matrix, right, rows, bounds)
    result = compiled(matrix, right, rows, bounds)
    return None if result is None else LeastSquares(*result)


def by_least_distance(matrix: Array, right: Array, rows: Array, bounds: Array) -> LeastSquares | None:
    """Constrained least squares by `scipy.optimize.nnls`.

    Method: Lawson and Hanson, Solving Least Squares Problems (1974), chapter 23.

    A QR factorisation makes it a problem of least distance, whose dual is a non-negative least-squares problem.
    """
    m = matrix.shape[1]
    q, r = np.linalg.qr(matrix)
    x = scipy.linalg.solve_triangular(r, q.T @ right)
    kept = np.isfinite(bounds).nonzero()[0]
    cone = scipy.linalg.solve_triangular(r, rows[kept].T, trans=1).T
    length, slack = np.linalg.norm(cone, axis=1), (bounds - rows @ x)[kept]
    idle = length <= 1e-14 * length.max(initial=0.0)
    if (bounds[kept[idle]] > FEASIBLE).any():
        return None
    kept, cone, slack, length = kept[~idle], cone[~idle], slack[~idle], length[~idle]
    slack, cone = slack / length, cone / length[:, None]
    scale = float(slack.max(initial=0.0))
    if scale <= 0:
        return LeastSquares(x, np.zeros(0, dtype=int))
    # Least |y| with cone y >= gap / scale: y is the residual of the dual over its last entry.
    dual, last = np.vstack([cone.T, slack / scale]), np.append(np.zeros(m), 1.0)
    weights, _ = scipy.optimize.nnls(dual, last, maxiter=50 * len(slack))
    residual = dual @ weights - last
    if -residual[-1] <= FEASIBLE:
        return None
    y = -scale * residual[:-1] / residual[-1]
    x = x + scipy.linalg.solve_triangular(r, y)
    # Where next to nothing satisfies them all, rounding decides the dual.
    if (bounds[kept] - rows[kept] @ x > ROUNDED * length * math.sqrt(y @ y)).any():
        return None
    return LeastSquares(x, kept[weights > 0])


# --- compiled kernel --------------------------------------------------------------------------------------------------


def quadratic_source() -> str:
    """C text of the kernel."""
    return c_text({"N": MOST_VARIABLES // 2}, ca.CodeGenerator("program.c"), "program.c")


class CompiledLeastSquares:
    """Function of the kernel with its memory, for one thread."""

    def __init__(self, solve: Any) -> None:
        self._solve = solve
        self._allocate(1024)

    def _allocate(self, size: int) -> None:
        """Allocate memory with a known address, since NumPy needs as long for an address as a solve takes."""
        self._memory, self._numbers = np.zeros(size), np.zeros(MOST_VARIABLES, dtype=np.int64)
        self._addresses = self._memory.ctypes.data, self._numbers.ctypes.data

    def __call__(self, matrix: Array, right: Array, rows: Array, bounds: Array) -> tuple[Array, Index] | None:
        """Minimiser x (n,) of |matrix x - right| subject to rows x >= bounds, and the indices of the active rows.

        None if no x satisfies the rows. The matrix (r, n) must have full rank, with n at most MOST_VARIABLES.
        """
        count, n = matrix.shape
        k = len(bounds)
        used = n + count * (n + 1) + k * (n + 1)
        if len(self._memory) < used + k:
            self._allocate(2 * (used + k))
        np.concatenate([matrix.ravel(), right, rows.ravel(), bounds], out=self._memory[n:used])
        memory, numbers = self._addresses
        active = self._solve(n, count, k, memory + 8 * n, memory, numbers)
        return None if active < 0 else (self._memory[:n].copy(), self._numbers[:active].copy())


@lru_cache(maxsize=1)
def _kernel() -> Any:
    """Loaded function; None without a kernel."""
    path = kernel_path((0, "quadratic"), quadratic_source)
    loaded = None if path is None else open_library(path)
    if loaded is None:
        return None
    loaded.constrained.argtypes = [ctypes.c_longlong] * 3 + [ctypes.c_void_p] * 3
    return loaded.constrained


_of_thread = threading.local()


def compiled_least_squares() -> CompiledLeastSquares | None:
    """Function of this thread; None without a kernel."""
    if "solve" not in _of_thread.__dict__:
        kernel = _kernel()
        _of_thread.solve = None if kernel is None else CompiledLeastSquares(kernel)
    solve: CompiledLeastSquares | None = _of_thread.solve
    return solve
