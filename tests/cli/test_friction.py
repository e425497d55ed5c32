"""`tubeopt follow` and `fk` with a robot whose file tells of friction."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.command_line import Run

ROBOT = """
kind: concentric
name: two tubes that rub
tubes:
  - {outer_diameter_mm: 1.0, inner_diameter_mm: 0.75, straight_length_mm: 150, curved_length_mm: 90, curvature_per_m: 9,
     material: nitinol}
  - {outer_diameter_mm: 1.5, inner_diameter_mm: 1.15, straight_length_mm: 70, curved_length_mm: 60, curvature_per_m: 5,
     material: nitinol}
friction: {torque_mN_m_per_m: [8], plate_mN_m: [0.1]}
"""


@pytest.fixture
def files(tmp_path: Path) -> tuple[str, str]:
    robot, path = tmp_path / "robot.yaml", tmp_path / "way.csv"
    robot.write_text(ROBOT)
    path.write_text("rotation_1_deg,rotation_2_deg\n0,0\n90,0\n60,-40\n")
    return str(robot), str(path)


def test_follow_takes_the_friction_of_the_file(run: Run, files: tuple[str, str]) -> None:
    rubbed = json.loads(run("follow", *files, "--json").out)["waypoints"]
    shaken = json.loads(run("follow", *files, "--shaken", "--json").out)["waypoints"]
    assert rubbed[0]["tip_position_mm"] == pytest.approx(shaken[0]["tip_position_mm"], abs=1e-6)
    assert rubbed[0]["friction_heat_mJ"] == 0 < rubbed[1]["friction_heat_mJ"] < rubbed[2]["friction_heat_mJ"]
    assert "friction_heat_mJ" not in shaken[2]
    band = json.loads(run("fk", files[0], "--rotations-deg", "60,-40", "--json").out)["tip_by_history_mm"]
    off = [abs(a - b) for a, b in zip(rubbed[2]["tip_position_mm"], shaken[2]["tip_position_mm"], strict=True)]
    assert all(0 < a < 1.1 * largest for a, largest in zip(off, band, strict=True))


def test_follow_takes_friction_and_load_together(run: Run, files: tuple[str, str]) -> None:
    both, shaken, free = (
        json.loads(run("follow", *files, *more, "--json").out)["waypoints"][2]
        for more in (("--tip-force-mN", "30,0,0"), ("--tip-force-mN", "30,0,0", "--shaken"), ())
    )
    assert both["friction_heat_mJ"] > 0
    assert both["tip_position_mm"] != pytest.approx(shaken["tip_position_mm"], abs=1e-3)
    assert both["tip_position_mm"][0] > free["tip_position_mm"][0] + 0.5


def test_follow_takes_the_friction_of_a_bundle(run: Run, tmp_path: Path) -> None:
    robot, path = tmp_path / "bundle.yaml", tmp_path / "way.csv"
    tubes = ROBOT.split("tubes:")[1].replace("material: nitinol}", "offset_mm: 1.5, angle_deg: 0}", 1)
    tubes = tubes.replace("material: nitinol}", "offset_mm: 1.5, angle_deg: 180}")
    robot.write_text("kind: bundle\ntubes:" + tubes)
    path.write_text("rotation_1_deg,rotation_2_deg\n0,0\n90,0\n60,-40\n")
    last = json.loads(run("follow", str(robot), str(path), "--json").out)["waypoints"][2]
    assert last["friction_heat_mJ"] > 0
    shaken = json.loads(run("follow", str(robot), str(path), "--shaken", "--json").out)["waypoints"][2]
    band = json.loads(run("fk", str(robot), "--rotations-deg", "60,-40", "--json").out)["tip_by_history_mm"]
    off = [abs(a - b) for a, b in zip(last["tip_position_mm"], shaken["tip_position_mm"], strict=True)]
    assert all(0 < a < 1.1 * largest for a, largest in zip(off, band, strict=True))
