"""From the collocated solution to the whole arm: shape, energy, and what the mesh gets wrong."""

from __future__ import annotations

from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from ...physics.shape import GAUSS_POINTS, carry_function
from ...typing import Array
from .arm import Arm, Profile, Sections, along_pieces, arc_lengths, sections_along
from .buffered import chained
from .collocated import ENDS, STEPS
from .green import INWARDS, reach
from .mesh import Mesh
from .reduced import Evaluation, ReducedProblem
from .tableau import Tableau, tableau

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

_HOME = np.concatenate([np.eye(3).ravel(), np.zeros(3)])


def evaluate_arm(problem: ReducedProblem, rotations: Array, state: Evaluation, torsion: Profile) -> Arm:
    """Everything along the arm, from the solved state and its torsion profile; theta with the natural turn."""
    mesh, n = problem.mesh, problem.assembly.n_tubes
    pieces = len(mesh.length)
    if not pieces:
        still, zero = rotations[:, None] + problem.assembly.wound(np.zeros(1)).T, np.zeros((1, 3))
        return Arm(np.zeros(1), still, np.zeros((n, 1)), zero[:, :2], zero, np.eye(3)[None], 0.0, 0.0, 0.0)
    at_ends, finer, *inside = _sections(problem, torsion, steps := _steps(problem))
    length = np.repeat(mesh.length / steps, steps)
    u = np.zeros((pieces, steps.max() * len(GAUSS_POINTS), 2))
    for part in inside:
        own = steps == part.curvature.shape[1] // len(GAUSS_POINTS)
        u[own, : part.curvature.shape[1]] = part.curvature[own]
    u = u.reshape(pieces, -1, len(GAUSS_POINTS), 2)[np.arange(steps.max()) < steps[:, None]]
    turn, position = _poses(u, length)
    rough = _poses(ROUGHER @ u.reshape(-1, 2 * len(GAUSS_POINTS), 2), 2 * length[::2])[1][-1]
    first = np.cumsum(steps) - steps
    ends = np.append(0, (first[:, None] + steps[:, None] // STEPS * np.arange(1, STEPS + 1)).ravel())
    # The energies of the collocated pieces are those that were made least.
    energy = state.energy + float((mesh.length * (finer.bending @ _finer(mesh).weights))[~mesh.collocated].sum())
    if problem.assembly.eccentric:
        energy += _torsion(problem, torsion) - float(state.z @ state.z) / 2
    return Arm(
        arc_length=arc_lengths(mesh),
        rotation=along_pieces(at_ends.rotation, pieces).T,
        torsion=along_pieces(at_ends.torsion, pieces).T,
        curvature=along_pieces(at_ends.curvature, pieces),
        position=position[ends],
        frame=turn[ends],
        shape_error=float(np.linalg.norm(position[-1] - rough)) / SHAPE_RATIO,
        defect=_defect(problem, torsion, finer) if problem.size else 0.0,
        energy=energy,
    )


def _torsion(problem: ReducedProblem, torsion: Profile) -> float:
    """int g t^2 / (2 kt), J, with that of the transmissions."""
    mesh = problem.mesh
    torque = torsion.torque[:, None, :] + mesh.length[:, None, None] * (mesh.tableau.matrix @ torsion.moment)
    slope = torsion.compliance[:, None] * torque + torsion.extra
    inside = np.einsum("p,k,pki,pki->", mesh.length, mesh.tableau.weights, torque, slope)
    return 0.5 * float(inside + problem.here.transmission @ torsion.torque[0] ** 2)


def _steps(problem: ReducedProblem) -> NDArray[np.intp]:
    """(P,) Magnus steps on every piece."""
    mesh = problem.mesh
    steady = problem.assembly.steady(*(mesh.start + mesh.length * x for x in (INWARDS / 2, 1 - INWARDS / 2)))
    return np.where(steady, STEPS, SUBSTEPS * STEPS)


def _finer(mesh: Mesh) -> Tableau:
    """The quadrature by which that of the mesh is checked."""
    return tableau("gauss", mesh.tableau.degree + EXTRA_POINTS)


def _sections(problem: ReducedProblem, torsion: Profile, steps: NDArray[np.intp]) -> list[Sections]:
    """The cross-sections at ENDS, at the points of the finer quadrature, and at those of each number of steps."""
    places = [ENDS, _finer(problem.mesh).nodes, *(gauss_fractions(k) for k in sorted(set(steps.tolist())))]
    whole = sections_along(problem, torsion, tuple(np.concatenate(places).tolist()))
    return [whole.part(b - len(x), b) for x, b in zip(places, accumulate(map(len, places)), strict=True)]


def _poses(u: Array, lengths: Array) -> tuple[Array, Array]:
    """Frames (S + 1, 3, 3) and positions (S + 1, 3) between steps of lengths (S,) with u (S, 3, 2) at their points."""
    poses = chained(carry_function(), len(lengths))(_HOME, u.reshape(-1, 6), lengths[:, None])[0]
    poses = np.concatenate([_HOME[None], poses])
    return poses[:, :9].reshape(-1, 3, 3).swapaxes(1, 2), poses[:, 9:]


def _defect(problem: ReducedProblem, torsion: Profile, here: Sections) -> float:
    """What a quadrature with EXTRA_POINTS more, at cross-sections `here`, says is wrong in theta, rad: inside each
    piece, and by a torque gained too much, which turns all that lies nearer to the base."""
    mesh, finer = problem.mesh, _finer(problem.mesh)
    h = mesh.length[:, None, None]
    gain = h * here.moment
    torque = torsion.torque[:, None] + finer.matrix @ gain
    inner = np.abs(torsion.rotation[:, None] + h * (finer.matrix @ (here.rate * torque)) - here.elastic).max(1)
    gained = np.abs(finer.weights @ gain - h[:, 0] * (mesh.tableau.weights @ torsion.moment))
    return float((inner + gained * reach(mesh, problem.here)[1:]).sum(0).max(initial=0.0))
