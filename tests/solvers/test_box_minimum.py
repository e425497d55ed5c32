"""Minimum of a quadratic within a box: optimality conditions, and a search of all active sets."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from tubeopt.solvers.box_minimum import minimum_in_box
from tubeopt.solvers.robust_least_squares import bounded_step
from tubeopt.typing import Array


def by_enumeration(square: Array, slope: Array, low: Array, high: Array) -> float:
    """Least value over all active sets: a component at its lower bound, at its upper bound, or free."""
    best = np.inf
    for sides in product((-1, 0, 1), repeat=len(slope)):
        side = np.array(sides)
        x = np.where(side < 0, low, high)
        free = side == 0
        held = np.where(free, 0.0, x)
        x[free] = np.linalg.lstsq(square[np.ix_(free, free)], -(slope + square @ held)[free], rcond=None)[0]
        if (x >= low - 1e-12).all() and (x <= high + 1e-12).all():
            best = min(best, float(0.5 * x @ square @ x + slope @ x))
    return best


def problem(seed: int, rank: int) -> tuple[Array, Array, Array, Array]:
    """Quadratic of a rank in five components, correlated, and a box."""
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(rank, 5)) @ np.diag([1, 3, 0.3, 10, 1])
    low = -rng.uniform(0, 1, 5)
    return matrix.T @ matrix, matrix.T @ rng.normal(size=rank) * 3, low, low + rng.uniform(0, 2, 5)


@pytest.mark.parametrize("rank", [3, 5, 8])
@pytest.mark.parametrize("seed", range(12))
def test_no_active_set_is_better(seed: int, rank: int) -> None:
    square, slope, low, high = problem(seed, rank)
    step = bounded_step(square, slope, (low, high))
    assert (step >= low).all()
    assert (step <= high).all()
    value = 0.5 * step @ square @ step + slope @ step
    assert value == pytest.approx(by_enumeration(square, slope, low, high), rel=1e-9, abs=1e-12)


def test_a_component_that_was_cut_is_released() -> None:
    """The free minimum (2, -3) is outside of both bounds; at the least value x is inside."""
    square = np.array([[1.0, 0.9], [0.9, 1.0]])
    slope = -square @ [2.0, -3.0]
    step = bounded_step(square, slope, (np.array([-5.0, -1.0]), np.array([1.0, 5.0])))
    # With y at -1 the first component is 2 - 0.9 * 2 = 0.2; cutting both leaves it at 1.
    assert step == pytest.approx([0.2, -1.0])


def test_equal_bounds_fix_a_component() -> None:
    square, slope, low, high = problem(1, 8)
    low[2] = high[2] = 0.7
    assert bounded_step(square, slope, (low, high))[2] == 0.7


@pytest.mark.parametrize("damping", [0.1, 10.0])
def test_damping_adds_to_the_diagonal(damping: float) -> None:
    square, slope, low, high = problem(3, 8)
    step = bounded_step(square, slope, (low, high), damping=damping)
    same = bounded_step(square + damping * np.diag(np.diag(square)), slope, (low, high))
    assert step == pytest.approx(same, abs=1e-12)


def test_a_start_at_the_minimum_stays() -> None:
    square, slope, low, high = problem(4, 8)
    least = bounded_step(square, slope, (low, high))
    again = minimum_in_box(square, slope, (low, high), least, solve=np.linalg.solve, round_off=1e-9)
    assert again is not None
    assert again.x == pytest.approx(least, abs=1e-12)
    assert again.inside.tolist() == ((least > low) & (least < high)).tolist()
