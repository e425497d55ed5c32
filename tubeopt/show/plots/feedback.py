"""A heating that a sensor leads: temperatures of uncertain rigs, and how the board is wired."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...shaping.firmware.parts import parts_list
from .heating import COLD, IDEAL, TUBE, WINDOW, WINDOW_ALPHA
from .style import FAINT, INK, headed, new_figure, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import FancyBboxPatch

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


BOXES = {
    "battery": (0.05, 0.62, 0.16, 0.2),
    "fuse": (0.27, 0.67, 0.1, 0.1),
    "current\nsensor": (0.43, 0.66, 0.12, 0.12),
    "tube\nin its mold": (0.63, 0.64, 0.16, 0.16),
    "MOSFET": (0.63, 0.3, 0.16, 0.12),
    "gate\ndriver": (0.43, 0.3, 0.12, 0.12),
    "thermometer": (0.83, 0.3, 0.14, 0.12),
    "board": (0.27, 0.04, 0.46, 0.14),
    "stop": (0.06, 0.3, 0.12, 0.12),
}
"""Where the parts stand: left, bottom, width, height."""


@picture
def plot_wiring(answer: LedHeating, *, title: str = "") -> Figure:
    """How the parts are wired, with the pins of the board and the ratings for the plan's currents."""
    figure = new_figure(9.4, 5.6)
    grid = figure.add_gridspec(1, 2, width_ratios=(1.7, 1.0))
    axes, text = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1])
    for part in (axes, text):
        part.set_axis_off()
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 0.95)
    pins, board = answer.wiring.known.pins, answer.wiring.known.title
    for name, (x, y, w, h) in BOXES.items():
        axes.add_patch(_box(x, y, w, h))
        axes.text(x + w / 2, y + h / 2, board if name == "board" else name, ha="center", va="center", fontsize=9)
    power: dict[str, Any] = {"color": TUBE, "lw": 2.4}
    signal: dict[str, Any] = {"color": IDEAL, "lw": 1.0}
    for path in (
        [(0.21, 0.72), (0.27, 0.72)], [(0.37, 0.72), (0.43, 0.72)], [(0.55, 0.72), (0.63, 0.72)],
        [(0.71, 0.64), (0.71, 0.42)], [(0.79, 0.36), (0.81, 0.36), (0.81, 0.88), (0.13, 0.88), (0.13, 0.82)],
    ):  # fmt: skip
        axes.plot(*zip(*path, strict=True), **power)
    wires = (
        ([(0.49, 0.18), (0.49, 0.3)], f"pin {pins['gate']}", (0.5, 0.22)),
        ([(0.55, 0.36), (0.63, 0.36)], "gate", (0.57, 0.375)),
        ([(0.46, 0.66), (0.46, 0.55), (0.38, 0.55), (0.38, 0.18)], f"pin {pins['current']}", (0.385, 0.22)),
        ([(0.13, 0.62), (0.13, 0.5), (0.31, 0.5), (0.31, 0.18)], f"pin {pins['voltage']}, divider", (0.14, 0.515)),
        ([(0.12, 0.3), (0.12, 0.11), (0.27, 0.11)], f"pin {pins['stop']}", (0.13, 0.125)),
        ([(0.18, 0.36), (0.43, 0.36)], "its supply", (0.185, 0.375)),
        ([(0.9, 0.42), (0.9, 0.7), (0.79, 0.7)], "on the tube", (0.91, 0.56)),
    )
    for path, label, at in wires:
        axes.plot(*zip(*path, strict=True), **signal)
        axes.text(*at, label, fontsize=7.5, color=INK)
    read = f"{pins['select']} and SPI" if answer.wiring.converter != "analog" else pins["temperature"]
    axes.plot([0.9, 0.9, 0.73], [0.3, 0.11, 0.11], **signal)
    axes.text(0.745, 0.125, f"pin {read}", fontsize=7.5, color=INK)
    lines = [f"{part.name}: {part.rating}" for part in parts_list(answer.plan, answer.wiring)]
    text.text(0, 0.95, "\n\n".join(_wrapped(line) for line in lines), fontsize=8, va="top", color=INK)
    axes.plot([], [], label="current of the tube", **power)
    axes.plot([], [], label="signals", **signal)
    axes.legend(loc="lower left", fontsize=7, bbox_to_anchor=(0.0, 0.0))
    return headed(figure, f"{title or answer.plan.rig.name or 'rig'}: wiring")


def _box(x: float, y: float, w: float, h: float) -> FancyBboxPatch:
    from matplotlib.patches import FancyBboxPatch

    return FancyBboxPatch((x, y), w, h, boxstyle="round,pad=0.005", facecolor="white", edgecolor=FAINT)


def _wrapped(line: str, width: int = 46) -> str:
    import textwrap

    return textwrap.fill(line, width)
