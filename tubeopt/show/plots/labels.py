"""Labels of panels: names next to points and above panels, arrows, and legends.

Names beside points are moved off one another by `texts.separate`.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from .style import FAINT, INK, Axes

if TYPE_CHECKING:
    from matplotlib.text import Annotation


def note(
    axes: Axes,
    text: str,
    at: ArrayLike,
    shift: ArrayLike,
    *,
    size: float = 8,
    rotation: float = 0,
    colour: str = INK,
    level: bool = False,
) -> Annotation:
    """Annotation at an offset of `shift` (2,) points from the point `at` (2,); `separate` may move it.

    level: the middle of the text is `shift` off the point, instead of its lower or upper edge.
    """
    (x, y), (across, up) = np.asarray(at, dtype=float).tolist(), np.asarray(shift, dtype=float).tolist()
    horizontal = "left" if across > 2 else "right" if across < -2 else "center"
    vertical = "center" if level or abs(across) > 2 * abs(up) else "bottom" if up > 0 else "top"
    return axes.annotate(
        text,
        (x, y),
        (across, up),
        textcoords="offset points",
        ha=horizontal,
        va=vertical,
        fontsize=size,
        rotation=rotation,
        color=colour,
        annotation_clip=False,
        zorder=6,
    )


def arrow(
    axes: Axes,
    start: ArrayLike,
    end: ArrayLike,
    colour: str,
    *,
    width: float = 1.0,
    head: float = 10,
    margins: tuple[float, float] = (0, 0),
    zorder: float = 4,
) -> None:
    """Draw an arrow between two points (2,) in the units of a panel.

    Args:
        width: of its line, points.   head: size of its head, points.
        margins: distances to keep from start and end, points.
    """
    style = {"arrowstyle": "-|>", "color": colour, "lw": width, "mutation_scale": head}
    style |= {"shrinkA": margins[0], "shrinkB": margins[1]}
    (x, y), tail = np.asarray(end, dtype=float).tolist(), np.asarray(start, dtype=float).tolist()
    axes.annotate("", (x, y), (tail[0], tail[1]), arrowprops=style, zorder=zorder)


ROW = 9
"""Height of a line of names above a panel, points."""

LETTER = 4.2
"""Mean width of a letter of 7 points: rows of names are chosen before the layout knows widths, points."""


def rules_at(panels: Iterable[Axes], positions: Iterable[float]) -> None:
    """Draw thin dashed lines across panels."""
    for axes, x in itertools.product(panels, positions):
        axes.axvline(x, color=FAINT, lw=0.6, ls=(0, (4, 3)), zorder=0)


def names_above(axes: Axes, names: Mapping[float, str], *, panel_width: float) -> int:
    """Number of rows of names above a panel: each name is at its x, in the lowest free row.

    Args:
        names: x in the units of the panel, whose limits are set -> name, of one line or of several.
        panel_width: expected width of the panel, in.
    """
    low, high = axes.get_xlim()
    row_ends: list[float] = []
    for x, text in sorted(names.items()):
        lines = text.split("\n")
        half = LETTER * (max(map(len, lines)) + 1) / 2
        middle = 72 * panel_width * (x - low) / (high - low)
        row = next((k for k, end in enumerate(row_ends) if middle - half > end), len(row_ends))
        row_ends[row : row + 1] = [middle + half]
        where: dict[str, Any] = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
        look: dict[str, Any] = {"fontsize": 7, "color": FAINT, "ha": "center", "va": "bottom"}
        axes.annotate(text, (x, 1), (0, 2 + ROW * len(lines) * row), **where, **look)
    return len(row_ends)


def legend_beside(axes: Axes, *entries: Any) -> None:
    """Legend to the right of a panel: of its own artists, or of entries (handles, names)."""
    axes.legend(*entries, loc="upper left", bbox_to_anchor=(1.0, 1.0), handlelength=1.2)


def legend_above(axes: Axes, columns: int, **look: Any) -> None:
    """Legend above a panel, where it hides no curve."""
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, borderaxespad=0.1, **look)
