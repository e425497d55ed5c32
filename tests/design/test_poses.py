"""Designs with task poses: reach, corridor, obstacles, margins in use, workspace boxes."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tests.design.tasks import THESIS, two_tubes
from tubeopt import (
    ConcentricRobot,
    DesignSolver,
    DesignTask,
    InputError,
    JointLimits,
    Tube,
    find_stroke_force,
    follow,
    forward_kinematics,
    optimize_design,
)
from tubeopt.bodies.corridors import Corridor
from tubeopt.bodies.obstacles import Sphere
from tubeopt.bodies.solids import field_of_points
from tubeopt.design import (
    Avoid,
    Coverage,
    Free,
    Objective,
    Poses,
    Reach,
    SnapFree,
    SnapFreeInUse,
    Strain,
    Stroke,
    StrokeForce,
    Target,
)
from tubeopt.design.evaluation import evaluate, state_at
from tubeopt.design.program import Program, compile_task
from tubeopt.design.solve import with_joints
from tubeopt.design.state import pose_strain
from tubeopt.design.verify import largest_strain
from tubeopt.typing import Array

MM = 1e-3
TURN = 2 * np.pi


QUICK = DesignSolver(iterations=40, orders=2)
"""For tests that ask what a design keeps, not whether it is the best."""


def corridor() -> tuple[tuple[float, float, float], ...]:
    """60 mm up, then a quarter turn of 70 mm radius towards -y, and 40 mm on."""
    bend = [(0.0, -0.07 * (1 - np.cos(a)), 0.06 + 0.07 * np.sin(a)) for a in np.linspace(0, np.pi / 2, 13)]
    return ((0.0, 0.0, -0.005), *bend, (0.0, -0.11, 0.13))


def corner_task(targets: int = 3) -> DesignTask:
    """The shortest robot that reaches targets around a corner."""
    tubes = (
        Tube(1.0 * MM, 0.8 * MM, 0.15, 0.08, 12.0),
        Tube(1.4 * MM, 1.1 * MM, 0.1, 0.09, 9.0),
        Tube(2.0 * MM, 1.6 * MM, 0.05, 0.05, 2.0),
    )
    angles = np.arange(targets) * TURN / targets
    points = [(5 * MM * np.cos(a), -0.085 + 3 * MM * (k % 2), 0.13 + 5 * MM * np.sin(a)) for k, a in enumerate(angles)]
    return DesignTask(
        ConcentricRobot(tubes),
        (
            Free("curvature", (0, 1, 2), 0.0, 19.5),
            Free("curved_length", (0, 1, 2), 0.02, 0.2),
            Free("straight_length", (0, 1, 2), 0.02, 0.25),
        ),
        (
            Reach(tuple(Target(point) for point in points)),
            Avoid((Corridor(corridor(), 12 * MM),)),
            SnapFreeInUse(0.1),
            Strain((0.025,)),
        ),
        Objective("length"),
    )


def distance_from(line: Array, points: Array) -> Array:
    """Distance of points from a polyline, by brute force."""
    fine = np.concatenate([a + np.linspace(0, 1, 400)[:, None] * (b - a) for a, b in pairwise(line)])
    return np.asarray([np.linalg.norm(fine - point, axis=1).min() for point in points])


def test_derivatives_of_all_rows_are_those_of_differences() -> None:
    program = compile_task(corner_task(2))
    x = with_joints(program, program.layout.space.start, np.random.default_rng(0))
    x = x * (1 + 1e-3 * np.random.default_rng(1).uniform(-1, 1, len(x)))

    def at(point: Array) -> tuple[Array, Array, float, Array]:
        result = evaluate(program, point)
        assert result is not None
        return (*result.rows(), *result.objective)

    _, jacobian, _, slope = at(x)
    for j, size in enumerate(1e-6 * program.scale):
        sides = [at(x + sign * size * np.eye(len(x))[j]) for sign in (1, -1)]
        change = (sides[0][0] - sides[1][0]) / (2 * size)
        assert np.allclose(change * program.scale[j], jacobian[:, j] * program.scale[j], atol=1e-4)
        assert (sides[0][2] - sides[1][2]) / (2 * size) == pytest.approx(slope[j], abs=1e-6)


def test_robot_reaches_around_a_corner() -> None:
    task = corner_task(2)
    design = optimize_design(task)
    reach = task.requirements[0]
    assert isinstance(reach, Reach)
    for pose, target in zip(design.equilibria, reach.targets, strict=True):
        again = forward_kinematics(design.robot, pose.rotations, pose.translations)
        assert np.linalg.norm(again.tip_position - np.array(target.position)) <= 0.1 * MM * 1.001
        assert again.margin >= 0.1
        radius = [max(t.outer_diameter for t, end in zip(design.robot.tubes, again.tube_end, strict=True) if end >= s)
                  for s in again.arc_length - 1e-9]  # fmt: skip
        assert (distance_from(np.array(corridor()), again.position) + np.array(radius) / 2).max() <= 12 * MM + 1e-6
        beta = pose.translations - [tube.straight_length for tube in design.robot.tubes]
        ends = beta + [tube.length for tube in design.robot.tubes]
        assert (np.diff(beta) >= -1e-7).all()
        assert (np.diff(ends) <= 1e-7).all()
        assert (beta <= 1e-9).all()
    assert design.verification.satisfied
    assert design.objective < 0.18
    assert design.sensitivities


def test_path_between_poses_stops_snapping() -> None:
    turn = Poses(((0.0, 0.0, 0.0), (TURN, 0.0, 0.0)), ((0.0,) * 3,) * 2)
    free = (Free("curvature", (0, 1, 2), 0.5, 15.0),)
    design = optimize_design(DesignTask(THESIS, free, (turn, SnapFreeInUse(0.05)), Objective("change")))
    path = np.linspace(0, 1, 60)[:, None] * np.array([TURN, 0.0, 0.0])
    assert len(follow(THESIS, path).snaps) == 1
    walked = follow(design.robot, path)
    assert not walked.snaps
    assert min(e.margin for e in walked.equilibria) >= 0.05 - 3e-3
    assert design.rounds >= 1


def test_direction_and_stroke_are_kept() -> None:
    desired = np.array([0.3, -1.0, 1.0]) / np.linalg.norm([0.3, -1.0, 1.0])
    targets = (
        Target((0.02, -0.03, 0.11), 1e-4, tuple(desired), np.radians(12.0)),
        Target((0.02, -0.03, 0.12), 2e-4),
    )
    free = (Free("curvature", (0, 1), 5.0, 25.0),)
    task = DesignTask(
        two_tubes(), free, (SnapFree(0.1), Reach(targets), Stroke(0.02)), Objective("margin"), solver=QUICK
    )
    design = optimize_design(task, turns=1)
    first, second = design.equilibria
    assert np.degrees(np.arccos(first.tip_rotation[:, 2] @ desired)) <= 12.0 + 1e-4
    assert np.linalg.norm(second.tip_position - [0.02, -0.03, 0.12]) <= 2.001e-4
    assert np.abs(first.translations - second.translations).max() <= 0.02 + 1e-7


def test_reach_at_depth_avoids_a_sphere_and_sits_on_a_kink() -> None:
    ball = Sphere((0.0, -0.05, 0.08), 0.012)
    requirements = (SnapFree(0.1), Strain((0.012,), in_poses=False), Avoid((ball,), 1e-3))
    free = (Free("curvature", (0, 1), 0.0, 25.0),)
    task = DesignTask(
        two_tubes(),
        free,
        requirements,
        Objective("reach_radius", depth=0.1),
        solver=DesignSolver(iterations=40),
    )
    design = optimize_design(task, turns=1)
    (pose,) = design.equilibria
    assert pose.tip_position[2] == pytest.approx(0.1, abs=2e-6)
    assert np.linalg.norm(pose.tip_position[:2]) == pytest.approx(design.objective, abs=1e-6)
    assert design.objective > 0.09
    assert ball.signed_distance(pose.position).min() >= 1e-3
    # binding: the certificate, and the strain of the outer tube
    assert {price.limit.description for price in design.sensitivities} >= {"certified margin"}
    assert not any("the clearance is from" in text for text in design.remarks)
    cloud = Avoid((field_of_points(np.array([[0.0, 0.0, 0.3], [0.0, 0.0, 0.31]]), 6e-3, name="wall.csv"),))
    of_points = replace(design, task=replace(design.task, requirements=(cloud,)))
    assert any("the clearance is from the 2 points of wall.csv" in text for text in of_points.remarks)


def test_workspace_box_is_covered() -> None:
    box = Coverage((-0.01, -0.01, 0.085), (0.01, 0.01, 0.095), 1e-3, 4)
    free = (Free("curvature", (0, 1), 0.0, 25.0), Free("curved_length", (0, 1), 0.02, 0.12))
    task = DesignTask(two_tubes(), free, (box, SnapFreeInUse(0.1, paths=False)), Objective("length"), solver=QUICK)
    design = optimize_design(task)
    corners = np.array([(x, y, z) for x in (-0.01, 0.01) for y in (-0.01, 0.01) for z in (0.085, 0.095)])
    tips = np.array([pose.tip_position for pose in design.equilibria])
    assert np.linalg.norm(tips[None] - corners[:, None], axis=2).min(1).max() <= 1e-3 * 1.001


def test_balls_around_targets_are_used_to_their_rim() -> None:
    """The shortest straight arm ends a tolerance short of the target, whichever way that lies."""
    arm = ConcentricRobot((Tube(1.0 * MM, 0.8 * MM, 0.0, 0.1, 0.0),))
    free = (Free("curved_length", (0,), 0.02, 0.15),)
    for position, smallest in (((0.0, 0.0, 0.1), 0.09), ((0.006, 0.0, 0.1), 0.092), ((0.0, 0.0096, 0.1), 0.0972)):
        design = optimize_design(DesignTask(arm, free, (Reach((Target(position, 0.01),)),), Objective("length")))
        assert design.objective == pytest.approx(smallest, abs=1e-6)


def test_limits_of_the_translations_are_kept() -> None:
    """Target 40 mm up, carriages that may withdraw by 10 mm: the tubes must get shorter."""
    turns = ((-7.0, 7.0),) * 2
    robot = replace(two_tubes(), joint_limits=JointLimits(turns, ((-0.01, 0.02), (-0.01, 0.0))))
    free = (Free("curved_length", (0, 1), 0.02, 0.1),)
    target = Reach((Target((0.0, -0.004, 0.04), 1e-3),))
    design = optimize_design(DesignTask(robot, free, (SnapFree(0.05), target), Objective("change")), turns=0)
    (pose,) = design.equilibria
    assert (pose.translations >= -0.01 - 1e-8).all()
    assert (pose.translations <= np.array([0.02, 0.0]) + 1e-8).all()
    assert design.robot.tubes[0].curved_length < 0.055


def test_strain_is_found_again_from_equilibria() -> None:
    rotations, translations = ((0.0, 2.0, 1.0), (0.0, 1.0, -2.0)), ((0.0, 0.0, 0.0), (-0.02, -0.01, 0.0))
    strain = Strain((0.02,), straightened=False)
    requirements = (Poses(rotations, translations), strain)
    task = DesignTask(THESIS, (Free("curvature", (0,), 1.0, 15.0),), requirements, Objective("change"))
    program = compile_task(task)
    state = state_at(program, program.layout.space.start)
    inside = [max(pose_strain(state, k, i)[0] for k in range(2)) for i in range(3)]
    poses = tuple(forward_kinematics(THESIS, *pair) for pair in zip(rotations, translations, strict=True))
    assert largest_strain(strain, THESIS, poses) == pytest.approx(inside, rel=0.02)


HOME = Poses(((0.0, 0.0, 0.0),), ((0.0, 0.0, 0.0),))


def test_a_stroke_force_to_be_made_large_is_that_of_the_robot_and_changes_as_told() -> None:
    """At home the arm buckles out of its plane the later the less its inner tube bends."""
    task = DesignTask(THESIS, (Free("curvature", (0,), 7.5, 7.8),), (HOME,), Objective("stroke_force"))
    program = compile_task(task)
    (aim,) = program.task.objectives
    start, step = float(program.layout.space.start[0]), 1e-3
    values, slopes = program.aims[aim].linear(state_at(program, np.array([start, 0.0])).quantity)
    low, current, high = (stroke_force_of(program, start + change) for change in (-step, 0.0, step))
    assert values.ravel() == pytest.approx([current], rel=1e-6)
    assert high < low
    assert slopes[0, 0] == pytest.approx((high - low) / (2 * step), rel=1e-4)


def stroke_force_of(program: Program, curvature: float) -> float:
    """N, of the robot of a program at home, with this curvature of its inner tube."""
    limit = find_stroke_force(ConcentricRobot(state_at(program, np.array([curvature, 0.0])).tubes), (0, 0, 0))
    assert limit is not None
    return limit.factor


def test_the_least_change_that_bears_a_stroke_force() -> None:
    free = (Free("curvature", (0,), 0.5, 15.0),)
    design = optimize_design(DesignTask(THESIS, free, (HOME, StrokeForce(0.14)), Objective("change"), solver=QUICK))
    limit = find_stroke_force(design.robot, (0, 0, 0))
    assert limit is not None
    assert limit.factor == pytest.approx(0.14, abs=1e-6)
    assert any(check.what == "stroke force at the task poses" for check in design.verification.checks)
    assert "stroke force" in design.sensitivities[0].sentence


def test_stroke_forces_are_of_given_poses() -> None:
    free, reach = (Free("curvature", (0,), 6.0, 12.0),), Reach((Target((0.0, 0.0, 0.1)),))
    with pytest.raises(InputError, match="objective stroke_force needs task poses with given joint values"):
        DesignTask(THESIS, free, (reach, HOME), Objective("stroke_force"))
    with pytest.raises(InputError, match="requirement StrokeForce needs task poses with given joint values"):
        DesignTask(THESIS, free, (StrokeForce(0.1),), Objective("change"))
    with pytest.raises(InputError, match="it must be at most 10 N"):
        StrokeForce(11.0)
