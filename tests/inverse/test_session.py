"""Servoing: small steps stay on the branch, on target and inside what is allowed."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import tubeopt
from tests.command_line import ROOT
from tests.examples import CRL, MM, THESIS, eccentric_robot
from tests.inverse_targets import inside
from tubeopt import IkSession, InputError, InverseOptions, SolveError, forward_kinematics
from tubeopt.bodies.obstacles import Sphere
from tubeopt.inverse.goal import pose_question
from tubeopt.inverse.joint_path import jump_between
from tubeopt.inverse.posture import posture_of
from tubeopt.robots.robot import Robot
from tubeopt.runs.inverse_study import load_targets
from tubeopt.typing import Array


def circle(centre: tuple[float, float, float], radius: float, count: int) -> Array:
    """Targets 0.5 mm apart on a circle, m."""
    angle = np.arange(count) * 0.5 / radius
    ring = np.column_stack([np.cos(angle), np.sin(angle), 0.2 * np.sin(2 * angle)])
    return (np.array(centre) + radius * ring) * MM


@pytest.mark.parametrize(
    ("robot", "targets"),
    [
        (THESIS, circle((55, 20, 150), 25, 120)),
        (CRL, circle((25, 0, 115), 12, 90)),
        (eccentric_robot(0.05), circle((15, 0, 80), 6, 60)),
    ],
    ids=["thesis", "CRL", "ETR"],
)
def test_a_path_without_a_jump(robot: Robot, targets: Array) -> None:
    session = IkSession(robot, min_margin=0.1)
    answers = [session.solve(target) for target in targets]
    assert session.solution is answers[-1]
    for target, answer in zip(targets, answers, strict=True):
        assert np.linalg.norm(answer.equilibrium.tip_position - target) <= 1e-7
        assert answer.margin >= 0.1
        assert inside(robot, answer.rotations, answer.translations)
    path = tubeopt.follow(
        robot, [a.rotations for a in answers], [a.translations for a in answers], start=answers[0].equilibrium
    )
    assert not path.snaps
    for answer, walked in zip(answers, path.equilibria, strict=True):
        assert np.linalg.norm(walked.tip_position - answer.equilibrium.tip_position) < 1e-8
        # Margins close to 1, where nothing is about to snap, are told to a few 1e-6.
        assert walked.margin == pytest.approx(answer.margin, abs=1e-6 if answer.margin < 0.99 else 2e-5)


def test_directions_are_followed() -> None:
    seed = forward_kinematics(CRL, [0.3, -0.4, 0.8], [0.05, -0.02, -0.04])
    session = IkSession(CRL, start=seed)
    for k in range(1, 16):
        target = seed.tip_position + k * np.array([2e-4, -1e-4, 1e-4])
        answer = session.solve(target, direction=seed.tip_rotation[:, 2])
        assert answer.position_error <= 1e-7
        assert answer.direction_error <= 1e-7


def test_what_the_target_leaves_free_goes_to_the_margin() -> None:
    """Back and forth between two targets, the margin grows."""
    seed = forward_kinematics(CRL, np.radians([-129.0, -335.0, 116.0]), [0.107, 0.015, -0.004])
    assert seed.margin < 0.9
    session = IkSession(CRL, start=seed)
    margins = []
    for k in range(60):
        margins.append(session.solve(seed.tip_position + (k % 2) * np.array([5e-4, 0.0, 0.0])).margin)
    assert margins[-1] > seed.margin + 0.05


def test_a_far_target_is_approached_on_the_branch() -> None:
    seed = forward_kinematics(THESIS, [0.4, 1.0, -0.5], [-0.01, -0.02, -0.015])
    far = forward_kinematics(THESIS, [0.8, 1.3, -0.2], [-0.02, -0.03, -0.025], start=seed).tip_position
    answer = IkSession(THESIS, start=seed).solve(far)
    assert answer.position_error <= 1e-7
    assert answer.margin >= 0.05


def test_obstacles_are_kept_clear_of() -> None:
    targets = circle((55, 20, 150), 20, 40)
    free = IkSession(THESIS)
    touched = [free.solve(target).equilibrium.position for target in targets]
    middle = touched[30][len(touched[30]) // 2]
    beside = Sphere(tuple(middle + np.array([0.0, 0.006, 0.0])), 0.004)
    session = IkSession(THESIS, obstacles=[beside])
    for target in targets:
        assert session.solve(target).clearance >= 0.0


def test_a_target_out_of_reach_leaves_it_where_it_was() -> None:
    robot = eccentric_robot()
    session = IkSession(robot, start=forward_kinematics(robot, [0.0, 0.5, -0.5], np.full(3, -0.01)))
    first = session.solve([0.0, -0.02, 0.078])
    # Straight up is as close as 94 mm of arm get, though the search ended at a part of the way.
    with pytest.raises(SolveError, match=r"cannot be reached from here: 1\d* mm short"):
        session.solve([0.0, 0.0, 0.2])
    assert session.solution is first
    again = session.solve([0.0, -0.02, 0.078])
    np.testing.assert_allclose(again.rotations, first.rotations, atol=1e-9)


def tips_between(robot: Robot, before: tubeopt.InverseSolution, after: tubeopt.InverseSolution) -> Array:
    """(9, 3) tips on the straight way of joint values between two answers."""
    fraction = np.linspace(0, 1, 9)[:, None]
    rotations = before.rotations + fraction * (after.rotations - before.rotations)
    translations = before.translations + fraction * (after.translations - before.translations)
    path = tubeopt.follow(robot, rotations, translations, start=before.equilibrium)
    assert not path.snaps
    return np.array([e.tip_position for e in path.equilibria])


def test_a_time_limit_ends_a_step() -> None:
    session = IkSession(THESIS, start=([0.0, 0.0, 0.0], None), options=InverseOptions(time_limit=1e-9))
    with pytest.raises(SolveError, match="the time limit was reached before the target"):
        session.solve([0.05, 0.03, 0.15])


def test_it_does_not_jump() -> None:
    """Targets 3.2 mm apart between two of which a carriage may go 31 mm, the tip 0.5 mm off the line."""
    targets = load_targets(ROOT / "configs/targets/arc.csv").position
    session = IkSession(THESIS)
    answers = [answer for target in targets for answer in session.solve_path(target)]
    for before, after in pairwise(answers):
        assert not after.jump
        tips = tips_between(THESIS, before, after)
        along = tips[-1] - tips[0]
        distance = np.linalg.norm(along)
        aside = np.linalg.norm(np.cross(tips - tips[0], along / distance), axis=1).max()
        assert aside <= 0.06 * distance + 1.1e-5
        assert np.abs(after.translations - before.translations).max() <= 4 * distance + 2.1 * MM


def test_branch_jump_is_reported() -> None:
    """Of motions of the joints that bring the tip straight on, round on an arc, and through a snap."""
    before = forward_kinematics(THESIS, [0.4, 1.0, -0.5], [-0.01, -0.02, -0.015])
    goal = pose_question(THESIS, before.tip_position)
    current = posture_of(goal.space, before)
    near = current.to(current.q + np.array([0.02, 0.02, 0.02, 0.0, 0.0, 0.0]))
    assert near is not None
    assert jump_between(goal, current, near) == ("", True)
    back = current.to(current.q + np.array([2.0, 2.0, 2.0, 0.0, 0.0, 0.0]))
    assert back is not None
    text, safe = jump_between(goal, current, back)
    assert "the tip leaves the line between the targets by" in text  # it goes round on an arc
    assert safe
    # The fold of the thesis' robot lies at 214 deg.
    home = posture_of(goal.space, forward_kinematics(THESIS, np.zeros(3)))
    beyond = posture_of(goal.space, forward_kinematics(THESIS, np.radians([270.0, 0.0, 0.0])))
    text, safe = jump_between(goal, home, beyond)
    assert "the robot snaps on the straight path" in text
    assert not safe


def test_the_way_to_a_far_target_is_given() -> None:
    seed = forward_kinematics(THESIS, [0.4, 1.0, -0.5], [-0.01, -0.02, -0.015])
    far = forward_kinematics(THESIS, [0.8, 1.3, -0.2], [-0.02, -0.03, -0.025], start=seed).tip_position
    answer = IkSession(THESIS, start=seed).solve(far)
    assert answer.path is not None
    np.testing.assert_allclose(answer.path.rotations[0], seed.rotations, atol=1e-15)
    path = tubeopt.follow(THESIS, answer.path.rotations, answer.path.translations, start=seed)
    assert not path.snaps
    tips = np.array([e.tip_position for e in path.equilibria]) - seed.tip_position
    along = (far - seed.tip_position) / np.linalg.norm(far - seed.tip_position)
    assert np.linalg.norm(np.cross(tips, along), axis=1).max() <= 1e-5


def test_seeds_that_are_not_allowed_are_refused() -> None:
    with pytest.raises(InputError, match=r"start is out of range: rotation of tube 1 is 515\.662 deg"):
        IkSession(THESIS, start=([9.0, 0.0, 0.0], None))
    weak = forward_kinematics(
        THESIS, np.radians([212.0, 0, 0]), start=forward_kinematics(THESIS, np.radians([200.0, 0, 0]))
    )
    smallest = min(e.margin for e in tubeopt.find_equilibria(THESIS, np.radians([212.0, 0, 0])) if e.stable)
    if weak.margin == pytest.approx(smallest):
        with pytest.raises(InputError, match="it must have more than min_margin"):
            IkSession(THESIS, start=weak, min_margin=0.9)
    with pytest.raises(InputError, match="position has 2 numbers"):
        IkSession(THESIS).solve([0.0, 1.0])
