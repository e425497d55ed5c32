"""Following a curve with the tip, within a tolerance, on one stable branch."""

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
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError
from ..files.field_metadata import TOLERATED, usual_length
from ..inverse import IkSession, inverse_kinematics
from ..robots.limits import JointLimits, check_target
from ..robots.robot import Robot
from ..solvers.blas import small
from ..typing import Array
from .goals import check_start, checked_places, kept, start_equilibrium
from .motion import DEFAULT_RATES, RateLimits
from .question import DEFAULT_PLAN, PlanOptions, PlanTask, asked
from .reach import least_miss
from .trajectory import Trajectory
from .trajectory_building import passing

LONGEST = 1000
"""Length of a curve for the tip, in that of the longest tube: a longer one is a mistake in units."""


SPACING, REFINEMENTS = 0.008, 3
"""Initial spacing of the solved points, as a share of the robot's length, and times that it is halved where the tip
leaves the curve in between."""

DENSE = 40
"""Points per piece of a spline at which it is sampled."""

STARTS, STARTS_SHARE = 8, 0.3
"""Maximum number of starting configurations, and share of the remaining time for finding them."""


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
    min_margin: float = 0.05,
    rate_limits: RateLimits = DEFAULT_RATES,
    limits: JointLimits | None = None,
    options: PlanOptions = DEFAULT_PLAN,
) -> Trajectory:
    """A motion in which the tip moves along a curve; the null space raises the margin.

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
    usual_length("tolerance", tolerance, TOLERATED)
    task = asked(robot, obstacles, min_margin, rate_limits, limits, options, places=(start,))
    clock = task.clock
    curve = _curve(path, spline)
    check_target(robot.tubes, "path", checked_places(path, "path"))
    length = float(np.linalg.norm(np.diff(curve, axis=0), axis=1).sum())
    longest = LONGEST * max(tube.length for tube in robot.tubes)
    if length > longest:
        raise InputError(
            f"path is {length:.6g} m long; it must be at most {longest:g} m, {LONGEST} times the longest tube"
        )
    furthest, reason = 0.0, "the first point is out of reach"
    for first in _starts(task, curve, start, tolerance):
        spacing = SPACING * task.chart.space.length
        for _ in range(REFINEMENTS + 1):
            places = _spaced(curve, spacing)
            equilibria, why = _track(task, first, places)
            share = len(equilibria) / len(places)
            if share < 1:
                if share >= furthest:
                    furthest, reason = share, why
                break
            q = np.array([task.chart.space.join(e.rotations, e.translations) for e in equilibria])
            made = passing(task, first, q, task.chart.of(equilibria[-1]), "tip path", len(q))
            if isinstance(made, Trajectory):
                off = distance_from(curve, made.tip_position)
                if off.max() <= tolerance:
                    return replace(made, deviation=off)
                made = ("between its points the tip leaves the curve",)
            reason = "; ".join(made)
            furthest, spacing = 1.0, spacing / 2
            if clock.over:
                break
        if clock.over:
            reason += f"; the time limit of {clock.limit:g} s is reached"
            break
    raise SolveError(f"the tip can follow {100 * furthest:.1f} % of the curve: {reason}")


def _curve(path: ArrayLike, spline: bool) -> Array:
    """(k, 3) dense points of the curve."""
    points = checked_places(path, "path")
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


def _spaced(curve: Array, spacing: float) -> Array:
    """Points of a polyline at most `spacing` (m) apart, its corners among them."""
    out = [curve[:1]]
    for a, b in pairwise(curve):
        count = max(1, int(np.ceil(np.linalg.norm(b - a) / spacing)))
        out.append(a + (b - a) * (np.arange(1, count + 1) / count)[:, None])
    return np.concatenate(out)


def _starts(task: PlanTask, curve: Array, start: Any, tolerance: float) -> Iterator[Equilibrium]:
    if start is not None:
        first = start_equilibrium(task.chart.space, start)
        check_start(task, first)
        off = float(np.linalg.norm(first.tip_position - curve[0]))
        if off > tolerance:
            raise InputError(
                f"the tip at start is {off * 1e3:.4g} mm from the first point of the path; "
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
    asks = kept(task, task.min_margin, STARTS_SHARE * task.clock.left)
    for answer in inverse_kinematics(task.chart.space.robot, curve[0], all_solutions=True, **asks)[:STARTS]:
        yield answer.equilibrium


def _track(task: PlanTask, first: Equilibrium, places: Array) -> tuple[list[Equilibrium], str]:
    """Equilibria with their tips at the places, each followed from the last, and why they end before the last one."""
    out: list[Equilibrium] = []
    floor = min(task.min_margin + task.margin_room, max(first.margin - 1e-4, task.min_margin))
    try:
        session = IkSession(first.robot, start=first, **kept(task, floor, math.inf))
        out.append(first)
        for place in places[1:]:
            if task.clock.over:
                return out, "no answer was found in time"
            out.append(session.solve(place).equilibrium)
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
