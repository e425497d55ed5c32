"""What the trace of a trajectory takes from its equilibria: stiffness, closest place of the arm, least margin."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.examples import DEG, TWO_TUBE, eccentric_robot, nested
from tubeopt import forward_kinematics
from tubeopt.bodies.obstacles import Sphere, scene_of
from tubeopt.equilibrium.kinematics import linearised
from tubeopt.inverse.clock import Clock
from tubeopt.planning import proof, trajectory_trace
from tubeopt.planning.sections import SolvedArms
from tubeopt.planning.trajectory_trace import (
    BranchEndsError,
    ClearanceTarget,
    Link,
    Proved,
    TraceStep,
    TrajectoryVerifier,
    follow,
)
from tubeopt.robots.robot import Robot


def verifier_of(robot: Robot, *bodies: Sphere) -> TrajectoryVerifier:
    return TrajectoryVerifier(
        robot, scene_of(bodies), ClearanceTarget(0.0, proof.ACCURACY, proof.MAX_CELLS), Clock(60.0)
    )


def test_the_stiffness_of_two_opposed_tubes_is_that_of_a_column() -> None:
    """Of kt y'^2 - c y^2 over kt y'^2, free at the tip, the least is 1 - c / kt (2 L / pi)^2."""
    length, curvature = 0.05, 12.0
    robot = nested((0.0, length, curvature), (0.0, length, curvature))
    one, other = ((tube.bending_stiffness, tube.torsional_stiffness) for tube in robot.tubes)
    pulled = curvature**2 * one[0] * other[0] / (one[0] + other[0]) * (1 / one[1] + 1 / other[1])
    verifier = verifier_of(robot)
    arms = SolvedArms.of(verifier.constants, [forward_kinematics(robot, [np.pi, 0.0])])
    assert verifier._stiffness(arms) == pytest.approx([1 - pulled * (2 * length / np.pi) ** 2], rel=1e-6)


@pytest.mark.parametrize("turn", [1.0, 2.0])
def test_the_stiffness_of_an_eccentric_arm_is_the_least_that_its_equations_make_of_a_turn(turn: float) -> None:
    """|H y| >= stiffness |y| for all y, and one y attains it."""
    robot = eccentric_robot()
    verifier, arm = verifier_of(robot), forward_kinematics(robot, np.array([1.0, -0.5, -0.5]) * turn)
    result, equations = verifier._stiffness(SolvedArms.of(verifier.constants, [arm])), linearised(arm)
    assert result == pytest.approx([1 / np.linalg.norm(np.linalg.inv(equations), 2)], rel=1e-9)
    random = np.random.default_rng(0).normal(size=(len(equations), 100))
    assert (np.linalg.norm(equations @ random, axis=0) >= result * np.linalg.norm(random, axis=0)).all()


def test_the_clearance_of_a_motion_is_the_least_of_all_its_times() -> None:
    """A bent tube turns past a ball beyond its tip, and is closest to it half-way."""
    length, curvature, radius = 0.05, 10.0, 1e-3
    robot = nested((0.0, length, curvature))
    middle, tip = (forward_kinematics(robot, [angle]) for angle in (45 * DEG, 0.0))
    outwards = middle.tip_position * [1, 1, 0] / np.linalg.norm(middle.tip_position[:2])
    bend = curvature * length
    ahead = middle.tip_position + 8e-3 * (np.sin(bend) * outwards + np.cos(bend) * np.array([0.0, 0.0, 1.0]))
    verifier = verifier_of(robot, Sphere(tuple(ahead.tolist()), radius))
    result = follow(verifier, tip, np.array([0.0, 1.0]), np.array([[0.0, 0.0], [90 * DEG, 0.0]]))
    true = 8e-3 - radius - robot.tubes[0].outer_diameter / 2
    assert not result.unproved
    assert true - proof.ACCURACY <= result.clearance <= true + 1e-9
    assert max(link.bound for link in result.links) > 1.2 * true


def test_no_clearance_is_shown_where_a_branch_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two steps far apart, and no equilibria left to put between them."""
    monkeypatch.setattr(trajectory_trace, "LARGEST_TURN", 1.0)
    monkeypatch.setattr(trajectory_trace, "MAX_EQUILIBRIA", 1)
    start, turned = forward_kinematics(TWO_TUBE, [0.0, 0.0]), np.array([[0.0] * 4, [1.0, 0.0, 0.0, 0.0]])
    verifier = verifier_of(TWO_TUBE, Sphere((0.0, 0.0, 1.0), 1e-3))
    result = follow(verifier, start, np.array([0.0, 1.0]), turned)
    assert result.unproved
    assert result.clearance == -np.inf
    assert np.isfinite(result.measured)


@pytest.mark.parametrize("lost", ["nothing", "a half", "the branch"])
def test_no_clearance_is_shown_where_a_branch_is_lost_between_more_equilibria(
    lost: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    start, turned = forward_kinematics(TWO_TUBE, [0.0, 0.0]), np.array([[0.0] * 4, [0.02, 0.0, 0.0, 0.0]])
    ball, result = Sphere((0.0, 0.0, 1.0), 1e-3), trajectory_trace.prove_branch
    answers = {"nothing": [], "a half": [[], [(0.25, 0.25)]], "the branch": []}[lost]

    def prove_branch(verifier: TrajectoryVerifier, links: list[Link]) -> Proved:
        return Proved(result(verifier, links).links, answers.pop(0) if answers else [])

    def bisect(verifier: TrajectoryVerifier, link: Link) -> list[Link]:
        raise BranchEndsError(0.25)

    monkeypatch.setattr(trajectory_trace, "prove_branch", prove_branch)
    if lost == "the branch":
        monkeypatch.setattr(trajectory_trace, "bisect", bisect)
    monkeypatch.setattr(trajectory_trace, "MAX_EQUILIBRIA", 9)
    verifier = verifier_of(TWO_TUBE, ball)
    verifier.target = ClearanceTarget(1.0, 1e-9, 0)
    shown = follow(verifier, start, np.arange(2.0), turned)
    assert shown.unproved == (() if lost == "nothing" else ((0.25, 0.25),))
    assert np.isfinite(shown.clearance) == (lost == "nothing")


@pytest.mark.parametrize("high", [1.0, 1e-3, 1e-6])
def test_the_least_of_a_parabola_lies_an_eighth_of_its_rise_below_samples(high: float) -> None:
    """(t - 1/2)^2 at -1, 0, 1 and 2 rises by 2 and falls by 1/4 more, below a place that is lower than those."""

    def step(t: float, margin: float) -> Any:
        return SimpleNamespace(at=t, equilibrium=SimpleNamespace(margin=margin))

    def between(one: Any, other: Any) -> Any:
        t = (one.at + other.at) / 2
        return step(t, high * (t - 0.5) ** 2)

    dip = [step(t, high * (t - 0.5) ** 2) for t in (-1.0, 0.0, 1.0, 2.0)]
    verifier: Any = SimpleNamespace(midway=between, exhausted=False)
    for elsewhere in (9.0, 0.01):
        steps = [*dip, step(3.0, elsewhere * high)]
        assert trajectory_trace._least_margin(verifier, steps) <= trajectory_trace.DIP


def test_no_step_is_made_to_an_unstable_equilibrium(monkeypatch: pytest.MonkeyPatch) -> None:
    """Opposed tubes that are long stand on a saddle, which Newton's method finds."""
    robot = nested((0.0, 0.05, 30.0), (0.0, 0.05, 30.0))
    joints = np.array([np.pi, 0.0, 0.0, 0.0])
    flat = forward_kinematics(robot, [0.0, 0.0])
    saddle = SimpleNamespace(stable=False)
    verifier = verifier_of(robot)
    for name, find in (("step", "forward_kinematics"), ("step_by_one_solve", "one_step")):
        monkeypatch.setattr(trajectory_trace, find, lambda *_, **__: saddle)
        assert getattr(verifier, name)(TraceStep(0.0, flat, 0 * joints), 1.0, joints) is None
