"""Least squares with inequalities, compiled and by SciPy: against SLSQP, the optimality conditions, and each other."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import minimize

from tubeopt.solvers.compiled import quadratic
from tubeopt.solvers.compiled.quadratic import (
    MOST_VARIABLES,
    LeastSquares,
    by_least_distance,
    compiled_least_squares,
    constrained_least_squares,
)
from tubeopt.typing import Array

Solve = Callable[[Array, Array, Array, Array], LeastSquares | None]


def compiled(*problem: Array) -> LeastSquares | None:
    """By the kernel, which must be there."""
    if compiled_least_squares() is None:
        pytest.skip("there is no compiled kernel")
    return constrained_least_squares(*problem)


@pytest.fixture(params=[compiled, by_least_distance])
def solve(request: pytest.FixtureRequest) -> Solve:
    """One method after the other."""
    method: Solve = request.param
    return method


@pytest.mark.parametrize("seed", range(20))
def test_the_answer_is_that_of_slsqp_and_optimal(solve: Solve, seed: int) -> None:
    random = np.random.default_rng(seed)
    matrix, right = random.normal(size=(8, 5)), random.normal(size=8)
    rows, inside = random.normal(size=(12, 5)), random.normal(size=5)
    bounds = rows @ inside - random.uniform(0.0, 1.0, 12) * (random.random(12) < 0.7)
    solution = solve(matrix, right, rows, bounds)
    assert solution is not None
    slack = rows @ solution.x - bounds
    assert slack.min() > -1e-10
    # Optimal where the gradient is a non-negative combination of the active rows (Karush, Kuhn, Tucker).
    gradient = matrix.T @ (matrix @ solution.x - right)
    weights = np.linalg.lstsq(rows[solution.active].T, gradient, rcond=None)[0]
    np.testing.assert_allclose(rows[solution.active].T @ weights, gradient, atol=1e-8)
    assert (weights > -1e-8).all()
    assert np.abs(slack[solution.active]).max(initial=0.0) < 1e-9
    other = minimize(
        lambda x: 0.5 * np.sum((matrix @ x - right) ** 2),
        inside,
        method="SLSQP",
        constraints={"type": "ineq", "fun": lambda x: rows @ x - bounds},
        options={"ftol": 1e-14, "maxiter": 500},
    )
    np.testing.assert_allclose(solution.x, other.x, atol=1e-5)


def test_without_active_inequalities_it_is_least_squares(solve: Solve) -> None:
    matrix, right = np.random.default_rng(0).normal(size=(6, 3)), np.ones(6)
    desired = np.linalg.lstsq(matrix, right, rcond=None)[0]
    for rows, bounds in ((np.eye(3), np.array([-1e3, -np.inf, -1e3])), (np.zeros((0, 3)), np.zeros(0))):
        solution = solve(matrix, right, rows, bounds)
        assert solution is not None
        np.testing.assert_allclose(solution.x, desired, atol=1e-12)
        assert not len(solution.active)


def test_a_contradiction_has_no_answer(solve: Solve) -> None:
    rows = np.array([[1.0, 0.0], [-1.0, 0.0]])
    assert solve(np.eye(2), np.zeros(2), rows, np.array([1.0, 0.5])) is None


def test_a_row_of_zeros_contradicts_a_positive_bound_only(solve: Solve) -> None:
    rows = np.array([[0.0, 0.0], [1.0, 0.0]])
    assert solve(np.eye(2), np.zeros(2), rows, np.array([1.0, 0.5])) is None
    solution = solve(np.eye(2), np.zeros(2), rows, np.array([0.0, 0.5]))
    assert solution is not None
    np.testing.assert_allclose(solution.x, [0.5, 0.0], atol=1e-12)


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e6])
def test_an_equation_as_two_inequalities(solve: Solve, size: float) -> None:
    """Round-off in the one does not contradict the other, however large or small the numbers."""
    random = np.random.default_rng(1)
    for _ in range(50):
        row, base, inside = random.normal(size=4), random.normal(size=4) * size, random.normal(size=4) * size
        rows, bounds = np.array([row, -row]), row @ inside * np.array([1.0, -1.0])
        solution = solve(np.diag([1.0, 2.0, 3.0, 4.0]), base, rows, bounds)
        assert solution is not None
        assert row @ solution.x == pytest.approx(row @ inside, abs=1e-9 * size)


def test_both_give_the_same_answers_and_contradictions() -> None:
    random, refused = np.random.default_rng(0), 0
    for _ in range(200):
        n, k = random.integers(1, 7), random.integers(1, 40)
        problem = matrix, right, rows, bounds = (
            random.normal(size=(n + 3, n)),
            random.normal(size=n + 3),
            random.normal(size=(k, n)),
            random.normal(size=k) - 0.5,
        )
        rows[random.random(k) < 0.2] *= 1e-3
        bounds[random.random(k) < 0.1] = -np.inf
        retained = [part.copy() for part in problem]
        known, result = by_least_distance(matrix, right, rows, bounds), compiled(matrix, right, rows, bounds)
        assert all(np.array_equal(a, b) for a, b in zip(retained, problem, strict=True))
        assert (known is None) == (result is None)
        refused += known is None
        if known is None or result is None:
            continue
        np.testing.assert_allclose(result.x, known.x, atol=1e-8 * max(1.0, np.abs(known.x).max()))
        assert set(result.active.tolist()) == set(known.active.tolist())
    assert 20 < refused < 180


def test_memory_grows_with_the_rows(solve: Solve) -> None:
    rows = np.tile(np.eye(6), (500, 1))
    solution = solve(np.eye(6), np.zeros(6), rows, np.linspace(0.0, 1.0, 3000))
    assert solution is not None
    np.testing.assert_allclose(solution.x, np.linspace(0.0, 1.0, 3000)[-6:], atol=1e-12)


def test_columns_that_depend_on_each_other_have_no_compiled_answer() -> None:
    assert compiled(np.zeros((3, 2)), np.ones(3), np.eye(2), np.full(2, -1.0)) is None


def test_more_variables_than_the_kernel_has_room_for_go_to_scipy(monkeypatch: pytest.MonkeyPatch) -> None:
    requested = []
    monkeypatch.setattr(quadratic, "compiled_least_squares", lambda: requested.append(1))
    n = MOST_VARIABLES + 1
    result = constrained_least_squares(np.eye(n), np.zeros(n), np.eye(n), np.ones(n))
    assert result is not None
    np.testing.assert_allclose(result.x, 1.0, atol=1e-12)
    assert not requested
