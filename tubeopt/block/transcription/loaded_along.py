"""How a loaded arm gives way at any place along it."""

from __future__ import annotations

import numpy as np
import scipy

from ...physics.shape import quaternion_rates, rotation_matrix_function, world_turns
from ...typing import Array
from .loaded import LoadedProblem, LoadedState, compliances
from .orientation import IDENTITY, tangent_slopes, tangents


def integration_to(problem: LoadedProblem, s: float) -> Array:
    """(N,) weights by which values at the points are integrated from the plate to arc length s, m."""
    mesh = problem.mesh
    degree = mesh.tableau.degree
    piece = int(np.clip(np.searchsorted(mesh.start, s, side="right") - 1, 0, len(mesh.start) - 1))
    x = min(1.0, (s - mesh.start[piece]) / mesh.length[piece])
    weight = np.where(np.arange(len(problem.softness)) < piece * degree, problem.torsion.weight, 0.0)
    weight[piece * degree : (piece + 1) * degree] = mesh.length[piece] * mesh.tableau.lagrange([x], integrals=1)[0]
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
    rate, held = compliances(torsion)
    t = mesh.tableau
    piece = np.repeat(np.arange(len(mesh.length)), t.degree)
    up_to = np.where(piece < piece[:, None], torsion.weight, 0.0)
    within = np.kron(np.diag(mesh.length), t.matrix)
    shared = (up_to + within) * rate[:, tube] / torsion.weight
    lever = held[tube] + shared @ weight
    whole = held[tube] + float((weight**2 * rate[:, tube] / torsion.weight).sum())
    if not torsion.size:
        return np.zeros(0), whole
    seen = np.where(torsion.tube == tube, lever[torsion.point], 0.0)
    row = scipy.linalg.lapack.dtrtrs(torsion.factor, seen, lower=1)[0]
    return row, whole - float(row @ row)
