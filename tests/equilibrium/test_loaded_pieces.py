"""Tubes made of pieces under load, against shooting."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from tests.equilibrium.test_loads import base_values
from tests.load_reference import RefLoad, RefTube, Shooting
from tubeopt import (
    ConcentricRobot,
    Load,
    Piece,
    Tube,
    find_load_limit,
    forward_kinematics,
    snap_free_certificate,
)

MM = 1e-3
BETA = np.array([-0.06, -0.04, -0.02])
ROTATIONS = np.array([0.2, 1.5, -1.0])
LOAD = Load((0.15, -0.1, 0.08), gravity=(0, -9.81, 0), points=((0.05, (0.1, 0.05, -0.2)),))
Stiffness = Callable[[float], float]

TUBES: list[tuple[float, float, Callable[[float], Sequence[float]], Stiffness, Stiffness, float]] = [
    (
        0.12,
        0.10,
        lambda x: (18 * np.cos(20 * x), 4 * np.sin(30 * x), 12.0),
        lambda s: 8e-4 * (1 + 0.3 * np.sin(40 * s)),
        lambda s: 6e-4 * (1 + 0.2 * np.sin(55 * s)),
        0.002,
    ),
    (
        0.08,
        0.08,
        lambda x: (9.0, 0.0, -6.0),
        lambda s: 2e-3 * (1 + 0.2 * np.sin(60 * s)),
        lambda s: 1.6e-3,
        0.004,
    ),
    (0.05, 0.06, lambda x: (5.0, 2.0, 0.0), lambda s: 4e-3, lambda s: 3e-3, 0.006),
]


@pytest.fixture(scope="module")
def robot() -> ConcentricRobot:
    """Helices and waves; held at the beginning of what is here a straight piece."""
    made = []
    for k, (straight, curved, precurvature, bending, torsional, mass) in enumerate(TUBES):
        pieces = (
            Piece(straight, 0.0, bending_stiffness=bending, torsional_stiffness=torsional),
            Piece(
                curved,
                precurvature,
                bending_stiffness=lambda x, f=bending, a=straight: f(x + a),
                torsional_stiffness=lambda x, f=torsional, a=straight: f(x + a),
            ),
        )
        outer = (1.0 + 0.4 * k) * MM
        made.append(Tube.of_pieces(outer, outer - 0.2 * MM, pieces, mass_per_length=mass))
    return ConcentricRobot(tuple(made))


def test_varying_tubes_under_weight_and_forces(robot: ConcentricRobot) -> None:
    e = forward_kinematics(robot, ROTATIONS, BETA, load=LOAD)
    assert np.allclose(e.tip_position / MM, (42.140009315, -42.873391175, 140.788348705), rtol=0, atol=1e-9 / MM)
    assert e.margin == pytest.approx(0.991431681, abs=1e-8)
    compliance = e.compliance
    assert np.abs(compliance - compliance.T).max() < 1e-10 * np.abs(compliance).max()


def reference(load: RefLoad) -> Shooting:
    tubes = [RefTube(*inputs[:5], mass=inputs[5]) for inputs in TUBES]
    return Shooting(tubes, BETA, ROTATIONS, load)


def test_varying_tubes_against_shooting(robot: ConcentricRobot) -> None:
    e = forward_kinematics(robot, ROTATIONS, BETA, load=LOAD)
    same = RefLoad(LOAD.force, points=((0.05, (0.1, 0.05, -0.2)),), gravity=(0, -9.81, 0))
    shot = reference(same).solve(base_values(e))
    assert shot.residual < 1e-11
    assert np.linalg.norm(shot.tip - e.tip_position) < 1e-10
    assert np.abs(shot.frame - e.tip_rotation).max() < 1e-9


@pytest.mark.parametrize("load", [Load((0.05, 0, 0), (0.002, 0.003, 0.004))])
def test_varying_tubes_under_a_moment(robot: ConcentricRobot, load: Load) -> None:
    e = forward_kinematics(robot, ROTATIONS, BETA, load=load)
    shot = reference(RefLoad(load.force, load.moment)).solve(base_values(e))
    assert shot.residual < 1e-11
    assert np.linalg.norm(shot.tip - e.tip_position) < 1e-9


def test_varying_tubes_without_load(robot: ConcentricRobot) -> None:
    plain = forward_kinematics(robot, ROTATIONS, BETA)
    e = forward_kinematics(robot, ROTATIONS, BETA, load=Load())
    assert np.linalg.norm(e.tip_position - plain.tip_position) < 1e-10
    assert e.margin == pytest.approx(plain.margin, abs=1e-8)
    assert np.allclose(e.rotation[:, -1], plain.rotation[:, -1], rtol=0, atol=1e-9)
    assert np.allclose(e.torsion[:, 0], plain.torsion[:, 0], rtol=0, atol=1e-8)
    warm = forward_kinematics(robot, ROTATIONS + 0.01, BETA, load=LOAD, start=e)
    cold = forward_kinematics(robot, ROTATIONS + 0.01, BETA, load=LOAD)
    assert np.allclose(warm.tip_position, cold.tip_position, rtol=0, atol=1e-11)


def test_what_is_shown_under_any_force_falls_with_it(robot: ConcentricRobot) -> None:
    bounds = [snap_free_certificate(robot, BETA, max_force=force) for force in (0.0, 0.001, 0.01, 0.1)]
    assert (np.diff(bounds) < 0).all()
    assert find_load_limit(robot, ROTATIONS, BETA, Load((0.05, 0, 0)), up_to=2.0) is None


def test_a_chain_of_arcs_is_the_plain_tube() -> None:
    def made(pieces: Any) -> ConcentricRobot:
        inner = Tube.of_pieces(1.0 * MM, 0.8 * MM, pieces, straight_length=0.1)
        return ConcentricRobot((inner, Tube(1.5 * MM, 1.1 * MM, 0.05, 0.08, 6.0)))

    whole = made((Piece(0.1, (10.0, 0.0, 0.0)),))
    parts = made((Piece(0.04, (10.0, 0.0, 0.0)), Piece(0.06, (10.0, 0.0, 0.0))))
    load = Load((0.2, 0.1, 0.0), gravity=(0, 0, -9.81))
    one, other = (forward_kinematics(robot, (0.5, 2.0), (-0.02, 0.0), load=load) for robot in (whole, parts))
    assert not whole.tubes[0].general
    assert parts.tubes[0].general
    assert np.allclose(one.tip_position, other.tip_position, rtol=0, atol=1e-11)
    assert one.margin == pytest.approx(other.margin, abs=1e-8)
