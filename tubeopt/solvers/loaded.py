"""Newton's method and energy descent on a loaded problem."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..block.transcription.arm import ArmShape
from ..block.transcription.loaded import LoadedProblem, LoadedState, evaluate
from ..block.transcription.second_variation import least
from ..typing import Array
from .newton import NewtonResult, full_steps, newton_step
from .settings import NEWTON


@dataclass(frozen=True, eq=False)
class LoadedAnswer:
    """An equilibrium under load at N points and along its arm; n tubes.

    Attributes:
        theta (N, n), curvature (N, 2): at the points.
        margin, residual, energy, work, iterations: as of an equilibrium.
        errors: of theta (rad), the tip (m) and the margin, by a Newton step on a finer rule.
        compliance: (6, 6) of the tip; None at a fold.   base_wrench: (6,).
    """

    theta: Array
    curvature: Array
    margin: float
    residual: float
    energy: float
    work: float
    iterations: int
    errors: tuple[float, float, float]
    compliance: Array | None
    base_wrench: Array
    arm: ArmShape


def loaded_newton(
    problem: LoadedProblem, rotations: Array, x: Array, factor: float = 1.0, *, iterations: int = 20
) -> NewtonResult[LoadedState]:
    """Full Newton steps from x (U + 2 N,)."""

    def step(state: LoadedState) -> tuple[Array, float]:
        change, singular = newton_step(state)
        size = turn_of(problem, state, change)
        return change, np.inf if singular or size > 1e3 else size

    return full_steps(
        evaluate(problem, rotations, x, factor),
        step,
        lambda state, change: evaluate(problem, rotations, state.x + change, factor),
        lambda state: loaded_residual(problem, state),
        iterations,
        NEWTON,
    )


def turn_of(problem: LoadedProblem, state: LoadedState, step: Array) -> float:
    """Largest turn (rad) of a tube at a point by a step, or of the arm if curvature changed alike all along it."""
    tubes = np.abs(problem.torsion.factor @ step[: problem.torsion.size]).max(initial=0.0)
    length = problem.torsion.assembly.total_length
    return max(float(tubes), length * float(np.abs(state.turned @ step).max(initial=0.0)))


def loaded_residual(problem: LoadedProblem, state: LoadedState) -> float:
    """Largest violation of the equations, as an error of theta at the points or of the arm's direction, rad."""
    split = problem.torsion.size
    tubes = np.abs(problem.torsion.factor @ state.gradient[:split]).max(initial=0.0)
    bend = np.abs(np.repeat(problem.softness, 2) * state.gradient[split:]).max(initial=0.0)
    return max(float(tubes), problem.torsion.assembly.total_length * float(bend))


def loaded_margin(problem: LoadedProblem, state: LoadedState) -> float:
    """Smallest eigenvalue of the second variation relative to its torsional and bending part, at most 1; NaN for loads
    without an energy."""
    if not problem.load.has_energy:
        return float("nan")
    return least(state.hessian)
