"""Margin of the robot of the CRL data set over the rotations of its two inner tubes.

Result: a snap is a property of a path, not of joint values. The line of first snaps ends in a cusp. A path around the
cusp reaches the same shapes without a snap.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.show.plots import plot_stability_map

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path, samples: int = 90) -> list[Path]:
    """Compute the map with `samples` points per axis, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "crl_ctr.yaml")
    result = tubeopt.stability_map(robot, translations=np.zeros(3), samples=samples, directions=4 * samples)
    fraction = 100 * np.mean(result.snaps > 0)
    print(f"{fraction:.1f} % of the map is reached through a snap; the least margin on it is {result.margin.min():.3f}")
    picture = out / "crl_stability_map.png"
    plot_stability_map(result, picture, title=f"{robot.name} at translations 0")
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    parser.add_argument("--samples", type=int, default=90, help="points per axis")
    args = parser.parse_args()
    for path in main(args.out, args.samples):
        print(f"saved {path}")
