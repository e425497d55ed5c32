"""Random robots of helices, tables, waves, slots and bends in all directions: right to 1e-10 m as they come."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline

from tests.general_reference import Bundle, Stretch, shoot, straight
from tubeopt import ConcentricRobot, Piece, Tube, forward_kinematics
from tubeopt.equilibrium.kinematics import point_of
from tubeopt.equilibrium.member import discretisation_of


def random_piece(random: np.random.Generator, length: float, stiffness: tuple[float, float]) -> tuple[Piece, Stretch]:
    """A piece, and the same as functions; 2 in 5 have slots."""
    amplitude, inputs = float(random.uniform(2, 14)), {}
    if random.random() < 0.4:
        bending = random.uniform(0.25, 1)
        stiffness = bending * stiffness[0], random.uniform(bending, 1) * stiffness[1]
        inputs = {"bending_stiffness": stiffness[0], "torsional_stiffness": stiffness[1]}
    u: Any
    match int(random.integers(5)):
        case 0:
            radius, pitch, left = random.uniform(0.01, 0.03), random.uniform(0.04, 0.15), bool(random.integers(2))
            piece = Piece.helix(length, radius, pitch, left=left, **inputs)
            lead = pitch / (2 * math.pi)
            size = radius**2 + lead**2
            u = lambda s: (radius / size, 0.0, (-lead if left else lead) / size)  # noqa: E731
        case 1:
            plane = random.uniform(-math.pi, math.pi)
            bend = amplitude * math.cos(plane), amplitude * math.sin(plane), 0.0
            piece, u = Piece(length, bend, **inputs), lambda s: bend
        case 2:
            s = np.linspace(0, length, int(random.integers(4, 8)))
            phase = random.uniform(0, 6, 2)
            rows = amplitude * np.cos(3 * s / length + phase[0]), 4 * np.sin(2 * s / length + phase[1]), 0 * s + 5
            piece = Piece.table(s, np.column_stack(rows), **inputs)
            through = make_interp_spline(s, np.column_stack(rows), k=min(5, len(s) - 1))
            u = lambda x: tuple(through(x))  # noqa: E731
        case 3:
            wave = random.uniform(5, 30)
            u = lambda s: (amplitude * math.cos(wave * s), 0.0, 6.0)  # noqa: E731
            piece = Piece(length, u, **inputs)
        case _:
            piece, u = Piece(length, amplitude, **inputs), lambda s: (amplitude, 0.0, 0.0)
    return piece, (length, u, lambda s: stiffness[0], lambda s: stiffness[1])


def random_robot(random: np.random.Generator) -> tuple[ConcentricRobot, Bundle]:
    """Two to four tubes of one to three pieces each, and the same as functions."""
    n = int(random.integers(2, 5))
    curved, held = (np.sort(random.uniform(*ends, n))[::-1].tolist() for ends in ((0.04, 0.12), (0.02, 0.1)))
    tubes, bundle = [], []
    for i in range(n):
        sizes = 0.94e-3 + 0.3e-3 * i, 0.7e-3 + 0.3e-3 * i
        plain = Tube(*sizes, held[i], curved[i], 0.0)
        own = float(plain.bending_stiffness), float(plain.torsional_stiffness)
        parts = random.dirichlet(np.full(int(random.integers(1, 4)), 3.0)) * curved[i]
        pieces, chain = zip(*(random_piece(random, float(part), own) for part in parts), strict=True)
        tubes.append(Tube.of_pieces(*sizes, pieces, straight_length=held[i]))
        bundle.append([straight(held[i], *own), *chain])
    return ConcentricRobot(tuple(tubes)), bundle


def test_random_robots_are_where_shooting_puts_them() -> None:
    random = np.random.default_rng(12)
    for _ in range(8):
        robot, bundle = random_robot(random)
        low = np.array(robot.limits.translations)[:, 0]
        shift = np.sort(random.uniform(0.6 * low, 0.0))
        turned = random.uniform(-math.pi, math.pi, robot.n_tubes)
        equilibrium = forward_kinematics(robot, turned, shift)
        beta = shift - np.array([tube.straight_length for tube in robot.tubes])
        torque = point_of(equilibrium, discretisation=discretisation_of(equilibrium)).torsion.torque[0]
        shot = shoot(bundle, turned.tolist(), beta.tolist(), torque.tolist())
        assert np.linalg.norm(shot.tip - equilibrium.tip_position) < 1e-10
        assert shot.stable == equilibrium.stable
