"""From a motion to an answer: it is sampled, followed to its end, and proved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..equilibrium.result import Equilibrium
from ..inverse.clock import Clock
from ..typing import Array
from .goals import End
from .motion import Motion
from .proof import verify_trajectory
from .question import Question
from .timing import Limits, through
from .tracking import Tracked, track
from .trajectory import PlanStatistics, Trajectory

Faults = tuple[str, ...]


def actuators(question: Question, first: Equilibrium) -> Limits:
    """What limits the speed of motions that begin at an equilibrium."""
    task, rates = question.task, question.rates

    def tips(q: Array) -> Array:
        """Those of the branch of the equilibrium; where it ends, the last one of it."""
        found = track(task, first, q).tip
        return np.concatenate([found, np.repeat(found[-1:], len(q) - len(found), axis=0)])

    tip = None if rates.tip is None else (rates.tip, tips)
    return Limits(*rates.of(task.chart.space), tip, task.effort)


def build(
    question: Question, first: Equilibrium, end: End | None, motion: Motion, found: PlanStatistics
) -> Trajectory | Faults:
    """Sample a motion, make its ends exact, and prove it as far as there is time; where it has faults, these. What was
    `found` before is told with the length of what is made of it and the seconds of the proof."""
    task, rates, clock = question.task, question.rates, question.clock
    space = task.chart.space
    t, q = motion.sampled(task.scale, task.effort)
    begin = space.join(first.rotations, first.translations)
    last = q[-1] if end is None else end.joints
    x = (t / t[-1] if t[-1] > 0 else np.ones(len(t)))[:, None]
    blend = x * x * (3 - 2 * x)
    q = q + (begin - q[0]) * (1 - blend) + (last - q[-1]) * blend
    q[0], q[-1] = begin, last
    q = np.clip(q, np.minimum(space.lower, begin), np.maximum(space.upper, begin))
    table = np.array([space.joint(row) for row in q])
    n = space.robot.n_tubes
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
        limits=space.limits,
        clock=clock,
        max_force=task.max_force,
        load=task.chart.load,
        effort=task.effort,
    )
    if not (proof.holds or proof.open):
        hurry = 1.0 if rates.tip is None else proof.largest_tip_rate / rates.tip
        if 1 < hurry < task.effort.tip_hurry and len(proof.faults) == 1:
            return build(question, first, end, motion.slower(hurry), found)
        return proof.faults
    # A proof that time ended may not have come to the last of them.
    rest = track(task, proof.samples[-1], q[len(proof.samples) :], Clock(task.effort.late_seconds))
    if rest.lost:
        return (no_time(clock),)
    known = Tracked((*proof.samples, *rest.equilibria), lost=False)
    if end is not None and float(np.abs(task.chart.of(known.equilibria[-1]) - end.point).max()) > 1e-3:
        return (*proof.faults, "the motion ends on another branch than that of the goal")
    length = float(np.linalg.norm(np.diff(q / task.scale, axis=0), axis=1).sum())
    seconds = clock.seconds
    proving = seconds - found.search_seconds - found.smooth_seconds
    return Trajectory(
        robot=first.robot,
        time=t,
        rotations=table[:, :n],
        translations=table[:, n:],
        tip_position=known.tip,
        margin=known.margin,
        arms=known.equilibria,
        start=first,
        end=known.equilibria[-1],
        turns=(0,) * n if end is None else end.turns,
        obstacles=task.obstacles,
        min_margin=task.min_margin,
        min_clearance=task.clearance - task.reserve,
        rate_limits=rates,
        proof=proof,
        statistics=replace(found, length=length, proof_seconds=proving, seconds=seconds),
    )


def passing(
    question: Question, first: Equilibrium, q: Array, last: Array, found: PlanStatistics
) -> Trajectory | Faults:
    """The fastest motion through joint values (k, m), from an equilibrium to the point `last` (m,) of the chart."""
    motion = through(q, question.task.scale, actuators(question, first))
    end = End(last, q[-1], (0,) * first.robot.n_tubes)
    made = build(question, first, end, motion, found)
    if isinstance(made, Trajectory):  # nothing was smoothed
        return replace(made, statistics=replace(made.statistics, raw_length=made.statistics.length))
    return made


def no_time(clock: Clock) -> str:
    """What is wrong where the clock is over."""
    return f"the time limit of {clock.limit:g} s left no time to follow the way that was found"
