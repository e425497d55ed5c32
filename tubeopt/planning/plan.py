"""Planning a trajectory: goal, search, smoothing, timing, proof; also from a plate that may be placed.

Of a region of entry points and a cone of directions many places of the plate are looked at cheaply, by arms of random
joint values: how close one that is clear of bodies comes to the goal. Plans are then made from the most promising ones,
until one is found and proved.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, TypedDict, Unpack

import numpy as np
import scipy

from ..arguments import typed
from ..bodies.anatomy import seen_from
from ..bodies.distance_field import DistanceField
from ..bodies.frames import Frame
from ..bodies.obstacles import Obstacle, nearest_distance
from ..display import Displayed
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, instance, positive, vector, whole
from ..files.field_metadata import REGION, usual_length
from ..inverse.clock import Clock, LateError
from ..inverse.search import Way, find_way, shorten, without_corners
from ..robots.limits import JointLimits
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.blas import small
from ..solvers.sampling import sobol
from ..typing import Array
from .arms import Lines
from .goals import (
    ENOUGH_ENDS,
    MOST_ENDS,
    End,
    TipGoal,
    asked_ends,
    check_goal,
    check_start,
    checked_places,
    goal_seen,
    of_the_tip,
    other_ends,
    start_equilibrium,
)
from .motion import DEFAULT_RATES, Motion, RateLimits
from .proof import Kept, proved
from .question import DEFAULT_PLAN, PlanOptions, PlanTask, asked, bearing
from .smoothing import smooth
from .timing import Limits, actuators, at_full_speed, joint_curves, stopping_at, through, track, violated
from .trajectory import Entry, PlanStatistics, Trajectory

Faults = tuple[str, ...]

# The rest is left to rounding corners and to the proof.
SMOOTHING_SHARE, LEAST_SMOOTHING = 0.5, 1.0
"""Maximum share of the remaining time for smoothing, since the proof needs the rest; and time, s, below which it is
skipped."""

# Distances are tables there. Rounded corners are rarely longer than the answer of the program.
SCANNED_SECONDS = 2.5
"""Maximum duration of smoothing for length among scanned obstacles, s."""

WORTH, WORTH_AMONG_BODIES = 0.02, 0.1
"""Relative excess of a path over the straight line that justifies smoothing for length, in free space and among
obstacles, where it takes twice as long."""

# Lengths are sums over samples, which cut corners.
SAME_LENGTH = 2e-3
"""Largest relative difference of equal lengths and durations."""

# Every spacing that is tried is followed by forward kinematics from end to end.
ROUNDING_SECONDS, ROUNDING_SHARE = 5.0, 0.3
"""Maximum duration of rounding corners, s, and share of the time that smoothing leaves."""

# The first is as round as a turn of a joint by 0.4 rad, the last all but the path itself. Each is about half of the
# one before, and so is what it cuts off the corners.
SPACINGS = (0.4, 0.2, 0.1, 0.05, 0.02, 0.01)
"""Spacings of the polyline points before rounding, in units of the joint scales, tried in turn."""

# Between the points of its grid the tip can be a little too fast. A motion that is faster than this has another fault.
MAX_OVERSPEED = 1.1
"""Largest ratio of the tip speed to its limit that is repaired by slowing the motion down."""

# A motion without its end is of no use.
LATE_SECONDS = 0.25
"""Largest overrun of the time limit for following an unproved motion to its end, s."""

# Round-off: start and goal are the same joint values.
SHORT = 1e-9
"""Length of a way (joints' scales) on which nothing is smoothed."""


def motions_near(task: PlanTask, first: Equilibrium, points: Array) -> list[tuple[Motion, str, int, int]]:
    """Motions near a way, the best first, and last the way itself with rests at its corners: each as fast as it may be,
    with the objective of its smoothing, iterations and knots.

    What is smoothed for length is neither longer nor slower than what it began from; what is smoothed for time is no
    slower than that, nor than what is smoothed for length.
    """
    clock, limits, aim, extra = task.clock, actuators(task, first), task.options.objective, task.options.extra_cost
    curves = joint_curves(task, points)
    resting = stopping_at(curves, limits)
    found = []
    scanned = aim == "length" and extra is None and any(isinstance(body, DistanceField) for body in task.obstacles)
    most = SCANNED_SECONDS * clock.parallel_slowdown if scanned else task.options.smoothing_seconds
    own = Clock(min(most, SMOOTHING_SHARE * clock.left), clock)
    for name in ("length", "time") if aim == "time" else (aim,):
        if aim == "none" or own.left < LEAST_SMOOTHING or not _worth_smoothing(task, curves):
            break
        best = smooth(task, first, points, limits, name, own)
        if best is not None:
            exact = name == "margin" or extra is not None
            way = best.motion.sampled(task.scale)[1], best.points[-1]
            rounder = None if exact else _rounded(task, first, way, limits, own)
            motion = best.motion if name == "effort" else rounder or at_full_speed(best.motion, limits)
            found.append((motion, name, best.iterations, len(best.points)))
    if aim in ("length", "time") and extra is None:
        rest = Clock(min(ROUNDING_SECONDS * clock.parallel_slowdown, ROUNDING_SHARE * clock.left), clock)
        way = np.concatenate(curves), points[-1]
        if len(curves) > 1 and (corners := _rounded(task, first, way, limits, rest)) is not None:
            found.append((corners, "corners", 0, len(points)))
        if aim == "time":
            found = [each for each in found if each[0].duration <= resting.duration]
            found.sort(key=lambda each: each[0].duration)
        else:
            longest, slowest = (x * (1 + SAME_LENGTH) for x in (resting.length(task.scale), resting.duration))
            short = [(each[0].length(task.scale), each) for each in found if each[0].duration <= slowest]
            found = [each for length, each in sorted(short, key=lambda pair: pair[0]) if length <= longest]
    return [*found, (resting, "", 0, len(points))]


def _worth_smoothing(task: PlanTask, curves: Sequence[Array]) -> bool:
    """Whether a way in joint space, curves of joint values (k, m), can become much shorter: none is shorter than the
    straight line. With bodies in the way smoothing takes twice as long; its equations are those without a load."""
    options = task.options
    if task.chart.load is not None:
        return False
    length = sum(float(np.linalg.norm(np.diff(q / task.scale, axis=0), axis=1).sum()) for q in curves)
    if length < SHORT or options.objective != "length" or options.extra_cost is not None:
        return length >= SHORT
    straight = float(np.linalg.norm((curves[-1][-1] - curves[0][0]) / task.scale))
    return 1 - straight / length > (WORTH_AMONG_BODIES if task.obstacles else WORTH)


def _rounded(
    task: PlanTask, first: Equilibrium, way: tuple[Array, Array], limits: Limits, clock: Clock
) -> Motion | None:
    """The fastest motion close to a way, its bends as round as they may be; None where even slight rounding leads where
    the robot may not be, or time is over. `way`: joint values (k, m), and the point of the chart (m,) at its end."""
    q, end = way
    for spacing in SPACINGS:
        if clock.over:
            return None
        motion = through(q, task.scale, limits, spacing)
        places = motion.time[-1:], end[None]
        if not violated(task, first, motion, clock, places)[0].any():
            return motion
    return None


def build(
    task: PlanTask, first: Equilibrium, end: End | None, motion: Motion, found: PlanStatistics
) -> Trajectory | Faults:
    """Sample a motion, make its ends exact, and prove it as far as there is time; where it has faults, these. What was
    `found` before is told with the length of what is made of it and the seconds of the proof."""
    rates, clock, space = task.rates, task.clock, task.chart.space
    t, q = motion.sampled(task.scale)
    begin = space.join(first.rotations, first.translations)
    last = q[-1] if end is None else end.joints
    x = (t / t[-1] if t[-1] > 0 else np.ones(len(t)))[:, None]
    blend = x * x * (3 - 2 * x)
    q = q + (begin - q[0]) * (1 - blend) + (last - q[-1]) * blend
    q[0], q[-1] = begin, last
    q = np.clip(q, np.minimum(space.lower, begin), np.maximum(space.upper, begin))
    table = np.array([space.joint(row) for row in q])
    table[0] = [*first.rotations, *first.translations]
    n = space.robot.n_tubes
    least, clearance = task.min_margin - 1e-6, task.clearance - task.reserve
    kept = Kept(task.obstacles, least, clearance, rates, space.limits, task.max_force)
    proof = proved(first, t, table, kept, clock)
    if not (proof.holds or proof.open):
        overspeed = 1.0 if rates.tip is None else proof.largest_tip_rate / rates.tip
        if 1 < overspeed < MAX_OVERSPEED and len(proof.faults) == 1:
            slower = motion.slower(overspeed)
            return build(task, first, end, slower, found)
        return proof.faults
    # A proof that time ended may not have come to the last of them.
    late = Clock(LATE_SECONDS)
    arms = (*proof.samples, *track(task, proof.samples[-1], q[len(proof.samples) :], late))
    if len(arms) < len(q):
        return (no_time(clock),)
    if end is not None and float(np.abs(task.chart.of(arms[-1]) - end.point).max()) > 1e-3:
        return (*proof.faults, "the motion ends on another branch than that of the goal")
    length = float(np.linalg.norm(np.diff(q / task.scale, axis=0), axis=1).sum())
    seconds = clock.seconds
    proving = seconds - found.search_seconds - found.smooth_seconds
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
        statistics=replace(found, length=length, proof_seconds=proving, seconds=seconds),
    )


def passing(
    task: PlanTask, first: Equilibrium, q: Array, last: Array, how: str, motions: int = 0
) -> Trajectory | Faults:
    """The fastest motion through joint values (k, m), from an equilibrium to the point `last` (m,) of the chart, with
    how these were found by looking at so many motions."""
    found = PlanStatistics(how, "", motions, 0.0, 0.0, 0, len(q), task.clock.seconds)
    motion = through(q, task.scale, actuators(task, first))
    end = End(last, q[-1], (0,) * first.robot.n_tubes)
    made = build(task, first, end, motion, found)
    if isinstance(made, Trajectory):  # nothing was smoothed
        return replace(made, statistics=replace(made.statistics, raw_length=made.statistics.length))
    return made


def no_time(clock: Clock) -> str:
    """What is wrong where the clock is over."""
    return f"the time limit of {clock.limit:g} s left no time to follow the path found"


# Each attempt triples the reserve of the margin. Where the third fails, what is missing lies between checked points of
# any path there.
ATTEMPTS = 3
"""Maximum number of attempts: a failed proof is followed by a plan with more clearance and other random numbers."""

# A search that uses up all of the time leaves none to follow the path that it has found.
SEARCH_SHARE = 0.9
"""Share of the time limit after which the search ends, so that the result can be reported in time."""

# The partial path is timed and followed, and why the search failed is looked into.
REPORT_SECONDS, REPORT_SHARE = 2.0, 0.35
"""Time reserved for the report: so many seconds, at most a share of the time limit."""

# All configurations of a target take inverse kinematics seconds, which a short search needs itself.
POSTURES_SECONDS, NEAREST_SHARE = 15.0, 0.4
"""Time, s, below which only the nearest configuration for a tip goal is tried; share of it for that one if others
follow."""

# The rest is left to a search from scratch.
ROADMAP_SHARE = 0.3
"""Share of the search time for a roadmap, which comes first."""

# Up to sixty random cuts are tried, each of which checks one motion.
SHORTEN_SECONDS, SHORTEN_SHARE = 2.0, 0.3
"""Maximum duration of cutting corners of the path, s, and share of the remaining time."""

# A motion whose proof would take longer than the time that is left is cut short.
PROOF_SECONDS, PROOF_SECONDS_PER_SAMPLE = 0.1, 1e-3
"""Typical upper limits of the time of a proof, s: in any case, and per sample of the motion."""


@typed
@small
def plan_trajectory(  # noqa: PLR0913
    robot: Robot,
    start: Any,
    goal: Any,
    *,
    obstacles: Sequence[Obstacle] = (),
    min_margin: float = 0.05,
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
    task = asked(robot, obstacles, min_margin, rate_limits, limits, options, load, (start, goal))
    check_goal(robot, goal)
    with task.in_time():
        return _planned(task, start, goal)


def _planned(task: PlanTask, start: Any, goal: Any) -> Trajectory:
    """The plan; raises as `plan_trajectory` does, and LateError."""
    chart, options = task.chart, task.options
    first = start_equilibrium(chart.space, start, chart.load)
    task = bearing(task, first.translations)
    check_start(task, first)
    hasty = options.roadmap is not None and options.objective == "none" and of_the_tip(goal)
    goals = asked_ends(task, first, goal, 1 if hasty else ENOUGH_ENDS)
    n = len(first.translations)
    task = bearing(task, first.translations, *(chart.space.joint(end.joints)[n:] for end in goals))
    task = _between(task, first, goals)
    faults: Faults = ()
    for attempt in range(ATTEMPTS):
        task, goals, way = _way(task, first, goal, goals, options.seed + attempt)
        if way.points is None:
            raise _not_found(task, first, goals, way)
        reached = way.points[-1]
        end = min(goals, key=lambda each: float(np.abs(each.point - reached).max()))
        made = _make(task, first, end, way)
        if isinstance(made, Trajectory):
            return made
        faults = made
        if task.clock.over:
            break
        task = _between(task.roomier(), first, goals)
    raise SolveError(f"no provable trajectory was found: {'; '.join(faults)}")


def _between(task: PlanTask, first: Equilibrium, goals: Sequence[End]) -> PlanTask:
    return task.from_to(task.chart.of(first), *(end.point for end in goals))


def _way(task: PlanTask, first: Equilibrium, goal: Any, goals: list[End], seed: int) -> tuple[PlanTask, list[End], Way]:
    """A way to the goals; where none is found to a goal of the tip, one to other postures that meet it."""
    options, clock = task.options, task.clock
    until = options.time_limit - min(REPORT_SECONDS, REPORT_SHARE * options.time_limit)
    left = max(0.0, min(SEARCH_SHARE * options.time_limit, until) - clock.seconds)
    postures = of_the_tip(goal) and left > POSTURES_SECONDS
    begin = task.chart.of(first)
    if options.roadmap is not None:
        way = options.roadmap.shortest_path(task, begin, [end.point for end in goals], Clock(ROADMAP_SHARE * left))
        if way.points is None and len(goals) < ENOUGH_ENDS and of_the_tip(goal):
            goals = asked_ends(task, first, goal, ENOUGH_ENDS)
            task = _between(task, first, goals)
            rest = Clock(ROADMAP_SHARE * max(0.0, left - clock.seconds))
            way = options.roadmap.shortest_path(task, begin, [end.point for end in goals], rest)
        if way.points is not None:
            return task, goals, way
        left = max(0.0, until - clock.seconds)
    search = Clock(NEAREST_SHARE * left if postures else left)
    find = partial(find_way, how=options.search, improving=options.search_seconds)
    way = find(task, begin, [end.point for end in goals], search, seed=seed)
    if way.impossible and (of_the_tip(goal) or len(goals) == MOST_ENDS or task.chart.load is not None):
        way = replace(way, impossible=False, why=f"{way.why} (to what was tried; others may meet the goal)")
    if way.points is not None or not postures:
        return task, goals, way
    rest = Clock(left - search.seconds)
    others = other_ends(task, first, goal, goals, rest.part(0.5), modulo_turns=options.modulo_turns)
    goals = [*goals, *others]
    task = _between(task, first, goals)
    again = find(task, begin, [end.point for end in others or goals], rest, seed=seed + 1)
    return task, goals, replace(again, motions=way.motions + again.motions, impossible=False)


def _make(task: PlanTask, first: Equilibrium, end: End, way: Way) -> Trajectory | Faults:
    """Smooth a way and prove it: the smoothed motion, else the shortened way with rests at its corners."""
    assert way.points is not None
    clock = task.clock
    searched = clock.seconds
    try:
        points = _shorter(task, way)
        raw = task.length(way.points)
        motions = motions_near(task, first, points)
    except LateError:
        return (no_time(clock),)
    smoothed = clock.seconds
    faults: Faults = ()
    for motion, how, iterations, knots in motions:
        numbers = (way.motions, raw, 0.0, iterations, knots, searched, smoothed - searched)
        made = build(task, first, end, motion, PlanStatistics(way.how, how, *numbers))
        if isinstance(made, Trajectory):
            return made
        faults = made
    return faults


def _shorter(task: PlanTask, way: Way) -> Array:
    """The points of a way with corners cut; of one over a roadmap, which is the shortest there, without smoothing only
    those corners are left out that it can do without."""
    assert way.points is not None
    if way.how == "roadmap" and task.options.objective == "none":
        return without_corners(task, way.points)
    clock = Clock(min(SHORTEN_SECONDS, SHORTEN_SHARE * task.clock.left))
    return shorten(task, way.points, clock, seed=task.options.seed)


def _not_found(task: PlanTask, first: Equilibrium, goals: Sequence[End], way: Way) -> SolveError:
    """What to say where the search ended without a way: how close it came, and with what."""
    clock = task.clock
    if way.impossible:
        return SolveError(f"no plan exists: {way.why}")
    partial, distance = None, float("nan")
    if way.closest is not None and len(way.closest) > 1:
        distance = min(float(np.linalg.norm((way.closest[-1] - each.point) / task.scale)) for each in goals)
        points, motion = way.closest, None
        with suppress(LateError):
            points, motion = _affordable(task, way.closest, actuators(task, first), clock.left)
        if motion is not None:
            found = PlanStatistics("partial", "", way.motions, 0.0, 0.0, 0, len(points), clock.seconds)
            made = build(task, first, None, motion, found)
            partial = made if isinstance(made, Trajectory) and made.proof.holds else None
    near = f"; the closest state is {distance:.3g} (joint scales) from the goal" if distance == distance else ""
    why = f"; {way.why}" if way.why else ""
    count = "1 motion was" if way.motions == 1 else f"{way.motions} motions were"
    tried = f"{count} tried in {clock.seconds:.1f} s"
    return SolveError(f"no plan was found within {clock.limit:g} s: {tried}{near}{why}", partial)


def _affordable(task: PlanTask, points: Array, limits: Limits, left: float) -> tuple[Array, Motion | None]:
    """The longest beginning of a way whose proof should take no longer than `left` seconds, as a motion with rests."""
    while len(points) > 1:
        motion = stopping_at(joint_curves(task, points), limits)
        samples = len(motion.sampled(task.scale)[0])
        needed = PROOF_SECONDS + PROOF_SECONDS_PER_SAMPLE * samples
        if needed <= left:
            return points, motion
        points = points[: min(len(points) - 1, int(len(points) * left / needed))]
    return points, None


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
    # The ranking must leave time for the plans.
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
        # Turned about z as a whole an arm stays an equilibrium: only radius and height of its tip count.
        miss = np.hypot(np.hypot(tip[:, 0], tip[:, 1]) - np.hypot(x, y), tip[:, 2] - z)
        near = np.argsort(miss)[:NEAREST_ARMS]
        turn = np.arctan2(y, x) - np.arctan2(tip[near, 1], tip[near, 0])
        axes = scipy.spatial.transform.Rotation.from_rotvec(turn[:, None] * [0.0, 0.0, 1.0]).as_matrix()
        # Points are rows: R p is p @ R^T.
        turned = Lines(frame.placed(arms.points[near] @ axes.transpose(0, 2, 1)), arms.radius[near])
        short = np.maximum(task.clearance - _room(task, turned), 0.0)
        least = min(least, float((miss[near] + short).min(initial=np.inf)))
    return least
