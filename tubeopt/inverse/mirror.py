"""Symmetric ("mirror") actuation of eccentric robots: a direction and a separation for the three tubes of a segment.

One tube points in the direction, and the other two are rotated from it by the separation to either side (thesis, eq.
3.51). The sum of three equal vectors then has that direction and the length 1 + 2 cos(separation): the arm bends in a
plane, from the precurvature at separation 0 to straight at 120 deg. Torsion and offsets of the tubes change this law a
little. So a search for a bend or a tip starts from the law, or from its closed form for an arm of constant curvature,
and solves the full equations by the trust-region method of SciPy's `least_squares` with their exact derivatives.

A robot of several segments has this actuation in each. The start is then a chain of arcs, and a Gauss-Newton method
with the exact derivatives of the tip solves the full equations: translations are kept in the order of the tubes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..arguments import typed
from ..equilibrium.jacobian import position_slopes
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.linearised import curvature_at, linearise
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, finite, positive, vector
from ..files.field_metadata import TYPICAL_TIP_ERROR, typical_length
from ..robots.eccentric import EccentricRobot, SegmentedEccentricRobot
from ..robots.robot import shifts
from ..solvers.compiled.quadratic import constrained_least_squares
from ..typing import Array
from .goal import unit_vector
from .joints import joint_space
from .posture import Posture

ASSIGNMENTS = ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))
"""The six permutations of the middle tube, the tube ahead and the tube behind."""

STRAIGHT = 2 * math.pi / 3
"""Separation of the tubes for a straight arm, rad."""


def mirror_rotations(direction: ArrayLike, separation: ArrayLike, assignment: Sequence[int] = (0, 1, 2)) -> Array:
    """Rotations (3,) of the tubes, rad (thesis, eq. 3.51); (3 k,) of k segments for k directions and separations.

    Args:
        direction: rotation theta_d of the middle tube, rad; at 0 the arm bends towards -y. (k,) for k segments, inner
            to outer.
        separation: rotation theta_s of the other two from it, rad; 0 bends most, 120 deg is straight. (k,) as well.
        assignment: tubes i, j, k (from 0) with the rotations direction, direction + separation, direction - separation.

    Raises:
        InputError: an angle that is not finite, or an assignment other than `ASSIGNMENTS`.
    """
    if np.ndim(direction):
        middles = vector("direction", direction, np.size(direction), "one per segment")
        aparts = vector("separation", separation, len(middles), "one per segment")
        pairs = zip(middles.tolist(), aparts.tolist(), strict=True)
        return np.concatenate([mirror_rotations(*pair, assignment) for pair in pairs])
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


def _law_slope(x: float, y: float) -> Array:
    """Derivatives (2, 2) of direction and separation, rad, by a bend (x, y) as a fraction of the precurvature."""
    size = max(math.hypot(x, y), 1e-9)
    # Beyond the largest bend, the separation stays 0.
    rate = -1.5 / math.sin(mirror_separation(size)) / size if size < 1 else 0.0
    return np.array([[-y / size**2, x / size**2], [rate * x, rate * y]])


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


def _arc_slope(equilibrium: Equilibrium) -> Array:
    """Derivative (2, 3) of `arc_curvature` by the tip position, at fixed translations."""
    assembly = equilibrium.robot.assembly(equilibrium.translations)
    tip = equilibrium.tip_position - [0.0, 0.0, max(float(assembly.transition.min()), 0.0)]
    square = float(tip @ tip)
    return np.asarray((2 * np.eye(3)[:2] - 4 * np.outer(tip[:2], tip) / square) / square)


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

    direction: float | Array
    """Direction theta_d, rad; (k,) of a robot of k segments, inner to outer."""
    separation: float | Array
    """Separation theta_s, rad, in [0, 120 deg]; (k,) as well."""
    rotations: Array
    """Rotations (3,) or (3 k,) of the tubes, rad."""
    translations: Array
    """Translations (3,) or (3 k,) of the tubes, m."""


@dataclass(frozen=True, eq=False)
class MirrorPose(MirrorInput):
    """Mirror actuation for a target."""

    equilibrium: Equilibrium
    """Equilibrium for this actuation."""
    error: float
    """Difference between target and result, 1/m for a curvature and m for a tip."""


@typed
def mirror_inverse(
    robot: EccentricRobot | SegmentedEccentricRobot,
    bending_direction: ArrayLike,
    curvature: ArrayLike,
    *,
    translations: ArrayLike | None = None,
    assignment: Sequence[int] = (0, 1, 2),
) -> MirrorPose:
    """Mirror actuation that bends the arm, or each of its segments, in a given direction with a given curvature.

    Args:
        bending_direction: azimuth of the tip, rad: 0 is towards x, 90 deg towards y. (k,) for a robot of k segments,
            inner to outer.
        curvature: curvature of the arc from plate to tip (see `arc_curvature`), 1/m, >= 0. (k,) for k segments: the
            mean along each (see `segment_curvatures`).
        translations, assignment: as in `forward_kinematics` and `mirror_rotations`.

    Raises:
        InputError: a number that is not finite, a curvature below 0 or above the largest one, no precurvature.
        SolveError: forward kinematics failed on the path, or the robot snaps on it.
    """
    if isinstance(robot, SegmentedEccentricRobot):
        return _Segments(robot, tuple(assignment)).bend(bending_direction, curvature, translations)
    azimuth = finite("bending_direction", bending_direction)
    curvature = positive("curvature", finite("curvature", curvature), zero=True)
    arm = _Arm(robot, translations, tuple(assignment), azimuth)
    target = curvature * np.array([math.cos(azimuth), math.sin(azimuth)])
    pose = arm.solve(
        target, lambda equilibrium: arc_curvature(equilibrium) - target, arm.max_curvature, by_tip=_arc_slope
    )
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
    robot: EccentricRobot | SegmentedEccentricRobot,
    position: ArrayLike,
    *,
    translations: ArrayLike | None = None,
    assignment: Sequence[int] = (0, 1, 2),
    tolerance: float = 1e-6,
) -> MirrorPose:
    """Mirror actuation that brings the tip to a point at given translations.

    Of one segment these points are a surface. Several segments fill a volume, and bend little to reach a point there.

    Args:
        position: target (3,) of the tip, m.
        translations, assignment: as in `forward_kinematics` and `mirror_rotations`.
        tolerance: largest distance of a point from the surface, m.

    Raises:
        InputError: numbers that are not finite, no precurvature, or a position off the surface; the message states the
            distance and the closest point of the surface.
        SolveError: forward kinematics failed on the path.
    """
    if isinstance(robot, SegmentedEccentricRobot):
        typical_length("tolerance", tolerance, TYPICAL_TIP_ERROR)
        held = shifts(robot, translations)
        return _Segments(robot, tuple(assignment)).reach(position, None, held, max(tolerance, ON_TARGET))
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
def mirror_pose(
    robot: EccentricRobot | SegmentedEccentricRobot,
    position: ArrayLike,
    *,
    direction: ArrayLike | None = None,
    assignment: Sequence[int] = (0, 1, 2),
) -> MirrorPose:
    """Mirror actuation and translations that bring the tip of the full model to `position`.

    Args:
        position, assignment: as in `mirror_closed_form`.
        direction: axis (3,) of the tip, of any length; for robots of several segments only.

    Raises:
        InputError: a position that no arc reaches (see `mirror_closed_form`), or where no pose of several segments was
            found. A direction for a robot of one segment.
        SolveError: the search ends off the target; the message has the distance, and `.solution` the closest pose.
    """
    if isinstance(robot, SegmentedEccentricRobot):
        return _Segments(robot, tuple(assignment)).reach(position, direction, None, ON_TARGET)
    if direction is not None:
        raise InputError("direction is given; the mirror actuation of one segment reaches a position in one direction")
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
        mirror_rotations(0.0, 0.0, assignment)  # refuses other assignments
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
        by_tip: Callable[[Equilibrium], Array] = lambda _: np.eye(3),
    ) -> MirrorPose:
        """Pose of the smallest `residual`, from a curvature vector `start` (2,), 1/m.

        The unknowns are direction and separation for a bent arm, and the curvature vector for a nearly straight one:
        each pair is smooth where the other is not.

        Args:
            scale: change of the residual by the curvature `max_curvature`.
            shift: start of the translation, m; None for a fixed one.
            by_tip: derivative (r, 3) of the residual by the tip position.
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
        apart = np.zeros(3)
        apart[list(self.assignment[1:])] = 1.0, -1.0

        pose = lru_cache(maxsize=2)(self.pose)  # residual and slope need the same equilibrium

        def slope(x: Array) -> Array:
            equilibrium = pose(*actuation(x))
            by_joints = position_slopes(equilibrium)
            by_angles = by_joints[:, :3] @ np.column_stack([np.ones(3), apart])
            parts = [by_angles if bent else by_angles @ _law_slope(float(x[0]), float(x[1]))]
            if len(x) > 2:
                parts.append(by_joints[:, 3:].sum(1, keepdims=True) * self.length)
            return by_tip(equilibrium) @ np.hstack(parts) / scale

        solution = scipy.optimize.least_squares(
            lambda x: residual(pose(*actuation(x))) / scale,
            guess,
            jac=slope,
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


# --- several segments -------------------------------------------------------------------------------------------------

ON_TARGET = 1e-9
"""Largest distance of the tip from its target, m, and of its direction, rad."""

MOST_STEPS = 60
"""Most steps of one search; measured ones take 4 to 15."""

DAMPING = 1e-6
"""Damping of a step: of the actuations that reach a target, it prefers a near one and hardly slows the search."""

NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)
"""Gauss-Legendre rule along a segment."""


def segment_curvatures(equilibrium: Equilibrium) -> Array:
    """Mean curvature (k, 2) of each segment, 1/m, as a vector along x and y of the plate; 0 of one behind the plate.

    It points to where the segment bends, in the frame of the plate carried along the arm without torsion (Bishop). So a
    segment bends as it would on a straight arm.

    Raises:
        InputError: a robot that has no segments.
    """
    if not isinstance(equilibrium.robot, SegmentedEccentricRobot):
        raise InputError("the robot is not of kind segmented_eccentric; arc_curvature has the bend of one segment")
    return _bends(equilibrium)[0]


def _bends(equilibrium: Equilibrium) -> tuple[Array, Array]:
    """`segment_curvatures` (k, 2), and their derivatives (k, 2, n) by the rotations."""
    assembly = equilibrium.robot.assembly(equilibrium.translations)
    of = linearise(equilibrium, ("rotations",))
    start, end = np.maximum(assembly.transition[::3], 0.0), np.maximum(assembly.end[::3], 0.0)
    bend, slope = np.zeros((len(start), 2)), np.zeros((len(start), 2, of.size))
    for k in np.flatnonzero(end > start):
        for node, weight in zip(NODES, WEIGHTS, strict=True):
            at = start[k] + (end[k] - start[k]) * (1 + node) / 2
            u, change = curvature_at(of, at / assembly.total_length)
            # t' = u x t: the tangent turns towards (u_y, -u_x).
            bend[k] += weight / 2 * np.array([u[1], -u[0]])
            slope[k] += weight / 2 * np.array([change[1], -change[0]])
    return bend, slope


Miss = Callable[[Array], tuple[Array, Callable[[], Array]]]
"""Residual (r,) at independent joint values (m,), and its derivatives (r, m)."""


class _Segments:
    """Robot of k segments under mirror actuation.

    The unknowns x are two for each segment, and then the translations of the carriages in lengths of the robot, if they
    are free. The two are direction and separation for a bent segment, and for a nearly straight one its bend as a
    fraction (2,) of the largest, as in `_Arm.solve`.
    """

    def __init__(self, robot: SegmentedEccentricRobot, assignment: tuple[int, ...]) -> None:
        mirror_rotations(0.0, 0.0, assignment)  # refuses other assignments
        self.robot, self.assignment, self.space = robot, assignment, joint_space(robot)
        stiffness = np.array([tube.bending_stiffness for tube in robot.segments])
        self.curvature = np.array([tube.curvature for tube in robot.segments])
        # The straight tubes of inner segments stiffen an outer one.
        self.largest = self.curvature * stiffness / np.cumsum(stiffness)
        if not self.largest.any():
            raise InputError("the tubes are straight and cannot bend the robot")
        count, apart = len(stiffness), np.zeros(3)
        apart[list(assignment[1:])] = 1.0, -1.0
        self.by_angles = np.hstack([np.kron(np.eye(count), np.ones((3, 1))), np.kron(np.eye(count), apart[:, None])])

    def angles(self, x: Array, bent: tuple[bool, ...]) -> tuple[Array, Array]:
        """Directions and separations (2 k,), rad, and their derivatives (2 k, 2 k) by the unknowns of the segments."""
        k = len(bent)
        angle, slope = np.zeros(2 * k), np.zeros((2 * k, 2 * k))
        for j, (one, two) in enumerate(x[: 2 * k].reshape(k, 2).tolist()):
            if bent[j]:
                angle[[j, k + j]] = one, two
                slope[j, 2 * j] = slope[k + j, 2 * j + 1] = 1.0
                continue
            # A tube of positive precurvature and rotation 0 bends towards -y.
            angle[j] = math.atan2(two, one) + math.copysign(math.pi / 2, self.curvature[j])
            angle[k + j] = mirror_separation(math.hypot(one, two))
            slope[[j, k + j], 2 * j : 2 * j + 2] = _law_slope(one, two)
        return angle, slope

    def unknowns(self, bend: Array, q: Array, free: bool) -> tuple[Array, tuple[bool, ...]]:
        """Unknowns for bends (k, 2) as fractions of the largest, and which segments are bent."""
        size = np.maximum(np.hypot(*bend.T), 1e-3)
        bent = tuple((size > 0.5).tolist())
        turn = np.arctan2(bend[:, 1], bend[:, 0]) + np.copysign(np.pi / 2, self.curvature)
        # A little off the ends of the separation, and off the straight segment, which has no direction.
        apart = [max(mirror_separation(each), 1e-3) for each in size.tolist()]
        small = bend + np.array([1e-3, 0.0])
        pairs = np.where(np.array(bent)[:, None], np.column_stack([turn, apart]), small)
        advance = q[self.robot.n_tubes :] / self.space.length if free else np.zeros(0)
        return np.array([*np.ravel(pairs), *advance]), bent

    def search(self, x: Array, bent: tuple[bool, ...], q: Array, miss: Miss) -> tuple[Array, Array]:
        """Joint values (m,) and residual from unknowns x, by the Gauss-Newton method in a trust region.

        Without free translations those of `q` are kept.
        """
        space, n, k = self.space, self.robot.n_tubes, len(bent)
        separations = [2 * j + 1 for j in range(k) if bent[j]]
        box = np.eye(len(x))[separations]

        def joints(x: Array) -> tuple[Array, Array]:
            angle, slope = self.angles(x, bent)
            out, by = q.copy(), np.zeros((len(q), len(x)))
            out[:n], by[:n, : 2 * k] = self.by_angles @ angle, self.by_angles @ slope
            if len(x) > 2 * k:
                # Clipped, since a step may leave a range by round-off.
                out[n:] = np.clip(x[2 * k :] * space.length, space.lower[n:], space.upper[n:])
                by[n:, 2 * k :] = space.length * np.eye(len(q) - n)
            return out, by

        at, by = joints(x)
        residual, slope = miss(at)
        size, unit = 0.5, np.eye(len(x))
        for _ in range(MOST_STEPS):
            matrix = slope() @ by
            moved = np.any(by[n:], axis=1).nonzero()[0] + n
            rows = np.vstack([space.rows @ by, by[moved], -by[moved], box, -box])
            bounds = [space.row_lower - space.rows @ at, (space.lower - at)[moved], (at - space.upper)[moved]]
            limits = np.concatenate([*bounds, -x[separations], x[separations] - STRAIGHT])
            chosen = None
            while size > 1e-9:
                chosen = constrained_least_squares(
                    np.vstack([matrix, DAMPING * unit]),
                    np.concatenate([-residual, np.zeros(len(x))]),
                    np.vstack([rows, unit, -unit]),
                    np.concatenate([np.minimum(limits, 0.0), np.full(2 * len(x), -size)]),
                )
                if chosen is None:
                    return at, residual
                predicted = float(residual @ residual - np.sum((residual + matrix @ chosen.x) ** 2))
                if predicted <= 1e-28 + 1e-9 * float(residual @ residual):
                    return at, residual
                try:
                    next_at, next_by = joints(x + chosen.x)
                    next_residual, next_slope = miss(next_at)
                except SolveError:
                    size *= 0.35
                    continue
                gain = float(residual @ residual - next_residual @ next_residual)
                if gain >= 0.05 * predicted:
                    size = min(2 * size, 1.0) if gain > 0.7 * predicted else size
                    break
                size = 0.35 * min(size, float(np.abs(chosen.x).max()))
            else:
                return at, residual
            x, at, by, residual, slope = x + chosen.x, next_at, next_by, next_residual, next_slope
        return at, residual

    def bend(self, bending_direction: ArrayLike, curvature: ArrayLike, translations: ArrayLike | None) -> MirrorPose:
        """Pose of `mirror_inverse`."""
        k = len(self.largest)
        azimuth = vector("bending_direction", bending_direction, k, "one per segment")
        wanted = vector("curvature", curvature, k, "one per segment")
        if (wanted < 0).any():
            raise InputError(f"curvature is {wanted.tolist()}; every number must be at least 0")
        start = np.array(shifts(self.robot, translations))
        behind = np.flatnonzero((self.robot.assembly(start).end[::3] <= 0) | (self.largest == 0))
        if len(behind):
            raise InputError(f"segment {behind[0] + 1} is straight or behind the base plate and cannot bend")
        target = wanted[:, None] * np.column_stack([np.cos(azimuth), np.sin(azimuth)])
        q, scale = self.space.join(np.zeros(3 * k), start, "translations"), np.abs(self.largest)[:, None]

        def miss(q: Array) -> tuple[Array, Callable[[], Array]]:
            bend, slope = _bends(forward_kinematics(self.robot, *self.space.split(q)))
            by = np.zeros((2 * k, len(q)))
            by[:, : 3 * k] = (slope / scale[..., None]).reshape(2 * k, -1)
            return ((bend - target) / scale).ravel(), lambda: by

        fraction = target / scale
        fraction /= np.maximum(np.linalg.norm(fraction, axis=1, keepdims=True), 1.0)
        q, residual = self.search(*self.unknowns(fraction, q, False), q, miss)
        error = residual.reshape(k, 2) * scale
        pose = self.pose(q, float(np.linalg.norm(error)))
        if pose.error > 1e-7 * float(scale.max()):
            worst = int(np.argmax(np.linalg.norm(error, axis=1)))
            reached = float(np.linalg.norm(segment_curvatures(pose.equilibrium)[worst]))
            raise InputError(
                f"curvature of segment {worst + 1} is {wanted[worst]:.6g} per m; towards "
                f"{math.degrees(azimuth[worst]):.4g} deg the search ends at {reached:.6g} per m"
            )
        return pose

    def pose(self, q: Array, error: float) -> MirrorPose:
        """Pose at independent joint values that are mirror-symmetric."""
        rotations, shifted = self.space.split(q)
        # A full turn of the three tubes of a segment changes nothing.
        turns = np.round(rotations.reshape(-1, 3)[:, self.assignment[0]] / (2 * np.pi))
        equilibrium = forward_kinematics(self.robot, rotations - 2 * np.pi * np.repeat(turns, 3), shifted)
        middle, ahead, _ = equilibrium.rotations.reshape(-1, 3)[:, list(self.assignment)].T
        shift = equilibrium.translations
        return MirrorPose(middle, ahead - middle, equilibrium.rotations, shift, equilibrium, error)

    def arcs(self, q: Array) -> Array:
        """Tip poses (N, 4, 4) of chains of constant-curvature arcs, at joint values (N, m): no offset, no torsion."""
        joint, n = self.space.joint(q), self.robot.n_tubes
        theta, begin = joint[:, :n].reshape(len(q), -1, 3), joint[:, n::3]
        end = np.maximum(begin + [tube.curved_length for tube in self.robot.segments], 0.0)
        pose, reached = np.broadcast_to(np.eye(4), (len(q), 4, 4)), np.zeros(len(q))
        for k in reversed(range(len(self.largest))):
            start, twist = np.maximum(begin[:, k], 0.0), np.zeros((len(q), 4, 4))
            ux, uy = self.largest[k] * np.cos(theta[:, k]).mean(1), self.largest[k] * np.sin(theta[:, k]).mean(1)
            twist[:, 0, 2], twist[:, 1, 2], twist[:, 2, 0], twist[:, 2, 1], twist[:, 2, 3] = uy, -ux, -uy, ux, 1.0
            ahead = np.tile(np.eye(4), (len(q), 1, 1))
            ahead[:, 2, 3] = np.maximum(start - reached, 0.0)
            pose = pose @ ahead @ scipy.linalg.expm(twist * (end[:, k] - start)[:, None, None])
            reached = np.maximum(end[:, k], reached)
        return pose

    def reach(
        self, position: ArrayLike, direction: ArrayLike | None, held: ArrayLike | None, tolerance: float
    ) -> MirrorPose:
        """Pose of `mirror_pose`, and with `held` translations of `mirror_to_tip`."""
        target = vector("position", position, 3, "x, y, z in m")
        axis = None if direction is None else unit_vector("direction", direction)
        space, length = self.space, self.space.length

        def residual_of(tip: Array, tangent: Array) -> Array:
            parts = [(tip - target) / length] + ([] if axis is None else [tangent - axis])
            return np.concatenate(parts)

        def miss(q: Array) -> tuple[Array, Callable[[], Array]]:
            posture = Posture(space, q, forward_kinematics(self.robot, *space.split(q)))

            def slope() -> Array:
                by = posture.jacobian
                turned = np.cross(by.rotation.T, posture.direction).T
                return np.vstack([by.tip / length, *([] if axis is None else [turned])])

            return residual_of(posture.tip, posture.direction), slope

        def miss_of_arcs(q: Array) -> tuple[Array, Callable[[], Array]]:
            pose = self.arcs(q[None])[0]

            def slope() -> Array:
                step = np.diag(1e-6 * space.scale)
                there, back = self.arcs(q + step), self.arcs(q - step)
                change = (there - back) / (2e-6 * space.scale)[:, None, None]
                return np.vstack([change[:, :3, 3].T / length, *([] if axis is None else [change[:, :3, 2].T])])

            return residual_of(pose[:3, 3], pose[:3, 2]), slope

        azimuth = math.atan2(target[1], target[0])
        towards, count = np.array([math.cos(azimuth), math.sin(azimuth)]), len(self.largest)
        sizes = [np.full(count, 0.1), *map(np.array, product((0.4, -0.4), repeat=count)), np.full(count, 0.9)]
        found = []
        for q, size in product(self._carriages(held), sizes):
            start, bent = self.unknowns(size[:, None] * towards, q, held is None)
            end, residual = self.search(start, bent, q, miss_of_arcs)
            found.append((end, float(np.linalg.norm(residual))))
        # Of chains that reach the target, the one with the least bend is tried first.
        found.sort(key=lambda each: (max(each[1], 1e-9), self._bending(each[0])))
        poses = []
        for q, _ in found[:TRIED]:
            start, bent = self.unknowns(self._fractions(q), q, held is None)
            end, residual = self.search(start, bent, q, miss)
            pose = self.pose(end, float(np.linalg.norm(residual[:3])) * length)
            if pose.error <= tolerance and float(np.linalg.norm(residual[3:])) <= ON_TARGET:
                return pose
            poses.append((float(np.linalg.norm(residual)), pose))
        best = min(poses, key=lambda each: each[0])[1]
        nearest = ", ".join(f"{1e3 * x:.4f}" for x in best.equilibrium.tip_position)
        raise InputError(
            f"position {'' if axis is None else 'in this direction '}was not reached: the closest tip that was found "
            f"is {1e3 * best.error:.4g} mm away, at ({nearest}) mm"
        )

    def _carriages(self, held: ArrayLike | None) -> list[Array]:
        """Joint values that start a search: the held translations, or four from drawn back to advanced."""
        space, n = self.space, self.robot.n_tubes
        if held is not None:
            return [space.join(np.zeros(n), np.array(held), "translations")]
        out, none = [], np.zeros(n)
        rows, unit = space.rows[:, n:], np.eye(len(space.lower) - n)
        lower, upper = space.lower[n:], space.upper[n:]
        for share in (0.9, 0.6, 0.3, 0.05):
            nearest = constrained_least_squares(
                unit,
                lower + share * (upper - lower),
                np.vstack([rows, unit, -unit]),
                np.concatenate([space.row_lower, lower, -upper]),
            )
            if nearest is not None:
                out.append(np.concatenate([none, nearest.x]))
        return out

    def _fractions(self, q: Array) -> Array:
        """Bend (k, 2) of each segment as a fraction of the largest, by the law of three vectors."""
        theta = q[: self.robot.n_tubes].reshape(-1, 3)
        turn = np.sign(self.curvature)[:, None] * np.column_stack([np.sin(theta).mean(1), -np.cos(theta).mean(1)])
        return np.asarray(turn)

    def _bending(self, q: Array) -> float:
        """Sum of the squared bends of `_fractions`."""
        return float(np.sum(self._fractions(q) ** 2))


TRIED = 4
"""Chains of arcs that start the search of the full model."""


def _nearest_turn(angle: float, reference: float) -> float:
    """Angle nearest to a reference that differs from `angle` by full turns, rad."""
    return angle - 2 * math.pi * round((angle - reference) / (2 * math.pi))
