"""Rotations that make an arm the stiffest against a transverse force, with its tip at a given height.

Castigliano's theorem gives the displacement of the tip per newton by bending: the integral of |m|^2 / K along the arm.
Here m is the transverse moment of the force, and K the bending stiffness of the tubes at this point. The torsion of the
tubes is fixed. If it changes too, the arm is softer, never stiffer.

Result: an own objective is a sum over points along the arm.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

import tubeopt
from tubeopt.show.plots import plot_shapes

ROOT = Path(__file__).resolve().parents[1]
PUSH = ca.DM([1.0, 0.0, 0.0])
HEIGHT = 0.175


def softness(block: tubeopt.EquilibriumBlock[tubeopt.Equilibrium]) -> ca.MX:
    """Displacement of the tip along the force by bending, m/N: three Gauss points per section between tube ends."""
    robot, ends = block.robot, sorted(tube.curved_length for tube in block.robot.tubes)
    total = ca.MX(0.0)
    for low, high in zip([0.0, *ends], ends, strict=False):
        stiffness = sum(tube.bending_stiffness for tube in robot.tubes if tube.curved_length > low)
        for x, weight in zip(*np.polynomial.legendre.leggauss(3), strict=True):
            fraction = (low + (1 + x) / 2 * (high - low)) / ends[-1]
            moment = ca.cross(block.tip_position - block.position(fraction), PUSH)
            across = (block.orientation(fraction).T @ moment)[:2]
            total += weight / 2 * (high - low) * ca.sumsqr(across) / stiffness
    return total


def main(out: Path) -> list[Path]:
    """Find the stiffest and the softest arm, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    near = tubeopt.forward_kinematics(robot, [0.2, 1.0, 2.0])
    opti = ca.Opti()
    rotations, sign = opti.variable(3), opti.parameter()
    opti.set_initial(rotations, near.rotations)
    block = tubeopt.EquilibriumBlock(opti, near, rotations=rotations)
    block.margin_at_least(0.2)
    opti.subject_to(block.tip_position[2] == HEIGHT)
    opti.subject_to(opti.bounded(-2 * np.pi, rotations, 2 * np.pi))
    give = softness(block)
    opti.minimize(sign * give)
    settings: dict[str, Any] = {"print_level": 0, "sb": "yes", "mu_strategy": "adaptive"}
    opti.solver("ipopt", {"print_time": False, "expand": True}, settings)
    poses, titles = [], []
    for name, which in (("stiffest", 1.0), ("softest", -1.0)):
        opti.set_value(sign, which)
        solution = opti.solve()
        poses.append(block.equilibrium(solution))
        path = 1e3 * solution.value(give)
        titles.append(f"{name}: {path:.2f} mm/N along x")
        turned = np.degrees(poses[-1].rotations).round(1) + 0.0
        print(f"{titles[-1]} by bending, at rotations {turned} deg, margin {poses[-1].margin:.3f}")
    picture = out / "own_stiffest_direction.png"
    plot_shapes(poses, picture, titles=titles)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
