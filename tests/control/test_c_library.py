"""The C library of a robot: the answers of Python, clean C, no memory of its own, and a guard that sees snaps."""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.examples import THESIS
from tests.sanitizers import sanitizers
from tubeopt import (
    BundleRobot,
    ConcentricRobot,
    InputError,
    Load,
    Piece,
    SolveError,
    Tube,
    find_load_limit,
    find_snap,
    forward_kinematics,
    load_robot,
)
from tubeopt.bodies.obstacles import Obstacle, Sphere, scene_of
from tubeopt.control.c_binding import CEstimator, CRobot, CServo
from tubeopt.control.c_library import c_library, save_c_library
from tubeopt.control.command import Command, ServoOptions, Why
from tubeopt.control.estimator import BaseReading, EstimatorOptions, StateEstimator, TipReading
from tubeopt.control.servo import Servo
from tubeopt.equilibrium.arm_surface import ArmSurface
from tubeopt.equilibrium.result import Equilibrium
from tubeopt.inverse.joints import joint_space
from tubeopt.robots.robot import Robot
from tubeopt.solvers.compiled.binding import solve_compiled
from tubeopt.solvers.compiled.friction import friction_source
from tubeopt.solvers.compiled.heating import heating_source
from tubeopt.solvers.compiled.library import FLAGS, compile_to, compiler, source
from tubeopt.solvers.compiled.loaded import loaded_source

pytestmark = pytest.mark.skipif(compiler() is None, reason="no C compiler")

TWO_TUBES = load_robot("configs/robots/two_tube.yaml")

PIECES = load_robot("configs/robots/example_pieces.yaml")

ECCENTRIC = load_robot("configs/robots/thesis_etr.yaml")

BUNDLE = load_robot("configs/bundles/steerable_sheath.yaml")

START = ([0.0, 1.0, 2.0], [-0.05, -0.03, -0.02])


@pytest.fixture(scope="module", autouse=True)
def _compiled_in_a_fifth_of_the_time(own_tables: None) -> Iterator[None]:
    """Optimised as little as does: the last -O holds. In a cache of the tests, since users have faster ones."""

    def compile_quickly(text: str, path: Path, flags: Sequence[str]) -> None:
        compile_to(text, path, [*flags, "-Og"])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tubeopt.control.c_binding.compile_to", compile_quickly)
        yield


@pytest.fixture(scope="module")
def thesis() -> CRobot:
    return CRobot(c_library(THESIS, loads=True))


@pytest.fixture(scope="module")
def pieces() -> CRobot:
    return CRobot(c_library(PIECES, loads=True))


def command(target: np.ndarray, **other: float) -> np.ndarray:
    values = {"step": 1e-3, "speed": 0.1, "turn_rate": 3.0, "shift_rate": 0.1, "min_margin": 0.2, "push": 0.0} | other
    step, *rest = values.values()
    return np.concatenate([[step], target, np.zeros(3), rest])


def test_the_library_has_the_answers_of_the_general_solver_and_of_its_derivatives(thesis: CRobot) -> None:
    for q in joint_space(THESIS).sample(8)[:8]:
        rotations, shift = joint_space(THESIS).split(q)
        known = forward_kinematics(THESIS, rotations, shift, method="energy")
        found = thesis.solve(rotations, shift)
        assert found.tip_position == pytest.approx(known.tip_position, abs=1e-9)
        assert found.tip_rotation == pytest.approx(known.tip_rotation, abs=1e-9)
        assert found.margin == pytest.approx(known.margin, abs=1e-8)
        jacobian, slopes = known.jacobian(), thesis.slopes()
        assert slopes.position == pytest.approx(jacobian.position, abs=1e-9)
        assert slopes.rotation == pytest.approx(jacobian.rotation, abs=1e-8)
        assert slopes.tip_rotations == pytest.approx(jacobian.tip_rotations, abs=1e-8)
        assert slopes.margin == pytest.approx(jacobian.margin, abs=1e-5)
        light = forward_kinematics(THESIS, rotations, shift, load=Load(force=(1e-9, 0, 0)))
        assert light.compliance is not None
        assert slopes.compliance == pytest.approx(light.compliance, rel=1e-6, abs=1e-6 * np.abs(light.compliance).max())


@pytest.mark.parametrize("robot", [PIECES, ECCENTRIC, BUNDLE], ids=lambda robot: robot.name)
def test_pieces_and_tubes_off_the_centreline_have_the_answers_and_derivatives_of_python(
    robot: Robot, request: pytest.FixtureRequest
) -> None:
    eccentric = robot is not PIECES
    library = CRobot(c_library(robot)) if eccentric else request.getfixturevalue("pieces")
    space = joint_space(robot)
    # The middle between a corner and the middle of the range has breakpoints that coincide.
    for q in [0.5 * space.inside() + 0.5 * space.middle(), *space.sample(4)]:
        rotations, shift = space.split(q)
        known, found = forward_kinematics(robot, rotations, shift), library.solve(rotations, shift)
        assert found.tip_position == pytest.approx(known.tip_position, abs=1e-9)
        assert found.margin == pytest.approx(known.margin, abs=1e-6)
        jacobian, slopes = known.jacobian(), library.slopes()
        assert (slopes.compliance is None) == eccentric
        same = 1e-5 if eccentric else 1e-9  # differences, or the implicit function theorem
        assert slopes.position == pytest.approx(jacobian.position, abs=same)
        assert slopes.rotation == pytest.approx(jacobian.rotation, rel=2 * same, abs=same)
        assert slopes.tip_rotations == pytest.approx(jacobian.tip_rotations, abs=10 * same)
        assert slopes.margin == pytest.approx(jacobian.margin, abs=100 * same)
    start = library.solve(*space.split(0.5 * space.inside() + 0.5 * space.middle()))
    # With all tubes bending to -y the tip of three equal tubes is as far there as it can be.
    target = start.tip_position + np.array([1e-3, 1e-3, 1e-3])
    for _ in range(300):
        pose, distance, _, _ = library.servo(command(target))
    assert distance < 1e-6
    again = forward_kinematics(robot, pose.rotations, pose.translations)
    assert again.tip_position == pytest.approx(pose.tip_position, abs=1e-9)


def test_a_table_that_varies_quickly_has_the_room_it_needs() -> None:
    """A row every 3 mm with noise needs more pieces of mesh than Python's kernel has room for."""
    noise, s = np.random.default_rng(0).normal(size=(31, 2)), np.linspace(0.0, 0.09, 31)
    table = np.column_stack([8 + 0.1 * noise[:, 0], 0.1 * noise[:, 1], 0 * s])
    inner = Tube.of_pieces(1e-3, 0.8e-3, [Piece(0.03, 12.0), Piece.helix(0.08, 0.014, 0.055)], straight_length=0.12)
    robot = ConcentricRobot([inner, Tube.of_pieces(1.5e-3, 1.2e-3, [Piece.table(s, table)], straight_length=0.03)])
    library, space = CRobot(c_library(robot)), joint_space(robot)
    refused = 0
    for q in space.sample(8)[:8]:
        rotations, shift = space.split(q)
        refused += solve_compiled(robot, rotations, np.array(shift)) is None
        known = forward_kinematics(robot, rotations, shift)
        assert library.solve(rotations, shift).tip_position == pytest.approx(known.tip_position, abs=1e-9)
    assert refused > 0


def test_under_load_it_has_the_answers_of_python_and_its_tip_is_led(thesis: CRobot) -> None:
    library = thesis
    free = library.solve(*START)
    load = Load(force=(5e-3, 1e-2, -3e-3), gravity=(0.0, 0.0, -9.81))
    library.bear(np.array(load.force) / 3)
    for _ in range(2):  # from another load, then as it is
        pose, known = library.bear(load.force, load.gravity), forward_kinematics(THESIS, *START, load=load)
        assert pose.tip_position == pytest.approx(known.tip_position, abs=1e-9)
        assert pose.margin == pytest.approx(known.margin, abs=1e-8)
        assert pose.position[-1] == pytest.approx(known.tip_position, abs=1e-9)
    jacobian, slopes = known.jacobian(), library.slopes()
    assert slopes.position == pytest.approx(jacobian.position, abs=1e-6)
    assert slopes.rotation == pytest.approx(jacobian.rotation, abs=1e-5)
    assert slopes.margin == pytest.approx(jacobian.margin, abs=1e-5)
    assert known.compliance is not None
    assert slopes.compliance == pytest.approx(known.compliance, rel=1e-9)
    target = pose.tip_position + np.array([2e-3, 1e-3, -1e-3])
    for _ in range(400):
        pose, distance, _, _ = library.servo(command(target))
    assert distance < 1e-6
    again = forward_kinematics(THESIS, pose.rotations, pose.translations, load=load)
    assert again.tip_position == pytest.approx(pose.tip_position, abs=1e-9)
    library.follow(*START)
    assert library.bear().tip_position == pytest.approx(free.tip_position, abs=1e-12)
    # Up to the fold that Python finds, and no farther.
    push = np.full(3, 0.1)
    limit = find_load_limit(THESIS, np.radians([200, 0, 0]), np.zeros(3), Load(force=tuple(push)))
    assert limit is not None
    library.solve(np.radians([200, 0, 0]), np.zeros(3))
    borne = library.bear(0.98 * limit.factor * push)
    with pytest.raises(SolveError, match="snap"):
        library.bear(1.02 * limit.factor * push)
    # It bears what it bore.
    again = library.follow(np.radians([200, 0, 0]), np.zeros(3))
    assert again.tip_position == pytest.approx(borne.tip_position, abs=1e-9)
    library.bear()


def test_servo_is_led_under_a_force_that_changes_each_cycle() -> None:
    """Its poses are those of Python under the same force, it reaches its target, and keeps the margin under load."""
    limits = {"turn_acceleration": 30.0, "shift_acceleration": 1.0}
    servo = CServo(c_library(THESIS, loads=True), START, ServoOptions(speed=0.05, min_margin=0.4, **limits))
    arm, target = forward_kinematics(THESIS, *START), servo.equilibrium.tip_position + np.array([4e-3, -3e-3, 1e-3])
    joints = [np.concatenate(START)]
    for k in range(300):
        push = np.array([0.02 * np.sin(k / 150), 0.005 * (k > 100), 0.005])
        servo.bear(push)
        pose = servo.step(Command(position=target), 2e-3).equilibrium
        joints.append(np.concatenate([pose.rotations, pose.translations]))
        if k % 50 == 49:
            load = Load(tuple(push.tolist()))
            arm = forward_kinematics(THESIS, pose.rotations, pose.translations, load=load, start=arm)
            assert pose.tip_position == pytest.approx(arm.tip_position, abs=1e-8)
            assert pose.margin == pytest.approx(arm.margin, abs=1e-4)
    # It lags behind the tip, which the changing force moves by 6 mm/s.
    assert np.linalg.norm(pose.tip_position - target) < 1e-3
    change = np.abs(np.diff(np.array(joints), 2, axis=0)) / 4e-6
    assert (change <= np.repeat([30.0, 1.0], 3) * (1 + 1e-6) + 1e-6).all()
    # Towards a snap under a force it stops at the floor of its margin under load.
    servo = CServo(c_library(THESIS, loads=True), START, ServoOptions(min_margin=0.4, **limits))
    goal, margins = Command(joints=(np.add(START[0], [0.0, -6.0, 0.0]), START[1])), []
    for _ in range(400):
        servo.bear((0.02, 0.005, 0.005))
        margins.append(servo.step(goal, 5e-3).equilibrium.margin)
    assert min(margins) >= 0.4
    assert margins[-1] < 0.41


def test_tubes_made_of_pieces_bear_loads_and_have_a_compliance(pieces: CRobot) -> None:
    robot, library, space, random = PIECES, pieces, joint_space(PIECES), np.random.default_rng(0)
    for q in [0.5 * space.inside() + 0.5 * space.middle(), *space.sample(6)]:
        joints = space.split(q)
        library.solve(*joints)
        light = forward_kinematics(robot, *joints, load=Load(force=(1e-9, 0, 0))).compliance
        assert light is not None
        assert library.slopes().compliance == pytest.approx(light, rel=1e-6, abs=1e-7 * np.abs(light).max())
        push, down = random.normal(size=3), random.normal(size=3) * 9.81
        push *= 0.01 / np.linalg.norm(light[:3, :3] @ push)
        pose = library.bear(push, down)
        known = forward_kinematics(robot, *joints, load=Load(force=tuple(push), gravity=tuple(down)))
        assert pose.tip_position == pytest.approx(known.tip_position, abs=1e-9)
        assert pose.tip_rotation == pytest.approx(known.tip_rotation, abs=1e-9)
        assert pose.tip_rotations == pytest.approx(known.tip_rotations, abs=1e-9)
        assert pose.margin == pytest.approx(known.margin, abs=1e-8)
        assert known.compliance is not None
        slopes, jacobian = library.slopes(), known.jacobian()
        assert slopes.compliance == pytest.approx(known.compliance, rel=1e-6, abs=1e-9 * np.abs(light).max())
        assert slopes.position == pytest.approx(jacobian.position, abs=1e-6)
        assert slopes.rotation == pytest.approx(jacobian.rotation, rel=1e-6, abs=1e-5)
        library.bear()


def test_the_tip_tube_of_tubes_that_end_together_does_not_depend_on_round_off() -> None:
    """The moment of a compliance is on the innermost of them."""
    library, rotations = CRobot(c_library(TWO_TUBES, loads=True)), [0.3, 1.4]
    load = Load(force=(5e-3, 1e-2, -3e-3))
    shift = np.array([0.05 - tube.curved_length for tube in TWO_TUBES.tubes])
    for off in (0.0, 1e-15, -1e-15, 1e-13, -1e-13):
        there = shift + np.array([off, 0.0])
        for push in (None, load):
            known = forward_kinematics(TWO_TUBES, rotations, shift, load=push).compliance
            library.solve(rotations, there)
            if push is not None:
                library.bear(push.force)
            found = library.slopes().compliance
            assert found == pytest.approx(known, rel=1e-6, abs=1e-9 * np.abs(known).max())
            library.bear()


def test_a_bundle_is_solved_to_the_last_bits_and_followed_while_its_ends_change_places() -> None:
    """Three tubes of the thesis: ends pass each other on most motions. Longer ones snap at 210.11 deg."""
    thesis = load_robot("configs/robots/thesis_etr.yaml").bundle()  # type: ignore[attr-defined]
    library, space = CRobot(c_library(thesis)), joint_space(thesis)
    for q in space.sample(6):
        rotations, shift = space.split(q)
        known, found = forward_kinematics(thesis, rotations, shift), library.solve(rotations, shift)
        assert found.tip_position == pytest.approx(known.tip_position, abs=1e-14)
        assert found.margin == pytest.approx(known.margin, abs=1e-12)
    long = BundleRobot((thesis.tubes[0].resized("curved_length", 0.164),) * 3, (1.109e-3,) * 3, thesis.angle)
    library = CRobot(c_library(long))
    library.solve(np.radians([30, 0, 30]), np.zeros(3))
    path = forward_kinematics(long, np.radians([30, 0, 30]))
    for degrees in (60, 120, 180, 205, 209, 210):
        turned = np.radians([30, degrees, 30])
        path = forward_kinematics(long, turned, start=path)
        followed = library.follow(turned, np.zeros(3))
        assert followed.tip_position == pytest.approx(path.tip_position, abs=1e-9)
    with pytest.raises(SolveError, match="would snap"):
        library.follow(np.radians([30, 211, 30]), np.zeros(3))


def test_loads_that_no_library_has_are_refused() -> None:
    for robot in (ECCENTRIC, BUNDLE):
        with pytest.raises(InputError, match="requested; loads on"):
            c_library(robot, loads=True)


def test_derivatives_where_tubes_share_a_carriage_and_end_together() -> None:
    robot = load_robot("configs/robots/example_equal_ends.yaml")
    rotations = np.linspace(0.2, 1.0, robot.n_tubes)
    library = CRobot(c_library(robot))
    library.solve(rotations, robot.home_translations)
    known = forward_kinematics(robot, rotations).jacobian()
    assert library.slopes().position == pytest.approx(known.position, abs=1e-9)


def test_the_branch_is_followed_up_to_the_snap_and_no_farther(thesis: CRobot) -> None:
    # Rotating only the inner tube from 0 the robot snaps at 214.222427 deg (independent shooting).
    thesis.solve(np.zeros(3), np.zeros(3))
    for degree in range(2, 215, 2):
        last = thesis.follow([np.radians(degree), 0, 0], np.zeros(3))
    assert 0 < last.margin < 0.2
    with pytest.raises(SolveError, match="snap"):
        thesis.follow([np.radians(216), 0, 0], np.zeros(3))
    # It stayed where it was.
    again = thesis.follow(last.rotations, last.translations)
    assert again.tip_position == pytest.approx(last.tip_position, abs=1e-12)


def test_a_branch_that_begins_soon_behind_the_end_of_another_is_not_taken_for_it(thesis: CRobot) -> None:
    """Between the fold at 0.487 of the path and the other branch is a gap of half a step; `follow` finds the snap."""
    start = np.array([-1.063867, 2.740718, -4.086733]), np.array([-0.019295, -0.037549, -0.037175])
    goal = np.array([-3.660197, -0.811526, 2.205283]), np.array([0.060833, 0.071768, 0.070282])
    known = find_snap(THESIS, start, goal)
    assert known is not None
    assert known.fraction == pytest.approx(0.4875, abs=1e-3)
    first = thesis.solve(*start)
    with pytest.raises(SolveError, match="snap"):
        thesis.follow(*goal)
    before = [(1 - 0.485) * a + 0.485 * b for a, b in zip(start, goal, strict=True)]
    assert 0 < thesis.follow(*before).margin < first.margin


def test_a_call_follows_at_most_64_steps_of_ordinary_length(thesis: CRobot) -> None:
    """TUBEOPT_TOO_FAR of the header: 64 of 0.3 rad. All tubes turned alike turn the robot as it is."""
    for share in (0.999, 1.001):
        first, turn = thesis.solve(*START), share * 64 * 0.3
        if share > 1:
            with pytest.raises(SolveError, match="longer"):
                thesis.follow(np.add(START[0], turn), START[1])
        else:
            known = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
            there = thesis.follow(np.add(START[0], turn), START[1])
            assert there.tip_position == pytest.approx(known @ first.tip_position, abs=1e-10)


def test_the_shape_of_the_arm_is_that_of_python_from_the_plate_to_the_tip(thesis: CRobot) -> None:
    found, known = thesis.solve(*START), forward_kinematics(THESIS, *START)
    assert found.arc_length == pytest.approx(np.linspace(0, known.arc_length[-1], len(found.arc_length)), abs=1e-12)
    assert found.position == pytest.approx(ArmSurface(known).centreline(found.arc_length), abs=1e-7)
    assert found.position[-1] == pytest.approx(found.tip_position, abs=1e-15)


def test_a_long_motion_into_a_snap_leaves_the_robot_where_it_began(thesis: CRobot) -> None:
    first = thesis.solve(np.zeros(3), np.zeros(3))
    with pytest.raises(SolveError, match="snap"):
        thesis.follow([np.radians(300), 0, 0], np.zeros(3))
    again = thesis.follow(np.zeros(3), np.zeros(3))
    assert again.tip_position == pytest.approx(first.tip_position, abs=1e-12)
    with pytest.raises(SolveError, match="longer"):
        thesis.follow([100.0, 0, 0], np.zeros(3))


def test_the_servo_reaches_its_target_within_rates_and_slides_along_the_floor(thesis: CRobot) -> None:
    last = thesis.solve(*START)
    target = last.tip_position + np.array([4e-3, -3e-3, 2e-3])
    for _ in range(400):
        pose, distance, _, why = thesis.servo(command(target))
        assert np.abs(pose.rotations - last.rotations).max() <= 3e-3 + 1e-12
        assert np.abs(pose.translations - last.translations).max() <= 1e-4 + 1e-12
        last = pose
    assert distance < 1e-6
    reasons = Why(0)
    for _ in range(3000):
        pose, distance, _, why = thesis.servo(command(np.array([-0.2, 0.0, 0.1])))
        reasons |= why
        assert pose.margin >= 0.2
    assert Why.MARGIN in reasons or Why.RANGE in reasons or Why.ORDER in reasons
    known = forward_kinematics(THESIS, pose.rotations, pose.translations)
    assert known.tip_position == pytest.approx(pose.tip_position, abs=1e-9)


def test_the_tip_turns_into_a_direction_as_by_the_servo_of_python(thesis: CRobot) -> None:
    """No faster than it would turn at its speed about a tenth of the robot."""
    seed = forward_kinematics(THESIS, *START)
    options = ServoOptions(speed=0.02, turn_rate=3.0, shift_rate=0.1, min_margin=0.2)
    servo, wanted = Servo(THESIS, thesis_start(thesis), options=options), seed.tip_rotation @ [0.06, -0.04, 1.0]
    target, before = seed.tip_position + np.array([1e-3, 1e-3, 0.0]), np.inf
    most = 0.02 * 1e-3 / (0.1 * max(tube.length for tube in THESIS.tubes))
    for _ in range(170):
        known = servo.step(Command(position=target, direction=wanted), 1e-3)
        row = command(target, speed=0.02)
        row[4:7] = wanted
        pose, distance, angle, why = thesis.servo(row)
        assert pose.tip_position == pytest.approx(known.equilibrium.tip_position, abs=1e-9)
        assert pose.tip_rotation == pytest.approx(known.equilibrium.tip_rotation, abs=1e-8)
        assert (distance, angle) == pytest.approx((known.distance, known.angle), abs=1e-8)
        assert why == known.why
        assert before - angle < 1.01 * most or before == np.inf
        before = angle
    assert angle < 1e-6


def contacts_of(arm: Equilibrium, bodies: Sequence[Obstacle]) -> np.ndarray:
    scene = scene_of(tuple(bodies))
    found = ArmSurface(arm).contacts(scene, 4e-3)
    return np.column_stack([found.arc_length, scene.gradients(found.body, found.point), found.distance])


@pytest.mark.parametrize("which", ["thesis", "pieces"])
def test_among_bodies_the_servo_does_what_that_of_python_does(which: str, request: pytest.FixtureRequest) -> None:
    """It slides along a ball before the tip; the thesis robot also along one beside the end of its second tube."""
    library, robot = request.getfixturevalue(which), THESIS if which == "thesis" else PIECES
    space = joint_space(robot)
    start = START if which == "thesis" else space.split(0.5 * space.inside() + 0.5 * space.middle())
    pose = library.solve(*start)
    seed = forward_kinematics(robot, *start)
    edge = ArmSurface(seed).centreline(seed.tube_end[1:2])[0]
    across = np.array([1.0, 0.0, 0.0]) if which == "thesis" else seed.tip_rotation[:, 0]
    bodies = [Sphere(tuple((seed.tip_position + 6e-3 * across).tolist()), 3e-3)]
    if which == "thesis":
        bodies.append(Sphere(tuple((edge + np.array([5e-3, 0.0, 1e-3])).tolist()), 2e-3))
    options = ServoOptions(speed=0.1, turn_rate=3.0, shift_rate=0.1, min_margin=0.2, clearance=5e-4)
    servo = Servo(robot, (pose.rotations, pose.translations), obstacles=bodies, options=options)
    target, reasons = seed.tip_position + 8e-3 * across, Why(0)
    # After 48 steps the robot of pieces comes to a saddle beside the ball, where round-off decides the side.
    for _ in range(60 if which == "thesis" else 45):
        known = servo.step(Command(position=target), 1e-3)
        here = servo.guard.before.arm
        pose, _, _, why = library.servo(command(target), contacts_of(here, bodies), 5e-4)
        assert pose.tip_position == pytest.approx(known.equilibrium.tip_position, abs=1e-9)
        assert why == known.why
        reasons |= why
        assert min(ArmSurface(known.equilibrium).clearance(scene_of((body,))) for body in bodies) >= 5e-4 - 1e-9
    assert Why.OBSTACLE in reasons
    with pytest.raises(InputError, match="more than it can take"):
        library.servo(command(target), np.zeros((100, 5)))


def test_a_contact_a_hair_before_the_end_of_a_tube_moves_with_the_end(thesis: CRobot) -> None:
    """To less than a nanometre it is the same contact, wherever round-off puts it."""
    seed = forward_kinematics(THESIS, *START)
    end, target = float(seed.tube_end[1]), seed.tip_position + np.array([8e-3, 0.0, 0.0])
    along = seed.frame[np.argmin(np.abs(seed.arc_length - end))][:, 2]
    found = []
    for off in (0.0, -5e-10):
        thesis.solve(*START)
        # A wall whose normal is the tangent there: what brings it closer is that the end advances.
        contact = np.array([[end + off, *-along, 5.2e-4]])
        found.append(thesis.servo(command(target), contact, 5e-4)[0].tip_position)
    assert found[1] == pytest.approx(found[0], abs=1e-9)


def thesis_start(library: CRobot) -> tuple[np.ndarray, np.ndarray]:
    pose = library.solve(*START)
    return pose.rotations, pose.translations


def test_the_servo_goes_on_where_a_tube_is_stopped_by_the_end_of_another(thesis: CRobot) -> None:
    """There derivatives differ to both sides; by those of the wrong one every step loses margin at its floor."""
    thesis.solve(*START)
    for target in ([0.1, 0.1, 0.15], [0.0, -0.1, 0.2], [0.1, 0.0, 0.1]):
        for _ in range(250):
            told = command(np.array(target), step=1e-2, speed=0.06, shift_rate=0.05, min_margin=0.1)
            _, distance, _, why = thesis.servo(told)
            assert Why.HELD not in why
    assert distance < 0.08


def test_a_motion_that_was_not_sent_is_taken_back(thesis: CRobot, pieces: CRobot) -> None:
    eccentric = load_robot("configs/robots/thesis_etr.yaml")
    loaded, home = joint_space(PIECES), joint_space(eccentric)
    for library, joints in (
        (thesis, START),
        (pieces, loaded.split(0.5 * loaded.inside() + 0.5 * loaded.middle())),
        (CRobot(c_library(eccentric)), home.split(0.5 * home.inside() + 0.5 * home.middle())),
    ):
        first = library.solve(*joints)
        if library is pieces:
            first = library.bear((1e-3, 0, 0))
        wanted = command(first.tip_position + np.array([1e-3, -1e-3, 1e-3]))
        moved = library.servo(wanted)[0]
        back = library.undo()
        with pytest.raises(SolveError, match="to return to"):
            library.undo()
        assert np.abs(moved.rotations - first.rotations).max() > 1e-5
        assert back.rotations == pytest.approx(first.rotations, abs=0)
        assert back.tip_position == pytest.approx(first.tip_position, abs=0)
        assert library.servo(wanted)[0].tip_position == pytest.approx(moved.tip_position, abs=1e-8)
        library.undo()
        library.follow(np.add(joints[0], [0.7] + [0] * (len(joints[0]) - 1)), joints[1])
        assert library.undo().tip_position == pytest.approx(first.tip_position, abs=1e-12)
        assert library.follow(*joints).tip_position == pytest.approx(first.tip_position, abs=1e-12)
    pieces.bear()


@pytest.mark.parametrize(("count", "status"), [(-1, 2), (0, 0), (1, 0), (32, 0), (33, 2), (2**31 - 1, 2)])
def test_contacts_are_none_to_32(thesis: CRobot, count: int, status: int) -> None:
    """As a caller in C gives their number; 2 is bad input."""
    first, far = thesis.solve(*START), np.tile([0.05, 1.0, 0.0, 0.0, 0.5], (32, 1))
    thesis.servo(command(first.tip_position), far)
    function, memory, row, _, *others = thesis._calls["servo_among"]
    assert function(memory, row, ctypes.c_int(count), *others) == status
    thesis._in[18] = 8.0  # steps of a search, which knows no contacts of other poses
    assert function(memory, row, ctypes.c_int(count), *others) == 2


def test_bad_input_is_refused(thesis: CRobot) -> None:
    thesis.solve(*START)
    with pytest.raises(InputError, match="finite"):
        thesis.servo(command(np.full(3, np.nan)))
    with pytest.raises(InputError, match="possible"):
        thesis.follow(START[0], [0.5, 0, 0])
    first, n = thesis.solve(*START), 3
    for bad in (np.nan, np.inf, -np.inf, 1e308, -1e308, 1e7, True, "1"):
        for k in range(2 * n):
            joints: list[Any] = [*START[0], *START[1]]
            joints[k] = bad
            for ask in (thesis.solve, thesis.follow):
                with pytest.raises(InputError, match=r"finite|possible|too large|must be 3 numbers"):
                    ask(joints[:n], joints[n:])
        if isinstance(bad, float):
            for k in range(12):
                row = command(first.tip_position)
                row[k] = bad
                with pytest.raises(InputError, match=r"finite|too large"):
                    thesis.servo(row)
            for place in range(5):
                contact = np.array([[0.05, 1.0, 0.0, 0.0, 0.01]])
                contact[0, place] = bad
                with pytest.raises(InputError, match=r"finite|too large"):
                    thesis.servo(command(first.tip_position), contact)
        for key in ("force", "gravity"):
            with pytest.raises(InputError, match=r"finite|too large|must be 3 numbers"):
                thesis.bear(**{key: [0, bad, 0]})
    # None of them has moved it.
    assert thesis.follow(*START).tip_position == pytest.approx(first.tip_position, abs=1e-12)
    for back in (-11 * THESIS.tubes[0].length, -1e6):
        with pytest.raises(InputError, match="withdrawn by 10 of its lengths"):
            thesis.solve(START[0], [back, *START[1][1:]])
    with pytest.raises(InputError, match="prefix is '1a'"):
        c_library(THESIS, prefix="1a")
    eight = ConcentricRobot([Tube(1e-3 * (k + 1), 1e-3 * (k + 0.5), 0.1, 0.05, 1.0) for k in range(8)])
    with pytest.raises(InputError, match="at most 6"):
        c_library(eight)


def test_the_library_is_clean_c99_without_memory_of_its_own_and_passes_its_test(tmp_path: Path) -> None:
    save_c_library(c_library(TWO_TUBES, prefix="pair", loads=True), tmp_path)
    assert "test.c pair_robot.c pair_load.c -lm -o test" in (tmp_path / "README.md").read_text()
    own = compiler()
    assert own is not None
    flags = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-Og", "-fno-pie"]
    for part in ("robot", "load"):
        parts = ["-c", f"pair_{part}.c", "-o", f"{part}.o"]
        subprocess.run([*own, *flags, *parts], cwd=tmp_path, check=True, timeout=240)
    for program in ("test", "example"):
        parts = [f"{program}.c", "robot.o", "load.o", "-lm", "-no-pie", "-o", program]
        subprocess.run([*own, *flags, *parts], cwd=tmp_path, check=True, timeout=60)
        done = subprocess.run([tmp_path / program], capture_output=True, text=True, timeout=300, check=False)
        assert done.returncode == 0, done.stdout
    if shutil.which("nm"):
        names = ["nm", "robot.o", "load.o"]
        table = subprocess.run(names, cwd=tmp_path, capture_output=True, text=True, check=True).stdout
        kinds = {line.split()[-1]: line.split()[-2] for line in table.splitlines() if " " in line}
        assert not [name for name, kind in kinds.items() if kind in "bBdDC"]  # nothing that can be written to
        assert not {"malloc", "calloc", "realloc", "free"} & set(kinds)
        assert all(name.startswith("pair_") for name, kind in kinds.items() if kind == "T")


@pytest.mark.parametrize("robot", [THESIS, PIECES, ECCENTRIC, BUNDLE], ids=lambda robot: robot.name)
def test_it_is_compiled_without_a_warning_as_users_do(robot: Robot, tmp_path: Path) -> None:
    """What users build has no -Werror, since their compiler may know more warnings."""
    own, loads = compiler(), isinstance(robot, ConcentricRobot)
    assert own is not None
    library = c_library(robot, loads=loads)
    assert all(flag in library.files["CMakeLists.txt"] for flag in FLAGS)
    assert "-Werror" not in library.files["CMakeLists.txt"]
    save_c_library(library, tmp_path)
    files = ["tubeopt_robot.c", "example.c", "test.c", *(["tubeopt_load.c"] if loads else [])]
    command = [*own, "-std=c99", *FLAGS, "-Wall", "-Wextra", "-Werror", "-c", *files]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("robot", [TWO_TUBES, THESIS], ids=lambda robot: robot.name)
def test_the_library_reads_and_writes_nothing_beyond_its_arrays(robot: ConcentricRobot, tmp_path: Path) -> None:
    """Sanitizers would end its own test there."""
    own = compiler()
    assert own is not None
    save_c_library(c_library(robot, prefix="arm", loads=True), tmp_path)
    files = ["test.c", "arm_robot.c", "arm_load.c", "-lm", "-o", "test"]
    subprocess.run([*own, "-std=c99", "-w", "-O1", *sanitizers(*own), *files], cwd=tmp_path, check=True, timeout=240)
    done = subprocess.run([tmp_path / "test"], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def preprocessed(text: str, folder: Path) -> str:
    """A C text as a compiler sees it on Windows that is neither gcc nor clang, without the headers of the library; no
    macro is defined twice."""
    own = compiler()
    assert own is not None
    (folder / "tubeopt_robot.h").write_text(c_library(TWO_TUBES).files["tubeopt_robot.h"])
    for name in ("math", "stdlib", "string", "stddef", "stdio", "time"):
        (folder / f"{name}.h").write_text("")
    other = ["-U__GNUC__", "-U__clang__", "-D_WIN32"]
    command = [*own, "-E", "-P", "-Werror", *other, "-nostdinc", "-I", str(folder), "-"]
    return subprocess.run(command, input=text, capture_output=True, text=True, check=True, timeout=60).stdout


def test_c_for_other_compilers_has_no_word_of_gcc(tmp_path: Path) -> None:
    texts = [source(2, False), source(2, True), loaded_source(2), friction_source(2)]
    texts += [
        heating_source(),
        *(text for name, text in c_library(PIECES, loads=True).files.items() if name.endswith(".c")),
    ]
    for text in texts:
        seen = preprocessed(text, tmp_path)
        assert "double " in seen
        words = r"\bclock_gettime\b|\b__(?!declspec)\w+|\b_Complex\b|\btypeof\b|\basm\b|\balloca\b|\bM_PI\b|\(\{"
        assert not re.findall(words, seen)


def test_it_passes_its_test_without_the_vectors_of_gcc(tmp_path: Path) -> None:
    save_c_library(c_library(TWO_TUBES), tmp_path)
    own = compiler()
    assert own is not None
    strict = ["-std=c99", "-pedantic-errors", "-Wall", "-Wextra", "-Werror", "-Wvla", "-Og", "-DTUBEOPT_PORTABLE"]
    subprocess.run(
        [*own, *strict, "test.c", "tubeopt_robot.c", "-lm", "-o", "test"], cwd=tmp_path, check=True, timeout=240
    )
    told = subprocess.run([tmp_path / "test"], capture_output=True, text=True, timeout=300, check=False)
    assert told.returncode == 0, told.stdout
    assert "passed" in told.stdout


RUN_IN_NODE = """
import { readFile } from "node:fs/promises";
import { WASI } from "node:wasi";
const wasi = new WASI({ version: "preview1", args: ["test"] });
const module = await WebAssembly.compile(await readFile(process.argv[2]));
process.exit(wasi.start(await WebAssembly.instantiate(module, wasi.getImportObject())));
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="no Node")
def test_it_passes_its_test_as_web_assembly(tmp_path: Path) -> None:
    pytest.importorskip("ziglang", reason="no ziglang")
    save_c_library(c_library(TWO_TUBES), tmp_path)
    (tmp_path / "run.mjs").write_text(RUN_IN_NODE)
    zig = [sys.executable, "-m", "ziglang", "cc", "--target=wasm32-wasi", "-O2", "-msimd128", "-std=c99"]
    parts = ["-Wall", "-Wextra", "-Werror", "test.c", "tubeopt_robot.c", "-o", "test.wasm"]
    subprocess.run([*zig, *parts], cwd=tmp_path, check=True, timeout=600)
    told = subprocess.run(
        ["node", "--no-warnings", "run.mjs", "test.wasm"], cwd=tmp_path, capture_output=True, text=True
    )
    assert told.returncode == 0, told.stdout + told.stderr
    assert "passed" in told.stdout


def test_the_library_leaves_the_plate_and_comes_back(thesis: CRobot) -> None:
    """From an arm of length zero, where every insertion begins."""
    shift = np.array([-tube.curved_length for tube in THESIS.tubes])
    at = thesis.solve(START[0], shift)
    assert not at.tip_position.any()
    assert not at.position.any()
    assert not at.arc_length.any()
    assert at.margin == 1.0
    known = forward_kinematics(THESIS, START[0], shift).jacobian()
    slopes = thesis.slopes()
    assert slopes.position == pytest.approx(known.position, abs=1e-12)
    assert slopes.rotation == pytest.approx(known.rotation, abs=1e-10)
    there = thesis.follow(START[0], shift + 5e-3)
    cold = forward_kinematics(THESIS, START[0], shift + 5e-3)
    assert there.tip_position == pytest.approx(cold.tip_position, abs=1e-10)
    assert not thesis.follow(START[0], shift).tip_position.any()
    servo = CServo(c_library(THESIS), (START[0], shift))
    for _ in range(20):
        servo.step(Command(velocity=[0, 0, 0.01]), 1e-2)
    assert servo.equilibrium.tip_position[2] == pytest.approx(2e-3, rel=0.1)


def test_estimator_has_the_states_of_that_in_python() -> None:
    """Tip poses that come 30 ms late, and wrenches in time, of a robot whose joints are off, under a force."""
    random, arm = np.random.default_rng(5), forward_kinematics(THESIS, *START)
    python, ours = StateEstimator(arm, EstimatorOptions()), CEstimator(c_library(THESIS, loads=True), START)
    late: list[tuple[float, Any, TipReading]] = []
    surprises = []
    for k in range(8):
        time, joints = 0.01 * k, (np.array(START[0]) + 0.05 * k, np.array(START[1]) + 5e-4 * k)
        truth = forward_kinematics(
            THESIS, joints[0] + 0.01, joints[1] - 3e-4, load=Load((0.02, -0.01, 0.01)), start=arm
        )
        base = BaseReading(truth.base_wrench + random.normal(size=6) * np.repeat([5e-3, 1e-3], 3))
        tip = TipReading(truth.tip_position + random.normal(0, 3e-4, 3), direction=2 * truth.tip_rotation[:, 2])
        late.append((time, joints, tip))
        python.encoders(time, *joints)
        for when, where, reading in [(time, joints, base), *late[max(0, k - 3) : k - 2]]:
            known = python.measured(when, reading)
            surprises.append((ours.measured(when, where, reading), known.surprise))
    estimate, (x, covariance) = python.estimate(), ours.estimate()
    spread = np.sqrt(np.diag(estimate.covariance))
    # Derivatives by differences of first order in C, exact ones in Python.
    assert x / spread == pytest.approx(estimate.state / spread, abs=2e-3)
    assert covariance / np.outer(spread, spread) == pytest.approx(
        estimate.covariance / np.outer(spread, spread), abs=2e-3
    )
    assert np.array(surprises)[:, 0] == pytest.approx(np.array(surprises)[:, 1], rel=1e-2, abs=1e-2)
    assert x[:3] == pytest.approx([0.02, -0.01, 0.01], abs=4 * spread[:3].max())
    far = replace(late[-1][2], position=np.array([0.1, 0.0, 0.0]))
    before = ours.estimate()[0]
    assert ours.measured(0.07, late[-1][1], far) == 0.0  # left out
    assert ours.estimate()[0] == pytest.approx(before, abs=1e-12)
    with pytest.raises(InputError, match="no rotations"):
        ours.measured(0.08, late[-1][1], TipReading((0, 0, 0), rotation=np.eye(3)))
    with pytest.raises(InputError, match="made without loads"):
        CEstimator(c_library(THESIS), START)
    with pytest.raises(InputError, match="stiffness or tip offset"):
        CEstimator(c_library(THESIS), START, EstimatorOptions(tip_offset=1e-3))
