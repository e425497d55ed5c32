"""Figure 3.9 of the thesis: the six assignments of three tubes to one mirror actuation, next to the robot at d = 0.

The thesis measures a largest distance between the tips of about 0.36 mm, "less than 0.04 %" of the length of the robot
(it is 0.38 %). Its own equations give 26 times less.

Result: the assignment hardly matters: the tips differ by at most 0.014 mm, 0.015 % of the length.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.inverse.mirror import ASSIGNMENTS, mirror_rotations, permuted_tips
from tubeopt.show.plots.eccentric import Permutations, plot_permutations

ROOT = Path(__file__).resolve().parents[1]
THESIS = 0.36e-3
SEPARATIONS = np.radians(np.arange(0.0, 120.5, 5.0))
DIRECTIONS = np.radians(np.arange(0.0, 120.0, 10.0))
"""A third of a turn: turning all rotations by 120 deg only renames the tubes."""


def main(out: Path) -> list[Path]:
    """Search the grid for the largest deviation, draw the tips there, save the picture, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_etr.yaml")
    assert isinstance(robot, tubeopt.EccentricRobot)
    table = np.array([[_deviation(robot, d, s) for d in DIRECTIONS] for s in SEPARATIONS])
    row, column = np.unravel_index(np.argmax(table), table.shape)
    direction, separation = float(DIRECTIONS[column]), float(SEPARATIONS[row])
    largest, length = float(table.max()), robot.tube.length
    print(
        f"largest distance from d = 0: {largest * 1e3:.4f} mm ({100 * largest / length:.4f} % of the length) "
        f"at direction {np.degrees(direction):.0f}, separation {np.degrees(separation):.0f} deg; "
        f"thesis: {THESIS * 1e3:.2f} mm ({100 * THESIS / length:.2f} %)"
    )
    tips, reference = permuted_tips(robot, direction, separation)
    inputs = [mirror_rotations(direction, separation, order) for order in ASSIGNMENTS]
    arms = [tubeopt.forward_kinematics(robot, rotations) for rotations in inputs]
    centred = tubeopt.EccentricRobot(robot.tube, offset=0.0)
    arms.append(tubeopt.forward_kinematics(centred, inputs[0]))
    data = Permutations(
        tips=tips,
        reference=reference,
        names=["".join(str(i + 1) for i in order) for order in ASSIGNMENTS],
        frame=arms[-1].tip_rotation,
        separation=SEPARATIONS,
        deviation=table.max(1),
        shown=separation,
        published=(THESIS, "thesis"),
    )
    picture = out / "thesis_etr_permutations.png"
    # No line of the heading may end within "d = 0".
    same = "the same robot at d = 0".replace(" = ", "\N{NO-BREAK SPACE}=\N{NO-BREAK SPACE}")
    title = f"{robot.name}: six assignments of its tubes to one mirror actuation, and {same}"
    plot_permutations(data, picture, title=title, arms=arms)
    return [picture]


def _deviation(robot: tubeopt.EccentricRobot, direction: float, separation: float) -> float:
    """Largest distance of the six tips from the tip at d = 0, m."""
    tips, reference = permuted_tips(robot, direction, separation)
    return float(np.linalg.norm(tips - reference, axis=1).max())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
