"""Mandrels: the solid with its groove in space, the groove unrolled or from above, and the one-page set-up sheet."""

from __future__ import annotations

import itertools
import math

import numpy as np

from ...constants import ZERO_CELSIUS
from ...files.units import TO_MM
from ...shaping.mold.mandrel import Cylinder, Mandrel, rotation_table
from ...typing import Array
from ..colours import tube_colour
from .sheet import A4, EDGE, new_sheet, numbered, write, write_rows
from .style import INK, Axes, Figure, headed, new_figure, picture

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
        if np.abs(np.subtract(*ends)).sum() == 1:
            axes.plot(*(np.array(ends) * size).T, color=INK, lw=0.6)


@picture
def plot_mandrel_sheet(mandrel: Mandrel, *, title: str = "") -> Figure:
    """The set-up sheet for the workshop, one page A4."""
    figure = new_sheet(f"Set-up sheet: {title or f'mandrel of tube {mandrel.number}'}")
    draw_space(figure.add_axes((0.03, 0.5, 0.42, 0.42), projection="3d"), mandrel)
    draw_plan(figure.add_axes((0.55, 0.56, 0.4, 0.34)), mandrel)
    top = 0.46 * A4[1]
    write_rows(figure, (EDGE, 95.0), top, _numbers(mandrel), 5.2)
    write(figure, 150.0, top, numbered(_steps(mandrel), mandrel.remarks))
    return figure


def _numbers(mandrel: Mandrel) -> list[tuple[str, str]]:
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


def _steps(mandrel: Mandrel) -> list[str]:
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
