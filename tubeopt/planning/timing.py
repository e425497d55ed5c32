"""The fastest motion along a path of joint values: as fast as rates, accelerations and the speed of the tip allow.

Along q(s), with b = (ds/dt)^2 and u = d^2 s / dt^2 = b' / 2,

    |q_s| sqrt(b) <= rate,    |q_s u + q_ss b| <= acceleration,

which is linear in (b, u). Between the points of a grid u is constant, so that b is linear. Backwards from the end it is
told how large b may be so that the rest can still be passed; forwards u is then as large as it may be (Pham and Pham
2018). At rest at both ends: b is 0 there, or q_s is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from ..typing import Array
from .motion import Motion

CELLS = 100, 500
"""Cells of the first grid, evenly spaced, and of the second, on which they take the same time, beside the knots."""

BESIDE = 1e-9
"""Share of a cell beside its ends at which second derivatives, which may jump there, are taken."""

PRUDENCE = 0.9995, 0.995
"""Share of the rates and of the accelerations that is used, for what lies between the points of the grid."""

SAME = 1e-9
"""Share of a curve below which two points of the grid are one."""

TINY = 1e-12

Tips = Callable[[Array], Array]
"""Tips (k, 3), m, at joint values (k, m)."""


@dataclass(frozen=True, eq=False)
class Limits:
    """rate, acceleration (m,) of the joints; tip: greatest speed of the tip, m/s, and where it is."""

    rate: Array
    acceleration: Array
    tip: tuple[float, Tips] | None = None


def at_full_speed(motion: Motion, limits: Limits) -> Motion:
    """A motion from rest to rest, along the same curve, as fast as limits allow."""
    if motion.duration == 0:
        return motion
    return _along(scipy.interpolate.CubicHermiteSpline(motion.time, motion.joints, motion.rates), motion.time, limits)


def stopping_at(ways: Sequence[Array], limits: Limits) -> Motion:
    """The fastest motion along curves of joint values, each a table (k, m) of evenly spaced points, at rest where they
    meet."""
    parts = [_along(rounded(way), np.linspace(0, 1, len(way)), limits) for way in ways]
    began = np.cumsum([0.0, *(part.duration for part in parts)])
    time = [parts[0].time, *(part.time[1:] + start for part, start in zip(parts[1:], began[1:-1], strict=True))]
    joints, rates = (
        np.concatenate([getattr(parts[0], name), *(getattr(part, name)[1:] for part in parts[1:])])
        for name in ("joints", "rates")
    )
    return Motion(np.concatenate(time), joints, rates)


def through(q: Array, scale: Array, limits: Limits, spacing: float | None = None) -> Motion:
    """The fastest motion close to a path of joint values (k, m), at rest at both ends: rounded at points `spacing` (in
    units of the scales) apart, or else closely."""
    step = np.linalg.norm(np.diff(q / scale, axis=0), axis=1)
    mark = np.concatenate([[0.0], np.cumsum(step)])
    if not mark[-1] > 1e-9:
        return Motion(np.zeros(1), q[:1], np.zeros_like(q[:1]))
    count = max(100, 4 * len(q)) if spacing is None else max(8, int(np.ceil(mark[-1] / spacing)) + 1)
    even = np.linspace(0, mark[-1], count)
    return stopping_at([np.column_stack([np.interp(even, mark, column) for column in q.T])], limits)


def rounded(table: Array) -> scipy.interpolate.BSpline:
    """A smooth curve over [0, 1] close to evenly spaced points (k, m).

    The cubic B-spline whose control points lie on the polyline: it begins and ends at its ends, and stays within the
    hull of neighbouring points, so that whatever ranges and order these keep, it keeps.
    """
    count = max(8, len(table))
    knots = np.concatenate([np.zeros(3), np.linspace(0, 1, count - 2), np.ones(3)])
    places = np.array([knots[k + 1 : k + 4].mean() for k in range(count)])
    x = np.linspace(0, 1, len(table))
    control = np.column_stack([np.interp(places, x, column) for column in table.T])
    return scipy.interpolate.BSpline(knots, control, 3)


def _along(curve: scipy.interpolate.BSpline | scipy.interpolate.PPoly, knots: Array, limits: Limits) -> Motion:
    """The fastest motion along a curve over the range of its knots."""
    s = np.union1d(knots, np.linspace(knots[0], knots[-1], CELLS[0]))
    b = _Program.of(curve, s, limits).largest()
    time = _time(s, b)
    s = np.union1d(knots, np.interp(np.linspace(0, time[-1], CELLS[1]), time, s))
    s = s[np.append(np.diff(s) > SAME * (s[-1] - s[0]), True)]
    b = _Program.of(curve, s, limits).largest()
    time = _time(s, b)
    return Motion(time, curve(s), curve.derivative()(s) * np.sqrt(b)[:, None])


def _time(s: Array, b: Array) -> Array:
    """(N + 1,) seconds at which the points of a grid are passed."""
    pace = np.sqrt(b)
    return np.concatenate([[0.0], np.cumsum(2 * np.diff(s) / np.maximum(pace[1:] + pace[:-1], TINY))])


@dataclass(frozen=True, eq=False)
class _Program:
    """Of N cells: lengths h (N,); rows (N, r) and right-hand sides (r,), row_u u + row_b b <= right, of b at the begin
    of each; and the greatest b (N + 1,)."""

    h: Array
    row_u: Array
    row_b: Array
    right: Array
    most: Array

    @staticmethod
    def of(curve: scipy.interpolate.BSpline | scipy.interpolate.PPoly, s: Array, limits: Limits) -> _Program:
        """That of a curve on a grid s (N + 1,)."""
        h = np.diff(s)
        slope, bend = curve.derivative(), curve.derivative(2)
        first, last = s[:-1] + BESIDE * h, s[1:] - BESIDE * h
        force = PRUDENCE[1] * limits.acceleration
        # At the end of a cell b has grown by 2 h u.
        at_end = slope(last) + 2 * h[:, None] * bend(last)
        row_u = np.concatenate([slope(first), at_end], axis=1) / np.tile(force, 2)
        row_b = np.concatenate([bend(first), bend(last)], axis=1) / np.tile(force, 2)
        row_u, row_b = (np.concatenate([rows, -rows], axis=1) for rows in (row_u, row_b))
        along = np.abs(slope(np.stack([s[:-1], (s[:-1] + s[1:]) / 2, s[1:]]))).max(0)
        pace = (along / (PRUDENCE[0] * limits.rate)).max(1)
        if limits.tip is not None:
            speed, tips = limits.tip
            way = np.linalg.norm(np.diff(tips(curve(s)), axis=0), axis=1) / h
            pace = np.maximum(pace, way / (PRUDENCE[0] * speed))
        most = 1 / np.maximum(np.append(pace, 0.0), np.append(0.0, pace)).clip(TINY) ** 2
        # What does not move there is at rest however fast s is.
        moving = np.abs(slope(s[[0, -1]]) / limits.rate).max(1) * np.sqrt(most[[0, -1]]) > 1e-6
        most[[0, -1]] = np.where(moving, 0.0, most[[0, -1]])
        return _Program(h, row_u, row_b, np.ones(row_u.shape[1]), most)

    def largest(self) -> Array:
        """(N + 1,) the largest b."""
        most = self.most.copy()
        for k in reversed(range(len(self.h))):
            most[k] = min(most[k], self._controllable(k, most[k + 1]))
        b = most.copy()
        for k in range(len(self.h)):
            b[k + 1] = min(most[k + 1], max(0.0, b[k] + 2 * self.h[k] * self._hardest(k, b[k])))
        return b

    def _rows(self, k: int, after: float) -> tuple[Array, Array, Array]:
        """Those of a cell, with 0 <= b + 2 h u <= after."""
        grown = 2 * self.h[k]
        return (
            np.append(self.row_u[k], [grown, -grown]),
            np.append(self.row_b[k], [1.0, -1.0]),
            np.append(self.right, [after, 0.0]),
        )

    def _controllable(self, k: int, after: float) -> float:
        """The largest b for which some u is allowed. Lines in b bound u from both sides, and rest is allowed."""
        row_u, row_b, right = self._rows(k, after)
        up, down = row_u > TINY, row_u < -TINY
        level = ~(up | down) & (row_b > TINY)
        most = float((right[level] / row_b[level]).min(initial=np.inf))
        slope, bound = row_b / np.where(up | down, row_u, 1.0), right / np.where(up | down, row_u, 1.0)
        falls = slope[up][:, None] - slope[down]
        room = bound[up][:, None] - bound[down]
        tight = falls > 0
        return min(most, float((np.maximum(room[tight], 0.0) / falls[tight]).min(initial=np.inf)))

    def _hardest(self, k: int, b: float) -> float:
        """The largest u that is allowed with b."""
        row_u, row_b, right = self.row_u[k], self.row_b[k], self.right
        up = row_u > TINY
        return float(((right[up] - row_b[up] * b) / row_u[up]).min(initial=np.inf))
