"""Weighted, robust nonlinear least squares of observations, in steps that never leave the robots that can be built.

    minimise  sum_v w_v rho(|r_v(x)|^2 / sigma_v^2)  +  sum_p ((x_p - start_p) / prior_p)^2

by Levenberg and Marquardt's method with bounds; the loss by reweighting (Holland and Welsch, Commun. Stat. A 6 (1977)).
A step to where there is no robot, or no stable shape, is shortened like one that does not descend. Beside it, what fits
to some of the rows tell of the others, and intervals from blocks of rows drawn again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError, Settings, SolveError
from ..typing import Array, Index
from .model import ArmModel, State

LOSSES = ("linear", "huber", "soft_l1")
"""How a large error counts: by its square, or in the end by its size."""


@dataclass(frozen=True)
class FitSolver(Settings):
    """How a fit descends; a field of `FitOptions`.

    Raises:
        InputError: a count that is no whole number of at least 1, another number that is not positive.
    """

    iterations: int = 50
    """After which it gives up."""
    settled: float = 1e-7
    """Relative decrease of the cost at which it ends: a small part of what noise makes of it."""
    nearly_settled: float = 1e-5
    """The same where a step is costly, or one of many fits alike: a few hundredths of a standard error of the
    parameters. Along a way with friction, kinks where what sticks changes let steps gain less than they promise, and
    never end."""
    faithful: float = 0.7
    """Part of the promised decrease that came about, from which costly slopes serve another step."""
    first_damping: float = 1e-6
    """Of the first step, relative to the diagonal of the normal equations."""
    chord_iterations: int = 8
    """With slopes that are known from near by, as in fits to all folds but one: each gains two digits or more."""
    most_damping: float = 1e12
    """At which a step is too short to be worth another."""
    same_noise: float = 0.02
    """Relative change of the estimated noise at which it has settled."""
    blocks: int = 20
    """Of rows that intervals are drawn from again, where there are as many places."""
    draws: int = 400
    """Of them."""
    rounds: int = 8
    """Of choosing effects at most."""
    tried: int = 4
    """Sets of effects, of those that promise most, that are fitted at each round."""
    strong: float = 10.0
    """Twice the logarithm of a Bayes factor from which on the evidence against an effect counts: very strong (Kass and
    Raftery, J. Am. Stat. Assoc. 90 (1995))."""
    crooked: float = 30.0
    """A set is fitted if it is no more than so much worse to first order, which curvature of the model may make up
    for."""
    robust_from: float = 3.0
    """Length of an error of three coordinates, in standard deviations of one, from which a robust loss grows like it
    and no longer like its square."""

    @property
    def by_chords(self) -> FitSolver:
        """For one of many fits alike, whose slopes are known from near by."""
        return replace(self, iterations=self.chord_iterations, settled=self.nearly_settled)


DEFAULT_SOLVER = FitSolver()


@dataclass(frozen=True, eq=False)
class Weights:
    """sigma (V,): standard deviation of a coordinate of each observation; share (V,): 0 leaves an observation out;
    prior (P,): standard deviation of each parameter around its start, infinite for none; loss, robust_from: how a large
    error counts, and from which size on."""

    sigma: Array
    share: Array
    prior: Array
    loss: str = "linear"
    robust_from: float = DEFAULT_SOLVER.robust_from

    def losses(self, residuals: Array) -> Array:
        """(V,) what each observation costs, in squares of its standard deviation."""
        square, edge = (residuals**2).sum(1) / self.sigma**2, self.robust_from
        if self.loss == "huber":
            size = np.sqrt(square)
            square = np.where(size > edge, 2 * edge * size - edge**2, square)
        elif self.loss == "soft_l1":
            square = 2 * edge**2 * (np.sqrt(1 + square / edge**2) - 1)
        return np.asarray(square)

    def cost(self, residuals: Array) -> float:
        """Of the observations; the priors' part comes to it."""
        return float(self.share @ self.losses(residuals))

    def of(self, residuals: Array) -> Array:
        """(V,) weights of the squares at residuals (V, 3)."""
        size = np.sqrt((residuals**2).sum(1)) / self.sigma
        softened = np.ones(len(size))
        if self.loss == "huber":
            softened = np.minimum(1.0, self.robust_from / np.maximum(size, self.robust_from))
        elif self.loss == "soft_l1":
            softened = 1 / np.sqrt(1 + (size / self.robust_from) ** 2)
        return np.asarray(self.share * softened / self.sigma**2)


@dataclass(frozen=True, eq=False)
class Descent:
    """Where a descent ended."""

    state: State
    """There."""
    residuals: Array
    """(V, 3)."""
    jacobian: Array
    """(V, 3, P + F)."""
    converged: bool
    """Whether no step was left that lessens the cost by what counts; else the steps ran out."""
    obstacle: str = ""
    """What cut its last steps short, in words."""


def weighted_sums(jacobian: Array, residuals: Array, w: Array) -> tuple[Array, Array]:
    """J'WJ (Q, Q) and J'Wr (Q,) of observations with weights (V,)."""
    flat = jacobian.reshape(3 * len(jacobian), jacobian.shape[2])
    weighted = flat * np.repeat(w, 3)[:, None]
    return weighted.T @ flat, weighted.T @ residuals.ravel()


def normal_equations(
    model: ArmModel, weights: Weights, state: State, residuals: Array, jacobian: Array
) -> tuple[Array, Array]:
    """J'WJ with the priors (Q, Q), and half the gradient (Q,)."""
    square, slope = weighted_sums(jacobian, residuals, weights.of(residuals))
    count = len(state.x)
    inverse = 1 / weights.prior**2
    square[np.arange(count), np.arange(count)] += inverse
    slope[:count] += (state.x - model.start.x) * inverse
    return square, slope


def descend(
    model: ArmModel,
    weights: Weights,
    start: State,
    *,
    jacobian: Array | None = None,
    first: Array | None = None,
    solver: FitSolver = DEFAULT_SOLVER,
) -> Descent:
    """The least cost near a start at which every row can be solved.

    Args:
        jacobian: to keep throughout, where the start is close to the answer; None is that of every state, or, where it
            is costly, of those at which an older one no longer serves, and of the last.
        first: that of the start, where it is known.
        solver: when it ends, among others.
    """
    bounds = np.array([[p.low, p.high] for p in model.parameters]).reshape(-1, 2).T
    state = State(np.clip(start.x, *bounds), start.registration)
    residuals = model.residuals(state)
    known = first if jacobian is None else jacobian
    slopes, fresh = model.jacobian(state) if known is None else known, True
    cost, damping, obstacle = cost_of(model, weights, state, residuals), solver.first_damping, ""
    for _ in range(solver.iterations):
        square, slope = normal_equations(model, weights, state, residuals, slopes)
        least = max(solver.settled, solver.nearly_settled) if model.costly(state) else solver.settled
        before, accepted, enough = cost, False, least * cost + 1e-14 * len(residuals)
        while not accepted and damping < solver.most_damping:
            step = _step(square, slope, damping, state.x, bounds)
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
            promised = float(-2 * slope @ step - step @ square @ step)
            serves = accepted and before - cost > max(float(enough), solver.faithful * promised)
            fresh = not (serves and model.costly(state))
            slopes = model.jacobian(state) if fresh else slopes
    return Descent(state, residuals, slopes, False, obstacle)


def cost_of(model: ArmModel, weights: Weights, state: State, residuals: Array) -> float:
    """What is minimised, at a state with its residuals (V, 3)."""
    return weights.cost(residuals) + float((((state.x - model.start.x) / weights.prior) ** 2).sum())


def _step(square: Array, slope: Array, damping: float, x: Array, bounds: Array) -> Array:
    """The damped step that stays within the bounds (2, P); those that a bound stops are held, the others go on."""
    size, count = len(slope), len(x)
    held = np.zeros(size, dtype=bool)
    step = np.zeros(size)
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
    scale = np.sqrt(np.maximum(np.diag(square), 1e-300))
    matrix = square / np.outer(scale, scale) + damping * np.eye(len(scale))
    return np.asarray(np.linalg.lstsq(matrix, slope / scale, rcond=1e-13)[0] / scale)


def hold_out(model: ArmModel, weights: Weights, fit: Descent, fold: Index, solver: FitSolver = DEFAULT_SOLVER) -> Array:
    """(V, 3) residuals of every observation by fits to the other folds, with the slopes of the fit to all; `fold` (N,)
    is that of each row.

    A fold without which the parameters leave the allowed robots keeps those of the whole fit.
    """
    own = fold[model.row]
    out = np.empty_like(fit.residuals)
    for k in np.unique(own):
        rest = replace(weights, share=weights.share * (own != k))
        try:
            without = descend(model, rest, fit.state, jacobian=fit.jacobian, solver=solver.by_chords)
            out[own == k] = without.residuals[own == k]
        except SolveError:
            out[own == k] = fit.residuals[own == k]
    return out


def predicted_held_out(model: ArmModel, weights: Weights, near: Descent, fold: Index) -> Array:
    """(V, 3) residuals held out, were the observations linear in the parameters around a state: nothing is solved."""
    own, w, jacobian, x = fold[model.row], weights.of(near.residuals), near.jacobian, near.state.x
    square, slope = normal_equations(model, weights, near.state, near.residuals, jacobian)
    free = np.full(model.freedoms, np.inf)
    low, high = (np.array([getattr(p, side) for p in model.parameters]) - x for side in ("low", "high"))
    bounds = np.append(low, -free), np.append(high, free)
    out = np.empty_like(near.residuals)
    for k in np.unique(own):
        mine = own == k
        a, b = weighted_sums(jacobian[mine], near.residuals[mine], w[mine])
        out[mine] = near.residuals[mine] + jacobian[mine] @ np.clip(-solved(square - a, slope - b), *bounds)
    return out


def bootstrap_errors(model: ArmModel, weights: Weights, fit: Descent, block: Index, draws: int) -> Array:
    """(P,) standard errors from blocks of rows, (N,) the block of each, drawn again with replacement.

    Each draw is refitted to first order (one Gauss-Newton step from the fit), so that nothing is solved.
    """
    own, w = block[model.row], weights.of(fit.residuals)
    labels = np.unique(own)
    parts = [weighted_sums(fit.jacobian[own == k], fit.residuals[own == k], w[own == k]) for k in labels]
    squares, slopes = np.array([a for a, _ in parts]), np.array([b for _, b in parts])
    whole = normal_equations(model, weights, fit.state, fit.residuals, fit.jacobian)
    prior = whole[0] - squares.sum(0), whole[1] - slopes.sum(0)
    draw = np.random.default_rng(1).multinomial(len(labels), np.full(len(labels), 1 / len(labels)), draws)
    steps = [solved(np.tensordot(n, squares, 1) + prior[0], np.tensordot(n, slopes, 1) + prior[1]) for n in draw]
    spread = np.std(steps, axis=0, ddof=1) * np.sqrt(len(labels) / (len(labels) - 1))
    return np.asarray(spread[: len(fit.state.x)])
