"""The whole arm of tubes made of pieces: what `evaluate_arm` does, with a cross-section of its own at every point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...physics.shape import GAUSS_POINTS, step_function
from ...robots.lengthwise import CrossSections
from ...typing import Array
from .arm import Arm, Profile, along_pieces, arc_lengths, rotations_at, tubes_along
from .buffered import mapped, section_function
from .collocated import STEPS
from .green import reach, sections_at
from .piece import EXTRA_POINTS
from .reduced import Evaluation, ReducedProblem
from .tableau import tableau

SUBSTEPS = 2
"""Steps of the shape from one of its points to the next: the curvature of such arms turns as they go on."""

FINE = ((np.arange(SUBSTEPS * STEPS)[:, None] + GAUSS_POINTS) / (SUBSTEPS * STEPS)).ravel()

SHAPE_RATIO = SUBSTEPS**6 - 1
"""How far a rougher integration, of one step, is off the finer one, over what is wrong with that."""


def _through(nodes: Array, x: Array) -> Array:
    """(X, K) Lagrange's polynomials through nodes (K,) at x (X,)."""
    return np.asarray(np.vander(x, len(nodes)) @ np.linalg.inv(np.vander(nodes, len(nodes))))


ROUGHER = _through(FINE[: 3 * SUBSTEPS] * STEPS, GAUSS_POINTS)
"""(3, 3 SUBSTEPS) what makes of the curvature at the points of finer steps that at the points of the rougher one."""


@dataclass(frozen=True, eq=False)
class _Points:
    """phi (P, X, n) at fractions of every piece, and the cross-sections (P X, n) there."""

    phi: Array
    here: CrossSections

    @property
    def arguments(self) -> tuple[Array, Array, Array]:
        """What the functions of a cross-section take."""
        n = self.phi.shape[2]
        return self.phi.reshape(-1, n) + self.here.phase, self.here.stiffness, self.here.moment


def _points(problem: ReducedProblem, torsion: Profile, x: Array) -> _Points:
    phi = rotations_at(problem, torsion, tuple(x.tolist()))
    return _Points(phi, sections_at(problem.assembly, problem.mesh, x))


def general_arm(problem: ReducedProblem, state: Evaluation, torsion: Profile) -> Arm:
    """Everything along the arm; theta, not phi."""
    mesh, n = problem.mesh, problem.assembly.n_tubes
    pieces = len(mesh.length)
    theta, slope, pull = tubes_along(problem, torsion)
    inside = _points(problem, torsion, FINE)
    count = len(inside.here.stiffness)
    u = section_function("curvature", count, n, False)(*inside.arguments)[0].reshape(pieces, -1, 2).copy()
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
    mesh, n, here = problem.mesh, problem.assembly.n_tubes, problem.here
    assert here is not None
    finer = tableau("gauss", mesh.tableau.degree + EXTRA_POINTS)
    at = _points(problem, torsion, finer.nodes)
    moment, _, bending, *_ = section_function("balance", len(at.here.stiffness), n, False)(*at.arguments)
    shape, h = at.phi.shape, mesh.length[:, None, None]
    gain = h * moment.reshape(shape)
    torque = torsion.twist[:, None] + finer.matrix @ gain
    turned = h * (finer.matrix @ (torque / at.here.torsional_stiffness.reshape(shape)))
    inner = np.abs(torsion.rotation[:, None] + turned - at.phi).max(1)
    gained = np.abs(finer.weights @ gain - h[:, 0] * (mesh.tableau.weights @ torsion.moment))
    wrong = (inner + gained * reach(mesh, here)[1:]).sum(0)
    energy = mesh.length * (bending[:, 0].reshape(shape[:2]) @ finer.weights)
    return float(wrong.max(initial=0.0)), energy
