"""The torsion of an arm in a program: the same equilibrium as the condensed equations, square, and named in words."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from tests.examples import CRL, MM, THESIS, eccentric_assembly, nested, newton
from tubeopt import ConcentricRobot, Problem, ProblemSolution, ProblemStatus, forward_kinematics
from tubeopt.block.transcription import arm as arms
from tubeopt.block.transcription.mesh import make_mesh
from tubeopt.block.transcription.model import side_by_side
from tubeopt.block.transcription.program import (
    add_torsion,
    structure_of,
    torsion_guess,
    torsion_numbers,
    violations_of,
    worst,
)
from tubeopt.block.transcription.reduced import ReducedProblem, reduce
from tubeopt.equilibrium.problem import Discretisation, reduced_problem
from tubeopt.solvers.ipopt import EQUILIBRIUM, inside_points
from tubeopt.typing import Array

CASES = [
    (THESIS, (0.0, 1.0, 2.0), (0.0, 0.0, 0.0)),
    (THESIS, (0.3, -0.8, 1.2), (60.0, 30.0, 0.0)),
    (THESIS, (1.0, 0.0, -1.0), (-30.0, 20.0, -40.0)),
    (CRL, (0.5, 1.5, 0.0), (-10.0, -5.0, 5.0)),
    (nested((0.05, 0.1, 12.0)), (0.7,), (20.0,)),
]

EQUATIONS = (
    "torsion equation",
    "continuity of rotation",
    "continuity of torsion",
    "base rotation",
    "torsion at the end",
)


def posed(problem: ReducedProblem, rotations: Array) -> Problem:
    """The program of one equilibrium, with its numbers; its unknowns start at tubes without torsion."""
    program, pieces = Problem(), len(problem.mesh.length)
    add_torsion(program, structure_of(problem), program.parameter("rotations", rotations), {})
    for name, value in torsion_numbers(problem).items():
        program.set_value(name, value)
    program.set_guess("rotation", np.tile(rotations, pieces))
    program.set_guess("rotation inside", np.tile(rotations, pieces * problem.mesh.tableau.degree))
    return program


def solved(problem: ReducedProblem, rotations: Array) -> ProblemSolution:
    result = posed(problem, rotations).attempt(EQUILIBRIUM)
    assert result.status is ProblemStatus.SOLVED
    assert result.statistics.unknowns == result.statistics.constraints
    return result


@pytest.mark.parametrize(("robot", "rotations", "shift"), CASES)
def test_its_equations_have_the_equilibrium_of_forward_kinematics(
    robot: ConcentricRobot, rotations: tuple[float, ...], shift: tuple[float, ...]
) -> None:
    translations = np.array(shift) * MM
    problem = reduced_problem(robot, tuple(translations), Discretisation())
    result, pose = solved(problem, np.array(rotations)), forward_kinematics(robot, rotations, translations)
    # At the points the condensed equations know the rotations of the curved tubes, which are their unknowns.
    chosen = problem.point, problem.tube
    points = inside_points(problem, result.values["rotation inside"])
    assert points[chosen] == pytest.approx(pose.point_rotation[chosen], abs=1e-10)
    at = [int(np.argmin(np.abs(pose.arc_length - s))) for s in problem.mesh.start]
    begins, twists = (result.values[name].reshape(-1, robot.n_tubes) for name in ("rotation", "torsion"))
    assert begins == pytest.approx(pose.rotation[:, at].T, abs=1e-10)
    assert twists == pytest.approx(pose.torsion[:, at].T, abs=1e-8)


def test_its_equations_of_tubes_beside_the_centreline_are_those_condensed() -> None:
    problem = reduce(eccentric_assembly(), make_mesh(eccentric_assembly()))
    rotations = np.radians([0.0, 60.0, -60.0])
    points = inside_points(problem, solved(problem, rotations).values["rotation inside"])
    assert points == pytest.approx(newton(problem, rotations, np.zeros(problem.size)).state.theta, abs=1e-10)


def test_an_arm_is_given_the_numbers_of_its_sections() -> None:
    problem = reduced_problem(THESIS, (0.06, 0.03, 0.0), Discretisation())
    numbers, assembly, pieces = torsion_numbers(problem), problem.assembly, len(problem.mesh.length)
    assert numbers["transmission"].tolist() == assembly.transmission.tolist()
    assert numbers["lengths"].tolist() == problem.mesh.length.tolist()
    stiffness, moment, kt = (
        numbers[name].reshape(pieces, -1) for name in ("stiffness", "moment", "torsional_stiffness")
    )
    for k, section in enumerate(problem.mesh.section):
        present, curved = assembly.present[section], assembly.curved[section]
        assert stiffness[k].tolist() == (assembly.bending_stiffness * present).tolist()
        assert moment[k].tolist() == (assembly.bending_stiffness * assembly.curvature * curved).tolist()
        assert kt[k].tolist() == assembly.torsional_stiffness.tolist()


def test_violated_equations_are_reported_in_words() -> None:
    rotations = np.array([0.0, 1.0, 2.0])
    problem = reduced_problem(THESIS, (0.0, 0.0, 0.0), Discretisation())
    program = posed(problem, rotations)
    start = torsion_guess(
        problem, arms.profile(problem, rotations, newton(problem, rotations, np.zeros(problem.size)).state)
    )
    # Not round-off: the profile is the polynomial through the moments, integrated twice, not the points themselves.
    assert max(np.abs(program.evaluate(program.constraint(name), start, {})).max() for name in EQUATIONS) < 1e-8
    first = int(np.flatnonzero(problem.mesh.section == 1)[0])
    inside = start["rotation inside"].reshape(-1, problem.mesh.tableau.degree, 3)
    inside[first, 3, 1] += 3e-3
    names = program.entries("torsion equation")
    values = program.evaluate(program.constraint("torsion equation"), start, {}).ravel()
    zero = np.zeros(len(names))
    (result,) = worst(violations_of(names, values, (zero, zero), np.ones(len(names)), 1e-8), 1)
    assert result.name == "torsion equation, tube 2, section 2, point 4"
    assert result.amount == pytest.approx(3e-3, rel=1e-2)


def test_names_of_the_equations_are_words() -> None:
    program = posed(reduced_problem(THESIS, (0.06, 0.03, 0.0), Discretisation()), np.zeros(3))
    names = [word for name in EQUATIONS for word in program.entries(name)]
    assert len(set(names)) == len(names)
    assert names[-1] == "torsion at the end, tube 3"
    desired = {"torsion equation, tube 2, section 3, point 4", "continuity of torsion, tube 3, section 2"}
    assert {"base rotation, tube 1", *desired} <= set(names)


def test_elements_side_by_side_have_the_derivatives_of_all_at_once() -> None:
    """Values, Jacobian and Hessian of a mapped element with its own Jacobian equal those that CasADi derives."""
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y", 1, 2)
    one = ca.Function("one", [x, y], [ca.sin(x) * y.T, x[0] * y[1] ** 2, ca.SX(1, 1)])
    at = ca.MX.sym("at", 4, 3)
    arguments = at[:2, :], ca.reshape(at[2:, :] ** 2, 1, 6)
    weights = np.random.default_rng(0).normal(size=12)
    numbers = np.random.default_rng(1).normal(size=(4, 3))
    results = []
    for mapped in (one.map(3), side_by_side(one, 3)):
        values = ca.veccat(*mapped(*arguments))
        hessian = ca.hessian(ca.dot(ca.DM(weights), values), ca.vec(at))[0]
        results.append(ca.Function("all", [at], [values, ca.jacobian(values, ca.vec(at)), hessian])(numbers))
    for theirs, ours in zip(*results, strict=True):
        assert np.array(theirs).any()
        np.testing.assert_allclose(np.array(ours), np.array(theirs), rtol=0, atol=1e-14)
