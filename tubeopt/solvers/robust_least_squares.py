"""Weighted, robust nonlinear least squares of observations, in steps that never leave what can be solved.

    minimise  sum_v w_v rho(|r_v(x)|^2 / sigma_v^2)  +  sum_p ((x_p - start_p) / prior_p)^2

by Levenberg and Marquardt's method with bounds; the loss by reweighting (Holland and Welsch, Commun. Stat. A 6 (1977)).
A step to where there is no answer (no robot, no stable shape) is shortened like one that does not descend, and slopes
that cost as much as a fit serve several steps: what SciPy's `least_squares`, which computes them at each, does not do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar

import numpy as np

from ..errors import InputError, Settings, SolveError
from ..typing import Array


@dataclass(frozen=True)
class LeastSquaresSolver(Settings):
    """How a fit descends.

    Raises:
        InputError: a count that is no whole number of at least 1, another number that is not positive.
    """

    iterations: int = 50
    """After which it gives up."""
    settled: float = 1e-7
    """Relative decrease of the cost at which it ends: a small part of what noise makes of it."""
    round_off: float = 1e-14
    """The same decrease per observation, in squares of its standard deviation, where nothing is left of the cost."""
    first_damping: float = 1e-6
    """Damping of the first step, relative to the diagonal of the normal equations."""


DEFAULT_SOLVER = LeastSquaresSolver()

# A few hundredths of a standard error of the parameters. Along a path with friction there are kinks where the rows that
# stick change. Steps there gain less than predicted, so that a fit to 1e-7 never ends.
NEARLY_SETTLED = 1e-5
"""Relative decrease at which a fit ends whose steps are costly, or one of many similar fits."""

# Below this the Jacobian has changed so much that a new one saves more steps than it costs.
FAITHFUL = 0.7
"""Achieved fraction of the predicted decrease above which a costly Jacobian serves another step."""

MOST_DAMPING = 1e12
"""Damping at which a step is of round-off."""


class Point(Protocol):
    """Parameters x (P,), and what else a step moves."""

    @property
    def x(self) -> Array:
        """(P,) the parameters, which have bounds and priors."""

    def moved(self, step: Array) -> Self:
        """The point after a step (P + F,) of the parameters and of the F other freedoms."""


P = TypeVar("P", bound=Point)


class Observed(Protocol[P]):
    """V observations of k numbers each, and what predicts them."""

    @property
    def start(self) -> P:
        """Where priors draw the parameters to."""

    @property
    def bounds(self) -> Array:
        """(2, P) least and greatest parameters."""

    @property
    def freedoms(self) -> int:
        """Freedoms F beside the parameters."""

    def residuals(self, state: P) -> Array:
        """(V, k) prediction less observation; raises SolveError or InputError where there is none."""

    def jacobian(self, state: P) -> Array:
        """(V, k, P + F) their derivatives by a step."""

    def costly(self, state: P) -> bool:
        """Whether derivatives cost as much as many residuals."""


@dataclass(frozen=True, eq=False)
class Weights:
    """sigma (V,): standard deviation of a coordinate of each observation; share (V,): 0 leaves an observation out;
    prior (P,): standard deviation of each parameter around its start, infinite for none; loss, robust_from: how a large
    error counts, and from which size on."""

    sigma: Array
    share: Array
    prior: Array
    loss: str = "linear"
    robust_from: float = 3.0

    def losses(self, residuals: Array) -> Array:
        """(V,) what each observation costs, in squares of its standard deviation."""
        square, edge = (residuals**2).sum(1) / self.sigma**2, self.robust_from
        if self.loss == "huber":
            size = np.sqrt(square)
            square = np.where(size > edge, 2 * edge * size - edge**2, square)
        elif self.loss == "soft_l1":
            # s^2 for small errors and 2 edge |s| for large ones, smooth in between.
            square = 2 * edge**2 * (np.sqrt(1 + square / edge**2) - 1)
        return np.asarray(square)

    def cost(self, residuals: Array) -> float:
        """Of the observations; the priors' part comes to it."""
        return float(self.share @ self.losses(residuals))

    def of(self, residuals: Array) -> Array:
        """(V,) weights of the squares at residuals (V, k)."""
        size = np.sqrt((residuals**2).sum(1)) / self.sigma
        softened = np.ones(len(size))
        if self.loss == "huber":
            softened = np.minimum(1.0, self.robust_from / np.maximum(size, self.robust_from))
        elif self.loss == "soft_l1":
            softened = 1 / np.sqrt(1 + (size / self.robust_from) ** 2)
        return np.asarray(self.share * softened / self.sigma**2)


@dataclass(frozen=True, eq=False)
class Descent(Generic[P]):
    """Where a descent ended."""

    state: P
    """There."""
    residuals: Array
    """(V, k)."""
    jacobian: Array
    """(V, k, P + F)."""
    converged: bool
    """Whether no step was left that lessens the cost by what counts; else the steps ran out."""
    obstacle: str = ""
    """What cut its last steps short, in words."""


def weighted_sums(jacobian: Array, residuals: Array, w: Array) -> tuple[Array, Array]:
    """J'WJ (Q, Q) and J'Wr (Q,) of observations with weights (V,)."""
    # One weight for all coordinates of an observation: the loss is of its distance.
    flat = jacobian.reshape(residuals.size, jacobian.shape[2])
    weighted = flat * np.repeat(w, jacobian.shape[1])[:, None]
    return weighted.T @ flat, weighted.T @ residuals.ravel()


def normal_equations(
    model: Observed[P], weights: Weights, state: P, residuals: Array, jacobian: Array
) -> tuple[Array, Array]:
    """J'WJ with the priors (Q, Q), and half the gradient (Q,)."""
    square, slope = weighted_sums(jacobian, residuals, weights.of(residuals))
    count = len(state.x)
    inverse = 1 / weights.prior**2
    square[np.arange(count), np.arange(count)] += inverse
    slope[:count] += (state.x - model.start.x) * inverse
    return square, slope


def descend(
    model: Observed[P],
    weights: Weights,
    start: P,
    *,
    jacobian: Array | None = None,
    first: Array | None = None,
    solver: LeastSquaresSolver = DEFAULT_SOLVER,
) -> Descent[P]:
    """The least cost near a start at which every row can be solved.

    Args:
        jacobian: to keep throughout, where the start is close to the answer; None is that of every state, or, where it
            is costly, of those at which an older one no longer serves, and of the last.
        first: that of the start, where it is known.
        solver: when it ends, among others.
    """
    bounds = model.bounds
    # Steps stay within the bounds only from a start within them.
    off = np.clip(start.x, *bounds) - start.x
    state = start.moved(np.append(off, np.zeros(model.freedoms))) if off.any() else start
    residuals = model.residuals(state)
    known = first if jacobian is None else jacobian
    slopes, fresh = model.jacobian(state) if known is None else known, True
    cost, damping, obstacle = cost_of(model, weights, state, residuals), solver.first_damping, ""
    for _ in range(solver.iterations):
        square, slope = normal_equations(model, weights, state, residuals, slopes)
        least = max(solver.settled, NEARLY_SETTLED) if model.costly(state) else solver.settled
        before, accepted, enough = cost, False, least * cost + solver.round_off * len(residuals)
        while not accepted and damping < MOST_DAMPING:
            step = _step(square, slope, damping, state.x, bounds)
            # Within the bounds the model promises between -slope.p and twice as much.
            if -slope @ step <= enough:
                break
            trial = state.moved(step)
            try:
                there = model.residuals(trial)
                cost_there, obstacle = cost_of(model, weights, trial, there), ""
            except (InputError, SolveError) as error:
                cost_there, obstacle = np.inf, str(error).splitlines()[0]
            accepted = cost_there <= cost
            if accepted:
                # The lower limit keeps a later rise within ten steps.
                state, residuals, cost, damping = trial, there, cost_there, max(damping / 10, 1e-9)
            elif not fresh:
                obstacle = ""
                break  # old slopes that lead no further down: new ones are worth more than a shorter step
            else:
                damping *= 10
        if fresh and (not accepted or before - cost <= enough):
            # After so short a step the slopes are those of the state before it.
            return Descent(state, residuals, slopes, True, obstacle)
        if jacobian is None:
            # The model's decrease of |r|^2: slope is half the gradient.
            promised = float(-2 * slope @ step - step @ square @ step)
            serves = accepted and before - cost > max(float(enough), FAITHFUL * promised)
            fresh = not (serves and model.costly(state))
            slopes = model.jacobian(state) if fresh else slopes
    return Descent(state, residuals, slopes, False, obstacle)


def cost_of(model: Observed[P], weights: Weights, state: P, residuals: Array) -> float:
    """What is minimised, at a state with its residuals (V, k)."""
    return weights.cost(residuals) + float((((state.x - model.start.x) / weights.prior) ** 2).sum())


def _step(square: Array, slope: Array, damping: float, x: Array, bounds: Array) -> Array:
    """The damped step that stays within the bounds (2, P); those that a bound stops are held, the others go on."""
    size, count = len(slope), len(x)
    held = np.zeros(size, dtype=bool)
    step = np.zeros(size)
    # An active set: every pass stops at one more bound, so that it ends after as many as there are parameters.
    for _ in range(count + 1):
        free = np.flatnonzero(~held)
        fixed = square[np.ix_(free, held.nonzero()[0])] @ step[held]
        step[free] = -solved(square[np.ix_(free, free)], slope[free] + fixed, damping)
        target = x + step[:count]
        beyond = (target < bounds[0]) | (target > bounds[1])
        beyond &= ~held[:count]
        if not beyond.any():
            break
        step[:count][beyond] = np.clip(target, *bounds)[beyond] - x[beyond]
        held[:count] |= beyond
    return step


def solved(square: Array, slope: Array, damping: float = 0.0) -> Array:
    """(Q,) the answer x to normal equations (Q, Q) x = (Q,), in units of their diagonal, to which damping adds."""
    # In units of the diagonal all parameters count alike, angles and lengths; what no observation sees, below 1e-13,
    # does not move.
    scale = np.sqrt(np.maximum(np.diag(square), 1e-300))
    matrix = square / np.outer(scale, scale) + damping * np.eye(len(scale))
    return np.asarray(np.linalg.lstsq(matrix, slope / scale, rcond=1e-13)[0] / scale)
