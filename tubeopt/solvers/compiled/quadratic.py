"""Small least squares with linear inequalities, compiled: one kernel for all robots."""

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
"""Twice the joints of the largest robot that has a kernel; more go to SciPy."""


def quadratic_source() -> str:
    """The C text of the kernel."""
    return c_text({"N": MOST_VARIABLES // 2}, ca.CodeGenerator("program.c"), "program.c")


class CompiledLeastSquares:
    """The function of the kernel with its memory: of one thread."""

    def __init__(self, solve: Any) -> None:
        self._solve = solve
        self._room(1024)

    def _room(self, size: int) -> None:
        """Memory whose place is known: to ask NumPy for it takes as long as a solve."""
        self._memory, self._numbers = np.zeros(size), np.zeros(MOST_VARIABLES, dtype=np.int64)
        self._places = self._memory.ctypes.data, self._numbers.ctypes.data

    def __call__(self, matrix: Array, right: Array, rows: Array, bounds: Array) -> tuple[Array, Index] | None:
        """The minimiser (n,) of |matrix x - right| with rows x >= bounds, and the numbers of the rows that hold it;
        None where no x keeps them. Of a matrix (r, n) of full rank, n at most MOST_VARIABLES."""
        count, n = matrix.shape
        k = len(bounds)
        used = n + count * (n + 1) + k * (n + 1)
        if len(self._memory) < used + k:
            self._room(2 * (used + k))
        np.concatenate([matrix.ravel(), right, rows.ravel(), bounds], out=self._memory[n:used])
        place, numbers = self._places
        held = self._solve(n, count, k, place + 8 * n, place, numbers)
        return None if held < 0 else (self._memory[:n].copy(), self._numbers[:held].copy())


@lru_cache(maxsize=1)
def _kernel() -> Any:
    """The loaded function; None where there is no kernel."""
    path = kernel_path((0, "quadratic"), quadratic_source)
    loaded = None if path is None else open_library(path)
    if loaded is None:
        return None
    loaded.constrained.argtypes = [ctypes.c_longlong] * 3 + [ctypes.c_void_p] * 3
    return loaded.constrained


_own = threading.local()


def compiled_least_squares() -> CompiledLeastSquares | None:
    """That of this thread; None where there is no kernel."""
    if "solve" not in _own.__dict__:
        kernel = _kernel()
        _own.solve = None if kernel is None else CompiledLeastSquares(kernel)
    found: CompiledLeastSquares | None = _own.solve
    return found
