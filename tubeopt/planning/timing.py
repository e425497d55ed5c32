"""The fastest motion along a path of joint values: as fast as rates, accelerations and the speed of the tip allow.

Along q(s), with b = (ds/dt)^2 and u = d^2 s / dt^2 = b' / 2,

    |q_s| sqrt(b) <= rate,    |q_s u + q_ss b| <= acceleration,

which is linear in (b, u). Between the points of a grid u is constant, so that b is linear, and q is cubic: both sides
are quadratic in s there, and the hull of their Bezier coefficients bounds them, so that rates and accelerations of the
joints are kept at all times and not only on the grid. Backwards from the end it is told how large b may be so that the
rest can still be passed; forwards u is then as large as it may be (Pham and Pham 2018). At rest at both ends: b is 0
there, or q_s is. The motion is that curve itself, a polynomial of time in every cell.

The speed of the tip is that of the equilibria on the branch of the start. They also show where a motion loses what a
plan must keep: `track` follows them, `violated` finds the places.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy
from scipy.interpolate import PPoly

from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import SolveError
from ..inverse.arm_surface import ArmSurface
from ..inverse.clock import Clock
from ..typing import Array, Index, Mask
from .motion import INSTANT, MIN_SAMPLES_OF_TIP, SAMPLE_STEP, Motion
from .question import PlanTask

# The first grid finds where the motion is slow, and the second has its cells there. Measured on six plans: with half
# or twice as many cells durations differ by less than 1e-4. TOPP-RA of the package toppra (500 cells) takes 1.000 to
# 1.005 times as long on the same curves, but its accelerations exceed their limits by up to 38 % between grid points.
CELLS, FINE_CELLS = 100, 500
"""Cells of the first grid of a curve, evenly spaced, and of the second, of equal durations."""

# `motion.too_fast` allows rates 1e-6 and accelerations 1e-3 beyond their limits. The price is 0.05 % of the duration.
RATE_SAFETY_FACTOR = 0.9995
"""Safety factor on the rate limits: tip speed is only checked on a grid, and the ends of a motion are made exact."""

# Near a fold joint values run fast along a straight motion in tip rotations.
MOST_HALVINGS, MOST_BEND = 4, 0.02
"""Times that points of a path are set twice as close at most, and the second difference of joint values, in units of
their scales, at which rounded curves stay close enough to the points."""

# It exceeds the error between samples, and falls with the square of their distance.
RESERVE = 1e-5
"""Reserve of the margin (and of the clearance, m) at the largest sample distance."""

# Samples lie up to 0.04 apart.
OTHER_BRANCH = 0.1
"""Distance from a point of the chart, in units of the scales, beyond which an equilibrium is on another branch."""

SAME = 1e-9
"""Share of a curve below which two points of the grid are one."""

TINY = 1e-12

FAR = 1e100
"""More than any b."""

SHORTEST = 1e-3
"""s, the cycle of a usual control loop, that a motion takes at least: over shorter times the round-off of joint values
looks like an acceleration."""

Tips = Callable[[Array], Array]
"""Tips (k, 3), m, at joint values (k, m)."""


@dataclass(frozen=True, eq=False)
class Limits:
    """How fast joints and tip may be."""

    rate: Array
    """(m,) of the joints."""
    acceleration: Array
    """(m,) of the joints."""
    tip: tuple[float, Tips] | None = None
    """Greatest speed of the tip, m/s, and where it is."""


def at_full_speed(motion: Motion, limits: Limits) -> Motion:
    """A motion from rest to rest, along the same curve, as fast as limits allow."""
    return motion if motion.duration < INSTANT else _along([motion.curve], limits)[0]


def stopping_at(ways: Sequence[Array], limits: Limits) -> Motion:
    """The fastest motion along curves of joint values, each a table (k, m) of evenly spaced points, at rest where they
    meet."""
    parts = _along([rounded(way) for way in ways], limits)
    began = np.cumsum([0.0, *(part.duration for part in parts)])
    time = [parts[0].time, *(part.time[1:] + start for part, start in zip(parts[1:], began[1:-1], strict=True))]
    powers = np.concatenate([part.curve.c for part in parts], axis=1)
    return Motion(PPoly(powers, np.concatenate(time)), parts[0].tip_limited)


def through(q: Array, scale: Array, limits: Limits, spacing: float | None = None) -> Motion:
    """The fastest motion close to a path of joint values (k, m), at rest at both ends: rounded at points `spacing` (in
    units of the scales) apart, or else closely."""
    step = np.linalg.norm(np.diff(q / scale, axis=0), axis=1)
    mark = np.concatenate([[0.0], np.cumsum(step)])
    if not mark[-1] > 1e-9:
        return Motion.resting(q[0])
    count = max(100, 4 * len(q)) if spacing is None else max(8, int(np.ceil(mark[-1] / spacing)) + 1)
    even = np.linspace(0, mark[-1], count)
    return stopping_at([np.column_stack([np.interp(even, mark, column) for column in q.T])], limits)


def rounded(table: Array) -> PPoly:
    """A smooth curve over [0, 1] close to evenly spaced points (k, m).

    The cubic B-spline whose control points lie on the polyline: it begins and ends at its ends, and stays within the
    hull of neighbouring points, so that whatever ranges and order these keep, it keeps.
    """
    count = max(8, len(table))
    knots = np.concatenate([np.zeros(3), np.linspace(0, 1, count - 2), np.ones(3)])
    # Greville's abscissae: with control points there a B-spline reproduces straight lines.
    places = np.array([knots[k + 1 : k + 4].mean() for k in range(count)])
    x = np.linspace(0, 1, len(table))
    control = np.column_stack([np.interp(places, x, column) for column in table.T])
    curve, inner = scipy.interpolate.BSpline(knots, control, 3), knots[3:-3]
    terms = [curve(inner[:-1], nu=order) / math.factorial(order) for order in (3, 2, 1, 0)]
    return PPoly(np.array(terms), inner)


def _along(curves: Sequence[PPoly], limits: Limits) -> list[Motion]:
    """The fastest motions along cubic curves, each of which begins where the one before ends."""
    grids = [_grid(curve, np.linspace(curve.x[0], curve.x[-1], CELLS)) for curve in curves]
    for k, (curve, s, b) in enumerate(zip(curves, grids, _largest(curves, grids, limits), strict=True)):
        time = _time(s, b)
        grids[k] = _grid(curve, np.interp(np.linspace(0, time[-1], FINE_CELLS), time, s))
    found = zip(curves, grids, _largest(curves, grids, limits), strict=True)
    motions = [_motion(curve, s, b) for curve, s, b in found]
    motions = [each.slower(max(1.0, SHORTEST / each.duration)) for each in motions]
    return motions if limits.tip is None else [replace(each, tip_limited=True) for each in motions]


def _grid(curve: PPoly, places: Array) -> Array:
    """(N + 1,) places on a curve and its knots, those that are all but the same once."""
    s = np.union1d(curve.x, places)
    apart: Array = s[np.append(np.diff(s) > SAME * (s[-1] - s[0]), True)]
    return apart


def _largest(curves: Sequence[PPoly], grids: Sequence[Array], limits: Limits) -> list[Array]:
    """(N + 1,) the largest b on every curve's grid."""
    tips: list[Array | None] = [None] * len(curves)
    if limits.tip is not None:
        # At once, since the branch is followed from the beginning of the first.
        all_tips = limits.tip[1](np.concatenate([curve(s) for curve, s in zip(curves, grids, strict=True)]))
        tips = list(np.split(all_tips, np.cumsum([len(s) for s in grids])[:-1]))
    asked = zip(curves, grids, tips, strict=True)
    return [_paced(_Program.of(curve, s, limits, tip)) for curve, s, tip in asked]


def _time(s: Array, b: Array) -> Array:
    """(N + 1,) seconds at which the points of a grid are passed."""
    pace = np.sqrt(b)
    # At constant acceleration the mean speed is the mean of both ends.
    return np.concatenate([[0.0], np.cumsum(2 * np.diff(s) / np.maximum(pace[1:] + pace[:-1], TINY))])


def _motion(curve: PPoly, s: Array, b: Array) -> Motion:
    """Along a curve with b (N + 1,) on a grid: in every cell s grows by p t + w t^2."""
    c1, c2, c3 = _terms(curve, s)
    # ds/dt begins as p = sqrt(b). d^2 s / dt^2 = b' / 2 is constant, so that w is a quarter of the slope of b.
    p, w = np.sqrt(b[:-1])[:, None], (np.diff(b) / np.diff(s) / 4)[:, None]
    # c1 x + c2 x^2 + c3 x^3 with x = p t + w t^2, by powers of t from the sixth down.
    powers = [c3 * w**3, 3 * c3 * p * w**2, c2 * w**2 + 3 * c3 * p**2 * w, 2 * c2 * p * w + c3 * p**3]
    return Motion(PPoly(np.array([*powers, c1 * w + c2 * p**2, c1 * p, curve(s[:-1])]), _time(s, b)))


def _terms(curve: PPoly, s: Array) -> tuple[Array, Array, Array]:
    """Three (N, m) of a curve in every cell of a grid that has its knots: c1 x + c2 x^2 + c3 x^3 from its begin."""
    first, second, third = (curve(s[:-1], nu=order) / math.factorial(order) for order in (1, 2, 3))
    return first, second, third


@dataclass(frozen=True, eq=False)
class _Program:
    """Of N cells: lengths h (N,); rows (N, r), |row_u u + row_b b| <= 1, of b at the begin of each; and the greatest b
    (N + 1,)."""

    h: Array
    row_u: Array
    row_b: Array
    most: Array

    @staticmethod
    def of(curve: PPoly, s: Array, limits: Limits, tip: Array | None) -> _Program:
        """That of a curve on a grid s (N + 1,), with tips (N + 1, 3) where their speed is limited."""
        h = np.diff(s)
        c1, c2, c3 = _terms(curve, s)
        long, force = h[:, None], RATE_SAFETY_FACTOR * limits.acceleration
        # Where s has grown by x, b has by 2 x u.
        # Bezier coefficients of q_s u + q_ss b = (c1 + 6 c2 x + 15 c3 x^2) u + (2 c2 + 6 c3 x) b, with b at the begin.
        row_u = [c1, c1 + 3 * c2 * long, c1 + 6 * c2 * long + 15 * c3 * long**2]
        row_b = [2 * c2, 2 * c2 + 3 * c3 * long, 2 * c2 + 6 * c3 * long]
        rows_u, rows_b = (np.concatenate(rows, axis=1) / np.tile(force, 3) for rows in (row_u, row_b))
        # Bezier coefficients of q_s, a hull of the rates.
        along = np.abs([c1, c1 + c2 * long, c1 + 2 * c2 * long + 3 * c3 * long**2]).max(0)
        pace = (along / (RATE_SAFETY_FACTOR * limits.rate)).max(1)
        if limits.tip is not None and tip is not None:
            speed = scipy.interpolate.CubicSpline(s, tip)(np.stack([s[:-1], (s[:-1] + s[1:]) / 2, s[1:]]), 1)
            # Samples are joined by straight lines: what the joints do at one time they do at those beside it.
            beside = 1 + 2 * math.ceil(len(h) / MIN_SAMPLES_OF_TIP)
            fastest = scipy.ndimage.maximum_filter1d(np.linalg.norm(speed, axis=2).max(0), beside)
            pace = np.maximum(pace, fastest / (RATE_SAFETY_FACTOR * limits.tip[0]))
        most = 1 / np.maximum(np.append(pace, 0.0), np.append(0.0, pace)).clip(TINY) ** 2
        # What does not move there is at rest however fast s is.
        moving = np.abs(curve(s[[0, -1]], nu=1) / limits.rate).max(1) * np.sqrt(most[[0, -1]]) > 1e-6
        most[[0, -1]] = np.where(moving, 0.0, most[[0, -1]])
        return _Program(h, rows_u, rows_b, most)


def _paced(program: _Program) -> Array:
    """(N + 1,) the largest b of a program: cell by cell, backwards from its end and then forwards.

    Every row is two lines between which u lies, |u + v b| <= w.
    """
    grown = 2 * program.h[:, None]  # what b grows by with u
    steep = np.abs(program.row_u) > TINY
    some = np.where(steep, program.row_u, 1.0)
    v, w = np.where(steep, program.row_b / some, 0.0), np.where(steep, 1 / np.abs(some), np.inf)
    # A row without u bounds b itself.
    level = np.where(steep, np.inf, 1 / np.maximum(np.abs(program.row_b), TINY)).min(1)
    most = np.append(np.minimum(program.most[:-1], np.minimum(level, _between(v, w, grown))), program.most[-1])
    # What the next b is at most, of a line; and back from that, where it grows with b.
    # The next b is b + grown u with u <= w - v b.
    slope, bound = 1 - grown * v, grown * w
    grows = slope > TINY
    back, more = 1 / np.where(grows, slope, 1.0), np.where(grows, bound / np.where(grows, slope, 1.0), np.inf)
    most = _least(most[::-1], back[::-1], more[::-1])[::-1]
    return _least(most, slope, bound)


def _least(most: Array, steep: Array, level: Array) -> Array:
    """(N + 1,) the largest values, none above `most` (N + 1,) nor above any of r lines over the value before it, of
    steepness and level (N, r).

    Of the lines three mostly are below all others wherever the value before can be: those that are it at 0 and at the
    most, and the one below where these meet.
    """
    rows, level = np.arange(len(level)), np.minimum(level, FAR)

    def lowest(at: Array) -> Index:
        return np.asarray((steep * at[:, None] + level).argmin(1))

    def meeting(one: Index, other: Index) -> Array:
        rise, low = (table[rows, one] - table[rows, other] for table in (steep, level))
        return np.asarray(np.where(np.abs(rise) > TINY, -low / np.where(rise == 0, 1.0, rise), 0.0)).clip(0, most[:-1])

    def above(one: Index, at: Array) -> Mask:
        """Whether another line is below one."""
        return np.asarray(steep[rows, one] * at + level[rows, one] > (steep * at[:, None] + level).min(1) * (1 + TINY))

    first, last = lowest(np.zeros(len(level))), lowest(most[:-1])
    middle = lowest(meeting(first, last))
    more = above(middle, meeting(first, middle)) | above(middle, meeting(middle, last))
    few = [(steep[rows, one].tolist(), level[rows, one].tolist()) for one in (first, middle, last)]
    (a, b), (c, d), (e, f) = few
    value, out = float(most[0]), [float(most[0])]
    for k, (top, many) in enumerate(zip(most[1:].tolist(), more.tolist(), strict=True)):
        if many:
            after = float((steep[k] * value + level[k]).min())
        else:
            after = min(a[k] * value + b[k], c[k] * value + d[k], e[k] * value + f[k])
        value = min(top, max(after, 0.0))
        out.append(value)
    return np.array(out)


def _between(v: Array, w: Array, grown: Array) -> Array:
    """(N,) the largest b for which some u with |u + v b| <= w (N, r) leaves the next b no less than 0."""
    least = np.full(len(v), np.inf)
    for k in range(v.shape[1]):
        # The intervals of u of two rows meet where |v_j - v_k| b <= w_j + w_k. The next b is not negative for u >= -b /
        # grown.
        one = v[:, k, None]
        falls = np.concatenate([np.abs(one - v[:, k + 1 :]), one - 1 / grown], axis=1)
        room = np.concatenate([w[:, k, None] + w[:, k + 1 :], w[:, k, None]], axis=1)
        np.minimum(least, np.where(falls > 0, room / np.where(falls > 0, falls, 1.0), np.inf).min(1), out=least)
    return least


# --- the robot along a motion -----------------------------------------------------------------------------------------


def joint_curves(task: PlanTask, points: Array) -> list[Array]:
    """The joint values of every straight motion of a way (k, m), evenly spaced and as close as it takes to check it."""
    out = []
    for a, b in pairwise(points):
        pieces = (len(task.line(a, b)) - 1) * 2 ** (task.fineness(a, b) or 0)
        for halvings in range(MOST_HALVINGS + 1):
            q = task.chart.joints(a + np.linspace(0, 1, 2**halvings * pieces + 1)[:, None] * (b - a))
            if np.abs(np.diff(q / task.scale, 2, axis=0)).max(initial=0.0) <= MOST_BEND:
                break
        out.append(q)
    return out


def actuators(task: PlanTask, first: Equilibrium) -> Limits:
    """What limits the speed of motions that begin at an equilibrium."""
    rates = task.rates

    def tips(q: Array) -> Array:
        """Those of the branch of the equilibrium; where it ends, the last one of it."""
        found = np.array([e.tip_position for e in track(task, first, q)])
        return np.concatenate([found, np.repeat(found[-1:], len(q) - len(found), axis=0)])

    tip = None if rates.tip is None else (rates.tip, tips)
    return Limits(*rates.of(task.chart.space), tip)


def track(task: PlanTask, start: Equilibrium, q: Array, clock: Clock | None = None) -> tuple[Equilibrium, ...]:
    """The equilibria at joint values q (T, m), as forward kinematics finds them one from the other on the branch of
    `start`: fewer than T where the branch ends, or the clock is over."""
    space, here, found = task.chart.space, start, list[Equilibrium]()
    for row in q:
        rotations, shift = space.split(row)
        try:
            # Each from the last, which keeps the branch: a cold start may find another equilibrium.
            here = forward_kinematics(space.robot, rotations, shift, load=task.chart.load, start=here)
        except SolveError:
            break
        if not here.stable or (clock is not None and clock.over):
            break
        found.append(here)
    return tuple(found)


def violated(
    task: PlanTask, start: Equilibrium, motion: Motion, clock: Clock, places: tuple[Array, Array]
) -> tuple[Mask, Array]:
    """(intervals,) where the motion between knots loses the branch, margin, or clearance; and by how much (2,) margin
    and clearance (m) fall short. `places`: times (P,) at which it has to be at points (P, m) of the chart: the same
    joint values may be led to on several branches, by ways around a fold on one side and on the other."""
    time, q = motion.sampled(task.scale)
    found = track(task, start, q, clock)
    bad = np.zeros(len(motion.time) - 1, dtype=bool)
    short = _short(task, found)
    wrong = time[: len(found)][(short > 0).any(0)]
    if len(found) < len(q):
        wrong = np.append(wrong, time[len(found)])
    else:
        first = places[0][_apart(task, time, found, places)][:1]
        wrong = np.append(wrong, np.nextafter(first, 0))  # what led there lies before it
    at = np.clip(np.searchsorted(motion.time, wrong, side="right") - 1, 0, len(bad) - 1)
    bad[at] = True
    return bad, np.maximum(short.max(1, initial=0.0), 0.0)


def _short(task: PlanTask, found: Sequence[Equilibrium]) -> Array:
    """(2, T) what margin and clearance (m) of equilibria lack of what is to be kept and to be left; 0 or less where
    nothing. Both ends are as they are."""
    joints = [task.chart.space.join(e.rotations, e.translations) for e in found]
    q = np.reshape(joints, (-1, len(task.scale))) / task.scale
    step = np.append(np.abs(np.diff(q, axis=0)).max(1), 0.0)[: len(q)]
    left = RESERVE * np.minimum(1.0, np.maximum(step, np.roll(step, 1)) / SAMPLE_STEP) ** 2
    margin = np.array([e.margin for e in found])
    clear = np.array([ArmSurface(e).clearance(task.scene, task.clearance + RESERVE) for e in found])
    out = np.array([task.min_margin + left - margin, task.clearance + left - clear])
    for end in {0, len(q) - 1} if len(q) else ():
        out[:, end] = np.minimum(out[:, end], 0.0)
    return out


def _apart(task: PlanTask, time: Array, found: Sequence[Equilibrium], places: tuple[Array, Array]) -> Mask:
    """(P,) at which of some places a motion that was followed at times (T,) is on another branch."""
    points = np.array([task.chart.of(each) for each in found])
    there = np.column_stack([np.interp(places[0], time, column) for column in points.T])
    return np.asarray((np.abs(there - places[1]) / task.scale).max(1) > OTHER_BRANCH)
