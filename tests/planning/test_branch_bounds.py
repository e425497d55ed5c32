"""Bounds of the branch between two equilibria, piece by piece: products and sums that are attained, by closed forms."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.planning.test_cross_section_bounds import derivatives, parts
from tests.planning.test_sharp_bounds import NONE, STEPPED, between
from tubeopt.planning import branch
from tubeopt.planning.sections import PARTS, DerivativeBounds
from tubeopt.typing import Array


def bare(**parts: Any) -> Any:
    """Bounds of an interval of which only these are known."""
    result = branch._Bounds.__new__(branch._Bounds)
    vars(result).update(parts)
    return result


def growing(random: Any, *shape: int) -> tuple[DerivativeBounds, Any]:
    """What grows linearly to the end of the time, as a bound and as a function of the time before the end."""
    value, rate = random.uniform(1, 2, (2, 1, *shape))
    return DerivativeBounds(value, rate, 0 * rate), lambda t: value[0] + rate[0] * t


def rate_at_the_end(function: Any) -> Array:
    return np.asarray((function(1e-4) - function(-1e-4)) / 2e-4)


def test_what_bends_a_turn_between_samples_changes_as_the_product_of_what_does() -> None:
    """h^2 (g M / kt + t (1 / kt)' + twist') + h w d u_x by time, of one tube in one section, all of which grow."""
    random, offset, turn, tangent_stiffness, bow = np.random.default_rng(5), 0.3, 0.4, 0.7, 0.2
    (h, length), (moment, m) = growing(random, 1), growing(random, 1, 1)
    (compliance, e), (compliance_slope, ee), (twist_slope, ww) = (growing(random, 1, 1) for _ in range(3))
    transport = SimpleNamespace(still=False, compliance_slope=compliance_slope, twist_slope=twist_slope)
    largest = np.array([[0.6]])
    bending = SimpleNamespace(
        max_u=largest,
        change=lambda by: tangent_stiffness * by.sum(-1),
        second=lambda one, other: bow * (one * other).sum(-1),
    )
    bounds = bare(
        length=h, compliance=compliance, transport=transport, bending=bending, offset=np.array([offset]), zero=NONE
    )
    bounds.chord = lambda by: None
    bounds.cross_sections = lambda course: (moment, None)

    def bends(t: float) -> Array:
        g = 1 + offset * (0.6 + tangent_stiffness * turn * t)
        torque = length(t) * m(t)
        speed = length(t) * g * torque * e(t)
        along = tangent_stiffness * speed + bow * turn * t * speed
        plain = length(t) ** 2 * (g * m(t) * e(t) + torque * ee(t) + ww(t))
        return np.asarray(plain + length(t) * torque * e(t) * offset * along)

    result = bounds._between_samples((NONE + turn, NONE[..., None])).item()
    assert result == pytest.approx(rate_at_the_end(bends).item() / (8 * PARTS**2), rel=1e-6)


@pytest.mark.parametrize("moving", [True, False])
def test_what_the_linearised_equations_make_of_a_turn_changes_as_the_product_of_what_does(moving: bool) -> None:
    """|beta| v(0) + int h (g v + g' w), v and w of moments that change, by time; at rest with fixed sections."""
    random, offset, count = np.random.default_rng(6), np.array([0.3, 0.2]), 3
    (h, length), (spring, held), (compliance, e) = growing(random, count), growing(random, 2), growing(random, 2)
    (varied, v), (gained, g) = growing(random, count, 2), growing(random, count, 2)
    largest, change = random.uniform(0.1, 0.2, (2, count))
    torque, more = random.uniform(1, 2, (2, count, 2))
    bending = SimpleNamespace(max_u=largest[None], change=lambda by: change[None])
    bounds = bare(
        length=h, transmission=spring, compliance=compliance, bending=bending, offset=offset, torque=torque[None]
    )
    bounds.zero, bounds.torque_change = np.zeros((1, count, 2)), lambda by: more[None]

    def made(t: float) -> Array:
        s = t if moving else 0.0
        steps = length(s)[:, None]
        gain, stretch = steps * v(t), (largest + change * t)[:, None] * offset
        mean = np.cumsum(gain[::-1], axis=0)[::-1] - gain / 2
        twist = np.cumsum((steps * (torque + more * t))[::-1], axis=0)[::-1] * e(s)
        along = np.cumsum(steps * ((1 + stretch) * mean * e(s) + g(t) * twist), axis=0)
        return np.asarray(held(s) * gain.sum(0) + along)

    result = bounds._jacobian_change(varied, gained, (np.zeros((1, count, 2)), None), moving)[0]
    assert result == pytest.approx(rate_at_the_end(made), rel=1e-6)


def test_the_ball_takes_what_changes_the_linearised_equations_by_time_and_by_turns() -> None:
    """First and second derivatives of moments and bends; where places move along tubes, what that adds by time."""
    flat, requested = DerivativeBounds(NONE, NONE, NONE, NONE), []

    def varied(moments: DerivativeBounds, gained: DerivativeBounds, by: Any, moving: bool) -> Array:
        requested.append(
            ([float(each.item()) for each in (moments.v, moments.d, gained.v, gained.d)], by[0].item(), moving)
        )
        return NONE

    still: Any = SimpleNamespace(
        weight=(NONE + 1, NONE[..., None] + 1),
        bending=SimpleNamespace(max_u=NONE[0], change=lambda y: NONE[0] + 0.1, second=lambda y, by: NONE[0] + 0.2),
        transport=SimpleNamespace(gain=lambda pair: 0.03 * pair[..., 0]),
        zero=NONE,
        chord=lambda turn: None,
        cross_sections=lambda course: (flat, flat),
        rotation=lambda moment, stretch: flat,
        torque_change=lambda y: NONE + 0.4,
        torque_second=lambda y, by: NONE + 0.5,
        response=lambda turn: turn,
        norm=lambda turn: turn[0][0, 0],
        _stretch=lambda u: u[..., None],
        _jacobian_change=varied,
    )
    branch._Bounds.ball(still, (NONE + 0.7, NONE[..., None] + 0.7))
    numbers, *paths = zip(*requested, strict=True)
    assert np.array(numbers) == pytest.approx(np.array([[0.4, 0.53, 0.1, 0.2], [0.4, 0.5, 0.1, 0.2]]))
    assert paths == [(0.7, 1.0), (True, False)]


def test_the_natural_turn_of_tubes_is_part_of_their_course() -> None:
    bow = np.array([[[0.3, 0.5]]])
    still: Any = SimpleNamespace(transport=SimpleNamespace(twist_deviation=DerivativeBounds(0 * bow, 0 * bow, bow)))
    turn = np.ones((1, 1, 2)), np.ones((1, 1, 2, 2))
    own, pair = branch._Bounds.chord(still, turn)
    assert (own.d.tolist(), own.dd.tolist()) == (turn[0].tolist(), bow.tolist())
    assert pair.d.tolist() == turn[1].tolist()
    assert pair.dd[0, 0].tolist() == [[0.6, 0.8], [0.8, 1.0]]


def test_a_course_has_the_derivatives_of_the_implicit_function_theorem() -> None:
    """S (theta - N) = theta^2 T with N, whose second and third derivatives are known, and T that grows."""
    steady, natural, grown = 2.7, (0.3, 0.7), (1.0, 0.4, 0.5, 0.2)
    time = DerivativeBounds(*(NONE + each for each in grown))
    slope = steady - 2 * grown[0]
    ball = branch._Ball(*(np.array([each]) for each in (0.0, 2 * grown[1], 0.0, slope)))
    still: Any = SimpleNamespace(
        weight=(NONE + 1, NONE[..., None] + 2),
        transport=SimpleNamespace(twist_deviation=DerivativeBounds(NONE, NONE, NONE + natural[0], NONE + natural[1])),
        cross_sections=lambda course: (course[0] * course[0] * time, course[0]),
        rotation=lambda moment, stretch: moment,
        response=lambda turn: turn,
        norm=lambda turn: turn[0][:, 0, 0],
        _stretch=lambda u: u,
    )
    result, pair = branch._Bounds.solution_derivatives(still, (NONE, NONE[..., None]), ball)
    # theta(0) = 1 with N(0) = 1 - T(0) / S, and Taylor coefficients by fixed points.
    x = np.linspace(-0.02, 0.02, 9)
    t = sum(each * x**k / f for k, (each, f) in enumerate(zip(grown, (1, 1, 2, 6), strict=True)))
    n = 1 - grown[0] / steady + natural[0] * x**2 / 2 + natural[1] * x**3 / 6
    theta = np.ones(9)
    for _ in range(60):
        theta -= (steady * (theta - n) - theta**2 * t) / (steady - 2 * theta * t)
    poly = np.linalg.solve(np.vander(x / 0.005, increasing=True), theta) / 0.005 ** np.arange(9)
    true = poly[1:4] * [1, 2, 6]
    for bound, both, by_itself, exact in zip(
        (result.d, result.dd, result.ddd), (pair.d, pair.dd, pair.ddd), (0.0, *natural), true, strict=True
    ):
        assert bound is not None
        assert both is not None
        assert bound.item() == pytest.approx(exact, rel=1e-5)
        assert both.item() == pytest.approx(2 * by_itself + 2 * (exact - by_itself), rel=1e-5)


def whirl_by_sums(bent: Array) -> tuple[Array, Array, Array]:
    """w' = U', s' = w U' + U'', j' = (s + w^2) U' + 2 w U'' + U''' along sections (K,) of `bent` (3, K), by sums: of
    each the means (K,) of w, s + w^2 and j + 3 w s + w^3."""
    rows, now, fine = [], np.zeros(3), 4800 // bent.shape[1]
    for first, second, third in bent.T:
        total = np.zeros(3)
        for _ in range(fine):
            w, s, j = now
            step = np.array([first, w * first + second, (s + w**2) * first + 2 * w * second + third]) / fine
            w, s, j = now + step / 2
            total += np.array([w, s + w**2, j + 3 * w * s + w**3]) / fine
            now = now + step
        rows.append(total)
    one, two, three = np.array(rows).T
    return one, two, three


def test_a_tangent_changes_as_what_bends_the_arm_before_it_is_summed() -> None:
    bent, long = np.random.default_rng(7).uniform(0.02, 0.06, (3, 12)), np.full((1, 12), 0.5)
    jet = DerivativeBounds(long, *(each[None] / 0.5 for each in bent))
    bounds = bare(length=DerivativeBounds(long, 0 * long, 0 * long, 0 * long))
    bounds.solution_derivatives, bounds.cross_sections = lambda turn, ball: None, lambda course: (None, jet)
    result = bounds.tangent_derivatives(None, None)
    for bound, true in zip((result.d, result.dd, result.ddd), whirl_by_sums(bent), strict=True):
        assert bound is not None
        assert (bound[0] >= true * (1 - 2e-3)).all()
        assert (bound[0, 3:] <= true[3:] * 1.02).all()


def test_a_point_is_off_its_chord_by_the_sum_of_what_turns_and_lengthens_the_arm() -> None:
    """An eighth of int 2 |h_t| W + h (Phi + W^2) by sums, U being U(t) in sections whose length changes."""
    first, second = np.random.default_rng(8).uniform(0.02, 0.06, (2, 12))
    long, more = np.random.default_rng(9).uniform(0.5, 1.0, (2, 1, 12))
    jet = DerivativeBounds(0 * long, first[None] / long, second[None] / long)
    bounds = bare(length=DerivativeBounds(long, more, 0 * more))
    bounds.chord, bounds.cross_sections = lambda turn: None, lambda course: (None, jet)
    bounds.bending = SimpleNamespace(change=lambda error: 0 * long)
    w, second_of, _ = whirl_by_sums(np.array([first, second + 2 * more[0] * first / long[0], 0 * first]))
    true = np.cumsum(2 * more[0] * w + long[0] * second_of) / 8
    result = bounds.chord_error(None, None)[0]
    assert (true * (1 - 2e-3) <= result).all()
    assert (result <= true * 1.01).all()


def test_moments_of_tubes_beside_the_centreline_change_as_a_quotient() -> None:
    """sum c e^(theta) over k, which may fall with the same derivatives: 1 / k is (1 - c (e^t - 1))^-1 here."""
    fall, pairs, rate = 0.4, np.array([[0.0, 0.3], [0.3, 0.0]]), 0.7
    still = DerivativeBounds(*np.zeros((4, 1, 1, 2)))
    k = DerivativeBounds(*(np.full((1, 1), each) for each in (1.0, fall, fall, fall)))
    flat = np.zeros((1, 1, 2, 2))
    bounds = bare(
        natural_curvature=still,
        pairing=DerivativeBounds(flat + pairs, flat, flat, flat),
        offset=np.array([0.01]),
        zero=np.zeros((1, 1, 2)),
    )
    bounds.bending = SimpleNamespace(along=lambda pulled: (None, k))
    turn = DerivativeBounds(flat, flat + rate, flat, flat)
    result = bounds.cross_sections((still, turn))[0]
    exact = derivatives(lambda t: 0.3 * np.exp(rate * t) / (1 - fall * (np.exp(t) - 1)), 0.02)
    assert [each[0, 0, 0] for each in parts(result)] == pytest.approx(np.array(exact), rel=1e-5)


@pytest.mark.parametrize("lost", ["margin of one", "margin of other", "turn", "order"])
def test_no_branch_is_shown_where_a_part_of_the_proof_is_missing(lost: str, monkeypatch: pytest.MonkeyPatch) -> None:
    intervals = between(STEPPED, ([0.3, 0.1], [-0.02, -0.01]), ([0.301, 0.1], [-0.02, -0.01]))
    stiffness = np.ones(2)
    assert branch.branch(intervals, stiffness).unbroken.all()
    if lost.startswith("margin"):
        stiffness[int(lost.endswith("other"))] = 1e-12
    elif lost == "order":
        intervals = replace(intervals, ordered=np.array([False]))
    else:
        turn = branch._Bounds.angle_change
        monkeypatch.setattr(branch._Bounds, "angle_change", lambda bounds: (turn(bounds)[0], np.array([False])))
    result = branch.branch(intervals, stiffness)
    assert not result.unbroken.any()
    assert np.isinf(result.chord_error).all()
