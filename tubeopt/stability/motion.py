"""Quasi-static motion along a family of problems, joints or load alike: where the robot snaps, and where it lands."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np

from ..display import Displayed
from ..equilibrium.answer import point_of, to_equilibrium
from ..equilibrium.continuation import SHARPEST_STEP, SHORTEST_STEP, Family, JointPath, Milestone, follow, step_to
from ..equilibrium.kinematics import along
from ..equilibrium.member import Place
from ..equilibrium.problem import LOADED_DISCRETISATION
from ..equilibrium.result import Equilibrium, Statistics
from ..errors import SolveError
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.compiled.binding import kernel_of
from ..typing import Array, Delegate, StatusEnum
from .folds import PAST, Loss, branch_end, fall, fold_ahead


class SnapStatus(StatusEnum):
    """How a snap ends; it reads as a sentence. One that does not land is no Snap, but raises SolveError."""

    LANDED = "the robot snapped to another equilibrium"


@dataclass(frozen=True, eq=False)
class Snap(Displayed):
    """One snap: the vanishing equilibrium and the one after it."""

    _brief = ("fraction", "rotations", "translations", "tip_jump", "energy_released")

    index: int
    """Index of the waypoint before it."""
    fraction: Annotated[float, "fraction of the path to the snap"]
    """The path is that to the next waypoint."""
    before: Annotated[Equilibrium, "equilibrium that is lost"]
    """Its margin is 0, at the joint values of the snap."""
    after: Annotated[Equilibrium, "equilibrium after the snap"]

    rotations, translations = Delegate[Array]("before"), Delegate[Array]("before")

    @property
    def energy_released(self) -> float:
        """J; NaN under a load without an energy."""
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
        """Result, as a sentence."""
        return SnapStatus.LANDED

    @property
    def statistics(self) -> Statistics:
        """Statistics of the vanishing equilibrium."""
        return self.before.statistics


# Beside a bifurcation the new branch is reached within `PAST` of the path, where it is about 0.01 rad away. The
# smallest snaps, at the cusp where a hysteresis begins, have the same size: a smaller turn cannot be told from no snap.
SMOOTH_TURN = 0.05
"""Largest turn (rad) of a point by which the robot changes to a neighbouring branch at a bifurcation without a snap."""

LEAST_TURN = 1e-3
"""Turn (rad) above which the equilibrium where the robot lands differs from the one that it left."""


TAKEN_OVER, CLOSE = 0.1, 0.02
"""How far (rad) the general follower goes before the kernel is asked again; and how close to where the kernel declines
a fold lies that is the reason."""


@dataclass(frozen=True, eq=False)
class Event:
    """A snap of a family: the equilibrium that is lost, and the one in which the robot has landed."""

    lost: Place
    landed: Place

    @cached_property
    def before(self) -> Equilibrium:
        """That is lost."""
        return to_equilibrium(self.lost, "fold")

    @cached_property
    def after(self) -> Equilibrium:
        """In which the robot lands."""
        return to_equilibrium(self.landed, "energy descent")

    def snap(self, index: int) -> Snap:
        """That after the waypoint `index`."""
        return Snap(index, self.lost.t, self.before, self.after)


def family_between(robot: Robot, start: Array, end: Array, load: Load | None) -> Family:
    """Joint values (2n,) that go straight to others, under a load that stays or none."""
    if load is None:
        return Family(JointPath(robot, start, end))
    return Family(JointPath(robot, start, end, LOADED_DISCRETISATION), load, load)


def motion(family: Family, origin: Equilibrium) -> Iterator[Milestone | Event]:
    """Equilibria of the motion from a stable one at t = 0, the last at t = 1; an event wherever the robot snaps.

    Joints that move along a path and a load that turns into another one are followed alike: by the compiled kernel
    where it is at ease, else by the general follower, until the branch has ended in a snap or is at ease again.
    """
    here, scale = Milestone(0.0, origin), max(family.span(), CLOSE)
    # The kernel makes an energy least.
    kernel = kernel_of(family.path.robot) if all(load is None or load.has_energy for load in family.loads) else None
    while here.t < 1.0:
        if kernel is not None:
            for step in along(family, here):
                yield step
                here = step
            if here.t >= 1.0:
                return
        start, far, ahead = _point_of(family, here), 1.0, None
        if kernel is not None:
            far = min(1.0, here.t + TAKEN_OVER / scale)
            ahead = fold_ahead(family, start, min(1.0, here.t + CLOSE / scale))
        result = _slowly(family, start, far) if ahead is None else leave(family, start, ahead, 1.0)
        if isinstance(result, Event):
            yield result
            here = Milestone(result.landed.t, result.after)
        else:
            here = Milestone(result.t, to_equilibrium(result, "the path"))
        yield here


def _point_of(family: Family, here: Milestone) -> Place:
    """An equilibrium as a solved point of a family."""
    return replace(point_of(here.pose, None if family.load is None else Load()), t=here.t)


def _slowly(family: Family, start: Place, far: float) -> Place | Event:
    """Where the general follower comes from a stable point: to t = `far` or beyond, or to the next snap."""
    here, shortest = start, SHORTEST_STEP
    while here.t < far:
        goal = next(t for t in family.path.events() if t > here.t)
        for point in follow(family, here, goal, shortest=shortest):
            here = point
            if here.t >= far:
                return here
        if here.t >= goal:
            continue
        loss = branch_end(family, here, goal)
        if loss is None and shortest > SHARPEST_STEP:
            shortest = SHARPEST_STEP
            continue
        result, shortest = leave(family, here, loss, goal), SHORTEST_STEP
        if isinstance(result, Event):
            return result
        here = result
    return here


def leave(family: Family, last: Place, loss: Loss | None, goal: float) -> Place | Event:
    """What happens after the last stable point, where the branch is lost: a snap, or a smooth change to a neighbouring
    branch."""
    lost, direction = (last, last.softest) if loss is None else (loss.point, loss.direction)
    if lost.member.flutters(lost.state):
        raise SolveError(
            f"the robot begins to flutter at {100 * lost.t:.3f} % of the path: oscillations "
            "about the equilibrium grow, and their final equilibrium is unknown"
        )
    landed = fall(lost, direction)
    turn = 0.0 if landed is None else landed.member.moved(lost, landed.state)
    t = min(goal, lost.t + PAST)
    beyond = step_to(family, t, last) if turn <= SMOOTH_TURN else None
    # Without equilibria beyond a fold even a small turn is a snap.
    if landed is not None and beyond is None and turn > LEAST_TURN:
        return Event(lost, landed)
    # A branch that crosses the stable one takes over: beyond the crossing it is the nearest minimum.
    side = None if beyond is None else fall(beyond, beyond.softest)
    if beyond is None or side is None:
        raise SolveError(
            f"the branch ends at {100 * t:.3f} % of the path, and energy descent from there finds no equilibrium"
        )
    if landed is None and side.member.moved(beyond, side.state) > SMOOTH_TURN:
        return Event(replace(beyond, t=lost.t), side)
    return side


def leg(family: Family, origin: Equilibrium, index: int) -> tuple[Equilibrium, list[Snap]]:
    """The end of a motion from a stable equilibrium, and the snaps on it, which lie behind the waypoint `index`."""
    here, snaps = origin, list[Snap]()
    for step in motion(family, origin):
        if isinstance(step, Event):
            snaps.append(step.snap(index))
        else:
            here = step.pose
    return here, snaps
