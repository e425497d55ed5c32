"""Effect of a moment on the outer tube: a port tilts the arm, or holds the tube while it turns.

A port 60 mm from the plate acts on the outermost tube. A transverse moment bends all tubes. An axial moment twists the
outer tube alone, and its curve then points in another direction.

Result: a transverse moment moves the tip twice as far as the same axial moment. The axial moment turns the outer tube
by 30 deg. Neither has an energy; the margin is the least real part of an eigenvalue. An axial moment at the tip makes
the robot snap earlier when its inner tube turns. A motion is planned and proved while the port holds the tube.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.robots.load import PointLoad
from tubeopt.show.plots import plot_shape

ROOT = Path(__file__).resolve().parents[1]
ROTATIONS = np.radians([0.0, 60.0, 120.0])
PORT = 0.06
"""Arc length from the plate, m."""


def main(out: Path) -> list[Path]:
    """Apply moments to the arm, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    free = tubeopt.forward_kinematics(robot, ROTATIONS)
    along = free.frame[np.argmin(np.abs(free.arc_length - PORT))][:, 2]
    across = np.cross(along, (1.0, 0.0, 0.0))
    across /= np.linalg.norm(across)
    arms = []
    for name, axis in (("across", across), ("along", along)):
        for size in (2e-3, 5e-3, 10e-3):
            load = tubeopt.Load(points=(PointLoad(PORT, moment=tuple(size * axis)),))
            arms.append(tubeopt.forward_kinematics(robot, ROTATIONS, load=load, verify=True))
            path = np.linalg.norm(arms[-1].tip_position - free.tip_position)
            turn = np.degrees(arms[-1].tip_rotations[2] - free.tip_rotations[2])
            moved = f"the tip moves by {path * 1e3:5.2f} mm, tube 3 turns by {turn:6.2f} deg"
            print(f"{size * 1e3:2.0f} mN m {name:6}: {moved}, margin {arms[-1].margin:.3f}")
    checks = [arm.verification.tip_position for arm in arms if arm.verification is not None]
    print(f"re-integrated, the tips differ by {1e3 * max(checks):.0e} mm at most")
    home = np.zeros(3)
    for size in (0.0, 1e-3, 2e-3):
        twisted = tubeopt.Load(moment=(0.0, 0.0, size))
        snap = tubeopt.find_snap(robot, (home, home), (np.radians([360.0, 0.0, 0.0]), home), load=twisted)
        turned = "nowhere" if snap is None else f"at {np.degrees(snap.rotations[0]):.1f} deg"
        print(f"{size * 1e3:2.0f} mN m at the tip: the robot snaps {turned}")
    held = tubeopt.Load(points=(PointLoad(PORT, moment=tuple(5e-3 * across)),))
    goal = (np.radians([90.0, 30.0, -20.0]), None)
    plan = tubeopt.plan_trajectory(robot, (home, None), goal, load=held, options=tubeopt.PlanOptions(objective="none"))
    word = "proved" if plan.proved else "not proved"
    margin = f"its least margin is {plan.proof.least_margin:.3f}"
    print(f"a plan of {plan.time[-1]:.1f} s while the port holds the tube with 5 mN m is {word}; {margin}")
    picture = out / "load_moment.png"
    plot_shape(arms[2], picture, ghosts=[free], remark="pale: without the moment")
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
