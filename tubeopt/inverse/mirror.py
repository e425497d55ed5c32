"""Symmetric ("mirror") actuation of a one-segment eccentric robot: a direction and a separation for three tubes.

One tube points in the direction, the other two are turned from it by the separation to either side (thesis, eq. 3.51).
Three equal vectors then add up to one in that direction, of length 1 + 2 cos(separation): the arm bends in a plane,
from the precurvature at separation 0 to straight at 120 deg. Torsion bends this law, and tubes off the centreline break
its symmetry a little: what asks for a bend or for a tip starts from the law, or from its closed form for an arm of
constant curvature, and solves the equations themselves by SciPy's `least_squares`, a trust-region method.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..arguments import typed
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, finite, positive, vector
from ..files.field_metadata import TYPICAL_TIP_ERROR, typical_length
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
        separation: rotation theta_s of the other two from it, rad; 0 bends most, 120 deg is straight.
        assignment: tubes i, j, k (from 0) with the rotations direction, direction + separation, direction - separation.

    Raises:
        InputError: an angle that is not finite, or an assignment other than `ASSIGNMENTS`.
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
    """(2,) curvature of the arc from the plate to the tip, 1/m, as a vector towards the tip in the plate's x and y.

    The arc leaves the robot along its axis, where its tubes begin to curve. Its curvature vector is 2 (x, y) / |p|^2. A
    camera sees this arc of an arm with varying curvature.
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
    """Mirror actuation, and the joint values that it makes."""

    direction: float
    """Direction theta_d, rad."""
    separation: float
    """rad, in [0, 120 deg]."""
    rotations: Array
    """(3,) of the tubes, rad."""
    translations: Array
    """(3,) of the tubes, m."""


@dataclass(frozen=True, eq=False)
class MirrorPose(MirrorInput):
    """Mirror actuation that does what was asked."""

    equilibrium: Equilibrium
    """Equilibrium for this actuation."""
    error: float
    """Difference between target and result, 1/m for a curvature and m for a tip."""


@typed
def mirror_inverse(
    robot: EccentricRobot,
    bending_direction: float,
    curvature: float,
    *,
    translations: ArrayLike | None = None,
    assignment: Sequence[int] = (0, 1, 2),
) -> MirrorPose:
    """Mirror actuation that bends the arm in a given direction with a given curvature.

    Args:
        bending_direction: azimuth of the tip, rad: 0 is towards x, 90 deg towards y.
        curvature: curvature of the arc from plate to tip (see `arc_curvature`), 1/m, >= 0.
        translations, assignment: as in `forward_kinematics` and `mirror_rotations`.

    Raises:
        InputError: a number that is not finite, a curvature below 0 or above the largest one, no precurvature.
        SolveError: forward kinematics failed on the path, or the robot snaps on it.
    """
    azimuth, wanted = finite("bending_direction", bending_direction), positive("curvature", curvature, zero=True)
    arm = _Arm(robot, translations, tuple(assignment), azimuth)
    target = wanted * np.array([math.cos(azimuth), math.sin(azimuth)])
    found = arm.solve(target, lambda each: arc_curvature(each) - target, arm.most)
    if found.error > 1e-7 * arm.most:
        most = float(np.linalg.norm(arc_curvature(arm.pose(*arm.inputs(arm.full)))))
        if wanted < most:
            raise SolveError(f"no mirror actuation was found: the best misses by {found.error:.3g} per m", found)
        raise InputError(
            f"curvature is {wanted:.6g} per m; towards {math.degrees(azimuth):.4g} deg it "
            f"must be at most {most:.6g} per m"
        )
    return found


def mirror_to_tip(
    robot: EccentricRobot,
    position: ArrayLike,
    *,
    translations: ArrayLike | None = None,
    assignment: Sequence[int] = (0, 1, 2),
    tolerance: float = 1e-6,
) -> MirrorPose:
    """Mirror actuation that brings the tip to a point of the workspace, which is a surface.

    Args:
        position: (3,) m.
        translations, assignment: as in `forward_kinematics` and `mirror_rotations`.
        tolerance: largest distance of a point from the surface, m.

    Raises:
        InputError: numbers that are not finite, no precurvature, or a position off the surface; the message states the
            distance and the closest point of the surface.
        SolveError: forward kinematics failed on the path.
    """
    arm, target = _aimed(robot, position, translations, assignment)
    typical_length("tolerance", tolerance, TYPICAL_TIP_ERROR)
    above = target - [0.0, 0.0, arm.plate]
    length = arm.length
    square = max(float(above @ above), 1e-6 * length**2)

    def solve(start: Array) -> MirrorPose:
        return arm.solve(start, lambda each: each.tip_position - target, arm.most * length**2 / 2)

    found = solve(2 * above[:2] / square)
    if found.error > tolerance:
        # Off the surface there can be several points that are closer than their neighbours.
        found = min([found, solve(arm.full), solve(arm.full / 3)], key=lambda each: each.error)
    if found.error > tolerance:
        nearest = ", ".join(f"{1e3 * x:.4f}" for x in found.equilibrium.tip_position)
        raise InputError(
            f"position is {1e3 * found.error:.4g} mm off the surface that the tip can reach; its closest point there "
            f"is ({nearest}) mm"
        )
    return found


def mirror_closed_form(
    robot: EccentricRobot, position: ArrayLike, *, assignment: Sequence[int] = (0, 1, 2)
) -> MirrorInput:
    """Direction, separation and translation that put the tip of an arm of constant curvature at `position`.

    Exact for tubes on the centreline without torsion; others deviate by torsion and offsets.

    Args:
        position: (3,) m.
        assignment: as in `mirror_rotations`.

    Raises:
        InputError: numbers that are not finite, straight tubes, or a position out of reach; the message states why.
    """
    arm, target = _aimed(robot, position, None, assignment)
    bend, shift = arm.arc(target)
    direction, separation = arm.inputs(bend)
    return MirrorInput(direction, separation, mirror_rotations(direction, separation, assignment), np.full(3, shift))


def mirror_pose(robot: EccentricRobot, position: ArrayLike, *, assignment: Sequence[int] = (0, 1, 2)) -> MirrorPose:
    """Direction, separation and translation that put the tip of the full model at `position`.

    Args:
        position, assignment: as in `mirror_closed_form`.

    Raises:
        InputError: a position that is no arc's (see `mirror_closed_form`).
        SolveError: the search ends off the target; the message says by how far, `.solution` is where.
    """
    arm, target = _aimed(robot, position, None, assignment)
    bend, shift = arm.arc(target)
    found = arm.solve(bend, lambda each: each.tip_position - target, robot.tube.curved_length, shift)
    if found.error > 1e-7:
        raise SolveError(f"no mirror actuation was found: the best misses the position by {found.error:.3g} m", found)
    return found


def _aimed(
    robot: EccentricRobot, position: ArrayLike, translations: ArrayLike | None, assignment: Sequence[int]
) -> tuple[_Arm, Array]:
    """The robot whose arm shall bend towards a position, and this, checked."""
    target = vector("position", position, 3, "x, y, z in m")
    return _Arm(robot, translations, tuple(assignment), math.atan2(target[1], target[0])), target


class _Arm:
    """A robot under mirror actuation, and the law of three vectors from the curvature vector that is asked for."""

    def __init__(
        self, robot: EccentricRobot, translations: ArrayLike | None, assignment: tuple[int, ...], azimuth: float
    ) -> None:
        self.robot, self.assignment, self.azimuth = robot, assignment, azimuth
        self.translations = np.array(shifts(robot, translations))
        self.most = abs(robot.tube.curvature)
        self.full = self.most * np.array([math.cos(azimuth), math.sin(azimuth)])
        if self.most == 0 or robot.tube.curved_length == 0:
            raise InputError("the tubes are straight and cannot bend the robot")
        assembly = robot.assembly(self.translations)
        self.plate = max(float(assembly.transition.min()), 0.0)
        self.length = assembly.total_length - self.plate
        if self.length <= 0:
            raise InputError("the tubes are retracted behind the base plate and cannot bend the robot")

    @property
    def travel(self) -> tuple[float, float]:
        """Least and greatest translation of the three tubes together, m."""
        limits, tube = np.array(self.robot.limits.translations), self.robot.tube
        return max(float(limits[:, 0].max()), -tube.curved_length), min(float(limits[:, 1].min()), tube.straight_length)

    def arc(self, target: Array) -> tuple[Array, float]:
        """Curvature vector (2,), 1/m, and translation, m, of an arc of constant curvature to a place (3,); straight
        below it if advanced."""
        radius, height = math.hypot(target[0], target[1]), float(target[2])
        size, translation = self._arc(radius, height)
        low, high = self.travel
        if size > self.most * (1 + 1e-12):
            raise InputError(
                f"position needs a curvature of {size:.6g} per m; it must be at most {self.most:.6g} per m"
            )
        if not low - 1e-12 <= translation <= high + 1e-12:
            raise InputError(
                f"position needs a translation of {translation:.6g} m; it must be from {low:.6g} to {high:.6g} m"
            )
        return size * self.full / self.most, min(max(translation, low), high)

    def _arc(self, radius: float, height: float) -> tuple[float, float]:
        """Curvature (1/m) and translation (m) of an arc to a place at a distance from the axis and a height, m."""
        longest, kappa, square = self.robot.tube.curved_length, self.most, radius**2 + height**2
        if square == 0:
            return 0.0, -longest
        if radius == 0:
            # Straight up: any length of straight part above the plate that the travel allows; the least is taken.
            return 0.0, height - longest
        bend = 2 * radius / square
        length = 2 * math.atan2(radius, height) / bend
        if length <= longest:
            return bend, length - longest
        sharpest = min(kappa, math.pi / longest)
        most = (1 - math.cos(sharpest * longest)) / sharpest
        if radius > most:
            raise InputError(f"position is {radius:.6g} m from the axis; at this depth it must be at most {most:.6g} m")
        bend = scipy.optimize.brentq(
            lambda k: (1 - math.cos(k * longest)) / k - radius, 1e-9 / longest, sharpest * (1 + 1e-12)
        )
        return bend, height - math.sin(bend * longest) / bend

    def inputs(self, bend: Array) -> tuple[float, float]:
        """Direction and separation that the law gives for a curvature vector `bend` (2,), clipped to what it allows."""
        size = math.hypot(*bend)
        towards = math.atan2(bend[1], bend[0]) if size > 1e-12 * self.most else self.azimuth
        # A tube of positive precurvature and rotation 0 bends towards -y.
        direction = towards + math.copysign(math.pi / 2, self.robot.tube.curvature)
        return _near(direction, self.azimuth), mirror_separation(size / self.most)

    def pose(self, direction: float, separation: float, shift: float | None = None) -> Equilibrium:
        """The equilibrium for a direction, a separation, and a translation (m) where that is free."""
        translations = self.translations if shift is None else np.full(3, shift)
        return forward_kinematics(self.robot, mirror_rotations(direction, separation, self.assignment), translations)

    def solve(
        self,
        start: Array,
        gap: Callable[[Equilibrium], Array],
        scale: float,
        shift: float | None = None,
    ) -> MirrorPose:
        """Least `gap` from a curvature vector (2,) on; `scale` is how much gap a whole curvature `most` makes; the
        translation, m, is free where it begins at a `shift`.

        The unknowns are direction and separation where the arm is bent well, and the curvature vector where it is
        nearly straight: each is smooth where the other is not.
        """
        size = float(np.linalg.norm(start))
        start = start * min(1.0, self.most / size) if size else start
        bent = size > self.most / 2

        def actuation(unknown: Array) -> tuple[float, ...]:
            angles = (float(unknown[0]), float(unknown[1])) if bent else self.inputs(unknown[:2] * self.most)
            return (*angles, *np.clip(unknown[2:] * self.length, *self.travel).tolist())

        if bent:
            direction, separation = self.inputs(start)
            # The iteration moves inside of its bounds: it begins a little off them, and may end on them.
            guess, bounds = [direction, max(separation, 1e-3)], ([-np.inf, 0.0], [np.inf, STRAIGHT])
        else:
            guess, bounds = (start / self.most).tolist(), ([-np.inf] * 2, [np.inf] * 2)
        if shift is not None:
            begin, low, high = (each / self.length for each in (shift, *self.travel))
            guess, bounds = [*guess, begin], ([*bounds[0], low], [*bounds[1], max(high, low + 1e-9)])
        answer = scipy.optimize.least_squares(
            lambda x: gap(self.pose(*actuation(x))) / scale,
            guess,
            bounds=bounds,
            xtol=1e-14,
            ftol=1e-14,
            gtol=1e-14,
            max_nfev=200,
        )
        direction, separation, *_ = actuation(answer.x)
        found = self.pose(*actuation(answer.x))
        error = float(np.linalg.norm(gap(found)))
        turned = _near(direction, self.azimuth)
        return MirrorPose(turned, separation, found.rotations, found.translations, found, error)


def _near(angle: float, other: float) -> float:
    """`angle`, by whole turns as near to `other` as it gets."""
    return angle - 2 * math.pi * round((angle - other) / (2 * math.pi))
