"""Whether a place is out of reach: told in a fraction of a second, before inverse kinematics looks for the joints.

What is tested is an easier question than the one that is asked. Margin, branch, ranges of rotations, obstacles and the
direction of the tip are left out; ranges of the translations and the order of the tubes are kept. Who cannot reach the
place even so cannot reach it at all; that the best of some local searches cannot is evidence, not a proof.
"""

from __future__ import annotations

import numpy as np

from ..inverse.chart import Chart
from ..inverse.clock import Clock
from ..inverse.least_squares import constrained_least_squares
from ..inverse.multistart import known_starts
from ..inverse.table import nearest_starts, spread_starts
from ..typing import Array

STARTS = 8
"""Configurations from which the place is tried: of those in the table, the nearest half, and half that differ."""

ITERATIONS = 20
"""Most Gauss-Newton steps from each."""

NEAR = 0.02
"""Share of the robot's length: who comes closer than this is not refused here."""

DIFFERENCE = 1e-5
"""Step of the differences, in units of the scales."""

LONGEST = 0.4
"""Largest change of a coordinate per step, in units of the scales."""


def least_miss(chart: Chart, position: Array, clock: Clock | None = None) -> float:
    """Distance (m) from a place (3,) at which the tip ends in the best of some searches; 0 where one comes near, and
    where the clock is over before all of them ended."""
    space = chart.space
    target = (position, None)
    known = nearest_starts(space, known_starts(space, clock), target, min_margin=0.0, reference=None)
    least = np.inf
    for q in spread_starts(space, known, STARTS, first=STARTS // 2):
        if clock is not None and clock.over:
            return 0.0
        least = min(least, _closest(chart, q, position))
        if least <= NEAR * space.length:
            return 0.0
    return float(least) if np.isfinite(least) else 0.0


def _closest(chart: Chart, start: Array, position: Array) -> float:
    """Distance at which Gauss-Newton from joint values (m,), taken for tip rotations, ends, m."""
    space, z = chart.space, start.copy()
    m, scale = len(z), chart.space.scale
    moves = np.vstack([np.zeros(m), DIFFERENCE * np.diag(scale)])
    miss = np.inf
    for _ in range(ITERATIONS):
        tips = chart.arms(z + moves, 0.0).tip
        gap = (tips - position) / space.length
        if np.linalg.norm(gap[0]) > (1 - 1e-3) * miss:
            break
        miss = float(np.linalg.norm(gap[0]))
        if miss <= NEAR:
            break
        slope = ((gap[1:] - gap[0]) / DIFFERENCE).T
        rows, bounds = chart_constraints(chart, z)
        weights = np.vstack([slope, 1e-3 * np.eye(m)])
        found = constrained_least_squares(weights, np.append(-gap[0], np.zeros(m)), rows, bounds)
        if found is None:
            break
        z = z + found.x * scale
    return miss * space.length


def chart_constraints(chart: Chart, z: Array) -> tuple[Array, Array]:
    """Rows and bounds of a step in units of the scales: ranges of the translations, order, and not too far."""
    space = chart.space
    n, m = space.robot.n_tubes, len(z)
    unit = np.eye(m)
    rows = [unit[n:], -unit[n:], space.rows * space.scale, unit, -unit]
    bounds = [(space.lower - z)[n:] / space.scale[n:], (z - space.upper)[n:] / space.scale[n:]]
    bounds += [space.least - space.rows @ z, np.full(2 * m, -LONGEST)]
    return np.vstack(rows), np.minimum(np.concatenate(bounds), 0.0)
