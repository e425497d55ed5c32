"""Tip speed is bounded from above at all times, and sharply; see "Speed of the tip" in docs/theory-proofs.md."""

from __future__ import annotations

import math
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.examples import PIECES, THESIS, TWO_TUBE
from tubeopt import (
    EccentricRobot,
    Load,
    RateLimits,
    Tube,
    forward_kinematics,
    load_robot,
    plan_trajectory,
    verify_trajectory,
)
from tubeopt.bodies.obstacles import scene_of
from tubeopt.equilibrium.continuation import Family, SampledJointPath, meetings
from tubeopt.errors import InputError
from tubeopt.inverse.clock import Clock
from tubeopt.planning import PlanOptions, trajectory_trace
from tubeopt.planning.proof import HERMITE, _Row, fastest_on_cubic
from tubeopt.planning.sections import DerivativeBounds, inverse, unit_vector
from tubeopt.planning.trajectory_trace import ClearanceTarget, Link, TraceStep, TrajectoryVerifier, _divided
from tubeopt.robots.load import PointLoad
from tubeopt.robots.robot import Robot
from tubeopt.typing import Array

ECCENTRIC = EccentricRobot(Tube(1.2e-3, 1.0e-3, 0.0, 0.08, 12.0), transmission_length=0.05)


def _tip(robot: Robot, joints: Array, load: Load | None = None) -> Array:
    return forward_kinematics(robot, *np.split(joints, 2), load=load).tip_position


@pytest.mark.parametrize(
    ("robot", "begin", "end", "load"),
    [
        (THESIS, [0.9, 0.3, 0.1], [1.0, 0.28, 0.1], None),
        (THESIS, [0.9, 0.3, 0.1], [0.92, 0.296, 0.1], Load(force=(0.03, 0.02, 0))),
        (PIECES, [0.4, 0.0, -0.2][: PIECES.n_tubes], [0.41, 0.004, -0.2][: PIECES.n_tubes], None),
        (ECCENTRIC, [0.5, -0.5, 0.1][: ECCENTRIC.n_tubes], [0.6, -0.5, 0.1][: ECCENTRIC.n_tubes], None),
    ],
    ids=["concentric", "loaded", "pieces", "eccentric"],
)
def test_second_and_third_derivatives_of_the_tip_are_bounded(
    robot: Robot, begin: list[float], end: list[float], load: Load | None
) -> None:
    """By differences of solved equilibria, translations moving too."""
    home = np.array(robot.home_translations)
    slide = 2e-5
    a, b = np.append(begin, home - 0.010), np.append(end, home - 0.010 + slide * np.arange(robot.n_tubes))
    if robot is ECCENTRIC:
        a, b = np.append(begin, home), np.append(end, home)
    verifier = TrajectoryVerifier(robot, scene_of(()), ClearanceTarget(0.0, 1e-5, 10), Clock(math.inf), load)
    arms = [forward_kinematics(robot, *np.split(q, 2), load=load) for q in (a, b)]
    intervals = verifier.intervals(arms, np.array([0]), np.array([1]))
    known = verifier.prove(intervals)
    assert known.unbroken.all()
    second, third = known.rates[:, 0]
    tips = np.array([_tip(robot, a + (b - a) * x, load) for x in np.linspace(0, 1, 5)])
    speeding = np.linalg.norm(np.diff(tips, 2, axis=0), axis=1).max() * 4**2
    jerking = np.linalg.norm(np.diff(tips, 3, axis=0), axis=1).max() * 4**3
    assert speeding <= second < 1e3 * speeding
    assert jerking <= third < 1e5 * jerking


def test_the_speed_of_a_wound_tip_is_no_mean_between_equilibria() -> None:
    """The inner tube from 0 to 214 deg: chords between equilibria give 116.3 mm/s, J q' 132.9 mm/s."""
    last = np.radians([214, 0, 0])
    near = [forward_kinematics(THESIS, last * x, start=None) for x in (0.0,)]
    for x in np.append(np.linspace(0.02, 0.98, 49), 1 - np.logspace(-2, -5, 7)):
        near.append(forward_kinematics(THESIS, last * x, start=near[-1]))
    jacobian = forward_kinematics(THESIS, last, start=near[-1]).jacobian().position
    fastest = float(np.linalg.norm(jacobian[:, 0])) * last[0] / 10
    proof = verify_trajectory(THESIS, [0, 10], [[0, 0, 0], last])
    assert 0.13 < fastest <= proof.largest_tip_rate <= 1.03 * fastest
    assert proof.measured_tip_rate <= fastest
    limited = verify_trajectory(THESIS, [0, 10], [[0, 0, 0], last], rate_limits=RateLimits(tip=0.12))
    assert limited.faults[0].startswith("the tip reaches")
    assert verify_trajectory(THESIS, [0, 10], [[0, 0, 0], last], rate_limits=RateLimits(tip=0.135)).holds
    # Less above the truth than what the bound gives away by itself.
    assert verify_trajectory(THESIS, [0, 10], [[0, 0, 0], last], rate_limits=RateLimits(tip=fastest * 1.003)).holds


def test_a_circle_of_the_tip_is_passed_at_its_speed() -> None:
    """All tubes turn together: the tip runs on a circle, whose radius is known."""
    proof = verify_trajectory(THESIS, [0, 2], [[0.3, 0.3, 0.3], [1.3, 1.3, 1.3]])
    x, y, _ = forward_kinematics(THESIS, [0.3, 0.3, 0.3]).tip_position
    exact = math.hypot(x, y) / 2
    assert exact * (1 - 1e-6) <= proof.largest_tip_rate <= 1.03 * exact


@pytest.mark.parametrize("load", [None, Load(force=(0.02, 0.01, 0.0))], ids=["unloaded", "force"])
def test_changes_of_pace_need_few_further_equilibria(load: Load | None) -> None:
    """Forty samples with a smooth law of time: the inner tube passes its fastest place at a known J q'."""
    x = np.linspace(0, 1, 41)
    angle = (x**3 * (10 - 15 * x + 6 * x**2))[:, None] * [0.8, 0.0, 0.0]
    proof = verify_trajectory(THESIS, 2 * x, angle, load=load)
    fast = [[float(angle[k, 0]) + d, 0.0, 0.0, *THESIS.home_translations] for k in (19, 20, 21) for d in (-1e-5, 1e-5)]
    tips = [_tip(THESIS, np.array(q), load) for q in fast]
    sizes = [np.linalg.norm(b - a) / 2e-5 for a, b in zip(tips[::2], tips[1::2], strict=True)]
    rate = float(np.diff(angle[:, 0]).max()) / 0.05
    assert rate * max(sizes) * (1 - 1e-4) <= proof.largest_tip_rate <= 1.03 * rate * max(sizes)
    assert proof.equilibria <= (43 if load is None else 60)


def test_a_slow_motion_of_loaded_pieces_needs_few_equilibria() -> None:
    """The inner tube turns by 0.1 rad in 100 s. Errors of interpolation along the arm do not shrink with the links."""
    current, turn = np.array([0.1, 0.5, 0.0, -0.012, -0.012, -0.012]), np.array([0.1, 0, 0, 0, 0, 0])
    load = Load(force=(0.004, 0.003, -0.002))
    joints = [current, current + turn]
    proof = verify_trajectory(PIECES, [0, 100], [q[:3] for q in joints], [q[3:] for q in joints], load=load)
    tips = [_tip(PIECES, current + turn * x, load) for x in np.linspace(0, 1, 21)]
    true = np.linalg.norm(np.diff(tips, axis=0), axis=1).max() / 5
    assert true <= proof.largest_tip_rate <= 1.03 * true
    assert proof.equilibria <= 30


def test_what_is_not_proved_of_the_speed_is_not_kept() -> None:
    moved = [[0.0, 0, 0], [0.2, 0, 0]]
    uncovered = Load(force=(1e-3, 0, 0), frame="tip")
    proof = verify_trajectory(THESIS, [0, 1], moved, load=uncovered, rate_limits=RateLimits(tip=1.0))
    assert proof.largest_tip_rate == math.inf
    assert math.isfinite(proof.measured_tip_rate)
    assert any("nothing bounds the speed of the tip" in fault for fault in proof.faults)
    pushed = verify_trajectory(THESIS, [0, 1], moved, max_force=1e-3, rate_limits=RateLimits(tip=1.0))
    assert pushed.largest_tip_rate == math.inf
    assert any("while a force changes" in fault for fault in pushed.faults)
    with pytest.raises(InputError, match="is no bound on the tip speed"):
        plan_trajectory(
            THESIS,
            (moved[0], None),
            (moved[1], None),
            rate_limits=RateLimits(tip=0.1),
            options=PlanOptions(max_force=1e-3),
        )


def test_product_and_inverse_of_jets_are_exact_where_all_derivatives_are_positive() -> None:
    """(e^(a t), e^(b t)) at 0: derivatives of their product are powers of a + b; 1 / (1 - c (e^t - 1)) has those of a
    series without negative terms."""
    one, other = (DerivativeBounds(*(np.array(x**k) for k in range(4))) for x in (0.7, 1.9))
    product = one * other
    assert [float(x) for x in (product.v, product.d, product.dd, product.ddd)] == pytest.approx(
        [2.6**k for k in range(4)]
    )
    c = 0.4
    result = inverse(DerivativeBounds(np.array(1.0), *(np.array(c) for _ in range(3))))
    exact = [1.0, c, c + 2 * c**2, c + 6 * c**2 + 6 * c**3]
    assert [float(x) for x in (result.v, result.d, result.dd, result.ddd)] == pytest.approx(exact)


def test_a_turned_unit_vector_changes_as_its_jet_says() -> None:
    """e(phi) for phi = w t: derivatives are powers of w, exactly; for phi = t^3 the third is 6."""
    steady = unit_vector(DerivativeBounds(np.array(0.0), np.array(1.7), np.array(0.0), np.array(0.0)))
    assert [float(x) for x in (steady.v, steady.d, steady.dd, steady.ddd)] == pytest.approx([1.7**k for k in range(4)])
    cubic = unit_vector(DerivativeBounds(np.array(0.0), np.array(0.0), np.array(0.0), np.array(6.0)))
    assert float(cubic.ddd) == 6.0
    # phi = t + t^2 at 0: |e'''| = |(i^2) 3 phi' phi'' + i^3 phi'^3| = |-6 - i|, at most 7.
    both = unit_vector(DerivativeBounds(np.array(0.0), np.array(1.0), np.array(2.0), np.array(0.0)))
    assert math.hypot(6, 1) <= float(both.ddd) == 7.0


def test_a_limit_that_the_bound_does_not_reach_is_not_proved(monkeypatch: pytest.MonkeyPatch) -> None:
    """With too few equilibria for a sharp bound the limit is neither refuted nor satisfied."""
    last = np.radians([214, 0, 0])
    monkeypatch.setattr(trajectory_trace, "MAX_EQUILIBRIA", 121)
    proof = verify_trajectory(THESIS, [0, 10], [[0, 0, 0], last], rate_limits=RateLimits(tip=0.1329))
    assert proof.measured_tip_rate < 0.1329 < proof.largest_tip_rate
    assert not proof.holds
    assert any("of the speed of the tip only" in fault for fault in proof.faults)


def test_the_cubic_through_both_velocities_leaves_a_31st_of_the_third_derivative() -> None:
    """The most that |w''| <= 1 leaves of w - q, where q has the ends and the mean of w: the integral of the size of
    what a unit impulse of w'' leaves, by the midpoint rule."""
    s = (np.arange(4000) + 0.5) / 4000
    largest = 0.0
    for x in np.append(np.linspace(0.0, 1.0, 201), 0.2324):
        impulse = -np.minimum(x, s) * (1 - np.maximum(x, s))
        mean = -s * (1 - s) / 2
        largest = max(largest, float(np.abs(impulse - 6 * x * (1 - x) * mean).mean()))
    assert 0.999 * HERMITE <= largest <= HERMITE


def test_the_speed_along_a_cubic_is_bounded_sharply() -> None:
    rng = np.random.default_rng(3)
    x = np.linspace(0.0, 1.0, 5001)
    for bow in (0.0, 0.3, 3.0):
        start, end = rng.normal(size=(2, 3))
        curve = np.polynomial.Polynomial.fit([0, 0.5, 1], [0, 1, 0], 2)(x)  # of mean 2/3
        velocity = start + np.outer(x, end - start) + np.outer(curve, np.array([bow, -bow, bow / 2]))
        true = np.linalg.norm(velocity, axis=1).max()
        mean = (start + end) / 2 + 2 / 3 * np.array([bow, -bow, bow / 2])
        assert true <= fastest_on_cubic(mean, start, end) * (1 + 1e-12)
        assert fastest_on_cubic(mean, start, end) <= 1.03 * true


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_speed_along_a_cubic_counts_the_bow_of_its_velocity(sign: float) -> None:
    """From rest to rest, the velocity 6 x (1 - x) is 1.5 in the middle; with the ends 1 and a mean below, it is 1."""
    along = np.array([1.0, 0.0, 0.0])
    if sign > 0:
        assert 1.5 <= fastest_on_cubic(along, 0 * along, 0 * along) <= 1.5 * 1.02
    else:
        assert 1.0 <= fastest_on_cubic(0.9 * along, along, along) <= 1.01


def test_two_tubes_need_no_more_equilibria_for_the_speed_of_the_tip() -> None:
    """Velocities at both ends of links suffice; the bound is above the fastest J q' and at most 3 % above."""
    last = np.radians([60.0, 0.0])
    proof = verify_trajectory(TWO_TUBE, [0, 3], [[0, 0], last])
    true = 0.0
    for x in np.linspace(0, 1, 61):
        jacobian = forward_kinematics(TWO_TUBE, x * last).jacobian().position
        true = max(true, float(np.linalg.norm(jacobian[:, 0])) * last[0] / 3)
    assert proof.equilibria <= 28
    assert true <= proof.largest_tip_rate <= 1.03 * true


def row(h: list[float], speed: list[float], pace: list[float] | None = None, error: float = 0.0) -> Any:
    """Links that follow each other, of which only this is known."""
    result: Any = _Row.__new__(_Row)
    count = len(h)
    chord = np.array(speed)[:, None] * [1.0, 0.0, 0.0]
    steps = [SimpleNamespace(equilibrium=SimpleNamespace(tip_error=error * (k == 0))) for k in range(count + 1)]
    vars(result).update(
        links=[SimpleNamespace(fastest=math.inf)] * count,
        passed=np.array(h),
        speed=np.array(speed),
        pace=np.array(pace or [1.0] * count),
        chord=chord,
        alike=np.ones(count - 1, dtype=bool),
        steps=steps,
    )
    return result


def test_a_velocity_that_grows_linearly_is_ahead_of_its_mean_by_half_of_its_growth() -> None:
    """v = mean + a t from -h / 2 to h / 2; the mean of measured places is off by both of them."""
    result = row([0.4], [0.3], error=1e-3).fastest(np.array([[0.5], [np.inf]]), 0.0)[0]
    assert result == pytest.approx([0.3 + 0.5 * 0.2 + 2 * 1e-3 / 0.4])


def test_a_velocity_that_bends_is_bounded_by_the_middles_of_neighbouring_links() -> None:
    """v = c - T s^2 / 2 of the way s = 0 between two links, which the second one takes at twice the pace."""
    top, bend, error = 0.7, 0.3, 1e-3
    mean = top - bend / 6
    links = row([1.0, 0.5], [mean, 2 * mean], [1.0, 2.0], error)
    vars(links)["velocity"] = lambda step, link: np.array([1e-9, 0.0, 0.0])
    # The second link may bend less.
    rates = np.array([[np.inf, np.inf], [bend, 8 * 0.9 * bend]])
    result = links.fastest(rates, 0.0)[0]
    assert result[0] == pytest.approx(top + 2 * error)
    # Of places that are exact the second is twice as fast.
    exact = row([1.0, 0.5], [mean, 2 * mean], [1.0, 2.0])
    vars(exact)["velocity"] = links.velocity
    equal = np.array([[np.inf, np.inf], [bend, 8 * bend]])
    assert exact.fastest(equal, 0.0)[0] == pytest.approx([top, 2 * top], rel=1e-6)
    assert exact.fastest(rates, 0.0)[0][0] == pytest.approx(top, rel=1e-6)
    vars(exact)["alike"] = np.array([False])
    vars(exact)["velocity"] = lambda step, link: None
    assert np.isinf(exact.fastest(rates, 0.0)[0]).all()


def test_the_bound_of_a_link_by_its_end_is_that_of_half_the_link() -> None:
    """A neighbour of no length whose middle is as fast as that of the link, which bends by T in all of it."""
    bend, h, mean = 0.3, 2.0, 0.5
    links = row([h, 1e-9], [mean, mean])
    middle = mean + bend * h**2 / 24
    for fast in (middle + 0.2, middle - 0.2):
        vars(links)["velocity"] = lambda step, link, fast=fast: np.array([fast, 0.0, 0.0]) if step == 0 else None
        result, _ = links.fastest(np.array([[np.inf] * 2, [bend, 0.0]]), 0.0)
        near = max(middle, fast) + bend * (h / 2) ** 2 / 8
        far = middle + bend * (h / 2) ** 2 / 8
        assert result[0] == pytest.approx(max(near, far), rel=1e-6)


def test_a_link_is_as_fast_as_the_cubic_through_both_velocities_and_what_it_leaves() -> None:
    """From 1 to 1 with the mean 0.9 the cubic is slower between; what the mean is off counts 3/2 there."""
    bend, h, error = 0.4, 0.1, 1e-4
    ends, mean = np.array([1.0, 0.0, 0.0]), 0.9
    links = row([h], [mean], error=error)
    vars(links)["velocity"] = lambda step, link: ends
    result, reached = links.fastest(np.array([[np.inf], [bend]]), 0.0)
    cubic = fastest_on_cubic(mean * ends, ends, ends)
    sides = 1.0 + bend * h**2 / 32
    assert reached == 1.0
    assert result[0] == pytest.approx(min(sides, cubic + 1.5 * 2 * error / h + HERMITE * bend * h**2))
    # Where the middle is the fastest the cubic is the sharper one.
    links = row([h], [mean], error=error)
    vars(links)["velocity"] = lambda step, link: 0.85 * ends
    middle = mean + 200 * h**2 / 24 + 2 * error / h
    cubic = fastest_on_cubic(mean * ends, 0.85 * ends, 0.85 * ends) + 1.5 * 2 * error / h + HERMITE * 200 * h**2
    result, _ = links.fastest(np.array([[np.inf], [200.0]]), 0.0)
    assert cubic < middle + 200 * h**2 / 32
    assert result[0] == pytest.approx(cubic)


def test_the_speed_along_a_cubic_between_samples_is_that_of_a_parabola() -> None:
    """6 x (1 - x) + 3/4 x is fastest at 9/16, half-way between two samples."""
    along = np.array([1.0, 0.0, 0.0])
    # Between 0 and 3/4 with a mean of 1 + 3/8.
    result = fastest_on_cubic(1.375 * along, 0.0 * along, 0.75 * along)
    assert result == pytest.approx(6 * 9 / 16 * 7 / 16 + 0.75 * 9 / 16, rel=1e-12)


def going(joints: list[list[float]]) -> Any:
    """Links at times 0, 1, 2 of a robot of two tubes, whose breakpoints are as far in front of the plate as both are
    advanced, and 1/4 m farther."""

    def cuts(translations: Array) -> Array:
        moving = np.concatenate([translations, translations + 0.25], axis=-1)
        return np.concatenate([np.zeros((*moving.shape[:-1], 1)), moving], axis=-1)

    verifier = SimpleNamespace(robot=SimpleNamespace(n_tubes=2), constants=SimpleNamespace(ended=2), cuts=cuts)
    steps = [SimpleNamespace(joints=np.array(each), equilibrium="arm") for each in joints]
    result: Any = _Row.__new__(_Row)
    vars(result).update(
        verifier=verifier,
        links=[SimpleNamespace(start=a, end=b) for a, b in pairwise(steps)],
        passed=np.ones(len(joints) - 1),
        steps=steps,
    )
    return result


@pytest.mark.parametrize(
    ("joints", "alike"),
    [
        ([[0.0, 0.0, 0.25, 0.6], [0.1, 0.05, 0.35, 0.6], [0.3, 0.15, 0.55, 0.6]], False),
        ([[0.0, 0.0, 0.05, 0.6], [0.1, 0.05, 0.06, 0.6], [0.3, 0.15, 0.08, 0.6]], True),
        ([[0.0, 0.0, 0.05, 0.6], [0.1, 0.05, 0.06, 0.6], [0.3, 0.16, 0.08, 0.6]], False),
        ([[0.0, 0.0, 0.0, 0.0], [0.1, 0.05, 0.0, 0.0], [0.3, 0.15, 0.0, 0.0]], True),
    ],
    ids=["breakpoints pass each other", "straight on", "another direction", "turns alone"],
)
def test_joints_go_on_alike_along_one_line_of_one_order_of_sections(joints: list[list[float]], alike: bool) -> None:
    assert going(joints).alike.tolist() == [alike]


def moving(robot: Robot, here: list[float], rate: list[float], load: Load | None = None) -> Any:
    """One link from joint values at given rates, of equilibria so close that their difference has no second order."""
    verifier = TrajectoryVerifier(robot, scene_of(()), ClearanceTarget(0.0, 1e-5, 10), Clock(math.inf), load)
    joints = [np.array(here) + np.array(rate) * t for t in (0.0, 1e-3)]
    steps = [
        TraceStep(t, forward_kinematics(robot, *np.split(q, 2), load=load), q)
        for t, q in zip((0, 1), joints, strict=True)
    ]
    return _Row(verifier, [Link(*steps)], 1e-3, {})


@pytest.mark.parametrize("end", [0, 1])
@pytest.mark.parametrize(
    ("robot", "here", "rate", "load"),
    [
        (TWO_TUBE, [1.0, 0.3, -0.02, -0.02], [0.5, 0.2, 0.03, 0.03], None),
        (TWO_TUBE, [1.0, 0.3, -0.02, -0.02], [0.5, 0.2, -0.03, 0.02], None),
        (TWO_TUBE, [1.0, 0.3, -0.02, -0.02 + 4e-13], [0.5, 0.2, 0.02, -0.03], None),
        (THESIS, [0.0, 1.0, 2.0, 0.0, 0.0, 0.0], [0.1, 0.2, 0.3, -0.01, -0.02, -0.03], None),
        (PIECES, [0.5, -0.4, 1.2, -0.03, -0.04, -0.02], [0.5, 0.3, 0.1, 0.01, -0.02, 0.03], None),
        (PIECES, [0.5, -0.4, 1.2, -0.0135412, -0.03, -0.0135412], [0.1, 0.2, 0.3, 0.02, 0.01, -0.03], None),
        (TWO_TUBE, [1.0, 0.3, -0.02, 0.0], [0.5, 0.2, 0.0, -0.03], None),
        (TWO_TUBE, [1.0, 0.3, -0.02, -0.03], [0.5, 0.2, 0.0, -0.03], Load(points=(PointLoad(0.07, (0.03, 0.0, 0.0)),))),
        (TWO_TUBE, [1.0, 0.3, -0.02, -0.02], [0.5, 0.2, 0.03, 0.03], Load(force=(0.02, 0.01, 0.0))),
        (THESIS, [0.0, 1.0, 2.0, 0.0, 0.0, 0.0], [0.1, 0.2, 0.3, -0.01, -0.02, -0.03], Load(force=(0.02, 0.01, 0.0))),
    ],
    ids=[
        "together",
        "apart",
        "round-off",
        "plate",
        "no meeting",
        "pieces",
        "plate alone",
        "point",
        "together, force",
        "plate, force",
    ],
)
def test_velocities_where_breakpoints_meet_are_those_on_the_side_of_the_link(
    robot: Robot, here: list[float], rate: list[float], load: Load | None, end: int
) -> None:
    """By differences of three equilibria on that side, in which no two sections change their order."""
    links = moving(robot, here, rate, load)
    if end:  # the link leads to where breakpoints meet
        links = moving(robot, [q - v * 1e-3 for q, v in zip(here, rate, strict=True)], rate, load)
    at, inwards = links.steps[end].joints, (1, -1)[end]
    step = 2e-4 * inwards
    tips = [_tip(robot, at + np.array(rate) * step * k, load) for k in range(3)]
    slope = (4 * tips[1] - 3 * tips[0] - tips[2]) / (2 * step)
    assert links.velocity(end, 0) == pytest.approx(slope, abs=2e-5 * np.linalg.norm(slope))


def test_tubes_that_end_together_are_as_fast_as_their_tip() -> None:
    """Both carriages forward at 30 mm/s, no turn: the arm leaves the plate along its own line as fast as that."""
    proof = verify_trajectory(TWO_TUBE, [0, 0.2], [[0.0, 0.0]] * 2, [[-0.03, -0.03], [-0.024, -0.024]])
    true = 0.0
    for shift in np.linspace(-0.03, -0.0241, 60):
        before, after = (_tip(TWO_TUBE, np.array([0, 0, x, x])) for x in (shift, shift + 1e-4))
        true = max(true, float(np.linalg.norm(after - before)) / 1e-4 * 0.03)
    assert true * (1 - 1e-6) <= proof.largest_tip_rate <= 1.03 * true
    limited = verify_trajectory(
        TWO_TUBE,
        [0, 0.2],
        [[0.0, 0.0]] * 2,
        [[-0.03, -0.03], [-0.024, -0.024]],
        rate_limits=RateLimits(translation=0.1, tip=1.03 * true),
    )
    assert limited.holds


def test_the_speed_is_bounded_where_breakpoints_are_less_than_a_nanometre_from_their_meeting() -> None:
    """They pass each other just after the first sample: the speed is that on the far side. J q' of the near side is
    1.4 % less, and would show a limit that is not kept."""
    robot = load_robot("till_snapping_pair")
    start = np.array([-0.6534, 0.8595, -0.02291, -0.0399000009])
    end = np.array([-0.6464, 0.8392, -0.02307, -0.0394744])
    proof = verify_trajectory(robot, [0, 1], [start[:2], end[:2]], [start[2:], end[2:]])
    tips = [_tip(robot, start + (end - start) * x) for x in (1e-5, 3e-3)]
    true = float(np.linalg.norm(tips[1] - tips[0])) / (3e-3 - 1e-5)
    assert true <= proof.largest_tip_rate <= 1.03 * true
    assert proof.measured_tip_rate <= proof.largest_tip_rate


@pytest.mark.parametrize("size", [1e-4, 1e-3])
def test_breakpoints_that_meet_at_once_are_met_by_one_step(size: float) -> None:
    """All tubes pass the plate at home, at one time but for round-off: a sample there changes nothing."""
    rng = np.random.default_rng(3)
    for _ in range(4):
        turn, shift = rng.uniform(-size, size, 3) / 0.1, rng.uniform(-size, size, 3)
        turns, shifts = [-turn, 0 * turn, 1.7 * turn], [-shift, 0 * shift, 1.7 * shift]
        through = verify_trajectory(THESIS, [0, 2.7], turns[::2], shifts[::2])
        stopped = verify_trajectory(THESIS, [0, 1, 2.7], turns, shifts)
        assert through.largest_tip_rate <= 1.03 * stopped.largest_tip_rate
        assert through.measured_tip_rate <= stopped.largest_tip_rate


def test_meetings_at_one_time_are_one_and_parts_beside_them_are_none() -> None:
    """Gaps that differ by 1e-13 m of 1e-4 m where one of them is 0; by 1e-8 m; and a part 1e-9 beside a meeting."""
    before, after = np.array([0.0, 2e-5, 2e-5 + 1e-13, 3e-5]), np.array([0.0, -8e-5, -8e-5, -7e-5])
    result = meetings(np.array([before, after]))[0]
    assert result == pytest.approx([0.2, 0.3], abs=1e-8)
    assert meetings(np.array([[0.0, 0.9e-9], [0.0, -1e-3]]))[0] == pytest.approx([0.9e-6], rel=1e-3)
    assert not meetings(np.array([[0.0, 0.9e-12], [0.0, -1e-3]]))
    parts = _divided(np.array([0.2, 0.3 + 1e-9, 1.0]), np.array([0.3, 1 - 1e-9]))
    assert parts.tolist() == [0.2, 0.3, 1 - 1e-9, 1.0]


def test_a_path_has_events_where_a_breakpoint_passes_a_place_of_a_load() -> None:
    """Both tubes pass the plate, and the end of one of them passes a force."""
    path = SampledJointPath(TWO_TUBE, np.array([0, 0, -0.03, -0.01]), np.array([0, 0, 0.01, 0.03]))
    load = Load(points=(PointLoad(0.085, (0.03, 0.0, 0.0)),))
    assert TWO_TUBE.assembly(np.array([-0.03, -0.01])).breakpoints == pytest.approx([-0.03, -0.01, 0.07, 0.09])
    assert Family(path).events() == pytest.approx([0.25, 0.75, 1])
    assert Family(path, load, load).events() == pytest.approx([0.25, 0.375, 0.75, 1])


def test_sections_change_at_the_plate_behind_it_and_at_places_of_a_load() -> None:
    load = Load(points=(PointLoad(0.07, (0.03, 0.0, 0.0)),))
    verifier = TrajectoryVerifier(TWO_TUBE, scene_of(()), ClearanceTarget(0.0, 1e-5, 10), Clock(math.inf), load)
    assert verifier.cuts(np.array([-0.02, 0.01])).tolist() == pytest.approx([0, -0.02, 0.01, 0.08, 0.11, 0.07])
