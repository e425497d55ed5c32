"""Small least squares by the compiled kernel against those of SciPy's non-negative least squares."""

from __future__ import annotations

import numpy as np
import pytest

from tests.examples import THESIS
from tubeopt.inverse.least_squares import constrained_least_squares
from tubeopt.solvers.compiled.quadratic import CompiledLeastSquares, least_squares_of


@pytest.fixture(scope="module")
def solve() -> CompiledLeastSquares:
    solver = least_squares_of(THESIS)
    if solver is None:
        pytest.skip("there is no compiled kernel")
    return solver


def test_answers_and_contradictions_are_those_of_the_general_method(solve: CompiledLeastSquares) -> None:
    random, refused = np.random.default_rng(0), 0
    for _ in range(200):
        n, k = random.integers(1, 7), random.integers(1, 40)
        matrix, right = random.normal(size=(n + 3, n)), random.normal(size=n + 3)
        rows, bounds = random.normal(size=(k, n)), random.normal(size=k) - 0.5
        rows[random.random(k) < 0.2] *= 1e-3
        bounds[random.random(k) < 0.1] = -np.inf
        kept = [part.copy() for part in (matrix, right, rows, bounds)]
        known, found = constrained_least_squares(matrix, right, rows, bounds), solve(matrix, right, rows, bounds)
        assert all(np.array_equal(a, b) for a, b in zip(kept, (matrix, right, rows, bounds), strict=True))
        assert (known is None) == (found is None)
        refused += known is None
        if known is None or found is None:
            continue
        np.testing.assert_allclose(found[0], known.x, atol=1e-8 * max(1.0, np.abs(known.x).max()))
        assert set(found[1].tolist()) == set(known.active.nonzero()[0].tolist())
    assert 20 < refused < 180


def test_memory_grows_with_the_rows(solve: CompiledLeastSquares) -> None:
    rows = np.tile(np.eye(6), (500, 1))
    found = solve(np.eye(6), np.zeros(6), rows, np.linspace(0.0, 1.0, 3000))
    assert found is not None
    np.testing.assert_allclose(found[0], np.linspace(0.0, 1.0, 3000)[-6:], atol=1e-12)


def test_columns_that_depend_on_each_other_have_no_answer(solve: CompiledLeastSquares) -> None:
    assert solve(np.zeros((3, 2)), np.ones(3), np.eye(2), np.full(2, -1.0)) is None
