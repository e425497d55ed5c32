"""Motion through waypoints: the tip and the margin on the way, broken where the robot snaps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...files.units import TO_MM
from ...typing import Array
from .style import FAINT, INK, headed, new_figure, number, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ...stability import Path


COORDINATES = (("x", "#D55E00"), ("y", "#009E73"), ("z", "#0072B2"))
"""Coordinates of the tip and their colours; from the palette of Okabe and Ito (2008)."""

MOST_NAMES = 12
"""Snaps that are named in the picture; more would cover each other."""


@picture
def plot_path(path: Path) -> Figure:
    """Picture of a motion: tip position over the waypoints, and the margin below it.

    At a snap the curves break: an open mark where the robot was, a full one where it lands.

    Args:
    """
    waypoint, tip, margin = _curves(path)
    figure = new_figure(7.0, 5.0)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    for k, (name, colour) in enumerate(COORDINATES):
        above.plot(waypoint, tip[:, k] * TO_MM, color=colour, lw=1.4, label=name)
        _mark_ends(
            above,
            path,
            [(s.before.tip_position[k] * TO_MM, s.after.tip_position[k] * TO_MM) for s in path.snaps],
            colour,
        )
    below.plot(waypoint, margin, color=INK, lw=1.4)
    _mark_ends(below, path, [(s.before.margin, s.after.margin) for s in path.snaps], INK)
    _mark_snaps(above, below, path)
    below.axhline(0, color=FAINT, lw=0.7)
    below.set_ylim(min(-0.05, float(np.nanmin(margin)) - 0.05), 1.05)
    above.set_ylabel("tip position (mm)")
    below.set_ylabel("margin")
    below.set_xlabel("waypoint")
    last = len(path.equilibria)
    below.set_xlim(1 - 0.02 * last, last + 0.02 * last)
    below.xaxis.get_major_locator().set_params(integer=True)
    for axes in (above, below):
        axes.grid(axis="y", color="#E6E8EB", lw=0.5)
        axes.set_axisbelow(True)
    above.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), handlelength=1.4)
    headed(figure, _heading(path))
    return figure


def _curves(path: Path) -> tuple[Array, Array, Array]:
    """Place in the path in waypoints from 1, tip (m) and margin there; NaN between the two sides of a snap."""
    points = [(k + 1.0, 0, e.tip_position, e.margin) for k, e in enumerate(path.equilibria)]
    gap = np.full(3, np.nan)
    for order, snap in enumerate(path.snaps):
        at = _place(snap.index, snap.fraction)
        points.append((at, 3 * order + 1, snap.before.tip_position, snap.before.margin))
        points.append((at, 3 * order + 2, gap, np.nan))
        points.append((at, 3 * order + 3, snap.after.tip_position, snap.after.margin))
    points.sort(key=lambda point: point[:2])
    return np.array([p[0] for p in points]), np.array([p[2] for p in points]), np.array([p[3] for p in points])


def _place(index: int, fraction: float) -> float:
    return index + 1 + fraction


def _mark_ends(axes: Axes, path: Path, ends: list[tuple[float, float]], colour: str) -> None:
    """An open mark where each snap begins, a full one where it ends."""
    for snap, (before, after) in zip(path.snaps, ends, strict=True):
        at = _place(snap.index, snap.fraction)
        axes.plot([at], [before], "o", ms=4, mfc="white", mec=colour, zorder=4, clip_on=False)
        axes.plot([at], [after], "o", ms=4, mfc=colour, mec=colour, zorder=4, clip_on=False)


def _mark_snaps(above: Axes, below: Axes, path: Path) -> None:
    """A thin line at every snap, numbered on top."""
    for k, snap in enumerate(path.snaps, start=1):
        at = _place(snap.index, snap.fraction)
        for axes in (above, below):
            axes.axvline(at, color=FAINT, lw=0.7, ls=(0, (4, 3)), zorder=0)
        if len(path.snaps) <= MOST_NAMES:
            above.annotate(
                f"snap {k}\n{number(snap.tip_jump * TO_MM, 1)} mm",
                (at, 1),
                (0, 2),
                xycoords=("data", "axes fraction"),
                textcoords="offset points",
                ha="center",
                va="bottom",
                fontsize=7,
                color=FAINT,
            )


def _heading(path: Path) -> str:
    robot = path.equilibria[0].robot
    count = {0: "no snap", 1: "1 snap"}.get(len(path.snaps), f"{len(path.snaps)} snaps")
    return f"{robot.name or 'Tube robot'}:  {len(path.equilibria)} waypoints,  {count}"
