"""A robot of tubes made of pieces: a helix, an S, and an outer tube with slots; at home and with its tubes turned.

Result: each tube takes a line or two in the robot file. Solver, margin and certificate are the same for all tubes.
Slots in a single tube do not help by themselves: a softer outer tube resists the inner two less, which then act on each
other more.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.show.plots import plot_shapes

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path) -> list[Path]:
    """Solve both configurations, print the effect of the slots, save the picture, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "example_pieces.yaml")
    assert isinstance(robot, tubeopt.ConcentricRobot)
    home = tubeopt.forward_kinematics(robot, (0.0, 0.0, 0.0))
    turned = tubeopt.forward_kinematics(robot, np.radians((0.0, 120.0, -60.0)))
    print(f"margin at home {home.margin:.4f}, turned {turned.margin:.4f}")
    outer = robot.tubes[2]
    plain = replace(
        outer, pieces=tuple(replace(p, bending_stiffness=None, torsional_stiffness=None) for p in outer.pieces)
    )
    for name, tube in (("with slots", outer), ("without", plain)):
        one = replace(robot, tubes=(*robot.tubes[:2], tube))
        print(f"certificate {name}: {tubeopt.snap_free_certificate(one):.4f}")
    picture = out / "tubes_of_pieces.png"
    plot_shapes([home, turned], picture, titles=["Home configuration", "Turned by 0, 120, -60 deg"])
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
