"""Causes of the model error of a synthetic robot with delayed sensors and inexact drives.

The robot moves along a path forward and back. The true errors are known: a delay, offsets of the carriages and of one
rotation, and gains of the drives that are 1 % off. Effects are added in the order in which they improve the prediction
of rows that no fit used.

Result: the fit finds the four true effects and rejects the others. The remaining error is the noise.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from tubeopt import ConcentricRobot, Tube, forward_kinematics_batch
from tubeopt.robots.calibration import Calibration
from tubeopt.show.plots.validation import plot_effects
from tubeopt.typing import Array
from tubeopt.validation import FitOptions, Measurements, compare_effects

ROOT = Path(__file__).resolve().parents[1]
MM = 1e-3
RATE, NOISE = 10.0, 0.3 * MM

ROBOT = ConcentricRobot(
    (
        Tube(1.0 * MM, 0.75 * MM, 150 * MM, 90 * MM, 9.0),
        Tube(1.5 * MM, 1.15 * MM, 70 * MM, 60 * MM, 5.0),
    ),
    name="two tubes",
)

DRIVES = replace(
    Calibration.none(2),
    latency=0.09,
    rotation_offsets=(0.0, np.radians(4.5)),
    rotation_gains=(1.01, 0.99),
    translation_offsets=(-2 * MM, 1.5 * MM),
)
"""True offsets and gains of the drives."""

TRIED = (
    "latency",
    "translation",
    "rotation",
    "rotation_gain",
    "rotation_play",
    "curvature",
    "torsional_stiffness",
    "sensor_offset",
)


def joints(time: Array, last: float) -> Array:
    """(N, 4) readings, rad and m, at times (N,), s, of a smooth path that turns back half of the time to `last`."""
    reached = np.minimum(time, last - time)[:, None]
    speed, phase = np.array([0.23, 0.31, 0.19, 0.27]), np.array([0.3, 1.9, 4.0, 5.1])
    waves = np.sin(speed * reached + phase) + 0.6 * np.sin(2.3 * speed * reached + 2 * phase)
    return np.asarray(waves * [1.4, 1.6, 14 * MM, 9 * MM] + [0.0, 0.0, 20 * MM, -8 * MM])


def measure(count: int = 300) -> Measurements:
    """Rows of the path as the laboratory records them."""
    time = np.arange(count) / RATE
    read, lagging = joints(time, time[-1]), joints(time - DRIVES.latency, time[-1])
    tips = forward_kinematics_batch(ROBOT, *DRIVES.to_model(lagging[:, :2], lagging[:, 2:])).tip_position
    noise = np.random.default_rng(1).normal(0, NOISE, tips.shape)
    return Measurements(read[:, :2], read[:, 2:], tips + noise, time=time, source="a synthetic path")


def main(directory: Path) -> list[Path]:
    """Draw the part of the error that each effect explains, and print the fitted values of the drives."""
    result = compare_effects(ROBOT, measure(), TRIED, FitOptions(folds=6))
    print(f"as given: {result.start.rms / MM:.2f} mm held out")
    for step in result.steps:
        print(f"+ {step.effect}: {step.held_out.rms / MM:.2f} mm ({100 * step.gain:.0f} % less)")
    assert result.fit is not None
    for e in result.fit.estimates:
        print(f"{e.name}: {e.low:.4g} to {e.high:.4g} {e.unit}" + (" (held)" if e.held else ""))
    path = directory / "calibrate_way.png"
    plot_effects(result, path)
    return [path]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for picture in main(parser.parse_args().out):
        print(f"saved {picture}")
