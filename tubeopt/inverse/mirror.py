"""Symmetric ("mirror") actuation of eccentric robots: a direction and a separation for the three tubes of a segment.

One tube points in the direction, and the other two are rotated from it by the separation to either side (thesis, eq.
3.51). The sum of three equal vectors then has that direction and the length 1 + 2 cos(separation): the arm bends in a
plane, from the precurvature at separation 0 to straight at 120 deg. Torsion and offsets of the tubes change this law a
little. So a search for a bend or a tip starts from the law, or from its closed form for an arm of constant curvature.
The Gauss-Newton method of `gauss_newton` then solves the full equations in these coordinates, with exact derivatives.

A robot of several segments has this actuation in each, and a chain of arcs as start.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..arguments import typed
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.linearised import curvature_at, linearise
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, finite, positive, vector
from ..files.field_metadata import TYPICAL_TIP_ERROR, typical_length
from ..robots.eccentric import EccentricRobot, SegmentedEccentricRobot
from ..robots.robot import shifts
from ..typing import Array
from .clock import Clock
from .gauss_newton import AcceptedStep, Restored, StepModel, descend
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
        return _bend_segments(robot, bending_direction, curvature, translations, assignment)
    azimuth = finite("bending_direction", bending_direction)
    curvature = positive("curvature", finite("curvature", curvature), zero=True)
    arm = _Arm(robot, translations, assignment, azimuth)
    target = curvature * arm.towards[0]

    def miss(q: Array) -> Miss:
        at = arm.posture(q)
        residual = (arc_curvature(at.equilibrium) - target) / arm.max_curvature
        return Miss(residual, lambda: _arc_slope(at.equilibrium) @ at.slope("tip_position") / arm.max_curvature)

    end = arm.search(target / arm.max_curvature, arm.held, False, miss)
    pose = arm.pose(end, end.miss.size * arm.max_curvature)
    if pose.error > 1e-7 * arm.max_curvature:
        most = arm.posture(arm.joints(arm.towards.ravel(), (False,), arm.held)[0])
        max_curvature = float(np.linalg.norm(arc_curvature(most.equilibrium)))
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
        return _reach_with_segments(robot, position, None, held, max(tolerance, ON_TARGET), assignment)
    arm, target = _aimed(robot, position, translations, assignment)
    typical_length("tolerance", tolerance, TYPICAL_TIP_ERROR)
    above = target - [0.0, 0.0, arm.plate]
    square = max(float(above @ above), 1e-6 * arm.length**2)

    def pose_from(bend: Array) -> MirrorPose:
        end = arm.search(bend, arm.held, False, arm.tip_miss(target, None))
        return arm.pose(end, end.miss.size * arm.space.length)

    pose = pose_from(2 * above[:2] / square / arm.max_curvature)
    if pose.error > tolerance:
        # Off the surface the distance can have several local minima.
        others = [pose_from(arm.towards[0]), pose_from(arm.towards[0] / 3)]
        pose = min([pose, *others], key=lambda candidate: candidate.error)
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
    fraction, shift = arm.arc(target)
    direction, separation = arm.angles(fraction * arm.towards.ravel(), (False,))[0].tolist()
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
        return _reach_with_segments(robot, position, direction, None, ON_TARGET, assignment)
    if direction is not None:
        raise InputError("direction is given; the mirror actuation of one segment reaches a position in one direction")
    arm, target = _aimed(robot, position, None, assignment)
    fraction, shift = arm.arc(target)
    start = arm.space.join(np.zeros(3), np.full(3, shift))
    end = arm.search(fraction * arm.towards, start, True, arm.tip_miss(target, None))
    pose = arm.pose(end, end.miss.size * arm.space.length)
    if pose.error > 1e-7:
        raise SolveError(f"no mirror actuation was found: the best misses the position by {pose.error:.3g} m", pose)
    return pose


def _aimed(
    robot: EccentricRobot, position: ArrayLike, translations: ArrayLike | None, assignment: Sequence[int]
) -> tuple[_Arm, Array]:
    """Robot with an arm that bends towards a position, and the checked position."""
    target = vector("position", position, 3, "x, y, z in m")
    return _Arm(robot, translations, assignment, math.atan2(target[1], target[0])), target


# --- coordinates ------------------------------------------------------------------------------------------------------

ON_TARGET = 1e-9
"""Largest distance of the tip from its target, m, and of its direction, rad."""

ON_TARGET_RESIDUAL = 1e-12
"""Residual that ends a search: far below `ON_TARGET`, and above round-off."""

STRAIGHT_BEND = 1e-9
"""Bend of a straight segment, as a fraction of the largest."""

MOST_STEPS = 60
"""Most steps of one search; measured ones take 4 to 15."""

DAMPING = 1e-6
"""Damping of a step: of the actuations that reach a target, it prefers a near one and hardly slows the search."""


@dataclass(frozen=True, eq=False)
class Miss:
    """Distance of independent joint values (m,) from a target."""

    residual: Array
    """Residual (r,)."""
    slope: Callable[[], Array]
    """Function that returns its derivatives (r, m)."""

    @property
    def size(self) -> float:
        """Norm of the residual."""
        return float(np.linalg.norm(self.residual))


@dataclass(frozen=True, eq=False)
class _Actuation:
    """Mirror actuation: an iterate of a search."""

    x: Array
    """Unknowns of `_Mirror`."""
    q: Array
    """Independent joint values (m,)."""
    by_unknowns: Array
    """Derivatives of q by x."""
    miss: Miss


class _Mirror:
    """Coordinates of a robot of k segments under mirror actuation.

    The unknowns x are two for each segment, and then the translations of the carriages in lengths of the robot, if they
    are free. The two are direction and separation for a bent segment, and for a nearly straight one its bend as a
    fraction (2,) of the largest: each pair is smooth where the other is not.
    """

    def __init__(
        self, robot: EccentricRobot | SegmentedEccentricRobot, assignment: Sequence[int], azimuth: ArrayLike
    ) -> None:
        mirror_rotations(0.0, 0.0, assignment)  # refuses other assignments
        tubes = robot.segments if isinstance(robot, SegmentedEccentricRobot) else (robot.tube,)
        stiffness = np.array([tube.bending_stiffness for tube in tubes])
        self.assignment, self.space = tuple(assignment), joint_space(robot)
        self.curvature = np.array([tube.curvature for tube in tubes])
        # The straight tubes of inner segments stiffen an outer one.
        self.largest = self.curvature * stiffness / np.cumsum(stiffness)
        if not (self.largest * [tube.curved_length for tube in tubes]).any():
            raise InputError("the tubes are straight and cannot bend the robot")
        count, apart = len(tubes), np.zeros(3)
        apart[list(assignment[1:])] = 1.0, -1.0
        self.by_angles = np.hstack([np.kron(np.eye(count), np.ones((3, 1))), np.kron(np.eye(count), apart[:, None])])
        self.towards = np.column_stack([np.cos(azimuth), np.sin(azimuth)]) * np.ones((count, 1))
        """Unit vectors (k, 2) in which straight segments would bend."""

    def angles(self, x: Array, bent: tuple[bool, ...]) -> tuple[Array, Array]:
        """Directions and separations (2 k,), rad, and their derivatives (2 k, 2 k) by the unknowns of the segments."""
        k = len(bent)
        angle, slope = np.zeros(2 * k), np.zeros((2 * k, 2 * k))
        for j, (one, two) in enumerate(x[: 2 * k].reshape(k, 2).tolist()):
            if bent[j]:
                angle[[j, k + j]] = one, two
                slope[j, 2 * j] = slope[k + j, 2 * j + 1] = 1.0
                continue
            size = math.hypot(one, two)
            if size < STRAIGHT_BEND:
                one, two = (STRAIGHT_BEND * self.towards[j]).tolist()
            # A tube of positive precurvature and rotation 0 bends towards -y.
            angle[j] = math.atan2(two, one) + math.copysign(math.pi / 2, self.curvature[j])
            angle[k + j] = mirror_separation(size)
            size = max(size, STRAIGHT_BEND)
            # Beyond the largest bend, the separation stays 0.
            rate = -1.5 / math.sin(mirror_separation(size)) / size if size < 1 else 0.0
            slope[j, 2 * j : 2 * j + 2] = -two / size**2, one / size**2
            slope[k + j, 2 * j : 2 * j + 2] = rate * one, rate * two
        return angle, slope

    def joints(self, x: Array, bent: tuple[bool, ...], held: Array) -> tuple[Array, Array]:
        """Independent joint values (m,), and their derivatives by x; without free translations those of `held`."""
        space, n, k = self.space, self.space.robot.n_tubes, len(bent)
        angle, slope = self.angles(x, bent)
        q, by_x = held.copy(), np.zeros((len(held), len(x)))
        q[:n], by_x[:n, : 2 * k] = self.by_angles @ angle, self.by_angles @ slope
        if len(x) > 2 * k:
            # Clipped, since a step may leave a range by round-off.
            q[n:] = np.clip(x[2 * k :] * space.length, space.lower[n:], space.upper[n:])
            by_x[n:, 2 * k :] = space.length * np.eye(len(q) - n)
        return q, by_x

    def search(self, bend: Array, start: Array, free: bool, miss: Callable[[Array], Miss]) -> _Actuation:
        """Actuation of a smallest residual, from bends (k, 2) as fractions of the largest and joint values (m,).

        Args:
            free: True if the translations are unknowns.
        """
        bend = np.reshape(bend, (-1, 2))
        size = np.hypot(*bend.T)
        bend = bend / np.maximum(size, 1.0)[:, None]
        bent = tuple((size > 0.5).tolist())
        turn = np.arctan2(bend[:, 1], bend[:, 0]) + np.copysign(np.pi / 2, self.curvature)
        # A little off the ends of the separation, and off the straight segment, which has no direction.
        apart = [max(mirror_separation(each), 1e-3) for each in size.tolist()]
        pairs = np.where(np.array(bent)[:, None], np.column_stack([turn, apart]), bend + 1e-3 * self.towards)
        advance = start[self.space.robot.n_tubes :] / self.space.length if free else np.zeros(0)
        problem = _MirrorProblem(self, bent, start, free, miss)
        first = problem.at(np.array([*np.ravel(pairs), *advance]))
        return descend(problem, first, size=0.5, max_steps=MOST_STEPS).iterate

    def posture(self, q: Array) -> Posture:
        """Posture at independent joint values (m,)."""
        return Posture(self.space, q, forward_kinematics(self.space.robot, *self.space.split(q)))

    def pose(self, end: _Actuation, error: float) -> MirrorPose:
        """Pose of an actuation that misses its target by `error`."""
        rotations, shifted = self.space.split(end.q)
        # A full turn of the three tubes of a segment changes nothing.
        turns = np.round(rotations.reshape(-1, 3)[:, self.assignment[0]] / (2 * np.pi))
        equilibrium = forward_kinematics(self.space.robot, rotations - 2 * np.pi * np.repeat(turns, 3), shifted)
        middle, ahead, _ = equilibrium.rotations.reshape(-1, 3)[:, list(self.assignment)].T
        segmented = len(middle) > 1
        return MirrorPose(
            direction=middle if segmented else float(middle[0]),
            separation=ahead - middle if segmented else float(ahead[0] - middle[0]),
            rotations=equilibrium.rotations,
            translations=equilibrium.translations,
            equilibrium=equilibrium,
            error=error,
        )

    def tip_miss(self, target: Array, axis: Array | None) -> Callable[[Array], Miss]:
        """Distance of the tip from a target (3,) in lengths of the robot, and its direction from `axis` (3,)."""

        def miss(q: Array) -> Miss:
            at = self.posture(q)

            def slope() -> Array:
                position = at.slope("tip_position") / self.space.length
                if axis is None:
                    return np.asarray(position)
                return np.vstack([position, np.cross(at.slope("tip_rotation"), at.direction[:, None], axis=0)])

            return Miss(self.tip_residual(at.tip, at.direction, target, axis), slope)

        return miss

    def tip_residual(self, tip: Array, direction: Array, target: Array, axis: Array | None) -> Array:
        """Residual (3,) or (6,) of `tip_miss`."""
        parts = [(tip - target) / self.space.length, *([] if axis is None else [direction - axis])]
        return np.concatenate(parts)


@dataclass(frozen=True, eq=False)
class _MirrorProblem:
    """Half the square of a miss in the coordinates of `_Mirror`, within ranges and order of the translations."""

    mirror: _Mirror
    bent: tuple[bool, ...]
    held: Array
    """Independent joint values (m,). Their translations are kept, unless translations are unknowns."""
    free: bool
    """True if the translations are unknowns."""
    miss: Callable[[Array], Miss]
    clock: Clock = field(default_factory=lambda: Clock(np.inf))
    touched: tuple[int, ...] = ()

    @cached_property
    def scale(self) -> Array:
        return np.ones(2 * len(self.bent) + self.free * len(self.mirror.space.carriages))

    def at(self, x: Array) -> _Actuation:
        """Actuation of unknowns x."""
        q, by_unknowns = self.mirror.joints(x, self.bent, self.held)
        return _Actuation(x, q, by_unknowns, self.miss(q))

    def value(self, at: _Actuation) -> float:
        return 0.5 * float(at.miss.residual @ at.miss.residual)

    def min_decrease(self, value: float) -> float:
        return 1e-9 * value

    def converged(self, at: _Actuation, values: Sequence[float]) -> bool:
        return values[-1] <= 0.5 * ON_TARGET_RESIDUAL**2

    def model(self, at: _Actuation, side: int, last: AcceptedStep[_Actuation] | None) -> StepModel:
        space, unit = self.mirror.space, np.eye(len(at.x))
        moved = np.any(at.by_unknowns[space.robot.n_tubes :], axis=1).nonzero()[0] + space.robot.n_tubes
        separations = [2 * j + 1 for j, bent in enumerate(self.bent) if bent]
        box, by_x = unit[separations], at.by_unknowns
        rows = np.vstack([space.rows @ by_x, by_x[moved], -by_x[moved], box, -box])
        ranges = [space.row_lower - space.rows @ at.q, (space.lower - at.q)[moved], (at.q - space.upper)[moved]]
        bounds = np.concatenate([*ranges, -at.x[separations], at.x[separations] - STRAIGHT])
        guide = DAMPING * unit, np.zeros(len(at.x))
        return StepModel(at.miss.slope() @ by_x, -at.miss.residual, *guide, rows, np.minimum(bounds, 0.0))

    def after(self, current: _Actuation, x: Array) -> Restored[_Actuation]:
        try:
            return Restored(self.at(current.x + x), 1)
        except SolveError:
            return Restored(None, 1)

    def two_sided(self, at: _Actuation) -> bool:
        return False

    def across(self, at: _Actuation) -> Iterator[_Actuation]:
        return iter(())


# --- one segment ------------------------------------------------------------------------------------------------------


class _Arm(_Mirror):
    """Robot of one segment, with the closed form of its arc."""

    def __init__(
        self, robot: EccentricRobot, translations: ArrayLike | None, assignment: Sequence[int], azimuth: float
    ) -> None:
        super().__init__(robot, assignment, azimuth)
        self.tube, self.max_curvature = robot.tube, abs(robot.tube.curvature)
        shift = shifts(robot, translations)
        self.held = self.space.join(np.zeros(3), shift, "translations")
        assembly = robot.assembly(shift)
        self.plate = max(float(assembly.transition.min()), 0.0)
        self.length = assembly.total_length - self.plate
        if self.length <= 0:
            raise InputError("the tubes are retracted behind the base plate and cannot bend the robot")

    def arc(self, target: Array) -> tuple[float, float]:
        """Fraction of the precurvature, and translation, m, of an arc of constant curvature to a target (3,), m.

        A part of the arm below the arc may be straight.
        """
        radius, height = math.hypot(target[0], target[1]), float(target[2])
        curvature, translation = self._arc(radius, height)
        low, high = float(self.space.lower[-1]), float(self.space.upper[-1])
        if curvature > self.max_curvature * (1 + 1e-12):
            raise InputError(
                f"position needs a curvature of {curvature:.6g} per m; it must be at most "
                f"{self.max_curvature:.6g} per m"
            )
        if not low - 1e-12 <= translation <= high + 1e-12:
            raise InputError(
                f"position needs a translation of {translation:.6g} m; it must be from {low:.6g} to {high:.6g} m"
            )
        return curvature / self.max_curvature, min(max(translation, low), high)

    def _arc(self, radius: float, height: float) -> tuple[float, float]:
        """Curvature (1/m) and translation (m) of an arc to a point at a distance from the axis and a height, m."""
        full_length, square = self.tube.curved_length, radius**2 + height**2
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


# --- several segments -------------------------------------------------------------------------------------------------

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


class _Segments(_Mirror):
    """Robot of several segments, with chains of arcs as starts."""

    def __init__(self, robot: SegmentedEccentricRobot, assignment: Sequence[int], azimuth: ArrayLike) -> None:
        super().__init__(robot, assignment, azimuth)
        self.segments = robot.segments

    def arcs(self, q: Array) -> Array:
        """Tip poses (N, 4, 4) of chains of constant-curvature arcs, at joint values (N, m): no offset, no torsion."""
        joint, n = self.space.joint(q), self.space.robot.n_tubes
        theta, begin = joint[:, :n].reshape(len(q), -1, 3), joint[:, n::3]
        end = np.maximum(begin + [tube.curved_length for tube in self.segments], 0.0)
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

    def miss_of_arcs(self, target: Array, axis: Array | None) -> Callable[[Array], Miss]:
        """`tip_miss` of the chain of arcs."""
        scale, length = self.space.scale, self.space.length

        def miss(q: Array) -> Miss:
            pose = self.arcs(q[None])[0]

            def slope() -> Array:
                step = np.diag(1e-6 * scale)
                change = (self.arcs(q + step) - self.arcs(q - step)) / (2e-6 * scale)[:, None, None]
                return np.vstack([change[:, :3, 3].T / length, *([] if axis is None else [change[:, :3, 2].T])])

            return Miss(self.tip_residual(pose[:3, 3], pose[:3, 2], target, axis), slope)

        return miss

    def carriages(self, held: ArrayLike | None) -> list[Array]:
        """Joint values that start a search: the held translations, or four from drawn back to advanced."""
        space, n = self.space, self.space.robot.n_tubes
        if held is not None:
            return [space.join(np.zeros(n), np.array(held), "translations")]
        lower, upper = space.lower[n:], space.upper[n:]
        middle = space.middle()[:n]
        return [
            space.nearest(np.concatenate([middle, lower + share * (upper - lower)])) for share in (0.9, 0.6, 0.3, 0.05)
        ]

    def fractions(self, q: Array) -> Array:
        """Bend (k, 2) of each segment as a fraction of the largest, by the law of three vectors."""
        theta = q[: self.space.robot.n_tubes].reshape(-1, 3)
        turn = np.sign(self.curvature)[:, None] * np.column_stack([np.sin(theta).mean(1), -np.cos(theta).mean(1)])
        return np.asarray(turn)

    def bending(self, q: Array) -> float:
        """Sum of the squared bends of `fractions`."""
        return float(np.sum(self.fractions(q) ** 2))


TRIED = 4
"""Chains of arcs that start the search of the full model."""


def _bend_segments(
    robot: SegmentedEccentricRobot,
    bending_direction: ArrayLike,
    curvature: ArrayLike,
    translations: ArrayLike | None,
    assignment: Sequence[int],
) -> MirrorPose:
    """Pose of `mirror_inverse`."""
    k = len(robot.segments)
    azimuth = vector("bending_direction", bending_direction, k, "one per segment")
    wanted = vector("curvature", curvature, k, "one per segment")
    if (wanted < 0).any():
        raise InputError(f"curvature is {wanted.tolist()}; every number must be at least 0")
    mirror, shift = _Segments(robot, assignment, azimuth), shifts(robot, translations)
    behind = np.flatnonzero((robot.assembly(shift).end[::3] <= 0) | (mirror.largest == 0))
    if len(behind):
        raise InputError(f"segment {behind[0] + 1} is straight or behind the base plate and cannot bend")
    target, scale = wanted[:, None] * mirror.towards, np.abs(mirror.largest)[:, None]

    def miss(q: Array) -> Miss:
        bend, slope = _bends(mirror.posture(q).equilibrium)
        by_joints = np.zeros((2 * k, len(q)))
        by_joints[:, : 3 * k] = (slope / scale[..., None]).reshape(2 * k, -1)
        return Miss(((bend - target) / scale).ravel(), lambda: by_joints)

    start = mirror.space.join(np.zeros(3 * k), shift, "translations")
    end = mirror.search(target / scale, start, False, miss)
    error = np.linalg.norm(end.miss.residual.reshape(k, 2) * scale, axis=1)
    pose = mirror.pose(end, float(np.linalg.norm(error)))
    if pose.error > 1e-7 * float(scale.max()):
        worst = int(np.argmax(error))
        reached = float(np.linalg.norm(segment_curvatures(pose.equilibrium)[worst]))
        raise InputError(
            f"curvature of segment {worst + 1} is {wanted[worst]:.6g} per m; towards "
            f"{math.degrees(azimuth[worst]):.4g} deg the search ends at {reached:.6g} per m"
        )
    return pose


def _reach_with_segments(
    robot: SegmentedEccentricRobot,
    position: ArrayLike,
    direction: ArrayLike | None,
    held: ArrayLike | None,
    tolerance: float,
    assignment: Sequence[int],
) -> MirrorPose:
    """Pose of `mirror_pose`, and with `held` translations of `mirror_to_tip`."""
    target = vector("position", position, 3, "x, y, z in m")
    axis = None if direction is None else unit_vector("direction", direction)
    mirror, count, free = (
        _Segments(robot, assignment, math.atan2(target[1], target[0])),
        len(robot.segments),
        held is None,
    )
    sizes = [np.full(count, 0.1), *map(np.array, product((0.4, -0.4), repeat=count)), np.full(count, 0.9)]
    of_arcs, of_arm = mirror.miss_of_arcs(target, axis), mirror.tip_miss(target, axis)
    chains = [
        mirror.search(size[:, None] * mirror.towards, q, free, of_arcs)
        for q, size in product(mirror.carriages(held), sizes)
    ]
    # Of chains that reach the target, the one with the least bend is tried first.
    chains.sort(key=lambda each: (max(each.miss.size, 1e-9), mirror.bending(each.q)))
    poses = []
    for chain in chains[:TRIED]:
        end = mirror.search(mirror.fractions(chain.q), chain.q, free, of_arm)
        residual = end.miss.residual
        pose = mirror.pose(end, float(np.linalg.norm(residual[:3])) * mirror.space.length)
        if pose.error <= tolerance and float(np.linalg.norm(residual[3:])) <= ON_TARGET:
            return pose
        poses.append((end.miss.size, pose))
    best = min(poses, key=lambda each: each[0])[1]
    nearest = ", ".join(f"{1e3 * x:.4f}" for x in best.equilibrium.tip_position)
    raise InputError(
        f"position {'' if axis is None else 'in this direction '}was not reached: the closest tip that was found "
        f"is {1e3 * best.error:.4g} mm away, at ({nearest}) mm"
    )
