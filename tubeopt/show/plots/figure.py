"""A figure that a notebook shows as it is, without any word to switch that on.

The one module that loads Matplotlib when it is imported: `new_figure` imports it when the first picture is made.
"""

from __future__ import annotations

import io
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

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
        self.savefig(out, format="png", dpi=SCREEN_DPI, metadata={"Software": None})
        return out.getvalue()
