"""A roadmap answers again and again, forgets what other bodies made true, and is its own robot's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import tubeopt
from tests.command_line import ROOT
from tubeopt import InputError, PlanOptions
from tubeopt.bodies.images import field_of_image
from tubeopt.bodies.obstacles import Sphere
from tubeopt.bodies.phantoms import LUMEN, TARGET, kidney
from tubeopt.inverse.clock import Clock
from tubeopt.inverse.search import without_corners
from tubeopt.planning import plan_trajectory
from tubeopt.planning.motion import DEFAULT_RATES
from tubeopt.planning.question import plan_task
from tubeopt.planning.roadmap import build_roadmap, load_roadmap

ROBOT = tubeopt.load_robot(ROOT / "configs" / "robots" / "crl_ctr.yaml")
OPTIONS = PlanOptions(clearance=2e-4)


def test_a_roadmap_is_asked_again_and_again(tmp_path: Path) -> None:
    image = kidney().image(1e-3)
    body = field_of_image(image, lumen=image.chosen([LUMEN, TARGET]))
    roadmap = build_roadmap(ROBOT, obstacles=[body], options=OPTIONS, count=60)
    assert len(roadmap) == 60
    task = plan_task(ROBOT, [body], 0.05, DEFAULT_RATES, None, OPTIONS)
    assert task.holds(roadmap.points).all()
    deep = np.argsort(-task.arms(roadmap.points).tip[:, 2])
    start, goal = roadmap.points[deep[-1]], roadmap.points[deep[0]] + 1e-4
    first = roadmap.shortest_path(task, start, [goal], Clock(60))
    assert first.points is not None
    assert task.path(first.points)
    again = roadmap.shortest_path(task, start, [goal], Clock(60))
    assert again.points is not None
    assert np.array_equal(again.points, first.points)
    assert again.motions <= 3  # from the start, to the goal, and the straight one
    middle = task.arms(first.points[len(first.points) // 2][None]).tip[0]
    task = plan_task(ROBOT, [body, Sphere(tuple(middle.tolist()), 1e-3)], 0.05, DEFAULT_RATES, None, OPTIONS)
    other = roadmap.shortest_path(task, start, [goal], Clock(60))
    assert other.points is None or task.path(other.points)
    roadmap.save(tmp_path / "map.npz")
    loaded = load_roadmap(tmp_path / "map.npz")
    assert np.array_equal(loaded.points, roadmap.points)
    thesis = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    task = plan_task(thesis, [], 0.05, DEFAULT_RATES, None, OPTIONS)
    with pytest.raises(InputError, match="the roadmap is of another robot"):
        loaded.shortest_path(task, start, [goal], Clock(1))
    (tmp_path / "map.npz").write_bytes(b"no map")
    with pytest.raises(InputError, match="read the roadmap"):
        load_roadmap(tmp_path / "map.npz")


def test_plans_over_a_roadmap_are_proved() -> None:
    roadmap = build_roadmap(ROBOT, options=PlanOptions(seed=1), count=40)
    start = ([0.0, 0.0, 0.0], [-0.02, -0.08, -0.09])
    goal = tubeopt.forward_kinematics(ROBOT, [0.4, 1.0, -0.5], [0.02, -0.04, -0.08])
    plan = plan_trajectory(ROBOT, start, goal, options=PlanOptions(roadmap=roadmap))
    assert plan.proved
    assert plan.statistics.how == "roadmap"
    with pytest.raises(InputError, match="roadmap is 3; it must be a Roadmap"):
        PlanOptions(roadmap=3)  # type: ignore[arg-type]


def test_a_place_of_the_tip_is_planned_for_from_the_map_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    image = kidney().image(1e-3)
    free = image.chosen([LUMEN, TARGET])
    body = field_of_image(image, lumen=free)
    roadmap = build_roadmap(ROBOT, obstacles=[body], options=OPTIONS, count=80)
    task = plan_task(ROBOT, [body], 0.05, DEFAULT_RATES, None, PlanOptions(clearance=1e-3))
    roomy = task.arms(roadmap.points[task.holds(roadmap.points)]).tip
    start = np.zeros(3), np.array([-0.033, -0.092, -0.096])
    position = roomy[np.argmax(roomy[:, 2])] + [5e-4, -5e-4, 0.0]
    near = roadmap.near(task, position, 3)
    away = np.linalg.norm(task.arms(roadmap.points).tip - position, axis=1)
    assert np.array_equal(near, roadmap.points[np.argsort(away)[:3]])

    def never(*_: object, **__: object) -> None:
        raise AssertionError("joint values are those beside the map, and no other way is searched for")

    monkeypatch.setattr("tubeopt.planning.goals.inverse_kinematics", never)
    monkeypatch.setattr("tubeopt.planning.plan.find_path", never)
    quick = PlanOptions(clearance=2e-4, objective="none", roadmap=roadmap)
    plan = plan_trajectory(ROBOT, start, position, obstacles=[body], options=quick)
    assert plan.proved
    assert plan.statistics.how == "roadmap"
    assert plan.proof.least_clearance >= 2e-4
    assert np.linalg.norm(plan.tip_position[-1] - position) < 1e-8
    for arm in plan.arms:
        index = np.rint(image.frame.seen(arm.position) / image.spacing).astype(int)
        assert free[tuple(index.T)].all()


def test_a_way_does_without_corners_that_it_can_pass_straight() -> None:
    task = plan_task(ROBOT, [], 0.05, DEFAULT_RATES, None, PlanOptions())
    first = task.coordinates.space.join(np.zeros(3), np.array([-0.02, -0.08, -0.09]))
    last = first + task.scale * [0.1, 0.1, 0.1, 0.0, 0.0, 0.0]
    corner = (first + last) / 2 + task.scale * [0.1, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert np.array_equal(without_corners(task, np.stack([first, corner, last])), [first, last])
    assert np.array_equal(without_corners(task, np.stack([first, last])), [first, last])
