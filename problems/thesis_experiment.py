"""The experiment of the thesis, Figures 4.16 and 4.17: tip errors of its eccentric robot over direction and separation.

The thesis does not print the measured points of Figure 4.16, only their distances to the simulated tips (Table 4.1).

Result: the model explains the positions of the circles, not the errors of the built robot. The largest error is about
13.5 % of its length and depends on direction.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.runs.measurement_file import load_error_table
from tubeopt.show.plots.validation import plot_error_table, plot_simulated_circles

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path) -> list[Path]:
    """Simulate the four circles, save both pictures into `out`, and return their paths."""
    table = load_error_table(ROOT / "configs" / "experiments" / "thesis_table_4_1.csv")
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_etr.yaml")
    circles = []
    for apart in table.separation:
        shapes = [tubeopt.forward_kinematics(robot, (d, d + apart, d - apart)) for d in table.direction]
        circles.append(np.array([shape.tip_position for shape in shapes]))
    pictures = [out / "thesis_experiment_circles.png", out / "thesis_experiment_errors.png"]
    title = "Simulated tips; discs: measured tip error (Table 4.1)"
    plot_simulated_circles(table, pictures[0], circles=circles, title=title)
    s = table.summary
    title = f"Tip error (mm) over direction: mean {s.mean * 1e3:.1f} mm, max {s.max * 1e3:.1f} mm"
    plot_error_table(table, pictures[1], title=title)
    return pictures


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the pictures")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
