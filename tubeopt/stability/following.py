"""Quasi-static motion through waypoints of joint values, with every snap; the first snap on a straight path."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Annotated, NamedTuple, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..bodies.obstacles import Obstacle
from ..display import Displayed
from ..equilibrium.batch import joint_arrays
from ..equilibrium.continuation import Family, SampledJointPath
from ..equilibrium.friction import FrictionEquilibrium, to_held_equilibrium
from ..equilibrium.kinematics import forward_kinematics, under_load
from ..equilibrium.problem import LOADED_DISCRETISATION
from ..equilibrium.result import Equilibrium, refuse_contact, refuse_load
from ..equilibrium.wall_contact import Walls
from ..errors import InputError, SolveError, vector
from ..robots.concentric import Friction
from ..robots.eccentric import by_model
from ..robots.limits import check_turn
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.blas import small
from ..solvers.time_limit import LONG_TIME_LIMIT, TIME_LIMIT, limited
from ..typing import Array, StatusEnum
from .friction_path import segments_with_friction
from .motion import Event, Snap, family_between, motion, segment
from .wall_path import segments_among_walls

T = TypeVar("T")

STEPS_PER_WAYPOINT = 4
"""Steps of a dense path from one waypoint to the next."""

STEPS_TO_SNAP = 16
"""Steps of a dense path from a waypoint to the snap after it, where the margin falls like a square root."""


class PathStatus(StatusEnum):
    """Outcome of a motion, as a sentence."""

    SMOOTH = "the robot reached all waypoints without a snap"
    SNAPPED = "the robot reached all waypoints, with snaps"


@dataclass(frozen=True)
class PathStatistics:
    """Effort of a motion."""

    waypoints: int
    """Number of waypoints reached."""
    snaps: int
    """Number of snaps on the path."""
    iterations: int
    """Number of Newton iterations of the equilibria at the waypoints."""


class HeldEquilibria(Sequence[Equilibrium]):
    """Equilibria with friction at T waypoints; each is computed from its state on first access."""

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


class PathStretch(NamedTuple):
    """Part of a path between two snaps."""

    at: Array
    """(P,) values at its points, such as the number of the waypoint."""
    equilibria: Sequence[Equilibrium]
    """(P,) equilibria at its points. The last is the one lost in the next snap, the first the one after a snap."""


@dataclass(frozen=True, eq=False)
class Path(Displayed):
    """Quasi-static motion: one stable equilibrium per waypoint, and the snaps between them."""

    equilibria: Sequence[Equilibrium]
    """(T,) stable equilibria at the waypoints."""
    snaps: Annotated[tuple[Snap, ...], "snaps along the path"]
    """Snaps in order along the path."""

    @cached_property
    def dense(self) -> tuple[PathStretch, ...]:
        """Parts between snaps over the number of the waypoint, from 1, with equilibria between the waypoints.

        With friction or among walls it has the waypoints only, since states in between depend on the history.
        """
        parts = stretches(self, np.arange(1.0, len(self.equilibria) + 1))
        if self.equilibria[0].friction is not None or self.equilibria[0].walls is not None:
            return parts
        return tuple(_refined(part, ends_in_snap=part is not parts[-1]) for part in parts)

    @property
    def value(self) -> Array:
        """(T, 3) tip positions at the waypoints, m."""
        return np.array([each.tip_position for each in self.equilibria])

    @property
    def status(self) -> PathStatus:
        """Outcome, with or without snaps, as a sentence."""
        return PathStatus.SNAPPED if self.snaps else PathStatus.SMOOTH

    @property
    def statistics(self) -> PathStatistics:
        """Numbers of equilibria and snaps, and solver iterations."""
        spent = sum(each.statistics.iterations for each in self.equilibria)
        return PathStatistics(len(self.equilibria), len(self.snaps), spent)


def value_at_snap(snap: Snap, values: Array) -> float:
    """Interpolated value at a snap of a quantity with values (T,) at the waypoints."""
    return float(values[snap.index] + snap.fraction * (values[snap.index + 1] - values[snap.index]))


def stretches(path: Path, values: Array) -> tuple[PathStretch, ...]:
    """Parts of a path between its snaps, with the values (T,) of a quantity at the waypoints."""
    out: list[PathStretch] = []
    start, first, waypoint = float(values[0]), path.equilibria[0], 1
    for snap in path.snaps:
        stop = snap.index + 1
        at_snap = value_at_snap(snap, values)
        at = np.array([start, *values[waypoint:stop].tolist(), at_snap])
        out.append(PathStretch(at, [first, *path.equilibria[waypoint:stop], snap.before]))
        start, first, waypoint = at_snap, snap.after, max(waypoint, stop)
    out.append(PathStretch(np.array([start, *values[waypoint:].tolist()]), [first, *path.equilibria[waypoint:]]))
    return tuple(out)


def _refined(part: PathStretch, *, ends_in_snap: bool) -> PathStretch:
    """Stretch with equilibria between its points, on straight joint paths, each started from the one before.

    Points next to a fold that the solver does not reach are left out.
    """
    at, equilibria = [float(part.at[0])], [part.equilibria[0]]
    for (first, start), (last, end) in pairwise(zip(part.at.tolist(), part.equilibria, strict=True)):
        to_fold = ends_in_snap and end is part.equilibria[-1]
        steps = STEPS_TO_SNAP if to_fold else STEPS_PER_WAYPOINT
        fraction = np.arange(1, steps) / steps
        # With t = 1 - x^2 the margin, a square root of the distance to the snap, falls linearly in x.
        fraction = 1 - (1 - fraction) ** 2 if to_fold else fraction
        guess = start
        for t in fraction.tolist():
            rotations = start.rotations + t * (end.rotations - start.rotations)
            translations = start.translations + t * (end.translations - start.translations)
            try:
                guess = forward_kinematics(start.robot, rotations, translations, start=guess, load=start.load)
            except SolveError:
                break
            at.append(first + t * (last - first))
            equilibria.append(guess)
        at.append(last)
        equilibria.append(end)
    return PathStretch(np.array(at), equilibria)


@typed
@by_model
@small
@limited
def follow(  # noqa: PLR0913
    robot: Robot,
    rotations: ArrayLike,
    translations: ArrayLike | None = None,
    *,
    start: Equilibrium | None = None,
    load: Load | None = None,
    friction: Friction | None = None,
    walls: Sequence[Obstacle] = (),
    progress: Callable[[int], object] | None = None,
    time_limit: float = LONG_TIME_LIMIT,
) -> Path:
    """Quasi-static motion of a robot through waypoints of joint values, along straight joint paths between them.

    Args:
        rotations, translations: (T, n) rad and m; translations default to home.
        start: stable equilibrium at the first waypoint; by default that of `forward_kinematics`. From other joint
            values the robot is first moved to the first waypoint; snaps on that path are not recorded.
        load: constant external load; a start without it is first loaded.
        friction: friction between the tubes; every state then depends on its history. A start with friction continues
            its history. One without has none, like a robot after vibration.
        walls: bodies that the arm cannot enter, as of `forward_kinematics`; not with friction.
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
    if walls:
        if friction is not None and not friction.trivial:
            raise InputError("walls and friction between the tubes are both given; together they are not supported")
        first = start or forward_kinematics(robot, *np.split(joints[0], 2), load=load, walls=walls)
        states_among, snaps_among = _collect(
            segments_among_walls(first, joints, Walls(robot, tuple(walls), load)), progress
        )
        return Path(tuple(states_among), snaps_among)
    if friction is not None and not friction.trivial:
        states, snaps = _collect(segments_with_friction(robot, joints, friction, start, load), progress)
        return Path(HeldEquilibria(robot, states), snaps)

    def segments() -> Iterator[tuple[Equilibrium, list[Snap]]]:
        equilibrium = _start(robot, joints[0], load, start)
        yield equilibrium, []
        for k, (waypoint, next_waypoint) in enumerate(pairwise(joints)):
            equilibrium, snaps = segment(family_between(robot, waypoint, next_waypoint, load), equilibrium, k)
            yield equilibrium, snaps

    equilibria, snaps = _collect(segments(), progress)
    return Path(tuple(equilibria), snaps)


def _collect(
    segments: Iterable[tuple[T, list[Snap]]], progress: Callable[[int], object] | None
) -> tuple[list[T], tuple[Snap, ...]]:
    """State at every waypoint, and all snaps, from `segments` of each state and the snaps before it."""
    states, snaps = list[T](), list[Snap]()
    for k, (state, snaps_before) in enumerate(segments):
        states.append(state)
        snaps += snaps_before
        if progress is not None and k:
            progress(k)
    return states, tuple(snaps)


def _start(
    robot: Robot, joint: Array, load: Load | None, start: Equilibrium | None, name: str = "start"
) -> Equilibrium:
    """Stable equilibrium at a waypoint (2n,) under a load, on the branch of `start`, which messages call `name`.

    The load on `start` changes first, then the robot moves to the waypoint. Snaps on both are ignored.
    """
    first = start if start is not None else forward_kinematics(robot, *np.split(joint, 2), load=load)
    if not first.stable:
        raise InputError(f"{name} has margin {first.margin:.3g}; it must be a stable equilibrium (margin above 0)")
    if load is None:
        refuse_load(first)
    refuse_contact(first)
    if load is not None and first.load != load:
        first = under_load(first, load)
    current = np.concatenate([first.rotations, first.translations])
    if np.allclose(current, joint, rtol=0, atol=1e-12):
        return first
    return segment(family_between(robot, current, joint, load), first, 0)[0]


def checked_waypoints(robot: Robot, rotations: ArrayLike, translations: ArrayLike | None) -> tuple[Array, Array]:
    """Rotations and translations (T, n) of waypoints, T at least 1.

    Raises:
        InputError: wrong shapes, no waypoint, or a tube out of its actuator.
    """
    alpha, shift = joint_arrays(robot, rotations, translations)
    if not len(alpha):
        raise InputError("rotations has no rows; it must have one per waypoint")
    changed = np.append(True, (np.diff(shift, axis=0) != 0).any(1))
    # Tubes with a carriage each have only an upper limit each: the rows with the largest translations suffice.
    independent = all(len(tubes) == 1 for tubes in robot.moving_together)
    for row in shift[np.unique(shift.argmax(0)) if independent else changed]:
        robot.admit(row)
    return alpha, shift


Configuration = tuple[ArrayLike, ArrayLike | None]


@typed
@by_model
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
    """First snap on the straight path from `start` to `end`, or None if the branch reaches the end.

    Continuation to the end of the branch; the fold there is solved as a root of the bordered determinant.

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
    if equilibrium is not None:
        current = np.concatenate([equilibrium.rotations, equilibrium.translations])
        if np.abs(current - family.path.start).max() > 1e-9:
            raise InputError("equilibrium is at other joint values than start; they must be the same")
    steps = motion(family, _start(robot, family.path.start, load, equilibrium, "equilibrium"))
    return next((step.snap(0) for step in steps if isinstance(step, Event)), None)


def _joint(robot: Robot, name: str, value: Configuration) -> Array:
    """(2n,) joint values of the argument `name`, checked."""
    try:
        rotations, translations = value
    except (TypeError, ValueError):
        raise InputError(f"{name} is {value!r}; it must be a pair (rotations, translations)") from None
    home = robot.home_translations if translations is None else translations
    alpha = vector(f"rotations of {name}", rotations, robot.n_tubes)
    shift = vector(f"translations of {name}", home, robot.n_tubes)
    check_turn(alpha)
    robot.admit(shift)
    return np.concatenate([alpha, shift])


@small
def push(equilibrium: Equilibrium, load: Load) -> Path:
    """Equilibria before and after a quasi-static linear change of the load, and the snaps between them.

    Args:
        equilibrium: stable, with or without a load.
        load: the new load; `Load()` for none.

    Raises:
        InputError: an unstable equilibrium; loads in different frames.
        SolveError: descent from the end of a branch finds no stable equilibrium.
    """
    robot, before = equilibrium.robot, equilibrium.load or Load()
    if not equilibrium.stable:
        raise InputError(f"equilibrium has margin {equilibrium.margin:.3g}; it must be stable (margin above 0)")
    alpha, shift = equilibrium.rotations, equilibrium.translations
    try:
        return Path((equilibrium, forward_kinematics(robot, alpha, shift, load=load, start=equilibrium)), ())
    except SolveError:
        joint = np.concatenate([alpha, shift])
    family = Family(SampledJointPath(robot, joint, joint, LOADED_DISCRETISATION), load, before)
    end, snaps = segment(family, equilibrium, 0)
    return Path((equilibrium, end), tuple(snaps))
