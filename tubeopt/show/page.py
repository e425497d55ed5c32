"""Settings common to all pictures: width, headings, fonts and colours."""

from __future__ import annotations

from contextvars import ContextVar

import numpy as np

WIDTH: ContextVar[float | None] = ContextVar("WIDTH", default=None)
"""Width of pictures for a page, m; letters keep their size. None: every picture has its own width."""

NARROW = 0.12
"""Width of a picture, m, below which it is laid out for a column, with half as many rules on its scales."""


def narrow() -> bool:
    """True if pictures are laid out for a journal column."""
    width = WIDTH.get()
    return width is not None and width < NARROW


TITLED: ContextVar[bool] = ContextVar("TITLED", default=True)
"""True: pictures have headings. A paper has captions instead."""

HEADINGS: ContextVar[list[str] | None] = ContextVar("HEADINGS", default=None)
"""List that collects the headings of pictures drawn without them, for captions; None: not collected."""

FONTS: ContextVar[tuple[str, ...]] = ContextVar("FONTS", default=())
"""Font families in order of preference; those not installed are skipped."""

SCALE = "scale"
"""`gid` of the numbers along the edges of a scene; some of them may be hidden."""

INK = "#222222"
FAINT = "#8A8A8A"


Colour = tuple[int, int, int]
"""Red, green and blue, 0 to 255."""

TUBE_COLOURS = ("#D55E00", "#009E73", "#0072B2", "#E69F00", "#CC79A7", "#56B4E9")
"""Colours of tubes, inner to outer, distinct for every kind of colour vision (Okabe and Ito, 2008)."""


def tube_colour(index: int) -> str:
    """Colour #RRGGBB of a tube; index 0 is the innermost."""
    # From the seventh tube on colours repeat.
    return TUBE_COLOURS[index % len(TUBE_COLOURS)]


def rgb(colour: str) -> Colour:
    """Red, green and blue (0 to 255) of a colour #RRGGBB."""
    red, green, blue = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
    return red, green, blue


def margin_colour(margin: float) -> Colour:
    """Green at margin 1, yellow in between, red at 0 and below."""
    stops = (200, 235, 0), (30, 190, 150), (30, 40, 90)
    red, green, blue = (round(float(np.interp(margin, (0.0, 0.5, 1.0), each))) for each in stops)
    return red, green, blue
