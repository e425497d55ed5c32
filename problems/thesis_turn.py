"""A film of the robot of the thesis while its inner tube turns once: the arm moves smoothly, snaps, and moves on.

Result: the margin stays near 1 for half a turn and falls to 0 in the last 40 deg before the snap at 214.22 deg. There
the tip jumps by 98 mm, and the arm is stable again.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.show.plots import animate_path

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path, samples: int = 61) -> list[Path]:
    """Follow the turn through `samples` waypoints, save the film into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    angles_deg = np.linspace(0.0, 360.0, samples)
    turned = tubeopt.follow(robot, np.radians(angles_deg)[:, None] * [1.0, 0.0, 0.0])
    for snap in turned.snaps:
        where, jump = np.degrees(snap.rotations[0]), snap.tip_jump * 1e3
        print(f"snaps at {where:.2f} deg, the tip jumps by {jump:.1f} mm")
    film = out / "thesis_turn.gif"
    animate_path(turned, film, values=angles_deg, name="rotation of tube 1 (deg)")
    return [film]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the film")
    parser.add_argument("--samples", type=int, default=61, help="waypoints")
    args = parser.parse_args()
    for path in main(args.out, args.samples):
        print(f"saved {path}")
