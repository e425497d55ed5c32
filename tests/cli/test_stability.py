"""The commands about stability: their numbers, their words, what they save, and how they fail."""

from __future__ import annotations

import functools
import json
import shlex
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from tests.command_line import CRL, ROOT, THESIS, Run, answer, refused
from tests.stability.robots import inner_and_middle
from tubeopt import (
    ConcentricRobot,
    InputError,
    JointLimits,
    SnapSearch,
    SolveError,
    find_snap,
    load_robot,
    snap_free_certificate,
    snap_in_time,
    worst_certificate,
)
from tubeopt.runs import stability_studies
from tubeopt.runs.study_file import load_study
from tubeopt.show.plots import animate_snap
from tubeopt.stability import ASSUMING

COMMANDS = ["equilibria", "snap", "follow", "certify", "stability-map"]
TWO = str(ROOT / "configs" / "robots" / "two_tube.yaml")
ETR = str(ROOT / "configs" / "robots" / "thesis_etr.yaml")
SNAP_DEG = 214.222427
DEG = np.pi / 180
PNG = b"\x89PNG"


def saved(directory: Path, *names: str) -> None:
    """These files and no others are in the directory, none of them empty, pictures as PNG."""
    assert sorted(path.name for path in directory.iterdir()) == sorted(names)
    for name in names:
        content = (directory / name).read_bytes()
        assert content.startswith(PNG) if name.endswith(".png") else content


def one_line(text: str) -> str:
    return " ".join(text.split())


# --- help -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_with_an_example_and_the_common_flags(run: Run, command: str) -> None:
    outcome = run(command, "--help")
    assert outcome.code == 0
    for part in (f"Example: tubeopt {command} ", "--json", "--out"):
        assert part in outcome.out


@pytest.mark.parametrize("command", COMMANDS)
def test_the_examples_of_the_help_work(run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, command: str) -> None:
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    monkeypatch.chdir(tmp_path)
    example = one_line(run(command, "--help").out).split("Example: tubeopt ")[1].split()
    small = ["--samples", "3", "--directions", "4", "--workers", "1"] if command == "stability-map" else []
    assert run(*example, *small).code == 0


# --- equilibria -------------------------------------------------------------------------------------------------------


def test_three_equilibria_of_the_inner_and_middle_tube(run: Run, tmp_path: Path) -> None:
    robot, out = tmp_path / "robot.yaml", tmp_path / "out"
    inner_and_middle().save(robot)
    data = answer(run("equilibria", str(robot), "--rotations-deg", "150,0", "--json", "--out", str(out)))
    result = data["equilibria"]
    apart = [np.subtract(*each["tip_rotations_deg"]) for each in result]
    assert sorted(apart) == pytest.approx([39.43309191, 208.31500100, 294.34122683], abs=1e-7)
    assert {round(a): each["stable"] for a, each in zip(apart, result, strict=True)} == {
        39: True,
        208: False,
        294: True,
    }
    assert [each["index"] for each in result] == [0, 0, 1]
    assert [each["margin"] > 0 for each in result] == [True, True, False]
    energies = [each["energy_mJ"] for each in result]
    assert energies == sorted(energies)
    saved(out, "equilibria.json", "equilibria.png")
    written = json.loads((out / "equilibria.json").read_text(encoding="utf-8"))
    assert written == {key: value for key, value in data.items() if key not in ("files", "warnings")}


def test_equilibria_as_a_table(run: Run) -> None:
    outcome = run("equilibria", TWO, "--rotations-deg", "190,0")
    assert outcome.code == 0
    assert "two tubes: 3 equilibria (2 stable) at rotations 190, 0 deg" in one_line(outcome.out)
    lines = [line.split() for line in outcome.out.splitlines()]
    assert [line[-1] for line in lines[-3:]] == ["stable", "stable", "unstable"]


# --- snap -------------------------------------------------------------------------------------------------------------


def test_the_snap_of_the_thesis_robot(run: Run, tmp_path: Path) -> None:
    data = answer(run("snap", THESIS, "--to-deg", "360,0,0", "--json", "--out", str(tmp_path)))
    snap = data["snap"]
    assert snap["rotations_deg"] == pytest.approx([SNAP_DEG, 0, 0], abs=1e-5)
    assert snap["fraction"] == pytest.approx(SNAP_DEG / 360, abs=1e-7)
    assert snap["before"]["tip_rotations_deg"] == pytest.approx([130.231722, 20.009537, 3.579333], abs=1e-4)
    assert snap["before"]["margin"] == pytest.approx(0, abs=1e-9)
    jump = np.subtract(snap["after"]["tip_position_mm"], snap["before"]["tip_position_mm"])
    assert snap["tip_jump_mm"] == pytest.approx(np.linalg.norm(jump), rel=1e-12)
    assert snap["energy_released_mJ"] == pytest.approx(snap["before"]["energy_mJ"] - snap["after"]["energy_mJ"])
    assert snap["energy_released_mJ"] > 0
    assert snap["after"]["stable"]
    assert data["arrived"] is None
    saved(tmp_path, "snap.json", "snap.png")


def test_a_snap_in_words(run: Run) -> None:
    text = one_line(run("snap", THESIS, "--to-deg", "360,0,0").out)
    for part in ("thesis CTR snaps 59.506230 % of the path, at rotations 214.222427, 0, 0 deg", "the tip jumps 97.97"):
        assert part in text


def test_joint_path_without_snap(run: Run, tmp_path: Path) -> None:
    outcome = run("snap", THESIS, "--from-deg", "-90,0,0", "--to-deg", "90,0,0", "--out", str(tmp_path))
    assert outcome.code == 0
    assert "does not snap: the branch reaches the end of the path, with margin 1.000" in one_line(outcome.out)
    saved(tmp_path, "snap.json", "snap.png")
    written = json.loads((tmp_path / "snap.json").read_text(encoding="utf-8"))
    assert written["snap"] is None
    assert written["arrived"]["stable"]


def test_joint_values_that_are_not_given_stay(run: Run) -> None:
    data = answer(run("snap", THESIS, "--from-deg", "200,0,0", "--from-mm", "-20,0,0", "--to-mm", "60,0,0", "--json"))
    assert data["to_deg"] == pytest.approx([200, 0, 0])
    assert data["to_mm"] == pytest.approx([60, 0, 0])
    data = answer(run("snap", THESIS, "--from-mm", "-20,0,0", "--to-deg", "90,0,0", "--json"))
    assert data["to_mm"] == pytest.approx([-20, 0, 0])


def test_the_example_study(run: Run) -> None:
    data = answer(run("run", str(ROOT / "configs" / "studies" / "thesis_snap.yaml"), "--json"))
    assert data["snap"]["rotations_deg"] == pytest.approx([SNAP_DEG, 0, 0], abs=1e-5)


# --- follow -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def there_and_back(tmp_path: Path) -> str:
    """The inner tube of three to 240 deg and back."""
    path = tmp_path / "path.csv"
    path.write_text(
        "rotation_1_deg,rotation_2_deg,rotation_3_deg\n0,0,0\n200,0,0\n240,0,0\n100,0,0\n", encoding="utf-8"
    )
    return str(path)


def test_follow_there_and_back(run: Run, tmp_path: Path, there_and_back: str) -> None:
    out = tmp_path / "out"
    data = answer(run("follow", THESIS, there_and_back, "--json", "--out", str(out)))
    forth, back = data["snaps"]
    assert (forth["after_waypoint"], back["after_waypoint"]) == (2, 3)
    assert forth["rotations_deg"][0] == pytest.approx(SNAP_DEG, abs=1e-5)
    # By symmetry the way back is the way forth of a robot that was turned once.
    assert back["rotations_deg"][0] == pytest.approx(360 - SNAP_DEG, abs=1e-5)
    assert [each["rotations_deg"][0] for each in data["waypoints"]] == pytest.approx([0, 200, 240, 100])
    saved(out, "path.csv", "snaps.json", "path.png")
    header, *rows = (out / "path.csv").read_text(encoding="utf-8").splitlines()
    assert header == (
        "waypoint,rotation_1_deg,rotation_2_deg,rotation_3_deg,translation_1_mm,translation_2_mm,translation_3_mm,"
        "tip_x_mm,tip_y_mm,tip_z_mm,margin"
    )
    at_waypoints = [row.split(",")[:7] for row in rows if float(row.split(",")[0]).is_integer()]
    assert at_waypoints == [[str(k + 1), a, *"00000"] for k, a in enumerate(["0", "200", "240", "100"])]
    assert [float(x) for x in rows[0].split(",")[7:]] == pytest.approx([0, -90.75837047, 164.83462233, 1], abs=1e-6)
    dense = np.array([[float(x) for x in row.split(",")] for row in rows])
    waypoint, rotation, tip, margin = dense[:, 0], dense[:, 1], dense[:, 7:10], dense[:, 10]
    np.testing.assert_allclose(rotation, np.interp(waypoint, [1, 2, 3, 4], [0, 200, 240, 100]), atol=1e-5)
    jumps = np.flatnonzero(np.diff(waypoint) == 0)
    np.testing.assert_allclose(margin[jumps], 0, atol=1e-6)
    jump = np.linalg.norm(tip[jumps + 1] - tip[jumps], axis=1)
    np.testing.assert_allclose(jump, [snap["tip_jump_mm"] for snap in data["snaps"]], atol=1e-6)
    assert np.diff(waypoint).max() <= 0.25
    assert json.loads((out / "snaps.json").read_text(encoding="utf-8"))["snaps"] == data["snaps"]


def test_follow_in_words(run: Run, there_and_back: str) -> None:
    text = one_line(run("follow", THESIS, there_and_back).out)
    for part in ("thesis CTR: 4 waypoints, 2 snaps", "2 to 3", "214.2224, 0, 0", "3 to 4", "145.7776, 0, 0"):
        assert part in text


def test_follow_without_a_snap(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "path.csv"
    path.write_text(
        "rotation_1_deg,rotation_2_deg,translation_1_mm,translation_2_mm\n0,0,0,0\n30,0,-5,0\n", encoding="utf-8"
    )
    outcome = run("follow", TWO, str(path), "--out", str(tmp_path / "out"))
    assert "two tubes: 2 waypoints, no snap" in one_line(outcome.out)
    saved(tmp_path / "out", "path.csv", "snaps.json", "path.png")


# --- certify ----------------------------------------------------------------------------------------------------------


def scaled(robot: ConcentricRobot, certificate: float, path: Path) -> str:
    """Save the robot with curvatures at which its certificate is this; 1 - mu goes with their square."""
    factor = np.sqrt((1 - certificate) / (1 - snap_free_certificate(robot)))
    tubes = tuple(replace(tube, curvature=factor * tube.curvature) for tube in robot.tubes)
    replace(robot, tubes=tubes).save(path)
    return str(path)


def concentric(path: str) -> ConcentricRobot:
    robot = load_robot(path)
    assert isinstance(robot, ConcentricRobot)
    return robot


def test_certify_a_robot_that_cannot_snap(run: Run, tmp_path: Path) -> None:
    robot = scaled(concentric(TWO), 0.25, tmp_path / "robot.yaml")
    data = answer(run("certify", robot, "--json", "--out", str(tmp_path / "out")))
    # For two tubes the certificate is exact, so that search finds what is proved.
    assert data["answer"] == f"cannot snap at any rotation (margin 0.25 proved; 0.25 found), {ASSUMING}"
    assert data["exit_code"] == 0
    assert data["within_limits"] is None
    assert data["finding"] == "SNAP_FREE"
    assert data["certificate"] == pytest.approx(0.25, abs=1e-9)
    assert data["margin_found"] == pytest.approx(0.25, abs=1e-6)
    assert data["limiting_tubes"] == [1, 2]
    assert data["limiting_section_mm"] == pytest.approx([0, 100])
    assert data["shares"] == [{"tubes": [1, 2], "share": pytest.approx(1)}]
    assert data["snap"] is None
    assert data["repeat"].startswith("tubeopt equilibria ")
    saved(tmp_path / "out", "certificate.json")
    text = one_line(run("certify", robot).out)
    assert "can snap" not in text
    assert "assuming no external load, weight or friction" in text


def test_certify_a_robot_that_snaps_with_the_command_to_repeat_it(run: Run, tmp_path: Path) -> None:
    data = answer(run("certify", THESIS, "--json", "--out", str(tmp_path)), 3)
    assert data["answer"] == (
        "can snap: from rotations 0, 0, 0 deg towards 360, 0, 0 deg, at 214.222427, 0, 0 deg (least margin found "
        f"-0.956; certificate -0.996), {ASSUMING}"
    )
    assert data["exit_code"] == 3
    assert data["within_limits"] is True
    assert data["rotation_limits_deg"] == [pytest.approx([-360, 360])] * 3
    assert data["path_deg"] == [pytest.approx([0, 0, 0]), pytest.approx([360, 0, 0])]
    assert data["margin_found"] == pytest.approx(-0.95567, abs=1e-5)
    assert data["limiting_tubes"] == [1, 2]
    assert data["limiting_section_mm"] == pytest.approx([0, 100])
    assert sum(each["share"] for each in data["shares"]) == pytest.approx(1)
    saved(tmp_path, "certificate.json", "snap.png")
    program, *command = shlex.split(data["repeat"])
    assert program == "tubeopt"
    again = answer(run(*command, "--json"))
    assert again["snap"]["rotations_deg"] == pytest.approx(data["snap"]["rotations_deg"], abs=1e-8)


def test_the_command_that_repeats_a_snap_is_printed_in_one_line(run: Run) -> None:
    lines = run("certify", THESIS, "--translations-mm", "-10,0,2.5").out.splitlines()
    (command,) = (line.strip() for line in lines if line.strip().startswith("tubeopt snap "))
    assert command == f"tubeopt snap {THESIS} --from-deg 0,0,0 --to-deg 360,0,0 --from-mm -10,0,2.5"
    assert run(*command.split()[1:]).code == 0


def test_certify_undecided(run: Run, tmp_path: Path) -> None:
    scaled(concentric(THESIS), -0.01, tmp_path / "robot.yaml")
    study = tmp_path / "study.yaml"
    study.write_text("kind: certify\nrobot: robot.yaml\n", encoding="utf-8")
    data = answer(run("run", str(study), "--json"), 4)
    assert data["finding"] == "OPEN"
    assert data["exit_code"] == 4
    assert data["answer"] == (
        f"not proved (certificate -0.01), and search found no snap (least margin found 0.0104), {ASSUMING}"
    )
    assert data["snap"] is None
    assert shlex.split(data["repeat"])[2] == str(tmp_path / "robot.yaml")
    assert data["paths_tried"] > 30


def turned(limit: float, path: Path) -> str:
    """Save the two tubes that snap 203.904 deg apart with so much room (deg) for each to either side."""
    robot = concentric(TWO)
    ranges = ((-limit * DEG, limit * DEG),) * 2
    replace(robot, joint_limits=JointLimits(ranges, robot.limits.translations)).save(path)
    return str(path)


def test_a_snap_that_only_both_tubes_together_reach_is_inside_the_limits(run: Run, tmp_path: Path) -> None:
    data = answer(run("certify", turned(102, tmp_path / "robot.yaml"), "--json"), 3)
    assert data["within_limits"] is True
    assert "limits" not in data["answer"]
    inner, outer = data["snap"]["rotations_deg"]
    assert inner - outer == pytest.approx(203.90356628, abs=1e-6)
    assert max(abs(inner), abs(outer)) <= 102
    assert np.abs(data["path_deg"]).max() <= 102 + 1e-9
    again = answer(run(*shlex.split(data["repeat"])[1:], "--json"))
    assert again["snap"]["rotations_deg"] == pytest.approx([inner, outer], abs=1e-6)


def test_snap_beyond_limits_is_reported_as_outside(run: Run, tmp_path: Path) -> None:
    robot = turned(101.9, tmp_path / "robot.yaml")
    data = answer(run("certify", robot, "--json"), 3)
    assert data["finding"] == "CAN_SNAP"
    assert data["within_limits"] is False
    assert data["answer"].startswith("can snap, but only beyond its joint limits: from rotations 0, 0 deg towards")
    text = one_line(run("certify", robot).out)
    assert "-101.9 to 101.9, -101.9 to 101.9 deg; the snap is beyond" in text


def test_the_help_and_a_study_say_how_certify_ends(run: Run, tmp_path: Path) -> None:
    text = one_line(run("certify", "--help").out)
    assert f"{ASSUMING}." in text
    assert "Exit code 0: proved that it cannot snap. 3: a snap was found. 4: undecided." in text
    study = tmp_path / "study.yaml"
    for certificate, code in ((0.1, 0), (-0.9, 3)):
        scaled(concentric(THESIS), certificate, tmp_path / "robot.yaml")
        study.write_text("kind: certify\nrobot: robot.yaml\n", encoding="utf-8")
        assert answer(run("run", str(study), "--json"), code)["exit_code"] == code


def test_the_gradient_is_per_unit_of_its_column(run: Run) -> None:
    data = answer(run("certify", CRL, "--translations-mm", "-20,0,0", "--json"))
    robot = concentric(CRL)

    def changed(tubes: Any = robot.tubes, shift: tuple[float, float, float] = (-20.0, 0.0, 0.0)) -> float:
        return snap_free_certificate(ConcentricRobot(tuple(tubes)), np.array(shift) / 1e3)

    step = 0.01
    shorter, longer = (
        changed([replace(robot.tubes[0], curved_length=robot.tubes[0].curved_length + s * 1e-3), *robot.tubes[1:]])
        for s in (-step, step)
    )
    assert data["gradient"]["curved_length_mm"][0] == pytest.approx((longer - shorter) / (2 * step), rel=1e-3)
    less, more = (changed(shift=(-20 + s, 0.0, 0.0)) for s in (-step, step))
    assert data["gradient"]["translation_mm"][0] == pytest.approx((more - less) / (2 * step), rel=1e-3)
    table = run("certify", CRL, "--translations-mm", "-20,0,0").out
    assert "cannot snap at any rotation (margin 0.198 proved; 0.205 found)" in one_line(table)
    assert f"{data['gradient']['curvature_per_m'][0]:.4g}" in table


def test_certify_a_box(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    soon = partial(worst_certificate, effort=SnapSearch(evaluations=30))
    monkeypatch.setattr("tubeopt.runs.stability_studies.worst_certificate", soon)
    bounds = ["--lower-mm", "-20,0,0", "--upper-mm", "-15,0,0"]
    data = answer(run("certify", CRL, *bounds, "--json"))
    robot = concentric(CRL)
    samples = [snap_free_certificate(robot, [shift, 0, 0]) for shift in np.linspace(-0.02, -0.015, 6)]
    assert data["certificate"] <= min(samples) + 1e-9
    assert data["certificate"] == pytest.approx(min(samples), abs=1e-3)
    assert data["box"]["lower_mm"] == pytest.approx([-20, 0, 0])
    assert data["box"]["upper_mm"] == pytest.approx([-15, 0, 0])
    assert data["box"]["evaluations"] > 10
    assert "DIRECT" in data["box"]["method"]
    text = one_line(run("certify", CRL, *bounds).out)
    assert "that search found. A certificate is a proof for its own translations, not for the box." in text
    assert f"{data['box']['evaluations']} evaluations" in text


def test_certify_reports_assumptions_of_proof(run: Run) -> None:
    text = one_line(run("certify", ETR).out)
    assert "thesis ETR cannot snap at any rotation (proved, also at 0.336 of its torsional stiffness)" in text
    assert "the share of torsional stiffness that may be lost with the proof still valid" in text
    assert "change of the certificate" in text


# --- stability map ----------------------------------------------------------------------------------------------------


def test_stability_map(run: Run, tmp_path: Path) -> None:
    flags = ["--samples", "5", "--directions", "8", "--tubes", "1,2"]
    data = answer(run("stability-map", THESIS, *flags, "--json", "--out", str(tmp_path)))
    saved(tmp_path, "map.npz", "stability_map.png")
    with np.load(tmp_path / "map.npz") as stored:
        assert stored["tubes"].tolist() == [0, 1]
        np.testing.assert_allclose(stored["angles"], np.linspace(-np.pi, np.pi, 5))
        assert stored["margin"].shape == stored["snaps"].shape == (5, 5)
        assert stored["margin"][2, 2] == pytest.approx(1)
        assert stored["margin"].min() == pytest.approx(data["least_margin"])
        boundary = np.degrees(stored["boundary"])
        assert stored["translations"].tolist() == [0, 0, 0]
    snap = find_snap(load_robot(THESIS), ([0, 0, 0], None), (np.radians([-180, 180, 0]), None))
    assert snap is not None
    (requested,) = np.flatnonzero(np.isclose(data["directions_deg"], 135.0))
    assert boundary[requested] == pytest.approx(np.degrees(snap.rotations[:2]), abs=1e-6)
    assert data["nearest_snap_deg"] == pytest.approx(boundary[requested], abs=1e-6)
    assert data["tubes"] == [1, 2]


def test_stability_map_in_words(run: Run) -> None:
    outcome = run("stability-map", THESIS, "--samples", "3", "--directions", "8", "--workers", "1")
    text = one_line(outcome.out)
    for part in (
        "thesis CTR: stability map",
        "% of all directions",
        "the nearest snap at -115.439849, 115.439849 deg",
    ):
        assert part in text
    assert outcome.err == ""


def test_a_bar_tells_the_progress_where_somebody_looks(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    outcome = run("stability-map", THESIS, "--samples", "6", "--directions", "8", "--workers", "0", "--json")
    assert "mapping the margin" in outcome.err
    assert json.loads(outcome.out)["samples"] == 6


# --- studies ----------------------------------------------------------------------------------------------------------


def test_every_kind_of_study_runs(run: Run, tmp_path: Path) -> None:
    (tmp_path / "waypoints.csv").write_text("rotation_1_deg,rotation_2_deg,rotation_3_deg\n0,0,0\n10,0,0\n")
    questions = {
        "equilibria": "rotations_deg: [10, 0, 0]",
        "snap": "to_deg: [10, 0, 0]",
        "follow": "path: waypoints.csv",
        "certify": "translations_mm: [0, 0, 0]",
        "stability_map": "samples: 2\ndirections: 4\nworkers: 1\ntubes: [2, 3]",
    }
    for kind, keys in questions.items():
        study = tmp_path / f"{kind}.yaml"
        study.write_text(f"kind: {kind}\nrobot: {THESIS}\n{keys}\n", encoding="utf-8")
        load_study(study)
        assert answer(run("run", str(study), "--json"), 3 if kind == "certify" else 0)["robot"] == "thesis CTR"


# --- failures ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (
            ["equilibria", THESIS, "--rotations-deg", "1,2"],
            "--rotations-deg has 2 numbers; it must be 3 (one per tube)",
        ),
        (["equilibria", THESIS, "--translations-mm", "a,0,0"], "--translations-mm[0] is 'a'; it must be a number"),
        (["snap", THESIS, "--to-deg", "1"], "--to-deg has 1 number; it must be 3 (one per tube)"),
        (["snap", THESIS, "--to-mm", "0,nan,0"], "--to-mm[1] is NaN; it must be a finite number"),
        (
            ["snap", THESIS, "--from-deg", "1,0,0", "--to-deg", "1,0,0"],
            "start and end are the same joint values; give other values for --to-deg or --to-mm",
        ),
        (
            ["snap", THESIS, "--to-mm", "300,0,0"],
            "--to-mm has 300 for tube 1; it must be at most its straight length, 200, where it is clamped",
        ),
        (["follow", THESIS, "none.csv"], "none.csv: there is no such file"),
        (
            ["certify", THESIS, "--translations-mm", "1,2"],
            "--translations-mm has 2 numbers; it must be 3 (one per tube)",
        ),
        (
            ["certify", THESIS, "--box", "--translations-mm", "0,0,0"],
            "--translations-mm are given as well as a box of translations; give one of them",
        ),
        (
            ["certify", THESIS, "--lower-mm", "5,0,0", "--upper-mm", "0,0,0"],
            "--lower-mm: lower translation of tube 1 is 5 mm; it must be at most upper, 0 mm",
        ),
        (["stability-map", TWO], "the robot has 2 tubes; a map over two relative rotations needs at least 3"),
        (["stability-map", THESIS, "--tubes", "1,4"], "--tubes is [1, 4]; it must be two different tubes from 1 to 3"),
        (["stability-map", THESIS, "--tubes", "1,1"], "--tubes is [1, 1]; it must be two different tubes from 1 to 3"),
        (["stability-map", THESIS, "--tubes", "1,1.5"], "--tubes[1] is 1.5; it must be a whole number"),
        (["stability-map", THESIS, "--samples", "1"], "--samples is 1; it must be at least 2"),
        (["stability-map", THESIS, "--workers", "x"], "--workers is 'x'; it must be a number"),
    ],
)
def test_wrong_input_is_refused_in_one_sentence(run: Run, arguments: list[str], problem: str) -> None:
    assert refused(run(*arguments)) == [problem]


@pytest.mark.parametrize("command", COMMANDS)
def test_a_robot_that_is_not_there(run: Run, command: str, there_and_back: str) -> None:
    path = [there_and_back] if command == "follow" else []
    assert refused(run(command, "none.yaml", *path)) == ["none.yaml: there is no such file"]


def test_bad_cells_are_named_with_their_rows(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "path.csv"
    path.write_text("rotation_1_deg,rotation_2_deg,rotation_3_deg\n0,0,0\n1,x,0\n2,0,\n", encoding="utf-8")
    assert refused(run("follow", THESIS, str(path))) == [
        f"{path}: row 2 (line 3), column rotation_2_deg is 'x'; it must be a number",
        f"{path}: row 3 (line 4), column rotation_3_deg is empty; it must be a number",
    ]
    path.write_text("rotation_1_deg,rotation_2_deg,rotations_3_deg\n0,0,0\n", encoding="utf-8")
    assert "did you mean 'rotation_3_deg'?" in refused(run("follow", THESIS, str(path)))[0]


def unreachable(*arguments: Any, **options: Any) -> None:
    raise AssertionError("work was done before the request was checked")


def test_a_directory_that_cannot_be_written_is_refused_before_the_work(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    # Help texts are read from the signature of the function that is replaced.
    replaced = functools.wraps(stability_studies.stability_map)(functools.partial(unreachable))
    monkeypatch.setattr(stability_studies, "stability_map", replaced)
    file = tmp_path / "file"
    file.touch()
    assert refused(run("stability-map", THESIS, "--out", str(file))) == [
        f"{file}: nothing can be saved there: it is a file"
    ]
    (problem,) = refused(run("stability-map", THESIS, "--out", str(file / "x" / "y")))
    assert problem == f"{file}/x/y: nothing can be saved there: {file} is a file, not a directory"


def test_without_a_solution_nothing_is_saved(run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def fail(*arguments: Any, **options: Any) -> None:
        raise SolveError("the branch ends at 12.000 % of the path, and energy descent from there finds no equilibrium")

    monkeypatch.setattr(stability_studies, "find_snap", fail)
    outcome = run("snap", THESIS, "--to-deg", "360,0,0", "--out", str(tmp_path / "out"))
    assert outcome == (
        3,
        "",
        "error: the branch ends at 12.000 % of the path, and energy descent from there finds no equilibrium\n",
    )
    assert not (tmp_path / "out").exists()


def test_an_interrupted_picture_leaves_nothing_half_written(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def interrupted(figure: Figure, path: Path, **options: object) -> None:
        path.write_bytes(PNG)
        raise KeyboardInterrupt

    monkeypatch.setattr(Figure, "savefig", interrupted)
    assert run("snap", THESIS, "--to-deg", "360,0,0", "--out", str(tmp_path)).code == 130
    saved(tmp_path, "snap.json")
    json.loads((tmp_path / "snap.json").read_text(encoding="utf-8"))


# --- snap in time -----------------------------------------------------------------------------------------------------

IN_TIME = (
    "snap",
    CRL,
    "--to-deg",
    "360,0,0",
    "--in-time",
    "--quasi-static-bending",
    "--relaxation-us",
    "20",
    "--rates-deg-per-s",
    "10000,0,0",
)
RATES = np.radians([1e4, 0.0, 0.0])


def test_a_snap_in_time_is_shown_saved_and_drawn(run: Run, tmp_path: Path) -> None:
    record = answer(run(*IN_TIME, "--duration-ms", "1.5", "--json"))["in_time"]
    robot = load_robot(CRL)
    snap = find_snap(robot, (np.zeros(3), None), (np.radians([360, 0, 0]), None))
    assert snap is not None
    moving = snap_in_time(snap, bending_inertia=False, relaxation=2e-5, duration=1.5e-3, rates=RATES)
    assert record["duration_ms"] == pytest.approx(1e3 * moving.duration)
    assert record["peak_speed_m_per_s"] == pytest.approx(moving.peak_speed)
    assert record["swept_area_mm2"] == pytest.approx(1e6 * moving.swept_area)
    assert record["swept_volume_cm3"] == pytest.approx(1e6 * moving.swept_volume)
    assert record["damping"] == "given"
    assert record["status"] == str(moving.status)
    outcome = run(*IN_TIME, "--duration-ms", "1.5", "--out", str(tmp_path / "out"))
    assert outcome.code == 0
    assert "time of the snap" in one_line(outcome.out)
    saved(tmp_path / "out", "snap.json", "snap.png", "snap_in_time.csv", "snap_in_time.png")
    header, *table = (tmp_path / "out" / "snap_in_time.csv").read_text().splitlines()
    assert header.startswith("time_ms,tip_x_mm,tip_y_mm,tip_z_mm,tip_rotation_1_deg")
    assert len(table) == moving.statistics.steps + 1
    last = [float(cell) for cell in table[-1].split(",")]
    np.testing.assert_allclose(last[1:4], 1e3 * moving.tip_position[-1], rtol=1e-6)


def test_a_film_of_a_snap_in_time(tmp_path: Path) -> None:
    snap = find_snap(load_robot(CRL), (np.zeros(3), None), (np.radians([360, 0, 0]), None))
    assert snap is not None
    moving = snap_in_time(snap, bending_inertia=False, relaxation=2e-5, duration=1.5e-3, rates=RATES)
    moving = replace(moving, arms=moving.arms[::40], arm_times=moving.arm_times[::40])
    assert animate_snap(moving, tmp_path / "snap.gif").read_bytes().startswith(b"GIF")
    with pytest.raises(InputError, match=r"must end in \.gif or \.mp4"):
        animate_snap(moving, tmp_path / "snap.avi")


@pytest.mark.parametrize("flag", ["--relaxation-us=2", "--duration-ms=3", "--friction", "--rates-deg-per-s=1,0,0"])
def test_flags_of_a_snap_in_time_need_it(run: Run, flag: str) -> None:
    (message,) = refused(run("snap", CRL, "--to-deg", "360,0,0", flag))
    assert "it is for a snap in time" in message
