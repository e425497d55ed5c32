"""Figure 2.9 of the thesis: its three-tube robot at home, and with the tubes turned by 0, 1 and 2 rad.

Result: rotated tubes settle on a shape between their own, which lies in no plane. No tube keeps the rotation of its
base.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import tubeopt
from tubeopt.show.plots import plot_shapes

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path) -> list[Path]:
    """Solve both configurations, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    home = tubeopt.forward_kinematics(robot, (0.0, 0.0, 0.0))
    actuated = tubeopt.forward_kinematics(robot, (0.0, 1.0, 2.0))
    picture = out / "thesis_robot.png"
    plot_shapes([home, actuated], picture, titles=["Home configuration", "Actuated configuration"])
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
