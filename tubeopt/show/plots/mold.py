"""Pictures of molds, mandrels, spring-back and mold materials."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...files.units import TO_MILLI, TO_MM
from ...robots.tubes import Tube
from ...shaping.clamp_body import HALF_BODY, HALF_NOSE
from ...shaping.mold.files import draw_plate, halves
from ...shaping.mold.gcode import slot_paths
from ...shaping.mold.groove import Arc, outline_of
from ...shaping.mold.mandrel import Block, Cylinder, Mandrel, exits_of, rotation_table
from ...shaping.mold.mold import Groove, Mold, clamp_corners
from ...shaping.mold.ranking import MAX_LEAK, MaterialRating
from ...shaping.mold.springback import Calibration
from ...typing import Array
from ..page import tube_colour
from .labels import arrow
from .panels import draw_band, draw_bars
from .style import FAINT, INK, Axes, Figure, disk, entitle, headed, new_figure, picture

if TYPE_CHECKING:
    from matplotlib.patches import Rectangle

PLATE, SLOT, VENT, CLAMP = "#F1EEE6", "#C9D6E3", "#FFFFFF", "#B9BDC2"


@picture
def plot_mold(mold: Mold, *, title: str = "") -> Figure:
    """Picture of the base plate from above: grooves, bolts, dowels, clamps, and the vents of the lid."""
    low, high = extent(mold)
    wide, tall = high - low
    figure = new_figure(7.5, max(2.6, 7.5 * tall / wide + 0.9))
    axes = figure.add_subplot()
    draw_mold(axes, mold)
    axes.set(xlabel="x (mm)", ylabel="y (mm)")
    radii = ",  ".join(f"tube {groove.number}: {radius_text(groove.held, '.2f', ' mm')}" for groove in mold.grooves)
    heading = mold_heading(mold)
    entitle(axes, f"{f'{title}: m{heading[1:]}' if title else heading}\nradius of the groove  {radii}")
    return figure


def radius_text(tube: Tube, digits: str, unit: str = "") -> str:
    """Radius of a tube, mm, the smallest one if it varies; "straight" for a straight tube."""
    if tube.curvature == 0:
        return "straight"
    return f"{'≥ ' if tube.general else ''}{TO_MM / abs(tube.curvature):{digits}}{unit}"


def mold_heading(mold: Mold) -> str:
    """Material and sizes of a mold."""
    plate = mold.spec.plate
    return (
        f"Mold of {mold.spec.material.name.replace('_', ' ')}, {mold.size[0] * TO_MM:g} × {mold.size[1] * TO_MM:g} mm, "
        f"base {plate.thickness * TO_MM:g} mm, lid {plate.lid_thickness * TO_MM:g} mm"
    )


def draw_mold(axes: Axes, mold: Mold, *, clamps: bool = True) -> None:
    """Draw the base plate with clamps and vents of the lid, or the plate alone, in mm at one scale."""
    from matplotlib.patches import Rectangle

    drawing = draw_plate(mold, "base")
    plate = Rectangle((0, 0), *drawing.size, fc=PLATE, ec=INK, lw=0.9, zorder=0)
    axes.add_patch(plate)
    for groove in mold.grooves:
        _draw_groove(axes, groove, plate)
        if clamps:
            _draw_clamps_and_vents(axes, groove, mold)
    for hole in mold.base_holes:
        face = "white" if hole.purpose in ("bolt", "latch") else FAINT
        centre = np.multiply(hole.centre, TO_MM)
        disk(axes, centre, hole.diameter / 2 * TO_MM, fc=face, ec=INK, lw=0.6, zorder=3)
    if mold.hinge:
        for (_, upper), (lower, _) in itertools.pairwise(halves(mold)):
            for edge in (upper, lower):
                axes.plot([0, drawing.size[0]], [edge * TO_MM] * 2, color=INK, lw=0.6, ls=(0, (3, 2)), zorder=2)
    low, high = extent(mold) if clamps else (np.zeros(2), np.array(drawing.size))
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")


def draw_lid(axes: Axes, mold: Mold) -> None:
    """Draw the lid as it lies when it is milled, in mm: with slots its lower face is up."""
    from matplotlib.patches import Polygon, Rectangle

    (width, height), slots = np.array(mold.size) * TO_MM, slot_paths(mold)
    for low, high in halves(mold):
        axes.add_patch(Rectangle((0, low * TO_MM), width, (high - low) * TO_MM, fc=PLATE, ec=INK, lw=0.9, zorder=0))
    for slot, path in zip(mold.slots, slots, strict=True):
        outline = outline_of(path, slot.mill.diameter / 2)
        axes.add_patch(Polygon(_line(outline), fc=SLOT, ec=tube_colour(0), lw=0.8, zorder=2))
    for hole in mold.lid_holes:
        x, y = np.multiply(hole.centre, TO_MM)
        face = FAINT if hole.purpose in ("dowel", "hinge") else "white"
        disk(axes, (width - x if slots else x, y), hole.diameter / 2 * TO_MM, fc=face, ec=INK, lw=0.5, zorder=3)
    axes.set(xlim=(0, width), ylim=(0, height), aspect="equal")


def _draw_groove(axes: Axes, groove: Groove, plate: Rectangle) -> None:
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


def _draw_clamps_and_vents(axes: Axes, groove: Groove, mold: Mold) -> None:
    from matplotlib.patches import Polygon

    curve, colour = groove.centreline, tube_colour(groove.number - 1)
    for vent in groove.vents:
        centre = np.multiply(vent.centre, TO_MM)
        disk(axes, centre, vent.diameter / 2 * TO_MM, fc=VENT, ec=colour, lw=0.5, zorder=3)
    for clamp in groove.clamps:
        along, corners = np.asarray(clamp.direction), clamp_corners(clamp, mold.spec.clamps) * TO_MM
        far = corners[2:4].mean(axis=0)
        axes.add_patch(Polygon(corners, fc=CLAMP, ec=INK, lw=0.6))
        mouth = curve.lead_in.start if clamp.end == "proximal" else curve.lead_out.end
        axes.plot(*np.array([np.asarray(mouth) * TO_MM, far]).T, color=colour, lw=1.2, zorder=3)
        if clamp.slides:
            arrow(axes, far + 1.5 * along, far + 6.5 * along, INK, width=0.8)
        # Beyond the clamp, where no clamp of a neighbour covers it.
        x, y = far + (9.5 if clamp.slides else 3.0) * along
        axes.text(x, y, str(groove.number), color=colour, ha="center", va="center", fontsize=7, fontweight="bold")


BROKEN_LENGTH = 26.0
"""Length at which a side view draws a mold, mm, and two thirds of it what sticks out behind a clamp."""

JAW, NOSE = HALF_BODY * TO_MM, HALF_NOSE * TO_MM
"""Heights of each half of a clamp's body and nose, mm."""


def draw_side(axes: Axes, mold: Mold) -> None:
    """Draw mold, tube, clamps and their supports from the side: heights to scale, the mold shortened; mm."""
    from matplotlib.patches import Rectangle

    groove, spec = mold.grooves[0], mold.spec
    base, lid, grip = (x * TO_MM for x in (spec.plate.thickness, spec.plate.lid_thickness, groove.grip))
    under = strips(mold)
    axis, diameter = under + axis_height(mold) * TO_MM, groove.tube.outer_diameter * TO_MM
    behind, colour = behind_clamp(groove) * TO_MM, tube_colour(groove.number - 1)
    near, far = (gap * TO_MM for gap in groove.gaps)
    fixed = "proximal" if spec.clamps.sliding_end == "distal" else "distal"

    def box(x: float, y: float, wide: float, tall: float, face: str) -> None:
        axes.add_patch(Rectangle((x, y), wide, tall, fc=face, ec=INK, lw=0.6, zorder=2))

    def measure(x: float, low: float, high: float, text: str) -> None:
        arrow(axes, (x, low), (x, high), INK, width=0.6)
        axes.text(x + 0.8, 0.5 * (low + high), text, fontsize=5.5, va="center", ha="left")

    for x in (0.0, BROKEN_LENGTH - 5.0):
        box(x, 0.0, 5.0, under, "white")
    box(0.0, under, BROKEN_LENGTH, base, PLATE)
    box(0.0, under + base, BROKEN_LENGTH, lid, PLATE)
    axes.text(0.5 * BROKEN_LENGTH + 2.5, 0.5 * under, f"strips {under:g}", fontsize=4.5, ha="center", va="center")
    ends = (-near - grip, "proximal", near), (BROKEN_LENGTH + far, "distal", far)
    for left, end, gap in ends:
        box(left, axis, grip, JAW, CLAMP)
        box(left, axis - JAW, grip, JAW, CLAMP)
        box(left, 0.0, grip, axis - JAW, "white")
        axes.text(left + grip / 2, axis + JAW + 1.0, f"{end},\n{'fixed' if end == fixed else 'slides'}", fontsize=5.5,
                  ha="center", va="bottom", linespacing=1.1)  # fmt: skip
        axes.text(left + grip / 2, 0.5 * (axis - JAW), f"support\n{axis - JAW:.1f}", fontsize=4.5, ha="center",
                  va="center", zorder=3, linespacing=1.1)  # fmt: skip
        face = left + grip if end == "proximal" else left
        axes.text(face + (gap / 2 if end == "proximal" else -gap / 2), -1.0, f"{gap:.1f}", fontsize=5.5, ha="center",
                  va="top")  # fmt: skip
        axes.text(left + grip / 2, -1.0, f"{grip:g}", fontsize=5.5, ha="center", va="top")
    outer = -near - grip - (0.65 * BROKEN_LENGTH if behind else 2.0)
    inner = BROKEN_LENGTH + far + grip + 2.0
    axes.plot([outer, inner], [axis, axis], color=colour, lw=1.6, zorder=4)
    if behind:
        axes.text(outer, axis - 1.0, f"{behind:.0f} behind\nit, live:\nsleeve", fontsize=5.5, ha="left", va="top",
                  linespacing=1.1)  # fmt: skip
    travel = max(clamp.travel for clamp in groove.clamps) * TO_MM
    at, way = (ends[1][0] + grip, 1.0) if fixed == "proximal" else (ends[0][0], -1.0)
    arrow(axes, (at + way * 2.5, axis - JAW / 2), (at + way * 8.0, axis - JAW / 2), INK, width=0.8)
    axes.text(at + way * 5.0, axis - JAW / 2 - 1.0, f"{travel:.1f}", fontsize=5.5, ha="center", va="top")
    measure(0.4 * BROKEN_LENGTH, 0.0, axis, f"axis {axis:.2f}")
    axes.text(1.0, under + base + 0.5 * lid, "lid", fontsize=5.5, va="center")
    axes.text(1.0, under + 0.5 * base, "base", fontsize=5.5, va="center")
    # One clamp from its face: round jaws around tube and core wire, the tube enlarged.
    x, y, scale = 0.5 * BROKEN_LENGTH, -17.0, 2.5
    box(x - 7.5, y, 15.0, NOSE, CLAMP)
    box(x - 7.5, y - NOSE, 15.0, NOSE, CLAMP)
    disk(axes, np.array([x, y]), scale * diameter / 2, fc="white", ec=colour, lw=1.4, zorder=4)
    bore = groove.tube.inner_diameter * TO_MM
    if bore:
        disk(axes, np.array([x, y]), 0.85 * scale * bore / 2, fc=FAINT, ec=INK, lw=0.4, zorder=5)
    axes.text(x - 9.0, y, f"jaws seen from\nthe mold, {NOSE:g} high\neach; tube enlarged", fontsize=5.5, ha="right",
              va="center", linespacing=1.1)  # fmt: skip
    axes.text(x + 9.0, y, "round grooves,\ncore wire in\nthe bore", fontsize=5.5, ha="left", va="center",
              linespacing=1.1)  # fmt: skip
    axes.plot([outer, inner + 6.0], [0.0, 0.0], color=INK, lw=0.9)
    axes.set(xlim=(outer - 1, inner + 9), ylim=(y - NOSE - 3, axis + max(lid, JAW) + 8.0), aspect="equal")
    axes.set_axis_off()


def strips(mold: Mold) -> float:
    """Height of the strips under the base, mm: heads of bolts (0.7 diameters, ISO 4017) and washers have room."""
    return math.ceil(mold.spec.plate.bolt_diameter * TO_MM)


def axis_height(mold: Mold) -> float:
    """Height (m) of the axis of the first tube above the lower face of the base: it lies on the floor of its groove."""
    groove = mold.grooves[0]
    return mold.spec.plate.thickness - groove.depth + 0.5 * groove.tube.outer_diameter


def behind_clamp(groove: Groove) -> float:
    """Length of tube (m) that sticks out behind the proximal clamp, where a straight part is longer than needed."""
    held = groove.centreline.lead_in.length + groove.gaps[0] + groove.grip
    behind = groove.before_bend - held
    return behind if behind > 0.5e-3 else 0.0  # round-off is no tube


def _line(pieces: Sequence[Arc]) -> Array:
    """(N, 2) points in mm, fine on arcs."""
    # Half a turn in 199 chords stays within R (pi/199)^2 / 8, which is 3e-5 R, of the arc.
    counts = [200 if piece.curvature else 2 for piece in pieces]
    points = [piece.point(np.linspace(0, piece.length, count)) for piece, count in zip(pieces, counts, strict=True)]
    return np.asarray(np.vstack(points) * TO_MM)


def extent(mold: Mold) -> tuple[Array, Array]:
    """Smallest and largest coordinates (2,) of plate and clamps, with a border, mm."""
    reach = mold.spec.clamps.grip + mold.spec.clamps.width / 2
    clamps = [clamp for groove in mold.grooves for clamp in groove.clamps]
    tips = [np.asarray(clamp.face) + reach * np.asarray(clamp.direction) for clamp in clamps]
    points = np.array([(0.0, 0.0), mold.size, *tips]) * TO_MM
    return points.min(axis=0) - 4, points.max(axis=0) + 4


@picture
def plot_springback(calibration: Calibration) -> Figure:
    """Picture of the fraction of the mold's curvature that tubes lost, over the curvature, with the fitted model."""
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
        deviation = 2 * c.noise * 100
        low_end, high_end = fitted - deviation, fitted + deviation
        draw_band(axes, kappa, low_end, high_end, tube_colour(5), name="± 2 standard deviations", alpha=0.25)
    axes.set(xlabel="curvature of the mold (1/m)", ylabel="lost fraction of the curvature (%)")
    axes.set_ylim(min(0.0, float((c.lost * 100).min()) * 1.2), max(1.0, float(c.lost.max()) * 135))
    upper = axes.secondary_xaxis("top", functions=(_reciprocal, _reciprocal))
    upper.set_xlabel("radius of the mold (mm)")
    radii = np.unique(np.round(TO_MM / c.mold_curvature, 3))
    upper.set_xticks(radii if len(radii) <= 6 else radii[np.linspace(0, len(radii) - 1, 5).astype(int)])
    axes.legend(loc="lower right")
    return figure


def _reciprocal(values: Any) -> Any:
    """Radii (mm) of curvatures (1/m), or curvatures of radii."""
    return np.asarray(TO_MM / np.maximum(np.abs(np.asarray(values, dtype=float)), 1e-9))


@picture
def plot_materials(ratings: Sequence[MaterialRating], *, title: str = "") -> Figure:
    """Picture of mold materials: heat drawn, margin to the limit temperature, leaking current; unsuitable hatched."""
    figure = new_figure(9.0, 0.5 * len(ratings) + 1.3)
    panels = figure.subplots(1, 3, sharey=True)
    names = [rating.material.name.replace("_", " ") for rating in ratings]
    columns = (
        ("heat drawn in the hold (kJ per m of tube)", [r.heat_drawn / TO_MILLI for r in ratings]),
        ("limit above the set temperature (K)", [r.limit_margin for r in ratings]),
        # A logarithmic scale has no 0: an insulator leaks nothing.
        ("fraction of the current that leaks", [max(r.leak, 1e-18) for r in ratings]),
    )
    colours = [tube_colour(1 if r.suitable else 0) for r in ratings]
    for axes, (label, values) in zip(panels, columns, strict=True):
        bars = draw_bars(axes, names, values, label, colours=colours)
        for bar, rating in zip(bars, ratings, strict=True):
            if not rating.suitable:
                bar.set_hatch("////")
                bar.set_edgecolor("white")
        axes.label_outer()
        axes.set_xlabel(label)
    panels[1].axvline(0, color=INK, lw=0.8)
    panels[2].set_xscale("log")
    limit = panels[2].axvline(MAX_LEAK, color=INK, lw=0.8, ls=(0, (4, 3)))
    suitable = [r.suitable for r in ratings]
    legend: dict[str, Any] = {
        "suitable" if kind else "not suitable": bars[suitable.index(kind)] for kind in sorted({*suitable})
    }
    legend["largest admissible leak"] = limit
    figure.legend(legend.values(), legend.keys(), loc="outside lower center", ncols=3)
    return headed(figure, title)


BODY = "#D9D4C5"


@picture
def plot_mandrel(mandrel: Mandrel) -> Figure:
    """Picture of the mandrel in space, and next to it rotation over feed, or the groove from above."""
    figure = new_figure(8.6, 4.0)
    space = figure.add_subplot(1, 2, 1, projection="3d")
    side = figure.add_subplot(1, 2, 2)
    draw_space(space, mandrel)
    draw_plan(side, mandrel)
    body = mandrel.body
    if isinstance(body, Cylinder):
        facts = (
            f"turned: cylinder {2 * body.radius * TO_MM:.2f} × {body.length * TO_MM:.1f} mm\n"
            f"groove {mandrel.width * TO_MM:g} mm, radius {body.helix_radius * TO_MM:.3f} mm, "
            f"pitch {body.pitch * TO_MM:.3f} mm, {body.handed}-handed"
        )
    else:
        size = " × ".join(f"{length * TO_MM:.1f}" for length in body.size)
        facts = f"printed: block {size} mm\ngroove {mandrel.width * TO_MM:g} mm wide"
    return headed(figure, f"Mandrel of tube {mandrel.number}, {facts}")


def draw_plan(side: Axes, mandrel: Mandrel) -> None:
    """Draw rotation over feed of a turned mandrel, or the groove of a printed one from above."""
    body, w = mandrel.body, mandrel.winding
    if isinstance(body, Cylinder):
        table = rotation_table(mandrel)
        bend = (table[:, 0] >= 0) & (table[:, 0] <= mandrel.held.curved_length + 1e-12)
        feed, winding = table[:, 1] * TO_MM, np.degrees(table[:, 2])
        side.plot(winding, feed, color=INK, lw=1.0, ls=(0, (4, 2)), label="leads, tangent")
        side.plot(winding[bend], feed[bend], color=tube_colour(mandrel.number - 1), lw=1.8, label="bend")
        side.set(xlabel="rotation (deg)", ylabel="feed from the chuck's end (mm)")
        side.legend(loc="best")
        return
    size = np.array(body.size) * TO_MM
    points = w.points[w.bend] * TO_MM
    for end, point in zip(exits_of(mandrel), (points[0], points[-1]), strict=True):
        line = np.array([point[:2], end.point[:2] * TO_MM])
        side.plot(*line.T, color=INK, lw=1.0, ls=(0, (4, 2)))
        if end.upper:
            side.plot(*line[1], "x", color=INK, ms=5, zorder=4)
            side.annotate("exit", line[1], (3, 3), textcoords="offset points", fontsize=7, color=INK)
    # The walls of the slot, which run beside the whole groove.
    across = np.column_stack([-w.tangents[:, 1], w.tangents[:, 0]])
    across *= 0.5 * body.slot / np.linalg.norm(across, axis=1)[:, None]
    inside = ((w.points >= 0) & (w.points <= np.array(body.size))).all(axis=1)
    for wall in (w.points[:, :2] + across, w.points[:, :2] - across):
        side.plot(*(wall[inside] * TO_MM).T, color=INK, lw=0.6)
    drawn = side.scatter(points[:, 0], points[:, 1], c=size[2] - points[:, 2], s=6, cmap="viridis", zorder=3)
    side.plot(*np.array([(0, 0), (size[0], 0), size[:2], (0, size[1]), (0, 0)]).T, color=INK, lw=0.8)
    side.figure.colorbar(drawn, ax=side, orientation="horizontal", label="centreline below the upper face (mm)")
    side.set_aspect("equal")
    side.set(xlabel="x (mm)", ylabel="y (mm)")


def draw_slot(axes: Axes, mandrel: Mandrel) -> None:
    """Draw the section of the slot of a printed mandrel, with the tube in its groove, mm."""
    assert isinstance(mandrel.body, Block)
    from matplotlib.patches import Polygon

    half, slot = 0.5 * mandrel.width * TO_MM, 0.5 * mandrel.body.slot * TO_MM
    outer = 0.5 * mandrel.tube.outer_diameter * TO_MM
    slopes = outer + slot - half
    turn = np.linspace(np.pi, 2 * np.pi, 40)
    high, beyond = slopes + 2.0, slot + 2.0
    floor = np.column_stack([half * np.cos(turn), half * np.sin(turn)])
    left = np.array([(-beyond, high), (-slot, high), (-slot, slopes), (-half, outer)])
    outline = np.vstack([left, floor, left[:0:-1] * (-1, 1), (beyond, high), (beyond, -half - 2), (-beyond, -half - 2)])
    axes.add_patch(Polygon(outline, fc=PLATE, ec=INK, lw=0.8))
    disk(axes, np.array([0.0, outer - half]), outer, fc="white", ec=tube_colour(mandrel.number - 1), lw=1.4, zorder=3)
    for level, width, text in ((high + 0.5, slot, f"{2 * slot:g}"), (-half - 2.5, half, f"{2 * half:.3g}")):
        axes.plot([-width, width], [level, level], color=INK, lw=0.7, marker="|", ms=4)
        axes.text(0, level + (0.4 if level > 0 else -0.4), text, fontsize=6, ha="center",
                  va="bottom" if level > 0 else "top")  # fmt: skip
    axes.text(0.5 * (slot + half) + 0.3, 0.5 * (slopes + outer) - 0.5, "45°", fontsize=6, ha="left", va="top")
    axes.set(xlim=(-beyond - 1, beyond + 1), ylim=(-half - 5.0, high + 2.5), aspect="equal")
    axes.set_axis_off()


def draw_space(axes: Axes, mandrel: Mandrel) -> None:
    """Draw the mandrel in space, with the centreline of the tube in its groove."""
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
        ends = np.array([[0, -body.radius, -body.radius], [body.length, body.radius, body.radius]]) * TO_MM
    else:
        ends = np.array([(0.0, 0.0, 0.0), body.size]) * TO_MM
        for corners in itertools.combinations(np.ndindex(2, 2, 2), 2):
            # Of the 28 pairs of corners, the 12 that differ in one coordinate are edges.
            if np.abs(np.subtract(*corners)).sum() == 1:
                axes.plot(*(np.array(corners) * ends[1]).T, color=INK, lw=0.6)
    points = w.points * TO_MM
    axes.plot(*points.T, color=INK, lw=1.0, ls=(0, (4, 2)))
    axes.plot(*points[w.bend].T, color=tube_colour(mandrel.number - 1), lw=2.0)
    axes.set_box_aspect(np.ptp(np.vstack([points, ends]), axis=0))
    axes.set_axis_off()
    axes.view_init(elev=25, azim=-60)  # type: ignore[attr-defined]
