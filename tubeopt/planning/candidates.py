"""Motions near a way that was found, as it is and smoothed, each as fast as its limits allow: what may be proved."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..bodies.distance_field import DistanceField
from ..equilibrium.result import Equilibrium
from ..inverse.clock import Clock
from ..inverse.task import Task
from ..typing import Array
from .building import actuators
from .motion import Motion
from .question import Question
from .smooth import joint_curves, smooth, violated
from .timing import Limits, at_full_speed, stopping_at, through

SHORT = 1e-9
"""Length of a way (joints' scales) on which nothing is smoothed."""


def motions_near(question: Question, first: Equilibrium, points: Array) -> list[tuple[Motion, str, int, int]]:
    """Motions near a way, the best first, and last the way itself with rests at its corners: each as fast as it may be,
    with the objective of its smoothing, iterations and knots.

    What is smoothed for length is neither longer nor slower than what it began from; what is smoothed for time is no
    slower than that, nor than what is smoothed for length.
    """
    task, clock, limits = question.task, question.clock, actuators(question, first)
    aim, extra = question.options.objective, question.options.extra_cost
    curves = joint_curves(task, points)
    resting = stopping_at(curves, limits)
    effort, found = task.effort, []
    scanned = aim == "length" and extra is None and any(isinstance(body, DistanceField) for body in task.obstacles)
    most = effort.scanned_seconds * clock.crowding if scanned else effort.smoothing_seconds
    own = Clock(min(most, effort.smoothing_share * clock.left), clock)
    for name in ("length", "time") if aim == "time" else (aim,):
        if aim == "none" or own.left < effort.least_smoothing or not _worth_smoothing(question, curves):
            break
        best = smooth(task, first, points, (limits.rate, limits.acceleration), objective=name, extra=extra, clock=own)
        if best is not None:
            exact = name == "margin" or extra is not None
            way = best.motion.sampled(task.scale, effort)[1], best.points[-1]
            rounder = None if exact else _rounded(task, first, way, limits, own)
            motion = best.motion if name == "effort" else rounder or at_full_speed(best.motion, limits)
            found.append((motion, name, best.iterations, len(best.points)))
    if aim in ("length", "time") and extra is None:
        rest = Clock(min(effort.rounding_seconds * clock.crowding, effort.rounding_share * clock.left), clock)
        way = np.concatenate(curves), points[-1]
        if len(curves) > 1 and (corners := _rounded(task, first, way, limits, rest)) is not None:
            found.append((corners, "corners", 0, len(points)))
        if aim == "time":
            found = [each for each in found if each[0].duration <= resting.duration]
            found.sort(key=lambda each: each[0].duration)
        else:
            same = 1 + effort.same_length
            longest, slowest = resting.length(task.scale, effort) * same, resting.duration * same
            short = [(each[0].length(task.scale, effort), each) for each in found if each[0].duration <= slowest]
            found = [each for length, each in sorted(short, key=lambda pair: pair[0]) if length <= longest]
    return [*found, (resting, "", 0, len(points))]


def _worth_smoothing(question: Question, curves: Sequence[Array]) -> bool:
    """Whether a way in joint space, curves of joint values (k, m), can become much shorter: none is shorter than the
    straight line. With bodies in the way smoothing takes twice as long; its equations are those without a load."""
    task, options = question.task, question.options
    if task.chart.load is not None:
        return False
    length = sum(float(np.linalg.norm(np.diff(q / task.scale, axis=0), axis=1).sum()) for q in curves)
    if length < SHORT or options.objective != "length" or options.extra_cost is not None:
        return length >= SHORT
    straight = float(np.linalg.norm((curves[-1][-1] - curves[0][0]) / task.scale))
    return 1 - straight / length > (task.effort.worth_among_bodies if task.obstacles else task.effort.worth_smoothing)


def _rounded(task: Task, first: Equilibrium, way: tuple[Array, Array], limits: Limits, clock: Clock) -> Motion | None:
    """The fastest motion close to a way, its bends as round as they may be; None where even slight rounding leads where
    the robot may not be, or time is over. `way`: joint values (k, m), and the point of the chart (m,) at its end."""
    q, end = way
    for spacing in task.effort.roundings:
        if clock.over:
            return None
        motion = through(q, task.scale, limits, spacing)
        places = motion.time[-1:], end[None]
        if not violated(task, first, motion, clock, places)[0].any():
            return motion
    return None
