"""Drives along a motion and over a workspace: peaks, power, snaps, and friction along the tubes."""

from __future__ import annotations

import numpy as np
import pytest

from tests.examples import THESIS, TWO_TUBE
from tubeopt import Friction, InputError, drive_loads, drives_along, drives_at, follow, forward_kinematics


def test_power_is_load_times_speed() -> None:
    rotations = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, -0.5]])
    drives = drives_along(TWO_TUBE, rotations, time=[0.0, 2.0, 3.0])
    np.testing.assert_allclose(drives.turn_rate, [[0.5, 0.0], [0.0, -0.5]])
    ends = [drive_loads(forward_kinematics(TWO_TUBE, each)).torque for each in rotations]
    np.testing.assert_allclose(drives.torque, ends, atol=1e-12)
    largest = [0.5 * ends[1][0], max(-0.5 * ends[1][1], -0.5 * ends[2][1])]
    np.testing.assert_allclose(drives.peak_torque_power, largest, rtol=1e-9)
    assert (drives.peak_torque_power > 0).all()
    np.testing.assert_allclose(drives.peak_force_power, 0.0)
    assert np.isnan(drives_along(TWO_TUBE, rotations).peak_torque_power).all()


def test_work_of_the_drives_is_the_energy_that_a_snap_releases() -> None:
    turn = np.linspace(0.0, 2 * np.pi, 201)[:, None] * (1.0, 0.0, 0.0)
    drives = drives_along(THESIS, turn)
    (snap,) = drives.snaps
    assert len(drives.at) == len(turn) + 2
    at_snap = np.flatnonzero(np.diff(drives.at) == 0)
    np.testing.assert_allclose(drives.rotations[at_snap[0]], snap.rotations)
    assert np.abs(np.diff(drives.torque, axis=0)[at_snap[0]]).max() > 1e-3
    # After a turn all is as it was, but for what the snap has released.
    assert drives.work == pytest.approx(snap.energy_released, rel=2e-3)


def test_at_an_end_at_home_the_forces_are_those_before_it() -> None:
    rest = np.array([0.0, 1.0, 2.0])
    drives = drives_along(THESIS, [rest, rest, rest], [[-0.02] * 3, [-0.01] * 3, [0.0] * 3])
    home = forward_kinematics(THESIS, rest)
    np.testing.assert_allclose(drives.force[-1], drive_loads(home, side=-1).force, atol=1e-9)
    back = drives_along(THESIS, [rest, rest], [[0.0] * 3, [-0.01] * 3])
    np.testing.assert_allclose(back.force[0], drive_loads(home, side=-1).force, atol=1e-9)
    assert np.abs(drive_loads(home).force - drives.force[-1]).max() > 0.01


def test_friction_along_the_tubes_opposes_the_carriages() -> None:
    friction = Friction(torque=0.005, sliding=True)
    way, start = np.array([[0.0], [0.5], [1.0]]), np.array([0.03, 0.02, 0.01])
    rotations, translations = np.tile([0.0, 1.0, 2.0], (3, 1)), start + way * (0.01, 0.0, 0.0)
    drives = drives_along(THESIS, rotations, translations, friction=friction)
    last = follow(THESIS, rotations, translations, friction=friction).equilibria[-1]
    rubbed = drives.force[-1] - drive_loads(last, side=-1).force
    # The inner tube is pushed, the next one is carried along; the third does not touch the inner one.
    radius = THESIS.tubes[0].outer_diameter / 2
    overlap = last.tube_end[1]
    assert rubbed[0] == pytest.approx(0.005 * overlap / radius, rel=0.02)
    assert rubbed[1] == pytest.approx(-rubbed[0])
    assert rubbed[2] == pytest.approx(0.0, abs=1e-12)


def test_loads_at_single_configurations() -> None:
    rotations = [[0.0, 0.0], [0.0, 1.0]]
    drives = drives_at(TWO_TUBE, rotations, rates=(2.0, 0.5))
    np.testing.assert_allclose(drives.torque[1], drive_loads(forward_kinematics(TWO_TUBE, rotations[1])).torque)
    np.testing.assert_allclose(drives.peak_torque_power, 2.0 * np.abs(drives.torque[1]))
    np.testing.assert_allclose(drives.peak_force_power, 0.5 * drives.peak_force)
    assert np.isnan(drives.work)


def test_times_must_increase() -> None:
    with pytest.raises(InputError, match=r"time\[1\] is 0 s after 0 s; times must increase"):
        drives_along(TWO_TUBE, [[0.0, 0.0], [1.0, 0.0]], time=[0.0, 0.0])
    with pytest.raises(InputError, match="the rate of the translations is -1"):
        drives_at(TWO_TUBE, [[0.0, 0.0]], rates=(1.0, -1.0))
