"""Figure 3.8 of the thesis: workspace of its eccentric robot under mirror actuation, by direction and separation.

Result: two numbers, a direction and a separation, replace the three rotations. They are easier to understand.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.inverse.mirror import mirror_rotations
from tubeopt.show.plots.eccentric import arm_curve, plot_reach

ROOT = Path(__file__).resolve().parents[1]
SEPARATIONS = np.radians(np.linspace(0.0, 120.0, 13))
DIRECTIONS = np.radians(np.arange(0.0, 360.0, 10.0))


def main(out: Path) -> list[Path]:
    """Solve a grid of directions and separations, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_etr.yaml")
    curves, planar = [], 0.0
    for separation in SEPARATIONS:
        for direction in DIRECTIONS:
            solved = tubeopt.forward_kinematics(robot, mirror_rotations(direction, separation))
            curves.append(arm_curve(solved, float(np.degrees(separation))))
            # A tube of rotation 0 bends in the plane x = 0.
            across = np.array([np.cos(direction), np.sin(direction), 0.0])
            planar = max(planar, float(np.abs(solved.position @ across).max()))
    print(f"{len(curves)} configurations; no arm leaves the plane of its direction by more than {planar * 1e3:.4f} mm")
    picture = out / "thesis_etr_mirror.png"
    title = f"{robot.name}: arms and tips under mirror actuation, every 10° of direction and separation"
    plot_reach(curves, picture, title=title, label="separation (deg)", opacity=0.35)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
