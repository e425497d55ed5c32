"""Nelder and Mead's method from many starts against that of SciPy, and minima that are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize, rosen

from tubeopt.stability.worst import minimise_together
from tubeopt.typing import Array


def rosenbrock(points: Array) -> Array:
    return np.array([rosen(point) for point in points])


@pytest.mark.parametrize("d", [2, 3])
def test_simplices_shrink_to_the_minimum_in_as_many_evaluations_as_those_of_scipy(d: int) -> None:
    starts = np.random.default_rng(0).uniform(-1.0, 2.0, (4, d))
    starts[0, 0] = 0.0
    rows = np.zeros(1, dtype=int)

    def counted(points: Array) -> Array:
        rows[0] += len(points)
        return rosenbrock(points)

    result = minimise_together(counted, starts, x=1e-6, f=1e-9)
    known = [minimize(rosen, start, method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-9}) for start in starts]
    for (point, value), one in zip(result, known, strict=True):
        assert point == pytest.approx(np.ones(d), abs=1e-4)
        assert value == pytest.approx(rosen(point), abs=1e-15)
        assert value <= max(one.fun, 1e-8)
    assert rows[0] <= 1.2 * sum(one.nfev for one in known)
