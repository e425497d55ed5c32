"""A figure that a notebook shows as it is, without any word to switch that on.

The one module that loads Matplotlib when it is imported: `new_figure` imports it when the first picture is made.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec

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
        with nullcontext() if self.stale else as_it_stands(self):
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
    if len(grids) != 1 or figure.artists:
        return
    (grid,) = grids.values()
    ratios, rows = (np.asarray(each, dtype=float) for each in (grid.get_width_ratios(), grid.get_height_ratios()))
    widths = (ratios / ratios.sum()).tolist()
    if len(widths) < 2 or min(widths) < SLIM or any(len(spec.colspan) > 1 for _, spec in panels):
        return
    width = float(figure.get_figwidth())
    counts = [sum(spec.colspan.start == k for _, spec in panels) for k in range(len(widths))]
    heights = [
        min(figure.drawn_for[1] * min(1.0, width / (share * figure.drawn_for[0])), count * TALL * width)
        for share, count in zip(widths, counts, strict=True)
    ]
    stacked = figure.add_gridspec(
        len(rows) * len(widths), 1, height_ratios=np.outer(heights, rows / rows.sum()).ravel().tolist()
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
