"""Newton's method on any equations of equilibrium, and energy descent on those with an energy.

`full_steps` go where the equations lead, to stable and unstable equilibria alike; `descend` only downhill in energy, so
that it ends in a minimum, or in a saddle if symmetry holds it there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
import scipy

from ..block.transcription.reduced import Evaluation, ReducedProblem
from ..typing import Array
from .settings import LAST_STEP, LONGEST_STEP, NEWTON, ROUND_OFF, Newton
from .time_limit import check_time

S = TypeVar("S")


class OfEnergy(Protocol):
    """A state with its energy (J), the gradient (U,) and the Hessian (U, U)."""

    @property
    def energy(self) -> float: ...
    @property
    def gradient(self) -> Array: ...
    @property
    def hessian(self) -> Array: ...


E = TypeVar("E", bound=OfEnergy)

LONGEST = 1e3
"""Turn (rad) of a step that leads nowhere: its matrix is all but singular."""


@dataclass(frozen=True, eq=False)
class NewtonResult(Generic[S]):
    """Last state, whether it converged, iterations done, and the largest ratio of successive steps."""

    state: S
    converged: bool
    iterations: int
    contraction: float


def full_steps(
    state: S,
    moved: Callable[[S, Array], S],
    turn: Callable[[S, Array], float],
    residual: Callable[[S], float],
    iterations: int,
) -> NewtonResult[S]:
    """Newton's method: full steps, which stop early where they grow instead of shrinking.

    Args:
        moved: a state after a step.   turn: largest turn of a step from a state, rad.   residual: of a state, rad.
    """
    check_time()
    last, contraction = np.inf, 0.0
    for iteration in range(1, iterations + 1):
        change, singular = newton_step(state)
        size = np.inf if singular else turn(state, change)
        if not size <= LONGEST or (size > 2 * last and size > np.pi):
            return NewtonResult(state, False, iteration, np.inf)
        state = moved(state, change)
        if size <= LAST_STEP and (size <= ROUND_OFF or residual(state) <= ROUND_OFF):
            return NewtonResult(state, True, iteration, contraction)
        if size > LAST_STEP:
            contraction = max(contraction, size / last)
        last = size
    return NewtonResult(state, False, iterations, contraction)


def descend(
    state: E,
    moved: Callable[[E, Array], E],
    turn: Callable[[E, Array], float],
    residual: Callable[[E], float],
    settings: Newton = NEWTON,
) -> NewtonResult[E]:
    """The minimum of the energy to which `damped_newton` leads, polished by `full_steps`; arguments as of these."""
    check_time()
    state, iterations, ended = damped_newton(state, moved, turn, settings)
    if not ended:
        return NewtonResult(state, False, iterations, 0.0)
    # A minimum, or a saddle that symmetry holds: nothing downhill that the gradient could see.
    last = full_steps(state, moved, turn, residual, 4)
    return NewtonResult(last.state, last.converged, iterations, 0.0)


def damped_newton(
    state: E, moved: Callable[[E, Array], E], turn: Callable[[E, Array], float], settings: Newton = NEWTON
) -> tuple[E, int, bool]:
    """Newton on an energy with the Hessian made positive and steps shortened until the energy falls (Armijo).

    Args:
        moved: the state after a step.   turn: largest turn of a step from a state, rad.

    Returns:
        The last state, iterations, and whether no step downhill is longer than `last_step`.
    """
    for iteration in range(1, settings.descent_iterations + 1):
        step = _downhill(state)
        size = turn(state, step)
        if size <= LAST_STEP:
            return state, iteration, True
        step *= min(1.0, LONGEST_STEP / size)
        slope = float(state.gradient @ step)
        for _ in range(40):
            trial = moved(state, step)
            if trial.energy <= state.energy + 1e-4 * slope + 1e-13 * abs(state.energy):
                break
            step, slope = step / 2, slope / 2
        state = trial
    return state, settings.descent_iterations, False


def leave_saddle(problem: ReducedProblem, state: Evaluation) -> tuple[Array, Array]:
    """Starting points (U,) on either side of an unstable equilibrium, along its most unstable direction."""
    direction = np.linalg.eigh(state.hessian)[1][:, 0]
    direction *= 0.05 / torsional_turn(problem, direction)
    return state.z + direction, state.z - direction


def torsional_turn(problem: ReducedProblem, step: Array) -> float:
    """Largest change of a rotation that a step in z makes, rad."""
    return float(abs(problem.factor @ step).max()) if len(step) else 0.0


def _downhill(state: OfEnergy) -> Array:
    """Newton step where the energy is convex; else of the Hessian with a shift that makes it so.

    The shifts are those of the compiled kernel: of several minima the two then end in the same one.
    """
    if not len(state.gradient):
        return state.gradient
    shift = 0.0
    while shift < 1e6:
        matrix = state.hessian.copy()
        matrix.ravel()[:: len(matrix) + 1] += shift
        _, step, failed = scipy.linalg.lapack.dposv(matrix, -state.gradient)
        if not failed:
            return np.asarray(step)
        shift = 4 * shift if shift else 0.1
    return np.zeros_like(state.gradient)


def newton_step(state: Any) -> tuple[Array, bool]:
    """Newton step, and whether the Jacobian is singular; LAPACK itself, whose NumPy wrapper costs more than it."""
    if not len(state.gradient):
        return state.gradient, False
    _, _, step, failed = scipy.linalg.lapack.dgesv(state.hessian, -state.gradient)
    return step, failed != 0
