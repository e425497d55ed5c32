"""Straight ways from a stable equilibrium, followed by the compiled kernel wherever it is at ease.

Far from a fold one solve of the kernel makes a step of a sixth of a radian and more. Where it declines the general
follower takes over, until the branch has ended in a snap or is at ease again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..equilibrium.continuation import Family, JointPath
from ..equilibrium.kinematics import nearby
from ..equilibrium.member import plain_point
from ..equilibrium.result import Equilibrium
from ..equilibrium.solving import polish
from ..solvers.compiled.binding import kernel_of
from ..solvers.settings import CONTINUATION
from ..typing import Array
from .folds import fold_ahead
from .motion import Event, equilibrium_at, leave, motion

STEP = (1 - 1e-9) * CONTINUATION.largest_turn
"""Turn (rad) of a step of the kernel: the most that it takes, less a round-off that would make it more; of those that
it declines half, down to SHORTEST_STEP."""

SHORTEST_STEP = STEP / 2**7

TAKEN_OVER, CLOSE = 0.1, 0.02
"""Turn (rad) that the general follower makes before the kernel is asked again; and how close (rad) to where the kernel
declines a fold lies that is the reason."""


@dataclass(frozen=True, eq=False)
class End:
    """Where a way ends: in which equilibrium, after how many snaps, and the joint rotations (n,), rad, at the first of
    them, None without; `before`: equilibria that the kernel found on the way to it, from the origin on."""

    pose: Equilibrium
    snaps: int
    first: Array | None
    before: Sequence[Equilibrium]


def straight_way(origin: Equilibrium, rotations: Array, *, to_first_snap: bool = False) -> End:
    """What a robot does that turns straight from a stable equilibrium to other rotations (n,), rad.
    With `to_first_snap` the way ends where the robot lands from it.
    """
    here, snaps, first, before = origin, 0, None, [origin]
    while True:
        passed = _by_kernel(here, rotations)
        here = passed[-1] if passed else here
        if first is None:
            before += passed
        left = float(np.abs(rotations - here.rotations).max())
        if not left:
            return End(here, snaps, first, before)
        begin, end = (np.concatenate([turned, here.translations]) for turned in (here.rotations, rotations))
        family = Family(JointPath(here.robot, begin, end))
        here, folds = _taken_over(family, here, left)
        if folds and first is None:
            first = family.path.at(folds[0])[0]
            if to_first_snap:
                return End(here, 1, first, before)
        snaps += len(folds)


def _by_kernel(here: Equilibrium, goal: Array) -> list[Equilibrium]:
    """The equilibria on the way that the kernel comes to, step by step."""
    step, passed = STEP, []
    while (left := float(np.abs(goal - here.rotations).max())) > 0:
        there = nearby(here, goal if left <= step else here.rotations + (goal - here.rotations) * (step / left))
        if there is not None and there.margin > 0:
            here, step = there, min(2 * step, STEP)
            passed.append(there)
        else:
            step /= 2
            if step < SHORTEST_STEP:
                break
    return passed


def _taken_over(family: Family, here: Equilibrium, left: float) -> tuple[Equilibrium, list[float]]:
    """What the general follower finds over the next fold, or through a turn of TAKEN_OVER of the `left` of a path; and
    the fractions at which it snapped."""
    start, folds = plain_point(here.robot, polish(here), tuple(here.translations.tolist())), []
    far, ahead = 1.0, None
    if kernel_of(here.robot) is not None:
        far, ahead = min(1.0, TAKEN_OVER / left), fold_ahead(family, start, min(1.0, CLOSE / left))
    for step in motion(family, start) if ahead is None else (leave(family, start, ahead, 1.0),):
        if isinstance(step, Event):
            folds.append(step.lost.t)
        point = step.landed if isinstance(step, Event) else step
        if folds or point.t >= far:
            break
    return equilibrium_at(point, "the way"), folds
