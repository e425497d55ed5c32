"""Time of equilibria under load, of their limits and of the force told from a shape.

    python -m benchmarks.loads [--robot FILE] [--solves N] [--json]

Cold: from no load, at other rotations each time. Warm: rotations move by half a degree, or the force by a tenth of a
millinewton, from the equilibrium before. Batch: configurations in one call. All include shape, margin, compliance, base
wrench and error estimates; processor times on one thread, with what is built for a robot built before.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from tubeopt import (
    Load,
    estimate_force,
    find_load_limit,
    forward_kinematics,
    forward_kinematics_batch,
    load_robot,
    snap_free_certificate,
)

from .timing import ROOT, Timing, clock, dump, milliseconds, show, summarise, table

FORCE = np.array([0.1, 0.0, 0.0])
TURN = np.pi / 360
MOST = 1e-4

TARGETS = {"warm": 0.5e-3, "cold": 2e-3, "batch, per configuration": 0.2e-3, "force from the tip, warm": 5e-3}
"""Seconds that a compiled kernel should take."""


def measure(path: Path, solves: int) -> dict[str, Timing]:
    """Times of one robot."""
    robot, random = load_robot(path), np.random.default_rng(0)
    rotations = random.uniform(-1, 1, (solves, robot.n_tubes))
    load = Load(tuple(FORCE))
    forward_kinematics(robot, rotations[0], load=load)
    cold = [clock(lambda a=alpha: forward_kinematics(robot, a, load=load))[0] for alpha in rotations]
    current, turning, pushing, report = forward_kinematics(robot, rotations[0], load=load), [], [], []
    for _ in range(solves):
        alpha = current.rotations + random.uniform(-TURN, TURN, robot.n_tubes)
        seconds, current = clock(lambda a=alpha, e=current: forward_kinematics(robot, a, load=load, start=e))
        turning.append(seconds)
    force = FORCE.copy()
    for _ in range(solves):
        force = force + random.uniform(-MOST, MOST, 3)
        other = Load(tuple(force))
        seconds, current = clock(lambda q=other, e=current: forward_kinematics(robot, e.rotations, load=q, start=e))
        pushing.append(seconds)
        tip = current.tip_position + random.normal(size=3) * 1e-6
        call = lambda p=tip, e=current: estimate_force(robot, e.rotations, tip_position=p, noise=1e-4, start=e)  # noqa: E731
        report.append(clock(call)[0])
    many = clock(lambda: forward_kinematics_batch(robot, rotations, load=load))[0] / solves
    limit = [clock(lambda a=a: find_load_limit(robot, a, None, load, up_to=4.0))[0] for a in rotations[:3]]
    proof = [clock(lambda: snap_free_certificate(robot, max_force=0.01))[0] for _ in range(3)]
    return {
        "cold": summarise(cold),
        "warm": summarise(turning),
        "warm, another force": summarise(pushing),
        "batch, per configuration": summarise([many]),
        "force from the tip, warm": summarise(report),
        "load limit, none up to 4": summarise(limit),
        "certificate": summarise(proof),
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--robot", type=Path, default=ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    parser.add_argument("--solves", type=int, default=100)
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    options = parser.parse_args()
    times = measure(options.robot, options.solves)
    if options.json:
        dump({name: {"median": t.median, "target": TARGETS.get(name)} for name, t in times.items()})
        return
    rows = [
        (name, milliseconds(t.median), f"{TARGETS[name] * 1e3:g}" if name in TARGETS else "")
        for name, t in times.items()
    ]
    show([table("under load", ["what", "time (ms)", "target (ms)"], rows)], ())


if __name__ == "__main__":
    main()
