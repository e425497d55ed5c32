"""The servo that looks ahead: goals that one step after another does not reach, derivatives, and what it keeps."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from tests.examples import CRL, PIECES, THESIS
from tubeopt import ConcentricRobot, InputError, follow, forward_kinematics
from tubeopt.bodies.obstacles import Sphere
from tubeopt.control.command import Command, ServoOptions
from tubeopt.control.lookahead import Knots, PredictiveServo
from tubeopt.inverse.joints import joint_space
from tubeopt.inverse.task import TipCoordinates

PAIR = ConcentricRobot(PIECES.tubes[:2])
DT = 0.02
VALLEY = ([-1.862, 0.452, -1.255], [0.0341, -0.0361, -0.0505])
BEHIND = (0.004, -0.0184, 0.1496)


def test_goal_behind_valley_of_margin_is_reached() -> None:
    options, dt = ServoOptions(speed=0.2, min_margin=0.2), 2 * DT
    seed = forward_kinematics(CRL, *VALLEY)
    ahead = PredictiveServo(CRL, seed, options=options)
    steps = [ahead.step(Command(position=BEHIND), dt) for _ in range(50)]
    assert np.linalg.norm(steps[-1].equilibrium.tip_position - BEHIND) < 1e-6
    assert min(step.equilibrium.margin for step in steps) >= 0.2
    for one, two in pairwise(steps):
        assert np.abs(two.rotations - one.rotations).max() <= options.turn_rate * dt + 1e-12
        assert np.abs(two.translations - one.translations).max() <= options.shift_rate * dt + 1e-12
    every = steps[::3]
    way = follow(CRL, [s.rotations for s in every], [s.translations for s in every], start=every[0].equilibrium)
    assert not way.snaps
    assert way.equilibria[-1].tip_position == pytest.approx(every[-1].equilibrium.tip_position, abs=1e-8)


def test_tubes_made_of_pieces_are_led_ahead_on_their_branch() -> None:
    space = joint_space(PAIR)
    seed = forward_kinematics(PAIR, *space.split(0.5 * space.inside() + 0.5 * space.middle()))
    goal = forward_kinematics(PAIR, seed.rotations + np.array([0.8, -0.5]), 0.8 * seed.translations)
    ahead = PredictiveServo(PAIR, seed, knots=12, options=ServoOptions(speed=0.2, min_margin=0.1))
    steps = [ahead.step(Command(position=goal.tip_position), DT) for _ in range(40)]
    assert steps[-1].distance < 1e-6
    assert min(step.equilibrium.margin for step in steps) >= 0.1
    way = follow(PAIR, [s.rotations for s in steps], [s.translations for s in steps], start=seed)
    assert not way.snaps
    assert way.equilibria[-1].tip_position == pytest.approx(steps[-1].equilibrium.tip_position, abs=1e-8)


def test_a_body_in_the_way_is_gone_around() -> None:
    seed = forward_kinematics(THESIS, [0.0, 1.0, 2.0], [-0.05, -0.03, -0.02])
    ball = Sphere(tuple(seed.tip_position + np.array([0, 8e-3, 0])), 4e-3)
    target = seed.tip_position + np.array([0, 16e-3, 0])
    ahead = PredictiveServo(THESIS, seed, obstacles=[ball], options=ServoOptions(clearance=5e-4, speed=0.1))
    steps = [ahead.step(Command(position=target), DT) for _ in range(60)]
    assert np.linalg.norm(steps[-1].equilibrium.tip_position - target) < 1e-6
    for step in steps:
        # Of the centreline, so by the radius of the tube more than of its surface.
        assert ball.signed_distance(step.equilibrium.position).min() >= 5e-4 + THESIS.tubes[0].outer_diameter / 2 - 1e-6


@pytest.mark.parametrize("robot", [THESIS, PAIR], ids=["arcs", "pieces"])
def test_knots_are_what_forward_kinematics_finds_and_change_as_differences_say(robot: object) -> None:
    assert robot in (THESIS, PAIR)
    coordinates = TipCoordinates(joint_space(THESIS if robot is THESIS else PAIR))
    space = coordinates.space
    random, n = np.random.default_rng(0), space.robot.n_tubes
    z = np.array([space.nearest(space.inside() + 0.1 * space.scale * random.normal(size=len(space.scale)))] * 3)
    z[1:, :n] += random.normal(size=(2, n))
    knots = Knots.at(coordinates, z, 0.1)
    arms = coordinates.arms(z, 0.1)
    np.testing.assert_allclose(knots.joints, coordinates.joints(z, arms), atol=1e-12)
    np.testing.assert_allclose(knots.tip, arms.tip, atol=1e-12)
    found = forward_kinematics(space.robot, *space.split(knots.joints[0]))
    if np.abs(coordinates.of(found) - z[0]).max() < 1e-3:
        np.testing.assert_allclose(knots.tip[0], found.tip_position, atol=2e-5)
    for k in range(z.shape[1]):
        step = np.zeros(z.shape[1])
        step[k] = 1e-6 * space.scale[k]
        up, down = Knots.at(coordinates, z + step, 0.1), Knots.at(coordinates, z - step, 0.1)
        for name, slope in zip(("joints", "fields", "points", "direction"), knots.slopes, strict=True):
            difference = (getattr(up, name) - getattr(down, name)) / 2e-6
            np.testing.assert_allclose(slope[..., k], difference, atol=1e-5 * max(1.0, np.abs(difference).max()))


def test_what_cannot_be_led_to_is_refused_and_what_is_out_of_reach_is_approached() -> None:
    seed = forward_kinematics(THESIS, [0.0, 1.0, 2.0], [-0.05, -0.03, -0.02])
    with pytest.raises(InputError, match="knots is 1"):
        PredictiveServo(THESIS, seed, knots=1)
    ahead = PredictiveServo(THESIS, seed)
    with pytest.raises(InputError, match="follows a position"):
        ahead.step(Command(velocity=(0.01, 0, 0)), DT)
    with pytest.raises(InputError, match="dt is 0 s"):
        ahead.step(Command(position=BEHIND), 0.0)
    far = seed.tip_position + np.array([0.0, 0.0, 1.0])
    first = ahead.step(Command(position=far), DT)
    assert ahead.path is None
    assert ahead.step(Command(position=far), DT).distance < first.distance
