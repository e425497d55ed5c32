"""The equilibrium block: the same equilibrium as the condensed equations, square, and named in words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np
import pytest
from tubeopt.transcription.block import add_energy, add_equilibrium, parameter_values, parameters, structure_of
from tubeopt.transcription.nlp import Builder, Nlp

from tests.examples import CRL, MM, THESIS, eccentric_assembly, nested
from tubeopt import ConcentricRobot, forward_kinematics
from tubeopt.equilibrium.solving import Discretisation, reduced_problem
from tubeopt.solvers.ipopt import start_values
from tubeopt.solvers.newton import newton
from tubeopt.transcription import arm as arms
from tubeopt.transcription.mesh import make_mesh
from tubeopt.transcription.reduced import ReducedProblem, reduce
from tubeopt.typing import Array

CASES = [
    (THESIS, (0.0, 1.0, 2.0), (0.0, 0.0, 0.0)),
    (THESIS, (0.3, -0.8, 1.2), (60.0, 30.0, 0.0)),
    (THESIS, (1.0, 0.0, -1.0), (-30.0, 20.0, -40.0)),
    (CRL, (0.5, 1.5, 0.0), (-10.0, -5.0, 5.0)),
    (nested((0.05, 0.1, 12.0)), (0.7,), (20.0,)),
]


def block(problem: ReducedProblem) -> tuple[Nlp, ca.Function]:
    """The program of one equilibrium, and theta at the points, theta and w where pieces begin, from its unknowns."""
    builder = Builder()
    structure = structure_of(problem)
    unknown = add_equilibrium(builder, structure, parameters(builder, structure))
    nlp = builder.build()
    begins = [ca.horzcat(*(getattr(part.piece, name) for part in unknown.torsion)) for name in ("theta", "twist")]
    return nlp, ca.Function("read", [nlp.x, nlp.p], [unknown.rotation, *begins])


def untwisted(nlp: Nlp, rotations: Sequence[float] | Array) -> Array:
    """The unknowns of tubes without torsion, theta = alpha everywhere, told by their names."""
    tubes = [int(name.split("tube ")[1].split(",")[0]) - 1 for name in nlp.names]
    turned = [name.startswith("rotation") for name in nlp.names]
    return np.where(turned, np.asarray(rotations)[tubes], 0.0)


@pytest.mark.parametrize(("robot", "rotations", "shift"), CASES)
def test_rootfinder_of_the_block_agrees_with_forward_kinematics(
    robot: ConcentricRobot, rotations: tuple[float, ...], shift: tuple[float, ...]
) -> None:
    translations = np.array(shift) * MM
    problem = reduced_problem(robot, tuple(translations), Discretisation())
    nlp, read = block(problem)
    assert nlp.square
    p = parameter_values(problem, rotations)
    assert p.shape == (nlp.p.numel(),)
    x = nlp.rootfinder()(untwisted(nlp, rotations) / nlp.scale, p)
    points, begins, twists = (out.full().T for out in read(x, p))
    solved = forward_kinematics(robot, rotations, translations)
    # At the points the condensed equations know the rotations of the curved tubes, which are their unknowns.
    chosen = problem.point, problem.tube
    assert points.reshape(-1, robot.n_tubes)[chosen] == pytest.approx(solved.point_rotation[chosen], abs=1e-10)
    at = [int(np.argmin(np.abs(solved.arc_length - s))) for s in problem.mesh.start]
    assert begins == pytest.approx(solved.rotation[:, at].T, abs=1e-10)
    assert twists == pytest.approx(solved.torsion[:, at].T, abs=1e-8)


def test_parameters_are_read_in_the_order_in_which_they_are_given() -> None:
    problem = reduced_problem(THESIS, (0.06, 0.03, 0.0), Discretisation())
    builder = Builder()
    given = parameters(builder, structure_of(problem))
    names = ("rotations", "transmission", "torsional_stiffness", "length", "stiffness", "moment")
    nlp = builder.build()
    values = ca.Function("given", [nlp.p], [getattr(given, name) for name in names])
    read = [out.full() for out in values(parameter_values(problem, (0.1, 0.2, 0.3)))]
    assembly = problem.assembly
    assert read[0].ravel().tolist() == [0.1, 0.2, 0.3]
    assert read[1].ravel().tolist() == assembly.transmission.tolist()
    assert read[2].ravel().tolist() == assembly.torsional_stiffness.tolist()
    assert read[3].ravel().tolist() == problem.mesh.length.tolist()
    for k, section in enumerate(problem.mesh.section):
        present, curved = assembly.present[section], assembly.curved[section]
        assert read[4][:, k].tolist() == (assembly.bending_stiffness * present).tolist()
        assert read[5][:, k].tolist() == (assembly.bending_stiffness * assembly.curvature * curved).tolist()


def test_parameters_of_tubes_beside_the_centreline() -> None:
    problem = reduce(eccentric_assembly(), make_mesh(eccentric_assembly()))
    builder = Builder()
    given = parameters(builder, structure_of(problem))
    nlp = builder.build()
    values = ca.Function("given", [nlp.p], [given.offset, given.offset_angle])
    offset, angle = (out.full().ravel() for out in values(parameter_values(problem, (0.0, 0.0, 0.0))))
    assert offset.tolist() == problem.assembly.offset.tolist()
    assert angle.tolist() == problem.assembly.offset_angle.tolist()


def test_rootfinder_of_the_eccentric_block_agrees_with_the_condensed_equations() -> None:
    problem = reduce(eccentric_assembly(), make_mesh(eccentric_assembly()))
    rotations = np.radians([0.0, 60.0, -60.0])
    nlp, read = block(problem)
    p = parameter_values(problem, rotations)
    points = read(nlp.rootfinder()(untwisted(nlp, rotations) / nlp.scale, p), p)[0].full().T
    assert points == pytest.approx(newton(problem, rotations, np.zeros(problem.size)).state.theta, abs=1e-10)


@pytest.mark.parametrize("add", [add_equilibrium, add_energy])
def test_every_unknown_and_equation_is_named_once(add: Callable[..., Any]) -> None:
    problem = reduced_problem(THESIS, (0.06, 0.03, 0.0), Discretisation("gauss", 2))
    builder = Builder()
    add(builder, structure_of(problem), parameters(builder, structure_of(problem)))
    nlp = builder.build()
    assert len(set(nlp.names)) == len(nlp.names) == nlp.x.numel()
    assert len(set(nlp.constraint_names)) == len(nlp.constraint_names) == nlp.constraints.numel()
    # Only sections 2 to 4 of the five have two curved tubes, whose torsion needs points.
    collocated = {
        name.split("section ")[1][0]
        for name in nlp.constraint_names
        if name.startswith(("torsion equation", "rotation equation"))
    }
    assert collocated == {"2", "3", "4"}


def test_names_of_the_equations_are_words() -> None:
    names = block(reduced_problem(THESIS, (0.06, 0.03, 0.0), Discretisation()))[0].constraint_names
    assert names[0] == "base rotation, tube 1"
    assert names[-1] == "torsion at the end, tube 3"
    assert {"torsion equation, tube 2, section 3, point 4", "continuity of torsion, tube 3, section 2"} <= set(names)


def test_violated_equations_are_reported_in_words() -> None:
    rotations = np.array([0.0, 1.0, 2.0])
    problem = reduced_problem(THESIS, (0.0, 0.0, 0.0), Discretisation())
    nlp, _ = block(problem)
    g = ca.Function("g", [nlp.x, nlp.p], [nlp.constraints])
    p = parameter_values(problem, rotations)
    solved = arms.profile(problem, rotations, newton(problem, rotations, np.zeros(problem.size)).state)
    x = start_values(structure_of(problem), problem, solved, "equations")
    # Not round-off: the profile is the polynomial through the moments, integrated twice, not the points themselves.
    assert np.abs(g(x, p).full()).max() < 1e-8
    x[nlp.names.index("rotation, tube 2, section 2, point 4")] += 3e-3
    name, size = nlp.worst(g(x, p).full().ravel())[0]
    assert name == "torsion equation, tube 2, section 2, point 4"
    assert size == pytest.approx(3e-3, rel=1e-2)
