"""Units that were probably mistaken are told with what was meant."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.command_line import ROOT, THESIS, Run, answer
from tubeopt import (
    ConcentricRobot,
    Friction,
    InputError,
    Load,
    Material,
    Piece,
    PlanOptions,
    RateLimits,
    Thermocouple,
    Tube,
    load_rig,
    load_robot,
)
from tubeopt.bodies.corridors import Corridor
from tubeopt.bodies.obstacles import Sphere
from tubeopt.design.requirements import Strain
from tubeopt.equilibrium.problem import check_load
from tubeopt.errors import ImplausibleWarning, without_unit_warnings
from tubeopt.files.checked import check
from tubeopt.files.fields import EntryOf
from tubeopt.robots.robot import resized
from tubeopt.runs.inverse_study import InverseStudy
from tubeopt.runs.surroundings_file import load_obstacles
from tubeopt.shaping.heating.rig import Circuit, Clamps, MoldBed
from tubeopt.shaping.mold.spec import EndMill

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
    output = warned(caplog, written(tmp_path / "x.yaml", f"material: {material}", curvature_per_m=curvature))
    assert len(output) == 1
    assert re.search(words, output[0])


def test_key_in_other_unit_is_reported_with_factor(tmp_path: Path) -> None:
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
    text = ["battery.capacity_Ah is 60000; that would be usual in mAh: was 60 meant?"]
    assert told(caplog, tmp_path / "x.yaml", rig.replace("capacity_Ah: 60", "capacity_Ah: 60000"), load_rig) == text
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
    caplog.clear()
    assert told(caplog, tmp_path / "y.yaml", f"{robot}[{{table: v.csv}}]}}]", load_robot) == []
    assert load_robot(tmp_path / "y.yaml").tubes[0].length == pytest.approx(0.26, rel=1e-15)


def _tube(curvature: float = 10.7, **more: float) -> Tube:
    return Tube(1.92e-3, 1.57e-3, 0.2, 0.06, curvature, **more)


def loaded(**load: Any) -> None:
    check_load(ConcentricRobot((_tube(0.0),)), Load(**load), (0.0,))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: RateLimits(rotation=90), "rotation of the rate limits is 90 rad/s; .*: was 90 deg/s meant"),
        (lambda: RateLimits(rotation=(1.0, 90.0)), "rotation of the rate limits is 90 rad/s"),
        (lambda: RateLimits(translation=20), "translation of the rate limits is 20 m/s; .*: was 20 mm/s meant"),
        (lambda: RateLimits(rotation_acceleration=180), "is 180 rad/s²; .*: was 180 deg/s² meant"),
        (lambda: RateLimits(translation_acceleration=40), "is 40 m/s²; .*: was 40 mm/s² meant"),
        (lambda: RateLimits(tip=50), "tip of the rate limits is 50 m/s; .*: was 50 mm/s meant"),
        (lambda: ConcentricRobot((_tube(0.012),)), "curvature is 0.012 1/m; .*: was 0.012 1/mm meant"),
        (lambda: ConcentricRobot((_tube(mass_per_length=8.0),)), "mass_per_length is 8 kg/m; .*: was 8 g/m meant"),
        (
            lambda: ConcentricRobot((Tube.of_pieces(1e-3, 8e-4, [Piece(60.0, 5.0), Piece(0.1, 4.0)]),)),
            "curved_length is 60.1 m; .*: was 60.1 mm meant",
        ),
        (
            lambda: ConcentricRobot((Tube.of_pieces(1e-3, 8e-4, [Piece(0.1, (0, 0, 1500.0))]),)),
            "twist of piece 1 is 1500 rad/m; usual is",
        ),
        (lambda: Friction(torque=5.0), "torque of friction is 5 N m/m; .*: was 5 mN m/m meant"),
        (lambda: Material("a metal", 58e9, 21.5e9, working_strain=1.0), "working_strain .* is 1; .*: was 1 % meant"),
        (lambda: PlanOptions(clearance=2.0), "clearance is 2 m; .*: was 2 mm meant"),
        (lambda: PlanOptions(carriage_gap=5.0), "carriage_gap is 5 m; .*: was 5 mm meant"),
        (lambda: Sphere((0.0, 0.0, 50.0), 5e-3), "centre of the sphere is 50 m; .*: was 50 mm meant"),
        (lambda: Sphere((0.0, 0.0, 0.05), 5.0), "radius of the sphere is 5 m; .*: was 5 mm meant"),
        (lambda: Corridor(((0, 0, 0), (0, 0, 60)), 5e-3), "a point of the corridor is 60 m; .*: was 60 mm meant"),
        (lambda: Strain(limits=(2.0,)), "limits of the strain is 2; .*: was 2 % meant"),
        (lambda: Circuit(cable_resistance=5.0), "cable_resistance of the circuit is 5 ohm; .*: was 5 mohm meant"),
        (lambda: Clamps(mass=50.0), "mass of the clamps is 50 kg; .*: was 50 g meant"),
        (lambda: MoldBed(lead=1.5), "lead of the mold is 1.5 m; .*: was 1.5 mm meant"),
        (lambda: Thermocouple(lag=300.0), "lag of the thermocouple is 300 s; .*: was 300 ms meant"),
        (lambda: EndMill(1.5), "diameter of an end mill is 1.5 m; .*: was 1.5 mm meant"),
        (
            lambda: loaded(distributed=(3000.0, 0.0, 0.0)),
            r"distributed\[0\] of the load has 180 N; .*: was 180 mN",
        ),
        (
            lambda: loaded(distributed=((0.0, 0.06, (3000.0, 0.0, 0.0)),)),
            r"distributed\[0\] of the load has 180 N",
        ),
        (lambda: loaded(moment=(5.0, 0.0, 0.0)), "tip moment of the load has 5 N m; .*: was 5 mN m meant"),
    ],
)
def test_numbers_typed_in_python_in_another_unit(call: Callable[[], object], words: str) -> None:
    with pytest.warns(ImplausibleWarning, match=words):
        call()


def test_rates_and_bodies_in_another_unit_in_a_file(caplog: pytest.LogCaptureFixture, tmp_path: Path) -> None:
    """Once for a key, in its unit: what is made of the file says nothing more."""
    text = "obstacles: [{centre_mm: [0, 0, 0.05], radius_mm: 5e3}]"
    assert told(caplog, tmp_path / "x.yaml", text, load_obstacles) == [
        "obstacles[0].radius_mm is 5E+3; that would be usual in um: was 5 meant?"
    ]
    caplog.clear()
    with caplog.at_level(logging.WARNING, "tubeopt"):
        check(EntryOf[RateLimits], {"rotation_deg_per_s": 1.5, "translation_mm_per_s": 0.02}, "").build()
    assert [record.getMessage() for record in caplog.records] == [
        "rotation_deg_per_s is 1.5; that would be usual in rad/s: was 85.9437 meant?",
        "translation_mm_per_s is 0.02; that would be usual in m/s: was 20 meant?",
    ]


def test_numbers_that_nobody_typed_are_not_doubted() -> None:
    robot = load_robot(THESIS)
    resized(robot, 0, "curvature", 0.02)
    with without_unit_warnings():
        replace(robot, tubes=tuple(replace(tube, curvature=0.02) for tube in robot.tubes))
    with pytest.warns(ImplausibleWarning, match="curvature is 0.02"):
        replace(robot, tubes=tuple(replace(tube, curvature=0.02) for tube in robot.tubes))
