"""How far a force on the tip moves it in a pose of a design, and the change of that with the unknowns."""

from __future__ import annotations

import numpy as np

from ..equilibrium.arm_change import PARAMETERS
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.solving import to_equilibrium
from ..robots.concentric import ConcentricRobot
from ..robots.load import Load
from ..typing import Array
from .pose import Pose


def tip_deflection(
    pose: Pose, robot: ConcentricRobot, translations: Array, force: tuple[float, float, float], chain: Array
) -> tuple[Array, Array]:
    """(3,) m and (3, X) of a force, N, that keeps its direction and grows on a pose.

    `chain` (7 n, X) is the change of PARAMETERS with the unknowns.

    Raises:
        SolveError: the robot does not bear the force there.
    """
    shift = tuple(translations.tolist())
    plain = to_equilibrium(robot, pose.solution, shift, ("newton", "guess", 0.0))
    pushed = forward_kinematics(robot, plain.rotations, shift, load=Load(force), guess=plain)
    # What no unknown moves need not be differentiated.
    moves = np.asarray(chain.reshape(len(PARAMETERS), robot.n_tubes, -1).any((1, 2)))
    names = [name for name, moved in zip(PARAMETERS, moves, strict=True) if moved]
    change = np.zeros((3, chain.shape[1]))
    if names:
        change += pushed.jacobian(wrt=names).position @ chain[np.repeat(moves, robot.n_tubes)]
    return pushed.tip_position - plain.tip_position, change - pose.tip_slopes[0] @ chain
