"""Figure 3.5 of the thesis: workspace of its eccentric robot from 1,000 random rotations of the three tubes.

Result: three rotations move the tip on a surface, so one rotation is redundant. The margin is smallest in a ring around
the straight pose.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.show.plots.eccentric import arm_curve, plot_reach

ROOT = Path(__file__).resolve().parents[1]
SAMPLES = 1000


def main(out: Path, samples: int = SAMPLES) -> list[Path]:
    """Solve all configurations, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_etr.yaml")
    rotations = np.random.default_rng(35).uniform(0.0, 2 * np.pi, (samples, 3))
    solved = [tubeopt.forward_kinematics(robot, row) for row in rotations]
    curves = [arm_curve(each, each.margin) for each in solved]
    smallest = min(solved, key=lambda each: each.margin)
    print(
        f"{samples} configurations; least margin {smallest.margin:.3f} at {np.degrees(smallest.rotations).round(1)} deg"
    )
    picture = out / "thesis_etr_workspace.png"
    title = f"{robot.name}: arms and tips of {samples:,} random rotations of its three tubes"
    plot_reach(curves, picture, title=title, label="stability margin", opacity=0.25)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
