"""The explicit equilibrium agrees with forward kinematics, and tells branches apart."""

from __future__ import annotations

import time

import numpy as np
import pytest

from tests.command_line import ROOT
from tests.examples import CRL, PIECES, THESIS, TWO_TUBE, eccentric_robot
from tubeopt import SolveError, find_equilibria, forward_kinematics, load_robot
from tubeopt.inverse.joints import joint_space
from tubeopt.inverse.task import TipCoordinates
from tubeopt.robots.robot import Robot


@pytest.mark.parametrize(
    "robot", [THESIS, CRL, TWO_TUBE, PIECES, eccentric_robot(0.05)], ids=lambda robot: robot.name or "etr"
)
def test_tips_give_the_joints_the_shape_and_the_margin(robot: Robot) -> None:
    space = joint_space(robot)
    coordinates = TipCoordinates(space)
    checked = 0
    for q in space.sample(12):
        rotations, shift = space.split(q)
        try:
            e = forward_kinematics(robot, rotations, shift)
        except SolveError:
            continue
        z = coordinates.of(e)[None]
        arms = coordinates.arms(z, e.margin - 2e-3)
        assert np.abs(arms.rotations[0] - rotations).max() < 2e-4
        assert np.abs(arms.tip[0] - e.tip_position).max() < 1e-4 * space.length
        assert arms.stable[0]
        if e.margin < 0.9:  # beyond, softened tubes are stiff equations for the steps of the integrator
            assert not coordinates.arms(z, e.margin + 2e-3).stable[0]
        checked += 1
    assert checked >= 6


def test_equal_joint_values_on_two_branches_are_two_points() -> None:
    coordinates = TipCoordinates(joint_space(THESIS))
    results = [e for e in find_equilibria(THESIS, [np.radians(200.0), 0.0, 0.0]) if e.stable]
    assert len(results) == 2
    points = np.array([coordinates.of(e) for e in results])
    assert np.abs(points[0] - points[1]).max() > 1.0
    arms = coordinates.arms(points, 0.0)
    assert np.abs(arms.rotations - [np.radians(200.0), 0.0, 0.0]).max() < 1e-4
    assert arms.stable.all()


def test_unstable_equilibria_are_told() -> None:
    coordinates = TipCoordinates(joint_space(THESIS))
    (saddle,) = [e for e in find_equilibria(THESIS, [np.pi, 0.0, 0.0]) if e.margin < -0.9]
    assert not coordinates.arms(coordinates.of(saddle)[None], 0.0).stable[0]
    assert coordinates.arms(coordinates.of(saddle)[None], saddle.margin - 0.01).stable[0]


def test_a_robot_of_nine_tubes_is_ready_at_once() -> None:
    """Written out step by step, its equations are 1.5 million operations, which take a quarter of a minute to build."""
    robot = load_robot(ROOT / "configs" / "robots" / "example_three_segment_etr.yaml")
    space = joint_space(robot)
    start_time = time.process_time()
    coordinates = TipCoordinates(space)
    rotations, shift = space.split(space.inside())
    e = forward_kinematics(robot, rotations + np.linspace(-0.3, 0.3, 9), shift)
    arms = coordinates.arms(coordinates.of(e)[None], 0.0)
    assert time.process_time() - start_time < 6.0
    assert np.abs(arms.rotations[0] - e.rotations).max() < 2e-4
    assert np.abs(arms.tip[0] - e.tip_position).max() < 1e-4 * space.length
