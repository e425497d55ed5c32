"""The inner tube of the robot of the thesis turned by 270 deg: straight it snaps at 214 deg, planned it does not.

Result: a detour avoids the snap. Withdrawn tubes overlap less, so they couple less.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.show.plots.trajectory import plot_trajectory

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path) -> list[Path]:
    """Check the straight path, plan the other, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    goal = [np.radians(270.0), 0.0, 0.0]
    naive = tubeopt.verify_trajectory(robot, [0.0, 10.0], [[0.0, 0.0, 0.0], goal])
    print(f"turned straight: {'; '.join(naive.faults)}")
    start = tubeopt.forward_kinematics(robot, [0.0, 0.0, 0.0])
    plan = tubeopt.plan_trajectory(robot, start, (goal, None), min_margin=0.05)
    proof = plan.proof
    print(f"planned: least margin {proof.least_margin:.3f}, {plan.time[-1]:.1f} s, proved: {proof.holds}")
    print(f"withdrawn by up to {-plan.translations.min() * 1e3:.1f} mm in between")
    picture = out / "plan_thesis_turn.png"
    plot_trajectory(plan, picture, title=f"{robot.name}: tube 1 turned by 270° at home, by withdrawing")
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
