"""A full turn of the inner tube of the robot of the thesis, forward and back: two snaps at different angles.

Result: between the two snaps, at 145.78 and 214.22 deg, joint values alone do not determine the tip; the history does.
The margin falls like a square root, so it warns late.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.show.plots import plot_hysteresis

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path) -> list[Path]:
    """Follow both directions, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    angles_deg = np.linspace(0.0, 360.0, 361)
    rotations = np.radians(angles_deg)[:, None] * [1.0, 0.0, 0.0]
    forth = tubeopt.follow(robot, rotations)
    back = tubeopt.follow(robot, rotations[::-1], start=forth.equilibria[-1])
    for name, walked in (("forth", forth), ("back", back)):
        for snap in walked.snaps:
            print(
                f"{name}: snaps at {np.degrees(snap.rotations[0]):.6f} deg, the tip jumps by "
                f"{snap.tip_jump * 1e3:.2f} mm, {snap.energy_released * 1e3:.3f} mJ are released"
            )
    picture = out / "thesis_hysteresis.png"
    title = f"{robot.name}: a full turn of tube 1, forward and back"
    plot_hysteresis((forth, back), picture, angles_deg=angles_deg, title=title)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
