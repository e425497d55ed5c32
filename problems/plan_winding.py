"""A helix that opens towards its tip, in a tube of growing curvature, turned past a post: planned and proved.

Result: the proof covers the robot as it is, with any variation of precurvature. An independent integration of the
equations between the samples finds no arm closer to the post than the proved clearance.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt import Piece, Tube
from tubeopt.bodies.obstacles import Capsule
from tubeopt.show.plots.trajectory import plot_trajectory

ROOT = Path(__file__).resolve().parents[1]

CHECKS = 24
"""Equilibria that are integrated once more, between the samples of the plan."""


def winding() -> tubeopt.ConcentricRobot:
    """The robot: the precurvature varies along both tubes, the natural twist along the inner one."""
    opening = Piece(0.11, lambda s: (34.0 - 200.0 * s, 0.0, 110.0 - 500.0 * s))
    rising = Piece(0.05, lambda s: 12.0 * np.sin(np.pi * s / 0.1))
    tubes = (
        Tube.of_pieces(1.0e-3, 0.7e-3, [opening], straight_length=0.09),
        Tube.of_pieces(1.6e-3, 1.2e-3, [rising], straight_length=0.04),
    )
    return tubeopt.ConcentricRobot(tubes, name="winding tubes")


def main(out: Path) -> list[Path]:
    """Plan, check by shooting, save the picture into `out`, and return its path."""
    robot = winding()
    start, goal = ([0.0, 0.0], [-0.03, -0.005]), ([2.0, 1.2], [0.0, -0.005])
    middle = tubeopt.forward_kinematics(robot, [1.0, 0.6], [-0.015, -0.005])
    x, y, z = middle.tip_position.tolist()
    post = Capsule((x, y, z - 0.03), (x, y, z + 0.002), 1.5e-3)
    straight = tubeopt.verify_trajectory(robot, [0.0, 10.0], [start[0], goal[0]], [start[1], goal[1]], obstacles=[post])
    print(f"straight from joint values to joint values: {'; '.join(straight.faults)}")
    plan = tubeopt.plan_trajectory(robot, start, goal, obstacles=[post], options=tubeopt.PlanOptions(clearance=2e-4))
    proof = plan.proof
    print(f"planned: least margin {proof.least_margin:.3f}, {plan.time[-1]:.1f} s, proved: {proof.holds}")
    print(f"clearance at least {proof.least_clearance * 1e3:.3f} mm at all times, by {proof.equilibria} equilibria")
    current, off, near = plan.start, 0.0, np.inf
    for t in np.linspace(0.0, plan.time[-1], CHECKS):
        turn, shift = (
            np.array([np.interp(t, plan.time, joint) for joint in table.T])
            for table in (plan.rotations, plan.translations)
        )
        current = tubeopt.forward_kinematics(robot, turn, shift, start=current, verify=True)
        assert current.verification is not None
        off = max(off, current.verification.tip_position)
        thick = np.where(
            current.arc_length <= current.tube_end[1], *(tube.outer_diameter / 2 for tube in robot.tubes[::-1])
        )
        near = min(near, float((post.signed_distance(current.position) - thick).min()))
    print(
        f"integrated {CHECKS} times in between: tips agree to {off * 1e9:.1g} nm, least clearance {near * 1e3:.3f} mm"
    )
    picture = out / "plan_winding.png"
    plot_trajectory(plan, picture, title=f"{robot.name}: past a post")
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
