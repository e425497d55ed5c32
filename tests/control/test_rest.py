"""Out of reach, and with limited accelerations: the robot comes to rest, within its limits, as close as it can."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.examples import CRL, THESIS
from tubeopt import (
    ConcentricRobot,
    InputError,
    Sphere,
    find_equilibria,
    follow,
    forward_kinematics,
    inverse_kinematics,
    load_robot,
)
from tubeopt.bodies.obstacles import scene_of
from tubeopt.control.c_binding import CServo
from tubeopt.control.c_library import c_library
from tubeopt.control.command import Command, ServoOptions, ServoStep, Why
from tubeopt.control.crtk import CrtkRobot
from tubeopt.control.lookahead import PredictiveServo
from tubeopt.control.servo import Servo
from tubeopt.equilibrium.arm_surface import ArmSurface
from tubeopt.inverse.joints import joint_space
from tubeopt.solvers.compiled.library import compile_to, compiler

TWO_TUBES = load_robot("configs/robots/two_tube.yaml")
START = ([0.0, 1.0, 2.0], [-0.05, -0.03, -0.02])
ACCELERATIONS = {"turn_acceleration": 30.0, "shift_acceleration": 1.0}
ROUNDING = 1e-9


@pytest.fixture(scope="module", autouse=True)
def _compiled_quickly(own_tables: None) -> Iterator[None]:
    def compile_quickly(text: str, path: Path, flags: Sequence[str]) -> None:
        compile_to(text, path, [*flags, "-Og"])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tubeopt.control.c_binding.compile_to", compile_quickly)
        yield


def made(kind: str, robot: ConcentricRobot, start: tuple[Sequence[float], Sequence[float]], **options: float) -> object:
    if kind == "c":
        if compiler() is None:
            pytest.skip("no C compiler")
        return CServo(c_library(robot), start, ServoOptions(**options))
    kinds = {"python": Servo, "predictive": PredictiveServo}
    return kinds[kind](robot, start, options=ServoOptions(**options))


def joints_of(steps: Sequence[ServoStep]) -> np.ndarray:
    return np.array([np.concatenate([step.rotations, step.translations]) for step in steps])


def reversals(joints: np.ndarray) -> int:
    """Largest number of changes of the sign of a joint's motion."""
    moved = np.diff(joints, axis=0)
    return max(int((np.diff(np.sign(column[np.abs(column) > 1e-9])) != 0).sum()) for column in moved.T)


@pytest.mark.parametrize("kind", ["python", "c", "predictive"])
@pytest.mark.parametrize("away", [(0.3, 0.1, 0.3), (-0.1, 0.3, 0.3)])
def test_robot_rests_where_target_is_out_of_reach(kind: str, away: tuple[float, float, float]) -> None:
    dt, count = (5e-3, 1200) if kind != "predictive" else (0.02, 400)
    servo = made(kind, THESIS, START, speed=0.2, shift_rate=0.2)
    steps = [servo.step(Command(position=away), dt) for _ in range(count)]
    joints = joints_of(steps)[-count // 3 :]
    assert reversals(joints) < 5
    assert np.abs(np.diff(joints, axis=0)).max() < 1e-6
    last = steps[-1]
    assert Why.NO_CLOSER in last.why
    assert "no small motion" in last.why.text
    # Inverse kinematics from there finds no closer place either.
    start = forward_kinematics(THESIS, last.rotations, last.translations)
    known = inverse_kinematics(THESIS, away, start=start, on_failure="closest", min_margin=0.1)
    assert np.linalg.norm(known.equilibrium.tip_position - away) > last.distance - 1e-4


@pytest.mark.parametrize("kind", ["python", "c"])
@pytest.mark.parametrize(("robot", "start"), [(THESIS, START), (TWO_TUBES, None)], ids=["thesis", "two"])
def test_accelerations_are_kept_to_target_and_back_to_rest(
    kind: str, robot: ConcentricRobot, start: tuple[list[float], list[float]] | None
) -> None:
    space = joint_space(robot)
    begin = start or space.split(0.5 * space.inside() + 0.5 * space.middle())
    servo = made(kind, robot, begin, speed=0.1, **ACCELERATIONS)
    first, dt, n = servo.equilibrium, 1e-3, robot.n_tubes
    targets = [first.tip_position + np.array([4e-3, 3e-3, 2e-3]), np.array([0.3, 0.0, 0.2]), first.tip_position]
    steps = [servo.step(Command(position=target), dt) for target in targets for _ in range(700)]
    if len(steps[-1].rotations) == 3:
        assert steps[699].distance < 1e-6
    steps += [servo.step(Command(), dt) for _ in range(200)]
    joints = joints_of(steps)
    joints = np.vstack([np.concatenate([first.rotations, first.translations]), joints])
    speed = np.vstack([np.zeros(2 * n), np.diff(joints, axis=0) / dt])
    change = np.abs(np.diff(speed, axis=0)) / dt
    assert change[:, :n].max() <= ACCELERATIONS["turn_acceleration"] * (1 + ROUNDING) + 1e-6
    assert change[:, n:].max() <= ACCELERATIONS["shift_acceleration"] * (1 + ROUNDING) + 1e-6
    assert change[:, :n].max() > 0.9 * ACCELERATIONS["turn_acceleration"]
    assert np.abs(speed[:, :n]).max() <= 3.0 * (1 + ROUNDING)
    assert np.abs(speed[:, n:]).max() <= 0.05 * (1 + ROUNDING)
    assert not servo.moving
    assert np.abs(speed[-1]).max() < 1e-9
    assert min(step.equilibrium.margin for step in steps) > 0.1 - 0.01


@pytest.mark.parametrize("kind", ["python", "c"])
def test_joints_speed_up_and_brake_straight_to_their_goal(kind: str) -> None:
    servo = made(kind, THESIS, START, **ACCELERATIONS)
    goal = np.array([0.4, 0.9, 2.0]), np.array([-0.049, -0.03, -0.02])
    joints = joints_of([servo.step(Command(joints=goal), 1e-3) for _ in range(400)])
    assert joints[-1] == pytest.approx(np.concatenate(goal), abs=1e-9)
    turned = joints[:, 0]
    # 0.4 rad at 30 rad/s^2 and 3 rad/s take 0.4 / 3 + 3 / 30 s.
    assert np.argmax(turned > 0.4 - 1e-3) == pytest.approx(233, abs=12)
    assert np.diff(turned).min() >= -1e-12
    assert np.abs(np.diff(turned, 2)).max() <= 30.0 * 1e-6 * (1 + ROUNDING)


@pytest.mark.parametrize("kind", ["python", "c"])
def test_order_is_kept_where_two_carriages_come_to_rest_together(kind: str) -> None:
    space = joint_space(CRL)
    start = (
        [-0.7221811371031275, -0.21967890611963892, 1.8970381766488753],
        [
            0.10236712003685536,
            0.037984955352731054,
            0.008506021434441208,
        ],
    )
    away = 0.05186569732575018, 0.11620690802376515, 0.047461386442277
    servo = made(kind, CRL, start, **ACCELERATIONS)
    joints = joints_of([servo.step(Command(position=away), 4e-3) for _ in range(310)])
    slack = joints @ space.rows.T - space.row_lower
    assert slack.min() < 1e-9  # they touch
    assert slack.min() > -1e-12


@pytest.mark.parametrize("kind", ["python", "c"])
def test_moving_target_is_tracked_while_a_transition_crosses_the_plate(kind: str) -> None:
    """There steps miss by the target's motion in a cycle, and no more: damping let it run away by 122 um."""
    start = [-0.15278, 0.71703, 1.89317], [-0.049593, -0.042526, 0.000267]
    servo, motion = made(kind, THESIS, start, speed=0.1, shift_rate=0.1), np.array([0.01237, 0.00268, -0.00925]) * 1e-3
    target, lags = servo.equilibrium.tip_position, []
    for _ in range(56):
        target = target + motion
        servo.step(Command(position=target), 1e-3)
        lags.append(np.linalg.norm(servo.equilibrium.tip_position - target))
    assert max(lags) > 0.5 * np.linalg.norm(motion)  # the transition is at the plate
    assert max(lags) < 1.01 * np.linalg.norm(motion)


@pytest.mark.skipif(compiler() is None, reason="no C compiler")
def test_undone_step_gives_the_speed_back() -> None:
    servo = made("c", THESIS, START, **ACCELERATIONS)
    target = Command(position=servo.equilibrium.tip_position + np.array([5e-3, 0.0, 0.0]))
    for _ in range(30):
        servo.step(target, 1e-3)
    before = servo.equilibrium
    there = servo.step(target, 1e-3).equilibrium
    servo.undo()
    assert servo.equilibrium is before
    assert servo.step(target, 1e-3).rotations == pytest.approx(there.rotations, abs=1e-9)


@pytest.mark.parametrize("kind", ["python", "c"])
def test_motion_of_objective_comes_to_rest(kind: str) -> None:
    space = joint_space(CRL)
    q = next(
        q
        for q in space.sample(16)
        if 0.3 < forward_kinematics(CRL, *space.split(0.8 * q + 0.2 * space.inside())).margin < 0.9
    )
    start = space.split(0.8 * q + 0.2 * space.inside())
    servo = made(kind, CRL, start, objective="margin")
    target, first = servo.equilibrium.tip_position, servo.equilibrium.margin
    steps = [servo.step(Command(position=target), 5e-3) for _ in range(900)]
    assert steps[-1].equilibrium.margin > first
    assert steps[-1].distance < 1e-5
    assert np.abs(np.diff(joints_of(steps[-50:]), axis=0)).max() < 1e-5


@pytest.mark.parametrize("kind", ["python", "c"])
def test_server_brakes_when_commands_stop(kind: str) -> None:
    """Watchdog, disable and release bring a moving robot to rest within its accelerations."""
    servo = made(kind, THESIS, START, **ACCELERATIONS)
    arm, now, dt = CrtkRobot(servo), 0.0, 1e-3
    place = (servo.equilibrium.tip_position + np.array([0.01, 0.0, 0.0])).tolist()
    joints = []
    arm.command({"op": "state_command", "command": "enable"}, now)
    for k in range(400):
        if k < 60:
            arm.command({"op": "servo_cp", "position": place}, now)
        arm.tick(lambda: now, dt)  # noqa: B023
        now += dt
        joints.append(np.concatenate([arm.servo.equilibrium.rotations, arm.servo.equilibrium.translations]))
    speed = np.diff(np.array(joints), axis=0) / dt
    assert np.abs(speed[60]).max() > 0.1
    assert np.abs(np.diff(speed[:, :3], axis=0)).max() / dt <= ACCELERATIONS["turn_acceleration"] * (1 + 1e-6)
    assert np.abs(speed[-1]).max() == 0


def test_hold_home_and_relative_joints_of_the_server() -> None:
    servo = made("python", THESIS, START, **ACCELERATIONS)
    arm, clock = CrtkRobot(servo), iter(np.arange(1, 100_000) * 1e-3 / 2)

    def tick(count: int) -> None:
        for _ in range(count):
            arm.tick(lambda: float(next(clock)), 1e-3)

    turn, stay = {"rotations": [0.05, 0.0, 0.0], "translations": [0.0] * 3}, {"rotations": [0.0] * 3}
    arm.command({"op": "state_command", "command": "enable"}, 0.0)
    arm.command({"op": "state_command", "command": "unhome"}, 0.0)
    assert arm.report(0.0)["operating_state"]["is_homed"] is False
    with pytest.raises(InputError, match="the robot is not homed"):
        arm.command({"op": "move_jr", **turn}, 0.0)
    arm.command({"op": "state_command", "command": "home"}, 0.0)
    with pytest.raises(InputError, match="translations"):
        arm.command({"op": "move_jr", **stay}, 0.0)
    arm.command({"op": "move_jr", **turn}, 0.0)
    assert arm.busy
    tick(300)
    assert not arm.busy
    assert arm.servo.equilibrium.rotations == pytest.approx([0.05, 1.0, 2.0], abs=1e-6)
    arm.command({"op": "move_jr", **turn}, 0.2)
    tick(20)
    arm.command({"op": "hold"}, 0.2)
    assert not arm.busy
    tick(100)
    assert not arm.servo.moving
    assert 0.05 < arm.servo.equilibrium.rotations[0] < 0.1 - 1e-3
    assert arm.report(0.3)["why"] == "stopped by command"


# At home the transitions of both tubes are at the plate, where the distance has a kink. The translation alone brings
# the tip no closer there, but rotations do.
KINK = ([2.8692, -0.122], [0.0041, 0.0041]), (-0.0019, -0.0813, 0.0402)

# Where the servo rests, the tip is 22 mm farther from the target than the pose that `ik --closest` finds.
MINIMUM = ([0.234, 0.613, -2.701], [-0.0393, -0.0424, -0.0699]), (0.0367, -0.3115, -0.2274)


def led_to_closest(servo: Servo | CServo, position: Sequence[float], dt: float) -> tuple[list[ServoStep], float]:
    """Steps until the robot rests after its search, and distance (m) from the target where it rested before."""
    command, steps, rest, still = Command(position=position, closest=True), [], np.nan, 0
    while still < 20:
        steps.append(servo.step(command, dt))
        assert len(steps) < 8000
        why = steps[-1].why
        still = still + 1 if Why.NO_CLOSER in why and Why.SEEKING not in why else 0
        if np.isnan(rest) and Why.SEEKING in why:
            rest = steps[-1].distance
    return steps, rest


@pytest.fixture
def few_trials(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four scouts a search in Python: from MINIMUM, one of them comes closer."""
    monkeypatch.setattr("tubeopt.control.closest.TRIALS", 4)


@pytest.fixture
def one_trial(monkeypatch: pytest.MonkeyPatch) -> None:
    """One scout a search in Python."""
    monkeypatch.setattr("tubeopt.control.closest.TRIALS", 1)


@pytest.mark.usefixtures("few_trials")
@pytest.mark.parametrize("kind", ["python", "c"])
def test_search_leads_from_a_local_minimum_to_the_closest_pose(kind: str) -> None:
    start, target = MINIMUM
    servo, dt = made(kind, THESIS, start, speed=0.5, shift_rate=0.5, **ACCELERATIONS), 1e-2
    first = servo.equilibrium
    steps, rest = led_to_closest(servo, target, dt)
    found = inverse_kinematics(THESIS, target, min_margin=0.1, on_failure="closest")
    assert steps[-1].distance < rest - 0.02
    assert steps[-1].distance < found.position_error + 1e-4
    q = np.vstack([np.concatenate([first.rotations, first.translations]), joints_of(steps)])
    passed = follow(THESIS, *np.split(q[::5], 2, axis=1), start=forward_kinematics(THESIS, *start))
    assert not passed.snaps
    assert min(step.equilibrium.margin for step in steps) > 0.1
    change = np.abs(np.diff(q, 2, axis=0)) / dt**2
    assert (change <= np.repeat([30.0, 1.0], 3) * (1 + ROUNDING) + 1e-6).all()
    assert np.abs(np.diff(q, axis=0))[:, :3].max() <= 3.0 * dt * (1 + ROUNDING)


def test_scouts_turn_in_the_other_direction_at_the_end_of_a_range() -> None:
    """The closest pose is behind the end of the range of a tube, and by a whole turn less within it."""
    start, target = ([-2 * np.pi, -0.938, -0.6], [0.05, 0.0, -0.05]), (-0.1273, -0.1932, 0.1394)
    servo = made("c", THESIS, start, speed=0.5, shift_rate=0.5, **ACCELERATIONS)
    steps, rest = led_to_closest(servo, target, 1e-2)
    assert rest == pytest.approx(0.096, abs=1e-4)
    found = inverse_kinematics(THESIS, target, min_margin=0.1, on_failure="closest")
    assert steps[-1].distance == pytest.approx(found.position_error, abs=1e-6)
    assert steps[-1].rotations[0] > -np.pi


@pytest.mark.usefixtures("one_trial")
@pytest.mark.parametrize("kind", ["python", "c"])
def test_robot_stays_where_no_scout_comes_closer(kind: str) -> None:
    servo = made(kind, TWO_TUBES, KINK[0], speed=0.2, shift_rate=0.2)
    steps, rest = led_to_closest(servo, KINK[1], 4e-3)
    assert steps[-1].distance == pytest.approx(rest, abs=1e-6)
    last = steps[-1]
    assert np.array_equal(servo.step(Command(position=KINK[1], closest=True), 4e-3).rotations, last.rotations)


def test_search_ends_where_the_robot_returns_to_its_rest() -> None:
    """Scouts find poses 20 um closer whose margin is in the room above the floor, which the robot leaves again."""
    servo = made("c", TWO_TUBES, ([-0.497, 2.231], [0.0303, 0.0303]), speed=0.2, shift_rate=0.2, **ACCELERATIONS)
    seeks = [Why.SEEKING in step.why for step in led_to_closest(servo, (0.0004, 0.0084, 0.1236), 2e-2)[0]]
    assert sum(np.diff(np.array(seeks, dtype=int)) == 1) == 2


@pytest.mark.usefixtures("one_trial")
@pytest.mark.parametrize("kind", ["python", "c"])
def test_new_target_ends_the_search(kind: str) -> None:
    start, target = MINIMUM
    servo = made(kind, THESIS, start, speed=0.5, shift_rate=0.5)
    while Why.SEEKING not in servo.step(Command(position=target, closest=True), 5e-3).why:
        pass
    near = servo.equilibrium.tip_position + np.array([0.0, 0.005, 0.002])
    steps = [servo.step(Command(position=near, closest=True), 5e-3) for _ in range(200)]
    assert not any(Why.SEEKING in step.why for step in steps[:20])
    assert steps[-1].distance < 1e-6


@pytest.mark.usefixtures("one_trial")
@pytest.mark.parametrize("kind", ["python", "c"])
def test_moves_to_targets_within_reach_are_the_same_with_search(kind: str) -> None:
    one, two = (made(kind, THESIS, START, **ACCELERATIONS) for _ in range(2))
    target = one.equilibrium.tip_position + np.array([5e-3, -3e-3, 2e-3])
    for _ in range(150):
        plain, seeking = (s.step(Command(position=target, closest=s is two), 2e-3) for s in (one, two))
        assert seeking.rotations == pytest.approx(plain.rotations, abs=1e-12)
        assert seeking.translations == pytest.approx(plain.translations, abs=1e-12)
        assert plain.why == seeking.why


@pytest.mark.usefixtures("few_trials")
def test_search_keeps_clear_of_bodies() -> None:
    """The way of the scout, and so that of the robot, keeps the clearance of a body beside it."""
    start, target = MINIMUM
    body = Sphere((-0.03, -0.05, 0.1), 0.02)
    servo = Servo(THESIS, start, obstacles=[body], options=ServoOptions(speed=0.5, shift_rate=0.5, clearance=1e-3))
    steps, rest = led_to_closest(servo, target, 5e-3)
    assert steps[-1].distance < rest - 0.02
    scene = scene_of([body])
    for step in steps[::10]:
        assert ArmSurface(step.equilibrium).clearance(scene, 1.0) > 1e-3 - 1e-6


@pytest.mark.usefixtures("few_trials")
def test_move_of_the_server_ends_at_the_closest_pose() -> None:
    start, target = MINIMUM
    arm, clock = CrtkRobot(made("c", THESIS, start, speed=0.5, shift_rate=0.5)), [0.0]
    arm.command({"op": "state_command", "command": "enable"}, 0.0)
    arm.command({"op": "move_cp", "position": list(target), "closest": True}, 0.0)
    while arm.busy:
        clock[0] += 5e-3
        arm.tick(lambda: clock[0], 5e-3)
    end = float(np.linalg.norm(arm.servo.equilibrium.tip_position - target))
    assert end == pytest.approx(0.38742, abs=1e-4)
    assert arm.events[-1] == ("status", f"the closest pose found is {end * 1e3:.3g} mm away")


def test_closest_is_true_or_false_and_for_positions() -> None:
    arm = CrtkRobot(made("python", THESIS, START))
    arm.command({"op": "state_command", "command": "enable"}, 0.0)
    with pytest.raises(InputError, match="closest is 1; it must be true or false"):
        arm.command({"op": "move_cp", "position": [0, 0, 0.1], "closest": 1}, 0.0)
    with pytest.raises(InputError, match="closest is for a position"):
        Command(direction=(0, 0, 1), closest=True)
    with pytest.raises(InputError, match="look-ahead"):
        PredictiveServo(THESIS, START).step(Command(position=(0, 0, 0.1), closest=True), 0.02)


@pytest.mark.parametrize(("kind", "count"), [("python", 300), ("c", 3000)])
def test_accelerations_are_kept_whatever_is_commanded(kind: str, count: int) -> None:
    """Positions, directions, velocities, joints and nothing in turn, at cycles of different lengths."""
    random, space = np.random.default_rng(1), joint_space(CRL)
    servo = made(kind, CRL, space.split(0.5 * space.inside() + 0.5 * space.middle()), speed=0.1, **ACCELERATIONS)
    goals, command, last = space.sample(16), Command(), np.zeros(6)
    most = np.repeat([ACCELERATIONS["turn_acceleration"], ACCELERATIONS["shift_acceleration"]], 3)
    for k in range(count):
        here = servo.equilibrium
        if k % 15 == 0:
            rotations, shift = space.split(goals[random.integers(len(goals))])
            command = [
                Command(position=here.tip_position + 0.02 * random.normal(size=3)),
                Command(position=here.tip_position, direction=random.normal(size=3)),
                Command(velocity=0.05 * random.normal(size=3)),
                Command(joints=(rotations, np.array(shift))),
                Command(),
            ][random.integers(5)]
        dt = float(random.choice([1e-3, 2e-3, 3e-4]))
        step = servo.step(command, dt)
        speed = np.concatenate([step.rotations - here.rotations, step.translations - here.translations]) / dt
        assert (np.abs(speed - last) <= most * dt * (1 + ROUNDING) + 1e-10).all()
        assert np.abs(speed[:3]).max() <= 3.0 + 1e-9
        assert np.abs(speed[3:]).max() <= 0.05 + 1e-9
        assert not space.outside(space.join(step.rotations, step.translations))
        last = speed


@pytest.mark.parametrize("kind", ["python", "c"])
def test_robot_rests_at_kink_only_where_no_rotation_brings_it_closer(kind: str) -> None:
    start, away = KINK
    servo = made(kind, TWO_TUBES, start, speed=0.2, shift_rate=0.2, **ACCELERATIONS)
    steps = [servo.step(Command(position=away), 4e-3) for _ in range(1500)]
    assert reversals(joints_of(steps)[-500:]) == 0
    assert np.abs(steps[-1].translations).max() < 1e-6
    known = inverse_kinematics(TWO_TUBES, away, start=start, on_failure="closest", min_margin=0.1)
    best = np.linalg.norm(known.equilibrium.tip_position - away)
    assert steps[-1].distance < best + 1e-5
    # A rotation by 0.1 rad from there takes the tip farther away.
    for turn in np.array([[0.1, 0], [-0.1, 0], [0, 0.1], [0, -0.1]]):
        beside = forward_kinematics(TWO_TUBES, steps[-1].rotations + turn, steps[-1].translations)
        assert np.linalg.norm(beside.tip_position - away) > steps[-1].distance


@pytest.mark.parametrize("kind", ["python", "c"])
def test_robot_rests_close_to_the_floor_of_the_margin(kind: str) -> None:
    """It moves 0.01 above it while steps are long; it rested there, 0.104 mm farther from its target."""
    start = [0.6011834168338335, -0.32028439685643484], [0.015783632639795556, 0.015783632639795556]
    away = -0.01595722670807312, 0.018149370922479605, 0.12650156509664945
    servo = made(kind, TWO_TUBES, start, speed=0.2, shift_rate=0.2, **ACCELERATIONS)
    steps = [servo.step(Command(position=away), 4e-3) for _ in range(450)]
    assert Why.MARGIN | Why.NO_CLOSER in steps[-1].why
    margins = [step.equilibrium.margin for step in steps]
    assert min(margins) >= 0.1
    assert margins[-1] < 0.106
    # 5.72826 mm is what `ik --closest` finds with this margin.
    assert steps[-1].distance < 5.72826e-3 + 6e-5


def test_braking_is_checked_where_breakpoints_meet(monkeypatch: pytest.MonkeyPatch) -> None:
    """On the straight motion the margin is 0.142 and 0.105 at the ends, and 0.037 where two transitions meet.

    A braking robot leaves it and snaps there, between places where the equilibrium continues.
    """
    robot = load_robot("endonasal_ctr")
    ends = np.array(
        [
            [2.45165327, -0.35407801, 2.97857368, 0.0414044, 0.04142613, 0.04179659],
            [2.45256541, -0.35641444, 2.98117225, 0.04210707, 0.04139303, 0.04153152],
        ]
    )
    start = next(arm for arm in find_equilibria(robot, *np.split(ends[0], 2)) if 0.14 < arm.margin < 0.15)
    path = np.linspace(*ends, 41)
    margins = [arm.margin for arm in follow(robot, *np.split(path, 2, axis=1), start=start).equilibria]
    assert min(margins) < 0.04
    assert margins[-1] > 0.105
    servo = Servo(robot, start, options=ServoOptions(min_margin=0.06, **ACCELERATIONS))
    guard = servo.guard
    end = guard.posture.to(ends[1])
    assert end is not None
    monkeypatch.setattr("tubeopt.control.servo.BRAKING", (0.0, 1.0))
    assert not guard._can_brake(end, 0.06, 1e-3)
    assert not guard._keeps_at_kinks(ends[0], ends[1], 0.06)
