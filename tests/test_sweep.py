"""Sweeps: every point once, whatever happens on the way; the same table; what fails is told."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from tubeopt import InputError, Tube, find_snap, forward_kinematics, sweep
from tubeopt.robots.concentric import ConcentricRobot
from tubeopt.study.sweep_file import load_sweep
from tubeopt.study.sweep_points import Axis, Points

from .command_line import ROOT, THESIS, Run, answer, refused
from .examples import THESIS as ROBOT
from .parallel.functions import slow_parabola

MM = 1e-3
FK = {"kind": "forward_kinematics", "robot": THESIS, "rotations_deg": [0, 0, 0]}


def written(directory: Path, **changes: Any) -> str:
    """A sweep file of two rotations and a radius, one of whose values makes no tube."""
    data = {
        "kind": "sweep",
        "study": FK,
        "vary": [
            {"key": "rotations_deg[0]", "from": -180, "to": 180, "count": 5},
            {"key": "robot.tubes[0].radius_mm", "values": [90, 100, -1]},
        ],
    } | changes
    path = directory / "sweep.yaml"
    path.write_text(yaml.safe_dump(data))
    return str(path)


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


# --- what it computes -------------------------------------------------------------------------------------------------


def test_every_row_is_the_study_at_its_point(run: Run, tmp_path: Path) -> None:
    data = answer(run("sweep", written(tmp_path), "--workers", "1", "--out", str(tmp_path / "out"), "--json"))
    assert (data["points"], data["computed"], data["failed"]) == (15, 15, 5)
    table = rows(Path(data["table"]))
    assert [row["point"] for row in table] == [str(k) for k in range(1, 16)]
    for k, row in enumerate(table):
        turn, radius = (-180, -90, 0, 90, 180)[k // 3], (90, 100, -1)[k % 3]
        assert float(row["rotations_deg[0]"]) == turn
        assert float(row["robot.tubes[0].radius_mm"]) == radius
        if radius < 0:
            assert row["status"] == "failed"
            assert "radius_mm is -1.0; it must be greater than 0" in row["reason"]
            assert row["margin"] == ""
            continue
        inner, *others = ROBOT.tubes
        changed = Tube(
            inner.outer_diameter, inner.inner_diameter, inner.straight_length, inner.curved_length, 1 / (radius * MM)
        )
        pose = forward_kinematics(ConcentricRobot((changed, *others)), np.radians([turn, 0, 0]))
        tip = [float(row[f"tip_position_mm[{i}]"]) for i in range(3)]
        assert tip == pytest.approx((pose.tip_position / MM).tolist(), abs=1e-6)
        assert float(row["margin"]) == pytest.approx(pose.margin, abs=1e-7)
    with np.load(data["arrays"]) as arrays:
        assert np.isnan(arrays["margin"]).sum() == 5
        assert arrays["status"].tolist() == [row["status"] for row in table]
        assert arrays["rotations_deg[0]"].tolist() == [float(row["rotations_deg[0]"]) for row in table]


def test_other_kinds_of_study_sweep_too(run: Run, tmp_path: Path) -> None:
    study = {"kind": "snap", "robot": THESIS, "to_deg": [360, 0, 0], "from_mm": [0, 0, 0]}
    vary = [{"key": ["from_mm[0]", "from_mm[1]", "from_mm[2]"], "values": [0, -20]}]
    path = written(tmp_path, study=study, vary=vary, columns=["snap.fraction", "answer"])
    data = answer(run("sweep", path, "--workers", "1", "--out", str(tmp_path / "out"), "--json"))
    table = rows(Path(data["table"]))
    assert 360 * float(table[0]["snap.fraction"]) == pytest.approx(214.222427, abs=1e-6)
    back = np.full(3, -20 * MM)
    snap = find_snap(ROBOT, (np.zeros(3), back), (np.radians([360, 0, 0]), back))
    assert snap is not None
    assert float(table[1]["snap.fraction"]) == pytest.approx(snap.fraction, abs=1e-9)
    assert set(table[0]) == {"point", *vary[0]["key"], "status", "reason", "snap.fraction", "answer"}


def test_a_study_in_a_file_of_its_own(run: Run, tmp_path: Path) -> None:
    path = written(tmp_path, study=str(ROOT / "configs" / "studies" / "thesis_actuated.yaml"))
    out = tmp_path / "out"
    data = answer(run("sweep", path, "--workers", "1", "--out", str(out), "--json"))
    assert data["failed"] == 5
    assert {row["rotations_deg[2]"] for row in rows(out / "table.csv") if row["status"] == "done"} == {
        "114.59155902616465"
    }


# --- points -----------------------------------------------------------------------------------------------------------


def test_the_points_of_a_grid() -> None:
    points = Points((Axis(("a",), None, 0.0, 0.3, 4), Axis(("b", "c"), (True, "x"))))
    assert len(points) == 8
    assert points[0] == {"a": 0.0, "b": True, "c": True}
    assert points[3] == {"a": 0.1, "b": "x", "c": "x"}
    assert list(points)[-1] == points[-1] == {"a": 0.3, "b": "x", "c": "x"}


@pytest.mark.parametrize("method", ["random", "sobol", "latin_hypercube"])
def test_the_points_of_a_sample(method: str) -> None:
    points = Points((Axis(("a",), None, -2.0, 2.0), Axis(("b",), ("x", "y"))), method, 100, 3)
    a = np.array([point["a"] for point in points], dtype=float)
    assert len(points) == 100
    assert a.min() >= -2
    assert a.max() <= 2
    assert abs(a.mean()) < 0.4
    assert 30 < sum(point["b"] == "x" for point in points) < 70
    assert list(points) == list(Points(points.axes, method, 100, 3))
    assert list(points) != list(Points(points.axes, method, 100, 4))


# --- killed -----------------------------------------------------------------------------------------------------------


POINTS = [{"x": float(k)} for k in range(2000)]

SCRIPT = """
import sys
from functools import partial
from tests.parallel.functions import slow_parabola
from tubeopt import sweep

if __name__ == "__main__":
    sweep(partial(slow_parabola, 0.1), [{"x": float(k)} for k in range(2000)], sys.argv[1], workers=2)
"""


def lines(journal: Path) -> list[bytes]:
    return journal.read_bytes().splitlines() if journal.exists() else []


def test_killed_in_the_middle_and_resumed(tmp_path: Path) -> None:
    script, journal = tmp_path / "run.py", tmp_path / "killed" / "journal.jsonl"
    script.write_text(SCRIPT)
    command = [sys.executable, str(script), str(journal.parent)]
    with subprocess.Popen(command, env={**os.environ, "PYTHONPATH": str(ROOT)}) as running:
        while len(lines(journal)) < 500:
            assert running.poll() is None
            time.sleep(0.01)
        running.send_signal(signal.SIGKILL)
    before = len(lines(journal)) - 1
    assert 500 <= before + 1 < 2000
    with journal.open("ab") as file:
        file.write(b'{"index": 1999, "para')  # torn by the kill
    seen: list[tuple[int, int, int]] = []
    function = partial(slow_parabola, 0.1)
    found = sweep(function, POINTS, journal.parent, workers=1, progress=lambda *now: seen.append(now))
    assert 2000 - before <= found.computed <= 2001 - before
    assert seen[0][0] == 2000 - found.computed
    assert seen[-1] == (2000, 2000, 1)
    indices = [json.loads(line)["index"] for line in lines(journal)[1:]]
    assert sorted(indices) == list(range(2000))
    whole = sweep(function, POINTS, tmp_path / "whole", workers=1)
    assert found.table.read_bytes() == whole.table.read_bytes()
    assert found.arrays.read_bytes() == whole.arrays.read_bytes()
    assert found.failures == whole.failures == ((77, "InputError: x is 77; it must be another number"),)


def test_a_journal_cut_anywhere_is_continued(tmp_path: Path) -> None:
    function, points = partial(slow_parabola, 0.0), POINTS[:6]
    whole = sweep(function, points, tmp_path / "whole", workers=1)
    content = whole.journal.read_bytes()
    for cut in range(0, len(content), 37):
        directory = tmp_path / str(cut)
        directory.mkdir()
        (directory / "journal.jsonl").write_bytes(content[:cut])
        again = sweep(function, points, directory, workers=1)
        assert again.table.read_bytes() == whole.table.read_bytes()
        assert len(lines(again.journal)) == 7


def test_nothing_is_computed_twice(tmp_path: Path) -> None:
    function, points = partial(slow_parabola, 0.0), POINTS[70:80]
    assert sweep(function, points, tmp_path, workers=1).computed == 10
    assert sweep(function, points, tmp_path, workers=1).computed == 0
    again = sweep(function, points, tmp_path, workers=1, retry_failed=True)
    assert (again.computed, len(again.failures)) == (1, 1)


# --- refused ----------------------------------------------------------------------------------------------------------


def test_a_directory_of_another_sweep_is_refused(tmp_path: Path) -> None:
    sweep(partial(slow_parabola, 0.0), POINTS[:3], tmp_path, workers=1)
    with pytest.raises(InputError, match="is the journal of another sweep"):
        sweep(partial(slow_parabola, 1.0), POINTS[:3], tmp_path, workers=1)


def test_a_damaged_journal_is_refused(tmp_path: Path) -> None:
    journal = sweep(partial(slow_parabola, 0.0), POINTS[:3], tmp_path, workers=1).journal
    content = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join([content[0], b"nonsense\n", *content[2:]]))
    with pytest.raises(InputError, match="line 2 is damaged"):
        sweep(partial(slow_parabola, 0.0), POINTS[:3], tmp_path, workers=1)


def test_two_runs_at_once_are_refused(tmp_path: Path) -> None:
    def meddle(done: int, total: int, failed: int) -> None:
        with pytest.raises(InputError, match="another run is writing here"):
            sweep(partial(slow_parabola, 0.0), POINTS[:2], tmp_path, workers=1)

    sweep(partial(slow_parabola, 0.0), POINTS[:2], tmp_path, workers=1, progress=meddle)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"vary": []}, "vary has 0 items; it must have at least 1"),
        ({"vary": [{"key": "margin", "values": [1]}]}, "vary margin: the study gives no margin"),
        ({"vary": [{"key": "rotations_deg[3]", "values": [1]}]}, "rotations_deg is a list of 3, counted from 0"),
        (
            {"vary": [{"key": "robot.tubes[0].radus_mm", "values": [1]}]},
            "robot.tubes[0] has no radus_mm; did you mean 'radius_mm'?",
        ),
        ({"vary": [{"key": "translations_mm[0]", "values": [1]}]}, "no translations_mm; give it a value"),
        ({"vary": [{"key": "a b", "values": [1]}]}, "this is no path of a key"),
        ({"vary": [{"key": "rotations_deg[0]", "from": 1}]}, "must give values, or from and to"),
        ({"vary": [{"key": "rotations_deg[0]", "from": 1, "to": 2}]}, "count is missing"),
        ({"study": {"kind": "forward_kinematics"}}, "robot is missing"),
        ({"study": "nowhere.yaml"}, "nowhere.yaml: there is no such file"),
        ({"sample": {"count": 0}}, "sample.count is 0"),
        ({"colums": ["margin"]}, "colums is not a known key; did you mean 'columns'?"),
    ],
)
def test_files_that_make_no_sweep(run: Run, tmp_path: Path, changes: dict[str, Any], problem: str) -> None:
    told = refused(run("sweep", written(tmp_path, **changes), "--workers", "1", "--out", str(tmp_path / "out")))
    assert any(problem in line for line in told), told
    assert all("sweep.yaml" in line or "nowhere.yaml" in line for line in told)
    assert not (tmp_path / "out").exists()


def test_where_every_point_fails_there_is_no_solution(run: Run, tmp_path: Path) -> None:
    path = written(tmp_path, vary=[{"key": "robot.tubes[0].radius_mm", "values": [-1, -2]}])
    outcome = run("sweep", path, "--workers", "1", "--out", str(tmp_path / "out"))
    assert outcome.code == 3
    assert "all 2 points failed; the first: InputError: robot: tubes[0].radius_mm is -1.0" in " ".join(
        outcome.err.split()
    )
    assert len(rows(tmp_path / "out" / "table.csv")) == 2


def test_files_named_by_the_study_tell_sweeps_apart(tmp_path: Path) -> None:
    path = Path(written(tmp_path))
    first = load_sweep(path).fingerprint
    assert load_sweep(path).fingerprint == first
    robot = tmp_path / "robot.yaml"
    robot.write_text(Path(THESIS).read_text())
    moved = written(tmp_path, study=FK | {"robot": "robot.yaml"})
    one = load_sweep(moved).fingerprint
    robot.write_text(robot.read_text().replace("200", "201"))
    assert load_sweep(moved).fingerprint != one


@pytest.mark.parametrize("name", ["sweep_tips", "sweep_curvature"])
def test_the_sweeps_in_configs_load(name: str) -> None:
    assert len(load_sweep(ROOT / "configs" / "studies" / f"{name}.yaml").points) in (18, 200)


def test_help_has_an_example(run: Run) -> None:
    outcome = run("sweep", "--help")
    assert outcome.code == 0
    for part in ("Example: tubeopt sweep configs/", "--json", "--out", "--scheduler"):
        assert part in outcome.out
