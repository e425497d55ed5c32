"""The tubes of a design are in order wherever the task puts them, and planning and inverse kinematics accept it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from tubeopt import ConcentricRobot, DesignTask, InputError, inverse_kinematics, optimize_design, plan_trajectory
from tubeopt.design import DesignSolution, Free, Objective, Poses, SnapFree
from tubeopt.design.requirements import Requirement
from tubeopt.design.task import TranslationRange, tube_order, worst_order

from .tasks import three_tubes, two_tubes

LENGTHS = (Free("curved_length", (0, 1, 2), 0.03, 0.15), Free("curvature", (0, 1, 2), 0.5, 30.0))


def disorder(robot: ConcentricRobot, translations: Any) -> float:
    """By how much (m) carriages or ends are out of order, or a tube is withdrawn past the plate; written plainly."""
    worst = -np.inf
    for i in range(robot.n_tubes):
        inner, d = robot.tubes[i], translations[i]
        worst = max(worst, -(d + inner.curved_length))
        if i + 1 < robot.n_tubes:
            outer, e = robot.tubes[i + 1], translations[i + 1]
            begins, ends = d - inner.straight_length, d + inner.curved_length
            worst = max(worst, begins - (e - outer.straight_length), e + outer.curved_length - ends)
    return float(worst)


HOME = (0.0, 0.0, 0.0)
CASES: dict[str, tuple[tuple[Requirement, ...], Objective, list[tuple[float, ...]]]] = {
    "home": ((SnapFree(0.3),), Objective("tip_curvature"), []),
    "box": (
        (SnapFree(0.3, box=((-0.02, -0.01, 0.0), HOME)),),
        Objective("tip_curvature"),
        [(-0.02, 0.0, 0.0), (0.0, -0.01, 0.0), (-0.02, -0.01, 0.0)],
    ),
    "certified": ((SnapFree(0.3, ((-0.01, 0.0, 0.0),)),), Objective("tip_curvature"), [(-0.01, 0.0, 0.0)]),
    "objective": (
        (SnapFree(0.3),),
        Objective("tip_curvature", translations=(-0.015, 0.0, 0.0)),
        [(-0.015, 0.0, 0.0)],
    ),
    "poses": (
        (SnapFree(0.3), Poses(((0.0, 0.5, 1.0),), ((-0.01, 0.0, 0.0),))),
        Objective("tip_curvature"),
        [(-0.01, 0.0, 0.0)],
    ),
}


def asked(name: str) -> DesignTask:
    requirements, objective, _ = CASES[name]
    return DesignTask(three_tubes(), LENGTHS, requirements, objective)


@cache
def designed(name: str) -> DesignSolution:
    return optimize_design(asked(name), turns=1)


@pytest.mark.usefixtures("few_places")
@pytest.mark.parametrize("name", CASES)
def test_tubes_are_in_order_wherever_the_task_puts_them(name: str) -> None:
    design = designed(name)
    for row in (HOME, *CASES[name][2], *(e.translations for e in design.equilibria)):
        assert disorder(design.robot, row) <= 1e-10
    (check,) = [check for check in design.verification.checks if check.what == "order of the tubes"]
    assert check.satisfied


def test_order_that_is_not_asked_for_costs_nothing() -> None:
    ordered, free = designed("objective"), optimize_design(replace(asked("objective"), ordered=False), turns=1)
    assert free.objective >= ordered.objective - 1e-6
    assert not any(check.what == "order of the tubes" for check in free.verification.checks)


def test_a_verified_design_is_accepted_by_inverse_kinematics_and_planning() -> None:
    design = designed("poses")
    (pose,) = design.equilibria
    home = (np.zeros(3), np.zeros(3))
    answer = inverse_kinematics(design.robot, pose.tip_position, start=home)
    assert answer.position_error < 1e-6
    plan = plan_trajectory(design.robot, home, (pose.rotations, pose.translations))
    np.testing.assert_allclose(plan.translations[-1], pose.translations, atol=1e-12)


def test_an_order_that_no_lengths_keep_is_refused() -> None:
    short = replace(two_tubes(), tubes=(replace(two_tubes().tubes[0], curved_length=0.05), two_tubes().tubes[1]))
    free = (Free("curvature", (0,), 1.0, 20.0),)
    text = "tube 1 ends 10 mm inside tube 2 at translations 0, whatever lengths are chosen; ordered=False "
    with pytest.raises(InputError, match=text):
        DesignTask(short, free, (SnapFree(0.1),))
    assert DesignTask(short, free, (SnapFree(0.1),), ordered=False).ordered is False
    assert DesignTask(short, (*free, Free("curved_length", (0,), 0.05, 0.06)), (SnapFree(0.1),)).ordered
    box = SnapFree(0.1, box=((-0.03, 0.0), (0.0, 0.0)))
    with pytest.raises(InputError, match=r"tube 1 ends 10 mm inside tube 2 in the certified box \(-30, 0\) mm"):
        DesignTask(two_tubes(), free, (box,))


def test_the_worst_order_is_told() -> None:
    robot = two_tubes()
    order, tubes = tube_order(robot), robot.tubes
    ahead = TranslationRange("here", (0.08, 0.0), (0.08, 0.0))
    gap, text = worst_order(order, tubes, [TranslationRange("at translations 0", (0.0, 0.0), (0.0, 0.0)), ahead])
    assert gap == pytest.approx(-0.01)
    assert text == "the carriage of tube 1 stands 10 mm before that of tube 2 here"
    gap, text = worst_order(order, tubes, [TranslationRange("there", (-0.09, -0.065), (-0.09, -0.065))])
    assert (gap, text) == (pytest.approx(-0.01), "tube 1 ends 10 mm behind the plate there")
