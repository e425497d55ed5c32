"""Figures that draw into memory, and the data that they show."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PathCollection, QuadMesh
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from ...typing import Array

SCREEN_DPI = 100


class NotebookFigure(Figure):
    """A Matplotlib figure that needs no window and that notebooks can show.

    drawn_for: width and height, in, for which its panels were laid out; a page may want others.
    """

    def __init__(self, *args: Any, drawn_for: tuple[float, float], **options: Any) -> None:
        super().__init__(*args, **options)
        self.drawn_for = drawn_for
        FigureCanvasAgg(self)

    def _repr_png_(self) -> bytes:
        out = io.BytesIO()
        # A figure that was changed since (stale) needs its layout engine again.
        with nullcontext() if self.stale else without_layout(self):
            # Without the version of Matplotlib the same data give the same bytes.
            self.savefig(out, format="png", dpi=SCREEN_DPI, metadata={"Software": None})
        return out.getvalue()


@contextmanager
def without_layout(figure: Figure) -> Iterator[None]:
    """Suspend the layout engine of a figure that is laid out: even an idle engine makes it draw twice."""
    engine = figure.get_layout_engine()
    figure.set_layout_engine(None)
    try:
        yield
    finally:
        figure.set_layout_engine(engine)


class DrawnPoint(NamedTuple):
    """A point of a panel with scales, in the units of the panel."""

    panel: str
    curve: str
    x: float
    y: float
    value: float | str
    """Value of a colour, or the length of a bar; "" without any."""


def drawn_data(figure: Any) -> Iterator[DrawnPoint]:
    """Points that the panels with scales show."""
    for axes in figure.axes:
        if not axes.axison or axes.name != "rectilinear" or axes.get_label() == "<colorbar>":
            continue
        panel = _cell(f"{axes.get_ylabel()} over {axes.get_xlabel()}")
        bars = [bar for container in axes.containers for bar in getattr(container, "patches", ())]
        for artist in (*axes.lines, *axes.collections, *axes.images, *bars):
            label = str(artist.get_label())
            curve = "" if label.startswith("_") else _cell(label)
            if artist.get_visible():
                yield from (DrawnPoint(panel, curve, x, y, value) for x, y, value in _points(axes, artist).tolist())


def _cell(text: str) -> str:
    """Text of a table cell, on one line and without the separator."""
    return re.sub(r"\s+", " ", text.replace(",", ";")).strip()


def _points(axes: Axes, artist: Any) -> Any:
    """(N, 3) points (x, y, value) of a line, points, a mesh, an image or a bar; none of other artists."""
    points: Any
    values: Any = None
    # Rules such as axvline have one coordinate in fractions of the panel: they are no data.
    if isinstance(artist, Line2D) and artist.get_transform() is axes.transData:
        points = artist.get_xydata()
    elif isinstance(artist, PathCollection):
        points, values = artist.get_offsets(), artist.get_array()
    # A mesh has corners of its cells; a value belongs to the middle of its four.
    elif isinstance(artist, QuadMesh):
        corners: Any = artist.get_coordinates()
        points = (corners[:-1, :-1] + corners[1:, :-1] + corners[:-1, 1:] + corners[1:, 1:]) / 4
        values = artist.get_array()
    elif isinstance(artist, AxesImage) and np.ndim(np.asarray(artist.get_array())) == 2:
        values = artist.get_array()
        left, right, bottom, top = artist.get_extent()
        # Row 0 of an image is its lowest or its uppermost, by `origin`.
        low, high = (bottom, top) if artist.origin == "lower" else (top, bottom)
        rows, columns = np.shape(values)
        across, up = (np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows
        points = np.stack(np.meshgrid(left + (right - left) * across, low + (high - low) * up), axis=-1)
    elif isinstance(artist, Rectangle):
        width, height = artist.get_width(), artist.get_height()
        points = [artist.get_x() + width / 2, artist.get_y() + height / 2]
        values = [width if artist.get_x() == 0 else height]  # a horizontal bar begins at the scale
    else:
        return np.empty((0, 3), dtype=object)
    points_mm: Array = np.ma.filled(np.ma.asarray(points, dtype=float), np.nan).reshape(-1, 2)
    if values is None:
        return np.column_stack([points_mm.astype(object), np.full(len(points_mm), "", dtype=object)])
    numbers: Array = np.ma.filled(np.ma.asarray(values, dtype=float), np.nan).ravel()
    # Masked cells of a map are NaN, and have no row.
    return np.column_stack([points_mm, numbers])[np.isfinite(numbers)]
