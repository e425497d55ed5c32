"""Forward kinematics: independent numbers, closed forms, symmetries of the physics, and how it fails."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ellipj

from benchmarks.shooting import shoot
from tests.examples import (
    CRL,
    DEG,
    MM,
    THESIS,
    THESIS_TIPS,
    TWO_TUBE,
    configurations,
    nested,
    opposed,
    poses,
    unstable_home,
)
from tubeopt import ConcentricRobot, Discretisation, Equilibrium, InputError, Newton, SolveError, Status, Tube
from tubeopt.equilibrium.file import ALONG_THE_ARM, ARRAYS
from tubeopt.equilibrium.kinematics import METHODS, forward_kinematics, to_equilibrium
from tubeopt.typing import Array

SOME_POSES = settings(max_examples=40)

Pose = tuple[ConcentricRobot, Array, Array]


def same_branch(a: Equilibrium, b: Equilibrium, tolerance: float) -> bool:
    """Whether two equilibria agree in theta along the arm."""
    return bool(np.abs(a.rotation - b.rotation).max() <= tolerance)


# --- design numbers -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("rotations", "tip", "margin"), THESIS_TIPS)
def test_tips_and_margins_of_the_thesis_robot(
    rotations: tuple[float, ...], tip: tuple[float, ...], margin: float, method: str
) -> None:
    solved = forward_kinematics(THESIS, rotations, method=method)
    assert solved.tip_position == pytest.approx(np.array(tip) * MM, abs=1e-8)
    assert solved.margin == pytest.approx(margin, abs=1e-4)
    assert solved.stable
    assert solved.status is Status.STABLE


def test_rotations_at_the_plate() -> None:
    solved = forward_kinematics(THESIS, (0.0, 1.0, 2.0))
    assert solved.rotation[:, 0] == pytest.approx([0.59433179, 1.02556267, 1.91656955], abs=1e-8)


def test_the_unstable_equilibrium_is_there_but_never_the_answer() -> None:
    rotations = np.array([np.pi, 0.0, 0.0])
    saddle = to_equilibrium(unstable_home(THESIS, rotations), "tubes without torsion")
    assert saddle.tip_position == pytest.approx(np.array([0.0, -15.1956103, 198.104534]) * MM, abs=1e-8)
    assert saddle.margin == pytest.approx(-0.95567, abs=1e-4)
    assert not saddle.stable
    assert saddle.status is Status.UNSTABLE
    for method in METHODS:
        cold = forward_kinematics(THESIS, rotations, method=method)
        assert cold.stable
        assert cold.energy < saddle.energy
        assert np.linalg.norm(cold.tip_position - saddle.tip_position) > 0.05
    # Followed as a guess it stays what it is, stable or not.
    again = forward_kinematics(THESIS, rotations, start=saddle)
    assert again.margin == pytest.approx(saddle.margin, abs=1e-9)
    assert again.tip_position == pytest.approx(saddle.tip_position, abs=1e-12)


@pytest.mark.parametrize("robot", [THESIS, CRL, TWO_TUBE], ids=lambda robot: robot.name)
def test_against_shooting(robot: ConcentricRobot) -> None:
    for rotations, translations in configurations(robot, 15, seed=3):
        solved = forward_kinematics(robot, rotations, translations)
        reference = shoot(robot, rotations, translations, solved.torsion[:, 0])
        assert solved.tip_position == pytest.approx(reference.tip_position, abs=1e-10)
        assert solved.tip_rotation == pytest.approx(reference.tip_rotation, abs=1e-9)
        assert solved.rotation[:, 0] == pytest.approx(reference.rotation, abs=1e-10)
        assert solved.tip_rotations == pytest.approx(reference.tip_rotations, abs=1e-10)


# --- the three methods ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("degree", [5, 6, 7])
@pytest.mark.parametrize("robot", [THESIS, CRL], ids=lambda robot: robot.name)
def test_three_methods_one_answer(robot: ConcentricRobot, degree: int) -> None:
    gauss = Discretisation("gauss", degree)
    for rotations, translations in configurations(robot, 3, seed=degree):
        # Within a sixth of a turn of each other the tubes have one equilibrium, so that no method can find another.
        newton, *others = (
            forward_kinematics(robot, rotations / 3, translations, method=method, discretisation=gauss, tolerance=1e-3)
            for method in METHODS
        )
        for other in others:
            assert same_branch(newton, other, 1e-9)
            assert other.tip_position == pytest.approx(newton.tip_position, abs=1e-10)
            assert other.energy == pytest.approx(newton.energy, rel=1e-12)
            assert other.residual < 1e-9


@pytest.mark.parametrize("degree", [5, 6, 7])
def test_radau_points_give_the_same_equilibrium(degree: int) -> None:
    radau = Discretisation("radau", degree)
    reference = forward_kinematics(THESIS, (0.0, 1.0, 2.0), tolerance=1e-11)
    for method in METHODS:
        solved = forward_kinematics(THESIS, (0.0, 1.0, 2.0), method=method, discretisation=radau)
        assert solved.tip_rotations == pytest.approx(reference.tip_rotations, abs=1e-9)
        assert solved.tip_position == pytest.approx(reference.tip_position, abs=1e-9)
        assert solved.margin == pytest.approx(reference.margin, abs=1e-9)


def test_statistics_say_how_it_was_solved() -> None:
    for method in METHODS:
        statistics = forward_kinematics(THESIS, (0.0, 1.0, 2.0), method=method).statistics
        assert (statistics.method, statistics.degree, statistics.elements) == (method, 6, 2)
        assert statistics.start == "tubes without torsion"
        assert 1 <= statistics.iterations < 60
        assert 0 < statistics.seconds < 30


# --- two tubes in closed form ---------------------------------------------------------------------------------------

SNAPS = (
    # c, l (for L = 1), tip difference and input at the fold (deg): design numbers
    (3.0, 0.0, 139.19242930, 184.38397018),
    (4.0, 0.0, 116.72100858, 197.78561425),
    (1.0, 1.0, 132.57393506, 189.54408069),
    (2.0, 0.5, 114.79735263, 203.90356628),
)


def pair(c: float, transmission: float) -> ConcentricRobot:
    """Two tubes with overlap 1 m, nu = 0.28, c = (1 + nu) kappa_1 kappa_2, the inner one curved four times as much."""
    kappa = np.sqrt(c / 1.28)
    return nested((transmission, 1.0, 2 * kappa), (transmission, 1.0, kappa / 2))


def input_of(tip: float | Array, c: float, transmission: float, length: float | Array = 1.0) -> Any:
    """Input difference (rad) that holds the tips `tip` apart; with transmission 0, the difference at `length` from
    the tips."""
    k, other = np.cos(tip / 2), np.sin(tip / 2)
    sn, cn, dn, _ = ellipj(np.sqrt(c) * length, k**2)
    return 2 * np.arccos(k * cn / dn) + 2 * transmission * np.sqrt(c) * k * other * sn / dn


@pytest.mark.parametrize(("c", "transmission", "tip", "snap"), SNAPS)
def test_two_tubes_in_closed_form(c: float, transmission: float, tip: float, snap: float) -> None:
    robot = pair(c, transmission)
    home = forward_kinematics(robot, (0.0, 0.0))
    assert input_of(tip * DEG, c, transmission) / DEG == pytest.approx(snap, abs=1e-7)
    for fraction in (0.1, 0.5, 0.9, 0.999):
        apart = fraction * tip * DEG
        alpha = input_of(apart, c, transmission)
        solved = forward_kinematics(robot, (alpha + 0.4, 0.4), start=home, tolerance=1e-10)
        assert -np.diff(solved.tip_rotations) == pytest.approx([apart], abs=1e-7)
        along = input_of(apart, c, 0.0, 1.0 - solved.arc_length)
        assert solved.rotation[0] - solved.rotation[1] == pytest.approx(along, abs=1e-7)
        assert solved.stable
        # Torques balance, so the mean of the rotations weighted by GJ is that of the inputs all along.
        gj = np.array([tube.torsional_stiffness for tube in robot.tubes])
        assert gj @ solved.rotation == pytest.approx(np.full(len(along), gj @ solved.rotations), abs=1e-10)


@pytest.mark.parametrize(("c", "transmission", "tip", "snap"), SNAPS)
def test_the_branch_ends_at_the_snap_of_the_closed_form(c: float, transmission: float, tip: float, snap: float) -> None:
    robot = pair(c, transmission)
    home = forward_kinematics(robot, (0.0, 0.0))
    before = forward_kinematics(robot, ((snap - 1e-4) * DEG, 0.0), start=home)
    assert 0 < before.margin < 0.01
    assert -np.diff(before.tip_rotations) / DEG == pytest.approx([tip], abs=0.2)
    with pytest.raises(SolveError, match="the branch ends"):
        forward_kinematics(robot, ((snap + 1e-4) * DEG, 0.0), start=before)


@pytest.mark.parametrize(("c", "transmission", "snaps"), [(2.4, 0.0, False), (2.5, 0.0, True), (0.5, 1.2, False)])
def test_two_tubes_snap_where_the_criterion_says(c: float, transmission: float, snaps: bool) -> None:
    root = np.sqrt(c)
    assert snaps != (root < np.pi / 2 and transmission * root * np.tan(root) < 1)
    solution = unstable_home(pair(c, transmission), np.array([np.pi, 0.0]))
    assert (solution.margin < 0) == snaps


# --- symmetries and limits, over random robots ----------------------------------------------------------------------


@given(poses(), st.floats(-7.0, 7.0))
@SOME_POSES
def test_turning_every_tube_turns_the_shape(pose: Pose, angle: float) -> None:
    robot, rotations, shift = pose
    still = forward_kinematics(robot, rotations, shift)
    turned = forward_kinematics(robot, rotations + angle, shift, start=still)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    assert turned.rotation == pytest.approx(still.rotation + angle, abs=1e-9)
    assert turned.position == pytest.approx(still.position @ turn.T, abs=1e-10)
    # The Bishop frame starts as the plate frame, which has not turned.
    assert turned.tip_rotation == pytest.approx(turn @ still.tip_rotation @ turn.T, abs=1e-9)
    assert turned.energy == pytest.approx(still.energy, rel=1e-9, abs=1e-15)
    assert turned.margin == pytest.approx(still.margin, abs=1e-7)


@given(poses())
@SOME_POSES
def test_tubes_bent_to_the_other_side_mirror_the_shape(pose: Pose) -> None:
    robot, rotations, shift = pose
    mirrored = ConcentricRobot(tuple(replace(tube, curvature=-tube.curvature) for tube in robot.tubes))
    one = forward_kinematics(robot, rotations, shift)
    other = forward_kinematics(mirrored, rotations, shift, start=one)
    assert other.rotation == pytest.approx(one.rotation, abs=1e-9)
    assert other.curvature == pytest.approx(-one.curvature, abs=1e-8)
    assert other.position == pytest.approx(one.position * [-1, -1, 1], abs=1e-10)
    half_turned = forward_kinematics(mirrored, rotations + np.pi, shift, start=one)
    assert half_turned.position == pytest.approx(one.position, abs=1e-10)


@given(poses())
@SOME_POSES
def test_seen_in_a_mirror(pose: Pose) -> None:
    # The mirror x -> -x holds the direction in which tubes bend at rotation 0, and turns every rotation around.
    robot, rotations, shift = pose
    one = forward_kinematics(robot, rotations, shift)
    arm = replace(one.arm, rotation=-one.rotation, torsion=-one.torsion)
    points = replace(one.points, point_rotation=-one.point_rotation)
    image = replace(one, rotations=-one.rotations, arm=arm, points=points)
    other = forward_kinematics(robot, -rotations, shift, start=image)
    assert other.rotation == pytest.approx(-one.rotation, abs=1e-9)
    assert other.position == pytest.approx(one.position * [-1, 1, 1], abs=1e-10)
    assert other.energy == pytest.approx(one.energy, rel=1e-9, abs=1e-15)
    assert other.margin == pytest.approx(one.margin, abs=1e-7)


@given(poses(curvature=0.0))
@SOME_POSES
def test_tubes_without_curvature_lie_straight(pose: Pose) -> None:
    robot, rotations, shift = pose
    solved = forward_kinematics(robot, rotations, shift)
    length = max(0.0, float(max(d + tube.curved_length for d, tube in zip(shift, robot.tubes, strict=True))))
    assert solved.tip_position == pytest.approx([0, 0, length], abs=1e-12)
    assert solved.tip_rotation == pytest.approx(np.eye(3), abs=1e-12)
    assert (solved.rotation == rotations[:, None]).all()
    assert (solved.margin, solved.energy) == (1.0, 0.0)


@given(poses(most=1))
@SOME_POSES
def test_one_tube_is_an_arc_of_a_circle(pose: Pose) -> None:
    robot, (alpha,), (shift,) = pose
    tube = robot.tubes[0]
    solved = forward_kinematics(robot, [alpha], [shift])
    straight, bend_length = max(0.0, shift), max(0.0, tube.curved_length + min(0.0, shift))
    bend = bend_length * tube.curvature
    across = bend_length * (bend / 2 if abs(bend) < 1e-6 else (1 - np.cos(bend)) / bend)
    along = straight + bend_length * np.sinc(bend / np.pi)
    # The curvature vector points along theta = alpha, and the tube bends at right angles to it.
    expected = [across * np.sin(alpha), -across * np.cos(alpha), along]
    assert solved.tip_position == pytest.approx(expected, abs=1e-11)
    assert solved.rotation == pytest.approx(np.full((1, len(solved.arc_length)), alpha), abs=1e-12)


@given(poses())
@SOME_POSES
def test_torques_balance_at_every_cross_section(pose: Pose) -> None:
    robot, rotations, shift = pose
    solved = forward_kinematics(robot, rotations, shift)
    torque = np.array([tube.torsional_stiffness for tube in robot.tubes]) @ solved.torsion
    scale = max(tube.bending_stiffness * abs(tube.curvature) for tube in robot.tubes)
    assert torque == pytest.approx(np.zeros(len(solved.arc_length)), abs=1e-9 * scale)


@given(poses())
@SOME_POSES
def test_solution_obeys_its_boundary_conditions_and_its_own_arrays(pose: Pose) -> None:
    robot, rotations, shift = pose
    solved = forward_kinematics(robot, rotations, shift)
    straight = np.array([tube.straight_length for tube in robot.tubes])
    ends = np.maximum(shift + [tube.curved_length for tube in robot.tubes], 0.0)
    assert solved.rotation[:, 0] == pytest.approx(rotations + (straight - shift) * solved.torsion[:, 0], abs=1e-10)
    assert solved.tube_end == pytest.approx(ends, abs=1e-12)
    for i, end in enumerate(ends):
        beyond = solved.arc_length >= end - 1e-12
        assert solved.torsion[i, beyond] == pytest.approx(0.0, abs=1e-9)
        assert solved.rotation[i, beyond] == pytest.approx(solved.tip_rotations[i], abs=1e-10)
    assert solved.arc_length[0] == 0
    assert solved.arc_length[-1] == pytest.approx(ends.max(), abs=1e-11)
    assert (solved.position[0] == 0).all()
    assert (solved.frame[0] == np.eye(3)).all()
    assert (solved.position[-1] == solved.tip_position).all()
    assert (solved.frame[-1] == solved.tip_rotation).all()
    assert solved.frame @ solved.frame.swapaxes(1, 2) == pytest.approx(np.tile(np.eye(3), (len(solved.frame), 1, 1)))
    assert solved.mesh_error <= 1e-8
    assert solved.residual <= 1e-10
    assert solved.stable


@given(poses())
@settings(max_examples=25)
def test_adaptive_integration_confirms_random_robots(pose: Pose) -> None:
    robot, rotations, shift = pose
    check = forward_kinematics(robot, rotations, shift, verify=True).verification
    assert check is not None
    assert check.tip_position < 1e-9
    assert check.tip_rotation < 1e-7
    assert check.rotation < 1e-7
    assert check.base_rotation < 1e-10


def test_two_opposed_tubes_lie_straight() -> None:
    robot = opposed()
    solved = to_equilibrium(unstable_home(robot, np.array([0.0, np.pi])), "tubes without torsion")
    assert solved.rotation == pytest.approx(np.tile([[0.0], [np.pi]], len(solved.arc_length)), abs=1e-12)
    assert solved.position == pytest.approx(solved.arc_length[:, None] * [0, 0, 1], abs=1e-12)
    # All the energy that bending the tubes straight takes: kb kappa^2 / 2 per length.
    stored = sum(tube.bending_stiffness * tube.curvature**2 for tube in robot.tubes) / 2 * 0.1
    assert solved.energy == pytest.approx(stored, rel=1e-12)


def test_equal_tubes_twisted_by_half_a_turn_find_a_lower_energy_if_they_can() -> None:
    # sqrt(c) L > pi/2: straight is unstable, and the tubes give way to one side.
    strong = pair(3.0, 0.0)
    solved = forward_kinematics(strong, (0.0, np.pi))
    saddle = unstable_home(strong, np.array([0.0, np.pi]))
    assert saddle.margin < 0 < solved.margin
    assert solved.energy < saddle.state.energy
    # sqrt(c) L < pi/2: it stays.
    weak = pair(2.0, 0.0)
    assert forward_kinematics(weak, (0.0, np.pi)).rotation[0] == pytest.approx(0.0, abs=1e-12)


def test_own_settings_of_newton_are_those_of_the_general_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    current = forward_kinematics(THESIS, [0.5, 0.2, 0.0])
    usual = forward_kinematics(THESIS, [1.5, 0.2, 0.0], start=current)
    monkeypatch.setattr("tubeopt.equilibrium.kinematics.solve_compiled", None)  # the kernel is not asked
    own = forward_kinematics(THESIS, [1.5, 0.2, 0.0], start=current, method=Newton(iterations=30))
    assert own.tip_position == pytest.approx(usual.tip_position, abs=1e-13)


# --- robustness -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", [THESIS, CRL], ids=lambda robot: robot.name)
@pytest.mark.parametrize("seed", range(4))
def test_a_thousand_random_configurations(robot: ConcentricRobot, seed: int) -> None:
    for rotations, translations in configurations(robot, 250, seed=100 + seed):
        solved = forward_kinematics(robot, rotations, translations)
        assert solved.stable, (rotations, translations)
        assert solved.residual <= 1e-10, (rotations, translations)
        assert solved.mesh_error <= 1e-8, (rotations, translations)


def test_wound_tubes_are_not_unwound() -> None:
    # Joint values of 370 deg are not 10 deg: followed from home, the inner tube is wound up by a whole turn or more.
    robot = pair(1.0, 0.3)
    home = forward_kinematics(robot, (0.0, 0.0))
    near = forward_kinematics(robot, (10 * DEG, 0.0))
    wound = forward_kinematics(robot, (370 * DEG, 0.0), start=home)
    assert wound.tip_rotations[0] - wound.tip_rotations[1] > 300 * DEG
    assert wound.tip_position == pytest.approx(near.tip_position, abs=1e-9)
    together = forward_kinematics(THESIS, np.array([0.0, 1.0, 2.0]) + 2 * np.pi)
    assert together.tip_position == pytest.approx(forward_kinematics(THESIS, (0.0, 1.0, 2.0)).tip_position, abs=1e-12)


def test_nothing_in_front_of_the_plate() -> None:
    solved = forward_kinematics(THESIS, (1.0, 2.0, 3.0), np.array([-250.0, -150.0, -100.0]) * MM, verify=True)
    assert solved.tip_position.tolist() == [0, 0, 0]
    assert solved.tip_rotations.tolist() == [1, 2, 3]
    assert (solved.margin, solved.energy, solved.residual) == (1.0, 0.0, 0.0)


def test_a_withdrawn_tube_changes_nothing() -> None:
    inner = ConcentricRobot(THESIS.tubes[:2])
    rotations = np.array([0.3, 1.7])
    for extra, advance in ((0.5, -0.1), (-2.0, -0.15)):
        both = forward_kinematics(inner, rotations, (0.01, -0.02))
        three = forward_kinematics(THESIS, [*rotations, extra], (0.01, -0.02, advance))
        assert three.position == pytest.approx(both.position, abs=1e-12)
        assert three.margin == pytest.approx(both.margin, abs=1e-12)
        assert three.energy == pytest.approx(both.energy, rel=1e-12)
        assert (three.rotation[2] == extra).all()


def test_a_stretch_held_without_curvature_is_all_that_a_transmission_is() -> None:
    # Retracting a tube whose part behind the plate is held straight: only what lies in front matters.
    long = nested((0.02, 0.15, 12.0), (0.02, 0.1, 8.0))
    short = nested((0.07, 0.1, 12.0), (0.02, 0.1, 8.0))
    rotations = (1.5, 0.0)
    one = forward_kinematics(long, rotations, (-0.05, 0.0))
    other = forward_kinematics(short, rotations, (0.0, 0.0))
    assert one.position == pytest.approx(other.position, abs=1e-12)
    assert one.margin == pytest.approx(other.margin, abs=1e-10)


def test_results_do_not_change_behind_the_callers_back() -> None:
    first = forward_kinematics(THESIS, (0.0, 1.0, 2.0))
    copies = {name: getattr(first, name).copy() for name in (*ARRAYS, *ALONG_THE_ARM)}
    rotations = np.array([0.5, -1.0, 0.3])
    second = forward_kinematics(THESIS, rotations)
    rotations[:] = 9.0
    assert second.rotations.tolist() == [0.5, -1.0, 0.3]
    assert not np.array_equal(first.position, second.position)
    for name, copy in copies.items():
        assert np.array_equal(getattr(first, name), copy), name


# --- following a branch ---------------------------------------------------------------------------------------------


def test_small_steps_and_one_long_one_end_on_the_same_branch() -> None:
    home = at = forward_kinematics(THESIS, (0.0, 0.0, 0.0))
    for angle in range(10, 201, 10):
        at = forward_kinematics(THESIS, (angle * DEG, 0.0, 0.0), start=at)
    once = forward_kinematics(THESIS, (200 * DEG, 0.0, 0.0), start=home)
    assert same_branch(at, once, 1e-10)
    assert once.tip_position == pytest.approx(at.tip_position, abs=1e-12)
    assert once.statistics.start == "guess"
    # The branch from home, not the one beyond the snap that a cold call may prefer.
    assert 100 * DEG < at.tip_rotations[0] < 130 * DEG


def test_the_branch_of_the_thesis_robot_ends_in_a_snap() -> None:
    home = forward_kinematics(THESIS, (0.0, 0.0, 0.0))
    last = forward_kinematics(THESIS, (214.222426 * DEG, 0.0, 0.0), start=home)
    # At the fold the tips lie at 130.231722, 20.009537, 3.579333 deg; short of it by a root of what is missing.
    assert last.tip_rotations / DEG == pytest.approx([130.231722, 20.009537, 3.579333], abs=0.02)
    assert 0 < last.margin < 1e-3
    with pytest.raises(SolveError, match="branch ends before the target joint values") as caught:
        forward_kinematics(THESIS, (214.222428 * DEG, 0.0, 0.0), start=last)
    ended = caught.value.solution
    assert last.rotations[0] <= ended.rotations[0] < 214.222428 * DEG
    assert 0 < ended.margin <= last.margin
    with pytest.raises(SolveError, match=r"it ends (\d+\.\d\d) % of the path from the start to the goal") as caught:
        forward_kinematics(THESIS, (220 * DEG, 0.0, 0.0), start=home)
    percent = float(str(caught.value).split("it ends ")[1].split(" %")[0])
    assert percent == pytest.approx(100 * 214.222427 / 220, abs=0.02)


def test_there_and_back_through_changing_sections() -> None:
    start = forward_kinematics(THESIS, (0.5, -0.8, 1.0), np.array([60.0, 30.0, 0.0]) * MM)
    away = forward_kinematics(THESIS, (-1.0, 0.2, 0.4), np.array([-40.0, 20.0, 30.0]) * MM, start=start)
    back = forward_kinematics(THESIS, start.rotations, start.translations, start=away)
    assert same_branch(start, back, 1e-10)


@pytest.mark.parametrize("method", ["ipopt", "energy"])
def test_every_method_follows_the_branch(method: str) -> None:
    home = forward_kinematics(THESIS, (0.0, 0.0, 0.0))
    goal = (190 * DEG, 0.0, 0.0)
    followed, same = (forward_kinematics(THESIS, goal, start=home, method=m) for m in ("newton", method))
    assert same_branch(followed, same, 1e-9)
    assert (same.statistics.method, same.statistics.start) == (method, "guess")


# --- accuracy on demand ---------------------------------------------------------------------------------------------


def test_a_tighter_tolerance_refines_the_mesh() -> None:
    loose = forward_kinematics(CRL, (1.0, 0.0, -1.0), tolerance=1e-8)
    tight = forward_kinematics(CRL, (1.0, 0.0, -1.0), tolerance=1e-11)
    assert loose.mesh_error > 1e-11
    assert tight.mesh_error <= 1e-11
    assert tight.tip_error <= 1e-11
    assert tight.statistics.elements > loose.statistics.elements
    assert loose.tip_rotations == pytest.approx(tight.tip_rotations, abs=1e-10)


@pytest.mark.parametrize("method", METHODS)
def test_refinement_keeps_the_method(method: str) -> None:
    coarse = Discretisation("gauss", 3)
    solved = forward_kinematics(THESIS, (0.0, 1.0, 2.0), method=method, discretisation=coarse, tolerance=1e-7)
    assert solved.mesh_error <= 1e-7
    assert solved.statistics.elements > 2
    assert solved.statistics.method == method


def test_a_tolerance_out_of_reach_is_said_and_the_best_handed_over() -> None:
    midpoint = Discretisation("gauss", 1)
    with pytest.raises(SolveError, match="finest mesh did not reach the tolerance") as caught:
        forward_kinematics(TWO_TUBE, (0.0, 1.0), tolerance=1e-9, discretisation=midpoint)
    best = caught.value.solution
    assert isinstance(best, Equilibrium)
    assert best.statistics.elements == 2 * 2**6
    fine = forward_kinematics(TWO_TUBE, (0.0, 1.0))
    assert best.tip_position == pytest.approx(fine.tip_position, abs=1e-5)
    assert f"the estimated error is {best.mesh_error:.1e} rad, wanted was 1.0e-09 rad" in str(caught.value)


# --- plain results --------------------------------------------------------------------------------------------------


def test_equilibria_pickle() -> None:
    solved = forward_kinematics(THESIS, (0.0, 1.0, 2.0), verify=True)
    copy = pickle.loads(pickle.dumps(solved))
    for name in (*ARRAYS, *ALONG_THE_ARM):
        assert np.array_equal(getattr(copy, name), getattr(solved, name)), name
    for name in ("robot", "margin", "energy", "residual", "status", "statistics", "verification"):
        assert getattr(copy, name) == getattr(solved, name), name


def test_every_array_has_the_shape_that_is_promised() -> None:
    solved = forward_kinematics(THESIS, (0.0, 1.0, 2.0))
    n, m, points = 3, len(solved.arc_length), len(solved.point)
    shapes = {
        "rotations": (n,),
        "translations": (n,),
        "tip_position": (3,),
        "tip_rotation": (3, 3),
        "arc_length": (m,),
        "position": (m, 3),
        "frame": (m, 3, 3),
        "curvature": (m, 2),
        "rotation": (n, m),
        "torsion": (n, m),
        "tip_rotations": (n,),
        "section_start": (3,),
        "tube_end": (n,),
        "point": (points,),
        "point_rotation": (points, n),
        "point_curvature": (0,),
    }
    assert {name: getattr(solved, name).shape for name in (*ARRAYS, *ALONG_THE_ARM)} == shapes
    assert all(getattr(solved, name).dtype == np.float64 for name in (*ARRAYS, *ALONG_THE_ARM))


# --- input that makes no sense --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"rotations": (0, 1)}, "rotations has 2 numbers; it must be 3 numbers (one per tube)"),
        ({"rotations": 0.5}, "rotations is 0.5; it must be 3 numbers (one per tube)"),
        ({"rotations": [[0, 1, 2]]}, "rotations has an array of shape (1, 3); it must be 3 numbers (one per tube)"),
        ({"rotations": (0, np.nan, 1)}, "rotations is [0.0, nan, 1.0]; every number must be finite"),
        ({"rotations": (0, np.inf, 1)}, "rotations is [0.0, inf, 1.0]; every number must be finite"),
        (
            {"rotations": (0, -1e9, 1)},
            "rotations has -1e+09 rad; it must be at most 1000 rad (159 turns) to either side",
        ),
        ({"rotations": ("a", 0, 1)}, "rotations is ('a', 0, 1); it must be 3 numbers (one per tube)"),
        ({"translations": (0, 0)}, "translations has 2 numbers; it must be 3 numbers (one per tube)"),
        ({"translations": (0, 0, np.nan)}, "translations is [0.0, 0.0, nan]; every number must be finite"),
        (
            {"translations": (0, 0.151, 0)},
            "translation of tube 2 is 0.151 m and moves it out of its carriage; it must be at most its "
            "straight_length, 0.15 m",
        ),
        (
            {"translations": (-30, -20, -10)},  # mm, taken for m
            "translation of tube 1 is -30 m, and the tube is 0.4 m long; it must be at least -10 times that: "
            "translations are in m",
        ),
        ({"method": "Newton"}, "method is 'Newton'; it must be one of newton, ipopt, energy; did you mean 'newton'?"),
        ({"tolerance": 0}, "tolerance is 0; it must be greater than 0"),
        ({"tolerance": -1e-8}, "tolerance is -1e-08; it must be greater than 0"),
        ({"tolerance": np.nan}, "tolerance is nan; it must be a finite number"),
    ],
)
def test_impossible_input(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        forward_kinematics(THESIS, **{"rotations": (0, 1, 2), **arguments})
    assert str(caught.value) == message


def test_a_guess_of_another_robot() -> None:
    guess = forward_kinematics(TWO_TUBE, (0.0, 0.5))
    with pytest.raises(InputError, match=r"^start is of a robot with 2 tubes; it must have 3$"):
        forward_kinematics(THESIS, (0.0, 1.0, 2.0), start=guess)


def test_a_start_is_an_equilibrium_or_joint_values() -> None:
    turned, goal = np.radians([90, 0, 0]), np.radians([200, 0, 0])
    followed = forward_kinematics(THESIS, goal, start=forward_kinematics(THESIS, turned))
    cold = forward_kinematics(THESIS, goal)
    assert np.linalg.norm(followed.tip_position - cold.tip_position) > 1e-3  # another branch
    for start in ((turned, None), [turned.tolist(), [0.0, 0.0, 0.0]]):
        assert np.array_equal(forward_kinematics(THESIS, goal, start=start).tip_position, followed.tip_position)
    with pytest.raises(InputError, match=r"^start is 3; it must be an Equilibrium or \(rotations, translations\)$"):
        forward_kinematics(THESIS, goal, start=3)


def test_the_old_name_of_the_start_warns() -> None:
    start, old = forward_kinematics(TWO_TUBE, (0.0, 0.5)), {"guess": forward_kinematics(TWO_TUBE, (0.0, 0.5))}
    with pytest.warns(DeprecationWarning, match="guess= is now start= in forward_kinematics") as caught:
        equilibrium = forward_kinematics(TWO_TUBE, (0.1, 0.5), **old)
    assert caught[0].filename == __file__
    assert np.array_equal(equilibrium.position, forward_kinematics(TWO_TUBE, (0.1, 0.5), start=start).position)
    with pytest.raises(InputError, match="guess and start are the same argument"):
        forward_kinematics(TWO_TUBE, (0.1, 0.5), start=start, **old)


def test_a_guess_of_a_similar_robot_is_a_start_like_any_other() -> None:
    thicker = ConcentricRobot((replace(THESIS.tubes[0], curvature=11.0), *THESIS.tubes[1:]))
    solved = forward_kinematics(thicker, (0.0, 1.0, 2.0), start=forward_kinematics(THESIS, (0.0, 1.0, 2.0)))
    assert solved.robot is thicker
    assert solved.tip_position == pytest.approx(forward_kinematics(thicker, (0.0, 1.0, 2.0)).tip_position, abs=1e-12)


def test_tubes_of_many_kinds_at_once() -> None:
    # Five tubes, one straight, one without straight part, different alloys: a configuration that fits no template.
    tubes = [
        Tube(0.4e-3, 0.0, 0.3, 0.05, 25.0),
        Tube(0.7e-3, 0.5e-3, 0.2, 0.1, 0.0),
        Tube(1.0e-3, 0.8e-3, 0.05, 0.2, -6.0, replace(THESIS.tubes[0].material, shear_modulus=25e9)),
        Tube(1.4e-3, 1.1e-3, 0.0, 0.15, 4.0),
        Tube(1.9e-3, 1.5e-3, 0.02, 0.02, 8.0),
    ]
    robot = ConcentricRobot(tuple(tubes))
    rotations, shift = np.array([2.0, 0.3, -1.0, 0.7, 1.2]), np.array([0.2, 0.1, 0.0, -0.01, 0.02])
    solved = forward_kinematics(robot, rotations, shift)
    reference = shoot(robot, rotations, shift, solved.torsion[:, 0])
    assert solved.tip_position == pytest.approx(reference.tip_position, abs=1e-10)
    assert solved.tip_rotations == pytest.approx(reference.tip_rotations, abs=1e-10)
