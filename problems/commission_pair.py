"""Commissioning of a synthetic robot from a log of its drives and a tracker.

The log has columns without units. One motor counts backward, angles are in rad, and one carriage was homed elsewhere.
The tips come 0.12 s late, and the tubes differ from their drawing.

Result: units, directions, zeros and latency are found as they were drawn. The error held out is that of the noise.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from tubeopt import ConcentricRobot, forward_kinematics_batch, load_robot
from tubeopt.files.csv_file import to_csv
from tubeopt.files.files import write_text
from tubeopt.runs.commission_study import Commissioning
from tubeopt.runs.study_file import STUDY_KINDS
from tubeopt.show.plots.commission import plot_commissioning
from tubeopt.typing import Array

ROOT = Path(__file__).resolve().parents[1]
LOG = ROOT / "configs" / "experiments" / "commission_log.csv"
MM = 1e-3
RATE, NOISE, LATENCY = 20.0, 0.3 * MM, 0.12
HOMED = 0.0374
"""Reading of the second carriage at home, m."""

EFFECTS = ["latency", "translation", "rotation", "curvature"]


def true_robot() -> ConcentricRobot:
    """The pair as it was made: both tubes bend less than drawn."""
    robot = load_robot("braunschweig_pair")
    assert isinstance(robot, ConcentricRobot)
    inner, outer = robot.tubes
    bent = [replace(tube, curvature=factor * tube.curvature) for tube, factor in ((inner, 0.95), (outer, 0.97))]
    return replace(robot, tubes=tuple(bent))


def joints(time: Array) -> Array:
    """(N, 4) joint values, rad and m, at times (N,), s."""
    speed, phase = np.array([0.37, 0.29, 0.23, 0.31]), np.array([0.3, 1.9, 4.0, 5.1])
    waves = np.sin(np.outer(time, speed) + phase) + 0.5 * np.sin(np.outer(time, 2.3 * speed) + 2 * phase)
    return np.asarray(waves * [0.8, 0.7, 12 * MM, 9 * MM] + [0.0, 0.3, 5 * MM, -10 * MM])


def write_log(path: Path, count: int = 500) -> None:
    """Write the log of the laboratory."""
    time = np.arange(count) / RATE
    late, now = joints(time - LATENCY), joints(time)
    tips = forward_kinematics_batch(true_robot(), late[:, :2], late[:, 2:]).tip_position
    random = np.random.default_rng(7)
    turn = Rotation.from_euler("zyx", [40, -25, 130], degrees=True).as_matrix()
    seen = tips @ turn.T + [0.21, -0.05, 0.4] + random.normal(0, NOISE, tips.shape)
    moved = [now[:, 0], -now[:, 1], now[:, 2] / MM, (HOMED - now[:, 3]) / MM]
    table = np.column_stack([1e3 * time, *moved, seen])
    names = ("stamp", "motor_1", "motor_2", "slide_1", "slide_2", "x", "y", "z")
    header = (
        "Synthetic log of braunschweig_pair, from problems/commission_pair.py. Times in ms, rotations in rad, slides\n"
        "in mm, positions in m. Motor 2 and slide 2 count backward; slide 2 reads 37.4 at home. Tips come 0.12 s late."
    )
    digits = (".0f", ".5f", ".5f", ".3f", ".3f", ".6f", ".6f", ".6f")
    cells = [[format(x, form) for x, form in zip(row, digits, strict=True)] for row in table.tolist()]
    write_text(path, to_csv(names, cells, header))


def commissioned(log: Path = LOG) -> Commissioning:
    """What is found from the log."""
    keys = {"kind": "commission", "robot": load_robot("braunschweig_pair"), "logs": [str(log)], "effects": EFFECTS}
    answer: Commissioning = STUDY_KINDS["commission"].model_validate(keys).run()
    return answer


def main(directory: Path) -> list[Path]:
    """Draw the page of the commissioning, and print how the columns are read."""
    found = commissioned()
    (log,) = found.logs
    print(log.text(LOG.parent))
    for e in found.fit.estimates:
        print(f"{e.name}: {e.posterior_low:.4g} to {e.posterior_high:.4g} {e.unit}")
    print(f"held out, choice included: {found.comparison.chosen_anew.rms / MM:.2f} mm")
    path = directory / "commission_pair.png"
    plot_commissioning(found, path)
    return [path]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for picture in main(parser.parse_args().out):
        print(f"saved {picture}")
