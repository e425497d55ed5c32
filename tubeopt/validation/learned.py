"""Sizes of the learned changes along tubes: a Gaussian process whose hyperparameters have the greatest likelihood.

The change of a tube is the process  u*(s) = sum_j w_j P_j(s)  with Legendre polynomials P_j of root mean square 1 and
independent normal weights of deviations a r^(j - 1): it is smooth, and 0 where the data say nothing. The amplitude a of
each tube and the decay r of all are those of greatest restricted likelihood of the observations, linearised about the
fit (Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), chapters 2.7 and 5; Patterson and Thompson,
Biometrika 58 (1971)): parameters without a prior and the registration are integrated out, and so is the noise.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import scipy

from ..solvers.robust_least_squares import RobustDescent, Weights, solved, weighted_sums
from ..typing import Array, Mask
from .model import ParameterState
from .parameters import Parameter
from .sessions import Registrations, Sessions
from .tube_shapes import DEGREES, MODES

# Standard deviations of the hyperparameters, logarithms of amplitudes and the logit of the decay, about their first
# values: where the data say little they stay near.
VAGUE = 2.0

# Logarithms of amplitudes over their first values are at least this: a thousandth changes no tip.
LEAST = -7.0

# Evaluations of the likelihood, each a small determinant.
EVALUATIONS = 300


def with_learned_priors(
    model: Sessions, weights: Weights, fit: RobustDescent[ParameterState[Registrations]]
) -> tuple[Parameter, ...]:
    """Parameters of a model with the priors of random ones learned from a fit; `weights` with those of all others."""
    parameters = model.parameters
    random = np.array([p.effect.random for p in parameters], dtype=bool)
    if not random.any():
        return parameters
    places = np.array([p.which[0] for p in parameters if p.effect.random])
    _, tube = np.unique(places // MODES, return_inverse=True)
    degree = places % DEGREES
    # A first amplitude of each tube, in which the search counts: the greatest prior of its numbers.
    first = np.array([p.prior for p in parameters if p.effect.random])
    unit = np.array([first[tube == k].max() for k in range(tube.max() + 1)])

    def deviations(z: Array) -> Array:
        amplitude = unit * np.exp(np.maximum(z[:-1], LEAST))
        return np.asarray(amplitude[tube] * scipy.special.expit(z[-1]) ** degree)

    gain = _Likelihood(model, weights, fit, random)
    start = np.append(np.zeros(len(unit)), 0.4)

    def cost(z: Array) -> float:
        return gain.of(deviations(z)) + float((((z - start) / VAGUE) ** 2).sum())

    options: dict[str, Any] = {"maxfev": EVALUATIONS, "xatol": 0.02, "fatol": 0.02}
    best = scipy.optimize.minimize(cost, start, method="Nelder-Mead", options=options).x
    found = iter(deviations(best).tolist())
    return tuple(replace(p, prior=next(found)) if p.effect.random else p for p in parameters)


class _Likelihood:
    """Restricted likelihood of the observations, of deviations of random parameters."""

    def __init__(
        self,
        model: Sessions,
        weights: Weights,
        fit: RobustDescent[ParameterState[Registrations]],
        random: Mask,
    ) -> None:
        w, count = weights.of(fit.residuals), len(random)
        square, slope = weighted_sums(fit.jacobian, fit.residuals, w)
        total = float((w[:, None] * fit.residuals**2).sum())
        change = fit.state.x - np.array([p.start for p in model.parameters])
        inverse = np.where(random, 0.0, weights.prior**-2.0)
        square[np.arange(count), np.arange(count)] += inverse
        slope[:count] += inverse * change
        total += float(inverse @ change**2)
        # Without any learned change.
        back = np.zeros(len(square))
        back[:count] = np.where(random, -change, 0.0)
        total += float(2 * slope @ back + back @ square @ back)
        slope = slope + square @ back
        mine = np.flatnonzero(random)
        others = np.setdiff1d(np.arange(len(square)), mine)
        gone = np.column_stack([square[np.ix_(others, mine)], slope[others]])
        kept = np.column_stack([solved(square[np.ix_(others, others)], column) for column in gone.T])
        self.square = square[np.ix_(mine, mine)] - square[np.ix_(mine, others)] @ kept[:, :-1]
        self.slope = slope[mine] - square[np.ix_(mine, others)] @ kept[:, -1]
        self.total = total - float(slope[others] @ kept[:, -1])
        self.degrees = max(3 * len(w) - int(model.directed.sum()) - len(others), 1)

    def of(self, deviations: Array) -> float:
        """Minus twice the logarithm of the likelihood, the noise being the most likely one."""
        # Deviations count in units of the noise, whose size the weights have.
        matrix = np.eye(len(deviations)) + deviations[:, None] * self.square * deviations
        factor = scipy.linalg.cho_factor(matrix, lower=True)
        slope = deviations * self.slope
        rest = max(self.total - float(slope @ scipy.linalg.cho_solve(factor, slope)), 1e-300)
        return float(self.degrees * np.log(rest) + 2 * np.log(np.diag(factor[0])).sum())
