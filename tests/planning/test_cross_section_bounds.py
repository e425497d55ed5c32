"""Bounds of cross-sections that are attained: of those that yield, and of those that move along tubes that vary."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tubeopt.planning import branch
from tubeopt.planning.sections import SHAPE_ERROR, Constants, CurvatureBounds, DerivativeBounds, TransportBounds, linear
from tubeopt.robots.lengthwise import Variation
from tubeopt.typing import Array

NONE = np.zeros(())


def derivatives(function: Callable[[float], Any], step: float = 4e-3) -> list[Array]:
    """Value and three derivatives at 0, by the polynomial through nine values."""
    x = step * np.arange(-4, 5)
    table = np.array([function(each) for each in x])
    found = np.linalg.solve(np.vander(x / step, increasing=True), table.reshape(len(x), -1))
    return [found[k].reshape(table.shape[1:]) * f / step**k for k, f in enumerate((1, 1, 2, 6))]


def parts(jet: DerivativeBounds) -> list[Array]:
    return [each for each in (jet.v, jet.d, jet.dd, jet.ddd) if each is not None]


YIELDS = CurvatureBounds(
    *(np.array(each) for each in ([0.4, 0.3], [[0.0, 0.2], [0.2, 0.0]], 0.5, 2.0, 0.7, 0.6, 0.8, 1.65))
)
"""Stiffness K = 2 - 0.7 x - 0.6 x^2 / 2 - 0.8 x^3 / 6 at curvature 0.5 + x; K + u K' is 1.65 there."""


def softened(x: float) -> float:
    return 2.0 - 0.7 * x - 0.6 * x**2 / 2 - 0.8 * x**3 / 6


def bent(load: float) -> float:
    """By how much the curvature grows where u K(u) does by so much, by Newton's method."""
    x = 0.0
    for _ in range(50):
        slope = softened(x) - (0.5 + x) * (0.7 + 0.6 * x + 0.4 * x**2)
        x -= ((0.5 + x) * softened(x) - 1.0 - load) / slope
    return x


def test_the_bend_of_what_yields_grows_as_the_inverse_function() -> None:
    """u K(u) = S: of the load (0.9 t + 0.8 t^2 + 0.5 t^3) K(0), to the third derivative of u and of K."""

    def load(t: float) -> float:
        return 2.0 * (0.9 * t + 0.8 * t**2 + 0.5 * t**3)

    u, k = YIELDS.along(DerivativeBounds(*map(np.array, (0.5, 0.9, 1.6, 3.0))))
    for found, true in zip(parts(u), derivatives(lambda t: 0.5 + bent(load(t))), strict=True):
        assert found == pytest.approx(true, rel=1e-6)
    for found, true in zip(parts(k), derivatives(lambda t: softened(bent(load(t))) / 2.0), strict=True):
        assert found == pytest.approx(abs(true), rel=1e-6)


def test_the_bend_of_what_yields_changes_by_turns_as_the_inverse_function() -> None:
    """S grows by a1 m_1 t + a2 m_2 t, and by m_1 a1 b1 s t + m_2 a2 b2 s t in two directions at once."""
    one, other = np.array([0.2, 0.5]), np.array([0.4, 0.1])
    moment, step = np.array([0.4, 0.3]), 1e-3

    def curvature(s: float, t: float) -> float:
        return bent(float(moment @ (s * one + t * other + s * t * one * other)))

    slope = derivatives(lambda s: curvature(s, 0.0))[1]
    assert YIELDS.change(one) == pytest.approx(slope, rel=1e-9)
    corners = [a * b * curvature(a * step, b * step) for a in (1, -1) for b in (1, -1)]
    assert YIELDS.second(one, other) == pytest.approx(sum(corners) / (4 * step**2), rel=1e-5)


def test_moments_of_what_yields_change_as_a_quotient() -> None:
    """N / K in two directions, both of which may turn tubes against each other and bend the arm."""
    one, other, step = np.array([0.2, 0.5]), np.array([0.4, 0.1]), 1e-3
    turns = [(each, each[:, None] + each) for each in (one, other)]
    bounds: Any = SimpleNamespace(bending=YIELDS, torque=np.array([0.9, 0.7]))
    bounds.bending = CurvatureBounds(*(each[None, None] for each in vars(YIELDS).values()))
    bounds.torque = bounds.torque[None, None]
    both = [(own[None, None], pair[None, None]) for own, pair in turns]
    first = branch._Bounds.torque_change(bounds, both[0])[0, 0]
    second = branch._Bounds.torque_second(bounds, both[0], both[1])[0, 0]
    u = [float(YIELDS.change(each)) for each in (one, other)]
    uu = float(YIELDS.second(one, other))

    def moment(s: float, t: float) -> Array:
        x = u[0] * s + u[1] * t + uu * s * t
        pairs = np.array(YIELDS.pairs)
        turned = s * turns[0][1] + t * turns[1][1] + s * t * turns[0][1] * turns[1][1]
        return np.asarray((np.array([0.9, 0.7]) + (pairs * turned).sum(1)) / (softened(x) / 2.0))

    assert first == pytest.approx(derivatives(lambda s: moment(s, 0.0))[1], rel=1e-6)
    corners = [a * b * moment(a * step, b * step) for a in (1, -1) for b in (1, -1)]
    assert second == pytest.approx(sum(corners) / (4 * step**2), rel=1e-4)


@pytest.mark.parametrize("share", [0.02, 0.12])
def test_a_tube_beside_the_centreline_is_softer_where_the_arm_bends_away_from_it(share: float) -> None:
    """k = kb / (1 + d u . a) of one tube, whose moment bends the arm to d u = share at most, against a."""
    kb, offset = 3.0, 0.01
    rows = np.zeros((4, 1, 2))
    bounds: Any = SimpleNamespace(moment=rows + kb * share / offset * (1 - share), bending=rows + kb)
    direction = np.array([[0.6, 0.8]]) * offset
    constants = Constants(NONE, bounds, np.array([offset]), direction, np.ones(1))  # type: ignore[arg-type]
    found = CurvatureBounds.of(constants, np.zeros(1, dtype=int))
    x = share * np.linspace(-1, 1, 401)
    assert found.max_u == pytest.approx(share / offset)
    assert found.k_uu == pytest.approx((2 * kb * offset**2 / (1 + x) ** 3).max())
    assert found.k_uuu == pytest.approx((6 * kb * offset**3 / (1 + x) ** 4).max())
    # By the mean value theorem from what k, and its gradient, are where the arm is straight.
    slope = (kb * offset / (1 + x) ** 2).max()
    assert slope <= found.k_u <= slope * (1 + 4 * share**2)
    for bound, true in ((found.stiffness, (kb / (1 + x)).min()), (found.tangent_stiffness, (kb / (1 + x) ** 2).min())):
        assert true * (1 - 8 * share**2) <= bound <= true


def varying(move: Array) -> tuple[Constants, Callable[[float], tuple[Array, Array, Array, Array]]]:
    """Two tubes whose a, 1 / kt and u*_z grow exponentially along them and whose kb falls, and these at a place that
    moves along them by `move` in the time."""
    a, r = np.array([0.7, 0.4]), np.array([1.1, 0.6])
    kb, p = np.array([2.0, 1.5]), np.array([0.5, 0.9])
    compliance, q = np.array([0.3, 0.8]), np.array([0.7, 1.3])
    twist, w = np.array([0.2, 0.6]), np.array([0.8, 0.5])

    def table(*rows: Array) -> Array:
        return np.stack([np.stack([row, row]).T for row in rows])

    bounds = Variation(
        cuts=np.zeros((2, 1)),
        bending=table(kb, *(kb * p**k for k in (1, 2, 3))),
        torsional=table(1 / compliance)[0],
        compliance=table(*(compliance * q**k for k in (1, 2, 3))),
        moment=table(*(a * r**k for k in range(4))),
        twist=table(*(twist * w**k for k in range(3))),
        stiffest=table(kb, 1 / compliance),
    )

    def at(t: float) -> tuple[Array, Array, Array, Array]:
        s = move * t
        return a * np.exp(r * s), kb * (2 - np.exp(p * s)), compliance * np.exp(q * s), twist * np.exp(w * s)

    return Constants(NONE, bounds, np.zeros(2), np.zeros((2, 2)), np.ones(2)), at  # type: ignore[arg-type]


def test_what_moving_along_tubes_that_vary_adds_has_their_derivatives() -> None:
    move = np.array([0.3, 0.5])
    constants, at = varying(move)
    transport = TransportBounds.of(constants, move, np.zeros(2, dtype=int))
    length = 1 - np.eye(2)
    for jet, function in (
        (transport.natural_curvature, lambda t: at(t)[0] / at(t)[1].sum()),
        (transport.pairs, lambda t: at(t)[0][:, None] * at(t)[0] / at(t)[1].sum() * length),
        (transport.bending_compliance, lambda t: 1 / at(t)[1].sum()),
        (transport.compliance, lambda t: at(t)[2]),
    ):
        for found, true in zip(parts(jet), derivatives(function, 0.02), strict=True):
            assert found == pytest.approx(true, rel=1e-5, abs=1e-12)
    along = derivatives(lambda s: at(s)[2], 0.02)
    assert transport.compliance_slope.v == pytest.approx(along[1] / move, rel=1e-6)
    assert transport.compliance_slope.d == pytest.approx(along[2] / move, rel=1e-6)
    assert transport.compliance_slope.dd == pytest.approx(along[3] / move, rel=1e-5)
    twist = derivatives(lambda t: at(t)[3], 0.02)
    assert transport.twist_slope.v == pytest.approx(twist[1] / move, rel=1e-6)
    assert transport.twist_slope.d == pytest.approx(twist[2] / move, rel=1e-6)
    # The natural turn is the integral of the twist; what it is off a straight line is steepest where time ends.
    assert transport.twist_deviation.d == pytest.approx(move * twist[1] / 2, rel=1e-6)
    assert transport.twist_deviation.dd == pytest.approx(move * twist[1], rel=1e-6)
    assert transport.twist_deviation.ddd == pytest.approx(move * twist[2], rel=1e-6)


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
def test_bounds_of_several_stretches_hold_in_each_of_them(order: list[int]) -> None:
    """Of two stretches with other moments and stiffnesses: the most of the one, the least of the other."""
    constants, _ = varying(np.ones(2))
    bounds, stretches = constants.bounds, [np.full(2, k) for k in order]
    for table, change in (
        (bounds.moment, 3.0),
        (bounds.bending, 0.5),
        (bounds.torsional, 0.25),
        (bounds.compliance, 2.0),
    ):
        table[..., 1] *= change
    bending, transport = (
        CurvatureBounds.of(constants, *stretches),
        TransportBounds.of(constants, np.ones(2), *stretches),
    )
    assert bending.moment == pytest.approx(3 * np.array([0.7, 0.4]))
    assert bending.stiffness == pytest.approx(0.5 * 3.5)
    assert transport.compliance.v == pytest.approx(4 * np.array([0.3, 0.8]))
    assert transport.compliance.d == pytest.approx(2 * np.array([0.3 * 0.7, 0.8 * 1.3]))
    for rates in (bounds.bending[1:], bounds.moment[1:], bounds.twist[1:], bounds.compliance):
        rates[...] = 0.0
    still = TransportBounds.of(replace(constants), np.ones(2), *stretches)
    assert still.still
    assert still.compliance.v == pytest.approx(4 * np.array([0.3, 0.8]))


def test_moving_along_tubes_changes_a_moment_by_the_sine_of_what_turns_them_apart() -> None:
    """a_i a_j sin(theta_i - theta_j) / K by time, of angles at which the sine is steepest."""
    move = np.array([0.3, 0.5])
    constants, at = varying(move)
    transport = TransportBounds.of(constants, move, np.zeros(2, dtype=int))
    turn = np.array([[0.0, 0.02], [0.02, 0.0]])

    def moment(t: float) -> Array:
        pull, stiff, *_ = at(t)
        return np.asarray((pull[:, None] * pull / stiff.sum() * np.sin(turn)).sum(1))

    assert transport.gain(turn) == pytest.approx(derivatives(moment, 0.02)[1], rel=1e-3)


@pytest.mark.parametrize(("order", "share"), [(3, SHAPE_ERROR[0]), (4, SHAPE_ERROR[1])])
def test_cubic_interpolation_is_off_by_the_integral_of_its_kernel(order: int, share: float) -> None:
    """Peano: the error at x is int G(x, s) p^(order)(s) ds, G the error of (x - s)^(order - 1) / (order - 1)! beyond s.
    So the integral of |G| is attained."""
    s = (np.arange(4000) + 0.5) / 4000
    most = 0.0
    for x in np.linspace(0.0, 1.0, 201):
        end, slope = (1 - s) ** (order - 1), (order - 1) * (1 - s) ** (order - 2)
        cubic = end * x**2 * (3 - 2 * x) - slope * x**2 * (1 - x)
        left = np.maximum(x - s, 0.0) ** (order - 1) - cubic
        most = max(most, float(np.abs(left).mean()) / float(np.prod(range(1, order))))
    assert 0.999 * share <= most <= share * (1 + 1e-6)


def test_what_goes_linearly_is_at_most_the_larger_of_its_ends() -> None:
    jet = linear(np.array([1.0, -3.0]), np.array([-2.0, 5.0]))
    assert jet.v.tolist() == [2.0, 5.0]
    assert jet.d.tolist() == [3.0, 8.0]


def test_the_tip_moves_by_the_sum_of_all_sections() -> None:
    sections = DerivativeBounds(*(np.array([[1.0, 2.0, 3.0]]) * k for k in (1, 10, 100, 1000)))
    assert branch.tip_derivatives(sections).tolist() == [[600.0], [6000.0]]
    endless = DerivativeBounds(sections.v, sections.d, np.array([[1.0, np.nan, 0.0]]), np.array([[np.inf, 0.0, 0.0]]))
    assert np.isinf(branch.tip_derivatives(endless)).all()
