"""From the collocated solution under load to the whole arm at its shape points."""

from __future__ import annotations

import numpy as np

from ...physics.shape import quaternion_rates, rotation_matrix_function, world_turns
from ...typing import Array
from .arm import ArmShape, Profile, along_pieces, arc_lengths, integrate, pushed, sections_along
from .buffered import mapped
from .collocated import ENDS
from .loaded import LoadedProblem, LoadedState
from .orientation import IDENTITY, tangent_slopes, tangents
from .reduced import row_of


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
    turning = (along.rate @ along.stage[:, :, None] / 2).reshape(pieces, t.degree, 4)
    quaternion = along.begin[:-1, None] + up_to @ turning
    quaternion[:, -1] = along.begin[1:]
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
    shared = (up_to + within) * rate / torsion.weight
    lever = held + shared @ weight
    whole = held + float((weight**2 * rate / torsion.weight).sum())
    row = row_of(torsion, tube, lever)
    return row, whole - float(row @ row)
