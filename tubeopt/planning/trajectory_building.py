"""From a way to an answer: motions near it, as it is and smoothed, each as fast as its limits allow; which are sampled,
followed to their ends, and proved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..bodies.distance_field import DistanceField
from ..equilibrium.result import Equilibrium
from ..inverse.clock import Clock
from ..typing import Array
from .goals import End
from .motion import Motion
from .proof import Kept, proved
from .question import PlanTask
from .smooth import smooth
from .timing import Limits, actuators, at_full_speed, joint_curves, stopping_at, through, track, violated
from .trajectory import PlanStatistics, Trajectory

Faults = tuple[str, ...]

SMOOTHING_SHARE, LEAST_SMOOTHING = 0.5, 1.0
"""Maximum share of the remaining time for smoothing, since the proof needs the rest; and time, s, below which it is
skipped."""

SCANNED_SECONDS = 2.5
"""Maximum duration of smoothing for length among scanned obstacles, s."""

WORTH, WORTH_AMONG_BODIES = 0.02, 0.1
"""Relative excess of a path over the straight line that justifies smoothing for length, in free space and among
obstacles, where it takes twice as long."""

SAME_LENGTH = 2e-3
"""Largest relative difference of equal lengths and durations."""

ROUNDING_SECONDS, ROUNDING_SHARE = 5.0, 0.3
"""Maximum duration of rounding corners, s, and share of the time that smoothing leaves."""

SPACINGS = (0.4, 0.2, 0.1, 0.05, 0.02, 0.01)
"""Spacings of the polyline points before rounding, in units of the joint scales, tried in turn."""

MAX_OVERSPEED = 1.1
"""Largest ratio of the tip speed to its limit that is repaired by slowing the motion down."""

LATE_SECONDS = 0.25
"""Largest overrun of the time limit for following an unproved motion to its end, s."""

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
