"""Plans: safe where the straight way snaps, clear of obstacles, told early where there are none."""

from __future__ import annotations

import json
import time
from functools import partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy

from tests.examples import DEG, THESIS, TWO_TUBE, eccentric_robot
from tubeopt import (
    InputError,
    InverseOptions,
    JointLimits,
    PlanOptions,
    RateLimits,
    SolveError,
    TipGoal,
    Trajectory,
    find_equilibria,
    find_snap,
    follow,
    follow_the_leader,
    follow_tip_path,
    forward_kinematics,
    inverse_kinematics,
    plan_trajectory,
    verify_trajectory,
)
from tubeopt.bodies.corridors import Corridor
from tubeopt.bodies.obstacles import Sphere, nearest_distance
from tubeopt.inverse import search
from tubeopt.inverse.joints import joint_space
from tubeopt.inverse.task import TipCoordinates
from tubeopt.planning import plan, smoothing
from tubeopt.planning.goals import least_miss
from tubeopt.planning.motion import DEFAULT_RATES
from tubeopt.planning.question import PlanTask, plan_task
from tubeopt.planning.timing import Limits, joint_curves, rounded, stopping_at, violated
from tubeopt.planning.trajectory import save_joint_trajectory
from tubeopt.robots.robot import Robot
from tubeopt.typing import Array

OBJECTIVES = ("none", "length", "time")
HOME = ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
TURNED = ([270 * DEG, 0.0, 0.0], [0.0, 0.0, 0.0])


@pytest.fixture
def few_knots(monkeypatch: pytest.MonkeyPatch) -> int:
    """Intervals of a smoothing whose knots are not refined."""
    monkeypatch.setattr(smoothing, "REFINEMENTS", 0)
    return 6


@pytest.fixture(scope="module")
def turn() -> Trajectory:
    return plan_trajectory(THESIS, HOME, TURNED, options=PlanOptions(smoothing_intervals=12))


def test_the_turn_that_snaps_is_planned(turn: Trajectory) -> None:
    assert find_snap(THESIS, HOME, TURNED) is not None
    assert turn.proof.holds
    assert turn.margin.min() >= 0.05
    np.testing.assert_allclose(turn.rotations[[0, -1]], [HOME[0], TURNED[0]], atol=1e-12)
    np.testing.assert_allclose(turn.translations[[0, -1]], 0.0, atol=1e-12)
    # The library's own verifier, which knows snaps, meets none.
    walked = follow(THESIS, turn.rotations, turn.translations)
    assert not walked.snaps
    np.testing.assert_allclose([e.tip_position for e in walked.equilibria], turn.tip_position, atol=1e-8)
    np.testing.assert_allclose([e.margin for e in walked.equilibria], turn.margin, atol=1e-6)


def test_rates_and_accelerations_are_kept(turn: Trajectory) -> None:
    h = np.diff(turn.time)
    np.testing.assert_allclose(h, h[0])
    rates = RateLimits()
    for values, rate, acceleration in (
        (turn.rotations, rates.rotation, rates.rotation_acceleration),
        (turn.translations, rates.translation, rates.translation_acceleration),
    ):
        assert np.abs(np.diff(values, axis=0) / h[0]).max() <= rate * (1 + 1e-6)
        assert np.abs(np.diff(values, 2, axis=0) / h[0] ** 2).max() <= acceleration * (1 + 1e-3)


def test_smoothing_shortens_the_path(turn: Trajectory) -> None:
    assert turn.statistics.smoothed == "length"
    assert turn.statistics.length < 0.9 * turn.statistics.raw_length
    half = max(tube.length for tube in THESIS.tubes) / 2
    ends = np.hstack([turn.rotations, turn.translations / half])[[0, -1]]
    assert turn.quality == pytest.approx(np.linalg.norm(ends[1] - ends[0]) / turn.statistics.length, rel=1e-9)


def test_the_naive_turn_is_refuted_at_the_exact_snap() -> None:
    proof = verify_trajectory(THESIS, [0.0, 1.0], [HOME[0], TURNED[0]])
    assert not proof.holds
    assert proof.snap == pytest.approx(214.222 / 270, abs=0.01)
    assert "snaps" in proof.faults[0]


def test_every_fault_is_told() -> None:
    limits = RateLimits(rotation=0.5)
    proof = verify_trajectory(THESIS, [0.0, 1.0], [HOME[0], [3.5, 0.0, 0.0]], rate_limits=limits, min_margin=0.99)
    assert any("rotation of tube 1 reaches 200.5 deg/s" in fault for fault in proof.faults)
    assert proof.least_margin < 0.99
    assert any(f"the margin falls to {proof.least_margin:.4g}; it must be at least 0.99" in f for f in proof.faults)
    near = Sphere((0.0, -0.06, 0.13), 0.005)
    proof = verify_trajectory(THESIS, [0.0, 1.0], [HOME[0], [0.1, 0.0, 0.0]], obstacles=[near], clearance=0.1)
    assert any("must keep" in fault for fault in proof.faults)
    proof = verify_trajectory(THESIS, [0.0, 1.0], [HOME[0], [0.1, 0.0, 0.0]], [[0.0] * 3, [0.0, -0.1, 0.05]])
    assert any("order" in fault for fault in proof.faults)
    with pytest.raises(InputError, match="increase"):
        verify_trajectory(THESIS, [0.0, 0.0], [HOME[0], [1.0, 0.0, 0.0]])


def test_random_search_alone_finds_a_way() -> None:
    start, goal = ([0.0, 0.0], None), ([300 * DEG, 0.0], None)
    assert find_snap(TWO_TUBE, start, goal) is not None
    options = PlanOptions(method="rrt_connect", objective="none")
    plan = plan_trajectory(TWO_TUBE, start, goal, options=options)
    assert plan.statistics.how == "search"
    assert plan.proof.holds


def test_a_goal_modulo_turns_tells_how_many() -> None:
    plan = plan_trajectory(THESIS, HOME, TURNED, options=PlanOptions(modulo_turns=True, objective="none"))
    assert plan.turns == (-1, 0, 0)
    assert plan.rotations[-1, 0] == pytest.approx(-90 * DEG)
    assert plan.proof.holds


@pytest.mark.parametrize("objective", ["time", "effort", "margin"])
def test_objectives(objective: str, few_knots: int) -> None:
    goal = ([150 * DEG, 30 * DEG, 0.0], [-0.02, -0.02, -0.01])
    options = PlanOptions(objective=objective, smoothing_intervals=few_knots)
    plan = plan_trajectory(THESIS, HOME, goal, options=options)
    assert plan.proof.holds
    assert plan.statistics.knots == 7, "as many as asked for"
    if objective == "time":
        assert plan.time[-1] < 150 / 90 + 1.5


def test_knots_that_are_none_are_refused() -> None:
    with pytest.raises(InputError, match="smoothing_intervals is 0; it must be at least 1"):
        PlanOptions(smoothing_intervals=0)


def test_obstacles_are_kept_clear_of_by_the_surface(few_knots: int) -> None:
    start = forward_kinematics(THESIS, [-90 * DEG, -30 * DEG, 0.0])
    goal = forward_kinematics(THESIS, [110 * DEG, 0.0, 0.0])
    body = Sphere(tuple(forward_kinematics(THESIS, [0.0, 0.0, 0.0]).tip_position.tolist()), 0.02)
    options = PlanOptions(clearance=1e-3, smoothing_intervals=few_knots)
    plan = plan_trajectory(THESIS, start, goal, obstacles=[body], options=options)
    assert plan.proof.holds
    current, smallest = start, np.inf
    for alpha, shift in zip(plan.rotations, plan.translations, strict=True):
        current = forward_kinematics(THESIS, alpha, shift, start=current)
        s = np.linspace(0, current.arc_length[-1], 500)
        line = np.column_stack([np.interp(s, current.arc_length, current.position[:, k]) for k in range(3)])
        radius = np.select([s <= end for end in current.tube_end[::-1]], [7e-4, 6e-4, 5e-4])
        smallest = min(smallest, float((nearest_distance([body], line) - radius).min()))
    assert smallest >= 1e-3 - 5e-6
    assert plan.proof.least_clearance == pytest.approx(smallest, abs=1e-4)


def test_a_vessel_is_stayed_inside_of() -> None:
    inside = forward_kinematics(THESIS, [60 * DEG, 20 * DEG, 0.0], [-0.08, -0.06, -0.04])
    bend = inside.position[:: max(1, len(inside.position) // 10)]
    beyond = inside.tip_position + 0.02 * inside.tip_rotation[:, 2]
    line = np.vstack([[0.0, 0.0, -0.03], bend, beyond])
    vessel = Corridor(tuple(map(tuple, line.tolist())), 0.012)
    outside = ([-60 * DEG, 0.0, 0.0], [-0.17, -0.13, -0.085])
    plan = plan_trajectory(THESIS, outside, inside, obstacles=[vessel], options=PlanOptions(objective="none"))
    assert plan.proof.holds
    assert 0 <= plan.proof.clearance_bound <= plan.proof.least_clearance


def test_no_plan_is_told_before_searching() -> None:
    goal = forward_kinematics(THESIS, [1.0, 0.5, 0.0])
    body = Sphere(tuple(goal.tip_position.tolist()), 0.01)
    with pytest.raises(SolveError, match=r"no plan exists: the arm at the goal is inside an obstacle"):
        plan_trajectory(THESIS, HOME, goal, obstacles=[body])
    weak = forward_kinematics(THESIS, [0.0, np.pi / 2, np.pi])
    with pytest.raises(SolveError, match=r"no plan exists: the goal has margin 0\.9267"):
        plan_trajectory(THESIS, HOME, weak, min_margin=0.95)
    with pytest.raises(InputError, match=r"goal is out of range: rotation of tube 1 is 401"):
        plan_trajectory(THESIS, HOME, ([7.0, 0.0, 0.0], [0.0, 0.0, 0.0]))
    with pytest.raises(InputError, match="tube 1 would end inside tube 2, by 140 mm"):
        plan_trajectory(THESIS, HOME, ([0.0, 0.0, 0.0], [-0.19, 0.0, 0.0]))
    with pytest.raises(InputError, match="min_margin"):
        plan_trajectory(THESIS, HOME, TURNED, min_margin=1.0)


def test_the_time_limit_ends_a_search_with_what_it_found() -> None:
    fixed = JointLimits(((-5.0, 5.0),) * 3, ((0.0, 0.0),) * 3)
    plan_trajectory(THESIS, HOME, ([0.1, 0.0, 0.0], None), options=PlanOptions(objective="none"))
    start_time = time.perf_counter()
    with pytest.raises(SolveError, match="no plan was found within 3 s") as report:
        plan_trajectory(THESIS, HOME, TURNED, limits=fixed, options=PlanOptions(time_limit=3.0))
    assert time.perf_counter() - start_time < 30
    partial = report.value.solution
    assert partial is None or partial.proof.holds


def test_poses_of_the_tip_are_goals() -> None:
    reached = forward_kinematics(THESIS, [1.0, 0.5, 0.0], [-0.02, -0.02, 0.0])
    options = PlanOptions(objective="none")
    plan = plan_trajectory(THESIS, HOME, reached.tip_position, options=options)
    np.testing.assert_allclose(plan.tip_position[-1], reached.tip_position, atol=1e-6)
    pose = TipGoal(reached.tip_position, reached.tip_rotation[:, 2])
    plan = plan_trajectory(THESIS, HOME, pose, options=options)
    np.testing.assert_allclose(plan.end.tip_rotation[:, 2], reached.tip_rotation[:, 2], atol=1e-6)


def test_other_postures_are_tried_where_the_nearest_is_cut_off(monkeypatch: pytest.MonkeyPatch) -> None:
    reached = forward_kinematics(THESIS, [0.07, 2.7, -2.14], [-0.0559, -0.0057, -0.0028])
    tried: list[int] = []

    def nearest_cut_off(*arguments: Any, **options: Any) -> search.PathResult:
        tried.append(len(arguments[2]))
        return search.PathResult(None, "search", 7) if len(tried) == 1 else search.find_path(*arguments, **options)

    monkeypatch.setattr(plan, "find_path", nearest_cut_off)
    monkeypatch.setattr("tubeopt.planning.goals.InverseOptions", partial(InverseOptions, starts=6))
    trajectory = plan_trajectory(THESIS, HOME, reached.tip_position, options=PlanOptions(objective="none"))
    first = inverse_kinematics(THESIS, reached.tip_position, start=forward_kinematics(THESIS, *HOME))
    np.testing.assert_allclose(trajectory.tip_position[-1], reached.tip_position, atol=1e-6)
    assert np.abs(trajectory.rotations[-1] - first.rotations).max() > 0.1
    assert trajectory.proof.holds
    assert trajectory.statistics.motions > 7


def test_eccentric_robots_are_planned_for() -> None:
    robot = eccentric_robot(0.05)
    plan = plan_trajectory(
        robot, ([0.0, 0.0, 0.0], None), ([1.0, 2.0, 0.5], None), options=PlanOptions(objective="none")
    )
    assert plan.proof.holds


def test_the_tip_follows_a_curve() -> None:
    x = np.linspace(0, np.pi, 16)
    circle = np.column_stack([0.01 * np.cos(x), 0.01 * np.sin(x) - 0.03, np.full(16, 0.13)])
    plan = follow_tip_path(THESIS, circle, tolerance=3e-4)
    assert plan.deviation is not None
    assert plan.deviation.max() <= 3e-4
    assert plan.proof.holds
    np.testing.assert_allclose(plan.tip_position[[0, -1]], circle[[0, -1]], atol=1e-6)
    with pytest.raises(SolveError, match="of the curve"):
        follow_tip_path(THESIS, [circle[0], [0.01, -0.03, 0.02]])
    with pytest.raises(InputError, match="at least 2 points"):
        follow_tip_path(THESIS, [[0.0, 0.0, 0.1]])
    with pytest.raises(InputError, match=r"path in row 2 is 1e\+09, 0, 0\.1 m, .*; it must be at most 4 m away"):
        follow_tip_path(THESIS, [[0.0, 0.0, 0.1], [1e9, 0.0, 0.1]])


def test_the_arm_follows_its_leader() -> None:
    goal = forward_kinematics(THESIS, [0.3, 1.0, -0.5], [-0.06, -0.06, -0.04])
    plan = follow_the_leader(THESIS, goal)
    assert plan.proof.holds
    assert plan.deviation is not None
    assert plan.deviation.max() < 2e-3
    assert plan.start.arc_length[-1] == pytest.approx(0.2 * goal.arc_length[-1], rel=1e-6)


def test_a_deployment_with_many_bends_keeps_its_accelerations() -> None:
    plan = follow_the_leader(THESIS, ([0.0, 0.5, 1.0], HOME[1]))
    assert plan.proved
    largest = plan.rate_limits.rotation_acceleration, plan.rate_limits.translation_acceleration
    assert 0.9 < plan.proof.largest_rotation_acceleration / float(np.max(largest[0])) <= 1
    assert 0.9 < plan.proof.largest_translation_acceleration / float(np.max(largest[1])) <= 1


@pytest.mark.parametrize("place", [[0.0, 0.0, 3.0], [0.15, 0.0, 0.1], [0.0, 0.0, -0.1]])
def test_a_place_out_of_reach_is_told_before_inverse_kinematics(
    place: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tubeopt.planning.goals.inverse_kinematics", lambda *_, **__: pytest.fail("was asked"))
    with pytest.raises(
        SolveError, match=r"no plan (exists: the goal is 3|was found: the searches did not reach the goal)"
    ):
        plan_trajectory(THESIS, HOME, place)


@pytest.mark.parametrize("robot", [THESIS, TWO_TUBE, eccentric_robot(0.05)], ids=lambda robot: robot.name or "etr")
def test_tips_that_exist_are_not_refused(robot: Robot) -> None:
    """Also those of joint values at the ends of their ranges, where few starts are near."""
    task = PlanTask(TipCoordinates(joint_space(robot)), (), 0.0, 0.0)
    space, n, random = task.coordinates.space, robot.n_tubes, np.random.default_rng(3)
    for _ in range(12):
        q = np.where(random.random(len(space.lower)) < 0.5, space.lower, space.upper)
        q[:n] = random.uniform(-np.pi, np.pi, n)
        assert least_miss(task, task.coordinates.arms(space.nearest(q)[None], 0.0).tip[0]) == 0.0


def test_an_optimal_search_is_no_longer_than_what_it_begins_with() -> None:
    start, goal = ([0.0, 0.0], None), ([300 * DEG, 0.0], None)
    first = plan_trajectory(TWO_TUBE, start, goal, options=PlanOptions(objective="none"))
    options = PlanOptions(method="optimal", search_seconds=0.3, objective="none")
    plan = plan_trajectory(TWO_TUBE, start, goal, options=options)
    assert plan.proof.holds
    assert plan.statistics.raw_length <= first.statistics.raw_length * (1 + 1e-9)


def test_of_wide_ranges_the_nearest_turns_are_tried() -> None:
    wide = JointLimits(((-100.0, 100.0),) * 3, ((-0.1, 0.0),) * 3)
    start = ([50.0, 50.0, 50.0], None)
    options = PlanOptions(modulo_turns=True, objective="none")
    plan = plan_trajectory(THESIS, start, ([0.2, 0.1, 0.0], None), limits=wide, options=options)
    assert plan.turns == (8, 8, 8)


def test_an_arm_can_be_withdrawn_where_two_tubes_end_together() -> None:
    """Tubes 1 and 2 end at the same place but for round-off on the way."""
    z = np.array([[0.0, 0.0, 0.0, -0.0574900243, -0.00749002431, 0.0168773203]])
    coordinates = TipCoordinates(joint_space(THESIS))
    for gap in (0.0, 1e-17, -1e-17, 3e-17, 1e-16):
        z[0, 4] = z[0, 3] + 0.05 + gap
        assert np.isfinite(coordinates.arms(z, 0.0).tip).all()


def test_a_curve_is_passed_as_fast_as_limits_allow() -> None:
    """On a way with a hairpin: rates and accelerations are kept, and nearly used; it begins and ends at rest."""
    path = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.05], [0.0, 0.05]])
    mark = np.array([0.0, 1.0, 1.05, 2.05])
    even = np.linspace(0, mark[-1], 120)
    rate, largest = np.array([0.5, 0.2]), np.array([1.0, 0.3])
    motion = stopping_at([np.column_stack([np.interp(even, mark, c) for c in path.T])], Limits(rate, largest))
    t = np.linspace(0, motion.duration, 20_001)
    q, speed = motion.curve(t), motion.curve(t, nu=1)
    # At all times, not only where the motion has its knots.
    assert (np.abs(speed) <= rate).all()
    assert (np.abs(motion.curve(t, nu=2)) <= largest).all()
    np.testing.assert_allclose(scipy.integrate.cumulative_trapezoid(speed, t, axis=0), (q - q[0])[1:], atol=1e-7)
    assert np.abs(speed[:, 0]).max() > 0.85 * rate[0]
    np.testing.assert_allclose(q[[0, -1]], path[[0, -1]], atol=1e-12)
    np.testing.assert_allclose(motion.curve([0.0, motion.duration], nu=1), 0.0, atol=1e-12)


def test_curves_of_joint_values_keep_to_motions_that_bend() -> None:
    """Close to a snap the joints turn back while the tips go straight on."""
    task = plan_task(THESIS, [], 0.05, DEFAULT_RATES, None, PlanOptions())
    start = np.zeros(len(task.scale))
    end = start + [6.0, 0.0, -6.0, 0.0, 0.0, 0.0][: len(start)]
    fine = start + np.linspace(0, 1, 4_001)[:, None] * (end - start)
    exact = task.coordinates.joints(fine, task.arms(fine)) / task.scale
    (table,) = joint_curves(task, np.stack([start, end]))
    curve = rounded(table)(np.linspace(0, 1, 400)) / task.scale
    off = scipy.spatial.cKDTree(exact).query(curve)[0]
    assert off.max() < 0.01


def test_a_way_with_corners_is_passed_piece_by_piece() -> None:
    random = np.random.default_rng(0)
    corners = np.cumsum(random.normal(size=(5, 3)), axis=0)
    limits = Limits(random.uniform(0.5, 2, 3), random.uniform(0.5, 2, 3))
    pieces = [
        a + np.linspace(0, 1, count)[:, None] * (b - a)
        for count, a, b in zip((2, 7, 40, 3), corners, corners[1:], strict=False)
    ]
    alone = [stopping_at([piece], limits) for piece in pieces]
    motion = stopping_at(pieces, limits)
    assert motion.duration == pytest.approx(sum(each.duration for each in alone), rel=1e-4)
    # A straight piece at rest at both ends: the joint that needs longest has a trapezoidal profile of speed.
    for piece, each in zip(pieces, alone, strict=True):
        far = np.abs(piece[-1] - piece[0])
        ramp = limits.rate**2 / limits.acceleration
        smallest = np.where(
            far > ramp, far / limits.rate + limits.rate / limits.acceleration, 2 * np.sqrt(far / limits.acceleration)
        )
        assert smallest.max() * (1 - 1e-9) <= each.duration <= smallest.max() * 1.03
    rests = motion.curve(np.cumsum([each.duration for each in alone[:-1]]), nu=1)
    assert np.abs(rests).max() < 0.02


def test_a_motion_to_the_right_joint_values_on_another_branch_is_told() -> None:
    """At 180 deg two stable equilibria mirror each other: the way from 100 deg leads to one of them."""
    task = plan_task(TWO_TUBE, (), 0.05, DEFAULT_RATES, None, PlanOptions(), None)
    space, start = joint_space(TWO_TUBE), forward_kinematics(TWO_TUBE, [100 * DEG, 0.0])
    q = np.linspace(space.join(start.rotations, start.translations), space.join([180 * DEG, 0.0], [0.0, 0.0]), 9)
    motion = stopping_at([q], Limits(*DEFAULT_RATES.of(space)))
    guided = follow(TWO_TUBE, np.column_stack([np.linspace(100, 180, 9) * DEG, np.zeros(9)]), start=start).equilibria[
        -1
    ]
    ends = [each for each in find_equilibria(TWO_TUBE, [180 * DEG, 0.0]) if each.stable]
    assert len(ends) == 2
    for end in ends:
        positions = motion.time[-1:], task.coordinates.of(end)[None]
        same = np.allclose(end.tip_position, guided.tip_position, atol=1e-6)
        assert violated(task, start, motion, task.clock, positions).intervals.any() == (not same)


def test_arguments_of_another_kind_are_named() -> None:
    body: Any = Sphere((0.0, 0.0, 0.1), 0.01)
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"obstacles": body}, r"obstacles is Sphere.*it must be a sequence of bodies"),
        ({"obstacles": [3]}, r"obstacle 1 is 3; it must be a body"),
        ({"rate_limits": {"rotation": 1}}, r"rate_limits is .*; it must be a RateLimits"),
        ({"options": {"seed": 1}}, r"options is .*; it must be a PlanOptions"),
        ({"limits": 3}, r"limits is 3; it must be a JointLimits"),
    ]
    for argument, message in wrong:
        for ask in (plan_trajectory, follow_tip_path):
            positions: tuple[Any, ...] = (HOME, TURNED) if ask is plan_trajectory else ([[0, 0, 0.1], [0, 0, 0.11]],)
            with pytest.raises(InputError, match=message):
                ask(THESIS, *positions, **argument)
    nothing: Any = None
    with pytest.raises(InputError, match="robot is None"):
        plan_trajectory(nothing, HOME, TURNED)
    with pytest.raises(InputError, match="start is 3"):
        verify_trajectory(THESIS, [0.0, 1.0], [HOME[0], TURNED[0]], start=3)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="modulo_turns is 'yes'"):
        PlanOptions(modulo_turns="yes")  # type: ignore[arg-type]


def test_a_plan_is_as_fast_as_its_own_path_can_be_passed(turn: Trajectory) -> None:
    """It stops at no corner, and is neither slower nor longer than the way that it began from."""
    path = plan_trajectory(THESIS, HOME, TURNED, options=PlanOptions(objective="none"))
    assert turn.time[-1] <= path.time[-1] * 1.002
    assert turn.statistics.length <= path.statistics.length * 1.002
    space = joint_space(THESIS)
    q = np.array([space.join(a, d) for a, d in zip(turn.rotations, turn.translations, strict=True)])
    rate, largest = turn.rate_limits.of(space)
    assert turn.time[-1] <= 1.05 * least_time(q / space.scale, rate / space.scale, largest / space.scale)


def test_a_plan_for_time_is_no_slower_than_one_for_length(few_knots: int) -> None:
    goal = ([100 * DEG, -40 * DEG, 20 * DEG], [-0.03, -0.02, -0.01])
    requested = [PlanOptions(objective=name, smoothing_intervals=few_knots) for name in OBJECTIVES]
    times = [plan_trajectory(THESIS, HOME, goal, options=options).time[-1] for options in requested]
    none, length, fast = times
    assert fast <= min(none, length) * (1 + 1e-9)


def least_time(q: Array, rate: Array, most: Array, cells: int = 200) -> float:
    """Seconds at least along a table of joint values (k, m), from rest to rest: a convex program in b = (ds/dt)^2."""
    step = np.linalg.norm(np.diff(q, axis=0), axis=1)
    s = np.append(0.0, np.cumsum(step[step > 1e-7]))
    curve = scipy.interpolate.CubicSpline(s, q[np.append(True, step > 1e-7)])
    x = s[-1] * (1 - np.cos(np.linspace(0, np.pi, cells + 1))) / 2
    h, middle = np.diff(x), (x[1:] + x[:-1]) / 2
    b = ca.MX.sym("b", cells + 1)
    grown, mean = (b[1:] - b[:-1]) / (2 * h), (b[1:] + b[:-1]) / 2
    force = [(curve(middle, 1)[:, i] * grown + curve(middle, 2)[:, i] * mean) / most[i] for i in range(len(most))]
    seconds = ca.sum1(2 * h / (ca.sqrt(b[1:] + 1e-12) + ca.sqrt(b[:-1] + 1e-12)))
    top = 1 / (np.abs(curve(x, 1)) / rate).max(1) ** 2
    top[[0, -1]] = 0.0
    options = {"ipopt.print_level": 0, "print_time": 0, "ipopt.sb": "yes"}
    solver = ca.nlpsol("least", "ipopt", {"x": b, "f": seconds, "g": ca.vertcat(*force)}, options)
    result = solver(x0=np.minimum(top, 0.05) / 2, lbx=0, ubx=top, lbg=-1, ubg=1)
    assert solver.stats()["success"]
    return float(result["f"])


def test_the_speed_of_the_tip_is_limited() -> None:
    limits = RateLimits(tip=0.01)
    plan = plan_trajectory(THESIS, HOME, ([1.0, 0.6, 0.3], None), rate_limits=limits)
    free = plan_trajectory(THESIS, HOME, ([1.0, 0.6, 0.3], None))
    assert plan.proved
    assert 0.009 < plan.proof.largest_tip_rate <= 0.01 * (1 + 1e-3) < free.proof.largest_tip_rate
    again = verify_trajectory(THESIS, free.time, free.rotations, free.translations, rate_limits=limits)
    assert "the tip reaches" in again.faults[0]
    with pytest.raises(InputError, match="tip of the rate limits is -1; it must be greater than 0"):
        RateLimits(tip=-1)


def test_the_speed_of_the_tip_is_limited_on_a_way_with_corners_too() -> None:
    """On each of its parts the arm is where the way before has led it."""
    limits = RateLimits(tip=0.02)
    plan = plan_trajectory(THESIS, HOME, TURNED, rate_limits=limits, options=PlanOptions(objective="none"))
    assert plan.proved
    assert 0.0195 < plan.proof.largest_tip_rate <= 0.02 * (1 + 1e-3)


def test_a_trajectory_is_exported_as_a_message_of_ros(tmp_path: Path) -> None:
    plan = plan_trajectory(THESIS, HOME, ([0.5, 0.2, 0.0], [-0.01, -0.01, 0.0]), options=PlanOptions(objective="none"))
    save_joint_trajectory(plan, tmp_path / "plan.json")
    message = json.loads((tmp_path / "plan.json").read_text())
    assert set(message) == {"header", "joint_names", "points"}
    assert message["joint_names"] == [f"{kind}_{i}" for kind in ("rotation", "translation") for i in (1, 2, 3)]
    points = message["points"]
    time = np.array([p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in points])
    np.testing.assert_allclose(time, plan.time, atol=1e-9)
    table = np.array([p["positions"] for p in points])
    np.testing.assert_array_equal(table, np.hstack([plan.rotations, plan.translations]))
    rates = np.array([p["velocities"] for p in points])
    assert not rates[[0, -1]].any()
    whole = np.trapezoid(rates, time, axis=0)
    np.testing.assert_allclose(whole, table[-1] - table[0], atol=2e-3)
    assert {len(p["accelerations"]) for p in points} == {6}


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-10, 1e-8, 1e-6])
def test_a_motion_smaller_than_round_off_shows_is_planned(size: float) -> None:
    """Over microseconds the round-off of joint values looked like accelerations above their limits."""
    rotations, translations = np.array([0.2, 0.3, 0.1]), np.array([-0.02, -0.01, 0.0])
    goal = rotations + 30 * size, translations - [0.0, 0.0, size]
    plan = plan_trajectory(THESIS, (rotations, translations), goal)
    assert plan.proved
    assert len(plan.proof.samples) < 500
    np.testing.assert_array_equal(plan.rotations[[0, -1]], [rotations, goal[0]])
    np.testing.assert_array_equal(plan.translations[[0, -1]], [translations, goal[1]])


def test_a_tip_goal_where_the_tip_is_already_is_planned() -> None:
    withdrawn = [-tube.curved_length for tube in THESIS.tubes]
    plan = plan_trajectory(THESIS, ([1.0, 2.0, -2.0], withdrawn), (0.0, 0.0, 0.0))
    assert plan.proved
