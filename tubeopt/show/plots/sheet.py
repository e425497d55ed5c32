"""Sheets for the workshop: one page A4 of drawings, numbers and steps; places in mm from its lower left corner."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from ..page import WIDTH
from .style import Figure, new_figure

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
