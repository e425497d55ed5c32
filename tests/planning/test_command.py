"""`tubeopt plan` and `tubeopt verify`, trajectory files, and pictures."""

from __future__ import annotations

import json
import shutil
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.command_line import ROOT, THESIS, Run, answer, refused
from tubeopt import InputError, PlanOptions, SolveError, load_robot, plan_trajectory
from tubeopt.bodies.corridors import Corridor, MeshObstacle
from tubeopt.bodies.obstacles import Box
from tubeopt.planning.trajectory import load_trajectory
from tubeopt.show.plots.trajectory import animate_trajectory
from tubeopt.stability import ASSUMING

STUDY = ROOT / "configs" / "studies" / "plan_thesis_turn.yaml"

pytestmark = pytest.mark.usefixtures("short_films")


def test_a_plan_is_saved_drawn_and_verified(run: Run, tmp_path: Path) -> None:
    data = answer(
        run("plan", str(STUDY), "--objective", "none", "--json", "--out", str(tmp_path), "--format", "png,gif")
    )
    assert data["proof"]["proved"]
    assert data["proof"]["least_margin"] >= 0.05
    assert data["goal"]["rotations_deg"] == [270.0, 0.0, 0.0]
    for name in ("trajectory.png", "trajectory.gif"):
        with Image.open(tmp_path / name) as image:
            image.verify()
    table = tmp_path / "trajectory.csv"
    joints = load_trajectory(table)
    assert joints.rotations[-1, 0] == 1.5 * np.pi
    again = answer(run("verify", str(table), "--json", "--study", str(STUDY)))
    assert again["proved"]
    assert again["assumed"] == ASSUMING
    assert abs(again["least_margin"] - data["proof"]["least_margin"]) < 1e-6


def test_flags_replace_what_the_plan_study_says(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "little.csv"
    path.write_text("time_s,rotation_1_deg,rotation_2_deg,rotation_3_deg\n0,0,0,0\n10,200,0,0\n")
    requested = ("verify", str(path), "--robot", THESIS, "--study", str(STUDY))
    bare = answer(run(*requested, "--json"))
    assert bare["proved"]
    strict = run(*requested, "--min-margin", "0.99", "--json")
    assert strict.code == 3
    assert not json.loads(strict.out)["proved"]
    pushed = json.loads(run(*requested, "--tip-force-mN", "0,20,0", "--json").out)
    assert pushed["assumed"] != bare["assumed"]
    assert abs(pushed["least_margin"] - bare["least_margin"]) > 1e-5
    both = run(*requested, "--tip-force-mN", "0,5,0", "--max-tip-force-mN", "3")
    assert both.code == 3
    assert "nothing shows that no force of up to 3 mN on the tip snaps" in both.err


def test_a_trajectory_made_elsewhere_is_refuted(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "naive.csv"
    path.write_text("time_s,rotation_1_deg,rotation_2_deg,rotation_3_deg\n0,0,0,0\n10,270,0,0\n")
    outcome = run("verify", str(path), "--robot", THESIS, "--out", str(tmp_path), "--format", "svg")
    assert "snaps" in (tmp_path / "verified.svg").read_text()
    assert outcome.code == 3
    assert "the robot snaps" in outcome.err
    # The path before it is long, so that the line is broken anywhere.
    assert f"naive.csv is not proved, {ASSUMING}".replace(" ", "") in "".join(outcome.out.split())
    assert "has no robot" in refused(run("verify", str(path)))[0]
    path.write_text("rotation_1_deg,rotation_2_deg,rotation_4_deg\n0,0,0\n")
    report = refused(run("verify", str(path), "--robot", THESIS))
    assert any("column time_s is missing" in line for line in report)
    assert any("rotation_4_deg is not known" in line for line in report)


def test_wrong_studies_are_refused(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    path.write_text(f"kind: plan\nrobot: {THESIS}\n")
    assert "one goal must be given" in refused(run("plan", str(path)))[0]
    path.write_text(f"kind: plan\nrobot: {THESIS}\ngoal_deg: [500, 0, 0]\n")
    assert "goal_deg[0] is 500 deg; it must be from -360 to 360 deg" in refused(run("plan", str(path)))[0]
    snap = ROOT / "configs" / "studies" / "thesis_snap.yaml"
    assert "it must be plan" in refused(run("plan", str(snap)))[0]
    assert "must be plan; a robot is named by the key robot of such a file" in refused(run("plan", THESIS))[0]


@pytest.fixture
def coarse_grids(monkeypatch: pytest.MonkeyPatch) -> None:
    """Distances from meshes that are exact for the nearest point of a call, and told by a table for the others, are
    asked one by one: the table may be small."""
    monkeypatch.setattr("tubeopt.bodies.corridors.CELLS", 6)


@pytest.mark.usefixtures("coarse_grids")
def test_distances_from_a_corridor_and_a_mesh() -> None:
    vessel = Corridor(((0.0, 0.0, 0.0), (0.0, 0.0, 0.1), (0.1, 0.0, 0.1)), 0.01)
    points = np.array([[0.0, 0.0, 0.05], [0.004, 0.0, 0.05], [0.05, 0.02, 0.1], [0.0, 0.0, -0.02]])
    np.testing.assert_allclose(vessel.signed_distance(points), [0.01, 0.006, -0.01, -0.01], atol=1e-12)
    np.testing.assert_allclose(vessel.distance(*points.T), vessel.signed_distance(points), atol=1e-5)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * 0.02
    sides = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)]
    sides += [(2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
    cube = MeshObstacle(tuple(map(tuple, corners.tolist())), tuple(sides))
    for point, distance in (((0.01, 0.01, 0.03), 0.01), ((0.01, 0.01, 0.012), -0.008), ((0.2, 0.01, 0.01), 0.18)):
        assert abs(float(cube.signed_distance(np.array([point]))[0]) - distance) < 1e-9


@pytest.mark.usefixtures("coarse_grids")
def test_the_mesh_of_a_box_has_the_distance_of_the_box() -> None:
    """At faces, edges and corners, inside and outside; its triangles are cut on the way."""
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.creation.box(extents=(0.02, 0.02, 0.04))
    body = MeshObstacle(tuple(map(tuple, mesh.vertices.tolist())), tuple(map(tuple, mesh.faces.tolist())))
    box = Box((-0.01, -0.01, -0.02), (0.01, 0.01, 0.02))
    points = np.random.default_rng(0).uniform(-0.04, 0.04, (400, 3))
    points[:3] = [0.02, 0.02, 0.03], [0.02, 0.015, 0.0], [0.0, 0.0, 0.0]
    results = np.concatenate([body.signed_distance(point[None]) for point in points])
    np.testing.assert_allclose(results, box.signed_distance(points), atol=1e-12)


def test_films_end_in_a_known_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = plan_trajectory(
        load_robot(THESIS), ([0.0] * 3, None), ([0.1, 0.0, 0.0], None), options=PlanOptions(objective="none")
    )
    monkeypatch.setattr("matplotlib.animation.writers.is_available", lambda name: False)
    with pytest.raises(InputError, match="MP4 needs ffmpeg"):
        animate_trajectory(plan, tmp_path / "film.mp4")
    with pytest.raises(InputError, match=r"must end in \.gif or \.mp4"):
        animate_trajectory(plan, tmp_path / "film.avi")
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="MP4 needs ffmpeg")
def test_a_film_in_mp4(tmp_path: Path) -> None:
    plan = plan_trajectory(
        load_robot(THESIS), ([0.0] * 3, None), ([0.1, 0.0, 0.0], None), options=PlanOptions(objective="none")
    )
    film = animate_trajectory(plan, tmp_path / "film.mp4", frames=5)
    assert film.read_bytes()[4:8] == b"ftyp"
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]


def test_a_search_that_runs_out_of_time_saves_what_it_found(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    partial = plan_trajectory(
        load_robot(THESIS), ([0.0] * 3, None), ([0.1, 0.0, 0.0], None), options=PlanOptions(objective="none")
    )

    def late(*_: object) -> None:
        raise SolveError("no plan was found within 1 s", partial)

    monkeypatch.setattr("tubeopt.runs.plan_study.PlanStudy.run", late)
    outcome = run("plan", str(STUDY), "--out", str(tmp_path / "out"))
    assert outcome.code == 3
    assert "no plan was found within 1 s; partial result" in outcome.err
    assert not (tmp_path / "out" / "trajectory.csv").exists()
    again = answer(run("verify", str(tmp_path / "out" / "partial" / "trajectory.csv"), "--json"))
    assert again["proved"]


def test_two_arms_are_planned_saved_and_drawn(run: Run, tmp_path: Path) -> None:
    study = ROOT / "configs" / "studies" / "plan_two_arms.yaml"
    report = answer(
        run("plan-arms", str(study), "--objective", "none", "--out", str(tmp_path), "--json", "--format", "png,gif")
    )
    assert report["proved"]
    assert [arm["name"] for arm in report["arms"]] == ["left", "right"]
    (pair,) = report["pairs"]
    assert pair["arms"] == [1, 2]
    assert 0.5 <= pair["least_clearance_mm"] <= pair["measured_clearance_mm"]
    for name in (
        "arm_1/robot.yaml",
        "arm_2/trajectory.csv",
        "between_arms.csv",
        "plan_arms.json",
        "arms.png",
        "arms.gif",
    ):
        assert (tmp_path / name).stat().st_size > 0
    if find_spec("viser") is not None:
        page = (tmp_path / "arms.html").read_text(encoding="utf-8")
        assert "<title>left and right, tubeopt</title>" in page
        assert "__VISER_EMBED_DATA__" in page
    _, measured, proved = np.loadtxt(tmp_path / "between_arms.csv", delimiter=",", skiprows=1).T
    assert measured.min() >= pair["least_clearance_mm"]
    assert proved.min() == pytest.approx(pair["least_clearance_mm"], abs=1e-5)
    assert (proved <= measured).all()
    assert (proved[:-1] <= measured[1:]).all()
    assert [arm["roll_deg"] for arm in report["arms"]] == pytest.approx([0, 0])
    assert answer(run("verify", str(tmp_path / "arm_1" / "trajectory.csv"), "--json"))["proved"]


def test_goals_of_arms_that_make_no_study_are_refused(run: Run, tmp_path: Path) -> None:
    arm = {"robot": str(ROOT / "configs" / "robots" / "crl_ctr.yaml")}
    study = tmp_path / "study.yaml"
    for arms, message in (
        ([arm], "arms has 1 item; it must have at least 2"),
        ([arm, arm | {"tip_mm": [1, 2, 3], "goal_deg": [0, 0, 0]}], "several goals"),
        ([arm, arm | {"tip_at": "carina"}], "'carina' is not a landmark of the anatomy; it has no landmarks"),
        ([arm, arm | {"goal_deg": [1, 2]}], "has 2 numbers; it must be 3"),
    ):
        study.write_text(json.dumps({"kind": "plan_arms", "arms": arms}))
        assert any(message in line for line in refused(run("plan-arms", str(study))))
