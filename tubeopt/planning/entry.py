"""Plans whose plate may be placed: a region of entry points and a cone of directions, from which one is chosen.

Many places of the plate are looked at cheaply, by arms of random joint values: how close one that is clear of bodies
comes to the goal. Plans are then made from the most promising ones, until one is found and proved.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypedDict, Unpack

import numpy as np
import scipy

from ..arguments import typed
from ..bodies.anatomy import seen_from
from ..bodies.frames import Frame
from ..bodies.obstacles import Obstacle, nearest_distance
from ..display import Displayed
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, instance, positive, vector, whole
from ..files.field_metadata import REGION, usual_length
from ..robots.limits import JointLimits
from ..robots.robot import Robot
from ..solvers.sampling import sobol
from ..typing import Array
from .arms import Lines
from .goals import TipGoal, check_goal, checked_places, goal_seen, of_the_tip, start_equilibrium
from .motion import RateLimits
from .plan import plan_trajectory
from .question import DEFAULT_PLAN, PlanOptions, PlanTask, asked
from .trajectory import Entry, Trajectory

# They rank poses of the plate; plans decide.
ARMS, NEAREST_ARMS, POINTS = 1024, 12, 48
"""Random arms that rank poses of the plate, those considered per goal position (nearest first), and points of each."""

# A pose that leads nowhere must not use up the time of those after it.
SPLIT = 4
"""While more than so many poses of the plate remain, each gets this fraction of the remaining time."""

MOST = 16384
"""Places of the plate that can be looked at."""


@typed
@dataclass(frozen=True, eq=False)
class EntryRegion(Displayed):
    """Allowed positions and orientations of the base plate, in the frame of the given plate.

    Raises:
        InputError: more than one of radius, box and places, none of them and no cone, or numbers out of range.
    """

    radius: float = 0.0
    """Radius of the disc normal to the plate's z axis, m."""
    box: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Half extents along x, y and z, m."""
    places: Array | None = field(default=None, repr=False)
    """(N, 3) points in place of a disc or box, m."""
    cone: float = 0.0
    """Half angle of the cone about z, rad, below a right one."""

    def __post_init__(self) -> None:
        usual_length("radius of the entry", self.radius, REGION, zero=True)
        for size in vector("box of the entry", self.box, 3, "along x, y and z"):
            usual_length("box of the entry", size, REGION, zero=True)
        if self.places is not None:
            object.__setattr__(self, "places", checked_places(self.places, "places of the entry"))
        positive("cone of the entry", self.cone, zero=True)
        if self.cone >= np.pi / 2:
            raise InputError(f"cone of the entry is {np.degrees(self.cone):g} deg; it must be less than 90 deg")
        if (self.radius > 0) + any(self.box) + (self.places is not None) > 1:
            raise InputError("the entry has several regions; it must have one of a radius, a box, and places")
        if not (self.radius or any(self.box) or self.places is not None or self.cone):
            raise InputError("the entry has no freedom; it must have a radius, a box, places or a cone")

    def frames(self, count: int, seed: int = 0) -> list[Frame]:
        """Places of the plate, spread evenly, the first as it is given: without a tilt, and in the middle of a disc
        or box. Of places that are given there is each, however small the count."""
        count = max(whole("count", count, 1), 0 if self.places is None else len(self.places))
        if count > MOST:
            raise InputError(f"the entry has {count} base poses to check; it must have at most {MOST}")
        unit = sobol(5, count, seed)
        unit[0] = 0.5, 0.5, 0.5, 0.0, 0.0
        if self.places is not None:
            points = self.places[np.arange(count) % len(self.places)]
            unit[: len(self.places), 3] = 0.0
        elif self.radius:
            far, turn = self.radius * np.sqrt(unit[:, 0]), 2 * np.pi * unit[:, 1]
            points = np.column_stack([far * np.cos(turn), far * np.sin(turn), 0 * far])
            points[0] = 0.0
        else:
            points = (2 * unit[:, :3] - 1) * np.array(self.box)
        tilt = np.arccos(1 - unit[:, 3] * (1 - np.cos(self.cone)))
        turn = 2 * np.pi * unit[:, 4]
        about = tilt[:, None] * np.column_stack([-np.sin(turn), np.cos(turn), 0 * turn])
        axes = scipy.spatial.transform.Rotation.from_rotvec(about).as_matrix()
        return [Frame(*each) for each in zip(axes, points, strict=True)]


class PlanGiven(TypedDict, total=False):
    """What `plan_trajectory` takes that says nothing of where the plate stands."""

    min_margin: float
    rate_limits: RateLimits
    limits: JointLimits | None


@typed
def plan_from_region(
    robot: Robot,
    start: Any,
    goal: Any,
    region: EntryRegion,
    *,
    obstacles: Sequence[Obstacle] = (),
    options: PlanOptions = DEFAULT_PLAN,
    count: int = 64,
    progress: Callable[[int, int], object] | None = None,
    **given: Unpack[PlanGiven],
) -> Trajectory:
    """A motion as of `plan_trajectory`, from a base plate that is placed within a region.

    Args:
        start, goal, obstacles, options: as for `plan_trajectory`; obstacles and tip positions in the frame of the given
            plate. The time limit covers the whole call.
        region: allowed poses of the plate.   count: number of poses considered.
        progress: called with the number of poses tried, and of all.
        given: min_margin, rate_limits and limits, as for `plan_trajectory`.

    Returns:
        The trajectory in the frame of the chosen plate; `entry` is its pose. It is the first pose that gave a plan, not
        the best one.

    Raises:
        InputError: as `plan_trajectory`.
        SolveError: no pose gave a plan in time.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> tip = tubeopt.forward_kinematics(robot, [0.5, 0.0]).tip_position
        >>> region = tubeopt.EntryRegion(radius=5e-3)
        >>> plan = tubeopt.plan_from_region(robot, ([0.0, 0.0], None), tip + [3e-3, 0.0, 0.0], region)
        >>> plan.proved
        True
    """
    instance("region", region, EntryRegion)
    check_goal(robot, goal)
    task = asked(robot, obstacles, options=options, places=(start, goal), **given)
    first = start_equilibrium(task.chart.space, start)
    frames = region.frames(count, options.seed)
    if progress is not None:
        progress(0, len(frames))
    score = _scores(task, first, goal, frames)
    order = [k for k in np.argsort(score, kind="stable").tolist() if np.isfinite(score[k])]
    if not order:
        raise SolveError(
            f"no plan exists from the {len(score)} checked base poses: at each the clearance "
            f"of the arm at the start is below {options.clearance * 1e3:g} mm"
        )

    def planned(frame: Frame, left: int) -> Trajectory:
        limit = max(task.clock.left / min(left, SPLIT), 1e-3)
        bodies, own = seen_from(frame, obstacles), replace(options, time_limit=limit)
        return plan_trajectory(robot, start, goal_seen(goal, frame), obstacles=bodies, options=own, **given)

    why, unproved, tried = "", None, 0
    for k in order:
        if task.clock.over:
            break
        frame, tried = frames[k], tried + 1
        try:
            plan = planned(frame, len(order) - tried + 1)
        except SolveError as error:
            why = why or str(error)
        else:
            plan = replace(plan, entry=Entry(frame, frame, len(score), len(order), tried))
            if plan.proved:
                return plan
            unproved = unproved or plan
        if progress is not None:
            progress(tried, len(order))
    if unproved is not None:
        return unproved
    raise SolveError(
        f"no plan was found from {len(score)} base poses; {len(order)} of them have a "
        f"collision-free start, and plans were tried from {tried}; for the most promising "
        f"one: {why or 'the time limit was reached'}"
    )


def _scores(task: PlanTask, first: Equilibrium, goal: Any, frames: Sequence[Frame]) -> Array:
    """(K,) m: how far one stays from the goal from every place, the less the better, as far as random arms tell;
    infinite where the start does not keep its clearance. Of the first places only, where half of the time is over."""
    of_tip = of_the_tip(goal)
    at_start = Lines.of([first], POINTS)
    arms = _random(task) if of_tip else Lines.of([start_equilibrium(task.chart.space, goal, name="goal")], POINTS)
    half, found = task.clock.part(0.5), list[float]()
    for frame in frames:
        if found and half.over:
            break
        if _room(task, at_start.placed(frame))[0] < task.clearance:
            found.append(np.inf)
        elif of_tip:
            found.append(_missed(task, arms, goal_seen(goal, frame), frame))
        else:
            found.append(max(task.clearance - _room(task, arms.placed(frame))[0], 0.0))
    return np.array(found)


def _random(task: PlanTask) -> Lines:
    """Stable arms of random joint values."""
    chart = task.chart
    arms = chart.arms(chart.space.sample(ARMS), task.min_margin)
    kept = np.flatnonzero(arms.stable)
    s = np.linspace(0.0, 1.0, POINTS) * arms.arc_length[kept, -1:]
    shown = s[:, :, None] <= arms.tube_end[kept][:, None, :] + 1e-12
    return Lines(arms.at(s, kept), np.where(shown, chart.radius, 0.0).max(2))


def _room(task: PlanTask, arms: Lines) -> Array:
    """(N,) distance of arms from bodies, m."""
    return np.asarray((nearest_distance(task.obstacles, arms.points) - arms.radius).min(1))


def _missed(task: PlanTask, arms: Lines, goal: TipGoal, frame: Frame) -> float:
    """How far arms that are turned about the plate's z, as they all may be, stay from a goal, and from their clearance,
    m: the least of both together."""
    least = np.inf
    tip = arms.points[:, -1]
    for place in goal.places():
        x, y, z = np.asarray(place.position, dtype=float)
        miss = np.hypot(np.hypot(tip[:, 0], tip[:, 1]) - np.hypot(x, y), tip[:, 2] - z)
        near = np.argsort(miss)[:NEAREST_ARMS]
        turn = np.arctan2(y, x) - np.arctan2(tip[near, 1], tip[near, 0])
        axes = scipy.spatial.transform.Rotation.from_rotvec(turn[:, None] * [0.0, 0.0, 1.0]).as_matrix()
        turned = Lines(frame.placed(arms.points[near] @ axes.transpose(0, 2, 1)), arms.radius[near])
        short = np.maximum(task.clearance - _room(task, turned), 0.0)
        least = min(least, float((miss[near] + short).min(initial=np.inf)))
    return least
