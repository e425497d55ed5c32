"""Sheets for the workshop: one page A4 of drawings, numbers and steps; places in mm from its lower left corner."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from ...files.units import TO_MM
from ...shaping.firmware.boards import root_mean_square
from ...shaping.heating.plan import HeatingPlan
from ...shaping.tube_fabrication import TubeFabrication
from ..page import WIDTH
from .heating import draw_duty, draw_temperature
from .style import Figure, new_figure, picture

INCH = 25.4
A4 = (297.0, 210.0)
EDGE = 12.0


@contextmanager
def a_page() -> Iterator[None]:
    """A sheet keeps its size, whatever the width of other pictures."""
    token = WIDTH.set(None)
    try:
        yield
    finally:
        WIDTH.reset(token)


def new_sheet(heading: str) -> Figure:
    """A page with a heading; its panels are put where they belong."""
    with a_page():
        figure = new_figure(A4[0] / INCH, A4[1] / INCH, layout=None)
    write(figure, EDGE, A4[1] - EDGE, heading, size=13, weight="bold")
    return figure


def write(figure: Figure, x: float, y: float, text: str, *, size: float = 7.5, weight: str = "normal") -> None:
    """Words, their upper left corner at x, y."""
    figure.text(x / A4[0], y / A4[1], text, fontsize=size, fontweight=weight, va="top", ha="left", linespacing=1.35)


def write_rows(
    figure: Figure, columns: Sequence[float], top: float, rows: Sequence[Sequence[str]], step: float
) -> None:
    """Rows of words, each of them at a column."""
    for k, row in enumerate(rows):
        for x, words in zip(columns, row, strict=True):
            write(figure, x, top - step * k, words)


def numbered(steps: Sequence[str], remarks: Sequence[str]) -> str:
    """Steps, and below them what to beware of."""
    marked = [*((f"{k}.", step) for k, step in enumerate(steps, start=1)), *(("!", remark) for remark in remarks)]
    return "\n".join(f"{mark}  {textwrap.fill(text, 78, subsequent_indent='      ')}" for mark, text in marked)


WRAPPED = 84
"""Letters per line of the steps."""

STEP = 4.6
"""Between two rows of numbers, mm."""

QUARTERS = (0.25, 0.5, 0.75)
"""Parts of the rise whose times are told, so that one sees early whether the tube follows."""


@picture
def plot_fabrication_sheet(made: TubeFabrication, *, title: str = "", success: str = "") -> Figure:
    """The sheet for the one who heats the tube: one page A4, whose first line says how likely it succeeds."""
    plan = made.heating
    figure = new_sheet(f"Heating sheet: {title or f'tube {made.groove.number}'}")
    left, wide, top = 0.09, 0.37, 0.47 * A4[1]
    over_time = figure.add_axes((left, 0.68, wide, 0.185))
    duty = figure.add_axes((left, 0.53, wide, 0.105), sharex=over_time)
    draw_temperature(over_time, plan)
    draw_duty(duty, plan)
    over_time.tick_params(labelbottom=False)
    duty.set_xlabel("time (s)")
    write(figure, EDGE, A4[1] - EDGE + 5, success or "success: not known", weight="bold")
    write(figure, EDGE, A4[1] - EDGE - 6, f"{plan.rig.name or 'rig'}, mold of {plan.rig.mold.material.name}")
    write_rows(figure, (EDGE, EDGE + 62.0), top, sheet_numbers(made), STEP)
    for head, lines, y in (
        ("Time line", time_line(plan), A4[1] - EDGE - 6),
        ("Before", before(made), A4[1] - EDGE - 50),
        ("Safety", safety(plan), A4[1] - EDGE - 104),
    ):
        write(figure, 152.0, y, head, weight="bold")
        wrapped = [textwrap.fill(line, WRAPPED, initial_indent="- ", subsequent_indent="  ") for line in lines]
        write(figure, 152.0, y - STEP, "\n".join(wrapped))
    return figure


def sheet_numbers(made: TubeFabrication) -> list[tuple[str, str]]:
    """What is set, measured and watched, with its value; mm, s, degC, V, A."""
    plan, groove, tube = made.heating, made.groove, made.groove.tube
    low, high = plan.spec.window_degC
    on = plan.duty > 0
    held = plan.duty[plan.in_hold][:-1]
    return [
        ("tube, outer / inner diameter (mm)", f"{tube.outer_diameter * TO_MM:.3f} / {tube.inner_diameter * TO_MM:.3f}"),
        ("cut to / between the clamps (mm)", f"{groove.stock_length * TO_MM:.1f} / {groove.free_length * TO_MM:.1f}"),
        ("window / limit (°C)", f"{low:g} to {high:g} / {plan.spec.limit:g}"),
        ("curved part in the hold (°C)", f"{plan.lowest:.1f} to {plan.highest:.1f}"),
        ("ramp / hold (s)", f"{plan.hold_start:g} / {plan.spec.hold_time:g}"),
        ("counts of 255, ramp at most / hold", f"{plan.duty.max()} / {held.max()} to {held.min()}"),
        ("slot (s) / pulses (Hz)", f"{plan.spec.slot:g} / {plan.rig.circuit.pwm_frequency:g}"),
        ("battery at rest / least under load (V)", f"{plan.rig.battery.voltage:.2f} / {plan.voltage[on].min():.2f}"),
        ("current while on / rms of 10 s (A)", f"{plan.peak_current:.0f} / {root_mean_square(plan):.1f}"),
        ("energy (kJ) / charge left (%)", f"{plan.energy / 1e3:.1f} / {100 * plan.charge[-1]:.0f}"),
        (
            "clamps / wall of the groove at most (°C)",
            f"{plan.clamp_temperature.max():.0f} / {plan.mold_temperature.max():.0f}",
        ),
        ("growth of the hot tube (mm)", f"{plan.growth * TO_MM:.2f}"),
        ("quench, out of the mold (s)", f"{plan.quench_time:.2f} in {plan.spec.quench}"),
    ]


def time_line(plan: HeatingPlan) -> list[str]:
    """What happens when, s from the switch; and how warm the middle of the curved part is then."""
    middle = plan.temperature[:, plan.temperature.shape[1] // 2]
    begins = int(np.flatnonzero(plan.in_hold)[0])
    rising = np.maximum.accumulate(middle[: begins + 1])
    goals = [middle[0] + share * (middle[begins] - middle[0]) for share in QUARTERS]
    off = plan.spec.slot * plan.table_length
    return [
        f"0 s: switched on, {middle[0]:.0f} °C",
        *(f"{np.interp(goal, rising, plan.time[: begins + 1]):.1f} s: {goal:.0f} °C" for goal in goals),
        f"{plan.hold_start:g} s: the hold begins, {middle[begins]:.0f} °C",
        f"{plan.hold_end:g} s: the hold ends; the last pulse is at {off:g} s",
        f"lid off and the tube into {plan.spec.quench} at once; it is below 100 °C {plan.quench_time:.2f} s later: "
        "in the mold it anneals on",
    ]


def before(made: TubeFabrication) -> list[str]:
    """What is set up, wired and measured before the switch."""
    plan, spec = made.heating, made.mold.spec
    battery, fixed = plan.rig.battery, "distal" if spec.clamps.sliding_end == "proximal" else "proximal"
    return [
        f"Tube in its groove, {plan.rig.clamps.grip * TO_MM:g} mm of it in each clamp; the {fixed} clamp is fixed, the "
        f"{spec.clamps.sliding_end} one slides outwards by {plan.growth * TO_MM:.2f} mm and more.",
        f"Battery rested and disconnected: {battery.voltage:.2f} V. With another voltage take its own schedule "
        "(`tubeopt heat plan rig.yaml --battery-V`), not this one.",
        f"Polarity: battery plus, fuse, {fixed} clamp; {spec.clamps.sliding_end} clamp, MOSFET (drain), its source to "
        "battery minus. A diode across the tube has its ring on the side of the fuse. The tube itself has no polarity.",
        "Power off: the resistance from each clamp to the plates must be high if the mold insulates. From clamp to "
        "clamp a multimeter measures mainly its own leads; check the current instead.",
        "First without power, then one pulse: the current while on must be that of the table.",
    ]


def safety(plan: HeatingPlan) -> list[str]:
    """What can hurt, with the plan's own numbers."""
    spare = 100 * (1 - plan.mean_current / plan.rig.circuit.current_limit)
    return [
        f"{plan.peak_current:.0f} A flow while on: no rings or watches, tools with insulated handles, a fuse at the "
        f"battery's plus, the stop button within reach. The mean current has {spare:.0f} % to spare.",
        f"The tube is at {plan.hottest:.0f} °C; clamps reach {plan.clamp_temperature.max():.0f} °C, the groove "
        f"{plan.mold_temperature.max():.0f} °C: wear gloves and goggles, and keep it away from anything that burns.",
        "Quench with the current off and the clamps open, tongs in hand; water spits.",
        "Above the limit, or where the tube does not follow the time line: stop.",
        *plan.problems,
    ]
