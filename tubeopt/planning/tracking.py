"""Following a motion on its branch: the equilibria that it leads through, and where they lose what a plan must keep."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import SolveError
from ..inverse.clock import Clock
from ..inverse.outline import Outline
from ..typing import Array, Mask
from .motion import Motion
from .question import PlanTask
from .timing import Limits


def joint_curves(task: PlanTask, points: Array) -> list[Array]:
    """The joint values of every straight motion of a way (k, m), evenly spaced and as close as it takes to check it."""
    out = []
    for a, b in pairwise(points):
        pieces = (len(task.line(a, b)) - 1) * 2 ** (task.fineness(a, b) or 0)
        for halvings in range(task.effort.rounding.halvings + 1):
            q = task.chart.joints(a + np.linspace(0, 1, 2**halvings * pieces + 1)[:, None] * (b - a))
            if np.abs(np.diff(q / task.scale, 2, axis=0)).max(initial=0.0) <= task.effort.rounding.bend:
                break
        out.append(q)
    return out


def actuators(task: PlanTask, first: Equilibrium) -> Limits:
    """What limits the speed of motions that begin at an equilibrium."""
    rates = task.rates

    def tips(q: Array) -> Array:
        """Those of the branch of the equilibrium; where it ends, the last one of it."""
        found = np.array([e.tip_position for e in track(task, first, q)])
        return np.concatenate([found, np.repeat(found[-1:], len(q) - len(found), axis=0)])

    tip = None if rates.tip is None else (rates.tip, tips)
    return Limits(*rates.of(task.chart.space), tip, task.effort.timing)


def track(task: PlanTask, start: Equilibrium, q: Array, clock: Clock | None = None) -> tuple[Equilibrium, ...]:
    """The equilibria at joint values q (T, m), as forward kinematics finds them one from the other on the branch of
    `start`: fewer than T where the branch ends, or the clock is over."""
    space, here, found = task.chart.space, start, list[Equilibrium]()
    for row in q:
        rotations, shift = space.split(row)
        try:
            here = forward_kinematics(space.robot, rotations, shift, load=task.chart.load, guess=here)
        except SolveError:
            break
        if not here.stable or (clock is not None and clock.over):
            break
        found.append(here)
    return tuple(found)


def violated(
    task: PlanTask, start: Equilibrium, motion: Motion, clock: Clock, places: tuple[Array, Array]
) -> tuple[Mask, Array]:
    """(intervals,) where the motion between knots loses the branch, margin, or clearance; and by how much (2,) margin
    and clearance (m) fall short. `places`: times (P,) at which it has to be at points (P, m) of the chart: the same
    joint values may be led to on several branches, by ways around a fold on one side and on the other."""
    time, q = motion.sampled(task.scale, task.effort.timing)
    found = track(task, start, q, clock)
    bad = np.zeros(len(motion.time) - 1, dtype=bool)
    short = _short(task, found)
    wrong = time[: len(found)][(short > 0).any(0)]
    if len(found) < len(q):
        wrong = np.append(wrong, time[len(found)])
    else:
        first = places[0][_apart(task, time, found, places)][:1]
        wrong = np.append(wrong, np.nextafter(first, 0))  # what led there lies before it
    at = np.clip(np.searchsorted(motion.time, wrong, side="right") - 1, 0, len(bad) - 1)
    bad[at] = True
    return bad, np.maximum(short.max(1, initial=0.0), 0.0)


def _short(task: PlanTask, found: Sequence[Equilibrium]) -> Array:
    """(2, T) what margin and clearance (m) of equilibria lack of what is to be kept and to be left; 0 or less where
    nothing. Both ends are as they are."""
    joints = [task.chart.space.join(e.rotations, e.translations) for e in found]
    q = np.reshape(joints, (-1, len(task.scale))) / task.scale
    step = np.append(np.abs(np.diff(q, axis=0)).max(1), 0.0)[: len(q)]
    most = task.effort.smoothing.left
    left = most * np.minimum(1.0, np.maximum(step, np.roll(step, 1)) / task.effort.timing.sample_step) ** 2
    margin = np.array([e.margin for e in found])
    clear = np.array([Outline(e).clearance(task.scene, task.clearance + most) for e in found])
    out = np.array([task.min_margin + left - margin, task.clearance + left - clear])
    for end in {0, len(q) - 1} if len(q) else ():
        out[:, end] = np.minimum(out[:, end], 0.0)
    return out


def _apart(task: PlanTask, time: Array, found: Sequence[Equilibrium], places: tuple[Array, Array]) -> Mask:
    """(P,) at which of some places a motion that was followed at times (T,) is on another branch."""
    points = np.array([task.chart.of(each) for each in found])
    there = np.column_stack([np.interp(places[0], time, column) for column in points.T])
    return np.asarray((np.abs(there - places[1]) / task.scale).max(1) > task.effort.smoothing.apart)
