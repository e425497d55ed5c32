"""Servos at targets out of reach: whether robots come to rest, within their limits, as close as they can.

    python -m benchmarks.rest [--targets 1000] [--robots thesis_ctr ...] [--kind c] [--seek] [--jsonl FILE]

Each robot starts at random joint values, and its servo is led to a random target within a length of its longest tube
that is out of reach. It moves until it has rested for two seconds. Printed: how long it takes from 1 mm off its last
place until rest, reversals in the last two seconds, largest rates and accelerations over their limits, least margin,
snaps that `follow` finds on the way, and how much closer inverse kinematics comes: `ik --closest`, which searches from
many starts, and the descent of `ik --closest` from the place of rest. For a motion that ends farther off, planning
searches a way without a snap to that pose. With `--jsonl` each motion is a line of a file, and a later run goes on from
there; motions of other kinds to the same targets share their `ik --closest`. A servo approaches its target at every
step, so it can rest at a local minimum only; `--certify` checks that, by multipliers and second derivatives. Kinds: the
servo in Python, in C, and the robot of the server, commanded by servo_cp in time of its own. With `--reach` the targets
are tips of random joint values, and what counts is whether they are reached. With `--seek` commands ask for the closest
pose.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import scipy

import tubeopt
from benchmarks.timing import dump, show, table
from tubeopt.control.c_binding import CServo
from tubeopt.control.c_library import CLibrary, c_library
from tubeopt.control.command import WORDS, Command, ServoOptions, Why
from tubeopt.control.crtk import CrtkRobot
from tubeopt.control.servo import Servo
from tubeopt.equilibrium.jacobian import compiled_slopes
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

ACTIVE, NEAR_FLOOR, STEP, FLAT, SOME = 1e-6, 0.012, 4e-5, 1e-3, 1e-4
"""Distance of an active limit in units of the joints, and of the margin from its floor with the servo's room; step
inside; shares of the largest second derivative below which one counts as 0, and of the slope below which a multiplier
does."""

EVERY = 10
"""Steps after which the way of a motion is followed."""

SEARCHED = 600.0
"""Time limit of inverse kinematics, s: none on an idle machine, where its search takes 2 s."""

ARRIVED = 2e-6
"""Distance (m) at which a target is met: what the robot of the server calls arrived, with rounding."""


@dataclass(frozen=True)
class Rest:
    """How a motion ended."""

    settled: float
    """Seconds from NEAR its last place to its last motion; infinite where it does not rest."""
    reversals: int
    """In the last RESTED seconds, of the joint with the most."""
    rate: float
    """Largest rate of a joint over its limit."""
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


def lead(servo: Any, target: Array, dt: float, server: bool, seek: bool = False) -> Rest:
    """The motion of a servo to a target, or with `seek` to the closest pose, until it has rested."""
    o, clock = servo.options, [0.0]
    arm = CrtkRobot(servo)
    if server:
        arm.command({"op": "state_command", "command": "enable"}, 0.0)
    first = servo.equilibrium
    sent = [np.concatenate([first.rotations, first.translations])]
    n = len(first.rotations)
    rates = np.repeat([o.turn_rate, o.shift_rate], n)
    tips, margin, rested, text, start_time = [first.tip_position], first.margin, 0, "", time.perf_counter()
    while rested * dt < RESTED and len(sent) * dt < LONGEST:
        if server:
            clock[0] += dt
            arm.command({"op": "servo_cp", "position": target.tolist(), "closest": seek}, clock[0])
            arm.tick(lambda: clock[0], dt)
            text = arm.report(0.0)["why"]
        else:
            text = servo.step(Command(position=target, closest=seek), dt).why.text
        here = servo.equilibrium
        sent.append(np.concatenate([here.rotations, here.translations]))
        tips.append(here.tip_position)
        margin = min(margin, here.margin)
        seeks = WORDS[Why.SEEKING] in text
        rested = rested + 1 if not seeks and (np.abs(sent[-1] - sent[-2]) < RESTS * rates * dt).all() else 0
    q, away = np.array(sent), np.linalg.norm(np.array(tips) - tips[-1], axis=1)
    near = len(q) - int(np.argmax((away > NEAR)[::-1])) if (away > NEAR).any() else 0
    moved = np.diff(q[-int(RESTED / dt) :], axis=0)
    still = int(np.argmax((np.abs(np.diff(q, axis=0)) >= RESTS * rates * dt).any(1)[::-1]))
    signs = [np.sign(column[np.abs(column) > MOVES]) for column in moved.T]
    limits = np.repeat([o.turn_acceleration or np.inf, o.shift_acceleration or np.inf], n)
    speed = np.vstack([np.zeros(2 * n), np.diff(q, axis=0) / dt])
    settled = (len(q) - still - near) * dt if rested * dt >= RESTED else np.inf
    return Rest(
        max(settled, 0.0),
        max(int((np.diff(each) != 0).sum()) for each in signs),
        float((np.abs(speed) / rates).max()),
        float((np.abs(np.diff(speed, axis=0)) / dt / limits).max()),
        margin,
        float(np.linalg.norm(tips[-1] - target)),
        (here.rotations, here.translations),
        tips[-1],
        text,
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


def closest(robot: Robot, target: Array, floor: float) -> float:
    """Distance (m) to which `ik --closest` comes."""
    options = tubeopt.InverseOptions(time_limit=SEARCHED)
    result = tubeopt.inverse_kinematics(robot, target, on_failure="closest", min_margin=floor, options=options)
    return float(np.linalg.norm(result.equilibrium.tip_position - target))


def reachable(robot: Robot, start: tubeopt.Equilibrium, target: Array, floor: float) -> bool:
    """Whether a way without a snap, above the floor, from a start to the pose of `ik --closest` is found."""
    options = tubeopt.InverseOptions(time_limit=SEARCHED)
    found = tubeopt.inverse_kinematics(
        robot, target, start=start, on_failure="closest", reachable=True, min_margin=floor, options=options
    )
    path = found.path
    if not found.reachable or path is None:
        return False
    way = tubeopt.follow(robot, path.rotations, path.translations, start=start)
    return not way.snaps and min(each.margin for each in way.equilibria) > floor


def lowest(robot: Robot, rest: tubeopt.Equilibrium, target: Array, floor: float) -> float:
    """Distance (m) of the local minimum that `ik --closest` descends to from the rest, by continuous motion."""
    goal = pose_question(robot, target, None, start=rest, min_margin=floor)
    end = approach(goal, posture_of(goal.space, rest))
    return np.inf if end is None else float(np.linalg.norm(end.posture.equilibrium.tip_position - target))


def local(robot: Robot, rest: tubeopt.Equilibrium, target: Array, floor: float) -> tuple[str, float]:
    """Whether a rest is a local minimum of the distance, and how much closer (m) its model has a minimum.

    Active limits are ranges, order, and the floor of the margin. Where breakpoints meet, the distance has a kink, and
    the joint values around are looked into side by side. On each side: multipliers by non-negative least squares (KKT),
    and the Hessian of the Lagrangian on the directions that the limits leave, by differences at points inside.
    "minimum" where it is positive definite, "flat" where it is singular, as for a tube without a curve in front of the
    plate; "saddle" where it has a negative eigenvalue, "unknown" where no side has points inside.
    """
    space = joint_space(robot)
    q, n = space.join(rest.rotations, rest.translations), robot.n_tubes
    limits = [
        side * unit
        for side, end in ((1, space.lower), (-1, space.upper))
        for k, unit in enumerate(np.eye(len(q)))
        if abs(q[k] - end[k]) < ACTIVE * space.scale[k]
    ]
    limits += [
        row * space.scale
        for row, least in zip(space.rows, space.row_lower, strict=True)
        if row @ q - least < ACTIVE * space.longest
    ]
    kinks = [row for row in meetings(robot, rest) @ space.spread[n:] * space.scale if np.abs(row).max() > 0]
    # A kink of which the limits leave one side only is none.
    sides = np.array(limits).reshape(-1, len(q)).T
    kinks = [
        row for row in kinks if not limits or min(scipy.optimize.nnls(sides, sign * row)[1] for sign in (1, -1)) > 1e-9
    ]
    answers = []
    for signs in itertools.product((1, -1), repeat=len(kinks)):
        rows = np.array([*limits, *(sign * row for sign, row in zip(signs, kinks, strict=True))]).reshape(-1, len(q))
        rows = rows / np.linalg.norm(rows, axis=1, keepdims=True)
        # The least motion away from all of them: w = a - b with a, b >= 0.
        found = scipy.optimize.linprog(np.ones(2 * len(q)), np.hstack([-rows, rows]), -np.ones(len(rows)))
        if found.status == 0:
            inside = found.x[: len(q)] - found.x[len(q) :]
            answers.append(on_side(rest, target, floor, (space, q, rows, inside)))
    kinds = [kind for kind, _ in answers]
    worst = next((kind for kind in ("saddle", "flat") if kind in kinds), "minimum") if kinds else "unknown"
    return worst, max((gain for _, gain in answers), default=np.nan)


def meetings(robot: Robot, rest: tubeopt.Equilibrium) -> Array:
    """(M, n) slopes, by the translations, of the distances of breakpoints that meet each other or the plate."""
    n, found = robot.n_tubes, [np.zeros(robot.n_tubes)]
    ends = [(k, rest.translations[k] + at) for k, tube in enumerate(robot.tubes) for at in (0.0, tube.curved_length)]
    close = ACTIVE * max(tube.length for tube in robot.tubes)
    for a, (i, s) in enumerate(ends):
        found += [np.eye(n)[i]] * int(abs(s) < close)
        found += [np.eye(n)[i] - np.eye(n)[j] for j, r in ends[:a] if i != j and abs(r - s) < close and s > -close]
    return np.unique(found, axis=0)


def on_side(rest: tubeopt.Equilibrium, target: Array, floor: float, side: tuple[Any, ...]) -> tuple[str, float]:
    """Kind of a rest, and gain (m), as of `local`, on one side of kinks."""
    space, q, rows, inside = side
    robot, distance = space.robot, float(np.linalg.norm(rest.tip_position - target))

    def slopes(by: Array) -> tuple[Array, Array]:
        """Slopes of half the squared distance and of the margin by the scaled joints, at a point inside."""
        at = tubeopt.forward_kinematics(robot, *space.split(q + (STEP * inside + by) * space.scale), start=rest)
        slope = compiled_slopes(at, (1,) * robot.n_tubes, space.carriages, either=False)
        assert slope is not None, "there is no compiled kernel"
        pull = (at.tip_position - target) @ slope.position
        return tuple(part @ space.spread * space.scale for part in (pull, slope.margin))

    pull, margin = slopes(np.zeros(len(q)))
    at_floor = rest.margin < floor + NEAR_FLOOR
    size = float(np.linalg.norm(margin))
    rows = np.vstack([rows, margin / size]) if at_floor else rows
    force = scipy.optimize.nnls(rows.T, pull)[0] if len(rows) else np.zeros(0)
    strong = rows[force > SOME * np.linalg.norm(pull)]
    free = scipy.linalg.null_space(strong) if len(strong) else np.eye(len(q))
    # Rows without a multiplier that no direction of the critical cone leaves: normals may depend on one another.
    for _ in range(len(rows) if free.shape[1] else 0):
        cone = rows @ free
        held = [
            k
            for k, row in enumerate(cone)
            if np.abs(row).max() > 1e-9
            and -scipy.optimize.linprog(-row, -cone, np.full(len(cone), 1e-12), bounds=(-1, 1)).fun < 1e-6
        ]
        if not held:
            break
        free = free @ scipy.linalg.null_space(cone[held])
        if not free.shape[1]:
            break
    if not free.shape[1]:
        return "minimum", 0.0
    left = free.T @ (pull - rows.T @ force)
    weight, step = (force[-1] / size if at_floor else 0.0), STEP / 4
    ends = [[slopes(step * way * one) for one in (-1, 1)] for way in free.T]
    columns = [(b[0] - a[0] - weight * (b[1] - a[1])) / (2 * step) for a, b in ends]
    hessian = free.T @ np.array(columns).T
    values, vectors = np.linalg.eigh((hessian + hessian.T) / 2)
    largest = max(np.abs(values).max(), 1e-3 * space.longest**2)
    along, steep = vectors.T @ left, values > FLAT * largest
    gain = float((along[steep] ** 2 / values[steep]).sum()) / 2 / distance
    return "saddle" if (values < -FLAT * largest).any() else "minimum" if steep.all() else "flat", gain


def measure(name: str, asked: argparse.Namespace, known: Sequence[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Motions of one robot, one after another, with what a file knows of them: as many as one wants."""
    robot = tubeopt.load_robot(name)
    longest, counted = joint_space(robot).longest, 0
    for k in itertools.count(asked.first):
        same = [row for row in known if (row["robot"], row["case"]) == (name, k)]
        row = next((row for row in reversed(same) if row["of"] == asked.kind), {})
        others = [row["closest"] for row in same if "closest" in row]
        compares = counted < asked.compare and "closest" not in row and (not row or counts(row, asked))
        certifies = counted < asked.certify and not row
        if not row or compares:
            random = np.random.default_rng([asked.seed, *name.encode(), k])
            start = posed(robot, random, asked.floor)
            if asked.reach:
                target = posed(robot, random, asked.floor).tip_position
            else:
                target = random.normal(size=3)
                target *= longest * random.uniform() ** (1 / 3) / np.linalg.norm(target)
            if not row:
                servo = made(robot, (start.rotations, start.translations), asked)
                result = lead(servo, target, asked.dt, asked.kind == "server", asked.seek)
                row = vars(result) | {"robot": name, "case": k, "of": asked.kind}
                row["joints"] = [each.tolist() for each in result.joints]
                row["tip"] = result.tip.tolist()
                row["snaps"] = snaps(robot, start, result)
                del row["path"]
            if certifies and counts(row, asked):
                rest = tubeopt.follow(robot, *np.split(result.path, 2, axis=1), start=start).equilibria[-1]
                row["kind"], row["gain"] = local(robot, rest, target, asked.floor)
                if np.linalg.norm(rest.tip_position - result.tip) > ARRIVED:
                    row["kind"] = "another branch"
            if compares and counts(row, asked):
                row["closest"] = others[0] if others else closest(robot, target, asked.floor)
                if row["closest"] < row["distance"] - CLOSER:
                    rest = tubeopt.follow(robot, *([each] for each in row["joints"]), start=start).equilibria[-1]
                    row["closest from rest"] = lowest(robot, rest, target, asked.floor)
                    row["way"] = asked.seek and reachable(robot, start, target, asked.floor)
            if asked.jsonl:
                with asked.jsonl.open("a") as file:
                    print(json.dumps(row), file=file)
        counted += counts(row, asked)
        yield row


def counts(row: dict[str, Any], asked: argparse.Namespace) -> bool:
    """Whether a motion is one that is asked for."""
    return bool(asked.reach or row["distance"] >= NEAR)


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
        f"{max(row['rate'] for row in rows):.9f}",
        f"{max(speeds):.9f}",
        f"{min(row['margin'] for row in rows):.4f}",
        sum(row["distance"] > ARRIVED and not row["why"] for row in rows),
        sum(row["distance"] < NEAR for row in rows),
        f"{sum(each <= CLOSER for each in off)} of {len(known)}",
        sum(row["distance"] - row.get("closest from rest", np.inf) > CLOSER for row in known),
        sum(row.get("way", False) for row in known),
        f"{np.median([row['milliseconds'] for row in rows]):.3f}",
        sum(row.get("snaps", 0) for row in rows),
        ", ".join(f"{count} {kind}" for kind, count in Counter(row["kind"] for row in rows if "kind" in row).items()),
        f"{1e9 * max((row['gain'] for row in rows if 'gain' in row), default=np.nan):.0f}",
    )
    return [str(cell) for cell in cells]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", nargs="+", default=ROBOTS)
    parser.add_argument("--targets", type=int, default=1000, help="number, over all robots")
    parser.add_argument("--kind", choices=("python", "c", "server"), default="c")
    parser.add_argument("--compare", type=int, default=0, help="motions of each robot compared with ik --closest")
    parser.add_argument("--seek", action="store_true", help="commands that ask for the closest pose")
    parser.add_argument("--certify", type=int, default=0, help="motions of each robot whose rest is looked into")
    parser.add_argument("--dt", type=float, default=2e-3, help="cycle, s")
    parser.add_argument("--floor", type=float, default=0.1, help="of the margin")
    parser.add_argument("--snap-deg", type=float, default=0.0, help="least snap distance in place of the floor")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--reach", action="store_true", help="targets within reach")
    parser.add_argument("--unlimited", action="store_true", help="without limits of accelerations")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--jsonl", type=Path, help="file of motions, a line each, to go on with")
    parser.add_argument("--verbose", action="store_true", help="each motion as it ends")
    parser.add_argument("--json", action="store_true", help="each motion, as JSON")
    asked = parser.parse_args()
    known = []
    if asked.jsonl and asked.jsonl.exists():
        known = [json.loads(line) for line in asked.jsonl.read_text().splitlines()]
    # In turn, so that an unfinished file is of all robots alike.
    motions, rows = {name: measure(name, asked, known) for name in asked.robots}, list[dict[str, Any]]()
    for _ in range(asked.targets // len(asked.robots)):
        for name in asked.robots:
            rows.append(next(row for row in motions[name] if counts(row, asked)))
            if asked.verbose:
                print(rows[-1], file=sys.stderr, flush=True)
    if asked.json:
        dump({"motions": rows})
        return
    first = "", "motions", "s to rest", "most", "reverse", "rate / limit", "a / limit", "least margin"
    named = "no reason", "met", "as close", "closer from rest", "closer by a way"
    columns = *first, *named, "ms / step", "snaps", "kinds", "gain, nm"
    lines = [summary(name, [row for row in rows if row["robot"] == name]) for name in asked.robots]
    show([table("motions to random targets", columns, [*lines, summary("all", rows)])], [])


if __name__ == "__main__":
    main()
