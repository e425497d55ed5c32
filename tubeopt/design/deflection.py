"""What a force on the tip does in a pose of a design: how far it moves it, and the largest that the arm bears along the
tip, with their change with the unknowns."""

from __future__ import annotations

import numpy as np

from ..block.quantities import PoseNumber
from ..equilibrium.arm_change import PARAMETERS
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..equilibrium.solving import to_equilibrium
from ..errors import InputError
from ..robots.concentric import ConcentricRobot
from ..robots.load import Load
from ..stability.stroke import stroke_slopes
from ..typing import Array
from .piece_pose import PiecePose
from .state import State

STRONGEST = 10.0
"""N; a pose that bears more along its tip counts as one that bears this."""


def tip_deflection(state: State, index: PoseNumber, force: tuple[float, float, float]) -> tuple[Array, Array]:
    """(3,) m and (3, X) of a force, N, that keeps its direction and grows on a pose; raises SolveError where the robot
    does not bear it there."""
    plain, names, rows = _unloaded(state, index, "deflection")
    pushed = forward_kinematics(plain.robot, plain.rotations, plain.translations, load=Load(force), guess=plain)
    change = -state.pose(index).tip_slope @ state.chain(index)
    if names:
        change += pushed.jacobian(wrt=names).position @ rows
    return pushed.tip_position - plain.tip_position, change


def stroke_force(state: State, index: PoseNumber) -> tuple[float, Array]:
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
