"""One target of the tip, and the distinct postures of the robot of the thesis that reach it.

Result: six joints and three coordinates leave a choice. Postures with the same tip have different margins.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.show.plots.workspace import plot_inverse

ROOT = Path(__file__).resolve().parents[1]
TARGET_MM = (40.0, 0.0, 170.0)


def main(out: Path) -> list[Path]:
    """Find the postures, print them, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    # Every tube must be visible, so its end is not that of another one.
    options = tubeopt.InverseOptions(section_length=10e-3)
    solutions = tubeopt.inverse_kinematics(robot, np.array(TARGET_MM) * 1e-3, all_solutions=True, options=options)
    for each in solutions:
        rotations = np.round(np.degrees(each.rotations), 2) + 0.0
        translations = np.round(each.translations * 1e3, 2) + 0.0
        print(f"rotations {rotations} deg, translations {translations} mm, margin {each.margin:.3f}")
    picture = out / "inverse_redundancy.png"
    plot_inverse(solutions, picture)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
