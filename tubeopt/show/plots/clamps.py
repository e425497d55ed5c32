"""Sheet of the clamps of a tube: one page A4 with three views, the groove enlarged, and the steps."""

from __future__ import annotations

import math

import numpy as np

from ...files.units import TO_MM
from ...shaping.clamp_body import (
    ASIDE,
    BEHIND_NOSE,
    HALF_BODY,
    HALF_NOSE,
    OPEN,
    SCREW,
    SHIM,
    ClampBody,
    clamp_body,
    equal_mass,
    largest_force,
)
from ...shaping.mold.mold import shoulder
from ...shaping.tube_fabrication import TubeFabrication
from .labels import arrow
from .mold import CLAMP, axis_height, strips
from .sheets import A4, EDGE, new_sheet, write_at, write_steps
from .style import INK, Axes, Figure, disk, picture

SCALE = 1.5
"""Enlargement of the three views."""

LUG = 5.0
"""Nominal diameter of the screw of the lug, mm."""

CHANNEL = 2e-3
"""Extra width of the channel behind the nose, m: the tube does not touch it, and a sleeve has room."""

RAILS = 0.2
"""Play of the sliding clamp between its rails, mm."""


@picture
def plot_clamp_sheet(fabrication: TubeFabrication, *, title: str = "") -> Figure:
    """Dimensioned drawing of the clamps of a tube, with material, screws, torque, support and guide."""
    spec = fabrication.mold.spec.clamps
    body = clamp_body(fabrication.groove.tube, spec, fabrication.rig.clamps)
    figure = new_sheet(f"Clamps: {title or f'tube {fabrication.groove.number}'}")
    write_at(figure, EDGE, A4[1] - EDGE - 6, f"Two clamps; mm, drawn {SCALE:g}:1, the groove 10:1")
    long, high = (body.grip + body.length) * TO_MM, 2 * HALF_BODY * TO_MM
    left, top = EDGE + 12, A4[1] - EDGE - 22
    views = (
        ("from above", left, top - SCALE * body.width * TO_MM, long, body.width * TO_MM, _above),
        ("from the side", left, top - SCALE * (body.width * TO_MM + 12 + high), long, high, _aside),
        ("from the mold", left + SCALE * long + 28, top - SCALE * (body.width * TO_MM + 12 + high),
         body.width * TO_MM, high, _front),
    )  # fmt: skip
    for name, x, y, wide, tall, draw in views:
        axes = figure.add_axes(((x - 16) / A4[0], (y - 12) / A4[1], (SCALE * wide + 32) / A4[0],
                                (SCALE * tall + 24) / A4[1]))  # fmt: skip
        draw(axes, body)
        axes.set(xlim=(-16 / SCALE, wide + 16 / SCALE), ylim=(-12 / SCALE, tall + 12 / SCALE), aspect="equal")
        axes.set_axis_off()
        write_at(figure, x, y + SCALE * tall + 9.5, name, weight="bold")
    x, y = left + SCALE * long + 40, top - 26
    axes = figure.add_axes((x / A4[0], y / A4[1], 50 / A4[0], 30 / A4[1]))
    _groove(axes, body)
    write_at(figure, x, y + 34.5, "groove of both halves, the tube in it", weight="bold")
    write_steps(figure, EDGE, 78.0, clamp_steps(fabrication, body), ())
    return figure


def clamp_steps(fabrication: TubeFabrication, body: ClampBody) -> list[str]:
    """Steps, as text, that make the clamps of a tube and put them beside the mold."""
    mold, groove, asked = fabrication.mold, fabrication.groove, fabrication.rig.clamps
    below = (mold.spec.plate.thickness - axis_height(mold)) * TO_MM
    sliding, travel = mold.spec.clamps.sliding_end, max(clamp.travel for clamp in groove.clamps) * TO_MM
    fixed = "distal" if sliding == "proximal" else "proximal"
    diameter = groove.tube.outer_diameter * TO_MM
    return [
        f"Two clamps of aluminium, each of two halves, split at the axis: {body.mass * 1e3:.0f} g (the plan: "
        f"{equal_mass(asked) * 1e3:.0f} g), {body.area * 1e4:.0f} cm² in air (the plan: "
        f"{asked.area * 1e4:.0f} cm²). Tolerances ISO 2768-m, the groove ± {OPEN / 2 * TO_MM:g} mm in depth."
        + ("" if body.mass < 1.05 * equal_mass(asked) else " Heavier than planned: set mass_g of the rig, plan again."),
        f"Groove along the nose in each half: radius {diameter / 2:.2f} mm, {body.groove_depth * TO_MM:.2f} mm deep. "
        f"On the tube the halves stay {2 * OPEN * TO_MM:g} mm apart. Cut it by a ball-nose end mill. Behind the nose a "
        f"channel of {diameter + CHANNEL * TO_MM:.1f} mm, so that the tube touches the nose alone.",
        f"Two M{SCREW * TO_MM:g} screws in each clamp: holes of 4.5 mm in the upper half, threads in the lower one. A "
        f"shim of {2 * OPEN * TO_MM:g} × {SHIM * TO_MM:g} × {body.width * TO_MM:g} mm lies at the rear end.",
        f"Tighten each screw by at most {math.floor(100 * body.torque) / 100:.2f} N m: T = 0.2 F d, and the lever "
        f"gives the nose 1 / {body.lever:.2f} of their force, at most {largest_force(body.tube, body.grip):.0f} N.",
        f"Lug of the cable under an M{LUG:g} screw in the upper half, 8 mm deep. Faces brushed, with contact grease. "
        f"The {sliding} clamp has a flexible lead.",
        f"Supports of the mold's board: height = strips {strips(mold):g} + measured thickness of the base - "
        f"{below:.2f} - {HALF_BODY * TO_MM:g} mm. Distances of the noses from the plate: set-up sheet.",
        f"The {fixed} clamp is fixed: two more M4 screws from below, through its support. The {sliding} one lies "
        f"between two rails of board along the tube, {body.width * TO_MM + RAILS:.1f} mm apart, free to move outwards "
        f"by {travel:.1f} mm and more.",
    ]


def _dimension(axes: Axes, start: tuple[float, float], end: tuple[float, float], text: str) -> None:
    """Draw a dimension between two points, with its text above or to the left of it."""
    for a, b in ((start, end), (end, start)):
        arrow(axes, a, b, INK, width=0.5, head=5)
    upright = start[0] == end[0]
    x, y = 0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1])
    axes.text(x - (0.6 if upright else 0), y + (0 if upright else 0.4), text, fontsize=6,
              ha="right" if upright else "center", va="center" if upright else "bottom", zorder=6,
              bbox={"fc": "white", "ec": "none", "pad": 0.6} if upright else None)  # fmt: skip


def _box(axes: Axes, x: float, y: float, wide: float, tall: float) -> None:
    """Draw a rectangle with its lower left corner at a point."""
    from matplotlib.patches import Rectangle

    axes.add_patch(Rectangle((x, y), wide, tall, fc=CLAMP, ec=INK, lw=0.7, zorder=2))


def _above(axes: Axes, body: ClampBody) -> None:
    """Draw a clamp from above: nose on the left, screws and lug; mm."""
    from matplotlib.patches import Polygon

    grip, long, wide = (x * TO_MM for x in (body.grip, body.length, body.width))
    face, nose, back = (0.5 * TO_MM * x for x in (body.nose.face_width, body.nose.width, 2 * shoulder(body.nose)))
    axis = wide / 2
    corners = [(0.0, -face), (back, -nose), (grip, -nose), (grip, nose), (back, nose), (0.0, face)]
    axes.add_patch(Polygon(np.array(corners) + np.array([0.0, axis]), fc=CLAMP, ec=INK, lw=0.7, zorder=2))
    _box(axes, grip, 0.0, long, wide)
    axes.plot([-4, grip + long + 4], [axis, axis], color=INK, lw=0.6, ls=(0, (8, 2, 1.5, 2)), zorder=3)
    at = grip + BEHIND_NOSE * TO_MM
    for side in (-1, 1):
        centre = np.array([at, axis + side * ASIDE * TO_MM])
        disk(axes, centre, SCREW * TO_MM / 2, fc="white", ec=INK, lw=0.6, zorder=4)
    lug = grip + long - SHIM * TO_MM - 6
    disk(axes, np.array([lug, axis]), LUG / 2, fc="white", ec=INK, lw=0.6, zorder=4)
    axes.text(lug, axis, f"M{LUG:g}\nlug", fontsize=5, ha="center", va="center", zorder=5)
    axes.plot([grip + long - SHIM * TO_MM] * 2, [0, wide], color=INK, lw=0.5, ls=":", zorder=3)
    axes.text(grip + long - SHIM * TO_MM / 2, 1.0, "shim", fontsize=5, ha="center", rotation=90, va="bottom", zorder=4)
    _dimension(axes, (0.0, wide + 1.5), (grip, wide + 1.5), f"{grip:g}")
    _dimension(axes, (grip, wide + 1.5), (grip + long, wide + 1.5), f"{long:.1f}")
    _dimension(axes, (grip, -2.5), (at, -2.5), f"{BEHIND_NOSE * TO_MM:g}")
    _dimension(axes, (lug, -2.5), (grip + long, -2.5), f"{grip + long - lug:g}")
    _dimension(axes, (grip + long + 5, 0.0), (grip + long + 5, wide), f"{wide:g}")
    _dimension(axes, (-1.5, axis - face), (-1.5, axis + face), f"{2 * face:g}")
    _dimension(axes, (at + 4, axis - ASIDE * TO_MM), (at + 4, axis + ASIDE * TO_MM), f"{2 * ASIDE * TO_MM:g}")
    axes.text(back / 2 - 1, axis + nose, "45°", fontsize=6, ha="right", va="center")
    axes.text(at, axis + ASIDE * TO_MM, f"M{SCREW * TO_MM:g}", fontsize=5, ha="center", va="center", zorder=5)


def _aside(axes: Axes, body: ClampBody) -> None:
    """Draw a clamp from the side: both halves with the gap between them; mm."""
    grip, long, half, nose = (x * TO_MM for x in (body.grip, body.length, HALF_BODY, HALF_NOSE))
    for side in (0.0, half):
        _box(axes, grip, side, long, half)
        _box(axes, 0.0, side if side else half - nose, grip, nose)
    axes.plot([-4, grip + long + 4], [half, half], color=INK, lw=0.6, ls=(0, (8, 2, 1.5, 2)), zorder=3)
    at = grip + BEHIND_NOSE * TO_MM
    axes.plot([at, at], [2.0, 2 * half + 1.5], color=INK, lw=0.6, ls=(0, (4, 1.5, 1, 1.5)), zorder=3)
    _dimension(axes, (-2.0, half - nose), (-2.0, half + nose), f"{2 * nose:g}")
    _dimension(axes, (grip + long + 5, 0.0), (grip + long + 5, 2 * half), f"{2 * half:g}")
    axes.text(grip + long / 2, half + 1.0, f"gap {2 * OPEN * TO_MM:g}, by the shim", fontsize=6, ha="center", zorder=4)


def _front(axes: Axes, body: ClampBody) -> None:
    """Draw a clamp from the mold: body, nose, and the tube between the halves; mm."""
    wide, half, nose = body.width * TO_MM, HALF_BODY * TO_MM, HALF_NOSE * TO_MM
    across = body.nose.width * TO_MM
    _box(axes, 0.0, 0.0, wide, 2 * half)
    _box(axes, (wide - across) / 2, half - nose, across, 2 * nose)
    axes.plot([0.0, wide], [half, half], color=INK, lw=0.7, zorder=3)
    disk(axes, np.array([wide / 2, half]), body.tube.outer_diameter / 2 * TO_MM, fc="white", ec=INK, lw=0.8, zorder=4)
    _dimension(axes, ((wide - across) / 2, half - nose - 1.8), ((wide + across) / 2, half - nose - 1.8), f"{across:g}")


def _groove(axes: Axes, body: ClampBody) -> None:
    """Draw the groove of both halves with the gap between them, ten times enlarged; mm."""
    from matplotlib.patches import Polygon

    radius, open_ = body.tube.outer_diameter / 2 * TO_MM, OPEN * TO_MM
    start = math.asin(open_ / radius)
    turn = np.linspace(start, math.pi - start, 60)
    arc = radius * np.column_stack([np.cos(turn), np.sin(turn)])
    rim = np.array([(-2.5, open_), (-2.5, 1.5), (2.5, 1.5), (2.5, open_)])
    for side in (1, -1):
        axes.add_patch(Polygon(np.vstack([arc, rim]) * (1, side), fc=CLAMP, ec=INK, lw=0.7, zorder=2))
    disk(axes, np.zeros(2), body.tube.outer_diameter / 2 * TO_MM, fc="white", ec=INK, lw=0.9, zorder=3)
    axes.text(0.0, 0.0, f"R {radius:.2f}", fontsize=6, ha="center", va="center", zorder=4)
    axes.text(1.75, radius / 2 + open_ + 0.1, f"{body.groove_depth * TO_MM:.2f}\ndeep", fontsize=6, ha="center",
              va="center", zorder=4)  # fmt: skip
    axes.text(-1.75, 0.0, f"gap {2 * open_:g}", fontsize=6, ha="center", va="center", zorder=4)
    axes.set(xlim=(-2.5, 2.5), ylim=(-1.5, 1.5), aspect="equal")
    axes.set_axis_off()
