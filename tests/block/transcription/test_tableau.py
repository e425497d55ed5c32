"""Collocation tableaux: known ones, orders of quadrature and stages, interpolation and its integrals."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from tubeopt import InputError
from tubeopt.block.transcription.tableau import FAMILIES, tableau

DEGREES = range(1, 11)


def test_midpoint_and_gauss_of_order_4() -> None:
    assert tableau("gauss", 1).nodes == pytest.approx([0.5])
    root = np.sqrt(3) / 6
    t = tableau("gauss", 2)
    assert t.nodes == pytest.approx([0.5 - root, 0.5 + root])
    assert t.matrix == pytest.approx(np.array([[0.25, 0.25 - root], [0.25 + root, 0.25]]))


def test_implicit_euler_and_radau_of_order_3() -> None:
    t = tableau("radau", 1)
    assert (t.nodes.tolist(), t.weights.tolist()) == ([1.0], [1.0])
    t = tableau("radau", 2)
    assert t.matrix == pytest.approx(np.array([[5 / 12, -1 / 12], [3 / 4, 1 / 4]]))
    assert t.weights == pytest.approx([3 / 4, 1 / 4])


@pytest.mark.parametrize("degree", DEGREES)
@pytest.mark.parametrize("family", FAMILIES)
def test_quadrature_is_exact_to_its_order_and_no_further(family: str, degree: int) -> None:
    t = tableau(family, degree)
    order = 2 * degree if family == "gauss" else 2 * degree - 1
    for power in range(order):
        assert t.weights @ t.nodes**power == pytest.approx(1 / (power + 1), rel=1e-13)
    if degree <= 6:  # beyond, the term that is missed drowns in round-off
        assert abs(t.weights @ t.nodes**order - 1 / (order + 1)) > 1e-9


@pytest.mark.parametrize("degree", DEGREES)
@pytest.mark.parametrize("family", FAMILIES)
def test_stages_integrate_polynomials_of_the_degree(family: str, degree: int) -> None:
    t = tableau(family, degree)
    for power in range(degree):
        assert t.matrix @ t.nodes**power == pytest.approx(t.nodes ** (power + 1) / (power + 1), abs=1e-13)


@pytest.mark.parametrize("degree", DEGREES)
def test_points_lie_in_order_inside_and_radau_ends_at_one(degree: int) -> None:
    for family in FAMILIES:
        t = tableau(family, degree)
        assert t.degree == degree
        assert (np.diff(t.nodes) > 0).all()
        assert t.nodes[0] > 0
        assert (t.weights > 0).all()
    assert tableau("gauss", degree).nodes[-1] < 1
    radau = tableau("radau", degree)
    assert radau.nodes[-1] == 1.0
    # The last stage is the step itself: stiffly accurate.
    assert radau.matrix[-1] == pytest.approx(radau.weights, abs=1e-14)


@pytest.mark.parametrize("degree", DEGREES)
def test_gauss_is_symplectic(degree: int) -> None:
    # b_i a_ij + b_j a_ji = b_i b_j: what makes the condensed compliance symmetric.
    t = tableau("gauss", degree)
    product = t.weights[:, None] * t.matrix
    assert product + product.T == pytest.approx(np.outer(t.weights, t.weights), abs=1e-14)


@pytest.mark.parametrize("degree", DEGREES)
@pytest.mark.parametrize("family", FAMILIES)
def test_interpolation_and_its_integrals(family: str, degree: int) -> None:
    t = tableau(family, degree)
    at = np.linspace(0, 1, 23)
    assert t.lagrange(t.nodes) == pytest.approx(np.eye(degree), abs=1e-11)
    polynomial = Polynomial(np.random.default_rng(degree).normal(size=degree))
    samples = polynomial(t.nodes)
    for integrals in range(3):
        expected = polynomial.integ(integrals) if integrals else polynomial
        assert t.lagrange(at, integrals=integrals) @ samples == pytest.approx(expected(at), abs=1e-11)
    assert t.lagrange([1.0], integrals=1)[0] == pytest.approx(t.weights, abs=1e-13)
    assert t.lagrange(t.nodes, integrals=1) == pytest.approx(t.matrix, abs=1e-13)


def test_built_once() -> None:
    assert tableau("gauss", 6) is tableau("gauss", 6)


def test_what_there_is_not() -> None:
    with pytest.raises(InputError, match=r"^family is 'gaus'; it must be one of gauss, radau; did you mean 'gauss'\?$"):
        tableau("gaus", 6)
    with pytest.raises(InputError, match=r"^degree is 0; it must be at least 1$"):
        tableau("radau", 0)
