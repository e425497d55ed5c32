"""Bounds that go through products and chords: derivatives of exponentials, and of parabolas over a chord."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tubeopt import EccentricRobot, Tube
from tubeopt.planning import branch
from tubeopt.planning.loaded_branch import _Bounds, _Samples
from tubeopt.planning.sections import Constants, CurvatureBounds, DerivativeBounds, TransportBounds
from tubeopt.planning.trajectory_trace import Sizes
from tubeopt.typing import Array


def exponential(rate: float) -> DerivativeBounds:
    """exp(rate t) at t = 0, with its first three derivatives."""
    return DerivativeBounds(*(np.array([rate**order]) for order in range(4)))


def parts(jet: DerivativeBounds) -> list[float]:
    return [float(each[0]) for each in (jet.v, jet.d, jet.dd, jet.ddd) if each is not None]


@pytest.mark.parametrize(("a", "b"), [(2.0, 3.0), (0.5, 7.0), (0.0, 4.0)])
def test_the_product_of_exponentials_is_that_of_the_sum_of_their_rates(a: float, b: float) -> None:
    assert parts(exponential(a) * exponential(b)) == pytest.approx(parts(exponential(a + b)))
    total = exponential(a) + exponential(b)
    assert parts(total) == pytest.approx([a**k + b**k for k in range(4)])
    short = DerivativeBounds(*(np.array([a**order]) for order in range(3)))
    assert parts(short * exponential(b)) == pytest.approx([(a + b) ** k for k in range(3)])
    assert parts(exponential(a).map(lambda x: 3 * x)) == pytest.approx([3 * a**k for k in range(4)])


def test_bounds_of_the_bend_of_tubes_off_the_centreline_hold_for_all_rotations() -> None:
    """u k(u) = sum m e(theta), k = sum kb / (1 + d u.a), solved for many rotations and differentiated by differences.
    Tubes that all bend to one side nearly reach the bounds; |grad k| is half of its own, as the a share the plane."""
    tube = Tube(1.92e-3, 1.6e-3, 0.0, 60e-3, 70.0)
    robot = EccentricRobot(tube)
    constants = Constants.of(robot)
    inside = constants.stretch(np.array(0.01), constants.breakpoints(robot.home_translations))
    bound, kb, m = (
        CurvatureBounds.of(constants, inside),
        tube.bending_stiffness,
        tube.bending_stiffness * tube.curvature,
    )
    positions = 2 * np.pi / 3 * np.arange(3)
    lever = robot.distance * np.stack([np.sin(positions), -np.cos(positions)], axis=-1)  # d a

    def stiffness(u: Array) -> Array:
        return np.asarray((kb / (1 + u @ lever.T)).sum(-1))

    def bend(theta: Array) -> Array:
        pull = m * np.stack([np.cos(theta).sum(-1), np.sin(theta).sum(-1)], axis=-1)
        u = pull / (3 * kb)
        for _ in range(60):
            u = pull / stiffness(u)[..., None]
        return np.asarray(u)

    random, step = np.random.default_rng(0), 1e-4
    aligned = np.linspace(0, 2 * np.pi, 60, endpoint=False)[:, None] + np.zeros(3)
    theta = np.concatenate([random.uniform(0, 2 * np.pi, (400, 3)), aligned])
    turn = np.concatenate([random.normal(size=(400, 3)), np.ones((60, 3))])
    u, ahead, behind = bend(theta), bend(theta + step * turn), bend(theta - step * turn)
    sloped = -(kb * lever / (1 + u @ lever.T)[..., None] ** 2).sum(1)
    size = np.abs(turn)
    for true, largest, fraction in (
        (np.linalg.norm(u, axis=-1), bound.max_u, 0.99),
        (bound.stiffness / stiffness(u), 1.0, 0.99),
        (np.linalg.norm(sloped, axis=-1), bound.k_u, 0.4),
        (np.linalg.norm(ahead - behind, axis=-1) / (2 * step), bound.change(size), 0.95),
        (np.linalg.norm(ahead - 2 * u + behind, axis=-1) / step**2, bound.second(size, size), 0.95),
    ):
        assert (true <= largest * (1 + 1e-6)).all()
        assert (true / largest).max() >= fraction


@pytest.mark.parametrize(("along", "time", "sagitta", "radius"), [(0.0, 0.0, 3e-4, 5e-4), (4e-6, 9e-6, 2e-4, 1e-3)])
def test_a_bent_patch_of_an_arm_takes_sagitta_and_radius_off_the_clearance(
    along: float, time: float, sagitta: float, radius: float
) -> None:
    sizes = Sizes(*(np.array([each]) for each in (along, time, sagitta, 7e-4, radius)))
    flat = Sizes(*(np.array([each]) for each in (along, time, 0.0, 7e-4, 0.0)))
    for distance in (0.0, 1e-3, 8e-3):
        at = np.array([distance])
        assert sizes.bound(at)[0] == pytest.approx(flat.bound(at)[0] - sagitta - radius, abs=1e-15)
    # At the distance that is needed the bound is the threshold: `needed` is the inverse of `bound`.
    clear = sizes.bound(np.array([sizes.needed(2e-3)]))[0]
    assert clear == pytest.approx(2e-3, rel=1e-12)


@pytest.mark.parametrize("bow", [0.0, 0.6, 4.0])
def test_between_its_ends_a_parabola_is_no_steeper_than_its_chord_by_more_than_half_its_bow(bow: float) -> None:
    # f = t (change + bow (1 - t) / 2): f' is change + bow / 2 where it begins, |f''| the bow.
    change, t = 0.3, np.linspace(0, 1, 101)
    curve = DerivativeBounds(np.ones((1, 1, 1)), np.zeros((1, 1, 1)), np.full((1, 1, 1), bow))
    still = SimpleNamespace(
        lever=np.zeros((1, 1)),
        _twist=lambda torque: curve,
        _bend=lambda theta, moment: DerivativeBounds(*np.zeros((3, 1, 1))),
        _balance=lambda theta, pair, tangent: (None, None),
    )
    turn = np.full((1, 1, 1), change), np.full((1, 1, 1, 1), change)
    changes: Any = SimpleNamespace(angle=turn, torque=np.zeros((1, 1, 1)), moment=np.zeros((1, 1)))
    chord = _Bounds._chord(still, changes, np.zeros((1, 1, 1)))  # type: ignore[arg-type]
    theta, pair = chord.theta, chord.pair
    steepest = np.abs(change + bow * (1 - 2 * t) / 2).max()
    assert theta.d.item() == pytest.approx(steepest)
    assert theta.dd.item() == bow
    # Of a difference of two tubes that bow by as much each, twice the bow at most, and by as much its slope.
    assert pair.dd.item() == pytest.approx(2 * bow)
    assert pair.d.item() == pytest.approx(change + bow)


@pytest.mark.parametrize("which", ["bend", "moment"])
def test_what_drift_adds_is_the_second_derivative_of_a_pull_that_changes_as_it_turns(which: str) -> None:
    """Of a(t) exp(i theta(t)), but for a theta'^2, which is there without drift; sharp where terms are parallel."""
    random = np.random.default_rng(0)
    none = DerivativeBounds(*np.zeros((3, 1, 1)))
    for _ in range(50):
        v, d, dd, turn, bow = random.uniform(0.0, 2.0, 5)
        for change, speed, curve in ((d, dd, bow), (0.0, dd, 0.0), (d, 0.0, bow)):
            pulls = DerivativeBounds(*(np.array([[each]]) for each in (v, change, speed)))
            transport = TransportBounds(False, pulls, pulls, none, none, none, none, none)
            first, second = getattr(transport, which)(np.array([[turn]]), np.array([[curve]]))
            true = speed + 2j * change * turn + 1j * v * curve
            assert first.item() == pytest.approx(change)
            assert abs(true) <= second.item() * (1 + 1e-12)
            if not change or not speed:
                assert second.item() == pytest.approx(abs(true))


def test_what_drift_adds_to_a_bend_is_the_sum_over_the_tubes_of_a_cross_section() -> None:
    none = DerivativeBounds(*np.zeros((3, 1, 1)))
    v, d, dd, turn, bow = np.random.default_rng(1).uniform(0.0, 2.0, (5, 2, 3))

    def added(tubes: slice) -> Array:
        pulls = DerivativeBounds(v[:, tubes], d[:, tubes], dd[:, tubes])
        transport = TransportBounds(False, pulls, pulls, none, none, none, none, none)
        return np.array(transport.bend(turn[:, tubes], bow[:, tubes]))

    assert added(slice(3)) == pytest.approx(sum(added(slice(i, i + 1)) for i in range(3)))


@pytest.mark.parametrize("share", [0.0, 0.1, 0.3, 0.4999, 0.5001, 0.8, 1.0, 3.0])
def test_what_lies_between_samples_is_sure_as_far_as_its_series_is_bounded(share: float) -> None:
    """x = own + share x has x = own / (1 - share): twice the first term is as much up to a share of a half."""
    ends: Any = SimpleNamespace(changes=(np.array([[[0.7]]]), np.full((1, 1, 1, 1), 0.7)))
    still: Any = SimpleNamespace(
        intervals=ends,
        transport=SimpleNamespace(twist_deviation=SimpleNamespace(d=np.zeros((1, 1, 1)))),
        _between_samples=lambda turn: share * turn[0],
    )
    (wide, both), sure = branch._Bounds.angle_change(still)
    assert sure.item() == (share <= 0.5)
    if sure:
        assert wide.item() >= 0.7 / (1 - share) * (1 - 1e-12)
        assert both.item() - 0.7 == pytest.approx(2 * (wide.item() - 0.7))


def test_what_turns_between_samples_is_as_steep_as_the_natural_turn() -> None:
    """Of tubes whose turn is off a straight line in time with rate 0.05."""
    ends: Any = SimpleNamespace(changes=(np.full((1, 1, 1), 0.7), np.full((1, 1, 1, 1), 0.9)))
    transport = SimpleNamespace(twist_deviation=SimpleNamespace(d=np.full((1, 1, 1), 0.05)))
    still: Any = SimpleNamespace(intervals=ends, transport=transport, _between_samples=lambda turn: 0.0 * turn[0])
    (own, pair), _ = branch._Bounds.angle_change(still)
    assert (own.item(), pair.item()) == pytest.approx((0.75, 0.9 + 2 * 0.05))


@pytest.mark.parametrize("share", [0.0, 0.3, 0.8, 0.8408, 0.841, 1.0, 3.0])
def test_what_lies_between_samples_of_loaded_arms_is_sure_as_far_as_its_series_is_bounded(share: float) -> None:
    """The last of four terms of the series is doubled: as much as all that are left up to share^4 = 1/2."""
    ends: Any = SimpleNamespace(changes=(np.full((1, 1, 1), 0.7), np.full((1, 1, 1, 1), 1.4)))
    still: Any = SimpleNamespace(
        intervals=ends, _between_samples=lambda c: _Samples(share * c.angle[0], share * c.torque, share * c.moment)
    )
    result = _Bounds._changes(still, np.full((1, 1, 1), 0.2), np.full((1, 1), 0.3))
    assert result.valid.item() == (share**4 <= 0.5)
    if result.valid:
        for bound, own in ((result.angle[0], 0.7), (result.angle[1], 1.4), (result.torque, 0.2), (result.moment, 0.3)):
            assert bound.item() >= own / (1 - share) * (1 - 1e-12)
