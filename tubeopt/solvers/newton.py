"""Newton's method for any equations of equilibrium, and energy descent for those with an energy.

`full_steps` converges to stable and unstable equilibria alike. `descend` only decreases the energy, so that it ends in
a minimum, or in a saddle if the start is symmetric.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
import scipy

from ..block.transcription.reduced import ReducedProblem
from ..typing import Array
from .settings import LAST_STEP, LONGEST_STEP, NEWTON, NEWTON_ROUND_OFF, Newton
from .time_limit import check_time

S = TypeVar("S")
C = TypeVar("C")
R = TypeVar("R")


class OfEnergy(Protocol):
    """State with its energy (J), gradient (U,) and Hessian (U, U)."""

    @property
    def energy(self) -> float: ...
    @property
    def gradient(self) -> Array: ...
    @property
    def hessian(self) -> Array: ...


E = TypeVar("E", bound=OfEnergy)

LONGEST = 1e3
"""Turn (rad) above which a step is meaningless, since its matrix is nearly singular."""


@dataclass(frozen=True, eq=False)
class NewtonResult(Generic[S]):
    """Result of Newton's method."""

    state: S
    """Last state."""
    converged: bool
    iterations: int
    contraction: float
    """Largest ratio of successive steps."""


def full_steps(
    state: S,
    moved: Callable[[S, Array], S],
    turn: Callable[[S, Array], float],
    residual: Callable[[S], float],
    iterations: int,
) -> NewtonResult[S]:
    """Newton's method with full steps; ends early if the steps grow.

    Args:
        moved: returns a state after a step.   turn: largest turn of a step from a state, rad.
        residual: residual of a state, rad.
    """
    check_time()
    last, contraction = np.inf, 0.0
    for iteration in range(1, iterations + 1):
        change, singular = newton_step(state)
        size = np.inf if singular else turn(state, change)
        # Far from a solution the first steps may grow a little, and converge all the same. A step that doubles and
        # turns a tube by more than half a turn has left every branch nearby. `not <=` also catches NaN.
        if not size <= LONGEST or (size > 2 * last and size > np.pi):
            return NewtonResult(state, False, iteration, np.inf)
        state = moved(state, change)
        if size <= LAST_STEP and (size <= NEWTON_ROUND_OFF or residual(state) <= NEWTON_ROUND_OFF):
            return NewtonResult(state, True, iteration, contraction)
        # The ratio of smaller steps is round-off.
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
    """Minimum of the energy by `damped_newton`, refined by `full_steps`; the arguments are theirs."""
    check_time()
    state, iterations, converged = damped_newton(state, moved, turn, settings)
    if not converged:
        return NewtonResult(state, False, iterations, 0.0)
    # A minimum, or a saddle of a symmetric start: the gradient is 0.
    last = full_steps(state, moved, turn, residual, 4)
    return NewtonResult(last.state, last.converged, iterations, 0.0)


class Descent(NamedTuple, Generic[E]):
    """Result of a descent."""

    state: E
    iterations: int
    converged: bool
    """True if the last step is at most LAST_STEP."""


def damped_newton(
    state: E, moved: Callable[[E, Array], E], turn: Callable[[E, Array], float], settings: Newton = NEWTON
) -> Descent[E]:
    """Newton's method on an energy, with a shifted Hessian and steps shortened until the energy falls (Armijo).

    Args:
        moved: returns the state after a step.   turn: largest turn of a step from a state, rad.
    """
    for iteration in range(1, settings.descent_iterations + 1):
        step = _downhill(state)
        size = turn(state, step)
        if size <= LAST_STEP:
            return Descent(state, iteration, True)
        step *= min(1.0, LONGEST_STEP / size)
        slope = float(state.gradient @ step)
        # Armijo's condition with the usual 1e-4. Near the minimum the decrease drowns in the round-off of the energy,
        # 1e-13 of it. After 40 halvings a step is of round-off itself.
        for _ in range(40):
            trial = moved(state, step)
            if trial.energy <= state.energy + 1e-4 * slope + 1e-13 * abs(state.energy):
                break
            step, slope = step / 2, slope / 2
        if not np.isfinite(trial.energy):
            # No such arm, however short the step: the last one is kept.
            return Descent(state, iteration, False)
        state = trial
    return Descent(state, settings.descent_iterations, False)


def torsional_turn(problem: ReducedProblem, step: Array) -> float:
    """Largest change of a rotation by a step in z, rad."""
    return float(abs(problem.factor @ step).max()) if len(step) else 0.0


def _downhill(state: OfEnergy) -> Array:
    """Newton step, with a shifted Hessian if the energy is not convex.

    The shifts are those of the compiled kernel, so that both end in the same of several minima.
    """
    if not len(state.gradient):
        return state.gradient
    # In whitened unknowns the torsional part of the Hessian is the identity: a shift of the order of 1 makes a softened
    # Hessian positive, and one of 1e6 leaves no step.
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
    """Newton step, and True if the Jacobian is singular."""
    # LAPACK directly: the wrapper of NumPy takes longer than the solve.
    if not len(state.gradient):
        return state.gradient, False
    _, _, step, failed = scipy.linalg.lapack.dgesv(state.hessian, -state.gradient)
    return step, failed != 0


# --- Gradient flow of an energy ---------------------------------------------------------------------------------------

# Linearly implicit Euler steps, no longer than a stride, grow into those of Newton's method. Time steps may be as long
# as the softest direction allows, so that a flat valley costs no more steps than a steep one.


# A valley of the coupling energy is about as wide as the hysteresis, down to a few tenths of a radian (`SOFT_TWIST`): a
# longer step may cross into the next valley.
STRIDE = 0.1
"""Largest turn (rad) of a point in one step downhill."""

# A fall crosses up to a few turns of every tube, at 0.1 rad a step with some steps repeated: some hundred steps.
FLOW_STEPS = 2000
"""Maximum number of steps of a fall."""


def flow(
    state: S,
    step: Callable[[S, float], C | None],
    turn: Callable[[S, C], float],
    moved: Callable[[S, C], S | None],
    rest: Callable[[S, float, float, int], R | None],
) -> R | None:
    """State of rest at the end of the gradient flow from a state; None if it finds none.

    Args:
        step: returns the change of a state in a time; None if its matrix is not positive.
        turn: largest turn of a change of a state, rad.
        moved: returns the state after a change; None if its energy rises.
        rest: returns the state of rest, if the flow has come close to it; from a state, the largest turn (rad) of the
            last step, the time of the next one, and the number of steps so far.
    """
    time, size = 1.0, np.inf
    for count in range(FLOW_STEPS):
        last = rest(state, size, time, count)
        if last is not None:
            return last
        change = step(state, time)
        if change is None:
            # The matrix H + 1 / time is positive for a time short enough.
            time *= 0.25
            continue
        size = turn(state, change)
        if size > STRIDE:
            # A step is about proportional to its time; 0.8 is a safety factor.
            time *= max(0.1, 0.8 * STRIDE / size)
            continue
        following = moved(state, change)
        if following is None:
            # A rise of energy means that the model of second order is valid for a shorter time only.
            time *= 0.25
            continue
        # At most three times as long: the curvature of the valley, which may lengthen a step, is known here only. The
        # limit 1e12 keeps 1 / time above round-off of the Hessian.
        state, time = following, min(time * min(3.0, max(1.0, 0.8 * STRIDE / max(size, 1e-12))), 1e12)
    return None


def downhill(x: Array, push: Array, gradient: Callable[[Array], Array]) -> list[Array]:
    """Points (U,) at x +- `push` with energy decreasing away from x; both points if neither has."""
    down = [side for side in (push, -push) if float(gradient(x + side) @ side) < 0]
    return [x + side for side in down or (push, -push)]
