"""Quasi-static motion along a family of problems, joints or load alike: where the robot snaps, and where it lands."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..display import Displayed
from ..equilibrium.continuation import Family, JointPath, follow, step_to
from ..equilibrium.load_answer import to_loaded
from ..equilibrium.load_problem import LOADED_DISCRETISATION
from ..equilibrium.member import Loaded, Place, solution_of
from ..equilibrium.result import Equilibrium, Statistics
from ..equilibrium.solving import to_equilibrium
from ..errors import SolveError
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.settings import CONTINUATION
from ..typing import Array, Of, Sentence
from .folds import Loss, branch_end, fall


class SnapStatus(Sentence):
    """How a snap ends; it reads as a sentence. One that does not land is no Snap, but raises SolveError."""

    LANDED = "the equilibrium was lost, and the robot landed in another one"


@dataclass(frozen=True, eq=False)
class Snap(Displayed):
    """One snap."""

    _brief = ("fraction", "rotations", "translations", "tip_jump", "energy_released")

    index: int
    """Of the waypoint before it."""
    fraction: float
    """Of the way to the next waypoint."""
    before: Equilibrium
    """That vanishes (margin 0), at the joint values of the snap."""
    after: Equilibrium
    """In which the robot lands."""

    rotations, translations = Of[Array]("before"), Of[Array]("before")

    @property
    def energy_released(self) -> float:
        """J."""
        return self.before.potential - self.after.potential

    @property
    def tip_jump(self) -> float:
        """m."""
        return float(np.linalg.norm(self.after.tip_position - self.before.tip_position))

    @property
    def value(self) -> float:
        """The fraction of the way."""
        return self.fraction

    @property
    def status(self) -> SnapStatus:
        """How it ends."""
        return SnapStatus.LANDED

    @property
    def statistics(self) -> Statistics:
        """What the equilibrium that vanishes took."""
        return self.before.statistics


@dataclass(frozen=True, eq=False)
class Event:
    """A snap of a family: the equilibrium that is lost, and the one in which the robot has landed."""

    lost: Place
    landed: Place


def family_between(robot: Robot, start: Array, end: Array, load: Load | None) -> Family:
    """Joint values (2n,) that go straight to others, under a load that stays or none."""
    if load is None:
        return Family(JointPath(robot, start, end))
    return Family(JointPath(robot, start, end, LOADED_DISCRETISATION), load, load)


def motion(family: Family, start: Place) -> Iterator[Place | Event]:
    """Points of the motion from a stable one at t = 0, the last at t = 1; an event wherever the robot snaps.

    Joints that move along a path and a load that turns into another one are followed alike.
    """
    here, shortest = replace(start, t=0.0), CONTINUATION.shortest_step
    for goal in family.path.events():
        while here.t < goal:
            for point in follow(family, here, goal, shortest=shortest):
                yield point
                here = point
            if here.t >= goal:
                break
            loss = branch_end(family, here, goal)
            if loss is None and shortest > CONTINUATION.sharpest_step:
                shortest = CONTINUATION.sharpest_step
                continue
            step, shortest = leave(family, here, loss, goal), CONTINUATION.shortest_step
            yield step
            here = step.landed if isinstance(step, Event) else step
            if isinstance(step, Event):
                yield here


def leave(family: Family, last: Place, loss: Loss | None, goal: float) -> Place | Event:
    """What happens after the last stable point, where the branch is lost: a snap, or a smooth change to a neighbouring
    branch."""
    lost, direction = (last, last.softest) if loss is None else (loss.point, loss.direction)
    landed = fall(lost, direction)
    turn = 0.0 if landed is None else landed.member.moved(lost, landed.state)
    t = min(goal, lost.t + CONTINUATION.past)
    beyond = step_to(family, t, last) if turn <= CONTINUATION.smooth_turn else None
    # Without equilibria beyond a fold even a small turn is a snap.
    if landed is not None and beyond is None and turn > CONTINUATION.least_turn:
        return Event(lost, landed)
    # A branch that crosses the stable one takes over: beyond the crossing it is the nearest minimum.
    side = None if beyond is None else fall(beyond, beyond.softest)
    if beyond is None or side is None:
        raise SolveError(f"the branch ends {100 * t:.3f} % of the way, and descent from there finds no equilibrium")
    if landed is None and side.member.moved(beyond, side.state) > CONTINUATION.smooth_turn:
        return Event(replace(beyond, t=lost.t), side)
    return side


def leg(family: Family, start: Place, index: int) -> tuple[Place, list[Snap]]:
    """The end of a motion from a stable point, and the snaps on it, which lie behind the waypoint `index`."""
    point, snaps = start, list[Snap]()
    for step in motion(family, start):
        if isinstance(step, Event):
            snaps.append(to_snap(step, index))
        else:
            point = step
    return point, snaps


def to_snap(event: Event, index: int) -> Snap:
    """An event as a snap after the waypoint `index`."""
    before, after = equilibrium_at(event.lost, "fold"), equilibrium_at(event.landed, "energy descent")
    return Snap(index, event.lost.t, before, after)


def equilibrium_at(point: Place, start: str) -> Equilibrium:
    """The equilibrium at a point; `start` is how it was reached."""
    member = point.member
    if isinstance(member, Loaded):
        return to_loaded(point, (start, 0.0))
    return to_equilibrium(member.robot, solution_of(point), member.translations, ("newton", start, 0.0))
