"""Nonlinear programs with names: scales, bounds, square systems, and the worst constraints in words."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from tubeopt.transcription.nlp import Builder, Nlp

from tubeopt import InputError


def circle_and_line(scale: float = 1.0, g_scale: float = 1.0) -> Nlp:
    """x^2 + y^2 = 25 p, x = y + 1: (4, 3) or (-3, -4) for p = 1."""
    builder = Builder()
    x = builder.variable(["x", "y"], guess=[5.0, 1.0], scale=scale)
    p = builder.parameter(1)
    builder.constrain(["circle"], x[0] ** 2 + x[1] ** 2 - 25 * p, scale=g_scale)
    builder.constrain(["line"], x[0] - x[1], lower=1.0, upper=1.0)
    return builder.build()


def hill(**bounds: Any) -> Nlp:
    """Least (x - 3)^2 + (y + 1)^2 within x + y <= 1."""
    builder = Builder()
    x = builder.variable(["x", "y"], scale=[10.0, 0.1], **bounds)
    builder.minimise((x[0] - 3) ** 2)
    builder.minimise((x[1] + 1) ** 2)
    builder.constrain(["budget"], x[0] + x[1], lower=-np.inf, upper=1.0, scale=50.0)
    return builder.build()


@pytest.mark.parametrize(("scale", "g_scale"), [(1.0, 1.0), (100.0, 1e-3), (1e-3, 1e3)])
def test_square_system_by_newton_and_by_ipopt_whatever_the_scale(scale: float, g_scale: float) -> None:
    nlp = circle_and_line(scale, g_scale)
    assert nlp.square
    x0 = nlp.guess / nlp.scale
    root, ipopt = nlp.rootfinder(), nlp.ipopt()
    for p in (1.0, 4.0):
        x = (np.sqrt(2 * 25 * p - 1) + 1) / 2
        for solution in (root(x0, p), ipopt(x0=x0, p=p, **nlp.bounds)["x"]):
            assert solution.full().ravel() * nlp.scale == pytest.approx([x, x - 1], rel=1e-10)


def test_every_entry_has_its_name_guess_and_bounds() -> None:
    builder = Builder()
    x = builder.variable(["a", "b"], guess=[1.0, 2.0], lower=0.0, upper=[3.0, np.inf], scale=[1.0, 10.0])
    builder.variable(["c"])
    builder.constrain(["f", "g"], x[:2], lower=[-1.0, 0.0], upper=5.0, scale=[1.0, 4.0])
    nlp = builder.build()
    assert nlp.names == ("a", "b", "c")
    assert nlp.constraint_names == ("f", "g")
    assert nlp.guess.tolist() == [1, 2, 0]
    assert (nlp.lower.tolist(), nlp.upper.tolist()) == ([0, 0, -np.inf], [3, np.inf, np.inf])
    assert {key: value.tolist() for key, value in nlp.bounds.items()} == {
        "lbx": [0, 0, -np.inf],
        "ubx": [3, np.inf, np.inf],
        "lbg": [-1, 0],
        "ubg": [5, 1.25],
    }
    # The unscaled unknowns (2, 30, 0) are x = (2, 3, 0) to the solver, and g = (2, 30) is (2, 7.5).
    assert ca.Function("g", [nlp.x], [nlp.constraints])([2, 3, 0]).full().ravel().tolist() == [2, 7.5]


def test_least_squares_within_bounds() -> None:
    def solve(nlp: Nlp) -> tuple[Any, Any]:
        out = nlp.ipopt()(x0=nlp.guess / nlp.scale, **nlp.bounds)
        return out["x"].full().ravel() * nlp.scale, float(out["f"])

    # Projection of (3, -1) on x + y = 1, and on x <= 1.
    x, cost = solve(hill())
    assert x == pytest.approx([2.5, -1.5], abs=1e-8)
    assert cost == pytest.approx(0.5)
    x, cost = solve(hill(upper=[1.0, np.inf]))
    assert x == pytest.approx([1.0, -1.0], abs=1e-8)
    assert cost == pytest.approx(4.0)


def test_a_program_with_an_inequality_is_not_square() -> None:
    assert not hill().square
    with pytest.raises(InputError) as caught:
        hill().rootfinder()
    assert str(caught.value) == (
        "the problem has 2 unknowns and 1 constraints; "
        "a root-finding problem must have as many equations as unknowns, and no inequality"
    )
    builder = Builder()
    x = builder.variable(["x"])
    builder.constrain(["range"], x, lower=0.0, upper=1.0)
    assert not builder.build().square


def test_worst_constraints_in_words_and_in_their_own_units() -> None:
    builder = Builder()
    x = builder.variable(["x"])
    builder.constrain(["length (mm)"], x, lower=0.0, upper=10.0, scale=1000.0)
    builder.constrain(["angle"], x)
    builder.constrain(["force", "torque"], ca.vertcat(x, x), lower=-1.0, upper=1.0)
    nlp = builder.build()
    # Scaled values: length 0.03 stands for 30 mm.
    assert nlp.worst([0.03, 0.5, -3.0, 0.9]) == [("length (mm)", 20.0), ("force", 2.0), ("angle", 0.5)]
    assert nlp.worst([0.03, 0.5, -3.0, 0.9], count=1) == [("length (mm)", 20.0)]
    assert nlp.worst([0.005, 0.0, 0.0, 0.0]) == []
    assert nlp.worst([np.nan, 0.0, 0.0, 0.0]) == [("length (mm)", np.inf)]


def test_names_and_constraints_must_agree() -> None:
    builder = Builder()
    x = builder.variable(["x", "y"])
    with pytest.raises(InputError, match=r"^1 names are given for 2 constraints; they must agree$"):
        builder.constrain(["both"], x)


def test_acceptable_is_not_converged() -> None:
    # Stopped far from the solution: the solver must say so, and not call it good enough.
    nlp = circle_and_line()
    solver = nlp.ipopt(**{"ipopt.max_iter": 2})
    solver(x0=[1e6, -1e6], p=1.0, **nlp.bounds)
    assert not solver.stats()["success"]
