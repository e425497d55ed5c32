"""Width, title and colours of pictures."""

from __future__ import annotations

from contextvars import ContextVar

import numpy as np

WIDTH: ContextVar[float | None] = ContextVar("WIDTH", default=None)
"""Of pictures, m, where they are to be laid out anew for a page; letters keep their size. None leaves each as it is."""

TITLED: ContextVar[bool] = ContextVar("TITLED", default=True)
"""Whether pictures have a heading; a paper has a caption below."""

HEADINGS: ContextVar[list[str] | None] = ContextVar("HEADINGS", default=None)
"""Where pictures without a heading leave it, for their captions."""

FONTS: ContextVar[tuple[str, ...]] = ContextVar("FONTS", default=())
"""Families of letters, the best first; of those that are not installed the next is taken."""

SCALE = "scale"
"""`gid` of the numbers along the edges of a scene, of which some may be left out."""


Colour = tuple[int, int, int]
"""Red, green and blue from 0 to 255."""

TUBE_COLOURS = ("#D55E00", "#009E73", "#0072B2", "#E69F00", "#CC79A7", "#56B4E9")
"""Tubes, inner to outer; from the palette of Okabe and Ito (2008), told apart with any kind of colour vision."""


def tube_colour(index: int) -> str:
    """Colour of the tube with this index (0 is the innermost), as #RRGGBB."""
    # From the seventh tube on colours repeat.
    return TUBE_COLOURS[index % len(TUBE_COLOURS)]


def rgb(colour: str) -> Colour:
    """#RRGGBB as three numbers from 0 to 255."""
    red, green, blue = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
    return red, green, blue


def margin_colour(margin: float) -> Colour:
    """Green at margin 1, yellow in between, red at 0 and below."""
    stops = (200, 235, 0), (30, 190, 150), (30, 40, 90)
    red, green, blue = (round(float(np.interp(margin, (0.0, 0.5, 1.0), each))) for each in stops)
    return red, green, blue
