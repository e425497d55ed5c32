"""From the collocated solution to the whole arm: shape, energy, and what the mesh gets wrong."""

from __future__ import annotations

from functools import lru_cache, reduce
from typing import Any

import casadi as ca
import numpy as np

from ...physics.shape import GAUSS_POINTS, magnus_step, step_function
from ...robots.lengthwise import CrossSections
from ...typing import Array
from .arm import Arm, Profile, along_pieces, arc_lengths, rotations_at, tubes_along
from .buffered import chained, mapped, section_function
from .collocated import ENDS, STEPS, Grid, Torsion, symbols
from .green import reach, sections_at
from .reduced import Evaluation, ReducedProblem
from .tableau import tableau

COARSE_STEPS = 2
"""Steps of the shape per piece of the mesh of the rougher integration that tells the error of the STEPS."""

EXTRA_POINTS = 3
"""Collocation points by which the check of the mesh is finer than the solution."""

SUBSTEPS = 2
"""Steps of the shape from one of its points to the next: the curvature of such arms turns as they go on."""


def gauss_fractions(steps: int) -> Array:
    """(3 steps,) where along a piece so many Magnus steps need the curvature, 0 to 1."""
    return np.asarray(((np.arange(steps)[:, None] + GAUSS_POINTS) / steps).ravel())


FINE = gauss_fractions(SUBSTEPS * STEPS)

ROUGHER = np.vander(GAUSS_POINTS, 3 * SUBSTEPS) @ np.linalg.inv(np.vander(FINE[: 3 * SUBSTEPS] * STEPS))
"""(3, 3 SUBSTEPS) what makes of the curvature at the points of finer steps that at the points of the rougher one."""

SHAPE_RATIO = SUBSTEPS**6 - 1
"""How far a rougher integration, of one step, is off the finer one, over what is wrong with that."""

_HOME = np.tile(np.concatenate([np.eye(3).ravel(), np.zeros(3)]), 2)


def evaluate_arm(problem: ReducedProblem, rotations: Array, state: Evaluation, torsion: Profile) -> Arm:
    """Everything along the arm, from the solved state and its torsion profile."""
    mesh, n = problem.mesh, problem.assembly.n_tubes
    pieces = len(mesh.length)
    if not pieces:
        still, zero = rotations[:, None] + problem.assembly.wound(np.zeros(1)).T, np.zeros((1, 3))
        return Arm(np.zeros(1), still, np.zeros((n, 1)), zero[:, :2], zero, np.eye(3)[None], 0.0, 0.0, 0.0)
    if problem.assembly.general:
        return _general_arm(problem, state, torsion)
    eccentric, t = problem.assembly.eccentric, mesh.tableau
    chain = chained(piece_function(n, eccentric, t.family, t.degree), pieces)
    given = [_HOME, torsion.rotation, torsion.twist, torsion.moment.reshape(-1, n)]
    given += [*problem.on_pieces, problem.assembly.torsional_stiffness, mesh.length[:, None]]
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


@lru_cache(maxsize=32)
def piece_function(n: int, eccentric: bool, family: str, degree: int) -> ca.Function:
    """(poses, theta, w, M/kt, kb, m, kt, h[, (g-1)w, d, phi]) -> (poses, theta, theta', u, R and p, defects, V).

    poses (24,): R by columns and p of the fine and of the coarse integration, where the piece begins and where it ends.
    theta, w (n,) at its beginning; M/kt (n, K) at its collocation points; kb, m (n,) of its section; h its length.
    theta (n, 5), theta' (n, 5), u (2, 5) at the points ENDS, R and p (12, 4) at all but the first.
    defects (n, 2): how far theta inside and the gain of w over the piece are from a quadrature with EXTRA_POINTS more.
    V: bending energy per length at the beginning.
    """
    piece = symbols(Grid(n, family, degree, eccentric))
    t, h = piece.grid.tableau, piece.length
    poses, gain, extra = ca.SX.sym("poses", 24), ca.SX.sym("moment", n, degree), ca.SX.sym("extra", n, degree)
    torsion = Torsion(piece, ca.SX(), gain, extra, ca.SX(), (ca.SX(), ca.SX()))
    inputs = [poses, piece.theta, piece.twist, gain, piece.stiffness, piece.moment, piece.torsional_stiffness, h]
    inputs += [extra, *piece.place] if eccentric else []
    slope = torsion.torsion(ENDS) + (extra @ t.lagrange(ENDS).T if eccentric else 0)
    fine = _integrate(poses[:12], torsion, STEPS)
    coarse = _integrate(poses[12:], torsion, COARSE_STEPS)
    check = tableau("gauss", degree + EXTRA_POINTS)
    theta = torsion.rotation(check.nodes)
    finer = [piece.section(theta[:, k], x) for k, x in enumerate(check.nodes)]
    gained = h * ca.horzcat(*(here.moment / piece.torsional_stiffness for here in finer))
    w = ca.repmat(piece.twist, 1, check.degree) + gained @ check.matrix.T
    stretch = ca.horzcat(*(ca.SX(here.stretch) for here in finer))
    defect = ca.repmat(piece.theta, 1, check.degree) + h * (w * stretch) @ check.matrix.T - theta
    outputs = [
        ca.vertcat(fine[-1], coarse[-1]),
        torsion.rotation(ENDS),
        slope,
        torsion.curvature(ENDS),
        ca.horzcat(*fine),
        ca.horzcat(
            reduce(ca.fmax, ca.horzsplit(ca.fabs(defect))), ca.fabs(gained @ check.weights - h * gain @ t.weights)
        ),
        piece.section(piece.theta, 0.0).bending_energy,
    ]
    return ca.Function("piece", inputs, [ca.densify(out) for out in outputs], {"cse": True})


def _integrate(pose: Any, torsion: Torsion, steps: int) -> list[Any]:
    """Poses (12,) after each Magnus step."""
    u = torsion.curvature(((np.arange(steps)[:, None] + GAUSS_POINTS) / steps).ravel())
    rotation, position = ca.reshape(pose[:9], 3, 3), pose[9:]
    out = []
    for k in range(steps):
        rotation, position = magnus_step(rotation, position, u[:, 3 * k : 3 * k + 3], torsion.piece.length / steps)
        out.append(ca.vertcat(ca.vec(rotation), position))
    return out


# --- tubes made of pieces: a cross-section of its own at every point -------------------------------------------------


def _points(problem: ReducedProblem, torsion: Profile, x: Array) -> tuple[Array, CrossSections, tuple[Array, ...]]:
    """phi (P, X, n) at fractions x of every piece, the cross-sections (P X, n), and what their functions take."""
    phi, here = rotations_at(problem, torsion, tuple(x.tolist())), sections_at(problem.assembly, problem.mesh, x)
    return phi, here, (phi.reshape(-1, phi.shape[2]) + here.phase, here.stiffness, here.moment)


def _general_arm(problem: ReducedProblem, state: Evaluation, torsion: Profile) -> Arm:
    """Everything along the arm; theta, not phi."""
    mesh, n = problem.mesh, problem.assembly.n_tubes
    pieces = len(mesh.length)
    theta, slope, pull = tubes_along(problem, torsion)
    _, _, inside = _points(problem, torsion, FINE)
    u = section_function("curvature", len(inside[0]), n, False)(*inside)[0].reshape(pieces, -1, 2).copy()
    turn, position = (part[::SUBSTEPS] for part in _poses(u, mesh.length / (SUBSTEPS * STEPS)))
    rougher = (ROUGHER @ u.reshape(pieces * STEPS, -1, 2)).reshape(pieces, -1, 2)
    rough = _poses(rougher, mesh.length / STEPS)[1][-1]
    defect, bending = _check(problem, torsion)
    curvature = section_function("curvature", len(pull[0]), n, False)(*pull)[0].copy()
    return Arm(
        arc_length=arc_lengths(mesh),
        rotation=along_pieces(theta, pieces).T,
        torsion=along_pieces(slope, pieces).T,
        curvature=along_pieces(curvature, pieces),
        position=position,
        frame=turn,
        shape_error=float(np.linalg.norm(position[-1] - rough)) / SHAPE_RATIO,
        defect=defect,
        energy=state.energy + float(bending[~mesh.collocated].sum()),
    )


def _poses(u: Array, step: Array) -> tuple[Array, Array]:
    """Frames (m, 3, 3) and positions (m, 3) between steps of lengths (P,) with u (P, 3 steps, 2) at their points."""
    lengths = np.repeat(step, u.shape[1] // 3)[:, None]
    turns, shifts = mapped(step_function(), len(lengths))(u.reshape(-1, 6), lengths)
    turns = turns.reshape(-1, 3, 3).swapaxes(1, 2)
    frame, position = np.empty((len(lengths) + 1, 3, 3)), np.zeros((len(lengths) + 1, 3))
    frame[0] = np.eye(3)
    for k in range(len(lengths)):
        frame[k + 1] = frame[k] @ turns[k]
        position[k + 1] = position[k] + frame[k] @ shifts[k]
    return frame, position


def _check(problem: ReducedProblem, torsion: Profile) -> tuple[float, Array]:
    """What a quadrature with EXTRA_POINTS more says is wrong in phi, rad, and the bending energy (P,) of the pieces."""
    mesh, n = problem.mesh, problem.assembly.n_tubes
    finer = tableau("gauss", mesh.tableau.degree + EXTRA_POINTS)
    phi, at, given = _points(problem, torsion, finer.nodes)
    moment, _, bending, *_ = section_function("balance", len(given[0]), n, False)(*given)
    shape, h = phi.shape, mesh.length[:, None, None]
    gain = h * moment.reshape(shape)
    torque = torsion.twist[:, None] + finer.matrix @ gain
    turned = h * (finer.matrix @ (torque / at.torsional_stiffness.reshape(shape)))
    inner = np.abs(torsion.rotation[:, None] + turned - phi).max(1)
    gained = np.abs(finer.weights @ gain - h[:, 0] * (mesh.tableau.weights @ torsion.moment))
    wrong = (inner + gained * reach(mesh, problem.here)[1:]).sum(0)
    energy = mesh.length * (bending[:, 0].reshape(shape[:2]) @ finer.weights)
    return float(wrong.max(initial=0.0)), energy
