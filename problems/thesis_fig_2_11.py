"""Figure 2.11 of the thesis: rotation and torsion along the tubes in the two configurations of Figure 2.9.

Result: torsion is zero at the end of each tube and largest at the plate. Most of the twist is in the transmissions
behind the plate.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import tubeopt
from tubeopt.show.plots import plot_torsions

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path) -> list[Path]:
    """Solve both configurations, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    home = tubeopt.forward_kinematics(robot, (0.0, 0.0, 0.0))
    actuated = tubeopt.forward_kinematics(robot, (0.0, 1.0, 2.0))
    picture = out / "thesis_torsion.png"
    plot_torsions([home, actuated], picture, titles=["Home configuration", "Actuated configuration"])
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
