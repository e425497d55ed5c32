"""The page of a commissioning to print: one page A4 with all that was found."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np

from ...files.units import TO_MM
from ...runs.commission_study import Commissioning
from ..commission_report import estimate_rows, floor_text, latency_text, next_rows, reading_rows
from .sheets import A4, EDGE, ROW, new_sheet, write_at
from .style import Axes, Figure, picture

# Most rows of the tables; what is left out is in report.json.
MOST_COLUMNS, MOST_PARAMETERS, MOST_NEXT, MOST_REMARKS = 16, 18, 20, 6

RIGHT = 160.0
"""Left end of the right half, mm."""


@picture
def plot_commissioning(c: Commissioning) -> Figure:
    """Page with columns, parameters, errors held out, floor of the servo, what to measure next, and remarks."""
    figure = new_sheet(f"Commissioning of {c.given.name or 'a robot'}")
    top = A4[1] - EDGE - 9
    start, chosen = c.comparison.start, c.comparison.chosen_anew
    facts = [
        ("recordings", ", ".join(f"{log.name} ({len(log.measurements)} rows)" for log in c.logs)),
        ("errors held out", f"{start.rms * TO_MM:.2f} mm as drawn, {chosen.rms * TO_MM:.2f} mm calibrated (RMS)"),
        (
            "",
            f"95 % below {chosen.p95 * TO_MM:.2f} mm, greatest {chosen.max * TO_MM:.2f} mm; choice of effects included",
        ),
        ("latency", latency_text(c)),
        ("servo must keep", floor_text(c)),
    ]
    top = _table(figure, EDGE, top, (0.0, 28.0), facts) - 0.5 * ROW
    columns = [row for log in c.logs for row in ([(log.name, "", "")] if len(c.logs) > 1 else []) + reading_rows(log)]
    top = _section(figure, EDGE, top, "How the columns are read", (0.0, 33.0, 63.0), columns, MOST_COLUMNS)
    heads = ("Fitted parameters, with intervals of what the model lacks", (0.0, 33.0, 63.0))
    _section(figure, EDGE, top, *heads, estimate_rows(c), MOST_PARAMETERS)
    _draw_errors(figure.add_axes((0.59, 0.62, 0.36, 0.24)), c)
    n = c.given.n_tubes
    names = ("", *(f"rot {i + 1}" for i in range(n)), *(f"trans {i + 1}" for i in range(n)))
    places = [6.0 + 17.0 * k for k in range(2 * n)]
    rows = [names, *next_rows(c, MOST_NEXT)]
    title = "Measure next (deg, mm; all in next/configurations.csv)"
    low = _section(figure, RIGHT, 0.5 * A4[1], title, (0.0, *places), rows, MOST_NEXT + 1)
    remarks = [*c.remarks, *c.fit.remarks][:MOST_REMARKS]
    lines = [textwrap.fill(f"! {text}", 100, subsequent_indent="  ") for text in remarks]
    write_at(figure, RIGHT, low, "\n".join(lines), size=5.6)
    return figure


def _table(figure: Figure, x: float, top: float, columns: Sequence[float], rows: Sequence[Sequence[str]]) -> float:
    """Rows of text below `top`, mm; returns the height below them."""
    for k, row in enumerate(rows):
        for place, text in zip(columns, row, strict=False):
            write_at(figure, x + place, top - ROW * k, text, size=6.5)
    return top - ROW * len(rows)


def _section(
    figure: Figure,
    x: float,
    top: float,
    heading: str,
    columns: Sequence[float],
    rows: Sequence[Sequence[str]],
    most: int,
) -> float:
    """A heading and its table, of at most so many rows; returns the height below."""
    write_at(figure, x, top, heading, weight="bold")
    shown = [*rows[:most], *([(f"and {len(rows) - most} more: see report.json",)] if len(rows) > most else [])]
    return _table(figure, x, top - 1.2 * ROW, columns, shown) - 0.5 * ROW


def _draw_errors(axes: Axes, c: Commissioning) -> None:
    """Distribution of the errors: as drawn, and held out of the calibration."""
    before, held = c.fit.before.errors, c.fit.held_out_errors
    for errors, label, colour in ((before, "as drawn", "#D55E00"), (held, "calibrated, held out", "#0072B2")):
        if errors is None:
            continue
        ordered = np.sort(errors[np.isfinite(errors)]) * TO_MM
        axes.plot(ordered, np.linspace(0, 100, len(ordered)), color=colour, label=label)
    axes.set(xlabel="tip error (mm)", ylabel="rows below (%)", ylim=(0, 100))
    axes.set_xlim(left=0)
    axes.grid()
    axes.legend(loc="lower right")
