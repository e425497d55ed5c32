"""Every bound of a proof of a motion, from both sides: it holds, and where it is sharp it gives nothing away."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from math import comb

import numpy as np
import pytest

from tests.examples import DEG, THESIS, nested
from tubeopt import InputError, forward_kinematics, verify_trajectory
from tubeopt.bodies.obstacles import Sphere
from tubeopt.control.command import ServoOptions, Why
from tubeopt.control.servo import Guard
from tubeopt.physics.shape import hat
from tubeopt.planning.branch import branch, least_root, rotating_tangent
from tubeopt.planning.loaded_branch import CHORD_ERROR
from tubeopt.planning.sections import Constants, Intervals, SolvedArms
from tubeopt.planning.trajectory_trace import Sizes


@pytest.mark.parametrize(("along", "wide", "height"), [(4e-3, 0.0, 5e-3), (3e-3, 4e-3, 2e-3), (1e-3, 8e-3, 1e-4)])
def test_variance_of_a_patch_is_a_quarter_of_its_squares(along: float, wide: float, height: float) -> None:
    """A point above the middle of a rectangle is as far from its corners as Pythagoras says."""
    zero = np.zeros(1)
    sizes = Sizes(np.array([along**2]), np.array([wide**2]), zero, zero, zero)
    corner = np.array([np.sqrt(height**2 + (along**2 + wide**2) / 4)])
    assert sizes.bound(corner)[0] == pytest.approx(height, rel=1e-9)
    # Cells are looked up as far as they may matter, and no farther.
    assert sizes.needed(height) == pytest.approx(corner[0], rel=1e-12)


def test_a_point_inside_a_patch_is_no_farther_than_its_half_diagonal() -> None:
    sizes = Sizes(np.array([9e-6]), np.array([16e-6]), *np.zeros((3, 1)))
    assert sizes.bound(np.array([1e-3]))[0] == pytest.approx(1e-3 - 2.5e-3)


def test_sagitta_of_an_arc_is_an_eighth_of_curvature_times_length_squared() -> None:
    """Two tubes that are bent alike form a circle: the sagitta of a short arc is known."""
    robot = nested((0.0, 0.1, 8.0), (0.0, 0.1, 8.0))
    arm = forward_kinematics(robot, [0.0, 0.0])
    intervals = Intervals.of(SolvedArms.of(Constants.of(robot), [arm, arm]), np.array([0]), np.array([1]))
    section = int(np.argmax(intervals.length[0][0]))
    x = np.array([[0.0, 0.1], [0.2, 0.7]])
    result = intervals.sagitta(np.zeros(2, int), np.full(2, section), x)
    true = (1 - np.cos(8.0 * 0.1 * np.diff(x)[:, 0] / 2)) / 8.0
    assert (result >= true).all()
    assert true == pytest.approx(result, rel=5e-3)


def test_an_arm_that_turns_as_one_is_off_its_chord_by_the_sagitta_of_its_circle() -> None:
    """Two tubes that are bent alike: every point runs on a circle about z, with derivatives radius turn^2 and so on."""
    curvature, length, turn = 8.0, 0.02, 0.1
    robot = nested((0.0, length, curvature), (0.0, length, curvature))
    arms = [forward_kinematics(robot, [angle, angle]) for angle in (0.3, 0.3 + turn)]
    result = branch(Intervals.of(SolvedArms.of(Constants.of(robot), arms), np.array([0]), np.array([1])), np.ones(2))
    radius = (1 - np.cos(curvature * length)) / curvature
    sagitta = radius * (1 - np.cos(turn / 2))
    assert result.unbroken.all()
    assert sagitta <= result.chord_error.max() <= 1.25 * sagitta
    second, third = result.rates[:, 0] / [radius * turn**2, radius * turn**3]
    assert 1 <= second <= 1.3
    assert 1 <= third <= 2


def test_newton_and_kantorovich_take_the_least_root() -> None:
    """r = first + q r + bow r^2 / 2, and a fixed-point iteration from 0 ends there; none where no root is."""
    first, q, bow = np.array([1e-3, 0.1, 0.2]), np.array([0.3, 0.1, 0.5]), np.array([2.0, 3.0, 1.0])
    radius, retained = least_root(first, 1 - q, bow)
    assert retained.tolist() == [True, True, False]
    r = np.zeros(3)
    for _ in range(2000):
        r = np.minimum(first + q * r + bow * r**2 / 2, 1.0)
    assert radius[retained] == pytest.approx(r[retained], rel=1e-9)
    # There is one up to where the discriminant vanishes.
    edge = (1 - q) ** 2 / (2 * bow)
    assert least_root(edge * 0.999, 1 - q, bow)[1].all()
    assert not least_root(edge * 1.001, 1 - q, bow)[1].any()
    assert not least_root(first, -(1 - q), bow)[1].any()


def test_a_sixth_of_what_bends_a_function_leaves_it_on_its_chord() -> None:
    """Of functions with f'' = -T, T linear and nowhere negative: by their closed form, at all times."""
    t = np.linspace(0, 1, 100_001)[1:-1]
    fractions = []
    for first, last in ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (0.2, 1.0)):
        above = t * (1 - t) * (first * (2 - t) + last * (1 + t)) / 6
        bend = np.diff(above, 2) / (t[1] - t[0]) ** 2
        size = first + (last - first) * t
        assert np.abs(bend + size[1:-1]).max() < 1e-4
        fractions.append((above / size).max())
    assert max(fractions) <= CHORD_ERROR
    assert max(fractions) >= 0.999 * CHORD_ERROR


@pytest.mark.parametrize("plane", [True, False])
def test_the_moment_of_a_load_changes_no_faster_than_the_arm_ahead_turns(plane: bool) -> None:
    """In the frame of a place of the arm: rigid parts turn at fixed rates, all derivatives by the exponential."""
    rng, largest = np.random.default_rng(4), np.zeros(3)
    for _ in range(300):
        own, ahead, force = (part / np.linalg.norm(part) for part in rng.normal(size=(3, 3)))
        tangent = np.array([0.0, 0.0, 1.0])
        if plane:
            own = ahead = np.array([1.0, 0.0, 0.0])
            angle = rng.uniform(0, 2 * np.pi)
            force = np.array([0.0, np.sin(angle), np.cos(angle)])
        own, ahead = own * rng.uniform(0, 1), ahead * rng.uniform(0, 1)
        # R' t = exp(A) e3, R' n = exp(-W) n; derivatives at time 0, product rule.
        turns = [
            [np.linalg.matrix_power(hat(w), k) @ v for k in range(4)] for w, v in ((ahead, tangent), (-own, force))
        ]
        rate, none = np.linalg.norm(own) + np.linalg.norm(ahead), np.zeros(())
        bound = rotating_tangent(np.asarray(rate), none, none)
        for order in (1, 2, 3):
            parts = [comb(order, k) * np.cross(turns[0][k], turns[1][order - k]) for k in range(order + 1)]
            size = np.linalg.norm(np.sum(parts, axis=0))
            assert size <= bound.order(order) * (1 + 1e-12)
            largest[order - 1] = max(largest[order - 1], size / bound.order(order))
    assert not plane or (largest > 0.999).all()


def test_the_margin_that_is_asked_for_is_kept_to_the_last_digit() -> None:
    table = [0.0, 1.0], [[0.0, 0.0, 0.0], [200 * DEG, 0.0, 0.0]]
    smallest = verify_trajectory(THESIS, *table).least_margin
    assert smallest < 0.999
    assert verify_trajectory(THESIS, *table, min_margin=smallest - 1e-6).holds
    short = verify_trajectory(THESIS, *table, min_margin=smallest + 1e-4)
    assert any(f"the margin falls to {smallest:.4g}" in fault for fault in short.faults)
    assert not short.holds


def test_the_least_margin_of_a_turn_is_that_of_opposed_tubes_between_its_ends() -> None:
    """By symmetry two tubes are softest where they are opposed; no end of the motion, and no sample, is there."""
    robot, turn = nested((0.0, 0.05, 8.0), (0.0, 0.05, 8.0)), np.array([[100 * DEG, 0.0], [247 * DEG, 0.0]])
    smallest = forward_kinematics(robot, [np.pi, 0.0]).margin
    proof = verify_trajectory(robot, [0.0, 1.0], turn)
    assert smallest < min(forward_kinematics(robot, angles).margin for angles in turn) - 0.01
    assert proof.least_margin == pytest.approx(smallest, abs=1e-6)


def test_the_guard_makes_no_step_towards_a_body() -> None:
    """Whatever asks for the step: it is halved until the clearance is kept, or not made."""
    start = np.zeros(3)
    reached = forward_kinematics(THESIS, [20 * DEG, 0.0, 0.0]).tip_position
    ball = Sphere(tuple(reached.tolist()), 1e-3)
    options = ServoOptions(clearance=2e-3)
    guard, free = (Guard(THESIS, (start, None), None, bodies, options) for bodies in ([ball], []))
    requested = np.zeros(len(guard.posture.q))
    requested[0] = 2 * DEG
    for _ in range(12):
        free.go(requested, Why(0), 1e-3)
        _, why = guard.go(requested, Why(0), 1e-3)
    assert Why.HELD in why
    radius = 1e-3 + THESIS.tubes[0].outer_diameter / 2
    gap = np.linalg.norm(guard.posture.tip - reached) - radius
    assert gap >= 2e-3 - 1e-6
    assert np.linalg.norm(free.posture.tip - reached) - radius < 0


def test_the_guard_keeps_the_floor_of_the_margin() -> None:
    """A turn of the inner tube towards the snap, asked for again and again."""
    floor = 0.5
    guard = Guard(THESIS, (np.zeros(3), None), None, [], ServoOptions(min_margin=floor))
    requested = np.zeros(len(guard.posture.q))
    requested[0] = 4 * DEG
    for _ in range(60):
        _, why = guard.go(requested, Why(0), 1e-3)
    assert Why.HELD in why
    assert floor <= guard.posture.margin < floor + 0.05


def test_the_guard_begins_within_the_ranges_and_the_margin() -> None:
    seed, limits = np.array([0.0, 90.0, 180.0]) * DEG, replace(THESIS.limits, rotations=((0.0, 180 * DEG),) * 3)
    smallest = forward_kinematics(THESIS, seed).margin
    for turn, floor, fault in (
        (0.0, smallest - 1e-6, ""),
        (0.1, 0.5, "out of range"),
        (0.0, smallest + 1e-6, "margin"),
    ):
        with pytest.raises(InputError, match=fault) if fault else nullcontext():
            Guard(THESIS, (seed + turn * DEG, None), limits, [], ServoOptions(min_margin=floor))


def test_a_tangent_that_spins_about_a_fixed_axis_changes_by_powers_of_its_rate() -> None:
    """w, w^2 and w^3; about an axis that speeds up the derivatives of (cos phi, sin phi) for phi = w t + a t^2 / 2."""
    w, a = 1.3, 0.9
    still, zero = rotating_tangent(np.array(w), np.array(0.0), np.array(0.0)), np.array(0.0)
    assert [float(x) for x in (still.d, still.dd)] == pytest.approx([w, w**2])
    assert still.ddd is not None
    assert float(still.ddd) == pytest.approx(w**3)
    speeding = rotating_tangent(np.array(w), np.array(a), zero)
    assert speeding.ddd is not None
    second, third = np.hypot(w**2, a), np.hypot(3 * w * a, w**3)
    assert second <= float(speeding.dd) == pytest.approx(w**2 + a)
    assert third <= float(speeding.ddd) == pytest.approx(3 * w * a + w**3)
    assert rotating_tangent(np.array(0.0), zero, np.array(2.0)).ddd == 2.0
