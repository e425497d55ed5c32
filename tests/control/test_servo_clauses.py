"""Each thing that may be asked of a servo, and each that it keeps, by itself."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tests.examples import CRL, THESIS
from tubeopt import Equilibrium, forward_kinematics
from tubeopt.control.command import Command, ServoOptions, ServoStep, Why
from tubeopt.control.servo import Servo
from tubeopt.inverse.goal import angle
from tubeopt.inverse.joints import joint_space

SEED = ([0.0, 1.0, 2.0], [-0.05, -0.03, -0.02])
DT = 2e-3
ROUNDING = 1e-12


@pytest.fixture(scope="module")
def seed() -> Equilibrium:
    return forward_kinematics(THESIS, *SEED)


def run(servo: Servo, command: Command, steps: int) -> list[ServoStep]:
    return [servo.step(command, DT) for _ in range(steps)]


def reasons(steps: list[ServoStep]) -> Why:
    found = Why(0)
    for step in steps:
        found |= step.why
    return found


@pytest.mark.parametrize("factor", [0.5, 3.0])
def test_the_tip_has_the_velocity_that_is_asked_up_to_its_speed(factor: float, seed: Equilibrium) -> None:
    along = np.array([2.0, -1.0, 2.0]) / 3
    servo = Servo(THESIS, seed, options=ServoOptions(speed=0.01, turn_rate=50.0, shift_rate=1.0))
    tips = [step.equilibrium.tip_position for step in run(servo, Command(velocity=factor * 0.01 * along), 50)]
    for one, two in pairwise([seed.tip_position, *tips]):
        assert (two - one) / DT == pytest.approx(min(factor, 1.0) * 0.01 * along, abs=2e-5)


def test_the_tip_points_elsewhere_by_the_shortest_turn(seed: Equilibrium) -> None:
    here, servo = seed.tip_rotation[:, 2], Servo(THESIS, seed)
    there = here + np.array([0.03, 0.05, 0.0])
    there /= np.linalg.norm(there)
    steps = run(servo, Command(direction=there), 60)
    ways = [step.equilibrium.tip_rotation[:, 2] for step in steps]
    assert angle(ways[-1], there) < 1e-7
    assert steps[0].angle == pytest.approx(np.arccos(here @ there), abs=1e-9)
    assert np.isnan(steps[0].distance)
    across = np.cross(here, there) / np.linalg.norm(np.cross(here, there))
    assert max(abs(way @ across) for way in ways) < 1e-4


def test_a_joint_at_the_end_of_its_range_stays_and_the_others_bring_the_tip_there(seed: Equilibrium) -> None:
    target = seed.tip_position + np.array([6e-3, 6e-3, 0.0])
    free = run(Servo(THESIS, seed), Command(position=target), 200)[-1].equilibrium
    joint = int(np.abs(free.rotations - seed.rotations).argmax())
    turn = 0.3 * (free.rotations[joint] - seed.rotations[joint])
    ends = sorted((seed.rotations[joint] - turn, seed.rotations[joint] + turn))
    rotations = [ends if i == joint else pair for i, pair in enumerate(THESIS.limits.rotations)]
    limits = replace(THESIS.limits, rotations=tuple((float(a), float(b)) for a, b in rotations))
    steps = run(Servo(THESIS, seed, limits=limits), Command(position=target), 300)
    assert Why.RANGE in reasons(steps)
    assert all(ends[0] - ROUNDING <= step.rotations[joint] <= ends[1] + ROUNDING for step in steps)
    assert steps[-1].rotations[joint] == pytest.approx(seed.rotations[joint] + turn, abs=1e-9)
    assert np.linalg.norm(steps[-1].equilibrium.tip_position - target) < 1e-6


def test_tubes_that_touch_stay_in_order_while_the_tip_goes_on(seed: Equilibrium) -> None:
    space, speed = joint_space(THESIS), 0.05
    steps = run(Servo(THESIS, seed, options=ServoOptions(shift_rate=0.2)), Command(velocity=(-speed, 0, 0)), 220)
    gaps = [float((space.rows @ space.join(s.rotations, s.translations) - space.row_lower).min()) for s in steps]
    assert min(gaps) > -1e-9 * space.length
    touching = [k for k, step in enumerate(steps) if Why.ORDER in step.why]
    assert max(gaps[k] for k in touching) < 1e-9
    tips = [steps[k].equilibrium.tip_position[0] for k in (touching[0], -1)]
    assert tips[1] - tips[0] == pytest.approx(-speed * DT * (219 - touching[0]), rel=1e-2)


def test_the_arm_comes_to_a_pivot_with_the_speed_of_the_tip(seed: Equilibrium) -> None:
    speed, k = 1e-3, 8
    pivot = seed.position[k] + 2e-4 * seed.frame[k][:, 0]
    servo = Servo(THESIS, seed, options=ServoOptions(speed=speed, turn_rate=50.0, shift_rate=1.0))
    gaps = []
    for step in run(servo, Command(pivot=pivot), 150):
        arm = step.equilibrium.position
        way = np.diff(arm, axis=0)
        along = np.clip(((pivot - arm[:-1]) * way).sum(1) / (way**2).sum(1), 0, 1)
        gaps.append(float(np.linalg.norm(arm[:-1] + along[:, None] * way - pivot, axis=1).min()))
    assert gaps[0] == pytest.approx(2e-4 - speed * DT, rel=0.02)
    assert np.diff(gaps[:80]) == pytest.approx(-speed * DT, rel=0.1)
    assert gaps[-1] < 1e-7


def test_joints_go_straight_as_fast_as_the_slowest_of_them_allows(seed: Equilibrium) -> None:
    turned, shifted = np.array([0.3, -0.1, 0.2]), np.array([1e-3, 0.0, -2e-3])
    goal = seed.rotations + turned, seed.translations + shifted
    steps = run(Servo(THESIS, seed, options=ServoOptions(turn_rate=3.0, shift_rate=0.05)), Command(joints=goal), 60)
    for k, step in enumerate(steps, 1):
        share = min(1.0, k * DT * 3.0 / 0.3)
        assert step.rotations == pytest.approx(seed.rotations + share * turned, abs=1e-6)
        assert step.translations == pytest.approx(seed.translations + share * shifted, abs=1e-8)


def test_what_comes_first_is_kept_while_what_comes_after_does_what_is_left(seed: Equilibrium) -> None:
    """The tip shall stay, and point backwards, which it cannot while it stays."""
    command = Command(position=seed.tip_position, direction=-seed.tip_rotation[:, 2] + [1.0, 0.0, 0.0])
    ways = {}
    for order in (("position", "direction"), ("position+direction",), ("direction", "position")):
        last = run(Servo(THESIS, seed, options=ServoOptions(priorities=order)), command, 60)[-1]
        ways[order] = last.distance, last.angle
    (kept, first), (_, alike), (left, last) = ways.values()
    assert kept < 1e-6
    assert left > 1e-3
    assert last <= alike <= first < angle(seed.tip_rotation[:, 2], np.asarray(command.direction)) - 0.01


def test_a_margin_that_is_missed_already_gets_no_worse() -> None:
    """A seed at its floor, asked to go on towards the snap: the margin is slid along."""
    space = joint_space(CRL)
    random = np.random.default_rng(2)
    asked = 0
    for q in space.sample(8):
        start = forward_kinematics(CRL, *space.split(0.9 * q + 0.1 * space.inside()))
        if not 0.05 < start.margin < 0.9:
            continue
        servo = Servo(CRL, start, options=ServoOptions(min_margin=start.margin - 1e-12, turn_rate=10.0))
        slope = servo.guard.posture.margin_slope()[:3]
        goal = start.rotations - 0.3 * slope / np.linalg.norm(slope) + 0.1 * random.normal(size=3), start.translations
        steps = run(servo, Command(joints=goal), 15)
        assert min(step.equilibrium.margin for step in steps) >= start.margin - 1e-9
        asked += 1
    assert asked >= 2
