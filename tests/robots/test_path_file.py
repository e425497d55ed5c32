"""Waypoints in CSV: read in the units that the header names, every problem told with its place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tubeopt import ConcentricRobot, InputError, Tube
from tubeopt.robots.file import load_waypoints

ROBOT = ConcentricRobot((Tube(1e-3, 0.8e-3, 0.05, 0.1, 10.0), Tube(1.3e-3, 1.1e-3, 0.05, 0.1, 10.0)))


def waypoints(path: Path, text: str) -> list[list[float]]:
    path.write_text(text, encoding="utf-8")
    points = load_waypoints(path, ROBOT)
    return np.hstack([np.degrees(points.rotations), points.translations * 1e3]).round(12).tolist()


def test_columns_in_any_order_with_blanks_comments_and_a_byte_order_mark(tmp_path: Path) -> None:
    header = "\ufeff# a comment\n translation_2_mm, rotation_2_deg ,rotation_1_deg,translation_1_mm\n\n"
    text = f"{header}1e1,-90, 360,0.1\n1,2,3,4\n"
    assert waypoints(tmp_path / "path.csv", text) == [[360, -90, 0.1, 10], [3, 2, 4, 1]]


def test_without_translations_at_home(tmp_path: Path) -> None:
    assert waypoints(tmp_path / "path.csv", "rotation_1_deg,rotation_2_deg\n1,2\n") == [[1, 2, 0, 0]]


@pytest.mark.parametrize(
    ("text", "problems"),
    [
        (
            "rotation_1_deg,rotaton_2_deg\n1,2\n",
            [
                "column rotaton_2_deg is not known; columns are rotation_1_deg to rotation_2_deg and translation_1_mm "
                "to translation_2_mm; did you mean 'rotation_2_deg'?",
                "column rotation_2_deg is missing",
            ],
        ),
        (
            "rotation_1_deg,rotation_2_deg,translation_1_mm\n1,2,3\n",
            ["column translation_2_mm is missing; it must be there since translation_1_mm is"],
        ),
        (
            "rotation_1_deg,rotation_2_deg\n1,x\n\n2,3\n,nan\n",
            [
                "row 1 (line 2), column rotation_2_deg is 'x'; it must be a number",
                "row 3 (line 5), column rotation_1_deg is empty; it must be a number",
                "row 3 (line 5), column rotation_2_deg is NaN; it must be a finite number",
            ],
        ),
        ("rotation_1_deg,rotation_2_deg\n1,2,3\n", ["row 1 (line 2) has 3 cells; the header names 2 columns"]),
        ("rotation_1_deg,rotation_1_deg\n1,2\n", ["column rotation_1_deg is given twice"]),
        ("rotation_1_deg,rotation_2_deg\n", ["there are no rows below the header"]),
        ("", ["the file is empty; its first line must name the columns"]),
    ],
)
def test_each_problem_has_its_place(tmp_path: Path, text: str, problems: list[str]) -> None:
    path = tmp_path / "path.csv"
    with pytest.raises(InputError) as caught:
        waypoints(path, text)
    assert sorted(str(caught.value).splitlines()) == sorted(f"{path}: {problem}" for problem in problems)


def test_no_such_file() -> None:
    with pytest.raises(InputError, match=r"^none\.csv: there is no such file$"):
        load_waypoints("none.csv", ROBOT)
