"""A helix drawn by the tip of the robot of the thesis, within half a millimetre, on one stable branch.

Result: rotations and translations together follow a path of the tip within a tolerance, with the required margin at all
times.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.show.plots.trajectory import plot_trajectory

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path) -> list[Path]:
    """Follow the curve, print the deviation of the tip, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    turn = np.linspace(0.0, 4 * np.pi, 80)
    helix = np.column_stack([0.012 * np.cos(turn), 0.012 * np.sin(turn) - 0.03, 0.12 + 0.02 * turn / turn[-1]])
    plan = tubeopt.follow_tip_path(robot, helix)
    assert plan.deviation is not None
    print(f"the tip stays within {plan.deviation.max() * 1e3:.3f} mm of the helix")
    print(f"least margin {plan.proof.least_margin:.3f}, {plan.time[-1]:.1f} s, proved: {plan.proof.holds}")
    picture = out / "plan_helix.png"
    plot_trajectory(plan, picture, title=f"{robot.name}: a helix of 12 mm radius drawn by the tip")
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
