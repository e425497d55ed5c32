"""Targets that can be reached: tips of random stable configurations inside the limits, tubes in order."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tubeopt import Equilibrium, SolveError, forward_kinematics
from tubeopt.robots.robot import Robot
from tubeopt.typing import Array


def in_order(robot: Robot, translations: Array, slack: float = 1e-9) -> bool:
    """Whether every inner tube is held behind, and ends beyond, the next one; written out once more."""
    for i, o in robot.nested_pairs:
        inner, outer = robot.tubes[i], robot.tubes[o]
        held = translations[[i, o]] - [inner.straight_length, outer.straight_length]
        ends = held + np.array([inner.length, outer.length])
        if held[0] > held[1] + slack or ends[0] < ends[1] - slack:
            return False
    return True


def inside(robot: Robot, rotations: Array, translations: Array, slack: float = 0.0) -> bool:
    """Whether joint values keep the robot's ranges and the order of its tubes."""
    for values, ranges in ((rotations, robot.limits.rotations), (translations, robot.limits.translations)):
        low, high = np.array(ranges).T
        if (values < low - slack).any() or (values > high + slack).any():
            return False
    return in_order(robot, translations)


def reachable(robot: Robot, count: int, seed: int, *, margin: float = 0.1) -> Iterator[Equilibrium]:
    """Stable equilibria at random admissible joint values."""
    random = np.random.default_rng(seed)
    low, high = np.array(robot.limits.translations).T
    turn_low, turn_high = np.array(robot.limits.rotations).T
    equal = all(
        a.straight_length == b.straight_length and a.length == b.length
        for a, b in ((robot.tubes[i], robot.tubes[o]) for i, o in robot.nested_pairs)
    )
    while count:
        translations = random.uniform(low, high)
        for tubes in robot.moving_together:
            translations[list(tubes)] = translations[tubes[0]]
        if equal:
            translations[:] = translations[0]
        rotations = random.uniform(turn_low, turn_high)
        if not in_order(robot, translations):
            continue
        try:
            equilibrium = forward_kinematics(robot, rotations, translations)
        except SolveError:
            continue
        if equilibrium.margin >= margin:
            count -= 1
            yield equilibrium
