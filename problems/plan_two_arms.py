"""Two robots on one plate: base poses with a large common workspace, and a task without contact between the arms.

The plates may be 10 to 30 mm apart, tilted by up to 30 deg, and rotated. First each tip goes to a point on the other
side that both arms reach. Then the tips of two arms exchange their positions.

Result: the distance of two moving arms is proved at all times, and this costs no more than the proof of either motion.
If each arm blocks the goal of the other, no order of single motions works; one of them must withdraw and return.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.bodies.frames import base_frame
from tubeopt.robots.robot import Robot
from tubeopt.show.plots.trajectory import plot_arms
from tubeopt.workspaces import place_pair, shared_workspace

ROOT = Path(__file__).resolve().parents[1]
SHIFT = np.array([0.012, -0.05, -0.085])
"""Translations at the goals, m."""


def main(out: Path) -> list[Path]:
    """Place the pair, plan, print the proof, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "crl_ctr.yaml")
    reached = [tubeopt.workspace(robot, 4000, seed=0)] * 2
    beside = shared_workspace(reached, [base_frame([x, 0, 0], [0, 0, 1]) for x in (-0.015, 0.015)])
    best = place_pair(reached, min_distance=0.01, max_distance=0.03, max_tilt=np.radians(30))
    apart = np.linalg.norm(best.bases[1].origin - best.bases[0].origin)
    print(f"in voxels of {best.size * 1e3:.0f} mm:")
    print(f"side by side, 30 mm apart: {100 * beside.fraction:.0f} % of a workspace is shared")
    print(f"{apart * 1e3:.0f} mm apart, leaning and turned: {100 * best.fraction:.0f} %")

    arms = [
        tubeopt.PlacedRobot(robot, base_frame([x, 0, 0], [-8 * x, 0, 1]), name)
        for x, name in ((-0.008, "left"), (0.008, "right"))
    ]
    withdrawn = (np.zeros(3), np.array([-0.02, -0.08, -0.09]))
    goals = [(np.radians([60, 50, 75]), SHIFT), (np.radians([-120, -130, -105]), SHIFT)]
    options = tubeopt.PlanOptions(clearance=5e-4)
    plan = tubeopt.plan_arms(arms, [withdrawn] * 2, goals, options=options)
    alone = sum(float(each.time[-1] - each.time[0]) for each in plan.trajectories)
    print(f"both moved within {plan.duration:.1f} s, one after the other it would take {alone:.1f} s")
    print(f"at least {plan.proof.least_clearance * 1e3:.2f} mm between them at all times, proved: {plan.proved}")
    swapped(robot)
    picture = out / "plan_two_arms.png"
    plot_arms(plan, picture, title="Two robots on one plate cross over")
    return [picture]


def swapped(robot: Robot) -> None:
    """Plan the exchange of two tips, and print the result."""
    arms = [
        tubeopt.PlacedRobot(robot, base_frame([x, 0, 0], [0, 0, 1]), name)
        for x, name in ((-0.008, "left"), (0.008, "right"))
    ]
    positions = [np.array([0.0, y, 0.05]) for y in (0.006, -0.006)]
    starts = [
        tubeopt.inverse_kinematics(robot, arm.base.seen(position), start=(np.zeros(3), SHIFT))
        for arm, position in zip(arms, positions, strict=True)
    ]
    options = tubeopt.PlanOptions(clearance=5e-4, objective="none")  # no path is shorter
    plan = tubeopt.plan_arms(arms, starts, positions[::-1], options=options)
    names = ", ".join(arms[k].called for k in plan.withdrawn_first)
    print(f"tips change places within {plan.duration:.1f} s; {names} withdraws; proved: {plan.proved}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
