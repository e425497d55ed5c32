"""Places that are barely clear are planned to; time limits bound everything; what cannot be reached says why."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from tests.command_line import ROOT, Run
from tests.command_line import THESIS as THESIS_FILE
from tests.examples import CRL, DEG, THESIS, TWO_TUBE, nested
from tubeopt import (
    ConcentricRobot,
    Equilibrium,
    InverseOptions,
    JointLimits,
    PlanOptions,
    SolveError,
    Trajectory,
    Tube,
    follow_the_leader,
    forward_kinematics,
    inverse_kinematics,
    load_robot,
    plan_trajectory,
    verify_trajectory,
)
from tubeopt.bodies.corridors import Corridor
from tubeopt.bodies.obstacles import Box, Capsule, HalfSpace, Obstacle, Scene, Sphere
from tubeopt.equilibrium.arm_surface import ArmSurface
from tubeopt.inverse import search
from tubeopt.inverse.clock import Clock
from tubeopt.inverse.joints import joint_space
from tubeopt.inverse.posture import posture_of
from tubeopt.inverse.search import Obstruction, find_obstruction, trapped_region
from tubeopt.inverse.task import Task, TipCoordinates
from tubeopt.planning import plan
from tubeopt.planning.goals import least_miss, path_around, step_constraints
from tubeopt.planning.proof import proved
from tubeopt.planning.question import plan_task
from tubeopt.robots.robot import Robot

PLAIN = PlanOptions(objective="none", clearance=1e-3, time_limit=20.0)
HOME = ([0.0] * 3, [0.0] * 3)


def ends_of_a_way(robot: Robot) -> tuple[Equilibrium, Equilibrium]:
    """Two equilibria that a straight way joins."""
    shift = joint_space(robot).split(joint_space(robot).inside())[1]
    return forward_kinematics(robot, np.zeros(3), shift), forward_kinematics(robot, [1.2, 0.9, 0.4], shift)


def body_at(goal: Equilibrium, start: Equilibrium, kind: str, spare: float) -> Obstacle:
    """A body beyond the tip at the goal, seen from the start, that the arm is clear of by 1 mm and `spare`."""
    tip, ahead = goal.tip_position, goal.tip_rotation[:, 2]
    away = tip - start.tip_position
    away -= away @ ahead * ahead
    away /= np.linalg.norm(away)
    side = np.cross(ahead, away)

    def made(x: float) -> Obstacle:
        at = tip + away * x
        if kind == "sphere":
            return Sphere(tuple(at.tolist()), 4e-3)
        if kind == "half-space":
            return HalfSpace(tuple(at.tolist()), tuple((-away).tolist()))
        if kind == "capsule":
            return Capsule(tuple((at - 0.02 * side).tolist()), tuple((at + 0.02 * side).tolist()), 2e-3)
        low = tip + np.array([-0.01, -0.01, x])
        return Box(tuple(low.tolist()), tuple((low + np.array([0.02, 0.02, 5e-3])).tolist()))

    return made(brentq(lambda x: ArmSurface(goal).clearance(Scene((made(x),))) - 1e-3 - spare, 1e-3, 0.1, xtol=1e-12))


@pytest.mark.parametrize("spare", [3e-4, 1e-4, 5e-5, 1e-5])
@pytest.mark.parametrize(("robot", "kind"), [(THESIS, "sphere"), (THESIS, "box"), (CRL, "capsule")])
def test_places_that_are_barely_clear_are_planned_to(robot: Robot, kind: str, spare: float) -> None:
    start, goal = ends_of_a_way(robot)
    body = body_at(goal, start, kind, spare)
    plan = plan_trajectory(robot, start, goal, obstacles=[body], options=PLAIN)
    assert plan.proved
    assert plan.proof.least_clearance >= 1e-3
    again = plan_trajectory(robot, goal, start, obstacles=[body], options=PLAIN)
    assert again.proved


@pytest.mark.parametrize("spare", [3e-4, 1e-5])
def test_ways_along_a_wall_are_smoothed_as_free_ones(spare: float) -> None:
    """The plate itself is hardly clear of the wall, so that all arms are as close to it, and most of an arm at once."""
    start, goal = ends_of_a_way(THESIS)
    free, tight = (
        plan_trajectory(
            THESIS,
            start,
            goal,
            obstacles=[body_at(goal, start, "half-space", left)],
            options=PlanOptions(clearance=1e-3, smoothing_intervals=12),
        )
        for left in (0.03, spare)
    )
    assert tight.proved
    assert tight.statistics.length < 1.02 * free.statistics.length
    assert tight.time[-1] < 1.02 * free.time[-1]


def test_goals_of_barely_enough_margin_are_planned_to() -> None:
    space, random = joint_space(THESIS), np.random.default_rng(0)
    results = (forward_kinematics(THESIS, *space.split(q)) for q in space.sample(60))
    goal = next(e for e in results if 0.3 < e.margin < 0.8)
    around = (goal.rotations + 0.2 * random.normal(size=3) for _ in range(100))
    near = (forward_kinematics(THESIS, each, goal.translations, start=goal) for each in around)
    start = next(e for e in near if e.margin > goal.margin + 0.02)
    options = PlanOptions(objective="none", time_limit=20.0)
    plan = plan_trajectory(THESIS, start, goal, min_margin=goal.margin - 1e-5, options=options)
    assert plan.proved
    assert plan.margin.min() >= goal.margin - 1.1e-5


def test_a_design_that_touches_its_corridor_is_deployed_into_it() -> None:
    """The robot and a pose of configs/studies/design_corner.yaml, whose optimum leaves 0.018 mm at that pose."""
    text = (ROOT / "configs" / "studies" / "design_corner.yaml").read_text()
    lines = text.split("centreline_mm:\n")[1].split("objective")[0].splitlines()
    centreline = [tuple(float(x) / 1e3 for x in line.strip(" -[]").split(",")) for line in lines if "[" in line]
    vessel = Corridor(tuple((x, y, z) for x, y, z in centreline), 0.012)
    base = load_robot(ROOT / "configs" / "robots" / "example_corner.yaml")
    tubes = tuple(
        type(tube)(
            outer_diameter=tube.outer_diameter,
            inner_diameter=tube.inner_diameter,
            straight_length=straight,
            curved_length=curved,
            curvature=curvature,
            material=tube.material,
        )
        for tube, straight, curved, curvature in zip(
            base.tubes,
            (0.049963544102053, 0.020000000123505803, 0.020000000121258757),
            (0.12388843784831018, 0.11515851863324332, 0.07004725064870838),
            (3.5660919271587144, 18.999999946092807, 4.945621500014814),
            strict=True,
        )
    )
    robot = type(base)(tubes=tubes)
    goal = forward_kinematics(
        robot,
        np.radians([8.204975725556416, -19.205449298513432, 18.904199926066283]),
        np.array([46.8460976408652, 19.99999931598615, 19.999999745138847]) / 1e3,
    )
    start = forward_kinematics(robot, np.zeros(3), [-0.9 * tube.curved_length for tube in tubes])
    clear = ArmSurface(goal).clearance(Scene((vessel,)))
    assert 1e-5 < clear < 5e-5
    options = PlanOptions(objective="none", clearance=clear - 1e-5, time_limit=60.0)
    plan = plan_trajectory(robot, start, goal, obstacles=[vessel], options=options)
    assert plan.proved
    assert plan.proof.least_clearance >= clear - 1e-5


def test_the_arm_between_points_of_the_chart_is_the_arm() -> None:
    """Its clearance, too, is that of forward kinematics, from bodies much smaller than the points are apart."""
    space, random = joint_space(THESIS), np.random.default_rng(1)
    coordinates = TipCoordinates(space)
    for q in space.sample(12):
        e = forward_kinematics(THESIS, *space.split(q))
        arms = coordinates.arms(coordinates.of(e)[None], 0.0)
        s, line = arms.fine()
        posture = posture_of(space, e)
        np.testing.assert_allclose(line[0], posture.surface.at(s[0])[0], atol=2e-6)
        position = line[0, random.integers(20, 120)] + random.normal(size=3) * 5e-3
        body = Sphere(tuple(position.tolist()), 2e-4)
        smallest = posture.surface.clearance(Scene((body,)))
        own = float(Task(coordinates, (body,), 0.0, max(smallest, 0.0)).clearances(arms)[0])
        assert own == pytest.approx(smallest, abs=3e-6 if smallest > 5e-4 else 5e-5)


def test_a_proof_that_is_out_of_time_says_so() -> None:
    t, paths = np.linspace(0, 10, 50), np.linspace(0, 1, 50)[:, None] * [2.0, 1.0, 0.0]
    proof = verify_trajectory(THESIS, t, paths, time_limit=1e-3)
    assert not proof.holds
    assert proof.open
    assert 0 < proof.followed < 1 or proof.followed == 0
    assert "not proved: the time limit was reached" in proof.faults[0]
    assert verify_trajectory(THESIS, t, paths, time_limit=60.0).holds


def unproved(*arguments: Any) -> object:
    """The proof as it is when time is over after its first steps."""
    *inputs, _ = arguments
    return proved(*inputs, Clock(0.0))


def test_what_was_not_proved_in_time_is_returned_as_that(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plan, "proved", unproved)
    trajectory = plan_trajectory(THESIS, HOME, ([0.5, 0.0, 0.0], None), options=PLAIN)
    assert isinstance(trajectory, Trajectory)
    assert not trajectory.proved
    assert trajectory.status.startswith("not proved: the time limit was reached")
    np.testing.assert_allclose(trajectory.rotations[-1], [0.5, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("command", ["plan", "run"])
def test_the_command_ends_with_4_where_the_proof_is_missing(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.setattr(plan, "proved", unproved)
    monkeypatch.setattr("tubeopt.show.plots.trajectory.animate_trajectory", lambda *_: None)
    study = tmp_path / "plan.yaml"
    study.write_text(f"kind: plan\nrobot: {THESIS_FILE}\ngoal_deg: [20, 0, 0]\nobjective: none\n")
    outcome = run(command, str(study), "--out", str(tmp_path / "out"))
    assert outcome.code == 4
    assert "a trajectory was found, but it is not proved" in outcome.err
    assert "not proved" in (tmp_path / "out" / "trajectory.csv").read_text().split("time_s")[0]
    assert '"proved": false' in (tmp_path / "out" / "plan.json").read_text()


def test_time_limits_bound_the_whole_call() -> None:
    """On a goal that cannot be reached and among many bodies, each of which costs the search and the proof."""
    random = np.random.default_rng(0)
    positions = random.normal(size=(60, 3)) * 0.03 + [0.15, 0.15, 0.15]
    bodies = [Sphere(tuple(position.tolist()), 1e-3) for position in positions]
    fixed = JointLimits(((-5.0, 5.0),) * 3, ((0.0, 0.0),) * 3)
    forward_kinematics(THESIS, [0.1, 0.0, 0.0])
    for goal, obstacles, limits in (([2.0, 0.3, 0.3], bodies, None), ([270 * DEG, 0.0, 0.0], [], fixed)):
        start_time = time.perf_counter()
        with suppress(SolveError):
            plan_trajectory(
                THESIS, HOME, (goal, None), obstacles=obstacles, limits=limits, options=PlanOptions(time_limit=3.0)
            )
        assert time.perf_counter() - start_time <= 1.1 * 3.0 + 0.5


def slow_robot(kind: str) -> Robot:
    """One of nine tubes, whose every equilibrium takes milliseconds: beside each other, or in three segments."""
    if kind == "segments":
        return load_robot(ROOT / "configs" / "robots" / "example_three_segment_etr.yaml")
    tubes = (Tube(8e-4 + 5e-4 * k, 6e-4 + 5e-4 * k, 0.35 - 0.03 * k, 0.12 - 0.01 * k, 4.0 + k) for k in range(9))
    return ConcentricRobot(tuple(tubes))


@pytest.mark.parametrize("kind", ["segments", "nine"])
def test_short_time_limits_bound_what_slow_robots_do(kind: str) -> None:
    robot, limit = slow_robot(kind), 0.1
    space = joint_space(robot)
    start, goal = (forward_kinematics(robot, *space.split(q)) for q in space.sample(4)[:2])
    body = Sphere((0.03, 0.03, 0.1), 4e-3)
    plan, ik = PlanOptions(time_limit=limit), InverseOptions(time_limit=limit)
    TipCoordinates(space).arms(TipCoordinates(space).of(start)[None], 0.0)
    for ask in (
        lambda: plan_trajectory(robot, start, goal, options=plan),
        lambda: plan_trajectory(robot, start, (goal.rotations, goal.translations), obstacles=[body], options=plan),
        lambda: plan_trajectory(robot, start, goal.tip_position, options=plan),
        lambda: follow_the_leader(robot, goal, options=plan),
        lambda: inverse_kinematics(robot, goal.tip_position, start=start, obstacles=[body], options=ik),
        lambda: inverse_kinematics(robot, goal.tip_position, all_solutions=True, options=ik),
        lambda: inverse_kinematics(robot, 3 * goal.tip_position, reachable=True, options=ik),
    ):
        start_time = time.process_time()
        with suppress(SolveError):
            ask()
        assert time.process_time() - start_time <= 1.1 * limit + 1.0


def test_bodies_that_are_far_away_cost_smoothing_nothing() -> None:
    random = np.random.default_rng(0)
    positions = random.uniform([-0.1, -0.1, 0.02], [0.1, 0.1, 0.2], (100, 3))
    bodies = [Sphere(tuple(position.tolist()), 2e-3) for position in positions]
    start_time = time.process_time()
    options = PlanOptions(time_limit=60.0)
    start, goal = (forward_kinematics(CRL, a, [0.02991, -0.05159, -0.08409]) for a in (np.zeros(3), [1.2, 0.9, 0.4]))
    plan = plan_trajectory(CRL, start, goal, obstacles=bodies, options=options)
    assert time.process_time() - start_time < 3.0
    assert plan.proved
    assert plan.statistics.length < 1.1 * np.linalg.norm(
        (posture_of(joint_space(CRL), plan.end).q - posture_of(joint_space(CRL), plan.start).q) / joint_space(CRL).scale
    )


def test_a_turn_that_must_snap_is_told_at_once() -> None:
    """Two tubes that cannot slide: on every way one is turned half a turn against the other, which snaps."""
    fixed = JointLimits(((-7.0, 7.0),) * 2, ((0.0, 0.0),) * 2)
    start_time = time.process_time()
    with pytest.raises(SolveError, match=r"no plan exists: every path passes tube 1 turned by .* against tube 2"):
        plan_trajectory(TWO_TUBE, ([0.0, 0.0], None), ([300 * DEG, 0.0], None), limits=fixed)
    assert time.process_time() - start_time < 5


def test_of_several_goals_all_must_be_proved_to_be_out_of_reach(monkeypatch: pytest.MonkeyPatch) -> None:
    likely, sure = Obstruction("most states", False), Obstruction("every state", True)
    z = np.zeros(6)
    for pair, report in (((likely, sure), likely), ((sure, likely), likely), ((sure, sure), sure)):
        reports = iter(pair)
        monkeypatch.setattr(search, "_obstructions", lambda *_, reports=reports: [next(reports)])
        assert (
            find_obstruction(Task(TipCoordinates(joint_space(THESIS)), (), 0.05, 0.0), z, [z, z], Clock(1.0)) is report
        )


def test_no_more_is_said_of_a_goal_than_is_known_of_its_equilibria(monkeypatch: pytest.MonkeyPatch) -> None:
    goal = (np.radians([0.0, 90.0, 180.0]), None)
    with pytest.raises(SolveError, match=r"no plan exists: the goal has margin 0\.9267"):
        plan_trajectory(THESIS, HOME, goal, min_margin=0.95)

    def lost(*_: object) -> list[Equilibrium]:
        raise SolveError("an equilibrium is missing")

    monkeypatch.setattr("tubeopt.planning.goals.find_equilibria", lost)
    with pytest.raises(
        SolveError, match=r"no plan was found, as far as the equilibria at the goal are known: the goal"
    ):
        plan_trajectory(THESIS, HOME, goal, min_margin=0.95)


def test_a_wall_of_states_ends_the_search_before_its_time() -> None:
    fixed = JointLimits(((-7.0, 7.0),) * 3, ((0.0, 0.0),) * 3)
    with pytest.raises(SolveError, match=r"every path passes tube 1 turned by .* states on a grid \(evidence, not"):
        plan_trajectory(THESIS, HOME, ([270 * DEG, 0.0, 0.0], None), limits=fixed, options=PlanOptions(time_limit=6.0))


def test_a_tip_in_an_obstacle_is_told_before_inverse_kinematics(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tubeopt.planning.goals.inverse_kinematics", lambda *_, **__: pytest.fail("was asked"))
    tip = forward_kinematics(THESIS, [1.0, 0.5, 0.0]).tip_position
    body = Sphere(tuple((tip + np.array([0.0, 0.0, 2e-3])).tolist()), 5e-3)
    with pytest.raises(SolveError, match=r"at most -3\.5 mm"):
        plan_trajectory(THESIS, HOME, tip, obstacles=[body])


def test_a_goal_behind_a_wall_that_no_arm_gets_around_is_told_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tubeopt.planning.goals.inverse_kinematics", lambda *_, **__: pytest.fail("was asked"))
    tip = forward_kinematics(THESIS, [1.0, 0.5, 0.0]).tip_position
    slab = Box((-0.5, -0.5, 0.05), (0.5, 0.5, 0.06))
    with pytest.raises(SolveError, match=r"exists: obstacle 1"):
        plan_trajectory(THESIS, ([0.0] * 3, [-0.17, -0.13, -0.085]), tip, obstacles=[slab])
    with pytest.raises(SolveError, match=r"goal is 519\.6 mm"):
        plan_trajectory(THESIS, HOME, [0.3, 0.3, 0.3])


def test_the_way_around_a_box_is_never_longer_than_one_that_is_found() -> None:
    """Beside ways through random points in the plane of its middle, outside of it: right behind it, just as long."""
    random = np.random.default_rng(0)
    for _ in range(40):
        low = np.append(random.uniform(-0.06, -0.01, 2), 0.04)
        high = np.append(random.uniform(0.01, 0.06, 2), 0.05)
        goal = np.append(random.uniform(-0.05, 0.05, 2), random.uniform(0.06, 0.1))
        via = np.column_stack([random.uniform(-0.1, 0.1, (20000, 2)), np.full(20000, 0.045)])
        via = via[((via < low) | (via > high))[:, :2].any(1)]
        result = (np.linalg.norm(via, axis=1) + np.linalg.norm(goal - via, axis=1)).min()
        report = path_around(Box(tuple(low.tolist()), tuple(high.tolist())), goal)
        assert report <= result
        if ((goal > low) & (goal < high))[:2].all():
            assert report == pytest.approx(result, abs=3e-3)
    assert path_around(Box((-0.1, -0.1, 0.2), (0.1, 0.1, 0.3)), np.array([0.0, 0.0, 0.1])) == 0.0


def test_a_closed_pocket_is_told_from_an_open_place() -> None:
    """A joint space that is a tiny box is filled by a few states; that of the robot is not."""
    z = TipCoordinates(joint_space(THESIS)).of(forward_kinematics(THESIS, *HOME))
    tiny = JointLimits(((-0.02, 0.02),) * 3, ((0.0, 0.0),) * 3)
    small = Task(TipCoordinates(joint_space(THESIS, tiny)), (), 0.05, 0.0)
    assert trapped_region(small, z, Clock(60.0)) is not None
    assert trapped_region(Task(TipCoordinates(joint_space(THESIS)), (), 0.05, 0.0), z, Clock(60.0)) is None


@pytest.mark.parametrize("robot", [THESIS, CRL, TWO_TUBE], ids=lambda robot: robot.name)
def test_steps_towards_a_place_are_those_that_end_within_ranges_and_order(robot: Robot) -> None:
    """Against the joint space itself; rotations have no range in tip coordinates."""
    task, random = plan_task(robot, ()), np.random.default_rng(0)
    space, n, longest = task.coordinates.space, robot.n_tubes, 0.3
    observed = set()
    for q in space.sample(8):
        rows, bounds = step_constraints(task, q, longest)
        for step in random.uniform(-1.1 * longest, 1.1 * longest, (60, len(q))) * random.uniform(0.01, 1, (60, 1)):
            reached = q + step * task.scale
            within = (reached[n:] >= space.lower[n:]).all() and (reached[n:] <= space.upper[n:]).all()
            allowed = within and (space.rows @ reached >= space.row_lower).all() and np.abs(step).max() <= longest
            assert (rows @ step >= bounds).all() == allowed
            observed.add(bool(allowed))
    assert observed == {True, False}


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.08), (0.02, 0.0, 0.04), (0.0, -0.03, 0.09), (0.0, 0.0, 0.03)])
def test_a_place_is_missed_by_its_distance_from_the_axis_of_a_straight_tube(place: tuple[float, float, float]) -> None:
    rod = nested((0.05, 0.0, 0.0))
    reached = np.array([0.0, 0.0, np.clip(place[2], 0.0, 0.05)])
    assert least_miss(plan_task(rod, []), np.array(place)) == pytest.approx(np.linalg.norm(place - reached), abs=1e-9)
