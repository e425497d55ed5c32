"""Robots and tasks that the tests of design share."""

from __future__ import annotations

import numpy as np

from tests.examples import MM, THESIS
from tests.stability.robots import ALLOY
from tubeopt import ConcentricRobot, DesignTask, Tube
from tubeopt.design import Free, Objective, SnapFree

assert isinstance(THESIS, ConcentricRobot)


def equal_pair(overlap: float, transmission: float, kappa: float = 1.0) -> ConcentricRobot:
    """Two tubes of equal curvature, overlap and transmission."""
    return ConcentricRobot(
        (
            Tube(1.0 * MM, 0.5 * MM, transmission, overlap, kappa, ALLOY),
            Tube(2.0 * MM, 1.5 * MM, transmission, overlap, kappa, ALLOY),
        )
    )


def two_tubes() -> ConcentricRobot:
    """Two tubes that reach around."""
    return ConcentricRobot(
        (Tube(1.0 * MM, 0.8 * MM, 0.12, 0.08, 12.0), Tube(1.4 * MM, 1.1 * MM, 0.05, 0.06, 6.0)), name="two tubes"
    )


def three_tubes() -> ConcentricRobot:
    """Three tubes whose curved parts begin and end together."""
    walls = ((1.0, 0.9, 0.06), (1.2, 1.05, 0.04), (1.4, 1.25, 0.02))
    return ConcentricRobot(tuple(Tube(od * MM, bore * MM, straight, 0.1, 8.0) for od, bore, straight in walls))


def tightest(robot: ConcentricRobot, margin: float, most: float = 100.0) -> DesignTask:
    """The tightest bundle of tubes of one curvature that is snap-free at home."""
    tubes = tuple(range(robot.n_tubes))
    free = (Free("curvature", tubes, 0.01, most, "equal"),)
    return DesignTask(robot, free, (SnapFree(margin),), Objective("tip_curvature"))


def snap_free_thesis(margin: float = 0.05) -> DesignTask:
    """The thesis robot made snap-free with the least change of its curvatures."""
    return DesignTask(THESIS, (Free("curvature", (0, 1, 2), 0.5, 15.0),), (SnapFree(margin),), Objective("change"))


def closed_form(overlap: float, transmission: float, margin: float) -> float:
    """Curvature of two equal tubes at which mu_cert is `margin`: l q tan(L q) = 1, q^2 = (1 + nu) kappa^2 / (1 - m)."""
    low, high = 0.0, 0.5 * np.pi / overlap
    for _ in range(200):
        q = 0.5 * (low + high)
        if transmission * q * np.sin(overlap * q) < np.cos(overlap * q):
            low = q
        else:
            high = q
    return float(0.5 * (low + high) * np.sqrt((1 - margin) / (1 + ALLOY.poisson_ratio)))
