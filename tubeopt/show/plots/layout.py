"""Layout of a picture: panels, legends and headings for the width of a page, without texts that overlap."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.legend import Legend
from matplotlib.text import Annotation, Text
from matplotlib.transforms import Bbox

from ...typing import Array
from ..page import WIDTH, narrow
from .figure import NotebookFigure
from .texts import MAX_ASPECT, crowded, faults, separate, too_wide

MAX_PASSES = 3
"""Passes of the layout engine, at most: axes of equal aspect change their size with their position."""

STILL = 1e-3
"""Largest move of a panel, over the size of the picture, after which no further pass is made."""

ATTEMPTS = tuple((letters, stacked) for letters in (1.0, 0.8, 0.65, 0.5, 0.4) for stacked in (True, False))
"""Attempts to fit a page: size of the letters, and True for columns below each other."""

# Below 0.25 of the page panels look lost between their texts. Panels of fixed aspect, such as tall scenes, stop
# growing at about 0.18; letters are then made smaller only for a gain of 10 %.
ROOMY = 0.25
"""Fraction of a page filled by panels above which smaller letters are not tried."""

FAIR, GAIN = 0.18, 1.1
"""Fraction that suffices where smaller letters do not let panels grow by this factor."""


def finish(figure: Figure) -> None:
    """Lay a figure out for the width of the page, or for its own width."""
    if WIDTH.get() is not None:
        arrange(figure, stacked=narrow())
    else:
        _settle(figure)
        if crowded(figure):
            separate(figure)


def fitted(draw: Callable[[], Figure]) -> Figure:
    """Figure laid out for the page, drawn anew with smaller letters until no text overlaps another or is clipped.

    Smaller letters are tried too while panels fill less than `ROOMY` of the page. Where no attempt is free of faults,
    the one with the fewest faults and the largest panels is returned. A figure without layout engine keeps its size.
    """
    best: tuple[tuple[int, float], Figure] | None = None
    for letters, stacked in ATTEMPTS:
        # On a wide page columns have space side by side; stacking is tried only once letters are small.
        if stacked and not narrow() and letters > 0.7:
            continue
        figure = draw()
        if figure.get_layout_engine() is None:  # its panels have positions of their own
            return figure
        if not arrange(figure, stacked=stacked, letters=letters):
            continue
        filled = sum(float(np.prod(axes.get_position().size)) for axes in figure.axes)
        # Readable texts come first, then the size of panels, which counts no more beyond ROOMY.
        merit = len(faults(figure)), -min(filled, ROOMY)
        if best is not None and best[0][0] == 0 and -best[0][1] > FAIR and merit[1] > GAIN * best[0][1]:
            break  # panels of fixed aspect do not grow with smaller letters
        if best is None or merit < best[0]:
            best = merit, figure
        if merit == (0, -ROOMY):
            break
    if best is not None:
        return best[1]
    figure = draw()
    arrange(figure, stacked=narrow(), letters=ATTEMPTS[-1][0])
    figure.set_layout_engine("none")
    return figure


def arrange(figure: Figure, *, stacked: bool, letters: float = 1.0) -> bool:
    """Lay a figure out for the page; False where its panels have no space left.

    stacked: columns stand below each other.   letters: factor on the size of all letters.
    """
    if stacked and isinstance(figure, NotebookFigure):
        _stack(figure)
    width, height = figure.get_size_inches()
    figure.set_figheight(min(height, MAX_ASPECT * width))
    _fix_tick_sizes(figure)
    if letters != 1.0:
        _scale_letters(figure, letters)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # before texts are broken, panels may have no space
        _break_headings_and_legends(figure)
        _run_engine(figure)
        _break_axis_labels(figure)
        _settle(figure)
        separate(figure)
        if clipped := list(too_wide(figure)):
            for text, width in clipped:
                _break_lines(text, width)
            _run_engine(figure)
            separate(figure)
        # Matplotlib reports panels without space only by this warning.
        warnings.simplefilter("error", UserWarning)
        try:
            figure.draw_without_rendering()
        except UserWarning:
            return False
    figure.set_layout_engine("none")  # what was measured stays where it is
    return True


MAX_PANEL_ASPECT = 0.85
"""Largest height of a single panel over its width."""

SLIM = 0.12
"""Largest fraction of the width of a column that is a scale of colours, and that stays next to its panel."""


def _stack(figure: NotebookFigure) -> None:
    """Put the columns of a figure below each other, each as high as its panels need at their new width."""
    panels = [(axes, spec) for axes in figure.axes if (spec := axes.get_subplotspec()) is not None]
    grids = {id(grid): grid for _, spec in panels if isinstance(grid := spec.get_gridspec(), GridSpec)}
    # Panels of several grids, or arrows across panels, have positions that stacking would break.
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
        min(figure.drawn_for[1] * min(1.0, width / (part * figure.drawn_for[0])), count * MAX_PANEL_ASPECT * width)
        for part, count in zip(widths, counts, strict=True)
    ]
    stacked = figure.add_gridspec(
        # Each column keeps the proportions of its rows.
        len(rows) * len(widths),
        1,
        height_ratios=np.outer(heights, rows / rows.sum()).ravel().tolist(),
    )
    first_panel = panels[0][0]
    for axes, spec in panels:
        first = len(rows) * spec.colspan.start
        axes.set_subplotspec(stacked[first + spec.rowspan.start : first + spec.rowspan.stop, 0])
        # Panels that shared the vertical axis of a neighbour need numbers and a name of their own.
        shared = axes is not first_panel and axes.get_shared_y_axes().joined(axes, first_panel)
        if shared and not axes.get_ylabel():
            axes.tick_params(labelleft=True)
            axes.set_ylabel(first_panel.get_ylabel())
    figure.set_figheight(sum(heights))


def _settle(figure: Figure) -> None:
    """Lay a figure out, and move legends off the data."""
    _run_engine(figure)
    moved = [_uncover(axes) for axes in figure.axes]
    if any(moved):
        _run_engine(figure)


def _run_engine(figure: Figure) -> None:
    """Run the layout engine until the panels stop moving."""
    engine = figure.get_layout_engine()
    if engine is None:
        return
    positions = _positions(figure)
    # Each pass places panels by sizes of the last one; panels of equal aspect change their size with their position.
    for _ in range(MAX_PASSES):
        engine.execute(figure)
        before, positions = positions, _positions(figure)
        if np.abs(positions - before).max(initial=0.0) < STILL:
            break


def _positions(figure: Figure) -> Array:
    """(A, 4) left, bottom, width and height of the panels, as fractions of the figure."""
    return np.array([axes.get_position(original=True).bounds for axes in figure.axes]).reshape(-1, 4)


def _scale_letters(figure: Figure, scale: float) -> None:
    """Scale all letters, and with them ticks, legends and the distances between texts and panels."""
    for each in figure.findobj(Text):
        text: Any = each
        text.set_fontsize(scale * text.get_fontsize())
        if isinstance(text, Annotation) and text.anncoords == "offset points":
            text.xyann = (scale * text.xyann[0], scale * text.xyann[1])
    _fix_tick_sizes(figure)
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            axis.labelpad *= scale
            first: Any = next(iter(axis.get_major_ticks(1)))
            axis.set_tick_params(length=scale * first.tick1line.get_markersize(), pad=scale * first.get_pad())
        if axes.get_legend() is not None:
            _legend_again(axes)
    # Distances of the layout are in inches and do not follow the letters.
    engine: Any = figure.get_layout_engine()
    engine.set(**{name: scale * pad for name, pad in engine.get().items() if name in ("w_pad", "h_pad")})


def _fix_tick_sizes(figure: Figure) -> None:
    """Keep the size of tick labels for ticks that are made later, perhaps with other settings of Matplotlib."""
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            labels = axis.get_ticklabels()
            if labels:
                axis.set_tick_params(labelsize=labels[0].get_fontsize())


def _legend_again(axes: Axes, **changes: Any) -> Legend:
    """The legend of a panel, made again for the size of its letters, with some properties changed."""
    legend: Any = axes.get_legend()
    texts, title = legend.get_texts(), legend.get_title()
    look: dict[str, Any] = {
        "ncols": legend._ncols,  # noqa: SLF001
        "loc": legend._loc,  # noqa: SLF001
        # The anchor is known in pixels, and a new legend takes fractions of the panel.
        "bbox_to_anchor": legend.get_bbox_to_anchor().transformed(axes.transAxes.inverted()).bounds,
        "borderaxespad": legend.borderaxespad,
        "columnspacing": legend.columnspacing,
        "handlelength": min(legend.handlelength, 1.4),
        "title": title.get_text() or None,
        "title_fontsize": title.get_fontsize(),
    }
    if texts:
        look["fontsize"] = texts[0].get_fontsize()
    return axes.legend(legend.legend_handles, [text.get_text() for text in texts], **look | changes)


def _uncover(axes: Axes) -> bool:
    """Move the legend of a panel off its data: above the panel, or next to it below a title.

    False where it covers nothing.
    """
    legend = axes.get_legend()
    if legend is None or not legend.get_texts() or axes.name == "3d":
        return False
    box = legend.get_window_extent()
    if not any(_drawn_in(artist, box) for artist in (*axes.lines, *axes.collections, *axes.texts)):
        return False
    if axes.get_title() or axes.get_title("left"):
        _legend_again(axes, loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return True
    n_columns: Any = legend._ncols  # type: ignore[attr-defined]  # noqa: SLF001
    # As many columns as the panel is wide: above it, every row of a legend costs height.
    columns = int(np.clip(axes.bbox.width / box.width * n_columns, 1, len(legend.get_texts())))
    where: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.1}
    _legend_again(axes, ncols=columns, **where)
    return True


SHADE = 0.4
"""Largest opacity of a shaded surface; a legend on it is readable."""


def _drawn_in(artist: Any, box: Bbox) -> bool:
    """True if a line, points, a text or an opaque surface lies partly in a box of pixels."""
    if not artist.get_visible():
        return False
    if isinstance(artist, Text):
        return bool(artist.get_text() and artist.get_window_extent().overlaps(box))
    if hasattr(artist, "get_xydata"):
        # A line may cross the legend without a point of it inside.
        line = artist.get_transform().transform_path(artist.get_path())
        if artist.get_linestyle() not in ("None", "", " ") and line.intersects_bbox(box, filled=False):
            return True
        marked = artist.get_marker() not in ("None", "", " ", None)
        return bool(marked and box.count_contains(line.vertices) > 0)
    # Shades such as bands of uncertainty may lie below a legend.
    if artist.get_alpha() is not None and np.max(artist.get_alpha()) <= SHADE:
        return False
    if len(artist.get_offsets()) > 1:
        return bool(box.count_contains(artist.get_offset_transform().transform(artist.get_offsets())) > 0)
    paths = [artist.get_transform().transform_path(path) for path in artist.get_paths()]
    return any(len(path.vertices) and path.intersects_bbox(box, filled=True) for path in paths)


def _break_headings_and_legends(figure: Figure) -> None:
    """Break headings into lines, and give legends fewer columns, where they are wider than the page or their panel."""
    figure.draw_without_rendering()
    # The heading begins at 2 % of the width, and as much is left at its end.
    page_width = figure.bbox.width * 0.96
    for heading in figure.texts:
        _break_lines(heading, page_width)
    for axes in figure.axes:
        spec = axes.get_subplotspec()
        # Titles of adjacent panels would overlap where each takes the whole width.
        columns = 1 if spec is None else spec.get_gridspec().ncols / len(spec.colspan)
        width = 0.85 * page_width / columns
        for title in (axes.title, axes._left_title):  # type: ignore[attr-defined]  # noqa: SLF001
            if title.get_text():
                _break_lines(title, width)
        legend = axes.get_legend()
        if legend is None or not legend.get_texts():
            continue
        n_columns: Any = legend._ncols  # type: ignore[attr-defined]  # noqa: SLF001
        legend_width = legend.get_window_extent().width
        if legend_width > width and n_columns > 1:
            legend = _legend_again(axes, ncols=max(int(n_columns * width / legend_width), 1), columnspacing=1.0)
        for text in legend.get_texts():
            _break_lines(text, 0.4 * width if n_columns == 1 else width)
    for legend in list(figure.legends):
        entries = [text.get_text() for text in legend.get_texts()]
        columns = int(len(entries) * page_width / legend.get_window_extent().width)
        if columns < len(entries):
            handles: Any = legend.legend_handles
            size = legend.get_texts()[0].get_fontsize()
            legend.remove()
            legend_below = figure.legend(
                handles, entries, loc="outside lower center", ncols=max(columns, 1), fontsize=size
            )
            for text in legend_below.get_texts():
                _break_lines(text, 0.85 * page_width)


def _break_axis_labels(figure: Figure) -> None:
    """Break names of axes that are longer than their axis."""
    for axes in figure.axes:
        spec = axes.get_subplotspec()
        box = axes.bbox if spec is None else spec.get_position(figure).transformed(figure.transFigure)
        for axis, length in ((axes.xaxis, box.width), (axes.yaxis, box.height)):
            if axes.axison and axis.label.get_text() and axes.name != "3d":
                _break_lines(axis.label, 0.9 * length, upright=axis is axes.yaxis)


def _break_lines(text: Text, width: float, *, upright: bool = False) -> None:
    """Break a text into lines of at most `width` pixels: between its statements where that suffices, else at blanks."""
    lines: list[str] = []
    for line in text.get_text().split("\n"):
        # Two blanks separate statements of a heading; the comma before a break is left out.
        first, *statements = re.split(r"(?<=:)  |(?<=,)  ", line)
        lines += _at_blanks(text, first, width, upright=upright)
        for statement in statements:
            joined = f"{lines[-1]}  {statement}"
            if _length(text, joined, upright=upright) < width:
                lines[-1] = joined
            else:
                lines[-1] = lines[-1].rstrip(",:")
                lines += _at_blanks(text, statement, width, upright=upright)
    text.set_text("\n".join(lines))


def _at_blanks(text: Text, line: str, width: float, *, upright: bool) -> list[str]:
    """Lines for the words of a text, broken at blanks."""
    lines: list[str] = []
    for word in line.split(" "):
        if lines and (joined := f"{lines[-1]} {word}") and _length(text, joined, upright=upright) < width:
            lines[-1] = joined
        else:
            lines.append(word)
    return lines


def _length(text: Text, content: str, *, upright: bool) -> float:
    """Length of a text along its writing direction, pixels."""
    before = text.get_text()
    text.set_text(content)  # widths depend on the letters, so that words are measured by setting them
    box = text.get_window_extent()
    text.set_text(before)
    return float(box.height if upright else box.width)
