"""Deflection and remaining margin of the robot of the thesis under a payload.

The arm points up: gravity acts along -z, on the tubes and on the payload at the tip.

Result: the own weight moves the tip by millimetres. The compliance at the start predicts the displacement by small
payloads only. An arm with margin 1 without load keeps a third of it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.show.plots import plot_payload

ROOT = Path(__file__).resolve().parents[1]
ROTATIONS = np.radians([150.0, 60.0, 0.0])
GRAVITY = (0.0, 0.0, -9.81)


def main(out: Path) -> list[Path]:
    """Load the arm, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    alone = tubeopt.forward_kinematics(robot, ROTATIONS)
    payloads = np.linspace(0.0, 0.2, 21)
    arms: list[tubeopt.Equilibrium] = []
    for payload in payloads:
        load = tubeopt.Load((0.0, 0.0, -payload), gravity=GRAVITY)
        arms.append(tubeopt.forward_kinematics(robot, ROTATIONS, load=load, start=arms[-1] if arms else None))
    sag = np.linalg.norm(arms[0].tip_position - alone.tip_position)
    print(f"without any load: margin {alone.margin:.3f}; its own weight moves the tip by {sag * 1e3:.2f} mm")
    for k in (0, 5, 10, 20):
        path = np.linalg.norm(arms[k].tip_position - arms[0].tip_position)
        print(f"payload of {payloads[k] * 1e3:3.0f} mN: {path * 1e3:5.1f} mm more, margin {arms[k].margin:.3f}")
    hung = tubeopt.Load((0.0, 0.0, -1.0))
    limit = tubeopt.find_load_limit(robot, ROTATIONS, None, hung, up_to=2.0)
    report = "none is lost up to 2 N" if limit is None else f"lost in a {limit.kind} at {limit.factor * 1e3:.1f} mN"
    print(f"a payload alone, without the tubes' weight: {report}")
    picture = out / "load_payload.png"
    title = f"{robot.name} carries a payload, gravity along \N{MINUS SIGN}z"
    plot_payload(arms, picture, payloads=payloads, title=title)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
