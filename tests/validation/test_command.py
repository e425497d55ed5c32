"""`tubeopt validate`: what it prints, what it saves, and how it fails."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
import pytest

from tubeopt import EccentricRobot, load_robot
from tubeopt.cli.app import main
from tubeopt.runs.measurement_file import load_measurements, save_measurements
from tubeopt.validation import validate

from .laboratory import CONFIGS, ctr, noisy, turned

ROBOT = str(CONFIGS / "robots" / "thesis_etr.yaml")
MEASURED = str(CONFIGS / "experiments" / "synthetic_etr.csv")
COLOUR = re.compile(r"\x1b\[[0-9;]*m")


class Outcome(NamedTuple):
    code: int
    out: str
    err: str


class Run(Protocol):
    def __call__(self, *arguments: str) -> Outcome: ...


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run the program with these arguments."""
    monkeypatch.setenv("COLUMNS", "160")

    def run_main(*arguments: str) -> Outcome:
        with pytest.raises(SystemExit) as exit_:
            main(list(arguments))
        out, err = (COLOUR.sub("", stream) for stream in capsys.readouterr())
        code = exit_.value.code
        assert isinstance(code, int)
        return Outcome(code, out, err)

    return run_main


def test_a_comparison(run: Run, tmp_path: Path) -> None:
    outcome = run("validate", ROBOT, MEASURED, "--json", "--out", str(tmp_path))
    assert (outcome.code, outcome.err) == (0, "")
    data = json.loads(outcome.out)
    names = ["report.json", "residuals.csv", "residuals.png", "errors.png"]
    assert data["files"] == [str(tmp_path / name) for name in names]
    assert {path.name for path in tmp_path.iterdir()} == set(names)
    robot = load_robot(ROBOT)
    result = validate(robot, load_measurements(MEASURED, robot))
    assert data["error"]["mean_mm"] == pytest.approx(result.summary.mean * 1e3)
    assert data["error"]["max_percent"] == pytest.approx(result.summary.max / 94e-3 * 100)
    assert [group["direction_deg"] for group in data["by_direction"]] == pytest.approx(list(range(0, 360, 30)))
    assert [group["separation_deg"] for group in data["by_separation"]] == pytest.approx([0, 30, 60, 90])
    assert data["registration"]["tilt_deg"] == pytest.approx(9.43, abs=0.3)  # what the file's header tells
    assert json.loads((tmp_path / "report.json").read_text()) == {
        k: v for k, v in data.items() if k not in ("files", "warnings")
    }
    lines = (tmp_path / "residuals.csv").read_text().splitlines()[1:]
    errors = [float(row["error_mm"]) for row in csv.DictReader(lines)]
    np.testing.assert_allclose(errors, result.errors * 1e3, atol=1e-6)


def test_the_example_of_the_help_works(run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "configs").symlink_to(CONFIGS)
    monkeypatch.chdir(tmp_path)
    text = " ".join(run("validate", "--help").out.split())
    outcome = run(*text.split("Example: tubeopt ")[1].split(), "--folds", "0")
    assert outcome.code == 0
    assert "curvature" in outcome.out


def test_a_comparison_as_a_table(run: Run) -> None:
    outcome = run("validate", ROBOT, MEASURED)
    assert outcome.code == 0
    for part in ("thesis ETR", "48 configurations, 3 sensors, averaged", "rigid: yaw", "worst direction", "94.0 mm"):
        assert part in outcome.out


def test_a_fit_writes_the_calibrated_robot(run: Run, tmp_path: Path) -> None:
    outcome = run(
        "validate", ROBOT, MEASURED, "--fit", "curvature, rotation_2,rotation_3", "--folds", "2", "--out", str(tmp_path)
    )
    assert outcome.code == 0
    for part in (
        "tip error before",
        "after the fit",
        "held out",
        "95 % interval",
        "their offsets, gains and latency go into robot.yaml",
    ):
        assert part in outcome.out
    record = json.loads((tmp_path / "report.json").read_text())
    curvature, turn, _ = record["estimates"]
    assert curvature["low"] < 0.96 < curvature["high"]
    assert turn["name"] == "rotation_2"
    assert {"start_deg", "value_deg", "standard_error_deg", "low_deg", "high_deg"} < set(turn)
    assert record["after"]["error"]["rms_mm"] < record["held_out"]["rms_mm"] < record["before"]["error"]["rms_mm"]
    robot = load_robot(tmp_path / "robot.yaml")
    assert isinstance(robot, EccentricRobot)
    assert robot.tube.curvature * 0.12 == pytest.approx(curvature["value"])
    assert "held_out_error_mm" in (tmp_path / "residuals.csv").read_text()


@pytest.mark.parametrize("flags", [[], ["--fit", "curvature", "--folds", "0"]])
def test_without_a_registration_none_is_reported(run: Run, flags: list[str], tmp_path: Path) -> None:
    ctr().save(tmp_path / "robot.yaml")
    save_measurements(turned(ctr(), 6), tmp_path / "m.csv")
    where = [str(tmp_path / name) for name in ("robot.yaml", "m.csv")]
    text = " ".join(run("validate", *where, "--registration", "none", "--out", str(tmp_path), *flags).out.split())
    assert "registration none: the device's frame is the plate's" in text
    assert "yaw" not in text


def test_what_was_noticed_in_the_file_is_printed_without_a_fit(run: Run, tmp_path: Path) -> None:
    ctr().save(tmp_path / "robot.yaml")
    m = turned(ctr(), 6)
    save_measurements(replace(m, sensors=1e-3 * m.sensors), tmp_path / "m.csv")
    outcome = run("validate", str(tmp_path / "robot.yaml"), str(tmp_path / "m.csv"))
    assert outcome.code == 0
    assert "remark: the tips lie within" in outcome.out
    assert "Are positions in m in columns for mm" in " ".join(outcome.out.split())


def test_a_concentric_robot_from_a_known_base(run: Run, tmp_path: Path) -> None:
    ctr().save(tmp_path / "robot.yaml")
    save_measurements(noisy(turned(ctr(), 6), 1), tmp_path / "m.csv")
    where = [str(tmp_path / name) for name in ("robot.yaml", "m.csv")]
    data = json.loads(run("validate", *where, "--json", "--out", str(tmp_path / "out")).out)
    assert data["by_direction"] == []
    assert (tmp_path / "out" / "errors.png").exists()
    base = ["--registration", "base-axis", "--base-position-mm", "120,-35,210", "--base-axis", "0,0,-1"]
    outcome = run("validate", *where, *base, "--json")
    assert json.loads(outcome.out)["registration"]["tilt_deg"] == pytest.approx(180)


def test_a_study(run: Run, tmp_path: Path) -> None:
    study = tmp_path / "study.yaml"
    study.write_text(f"kind: validation\nrobot: {ROBOT}\nmeasurements: {MEASURED}\nfit: [curvature]\nfolds: 0\n")
    data = json.loads(run("run", str(study), "--json").out)
    assert data["held_out"] is None
    assert [e["name"] for e in data["estimates"]] == ["curvature"]


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ((ROBOT, "none.csv"), "none.csv: there is no such file"),
        (
            (ROBOT, MEASURED, "--registration", "rigd"),
            "--registration is 'rigd'; it must be rigid, base-axis, none or saved",
        ),
        ((ROBOT, MEASURED, "--fit", "curvatur"), "parameter 'curvatur' is not known; did you mean 'curvature'"),
        ((ROBOT, MEASURED, "--fit", "nu", "--folds", "1.5"), "--folds is 1.5; it must be a whole number"),
        ((ROBOT, MEASURED, "--fit", "nu", "--folds", "1"), "--folds is 1; it must be 0, or at least 2"),
        ((ROBOT, MEASURED, "--base-axis", "0,0,1"), "are for registration base-axis only"),
        ((ROBOT, MEASURED, "--registration", "base-axis", "--base-axis", "0,0,0"), "--base-axis is (0, 0, 0)"),
        (
            (ROBOT, MEASURED, "--registration", "base-axis", "--base-axis", "0,0"),
            "--base-axis has 2 numbers; it must have 3",
        ),
    ],
)
def test_wrong_arguments(run: Run, arguments: tuple[str, ...], problem: str) -> None:
    outcome = run("validate", *arguments)
    assert (outcome.code, outcome.out) == (2, "")
    assert problem in outcome.err
    assert "Traceback" not in outcome.err
