"""Sweeps: every point once, whatever happens on the way; the same table; what fails is told."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
import yaml

from tests.command_line import ROOT, THESIS, Run, answer, refused
from tests.examples import THESIS as ROBOT
from tests.solvers.parallel_functions import echo, slow_parabola
from tubeopt import InputError, Tube, find_snap, forward_kinematics, sweep, workspace
from tubeopt.robots.concentric import ConcentricRobot
from tubeopt.runs.sweep_file import _fingerprint, load_sweep
from tubeopt.runs.sweeping import Axis, Points
from tubeopt.workspaces import voxels

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


def test_precurvature_tables_are_relative_to_robot_file(run: Run, tmp_path: Path) -> None:
    """Whether keys of the robot vary or not, and wherever the sweep is run."""
    (tmp_path / "bend.csv").write_text("arc_length_mm,curvature_x_per_m,curvature_y_per_m\n0,10,0\n20,8,3\n40,5,6\n")
    tube = {
        "outer_diameter_mm": 1,
        "inner_diameter_mm": 0.7,
        "straight_length_mm": 30,
        "pieces": [{"table": "bend.csv"}],
    }
    robot = {"kind": "concentric", "name": "one", "tubes": [tube]}
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(robot))
    study = {"kind": "forward_kinematics", "robot": "robot.yaml", "rotations_deg": [0]}
    tips = []
    for key in ("rotations_deg[0]", "robot.tubes[0].straight_length_mm"):
        path = written(tmp_path, study=study, vary=[{"key": key, "values": [30]}], columns=["tip_position_mm[2]"])
        out = run("sweep", path, "--workers", "1")
        assert out.code == 0, out.err
        tips.append(float(out.out.splitlines()[-1].split(",")[-1]))
    assert tips[0] == pytest.approx(tips[1])
    assert 35 < tips[0] < 40


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


def test_without_a_directory_the_table_is_printed_and_nothing_is_written(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = written(tmp_path)
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    outcome = run("sweep", path, "--workers", "1")
    data = answer(run("sweep", path, "--workers", "1", "--json"))
    assert sorted(tmp_path.rglob("*")) == before
    assert (outcome.code, data["table"]) == (0, None)
    rows = list(csv.DictReader(outcome.out.splitlines()))
    assert [row["margin"] for row in rows] == [str(row["margin"]) for row in data["rows"]]
    assert len(rows) == data["points"]


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


def test_workspaces_and_heatings_sweep_too(run: Run, tmp_path: Path) -> None:
    position = {"kind": "workspace", "robot": THESIS, "samples": 300, "voxel_mm": 20}
    vary = [{"key": "robot.tubes[0].radius_mm", "values": [90, 200]}]
    table = Path(answer(run("sweep", written(tmp_path, study=position, vary=vary), "--workers", "1", "--out",
                            str(tmp_path / "w"), "--json"))["table"])  # fmt: skip
    for row, radius in zip(rows(table), (90, 200), strict=True):
        tubes = (replace(ROBOT.tubes[0], curvature=1 / (radius * MM)), *ROBOT.tubes[1:])
        cubes = voxels(workspace(ConcentricRobot(tubes), 300), 20 * MM)
        assert (int(row["voxels"]), row["without_equilibrium"]) == (len(cubes), "0")
    oven = {"kind": "heating", "rig": str(ROOT / "configs" / "rigs" / "thesis_calcium_silicate.yaml"),
            "window_degC": [200, 260], "hold_s": 5, "slot_s": 1, "longest_s": 20}  # fmt: skip
    vary = [{"key": "rig.ambient_degC", "values": [35, "warm"]}]
    columns = ["feasible", "lowest_degC", "energy_kJ"]
    data = answer(run("sweep", written(tmp_path, study=oven, vary=vary, columns=columns), "--workers", "1", "--out",
                      str(tmp_path / "h"), "--json"))  # fmt: skip
    assert data["failures"] == [{"point": 2, "reason": "InputError: rig: ambient_degC is 'warm'; it must be a number"}]
    done = rows(Path(data["table"]))[0]
    assert done["feasible"] == "true"
    assert float(done["lowest_degC"]) > 200 - 1


def test_molds_sweep_too(run: Run, tmp_path: Path) -> None:
    board = ROOT / "configs" / "molds" / "calcium_silicate.yaml"
    lossy = tmp_path / "mold.yaml"
    lossy.write_text(board.read_text() + "springback: {fraction_percent: 10}\n")
    groove = {"kind": "mold_plan", "robot": THESIS, "tubes": [1], "mold": str(lossy)}
    vary = [{"key": "robot.tubes[0].radius_mm", "values": [90, 200]},
            {"key": "mold.springback.fraction_percent", "values": [0, 20]}]  # fmt: skip
    data = answer(run("sweep", written(tmp_path, study=groove, vary=vary, columns=["grooves"]), "--workers", "1",
                      "--out", str(tmp_path / "m"), "--json"))  # fmt: skip
    results = [float(row["grooves[0].mold_radius_mm"]) for row in rows(Path(data["table"]))]
    # What comes out has the mold's curvature less the lost part of it.
    assert results == pytest.approx([90, 90 * 0.8, 200, 200 * 0.8], rel=1e-9)


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


def test_points_are_generated_lazily() -> None:
    points = Points((Axis(("a",), None, -1.0, 2.0, 1001), Axis(("b",), None, 0.0, 1.0, 9001)))
    assert points[-1] == {"a": 2.0, "b": 1.0}
    with patch("numpy.linspace", side_effect=AssertionError("all values for one point")):
        assert points[9001 * 500 + 4500] == {"a": 0.5, "b": 0.5}
    with pytest.raises(InputError, match="the sweep has 4000000000000 points; there must be 1 to 10000000"):
        Points((Axis(("a",), None, 0.0, 1.0, 4 * 10**12),))
    with pytest.raises(InputError, match="vary a: it is given 2 times"):
        Points((Axis(("a",), (1.0,)), Axis(("b", "a"), (2.0,))))


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
from tests.solvers.parallel_functions import slow_parabola
from tubeopt import sweep

if __name__ == "__main__":
    sweep(partial(slow_parabola, 0.1), [{"x": float(k)} for k in range(2000)], sys.argv[1], workers=2)
"""


def lines(journal: Path) -> list[bytes]:
    return journal.read_bytes().splitlines() if journal.exists() else []


def test_killed_sweep_resumes(tmp_path: Path) -> None:
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
    observed: list[tuple[int, int, int]] = []
    function = partial(slow_parabola, 0.1)
    result = sweep(function, POINTS, journal.parent, workers=1, progress=lambda *now: observed.append(now))
    assert 2000 - before <= result.computed <= 2001 - before
    assert observed[0][0] == 2000 - result.computed
    assert observed[-1] == (2000, 2000, 1)
    indices = [json.loads(line)["index"] for line in lines(journal)[1:]]
    assert sorted(indices) == list(range(2000))
    whole = sweep(function, POINTS, tmp_path / "whole", workers=1)
    assert result.table.read_bytes() == whole.table.read_bytes()
    assert result.arrays.read_bytes() == whole.arrays.read_bytes()
    assert result.failures == whole.failures == ((77, "InputError: x is 77; it must be another number"),)


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
    with pytest.raises(InputError, match="another sweep, or the"):
        sweep(partial(slow_parabola, 1.0), POINTS[:3], tmp_path, workers=1)


def test_a_damaged_journal_is_refused(tmp_path: Path) -> None:
    journal = sweep(partial(slow_parabola, 0.0), POINTS[:3], tmp_path, workers=1).journal
    content = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join([content[0], b"nonsense\n", *content[2:]]))
    with pytest.raises(InputError, match="line 2 is damaged"):
        sweep(partial(slow_parabola, 0.0), POINTS[:3], tmp_path, workers=1)


@pytest.mark.parametrize("rubbish", [b"nonsense\n", b"\0" * 5000, b'{"index": 2}\n', b'{"index": 2, "par'])
def test_nonsense_at_the_end_of_a_journal_is_computed_again(tmp_path: Path, rubbish: bytes) -> None:
    whole = sweep(partial(slow_parabola, 0.0), POINTS[:3], tmp_path / "whole", workers=1)
    content = whole.journal.read_bytes().splitlines(keepends=True)
    (tmp_path / "cut").mkdir()
    (tmp_path / "cut" / "journal.jsonl").write_bytes(b"".join(content[:-1]) + rubbish)
    again = sweep(partial(slow_parabola, 0.0), POINTS[:3], tmp_path / "cut", workers=1)
    assert again.computed == 1
    assert again.table.read_bytes() == whole.table.read_bytes()


def test_a_file_that_is_no_journal_is_left_alone(tmp_path: Path) -> None:
    file = tmp_path / "journal.jsonl"
    file.write_text("Dear diary")
    with pytest.raises(InputError, match="line 1 is damaged; this is not the journal of a sweep"):
        sweep(partial(slow_parabola, 0.0), POINTS[:3], tmp_path, workers=1)
    assert file.read_text() == "Dear diary"


def test_points_and_answers_of_all_kinds(tmp_path: Path) -> None:
    points: list[Any] = [{"x": np.float64(1.5)}, {"x": np.int64(2), "to": np.array([3.0, 4.0])}, {"x": 3}, {"x": 4}]
    result = sweep(echo, points, tmp_path / "rows", workers=1)
    assert [(row["x"], row["to[1]"], row["twice"]) for row in rows(result.table)] == [
        ("1.5", "", "3.0"),
        ("2", "4.0", "4"),
        ("3", "", ""),
        ("4", "", ""),
    ]
    assert result.failures == (
        (2, "TypeError: the answer is 3; it must be a mapping of names to values"),
        (3, "TypeError: the answer: z is 4j; it must be a number or text"),
    )
    wrong: Any
    for wrong, problem in (
        ([], "there are no points"),
        ({"x": 1}, "points are dict; they must be a list"),
        ([{"x": 1}, 2], r"points\[1\] is 2; it must be a mapping"),
        ([{"x": 1j}], r"points\[0\]: x is 1j; it must be a number or text"),
    ):
        with pytest.raises(InputError, match=problem):
            sweep(echo, wrong, tmp_path / "wrong", workers=1)
    wrong = 3
    with pytest.raises(InputError, match="function is 3; it must be a function"):
        sweep(wrong, POINTS[:1], tmp_path / "wrong", workers=1)
    assert not (tmp_path / "wrong").exists()


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
        ({"vary": [{"key": "a b", "values": [1]}]}, "this is not a path of"),
        ({"vary": [{"key": "rotations_deg[0]", "from": 1}]}, "must give values, or from and to"),
        ({"vary": [{"key": "rotations_deg[0]", "from": 1, "to": 2}]}, "count is missing"),
        ({"study": {"kind": "forward_kinematics"}}, "robot is missing"),
        ({"study": "nowhere.yaml"}, "nowhere.yaml: there is no such file"),
        ({"sample": {"count": 0}}, "sample.count is 0"),
        ({"columns": []}, "columns has 0 items; it must have at least 1"),
        ({"vary": [{"key": "rotations_deg[0]", "values": [1]}] * 2}, "vary rotations_deg[0]: it is given 2 times"),
        ({"colums": ["margin"]}, "colums is not a known key; did you mean 'columns'?"),
    ],
)
def test_files_that_make_no_sweep(run: Run, tmp_path: Path, changes: dict[str, Any], problem: str) -> None:
    report = refused(run("sweep", written(tmp_path, **changes), "--workers", "1", "--out", str(tmp_path / "out")))
    assert any(problem in line for line in report), report
    assert all("sweep.yaml" in line or "nowhere.yaml" in line for line in report)
    assert not (tmp_path / "out").exists()


def test_how_long_a_study_took_is_no_result(run: Run, tmp_path: Path) -> None:
    rest = [-120.0, 100.0, 10.0]
    tip = forward_kinematics(ROBOT, np.radians(rest)).tip_position / MM
    study = {"kind": "inverse_kinematics", "robot": THESIS, "target_mm": tip.tolist()}
    path = written(tmp_path, study=study, vary=[{"key": "target_mm[0]", "values": [float(tip[0])]}])
    table = Path(answer(run("sweep", path, "--workers", "1", "--out", str(tmp_path / "out"), "--json"))["table"])
    columns = list(rows(table)[0])
    assert "solutions[0].margin" in columns
    assert not [column for column in columns if "seconds" in column or "statistics" in column]


def test_column_without_result_is_reported(run: Run, tmp_path: Path) -> None:
    path = written(tmp_path, vary=[{"key": "rotations_deg[1]", "values": [0, 1]}], columns=["margin", "energi_mJ"])
    outcome = run("sweep", path, "--workers", "1", "--out", str(tmp_path / "out"))
    assert outcome.code == 3
    assert "columns: no result begins with 'energi_mJ'; did you mean 'energy_mJ'?" in outcome.err


def test_reasons_name_no_directories(run: Run, tmp_path: Path) -> None:
    path = written(tmp_path, vary=[{"key": "rotations_deg[1]", "values": [0, "x"]}])
    data = answer(run("sweep", path, "--workers", "1", "--out", str(tmp_path / "out"), "--json"))
    assert data["failures"] == [{"point": 2, "reason": "InputError: rotations_deg[1] is 'x'; it must be a number"}]


def test_a_sweep_is_no_study(run: Run, tmp_path: Path) -> None:
    assert "is 'sweep'; use `tubeopt" in refused(run("run", written(tmp_path)))[0]


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


def test_files_named_by_files_tell_sweeps_apart(tmp_path: Path) -> None:
    mesh = tmp_path / "bone.stl"
    mesh.write_text("solid")
    bodies = tmp_path / "bodies.yaml"
    bodies.write_text("mesh: bone.stl\nself: bodies.yaml\n")
    data = {"kind": "forward_kinematics", "obstacles": "bodies.yaml"}
    one = _fingerprint(data, tmp_path / "sweep.yaml", {})
    assert _fingerprint(data, tmp_path / "sweep.yaml", {}) == one
    mesh.write_text("solid bone")
    assert _fingerprint(data, tmp_path / "sweep.yaml", {}) != one


@pytest.mark.parametrize("name", ["sweep_tips", "sweep_curvature"])
def test_the_sweeps_in_configs_load(name: str) -> None:
    assert len(load_sweep(ROOT / "configs" / "studies" / f"{name}.yaml").points) in (18, 200)


def test_help_has_an_example(run: Run) -> None:
    outcome = run("sweep", "--help")
    assert outcome.code == 0
    for part in ("Example: tubeopt sweep sweep_tips", "--json", "--out", "--scheduler"):
        assert part in outcome.out
