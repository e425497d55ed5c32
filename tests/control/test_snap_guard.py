"""The guard by snap distances: where it lets a robot stop, that nothing snaps on the way, and what it costs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.control.test_servo import of_four
from tests.examples import CRL, THESIS
from tubeopt import ConcentricRobot, Equilibrium, InputError, Load, find_snap, follow, forward_kinematics, load_robot
from tubeopt.control import servo as servo_module
from tubeopt.control.c_binding import CRobot, CServo
from tubeopt.control.c_library import c_library
from tubeopt.control.command import Command, ServoOptions, Why
from tubeopt.control.crtk import FAR_FROM_SNAP, CrtkRobot
from tubeopt.control.servo import Servo
from tubeopt.inverse.joints import joint_space
from tubeopt.solvers.compiled.library import compile_to, compiler
from tubeopt.stability.loaded_distance import LoadedForm
from tubeopt.stability.snap_distance import largest_turn, proved_turn, snap_distance

TWO_TUBES = load_robot("configs/robots/two_tube.yaml")
ROBOTS = {"thesis": THESIS, "crl": CRL, "two": TWO_TUBES, "four": of_four()}
LEAST = np.radians(3.0)
ACCELERATIONS = {"turn_acceleration": 30.0, "shift_acceleration": 1.0}
HOME = np.zeros(3)
C_PRECISION = 0.02  # of a snap distance of the C library


@pytest.fixture(scope="module", autouse=True)
def _compiled_quickly(own_tables: None) -> Iterator[None]:
    def compile_quickly(text: str, path: Path, flags: Sequence[str]) -> None:
        compile_to(text, path, [*flags, "-Og"])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tubeopt.control.c_binding.compile_to", compile_quickly)
        yield


def made(kind: str, robot: ConcentricRobot, start: tuple[np.ndarray, np.ndarray], **options: float) -> Servo | CServo:
    chosen = ServoOptions(speed=0.1, min_snap_distance=LEAST, **options)
    if kind == "c":
        if compiler() is None:
            pytest.skip("no C compiler")
        return CServo(c_library(robot), start, chosen)
    return Servo(robot, start, options=chosen)


@pytest.mark.parametrize(("kind", "commands"), [("c", 52), ("python", 6)])
@pytest.mark.parametrize("name", ROBOTS)
def test_random_commands_never_snap(name: str, kind: str, commands: int) -> None:
    robot = ROBOTS[name]
    space, random = joint_space(robot), np.random.default_rng(len(name))
    goals = space.sample(64)
    begin = next(q for q in (space.split(0.9 * q + 0.1 * space.inside()) for q in goals) if _far(robot, q))
    limits = ACCELERATIONS if kind == "c" else {}
    servo = made(kind, robot, begin, **limits)
    way = [servo.equilibrium]
    for k in range(commands):
        rotations, shift = space.split(goals[random.integers(len(goals))])
        near = way[-1].tip_position + 0.03 * random.normal(size=3)
        command = [
            Command(position=near),
            Command(joints=(rotations, np.array(shift))),
            Command(velocity=0.05 * random.normal(size=3)),
        ][k % 3]
        for _ in range(15):
            way.append(servo.step(command, 5e-3).equilibrium)
    for _ in range(100):
        way.append(servo.step(Command(), 5e-3).equilibrium)
    assert not servo.moving
    distance = servo.snap_distance(LEAST)
    assert distance is not None
    assert distance >= LEAST
    places = [way[0], *way[1::5], way[-1]]
    start = forward_kinematics(robot, way[0].rotations, way[0].translations)
    passed = follow(robot, [at.rotations for at in places], [at.translations for at in places], start=start)
    assert not passed.snaps
    assert passed.equilibria[-1].tip_position == pytest.approx(way[-1].tip_position, abs=1e-7)
    stops = () if limits else passed.equilibria[:: max(1, len(places) // 8)]
    assert all(proved_turn(at, LEAST) >= LEAST for at in stops)


def _far(robot: ConcentricRobot, joints: tuple[np.ndarray, np.ndarray]) -> bool:
    return proved_turn(forward_kinematics(robot, *joints), 2 * LEAST) >= 2 * LEAST


@pytest.mark.parametrize("kind", ["python", "c"])
@pytest.mark.parametrize("limits", [{}, ACCELERATIONS], ids=["at once", "limited"])
def test_tube_stops_where_turns_of_all_tubes_would_snap(kind: str, limits: dict[str, float]) -> None:
    # From home the inner tube snaps at 214.22 deg; all turned by r change its angles as much as it turned by 2 r.
    start = forward_kinematics(THESIS, HOME, HOME)
    goal = np.radians([300.0, 0.0, 0.0]), HOME
    snap = find_snap(THESIS, (start.rotations, HOME), goal, equilibrium=start)
    assert snap is not None
    farthest = snap.rotations[0] - 2 * LEAST
    servo = made(kind, THESIS, (HOME, HOME), min_margin=0.99, **limits)  # a floor that it does not look at
    steps = [servo.step(Command(joints=goal), 5e-3) for _ in range(300)]
    there = forward_kinematics(THESIS, steps[-1].rotations, steps[-1].translations, start=start)
    assert proved_turn(there, LEAST) >= LEAST
    assert proved_turn(there, 1.2 * LEAST) < LEAST
    if kind == "c":  # straight on; in Python other tubes give way, which is closer to the goal
        assert farthest - np.radians(1.0) < steps[-1].rotations[0] < farthest
        assert Why.HELD in steps[-1].why
    assert steps[-1].equilibrium.margin < 0.98
    back = [servo.step(Command(joints=(HOME, HOME)), 5e-3) for _ in range(360)]
    assert back[-1].rotations == pytest.approx(HOME, abs=1e-9)


def test_steps_within_a_ball_need_no_proof(monkeypatch: pytest.MonkeyPatch) -> None:
    proofs = []

    def counted(*arguments: float) -> float:
        proofs.append(arguments)
        return proved_turn(*arguments)

    monkeypatch.setattr(servo_module, "proved_turn", counted)
    servo = made("python", THESIS, (HOME, HOME))
    for _ in range(100):
        servo.step(Command(joints=(np.array([0.7, -0.7, 0.0]), HOME)), 5e-3)
    assert servo.equilibrium.rotations == pytest.approx([0.7, -0.7, 0.0], abs=1e-9)
    assert len(proofs) < 10  # 47 steps of 0.015 rad


@pytest.mark.parametrize("kind", ["python", "c"])
def test_snap_distance_is_reported(kind: str) -> None:
    # At 200 deg 7.1079 deg can be proved, and the nearest snap is at 7.1112 deg; at home 80.5 deg are proved.
    start = forward_kinematics(THESIS, HOME, HOME)
    turned = follow(THESIS, [HOME, np.radians([200.0, 0, 0])], [HOME, HOME], start=start).equilibria[-1]
    servo = made(kind, THESIS, (HOME, HOME))
    robot = CrtkRobot(servo)
    assert robot.snap_distance() == FAR_FROM_SNAP
    servo.resume((turned.rotations, HOME))
    distance = robot.snap_distance()
    assert distance is not None
    assert 6.9 < np.degrees(distance) < 7.1113


@pytest.mark.parametrize("name", ROBOTS)
def test_time_within_which_nothing_snaps(name: str) -> None:
    if compiler() is None:
        pytest.skip("no C compiler")
    robot, space = ROBOTS[name], joint_space(ROBOTS[name])
    drawn = (space.split(q) for q in space.sample(64)[3:])
    joints = next(q for q in drawn if snap_distance(forward_kinematics(robot, *q)).turn < 2.0)
    arm = CRobot(c_library(robot))
    arm.solve(*joints)
    seconds = snap_distance(forward_kinematics(robot, *joints)).time(2.0, 0.05)
    found = arm.snap_time(2.0, 0.05, 100.0)
    assert found is not None
    # Both are proofs; near the limit the iterations find other boxes.
    assert 0.95 * seconds < found < 1.03 * seconds
    assert arm.snap_time(2.0, 0.05, 0.9 * seconds) == 0.9 * seconds
    turns = arm.snap_distance(3.0)
    assert turns is not None
    assert found * 2.0 < turns


def test_starts_too_close_to_a_snap_are_refused() -> None:
    start = forward_kinematics(THESIS, HOME, HOME)
    turned = follow(THESIS, [HOME, np.radians([212.0, 0, 0])], [HOME, HOME], start=start).equilibria[-1]
    with pytest.raises(InputError, match="snap distance below min_snap_distance, 3 deg"):
        made("python", THESIS, turned)
    with pytest.raises(InputError, match="min_snap_distance is 4 rad"):
        ServoOptions(min_snap_distance=4.0)


# --- Under a load -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def loaded() -> tuple[CRobot, Equilibrium]:
    """A C library under a load, and its equilibrium in Python."""
    if compiler() is None:
        pytest.skip("no C compiler")
    rotations, translations, force = [3.0, -0.3, 0.2], [-0.01, -0.005, 0.0], (4e-3, -6e-3, 3e-3)
    arm = CRobot(c_library(THESIS, loads=True))
    arm.solve(rotations, translations)
    arm.bear(force)
    return arm, forward_kinematics(THESIS, rotations, translations, load=Load(force))


def test_c_proves_the_turn_under_a_load_that_python_proves(loaded: tuple[CRobot, Equilibrium]) -> None:
    arm, start = loaded
    released = forward_kinematics(THESIS, start.rotations, start.translations)
    most = proved_turn(released, np.pi, C_PRECISION)
    turn, _ = largest_turn(LoadedForm.of(start), most, C_PRECISION)
    assert 0.05 < turn < most < np.pi
    assert start.margin < 0.99  # with others Python refines its mesh
    assert arm.snap_distance(np.pi) == pytest.approx(turn, abs=1e-9)
    assert arm.snap_distance(turn / 2) == turn / 2


def test_no_motion_in_a_ball_under_a_load_snaps(loaded: tuple[CRobot, Equilibrium]) -> None:
    arm, start = loaded
    turn, random = arm.snap_distance(np.pi), np.random.default_rng(2)
    assert turn is not None
    for _ in range(60):
        by = random.choice([-1.0, 1.0, random.uniform(-1, 1)], start.robot.n_tubes)
        arm.follow(start.rotations + turn * by, start.translations)
    back = arm.follow(start.rotations, start.translations)
    assert back.tip_position == pytest.approx(start.tip_position, abs=1e-8)


def test_the_servo_stops_before_a_snap_under_a_measured_force() -> None:
    if compiler() is None:
        pytest.skip("no C compiler")
    options = ServoOptions(min_margin=0.99, min_snap_distance=LEAST)  # a floor of the margin that it does not look at
    servo = CServo(c_library(THESIS, loads=True), (np.radians([150.0, 0.0, 0.0]), HOME), options)
    for k in range(90):  # without a guard the inner tube snaps at 214 deg
        servo.bear((1e-3, 1e-3 * np.sin(0.1 * k), 0.0))
        servo.step(Command(joints=(np.radians([300.0, 0.0, 0.0]), HOME)), 5e-3)
    assert 195.0 < np.degrees(servo.equilibrium.rotations[0]) < 208.3
    assert servo.equilibrium.margin < 0.98
    distance = servo.snap_distance(LEAST)
    assert distance is not None
    assert distance > 0.9 * LEAST  # the force has changed since it stopped
