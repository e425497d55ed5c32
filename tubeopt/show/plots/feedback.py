"""A heating that a sensor leads: temperatures of uncertain rigs, and what moves them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .heating import COLD, IDEAL, TUBE, WINDOW, WINDOW_ALPHA
from .style import INK, headed, new_figure, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ...runs.firmware_study import LedHeating


@picture
def plot_feedback(answer: LedHeating, *, title: str = "") -> Figure:
    """Picture of a led heating: curved parts of uncertain rigs over time, near the window, and what moves them."""
    feedback, spec = answer.feedback, answer.plan.spec
    figure = new_figure(9.4, 5.2)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.6, 1.0))
    whole = figure.add_subplot(grid[0, 0])
    close = figure.add_subplot(grid[1, 0])
    history = feedback.history
    inside = history.in_hold(feedback.law)
    for axes in (whole, close):
        axes.axhspan(*spec.window_degC, color=WINDOW, alpha=WINDOW_ALPHA, lw=0, label="window")
        axes.axhline(spec.limit, color=INK, lw=0.8, ls=(0, (5, 3)), label="limit")
    running = np.where(history.place < len(feedback.law.planned), 1.0, np.nan)
    whole.plot(history.time, (history.hottest * running)[:, 1:], color=TUBE, lw=0.3, alpha=0.35)
    whole.plot([], [], color=TUBE, label=f"hottest of the curve, {feedback.samples} rigs")
    held = np.where(inside, 1.0, np.nan)
    close.plot(history.time, (history.hottest * held)[:, 1:], color=TUBE, lw=0.3, alpha=0.35)
    close.plot(history.time, (history.coldest * held)[:, 1:], color=COLD, lw=0.3, alpha=0.35)
    close.plot([], [], color=TUBE, label="hottest of the curve in the hold")
    close.plot([], [], color=COLD, label="coldest")
    low, high = spec.window_degC
    close.set_ylim(low - 0.3 * (high - low), high + 0.3 * (high - low))
    times = history.time[inside.any(axis=1)]
    if len(times) > 1:
        close.set_xlim(times[0], times[-1])
    close.set_xlabel("time (s)")
    for axes in (whole, close):
        axes.set_ylabel("temperature (°C)")
        axes.legend(loc="lower right" if axes is whole else "lower left", fontsize=7, ncols=2)
    _draw_contributions(figure.add_subplot(grid[:, 1]), answer)
    low_p, high_p = feedback.interval
    kept = f"{100 * feedback.probability:.1f} % of {feedback.samples} rigs keep the window"
    sure = f"({100 * low_p:.1f} to {100 * high_p:.1f} %),  {100 * feedback.open_loop:.0f} % without it"
    headed(figure, f"{title or answer.plan.rig.name or 'rig'}, led by a {feedback.sensor.name}:  {kept} {sure}")
    return figure


def _draw_contributions(axes: Axes, answer: LedHeating) -> None:
    items = answer.feedback.contributions[::-1]
    axes.barh(
        [item.name.replace("_", " ") for item in items], [item.deviation for item in items], color=IDEAL, height=0.6
    )
    axes.set_xlabel("moves the hold by (K, standard deviation)")
    axes.tick_params(labelsize=8)
