"""Blocks of arms that bear a load say what forward kinematics says, and what independent shooting says."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from tests.examples import CONFIGS, CRL, THESIS, TWO_TUBE, eccentric_robot
from tubeopt import (
    ConcentricRobot,
    EquilibriumBlock,
    InputError,
    Ipopt,
    Load,
    Problem,
    forward_kinematics,
    load_robot,
    snap_free_certificate,
)
from tubeopt.solvers.named_program import few_directions

TURNED = [0.0, 1.0, 2.0]


def solved(opti: ca.Opti) -> Any:
    """Of a square program, whose Newton steps no second derivative changes."""
    quiet = {"print_level": 0, "sb": "yes", "tol": 1e-11, "hessian_approximation": "limited-memory"}
    opti.solver("ipopt", {"print_time": False}, quiet)
    with few_directions():
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
    results, desired = np.array(solved(opti).value(jacobian)), near.jacobian(wrt=names).position
    np.testing.assert_allclose(results, desired, atol=1e-6 * np.abs(desired).max(), rtol=1e-6)


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
    result = block.equilibrium(problem.solve())
    again = forward_kinematics(TWO_TUBE, result.rotations, result.translations, load=load)
    np.testing.assert_allclose(again.tip_position, free.tip_position, atol=1e-8)
    assert again.margin > 0.5


def test_largest_margin_under_load_that_can_be_demanded_is_the_margin() -> None:
    """That of the energy in its own coordinates, whose second variation the Jacobi fields know nothing of."""
    near = forward_kinematics(TWO_TUBE, [2.9, 0.0], load=Load((0.0, 0.0, -0.4), gravity=(0.0, -9.81, 0.0)))
    assert 0.6 < near.margin < 0.65
    problem = Problem()
    smallest = problem.variable("margin", guess=near.margin - 0.1, upper=0.999)
    EquilibriumBlock(problem, near, refinement=0).margin_at_least(smallest)
    problem.maximize(smallest)
    assert problem.solve(Ipopt(hessian="limited-memory")).value("margin") == pytest.approx(near.margin, abs=1e-7)


def test_margin_keeps_a_loaded_robot_from_the_snap() -> None:
    """Turned as far as the margin under the load allows; without load it would not have been that."""
    load = Load((0.1, 0.0, -0.2))
    near = forward_kinematics(TWO_TUBE, [2.6, 0.0], load=load)
    problem = Problem()
    turn = problem.variable("turn", guess=2.6)
    block = EquilibriumBlock(problem, near, rotations=[turn, 0.0], refinement=0)
    block.margin_at_least(0.3)
    problem.maximize(turn)
    result = block.equilibrium(problem.solve())
    again = forward_kinematics(TWO_TUBE, result.rotations, load=load, start=near)
    assert again.margin == pytest.approx(0.3, abs=1e-6)
    assert abs(forward_kinematics(TWO_TUBE, result.rotations).margin - 0.3) > 0.02


def test_what_a_block_does_not_bear_is_refused() -> None:
    near = forward_kinematics(TWO_TUBE, [0.0, 1.0])
    for load, message in (
        (Load(points=[(0.05, (0.01, 0.0, 0.0))]), "load has points, stretches or a function along the arm"),
        ((0.1, 0.0, 0.0), "it must be a Load"),
    ):
        with pytest.raises(InputError, match=message):
            EquilibriumBlock(ca.Opti(), near, load=load)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="load is given for an eccentric robot"):
        EquilibriumBlock(ca.Opti(), forward_kinematics(eccentric_robot(0.02), [0.0, 1.0, -1.0]), load=Load((0.1, 0, 0)))
    block = EquilibriumBlock(ca.Opti(), near, load=Load((0.01, 0.0, 0.0)))
    with pytest.raises(InputError, match="force of 10 mN; it must be at most max_force, 9 mN"):
        block.certificate_at_least(0.0, max_force=0.009)
    with pytest.raises(InputError, match="max_force is -1"):
        block.certificate_at_least(0.0, max_force=-1.0)
    turning = EquilibriumBlock(ca.Opti(), near, load=Load((0.01, 0.0, 0.0), frame="tip"))
    with pytest.raises(InputError, match="it has no energy, so the arm has no margin"):
        turning.margin_at_least(0.1)


@pytest.mark.parametrize(
    ("robot", "shift", "force"), [(TWO_TUBE, [-0.01, -0.03], 0.02), (CRL, [-0.02, -0.01, -0.01], 0.003)]
)
def test_certificate_under_force_is_that_of_the_library_and_so_are_its_derivatives(
    robot: ConcentricRobot, shift: list[float], force: float
) -> None:
    """How the largest certificate of a program changes with what is held in it are its multipliers: of three tubes in
    their bound for weak forces, of two in that where all are opposed."""
    near = forward_kinematics(robot, np.zeros(robot.n_tubes), shift)
    problem = Problem()
    names = "curvature", "torsional_stiffness", "bending_stiffness"
    start = {name: np.array([getattr(tube, name) for tube in robot.tubes]) for name in names}
    factors = {name: problem.variable(name, robot.n_tubes, guess=1.0) for name in names}
    out = problem.variable("out", robot.n_tubes, guess=shift, scale=0.05)
    tubes = {name: ca.DM(start[name]) * factors[name] for name in names}
    block = EquilibriumBlock(problem, near, translations=out, tubes=tubes, refinement=0)
    smallest = problem.variable("least", guess=0.0)
    block.certificate_at_least(smallest, max_force=force)
    for name in names:
        problem.subject_to(f"held {name}", factors[name] == np.ones(robot.n_tubes))
    problem.subject_to("held out", out == np.array(shift), scale=0.05)
    problem.maximize(smallest)
    solution = problem.solve()

    def certificate(name: str, index: int, factor: float) -> float:
        tubes = list(robot.tubes)
        tubes[index] = replace(tubes[index], **{name: factor * getattr(tubes[index], name)})
        return snap_free_certificate(replace(robot, tubes=tuple(tubes)), shift, max_force=force)

    assert solution.value("least") == pytest.approx(certificate("curvature", 0, 1.0), abs=1e-9)
    assert block.bounds[0].value(block.model.at(solution.value)) == pytest.approx(
        snap_free_certificate(robot, shift, max_force=force), abs=1e-10
    )
    for name in names:
        desired = [(certificate(name, i, 1.0001) - certificate(name, i, 0.9999)) / 2e-4 for i in range(robot.n_tubes)]
        result = -solution.multiplier(f"held {name}")
        np.testing.assert_allclose(result, desired, rtol=1e-6, atol=1e-6 * np.abs(desired).max())
