"""The state estimator of the C library in simulated runs: consistency, error of the force, and time of a reading.

    python -m benchmarks.estimator [--runs 50] [--seconds 0.6] [--tracker-only]

A robot moves at 100 Hz. Offsets of its joints and a force at its tip that changes at random are drawn from the priors.
A tracker sees its tip 50 ms late, with noise of 0.3 mm and 0.5 deg, and loses a third of the poses; a sensor below the
plate measures force and moment. Printed: mean normalised squared error (NEES) of all runs with its 95 % band, errors of
the force along the axes of its covariance, and processor time.
"""

from __future__ import annotations

import argparse
import time
from typing import NamedTuple

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

import tubeopt
from benchmarks.timing import show, table
from tubeopt.control.c_binding import CEstimator
from tubeopt.control.c_library import CLibrary, c_library
from tubeopt.control.estimator import HIDDEN, BaseReading, EstimatorOptions, TipReading
from tubeopt.typing import Array

START = np.array([0.0, 1.0, 2.0]), np.array([-0.05, -0.03, -0.02])
DT, LATE, LOST = 0.01, 5, 1 / 3
METHOD = tubeopt.Newton(margin_tolerance=1e-3)


class Run(NamedTuple):
    """One run."""

    nees: Array
    """(T,) after each step."""
    errors: Array
    """(3,) of the force along the axes of its covariance at the end, from the best to the worst, N."""
    deviations: Array
    """(3,) standard deviations that the filter states along these, N."""
    took: Array
    """Processor times of the readings, s."""


def run(library: CLibrary, seed: int, steps: int, *, tracker_only: bool, options: EstimatorOptions) -> Run:
    """A simulated run."""
    robot, random, phi = library.robot, np.random.default_rng(seed), np.exp(-DT / options.force_time)
    turned, shifted = random.normal(0, options.rotation, 3), random.normal(0, options.translation, 3)
    force, arm = random.normal(0, options.force, 3), tubeopt.forward_kinematics(robot, *START)
    estimator, late, nees, took = CEstimator(library, START, options), [], [], []
    for k in range(steps):
        turn = START[0] + 0.6 * np.sin(np.array([2.0, 1.3, 1.7]) * DT * k)
        shift = START[1] + 4e-3 * np.sin(np.array([2.2, 1.5, 1.1]) * DT * k)
        if k:
            force = phi * force + np.sqrt(1 - phi**2) * random.normal(0, options.force, 3)
        load = tubeopt.Load(tuple(force.tolist()))
        arm = tubeopt.forward_kinematics(robot, turn + turned, shift + shifted, load=load, start=arm, method=METHOD)
        direction = Rotation.from_rotvec(random.normal(0, np.radians(0.5), 3)).apply(arm.tip_rotation[:, 2])
        tip = TipReading(arm.tip_position + random.normal(0, 3e-4, 3), direction=direction)
        late.append((DT * k, (turn, shift), tip))
        readings = []
        if not tracker_only:
            wrench = arm.base_wrench + random.normal(size=6) * np.repeat([5e-3, 1e-3], 3)
            readings.append((DT * k, (turn, shift), BaseReading(wrench)))
        if k >= LATE and random.random() > LOST:
            readings.append(late[k - LATE])
        for reading in readings:
            start = time.thread_time()
            estimator.measured(*reading)
            took.append(time.thread_time() - start)
        if readings and not tracker_only:
            x, covariance = estimator.estimate()
            off = x - np.concatenate([force, turned, shifted])
            nees.append(off @ np.linalg.solve(covariance, off))
    x, covariance = estimator.estimate()
    square, axes = np.linalg.eigh(covariance[:3, :3])
    return Run(np.array(nees), axes.T @ (x[:3] - force), np.sqrt(square), np.array(took))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="thesis_ctr")
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=0.6)
    parser.add_argument("--force-time", type=float, default=10.0, help="correlation time of the force, s")
    parser.add_argument("--tracker-only", action="store_true", help="without the sensor below the plate")
    asked = parser.parse_args()
    library, steps = c_library(tubeopt.load_robot(asked.robot), loads=True), round(asked.seconds / DT)
    options = EstimatorOptions(force=0.05, force_time=asked.force_time)
    runs = [run(library, seed, steps, tracker_only=asked.tracker_only, options=options) for seed in range(asked.runs)]
    rows = []
    if not asked.tracker_only:
        mean = np.mean([each.nees for each in runs], axis=0)
        low, high = scipy.stats.chi2.ppf([0.025, 0.975], 9 * asked.runs) / asked.runs
        inside = float(((low < mean) & (mean < high)).mean())
        rows += [
            ("NEES, mean of 9", f"{mean.mean():.2f}"),
            ("NEES at the end", f"{mean[-1]:.2f}"),
            ("95 % band", f"{low:.2f} to {high:.2f}"),
            ("times within it", f"{inside:.0%}"),
        ]
    errors = np.sqrt(np.mean([each.errors**2 for each in runs], axis=0))
    deviations = np.median([each.deviations for each in runs], axis=0)
    for axis in range(3):
        known = "" if deviations[axis] <= HIDDEN * options.force else ", not observed"
        stated = f"{deviations[axis] * 1e3:.2f} mN stated{known}"
        rows.append((f"force, {('best', 'middle', 'worst')[axis]} direction", f"{errors[axis] * 1e3:.2f} mN, {stated}"))
    took = np.concatenate([each.took for each in runs]) * 1e3
    rows.append(("a reading", f"{np.median(took):.2f} ms in the median, {np.quantile(took, 0.999):.2f} ms at 99.9 %"))
    show([table(f"{asked.robot}, {asked.runs} runs of {steps} steps", ("", ""), rows)], [])


if __name__ == "__main__":
    main()
