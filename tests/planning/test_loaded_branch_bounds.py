"""Bounds of the branch between two loaded equilibria, piece by piece: products and sums that are attained.

A unit vector that turns by an angle has derivatives no larger than those of the exponential of the angle. In its place
everything here grows, so that no term of a bound is lost to a sign.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.examples import nested
from tests.planning.test_branch_bounds import whirl_by_sums
from tests.planning.test_cross_section_bounds import derivatives
from tests.planning.test_cross_section_bounds import parts as parts_of
from tests.planning.test_sharp_bounds import STEPPED
from tubeopt import ConcentricRobot, Load, Piece, Tube, forward_kinematics
from tubeopt.planning.branch import rotating_tangent
from tubeopt.planning.loaded_branch import (
    CHORD_ERROR,
    _Bounds,
    _Changes,
    _Displacement,
    _GeometryChange,
    _Samples,
    _TimeDerivatives,
    loaded_branch,
)
from tubeopt.planning.loaded_sections import DeadLoad, LoadedArms, LoadedIntervals
from tubeopt.planning.sections import PARTS, Constants, DerivativeBounds, Intervals
from tubeopt.robots.load import PointLoad, Stretch
from tubeopt.typing import Array

K, N = 3, 2


def bare(**known: Any) -> Any:
    """Bounds of an interval of which only these are known."""
    result = _Bounds.__new__(_Bounds)
    vars(result).update(known)
    return result


class Grows:
    """What grows with time, of some shape: derivatives at time 0, and its values."""

    def __init__(self, random: Any, *shape: int, orders: int = 4, value: float | None = None) -> None:
        table = random.uniform(0.5, 1.0, (4, *shape)) * np.array([1.0, 0.4, 0.3, 0.2]).reshape(4, *[1] * len(shape))
        table[orders:] = 0.0
        if value is not None:
            table[0] = value
        self.jet, self.table = DerivativeBounds(*table[:, None]), table

    def __call__(self, t: float) -> Array:
        return np.asarray(sum(self.table[k] * t**k / f for k, f in enumerate((1, 1, 2, 6))))


def ahead(table: Array) -> Array:
    return np.asarray(np.cumsum(table[::-1], axis=0)[::-1])


def compare(jet: DerivativeBounds, function: Callable[[float], Array], *orders: int) -> None:
    exact = derivatives(function, 0.02)
    for order in orders:
        assert parts_of(jet)[order][0] == pytest.approx(exact[order], rel=1e-5, abs=1e-9)


def grown(seed: int) -> SimpleNamespace:
    """All that the bounds are made of: bounds, and functions of time with the same derivatives."""
    random = np.random.default_rng(seed)
    own = Grows(random, K, N, value=0.0), Grows(random, K, N, N, value=0.0)
    parts = {
        "h": Grows(random, K, orders=2),
        "spring": Grows(random, N, orders=2),
        "compliance": Grows(random, K, N),
        "pull": Grows(random, K, N),
        "pairing": Grows(random, K, N, N),
        "bending_compliance": Grows(random, K),
        "force": Grows(random, K, orders=2),
        "tangent": Grows(random, K, value=1.0),
        "moment": Grows(random, K),
        "theta": own[0],
        "pair": own[1],
        "couple": falling(random),
    }
    kick, along = random.uniform(0.5, 1.0, (2, K, N))
    return SimpleNamespace(**parts, kick=kick, along=along, random=random)


def falling(random: Any) -> Grows:
    """What falls towards the tip, as moments ahead, and so does its change."""
    result = Grows(random, K, orders=2)
    result.table[:2] = -np.sort(-result.table[:2])
    result.jet = DerivativeBounds(*result.table[:, None])
    return result


def bounds_of(g: SimpleNamespace) -> Any:
    transport = SimpleNamespace(
        compliance=g.compliance.jet,
        bending_compliance=g.bending_compliance.jet,
        still=False,
        twist_deviation=DerivativeBounds(*np.zeros((4, 1, K, N))),
    )
    return bare(
        length=g.h.jet,
        spring=g.spring.jet,
        force=g.force.jet,
        natural_curvature=g.pull.jet,
        slope=g.pull.jet.v,
        pairing=g.pairing.jet,
        pairs=g.pairing.jet.v,
        transport=transport,
        kt=1 / g.compliance.jet.v,
        stiffness=1 / g.bending_compliance.jet.v,
        u=np.full((1, K), 0.7),
        couple=g.couple.jet,
        kick=g.kick[None],
        along=g.along[None],
    )


def test_torques_and_moments_of_a_load_change_as_the_products_of_what_does() -> None:
    """M = sum h t n of what lies ahead + t m_c, T_i = sum h (A_i e_i M + sum c_ij e_ij + t m_i) + t m_k, to the third
    derivative."""
    g = grown(1)
    torque, moment = bounds_of(g)._balance(g.theta.jet, g.pair.jet, g.tangent.jet)

    def lever(t: float) -> Array:
        return ahead(g.h(t) * g.tangent(t) * g.force(t)) + g.tangent(t) * g.couple(t)

    def twist(t: float) -> Array:
        by_load = g.pull(t) * np.exp(g.theta(t)) * lever(t)[:, None] + g.along * g.tangent(t)[:, None]
        each = g.h(t)[:, None] * (by_load + (g.pairing(t) * np.exp(g.pair(t))).sum(2))
        return ahead(each + g.kick * g.tangent(t)[:, None])

    compare(moment, lever, 0, 1, 2, 3)
    compare(torque, twist, 1, 2, 3)


def test_a_bend_and_a_twist_change_as_the_products_of_what_does() -> None:
    """h (sum A_i e_i + M / K), and |beta| / kt t(0) + sum h t / kt with the natural turn, to the third derivative."""
    g = grown(2)
    bounds, torque, bow = bounds_of(g), Grows(g.random, K, N), Grows(g.random, K, N)
    bounds.u = (g.pull(0.0).sum(1) + g.moment(0.0) * g.bending_compliance(0.0))[None]
    compare(
        bounds._bend(g.theta.jet, g.moment.jet),
        lambda t: g.h(t) * ((g.pull(t) * np.exp(g.theta(t))).sum(1) + g.moment(t) * g.bending_compliance(t)),
        *range(4),
    )
    bounds.transport.twist_deviation = bow.jet

    def twist(t: float) -> Array:
        along = np.cumsum(g.h(t)[:, None] * torque(t) * g.compliance(t), axis=0)
        return np.asarray(g.spring(t) * torque(t)[0] + along + bow(t))

    compare(bounds._twist(torque.jet), twist, 1, 2, 3)


def test_what_differs_between_samples_is_half_their_distance_times_the_change_of_a_slope() -> None:
    """Slopes along the arm by time: h (t / kt + twist), h (sum c_ij e_ij + A_i M e_i + m_i) and h (u sum t + n + m)."""
    g = grown(3)
    bounds, random = bounds_of(g), g.random
    torque, twist, moved = (
        Grows(random, K, N, orders=2),
        random.uniform(0.5, 1, (K, N)),
        random.uniform(0.1, 0.2, (K, N)),
    )
    twist_slope, lever = random.uniform(0.5, 1, (1, K, N)), Grows(random, K, orders=2)
    turn = g.theta.table[1], g.pair.table[1]
    bounds.torque, bounds.lever = torque.jet.v, lever.jet.v
    bounds.transport = SimpleNamespace(
        compliance=g.compliance.jet,
        bending_compliance=g.bending_compliance.jet,
        twist_slope=DerivativeBounds(twist_slope, twist_slope, twist_slope),
        gain=lambda ones: g.pairing.jet.d.sum(3),
    )
    constants = SimpleNamespace(bounds=SimpleNamespace(twist=[None]), largest=lambda table, stretch: twist[None])
    bounds.intervals = SimpleNamespace(arms=SimpleNamespace(constants=constants), stretch=None, moved=moved[None])
    changes = _Changes((turn[0][None], turn[1][None]), torque.jet.d, lever.jet.d, np.ones(1, dtype=bool))
    result = bounds._between_samples(changes)

    def bend(t: float) -> Array:
        """u of the bound, 0.7, with its change."""
        own = (g.pull(t) * np.exp(g.theta(t))).sum(1) + lever(t) * g.bending_compliance(t)
        return np.asarray(0.7 + own - (g.pull(0.0).sum(1) + lever(0.0) * g.bending_compliance(0.0)))

    def frame(t: float) -> Array:
        return np.cumsum(g.h(t) * bend(t))

    def slopes(t: float) -> tuple[Array, Array, Array]:
        turned = 1 + frame(t) - frame(0.0)
        h, load = g.h(t), (g.force(t) + g.along.sum(1)) * turned
        turning = h[:, None] * (torque(t) * g.compliance(t) + twist + t * twist_slope[0] * moved)
        each = g.pull(t) * lever(t)[:, None] * np.exp(g.theta(t)) + (g.pairing(t) * np.exp(g.pair(t))).sum(2)
        each += g.along * turned[:, None]
        return turning, h[:, None] * each, h * (bend(t) * torque(t).sum(1) + load)

    for bound, k in zip((result.theta, result.torque, result.moment), range(3), strict=True):
        change = (slopes(1e-5)[k] - slopes(-1e-5)[k]) / 2e-5
        assert bound[0] == pytest.approx(change / (2 * PARTS), rel=1e-6)
    bent = (bend(1e-5) - bend(-1e-5)) / 2e-5
    assert bounds._curvature_change(changes)[0] == pytest.approx(bent, rel=1e-6)


def test_what_coordinates_turn_changes_torques_and_moments_as_their_derivative() -> None:
    """Of sections at rest: what turns tubes by their weight, and frames by their swing."""
    g, size = grown(4), 0.3
    bounds, random = bounds_of(g), g.random
    weight = random.uniform(1, 2, (1, K, N)), random.uniform(1, 2, (1, K, N, N))
    bounds.weight, bounds.swing = weight, random.uniform(1, 2, (1, K))
    bounds.lever = (ahead(g.h(0.0) * g.force(0.0)) + g.couple(0.0))[None]
    result = bounds._response(np.array([size]))

    def made(t: float) -> tuple[Array, Array]:
        frame = 1 + t * size * bounds.swing[0]
        lever = ahead(g.h(0.0) * g.force(0.0) * frame) + g.couple(0.0) * frame
        by_load = g.pull(0.0) * (1 + t * size * weight[0][0]) * lever[:, None]
        each = by_load + (g.pairing(0.0) * (1 + t * size * weight[1][0])).sum(2) + g.along * frame[:, None]
        return ahead(g.h(0.0)[:, None] * each + g.kick * frame[:, None]), lever

    assert result.angle[0] == pytest.approx(size * weight[0])
    assert result.angle[1] == pytest.approx(size * weight[1])
    for bound, k in ((result.torque, 0), (result.moment, 1)):
        assert bound[0] == pytest.approx((made(1e-5)[k] - made(-1e-5)[k]) / 2e-5, rel=1e-8)


def test_a_tangent_of_loaded_arms_changes_as_what_bends_them_before_it_is_summed() -> None:
    """Of the chord to the second derivative, of a course to the third; what holds at the end of a section is taken."""
    count = 200
    bent = np.random.default_rng(7).uniform(0.1, 0.3, (3, count)) * 6 / count
    jet = DerivativeBounds(*np.concatenate([np.zeros((1, count)), bent])[:, None])
    nothing = np.zeros((1, count, 1))
    flat = DerivativeBounds(nothing, nothing, nothing, nothing)
    bounds = bare(lever=np.zeros((1, count)), swing=np.ones((1, count)))
    bounds._twist, bounds._bend = lambda torque: flat, lambda theta, moment: jet
    bounds._balance = lambda theta, pair, tangent: (flat, DerivativeBounds(*np.zeros((4, 1, count))))
    bounds._size, bounds._response = lambda *_: np.zeros(1), lambda size: _at_rest(nothing)
    changes: Any = _Changes((nothing, nothing[..., None]), nothing, np.zeros((1, count)), np.ones(1, dtype=bool))
    tangent = bounds._chord(changes, nothing).tangent
    true = whirl_by_sums(bent)
    course = blank(nothing)
    course.frame[1] = np.cumsum(bent[:1], axis=1)
    for order in (2, 3):
        bounds._add_order(course, order, np.ones(1))
    whole = rotating_tangent(*course.frame[1:])
    for bound, exact in zip((tangent.d, tangent.dd, whole.d, whole.dd, whole.ddd), (*true[:2], *true), strict=True):
        assert bound is not None
        assert (bound[0, 20:] >= exact[20:] * (1 - 2e-3)).all()
        assert (bound[0, 20:] <= exact[20:] * 1.06).all()


def blank(nothing: Array) -> _TimeDerivatives:
    """One of which nothing is known, of sections and tubes as `nothing` (1, K, n)."""
    arm = nothing[..., 0]
    return _TimeDerivatives([nothing] * 4, [nothing[..., None]] * 4, [nothing] * 4, [arm] * 4, [arm] * 4)


def _at_rest(nothing: Array) -> Any:
    return _Changes((nothing, nothing[..., None]), nothing, nothing[..., 0], np.ones(1, dtype=bool))


@pytest.mark.parametrize("order", [2, 3])
def test_derivatives_of_a_course_are_what_lower_ones_make_and_what_calls_them_forth(order: int) -> None:
    """As of `branch`: torques t, theta = t and moments m solve S (t - made) = 0 with as much as the margin left."""
    one, convex = np.ones((1, 1, 1)), 0.4
    bounds = bare(lever=one[..., 0], swing=one[..., 0] * 0.6)
    made = (
        DerivativeBounds(one * 2, one * 3, one * 5, one * 7),
        DerivativeBounds(*(one[..., 0] * k for k in (11, 13, 17, 19))),
    )
    bounds._twist = lambda torque: DerivativeBounds(one, one, one * 0.5, one * 0.7)
    bounds._bend = lambda theta, moment: DerivativeBounds(*np.zeros((4, 1, 1)))
    bounds._balance = lambda theta, pair, tangent: made
    bounds._size = lambda torque, moment: torque[:, 0, 0] + moment[:, 0]
    bounds._response = lambda size: _Changes(
        (size * one, 3 * size * one[..., None]), 5 * size * one, 7 * size * one[..., 0], np.ones(1, dtype=bool)
    )
    course = blank(0 * one)
    bounds._add_order(course, order, np.array([convex]))
    torque, moment, twist_slope = {2: (5, 17, 0.5), 3: (7, 19, 0.7)}[order]
    size = (torque + moment) / convex
    results = [
        float(table[order].item()) for table in (course.theta, course.pair, course.torque, course.moment, course.frame)
    ]
    assert results == pytest.approx(
        [twist_slope + size, 2 * twist_slope + 3 * size, torque + 5 * size, moment + 7 * size, 0.6 * size]
    )


def test_rates_of_loaded_arms_count_what_is_off_the_chord_as_a_parabola() -> None:
    """Off it by an eighth of the second derivative, and changing by half of it, beside what is in the ball."""
    one, convex, requested = np.ones((1, 1, 1)), 0.5, []
    flat = one[..., 0]
    bounds = bare(torque=one * 2, lever=flat * 3, pairs=one[..., None], u=flat)
    bounds.changes = _Changes((one * 0.1, one[..., None] * 0.2), one * 0.3, flat * 0.4, np.ones(1, dtype=bool))
    bounds.chord = SimpleNamespace(
        theta=DerivativeBounds(one, one * 0.11, one),
        pair=DerivativeBounds(one[..., None], one[..., None] * 0.21, one[..., None]),
        torque=DerivativeBounds(one, one, one * 0.8),
        moment=DerivativeBounds(flat, flat, flat * 1.6),
    )

    def chord(changes: Any, torque: Array) -> Any:
        requested.append([each.item() for each in (*changes.angle, changes.torque, changes.moment, torque)])
        return SimpleNamespace(
            torque=DerivativeBounds(one, one, one * 2.2), moment=DerivativeBounds(flat, flat, flat * 2.6)
        )

    def response(size: Array) -> Any:
        parts = (size * one, 2 * size * one[..., None]), 3 * size * one, 4 * size * flat
        return _Changes(*parts, np.ones(1, dtype=bool))

    courses: list[Any] = []
    bounds._chord, bounds._response = chord, response
    bounds._size = lambda torque, moment: torque[:, 0, 0] + moment[:, 0]
    bounds._bend = lambda theta, moment: DerivativeBounds(*np.zeros((4, 1, 1)))
    bounds._add_order = lambda course, order, left: courses.append(course)
    bounds.tangent_derivatives(np.array([0.05]), np.array([convex]))
    off = 3 * 0.05 + 0.8 / 8
    assert requested == [pytest.approx([0.1 + 0.05, 0.2 + 0.1, 0.3 + off, 0.4 + 4 * 0.05 + 1.6 / 8, 2 + off])]
    size = (1.1 + 1.3) / convex
    course = courses[0]
    results = [table[1].item() for table in (course.theta, course.pair, course.torque, course.moment)]
    assert results == pytest.approx([0.11 + size, 0.21 + 2 * size, 0.3 + 1.1 + 3 * size, 0.4 + 1.3 + 4 * size])
    assert course.torque[0].item() == pytest.approx(2 + off)


def test_what_differs_of_a_second_variation_is_that_of_products() -> None:
    """h c e (y_i - y_j)^2 / 2, h A M e y^2 and h n e |psi|^2, by time, where coordinates are worth more with it."""
    g = grown(5)
    bounds, random = bounds_of(g), g.random
    bounds.kick = bounds.along = np.zeros((1, K, N))
    y, more = random.uniform(1, 2, (2, K, N))
    bounds.weight = y[None], np.hypot(y[:, :, None], y[:, None])[None]
    bounds.lever, bounds.swing = np.zeros((1, K)), np.zeros((1, K))
    bounds.force = DerivativeBounds(*np.zeros((3, 1, K)))
    moved = _Displacement(
        (g.theta.table[1][None], g.pair.table[1][None]), g.tangent.table[1][None], g.moment.table[1][None]
    )
    dh, dn = random.uniform(0.1, 0.2, (2, 1, K))
    bounds._geometry_change = lambda: _GeometryChange(dh, more[None], np.zeros((1, K)), dn)
    both = np.hypot(more[:, :, None], more[:, None])

    def by_tubes(t: float) -> float:
        h, c = g.h(0.0) + t * dh[0], g.pairing.table[0] + t / 2 * g.pairing.table[1]
        form = (h[:, None, None] * c * np.exp(g.pair(t)) * (bounds.weight[1][0] + t * both) ** 2).sum() / 2
        return float(form)

    def rate(function: Callable[[float], float]) -> float:
        return (function(1e-5) - function(-1e-5)) / 2e-5

    none = _Displacement((moved.angle[0], moved.angle[1]), 0 * moved.frame, 0 * moved.moment)
    assert bounds.hessian_change(none, stretched=True).item() == pytest.approx(rate(by_tubes), rel=1e-6)
    # With a load, less what the tubes take, and without psi.
    bounds.pairs = 0 * bounds.pairs
    bounds.pairing = DerivativeBounds(*np.zeros((4, 1, K, N, N)))
    lever = g.random.uniform(1, 2, K)
    bounds.lever = lever[None]

    def by_load(t: float) -> float:
        h, a = g.h(0.0) + t * dh[0], g.pull.table[0] + t / 2 * g.pull.table[1]
        bent = lever + t * (moved.moment[0] + g.couple(0.0) * moved.frame[0])
        each = a * bent[:, None] * np.exp(g.theta(t)) * (y + t * more) ** 2
        return float((h[:, None] * each).sum())

    assert bounds.hessian_change(moved, stretched=True).item() == pytest.approx(rate(by_load), rel=1e-6)


def test_what_differs_of_a_second_variation_by_its_turns_is_that_of_running_totals() -> None:
    """m.(psi x psi') with |psi| <= P, and what differs of psi <= D, running totals both: int D dP + P dD is D P. And
    n e P^2 by time, and (h m_i + m_k) e P y of the torques. D is what frames turn, and what differs of A_i y_i and of
    r."""
    g = grown(6)
    bounds, random = bounds_of(g), g.random
    y, more = random.uniform(1, 2, (2, K, N))
    swing, bend = np.cumsum(random.uniform(1, 2, (2, K)), axis=1)
    dh, dn = random.uniform(0.1, 0.2, (2, K))
    bounds.pairs, bounds.pairing = 0 * bounds.pairs, DerivativeBounds(*np.zeros((4, 1, K, N, N)))
    bounds.weight = y[None], np.hypot(y[:, :, None], y[:, None])[None]
    bounds.lever, bounds.swing = random.uniform(1, 2, (1, K)) * 1e6, swing[None]
    bounds._geometry_change = lambda: _GeometryChange(dh[None], more[None], bend[None], dn[None])
    turn, frame, moment = g.theta.table[1], g.tangent.table[1], g.moment.table[1]
    moved = _Displacement((turn[None], np.zeros((1, K, N, N))), frame[None], moment[None])

    def way(t: float) -> Array:
        h, a = g.h(0.0) + t * dh, g.pull.table[0] + t / 2 * g.pull.table[1]
        return np.cumsum((h[:, None] * a * np.exp(g.theta(t)) * (y + t * more)).sum(1))

    bent = moment + g.couple(0.0) * frame
    differs = frame * swing + (way(1e-5) - way(-1e-5)) / 2e-5 + bend
    lever = bounds.lever[0]
    results = []
    for size in (1.0, 0.0):
        bounds.lever = size * lever[None]
        results.append(bounds.hessian_change(moved, stretched=True).item())

    def by_load(t: float) -> float:
        h, a = g.h(0.0) + t * dh, g.pull.table[0] + t / 2 * g.pull.table[1]
        return float((h[:, None] * a * (lever + t * bent)[:, None] * np.exp(g.theta(t)) * (y + t * more) ** 2).sum())

    def by_moment(t: float) -> float:
        return float((g.h(0.0)[:, None] * g.pull.table[0] * (t * bent)[:, None] * y**2).sum())

    load = (by_load(1e-5) - by_load(-1e-5)) / 2e-5 - by_moment(1.0)
    assert results[0] - results[1] == pytest.approx(load + lever[0] * swing[-1] * differs[-1], rel=1e-6)

    def form(t: float) -> float:
        h, n = g.h(0.0) + t * dh, g.force.table[0] + t * dn
        acts = (h[:, None] * g.along + g.kick) * (y + t * more)
        turned = (1 + t * frame) * (swing + t * differs)
        return float((h * n * turned * (swing + t * differs)).sum() + (acts * turned[:, None]).sum())

    exact = (form(1e-5) - form(-1e-5)) / 2e-5 + moment.max() * swing[-1] ** 2 / 2 + by_moment(1.0)
    assert results[1] == pytest.approx(exact, rel=1e-6)


def test_two_running_totals_take_no_more_than_their_product() -> None:
    """int |b x a'| + |a x b'| over steps of vectors at random, and of b after all of a, which attains it."""
    random = np.random.default_rng(11)
    fractions = []
    for k in range(300):
        a, b = random.normal(size=(2, 40, 3)) * random.random((2, 40, 1)) ** random.integers(0, 8)
        if k == 0:
            a, b = np.zeros((2, 40, 3))
            a[:20, 0], b[20:, 1] = 1.0, 1.0
        before = [np.cumsum(each, axis=0) - each / 2 for each in (a, b)]
        size = (
            np.linalg.norm(np.cross(before[1], a), axis=1).sum() + np.linalg.norm(np.cross(before[0], b), axis=1).sum()
        )
        fractions.append(size / (np.linalg.norm(a, axis=1).sum() * np.linalg.norm(b, axis=1).sum()))
    assert max(fractions) <= 1 + 1e-12
    assert fractions[0] == pytest.approx(1.0)


def test_the_second_variation_curves_as_the_products_of_what_it_is_made_of() -> None:
    """A sixth of the second derivative of h (sum c e (y_i - y_j)^2 / 2 + A e M y^2 + 3/2 t n |psi|^2), of half of what
    m_c falls by times |psi|^2, and of (h m_i + m_k) t psi y."""
    random = np.random.default_rng(12)
    h, spring = Grows(random, K, orders=2), Grows(random, N, orders=2)
    force, tangent, moment = Grows(random, K, orders=2), Grows(random, K, value=1.0), Grows(random, K)
    theta, pair = Grows(random, K, N, value=0.0), Grows(random, K, N, N, value=0.0)
    slope, pairs, kt = random.uniform(1, 2, (K, N)), random.uniform(1, 2, (K, N, N)), random.uniform(1, 2, (K, N))
    stiff, y, both, swing = (random.uniform(1, 2, each) for each in (K, (K, N), (K, N, N), K))
    first, couple, (kick, along) = h.table[0] - h.table[1], falling(random), random.uniform(0.5, 1.0, (2, K, N))
    none = DerivativeBounds(*np.zeros((4,)))
    transport = SimpleNamespace(still=True)
    bounds = bare(
        length=h.jet,
        spring=spring.jet,
        force=force.jet,
        transport=transport,
        lever=np.zeros((1, K)),
        kt=kt[None],
        stiffness=stiff[None],
        weight=(y[None], both[None]),
        swing=swing[None],
        pairing=DerivativeBounds(pairs[None], none.d, none.d, none.d),
        natural_curvature=DerivativeBounds(slope[None], none.d, none.d, none.d),
        chord=SimpleNamespace(theta=theta.jet, pair=pair.jet, tangent=tangent.jet, moment=moment.jet),
        intervals=SimpleNamespace(length=(first[None], h.table[0][None])),
        couple=couple.jet,
        kick=kick[None],
        along=along[None],
    )
    over, held = h.table[1] ** 2 / first, spring.table[1] ** 2 / (spring.table[0] - spring.table[1])
    own = np.sqrt(np.cumsum(over[:, None] / kt, axis=0) + held)
    apart = np.hypot(own[:, :, None], own[:, None])
    bent = np.sqrt(np.cumsum(h.table[0] / stiff)), np.sqrt(np.cumsum(over / stiff))

    def psi(t: float) -> Array:
        by_tubes = tangent(t) * h(t) * (slope * np.exp(theta(t)) * (y + t * own)).sum(1)
        whole = np.cumsum(by_tubes) + tangent(t) * (bent[0] + t * bent[1])
        start = np.cumsum(h.table[0] * (slope * y).sum(1)) + bent[0]
        return np.asarray(swing + whole - start)

    def form(t: float) -> float:
        tubes = (pairs * np.exp(pair(t)) * (both + t * apart) ** 2).sum((1, 2)) / 2
        load = (slope * np.exp(theta(t)) * moment(t)[:, None] * (y + t * own) ** 2).sum(1)
        falls = couple(t) - np.append(couple(t)[1:], 0.0)
        acts = (h(t)[:, None] * along + kick) * (tangent(t) * psi(t))[:, None] * (y + t * own)
        turns = h(t) * (tubes + load + 1.5 * tangent(t) * force(t) * psi(t) ** 2) + falls * psi(t) ** 2 / 2
        return float(turns.sum() + acts.sum())

    assert bounds.hessian_chord_error().item() == pytest.approx(
        CHORD_ERROR * float(derivatives(form, 0.01)[2]), rel=1e-5
    )
    transport.still = False
    assert bounds.hessian_chord_error().item() == np.inf


def test_roots_of_what_changes_are_as_far_from_the_nearer_end_as_half_of_the_time() -> None:
    """Of 1 / kt and 1 / K that change at one rate, from where they are least; and of a transmission off its chord."""
    kt, compliance, bending_compliance = 4.0, 0.01, 0.02
    one = np.ones((1, 1, 1))
    stiffest = SimpleNamespace(stiffest=(None, None))
    values = iter((one * 3.0, one * kt))
    constants = SimpleNamespace(bounds=stiffest, largest=lambda table, stretch: next(values))
    intervals = SimpleNamespace(arms=SimpleNamespace(constants=constants), stretch=None)
    transport = SimpleNamespace(
        still=False,
        compliance=DerivativeBounds(one, one * compliance, one),
        bending_compliance=DerivativeBounds(one, one[..., 0] * bending_compliance, one),
    )
    bounds = bare(intervals=intervals, transport=transport)
    twisting, bending = bounds._compliance_change()
    for result, stiff, rate in ((twisting, kt, compliance), (bending, 3.0, bending_compliance)):
        true = np.sqrt(1 / stiff + rate / 2) - np.sqrt(1 / stiff)
        assert true <= result.item() <= true * (1 + rate * stiff / 4)


def test_what_sections_are_worth_at_the_nearer_end_sums_lengths_compliances_and_transmissions() -> None:
    length, twisting, bending = np.array([[0.01, 0.02]]), np.full((1, 2, 1), 0.3), np.full((1, 2), 0.2)
    later, bow = np.array([[0.012, 0.025]]), 1e-4
    bounds = bare(
        intervals=SimpleNamespace(length=(length, later)),
        spring=DerivativeBounds(np.array([[0.03]]), np.array([[0.01]]), np.array([[bow]])),
        length=DerivativeBounds(later, later - length, 0 * length),
        force=DerivativeBounds(length, np.array([[0.3, 0.5]]), length),
        kt=np.full((1, 2, 1), 2.0),
        stiffness=np.full((1, 2), 5.0),
    )
    bounds._compliance_change = lambda: (twisting, bending)
    change = bounds._geometry_change()
    root = np.sqrt((length + later) / 2) - np.sqrt(length)
    held = np.sqrt(0.025) - np.sqrt(0.02) + np.sqrt(bow / 8)
    one = root / np.sqrt(2) + np.sqrt(later) * 0.3
    two = root / np.sqrt(5) + np.sqrt(later) * 0.2
    assert change.h == pytest.approx((later - length) / 2)
    assert change.force == pytest.approx(np.array([[0.15, 0.25]]))
    assert change.y[0, :, 0] == pytest.approx(np.sqrt(np.cumsum(one[0] ** 2) + held**2))
    assert change.bending[0] == pytest.approx(np.sqrt(np.cumsum(two[0] ** 2)))


@pytest.mark.parametrize("linear", [True, False])
def test_the_ball_of_loaded_arms_is_that_of_newton_and_kantorovich(linear: bool) -> None:
    """At half of the time from the nearer end, or against what is linear between both, whichever is less."""
    one, requested = np.ones((1, 1, 1)), []
    flat = one[..., 0]

    def hessian_change(moved: Any, *, stretched: bool) -> Array:
        requested.append([float(each.item()) for each in (*moved.angle, moved.frame, moved.moment)])
        return np.array([0.3 if stretched else 0.5])

    bounds = bare(
        chord=SimpleNamespace(
            theta=DerivativeBounds(one, 0.2 * one, one),
            pair=DerivativeBounds(one[..., None], 0.6 * one[..., None], one[..., None]),
            tangent=DerivativeBounds(flat, 0.8 * flat, flat),
            moment=DerivativeBounds(flat, 1.4 * flat, flat),
        ),
        length=DerivativeBounds(2 * flat, flat, flat),
        force=DerivativeBounds(3 * flat, flat, flat),
        couple=DerivativeBounds(flat, 0.4 * flat, 0 * flat),
        weight=(7 * one, 11 * one[..., None]),
        swing=13 * flat,
    )
    bounds.hessian_change, bounds.gradient = hessian_change, lambda: np.array([0.05])
    bounds.hessian_chord_error = lambda: np.array([0.2 if linear else np.inf])
    ball = bounds.ball(np.array([0.9]))
    # Of the moment in world axes by time: h_t t n + h t_t n + h t n_t, and that of what acts ahead.
    moment = (1 * 1 * 3 + 2 * 0.8 * 3 + 2 * 1 * 1 + 0.4) / 2
    assert requested == [pytest.approx([0.1, 0.3, 0.4, moment]), pytest.approx([7, 11, 13, 2 * 3 * 13])]
    left = 0.7 if linear else 0.6
    root = float(np.roots([0.25, -left, 0.05]).min())
    assert ball.exists.all()
    assert ball.radius.item() == pytest.approx(root)
    assert ball.convexity.item() == pytest.approx(left - 0.5 * root)


def test_a_point_of_loaded_arms_is_off_its_chord_by_the_sum_of_what_turns_and_lengthens_the_arm() -> None:
    """An eighth of int 2 |h_t| |t_t| + h |t_tt|, and the lever of what is in the ball."""
    h, more, rate, bend, swing = np.random.default_rng(13).uniform(1, 2, (5, 1, K))
    bounds = bare(
        length=DerivativeBounds(h, more, 0 * h),
        chord=SimpleNamespace(tangent=DerivativeBounds(0 * h, rate, bend)),
        swing=swing,
    )
    result = bounds.chord_error(np.array([0.3]))[0]
    assert result == pytest.approx(np.cumsum((2 * more * rate + h * bend) / 8 + 0.3 * h * swing))


def loaded(load: Load) -> tuple[LoadedIntervals, _Bounds]:
    """Those of an arm with transmissions that stays where it is."""
    arm = forward_kinematics(STEPPED, [0.3, 0.1], [-0.02, -0.01], load=load)
    arms = LoadedArms.of(Constants.of(STEPPED), [arm, arm], load=DeadLoad.of(STEPPED, load))
    intervals = LoadedIntervals.of(arms, np.array([0]), np.array([1]))
    return intervals, _Bounds(intervals)


def test_an_arm_swings_by_the_root_of_its_compliance_at_most() -> None:
    """(int A_i |y_i| + |r|)^2 where T = 1, by sums: int m_i^2 / kt_i + |beta| m_i(0)^2 / kt_i + int 1 / K."""
    intervals, bounds = loaded(Load())
    cuts, count = intervals.start_cuts[0], 20000
    for k, s in enumerate(cuts[1:]):
        if not s:
            continue
        x = (np.arange(count) + 0.5) / count * s
        reached = [x < tube.curved_length + by for tube, by in zip(STEPPED.tubes, (-0.02, -0.01), strict=True)]
        stiff = sum(tube.bending_stiffness * on for tube, on in zip(STEPPED.tubes, reached, strict=True))
        total = (1 / stiff).sum() * s / count
        for tube, on, held in zip(STEPPED.tubes, reached, (0.06, 0.03), strict=True):
            slope = tube.bending_stiffness * tube.curvature * on / stiff * s / count
            m = np.cumsum(slope[::-1])[::-1] - slope / 2
            total += ((m**2).sum() * s / count + held * slope.sum() ** 2) / tube.torsional_stiffness
        assert bounds.swing[0, k] == pytest.approx(np.sqrt(total), rel=3e-5)


@pytest.mark.parametrize("couple", [0.0, 1e-3])
def test_torques_between_samples_grow_by_what_bends_the_tubes_and_by_the_load(couple: float) -> None:
    """By c + A_i M per length at most, and by the moment that acts on the outer tube, over half of the distance."""
    force = 0.01
    along = (Stretch(0.0, 0.03, moment=(0.0, 0.0, couple)),) if couple else None
    intervals, bounds = loaded(Load(force=(force, 0.0, 0.0), distributed=along))
    one, other = (tube.bending_stiffness for tube in STEPPED.tubes)
    bends = [tube.bending_stiffness * tube.curvature for tube in STEPPED.tubes]
    length = intervals.length[0][0]
    k = int(np.argmax((intervals.stretch[0] == 1).all(1) & (length > 1e-9)))
    lever = (force + couple) * (intervals.start_cuts[0, -1] - intervals.start_cuts[0, k])
    slope = bends[0] * bends[1] / (one + other) + np.array(bends) / (one + other) * lever + [0.0, couple]
    more = bounds.torque[0, k] - intervals.loads.torque[0, k]
    assert more == pytest.approx(slope * length[k] / (2 * PARTS), rel=1e-9)


def test_no_rotation_of_loaded_arms_of_unit_elastic_form_is_larger_than_its_weight() -> None:
    """(|beta| + s) / kt is the square of what a tube may turn, and their sum that of two against each other."""
    intervals, bounds = loaded(Load(force=(0.01, 0.0, 0.0)))
    kt = np.array([tube.torsional_stiffness for tube in STEPPED.tubes])
    square = (np.array([0.06, 0.03]) + intervals.start_cuts[0, 1:, None]) / kt
    assert bounds.weight[0][0] == pytest.approx(np.sqrt(square), rel=1e-9)
    assert bounds.weight[1][0] == pytest.approx(np.sqrt(square[:, :, None] + square[:, None]), rel=1e-9)


def test_what_differs_between_loaded_arms_is_more_between_samples() -> None:
    """Of rotations, torques and moments."""
    ends: Any = SimpleNamespace(changes=(np.full((1, 1, 1), 0.7), np.full((1, 1, 1, 1), 0.9)))
    still: Any = SimpleNamespace(
        intervals=ends,
        _between_samples=lambda c: _Samples(np.full((1, 1, 1), 0.1), np.full((1, 1, 1), 0.3), np.full((1, 1), 0.5)),
    )
    result = _Bounds._changes(still, np.full((1, 1, 1), 2.0), np.full((1, 1), 3.0))
    assert result.angle[0].item() == pytest.approx(0.7 + 0.1)
    assert result.angle[1].item() == pytest.approx(0.9 + 2 * 0.1)
    assert (result.torque.item(), result.moment.item()) == pytest.approx((2.3, 3.5))
    assert result.valid.all()


def test_torques_and_moments_between_points_are_those_of_statics() -> None:
    """What acts ahead of a place turns about it: its part along the arm is the torque of all tubes, the rest bends."""
    helix = Tube.of_pieces(1.3e-3, 1.1e-3, [Piece(0.03, (3.0, 0.0, 20.0))], straight_length=0.02)
    robot = ConcentricRobot((STEPPED.tubes[0], helix))
    point = PointLoad(0.025, (0.1, 0.0, 0.0), (3e-3, 2e-3, 4e-3))
    along = Stretch(0.0, 0.05, (0.0, 2.0, 0.0), (0.02, 0.0, 0.05))
    load = Load(force=(0.05, 0.1, 0.2), moment=(1e-3, 2e-3, 3e-3), points=(point,), distributed=(along,))
    arm = forward_kinematics(robot, [0.3, 1.5], [0.0, -0.003], load=load)
    arms = LoadedArms.of(Constants.of(robot), [arm], load=DeadLoad.of(robot, load))
    s = (arm.arc_length[1:] + arm.arc_length[:-1])[np.diff(arm.arc_length) > 1e-6] / 2
    positions, step = np.zeros(len(s), dtype=int), 1e-6
    current, before, after = (arms.points(positions, s + d * step) for d in (0, -1, 1))
    tangent = (after - before) / (2 * step)
    acts = np.cross(arm.tip_position - current, load.force) + load.moment
    moments = np.cross(arms.points(positions[:1], np.array([0.025]))[0] - current, point.force) + point.moment
    acts += (s < 0.025)[:, None] * moments
    node, weight = np.polynomial.legendre.leggauss(12)
    for k, start in enumerate(s):
        x = start + (0.05 - start) * (node + 1) / 2
        each = np.cross(arms.points(np.zeros(12, dtype=int), x) - current[k], along.force) + along.moment
        acts[k] += (0.05 - start) / 2 * weight @ each
    torque, bending = arms.sampled(positions, s)
    turning = (acts * tangent).sum(1)
    assert torque.sum(1) == pytest.approx(turning, abs=1e-7)
    assert np.linalg.norm(bending, axis=1) == pytest.approx(
        np.linalg.norm(acts - turning[:, None] * tangent, axis=1), abs=1e-7
    )


@pytest.mark.parametrize("order", [1, -1])
def test_loads_are_sampled_with_the_errors_of_both_ends(order: int) -> None:
    """Torques 2 and -3 between 2.5 and -2.9, moments that differ by 5; and backwards."""
    ends = [
        (np.array([[[[2.0], [-3.0]]]]), np.array([[[[0.0, 0.0], [3.0, 4.0]]]])),
        (np.array([[[[2.5], [-2.9]]]]), np.zeros((1, 1, 2, 2))),
    ]
    samples, parts = iter(ends[::order]), iter([(0.01, 0.03), (0.02, 0.04)])
    wrong = ((np.full((1, 1, 2, 1), twist), np.full((1, 1, 2), bend)) for twist, bend in parts)
    arms = SimpleNamespace(sampled=lambda *_: next(samples), load_error=lambda *_: next(wrong))
    stub: Any = SimpleNamespace(arms=arms, parts=((), ()), start=np.array([0]), end=np.array([1]))
    loads = vars(LoadedIntervals)["loads"].func(stub)
    assert (loads.torque.item(), loads.torque_change.item(), loads.moment_change.item()) == pytest.approx(
        (3.03, 0.53, 5.07)
    )


@pytest.mark.parametrize("strength", [0.1, 0.3, 0.5, 0.7, 0.9])
def test_what_differs_is_sure_also_where_it_spreads_from_rotations_alone(strength: float) -> None:
    """At the samples no torque and no moment differs; between them torques turn, and turns make torques and moments."""
    spread = strength * np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 1.0], [0.5, 0.5, 0.0]])

    def between(c: Any) -> _Samples:
        theta, torque, moment = spread @ [c.angle[0].item(), c.torque.item(), c.moment.item()]
        return _Samples(np.full((1, 1, 1), theta), np.full((1, 1, 1), torque), np.full((1, 1), moment))

    ends: Any = SimpleNamespace(changes=(np.full((1, 1, 1), 1.0), np.zeros((1, 1, 1, 1))))
    still: Any = SimpleNamespace(intervals=ends, _between_samples=between)
    result = _Bounds._changes(still, np.zeros((1, 1, 1)), np.zeros((1, 1)))
    assert result.valid.item() == (strength <= 0.5)
    if result.valid:
        bound = np.array([result.angle[0].item(), result.torque.item(), result.moment.item()])
        exact = np.linalg.solve(np.eye(3) - spread, [1.0, 0.0, 0.0])
        assert (exact * (1 - 1e-12) <= bound).all()
        assert (bound <= 1.6 * exact).all()


@pytest.mark.parametrize("grows", ["turn of one tube", "torque", "moment", "nothing"])
def test_what_differs_is_sure_only_if_all_of_it_is(grows: str) -> None:
    """One of them feeds itself by 0.95, the others by a half."""
    factors = {"turn of one tube": 0.5, "torque": 0.5, "moment": 0.5} | {grows: 0.95}
    turns = np.array([0.5, factors["turn of one tube"]])
    ends: Any = SimpleNamespace(changes=(np.ones((1, 1, 2)), np.ones((1, 1, 2, 2))))
    still: Any = SimpleNamespace(
        intervals=ends,
        _between_samples=lambda c: _Samples(
            turns * c.angle[0], factors["torque"] * c.torque, factors["moment"] * c.moment
        ),
    )
    result = _Bounds._changes(still, np.ones((1, 1, 2)), np.ones((1, 1)))
    assert result.valid.item() == (grows == "nothing")


@pytest.mark.parametrize("per_length", [0.2, -0.2])
def test_forces_and_levers_are_the_most_of_both_ends_of_a_section_and_of_the_time(per_length: float) -> None:
    """By gravity and along the arm, across it; the load ahead of the base of a straight arm is its lever. What cancels
    the force on the tip makes it less towards the plate."""
    load = Load(force=(0.01, 0.0, 0.0), distributed=(per_length, 0.0, 0.0))
    robot = nested((0.0, 0.05, 0.0), (0.0, 0.03, 0.0))
    arms = [forward_kinematics(robot, [0.0, 0.0], shift, load=load) for shift in ([-0.01, -0.01], [-0.008, -0.009])]
    table = LoadedArms.of(Constants.of(robot), arms, load=DeadLoad.of(robot, load))
    intervals = LoadedIntervals.of(table, np.array([0]), np.array([1]))
    for k in range(intervals.length[0].shape[1]):
        sizes = [
            0.01 + per_length * max(end - cuts[0, at], 0.0)
            for cuts, end in ((intervals.start_cuts, 0.04), (intervals.end_cuts, 0.042))
            for at in (k, k + 1)
        ]
        assert intervals.force.v[0, k] == pytest.approx(max(map(abs, sizes)), rel=1e-9)
        assert intervals.force.d[0, k] == pytest.approx(
            max(abs(sizes[2] - sizes[0]), abs(sizes[3] - sizes[1])), abs=1e-12
        )
    longest = np.maximum(*intervals.length)
    ahead_of = np.cumsum((longest * intervals.force.v)[0, ::-1])[::-1]
    assert intervals.lever[0] == pytest.approx(ahead_of)
    straight = intervals.lever / intervals.bending.stiffness
    assert intervals.bending.max_u == pytest.approx(straight)
    along, weight = np.array([[0.0, 3.0, 4.0, 0.1, 0.0, 0.0], [1.0, 0, 0, 0, 0.2, 0]]), np.diag([0.0, 1.5, 2.0])
    hanging = DeadLoad(np.array([np.inf]), np.zeros((1, 6)), np.zeros((2, 2)), along, weight)
    assert hanging.per_length == pytest.approx((5.0 + 1.0 + 1.5 + 2.0, 0.1 + 0.2))


def test_moments_that_cancel_along_a_section_are_the_most_at_its_ends() -> None:
    """M on the tip against 30 M / m along the arm: from less than M the other side at the plate, through 0, to M."""
    moment, robot = 1e-3, nested((0.04, 0.05, 0.0))
    along = Stretch(0.0, 0.06, moment=(-30 * moment, 0.0, 0.0))
    pull = DeadLoad.of(robot, Load(moment=(moment, 0.0, 0.0), distributed=(along,)))
    arms = [forward_kinematics(robot, [0.0], [shift]) for shift in (0.0, 0.002)]
    intervals = LoadedIntervals.of(LoadedArms.of(Constants.of(robot), arms, load=pull), np.array([0]), np.array([1]))
    ends = [moment * (1 - 30 * (cuts[0, -1] - cuts[0])) for cuts in (intervals.start_cuts, intervals.end_cuts)]
    for k in range(intervals.length[0].shape[1]):
        largest = max(abs(end[at]) for end in ends for at in (k, k + 1))
        assert intervals._loads[1].v[0, k] == pytest.approx(largest, rel=1e-9)
        change = max(abs(ends[1][at] - ends[0][at]) for at in (k, k + 1))
        assert intervals._loads[1].d[0, k] == pytest.approx(change, abs=1e-15)
    assert intervals.couple.v[0, -1] == pytest.approx(moment)


def test_moments_twist_the_outermost_tube_by_their_whole_size_where_they_act() -> None:
    """At the ends of sections, where several add up, and along them; at the plate they twist nothing, and beyond the
    arm they act on the tip."""
    robot = nested((0.04, 0.05, 0.0), (0.02, 0.03, 0.0))
    at, moment = np.array([0.0, 0.01, 0.01, 0.03, 0.04, 0.07]), np.array([3.0, 0.0, 4.0])
    points = tuple(PointLoad(position, moment=tuple((k + 1) * moment)) for k, position in enumerate(at.tolist()))
    along = Stretch(0.005, 0.035, moment=(0.0, 0.3, 0.4))
    pull = DeadLoad.of(robot, Load(moment=tuple(10 * moment), distributed=(along,), points=points))
    arm = forward_kinematics(robot, [0.0, 0.0], [0.0, 0.0])
    intervals = LoadedIntervals.of(LoadedArms.of(Constants.of(robot), [arm, arm], load=pull), *np.array([[0], [1]]))
    ends, per_length = intervals.twisting
    long = intervals.length[0][0] > 1e-9
    results = dict(zip(np.round(intervals.start_cuts[0, 1:][long], 9).tolist(), ends[0, long].tolist(), strict=True))
    acting = {0.01: [0, 25], 0.03: [0, 20], 0.04: [25, 0], 0.05: [80, 0]}
    assert results == {position: pytest.approx(acting.get(position, [0, 0])) for position in results}
    assert set(acting) < set(results)
    assert not ends[0, ~long].any()
    middles = (intervals.start_cuts[0, :-1] + intervals.start_cuts[0, 1:])[long] / 2
    outer = (middles > 0.005) & (middles < 0.03)
    inner = (middles > 0.03) & (middles < 0.035)
    assert per_length[0, long] == pytest.approx(0.5 * np.stack([inner, outer], axis=1))


def test_what_is_ahead_of_a_place_that_moves_through_a_load_changes_there() -> None:
    """An outer tube ends 2 mm farther on a stretch of load, which begins before: no change there, and 2 mm here."""
    robot = nested((0.04, 0.05, 0.0), (0.02, 0.03, 0.0))
    along = Stretch(0.01, 0.02, force=(0.3, 0.0, 0.0), moment=(0.0, 0.2, 0.0))
    pull = DeadLoad.of(robot, Load(distributed=(along,)))
    arms = [forward_kinematics(robot, [0.0, 0.0], [0.0, shift]) for shift in (-0.018, -0.016)]
    intervals = LoadedIntervals.of(LoadedArms.of(Constants.of(robot), arms, load=pull), np.array([0]), np.array([1]))
    k = int(
        np.argmax(np.isclose(intervals.start_cuts[0], 0.01) & np.isclose(np.roll(intervals.start_cuts[0], -1), 0.012))
    )
    assert [jet.v[0, k] for jet in intervals._loads] == pytest.approx([0.003, 0.002])
    assert [jet.d[0, k] for jet in intervals._loads] == pytest.approx([6e-4, 4e-4])


@pytest.mark.parametrize(
    ("load", "inwards", "ordered"),
    [
        (Load(moment=(0.0, 0.0, 1e-3)), 0.002, False),
        (Load(moment=(0.0, 0.0, 1e-3)), -0.002, True),
        (Load(force=(0.0, 0.0, 0.1)), 0.002, True),
        (Load(points=(PointLoad(0.02, moment=(0.0, 0.0, 1e-3)),)), 0.002, True),
        (Load(points=(PointLoad(0.03, moment=(0.0, 0.0, 1e-3)),)), 0.002, False),
        (Load(points=(PointLoad(0.03, force=(0.0, 0.0, 0.1)),)), 0.002, True),
    ],
)
def test_no_branch_is_sought_where_a_moment_passes_from_one_tube_to_another(
    load: Load, inwards: float, ordered: bool
) -> None:
    """Two tubes end at one place, where the arm ends. A moment there twists the inner tube; once that is drawn in, a
    moment on the tip twists the outer one, though no breakpoints change their order."""
    robot = nested((0.04, 0.05, 4.0), (0.02, 0.03, 3.0))
    shifts = [-0.02, 0.0], [-0.02 - inwards, 0.0]
    arms = [forward_kinematics(robot, [0.0, 0.0], shift, load=load) for shift in shifts]
    table = LoadedArms.of(Constants.of(robot), arms, load=DeadLoad.of(robot, load))
    ends = np.array([0]), np.array([1])
    assert Intervals.of(table, *ends).ordered.all()
    assert LoadedIntervals.of(table, *ends).ordered.item() == ordered
    # Breakpoints that change their order exclude it under loads, too.
    table.breakpoints[1] = table.breakpoints[1, ::-1]
    assert not LoadedIntervals.of(table, *ends).ordered.any()


@pytest.mark.parametrize("lost", ["margin of one", "margin of other", "samples", "order"])
def test_no_branch_of_loaded_arms_is_shown_where_a_part_of_the_proof_is_missing(
    lost: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    load = Load(force=(1e-3, 0.0, 0.0))
    arms = [forward_kinematics(STEPPED, [angle, 0.1], [-0.02, -0.01], load=load) for angle in (0.3, 0.301)]
    table = LoadedArms.of(Constants.of(STEPPED), arms, load=DeadLoad.of(STEPPED, load))
    intervals, margins = LoadedIntervals.of(table, np.array([0]), np.array([1])), np.ones(2)
    assert loaded_branch(intervals, margins).unbroken.all()
    if lost.startswith("margin"):
        margins[int(lost.endswith("other"))] = 1e-12
    elif lost == "order":
        intervals = replace(intervals, ordered=np.array([False]))
    else:
        changes = _Bounds._changes
        monkeypatch.setattr(_Bounds, "_changes", lambda *a: replace(changes(*a), valid=np.array([False])))
    result = loaded_branch(intervals, margins)
    assert not result.unbroken.any()
    assert np.isinf(result.chord_error).all()


def test_the_moment_of_all_that_acts_to_one_side_of_a_straight_arm_is_its_lever() -> None:
    """Forces by their places and moments as they are: on the tip, at a place, on a stretch, and by weight."""
    length, at, (start, end) = 0.1, 0.03, (0.02, 0.07)
    tip, point, along = np.array([2.0, 0.3]), np.array([1.5, 0.2]), np.array([5.0, 0.7])

    def both(parts: Array) -> Array:
        return np.array([parts[0], 0.0, 0.0, 0.0, parts[1], 0.0])

    pull = DeadLoad(
        at=np.array([at, np.inf]),
        points=np.stack([both(point), both(tip)]),
        stretches=np.array([[start, end]]),
        along=both(along)[None],
        weight=np.array([[4.0, 0.0, 0.0]]),
    )
    arms = SimpleNamespace(ends=np.array([[length]]), load=pull)
    true = length * tip[0] + tip[1] + at * point[0] + point[1] + along[0] * (end**2 - start**2) / 2
    true += along[1] * (end - start) + 4.0 * length**2 / 2
    assert vars(LoadedArms)["_lever"].func(arms) == pytest.approx([true])


def test_moments_that_cancel_ahead_bend_what_lies_between_them() -> None:
    """Of two that oppose each other the base bears none, and more is ahead: the larger of both is its bound."""
    moment = 1e-3
    points = PointLoad(0.01, moment=(moment, 0.0, 0.0)), PointLoad(0.025, moment=(-moment, 0.0, 0.0))
    intervals, bounds = loaded(Load(points=points))
    inside = intervals.start_cuts[0, :-1] < 0.025 - 1e-9
    assert bounds.couple.v[0, inside] == pytest.approx(np.full(inside.sum(), moment))
    assert bounds.couple.v[0, ~inside] == pytest.approx(np.zeros((~inside).sum()))
    assert intervals.lever[0] == pytest.approx(bounds.couple.v[0])
