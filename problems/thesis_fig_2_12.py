"""Figure 2.12 of the thesis: elastic energy over the tip angles of the two inner tubes while the inner one turns.

At 135 deg there is one minimum. A second one appears before 150 deg. At 180 deg both are equally deep. At 225 deg the
first one has vanished: a robot that came from home has snapped into the second, at 214.22 deg.

Result: a snap is the disappearance of a minimum. It can be computed to any number of digits.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.show.plots import plot_energy_maps

ROOT = Path(__file__).resolve().parents[1]
INPUTS_DEG = (135.0, 150.0, 180.0, 225.0)
WINDOW_DEG = ((-30.0, 390.0), (-90.0, 90.0))


def main(out: Path, samples: int = 61) -> list[Path]:
    """Compute the maps with `samples` points per axis, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    window = np.radians(WINDOW_DEG)
    maps = [tubeopt.energy_map(robot, np.radians([deg, 0, 0]), window=window, samples=samples) for deg in INPUTS_DEG]
    for deg, each in zip(INPUTS_DEG, maps, strict=True):
        results = [f"{e.energy * 1e3:.3f} mJ ({'stable' if e.stable else 'unstable'})" for e in each.equilibria]
        print(f"inner tube at {deg:g} deg: {', '.join(results)}")
    picture = out / "thesis_energy_maps.png"
    titles = [f"inner tube turned by {deg:g}°" for deg in INPUTS_DEG]
    plot_energy_maps(maps, picture, titles=titles)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    parser.add_argument("--samples", type=int, default=61, help="points per axis")
    args = parser.parse_args()
    for path in main(args.out, args.samples):
        print(f"saved {path}")
