"""Collocated equilibrium of concentric tubes under load: torsion and bending, with the orientation eliminated.

Unknowns are whitened: z of the torsion, as in `reduced`, and q of the bending, two per collocation point,

    theta = alpha + L z,      u = u0(theta) + q / sqrt(B K),      K = sum kb,

where u0 is the curvature of the unloaded cross-section. Dead loads determine the force n on the cross-sections in
advance. The elastic energy and the work of the load are

    E = z'z / 2 + q'q / 2 + sum B V(theta) - W,      W = sum B n.t(u),

where t is the tangent from the orientation by u. The collocated equations of equilibrium are grad E = 0, with the
bending moment m = dW/du / B. The smallest eigenvalue of the Hessian is the margin. Without load the Hessian is
block-diagonal: that of `reduced`, and the identity.

Moments, and forces that turn with the tip, have no such W. Their equations are the same, with the virtual work of the
load in place of the derivatives of W, and their Jacobian is not symmetric. The sum m of the moments beyond a point adds
B (R'm)_xy to dW/du, where R is the Bishop frame, and each moment twists its tube (`Couples`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ...physics.shape import hat, rotation_matrix_function, tangent_forms, world_turns
from ...robots.load import FORCE, MOMENT, Load
from ...robots.order import outermost, twisted_tube
from ...typing import Array, Index
from .arm import ArmShape, Profile, along_elements, arc_lengths, integrate, pushed, sections_along, torsional_energy
from .buffered import mapped, section_function
from .collocated import ENDS
from .mesh import Mesh
from .orientation import (
    Orientation,
    adjoint,
    centreline,
    moment_work,
    orient,
    position_slopes,
    second_derivative,
    tangent_slopes,
    tangents,
)
from .reduced import ReducedProblem, TubeTurn, to_unknowns, torsional_hessian, tube_turn

# --- Dead moments -----------------------------------------------------------------------------------------------------

# A moment m of fixed direction acts on tube j, where the arm has the tangent t. In a small motion the frame turns by
# dpsi about world axes, and the tube by dtheta about the tangent. The work is
#
#     m.dpsi + tau dtheta,        tau = m.t.
#
# The first part bends all tubes up to there: `evaluate` adds it to that of forces, by the sum of all moments beyond.
# The second part twists one tube: at the tip the tube that ends last (of several the innermost), elsewhere the
# outermost.
# At a joint between elements m is the moment itself; a moment per length acts at the collocation points, times their
# weights. The work depends on the path, so that the Jacobian is not symmetric.

END = 1e-12
"""Distance (m) within which a moment acts where a tube ends: round-off of a length."""


@dataclass(frozen=True, eq=False)
class Couples:
    """C moments on the tubes of an arm: J between elements, the tip first, then those at collocation points."""

    along: Array
    """Moments (N, n, 3) per length on the tubes at the collocation points, N."""
    moment: Array
    """Moments (C, 3) in world axes, N m; the moment at the tip in the axes of the load."""
    joint: Index
    """Elements (J,) that start where the moments act; the number of elements at the tip."""
    point: Index
    """Collocation points (C - J,)."""
    tube: Index
    """Tubes (C,) that the moments act on."""
    row: Array
    """Rotations (C, U) of the tubes where the moments act, by z."""
    following: bool
    """The moment at the tip turns with it."""
    compliance: Array
    """Torsional compliances (C,) of the tubes up to the moments, rad/(N m)."""

    def rest(self, turn: TubeTurn) -> Array:
        """Rotation (C,) of a tube at a place by a unit torque of each moment, less its part through z, rad/(N m)."""
        # int ds / kt up to the nearer of two places on one tube, less its part L L' through the collocation points.
        shared = np.where(self.tube == turn.tube, np.minimum(self.compliance, turn.compliance), 0.0)
        return np.asarray(shared - self.row @ turn.row)

    def quaternions(self, orientation: Orientation) -> Array:
        """Quaternions (C, 4) where the moments act."""
        return np.concatenate([orientation.start[self.joint], orientation.stage[self.point]])

    def torques(self, orientation: Orientation) -> Array:
        """Torques (C,) tau = m.t, N m."""
        out = (self.moment * tangents(self.quaternions(orientation))).sum(1)
        if self.following:
            out[0] = self.moment[0, 2]
        return np.asarray(out)

    def torque_slopes(self, orientation: Orientation, curvature_slope: Array) -> Array:
        """Derivative (C, U + 2 N) of the torques by x, from the slope of the curvature (2 N, U + 2 N)."""
        slope = np.concatenate([orientation.start_slope[self.joint], orientation.stage_slope[self.point]])
        by_quaternion = (self.moment[:, None] @ tangent_slopes(self.quaternions(orientation)))[:, 0]
        # A moment that turns with the tip has a constant torque.
        by_quaternion[:1] *= not self.following
        return np.asarray((by_quaternion[:, None] @ slope)[:, 0] @ curvature_slope)


def couples_of(torsion: ReducedProblem, load: Load, per_length: Array, spread: Array) -> Couples:
    """Moments of a load: at the tip, at its points, and `per_length` (N, 3) at the collocation points, N.

    `spread` (N, n, U) is the derivative of the rotations at the points by z.
    """
    assembly, mesh = torsion.assembly, torsion.mesh
    point_compliance = torsion.softness[0]
    at_joints = [part for part in load.acting[::-1] if any(part.moment) or part.at == np.inf]
    # The element that starts there, at the tip the number of elements.
    joint = np.searchsorted(mesh.start, [part.at - END for part in at_joints])
    on_joint, point = twisted_tube(assembly.end, [part.at for part in at_joints]), np.flatnonzero(per_length.any(1))
    outer_tube = np.repeat(outermost(assembly.present)[mesh.section], mesh.tableau.degree)
    on_point = outer_tube[point]
    tube = np.concatenate([on_joint, on_point])
    turns = [tube_turn(torsion, j, element) for j, element in zip(on_joint.tolist(), joint.tolist(), strict=True)]
    compliance = np.concatenate([[turn.compliance for turn in turns], point_compliance[point, on_point]])
    rows = [turn.row for turn in turns]
    row = np.concatenate([rows, spread[point, on_point]])
    return Couples(
        along=np.where((outer_tube[:, None] == np.arange(assembly.n_tubes))[..., None], per_length[:, None], 0.0),
        moment=np.concatenate([[part.moment for part in at_joints], (per_length.T * torsion.weight).T[point]]),
        joint=joint,
        point=point,
        tube=tube,
        row=row,
        following=load.frame == "tip",
        compliance=compliance,
    )


@dataclass(frozen=True, eq=False)
class LoadedProblem:
    """Data of one robot under one load on one mesh, for any rotations; N points, U unknown rotations."""

    torsion: ReducedProblem
    """Problem of the rotations, on a mesh with collocation points in every element."""
    load: Load
    """External load."""
    ahead: Array
    """Sum (N, 6) of forces n, N, and moments m, N m, that act beyond the points, in world axes."""
    base: Array
    """Sum (6,) of all forces and moments."""
    couples: Couples | None
    """Moments of a load without an energy, or None."""

    @cached_property
    def force(self) -> Array:
        """Forces n (N, 3) on the cross-sections, N."""
        return np.ascontiguousarray(self.ahead[:, FORCE])

    @property
    def spread(self) -> Array:
        """Rows (N, n, U) of L, 0 for tubes that are not unknown at a point."""
        return self.torsion.spread

    @property
    def softness(self) -> Array:
        """Factors (N,) 1 / sqrt(B K)."""
        return self.torsion.bending_softness

    @property
    def tip_tube(self) -> int:
        """Tube that ends last; of several, the innermost."""
        return self.torsion.tip_tube

    @property
    def tip_lever(self) -> float:
        """Torsional compliance of the tip tube at its end, rad/(N m)."""
        return float(self.torsion.softness[1][-1, self.torsion.tip_tube])

    @property
    def mesh(self) -> Mesh:
        """Elements of the arm."""
        return self.torsion.mesh

    @cached_property
    def twist_angle(self) -> Array:
        """Natural rotations (N, n) of the tubes up to the points, rad."""
        return self.torsion.assembly.twist_angle(self.torsion.arc_length)

    @property
    def size(self) -> int:
        """Number of unknowns U + 2 N."""
        return self.torsion.size + 2 * len(self.softness)


@dataclass(frozen=True, eq=False)
class LoadedState:
    """State of a loaded problem."""

    x: Array
    """Unknowns (U + 2 N,): z and q."""
    factor: float
    """Factor of the load."""
    theta: Array
    """Elastic rotations (N, n) at the points, rad."""
    curvature: Array
    """Curvature (N, 2) at the points, 1/m."""
    energy: float
    """Elastic energy, J; under moments without the torsion that z does not determine."""
    work: float
    """Work int n.t ds of the load, J; NaN for a load without an energy.

    It counts from an arm with all points at the plate.
    """
    gradient: Array
    """Gradient of energy less work by x, or the equations for loads without an energy."""
    hessian: Array
    """Derivative of `gradient` by x."""
    load_slope: Array
    """Derivative (U + 2 N,) of `gradient` by the factor."""
    torque: Array
    """Torque (N, n) per length on each tube, N."""
    joint_torques: Array
    """Torques (J,) of the moments at joints, N m."""
    torque_slope: Array
    """Derivative (C, U + 2 N) of the torques of all moments by x."""
    base_moment: Array
    """Bending moment (2,) at the plate, N m."""
    orientation: Orientation
    """Orientation of the arm."""
    curvature_slope: Array
    """Derivative (2 N, U + 2 N) of the curvature by x."""

    @property
    def potential(self) -> float:
        """Energy less work, J, which is minimal at equilibria under dead loads."""
        return self.energy - self.work


@dataclass(frozen=True, eq=False)
class Loading:
    """Load on an assembly with breakpoints at the jumps of the load."""

    load: Load
    """External load."""
    density: Array
    """Masses (n,) per length of the tubes, kg/m."""
    counts: Index
    """Minimum numbers (m,) of elements of the sections."""


def load_problem(torsion: ReducedProblem, load: Load, density: Array) -> LoadedProblem:
    """Problem of an equilibrium under load; `density` (n,) is the mass per length of the tubes, kg/m."""
    mesh = torsion.mesh
    # Forces, N/m, and moments, N, per length at the points (P, K, 6), in world axes.
    per_length = load.per_length(mesh.start[:, None] + mesh.length[:, None] * mesh.tableau.nodes)
    if load.gravity is not None:
        mass = torsion.assembly.present @ density
        per_length[..., FORCE] += mass[mesh.section][:, None, None] * np.array(load.gravity)
    moments = per_length[..., MOMENT].reshape(-1, 3)
    couples = None if load.has_energy else couples_of(torsion, load, moments, torsion.spread)
    return LoadedProblem(torsion, load, *_ahead(mesh, load, per_length), couples)


def _ahead(mesh: Mesh, load: Load, per_length: Array) -> tuple[Array, Array]:
    """Total force and moment (N, 6) between each point and the tip, and beyond the plate (6,), in world axes.

    `per_length` (P, K, 6) are the distributed ones; forces that turn with the tip are left out.
    """
    s = mesh.start[:, None] + mesh.length[:, None] * mesh.tableau.nodes
    out, base = np.zeros((*s.shape, 6)), np.zeros(6)
    if per_length.any():
        h, t = mesh.length[:, None, None], mesh.tableau
        of_element = (h * per_length * t.weights[:, None]).sum(1)
        ahead = np.cumsum(of_element[::-1], axis=0)[::-1]
        # From each point to the end of its element, then the elements beyond.
        out, base = h * ((t.weights - t.matrix) @ per_length) + (ahead - of_element)[:, None], ahead[0].copy()
    for part in load.acting if load.frame == "world" else load.points:
        # At the end of the arm, within round-off, a force acts on all of it.
        out[s < part.at] += (*part.force, *part.moment)
        base += (*part.force, *part.moment)
    return out.reshape(-1, 6), base


def evaluate(problem: LoadedProblem, rotations: Array, x: Array, factor: float = 1.0) -> LoadedState:
    """Energy, equations and their derivatives at x (U + 2 N,) for base rotations (n,) and `factor` times the load."""
    torsion, mesh = problem.torsion, problem.mesh
    split, (count, n) = torsion.size, torsion.stiffness.shape
    weight, z, q = torsion.weight, x[: torsion.size], x[torsion.size :]
    theta = np.empty((count, n))
    theta[:] = rotations
    theta.ravel()[torsion.flat] += torsion.factor @ z
    coupling, moment, stiffness, natural, slope, second = section_function("bending", count, n, False)(
        theta + torsion.phase, torsion.stiffness, torsion.moment
    )
    # CasADi stores by columns: (N, n, 2).
    slope, second = (part.reshape(count, n, 2).swapaxes(1, 2) for part in (slope, second))
    curvature = natural + problem.softness[:, None] * q.reshape(count, 2)
    by_x = np.zeros((2 * count, problem.size))
    by_x[:, :split] = (slope @ problem.spread).reshape(2 * count, split)
    # u = u0(theta) + q / sqrt(B K): the second part changes the curvature of each point by its own q only.
    by_x[np.arange(2 * count), split + np.arange(2 * count)] = np.repeat(problem.softness, 2)
    # The quaternions are linear in the curvature of each element, and are eliminated. One adjoint sweep from tip to
    # plate gives the gradient of the work through them, for all curvatures at once.
    orientation = orient(mesh, curvature)
    sums = _load_sums(problem, orientation)
    # n.t = Q'(sum n_i T_i) Q with symmetric T_i: its derivative by Q is 2 (sum n_i T_i) Q.
    forms = ((2 * weight[:, None] * sums.ahead[:, FORCE]) @ tangent_forms().reshape(3, 16)).reshape(count, 4, 4)
    first = adjoint(mesh, orientation, (forms @ orientation.stage[:, :, None])[:, :, 0])
    # First and second derivatives of the work by the curvature.
    by_u, by_uu, couples = first.gradient, second_derivative(orientation, first, forms), problem.couples
    if couples is not None:
        turned, turned_slope = moment_work(orientation, weight[:, None] * sums.ahead[:, MOMENT])
        by_u = by_u + turned
        by_uu += turned_slope
    # Torque on the tubes per length: of the cross-section at its own curvature.
    torque = moment - factor * (by_u[:, None, :] @ slope)[:, 0] / weight[:, None]
    softened = stiffness.copy()
    # The load acts on u0(theta), the second derivative of which is diagonal in the angles.
    softened.ravel().reshape(count, n * n)[:, :: n + 1] -= factor * (by_u[:, None, :] @ second)[:, 0] / weight[:, None]
    load_slope, joint_torques, torque_slope = -(by_u.ravel() @ by_x), np.zeros(1), np.zeros((0, len(x)))
    if couples is not None:
        joints, torques = len(couples.joint), couples.torques(orientation)
        load_slope[:split] -= torques @ couples.row
        torque[couples.point, couples.tube[joints:]] -= factor * torques[joints:] / weight[couples.point]
        joint_torques, torque_slope = factor * torques[:joints], couples.torque_slopes(orientation, by_x)
    gradient = x + factor * load_slope
    gradient[:split] += (moment.ravel()[torsion.flat] * torsion.flat_weight) @ torsion.factor
    hessian = _hessian(problem, factor, by_x[:, :split], softened, by_uu)
    # Dead moments have no energy: their torques are in the equations only, and the Jacobian is then not symmetric.
    if couples is not None:
        hessian[:split] -= factor * (couples.row.T @ torque_slope)
    if problem.load.frame == "tip":
        # Virtual work of a load that turns with the tip.
        turn = orientation.turn_slope() @ by_x
        reach = tip_slopes(problem, orientation, by_x)
        wrench_slope = reach.T @ hat(sums.turning[FORCE]) + turn.T @ hat(sums.turning[MOMENT])
        hessian += factor * (wrench_slope @ turn)
    return LoadedState(
        x=x,
        factor=factor,
        theta=theta,
        curvature=curvature,
        energy=float(x @ x) / 2 + float(weight @ coupling[:, 0]),
        work=factor * float(weight @ (problem.force * tangents(orientation.stage)).sum(1))
        if couples is None
        else np.nan,
        gradient=gradient,
        hessian=hessian,
        load_slope=load_slope,
        torque=torque,
        joint_torques=joint_torques,
        torque_slope=torque_slope,
        base_moment=factor * (world_turns() @ orientation.start[0] @ first.base / 2 + sums.base[MOMENT])[:2],
        orientation=orientation,
        curvature_slope=by_x,
    )


def _hessian(problem: LoadedProblem, factor: float, by_z: Array, softened: Array, by_uu: Array) -> Array:
    """Second derivative (U + 2 N, U + 2 N) of the potential energy by x.

    Args:
        by_z: derivative (2 N, U) of the curvature by z.
        softened: derivative (N, n, n) of the torques by the angles, under load.
        by_uu: second derivative (2 N, 2 N) of the work by the curvature.
    """
    split, by_q = problem.torsion.size, np.repeat(-factor * problem.softness, 2)
    by_uz = by_uu @ by_z
    hessian = np.empty((problem.size, problem.size))
    hessian[:split, :split] = torsional_hessian(problem.torsion, softened) - factor * (by_z.T @ by_uz)
    hessian.ravel()[: split * problem.size : problem.size + 1] -= 1.0
    # The derivative of the curvature by q is diagonal.
    hessian[split:, :split] = by_q[:, None] * by_uz
    # Under moments the matrix is not symmetric.
    symmetric = problem.couples is None
    hessian[:split, split:] = hessian[split:, :split].T if symmetric else (by_z.T @ by_uu) * by_q
    hessian[split:, split:] = by_q[:, None] * by_uu * np.repeat(problem.softness, 2)
    hessian.ravel()[:: problem.size + 1] += 1.0
    return hessian


class _LoadSums(NamedTuple):
    """Forces and moments at an orientation of the tip, in world axes."""

    ahead: Array
    """Sum (N, 6) of the loads beyond each point."""
    base: Array
    """Sum (6,) of all."""
    turning: Array
    """Force and moment (6,) at the tip that turn with it."""


def _load_sums(problem: LoadedProblem, orientation: Orientation) -> _LoadSums:
    """Sums of the load, those that turn with the tip included."""
    if problem.load.frame == "world":
        return _LoadSums(problem.ahead, problem.base, np.zeros(6))
    frame = tip_frame(orientation)
    turning = np.concatenate([frame @ problem.load.force, frame @ problem.load.moment])
    return _LoadSums(problem.ahead + turning, problem.base + turning, turning)


def tip_frame(orientation: Orientation) -> Array:
    """Bishop frame (3, 3) of the tip."""
    # CasADi stores by columns.
    return np.asarray(mapped(rotation_matrix_function(), 1)(orientation.start[-1])[0].reshape(3, 3).T.copy())


def tip_slopes(problem: LoadedProblem, orientation: Orientation, curvature_slope: Array) -> Array:
    """Derivative (3, U + 2 N) by x of the tip position."""
    return np.asarray(position_slopes(orientation, problem.torsion.weight) @ curvature_slope)


def tip_position(problem: LoadedProblem, state: LoadedState) -> Array:
    """Position (3,) of the tip, m."""
    return np.asarray(problem.torsion.weight @ tangents(state.orientation.stage))


def symmetric_part(problem: LoadedProblem, state: LoadedState) -> Array:
    """Symmetric part of the linearised equations under a load without an energy, by x and J twists.

    The twists are those by the moments at joints that z does not determine.
    """
    couples = problem.couples
    assert couples is not None
    joints = len(couples.joint)
    turns = map(TubeTurn, couples.tube.tolist(), couples.row, couples.compliance.tolist())
    rest = np.array([couples.rest(turn)[:joints] for turn, _ in zip(turns, range(joints), strict=False)])
    # Twists w at joints with energy w' rest^-1 w / 2, in coordinates where that is the identity.
    size, vectors = np.linalg.eigh(rest)
    root = (vectors * np.sqrt(np.maximum(size, 0.0))) @ vectors.T
    across = -state.factor / 2 * root @ state.torque_slope[:joints]
    # x' A x depends on the symmetric part only: if it is positive in all directions, no small motion gains work.
    symmetric = (state.hessian + state.hessian.T) / 2
    return np.block([[symmetric, across.T], [across, np.eye(joints)]])


def monotonicity(problem: LoadedProblem, state: LoadedState) -> float:
    """Smallest eigenvalue of `symmetric_part`, at most 1; if it is positive, there is no other equilibrium close by."""
    return min(1.0, float(np.linalg.eigvalsh(symmetric_part(problem, state))[0]))


def base_wrench(problem: LoadedProblem, state: LoadedState) -> Array:
    """Force (N) and moment about the centre of the plate (N m) of the load on the plate (6,).

    The bending moment is that of the arm at the plate, the torsional moment the sum over all tubes there.
    """
    force = state.factor * _load_sums(problem, state.orientation).base[FORCE]
    torque = float(state.joint_torques.sum() - problem.torsion.weight @ state.torque.sum(1))
    return np.concatenate([force, state.base_moment, [torque]])


def unknowns(problem: LoadedProblem, rotations: Array, theta: Array, curvature: Array | None = None) -> Array:
    """Unknowns x (U + 2 N,) at rotations theta (N, n) and curvature (N, 2); by default the curvature without load."""
    z = to_unknowns(problem.torsion, rotations, theta)
    count = len(problem.softness)
    if curvature is None:
        return np.concatenate([z, np.zeros(2 * count)])
    torsion = problem.torsion
    collocated = np.empty_like(torsion.moment)
    collocated[:] = rotations
    collocated.ravel()[torsion.flat] += torsion.factor @ z
    natural = section_function("curvature", count, collocated.shape[1], False)(
        collocated + torsion.phase, torsion.stiffness, torsion.moment
    )[0]
    return np.concatenate([z, ((curvature - natural) / problem.softness[:, None]).ravel()])


# --- Whole arm under load ---------------------------------------------------------------------------------------------


def loaded_profile(problem: LoadedProblem, rotations: Array, state: LoadedState) -> Profile:
    """Torsion along all tubes; a torque at a joint twists its tube up to there."""
    torsion, couples = problem.torsion, problem.couples
    profile = integrate(torsion, rotations, state.torque)
    if couples is None:
        return profile
    joint = couples.joint
    return pushed(torsion, profile, joint, couples.tube[: len(joint)], state.joint_torques)


def elastic_energy(problem: LoadedProblem, profile: Profile, state: LoadedState) -> float:
    """Elastic energy of bending and torsion, J.

    Moments twist tubes beyond z, so the torsional energy along the arm replaces z'z / 2.
    """
    z = state.x[: problem.torsion.size]
    return state.energy + torsional_energy(problem.torsion, profile) - float(z @ z) / 2


def loaded_arm(problem: LoadedProblem, profile: Profile, state: LoadedState) -> ArmShape:
    """Shape of the arm from the torsion along it."""
    torsion, mesh = problem.torsion, problem.mesh
    t, elements = mesh.tableau, len(mesh.length)
    sections = sections_along(torsion, profile, tuple(ENDS.tolist()))
    bending = (state.x[torsion.size :].reshape(-1, 2) * problem.softness[:, None]).reshape(elements, t.degree, 2)
    curvature = sections.curvature + t.lagrange(ENDS) @ bending
    position, frame = centreline(mesh, state.orientation, mesh.length)
    return ArmShape(
        arc_length=arc_lengths(mesh),
        rotation=along_elements(sections.rotation, elements).T.copy(),
        torsion=along_elements(sections.torsion, elements).T.copy(),
        curvature=along_elements(curvature, elements),
        position=position,
        frame=frame,
    )


def integration_to(problem: LoadedProblem, s: float) -> Array:
    """Quadrature weights (N,) at the points for integrals from the plate to arc length s, m."""
    mesh = problem.mesh
    degree = mesh.tableau.degree
    (element,), x = mesh.locate(np.array([s]))
    weight = np.where(np.arange(len(problem.softness)) < element * degree, problem.torsion.weight, 0.0)
    weight[element * degree : (element + 1) * degree] = mesh.length[element] * mesh.tableau.lagrange(x, integrals=1)[0]
    return np.asarray(weight)


def compliance(
    problem: LoadedProblem, state: LoadedState, s: float, tube: int, responds: Callable[[Array], Array] | None = None
) -> Array:
    """Compliance (6, 6) at arc length s: translation (m) and rotation (rad) by a dead force (N) and moment (N m) there.

    All are in world axes. The axial part of the moment twists `tube`, whose rotation is that of the compliance. An
    element ends at s. `responds` returns the motion (X, R) by forces (X, R) on the unknowns, where it is not that of
    the Hessian: with contacts that stay closed.
    """
    orientation, weight = state.orientation, integration_to(problem, s)
    element = int(np.searchsorted(problem.mesh.start, s - END))
    tangent = tangents(orientation.start[element][None])[0]
    twist, by_u = tube_turn(problem.torsion, tube, element), position_slopes(orientation, weight)
    slopes = np.concatenate([by_u, orientation.turn_slope(element)]) @ state.curvature_slope
    slopes[3:, : problem.torsion.size] += np.outer(tangent, twist.row)
    response = np.linalg.solve(state.hessian, slopes.T) if responds is None else responds(slopes.T)
    out = slopes @ response
    # Twist by a torque that z does not determine: of the added moment, and of those of the load as the arm turns.
    out[3:, 3:] += twist.rest * np.outer(tangent, tangent)
    if problem.couples is not None:
        out[3:] += state.factor * np.outer(tangent, problem.couples.rest(twist) @ state.torque_slope @ response)
    return np.asarray(out)
