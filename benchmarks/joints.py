"""Joint values and targets that several benchmarks ask."""

from __future__ import annotations

import numpy as np

from tubeopt import ConcentricRobot

from .shooting import Array

APART = 1e-6
"""How far (m) the timed translations lie from those of the untimed first round."""

TURN, SHIFT = np.pi / 360, 1e-4
"""Largest motion of a joint per step of a path, rad and m."""

STEP = 0.5e-3
"""Between targets of a path, m."""


def random_joints(robot: ConcentricRobot, count: int, seed: int = 0) -> list[tuple[Array, Array]]:
    """Random configurations: half a turn to either side, each tube within 20 % of its curved length from home."""
    random = np.random.default_rng(seed)
    reach = 0.2 * np.array([tube.curved_length for tube in robot.tubes])
    largest = np.array([tube.straight_length for tube in robot.tubes]) - 2 * APART
    return [
        (random.uniform(-np.pi, np.pi, robot.n_tubes), np.minimum(random.uniform(-reach, reach), largest))
        for _ in range(count)
    ]


def path_joints(
    robot: ConcentricRobot, count: int, shift: float = 0.0, *, translate: bool = True
) -> list[tuple[Array, Array]]:
    """A path that turns around before the tubes are twisted so much that they could snap."""
    n = robot.n_tubes
    phase = np.arange(n) * 2 * np.pi / n
    period = 400
    out = []
    for k in range(count):
        # The largest rate of a sine of amplitude a and period T is 2 pi a / T.
        wave = np.sin(2 * np.pi * k / period + phase) * period / (2 * np.pi)
        moved = SHIFT * np.roll(wave, 1) if translate else SHIFT * phase
        out.append((TURN * wave, moved - 5e-3 + shift))
    return out


def ordered_joints(robot: ConcentricRobot, count: int, seed: int = 0) -> tuple[Array, Array]:
    """Random joint values within a turn, with carriages and ends in order."""
    random = np.random.default_rng(seed)
    curved = np.array([tube.curved_length for tube in robot.tubes])
    straight = np.array([tube.straight_length for tube in robot.tubes])
    rows: list[Array] = []
    while len(rows) < count:
        shift = random.uniform(-curved, straight, (4 * count, len(curved)))
        start, end = shift - straight, shift + curved
        rows.extend(shift[(np.diff(start) >= 0).all(1) & (np.diff(end) <= 0).all(1)])
    return random.uniform(-2 * np.pi, 2 * np.pi, (count, len(curved))), np.array(rows[:count])


def circle(centre: tuple[float, float, float], radius: float, steps: int) -> Array:
    """(T, 3) targets STEP apart on a wavy circle, m."""
    angle = np.arange(steps) * STEP / radius
    return np.array(centre) + radius * np.column_stack([np.cos(angle), np.sin(angle), 0.1 * np.sin(3 * angle)])
