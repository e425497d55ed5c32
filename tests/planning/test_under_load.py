"""Motions of a robot that bears a load: what is said of them holds for arms that were solved for in between."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.command_line import THESIS as FILE
from tests.command_line import Run, answer, refused
from tests.examples import DEG, PIECES, THESIS, TWO_TUBE, nested
from tubeopt import (
    ConcentricRobot,
    InputError,
    Load,
    PlanOptions,
    SolveError,
    Tube,
    find_snap,
    follow,
    forward_kinematics,
    plan_trajectory,
    verify_trajectory,
)
from tubeopt.bodies.obstacles import Sphere, scene_of
from tubeopt.equilibrium.arm_surface import ArmSurface
from tubeopt.equilibrium.result import Equilibrium
from tubeopt.planning.loaded_branch import CHORD_ERROR, _Bounds, _Displacement, loaded_branch
from tubeopt.planning.loaded_sections import DeadLoad, LoadedArms, LoadedIntervals
from tubeopt.planning.sections import PARTS, SHAPE_ERROR, Constants
from tubeopt.robots.robot import Robot
from tubeopt.typing import Array

HOME = THESIS.home_translations
SIDEWAYS = Load(force=(0.02, 0, 0))
EVERYTHING = Load(force=(0.01, -0.02, 0.005), gravity=(0, 3.0, -9.81), distributed=(0.02, 0.0, -0.03))


def intervals_of(chain: list[Equilibrium], load: Load) -> tuple[LoadedIntervals, Array]:
    robot = chain[0].robot
    arms = LoadedArms.of(Constants.of(robot), chain, load=DeadLoad.of(robot, load))
    one = np.arange(len(chain) - 1)
    return LoadedIntervals.of(arms, one, one + 1), np.array([min(e.margin, 1.0) for e in chain])


@pytest.mark.parametrize("robot", [THESIS, TWO_TUBE, PIECES], ids=lambda r: r.name)
def test_arms_between_two_loaded_equilibria_are_where_the_bound_says(robot: Robot) -> None:
    """And there are such: the branch is shown to be one over steps that are not tiny."""
    n = robot.n_tubes
    load = {id(THESIS): EVERYTHING, id(TWO_TUBE): SIDEWAYS, id(PIECES): Load(force=(1e-3, 0, 0))}[id(robot)]
    start = np.concatenate([np.linspace(0.4, -0.8, n), robot.home_translations - 0.01])
    end = start + 0.1 * np.concatenate([np.linspace(0.7, -0.4, n), 0.05 * np.linspace(1.0, -0.5, n)])
    count = 16
    chain = [forward_kinematics(robot, start[:n], start[n:], load=load)]
    for x in np.arange(1, 2 * count + 1) / (2 * count):
        joints = start + x * (end - start)
        chain.append(forward_kinematics(robot, joints[:n], joints[n:], load=load, start=chain[-1]))
    intervals, margins = intervals_of(chain[::2], load)
    result = loaded_branch(intervals, margins)
    assert result.unbroken.all()
    inside = LoadedArms.of(intervals.arms.constants, chain[1::2], load=intervals.arms.load)
    for k in range(count):
        for section in np.flatnonzero(intervals.length[0][k] > 0):
            x = np.linspace(0, 1, 9)
            at = np.full(len(x), k)
            ends = intervals.positions(at, np.full(len(x), section), x)
            cuts = (intervals.start_cuts[k] + intervals.end_cuts[k]) / 2
            points = inside.points(at, cuts[section] + x * (cuts[section + 1] - cuts[section]))
            off = np.linalg.norm(points - (ends[0] + ends[1]) / 2, axis=1).max()
            assert off <= result.chord_error[k, section] + 3 * inside.shape_error.max()


@pytest.mark.parametrize("load", [SIDEWAYS, EVERYTHING], ids=["force", "everything"])
def test_margins_between_two_loaded_equilibria_are_no_less_than_shown(load: Load) -> None:
    """And what they may lose falls by four where a step is half as long, while nothing varies along the tubes."""
    start, step = np.append([0.9, 0.3, 0.1], np.array(HOME) - 0.03), np.append([0.06, -0.02, 0.01], [1e-3, 2e-3, 2e-3])
    lost = []
    for part in (1.0, 0.5):
        chain = [forward_kinematics(THESIS, *np.split(start, 2), load=load)]
        for x in np.linspace(0, part, 9)[1:]:
            chain.append(forward_kinematics(THESIS, *np.split(start + x * step, 2), load=load, start=chain[-1]))
        intervals, margins = intervals_of([chain[0], chain[-1]], load)
        bounds = _Bounds(intervals)
        ball = bounds.ball(margins[:1])
        convex, retained = ball.convexity, ball.exists
        assert retained.all()
        assert min(e.margin for e in chain) >= convex[0] >= margins.min() - 0.2
        lost.append(bounds.hessian_chord_error()[0])
    assert lost[0] / lost[1] == pytest.approx(4, rel=0.25)


def test_the_second_variation_of_two_tubes_curves_with_the_square_of_their_angle() -> None:
    """V = c int cos(D) y^2 and T = int y'^2 / sigma: int y^2 is at most (2 L / pi)^2 sigma T; the bound has L^2."""
    robot = nested((0.0, 0.1, 2.0), (0.0, 0.1, 2.0))
    inner, outer = robot.tubes
    stiffness, sigma = inner.bending_stiffness, 1 / inner.torsional_stiffness + 1 / outer.torsional_stiffness
    other = outer.bending_stiffness
    coupling = stiffness * other / (stiffness + other) * 2.0**2
    turn = 0.2
    chain = [forward_kinematics(robot, [angle, 0.0], load=Load()) for angle in (-turn / 2, turn / 2)]
    bounds = _Bounds(intervals_of(chain, Load())[0])
    true = coupling * sigma * (2 * 0.1 / np.pi) ** 2 * turn**2
    assert 0.97 * true <= bounds.hessian_chord_error()[0] / CHORD_ERROR <= 1.05 * np.pi**2 / 4 * true


@pytest.mark.parametrize("share", [1e-3, 0.3])
def test_the_second_variation_of_a_pressed_rod_curves_as_its_closed_form(share: float) -> None:
    """Under a share of the force that buckles it. With psi = int h m / K, V = -F int h |psi|^2 grows with h^3, and
    int |int m|^2 is at most (2 / pi)^2 int |m|^2."""
    tube = Tube(1e-3, 0.8e-3, 0.0, 0.1, 0.0)
    robot, stiffness = ConcentricRobot((tube,)), float(tube.bending_stiffness)
    short, long = 0.08, 0.09
    press = share * np.pi**2 * stiffness / (4 * long**2)
    load = Load(force=(0.0, 0.0, -press))
    chain = [forward_kinematics(robot, [0.0], [length - 0.1], load=load) for length in (short, long)]
    intervals, margins = intervals_of(chain, load)
    assert margins[1] == pytest.approx(1 - share, abs=1e-6)
    bounds = _Bounds(intervals)
    true = press * (long - short) ** 2 * 4 / np.pi**2 / stiffness
    assert 0.999 * true <= bounds.hessian_chord_error()[0]
    # Of small forces it does not count that the frame might turn.
    assert share > 0.1 or bounds.hessian_chord_error()[0] <= 4.2 * true
    assert bounds.ball(margins[1:]).convexity[0] <= 1 - share


@pytest.mark.parametrize(("turned", "moved"), [(0.05, 0.0), (0.05, 2e-3), (0.01, 5e-3)])
@pytest.mark.parametrize("robot", [THESIS, TWO_TUBE], ids=lambda r: r.name)
def test_slopes_of_what_differs_between_two_loaded_arms_are_bounded(robot: Robot, turned: float, moved: float) -> None:
    """Of rotations, which change by torque over stiffness; of torques and moments by differences along both arms."""
    n, kt = robot.n_tubes, np.array([tube.torsional_stiffness for tube in robot.tubes])
    start = np.linspace(0.4, -0.8, n), robot.home_translations - 0.03
    end = start[0] + turned * np.linspace(0.7, -0.4, n), start[1] + moved
    arms = [forward_kinematics(robot, *joints, load=SIDEWAYS) for joints in (start, end)]
    intervals, _ = intervals_of(arms, SIDEWAYS)
    bounds = _Bounds(intervals)
    between = bounds._between_samples(bounds.changes)
    slopes = [2 * PARTS * each[0] for each in (between.theta, between.torque, between.moment)]
    x, sharp = np.linspace(0.0, 1.0, 401)[1:-1], 1 - 1e-3
    for k in np.flatnonzero(intervals.length[0][0] > 1e-9):
        rows = []
        for e, cuts in enumerate((intervals.start_cuts[0], intervals.end_cuts[0])):
            length = cuts[k + 1] - cuts[k]
            torque, moment = intervals.arms.sampled(np.full(len(x), e), cuts[k] + x * length)
            rows.append((length * torque / kt, torque, moment))
        present = intervals.stretch[0, k] < intervals.arms.constants.ended
        turn, *others = (each[1] - each[0] for each in zip(*rows, strict=True))
        torque, moment = (np.gradient(each, x, axis=0)[2:-2] for each in others)
        true = np.abs(turn).max(0)
        assert (slopes[0][k] >= sharp * true)[present].all()
        assert slopes[0][k].max() <= 2 * true.max() or true.max() < 1e-4
        assert (slopes[1][k] >= sharp * np.abs(torque).max(0))[present].all()
        assert slopes[2][k] >= sharp * np.linalg.norm(moment, axis=1).max()


def test_the_second_variation_changes_by_the_moment_of_the_load_about_the_own_bend_of_a_tube() -> None:
    """A long transmission turns a short tube as one by y: a force F across it takes the energy F kappa y^2 int (L - s).

    This is so where the tube bends along the force, and 0 where it bends across. The bound has F L for F (L - s), so
    that it is twice as much, and what the turned tube bends.
    """
    length, transmission, curvature, force, turn = 5e-3, 1.0, 4.0, 0.01, 0.01
    robot = ConcentricRobot((Tube(1e-3, 0.8e-3, transmission, length, curvature),))
    load = Load(force=(force, 0, 0))
    arm = forward_kinematics(robot, [np.pi / 2], load=load)
    bounds = _Bounds(intervals_of([arm, arm], load)[0])
    sections = bounds.length.v.shape
    none = np.zeros(sections)
    turned = _Displacement((np.full((*sections, 1), turn), np.zeros((*sections, 1, 1))), none, none)
    compliance = transmission / robot.tubes[0].torsional_stiffness
    true = force * curvature * length**2 / 2 * compliance * np.sin(turn)
    assert true <= bounds.hessian_change(turned, stretched=False).item() <= 2.6 * true


def test_the_second_variation_of_a_longer_column_is_lower_by_what_the_square_of_its_length_grows() -> None:
    """A column of length h under a force F has 1 - 4 F h^2 / (pi^2 K) of its elastic form left (Euler)."""
    force, withdrawn = 1.0, np.array([-0.010, -0.008])
    robot = ConcentricRobot((Tube(1e-3, 0.8e-3, 0.0, 0.05, 0.0),))
    load = Load(force=(0.0, 0.0, -force))
    arms = [forward_kinematics(robot, [0.0], [shift], load=load) for shift in withdrawn]
    bounds = _Bounds(intervals_of(arms, load)[0])
    none = np.zeros(bounds.length.v.shape)
    still = _Displacement((none[..., None], none[..., None, None]), none, none)
    first, last = 0.05 + withdrawn
    change = 4 * force / (np.pi**2 * robot.tubes[0].bending_stiffness)
    true = change * (((first + last) / 2) ** 2 - first**2)
    assert true <= bounds.hessian_change(still, stretched=True).item() <= 4.5 * true
    assert bounds.hessian_change(still, stretched=False).item() == 0.0


@pytest.mark.parametrize("robot", [THESIS, TWO_TUBE], ids=lambda r: r.name)
def test_sections_differ_most_from_those_at_the_nearer_end_in_the_middle_of_the_time(robot: Robot) -> None:
    """Lengths h, and what coordinates of length 1 make of rotations and bends by sqrt(h / kt) and sqrt(h / K)."""
    n = robot.n_tubes
    joints = [(np.zeros(n), robot.home_translations - 0.01 * (1 + e * np.linspace(0.2, 0.9, n))) for e in (0, 1)]
    intervals, _ = intervals_of([forward_kinematics(robot, *q, load=SIDEWAYS) for q in joints], SIDEWAYS)
    bounds = _Bounds(intervals)
    kt, stiffness = bounds.kt, bounds.stiffness
    held = [intervals.arms.constants.along.compliant(-intervals.arms.constants.held(q[1])) for q in joints]
    largest = [np.zeros(1)] * 3
    for near, far in ((0, 1), (1, 0)):
        first = intervals.length[near]
        for t in np.linspace(0.0, 0.5, 11):
            reached = first + t * (intervals.length[far] - first)
            root = np.sqrt(reached) - np.sqrt(first)
            spring = np.sqrt(held[near] + t * (held[far] - held[near])) - np.sqrt(held[near])
            turn = np.sqrt(np.cumsum(root[..., None] ** 2 / kt, axis=1) + spring**2)
            bend = np.sqrt(np.cumsum(root**2 / stiffness, axis=1))
            largest = [np.maximum(a, b) for a, b in zip(largest, (np.abs(reached - first), turn, bend), strict=True)]
    change = bounds._geometry_change()
    for bound, true in zip((change.h, change.y, change.bending), largest, strict=True):
        assert (bound >= true * (1 - 1e-9)).all()
        assert bound.max() <= 1.01 * true.max()


@pytest.mark.parametrize("curvature", [0.0, 5.0])
def test_the_error_between_points_of_a_loaded_rod_is_bounded_by_its_third_derivative(curvature: float) -> None:
    """Its square is |u|^4 + |u'|^2, by differences of the arm as it is solved for."""
    robot = ConcentricRobot((Tube(1e-3, 0.8e-3, 0.0, 0.1, curvature),))
    arm = forward_kinematics(robot, [0.0], load=SIDEWAYS)
    arms = LoadedArms.of(Constants.of(robot), [arm], load=DeadLoad.of(robot, SIDEWAYS))
    s, size = arm.arc_length, np.linalg.norm(arm.curvature, axis=1)
    slope = np.linalg.norm(np.diff(arm.curvature, axis=0), axis=1) / np.diff(s)
    third = np.hypot((size[1:] + size[:-1]) ** 2 / 4, slope)
    assert arms.shape_error[0] - arm.tip_error >= 0.99 * (SHAPE_ERROR[0] * np.diff(s) ** 3 * third).max()


def test_two_branches_at_one_place_are_not_joined() -> None:
    snap = find_snap(THESIS, (np.zeros(3), HOME), (np.array([270, 0, 0]) * DEG, HOME), load=SIDEWAYS)
    assert snap is not None
    path = [np.zeros(3), snap.rotations - [2e-3, 0, 0]]
    on = follow(THESIS, path, [HOME, HOME], load=SIDEWAYS).equilibria[-1]
    landed = forward_kinematics(THESIS, snap.rotations - [1e-3, 0, 0], HOME, load=SIDEWAYS, start=snap.after)
    intervals, margins = intervals_of([on, landed], SIDEWAYS)
    assert margins.min() > 0
    assert not loaded_branch(intervals, margins).unbroken.any()


def test_a_load_snaps_what_holds_without_it() -> None:
    """Where, the following of the loaded robot tells by itself."""
    load, table = Load(force=(0, 0.05, 0)), [np.zeros(3), np.array([200, 0, 0]) * DEG]
    assert verify_trajectory(THESIS, [0, 10], table).holds
    loaded = verify_trajectory(THESIS, [0, 10], table, load=load)
    snap = find_snap(THESIS, (table[0], HOME), (table[1], HOME), load=load)
    assert snap is not None
    assert loaded.snap == pytest.approx(snap.fraction, abs=1e-9)
    assert loaded.faults[0].startswith("the robot snaps")
    assert loaded.least_margin == 0.0
    earlier = verify_trajectory(THESIS, [0, 10], [table[0], table[1] * 0.9], load=load)
    assert earlier.holds
    assert earlier.end.load == load


def test_no_load_says_what_is_said_without() -> None:
    table = [np.zeros(3), np.array([180, 20, 0]) * DEG]
    plain = verify_trajectory(THESIS, [0, 10], table)
    loaded = verify_trajectory(THESIS, [0, 10], table, load=Load())
    assert plain.holds
    assert loaded.holds
    assert loaded.least_margin == pytest.approx(plain.least_margin, abs=1e-5)


def test_the_clearance_is_that_of_the_loaded_arm() -> None:
    """It bounds what dense samples measure, sharply, while tubes turn and slide."""
    joints = np.array([[0, 0, 0, *HOME], [1.0, 0, 0.3, *(HOME - [0.03, 0.02, 0.01])]])
    load = Load(force=(0.02, 0, 0), gravity=(0, 0, -9.81))
    middle = forward_kinematics(THESIS, *np.split(joints.mean(0), 2), load=load)
    body = Sphere(tuple(middle.position[-4] + 15e-3 * middle.frame[-4, :, 0]), 4e-3)
    proof = verify_trajectory(THESIS, [0, 5], joints[:, :3], joints[:, 3:], load=load, obstacles=[body])
    current, smallest = forward_kinematics(THESIS, joints[0, :3], joints[0, 3:], load=load), np.inf
    for x in np.linspace(0, 1, 61):
        current = forward_kinematics(
            THESIS, *np.split(joints[0] + x * (joints[1] - joints[0]), 2), load=load, start=current
        )
        smallest = min(smallest, ArmSurface(current).clearance(scene_of([body])))
    assert proof.holds
    assert smallest - 3e-5 <= proof.least_clearance <= smallest
    plain = verify_trajectory(THESIS, [0, 5], joints[:, :3], joints[:, 3:], obstacles=[body])
    assert abs(plain.least_clearance - smallest) > 1e-3


def test_what_is_not_proved_is_said_by_name() -> None:
    table = [np.zeros(3), np.array([2, 0, 0]) * DEG]
    proof = verify_trajectory(THESIS, [0, 1], table, load=Load(distributed=lambda s: (0.1 * s, 0.0, 0.0)))
    under = "a load per length that is a function of the arc length"
    assert proof.faults == (f"not proved: what lies between equilibria under {under} is not bounded",)
    assert proof.followed == 1.0
    under = "a force or a moment that turns with the tip"
    proof = verify_trajectory(THESIS, [0, 1], table, load=Load(moment=(0.01, 0, 0), frame="tip"))
    assert proof.faults == (f"not proved: what lies between equilibria under {under} is not bounded",)
    ends = [forward_kinematics(THESIS, turns, load=proof.end.load).margin for turns in table]
    assert proof.least_margin <= min(ends)


def test_plans_of_a_loaded_robot_end_where_its_loaded_tip_is_wanted() -> None:
    desired = forward_kinematics(THESIS, [0.5, 0.3, -0.2], HOME, load=SIDEWAYS).tip_position
    plan = plan_trajectory(THESIS, (np.zeros(3), None), desired, load=SIDEWAYS, options=PlanOptions(objective="none"))
    assert plan.proved
    assert plan.start.load == plan.end.load == SIDEWAYS
    np.testing.assert_allclose(plan.tip_position[-1], desired, atol=1e-7)
    again = forward_kinematics(THESIS, plan.rotations[-1], plan.translations[-1], load=SIDEWAYS)
    np.testing.assert_allclose(again.tip_position, desired, atol=1e-7)


@pytest.mark.parametrize(
    ("load", "options", "words"),
    [
        (Load(distributed=lambda s: (s, 0, 0)), PlanOptions(), "a function of the arc length; no trajectory"),
        (
            Load(force=(0, 0, 0.01), frame="tip"),
            PlanOptions(),
            "a force or a moment that turns with the tip; no trajectory",
        ),
    ],
)
def test_plans_that_could_not_be_proved_are_refused(load: Load, options: PlanOptions, words: str) -> None:
    with pytest.raises(InputError, match=words):
        plan_trajectory(THESIS, (np.zeros(3), None), (np.ones(3) * 0.1, None), load=load, options=options)


def test_a_start_that_the_load_snaps_is_named() -> None:
    turned = follow(THESIS, [np.zeros(3), np.array([200, 0, 0]) * DEG]).equilibria[-1]
    with pytest.raises(SolveError, match="the branch from the unloaded equilibrium ends"):
        plan_trajectory(THESIS, turned, (np.zeros(3), None), load=Load(force=(-0.03, 0, 0)))


@pytest.mark.usefixtures("short_films")
def test_a_plan_under_load_from_the_command_line(run: Run, tmp_path: Path) -> None:
    study = tmp_path / "study.yaml"
    study.write_text(f"kind: plan\nrobot: {FILE}\ngoal_deg: [20, 0, 0]\n")
    flags = ("--tip-force-mN", "20,0,0", "--gravity-m-per-s2=0,0,-9.81")
    under = "under 20, 0, 0 mN at the tip; gravity 0, 0, -9.81 m/s^2, assuming no other load and no friction"
    made = run("plan", str(study), *flags, "--time-limit-s", "300", "--out", str(tmp_path / "out"))
    assert made.code == 0
    assert under in " ".join(made.out.split())
    moved = str(tmp_path / "out" / "trajectory.csv")
    again = answer(run("verify", moved, *flags, "--json"))
    assert again["proved"]
    assert again["assumed"] == under
    assert "a trajectory under the load" in refused(run("verify", moved, "--json"))[0]
    pushed = run("verify", moved, *flags, "--max-tip-force-mN", "5", "--json")
    assert pushed.code == 3
    report = json.loads(pushed.out)
    assert (
        "20, 0, 0 mN at the tip; gravity 0, 0, -9.81 m/s^2 and any force of up to 5 mN on the tip" in report["assumed"]
    )
    assert "nothing shows that no force of up to 5 mN" in report["faults"][0]


def test_the_moment_of_the_load_is_no_larger_than_its_lever_on_a_straight_arm() -> None:
    """|m_w| <= L |F| + L^2 / 2 |w|: a straight arm that a force and a load per length push across reaches it."""
    robot = ConcentricRobot((Tube(1e-3, 0.8e-3, 0.0, 0.1, 0.0),))
    load = Load(force=(1e-5, 0.0, 0.0), distributed=(2e-4, 0.0, 0.0))
    arms = LoadedArms.of(
        Constants.of(robot), [forward_kinematics(robot, [0.0], load=load)], load=DeadLoad.of(robot, load)
    )
    true = float(np.linalg.norm(arms.moment, axis=1).max())
    assert true == pytest.approx(0.1 * 1e-5 + 0.1**2 / 2 * 2e-4, rel=1e-4)
    assert 0.999 * arms._lever[0] <= true <= arms._lever[0] * (1 + 1e-6)


def test_bending_stiffness_is_the_sum_of_the_tubes_that_are_there() -> None:
    """K, N m^2, from the base to the tip, along which tubes end."""
    arm = forward_kinematics(THESIS, np.zeros(3), HOME, load=SIDEWAYS)
    arms = LoadedArms.of(Constants.of(THESIS), [arm], load=DeadLoad.of(THESIS, SIDEWAYS))
    each = np.array([tube.bending_stiffness for tube in THESIS.tubes])
    _, stiffness = arms._moments(arms._values[0])
    inside = np.abs(arms.arc_length[:, None] - arms.ends[0]).min(1) > 1e-5
    true = (each * (arms.arc_length[:, None] < arms.ends[0])).sum(1)
    np.testing.assert_allclose(stiffness[inside], true[inside], rtol=1e-9)
