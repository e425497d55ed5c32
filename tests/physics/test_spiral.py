"""Tubes that spiral in a sheath: against frames of the space curves, and distances of helices."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from problems.thesis_error_budget import ROBOT, spiral, tips
from tubeopt import BundleRobot, forward_kinematics, load_robot
from tubeopt.physics.spiral import spiral_rate, strand, touching_offset
from tubeopt.robots.eccentric import room_in_sheath
from tubeopt.typing import Array


def frames(s: Array, u: Array, offset: float, angle: float, rate: float) -> tuple[Array, Array]:
    """Points (m, 3) of a tube around an arc of curvature u, and frames (m, 3, 3) of the arc, inclined to it."""
    point, frame = np.zeros((len(s), 3)), np.zeros((len(s), 3, 3))
    size = float(np.hypot(*u))
    aside = np.array([u[1], -u[0], 0.0]) / size  # towards the centre of the arc
    for k, arc in enumerate(s.tolist()):
        turned = Rotation.from_rotvec([*(u * arc), 0.0]).as_matrix()
        on_arc = (np.sin(size * arc) * np.array([0, 0, 1.0]) + (1 - np.cos(size * arc)) * aside) / size
        phi = angle + rate * arc
        point[k] = on_arc + turned @ (offset * np.array([np.cos(phi), np.sin(phi), 0.0]))
        frame[k] = turned
    tangent = np.gradient(point, s, axis=0, edge_order=2)
    for k, t in enumerate(tangent):
        own = frame[k][:, 2]
        axis = np.cross(own, t / np.linalg.norm(t))
        sine = np.linalg.norm(axis)
        inclined = Rotation.from_rotvec(axis / sine * np.arctan2(sine, own @ t / np.linalg.norm(t)))
        frame[k] = inclined.as_matrix() @ frame[k]
    return point, frame


@pytest.mark.parametrize("rate", [60.0, -25.0, 300.0])
def test_curvature_and_twist_are_those_of_the_space_curve(rate: float) -> None:
    u, offset, angle = np.array([6.0, -9.0]), 2e-3, 0.4
    s = np.linspace(0.0, 4e-3, 4001)
    point, frame = frames(s, u, offset, angle, rate)
    k = len(s) // 2
    h = s[1] - s[0]
    change = frame[k].T @ (frame[k + 1] - frame[k - 1]) / (2 * h)
    found = strand(ca.DM(u), offset, angle + rate * s[k], rate)
    assert float(found.length) == pytest.approx(np.linalg.norm(point[k + 1] - point[k - 1]) / (2 * h), rel=1e-6)
    assert float(found.bend[0]) == pytest.approx(change[2, 1], rel=1e-4, abs=1e-4)
    assert float(found.bend[1]) == pytest.approx(change[0, 2], rel=1e-4, abs=1e-4)
    assert float(found.twist) == pytest.approx(change[1, 0], rel=1e-4, abs=1e-4)


def test_a_helix_around_a_straight_line_is_a_helix() -> None:
    offset, rate = 1.1e-3, 80.0
    tube = strand(ca.DM([0.0, 0.0]), offset, 0.0, rate)
    steep = 1 + (offset * rate) ** 2
    # Frenet's curvature and torsion per own length; the frame turns back by the rest of a turn.
    assert float(ca.norm_2(tube.bend) / tube.length) == pytest.approx(offset * rate**2 / steep)
    assert float(tube.twist / tube.length) == pytest.approx(rate / steep - rate / np.sqrt(steep))


@pytest.mark.parametrize("rate", [20.0, 70.0, 400.0])
def test_tubes_touch_at_their_closest_points(rate: float) -> None:
    diameter = 1.92e-3
    offset = touching_offset(diameter, rate)
    z = np.linspace(-3e-3, 3e-3, 200_001)
    phi = 2 * np.pi / 3 + rate * z
    helix = np.column_stack([offset * np.cos(phi), offset * np.sin(phi), z])
    assert np.linalg.norm(helix - [offset, 0, 0], axis=1).min() == pytest.approx(diameter, rel=1e-7)
    straight = diameter / np.sqrt(3)
    if rate < 100:
        assert offset / straight - 1 == pytest.approx((straight * rate) ** 2 / 8, rel=0.02)


def test_tubes_without_a_spiral_are_those_of_the_energy_of_a_bundle() -> None:
    # Reference of two other codes, for tubes that end together.
    tip = spiral(np.radians([0.0, 60.0, -60.0]))[1]
    assert 1e3 * tip == pytest.approx([-0.0027346516, -26.2031690001, 88.8415934412], abs=2e-4)
    tip = spiral(np.radians([30.0, 100.0, -20.0]))[1]
    assert 1e3 * tip == pytest.approx([15.1995478073, -21.2546830267, 88.8709704208], abs=2e-4)
    assert np.linalg.norm(tip - tips(ROBOT, np.radians([[30.0, 100.0, -20.0]]))[0]) < 1e-5
    assert forward_kinematics(ROBOT, np.radians([30.0, 100.0, -20.0])).stable


def test_tubes_spiral_to_less_energy() -> None:
    rotations = np.radians([0.0, 90.0, -90.0])
    _, _, straight = spiral(rotations)
    turn, _, energy = spiral(rotations, None)
    assert energy < straight - 20
    length = ROBOT.tube.curved_length
    around = [spiral(rotations, (turn + step) / length)[2] for step in (-0.05, 0.0, 0.05)]
    assert around[1] == pytest.approx(energy, abs=1e-6)
    assert min(around[0], around[2]) > energy


def test_a_loose_sheath_lets_tubes_spiral_until_they_fill_it() -> None:
    robot = ROBOT.bundle()
    widest, diameter = robot.least_sheath_diameter, robot.tubes[0].outer_diameter
    room = room_in_sheath(robot)
    assert (room.diameter, room.width, room.turns) == (widest, 0.0, 0.0)
    for width in (1e-6, 1e-4):
        room = room_in_sheath(replace(robot, sheath_diameter=widest + 2 * width))
        rate = 2 * np.pi * float(room.turns or 0.0) / 0.094
        assert room.width == pytest.approx(width, rel=1e-9)
        assert touching_offset(diameter, rate) - touching_offset(diameter, 0.0) == pytest.approx(width, rel=1e-6)
    # Little room grows with the square of the rate.
    offset = touching_offset(diameter, 0.0)
    assert spiral_rate(diameter, 1e-9) == pytest.approx(np.sqrt(8e-9 / offset**3), rel=1e-3)
    sheath = load_robot("configs/bundles/steerable_sheath.yaml")
    assert isinstance(sheath, BundleRobot)
    assert room_in_sheath(sheath).turns is None
    four = BundleRobot(robot.tubes[:1] * 4, (diameter / np.sqrt(2),) * 4, tuple(np.pi / 2 * np.arange(4)))
    assert room_in_sheath(replace(four, sheath_diameter=four.least_sheath_diameter + 2e-4)).turns == pytest.approx(
        0.094 / (2 * np.pi) * spiral_rate(diameter, 1e-4, 4), rel=1e-6
    )
