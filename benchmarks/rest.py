"""Servos at targets out of reach: whether robots come to rest, within their limits, as close as they can.

    python -m benchmarks.rest [--number 1000] [--robots thesis_ctr ...] [--kind c] [--against DIRECTORY]

Each robot starts at random joint values, and its servo is led to a random target within a length of its longest tube
that is out of reach. It moves until it has rested for two seconds. Printed: how long it takes from 1 mm off its last
place until rest, reversals in the last two seconds, largest accelerations over their limits, least margin, and how much
closer inverse kinematics comes: `ik --closest`, which searches from many starts, and the descent of `ik --closest` from
the place of rest. A servo approaches its target at every step, so it can rest at a local minimum only. Kinds: the servo
in Python, in C, and the robot of the server, commanded by servo_cp in time of its own. With `--reach` the targets are
tips of random joint values, and what counts is whether they are reached.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

import tubeopt
from benchmarks.timing import dump, show, table
from tubeopt.control.c_binding import CServo
from tubeopt.control.c_library import CLibrary, c_library
from tubeopt.control.command import Command, ServoOptions
from tubeopt.control.crtk import CrtkRobot
from tubeopt.control.servo import Servo
from tubeopt.inverse.closest import approach
from tubeopt.inverse.goal import pose_question
from tubeopt.inverse.joints import joint_space
from tubeopt.inverse.posture import posture_of
from tubeopt.robots.robot import Robot
from tubeopt.typing import Array

ROBOTS = ["thesis_ctr", "crl_ctr", "endonasal_ctr", "two_tube", "toronto_ctr"]
TURN, SHIFT = 30.0, 1.0
"""Limits of the accelerations, rad/s^2 and m/s^2."""

RESTED, LONGEST, NEAR = 2.0, 60.0, 1e-3
"""Seconds for which a robot must rest, the longest motion (s), and the distance from its last place (m) from which the
time until rest counts."""

RESTS, MOVES = 1e-3, 1e-9
"""Share of its rate below which a joint rests, and change (rad, m) above which it moves."""

REVERSALS, CLOSER = 5, 1e-4
"""Reversals that are too many, and distance (m) by which inverse kinematics must not come closer."""

EVERY = 5
"""Steps after which the way of a motion is followed."""

ARRIVED = 2e-6
"""Distance (m) at which a target is met: what the robot of the server calls arrived, with rounding."""


@dataclass(frozen=True)
class Rest:
    """How a motion ended."""

    settled: float
    """Seconds from NEAR its last place to rest; infinite where it does not rest."""
    reversals: int
    """In the last RESTED seconds, of the joint with the most."""
    acceleration: float
    """Largest acceleration over its limit."""
    margin: float
    """Least margin on the way."""
    distance: float
    """From the target, m."""
    joints: tuple[Array, Array]
    """Where it rests."""
    tip: Array
    """(3,) its tip there, m."""
    why: str
    """What is said of it."""
    milliseconds: float
    """Of a step, on average."""
    path: Array
    """(T, 2n) joint values on the way, every EVERY-th and the last."""


@cache
def library_of(robot: Robot) -> CLibrary:
    """The C library of a robot."""
    return c_library(robot)


def made(robot: Robot, start: Any, asked: argparse.Namespace) -> Any:
    """A servo of the kind that is asked for."""
    limits = {} if asked.unlimited else {"turn_acceleration": TURN, "shift_acceleration": SHIFT}
    if asked.snap_deg:
        limits["min_snap_distance"] = np.radians(asked.snap_deg)
    options = ServoOptions(speed=0.2, shift_rate=0.2, min_margin=asked.floor, **limits)
    return Servo(robot, start, options=options) if asked.kind == "python" else CServo(library_of(robot), start, options)


def lead(servo: Any, target: Array, dt: float, server: bool) -> Rest:
    """The motion of a servo to a target until it has rested."""
    o, clock = servo.options, [0.0]
    arm = CrtkRobot(servo)
    if server:
        arm.command({"op": "state_command", "command": "enable"}, 0.0)
    first = servo.equilibrium
    sent = [np.concatenate([first.rotations, first.translations])]
    n = len(first.rotations)
    rates = np.repeat([o.turn_rate, o.shift_rate], n)
    tips, margin, rested, why, start_time = [first.tip_position], first.margin, 0, None, time.perf_counter()
    while rested * dt < RESTED and len(sent) * dt < LONGEST:
        if server:
            clock[0] += dt
            arm.command({"op": "servo_cp", "position": target.tolist()}, clock[0])
            arm.tick(lambda: clock[0], dt)
        else:
            why = servo.step(Command(position=target), dt).why
        here = servo.equilibrium
        sent.append(np.concatenate([here.rotations, here.translations]))
        tips.append(here.tip_position)
        margin = min(margin, here.margin)
        rested = rested + 1 if (np.abs(sent[-1] - sent[-2]) < RESTS * rates * dt).all() else 0
    q, away = np.array(sent), np.linalg.norm(np.array(tips) - tips[-1], axis=1)
    near = len(q) - int(np.argmax((away > NEAR)[::-1])) if (away > NEAR).any() else 0
    moved = np.diff(q[-int(RESTED / dt) :], axis=0)
    signs = [np.sign(column[np.abs(column) > MOVES]) for column in moved.T]
    limits = np.repeat([o.turn_acceleration or np.inf, o.shift_acceleration or np.inf], n)
    speed = np.vstack([np.zeros(2 * n), np.diff(q, axis=0) / dt])
    settled = (len(q) - rested - near) * dt if rested * dt >= RESTED else np.inf
    return Rest(
        max(settled, 0.0),
        max(int((np.diff(each) != 0).sum()) for each in signs),
        float((np.abs(np.diff(speed, axis=0)) / dt / limits).max()),
        margin,
        float(np.linalg.norm(tips[-1] - target)),
        (here.rotations, here.translations),
        tips[-1],
        arm.report(0.0)["why"] if server else why.text,
        (time.perf_counter() - start_time) / (len(sent) - 1) * 1e3,
        np.vstack([q[:-1:EVERY], q[-1:]]),
    )


def posed(robot: Robot, random: np.random.Generator, floor: float) -> tubeopt.Equilibrium:
    """A random equilibrium with a margin above the floor."""
    space = joint_space(robot)
    many = space.sample(1024)
    while True:
        start = space.split(many[random.integers(len(many))])
        with suppress(tubeopt.SolveError):
            if (arm := tubeopt.forward_kinematics(robot, *start)).margin > floor + 0.05:
                return arm


def closest(robot: Robot, start: Any, target: Array, floor: float) -> float:
    """Distance (m) to which inverse kinematics comes from a start."""
    result = tubeopt.inverse_kinematics(robot, target, start=start, on_failure="closest", min_margin=floor)
    return float(np.linalg.norm(result.equilibrium.tip_position - target))


def lowest(robot: Robot, rest: tubeopt.Equilibrium, target: Array, floor: float) -> float:
    """Distance (m) of the local minimum that `ik --closest` descends to from the rest, by continuous motion."""
    goal = pose_question(robot, target, None, start=rest, min_margin=floor)
    end = approach(goal, posture_of(goal.space, rest))
    return np.inf if end is None else float(np.linalg.norm(end.posture.equilibrium.tip_position - target))


def measure(name: str, asked: argparse.Namespace, number: int) -> list[dict[str, Any]]:
    """Motions of one robot: as many that end out of reach, or with `--reach` as many targets within."""
    robot = tubeopt.load_robot(name)
    longest, out, k = joint_space(robot).longest, list[dict[str, Any]](), asked.first
    while len(out) < number:
        random = np.random.default_rng([asked.seed, *name.encode(), k])
        start = posed(robot, random, asked.floor)
        if asked.reach:
            target = posed(robot, random, asked.floor).tip_position
        else:
            target = random.normal(size=3)
            target *= longest * random.uniform() ** (1 / 3) / np.linalg.norm(target)
        servo = made(robot, (start.rotations, start.translations), asked)
        result = lead(servo, target, asked.dt, asked.kind == "server")
        row = vars(result) | {"robot": name, "case": k, "joints": [each.tolist() for each in result.joints]}
        del row["path"], row["tip"]
        if asked.snap_deg:
            row["snaps"] = snaps(robot, start, result)
        k += 1
        if not asked.reach and result.distance < NEAR:
            continue
        if len(out) < asked.compare:
            row["closest"] = closest(robot, start, target, asked.floor)
            if row["closest"] < result.distance - CLOSER:
                rest = tubeopt.follow(robot, *([each] for each in result.joints), start=start).equilibria[-1]
                row["closest from rest"] = lowest(robot, rest, target, asked.floor)
        out.append(row)
        if asked.verbose:
            print(row, file=sys.stderr, flush=True)
    return out


def snaps(robot: Robot, start: tubeopt.Equilibrium, result: Rest) -> bool:
    """Whether `follow` finds a snap on the way of a motion, or another pose at its end."""
    passed = tubeopt.follow(robot, *np.split(result.path, 2, axis=1), start=start)
    return bool(passed.snaps) or float(np.linalg.norm(passed.equilibria[-1].tip_position - result.tip)) > ARRIVED


def summary(name: str, rows: Sequence[dict[str, Any]]) -> list[str]:
    """A line of the table."""
    settled, speeds = np.array([row["settled"] for row in rows]), [row["acceleration"] for row in rows]
    known = [row for row in rows if "closest" in row]
    off = [row["distance"] - row["closest"] for row in known]
    cells = (
        name,
        len(rows),
        f"{np.median(settled):.2f}",
        f"{settled.max():.2f}",
        sum(row["reversals"] >= REVERSALS for row in rows),
        f"{max(speeds):.9f}",
        f"{min(row['margin'] for row in rows):.4f}",
        sum(row["distance"] > ARRIVED and not row["why"] for row in rows),
        sum(row["distance"] < NEAR for row in rows),
        f"{sum(each <= CLOSER for each in off)} of {len(known)}",
        sum(row["distance"] - row.get("closest from rest", np.inf) > CLOSER for row in known),
        f"{np.median([row['milliseconds'] for row in rows]):.3f}",
        sum(row.get("snaps", 0) for row in rows),
    )
    return [str(cell) for cell in cells]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", nargs="+", default=ROBOTS)
    parser.add_argument("--number", type=int, default=1000, help="of targets, over all robots")
    parser.add_argument("--kind", choices=("python", "c", "server"), default="c")
    parser.add_argument("--compare", type=int, default=0, help="motions of each robot compared with ik --closest")
    parser.add_argument("--dt", type=float, default=2e-3, help="cycle, s")
    parser.add_argument("--floor", type=float, default=0.1, help="of the margin")
    parser.add_argument("--snap-deg", type=float, default=0.0, help="least snap distance in place of the floor")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--reach", action="store_true", help="targets within reach")
    parser.add_argument("--unlimited", action="store_true", help="without limits of accelerations")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--verbose", action="store_true", help="each motion as it ends")
    parser.add_argument("--json", action="store_true", help="each motion, as JSON")
    asked = parser.parse_args()
    rows = []
    for name in asked.robots:
        rows += measure(name, asked, asked.number // len(asked.robots))
    if asked.json:
        dump({"motions": rows})
        return
    first = "", "motions", "s to rest", "most", "reverse", "a / limit", "least margin"
    columns = *first, "no reason", "met", "as close", "closer from rest", "ms / step", "snaps"
    lines = [summary(name, [row for row in rows if row["robot"] == name]) for name in asked.robots]
    show([table("motions to random targets", columns, [*lines, summary("all", rows)])], [])


if __name__ == "__main__":
    main()
