"""A way that a robot is driven along, there and back, with drives that do not read true and sensors that lag behind."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from tubeopt import ConcentricRobot, Tube
from tubeopt.robots.calibration import Calibration
from tubeopt.typing import Array
from tubeopt.validation import Measurements
from tubeopt.validation.model import PredictedPoses, solve_poses

from .laboratory import MM, in_device

RATE = 10.0
"""Rows per second."""

DRIVES = Calibration(
    rotation_offsets=(0.0, 0.08),
    translation_offsets=(-2.0 * MM, 1.5 * MM),
    rotation_gains=(1.01, 0.992),
    translation_gains=(1.0, 1.0),
    rotation_play=(0.0, 0.0),
    latency=0.09,
)


def robot() -> ConcentricRobot:
    """Two tubes that cannot snap."""
    inner = Tube(1.0 * MM, 0.75 * MM, 150 * MM, 90 * MM, 9.0)
    return ConcentricRobot((inner, Tube(1.5 * MM, 1.15 * MM, 70 * MM, 60 * MM, 5.0)), name="two tubes on a way")


def joints(time: Array, last: float) -> Array:
    """(N, 4) readings at times (N,), s, of a way that turns back half way to `last`."""
    reached = np.minimum(time, last - time)[:, None]
    speed, phase = np.array([0.23, 0.31, 0.19, 0.27]), np.array([0.3, 1.9, 4.0, 5.1])
    waves = np.sin(speed * reached + phase) + 0.6 * np.sin(2.3 * speed * reached + 2 * phase)
    return np.asarray(waves * [1.4, 1.6, 14 * MM, 9 * MM] + [0.0, 0.0, 20 * MM, -8 * MM])


def poses(given: ConcentricRobot, drives: Calibration, readings: Array) -> PredictedPoses:
    """Where the robot is at readings (N, 4)."""
    return solve_poses(given, *drives.to_model(readings[:, :2], readings[:, 2:]), np.zeros(1))


@cache
def seen(drives: Calibration, count: int) -> Array:
    """(N, 3) tips along the way, in the frame of the device, without noise."""
    time = np.arange(count) / RATE
    return in_device(poses(robot(), drives, joints(time - drives.latency, time[-1])).position[:, 0])


def driven(drives: Calibration = DRIVES, count: int = 300, noise: float = 0.3 * MM, seed: int = 0) -> Measurements:
    """Rows of the way, measured with noise."""
    time = np.arange(count) / RATE
    tips = seen(drives, count)
    read = joints(time, time[-1])
    noisy = tips + np.random.default_rng(seed).normal(0, noise, tips.shape)
    return Measurements(read[:, :2], read[:, 2:], noisy, time=time, source="a way")


def trivial(**changed: object) -> Calibration:
    """Drives that read true but for this."""
    return replace(Calibration.none(2), **changed)  # type: ignore[arg-type]
