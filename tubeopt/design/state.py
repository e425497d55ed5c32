"""A design at one vector of unknowns: its tubes, its solved poses, and their quantities with the change of each.

Equilibria are solved inside: changes with tubes and joint values reach the unknowns by the chain rule.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np
import scipy

from ..block.quantities import PoseNumber, Quantity
from ..block.transcription.buffered import mapped
from ..equilibrium.arm_change import SHAPE_POINTS
from ..equilibrium.bundle import bundle_at
from ..equilibrium.directions import ARRANGEMENT, Change, Directions
from ..equilibrium.jacobian import margin_slopes
from ..equilibrium.kinematics import sure_margin
from ..equilibrium.linearised import Linearised, curvature_at, position_changes, positions_at
from ..equilibrium.linearised_bundle import LinearisedBundle
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError
from ..physics.strain import bend_from_own, surface_strain
from ..robots.assembly import DIMENSIONS
from ..robots.concentric import ConcentricRobot
from ..robots.eccentric import BundleRobot, channel_between
from ..robots.load import Load
from ..robots.robot import Robot
from ..robots.tubes import Tube
from ..stability.bundle_certificate import proof_parts, proof_slopes
from ..stability.stroke import Varied, stroke_slopes
from ..typing import Array
from .parameters import DesignSpace, change_of, piece_values
from .pose import (
    FRACTIONS,
    AnyPose,
    BundlePose,
    Guess,
    Pose,
    arm_clearance,
    arm_radius,
    draft,
    moving,
    posed,
    without_solving,
)
from .requirements import retracted


@dataclass(frozen=True)
class FreePose:
    """Task pose with unknown joint values: rotations, then beta of every tube."""

    index: int


@dataclass(frozen=True)
class FixedPose:
    """A task pose with given joint values."""

    rotations: tuple[float, ...]
    translations: tuple[float, ...]


@dataclass(frozen=True)
class Via:
    """Pose at the fraction `fraction` of the straight joint path between two task poses."""

    first: int
    second: int
    fraction: float


PoseKind = FreePose | FixedPose | Via


@dataclass(frozen=True, eq=False)
class Layout:
    """Layout of the unknowns x (X,): D dimensions, joint values of each of F free poses, auxiliary unknowns.

    Joint values are n rotations, and the beta of the first tube of each of C carriages.
    """

    space: DesignSpace
    poses: tuple[PoseKind, ...]
    """Task poses in order, then via points."""
    certified: tuple[tuple[float, ...], ...]
    """Translations (T, n) of the certificate, m."""
    auxiliary: tuple[str, ...]

    @property
    def n(self) -> int:
        """Number of tubes n."""
        return len(self.space.robot_tubes)

    @property
    def designs(self) -> int:
        """Number of unknown dimensions D."""
        return len(self.space.unknowns)

    @property
    def free_poses(self) -> int:
        """Number of poses with unknown joint values."""
        return sum(isinstance(pose, FreePose) for pose in self.poses)

    @property
    def carriages(self) -> tuple[tuple[int, ...], ...]:
        """Tubes of each carriage."""
        return self.space.robot.moving_together

    @property
    def joint_count(self) -> int:
        """Number n + C of unknown joint values of a free pose."""
        return self.n + len(self.carriages)

    @property
    def size(self) -> int:
        """Number of unknowns X."""
        return self.designs + self.joint_count * self.free_poses + len(self.auxiliary)

    def joints(self, pose: FreePose) -> tuple[slice, slice]:
        """Columns of the rotations and of beta of a free pose."""
        first = self.designs + self.joint_count * pose.index
        return slice(first, first + self.n), slice(first + self.n, first + self.joint_count)

    def column(self, name: str) -> int:
        """Column of an auxiliary unknown."""
        return self.designs + self.joint_count * self.free_poses + self.auxiliary.index(name)


# First parameters by which every pose is differentiated.
JOINTS = ("rotations", "translations")

# Upper bound of a stroke force, N: a pose that withstands more counts as one that withstands this.
STRONGEST = 10.0

# Step of central differences by unknowns of pieces, relative to their size: truncation 1e-10, round-off of an
# equilibrium 1e-12 over it 1e-7.
STEP = 1e-5


class DesignState:
    """Tubes, poses and quantities at x; equilibria are solved on first use, near `guesses`, which they update.

    Raises:
        InputError: (on use) the dimensions make no tubes.
        SolveError: (on use) a pose has no equilibrium.
    """

    def __init__(self, layout: Layout, x: Array, guesses: dict[PoseNumber, Guess] | None = None) -> None:
        self.layout = layout
        self.x = x
        self.guesses: dict[PoseNumber, Guess] = {} if guesses is None else guesses
        self._known: dict[Quantity, tuple[Array, Array]] = {}
        self._poses: dict[PoseNumber, AnyPose] = {}
        self._moved: dict[PoseNumber, tuple[Array, Array]] = {}
        self._chains: dict[PoseNumber, Array] = {}
        self._proofs: dict[tuple[float, ...], tuple[Array, Array]] = {}

    def with_auxiliary(self, x: Array) -> DesignState:
        """Same tubes and poses at an x that differs in auxiliary unknowns only, which no quantity depends on."""
        other = copy(self)
        other.x = x
        return other

    def quantity(self, quantity: Quantity) -> tuple[Array, Array]:
        """Value and derivative (.., X) of a quantity; poses are numbered as in the layout."""
        if quantity not in self._known:
            self._known[quantity] = _value_and_change(self, quantity)
        return self._known[quantity]

    @cached_property
    def robot(self) -> Robot:
        """Robot with the dimensions of x, whose tubes need not fit."""
        return draft(self.layout.space, self.x[: self.layout.designs])

    @property
    def tubes(self) -> tuple[Tube, ...]:
        """Tubes with the dimensions of x."""
        return self.robot.tubes

    @cached_property
    def slopes(self) -> dict[str, Array]:
        """Derivatives (n, X) of all dimensions and stiffnesses."""
        space, x = self.layout.space, self.x[: self.layout.designs]
        designs = space.slopes(x)
        if space.pieced:
            designs["curvature"] = space.bend_slopes(self.tubes, x)
        return {name: np.pad(part, ((0, 0), (0, self.layout.size - part.shape[1]))) for name, part in designs.items()}

    def joint_values(self, index: PoseNumber) -> tuple[Array, Array]:
        """Rotations and translations (n,) of a pose."""
        (rotations, _), (translations, _) = self._joints(index)
        return rotations, translations

    def joint_slopes(self, index: PoseNumber) -> tuple[Array, Array]:
        """Derivatives (n, X) of the rotations and of the translations of a pose."""
        (_, turned), (_, shifted) = self._joints(index)
        return turned, shifted

    def _joints(self, index: PoseNumber) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """Values and derivatives of rotations, then of translations, of a pose."""
        if isinstance(index, tuple):
            number, fraction = index
            turned, (shift, moved) = self._joints(number)
            drawn, withdrawn, last = retracted(self.tubes, shift, fraction)
            ended = moved + self.slopes["curved_length"]
            # A withdrawn tube ends at `fraction` times the end of the last one:
            # d translation = fraction d end_last - d curved_length, and `ended` is d translation + d curved_length.
            return turned, (drawn, moved - withdrawn[:, None] * (ended - fraction * ended[last]))
        pose = self.layout.poses[index]
        if isinstance(pose, Via):
            t, first, second = pose.fraction, self._joints(pose.first), self._joints(pose.second)
            rotations, translations = (
                # Joint values of a via point are linear between two poses, and so are their changes.
                ((1 - t) * a[0] + t * b[0], (1 - t) * a[1] + t * b[1])
                for a, b in zip(first, second, strict=True)
            )
            return rotations, translations
        if isinstance(pose, FixedPose):
            still = np.zeros((self.layout.n, self.layout.size))
            return (np.array(pose.rotations), still), (np.array(pose.translations), still)
        (alpha, beta), unit = self.layout.joints(pose), np.eye(self.layout.size)
        # beta counts from the clamped end: the translation, which counts from home, grows with the straight part.
        leading, carriage = [tubes[0] for tubes in self.layout.carriages], np.zeros(self.layout.n, dtype=int)
        for k, tubes in enumerate(self.layout.carriages):
            carriage[[*tubes]] = k
        straight = np.array([self.tubes[i].straight_length for i in leading])
        shift, moved = self.x[beta] + straight, unit[beta] + self.slopes["straight_length"][leading]
        return (self.x[alpha], unit[alpha]), (shift[carriage], moved[carriage])

    def pose(self, index: PoseNumber) -> AnyPose:
        """Solved pose."""
        if index not in self._poses:
            joints, slopes = self.joint_values(index), self.joint_slopes(index)
            # Only directions that some unknown moves are differentiated; the chain rule to all unknowns comes after.
            directions, self._chains[index] = moving(np.concatenate([*slopes, self._reshaped]))
            wrt, guess = (*JOINTS, *self.resized), self.guesses.get(index)
            pose = posed(self.robot, *joints, guess, wrt, self.piece_changes, directions)
            self._poses[index], self.guesses[index] = pose, pose.guess
        return self._poses[index]

    @cached_property
    def resized(self) -> dict[str, Array]:
        """Derivatives (n, X) of the DIMENSIONS and the ARRANGEMENT that depend on unknowns of whole tubes."""
        names = [name for name in DIMENSIONS if name != "curvature" or not self.layout.space.pieced]
        names += [name for name in ARRANGEMENT if name in self.slopes]
        return {name: self.slopes[name] for name in names if self.slopes[name].any()}

    @cached_property
    def free_pieces(self) -> list[int]:
        """Columns of the unknowns of pieces."""
        return [column for column, unknown in enumerate(self.layout.space.unknowns) if unknown.pieces]

    def piece_changes(self, directions: Directions) -> list[Change]:
        """Derivatives of the sections of a solved arm by every unknown of pieces."""
        unknowns = self.layout.space.unknowns
        values = piece_values(unknowns, self.x[: self.layout.designs].tolist())
        return [change_of(directions, unknowns[column], values) for column in self.free_pieces]

    @cached_property
    def _reshaped(self) -> Array:
        """Derivatives (L - 2 n, X) of the parameters of a pose, without its joint values."""
        return np.concatenate([*self.resized.values(), np.eye(self.layout.size)[self.free_pieces]])

    def chain(self, index: PoseNumber) -> Array:
        """Selection (Q, X) of the unknowns that a pose depends on."""
        self.pose(index)
        return self._chains[index]

    def jacobian(self, index: PoseNumber, *, turning: bool = False) -> tuple[Array, Array]:
        """Jacobian (6 n,) of the tip position by the joint values, joint by joint, and its derivative (6 n, X).

        With `turning` the Jacobian of the tip frame (rotation vector). The derivative is a central difference of exact
        derivatives.
        """
        if index not in self._moved:
            self._moved[index] = self._tip_moves(index)
        half = np.split(np.arange(12 * self.layout.n), 2)[int(turning)]
        return self._moved[index][0][half], self._moved[index][1][half]

    def _tip_moves(self, index: PoseNumber) -> tuple[Array, Array]:
        """Jacobians (12 n,) of the tip position, then of its frame, and their derivative (12 n, X)."""

        def jacobians(state: DesignState) -> Array:
            linear = state.pose(index).by_joints
            return np.concatenate([each.ravel(order="F") for each in (linear.tip_position, linear.tip_rotation)])

        # Sizes: dimensions have their own, rotations and auxiliary numbers 1, translations that of an arm.
        size = np.ones(self.layout.size)
        size[: self.layout.designs] = self.layout.space.scale
        for pose in self.layout.poses:
            if isinstance(pose, FreePose):
                size[self.layout.joints(pose)[1]] = 0.1  # m
        change = np.zeros((12 * self.layout.n, self.layout.size))
        for column in np.flatnonzero(self.chain(index).any(0)).tolist():
            # Derivatives are exact, so that truncation is 1e-8 of the second change, and round-off 1e-12 over 1e-4.
            step = np.eye(self.layout.size)[column] * 1e-4 * size[column]
            # States of their own with copied guesses: neither side may move the start of the other.
            ends = (jacobians(DesignState(self.layout, x, dict(self.guesses))) for x in (self.x + step, self.x - step))
            change[:, column] = -np.diff(np.stack(list(ends)), axis=0)[0] / (2 * step[column])
        return jacobians(self), change

    def proof_at(self, translations: tuple[float, ...]) -> tuple[Array, Array]:
        """`proof_parts` of a bundle at translations (n,), m, and their derivatives (.., X)."""
        if translations not in self._proofs:
            assert isinstance(self.robot, BundleRobot)
            bundle = bundle_at(self.robot, translations).beyond_rigid_length
            rows, chain = moving(self._reshaped)
            if (parts := proof_parts(bundle)) is None:
                raise SolveError("the tubes curve too tightly, relative to their offsets, for a certificate")
            split = np.cumsum([len(part) for part in self.resized.values()])
            slopes = dict(zip(self.resized, np.split(rows, split)[:-1], strict=True))
            if (longer := slopes.pop("sheath_rigid_length", None)) is not None:
                # Seen from its end, a longer rigid part draws all tubes back.
                slopes["translations"] = np.tile(-longer, (self.robot.n_tubes, 1))
            change = proof_slopes(bundle, slopes) @ chain if slopes else np.zeros((len(parts), self.layout.size))
            self._proofs[translations] = parts, change
        return self._proofs[translations]

    def certificate_at(self, translations: tuple[float, ...]) -> tuple[float, Array]:
        """Certificate mu_cert at translations (n,), m, and its gradient (X,); of bundles if ends keep their order."""
        if isinstance(self.robot, BundleRobot):
            parts, change = self.proof_at(translations)
            return float(parts[0]), change[0]
        solved = without_solving(self.tubes, np.array(translations))
        directions, chain = moving(self._reshaped)
        value, slope = Pose(solved, [*self.resized], self.piece_changes, directions).certificate
        return value, slope @ chain


def _value_and_change(state: DesignState, quantity: Quantity) -> tuple[Array, Array]:
    """Value and derivative of a quantity, as `DesignState.quantity`, not cached."""
    match quantity.name:
        case "certificate":
            return _row(state.certificate_at(quantity.at))
        case "order_reserve":
            parts, slope = state.proof_at(quantity.at)
            return parts[1:], slope[1:]
        case "straightened_strain":
            return _row(straightened_strain(state, *quantity.at))
        case "channel":
            return _row(channel(state))
        case "sheath_diameter":
            return _row(sheath(state))
    if quantity.pose is None:
        if isinstance(state.robot, BundleRobot) and quantity.name in ARRANGEMENT and quantity.name in state.slopes:
            return np.atleast_1d(getattr(state.robot, quantity.name)), state.slopes[quantity.name]
        if quantity.name not in state.slopes:
            raise InputError(f"{quantity.name} is no dimension of this robot")
        return np.array([getattr(tube, quantity.name) for tube in state.tubes]), state.slopes[quantity.name]
    match quantity.name:
        case "rotations" | "translations":
            part = JOINTS.index(quantity.name)
            return state.joint_values(quantity.pose)[part], state.joint_slopes(quantity.pose)[part]
        case "strain":
            return _row(pose_strain(state, quantity.pose, quantity.at[0]))
        case "deflection":
            return tip_deflection(state, quantity.pose, quantity.at[0])
        case "margin_under":
            return _row(margin_under(state, quantity.pose, quantity.at[0]))
        case "stroke_force":
            return _row(stroke_force(state, quantity.pose))
        case "jacobian" | "turning":
            return state.jacobian(quantity.pose, turning=quantity.name == "turning")
        case "clearance":
            ended = state.joint_slopes(quantity.pose)[1] + state.slopes["curved_length"]
            pose, chain, thicker = state.pose(quantity.pose), state.chain(quantity.pose), state.slopes["outer_diameter"]
            if isinstance(pose, Pose):
                radius = arm_radius(pose, 0.5 * thicker, ended, pose.derivatives.moved[-1] @ chain)
            else:
                # A sheath of one diameter is around the tubes.
                width, wider = sheath(state)
                radius = np.full(len(FRACTIONS), width / 2), np.tile(wider / 2, (len(FRACTIONS), 1))
            return arm_clearance(pose, quantity.at[0], chain, *radius)
    chain = state.chain(quantity.pose)
    value, change = _of_pose(state.pose(quantity.pose), quantity)
    return value, change @ chain


def _row(number: tuple[float, Array]) -> tuple[Array, Array]:
    """Value and derivative of one number as arrays (1,) and (1, X)."""
    return np.array(number[:1]), number[1][None]


def _of_pose(pose: AnyPose, quantity: Quantity) -> tuple[Array, Array]:
    """Value and derivative (.., Q) of a quantity of a pose, in its directions of differentiation."""
    of = pose.derivatives
    match quantity.name:
        case "tip_position":
            return pose.arm.position[-1], of.tip_position
        case "tip_direction":
            heading = pose.arm.frame[-1][:, 2]
            # A turn vector w moves a direction t by w x t.
            return heading, np.cross(of.tip_rotation, heading[:, None], axis=0)
        case "margin":
            return np.array([pose.margin]), of.one_margin[None]
        case "position":
            fraction = np.array(quantity.at[:1])
            return positions_at(of, fraction)[0], position_changes(of, fraction)[0]
        case _ if isinstance(of, Linearised):
            return curvature_at(of, quantity.at[0])
        case _:
            return of.curvature_at(quantity.at[0])


# --- arrangements -----------------------------------------------------------------------------------------------------


def sheath(state: DesignState) -> tuple[float, Array]:
    """Inner diameter of the sheath of a bundle, m, and its gradient (X,); one that touches the tubes is around them."""
    robot = state.robot
    if not isinstance(robot, BundleRobot):
        raise InputError("sheath_diameter is a dimension of eccentric robots; the tubes are nested")
    if robot.sheath_diameter is not None:
        return robot.sheath_diameter, state.slopes["sheath_diameter"][0]
    widest = int(np.argmax([d + tube.outer_diameter / 2 for d, tube in zip(robot.offset, robot.tubes, strict=True)]))
    return robot.least_sheath_diameter, 2 * state.slopes["offset"][widest] + state.slopes["outer_diameter"][widest]


def axes_slopes(state: DesignState) -> Array:
    """Derivative (n, 2, X) of the places of the tube axes in the cross-section of a bundle."""
    robot = state.robot
    assert isinstance(robot, BundleRobot)
    c, s = np.cos(robot.angle)[:, None], np.sin(robot.angle)[:, None]
    out, turned = state.slopes["offset"], np.array(robot.offset)[:, None] * state.slopes["angle"]
    return np.stack([c * out - s * turned, s * out + c * turned], axis=1)


# Of the sheath: surfaces closer to the largest free circle than this touch it.
TOUCHING = 1e-7


def channel(state: DesignState) -> tuple[float, Array]:
    """Diameter of the largest free circle between the tubes of a bundle, m, and its gradient (X,).

    The circle is a maximum over its centre: its radius changes as the distances of the surfaces that it touches from
    the centre, weighted by the forces of equal sum with which these hold it in balance.
    """
    robot = state.robot
    if not isinstance(robot, BundleRobot):
        raise InputError("channel is a dimension of eccentric robots; the tubes are nested")
    free, (width, wider) = channel_between(robot), sheath(state)
    away = np.array(free.centre) - robot.axes
    outwards = np.array([*away, -np.array(free.centre)])
    far = np.linalg.norm(outwards, axis=1)
    radius = np.array([tube.outer_diameter / 2 for tube in robot.tubes])
    distance = np.append(far[:-1] - radius, width / 2 - far[-1])
    outwards /= np.maximum(far, 1e-300)[:, None]
    near = np.flatnonzero(distance - free.diameter / 2 < TOUCHING * width)
    share, _ = scipy.optimize.nnls(np.vstack([outwards[near].T, np.ones(len(near))]), np.array([0.0, 0.0, 1.0]))
    by_tubes = -np.einsum("ic,icx->ix", outwards[:-1], axes_slopes(state)) - state.slopes["outer_diameter"] / 2
    return free.diameter, 2 * share @ np.vstack([by_tubes, wider / 2])[near]


# --- loads ------------------------------------------------------------------------------------------------------------


def tip_deflection(state: DesignState, index: PoseNumber, load: Load) -> tuple[Array, Array]:
    """Displacement (3,) of the tip by a load on a pose, m, and its derivative (3, X).

    Raises:
        SolveError: the robot does not withstand the load.
    """
    pose, chain = state.pose(index), state.chain(index)
    pushed = pose.under(load)
    of = pose.derivatives_of(pushed)
    # Both the loaded and the unloaded tip move with the design, so that the slope is a difference too.
    change = (of.tip_position - pose.derivatives.tip_position) @ chain
    return pushed.tip_position - pose.arm.position[-1], change


def margin_under(state: DesignState, index: PoseNumber, load: Load) -> tuple[float, Array]:
    """`sure_margin` of a pose under a load, and its gradient (X,).

    Raises:
        SolveError: the robot does not withstand the load, or coinciding breakpoints move apart.
    """
    pose, chain = state.pose(index), state.chain(index)
    pushed = pose.under(load)
    margin = sure_margin(pushed)
    if load.has_energy or isinstance(pose, BundlePose):
        slope = pose.derivatives_of(pushed).one_margin @ chain
    else:
        _, names, rows = _unloaded(state, index)
        pieces = np.eye(state.layout.size)[state.free_pieces]
        # Without an energy the Hessian is not symmetric, and the margin is that of its symmetric part.
        free = [(step, robots) for _, step, robots in _free_pieces(state)]
        slope = margin_slopes(pushed, names, free, sure=True) @ np.concatenate([rows, pieces])
    if not np.isfinite(slope).all():
        raise SolveError(f"the margin of pose {index} under a load has no derivative: breakpoints meet there")
    return margin, slope


def stroke_force(state: DesignState, index: PoseNumber) -> tuple[float, Array]:
    """Stroke force of a pose, N, at most STRONGEST, and its gradient (X,).

    Raises:
        SolveError: the branch ends without a limit nearby, or the force has no derivative.
    """
    pose, chain = state.pose(index), state.chain(index)
    if isinstance(pose, BundlePose):
        of_bundle = stroke_slopes(pose.equilibrium, pose.wrt, STRONGEST, along=pose.along)
        # The value is capped at STRONGEST, and a capped value has no slope.
        return (STRONGEST, np.zeros(state.layout.size)) if of_bundle is None else (of_bundle[0], of_bundle[1] @ chain)
    plain, names, rows = _unloaded(state, index)
    free = _free_pieces(state)
    rotation_slopes = pose.derivatives.tip_rotation @ chain
    varied = [Varied(step, robots, rotation_slopes[:, k]) for k, step, robots in free]
    slopes = stroke_slopes(plain, names, STRONGEST, varied=varied)
    if slopes is None:
        return STRONGEST, np.zeros(state.layout.size)
    pieces = np.eye(state.layout.size)[state.free_pieces]
    return slopes[0], slopes[1] @ np.concatenate([rows, pieces])


class _UnloadedPose(NamedTuple):
    """Pose without load, and the parameters that depend on unknowns of whole tubes and joints."""

    equilibrium: Equilibrium
    names: list[str]
    """Names of the PARAMETERS that depend on unknowns; others need no derivatives."""
    rows: Array
    """Derivatives of the rows by the unknowns, n rows each, X columns."""


def _unloaded(state: DesignState, index: PoseNumber) -> _UnloadedPose:
    """Equilibrium of a pose without load, its parameters that depend on unknowns, and their derivatives."""
    rows = dict(zip(JOINTS, state.joint_slopes(index), strict=True)) | state.resized
    moved = {name: part for name, part in rows.items() if part.any()}
    changes = np.concatenate([np.zeros((0, state.layout.size)), *moved.values()])
    return _UnloadedPose(state.pose(index).equilibrium, [*moved], changes)


class _PieceStep(NamedTuple):
    """Step of one unknown of pieces, for central differences."""

    column: int
    step: float
    robots: tuple[ConcentricRobot, ConcentricRobot]
    """Robots a step up and a step down."""


def _free_pieces(state: DesignState) -> list[_PieceStep]:
    """Steps of all unknowns of pieces."""
    space, designs, out = state.layout.space, state.x[: state.layout.designs], []
    for k in state.free_pieces:
        step = STEP * float(space.scale[k])
        row = step * np.eye(len(designs))[k]
        robots = ConcentricRobot(space.tubes(designs + row)), ConcentricRobot(space.tubes(designs - row))
        out.append(_PieceStep(k, step, robots))
    return out


# --- strain -----------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def _strain() -> ca.Function:
    """Strain and its gradient (1, 5) as function of theta, u (2,), precurvature and outer diameter."""
    x = ca.SX.sym("x", 5)
    theta, u, natural, diameter = x[0], (x[1], x[2]), x[3], x[4]
    bend = bend_from_own((ca.cos(theta), ca.sin(theta)), u, natural)
    strain = surface_strain(diameter / 2, bend, natural)
    return ca.Function("strain", [x], [strain, ca.densify(ca.jacobian(strain, x))])


@lru_cache(maxsize=1)
def _straightened() -> ca.Function:
    """Strain of a straightened tube and its gradient (1, 2) as function of precurvature and outer diameter."""
    x = ca.SX.sym("x", 2)
    # Held straight, a tube loses its whole precurvature: it is bent by |u*| against its natural shape.
    strain = surface_strain(x[1] / 2, ca.fabs(x[0]), x[0])
    return ca.Function("straightened", [x], [strain, ca.densify(ca.jacobian(strain, x))])


@lru_cache(maxsize=1024)
def _slot_ratio(tube: Tube, number: int) -> tuple[float, float]:
    """Strain of a piece relative to a tube without slots, and its derivative by the bending factor."""
    if not tube.pieces or (slots := tube.pieces[number].slots) is None:
        return 1.0, 0.0
    b = ca.SX.sym("b")
    ratio = slots.strain_ratio(b)
    function = ca.Function("ratio", [b], [ratio, ca.jacobian(ratio, b)])
    value, slope = function(tube.pieces[number].bending_factor(float(tube.bending_stiffness)))
    return float(value), float(slope)


def _ratio(state: DesignState, tube: int, number: int) -> tuple[float, Array]:
    """Strain of a piece relative to a tube without slots, and its gradient (X,)."""
    shape, space = state.tubes[tube], state.layout.space
    value, slope = _slot_ratio(shape, number)
    change = np.zeros(state.layout.size)
    for column, unknown in enumerate(space.unknowns):
        if unknown.field == "piece_bending_factor" and (tube, number) in unknown.pieces:
            factor = shape.pieces[number].bending_factor(float(shape.bending_stiffness))
            # The remaining stiffness is proportional to the unknown x, so that its slope is factor / x.
            change[column] = slope * factor / state.x[column]
    return value, change


def straightened_strain(state: DesignState, tube: int, number: int) -> tuple[float, Array]:
    """Largest strain of a piece of a straightened tube, and its gradient (X,); a tube of one curvature is one piece."""
    shape, space = state.tubes[tube], state.layout.space
    if not space.pieced:
        natural, change = shape.curvature, state.slopes["curvature"][tube]
    else:
        natural = shape.pieces[number].largest_curvature
        designs = state.x[: state.layout.designs]
        # Held straight, a tube depends on no joint value and no auxiliary number: their columns are 0.
        change = np.pad(space.bend_slope(shape, (tube, number), designs), (0, state.layout.size - len(designs)))
    value, slope = (part.full().ravel() for part in _straightened()([natural, shape.outer_diameter]))
    change = slope[0] * change + slope[1] * state.slopes["outer_diameter"][tube]
    ratio, raised = _ratio(state, tube, number)
    return ratio * float(value[0]), ratio * change + float(value[0]) * raised


def pose_strain(state: DesignState, index: PoseNumber, tube: int) -> tuple[float, Array]:
    """Largest bending strain of a tube in a pose, and its gradient (X,); 0 if the tube is behind the plate."""
    shape, of = state.tubes[tube], state.pose(index).derivatives
    if isinstance(of, LinearisedBundle):
        return _bundle_strain(state, of, index, tube)
    n, mesh = of.n, of.problem.mesh
    # Sections in which the tube is present from end to end; the others have no strain of it.
    sections = np.flatnonzero((of.arm.stiffness[..., tube] > 0).all(1) & (mesh.length > 0))
    if not len(sections):
        return 0.0, np.zeros(state.layout.size)
    across, bend = (table[sections].reshape(len(sections) * len(SHAPE_POINTS), -1) for table in of.sections)
    theta, stiffness, moment = (across[:, k * n + tube] for k in range(3))
    # The moment of a tube is kb u*, its stiffness times its precurvature: the quotient is u*.
    inputs = np.column_stack([theta, bend, moment / stiffness, np.full(len(theta), shape.outer_diameter)])
    strains, slopes = (part.copy() for part in mapped(_strain(), len(inputs))(inputs))
    number = _pieces_at(shape, mesh.start[sections] + mesh.length[sections] / 2 + of.assembly.transmission[tube])
    ratios = np.array([_slot_ratio(shape, k)[0] if k >= 0 else 1.0 for k in number.tolist()])
    # The maximum has the slope of the section in which it is reached; of equal ones the first is taken.
    worst = int(np.argmax(strains[:, 0] * np.repeat(ratios, len(SHAPE_POINTS))))
    piece, end = divmod(worst, len(SHAPE_POINTS))
    k = int(sections[piece])
    at = of.section(k, SHAPE_POINTS[end], of.moved[k * (len(SHAPE_POINTS) - 1) + end])
    kb, natural = stiffness[worst], inputs[worst, 3]
    # u* = M / kb, so that du* = (dM - u* dkb) / kb.
    grown = (at.by_tubes[2 * n + tube] - natural * at.by_tubes[n + tube]) / kb
    slope, value = slopes.reshape(-1, 5)[worst], float(strains[worst, 0])
    change = (slope[0] * at.by_tubes[tube] + slope[1:3] @ at.by_curvature + slope[3] * grown) @ state.chain(index)
    change = change + slope[4] * state.slopes["outer_diameter"][tube]
    if number[piece] < 0:
        return value, change
    ratio, raised = _ratio(state, tube, int(number[piece]))
    return ratio * value, ratio * change + value * raised


def _bundle_strain(state: DesignState, of: LinearisedBundle, index: PoseNumber, tube: int) -> tuple[float, Array]:
    """Largest bending strain of a tube of a bundle in a pose, and its gradient (X,), as `pose_strain`."""
    at, diameter = of.along_tube(tube), state.tubes[tube].outer_diameter
    elements, places = at.theta.shape
    if not elements:
        return 0.0, np.zeros(state.layout.size)
    natural = np.repeat(at.natural, places)
    inputs = np.column_stack([at.theta.ravel(), at.curvature.reshape(-1, 2), natural, np.full(len(natural), diameter)])
    strains, slopes = (part.copy() for part in mapped(_strain(), len(inputs))(inputs))
    worst = int(np.argmax(strains[:, 0]))
    slope, (k, x) = slopes.reshape(-1, 5)[worst], divmod(worst, places)
    change = slope[0] * at.turned[k, x] + slope[1:3] @ at.bent[k, x] + slope[3] * at.curved[k]
    return float(strains[worst, 0]), change @ state.chain(index) + slope[4] * state.slopes["outer_diameter"][tube]


def _pieces_at(shape: Tube, arc_length: Array) -> Array:
    """Pieces (P,) of a tube at arc lengths along it, m; -1 for the straight part and for a tube of one curvature."""
    joints = shape.straight_length + np.cumsum([0.0, *(piece.length for piece in shape.pieces)])
    # A place beyond the last piece by round-off belongs to that piece.
    return np.minimum(np.searchsorted(joints, arc_length, side="right") - 1, len(shape.pieces) - 1)
