"""Whether a place is out of reach: told in a fraction of a second, before inverse kinematics looks for the joints.

What is tested is an easier question than the one that is asked. Margin, branch, ranges of rotations, obstacles and the
direction of the tip are left out; ranges of the translations and the order of the tubes are kept. Who cannot reach the
place even so cannot reach it at all; that the best of some local searches cannot is evidence, not a proof.
"""

from __future__ import annotations

import numpy as np

from ..inverse.clock import Clock
from ..inverse.least_squares import constrained_least_squares
from ..inverse.multistart import known_starts
from ..inverse.table import nearest_starts, spread_starts
from ..inverse.task import Task
from ..typing import Array

DIFFERENCE = 1e-5
"""Step of the differences, in units of the scales."""


def least_miss(task: Task, position: Array, clock: Clock | None = None) -> float:
    """Distance (m) from a place (3,) at which the tip ends in the best of some searches; 0 where one comes near, and
    where the clock is over before all of them ended."""
    space, effort = task.chart.space, task.effort
    target = (position, None)
    known = nearest_starts(space, known_starts(space, clock), target, min_margin=0.0, reference=None)
    least = np.inf
    for q in spread_starts(space, known, effort.reach_starts, first=effort.reach_starts // 2):
        if clock is not None and clock.over:
            return 0.0
        least = min(least, _closest(task, q, position))
        if least <= effort.reach_near * space.length:
            return 0.0
    return float(least) if np.isfinite(least) else 0.0


def _closest(task: Task, start: Array, position: Array) -> float:
    """Distance at which Gauss-Newton from joint values (m,), taken for tip rotations, ends, m."""
    length, effort, z = task.chart.space.length, task.effort, start
    miss = np.inf
    for _ in range(effort.reach_steps):
        tips = tips_about(task, z)
        here = float(np.linalg.norm(tips[0] - position))
        if here > (1 - 1e-3) * miss:
            break
        miss = here
        step = None if miss <= effort.reach_near * length else step_towards(task, z, tips, position)
        if step is None:
            break
        z = z + step
    return miss


def tips_about(task: Task, z: Array) -> Array:
    """(m + 1, 3) tips, m, at a point (m,) of the chart and a DIFFERENCE farther along each coordinate."""
    return task.chart.arms(z + np.vstack([np.zeros(len(z)), DIFFERENCE * np.diag(task.scale)]), 0.0).tip


def step_towards(task: Task, z: Array, tips: Array, position: Array) -> Array | None:
    """(m,) the damped step of Gauss-Newton by which tips `tips_about` a point come closer to a place; None for none."""
    gap = (tips - position) / task.chart.space.length
    weights = np.vstack([((gap[1:] - gap[0]) / DIFFERENCE).T, 1e-3 * np.eye(len(z))])
    constraints = step_constraints(task, z, task.effort.reach_longest_step)
    found = constrained_least_squares(weights, np.append(-gap[0], np.zeros(len(z))), *constraints)
    return None if found is None else np.asarray(found.x * task.scale)


def step_constraints(task: Task, z: Array, longest: float) -> tuple[Array, Array]:
    """Rows and bounds of a step in units of the scales: ranges of the translations, order, and no change of a
    coordinate beyond the longest."""
    space = task.chart.space
    n, m = space.robot.n_tubes, len(z)
    unit = np.eye(m)
    rows = [unit[n:], -unit[n:], space.rows * space.scale, unit, -unit]
    bounds = [(space.lower - z)[n:] / space.scale[n:], (z - space.upper)[n:] / space.scale[n:]]
    bounds += [space.least - space.rows @ z, np.full(2 * m, -longest)]
    return np.vstack(rows), np.minimum(np.concatenate(bounds), 0.0)
