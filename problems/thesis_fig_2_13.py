"""Figure 2.13 of the thesis: its three-tube robot before and after a snap while the inner tube turns.

Result: the tip jumps by 98 mm, half the length of the arm, at 214.22 deg. At 213 deg only the margin announces it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.show.plots import plot_snap

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path) -> list[Path]:
    """Find the snap, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    snap = tubeopt.find_snap(robot, (np.zeros(3), None), (np.radians([360.0, 0.0, 0.0]), None))
    if snap is None:
        raise SystemExit("the robot does not snap")
    print(f"snap at {np.degrees(snap.rotations[0]):.6f} deg: the tip jumps by {snap.tip_jump * 1e3:.2f} mm")
    picture = out / "thesis_snap.png"
    plot_snap(snap, picture)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
