"""Programs with names as solvers: whatever the scale, within bounds, and never merely acceptable."""

from __future__ import annotations

import numpy as np
import pytest

from tubeopt import InputError, Ipopt, Problem, ProblemStatus


def circle_and_line(scale: float = 1.0, row_scale: float = 1.0) -> Problem:
    """x^2 + y^2 = 25 p, x = y + 1: (4, 3) or (-3, -4) for p = 1."""
    problem = Problem("circle and line")
    x = problem.variable("x", 2, guess=[5.0, 1.0], scale=scale)
    p = problem.parameter("p", 1.0)
    problem.subject_to("circle", x[0] ** 2 + x[1] ** 2 - 25 * p, upper=0.0, scale=row_scale)
    problem.subject_to("line", x[0] - x[1], lower=1.0, upper=1.0)
    return problem


@pytest.mark.parametrize("expand", [False, True])
@pytest.mark.parametrize(("scale", "row_scale"), [(1.0, 1.0), (100.0, 1e-3), (1e-3, 1e3)])
def test_a_square_system_whatever_the_scale(scale: float, row_scale: float, expand: bool) -> None:
    problem = circle_and_line(scale, row_scale)
    for p in (1.0, 4.0):
        problem.set_value("p", p)
        x = (np.sqrt(2 * 25 * p - 1) + 1) / 2
        solution = problem.solve(Ipopt(tolerance=1e-12, expand=expand))
        assert solution.value("x") == pytest.approx([x, x - 1], rel=1e-10)


def test_least_squares_within_bounds_that_change() -> None:
    # Projection of (3, -1) on x + y = 1, and on x <= 1, and on x = y = 0.
    problem = Problem("hill")
    x = problem.variable("x", 2, scale=[10.0, 0.1])
    problem.subject_to("budget", x[0] + x[1], lower=-np.inf, upper=1.0, scale=50.0)
    problem.minimize((x[0] - 3) ** 2 + (x[1] + 1) ** 2)
    for lower, upper, desired, cost in (
        (-np.inf, np.inf, [2.5, -1.5], 0.5),
        (-np.inf, [1.0, np.inf], [1.0, -1.0], 4.0),
        (0.0, 0.0, [0.0, 0.0], 10.0),
    ):
        problem.set_bounds(x, lower, upper)
        solution = problem.solve(Ipopt(expand=True))
        assert solution.value("x") == pytest.approx(desired, abs=1e-7)
        assert solution.objective == pytest.approx(cost, abs=1e-6)
    with pytest.raises(InputError, match=r"bounds of 'x' are \[1.0, 1.0\] to \[0.0, 0.0\]: out of order"):
        problem.set_bounds("x", 1.0, 0.0)
    with pytest.raises(InputError, match="no constraint 'budge'; did you mean 'budget'"):
        problem.constraint("budge")


def test_acceptable_is_not_converged() -> None:
    # Stopped far from the solution: it must say so, and not call it good enough; the worst comes first.
    problem = circle_and_line()
    problem.set_guess("x", [1e6, -1e6])
    result = problem.attempt(Ipopt(iterations=2))
    assert result.status is ProblemStatus.TOO_MANY_ITERATIONS
    x, y = result.value("x")
    assert result.violations[0].name == "circle"
    assert result.violations[0].amount == pytest.approx(abs(x**2 + y**2 - 25))
    assert result.statistics.verdict == "Maximum_Iterations_Exceeded"
