"""Tubes and rotations estimated from a measured shape: ten points of three arms, with noise of 0.2 mm.

Three blocks share the curvatures and the zeros of the drives. The objective is the sum of squared distances. The
measurement comes from tubes that the estimate does not know.

Result: points along the arm determine curvatures to about a percent, and the zeros of the drives to fractions of a
degree.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np

import tubeopt
from tubeopt.show.plots import plot_shapes

ROOT = Path(__file__).resolve().parents[1]
NOISE = 0.2e-3
COMMANDS = ((0.0, 0.8), (1.5, 0.3), (-1.0, 1.0))
FRACTIONS = np.linspace(0.1, 1.0, 10)


def measure(robot: tubeopt.ConcentricRobot) -> list[np.ndarray]:
    """Points (10, 3) along the arms of the true tubes, m."""
    bends, zeros = (13.4, 11.9), np.radians([3.0, -2.0])
    tubes = tuple(replace(tube, curvature=bend) for tube, bend in zip(robot.tubes, bends, strict=True))
    arms = [tubeopt.forward_kinematics(replace(robot, tubes=tubes), np.array(turn) + zeros) for turn in COMMANDS]
    random = np.random.default_rng(0)
    picked = [
        np.array([np.interp(FRACTIONS * arm.arc_length[-1], arm.arc_length, axis) for axis in arm.position.T]).T
        for arm in arms
    ]
    return [points + random.normal(0, NOISE, points.shape) for points in picked]


def main(out: Path, samples: int = len(COMMANDS)) -> list[Path]:
    """Estimate the tubes from `samples` poses, print them, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "two_tube.yaml")
    assert isinstance(robot, tubeopt.ConcentricRobot)
    commands = COMMANDS[:samples]
    measured = measure(robot)[:samples]

    opti = ca.Opti()
    curvature, zero = 10 * opti.variable(2), opti.variable(2)
    opti.set_initial(curvature, [tube.curvature for tube in robot.tubes])
    blocks, cost = [], 0.0
    for turn, points in zip(commands, measured, strict=True):
        near = tubeopt.forward_kinematics(robot, turn)
        block = tubeopt.EquilibriumBlock(opti, near, rotations=zero + ca.DM(turn), tubes={"curvature": curvature})
        cost += sum(ca.sumsqr((block.position(f) - point) / NOISE) for f, point in zip(FRACTIONS, points, strict=True))
        blocks.append(block)
    opti.minimize(cost)
    opti.solver("ipopt", {"print_time": False, "expand": True}, {"print_level": 0, "sb": "yes"})
    solution = opti.solve()

    poses = [block.equilibrium(solution) for block in blocks]
    print("curvatures (1/m):", np.round(solution.value(curvature), 2), "of 13.4 and 11.9")
    print("zeros (deg):", np.round(np.degrees(solution.value(zero)), 2), "of 3 and -2")
    print(f"root mean square of the residuals: {1e3 * NOISE * np.sqrt(solution.value(cost) / (30 * samples)):.3f} mm")
    picture = out / "own_shape_estimation.png"
    plot_shapes(
        poses, picture, titles=[f"commanded ({first:.0f}°, {second:.0f}°)" for first, second in np.degrees(commands)]
    )
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
