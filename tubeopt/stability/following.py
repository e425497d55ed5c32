"""Quasi-static motion along a path of joint values, with its history: where the robot snaps, and where it lands; the
first snap on a straight path."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Annotated, NamedTuple, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..display import Displayed
from ..equilibrium.batch import joint_arrays
from ..equilibrium.continuation import Family, JointPath
from ..equilibrium.friction import FrictionEquilibrium, to_held_equilibrium
from ..equilibrium.kinematics import forward_kinematics, under_load
from ..equilibrium.problem import LOADED_DISCRETISATION
from ..equilibrium.result import Equilibrium, refuse_friction, refuse_load
from ..errors import InputError, SolveError, vector
from ..robots.concentric import Friction
from ..robots.limits import check_turn
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.blas import small
from ..solvers.time_limit import LONG_TIME_LIMIT, TIME_LIMIT, limited
from ..typing import Array, StatusEnum
from .friction_path import rubbing_legs
from .motion import Event, Snap, family_between, leg, motion

T = TypeVar("T")

BETWEEN = 4
"""Steps of a dense path from one waypoint to the next."""

TO_A_SNAP = 16
"""Steps of a dense path from a waypoint to the snap after it, where the margin falls like a root."""


class PathStatus(StatusEnum):
    """What a robot did on its path; every value reads as a sentence."""

    SMOOTH = "the robot reached all waypoints without a snap"
    SNAPPED = "the robot reached all waypoints, with snaps"


@dataclass(frozen=True)
class PathStatistics:
    """What a motion took."""

    waypoints: int
    """That the robot came to."""
    snaps: int
    """Between the waypoints."""
    iterations: int
    """Of Newton's method that their equilibria took."""


class HeldEquilibria(Sequence[Equilibrium]):
    """Equilibria with friction at T waypoints, each of which is put together when it is first asked for."""

    def __init__(self, robot: Robot, states: Sequence[FrictionEquilibrium | Callable[[], FrictionEquilibrium]]) -> None:
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
            current = state if isinstance(state, FrictionEquilibrium) else state()
            self._made[k] = to_held_equilibrium(self._robot, current, "the increment before")
        return self._made[k]


class Stretch(NamedTuple):
    """Part of a path from one snap to the next."""

    at: Array
    """(P,) values at its points, such as the number of the waypoint."""
    equilibria: Sequence[Equilibrium]
    """(P,) equilibria there; at a snap the one that is lost, or the one after it."""


@dataclass(frozen=True, eq=False)
class Path(Displayed):
    """Motion of a robot along a path: one stable equilibrium per waypoint, and the snaps between them."""

    equilibria: Sequence[Equilibrium]
    """(T,) at the waypoints."""
    snaps: Annotated[tuple[Snap, ...], "snaps along the path"]
    """In order."""

    @cached_property
    def dense(self) -> tuple[Stretch, ...]:
        """Parts between snaps over the number of the waypoint, from 1, with equilibria between the waypoints. With
        friction it has no points between the waypoints, since their states depend on the history."""
        parts = stretches(self, np.arange(1.0, len(self.equilibria) + 1))
        if self.equilibria[0].friction is not None:
            return parts
        return tuple(_refined(part, ends_in_snap=part is not parts[-1]) for part in parts)

    @property
    def value(self) -> Array:
        """(T, 3) the tips at the waypoints, m."""
        return np.array([each.tip_position for each in self.equilibria])

    @property
    def status(self) -> PathStatus:
        """Whether the robot snapped, as a sentence."""
        return PathStatus.SNAPPED if self.snaps else PathStatus.SMOOTH

    @property
    def statistics(self) -> PathStatistics:
        """Numbers of equilibria and snaps, and solver iterations."""
        spent = sum(each.statistics.iterations for each in self.equilibria)
        return PathStatistics(len(self.equilibria), len(self.snaps), spent)


def place_of(snap: Snap, values: Array) -> float:
    """Value at a snap of a quantity with values (T,) at the waypoints, interpolated."""
    return float(values[snap.index] + snap.fraction * (values[snap.index + 1] - values[snap.index]))


def stretches(path: Path, values: Array) -> tuple[Stretch, ...]:
    """Parts of a path between its snaps, over values (T,) at the waypoints."""
    out: list[Stretch] = []
    where, what, done = [float(values[0])], [path.equilibria[0]], 1
    for snap in path.snaps:
        until = snap.index + 1
        here = place_of(snap, values)
        at = np.array([*where, *values[done:until].tolist(), here])
        out.append(Stretch(at, [*what, *path.equilibria[done:until], snap.before]))
        where, what, done = [here], [snap.after], max(done, until)
    out.append(Stretch(np.array([*where, *values[done:].tolist()]), [*what, *path.equilibria[done:]]))
    return tuple(out)


def _refined(part: Stretch, *, ends_in_snap: bool) -> Stretch:
    """A stretch with equilibria between its points, on straight joint paths, each started from the one before.

    Points that the solver does not reach, next to a fold, are left out.
    """
    at, equilibria = [float(part.at[0])], [part.equilibria[0]]
    for (first, start), (last, end) in pairwise(zip(part.at.tolist(), part.equilibria, strict=True)):
        to_fold = ends_in_snap and end is part.equilibria[-1]
        steps = TO_A_SNAP if to_fold else BETWEEN
        fraction = np.arange(1, steps) / steps
        fraction = 1 - (1 - fraction) ** 2 if to_fold else fraction  # the margin falls fastest next to the snap
        guess = start
        for x in fraction.tolist():
            turns = start.rotations + x * (end.rotations - start.rotations)
            shifts = start.translations + x * (end.translations - start.translations)
            try:
                guess = forward_kinematics(start.robot, turns, shifts, start=guess, load=start.load)
            except SolveError:
                break
            at.append(first + x * (last - first))
            equilibria.append(guess)
        at.append(last)
        equilibria.append(end)
    return Stretch(np.array(at), equilibria)


@typed
@small
@limited
def follow(
    robot: Robot,
    rotations: ArrayLike,
    translations: ArrayLike | None = None,
    *,
    start: Equilibrium | None = None,
    load: Load | None = None,
    friction: Friction | None = None,
    progress: Callable[[int], object] | None = None,
    time_limit: float = LONG_TIME_LIMIT,
) -> Path:
    """Quasi-static motion of a robot through waypoints of joint values, along straight lines between them.

    Args:
        rotations, translations: (T, n) rad and m; translations default to home.
        start: stable equilibrium at the first waypoint; by default that of `forward_kinematics`. From other joint
            values the robot is first moved to the first waypoint; snaps on that path are not recorded.
        load: constant external load; a start without it is first loaded.
        friction: friction between the tubes; every state then depends on its history. A start with friction continues
            its history. One without has none, like a robot after vibration.
        progress: called with the number of each waypoint that is reached.
        time_limit: maximum run time, s.

    Raises:
        InputError: tables of the wrong shape, a value that is not finite, a tube out of its actuator, or an unstable
            start. Friction for another number of tubes, or of an eccentric robot.
        SolveError: descent from a fold found no stable equilibrium, or a motion with friction was lost.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> path = tubeopt.follow(robot, [[0, 0], [1.0, 0], [1.0, 0.5]])
        >>> len(path.equilibria), len(path.snaps)
        (3, 0)
    """
    joints = np.concatenate(checked_waypoints(robot, rotations, translations), axis=1)
    if friction is not None and not friction.trivial:
        states, snaps = _collected(rubbing_legs(robot, joints, friction, start, load), progress)
        return Path(HeldEquilibria(robot, states), snaps)
    equilibria, snaps = _collected(_legs(robot, joints, load, start), progress)
    return Path(tuple(equilibria), snaps)


def _collected(
    legs: Iterable[tuple[T, list[Snap]]], progress: Callable[[int], object] | None
) -> tuple[list[T], tuple[Snap, ...]]:
    """What is told of every waypoint, and all snaps on the path."""
    reached, snaps = list[T](), list[Snap]()
    for k, (there, result) in enumerate(legs):
        reached.append(there)
        snaps += result
        if progress is not None and k:
            progress(k)
    return reached, tuple(snaps)


def _legs(
    robot: Robot, joints: Array, load: Load | None, start: Equilibrium | None
) -> Iterator[tuple[Equilibrium, list[Snap]]]:
    """Equilibria at the waypoints `joints` (T, 2 n), each with the snaps on the path to it."""
    pose = _start(robot, joints[0], load, start)
    yield pose, []
    for k, (here, there) in enumerate(pairwise(joints)):
        pose, snaps = leg(family_between(robot, here, there, load), pose, k)
        yield pose, snaps


def _start(
    robot: Robot, joint: Array, load: Load | None, start: Equilibrium | None, name: str = "start"
) -> Equilibrium:
    """The stable equilibrium at a waypoint under a load; `start`, which messages call `name`, is loaded first, then
    moved there."""
    first = start if start is not None else forward_kinematics(robot, *np.split(joint, 2), load=load)
    if not first.stable:
        raise InputError(f"{name} has margin {first.margin:.3g}; it must be a stable equilibrium (margin above 0)")
    if load is None:
        refuse_load(first)
    refuse_friction(first)
    if load is not None and first.load != load:
        first = under_load(first, load)
    own = np.concatenate([first.rotations, first.translations])
    if np.allclose(own, joint, rtol=0, atol=1e-12):
        return first
    return leg(family_between(robot, own, joint, load), first, 0)[0]


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


Configuration = tuple[ArrayLike, ArrayLike | None]


@typed
@small
@limited
def find_snap(
    robot: Robot,
    start: Configuration,
    end: Configuration,
    *,
    equilibrium: Equilibrium | None = None,
    load: Load | None = None,
    time_limit: float = TIME_LIMIT,
) -> Snap | None:
    """The first snap on the straight path from `start` to `end`, or None if the branch reaches the end.

    The branch is followed to its end; the fold there is the root of a bordered determinant.

    Args:
        start, end: (rotations, translations), each (n,), rad and m; translations may be None for home.
        equilibrium: stable equilibrium at `start` on the branch to follow; by default that of `forward_kinematics`.
        load: constant external load.
        time_limit: maximum run time, s.

    Raises:
        InputError: joint values of the wrong number, or not finite; an equilibrium that is unstable or not at `start`.
        SolveError: no stable equilibrium at `start`, or none where the robot lands.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import numpy as np
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> home = [0, 0, 0]
        >>> snap = tubeopt.find_snap(robot, (home, home), (np.radians([360, 0, 0]), home))
        >>> round(float(np.degrees(snap.rotations[0])), 3)
        214.222
    """
    family = family_between(robot, _joint(robot, "start", start), _joint(robot, "end", end), load)
    steps = motion(family, _first(robot, family, equilibrium))
    return next((step.snap(0) for step in steps if isinstance(step, Event)), None)


def _first(robot: Robot, family: Family, equilibrium: Equilibrium | None) -> Equilibrium:
    """The stable equilibrium at the start of a family, on the branch of an equilibrium if one is given."""
    start = family.path.start
    if equilibrium is not None:
        own = np.concatenate([equilibrium.rotations, equilibrium.translations])
        if np.abs(own - start).max() > 1e-9:
            raise InputError("equilibrium is at other joint values than start; they must be the same")
    return _start(robot, start, family.load, equilibrium, "equilibrium")


def _joint(robot: Robot, name: str, value: Configuration) -> Array:
    try:
        rotations, translations = value
    except (TypeError, ValueError):
        raise InputError(f"{name} is {value!r}; it must be a pair (rotations, translations)") from None
    home = robot.home_translations if translations is None else translations
    alpha = vector(f"rotations of {name}", rotations, robot.n_tubes)
    shift = vector(f"translations of {name}", home, robot.n_tubes)
    check_turn(alpha)
    robot.assembly(shift)
    return np.concatenate([alpha, shift])


@small
def push(equilibrium: Equilibrium, load: Load) -> Path:
    """What a robot does while the load on it turns evenly into another one: the equilibria at both ends, and the snaps
    between, at fractions of the path.

    Args:
        equilibrium: stable, with or without a load.
        load: the new one; `Load()` takes the old one off.

    Raises:
        InputError: an unstable equilibrium; loads in different frames.
        SolveError: descent from where the branch is lost finds no stable equilibrium.
    """
    robot, before = equilibrium.robot, equilibrium.load or Load()
    if not equilibrium.stable:
        raise InputError(f"equilibrium has margin {equilibrium.margin:.3g}; it must be stable (margin above 0)")
    alpha, shift = equilibrium.rotations, equilibrium.translations
    try:
        return Path((equilibrium, forward_kinematics(robot, alpha, shift, load=load, start=equilibrium)), ())
    except SolveError:
        here = np.concatenate([alpha, shift])
    family = Family(JointPath(robot, here, here, LOADED_DISCRETISATION), load, before)
    end, snaps = leg(family, equilibrium, 0)
    return Path((equilibrium, end), tuple(snaps))
