"""Quantities of a design, where equilibria are solved inside: values, and their change with the unknowns."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..block.quantities import PoseNumber, Quantity
from ..equilibrium.along import curvature_at, position_at
from ..equilibrium.arm_change import PARAMETERS
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..equilibrium.solving import to_equilibrium
from ..errors import InputError
from ..robots.concentric import ConcentricRobot
from ..robots.load import Load
from ..stability.stroke import stroke_slopes
from ..typing import Array
from .anatomy import arm_clearance
from .bending import pose_strain, straightened_strain
from .pose import PiecePose
from .state import State

Linear = Callable[[Quantity], tuple[Array, Array]]
"""Value and change (.., X) of a quantity."""


STRONGEST = 10.0
"""N; a pose that bears more along its tip counts as one that bears this."""


def at_state(state: State) -> Linear:
    """Quantities at a state; poses are numbered as in its layout."""

    def look(one: Quantity) -> tuple[Array, Array]:
        """Value and change of one quantity."""
        if one not in state.known:
            state.known[one] = _told(state, one)
        return state.known[one]

    return look


def _told(state: State, one: Quantity) -> tuple[Array, Array]:
    if one.name == "certificate":
        return _row(state.certificate_at(one.at))
    if one.name == "straightened_strain":
        return _row(straightened_strain(state, *one.at))
    if one.pose is None:
        return np.array([getattr(tube, one.name) for tube in state.tubes]), state.slopes[one.name]
    match one.name:
        case "rotations" | "translations":
            part = ("rotations", "translations").index(one.name)
            return state.joint_values(one.pose)[part], state.joint_slopes(one.pose)[part]
        case "strain":
            return _row(pose_strain(state, one.pose, one.at[0]))
        case "deflection":
            return _tip_deflection(state, one.pose, one.at)
        case "stroke_force":
            return _row(_stroke_force(state, one.pose))
        case "jacobian" | "turning":
            return state.jacobian(one.pose, turning=one.name == "turning")
        case "clearance":
            return arm_clearance(state, one.pose, one.at[0])
    value, change = _of_pose(state, one, one.pose)
    return value, change @ state.chain(one.pose)


def _row(found: tuple[float, Array]) -> tuple[Array, Array]:
    """(1,) and (1, X) of one number."""
    return np.array(found[:1]), found[1][None]


def _of_pose(state: State, one: Quantity, index: PoseNumber) -> tuple[Array, Array]:
    """Value and change (.., 7 n) by what a pose is differentiated by."""
    pose = state.pose(index)
    match one.name:
        case "tip_position":
            return pose.position[-1], pose.tip_slope
        case "tip_direction":
            heading = pose.frame[-1][:, 2]
            return heading, np.cross(pose.tip_turn, heading[:, None], axis=0)
        case "margin":
            return np.array([pose.margin]), pose.margin_slope[None]
        case "position":
            return position_at(pose.derivatives, one.at[0])
        case _:
            return curvature_at(pose.derivatives, one.at[0])


def _tip_deflection(state: State, index: PoseNumber, force: tuple[float, float, float]) -> tuple[Array, Array]:
    """(3,) m and (3, X) of a force, N, that keeps its direction and grows on a pose; raises SolveError where the robot
    does not bear it there."""
    plain, names, rows = _unloaded(state, index, "deflection")
    pushed = forward_kinematics(plain.robot, plain.rotations, plain.translations, load=Load(force), guess=plain)
    change = -state.pose(index).tip_slope @ state.chain(index)
    if names:
        change += pushed.jacobian(wrt=names).position @ rows
    return pushed.tip_position - plain.tip_position, change


def _stroke_force(state: State, index: PoseNumber) -> tuple[float, Array]:
    """The stroke force of a pose, N, at most STRONGEST, and its change (X,); raises SolveError where there is no limit
    close to where the branch is lost, or it has no derivative."""
    plain, names, rows = _unloaded(state, index, "stroke force")
    found = stroke_slopes(plain, names, STRONGEST)
    return (STRONGEST, np.zeros(state.layout.size)) if found is None else (found[0], found[1] @ rows)


def _unloaded(state: State, index: PoseNumber, what: str) -> tuple[Equilibrium, list[str], Array]:
    """The equilibrium of a pose, the PARAMETERS that some unknown moves, and their rows of the pose's chain: the others
    need not be differentiated."""
    pose, robot = state.pose(index), ConcentricRobot(state.tubes)
    if isinstance(pose, PiecePose):
        raise InputError(f"an expression speaks of the {what} in a pose; a design of pieces has none for it")
    shift = tuple(state.joint_values(index)[1].tolist())
    chain, n = state.chain(index), robot.n_tubes
    moves = np.asarray(chain.reshape(len(PARAMETERS), n, -1).any((1, 2)))
    names = [name for name, moved in zip(PARAMETERS, moves, strict=True) if moved]
    return to_equilibrium(robot, pose.solved, shift, ("newton", "guess", 0.0)), names, chain[np.repeat(moves, n)]
