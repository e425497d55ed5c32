"""Small least squares with linear inequalities by the compiled kernel."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...robots.robot import Robot
from ...typing import Array, Index
from .binding import kernel_of


class CompiledLeastSquares:
    """The function of a kernel, for as many variables as its robots have joints, with what it works in: of one
    thread."""

    def __init__(self, solve: Any) -> None:
        self._solve = solve
        self._room(1024)

    def _room(self, size: int) -> None:
        """Memory whose place is known: to ask NumPy for it takes as long as a solve."""
        self._memory, self._numbers = np.zeros(size), np.zeros(size, dtype=np.int64)
        self._places = self._memory.ctypes.data, self._numbers.ctypes.data

    def __call__(self, matrix: Array, right: Array, rows: Array, bounds: Array) -> tuple[Array, Index] | None:
        """The minimiser (n,) of |matrix x - right| with rows x >= bounds, and the numbers of the rows that hold it;
        None where no x keeps them. Of a matrix (r, n) of full rank, n at most the joints of the kernel's robots."""
        count, n = matrix.shape
        k = len(bounds)
        used = n + count * (n + 1) + k * (n + 1)
        if len(self._memory) < used + k:
            self._room(2 * (used + k))
        np.concatenate([matrix.ravel(), right, rows.ravel(), bounds], out=self._memory[n:used])
        place, numbers = self._places
        held = self._solve(n, count, k, place + 8 * n, place, numbers)
        return None if held < 0 else (self._memory[:n].copy(), self._numbers[:held].copy())


def least_squares_of(robot: Robot) -> CompiledLeastSquares | None:
    """That of the kernel of a robot; None where it has none."""
    kernel = kernel_of(robot)
    return None if kernel is None else CompiledLeastSquares(kernel.functions.constrained)
