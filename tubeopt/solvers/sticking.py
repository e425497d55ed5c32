"""What sticks and what slips: a convex quadratic program with a bound on every multiplier.

Rows of friction with a compliance A (positive definite), free slips b (what they would slip if nothing rubbed) and
capacities D bear torques lam and slip by v = b - A lam so that

    |lam| <= D,     v = 0 where |lam| < D,     v has the sign of lam where |lam| = D.

Solved by block principal pivoting: all rows of the wrong kind change at once, and one at a time, the last, where that
goes in circles (Judice and Pires, Computers & Operations Research 21 (1994)), which ends with the solution, since A is a
P-matrix. It begins with every row slipping as if nothing rubbed; from all rows sticking it would go row by row.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from ..typing import Array

Signs = NDArray[np.int8]

PATIENCE = 8
"""Exchanges of whole blocks without fewer wrong rows, after which rows change one at a time."""

MOST_EXCHANGES = 20
"""Exchanges per row, after which another algorithm takes over."""

ROUND_OFF = 1e-12
"""Slip (rad) and part of the capacity that are round-off."""


def stick_or_slip(compliance: Array, free: Array, capacity: Array, start: Signs) -> tuple[Array, Signs] | None:
    """Torques (R,) and for every row the sign of its slip, 0 where it sticks; None where exchanges find no end.

    Args:
        compliance: (R, R).   free: (R,) slips without friction.   capacity: (R,), above 0.   start: (R,) first guess.
    """
    signs, fewest, patience = start.copy(), len(free) + 1, PATIENCE
    for _ in range(MOST_EXCHANGES * (len(free) + 1)):
        torque = capacity * signs
        stuck = np.flatnonzero(signs == 0)
        slip = free - compliance @ torque
        if len(stuck):
            torque[stuck], failed = _solve(compliance[np.ix_(stuck, stuck)], slip[stuck])
            if failed:
                return None
            slip -= compliance[:, stuck] @ torque[stuck]
            slip[stuck] = 0.0
        over = (signs == 0) & (np.abs(torque) > capacity * (1 + ROUND_OFF))
        back = slip * signs < -ROUND_OFF
        wrong = over | back
        count = int(np.count_nonzero(wrong))
        if not count:
            return torque, signs
        if count < fewest:
            fewest, patience = count, PATIENCE
        elif patience:
            patience -= 1
        else:
            wrong[: int(np.flatnonzero(wrong)[-1])] = False
        signs[wrong & back] = 0
        signs[wrong & over] = np.sign(torque[wrong & over])
    return None


def _solve(matrix: Array, right: Array) -> tuple[Array, bool]:
    """Solution of a symmetric system, by Cholesky where it is positive definite; whether it is singular."""
    _, x, failed = scipy.linalg.lapack.dposv(matrix, right)
    if failed:
        _, _, x, failed = scipy.linalg.lapack.dsysv(matrix, right)
    return x, failed != 0


def stick_or_slip_by_descent(compliance: Array, free: Array, capacity: Array) -> tuple[Array, Signs]:
    """The same from the dual program, least 1/2 lam' A lam - b' lam within the capacities: every step of the active set
    goes down, so that it ends (Stark and Parker, Computational Statistics 10 (1995), as SciPy has it)."""
    root = np.linalg.cholesky(compliance).T
    target = scipy.linalg.solve_triangular(root, free, trans="T")
    bounds = (-capacity, capacity)
    torque = scipy.optimize.lsq_linear(root, target, bounds, method="bvls", tol=1e-15, max_iter=100 * len(free)).x
    signs = np.where(np.abs(torque) >= capacity * (1 - ROUND_OFF), np.sign(torque), 0.0)
    return torque, signs.astype(np.int8)
