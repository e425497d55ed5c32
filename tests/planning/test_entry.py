"""Entry point and direction free: where the plate is put, and that what is planned from there holds in the patient."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tubeopt
from tests.command_line import ROOT, Run, answer, refused
from tubeopt import EntryRegion, InputError, PlanOptions, SolveError
from tubeopt.bodies.obstacles import Sphere
from tubeopt.runs.surroundings_file import load_pose

CRL = tubeopt.load_robot(ROOT / "configs" / "robots" / "crl_ctr.yaml")
START = (np.zeros(3), np.array([-0.02, -0.08, -0.09]))
GOAL = np.array([0.012, 0.0, 0.07])


def test_places_lie_in_the_region_and_point_into_the_cone() -> None:
    region = EntryRegion(radius=5e-3, cone=0.3)
    frames = region.frames(256)
    points, z = np.array([f.origin for f in frames]), np.array([f.axes[:, 2] for f in frames])
    assert (points[0] == 0).all()
    assert (z[0] == [0, 0, 1]).all()
    assert np.linalg.norm(points, axis=1).max() <= 5e-3 + 1e-12
    assert (points[:, 2] == 0).all()
    assert z[:, 2].min() >= np.cos(0.3) - 1e-12
    # Evenly: half of a disc lies within 1 / sqrt(2) of its radius, half of a cap within half of its height.
    assert np.median(np.linalg.norm(points, axis=1)) == pytest.approx(5e-3 / np.sqrt(2), rel=0.05)
    assert np.median(1 - z[:, 2]) == pytest.approx((1 - np.cos(0.3)) / 2, rel=0.05)
    box = np.array([f.origin for f in EntryRegion(box=(1e-3, 0.0, 2e-3)).frames(64)])
    assert (np.abs(box).max(0) <= [1e-3, 0, 2e-3]).all()
    two = EntryRegion(positions=np.array([[0, 0, 1e-3], [0, 0, 2e-3]]), cone=0.2).frames(8)
    assert {f.origin[2] for f in two} == {1e-3, 2e-3}
    assert [f.axes[2, 2] for f in two[:2]] == [1.0, 1.0]
    assert len(EntryRegion(positions=np.eye(3)).frames(2)) == 3, "each of them, however few are asked for"
    with pytest.raises(InputError, match="entry has 1000000 base poses to check; it must have at most 16384"):
        region.frames(10**6)


def test_a_plate_that_is_blocked_is_moved_and_all_holds_where_it_was_said() -> None:
    """A ball lies on the plate as it is given; the tip ends at the goal, and the arm keeps off the ball, in the frame
    in which both are written."""
    ball = Sphere((0.0, 0.0, 0.004), 0.004)
    options = PlanOptions(clearance=5e-4, objective="none", time_limit=600)
    requested: dict[str, Any] = {"obstacles": [ball], "options": options}
    with pytest.raises(SolveError):
        tubeopt.plan_trajectory(CRL, START, GOAL, **requested)
    plan = tubeopt.plan_from_region(CRL, START, GOAL, EntryRegion(radius=0.01, cone=0.2), count=32, **requested)
    assert plan.proved
    assert plan.entry is not None
    frame = plan.entry.frame
    assert 0.0045 < np.linalg.norm(frame.origin) <= 0.01
    np.testing.assert_allclose(frame.placed(plan.tip_position[-1]), GOAL, atol=1e-6)
    for arm in plan.arms:
        away = np.linalg.norm(frame.placed(arm.position) - ball.centre, axis=1)
        assert away.min() > ball.radius + options.clearance
    with pytest.raises(SolveError, match=r"from the 8 checked .* at the start"):
        tubeopt.plan_from_region(CRL, START, GOAL, EntryRegion(radius=1e-3), count=8, **requested)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "the entry has"),
        ({"radius": 1e-3, "box": (1e-3, 0.0, 0.0)}, "several regions"),
        ({"cone": 2.0}, "cone of the entry is 114.592 deg"),
        ({"radius": -1.0}, "radius of the entry is -1"),
        ({"box": (1e-3, 0.0)}, "must be 3 numbers"),
        ({"positions": np.zeros((0, 3))}, "positions of the entry"),
    ],
)
def test_what_is_no_region_is_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        EntryRegion(**given)


@pytest.mark.usefixtures("short_films")
def test_a_study_saves_where_the_plate_stands(run: Run, tmp_path: Path) -> None:
    study = {
        "kind": "plan",
        "robot": str(ROOT / "configs" / "robots" / "crl_ctr.yaml"),
        "start_mm": [-20, -80, -90],
        "tip_mm": (GOAL * 1e3).tolist(),
        "obstacles": [{"centre_mm": [0, 0, 4], "radius_mm": 4}],
        "entry": {"radius_mm": 10, "cone_deg": 10, "places": 16},
        "cut": {"at_mm": [0, 0, 30], "normal": [1, 1, 0.2]},
        "clearance_mm": 0.5,
        "objective": "none",
        "time_limit_s": 600,
    }
    path = tmp_path / "study.yaml"
    path.write_text(json.dumps(study))
    report = answer(run("plan", str(path), "--out", str(tmp_path), "--json"))
    frame = load_pose(tmp_path / "base.txt")
    np.testing.assert_allclose(frame.origin * 1e3, report["entry"]["patient_position_mm"], atol=1e-9)
    np.testing.assert_allclose(frame.placed(np.array(report["tip_position_mm"]) * 1e-3), GOAL, atol=1e-6)
    assert report["entry"]["considered"] == 16 >= report["entry"]["clear"] >= report["entry"]["tried"] >= 1
    assert (tmp_path / "section.png").stat().st_size > 0
    for change, message in (
        ({"cut": {"at_mm": [0, 0, 30]}}, "cut must give at_mm and normal, or through"),
        ({"cut": {"at_mm": [0, 0, 30], "normal": [0, 0, 0]}}, "normal of the plane is 0, 0, 0"),
        ({"cut": {"through": ["carina", "mouth"]}}, "'carina' is"),
        ({"leader": True}, "entry is given with leader"),
        ({"entry": {"at": ["carina"]}}, "'carina' is"),
        ({"entry": {}}, "the entry has"),
    ):
        path.write_text(json.dumps(study | change))
        lines = refused(run("plan", str(path)))
        assert any(message in line for line in lines), lines
