"""Which effects explain how far a robot is from its model: held-out errors as effects are added."""

from __future__ import annotations

import numpy as np

from ...files.units import TO_MM
from ...validation import Comparison
from .stage import note
from .style import FAINT, INK, Axes, Figure, name_above, new_figure, picture

KEPT, REFUSED = "#0072B2", "#B8BEC6"


@picture
def plot_effects(comparison: Comparison) -> Figure:
    """Held-out errors of the robot as given and with every effect that pays, then the gain of those that do not; of
    places passed both ways, what of the error depends on the direction, before and after."""
    c = comparison
    both = c.fit is not None and c.fit.before.parity is not None
    figure = new_figure(9.6 if both else 7.2, max(3.0, 0.9 + 0.30 * (2 + len(c.steps) + len(c.refused))))
    if both:
        left, right = figure.subplots(1, 2, width_ratios=[2.6, 1])
        _draw_parity(right, c)
    else:
        left = figure.subplots()
    _draw_steps(left, c)
    return figure


def _draw_steps(axes: Axes, c: Comparison) -> None:
    rows = [("as given", c.start.rms), *((f"+ {s.effect.replace('_', ' ')}", s.held_out.rms) for s in c.steps)]
    values = np.array([value for _, value in rows]) * TO_MM
    axes.bar_label(axes.barh(range(len(rows)), values, height=0.62, color=KEPT), fmt="%.2f", padding=4, fontsize=8)
    last = values[-1]
    for k, step in enumerate(c.refused, start=len(rows)):
        value = step.held_out.rms * TO_MM
        axes.barh(k, value, height=0.62, color="none", edgecolor=REFUSED, lw=0.9)
        gain = f"{100 * step.gain + 0.0:+.1f} %".replace("-0.0", "±0.0").replace("+0.0", "±0.0").replace("-", "−")
        note(axes, gain, np.array([max(value, last), k]), np.array([4.0, 0.0]), size=7, colour=FAINT)
    names = [name for name, _ in rows] + [f"({s.effect.replace('_', ' ')})" for s in c.refused]
    axes.set_yticks(range(len(names)), names)
    for label in axes.get_yticklabels()[len(rows) :]:
        label.set_color(FAINT)
    if c.fit is not None:
        noise = c.fit.noise * np.sqrt(3) * TO_MM
        axes.axvline(noise, color=INK, lw=0.8, ls=(0, (4, 3)))
        name_above(axes, noise, f"what the fit leaves, {noise:.2f}")
    axes.invert_yaxis()
    axes.set_xlim(0, 1.14 * float(values.max()))
    axes.set_xlabel(f"RMS tip error held out (mm), {c.folds} blocks")
    axes.xaxis.grid()


def _draw_parity(axes: Axes, c: Comparison) -> None:
    assert c.fit is not None
    for k, v in enumerate((c.fit.before, c.fit.after)):
        if v.parity is None:
            continue
        for j, (value, colour) in enumerate(((v.parity.history, "#D55E00"), (v.parity.static, "#009E73"))):
            height = value * TO_MM
            label = ("depends on the direction", "does not")[j] if k == 0 else None
            bar = axes.bar(k + 0.36 * (j - 0.5), height, width=0.34, color=colour, label=label)
            axes.bar_label(bar, fmt="%.2f", padding=2, fontsize=7)
    axes.set_xticks([0, 1], ["as given", "calibrated"])
    axes.set_ylabel("RMS of points passed in both directions (mm)")
    axes.set_ylim(0, 1.32 * axes.get_ylim()[1])
    axes.legend(loc="upper right", fontsize=7)
    axes.yaxis.grid()
