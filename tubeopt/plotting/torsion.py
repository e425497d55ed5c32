"""Twist along the arm: how far each tube is turned, and how fast it turns, over arc length."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from ..robots.assembly import Array
from .style import FAINT, INK, caption, new_figure, save_figure, styled, tube_colour

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

    from ..equilibrium import Equilibrium

MM = 1e3


@styled
def plot_torsion(equilibrium: Equilibrium, path: str | PathLike[str] | None = None) -> Figure:
    """Picture of the rotation and the torsion of every tube over arc length, 7.0 x 5.0 in.

    Args:
        equilibrium: what to draw.
        path: where to save the picture (PNG, PDF or SVG by its ending); None saves nothing.

    Raises:
        InputError: the name of the picture does not end in a known format.
    """
    figure = new_figure(7.0, 5.0)
    draw_torsion(figure, equilibrium)
    if path is not None:
        save_figure(figure, path)
    return figure


@styled
def draw_torsion(figure: Figure | SubFigure, equilibrium: Equilibrium, *, title: str | None = None) -> None:
    """Draw theta_i(s) in deg above theta_i'(s) in deg/mm into `figure`, or a part of one.

    Each curve ends where its tube ends. Curves of outer tubes are thicker, so that curves that coincide stay visible
    inside one another. `title` replaces the robot's name.
    """
    above, below = figure.subplots(2, 1, sharex=True)
    _draw_curves(above, equilibrium, np.degrees(equilibrium.rotation))
    _draw_curves(below, equilibrium, np.degrees(equilibrium.torsion) / MM)
    _draw_inputs(above, equilibrium)
    above.set_ylabel("rotation \N{GREEK SMALL LETTER THETA} (deg)")
    below.set_ylabel("torsion \N{GREEK SMALL LETTER THETA}\N{PRIME} (deg/mm)")
    below.set_xlabel("arc length s from the base plate (mm)")
    _mark_sections(above, equilibrium, names=True)
    _mark_sections(below, equilibrium, names=False)
    _widen(above, 20.0)
    _widen(below, 0.02)
    below.set_xlim(0, float(equilibrium.tube_end.max()) * MM * 1.02)
    figure.suptitle(caption(equilibrium, title), fontsize=9, x=0.02, ha="left")


def _draw_curves(axes: Axes, equilibrium: Equilibrium, values: Array) -> None:
    """One curve per tube, `values` (n, m) over arc length, up to the tube's own end."""
    for i in reversed(range(len(values))):
        end = equilibrium.tube_end[i]
        inside = equilibrium.arc_length <= end + 1e-12
        s, value = equilibrium.arc_length[inside] * MM, values[i, inside]
        axes.plot(s, value, color=tube_colour(i), lw=1.4 + 1.1 * i, solid_capstyle="butt", label=f"tube {i + 1}")
        axes.plot(s[-1:], value[-1:], "o", color=tube_colour(i), ms=4 + 1.1 * i, clip_on=False, zorder=4)
    axes.grid(axis="y", color="#E6E8EB", lw=0.5)
    axes.set_axisbelow(True)


def _draw_inputs(axes: Axes, equilibrium: Equilibrium) -> None:
    """The rotation imposed behind the plate, at the left edge: its distance to the curve is the wind-up there."""
    for i, rotation in enumerate(np.degrees(equilibrium.rotations)):
        axes.plot([0], [rotation], ">", mfc="white", mec=tube_colour(i), ms=6 + i, clip_on=False, zorder=5)
    handles, labels = axes.get_legend_handles_labels()
    (mark,) = axes.plot([], [], ">", mfc="white", mec=INK, ms=6)
    axes.legend(
        [*reversed(handles), mark],
        [*reversed(labels), "rotation imposed behind the plate"],
        loc="lower left",
        bbox_to_anchor=(0, 1.08),
        ncols=len(handles) + 1,
        borderaxespad=0,
        handlelength=1.6,
        columnspacing=1.4,
    )


def _mark_sections(axes: Axes, equilibrium: Equilibrium, *, names: bool) -> None:
    """A thin line at every breakpoint, named by what happens there."""
    marks: dict[float, list[str]] = {}
    for start in equilibrium.section_start:
        marks.setdefault(round(float(start) * MM, 6), [])
    for i, tube in enumerate(equilibrium.robot.tubes):
        end = float(equilibrium.tube_end[i])
        bend = end - tube.curved_length
        if bend > 0 and tube.curved_length > 0:
            marks.setdefault(round(bend * MM, 6), []).append(f"{i + 1} curves")
        if end > 0:
            marks.setdefault(round(end * MM, 6), []).append(f"{i + 1} ends")
    for s, events in marks.items():
        axes.axvline(s, color=FAINT, lw=0.6, ls=(0, (4, 3)), zorder=0)
        if names and events:
            axes.annotate(
                "tube " + ", ".join(events),
                (s, 1),
                (0, 2),
                xycoords=("data", "axes fraction"),
                textcoords="offset points",
                ha="center",
                va="bottom",
                fontsize=7,
                color=FAINT,
            )


def _widen(axes: Axes, least: float) -> None:
    """Let the y axis span at least `least`, so that round-off about a constant does not look like a signal."""
    low, high = axes.get_ylim()
    if high - low < least:
        middle = (low + high) / 2
        axes.set_ylim(middle - least / 2, middle + least / 2)
