"""The one-segment eccentric robot under mirror actuation: direction, separation and translation from a tip position.

In closed form for arms of constant curvature, the law of three vectors that the thesis begins with: the middle tube
turned to the direction theta_d and the other two by the separation theta_s to either side bend the arm with
kappa (1 + 2 cos theta_s) / 3 towards theta_d - 90 deg. From there Newton's method solves the full model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, vector
from ..robots.eccentric import EccentricRobot
from ..typing import Array
from .mirror import STRAIGHT, mirror_rotations, mirror_separation


@dataclass(frozen=True, eq=False)
class MirrorPose:
    """Mirror actuation for a tip position.

    direction, separation: rad; separation in [0, 120 deg].   translation: of the three tubes, m.
    rotations, translations: (3,) the same as joint values.
    equilibrium: what the robot does with them; None for the closed form.   position_error: m, NaN for the closed form.
    """

    direction: float
    separation: float
    translation: float
    rotations: Array
    translations: Array
    equilibrium: Equilibrium | None = None
    position_error: float = float("nan")


def mirror_closed_form(
    robot: EccentricRobot, position: ArrayLike, *, assignment: Sequence[int] = (0, 1, 2)
) -> MirrorPose:
    """Direction, separation and translation that put the tip of an arm of constant curvature at `position`.

    Exact for tubes on the centreline whose rotations are those at their tips, off by torsion and offsets for others.

    Args:
        position: (3,) m.
        assignment: as in `mirror_rotations`.

    Raises:
        InputError: numbers that are not finite, straight tubes, or a position out of reach: the message says why.
    """
    target = vector("position", position, 3, "x, y, z in m")
    tube = robot.tubes[0]
    kappa, longest = abs(tube.curvature), tube.curved_length
    if kappa == 0 or longest == 0:
        raise InputError("the robot's tubes are straight; they cannot bend it")
    radius, height = float(np.hypot(target[0], target[1])), float(target[2])
    bend, translation = _arc(radius, height, longest, kappa)
    low, high = _travel(robot)
    if bend > kappa * (1 + 1e-12):
        raise InputError(
            f"position asks for an arc with a curvature of {bend:.6g} per m; three tubes bend with at most {kappa:.6g}"
        )
    if not low - 1e-12 <= translation <= high + 1e-12:
        raise InputError(
            f"position asks for a translation of {translation:.6g} m; it must be from {low:.6g} to {high:.6g} m"
        )
    towards = np.arctan2(target[1], target[0]) if radius > 0 else 0.0
    direction = float(towards + np.copysign(np.pi / 2, tube.curvature))
    direction -= 2 * np.pi * round((direction - towards) / (2 * np.pi))
    separation = mirror_separation(bend / kappa)
    shift = float(np.clip(translation, low, high))
    return MirrorPose(
        direction, separation, shift, mirror_rotations(direction, separation, assignment), np.full(3, shift)
    )


def _travel(robot: EccentricRobot) -> tuple[float, float]:
    limits = np.array(robot.limits.translations)
    tube = robot.tubes[0]
    return max(float(limits[:, 0].max()), -tube.curved_length), min(float(limits[:, 1].min()), tube.straight_length)


def _arc(radius: float, height: float, longest: float, kappa: float) -> tuple[float, float]:
    """Curvature (1/m) and translation (m) of an arc of at most `longest` to a point; straight below it if advanced."""
    square = radius**2 + height**2
    if square == 0:
        return 0.0, -longest
    if radius == 0:
        # Straight up: any length of straight part above the plate that the travel allows; the least is taken.
        return 0.0, height - longest
    bend = 2 * radius / square
    length = 2 * np.arctan2(radius, height) / bend
    if length <= longest:
        return float(bend), float(length - longest)
    most = (1 - np.cos(min(kappa * longest, np.pi))) / min(kappa, np.pi / longest)
    if radius > most:
        raise InputError(
            f"position lies {radius:.6g} m off the axis; an arm advanced to there bends to at most {most:.6g} m"
        )
    bend = scipy.optimize.brentq(
        lambda k: (1 - np.cos(k * longest)) / k - radius, 1e-9 / longest, min(kappa, np.pi / longest) * (1 + 1e-12)
    )
    return float(bend), float(height - np.sin(bend * longest) / bend)


def mirror_pose(robot: EccentricRobot, position: ArrayLike, *, assignment: Sequence[int] = (0, 1, 2)) -> MirrorPose:
    """Direction, separation and translation that put the tip of the full model at `position`.

    Newton's method on the implicit derivatives of the equilibrium, from the closed form.

    Args:
        position, assignment: as in `mirror_closed_form`.

    Raises:
        InputError: a position that is no arc's (see `mirror_closed_form`).
        SolveError: Newton's method ends off the target; the message says by how far, `.solution` is where.
    """
    target = vector("position", position, 3, "x, y, z in m")
    start = mirror_closed_form(robot, target, assignment=assignment)
    unknown = np.array([start.direction, start.separation, start.translation])
    low, high = _travel(robot)
    motion = np.zeros((3, 2))
    motion[list(assignment)] = [[1.0, 0.0], [1.0, 1.0], [1.0, -1.0]]
    here = forward_kinematics(robot, start.rotations, start.translations)
    size = float(np.linalg.norm(here.tip_position - target))
    scale = np.array([1.0, 1.0, robot.tube.curved_length])
    for _ in range(30):
        if size <= 1e-9:
            break
        slope = here.jacobian().position
        reduced = np.column_stack([slope[:, :3] @ motion, slope[:, 3:].sum(1)])
        # Least squares, since a straight arm has no direction to be turned in.
        step = np.linalg.lstsq(reduced * scale, target - here.tip_position, rcond=1e-9)[0] * scale
        step *= min(1.0, 0.5 / max(float(np.abs(step[:2]).max()), 1e-300))
        for share in 0.5 ** np.arange(10):
            trial = unknown + share * step
            trial[1:] = np.clip(trial[1:], [0.0, low], [STRAIGHT, high])
            there = forward_kinematics(robot, mirror_rotations(trial[0], trial[1], assignment), np.full(3, trial[2]))
            new = float(np.linalg.norm(there.tip_position - target))
            if new < size:
                break
        if new >= size:
            break
        unknown, here, size = trial, there, new
    direction, separation, shift = (float(x) for x in unknown)
    found = MirrorPose(direction, separation, shift, here.rotations, here.translations, here, size)
    if size > 1e-7:
        raise SolveError(f"no mirror actuation was found: the best misses the position by {size:.3g} m", found)
    return found
