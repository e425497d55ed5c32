"""Errors of rows that the fit has not seen, and intervals from blocks of rows drawn again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import SolveError
from ..typing import Array, Index
from .descent import DEFAULT_SOLVER, Descent, FitSolver, Weights, descend, normal_equations, weighted_sums
from .model import ArmModel


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
        out[mine] = near.residuals[mine] + jacobian[mine] @ np.clip(-_solve(square - a, slope - b), *bounds)
    return out


def _solve(square: Array, slope: Array) -> Array:
    scale = np.sqrt(np.maximum(np.diag(square), 1e-300))
    return np.asarray(np.linalg.lstsq(square / np.outer(scale, scale), slope / scale, rcond=1e-13)[0] / scale)


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
    steps = [_solve(np.tensordot(n, squares, 1) + prior[0], np.tensordot(n, slopes, 1) + prior[1]) for n in draw]
    spread = np.std(steps, axis=0, ddof=1) * np.sqrt(len(labels) / (len(labels) - 1))
    return np.asarray(spread[: len(fit.state.x)])
