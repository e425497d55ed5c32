"""Figure 3.6 of the thesis: contours of the workspace, each the path of the tip when a bend of one size turns around.

Result: paths of the tip at one separation are circles within 0.014 mm. Direction and separation are nearly polar
coordinates.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.inverse.mirror import mirror_rotations
from tubeopt.show.plots.eccentric import Curve, plot_reach

ROOT = Path(__file__).resolve().parents[1]
SEPARATIONS = np.radians(np.arange(0.0, 120.0, 10.0))
DIRECTIONS = np.linspace(0.0, 2 * np.pi, 73)


def main(out: Path) -> list[Path]:
    """Trace a closed path of the tip for every separation, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_etr.yaml")
    curves = []
    for separation in SEPARATIONS:
        rotations = [mirror_rotations(direction, separation) for direction in DIRECTIONS]
        tips = np.array([tubeopt.forward_kinematics(robot, each).tip_position for each in rotations])
        radius = np.hypot(tips[:, 0], tips[:, 1]) * 1e3
        angle = f"separation {np.degrees(separation):3.0f} deg"
        print(f"{angle}: radius {radius.mean():.3f} mm, round to {np.ptp(radius):.4f} mm")
        curves.append(Curve(tips, float(np.degrees(separation)), tip=False))
    picture = out / "thesis_etr_contours.png"
    title = f"{robot.name}: paths of the tip as the direction turns, at separations of 0° to 110°"
    plot_reach(curves, picture, title=title, label="separation (deg)")
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
