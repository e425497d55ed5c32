"""Weighted, robust nonlinear least squares of observations, with steps that stay where the model is solvable.

    minimise  sum_v w_v rho(|r_v(x)|^2 / sigma_v^2)  +  sum_p ((x_p - start_p) / prior_p)^2

by Levenberg and Marquardt's method with bounds; the loss by reweighting (Holland and Welsch, Commun. Stat. A 6 (1977)).
A step to a point without a solution (no robot, no stable shape) is shortened like one that does not descend. Costly
derivatives serve several steps; SciPy's `least_squares` computes them at every step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Protocol, Self, TypeVar

import numpy as np

from ..errors import InputError, Settings, SolveError
from ..typing import Array
from .box_minimum import minimum_in_box


@dataclass(frozen=True)
class LeastSquaresSolver(Settings):
    """Settings of a fit.

    Raises:
        InputError: a count that is no whole number of at least 1, another number that is not positive.
    """

    iterations: int = 50
    """Maximum number of iterations."""
    settled: float = 1e-7
    """Relative decrease of the cost that ends a fit: small compared with the effect of noise."""
    round_off: float = 1e-14
    """Decrease of the cost per observation that ends an exact fit, in squared standard deviations."""
    first_damping: float = 1e-6
    """Damping of the first step, relative to the diagonal of the normal equations."""


DEFAULT_SOLVER = LeastSquaresSolver()

# A few hundredths of a standard error of the parameters. Along a path with friction there are kinks where the rows that
# stick change. Steps there gain less than predicted, so that a fit to 1e-7 never ends.
NEARLY_SETTLED = 1e-5
"""Relative decrease that ends a fit with costly steps, or one of many similar fits."""

# Below this the Jacobian has changed so much that a new one saves more steps than it costs.
FAITHFUL = 0.7
"""Achieved fraction of the predicted decrease above which a costly Jacobian serves another step."""

MAX_DAMPING = 1e12
"""Damping of a step as small as round-off."""


class Point(Protocol):
    """Parameters, and further quantities that a step moves."""

    @property
    def x(self) -> Array:
        """Parameters (P,), with bounds and priors."""

    def moved(self, step: Array) -> Self:
        """Point after a step (P + F,) of the parameters and of F further quantities."""


P = TypeVar("P", bound=Point)


class Observed(Protocol[P]):
    """Model with V observations of k numbers each."""

    @property
    def start(self) -> P:
        """Point of the priors, and default start."""

    @property
    def bounds(self) -> Array:
        """Lower and upper bounds (2, P) of the parameters."""

    @property
    def freedoms(self) -> int:
        """Number F of further quantities that a step moves."""

    def residuals(self, state: P) -> Array:
        """Predictions less observations (V, k); raises SolveError or InputError without a prediction."""

    def jacobian(self, state: P) -> Array:
        """Derivatives (V, k, P + F) of the residuals by a step."""

    def costly(self, state: P) -> bool:
        """True if derivatives cost as much as many residuals."""


@dataclass(frozen=True, eq=False)
class Weights:
    """Weights of observations and priors."""

    sigma: Array
    """Standard deviation (V,) of a coordinate of each observation."""
    weight: Array
    """Weight (V,) of each observation; 0 leaves it out."""
    prior: Array
    """Standard deviation (P,) of each parameter around its start, infinite without a prior."""
    loss: str = "linear"
    """Loss of large errors: "linear" (least squares), "huber" or "soft_l1"."""
    robust_from: float = 3.0
    """Error, in standard deviations, above which the loss grows linearly."""

    def losses(self, residuals: Array) -> Array:
        """Loss (V,) of each observation, in squares of its standard deviation."""
        square, edge = (residuals**2).sum(1) / self.sigma**2, self.robust_from
        if self.loss == "huber":
            size = np.sqrt(square)
            square = np.where(size > edge, 2 * edge * size - edge**2, square)
        elif self.loss == "soft_l1":
            # s^2 for small errors and 2 edge |s| for large ones, smooth in between.
            square = 2 * edge**2 * (np.sqrt(1 + square / edge**2) - 1)
        return np.asarray(square)

    def cost(self, residuals: Array) -> float:
        """Cost of the observations, without the priors."""
        return float(self.weight @ self.losses(residuals))

    def of(self, residuals: Array) -> Array:
        """Weights (V,) of the squared residuals (V, k), by the loss."""
        size = np.sqrt((residuals**2).sum(1)) / self.sigma
        softened = np.ones(len(size))
        if self.loss == "huber":
            softened = np.minimum(1.0, self.robust_from / np.maximum(size, self.robust_from))
        elif self.loss == "soft_l1":
            softened = 1 / np.sqrt(1 + (size / self.robust_from) ** 2)
        return np.asarray(self.weight * softened / self.sigma**2)


@dataclass(frozen=True, eq=False)
class RobustDescent(Generic[P]):
    """Result of a fit."""

    state: P
    """Last state."""
    residuals: Array
    """Residuals (V, k) at the state."""
    jacobian: Array
    """Derivatives (V, k, P + F) of the residuals at the state."""
    converged: bool
    """True if no step decreases the cost any more; False if the iterations ran out."""
    obstacle: str = ""
    """Error that shortened the last steps, or empty."""


def weighted_sums(jacobian: Array, residuals: Array, w: Array) -> tuple[Array, Array]:
    """Sums J'WJ (Q, Q) and J'Wr (Q,) over observations with weights (V,)."""
    # One weight for all coordinates of an observation: the loss is of its distance.
    flat = jacobian.reshape(residuals.size, jacobian.shape[2])
    weighted = flat * np.repeat(w, jacobian.shape[1])[:, None]
    return weighted.T @ flat, weighted.T @ residuals.ravel()


def normal_equations(
    model: Observed[P], weights: Weights, state: P, residuals: Array, jacobian: Array
) -> tuple[Array, Array]:
    """Matrix J'WJ (Q, Q) with the priors, and half the gradient (Q,)."""
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
    secants: bool = False,
    solver: LeastSquaresSolver = DEFAULT_SOLVER,
) -> RobustDescent[P]:
    """Minimum of the cost near a start with a prediction for every observation.

    Args:
        jacobian: derivatives for all steps, if the start is close to the solution. None computes them at every state;
            if they are costly, at states where older ones no longer serve, and at the last.
        first: derivatives at the start, if known.
        secants: whether costly derivatives follow the steps, which suits smooth models, not those with kinks.
        solver: settings.
    """
    bounds = model.bounds
    # Steps stay within the bounds only from a start within them.
    off = np.clip(start.x, *bounds) - start.x
    state = start.moved(np.append(off, np.zeros(model.freedoms))) if off.any() else start
    residuals = model.residuals(state)
    known = first if jacobian is None else jacobian
    slopes, fresh = model.jacobian(state) if known is None else known, True
    cost, damping, obstacle = cost_of(model, weights, state, residuals), solver.first_damping, ""
    free = np.full(model.freedoms, np.inf)
    for _ in range(solver.iterations):
        low, high = bounds - state.x
        range_of_step = np.append(low, -free), np.append(high, free)
        square, slope = normal_equations(model, weights, state, residuals, slopes)
        costly = model.costly(state)
        relative = max(solver.settled, NEARLY_SETTLED) if costly else solver.settled
        before, accepted, enough = cost, False, relative * cost + solver.round_off * len(residuals)
        while not accepted and damping < MAX_DAMPING:
            step = bounded_step(square, slope, range_of_step, damping=damping)
            # Within the bounds the model promises between -slope.p and twice as much.
            if -slope @ step <= enough:
                break
            trial = state.moved(step)
            try:
                trial_residuals = model.residuals(trial)
                trial_cost, obstacle = cost_of(model, weights, trial, trial_residuals), ""
            except (InputError, SolveError) as error:
                trial_cost, obstacle = np.inf, str(error).splitlines()[0]
            accepted = trial_cost <= cost
            if accepted:
                if secants and costly and jacobian is None:
                    slopes = secant(slopes, step, trial_residuals - residuals, np.diag(square))
                # The lower limit keeps a later rise within ten steps.
                state, residuals, cost, damping = trial, trial_residuals, trial_cost, max(damping / 10, 1e-9)
            elif not fresh:
                obstacle = ""
                break  # old derivatives give no descent: compute new ones rather than shorten the step
            else:
                damping *= 10
        if fresh and (not accepted or before - cost <= enough):
            # After so short a step the derivatives of the previous state are accurate.
            return RobustDescent(state, residuals, slopes, True, obstacle)
        if jacobian is None:
            # The model's decrease of |r|^2: slope is half the gradient.
            promised = float(-2 * slope @ step - step @ square @ step)
            serves = accepted and before - cost > max(float(enough), FAITHFUL * promised)
            fresh = not (serves and costly)
            slopes = model.jacobian(state) if fresh else slopes
    return RobustDescent(state, residuals, slopes, False, obstacle)


def secant(slopes: Array, step: Array, change: Array, metric: Array) -> Array:
    """Derivatives (V, k, Q) with the least change that explains a step (Q,) and the change (V, k) of the residuals.

    Broyden, Math. Comput. 19 (1965); the metric (Q,) makes it independent of units.
    """
    along = metric * step
    size = float(along @ step)
    return slopes + ((change - slopes @ step) / size)[..., None] * along if size > 0 else slopes


def cost_of(model: Observed[P], weights: Weights, state: P, residuals: Array) -> float:
    """Cost at a state with residuals (V, k), with the priors."""
    return weights.cost(residuals) + float((((state.x - model.start.x) / weights.prior) ** 2).sum())


def bounded_step(
    square: Array,
    slope: Array,
    bounds: tuple[Array, Array],
    solve: Callable[..., Any] | None = None,
    *,
    damping: float = 0.0,
) -> Array:
    """Step x (Q,) of least x'Sx / 2 + slope.x within bounds (Q,); equal bounds fix a component.

    Args:
        solve: solution of normal equations; by default `solved`.
        damping: multiple of the diagonal that is added to S.
    """
    solve = solve or solved
    diagonal, fixed = np.diag(square), bounds[0] == bounds[1]
    matrix, step = square + damping * np.diag(diagonal), np.where(fixed, bounds[0], 0.0)
    free = np.flatnonzero(~fixed)
    step[free] = -solve(matrix[np.ix_(free, free)], slope[free] + square[np.ix_(free, fixed)] @ step[fixed])
    if ((step >= bounds[0]) & (step <= bounds[1])).all():
        return step
    round_off = 1e-10 * (np.abs(matrix) @ np.abs(step) + np.abs(slope))
    least = minimum_in_box(matrix, slope, bounds, step, solve=solve, round_off=round_off)
    # Where round-off repeats active sets, the cut step serves: its cost is tested anyway.
    return np.clip(step, *bounds) if least is None else least.x


def solved(square: Array, slope: Array) -> Array:
    """Solution (Q,) of normal equations (Q, Q) x = (Q,)."""
    # In units of the diagonal angles and lengths count alike. Directions that no observation determines, below 1e-13,
    # do not move. What no observation depends on has an infinite scale, which round-off cannot move.
    diagonal = np.diag(square)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, np.inf))
    matrix = square / np.outer(scale, scale)
    return np.asarray(np.linalg.lstsq(matrix, slope / scale, rcond=1e-13)[0] / scale)


def inverse_of(square: Array) -> Array:
    """Pseudoinverse (Q, Q) of normal equations (Q, Q)."""
    # Scaled to ones on the diagonal: of parameters in m and in rad the pseudoinverse would drop the smaller.
    scale = np.sqrt(np.maximum(np.diag(square), 1e-300))
    return np.asarray(np.linalg.pinv(square / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale))
