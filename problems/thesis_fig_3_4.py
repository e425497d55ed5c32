"""Figure 3.4 of the thesis: its eccentric robot straight, with its tubes 120 deg apart, and fully bent.

Result: three equal tubes 120 deg apart cancel each other, and the arm is straight. In a bent arm they slide along each
other, since the tube on the inside of the bend is shorter.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.equilibrium import centrelines
from tubeopt.inverse import mirror
from tubeopt.show.plots import plot_shapes

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path) -> list[Path]:
    """Solve both configurations, print the lengths of the tubes, save the picture, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_etr.yaml")
    straight = tubeopt.forward_kinematics(robot, mirror.mirror_rotations(0.0, mirror.STRAIGHT))
    bent = tubeopt.forward_kinematics(robot, mirror.mirror_rotations(np.pi / 2, 0.0))
    titles = []
    for name, equilibrium in (("Straight", straight), ("Bent", bent)):
        lengths = ", ".join(f"{length * 1e3:.2f}" for length in centrelines.tube_lengths(equilibrium))
        titles.append(f"{name}: tubes {lengths} mm long")
        print(f"{titles[-1]}, tip {np.round(equilibrium.tip_position * 1e3, 6)} mm")
    picture = out / "thesis_etr_straight.png"
    plot_shapes([straight, bent], picture, titles=titles, view=(18.0, -60.0))
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
