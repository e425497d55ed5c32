"""Quasi-static motion of a robot under a load that stays: snaps along paths of joint values."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..equilibrium.continuation import JointPath
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.load_answer import to_loaded
from ..equilibrium.load_continuation import JointFamily, LoadedPoint, carry, follow_family
from ..equilibrium.load_problem import LOADED_DISCRETISATION
from ..equilibrium.loaded import loaded_point
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.settings import CONTINUATION
from ..typing import Array
from .loaded_events import Loss, branch_end, fall
from .snap import Snap, snap_between


@dataclass(frozen=True, eq=False)
class LoadedEvent:
    """A snap on a segment: where the branch is lost, and the point where the robot has landed."""

    loss: Loss
    landed: LoadedPoint


def loaded_motion_along(family: JointFamily, start: LoadedPoint) -> Iterator[LoadedPoint | LoadedEvent]:
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
        here = step.landed if isinstance(step, LoadedEvent) else step
        if isinstance(step, LoadedEvent):
            yield here


def _lost(family: JointFamily, last: LoadedPoint) -> LoadedPoint | LoadedEvent:
    """What happens where the stable branch is lost: a snap, or a smooth change to a neighbouring branch."""
    loss = branch_end(family, last, 1.0)
    if loss is None:
        # Close to where breakpoints meet the exact fold may not be told; the last stable point is next to it.
        loss = Loss(last.t, last, "fold", last.softest)
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
    return LoadedEvent(replace(loss, point=left), landed)


def loaded_legs(
    robot: Robot, joints: Array, load: Load, start: Equilibrium | None
) -> Iterator[tuple[Equilibrium, list[Snap]]]:
    """Equilibria at the waypoints `joints` (T, 2 n), each with the snaps on the way to it."""
    first = loaded_start(robot, joints[0], load, start)
    point = loaded_point(first)
    yield first, []
    for k in range(len(joints) - 1):
        family = JointFamily(JointPath(robot, joints[k], joints[k + 1], LOADED_DISCRETISATION), load, load)
        point, snaps = loaded_leg(family, point, k)
        yield to_loaded(point, ("the waypoint before", 0.0)), snaps


def loaded_leg(family: JointFamily, start: LoadedPoint, index: int) -> tuple[LoadedPoint, list[Snap]]:
    """The end of a motion from a stable point, and the snaps on it, which lie behind the waypoint `index`."""
    point, snaps = replace(start, t=0.0, iterations=0), list[Snap]()
    for step in loaded_motion_along(family, point):
        if isinstance(step, LoadedPoint):
            point = step
        else:
            snaps.append(to_loaded_snap(step, index))
    return point, snaps


def to_loaded_snap(event: LoadedEvent, index: int) -> Snap:
    """An event as a snap after the waypoint `index`."""
    before, after = to_loaded(event.loss.point, ("fold", 0.0)), to_loaded(event.landed, ("energy descent", 0.0))
    return snap_between(index, event.loss.t, before, after)


def loaded_start(robot: Robot, joint: Array, load: Load, start: Equilibrium | None) -> Equilibrium:
    """The stable equilibrium under load at a waypoint: that of forward kinematics, or on the branch of `start`."""
    load.require_energy("snaps are not told")
    rotations, translations = np.split(joint, 2)
    first = start
    if start is None or start.load != load or not _at(start, joint):
        first = forward_kinematics(robot, rotations, translations, load=load, guess=start)
    assert first is not None
    if not first.stable:
        raise InputError(f"the start has margin {first.margin:.3g}; it must be a stable equilibrium (margin above 0)")
    return first


def _at(equilibrium: Equilibrium, joint: Array) -> bool:
    own = np.concatenate([equilibrium.rotations, equilibrium.translations])
    return bool(np.allclose(own, joint, rtol=0, atol=1e-12))
