"""Quasi-static motion along a family of problems, joints or load alike, with its snaps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np

from ..display import Displayed
from ..equilibrium.continuation import (
    SHARPEST_STEP,
    SHORTEST_STEP,
    Family,
    Milestone,
    SampledJointPath,
    follow,
    step_to,
)
from ..equilibrium.kinematics import along, followed_by_kernel, point_of, to_equilibrium
from ..equilibrium.member import AnyPoint
from ..equilibrium.problem import LOADED_DISCRETISATION
from ..equilibrium.result import Equilibrium, Statistics
from ..errors import FlutterError, SolveError
from ..robots.load import Load
from ..robots.robot import Robot
from ..typing import Array, Delegate, StatusEnum
from .folds import MIN_JUMP, PAST, Loss, across, branch_end, fall, fold_ahead


class SnapStatus(StatusEnum):
    """End of a snap, as a sentence; a snap that reaches no equilibrium raises SolveError instead."""

    LANDED = "the robot snapped to another equilibrium"


@dataclass(frozen=True, eq=False)
class Snap(Displayed):
    """Snap: an equilibrium vanishes, and the robot jumps to another one."""

    _brief = ("fraction", "rotations", "translations", "tip_jump", "energy_released")

    index: int
    """Index of the waypoint before it."""
    fraction: Annotated[float, "fraction of the path to the snap"]
    """0 at the waypoint `index`, 1 at the next one."""
    before: Annotated[Equilibrium, "equilibrium that is lost"]
    """Equilibrium at the joint values of the snap; its margin is 0."""
    after: Annotated[Equilibrium, "equilibrium after the snap"]

    rotations, translations = Delegate[Array]("before"), Delegate[Array]("before")

    @property
    def energy_released(self) -> float:
        """Energy released by tubes and load, J; NaN under a load without an energy."""
        return self.before.potential - self.after.potential

    @property
    def tip_jump(self) -> float:
        """Distance that the tip jumps, m."""
        return float(np.linalg.norm(self.after.tip_position - self.before.tip_position))

    @property
    def value(self) -> float:
        """Fraction of the path to the next waypoint."""
        return self.fraction

    @property
    def status(self) -> SnapStatus:
        """End of the snap, as a sentence."""
        return SnapStatus.LANDED

    @property
    def statistics(self) -> Statistics:
        """Statistics of the vanishing equilibrium."""
        return self.before.statistics


# Next to a bifurcation the new branch is reached within `PAST` of the path, where it is about 0.01 rad away. The
# smallest snaps, at the cusp where a hysteresis begins, have the same size: a smaller jump counts as no snap.
SMOOTH_TURN = 0.05
"""Largest rotation (rad) of a point in a smooth change to a neighbouring branch at a bifurcation."""

# A fold close ahead of the point where the kernel declines is the reason, and `fold_ahead` finds it. Otherwise a few
# steps of the general continuation pass the difficult part.
HANDOVER = 0.1
"""Distance (rad) of general continuation before the kernel is tried again."""

FOLD_RANGE = 0.02
"""Distance (rad) ahead of the kernel's last point that is searched for a fold first."""


@dataclass(frozen=True, eq=False)
class Event:
    """Snap of a family of problems."""

    lost: AnyPoint
    """Point at the end of the branch."""
    landed: AnyPoint
    """Stable point after the snap."""

    @cached_property
    def before(self) -> Equilibrium:
        """Equilibrium that vanishes."""
        return to_equilibrium(self.lost, "fold")

    @cached_property
    def after(self) -> Equilibrium:
        """Equilibrium after the snap."""
        return to_equilibrium(self.landed, "energy descent")

    def snap(self, index: int) -> Snap:
        """Snap between the waypoint `index` and the next one."""
        return Snap(index, self.lost.t, self.before, self.after)


def family_between(robot: Robot, start: Array, end: Array, load: Load | None) -> Family:
    """Problems on a straight path between joint values (2n,), under a constant load or none."""
    if load is None:
        return Family(SampledJointPath(robot, start, end))
    return Family(SampledJointPath(robot, start, end, LOADED_DISCRETISATION), load, load)


def motion(family: Family, origin: Equilibrium) -> Iterator[Milestone | Event]:
    """Follow a stable equilibrium from t = 0 to t = 1; yields equilibria, and an event wherever the robot snaps.

    Joint paths and changes of the load alike. The compiled kernel follows the branch (`along`) until it declines a
    step. Then the general continuation takes over, until the branch has ended in a snap or `HANDOVER` is behind.
    """
    last, scale = Milestone(0.0, origin), max(family.span(), FOLD_RANGE)
    kernel = followed_by_kernel(family)
    while last.t < 1.0:
        if kernel:
            for milestone in along(family, last):
                yield milestone
                last = milestone
            if last.t >= 1.0:
                return
        start = replace(point_of(last.pose, None if family.load is None else Load()), t=last.t)
        far, ahead = 1.0, None
        if kernel:
            far = min(1.0, last.t + HANDOVER / scale)
            ahead = fold_ahead(family, start, min(1.0, last.t + FOLD_RANGE / scale))
        result = _continue(family, start, far) if ahead is None else leave(family, start, ahead, 1.0)
        if isinstance(result, Event):
            yield result
            last = Milestone(result.landed.t, result.after)
        else:
            last = Milestone(result.t, to_equilibrium(result, "the path"))
        yield last


def _continue(family: Family, start: AnyPoint, far: float) -> AnyPoint | Event:
    """Stable point at t = `far` or beyond by general continuation, or the first snap on the path to it."""
    point, shortest = start, SHORTEST_STEP
    while point.t < far:
        # Breakpoints change places at the events of the path: continuation goes from one to the next.
        goal = next(t for t in family.events() if t > point.t)
        for step in follow(family, point, goal, shortest=shortest):
            point = step
            if point.t >= far:
                return point
        if point.t >= goal:
            continue
        loss = branch_end(family, point, goal)
        if loss is None and shortest > SHARPEST_STEP:
            # Sharp bends of a branch look like its end until the steps are much shorter.
            shortest = SHARPEST_STEP
            continue
        result, shortest = leave(family, point, loss, goal), SHORTEST_STEP
        if isinstance(result, Event):
            return result
        point = result
    return point


def leave(family: Family, last: AnyPoint, loss: Loss | None, goal: float) -> AnyPoint | Event:
    """Snap at the end of a branch after the stable point `last`, or the next point if the branch continues.

    Three cases: the fall from the end goes far (a snap); a neighbouring branch takes over within `SMOOTH_TURN` (a
    smooth bifurcation); or nothing stable is near the end, but the fall from just beyond it goes far (a snap).

    Raises:
        FlutterError: the robot flutters.
        SolveError: no stable equilibrium is reached.
    """
    lost, direction = (last, last.softest) if loss is None else (loss.point, loss.direction)
    if lost.member.flutters(lost.state):
        raise FlutterError(
            f"the robot begins to flutter at {100 * lost.t:.3f} % of the path: oscillations "
            "about the equilibrium grow, and their final equilibrium is unknown"
        )
    landed = fall(lost, direction)
    jump = 0.0 if landed is None else landed.member.distance(lost, landed.state)
    t = min(goal, lost.t + PAST)
    beyond = step_to(family, t, last) if jump <= SMOOTH_TURN else None
    # Where the branch does not continue beyond its end, even a small jump is a snap.
    if landed is not None and beyond is None and jump > MIN_JUMP:
        return Event(lost, landed)
    # Where it continues but is unstable, the branch that crosses it takes over: the nearest minimum beyond.
    side = None if beyond is None else fall(beyond, beyond.softest)
    if beyond is None or side is None:
        over = across(family, last, t)
        if over is not None:
            return Event(last, over) if over.member.distance(last, over.state) > MIN_JUMP else over
        raise SolveError(
            f"the branch ends at {100 * t:.3f} % of the path, and energy descent from there finds no equilibrium"
        )
    if landed is None and side.member.distance(beyond, side.state) > SMOOTH_TURN:
        return Event(replace(beyond, t=lost.t), side)
    return side


def segment(family: Family, origin: Equilibrium, index: int) -> tuple[Equilibrium, list[Snap]]:
    """Equilibrium at the end of a motion from a stable one, and the snaps on it, all after the waypoint `index`."""
    last, snaps = origin, list[Snap]()
    for step in motion(family, origin):
        if isinstance(step, Event):
            snaps.append(step.snap(index))
        else:
            last = step.pose
    return last, snaps
