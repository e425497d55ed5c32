"""How hard a robot is fitted to measured rows, what fits to some rows say of the others, and intervals from blocks.

The least squares are those of `solvers.robust_least_squares`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import SolveError
from ..solvers.robust_least_squares import (
    NEARLY_SETTLED,
    Descent,
    LeastSquaresSolver,
    Weights,
    descend,
    normal_equations,
    solved,
    weighted_sums,
)
from ..typing import Array, Index
from .model import ArmModel, State

# How a large error counts: by its square, or in the end by its size.
LOSSES = ("linear", "huber", "soft_l1")


# How a fit descends, and one of many similar fits whose slopes are known from near by, as in fits to all folds but one:
# each step there gains two digits or more.
FITTING = LeastSquaresSolver()
BY_CHORDS = LeastSquaresSolver(iterations=8, settled=NEARLY_SETTLED)

# Length of an error of three coordinates, in standard deviations of one, from which a robust loss grows like it and no
# longer like its square. Of normal errors 3 % are longer.
ROBUST_FROM = 3.0

# Draws of blocks of rows that intervals are computed from: their standard deviation is known to 4 %.
DRAWS = 400


def hold_out(model: ArmModel, weights: Weights, fit: Descent[State], fold: Index) -> Array:
    """(V, 3) residuals of every observation by fits to the other folds, with the slopes of the fit to all; `fold` (N,)
    is that of each row.

    A fold without which the parameters leave the allowed robots keeps those of the whole fit.
    """
    own = fold[model.row]
    out = np.empty_like(fit.residuals)
    for k in np.unique(own):
        rest = replace(weights, share=weights.share * (own != k))
        try:
            without = descend(model, rest, fit.state, jacobian=fit.jacobian, solver=BY_CHORDS)
            out[own == k] = without.residuals[own == k]
        except SolveError:
            out[own == k] = fit.residuals[own == k]
    return out


def predicted_held_out(model: ArmModel, weights: Weights, near: Descent[State], fold: Index) -> Array:
    """(V, 3) residuals held out, were the observations linear in the parameters around a state: nothing is solved."""
    own, w, jacobian, x = fold[model.row], weights.of(near.residuals), near.jacobian, near.state.x
    square, slope = normal_equations(model, weights, near.state, near.residuals, jacobian)
    free = np.full(model.freedoms, np.inf)
    low, high = model.bounds - x
    bounds = np.append(low, -free), np.append(high, free)
    out = np.empty_like(near.residuals)
    for k in np.unique(own):
        mine = own == k
        a, b = weighted_sums(jacobian[mine], near.residuals[mine], w[mine])
        out[mine] = near.residuals[mine] + jacobian[mine] @ np.clip(-solved(square - a, slope - b), *bounds)
    return out


def bootstrap_errors(model: ArmModel, weights: Weights, fit: Descent[State], block: Index) -> Array:
    """(P,) standard errors from blocks of rows, (N,) the block of each, drawn again with replacement.

    Each draw is refitted to first order (one Gauss-Newton step from the fit), so that nothing is solved.
    """
    own, w = block[model.row], weights.of(fit.residuals)
    labels = np.unique(own)
    parts = [weighted_sums(fit.jacobian[own == k], fit.residuals[own == k], w[own == k]) for k in labels]
    squares, slopes = np.array([a for a, _ in parts]), np.array([b for _, b in parts])
    whole = normal_equations(model, weights, fit.state, fit.residuals, fit.jacobian)
    prior = whole[0] - squares.sum(0), whole[1] - slopes.sum(0)
    draw = np.random.default_rng(1).multinomial(len(labels), np.full(len(labels), 1 / len(labels)), DRAWS)
    steps = [solved(np.tensordot(n, squares, 1) + prior[0], np.tensordot(n, slopes, 1) + prior[1]) for n in draw]
    spread = np.std(steps, axis=0, ddof=1) * np.sqrt(len(labels) / (len(labels) - 1))
    return np.asarray(spread[: len(fit.state.x)])
