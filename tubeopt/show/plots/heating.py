"""Heatings: a plan over time and along the tube, one that a sensor leads, and how a calibrated rig fits its log."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...constants import ZERO_CELSIUS
from ...files.units import TO_MM
from ...runs.heating_study import LedHeating
from ...shaping.heating.calibration import RigFit
from ...shaping.heating.plan import HeatingPlan
from ...shaping.heating.robust import Band
from .style import FAINT, INK, Axes, Figure, headed, new_figure, picture

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
    axes.step(plan.time, plan.duty, where="post", color=TUBE, lw=0.8, label="counts")
    axes.plot(plan.time + 0.5 * plan.spec.slot, plan.ideal_duty, color=IDEAL, lw=0.9, label="ideal")
    axes.set_ylabel("duty (of 255)")
    axes.set_ylim(0, None)
    _legend_above(axes, 2)


def _draw_battery(axes: Axes, plan: HeatingPlan) -> None:
    on = plan.duty > 0
    axes.plot(plan.time[on], plan.voltage[on], color=BATTERY, lw=1.1)
    axes.set(ylabel="battery,\nwhile on (V)", xlabel="time (s)")
    if on.any():
        pad = max(0.1, 0.3 * float(np.ptp(plan.voltage[on])))
        axes.set_ylim(plan.voltage[on].min() - pad, plan.voltage[on].max() + pad)


def _draw_along(axes: Axes, plan: HeatingPlan) -> None:
    x = plan.position * TO_MM
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
    running = np.where(history.place < len(feedback.law.planned), 1.0, np.nan)
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
