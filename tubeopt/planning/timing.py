"""Time-optimal parametrisation of a path of joint values (TOPP-RA, Pham and Pham 2018), and the robot along it.

Along a curve q(s), with the squared path speed x = (ds/dt)^2 and the path acceleration u = d^2 s / dt^2 = x' / 2,

    |q_s| sqrt(x) <= rate,    |a u + b x| <= acceleration,    a = q_s,    b = q_ss,

which is linear in (u, x). Between the points s_i of a grid u is constant, so that x_i+1 = x_i + 2 (s_i+1 - s_i) u_i,
and q is cubic. Both sides of the constraints are then quadratic in s, and their Bezier coefficients are a hull, so that
rates and accelerations of the joints are within their limits at all times and not only on the grid. A backward pass
computes the largest controllable x_i, from which the end can still be reached; a forward pass takes the largest u_i.
At both ends the robot is at rest: x is 0 there, or q_s is. The motion is a polynomial of time in every cell.

The speed of the tip is that of the equilibria on the branch of the start. They also show where a motion violates the
requirements of a plan: `track` computes them, `violated` evaluates them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy
from scipy.interpolate import PPoly

from ..equilibrium.arm_surface import ArmSurface
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import SolveError
from ..inverse.clock import Clock
from ..typing import Array, Index, Mask
from .motion import INSTANT, MIN_SAMPLES_OF_TIP, SAMPLE_STEP, JointMotion
from .question import PlanTask

# The first grid finds where the motion is slow, and the second has its cells there. Measured on six plans: with half
# or twice as many cells durations differ by less than 1e-4. TOPP-RA of the package toppra (500 cells) takes 1.000 to
# 1.005 times as long on the same curves, but its accelerations exceed their limits by up to 38 % between grid points.
CELLS, FINE_CELLS = 100, 500
"""Cells of the first grid of a curve, evenly spaced, and of the second, of equal durations."""

# `motion.too_fast` allows rates 1e-6 and accelerations 1e-3 beyond their limits. The price is 0.05 % of the duration.
RATE_SAFETY_FACTOR = 0.9995
"""Safety factor on the rate limits.

The tip speed is only checked on a grid, and the ends of a motion are made exact.
"""

# Near a fold joint values change fast along a straight motion in tip rotations.
MAX_HALVINGS, MAX_BEND = 4, 0.02
"""Largest number of doublings of the points of a path, and largest second difference of a sufficiently fine path.

The difference is of joint values, in units of their scales; below it, rounded curves are close enough to the points.
"""

# Larger than the error between samples, and falling with the square of their distance as the error does.
RESERVE = 1e-5
"""Reserve of the margin (and of the clearance, m) at the largest sample distance."""

# Samples are up to 0.04 apart.
OTHER_BRANCH = 0.1
"""Distance in tip coordinates, in units of the scales, of an equilibrium on another branch."""

SAME = 1e-9
"""Distance of grid points, relative to the curve, below which they are one."""

TINY = 1e-12

FAR = 1e100
"""Larger than any x."""

SHORTEST = 1e-3
"""Shortest duration of a motion, s: the cycle of a usual control loop. Below it, round-off of joint values resembles an
acceleration."""

Tips = Callable[[Array], Array]
"""Tip positions (k, 3), m, at joint values (k, m)."""


class TipLimit(NamedTuple):
    """Limit on the speed of the tip."""

    speed: float
    """Largest speed, m/s."""
    positions: Tips
    """Tip positions as a function of the joint values."""


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits on joints and tip."""

    rate: Array
    """(m,) largest rates of the joints."""
    acceleration: Array
    """(m,) largest accelerations of the joints."""
    tip: TipLimit | None = None


def at_full_speed(motion: JointMotion, limits: Limits) -> JointMotion:
    """Time-optimal motion from rest to rest along the curve of a motion."""
    return motion if motion.duration < INSTANT else _time_optimal([motion.curve], limits)[0]


def stopping_at(paths: Sequence[Array], limits: Limits) -> JointMotion:
    """Time-optimal motion along rounded paths (k, m) of evenly spaced joint values, with a stop between paths."""
    parts = _time_optimal([rounded(path) for path in paths], limits)
    starts = np.cumsum([0.0, *(part.duration for part in parts)])
    time = [parts[0].time, *(part.time[1:] + start for part, start in zip(parts[1:], starts[1:-1], strict=True))]
    powers = np.concatenate([part.curve.c for part in parts], axis=1)
    return JointMotion(PPoly(powers, np.concatenate(time)), parts[0].tip_limited)


def through(q: Array, scale: Array, limits: Limits, spacing: float | None = None) -> JointMotion:
    """Time-optimal motion close to a path of joint values (k, m), at rest at both ends.

    A spline with control points `spacing` apart, in units of the scales, rounds the corners; by default closely.
    """
    step = np.linalg.norm(np.diff(q / scale, axis=0), axis=1)
    mark = np.concatenate([[0.0], np.cumsum(step)])
    if not mark[-1] > 1e-9:
        return JointMotion.resting(q[0])
    count = max(100, 4 * len(q)) if spacing is None else max(8, int(np.ceil(mark[-1] / spacing)) + 1)
    even = np.linspace(0, mark[-1], count)
    return stopping_at([np.column_stack([np.interp(even, mark, column) for column in q.T])], limits)


def rounded(table: Array) -> PPoly:
    """Cubic B-spline over [0, 1] with control points on the polyline through evenly spaced points (k, m).

    It starts and ends at the ends of the polyline and is inside the hull of neighbouring points, so it satisfies the
    same ranges and order of the joints.
    """
    count = max(8, len(table))
    knots = np.concatenate([np.zeros(3), np.linspace(0, 1, count - 2), np.ones(3)])
    # With control points at Greville's abscissae a B-spline reproduces straight lines.
    greville = np.array([knots[k + 1 : k + 4].mean() for k in range(count)])
    x = np.linspace(0, 1, len(table))
    control = np.column_stack([np.interp(greville, x, column) for column in table.T])
    curve, inner = scipy.interpolate.BSpline(knots, control, 3), knots[3:-3]
    powers = [curve(inner[:-1], nu=order) / math.factorial(order) for order in (3, 2, 1, 0)]
    return PPoly(np.array(powers), inner)


def _time_optimal(curves: Sequence[PPoly], limits: Limits) -> list[JointMotion]:
    """Time-optimal motions along consecutive cubic curves."""
    grids = [_grid(curve, np.linspace(curve.x[0], curve.x[-1], CELLS)) for curve in curves]
    for k, (curve, s, x) in enumerate(zip(curves, grids, _squared_speeds(curves, grids, limits), strict=True)):
        time = _time(s, x)
        grids[k] = _grid(curve, np.interp(np.linspace(0, time[-1], FINE_CELLS), time, s))
    motions = []
    for curve, s, x in zip(curves, grids, _squared_speeds(curves, grids, limits), strict=True):
        # In every cell s grows by p t + w t^2, where ds/dt starts as p = sqrt(x) and w = u / 2 = x' / 4.
        c1, c2, c3 = _coefficients(curve, s)
        p, w = np.sqrt(x[:-1])[:, None], (np.diff(x) / np.diff(s) / 4)[:, None]
        # c1 ds + c2 ds^2 + c3 ds^3 with ds = p t + w t^2, by powers of t from the sixth down.
        powers = [c3 * w**3, 3 * c3 * p * w**2, c2 * w**2 + 3 * c3 * p**2 * w, 2 * c2 * p * w + c3 * p**3]
        powers += [c1 * w + c2 * p**2, c1 * p, curve(s[:-1])]
        motion = JointMotion(PPoly(np.array(powers), _time(s, x)), tip_limited=limits.tip is not None)
        motions.append(motion.slower(max(1.0, SHORTEST / motion.duration)))
    return motions


def _grid(curve: PPoly, points: Array) -> Array:
    """(N + 1,) points of a curve with its knots, where points that differ by round-off are one."""
    s = np.union1d(curve.x, points)
    distinct: Array = s[np.append(np.diff(s) > SAME * (s[-1] - s[0]), True)]
    return distinct


def _squared_speeds(curves: Sequence[PPoly], grids: Sequence[Array], limits: Limits) -> list[Array]:
    """Largest squares (N + 1,) of the path speed on the grid of every curve."""
    tips: list[Array | None] = [None] * len(curves)
    if limits.tip is not None:
        # All at once, since the branch is followed from the start of the first curve.
        all_tips = limits.tip.positions(np.concatenate([curve(s) for curve, s in zip(curves, grids, strict=True)]))
        tips = list(np.split(all_tips, np.cumsum([len(s) for s in grids])[:-1]))
    rows = zip(curves, grids, tips, strict=True)
    return [_solve(_Program.of(curve, s, limits, tip)) for curve, s, tip in rows]


def _time(s: Array, x: Array) -> Array:
    """(N + 1,) times at the points of a grid, s."""
    speed = np.sqrt(x)
    # At constant acceleration the mean speed is the mean of both ends.
    return np.concatenate([[0.0], np.cumsum(2 * np.diff(s) / np.maximum(speed[1:] + speed[:-1], TINY))])


def _coefficients(curve: PPoly, s: Array) -> list[Array]:
    """Coefficients c_1, c_2, c_3 (N, m) of powers of s - s_i in every cell of a grid that contains the knots."""
    return [curve(s[:-1], nu=order) / math.factorial(order) for order in (1, 2, 3)]


@dataclass(frozen=True, eq=False)
class _Program:
    """Linear program for the squared path speed x and the acceleration u on N cells: |a u + b x| <= 1, x <= x_max.

    x is the square of the path speed at the start of each cell, u half its slope along the cell.
    """

    h: Array
    """(N,) lengths of the cells."""
    a: Array
    """(N, r) coefficients of the path acceleration u, over the limits of the acceleration."""
    b: Array
    """(N, r) coefficients of the squared path speed x, over the limits of the acceleration."""
    x_max: Array
    """(N + 1,) maximum velocity curve, from the rates."""

    @staticmethod
    def of(curve: PPoly, s: Array, limits: Limits, tip: Array | None) -> _Program:
        """Program of a curve on a grid s (N + 1,).

        `tip` (N + 1, 3): tip positions, if their speed is limited.
        """
        h = np.diff(s)
        c1, c2, c3 = _coefficients(curve, s)
        long, acceleration = h[:, None], RATE_SAFETY_FACTOR * limits.acceleration
        # At s_i + ds the square of the path speed is x + 2 ds u. So
        # q_s u + q_ss (x + 2 ds u) = (c1 + 6 c2 ds + 15 c3 ds^2) u + (2 c2 + 6 c3 ds) x, by Bezier coefficients:
        a = [c1, c1 + 3 * c2 * long, c1 + 6 * c2 * long + 15 * c3 * long**2]
        b = [2 * c2, 2 * c2 + 3 * c3 * long, 2 * c2 + 6 * c3 * long]
        a_rows, b_rows = (np.concatenate(rows, axis=1) / np.tile(acceleration, 3) for rows in (a, b))
        # Bezier coefficients of q_s, a hull of the rates; `pace` is the time per unit of s.
        q_s = np.abs([c1, c1 + c2 * long, c1 + 2 * c2 * long + 3 * c3 * long**2]).max(0)
        pace = (q_s / (RATE_SAFETY_FACTOR * limits.rate)).max(1)
        if limits.tip is not None and tip is not None:
            speed = scipy.interpolate.CubicSpline(s, tip)(np.stack([s[:-1], (s[:-1] + s[1:]) / 2, s[1:]]), 1)
            # Samples are joined by straight lines, so the joints have the rates of neighbouring cells as well.
            neighbours = 1 + 2 * math.ceil(len(h) / MIN_SAMPLES_OF_TIP)
            fastest = scipy.ndimage.maximum_filter1d(np.linalg.norm(speed, axis=2).max(0), neighbours)
            pace = np.maximum(pace, fastest / (RATE_SAFETY_FACTOR * limits.tip.speed))
        x_max = 1 / np.maximum(np.append(pace, 0.0), np.append(0.0, pace)).clip(TINY) ** 2
        # At an end where q_s = 0 the robot is at rest at any path speed.
        moving = np.abs(curve(s[[0, -1]], nu=1) / limits.rate).max(1) * np.sqrt(x_max[[0, -1]]) > 1e-6
        x_max[[0, -1]] = np.where(moving, 0.0, x_max[[0, -1]])
        return _Program(h, a_rows, b_rows, x_max)


def _solve(program: _Program) -> Array:
    """(N + 1,) largest squares of the path speed.

    The backward pass computes controllable sets [0, x_max], the forward pass the motion.
    """
    # Every row is |u + v x| <= w; a row without u bounds x itself.
    growth = 2 * program.h[:, None]  # x_i+1 = x_i + growth u
    with_u = np.abs(program.a) > TINY
    divisor = np.where(with_u, program.a, 1.0)
    v, w = np.where(with_u, program.b / divisor, 0.0), np.where(with_u, 1 / np.abs(divisor), np.inf)
    without_u = np.where(with_u, np.inf, 1 / np.maximum(np.abs(program.b), TINY)).min(1)
    feasible = np.minimum(without_u, _largest_feasible(v, w, growth))
    x_max = np.append(np.minimum(program.x_max[:-1], feasible), program.x_max[-1])
    # u <= w - v x gives x_i+1 <= slope x_i + intercept; backwards, u >= -w - v x gives
    # x_i <= (x_i+1 + intercept) / slope.
    slope, intercept = 1 - growth * v, growth * w
    grows = slope > TINY
    divisor = np.where(grows, slope, 1.0)
    x_max = _largest_below(x_max[::-1], (1 / divisor)[::-1], np.where(grows, intercept / divisor, np.inf)[::-1])[::-1]
    return _largest_below(x_max, slope, intercept)


def _largest_below(x_max: Array, slope: Array, intercept: Array) -> Array:
    """(N + 1,) largest x_i with x_i <= x_max_i, and x_i+1 below r lines (N, r) of x_i.

    Only the lower envelope of the lines matters, for x_i in [0, x_max_i]. Mostly it has at most three lines: the lowest
    at 0, the lowest at x_max, and the lowest where these two meet. Where it has more, all lines are evaluated.
    """
    rows, intercept = np.arange(len(intercept)), np.minimum(intercept, FAR)

    def lowest(x: Array) -> Index:
        return np.asarray((slope * x[:, None] + intercept).argmin(1))

    def crossing(i: Index, j: Index) -> Array:
        dslope, dintercept = (table[rows, i] - table[rows, j] for table in (slope, intercept))
        x = np.where(np.abs(dslope) > TINY, -dintercept / np.where(dslope == 0, 1.0, dslope), 0.0)
        return np.asarray(x).clip(0, x_max[:-1])

    def above_envelope(i: Index, x: Array) -> Mask:
        envelope = (slope * x[:, None] + intercept).min(1)
        return np.asarray(slope[rows, i] * x + intercept[rows, i] > envelope * (1 + TINY))

    first, last = lowest(np.zeros(len(intercept))), lowest(x_max[:-1])
    middle = lowest(crossing(first, last))
    more = above_envelope(middle, crossing(first, middle)) | above_envelope(middle, crossing(middle, last))
    # Python floats: the recursion is sequential, and they are faster than array elements.
    three = [(slope[rows, i].tolist(), intercept[rows, i].tolist()) for i in (first, middle, last)]
    (m_1, c_1), (m_2, c_2), (m_3, c_3) = three
    x = float(x_max[0])
    out = [x]
    for k, (upper, many) in enumerate(zip(x_max[1:].tolist(), more.tolist(), strict=True)):
        if many:
            bound = float((slope[k] * x + intercept[k]).min())
        else:
            bound = min(m_1[k] * x + c_1[k], m_2[k] * x + c_2[k], m_3[k] * x + c_3[k])
        x = min(upper, max(bound, 0.0))
        out.append(x)
    return np.array(out)


def _largest_feasible(v: Array, w: Array, growth: Array) -> Array:
    """(N,) largest squared path speeds x for which some acceleration u satisfies |u + v x| <= w (N, r).

    The next x must not be negative.
    """
    x = np.full(len(v), np.inf)
    for k in range(v.shape[1]):
        # The intervals of u of rows j and k intersect if |v_j - v_k| x <= w_j + w_k; the next x is not negative if
        # u >= -x / growth.
        row = v[:, k, None]
        difference = np.concatenate([np.abs(row - v[:, k + 1 :]), row - 1 / growth], axis=1)
        width = np.concatenate([w[:, k, None] + w[:, k + 1 :], w[:, k, None]], axis=1)
        limit = np.where(difference > 0, width / np.where(difference > 0, difference, 1.0), np.inf)
        np.minimum(x, limit.min(1), out=x)
    return x


# --- the robot along a motion -----------------------------------------------------------------------------------------


def joint_curves(task: PlanTask, points: Array) -> list[Array]:
    """Joint values along every straight motion of a path (k, m), evenly spaced and close enough to check it."""
    out = []
    for a, b in pairwise(points):
        pieces = (len(task.line(a, b)) - 1) * 2 ** (task.fineness(a, b) or 0)
        for halvings in range(MAX_HALVINGS + 1):
            q = task.coordinates.joints(a + np.linspace(0, 1, 2**halvings * pieces + 1)[:, None] * (b - a))
            if np.abs(np.diff(q / task.scale, 2, axis=0)).max(initial=0.0) <= MAX_BEND:
                break
        out.append(q)
    return out


def actuators(task: PlanTask, first: Equilibrium) -> Limits:
    """Speed limits of joints and tip for motions that start at an equilibrium."""
    rates = task.rates

    def tips(q: Array) -> Array:
        """Tips on the branch of the equilibrium; beyond its end, the last one."""
        positions = np.array([e.tip_position for e in track(task, first, q)])
        return np.concatenate([positions, np.repeat(positions[-1:], len(q) - len(positions), axis=0)])

    tip = None if rates.tip is None else TipLimit(rates.tip, tips)
    return Limits(*rates.of(task.coordinates.space), tip)


def track(task: PlanTask, start: Equilibrium, q: Array, clock: Clock | None = None) -> tuple[Equilibrium, ...]:
    """Equilibria at joint values q (T, m) on the branch of `start`; fewer than T if the branch or the time ends."""
    space, e, equilibria = task.coordinates.space, start, list[Equilibrium]()
    for row in q:
        rotations, shift = space.split(row)
        try:
            # Each from the last one, which keeps the branch: a cold start may find another equilibrium.
            e = forward_kinematics(space.robot, rotations, shift, load=task.coordinates.load, start=e)
        except SolveError:
            break
        if not e.stable or (clock is not None and clock.over):
            break
        equilibria.append(e)
    return tuple(equilibria)


@dataclass(frozen=True, eq=False)
class Violations:
    """Violations along a motion."""

    intervals: Mask
    """(K - 1,) True between knots where the motion violates branch, margin or clearance."""
    shortfall: Array
    """(2,) largest shortfall of margin and of clearance (m)."""


# The first rounds over a rotation of 0.4 rad, the last is nearly the path itself. Each cuts off the corners about half
# as much as the one before.
SPACINGS = (0.4, 0.2, 0.1, 0.05, 0.02, 0.01)
"""Spacings of the polyline points before rounding, in units of the joint scales, tried in turn."""


def round_corners(
    task: PlanTask, first: Equilibrium, q: Array, end: Array, limits: Limits, clock: Clock
) -> JointMotion | None:
    """Time-optimal motion close to joint values (k, m), with the roundest valid corners; None if none is valid in time.

    `end` (m,): tip coordinates at the end.
    """
    for spacing in SPACINGS:
        if clock.over:
            return None
        motion = through(q, task.scale, limits, spacing)
        if not violated(task, first, motion, clock, (motion.time[-1:], end[None])).intervals.any():
            return motion
    return None


def violated(
    task: PlanTask,
    start: Equilibrium,
    motion: JointMotion,
    clock: Clock,
    checkpoints: tuple[Array, Array],
    *,
    given_goal: bool = True,
) -> Violations:
    """Violations along a motion; its start and a given goal may violate margin and clearance.

    `checkpoints`: times (P,) at which it has to be at tip coordinates (P, m). The same joint values may be reached
    on several branches, by paths around a fold on one side and on the other.
    """
    time, q = motion.sampled(task.scale)
    equilibria = track(task, start, q, clock)
    bad = np.zeros(len(motion.time) - 1, dtype=bool)
    shortfall = _shortfall(task, equilibria, len(q) - 1 if given_goal else None)
    wrong = time[: len(equilibria)][(shortfall > 0).any(0)]
    if len(equilibria) < len(q):
        wrong = np.append(wrong, time[len(equilibria)])
    else:
        first = checkpoints[0][_on_other_branch(task, time, equilibria, checkpoints)][:1]
        wrong = np.append(wrong, np.nextafter(first, 0))  # the cause is in the interval before
    bad[np.clip(np.searchsorted(motion.time, wrong, side="right") - 1, 0, len(bad) - 1)] = True
    return Violations(bad, np.maximum(shortfall.max(1, initial=0.0), 0.0))


def _shortfall(task: PlanTask, equilibria: Sequence[Equilibrium], goal: int | None) -> Array:
    """(2, T) shortfalls of margin and clearance (m), with reserve; at most 0 if satisfied."""
    joints = [task.coordinates.space.join(e.rotations, e.translations) for e in equilibria]
    q = np.reshape(joints, (-1, len(task.scale))) / task.scale
    step = np.append(np.abs(np.diff(q, axis=0)).max(1), 0.0)[: len(q)]
    reserve = RESERVE * np.minimum(1.0, np.maximum(step, np.roll(step, 1)) / SAMPLE_STEP) ** 2
    margin = np.array([e.margin for e in equilibria])
    clear = np.array([ArmSurface(e).clearance(task.scene, task.clearance + RESERVE) for e in equilibria])
    out = np.array([task.min_margin + reserve - margin, task.clearance + reserve - clear])
    fixed = [end for end in {0, goal} if end is not None and end < len(q)]
    out[:, fixed] = np.minimum(out[:, fixed], 0.0)
    return out


def _on_other_branch(
    task: PlanTask, time: Array, equilibria: Sequence[Equilibrium], checkpoints: tuple[Array, Array]
) -> Mask:
    """(P,) True at checkpoints where the equilibria at times (T,) are on another branch."""
    points = np.array([task.coordinates.of(each) for each in equilibria])
    reached = np.column_stack([np.interp(checkpoints[0], time, column) for column in points.T])
    return np.asarray((np.abs(reached - checkpoints[1]) / task.scale).max(1) > OTHER_BRANCH)
