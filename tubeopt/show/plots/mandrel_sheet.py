"""The one-page set-up sheet of a mandrel: the curve, the numbers, and how a tube is set on it."""

from __future__ import annotations

import math
import textwrap

from ...files.units import TO_MM
from ...shaping.mold.mandrel import Cylinder, Mandrel
from .kinds import Figure
from .mandrel import draw_plan, draw_space
from .mold import A4, EDGE, INCH, sheet_text
from .style import new_figure, picture

WRAPPED = 78
"""Letters per line of the steps."""


@picture
def plot_mandrel_sheet(mandrel: Mandrel, *, title: str = "") -> Figure:
    """The set-up sheet for the workshop, one page A4.

    Args:
        mandrel: what to make, and to set a tube on.
        title: what it is for.
    """
    figure = new_figure(A4[0] / INCH, A4[1] / INCH, layout=None)
    draw_space(figure.add_axes((0.03, 0.5, 0.42, 0.42), projection="3d"), mandrel)
    draw_plan(figure.add_axes((0.55, 0.56, 0.4, 0.34)), mandrel)
    name = title or f"mandrel of tube {mandrel.number}"
    sheet_text(figure, EDGE, A4[1] - EDGE, f"Set-up sheet: {name}", size=13, weight="bold")
    top = 0.46 * A4[1]
    for k, (what, value) in enumerate(_numbers(mandrel)):
        for x, words in ((EDGE, what), (95.0, value)):
            sheet_text(figure, x, top - 5.2 * k, words)
    lines = [_wrapped(f"{k}.", step) for k, step in enumerate(_steps(mandrel), start=1)]
    lines += [_wrapped("!", remark) for remark in mandrel.remarks]
    sheet_text(figure, 150.0, top, "\n".join(lines))
    return figure


def _wrapped(mark: str, text: str) -> str:
    return f"{mark}  " + textwrap.fill(text, WRAPPED, subsequent_indent="      ")


def _numbers(mandrel: Mandrel) -> list[tuple[str, str]]:
    """What the workshop needs to know; mm."""
    body, tube, held = mandrel.body, mandrel.tube, mandrel.held
    if isinstance(body, Cylinder):
        hand, pitch = "left" if body.lead < 0 else "right", 2 * math.pi * abs(body.lead) * TO_MM
        made = [
            ("cylinder, diameter / length", f"{2 * body.radius * TO_MM:.3f} / {body.length * TO_MM:.1f}"),
            (
                "helix, radius / pitch",
                f"{body.helix_radius * TO_MM:.3f} / {pitch:.3f}, {hand}-handed",
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
        (
            "mark: bend begins at / ends at",
            f"{begins * TO_MM:.1f} / {(begins + held.curved_length) * TO_MM:.1f}",
        ),
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
        f"Set it in a furnace, mandrel and all: the tube at {heat.set_temperature - 273.15:.0f} ± {heat.tolerance:.0f} "
        f"°C for {heat.hold_time:g} s, counted from when a thermocouple on the tube is there; then quench in water. No "
        "heating by current is planned: what a mandrel takes off a tube is not known.",
        "Trim the ends. Measure the tube; what comes off is told by `tubeopt mold mandrel`.",
    ]
