"""Passport of a tube: what commands append to it, and the radius that a robot file takes from it."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from tubeopt import InputError, load_robot
from tubeopt.cli.app import main
from tubeopt.robots.passport import PASSPORT_FILE, begin_passport, continue_passport, load_passport
from tubeopt.runs.heating_run import HeatingRun
from tubeopt.shaping.mold.springback import calibrate_springback
from tubeopt.show.fabrication_report import CalibrationReport
from tubeopt.show.heat_report import HeatingRunReport

CONFIGS = Path(__file__).parents[2] / "configs"
ROBOT = """kind: concentric
tubes:
  - {outer_diameter_mm: 1.0, inner_diameter_mm: 0.8, straight_length_mm: 50, curved_length_mm: 60, curvature_per_m: -10,
     passport: tube_1/passport.yaml}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Folder of a tube of 100 mm, as `fabricate` leaves it."""
    begin_passport(tmp_path / "tube_1", robot="mine", tube=1, drawn_radius=0.1, mold_radius=0.09)
    return tmp_path / "tube_1"


def test_a_robot_file_takes_the_measured_radius(folder: Path) -> None:
    path = folder.parent / "robot.yaml"
    path.write_text(ROBOT, encoding="utf-8")
    assert load_robot(path).tubes[0].curvature == pytest.approx(-10)
    assert load_passport(folder / PASSPORT_FILE).measured is None
    for radius, error in ((0.104, 1e-3), (0.101, 0.5e-3)):
        continue_passport(folder, "measurements", source="scan.png", radius_mm=radius, error_mm=error)
    # Weights 1 to 4: the second measurement is twice as sure.
    assert load_robot(path).tubes[0].curvature == pytest.approx(-1 / 0.1016, rel=1e-6)
    measured = load_passport(folder / PASSPORT_FILE).measured
    assert measured is not None
    assert measured.standard_error == pytest.approx(1e-3 / math.sqrt(5))


def test_commands_continue_the_passport_in_their_folder(folder: Path) -> None:
    row = {"state": "holding", "dry": False, "temperature_degC": 521.5, "time_s": 93.0}
    for state, dry in (("holding", False), ("holding", True)):
        HeatingRunReport(HeatingRun(({**row, "state": state, "dry": dry},), "done")).save(folder)
    trials = calibrate_springback(np.array([0.06, 0.08, 0.1]), np.array([0.066, 0.088, 0.11]))
    CalibrationReport(trials).save(folder)
    passport = load_passport(folder / PASSPORT_FILE)
    # A dry run is no heating.
    assert [(h.ended, float(h.lowest_degC or 0), float(h.time_s)) for h in passport.heatings] == [("done", 521.5, 93.0)]
    assert [s.trials for s in passport.springback] == [3]
    assert float(passport.springback[0].lost_percent) == pytest.approx(100 / 11, abs=0.01)


def test_a_new_tube_keeps_the_passports_of_those_before_it(folder: Path) -> None:
    radii = []
    for radius in (0.1, 0.2):
        continue_passport(folder, "measurements", source="scan.png", radius_mm=radius, error_mm=1e-3)
        begin_passport(folder, robot="mine", tube=1, drawn_radius=0.1, mold_radius=0.09)
        radii.append(radius)
    # One that was only begun is replaced.
    begin_passport(folder, robot="mine", tube=1, drawn_radius=0.1, mold_radius=0.08)
    kept = [load_passport(folder / f"passport_{k}.yaml").measured for k in (1, 2)]
    assert [each and each.radius for each in kept] == pytest.approx(radii)
    assert not (folder / "passport_3.yaml").exists()
    begun = load_passport(folder / PASSPORT_FILE)
    assert begun.measured is None
    assert float(begun.mold_radius_mm) == 80


def test_without_a_passport_nothing_is_written(tmp_path: Path) -> None:
    assert continue_passport(tmp_path, "heatings", ended="done", time_s=1.0) == []
    assert not list(tmp_path.iterdir())


def test_an_invalid_passport_is_refused_and_kept(folder: Path) -> None:
    before = (folder / PASSPORT_FILE).read_text(encoding="utf-8")
    with pytest.raises(InputError, match="error_mm"):
        continue_passport(folder, "measurements", radius_mm=0.1, error_mm=0.0)
    assert (folder / PASSPORT_FILE).read_text(encoding="utf-8") == before


def test_fabricate_begins_a_passport_that_validate_and_measure_continue(tmp_path: Path) -> None:
    """By the program itself: from the drawing to the errors of the tip."""
    robot, rig = str(CONFIGS / "robots" / "thesis_etr.yaml"), str(CONFIGS / "rigs" / "thesis_calcium_silicate.yaml")
    fast = "--sensor", "none", "--objective", "time", "--charges-percent", "none"
    # The schedule alone succeeds on few uncertain rigs: the files are written, and the command says so.
    assert _run("fabricate", robot, "--rig", rig, "--out", str(tmp_path), "--samples", "8", *fast) == 3
    folder = tmp_path / "tube_1"
    assert not (folder / "firmware").exists()
    begun = load_passport(folder / PASSPORT_FILE)
    assert (begun.robot, begun.tube) == ("thesis ETR", 1)
    assert [float(begun.drawn_radius_mm), float(begun.mold_radius_mm)] == pytest.approx([120.0, 120.0])
    assert [begun.heatings, begun.measurements, begun.springback, begun.validations] == [[], [], [], []]
    # The robot that is written beside it is the one that was asked for.
    assert load_robot(tmp_path / "robot.yaml").tubes[0].curvature == load_robot(robot).tubes[0].curvature
    measured = str(CONFIGS / "experiments" / "synthetic_etr.csv")
    assert _run("validate", robot, measured, "--out", str(folder)) == 0
    (validation,) = load_passport(folder / PASSPORT_FILE).validations
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert validation.configurations == report["count"] == 48
    assert float(validation.mean_error_mm) == pytest.approx(report["error"]["mean_mm"], rel=1e-3)
    # A folder without a passport gets none.
    assert _run("validate", robot, measured, "--out", str(tmp_path / "elsewhere")) == 0
    assert not (tmp_path / "elsewhere" / PASSPORT_FILE).exists()


def _run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(list(arguments))
    assert isinstance(ended.value.code, int)
    return ended.value.code
