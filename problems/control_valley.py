"""The tip of the CRL robot moves to a target behind a region of small margin: one-step servo and predictive servo.

Result: both reach it. The one-step servo slides along the lower bound of the margin, where each step closer would
reduce it; the predictive servo plans the whole path around the region.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import tubeopt
from tubeopt.control.command import Command, ServoOptions
from tubeopt.control.lookahead import PredictiveServo
from tubeopt.control.servo import Servo
from tubeopt.show.page import tube_colour
from tubeopt.show.plots.style import new_figure, picture
from tubeopt.typing import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROOT = Path(__file__).resolve().parents[1]

SEED = ([-1.862, 0.452, -1.255], [0.0341, -0.0361, -0.0505])
TARGET = (0.004, -0.0184, 0.1496)
OPTIONS = ServoOptions(speed=0.2, min_margin=0.2)
DT, STEPS = 0.02, 150


def main(out: Path) -> list[Path]:
    """Move the tip with both servos, print the results, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "crl_ctr.yaml")
    seed = tubeopt.forward_kinematics(robot, *SEED)
    tables = []
    for name, servo in (
        ("one-step servo", Servo(robot, seed, options=OPTIONS)),
        ("predictive servo", PredictiveServo(robot, seed, options=OPTIONS)),
    ):
        steps = [servo.step(Command(position=TARGET), DT) for _ in range(STEPS)]
        arms = [step.equilibrium for step in steps]
        way = tubeopt.follow(robot, [e.rotations for e in arms], [e.translations for e in arms], start=arms[0])
        left = np.array([np.linalg.norm(e.tip_position - TARGET) for e in arms])
        tables.append((name, left, np.array([e.margin for e in arms])))
        words = steps[-1].why.text if left[-1] > 1e-5 else "there"
        print(f"{name}: {left[-1] * 1e3:.2f} mm from the target, {len(way.snaps)} snaps; {words}")
    path = out / "control_valley.png"
    plot_ways(tables, path)
    return [path]


@picture
def plot_ways(tables: list[tuple[str, Array, Array]]) -> Figure:
    """Distance from the target, m, and margin over time, for both servos."""
    figure = new_figure(6.4, 2.8)
    left, right = figure.subplots(1, 2)
    for k, (name, away, margin) in enumerate(tables):
        time = DT * np.arange(1, len(away) + 1)
        left.plot(time, away * 1e3, color=tube_colour(k), label=name)
        right.plot(time, margin, color=tube_colour(k))
    right.axhline(OPTIONS.min_margin, color="0.5", linewidth=0.8, linestyle="--")
    right.text(DT * STEPS, OPTIONS.min_margin, "floor", ha="right", va="top", color="0.5")
    left.set(xlabel="time (s)", ylabel="tip from its target (mm)", ylim=(0, None))
    right.set(xlabel="time (s)", ylabel="margin", ylim=(0, 1.02))
    left.legend()
    return figure


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
