"""Interactive session with one robot: current equilibrium, path up to it, and log of events.

A session is data; every verb returns a new one. Motion is quasi-static and follows the branch of equilibria, so that
what the robot does depends on its history, as it does on a bench.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...constants import GRAVITY
from ...equilibrium.kinematics import forward_kinematics
from ...equilibrium.result import Equilibrium
from ...errors import InputError, SolveError, vector
from ...files.units import TO_MILLI, TO_MM
from ...inverse.joints import JointSpace, joint_space
from ...robots.load import Load
from ...robots.robot import Robot
from ...stability import Path, Snap, find_equilibria, follow
from ...stability.following import push
from ...stability.load_limit import LoadLimit, find_load_limit
from ...typing import Array
from ..formatting import degrees, millimetres, released, row

CLOSE = 0.25
"""Largest margin of a stable robot that is reported as close to a snap.

For the robot of the thesis that is 1 deg before it.
"""

TRAIL = 600
"""Maximum number of stored tip positions."""

TRAIL_TURN, TRAIL_SLIDE = np.radians(15.0), 0.005
"""Longer motions (rad, m) are remembered in parts."""

SAME_TIP = np.radians(0.1)
"""Largest difference of tip rotations (rad) of equal equilibria."""


@dataclass(frozen=True, eq=False)
class SessionEvent:
    """Event of a session: a sentence, and the snap if it was one."""

    text: str
    snap: Snap | None = None


@dataclass(frozen=True, eq=False)
class Session:
    """Robot in the viewer: its equilibrium, path and log."""

    equilibrium: Equilibrium
    """Current equilibrium."""
    log: tuple[SessionEvent, ...] = ()
    """Events, first to last."""
    last: tuple[Snap, ...] = ()
    """The snaps of the last motion, in their order."""
    trail: Array | None = None
    """(k, 4) tips (m) that the robot has passed, with the margin there, oldest first."""
    recording: tuple[Array, ...] | None = None
    """Joint values (2n,), rad and m, that were passed since recording began; None if nothing is recorded."""
    recorded_from: Equilibrium | None = None
    """Equilibrium at the start of the recording; None: not recording."""

    @property
    def robot(self) -> Robot:
        """Current robot; a redesign changes it."""
        return self.equilibrium.robot

    @property
    def q(self) -> Array:
        """(m,) independent joint values, see `space_of`."""
        return space_of(self.robot).join(self.equilibrium.rotations, self.equilibrium.translations)

    @property
    def verdict(self) -> str:
        """The state in a word: "stable", "close to a snap", "snapped" (by the last motion)."""
        if self.last:
            return "snapped"
        return "stable" if self.equilibrium.margin >= CLOSE else "close to a snap"


@lru_cache(maxsize=32)
def space_of(robot: Robot) -> JointSpace:
    """Joint space with one value per independent joint: n rotations (rad), then one translation (m) per carriage."""
    return joint_space(robot)


def open_session(robot: Robot, rotations: ArrayLike | None = None, translations: ArrayLike | None = None) -> Session:
    """New session at the equilibrium that a robot reaches at given joint values; by default at home.

    Raises:
        InputError: joint values out of the ranges of the robot's limits, or of the wrong number.
        SolveError: no stable equilibrium there.
    """
    n = robot.n_tubes
    alpha = vector("rotations", robot.home_rotations if rotations is None else rotations, n)
    shift = vector("translations", robot.home_translations if translations is None else translations, n)
    if rotations is not None or translations is not None:
        check(robot, alpha, shift, order=False)
    return moved_to(Session(forward_kinematics(robot, alpha, shift)))


def check(
    robot: Robot, rotations: Array, translations: Array, *, start: Array | None = None, order: bool = True
) -> None:
    """Raise InputError if joint values violate the robot's limits or the order of its tubes; it names the violation.

    start: joint values (m,) of the motion; if they violate the order themselves, the violation may stay, but not grow.
    """
    space, n = space_of(robot), robot.n_tubes
    q = space.join(rotations, translations)
    # Values from a slider or a file are rounded; `scale` makes rad and m comparable.
    tolerance = 1e-9 * space.scale
    for k in np.flatnonzero((q < space.lower - tolerance) | (q > space.upper + tolerance)):
        unit, factor = ("deg", np.degrees(1.0)) if k < n else ("mm", TO_MM)
        low, high = space.lower[k] * factor, space.upper[k] * factor
        raise InputError(f"{space.names[k]} is {q[k] * factor:g} {unit}; it must be from {low:g} to {high:g} {unit}")
    # Order of tubes: rows q >= least, a row for each pair of neighbours. Negative residuals are violations.
    residual = space.rows @ q - space.row_lower
    allowed_residual = (
        np.zeros_like(residual) if start is None else np.minimum(space.rows @ start - space.row_lower, 0.0)
    )
    violated = [space.row_names[k] for k in np.flatnonzero(residual < allowed_residual - 1e-9 * space.length)]
    if order and violated:
        raise InputError(f"the tubes would be out of order: {', '.join(violated)}")


class JointBound(NamedTuple):
    """End of the range of a joint, rad or m, and the name of the limiting constraint."""

    value: float
    name: str


def allowed(robot: Robot, q: Array, joint: int) -> tuple[JointBound, JointBound]:
    """Smallest and largest value of one joint with all others fixed at q, each with the name of its limit.

    If q violates the order itself, the joint may stay, but not increase the violation.
    """
    space = space_of(robot)
    low, high = (JointBound(float(ends[joint]), "end of its range") for ends in (space.lower, space.upper))
    for order, lower, name in zip(space.rows, space.row_lower, space.row_names, strict=True):
        if order[joint] != 0:
            # Solves order . q = min(lower, present value) for this joint, with the others fixed.
            bound = JointBound(float((min(lower, order @ q) - order @ q) / order[joint] + q[joint]), name)
            low, high = (max(low, bound), high) if order[joint] > 0 else (low, min(high, bound))
    return low, high


def move(session: Session, rotations: ArrayLike, translations: ArrayLike) -> Session:
    """Session after a slow, straight motion to other joint values along the branch; the log has the snaps.

    Args:
        rotations, translations: (n,) rad and m.

    Raises:
        InputError: joint values out of limits; the robot stays where it was.
        SolveError: the branch was lost; the robot stays where it was.
    """
    robot = session.robot
    alpha = vector("rotations", rotations, robot.n_tubes)
    shift = vector("translations", translations, robot.n_tubes)
    check(robot, alpha, shift, start=session.q)
    return _moved(session, alpha, shift)


def _moved(session: Session, rotations: Array, translations: Array) -> Session:
    start = session.equilibrium
    if np.array_equal(rotations, start.rotations) and np.array_equal(translations, start.translations):
        return session
    ends = (start.rotations, rotations), (start.translations, translations)
    (steps,) = strides(*map(np.array, ends), turn=TRAIL_TURN, slide=TRAIL_SLIDE)
    # Waypoints on the straight line add no turn: they are where the trail has points.
    part = np.linspace(0.0, 1.0, 1 + max(1, int(np.ceil(steps))))[:, None]
    path = follow(session.robot, *((1 - part) * a + part * b for a, b in ends), start=start, load=start.load)
    return moved_along(session, path)


def strides(rotations: Array, translations: Array, *, turn: float, slide: float) -> Array:
    """(T-1,) distances between waypoints (T, n) of the joint that moves most, in units of `turn`, rad,
    or `slide`, m.
    """
    kinds = (rotations, turn), (translations, slide)
    return np.asarray(np.max([np.abs(np.diff(q, axis=0)).max(1, initial=0.0) / unit for q, unit in kinds], axis=0))


def move_joint(session: Session, joint: int, value: float) -> tuple[Session, str]:
    """Session after a motion of one joint towards `value`, rad or m, as far as the other joints allow.

    Returns:
        The session, and a message if the joint was stopped before, else "".
    """
    robot, q = session.robot, session.q
    (low, lower), (high, upper) = allowed(robot, q, joint)
    reached = min(max(value, low), high)
    message = ""
    if abs(reached - value) > 1e-9:
        message = f"{space_of(robot).names[joint]} is stopped: {lower if value < low else upper}"
    q[joint] = reached
    rotations, translations = space_of(robot).split(q)
    return move(session, rotations, translations), message


def go_home(session: Session) -> Session:
    """Move straight to home, with snaps along the path."""
    robot = session.robot
    return _moved(session, robot.home_rotations, robot.home_translations)


def moved_along(session: Session, path: Path) -> Session:
    """Session after a motion of its robot along a path from its equilibrium."""
    passed: list[Equilibrium] = []
    for k, equilibrium in enumerate(path.equilibria[1:]):
        # Both sides of a snap, so that the trail shows the jump as a straight line.
        passed += [each for snap in path.snaps if snap.index == k for each in (snap.before, snap.after)]
        passed.append(equilibrium)
    return moved_to(session, passed[-1], path.snaps, passed=passed)


def moved_to(
    session: Session,
    equilibrium: Equilibrium | None = None,
    snaps: tuple[Snap, ...] = (),
    *,
    passed: Sequence[Equilibrium] | None = None,
) -> Session:
    """Session at a stable equilibrium, by default its own, with some snaps added to its log.

    passed: equilibria for the trail, the end included; by default the snaps and the end.
    """
    end = session.equilibrium if equilibrium is None else equilibrium
    steps = passed or [each for snap in snaps for each in (snap.before, snap.after)] + [end]
    tips = np.array([[*each.tip_position, each.margin] for each in steps])
    # Bounded, as the whole trail is sent to the browser with every change.
    trail = tips if session.trail is None else np.concatenate([session.trail, tips])[-TRAIL:]
    recording = session.recording
    if recording is not None:
        recording = (*recording, np.concatenate([end.rotations, end.translations]))
    log = (*session.log, *(SessionEvent(snap_text(snap), snap) for snap in snaps))
    return replace(session, equilibrium=end, log=log, last=tuple(snaps), trail=trail, recording=recording)


def note(session: Session, text: str) -> Session:
    """Session with a sentence in its log."""
    return replace(session, log=(*session.log, SessionEvent(text)))


def clear_trail(session: Session) -> Session:
    """Session with a trail that starts at its equilibrium."""
    return moved_to(replace(session, trail=None, last=()))


def snap_text(snap: Snap) -> str:
    """Sentence on a snap: joint values, tip jump, energy."""
    where = f"rotations {degrees(snap.rotations, '.4f')}"
    if np.any(snap.translations != snap.before.robot.home_translations):
        where += f", translations {millimetres(snap.translations, '.3f')}"
    if snap.before.load is not None:
        where += f", force {row(np.array(snap.before.load.force) * TO_MILLI, '.4f')} mN"
    return (
        f"snap at {where}: the tip jumped by {snap.tip_jump * TO_MM:.4f} mm"
        f"{released(snap.energy_released, ', {:.4f} mJ were released')}"
    )


def other_equilibria(session: Session) -> list[Equilibrium]:
    """Other equilibria at the same joint values, stable and unstable, the lowest energy first.

    Raises:
        SolveError: the set that was found is not complete.
    """
    shown = session.equilibrium
    equilibria = find_equilibria(session.robot, shown.rotations, shown.translations, load=shown.load)
    distance = [float(np.abs(each.tip_rotations - shown.tip_rotations).max()) for each in equilibria]
    # The session's own equilibrium is among them; the nearest is left out unless it clearly differs.
    nearest = int(np.argmin(distance)) if equilibria else -1
    return [each for k, each in enumerate(equilibria) if k != nearest or distance[k] > SAME_TIP]


def redesign(session: Session, robot: Robot) -> Session:
    """Session with other tubes at the same joint values, within the new limits and on the same branch if possible.

    Without a neighbouring shape among the new ones the robot is assembled afresh; the log states this.

    Raises:
        InputError: the robot has a load.
        SolveError: no stable equilibrium with the new tubes.
    """
    if session.equilibrium.load is not None:
        raise InputError("tubes can be changed without load only; remove the load first")
    old, space = session.equilibrium, space_of(robot)
    q, before = space.join(old.rotations, old.translations), space_of(old.robot)
    inside = bool((space.clip(q) == q).all())
    # Joint values out of order stay only where they were out of order before.
    keeps = inside and (space.admissible(q) or not before.admissible(session.q))
    rotations, translations = space.split(q if keeps else space.nearest(q))
    try:
        new = forward_kinematics(robot, rotations, translations, start=replace(old, robot=robot))
        # 0.5 rad: a neighbour on the branch changes with the tubes, a snap usually turns a tip by much more.
        same = new.stable and float(np.abs(new.tip_rotations - old.tip_rotations).max()) < 0.5
    except (SolveError, InputError):
        same = False
    if not same:
        new = forward_kinematics(robot, rotations, translations)
    fresh = record(replace(session, equilibrium=new, last=(), trail=None), session.recording is not None)
    if not same:
        fresh = note(fresh, "the old shape does not exist with these tubes: assembled afresh")
    if fresh.recording is not None:
        fresh = note(fresh, "the recording begins anew: it is of other tubes")
    return moved_to(fresh)


def record(session: Session, on: bool) -> Session:
    """Start recording the joint values of the robot, or stop and discard the recording."""
    start = session.equilibrium
    joints = np.concatenate([start.rotations, start.translations])
    return replace(session, recording=(joints,) if on else None, recorded_from=start if on else None)


ARROW = 5.0
"""Length of the arrow of a force, over the displacement of the tip in the softest direction, to first order."""

UP_TO = 10.0
"""Largest factor on a load in the search of its limit."""

DIRECTIONS: dict[str, tuple[float, float, float] | None] = {
    "none": None,
    "along +x": (GRAVITY, 0.0, 0.0),
    "along -x": (-GRAVITY, 0.0, 0.0),
    "along +y": (0.0, GRAVITY, 0.0),
    "along -y": (0.0, -GRAVITY, 0.0),
    "along +z": (0.0, 0.0, GRAVITY),
    "along -z": (0.0, 0.0, -GRAVITY),
}
"""Choices of gravity, m/s^2."""


def push_on(session: Session, load: Load) -> Session:
    """Session after a slow change of the load, with its snaps.

    Raises:
        InputError: an unsupported load: tubes of unknown weight, or in addition to one another.
        SolveError: the branch was lost; the robot stays as it was.
    """
    start = session.equilibrium
    if (start.load or Load()) == load:
        return session
    path = push(start, load)
    end = path.equilibria[-1]
    # Motion of the tip and redesign refuse an equilibrium with a load, even one without force.
    return moved_to(session, bare(end) if load == Load() else end, path.snaps)


def bare(equilibrium: Equilibrium) -> Equilibrium:
    """Equilibrium under a load of 0 N, converted to one without a load."""
    guess = replace(equilibrium, load=None)
    return forward_kinematics(equilibrium.robot, equilibrium.rotations, equilibrium.translations, start=guess)


def without_load(equilibrium: Equilibrium) -> Equilibrium | None:
    """Equilibrium after removing the load; None if the robot snaps before."""
    if equilibrium.load is None:
        return equilibrium
    path = push(equilibrium, Load())
    return None if path.snaps else bare(path.equilibria[-1])


def newtons_per_metre(equilibrium: Equilibrium) -> float:
    """Force on the tip per length of its arrow, N/m."""
    # The 2-norm is the largest singular value: displacement per force in the softest direction.
    softest = float(np.linalg.norm(equilibrium.compliance[:3, :3], 2))
    return 1 / (ARROW * softest)


def head_of(equilibrium: Equilibrium, scale: float) -> np.ndarray:
    """(3,) head of the arrow, m."""
    force = np.zeros(3) if equilibrium.load is None else np.array(equilibrium.load.force)
    return np.asarray(equilibrium.tip_position + force / scale)


def load_effect(equilibrium: Equilibrium) -> tuple[float, LoadLimit | None] | None:
    """Displacement of the tip by the load, m, and the load limit; None if the robot snaps when the load is removed.

    The limit is None if the robot withstands `UP_TO` times the load.

    Raises:
        SolveError: the branch is lost without a fold or bifurcation close by.
    """
    load, unloaded = equilibrium.load, without_load(equilibrium)
    if load is None or unloaded is None:
        return None
    joints = equilibrium.rotations, equilibrium.translations
    # From the unloaded state, as the limit is a factor on the whole load.
    limit = find_load_limit(equilibrium.robot, *joints, load, equilibrium=unloaded, up_to=UP_TO)
    return float(np.linalg.norm(equilibrium.tip_position - unloaded.tip_position)), limit


def equilibrium_load_text(equilibrium: Equilibrium) -> str:
    """Effect of the load in a sentence; "" without load."""
    load = equilibrium.load
    if load is None:
        return ""
    force = float(np.linalg.norm(load.force)) * TO_MILLI
    weight = " and weight" if load.gravity is not None else ""
    size = f"{force:.2f} mN{weight}"
    try:
        effect = load_effect(equilibrium)
    except SolveError as error:
        return f"{size}: {error}"
    if effect is None:
        return f"{size}: taken off, the robot snaps"
    displacement, limit = effect
    capacity = f"withstands more than {UP_TO:g} times as much"
    if limit is not None:
        failure = "snaps" if limit.kind == "fold" else "buckles"
        capacity = f"{failure} at {limit.factor:.4f} times as much"
    return f"{size}: tip moved by {displacement * TO_MM:.4f} mm, {capacity}"
