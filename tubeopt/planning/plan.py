"""Planning a trajectory: goal, search, smoothing, proof."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..bodies.obstacles import Obstacle
from ..equilibrium.result import Equilibrium
from ..errors import SolveError
from ..inverse.clock import Clock, LateError
from ..inverse.search import Way, find_way, shorten
from ..inverse.task import Task
from ..robots.limits import JointLimits
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.parallel.blas import small
from ..typing import Array
from .goals import MOST_GOALS, End, check_start, ends, limits_of, of_the_tip, other_ends, start_equilibrium
from .motion import DEFAULT_RATES, Motion, RateLimits
from .options import DEFAULT_PLAN, PlanOptions
from .proof import Proof, verify_trajectory
from .question import asked, bearing, in_time
from .smooth import joint_curves, smooth, violated
from .timing import Limits, at_full_speed, stopping_at, through
from .tracking import track
from .trajectory import PlanStatistics, Trajectory

FOR_SEARCH = 0.9
"""Share of the time limit after which the search ends, so that what was found can be reported in time."""

SHARE_OF_ROADMAP = 0.3
"""Share of the time for the search which a roadmap is given first."""

FOR_REPORT, MOST_FOR_REPORT = 2.0, 0.35
"""Seconds that are kept for the report at least, but no more than this share of the time limit."""

PROOF, PROOF_SAMPLE = 0.1, 1e-3
"""Seconds that a proof takes at most on most machines: in all, and per sample of the motion."""

ATTEMPTS = 3
"""Times that a plan whose proof finds a fault is made again with more room and other random numbers."""

SHARE_OF_GOAL = 0.6
"""Share of the time limit after which the search for joints that meet a goal of the tip tries no further start."""

FOR_POSTURES, SHARE_OF_NEAREST = 15.0, 0.4
"""Seconds below which only the nearest posture for a goal of the tip is tried, and what part of more it gets."""

SMOOTHING, LEAST_SMOOTHING = 20.0, 1.0
"""Most seconds of smoothing, and those below which it is not begun: its steps cannot be cut short."""

SHARE_OF_SMOOTHING = 0.5
"""Share of the time that is left which smoothing may take: the proof needs the rest."""

SHORT, SAME = 1e-9, 2e-3
"""Length of a way (joints' scales) on which nothing is smoothed; share by which lengths and durations may differ that
count as the same."""

WORTH = 0.02, 0.1
"""Share of its length by which a way must exceed the straight line to be smoothed for length: free, among bodies."""

ROUNDINGS = (0.4, 0.2, 0.1, 0.05)
"""Distances (joints' scales) of the points of a polyline whose corners are rounded."""

Faults = tuple[str, ...]


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
    """A motion from one equilibrium to another that stays on one stable branch all the way, and the proof of it.

    Args:
        start: an Equilibrium, an InverseSolution, or a pair (rotations, translations), of which the equilibrium is that
            of `forward_kinematics`.
        goal: an Equilibrium or InverseSolution (joint values with their branch); a pair (rotations, translations), on
            any branch; a tip position (3,), m; or a `TipGoal`.
        obstacles: bodies that the whole arm keeps away from, by `options.clearance`.
        min_margin: least margin all the way, in [0, 1).
        rate_limits: of the actuators.   limits: range of every joint; by default `robot.limits`.
        options: search, objective of smoothing, time limit, and the like.
        load: that the robot bears all the way; a start without it is first loaded. Margin, clearance and rates are
            those of the loaded robot, whose way is shortened and rounded, but not smoothed by a program.

    Raises:
        InputError: start or goal out of range, or numbers that make no sense; a load for which nothing is proved (see
            `verify_trajectory`), or beside `max_force`, a roadmap, or a cost of smoothing.
        SolveError: no plan exists (told before searching), or none was found in time: `.solution` is then the
            trajectory that comes closest to the goal, or None, and the message says why it ends there.

    The time limit bounds all of it. A motion whose proof was not finished in time is returned as such: its `.proved`
    is False, and its `.status` says how much of it was followed.

    Examples:
        >>> import numpy as np
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> plan = tubeopt.plan_trajectory(robot, ([0, 0, 0], None), (np.radians([90, 0, 0]), None))
        >>> plan.proved
        True
    """
    task, clock = asked(robot, obstacles, min_margin, rate_limits, limits, options, load)
    with in_time(clock):
        return _planned(task, start, goal, rate_limits, options, clock)


def _planned(
    task: Task, start: Any, goal: Any, rate_limits: RateLimits, options: PlanOptions, clock: Clock
) -> Trajectory:
    """The plan; raises as `plan_trajectory` does, and LateError."""
    first = start_equilibrium(task.chart.space, start, task.chart.load)
    task = bearing(task, first.translations)
    check_start(task, first)
    goals = ends(task, first, goal, Clock(SHARE_OF_GOAL * clock.left), modulo_turns=options.modulo_turns)
    n = len(first.translations)
    task = bearing(task, first.translations, *(task.chart.space.joint(end.joints)[n:] for end in goals))
    task = _between(task, first, goals)
    faults: Faults = ()
    for attempt in range(ATTEMPTS):
        task, goals, way = _way(task, first, goal, goals, clock, replace(options, seed=options.seed + attempt))
        if way.points is None:
            raise _not_found(task, first, goals, way, rate_limits, clock)
        reached = way.points[-1]
        end = min(goals, key=lambda each: float(np.abs(each.point - reached).max()))
        made = _make(task, first, end, way, rate_limits, options, clock)
        if isinstance(made, Trajectory):
            return made
        faults = made
        if clock.over:
            break
        task = _between(task.roomier(), first, goals)
    raise SolveError(f"no trajectory was found that can be proved: {'; '.join(faults)}")


def _between(task: Task, first: Equilibrium, goals: Sequence[End]) -> Task:
    return task.from_to(task.chart.of(first), *(end.point for end in goals))


def _way(
    task: Task, first: Equilibrium, goal: Any, goals: list[End], clock: Clock, options: PlanOptions
) -> tuple[Task, list[End], Way]:
    """A way to the goals; where none is found to a goal of the tip, one to other postures that meet it."""
    until = options.time_limit - min(FOR_REPORT, MOST_FOR_REPORT * options.time_limit)
    left = max(0.0, min(FOR_SEARCH * options.time_limit, until) - clock.seconds)
    postures = of_the_tip(goal) and left > FOR_POSTURES
    begin = task.chart.of(first)
    if options.roadmap is not None:
        way = options.roadmap.way(task, begin, [end.point for end in goals], Clock(SHARE_OF_ROADMAP * left))
        if way.points is not None:
            return task, goals, way
        left = max(0.0, until - clock.seconds)
    search = Clock(SHARE_OF_NEAREST * left if postures else left)
    way = find_way(task, begin, [end.point for end in goals], search, options, seed=options.seed)
    if way.impossible and (of_the_tip(goal) or len(goals) == MOST_GOALS or task.chart.load is not None):
        way = replace(way, impossible=False, why=f"{way.why} (to what was tried; others may meet the goal)")
    if way.points is not None or not postures:
        return task, goals, way
    rest = Clock(left - search.seconds)
    others = other_ends(task, first, goal, goals, rest.part(0.5), modulo_turns=options.modulo_turns)
    goals = [*goals, *others]
    task = _between(task, first, goals)
    again = find_way(task, begin, [end.point for end in others or goals], rest, options, seed=options.seed + 1)
    return task, goals, replace(again, motions=way.motions + again.motions, impossible=False)


def _make(
    task: Task,
    first: Equilibrium,
    end: End,
    way: Way,
    rates: RateLimits,
    options: PlanOptions,
    clock: Clock,
) -> Trajectory | Faults:
    """Smooth a way and prove it: the smoothed motion, else the shortened way with rests at its corners."""
    assert way.points is not None
    searched = clock.seconds
    try:
        points = shorten(task, way.points, Clock(min(2.0, 0.3 * clock.left)), seed=options.seed)
        raw = task.length(way.points)
        motions = _motions(task, first, points, rates, options, clock)
    except LateError:
        return (_no_time(clock),)
    smoothed = clock.seconds
    faults: Faults = ()
    for motion, how, iterations, knots in motions:
        built = build(task, first, end, motion, rates, clock)
        if not isinstance(built, Built):
            faults = built
            continue
        length = float(np.linalg.norm(np.diff(built.joints / task.scale, axis=0), axis=1).sum())
        done = clock.seconds
        numbers = (way.motions, raw, length, iterations, knots)
        seconds = (searched, smoothed - searched, done - smoothed, done)
        return built.trajectory(task, first, end, rates, PlanStatistics(way.how, how, *numbers, *seconds))
    return faults


def _no_time(clock: Clock) -> str:
    return f"the time limit of {clock.limit:g} s left no time to follow the way that was found"


def _motions(
    task: Task, first: Equilibrium, points: Array, rates: RateLimits, options: PlanOptions, clock: Clock
) -> list[tuple[Motion, str, int, int]]:
    """Motions near a way, the best first, and last the way itself with rests at its corners: each as fast as it may be,
    with the objective of its smoothing, iterations and knots.

    What is smoothed for length is neither longer nor slower than what it began from; what is smoothed for time is no
    slower than that, nor than what is smoothed for length.
    """
    limits, aim, extra = actuators(task, first, rates), options.objective, options.extra_cost
    curves = joint_curves(task, points)
    resting = stopping_at(curves, limits)
    own, found = Clock(min(SMOOTHING, SHARE_OF_SMOOTHING * clock.left), clock), []
    for name in ("length", "time") if aim == "time" else (aim,):
        if aim == "none" or own.left < LEAST_SMOOTHING or not _worth_smoothing(task, curves, options):
            break
        best = smooth(task, first, points, rates.of(task.chart.space), objective=name, extra=extra, clock=own)
        if best is not None:
            exact = name == "margin" or extra is not None
            rounder = None if exact else _rounded(task, first, best.motion.sampled(task.scale)[1], limits, own)
            motion = best.motion if name == "effort" else rounder or at_full_speed(best.motion, limits)
            found.append((motion, name, best.iterations, len(best.points)))
    if aim in ("length", "time") and extra is None:
        if len(curves) > 1 and (corners := _rounded(task, first, np.concatenate(curves), limits, own)) is not None:
            found.append((corners, "corners", 0, len(points)))
        if aim == "time":
            found = [each for each in found if each[0].duration <= resting.duration]
            found.sort(key=lambda each: each[0].duration)
        else:
            longest, slowest = resting.length(task.scale) * (1 + SAME), resting.duration * (1 + SAME)
            short = [(each[0].length(task.scale), each) for each in found if each[0].duration <= slowest]
            found = [each for length, each in sorted(short, key=lambda pair: pair[0]) if length <= longest]
    return [*found, (resting, "", 0, len(points))]


def _worth_smoothing(task: Task, curves: Sequence[Array], options: PlanOptions) -> bool:
    """Whether a way in joint space, curves of joint values (k, m), can become much shorter: none is shorter than the
    straight line. With bodies in the way smoothing takes twice as long; its equations are those without a load."""
    if task.chart.load is not None:
        return False
    length = sum(float(np.linalg.norm(np.diff(q / task.scale, axis=0), axis=1).sum()) for q in curves)
    if length < SHORT or options.objective != "length" or options.extra_cost is not None:
        return length >= SHORT
    straight = float(np.linalg.norm((curves[-1][-1] - curves[0][0]) / task.scale))
    return 1 - straight / length > WORTH[bool(task.obstacles)]


def _rounded(task: Task, first: Equilibrium, q: Array, limits: Limits, clock: Clock) -> Motion | None:
    """The fastest motion close to a path of joint values (k, m), its bends as round as they may be; None where even
    slight rounding leads where the robot may not be, or time is over."""
    for spacing in ROUNDINGS:
        if clock.over:
            return None
        motion = through(q, task.scale, limits, spacing)
        if not violated(task, first, motion, clock)[0].any():
            return motion
    return None


def actuators(task: Task, first: Equilibrium, rates: RateLimits) -> Limits:
    """What limits the speed of motions that begin at an equilibrium."""

    def tips(q: Array) -> Array:
        """Those of the branch of the equilibrium; where it ends, the last one of it."""
        found = track(task, first, q).tip
        return np.concatenate([found, np.repeat(found[-1:], len(q) - len(found), axis=0)])

    return Limits(*rates.of(task.chart.space), None if rates.tip is None else (rates.tip, tips))


@dataclass(frozen=True, eq=False)
class Built:
    """A sampled motion that was followed to its end, and its proof, which may not have been finished in time."""

    time: Array
    joints: Array
    tip: Array
    margin: Array
    equilibria: tuple[Equilibrium, ...]
    proof: Proof

    def trajectory(
        self,
        task: Task,
        first: Equilibrium,
        end: End,
        rates: RateLimits,
        statistics: PlanStatistics,
        deviation: Array | None = None,
    ) -> Trajectory:
        """The answer."""
        table = np.array([task.chart.space.joint(q) for q in self.joints])
        rotations, translations = np.split(table, 2, axis=1)
        return Trajectory(
            robot=first.robot,
            time=self.time,
            rotations=rotations,
            translations=translations,
            tip_position=self.tip,
            margin=self.margin,
            arms=self.equilibria,
            start=first,
            end=self.equilibria[-1],
            turns=end.turns,
            obstacles=task.obstacles,
            min_margin=task.min_margin,
            min_clearance=task.clearance - task.reserve,
            rate_limits=rates,
            proof=self.proof,
            statistics=statistics,
            deviation=deviation,
        )


def build(
    task: Task, first: Equilibrium, end: End | None, motion: Motion, rates: RateLimits, clock: Clock
) -> Built | Faults:
    """Sample a motion, make its ends exact, and prove it as far as there is time; where it has faults, these."""
    space = task.chart.space
    t, q = motion.sampled(task.scale)
    begin = space.join(first.rotations, first.translations)
    last = q[-1] if end is None else end.joints
    x = (t / t[-1] if t[-1] > 0 else np.ones(len(t)))[:, None]
    blend = x * x * (3 - 2 * x)
    q = q + (begin - q[0]) * (1 - blend) + (last - q[-1]) * blend
    q[0], q[-1] = begin, last
    q = np.clip(q, np.minimum(space.lower, begin), np.maximum(space.upper, begin))
    table = np.array([space.joint(row) for row in q])
    n = space.robot.n_tubes
    tracked = track(task, first, q, clock)
    if tracked.lost:
        return (_no_time(clock) if clock.over else "the branch is lost between samples",)
    proof = verify_trajectory(
        space.robot,
        t,
        table[:, :n],
        table[:, n:],
        start=first,
        obstacles=task.obstacles,
        min_margin=task.min_margin - 1e-6,
        clearance=task.clearance - task.reserve,
        rate_limits=rates,
        limits=None if space.robot.limits is None else limits_of(space),
        clock=clock,
        max_force=task.max_force,
        load=task.chart.load,
    )
    if not (proof.holds or proof.open):
        return proof.faults
    reached = tracked.equilibria[-1]
    if end is not None and float(np.abs(task.chart.of(reached) - end.point).max()) > 1e-3:
        return (*proof.faults, "the motion ends on another branch than that of the goal")
    return Built(t, q, tracked.tip, tracked.margin, tracked.equilibria, proof)


def _not_found(
    task: Task,
    first: Equilibrium,
    goals: Sequence[End],
    way: Way,
    rates: RateLimits,
    clock: Clock,
) -> SolveError:
    """What to say where the search ended without a way: how close it came, and with what."""
    if way.impossible:
        return SolveError(f"no plan exists: {way.why}")
    partial, distance = None, float("nan")
    if way.closest is not None and len(way.closest) > 1:
        distance = min(float(np.linalg.norm((way.closest[-1] - each.point) / task.scale)) for each in goals)
        points, motion = way.closest, None
        with suppress(LateError):
            points, motion = _affordable(task, way.closest, actuators(task, first, rates), clock.left)
        built = () if motion is None else build(task, first, None, motion, rates, clock)
        if isinstance(built, Built) and built.proof.holds and motion is not None:
            end = End(points[-1], motion.joints[-1], (0,) * task.chart.space.robot.n_tubes)
            numbers = (way.motions, 0.0, task.length(points), 0, len(points))
            seconds = (clock.seconds, 0.0, 0.0, clock.seconds)
            statistics = PlanStatistics("partial", "", *numbers, *seconds)
            partial = built.trajectory(task, first, end, rates, statistics)
    near = f"; the closest state is {distance:.3g} (joint scales) from the goal" if distance == distance else ""
    why = f"; {way.why}" if way.why else ""
    count = "1 motion was" if way.motions == 1 else f"{way.motions} motions were"
    tried = f"{count} tried in {clock.seconds:.1f} s"
    return SolveError(f"no plan was found within {clock.limit:g} s: {tried}{near}{why}", partial)


def _affordable(task: Task, points: Array, limits: Limits, left: float) -> tuple[Array, Motion | None]:
    """The longest beginning of a way whose proof should take no longer than `left` seconds, as a motion with rests."""
    while len(points) > 1:
        motion = stopping_at(joint_curves(task, points), limits)
        needed = PROOF + PROOF_SAMPLE * len(motion.sampled(task.scale)[0])
        if needed <= left:
            return points, motion
        points = points[: min(len(points) - 1, int(len(points) * left / needed))]
    return points, None
