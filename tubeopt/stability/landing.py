"""Where a robot lands that has lost its equilibrium: downhill in elastic energy, to the next minimum."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dposv

from ..robots.assembly import Array
from ..solution import Solution
from ..solvers.newton import NewtonResult, newton
from ..transcription.reduced import ReducedProblem, evaluate, margin, on_centreline, to_unknowns

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

    The energy is that of the tubes on the centreline; for tubes off it the landing is then solved with their offsets.
    """
    problem, rotations = solution.problem, solution.rotations
    concentric = on_centreline(problem)
    best: Solution | None = None
    lowest = np.inf
    z = to_unknowns(concentric, rotations, solution.result.state.theta)
    for start in _sides(concentric, rotations, z, direction):
        result = slide(concentric, rotations, start)
        value = margin(concentric, result.state)
        if result.converged and value > 0 and result.state.energy < lowest:
            lowest = result.state.energy
            best = Solution(concentric, rotations, result, value)
    if best is None or concentric is problem:
        return best
    result = newton(problem, rotations, to_unknowns(problem, rotations, best.result.state.theta))
    value = margin(problem, result.state)
    return Solution(problem, rotations, result, value) if result.converged and value > 0 else None


def _sides(problem: ReducedProblem, rotations: Array, z: Array, direction: Array) -> list[Array]:
    """Starting points (U,) beside z along `direction`, on the sides that lead down; on both if none does."""
    push = NUDGE / float(np.abs(problem.factor @ direction).max()) * direction
    down = [side for side in (push, -push) if float(evaluate(problem, rotations, z + side).gradient @ side) < 0]
    return [z + side for side in down or (push, -push)]


def slide(problem: ReducedProblem, rotations: Array, z: Array) -> NewtonResult:
    """The gradient flow of the energy from z (U,) to the minimum where it ends, for concentric tubes.

    Linearly implicit Euler steps of at most STRIDE, which grow into those of Newton where the flow comes to rest. Time
    steps may be as long as the softest direction allows, so that a flat valley costs no more steps than a steep one.
    """
    state, time = evaluate(problem, rotations, z), 1.0
    identity = np.eye(len(z))
    # The energy of bending may be next to 0 where curvatures agree; its round-off is that of its parts.
    parts = float(problem.weight @ ((problem.moment**2).sum(1) / problem.stiffness.sum(1)))
    for count in range(1, MOST_STEPS + 1):
        _, step, not_convex = dposv(state.hessian + identity / time, -state.gradient)
        turn = float(np.abs(problem.factor @ step).max(initial=0.0))
        if not_convex or turn > STRIDE:
            time *= 0.25 if not_convex else max(0.1, 0.8 * STRIDE / turn)
            continue
        trial = evaluate(problem, rotations, state.z + step)
        if trial.energy > state.energy + 1e-13 * (parts + abs(state.energy)):
            time *= 0.25
            continue
        state, time = trial, min(time * min(3.0, max(1.0, 0.8 * STRIDE / max(turn, 1e-12))), 1e12)
        if turn < 1e-6 and time > 1e6:
            last = newton(problem, rotations, state.z, iterations=4)
            return NewtonResult(last.state, last.converged, count, 0.0)
    return NewtonResult(state, False, MOST_STEPS, 0.0)


def distance(a: Solution, b: Solution) -> float:
    """Largest difference (rad) of the rotations of two solutions of the same problem."""
    return float(np.abs(a.result.state.theta - b.result.state.theta).max(initial=0.0))
