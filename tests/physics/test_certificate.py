"""The determinant of the snap-free certificate, of two tubes against the closed form."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from tubeopt.physics.certificate import (
    ONCE,
    WHOLE,
    base_determinant,
    bend_rate_function,
    coupling_rate_function,
    worst_function,
)


@pytest.mark.parametrize("varying", [False, True])
def test_the_determinant_of_two_tubes_is_that_of_their_difference(varying: bool) -> None:
    """Torques are opposite, T' = -c d / lambda and d' = T (1 / kt_1 + 1 / kt_2); d at the plate is what the
    transmissions are twisted by, and T is 0 at the tip. kt may differ from section to section."""
    random = np.random.default_rng(0)
    for _ in range(20):
        sections = 3
        kt = random.uniform(0.5, 2.0, (2, sections if varying else 1))
        kb, m = random.uniform(0.5, 2.0, (2, sections)), random.uniform(0.2, 2.0, (2, sections))
        m *= random.choice([-1, 1], m.shape)  # where a tube is curved the other side it is turned about
        length, straight = random.uniform(0.2, 0.8, sections), random.uniform(0.0, 1.0, 2)
        for eigenvalue in (0.3, 1.0, 4.0):
            d, torque = 1.0, 0.0
            for k in reversed(range(sections)):
                current = kt[:, k if varying else 0]
                g, c = (1 / current).sum(), abs(m[0, k] * m[1, k]) / kb[:, k].sum() / eigenvalue
                q = np.sqrt(c * g)
                cos, sin = np.cos(q * length[k]), np.sin(q * length[k])
                d, torque = d * cos - torque * g / q * sin, torque * cos + d * c / q * sin
            expected = d - torque * (straight / kt[:, 0]).sum()
            inputs = {
                "torsional_stiffness": ca.DM(kt),
                "transmission": ca.DM(straight),
                "length": ca.DM(length),
                "stiffness": ca.DM(kb),
                "moment": ca.DM(m),
            }
            assert float(base_determinant(ca.DM(eigenvalue), inputs, WHOLE)) == pytest.approx(
                expected, rel=1e-8, abs=1e-8
            )


@pytest.mark.parametrize("across", [WHOLE, ONCE])
def test_series_cross_a_quarter_of_a_wave_to_round_off(across: tuple[int, int]) -> None:
    """Of two tubes that are held at the plate itself: cos(1.5), where each can bend them by 0.75 rad."""
    inputs = {"torsional_stiffness": [2.0, 2.0], "transmission": [0.0, 0.0], "length": [1.5]}
    tubes = {"stiffness": [1.0, 1.0], "moment": [1.0, 1.0]}
    result = base_determinant(0.5, {name: ca.DM(value) for name, value in {**inputs, **tubes}.items()}, across)
    assert float(result) == pytest.approx(np.cos(1.5), abs=1e-12)


def test_tubes_curved_to_either_side_oppose_each_other_alike() -> None:
    """-sum |c_ij| (y_i - y_j)^2, whatever the signs of the curvatures."""
    kb, m, y = np.random.default_rng(1).uniform(0.5, 2.0, (3, 3))
    pull = np.outer(m, m) / kb.sum()
    true = -sum(pull[i, j] * (y[i] - y[j]) ** 2 for i in range(3) for j in range(i))
    for signs in ([1, 1, 1], [1, -1, 1], [-1, -1, 1]):
        matrix, form, _, pairs = (np.array(each) for each in worst_function(3)(kb, m * signs, y))
        assert form.item() == pytest.approx(true)
        assert y @ matrix @ y == pytest.approx(true)
        assert pairs == pytest.approx(pull * (1 - np.eye(3)))


@pytest.mark.parametrize("n", [2, 3])
def test_torsion_grows_or_oscillates_no_faster_than_its_rate(n: int) -> None:
    """kt_i y_i'' = (V'' y)_i at any rotations; two tubes that oppose each other attain it."""
    random = np.random.default_rng(2)
    kb, kt = random.uniform(0.5, 2.0, (2, n))
    m = random.uniform(0.5, 2.0, n) * np.array([1, -1, 1])[:n]
    bound = float(coupling_rate_function(n)(kb, m, kt))
    pull, rates = np.abs(m), []
    for turn in [np.arange(n) * np.pi, *random.uniform(-np.pi, np.pi, (200, n))]:
        pairs = np.outer(pull, pull) / kb.sum() * np.cos(turn[:, None] - turn) * (1 - np.eye(n))
        second = np.diag(pairs.sum(1)) - pairs
        rates.append(np.sqrt(np.abs(np.linalg.eigvals(second / kt[:, None])).max()))
    assert max(rates) <= bound * (1 + 1e-12)
    assert max(rates) >= (1 - 1e-9 if n == 2 else 0.8) * bound
    assert np.array(bend_rate_function(n)(kb, m)).ravel() == pytest.approx(pull / kb.sum())
    assert not np.array(bend_rate_function(n)(0 * kb, 0 * m)).any()
    assert float(coupling_rate_function(n)(0 * kb, 0 * m, kt)) == 0
