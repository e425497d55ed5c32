"""From the collocated solution under load to the whole arm at its shape points."""

from __future__ import annotations

import numpy as np

from ...physics.shape import rotation_matrix_function
from ...robots.lengthwise import CrossSections
from ...typing import Array
from .arm import ArmShape, Profile, along_pieces, arc_lengths, integrate, integrate_torque, rotations_at
from .buffered import mapped, section_function
from .collocated import ENDS
from .green import reach, sections_at
from .loaded import LoadedProblem, LoadedState
from .orientation import tangents
from .reduced import ReducedProblem


def loaded_profile(problem: LoadedProblem, rotations: Array, state: LoadedState) -> Profile:
    """theta_i(s) of all tubes; a torque at the tip twists the tube that ends last all along."""
    torsion = problem.torsion
    assembly, mesh, tip = torsion.assembly, torsion.mesh, problem.tip_tube
    if torsion.here is not None:
        profile = integrate_torque(torsion, rotations, state.torque)
        assert profile.slope is not None
        assert profile.compliance is not None
        profile.twist[:, tip] += state.tip_torque
        profile.rotation[:, tip] += state.tip_torque * reach(mesh, torsion.here)[:-1, tip]
        even = torsion.here.rate[:, :, tip] - profile.compliance[:, None, tip]
        profile.slope[:, :, tip] += state.tip_torque * even
        return profile
    profile = integrate(mesh, rotations, assembly.transmission, state.torque / assembly.torsional_stiffness)
    twist = state.tip_torque / assembly.torsional_stiffness[tip]
    profile.twist[:, tip] += twist
    profile.rotation[:, tip] += twist * (assembly.transmission[tip] + mesh.start)
    return profile


def loaded_arm(problem: LoadedProblem, rotations: Array, state: LoadedState) -> ArmShape:
    """Everything along the arm."""
    torsion, mesh = problem.torsion, problem.mesh
    t, pieces, n = mesh.tableau, len(mesh.length), len(rotations)
    profile = loaded_profile(problem, rotations, state)
    theta, slope, pull = _tubes(torsion, profile)
    bent = (state.x[torsion.size :].reshape(-1, 2) * problem.softness[:, None]).reshape(pieces, t.degree, 2)
    natural = section_function("curvature", len(pull[0]), n, False)(*pull)[0]
    curvature = natural.reshape(pieces, len(ENDS), 2) + t.lagrange(ENDS) @ bent
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
        rotation=along_pieces(theta, pieces).T.copy(),
        torsion=along_pieces(slope, pieces).T.copy(),
        curvature=along_pieces(curvature, pieces),
        position=along_pieces(begun[:, None] + moved, pieces),
        frame=along_pieces(frame, pieces).reshape(-1, 3, 3).swapaxes(1, 2).copy(),
    )


def shape_sections(torsion: ReducedProblem) -> CrossSections:
    """(P 5, n) cross-sections at the shape points of every piece, seen from inside it."""
    assembly, mesh, count = torsion.assembly, torsion.mesh, len(ENDS)
    if torsion.here is not None:
        return sections_at(assembly, mesh, ENDS)
    kb, m = (np.repeat(table, count, axis=0) for table in (torsion.piece_stiffness, torsion.piece_moment))
    none = np.zeros_like(kb)
    return CrossSections(kb, m, none, np.broadcast_to(assembly.torsional_stiffness, kb.shape), none, none)


def _tubes(torsion: ReducedProblem, profile: Profile) -> tuple[Array, Array, tuple[Array, Array, Array]]:
    """theta and theta' (P, 5, n) at the shape points, and what the functions of a cross-section take there."""
    theta, n, mesh = rotations_at(torsion, profile, tuple(ENDS.tolist())), torsion.assembly.n_tubes, torsion.mesh
    here = shape_sections(torsion)
    inside = mesh.length[:, None, None] * (mesh.tableau.lagrange(ENDS, integrals=1) @ profile.moment)
    slope = (profile.twist[:, None] + inside).reshape(-1, n)
    if torsion.here is not None:
        slope = slope / here.torsional_stiffness
    pull = (theta.reshape(-1, n) + here.phase, here.stiffness, here.moment)
    return theta + here.wound.reshape(theta.shape), (slope + here.twist).reshape(theta.shape), pull
