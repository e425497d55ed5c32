"""Objectives of what a robot is for, requirements on its way out, tubes that are off, and remarks on a design."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from tests.design.tasks import two_tubes
from tests.examples import CRL
from tubeopt import ConcentricRobot, DesignTask, InputError, forward_kinematics, optimize_design, snap_free_certificate
from tubeopt.bodies.corridors import Corridor
from tubeopt.design import (
    Avoid,
    Deployment,
    DesignSolution,
    Free,
    Objective,
    Poses,
    SnapFree,
    SnapFreeInUse,
    Strain,
)
from tubeopt.design.evaluation import state_at
from tubeopt.design.program import compile_task
from tubeopt.design.requirements import DEPLOYED_FRACTIONS, retracted
from tubeopt.design.sensitivities import remarks
from tubeopt.design.verify import numbers_of
from tubeopt.typing import Array

assert isinstance(CRL, ConcentricRobot)
POSES = Poses(
    ((0.0, 0.5, 1.0), (0.0, 2.0, 1.0), (0.3, 1.0, -1.0)),
    ((-0.03, -0.05, -0.02), (-0.02, -0.04, -0.03), (-0.005, -0.02, -0.01)),
)
FREE = (Free("curvature", (0, 1, 2), 1.0, 40.0),)


def task(kind: str, **in_use: bool) -> DesignTask:
    """The CRL robot with its curvatures free, for an objective of three poses."""
    needs = (POSES, SnapFreeInUse(0.1, paths=False, **in_use), Strain((0.012,), in_poses=False))
    return DesignTask(CRL, FREE, needs, Objective(kind), ordered=False)


def posed(robot: ConcentricRobot) -> list[tuple[Array, Array]]:
    return [(np.array(a), np.array(b)) for a, b in zip(POSES.rotations, POSES.translations, strict=True)]


def least_motion(robot: ConcentricRobot, rotations: Array, translations: Array) -> float:
    """Least singular value of the tip's Jacobian, by differences of tips, for 1 rad or 50 mm."""
    columns = []
    for k, step in product((0, 1), np.eye(3)):
        ends = []
        for sign in (1e-5, -1e-5):
            q = [rotations, translations]
            q[k] = q[k] + sign * step * (0.05 if k else 1.0)
            ends.append(forward_kinematics(robot, *q).tip_position)
        columns.append((ends[0] - ends[1]) / 2e-5)
    return float(np.linalg.svd(np.array(columns), compute_uv=False)[-1])


def test_dexterity_is_the_least_singular_value_or_a_little_less() -> None:
    solution = optimize_design(task("dexterity"), turns=0)
    before, after = (np.mean([least_motion(robot, *pose) for pose in posed(robot)]) for robot in (CRL, solution.robot))
    assert 3 ** (-1 / 8) * after <= solution.objective <= after * (1 + 1e-6)
    assert after > 1.5 * before


def least_turn(robot: ConcentricRobot, rotations: Array, translations: Array) -> float:
    """Least turn (rad) of the tip's direction by joints that leave its place, for 1 rad or 50 mm, by differences."""
    columns = []
    for k, step in product((0, 1), np.eye(3)):
        ends = []
        for sign in (1e-5, -1e-5):
            q = [rotations, translations]
            q[k] = q[k] + sign * step * (0.05 if k else 1.0)
            equilibrium = forward_kinematics(robot, *q)
            ends.append(np.append(equilibrium.tip_position, equilibrium.tip_rotation[:, 2]))
        columns.append((ends[0] - ends[1]) / 2e-5)
    change = np.array(columns).T
    still = np.linalg.svd(change[:3])[2][3:].T  # joints that leave the place
    return float(np.linalg.svd(change[3:] @ still, compute_uv=False)[1])


def test_orientability_is_the_least_turn_of_a_tip_that_stays_or_a_little_less() -> None:
    solution = optimize_design(task("orientability"), turns=0)
    before, after = (np.mean([least_turn(robot, *pose) for pose in posed(robot)]) for robot in (CRL, solution.robot))
    assert 2 ** (-1 / 8) * after <= solution.objective <= after * (1 + 1e-4)
    assert after > 1.2 * before
    with pytest.raises(InputError, match="needs 3 tubes"):
        DesignTask(two_tubes(), (Free("curvature", (0, 1), 1.0, 40.0),), (), Objective("orientability"))


@pytest.mark.parametrize("kind", ["dexterity", "orientability", "deployment", "workspace_volume"])
def test_derivatives_agree_with_differences_and_values_with_solved_poses(kind: str) -> None:
    requested = task(kind)
    program = compile_task(requested)
    expression, x = program.aims[requested.objectives[0]], program.layout.space.start
    value, slope = expression.linear(state_at(program, x).quantity)
    solved = [forward_kinematics(CRL, *pose) for pose in posed(CRL)]
    assert value == pytest.approx(expression(numbers_of(CRL, solved)), rel=1e-5)
    for k, step in enumerate(np.diag([1e-3] * 3)):
        ends = [expression.linear(state_at(program, x + s * step).quantity)[0][0] for s in (1, -1)]
        assert slope[0, k] == pytest.approx((ends[0] - ends[1]) / 2e-3, rel=1e-5, abs=1e-9)


def test_the_swept_volume_is_that_of_a_solid_of_revolution() -> None:
    tips = np.array([forward_kinematics(CRL, *pose).tip_position for pose in posed(CRL)])
    corners = np.column_stack([np.hypot(tips[:, 0], tips[:, 1]), tips[:, 2]])
    a, b = corners[1] - corners[0], corners[2] - corners[0]
    pappus = 2 * np.pi * corners[:, 0].mean() * abs(a[0] * b[1] - a[1] * b[0]) / 2
    requested = task("workspace_volume")
    program = compile_task(requested)
    value = program.aims[requested.objectives[0]].linear(state_at(program, program.layout.space.start).quantity)[0]
    assert value == pytest.approx(pappus, rel=1e-4)


def test_tubes_of_one_circle_deploy_along_it() -> None:
    """A bundle whose tubes end together and bend to one side follows its own tip; one that is turned does not."""
    robot = two_tubes()
    equal = replace(robot, tubes=tuple(replace(tube, curvature=8.0, curved_length=0.06) for tube in robot.tubes))
    for rotations, largest in (((0.0, 0.0), 2e-6), ((0.0, 2.0), None)):
        requested = DesignTask(
            equal,
            (Free("curvature", (0,), 1.0, 20.0),),
            (Poses((rotations,), ((0.0, 0.0),)),),
            Objective("deployment"),
            ordered=False,
        )
        program = compile_task(requested)
        value = program.aims[requested.objectives[0]].linear(state_at(program, program.layout.space.start).quantity)[0][
            0
        ]
        assert value < largest if largest else value > 1e-5


def test_tubes_are_drawn_back_to_one_length() -> None:
    shift, moved, last = retracted(CRL.tubes, np.array([-0.01, -0.05, -0.06]), 0.5)
    ends = shift + [tube.curved_length for tube in CRL.tubes]
    assert last == 1
    assert ends == pytest.approx([0.025, 0.025, 0.025])
    assert moved.tolist() == [True, True, True]
    shift, moved, _ = retracted(CRL.tubes, np.array([0.05, -0.05, -0.06]), 0.5)
    assert moved.tolist() == [True, True, False]
    assert shift == pytest.approx([0.0455 - 0.041, 0.0455 - 0.1, -0.06])


def test_the_way_out_keeps_to_where_the_arm_will_be_and_in_its_corridor() -> None:
    pose = forward_kinematics(CRL, POSES.rotations[1], POSES.translations[1])
    line = tuple(map(tuple, np.vstack([[0, 0, -0.02], pose.position[::4], pose.position[-1:]]).tolist()))
    needs = (Poses(POSES.rotations[1:2], POSES.translations[1:2]), SnapFreeInUse(0.1, paths=False, deployed=True))
    path = Avoid((Corridor(line, 0.004),), 2e-4, deployed=True)
    desired = DesignTask(CRL, FREE, (*needs, path, Deployment(3e-5)), Objective("change"), ordered=False)
    solution = optimize_design(desired, turns=0)
    before, after = (_off(robot) for robot in (CRL, solution.robot))
    assert before > 5e-5
    assert after <= 3.1e-5
    checks = {check.what: check.satisfied for check in solution.verification.checks}
    assert checks["deviation of the deployment"]
    assert checks["margin during deployment to the task poses"]


def _off(robot: ConcentricRobot) -> float:
    """Largest distance of the arms on their way out to the second pose from the whole one, at the same arc length."""
    whole = forward_kinematics(robot, POSES.rotations[1], POSES.translations[1])
    worst = 0.0
    for fraction in DEPLOYED_FRACTIONS:
        shift = retracted(robot.tubes, np.array(POSES.translations[1]), fraction)[0]
        arm = forward_kinematics(robot, POSES.rotations[1], shift)
        for s in arm.arc_length[-1] * np.array([0.5, 0.75, 1.0]):
            positions = [
                CubicHermiteSpline(one.arc_length, one.position, one.frame[:, :, 2])(s) for one in (arm, whole)
            ]
            worst = max(worst, float(np.linalg.norm(np.subtract(*positions))))
    return worst


def test_tubes_that_are_off_keep_the_margin() -> None:
    robust = SnapFree(0.05, curvature_error=0.04, stiffness_error=0.03)
    desired = DesignTask(CRL, FREE, (robust,), Objective("change"), ordered=False)
    solution = optimize_design(desired, turns=0)
    plain = optimize_design(replace(desired, requirements=(SnapFree(0.05),)), turns=0)
    assert solution.certificate > plain.certificate + 0.05
    assert _worst(solution.robot) >= 0.05 > _worst(plain.robot)
    with pytest.raises(InputError, match="errors"):
        SnapFree(0.05, max_force=0.01, curvature_error=0.01)


def _worst(robot: ConcentricRobot) -> float:
    """Least certificate of robots with tubes off by 4 % of curvature and 3 % of both stiffnesses."""
    results = []
    for signs in product((-1, 1), repeat=3):
        tubes = tuple(
            replace(
                tube,
                curvature=tube.curvature * 1.04,
                bending_stiffness=float(tube.bending_stiffness) * (1 + 0.03 * signs[i]),
                torsional_stiffness=float(tube.torsional_stiffness) * (1 - 0.03),
            )
            for i, tube in enumerate(robot.tubes)
        )
        results.append(snap_free_certificate(ConcentricRobot(tubes)))
    return min(results)


def test_a_design_says_which_tubes_it_does_not_need() -> None:
    solution = optimize_design(task("workspace_volume"), turns=0)
    assert isinstance(solution, DesignSolution)
    assert any("curvature of tube 1 lies on its lower bound, 1 1/m" in text for text in solution.remarks)


def test_a_tube_that_hardly_bends_the_bundle_may_as_well_be_straight() -> None:
    """Not where it stands out of the others, and bends as much as it is bent."""
    inner, outer = CRL.tubes[0], CRL.tubes[2]
    hidden = replace(inner, straight_length=outer.straight_length, curved_length=0.1, curvature=1.0)
    out = replace(hidden, curved_length=0.15)
    useless, needed = (
        [text for text in remarks(ConcentricRobot((tube, outer)), ()) if "may be straight" in text]
        for tube in (hidden, out)
    )
    assert not needed
    # A nitinol tube of 6.45 g/cm^3, 1.5 and 1.2 mm wide and 100 mm long: w L^4 / (8 EI).
    weight = 6450 * np.pi / 4 * (1.5e-3**2 - 1.2e-3**2) * 9.81
    sag = weight * 0.1**4 / (8 * 50e9 * np.pi / 64 * (1.5e-3**4 - 1.2e-3**4))
    assert len(useless) == 1
    assert f"Tube 2, the stiffest, sags by {sag * 1e3:.2g} mm" in useless[0]


def test_a_polygon_needs_three_poses() -> None:
    with pytest.raises(InputError, match="at least 3"):
        DesignTask(CRL, FREE, (Poses(POSES.rotations[:2], POSES.translations[:2]),), Objective("workspace_volume"))
