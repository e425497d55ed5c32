"""`tubeopt design`: what it prints, what it saves, and how it fails."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.command_line import ROOT, Run, answer, refused
from tubeopt import load_robot, snap_free_certificate
from tubeopt.runs.design_parts import load_stock
from tubeopt.runs.design_study import DesignStudy
from tubeopt.runs.study_file import load_study

STUDIES = ROOT / "configs" / "studies"
THESIS = STUDIES / "design_thesis_snap_free.yaml"

STUDY = """\
kind: design
robot: {robot}
free: [{{tubes: [1, 2], {range}}}]
requirements: {{snap_free: {{margin: {margin}}}}}
objective: {{kind: {objective}}}
"""


def written(
    path: Path, *, free: str = "curvature_per_m: [1, 20]", margin: float = 0.1, objective: str = "tip_curvature"
) -> str:
    """A study of two tubes."""
    robot = ROOT / "configs" / "robots" / "two_tube.yaml"
    path.write_text(STUDY.format(robot=robot, range=free, margin=margin, objective=objective), encoding="utf-8")
    return str(path)


@pytest.mark.usefixtures("small_maps")
def test_design_is_printed_saved_and_loads_back(run: Run, tmp_path: Path) -> None:
    data = answer(run("design", str(THESIS), "--json", "--out", str(tmp_path)))
    robot = load_robot(tmp_path / "robot.yaml")
    assert snap_free_certificate(robot) == data["certificate"] >= 0.05 - 1e-6
    assert all(check["satisfied"] for check in data["checks"])
    assert 0.9 < data["tolerance"]["snap_free_probability"] < 1
    page = (tmp_path / "report.md").read_text(encoding="utf-8")
    for name in ("shapes.png", "maps.png", "tolerance.png"):
        assert (tmp_path / name).stat().st_size > 0
        assert f"({name})" in page
    assert "certified margin" in page
    assert json.loads((tmp_path / "design.json").read_text())["dimensions"][0]["before"] == 10.0


def test_table_says_what_binds(run: Run, tmp_path: Path) -> None:
    outcome = run("design", written(tmp_path / "two.yaml"), "--starts", "2")
    assert outcome.code == 0
    assert "less certified margin buys" in outcome.out
    assert "2, 2 feasible" in outcome.out


def test_infeasible_task_says_what_to_relax(run: Run, tmp_path: Path) -> None:
    outcome = run("design", written(tmp_path / "bad.yaml", free="curvature_per_m: [19, 20]", margin=0.95))
    assert outcome.code == 3
    assert "certified margin must fall from 0.95 to" in outcome.err


def test_wrong_files_are_refused(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "study.yaml"
    assert "it must be design" in refused(run("design", str(STUDIES / "thesis_snap.yaml")))[0]
    assert "gives 0 ranges" in refused(run("design", written(path, free="equal: true")))[0]
    assert "kind is 'curvature'" in refused(run("design", written(path, objective="curvature")))[0]
    text = Path(written(path)).read_text(encoding="utf-8")
    for line, label in (
        ("seed: -1", "seed is -1"),
        ("starts: 0", "starts is 0"),
        ("pareto_margins: [0.1, 1.5]", "must be less than 1"),
        ("pareto_margins: []", "pareto_margins has 0 items"),
        ("tolerances: {samples: 1}", "tolerances.samples is 1"),
    ):
        path.write_text(f"{text}{line}\n", encoding="utf-8")
        (message,) = refused(run("design", str(path)))
        assert label in message
        assert str(path) in message
    assert "--starts is 0" in refused(run("design", str(THESIS), "--starts", "0"))[0]
    assert "there is no such file" in refused(run("design", str(tmp_path / "none.yaml")))[0]


DESIGNS = [path for path in sorted(STUDIES.glob("*.yaml")) if "\nkind: design\n" in path.read_text()]


@pytest.mark.parametrize("path", DESIGNS, ids=lambda path: path.stem)
def test_every_design_study_makes_a_task(path: Path) -> None:
    study = load_study(path)
    assert isinstance(study, DesignStudy)
    assert study.task().requirements


def test_stock_list_has_a_dozen_sizes_with_sources() -> None:
    stock = load_stock(ROOT / "configs" / "tubes" / "stock.yaml")
    assert len(stock) == 12
    assert all(size.source for size in stock)
