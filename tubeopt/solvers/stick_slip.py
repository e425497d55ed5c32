"""What sticks and what slips: a convex quadratic program with a bound on every multiplier.

Rows of friction with a compliance A (positive definite), free slips b (what they would slip if nothing rubbed) and
capacities D bear torques lam and slip by v = b - A lam so that

    |lam| <= D,     v = 0 where |lam| < D,     v has the sign of lam where |lam| = D.

Block principal pivoting exchanges all rows of the wrong kind at once (Judice and Pires, Computers & Operations Research
21 (1994)), from all rows slipping as if nothing rubbed; from all rows sticking it would go row by row. Where that goes
in circles, the dual program, least 1/2 lam' A lam - b' lam within the capacities, is solved from there by an active set
that goes down with every step, and so ends.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from ..typing import Array
from .settings import STICK_CHANGES

Signs = NDArray[np.int8]

ROUND_OFF = 1e-12
"""Slip (rad) and part of the capacity that are round-off."""

# Block pivoting may cycle. Judice and Pires switch to single exchanges after ten such rounds; here the descent, which
# cannot cycle, is as fast, so that four are enough.
STICK_PATIENCE = 4
"""Exchanges between sticking and slipping without fewer wrong rows, after which pivoting counts as cycling."""


def stick_or_slip(
    compliance: Array, free: Array, capacity: Array, start: Signs, *, convex: bool = True
) -> tuple[Array, Signs] | None:
    """Torques (R,) and for every row the sign of its slip, 0 where it sticks; None where none were found, which only
    round-off can do where A is positive definite.

    Args:
        compliance: (R, R).   free: (R,) slips without friction.   capacity: (R,), above 0.   start: (R,) first guess.
        convex: whether A is positive definite.
    """
    signs, fewest, patience = start.copy(), len(free) + 1, STICK_PATIENCE
    while True:
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
        count = int(np.count_nonzero(over | back))
        if not count:
            return torque, signs
        patience = STICK_PATIENCE if count < fewest else patience - 1
        if patience < 0:
            return _by_descent(compliance, free, capacity, torque) if convex else None
        fewest = min(fewest, count)
        signs[back] = 0
        signs[over] = np.sign(torque[over])


def _by_descent(compliance: Array, free: Array, capacity: Array, near: Array) -> tuple[Array, Signs] | None:
    """The same from torques (R,) nearby: those inside go down to their least, then the one is freed that gains most."""
    torque = np.clip(near, -capacity, capacity)
    inside = np.abs(torque) < capacity
    for _ in range(STICK_CHANGES * (len(free) + 1)):
        rows = np.flatnonzero(inside)
        if len(rows):
            rest = free[rows] - compliance[rows] @ (torque * ~inside)
            target, failed = _solve(compliance[np.ix_(rows, rows)], rest)
            if failed:
                return None
            move, room = target - torque[rows], np.full(len(rows), np.inf)
            ahead = move != 0
            room[ahead] = (np.copysign(capacity[rows], move) - torque[rows])[ahead] / move[ahead]
            first = int(np.argmin(room))
            if room[first] < 1:
                torque[rows] += room[first] * move
                torque[rows[first]] = np.copysign(capacity[rows[first]], move[first])
                inside[rows[first]] = False
                continue
            torque[rows] = target
        wrong = np.where(inside, 0.0, -np.sign(torque) * (free - compliance @ torque))
        worst = int(np.argmax(wrong)) if len(wrong) else 0
        if not len(wrong) or wrong[worst] <= ROUND_OFF:
            return torque, np.where(inside, 0, np.sign(torque)).astype(np.int8)
        inside[worst] = True
    return None


def _solve(matrix: Array, right: Array) -> tuple[Array, bool]:
    """Solution of a symmetric system, by Cholesky where it is positive definite; whether it is singular."""
    _, x, failed = scipy.linalg.lapack.dposv(matrix, right)
    if failed:
        _, _, x, failed = scipy.linalg.lapack.dsysv(matrix, right)
    return x, failed != 0
