"""Symmetric ("mirror") actuation of a one-segment eccentric robot: a direction and a separation for three tubes.

One tube points in the direction, and the other two are rotated from it by the separation to either side (thesis, eq.
3.51). The sum of three equal vectors then has that direction and the length 1 + 2 cos(separation): the arm bends in a
plane, from the precurvature at separation 0 to straight at 120 deg. Torsion and offsets of the tubes change this law a
little. So a search for a bend or a tip starts from the law, or from its closed form for an arm of constant curvature,
and solves the full equations by the trust-region method of SciPy's `least_squares`.
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
"""The six permutations of the middle tube, the tube ahead and the tube behind."""

STRAIGHT = 2 * math.pi / 3
"""Separation of the tubes for a straight arm, rad."""


def mirror_rotations(direction: float, separation: float, assignment: Sequence[int] = (0, 1, 2)) -> Array:
    """Rotations (3,) of the tubes, rad (thesis, eq. 3.51).

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


def mirror_separation(fraction: float) -> float:
    """Separation, rad, that bends the arm with this fraction of the precurvature by the law of three vectors.

    It is 0 for fractions of 1 and more.
    """
    return math.acos((3 * min(fraction, 1.0) - 1) / 2)


def arc_curvature(equilibrium: Equilibrium) -> Array:
    """Curvature (2,) of the arc from plate to tip, 1/m, as a vector along x and y of the plate.

    It points towards the tip.

    The arc is tangent to the axis where the tubes start to curve. Its curvature vector is 2 (x, y) / |p|^2. For an arm
    of varying curvature, a camera sees this arc.
    """
    assembly = equilibrium.robot.assembly(equilibrium.translations)
    tip = equilibrium.tip_position - [0.0, 0.0, max(float(assembly.transition.min()), 0.0)]
    square = float(tip @ tip)
    return np.asarray(2 * tip[:2] / square if square else np.zeros(2))


@typed
def permuted_tips(
    robot: EccentricRobot, direction: float, separation: float, *, translations: ArrayLike | None = None
) -> tuple[Array, Array]:
    """Tips (6, 3) for the `ASSIGNMENTS` of one mirror actuation, and the tip (3,) at d = 0, m.

    On the centreline equal tubes are interchangeable, so that all six tips are one.

    Raises:
        InputError, SolveError: as for `forward_kinematics`.
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
    """Mirror actuation, and its joint values."""

    direction: float
    """Direction theta_d, rad."""
    separation: float
    """Separation theta_s, rad, in [0, 120 deg]."""
    rotations: Array
    """Rotations (3,) of the tubes, rad."""
    translations: Array
    """Translations (3,) of the tubes, m."""


@dataclass(frozen=True, eq=False)
class MirrorPose(MirrorInput):
    """Mirror actuation for a target."""

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
    azimuth, curvature = finite("bending_direction", bending_direction), positive("curvature", curvature, zero=True)
    arm = _Arm(robot, translations, tuple(assignment), azimuth)
    target = curvature * np.array([math.cos(azimuth), math.sin(azimuth)])
    pose = arm.solve(target, lambda equilibrium: arc_curvature(equilibrium) - target, arm.max_curvature)
    if pose.error > 1e-7 * arm.max_curvature:
        max_curvature = float(np.linalg.norm(arc_curvature(arm.pose(*arm.inputs(arm.full)))))
        if curvature < max_curvature:
            raise SolveError(f"no mirror actuation was found: the best misses by {pose.error:.3g} per m", pose)
        raise InputError(
            f"curvature is {curvature:.6g} per m; towards {math.degrees(azimuth):.4g} deg it "
            f"must be at most {max_curvature:.6g} per m"
        )
    return pose


@typed
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
        position: target (3,) of the tip, m.
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
        return arm.solve(
            start, lambda equilibrium: equilibrium.tip_position - target, arm.max_curvature * length**2 / 2
        )

    pose = solve(2 * above[:2] / square)
    if pose.error > tolerance:
        # Off the surface the distance can have several local minima.
        pose = min([pose, solve(arm.full), solve(arm.full / 3)], key=lambda candidate: candidate.error)
    if pose.error > tolerance:
        nearest = ", ".join(f"{1e3 * x:.4f}" for x in pose.equilibrium.tip_position)
        raise InputError(
            f"position is {1e3 * pose.error:.4g} mm off the surface that the tip can reach; its closest point there "
            f"is ({nearest}) mm"
        )
    return pose


@typed
def mirror_closed_form(
    robot: EccentricRobot, position: ArrayLike, *, assignment: Sequence[int] = (0, 1, 2)
) -> MirrorInput:
    """Mirror actuation and translation that bring the tip of an arm of constant curvature to `position`.

    It is exact for tubes on the centreline without torsion.

    Args:
        position: target (3,) of the tip, m.
        assignment: as in `mirror_rotations`.

    Raises:
        InputError: numbers that are not finite, straight tubes, or a position out of reach; the message states why.
    """
    arm, target = _aimed(robot, position, None, assignment)
    curvature, shift = arm.arc(target)
    direction, separation = arm.inputs(curvature)
    return MirrorInput(direction, separation, mirror_rotations(direction, separation, assignment), np.full(3, shift))


@typed
def mirror_pose(robot: EccentricRobot, position: ArrayLike, *, assignment: Sequence[int] = (0, 1, 2)) -> MirrorPose:
    """Mirror actuation and translation that bring the tip of the full model to `position`.

    Args:
        position, assignment: as in `mirror_closed_form`.

    Raises:
        InputError: a position that no arc reaches (see `mirror_closed_form`).
        SolveError: the search ends off the target; the message has the distance, and `.solution` the closest pose.
    """
    arm, target = _aimed(robot, position, None, assignment)
    curvature, shift = arm.arc(target)
    pose = arm.solve(curvature, lambda equilibrium: equilibrium.tip_position - target, robot.tube.curved_length, shift)
    if pose.error > 1e-7:
        raise SolveError(f"no mirror actuation was found: the best misses the position by {pose.error:.3g} m", pose)
    return pose


def _aimed(
    robot: EccentricRobot, position: ArrayLike, translations: ArrayLike | None, assignment: Sequence[int]
) -> tuple[_Arm, Array]:
    """Robot with an arm that bends towards a position, and the checked position."""
    target = vector("position", position, 3, "x, y, z in m")
    return _Arm(robot, translations, tuple(assignment), math.atan2(target[1], target[0])), target


class _Arm:
    """Robot under mirror actuation, with the law of three vectors."""

    def __init__(
        self, robot: EccentricRobot, translations: ArrayLike | None, assignment: tuple[int, ...], azimuth: float
    ) -> None:
        self.robot, self.assignment, self.azimuth = robot, assignment, azimuth
        self.translations = np.array(shifts(robot, translations))
        self.max_curvature = abs(robot.tube.curvature)
        self.full = self.max_curvature * np.array([math.cos(azimuth), math.sin(azimuth)])
        if self.max_curvature == 0 or robot.tube.curved_length == 0:
            raise InputError("the tubes are straight and cannot bend the robot")
        assembly = robot.assembly(self.translations)
        self.plate = max(float(assembly.transition.min()), 0.0)
        self.length = assembly.total_length - self.plate
        if self.length <= 0:
            raise InputError("the tubes are retracted behind the base plate and cannot bend the robot")

    @property
    def travel(self) -> tuple[float, float]:
        """Smallest and largest translation of the three tubes together, m."""
        limits, tube = np.array(self.robot.limits.translations), self.robot.tube
        return max(float(limits[:, 0].max()), -tube.curved_length), min(float(limits[:, 1].min()), tube.straight_length)

    def arc(self, target: Array) -> tuple[Array, float]:
        """Curvature vector (2,), 1/m, and translation, m, of an arc of constant curvature to a target (3,), m.

        A part of the arm below the arc may be straight.
        """
        radius, height = math.hypot(target[0], target[1]), float(target[2])
        curvature, translation = self._arc(radius, height)
        low, high = self.travel
        if curvature > self.max_curvature * (1 + 1e-12):
            raise InputError(
                f"position needs a curvature of {curvature:.6g} per m; it must be at most "
                f"{self.max_curvature:.6g} per m"
            )
        if not low - 1e-12 <= translation <= high + 1e-12:
            raise InputError(
                f"position needs a translation of {translation:.6g} m; it must be from {low:.6g} to {high:.6g} m"
            )
        return curvature * self.full / self.max_curvature, min(max(translation, low), high)

    def _arc(self, radius: float, height: float) -> tuple[float, float]:
        """Curvature (1/m) and translation (m) of an arc to a point at a distance from the axis and a height, m."""
        full_length, square = self.robot.tube.curved_length, radius**2 + height**2
        if square == 0:
            return 0.0, -full_length
        if radius == 0:
            # Any translation that leaves a straight part of the right length would do; this is the smallest one.
            return 0.0, height - full_length
        kappa = 2 * radius / square
        length = 2 * math.atan2(radius, height) / kappa
        if length <= full_length:
            return kappa, length - full_length
        # The whole curved part is out, above a straight part: its tip moves outwards up to half a circle.
        max_kappa = min(self.max_curvature, math.pi / full_length)
        max_radius = (1 - math.cos(max_kappa * full_length)) / max_kappa
        if radius > max_radius:
            raise InputError(
                f"position is {radius:.6g} m from the axis; at this depth it must be at most {max_radius:.6g} m"
            )
        kappa = scipy.optimize.brentq(
            lambda k: (1 - math.cos(k * full_length)) / k - radius, 1e-9 / full_length, max_kappa * (1 + 1e-12)
        )
        return kappa, height - math.sin(kappa * full_length) / kappa

    def inputs(self, curvature: Array) -> tuple[float, float]:
        """Direction and separation for a curvature vector (2,), by the law of three vectors, clipped to its range."""
        size = math.hypot(*curvature)
        azimuth = math.atan2(curvature[1], curvature[0]) if size > 1e-12 * self.max_curvature else self.azimuth
        # A tube of positive precurvature and rotation 0 bends towards -y.
        direction = azimuth + math.copysign(math.pi / 2, self.robot.tube.curvature)
        return _nearest_turn(direction, self.azimuth), mirror_separation(size / self.max_curvature)

    def pose(self, direction: float, separation: float, shift: float | None = None) -> Equilibrium:
        """Equilibrium for a direction, a separation, and a translation (m) if that is free."""
        translations = self.translations if shift is None else np.full(3, shift)
        return forward_kinematics(self.robot, mirror_rotations(direction, separation, self.assignment), translations)

    def solve(
        self,
        start: Array,
        residual: Callable[[Equilibrium], Array],
        scale: float,
        shift: float | None = None,
    ) -> MirrorPose:
        """Pose of the smallest `residual`, from a curvature vector `start` (2,), 1/m.

        The unknowns are direction and separation for a bent arm, and the curvature vector for a nearly straight one:
        each pair is smooth where the other is not.

        Args:
            scale: change of the residual by the curvature `max_curvature`.
            shift: start of the translation, m; None for a fixed one.
        """
        size = float(np.linalg.norm(start))
        start = start * min(1.0, self.max_curvature / size) if size else start
        bent = size > self.max_curvature / 2

        def actuation(x: Array) -> tuple[float, ...]:
            angles = (float(x[0]), float(x[1])) if bent else self.inputs(x[:2] * self.max_curvature)
            return (*angles, *np.clip(x[2:] * self.length, *self.travel).tolist())

        if bent:
            direction, separation = self.inputs(start)
            # The iteration stays inside of its bounds: it starts a little off them, and may end on them.
            guess, bounds = [direction, max(separation, 1e-3)], ([-np.inf, 0.0], [np.inf, STRAIGHT])
        else:
            guess, bounds = (start / self.max_curvature).tolist(), ([-np.inf] * 2, [np.inf] * 2)
        if shift is not None:
            initial, low, high = (translation / self.length for translation in (shift, *self.travel))
            guess, bounds = [*guess, initial], ([*bounds[0], low], [*bounds[1], max(high, low + 1e-9)])
        solution = scipy.optimize.least_squares(
            lambda x: residual(self.pose(*actuation(x))) / scale,
            guess,
            bounds=bounds,
            xtol=1e-14,
            ftol=1e-14,
            gtol=1e-14,
            max_nfev=200,
        )
        direction, separation, *_ = actuation(solution.x)
        equilibrium = self.pose(*actuation(solution.x))
        return MirrorPose(
            direction=_nearest_turn(direction, self.azimuth),
            separation=separation,
            rotations=equilibrium.rotations,
            translations=equilibrium.translations,
            equilibrium=equilibrium,
            error=float(np.linalg.norm(residual(equilibrium))),
        )


def _nearest_turn(angle: float, reference: float) -> float:
    """Angle nearest to a reference that differs from `angle` by full turns, rad."""
    return angle - 2 * math.pi * round((angle - reference) / (2 * math.pi))
