"""Loads of drives: derivatives of the whole energy, and the balance of work, energy and heat with friction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.examples import CRL, PIECES, THESIS
from tubeopt import (
    ConcentricRobot,
    EccentricRobot,
    Friction,
    HalfSpace,
    InputError,
    Load,
    Piece,
    Tube,
    drive_loads,
    follow,
    forward_kinematics,
    load_robot,
)
from tubeopt.equilibrium.result import Equilibrium
from tubeopt.robots.load import PointLoad
from tubeopt.robots.robot import Robot
from tubeopt.typing import Array


def concentric(robot: Robot) -> ConcentricRobot:
    assert isinstance(robot, ConcentricRobot)
    return robot


def eccentric() -> EccentricRobot:
    robot = load_robot("thesis_etr")
    assert isinstance(robot, EccentricRobot)
    return robot


HEAVY = replace(
    concentric(THESIS),
    tubes=tuple(replace(t, mass_per_length=m) for t, m in zip(THESIS.tubes, (0.02, 0.05, 0.05), strict=True)),
)
VARYING = ConcentricRobot(
    (
        Tube.of_pieces(
            1.0e-3,
            0.7e-3,
            [
                Piece(
                    0.10,
                    lambda x: (18 * np.cos(20 * x), 4 * np.sin(30 * x), 12),
                    bending_stiffness=lambda x: 8e-4 * (1 + 0.3 * np.sin(40 * x)),
                    torsional_stiffness=lambda x: 6e-4 * (1 + 0.2 * np.sin(55 * x)),
                )
            ],
            straight_length=0.12,
        ),
        Tube.of_pieces(
            1.6e-3, 1.2e-3, [Piece(0.08, (9, 0, -6), bending_stiffness=2e-3, torsional_stiffness=1.6e-3)],
            straight_length=0.08,
        ),
    )
)  # fmt: skip


def behind(robot: Robot, translations: Array, load: Load | None) -> float:
    """Energy, J, of curved parts that the plate holds straight, and of the weight of the tubes behind it."""
    total = 0.0
    for i, tube in enumerate(robot.tubes):
        length = min(tube.straight_length - translations[i], tube.length)
        if tube.pieces:
            start = tube.straight_length
            for piece in tube.pieces:
                end = min(start + piece.length, length)
                if end > start:
                    nodes, weights = np.polynomial.legendre.leggauss(20)
                    s = start + (nodes[:, None] + 1) / 2 * (end - start)
                    table = robot.assembly(translations).lengthwise
                    assert table is not None
                    kb, _, x, y, _, _ = table.values(np.tile(s, (1, robot.n_tubes)))[:, :, i]
                    total += (end - start) / 4 * float(weights @ (kb * (x**2 + y**2)))
                start += piece.length
        else:
            total += float(tube.bending_stiffness) * tube.curvature**2 / 2 * max(0.0, length - tube.straight_length)
        if load is not None and load.gravity is not None:
            total += float(tube.mass_per_length or 0.0) * load.gravity[2] * length**2 / 2
    return total


def differences(at: Equilibrium, step: tuple[float, float]) -> tuple[Array, Array]:
    """Derivatives of the whole energy by rotations and translations, by differences of sixth order."""
    n, load = at.robot.n_tubes, at.load

    def energy(move: Array) -> float:
        rotations, translations = at.rotations + move[:n], at.translations + move[n:]
        e = forward_kinematics(at.robot, rotations, translations, load=load, start=at, tolerance=1e-12)
        return e.potential + behind(at.robot, translations, load)

    out = []
    for k in range(2 * n):
        unit = np.eye(2 * n)[k] * step[k >= n]
        once, twice, fourth = (energy(m * unit) - energy(-m * unit) for m in (1, 2, 4))
        out.append((16 * (8 * once - twice) / 12 - (8 * twice - fourth) / 24) / 15 / step[k >= n])
    return np.array(out[:n]), np.array(out[n:])


@pytest.mark.parametrize(
    ("robot", "translations", "load", "accuracy"),
    [
        (THESIS, (-0.03, -0.015, -0.01), None, 1e-9),
        (HEAVY, (0.03, 0.02, 0.01), Load((0.1, -0.05, -0.08), gravity=(1.0, -9.81, -3.0)), 1e-9),
        (CRL, (-0.013, -0.008, -0.004), Load((0.05, 0.02, -0.1), points=(PointLoad(0.01, (0.1, 0.0, 0.0)),)), 1e-9),
        (VARYING, (0.06, 0.04), Load((0.15, -0.1, 0.08)), 1e-9),
        (PIECES, (-0.013, -0.008), None, 1e-9),
    ],
    ids=["straightened", "weight", "loads", "varying", "pieces"],
)
def test_loads_are_the_derivatives_of_the_energy(
    robot: Robot, translations: tuple[float, ...], load: Load | None, accuracy: float
) -> None:
    shift = np.array([*translations, *robot.home_translations[len(translations) :]])
    at = forward_kinematics(robot, np.linspace(0.0, 2.0, robot.n_tubes), shift, load=load, tolerance=1e-12)
    torque, force = differences(at, (1e-2, 3e-4))
    loads = drive_loads(at)
    np.testing.assert_allclose(loads.torque, torque, rtol=accuracy, atol=1e-11)
    np.testing.assert_allclose(loads.force, force, rtol=accuracy, atol=1e-9)


@pytest.mark.parametrize("side", [1, -1])
def test_at_home_the_forces_differ_to_either_side(side: int) -> None:
    rotations, home, step = np.array([0.0, 1.0, 2.0]), np.zeros(3), 2e-5 * side

    def energy(tube: int, steps: int) -> float:
        translations = home + np.eye(3)[tube] * steps * step
        at = forward_kinematics(THESIS, rotations, translations, tolerance=1e-12)
        return at.energy + behind(THESIS, translations, None)

    found = drive_loads(forward_kinematics(THESIS, rotations), side=side).force
    for i in range(3):
        values = [energy(i, k) for k in range(5)]
        assert found[i] == pytest.approx(np.dot((-25, 48, -36, 16, -3), values) / (12 * step), abs=1e-9)


def test_a_carriage_bears_the_wall_before_the_tip() -> None:
    rotations, translations = np.array([0.0, 1.0, 2.0]), np.array([0.03, 0.02, 0.01])
    free = forward_kinematics(THESIS, rotations, translations)
    axis = free.tip_rotation[:, 2]
    wall = HalfSpace(tuple(free.tip_position - 5e-4 * axis), tuple(-axis - (0.2, 0.3, 0.1)))
    touching = forward_kinematics(THESIS, rotations, translations, walls=[wall])
    assert touching.walls is not None
    assert touching.walls.contacts[0].arc_length == pytest.approx(touching.arc_length[-1])

    def energy(steps: int) -> float:
        moved = translations + np.array([steps * 5e-5, 0.0, 0.0])
        return forward_kinematics(THESIS, rotations, moved, walls=[wall], start=touching).energy

    difference = (8 * (energy(1) - energy(-1)) - (energy(2) - energy(-2))) / (12 * 5e-5)
    loads = drive_loads(touching)
    assert loads.force[0] == pytest.approx(difference, abs=1e-8)
    assert abs(loads.force[0] - drive_loads(free).force[0]) > 1e-3


def test_tubes_of_a_bundle_share_a_carriage() -> None:
    robot = eccentric().bundle()
    rotations, translations = np.radians([30.0, 100.0, -20.0]), robot.home_translations - 0.005
    at = forward_kinematics(robot, rotations, translations)
    loads = drive_loads(at)
    straight = sum(t.bending_stiffness * t.curvature**2 / 2 for t in robot.tubes)

    def energy(turn: Array, slide: float) -> float:
        e = forward_kinematics(robot, rotations + turn, translations + slide, start=at)
        return e.energy + straight * (0.005 - slide)

    none = np.zeros(3)
    slid = (8 * (energy(none, 2e-4) - energy(none, -2e-4)) - (energy(none, 4e-4) - energy(none, -4e-4))) / (12 * 2e-4)
    np.testing.assert_allclose(loads.force, [slid], rtol=1e-8)
    turn = np.array([0.01, 0.0, 0.0])
    turned = (8 * (energy(turn, 0) - energy(-turn, 0)) - (energy(2 * turn, 0) - energy(-2 * turn, 0))) / 0.12
    assert loads.torque[0] == pytest.approx(turned, abs=1e-9)


@pytest.mark.parametrize(
    ("slide", "friction", "error"),
    [
        ((0.0, 0.0, 0.0), Friction(torque=0.005), 1e-6),
        ((0.0, 0.0, 0.0), Friction(torque=0.005, plate=1e-4, jumps=1e-4, ends=1e-4), 1e-6),
        ((0.02, -0.005, 0.004), Friction(torque=0.005, plate=1e-4, jumps=1e-4, ends=1e-4), 1e-6),
    ],
    ids=["distributed", "concentrated", "sliding"],
)
def test_work_is_energy_and_heat_with_friction(slide: tuple[float, ...], friction: Friction, error: float) -> None:
    way = np.linspace(0.0, 1.0, 101)[:, None]
    rotations, translations = way * (2.0, 0.0, -1.0) + (0.0, 0.3, 0.5), way * slide + (0.03, 0.02, 0.01)
    states = follow(THESIS, rotations, translations, friction=friction).equilibria
    loads = [drive_loads(e) for e in states]
    torque, force = np.array([each.torque for each in loads]), np.array([each.force for each in loads])
    work = np.sum((torque[1:] + torque[:-1]) / 2 * np.diff(rotations, axis=0))
    work += np.sum((force[1:] + force[:-1]) / 2 * np.diff(translations, axis=0))
    stored = [e.energy + behind(THESIS, e.translations, None) for e in (states[0], states[-1])]
    last = states[-1].friction
    assert last is not None
    assert last.heat > 1e-3
    assert work == pytest.approx(stored[1] - stored[0] + last.heat, abs=error)


def test_loads_without_an_energy_are_refused() -> None:
    with pytest.raises(InputError, match=r"model without an energy.*bundle\(\)"):
        drive_loads(forward_kinematics(eccentric(), [0.0, 0.0, 0.0]))
    with pytest.raises(InputError, match="has moments or turns with the tip"):
        drive_loads(forward_kinematics(THESIS, [0.0, 1.0, 2.0], load=Load(moment=(0.0, 0.01, 0.0))))
    bundle = eccentric().bundle()
    with pytest.raises(InputError, match="a bundle has a load"):
        drive_loads(forward_kinematics(bundle, [0.0, 0.0, 0.0], load=Load((0.01, 0.0, 0.0))))
    with pytest.raises(InputError, match="side is 0"):
        drive_loads(forward_kinematics(THESIS, [0.0, 1.0, 2.0]), side=0)
