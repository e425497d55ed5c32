"""Do the tubes break? The inner tube of the thesis robot turns by a turn and back, again and again, and snaps.

Result: the strain amplitude of the inner tube is 0.24 %, less than the published limits of 10 million cycles.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.plot import plot_fatigue

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path) -> list[Path]:
    """Count the strain cycles, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    result = tubeopt.fatigue(robot, np.linspace(0.0, 2 * np.pi, 73)[:, None] * (1.0, 0.0, 0.0))
    print(f"{result.statistics.snaps} snaps in a repetition")
    for number, tube in enumerate(result.tubes, start=1):
        print(f"tube {number}: amplitude {100 * tube.amplitude:.3f} % at {1e3 * tube.place:.0f} mm, {tube.endurance}")
    picture = out / "fatigue.png"
    plot_fatigue(result, picture)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
