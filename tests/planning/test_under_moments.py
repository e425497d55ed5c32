"""Motions under moments, which have no energy: bounds from both sides, and motions that are shown or refused."""

from __future__ import annotations

import numpy as np
import pytest

from tests.examples import DEG, THESIS, TWO_TUBE
from tubeopt import (
    ConcentricRobot,
    Equilibrium,
    Load,
    PlanOptions,
    Tube,
    find_snap,
    follow,
    forward_kinematics,
    plan_trajectory,
    verify_trajectory,
)
from tubeopt.block.transcription.loaded import monotonicity
from tubeopt.equilibrium.kinematics import point_of, sure_margin
from tubeopt.errors import FlutterError
from tubeopt.planning import trajectory_trace
from tubeopt.planning.loaded_branch import CHORD_ERROR, _Bounds, _Displacement, loaded_branch
from tubeopt.planning.loaded_sections import DeadLoad, LoadedArms, LoadedIntervals
from tubeopt.planning.sections import Constants

HOME = THESIS.home_translations
LENGTH, BENDING = 0.1, 1e-2


def rod(length: float, bending: float, torsional: float, curvature: float = 0.0) -> ConcentricRobot:
    """One tube, all of it in front of the plate, of any EI and GJ."""
    tube = Tube(1e-3, 0.8e-3, 0.0, length, curvature, bending_stiffness=bending, torsional_stiffness=torsional)
    return ConcentricRobot((tube,))


def intervals_of(*arms: Equilibrium) -> LoadedIntervals:
    """Those between neighbours in a row of equilibria."""
    robot, load = arms[0].robot, arms[0].load
    assert load is not None
    row = LoadedArms.of(Constants.of(robot), arms, load=DeadLoad.of(robot, load))
    one = np.arange(len(arms) - 1)
    return LoadedIntervals.of(row, one, one + 1)


@pytest.mark.parametrize("size", [0.3, 1.5])
def test_a_moment_along_a_rod_leaves_what_its_closed_form_says(size: float) -> None:
    """K int |psi'|^2 - M int e3.(psi x psi') has the least eigenvalue 1 - M L / (pi K)."""
    robot = rod(LENGTH, BENDING, 1e3 * BENDING)
    arm = forward_kinematics(robot, [0.0], load=Load(moment=(0, 0, size * BENDING / LENGTH)))
    assert sure_margin(arm) == pytest.approx(1 - size / np.pi, abs=1e-6)
    assert arm.margin > sure_margin(arm) + 0.02


@pytest.mark.parametrize("share", [0.1, 0.4])
def test_a_moment_across_a_soft_rod_leaves_what_its_closed_form_says(share: float) -> None:
    """The torque m.(psi x t) y at the end couples a bend and a twist, each constant: 1 - M L / (2 sqrt(K kt))."""
    torsional = 1e-6 * BENDING
    moment = 2 * share * np.sqrt(BENDING * torsional) / LENGTH
    arm = forward_kinematics(rod(LENGTH, BENDING, torsional), [0.0], load=Load(moment=(moment, 0, 0)))
    assert sure_margin(arm) == pytest.approx(1 - share, abs=2e-3)


def test_sure_margins_do_not_depend_on_the_mesh() -> None:
    """Where a moment at a joint of the mesh twists a tube, too."""
    load = Load(points=((0.06, (0, 0, 0), (0.006, -0.004, 0.008)),))
    point, results = point_of(forward_kinematics(THESIS, [0.0, 1.0, 2.0], load=load)), []
    for degree, refinement in ((7, 0), (8, 0), (7, 1)):
        current = point.member.on(degree=degree, refinement=refinement)
        results.append(monotonicity(current.problem, current.solve(current.transfer(point)).state))
    assert np.ptp(results) < 1e-10


@pytest.mark.parametrize("along", [True, False])
def test_the_form_of_a_longer_rod_curves_as_its_closed_form(along: bool) -> None:
    """At fixed coordinates psi grows with the length h of the rod, y by a torque t of it and t0 of what is held behind,
    L - h: psi x psi' makes h^2 of it, psi y makes h (h t + (L - h) t0)."""
    ratio = 1e8 if along else 1e-4
    robot, lengths = rod(LENGTH, BENDING, ratio * BENDING), np.array([0.08, 0.0801])
    moment = 1e-5 * BENDING / LENGTH
    load = Load(moment=(0, 0, moment) if along else (moment, 0, 0))
    bounds = _Bounds(intervals_of(*(forward_kinematics(robot, [0.0], [x - LENGTH], load=load) for x in lengths)))
    h = lengths[0]
    true = 2 / np.pi / h if along else np.sqrt((1 / h + 1 / (LENGTH - h)) / h / ratio)
    true *= np.ptp(lengths) ** 2 * moment / BENDING
    assert 0.999 * true <= bounds.hessian_chord_error()[0] / CHORD_ERROR <= (np.pi / 2 if along else 2.0) * 1.02 * true


@pytest.mark.parametrize("across", [True, False])
def test_what_a_moment_makes_of_a_chord_bends_as_the_frame_of_an_arc_that_turns(across: bool) -> None:
    """A stiff tube of angle phi turns by d: m.t is m sin(phi) cos(alpha), and R'm for m along z is m sin(phi) long."""
    angle, turn, moment = 0.012, 0.2, 1e-6
    robot = ConcentricRobot((Tube(1e-3, 0.8e-3, 0.0, LENGTH, angle / LENGTH),))
    load = Load(moment=(moment, 0, 0) if across else (0, 0, moment))
    bounds = _Bounds(intervals_of(*(forward_kinematics(robot, [x], load=load) for x in (0.0, turn))))
    torque, bent = bounds.chord.torque, bounds.chord.moment
    result = torque.dd[0, -1, 0] if across else bent.dd[0, -1]
    # The torque is bounded by as much at the tip as the bend of the tube makes of it up to the plate, where it is 0.
    assert 0.999 <= result / (moment * np.sin(angle) * turn**2) <= (2.1 if across else 1.03)


def test_what_a_bend_makes_of_torque_and_moment_is_exact_for_a_rod() -> None:
    """A bend constant along the arm, of a root of T of 1, turns the tip by sqrt(h / K)."""
    moment, size = 1e-6, 1e-3
    robot = rod(LENGTH, BENDING, BENDING)
    arm = forward_kinematics(robot, [0.0], load=Load(moment=(moment, 0, 0)))
    result = _Bounds(intervals_of(arm, arm))._response(np.array([size]))
    true = moment * np.sqrt(LENGTH / BENDING) * size
    assert result.moment[0, -1] == pytest.approx(true, rel=1e-9)
    assert result.torque[0, -1, 0] == pytest.approx(true, rel=1e-6)


def test_the_form_of_a_bent_rod_changes_no_more_than_is_said() -> None:
    """A moment along a rod that is then bent by phi, alike all along: solved with the arc as its precurvature."""
    moment, angle = 0.5 * BENDING / LENGTH, 0.05
    straight, arc = (rod(LENGTH, BENDING, 1e4 * BENDING, curvature) for curvature in (0.0, angle / LENGTH))
    load = Load(moment=(moment, 0, 0))
    arm = forward_kinematics(straight, [0.0], load=load)
    bounds = _Bounds(intervals_of(arm, arm))
    none = np.zeros((*bounds.length.v.shape, 1))
    moved = _Displacement((none, none[..., None]), np.full(bounds.length.v.shape, angle), none[..., 0])
    other = forward_kinematics(arc, [0.0], load=load)
    assert abs(sure_margin(other) - sure_margin(arm)) <= bounds.hessian_change(moved, stretched=False)[0] * 1.01


def test_no_moment_of_what_is_ahead_is_larger_than_its_lever() -> None:
    """All across one plane on an arm that is all but straight reach it."""
    load = Load(
        (0, -1e-5, 0),
        (2e-6, 0, 0),
        points=((0.05, (0, -2e-5, 0), (1e-6, 0, 0)),),
        distributed=((0.02, 0.07, (0, -1e-4, 0), (3e-5, 0, 0)),),
    )
    robot = rod(LENGTH, BENDING, BENDING)
    arm = forward_kinematics(robot, [0.0], load=load)
    intervals = intervals_of(arm, arm)
    true = LENGTH * 1e-5 + 0.05 * 2e-5 + 0.045 * 0.05 * 1e-4 + 2e-6 + 1e-6 + 0.05 * 3e-5
    assert np.linalg.norm(intervals.arms.moment[0]) == pytest.approx(true, rel=1e-4)
    assert true * 0.9999 <= intervals.arms._lever[0] <= 1.0001 * true
    assert true * 0.9999 <= intervals.lever[0, 0] <= 1.2 * true


def test_torques_and_moments_jump_where_a_moment_acts() -> None:
    """By m.t on the outermost tube, and by the part of m across the arm."""
    position, moment = 0.06, np.array([0.006, -0.004, 0.008])
    arm = forward_kinematics(THESIS, [0.0, 1.0, 2.0], load=Load(points=((position, (0, 0, 0), tuple(moment)),)))
    row = intervals_of(arm, arm).arms
    k = int(np.argmin(np.abs(arm.arc_length - position)))
    torques, moments = row.sampled(np.zeros(2, dtype=int), position + np.array([-1e-7, 1e-7]))
    assert torques[0] - torques[1] == pytest.approx([0, 0, moment @ arm.frame[k, :, 2]], abs=1e-7)
    assert moments[0] - moments[1] == pytest.approx((arm.frame[k].T @ moment)[:2], abs=1e-6)


def test_two_branches_under_a_moment_are_not_joined() -> None:
    load, ends = Load(moment=(0.003, 0.002, 0.002)), (np.zeros(3), np.array([200, 0, 0]) * DEG)
    snap = find_snap(THESIS, (ends[0], HOME), (ends[1], HOME), load=load)
    assert snap is not None
    on = follow(THESIS, [ends[0], snap.rotations - [2e-3, 0, 0]], [HOME, HOME], load=load).equilibria[-1]
    landed = forward_kinematics(THESIS, snap.rotations - [1e-3, 0, 0], HOME, load=load, start=snap.after)
    sure = np.array([sure_margin(e) for e in (on, landed)])
    assert not loaded_branch(intervals_of(on, landed), np.maximum(sure, 0.01)).unbroken.any()
    proof = verify_trajectory(THESIS, [0, 1], ends, load=load)
    # The fold at 187.578 deg is that of tests/stability/test_moments_along_the_arm.py, by shooting.
    assert proof.faults[0].startswith("the robot snaps at 93.8 % of the trajectory")


@pytest.mark.parametrize(
    "load",
    [
        Load(moment=(0.002, 0.001, -0.001)),
        Load(points=((0.06, (0.01, 0, 0), (0.006, -0.004, 0.008)),)),
        Load(distributed=((0.01, 0.15, (0.05, 0, 0), (0.05, 0.03, -0.02)),), gravity=(0, 0, -9.81)),
    ],
    ids=["tip", "point", "along"],
)
def test_a_motion_under_moments_is_proved_and_followed_densely(load: Load) -> None:
    """Tubes turn and slide under places of the load: no snap, no margin below what is shown, no arm off its bound."""
    start, end = np.concatenate([np.zeros(3), HOME]), np.array([0.5, 0.3, -0.2, *(HOME - [0.02, 0.015, 0.005])])
    proof = verify_trajectory(THESIS, [0, 1], [start[:3], end[:3]], [start[3:], end[3:]], load=load)
    assert proof.holds
    assert find_snap(THESIS, (start[:3], start[3:]), (end[:3], end[3:]), load=load) is None
    current = forward_kinematics(THESIS, start[:3], start[3:], load=load)
    tips = []
    for x in np.linspace(0, 1, 41):
        current = forward_kinematics(THESIS, *np.split(start + x * (end - start), 2), load=load, start=current)
        assert current.margin >= proof.least_margin - 1e-7
        tips.append(current.tip_position)
    assert 40 * np.linalg.norm(np.diff(tips, axis=0), axis=1).max() <= proof.largest_tip_rate


def test_a_moment_that_changes_its_tube_is_not_proved() -> None:
    """The outermost tube draws its end back from under a moment along the arm: the shape jumps there."""
    end = forward_kinematics(THESIS, np.zeros(3)).tube_end[2]
    load = Load(points=((end - 0.01, (0, 0, 0), (0, 0, 0.005)),))
    back = HOME - [0.0, 0.0, 0.02]
    arms = [forward_kinematics(THESIS, np.zeros(3), shift, load=load) for shift in (HOME, back)]
    intervals = intervals_of(*arms)
    assert not intervals.ordered.any()
    assert not loaded_branch(intervals, np.ones(2)).unbroken.any()


def test_what_has_no_positive_symmetric_part_is_refused_by_name() -> None:
    """A rod under 4 K/L along it is stable, and its symmetric part has the eigenvalue 1 - 4/pi."""
    robot = rod(LENGTH, BENDING, BENDING)
    load = Load(moment=(0, 0, 4 * BENDING / LENGTH))
    proof = verify_trajectory(robot, [0, 1], [[0.0], [0.1]], load=load)
    assert proof.least_margin > 0.5
    assert len(proof.faults) == 1
    assert proof.faults[0].startswith("not proved: at 0 % of the trajectory the margin is 0.")
    assert f"symmetric part of the linearised equations is {1 - 4 / np.pi:.3g}; a proof" in proof.faults[0]


def test_flutter_is_no_snap(monkeypatch: pytest.MonkeyPatch) -> None:
    """A rod that is pushed along itself with less than what buckles it, under K/L along it, and gets longer."""
    robot = rod(LENGTH, BENDING, 0.8 * BENDING)
    load = Load((0, 0, -0.96 * np.pi**2 / 4 * BENDING / LENGTH**2), (0, 0, BENDING / LENGTH))
    ends = ([-LENGTH / 10], [0.0])
    monkeypatch.setattr(trajectory_trace, "MAX_EQUILIBRIA", 60)
    proof = verify_trajectory(robot, [0, 1], [[0.0]] * 2, ends, load=load)
    assert proof.faults[0].startswith("the robot begins to flutter at 92 % of the trajectory (0.92 s)")
    with pytest.raises(FlutterError, match=r"flutter at 94\.575 %"):
        find_snap(robot, ([0.0], ends[0]), ([0.0], ends[1]), load=load)


def test_a_plan_under_a_moment_ends_where_its_loaded_tip_is_wanted() -> None:
    load = Load(moment=(0.0, 0.003, 0.001))
    goal = np.array([0.4, -0.2]), TWO_TUBE.home_translations - 0.01
    options = PlanOptions(objective="none")
    plan = plan_trajectory(TWO_TUBE, (np.zeros(2), None), goal, load=load, options=options)
    assert plan.proved
    assert plan.start.load == plan.end.load == load
    desired = forward_kinematics(TWO_TUBE, *goal, load=load)
    np.testing.assert_allclose(plan.tip_position[-1], desired.tip_position, atol=1e-7)
    again = verify_trajectory(TWO_TUBE, plan.time, plan.rotations, plan.translations, load=load)
    assert again.holds
