"""Where a robot lands that has lost its equilibrium: downhill in elastic energy, to the next minimum."""

from __future__ import annotations

import numpy as np

from ..kinematics import Solution
from ..robots.assembly import Array
from ..solvers.newton import descend, newton
from ..transcription.reduced import margin, on_centreline, to_unknowns

NUDGE = 1e-3
"""Push (rad) along the direction without stiffness."""


def land(solution: Solution, direction: Array) -> Solution | None:
    """The minimum that energy descent reaches from a fold or an unstable equilibrium, at its joint values.

    The robot is pushed to both sides along `direction` (U,) in z; at a fold only one of them leads down. None where
    descent ends in no stable equilibrium.

    The energy is that of the tubes on the centreline; for tubes off it the landing is then solved with their offsets.
    """
    problem, rotations = solution.problem, solution.rotations
    concentric = on_centreline(problem)
    z = to_unknowns(concentric, rotations, solution.result.state.theta)
    turn = float(np.abs(problem.factor @ direction).max())
    best: Solution | None = None
    lowest = np.inf
    for sign in (1.0, -1.0):
        start = z + sign * NUDGE / turn * direction
        result = descend(concentric, rotations, start, iterations=200)
        if not result.converged or margin(concentric, result.state) <= 0:
            continue
        if result.state.energy < lowest:
            lowest = result.state.energy
            best = Solution(concentric, rotations, result, margin(concentric, result.state))
    if best is None or concentric is problem:
        return best
    result = newton(problem, rotations, to_unknowns(problem, rotations, best.result.state.theta))
    value = margin(problem, result.state)
    return Solution(problem, rotations, result, value) if result.converged and value > 0 else None


def distance(a: Solution, b: Solution) -> float:
    """Largest difference (rad) of the rotations of two solutions of the same problem."""
    return float(np.abs(a.result.state.theta - b.result.state.theta).max(initial=0.0))
