"""Error budget of a synthetic robot with delayed sensors and friction between its tubes.

The robot moves along a path forward and back, first slowly, then twice as fast. The effect of a delay grows with the
speed; that of friction does not. The true delay and the true friction are known.

Result: the table shows the part of the error that each effect explains. Two speeds separate friction from delay and
from backlash. The remaining error is the noise.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from tubeopt import ConcentricRobot, Friction, Tube, follow
from tubeopt.robots.calibration import Calibration
from tubeopt.show.plots.validation import plot_effects
from tubeopt.typing import Array
from tubeopt.validation import FitOptions, Measurements, compare_effects

ROOT = Path(__file__).resolve().parents[1]
MM = 1e-3
RATE, NOISE, FASTER = 10.0, 0.2 * MM, 2.0

ROBOT = ConcentricRobot(
    (
        Tube(1.0 * MM, 0.75 * MM, 150 * MM, 90 * MM, 9.0),
        Tube(1.5 * MM, 1.15 * MM, 70 * MM, 60 * MM, 5.0),
    ),
    name="two tubes with friction",
)
DRIVES = replace(Calibration.none(2), latency=0.09)
FRICTION = Friction(torque=0.012)
"""12 mN m per m: when the inner tube turns, its tip lags by about 10 deg."""

TRIED = ("latency", "rotation_play", "friction")


def joints(time: Array, slow: float) -> Array:
    """(N, 4) readings, rad and m, at times (N,), s: a smooth path forward and back in `slow` s, then again faster."""
    phase = np.where(time < slow, time / slow, (time - slow) * FASTER / slow)
    reached = 19.0 * np.minimum(phase, 1 - phase)[:, None]
    speed, shift = np.array([0.23, 0.31, 0.19, 0.27]), np.array([0.3, 1.9, 4.0, 5.1])
    waves = np.sin(speed * reached + shift) + 0.6 * np.sin(2.3 * speed * reached + 2 * shift)
    return np.asarray(waves * [1.4, 1.6, 6 * MM, 4 * MM] + [0.0, 0.0, 20 * MM, -8 * MM])


def measure(samples: int) -> Measurements:
    """Rows of the path as the laboratory records them."""
    time, slow = np.arange(samples) / RATE, samples / RATE / (1 + 1 / FASTER)
    read, lagging = joints(time, slow), joints(np.maximum(time - DRIVES.latency, 0.0), slow)
    alpha, shift = DRIVES.to_model(lagging[:, :2], lagging[:, 2:])
    tips = np.array([e.tip_position for e in follow(ROBOT, alpha, shift, friction=FRICTION).equilibria])
    noise = np.random.default_rng(1).normal(0, NOISE, tips.shape)
    return Measurements(read[:, :2], read[:, 2:], tips + noise, time=time, source="a synthetic path")


def main(directory: Path, samples: int = 75) -> list[Path]:
    """Draw the part of the error that each effect explains in `samples` rows, and print the fitted values."""
    result = compare_effects(ROBOT, measure(samples), TRIED, FitOptions(folds=2))
    print(f"as given: {result.start.rms / MM:.2f} mm held out")
    for step in result.steps:
        print(f"+ {step.effect}: {step.held_out.rms / MM:.2f} mm ({100 * step.gain:.0f} % less)")
    assert result.fit is not None
    for e in result.fit.estimates:
        print(f"{e.name}: {e.low:.4g} to {e.high:.4g} {e.unit}" + (" (held)" if e.held else ""))
    path = directory / "calibrate_friction.png"
    plot_effects(result, path)
    return [path]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for picture in main(parser.parse_args().out):
        print(f"saved {picture}")
