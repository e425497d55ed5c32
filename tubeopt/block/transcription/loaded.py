"""The collocated equilibrium of concentric tubes under load: torsion and bending, with the orientation eliminated.

Unknowns are whitened: z of the torsion, as in `reduced`, and q of the bending, two per collocation point,

    theta = alpha + L z,      u = u0(theta) + q / sqrt(B K),      K = sum kb,

u0 being the curvature of the unloaded cross-section. With the force n on the cross-sections, which dead loads fix in
advance, the elastic energy and the work of the load are

    E = z'z / 2 + q'q / 2 + sum B V(theta) - W,      W = sum B n.t(u),

t the tangent from the orientation that u gives. grad E = 0 are the collocated equations of equilibrium, with the
bending moment m = dW/du / B, and the least eigenvalue of the Hessian is the margin. Without load the Hessian is that of
`reduced` beside the identity.

Moments and forces that turn with the tip have no such W: their equations are the same, with what the load does in a
small motion in place of the derivatives of W, and a Jacobian that is not symmetric. With the sum m of the moments ahead
the arm feels B (R'm)_xy beside dW/du, R the frame from the orientation, and each moment twists its tube (`couples`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from ...physics.shape import frame_forms, quaternion_rates, rotation_matrix_function, tangent_forms, world_turns
from ...robots.load import FORCE, MOMENT, Load
from ...robots.order import outermost, twisted_tube
from ...typing import Array, Index
from .arm import ArmShape, Profile, along_pieces, arc_lengths, integrate, pushed, sections_along
from .buffered import mapped, section_function
from .collocated import ENDS
from .mesh import Mesh
from .orientation import IDENTITY, Orientation, adjoint, orient, second_derivative, tangent_slopes, tangents
from .reduced import ReducedProblem, row_of, to_unknowns, torsional_hessian

# --- Dead moments -----------------------------------------------------------------------------------------------------

# What dead moments on a loaded arm twist: the part of them along the arm, which no energy has, and its derivatives.
#
# A moment m of fixed direction acts on tube j, where the arm has the tangent t. In a small motion the frame turns by
# dpsi about world axes, and the tube by dtheta about the tangent. The work is
#
#     m.dpsi + tau dtheta,        tau = m.t.
#
# The first part bends all tubes up to there: `loaded` has it beside that of forces, by the sum of all moments ahead.
# The second twists one tube: at the tip the one that ends last, of several the innermost; elsewhere the outermost one.
# At a joint between pieces m is the moment itself; a moment per length acts at the collocation points, times their
# weights. The work depends on the path, so that the Jacobian is not symmetric.

END = 1e-12
"""Distance (m) within which a moment acts where a tube ends: round-off of a length."""


@dataclass(frozen=True, eq=False)
class Couples:
    """C moments on the tubes of an arm: J at joints between pieces, the tip first, then those at collocation points."""

    along: Array
    """(N, n, 3) moments per length at the collocation points, on the tubes, N."""
    moment: Array
    """(C, 3) world axes, N m; that at the tip in the axes of the load."""
    joint: Index
    """(J,) the piece that begins there; the number of pieces at the tip."""
    point: Index
    """(C - J,) collocation points."""
    tube: Index
    """(C,) on which each acts."""
    row: Array
    """(C, U) turn of the tube there by z."""
    following: bool
    """Whether the moment at the tip turns with it."""
    rest: Array
    """(J, C) turns of the tubes at the joints, by unit torques on all of them, that z does not see, rad/(N m)."""

    def quaternions(self, along: Orientation) -> Array:
        """(C, 4) where the moments act."""
        return np.concatenate([along.begin[self.joint], along.stage[self.point]])

    def torques(self, along: Orientation) -> Array:
        """(C,) tau = m.t."""
        out = (self.moment * tangents(self.quaternions(along))).sum(1)
        if self.following:
            out[0] = self.moment[0, 2]
        return np.asarray(out)

    def torque_slopes(self, along: Orientation, turned: Array) -> Array:
        """(C, U + 2 N) derivative of the torques, with `turned` (2 N, U + 2 N) that of the curvature."""
        slope = np.concatenate([along.begin_slope[self.joint], along.stage_slope[self.point]])
        leaning = (self.moment[:, None] @ tangent_slopes(self.quaternions(along)))[:, 0]
        leaning[:1] *= not self.following
        return np.asarray((leaning[:, None] @ slope)[:, 0] @ turned)


def couples_of(torsion: ReducedProblem, load: Load, per_length: Array, spread: Array) -> Couples:
    """The moments of a load: at the tip, at its points, and `per_length` (N, 3) at the collocation points, N; `spread`
    (N, n, U) is the turn of the tubes there by z."""
    assembly, mesh = torsion.assembly, torsion.mesh
    ahead, ends = torsion.softness
    at = [(part.at, part.moment) for part in load.acting[::-1] if any(part.moment) or part.at == np.inf]
    # The piece that begins there, at the tip the number of pieces.
    joint = np.searchsorted(mesh.start, [s - END for s, _ in at])
    on_joint, point = twisted_tube(assembly.end, [s for s, _ in at]), np.flatnonzero(per_length.any(1))
    tube_there = np.repeat(outermost(assembly.present)[mesh.section], mesh.tableau.degree)
    on_point = tube_there[point]
    tube, lever = np.concatenate([on_joint, on_point]), np.concatenate([ends[joint, on_joint], ahead[point, on_point]])
    rows = [
        # A torque turns its tube up to where it acts, and no farther.
        row_of(torsion, j, np.minimum(ahead[:, j], end))
        for j, end in zip(on_joint.tolist(), lever.tolist(), strict=False)
    ]
    row, count = np.concatenate([rows, spread[point, on_point]]), len(joint)
    whole = np.where(tube[:count, None] == tube, np.minimum(lever[:count, None], lever), 0.0)
    return Couples(
        along=np.where((tube_there[:, None] == np.arange(assembly.n_tubes))[..., None], per_length[:, None], 0.0),
        moment=np.concatenate([[m for _, m in at], (per_length.T * torsion.weight).T[point]]),
        joint=joint,
        point=point,
        tube=tube,
        row=row,
        following=load.frame == "tip",
        # All of int ds / kt between two places, less what L L' has of it at the collocation points.
        rest=whole - row[:count] @ row.T,
    )


@dataclass(frozen=True, eq=False)
class LoadedProblem:
    """Numbers of one robot under one load on one mesh, ready for any rotations; N points, U rotations unknown.

    Attributes:
        torsion: the problem of the rotations, on a mesh all of whose pieces have collocation points.
        load: what pushes.
        ahead: (N, 6) force n, N, and moment m, N m, of what acts beyond the points, in world axes.
        base: (6,) all of that.
        couples: the moments, where the load has no energy.
    """

    torsion: ReducedProblem
    load: Load
    ahead: Array
    base: Array
    couples: Couples | None

    @cached_property
    def force(self) -> Array:
        """(N, 3) n."""
        return np.ascontiguousarray(self.ahead[:, FORCE])

    @property
    def spread(self) -> Array:
        """(N, n, U) rows of L, 0 for tubes that are not unknown at a point."""
        return self.torsion.spread

    @property
    def softness(self) -> Array:
        """(N,) 1 / sqrt(B K)."""
        return self.torsion.bending_softness

    @property
    def tip_tube(self) -> int:
        """The tube that ends last, of several the innermost."""
        return self.torsion.tip_tube

    @property
    def tip_row(self) -> Array:
        """(U,) its rotation at its end by z."""
        return _tip_tube(self.torsion)[0]

    @property
    def tip_rest(self) -> float:
        """Rotation at its end by a unit torque there that z does not see, rad/(N m)."""
        return self.tip_lever - float(self.tip_row @ self.tip_row)

    @property
    def tip_lever(self) -> float:
        """Its whole compliance: rotation at its end by a unit torque there, rad/(N m)."""
        return _tip_tube(self.torsion)[1]

    @property
    def mesh(self) -> Mesh:
        """Pieces of the arm."""
        return self.torsion.mesh

    @cached_property
    def wound(self) -> Array:
        """(N, n) natural turn of the tubes up to the points, rad."""
        return self.torsion.assembly.wound(self.torsion.arc_length)

    @property
    def size(self) -> int:
        """Number of unknowns U + 2 N."""
        return self.torsion.size + 2 * len(self.softness)


@dataclass(frozen=True, eq=False)
class LoadedState:
    """State of a loaded problem.

    x: (U + 2 N,) unknowns z and q.   factor: of the load.   theta (N, n) and curvature (N, 2) at the points.
    energy: elastic energy, J; under moments without the torsion that z does not see.
    work: int n.t ds, what the load does on the arm as it comes from the plate's point, J; NaN without an energy.
    gradient, hessian: of energy less work, or the equations and their Jacobian for loads without an energy.
    pull: (U + 2 N,) derivative of the gradient by the factor.
    torque: (N, n) torque per length on each tube, N.   joint_torques: (J,) of the moments at joints, N m.
    twisted: (C, U + 2 N) derivative of the torques of all moments.
    base_moment: (2,) bending moment at the plate, N m.   turned: (2 N, U + 2 N) du/dx.
    """

    x: Array
    factor: float
    theta: Array
    curvature: Array
    energy: float
    work: float
    gradient: Array
    hessian: Array
    pull: Array
    torque: Array
    joint_torques: Array
    twisted: Array
    base_moment: Array
    orientation: Orientation
    turned: Array

    @property
    def potential(self) -> float:
        """Energy less work, J: what dead loads make least."""
        return self.energy - self.work


@dataclass(frozen=True, eq=False)
class Loading:
    """A load on an assembly whose sections end where the load jumps.

    Attributes:
        load: as given.   density: (n,) mass per length of the tubes, kg/m.
        counts: (m,) least number of pieces of each section.
    """

    load: Load
    density: Array
    counts: Index


def load_problem(torsion: ReducedProblem, load: Load, density: Array) -> LoadedProblem:
    """Set up a problem; `density` (n,) is the mass per length of the tubes, kg/m."""
    along = _per_length(torsion.mesh, load, torsion.assembly.present @ density)
    couples = None if load.has_energy else couples_of(torsion, load, along[..., MOMENT].reshape(-1, 3), torsion.spread)
    return LoadedProblem(torsion, load, *_ahead(torsion.mesh, load, along), couples)


@lru_cache(maxsize=64)
def _tip_tube(torsion: ReducedProblem) -> tuple[Array, float]:
    """Rotation of the tube that ends last at its end: (U,) by z, and by a unit torque there, rad/(N m)."""
    tip = torsion.tip_tube
    lever, ends = torsion.softness
    return row_of(torsion, tip, lever[:, tip]), float(ends[-1, tip])


def _per_length(mesh: Mesh, load: Load, mass: Array) -> Array:
    """(P, K, 6) force, N/m, and moment, N, per length at the points, in world axes; `mass` (m,) per length of each
    section, kg/m."""
    along = load.per_length(mesh.start[:, None] + mesh.length[:, None] * mesh.tableau.nodes)
    if load.gravity is not None:
        along[..., FORCE] += mass[mesh.section][:, None, None] * np.array(load.gravity)
    return along


def _ahead(mesh: Mesh, load: Load, along: Array) -> tuple[Array, Array]:
    """Force and moment (N, 6) of what acts beyond the points, and (6,) beyond the plate, of loads in world axes;
    `along` (P, K, 6) is what there is per length."""
    s = mesh.start[:, None] + mesh.length[:, None] * mesh.tableau.nodes
    out, base = np.zeros((*s.shape, 6)), np.zeros(6)
    if along.any():
        h, t = mesh.length[:, None, None], mesh.tableau
        whole = (h * along * t.weights[:, None]).sum(1)
        ahead = np.cumsum(whole[::-1], axis=0)[::-1]
        # From each point to the end of its piece, then the pieces ahead.
        out, base = h * ((t.weights - t.matrix) @ along) + (ahead - whole)[:, None], ahead[0].copy()
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
    bend, moment, stiff, natural, slope, second = section_function("bending", count, n, False)(
        theta + torsion.phase, torsion.stiffness, torsion.moment
    )
    # CasADi stores by columns: (N, n, 2).
    slope, second = (part.reshape(count, n, 2).swapaxes(1, 2) for part in (slope, second))
    curvature = natural + problem.softness[:, None] * q.reshape(count, 2)
    turned = np.zeros((2 * count, problem.size))
    turned[:, :split] = (slope @ problem.spread).reshape(2 * count, split)
    # u = u0(theta) + q / sqrt(B K): the second part turns each point by its own q only.
    turned[np.arange(2 * count), split + np.arange(2 * count)] = np.repeat(problem.softness, 2)
    # The quaternions are linear in the curvature of each piece, so that they are eliminated. One adjoint sweep from the
    # tip to the plate gives what they add to the gradient of the work, for all curvatures at once.
    along = orient(mesh, curvature)
    push = _push(problem, along)
    # n.t = Q'(sum n_i T_i) Q with symmetric T_i: its derivative by Q is 2 (sum n_i T_i) Q.
    forms = ((2 * weight[:, None] * push.ahead[:, FORCE]) @ tangent_forms().reshape(3, 16)).reshape(count, 4, 4)
    swept = adjoint(mesh, along, (forms @ along.stage[:, :, None])[:, :, 0])
    felt, work, couples = swept.gradient, second_derivative(along, swept, forms), problem.couples
    if couples is not None:
        bending = (weight[:, None] * push.ahead[:, MOMENT]) @ frame_forms()[:, :2].reshape(3, 32)
        leaning = (bending.reshape(count, 8, 4) @ along.stage[:, :, None]).reshape(count, 2, 4)
        felt = felt + (leaning @ along.stage[:, :, None])[:, :, 0]
        work += (2 * leaning @ along.stage_slope).reshape(2 * count, 2 * count)
    # Torque on the tubes per length: of the cross-section at its own curvature.
    torque = moment - factor * (felt[:, None, :] @ slope)[:, 0] / weight[:, None]
    softened = stiff.copy()
    # The load pulls at u0(theta), whose second derivative is diagonal in the angles.
    softened.ravel().reshape(count, n * n)[:, :: n + 1] -= factor * (felt[:, None, :] @ second)[:, 0] / weight[:, None]
    pull, joint_torques, twisted = -(felt.ravel() @ turned), np.zeros(1), np.zeros((0, len(x)))
    if couples is not None:
        joints, twisting = len(couples.joint), couples.torques(along)
        pull[:split] -= twisting @ couples.row
        torque[couples.point, couples.tube[joints:]] -= factor * twisting[joints:] / weight[couples.point]
        joint_torques, twisted = factor * twisting[:joints], couples.torque_slopes(along, turned)
    gradient = x + factor * pull
    gradient[:split] += (moment.ravel()[torsion.flat] * torsion.flat_weight) @ torsion.factor
    hessian = _hessian(problem, factor, turned[:, :split], softened, work)
    # Dead moments have no energy: their torques enter the equations only, whose Jacobian is then not symmetric.
    if couples is not None:
        hessian[:split] -= factor * (couples.row.T @ twisted)
    if problem.load.frame == "tip":
        hessian -= factor * _following(problem, along, push, turned)
    return LoadedState(
        x=x,
        factor=factor,
        theta=theta,
        curvature=curvature,
        energy=float(x @ x) / 2 + float(weight @ bend[:, 0]),
        work=factor * float(weight @ (problem.force * tangents(along.stage)).sum(1)) if couples is None else np.nan,
        gradient=gradient,
        hessian=hessian,
        pull=pull,
        torque=torque,
        joint_torques=joint_torques,
        twisted=twisted,
        base_moment=factor * (world_turns() @ along.begin[0] @ swept.base / 2 + push.base[MOMENT])[:2],
        orientation=along,
        turned=turned,
    )


def _hessian(problem: LoadedProblem, factor: float, by_tubes: Array, softened: Array, work: Array) -> Array:
    """(U + 2 N, U + 2 N) second derivative of the potential energy, of dM/dtheta (N, n, n) less what the load makes of
    it, and of that of the load by the curvature (2 N, 2 N), which `by_tubes` (2 N, U) is changed by the tubes."""
    split, by_bending = problem.torsion.size, np.repeat(-factor * problem.softness, 2)
    felt_by_tubes = work @ by_tubes
    hessian = np.empty((problem.size, problem.size))
    hessian[:split, :split] = torsional_hessian(problem.torsion, softened) - factor * (by_tubes.T @ felt_by_tubes)
    hessian.ravel()[: split * problem.size : problem.size + 1] -= 1.0
    # What bending turns is diagonal.
    hessian[split:, :split] = by_bending[:, None] * felt_by_tubes
    # Of moments the matrix is not symmetric.
    alike = problem.couples is None
    hessian[:split, split:] = hessian[split:, :split].T if alike else (by_tubes.T @ work) * by_bending
    hessian[split:, split:] = by_bending[:, None] * work * np.repeat(problem.softness, 2)
    hessian.ravel()[:: problem.size + 1] += 1.0
    return hessian


@dataclass(frozen=True, eq=False)
class _Push:
    """The whole load at an orientation of the tip, in world axes: force and moment beyond the points, `ahead` (N, 6),
    and beyond the plate, `base` (6,); `turning` (6,) at the tip, which turns with it."""

    ahead: Array
    base: Array
    turning: Array


def _push(problem: LoadedProblem, along: Orientation) -> _Push:
    if problem.load.frame == "world":
        return _Push(problem.ahead, problem.base, np.zeros(6))
    frame = tip_frame(along)
    turning = np.concatenate([frame @ problem.load.force, frame @ problem.load.moment])
    return _Push(problem.ahead + turning, problem.base + turning, turning)


def _following(problem: LoadedProblem, along: Orientation, push: _Push, turned: Array) -> Array:
    """(U + 2 N, U + 2 N) what a load that turns with the tip adds to the derivative of what the load does."""
    reach, turn = _tip(problem, along, turned)
    return -(reach.T @ _cross(push.turning[FORCE]) + turn.T @ _cross(push.turning[MOMENT])) @ turn


def _cross(a: Array) -> Array:
    """(3, 3) matrix of b -> a x b."""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def tip_frame(along: Orientation) -> Array:
    """(3, 3) Bishop frame of the tip."""
    return np.array(rotation_matrix_function()(along.begin[-1]))


def _tip(problem: LoadedProblem, along: Orientation, turned: Array) -> tuple[Array, Array]:
    """(3, U + 2 N) change of the tip's position, and turn of its Bishop frame about world axes."""
    count = len(along.stage)
    moved = tangent_slopes(along.stage) @ along.stage_slope
    # The tip is int t ds: its change is the sum of those of the tangents with the weights.
    reach = (problem.torsion.weight @ moved.reshape(count, -1)).reshape(3, -1) @ turned
    turn = 2 * (world_turns() @ along.begin[-1]) @ along.begin_slope[-1] @ turned
    return reach, turn


def tip_slopes(problem: LoadedProblem, state: LoadedState) -> Array:
    """(6, U + 2 N) change of the tip's position, and turn of the tube that ends last, about world axes."""
    reach, turn = _tip(problem, state.orientation, state.turned)
    turn[:, : len(problem.tip_row)] += np.outer(tip_frame(state.orientation)[:, 2], problem.tip_row)
    return np.concatenate([reach, turn])


def tip_position(problem: LoadedProblem, state: LoadedState) -> Array:
    """(3,) position of the tip, m."""
    return np.asarray(problem.torsion.weight @ tangents(state.orientation.stage))


def compliance(problem: LoadedProblem, state: LoadedState) -> Array:
    """(6, 6) translation (m) and rotation (rad) of the tip by a dead force (N) and moment (N m) there, world axes."""
    slopes = tip_slopes(problem, state)
    answer = np.linalg.solve(state.hessian, slopes.T)
    out = slopes @ answer
    # What z does not see of the twist by a torque at the tip: by the new moment, and by the old one as the tip turns.
    tangent = tip_frame(state.orientation)[:, 2]
    out[3:, 3:] += problem.tip_rest * np.outer(tangent, tangent)
    if problem.couples is not None:
        out[3:] += state.factor * np.outer(tangent, problem.couples.rest[0] @ state.twisted @ answer)
    return np.asarray(out)


def symmetric_part(problem: LoadedProblem, state: LoadedState) -> Array:
    """The symmetric part of the linearised equations under a load without an energy, by x and by J twists: those that
    moments at joints make of their tubes and no z does."""
    couples = problem.couples
    assert couples is not None
    joints = len(couples.joint)
    # Twists w at joints with energy w' rest^-1 w / 2, in coordinates where that is the identity.
    size, vectors = np.linalg.eigh(couples.rest[:, :joints])
    root = (vectors * np.sqrt(np.maximum(size, 0.0))) @ vectors.T
    across = -state.factor / 2 * root @ state.twisted[:joints]
    # x' A x has the symmetric part only: above 0 in all directions no small motion gains work.
    both = (state.hessian + state.hessian.T) / 2
    return np.block([[both, across.T], [across, np.eye(joints)]])


def monotonicity(problem: LoadedProblem, state: LoadedState) -> float:
    """Least eigenvalue of the symmetric part of the linearised equations, at most 1, where the load has no energy:
    above 0 there is no other equilibrium close by."""
    return min(1.0, float(np.linalg.eigvalsh(symmetric_part(problem, state))[0]))


def base_wrench(problem: LoadedProblem, state: LoadedState) -> Array:
    """(6,) force (N) and moment about the plate's point (N m) that the load puts on the plate.

    The moment in bending is that which bends the arm at the plate, the moment in torsion that of all tubes there.
    """
    force = state.factor * _push(problem, state.orientation).base[FORCE]
    torque = float(state.joint_torques.sum() - problem.torsion.weight @ state.torque.sum(1))
    return np.concatenate([force, state.base_moment, [torque]])


def unknowns(problem: LoadedProblem, rotations: Array, theta: Array, curvature: Array | None = None) -> Array:
    """x (U + 2 N,) of rotations theta (N, n) and curvature (N, 2) at the points; by default that without load."""
    z = to_unknowns(problem.torsion, rotations, theta)
    count = len(problem.softness)
    if curvature is None:
        return np.concatenate([z, np.zeros(2 * count)])
    torsion = problem.torsion
    full = np.empty_like(torsion.moment)
    full[:] = rotations
    full.ravel()[torsion.flat] += torsion.factor @ z
    natural = section_function("curvature", count, full.shape[1], False)(
        full + torsion.phase, torsion.stiffness, torsion.moment
    )[0]
    return np.concatenate([z, ((curvature - natural) / problem.softness[:, None]).ravel()])


# --- Whole arm under load ---------------------------------------------------------------------------------------------


def loaded_profile(problem: LoadedProblem, rotations: Array, state: LoadedState) -> Profile:
    """theta_i(s) of all tubes; a torque at a joint twists its tube up to there."""
    torsion, couples = problem.torsion, problem.couples
    profile = integrate(torsion, rotations, state.torque)
    if couples is None:
        return profile
    joint = couples.joint
    return pushed(torsion, profile, joint, couples.tube[: len(joint)], state.joint_torques)


def elastic_energy(problem: LoadedProblem, profile: Profile, state: LoadedState) -> float:
    """Of bending and torsion, J. Moments twist tubes as no z does: torsion has half of int t^2 / kt."""
    torsion, mesh = problem.torsion, problem.mesh
    t, rate = mesh.tableau, torsion.here.rate
    torque = profile.torque[:, None] + mesh.length[:, None, None] * (t.adjoint @ profile.moment)
    inside = np.einsum("p,k,pki->", mesh.length, t.weights, rate * torque**2)
    z = state.x[: torsion.size]
    return state.energy + float(inside + torsion.here.transmission @ profile.torque[0] ** 2 - z @ z) / 2


def loaded_arm(problem: LoadedProblem, profile: Profile, state: LoadedState) -> ArmShape:
    """Everything along the arm, from the torsion along it."""
    torsion, mesh = problem.torsion, problem.mesh
    t, pieces = mesh.tableau, len(mesh.length)
    here = sections_along(torsion, profile, tuple(ENDS.tolist()))
    bent = (state.x[torsion.size :].reshape(-1, 2) * problem.softness[:, None]).reshape(pieces, t.degree, 2)
    curvature = here.curvature + t.lagrange(ENDS) @ bent
    along, up_to = state.orientation, mesh.length[:, None, None] * t.lagrange(ENDS, integrals=1)
    # Q' = (u_x Omega_x + u_y Omega_y) Q / 2 at the points, integrated by their polynomial.
    turning = (along.rate @ along.stage[:, :, None] / 2).reshape(pieces, t.degree, 4)
    quaternion = along.begin[:-1, None] + up_to @ turning
    quaternion[:, -1] = along.begin[1:]
    # Collocation keeps the norm at the ends of pieces only; between them it is off by its error.
    quaternion /= np.linalg.norm(quaternion, axis=2, keepdims=True)
    moved = up_to @ tangents(along.stage).reshape(pieces, t.degree, 3)
    begun = np.cumsum(np.concatenate([np.zeros((1, 3)), moved[:-1, -1]]), axis=0)
    frame = mapped(rotation_matrix_function(), pieces * len(ENDS))(quaternion.reshape(-1, 4))[0]
    return ArmShape(
        arc_length=arc_lengths(mesh),
        rotation=along_pieces(here.rotation, pieces).T.copy(),
        torsion=along_pieces(here.torsion, pieces).T.copy(),
        curvature=along_pieces(curvature, pieces),
        position=along_pieces(begun[:, None] + moved, pieces),
        frame=along_pieces(frame, pieces).reshape(-1, 3, 3).swapaxes(1, 2).copy(),
    )


def integration_to(problem: LoadedProblem, s: float) -> Array:
    """(N,) weights by which values at the points are integrated from the plate to arc length s, m."""
    mesh = problem.mesh
    degree = mesh.tableau.degree
    (piece,), x = mesh.places(np.array([s]))
    weight = np.where(np.arange(len(problem.softness)) < piece * degree, problem.torsion.weight, 0.0)
    weight[piece * degree : (piece + 1) * degree] = mesh.length[piece] * mesh.tableau.lagrange(x, integrals=1)[0]
    return np.asarray(weight)


def position_slopes(problem: LoadedProblem, state: LoadedState, s: float) -> tuple[Array, Array]:
    """(3,) position at arc length s, m, and (3, U + 2 N) its change."""
    along, weight = state.orientation, integration_to(problem, s)
    moved = weight @ (tangent_slopes(along.stage) @ along.stage_slope).reshape(len(weight), -1)
    return weight @ tangents(along.stage), moved.reshape(3, -1) @ state.turned


def compliance_along(problem: LoadedProblem, state: LoadedState, s: float, tube: int) -> Array:
    """(6, 6) translation (m) and rotation (rad) at arc length s by a dead force (N) and moment (N m) there, world axes;
    the moment's part along the arm turns `tube`, and it is that tube's rotation."""
    torsion, along, weight = problem.torsion, state.orientation, integration_to(problem, s)
    turned = np.einsum("k,krc,kc->r", weight, along.rate, along.stage) / 2
    quaternion = IDENTITY + turned
    slope = np.einsum("k,krc,kcj->rj", weight, along.rate, along.stage_slope) / 2
    # Product rule of rate(u) Q / 2: by Q above, by u here.
    own = np.einsum("k,jrc,kc->rkj", weight, quaternion_rates(), along.stage) / 2
    slope = (slope + own.reshape(4, -1)) @ state.turned
    turn = 2 * (world_turns() @ quaternion) @ slope
    tangent = np.array(rotation_matrix_function()(quaternion / np.linalg.norm(quaternion)))[:, 2]
    row, rest = _twist(problem, weight, tube)
    turn[:, : torsion.size] += np.outer(tangent, row)
    slopes = np.concatenate([position_slopes(problem, state, s)[1], turn])
    out = slopes @ np.linalg.solve(state.hessian, slopes.T)
    out[3:, 3:] += rest * np.outer(tangent, tangent)
    return np.asarray(out)


def _twist(problem: LoadedProblem, weight: Array, tube: int) -> tuple[Array, float]:
    """(U,) rotation of a tube at a place by z, and its compliance that z does not see, rad/(N m)."""
    torsion, mesh = problem.torsion, problem.mesh
    rate, held, t = torsion.here.rate[:, :, tube].ravel(), torsion.here.transmission[tube], mesh.tableau
    piece = np.repeat(np.arange(len(mesh.length)), t.degree)
    up_to = np.where(piece < piece[:, None], torsion.weight, 0.0)
    within = np.kron(np.diag(mesh.length), t.matrix)
    # Row of the Green's function to the place s: int to the nearer of point and s.
    shared = (up_to + within) * rate / torsion.weight
    lever = held + shared @ weight
    whole = held + float((weight**2 * rate / torsion.weight).sum())
    row = row_of(torsion, tube, lever)
    return row, whole - float(row @ row)
