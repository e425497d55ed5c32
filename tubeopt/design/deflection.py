"""What a force on the tip does in a pose of a design: how far it moves it, and the largest that the arm bears along the
tip, with their change with the unknowns."""

from __future__ import annotations

import numpy as np

from ..equilibrium.arm_change import PARAMETERS
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.solving import to_equilibrium
from ..robots.concentric import ConcentricRobot
from ..robots.load import Load
from ..stability.stroke import stroke_slopes
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
    plain = to_equilibrium(robot, pose.solved, shift, ("newton", "guess", 0.0))
    pushed = forward_kinematics(robot, plain.rotations, shift, load=Load(force), guess=plain)
    names, rows = _moved(chain, robot.n_tubes)
    change = np.zeros((3, chain.shape[1]))
    if names:
        change += pushed.jacobian(wrt=names).position @ rows
    return pushed.tip_position - plain.tip_position, change - pose.tip_slope @ chain


STRONGEST = 10.0
"""N; a pose that bears more along its tip counts as one that bears this."""


def stroke_force(pose: Pose, robot: ConcentricRobot, translations: Array, chain: Array) -> tuple[float, Array]:
    """The stroke force of a pose, N, at most STRONGEST, and its change (X,); `chain` as above.

    Raises:
        SolveError: there is no limit close to where the branch is lost, or it has no derivative.
    """
    plain = to_equilibrium(robot, pose.solved, tuple(translations.tolist()), ("newton", "guess", 0.0))
    names, rows = _moved(chain, robot.n_tubes)
    found = stroke_slopes(plain, names, STRONGEST)
    return (STRONGEST, np.zeros(chain.shape[1])) if found is None else (found[0], found[1] @ rows)


def _moved(chain: Array, n: int) -> tuple[list[str], Array]:
    """The PARAMETERS that some unknown moves, and their rows of `chain`: the others need not be differentiated."""
    moves = np.asarray(chain.reshape(len(PARAMETERS), n, -1).any((1, 2)))
    return [name for name, moved in zip(PARAMETERS, moves, strict=True) if moved], chain[np.repeat(moves, n)]
