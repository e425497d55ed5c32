"""Motion through waypoints: the tip and the margin on the way, broken where the robot snaps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from ...equilibrium.result import Equilibrium
from ...files.units import TO_MM
from ...stability import Path
from ...stability.following import Stretch
from ...typing import Array
from .style import FAINT, INK, Axes, Figure, headed, legend_beside, name_above, new_figure, number, picture

COORDINATES = (("x", "#D55E00"), ("y", "#009E73"), ("z", "#0072B2"))
"""Coordinates of the tip and their colours; from the palette of Okabe and Ito (2008)."""

MOST_NAMES = 12
"""Snaps that are named in the picture; more would cover each other."""

Value = Callable[[Equilibrium], float]
"""What is drawn of an equilibrium."""


@picture
def plot_path(path: Path) -> Figure:
    """Picture of a motion: tip position over the waypoints, and the margin below it.

    The curves have the points of `path.dense`, those between waypoints included. At a snap they break: an open mark
    before it, a full mark after it.
    """
    parts = path.dense
    figure = new_figure(7.0, 5.0)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    for k, (name, colour) in enumerate(COORDINATES):
        draw_broken(above, parts, partial(_coordinate, k), colour, label=name)
    draw_broken(below, parts, lambda e: e.margin, INK)
    _mark_snaps(above, below, path)
    below.axhline(0, color=FAINT, lw=0.7)
    least = float(np.nanmin([each.margin for _, what in parts for each in what]))
    below.set_ylim(min(-0.05, least - 0.05), 1.05)
    above.set_ylabel("tip position (mm)")
    below.set(ylabel="margin", xlabel="waypoint")
    last = len(path.equilibria)
    below.set_xlim(1 - 0.02 * last, last + 0.02 * last)
    below.xaxis.get_major_locator().set_params(integer=True)
    for axes in (above, below):
        axes.grid(axis="y")
    legend_beside(above)
    headed(figure, _heading(path))
    return figure


def _coordinate(axis: int, equilibrium: Equilibrium) -> float:
    """Of the tip, mm."""
    return float(equilibrium.tip_position[axis]) * TO_MM


def draw_broken(
    axes: Axes, parts: Sequence[Stretch], quantity: Value, colour: str, *, width: float = 1.4, label: str = ""
) -> list[Array]:
    """A quantity along the stretches of a path, with an open mark where each snap begins, and a full one where it ends;
    returns the values of each stretch."""
    drawn = [np.array([quantity(each) for each in what]) for _, what in parts]
    for k, ((where, _), values) in enumerate(zip(parts, drawn, strict=True)):
        axes.plot(where, values, color=colour, lw=width, label="_" if k else label, zorder=3)
    look: dict[str, Any] = {"ms": 4.5, "mec": colour, "zorder": 4, "clip_on": False}
    for (where, _), (old, new) in zip(parts, pairwise(drawn), strict=False):
        axes.plot(where[-1:], old[-1:], "o", mfc="white", mew=1.2, **look)
        axes.plot(where[-1:], new[:1], "o", mfc=colour, **look)
    return drawn


def _mark_snaps(above: Axes, below: Axes, path: Path) -> None:
    """A thin line at every snap, numbered on top."""
    for k, snap in enumerate(path.snaps, start=1):
        at = snap.index + 1 + snap.fraction
        for axes in (above, below):
            axes.axvline(at, color=FAINT, lw=0.7, ls=(0, (4, 3)), zorder=0)
        if len(path.snaps) <= MOST_NAMES:
            name_above(above, at, f"snap {k}\n{number(snap.tip_jump * TO_MM, 1)} mm")


def _heading(path: Path) -> str:
    robot = path.equilibria[0].robot
    count = {0: "no snap", 1: "1 snap"}.get(len(path.snaps), f"{len(path.snaps)} snaps")
    return f"{robot.name or 'Tube robot'}:  {len(path.equilibria)} waypoints,  {count}"
