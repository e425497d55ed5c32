"""A wall that holds the robot of the thesis beyond its snap, and then lets it pass.

Tube 1 turns from home. Without walls the robot snaps at 214 deg. A ball beside the tip holds it: the margin with
the wall stays positive. At 218 deg the arm slides off the ball and snaps past it.

Result: rotations of both snaps and the energy that each releases, contact forces and margins before them.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.bodies import Sphere

ROOT = Path(__file__).resolve().parents[1]
TURNS = np.radians([0.0, 210.0, 214.0, 216.0, 217.0, 220.0])


def snap_text(snap: tubeopt.Snap) -> str:
    """Rotation of a snap and its energy, as text."""
    return f"snap at {np.degrees(snap.rotations[0]):.2f} deg, {snap.energy_released * 1e3:.3f} mJ released"


def main(out: Path) -> list[Path]:
    """Turn the tube with and without the ball, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    home = np.zeros(3)
    free = tubeopt.find_snap(robot, (home, home), (np.radians([360.0, 0.0, 0.0]), home))
    assert free is not None
    print(f"without walls: {snap_text(free)}")
    fall = free.after.tip_position - free.before.tip_position
    direction = fall / np.linalg.norm(fall)
    ball = Sphere(tuple((free.before.tip_position + 16e-3 * direction).tolist()), 15e-3)
    path = tubeopt.follow(robot, np.column_stack([TURNS, 0 * TURNS, 0 * TURNS]), walls=[ball])
    for pose in path.equilibria:
        assert pose.walls is not None
        pushed = ", ".join(f"{contact.size * 1e3:.2f} mN" for contact in pose.walls.contacts) or "no contact"
        print(f"tube 1 at {np.degrees(pose.rotations[0]):5.1f} deg: {pushed}, margin {pose.margin:.3f}")
    (snap,) = path.snaps
    print(f"with the ball: {snap_text(snap)}")
    picture = out / "contact_holds_snap.png"
    shown = [path.equilibria[k] for k in (1, 4, 5)]
    titles = [f"tube 1 at {np.degrees(pose.rotations[0]):.0f}\N{DEGREE SIGN}" for pose in shown]
    tubeopt.plot_shapes(shown, titles=titles, heading=f"{robot.name}: a ball holds the arm beyond its snap").savefig(
        picture
    )
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
