"""Tubes that end at one place: the innermost holds the tool, however round-off orders their ends."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from tests.equilibrium.test_moments_along_the_arm import agrees, shot
from tests.load_reference import RefLoad
from tubeopt import (
    ConcentricRobot,
    Equilibrium,
    EquilibriumBlock,
    Load,
    forward_kinematics,
    forward_kinematics_batch,
    load_robot,
)
from tubeopt.robots.order import last_tube, tip_tube, twisted_tube
from tubeopt.typing import Array

NONE = (0.0, 0.0, 0.0)
MOMENT = (1e-3, 2e-3, 4e-3)
ROTATIONS = (0.3, 1.4, -0.6)
NAMES = ("two_tube", "example_equal_ends")
NEAR = (1e-15, -1e-15, 1e-13, -1e-13, 1e-12, -1e-12, 5e-11, -5e-11)


def of(name: str) -> ConcentricRobot:
    robot = load_robot(f"configs/robots/{name}.yaml")
    assert isinstance(robot, ConcentricRobot)
    return robot


def together(robot: ConcentricRobot) -> Array:
    """(n,) translations with which all tubes end 50 mm before the plate."""
    return np.array([0.05 - tube.curved_length for tube in robot.tubes])


def check_same(one: Equilibrium, other: Equilibrium, tolerance: float = 1e-9) -> None:
    assert np.linalg.norm(one.tip_position - other.tip_position) < tolerance
    assert np.abs(one.tip_rotation - other.tip_rotation).max() < 10 * tolerance
    assert np.abs(one.tip_rotations - other.tip_rotations).max() < 10 * tolerance


@pytest.mark.parametrize("name", NAMES)
def test_shape_under_a_moment_does_not_depend_on_round_off(name: str) -> None:
    robot = of(name)
    shift = together(robot)
    whole = forward_kinematics(robot, ROTATIONS[: robot.n_tubes], shift, load=Load(moment=MOMENT))
    for off in NEAR:
        for tube in range(robot.n_tubes):
            moved = shift + off * np.eye(robot.n_tubes)[tube]
            equilibrium = forward_kinematics(robot, ROTATIONS[: robot.n_tubes], moved, load=Load(moment=MOMENT))
            check_same(equilibrium, whole)
            assert equilibrium.margin == pytest.approx(whole.margin, abs=1e-7)


@pytest.mark.parametrize("off", [0.0, 1e-15, -1e-15, 1e-11, -1e-11])
@pytest.mark.parametrize("name", NAMES)
def test_all_that_bears_a_moment_at_the_tip_agrees(name: str, off: float) -> None:
    """Shooting, verification, a point moment at the arm's end, compliance, the block, and differences."""
    robot = of(name)
    shift = together(robot) + off * np.eye(robot.n_tubes)[1]
    e = forward_kinematics(robot, ROTATIONS[: robot.n_tubes], shift, load=Load(moment=MOMENT), verify=True)
    assert e.verification is not None
    assert e.verification.tip_position < 1e-9
    assert e.verification.end_torsion < 1e-7
    if abs(off) < 1e-12:  # the mesh of the reference is rounded to this
        agrees(e, shot(robot, e, RefLoad(moment=MOMENT)))
    at_end = Load(points=((float(e.arc_length[-1]), NONE, MOMENT),))
    check_same(forward_kinematics(robot, ROTATIONS[: robot.n_tubes], shift, load=at_end, verify=True), e)
    # A moment along the tip turns the tube whose rotation the compliance has.
    step, tangent = 1e-6, e.tip_rotation[:, 2]
    ends = [
        forward_kinematics(
            robot, ROTATIONS[: robot.n_tubes], shift, load=Load(moment=MOMENT + sign * step * tangent), tolerance=1e-11
        )
        for sign in (1, -1)
    ]
    turned = (ends[0].tip_rotations - ends[1].tip_rotations)[0] / (2 * step)
    frames = (ends[0].tip_rotation - ends[1].tip_rotation) / (2 * step) @ e.tip_rotation.T
    turned += np.array([frames[2, 1], frames[0, 2], frames[1, 0]]) @ tangent
    assert tangent @ e.compliance[3:, 3:] @ tangent == pytest.approx(turned, rel=1e-5)
    opti = ca.Opti()
    block = EquilibriumBlock(opti, e, load=Load(moment=MOMENT))
    opti.solver("ipopt", {"ipopt.print_level": 0, "print_time": False, "ipopt.tol": 1e-12})
    assert np.linalg.norm(opti.solve().value(block.tip_position) - e.tip_position) < 1e-8


@pytest.mark.parametrize("name", NAMES)
def test_compliance_does_not_depend_on_round_off(name: str) -> None:
    robot = of(name)
    shift = together(robot)
    e = forward_kinematics(robot, ROTATIONS[: robot.n_tubes], shift, load=Load((0.01, 0.02, 0.0)))
    size = np.abs(e.compliance).max()
    assert np.allclose(e.compliance_at(float(e.arc_length[-1])), e.compliance, rtol=0, atol=1e-8 * size)
    for off in NEAR:
        for tube in range(robot.n_tubes):
            moved = shift + off * np.eye(robot.n_tubes)[tube]
            other = forward_kinematics(robot, ROTATIONS[: robot.n_tubes], moved, load=e.load)
            batch = forward_kinematics_batch(robot, [ROTATIONS[: robot.n_tubes]] * 2, [moved] * 2, load=e.load)
            along = other.compliance_at(float(other.arc_length[-1]))
            for result in (other.compliance, *batch.compliance, along):
                assert np.allclose(result, e.compliance, rtol=0, atol=1e-7 * size)


def test_a_moment_elsewhere_is_on_the_outermost_tube_and_at_the_tip_on_the_innermost() -> None:
    end = np.array([0.1, 0.1 - 1e-12, 0.06])
    assert (tip_tube(end), int(last_tube(end)), twisted_tube(end, 0.1)) == (0, 0, 0)
    assert [twisted_tube(end, s) for s in (0.0, 0.06 + 1e-13, 0.061, 0.1 - 1e-7, 0.1 - 1e-12)] == [2, 2, 1, 1, 0]
    assert last_tube(np.array([[0.1, 0.1 + 1e-15], [0.1, 0.2]])).tolist() == [0, 1]
