"""Loads of drives, over a motion or in a workspace, and strain cycles of tubes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...files.units import TO_MILLI, TO_MM
from ...stability import Drives, Fatigue
from ...stability.drives import DrivesStatus
from ...stability.fatigue import ANY_MEAN, LIMITS
from ...typing import Array
from ..page import tube_colour
from .labels import legend_beside
from .panels import PanelScale, draw_over, share_x
from .style import FAINT, INK, Axes, Figure, headed, new_figure, number, picture

TORQUE = PanelScale("torque (mN m)", TO_MILLI, min_span=1e-3)
STRAIN = PanelScale("strain (%)", 100.0, min_span=1e-3)
FORCE = PanelScale("force (mN)", TO_MILLI, min_span=1e-3)


@picture
def plot_drives(drives: Drives, *, title: str = "") -> Figure:
    """Picture of the loads of drives.

    Along a motion: torques and forces over time or the waypoints, and the points of load and speed of each drive if
    there are times. At single configurations: the percentage of them in which a load is exceeded.

    Args:
        drives: result of `drives_along` or `drives_at`.
        title: heading; default the robot's name.
    """
    d = drives
    loads = ((d.torque, TORQUE, "tube"), (d.force, FORCE, "carriage"))
    if d.status is DrivesStatus.AT:
        figure = new_figure(9.0, 3.6)
        for axes, (values, scale, what) in zip(figure.subplots(1, 2), loads, strict=True):
            _draw_exceeded(axes, np.abs(values), scale, what)
    elif d.timed:
        figure = new_figure(10.0, 5.0)
        panels = figure.subplots(2, 2, width_ratios=(5, 3), squeeze=False)
        _draw_along(panels[:, 0].tolist(), d)
        rates = ((d.turn_rate, np.degrees(1.0), "deg/s"), (d.slide_rate, TO_MM, "mm/s"))
        for axes, (values, scale, _), (rate, factor, unit) in zip(panels[:, 1], loads, rates, strict=True):
            _draw_speeds(axes, values * scale.factor, rate * factor)
            axes.set_xlabel(f"speed ({unit})")
            axes.set_ylabel(scale.name)
    else:
        figure = new_figure(7.0, 5.0)
        _draw_along(figure.subplots(2, 1, squeeze=False)[:, 0].tolist(), d)
    torque, force = (f"{number(TO_MILLI * float(peak.max()), 2)}" for peak in d.value)
    return headed(figure, f"{title or d.robot.name or 'Tube robot'}\nup to {torque} mN m and {force} mN")


def _draw_along(panels: Sequence[Axes], d: Drives) -> None:
    """Draw torques and forces over a motion in two panels."""
    for axes, values, scale, what in ((panels[0], d.torque, TORQUE, "tube"), (panels[1], d.force, FORCE, "carriage")):
        for i, row in enumerate(values.T):
            draw_over(axes, d.at, row, scale, name=f"{what} {i + 1}", color=tube_colour(i))
        axes.axhline(0.0, color=FAINT, lw=0.8, zorder=0)
        legend_beside(axes)
    share_x(panels, d.at, "time (s)" if d.timed else "waypoint, from 0")


def _draw_speeds(axes: Axes, load: Array, rate: Array) -> None:
    """Draw the points of speed (T - 1, k) and load (T, k) between the rows, at both ends of each step."""
    for i in range(load.shape[1]):
        known = np.isfinite(rate[:, i])
        speed = np.concatenate([rate[known, i]] * 2)
        axes.plot(speed, np.concatenate([load[:-1, i][known], load[1:, i][known]]), ".", ms=3, color=tube_colour(i))
    axes.axhline(0.0, color=FAINT, lw=0.8, zorder=0)
    axes.axvline(0.0, color=FAINT, lw=0.8, zorder=0)


def _draw_exceeded(axes: Axes, size: Array, scale: PanelScale, what: str) -> None:
    """Draw the percentage of configurations in which each load of sizes (T, k) is exceeded."""
    share = 100 * (1 - np.arange(len(size)) / len(size))
    for i, row in enumerate(np.sort(size, axis=0).T):
        axes.plot(scale.factor * row, share, color=tube_colour(i), lw=1.4, label=f"{what} {i + 1}")
    axes.set_xlabel(scale.name)
    axes.set_ylabel("configurations with more (%)")
    axes.set_ylim(0, 100)
    axes.set_xlim(left=0)
    axes.grid()
    legend_beside(axes)


@picture
def plot_fatigue(fatigue: Fatigue, *, title: str = "") -> Figure:
    """Picture of strain cycles: the largest changing strain of every tube over a repetition, and amplitudes over means.

    Args:
        fatigue: result of `fatigue`.
        title: heading; default the robot's name.
    """
    figure = new_figure(10.0, 3.8)
    over, cycles = figure.subplots(1, 2, width_ratios=(5, 4))
    for i, tube in enumerate(fatigue.tubes):
        draw_over(over, tube.waypoint, tube.history, STRAIN, name=f"tube {i + 1}", color=tube_colour(i))
        amplitude, mean = 100 * tube.cycles.amplitude, 100 * tube.cycles.mean
        cycles.plot(mean, amplitude, "o", ms=4, color=tube_colour(i), clip_on=False)
    share_x([over], fatigue.tubes[0].waypoint, "waypoint")
    legend_beside(over)
    for limit, name in ((ANY_MEAN, "4e8 cycles"), (LIMITS[0], "1e7 cycles, least"), (LIMITS[1], "1e7 cycles, largest")):
        cycles.axhline(100 * limit, color=FAINT, lw=0.8, ls="--")
        cycles.annotate(
            name, (1.0, 100 * limit), xycoords=("axes fraction", "data"), ha="right", va="bottom", color=INK
        )
    cycles.set_xlabel("mean strain (%)")
    cycles.set_ylabel("strain amplitude (%)")
    cycles.set_ylim(bottom=0)
    largest = float(fatigue.value.max())
    return headed(
        figure, f"{title or fatigue.robot.name or 'Tube robot'}\nstrain amplitude up to {number(100 * largest, 2)} %"
    )
