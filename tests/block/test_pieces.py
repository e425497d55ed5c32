"""Blocks of robots with tubes made of pieces: what forward kinematics says of the same robot, whatever is free."""

from __future__ import annotations

import math
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from tubeopt import (
    ConcentricRobot,
    EquilibriumBlock,
    InputError,
    Ipopt,
    Piece,
    Problem,
    Tube,
    forward_kinematics,
    load_robot,
    snap_free_certificate,
)
from tubeopt.typing import Array

from ..examples import CONFIGS

FIRST = Ipopt(hessian="limited-memory")
"""By first derivatives alone: enough where little is left to choose, and built in a fraction of the time."""

EXAMPLE = load_robot(CONFIGS / "example_pieces.yaml")
TURNED, SHIFT = np.array([0.0, 1.0, 2.0]), np.array([-0.02, -0.01, 0.0])


def helix_and_wave(curvature: Array, plane: float, twist: float, factors: Array, length: float) -> ConcentricRobot:
    """A wave and a helix in an arc of which the second half is slotted, made anew for every dimension."""
    inner = Tube(1e-3, 0.8e-3, 0.06, 0.07, 0.0)
    wave = Piece(length, lambda s: (curvature[0] * math.cos(30 * s * 0.03 / length), 0.0, 0.0))
    own = np.array([float(inner.bending_stiffness), float(inner.torsional_stiffness)]) * factors
    bend = curvature[1] * math.cos(plane), curvature[1] * math.sin(plane), twist
    helix = Piece(0.04, bend, bending_stiffness=own[0], torsional_stiffness=own[1])
    return ConcentricRobot(
        (
            Tube.of_pieces(1e-3, 0.8e-3, [wave, helix], straight_length=0.06),
            Tube.of_pieces(1.5e-3, 1.2e-3, [Piece(0.03, 12.0), Piece(0.03, -9.0)], straight_length=0.03),
        )
    )


BEFORE = helix_and_wave(np.array([14.0, 10.0]), 0.4, 15.0, np.array([0.5, 0.8]), 0.03)
AFTER = helix_and_wave(np.array([12.0, 13.0]), 0.9, 22.0, np.array([0.4, 0.7]), 0.034)
AFTER_BENDS = {"piece_curvature": [12.0, 13.0, 12.0, -9.0], "piece_plane": [0.0, 0.5, 0.0, 0.0]}
AFTER_REST = {
    "piece_twist": [0.0, 22.0, 0.0, 0.0],
    "piece_length": [0.034, 0.04, 0.03, 0.03],
    "piece_bending_factor": [1.0, 0.8, 1.0, 1.0],
    "piece_torsion_factor": [1.0, 0.875, 1.0, 1.0],
}


def test_square_program_is_forward_kinematics() -> None:
    near = forward_kinematics(EXAMPLE, TURNED, SHIFT)
    known = forward_kinematics(EXAMPLE, TURNED + 0.1, SHIFT - 1e-3)
    problem = Problem()
    block = EquilibriumBlock(problem, near, rotations=TURNED + 0.1, translations=SHIFT - 1e-3)
    solution = problem.solve(FIRST)
    np.testing.assert_allclose(solution.value(block.tip_position), known.tip_position, atol=1e-9)
    np.testing.assert_allclose(solution.value(block.tip_rotation), known.tip_rotation, atol=1e-8)
    np.testing.assert_allclose(solution.value(block.tip_rotations), known.rotation[:, -1], atol=1e-8)
    assert solution.value(block.energy) == pytest.approx(known.energy, rel=1e-8)
    k = len(known.arc_length) // 3
    part = known.arc_length[k] / known.arc_length[-1]
    np.testing.assert_allclose(solution.value(block.position(part)), known.position[k], atol=1e-9)
    np.testing.assert_allclose(solution.value(block.rotation(part)), known.rotation[:, k], atol=1e-8)
    np.testing.assert_allclose(solution.value(block.torsion(part)), known.torsion[:, k], atol=1e-6)
    np.testing.assert_allclose(solution.value(block.curvature(part)), known.curvature[k], atol=1e-7)
    result = block.equilibrium(solution)
    assert result.verification is not None
    assert result.verification.tip_position < 1e-9


def test_dimensions_of_pieces_are_those_of_a_robot_made_with_them() -> None:
    """Curvature of a wave, plane, twist, slots and length at once: the block's robot is the one made by hand."""
    turned, shift = np.array([0.3, 1.4]), np.array([-0.01, -0.005])
    near, known = (forward_kinematics(robot, turned, shift) for robot in (BEFORE, AFTER))
    problem = Problem()
    tubes = {}
    for name, goal in {**AFTER_BENDS, **AFTER_REST}.items():
        start = np.array(goal) if name not in ("piece_length",) else np.array([0.03, 0.04, 0.03, 0.03])
        tubes[name] = problem.variable(name, 4, guess=start)
        problem.subject_to(f"{name} as wanted", tubes[name] - np.array(goal), upper=0.0)
    block = EquilibriumBlock(problem, near, tubes=tubes)
    solution = problem.solve(FIRST)
    np.testing.assert_allclose(solution.value(block.tip_position), known.tip_position, atol=1e-9)
    assert solution.value(block.energy) == pytest.approx(known.energy, rel=1e-7)
    result = block.equilibrium(solution)
    np.testing.assert_allclose(result.tip_position, known.tip_position, atol=1e-9)
    assert result.margin == pytest.approx(known.margin, abs=1e-7)
    for mine, by_hand in zip(result.robot.tubes, AFTER.tubes, strict=True):
        for one, other in zip(mine.pieces, by_hand.pieces, strict=True):
            assert one.largest_curvature == pytest.approx(other.largest_curvature, rel=1e-9)
            assert one.length == pytest.approx(other.length, rel=1e-9)


def test_derivatives_by_dimensions_of_pieces() -> None:
    """The slope of the tip along the program's solutions, against differences of forward kinematics."""
    turned, shift = np.array([0.3, 1.4]), np.array([-0.01, -0.005])
    near = forward_kinematics(BEFORE, turned, shift)
    problem = Problem()
    bend = problem.variable("bend of the helix", guess=10.0)
    block = EquilibriumBlock(problem, near, tubes={"piece_curvature": ca.vertcat(14.0, bend, 12.0, -9.0)})
    goal = forward_kinematics(
        helix_and_wave(np.array([14.0, 11.0]), 0.4, 15.0, np.array([0.5, 0.8]), 0.03), turned, shift
    )
    problem.minimize(1e6 * ca.sumsqr(block.tip_position - goal.tip_position))
    assert problem.solve(FIRST).value(bend) == pytest.approx(11.0, abs=1e-6)


def test_largest_margin_that_can_be_demanded_is_the_margin() -> None:
    near = forward_kinematics(BEFORE, np.array([2.2, 0.0]))
    assert near.margin < 0.95
    problem = Problem()
    smallest = problem.variable("margin", guess=near.margin - 0.1, upper=0.999)
    block = EquilibriumBlock(problem, near, refinement=0)
    block.margin_at_least(smallest)
    problem.maximize(smallest)
    assert problem.solve(replace(FIRST, expand=True)).value("margin") == pytest.approx(near.margin, abs=1e-7)


def test_largest_certificate_that_can_be_demanded_is_the_certificate() -> None:
    """Of helices, arcs and slots, found there as the least eigenvalue of another matrix."""
    near = forward_kinematics(EXAMPLE, TURNED, SHIFT)
    known = snap_free_certificate(EXAMPLE, SHIFT)
    problem = Problem()
    smallest = problem.variable("certificate", guess=known - 0.3)
    block = EquilibriumBlock(problem, near, refinement=0)
    block.certificate_at_least(smallest)
    problem.maximize(smallest)
    solution = problem.solve(FIRST)
    assert solution.value(smallest) == pytest.approx(known, abs=1e-6)
    # Looked at again by the largest eigenvalue in place of a determinant.
    assert block.bounds[0].value(block.model.at(solution.value), block.chain) == pytest.approx(known, abs=1e-6)
    assert block.equilibrium(solution).margin > known
    with pytest.raises(InputError, match="curvature or stiffness"):
        EquilibriumBlock(Problem(), forward_kinematics(BEFORE, [0.3, 1.4])).certificate_at_least(0.0)


def test_a_joint_of_pieces_passes_the_plate() -> None:
    """The inner tube is drawn back until the joint of its pieces lies behind the plate: the order changes."""
    near = forward_kinematics(EXAMPLE, TURNED, [-0.024, -0.012, -0.002])
    goal = forward_kinematics(EXAMPLE, TURNED, [-0.034, -0.012, -0.002])
    problem = Problem()
    shift = problem.variable("translation", guess=-0.024, lower=-0.06, upper=0.0, scale=0.01)
    block = EquilibriumBlock(problem, near, translations=ca.vertcat(shift, -0.012, -0.002), refinement=0)
    problem.minimize(1e4 * ca.sumsqr(shift + 0.034))
    solution = problem.solve()
    assert solution.value(shift) == pytest.approx(-0.034, abs=1e-7)
    np.testing.assert_allclose(block.equilibrium(solution).tip_position, goal.tip_position, atol=1e-8)


def test_a_helix_alone_is_not_strained() -> None:
    tube = Tube.of_pieces(1e-3, 0.8e-3, [Piece.helix(0.12, 0.02, 0.08)], straight_length=0.05)
    near = forward_kinematics(ConcentricRobot((tube,)), [0.3])
    problem = Problem()
    block = EquilibriumBlock(problem, near)
    assert np.abs(problem.solve(FIRST).value(block.strain(0))).max() < 1e-9


def test_wrong_names_are_told() -> None:
    near = forward_kinematics(EXAMPLE, TURNED, SHIFT)
    with pytest.raises(InputError, match="piece_curvature"):
        EquilibriumBlock(Problem(), near, tubes={"piece_curvatures": np.ones(6)})
    with pytest.raises(InputError, match=r"piece_curvature.; for tubes made of pieces, give one of them"):
        EquilibriumBlock(Problem(), near, tubes={"piece_curvature": np.ones(6), "curvature": np.ones(3)})
    with pytest.raises(InputError, match="6 finite numbers"):
        EquilibriumBlock(Problem(), near, tubes={"piece_plane": np.ones(4)})
