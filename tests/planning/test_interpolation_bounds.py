"""Bounds of what interpolation along an arm is off: derivatives along it of the tangent, the tubes' turn and the load.

A tangent t turns with t' = u t in size; the exponential of the integral of u has the derivatives that bound those of t.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.examples import nested
from tests.planning.test_cross_section_bounds import derivatives
from tests.planning.test_sharp_bounds import STEPPED, between
from tubeopt import EccentricRobot, Tube, forward_kinematics
from tubeopt.planning.loaded_sections import LoadedArms
from tubeopt.planning.sections import (
    SHAPE_ERROR,
    Constants,
    CurvatureBounds,
    DerivativeBounds,
    Intervals,
    SolvedArms,
    TransportBounds,
)

TIP = 1e-11
"""Error of the tip as it was solved for, m."""


def series(*parts: Any) -> Any:
    """A function of arc length by its value and derivatives at 0."""
    return lambda s: sum(part * s**k / f for k, (part, f) in enumerate(zip(parts, (1, 1, 2, 6), strict=False)))


def jet(*parts: float) -> DerivativeBounds:
    return DerivativeBounds(*(np.full((1, 2), part) for part in parts))


EASE, WOUND = (1 / 3.0, 0.2, 0.15), (0.3, 0.25, 0.0)
"""1 / kt and its derivatives; the first and second of the natural twist."""

PAIRS, DRIFTED = 0.4, 0.35
"""Moment between two tubes, and what moving along them adds to its derivative."""

U, YIELD, BOW, FIRST, SECOND = 0.5, 0.6, 0.7, 0.12, 0.23
"""Curvature; its derivatives by turns of either tube; what moving along the tubes adds to those along the arm."""

BEND = SimpleNamespace(
    pairs=PAIRS * (1 - np.eye(2))[None],
    max_u=np.full(1, U),
    moment=np.full((1, 2), 0.9),
    stiffness=np.full(1, 2.0),
    change=lambda turn: YIELD * turn.sum(-1),
    second=lambda one, other: BOW * (one * other).sum(-1),
)


def found_by(kind: type, name: str, stub: Any) -> Any:
    """What a cached property of a class is of something that has what it takes."""
    return vars(kind)[name].func(stub)


def stub(offset: float, still: bool, h: float, *, wide: bool = False) -> Any:
    """Arms of one equilibrium with one step of length h, whose tubes turn at 0.8 and 1.1 rad/m at its ends."""
    torsional = np.full((2, 1), 3.0)
    constants = SimpleNamespace(
        offset=np.full(2, offset),
        still=still,
        bounds=SimpleNamespace(torsional=torsional, moment=[np.array(k) for k in (0.9, 0.5, 0.4, 0.1)], twist=[0.31]),
        smallest=lambda table, *_: np.full((1, 2), 3.0),
        largest=lambda table, *_: np.full((1, 2), table),
    )
    return SimpleNamespace(
        constants=constants,
        equilibria=[SimpleNamespace(tip_error=TIP)],
        inner=np.array([0]),
        crossed=(None,),
        arc_length=np.array([0.0, h]),
        owner=np.array([0, 0]),
        wide=np.array([wide]),
        _onwards=np.array([[0.8, 1.1], [0.0, 0.0]]),
        torsion=np.array([[0.0, 0.0], [1.1, 0.8]]),
        _torque=lambda gain: 0.45 + gain,
    )


def drift_of(still: bool) -> Any:
    none = np.zeros(())
    flat = DerivativeBounds(none, none, none, none)
    if still:
        return SimpleNamespace(
            compliance=DerivativeBounds(np.full((1, 2), EASE[0]), none, none),
            twist_slope=flat,
            moment=lambda *_: (none, none),
            bend=lambda *_: (none, none),
        )
    return SimpleNamespace(
        compliance=jet(*EASE),
        twist_slope=jet(*WOUND),
        moment=lambda pair, bow: (np.full((1, 2), DRIFTED), None),
        bend=lambda turn, bow: (FIRST, SECOND),
        natural_curvature=jet(0.45, 0.25, 0.2),
        bending_compliance=DerivativeBounds(np.full(1, 0.5), np.full(1, 0.15), np.full(1, 0.11)),
    )


def shape_errors(h: float, u: Any) -> float:
    """What is known of the error of a cubic through points h apart, by the third or the fourth derivative."""
    tangent = derivatives(lambda s: np.exp(u(s)), 0.02)
    return float(min(SHAPE_ERROR[0] * h**3 * tangent[2], SHAPE_ERROR[1] * h**4 * tangent[3])) + TIP


@pytest.mark.parametrize("h", [0.01, 4.0])
def test_interpolation_along_tubes_that_vary_is_off_by_derivatives_of_what_turns_them(
    h: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """theta' = t / kt + u*_z with t' = M and M' what turns the tubes against each other; u by turns and places."""
    monkeypatch.setattr(CurvatureBounds, "of", lambda *_: BEND)
    monkeypatch.setattr(TransportBounds, "of", lambda *_: drift_of(False))
    shape, turned = found_by(SolvedArms, "_errors", stub(0.0, False, h))
    torque = 0.45 + h * PAIRS
    winding = PAIRS * EASE[0] + torque * EASE[1] + WOUND[0]
    speed = 1.1 + h * winding
    twist_slope = series(0.0, *WOUND)
    twist = series(torque, PAIRS, PAIRS * 2 * speed + DRIFTED)
    rate = derivatives(lambda s: twist(s) * series(*EASE)(s) + twist_slope(s), 0.02)
    assert rate[1] == pytest.approx(winding)
    assert turned[0] == pytest.approx(h**3 * rate[2], rel=1e-6)
    turn = series(0.0, speed, winding)
    bent = series(U, FIRST, SECOND)
    slopes = derivatives(lambda s: bent(s) + 2 * YIELD * turn(s) + 2 * BOW * turn(s) ** 2 / 2, 0.02)
    u = series(0.0, U, slopes[1], slopes[2])
    assert shape[0] == pytest.approx(shape_errors(h, u), rel=1e-5, abs=0)


@pytest.mark.parametrize("h", [0.01, 4.0])
def test_interpolation_along_tubes_beside_the_centreline_is_off_by_how_they_are_stretched(
    h: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """theta' = g w: theta'' = g w' + (g' / g) theta', g' = d u', with g between 1 - d u and 1 + d u."""
    offset = 0.2
    monkeypatch.setattr(CurvatureBounds, "of", lambda *_: BEND)
    monkeypatch.setattr(TransportBounds, "of", lambda *_: drift_of(True))
    shape, turned = found_by(SolvedArms, "_errors", stub(offset, True, h))
    speed = 1.1 + h * PAIRS * EASE[0]
    bent = 2 * YIELD * speed
    winding = (1 + offset * U) * PAIRS * EASE[0] + speed * offset * bent / (1 - offset * U)
    slopes_of_bend = 2 * BOW * speed**2 + 2 * YIELD * winding
    u = series(0.0, U, bent, slopes_of_bend)
    assert shape[0] == pytest.approx(shape_errors(h, u), rel=1e-5, abs=0)
    # theta' = g w, with the derivatives of both.
    stretched = series(1 + offset * U, offset * bent, offset * slopes_of_bend)
    twisted = series(speed / (1 - offset * U), PAIRS * EASE[0], PAIRS * 2 * speed * EASE[0])
    rate = derivatives(lambda s: stretched(s) * twisted(s), 0.02)
    assert turned[0] == pytest.approx(h**3 * rate[2], rel=1e-6)


def test_nothing_bounds_interpolation_across_too_many_stretches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(CurvatureBounds, "of", lambda *_: BEND)
    monkeypatch.setattr(TransportBounds, "of", lambda *_: drift_of(False))
    for result in (
        found_by(SolvedArms, "_errors", stub(0.0, False, 0.01, wide=True)),
        found_by(LoadedArms, "_wrong", loaded_stub(0.01, wide=True)),
    ):
        assert all(np.isinf(each[0]).all() for each in result)


FORCE, ALONG, LEVER, COUPLE = 0.8, 0.33, 0.7, 0.21
"""On the cross-section where it is the most, and per length; the moment of the load, at most, and per length."""


def loaded_stub(h: float, *, wide: bool = False) -> Any:
    result = stub(0.0, False, h, wide=wide)
    result.load = SimpleNamespace(per_length=(ALONG, COUPLE))
    result._felt = np.array([[0.3, 0.4, 0.0, 0, 0, 0]] * 2), np.array([[0.0, 0.0, FORCE, 0, 0, 0]] * 2)
    result.ends, result._lever = np.array([[1.0, 1.0]]), np.array([LEVER])
    result.torque = np.array([[0.2, 0.45], [0.45, 0.1]])
    result.reactions = (result.torque, result.torque), None
    return result


@pytest.mark.parametrize("order", [1, -1])
def test_interpolation_along_loaded_arms_is_off_by_derivatives_of_torques_and_moments(
    order: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """t_i' = u a_i e_i + m, M' = n + u sum t + m, n' = f + n u, u = M / K + sum A_i e_i, theta_i' = t_i / kt + u*_z."""
    h = 0.01
    monkeypatch.setattr(CurvatureBounds, "of", lambda *_: BEND)
    monkeypatch.setattr(TransportBounds, "of", lambda *_: drift_of(False))
    arms = loaded_stub(h)
    arms._felt = arms._felt[::order]  # the force is the most at the end or at the begin of the step
    shape, turned, twisted, lifted = found_by(LoadedArms, "_wrong", arms)
    u = U + LEVER / 2.0
    torque = 0.45 + h * (u * 0.9 + COUPLE)
    pull, slope, bending_compliance, compliance = (
        series(*each) for each in ((0.9, 0.5, 0.4), (0.45, 0.25, 0.2), (0.5, 0.15, 0.11), EASE)
    )
    twist = series(0.31, *WOUND)
    tables = [[torque], [LEVER], [0.0], [FORCE], [u]]

    def rates(s: float) -> list[float]:
        t, _, theta, n, bent = (series(*table)(s) for table in tables)
        along = series(ALONG, ALONG * u)(s)  # it turns in the frame of the cross-section
        # So does a moment: its second derivative is asked for when u' is known.
        acts = series(COUPLE, COUPLE * u, COUPLE * (u**2 + sum(tables[4][1:2])))(s)
        return [
            bent * pull(s) * np.exp(theta) + acts,
            n + bent * 2 * t + acts,
            t * compliance(s) + twist(s),
            along + n * bent,
        ]

    def bend(s: float) -> float:
        _, m, theta, *_ = (series(*table)(s) for table in tables)
        return float(m * bending_compliance(s) + 2 * slope(s) * np.exp(theta))

    # Derivatives follow from the equations, order by order.
    for order in (1, 2, 3):
        for table, more in zip(tables, derivatives(rates, 0.02)[order - 1].tolist(), strict=False):
            table.append(more)
        tables[4].append(float(derivatives(bend, 0.02)[order]))
    t, m, theta, _, bent = tables
    fraction = SHAPE_ERROR[0] * h**3
    assert shape[0] == pytest.approx(fraction * (u**2 + bent[1]) + TIP, rel=1e-6)
    assert turned[0] == pytest.approx(np.full(2, h**3 * theta[3]), rel=1e-5)
    assert twisted[0] == pytest.approx(np.full(2, h**3 * t[3]), rel=1e-5)
    assert lifted[0] == pytest.approx(np.array([h**3 * m[3]]), rel=1e-5)


@pytest.mark.parametrize("steps", [(0.01, 0.005), (0.005, 0.01)])
@pytest.mark.parametrize(("kind", "name"), [(SolvedArms, "_errors"), (LoadedArms, "_wrong")])
def test_an_arm_is_as_far_off_as_in_its_longest_step(
    kind: type, name: str, steps: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of two steps that are alike but for their length; rotations, torques and moments in each step as in itself."""
    monkeypatch.setattr(CurvatureBounds, "of", lambda *_: BEND)
    monkeypatch.setattr(TransportBounds, "of", lambda *_: drift_of(False))
    one, both = loaded_stub(max(steps)), loaded_stub(max(steps))
    both.arc_length, both.inner = np.cumsum([0.0, *steps]), np.arange(2)
    both.owner, both.wide = np.zeros(3, dtype=int), np.zeros(2, dtype=bool)
    both._onwards, both.torsion = np.tile([0.8, 1.1], (3, 1)), np.tile([1.1, 0.8], (3, 1))
    both.torque = np.full((3, 2), 0.45)
    both.reactions, both._felt = (
        ((both.torque, both.torque), None),
        tuple(np.tile(each[:1], (3, 1)) for each in one._felt),
    )
    (shape, *thirds), (result, *steps_found) = found_by(kind, name, one), found_by(kind, name, both)
    assert result == pytest.approx(shape, rel=1e-12)
    for third, each in zip(thirds, steps_found, strict=True):
        assert each[int(np.argmax(steps))] == pytest.approx(third[0], rel=1e-12)
        assert (each[int(np.argmin(steps))] < 0.2 * third[0]).all()
        assert not each[-1].any()


@pytest.mark.parametrize("x", [0.0, 1e-6, 0.1, 0.3, 0.5, 0.9, 1.0])
def test_a_cubic_is_off_by_what_the_third_derivative_makes_at_that_place_of_the_step(x: float) -> None:
    """The integral of the size of Peano's kernel is attained in the middle, and 1/8 less at the ends. Steps of 2 and 3,
    of which the second has twice the third derivative."""
    arms: Any = SolvedArms.__new__(SolvedArms)
    vars(arms).update(first=np.array([0, 3]), arc_length=np.array([0.0, 2.0, 5.0]), owner=np.zeros(3, dtype=int))
    third = np.array([[8.0], [54.0], [0.0]])
    s = np.linspace(0, 1, 20001)
    kernel = np.where(x > s, (x - s) ** 2 / 2, 0) - x**2 * (3 - 2 * x) * (1 - s) ** 2 / 2 + x**2 * (1 - x) * (1 - s)
    true = float(np.trapezoid(np.abs(kernel), s))
    result = arms.hermite_error(np.zeros(2, dtype=int), np.array([2 * x, 2 + 3 * x]), third).ravel()
    if x in (0.0, 1.0):
        # A point belongs to the step that follows it.
        assert result == pytest.approx(0.0, abs=1e-15)
    else:
        assert (true * np.array([8.0, 54.0]) <= result * (1 + 1e-6)).all()
        assert (result <= 1.13 * true * np.array([8.0, 54.0])).all()
        if x == 0.5:
            assert result[0] == pytest.approx(8.0 * true, rel=1e-6)


def test_what_nothing_bounds_is_exact_at_points_alone() -> None:
    arms: Any = SolvedArms.__new__(SolvedArms)
    vars(arms).update(first=np.array([0, 2]), arc_length=np.array([0.0, 2.0]), owner=np.zeros(2, dtype=int))
    result = arms.hermite_error(np.zeros(3, dtype=int), np.array([0.0, 1.0, 2.0]), np.array([[np.inf], [0.0]]))
    assert result.ravel().tolist() == [0.0, np.inf, 0.0]


def test_changes_are_as_wrong_as_what_is_interpolated_at_both_ends() -> None:
    """Places with changes 0.5 and -0.7 of one tube and 0.4 of the other, off by 0.02 and 0.03 (0.01) at both ends."""
    positions = iter([np.zeros((1, 1, 2, 2)), np.array([[[[0.5, 0.4], [-0.7, 0.4]]]])][::-1])
    wrong = iter([np.array([[[[0.01, 0.01], [0.02, 0.01]]]]), np.array([[[[0.02, 0.0], [0.03, 0.0]]]])])
    arms = SimpleNamespace(rotations=lambda *_: next(positions), turn_error=lambda *_: next(wrong))
    own, pair = found_by(Intervals, "changes", SimpleNamespace(arms=arms, parts=((), ())))
    assert own.ravel() == pytest.approx([0.75, 0.41])
    assert pair[0, 0] == pytest.approx(np.array([[0.1, 1.16], [1.16, 0.02]]))


def test_the_torque_along_a_step_is_the_larger_of_its_ends_and_what_it_gains() -> None:
    """Twist less the natural one, times kt, towards the tip and from the plate."""
    stiff, natural = np.array([[2.0, 3.0]]), np.array([[0.1, 0.2]])
    arms = stub(0.0, False, 0.1)
    arms.along = lambda side, rows: (None, stiff, None, None, natural, None)
    result = SolvedArms._torque(arms, np.array([[0.01, 0.02]]))
    assert result == pytest.approx(np.array([[2 * 1.0 + 0.01, 3 * 0.9 + 0.02]]))


def test_a_transmission_whose_compliance_changes_along_it_is_off_its_chord_as_a_parabola() -> None:
    """int e ds up to a place that moves by m, e = e0 + e1 s: e1 m^2 is the second derivative, half of it more than the
    slope of the chord."""
    e, slope, bend, moved = 0.5, 0.3, 0.2, 0.4
    whole = np.array([[0.0], [e * moved + slope * moved**2 / 2]])
    along = SimpleNamespace(compliant=lambda length: whole)
    constants = SimpleNamespace(along=along, held=lambda shift: np.zeros((2, 1)))
    compliance_slope = DerivativeBounds(*(np.full((1, 1, 1), each) for each in (slope, bend * moved, 0.0)))
    transport = SimpleNamespace(still=False, compliance_slope=compliance_slope)
    arms = SimpleNamespace(constants=constants, translations=None)
    intervals = SimpleNamespace(
        arms=arms, start=np.array([0]), end=np.array([1]), transport=transport, moved=np.full((1, 1, 1), moved)
    )
    result = found_by(Intervals, "transmission", intervals)
    assert result.v.item() == pytest.approx(whole[1].item())
    assert result.d.item() == pytest.approx((e + slope * moved) * moved)
    assert result.dd.item() == pytest.approx(slope * moved**2)
    assert result.ddd.item() == pytest.approx(bend * moved**3)


def test_places_move_along_tubes_as_far_as_the_end_of_their_section_that_moves_most() -> None:
    """Against places all along the sections, while both tubes slide."""
    shifts = np.array([[-0.02, -0.012], [-0.017, -0.01]])
    intervals = between(STEPPED, *(([0.3, 0.1], shift) for shift in shifts))
    x, moved = np.linspace(0, 1, 11)[:, None], []
    for i in range(2):
        positions = [cuts[0, :-1] + x * np.diff(cuts[0]) for cuts in (intervals.start_cuts, intervals.end_cuts)]
        held = shifts[:, i]
        moved.append(np.abs((positions[1] - held[1]) - (positions[0] - held[0])).max(0))
    assert intervals.moved[0] == pytest.approx(np.array(moved).T)


def test_an_arm_is_as_thick_as_its_outermost_tube_and_bends_as_where_it_is_longer() -> None:
    shifts = [-0.02, -0.012], [-0.017, -0.011]
    intervals = between(STEPPED, *(([0.3, 0.1], shift) for shift in shifts))
    long = np.flatnonzero(intervals.length[0][0] > 0)
    ends = [tube.curved_length + by for tube, by in zip(STEPPED.tubes, shifts[0], strict=True)]
    outer = [intervals.start_cuts[0, k + 1] <= min(ends) + 1e-12 for k in long]
    radii = [STEPPED.tubes[int(reached)].outer_diameter / 2 for reached in outer]
    assert intervals.radius[0, long] == pytest.approx(np.array(radii))
    for k in long:
        lengths = [cuts[0, k + 1] - cuts[0, k] for cuts in (intervals.start_cuts, intervals.end_cuts)]
        result = intervals.sagitta(np.array([0]), np.array([k]), np.array([[0.2, 0.7]]))
        assert result == pytest.approx(intervals.bending.max_u[0, k] * (0.5 * max(lengths)) ** 2 / 8)
    # Three tubes beside the centreline reach as far as their distance from it.
    beside = EccentricRobot(Tube(1.2e-3, 1.0e-3, 0.0, 0.08, 12.0))
    assert Constants.of(beside).radius == pytest.approx(np.full(3, beside.distance + 0.6e-3))


def test_what_turns_between_equilibria_is_the_most_at_the_ends_of_four_stretches() -> None:
    """Of two tubes that wind each other up, by the equilibria themselves."""
    robot = nested((0.0, 0.08, 12.0), (0.0, 0.08, 12.0))
    joints = [([angle, 0.0], None) for angle in (1.5, 1.7)]
    intervals = between(robot, *joints)
    k = int(np.argmax(intervals.length[0][0]))
    table = []
    for each in joints:
        arm = forward_kinematics(robot, *each)
        s = np.linspace(0.0, 0.08, 5)
        table.append([np.interp(s, arm.arc_length, row) for row in arm.rotation])
    change = np.array(table[1]) - np.array(table[0])
    own, pair = intervals.changes
    assert np.ptp(np.abs(change), axis=1).min() > 1e-3
    assert own[0, k] == pytest.approx(np.abs(change).max(1), abs=1e-4)
    assert pair[0, k, 0, 1] == pytest.approx(np.abs(change[0] - change[1]).max(), abs=1e-4)


@pytest.mark.parametrize(
    ("shifts", "ordered"),
    [
        (([-0.03, -0.02], [-0.028, -0.019]), True),
        (([-0.0305, -0.01], [-0.0295, -0.01]), False),  # the ends of the tubes pass each other
        (([-0.01, -0.0305], [-0.01, -0.0295]), False),  # the end of a tube passes the plate
    ],
)
def test_no_branch_is_looked_for_where_the_sections_of_an_arm_change_their_order(
    shifts: tuple[list[float], list[float]], ordered: bool
) -> None:
    """Tubes of 50 and 30 mm: at -30 and -10 mm both end at 20 mm."""
    assert between(STEPPED, *(([0.3, 0.1], shift) for shift in shifts)).ordered.item() == ordered


def test_rotations_torques_and_moments_are_each_as_wrong_as_their_own_third_derivative() -> None:
    arms: Any = SimpleNamespace(
        _wrong=(0.0, np.array([[1.0]]), np.array([[2.0]]), np.array([[3.0]])),
        hermite_error=lambda which, s, third: third,
    )
    assert LoadedArms.turn_error(arms, None, None).tolist() == [[1.0]]
    assert [each.tolist() for each in LoadedArms.load_error(arms, None, None)] == [[[2.0]], [3.0]]


def test_a_step_across_two_changes_of_a_tube_counts_all_three_stretches() -> None:
    """Changes at 0.25 and 0.5 of a step of length 1."""
    stretch = lambda s, cuts: (s[:, None] > 0.25).astype(int) + (s[:, None] > 0.5)  # noqa: E731
    arms: Any = SimpleNamespace(
        constants=SimpleNamespace(still=False, stretch=stretch),
        arc_length=np.array([0.0, 1.0]),
        breakpoints=np.zeros((1, 1)),
        owner=np.array([0, 0]),
        inner=np.array([0]),
    )
    assert [each.item() for each in found_by(SolvedArms, "crossed", arms)] == [0, 1, 2]
