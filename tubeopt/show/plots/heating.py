"""Pictures of heatings: a plan, a controlled heating, a calibration, the wiring, and an oven."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...constants import ZERO_CELSIUS
from ...files.units import TO_MM
from ...runs.heating_study import ClosedLoopHeating
from ...shaping.firmware.boards import TIMING_CAPACITOR, Wiring, timing_resistor
from ...shaping.heating.calibration import RigFit
from ...shaping.heating.oven import OvenPlan
from ...shaping.heating.plan import HeatingPlan
from ...shaping.heating.robust import Band
from ...typing import Array
from .labels import legend_above
from .panels import PanelScale, draw_band, draw_bars, draw_over, share_x
from .style import FAINT, INK, Axes, Figure, headed, narrow, new_figure, picture

TUBE, IDEAL, WINDOW, BATTERY, COLD = "#D55E00", "#0072B2", "#009E73", "#CC79A7", "#56B4E9"
WINDOW_ALPHA = 0.16

SMALL: dict[str, Any] = {"fontsize": 7, "columnspacing": 1.2}
"""Look of the legends."""


TEMPERATURE = PanelScale("temperature (°C)", low=0.0)


@picture
def plot_heating(plan: HeatingPlan, *, band: Band | None = None, title: str = "", stop: bool = False) -> Figure:
    """Picture of a plan: temperature, duty and battery voltage over time, and temperature along the tube.

    Args:
        plan: result of `plan_heating`.
        band: temperatures on uncertain rigs, drawn behind.
        title: heading; default the rig's name.
        stop: the heading says "do not run".
    """
    figure = new_figure(9.4, 6.4)
    grid = figure.add_gridspec(4, 2, width_ratios=(1.35, 1.0), height_ratios=(1.7, 1.7, 1.0, 0.55))
    over_time = figure.add_subplot(grid[0, 0])
    close, duty, battery = (figure.add_subplot(grid[k, 0], sharex=over_time) for k in (1, 2, 3))
    draw_temperature(over_time, plan, band)
    _draw_hold(close, plan)
    draw_duty(duty, plan)
    # Between pulses the battery recovers to its voltage at rest, which would hide the sag.
    on = plan.duty > 0
    draw_over(battery, plan.time[on], plan.voltage[on], VOLTAGE, color=BATTERY, lw=1.1)
    share_x((over_time, close, duty, battery), plan.time)
    _draw_along(figure.add_subplot(grid[:, 1]), plan)
    low, high = plan.spec.window_degC
    verdict = plan.verdict
    if band is not None:
        verdict += f" by the rig of the file, and by {100 * band.probability:.0f} % of uncertain rigs" + (
            " without a sensor" if plan.feedback else ""
        )
    window = f"{title or plan.rig.name or 'rig'}:  {low:g} to {high:g} °C for {plan.spec.hold_time:g} s: {verdict}"
    curved = f"curved part {plan.lowest:.1f} to {plan.highest:.1f} °C in the hold"
    window = f"DO NOT RUN THIS HEATING.  {window}" if stop else window
    headed(figure, f"{window}\n{curved},  hottest point {plan.hottest:.1f} °C")
    return figure


VOLTAGE = PanelScale("battery,\nwhile on (V)", min_span=0.2)
DUTY = PanelScale("duty (of 255)", low=0.0)


def _draw_window(axes: Axes, plan: HeatingPlan, *, name: bool = True) -> None:
    """Draw the temperature window and the limit."""
    low, high = plan.spec.window_degC
    axes.axhspan(low, high, color=WINDOW, alpha=WINDOW_ALPHA, lw=0, label="window" if name else None)
    axes.axhline(plan.spec.limit, color=INK, lw=0.8, ls=(0, (5, 3)), label="limit" if name else None)


def _draw_curved_part(axes: Axes, plan: HeatingPlan, **look: Any) -> None:
    """Draw the range of temperatures in the curved part, and lines where the hold starts and ends."""
    curved = plan.temperature[:, plan.curved]
    draw_band(axes, plan.time, curved.min(1), curved.max(1), TUBE, **look)
    for at in (plan.hold_start, plan.hold_end):
        axes.axvline(at, color=FAINT, lw=0.6, ls=":")


def draw_temperature(axes: Axes, plan: HeatingPlan, band: Band | None = None) -> None:
    """Draw curved part and clamps over time, with the window."""
    _draw_window(axes, plan)
    if band is not None:
        draw_band(axes, band.time, *band.quantiles(), FAINT, name="90 % of rigs, no sensor")
    _draw_curved_part(axes, plan, name="curved part", alpha=1.0, width=1.2)
    draw_over(axes, plan.time, plan.clamp_temperature, TEMPERATURE, name="clamps", color=COLD, lw=1.0)
    # After the hold the curves are those of a tube that cools in its mold; the table has the quench.
    corner: dict[str, Any] = {"xycoords": "axes fraction", "textcoords": "offset points", "ha": "right"}
    axes.annotate("not\nquenched", (1.0, 0.0), (-2, 10), fontsize=7, color=INK, **corner)
    axes.set_xlim(0, plan.time[-1])
    legend_above(axes, 5, **SMALL)


def _draw_hold(axes: Axes, plan: HeatingPlan) -> None:
    """Draw the window enlarged: temperatures by counts, and by the ideal duty."""
    _draw_window(axes, plan, name=False)
    # With an edge, the band is seen where coldest and hottest point are equally warm; dashes leave it visible.
    _draw_curved_part(axes, plan, name="counts", alpha=0.6, width=1.4)
    ideal = plan.ideal_temperature[:, plan.curved]
    for values, name in ((ideal.max(1), "ideal duty, coldest and hottest"), (ideal.min(1), "_")):
        axes.plot(plan.time, values, color=IDEAL, lw=0.8, ls=(0, (4, 2)), label=name)
    low, high = min(plan.spec.window_degC[0], plan.lowest), max(plan.spec.limit, plan.hottest)
    axes.set_ylim(low - 0.25 * (high - low), high + 0.12 * (high - low))
    axes.set_ylabel("in the hold (°C)")
    legend_above(axes, 2, **SMALL)


def draw_duty(axes: Axes, plan: HeatingPlan) -> None:
    """Draw counts over time, and the ideal duty."""
    # A count acts from its instant to the next: the value is after the step.
    draw_over(axes, plan.time, plan.duty, DUTY, name="counts", color=TUBE, lw=0.8, drawstyle="steps-post")
    # The ideal duty is the mean of its slot, and belongs to the middle.
    draw_over(axes, plan.time + 0.5 * plan.spec.slot, plan.ideal_duty, DUTY, name="ideal", color=IDEAL, lw=0.9)
    legend_above(axes, 2, **SMALL)


def _draw_along(axes: Axes, plan: HeatingPlan) -> None:
    """Draw temperature along the tube at both ends of the hold, with the names of the zones."""
    x = plan.position * TO_MM
    start, end = (int(np.flatnonzero(plan.in_hold)[k]) for k in (0, -1))
    _draw_window(axes, plan, name=False)
    curves: tuple[tuple[Array, str, dict[str, Any]], ...] = (
        (plan.temperature[start], "hold begins", {"color": COLD, "lw": 1.1}),
        (plan.temperature[end], "hold ends", {"color": TUBE}),
        (plan.ideal_temperature[end], "ideal duty", {"color": IDEAL, "lw": 0.8, "ls": "--"}),
    )
    for values, name, look in curves:
        draw_over(axes, x, values, TEMPERATURE, name=name, **look)
    rig = plan.rig
    lengths = [rig.clamps.grip, rig.clamps.clearance, rig.mold.lead, plan.tube.curved_length]
    edges = np.cumsum(lengths) * TO_MM
    # Clamp, clearance and lead lie on both sides of the curved part.
    total = float(2 * sum(lengths[:3]) + lengths[3]) * TO_MM
    for at in (*edges[:3], *(total - edges[:3])):
        axes.axvline(at, color=FAINT, lw=0.5, ls=":")
    middles = {"clamp": edges[0] / 2, "bare": edges[:2].mean(), "lead": edges[1:3].mean(), "curved part": total / 2}
    style: dict[str, Any] = {"transform": axes.get_xaxis_transform(), "fontsize": 6, "ha": "center", "va": "top"}
    for name, at in middles.items():
        axes.text(float(at), 0.985, name, rotation=0 if name == "curved part" else 90, color=INK, **style)
    axes.set(xlim=(0, float(x[-1] + x[0])), ylim=(0, 1.18 * plan.spec.limit))
    axes.set_xlabel("along the tube, from the end of a clamp (mm)")
    legend_above(axes, 3, **SMALL)


@picture
def plot_rig_fit(fit: RigFit) -> Figure:
    """Picture of a log and of the predictions before and after the calibration; a panel for every channel."""
    names = {"voltage": "voltage (V)", "current": "current (A)"}
    channels = fit.log.channels
    figure = new_figure(7.0, 1.1 + 1.9 * len(channels))
    panels = list(figure.subplots(len(channels), 1, sharex=True, squeeze=False)[:, 0])
    for axes, (name, logged) in zip(panels, channels.items(), strict=True):
        zero = ZERO_CELSIUS if name.startswith("temperature") else 0.0
        scale = PanelScale(names.get(name, f"{name} (°C)".replace(" at ", "\nat ")))
        curves: tuple[tuple[Array, str, dict[str, Any]], ...] = (
            (logged, "logged", {"ls": "", "marker": ".", "ms": 3}),
            (fit.before[name], "rig file", {"color": FAINT, "lw": 1.0, "ls": "--"}),
            (fit.after[name], "calibrated", {"color": TUBE, "lw": 1.2}),
        )
        for values, label, look in curves:
            draw_over(axes, fit.log.time, values - zero, scale, name=label, **look)
    panels[0].legend(fontsize=7, ncols=3, loc="lower right")
    share_x(panels, fit.log.time)
    text = ",  ".join(f"{e.name.replace('_', ' ')} × {e.factor:.3f}" for e in fit.estimates if not e.held)
    headed(figure, f"{fit.rig.name or 'rig'}:  {text or 'nothing is determined'}")
    return figure


@picture
def plot_feedback(answer: ClosedLoopHeating) -> Figure:
    """Picture of a controlled heating: curved parts of uncertain rigs over time, and the sources of their spread."""
    feedback = answer.feedback
    figure = new_figure(9.4, 5.2)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.6, 1.0))
    whole = figure.add_subplot(grid[0, 0])
    close = figure.add_subplot(grid[1, 0])
    history = feedback.history
    in_hold = history.in_hold(feedback.law)
    for axes in (whole, close):
        _draw_window(axes, answer.plan)
    # NaN breaks the line where the heating of a rig has ended. Rigs end at different times.
    running = np.where(history.index < len(feedback.law.planned), 1.0, np.nan)
    during_hold = np.where(in_hold, 1.0, np.nan)
    for axes, values, colour, name in (
        (whole, history.hottest * running, TUBE, f"hottest of the curve, {feedback.samples} rigs"),
        (close, history.hottest * during_hold, TUBE, "hottest of the curve in the hold"),
        (close, history.coldest * during_hold, COLD, "coldest"),
    ):
        # Column 0 is the nominal rig, which is no sample.
        axes.plot(history.time, values[:, 1:], color=colour, lw=0.3, alpha=0.35)
        axes.plot([], [], color=colour, label=name)
        axes.set_ylabel(TEMPERATURE.name)
    low, high = answer.plan.spec.window_degC
    close.set_ylim(low - 0.3 * (high - low), high + 0.3 * (high - low))
    times = history.time[in_hold.any(axis=1)]
    if len(times) > 1:
        close.set_xlim(times[0], times[-1])
    close.set_xlabel("time (s)")
    whole.legend(loc="lower right", fontsize=7, ncols=2)
    close.legend(loc="lower left", fontsize=7, ncols=2)
    items = feedback.contributions
    names = [item.name.replace("_", " ") for item in items]
    deviations = [item.deviation for item in items]
    quantity = "effect on the hold (K, standard deviation)"
    draw_bars(figure.add_subplot(grid[:, 1]), names, deviations, quantity, colours=IDEAL)
    low_p, high_p = feedback.interval
    success = f"{100 * feedback.probability:.1f} % of {feedback.samples} rigs keep the window"
    interval = f"({100 * low_p:.1f} to {100 * high_p:.1f} %),  {100 * feedback.open_loop:.0f} % without it"
    rig = answer.plan.rig.name or "rig"
    headed(figure, f"{rig}, controlled by a {feedback.sensor.name}:  {success} {interval}")
    return figure


Path = Sequence[tuple[float, float]]

Box = tuple[float, float, float, float]

BOXES: dict[str, Box] = {
    "battery": (0.02, 0.44, 0.1, 0.35),
    "fuse": (0.14, 0.67, 0.06, 0.1),
    "main\nswitch": (0.22, 0.67, 0.075, 0.1),
    "cut-out": (0.345, 0.66, 0.11, 0.12),
    "1 kohm": (0.365, 0.82, 0.07, 0.05),
    "current\nsensor": (0.5, 0.66, 0.09, 0.12),
    "tube\nin its mold": (0.645, 0.65, 0.13, 0.14),
    "control\nfuse, diode": (0.18, 0.52, 0.11, 0.09),
    "supply\n5 V, 12 V": (0.18, 0.36, 0.11, 0.1),
    "stop,\nthermal": (0.335, 0.52, 0.075, 0.09),
    "coil\nswitch": (0.428, 0.52, 0.065, 0.09),
    "gate,\nmonostable": (0.405, 0.35, 0.09, 0.1),
    "10 kohm": (0.765, 0.56, 0.075, 0.05),
    "1 uF": (0.68, 0.485, 0.055, 0.05),
    "gate\ndriver": (0.6, 0.35, 0.09, 0.1),
    "MOSFET,\nTVS diode": (0.79, 0.33, 0.16, 0.2),
    "thermometer": (0.83, 0.03, 0.16, 0.13),
}
"""Positions of the parts: left, bottom, width, height."""

BOARD: Box = (0.18, 0.03, 0.555, 0.13)
"""Position of the board."""

CURRENT: tuple[Path, ...] = (
    ((0.12, 0.72), (0.14, 0.72)),
    ((0.2, 0.72), (0.22, 0.72)),
    ((0.295, 0.72), (0.345, 0.72)),
    ((0.455, 0.72), (0.5, 0.72)),
    ((0.59, 0.72), (0.645, 0.72)),
    ((0.775, 0.72), (0.87, 0.72), (0.87, 0.53)),
    ((0.87, 0.33), (0.87, 0.28), (0.15, 0.28), (0.15, 0.51), (0.12, 0.51)),
    ((0.62, 0.72), (0.62, 0.87), (0.81, 0.87), (0.81, 0.72)),
)
"""Wires of the tube's current; the last but one is the ground.

The last is the path through the diode when the transistor is off.
"""

GROUND: tuple[Path, ...] = (
    ((0.21, 0.36), (0.21, 0.28)),
    ((0.485, 0.52), (0.505, 0.52), (0.505, 0.28)),
    ((0.475, 0.35), (0.475, 0.28)),
    ((0.66, 0.35), (0.66, 0.28)),
    ((0.71, 0.485), (0.71, 0.28)),
    ((0.71, 0.16), (0.71, 0.28)),
)
"""Wires from supply, coil switch, monostable, gate driver and its capacitor, and the board to the ground."""

JOINTS = (
    (0.32, 0.72), (0.475, 0.72), (0.62, 0.72), (0.81, 0.72), (0.87, 0.585), (0.37, 0.49), (0.64, 0.49), (0.21, 0.28),
    (0.25, 0.33), (0.475, 0.28), (0.505, 0.28), (0.66, 0.28), (0.71, 0.28),
)  # fmt: skip
TERMINALS = {
    "+": (0.105, 0.72),
    "\N{MINUS SIGN}": (0.105, 0.51),
    "drain": (0.87, 0.505),
    "source": (0.87, 0.355),
    "GND": (0.71, 0.14),
}
DIODE, DIODE_SIZE = (0.715, 0.87), 0.022
"""Centre and half width of the diode symbol; its bar is towards the battery's plus."""


WIRING_NOTES = (
    "The monostable closes the cut-out while ticks meet a high drain: a shorted switch or a dead board "
    "opens it. The main switch cuts all off. Stop, thermal switch and coil switch are in the coil's "
    "current. The 10 kohm sit at the drain's lug: no wire beyond them carries its peaks. 1 uF stands at "
    "the driver's pins. There is one ground: battery, driver and board are joined at the MOSFET's source. "
    "Current sensor, divider and thermometer take theirs from the board.",
    "Between pulses the tube is at the battery's plus: a junction or leg that touches its metal would put "
    "that on the converter. A strip of mica under the whole slot insulates junction and legs.",
    "Before the first tube, test a shorted switch: a lamp of 12 V in place of the tube, a wire from drain "
    'to source, main switch on. Pass: the lamp stays dark at a start, and the board reports "no voltage". '
    "The test of every day (--test-cutout) is another one: the tube in the clamps, no wire.",
)
"""Notes beside the drawing."""

LETTERS = 84
"""Letters of a line beside the drawing."""

LOGIC_WIRES: tuple[Path, ...] = (
    ((0.06, 0.27), (0.085, 0.27)), ((0.155, 0.27), (0.30, 0.27)), ((0.195, 0.27), (0.195, 0.31)),
    ((0.195, 0.36), (0.195, 0.39)), ((0.10, 0.22), (0.30, 0.22)), ((0.262, 0.22), (0.262, 0.14)),
    ((0.262, 0.09), (0.262, 0.03)), ((0.40, 0.245), (0.50, 0.245)), ((0.35, 0.30), (0.35, 0.39)),
    ((0.35, 0.19), (0.35, 0.03)), ((0.50, 0.30), (0.465, 0.30), (0.465, 0.39)), ((0.53, 0.33), (0.53, 0.39)),
    ((0.53, 0.13), (0.53, 0.03)), ((0.66, 0.29), (0.72, 0.29)), ((0.72, 0.39), (0.72, 0.37)),
    ((0.72, 0.325), (0.72, 0.28)), ((0.72, 0.235), (0.72, 0.21), (0.66, 0.21)), ((0.66, 0.16), (0.81, 0.16)),
    ((0.762, 0.16), (0.762, 0.12)), ((0.762, 0.075), (0.762, 0.03)), ((0.85, 0.12), (0.85, 0.03)),
    ((0.85, 0.20), (0.85, 0.24)), ((0.85, 0.29), (0.85, 0.33)), ((0.85, 0.385), (0.85, 0.41)),
    ((0.85, 0.22), (0.95, 0.22), (0.95, 0.235)), ((0.95, 0.295), (0.95, 0.31), (0.85, 0.31)),
    ((0.15, 0.03), (0.90, 0.03)), ((0.195, 0.39), (0.74, 0.39)),
)  # fmt: skip
"""Wires of the monostable; the last two are ground and supply."""

LOGIC_JOINTS = (
    (0.195, 0.27), (0.262, 0.22), (0.72, 0.29), (0.762, 0.16), (0.85, 0.22), (0.85, 0.31), (0.35, 0.39), (0.465, 0.39),
    (0.53, 0.39), (0.72, 0.39), (0.262, 0.03), (0.35, 0.03), (0.53, 0.03), (0.762, 0.03), (0.85, 0.03),
)  # fmt: skip


def _draw_logic(axes: Axes, answer: ClosedLoopHeating) -> None:
    """Monostable with its gate, supply, values and pins, and the coil that it holds."""
    wiring = answer.wiring
    supply = f"{wiring.known.reference:g} V"
    resistor = f"{timing_resistor(wiring, answer.frequency) / 1e3:g} kohm"
    axes.set_axis_off()
    axes.set(xlim=(0, 1), ylim=(0.0, 0.46))
    boxes: dict[str, Box] = {
        "10 kohm#drain": (0.085, 0.25, 0.07, 0.04),
        "BAT54,\nbar up": (0.16, 0.31, 0.07, 0.05),
        "10 kohm#tick": (0.235, 0.09, 0.058, 0.05),
        "74HC132": (0.30, 0.19, 0.10, 0.11),
        "74HC123": (0.50, 0.13, 0.16, 0.20),
        resistor: (0.685, 0.325, 0.07, 0.045),
        f"{1e9 * TIMING_CAPACITOR:g} nF": (0.69, 0.235, 0.06, 0.045),
        "10 kohm#gate": (0.73, 0.075, 0.064, 0.045),
        "coil\nswitch": (0.81, 0.12, 0.08, 0.08),
        "coil": (0.82, 0.24, 0.06, 0.05),
        "stop,\nthermal": (0.81, 0.33, 0.08, 0.055),
        "Zener,\ndiode": (0.915, 0.235, 0.07, 0.06),
    }
    for path in LOGIC_WIRES:
        axes.plot(*zip(*path, strict=True), color=INK if path in LOGIC_WIRES[-2:] else IDEAL, lw=1.0, zorder=0.5)
    axes.plot(*zip(*LOGIC_JOINTS, strict=True), "o", color=INK, ms=3.0)
    _draw_boxes(axes, boxes, 7.0)
    pin: dict[str, Any] = {"fontsize": 6.0, "color": INK, "va": "center"}
    for x, y, text, side in (
        (0.304, 0.27, "1", "left"), (0.304, 0.22, "2", "left"), (0.396, 0.26, "3", "right"),
        (0.355, 0.29, "14", "left"), (0.355, 0.20, "7", "left"), (0.504, 0.245, "1 A", "left"),
        (0.504, 0.30, "2 B, 3 RD", "left"), (0.535, 0.32, "16", "left"), (0.535, 0.14, "8", "left"),
        (0.656, 0.29, "15 RC", "right"), (0.656, 0.21, "14 C", "right"), (0.656, 0.16, "13 Q", "right"),
    ):  # fmt: skip
        axes.text(x, y, text, ha=side, **pin)
    for x, y, text, side in (
        (0.055, 0.27, "drain", "right"), (0.095, 0.22, f"{wiring.known.pin('tick')}, tick", "right"),
        (0.185, 0.39, supply, "right"), (0.85, 0.425, "12 V", "center"), (0.14, 0.03, "ground", "right"),
        (0.36, 0.085, "100 nF from 14 to 7;\n4, 5, 9, 10, 12,\n13 to ground", "left"),
        (0.54, 0.075, "100 nF from 16 to 8;\n9, 10, 11 to ground;\n1N4148 from 15 to 16", "left"),
    ):  # fmt: skip
        axes.text(x, y, text, ha=side, fontsize=7, color=INK, va="center")
    axes.text(0.0, 0.445, "monostable, in detail (numbers: pins of its chips)", fontsize=8, color=INK, va="center")


@picture
def plot_wiring(answer: ClosedLoopHeating) -> Figure:
    """Picture of the wiring: parts, poles, pins of the board, and ratings for the plan's currents."""
    from matplotlib.patches import Polygon

    figure = new_figure(12.0, 9.2)
    columns = (1.6,) if narrow() else (1.6, 1.0)
    grid = figure.add_gridspec(2, len(columns), width_ratios=columns, height_ratios=(1.0, 0.46))
    axes = figure.add_subplot(grid[0, 0])
    axes.set_axis_off()
    axes.set(xlim=(0, 1), ylim=(0.0, 0.97))
    _draw_parts(axes, BOXES | {answer.wiring.known.title: BOARD})
    _draw_logic(figure.add_subplot(grid[1, 0]), answer)
    _draw_wires(axes, answer.wiring)
    (x, y), half = DIODE, DIODE_SIZE
    axes.add_patch(Polygon([(x + half, y - half), (x + half, y + half), (x - half, y)], color=TUBE, zorder=2))
    axes.plot([x - half, x - half], [y - half, y + half], color=TUBE, lw=_thick(), zorder=2)
    axes.text(x, y + 1.8 * half, "diode, its bar towards plus", ha="center", fontsize=7, color=INK)
    if not narrow():  # a narrow page has no space for the parts list, which the sheet has too
        text = figure.add_subplot(grid[:, 1])
        text.set_axis_off()
        lines = [f"{part.name}: {part.rating}" for part in answer.parts]
        rows = [textwrap.fill(line, LETTERS, subsequent_indent="    ") for line in lines]
        notes = [textwrap.fill(note, LETTERS) for note in WIRING_NOTES]
        text.text(0, 1.0, "\n".join(rows), fontsize=6.6, va="top", color=INK, linespacing=1.35)
        text.text(0, 0.0, "\n".join(notes), fontsize=6.6, va="bottom", color=INK, linespacing=1.35)
    outer, inner = (size * TO_MM for size in (answer.plan.tube.outer_diameter, answer.plan.tube.inner_diameter))
    others = ", ratings for all tubes of the robot, fuse of this one" if len(answer.shared) > 1 else ""
    return headed(figure, f"{answer.plan.rig.name or 'rig'}: wiring for a tube of {outer:g} / {inner:g} mm{others}")


def _draw_boxes(axes: Axes, boxes: Mapping[str, Box], size: float = 8.0) -> None:
    from matplotlib.patches import FancyBboxPatch

    for name, (x, y, w, h) in boxes.items():
        box = FancyBboxPatch((x, y), w, h, boxstyle="round,pad=0.003", facecolor="white", edgecolor=FAINT)
        axes.add_patch(box)
        axes.text(x + w / 2, y + h / 2, name.split("#")[0], ha="center", va="center", fontsize=size)


def _draw_parts(axes: Axes, boxes: Mapping[str, Box]) -> None:
    _draw_boxes(axes, boxes)
    for name, at in TERMINALS.items():
        size = 13 if len(name) == 1 else 7
        axes.text(*at, name, ha="center", va="center", fontsize=size, color=INK)


def _thick() -> float:
    """Width of the wires of the tube's current, points: thin where letters are small, which they would cover."""
    return 1.0 if narrow() else 2.4


def _draw_wires(axes: Axes, wiring: Wiring) -> None:
    thick = _thick()
    power: dict[str, Any] = {"color": TUBE, "lw": thick, "zorder": 0.5}
    ground: dict[str, Any] = {"color": INK, "lw": 1.0, "zorder": 0.5}
    signal: dict[str, Any] = {"color": IDEAL, "lw": 1.0, "zorder": 0.5}
    for wires, look, label in ((CURRENT, power, "current of the tube"), (GROUND, ground, "ground")):
        for path in wires:
            axes.plot(*zip(*path, strict=True), **look)
        axes.plot([], [], label=label, **look)
    axes.plot(*zip(*JOINTS, strict=True), "o", color=INK, ms=1.7 * thick)
    pin = wiring.known.pin
    spi = f"CS {pin('select')}\nCLK {pin('clock')}\nDO {pin('data')}"
    read = spi if wiring.converter != "analog" else pin("temperature")
    signals: tuple[tuple[Path, str, tuple[float, float]], ...] = (
        (((0.63, 0.16), (0.63, 0.35)), pin("gate"), (0.635, 0.2)),
        (((0.69, 0.4), (0.79, 0.4)), "10 ohm", (0.722, 0.41)),
        (((0.575, 0.66), (0.575, 0.16)), pin("current"), (0.58, 0.2)),
        (((0.475, 0.72), (0.475, 0.64), (0.52, 0.64), (0.52, 0.16)), f"{pin('voltage')},\ndivider", (0.524, 0.19)),
        (((0.345, 0.52), (0.345, 0.16)), f"{pin('stop')}\nto GND", (0.35, 0.19)),
        (((0.32, 0.72), (0.32, 0.845), (0.365, 0.845)), "", (0.0, 0.0)),
        (((0.435, 0.845), (0.475, 0.845), (0.475, 0.72)), "", (0.0, 0.0)),
        (((0.32, 0.72), (0.32, 0.565), (0.29, 0.565)), "", (0.0, 0.0)),
        (((0.235, 0.52), (0.235, 0.46)), "", (0.0, 0.0)),
        (((0.25, 0.36), (0.25, 0.16)), "5 V", (0.255, 0.2)),
        (((0.27, 0.46), (0.27, 0.49), (0.64, 0.49), (0.64, 0.45)), "12 V", (0.3, 0.465)),
        (((0.64, 0.49), (0.64, 0.51), (0.68, 0.51)), "", (0.0, 0.0)),
        (((0.37, 0.49), (0.37, 0.52)), "", (0.0, 0.0)),
        (((0.37, 0.61), (0.37, 0.66)), "coil", (0.385, 0.625)),
        (((0.435, 0.66), (0.435, 0.61)), "", (0.0, 0.0)),
        (((0.45, 0.45), (0.45, 0.52)), "", (0.0, 0.0)),
        (((0.43, 0.35), (0.43, 0.16)), f"{pin('tick')},\ntick", (0.435, 0.19)),
        (((0.46, 0.35), (0.46, 0.31), (0.4, 0.31), (0.4, 0.16)), f"{wiring.known.reference:g} V", (0.361, 0.3)),
        (((0.87, 0.585), (0.84, 0.585)), "", (0.0, 0.0)),
        (((0.765, 0.585), (0.545, 0.585), (0.545, 0.4), (0.49, 0.4)), "drain high", (0.6, 0.592)),
        (((0.97, 0.16), (0.97, 0.69), (0.79, 0.69), (0.775, 0.69)), "on the tube", (0.885, 0.7)),
        (((0.83, 0.095), (0.735, 0.095)), read, (0.739, 0.105)),
        (((0.25, 0.33), (0.56, 0.33), (0.56, 0.66)), "5 V", (0.532, 0.335)),
    )
    for path, label, at in signals:
        axes.plot(*zip(*path, strict=True), **signal)
        axes.text(*at, label, fontsize=7, color=INK)
    axes.plot([], [], label="signals", **signal)
    axes.legend(loc="upper left", fontsize=7, bbox_to_anchor=(0.0, 1.0))


@picture
def plot_oven(plan: OvenPlan, *, title: str = "") -> Figure:
    """Curved part and mold over time with the window, and the steps for the technician.

    Args:
        plan: plan of the oven. title: heading; default the oven's name.
    """
    figure = new_figure(7.2, 5.2)
    axes, below = figure.subplots(2, 1, height_ratios=(3.2, 1.0))
    course, minutes = plan.course, plan.course.time / 60
    low, high = plan.window
    setting = plan.oven.set_temperature - ZERO_CELSIUS
    axes.axhspan(low, high, color=WINDOW, alpha=WINDOW_ALPHA, lw=0, label="window")
    axes.axhline(setting, color=INK, lw=0.8, ls=(0, (5, 3)), label="setting")
    axes.plot(minutes, course.surface, color=COLD, lw=1.0, label="faces of the mold")
    # With an edge the band is seen where coldest and hottest point are equally warm.
    axes.fill_between(minutes, course.coldest, course.hottest, color=TUBE, lw=1.2, label="curved part")
    if math.isfinite(plan.soak_time):
        for at in (plan.warm_time, plan.soak_time):
            axes.axvline(at / 60, color=FAINT, lw=0.6, ls=":")
    axes.set(xlabel="time (min)", ylabel="temperature (°C)", xlim=(0, minutes[-1]))
    axes.set_ylim(0, 1.08 * max(high, setting, float(np.max(course.hottest))))
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, fontsize=7, borderaxespad=0.1, columnspacing=1.2)
    below.axis("off")
    below.text(0.0, 1.0, "\n".join(oven_steps(plan)), fontsize=8, va="top", color=INK, linespacing=1.4)
    result = "held" if plan.feasible else "missed"
    name = title or plan.oven.name or "oven"
    headed(figure, f"{name}:  {low:g} to {high:g} °C for {plan.hold_time / 60:g} min: {result}")
    return figure


def oven_steps(plan: OvenPlan) -> list[str]:
    """Steps for the technician, as sentences."""
    oven = plan.oven
    setting = oven.set_temperature - ZERO_CELSIUS
    device = oven.method.replace("_", " ")
    if not plan.feasible:
        return ["Do not use this plan:", *plan.problems]
    quench = {
        "water": "take the tube out of the mold and quench it in water",
        "water_in_mold": "put the closed mold into water",
        "air": "let the closed mold cool in a draught of air",
    }[oven.quench]
    drawn = 1e3 / plan.tube.curvature if plan.tube.curvature else math.inf
    # Spring-back is known from trials only; the radius here is that of the hot tube's set shape when cold.
    mill = [f"Mill the groove to {1e3 * plan.groove_radius:.2f} mm for {drawn:g} mm, less spring-back."]
    sentences = [
        *(mill if math.isfinite(drawn) else []),
        f"Set the {device} to {setting:g} °C, and wait until it is there.",
        f"Put the cold mold with the tube in{', on the floor' if oven.on_floor else ''}.",
        f"Take it out after {math.ceil(plan.soak_time / 60)} min.",
        f"Within {oven.transfer_time:g} s, {quench}.",
    ]
    return [f"{k}. {sentence}" for k, sentence in enumerate(sentences, 1)]
