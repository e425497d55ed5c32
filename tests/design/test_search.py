"""Designs for what has no derivative: found within their requirements, and led by a planner."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import tubeopt
from tests.command_line import ROOT, Run, answer, refused
from tests.design.tasks import two_tubes
from tests.planning.test_anatomy import WITHDRAWN, write_case
from tubeopt import ConcentricRobot, DesignTask, InputError, PlanOptions, RegionReach, search_design
from tubeopt.bodies.obstacles import Sphere
from tubeopt.design import Free, Objective, Poses, SnapFree, Strain
from tubeopt.typing import Array

CRL = ROOT / "configs" / "robots" / "crl_ctr.yaml"


class Bent:
    """Curvature of the inner tube over 100/m, and a number of its own that is best at 0.3."""

    description = "curvature"
    ranges = np.array([[-1.0, 1.0]])

    def __call__(self, robot: ConcentricRobot, own: Array) -> tuple[float, float]:
        value = robot.tubes[0].curvature / 100
        return float(np.clip(1 - value + (own[0] - 0.3) ** 2, 0, 1)), value


def test_a_search_ends_at_the_strain_that_is_allowed() -> None:
    robot = two_tubes()
    task = DesignTask(robot, (Free("curvature", (0, 1), 1.0, 60.0),), (Strain((0.012,)),), ordered=False)
    result = search_design(task, Bent(), time_limit=60)
    largest = (
        2 * 0.012 / 1.012 / robot.tubes[0].outer_diameter
    )  # held straight, where its inside was shorter by as much
    assert result.value.tubes[0].curvature == pytest.approx(min(largest, 60.0), rel=5e-3)
    assert result.value.tubes[0].curvature <= largest * (1 + 1e-6)
    assert result.variables == pytest.approx([0.3], abs=0.02)
    assert result.after > result.before
    assert result.solution.verification.satisfied


def test_what_a_search_does_not_take_is_refused() -> None:
    robot = two_tubes()
    free = (Free("curvature", (0,), 1.0, 20.0),)
    posed = DesignTask(robot, free, (Poses(((0.0, 0.0),), ((0.0, 0.0),)),), Objective("change"), ordered=False)
    boxed = DesignTask(robot, free, (SnapFree(0.05, box=((-0.01, -0.01), (0.0, 0.0))),), ordered=False)
    for task, text in ((posed, "the task has poses"), (boxed, "snap_free has a box or a force")):
        with pytest.raises(InputError, match=text):
            search_design(task, Bent(), time_limit=1)


def test_a_plate_that_is_moved_sees_all_else_moved() -> None:
    """A robot that stands elsewhere reaches what it reached, when region and bodies stand there too."""
    robot = tubeopt.load_robot(CRL)
    tips = np.array(
        [tubeopt.forward_kinematics(robot, [a, 0.3, 0.0], [0.0, -0.05, -0.09]).tip_position for a in (0, 1)]
    )
    body = Sphere((0.0, 0.05, 0.06), 0.01)
    options = PlanOptions(clearance=2e-4, time_limit=60)
    plain = RegionReach(WITHDRAWN, tips, (body,), options=options, count=40)
    current = RegionReach(WITHDRAWN, tips, (body,), options=options, count=40, shift=2e-3, tilt=0.1)
    assert plain.ranges.shape == (0, 2)
    own = np.array([1e-3, -2e-3, 5e-4, 0.05, -0.02])
    frame = current.base(own)
    assert frame.axes @ [0, 0, 1] == pytest.approx([-0.02, -0.05, 1], abs=2e-3)
    reached = RegionReach(
        WITHDRAWN, frame.placed(tips), (Sphere(tuple(frame.placed(body.centre)), 0.01),), options=options, count=40,
        shift=2e-3, tilt=0.1,
    )  # fmt: skip
    assert reached.evaluate(robot, own).miss == pytest.approx(plain.evaluate(robot, np.zeros(0)).miss, abs=1e-9)


def study(directory: Path, **objective: Any) -> Path:
    if not (directory / "anatomy.yaml").exists():
        write_case(directory)
    path = directory / "design.yaml"
    requested = {
        "kind": "reach_share",
        "anatomy": "anatomy.yaml",
        "start_mm": [-33, -92, -96],
        "places": 2,
        "judged": 2,
    }
    content = {
        "kind": "design", "robot": str(CRL), "ordered": False, "requirements": {"strain": {"limits_percent": [3]}},
        "free": [{"tubes": [1, 2, 3], "curvature_per_m": [2, 50]}],
        "objective": requested | {"points": 12, "seconds": 0.2, "tilt_deg": 5} | objective,
    }  # fmt: skip
    path.write_text(yaml.safe_dump(content))
    return path


@pytest.mark.usefixtures("small_maps")
def test_a_region_is_the_aim_of_a_study(run: Run, tmp_path: Path) -> None:
    report = answer(run("design", str(study(tmp_path)), "--json", "--out", str(tmp_path / "out")))
    region = report["region"]
    assert region["places"] == 2
    assert region["tried"] >= 1
    assert region["searched_after"] >= region["searched_before"]
    assert region["proved"] == region["planned"]
    assert np.linalg.norm(region["base_direction"]) == pytest.approx(1)
    page = (tmp_path / "out" / "report.md").read_text()
    before, after = (round(100 * region[key]) for key in ("before", "after"))
    assert f"at least {before} % before, at least {after} % after, of 2 places not searched with" in page
    assert "objective | share of the region" in page
    assert "change" not in page
    assert report["objectives"] == {"reach_share": region["after"]}
    assert any("roadmap is too small to decide" in text for text in report["remarks"]) == (region["after"] <= 0.05)


def test_regions_that_make_no_study_are_refused(run: Run, tmp_path: Path) -> None:
    for wrong, text in (
        ({"judged": 10**6}, "objective.judged is 1000000; it must be at most 1000"),
        ({"judged": 1000}, "has a target"),
        ({"start_mm": [1, 2]}, "start_mm has 2 numbers; it must be 3"),
        ({"depth_mm": 3}, "objective.depth_mm is not a known key"),
    ):
        assert any(text in line for line in refused(run("design", str(study(tmp_path, **wrong)))))
