"""The nonlinear program of inverse kinematics: what it says of an equilibrium, its derivatives, and its answers."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import tubeopt
from tests.examples import CONFIGS, CRL, THESIS, eccentric_robot
from tubeopt import InverseOptions, Ipopt, Problem, ProblemSolution, forward_kinematics
from tubeopt.block.transcription.program import torsion_guess
from tubeopt.bodies.obstacles import Sphere
from tubeopt.inverse import program
from tubeopt.inverse.breakpoint_order import breakpoint_order
from tubeopt.inverse.clock import Clock
from tubeopt.inverse.goal import Goal, pose_question
from tubeopt.inverse.joints import joint_space
from tubeopt.inverse.posture import Posture, posture_of
from tubeopt.inverse.program import posed, solve_program
from tubeopt.robots.robot import Robot

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
            equilibrium = forward_kinematics(robot, rotations, shift)
            if equilibrium.margin > 0.1:
                return posture_of(space, equilibrium)


def question(at: Posture, **options: object) -> Goal:
    direction = options.pop("direction", None)
    obstacles = options.pop("obstacles", ())
    inputs = InverseOptions(**options)  # type: ignore[arg-type]
    reference = (at.equilibrium.rotations, at.equilibrium.translations)
    return pose_question(
        at.space.robot,
        at.tip,
        direction,  # type: ignore[arg-type]
        reference=reference,
        obstacles=obstacles,  # type: ignore[arg-type]
        options=inputs,
    )


EQUATIONS = (
    "torsion equation",
    "continuity of rotation",
    "continuity of torsion",
    "base rotation",
    "torsion at the end",
)


def program_at(goal: Goal, at: Posture) -> tuple[Problem, dict[str, np.ndarray]]:
    """The program of a goal, and its variables at a posture."""
    program = posed(goal, at, breakpoint_order(goal.space, at))
    n = at.space.robot.n_tubes
    start = {"rotations": at.q[:n], "translations": at.q[n:]}
    return program, start | torsion_guess(at.solution.member.problem, at.solution.torsion)


def rows(program: Problem, names: tuple[str, ...], at: dict[str, np.ndarray]) -> np.ndarray:
    """Values of constraints, one below the other."""
    return np.concatenate([program.evaluate(program.constraint(name), at, {}).ravel() for name in names])


def slopes(program: Problem, names: tuple[str, ...], at: dict[str, np.ndarray]) -> np.ndarray:
    """(rows, unknowns) of constraints by central differences."""
    columns = []
    for name, value in at.items():
        for k in range(len(value)):
            step = np.zeros(len(value))
            step[k] = 1e-6
            ahead, behind = (rows(program, names, {**at, name: value + s * step}) for s in (1, -1))
            columns.append((ahead - behind) / 2e-6)
    return np.array(columns).T


@pytest.mark.parametrize("robot", [THESIS, CRL, ETR, SEGMENTED], ids=lambda robot: robot.name or "ETR")
def test_a_solved_equilibrium_satisfies_it(robot: Robot) -> None:
    """The equations hold, and the tip is where forward kinematics, which integrates differently, has it."""
    at = pose(robot)
    goal = question(at, direction=at.direction)
    program, start = program_at(goal, at)
    assert np.abs(rows(program, EQUATIONS, start)).max() < 1e-5
    assert np.abs(rows(program, ("tip position",), start)).max() < 2e-6 * at.space.length
    if goal.pointed:
        assert np.abs(rows(program, ("tip direction",), start)).max() < 1e-5
    assert (rows(program, ("Jacobi fields", "order of breakpoints"), start) > -1e-12).all()


def test_jacobi_fields_tell_the_margin() -> None:
    """The determinant of tubes softened by mu changes its sign where mu is the margin."""
    rotations, shift = np.radians([140.0, 20.0, -30.0]), [-0.02, -0.03, -0.01]
    at = posture_of(joint_space(CRL), forward_kinematics(CRL, rotations, shift))
    assert 0.05 < at.margin < 0.9
    program, start = program_at(question(at, objective="margin"), at)

    def least(mu: float) -> float:
        return float(rows(program, ("Jacobi fields",), {**start, "margin": np.array([mu])}).min())

    low, high = 0.0, 0.95
    assert least(low) > 0 > least(high)
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (middle, high) if least(middle) > 0 else (low, middle)
    assert low == pytest.approx(at.margin, abs=1e-7)


def test_derivatives_are_those_of_finite_differences() -> None:
    """Of every constraint with respect to all unknowns, as IPOPT gets them."""
    at = pose(ETR, 3)
    program, start = program_at(question(at, obstacles=(Sphere((0.03, 0.0, 0.05), 0.01),), direction=at.direction), at)
    names = ("tip position", "tip direction", "Jacobi fields", "clearance of obstacle 1")
    desired = slopes(program, names, start)
    result = program.evaluate(
        ca.horzcat(*(ca.jacobian(ca.vertcat(*map(program.constraint, names)), program.symbol(name)) for name in start)),
        start,
        {},
    )
    scale = 1 + np.abs(desired).max(0)
    np.testing.assert_allclose(result / scale, desired / scale, atol=2e-7)


def test_implicit_derivatives_are_those_along_its_equations() -> None:
    """d(tip)/dq with the torsion eliminated is what `Equilibrium.jacobian` says."""
    at = pose(THESIS, 5)
    program, start = program_at(question(at), at)
    equations, tip = slopes(program, EQUATIONS, start), slopes(program, ("tip position",), start)
    count = len(at.q)
    inner = np.linalg.solve(equations[:, count:], -equations[:, :count])
    total = tip[:, :count] + tip[:, count:] @ inner
    np.testing.assert_allclose(total, at.equilibrium.jacobian().position @ at.space.spread, atol=1e-6)


def test_the_order_of_breakpoints_changes_on_the_way() -> None:
    """A target for which a section must close: the program goes on in the next order, and gets there."""
    space = joint_space(THESIS)
    start = posture_of(space, forward_kinematics(THESIS, [0.2, 0.9, 1.7], [-0.02, -0.03, -0.01]))
    desired = forward_kinematics(THESIS, [0.3, 1.0, 1.6], [0.01, 0.004, 0.012])
    before, after = (THESIS.assembly(e.translations).n_sections for e in (start.equilibrium, desired))
    assert before != after
    reference = (desired.rotations, desired.translations)
    near = InverseOptions(objective="nearest")
    goal = pose_question(THESIS, desired.tip_position, reference=reference, options=near)
    solution = solve_program(goal, start)
    assert solution.reached
    np.testing.assert_allclose(solution.posture.q, space.join(*reference), atol=1e-4)


def test_ipopt_has_the_time_that_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    limits, solve = [], Problem.attempt

    def hurried(self: Problem, solver: Ipopt) -> ProblemSolution:
        limits.append(solver.time_limit)
        return solve(self, replace(solver, time_limit=1e-6))

    monkeypatch.setattr(program, "building", lambda goal: 0.1)
    monkeypatch.setattr(Problem, "attempt", hurried)
    late = replace(question(pose(THESIS)), clock=Clock(100.0))
    assert not solve_program(late, pose(THESIS, 1)).reached
    assert limits[0] == 64.0
