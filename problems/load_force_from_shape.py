"""Accuracy of the tip force estimated from positions of the robot of the thesis, with a tracker of 0.1 mm noise.

The force is estimated from the tip alone, and from the tip with five points along the arm. Fifty measurements with
noise each give the scatter. The ellipses of the covariance contain 95 of 100 estimates.

Result: the tip determines transverse forces to less than a millinewton, and the axial force forty times worse. Points
along the arm help most in the axial direction. Report the covariance with the force.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.show.plots import plot_force_estimates

ROOT = Path(__file__).resolve().parents[1]
ROTATIONS = (0.0, 1.0, 2.0)
FORCE = np.array([0.05, 0.03, -0.02])
NOISE = 1e-4
TRIALS = 50


def main(out: Path) -> list[Path]:
    """Estimate the force again and again, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    true = tubeopt.forward_kinematics(robot, ROTATIONS, load=tubeopt.Load((FORCE[0], FORCE[1], FORCE[2])))
    random = np.random.default_rng(0)
    positions = np.linspace(0, len(true.arc_length) - 1, 7).astype(int)[1:-1]
    estimates = {}
    for name, points in (("the tip", ()), ("the tip and five points", positions)):
        results: list[tubeopt.ForceEstimate] = []
        for _ in range(TRIALS):
            tip = true.tip_position + NOISE * random.normal(size=3)
            observed = [(true.arc_length[k], true.position[k] + NOISE * random.normal(size=3)) for k in points]
            guess = results[-1].equilibrium if results else None
            results.append(
                tubeopt.estimate_force(robot, ROTATIONS, tip_position=tip, points=observed, noise=NOISE, start=guess)
            )
        estimates[name] = results
        errors = np.array([estimate.force for estimate in results]) - FORCE
        output, were = np.sqrt(np.diag(results[0].covariance)), np.sqrt((errors**2).mean(0))
        print(
            f"from {name}: errors of {', '.join(f'{x * 1e3:.2f}' for x in were)} mN along x, y, z; "
            f"the covariance says {', '.join(f'{x * 1e3:.2f}' for x in output)} mN"
        )
        print(f"  {results[0].undetermined}")
    picture = out / "load_force_from_shape.png"
    title = "Force on the tip, estimated from positions with noise of 0.1 mm"
    plot_force_estimates(estimates, picture, true=FORCE, title=title)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
