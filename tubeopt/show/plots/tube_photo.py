"""Pictures of a tube measured in a photo, and the sheet with marks on which it lies."""

from __future__ import annotations

import math

import numpy as np

from ...files.units import TO_MM
from ...shaping.mold.measured_tube import MeasuredTube
from ...shaping.mold.photo import MARK_RADII, mapped
from ...typing import Array
from ..page import WIDTH, tube_colour
from .style import Axes, Figure, disk, entitle, new_figure, picture

SHEET = 279.4, 210.0
"""Length of Letter and width of A4, mm: the sheet fits both."""

MAX_PIXELS = 1400
"""Pixels along the longer side of a photo in a picture."""


@picture
def plot_measured_tube(measured: MeasuredTube) -> Figure:
    """Picture of the photo with the detected centreline, the circle through the bend, its radius and interval."""
    m, grey = measured, measured.photo.grey
    shown = mapped(m.scale.to_pixels, m.trace.points)
    low, high = shown.min(axis=0), shown.max(axis=0)
    edge = 0.15 * float((high - low).max()) + 5
    left, top = np.maximum(low - edge, 0).astype(int)
    right, bottom = np.minimum(high + edge, grey.shape[::-1]).astype(int)
    part = grey[top:bottom, left:right]
    factor = max(1, max(part.shape) // MAX_PIXELS)
    tall, wide = part.shape
    figure = new_figure(6.0, float(np.clip(6.0 * tall / wide, 2.5, 7.5)) + 0.7)
    axes = figure.add_subplot()
    axes.imshow(
        part[::factor, ::factor], cmap="gray", vmin=0, vmax=1, extent=(left - 0.5, right - 0.5, bottom - 0.5, top - 0.5)
    )
    axes.plot(*shown.T, color=tube_colour(1), lw=0.9, label="detected centreline")
    axes.plot(*_circle(m).T, color=tube_colour(0), lw=1.2, ls=(0, (5, 3)), label="circle through the bend")
    axes.set(xlim=(left, right), ylim=(bottom, top))
    axes.set_axis_off()
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.01), ncols=2)
    low_end, high_end = np.multiply(m.interval, TO_MM)
    entitle(
        axes,
        f"{m.photo.name}: radius {m.radius * TO_MM:.2f} mm (95 %: {low_end:.2f} to {high_end:.2f} mm)\n"
        f"bend of {m.arc.length * TO_MM:.1f} mm, {math.degrees(m.angle):.1f}°",
    )
    return figure


def _circle(m: MeasuredTube) -> Array:
    """(N, 2) pixels of the circle, over the bend and a tenth more at each end."""
    used = m.scale.raised(m.trace.points, m.height)[m.arc.used] - m.arc.centre
    angle = np.unwrap(np.arctan2(used[:, 1], used[:, 0]))
    more = 0.1 * np.ptp(angle)
    along = np.linspace(angle.min() - more, angle.max() + more, 200)
    points = m.arc.centre + m.arc.radius * np.column_stack([np.cos(along), np.sin(along)])
    return mapped(m.scale.to_pixels, m.scale.lowered(points, m.height))


@picture
def plot_mark_sheet(marks: tuple[float, float]) -> Figure:
    """Sheet with four marks at the corners of a rectangle of the given sides, m, in true size."""
    token = WIDTH.set(None)
    try:
        figure = new_figure(SHEET[0] / 25.4, SHEET[1] / 25.4, layout=None)
    finally:
        WIDTH.reset(token)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, SHEET[0]), ylim=(0, SHEET[1]))
    axes.set_axis_off()
    wide, tall = np.multiply(marks, TO_MM)
    middle = np.array(SHEET) / 2
    for x in (-wide / 2, wide / 2):
        for y in (-tall / 2, tall / 2):
            _draw_mark(axes, middle + np.array([x, y]))
    text = (
        f"Print at 100 %. The middles of the marks must be {wide:g} mm and {tall:g} mm apart: measure them, and give "
        "other distances to --marks-mm.",
        "Lay the sheet flat and the tube in the middle, without anything across it. Take the photo from above, half a "
        "metre away or more, with all four marks.",
    )
    for k, line in enumerate(text):
        x, y = middle - np.array([0, tall / 2 + 5 + 4.5 * k])
        axes.text(x, y, line, ha="center", va="center", fontsize=6.5)
    return figure


def _draw_mark(axes: Axes, centre: Array) -> None:
    """Draw a black dot with a black ring around it, mm."""
    dot, inner, outer = np.multiply(MARK_RADII, TO_MM)
    for radius, colour in ((outer, "black"), (inner, "white"), (dot, "black")):
        disk(axes, centre, radius, fc=colour, ec="none")
