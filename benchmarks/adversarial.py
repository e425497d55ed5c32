"""Commands that make no sense, come too early or too late, or jump: whether a robot ever snaps or leaves its limits.

    python -m benchmarks.adversarial [--number 1000000] [--robots thesis_ctr ...] [--seconds 60] [--node]

Each robot has limited accelerations and stands behind the server: texts of messages go through its reader to the robot,
at times of its own clock, which also jumps. Texts are commands, broken JSON, numbers that are none, other types, other
frames and units. Each tick is looked at: joint values are finite, within ranges, rates and
accelerations of the time that has passed; the margin is above its floor; `follow` goes through the same places
without a snap. What is not refused by a sentence counts as a crash. With `--node` messages of ROS 2 go to its node, on
the modules of the tests that stand for those of ROS.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import time
from collections import Counter
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import tubeopt
from benchmarks.timing import show, table
from tests.control import ros_loopback
from tubeopt.control.c_binding import servo_of
from tubeopt.control.command import WORDS as REASONS
from tubeopt.control.command import ServoOptions, Why
from tubeopt.control.crtk import CrtkRobot
from tubeopt.control.server import _read
from tubeopt.inverse.joints import joint_space

ROBOTS = ["thesis_ctr", "crl_ctr", "two_tube"]
PERIOD, FLOOR, TURN, SHIFT = 1e-3, 0.1, 30.0, 1.0
EVERY = 100
"""Places after which the way through them is followed."""

CALM, CALM_TICKS = 2e-4, 3000
"""Share of messages that ask for the closest pose to a far target, and ticks without messages after them: the search
needs them."""

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
    possible: Any = [
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
        {"op": "servo_cp", "position": near.tolist(), "closest": True},
        {"op": "move_cp", "position": near.tolist(), "closest": True},
        {"op": "servo_jv", **small},
        {"op": "servo_cr", "translation": (near - tip).tolist(), "turn": random.normal(size=3).tolist()},
        {"op": "move_cr", "translation": (near - tip).tolist(), "turn": None},
        {"op": "free"},
    ]
    message = possible[random.integers(len(possible))]
    if random.random() < 0.15:
        key, bad = random.choice([*message, "nonsense"]), BAD[random.integers(len(BAD))]
        message[key] = [bad] * random.integers(1, 5) if random.random() < 0.5 else bad
    out = json.dumps(message)
    return out[: random.integers(len(out))] if random.random() < 0.02 else out


def told_to(arm: CrtkRobot, random: np.random.Generator, joints: tuple[list[float], list[float]], now: float) -> str:
    """Give a robot a text as the server does, perhaps late or early; returns its command."""
    ended = _read(text(random, arm.servo.equilibrium.tip_position, joints))
    arm.command(ended, now + random.choice([0.0, 0.0, 0.0, -1.0, 1e3]))
    return str(ended["op"])


class NodeOfRos:
    """The node of ROS 2 with a robot, on a clock of its own."""

    def __init__(self, robot: CrtkRobot, name: str) -> None:
        bus = ros_loopback.install(pytest.MonkeyPatch(), crtk=True)
        sys.path.insert(0, "integrations/ros2/tubeopt_ros")
        self.module: Any = importlib.import_module("tubeopt_ros.node")
        self.now, self.bus = 0.0, bus
        self.module.time = SimpleNamespace(monotonic=lambda: self.now, thread_time=time.thread_time, sleep=time.sleep)
        ros_loopback.Node.parameters = {"robot": name}
        self.node = self.module.RobotNode()
        self.topics = list(bus.calls)
        assert self.node.trigger_configure() == "success", self.node.logged
        self.node.robot, self.node._period = robot, PERIOD
        self.node.trigger_activate()

    def ended(self, random: np.random.Generator, joints: tuple[list[float], list[float]], now: float) -> str:
        """Send a message, possible or not; returns its command, or raises InputError where the node refuses it."""
        self.now, before, here = now, len(self.node.logged), self.node.robot.servo.equilibrium.tip_position
        op = str(random.choice(self.topics))
        message, bad = self.bus.types[op](), [each for each in BAD if isinstance(each, float)]
        odd = random.random() < 0.15
        if hasattr(message, "header"):
            message.header.frame_id = random.choice(["", "plate", "camera"], p=[0.45, 0.45, 0.1])
        if op.endswith(("cp", "cr")):
            place = (op.endswith("cp") * here + 10.0 ** random.uniform(-6, 0) * random.normal(size=3)).tolist()
            vectors = [(message.pose.position, place), (message.pose.orientation, random.normal(size=3).tolist())]
        elif op.endswith("cv"):
            rates = 10.0 ** random.uniform(-3, 2) * random.normal(size=(2, 3))
            vectors = [(message.twist.linear, rates[0].tolist()), (message.twist.angular, rates[1].tolist())]
        else:
            vectors = []
        for vector, values in vectors:
            vector.x, vector.y, vector.z = values
            if odd:
                vector.y = float(random.choice(bad))
        if op[-2:] in ("jp", "jr", "js", "jv"):
            values = [x * (1.0 if op[-2:] in ("jp", "js") else 0.05) for part in joints for x in part]
            values = values[: random.integers(len(values))] if odd else values
            message.position, message.velocity = values, [float(random.choice(bad))] if odd else values
        elif op == "state_command":
            message.string = str(random.choice([word for word in WORDS if isinstance(word, str)]))
        self.bus.calls[op][0](message)
        for words in self.node.logged[before:]:
            raise (AssertionError if "the robot is held" in words else tubeopt.InputError)(words)
        return op

    def tick(self, now: float) -> None:
        """A step at a time."""
        self.now, before = now, len(self.node.logged)
        self.node.tick()
        assert len(self.node.logged) == before, self.node.logged[-1]
        self.node.logged.clear()


def torment(name: str, number: int, seconds: float, seed: int, *, node: bool = False) -> Counter[str]:
    """What happened to one robot under so many messages, or for so long."""
    robot, random, counts = tubeopt.load_robot(name), np.random.default_rng(seed), Counter[str]()
    space, n = joint_space(robot), robot.n_tubes
    options = ServoOptions(min_margin=FLOOR, turn_acceleration=TURN, shift_acceleration=SHIFT)
    many = space.sample(1024)
    starts = (tubeopt.forward_kinematics(robot, *space.split(q)) for q in many)
    start = next(arm for arm in starts if arm.margin > 2 * FLOOR)
    arm = CrtkRobot(servo_of(robot, (start.rotations, start.translations), options=options))
    of_ros = NodeOfRos(arm, name) if node else None
    branch, now, start_time = start, 0.0, time.monotonic()
    rates = np.repeat([options.turn_rate, options.shift_rate], n)
    most = np.repeat([TURN, SHIFT], n)
    place = np.concatenate([start.rotations, start.translations])
    speed, span, path, ends = np.zeros(2 * n), PERIOD, list[np.ndarray](), set[int]()
    calm = 0
    while counts["messages"] < number and time.monotonic() - start_time < seconds:
        counts["messages"] += not calm
        goal, shift = space.split(many[random.integers(len(many))])
        sets = False
        calm = max(0, calm - 1)
        if not calm and random.random() < CALM:
            calm = CALM_TICKS
        if calm in (0, CALM_TICKS) and random.random() < (1.0 if calm else AWAKE):
            for word in ("home", "resume", "enable"):
                with suppress(tubeopt.InputError):
                    arm.command({"op": "state_command", "command": word}, now)
        try:
            joints = goal.tolist(), list(shift)
            if not calm:
                sets = (of_ros.ended(random, joints, now) if of_ros else told_to(arm, random, joints, now)) == "set_js"
            elif calm == CALM_TICKS:
                far = space.longest * random.uniform(-1, 1, size=3) / 2
                arm.command({"op": "move_cp", "position": far.tolist(), "closest": True}, now)
        except tubeopt.InputError:
            counts["refused"] += 1
        except Exception as error:  # what is looked for
            counts[f"crash: {type(error).__name__}: {error}"] += 1
        if sets:  # the drives have moved by themselves
            here, speed = arm.servo.equilibrium, np.zeros(2 * n)
            place = np.concatenate([here.rotations, here.translations])
            ends.update((len(path) - 1, len(path)))  # both ends of that motion, which is long and straight
            path.append(place)
        now += PERIOD * random.choice([0.2, 1.0, 1.0, 1.0, 3.0])
        sent = arm.sent
        try:
            of_ros.tick(now) if of_ros else arm.tick(lambda: now, PERIOD)  # noqa: B023
        except Exception as error:  # what is looked for
            counts[f"crash in a step: {type(error).__name__}: {error}"] += 1
        counts["ticks of searches"] += calm > 0 and REASONS[Why.SEEKING] in arm.report(now)["why"]
        here = arm.servo.equilibrium
        reached = np.concatenate([here.rotations, here.translations])
        span = arm._moved if arm.sent != sent else PERIOD
        moved = (reached - place) / span
        counts["moved"] += bool((reached != place).any())
        counts["beyond rates"] += bool((np.abs(moved) > rates * (1 + 1e-9) + 1e-12).any())
        if arm.sent != sent:
            counts["beyond accelerations"] += bool((np.abs(moved - speed) > most * span * (1 + 1e-6) + 1e-9).any())
            speed = moved
        counts["out of range"] += bool(space.outside(space.join(here.rotations, here.translations)))
        counts["below the floor"] += bool(here.margin < FLOOR - 1e-3)
        counts["not finite"] += not np.isfinite(reached).all()
        place = reached
        path.append(reached)
        if len(path) >= EVERY:
            passed_by = sorted({*range(0, len(path), EVERY // 20), len(path) - 1, *ends} - {-1})
            rotations, translations = np.split(np.array(path)[passed_by], 2, axis=1)
            passed = tubeopt.follow(robot, rotations, translations, start=branch)
            branch, path, ends = passed.equilibria[-1], [], set()
            counts["snaps"] += (
                bool(passed.snaps) or float(np.linalg.norm(branch.tip_position - here.tip_position)) > 1e-6
            )
    return counts


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", nargs="+", default=ROBOTS)
    parser.add_argument("--number", type=int, default=1_000_000, help="of messages, over all robots")
    parser.add_argument("--seconds", type=float, default=np.inf, help="for each robot at most")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--node", action="store_true", help="the node of ROS 2 in place of the server")
    options = parser.parse_args()
    each = options.number // len(options.robots)
    counts = {name: torment(name, each, options.seconds, options.seed, node=options.node) for name in options.robots}
    kinds = sorted({kind for each in counts.values() for kind in each})
    rows = [(kind, *(str(each[kind]) for each in counts.values())) for kind in kinds]
    show([table("messages that make no sense", ("", *counts), rows)], [])


if __name__ == "__main__":
    main()
