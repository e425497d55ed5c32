"""Where a robot's tip and stations are on its way, with friction between the tubes: every row from the one before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from ..block.transcription.arm import Arm
from ..block.transcription.whole_arm import evaluate_arm
from ..equilibrium.friction import Held, to_held_equilibrium
from ..errors import InputError, SolveError
from ..robots.friction import Friction
from ..robots.robot import Robot
from ..stability.rubbing_following import rubbing_legs
from ..typing import Array, Index
from .poses import Poses, loose, tilt

COARSE = -1
"""Refinement of the mesh: where slip ends is then off by less than what tips are measured to."""


def rubbed_poses(
    robot: Robot, joints: tuple[Array, Array], stations: Array, runs: Sequence[Index], friction: Friction
) -> Poses:
    """Poses at joint values (N, n) of the model along `runs` of rows, of which each begins without a history.

    Rows of a run behind one at which the motion is lost have none.

    Raises:
        InputError: joint values at which the robot cannot be.
    """
    alpha, shift = joints
    coarse = replace(friction, refinement=min(friction.refinement, COARSE))
    count = len(alpha)
    position, frame = np.full((count, len(stations), 3), np.nan), np.full((count, 3, 3), np.nan)
    margin, length = np.full(count, np.nan), np.zeros(count)
    failures: list[tuple[int, str]] = []
    poses = Poses(position, frame, margin, length, ())
    curved = np.array([tube.curved_length for tube in robot.tubes])
    for run in runs:
        table, k = np.hstack([alpha[run], shift[run]]), 0
        try:
            for k, (held, _) in enumerate(rubbing_legs(robot, table, coarse, None)):
                arm, row = _arm(held), run[k]
                last = int(np.argmax(shift[row] + curved))
                length[row], margin[row] = arm.arc_length[-1], held.margin
                position[row] = _along(arm, stations)
                frame[row] = arm.frame[-1] @ _about_z(arm.rotation[last, -1])
                if loose(robot):
                    tilt(poses, row, to_held_equilibrium(robot, held, "way"), stations)
        except (InputError, SolveError) as error:
            failures += [(int(row), str(error)) for row in run[k + (not np.isnan(margin[run[k]])) :]]
    return replace(poses, failures=tuple(failures))


def _arm(held: Held) -> Arm:
    return evaluate_arm(held.contact.problem, held.rotations, held.found.state.torsion, held.profile)


def _along(arm: Arm, stations: Array) -> Array:
    """(K, 3) positions of stations behind the tip; on the plate's axis where they are behind the plate."""
    if not stations.any():
        return np.repeat(arm.position[-1:], len(stations), axis=0)
    at = arm.arc_length[-1] - stations
    line = scipy.interpolate.CubicHermiteSpline(arm.arc_length, arm.position, arm.frame[:, :, 2])
    out: Array = line(np.maximum(at, 0.0))
    out[:, 2] += np.minimum(at, 0.0)
    return out


def _about_z(angle: float) -> Array:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def with_torque(friction: Friction | None, torque: Array) -> Friction | None:
    """A friction with other torques per length (n - 1,), N m per m; None where nothing rubs."""
    changed = replace(friction or Friction(), torque=tuple(torque.tolist()) or (0.0,))
    return None if changed.trivial else changed
