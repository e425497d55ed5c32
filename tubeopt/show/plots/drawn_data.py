"""Values that a picture shows, as rows of a table."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from ...typing import Array


def drawn_data(figure: Any) -> Iterator[tuple[str, str, float, float, float | str]]:
    """Rows of what the panels with scales show, in their units: panel, curve, x, y, and the value of a colour."""
    for axes in figure.axes:
        if not axes.axison or axes.name != "rectilinear" or axes.get_label() == "<colorbar>":
            continue
        panel = _cell(f"{axes.get_ylabel()} over {axes.get_xlabel()}")
        for artist in (*axes.lines, *axes.collections, *axes.images, *_bars(axes)):
            label = str(artist.get_label())
            curve = "" if label.startswith("_") else _cell(label)
            if artist.get_visible():
                yield from ((panel, curve, *row) for row in _points(axes, artist))


def _cell(words: str) -> str:
    """Words as a cell of a table: in one line, without its separator."""
    return re.sub(r"\s+", " ", words.replace(",", ";")).strip()


def _bars(axes: Any) -> Iterator[Any]:
    yield from (bar for bars in axes.containers for bar in getattr(bars, "patches", ()))


def _points(axes: Any, artist: Any) -> Iterator[tuple[float, float, float | str]]:
    """x, y and value of a line, points, a mesh, an image or a bar; nothing of what is placed by other than its data."""
    from matplotlib.collections import PathCollection, QuadMesh
    from matplotlib.image import AxesImage
    from matplotlib.lines import Line2D
    from matplotlib.patches import Rectangle

    found: Any = artist  # what Matplotlib says of its arrays is too wide
    places: Any
    values: Any = None
    if isinstance(artist, Line2D) and artist.get_transform() is axes.transData:
        places = found.get_xydata()
    elif isinstance(artist, PathCollection):
        places, values = found.get_offsets(), found.get_array()
    elif isinstance(artist, QuadMesh):
        corners = found.get_coordinates()
        places = (corners[:-1, :-1] + corners[1:, :-1] + corners[:-1, 1:] + corners[1:, 1:]) / 4
        values = found.get_array()
    elif isinstance(artist, AxesImage) and np.ndim(found.get_array()) == 2:
        values = found.get_array()
        left, right, bottom, top = found.get_extent()
        low, high = (bottom, top) if found.origin == "lower" else (top, bottom)
        rows, columns = values.shape
        across, up = (np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows
        places = np.stack(np.meshgrid(left + (right - left) * across, low + (high - low) * up), axis=-1)
    elif isinstance(artist, Rectangle):
        width, height = found.get_width(), found.get_height()
        places = [found.get_x() + width / 2, found.get_y() + height / 2]
        values = [width if found.get_x() == 0 else height]  # a bar that lies begins at the scale
    else:
        return
    points: Array = np.ma.filled(np.ma.asarray(places, dtype=float), np.nan).reshape(-1, 2)
    if values is None:
        yield from ((x, y, "") for x, y in points.tolist())
        return
    told: Array = np.ma.filled(np.ma.asarray(values, dtype=float), np.nan).ravel()
    kept = np.isfinite(told)
    yield from ((x, y, value) for (x, y), value in zip(points[kept].tolist(), told[kept].tolist(), strict=True))
