"""One look for all pictures: colours, type, and how a picture reaches the disk."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import wraps
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Concatenate, Literal, ParamSpec, Protocol, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from ...equilibrium.result import Equilibrium
from ...errors import InputError
from ...files.files import atomic_write
from ...files.units import TO_MM
from ...typing import Array
from ..formatting import in_a_word, tip_in_words
from ..load_words import load_in_words
from ..page import WIDTH

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.axis import Axis
    from matplotlib.colorbar import Colorbar
    from matplotlib.figure import Figure as Figure
    from matplotlib.text import Text
else:
    Axes = Figure = Any  # only types of pictures: Matplotlib takes longer to load than a solve

P = ParamSpec("P")
T = TypeVar("T")
D = TypeVar("D", contravariant=True)

INK = "#222222"
FAINT = "#8A8A8A"
DPI = 200
PNG_LEVEL = 1
"""How hard PNG is packed: harder takes half as long again for a sixth less."""
LAYOUT_PASSES = 3
"""Most passes until axes of equal aspect, whose size follows from their place, leave room for all that stands above
them; fewer where nothing moves any more by `STILL`, a part of the picture."""
STILL = 1e-3

FORMATS = ("png", "pdf", "svg")

RC = {
    "axes.axisbelow": True,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 9,
    "axes.labelsize": 9,
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 8,
    "grid.color": "#E6E8EB",
    "grid.linewidth": 0.5,
    "hatch.linewidth": 0.5,
    "legend.frameon": False,
    "mathtext.fontset": "dejavusans",
    "pdf.fonttype": 42,
    "savefig.facecolor": "white",
    "svg.fonttype": "none",
    "svg.hashsalt": "tubeopt",
    "text.color": INK,
    "xtick.color": INK,
    "xtick.labelsize": 8,
    "ytick.color": INK,
    "ytick.labelsize": 8,
}


INCH = 25.4e-3

HEIGHT_SHARE = 0.35
"""Power of the change of width by which the height changes."""

NARROW = 0.12
"""Width of a picture, m, below which its scales have half as many rules."""


def narrow() -> bool:
    """Whether pictures are laid out for a column."""
    wanted = WIDTH.get()
    return wanted is not None and wanted < NARROW


def styled(draw: Callable[P, T]) -> Callable[P, T]:
    """Let `draw` make its artists with the look of this module, whatever the caller's matplotlib is set to."""

    @wraps(draw)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> T:
        import matplotlib

        with matplotlib.rc_context():
            matplotlib.rcdefaults()
            matplotlib.rcParams.update(cast(Any, RC))
            return draw(*args, **kwargs)

    return wrapper


class Picture(Protocol[D, P]):
    """A function that makes a picture of what it is given, and saves it where a name is."""

    def __call__(
        self, data: D, path: str | PathLike[str] | None = None, /, *args: P.args, **kwargs: P.kwargs
    ) -> Figure: ...


def picture(draw: Callable[Concatenate[D, P], Figure]) -> Picture[D, P]:
    """The frame of every picture around a function that draws one: its look, its layout, and how it is saved.

    The function that comes out takes, after what is drawn, a `path` to save the picture under (PNG, PDF or SVG by its
    ending; None, the default, saves nothing), and raises InputError where the name does not end so.
    """

    @wraps(draw)
    @styled
    def wrapper(*given: Any, **keywords: Any) -> Figure:
        path = given[1] if len(given) > 1 else None
        return finish(draw(*given[:1], *given[2:], **keywords), path)

    return cast(Picture[D, P], wrapper)


def new_figure(width: float, height: float, layout: Literal["constrained"] | None = "constrained") -> Figure:
    """An empty figure of this size in inches that draws into memory: no window, no global state.

    layout: None where its axes are put where they belong.
    """
    from .figure import NotebookFigure

    wanted = WIDTH.get()
    scale = 1.0 if wanted is None else wanted / INCH / width
    # Letters keep their size, so that what is narrower needs more of its height.
    return NotebookFigure(
        figsize=(scale * width, scale**HEIGHT_SHARE * height),
        drawn_for=(width, height),
        dpi=DPI,
        layout=layout,
        facecolor="white",
    )


def headed(figure: Figure, heading: str) -> Figure:
    """Put a heading, if there is one, above everything in a figure, to the left."""
    if heading:
        figure.suptitle(heading, fontsize=9, x=0.02, ha="left")
    return figure


def disk(axes: Axes, centre: ArrayLike, radius: float, **look: Any) -> None:
    """All that is within a radius about a point (2,), in the units of the panel."""
    from matplotlib.patches import Circle

    x, y = np.asarray(centre, dtype=float)
    axes.add_patch(Circle((float(x), float(y)), radius, **look))


def legend_beside(axes: Axes, *entries: Any) -> None:
    """A legend to the right of a panel: of its own marks, or of entries (handles, names)."""
    axes.legend(*entries, loc="upper left", bbox_to_anchor=(1.0, 1.0), handlelength=1.2)


def name_above(axes: Axes, x: float, words: str, row: int = 0) -> None:
    """Say above the panel what is at x; rows of words from the lowest."""
    place: dict[str, Any] = {
        "xycoords": ("data", "axes fraction"),
        "textcoords": "offset points",
        "ha": "center",
        "va": "bottom",
    }
    axes.annotate(words, (x, 1), (0, 2 + 9 * row), fontsize=7, color=FAINT, **place)


def widen(axes: Axes, least: float) -> None:
    """Let the y axis span at least `least`, so that round-off about a constant does not look like a signal."""
    low, high = axes.get_ylim()
    if high - low < least:
        middle = (low + high) / 2
        axes.set_ylim(middle - least / 2, middle + least / 2)


def picture_format(path: str | PathLike[str]) -> str:
    """Format that the file name asks for; raises InputError where it is none of `FORMATS`."""
    suffix = Path(path).suffix.lower().removeprefix(".")
    if suffix not in FORMATS:
        raise InputError(f"the file name of the plot is {str(path)!r}; it must end in .{', .'.join(FORMATS)}")
    return suffix


SHADE = 0.4
"""Opacity up to which a surface is a shade, on which a legend can be read."""


@styled
def save_figure(figure: Figure, path: str | PathLike[str]) -> Path:
    """Write `figure` as PNG (200 dpi), PDF or SVG, as the name ends; whole, or not at all."""
    kind = picture_format(path)
    # A picture depends on its data alone, so that the same data give the same file.
    metadata = {"png": {"Software": None}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}[kind]
    packed: dict[str, Any] = {"pil_kwargs": {"compress_level": PNG_LEVEL}} if kind == "png" else {}
    with atomic_write(path) as temporary:
        figure.savefig(temporary, format=kind, dpi=DPI, metadata=metadata, **packed)
    return Path(path)


def angle_ticks(*scales: Axis) -> None:
    """Ticks for scales in deg, at round parts of a turn."""
    from matplotlib.ticker import MaxNLocator

    for scale in scales:
        scale.set_major_locator(MaxNLocator(nbins=5 if narrow() else 9, steps=[1, 1.5, 3, 4.5, 6, 9, 10]))


def colour_bar(figure: Figure, drawn: Any, label: str, **where: Any) -> Colorbar:
    """What colours mean, as a bar without a frame."""
    bar = figure.colorbar(drawn, label=label, **where)
    bar.outline.set_visible(False)
    return bar


def finish(figure: Figure, path: str | PathLike[str] | None) -> Figure:
    """Return `figure`, laid out, and saved under `path` if that is given."""
    from .figure import NotebookFigure, as_it_stands, stack

    if WIDTH.get() is not None:
        if narrow() and isinstance(figure, NotebookFigure):
            stack(figure)
        _fold(figure)
    _lay_out(figure)
    moved = [_uncover(axes) for axes in figure.axes]
    if any(moved):
        _lay_out(figure)
    if path is not None:
        with as_it_stands(figure):
            save_figure(figure, path)
    figure.stale = False  # until somebody changes it, it need not be laid out again
    return figure


def _lay_out(figure: Figure) -> None:
    """Let the layout of a figure come to rest."""
    engine = figure.get_layout_engine()
    if engine is None:
        return
    places = _places(figure)
    for _ in range(LAYOUT_PASSES):
        engine.execute(figure)
        before, places = places, _places(figure)
        if np.abs(places - before).max(initial=0.0) < STILL:
            break


def _uncover(axes: Axes) -> bool:
    """Whether the legend of a panel lay over what is drawn there, and now stands above it; beside it where there is a
    title."""
    legend = axes.get_legend()
    if legend is None or not legend.get_texts() or axes.name == "3d":
        return False
    box = legend.get_window_extent()
    if not any(_drawn_in(artist, box) for artist in (*axes.lines, *axes.collections, *axes.texts)):
        return False
    handles: Any = legend.legend_handles
    names = [text.get_text() for text in legend.get_texts()]
    size, columns = legend.get_texts()[0].get_fontsize(), legend._ncols  # type: ignore[attr-defined]  # noqa: SLF001
    if axes.get_title() or axes.get_title("left"):
        axes.legend(handles, names, loc="upper left", bbox_to_anchor=(1.0, 1.0), handlelength=1.2, fontsize=size)
        return True
    columns = int(np.clip(axes.bbox.width / box.width * columns, 1, len(names)))
    where: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.1}
    axes.legend(handles, names, ncols=columns, fontsize=size, columnspacing=1.2, **where)
    return True


def _drawn_in(artist: Any, box: Any) -> bool:
    """Whether some of a line, of points, of a surface that is no shade, or of a text lies in a box of pixels."""
    from matplotlib.text import Text

    if not artist.get_visible():
        return False
    if isinstance(artist, Text):
        return bool(artist.get_text() and artist.get_window_extent().overlaps(box))
    if hasattr(artist, "get_xydata"):
        line = artist.get_transform().transform_path(artist.get_path())
        if artist.get_linestyle() not in ("None", "", " ") and line.intersects_bbox(box, filled=False):
            return True
        marked = artist.get_marker() not in ("None", "", " ", None)
        return bool(marked and box.count_contains(line.vertices) > 0)
    if artist.get_alpha() is not None and np.max(artist.get_alpha()) <= SHADE:
        return False
    if len(artist.get_offsets()) > 1:
        return bool(box.count_contains(artist.get_offset_transform().transform(artist.get_offsets())) > 0)
    paths = [artist.get_transform().transform_path(path) for path in artist.get_paths()]
    return any(len(path.vertices) and path.intersects_bbox(box, filled=True) for path in paths)


def _places(figure: Figure) -> Array:
    """(A, 4) where the axes of a figure are, parts of it."""
    return np.array([axes.get_position(original=True).bounds for axes in figure.axes]).reshape(-1, 4)


def _fold(figure: Figure) -> None:
    """Break headings, and stack legends, that are wider than the room they have."""
    figure.draw_without_rendering()
    room = figure.bbox.width * 0.98
    for heading in figure.texts:
        _fold_lines(heading, room)
    for axes in figure.axes:
        inside = axes.get_subplotspec()
        columns = 1 if inside is None else inside.get_gridspec().ncols / len(inside.colspan)
        _fold_lines(axes.title if axes.get_title() else axes._left_title, 0.9 * room / columns)  # type: ignore[attr-defined]  # noqa: SLF001
    for legend in list(figure.legends):
        entries = [text.get_text() for text in legend.get_texts()]
        columns = int(len(entries) * room / legend.get_window_extent().width)
        if columns < len(entries):
            handles: Any = legend.legend_handles
            legend.remove()
            figure.legend(handles, entries, loc="outside lower center", ncols=max(columns, 1))


def _fold_lines(text: Text, room: float) -> None:
    """Break a heading where it says one thing after another, so that it is no wider than `room` pixels."""
    done: list[str] = []
    for line in text.get_text().split("\n"):
        first, *others = re.split(r"(?<=:)  |(?<=,)  ", line)
        done.append(first)
        for part in others:
            text.set_text(f"{done[-1]}  {part}")
            if text.get_window_extent().width < room:
                done[-1] = text.get_text()
            else:
                done[-1] = done[-1].rstrip(",:")
                done.append(part)
    text.set_text("\n".join(done))


def caption(equilibrium: Equilibrium, title: str = "", *, narrow: bool = False) -> str:
    """Heading of a picture: `title` or the robot's name, tip, margin and joint values, in two lines or one each;
    under a load, what pushes in a line more; and one more where another tube than the innermost is the tip."""
    kind = "Concentric" if equilibrium.robot.nested_pairs or equilibrium.robot.n_tubes == 1 else "Eccentric"
    name = title or equilibrium.robot.name or f"{kind} robot, {equilibrium.robot.n_tubes} tubes"
    joints = [rotations_in_words(equilibrium.rotations)]
    if np.any(equilibrium.translations):
        first = [tubes[0] for tubes in equilibrium.robot.moving_together]
        joints.append(f"translations ({millimetres(equilibrium.translations[first])}) mm")
    margin = f"margin {round(equilibrium.margin, 3) + 0.0:.3f}".replace("-", "\N{MINUS SIGN}")
    word = in_a_word(equilibrium.margin)
    verdict = f"{margin}, {word}" if word in ("unstable", "at a snap") else margin
    verdict = "margin unknown" if np.isnan(equilibrium.margin) else verdict
    state = [f"tip ({millimetres(equilibrium.tip_position)}) mm", verdict]
    load = "" if equilibrium.load is None else f"load: {load_in_words(equilibrium.load)}"
    more = [re.sub(r"(?<![\w.])-(?=\d)", "\N{MINUS SIGN}", load)] if load else []
    if tip := tip_in_words(equilibrium.robot, equilibrium.tube_end):
        more.append(f"the tip is {tip}")
    if narrow:
        return "\n".join([name, *joints, *state, *more])
    return "\n".join([f"{name}:  {',  '.join(state)}", ",  ".join(joints), *more])


def rotations_in_words(rotations: Array, digits: int = 1) -> str:
    """Rotations (rad) as a heading has them."""
    return f"rotations ({', '.join(f'{number(angle, digits)}°' for angle in np.degrees(rotations))})"


def millimetres(lengths: Array) -> str:
    """Lengths (m) as a heading has them, without their unit."""
    return ", ".join(number(length * TO_MM, 1) for length in lengths)


def number(value: float, digits: int) -> str:
    """`value` with at most `digits` decimals, without trailing zeros, and never "-0"; a true minus sign."""
    text = f"{value:.{digits}f}"
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return "0" if text in ("-0", "") else text.replace("-", "\N{MINUS SIGN}")
