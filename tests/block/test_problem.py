"""The named program: its optimum is known, its multipliers are slopes, its failures have names."""

from __future__ import annotations

import logging
import pickle
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from tests.examples import TWO_TUBE
from tubeopt import (
    EquilibriumBlock,
    InputError,
    Ipopt,
    Problem,
    ProblemStatus,
    SolveError,
    Sphere,
    forward_kinematics,
    load_problem_solution,
)


def rectangle(area: float = 4e-6) -> Problem:
    """The least circumference 4 sqrt(area) of a rectangle, in m."""
    problem = Problem("rectangle")
    side = problem.variable("side", 2, guess=1e-3, lower=1e-4, scale=1e-3)
    inputs = problem.parameter("area given", area)
    problem.subject_to("area", side[0] * side[1] >= inputs, scale=1e-6)
    problem.minimize(2 * ca.sum1(side))
    return problem


def test_optimum_multiplier_and_change_of_a_parameter() -> None:
    problem = rectangle()
    solution = problem.solve()
    assert solution.status is ProblemStatus.SOLVED
    assert str(solution.status) == "an optimum was found"
    assert solution.objective == pytest.approx(8e-3)
    # d(4 sqrt(A)) / dA = 2 / sqrt(A), in m per m^2.
    assert solution.multiplier("area") == pytest.approx(1e3, rel=1e-4)
    problem.set_value("area given", 9e-6)
    assert problem.solve().value("side") == pytest.approx([3e-3, 3e-3])
    assert solution.value(ca.DM([1, 2])).tolist() == [1, 2]


def test_multiplier_of_a_bound_is_the_slope_of_the_objective() -> None:
    values = []
    for low in (3e-3, 3.001e-3):
        problem = rectangle()
        problem.variables["side"].lower[0] = low
        values.append(problem.solve())
    slope = (values[1].objective - values[0].objective) / 1e-6
    assert values[0].multiplier("side")[0] == pytest.approx(slope, rel=1e-2)
    assert abs(values[0].multiplier("side")[1]) < 1e-4


def test_saved_solution_starts_a_solve_warm(tmp_path: Path) -> None:
    solution = rectangle().solve()
    solution.save(tmp_path)
    loaded = load_problem_solution(tmp_path)
    assert loaded.objective == solution.objective
    assert loaded.statistics == solution.statistics
    for name in ("values", "multipliers", "bound_multipliers", "parameters"):
        for key, value in getattr(solution, name).items():
            np.testing.assert_array_equal(getattr(loaded, name)[key], value)
    again = rectangle().solve(start=loaded)
    assert again.statistics.iterations < solution.statistics.iterations
    assert again.value("side") == pytest.approx(solution.value("side"), rel=1e-6)
    with pytest.raises(InputError, match="values by name only"):
        loaded.value(ca.MX.sym("x"))
    assert pickle.loads(pickle.dumps(solution)).value("side").tolist() == solution.value("side").tolist()
    (tmp_path / "result.json").write_text("{}")
    with pytest.raises(InputError, match="not the solution of a problem"):
        load_problem_solution(tmp_path)


def test_failure_names_the_worst_constraints() -> None:
    near = forward_kinematics(TWO_TUBE, [0.0, 1.0])
    problem = Problem("far away")
    turn = problem.variable("turn", 2, guess=near.rotations, lower=-7.0, upper=7.0)
    block = EquilibriumBlock(problem, near, rotations=turn)
    problem.subject_to("tip height", block.tip_position[2] >= 0.5, scale=0.1)
    with pytest.raises(SolveError, match=r"far away: .*: violated by \d") as caught:
        problem.solve()
    assert caught.value.solution.status is not ProblemStatus.SOLVED
    assert caught.value.solution.violations
    with pytest.raises(SolveError, match="ran out of iterations") as caught:
        problem.solve(Ipopt(iterations=2))
    assert any(each.name.startswith("equilibrium 1: ") for each in caught.value.solution.violations)


def test_a_start_inside_a_body_names_the_clearance() -> None:
    """The solver shares the contradiction among the equations of the arm, which are satisfied at equilibria."""
    near = forward_kinematics(TWO_TUBE, [0.0, 1.0], [-0.01, -0.03])
    problem = Problem("inside")
    turn = problem.variable("turn", 2, guess=near.rotations, lower=-7.0, upper=7.0)
    block = EquilibriumBlock(problem, near, rotations=turn, name="arm")
    middle = near.position[len(near.position) // 2]
    problem.subject_to("clear of the sphere", block.clearance(Sphere(tuple(middle), 0.03)), scale=1.0)
    problem.minimize(ca.sumsqr(turn - near.rotations))
    guesses = {name: each.guess.copy() for name, each in problem.variables.items()}
    with pytest.raises(SolveError, match=r"clear of the sphere, entry \d+: violated by") as caught:
        problem.solve(Ipopt(iterations=60))
    missed = caught.value.solution
    assert missed.violations[0].name.startswith("clear of the sphere")
    # The amount is that of the equilibrium at the joint values of the last point.
    at_end = forward_kinematics(TWO_TUBE, missed.values["turn"], near.translations, time_limit=100.0)
    body = Sphere(tuple(middle), 0.03)
    clearance = body.distance(*at_end.position.T) - TWO_TUBE.tubes[0].outer_diameter / 2
    assert missed.violations[0].amount > 0.5 * -clearance.min() > 0
    for name, guess in guesses.items():
        np.testing.assert_array_equal(problem.variables[name].guess, guess)


def test_a_swap_interrupts_the_solve_and_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    start, goal = [0.0, -0.02], [-0.03, -0.01]
    near = forward_kinematics(TWO_TUBE, [0.0, 1.0], start)

    def composed() -> tuple[Problem, EquilibriumBlock]:
        problem = Problem("swap")
        shift = problem.variable("shift", 2, guess=start, scale=0.1)
        block = EquilibriumBlock(problem, near, translations=shift)
        problem.minimize(1e4 * ca.sumsqr(shift - ca.DM(goal)))
        return problem, block

    alone = composed()[0].solve(reorderings=0)
    attempts = []
    problem, block = composed()
    attempt = problem.attempt
    problem.attempt = lambda *args, **kw: attempts.append(attempt(*args, **kw)) or attempts[-1]  # type: ignore
    with caplog.at_level(logging.WARNING):
        solution = problem.solve()
    np.testing.assert_allclose(block.equilibrium(solution).translations, goal, atol=1e-7)
    of = solution.statistics
    assert attempts[0].statistics.verdict == "User_Requested_Stop"
    assert (of.solves, of.iterations) == (len(attempts), sum(each.statistics.iterations for each in attempts))
    assert of.reorderings >= 1
    # The first swap is made close to the optimum of the order before.
    assert of.gained == pytest.approx(alone.objective - solution.objective, rel=0.05)
    assert [record.message for record in caplog.records] == [
        f"swap: breakpoints changed places, which lowered the objective by {of.gained:.3g} "
        f"({of.solves} solves, {of.iterations} iterations)"
    ]


def test_any_option_of_ipopt_may_be_set() -> None:
    problem = rectangle()
    with pytest.raises(SolveError, match="ran out of iterations"):
        problem.solve(Ipopt(further={"max_iter": 1}))
    assert problem.solve(Ipopt(further={"mu_strategy": "adaptive"})).objective == pytest.approx(8e-3)


def test_equations_of_a_block_are_named() -> None:
    near = forward_kinematics(TWO_TUBE, [0.0, 1.0])
    problem = Problem()
    block = EquilibriumBlock(problem, near, rotations=[0.4, 1.0], name="arm")
    with pytest.raises(SolveError) as caught:
        problem.solve(Ipopt(iterations=1))
    assert "arm: " in str(caught.value)
    entries = problem._constraints["arm: torsion equation"].entries
    assert entries[0] == "arm: torsion equation, tube 1, element 1, point 1"
    assert len(entries) == 2 * block.layout.n_elements * block.model.grid.degree


def test_multistart_keeps_the_best_and_counts() -> None:
    """Two minima, at -1 and 1; the one at 1 is lower."""
    problem = Problem("wells")
    x = problem.variable("x", guess=-1.0, lower=-2.0, upper=2.0)
    problem.minimize((x**2 - 1) ** 2 - 0.1 * x)
    best = problem.multistart(["x"], 8, seed=1)
    assert best.value("x") == pytest.approx(1.0, abs=0.05)
    assert best.attempts is not None
    assert best.attempts.started == 8
    assert best.attempts.solved == 8
    assert str(best.attempts) == "8 starts: 8 optima, 0 failed"
    assert best.attempts.objectives[0] == best.objective < best.attempts.objectives[-1]


def test_multistart_starts_blocks_at_equilibria() -> None:
    near = forward_kinematics(TWO_TUBE, [0.0, 0.0], [-0.01, -0.03])
    goal = forward_kinematics(TWO_TUBE, [-0.7, 1.1], [0.02, -0.02])
    problem = Problem("reach")
    turn = problem.variable("turn", 2, lower=-2.0, upper=2.0)
    shift = problem.variable("shift", 2, guess=near.translations, lower=-0.05, upper=0.04, scale=0.1)
    block = EquilibriumBlock(problem, near, rotations=turn, translations=shift)
    problem.subject_to("tip", block.tip_position == goal.tip_position, scale=0.1)
    problem.minimize(ca.sumsqr(turn))
    solution = problem.multistart(["turn", "shift"], 2, seed=3)
    result = block.equilibrium(solution)
    np.testing.assert_allclose(result.tip_position, goal.tip_position, atol=1e-8)
    assert solution.attempts is not None
    assert solution.attempts.solved >= 1


def test_multistart_without_success_says_so() -> None:
    problem = Problem("nowhere")
    x = problem.variable("x", lower=0.0, upper=1.0)
    problem.subject_to("far", x >= 2.0)
    with pytest.raises(SolveError, match=r"nowhere: 2 starts: 0 optima, 2 failed; nearest: .*far: violated by"):
        problem.multistart(["x"], 2)


def test_wrong_input_is_named() -> None:
    problem = Problem()
    x = problem.variable("x", 2)
    with pytest.raises(InputError, match="'x' is already used"):
        problem.variable("x")
    with pytest.raises(InputError, match="guess of 'y' is"):
        problem.variable("y", 2, guess=[1.0, 2.0, 3.0])
    with pytest.raises(InputError, match="out of order"):
        problem.variable("y", lower=1.0, upper=0.0)
    with pytest.raises(InputError, match="scale of 'y' is"):
        problem.variable("y", scale=0.0)
    with pytest.raises(InputError, match="not an expression"):
        problem.subject_to("nothing", 3.0)
    with pytest.raises(InputError, match="shape"):
        problem.minimize(x)
    problem.minimize(ca.MX.sym("stranger"))
    with pytest.raises(InputError, match="symbols that are not the problem's: stranger"):
        problem.solve()
    with pytest.raises(InputError, match="no variable 'z'"):
        problem.set_guess("z", 1.0)
    with pytest.raises(InputError, match="no finite bounds"):
        problem.multistart(["x"])
    with pytest.raises(InputError, match="tolerance is 0"):
        Ipopt(tolerance=0.0)
    with pytest.raises(InputError, match="hessian is 'none'"):
        Ipopt(hessian="none")


@pytest.mark.parametrize("pull", [0.04, 0.1])
def test_breakpoints_pass_only_where_the_objective_decreases(pull: float) -> None:
    """The energy has a kink where a transition passes the plate: 0.014 N behind it, 0.070 N in front of it."""
    start, step = np.array([0.0, -0.02]), 1e-5
    near = forward_kinematics(TWO_TUBE, [0.0, 1.0], start)
    problem = Problem("pull")
    shift = problem.variable("shift", 2, guess=start, scale=0.1)
    block = EquilibriumBlock(problem, near, translations=shift)
    problem.minimize(block.energy - pull * shift[0] + 2.5 * ca.sumsqr(shift - ca.DM(start)))
    solution = problem.solve()

    def objective(first: float) -> float:
        at = np.array([first, solution.value("shift")[1]])
        energy = forward_kinematics(TWO_TUBE, [0.0, 1.0], at).energy
        return float(energy - pull * first + 2.5 * ((at - start) ** 2).sum())

    first = solution.value("shift")[0]
    around = np.diff([objective(first + x) for x in (-step, 0.0, step)]) / step
    if pull < 0.07:
        assert abs(first) < 1e-8
        assert solution.statistics.solves == 1
        # A minimum in both orders of transition and plate.
        assert around[0] < -0.02
        assert around[1] > 0.02
    else:
        assert first > 3e-3
        assert solution.statistics.reorderings >= 1
        assert np.abs(around).max() < 1e-4
