"""Follow a curve with the tip within a tolerance, or with the whole arm (follow the leader).

For follow-the-leader the curve is the arm at the goal. From there the arm is retracted step by step: at every length a
constrained Gauss-Newton method finds the arm that is closest to the part of the curve of that length, in the mean
square along the arm. Reversed in time, this is the deployment. The distance of the arm from the path of its tip is
measured.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..arguments import typed
from ..bodies.obstacles import Obstacle
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import MIN_MARGIN, Equilibrium
from ..errors import InputError, SolveError, finite
from ..files.field_metadata import TYPICAL_TIP_ERROR, typical_length
from ..inverse import IkSession, inverse_kinematics
from ..robots.limits import JointLimits, check_target
from ..robots.order import last_tube
from ..robots.robot import Robot
from ..solvers.blas import small
from ..solvers.compiled.quadratic import constrained_least_squares
from ..typing import Array
from .goals import (
    check_goal,
    check_start,
    checked_points,
    damped_step,
    ends,
    inverse_constraints,
    least_miss,
    start_equilibrium,
    step_constraints,
)
from .motion import DEFAULT_RATES, RateLimits
from .plan import passing
from .question import DEFAULT_PLAN, PlanOptions, PlanTask, plan_task
from .timing import track
from .trajectory import Trajectory

# A curve of 200 m is one in mm.
LONGEST = 1000
"""Largest length of a curve, relative to the longest tube; a longer one is a mistake in units."""

# 1.6 mm on an arm of 200 mm: between points the error of the tip grows with the square of the spacing.
SPACING, REFINEMENTS = 0.008, 3
"""Initial spacing of the solved points, relative to the robot's length; maximum number of times that it is halved."""

# The error of the polyline is then 1 / 1600 of that of one through the points.
DENSE = 40
"""Number of samples per piece of a spline."""

# Different configurations reach different parts of a curve.
STARTS, STARTS_FRACTION = 8, 0.3
"""Maximum number of starting configurations, and fraction of the remaining time for their search."""


@typed
@small
def follow_tip_path(  # noqa: PLR0913
    robot: Robot,
    path: ArrayLike,
    *,
    start: Any = None,
    tolerance: float = 5e-4,
    spline: bool = False,
    obstacles: Sequence[Obstacle] = (),
    min_margin: float = MIN_MARGIN,
    rate_limits: RateLimits = DEFAULT_RATES,
    limits: JointLimits | None = None,
    options: PlanOptions = DEFAULT_PLAN,
) -> Trajectory:
    """Plan a motion of the tip along a curve; the null space raises the margin.

    Args:
        path: (k, 3) points, m: a polyline, or points of a smooth curve with `spline`.
        start: equilibrium or joint values with the tip at the first point. By default inverse kinematics gives
            configurations until the whole curve can be followed from one.
        tolerance: largest distance of the tip from the curve, m.
        obstacles, min_margin, rate_limits, limits, options: as for `plan_trajectory`.

    Returns:
        The trajectory; `.deviation` (T,) is the distance of the tip from the curve, m.

    Raises:
        InputError: fewer than two points, a curve longer than 1000 tubes, a start with its tip elsewhere, numbers out
            of range.
        SolveError: the curve leaves the region that is reachable with margin and clearance; the message states where.

    Examples:
        >>> import numpy as np
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> motion = tubeopt.follow_tip_path(robot, [[0.0, -0.03, 0.13], [0.005, -0.03, 0.13]])
        >>> motion.proof.holds, bool(motion.deviation.max() <= 5e-4)
        (True, True)
    """
    typical_length("tolerance", tolerance, TYPICAL_TIP_ERROR)
    task = plan_task(robot, obstacles, min_margin, rate_limits, limits, options, configurations=(start,))
    clock = task.clock
    curve = _curve(path, spline)
    check_target(robot.tubes, "path", checked_points(path, "path"))
    length = float(np.linalg.norm(np.diff(curve, axis=0), axis=1).sum())
    longest = LONGEST * max(tube.length for tube in robot.tubes)
    if length > longest:
        raise InputError(
            f"path is {length:.6g} m long; it must be at most {longest:g} m, {LONGEST} times the longest tube"
        )
    furthest, reason = 0.0, "the first point is out of reach"
    for first in _starts(task, curve, start, tolerance):
        spacing = SPACING * task.coordinates.space.length
        for _ in range(REFINEMENTS + 1):
            points = spaced(curve, spacing)
            equilibria, why = _solve_along(task, first, points)
            fraction = len(equilibria) / len(points)
            if fraction < 1:
                if fraction >= furthest:
                    furthest, reason = fraction, why
                break
            q = np.array([task.coordinates.space.join(e.rotations, e.translations) for e in equilibria])
            result = passing(task, first, q, task.coordinates.of(equilibria[-1]), "tip path", len(q))
            if isinstance(result, Trajectory):
                deviation = distance_from(curve, result.tip_position)
                if deviation.max() <= tolerance:
                    return replace(result, deviation=deviation)
                result = ("between its points the tip leaves the curve",)
            reason = "; ".join(result)
            furthest, spacing = 1.0, spacing / 2
            if clock.over:
                break
        if clock.over:
            reason += f"; the time limit of {clock.limit:g} s is reached"
            break
    raise SolveError(f"the tip can follow {100 * furthest:.1f} % of the curve: {reason}")


def _curve(path: ArrayLike, spline: bool) -> Array:
    """(k, 3) points of the polyline, or dense points of the spline, m."""
    points = checked_points(path, "path")
    if len(points) < 2:
        raise InputError("path is 1 point; it must be at least 2 points")
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if (step <= 0).any():
        raise InputError(f"path repeats point {int(np.argmin(step)) + 1}; consecutive points must differ")
    if not spline or len(points) < 3:
        return points
    along = np.concatenate([[0.0], np.cumsum(step)])
    fine = np.interp(np.linspace(0, len(points) - 1, DENSE * (len(points) - 1) + 1), np.arange(len(points)), along)
    fine_points: Array = scipy.interpolate.CubicSpline(along, points)(fine)
    return fine_points


def spaced(curve: Array, spacing: float) -> Array:
    """Points on a polyline at most `spacing` (m) apart, with all corners."""
    out = [curve[:1]]
    for a, b in pairwise(curve):
        count = max(1, int(np.ceil(np.linalg.norm(b - a) / spacing)))
        out.append(a + (b - a) * (np.arange(1, count + 1) / count)[:, None])
    return np.concatenate(out)


def _starts(task: PlanTask, curve: Array, start: Any, tolerance: float) -> Iterator[Equilibrium]:
    if start is not None:
        first = start_equilibrium(task.coordinates.space, start)
        check_start(task, first)
        distance = float(np.linalg.norm(first.tip_position - curve[0]))
        if distance > tolerance:
            raise InputError(
                f"the tip at start is {distance * 1e3:.4g} mm from the first point of the path; "
                f"it must be within {tolerance * 1e3:g} mm (use plan_trajectory with a "
                "TipGoal)"
            )
        yield first
        return
    miss = least_miss(task, curve[0], task.clock)
    if miss > 0:
        raise SolveError(
            "the tip can follow 0 % of the curve: the searches did not reach its first "
            f"point; the smallest distance of the tip is {miss * 1e3:.4g} mm"
        )
    constraints = inverse_constraints(task, task.min_margin, STARTS_FRACTION * task.clock.left)
    for solution in inverse_kinematics(task.coordinates.space.robot, curve[0], all_solutions=True, **constraints)[
        :STARTS
    ]:
        yield solution.equilibrium


def _solve_along(task: PlanTask, first: Equilibrium, points: Array) -> tuple[list[Equilibrium], str]:
    """Equilibria with tips at positions (P, 3), each from the one before, and the reason for an early end or ""."""
    out: list[Equilibrium] = []
    required = min(task.min_margin + task.margin_reserve, max(first.margin - 1e-4, task.min_margin))
    try:
        session = IkSession(first.robot, start=first, **inverse_constraints(task, required, math.inf))
        out.append(first)
        for point in points[1:]:
            if task.clock.over:
                return out, "no answer was found in time"
            out.append(session.solve(point).equilibrium)
    except (InputError, SolveError) as error:
        return out, str(error)
    return out, ""


def distance_from(curve: Array, points: Array) -> Array:
    """(T,) distance of points (T, 3) from a polyline (k, 3), m."""
    if len(curve) < 2:  # an arm of length zero is a point
        return np.asarray(np.linalg.norm(points - curve[0], axis=1))
    a, b = curve[:-1], curve[1:]
    along = b - a
    square = np.maximum((along**2).sum(1), 1e-300)
    out = np.empty(len(points))
    for k, p in enumerate(points):
        x = np.clip(((p - a) * along).sum(1) / square, 0.0, 1.0)
        out[k] = np.linalg.norm(p - a - x[:, None] * along, axis=1).min()
    return out


# The length changes by 1 / 75 from one to the next, so that the last fit is a good start of the next.
LENGTHS = 60
"""Number of arm lengths for the fit of the arm to the one at the goal."""

# Each fit starts at the one before.
ITERATIONS, LAST_STEP = 6, 1e-3
"""Maximum number of Gauss-Newton steps per length, and the step size, in units of the scales, that ends them."""

DIFFERENCE = 1e-5
"""Step of finite differences, in units of the scales of the joints."""

# Rotations of a straight section do not change the shape, and must not drift.
DAMPING = 2e-3
"""Weight of a change of the joints relative to the distance over the robot's length."""

LONGEST_STEP = 0.15
"""Largest change of a coordinate per step, in units of the scales."""


@typed
@small
def follow_the_leader(
    robot: Robot,
    goal: Any,
    *,
    start_fraction: float = 0.2,
    obstacles: Sequence[Obstacle] = (),
    min_margin: float = MIN_MARGIN,
    rate_limits: RateLimits = DEFAULT_RATES,
    limits: JointLimits | None = None,
    options: PlanOptions = DEFAULT_PLAN,
) -> Trajectory:
    """Plan a deployment that keeps the arm close to the path of its own tip.

    Args:
        goal: as for `plan_trajectory`; of several equilibria, the one with the largest margin.
        start_fraction: initial length of the arm as a fraction of its length at the goal, in (0, 1).
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
    if not 0 < finite("start_fraction", start_fraction) < 1:
        raise InputError(f"start_fraction is {start_fraction:g}; it must be between 0 and 1")
    task = plan_task(robot, obstacles, min_margin, rate_limits, limits, options, configurations=(goal,))
    with task.in_time():
        last = _goal(task, goal)
        if not float(last.arc_length[-1]) > 0:
            raise InputError("goal has no tube in front of the plate; deployment needs an arm there")
        path = [task.coordinates.of(last)]
        for fraction in np.linspace(1.0, start_fraction, LENGTHS + 1)[1:]:
            path.append(_fit(task, path[-1], last, fraction * float(last.arc_length[-1])))
        q = task.coordinates.joints(np.array(path))
    q[0] = task.coordinates.space.join(last.rotations, last.translations)
    retraction = track(task, last, q)
    if len(retraction) < len(q):
        raise SolveError("the arm snaps during retraction")
    first = retraction[-1]
    result = passing(task, first, q[::-1], path[0], "leader")
    if not isinstance(result, Trajectory):
        raise SolveError(f"the deployment cannot be proved: {'; '.join(result)}")
    tip_path = np.concatenate([first.position, result.tip_position[1:]])
    return replace(result, deviation=np.array([distance_from(tip_path, e.position).max() for e in result.arms]))


def _goal(task: PlanTask, goal: Any) -> Equilibrium:
    """Equilibrium at a goal; raises InputError if the goal has several."""
    space = task.coordinates.space
    check_goal(space.robot, goal)
    if isinstance(goal, Equilibrium):
        ends(task, goal, goal)
        return goal
    home = start_equilibrium(space, space.split(space.middle()))
    end = ends(task, home, goal)[0]
    equilibrium = forward_kinematics(space.robot, *space.split(end.joints))
    if np.abs(task.coordinates.of(equilibrium) - end.point).max() > 1e-6:
        raise InputError("goal has several equilibria; give an Equilibrium")
    return equilibrium


def _fit(task: PlanTask, z: Array, last: Equilibrium, length: float) -> Array:
    """Tip coordinates (m,) of the arm of a length (m) that lies closest to the arm `last`, from the start `z`."""
    space = task.coordinates.space
    m = len(z)
    z = _retracted(task, z, length)
    for _ in range(ITERATIONS):
        moves = np.vstack([np.zeros(m), DIFFERENCE * np.diag(task.scale)])
        arms = task.arms(z + moves)
        s, line = arms.fine()
        target = np.column_stack([np.interp(s[0], last.arc_length, last.position[:, k]) for k in range(3)])
        residual = (line - target).reshape(m + 1, -1) / space.length / np.sqrt(len(target))
        rotation = ((arms.rotations[1:] - arms.rotations[0]) / DIFFERENCE).T
        constraints = _constraints(task, z, arms.rotations[0], rotation, LONGEST_STEP)
        scaled = damped_step(residual, DIFFERENCE, DAMPING, constraints)
        if scaled is None:
            break
        step, fraction = scaled * task.scale, 1.0
        while fraction > 0.05 and not task.holds((z + fraction * step)[None])[0]:
            fraction /= 2
        if fraction <= 0.05:
            break
        z = z + fraction * step
        if np.abs(scaled).max() < LAST_STEP:
            break
    return z


def _foremost(task: PlanTask, z: Array) -> tuple[int, int]:
    """Number of the tube at the tip, and number of its carriage."""
    space = task.coordinates.space
    curved = np.array([tube.curved_length for tube in space.robot.tubes])
    tube = int(last_tube(task.coordinates.translations(z[None])[0] + curved))
    return tube, next(k for k, tubes in enumerate(space.carriages) if tube in tubes)


def _retracted(task: PlanTask, z: Array, length: float) -> Array:
    """Tip coordinates with the foremost carriage retracted to an arm length, m, and others as far as necessary."""
    space, n, m = task.coordinates.space, task.coordinates.space.robot.n_tubes, len(z)
    out, (tube, k) = z.copy(), _foremost(task, z)
    fixed, position = np.eye(m)[n + k], length - space.robot.tubes[tube].curved_length - space.offset[n + tube]
    out[n + k] = np.clip(position, space.lower[n + k], space.upper[n + k])
    rows, bounds = space.inequalities(out)
    rows, bounds = np.vstack([rows, fixed, -fixed]), np.append(bounds, [0.0, 0.0])
    shifts = np.abs(rows[:, n:]).sum(1) > 0
    solution = constrained_least_squares(np.eye(m - n), np.zeros(m - n), rows[shifts, n:], bounds[shifts])
    if solution is not None:
        out[n:] += solution.x
    return out


def _constraints(task: PlanTask, z: Array, rotations: Array, slope: Array, longest: float) -> tuple[Array, Array]:
    """Constraints, rows d >= bounds, of a step d in units of the scales: ranges, order, arm length, step size."""
    space, n = task.coordinates.space, task.coordinates.space.robot.n_tubes
    rows, bounds = step_constraints(task, z, longest)
    fixed = np.eye(len(z))[n + _foremost(task, z)[1]]
    low, high = np.minimum(space.lower[:n] - rotations, 0.0), np.minimum(rotations - space.upper[:n], 0.0)
    return np.vstack([slope, -slope, rows, fixed, -fixed]), np.concatenate([low, high, bounds, np.zeros(2)])
