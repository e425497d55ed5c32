"""How stable a solved torsion problem is: margin, unstable directions, and the softest of all."""

from __future__ import annotations

import numpy as np
import scipy

from ...typing import Array
from .offset_margin import softenings
from .reduced import Evaluation, ReducedProblem


def margin(problem: ReducedProblem, state: Evaluation) -> float:
    """Smallest eigenvalue of the second variation relative to its torsional part, at most 1; for tubes off the
    centreline, what takes its place (see `offset_margin`)."""
    if not problem.size:
        return 1.0
    if problem.assembly.eccentric:
        return 1.0 - float(softenings(problem, state.theta).max(initial=0.0))
    return least(state.hessian)


def least(matrix: Array) -> float:
    """Least eigenvalue of a symmetric matrix, at most 1."""
    if not len(matrix):
        return 1.0
    return min(1.0, float(scipy.linalg.lapack.dsyevr(matrix, compute_v=0, range="I", il=1, iu=1)[0][0]))


def unstable_directions(problem: ReducedProblem, state: Evaluation) -> int:
    """Number of negative eigenvalues of the second variation, or of what takes its place."""
    if not problem.size:
        return 0
    if problem.assembly.eccentric:
        return int((softenings(problem, state.theta) > 1).sum())
    return int((np.linalg.eigvalsh(state.hessian) < 0).sum())


def softest(problem: ReducedProblem, state: Evaluation) -> Array:
    """Direction (U,) in z in which an equilibrium is softest, without stiffness at a fold."""
    if not problem.assembly.eccentric:
        vectors: Array = np.linalg.eigh(state.hessian)[1]
        return vectors[:, 0]
    values, columns = np.linalg.eig(state.hessian)
    direction = columns[:, int(np.argmin(values.real))].real
    return np.asarray(direction / np.linalg.norm(direction))
