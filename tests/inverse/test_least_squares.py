"""Constrained least squares against SciPy's SLSQP, on random problems."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from tubeopt.inverse.least_squares import constrained_least_squares


@pytest.mark.parametrize("seed", range(20))
def test_least_squares_with_inequalities(seed: int) -> None:
    random = np.random.default_rng(seed)
    matrix, right = random.normal(size=(8, 5)), random.normal(size=8)
    rows, inside = random.normal(size=(12, 5)), random.normal(size=5)
    bounds = rows @ inside - random.uniform(0.0, 1.0, 12) * (random.random(12) < 0.7)
    found = constrained_least_squares(matrix, right, rows, bounds)
    assert found is not None
    slack = rows @ found.x - bounds
    assert slack.min() > -1e-10
    # Optimal where the gradient is a non-negative combination of the active rows (Karush, Kuhn, Tucker).
    gradient = matrix.T @ (matrix @ found.x - right)
    weights = np.linalg.lstsq(rows[found.active].T, gradient, rcond=None)[0]
    np.testing.assert_allclose(rows[found.active].T @ weights, gradient, atol=1e-8)
    assert (weights > -1e-8).all()
    assert np.abs(slack[found.active]).max(initial=0.0) < 1e-9
    other = minimize(
        lambda x: 0.5 * np.sum((matrix @ x - right) ** 2),
        inside,
        method="SLSQP",
        constraints={"type": "ineq", "fun": lambda x: rows @ x - bounds},
        options={"ftol": 1e-14, "maxiter": 500},
    )
    np.testing.assert_allclose(found.x, other.x, atol=1e-5)


def test_without_active_inequalities_it_is_least_squares() -> None:
    matrix, right = np.random.default_rng(0).normal(size=(6, 3)), np.ones(6)
    found = constrained_least_squares(matrix, right, np.eye(3), np.array([-1e3, -np.inf, -1e3]))
    assert found is not None
    np.testing.assert_allclose(found.x, np.linalg.lstsq(matrix, right, rcond=None)[0], atol=1e-12)
    assert not found.active.any()


def test_a_contradiction_is_told() -> None:
    rows = np.array([[1.0, 0.0], [-1.0, 0.0]])
    assert constrained_least_squares(np.eye(2), np.zeros(2), rows, np.array([1.0, 0.5])) is None
    assert constrained_least_squares(np.eye(2), np.zeros(2), np.zeros((1, 2)), np.array([1.0])) is None


def test_an_equation_as_two_inequalities() -> None:
    rows = np.array([[1.0, 1.0], [-1.0, -1.0]])
    found = constrained_least_squares(np.eye(2), np.zeros(2), rows, np.array([2.0, -2.0]))
    assert found is not None
    np.testing.assert_allclose(found.x, [1.0, 1.0], atol=1e-12)
