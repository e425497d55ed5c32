"""Commands in a folder without files: robots, rigs and studies by their names, in the shell too."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.command_line import Run, answer, refused
from tubeopt.files.shipped import shipped
from tubeopt.show.plots.figure import drawn_data
from tubeopt.show.plots.style import new_figure


@pytest.fixture(autouse=True)
def _empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_fk_by_name_draws_its_picture(run: Run, tmp_path: Path) -> None:
    report = answer(run("fk", "thesis_ctr", "--rotations-deg", "0,90,180", "--out", "results", "--json"))
    assert report["tip_position_mm"] == pytest.approx([70.75080462, -4.22996685, 177.38526469], abs=1e-7)
    assert {path.name for path in (tmp_path / "results").iterdir()} >= {"result.json", "shape.png", "torsion.png"}


@pytest.mark.parametrize(
    ("typed", "key"),
    [
        (("run", "thesis_snap"), "snap"),
        (("ik", "thesis_ctr", "--targets", "arc"), "targets"),
        (("follow", "thesis_ctr", "turn_and_back"), "snaps"),
        (("verify", "turn_and_back", "--robot", "two_tube"), "error"),
        (("mold", "thesis_etr", "--mold", "calcium_silicate"), "thickness_mm"),
        (("robot", "show", "timc_ctr"), "tubes"),
    ],
)
def test_other_commands_by_name(run: Run, typed: tuple[str, ...], key: str) -> None:
    assert key in json.loads(run(*typed, "--json").out)


def test_a_study_by_name_takes_another_robot_by_name(run: Run) -> None:
    lines = refused(run("plan", "plan_thesis_turn", "--robot", "two_tube"))
    assert lines[0].endswith("start_deg has 3 numbers; it must be 2 (one per tube)")


def test_a_certificate_names_the_robot_as_typed(run: Run) -> None:
    report = run("certify", "two_tube")
    assert report.code == 3
    assert "tubeopt snap two_tube --" in report.out


def test_a_name_of_nothing_is_one_sentence(run: Run) -> None:
    (line,) = refused(run("fk", "thesis_crt"))
    assert line.startswith(
        "thesis_crt: there is no such file, and no built-in robot has this name; did you mean thesis_ctr"
    )
    (line,) = refused(run("fk", "configs/robots/thesis_ctr.yaml"))
    assert line.endswith("use the built-in file by its name, thesis_ctr")


def test_lists(run: Run) -> None:
    report = answer(run("robot", "list", "--json"))["shipped"]
    assert [robot["name"] for robot in report] == list(shipped("robots"))
    (thesis,) = (robot for robot in report if robot["name"] == "thesis_ctr")
    assert thesis == {
        "name": "thesis_ctr",
        "folder": "robots",
        "kind": "concentric",
        "tubes": 3,
        "about": "The three-tube concentric tube robot of the thesis",
    }
    lines = run("robot", "list").out.splitlines()
    assert lines[0].split() == ["name", "kind", "tubes"]
    assert len(lines) == 1 + len(report)
    assert len(answer(run("list", "--json"))["shipped"]) == len(shipped())
    assert [line.split()[0] for line in run("list", "rigs").out.splitlines()[1:]] == list(shipped("rigs"))
    (line,) = refused(run("list", "rig"))
    assert line.endswith("; did you mean 'rigs'?")


def completed(*words: str) -> list[str]:
    """What bash proposes for the last word."""
    typed = {"_TUBEOPT_COMPLETE": "complete_bash", "COMP_WORDS": " ".join(words), "COMP_CWORD": str(len(words) - 1)}
    script = "from tubeopt.cli import main; main([])"
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, env=os.environ | typed, capture_output=True, text=True, check=False)
    return done.stdout.split()


def test_the_shell_completes_names_files_and_words(tmp_path: Path) -> None:
    shutil.copy(shipped()["two_tube"], "those.yaml")
    (tmp_path / "there").mkdir()
    (tmp_path / "text.txt").write_text("")
    assert completed("tubeopt", "fk", "th") == ["thamo_ctr", "thesis_ctr", "thesis_etr", "there/", "those.yaml"]
    assert completed("tubeopt", "fk", "thesis_ctr", "--method", "i") == ["ipopt"]
    assert completed("tubeopt", "heat", "plan", "thesis_s") == ["thesis_steel"]
    assert completed("tubeopt", "run", "plan_two") == ["plan_two_arms"]


def test_a_figure_has_picture_caption_data_and_command(run: Run, tmp_path: Path) -> None:
    report = answer(run("figure", "thesis_snap", "--journal", "springer", "--out", "paper", "--json"))
    assert report["snap"]["fraction"] == pytest.approx(0.595062, abs=1e-6)
    assert [Path(path).name for path in report["files"]] == [
        *("snap.json", "before_centreline.csv", "after_centreline.csv", "command.txt"),
        *("snap.tiff", "captions.txt"),
    ]
    with Image.open(tmp_path / "paper" / "snap.tiff") as image:
        assert image.width == pytest.approx(84 / 25.4 * 600, abs=1)
    caption = (tmp_path / "paper" / "captions.txt").read_text()
    assert caption.startswith("snap.tiff: thesis CTR: snap at rotations (214.222°, 0°, 0°)")
    command = (tmp_path / "paper" / "command.txt").read_text().splitlines()[0]
    assert command == "tubeopt figure thesis_snap --journal springer --width-mm 84 --out paper"
    before, after = (
        np.loadtxt(tmp_path / "paper" / f"{when}_centreline.csv", delimiter=",", skiprows=1)
        for when in ("before", "after")
    )
    assert np.linalg.norm(after[-1, 1:] - before[-1, 1:]) == pytest.approx(report["snap"]["tip_jump_mm"], rel=1e-9)


def test_a_figure_needs_a_directory_a_known_journal_and_plots(run: Run, tmp_path: Path) -> None:
    assert "--out is missing" in refused(run("figure", "thesis_snap"))[0]
    assert "--journal is 'nature'" in refused(run("figure", "thesis_snap", "--journal", "nature", "--out", "a"))[0]
    study = tmp_path / "study.yaml"
    study.write_text("kind: measure\nrobot: crl_ctr\ncount: 3\nfit: [curvature_1]\n")
    assert "it has no plots" in refused(run("figure", str(study), "--out", "a"))[0]


def test_data_of_a_picture_are_those_of_its_panels() -> None:
    figure = new_figure(4.0, 3.0)
    axes, bars = figure.subplots(1, 2)
    axes.plot([1.0, 2.0], [3.0, 4.0], label="a, b")
    axes.axhline(0.0)
    axes.pcolormesh([0.0, 2.0], [0.0, 4.0], [[5.0]])
    axes.set(xlabel="x (mm)", ylabel="y")
    bars.barh([1], [7.0])
    assert list(drawn_data(figure)) == [
        ("y over x (mm)", "a; b", 1.0, 3.0, ""),
        ("y over x (mm)", "a; b", 2.0, 4.0, ""),
        ("y over x (mm)", "", 1.0, 2.0, 5.0),
        ("over", "", 3.5, 1.0, 7.0),
    ]
