"""Smallest tip force that makes the robot of the thesis snap, by direction, with its inner tube turned by 200 deg.

Without a load the robot snaps at 214 deg, 14 deg later. In every direction the force grows until the equilibrium
is lost; the load at this point is computed exactly.

Result: a margin of 0.875 without load does not limit the load. A force of 16 mN, the weight of two grams, is enough
in the direction of the coming snap. Most other directions withstand many times as much. The force component along that
one direction decides.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.show.plots import plot_load_limits

ROOT = Path(__file__).resolve().parents[1]
UNIT = 0.02
MOST = 4.0


def main(out: Path, samples: int = 36) -> list[Path]:
    """Apply forces in `samples` directions of three planes, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    path = np.radians([[0.0, 0.0, 0.0], [200.0, 0.0, 0.0]])
    start = tubeopt.follow(robot, path).equilibria[-1]
    print(f"without load: margin {start.margin:.3f}")
    angles = np.linspace(0.0, 2 * np.pi, samples, endpoint=False)
    limits, kinds = {}, {}
    for plane in ("xy", "xz", "yz"):
        results = []
        for angle in angles:
            force = np.zeros(3)
            force[["xyz".index(axis) for axis in plane]] = UNIT * np.cos(angle), UNIT * np.sin(angle)
            load = tubeopt.Load((force[0], force[1], force[2]))
            results.append(tubeopt.find_load_limit(robot, start.rotations, None, load, equilibrium=start, up_to=MOST))
        limits[plane] = np.array([UNIT * limit.factor if limit else np.nan for limit in results])
        kinds[plane] = [limit.kind if limit else "" for limit in results]
        smallest = int(np.nanargmin(limits[plane]))
        print(
            f"in the plane {plane}: {limits[plane][smallest] * 1e3:.2f} mN at {np.degrees(angles[smallest]):.0f} deg "
            f"from {plane[0]}; {np.isnan(limits[plane]).sum()} of {samples} directions withstand "
            f"{UNIT * MOST * 1e3:.0f} mN"
        )
    picture = out / "load_snap_directions.png"
    title = "Force on the tip (mN) that snaps the robot of the thesis, its inner tube at 200°"
    plot_load_limits(limits, picture, angles=angles, kinds=kinds, title=title)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
