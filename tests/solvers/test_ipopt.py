"""IPOPT on the same collocation: the same equilibria, minima only from the energy, failures in words."""

from __future__ import annotations

import re
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from tests.examples import CRL, THESIS, configurations, eccentric_assembly, newton, unstable_home
from tubeopt import InputError, Ipopt, SolveError
from tubeopt.block.transcription import arm as arms
from tubeopt.block.transcription.mesh import make_mesh
from tubeopt.block.transcription.program import structure_of
from tubeopt.block.transcription.reduced import ReducedProblem, reduce, residual
from tubeopt.block.transcription.second_variation import margin
from tubeopt.equilibrium.problem import DEFAULT_DISCRETISATION, reduced_problem
from tubeopt.solvers.ipopt import _program, solve_ipopt
from tubeopt.typing import Array

FORMULATIONS = ("equations", "energy")


def untwisted(problem: ReducedProblem, rotations: Array) -> arms.Profile:
    """Tubes without torsion."""
    return arms.integrate(problem, rotations, np.zeros((len(problem.weight), problem.assembly.n_tubes)))


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_same_equilibrium_as_newton(formulation: str) -> None:
    for robot in (THESIS, CRL):
        for rotations, _ in configurations(robot, 3, seed=21):
            problem = reduced_problem(robot, (0.0, 0.0, 0.0), DEFAULT_DISCRETISATION)
            few = rotations / 3  # within a sixth of a turn of home there is one equilibrium
            solved = newton(problem, few, np.zeros(problem.size)).state
            result = solve_ipopt(problem, few, untwisted(problem, few), formulation)
            assert result.converged
            assert result.state.theta == pytest.approx(solved.theta, abs=1e-9)
            assert residual(problem, result.state) < 1e-9


def test_equations_of_tubes_beside_the_centreline() -> None:
    assembly, rotations = eccentric_assembly(), np.array([0.5, 1.7, -0.4])
    problem = reduce(assembly, make_mesh(assembly))
    solved = newton(problem, rotations, np.zeros(problem.size)).state
    result = solve_ipopt(problem, rotations, untwisted(problem, rotations))
    assert result.state.theta == pytest.approx(solved.theta, abs=1e-9)


def test_energy_has_its_minima_where_the_equations_also_have_saddles() -> None:
    rotations = np.array([np.pi, 0.0, 0.0])
    saddle = unstable_home(THESIS, rotations)
    problem = saddle.member.problem
    # The equations are content with the saddle; the energy, started a little beside it, is not.
    result = solve_ipopt(problem, rotations, untwisted(problem, rotations))
    assert margin(problem, result.state) == pytest.approx(saddle.margin, abs=1e-9)
    beside = untwisted(problem, rotations)
    beside.rotation[:, 0] += 0.1
    result = solve_ipopt(problem, rotations, beside, "energy")
    assert margin(problem, result.state) > 0
    assert result.state.energy < saddle.state.energy


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_started_at_the_solution_there_is_nothing_to_do(formulation: str) -> None:
    # Every value is where the program expects it.
    rotations = np.array([0.3, -0.4, 0.8])
    problem = reduced_problem(THESIS, (0.06, 0.03, 0.0), DEFAULT_DISCRETISATION)
    profile = arms.profile(problem, rotations, newton(problem, rotations, np.zeros(problem.size)).state)
    assert solve_ipopt(problem, rotations, profile, formulation).iterations <= 1


HASTY = Ipopt(tolerance=1e-12, iterations=1, expand=True)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"iterations": "100"}, "iterations is '100'; it must be a whole number"),
        ({"iterations": 0}, "iterations is 0; it must be at least 1"),
        ({"print_level": 2.5}, "print_level is 2.5; it must be a whole number"),
        ({"print_level": 13}, "print_level is 13; it must lie between 0 and 12"),
    ],
)
def test_settings_that_make_no_sense_are_refused(wrong: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        Ipopt(**wrong)


"""IPOPT that gives up after one iteration."""


def test_failure_names_the_verdict_and_the_worst_equations() -> None:
    rotations = np.array([0.0, 1.0, 2.0])
    problem = reduced_problem(THESIS, (0.0, 0.0, 0.0), DEFAULT_DISCRETISATION)
    with pytest.raises(SolveError) as caught:
        solve_ipopt(problem, rotations, untwisted(problem, rotations), settings=HASTY)
    entry = r"(continuity of torsion|torsion equation), tube \d, section \d(, point \d)?: violated by \d\.\de[+-]\d\d"
    pattern = rf"IPOPT found no equilibrium \(maximum iterations exceeded\): {entry}; {entry}; {entry}"
    assert re.fullmatch(pattern, str(caught.value))


def test_unknowns_of_the_energy_are_held_by_named_equations() -> None:
    program = _program(structure_of(reduced_problem(THESIS, (0.06, 0.03, 0.0), DEFAULT_DISCRETISATION)), "energy", 0)
    names = [program.entries(name) for name in ("rotation equation", "continuity of rotation", "base rotation")]
    assert names[0][-1].startswith("rotation equation, tube 3, section 5, point ")
    assert (names[1][0], names[2][0]) == ("continuity of rotation, tube 1, section 2", "base rotation, tube 1")


def test_threads_solve_side_by_side() -> None:
    problem = reduced_problem(THESIS, (0.0, 0.0, 0.0), DEFAULT_DISCRETISATION)
    turns = [np.array([0.0, 0.1, 0.2]) * k for k in range(1, 9)]

    def solved(rotations: Array) -> Array:
        return solve_ipopt(problem, rotations, untwisted(problem, rotations)).state.theta

    with ThreadPoolExecutor(4) as pool:
        for rotations, theta in zip(turns, pool.map(solved, turns), strict=True):
            assert theta == pytest.approx(newton(problem, rotations, np.zeros(problem.size)).state.theta, abs=1e-9)
