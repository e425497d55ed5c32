"""One robot, written as tubes of one curvature or as pieces: every public function gives the same answer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tubeopt
from tubeopt import ConcentricRobot, Piece, SolveError, Tube
from tubeopt.typing import Array

ROBOTS = [
    robot
    for path in sorted((Path(tubeopt.__file__).parents[1] / "configs" / "robots").glob("*.yaml"))
    if isinstance(robot := tubeopt.load_robot(path), ConcentricRobot)
    if all(tube.even and not tube.pieces for tube in robot.tubes)
]


def cut(tube: Tube, count: int) -> Tube:
    """The tube with its curved part written as equal pieces."""
    if not tube.curved_length:
        return tube
    return replace(
        tube, pieces=(Piece(tube.curved_length / count, tube.curvature),) * count, curvature=abs(tube.curvature)
    )


def written(robot: ConcentricRobot, count: int) -> ConcentricRobot:
    """The robot with all of its tubes cut."""
    return replace(robot, tubes=tuple(cut(tube, count) for tube in robot.tubes))


def pose(robot: ConcentricRobot) -> Array:
    """Rotations (n,) that oppose the tubes half."""
    return np.linspace(0.0, 1.4, robot.n_tubes)


def shape(robot: ConcentricRobot) -> list[float]:
    equilibrium = tubeopt.forward_kinematics(robot, pose(robot))
    # In units of the tolerance, so that both are held to the same.
    accuracy = [equilibrium.tip_error < 1e-9, equilibrium.mesh_error < 1e-8]
    return [
        *equilibrium.tip_position,
        *equilibrium.tip_rotations,
        equilibrium.margin,
        equilibrium.energy * 1e3,
        *accuracy,
    ]


def jacobian(robot: ConcentricRobot) -> list[float]:
    # Drawn back: a tube without a straight part cannot move on from home.
    result = tubeopt.forward_kinematics(robot, pose(robot), robot.home_translations - 1e-3).jacobian(side=1)
    return np.concatenate([result.position.ravel(), result.rotation.ravel()]).tolist()


def equilibria(robot: ConcentricRobot) -> list[float]:
    rotations = np.zeros(robot.n_tubes)
    rotations[0] = 3.0
    try:
        equilibria = tubeopt.find_equilibria(robot, rotations)
        return [number for e in equilibria for number in (*e.tip_position, e.index, *e.tip_rotations)]
    except SolveError:
        return [np.inf]


def certificate(robot: ConcentricRobot) -> list[float]:
    result = tubeopt.certify(robot)
    return [
        result.margin,
        *(result.gradient["bending_stiffness"] * 1e-3),
        *(result.gradient["torsional_stiffness"] * 1e-3),
    ]


def verdict(robot: ConcentricRobot) -> list[float]:
    result = tubeopt.assess_snapping(robot)
    return [result.snap is not None, result.certificate.margin, result.decided]


def worst(robot: ConcentricRobot) -> list[float]:
    return [tubeopt.worst_margin(robot).margin]


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize(
    ("ask", "tolerance"),
    [(shape, 1e-9), (jacobian, 2e-7), (equilibria, 1e-8), (certificate, 1e-7)],
    ids=lambda one: getattr(one, "__name__", ""),
)
@pytest.mark.parametrize("robot", ROBOTS, ids=lambda robot: robot.name)
def test_an_answer_is_the_same_however_tubes_are_written(
    robot: ConcentricRobot, ask: Callable[[Any], list[float]], tolerance: float, count: int
) -> None:
    other = written(robot, count)
    assert any(tube.pieces for tube in other.tubes)
    assert ask(other) == pytest.approx(ask(robot), abs=tolerance, rel=tolerance, nan_ok=True)


@pytest.mark.parametrize("ask", [verdict, worst])
@pytest.mark.parametrize("name", ["two_tube", "crl_ctr"])
def test_a_search_is_the_same_however_tubes_are_written(name: str, ask: Callable[[Any], list[float]]) -> None:
    (robot,) = (one for one in ROBOTS if one.name == tubeopt.load_robot(f"configs/robots/{name}.yaml").name)
    assert ask(written(robot, 2)) == pytest.approx(ask(robot), abs=1e-6)


def test_even_tubes_are_those_of_one_curvature_and_stiffness() -> None:
    tube = Tube(1e-3, 8e-4, 0.05, 0.04, -12.0)
    for count in (1, 2):
        assert cut(tube, count).even
        assert cut(tube, count).arc == -12.0
    assert not replace(tube, curvature=12.0, pieces=(Piece(0.02, 12.0), Piece(0.02, 11.0))).even
    assert not replace(tube, curvature=12.0, pieces=(Piece(0.04, (0.0, 12.0, 0.0)),)).even
    assert not replace(tube, curvature=12.0, pieces=(Piece(0.04, 12.0, bending_stiffness=1e-3),)).even
