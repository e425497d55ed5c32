"""Distance to the nearest snap while tube 1 of the robot of the thesis turns, beside the stability margin.

Result: the margin is still 0.875 at 200 deg, 14.2 deg before the snap. The snap distance shows it from the start: at
home all tubes may turn by 80.5 deg each (proved), at 200 deg by 7.1 deg.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

import tubeopt
from tubeopt.show.page import tube_colour
from tubeopt.show.plots.style import new_figure, picture
from tubeopt.typing import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path, samples: int = 40) -> list[Path]:
    """Follow the turn, measure the distance at each step, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    snap = tubeopt.find_snap(robot, (np.zeros(3), None), (np.radians([360.0, 0.0, 0.0]), None))
    assert snap is not None
    last = float(np.degrees(snap.rotations[0]))
    # Denser towards the snap, where the margin falls like a square root.
    angles = last * (1 - np.linspace(1, 0.02, samples) ** 2)
    path = tubeopt.follow(robot, np.radians(angles)[:, None] * [1.0, 0.0, 0.0])
    distances = [tubeopt.snap_distance(e) for e in path.equilibria]
    proved = np.degrees([d.turn for d in distances])
    result = np.degrees([np.nanmin(np.abs(d.one_tube)) / 2 for d in distances])
    for angle, e, d in list(zip(angles, path.equilibria, proved, strict=True))[:: max(1, samples // 4)]:
        print(f"{angle:6.1f} deg: margin {e.margin:.3f}, any tubes may turn by {d:.1f} deg")

    picture_path = out / "thesis_snap_distance.png"
    margin = np.array([e.margin for e in path.equilibria])
    plot_distances(Distances(angles, last, margin, proved, result), picture_path)
    return [picture_path]


class Distances(NamedTuple):
    """Margin, proved distance and half a turn of one tube to its snap (T,), by rotations of tube 1 up to `last`."""

    angles: Array
    last: float
    margin: Array
    proved: Array
    found: Array


@picture
def plot_distances(turned: Distances) -> Figure:
    """Margin above, proved distance and half of the nearest one-tube snap below, over the rotation of tube 1."""
    angles, last, margin, proved, result = turned
    figure = new_figure(6.4, 4.2)
    above, below = figure.subplots(2, 1, sharex=True)
    above.plot(angles, margin, color=tube_colour(0))
    above.set(ylabel="stability margin", ylim=(0, 1.05))
    below.fill_between(angles, proved, color=tube_colour(2), alpha=0.25, linewidth=0)
    below.plot(angles, proved, color=tube_colour(2), label="no snap (proved)")
    below.plot(angles, result, color=tube_colour(1), linestyle="--", label="half a turn of one tube that snaps")
    below.set(xlabel="rotation of tube 1 (deg)", ylabel="turn of every tube (deg)", ylim=(0, None))
    below.legend(loc="best")
    for panel in (above, below):
        panel.axvline(last, color="0.5", linewidth=0.8)
    figure.align_ylabels()
    return figure


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
