"""Robust least squares against SciPy's, on a decay with outliers; bounds, priors, and steps that have no answer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import scipy

from tubeopt.errors import SolveError
from tubeopt.solvers.robust_least_squares import Weights, descend
from tubeopt.typing import Array

TIME = np.linspace(0.0, 4.0, 40)
TRUTH = np.array([2.0, 0.7])
NOISE = 0.02


@dataclass(frozen=True, eq=False)
class Decay:
    """x = (size, rate) of a decay."""

    x: Array

    def moved(self, step: Array) -> Decay:
        """After a step."""
        return Decay(self.x + step)


class Seen:
    """Readings of a decay with outliers, which has no answer for rates above `most`."""

    freedoms = 0

    def __init__(self, start: tuple[float, float], *, most: float = np.inf, high: float = np.inf) -> None:
        random = np.random.default_rng(0)
        self.start, self.most, self.bounds = Decay(np.array(start)), most, np.array([[0.0, 0.0], [np.inf, high]])
        self.reading = TRUTH[0] * np.exp(-TRUTH[1] * TIME) + NOISE * random.normal(size=len(TIME))
        self.reading[::9] += 0.5

    def residuals(self, state: Decay) -> Array:
        """(V, 1)."""
        if state.x[1] > self.most:
            raise SolveError("there is no such decay")
        return np.asarray(state.x[0] * np.exp(-state.x[1] * TIME) - self.reading)[:, None]

    def jacobian(self, state: Decay) -> Array:
        """(V, 1, 2)."""
        fall = np.exp(-state.x[1] * TIME)
        return np.column_stack([fall, -state.x[0] * TIME * fall])[:, None]

    def costly(self, state: Decay) -> bool:
        """They are not."""
        return False


def weights(loss: str, prior: float = np.inf) -> Weights:
    """Of readings with the same noise."""
    return Weights(np.full(len(TIME), NOISE), np.ones(len(TIME)), np.full(2, prior), loss)


@pytest.mark.parametrize("loss", ["linear", "huber", "soft_l1"])
@pytest.mark.parametrize("high", [np.inf, 0.5])
def test_the_minimum_is_that_of_scipy(loss: str, high: float) -> None:
    observed = Seen((1.0, 0.3), high=high)
    result = descend(observed, weights(loss), observed.start)
    other = scipy.optimize.least_squares(
        lambda x: (x[0] * np.exp(-x[1] * TIME) - observed.reading) / NOISE,
        [1.0, 0.3],
        bounds=([0, 0], [np.inf, high]),
        loss=loss,
        f_scale=3.0,
        xtol=1e-12,
        ftol=1e-12,
    )
    assert result.converged
    np.testing.assert_allclose(result.state.x, other.x, rtol=1e-3)
    assert weights(loss).cost(result.residuals) <= 2 * other.cost * (1 + 1e-6)


def test_a_robust_loss_leaves_outliers_aside() -> None:
    observed = Seen((1.0, 0.3))
    plain, robust = (descend(observed, weights(loss), observed.start).state.x for loss in ("linear", "huber"))
    assert np.abs(robust - TRUTH).max() < 0.3 * np.abs(plain - TRUTH).max()


def test_steps_to_where_there_is_no_answer_are_shortened() -> None:
    free = descend(Seen((0.2, 0.05)), weights("huber"), Decay(np.array([0.2, 0.05]))).state.x
    wall = Seen((0.2, 0.05), most=free[1] + 0.01)
    result = descend(wall, weights("huber"), wall.start)
    np.testing.assert_allclose(result.state.x, free, rtol=1e-3)
    short = Seen((0.2, 0.05), most=free[1] - 0.1)
    stopped = descend(short, weights("huber"), short.start)
    assert stopped.state.x[1] <= short.most
    assert "no such decay" in stopped.obstacle


def test_a_strong_prior_holds_the_start() -> None:
    observed = Seen((1.0, 0.3))
    held = descend(observed, weights("linear", 1e-9), observed.start)
    np.testing.assert_allclose(held.state.x, [1.0, 0.3], atol=1e-8)
