"""Heatings: a plan over time and along the tube, one that a sensor leads, and how a calibrated rig fits its log."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np

from ...constants import ZERO_CELSIUS
from ...files.units import TO_MM
from ...runs.heating_study import LedHeating
from ...shaping.firmware.boards import Wiring, parts_list
from ...shaping.heating.calibration import RigFit
from ...shaping.heating.plan import HeatingPlan
from ...shaping.heating.robust import Band
from .style import FAINT, INK, Axes, Figure, headed, narrow, new_figure, picture

TUBE, IDEAL, WINDOW, BATTERY, COLD = "#D55E00", "#0072B2", "#009E73", "#CC79A7", "#56B4E9"
WINDOW_ALPHA = 0.16


@picture
def plot_heating(plan: HeatingPlan, *, band: Band | None = None, title: str = "") -> Figure:
    """Picture of a plan: temperature and duty over time, battery voltage, temperature along the tube as the hold ends.

    Args:
        plan: what to draw. band: what it may do on uncertain rigs, drawn behind.
        title: heading; default the rig's name.
    """
    figure = new_figure(9.4, 6.4)
    grid = figure.add_gridspec(4, 2, width_ratios=(1.35, 1.0), height_ratios=(1.7, 1.7, 1.0, 0.55))
    over_time = figure.add_subplot(grid[0, 0])
    close, duty, battery = (figure.add_subplot(grid[k, 0], sharex=over_time) for k in (1, 2, 3))
    draw_temperature(over_time, plan, band)
    _draw_close(close, plan)
    draw_duty(duty, plan)
    _draw_battery(battery, plan)
    for axes in (over_time, close, duty):
        axes.tick_params(labelbottom=False)
    _draw_along(figure.add_subplot(grid[:, 1]), plan)
    headed(figure, _heading(plan, title, band))
    return figure


def _heading(plan: HeatingPlan, title: str, band: Band | None) -> str:
    low, high = plan.spec.window_degC
    wanted = f"{low:g} to {high:g} °C for {plan.spec.hold_time:g} s"
    kept = plan.verdict
    if band is not None:
        kept += f" by the rig of the file, and by {100 * band.probability:.0f} % of uncertain rigs"
    curved = f"curved part {plan.lowest:.1f} to {plan.highest:.1f} °C in the hold"
    return f"{title or plan.rig.name or 'rig'}:  {wanted}: {kept}\n{curved},  hottest point {plan.hottest:.1f} °C"


def _window(axes: Axes, plan: HeatingPlan, *, label: bool = True) -> None:
    low, high = plan.spec.window_degC
    axes.axhspan(low, high, color=WINDOW, alpha=WINDOW_ALPHA, lw=0, label="window" if label else None)
    axes.axhline(plan.spec.limit, color=INK, lw=0.8, ls=(0, (5, 3)), label="limit" if label else None)


def _legend_above(axes: Axes, columns: int) -> None:
    """Put the legend above the axes, where it hides no curve."""
    axes.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, fontsize=7, borderaxespad=0.1, columnspacing=1.2
    )


def draw_temperature(axes: Axes, plan: HeatingPlan, band: Band | None = None) -> None:
    """Curved part and clamps over time, with the window."""
    _window(axes, plan)
    if band is not None:
        lower, upper = band.quantiles()
        axes.fill_between(band.time, lower, upper, color=FAINT, alpha=0.3, lw=0, label="90 % of uncertain rigs")
    curved = plan.temperature[:, plan.curved]
    axes.fill_between(plan.time, curved.min(1), curved.max(1), color=TUBE, lw=1.2, label="curved part")
    axes.plot(plan.time, plan.clamp_temperature, color=COLD, lw=1.0, label="clamps")
    for at in (plan.hold_start, plan.hold_end):
        axes.axvline(at, color=FAINT, lw=0.6, ls=":")
    # What follows the hold is how the tube would cool in its mold; the table tells of the quench.
    axes.annotate(
        "not\nquenched", (1.0, 0.0), (-2, 10), "axes fraction", "offset points", fontsize=7, ha="right", color=INK
    )
    axes.set_ylabel("temperature (°C)")
    axes.set(ylim=(0, None), xlim=(0, plan.time[-1]))
    _legend_above(axes, 5)


def _draw_close(axes: Axes, plan: HeatingPlan) -> None:
    """The window from near: counts against ideal duty."""
    _window(axes, plan, label=False)
    curved, ideal = plan.temperature[:, plan.curved], plan.ideal_temperature[:, plan.curved]
    # With an edge, the band is seen where coldest and hottest place are equally warm; dashes leave it visible.
    axes.fill_between(plan.time, curved.min(1), curved.max(1), color=TUBE, alpha=0.6, lw=1.4, label="counts")
    axes.plot(plan.time, ideal.max(1), color=IDEAL, lw=0.8, ls=(0, (4, 2)), label="ideal duty, coldest and hottest")
    axes.plot(plan.time, ideal.min(1), color=IDEAL, lw=0.8, ls=(0, (4, 2)))
    for at in (plan.hold_start, plan.hold_end):
        axes.axvline(at, color=FAINT, lw=0.6, ls=":")
    low, high = min(plan.spec.window_degC[0], plan.lowest), max(plan.spec.limit, plan.hottest)
    axes.set_ylim(low - 0.25 * (high - low), high + 0.12 * (high - low))
    axes.set_ylabel("in the hold (°C)")
    _legend_above(axes, 2)


def draw_duty(axes: Axes, plan: HeatingPlan) -> None:
    """Counts over time, and the ideal ones."""
    # A count acts from its instant to the next: the value is after the step.
    axes.step(plan.time, plan.duty, where="post", color=TUBE, lw=0.8, label="counts")
    # The ideal duty is the mean of its slot, and belongs to the middle.
    axes.plot(plan.time + 0.5 * plan.spec.slot, plan.ideal_duty, color=IDEAL, lw=0.9, label="ideal")
    axes.set_ylabel("duty (of 255)")
    axes.set_ylim(0, None)
    _legend_above(axes, 2)


def _draw_battery(axes: Axes, plan: HeatingPlan) -> None:
    # Between pulses the battery recovers to its voltage at rest, which would hide the sag.
    on = plan.duty > 0
    axes.plot(plan.time[on], plan.voltage[on], color=BATTERY, lw=1.1)
    axes.set(ylabel="battery,\nwhile on (V)", xlabel="time (s)")
    if on.any():
        pad = max(0.1, 0.3 * float(np.ptp(plan.voltage[on])))
        axes.set_ylim(plan.voltage[on].min() - pad, plan.voltage[on].max() + pad)


def _draw_along(axes: Axes, plan: HeatingPlan) -> None:
    x = plan.position * TO_MM
    # First and last instant of the hold.
    start, end = (int(np.flatnonzero(plan.in_hold)[k]) for k in (0, -1))
    _window(axes, plan, label=False)
    axes.plot(x, plan.temperature[start], color=COLD, lw=1.1, label="hold begins")
    axes.plot(x, plan.temperature[end], color=TUBE, lw=1.4, label="hold ends")
    axes.plot(x, plan.ideal_temperature[end], color=IDEAL, lw=0.8, ls="--", label="ideal duty")
    _mark_zones(axes, plan)
    axes.set(xlim=(0, float(x[-1] + x[0])), ylim=(0, 1.18 * plan.spec.limit))
    axes.set(xlabel="along the tube, from the end of a clamp (mm)", ylabel="temperature (°C)")
    _legend_above(axes, 3)


def _mark_zones(axes: Axes, plan: HeatingPlan) -> None:
    """Names of clamp, clearance, lead and curved part, and the lines between them."""
    rig, tube = plan.rig, plan.tube
    lengths = [rig.clamps.grip, rig.clamps.clearance, rig.mold.lead, tube.curved_length]
    edges = np.cumsum(lengths) * TO_MM
    # Clamp, clearance and lead lie on both sides of the curved part.
    total = float(2 * sum(lengths[:3]) + lengths[3]) * TO_MM
    for at in (*edges[:3], *(total - edges[:3])):
        axes.axvline(at, color=FAINT, lw=0.5, ls=":")
    top = axes.get_xaxis_transform()
    names: list[tuple[str, float]] = [
        ("clamp", 0.5 * edges[0]),
        ("bare", 0.5 * (edges[0] + edges[1])),
        ("lead", 0.5 * (edges[1] + edges[2])),
        ("curved part", 0.5 * total),
    ]
    style: dict[str, Any] = {"transform": top, "fontsize": 6, "color": INK, "ha": "center", "va": "top"}
    for name, at in names:
        axes.text(float(at), 0.985, name, rotation=0 if name == "curved part" else 90, **style)


@picture
def plot_rig_fit(fit: RigFit) -> Figure:
    """Picture of a log and of what the rig predicts, before and after the calibration; a row for every channel."""
    names = {"voltage": "voltage (V)", "current": "current (A)"}
    channels = fit.log.channels
    figure = new_figure(7.0, 1.1 + 1.9 * len(channels))
    rows = figure.subplots(len(channels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (name, logged) in zip(rows, channels.items(), strict=True):
        zero = ZERO_CELSIUS if name.startswith("temperature") else 0.0
        axes.plot(fit.log.time, logged - zero, ".", ms=3, color=INK, label="logged")
        axes.plot(fit.log.time, fit.before[name] - zero, color=FAINT, lw=1.0, ls="--", label="rig file")
        axes.plot(fit.log.time, fit.after[name] - zero, color=TUBE, lw=1.2, label="calibrated")
        axes.set_ylabel(names.get(name, f"{name} (°C)".replace(" at ", "\nat ")))
    rows[0].legend(fontsize=7, ncols=3, loc="lower right")
    rows[-1].set_xlabel("time (s)")
    words = ",  ".join(f"{e.name.replace('_', ' ')} × {e.factor:.3f}" for e in fit.estimates if not e.held)
    headed(figure, f"{fit.rig.name or 'rig'}:  {words or 'nothing is determined'}")
    return figure


@picture
def plot_feedback(answer: LedHeating) -> Figure:
    """Picture of a led heating: curved parts of uncertain rigs over time, near the window, and what moves them."""
    feedback = answer.feedback
    figure = new_figure(9.4, 5.2)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.6, 1.0))
    whole = figure.add_subplot(grid[0, 0])
    close = figure.add_subplot(grid[1, 0])
    history = feedback.history
    inside = history.in_hold(feedback.law)
    for axes in (whole, close):
        _window(axes, answer.plan)
    # NaN breaks the line where the heating of a rig has ended. Rigs end at different times.
    running = np.where(history.place < len(feedback.law.planned), 1.0, np.nan)
    # Column 0 is the nominal rig, which is no sample.
    whole.plot(history.time, (history.hottest * running)[:, 1:], color=TUBE, lw=0.3, alpha=0.35)
    whole.plot([], [], color=TUBE, label=f"hottest of the curve, {feedback.samples} rigs")
    held = np.where(inside, 1.0, np.nan)
    close.plot(history.time, (history.hottest * held)[:, 1:], color=TUBE, lw=0.3, alpha=0.35)
    close.plot(history.time, (history.coldest * held)[:, 1:], color=COLD, lw=0.3, alpha=0.35)
    close.plot([], [], color=TUBE, label="hottest of the curve in the hold")
    close.plot([], [], color=COLD, label="coldest")
    low, high = answer.plan.spec.window_degC
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
    headed(figure, f"{answer.plan.rig.name or 'rig'}, led by a {feedback.sensor.name}:  {kept} {sure}")
    return figure


def _draw_contributions(axes: Axes, answer: LedHeating) -> None:
    items = answer.feedback.contributions[::-1]
    axes.barh(
        [item.name.replace("_", " ") for item in items], [item.deviation for item in items], color=IDEAL, height=0.6
    )
    axes.set_xlabel("moves the hold by (K, standard deviation)")
    axes.tick_params(labelsize=8)


Path = Sequence[tuple[float, float]]

BOXES = {
    "battery": (0.03, 0.44, 0.14, 0.35),
    "fuse": (0.22, 0.67, 0.08, 0.1),
    "current\nsensor": (0.37, 0.66, 0.12, 0.12),
    "tube\nin its mold": (0.59, 0.65, 0.17, 0.14),
    "stop": (0.29, 0.37, 0.1, 0.12),
    "gate\ndriver": (0.55, 0.37, 0.12, 0.12),
    "MOSFET": (0.76, 0.33, 0.16, 0.2),
    "board": (0.22, 0.03, 0.5, 0.13),
    "thermometer": (0.835, 0.03, 0.15, 0.13),
}
"""Where the parts stand: left, bottom, width, height."""

CURRENT: tuple[Path, ...] = (
    ((0.17, 0.72), (0.22, 0.72)),
    ((0.30, 0.72), (0.37, 0.72)),
    ((0.49, 0.72), (0.59, 0.72)),
    ((0.76, 0.72), (0.84, 0.72), (0.84, 0.53)),
    ((0.84, 0.33), (0.84, 0.28), (0.2, 0.28), (0.2, 0.51), (0.17, 0.51)),
    ((0.54, 0.72), (0.54, 0.87), (0.81, 0.87), (0.81, 0.72)),
)
"""Ways of the tube's current; the last but one is the ground, the last the way through the diode when it is off."""

GROUND: tuple[Path, ...] = (((0.64, 0.37), (0.64, 0.28)), ((0.68, 0.16), (0.68, 0.28)))
"""From the gate driver and the board to the ground."""

JOINTS = ((0.335, 0.72), (0.54, 0.72), (0.81, 0.72), (0.64, 0.28), (0.68, 0.28))
TERMINALS = {
    "+": (0.15, 0.72),
    "\N{MINUS SIGN}": (0.15, 0.51),
    "drain": (0.84, 0.505),
    "source": (0.84, 0.355),
    "GND": (0.68, 0.14),
}
DIODE, DIODE_SIZE = (0.675, 0.87), 0.022
"""Middle of its sign; its bar is towards the battery's plus."""


@picture
def plot_wiring(answer: LedHeating) -> Figure:
    """How the parts are wired, with poles, the pins of the board, and the ratings for the plan's currents."""
    figure = new_figure(9.8, 5.8)
    grid = figure.add_gridspec(1, 2, width_ratios=(1.9, 1.0))
    axes, text = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1])
    for part in (axes, text):
        part.set_axis_off()
    axes.set(xlim=(0, 1), ylim=(-0.09, 0.97))
    _draw_parts(axes, answer.wiring.known.title)
    _draw_wires(axes, answer.wiring)
    _draw_diode(axes)
    lines = [f"{part.name}: {part.rating}" for part in parts_list(answer.plan, answer.wiring)]
    text.text(0, 0.97, "\n\n".join(textwrap.fill(line, 46) for line in lines), fontsize=8, va="top", color=INK)
    return headed(figure, f"{answer.plan.rig.name or 'rig'}: wiring")


def _draw_parts(axes: Axes, board: str) -> None:
    from matplotlib.patches import FancyBboxPatch

    for name, (x, y, w, h) in BOXES.items():
        box = FancyBboxPatch((x, y), w, h, boxstyle="round,pad=0.005", facecolor="white", edgecolor=FAINT)
        axes.add_patch(box)
        axes.text(x + w / 2, y + h / 2, board if name == "board" else name, ha="center", va="center", fontsize=9)
    for name, at in TERMINALS.items():
        size = 13 if len(name) == 1 else 7
        axes.text(*at, name, ha="center", va="center", fontsize=size, color=INK)


def _thick() -> float:
    """Width of the wires of the tube's current, points: letters shrink on a narrow page, and would be covered."""
    return 1.0 if narrow() else 2.4


def _draw_wires(axes: Axes, wiring: Wiring) -> None:
    thick = _thick()
    power: dict[str, Any] = {"color": TUBE, "lw": thick, "zorder": 0.5}
    ground: dict[str, Any] = {"color": INK, "lw": 1.0, "zorder": 0.5}
    signal: dict[str, Any] = {"color": IDEAL, "lw": 1.0, "zorder": 0.5}
    for ways, look, label in ((CURRENT, power, "current of the tube"), (GROUND, ground, "ground")):
        for path in ways:
            axes.plot(*zip(*path, strict=True), **look)
        axes.plot([], [], label=label, **look)
    axes.plot(*zip(*JOINTS, strict=True), "o", color=INK, ms=1.7 * thick)
    pins = wiring.known.pins
    read = f"pin {pins['select']}, SPI" if wiring.converter != "analog" else f"pin {pins['temperature']}"
    wires: tuple[tuple[Path, str, tuple[float, float]], ...] = (
        (((0.6, 0.16), (0.6, 0.37)), f"pin {pins['gate']}", (0.607, 0.2)),
        (((0.67, 0.43), (0.76, 0.43)), "gate", (0.69, 0.44)),
        (((0.43, 0.66), (0.43, 0.56), (0.52, 0.56), (0.52, 0.16)), f"pin {pins['current']}", (0.525, 0.2)),
        (((0.335, 0.72), (0.335, 0.58), (0.26, 0.58), (0.26, 0.16)), f"pin {pins['voltage']},\ndivider", (0.265, 0.19)),
        (((0.36, 0.37), (0.36, 0.16)), f"pin {pins['stop']}\nto GND", (0.367, 0.19)),
        (((0.39, 0.43), (0.55, 0.43)), "supply", (0.405, 0.44)),
        (((0.96, 0.16), (0.96, 0.58), (0.675, 0.58), (0.675, 0.65)), "on the tube", (0.86, 0.59)),
        (((0.835, 0.095), (0.72, 0.095)), read, (0.732, 0.105)),
    )
    for path, label, at in wires:
        axes.plot(*zip(*path, strict=True), **signal)
        axes.text(*at, label, fontsize=7, color=INK)
    axes.plot([], [], label="signals", **signal)
    words = (
        "There is one ground: battery, driver and board are joined at the MOSFET's source. Current sensor, divider\n"
        "and thermometer take theirs from the board. Between pulses the tube is at the battery's plus: a bead that\n"
        "touches its metal would put that on the converter. A coat of ceramic cement or a foil of mica insulates it."
    )
    axes.text(0.03, 0.0, words, fontsize=7, color=INK, va="top")
    axes.legend(loc="upper left", fontsize=7, bbox_to_anchor=(0.0, 1.0))


def _draw_diode(axes: Axes) -> None:
    from matplotlib.patches import Polygon

    (x, y), half = DIODE, DIODE_SIZE
    axes.add_patch(Polygon([(x + half, y - half), (x + half, y + half), (x - half, y)], color=TUBE, zorder=2))
    axes.plot([x - half, x - half], [y - half, y + half], color=TUBE, lw=_thick(), zorder=2)
    axes.text(x, y + 1.8 * half, "diode, its bar towards plus", ha="center", fontsize=7, color=INK)
