"""Twist along the arm: how far each tube is turned, and how fast it turns, over arc length."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import scipy

from ...equilibrium.result import Equilibrium
from ...files.units import TO_MM
from ...typing import Array
from ..page import tube_colour
from .style import FAINT, INK, Axes, Figure, caption, entitle, name_above, new_figure, picture, widen

JUMP = 1e-3
"""Share of the range of theta' from which a difference across a breakpoint is drawn as a jump."""


@picture
def plot_torsion(equilibrium: Equilibrium) -> Figure:
    """Picture of the rotation and the torsion of every tube over arc length.

    theta_i(s) in deg stands above theta_i'(s) in deg/mm; each curve ends where its tube ends, and theta' is broken
    where it jumps. Curves of outer tubes are thicker, so that curves that coincide stay visible inside one another.
    """
    return _torsions([equilibrium], [""])


@picture
def plot_torsions(
    equilibria: Sequence[Equilibrium],
    *,
    titles: Sequence[str] | None = None,
) -> Figure:
    """`plot_torsion` of several equilibria of one robot side by side, with the same scales.

    Args:
        equilibria: what to draw, left to right.
        titles: a heading for each; None is the robot's name.
    """
    return _torsions(equilibria, titles or [""] * len(equilibria))


def _torsions(equilibria: Sequence[Equilibrium], titles: Sequence[str]) -> Figure:
    count = len(equilibria)
    figure = new_figure(7.0 if count == 1 else 4.0 * count, 5.0)
    panels = figure.subplots(2, count, sharex=True, sharey="row", squeeze=False)
    for (above, below), equilibrium, title in zip(panels.T, equilibria, titles, strict=True):
        _draw_curves(above, below, equilibrium)
        _draw_inputs(above, equilibrium)
        rows = _mark_sections(above, below, equilibrium, room=0.12 if count == 1 else 0.22)
        below.set_xlabel("arc length s from the base plate (mm)")
        entitle(above, caption(equilibrium, title, narrow=count > 1), pad=8 + 9 * rows)
    above, below = panels[:, 0]
    above.set_ylabel("rotation \N{GREEK SMALL LETTER THETA} (deg)")
    below.set_ylabel("torsion \N{GREEK SMALL LETTER THETA}\N{PRIME} (deg/mm)")
    length = max(float(each.tube_end.max()) for each in equilibria)
    below.set_xlim(0, 1.02 * TO_MM * length if length > 0 else 1.0)
    widen(above, 20.0)
    widen(below, 0.02)
    _add_legend(figure, above)
    return figure


def _draw_curves(above: Axes, below: Axes, equilibrium: Equilibrium) -> None:
    """theta_i in deg into `above` and theta_i' in deg/mm into `below`, up to the end of each tube."""
    for i, end in reversed(list(enumerate(equilibrium.tube_end))):
        s, rotation, torsion = _curve(equilibrium, i, float(end))
        for axes, values in ((above, np.degrees(rotation)), (below, np.degrees(torsion) / TO_MM)):
            look: dict[str, Any] = {"color": tube_colour(i), "clip_on": False}
            axes.plot(s * TO_MM, values, lw=1.2 + 0.9 * i, solid_capstyle="butt", label=f"tube {i + 1}", **look)
            if end > 0:
                axes.plot(s[-1:] * TO_MM, values[-1:], "o", ms=3.6 + 0.9 * i, zorder=4, **look)
    for axes in (above, below):
        axes.grid(axis="y")


def _curve(equilibrium: Equilibrium, tube: int, end: float) -> tuple[Array, Array, Array]:
    """Arc length, theta and theta' of one tube up to its `end`, cubic between the points of a section.

    Where theta' jumps from one section to the next, as between an arc and a helix, NaN stands between both values.
    """
    inside = equilibrium.arc_length <= end + 1e-12
    s = equilibrium.arc_length[inside]
    rotation, torsion = equilibrium.rotation[tube, inside], equilibrium.torsion[tube, inside]
    if len(s) < 2:
        return s, rotation, torsion
    cuts = np.unique(np.searchsorted(s, [0.0, *equilibrium.section_start, s[-1]] - np.array(1e-12)))
    parts: list[Array] = []
    for first, last in pairwise(cuts[cuts < len(s)]):
        own = slice(first, last + 1)
        slopes = torsion[own].copy()
        if first > 0:
            slopes[0] = _first_slope(s[own], rotation[own], torsion[own])
        fine = np.union1d(s[own], np.linspace(s[first], s[last], 2 + int(300 * (s[last] - s[first]) / s[-1])))
        curve = scipy.interpolate.CubicHermiteSpline(s[own], rotation[own], slopes)
        if parts and abs(slopes[0] - torsion[first]) > JUMP * np.ptp(torsion):
            parts.append(np.full((3, 1), np.nan))
        parts.append(np.array([fine, curve(fine), curve(fine, 1)]))
    arc_length, angle, slope = np.concatenate(parts, axis=1)
    return arc_length, angle, slope


def _first_slope(s: Array, rotation: Array, torsion: Array) -> float:
    """theta' where a section begins, from what stands behind it: the answer holds the value in front of a jump."""
    points = np.r_[0, np.repeat(np.arange(1, min(len(s), 4)), 2)]
    values = rotation[points]
    values[2::2] = torsion[points[2::2]]
    slope = scipy.interpolate.KroghInterpolator(s[points] - s[0], values).derivative(0.0)
    return float(slope)


def _draw_inputs(axes: Axes, equilibrium: Equilibrium) -> None:
    """The rotation imposed behind the plate, at the left edge: its distance to the curve is the wind-up there."""
    for i, rotation in reversed(list(enumerate(np.degrees(equilibrium.rotations)))):
        axes.plot([0], [rotation], ">", mfc="white", mec=tube_colour(i), ms=5 + 2 * i, clip_on=False, zorder=5)


def _add_legend(figure: Figure, axes: Axes) -> None:
    """Names of the curves in `axes` and of the sign of an input, below all panels."""
    handles, labels = axes.get_legend_handles_labels()
    (mark,) = axes.plot([], [], ">", mfc="white", mec=INK, ms=6)
    figure.legend(
        [*reversed(handles), mark],
        [*reversed(labels), "rotation imposed behind the plate"],
        loc="outside lower center",
        ncols=len(handles) + 1,
        handlelength=1.8,
        columnspacing=1.6,
    )


def breakpoints(equilibrium: Equilibrium) -> dict[float, str]:
    """What happens at which arc length in front of the plate, mm: "tube 2 curves", "tube 3 ends"."""
    events: dict[float, list[str]] = {}
    for i, tube in enumerate(equilibrium.robot.tubes):
        end = float(equilibrium.tube_end[i])
        for s, what in ((end - tube.curved_length, "curves"), (end, "ends")):
            if s > 1e-9 and (what == "ends" or tube.curved_length > 0):
                events.setdefault(round(s * TO_MM, 6), []).append(f"{i + 1} {what}")
    return {s: "tube " + ", ".join(events[s]) for s in sorted(events)}


def _mark_sections(above: Axes, below: Axes, equilibrium: Equilibrium, *, room: float) -> int:
    """A thin line at every breakpoint, named on top; return how many rows of names that took.

    Names less than `room` (a fraction of the width) apart go into different rows.
    """
    width = float(equilibrium.tube_end.max()) * TO_MM
    reached: list[float] = []
    for s, what in breakpoints(equilibrium).items():
        for axes in (above, below):
            axes.axvline(s, color=FAINT, lw=0.6, ls=(0, (4, 3)), zorder=0)
        row = next((k for k, last in enumerate(reached) if s - last > room * width), len(reached))
        reached[row : row + 1] = [s]
        name_above(above, s, what, row)
    return len(reached)
