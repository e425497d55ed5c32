"""Tip force, joint offsets and shape of the thesis robot from four kinds of sensors, in simulated runs.

Encoders, six Bragg gratings along the inner tube and a force sensor below the plate are read at 100 Hz. A tracker
reads the tip at 50 Hz, 50 ms late, with noise of 0.3 mm and 0.5 deg. A third of its poses is lost. Offsets of all
joints and a force that changes at random are drawn anew for every run.

Result: the errors are as large as the covariance says. In 15 runs the mean of their normalised squares (NEES) is 8.3 of
9 expected. The force is known to 2 to 3 mN. The tracker alone does not determine the force along the arm, and the
estimate says so.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

import tubeopt
from tubeopt.control import (
    BaseReading,
    CurvatureReading,
    EstimatorOptions,
    StateEstimate,
    StateEstimator,
    TipReading,
)
from tubeopt.show.page import tube_colour
from tubeopt.show.plots.style import new_figure, picture
from tubeopt.typing import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROOT = Path(__file__).resolve().parents[1]

START = np.array([0.0, 1.0, 2.0]), np.array([-0.05, -0.03, -0.02])
DT, STEPS = 0.01, 60
LATE, LOST = 5, 1 / 3
METHOD = tubeopt.Newton(margin_tolerance=1e-3)
"""Of the simulated robot: digits of margins close to 1 are not needed."""
OPTIONS = EstimatorOptions(force=0.05, force_time=10.0)
STATIONS = np.linspace(0.01, 0.11, 6)


class Run(NamedTuple):
    """True states (T, 9) of a run, with the estimates."""

    truth: Array
    estimates: list[StateEstimate]

    @property
    def nees(self) -> Array:
        """(T,) normalised estimation errors squared."""
        pairs = zip(self.truth, self.estimates, strict=True)
        return np.array([(e.state - x) @ np.linalg.solve(e.covariance, e.state - x) for x, e in pairs])


class Shown(NamedTuple):
    """What the picture shows: a run, the mean NEES (T,) of all runs, and its band."""

    run: Run
    nees: Array
    band: tuple[float, float]


def run(seed: int, *, tracker_only: bool = False) -> Run:
    """A simulated run."""
    robot = tubeopt.load_robot("thesis_ctr")
    o, random, phi = OPTIONS, np.random.default_rng(seed), np.exp(-DT / OPTIONS.force_time)
    turned, shifted = random.normal(0, o.rotation, 3), random.normal(0, o.translation, 3)
    force = random.normal(0, o.force, 3)
    arm = tubeopt.forward_kinematics(robot, *START)
    # Expected readings of a robot without offsets: minus the gap of a reading of zeros.
    estimator, exact, still = StateEstimator(arm, o), StateEstimator(arm, o).states, np.zeros(9)
    fibre, late, truth, estimates = CurvatureReading(STATIONS, np.zeros((6, 2))), [], [], []
    for k in range(STEPS):
        time = k * DT
        turn = START[0] + 0.6 * np.sin(np.array([2.0, 1.3, 1.7]) * time)
        shift = START[1] + 4e-3 * np.sin(np.array([2.2, 1.5, 1.1]) * time)
        if k:
            force = phi * force + np.sqrt(1 - phi**2) * random.normal(0, o.force, 3)
        load = tubeopt.Load((force[0], force[1], force[2]))
        arm = tubeopt.forward_kinematics(robot, turn + turned, shift + shifted, load=load, start=arm, method=METHOD)
        curvature = -fibre.rows(exact.model(arm, still)).innovation.reshape(6, 2)
        wrench = arm.base_wrench + random.normal(size=6) * np.repeat([5e-3, 1e-3], 3)
        tilt = Rotation.from_rotvec(random.normal(0, np.radians(0.5), 3)).as_matrix()
        tip = TipReading(arm.tip_position + random.normal(0, 3e-4, 3), direction=tilt @ arm.tip_rotation[:, 2])
        estimator.encoders(time, turn, shift)
        if not tracker_only:
            measured = curvature + random.normal(0, fibre.noise, (6, 2))
            estimator.measured(time, CurvatureReading(STATIONS, measured), BaseReading(wrench))
        late.append((time, tip))
        if k % 2 and k >= LATE and random.random() > LOST:
            estimator.measured(*late[k - LATE])
        truth.append(np.concatenate([force, turned, shifted]))
        estimates.append(estimator.estimate())
    return Run(np.array(truth), estimates)


def main(out: Path, samples: int = 50) -> list[Path]:
    """Simulate `samples` runs, print the errors, save the picture into `out`, and return its path."""
    runs = [run(seed) for seed in range(samples)]
    nees = np.mean([each.nees for each in runs], axis=0)
    low, high = scipy.stats.chi2.ppf([0.025, 0.975], 9 * samples) / samples
    inside = np.mean((nees > low) & (nees < high))
    print(f"NEES of {samples} runs: {nees.mean():.2f} on average, expected 9; at the end {nees[-1]:.2f}, ", end="")
    print(f"95 % band {low:.2f} to {high:.2f}, inside at {inside:.0%} of the times")
    ends = [(each.estimates[-1], each.truth[-1]) for each in runs]
    off = np.array([e.force_directions @ (e.force - x[:3]) for e, x in ends])
    said = np.mean([e.force_errors for e, _ in ends], axis=0)
    for name, values in (("are", np.sqrt((off**2).mean(0))), ("should be", said)):
        print(f"errors of the force {name} {', '.join(f'{x * 1e3:.2f}' for x in values)} mN, best direction to worst")
    alone = run(0, tracker_only=True)
    print("tracker alone:", alone.estimates[-1].unobserved)
    path = out / "control_estimator.png"
    plot_run(Shown(runs[0], nees, (float(low), float(high))), path)
    return [path]


@picture
def plot_run(shown: Shown) -> Figure:
    """True and estimated force of a run with bands of two standard deviations, and the NEES of all runs."""
    shown_run, nees, band = shown
    figure = new_figure(7.2, 3.0)
    left, right = figure.subplots(1, 2)
    time = DT * np.arange(STEPS)
    force = 1e3 * np.array([e.force for e in shown_run.estimates])
    error = 2e3 * np.sqrt(np.array([np.diag(e.covariance_of("force")) for e in shown_run.estimates]))
    for k, name in enumerate("xyz"):
        colour = tube_colour(k)
        left.fill_between(time, force[:, k] - error[:, k], force[:, k] + error[:, k], color=colour, alpha=0.25, lw=0)
        left.plot(time, force[:, k], color=colour, label=f"along {name}")
        left.plot(time, 1e3 * shown_run.truth[:, k], color=colour, linestyle="--", linewidth=0.9)
    left.set(xlabel="time (s)", ylabel="tip force (mN), true: dashed")
    left.legend()
    right.axhspan(*band, color="0.9")
    right.plot(time, nees, color=tube_colour(0))
    right.set(xlabel="time (s)", ylabel="mean NEES and its 95 % band", ylim=(0, None))
    return figure


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
