"""Shape setting in an oven: temperatures over time, with what the technician does and when."""

from __future__ import annotations

import math

import numpy as np

from ...constants import ZERO_CELSIUS
from ...shaping.heating.oven import OvenPlan
from .heating import COLD, TUBE, WINDOW, WINDOW_ALPHA
from .style import FAINT, INK, Figure, headed, new_figure, picture


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
    below.text(0.0, 1.0, "\n".join(steps(plan)), fontsize=8, va="top", color=INK, linespacing=1.4)
    result = "held" if plan.feasible else "missed"
    name = title or plan.oven.name or "oven"
    headed(figure, f"{name}:  {low:g} to {high:g} °C for {plan.hold_time / 60:g} min: {result}")
    return figure


def steps(plan: OvenPlan) -> list[str]:
    """Steps for the technician, one sentence each."""
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
    return [f"{k}. {words}" for k, words in enumerate(sentences, 1)]
