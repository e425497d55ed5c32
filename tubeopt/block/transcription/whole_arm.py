"""From the collocated solution to the whole arm: shape, energy, and what the mesh gets wrong."""

from __future__ import annotations

from functools import lru_cache, reduce
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ...physics.shape import GAUSS_POINTS, carry_function, magnus_step
from ...robots.lengthwise import CrossSections
from ...typing import Array
from .arm import Arm, Profile, along_pieces, arc_lengths, rotations_at, tubes_along
from .buffered import chained, section_function
from .collocated import ENDS, STEPS, Grid, Torsion, symbols
from .green import INWARDS, reach, sections_at
from .reduced import Evaluation, ReducedProblem
from .tableau import tableau

COARSE_STEPS = STEPS // 2
"""Steps of the shape per piece of the mesh of the rougher integration that tells the error of the STEPS."""

EXTRA_POINTS = 3
"""Collocation points by which the check of the mesh is finer than the solution."""

SUBSTEPS = 2
"""Steps of the shape from one of its points to the next where tubes vary along a piece: there the curvature turns as it
goes on."""


def gauss_fractions(steps: int) -> Array:
    """(3 steps,) where along a piece so many Magnus steps need the curvature, 0 to 1."""
    return np.asarray(((np.arange(steps)[:, None] + GAUSS_POINTS) / steps).ravel())


ROUGHER = np.vander(GAUSS_POINTS, 6) @ np.linalg.inv(np.vander(gauss_fractions(2)))
"""(3, 6) what makes of the curvature at the points of two steps that at the points of one step for both."""

SHAPE_RATIO = (STEPS // COARSE_STEPS) ** 6 - 1
"""How far the rougher integration, of order 6, is off the finer one, over what is wrong with that."""

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
    kt = problem.assembly.torsional_stiffness
    given = [_HOME, torsion.rotation, torsion.torque / kt, (torsion.moment / kt).reshape(-1, n)]
    given += [*problem.on_pieces, kt, mesh.length[:, None]]
    if eccentric:
        given += [torsion.extra.reshape(-1, n), problem.assembly.offset, problem.assembly.offset_angle]
    end, theta, slope, u, poses, defects, bending = chain(*given)
    return Arm(
        arc_length=arc_lengths(mesh),
        rotation=along_pieces(theta, pieces).T,
        torsion=along_pieces(slope, pieces).T,
        curvature=along_pieces(u, pieces),
        position=np.concatenate([_HOME[None, 9:12], poses[:, 9:]]),
        frame=np.concatenate([np.eye(3)[None], poses[:, :9].reshape(-1, 3, 3).swapaxes(1, 2)]),
        shape_error=float(np.linalg.norm(end[-1, 9:12] - end[-1, 21:])) / SHAPE_RATIO,
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
    """int g t^2 / (2 kt) with g t / kt = t / kt + (g - 1) w, and the transmissions."""
    mesh, rate = problem.mesh, problem.here.rate
    torque = torsion.torque[:, None, :] + mesh.length[:, None, None] * (mesh.tableau.matrix @ torsion.moment)
    inside = np.einsum("p,k,pki,pki->", mesh.length, mesh.tableau.weights, torque, rate * torque + torsion.extra)
    return 0.5 * float(inside + problem.here.transmission @ torsion.torque[0] ** 2)


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
    turned = torsion.rotation(ENDS)
    ends = [piece.section(turned[:, k], x) for k, x in enumerate(ENDS)]
    slope = torsion.torsion(ENDS) * ca.horzcat(*(ca.SX(here.stretch) for here in ends))
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
        turned,
        slope,
        ca.horzcat(*(here.curvature for here in ends)),
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
    steps, u = _steps(problem, torsion)
    length = np.repeat(mesh.length / steps, steps)
    turn, position = _poses(u, length)
    rough = _poses(ROUGHER @ u.reshape(-1, 6, 2), 2 * length[::2])[1][-1]
    first = np.cumsum(steps) - steps
    ends = np.append(0, (first[:, None] + steps[:, None] // STEPS * np.arange(1, STEPS + 1)).ravel())
    defect, bending = _check(problem, torsion)
    curvature = section_function("curvature", len(pull[0]), n, False)(*pull)[0].copy()
    return Arm(
        arc_length=arc_lengths(mesh),
        rotation=along_pieces(theta, pieces).T,
        torsion=along_pieces(slope, pieces).T,
        curvature=along_pieces(curvature, pieces),
        position=position[ends],
        frame=turn[ends],
        shape_error=float(np.linalg.norm(position[-1] - rough)) / SHAPE_RATIO,
        defect=defect,
        energy=state.energy + float(bending[~mesh.collocated].sum()),
    )


def _steps(problem: ReducedProblem, torsion: Profile) -> tuple[NDArray[np.intp], Array]:
    """(P,) Magnus steps on every piece, and the curvature (S, 3, 2) at the points of all of them."""
    mesh, assembly = problem.mesh, problem.assembly
    assert assembly.lengthwise is not None
    ends = (
        mesh.start[:, None] + mesh.length[:, None] * x + assembly.transmission for x in (INWARDS / 2, 1 - INWARDS / 2)
    )
    steady, size = assembly.lengthwise.steady(*ends), SUBSTEPS * STEPS
    u, used = np.zeros((len(steady), size, 3, 2)), np.ones((len(steady), size), dtype=bool)
    used[steady, STEPS:] = False
    for these, steps in ((steady, STEPS), (~steady, size)):
        if these.any():
            _, _, inside = _points(problem, torsion, gauss_fractions(steps))
            at = section_function("curvature", len(inside[0]), assembly.n_tubes, False)(*inside)[0]
            u[these, :steps] = at.reshape(len(steady), steps, 3, 2)[these]
    return used.sum(1), u[used]


def _poses(u: Array, lengths: Array) -> tuple[Array, Array]:
    """Frames (S + 1, 3, 3) and positions (S + 1, 3) between steps of lengths (S,) with u (S, 3, 2) at their points."""
    poses = chained(carry_function(), len(lengths))(_HOME[:12], u.reshape(-1, 6), lengths[:, None])[0]
    poses = np.concatenate([_HOME[None, :12], poses])
    return poses[:, :9].reshape(-1, 3, 3).swapaxes(1, 2), poses[:, 9:]


def _check(problem: ReducedProblem, torsion: Profile) -> tuple[float, Array]:
    """What a quadrature with EXTRA_POINTS more says is wrong in phi, rad, and the bending energy (P,) of the pieces."""
    mesh, n = problem.mesh, problem.assembly.n_tubes
    finer = tableau("gauss", mesh.tableau.degree + EXTRA_POINTS)
    phi, at, given = _points(problem, torsion, finer.nodes)
    moment, _, bending, *_ = section_function("balance", len(given[0]), n, False)(*given)
    shape, h = phi.shape, mesh.length[:, None, None]
    gain = h * moment.reshape(shape)
    torque = torsion.torque[:, None] + finer.matrix @ gain
    turned = h * (finer.matrix @ (torque / at.torsional_stiffness.reshape(shape)))
    inner = np.abs(torsion.rotation[:, None] + turned - phi).max(1)
    gained = np.abs(finer.weights @ gain - h[:, 0] * (mesh.tableau.weights @ torsion.moment))
    wrong = (inner + gained * reach(mesh, problem.here)[1:]).sum(0)
    energy = mesh.length * (bending[:, 0].reshape(shape[:2]) @ finer.weights)
    return float(wrong.max(initial=0.0)), energy
