"""Where a robot lands that has lost its equilibrium: downhill in elastic energy, to the next minimum."""

from __future__ import annotations

import numpy as np
import scipy

from ..block.transcription.reduced import Evaluation, ReducedProblem, evaluate, to_unknowns
from ..block.transcription.second_variation import margin
from ..equilibrium.solving import Solution
from ..solvers.flow import downhill, flow
from ..solvers.newton import NewtonResult, newton
from ..solvers.settings import CONTINUATION
from ..typing import Array


def land(solution: Solution, direction: Array) -> Solution | None:
    """The minimum to which the energy falls from a fold or an unstable equilibrium, at its joint values.

    The robot is pushed along `direction` (U,) in z to the sides that lead down: one at a fold, both at an unstable
    equilibrium, of which the one that ends lower is taken. From there it takes the way of steepest descent in the norm
    of the torsional energy. None where that leads to no stable equilibrium.

    Of tubes off the centreline the torsional energy leaves out that they are stretched: it only chooses between sides.
    """
    problem, rotations = solution.problem, solution.rotations
    z = to_unknowns(problem, rotations, solution.result.state.theta)
    push = CONTINUATION.nudge / float(np.abs(problem.factor @ direction).max()) * direction
    starts = downhill(z, push, lambda x: evaluate(problem, rotations, x).gradient)
    ends = [result for result in (slide(problem, rotations, start) for start in starts) if result.converged]
    rests = [Solution(problem, rotations, end, margin(problem, end.state)) for end in ends]
    return min((one for one in rests if one.margin > 0), key=lambda one: one.result.state.energy, default=None)


def slide(problem: ReducedProblem, rotations: Array, z: Array) -> NewtonResult[Evaluation]:
    """The gradient flow of the energy from z (U,) to the minimum where it ends.

    Tubes off the centreline flow down what stands for the gradient, their residual: at their fold the same tubes on the
    centreline may still have a minimum close by, in which a descent of that energy would be caught.
    """
    eccentric = problem.assembly.eccentric

    def step(state: Evaluation, time: float) -> tuple[Array, float, bool]:
        change, not_convex = _step(problem, state, np.eye(len(z)) / time)
        return change, float(np.abs(problem.factor @ change).max(initial=0.0)), not_convex

    def moved(state: Evaluation, change: Array) -> Evaluation | None:
        there = evaluate(problem, rotations, state.z + change)
        rises = there.energy > state.energy + 1e-13 * (problem.energy_parts + abs(state.energy))
        return None if rises and not eccentric else there

    return flow(
        evaluate(problem, rotations, z), step, moved, lambda state: newton(problem, rotations, state.z, iterations=4)
    )


def _step(problem: ReducedProblem, state: Evaluation, shift: Array) -> tuple[Array, bool]:
    """Step of the shifted Newton matrix, and whether that is not positive."""
    matrix = state.hessian + shift
    if problem.assembly.eccentric:
        failed = scipy.linalg.lapack.dpotrf((matrix + matrix.T) / 2)[1]
        step = scipy.linalg.lapack.dgesv(matrix, -state.gradient)[2]
    else:
        _, step, failed = scipy.linalg.lapack.dposv(matrix, -state.gradient)
    return np.asarray(step), failed != 0


def distance(a: Solution, b: Solution) -> float:
    """Largest difference (rad) of the rotations of two solutions of the same problem."""
    return float(np.abs(a.result.state.theta - b.result.state.theta).max(initial=0.0))
