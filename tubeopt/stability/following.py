"""Quasi-static motion along a path of joint values, with its history: where the robot snaps, and where it lands."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike

from ..block.transcription.second_variation import softest
from ..display import Displayed
from ..equilibrium.batch import joint_arrays
from ..equilibrium.continuation import JointPath, Point, follow_to, solve_at
from ..equilibrium.friction import Held, to_held_equilibrium
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.load_answer import to_loaded
from ..equilibrium.load_continuation import JointFamily
from ..equilibrium.load_problem import LOADED_DISCRETISATION
from ..equilibrium.loaded import loaded_point
from ..equilibrium.result import Equilibrium
from ..equilibrium.solving import Solution, polish, to_equilibrium
from ..errors import InputError, SolveError
from ..robots.friction import Friction
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.parallel.blas import small
from ..solvers.settings import CONTINUATION
from ..typing import Array, Sentence
from .folds import Fold, distance, land, polish_fold
from .loaded_following import loaded_leg, loaded_legs
from .rubbing_following import rubbing_legs
from .snap import Snap, snap_between

T = TypeVar("T")


class PathStatus(Sentence):
    """What a robot did on its way; every value reads as a sentence."""

    SMOOTH = "the robot came to all waypoints without a snap"
    SNAPPED = "the robot came to all waypoints, and snapped on the way"


@dataclass(frozen=True)
class PathStatistics:
    """Waypoints, snaps between them, and iterations of Newton's method that their equilibria took."""

    waypoints: int
    snaps: int
    iterations: int


class HeldEquilibria(Sequence[Equilibrium]):
    """Equilibria with friction at T waypoints, each of which is put together when it is first asked for."""

    def __init__(self, robot: Robot, states: Sequence[Held | Callable[[], Held]]) -> None:
        self._robot, self._states = robot, tuple(states)
        self._made: dict[int, Equilibrium] = {}

    def __len__(self) -> int:
        return len(self._states)

    @overload
    def __getitem__(self, at: int) -> Equilibrium: ...
    @overload
    def __getitem__(self, at: slice) -> tuple[Equilibrium, ...]: ...
    def __getitem__(self, at: int | slice) -> Equilibrium | tuple[Equilibrium, ...]:
        if isinstance(at, slice):
            return tuple(self[k] for k in range(*at.indices(len(self))))
        k = range(len(self))[at]
        if k not in self._made:
            state = self._states[k]
            held = state if isinstance(state, Held) else state()
            self._made[k] = to_held_equilibrium(self._robot, held, "the increment before")
        return self._made[k]


@dataclass(frozen=True, eq=False)
class Path(Displayed):
    """What a robot does along a path: one stable equilibrium per waypoint, and the snaps on the way."""

    equilibria: Sequence[Equilibrium]
    """(T,) at the waypoints."""
    snaps: tuple[Snap, ...]

    @property
    def value(self) -> Array:
        """(T, 3) the tips at the waypoints, m."""
        return np.array([each.tip_position for each in self.equilibria])

    @property
    def status(self) -> PathStatus:
        """Whether the robot snapped."""
        return PathStatus.SNAPPED if self.snaps else PathStatus.SMOOTH

    @property
    def statistics(self) -> PathStatistics:
        """What it took."""
        spent = sum(each.statistics.iterations for each in self.equilibria)
        return PathStatistics(len(self.equilibria), len(self.snaps), spent)


@dataclass(frozen=True, eq=False)
class Event:
    """The end of a branch on a segment: the fold, and the point where the robot has landed."""

    fold: Fold
    landed: Point


@small
def follow(
    robot: Robot,
    rotations: ArrayLike,
    translations: ArrayLike | None = None,
    *,
    start: Equilibrium | None = None,
    load: Load | None = None,
    friction: Friction | None = None,
    progress: Callable[[int], object] | None = None,
) -> Path:
    """Move a robot slowly through waypoints of joint values, along straight lines between them.

    Args:
        rotations, translations: (T, n) rad and m; translations default to home.
        start: stable equilibrium at the first waypoint; by default the one of `forward_kinematics`. If its joint
            values are others, the robot is first moved from there, and snaps on that way are not recorded.
        load: forces that keep their direction and stay on the robot; a start without it is first loaded.
        friction: between the tubes, which makes every state depend on the way to it. A start that bears it goes on with
            its history; one without it has none, as if it had been shaken.
        progress: called with the number of each waypoint that is reached.

    Raises:
        InputError: tables of the wrong shape, a value that is not finite, a tube out of its actuator, or an unstable
            start; a friction for another number of tubes, of an eccentric robot, or beside a load.
        SolveError: descent from a fold found no stable equilibrium, or a motion with friction was lost.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> path = tubeopt.follow(robot, [[0, 0], [1.0, 0], [1.0, 0.5]])
        >>> len(path.equilibria), len(path.snaps)
        (3, 0)
    """
    joints = np.concatenate(checked_waypoints(robot, rotations, translations), axis=1)
    if friction is not None and not friction.trivial:
        if load is not None:
            raise InputError("friction and a load are given; a motion is followed with one of them")
        states, snaps = _collected(rubbing_legs(robot, joints, friction, start), progress)
        return Path(HeldEquilibria(robot, states), snaps)
    legs = _legs(robot, joints, start) if load is None else loaded_legs(robot, joints, load, start)
    equilibria, snaps = _collected(legs, progress)
    return Path(tuple(equilibria), snaps)


def _collected(
    legs: Iterable[tuple[T, list[Snap]]], progress: Callable[[int], object] | None
) -> tuple[list[T], tuple[Snap, ...]]:
    """What is told of every waypoint, and all snaps on the way."""
    reached, snaps = list[T](), list[Snap]()
    for k, (there, found) in enumerate(legs):
        reached.append(there)
        snaps += found
        if progress is not None and k:
            progress(k)
    return reached, tuple(snaps)


def _legs(robot: Robot, joints: Array, start: Equilibrium | None) -> Iterator[tuple[Equilibrium, list[Snap]]]:
    """Equilibria at the waypoints `joints` (T, 2 n), each with the snaps on the way to it."""
    first = start if start is not None else forward_kinematics(robot, *np.split(joints[0], 2))
    if not first.stable:
        raise InputError(f"start has margin {first.margin:.3g}; it must be a stable equilibrium (margin above 0)")
    solution, own = polish(first), np.concatenate([first.rotations, first.translations])
    if not np.allclose(own, joints[0], rtol=0, atol=1e-12):
        solution, _ = _leg(JointPath(robot, own, joints[0]), solution, 0)
    yield _finish(robot, solution, joints[0], "start"), []
    for k in range(len(joints) - 1):
        solution, snaps = _leg(JointPath(robot, joints[k], joints[k + 1]), solution, k)
        yield _finish(robot, solution, joints[k + 1], "the waypoint before"), snaps


def _leg(path: JointPath, solution: Solution, index: int) -> tuple[Solution, list[Snap]]:
    """The end of a motion from a stable solution, and the snaps on it, which lie behind the waypoint `index`."""
    snaps = list[Snap]()
    for step in motion_along(path, solution):
        if isinstance(step, Point):
            solution = step.solution
        else:
            snaps.append(to_snap(path, step, index))
    return solution, snaps


def checked_waypoints(robot: Robot, rotations: ArrayLike, translations: ArrayLike | None) -> tuple[Array, Array]:
    """Rotations and translations (T, n) of waypoints, T at least 1; raises InputError where they are none."""
    alpha, shift = joint_arrays(robot, rotations, translations)
    if not len(alpha):
        raise InputError("rotations has no rows; it must have one per waypoint")
    changed = np.append(True, (np.diff(shift, axis=0) != 0).any(1))
    # Of tubes that all move by themselves only how far each is pushed is limited: the farthest tell of all.
    alone = all(len(tubes) == 1 for tubes in robot.moving_together)
    for row in shift[np.unique(shift.argmax(0)) if alone else changed]:
        robot.assembly(row)
    return alpha, shift


def _finish(robot: Robot, solution: Solution, joint: Array, start: str) -> Equilibrium:
    translations = tuple(np.split(joint, 2)[1].tolist())
    return to_equilibrium(robot, solution, translations, ("newton", start, 0.0))


def motion_along(path: JointPath, solution: Solution) -> Iterator[Point | Event]:
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


def beyond(path: JointPath, here: Point, goal: float, fold: Fold) -> Event | Point:
    """What happens at a fold ahead of a point: a snap, or a smooth change to a neighbouring branch."""
    landed = land(fold.solution, fold.direction)
    turn = 0.0 if landed is None else distance(landed, fold.solution)
    t = min(goal, fold.t + CONTINUATION.past)
    unstable = solve_at(path, t, here) if turn <= CONTINUATION.smooth_turn else None
    # Without equilibria beyond the fold even a small turn is a snap.
    if landed is not None and unstable is None and turn > CONTINUATION.least_turn:
        return Event(fold, Point(fold.t, landed))
    # A branch that crosses the stable one takes over: beyond the crossing it is the nearest minimum.
    landed = None if unstable is None else land(unstable.solution, _softest(unstable.solution))
    if landed is None:
        raise SolveError(f"the branch ends {100 * t:.3f} % of the way, and descent from there finds no equilibrium")
    return Point(t, landed)


def _softest(solution: Solution) -> Array:
    return softest(solution.problem, solution.result.state)


def to_snap(path: JointPath, event: Event, index: int) -> Snap:
    """An event on a path as a snap after the waypoint `index`."""
    joint = np.concatenate(path.at(event.fold.t))
    ends = (event.fold.solution, "fold"), (event.landed.solution, "energy descent")
    before, after = (_finish(path.robot, solution, joint, how) for solution, how in ends)
    return snap_between(index, event.fold.t, before, after)


@small
def push(equilibrium: Equilibrium, load: Load) -> Path:
    """What a robot does while the load on it turns evenly into another one: the equilibria at both ends, and the snaps
    between, at fractions of the way.

    Args:
        equilibrium: stable, with a load whose forces keep their direction, or without one.
        load: the new one; `Load()` takes the old one off.

    Raises:
        InputError: an unstable equilibrium, or a load without an energy.
        SolveError: descent from where the branch is lost finds no stable equilibrium.
    """
    robot, before = equilibrium.robot, equilibrium.load or Load()
    for each in (load, before):
        each.require_energy("snaps are not told")
    if not equilibrium.stable:
        raise InputError(f"equilibrium has margin {equilibrium.margin:.3g}; it must be stable (margin above 0)")
    alpha, shift = equilibrium.rotations, equilibrium.translations
    try:
        return Path((equilibrium, forward_kinematics(robot, alpha, shift, load=load, guess=equilibrium)), ())
    except SolveError:
        here = np.concatenate([alpha, shift])
    family = JointFamily(JointPath(robot, here, here, LOADED_DISCRETISATION), load, before)
    point, snaps = loaded_leg(family, loaded_point(equilibrium), 0)
    end = to_loaded(point)
    return Path((equilibrium, end), tuple(snaps))
