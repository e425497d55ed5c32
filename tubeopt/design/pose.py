"""A solved pose of a design: shape, margin and clearance, and their derivatives by the unknowns.

Derivatives are by joint values, by dimensions of the tubes and by what is free of their pieces. Places along the arm
are fixed *within* the pieces of its mesh, which move along with the breakpoints: there the shape, and the strain of a
tube, are smooth in all lengths.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from ..block.quantities import CLEARANCES
from ..block.transcription.arm import ArmShape, evaluate_arm
from ..block.transcription.arm_response import LinearisedArm
from ..equilibrium.directions import Change, Directions
from ..equilibrium.jacobian import derivatives_of
from ..equilibrium.kinematics import forward_kinematics, to_equilibrium, under_load
from ..equilibrium.linearised import Linearised, linearise, position_changes, positions_at
from ..equilibrium.linearised_bundle import LinearisedBundle, linearise_bundle
from ..equilibrium.member import PlainPoint, Point, Unloaded
from ..equilibrium.problem import reduced_assembly
from ..equilibrium.result import Derivatives, Equilibrium
from ..errors import SolveError
from ..robots.assembly import assemble
from ..robots.concentric import ConcentricRobot
from ..robots.eccentric import BundleRobot
from ..robots.load import Load
from ..robots.robot import Robot
from ..robots.tubes import Tube
from ..stability.certificate import worst_case, worst_of_pair
from ..typing import Array
from .parameters import DesignSpace

# Points at which the clearance is evaluated within each of the CLEARANCES parts of the arm; the smallest of a part
# becomes a row.
WITHIN = 16

# Distance (m) by which the arm is kept off in addition, for what lies between the points: on 200 mm an arm with a
# radius of 20 mm leaves its chord by h^2 / 8 R, 2 um; edges of bodies need the rest.
HELD_OFF = 2e-5

# Length (m) over which a tube's radius runs out beyond its end: the clearance has no derivative at a step. It is
# never too small, so that the design stays clear.
RAMP = 3e-3


# From 1: the point at the plate is the same for all designs.
FRACTIONS = (np.arange(CLEARANCES * WITHIN) + 1) / (CLEARANCES * WITHIN)


def arm_clearance(pose: AnyPose, body: Any, chain: Array, radius: Array, rounder: Array) -> tuple[Array, Array]:
    """Smallest distance (CLEARANCES,) of the arm's surface from a body in each part of the arm, minus HELD_OFF, m.

    The second value is its derivative (CLEARANCES, X).

    `chain` (Q, X) takes the directions of the pose to the unknowns; `radius` (K,) is that of the arm at FRACTIONS of
    its length, m, and `rounder` (K, X) its derivative.
    """
    of = pose.derivatives
    points = positions_at(of, FRACTIONS)
    distance = body.signed_distance(points) - radius - HELD_OFF
    # The minimum over several points has the slope of the point where it is reached.
    worst = distance.reshape(CLEARANCES, WITHIN).argmin(1) + WITHIN * np.arange(CLEARANCES)
    local = np.einsum("kc,kcl->kl", body.gradient(points[worst]), position_changes(of, FRACTIONS[worst]))
    return distance[worst], local @ chain - rounder[worst]


def arm_radius(pose: Pose, thicker: Array, ended: Array, longer: Array) -> tuple[Array, Array]:
    """Radius (K,) of the arm at FRACTIONS of its length, and its derivative (K, X).

    `thicker` and `ended` (n, X) are the derivatives of the radii and ends of the tubes, `longer` (X,) of the length.

    Beyond its end a tube's radius runs out over RAMP, so that the radius is continuous, and never too small.
    """
    radii = np.array([tube.outer_diameter / 2 for tube in pose.solved.member.robot.tubes])
    fraction = FRACTIONS[:, None]
    beyond = (fraction * pose.arm.arc_length[-1] - pose.problem.assembly.end) / RAMP
    ramp = np.clip(beyond, 0.0, 1.0)
    # Each radius falls to that of the innermost tube: at least that is left of the arm everywhere.
    each = radii - (radii - radii[0]) * ramp
    tube = each.argmax(1)
    k = np.arange(len(FRACTIONS))
    thin = ramp[k, tube, None]
    change = thin * thicker[0] + (1 - thin) * thicker[tube]
    # The slope jumps at both ends of a ramp; there 0 is taken, the value outside of it.
    sloping = (beyond[k, tube] > 0) & (beyond[k, tube] < 1)
    rate = np.where(sloping, (radii[0] - radii[tube]) / RAMP, 0.0)
    return each[k, tube], change + rate[:, None] * (fraction * longer - ended[tube])


# --- Poses of bundles -------------------------------------------------------------------------------------------------


class _DraftBundle(BundleRobot):
    """Bundle of a trial design, whose tubes may overlap."""

    def __post_init__(self) -> None:
        pass


class BundlePose:
    """Solved pose of a bundle; derivatives as of `Pose`, by PARAMETERS and the ARRANGEMENT."""

    def __init__(self, equilibrium: Equilibrium, wrt: Sequence[str] = (), along: Array | None = None) -> None:
        self.equilibrium, self.wrt, self.along = equilibrium, tuple(wrt), along
        self.arm, self.margin = equilibrium.arm, equilibrium.margin

    def under(self, load: Load) -> Equilibrium:
        """Equilibrium under a load, as `Pose.under`."""
        return under_load(self.equilibrium, load)

    def derivatives_of(self, equilibrium: Equilibrium) -> LinearisedBundle:
        """Derivatives of another equilibrium of the same design and joint values, by the same unknowns."""
        return linearise_bundle(equilibrium, self.wrt, along=self.along)

    @property
    def guess(self) -> Equilibrium:
        """Guess for a nearby pose."""
        return self.equilibrium

    @cached_property
    def derivatives(self) -> LinearisedBundle:
        """Derivatives of the pose at fixed arc lengths."""
        return self.derivatives_of(self.equilibrium)

    @cached_property
    def by_joints(self) -> Derivatives:
        """Derivatives of the pose by the joint values, tube by tube."""
        return derivatives_of(self.equilibrium)


def solve_bundle(
    robot: BundleRobot, rotations: Array, translations: Array, guess: Equilibrium | None = None
) -> Equilibrium:
    """Equilibrium on the branch of `guess`, or the result of descent from tubes without torsion."""
    if guess is not None:
        with suppress(SolveError):
            return forward_kinematics(robot, rotations, translations, start=guess)
    return forward_kinematics(robot, rotations, translations)


# --- Poses of concentric tubes ----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Twist:
    """Twist theta - alpha (m, n) of a solved pose at fractions (m,) of the arm: a guess for the next one."""

    fraction: Array
    twist: Array


class _Draft(ConcentricRobot):
    """Robot of a trial design, for which tubes need not nest."""

    def __post_init__(self) -> None:
        pass


def _placed(tubes: Sequence[Tube], rotations: Array, translations: Array) -> Unloaded:
    """Torsion problem of tubes at joint values; not cached, since every design has other tubes."""
    assembly = assemble(tubes, translations)
    problem = reduced_assembly(assembly)
    return Unloaded(_Draft(tuple(tubes)), problem, rotations, tuple(translations.tolist()))


def solve_pose(tubes: Sequence[Tube], rotations: Array, translations: Array, guess: Twist | None = None) -> PlainPoint:
    """Equilibrium near `guess`, or the result of descent from tubes without torsion."""
    member = _placed(tubes, rotations, translations)
    problem = member.problem
    if guess is not None and len(guess.fraction) and problem.size:
        fraction = problem.arc_length / max(problem.assembly.total_length, 1e-300)
        # The twist is interpolated, not theta: it is 0 without torsion at any rotations, so that it fits other ones.
        twist = np.column_stack([np.interp(fraction, guess.fraction, column) for column in guess.twist.T])
        result = member.solve(member.unknowns(rotations + twist), iterations=12)
        if result.converged:
            return Point.of(member, result)
    result = member.descend(np.zeros(problem.size))
    if not result.converged:
        raise SolveError("no equilibrium was found at a pose of the design")
    return Point.of(member, result)


def without_solving(tubes: Sequence[Tube], translations: Array) -> PlainPoint:
    """Pose at given translations without its equilibrium, for the certificate, which is independent of rotations."""
    member = _placed(tubes, np.zeros(len(tubes)), translations)
    return Point(0.0, member, member.at(np.zeros(member.problem.size)), 1.0)


def moving(rows: Array) -> tuple[Array, Array]:
    """Columns (L, Q) of derivatives (L, X) that are not zero, and the matrix (Q, X) that selects their unknowns.

    Derivatives along the columns, times the selection, are derivatives by all unknowns.
    """
    columns = np.flatnonzero(rows.any(0))
    # Derivatives cost as much as there are directions: unknowns that move nothing are left out.
    return rows[:, columns], np.eye(rows.shape[1])[columns]


class Pose:
    """Solved pose of n tubes with m shape points; derivatives are computed on first use.

    Derivatives (.., L) are by the PARAMETERS in `wrt`, n columns each, then by the changes of sections that `more`
    returns; or along the directions `along` (L, Q).
    """

    def __init__(
        self,
        solved: PlainPoint,
        wrt: Sequence[str] = (),
        more: Callable[[Directions], Sequence[Change]] | None = None,
        along: Array | None = None,
    ) -> None:
        self.solved, self.problem, self.margin = solved, solved.member.problem, solved.margin
        self.wrt, self.more, self.along = tuple(wrt), more, along

    @cached_property
    def arm(self) -> ArmShape:
        """Shape of the arm."""
        solved = self.solved
        return evaluate_arm(self.problem, solved.member.rotations, solved.state, solved.torsion)

    @cached_property
    def equilibrium(self) -> Equilibrium:
        """The pose as an equilibrium."""
        return to_equilibrium(self.solved, "guess")

    def under(self, load: Load) -> Equilibrium:
        """Equilibrium at the same joint values on the same branch under a load.

        Raises:
            SolveError: the branch ends before the full load.
        """
        return under_load(self.equilibrium, load)

    def derivatives_of(self, equilibrium: Equilibrium) -> Linearised:
        """Derivatives of another equilibrium of the same design and joint values, by the same unknowns."""
        return linearise(equilibrium, self.wrt, more=self.more, along=self.along)

    @property
    def guess(self) -> Twist:
        """Guess for a nearby pose."""
        length = max(self.problem.assembly.total_length, 1e-300)
        return Twist(self.problem.arc_length / length, self.solved.state.theta - self.solved.member.rotations)

    @cached_property
    def derivatives(self) -> Linearised:
        """Derivatives of the pose at fixed arc lengths."""
        tubes = self.solved.member.robot.tubes
        return Linearised(self._standing, tubes, self.margin, self.wrt, more=self.more, along=self.along)

    @cached_property
    def by_joints(self) -> Linearised:
        """Derivatives of the pose by the joint values, tube by tube."""
        return Linearised(self._standing, self.solved.member.robot.tubes, self.margin)

    @cached_property
    def _standing(self) -> LinearisedArm:
        return LinearisedArm(self.problem, self.solved.member.rotations, self.solved.state.theta, self.arm)

    @cached_property
    def certificate(self) -> tuple[float, Array]:
        """Certificate mu_cert at the translations of this pose, and its derivative (L,).

        For two tubes made of pieces it is the smallest margin of all equilibria, which may exceed the bound.
        """
        value, mode, _ = worst_case(self.problem)
        # At its worst the margin is stationary in the rotations: its slope at given rotations is that of the minimum.
        worst = worst_of_pair(self.solved.member, value)
        if worst is not None:
            return worst.margin, Pose(worst, self.wrt, self.more, self.along).derivatives.one_margin
        return value, self.derivatives.certificate(value, mode)


AnyPose = Pose | BundlePose
"""Solved pose of a design."""

Guess = Twist | Equilibrium
"""Start of the solve of a pose: of a bundle, an equilibrium."""


def draft(space: DesignSpace, x: Array) -> Robot:
    """Robot of a trial design at its dimensions x (D,); its tubes need not fit.

    Raises:
        InputError: tubes without a wall.
    """
    robot = space.robot
    if not isinstance(robot, BundleRobot):
        return _Draft(space.tubes(x))
    return _DraftBundle(**{field.name: getattr(robot, field.name) for field in fields(robot)} | space.fields(x))


def posed(
    robot: Robot,
    rotations: Array,
    translations: Array,
    guess: Guess | None = None,
    wrt: Sequence[str] = (),
    more: Callable[[Directions], Sequence[Change]] | None = None,
    along: Array | None = None,
) -> AnyPose:
    """Solved pose near `guess`, or by descent from tubes without torsion; other arguments as of `Pose`.

    Raises:
        SolveError: no equilibrium was found.
        InputError: translations that carriages do not allow.
    """
    if isinstance(robot, BundleRobot):
        known = guess if isinstance(guess, Equilibrium) else None
        return BundlePose(solve_bundle(robot, rotations, translations, known), wrt, along)
    twist = guess if isinstance(guess, Twist) else None
    return Pose(solve_pose(robot.tubes, rotations, translations, twist), wrt, more, along)
