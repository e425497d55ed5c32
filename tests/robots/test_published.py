"""The robots in configs/robots: each names its source, loads, and solves to what re-integration gives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import tubeopt
from tests.examples import CONFIGS

ROBOTS = sorted(CONFIGS.glob("*.yaml"))


@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_it_says_its_source_and_solves(path: Path) -> None:
    head = path.read_text(encoding="utf-8").split("kind:")[0]
    assert "Source:" in " ".join(head.split())
    robot = tubeopt.load_robot(path)
    assert robot.name
    pose = tubeopt.forward_kinematics(robot, np.linspace(0.3, 1.0, robot.n_tubes), verify=True)
    assert pose.stable
    assert pose.verification is not None
    assert pose.verification.tip_position < 1e-7


def test_the_moduli_of_each_tube_are_those_of_the_source() -> None:
    """Young's and shear moduli that follow from the stiffnesses of a file and its diameters."""
    khadem = tubeopt.load_robot(CONFIGS / "khadem_ctr.yaml")
    rvim = tubeopt.load_robot(CONFIGS / "rvim_ctr.yaml")
    for robot, young, shear in (
        (khadem, [64.359738e9, 52.548578e9, 47.163092e9], [25.091303e9, 21.467424e9, 29.788923e9]),
        (rvim, [75e9] * 3, [25e9] * 3),
    ):
        for tube, e, g in zip(robot.tubes, young, shear, strict=True):
            assert tube.bending_stiffness == pytest.approx(e * tube.second_moment, rel=1e-3)
            assert tube.torsional_stiffness == pytest.approx(g * 2 * tube.second_moment, rel=3e-3)
