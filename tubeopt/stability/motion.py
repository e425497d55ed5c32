"""Quasi-static motion along a straight way of joint values, with or without a load: points of the branch that is
followed, where the robot snaps, and where it lands."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from ..block.transcription.second_variation import softest
from ..display import Displayed
from ..equilibrium.continuation import JointPath, Point, follow_to, solve_at
from ..equilibrium.load_answer import to_loaded
from ..equilibrium.load_continuation import Family, LoadedPoint, carry, follow_family
from ..equilibrium.load_problem import LOADED_DISCRETISATION
from ..equilibrium.result import Equilibrium, Statistics
from ..equilibrium.solving import Solution, to_equilibrium
from ..errors import SolveError
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.settings import CONTINUATION
from ..typing import Array, Of, Sentence
from .folds import Fold, distance, land, polish_fold
from .loaded_events import Loss, branch_end, fall

P = TypeVar("P", Point, LoadedPoint)

Way = JointPath | Family

Place = Point | LoadedPoint


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
class Event(Generic[P]):
    """A snap on a way: the equilibrium that is lost, and the one in which the robot has landed."""

    lost: P
    landed: P


def way_between(robot: Robot, start: Array, end: Array, load: Load | None) -> Way:
    """The straight way from joint values (2n,) to others, under a load that stays."""
    if load is None:
        return JointPath(robot, start, end)
    return Family(JointPath(robot, start, end, LOADED_DISCRETISATION), load, load)


def steps_along(way: Way, start: Place) -> Iterator[Place | Event[Point] | Event[LoadedPoint]]:
    """Points of the motion from a stable one at the start of a way, the last at its end; an event wherever the robot
    snaps."""
    if isinstance(way, JointPath):
        assert isinstance(start, Point)
        return motion_along(way, start.solution)
    assert isinstance(start, LoadedPoint)
    return loaded_motion_along(way, replace(start, t=0.0, iterations=0))


def leg(way: Way, start: Place, index: int) -> tuple[Place, list[Snap]]:
    """The end of a motion from a stable point, and the snaps on it, which lie behind the waypoint `index`."""
    point, snaps = start, list[Snap]()
    for step in steps_along(way, start):
        if isinstance(step, Event):
            snaps.append(to_snap(way, step, index))
        else:
            point = step
    return point, snaps


def to_snap(way: Way, event: Event[Point] | Event[LoadedPoint], index: int) -> Snap:
    """An event on a way as a snap after the waypoint `index`."""
    before, after = told(way, event.lost, "fold"), told(way, event.landed, "energy descent")
    return Snap(index, event.lost.t, before, after)


def told(way: Way, place: Place, start: str) -> Equilibrium:
    """The equilibrium at a point of a way; `start` is how it was reached."""
    if isinstance(place, LoadedPoint):
        return to_loaded(place, (start, 0.0))
    assert isinstance(way, JointPath)
    translations = tuple(way.at(place.t)[1].tolist())
    return to_equilibrium(way.robot, place.solution, translations, ("newton", start, 0.0))


def motion_along(path: JointPath, solution: Solution) -> Iterator[Point | Event[Point]]:
    """Points of the motion from a stable solution at the start of a path; an event wherever the robot snaps.

    The last point is at the end of the path.
    """
    here = Point(0.0, solution)
    for goal in path.events():
        while here.t < goal:
            points, reached = follow_to(path, here, goal)
            yield from points
            here = points[-1] if points else here
            if reached:
                break
            fold = fold_ahead(path, here, min(goal, here.t + 1e-2))
            event = beyond(path, here, goal, fold or Fold(here.t, here.solution, _softest(here.solution)))
            if isinstance(event, Event):
                yield event
                here = event.landed
            else:
                here = event
            yield here


def fold_ahead(path: JointPath, here: Point, far: float) -> Fold | None:
    """The fold close ahead of a point of a stable branch, up to fraction `far`; None where none is found."""
    fold = polish_fold(path, here)
    return fold if fold is not None and here.t - 1e-6 <= fold.t <= far else None


def beyond(path: JointPath, here: Point, goal: float, fold: Fold) -> Event[Point] | Point:
    """What happens at a fold ahead of a point: a snap, or a smooth change to a neighbouring branch."""
    landed = land(fold.solution, fold.direction)
    turn = 0.0 if landed is None else distance(landed, fold.solution)
    t = min(goal, fold.t + CONTINUATION.past)
    unstable = solve_at(path, t, here) if turn <= CONTINUATION.smooth_turn else None
    # Without equilibria beyond the fold even a small turn is a snap.
    if landed is not None and unstable is None and turn > CONTINUATION.least_turn:
        return Event(Point(fold.t, fold.solution), Point(fold.t, landed))
    # A branch that crosses the stable one takes over: beyond the crossing it is the nearest minimum.
    landed = None if unstable is None else land(unstable.solution, _softest(unstable.solution))
    if landed is None:
        raise SolveError(f"the branch ends {100 * t:.3f} % of the way, and descent from there finds no equilibrium")
    return Point(t, landed)


def _softest(solution: Solution) -> Array:
    return softest(solution.problem, solution.result.state)


def loaded_motion_along(family: Family, start: LoadedPoint) -> Iterator[LoadedPoint | Event[LoadedPoint]]:
    """Points of the motion from a stable one at t = 0, the last at t = 1; an event wherever the robot snaps."""
    here, longest = start, family.path.largest_step()
    while here.t < 1.0:
        for point in follow_family(family, here, 1.0, longest=longest):
            yield point
            here = point
        if here.t >= 1.0:
            return
        step = _lost(family, here)
        yield step
        here = step.landed if isinstance(step, Event) else step
        if isinstance(step, Event):
            yield here


def _lost(family: Family, last: LoadedPoint) -> LoadedPoint | Event[LoadedPoint]:
    """What happens where the stable branch is lost: a snap, or a smooth change to a neighbouring branch."""
    loss = branch_end(family, last, 1.0)
    if loss is None:
        # Close to where breakpoints meet the exact fold may not be told; the last stable point is next to it.
        loss = Loss(last, "fold", last.softest)
    left, t = loss.point, loss.t
    if loss.kind == "bifurcation":
        t = min(1.0, loss.t + CONTINUATION.past)
        there = family.member(t)
        result = there.solve(carry(loss.point, there))
        left = LoadedPoint.of(there, result, t) if result.converged else loss.point
    landed = fall(left.member, left.state.x, loss.direction)
    if landed is None:
        raise SolveError(f"the branch ends {100 * t:.3f} % of the way, and descent from there finds no equilibrium")
    landed = replace(landed, t=left.t)
    turn = float(np.abs(landed.state.theta - left.state.theta).max(initial=0.0))
    bend = 2 * float(np.linalg.norm(landed.state.orientation.stage - left.state.orientation.stage, axis=1).max())
    if loss.kind == "bifurcation" and max(turn, bend) <= CONTINUATION.smooth_turn:
        return landed
    return Event(replace(left, t=loss.t), landed)
