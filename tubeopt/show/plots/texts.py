"""Texts of a figure that is laid out: which cannot be read, and how they are moved apart."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.text import Annotation, Text
from matplotlib.transforms import BboxBase

from ...typing import Array, Mask
from ..page import SCALE

TOLERANCE = (1.0, 1.5)
"""Allowed overlap of two texts across and upwards, points: letters fill less than the box of their text."""

EDGE_TOLERANCE = 0.5
"""Allowed overhang of a text over the edge of the page, points: edges of letters are smoothed."""

MAX_ASPECT = 1.2
"""Largest height of a picture for a page, over its width."""

MAX_SHIFT = 5
"""Largest shift of a name off another text, in lines."""

ROUNDS = 3
"""Rounds of moving texts and measuring again."""


@dataclass(frozen=True)
class Fault:
    """Text that cannot be read, or a page that is too high."""

    kind: str
    """"overlap", "covered" (text in the area of another panel), "clipped" or "high"."""
    text: str
    other: str = ""
    """Overlapping text, or the name of the panel."""

    def __str__(self) -> str:
        """Kind and texts."""
        return f"{self.kind}: {self.text!r}" + (f" and {self.other!r}" if self.other else "")


class PlacedText(NamedTuple):
    """Text of a figure that is laid out."""

    text: Text
    axes: Axes | None
    """Panel of the text; None for texts of the whole figure."""
    axis: Axis | None
    """Axis of a tick label, else None."""


def faults(figure: Figure) -> list[Fault]:
    """Faults of the texts of a figure that is laid out."""
    figure.draw_without_rendering()  # legends and labels of ticks get their positions when they are drawn
    width, height = figure.get_size_inches()
    out = [Fault("high", f"{height / width:.2f} widths")] if height > MAX_ASPECT * width + 1e-6 else []
    texts = list(drawn_texts(figure))
    boxes = _boxes(texts)
    ((left, bottom, right, top),) = _box(figure.bbox.padded(EDGE_TOLERANCE * figure.dpi / 72))
    inside = (boxes[:, :2] >= (left, bottom)).all(1) & (boxes[:, 2:] <= (right, top)).all(1)
    out += [Fault("clipped", texts[k].text.get_text()) for k in np.flatnonzero(~inside)]
    for k, j in np.argwhere(np.tril(_overlap(figure, boxes, boxes), -1)):
        out.append(Fault("overlap", texts[k].text.get_text(), texts[j].text.get_text()))
    for panel, covered in _covered(figure, texts, boxes):
        name = panel.get_title("left") or panel.get_ylabel() or panel.get_xlabel() or "another panel"
        out += [Fault("covered", texts[k].text.get_text(), name) for k in np.flatnonzero(covered)]
    return out


def crowded(figure: Figure) -> bool:
    """True if texts overlap others or lie in other panels; texts of legends have no positions yet.

    After the layout it needs no drawing, which would take a quarter of the time of a picture.
    """
    texts = list(drawn_texts(figure, legends=False))
    boxes = _boxes(texts)
    overlapping = np.tril(_overlap(figure, boxes, boxes), -1).any()
    return bool(overlapping) or any(True for _ in _covered(figure, texts, boxes))


def separate(figure: Figure) -> None:
    """Move names off other texts and panels, thin out numbers of scales, and hide those that still overlap."""
    for _ in range(ROUNDS):
        figure.draw_without_rendering()
        texts = list(drawn_texts(figure))
        boxes = _boxes(texts)
        pairs = [(int(k), int(j)) for k, j in np.argwhere(np.tril(_overlap(figure, boxes, boxes), -1))]
        covered = [int(k) for _, each in _covered(figure, texts, boxes) for k in np.flatnonzero(each)]
        if not pairs and not covered:
            return
        one_axis = [(k, j) for k, j in pairs if texts[k].axis is not None and texts[k].axis is texts[j].axis]
        for axis in {id(texts[k].axis): texts[k].axis for k, _ in one_axis}.values():
            # Numbers of one scale overlap each other: hiding every other one keeps the scale regular. The first stays,
            # where a reader begins.
            ticks = axis.get_major_ticks() if axis is not None else []
            shown = [tick for tick in ticks if tick.label1.get_visible() or tick.label2.get_visible()]
            for tick in shown[1::2]:
                tick.label1.set_visible(False)
                tick.label2.set_visible(False)
        # Moves of a round change `boxes`, so that two names do not move to the same place.
        for pair in pairs:
            if pair not in one_axis:
                _resolve(figure, texts, boxes, pair)
        for k in covered:
            _resolve(figure, texts, boxes, (k,))


def _resolve(figure: Figure, texts: Sequence[PlacedText], boxes: Array, crowded: Sequence[int]) -> None:
    """Hide the number of a scale, or move a name, of texts that overlap."""
    for k in crowded:
        # A reader can infer a number of a scale from its neighbours, but not a name.
        if texts[k].axis is not None or texts[k].text.get_gid() == SCALE:
            texts[k].text.set_visible(False)
            return
    for k in crowded:
        text: Any = texts[k].text
        if not isinstance(text, Annotation) or text.anncoords != "offset points":
            continue
        x, y = text.xyann  # points
        steps = np.arange(-MAX_SHIFT, MAX_SHIFT + 1)
        size: Any = text.get_fontsize()
        shifts = size * np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
        # The nearest free place: a name far from its point is read as that of another.
        shifts = shifts[np.argsort(np.hypot(*shifts.T), kind="stable")][1:]
        candidates = boxes[k] + np.tile(shifts, 2) * figure.dpi / 72
        ((left, bottom, right, top),) = _box(figure.bbox)
        free = (candidates[:, :2] >= (left, bottom)).all(1) & (candidates[:, 2:] <= (right, top)).all(1)
        free &= ~_overlap(figure, candidates, np.delete(boxes, k, axis=0)).any(1)
        for panel in _foreign_panels(figure, texts[k].axes):
            free &= ~_overlap(figure, candidates, _box(panel.bbox))[:, 0]
        if free.any():
            best = int(np.argmax(free))
            text.xyann = (x + shifts[best, 0], y + shifts[best, 1])
            boxes[k] = candidates[best]
            return


def too_wide(figure: Figure) -> Iterator[tuple[Text, float]]:
    """Horizontal texts that extend beyond the page, and the width in pixels that each may have."""
    page = figure.bbox
    for text, _, _ in drawn_texts(figure):
        box = text.get_window_extent()
        outside = max(page.x0 - box.x0, 0.0) + max(box.x1 - page.x1, 0.0)
        if outside > EDGE_TOLERANCE * figure.dpi / 72 and text.get_rotation() == 0:
            # 5 % less, as breaking at blanks rarely fills a line exactly.
            yield text, 0.95 * (box.width - outside)


def drawn_texts(figure: Figure, *, legends: bool = True) -> Iterator[PlacedText]:
    """Every text that is drawn, with or without texts of legends."""
    shown = figure.legends if legends else []
    texts = [*figure.texts, *(text for legend in shown for text in (*legend.get_texts(), legend.get_title()))]
    panels = [each for axes in figure.axes if axes.get_visible() for each in _texts_of(axes, legends=legends)]
    for each in (*panels, *(PlacedText(text, None, None) for text in texts)):
        if each.text.get_visible() and each.text.get_text().strip():
            yield each


def _texts_of(axes: Axes, *, legends: bool) -> Iterator[PlacedText]:
    parts: list[Any] = axes.get_children()
    for part in parts:
        if isinstance(part, Text):
            yield PlacedText(part, axes, None)
        elif legends and hasattr(part, "get_texts") and part.get_visible():  # a legend
            yield from (PlacedText(text, axes, None) for text in (*part.get_texts(), part.get_title()))
        elif hasattr(part, "get_celld") and part.get_visible():  # a table
            yield from (PlacedText(cell.get_text(), axes, None) for cell in part.get_celld().values())
    for axis in parts if axes.axison else ():
        if isinstance(axis, Axis) and axis.get_visible():
            yield PlacedText(axis.label, axes, None)
            yield PlacedText(axis.get_offset_text(), axes, None)
            # Matplotlib keeps labels of ticks outside of the view, which are not drawn.
            low, high = sorted(axis.get_view_interval())
            tolerance = 1e-9 * (high - low)
            for tick, at in zip(axis.get_major_ticks(), axis.get_majorticklocs(), strict=False):
                if low - tolerance <= at <= high + tolerance:
                    yield from (PlacedText(label, axes, axis) for label in (tick.label1, tick.label2))


def _boxes(texts: Sequence[PlacedText]) -> Array:
    """(N, 4) left, lower, right and upper ends of texts, pixels."""
    return np.array([each.text.get_window_extent().extents for each in texts]).reshape(-1, 4)


def _box(box: BboxBase) -> Array:
    """(1, 4) ends of a box, pixels."""
    return np.asarray(box.extents, dtype=float).reshape(1, 4)


def _overlap(figure: Figure, boxes: Array, neighbours: Array) -> Mask:
    """(N, M) True if boxes (N, 4) and (M, 4) overlap by more than `TOLERANCE`."""
    ends = np.minimum(boxes[:, None, 2:], neighbours[None, :, 2:])
    starts = np.maximum(boxes[:, None, :2], neighbours[None, :, :2])
    return np.asarray((ends - starts > np.array(TOLERANCE) * figure.dpi / 72).all(-1))


def _foreign_panels(figure: Figure, axes: Axes | None) -> Iterator[Axes]:
    """Panels other than that of a text, and not inside it."""
    for panel in figure.axes if axes is not None else ():
        if panel is axes or not panel.get_visible():
            continue
        assert axes is not None
        common = panel.bbox.intersection(panel.bbox, axes.bbox)
        nested = common is not None and common.width * common.height > 0.5 * min(
            each.bbox.width * each.bbox.height for each in (panel, axes)
        )
        if not nested:
            yield panel


def _covered(figure: Figure, texts: Sequence[PlacedText], boxes: Array) -> Iterator[tuple[Axes, Mask]]:
    """Panels, and the texts (N,) of other panels inside their area, where one would hide the other."""
    for axes in figure.axes:
        on_axes = np.array([each.axes is axes for each in texts])
        for panel in _foreign_panels(figure, axes) if on_axes.any() else ():
            covered = on_axes & _overlap(figure, boxes, _box(panel.bbox))[:, 0]
            if covered.any():
                yield panel, covered
