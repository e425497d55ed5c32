"""A figure that notebooks show, its texts kept apart and on the page, and its values as rows of a table."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.text import Annotation, Text
from matplotlib.transforms import Bbox

from ...typing import Array
from ..page import SCALE

SCREEN_DPI = 100


class NotebookFigure(Figure):
    """A Matplotlib figure that draws into memory, and that notebooks know how to show.

    drawn_for: width and height, in, that its panels were laid out for; a page may want another.
    """

    def __init__(self, *args: Any, drawn_for: tuple[float, float], **options: Any) -> None:
        super().__init__(*args, **options)
        self.drawn_for = drawn_for
        FigureCanvasAgg(self)

    def _repr_png_(self) -> bytes:
        out = io.BytesIO()
        # A figure that was changed since (stale) needs its layout engine again.
        with nullcontext() if self.stale else as_it_stands(self):
            # Without the version of Matplotlib the same data give the same bytes.
            self.savefig(out, format="png", dpi=SCREEN_DPI, metadata={"Software": None})
        return out.getvalue()


@contextmanager
def as_it_stands(figure: Figure) -> Iterator[None]:
    """A figure that is laid out already: with a layout engine, even an idle one, it would be drawn twice."""
    engine = figure.get_layout_engine()
    figure.set_layout_engine(None)
    try:
        yield
    finally:
        figure.set_layout_engine(engine)


TALL = 0.85
"""Height of a single panel over its width, at most."""

SLIM = 0.12
"""Part of the width of a figure below which a column is that of a scale of colours, which stays where it is."""


def stack(figure: NotebookFigure) -> None:
    """Put the columns of a figure one below the other, each as high as its panels need at the width that they get.

    What is drawn across panels keeps them where they are.
    """
    panels = [(axes, spec) for axes in figure.axes if (spec := axes.get_subplotspec()) is not None]
    grids = {id(grid): grid for _, spec in panels if isinstance(grid := spec.get_gridspec(), GridSpec)}
    # Panels of several grids, or arrows across panels, have places that stacking would break.
    if len(grids) != 1 or figure.artists:
        return
    (grid,) = grids.values()
    ratios, rows = (np.asarray(each, dtype=float) for each in (grid.get_width_ratios(), grid.get_height_ratios()))
    widths = (ratios / ratios.sum()).tolist()
    # A panel across several columns cannot be in one of them.
    if len(widths) < 2 or min(widths) < SLIM or any(len(spec.colspan) > 1 for _, spec in panels):
        return
    width = float(figure.get_figwidth())
    counts = [sum(spec.colspan.start == k for _, spec in panels) for k in range(len(widths))]
    heights = [
        # A panel that gets wider keeps its height; one that gets narrower keeps its shape.
        min(figure.drawn_for[1] * min(1.0, width / (share * figure.drawn_for[0])), count * TALL * width)
        for share, count in zip(widths, counts, strict=True)
    ]
    stacked = figure.add_gridspec(
        # Each column keeps the proportions of its rows.
        len(rows) * len(widths),
        1,
        height_ratios=np.outer(heights, rows / rows.sum()).ravel().tolist(),
    )
    for axes, spec in panels:
        first = len(rows) * spec.colspan.start
        axes.set_subplotspec(stacked[first + spec.rowspan.start : first + spec.rowspan.stop, 0])
        _tell_own_scale(axes, panels[0][0])
    figure.set_figheight(sum(heights))


def _tell_own_scale(axes: Axes, beside: Axes) -> None:
    """Give a panel numbers and a name of its vertical axis of its own, where it was beside one that had them."""
    if axes is not beside and axes.get_shared_y_axes().joined(axes, beside) and not axes.get_ylabel():
        axes.tick_params(labelleft=True)
        axes.set_ylabel(beside.get_ylabel())


SLACK = (1.0, 1.5)
"""Points by which two texts may overlap across and upwards: letters fill less than the box of their text."""

TALLEST = 1.2
"""Height of a picture for a page, over its width, at most."""

STEPS = 5
"""How far a name is moved off another text, in lines."""

ROUNDS = 3
"""How often texts are moved and looked through again."""


@dataclass(frozen=True)
class Fault:
    """A text that overlaps another, or leaves the page, or a page that is too high."""

    kind: str
    """"overlap", "clipped" or "high"."""
    text: str
    other: str = ""

    def __str__(self) -> str:
        """In words."""
        return f"{self.kind}: {self.text!r}" + (f" and {self.other!r}" if self.other else "")


def faults(figure: Figure) -> list[Fault]:
    """What is wrong with the texts of a figure that is laid out."""
    figure.draw_without_rendering()  # legends and the labels of ticks take their places when they are drawn
    width, height = figure.get_size_inches()
    found = [Fault("high", f"{height / width:.2f} widths")] if height > TALLEST * width + 1e-6 else []
    texts = [(text, text.get_window_extent()) for text, _ in drawn_texts(figure)]
    # Half a point: anti-aliased edges of letters may touch the border.
    page = figure.bbox.padded(_points(figure, 0.5))
    found += [
        Fault("clipped", text.get_text())
        for text, box in texts
        if not (page.x0 <= box.x0 and box.x1 <= page.x1 and page.y0 <= box.y0 and box.y1 <= page.y1)
    ]
    for k, (text, box) in enumerate(texts):
        found += [
            Fault("overlap", text.get_text(), one.get_text()) for one, its in texts[:k] if _overlap(figure, box, its)
        ]
    return found


def relieve(figure: Figure) -> None:
    """Move names off other texts, thin out the numbers of scales, and hide those that still overlap another text."""
    for _ in range(ROUNDS):
        figure.draw_without_rendering()
        texts = [(text, axis, text.get_window_extent()) for text, axis in drawn_texts(figure)]
        pairs = [
            (texts[j], texts[k])
            for k in range(len(texts))
            for j in range(k)
            if _overlap(figure, texts[j][2], texts[k][2])
        ]
        if not pairs:
            return
        # Numbers of one scale that overlap each other: hiding every other keeps the scale regular.
        crowded = {id(one[1]): one[1] for one, other in pairs if one[1] is not None and one[1] is other[1]}
        for axis in crowded.values():
            _thin(axis)
        # Shared by all moves of a round, so that two names do not move to the same place.
        boxes = [box for _, _, box in texts]
        for one, other in pairs:
            if one[1] is None or one[1] is not other[1]:
                _make_room(figure, one, other, boxes)


Placed = tuple[Text, Axis | None, Bbox]
"""A text, the axis whose tick it labels, and its box."""


def drawn_texts(figure: Figure) -> Iterator[tuple[Text, Axis | None]]:
    """Every text that is drawn, with the axis whose tick it labels."""
    for axes in figure.axes:
        if axes.get_visible():
            yield from ((text, axis) for text, axis in _of_axes(axes) if text.get_visible() and text.get_text().strip())
    loose = [*figure.texts, *(text for legend in figure.legends for text in (*legend.get_texts(), legend.get_title()))]
    yield from ((text, None) for text in loose if text.get_visible() and text.get_text().strip())


def _of_axes(axes: Axes) -> Iterator[tuple[Text, Axis | None]]:
    parts: list[Any] = axes.get_children()
    for part in parts:
        if isinstance(part, Text):
            yield part, None
        elif hasattr(part, "get_texts") and part.get_visible():  # a legend
            yield from ((text, None) for text in (*part.get_texts(), part.get_title()))
        elif hasattr(part, "get_celld") and part.get_visible():  # a table
            yield from ((cell.get_text(), None) for cell in part.get_celld().values())
    for axis in parts if axes.axison else ():
        if isinstance(axis, Axis) and axis.get_visible():
            yield axis.label, None
            yield axis.get_offset_text(), None
            # Matplotlib keeps labels of ticks outside of the view, which are not drawn.
            low, high = sorted(axis.get_view_interval())
            slack = 1e-9 * (high - low)
            for tick, at in zip(axis.get_major_ticks(), axis.get_majorticklocs(), strict=False):
                if low - slack <= at <= high + slack:
                    yield from ((label, axis) for label in (tick.label1, tick.label2))


def _points(figure: Figure, points: float) -> float:
    return points * figure.dpi / 72


def _overlap(figure: Figure, one: Bbox, other: Bbox) -> bool:
    across = min(one.x1, other.x1) - max(one.x0, other.x0)
    upwards = min(one.y1, other.y1) - max(one.y0, other.y0)
    return bool(across > _points(figure, SLACK[0]) and upwards > _points(figure, SLACK[1]))


def _thin(axis: Axis) -> None:
    """Label every other tick of an axis whose labels overlap one another."""
    shown = [tick for tick in axis.get_major_ticks() if tick.label1.get_visible() or tick.label2.get_visible()]
    # From the second on: the first label is where a reader begins.
    for tick in shown[1::2]:
        tick.label1.set_visible(False)
        tick.label2.set_visible(False)


def clipped(figure: Figure) -> list[tuple[Text, float]]:
    """Level texts that leave the page to a side, and the width in pixels that each may have."""
    page = figure.bbox
    out = []
    for text, _ in drawn_texts(figure):
        box = text.get_window_extent()
        beyond = max(page.x0 - box.x0, 0.0) + max(box.x1 - page.x1, 0.0)
        if beyond > _points(figure, 0.5) and text.get_rotation() == 0:
            # 5 % less, as breaking at blanks rarely fills a line exactly.
            out.append((text, 0.95 * (box.width - beyond)))
    return out


def _make_room(figure: Figure, one: Placed, other: Placed, boxes: list[Bbox]) -> None:
    """Of two texts that overlap hide the number of a scale, or move a name."""
    for text, axis, _ in (other, one):
        # A reader can infer a number of a scale from its neighbours, but not a name.
        if axis is not None or text.get_gid() == SCALE:
            text.set_visible(False)
            return
    for text, _, box in (other, one):
        if isinstance(text, Annotation) and text.anncoords == "offset points" and _move(figure, text, box, boxes):
            return


def _move(figure: Figure, text: Annotation, box: Bbox, boxes: list[Bbox]) -> bool:
    """Whether a name was moved to where it overlaps nothing and stays on the page."""
    others = [each for each in boxes if each is not box]
    line: Any = text.get_fontsize()
    x, y = text.xyann  # points
    shifts = [(i, j) for i in range(-STEPS, STEPS + 1) for j in range(-STEPS, STEPS + 1) if i or j]
    # The nearest free place first: a name far from its point is read as that of another.
    for i, j in sorted(shifts, key=lambda at: float(np.hypot(*at))):
        there = box.translated(_points(figure, i * line), _points(figure, j * line))
        inside = figure.bbox.x0 <= there.x0 and there.x1 <= figure.bbox.x1
        inside &= bool(figure.bbox.y0 <= there.y0 and there.y1 <= figure.bbox.y1)
        if inside and not any(_overlap(figure, there, each) for each in others):
            text.xyann = (x + i * line, y + j * line)
            boxes[:] = [*others, there]
            return True
    return False


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
                yield from ((panel, curve, *row) for row in _drawn_points(axes, artist))


def _cell(words: str) -> str:
    """Words as a cell of a table: in one line, without its separator."""
    return re.sub(r"\s+", " ", words.replace(",", ";")).strip()


def _bars(axes: Any) -> Iterator[Any]:
    yield from (bar for bars in axes.containers for bar in getattr(bars, "patches", ()))


def _drawn_points(axes: Any, artist: Any) -> Iterator[tuple[float, float, float | str]]:
    """x, y and value of a line, points, a mesh, an image or a bar; nothing of what is placed by other than its data."""
    from matplotlib.collections import PathCollection, QuadMesh
    from matplotlib.image import AxesImage
    from matplotlib.lines import Line2D
    from matplotlib.patches import Rectangle

    found: Any = artist  # what Matplotlib says of its arrays is too wide
    places: Any
    values: Any = None
    # Rules such as axvline have one coordinate in parts of the panel: they are no data.
    if isinstance(artist, Line2D) and artist.get_transform() is axes.transData:
        places = found.get_xydata()
    elif isinstance(artist, PathCollection):
        places, values = found.get_offsets(), found.get_array()
    # A mesh has corners of its cells; a value belongs to the middle of its four.
    elif isinstance(artist, QuadMesh):
        corners = found.get_coordinates()
        places = (corners[:-1, :-1] + corners[1:, :-1] + corners[:-1, 1:] + corners[1:, 1:]) / 4
        values = found.get_array()
    elif isinstance(artist, AxesImage) and np.ndim(found.get_array()) == 2:
        values = found.get_array()
        left, right, bottom, top = found.get_extent()
        # Row 0 of an image is its lowest or its uppermost, by `origin`.
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
    # Masked cells of a map are NaN here, and have no row.
    kept = np.isfinite(told)
    yield from ((x, y, value) for (x, y), value in zip(points[kept].tolist(), told[kept].tolist(), strict=True))
