"""Follow the leader: the arm extends along the path of its own tip, as far as tubes allow.

The curve to lie on is the arm at the goal. From there it is withdrawn step by step: at every length the points of the
chart are found (Gauss-Newton, constrained) whose arm is closest, in the mean square along the arm, to the part of the
curve of that length. Forth in time, that is the deployment. How far the arm is from the path of its tip is measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..arguments import typed
from ..bodies.obstacles import Obstacle
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, finite
from ..robots.limits import JointLimits
from ..robots.order import last_tube
from ..robots.robot import Robot
from ..solvers.blas import small
from ..solvers.quadratic import constrained_least_squares
from ..typing import Array
from .goals import check_goal, ends, start_equilibrium
from .motion import DEFAULT_RATES, RateLimits
from .question import DEFAULT_PLAN, PlanOptions, PlanTask, asked
from .reach import damped_step, step_constraints
from .timing import track
from .tip_path import distance_from
from .trajectory import Trajectory
from .trajectory_building import passing

LENGTHS = 60
"""Number of arm lengths at which the arm is fitted to the one at the goal."""

ITERATIONS, LAST_STEP = 6, 1e-3
"""Maximum number of Gauss-Newton steps per length, and the step, in units of the scales, that ends them."""

DIFFERENCE = 1e-5
"""Step of the differences, in units of the scales of the joints."""

DAMPING = 2e-3
"""Weight of a change of the joints relative to the distance over the robot's length: what the shape does not decide."""

LONGEST_STEP = 0.15
"""Largest change of a coordinate per step, in units of the scales."""


@typed
@small
def follow_the_leader(
    robot: Robot,
    goal: Any,
    *,
    begin: float = 0.2,
    obstacles: Sequence[Obstacle] = (),
    min_margin: float = 0.05,
    rate_limits: RateLimits = DEFAULT_RATES,
    limits: JointLimits | None = None,
    options: PlanOptions = DEFAULT_PLAN,
) -> Trajectory:
    """Deployment to a goal in which the arm stays close to the path of its own tip.

    Args:
        goal: as for `plan_trajectory`; of several equilibria, the one with the largest margin.
        begin: initial length of the arm as a fraction of its length at the goal, in (0, 1).
        obstacles, min_margin, rate_limits, limits, options: as for `plan_trajectory`.

    Returns:
        The trajectory. `.deviation` (T,) is the largest distance of a point of the arm from the path of the tip, m.
        That path consists of the arm at the start and the later tip positions.

    Raises:
        InputError: numbers out of range, a goal out of range.
        SolveError: no equilibrium meets the goal, or the deployment found cannot be proved.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> deployment = tubeopt.follow_the_leader(robot, ([0.3, 1.0, -0.5], [-0.06, -0.06, -0.04]))
        >>> deployment.proof.holds, bool(deployment.deviation.max() < 2e-3)
        (True, True)
    """
    if not 0 < finite("begin", begin) < 1:
        raise InputError(f"begin is {begin:g}; it must be between 0 and 1")
    task = asked(robot, obstacles, min_margin, rate_limits, limits, options, places=(goal,))
    with task.in_time():
        last = _goal(task, goal)
        if not float(last.arc_length[-1]) > 0:
            raise InputError("goal has no tube in front of the plate; deployment needs an arm there")
        path = [task.chart.of(last)]
        for share in np.linspace(1.0, begin, LENGTHS + 1)[1:]:
            path.append(_fit(task, path[-1], last, share * float(last.arc_length[-1])))
        q = task.chart.joints(np.array(path))
    q[0] = task.chart.space.join(last.rotations, last.translations)
    withdrawn = track(task, last, q)
    if len(withdrawn) < len(q):
        raise SolveError("the arm snaps during retraction")
    first = withdrawn[-1]
    made = passing(task, first, q[::-1], path[0], "leader")
    if not isinstance(made, Trajectory):
        raise SolveError(f"the deployment cannot be proved: {'; '.join(made)}")
    way = np.concatenate([first.position, made.tip_position[1:]])
    return replace(made, deviation=np.array([distance_from(way, e.position).max() for e in made.arms]))


def _goal(task: PlanTask, goal: Any) -> Equilibrium:
    """The equilibrium at the end."""
    space = task.chart.space
    check_goal(space.robot, goal)
    if isinstance(goal, Equilibrium):
        ends(task, goal, goal)
        return goal
    home = start_equilibrium(space, space.split(space.middle()))
    end = ends(task, home, goal)[0]
    found = forward_kinematics(space.robot, *space.split(end.joints))
    if np.abs(task.chart.of(found) - end.point).max() > 1e-6:
        raise InputError("goal has several equilibria; give an Equilibrium")
    return found


def _fit(task: PlanTask, z: Array, last: Equilibrium, length: float) -> Array:
    """The point of the chart of an arm of a given length that lies closest to the arm at the goal."""
    space = task.chart.space
    m = len(z)
    z = _withdrawn(task, z, length)
    for _ in range(ITERATIONS):
        moves = np.vstack([np.zeros(m), DIFFERENCE * np.diag(task.scale)])
        arms = task.arms(z + moves)
        s, line = arms.fine()
        target = np.column_stack([np.interp(s[0], last.arc_length, last.position[:, k]) for k in range(3)])
        gap = (line - target).reshape(m + 1, -1) / space.length / np.sqrt(len(target))
        rotation = ((arms.rotations[1:] - arms.rotations[0]) / DIFFERENCE).T
        constraints = _constraints(task, z, arms.rotations[0], rotation, LONGEST_STEP)
        chosen = damped_step(gap, DIFFERENCE, DAMPING, constraints)
        if chosen is None:
            break
        step, share = chosen * task.scale, 1.0
        while share > 0.05 and not task.holds((z + share * step)[None])[0]:
            share /= 2
        if share <= 0.05:
            break
        z = z + share * step
        if np.abs(chosen).max() < LAST_STEP:
            break
    return z


def _foremost(task: PlanTask, z: Array) -> tuple[int, int]:
    """The tube with which the arm ends, and its carriage."""
    space = task.chart.space
    curved = np.array([tube.curved_length for tube in space.robot.tubes])
    tube = int(last_tube(task.chart.translations(z[None])[0] + curved))
    return tube, next(k for k, tubes in enumerate(space.carriages) if tube in tubes)


def _withdrawn(task: PlanTask, z: Array, length: float) -> Array:
    """The carriages moved back as far as an arm of a given length asks, the others with them where order asks."""
    space, n, m = task.chart.space, task.chart.space.robot.n_tubes, len(z)
    out, (tube, k) = z.copy(), _foremost(task, z)
    held, place = np.eye(m)[n + k], length - space.robot.tubes[tube].curved_length - space.offset[n + tube]
    out[n + k] = np.clip(place, space.lower[n + k], space.upper[n + k])
    rows, bounds = space.inequalities(out)
    rows, bounds = np.vstack([rows, held, -held]), np.append(bounds, [0.0, 0.0])
    shifts = np.abs(rows[:, n:]).sum(1) > 0
    found = constrained_least_squares(np.eye(m - n), np.zeros(m - n), rows[shifts, n:], bounds[shifts])
    if found is not None:
        out[n:] += found.x
    return out


def _constraints(task: PlanTask, z: Array, rotations: Array, slope: Array, longest: float) -> tuple[Array, Array]:
    """Rows and bounds of a step in units of the scales: ranges, order, the length of the arm, and no change of a
    coordinate beyond the longest."""
    space, n = task.chart.space, task.chart.space.robot.n_tubes
    rows, bounds = step_constraints(task, z, longest)
    held = np.eye(len(z))[n + _foremost(task, z)[1]]
    low, high = np.minimum(space.lower[:n] - rotations, 0.0), np.minimum(rotations - space.upper[:n], 0.0)
    return np.vstack([slope, -slope, rows, held, -held]), np.concatenate([low, high, bounds, np.zeros(2)])
