"""Folds: where a branch of equilibria ends, and a robot that follows it snaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..block.transcription.buffered import section_function
from ..block.transcription.mesh import make_mesh
from ..block.transcription.reduced import Evaluation, ReducedProblem, evaluate, reduce
from ..block.transcription.second_variation import softest
from ..equilibrium.continuation import JointPath, Point
from ..equilibrium.solving import Solution
from ..solvers.settings import CONTINUATION
from ..typing import Array


@dataclass(frozen=True, eq=False)
class Fold:
    """A fold at fraction t: the equilibrium, and the direction (U,) in z in which it has no stiffness."""

    t: float
    solution: Solution
    direction: Array


def polish_fold(path: JointPath, near: Point) -> Fold | None:
    """Newton on the augmented system  g(z, t) = 0, H(z, t) v = 0, v.v = 1  (Moore and Spence 1980); None where it
    does not converge.

    Derivatives with respect to t are central differences; they shape the steps, not the result.
    """
    known = near.solution.problem
    z, t = near.solution.result.state.z, near.t
    v = softest(known, near.solution.result.state)
    size = len(z)
    for _ in range(CONTINUATION.fold_steps):
        problem = _problem_like(path, t, known)
        if problem is None or problem.size != size:
            return None
        state = evaluate(problem, path.at(t)[0], z)
        residual = np.concatenate([state.gradient, state.hessian @ v, [(v @ v - 1) / 2]])
        matrix = np.zeros((2 * size + 1, 2 * size + 1))
        matrix[:size, :size] = state.hessian
        matrix[size : 2 * size, :size] = _hessian_slope(problem, path.at(t)[0], state, v)
        matrix[size : 2 * size, size : 2 * size] = state.hessian
        matrix[2 * size, size : 2 * size] = v
        slope = _t_slope(path, t, known, z, v)
        if slope is None:
            return None
        matrix[: 2 * size, 2 * size] = slope
        try:
            step = np.linalg.solve(matrix, -residual)
        except np.linalg.LinAlgError:
            return None
        turn = float(np.abs(problem.factor @ step[:size]).max())
        if not np.isfinite(turn) or turn > np.pi / 2 or abs(t + step[-1] - near.t) > 0.5:
            return None
        z, v, t = z + step[:size], v + step[size:-1], t + float(step[-1])
        if turn < 1e-11 and abs(step[-1]) < 1e-13:
            break
    else:
        if turn > 1e-7:
            return None
    problem = _problem_like(path, t, known)
    return None if problem is None else Fold(t, Solution.at(problem, path.at(t)[0], z), v)


def _problem_like(path: JointPath, t: float, known: ReducedProblem) -> ReducedProblem | None:
    """The problem at t on a mesh with the pieces of a known one of the path; None where the sections are others."""
    n = path.robot.n_tubes
    if (path.start[n:] == path.end[n:]).all():
        return known
    assembly, count = path.robot.assembly(path.at(t)[1]), known.assembly.n_sections
    if assembly.n_sections != count:
        return None
    return reduce(assembly, make_mesh(assembly, np.bincount(known.mesh.section, minlength=count)))


def _t_slope(path: JointPath, t: float, known: ReducedProblem, z: Array, v: Array) -> Array | None:
    """d(g, H v)/dt by central differences within the same structure, one-sided where a side leaves it."""
    values: list[Array] = []
    places: list[float] = []
    for at in (t - 1e-6, t + 1e-6, t):
        problem = _problem_like(path, at, known)
        if problem is None or problem.size != len(z) or len(values) == 2:
            continue
        state = evaluate(problem, path.at(at)[0], z)
        values.append(np.concatenate([state.gradient, state.hessian @ v]))
        places.append(at)
    return (values[1] - values[0]) / (places[1] - places[0]) if len(values) == 2 else None


def _hessian_slope(problem: ReducedProblem, rotations: Array, state: Evaluation, v: Array) -> Array:
    """(U, U) derivative of H v with respect to z; for tubes off the centreline by central differences."""
    count, n = state.theta.shape
    if problem.assembly.eccentric:
        # Second derivatives of the residual, so that v may be the direction in which H changes.
        ahead, back = (evaluate(problem, rotations, state.z + step * v).hessian for step in (1e-6, -1e-6))
        return (ahead - back) / 2e-6
    y = np.zeros((count, n))
    y.ravel()[problem.flat] = problem.factor @ v
    direction = state.theta if problem.phase is None else state.theta + problem.phase
    slope = section_function("stiffness_slope", count, n, False)(direction, problem.stiffness, problem.moment, y)[0]
    second = np.zeros(problem.size**2)
    second[problem.places] = slope.ravel()[problem.entries] * problem.entry_weight
    return np.asarray(problem.factor.T @ second.reshape(problem.size, -1) @ problem.factor)
