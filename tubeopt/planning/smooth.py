"""Smoothing: the way that was found becomes the best motion nearby, by direct collocation over time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from ..equilibrium.result import Equilibrium
from ..inverse.clock import Clock
from ..inverse.tip_coordinates import Arms
from ..typing import Array, Mask
from .motion import Motion
from .path_program import (
    MOST_NODES,
    TABLES,
    WEIGHTS,
    PathProgram,
    PathQuestion,
    path_program,
)
from .question import PlanTask
from .timing import Limits, violated

UNFINISHED = ("Maximum_WallTime_Exceeded", "Maximum_Iterations_Exceeded")

REFINEMENTS = 3
"""Times that knots are added where the motion between them is not allowed."""

TWIST = 0.3
"""Change of a tip rotation between knots that is always allowed, rad."""

MARGIN_RESERVE = 3e-3
"""Margin beyond that of the search that knots keep at first, for what is between them."""

BODY_REACH = 0.1
"""Distance of knots from obstacles, as a share of the longest tube, within which these count."""

MOST_OPERATIONS = 150_000
"""Operations of one equilibrium, about those of six tubes, beyond which derivatives take too long."""

BUILD_PER_OPERATION, BUILD_PER_BODY, BUILD_PER_NODE = 5e-5, 5e-2, 1e-6
"""Upper limits on most machines, s, of the time to build the program, which nothing can cut short, and to begin to
solve it: per operation of an equilibrium, per obstacle, and per node of a table of distances."""

LEAST_FIELDS = 1e-3
"""Least determinant of the Jacobi fields, which begin as 1."""

ROUND_OFF = 1e-9
"""Excess over ranges that is none, in units of the scales."""


@dataclass(frozen=True, eq=False)
class Smoothed:
    """A smoothed motion, its knots (K, m) in the chart, and how many iterations and knots it took."""

    motion: Motion
    points: Array
    iterations: int


def building(task: PlanTask) -> float:
    """Seconds of work that it may take to build the program of a task and to begin to solve it."""
    nodes = sum(min(body.lattice.values.size, MOST_NODES) for body in task.obstacles if isinstance(body, TABLES))
    return BUILD_PER_OPERATION * task.chart.size + BUILD_PER_BODY * len(task.obstacles) + BUILD_PER_NODE * nodes


def resample(task: PlanTask, points: Array, count: int) -> Array:
    """(count, m) points of a way, evenly spaced by the length of joint motion."""
    z = np.concatenate([points[:1], *(task.line(a, b)[1:] for a, b in pairwise(points))])
    q = task.chart.joints(z) / task.scale
    # Both metrics count: where the joints hardly move, the arm may.
    step = np.linalg.norm(np.diff(q, axis=0), axis=1) + 0.3 * np.linalg.norm(np.diff(z / task.scale, axis=0), axis=1)
    mark = np.concatenate([[0.0], np.cumsum(step)])
    at = np.linspace(0, mark[-1], count)
    out = np.column_stack([np.interp(at, mark, column) for column in z.T])
    out[0], out[-1] = points[0], points[-1]
    return out


def smooth(
    task: PlanTask, start: Equilibrium, points: Array, limits: Limits, objective: str, clock: Clock
) -> Smoothed | None:
    """The best motion near a way, from rest to rest; None where the program does not converge to an allowed one before
    the clock is over. How long it takes is told by objectives of time and effort only."""
    intervals, iterations = task.options.smoothing_intervals, 0
    z, share = resample(task, points, intervals + 1), np.full(intervals, 1 / intervals)
    room = np.array([task.margin_room + MARGIN_RESERVE, task.clearance_room])
    if task.chart.size > MOST_OPERATIONS:
        return None
    for _ in range(REFINEMENTS + 1):
        arms = task.chart.arms(z, 0.0)
        near = _near(task, arms)
        if clock.left < clock.parallel_slowdown * building(near):
            return None
        found = _solve(near, (z, arms), share, limits, objective, room, clock)
        if found is None:
            return None
        iterations += found.iterations
        bad, short = violated(task, start, found.motion, clock, (found.motion.time, found.points))
        if not bad.any():
            return replace(found, iterations=iterations)
        if clock.over:
            return None
        z, share = _split(found.points, share, bad)
        room += 1.5 * short
    return None


def _near(task: PlanTask, arms: Arms) -> PlanTask:
    """The same with the bodies alone that the arm may meet near knots."""
    if not task.obstacles:
        return task
    reach = BODY_REACH * task.chart.space.length + task.clearance + float(task.chart.radius.max())
    points = arms.fine()[1]
    near = task.scene.close(points.reshape(-1, 3), reach)
    return replace(task, obstacles=tuple(task.obstacles[k] for k in near))


def _solve(
    task: PlanTask, knots: tuple[Array, Arms], share: Array, limits: Limits, objective: str, room: Array, clock: Clock
) -> Smoothed | None:
    """The program's solution from knots (K, m) in the chart and their arms, with so much room (2,) above the margin and
    the clearance (m) to keep, at knots."""
    z = knots[0]
    space, n = task.chart.space, task.chart.space.robot.n_tubes
    scale, rate, acceleration = task.scale, limits.rate, limits.acceleration
    question = PathQuestion(
        task.chart.kind,
        space.carriages,
        len(share),
        len(space.least),
        task.obstacles,
        space.length,
        task.cost,
    )
    program = path_program(question)
    q = task.chart.joints(z)
    time = np.concatenate([[0.0], np.cumsum(share)])
    unit = _duration(q, time, rate, acceleration)
    length = max(float(np.linalg.norm(np.diff(q / scale, axis=0), axis=1).sum()), 1e-9)
    weights = np.array(WEIGHTS[objective]) * [length**-2, 1.0, length**-2, 1.0]
    p = program.values(
        robot=task.chart.parameters,
        offset=space.offset[n:],
        scale=scale,
        rate=rate / scale * unit,
        acceleration=acceleration / scale * unit**2,
        weights=weights,
        order=space.rows,
        step=share,
        twist=np.maximum(TWIST, 1.3 * np.abs(np.diff(z[:, :n], axis=0)).max(1)),
        radius=task.chart.radius,
    )
    floor = min(task.min_margin + float(room[0]), 0.998)
    x = np.concatenate([(q / scale).ravel(), (begin_rates(q, time) / scale).ravel(), z[:, :n].ravel(), [1.0, floor]])
    solver = program.solver(clock.left)
    least = _to_keep(task, program, np.asarray(program.least(x, p)), knots, float(room[1]))
    result = solver(x0=x, p=p, **_bounds(task, program, (q, z, least), objective, floor))
    stats = solver.stats()
    # What ran out of time or steps may still be allowed: following it tells.
    if not (stats["success"] or stats["return_status"] in UNFINISHED):
        return None
    sizes = np.cumsum([q.size, q.size, n * len(q)])
    *moved, tips, (square, _) = np.split(np.asarray(result["x"]).ravel(), sizes)
    joints, rates = (each.reshape(q.shape) * scale for each in moved)
    duration = float(np.sqrt(square)) * unit
    motion = Motion(CubicHermiteSpline(time * duration, joints, rates / duration))
    return Smoothed(motion, np.column_stack([tips.reshape(-1, n), joints[:, n:]]), int(stats["iter_count"]))


def begin_rates(q: Array, time: Array) -> Array:
    """(K, m) rates of knots by differences, at rest at both ends."""
    v = np.gradient(q, time, axis=0)
    v[0], v[-1] = 0.0, 0.0
    return np.asarray(v)


def _duration(q: Array, time: Array, rate: Array, acceleration: Array) -> float:
    """Seconds in which knots of joint values are passed without haste."""
    v, step = begin_rates(q, time), np.diff(time)[:, None]
    speed = (np.abs(np.diff(q, axis=0)) / step / rate).max()
    hard = (np.abs(np.diff(v, axis=0)) / step / acceleration).max()
    return float(max(2.0 * speed, 1.5 * np.sqrt(hard), 1e-2))


def _to_keep(task: PlanTask, program: PathProgram, least: Array, knots: tuple[Array, Arms], room: float) -> Array:
    """(K, rows) least distances to keep, m, at knots (K, m) and their arms: of those of an obstacle, all that of the
    closest. It may fall to `room` above the clearance to keep; not at all where a knot has no more than that to spare;
    and it must grow where there is none.

    The smooth least distances of the program, `least`, are bounded by what they are now less this: where much of an arm
    is about as close as its closest point, they are a few millimetres too small, of all knots alike.
    """
    z, arms = knots
    alone = (replace(task, obstacles=(body,)).clearances(arms) for body in task.obstacles)
    spare = np.array([each - task.clearance for each in alone]).reshape(len(task.obstacles), len(z)).T
    falls = spare - np.minimum(room, np.maximum(spare, task.needed(z)[:, None]))
    body, found = np.array(program.body, dtype=int), least.reshape(len(z), -1)
    closest = np.empty_like(falls)
    for k in range(falls.shape[1]):
        closest[:, k] = found[:, body == k].min(axis=1)
    return np.asarray((closest - falls)[:, body])


def _bounds(
    task: PlanTask, program: PathProgram, start: tuple[Array, Array, Array], objective: str, floor: float
) -> dict[str, Array]:
    """Bounds of unknowns and constraints from knots: joint values, points of the chart, least distances (m) to keep.
    Both ends, which were checked before, are as they are."""
    (q, z, least), space, inf = start, task.chart.space, np.inf
    n, (knots, m) = space.robot.n_tubes, q.shape
    low, high = (np.tile(value / task.scale, (knots, 1)) for value in (space.lower, space.upper))
    low[[0, -1]] = high[[0, -1]] = (q / task.scale)[[0, -1]]
    rate, tip = np.full((knots, m), inf), np.full((knots, n), inf)
    rate[[0, -1]] = 0.0
    lowest = -tip
    lowest[[0, -1]] = tip[[0, -1]] = z[[0, -1], :n]
    most = 0.999 if objective == "margin" else floor
    rows = program.rows
    lower = {name: np.full(size, -inf) for name, size in rows.items()}
    upper = {name: np.full(size, inf) for name, size in rows.items()}
    for name in ("speed", "force", "twist"):
        upper[name][:] = 0.0
    inside = ((np.arange(knots) > 0) & (np.arange(knots) < knots - 1))[:, None]
    lower["order"] = np.tile(space.least / space.length - ROUND_OFF, 2 * (knots - 1))
    ends = q[[0, -1]] / task.scale
    lower["ranges"] = np.tile(np.minimum(space.lower / task.scale, ends.min(0)) - ROUND_OFF, 2 * (knots - 1))
    upper["ranges"] = np.tile(np.maximum(space.upper / task.scale, ends.max(0)) + ROUND_OFF, 2 * (knots - 1))
    limits: dict[str, float | Array] = {"fields": LEAST_FIELDS, "clearance": least / space.length}
    for name, value in limits.items():
        if rows.get(name):
            lower[name] = np.where(inside, value, np.full((knots, rows[name] // knots), -inf)).ravel()
    # The ends' equations hold to the accuracy of the integration; there is nothing to solve.
    free = np.where(inside, 0.0, np.full((knots, n), inf)).ravel()
    lower["equilibrium"], upper["equilibrium"] = -free, free
    return {
        "lbx": np.concatenate([low.ravel(), -rate.ravel(), lowest.ravel(), [1e-6, floor]]),
        "ubx": np.concatenate([high.ravel(), rate.ravel(), tip.ravel(), [4.0, most]]),
        "lbg": np.concatenate([lower[name] for name in rows]),
        "ubg": np.concatenate([upper[name] for name in rows]),
    }


def _split(z: Array, share: Array, bad: Mask) -> tuple[Array, Array]:
    """Knots and shares of the time with a knot in the middle of each bad interval."""
    after = np.flatnonzero(bad) + 1
    points = np.insert(z, after, (z[after - 1] + z[after]) / 2, axis=0)
    return points, np.repeat(np.where(bad, share / 2, share), 1 + bad)
