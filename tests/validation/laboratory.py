"""A laboratory that does not exist: tips of a robot with known parameters, in a device's frame, with known errors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from tubeopt import ConcentricRobot, EccentricRobot, Tube, forward_kinematics, load_robot
from tubeopt.inverse.mirror import mirror_rotations
from tubeopt.robots.robot import Robot
from tubeopt.typing import Array
from tubeopt.validation import BasePose, Measurements

CONFIGS = Path(__file__).parents[2] / "configs"
MM = 1e-3
NOISE = 0.5 * MM

TURN = np.asarray(Rotation.from_euler("zyx", [-140.0, 25.0, -70.0], degrees=True).as_matrix())
BASE = np.array([0.12, -0.035, 0.21])
DEVICE_BASE = BasePose(tuple(BASE), tuple(TURN[:, 2]))


def in_device(tips: Array) -> Array:
    """Tips (..., 3) of the plate frame, as the device sees them."""
    return np.asarray(tips @ TURN.T + BASE)


def etr() -> EccentricRobot:
    """The eccentric robot of the thesis."""
    robot = load_robot(CONFIGS / "robots" / "thesis_etr.yaml")
    assert isinstance(robot, EccentricRobot)
    return robot


def ctr() -> ConcentricRobot:
    """Two tubes of different curvature that do not snap at the rotations used here."""
    return ConcentricRobot(
        (
            Tube(1.0 * MM, 0.8 * MM, 60 * MM, 110 * MM, 12.0),
            Tube(1.3 * MM, 1.05 * MM, 50 * MM, 70 * MM, 6.0),
        ),
        name="two tubes of a laboratory",
    )


def mirrored(robot: Robot, directions: int = 9, offsets: Array | None = None) -> Measurements:
    """Tips of a robot without errors over mirror actuation, its rotations off by `offsets` (3,), rad."""
    pairs = [(d, s) for s in np.radians([0, 30, 60, 90]) for d in np.linspace(0, 2 * np.pi, directions, endpoint=False)]
    requested = np.array([mirror_rotations(d, s) for d, s in pairs])
    direction, separation = np.array(pairs).T
    bare = np.zeros((len(requested), 3))
    reached = Measurements(requested, bare, bare, direction, separation, source="no laboratory")
    return replace(reached, sensors=in_device(tips(robot, reached.turned(np.zeros(3) if offsets is None else offsets))))


def turned(robot: Robot, count: int = 30) -> Measurements:
    """Tips of a robot without errors at random rotations and translations."""
    random = np.random.default_rng(5)
    rotations = random.uniform(-1.5, 1.5, (count, robot.n_tubes)) + random.uniform(-3, 3, (count, 1))
    inner = random.uniform(-20 * MM, 30 * MM, count)
    translations = np.column_stack([inner, inner + random.uniform(-15 * MM, 0.0, count)])
    reached = Measurements(rotations, translations, np.zeros((count, 3)), source="no laboratory")
    return replace(reached, sensors=in_device(tips(robot, reached)))


def tips(robot: Robot, measurements: Measurements) -> Array:
    """(N, 3) tips in the plate frame, m."""
    rows = zip(measurements.rotations, measurements.translations, strict=True)
    return np.array([forward_kinematics(robot, a, d).tip_position for a, d in rows])


def noisy(measurements: Measurements, seed: int, noise: float = NOISE) -> Measurements:
    """The same with normal errors of every coordinate, m."""
    errors = np.random.default_rng(seed).normal(0, noise, measurements.sensors.shape)
    return replace(measurements, sensors=measurements.sensors + errors)
