"""Blocks of arms that bear a load say what forward kinematics says, and what independent shooting says."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from tests.examples import CONFIGS, THESIS, TWO_TUBE, eccentric_robot
from tubeopt import EquilibriumBlock, InputError, Load, Problem, forward_kinematics, load_robot

TURNED = [0.0, 1.0, 2.0]


def solved(opti: ca.Opti) -> Any:
    """Of a square program, whose Newton steps no second derivative changes."""
    quiet = {"print_level": 0, "sb": "yes", "tol": 1e-11, "hessian_approximation": "limited-memory"}
    opti.solver("ipopt", {"print_time": False}, quiet)
    return opti.solve()


def test_a_dead_force_puts_the_tip_where_shooting_does() -> None:
    """From DOP853 shooting at 1e-12 (tip in mm); the block begins at the equilibrium under another force."""
    near = forward_kinematics(THESIS, TURNED, load=Load((0.095, 0.004, 0.0)))
    opti = ca.Opti()
    block = EquilibriumBlock(opti, near, load=Load((0.1, 0.0, 0.0)))
    tip = solved(opti).value(block.tip_position)
    np.testing.assert_allclose(1e3 * tip, [102.947988424, -23.162540628, 151.322371031], atol=1e-6)


@pytest.mark.parametrize(
    "load",
    [
        Load((0.02, -0.03, 0.05), (0.002, 0.001, 0.003)),
        Load((0.02, -0.03, 0.05), (0.002, 0.001, 0.003), frame="tip"),
        Load((0.0, 0.0, -0.1), distributed=(0.2, 0.1, -0.3), gravity=(0.0, -9.81, 0.0)),
    ],
    ids=["moment", "turning", "weight"],
)
def test_square_program_is_forward_kinematics(load: Load) -> None:
    """Moments and forces that turn with the tip, weight, a force along the arm."""
    near = forward_kinematics(THESIS, TURNED, load=load)
    opti = ca.Opti()
    block = EquilibriumBlock(opti, near)
    solution = solved(opti)
    np.testing.assert_allclose(solution.value(block.tip_position), near.tip_position, atol=1e-10)
    np.testing.assert_allclose(solution.value(block.tip_rotation), near.tip_rotation, atol=1e-8)
    assert solution.value(block.energy) == pytest.approx(near.energy, rel=1e-9)
    again = block.equilibrium(solution)
    assert again.load == load
    np.testing.assert_allclose(again.tip_position, near.tip_position, atol=1e-12)


def test_tubes_of_pieces_under_load() -> None:
    """A helix, an S and slots."""
    robot = load_robot(CONFIGS / "example_pieces.yaml")
    load = Load((0.02, 0.03, -0.01))
    near = forward_kinematics(robot, TURNED, [-0.06, -0.03, -0.01], load=load)
    opti = ca.Opti()
    block = EquilibriumBlock(opti, near)
    solution = solved(opti)
    np.testing.assert_allclose(solution.value(block.tip_position), near.tip_position, atol=1e-8)
    np.testing.assert_allclose(block.equilibrium(solution).tip_position, near.tip_position, atol=1e-10)


def test_jacobian_under_load_is_that_of_the_library() -> None:
    near = forward_kinematics(TWO_TUBE, [0.0, 1.2], [-0.01, -0.03], load=Load((0.03, -0.02, 0.01)))
    names = ("translations", "curvature")
    opti = ca.Opti()
    jacobian = EquilibriumBlock(opti, near, refinement=0).jacobian(names)
    found, wanted = np.array(solved(opti).value(jacobian)), near.jacobian(wrt=names).position
    np.testing.assert_allclose(found, wanted, atol=1e-6 * np.abs(wanted).max(), rtol=1e-6)


def test_joints_that_make_up_for_a_load() -> None:
    """Rotations and translations bring the tip back to where it is without load, also where breakpoints move."""
    joints = [0.0, 1.0], [-0.01, -0.03]
    free, load = forward_kinematics(TWO_TUBE, *joints), Load((0.02, 0.01, -0.02), gravity=(0.0, 0.0, -9.81))
    near = forward_kinematics(TWO_TUBE, *joints, load=load)
    assert np.linalg.norm(near.tip_position - free.tip_position) > 5e-4
    problem = Problem()
    turn = problem.variable("rotations", 2, guess=joints[0])
    shift = problem.variable("translations", 2, guess=joints[1], scale=0.1)
    block = EquilibriumBlock(problem, near, rotations=turn, translations=shift)
    problem.subject_to("tip", block.tip_position == free.tip_position, scale=0.1)
    problem.minimize(ca.sumsqr(turn - near.rotations) + ca.sumsqr((shift - near.translations) / 0.05))
    found = block.equilibrium(problem.solve())
    again = forward_kinematics(TWO_TUBE, found.rotations, found.translations, load=load)
    np.testing.assert_allclose(again.tip_position, free.tip_position, atol=1e-8)
    assert again.margin > 0.5


def test_what_a_block_does_not_bear_is_refused() -> None:
    near = forward_kinematics(TWO_TUBE, [0.0, 1.0])
    for load, message in (
        (Load(points=[(0.05, (0.01, 0.0, 0.0))]), "load has points, stretches or a function along the arm"),
        ((0.1, 0.0, 0.0), "it must be a Load"),
    ):
        with pytest.raises(InputError, match=message):
            EquilibriumBlock(ca.Opti(), near, load=load)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="load is given for tubes beside one another"):
        EquilibriumBlock(ca.Opti(), forward_kinematics(eccentric_robot(0.02), [0.0, 1.0, -1.0]), load=Load((0.1, 0, 0)))
    block = EquilibriumBlock(ca.Opti(), near, load=Load((0.01, 0.0, 0.0)))
    for ask in (lambda: block.margin_at_least(0.1), lambda: block.certificate_at_least(0.0)):
        with pytest.raises(InputError, match="of an arm under load is no expression"):
            ask()
