"""In the loop: a robot as a C library beside the robot in Python, and a minute of teleoperation at 1 kHz.

    python -m benchmarks.control [--configurations 10000] [--seconds 60] [--json] [--against DIRECTORY]

The C library: tips at random configurations within the limits, derivatives on every hundredth of them. Teleoperation:
the tip is led for 60 s to one place after another, most of which a straight motion of the joints reaches by a snap, by
the C library and by the servo in Python; `follow`, which knows nothing of either, then looks at the joint values sent.
Bodies: steps of the servo in Python among spheres. Times are processor times of one step, called from Python. With
`--against` the package of another checkout leads in turn with this one, and times stand side by side.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import tubeopt
from benchmarks.timing import ROOT, dump, milliseconds, show, table, with_package
from tubeopt.bodies.obstacles import Obstacle, Sphere
from tubeopt.control.c_binding import CRobot, CServo
from tubeopt.control.c_library import c_library
from tubeopt.control.command import Command, ServoOptions, Why
from tubeopt.control.servo import Servo
from tubeopt.inverse.joints import joint_space
from tubeopt.typing import Array

DT, LEG, FLOOR = 1e-3, 2.0, 0.1
"""Step (s), time for each place (s), floor of the margin."""

OPTIONS = ServoOptions(speed=0.06, turn_rate=3.0, shift_rate=0.05, min_margin=FLOOR)


Times = dict[str, tuple[float, float]]
"""What took how long per step, s: in the median, and at 99.9 %."""

ROBOTS = [f"configs/robots/{name}.yaml" for name in ("thesis_ctr", "crl_ctr", "example_pieces", "thesis_etr")]
"""Concentric ones of one arc per tube, one of tubes made of pieces, and an eccentric one."""


def joints_of(robot: Any, count: int) -> tuple[Array, Array]:
    """Rotations and translations (count, n) within the limits."""
    space = joint_space(robot)
    some = space.sample(count) @ space.spread.T + space.offset
    joints = np.tile(some, (count // len(some) + 1, 1))[:count]
    rotations, translations = np.split(joints, 2, axis=1)
    again = rotations[len(some) :]
    rotations[len(some) :] = np.random.default_rng(0).uniform(-np.pi, np.pi, again.shape)
    return rotations, translations


def compare(robot: Any, count: int) -> None:
    """Tips and derivatives of the library beside those of Python."""
    library = CRobot(c_library(robot))
    rotations, translations = joints_of(robot, count)
    known = tubeopt.forward_kinematics_batch(robot, rotations, translations)
    tips, slopes, declined = [], [], 0
    for k in range(count):
        try:
            pose = library.solve(rotations[k], translations[k])
        except tubeopt.SolveError:
            declined += 1
            continue
        tips.append(np.linalg.norm(pose.tip_position - known.tip_position[k]))
        if k % 100 == 0:
            jacobian = tubeopt.forward_kinematics(robot, rotations[k], translations[k]).jacobian()
            slopes.append(np.abs(library.slopes().position - jacobian.position).max())
    print(f"C library of {robot.name}: {len(tips)} configurations, {declined} declined")
    print(f"  tips differ by {max(tips):.1e} m at most, derivatives of {len(slopes)} by {max(slopes):.1e} m/rad or 1")


def compare_loaded(robot: Any, count: int) -> None:
    """Tips under a force and weight of the library beside those of Python."""
    library = CRobot(c_library(robot, loads=True))
    load = tubeopt.Load(force=(2e-3, -4e-3, 1e-3), gravity=(0.0, 0.0, -9.81))
    rotations, translations = joints_of(robot, count)
    known = tubeopt.forward_kinematics_batch(robot, rotations, translations, load=load)
    tips, declined = [], 0
    for k in np.flatnonzero(np.isfinite(known.margin)):
        try:
            library.solve(rotations[k], translations[k])
            pose = library.bear(load.force, load.gravity)
            library.bear()
        except tubeopt.SolveError:
            declined += 1
            continue
        tips.append(np.linalg.norm(pose.tip_position - known.tip_position[k]))
    far = np.count_nonzero(np.array(tips) > 1e-9)
    print(f"C library of {robot.name} under load: {len(tips)} configurations, {declined} declined, {far} differ")
    print(f"  the other tips by {max(tip for tip in tips if tip <= 1e-9):.1e} m at most")


def teleoperate(robot: Any, seconds: float) -> Times:
    """The tip led to one place after another by both servos, and what `follow` says of it."""
    times: Times = {}
    rotations, translations = joints_of(robot, 64)
    batch = tubeopt.forward_kinematics_batch(robot, rotations, translations)
    chosen = np.flatnonzero(batch.margin > 3 * FLOOR)[: int(seconds / LEG) + 1]
    straight = tubeopt.follow(robot, rotations[chosen], translations[chosen])
    print(f"{len(chosen) - 1} straight ways of the joints between the places have {len(straight.snaps)} snaps")
    seed = rotations[chosen[0]], translations[chosen[0]]
    targets = batch.tip_position[chosen[1:]]
    for name, servo in (
        ("C library", CServo(c_library(robot), seed, OPTIONS)),
        ("Python", Servo(robot, seed, options=OPTIONS)),
    ):
        sent, took, held = lead(servo.step, targets, int(seconds / DT))
        n = robot.n_tubes
        first = tubeopt.forward_kinematics(robot, *seed)
        every = np.concatenate([sent[::40], sent[-1:]])
        way = tubeopt.follow(robot, every[:, :n], every[:, n:], start=first)
        fastest = np.abs(np.diff(sent, axis=0)).max(0) / DT
        times[f"servo, {name}"] = median, rare = spread(took)
        print(f"{name}: {len(sent)} steps, {len(way.snaps)} snaps, {held} held")
        print(f"  least margin {min(e.margin for e in way.equilibria):.4f}, floor {FLOOR}")
        kept = max(fastest[:n].max() / OPTIONS.turn_rate, fastest[n:].max() / OPTIONS.shift_rate) <= 1 + 1e-9
        print(
            f"  fastest {np.degrees(fastest[:n].max()):.1f} deg/s and {fastest[n:].max() * 1e3:.1f} mm/s, allowed "
            f"{np.degrees(OPTIONS.turn_rate):.1f} and {OPTIONS.shift_rate * 1e3:.1f}: {'kept' if kept else 'BROKEN'}"
        )
        print(f"  step {milliseconds(median)} ms in the median, {milliseconds(rare)} ms at 99.9 %")
    return times


def spread(took: Array) -> tuple[float, float]:
    """Median and 99.9 % of times (T,)."""
    median, rare = np.quantile(took, [0.5, 0.999]).tolist()
    return median, rare


def lead(step: Callable[[Command, float], Any], targets: Array, steps: int) -> tuple[Array, Array, int]:
    """Joint values sent (T, 2n), processor time (T,) s of the steps, and how many were held."""
    sent, took, held = [], [], 0
    for k in range(steps):
        command = Command(position=targets[int(k * DT / LEG) % len(targets)])
        start = time.process_time()
        done = step(command, DT)
        took.append(time.process_time() - start)
        sent.append(np.concatenate([done.equilibrium.rotations, done.equilibrium.translations]))
        held += Why.HELD in done.why
    return np.array(sent), np.array(took), held


def among_bodies(robot: Any) -> Times:
    """Steps of the servo in Python among spheres that leave the arm some room."""
    times: Times = {}
    rotations, translations = joints_of(robot, 64)
    seed = tubeopt.forward_kinematics(robot, rotations[0], translations[0])
    for count in (0, 10, 100, 1000):
        servo = Servo(robot, seed, obstacles=spheres(seed, count), options=OPTIONS)
        circle = [seed.tip_position + 4e-3 * np.array([np.cos(a) - 1, np.sin(a), 0]) for a in np.linspace(0, 6.28, 20)]
        _, took, _ = lead(servo.step, np.array(circle), 1000)
        times[f"servo, Python, {count} spheres"] = median, rare = spread(took)
        print(f"{count:5d} spheres: step {milliseconds(median)} ms in the median, {milliseconds(rare)} ms at 99.9 %")
    return times


def spheres(seed: tubeopt.Equilibrium, count: int) -> Sequence[Obstacle]:
    """Spheres of 2 mm in a box about the arm, at least 10 mm from it."""
    random, found = np.random.default_rng(0), []
    while len(found) < count:
        centre = random.uniform(-0.2, 0.2, 3)
        if np.linalg.norm(seed.position - centre, axis=1).min() > 0.012:
            found.append(Sphere(tuple(centre), 2e-3))
    return found


def compare_with(checkout: Path, arguments: Sequence[str]) -> None:
    """Times with the package of another checkout and with this one, each twice by turns: of both the shorter one, since
    others on the machine only make them longer."""
    runs = [
        with_package(folder, "benchmarks.control", arguments)["times"] for folder in (checkout, ROOT, ROOT, checkout)
    ]
    rows = []
    for what in runs[0]:
        there, here = (np.minimum(runs[a][what], runs[b][what]).tolist() for a, b in ((0, 3), (1, 2)))
        rows.append((what, *map(milliseconds, (*there, *here)), f"{here[0] / there[0]:.2f}"))
    columns = "", "ms there", "99.9 %", "ms here", "99.9 %", "here / there"
    show([table("steps of the servo, side by side", columns, rows)], [])


def main() -> None:
    """Print all of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", nargs="+", default=ROBOTS, help="of which the first is led")
    parser.add_argument("--configurations", type=int, default=10_000, help="compared with Python; 0: none")
    parser.add_argument("--seconds", type=float, default=60.0, help="of teleoperation")
    parser.add_argument("--json", action="store_true", help="times alone, as JSON")
    parser.add_argument("--against", type=Path, metavar="DIRECTORY", help="another checkout, measured in turn")
    options = parser.parse_args()
    if options.against:
        compare_with(options.against.resolve(), ["--robots", options.robots[0], "--seconds", str(options.seconds)])
        return
    robots = [tubeopt.load_robot(path) for path in options.robots]
    with contextlib.redirect_stdout(sys.stderr if options.json else sys.stdout):
        if options.configurations and not options.json:
            for robot in robots:
                compare(robot, options.configurations)
            for robot in robots:
                if not robot.assembly(robot.home_translations).eccentric:
                    compare_loaded(robot, options.configurations)
        times = teleoperate(robots[0], options.seconds) | among_bodies(robots[0])
    if options.json:
        dump({"times": times})


if __name__ == "__main__":
    main()
