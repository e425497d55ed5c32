"""Symmetric ("mirror") actuation of a one-segment eccentric robot: a direction and a separation for three tubes.

One tube points in the direction, the other two are turned from it by the separation to either side (thesis, eq. 3.51).
Three equal vectors then add up to one in that direction, of length 1 + 2 cos(separation): the arm bends in a plane,
from the precurvature at separation 0 to straight at 120 deg. Torsion bends this law, and tubes off the centreline break
its symmetry a little: the inverse starts from the law and solves the equations themselves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, finite, positive, vector
from ..robots.eccentric import EccentricRobot
from ..robots.robot import shifts
from ..typing import Array

ASSIGNMENTS = ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))
"""The six ways to say which tube is in the middle, which ahead, and which behind."""

STRAIGHT = 2 * math.pi / 3
"""Separation at which the arm is straight, rad."""


def mirror_rotations(direction: float, separation: float, assignment: Sequence[int] = (0, 1, 2)) -> Array:
    """(3,) rotations of the tubes, rad (thesis, eq. 3.51).

    Args:
        direction: rotation theta_d of the middle tube, rad; at 0 the arm bends towards -y.
        separation: turn theta_s of the other two away from it, rad; 0 bends most, 120 deg is straight.
        assignment: tubes i, j, k (from 0) that turn to direction, direction + separation, direction - separation.

    Raises:
        InputError: an angle that is not finite, or an assignment that is none of `ASSIGNMENTS`.
    """
    middle, apart = finite("direction", direction), finite("separation", separation)
    order = tuple(int(i) for i in assignment)
    if order not in ASSIGNMENTS:
        raise InputError(f"assignment is {tuple(assignment)}; it must name the tubes 0, 1 and 2 once each")
    rotations = np.empty(3)
    rotations[list(order)] = middle, middle + apart, middle - apart
    return rotations


def mirror_separation(share: float) -> float:
    """Separation, rad, at which the law of three vectors bends the arm with this share of the precurvature; 0 from 1
    on."""
    return math.acos((3 * min(share, 1.0) - 1) / 2)


def arc_curvature(equilibrium: Equilibrium) -> Array:
    """(2,) 1/m: the arc that leaves the robot upright, where its tubes begin to curve, and ends at its tip.

    A vector towards the tip in the plate's x and y, of the length of the arc's curvature: 2 (x, y) / |p|^2. The arc is
    what a camera sees of an arm whose true curvature varies along it.
    """
    assembly = equilibrium.robot.assembly(equilibrium.translations)
    tip = equilibrium.tip_position - [0.0, 0.0, max(float(assembly.transition.min()), 0.0)]
    square = float(tip @ tip)
    return np.asarray(2 * tip[:2] / square if square else np.zeros(2))


def permuted_tips(
    robot: EccentricRobot, direction: float, separation: float, *, translations: ArrayLike | None = None
) -> tuple[Array, Array]:
    """Tips (6, 3) with the `ASSIGNMENTS` of one mirror actuation, and the tip (3,) of the same robot at d = 0, m.

    On the centreline equal tubes are interchangeable, so that one tip stands for all six.

    Raises:
        InputError, SolveError: as `forward_kinematics` does.
    """
    tips = [
        forward_kinematics(robot, mirror_rotations(direction, separation, order), translations).tip_position
        for order in ASSIGNMENTS
    ]
    centred = replace(robot, offset=0.0)
    reference = forward_kinematics(centred, mirror_rotations(direction, separation), translations)
    return np.array(tips), reference.tip_position


@dataclass(frozen=True, eq=False)
class MirrorInput:
    """Mirror actuation that does what was asked.

    Attributes:
        direction, separation: rad; separation in [0, 120 deg].
        rotations: (3,) of the tubes, rad.
        equilibrium: what the robot does with them.
        error: what is left between wanted and reached, 1/m for a curvature and m for a tip.
    """

    direction: float
    separation: float
    rotations: Array
    equilibrium: Equilibrium
    error: float


def mirror_inverse(
    robot: EccentricRobot,
    bending_direction: float,
    curvature: float,
    *,
    translations: ArrayLike | None = None,
    assignment: Sequence[int] = (0, 1, 2),
) -> MirrorInput:
    """Mirror actuation that bends the arm in a given direction with a given curvature.

    The law of three vectors is the guess; the answer solves forward kinematics for both numbers (SciPy's
    `least_squares`, a trust-region method).

    Args:
        bending_direction: azimuth of the tip, rad: 0 is towards x, 90 deg towards y.
        curvature: of the arc from plate to tip (see `arc_curvature`), 1/m, >= 0.
        translations, assignment: as in `forward_kinematics` and `mirror_rotations`.

    Raises:
        InputError: a number that is not finite, a curvature below 0 or above what the robot reaches, no precurvature.
        SolveError: forward kinematics failed on the way, or the robot snaps on it.
    """
    azimuth, wanted = finite("bending_direction", bending_direction), positive("curvature", curvature, zero=True)
    arm = _Arm(robot, translations, tuple(assignment), azimuth)
    target = wanted * np.array([math.cos(azimuth), math.sin(azimuth)])
    found = arm.solve(target, lambda each: arc_curvature(each) - target, arm.most)
    if found.error > 1e-7 * arm.most:
        most = float(np.linalg.norm(arc_curvature(arm.pose(*arm.inputs(arm.full))[1])))
        if wanted < most:
            raise SolveError(f"no mirror actuation was found: the best misses by {found.error:.3g} per m", found)
        raise InputError(
            f"curvature is {wanted:.6g} per m; towards {math.degrees(azimuth):.4g} deg this robot bends with at most "
            f"{most:.6g} per m"
        )
    return found


def mirror_to_tip(
    robot: EccentricRobot,
    position: ArrayLike,
    *,
    translations: ArrayLike | None = None,
    assignment: Sequence[int] = (0, 1, 2),
    tolerance: float = 1e-6,
) -> MirrorInput:
    """Mirror actuation that brings the tip to a point of the workspace, which is a surface.

    Args:
        position: (3,) m.
        translations, assignment: as in `forward_kinematics` and `mirror_rotations`.
        tolerance: distance from the surface at which a point still counts as on it, m.

    Raises:
        InputError: numbers that are not finite, no precurvature, or a position off the surface: the message says by how
            far, and which point of the surface is closest.
        SolveError: forward kinematics failed on the way.
    """
    target = vector("position", position, 3, "x, y, z in m")
    positive("tolerance", tolerance)
    azimuth = math.atan2(target[1], target[0])
    arm = _Arm(robot, translations, tuple(assignment), azimuth)
    above = target - [0.0, 0.0, arm.plate]
    length = arm.length
    square = max(float(above @ above), 1e-6 * length**2)

    def solve(start: Array) -> MirrorInput:
        return arm.solve(start, lambda each: each.tip_position - target, arm.most * length**2 / 2)

    found = solve(2 * above[:2] / square)
    if found.error > tolerance:
        # Off the surface there can be several points that are closer than their neighbours.
        found = min([found, solve(arm.full), solve(arm.full / 3)], key=lambda each: each.error)
    if found.error > tolerance:
        nearest = ", ".join(f"{1e3 * x:.4f}" for x in found.equilibrium.tip_position)
        raise InputError(
            f"position lies {1e3 * found.error:.4g} mm off the surface that the tip can reach; its closest point there "
            f"is ({nearest}) mm"
        )
    return found


class _Arm:
    """A robot under mirror actuation, and the law of three vectors from the curvature vector that is asked for."""

    def __init__(
        self, robot: EccentricRobot, translations: ArrayLike | None, assignment: tuple[int, ...], azimuth: float
    ) -> None:
        self.robot, self.translations, self.assignment, self.azimuth = robot, translations, assignment, azimuth
        self.most = abs(robot.tube.curvature)
        self.full = self.most * np.array([math.cos(azimuth), math.sin(azimuth)])
        if self.most == 0 or robot.tube.curved_length == 0:
            raise InputError("the robot's tubes are straight; they cannot bend it")
        shift = shifts(robot, translations)
        assembly = robot.assembly(shift)
        self.plate = max(float(assembly.transition.min()), 0.0)
        self.length = assembly.total_length - self.plate
        if self.length <= 0:
            raise InputError("the tubes are withdrawn behind the plate; nothing of them is left to bend")

    def inputs(self, bend: Array) -> tuple[float, float]:
        """Direction and separation that the law gives for a curvature vector `bend` (2,), clipped to what it allows."""
        size = math.hypot(*bend)
        towards = math.atan2(bend[1], bend[0]) if size > 1e-12 * self.most else self.azimuth
        # A tube of positive precurvature and rotation 0 bends towards -y.
        direction = towards + math.copysign(math.pi / 2, self.robot.tube.curvature)
        return _near(direction, self.azimuth), mirror_separation(size / self.most)

    def pose(self, direction: float, separation: float) -> tuple[Array, Equilibrium]:
        """Rotations and equilibrium for a direction and a separation."""
        rotations = mirror_rotations(direction, separation, self.assignment)
        return rotations, forward_kinematics(self.robot, rotations, self.translations)

    def solve(self, start: Array, gap: Callable[[Equilibrium], Array], scale: float) -> MirrorInput:
        """Least `gap` from a curvature vector (2,) on; `scale` is how much gap a whole curvature `most` makes.

        The unknowns are direction and separation where the arm is bent well, and the curvature vector where it is
        nearly straight: each is smooth where the other is not.
        """
        size = float(np.linalg.norm(start))
        start = start * min(1.0, self.most / size) if size else start
        bent = size > self.most / 2

        def angles(unknown: Array) -> tuple[float, float]:
            return (float(unknown[0]), float(unknown[1])) if bent else self.inputs(unknown * self.most)

        def residual(unknown: Array) -> Array:
            return gap(self.pose(*angles(unknown))[1]) / scale

        if bent:
            direction, separation = self.inputs(start)
            # The iteration moves inside of its bounds: it begins a little off them, and may end on them.
            guess, bounds = np.array([direction, max(separation, 1e-3)]), ([-np.inf, 0.0], [np.inf, STRAIGHT])
        else:
            guess, bounds = start / self.most, ([-np.inf] * 2, [np.inf] * 2)
        answer = scipy.optimize.least_squares(
            residual, guess, bounds=bounds, xtol=1e-14, ftol=1e-14, gtol=1e-14, max_nfev=200
        )
        direction, separation = angles(answer.x)
        rotations, equilibrium = self.pose(direction, separation)
        error = float(np.linalg.norm(gap(equilibrium)))
        return MirrorInput(_near(direction, self.azimuth), separation, rotations, equilibrium, error)


def _near(angle: float, other: float) -> float:
    """`angle`, by whole turns as near to `other` as it gets."""
    return angle - 2 * math.pi * round((angle - other) / (2 * math.pi))
