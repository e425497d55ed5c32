"""The least joint motion between two tips of a robot that snaps, with a margin of at least 0.2 throughout.

One nonlinear program has eleven equilibria: a block for every knot of the motion, with unknown joint values. Both tips
belong to opposed tubes with opposite twist. The straight joint path between them snaps. There are no constraints
between the knots, so the tips may turn only a little from knot to knot.

Result: the detour around the snap uses translations. The program is one sum of squares and one constraint on the
margin.
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path

import casadi as ca
import numpy as np

import tubeopt
from tubeopt.show.plots import plot_shape

ROOT = Path(__file__).resolve().parents[1]
KNOTS = 11
STEP = 0.6
"""Largest turn (rad) of the tubes' tips against each other from knot to knot: no knot lies behind a snap."""
PER_METRE = 20.0
"""1 rad of rotation counts as much as 50 mm of translation."""


def main(out: Path) -> list[Path]:
    """State the motion, solve it, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "two_tube.yaml")
    begin, end = np.array([np.radians(150), 0.0, -0.005, -0.01]), np.array([np.radians(210), 0.0, -0.005, -0.01])
    goal = tubeopt.forward_kinematics(robot, end[:2], end[2:])
    dip = np.array([0.0, 0.0, -0.05, -0.055])  # start of the search: tubes withdrawn between the ends

    problem = tubeopt.Problem("least motion")
    blocks, joints = [], []
    for k, part in enumerate(np.linspace(0, 1, KNOTS)):
        guess = begin + part * (end - begin) + np.sin(np.pi * part) * dip
        near = tubeopt.forward_kinematics(robot, guess[:2], guess[2:])
        joints.append(
            problem.variable(f"joints {k}", 4, guess=guess, lower=[-7, -7, -0.1, -0.1], upper=[7, 7, 0.05, 0.05])
        )
        blocks.append(
            tubeopt.EquilibriumBlock(problem, near, rotations=joints[k][:2], translations=joints[k][2:], refinement=0)
        )
        blocks[k].margin_at_least(0.2)
        turned = ca.dot(blocks[k].tip_rotations - (blocks[k - 1].tip_rotations if k else 0.0), ca.DM([1, -1]))
        if k:
            problem.subject_to(f"turn {k}", turned, lower=-STEP, upper=STEP)
    weight = ca.DM([1, 1, PER_METRE, PER_METRE])
    problem.subject_to("start", joints[0] == begin)
    problem.subject_to("tip at the end", blocks[-1].tip_position == goal.tip_position)
    problem.minimize(sum(ca.sumsqr(weight * (b - a)) for a, b in pairwise(joints)))
    solution = problem.solve()

    poses = [block.equilibrium(solution) for block in blocks]
    way = np.array([solution.value(each) for each in joints])
    print(f"{solution.status} in {solution.statistics.iterations} iterations: {solution.statistics.unknowns} unknowns")
    print("margins at the knots:", ", ".join(f"{pose.margin:.3f}" for pose in poses))
    for name, path in (("least motion", way), ("straight", way[[0, -1]])):
        print(f"{name}: {len(tubeopt.follow(robot, path[:, :2], path[:, 2:]).snaps)} snaps")
    picture = out / "own_least_motion.png"
    plot_shape(poses[-1], picture, ghosts=poses[:-1])
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
