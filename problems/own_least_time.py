"""The least time between two tips of the robot of the thesis, around a sphere on the straight path between them.

One nonlinear program has the joint values and rates at 9 knots, an equilibrium at each, and the duration as unknowns.
Rates, accelerations, a margin of 0.3 and a clearance of 1 mm are its constraints. `Motion` starts it at the motion
through the sphere.

Result: the path around the sphere takes 1 % more time than the motion through it. The final configuration is free,
only its tip is given.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.show.plots.trajectory import plot_trajectory

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path) -> list[Path]:
    """Solve the program with and without the sphere, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    start = tubeopt.forward_kinematics(robot, [0.0, 1.0, 2.0], [-0.06, -0.04, -0.02])
    goal, sphere = (0.004, 0.048, 0.1377), tubeopt.Sphere((0.0391, 0.0212, 0.1341), 0.006)

    def fastest(bodies: list[tubeopt.Sphere]) -> tubeopt.Trajectory:
        problem = tubeopt.Problem("least time")
        motion = tubeopt.Motion(problem, robot, 9, min_margin=0.3)
        motion.start(start)
        motion.goal(tip_position=goal)
        motion.limit(tubeopt.RateLimits())
        if bodies:
            motion.keep_clear(bodies, 1e-3)
        problem.minimize(motion.duration)
        return motion.solve()

    around, through = fastest([sphere]), fastest([])
    apart = np.linalg.norm(through.tip_position - np.array(sphere.centre), axis=1).min() - sphere.radius
    print(f"through the sphere: {through.time[-1]:.3f} s, tip {1e3 * apart:.1f} mm from its surface")
    proof = around.proof
    print(f"around it: {around.time[-1]:.3f} s, {1e3 * proof.least_clearance:.2f} mm clear, proved: {proof.holds}")
    picture = out / "own_least_time.png"
    plot_trajectory(around, picture, title="Least time around a sphere")
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
