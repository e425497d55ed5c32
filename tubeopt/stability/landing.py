"""Where a robot lands that has lost its equilibrium: downhill in elastic energy, to the next minimum."""

from __future__ import annotations

import numpy as np
import scipy

from ..block.transcription.reduced import Evaluation, ReducedProblem, evaluate, to_unknowns
from ..block.transcription.second_variation import margin
from ..equilibrium.solving import Solution
from ..solvers.newton import NewtonResult, newton
from ..typing import Array

NUDGE = 1e-2
"""Push (rad) along the direction without stiffness."""

STRIDE = 0.1
"""Largest turn (rad) of a point in one step downhill: short, so that the steps stay in the valley that they are in."""

MOST_STEPS = 2000


def land(solution: Solution, direction: Array) -> Solution | None:
    """The minimum to which the energy falls from a fold or an unstable equilibrium, at its joint values.

    The robot is pushed along `direction` (U,) in z to the sides that lead down: one at a fold, both at an unstable
    equilibrium, of which the one that ends lower is taken. From there it takes the way of steepest descent in the norm
    of the torsional energy. None where that leads to no stable equilibrium.

    Of tubes off the centreline the torsional energy leaves out that they are stretched: it only chooses between sides.
    """
    problem, rotations = solution.problem, solution.rotations
    best: Solution | None = None
    lowest = np.inf
    z = to_unknowns(problem, rotations, solution.result.state.theta)
    for start in _sides(problem, rotations, z, direction):
        result = slide(problem, rotations, start)
        value = margin(problem, result.state)
        if result.converged and value > 0 and result.state.energy < lowest:
            lowest = result.state.energy
            best = Solution(problem, rotations, result, value)
    return best


def _sides(problem: ReducedProblem, rotations: Array, z: Array, direction: Array) -> list[Array]:
    """Starting points (U,) beside z along `direction`, on the sides that lead down; on both if none does."""
    push = NUDGE / float(np.abs(problem.factor @ direction).max()) * direction
    down = [side for side in (push, -push) if float(evaluate(problem, rotations, z + side).gradient @ side) < 0]
    return [z + side for side in down or (push, -push)]


def slide(problem: ReducedProblem, rotations: Array, z: Array) -> NewtonResult:
    """The gradient flow of the energy from z (U,) to the minimum where it ends.

    Tubes off the centreline flow down what stands for the gradient, their residual: at their fold the same tubes on the
    centreline may still have a minimum close by, in which a descent of that energy would be caught.

    Linearly implicit Euler steps of at most STRIDE, which grow into those of Newton where the flow comes to rest. Time
    steps may be as long as the softest direction allows, so that a flat valley costs no more steps than a steep one.
    """
    state, time, eccentric = evaluate(problem, rotations, z), 1.0, problem.assembly.eccentric
    identity = np.eye(len(z))
    for count in range(1, MOST_STEPS + 1):
        step, not_convex = _step(problem, state, identity / time)
        turn = float(np.abs(problem.factor @ step).max(initial=0.0))
        if not_convex or turn > STRIDE:
            time *= 0.25 if not_convex else max(0.1, 0.8 * STRIDE / turn)
            continue
        trial = evaluate(problem, rotations, state.z + step)
        if not eccentric and trial.energy > state.energy + 1e-13 * (problem.energy_parts + abs(state.energy)):
            time *= 0.25
            continue
        state, time = trial, min(time * min(3.0, max(1.0, 0.8 * STRIDE / max(turn, 1e-12))), 1e12)
        if turn < 1e-6 and time > 1e6:
            last = newton(problem, rotations, state.z, iterations=4)
            return NewtonResult(last.state, last.converged, count, 0.0)
    return NewtonResult(state, False, MOST_STEPS, 0.0)


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
