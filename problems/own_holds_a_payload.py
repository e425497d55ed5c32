"""Joint values that keep the tip in place while a payload is added.

A force of 100 mN moves the tip of the robot of the thesis by 19 mm. The block includes the load: the tip of the loaded
arm is an expression of the joint values. One program finds the smallest joint motion.

Result: a load is an argument of the block. The block starts at the equilibrium under this load.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import casadi as ca
import numpy as np

import tubeopt
from tubeopt.show.plots import plot_shapes

ROOT = Path(__file__).resolve().parents[1]
LOAD = tubeopt.Load((0.0, -0.1, 0.0))
SHIFT = np.array([-0.06, -0.04, -0.03])


def main(out: Path) -> list[Path]:
    """Find the joint values, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    free = tubeopt.forward_kinematics(robot, [0.0, 1.0, 2.0], SHIFT)
    near = tubeopt.forward_kinematics(robot, free.rotations, SHIFT, load=LOAD)

    problem = tubeopt.Problem("payload")
    turn = problem.variable("rotations", 3, guess=near.rotations)
    shift = problem.variable("translations", 3, guess=near.translations, scale=0.1)
    block = tubeopt.EquilibriumBlock(problem, near, rotations=turn, translations=shift)
    problem.subject_to("tip", block.tip_position == free.tip_position, scale=0.1)
    problem.minimize(ca.sumsqr(turn - near.rotations) + ca.sumsqr((shift - near.translations) / 0.05))
    held = block.equilibrium(problem.solve())

    sag = 1e3 * np.linalg.norm(near.tip_position - free.tip_position)
    off = 1e6 * np.linalg.norm(held.tip_position - free.tip_position)
    print(f"the payload moves the tip by {sag:.2f} mm; with the joints moved it is {off + 0:.3f} um off")
    turned, moved = np.degrees(held.rotations - near.rotations), 1e3 * (held.translations - near.translations)
    print(f"turned by {turned.round(2) + 0.0} deg, moved by {moved.round(2) + 0.0} mm, margin {held.margin:.3f}")
    picture = out / "own_holds_a_payload.png"
    plot_shapes([free, near, held], picture, titles=["without load", "with a payload", "held by the joints"])
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
