"""`tubeopt commission`: what it finds, saves and prints, how it continues, and how it asks."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tubeopt import load_robot
from tubeopt.cli.app import main
from tubeopt.robots.file import save_robot
from tubeopt.runs.measurement_file import load_measurements

from ..validation.drives import RATE, joints, poses, robot, trivial
from ..validation.laboratory import MM


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as ending:
        main(["commission", *arguments])
    assert isinstance(ending.value.code, int)
    return ending.value.code


def write_log(directory: Path, *, still: bool = False) -> tuple[str, str]:
    """Files of a robot and of a log whose second motor counts backward, in degrees from 70; tips come 0.1 s late."""
    time = np.arange(160) / RATE
    now, late = joints(time, time[-1]), joints(time - 0.1, time[-1])
    if still:
        now[:, 0] = late[:, 0] = 0.0
    tips = poses(robot(), trivial(), late).position[:, 0] @ Rotation.random(random_state=4).as_matrix().T
    tips += np.random.default_rng(1).normal(0, 0.3 * MM, tips.shape)
    turned = np.degrees(now[:, :2]) * [1, -1] + [0, 70]
    rows = np.column_stack([time, turned, now[:, 2:] / MM, tips / MM])
    text = "\n".join(
        ["t,motor_1,motor_2,slide_1,slide_2,x,y,z", *(",".join(map("{:.6g}".format, row)) for row in rows)]
    )
    (directory / "log.csv").write_text(text + "\n")
    save_robot(robot(), directory / "robot.yaml")
    return str(directory / "robot.yaml"), str(directory / "log.csv")


def test_a_log_becomes_a_robot_and_a_servo(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files, out = write_log(tmp_path), tmp_path / "out"
    command = (*files, "--effects", "latency,translation", "--count", "6", "--json", "--out", str(out))
    assert run(*command) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["logs"][0]["columns"]["motor_1"] == "rotation_1, deg"
    zero = re.fullmatch(r"-1 \* motor_2 \+ ([\d.]+), deg", data["logs"][0]["formulas"]["rotation_2"])
    assert zero is not None
    assert float(zero[1]) == pytest.approx(70.0, abs=2.0)
    assert all(decision["certain"] for decision in data["logs"][0]["decisions"])
    (latency,) = (e for e in data["comparison"]["fit"]["estimates"] if e["name"] == "latency")
    assert latency["posterior_low_s"] < 0.1 < latency["posterior_high_s"]
    assert data["held_out_rms_mm"] < 0.7
    # What it saved is what other commands read.
    measured = load_measurements(out / "recording_1.yaml", load_robot(out / "robot.yaml"))
    assert len(measured) == 160
    header = (out / "servo" / "tubeopt_robot.h").read_text()
    floor = data["floor_deg"]
    assert f"TUBEOPT_MIN_SNAP_DISTANCE {np.radians(floor or 0.0):.9g}" in header
    assert (out / "commissioning.pdf").read_bytes().startswith(b"%PDF")
    assert len((out / "next" / "configurations.csv").read_text().splitlines()) == 7
    # A killed run continues: finished steps are not repeated, those of another question are.
    kept = {path.name: path.stat().st_mtime_ns for path in (out / "steps").iterdir()}
    (out / "steps" / "next.pickle").unlink()
    assert run(*command) == 0
    again = {path.name: path.stat().st_mtime_ns for path in (out / "steps").iterdir()}
    assert [name for name in kept if kept[name] != again[name]] == ["next.pickle"]


def test_an_open_column_is_a_question(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files, out = write_log(tmp_path, still=True), tmp_path / "out"
    others = "rotation_2=reversed,translation_1=forward,translation_2=forward"
    assert run(*files, "--answer", others, "--out", str(out)) == 2
    assert "is rotation_1 forward or reversed? It does not move." in " ".join(capsys.readouterr().err.split())
    assert not out.exists()
    assert run(*files, "--answer", "rotation_2=left") == 2
    assert "it must be rotation_1=forward" in " ".join(capsys.readouterr().err.split())
    assert run(files[0], str(tmp_path / "none.csv")) == 2
    assert "none.csv" in capsys.readouterr().err
