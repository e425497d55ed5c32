"""Newton and energy descent: quadratic where close, always downhill, and off a saddle to either side."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from tests.examples import CRL, DEG, THESIS, TWO_TUBE, configurations, descend, nested, newton, unstable_home
from tubeopt import ConcentricRobot, Discretisation
from tubeopt.block.transcription.reduced import Evaluation, ReducedProblem, evaluate, residual
from tubeopt.block.transcription.second_variation import margin
from tubeopt.equilibrium import member as module
from tubeopt.equilibrium.problem import DEFAULT_DISCRETISATION, reduced_problem
from tubeopt.solvers.settings import Newton


def problem_of(robot: ConcentricRobot, translations: Any = None) -> ReducedProblem:
    shift = np.zeros(robot.n_tubes) if translations is None else translations
    return reduced_problem(robot, tuple(float(d) for d in shift), DEFAULT_DISCRETISATION)


@pytest.fixture
def path(monkeypatch: pytest.MonkeyPatch) -> list[Evaluation]:
    """All states that a solver visits."""
    visited: list[Evaluation] = []

    def recorded(*arguments: Any) -> Evaluation:
        visited.append(evaluate(*arguments))
        return visited[-1]

    monkeypatch.setattr(module, "evaluate", recorded)
    return visited


def test_convergence_is_quadratic(path: list[Evaluation]) -> None:
    problem, rotations = problem_of(THESIS), np.array([0.0, 1.0, 2.0])
    result = newton(problem, rotations, np.zeros(problem.size))
    assert result.converged
    assert result.iterations == len(path) - 1 <= 6
    assert residual(problem, result.state) < 1e-13
    errors = [float(np.linalg.norm(state.z - result.state.z)) for state in path]
    constants = [after / before**2 for before, after in pairwise(errors) if after > 1e-12]
    assert len(constants) >= 3
    assert max(constants) < 30
    steps = [float(np.abs(problem.factor @ (b.z - a.z)).max()) for a, b in pairwise(path)]
    ratios = [b / a for a, b in pairwise(steps)]
    # The last step is round-off and tells nothing.
    assert result.contraction == pytest.approx(max(ratios[:-1]), rel=1e-6)


def test_contraction_tells_a_short_way_from_a_long_one() -> None:
    problem = problem_of(THESIS)
    near = newton(problem, np.array([0.05, 0.0, 0.0]), np.zeros(problem.size))
    far = newton(problem, np.array([2.8, 0.0, 0.0]), np.zeros(problem.size))
    assert near.contraction < 1e-3 < far.contraction


def test_what_is_solved_needs_one_step() -> None:
    problem, rotations = problem_of(CRL), np.array([0.3, 1.0, -0.5])
    solved = newton(problem, rotations, np.zeros(problem.size))
    again = newton(problem, rotations, solved.state.z)
    assert (again.converged, again.iterations, again.contraction) == (True, 1, 0.0)


def test_too_few_iterations_are_not_called_converged() -> None:
    problem = problem_of(THESIS)
    result = newton(problem, np.array([0.0, 1.0, 2.0]), np.zeros(problem.size), iterations=2)
    assert (result.converged, result.iterations) == (False, 2)
    assert residual(problem, result.state) > 1e-10
    few = Newton(descent_iterations=2)
    result = descend(problem, np.array([0.0, 1.0, 2.0]), np.zeros(problem.size), settings=few)
    assert (result.converged, result.iterations) == (False, 2)


def test_a_problem_without_unknowns_is_solved_at_once() -> None:
    problem = problem_of(nested((0.05, 0.1, 10.0)))
    assert problem.size == 0
    for solve in (newton, descend):
        result = solve(problem, np.array([0.5]), np.zeros(0))
        assert result.converged
        assert result.state.z.shape == (0,)


def test_no_branch_beyond_the_fold_means_no_convergence() -> None:
    # Next to the snap at 203.9 deg Newton's steps from the branch before it do not settle on that branch any more.
    problem = problem_of(TWO_TUBE)
    z = np.zeros(problem.size)
    for angle in np.linspace(0, 203.8, 60):
        before = newton(problem, np.array([angle * DEG, 0.0]), z)
        assert before.converged
        z = before.state.z
    assert 0 < margin(problem, before.state) < 0.1
    beyond = newton(problem, np.array([204.5 * DEG, 0.0]), z)
    assert not beyond.converged or beyond.contraction > 1


@pytest.mark.parametrize("family", ["gauss", "radau"])
def test_energy_falls_at_every_step(family: str) -> None:
    random = np.random.default_rng(0)
    for robot in (THESIS, CRL):
        for rotations, translations in configurations(robot, 20, seed=7):
            problem = reduced_problem(robot, tuple(translations.tolist()), Discretisation(family))
            z = random.normal(size=problem.size) * 0.05
            end = descend(problem, 2 * rotations, z)
            assert end.converged
            assert margin(problem, end.state) > 0
            energies = [evaluate(problem, 2 * rotations, z).energy]
            energies += [
                descend(problem, 2 * rotations, z, settings=Newton(descent_iterations=k)).state.energy
                for k in range(1, end.iterations)
            ]
            assert (np.diff([*energies, end.state.energy]) <= 1e-12 * energies[0]).all()


def test_newton_stays_on_the_saddle_that_descent_leaves() -> None:
    rotations = np.array([np.pi, 0.0, 0.0])
    saddle = unstable_home(THESIS, rotations)
    problem = saddle.member.problem
    assert saddle.margin < 0
    ends = []
    for start in saddle.member.beside(saddle.state):
        assert np.abs(problem.factor @ (start - saddle.state.z)).max() == pytest.approx(0.05)
        assert evaluate(problem, rotations, start).energy < saddle.state.energy
        end = descend(problem, rotations, start)
        assert end.converged
        assert margin(problem, end.state) > 0
        assert end.state.energy < saddle.state.energy
        ends.append(end.state)
    # The two sides are mirror images: theta -> -theta turns (pi, 0, 0) into (-pi, 0, 0), a turn less.
    assert ends[0].energy == pytest.approx(ends[1].energy, rel=1e-10)
    assert ends[0].z == pytest.approx(-ends[1].z, abs=1e-9)


def test_descent_starts_anywhere_and_ends_in_a_minimum() -> None:
    random = np.random.default_rng(11)
    problem = problem_of(THESIS, (0.06, 0.03, 0.0))
    for _ in range(20):
        rotations = random.uniform(-4, 4, 3)
        theta = rotations[problem.tube] + random.uniform(-6, 6, 3)[problem.tube]
        z = np.linalg.solve(problem.factor, theta - rotations[problem.tube])
        result = descend(problem, rotations, z)
        assert result.converged
        assert residual(problem, result.state) < 1e-12
        assert margin(problem, result.state) > 0
