"""Whether a place is out of reach: told in a fraction of a second, before inverse kinematics looks for the joints.

No tip can be in an obstacle, farther than any arm, or behind a box that no arm gets around. Beyond that, an easier
question is tested than the one that is asked. Margin, branch, ranges of rotations, obstacles and the direction of the
tip are left out; ranges of the translations and the order of the tubes are kept. Who cannot reach the place even so
cannot reach it at all; that the best of some local searches cannot is evidence, not a proof.
"""

from __future__ import annotations

import numpy as np

from ..bodies.obstacles import Box
from ..errors import SolveError
from ..inverse.clock import Clock
from ..inverse.multistart import known_starts
from ..inverse.table import nearest_starts, spread_starts
from ..solvers.quadratic import constrained_least_squares
from ..typing import Array
from .question import PlanTask

STARTS, STEPS = 8, 20
"""Starts of the test for unreachable places, half of them nearest in the table, half spread; and Gauss-Newton steps
from each."""

LONGEST_STEP = 0.4
"""Largest change of a coordinate, in units of the joints' scales."""

NEAR = 0.02
"""Miss, as a share of the robot's length, below which a place is left to inverse kinematics."""

DIFFERENCE = 1e-5
"""Step of the differences, in units of the scales."""


def check_place(task: PlanTask, position: Array) -> None:
    """Raise SolveError where the tip cannot be at a place: an obstacle is there, or no arm is long enough, straight or
    around a box."""
    for k, obstacle in enumerate(task.obstacles):
        # No arm is thinner at its tip than the thinnest tube.
        clear = float(obstacle.signed_distance(position[None])[0] - task.chart.radius.min())
        if clear < task.clearance:
            raise SolveError(
                "no plan exists: with its tip at the goal, the clearance of the arm from "
                f"obstacle {k + 1} ({type(obstacle).__name__}) is at most {clear * 1e3:.4g} "
                f"mm; it must be at least {task.clearance * 1e3:g} mm"
            )
    longest, far = task.chart.space.longest, float(np.linalg.norm(position))
    if far > longest:
        raise SolveError(
            f"no plan exists: the goal is {far * 1e3:.4g} mm from the base plate; the "
            f"longest arm is {longest * 1e3:.4g} mm"
        )
    for k, body in enumerate(task.obstacles):
        around = way_around(body, position) if isinstance(body, Box) else 0.0
        if around > longest:
            raise SolveError(
                f"no plan exists: obstacle {k + 1} (Box) is between base plate and goal; a "
                f"path around it is at least {around * 1e3:.4g} mm long; the longest arm is "
                f"{longest * 1e3:.4g} mm"
            )


def way_around(box: Box, position: Array) -> float:
    """Length (m) that a way from the plate to a place is at least, since a box lies between them; 0 where it does not.

    Where plate and place are on either side of the box along an axis, a way passes the plane in the middle of the box
    beyond one of its four sides there: at best on the edge of that side, unfolded about it.
    """
    low, high, longest = np.array(box.low), np.array(box.high), 0.0
    for k in range(3):
        if not min(0.0, position[k]) < low[k] < high[k] < max(0.0, position[k]):
            continue
        middle, ways = (low[k] + high[k]) / 2, []
        for i in range(3):
            for edge, side in ((low[i], -1.0), (high[i], 1.0)) if i != k else ():
                # From a point that is itself beyond the side the plane is reached straight on.
                reach = [np.hypot(max(side * (edge - p[i]), 0.0), middle - p[k]) for p in (np.zeros(3), position)]
                along = position[3 - i - k]
                ways.append(float(np.hypot(sum(reach), along)))
        longest = max(longest, min(ways))
    return longest


def least_miss(task: PlanTask, position: Array, clock: Clock | None = None) -> float:
    """Distance (m) from a place (3,) at which the tip ends in the best of some searches; 0 where one comes near, and
    where the clock is over before all of them ended."""
    space = task.chart.space
    target = (position, None)
    known = nearest_starts(space, known_starts(space, clock), target, min_margin=0.0, reference=None)
    least = np.inf
    for q in spread_starts(space, known, STARTS, first=STARTS // 2):
        if clock is not None and clock.over:
            return 0.0
        least = min(least, _closest(task, q, position))
        if least <= NEAR * space.length:
            return 0.0
    return float(least) if np.isfinite(least) else 0.0


def _closest(task: PlanTask, start: Array, position: Array) -> float:
    """Distance at which Gauss-Newton from joint values (m,), taken for tip rotations, ends, m."""
    length, z = task.chart.space.length, start
    miss = np.inf
    for _ in range(STEPS):
        tips = tips_about(task, z)
        here = float(np.linalg.norm(tips[0] - position))
        if here > (1 - 1e-3) * miss:
            break
        miss = here
        step = None if miss <= NEAR * length else step_towards(task, z, tips, position)
        if step is None:
            break
        z = z + step
    return miss


def tips_about(task: PlanTask, z: Array) -> Array:
    """(m + 1, 3) tips, m, at a point (m,) of the chart and a DIFFERENCE farther along each coordinate."""
    return task.chart.arms(z + np.vstack([np.zeros(len(z)), DIFFERENCE * np.diag(task.scale)]), 0.0).tip


def step_towards(task: PlanTask, z: Array, tips: Array, position: Array) -> Array | None:
    """(m,) the damped step of Gauss-Newton by which tips `tips_about` a point come closer to a place; None for none."""
    gap = (tips - position) / task.chart.space.length
    constraints = step_constraints(task, z, LONGEST_STEP)
    step = damped_step(gap, DIFFERENCE, 1e-3, constraints)
    return None if step is None else np.asarray(step * task.scale)


def damped_step(gaps: Array, difference: float, damping: float, constraints: tuple[Array, Array]) -> Array | None:
    """(m,) the step of Gauss and Newton, in units of the scales, that makes a gap (r,) small; None where the
    constraints leave none. `gaps` (m + 1, r): here, and a `difference` farther along each coordinate."""
    slope, m = ((gaps[1:] - gaps[0]) / difference).T, len(gaps) - 1
    weights = np.vstack([slope, damping * np.eye(m)])
    found = constrained_least_squares(weights, np.append(-gaps[0], np.zeros(m)), *constraints)
    return None if found is None else found.x


def step_constraints(task: PlanTask, z: Array, longest: float) -> tuple[Array, Array]:
    """Rows and bounds of a step in units of the scales: ranges of the translations, order, and no change of a
    coordinate beyond the longest."""
    space = task.chart.space
    n, m = space.robot.n_tubes, len(z)
    unit = np.eye(m)
    rows = [unit[n:], -unit[n:], space.rows * space.scale, unit, -unit]
    bounds = [(space.lower - z)[n:] / space.scale[n:], (z - space.upper)[n:] / space.scale[n:]]
    bounds += [space.least - space.rows @ z, np.full(2 * m, -longest)]
    return np.vstack(rows), np.minimum(np.concatenate(bounds), 0.0)
