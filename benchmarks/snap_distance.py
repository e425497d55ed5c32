"""Motions inside the proved distance from a snap: whether any of them snaps.

    python -m benchmarks.snap_distance [--legs 500] [--robots thesis_ctr ...] [--seed 0]

Every robot of configs/robots with concentric tubes stands at random joint values. Legs lead between random corners of
the ball of turns that is proved there, and of the box of turns and slides, where slides are known; `follow` goes along
them with no knowledge of the ball. Counted: snaps, ends off the branch of the centre, balls beyond the nearest snap
that is found by turning one tube, and least margins below 0. Printed as well: processor time of a distance.
"""

from __future__ import annotations

import argparse
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import tubeopt
from benchmarks.timing import ROOT, show, table
from tubeopt.errors import ImplausibleWarning
from tubeopt.inverse.joints import joint_space

INSIDE, LEGS, SAME = 0.9999, 10, 1e-6
"""Share of a distance at which corners lie, legs at a pose, and distance (m) of two tips that are one."""

TURN, SHIFT = 3.0, 0.03
"""Rates of the box, rad/s and m/s: 10 mm/rad."""


def attacked(path: Path, number: int, seed: int) -> dict[str, Any]:
    """Counts of so many legs of one robot."""
    robot = tubeopt.load_robot(path)
    out: dict[str, Any] = {"poses": 0, "certified": 0, "legs": 0, "with slides": 0, "snaps": 0, "off": 0, "too far": 0}
    if not isinstance(robot, tubeopt.ConcentricRobot):
        return out
    space, random, n = joint_space(robot), np.random.default_rng([seed, *path.stem.encode()]), robot.n_tubes
    many, times = space.sample(4096), []
    while out["legs"] < number and out["poses"] + out["certified"] < number:
        rotations, translations = space.split(many[random.integers(len(many))])
        arm = tubeopt.forward_kinematics(robot, rotations + np.pi * random.uniform(-1, 1, n), translations)
        if not arm.stable:
            continue
        begun = time.process_time()
        distance = tubeopt.snap_distance(arm)
        ball = distance.turn
        times.append(time.process_time() - begun)
        if ball == np.inf:
            out["certified"] += 1
            continue
        out["poses"] += 1
        folds = np.abs(distance.one_tube)
        out["too far"] += bool((ball > folds[np.isfinite(folds)] / 2 * (1 + 1e-6)).any())
        signs = random.choice([-1.0, 1.0], (LEGS, n)) * random.choice([1.0, random.uniform()], (LEGS, 1))
        turns, slides = INSIDE * ball * signs, np.zeros((LEGS, n))
        try:
            last = INSIDE * distance.time(TURN, SHIFT) if out["poses"] % 2 else np.inf
        except tubeopt.InputError:  # tubes made of pieces
            last = np.inf
        if last < np.inf:
            turns, slides = TURN * last * signs, SHIFT * last * random.choice([-1.0, 1.0], (LEGS, n))
            out["with slides"] += LEGS
        to = np.vstack([0 * turns[:1], turns, 0 * turns[:1]]) + arm.rotations
        shift = np.vstack([0 * slides[:1], slides, 0 * slides[:1]]) + arm.translations
        try:
            passed = tubeopt.follow(robot, to, shift, start=arm)
        except tubeopt.InputError:  # a slide beyond the plate
            continue
        out["legs"] += LEGS
        out["snaps"] += len(passed.snaps)
        out["off"] += float(np.linalg.norm(passed.equilibria[-1].tip_position - arm.tip_position)) > SAME
    out["ms, median"] = f"{1e3 * np.median(times):.2f}"
    return out


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    known = sorted((ROOT / "configs/robots").glob("*.yaml"))
    parser.add_argument("--robots", nargs="+", default=[path.stem for path in known])
    parser.add_argument("--legs", type=int, default=500, help="of each robot that can snap")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    warnings.simplefilter("ignore", ImplausibleWarning)  # of tubes that are wound up
    rows = []
    for name in asked.robots:
        counts = attacked(ROOT / f"configs/robots/{name}.yaml", asked.legs, asked.seed)
        rows.append((name, *(str(each) for each in counts.values())))
    columns = "", "poses", "certified", "legs", "with slides", "snaps", "off", "too far", "ms, median"
    sums = [str(sum(int(row[k]) for row in rows)) for k in range(1, 8)]
    show([table("motions inside proved distances", columns, [*rows, ("all", *sums, "")])], [])


if __name__ == "__main__":
    main()
