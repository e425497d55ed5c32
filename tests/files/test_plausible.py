"""Units that were probably mistaken are told with what was meant."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.command_line import ROOT, THESIS, Run, answer
from tubeopt import InputError, load_rig, load_robot
from tubeopt.runs.inverse_study import InverseStudy

TUBE = {
    "outer_diameter_mm": "1.92",
    "inner_diameter_mm": "1.57",
    "straight_length_mm": "200",
    "curved_length_mm": "60",
    "curvature_per_m": "10.7",
}
RIG = ROOT / "configs/rigs/thesis_mdf.yaml"
METAL = "material: {name: a metal, youngs_modulus_GPa: %s, poisson_ratio: 0.3}"


def written(path: Path, more: str = "", **changes: str) -> Path:
    keys = ", ".join([*(f"{key}: {value}" for key, value in (TUBE | changes).items()), *([more] if more else [])])
    path.write_text(f"kind: concentric\ntubes: [{{{keys}}}]\n")
    return path


def warned(caplog: pytest.LogCaptureFixture, path: Path) -> list[str]:
    with caplog.at_level(logging.WARNING, "tubeopt"):
        load_robot(path)
    return [record.getMessage().removeprefix(f"{path}: tubes[0].") for record in caplog.records]


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("outer_diameter_mm", "0.00192", "is 0.00192; that would be usual in m: was 1.92 meant?"),
        ("straight_length_mm", "0.2", "is 0.2; that would be usual in m: was 200 meant?"),
        ("curved_length_mm", "6e4", "is 6E+4; that would be usual in um: was 60 meant?"),
        ("curvature_per_m", "-0.0107", "is -0.0107; that would be usual in 1/mm: was -10.7 meant?"),
    ],
)
def test_a_number_in_another_unit(
    caplog: pytest.LogCaptureFixture, tmp_path: Path, key: str, value: str, words: str
) -> None:
    changes = {key: value} | ({"inner_diameter_mm": "0"} if key == "outer_diameter_mm" else {})
    if key == "outer_diameter_mm":
        changes["curvature_per_m"] = "0"
    assert warned(caplog, written(tmp_path / "x.yaml", **changes)) == [f"{key} {words}"]


@pytest.mark.parametrize(
    ("modulus", "words"),
    [
        ("58e9", "is 5.8E+10; that would be usual in Pa: was 58 meant?"),
        ("58000", "is 58000; that would be usual in MPa: was 58 meant?"),
        ("0.05", "is 0.05; usual is 0.1 to 500"),
    ],
)
def test_a_modulus_that_no_metal_has(
    caplog: pytest.LogCaptureFixture, tmp_path: Path, modulus: str, words: str
) -> None:
    assert warned(caplog, written(tmp_path / "x.yaml", METAL % modulus)) == [f"material.youngs_modulus_GPa {words}"]


@pytest.mark.parametrize("path", sorted((ROOT / "configs").glob("robots/*.yaml")), ids=lambda path: path.stem)
def test_published_robots_are_usual(caplog: pytest.LogCaptureFixture, path: Path) -> None:
    assert not warned(caplog, path)


@pytest.mark.parametrize(
    ("material", "curvature", "words"),
    [
        (
            "{name: nitinol of a maker, youngs_modulus_GPa: 1.5, poisson_ratio: 0.3}",
            "10.7",
            "youngs_modulus .* 1.5e.09 Pa",
        ),
        ("nitinol", "107", "curvature is 107 per m, which strains the tube by 11.4 % .*; nitinol .* at most 10 %"),
    ],
)
def test_a_file_is_warned_of_what_its_material_does_not_do(
    caplog: pytest.LogCaptureFixture, tmp_path: Path, material: str, curvature: str, words: str
) -> None:
    said = warned(caplog, written(tmp_path / "x.yaml", f"material: {material}", curvature_per_m=curvature))
    assert len(said) == 1
    assert re.search(words, said[0])


def test_a_key_in_another_unit_is_told_with_the_factor(tmp_path: Path) -> None:
    path = written(tmp_path / "x.yaml", "curvature_per_mm: 0.0107")
    with pytest.raises(InputError) as caught:
        load_robot(path)
    assert str(caught.value) == (
        f"{path}: tubes[0].curvature_per_mm is not a known key; did you mean 'curvature_per_m', 1000 times the number?"
    )


def test_a_target_in_metres(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise InputError("not now")

    monkeypatch.setattr(InverseStudy, "run", refuse)
    data = answer(run("ik", THESIS, "--target-mm", "0.05,0.03,0.15", "--json"), 2)
    assert data["warnings"] == ["--target-mm is [0.05, 0.03, 0.15]; that would be usual in m: was 50, 30, 150 meant?"]


def test_names_of_materials_in_upper_case(tmp_path: Path) -> None:
    plain = load_robot(written(tmp_path / "x.yaml"))
    assert load_robot(written(tmp_path / "x.yaml", "material: Nitinol")) == plain


def told(caplog: pytest.LogCaptureFixture, path: Path, text: str, load: Callable[[Path], object]) -> list[str]:
    path.write_text(text)
    with caplog.at_level(logging.WARNING, "tubeopt"):
        load(path)
    return [record.getMessage().removeprefix(f"{path}: ") for record in caplog.records]


def test_a_window_in_kelvin_is_refused_in_one_sentence(run: Run) -> None:
    for window, hint in (("773.15,823.15", "; if these are K, give 500 to 550 degC"), ("500,850", "")):
        data = answer(run("heat", "plan", str(RIG), "--window-degC", window, "--json"), 2)
        assert "warnings" not in data or not data["warnings"]
        assert data["error"]["messages"][0].endswith(f"nitinol: it is annealed there and springs back no more{hint}")


def test_a_battery_in_milliampere_hours(caplog: pytest.LogCaptureFixture, tmp_path: Path) -> None:
    rig = (RIG).read_text()
    words = ["battery.capacity_Ah is 60000; that would be usual in mAh: was 60 meant?"]
    assert told(caplog, tmp_path / "x.yaml", rig.replace("capacity_Ah: 60", "capacity_Ah: 60000"), load_rig) == words
    wrong = tmp_path / "y.yaml"
    wrong.write_text(rig.replace("capacity_Ah: 60", "capacity_mAh: 60000"))
    with pytest.raises(InputError, match=r"did you mean 'capacity_Ah', 0[.]001 times the number"):
        load_rig(wrong)


def test_a_table_of_a_piece_in_metres(caplog: pytest.LogCaptureFixture, tmp_path: Path) -> None:
    (tmp_path / "u.csv").write_text("arc_length_mm,curvature_x_per_m,curvature_y_per_m\n0,0,0\n0.03,9,1\n0.06,9,0\n")
    robot = (
        "kind: concentric\ntubes: [{outer_diameter_mm: 1.92, inner_diameter_mm: 1.57, straight_length_mm: 200, pieces: "
    )
    assert told(caplog, tmp_path / "x.yaml", f"{robot}[{{table: u.csv}}]}}]", load_robot) == [
        f"{tmp_path}/u.csv: the last arc_length_mm is 0.06; that would be usual in m: was 60 meant?"
    ]
    (tmp_path / "v.csv").write_text("arc_length_m,curvature_x_per_m,curvature_y_per_m\n0,0,0\n0.03,9,1\n0.06,9,0\n")
    with pytest.raises(InputError, match="arc_length_m is not known; did you mean 'arc_length_mm', 1000 times"):
        told(caplog, tmp_path / "y.yaml", f"{robot}[{{table: v.csv}}]}}]", load_robot)
