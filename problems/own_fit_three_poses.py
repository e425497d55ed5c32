"""Curvatures and lengths of two tubes with a tip that reaches three points: the least change, with margin 0.3.

Three blocks share the unknown tubes. The carriages are fixed in each pose; the rotations of each pose are unknown.

Result: dimensions are unknowns like joint values. A design with your own constraints takes a few lines. Every pose is
returned as an equilibrium that forward kinematics confirms.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import casadi as ca
import numpy as np

import tubeopt
from tubeopt.show.plots import plot_shapes

ROOT = Path(__file__).resolve().parents[1]
TARGETS_MM = ((24.2, -45.8, 74.0), (41.0, -41.8, 80.6), (18.1, -36.1, 71.8))
NEAR = (([0.0, 0.8], [-0.01, -0.03]), ([1.2, 0.2], [0.0, -0.05]), ([-0.6, 0.9], [-0.02, -0.04]))
"""Rotations to begin with (rad), and where the carriages stand (m)."""


def main(out: Path) -> list[Path]:
    """Fit the tubes, print them, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "two_tube.yaml")
    starts = [tubeopt.forward_kinematics(robot, *joints) for joints in NEAR]

    problem = tubeopt.Problem("tubes for three poses")
    curvature = problem.variable("curvature", 2, guess=12.5, lower=1.0, upper=30.0, scale=10.0)
    length = problem.variable("curved length", 2, guess=0.1, lower=0.03, upper=0.15, scale=0.1)
    blocks = []
    for k, (target, near) in enumerate(zip(TARGETS_MM, starts, strict=True), start=1):
        rotations = problem.variable(f"rotations {k}", 2, guess=near.rotations, lower=-7.0, upper=7.0)
        tubes = {"curvature": curvature, "curved_length": length}
        block = tubeopt.EquilibriumBlock(problem, near, rotations=rotations, tubes=tubes)
        block.margin_at_least(0.3)
        problem.subject_to(f"tip {k}", block.tip_position == np.array(target) * 1e-3, scale=0.1)
        blocks.append(block)
    problem.subject_to("the inner tube is not shorter", length[0] >= length[1], scale=0.1)
    problem.minimize(ca.sumsqr((curvature - 12.5) / 10) + ca.sumsqr((length - 0.1) / 0.1))
    solution = problem.solve()

    poses = [block.equilibrium(solution) for block in blocks]
    print(f"{solution.status}; breakpoints changed places {solution.statistics.reorderings} times")
    print("curvatures (1/m):", np.round(solution.value("curvature"), 4))
    print("curved lengths (mm):", np.round(1e3 * solution.value("curved length"), 3))
    for k, (pose, target) in enumerate(zip(poses, TARGETS_MM, strict=True), start=1):
        print(f"pose {k}: margin {pose.margin:.3f}, off by {np.linalg.norm(pose.tip_position * 1e3 - target):.1e} mm")
    picture = out / "own_fit_three_poses.png"
    plot_shapes(poses, picture, titles=[f"pose {k}" for k in range(1, len(poses) + 1)])
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
