"""The servo: where it leads the tip, what it keeps, and that it never snaps."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from tests.examples import CRL, PIECES, THESIS
from tubeopt import (
    ConcentricRobot,
    Equilibrium,
    InputError,
    Load,
    SolveError,
    Tube,
    find_snap,
    follow,
    forward_kinematics,
)
from tubeopt.bodies.obstacles import Sphere
from tubeopt.control.command import Command, ServoOptions, ServoStep, Why
from tubeopt.control.servo import Servo
from tubeopt.equilibrium.arm_surface import ArmSurface
from tubeopt.inverse.joints import joint_space
from tubeopt.solvers.compiled.binding import kernel_of
from tubeopt.solvers.compiled.quadratic import constrained_least_squares

SEED = ([0.0, 1.0, 2.0], [-0.05, -0.03, -0.02])
DT = 1e-3
TINY = Load(force=(1e-9, 0, 0))


def joints(arm: Equilibrium) -> tuple[np.ndarray, np.ndarray]:
    return arm.rotations, arm.translations


@pytest.fixture(scope="module")
def seed() -> Equilibrium:
    return forward_kinematics(THESIS, *SEED)


def run(servo: Servo, command: Command, steps: int) -> list[ServoStep]:
    return [servo.step(command, DT) for _ in range(steps)]


def test_it_reaches_a_place_and_a_direction_within_its_rates(seed: Equilibrium) -> None:
    servo = Servo(THESIS, seed, options=ServoOptions(turn_rate=2.0, shift_rate=0.03))
    target = seed.tip_position + np.array([3e-3, -2e-3, 1e-3])
    pointing = seed.tip_rotation[:, 2] + np.array([0.02, 0, 0])
    steps = run(servo, Command(position=target, direction=pointing), 700)
    assert np.linalg.norm(steps[-1].equilibrium.tip_position - target) < 1e-7
    assert steps[-1].equilibrium.tip_rotation[:, 2] == pytest.approx(pointing / np.linalg.norm(pointing), abs=1e-6)
    for one, two in pairwise(steps):
        assert np.abs(two.rotations - one.rotations).max() <= 2e-3 + 1e-12
        assert np.abs(two.translations - one.translations).max() <= 3e-5 + 1e-12


def of_four() -> ConcentricRobot:
    tubes = ((0.8, 0.6, 150, 80, 18.0), (1.2, 0.95, 100, 70, 15.0), (1.7, 1.35, 60, 50, 12.0), (2.3, 1.85, 30, 40, 9.0))
    return ConcentricRobot([Tube(*(1e-3 * size for size in sizes), bent) for *sizes, bent in tubes])


@pytest.mark.parametrize("robot", [of_four(), PIECES], ids=["four", "pieces"])
def test_turned_into_a_snap_it_stays_above_its_floor_on_its_branch(robot: ConcentricRobot) -> None:
    """Straight on there is a snap; the joints sent are followed from each to the next."""
    n = robot.n_tubes
    seed = forward_kinematics(robot, np.linspace(0.0, 0.5, n))
    goal = seed.rotations + np.where(np.arange(n) % 2, 5.5, 0.0), seed.translations
    assert find_snap(robot, joints(seed), goal, equilibrium=seed) is not None
    servo = Servo(robot, seed, options=ServoOptions(min_margin=0.1, turn_rate=10.0))
    arms = [seed, *(servo.step(Command(joints=goal), 1e-2).equilibrium for _ in range(48))]
    assert min(arm.margin for arm in arms) >= 0.1
    assert np.abs(arms[-1].rotations - seed.rotations).max() > 1.0
    assert np.abs(arms[-1].rotations - goal[0]).max() > 0.5
    way = follow(robot, [arm.rotations for arm in arms], [arm.translations for arm in arms], start=seed)
    assert not way.snaps
    assert way.equilibria[-1].tip_position == pytest.approx(arms[-1].tip_position, abs=1e-8)


def test_the_floor_of_the_margin_is_slid_along_and_the_joints_sent_do_not_snap(seed: Equilibrium) -> None:
    # Straight out to the side, where the robot would have to pass its floor.
    servo = Servo(THESIS, seed, options=ServoOptions(min_margin=0.3))
    steps = run(servo, Command(position=(-0.05, 0.02, 0.2)), 1500)
    reasons = Why(0)
    for step in steps:
        reasons |= step.why
    assert Why.MARGIN in reasons
    assert "margin is at its lower limit" in reasons.text
    assert min(step.equilibrium.margin for step in steps) >= 0.3
    every = steps[::25]
    way = follow(THESIS, [s.rotations for s in every], [s.translations for s in every], start=every[0].equilibrium)
    assert not way.snaps
    assert way.equilibria[-1].tip_position == pytest.approx(every[-1].equilibrium.tip_position, abs=1e-8)


def test_bodies_are_kept_clear_of(seed: Equilibrium) -> None:
    ball = Sphere(tuple(seed.tip_position + np.array([6e-3, 0, 0])), 3e-3)
    servo = Servo(THESIS, seed, obstacles=[ball], options=ServoOptions(clearance=5e-4))
    steps = run(servo, Command(position=seed.tip_position + np.array([8e-3, 0, 0])), 200)
    least = min(float(ball.signed_distance(step.equilibrium.tip_position[None])[0]) for step in steps)
    assert least >= 5e-4
    assert any(Why.OBSTACLE in step.why for step in steps)


def surface(arm: Equilibrium, body: Sphere, count: int) -> float:
    """Least distance (m) of many places of the surface from a body."""
    points, radius = ArmSurface(arm).at(np.linspace(0.0, arm.arc_length[-1], count))
    return float((body.signed_distance(points) - radius).min())


def test_in_a_cloud_the_arm_slides_between_the_bodies(seed: Equilibrium) -> None:
    """A step along a body bends towards it, and the edge of a tube moves with that tube: both are reckoned with, so
    that the guard has nothing to hold back."""
    random, cloud = np.random.default_rng(0), list[Sphere]()
    while len(cloud) < 80:
        place = seed.position[random.integers(3, len(seed.position))] + random.normal(size=3) * 8e-3
        body = Sphere(tuple(place.tolist()), 2e-3)
        if 5e-4 < surface(seed, body, 201) < 6e-3:
            cloud.append(body)
    servo = Servo(THESIS, seed, obstacles=cloud)
    target = seed.tip_position + np.array([0.015, 0.01, -0.01])
    steps = run(servo, Command(position=target), 200)
    assert sum(Why.OBSTACLE in step.why for step in steps) > 50
    assert not any(Why.HELD in step.why for step in steps)
    assert np.linalg.norm(target - seed.tip_position) - steps[-1].distance > 2e-3
    for step in steps[::40]:
        assert min(surface(step.equilibrium, body, 5001) for body in cloud) > 0.0


def test_the_arm_pivots_about_a_point_while_its_tip_moves(seed: Equilibrium) -> None:
    pivot = seed.position[8]
    servo = Servo(THESIS, seed)
    steps = run(servo, Command(velocity=(0, 0.004, 0), pivot=pivot), 300)
    arm = steps[-1].equilibrium
    gaps = [a + np.clip((pivot - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1) * (b - a) for a, b in pairwise(arm.position)]
    # Chords between shape points, 5 mm and less of radius 0.1 m and more, are off by 0.03 mm.
    assert min(np.linalg.norm(pivot - gap) for gap in gaps) < 1e-4
    assert arm.tip_position[1] - seed.tip_position[1] == pytest.approx(1.2e-3, rel=0.05)


@pytest.mark.parametrize("objective", ["margin", "centre", "compliance"])
def test_what_the_tip_leaves_free_goes_to_an_objective(objective: str) -> None:
    space = joint_space(THESIS)
    start = forward_kinematics(THESIS, *space.split(0.999 * space.sample(8)[0] + 0.001 * space.inside()))  # margin 0.48
    if objective == "compliance" and kernel_of(THESIS) is None:
        with pytest.raises(InputError, match="needs a compiled kernel"):
            Servo(THESIS, start, options=ServoOptions(objective=objective))
        return
    servo = Servo(THESIS, start, options=ServoOptions(objective=objective))
    before, q = servo.equilibrium, servo.space.join(start.rotations, start.translations)
    arm = run(servo, Command(position=start.tip_position), 60)[-1].equilibrium
    assert arm.tip_position == pytest.approx(before.tip_position, abs=1e-6)
    if objective == "margin":
        assert arm.margin > before.margin + 1e-3
    elif objective == "centre":
        middle = (servo.space.lower + servo.space.upper) / 2
        far = [np.linalg.norm((p - middle) / servo.space.scale) for p in (servo.space.join(*joints(arm)), q)]
        assert far[0] < far[1]
    else:
        soft = [np.trace(forward_kinematics(THESIS, *joints(e), load=TINY).compliance[:3, :3]) for e in (arm, before)]
        assert soft[0] < soft[1] * (1 - 1e-3)


def test_a_free_robot_close_to_the_middle_of_its_ranges_is_there_in_one_step() -> None:
    """As far as the objective may push, and no farther than the middle."""
    space, push = joint_space(THESIS), 0.5
    middle = np.where(np.isfinite(space.lower + space.upper), (space.lower + space.upper) / 2, 0.0)
    away = np.array([0.3, -0.2, 0.1, 0.4, 0.2, -0.1])
    options, most = ServoOptions(turn_rate=3.0, shift_rate=1.0, objective="centre", push=push), push * 3.0 * DT
    for size in (0.9 * most, 3 * most):
        start = middle + size * away / np.linalg.norm(away) * space.scale
        servo = Servo(THESIS, space.split(start), options=options)
        after = space.join(*joints(servo.step(Command(), DT).equilibrium))
        left = (after - middle) / space.scale
        assert left == pytest.approx(max(size - most, 0.0) * away / np.linalg.norm(away), abs=1e-9)


def test_commands_and_options_that_make_no_sense_are_refused(seed: Equilibrium) -> None:
    with pytest.raises(InputError, match=r"command is \[0, 0, 0\.1\]; it must be a Command"):
        Servo(THESIS, seed).step([0, 0, 0.1], 1e-3)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="both given"):
        Command(position=(0, 0, 0), velocity=(0, 0, 0))
    with pytest.raises(InputError, match="direction has no length"):
        Command(direction=(0, 0, 0))
    with pytest.raises(InputError, match="min_margin is 2"):
        ServoOptions(min_margin=2.0)
    with pytest.raises(InputError, match="priorities are"):
        ServoOptions(priorities=("position", "position"))
    with pytest.raises(InputError, match=r"objective is 'speed'; it must be one of margin, centre, compliance"):
        ServoOptions(objective="speed")
    with pytest.raises(InputError, match="push is -1; it must be at least 0"):
        ServoOptions(push=-1)
    with pytest.raises(InputError, match=r"obstacle 1 is .*Sphere.*; it must be a body of tubeopt\.bodies"):
        Servo(THESIS, seed, obstacles=[Sphere])
    with pytest.raises(InputError, match="dt is 0 s"):
        Servo(THESIS, seed).step(Command(), 0.0)
    near = forward_kinematics(THESIS, np.radians([0, 90, 180]))  # of margin 0.927
    with pytest.raises(InputError, match="start has margin"):
        Servo(THESIS, near, options=ServoOptions(min_margin=0.95))


def test_what_next_to_nothing_satisfies_has_no_answer_and_a_later_task_does_not_undo_the_first() -> None:
    unit = np.eye(1)
    # x >= 1e-3 and x <= 1e-3 (1 - 1e-7): contradictory by less than rounding tells, and so by more.
    for less in (1e-3, 1e-7):
        found = constrained_least_squares(unit, np.zeros(1), np.vstack([unit, -unit]), 1e-3 * np.array([1, less - 1]))
        assert found is None or found.x[0] == pytest.approx(1e-3, rel=1e-4)
    scales = np.array([[1.0], [-1e-3], [0.7]])
    assert constrained_least_squares(unit, np.zeros(1), scales, np.array([1e-3, 1e-6, 0.0])) is None


@pytest.mark.parametrize("objective", ["margin", "centre"])
def test_no_joint_is_faster_than_its_rate_however_long_the_step(objective: str) -> None:
    random = np.random.default_rng(5)
    space = joint_space(CRL)
    for q in space.sample(8):
        try:
            start = forward_kinematics(CRL, *space.split(0.9 * q + 0.1 * space.inside()))
            turn, shift, dt = 10 ** random.uniform(-1, 1), 10 ** random.uniform(-2, 0), 10 ** random.uniform(-2, -1)
            servo = Servo(CRL, start, options=ServoOptions(1.0, turn, shift, 0.02, objective=objective, push=0.5))
        except (SolveError, InputError):
            continue
        for _ in range(5):
            before = servo.equilibrium
            after = servo.step(Command(velocity=random.normal(size=3)), dt).equilibrium
            assert np.abs(after.rotations - before.rotations).max() <= turn * dt * (1 + 1e-12) + 1e-15
            assert np.abs(after.translations - before.translations).max() <= shift * dt * (1 + 1e-12) + 1e-15


def test_options_keep_numbers_however_they_are_written() -> None:
    options = ServoOptions(speed=np.float64(0.1), push=1)
    assert (options.speed, options.push) == (0.1, 1.0)
    assert type(options.push) is float
    for text in ("fast", "0.1"):
        with pytest.raises(InputError, match=f"speed is '{text}'; it must be a number"):
            ServoOptions(speed=text)  # type: ignore[arg-type]


def test_a_target_nearer_than_the_speed_allows_is_reached_in_one_step(seed: Equilibrium) -> None:
    """But for the little damping and what is not linear; one farther away comes nearer by what the speed allows."""
    servo = Servo(THESIS, seed)
    begin = servo.equilibrium.tip_position
    near = begin + np.array([2e-6, -1e-6, 0.0])
    servo.step(Command(position=near), 1e-2)
    assert np.linalg.norm(servo.equilibrium.tip_position - near) < 0.1 * np.linalg.norm(near - begin)
