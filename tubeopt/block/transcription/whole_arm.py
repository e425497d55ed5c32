"""From the collocated solution to the whole arm: shape, energy, and what the mesh gets wrong."""

from __future__ import annotations

import numpy as np

from ...typing import Array
from .arm import Arm, Profile, along_pieces, arc_lengths
from .buffered import piece_chain
from .collocated import STEPS
from .general_arm import general_arm
from .piece import COARSE_STEPS
from .reduced import Evaluation, ReducedProblem

_HOME = np.tile(np.concatenate([np.eye(3).ravel(), np.zeros(3)]), 2)


def evaluate_arm(problem: ReducedProblem, rotations: Array, state: Evaluation, torsion: Profile) -> Arm:
    """Everything along the arm, from the solved state and its torsion profile."""
    mesh, n = problem.mesh, problem.assembly.n_tubes
    pieces = len(mesh.length)
    if not pieces:
        still, zero = rotations[:, None].copy(), np.zeros((1, 3))
        return Arm(np.zeros(1), still, np.zeros((n, 1)), zero[:, :2], zero, np.eye(3)[None], 0.0, 0.0, 0.0)
    if problem.here is not None:
        return general_arm(problem, state, torsion)
    eccentric, t = problem.assembly.eccentric, mesh.tableau
    chain = piece_chain(pieces, n, eccentric, t.family, t.degree)
    given = [_HOME, torsion.rotation, torsion.twist, torsion.moment.reshape(-1, n)]
    given += [problem.piece_stiffness, problem.piece_moment]
    given += [problem.assembly.torsional_stiffness, mesh.length[:, None]]
    if eccentric:
        assert torsion.extra is not None
        given += [torsion.extra.reshape(-1, n), problem.assembly.offset, problem.assembly.offset_angle]
    end, theta, slope, u, poses, defects, bending = chain(*given)
    return Arm(
        arc_length=arc_lengths(mesh),
        rotation=along_pieces(theta, pieces).T,
        torsion=along_pieces(slope, pieces).T,
        curvature=along_pieces(u, pieces),
        position=np.concatenate([_HOME[None, 9:12], poses[:, 9:]]),
        frame=np.concatenate([np.eye(3)[None], poses[:, :9].reshape(-1, 3, 3).swapaxes(1, 2)]),
        # Order 6: steps half as long divide the error by 2^6.
        shape_error=float(np.linalg.norm(end[-1, 9:12] - end[-1, 21:])) / ((STEPS / COARSE_STEPS) ** 6 - 1),
        defect=_defect(problem, defects.reshape(pieces, 2, n)) if problem.size else 0.0,
        energy=_energy(problem, torsion, state, bending[:, 0]),
    )


def _energy(problem: ReducedProblem, torsion: Profile, state: Evaluation, bending: Array) -> float:
    """Bending and torsion in front of the plate, and torsion of the transmissions, J."""
    mesh = problem.mesh
    # Where at most one tube is curved, bending does not depend on the rotations: one point tells it.
    energy = state.energy + float(mesh.length @ (bending * ~mesh.collocated))
    if problem.assembly.eccentric:
        energy += _eccentric_torsion(problem, torsion) - 0.5 * float(state.z @ state.z)
    return energy


def _eccentric_torsion(problem: ReducedProblem, torsion: Profile) -> float:
    """int kt g w^2 / 2 with g w^2 = w (w + (g - 1) w), and the transmissions."""
    mesh, kt = problem.mesh, problem.assembly.torsional_stiffness
    w = torsion.twist[:, None, :] + mesh.length[:, None, None] * (mesh.tableau.matrix @ torsion.moment)
    slope = w if torsion.extra is None else w + torsion.extra
    inside = np.einsum("p,k,i,pki,pki->", mesh.length, mesh.tableau.weights, kt, w, slope)
    return 0.5 * float(inside + kt @ (problem.assembly.transmission * torsion.twist[0] ** 2))


def _defect(problem: ReducedProblem, defects: Array) -> float:
    """Bound of what the defects (P, 2, n) of all pieces change in theta: inside each, and by a twist w gained too much,
    which turns all that lies nearer to the base."""
    mesh = problem.mesh
    lever = problem.assembly.transmission + (mesh.start + mesh.length)[:, None]
    wrong = (defects[:, 0] + defects[:, 1] * lever)[mesh.collocated]
    return float(wrong.sum(0).max())
