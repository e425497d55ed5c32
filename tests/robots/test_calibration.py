"""The calibration of a robot's drives: readings and joint values of the model, in the file and on the command line."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.command_line import ROOT, Run, answer
from tubeopt import InputError, JointLimits, forward_kinematics, load_robot
from tubeopt.planning.trajectory import joint_trajectory, load_trajectory, save_trajectory
from tubeopt.robots.calibration import Calibration
from tubeopt.runs.study_file import load_study

ROBOTS = ROOT / "configs" / "robots"


def drives(n: int) -> Calibration:
    """Drives that do not read true."""
    return replace(
        Calibration.none(n),
        rotation_offsets=tuple(0.1 * (i + 1) for i in range(n)),
        translation_offsets=(-1e-3,) * n,
        rotation_gains=(1.01,) * n,
        latency=0.083,
        found_by="a test",
    )


@pytest.mark.parametrize("name", ["thesis_ctr", "thesis_etr", "example_three_segment_etr"])
def test_a_calibration_is_part_of_the_robot_s_file(name: str, tmp_path: Path) -> None:
    robot = load_robot(ROBOTS / f"{name}.yaml")
    robot = replace(robot, calibration=drives(robot.n_tubes))
    robot.save(tmp_path / "robot.yaml")
    assert load_robot(tmp_path / "robot.yaml") == robot


def test_there_and_back_between_readings_and_the_model() -> None:
    own = drives(3)
    read = np.array([[0.3, -2.0, 5.0], [0.0, 0.1, 0.2]]), np.array([[0.01, 0.0, -0.02]] * 2)
    model = own.to_model(*read)
    np.testing.assert_allclose(model[0][0], 1.01 * read[0][0] + [0.1, 0.2, 0.3])
    for reached, back in zip(read, own.to_readings(*model), strict=True):
        np.testing.assert_allclose(back, reached, atol=1e-15)


def test_limits_are_given_of_readings() -> None:
    robot = load_robot(ROBOTS / "thesis_ctr.yaml")
    inputs = JointLimits(((-1.0, 1.0),) * 3, ((-0.05, 0.01),) * 3)
    limits = replace(robot, joint_limits=inputs, calibration=drives(3)).limits
    assert limits.rotations[1] == pytest.approx((-1.01 + 0.2, 1.01 + 0.2))
    assert limits.translations[0] == pytest.approx((-0.051, 0.009))


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"rotation_gains": (1.0, 0.0, 1.0)}, "rotation_gains of tube 2 is 0; it must be greater than 0"),
        ({"rotation_play": (0.0, 0.0, -1.0)}, "rotation_play of tube 3 is -1; it must be at least 0"),
        ({"translation_offsets": (0.0,)}, "translation_offsets are 1 numbers; rotation_offsets are 3, one per tube"),
    ],
)
def test_calibrations_that_make_no_sense(change: dict[str, tuple[float, ...]], problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        replace(drives(3), **change)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="calibration is for 2 tubes; the robot has 3"):
        replace(load_robot(ROBOTS / "thesis_ctr.yaml"), calibration=drives(2))


def test_fk_and_ik_speak_of_readings(run: Run, tmp_path: Path) -> None:
    robot = replace(load_robot(ROBOTS / "crl_ctr.yaml"), calibration=drives(3))
    path = tmp_path / "robot.yaml"
    robot.save(path)
    outcome = run("fk", str(path), "--rotations-deg", "10,20,30", "--translations-mm", "-20,-10,-5", "--json")
    data = answer(outcome, 0)
    model = drives(3).to_model(np.radians([10.0, 20.0, 30.0]), np.array([-20.0, -10.0, -5.0]) * 1e-3)
    np.testing.assert_allclose(data["readings_deg"], [10, 20, 30])
    np.testing.assert_allclose(data["rotations_deg"], np.degrees(model[0]))
    np.testing.assert_allclose(data["tip_position_mm"], forward_kinematics(robot, *model).tip_position * 1e3)
    target = ",".join(str(x) for x in data["tip_position_mm"])
    solution = answer(run("ik", str(path), "--target-mm", target, "--no-reachable", "--json"), 0)["solutions"][0]
    turned = np.radians(solution["readings_deg"]), np.array(solution["readings_mm"]) * 1e-3
    tip = forward_kinematics(robot, *drives(3).to_model(*turned)).tip_position
    np.testing.assert_allclose(tip * 1e3, data["tip_position_mm"], atol=1e-4)


def test_a_plan_is_asked_and_saved_in_readings(tmp_path: Path) -> None:
    own = drives(3)
    robot = replace(load_robot(ROBOTS / "thesis_ctr.yaml"), calibration=own)
    study, file = tmp_path / "study.yaml", tmp_path / "trajectory.csv"
    robot.save(tmp_path / "robot.yaml")
    study.write_text(
        "{kind: plan, robot: robot.yaml, objective: none, start_deg: [10, 20, 30], start_mm: [-50, -30, -20], "
        "goal_deg: [20, 25, 60]}"
    )
    plan = load_study(study).run()
    reached = np.radians([20, 25, 60]), np.array([-0.05, -0.03, -0.02])
    tip = forward_kinematics(robot, *own.to_model(*reached)).tip_position
    np.testing.assert_allclose(plan.tip_position[-1], tip, atol=1e-9)
    save_trajectory(plan, file)
    rows = np.loadtxt(file, delimiter=",", comments=["#", "time"])
    np.testing.assert_allclose(rows[0, 1:], [10, 20, 30, -50, -30, -20], atol=1e-9)
    np.testing.assert_allclose(rows[-1, 1:], [20, 25, 60, -50, -30, -20], atol=1e-9)
    np.testing.assert_allclose(joint_trajectory(plan)["points"][-1]["positions"], np.concatenate(reached), atol=1e-12)
    np.testing.assert_allclose(load_trajectory(file, robot).rotations, plan.rotations, atol=1e-12)


def test_the_snap_of_a_certificate_is_repeated_in_readings(run: Run, tmp_path: Path) -> None:
    own = replace(drives(2), translation_offsets=(0.0, 0.0))
    robot = replace(load_robot(ROBOTS / "two_tube.yaml"), calibration=own)
    robot.save(tmp_path / "robot.yaml")
    report = answer(run("certify", str(tmp_path / "robot.yaml"), "--json"), 3)
    snap = answer(run(*shlex.split(report["repeat"])[1:], "--json"), 0)["snap"]
    assert snap["rotations_deg"][0] - snap["rotations_deg"][1] == pytest.approx(203.903566, abs=1e-5)
    read = own.to_readings(np.radians(snap["rotations_deg"]), np.array(snap["translations_mm"]) * 1e-3)
    np.testing.assert_allclose(snap["readings_deg"], np.degrees(read[0]))
