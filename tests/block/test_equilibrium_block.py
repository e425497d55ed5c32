"""The block says what forward kinematics says, with exact second derivatives, whatever is free in it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

import tubeopt
from tests.examples import CONFIGS, CRL, THESIS, TWO_TUBE, eccentric_robot
from tubeopt import EquilibriumBlock, InputError, OrderWarning, Piece, Problem, SolveError, Tube, forward_kinematics
from tubeopt.block.transcription.model import mapped
from tubeopt.bodies.obstacles import Sphere
from tubeopt.robots.robot import Robot
from tubeopt.solvers.named_program import few_directions

SEGMENTED = tubeopt.load_robot(CONFIGS / "example_three_segment_etr.yaml")
FIRST = tubeopt.Ipopt(hessian="limited-memory")
"""By first derivatives alone: enough where little is left to choose, and built in a fraction of the time."""
QUIET = {"print_level": 0, "sb": "yes", "tol": 1e-11}
ROBOTS = [
    (THESIS, [0.0, 1.0, 2.0], [0.0, 0.0, 0.0]),
    (THESIS, [0.3, -0.8, 1.2], [0.01, 0.02, -0.03]),
    (CRL, [0.5, 1.5, 0.0], [-0.01, -0.005, 0.005]),
    (eccentric_robot(0.02), [0.3, 1.4, -0.9], [0.0, 0.0, 0.0]),
    (SEGMENTED, list(np.linspace(-0.4, 0.5, 9)), None),
]


def solved(opti: ca.Opti, hessian: str = "limited-memory") -> Any:
    """Of a square program, unless told otherwise, no second derivative changes the steps."""
    opti.solver("ipopt", {"print_time": False}, {**QUIET, "hessian_approximation": hessian})
    with few_directions():
        return opti.solve()


@pytest.mark.parametrize(("robot", "rotations", "translations"), ROBOTS)
def test_square_program_is_forward_kinematics(robot: Robot, rotations: list[float], translations: Any) -> None:
    """From a neighbouring equilibrium to given joint values: the solver has no choice."""
    shift = robot.home_translations if translations is None else np.array(translations)
    near = forward_kinematics(robot, np.array(rotations) + 0.05, shift)
    known = forward_kinematics(robot, rotations, shift)
    opti = ca.Opti()
    block = EquilibriumBlock(opti, near, rotations=rotations)
    solution = solved(opti)
    length = known.arc_length[-1]
    np.testing.assert_allclose(solution.value(block.tip_position), known.tip_position, atol=1e-8)
    np.testing.assert_allclose(solution.value(block.tip_rotation), known.tip_rotation, atol=1e-7)
    assert solution.value(block.energy) == pytest.approx(known.energy, rel=1e-8)
    assert solution.value(block.length) == pytest.approx(length)
    k = len(known.arc_length) // 3
    part = known.arc_length[k] / length
    np.testing.assert_allclose(solution.value(block.position(part)), known.position[k], atol=1e-8)
    np.testing.assert_allclose(solution.value(block.orientation(part)), known.frame[k], atol=1e-7)
    np.testing.assert_allclose(solution.value(block.rotation(part)), known.rotation[:, k], atol=1e-7)
    result = block.equilibrium(solution)
    np.testing.assert_allclose(result.tip_position, known.tip_position, atol=1e-8)
    assert result.verification is not None
    assert result.verification.tip_position < 1e-8


def test_hessians_are_exact_and_newton_is_quick() -> None:
    """With exact second derivatives the last steps converge quadratically; a quasi-Newton method takes many more."""
    near = forward_kinematics(THESIS, [0.0, 1.0, 2.0], [-0.03, -0.02, -0.01])
    counts = {}
    for hessian in ("exact", "limited-memory"):
        opti = ca.Opti()
        turn = opti.variable(3)
        opti.set_initial(turn, near.rotations)
        block = EquilibriumBlock(opti, near, rotations=turn)
        opti.minimize(ca.sumsqr(turn - near.rotations))
        opti.subject_to(block.tip_position[:2] == near.tip_position[:2] + np.array([3e-3, -2e-3]))
        options = {**QUIET, "hessian_approximation": hessian}
        opti.solver("ipopt", {"print_time": False, "expand": True}, options)
        counts[hessian] = opti.solve().stats()["iter_count"]
    assert counts["exact"] <= 8
    assert counts["limited-memory"] > counts["exact"]


@pytest.mark.parametrize(
    ("robot", "rotations"),
    [(THESIS, [0.0, np.pi / 2, np.pi]), (TWO_TUBE, [3.3, 0.0]), (eccentric_robot(0.02), [0.3, 2.2, -1.4])],
)
def test_largest_margin_that_can_be_demanded_is_the_margin(robot: Robot, rotations: list[float]) -> None:
    wound = forward_kinematics(robot, 0.7 * np.array(rotations))
    near = forward_kinematics(robot, rotations, start=wound)
    assert near.margin < 0.97
    problem = Problem()
    smallest = problem.variable("margin", guess=near.margin - 0.1, upper=0.999)
    block = EquilibriumBlock(problem, near, refinement=0)
    block.margin_at_least(smallest)
    problem.maximize(smallest)
    margin = problem.solve(replace(FIRST, expand=True)).value("margin")
    # `margin` of eccentric robots by the compiled kernel is good to 1e-6 and better where it is farther from 1.
    assert margin == pytest.approx(near.margin, abs=1e-6 if block.model.offsets else 1e-8)


def test_margin_keeps_a_robot_from_the_snap() -> None:
    """Turned towards its snap at 203.9 deg, the robot stops where the margin is as demanded."""
    near = forward_kinematics(TWO_TUBE, [2.6, 0.0])
    problem = Problem()
    turn = problem.variable("turn", guess=2.6)
    block = EquilibriumBlock(problem, near, rotations=[turn, 0.0])
    block.margin_at_least(0.3)
    problem.maximize(turn)
    result = block.equilibrium(problem.solve())
    assert result.margin == pytest.approx(0.3, abs=1e-7)
    assert result.rotations[0] < np.radians(203.9)


@pytest.mark.parametrize("robot", [TWO_TUBE, CRL])
def test_certificate_is_that_of_the_library(robot: Robot) -> None:
    """Shortened until the certificate is as demanded, from translations where it is larger."""
    short = np.array([-0.06, -0.05, -0.03])[: robot.n_tubes]
    near = forward_kinematics(robot, np.zeros(robot.n_tubes), short)
    floor = tubeopt.snap_free_certificate(robot, short) - 0.1
    problem = Problem()
    out = problem.variable("out", guess=0.0, scale=0.01)
    block = EquilibriumBlock(problem, near, translations=ca.DM(short) + out)
    block.certificate_at_least(floor)
    problem.maximize(100 * out)
    result = block.equilibrium(problem.solve(FIRST))
    assert tubeopt.snap_free_certificate(robot, result.translations) == pytest.approx(floor, abs=1e-7)


@pytest.mark.parametrize("force", [0.0, 0.05])
def test_a_certificate_that_a_determinant_does_not_deny_is_refused(force: float) -> None:
    """Of three tubes that are nearly alike two eigenvalues are, too: beyond both the determinant is positive."""
    like = {"curvature": 15.0, "straight_length": 0.1, "bending_stiffness": 0.05, "torsional_stiffness": 0.04}
    tubes = [replace(tube, **like, curved_length=0.12 - 0.004 * i) for i, tube in enumerate(THESIS.tubes)]
    robot = tubeopt.ConcentricRobot(tuple(tubes))
    near = forward_kinematics(robot, [0.0, 0.1, -0.1], np.full(3, -1e-3))
    problem = Problem()
    out = problem.variable("out", guess=0.0, lower=-2e-3, upper=2e-3, scale=1e-3)
    block = EquilibriumBlock(problem, near, translations=near.translations + out * ca.DM.ones(3))
    block.certificate_at_least(0.0, max_force=force)
    problem.minimize((1e3 * out - 0.5) ** 2)
    solution = problem.solve(FIRST)
    assert tubeopt.snap_free_certificate(robot, solution.value(block.translations), max_force=force) < -3
    with pytest.raises(SolveError, match=r"the certificate (under 50 mN )?is -3\.\d+; it must be at least 0"):
        block.equilibrium(solution)


@pytest.mark.parametrize(
    ("robot", "translations", "wrt"),
    [
        (TWO_TUBE, [-0.01, -0.03], ["rotations", "translations"]),
        (eccentric_robot(0.02), [-0.01, -0.01, -0.01], ["translations"]),
    ],
)
def test_jacobian_is_that_of_differences(robot: Robot, translations: list[float], wrt: list[str]) -> None:
    rotations = np.linspace(0.0, 1.2, robot.n_tubes)
    near = forward_kinematics(robot, rotations, translations)
    opti = ca.Opti()
    block = EquilibriumBlock(opti, near, rotations=rotations + 0.02, refinement=0)
    jacobian = block.jacobian(wrt)
    result = solved(opti).value(jacobian)
    columns = [np.eye(robot.n_tubes)[i] * 1e-5 for i in range(robot.n_tubes)]
    moved = [np.where(np.isin(range(robot.n_tubes), tubes), 1e-6, 0.0) for tubes in robot.moving_together]
    at = rotations + 0.02, np.array(translations)

    def tip(turn: Any, shift: Any) -> Any:
        guess = forward_kinematics(robot, *at, tolerance=1e-12)
        return forward_kinematics(robot, at[0] + turn, at[1] + shift, start=guess, tolerance=1e-12).tip_position

    slopes = [(tip(step, 0) - tip(-step, 0)) / 2e-5 for step in columns if "rotations" in wrt]
    slopes += [(tip(0, step) - tip(0, -step)) / 2e-6 for step in moved]
    np.testing.assert_allclose(np.reshape(result, (3, -1)), np.array(slopes).T, atol=2e-7)


def test_jacobian_by_dimensions_is_that_of_the_library() -> None:
    near = forward_kinematics(TWO_TUBE, [0.0, 1.2], [-0.01, -0.03])
    names = ("curvature", "straight_length", "curved_length", "bending_stiffness", "torsional_stiffness")
    opti = ca.Opti()
    jacobian = EquilibriumBlock(opti, near, refinement=0).jacobian(names)
    results, desired = np.array(solved(opti).value(jacobian)), near.jacobian(wrt=names).position
    assert (np.abs(results - desired) <= 1e-8 * np.abs(desired).max(1, keepdims=True)).all()


def test_jacobian_by_pieces_is_that_of_tubes_of_one_curvature() -> None:
    """Two halves of an arc, curved together, are the arc; what lengthens the second half lengthens the tube."""
    arcs = [
        Tube.of_pieces(
            tube.outer_diameter,
            tube.inner_diameter,
            [Piece(tube.curved_length / 2, tube.curvature)] * 2,
            straight_length=tube.straight_length,
            material=tube.material,
        )
        for tube in TWO_TUBE.tubes
    ]
    joints = [0.0, 1.2], [-0.01, -0.03]
    near = forward_kinematics(tubeopt.ConcentricRobot(tuple(arcs)), *joints)
    opti = ca.Opti()
    jacobian = EquilibriumBlock(opti, near, refinement=0).jacobian(("piece_curvature", "piece_length"))
    halves = np.array(solved(opti).value(jacobian)).reshape(3, 2, 2, 2)
    results = np.concatenate([halves[:, 0].sum(2), halves[:, 1, :, 1]], axis=1)
    desired = forward_kinematics(TWO_TUBE, *joints).jacobian(wrt=("curvature", "curved_length")).position
    np.testing.assert_allclose(results, desired, atol=1e-7 * np.abs(desired).max())


def test_outputs_follow_an_arm_whose_lengths_are_free() -> None:
    """Asked at fractions of a length that the solve changes, over breakpoints that move past them."""
    start, goal = [-0.01, -0.02, -0.03], [0.015, 0.03, 0.02]
    near = forward_kinematics(THESIS, [0.0, 1.0, 2.0], start)
    problem = Problem()
    shift = problem.variable("translations", 3, guess=start, scale=0.1)
    block = EquilibriumBlock(problem, near, translations=shift, refinement=1)
    body = Sphere((0.02, 0.0, 0.1), 0.01)
    problem.minimize(1e4 * ca.sumsqr(shift - ca.DM(goal)))
    solution = problem.solve()
    assert solution.statistics.reorderings >= 3
    result = block.equilibrium(solution)
    np.testing.assert_allclose(result.translations, goal, atol=1e-9)
    np.testing.assert_allclose(solution.value(block.tip_position), result.tip_position, atol=1e-9)
    for k in range(2, len(result.arc_length), 5):
        part = result.arc_length[k] / result.arc_length[-1]
        np.testing.assert_allclose(solution.value(block.position(part)), result.position[k], atol=1e-8)
    strain = solution.value(block.strain(2))
    radius, natural = THESIS.tubes[2].outer_diameter / 2, THESIS.tubes[2].curvature
    s = result.arc_length
    own = np.where(s > goal[2], natural, 0.0)
    bend = result.curvature - (own * np.array([np.cos(result.rotation[2]), np.sin(result.rotation[2])])).T
    reached = (s < goal[2] + THESIS.tubes[2].curved_length - 1e-9) & (np.abs(s - goal[2]) > 1e-9)
    known = (radius * np.linalg.norm(bend, axis=1) / (1 - radius * own))[reached].max()
    assert strain.max() == pytest.approx(known, rel=0.02)
    clearance = solution.value(block.clearance(body)).min()
    thick = [tube.outer_diameter / 2 for tube in THESIS.tubes]
    outer = np.array([max(r for r, end in zip(thick, result.tube_end, strict=True) if s <= end + 1e-9) for s in s])
    assert clearance == pytest.approx((body.signed_distance(result.position) - outer).min(), abs=5e-4)


def test_dimensions_are_unknowns_and_come_back_as_a_robot() -> None:
    near = forward_kinematics(TWO_TUBE, [0.2, 1.0], [-0.01, -0.03])
    goal = {"curvature": [11.0, 14.0], "curved_length": [0.11, 0.09], "straight_length": [0.06, 0.045]}
    stiff = [tube.bending_stiffness * 1.04 for tube in TWO_TUBE.tubes]
    turn = [tube.torsional_stiffness * 0.97 for tube in TWO_TUBE.tubes]
    goal |= {"bending_stiffness": stiff, "torsional_stiffness": turn}
    opti = ca.Opti()
    tubes, cost = {}, 0.0
    for name, value in goal.items():
        size = np.abs(value).max()
        tubes[name] = size * opti.variable(2)
        opti.set_initial(tubes[name], [getattr(tube, name) for tube in TWO_TUBE.tubes])
        cost += ca.sumsqr((tubes[name] - ca.DM(value)) / size)
    block = EquilibriumBlock(opti, near, tubes=tubes)
    opti.minimize(cost)
    solution = solved(opti, "exact")
    result = block.equilibrium(solution)
    for name, value in goal.items():
        np.testing.assert_allclose([getattr(tube, name) for tube in result.robot.tubes], value, rtol=1e-7)
    again = forward_kinematics(result.robot, near.rotations, near.translations)
    np.testing.assert_allclose(solution.value(block.tip_position), again.tip_position, atol=1e-8)


def test_eccentric_tubes_of_a_segment_share_an_unknown() -> None:
    robot = eccentric_robot(0.02)
    near = forward_kinematics(robot, [0.3, 1.4, -0.9])
    problem = Problem()
    bend, shift = problem.variable("bend", guess=8.0, scale=10.0), problem.variable("shift", guess=0.0, scale=0.1)
    block = EquilibriumBlock(problem, near, translations=shift, tubes={"curvature": bend})
    problem.subject_to("bend is", bend == 8.8)
    problem.subject_to("shift is", shift == -0.01)
    solution = problem.solve(FIRST)
    result = block.equilibrium(solution)
    assert [tube.curvature for tube in result.robot.tubes] == pytest.approx([8.8] * 3)
    np.testing.assert_allclose(solution.value(block.tip_position), result.tip_position, atol=1e-8)


def test_margin_itself_can_be_maximised_close_to_1() -> None:
    near = forward_kinematics(THESIS, [0.0, 1.0, 3.4])
    problem = Problem()
    margin = problem.variable("margin", guess=0.5, upper=0.98)
    turn = problem.variable("turn", guess=3.4, lower=0.0, upper=np.pi + 1)
    block = EquilibriumBlock(problem, near, rotations=[0.0, 1.0, turn])
    block.margin_at_least(margin)
    problem.maximize(margin - 0.001 * (turn - 3.4) ** 2)
    solution = problem.solve()
    assert near.margin < 0.75
    assert solution.value("margin") == pytest.approx(0.98, abs=1e-6)
    # The turn is the least that gives this margin: it binds.
    assert block.equilibrium(solution).margin == pytest.approx(0.98, abs=1e-6)


def test_meeting_breakpoints_are_told_and_reordered_by_hand() -> None:
    start, goal = [0.0, -0.02], [-0.03, -0.01]
    near = forward_kinematics(TWO_TUBE, [0.0, 1.0], start)
    opti = ca.Opti()
    shift = opti.variable(2)
    opti.set_initial(shift, start)
    block = EquilibriumBlock(opti, near, translations=shift)
    opti.minimize(1e4 * ca.sumsqr(shift - ca.DM(goal)))
    solution = solved(opti, "exact")
    with pytest.warns(OrderWarning, match="the end of tube 1 is not before the end of tube 2, and they meet"):
        block.equilibrium(solution)
    assert solution.value(shift)[0] == pytest.approx(-0.02, abs=1e-6)
    opti.set_initial(solution.value_variables())
    block.reorder(solution)
    result = block.equilibrium(opti.solve())
    np.testing.assert_allclose(result.translations, goal, atol=1e-8)


def test_many_blocks_share_their_functions() -> None:
    """Four arms in one program: what the first one builds serves the others."""
    near = forward_kinematics(THESIS, [0.0, 1.0, 2.0], [-0.03, -0.02, -0.01])
    opti, last, cost, built = ca.Opti(), None, 0.0, []
    for _ in range(4):
        turn = opti.variable(3)
        opti.set_initial(turn, near.rotations)
        block = EquilibriumBlock(opti, near, rotations=turn)
        cost += 0.0 if last is None else ca.sumsqr(turn - last)
        last = turn
        built.append(mapped.cache_info().misses)
    assert built == [built[0]] * 4
    opti.minimize(cost)
    opti.subject_to(block.tip_position[:2] == near.tip_position[:2] + np.array([3e-3, -2e-3]))
    result = block.equilibrium(solved(opti, "exact"))
    np.testing.assert_allclose(result.tip_position[:2] - near.tip_position[:2], [3e-3, -2e-3], atol=1e-8)


def test_failure_of_opti_is_told_in_words() -> None:
    near = forward_kinematics(TWO_TUBE, [0.0, 1.0])
    opti = ca.Opti()
    turn = opti.variable(2)
    block = EquilibriumBlock(opti, near, rotations=turn, name="arm")
    opti.subject_to(block.tip_position[2] == 0.5)
    opti.solver("ipopt", {"print_time": False}, {**QUIET, "max_iter": 3})
    with pytest.raises(RuntimeError, match="Maximum_Iterations"):
        opti.solve()
    text = [str(each) for each in block.violations(opti.debug)]
    assert text
    assert all(word.startswith("arm: ") and "violated by" in word for word in text)


def test_a_program_that_was_not_solved_is_no_equilibrium() -> None:
    near = forward_kinematics(TWO_TUBE, [0.0, 1.0])
    opti = ca.Opti()
    turn = opti.variable(2)
    opti.set_initial(turn, [0.4, 1.0])
    block = EquilibriumBlock(opti, near, rotations=turn)
    opti.solver("ipopt", {"print_time": False}, {**QUIET, "max_iter": 0})
    with pytest.raises(RuntimeError):
        opti.solve()
    with pytest.raises(SolveError, match="the program was not solved"):
        block.equilibrium(opti.debug)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"rotations": [0.0]}, r"rotations is \[0.0\]; it must be 2 finite numbers"),
        ({"tubes": {"curvatur": [1.0, 2.0]}}, "tubes has the key 'curvatur'.*did you mean 'curvature'"),
        ({"rotations": ca.MX.sym("q", 3)}, "rotations has 3 entries; it must have 2, one per tube"),
        ({"side": 2}, "side is 2"),
        ({"refinement": -1}, "refinement is -1"),
        ({"translations": [-0.2, -0.2]}, "the base plate"),
    ],
)
def test_wrong_input_is_named(given: dict[str, Any], message: str) -> None:
    near = forward_kinematics(TWO_TUBE, [0.0, 1.0])
    with pytest.raises(InputError, match=message):
        EquilibriumBlock(ca.Opti(), near, **given)


def test_wrong_demands_are_named() -> None:
    near = forward_kinematics(TWO_TUBE, [0.0, 1.0])
    with pytest.raises(InputError, match=r"casadi.Opti or a tubeopt.Problem"):
        EquilibriumBlock(3, near)
    block = EquilibriumBlock(ca.Opti(), near)
    with pytest.raises(InputError, match="margin is 1; it must be below 1"):
        block.margin_at_least(1.0)
    with pytest.raises(InputError, match=r"fraction is 1.2"):
        block.position(1.2)
    with pytest.raises(InputError, match="tube is 2"):
        block.strain(2)
    with pytest.raises(InputError, match="wrt is 'diameter'"):
        block.jacobian(["diameter"])


def test_a_length_alone_may_be_free() -> None:
    near = forward_kinematics(TWO_TUBE, [0.0, 1.0], [-0.01, -0.03])
    problem = Problem()
    length = problem.variable("curved length", 2, guess=0.1, scale=0.1)
    block = EquilibriumBlock(problem, near, tubes={"curved_length": length})
    problem.subject_to("lengths", length == ca.DM([0.11, 0.105]), scale=0.1)
    result = block.equilibrium(problem.solve())
    assert [tube.curved_length for tube in result.robot.tubes] == pytest.approx([0.11, 0.105])
