"""Measurements in CSV: what the columns mean, and every bad cell with its row and column."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tubeopt import InputError, load_robot
from tubeopt.inverse.mirror import ASSIGNMENTS, mirror_rotations
from tubeopt.runs.measurement_file import load_measurements, save_measurements
from tubeopt.validation import JointLog, Measurements

from .laboratory import CONFIGS, ctr, etr, mirrored, turned


def read(tmp_path: Path, text: str, eccentric: bool = False) -> Measurements:
    path = tmp_path / "m.csv"
    path.write_text(text, encoding="utf-8")
    return load_measurements(path, etr() if eccentric else ctr())


def refused(tmp_path: Path, text: str, eccentric: bool = False) -> list[str]:
    with pytest.raises(InputError) as caught:
        read(tmp_path, text, eccentric)
    return [line.removeprefix(f"{tmp_path / 'm.csv'}: ") for line in str(caught.value).splitlines()]


def test_units_comments_and_home(tmp_path: Path) -> None:
    text = (
        "\ufeff# a comment\nz_mm, x_mm, y_mm, rotation_2_deg, rotation_1_deg, translation_2_mm, note\n"
        "\n3,1,2,180,-90,-5,first one\n,,,,,,\n# another\n6,4,5,0,1e2,0,\n"
    )
    m = read(tmp_path, text)
    np.testing.assert_allclose(np.degrees(m.rotations), [[-90, 180], [100, 0]])
    np.testing.assert_allclose(m.translations, [[0.0, -0.005], [0.0, 0.0]])
    np.testing.assert_allclose(m.tip_position, [[1e-3, 2e-3, 3e-3], [4e-3, 5e-3, 6e-3]])
    assert m.direction is None
    assert m.source == "m.csv"


def test_translations_that_are_missing_are_home(tmp_path: Path) -> None:
    robot = load_robot(CONFIGS / "robots" / "example_three_segment_etr.yaml")
    columns = [*(f"rotation_{i + 1}_deg" for i in range(robot.n_tubes)), "x_mm", "y_mm", "z_mm"]
    path = tmp_path / "m.csv"
    path.write_text(",".join(columns) + "\n" + ",".join("0" for _ in columns) + "\n")
    np.testing.assert_array_equal(load_measurements(path, robot).translations[0], robot.home_translations)


def test_several_sensors_are_averaged(tmp_path: Path) -> None:
    text = "rotation_1_deg,rotation_2_deg,x1_mm,y1_mm,z1_mm,x2_mm,y2_mm,z2_mm\n0,0,1,0,9,3,0,9\n"
    m = read(tmp_path, text)
    assert m.sensors.shape == (1, 2, 3)
    np.testing.assert_allclose(m.tip_position, [[2e-3, 0, 9e-3]])
    np.testing.assert_allclose(m.sensor_spread, [1e-3])


@pytest.mark.parametrize("assignment", ASSIGNMENTS)
def test_mirror_actuation(tmp_path: Path, assignment: tuple[int, ...]) -> None:
    word = "".join(str(i + 1) for i in assignment)
    m = read(tmp_path, f"direction_deg,separation_deg,assignment,x_mm,y_mm,z_mm\n20,30,{word},0,0,0\n", eccentric=True)
    np.testing.assert_allclose(m.rotations[0], mirror_rotations(np.radians(20), np.radians(30), assignment))
    assert m.direction is not None
    assert m.separation is not None
    assert np.degrees([m.direction[0], m.separation[0]]) == pytest.approx([20, 30])


def test_saved_measurements_are_read_back_to_the_last_bit(tmp_path: Path) -> None:
    two = mirrored(etr(), 3)
    two = replace(two, sensors=np.stack([two.tip_position, two.tip_position * 1.1], axis=1))
    for robot, measurements in ((etr(), two), (ctr(), turned(ctr(), 3))):
        path = tmp_path / "m.csv"
        save_measurements(measurements, path, "a comment\nin two lines")
        again = load_measurements(path, robot)
        for name in ("rotations", "translations", "sensors", "direction", "separation"):
            np.testing.assert_array_equal(getattr(again, name), getattr(measurements, name))


HEAD = "rotation_1_deg,rotation_2_deg,x_mm,y_mm,z_mm\n"


def test_every_bad_cell_is_named(tmp_path: Path) -> None:
    assert refused(tmp_path, f"# comment\n{HEAD}0,0,1,2,3\n0,a,1,nan,3\n\n0,0,,1 mm,3\n") == [
        "row 2 (line 4), column rotation_2_deg is 'a'; it must be a number",
        "row 3 (line 6), column y_mm is '1 mm'; it must be a number",
        "row 2 (line 4), column y_mm is missing; a sensor has x, y and z, or none of them",
        "row 3 (line 6), column x_mm is missing; a sensor has x, y and z, or none of them",
    ]


def test_many_problems_are_counted(tmp_path: Path) -> None:
    problems = refused(tmp_path, HEAD + "a,b,c,d,e\n" * 6)
    assert len(problems) == 21
    assert problems[-1] == "and 10 more"


@pytest.mark.parametrize(
    ("text", "eccentric", "problems"),
    [
        ("", False, ["the file is empty; its first line must name the columns"]),
        (HEAD, False, ["there are no rows below the header"]),
        ("rotation_1_deg;x_mm\n", False, ["there are no rows below the header"]),
        (HEAD + "0,0,1,2\n", False, ["row 1 (line 2) has 4 cells; the header names 5 columns"]),
        ("x_mm,x_mm,\n0,0,0\n", False, ["column 3 has no name", "column x_mm is given twice"]),
        (
            "rotation_1_cm,rotation_2_deg,x_mm,y_mm\n0,0,0,0\n",
            False,
            [
                "column rotation_1_cm is not known; did you mean 'rotation_1_deg'?",
                "column z_mm is missing",
                "column rotation_1_deg is missing",
            ],
        ),
        (
            "rotation_1_deg,rotation_2_deg,x2_mm,y2_mm\n0,0,0,0\n",
            False,
            ["column z2_mm is missing"],
        ),
        (
            "direction_deg,separation_deg,x_mm,y_mm,z_mm\n0,0,0,0,0\n",
            False,
            [
                "direction_deg and separation_deg are for an eccentric robot of one segment; this robot needs "
                "rotation_1_deg to rotation_2_deg"
            ],
        ),
        ("direction_deg,x_mm,y_mm,z_mm\n0,0,0,0\n", True, ["column separation_deg is missing"]),
        (
            "direction_deg,separation_deg,assignment,x_mm,y_mm,z_mm\n0,0,112,0,0,0\n",
            True,
            ["row 1 (line 2), column assignment is '112'; it must be 123, 132, 213, 231, 312 or 321"],
        ),
    ],
)
def test_wrong_files(tmp_path: Path, text: str, eccentric: bool, problems: list[str]) -> None:
    assert refused(tmp_path, text, eccentric) == problems


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"rotations": np.zeros((0, 2))}, "there are no measurements"),
        ({"translations": np.zeros((3, 1))}, "translations have shape"),
        ({"sensors": np.zeros((2, 3))}, r"sensors have shape \(2, 1, 3\)"),
        ({"sensors": np.full((3, 3), np.nan)}, "no sensor saw row 1; every row needs a measured position"),
        ({"sensors": np.full((3, 3), np.inf)}, r"sensors\[0, 0, 0\] is inf"),
        ({"time": np.zeros(2)}, "time has 2 numbers"),
        ({"behind": [-1.0]}, "behind is"),
        ({"orientation": np.zeros((3, 3))}, "orientation has shape"),
        ({"sensor_axis": [0, 0, 0]}, "it must be a direction in space"),
        ({"log": JointLog(np.arange(2.0), np.zeros((2, 2)), np.zeros((2, 2)))}, "needs the time of every row"),
        ({"direction": np.zeros(2)}, "direction has 2 numbers"),
        ({"rotations": "abc"}, "rotations are not an array of numbers"),
        ({"rotations": np.zeros(3)}, "rotations have shape"),
    ],
)
def test_arrays_that_make_no_measurements(change: dict[str, object], problem: str) -> None:
    good = Measurements(np.zeros((3, 2)), np.zeros((3, 2)), np.ones((3, 3)))
    with pytest.raises(InputError, match=problem):
        replace(good, **change)  # type: ignore[arg-type]
