"""Compiled kernel of small least-squares problems with linear inequalities, for all robots."""

from __future__ import annotations

import ctypes
import threading
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from ...typing import Array, Index
from .library import MOST_TUBES, kernel_path, open_library
from .text import c_text

MOST_VARIABLES = 4 * MOST_TUBES
"""Largest number of variables, twice the joints of the largest robot with a kernel; SciPy solves larger problems."""


def quadratic_source() -> str:
    """C text of the kernel."""
    return c_text({"N": MOST_VARIABLES // 2}, ca.CodeGenerator("program.c"), "program.c")


class CompiledLeastSquares:
    """Function of the kernel with its memory, for one thread."""

    def __init__(self, solve: Any) -> None:
        self._solve = solve
        self._allocate(1024)

    def _allocate(self, size: int) -> None:
        """Allocate memory with a known address: NumPy takes as long for an address as a solve."""
        self._memory, self._numbers = np.zeros(size), np.zeros(MOST_VARIABLES, dtype=np.int64)
        self._addresses = self._memory.ctypes.data, self._numbers.ctypes.data

    def __call__(self, matrix: Array, right: Array, rows: Array, bounds: Array) -> tuple[Array, Index] | None:
        """Minimiser x (n,) of |matrix x - right| with rows x >= bounds, and the numbers of the active rows.

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
    """Loaded function; None if there is no kernel."""
    path = kernel_path((0, "quadratic"), quadratic_source)
    loaded = None if path is None else open_library(path)
    if loaded is None:
        return None
    loaded.constrained.argtypes = [ctypes.c_longlong] * 3 + [ctypes.c_void_p] * 3
    return loaded.constrained


_of_thread = threading.local()


def compiled_least_squares() -> CompiledLeastSquares | None:
    """Function of this thread; None if there is no kernel."""
    if "solve" not in _of_thread.__dict__:
        kernel = _kernel()
        _of_thread.solve = None if kernel is None else CompiledLeastSquares(kernel)
    solve: CompiledLeastSquares | None = _of_thread.solve
    return solve
