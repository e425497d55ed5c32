"""Commands that make no sense, and robots in states at the edge of what there is: nothing dies, moves too far, or is
silent."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tubeopt import InputError, SolveError, load_robot
from tubeopt.control.c_binding import CServo, servo_of
from tubeopt.control.command import Command, ServoOptions, Why
from tubeopt.control.crtk import CrtkRobot
from tubeopt.control.servo import Servo
from tubeopt.inverse.joints import JointSpace, joint_space
from tubeopt.robots.robot import Robot
from tubeopt.solvers.compiled.library import compiler

ROBOTS = sorted(Path("configs/robots").glob("*.yaml"))
BAD: tuple[Any, ...] = (
    float("nan"), float("inf"), 1e308, -1e308, 1e-320, 10**400, True, "1", None, [1], [], {}, "enable", b"1",
)  # fmt: skip
STATES = "inside", "withdrawn", "advanced", "limits", "out of order", "zero turn"


def seeds(robot: Robot, space: JointSpace, random: np.random.Generator) -> Iterator[tuple[str, Any]]:
    """Joint values of each of the STATES, again and again: tubes out of order or carriages apart among them."""
    n, tubes = robot.n_tubes, robot.tubes
    low, high = space.ranges
    inside = space.sample(64)
    back = np.array([-tube.curved_length for tube in tubes])
    while True:
        for state in STATES:
            rotations, shift = space.split(inside[random.integers(len(inside))])
            if state == "withdrawn":
                shift = tuple(back + random.choice([0.0, 1e-15, 1e-12, 1e-9, 1e-6]))
            elif state == "advanced":
                shift = tuple(high[n:])
            elif state == "limits":
                rotations = np.where(random.random(n) < 0.5, low[:n], high[:n])
                shift = tuple(np.where(random.random(n) < 0.5, low[n:], high[n:]))
            elif state == "out of order":
                shift = tuple(random.uniform(low[n:], high[n:]))
            elif state == "zero turn":
                rotations = np.zeros(n)
            yield state, (rotations, np.array(shift))


def commands(space: JointSpace, at: Any, random: np.random.Generator) -> Iterator[dict[str, Any]]:
    """Fields of commands, most of them possible."""
    n, size = space.robot.n_tubes, space.length
    while True:
        away = random.normal(size=3)
        goal = space.split(space.sample(16)[random.integers(16)])
        told: dict[str, Any] = [
            {"position": at().tip_position + size * away * random.choice([1e-9, 1e-3, 0.3])},
            {"velocity": away * random.choice([1e-6, 0.02, 1e3])},
            {"position": at().tip_position + 0.1 * size * away, "direction": random.normal(size=3)},
            {"velocity": away, "direction": np.array([1e-320, 1e308, 0.0])},
            {"joints": (goal[0], np.array(goal[1]))},
            {"joints": (random.normal(size=n), random.normal(size=n) * size)},
            {"position": at().tip_position + size * away, "closest": True},
        ][random.integers(7)]
        if random.random() < 0.3:
            name = random.choice(list(told))
            bad = BAD[random.integers(len(BAD))]
            if name == "joints":
                told[name] = ([bad] * n, told[name][1]) if random.random() < 0.5 else bad
            else:
                told[name] = [bad, 0.0, 0.0] if random.random() < 0.5 else bad
        yield told


def is_sentence(error: Exception) -> bool:
    """Whether an error says something, in one line."""
    words = str(error)
    assert " " in words, repr(error)
    assert "\n" not in words, repr(error)
    return True


def attack(servo: Servo | CServo, random: np.random.Generator, count: int) -> dict[str, int]:
    """Steps of a servo under such commands: how many it made, and how many were refused with a sentence."""
    space, options = servo.space, servo.options
    done = {"steps": 0, "refused": 0, "held": 0}
    for _, told in zip(range(count), commands(space, lambda: servo.equilibrium, random), strict=False):
        here = servo.equilibrium
        dt: Any = random.choice([1e-3, 1e-6, 0.1, 10.0])
        if random.random() < 0.1:
            dt = BAD[random.integers(len(BAD))]
        try:
            step = servo.step(Command(**told), dt)
        except InputError as refused:
            done["refused"] += is_sentence(refused)
            assert servo.equilibrium is here
            continue
        dt = float(dt)
        moved = np.abs(step.rotations - here.rotations), np.abs(step.translations - here.translations)
        assert (moved[0] <= options.turn_rate * dt * (1 + 1e-9) + 1e-15).all()
        assert (moved[1] <= options.shift_rate * dt * (1 + 1e-9) + 1e-15).all()
        assert np.isfinite(step.equilibrium.tip_position).all()
        assert step.equilibrium.margin > 0
        still = not (moved[0].any() or moved[1].any())
        if still and set(told) in ({"joints"}, {"velocity"}) and dt > 1e-5 and not _there(told, here):
            assert step.why != Why(0), (told, dt)
        done["steps"] += 1
        done["held"] += still
        if random.random() < 0.2:
            servo.undo()
            assert servo.equilibrium.tip_position == pytest.approx(here.tip_position, abs=1e-12)
    return done


def _there(told: dict[str, Any], here: Any) -> bool:
    """Whether a command asks for what is, or for no motion of the tip."""
    if all(part is None for part in told.values()):
        return True
    if "velocity" in told:
        return float(np.linalg.norm(np.asarray(told["velocity"], dtype=float))) < 1e-5
    rotations, translations = (np.asarray(part, dtype=float) for part in told["joints"])
    return bool(np.allclose(rotations, here.rotations) and np.allclose(translations, here.translations))


def attack_messages(arm: CrtkRobot, random: np.random.Generator, count: int) -> int:
    """Messages of a client, and steps at times that come late and early; returns how many were refused."""
    space, options = arm.servo.space, arm.servo.options
    n, now, refused, last = space.robot.n_tubes, 0.0, 0, None
    for _ in range(count):
        place = arm.servo.equilibrium.tip_position
        goal = space.split(space.sample(16)[random.integers(16)])
        joints = {"rotations": goal[0].tolist(), "translations": list(goal[1])}
        message: Any = [
            {"op": "state_command", "command": random.choice(["enable", "enable", "disable", "pause", "resume"])},
            {"op": "servo_cp", "position": (place + 1e-3 * random.normal(size=3)).tolist()},
            {"op": "servo_cv", "linear": random.normal(size=3).tolist()},
            {"op": random.choice(["servo_jp", "servo_jv", "move_jr"]), **joints},
            {"op": "servo_cv", "linear": random.normal(size=3).tolist(), "angular": random.normal(size=3).tolist()},
            {"op": "move_cr", "translation": [1e-3, 0, 0], "turn": (0.1 * random.normal(size=3)).tolist()},
            {"op": "move_jp", **joints},
            {"op": "move_cp", "position": (place + 0.01 * random.normal(size=3)).tolist(), "direction": [0, 0, 1]},
        ][random.integers(8)]
        if random.random() < 0.4:
            key = random.choice([*message, "rotations", "nonsense"])
            bad = BAD[random.integers(len(BAD))]
            message[key] = [bad] * n if random.random() < 0.5 else bad
        try:
            arm.command(message, now)
        except InputError as error:
            refused += is_sentence(error)
        begun, takes = now + random.choice([1e-5, 2e-4, 1e-3, 3e-3]), random.choice([1e-5, 3e-4])
        reads = iter(begun + takes * np.arange(9))
        arm.tick(lambda reads=reads: next(reads), 1e-3)  # type: ignore[misc]
        now = float(next(reads))
        here = arm.servo.equilibrium
        if last is not None and arm.sent is not None and arm.sent > last[0]:
            passed = (arm.sent - last[0]) * (1 + 1e-9)
            assert (np.abs(here.rotations - last[1]) <= options.turn_rate * passed + 1e-12).all()
            assert (np.abs(here.translations - last[2]) <= options.shift_rate * passed + 1e-12).all()
        if arm.sent is not None:
            last = arm.sent, here.rotations, here.translations
        told = arm.report(now)
        assert np.isfinite(told["setpoint_js"]["position"]).all()
        assert (np.abs(told["setpoint_js"]["velocity"][:n]) <= options.turn_rate * (1 + 1e-9)).all()
        if random.random() < 0.05:
            arm.command({"op": "state_command", "command": "resume" if arm.state == "PAUSED" else "enable"}, now)
    return refused


def started(robot: Robot, seed: Any, fast: bool) -> Servo | CServo | None:
    """A servo at a seed, or None where it is refused with a sentence."""
    try:
        servo = Servo(robot, seed, options=ServoOptions(min_margin=0.05))
        here = servo.equilibrium
        # Whoever is let in begins where it was asked to.
        assert here.rotations == pytest.approx(seed[0], abs=1e-9)
        if fast:
            servo_c = servo_of(robot, (here.rotations, here.translations), options=servo.options)
            assert servo_c.equilibrium.tip_position == pytest.approx(here.tip_position, abs=1e-7)
            return servo_c
    except (InputError, SolveError) as refused:
        return None if is_sentence(refused) else servo
    return servo


def attack_robot(path: Path, fast: bool, count: int, steps: int) -> dict[str, int]:
    """Servos at `count` seeds of a robot under so many commands each, and how many were let in."""
    robot = load_robot(path)
    space, random = joint_space(robot), np.random.default_rng(len(path.stem))
    made = {"seeds": 0, "started": 0, "commands": 0, "refused": 0}
    for k, (_, seed) in zip(range(count), seeds(robot, space, random), strict=False):
        servo = started(robot, seed, fast)
        made["seeds"] += 1
        if servo is None:
            continue
        made["started"] += 1
        made["commands"] += steps
        if k % 2:
            made["refused"] += attack(servo, random, steps)["refused"]
        else:
            arm = CrtkRobot(servo)
            arm.command({"op": "state_command", "command": "enable"}, 0.0)
            made["refused"] += attack_messages(arm, random, steps)
    return made


@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_nothing_dies_moves_too_far_or_is_silent(path: Path) -> None:
    made = attack_robot(path, False, 6, 8)
    assert made["started"] > 0
    assert made["refused"] > 0


@pytest.mark.skipif(compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("name", ["thesis_ctr", "two_tube", "thesis_etr"])
def test_nor_does_the_c_library(name: str) -> None:
    made = attack_robot(Path(f"configs/robots/{name}.yaml"), True, 6, 12)
    assert made["started"] > 0
    assert made["refused"] > 0
