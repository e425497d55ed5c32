"""Robots of known coupling, and random ones, for tests of stability."""

from __future__ import annotations

import numpy as np

from tests.examples import CRL, MM, THESIS
from tubeopt import ConcentricRobot, Material, Tube
from tubeopt.robots.robot import Robot
from tubeopt.typing import Array

ALLOY = Material.from_poisson_ratio("m", 1e9, 0.3)

TRANSMISSION = 0.1856946012
"""Of the inner and middle tubes of the thesis robot at the lowest input with three equilibria at 150 deg, m."""


def unit_pair(c: float, lever: float, length: float = 1.0) -> ConcentricRobot:
    """Two tubes whose coupling (1 + nu) kappa_1 kappa_2 is c, with transmission `lever`, over `length` (m)."""
    kappa = np.sqrt(c / (1 + ALLOY.poisson_ratio))
    return ConcentricRobot(
        (Tube(1e-2, 0.5e-2, lever, length, kappa, ALLOY), Tube(2e-2, 1.5e-2, lever, length, kappa, ALLOY))
    )


def inner_and_middle() -> ConcentricRobot:
    """The inner and middle tubes of the thesis robot, with the transmission for which the design gives numbers."""
    inner, middle, _ = THESIS.tubes
    return ConcentricRobot(
        tuple(
            Tube(t.outer_diameter, t.inner_diameter, TRANSMISSION, t.curved_length, t.curvature, t.material)
            for t in (inner, middle)
        )
    )


def random_robot(random: np.random.Generator, n: int, *, bend: float = 1.0, home: bool = False) -> ConcentricRobot:
    """n tubes of random walls, lengths and materials (nu unequal), bent by about `bend` rad over 0.1 m; with `home`
    without straight parts."""
    bore, straight, curved = random.uniform(0, 0.5 * MM), 0.0, 0.0
    profile, walls = [], []
    for _ in range(n):
        straight += 0.0 if home else float(random.choice([0.0, random.uniform(0, 0.1)]))
        curved = max(0.02, (curved + random.uniform(0.01, 0.1)) * float(random.choice([1.0, 1.0, 0.7])))
        profile.append((straight, curved))
        outer = bore + random.uniform(0.05, 0.4) * MM
        walls.append((outer, bore))
        bore = outer + random.uniform(0, 0.2) * MM
    profile.sort(key=sum, reverse=True)
    return ConcentricRobot(
        tuple(
            Tube(
                *wall,
                *lengths,
                bend / 0.1 * random.uniform(0.3, 1.2) * float(random.choice([1, 1, 1, -1])),
                Material.from_poisson_ratio("alloy", random.uniform(30e9, 90e9), random.uniform(0, 0.45)),
            )
            for wall, lengths in zip(walls, profile, strict=True)
        )
    )


def random_translations(random: np.random.Generator, robot: ConcentricRobot) -> Array:
    """From nearly withdrawn, with curved parts behind the plate, to wholly advanced."""
    low = [-0.9 * tube.curved_length for tube in robot.tubes]
    high = [tube.straight_length for tube in robot.tubes]
    return np.asarray(random.uniform(low, high))


def strong(random: np.random.Generator, n: int, *, bend: float = 2.0) -> ConcentricRobot:
    """As `random_robot`, whose tubes are curved over lengths that overlap much, so that it snaps."""
    while True:
        robot = random_robot(random, n, bend=bend)
        if min(tube.curved_length for tube in robot.tubes) > 0.05:
            return robot


def snapping_way(k: int) -> tuple[Robot, Array, Array]:
    """Robot, and three random waypoints of rotations (3, n) and translations (3, n); k in 4 is which kind of robot."""
    random = np.random.default_rng([20, k])
    robots: tuple[Robot, ...] = (THESIS, CRL, strong(random, 2, bend=2.5), strong(random, 3, bend=2.0))
    robot = robots[k % 4]
    n = robot.n_tubes
    rotations = random.uniform(-2 * np.pi, 2 * np.pi, (3, n))
    rotations[0] = random.uniform(-0.5, 0.5, n)
    low = [-0.5 * tube.curved_length for tube in robot.tubes]
    high = [tube.straight_length for tube in robot.tubes]
    translations = np.maximum(low, random.uniform(np.full(n, -0.03), np.minimum(high, 0.03), (3, n)))
    return robot, rotations, np.asarray(translations)
