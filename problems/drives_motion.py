"""How strong must the motors be? An inner tube turns and advances, with friction between the tubes.

Result: friction raises the largest torque from 4.2 to 4.8 mN m. The drives do 7.4 mJ of work, and 0.9 mJ
become heat.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.plot import plot_drives

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path) -> list[Path]:
    """Compute the loads with and without friction, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    way = np.linspace(0.0, 1.0, 81)
    smooth = (3 * way**2 - 2 * way**3)[:, None]
    rotations, translations = smooth * (np.pi, 0.0, 0.0), smooth * (0.02, 0.0, 0.0) - (0.02, 0.01, 0.01)
    for friction in (None, tubeopt.Friction(torque=0.005)):
        drives = tubeopt.drives_along(robot, rotations, translations, time=4 * way, friction=friction)
        torque, force = (np.round(1e3 * peak, 2).tolist() for peak in drives.value)
        print(f"{'without' if friction is None else 'with'} friction: torques {torque} mN m, forces {force} mN")
        print(f"  work {1e3 * drives.work:.3f} mJ, heat {1e3 * drives.heat:.3f} mJ")
    picture = out / "drives.png"
    plot_drives(drives, picture)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
