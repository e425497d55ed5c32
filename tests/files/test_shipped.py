"""Files that come with tubeopt are typed by their name; a file of exactly that path goes first."""

from __future__ import annotations

import logging
import shutil
from pathlib import Path

import pytest

import tubeopt
from tubeopt.errors import InputError
from tubeopt.files.shipped import ENDINGS, FOLDER, NAME, description_of, resolve_file, shipped
from tubeopt.runs.robot_keys import load_entry
from tubeopt.runs.study_file import load_study
from tubeopt.runs.sweep_file import load_sweep


@pytest.fixture
def empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder without files, in which one is."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_built_in_files_have_unique_names_and_descriptions() -> None:
    files = [path for ending in ENDINGS for path in FOLDER.glob(f"*/*{ending}")]
    assert len(files) == len(shipped()) > 50
    for name, path in shipped().items():
        assert NAME.fullmatch(name)
        assert 10 < len(description_of(path)) < 220, path
        assert not description_of(path).startswith("Source"), path


@pytest.mark.parametrize("name", shipped("robots"))
def test_robots_by_name(name: str, empty: Path) -> None:
    assert tubeopt.load_robot(name) == tubeopt.load_robot(FOLDER / "robots" / f"{name}.yaml")


def test_rigs_studies_and_sweeps_by_name(empty: Path) -> None:
    assert tubeopt.load_rig("thesis_steel") == tubeopt.load_rig(FOLDER / "rigs" / "thesis_steel.yaml")
    assert load_study("thesis_snap").kind == "snap"
    assert len(load_sweep("sweep_curvature").points.keys) == 4


def test_a_study_of_ones_own_names_what_comes_with_tubeopt(empty: Path) -> None:
    below = empty / "studies"
    below.mkdir()
    (below / "ik.yaml").write_text("kind: inverse_kinematics\nrobot: thesis_ctr\ntargets: arc\nobstacles: two_bodies\n")
    study = load_study("studies/ik.yaml")
    assert study.robot == tubeopt.load_robot("thesis_ctr")  # type: ignore[attr-defined]
    assert len(study.targets.position) == 21  # type: ignore[attr-defined]
    sweep = "kind: sweep\nstudy: thesis_snap\nvary:\n  - {key: 'robot.tubes[0].radius_mm', values: [100, 120]}\n"
    (below / "sweep.yaml").write_text(sweep)
    assert load_sweep("studies/sweep.yaml").points.keys == ("robot.tubes[0].radius_mm",)


def test_a_local_file_of_exactly_this_path_goes_first(empty: Path) -> None:
    shutil.copy(shipped()["two_tube"], "thesis_ctr")
    assert tubeopt.load_robot("thesis_ctr").n_tubes == 2
    below = empty / "below"
    below.mkdir()
    shutil.copy(shipped()["two_tube"], below / "crl_ctr")
    (below / "study.yaml").write_text("kind: equilibria\nrobot: crl_ctr\n")
    assert load_study("below/study.yaml").robot.n_tubes == 2  # type: ignore[attr-defined]
    assert tubeopt.load_robot("crl_ctr").n_tubes == 3


def test_a_local_file_with_an_ending_is_typed_with_it(empty: Path, caplog: pytest.LogCaptureFixture) -> None:
    shutil.copy(shipped()["two_tube"], "thesis_ctr.yaml")
    assert tubeopt.load_robot("thesis_ctr.yaml").n_tubes == 2
    with caplog.at_level(logging.WARNING):
        assert tubeopt.load_robot("thesis_ctr").n_tubes == 3
    assert caplog.messages == ["thesis_ctr is the built-in file; the local file is thesis_ctr.yaml"]


def test_a_folder_of_this_name_hides_nothing(empty: Path) -> None:
    (empty / "thesis_ctr").mkdir()
    assert resolve_file("thesis_ctr") == shipped()["thesis_ctr"]


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("thesis_crt", "no built-in robot has this name; did you mean thesis_ctr or "),
        ("mine", "no built-in robot has this name; did you mean mine.yaml?"),
        ("zzz", "no built-in robot has this name; names are braunschweig_pair, crl_ctr, "),
        (
            "configs/robots/thesis_ctr.yaml",
            "no such file; use the built-in file by its name, ",
        ),
        ("below/zzz.yaml", "below/zzz.yaml: there is no such file"),
        ("below/thesis_ctr", "no such file; use the built-in file by its name, thesis_ctr"),
        ("", "this is a directory"),
    ],
)
def test_a_name_of_nothing_is_refused_with_the_nearest(typed: str, said: str, empty: Path) -> None:
    (empty / "mine.yaml").write_text("kind: concentric\n")
    with pytest.raises(InputError) as error:
        tubeopt.load_robot(typed)
    assert said in str(error.value)
    assert len(str(error.value).splitlines()) == 1


def test_names_of_nothing_in_a_study(empty: Path) -> None:
    (empty / "a.yaml").write_text("kind: inverse_kinematics\nrobot: thesis_ctr\ntargets: arcs\n")
    with pytest.raises(InputError, match=r"targets: arcs: there is no such file; did you mean arc\?$"):
        load_study("a.yaml")
    with pytest.raises(InputError, match="no built-in study has this name; did you mean thesis_snap"):
        load_study("thesis_snaps")
    with pytest.raises(InputError, match="no built-in rig has this name; did you mean thesis_steel"):
        tubeopt.load_rig("thesis_stel")
    with pytest.raises(InputError, match="there is no such file"):
        load_entry("push")
