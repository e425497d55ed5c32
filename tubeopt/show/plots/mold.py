"""Sheets of parts to make, and pictures of molds with their tubes."""

from __future__ import annotations

import itertools
import math
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from ...constants import ZERO_CELSIUS
from ...files.units import TO_MILLI, TO_MM
from ...robots.tubes import Tube
from ...shaping.firmware.boards import root_mean_square
from ...shaping.heating.plan import HeatingPlan
from ...shaping.mold.files import draw_plate
from ...shaping.mold.gcode import clear_room
from ...shaping.mold.groove import Arc
from ...shaping.mold.mandrel import Cylinder, Mandrel, rotation_table
from ...shaping.mold.mold import Groove, Mold, clamp_corners
from ...shaping.mold.ranking import MOST_LEAK, MaterialRating
from ...shaping.mold.springback import Calibration
from ...shaping.tube_fabrication import TubeFabrication
from ...typing import Array
from ..page import WIDTH, tube_colour
from .heating import draw_duty, draw_temperature
from .style import FAINT, INK, Axes, Figure, disk, entitle, headed, new_figure, picture

if TYPE_CHECKING:
    from matplotlib.patches import Rectangle

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
    # np.interp needs increasing abscissae, and integer duties let the temperature ripple.
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


PLATE, SLOT, VENT, CLAMP = "#F1EEE6", "#C9D6E3", "#FFFFFF", "#B9BDC2"
SCALES = (1.0, 1.5, 2.0, 2.5, 4.0, 5.0, 10.0)
"""Reductions of the drawing on the set-up sheet."""


@picture
def plot_mold(mold: Mold, *, title: str = "") -> Figure:
    """The base plate from above, with grooves, bolts, dowels and clamps, and where the vents of the lid lie."""
    low, high = _extent(mold)
    wide, tall = high - low
    figure = new_figure(7.5, max(2.6, 7.5 * tall / wide + 0.9))
    axes = figure.add_subplot()
    draw_mold(axes, mold)
    axes.set(xlabel="x (mm)", ylabel="y (mm)")
    radii = ",  ".join(f"tube {groove.number}: {_least(groove.held, '.2f', ' mm')}" for groove in mold.grooves)
    entitle(axes, f"{_named(mold, title)}\nradius of the groove  {radii}")
    return figure


def draw_mold(axes: Axes, mold: Mold) -> None:
    """Draw the base plate and the clamps into `axes`, in mm to the same scale both ways."""
    from matplotlib.patches import Rectangle

    drawing = draw_plate(mold, "base")
    plate = Rectangle((0, 0), *drawing.size, fc=PLATE, ec=INK, lw=0.9, zorder=0)
    axes.add_patch(plate)
    for groove in mold.grooves:
        _draw_groove(axes, groove, mold, plate)
    for hole in mold.holes:
        face = "white" if hole.purpose == "bolt" else FAINT
        centre = np.multiply(hole.centre, TO_MM)
        disk(axes, centre, hole.diameter / 2 * TO_MM, fc=face, ec=INK, lw=0.6, zorder=3)
    low, high = _extent(mold)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")


def _draw_groove(axes: Axes, groove: Groove, mold: Mold, plate: Rectangle) -> None:
    from matplotlib.patches import Polygon

    curve = groove.centreline
    left, right = (_line(curve.offset(side * groove.width / 2).pieces) for side in (1, -1))
    outline = np.vstack([left, right[::-1]])
    slot = Polygon(outline, fc=SLOT, ec=INK, lw=0.4, zorder=1)
    axes.add_patch(slot)
    slot.set_clip_path(plate)
    middle = _line(curve.pieces)
    colour = tube_colour(groove.number - 1)
    axes.plot(*middle.T, color=colour, lw=0.8, ls=(0, (8, 2, 1.5, 2)), zorder=2)
    for vent in groove.vents:
        centre = np.multiply(vent.centre, TO_MM)
        disk(axes, centre, vent.diameter / 2 * TO_MM, fc=VENT, ec=colour, lw=0.5, zorder=3)
    for clamp in groove.clamps:
        along, corners = np.asarray(clamp.direction), clamp_corners(clamp, mold.spec.clamps) * TO_MM
        far = corners[1:3].mean(axis=0)
        axes.add_patch(Polygon(corners, fc=CLAMP, ec=INK, lw=0.6))
        mouth = curve.lead_in.start if clamp.end == "proximal" else curve.lead_out.end
        axes.plot(*np.array([np.asarray(mouth) * TO_MM, far]).T, color=colour, lw=1.2, zorder=3)
        if clamp.slides:
            start, end = (far + way * along for way in (1.5, 6.5))
            axes.annotate(
                "", (end[0], end[1]), (start[0], start[1]), arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 0.8}
            )
        # Beyond the clamp, where no neighbour's lies over it.
        x, y = far + (9.5 if clamp.slides else 3.0) * along
        axes.text(x, y, str(groove.number), color=colour, ha="center", va="center", fontsize=7, fontweight="bold")


def _line(pieces: Sequence[Arc]) -> Array:
    """(N, 2) points in mm, fine on arcs."""
    # Half a turn in 199 chords stays within R (pi/199)^2 / 8, which is 3e-5 R, of the arc.
    counts = [200 if piece.curvature else 2 for piece in pieces]
    points = [piece.point(np.linspace(0, piece.length, count)) for piece, count in zip(pieces, counts, strict=True)]
    return np.asarray(np.vstack(points) * TO_MM)


def _extent(mold: Mold) -> tuple[Array, ...]:
    """Least and greatest coordinates (mm) of plate and clamps, with some room."""
    reach = mold.spec.clamps.grip + mold.spec.clamps.width / 2
    clamps = [clamp for groove in mold.grooves for clamp in groove.clamps]
    tips = [np.asarray(clamp.face) + reach * np.asarray(clamp.direction) for clamp in clamps]
    points = np.array([(0.0, 0.0), mold.size, *tips]) * TO_MM
    return points.min(axis=0) - 4, points.max(axis=0) + 4


def _named(mold: Mold, title: str) -> str:
    return f"{title}: m{_heading(mold)[1:]}" if title else _heading(mold)


def _heading(mold: Mold) -> str:
    plate = mold.spec.plate
    return (
        f"Mold of {mold.spec.material.name.replace('_', ' ')}, {mold.size[0] * TO_MM:g} × {mold.size[1] * TO_MM:g} mm, "
        f"base {plate.thickness * TO_MM:g} mm, lid {plate.lid_thickness * TO_MM:g} mm"
    )


@picture
def plot_setup_sheet(mold: Mold, *, title: str = "") -> Figure:
    """The set-up sheet for the workshop: one page A4, the drawing to scale, a column of numbers per tube, the steps."""
    figure = new_sheet(f"Set-up sheet{': ' + title if title else ''}")
    low, high = _extent(mold)
    room = np.array([A4[0] - 2 * EDGE, 0.47 * A4[1] - EDGE])
    # A round reduction, so that lengths can be measured on the sheet.
    fitting = [scale for scale in SCALES if (high - low <= room * scale).all()]
    scale = fitting[0] if fitting else SCALES[-1]
    wide, tall = (high - low) / scale
    top = A4[1] - EDGE - 9 - tall
    axes = figure.add_axes((EDGE / A4[0], top / A4[1], wide / A4[0], tall / A4[1]))
    draw_mold(axes, mold)
    axes.set_axis_off()
    key = "White: bolts; dark: dowels; ringed: vents of the lid; grey: clamps, with an arrow where one slides."
    where = f"drawn 1:{scale:g}. Zero: lower left corner, upper face of the base."
    write(figure, EDGE, A4[1] - EDGE - 6, f"{_heading(mold)}, {where}")
    write(figure, EDGE, EDGE + 3, key)
    _numbers(figure, mold, top - 4)
    _steps(figure, mold, top - 4)
    return figure


def _rows(groove: Groove, mold: Mold) -> list[tuple[str, str]]:
    """What the workshop needs to know of one groove; mm and deg."""
    tube, back = groove.tube, mold.spec.springback
    lost = 1 - abs(tube.curvature / groove.curvature) if groove.curvature else 0.0
    ends, travel = groove.before_bend + groove.bend_length, max(clamp.travel for clamp in groove.clamps)
    # Without the slack, a depth of whole steps would take one pass more by round-off.
    passes = math.ceil(groove.depth / mold.spec.milling.step_down - 1e-9)
    return [
        ("tube, outer / inner diameter", f"{tube.outer_diameter * TO_MM:.3f} / {tube.inner_diameter * TO_MM:.3f}"),
        ("wanted radius", _least(tube, ".2f")),
        ("mold radius", _least(groove.held, ".3f")),
        ("spring-back of the curvature", f"{100 * (1 - back.obtained(1.0) if back.slope == 0 else lost):.2f} %"),
        ("bend, length / angle", f"{groove.bend_length * TO_MM:.2f} / {math.degrees(groove.bend_angle):.2f}°"),
        ("groove, width / depth", f"{groove.width * TO_MM:.3f} / {groove.depth * TO_MM:.3f}"),
        ("end mill / passes", f"{groove.mill.diameter * TO_MM:g} / {passes} × {len(groove.cutter_offsets)}"),
        ("strain when pressed in", f"{groove.strain * 100:.2f} %"),
        ("cut the tube to", f"{groove.stock_length * TO_MM:.1f}"),
        ("mark: bend begins at / ends at", f"{groove.before_bend * TO_MM:.1f} / {ends * TO_MM:.1f}"),
        ("plate to clamp, proximal / distal", f"{groove.gaps[0] * TO_MM:.1f} / {groove.gaps[1] * TO_MM:.1f}"),
        ("cold end from the clamp", f"{groove.cold.length * TO_MM:.1f}"),
        ("growth / travel of the sliding clamp", f"{groove.growth * TO_MM:.2f} / {travel * TO_MM:.1f}"),
        ("trim, proximal / distal", f"{groove.trim[0] * TO_MM:.1f} / {groove.trim[1] * TO_MM:.1f}"),
    ]


def _least(tube: Tube, digits: str, unit: str = "") -> str:
    """The radius of a tube, mm, or the least of many."""
    if tube.curvature == 0:
        return "straight"
    return f"{'≥ ' if tube.general else ''}{TO_MM / abs(tube.curvature):{digits}}{unit}"


def _numbers(figure: Figure, mold: Mold, top: float) -> None:
    step, shown = 4.5, mold.grooves[:3]
    columns = [EDGE, *(EDGE + 52.0 + 30.0 * k for k in range(len(shown)))]
    for x, words in zip(columns, ("mm, tubes cold", *(f"tube {groove.number}" for groove in shown)), strict=True):
        write(figure, x, top, words, weight="bold")
    tables = [_rows(groove, mold) for groove in shown]
    rows = [(name, *(table[k][1] for table in tables)) for k, (name, _) in enumerate(tables[0])]
    write_rows(figure, columns, top - step, rows, step)
    if len(mold.grooves) > len(shown):
        rest = ", ".join(str(groove.number) for groove in mold.grooves[len(shown) :])
        write(figure, EDGE, top - (len(rows) + 1.4) * step, f"tubes {rest}: see mold.json")


def _steps(figure: Figure, mold: Mold, top: float) -> None:
    spec = mold.spec
    heat, clamps = spec.heat, spec.clamps
    bolts = sum(hole.purpose == "bolt" for hole in mold.holes)
    degrees = heat.set_temperature - ZERO_CELSIUS
    fixed = "distal" if clamps.sliding_end == "proximal" else "proximal"
    steps = [
        f"Cut both plates (base and lid, *.nc for {spec.workshop.dialect}). Clamp the stock at least "
        f"{math.ceil(clear_room(mold) * TO_MM)} mm from the plate, with a board below. {bolts} bolts of "
        f"{spec.plate.bolt_diameter * TO_MM:g} mm, 2 dowels of {spec.plate.dowel_diameter * TO_MM:g} mm (ream them), "
        f"{len(mold.vents)} vents of {spec.vents.diameter * TO_MM:g} mm in the lid.",
        "Cut the tube and mark the bend. Press it into the groove, marks on the ends of the bend; dowels, lid, bolts.",
        f"Clamps at the distances of the table from the plate, {clamps.grip * TO_MM:g} mm of tube in each. The {fixed} "
        f"one is fixed; the {clamps.sliding_end} one must slide outwards by the travel in the table, or the hot tube "
        "buckles.",
        f"Heat the bend to {degrees:.0f} ± {heat.tolerance:.0f} °C for {heat.hold_time:g} s, then quench in water.",
        "Trim the ends. Measure the radius, note it beside the mold radius: `tubeopt mold calibrate TRIALS.csv`.",
    ]
    write(figure, 158.0, top, numbered(steps, mold.remarks))


@picture
def plot_springback(calibration: Calibration) -> Figure:
    """The part of the mold's curvature that tubes lost, over the mold's radius, with the fitted model."""
    c = calibration
    figure = new_figure(5.2, 3.4)
    axes = figure.add_subplot()
    axes.plot(
        c.mold_curvature, c.lost * 100, "o", ms=4, mfc="white", mec=tube_colour(0), mew=1.1, label="trials", zorder=3
    )
    low, high = float(c.mold_curvature.min()), float(c.mold_curvature.max())
    # All trials in one mold have no range.
    pad = 0.08 * (high - low) or 0.05 * high
    kappa = np.linspace(max(low - pad, 0.0), high + pad, 100)
    fitted = (c.springback.fraction + c.springback.slope * kappa) * 100
    axes.plot(kappa, fitted, color=tube_colour(2), lw=1.4, label=f"{c.model} model")
    if np.isfinite(c.noise):
        spread = 2 * c.noise * 100
        axes.fill_between(
            kappa,
            fitted - spread,
            fitted + spread,
            color=tube_colour(5),
            alpha=0.25,
            lw=0,
            label="± 2 standard deviations",
        )
    axes.set(xlabel="curvature of the mold (1/m)", ylabel="lost part of the curvature (%)")
    axes.set_ylim(min(0.0, float((c.lost * 100).min()) * 1.2), max(1.0, float(c.lost.max()) * 135))
    upper = axes.secondary_xaxis("top", functions=(_reciprocal, _reciprocal))
    upper.set_xlabel("radius of the mold (mm)")
    radii = np.unique(np.round(TO_MM / c.mold_curvature, 3))
    upper.set_xticks(radii if len(radii) <= 6 else radii[np.linspace(0, len(radii) - 1, 5).astype(int)])
    axes.legend(loc="lower right")
    return figure


def _reciprocal(values: Any) -> Any:
    """1/m to mm and back."""
    return np.asarray(TO_MM / np.maximum(np.abs(np.asarray(values, dtype=float)), 1e-9))


@picture
def plot_materials(ratings: Sequence[MaterialRating], *, title: str = "") -> Figure:
    """Mold materials side by side: heat drawn, temperature to spare, current that leaks; the unsuitable hatched."""
    figure = new_figure(9.0, 0.5 * len(ratings) + 1.3)
    panels = figure.subplots(1, 3, sharey=True)
    names = [rating.material.name.replace("_", " ") for rating in ratings]
    columns = (
        ("heat drawn in the hold (kJ per m of tube)", [r.heat_drawn / TO_MILLI for r in ratings]),
        ("limit above the set temperature (K)", [r.limit_margin for r in ratings]),
        # A logarithmic scale has no 0: an insulator leaks nothing.
        ("share of the current that leaks", [max(r.leak, 1e-18) for r in ratings]),
    )
    for axes, (label, values) in zip(panels, columns, strict=True):
        bars = axes.barh(names, values, color=[tube_colour(1 if r.suitable else 0) for r in ratings], height=0.6)
        for bar, rating in zip(bars, ratings, strict=True):
            if not rating.suitable:
                bar.set_hatch("////")
                bar.set_edgecolor("white")
        axes.set_xlabel(label)
    panels[0].invert_yaxis()
    panels[1].axvline(0, color=INK, lw=0.8)
    panels[2].set_xscale("log")
    most = panels[2].axvline(MOST_LEAK, color=INK, lw=0.8, ls=(0, (4, 3)))
    shown = [r.suitable for r in ratings]
    signs = {"suitable" if suitable else "not suitable": bars[shown.index(suitable)] for suitable in sorted({*shown})}
    legend: dict[str, Any] = {**signs, "most that may leak": most}
    figure.legend(legend.values(), legend.keys(), loc="outside lower center", ncols=3)
    return headed(figure, title)


BODY = "#D9D4C5"


@picture
def plot_mandrel(mandrel: Mandrel) -> Figure:
    """The mandrel in space, and beside it what the workshop needs: rotation over feed, or the groove from above."""
    figure = new_figure(8.6, 4.0)
    space = figure.add_subplot(1, 2, 1, projection="3d")
    side = figure.add_subplot(1, 2, 2)
    draw_space(space, mandrel)
    draw_plan(side, mandrel)
    return headed(figure, f"Mandrel of tube {mandrel.number}, {_made(mandrel)}")


def _made(mandrel: Mandrel) -> str:
    body = mandrel.body
    if isinstance(body, Cylinder):
        return (
            f"turned: cylinder {2 * body.radius * TO_MM:.2f} × {body.length * TO_MM:.1f} mm\n"
            f"groove {mandrel.width * TO_MM:g} mm, radius {body.helix_radius * TO_MM:.3f} mm, "
            f"pitch {body.pitch * TO_MM:.3f} mm, {body.handed}-handed"
        )
    size = np.array(body.size) * TO_MM
    return f"printed: block {size[0]:.1f} × {size[1]:.1f} × {size[2]:.1f} mm\ngroove {mandrel.width * TO_MM:g} mm wide"


def draw_plan(side: Axes, mandrel: Mandrel) -> None:
    """Rotation over feed of a turned mandrel, or the groove of a printed one from above."""
    body, w = mandrel.body, mandrel.winding
    if isinstance(body, Cylinder):
        table = rotation_table(mandrel)
        bend = (table[:, 0] >= 0) & (table[:, 0] <= mandrel.held.curved_length + 1e-12)
        feed, turn = table[:, 1] * TO_MM, np.degrees(table[:, 2])
        side.plot(turn, feed, color=INK, lw=1.0, ls=(0, (4, 2)), label="leads, tangent")
        side.plot(turn[bend], feed[bend], color=tube_colour(mandrel.number - 1), lw=1.8, label="bend")
        side.set(xlabel="rotation (deg)", ylabel="feed from the chuck's end (mm)")
        side.legend(loc="best")
        return
    size = np.array(body.size) * TO_MM
    side.plot(*(w.points[:, :2] * TO_MM).T, color=INK, lw=1.0, ls=(0, (4, 2)), label="leads, tangent")
    points = w.points[w.bend] * TO_MM
    drawn = side.scatter(points[:, 0], points[:, 1], c=size[2] - points[:, 2], s=6, cmap="viridis", zorder=3)
    side.plot(*np.array([(0, 0), (size[0], 0), size[:2], (0, size[1]), (0, 0)]).T, color=INK, lw=0.8)
    side.figure.colorbar(drawn, ax=side, orientation="horizontal", label="centreline below the upper face (mm)")
    side.set_aspect("equal")
    side.set(xlabel="x (mm)", ylabel="y (mm)")


def draw_space(axes: Axes, mandrel: Mandrel) -> None:
    """The mandrel in space, with the tube's centreline in its groove."""
    body, w = mandrel.body, mandrel.winding
    if isinstance(body, Cylinder):
        angle, x = np.meshgrid(np.linspace(0, 2 * math.pi, 61), np.array([0.0, body.length]) * TO_MM)
        # 1.5 % smaller: Matplotlib sorts whole surfaces by depth, and lines on the surface would vanish in it.
        r = body.radius * TO_MM * 0.985
        axes.plot_surface(  # type: ignore[attr-defined]
            x, r * np.cos(angle), r * np.sin(angle), color=BODY, alpha=0.55, lw=0, shade=True
        )
        for end in (0.0, body.length * TO_MM):
            ring = np.linspace(0, 2 * math.pi, 61)
            axes.plot(np.full(61, end), r * np.cos(ring), r * np.sin(ring), color=INK, lw=0.5)
    else:
        _draw_box(axes, np.array(body.size) * TO_MM)
    points = w.points * TO_MM
    axes.plot(*points.T, color=INK, lw=1.0, ls=(0, (4, 2)))
    axes.plot(*points[w.bend].T, color=tube_colour(mandrel.number - 1), lw=2.0)
    low, high = (np.array(f(np.vstack([points, _corners(mandrel)]), axis=0)) for f in (np.min, np.max))
    axes.set_box_aspect(high - low)
    axes.set_axis_off()
    axes.view_init(elev=25, azim=-60)  # type: ignore[attr-defined]


def _corners(mandrel: Mandrel) -> Array:
    body = mandrel.body
    if isinstance(body, Cylinder):
        return np.array([[0, -body.radius, -body.radius], [body.length, body.radius, body.radius]]) * TO_MM
    return np.array([(0.0, 0.0, 0.0), body.size]) * TO_MM


def _draw_box(axes: Axes, size: Array) -> None:
    for ends in itertools.combinations(np.ndindex(2, 2, 2), 2):
        # Of the 28 pairs of corners, the 12 that differ in one coordinate are edges.
        if np.abs(np.subtract(*ends)).sum() == 1:
            axes.plot(*(np.array(ends) * size).T, color=INK, lw=0.6)


@picture
def plot_mandrel_sheet(mandrel: Mandrel, *, title: str = "") -> Figure:
    """The set-up sheet for the workshop, one page A4."""
    figure = new_sheet(f"Set-up sheet: {title or f'mandrel of tube {mandrel.number}'}")
    draw_space(figure.add_axes((0.03, 0.5, 0.42, 0.42), projection="3d"), mandrel)
    draw_plan(figure.add_axes((0.55, 0.56, 0.4, 0.34)), mandrel)
    top = 0.46 * A4[1]
    write_rows(figure, (EDGE, 95.0), top, _mandrel_numbers(mandrel), 5.2)
    write(figure, 150.0, top, numbered(_mandrel_steps(mandrel), mandrel.remarks))
    return figure


def _mandrel_numbers(mandrel: Mandrel) -> list[tuple[str, str]]:
    """What the workshop needs to know; mm."""
    body, tube, held = mandrel.body, mandrel.tube, mandrel.held
    if isinstance(body, Cylinder):
        made = [
            ("cylinder, diameter / length", f"{2 * body.radius * TO_MM:.3f} / {body.length * TO_MM:.1f}"),
            (
                "helix, radius / pitch",
                f"{body.helix_radius * TO_MM:.3f} / {body.pitch * TO_MM:.3f}, {body.handed}-handed",
            ),
        ]
    else:
        made = [("block", " × ".join(f"{size * TO_MM:.1f}" for size in body.size))]
    lead = (mandrel.free_length - held.curved_length) / 2 + mandrel.spec.clamps.grip
    begins = max(lead, tube.straight_length)
    return [
        ("tube, outer / inner diameter", f"{tube.outer_diameter * TO_MM:.3f} / {tube.inner_diameter * TO_MM:.3f}"),
        *made,
        ("groove, width, round below", f"{mandrel.width * TO_MM:.3f}"),
        ("least radius, wanted / in the groove", f"{TO_MM / tube.curvature:.2f} / {TO_MM / held.curvature:.3f}"),
        ("cut the tube to", f"{mandrel.stock_length * TO_MM:.1f}"),
        ("mark: bend begins at / ends at", f"{begins * TO_MM:.1f} / {(begins + held.curved_length) * TO_MM:.1f}"),
        ("tube from clamp to clamp", f"{mandrel.free_length * TO_MM:.1f}"),
    ]


def _mandrel_steps(mandrel: Mandrel) -> list[str]:
    heat, turned = mandrel.spec.heat, isinstance(mandrel.body, Cylinder)
    cut = (
        "Turn the cylinder. Mill the groove (mandrel.nc, or by hand from mandrel.csv: feed and rotation)."
        if turned
        else "Print the block (mandrel.stl); clear the groove of powder and supports."
    )
    hold = "wire over every half turn" if turned else "a flat lid over the open side"
    return [
        cut,
        f"Cut the tube and mark the bend. Wind it into the groove, marks on the ends of the bend; hold it by {hold}, "
        "and clamp one end only: the other must be free to grow.",
        f"Set it in a furnace, mandrel and all: the tube at {heat.set_temperature - ZERO_CELSIUS:.0f} ± "
        f"{heat.tolerance:.0f} °C for {heat.hold_time:g} s, counted from when a thermocouple on the tube is "
        "there; then quench in water. No heating by current is planned: what a mandrel takes off a tube is not known.",
        "Trim the ends. Measure the tube; `tubeopt mold mandrel` prints the expected tube.",
    ]
