"""The nonlinear program of inverse kinematics: what it says of an equilibrium, its derivatives, and its answers."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import tubeopt
from tests.examples import CONFIGS, CRL, THESIS, eccentric_robot
from tubeopt import InverseOptions, forward_kinematics
from tubeopt.bodies.obstacles import Sphere
from tubeopt.control.joints import joint_space
from tubeopt.control.posture import Posture, posture_of
from tubeopt.inverse.goal import Goal
from tubeopt.inverse.order import breakpoint_order
from tubeopt.inverse.program import _parameters, _program, solve_program
from tubeopt.inverse.question import pose_question
from tubeopt.robots.robot import Robot
from tubeopt.solvers.ipopt import start_values

ETR = eccentric_robot(0.03)
SEGMENTED = tubeopt.load_robot(CONFIGS / "example_three_segment_etr.yaml")


def pose(robot: Robot, seed: int = 0) -> Posture:
    """A generic stable posture, breakpoints apart."""
    random = np.random.default_rng(seed)
    space = joint_space(robot)
    while True:
        q = space.inside() + 0.02 * random.normal(size=len(space.lower)) * space.scale
        q[: robot.n_tubes] = random.uniform(-1.2, 1.2, robot.n_tubes)
        if space.admissible(q):
            rotations, shift = space.split(q)
            found = forward_kinematics(robot, rotations, shift)
            if found.margin > 0.1:
                return posture_of(space, found)


def question(at: Posture, **options: object) -> Goal:
    direction = options.pop("direction", None)
    obstacles = options.pop("obstacles", ())
    given = InverseOptions(**options)  # type: ignore[arg-type]
    reference = (at.equilibrium.rotations, at.equilibrium.translations)
    return pose_question(
        at.space.robot,
        at.tip,
        direction,
        (None, reference),
        0.05,
        None,
        None,
        obstacles,
        given,  # type: ignore[arg-type]
    )


def unknowns(goal: Goal, at: Posture, margin: float | None = None) -> tuple[object, np.ndarray, np.ndarray]:
    """The program of a posture, its scaled unknowns there, and its parameters."""
    order = breakpoint_order(goal, at)
    program, asked = _program(goal, at, order)
    block = start_values(asked.structure, at.solution.problem, at.solution.arm, "equations")
    x = np.concatenate([at.q, [] if margin is None else [margin], block]) / program.nlp.scale
    return program, x, _parameters(goal, at, order, asked)


@pytest.mark.parametrize("robot", [THESIS, CRL, ETR, SEGMENTED], ids=lambda robot: robot.name or "ETR")
def test_a_solved_equilibrium_satisfies_it(robot: Robot) -> None:
    """The equations hold, and the tip is where forward kinematics, which integrates differently, has it."""
    at = pose(robot)
    program, x, p = unknowns(question(at), at)
    nlp = program.nlp  # type: ignore[attr-defined]
    g = ca.Function("g", [nlp.x, nlp.p], [nlp.constraints])(x, p)
    g = g.full().ravel()
    equations = nlp.constraint_lower == nlp.constraint_upper
    assert np.abs(g[equations]).max() < 1e-5
    assert (g[~equations] > -1e-12).all()
    tip, direction = (each.full().ravel() for each in program.tip(x, p))  # type: ignore[attr-defined]
    np.testing.assert_allclose(tip, at.tip, atol=2e-6 * at.space.length)
    np.testing.assert_allclose(direction, at.direction, atol=1e-5)


def test_jacobi_fields_tell_the_margin() -> None:
    """The determinant of tubes softened by mu changes its sign where mu is the margin."""
    rotations, shift = np.radians([140.0, 20.0, -30.0]), [-0.02, -0.03, -0.01]
    at = posture_of(joint_space(CRL), forward_kinematics(CRL, rotations, shift))
    assert 0.05 < at.margin < 0.9
    program, x, p = unknowns(question(at, objective="margin"), at, margin=0.0)
    place = len(at.q)

    def least(mu: float) -> float:
        trial = x.copy()
        trial[place] = mu
        return float(program.margin(trial, p).full().min())  # type: ignore[attr-defined]

    low, high = 0.0, 0.95
    assert least(low) > 0 > least(high)
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if least(middle) > 0 else (low, middle)
    assert low == pytest.approx(at.margin, abs=1e-7)


@pytest.mark.parametrize("robot", [CRL, ETR], ids=["CTR", "ETR"])
def test_derivatives_are_those_of_finite_differences(robot: Robot) -> None:
    """Of tip and margin with respect to all unknowns, as IPOPT gets them."""
    at = pose(robot, 3)
    goal = question(at, obstacles=(Sphere((0.03, 0.0, 0.05), 0.01),), direction=at.direction)
    program, x, p = unknowns(goal, at)
    nlp, step = program.nlp, 1e-6  # type: ignore[attr-defined]
    value = ca.Function("g", [nlp.x, nlp.p], [nlp.constraints])
    table = program.jacobian(x, p).full()  # type: ignore[attr-defined]
    named = [k for k, name in enumerate(nlp.constraint_names) if name.startswith(("tip", "margin", "clearance"))]
    assert len(named) >= 8
    for column in range(len(x)):
        ahead, behind = x.copy(), x.copy()
        ahead[column] += step
        behind[column] -= step
        slope = ((value(ahead, p) - value(behind, p)) / (2 * step)).full().ravel()
        scale = 1 + np.abs(slope).max()
        np.testing.assert_allclose(table[:, column], slope, atol=2e-7 * scale)


def test_implicit_derivatives_are_those_along_its_equations() -> None:
    """d(tip)/dq with the block's unknowns eliminated is what `Equilibrium.jacobian` says."""
    at = pose(THESIS, 5)
    program, x, p = unknowns(question(at), at)
    nlp = program.nlp  # type: ignore[attr-defined]
    table = program.jacobian(x, p).full()  # type: ignore[attr-defined]
    count = len(at.q)
    tip = [k for k, name in enumerate(nlp.constraint_names) if name.startswith("tip position")]
    equations = [
        k
        for k, (low, high) in enumerate(zip(nlp.constraint_lower, nlp.constraint_upper, strict=True))
        if low == high and k not in tip
    ]
    inner = np.linalg.solve(table[np.ix_(equations, range(count, len(x)))], -table[np.ix_(equations, range(count))])
    total = table[np.ix_(tip, range(count))] + table[np.ix_(tip, range(count, len(x)))] @ inner
    total *= at.space.length / nlp.scale[:count]
    np.testing.assert_allclose(total, at.equilibrium.jacobian().position @ at.space.spread, atol=1e-6)


def test_the_order_of_breakpoints_changes_on_the_way() -> None:
    """A target for which a section must close: the program goes on in the next order, and gets there."""
    space = joint_space(THESIS)
    start = posture_of(space, forward_kinematics(THESIS, [0.2, 0.9, 1.7], [-0.02, -0.03, -0.001]))
    wanted = forward_kinematics(THESIS, [0.3, 1.0, 1.6], [0.01, 0.004, 0.012])
    before, after = (THESIS.assembly(e.translations).n_sections for e in (start.equilibrium, wanted))
    assert before != after
    reference = (wanted.rotations, wanted.translations)
    goal = pose_question(
        THESIS, wanted.tip_position, None, (None, reference), 0.05, None, None, (), InverseOptions(objective="nearest")
    )
    found = solve_program(goal, start)
    assert found.reached
    np.testing.assert_allclose(found.posture.q, space.join(*reference), atol=1e-4)
