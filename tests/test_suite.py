"""The public benchmark: its questions, the model that judges, and what it says of right and wrong answers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tubeopt
from benchmarks.suite import model
from benchmarks.suite.questions import KINDS, MM, questions, robots, scenes, withdrawn
from benchmarks.suite.score import Answers, arm_of, look, plans, score, table
from benchmarks.suite.solve import ANSWERS, bodies_of, robot_of
from tubeopt.typing import Array

TWO_TUBE = tubeopt.load_robot(Path(__file__).resolve().parents[1] / "configs" / "robots" / "two_tube.yaml")


def judged(robot: Any) -> model.Robot:
    """A robot of tubeopt as the model that judges has it."""
    names = (
        "outer_diameter", "inner_diameter", "straight_length", "curved_length", "curvature", "bending_stiffness",
        "torsional_stiffness",
    )  # fmt: skip
    return model.Robot(robot.name, *(np.array([float(getattr(tube, name)) for tube in robot.tubes]) for name in names))


def first(kind: str, **wanted: str) -> dict[str, Any]:
    """The first question of a kind, of a robot or scene."""
    return next(one for one in questions(kind) if all(one[key] == value for key, value in wanted.items()))


def why(question: dict[str, Any], answer: dict[str, Any]) -> str:
    """What the judge says of one answer."""
    answers: Answers = {question["id"]: {"id": question["id"], "seconds": 1.0, **answer}}
    kind = question["id"].split()[0]
    return next(one.why for one in score(answers, [kind]) if one.id == question["id"])


def test_questions_are_as_many_as_promised_and_speak_of_what_there_is() -> None:
    counts = {kind: list(questions(kind)) for kind in KINDS}
    assert {kind: len(some) for kind, some in counts.items()} == {"inverse": 1000, "plan": 200, "design": 20}
    every = [one for some in counts.values() for one in some]
    assert len({one["id"] for one in every}) == 1220
    assert {one["robot"] for one in every} == set(robots())
    assert {one["scene"] for one in every} == set(scenes())
    assert {robot.n for robot in robots().values()} == {2, 3, 4}
    text = {name.rstrip(" 0123456789") for name in scenes()}
    assert {"free", "bronchial tree", "ventricle", "kidney"} < text


@pytest.mark.parametrize("name", ["two_tubes", "crl_ctr", "four_tubes"])
def test_the_model_that_judges_agrees_with_forward_kinematics(name: str) -> None:
    robot, ours = robots()[name], robot_of(name)
    random = np.random.default_rng(5)
    beta = withdrawn(robot) + random.uniform(0.02, 0.05, (3, 1))
    turned = random.uniform(-np.pi, np.pi, (3, robot.n))
    shifts = beta + robot.straight_length
    solved = [tubeopt.forward_kinematics(ours, a, d) for a, d in zip(turned, shifts, strict=True)]
    z = np.array([one.tip_rotations for one in solved])
    result = model.integrate(robot, z, beta)
    assert np.abs(result.rotations - turned).max() < 1e-6
    assert np.abs(result.tip - [one.tip_position for one in solved]).max() < 1e-7
    assert result.stable.all()
    assert model.margins(robot, z, beta) == pytest.approx([one.margin for one in solved], abs=2e-3)


def test_a_snap_is_found_where_it_is_known() -> None:
    """Of the pair of closed form: 203.90356628 deg from home."""
    robot = judged(TWO_TUBE)
    paths = [np.array([[0, 0, -0.05, -0.05], [np.radians(end), 0, -0.05, -0.05]]) for end in (360.0, 203.0)]
    snapped, free = model.follow(robot, paths, np.zeros((2, 2)))
    assert 360 * snapped.share == pytest.approx(203.90356628, abs=0.05)
    assert free.share == 1


def test_a_right_answer_is_kept_and_wrong_ones_are_not() -> None:
    question = first("inverse", scene="free", robot="crl_ctr")
    answer = ANSWERS["inverse"](question)
    assert why(question, answer) == ""
    turned = {**answer, "rotations_deg": [x + 5 for x in answer["rotations_deg"]]}
    assert why(question, turned) == "tip rotations that are not of these joint values"
    both = {**turned, "tip_rotations_deg": [x + 5 for x in answer["tip_rotations_deg"]]}
    assert why(question, both) == "place of the tip"
    assert why(question, {"failed": "out of reach"}) == "out of reach"
    assert why(question, {"rotations_deg": [0]}).startswith("no pose")
    other = next(one for one in questions("inverse") if one["robot"] == "crl_ctr" and "direction" in one)
    assert "direction" in why(other, {**answer}) or "place" in why(other, {**answer})


def test_an_arm_in_a_wall_is_told() -> None:
    robot, scene = robots()["crl_ctr"], scenes()["kidney 1"]
    beta = withdrawn(robot)[None] + 0.06
    result = model.integrate(robot, np.zeros((1, 3)), beta)
    answer = {
        "rotations_deg": np.degrees(result.rotations[0]).tolist(),
        "tip_rotations_deg": [0.0, 0.0, 0.0],
        "translations_mm": ((beta[0] + robot.straight_length) / MM).tolist(),
    }
    (pose,) = look(robot, [(scene, arm_of(robot, answer))])
    assert pose.why == "clearance"
    assert pose.clearance < 0


def test_walls_are_the_same_for_solver_and_judge() -> None:
    random = np.random.default_rng(2)
    for name, scene in scenes().items():
        if scene.free:
            assert bodies_of(name) == ()
            continue
        points: Array = random.uniform([-0.05, -0.05, -0.02], [0.05, 0.05, 0.11], (500, 3))
        assert bodies_of(name)[0].signed_distance(points) == pytest.approx(scene.depth(points), abs=1e-12)


def test_a_plan_is_followed_to_its_goal_and_one_that_stops_short_is_told() -> None:
    question = first("plan", robot="two_tubes", scene="free")
    answer = ANSWERS["plan"](question)
    joints = {key: answer[key] for key in ("rotations_deg", "translations_mm")}
    inputs = {
        "whole": joints,
        "short": {key: value[:-5] for key, value in joints.items()},
        "late": {key: value[5:] for key, value in joints.items()},
    }
    answers = {name: {"id": name, "seconds": 1.0, **each} for name, each in inputs.items()}
    report = plans(robots()["two_tubes"], [{**question, "id": name} for name in inputs], answers)
    assert {one.id: one.why for one in report} == {"whole": "", "short": "goal", "late": "start"}


def test_a_design_that_snaps_is_told() -> None:
    question = next(one for one in questions("design") if one["kind"] == "snap_free" and one["robot"] == "crl_ctr")
    bend = robots()["crl_ctr"].curvature
    answer = ANSWERS["design"](question)
    assert why(question, answer) == ""
    assert why(question, {"curvature_per_m": (9 * bend).tolist()}) == "curvatures out of their range"


def test_the_table_counts_what_was_answered() -> None:
    rows = table(score({}, ["design"])).splitlines()
    assert any(row.startswith("| design | cannot snap | 0 of 8 | 0 |") for row in rows)
