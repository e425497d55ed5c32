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
        # Far from a solution the first steps may grow a little, and converge all the same. A step that doubles and
        # turns a tube by more than half a turn has left every branch nearby. `not <=` also catches NaN.
        if not size <= LONGEST or (size > 2 * last and size > np.pi):
            return NewtonResult(state, False, iteration, np.inf)
        state = moved(state, change)
        if size <= LAST_STEP and (size <= ROUND_OFF or residual(state) <= ROUND_OFF):
            return NewtonResult(state, True, iteration, contraction)
        # Below, the ratio is one of round-off.
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
        # Armijo's condition with the usual 1e-4. Near the minimum the decrease drowns in the round-off of the energy,
        # 1e-13 of it. After 40 halvings a step is of round-off itself.
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
    # 0.05 rad is small against the distance between minima, and enough for the energy to fall by more than round-off.
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
    """Newton step, and whether the Jacobian is singular; LAPACK itself, whose NumPy wrapper costs more than it."""
    if not len(state.gradient):
        return state.gradient, False
    _, _, step, failed = scipy.linalg.lapack.dgesv(state.hessian, -state.gradient)
    return step, failed != 0


# --- Gradient flow of an energy ---------------------------------------------------------------------------------------

# The gradient flow of an energy, down to where it comes to rest.
#
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
    step: Callable[[S, float], tuple[Array, float, bool]],
    moved: Callable[[S, Array], S | None],
    solved: Callable[[S], NewtonResult[S]],
) -> NewtonResult[S]:
    """The state where the flow from another comes to rest, and the steps that took.

    Args:
        step: from a state in a time: change, its largest turn (rad), and whether its matrix is not positive.
        moved: a state after a change; None where its energy rises.
        solved: the state at rest, from where the flow hardly moves.
    """
    time = 1.0
    for count in range(1, FLOW_STEPS + 1):
        change, turn, not_convex = step(state, time)
        if not_convex or turn > STRIDE:
            # The matrix H + 1 / time is positive for a time short enough.
            time *= 0.25 if not_convex else shortened(turn)
            continue
        # A rise of energy means that the model of second order is valid for a shorter time only.
        there = moved(state, change)
        if there is None:
            time *= 0.25
            continue
        state, time = there, grown(time, turn)
        # A long time step that hardly moves is Newton's step close to rest.
        if turn < 1e-6 and time > 1e6:
            last = solved(state)
            return NewtonResult(last.state, last.converged, count, 0.0)
    return NewtonResult(state, False, FLOW_STEPS, 0.0)


def downhill(x: Array, push: Array, gradient: Callable[[Array], Array]) -> list[Array]:
    """Points (U,) beside x at +-`push`, on the sides that lead down; on both if none does."""
    down = [side for side in (push, -push) if float(gradient(x + side) @ side) < 0]
    return [x + side for side in down or (push, -push)]


def shortened(turn: float) -> float:
    """By what a time is multiplied after a step with this turn (rad), which was too long."""
    # A step is about proportional to its time: 0.8 leaves room for what is not.
    return max(0.1, 0.8 * STRIDE / turn)


def grown(time: float, turn: float) -> float:
    """The time after one whose step had this turn (rad)."""
    # At most three times as long: the curvature of the valley, which may lengthen a step, is known here only. The
    # limit 1e12 keeps 1 / time above round-off of the Hessian.
    return min(time * min(3.0, max(1.0, 0.8 * STRIDE / max(turn, 1e-12))), 1e12)
