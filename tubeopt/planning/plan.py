"""Plan a trajectory: goal, search, smoothing, timing, proof; also from a base plate that may be moved.

Within a region of entry points and a cone of directions, many poses of the plate are ranked cheaply by arms with random
joint values: how close a collision-free one comes to the goal. Plans are then made from the most promising poses, until
one is proved.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple, TypedDict, Unpack

import numpy as np
import scipy

from ..arguments import typed
from ..bodies.anatomy import bodies_in_frame
from ..bodies.distance_field import DistanceField
from ..bodies.frames import Frame
from ..bodies.obstacles import Obstacle, nearest_distance
from ..display import Displayed
from ..equilibrium.result import MIN_MARGIN, Equilibrium
from ..errors import InputError, SolveError, instance, positive, vector, whole
from ..files.field_metadata import TYPICAL_REGION, typical_length
from ..inverse.clock import Clock, OutOfTimeError
from ..inverse.search import PathResult, find_path, shorten, without_corners
from ..robots.eccentric import by_model
from ..robots.limits import JointLimits
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.blas import small
from ..solvers.sampling import sobol
from ..typing import Array
from .arms import Lines
from .goals import (
    ENOUGH_ENDS,
    MAX_ENDS,
    End,
    TipGoal,
    check_goal,
    check_start,
    checked_points,
    goal_seen,
    of_the_tip,
    other_ends,
    requested_ends,
    start_equilibrium,
)
from .motion import DEFAULT_RATES, JointMotion, RateLimits
from .proof import TrajectoryRequirements, proved
from .question import DEFAULT_PLAN, PlanOptions, PlanTask, plan_task, reserve_deflection
from .smoothing import smooth
from .timing import Limits, actuators, at_full_speed, joint_curves, round_corners, stopping_at, through, track
from .trajectory import Entry, PlanStatistics, Trajectory


class CandidateMotion(NamedTuple):
    """Motion near a path, to be proved."""

    motion: JointMotion
    smoothed_for: str
    """Objective of its smoothing, "corners" if only corners are rounded, "" if it stops at them."""
    iterations: int
    """Number of iterations of the smoothing."""
    knots: int


# The rest is left to rounding corners and to the proof.
SMOOTHING_FRACTION, MIN_SMOOTHING = 0.5, 1.0
"""Maximum share of the remaining time for smoothing, since the proof needs the rest; and time, s, below which it is
skipped."""

# Distances are tables there. Rounded corners are rarely longer than the answer of the program.
SCANNED_SECONDS = 2.5
"""Maximum duration of smoothing for length among scanned obstacles, s."""

# Lengths are sums over samples, which cut corners.
SAME_LENGTH = 2e-3
"""Largest relative difference of lengths and durations that count as equal."""

# Forward kinematics follows every spacing from end to end.
ROUNDING_SECONDS, ROUNDING_FRACTION = 5.0, 0.3
"""Maximum duration of rounding corners, s, and share of the time that smoothing leaves."""


def motions_near(task: PlanTask, first: Equilibrium, points: Array) -> list[CandidateMotion]:
    """Time-optimal motions near a path (k, m), best first; the last is the path itself, with stops at its corners.

    A motion smoothed for length is neither longer nor slower than the path; one smoothed for time is no slower than
    that, nor than the motion smoothed for length.
    """
    clock, limits, aim, extra = task.clock, actuators(task, first), task.options.objective, task.options.extra_cost
    curves = joint_curves(task, points)
    resting = stopping_at(curves, limits)
    candidates = list[CandidateMotion]()
    scanned = aim == "length" and extra is None and any(isinstance(body, DistanceField) for body in task.obstacles)
    max_seconds = SCANNED_SECONDS * clock.parallel_slowdown if scanned else task.options.smoothing_seconds
    smoothing_clock = Clock(min(max_seconds, SMOOTHING_FRACTION * clock.left), clock)
    for name in ("length", "time") if aim == "time" else (aim,):
        if aim == "none" or smoothing_clock.left < MIN_SMOOTHING or not _worth_smoothing(task, curves):
            break
        best = smooth(task, first, points, limits, name, smoothing_clock)
        if best is not None:
            exact = name == "margin" or extra is not None
            joints = best.motion.sampled(task.scale)[1]
            rounder = None if exact else round_corners(task, first, joints, best.points[-1], limits, smoothing_clock)
            motion = best.motion if name == "effort" else rounder or at_full_speed(best.motion, limits)
            candidates.append(CandidateMotion(motion, name, best.iterations, len(best.points)))
    if aim in ("length", "time") and extra is None:
        remaining = Clock(min(ROUNDING_SECONDS * clock.parallel_slowdown, ROUNDING_FRACTION * clock.left), clock)
        joints = np.concatenate(curves)
        if (
            len(curves) > 1
            and (corners := round_corners(task, first, joints, points[-1], limits, remaining)) is not None
        ):
            candidates.append(CandidateMotion(corners, "corners", 0, len(points)))
        if aim == "time":
            candidates = [each for each in candidates if each.motion.duration <= resting.duration]
            candidates.sort(key=lambda each: each.motion.duration)
        else:
            longest, slowest = (x * (1 + SAME_LENGTH) for x in (resting.length(task.scale), resting.duration))
            lengths = [(each.motion.length(task.scale), each) for each in candidates if each.motion.duration <= slowest]
            candidates = [each for length, each in sorted(lengths, key=lambda pair: pair[0]) if length <= longest]
    return [*candidates, CandidateMotion(resting, "", 0, len(points))]


WORTH, WORTH_AMONG_BODIES = 0.02, 0.1
"""Relative excess of a path over the straight line that justifies smoothing for length, in free space and among
obstacles, where it takes twice as long."""

# Round-off: start and goal are the same joint values.
SHORT = 1e-9
"""Length of a path, in units of the joint scales, below which it is not smoothed."""


def _worth_smoothing(task: PlanTask, curves: Sequence[Array]) -> bool:
    """True if a path, curves of joint values (k, m), can become much shorter: none is shorter than the straight line.

    Among bodies smoothing takes twice as long; its equations are those of fixed sections without a load.
    """
    options = task.options
    if task.coordinates.load is not None or not task.coordinates.space.robot.fixed_sections:
        return False
    length = sum(float(np.linalg.norm(np.diff(q / task.scale, axis=0), axis=1).sum()) for q in curves)
    if length < SHORT or options.objective != "length" or options.extra_cost is not None:
        return length >= SHORT
    straight = float(np.linalg.norm((curves[-1][-1] - curves[0][0]) / task.scale))
    return 1 - straight / length > (WORTH_AMONG_BODIES if task.obstacles else WORTH)


Faults = tuple[str, ...]


# Between the points of its grid the tip can be a little too fast. A larger excess has another cause.
MAX_OVERSPEED = 1.1
"""Largest ratio of the tip speed to its limit that is repaired by slowing the motion down."""

# A motion without its end is useless.
EXTRA_SECONDS = 0.25
"""Largest overrun of the time limit for following an unproved motion to its end, s."""


def build(
    task: PlanTask, first: Equilibrium, end: End | None, motion: JointMotion, statistics: PlanStatistics
) -> Trajectory | Faults:
    """Sample a motion, make its ends exact, and prove it as far as time allows; returns its faults if it has any.

    `statistics` of the search are completed by length and duration of the proof.
    """
    rates, clock, space = task.rates, task.clock, task.coordinates.space
    t, q = motion.sampled(task.scale)
    start = space.join(first.rotations, first.translations)
    last = q[-1] if end is None else end.joints
    # Differences at the ends are spread over the motion by a cubic that is at rest at both ends.
    x = (t / t[-1] if t[-1] > 0 else np.ones(len(t)))[:, None]
    blend = x * x * (3 - 2 * x)
    q = q + (start - q[0]) * (1 - blend) + (last - q[-1]) * blend
    q[0], q[-1] = start, last
    q = np.clip(q, np.minimum(space.lower, start), np.maximum(space.upper, start))
    table = np.array([space.joint(row) for row in q])
    table[0] = [*first.rotations, *first.translations]
    n = space.robot.n_tubes
    margin, clearance = task.min_margin - 1e-6, task.clearance - task.reserve
    requirements = TrajectoryRequirements(task.obstacles, margin, clearance, rates, space.limits, task.max_force)
    proof = proved(first, t, table, requirements, clock)
    if not (proof.holds or proof.open):
        overspeed = 1.0 if rates.tip is None else proof.largest_tip_rate / rates.tip
        if 1 < overspeed < MAX_OVERSPEED and len(proof.faults) == 1:
            return build(task, first, end, motion.slower(overspeed), statistics)
        return proof.faults
    # An unfinished proof may not have reached the last samples.
    extra_clock = Clock(EXTRA_SECONDS)
    arms = (*proof.samples, *track(task, proof.samples[-1], q[len(proof.samples) :], extra_clock))
    if len(arms) < len(q):
        return (no_time(clock),)
    if end is not None and float(np.abs(task.coordinates.of(arms[-1]) - end.point).max()) > 1e-3:
        return (*proof.faults, "the motion ends on another branch than that of the goal")
    length = float(np.linalg.norm(np.diff(q / task.scale, axis=0), axis=1).sum())
    seconds = clock.seconds
    proof_seconds = seconds - statistics.search_seconds - statistics.smooth_seconds
    return Trajectory(
        robot=first.robot,
        time=t,
        rotations=table[:, :n],
        translations=table[:, n:],
        arms=arms,
        start=first,
        turns=(0,) * n if end is None else end.turns,
        obstacles=task.obstacles,
        min_margin=task.min_margin,
        min_clearance=task.clearance - task.reserve,
        rate_limits=rates,
        proof=proof,
        statistics=replace(statistics, length=length, proof_seconds=proof_seconds, seconds=seconds),
    )


def passing(
    task: PlanTask, first: Equilibrium, q: Array, last: Array, how: str, motions: int = 0
) -> Trajectory | Faults:
    """Time-optimal trajectory through joint values (k, m), or the messages on its faults.

    `how` and `motions`: method of the search and number of motions that it checked.
    """
    statistics = PlanStatistics(how=how, motions=motions, knots=len(q), search_seconds=task.clock.seconds)
    motion = through(q, task.scale, actuators(task, first))
    end = End(last, q[-1], (0,) * first.robot.n_tubes)
    result = build(task, first, end, motion, statistics)
    if isinstance(result, Trajectory):  # without smoothing both lengths are equal
        return replace(result, statistics=replace(result.statistics, raw_length=result.statistics.length))
    return result


def no_time(clock: Clock) -> str:
    """Fault when the time limit is reached."""
    return f"the time limit of {clock.limit:g} s left no time to follow the path found"


@typed
@by_model
@small
def plan_trajectory(  # noqa: PLR0913
    robot: Robot,
    start: Any,
    goal: Any,
    *,
    obstacles: Sequence[Obstacle] = (),
    min_margin: float = MIN_MARGIN,
    rate_limits: RateLimits = DEFAULT_RATES,
    limits: JointLimits | None = None,
    options: PlanOptions = DEFAULT_PLAN,
    load: Load | None = None,
) -> Trajectory:
    """A motion from one equilibrium to another that stays on one stable branch, with its proof.

    Args:
        start: an Equilibrium, an InverseSolution, or a pair (rotations, translations) for its `forward_kinematics`.
        goal: an Equilibrium or InverseSolution (joint values with their branch), a pair (rotations, translations) on
            any branch, a tip position (3,), m, or a `TipGoal`.
        obstacles: bodies that the whole arm avoids by `options.clearance`.
        min_margin: smallest margin along the whole path, in [0, 1).
        rate_limits: limits of the actuators.   limits: range of every joint; by default `robot.limits`.
        options: search, objective of smoothing, time limit, and so on.
        load: constant external load; a start without it is first loaded. Margin, clearance and rates are those of the
            loaded robot. Its path is shortened and rounded, but not smoothed by a program.

    Raises:
        InputError: start, goal or numbers out of range, or a load for which nothing is proved (see
            `verify_trajectory`). A load together with a roadmap or a cost of smoothing.
        SolveError: no plan exists (reported before the search), or none was found in time. The trajectory that comes
            closest to the goal is then `.solution`, or None; the message says why it ends there.

    The time limit covers the whole call. A motion with an unfinished proof is returned with `.proved` False; `.status`
    states how much of it was followed.

    Examples:
        >>> import numpy as np
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> plan = tubeopt.plan_trajectory(robot, ([0, 0, 0], None), (np.radians([90, 0, 0]), None))
        >>> plan.proved
        True
    """
    task = plan_task(robot, obstacles, min_margin, rate_limits, limits, options, load, (start, goal))
    check_goal(robot, goal)
    with task.in_time():
        return _planned(task, start, goal)


# Each attempt triples the reserve of the margin. Where the third fails, the violation is between the checked points of
# any path there.
ATTEMPTS = 3
"""Maximum number of attempts: a failed proof is followed by a plan with more clearance and other random numbers."""


def _planned(task: PlanTask, start: Any, goal: Any) -> Trajectory:
    """Plan of a task; raises as `plan_trajectory`, and OutOfTimeError."""
    coordinates, options = task.coordinates, task.options
    first = start_equilibrium(coordinates.space, start, coordinates.load)
    task = reserve_deflection(task, first.translations)
    check_start(task, first)
    quick = options.roadmap is not None and options.objective == "none" and of_the_tip(goal)
    goals = requested_ends(task, first, goal, 1 if quick else ENOUGH_ENDS)
    n = len(first.translations)
    task = reserve_deflection(task, first.translations, *(coordinates.space.joint(end.joints)[n:] for end in goals))
    task = _between(task, first, goals)
    faults: Faults = ()
    for attempt in range(ATTEMPTS):
        search = _search(task, first, goal, goals, options.seed + attempt)
        task, goals, path = search.task, search.goals, search.path
        if path.points is None:
            raise _search_error(task, first, goals, path)
        last = path.points[-1]
        end = min(goals, key=lambda each: float(np.abs(each.point - last).max()))
        result = _smooth_and_prove(task, first, end, path)
        if isinstance(result, Trajectory):
            return result
        faults = result
        if task.clock.over:
            break
        task = _between(task.with_larger_reserves(), first, goals)
    raise SolveError(f"no provable trajectory was found: {'; '.join(faults)}")


def _between(task: PlanTask, first: Equilibrium, goals: Sequence[End]) -> PlanTask:
    return task.from_to(task.coordinates.of(first), *(end.point for end in goals))


class _Search(NamedTuple):
    """Result of a search, with its goals and its task."""

    task: PlanTask
    goals: list[End]
    path: PathResult


# A search that uses all of the time leaves none to follow its path.
SEARCH_FRACTION = 0.9
"""Share of the time limit after which the search ends, so that the result can be reported in time."""

# The partial path is timed and followed, and the cause of the failure is searched.
REPORT_SECONDS, REPORT_FRACTION = 2.0, 0.35
"""Time reserved for the report, s, and its largest fraction of the time limit."""

# All configurations of a target take inverse kinematics seconds, which a short search needs itself.
POSTURES_SECONDS, NEAREST_FRACTION = 15.0, 0.4
"""Time, s, below which only the nearest configuration for a tip goal is tried; share of it for that one if others
follow."""

# The other part is for a search from scratch.
ROADMAP_FRACTION = 0.3
"""Fraction of the search time for a roadmap, which is tried first."""


def _search(task: PlanTask, first: Equilibrium, goal: Any, goals: list[End], seed: int) -> _Search:
    """Path to one of the goals; without any to a tip goal, a path to other configurations with that tip."""
    options, clock = task.options, task.clock
    until = options.time_limit - min(REPORT_SECONDS, REPORT_FRACTION * options.time_limit)
    left = max(0.0, min(SEARCH_FRACTION * options.time_limit, until) - clock.seconds)
    postures = of_the_tip(goal) and left > POSTURES_SECONDS
    start = task.coordinates.of(first)
    if options.roadmap is not None:
        path = options.roadmap.shortest_path(task, start, [end.point for end in goals], Clock(ROADMAP_FRACTION * left))
        if path.points is None and len(goals) < ENOUGH_ENDS and of_the_tip(goal):
            goals = requested_ends(task, first, goal, ENOUGH_ENDS)
            task = _between(task, first, goals)
            remaining = Clock(ROADMAP_FRACTION * max(0.0, left - clock.seconds))
            path = options.roadmap.shortest_path(task, start, [end.point for end in goals], remaining)
        if path.points is not None:
            return _Search(task, goals, path)
        left = max(0.0, until - clock.seconds)
    search = Clock(NEAREST_FRACTION * left if postures else left)
    find = partial(find_path, how=options.method, improving=options.search_seconds)
    path = find(task, start, [end.point for end in goals], search, seed=seed)
    if path.impossible and (of_the_tip(goal) or len(goals) == MAX_ENDS or task.coordinates.load is not None):
        path = replace(
            path, impossible=False, why=f"{path.why} (for the tried configurations; others may meet the goal)"
        )
    if path.points is not None or not postures:
        return _Search(task, goals, path)
    remaining = Clock(left - search.seconds)
    more = other_ends(task, first, goal, goals, remaining.part(0.5), modulo_turns=options.modulo_turns)
    goals = [*goals, *more]
    task = _between(task, first, goals)
    second = find(task, start, [end.point for end in more or goals], remaining, seed=seed + 1)
    return _Search(task, goals, replace(second, motions=path.motions + second.motions, impossible=False))


# Up to sixty random shortcuts are tried, each of which checks one motion.
SHORTEN_SECONDS, SHORTEN_FRACTION = 2.0, 0.3
"""Maximum duration of shortcutting, s, and fraction of the remaining time."""


def _smooth_and_prove(task: PlanTask, first: Equilibrium, end: End, path: PathResult) -> Trajectory | Faults:
    """Trajectory along a path: the first provable motion of `motions_near`; without any, the faults of the last one."""
    assert path.points is not None
    clock = task.clock
    searched = clock.seconds
    try:
        # The path of a roadmap is the shortest there: without smoothing, only unnecessary corners are left out.
        if path.how == "roadmap" and task.options.objective == "none":
            points = without_corners(task, path.points)
        else:
            cut = Clock(min(SHORTEN_SECONDS, SHORTEN_FRACTION * clock.left))
            points = shorten(task, path.points, cut, seed=task.options.seed)
        raw = task.length(path.points)
        motions = motions_near(task, first, points)
    except OutOfTimeError:
        return (no_time(clock),)
    smoothed = clock.seconds
    faults: Faults = ()
    for candidate in motions:
        statistics = PlanStatistics(
            how=path.how,
            smoothed=candidate.smoothed_for,
            motions=path.motions,
            raw_length=raw,
            iterations=candidate.iterations,
            knots=candidate.knots,
            search_seconds=searched,
            smooth_seconds=smoothed - searched,
        )
        result = build(task, first, end, candidate.motion, statistics)
        if isinstance(result, Trajectory):
            return result
        faults = result
    return faults


def _search_error(task: PlanTask, first: Equilibrium, goals: Sequence[End], path: PathResult) -> SolveError:
    """Error after a search without a path, with the partial trajectory that ends closest to the goal."""
    clock = task.clock
    if path.impossible:
        return SolveError(f"no plan exists: {path.why}")
    partial, distance = None, float("nan")
    if path.closest is not None and len(path.closest) > 1:
        distance = min(float(np.linalg.norm((path.closest[-1] - each.point) / task.scale)) for each in goals)
        points, motion = path.closest, None
        with suppress(OutOfTimeError):
            points, motion = _affordable(task, path.closest, actuators(task, first), clock.left)
        if motion is not None:
            statistics = PlanStatistics(
                how="partial", motions=path.motions, knots=len(points), search_seconds=clock.seconds
            )
            result = build(task, first, None, motion, statistics)
            partial = result if isinstance(result, Trajectory) and result.proof.holds else None
    nearest = f"; the closest state is {distance:.3g} (joint scales) from the goal" if distance == distance else ""
    why = f"; {path.why}" if path.why else ""
    count = "1 motion was" if path.motions == 1 else f"{path.motions} motions were"
    tried = f"{count} tried in {clock.seconds:.1f} s"
    return SolveError(f"no plan was found within {clock.limit:g} s: {tried}{nearest}{why}", partial)


# A partial motion is cut short so that its proof fits into the remaining time.
PROOF_SECONDS, PROOF_SECONDS_PER_SAMPLE = 0.1, 1e-3
"""Typical upper limits of the time of a proof, s: constant part, and per sample of the motion."""


def _affordable(task: PlanTask, points: Array, limits: Limits, left: float) -> tuple[Array, JointMotion | None]:
    """Longest first part of a path that should be provable within `left` seconds, as a motion with stops."""
    while len(points) > 1:
        motion = stopping_at(joint_curves(task, points), limits)
        samples = len(motion.sampled(task.scale)[0])
        needed = PROOF_SECONDS + PROOF_SECONDS_PER_SAMPLE * samples
        if needed <= left:
            return points, motion
        points = points[: min(len(points) - 1, int(len(points) * left / needed))]
    return points, None


MAX_BASE_POSES = 16384
"""Maximum number of poses of the plate."""


@typed
@dataclass(frozen=True, eq=False)
class EntryRegion(Displayed):
    """Allowed positions and orientations of the base plate, in the frame of the given plate.

    Raises:
        InputError: more than one of radius, box and positions, none of them and no cone, or numbers out of range.
    """

    radius: float = 0.0
    """Radius of the disc normal to the plate's z axis, m."""
    box: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Half extents along x, y and z, m."""
    positions: Array | None = field(default=None, repr=False)
    """(N, 3) points instead of a disc or box, m."""
    cone: float = 0.0
    """Half angle of the cone about z, rad, below a right one."""

    def __post_init__(self) -> None:
        typical_length("radius of the entry", self.radius, TYPICAL_REGION, zero=True)
        for size in vector("box of the entry", self.box, 3, "along x, y and z"):
            typical_length("box of the entry", size, TYPICAL_REGION, zero=True)
        if self.positions is not None:
            object.__setattr__(self, "positions", checked_points(self.positions, "positions of the entry"))
        positive("cone of the entry", self.cone, zero=True)
        if self.cone >= np.pi / 2:
            raise InputError(f"cone of the entry is {np.degrees(self.cone):g} deg; it must be less than 90 deg")
        if (self.radius > 0) + any(self.box) + (self.positions is not None) > 1:
            raise InputError("the entry has several regions; it must have one of a radius, a box, and positions")
        if not (self.radius or any(self.box) or self.positions is not None or self.cone):
            raise InputError("the entry has no freedom; it must have a radius, a box, positions or a cone")

    def frames(self, count: int, seed: int = 0) -> list[Frame]:
        """Evenly distributed poses of the plate; the first is not tilted and in the middle of a disc or box.

        Every one of given `positions` has a pose, even if `count` is smaller.
        """
        count = max(whole("count", count, 1), 0 if self.positions is None else len(self.positions))
        if count > MAX_BASE_POSES:
            raise InputError(f"the entry has {count} base poses to check; it must have at most {MAX_BASE_POSES}")
        unit = sobol(5, count, seed)
        unit[0] = 0.5, 0.5, 0.5, 0.0, 0.0
        if self.positions is not None:
            points = self.positions[np.arange(count) % len(self.positions)]
            unit[: len(self.positions), 3] = 0.0
        elif self.radius:
            # The root spreads points evenly over the area of a disc.
            far, turn = self.radius * np.sqrt(unit[:, 0]), 2 * np.pi * unit[:, 1]
            points = np.column_stack([far * np.cos(turn), far * np.sin(turn), 0 * far])
            points[0] = 0.0
        else:
            points = (2 * unit[:, :3] - 1) * np.array(self.box)
        # Evenly over the cap of the cone: its area grows with 1 - cos (Archimedes).
        tilt = np.arccos(1 - unit[:, 3] * (1 - np.cos(self.cone)))
        turn = 2 * np.pi * unit[:, 4]
        about = tilt[:, None] * np.column_stack([-np.sin(turn), np.cos(turn), 0 * turn])
        axes = scipy.spatial.transform.Rotation.from_rotvec(about).as_matrix()
        return [Frame(*each) for each in zip(axes, points, strict=True)]


class PlanInputs(TypedDict, total=False):
    """Arguments of `plan_trajectory` that do not depend on the pose of the plate."""

    min_margin: float
    rate_limits: RateLimits
    limits: JointLimits | None


# A pose without a plan must not use the time of those after it.
SPLIT = 4
"""Largest number of base poses that get equal parts of the time. Of more, each gets 1 / SPLIT of the remaining time."""


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
    **given: Unpack[PlanInputs],
) -> Trajectory:
    """Plan a trajectory, as `plan_trajectory`, from a base plate that may be placed within a region.

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
    task = plan_task(robot, obstacles, options=options, configurations=(start, goal), **given)
    first = start_equilibrium(task.coordinates.space, start)
    frames = region.frames(count, options.seed)
    if progress is not None:
        progress(0, len(frames))
    score = _scores(task, first, goal, frames)
    order = [k for k in np.argsort(score, kind="stable").tolist() if np.isfinite(score[k])]
    if not order:
        raise SolveError(
            f"no plan exists from the {len(score)} checked base poses: at each the clearance "
            f"of the arm at the start is below {task.clearance * 1e3:g} mm"
        )

    def planned(frame: Frame, left: int) -> Trajectory:
        limit = max(task.clock.left / min(left, SPLIT), 1e-3)
        bodies, plan_options = bodies_in_frame(frame, obstacles), replace(options, time_limit=limit)
        return plan_trajectory(robot, start, goal_seen(goal, frame), obstacles=bodies, options=plan_options, **given)

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


# They only rank poses of the plate; plans decide.
ARMS, NEAREST_ARMS, POINTS = 1024, 12, 48
"""Random arms that rank poses of the plate, those considered per goal position (nearest first), and points of each."""


def _scores(task: PlanTask, first: Equilibrium, goal: Any, frames: Sequence[Frame]) -> Array:
    """Scores (K,) of poses of the plate, m: distance of the closest random arm from the goal; smaller is better.

    Infinite where the start violates its clearance. Fewer than K if half of the time is over.
    """
    of_tip = of_the_tip(goal)
    at_start = Lines.of([first], POINTS)
    arms = (
        _random_arms(task)
        if of_tip
        else Lines.of([start_equilibrium(task.coordinates.space, goal, name="goal")], POINTS)
    )
    # The ranking must leave time for the plans.
    half, scores = task.clock.part(0.5), list[float]()
    for frame in frames:
        if scores and half.over:
            break
        if _clearance(task, at_start.placed(frame))[0] < task.clearance:
            scores.append(np.inf)
        elif of_tip:
            scores.append(_miss(task, arms, goal_seen(goal, frame), frame))
        else:
            scores.append(max(task.clearance - _clearance(task, arms.placed(frame))[0], 0.0))
    return np.array(scores)


def _random_arms(task: PlanTask) -> Lines:
    """Stable arms with random joint values."""
    coordinates = task.coordinates
    arms = coordinates.arms(coordinates.space.sample(ARMS), task.min_margin)
    stable = np.flatnonzero(arms.stable)
    s = np.linspace(0.0, 1.0, POINTS) * arms.arc_length[stable, -1:]
    exists = s[:, :, None] <= arms.tube_end[stable][:, None, :] + 1e-12
    return Lines(arms.at(s, stable), np.where(exists, coordinates.radius, 0.0).max(2))


def _clearance(task: PlanTask, arms: Lines) -> Array:
    """(N,) distances of arms from bodies, m."""
    return np.asarray((nearest_distance(task.obstacles, arms.points) - arms.radius).min(1))


def _miss(task: PlanTask, arms: Lines, goal: TipGoal, frame: Frame) -> float:
    """Smallest sum of distance from a goal and missing clearance over arms turned about the plate's z, m."""
    smallest = np.inf
    tip = arms.points[:, -1]
    for target in goal.single_goals():
        x, y, z = np.asarray(target.position, dtype=float)
        # Turned about z as a whole an arm remains an equilibrium: only radius and height of its tip matter.
        miss = np.hypot(np.hypot(tip[:, 0], tip[:, 1]) - np.hypot(x, y), tip[:, 2] - z)
        nearest = np.argsort(miss)[:NEAREST_ARMS]
        turn = np.arctan2(y, x) - np.arctan2(tip[nearest, 1], tip[nearest, 0])
        axes = scipy.spatial.transform.Rotation.from_rotvec(turn[:, None] * [0.0, 0.0, 1.0]).as_matrix()
        # Points are rows: R p is p @ R^T.
        rotated = Lines(frame.placed(arms.points[nearest] @ axes.transpose(0, 2, 1)), arms.radius[nearest])
        missing = np.maximum(task.clearance - _clearance(task, rotated), 0.0)
        smallest = min(smallest, float((miss[nearest] + missing).min(initial=np.inf)))
    return smallest
