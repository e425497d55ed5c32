"""Panels with scales: quantities over time or another parameter, bands of uncertainty, and bars."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...equilibrium.result import Equilibrium
from ...files.units import TO_MM
from ...stability.following import PathStretch
from ...typing import Array
from ..page import tube_colour
from .labels import arrow, legend_beside
from .style import FAINT, INK, Axes


class PanelScale(NamedTuple):
    """Vertical axis of a panel."""

    name: str
    """Name with the unit."""
    factor: float = 1.0
    """Factor from SI to the unit."""
    low: float | None = None
    """Lower end of the axis, in the unit; lower values extend the axis. None: from the values."""
    high: float | None = None
    """Upper end of the axis, in the unit; higher values extend the axis. None: from the values."""
    min_span: float = 0.0
    """Smallest height, in the unit, so that round-off about a constant does not resemble a signal."""


MARGIN = PanelScale("margin", low=-0.02, high=1.05)
ROTATION = PanelScale("rotation (deg)", 180 / np.pi, min_span=10.0)
TRANSLATION = PanelScale("translation (mm)", TO_MM, min_span=5.0)
CLEARANCE = PanelScale("clearance (mm)", TO_MM, low=0.0)
DEVIATION = PanelScale("deviation (mm)", TO_MM, low=0.0)


def draw_over(
    axes: Axes,
    x: ArrayLike,
    values: ArrayLike,
    scale: PanelScale,
    *,
    name: str = "",
    limit: float | None = None,
    **look: Any,
) -> Any:
    """Line of a quantity over x (T,), with the vertical axis of its scale; returns the line.

    Args:
        values: (T,) SI; NaN breaks the line.
        name: for the legend.
        limit: required value, SI, as a dashed line.
        look: properties of the line.
    """
    drawn = scale.factor * np.asarray(values, dtype=float)
    default: dict[str, Any] = {"color": INK, "lw": 1.4}
    (line,) = axes.plot(x, drawn, label=name or "_", **default | look)
    if limit is not None:
        axes.axhline(scale.factor * limit, color=FAINT, lw=0.8, ls="--", label="required")
    fit_scale(axes, scale)
    return line


def fit_scale(axes: Axes, scale: PanelScale) -> None:
    """Name the vertical axis of a panel and set its limits, once its data are drawn."""
    axes.set_ylabel(scale.name)
    data = axes.dataLim
    axes.autoscale(axis="y")
    low, high = axes.get_ylim()
    if scale.low is not None and not data.ymin < scale.low:
        low = scale.low
    if scale.high is not None and not data.ymax > scale.high:
        high = scale.high
    if high - low < scale.min_span:
        # Symmetric about the middle, so that a constant is a line across the panel.
        low, high = (low + high - scale.min_span) / 2, (low + high + scale.min_span) / 2
    axes.set_ylim(low, high)


def draw_joints(panels: Sequence[Axes], x: Array, rotations: Array, translations: Array) -> None:
    """Draw joint values (T, n), rad and m, over x (T,) in two panels, with a legend of the tubes."""
    for axes, scale, values in zip(panels, (ROTATION, TRANSLATION), (rotations, translations), strict=True):
        for i, row in enumerate(values.T):
            # Outer tubes wider and behind: where joints move together, all curves stay visible.
            look: dict[str, Any] = {"color": tube_colour(i), "lw": 1.2 + 1.1 * i, "zorder": 2 - 0.01 * i}
            draw_over(axes, x, row, scale, name=f"tube {i + 1}", **look)
    legend_beside(panels[0])


def share_x(panels: Sequence[Axes], x: ArrayLike, name: str = "time (s)") -> None:
    """Give panels below each other rules, aligned names, and one horizontal axis over the range of x (T,)."""
    first, last = float(np.min(x)), float(np.max(x))
    for axes in panels:
        axes.grid(axis="y")
        axes.tick_params(labelbottom=axes is panels[-1])
        # A motion of no duration would give an axis of no length.
        axes.set_xlim(first, max(last, first + 1e-9))
    panels[-1].set_xlabel(name)
    panels[0].figure.align_ylabels(panels)


def draw_broken(
    axes: Axes,
    stretches: Sequence[PathStretch],
    quantity: Callable[[Equilibrium], float],
    scale: PanelScale,
    *,
    colour: str = INK,
    width: float = 1.4,
    name: str = "",
    arrows: bool = False,
) -> None:
    """Draw a quantity of equilibria that jumps at snaps: an open mark before each snap, a full one after it.

    arrows: an arrow between both marks too.
    """
    drawn = [np.array([quantity(each) for each in stretch.equilibria]) for stretch in stretches]
    for k, (stretch, values) in enumerate(zip(stretches, drawn, strict=True)):
        draw_over(axes, stretch.at, values, scale, name="" if k else name, color=colour, lw=width, zorder=3)
    look: dict[str, Any] = {"ms": 4.5, "mec": colour, "zorder": 4, "clip_on": False}
    for stretch, (before, after) in zip(stretches, pairwise(drawn), strict=False):
        x, start, end = stretch.at[-1], scale.factor * before[-1], scale.factor * after[0]
        axes.plot([x], [start], "o", mfc="white", mew=1.2, **look)
        axes.plot([x], [end], "o", mfc=colour, **look)
        if arrows:
            arrow(axes, (x, start), (x, end), colour, width=0.9, head=8, margins=(2, 2), zorder=2)


def draw_band(
    axes: Axes,
    x: ArrayLike,
    low: ArrayLike,
    high: ArrayLike,
    colour: str,
    *,
    name: str = "",
    alpha: float = 0.3,
    width: float = 0.0,
) -> None:
    """Draw the range from `low` (T,) to `high` (T,) over x (T,), with an edge of `width` points."""
    axes.fill_between(np.asarray(x), low, high, color=colour, alpha=alpha, lw=width, label=name or "_")


BAR = 0.62
"""Height of a bar over the distance of two bars."""


def draw_bars(
    axes: Axes,
    names: Sequence[str],
    values: ArrayLike,
    quantity: str,
    *,
    colours: str | Sequence[str],
    labels: Sequence[str] | None = None,
) -> Any:
    """Horizontal bars, the first one on top; returns them.

    Args:
        names: of the bars, at their left.   values: (N,), in the unit of `quantity`, the name of the scale.
        labels: text at the end of every bar.
    """
    rows = np.arange(len(names))
    bars = axes.barh(rows, values, color=colours, height=BAR)
    axes.set_yticks(rows, names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    if labels is not None:
        axes.bar_label(bars, labels, padding=4, fontsize=7)
    axes.set_xlabel(quantity)
    return bars
