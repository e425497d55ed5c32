"""No legend lies over what a panel shows, whatever the data are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tubeopt.show.plots.style import Figure, new_figure, picture

X = np.linspace(0, 1, 400)


@picture
def crowded(kind: str, *, title: str = "") -> Figure:
    """A panel full of one kind of mark, with a legend of three inside."""
    figure = new_figure(5.0, 3.0)
    axes: Any = figure.subplots()
    match kind:
        case "lines":
            for k in range(12):
                axes.plot(X, np.sin(9 * X + k), label=f"curve {k}" if k < 3 else None)
        case "line without marks":
            axes.plot(X[::399], X[::399] * 0 + 0.93, label="level")
            axes.plot(X, X, label="curve")
        case "points":
            axes.plot(np.tile(X[::8], 50), np.repeat(X[::8], 50), ".", label="points")
        case "scatter":
            axes.scatter(np.tile(X[::8], 50), np.repeat(X[::8], 50), label="points")
        case "surface":
            axes.fill_between(X, -1, 1, label="surface")
        case "contours":
            axes.contourf(X[::8], X[::8], np.add.outer(X[::8], X[::8]))
            axes.plot([], [], label="nothing")
        case "points of many alphas":
            axes.scatter(np.tile(X[::8], 50), np.repeat(X[::8], 50), alpha=np.linspace(0.1, 1, 2500), label="points")
        case "shade":
            axes.fill_between(X, -1, 1, alpha=0.2, label="shade")
        case "nothing":
            axes.plot([0.1], [0.1], "o", label="mark")
            axes.set(xlim=(0, 1), ylim=(0, 1))
        case "text":
            axes.set(xlim=(0, 1), ylim=(0, 1))
            axes.text(0.9, 0.9, "a long text in the corner", ha="right")
            axes.plot([], [], label="nothing")
    axes.set_title(title)
    axes.legend(loc="upper right")
    return figure


def inside(figure: Figure) -> bool:
    """Whether the legend of the panel lies within it."""
    (axes,) = figure.axes
    legend = axes.get_legend()
    assert legend is not None
    return bool(legend.get_window_extent().overlaps(axes.bbox.padded(-1)))


@pytest.mark.parametrize(
    "kind", ["lines", "line without marks", "points", "scatter", "surface", "text", "contours", "points of many alphas"]
)
@pytest.mark.parametrize("title", ["", "a title"])
def test_a_legend_over_what_is_drawn_moves_out_of_the_panel(kind: str, title: str) -> None:
    figure = crowded(kind, title=title)
    assert not inside(figure)
    (axes,) = figure.axes
    box = axes.get_legend().get_window_extent()  # type: ignore[union-attr]
    assert box.x0 >= 0
    assert box.x1 <= figure.bbox.width + 1
    assert box.y1 <= figure.bbox.height + 1
    if title:
        assert not box.overlaps(axes.title.get_window_extent())


def test_a_legend_on_a_shade_or_in_free_room_stays() -> None:
    assert inside(crowded("shade"))
    assert inside(crowded("nothing"))
