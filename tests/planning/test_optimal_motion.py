"""Optimal motions in a program of the user, against closed forms and independent code."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline, CubicSpline

import tubeopt
from tubeopt import InputError, Motion, Problem, RateLimits, SolveError, Trajectory
from tubeopt.planning.knots import Cubics, KnotFunction

ROBOT = tubeopt.load_robot("two_tube")
START = tubeopt.forward_kinematics(ROBOT, [0.0, 0.0], [-0.02, -0.02])
ACCELERATION = np.pi
FREE = RateLimits(rotation=12.0, rotation_acceleration=ACCELERATION)


def motion_to(program: Problem | ca.Opti, rates: RateLimits = FREE, jerk: float | None = None, **goal: Any) -> Motion:
    """Motion from START to a goal within limits, with 9 knots."""
    motion = Motion(program, ROBOT, 9)
    motion.start(START)
    motion.goal(**goal)
    motion.limit(rates, rotation_jerk=jerk)
    return motion


def fastest(**goal: Any) -> Trajectory:
    """Least time to a goal."""
    problem = Problem()
    motion = motion_to(problem, **goal)
    problem.minimize(motion.duration)
    return motion.solve()


def test_cubics_are_those_of_hermite() -> None:
    rng = np.random.default_rng(1)
    time, q, v = np.array([0.0, 0.2, 0.7, 1.0]), rng.normal(size=(4, 2)), rng.normal(size=(4, 2))
    spline = CubicHermiteSpline(time, q, v)
    h = np.diff(time)[:, None]
    cubics = Cubics(ca.DM(q.T), ca.DM(v.T), ca.DM(np.tile(h.T, (2, 1))))
    early, late = spline(time[:-1], 2), spline(time[1:] - 1e-12, 2)
    assert np.allclose(np.array(cubics.early).T, early)
    assert np.allclose(np.array(cubics.late).T, late, atol=1e-8)
    # A quadratic is the sum of its Bezier coefficients times 1/4, 1/2, 1/4 in the middle.
    middle = spline((time[:-1] + time[1:]) / 2, 1)
    assert np.allclose(np.array(cubics.middle).T, 2 * middle - (v[:-1] + v[1:]) / 2)
    inner = np.array(cubics.inner).T
    assert np.allclose((q[:-1] + 3 * inner[:3] + 3 * inner[3:] + q[1:]) / 8, spline((time[:-1] + time[1:]) / 2))
    assert np.allclose(np.array(cubics.inside(0.3)).T, spline(time[:-1] + 0.3 * h[:, 0]))
    fine = np.linspace(0.0, 1.0, 200_001)
    for order, value in ((1, cubics.length), (2, cubics.effort)):
        assert float(value) == pytest.approx(np.trapezoid((spline(fine, order) ** 2).sum(1), fine), rel=1e-4)


def test_a_switched_function_is_the_same_or_constant() -> None:
    """Values, first and second derivatives of two knots, one on and one off, in a program of both."""
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p", 1)
    one = ca.Function("one", [x, p], [ca.vertcat(x[0] ** 2 * x[1], ca.sin(x[1]) * p)])
    at, numbers = np.array([[0.3, 1.2], [-0.7, 0.4]]), 1.7
    table, weight = ca.MX.sym("table", 2, 2), np.array([0.6, -1.3])

    def parts(values: Any) -> list[Any]:
        column = ca.vec(values)
        cost = ca.dot(ca.DM(weight), column[:2]) + ca.dot(ca.DM(weight), column[2:])
        derivatives = [column, ca.jacobian(column, table), ca.hessian(cost, ca.vec(table))[0]]
        return [np.array(part) for part in ca.Function("parts", [table], derivatives)(at)]

    flags = ca.DM([[1.0, 0.0]])
    switched = parts(KnotFunction.of(one).switched(5.0).at(2)(ca.vertcat(table, flags), numbers))
    plain = parts(ca.horzcat(one(table[:, 0], numbers), ca.DM([5.0, 5.0])))
    for result, expected in zip(switched, plain, strict=True):
        np.testing.assert_allclose(result, expected, atol=1e-14)


@pytest.mark.parametrize("directions", [1, 64])
def test_derivatives_knot_by_knot_are_those_of_casadi(directions: int) -> None:
    x, p = ca.SX.sym("x", 3), ca.SX.sym("p", 2)
    y = ca.vertcat(x[0] * x[1] * p[0] * ca.sin(x[2]), x[0] ** 2 + p[1] * x[2] ** 3, x[1] * x[0] * x[2], ca.exp(x[1]))
    one, count = ca.Function("one", [x, p], [y]), 5
    z, weight = ca.MX.sym("z", 3 * count), ca.MX.sym("weight", 4 * count)
    numbers = ca.DM([2.0, 3.0])
    table = ca.reshape(z, 3, count)
    rng = np.random.default_rng(0)
    at = rng.normal(size=3 * count), rng.normal(size=4 * count)
    before = ca.GlobalOptions.getMaxNumDir()
    ca.GlobalOptions.setMaxNumDir(directions)
    try:
        answers = []
        own = ca.vec(KnotFunction.of(one).at(count)(table, numbers))
        for column in (own, ca.vec(one.map(count)(table, ca.repmat(numbers, 1, count)))):
            # Weights that depend on the unknowns as well.
            bent = ca.hessian(ca.dot(weight, column**2 + ca.sin(column)), z)[0]
            slope, gradient = ca.jacobian(column, z), ca.gradient(ca.dot(weight, column), z)
            function = ca.Function("derivatives", [z, weight], [column, slope, gradient, bent])
            answers.append([np.array(part) for part in function(*at)])
    finally:
        ca.GlobalOptions.setMaxNumDir(before)
    for mine, theirs in zip(*answers, strict=True):
        assert np.abs(mine - theirs).max() < 1e-12 * np.abs(theirs).max()
    # Second derivatives of the first row only.
    part = KnotFunction.of(one, 1).at(count)(table, numbers)
    bent = ca.Function("bent", [z, weight], [ca.hessian(ca.dot(weight, ca.vec(part)), z)[0]])
    first = np.array(at[1]).reshape(count, 4) * [1.0, 0.0, 0.0, 0.0]
    whole = ca.Function("bent", [z, weight], [ca.hessian(ca.dot(weight, own), z)[0]])
    assert np.allclose(np.array(bent(*at)), np.array(whole(at[0], first.ravel())), atol=1e-12)


# With 8 equal intervals the switches of the closed forms are at knots.
CLOSED_FORMS = [
    pytest.param(FREE, None, 2 * np.sqrt(1.0 / ACCELERATION), id="bang-bang"),
    pytest.param(
        RateLimits(rotation=float(np.sqrt(ACCELERATION / 3)), rotation_acceleration=ACCELERATION),
        None,
        4 * np.sqrt(1.0 / (3 * ACCELERATION)),  # d / v + v / a
        id="rate",
    ),
    pytest.param(FREE, 5.0, (32 * 1.0 / 5.0) ** (1 / 3), id="jerk"),
]


@pytest.mark.parametrize(("rates", "jerk", "expected"), CLOSED_FORMS)
def test_least_time_of_a_turn_is_the_closed_form(rates: RateLimits, jerk: float | None, expected: float) -> None:
    problem = Problem()
    motion = motion_to(problem, rates, jerk, rotations=[1.0, 1.0], translations=START.translations)
    problem.minimize(motion.duration)
    trajectory = motion.solve()
    assert trajectory.proved
    assert trajectory.time[-1] == pytest.approx(expected, rel=1e-5)
    assert np.allclose(trajectory.rotations[-1], 1.0, atol=1e-7)


def test_least_effort_in_given_time_is_the_cubic() -> None:
    problem = Problem()
    motion = Motion(problem, ROBOT, 5, duration=2.0)
    motion.start(START)
    motion.goal(rotations=[1.0, 1.0], translations=START.translations)
    problem.minimize(motion.effort)
    solution = problem.solve()
    # From rest to rest over T: 12 d^2 / T^3 for each joint, of two.
    assert solution.value(motion.effort) == pytest.approx(2 * 12 / 2.0**3, rel=1e-6)
    assert solution.value(motion.rotation_rates)[:, 2] == pytest.approx([0.75, 0.75], rel=1e-5)


def test_tip_goal_is_reached_and_verified_by_other_code() -> None:
    goal = tubeopt.forward_kinematics(ROBOT, [0.8, 0.3], [-0.015, -0.015]).tip_position
    trajectory = fastest(tip_position=goal)
    assert np.linalg.norm(trajectory.end.tip_position - goal) < 1e-6
    proof = tubeopt.verify_trajectory(
        ROBOT,
        trajectory.time,
        trajectory.rotations,
        trajectory.translations,
        start=START,
        min_margin=0.05,
        rate_limits=FREE,
    )
    assert proof.holds
    # No joint can be faster than alone, from rest to rest.
    limits = np.array([ACCELERATION, ACCELERATION, 0.04, 0.04])
    change = np.abs(np.concatenate([trajectory.rotations[-1], trajectory.translations[-1] - START.translations]))
    alone = float((2 * np.sqrt(change / limits)).max())
    assert alone <= trajectory.time[-1] * (1 + 1e-6) < 1.2 * alone


def test_opti_and_problem_have_the_same_optimum() -> None:
    durations = []
    for program in (Problem(), ca.Opti()):
        motion = motion_to(program, rotations=[1.0, 0.4], translations=START.translations)
        program.minimize(motion.duration)
        if isinstance(program, ca.Opti):
            program.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
        durations.append(motion.solve().time[-1])
    assert durations[0] == pytest.approx(durations[1], rel=1e-5)


def test_clearance_holds_between_knots_and_costs_time() -> None:
    goal = {"rotations": [1.2, 1.2], "translations": START.translations}
    free = fastest(**goal)
    middle = free.tip_position[len(free.time) // 2]
    body = tubeopt.Sphere(tuple((1.15 * middle).tolist()), 4e-3)
    problem = Problem()
    motion = motion_to(problem, **goal)
    motion.keep_clear(body, 1e-3)
    problem.minimize(motion.duration)
    trajectory = motion.solve()
    assert trajectory.proof.least_clearance >= 1e-3
    assert trajectory.time[-1] >= free.time[-1] * (1 - 1e-5)


def test_a_body_on_the_way_is_passed_within_all_limits() -> None:
    goal = tubeopt.forward_kinematics(ROBOT, [2.5, 2.5], START.translations).tip_position
    middle = tubeopt.forward_kinematics(ROBOT, [1.25, 1.25], START.translations).tip_position
    body, rates = tubeopt.Sphere(tuple(middle.tolist()), 4e-3), RateLimits()
    problem = Problem()
    motion = Motion(problem, ROBOT, 9, min_margin=0.3)
    motion.start(START)
    motion.goal(tip_position=goal)
    motion.limit(rates)
    motion.keep_clear(body, 1e-3)
    problem.minimize(motion.duration)
    trajectory = motion.solve()
    assert np.linalg.norm(trajectory.end.tip_position - goal) < 1e-6
    # The verifier has its own equations, and samples between ours.
    time = np.linspace(0.0, trajectory.time[-1], 400)
    curves = CubicSpline(trajectory.time, np.column_stack([trajectory.rotations, trajectory.translations]))
    proof = tubeopt.verify_trajectory(
        ROBOT,
        trajectory.time,
        trajectory.rotations,
        trajectory.translations,
        start=START,
        obstacles=[body],
        clearance=1e-3,
        min_margin=0.3,
        rate_limits=rates,
    )
    assert proof.holds
    most = [rates.rotation] * 2 + [rates.translation] * 2
    assert (np.abs(curves(time, 1)) <= 1.01 * np.array(most)).all()


def test_optimum_with_a_bend_that_begins_at_the_plate_is_found() -> None:
    """Derivatives of the equilibrium jump there: the solver oscillates, until breakpoints have an order."""
    robot = tubeopt.load_robot("thesis_ctr")
    start = tubeopt.forward_kinematics(robot, [-0.385064, 2.45626461, 1.4491033], [-0.02331215, 0.00368736, 0.04035025])
    problem = Problem()
    motion = Motion(problem, robot, 5, between=0, min_margin=0.3)
    motion.start(start)
    motion.goal(tip_position=[0.05725932, -0.08222106, 0.17279284])
    motion.limit(RateLimits())
    problem.minimize(motion.duration)
    trajectory = motion.solve()
    assert trajectory.proved
    assert abs(trajectory.translations[-1, 1]) < 1e-6


def test_warm_start_ends_at_the_same_optimum() -> None:
    goal = {"rotations": [1.0, 0.4], "translations": START.translations}
    first = fastest(**goal)
    problem = Problem()
    motion = motion_to(problem, **goal)
    problem.minimize(motion.duration)
    assert motion.solve(start=first).time[-1] == pytest.approx(first.time[-1], rel=1e-5)


def test_equilibria_between_knots_change_no_optimum_without_bodies() -> None:
    durations = []
    for between in (0, 1):
        problem = Problem()
        motion = Motion(problem, ROBOT, 5, between=between)
        motion.start(START)
        motion.goal(rotations=[1.0, 1.0], translations=START.translations)
        motion.limit(FREE)
        problem.minimize(motion.duration)
        durations.append(motion.solve().time[-1])
    assert durations[1] == pytest.approx(durations[0], rel=1e-6)


def test_integral_of_one_is_the_duration() -> None:
    problem = Problem()
    motion = Motion(problem, ROBOT, [0.0, 0.3, 1.0], duration=3.0)
    assert problem.evaluate(motion.integral(ca.DM.ones(1, 3)), {}, {}).item() == pytest.approx(3.0)


def test_faults_are_named() -> None:
    motion = Motion(Problem(), ROBOT, 5)
    with pytest.raises(InputError, match="no start"):
        motion.goal(rotations=[0.0, 1.0])
    loaded = tubeopt.forward_kinematics(ROBOT, [0.0, 0.0], [-0.02, -0.02], load=tubeopt.Load((0.0, 0.0, -0.01)))
    with pytest.raises(InputError, match="the start has a load"):
        motion.start(loaded)
    motion.start(START)
    with pytest.raises(InputError, match="the goal is empty"):
        motion.goal()
    with pytest.raises(InputError, match="tip"):
        motion.limit(RateLimits(tip=0.01))
    with pytest.raises(InputError, match="from a body"):
        motion.keep_clear(tubeopt.Sphere(tuple(START.tip_position.tolist()), 2e-3))
    with pytest.raises(InputError, match="must increase from 0 to 1"):
        Motion(Problem(), ROBOT, [0.0, 0.5, 0.4, 1.0])
    with pytest.raises(InputError, match="min_margin is 1"):
        Motion(Problem(), ROBOT, 5, min_margin=1.0)


def test_motion_in_too_short_a_time_is_refused() -> None:
    problem = Problem("short")
    motion = Motion(problem, ROBOT, 5, duration=0.1)
    motion.start(START)
    motion.goal(rotations=[1.0, 1.0], translations=START.translations)
    motion.limit(FREE)
    problem.minimize(motion.effort)
    with pytest.raises(SolveError, match="no point was found"):
        motion.solve()
