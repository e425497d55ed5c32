"""A steerable sheath: two curved tubes and a straight one beside a working channel of 2 mm, under a force on its tip.

The tubes have fixed lengths and slide in the sheath, so that those on the outside of the bend end earlier. The balance
of moments of the thesis has no answer for unequal tubes; this energy has.

Result: the tip deflects by 0.39 mm under 50 mN. A turn of the second tube moves the tip by up to 56 mm.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.robots.eccentric import free_channel

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path, samples: int = 24) -> list[Path]:
    """Bend and load the robot, save its picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "bundles" / "steerable_sheath.yaml")
    assert isinstance(robot, tubeopt.BundleRobot)
    print(f"free channel: {1e3 * free_channel(robot).diameter:.3f} mm")
    rotations = np.radians([0.0, 40.0, 0.0])
    pose = robot.fk(rotations)
    pushed = robot.fk(rotations, load=tubeopt.Load(force=(0.05, 0.0, 0.0)))
    deflection = np.linalg.norm(pushed.tip_position - pose.tip_position)
    print(f"tip {np.round(1e3 * pose.tip_position, 3)} mm, margin {pose.margin:.4f}")
    print(f"tubes end at {np.round(1e3 * pose.tube_end, 3)} mm of the centreline")
    print(f"50 mN deflect the tip by {1e3 * deflection:.3f} mm")
    reached, last = [], pose
    for angle in np.linspace(0.0, 2 * np.pi, samples, endpoint=False):
        last = robot.fk(rotations + np.array([0.0, angle, 0.0]), start=last)
        reached.append(last.tip_position)
    print(f"turning tube 2 moves the tip by up to {1e3 * np.linalg.norm(np.ptp(reached, axis=0)):.1f} mm")
    path = out / "bundle_sheath.png"
    pose.plot(path)
    return [path]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results"))
    main(parser.parse_args().out)
