"""Joint values of the model from readings and back, with carriages that yield."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.command_line import ROOT, Run, answer
from tubeopt import InputError, forward_kinematics, load_robot
from tubeopt.equilibrium.drive_loads import drive_loads
from tubeopt.equilibrium.readings import push, to_model, to_readings, yielded
from tubeopt.robots.calibration import Calibration

ROBOTS = ROOT / "configs" / "robots"
SOFT = (2e-3, 5e-3, 20e-3)
"""m/N."""


def joints(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rotations and translations (count, 3) of the thesis robot."""
    random = np.random.default_rng(1)
    return random.uniform(-1, 1, (count, 3)), random.uniform(-0.03, 0.0, (count, 3))


@pytest.mark.parametrize("name", ["thesis_ctr", "example_pieces"])
def test_the_push_of_a_tube_is_the_force_of_its_drive(name: str) -> None:
    """Curved parts behind the plate are held straight there, and push too."""
    robot = load_robot(ROBOTS / f"{name}.yaml")
    rotations, translations = joints(4)
    force = push(robot, rotations, translations)[0]
    for a, d, own in zip(rotations, translations, force, strict=True):
        exact = drive_loads(forward_kinematics(robot, a, d)).force
        np.testing.assert_allclose(own, exact, rtol=1e-6, atol=1e-7)


def test_a_tube_at_the_end_of_its_carriage_pushes_too() -> None:
    robot = load_robot(ROBOTS / "thesis_ctr.yaml")
    rotations, translations = joints(1)
    translations[0, 0] = robot.tubes[0].straight_length
    exact = drive_loads(forward_kinematics(robot, rotations[0], translations[0]), side=-1).force
    np.testing.assert_allclose(push(robot, rotations, translations)[0][0], exact, rtol=1e-2, atol=1e-5)


def test_carriages_yield_until_their_springs_hold_the_tubes() -> None:
    robot = load_robot(ROBOTS / "thesis_ctr.yaml")
    soft = replace(robot, calibration=replace(Calibration.none(3), translation_compliance=SOFT))
    read = joints(5)
    rotations, translations = to_model(soft, *read)
    assert (np.abs(translations - read[1]).max(0) > 1e-6).all()
    for a, d, r in zip(rotations, translations, read[1], strict=True):
        force = drive_loads(forward_kinematics(robot, a, d)).force
        np.testing.assert_allclose(d, r - np.array(SOFT) * force, atol=1e-11)
    for one, other in zip(to_readings(soft, rotations, translations), read, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)
    alone = to_model(soft, read[0][0], read[1][0])[1]
    np.testing.assert_allclose(alone, translations[0], atol=1e-12)
    np.testing.assert_array_equal(yielded(robot, *read, np.zeros(3)), read[1])


def test_the_commands_take_and_give_readings_of_carriages_that_yield(tmp_path: Path, run: Run) -> None:
    robot = load_robot(ROBOTS / "thesis_ctr.yaml")
    soft = replace(robot, calibration=replace(Calibration.none(3), translation_compliance=SOFT))
    soft.save(tmp_path / "soft.yaml")
    assert load_robot(tmp_path / "soft.yaml") == soft
    position = ["--rotations-deg", "0,60,90", "--translations-mm=-10,-5,0"]
    report = answer(run("fk", str(tmp_path / "soft.yaml"), *position, "--json"))
    model = to_model(soft, np.radians([0, 60, 90]), np.array([-0.01, -0.005, 0.0]))
    np.testing.assert_allclose(report["translations_mm"], model[1] * 1e3, atol=1e-8)
    np.testing.assert_allclose(report["readings_mm"], [-10, -5, 0], atol=1e-8)


def test_only_carriages_of_concentric_robots_yield() -> None:
    robot = load_robot(ROBOTS / "thesis_etr.yaml")
    with pytest.raises(InputError, match="only carriages of concentric robots"):
        replace(robot, calibration=replace(Calibration.none(3), translation_compliance=(1e-3,) * 3))
