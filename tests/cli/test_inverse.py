"""`tubeopt ik`: its numbers, its words, what it saves, and how it fails."""

from __future__ import annotations

import csv
import json
import time
from pathlib import Path

import numpy as np
import pytest

from tests.command_line import ROOT, THESIS, Run, answer, refused
from tubeopt import InputError, follow, forward_kinematics, load_equilibrium, load_robot
from tubeopt.bodies.obstacles import Box, Capsule, HalfSpace, Sphere
from tubeopt.robots.file import load_waypoints
from tubeopt.runs.inverse_study import load_joints, load_targets
from tubeopt.runs.study_file import load_study
from tubeopt.runs.surroundings_file import load_obstacles

ETR = str(ROOT / "configs" / "robots" / "thesis_etr.yaml")
TARGET = ("--target-mm", "50,30,150")


pytestmark = pytest.mark.usefixtures("own_tables")


def test_help_has_an_example_and_the_common_flags(run: Run) -> None:
    outcome = run("ik", "--help")
    assert outcome.code == 0
    for part in ("Example: tubeopt ik ", "--json", "--out", "--target-mm", "--direction", "--from", "--all"):
        assert part in outcome.out


def test_tip_reaches_target(run: Run) -> None:
    (result,) = answer(run("ik", THESIS, *TARGET, "--json"))["solutions"]
    robot = load_robot(THESIS)
    tip = forward_kinematics(
        robot, np.radians(result["rotations_deg"]), np.array(result["translations_mm"]) / 1e3
    ).tip_position
    np.testing.assert_allclose(tip * 1e3, [50, 30, 150], atol=1e-4)
    np.testing.assert_allclose(result["tip_position_mm"], [50, 30, 150], atol=1e-4)
    assert result["status"] == "REACHED"
    assert result["margin"] >= 0.05


def test_a_table_for_people(run: Run) -> None:
    outcome = run("ik", THESIS, *TARGET, "--from", str(ROOT / "configs/joints/thesis_start.yaml"))
    assert outcome.code == 0
    for part in (
        "the target is reached in a stable",
        "tip position",
        "50.000000, 30.000000, 150.000000 mm",
        "snap-free path",
        "straight from the seed",
    ):
        assert part in outcome.out


def test_all_postures_are_saved_with_a_picture(run: Run, tmp_path: Path) -> None:
    out = tmp_path / "out"
    outcome = run("ik", THESIS, *TARGET, "--all", "--starts", "12", "--out", str(out))
    assert outcome.code == 0
    assert "other postures with the same tip" in outcome.out
    assert sorted(p.name for p in out.iterdir()) == [
        "arrays.npz",
        "inverse.png",
        "path.csv",
        "result.json",
        "solutions.json",
    ]
    best, *others = json.loads((out / "solutions.json").read_text())["solutions"]
    assert others
    # The waypoints lead to the best of them without a snap.
    waypoints = load_waypoints(out / "path.csv", load_robot(THESIS))
    path = follow(load_robot(THESIS), waypoints.rotations, waypoints.translations)
    assert not path.snaps
    np.testing.assert_allclose(path.equilibria[-1].tip_position * 1e3, [50, 30, 150], atol=1e-3)
    assert best["reachable"]
    assert len(best["path"]["rotations_deg"]) == len(waypoints.rotations)
    np.testing.assert_allclose(load_equilibrium(out).tip_position * 1e3, best["tip_position_mm"], atol=1e-9)
    assert (out / "inverse.png").read_bytes().startswith(b"\x89PNG")


def test_a_table_of_targets_is_followed(run: Run, tmp_path: Path) -> None:
    targets = str(ROOT / "configs/targets/arc.csv")
    outcome = run("ik", THESIS, "--targets", targets, "--follow", "--out", str(tmp_path))
    assert outcome.code == 0
    assert "21 of 21 targets" in outcome.out
    assert sorted(p.name for p in tmp_path.iterdir()) == ["solutions.csv", "targets.png"]
    rows = list(csv.DictReader((tmp_path / "solutions.csv").read_text().splitlines()))
    assert len(rows) == 21
    assert [row["target"] for row in rows] == [str(k) for k in range(1, 22)]
    assert not any(row["jump"] for row in rows)
    robot, before = load_robot(THESIS), None
    for row in rows:
        rotations = np.radians([float(row[f"rotation_{i}_deg"]) for i in (1, 2, 3)])
        translations = np.array([float(row[f"translation_{i}_mm"]) for i in (1, 2, 3)]) / 1e3
        before = forward_kinematics(robot, rotations, translations, start=before)
        desired = [float(row[name]) for name in ("x_mm", "y_mm", "z_mm")]
        np.testing.assert_allclose(before.tip_position * 1e3, desired, atol=1e-4)


def test_far_targets_get_inserted_targets(run: Run, tmp_path: Path) -> None:
    table = tmp_path / "targets.csv"
    table.write_text("x_mm,y_mm,z_mm\n50,30,150\n62,20,145\n")
    data = answer(run("ik", THESIS, "--targets", str(table), "--follow", "--json"))
    assert (data["targets"], data["reached"]) == (2, 2)
    numbers = [each["target"] for each in data["solutions"]]
    assert (numbers[0], numbers[-1]) == (1, 2)
    assert numbers == sorted(numbers)
    first, last = np.array([50, 30, 150]), np.array([62, 20, 145])
    for each in data["solutions"]:
        np.testing.assert_allclose(each["tip_position_mm"], first + (each["target"] - 1) * (last - first), atol=1e-3)
        assert each["jump"] == ""


def test_targets_out_of_reach_are_named_in_the_table(run: Run, tmp_path: Path) -> None:
    table = tmp_path / "targets.csv"
    table.write_text("x_mm,y_mm,z_mm\n0,-20,80\n0,0,200\n")
    requested = ("ik", ETR, "--targets", str(table), "--starts", "1")
    data = answer(run(*requested, "--json"))
    assert (data["targets"], data["reached"]) == (2, 1)
    assert "short" in data["solutions"][1]["problem"]
    data = answer(run(*requested, "--closest", "--json"))
    assert data["targets"] == 2
    assert data["solutions"][1]["status"] == "CLOSEST"
    outcome = run(*requested, "--out", str(tmp_path / "out"))
    assert outcome.code == 0
    assert "target 2: target not reached" in outcome.out
    rows = list(csv.DictReader((tmp_path / "out" / "solutions.csv").read_text().splitlines()))
    assert [row["status"] for row in rows] == ["REACHED", "FAILED"]
    assert "short" in rows[1]["problem"]
    table.write_text("x_mm,y_mm,z_mm\n0,0,200\n")
    outcome = run(*requested)
    assert outcome.code == 3
    assert "none of 1 targets was reached; the first: target not reached" in outcome.err
    outcome = run(*requested, "--closest")
    assert outcome.code == 3
    assert "none of 1 targets was reached; the first: 106 mm short" in outcome.err


def test_obstacles_are_kept_clear_of(run: Run) -> None:
    bodies = str(ROOT / "configs/obstacles/two_bodies.yaml")
    (result,) = answer(run("ik", THESIS, *TARGET, "--obstacles", bodies, "--clearance-mm", "1", "--json"))["solutions"]
    assert result["clearance_mm"] >= 1.0


def test_target_beside_plate_ends_with_time_limit(run: Run) -> None:
    pieces = str(ROOT / "configs" / "robots" / "example_pieces.yaml")
    start_time = time.perf_counter()
    outcome = run("ik", pieces, "--target-mm", "0.030,0.010,0.045", "--time-limit-s", "0.05")
    assert time.perf_counter() - start_time < 60
    assert outcome.code == 3
    text = " ".join(outcome.err.split())
    assert "was 30, 10, 45 meant?" in text
    assert "within 0.05 s" in text
    assert "whether the target can be reached is not known" in text


def test_end_at_a_time_limit_names_its_flag(run: Run) -> None:
    outcome = run("snap", "till_snapping_pair", "--to-deg", "360,0", "--time-limit-s", "0.0001")
    assert outcome.code == 3
    assert "time limit of 0.0001 s" in outcome.err
    assert "--time-limit-s" in outcome.err


def test_postures_omitted_by_time_limit_are_reported(run: Run) -> None:
    some = run("ik", THESIS, *TARGET, "--all", "--json", "--time-limit-s", "1.5", "--starts", "9000")
    assert answer(some)["timed_out"]
    assert not answer(run("ik", THESIS, *TARGET, "--all", "--json", "--starts", "2"))["timed_out"]


def test_a_target_out_of_reach_fails_with_3(run: Run) -> None:
    requested = ("ik", ETR, "--target-mm", "0,0,200", "--starts", "2")
    outcome = run(*requested)
    assert outcome.code == 3
    assert "mm short" in outcome.err
    outcome = run(*requested, "--closest", "--json")
    (message,) = answer(outcome, 3)["error"]["messages"]
    assert message.startswith("target not reached; the closest pose is shown: 106 mm short")
    (result,) = json.loads(outcome.out)["solutions"]
    assert result["status"] == "CLOSEST"
    assert result["position_error_mm"] == pytest.approx(106, abs=0.5)


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ((), "--target-mm and --targets are missing; one of them must be given"),
        (("--target-mm", "1,2"), "--target-mm has 2 numbers; it must have 3"),
        (("--target-mm", "1,2,x"), "--target-mm[2] is 'x'; it must be a number"),
        ((*TARGET, "--min-margin", "1"), "--min-margin is 1; it must be less than 1"),
        ((*TARGET, "--objective", "best"), "--objective is 'best'; it must be nearest, margin or curvature"),
        ((*TARGET, "--objective", "nearest"), "objective is nearest; it needs a start"),
        ((*TARGET, "--follow"), "follow is for a table of targets"),
        ((*TARGET, "--direction-weight", "1"), "--direction-weight is given without a direction"),
        ((*TARGET, "--from", "none.yaml"), "none.yaml: there is no such file"),
        ((*TARGET, "--direction", "0,0,0"), "direction is (0, 0, 0); it must have a direction"),
    ],
)
def test_wrong_flags_are_refused(run: Run, arguments: tuple[str, ...], problem: str) -> None:
    assert problem in " ".join(refused(run("ik", THESIS, *arguments)))


def test_the_example_study_runs() -> None:
    study = load_study(ROOT / "configs/studies/thesis_inverse.yaml")
    result = study.model_copy(update={"starts": 6}).run()
    assert result.solutions
    assert all(each.clearance >= 1e-3 for each in result.solutions)


class TestFiles:
    def test_every_kind_of_obstacle(self, tmp_path: Path) -> None:
        path = tmp_path / "bodies.yaml"
        path.write_text(
            "obstacles:\n"
            "  - {kind: sphere, centre_mm: [1, 2, 3], radius_mm: 4}\n"
            "  - {kind: capsule, start_mm: [0, 0, 0], end_mm: [0, 0, 10], radius_mm: 1}\n"
            "  - {kind: half_space, point_mm: [0, 0, -5], normal: [0, 0, 2]}\n"
            "  - {kind: box, low_mm: [0, 0, 0], high_mm: [1, 1, 1]}\n"
        )
        assert load_obstacles(str(path)) == (
            Sphere((0.001, 0.002, 0.003), 0.004),
            Capsule((0, 0, 0), (0, 0, 0.01), 0.001),
            HalfSpace((0, 0, -0.005), (0, 0, 1)),
            Box((0, 0, 0), (0.001, 0.001, 0.001)),
        )

    @pytest.mark.parametrize(
        ("text", "problem"),
        [
            ("obstacles: [{kind: ball}]", "kind must be one of sphere, capsule, half_space, box"),
            ("obstacles: [{kind: sphere, centre_mm: [1, 2], radius_mm: 4}]", "centre_mm has 2 numbers"),
            ("obstacles: [{kind: sphere, centre_mm: [1, 2, 3], radius_mm: 0}]", "radius_mm is 0"),
            ("obstacles: [{kind: box, low_mm: [0, 0, 0], high_mm: [0, 1, 1]}]", "low must be less than high"),
        ],
    )
    def test_obstacles_that_are_none(self, tmp_path: Path, text: str, problem: str) -> None:
        path = tmp_path / "bodies.yaml"
        path.write_text(text)
        with pytest.raises(InputError, match=problem):
            load_obstacles(str(path))

    @pytest.mark.parametrize(
        ("text", "problem"),
        [
            ("x_mm,y_mm\n1,2\n", "column z_mm is missing"),
            ("x_mm,y_mm,z_mm,w\n1,2,3,4\n", "column w is not known"),
            ("x_mm,y_mm,z_mm,direction_x\n1,2,3,4\n", "column direction_y is missing; it must be there since"),
            ("x_mm,y_mm,z_mm\n1,2,a\n", "column z_mm is 'a'; it must be a number"),
            ("x_mm,y_mm,z_mm,direction_x,direction_y,direction_z\n1,2,3,0,0,0\n", "a direction must have a length"),
        ],
    )
    def test_targets_that_are_none(self, tmp_path: Path, text: str, problem: str) -> None:
        path = tmp_path / "targets.csv"
        path.write_text(text)
        with pytest.raises(InputError, match=problem):
            load_targets(path)

    def test_joints(self, tmp_path: Path) -> None:
        robot, path = load_robot(THESIS), tmp_path / "joints.yaml"
        path.write_text("rotations_deg: [10, 20, 30]\ntranslations_mm: [1, 2, 3]\n")
        rotations, translations = load_joints(path, robot)
        np.testing.assert_allclose(np.degrees(rotations), [10, 20, 30])
        np.testing.assert_allclose(translations, [0.001, 0.002, 0.003])
        path.write_text("rotations_deg: [10, 20]\n")
        with pytest.raises(InputError, match="rotations_deg has 2 numbers; it must be 3"):
            load_joints(path, robot)
        path.write_text("rotations: [10, 20, 30]\n")
        with pytest.raises(InputError, match=r"rotations_deg is missing(.|\n)*did you mean 'rotations_deg'"):
            load_joints(path, robot)
        path.write_text("rotations_deg: [10, 20, x]\n")
        with pytest.raises(InputError, match=r"rotations_deg\[2\] is 'x'; it must be a number"):
            load_joints(path, robot)
