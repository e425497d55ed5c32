"""A motion of the robot of the thesis into a bent vessel of 12 mm radius, without contact with the wall.

Result: the whole arm must fit, not only its tip. Clearance and margin are kept along its surface and at all times.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.bodies.corridors import Corridor
from tubeopt.show.plots.trajectory import plot_trajectory

ROOT = Path(__file__).resolve().parents[1]

DEG = np.pi / 180


def main(out: Path) -> list[Path]:
    """Plan, print the proof, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    inside = tubeopt.forward_kinematics(robot, [100 * DEG, 40 * DEG, 0.0], [-0.03, -0.04, -0.02])
    positions = np.linspace(0.0, inside.arc_length[-1], 14)
    bend = np.column_stack([np.interp(positions, inside.arc_length, inside.position[:, k]) for k in range(3)])
    beyond = inside.tip_position + 0.02 * inside.tip_rotation[:, 2]
    vessel = Corridor(tuple(map(tuple, np.vstack([[0.0, 0.0, -0.03], bend, beyond]).tolist())), 0.012)
    outside = ([-80 * DEG, 0.0, 0.0], [-0.17, -0.13, -0.085])
    options = tubeopt.PlanOptions(clearance=1e-3)
    plan = tubeopt.plan_trajectory(robot, outside, inside, obstacles=[vessel], options=options)
    proof = plan.proof
    print(f"clearance at least {proof.least_clearance * 1e3:.2f} mm at all times")
    print(f"least margin {proof.least_margin:.3f}, {plan.time[-1]:.1f} s, proved: {proof.holds}")
    picture = out / "plan_corridor.png"
    plot_trajectory(plan, picture, title=f"{robot.name} in a bent vessel of 12 mm radius")
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
