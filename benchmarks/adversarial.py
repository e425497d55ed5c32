"""Commands that make no sense, come too early or too late, or jump: whether a robot ever snaps or leaves its limits.

    python -m benchmarks.adversarial [--number 1000000] [--robots thesis_ctr ...] [--seconds 60]

Each robot has limited accelerations and stands behind the server: texts of messages go through its reader to the robot,
at times of its own clock, which also jumps. Texts are commands, broken JSON, numbers that are none, other types, other
frames and units. Each tick is looked at: joint values are finite, within ranges, rates and
accelerations of the time that has passed; the margin is above its floor; `follow` goes through the same places
without a snap. What is not refused by a sentence counts as a crash.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from contextlib import suppress
from typing import Any

import numpy as np

import tubeopt
from benchmarks.timing import show, table
from tubeopt.control.c_binding import servo_of
from tubeopt.control.command import ServoOptions
from tubeopt.control.crtk import CrtkRobot
from tubeopt.control.server import _read
from tubeopt.inverse.joints import joint_space

ROBOTS = ["thesis_ctr", "crl_ctr", "two_tube"]
PERIOD, FLOOR, TURN, SHIFT = 1e-3, 0.1, 30.0, 1.0
EVERY = 100
"""Places after which the way through them is followed."""

AWAKE = 0.1
"""Share of messages before which the robot is homed and enabled."""

WORDS = [
    "enable",
    "enable",
    "enable",
    "disable",
    "pause",
    "resume",
    "home",
    "unhome",
    "ENABLE",
    "",
    None,
    3,
    ["enable"],
]
BAD: list[Any] = [float("nan"), float("inf"), -1e308, 1e-320, 10**400, True, "1", None, [], {}, "\u0000", -0.0]


def text(random: np.random.Generator, tip: np.ndarray, joints: tuple[list[float], list[float]]) -> str:
    """A message, most of them possible."""
    near, (rotations, translations) = tip + 10.0 ** random.uniform(-6, 0) * random.normal(size=3), joints
    pair = {"rotations": rotations, "translations": translations}
    small = {name: (1e-2 * random.normal(size=len(rotations))).tolist() for name in pair}
    message: Any = [
        {"op": "servo_cp", "position": near.tolist()},
        {"op": "servo_cp", "position": near.tolist(), "direction": random.normal(size=3).tolist()},
        {"op": "servo_cv", "linear": (10.0 ** random.uniform(-3, 2) * random.normal(size=3)).tolist()},
        {"op": "servo_jp", **pair},
        {"op": "servo_jr", **small},
        {"op": "move_cp", "position": near.tolist()},
        {"op": "move_jp", **pair},
        {"op": "move_jr", **small},
        {"op": "set_js", **pair},
        {"op": "hold"},
        {"op": "state_command", "command": WORDS[random.integers(len(WORDS))]},
        {"op": "servo_cp", "position": (1e3 * near).tolist(), "frame_id": "camera"},
    ][random.integers(12)]
    if random.random() < 0.15:
        key, bad = random.choice([*message, "nonsense"]), BAD[random.integers(len(BAD))]
        message[key] = [bad] * random.integers(1, 5) if random.random() < 0.5 else bad
    out = json.dumps(message)
    return out[: random.integers(len(out))] if random.random() < 0.02 else out


def torment(name: str, number: int, seconds: float, seed: int) -> Counter[str]:
    """What happened to one robot under so many messages, or for so long."""
    robot, random, found = tubeopt.load_robot(name), np.random.default_rng(seed), Counter[str]()
    space, n = joint_space(robot), robot.n_tubes
    options = ServoOptions(min_margin=FLOOR, turn_acceleration=TURN, shift_acceleration=SHIFT)
    many = space.sample(1024)
    starts = (tubeopt.forward_kinematics(robot, *space.split(q)) for q in many)
    start = next(arm for arm in starts if arm.margin > 2 * FLOOR)
    arm = CrtkRobot(servo_of(robot, (start.rotations, start.translations), options=options))
    branch, now, began = start, 0.0, time.monotonic()
    rates = np.repeat([options.turn_rate, options.shift_rate], n)
    most = np.repeat([TURN, SHIFT], n)
    place = np.concatenate([start.rotations, start.translations])
    speed, span, way = np.zeros(2 * n), PERIOD, list[np.ndarray]()
    while found["messages"] < number and time.monotonic() - began < seconds:
        found["messages"] += 1
        goal, shift = space.split(many[random.integers(len(many))])
        sets = False
        if random.random() < AWAKE:
            for word in ("home", "resume", "enable"):
                with suppress(tubeopt.InputError):
                    arm.command({"op": "state_command", "command": word}, now)
        try:
            told = _read(text(random, arm.servo.equilibrium.tip_position, (goal.tolist(), list(shift))))
            arm.command(told, now + random.choice([0.0, 0.0, 0.0, -1.0, 1e3]))
            sets = told["op"] == "set_js"
        except tubeopt.InputError:
            found["refused"] += 1
        except Exception as error:  # what is looked for
            found[f"crash: {type(error).__name__}: {error}"] += 1
        if sets:  # the drives have moved by themselves
            here, speed = arm.servo.equilibrium, np.zeros(2 * n)
            place = np.concatenate([here.rotations, here.translations])
            way.append(place)
        now += PERIOD * random.choice([0.2, 1.0, 1.0, 1.0, 3.0])
        sent = arm.sent
        try:
            arm.tick(lambda: now, PERIOD)  # noqa: B023
        except Exception as error:  # what is looked for
            found[f"crash in a step: {type(error).__name__}: {error}"] += 1
        here = arm.servo.equilibrium
        there = np.concatenate([here.rotations, here.translations])
        span = arm._moved if arm.sent != sent else PERIOD
        moved = (there - place) / span
        found["moved"] += bool((there != place).any())
        found["beyond rates"] += bool((np.abs(moved) > rates * (1 + 1e-9) + 1e-12).any())
        if arm.sent != sent:
            found["beyond accelerations"] += bool((np.abs(moved - speed) > most * span * (1 + 1e-6) + 1e-9).any())
            speed = moved
        found["out of range"] += bool(space.outside(space.join(here.rotations, here.translations)))
        found["below the floor"] += bool(here.margin < FLOOR - 1e-3)
        found["not finite"] += not np.isfinite(there).all()
        place = there
        way.append(there)
        if len(way) >= EVERY:
            rotations, translations = np.split(np.array(way[:: EVERY // 20] + way[-1:]), 2, axis=1)
            passed = tubeopt.follow(robot, rotations, translations, start=branch)
            branch, way = passed.equilibria[-1], []
            found["snaps"] += (
                bool(passed.snaps) or float(np.linalg.norm(branch.tip_position - here.tip_position)) > 1e-6
            )
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", nargs="+", default=ROBOTS)
    parser.add_argument("--number", type=int, default=1_000_000, help="of messages, over all robots")
    parser.add_argument("--seconds", type=float, default=np.inf, help="for each robot at most")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    found = {name: torment(name, asked.number // len(asked.robots), asked.seconds, asked.seed) for name in asked.robots}
    kinds = sorted({kind for each in found.values() for kind in each})
    rows = [(kind, *(str(each[kind]) for each in found.values())) for kind in kinds]
    show([table("messages that make no sense", ("", *found), rows)], [])


if __name__ == "__main__":
    main()
