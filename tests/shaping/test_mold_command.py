"""`tubeopt mold`: what it prints, what it writes, what it refuses."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import pytest

from tests.command_line import ROOT, THESIS, Run, answer, refused
from tubeopt import ConcentricRobot, MoldSpec, Tube, load_robot, save_robot
from tubeopt.runs.workshop_file import load_mold_spec, mold_spec_from_dict
from tubeopt.shaping.mold.ranking import rank_mold_materials

ETR = str(ROOT / "configs" / "robots" / "thesis_etr.yaml")
MOLD = str(ROOT / "configs" / "molds" / "calcium_silicate.yaml")
TRIALS = str(ROOT / "configs" / "molds" / "example_trials.csv")


def test_the_file_of_the_repository_is_the_default() -> None:
    assert load_mold_spec(MOLD) == MoldSpec() == mold_spec_from_dict({"kind": "mold"})


def test_plan_saves_all_files(run: Run, tmp_path: Path) -> None:
    out = answer(run("mold", ETR, "--mold", MOLD, "--out", str(tmp_path), "--json"))
    names = {Path(path).name for path in out["files"]}
    assert names == {path.name for path in tmp_path.iterdir()}
    assert names == {"mold.json", "setup.pdf", "base_holes.pdf", "lid_holes.pdf", "mold.png", "lid_5.nc"} | {
        f"{part}{kind}"
        for part in ("base", "lid")
        for kind in (".dxf", ".svg", ".stl", "_1.nc", "_2.nc", "_3.nc", "_4.nc")
    }
    assert [program["tool"] for program in out["programs"]] == [
        *("end mill 2 mm", "drill 2.8 mm", "drill 5.5 mm", "end mill 4 mm"),
        *("end mill 0.4 mm", "drill 1.5 mm", "drill 2.8 mm", "drill 5.5 mm", "end mill 4 mm"),
    ]
    (groove,) = out["grooves"]
    assert groove["mold_radius_mm"] == pytest.approx(120)
    assert groove["bend_length_mm"] == pytest.approx(94)
    assert groove["predicted"]["curvature_per_m"] == pytest.approx(1 / 0.12)
    assert all(check["passed"] for check in out["checks"])
    assert "tube 2 is equal to tube 1 and is set in its groove" in out["remarks"]
    assert json.loads((tmp_path / "mold.json").read_text())["size_mm"] == out["size_mm"] == [155, 50]


def test_plan_and_its_short_form_say_the_same(run: Run) -> None:
    flags = ("--tubes", "1,3", "--material", "glass_mica", "--cold-length-mm", "30")
    out = answer(run("mold", "plan", THESIS, *flags, "--json"))
    assert out == answer(run("mold", THESIS, *flags, "--json"))
    assert [groove["tube"] for groove in out["grooves"]] == [1, 3]
    assert [groove["cold_length_mm"] for groove in out["grooves"]] == [30, 30]
    assert out["material"] == "glass_mica"
    shown = run("mold", THESIS, *flags)
    assert "length of the tube blank (mm)" in shown.out
    assert "remark: the spring-back is not calibrated" in shown.out


def test_calibration_feeds_the_plan(run: Run, tmp_path: Path) -> None:
    fit = answer(run("mold", "calibrate", TRIALS, "--out", str(tmp_path), "--json"))
    assert fit["model"] == "constant"
    lost = [1 - t["mold_radius_mm"] / t["obtained_radius_mm"] for t in fit["trials"]]
    assert fit["fraction_percent"] == pytest.approx(100 * sum(lost) / len(lost))
    low, high = fit["fraction_interval_percent"]
    assert low < fit["fraction_percent"] < high
    back = str(tmp_path / "springback.yaml")
    plan = answer(run("mold", ETR, "--springback", back, "--json"))
    assert plan["grooves"][0]["mold_radius_mm"] == pytest.approx(120 * (1 - fit["fraction_percent"] / 100))
    assert "constant" in run("mold", "calibrate", TRIALS).out


def test_materials(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # The same question has the same answer: it is computed once.
    monkeypatch.setattr("tubeopt.runs.mold_study.rank_mold_materials", cache(rank_mold_materials))
    out = answer(run("mold", "materials", "--out", str(tmp_path), "--json"))
    assert [m["material"] for m in out["materials"]] == ["calcium_silicate", "mdf", "glass_mica", "steel"]
    assert [m["suitable"] for m in out["materials"]] == [True, False, False, False]
    assert out["outer_diameter_mm"] == pytest.approx(load_robot(ETR).tubes[0].outer_diameter * 1e3)
    other = answer(run("mold", "materials", THESIS, "--tube", "2", "--hold-s", "5", "--json"))
    assert other["outer_diameter_mm"] == pytest.approx(load_robot(THESIS).tubes[1].outer_diameter * 1e3)
    assert other["materials"][0]["heat_drawn_J_per_m"] < out["materials"][0]["heat_drawn_J_per_m"]
    shown = run("mold", "materials").out
    assert "mdf: chars above 300 degC" in shown
    page = (ROOT / "docs" / "mold.md").read_text(encoding="utf-8")
    _, table = page.split("    tubeopt mold materials\n")[1].split("```text\n", 1)
    lines = [line.rstrip() for line in shown.splitlines()]
    assert table.split("```")[0].splitlines() == lines[1:7]


def test_every_key_of_a_mold_file() -> None:
    spec = mold_spec_from_dict(
        {
            "kind": "mold",
            "material": {
                "name": "board",
                "conductivity_W_per_m_K": 0.2,
                "density_kg_per_m3": 900,
                "heat_capacity_J_per_kg_K": 1000,
                "limit_degC": 800,
                "resistivity_ohm_m": 1e6,
                "source": "its sheet",
            },
            "springback": {
                "fraction_percent": 8,
                "slope_mm": 1,
                "shrinkage_percent": 0.5,
                "radius_range_mm": [60, 120],
            },
            "cold_length_mm": 25,
            "most_strain_percent": 5,
            "plate": {"size_mm": [200, 80], "thickness_mm": 15},
            "milling": {"end_mills": [{"diameter_mm": 2, "flute_length_mm": 8}], "feed_mm_per_min": 600},
            "workshop": {"dialect": "mach", "touch_plate_mm": 12, "outline_diameter_mm": 6, "cut_out": False},
            "clamps": {"sliding_end": "proximal", "travel_factor": 2},
            "vents": {"open_percent": [10, 0, 20]},
            "heat": {"set_degC": 510, "clamp_degC": 60, "contact_conductance_W_per_m2_K": 500},
        }
    )
    assert spec.material.name == "board"
    assert (spec.workshop.touch_plate, spec.workshop.outline_diameter, spec.workshop.cut_out) == (12e-3, 6e-3, False)
    assert spec.material.limit_temperature == pytest.approx(1073.15)
    assert (spec.springback.fraction, spec.springback.slope) == (0.08, 1e-3)
    assert spec.springback.curvature_range == pytest.approx((1 / 0.12, 1 / 0.06))
    assert (spec.cold_length, spec.most_strain, spec.plate.size) == (0.025, 0.05, (0.2, 0.08))
    assert spec.milling.end_mills[0].reach == 8e-3
    assert spec.milling.feed == pytest.approx(0.01)
    assert spec.vents.profile == (0.1, 0.0, 0.2)
    assert spec.heat.clamps == pytest.approx(333.15)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("mold", ETR, "--tubes", "1-2"), "--tubes[0] is '1-2'; it must be a number"),
        (("mold", ETR, "--tubes", "4"), "tubes has 4; it must be numbers of tubes, from 1 to 3"),
        (("mold", ETR, "--material", "stel"), "mold material is 'stel'; it must be one of steel, mdf, glass_mica"),
        (("mold", ETR, "--cold-length-mm", "-3"), "--cold-length-mm is -3; it must be at least 0"),
        (("mold", "nowhere.yaml"), "nowhere.yaml: there is no such file"),
        (("mold", "calibrate", "nowhere.csv"), "nowhere.csv: there is no such file"),
        (
            ("mold", "calibrate", TRIALS, "--model", "cubic"),
            "--model is 'cubic'; it must be auto, constant or linear",
        ),
        (("mold", "materials", THESIS, "--tube", "9"), "--tube is 9; it must be 1 to 3"),
        (("mold", "materials", "--hold-s", "0"), "--hold-s is 0; it must be greater than 0"),
        (("mold", "materials", "--set-degC", "10"), "set_temperature is 10 degC; it must be above the ambient (20"),
    ],
)
def test_bad_flags_are_refused(run: Run, arguments: tuple[str, ...], said: str) -> None:
    (line,) = refused(run(*arguments))
    assert said in line


def test_bad_files_are_refused(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "mold.yaml"
    path.write_text("kind: mold\nplate: {thicknes_mm: 3}\nclamps: {sliding_end: left}\nvents: {open_percent: [120]}\n")
    lines = refused(run("mold", ETR, "--mold", str(path)))
    assert len(lines) == 3
    assert "plate.thicknes_mm is not a known key; did you mean 'thickness_mm'?" in lines[0]
    assert "it must be proximal or distal" in lines[1]
    assert "profile of the vents has 1.2" in lines[2]
    path.write_text("kind: mold\nplate: {thickness_mm: 5}\n")
    assert refused(run("mold", ETR, "--mold", str(path)))[0].startswith("the plate is too thin")


def test_a_straight_robot_needs_no_mold(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "straight.yaml"
    save_robot(ConcentricRobot((Tube(1e-3, 0.8e-3, 0.05, 0.0, 0.0),)), path)
    assert refused(run("mold", str(path))) == ["no tube of this robot is curved; none needs a mold"]


def test_help(run: Run) -> None:
    for command in ((), ("plan",), ("calibrate",), ("materials",)):
        shown = run("mold", *command, "--help")
        assert shown.code == 0
        assert "Example: tubeopt mold" in shown.out or not command
