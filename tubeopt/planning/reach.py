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
    space, effort, z = task.chart.space, task.effort, start.copy()
    m, scale = len(z), space.scale
    moves = np.vstack([np.zeros(m), DIFFERENCE * np.diag(scale)])
    miss = np.inf
    for _ in range(effort.reach_steps):
        tips = task.chart.arms(z + moves, 0.0).tip
        gap = (tips - position) / space.length
        if np.linalg.norm(gap[0]) > (1 - 1e-3) * miss:
            break
        miss = float(np.linalg.norm(gap[0]))
        if miss <= effort.reach_near:
            break
        slope = ((gap[1:] - gap[0]) / DIFFERENCE).T
        rows, bounds = step_constraints(task, z, effort.reach_longest_step)
        weights = np.vstack([slope, 1e-3 * np.eye(m)])
        found = constrained_least_squares(weights, np.append(-gap[0], np.zeros(m)), rows, bounds)
        if found is None:
            break
        z = z + found.x * scale
    return miss * space.length


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
