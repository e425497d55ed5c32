"""One look for all pictures: colours, type, and how a picture reaches the disk."""

from __future__ import annotations

import re
import warnings
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
from ..page import FONTS, HEADINGS, TITLED, WIDTH
from ..quantities import load_in_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.axis import Axis
    from matplotlib.colorbar import Colorbar
    from matplotlib.figure import Figure as Figure
    from matplotlib.legend import Legend
    from matplotlib.text import Text
else:
    Axes = Figure = Any  # only types of pictures: Matplotlib takes longer to load than a solve

P = ParamSpec("P")
T = TypeVar("T")
D = TypeVar("D", contravariant=True)

INK = "#222222"
FAINT = "#8A8A8A"
DPI, PAGE_DPI = 200, 600
"""Dots per inch of pictures that are made of dots: as they are, and for the page of a journal."""

PNG_LEVEL = 1
"""How hard PNG is packed: harder takes half as long again for a sixth less."""
LAYOUT_PASSES = 3
"""Most passes until axes of equal aspect, whose size follows from their place, leave room for all that stands above
them; fewer where nothing moves any more by `STILL`, a part of the picture."""
STILL = 1e-3

FORMATS = ("png", "pdf", "svg", "eps", "tiff")

RC: dict[str, Any] = {
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
    # Type 42 keeps letters as text in PDF and EPS; publishers refuse the default, Type 3.
    "pdf.fonttype": 42,
    "ps.fonttype": 42,
    "savefig.facecolor": "white",
    # Letters as text, and a fixed salt for names, so that equal data give an equal file.
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
            matplotlib.rcParams.update(cast(Any, RC | {"font.sans-serif": families()}))
            return draw(*args, **kwargs)

    return wrapper


def families() -> list[str]:
    """Families of letters of pictures: the first has them, the others what it lacks."""
    if not FONTS.get():
        return list(RC["font.sans-serif"])
    from matplotlib.font_manager import fontManager

    installed = {font.name for font in fontManager.ttflist}
    return [*(name for name in FONTS.get() if name in installed), *RC["font.sans-serif"]]


class Picture(Protocol[D, P]):
    """A function that makes a picture of what it is given, and saves it where a name is."""

    def __call__(
        self, data: D, path: str | PathLike[str] | None = None, /, *args: P.args, **kwargs: P.kwargs
    ) -> Figure: ...


def picture(draw: Callable[Concatenate[D, P], Figure]) -> Picture[D, P]:
    """The frame of every picture around a function that draws one: its look, its layout, and how it is saved.

    The function that comes out takes, after what is drawn, a `path` to save the picture under (PNG, TIFF, PDF, SVG or
    EPS by its ending; None, the default, saves nothing), and raises InputError where the name does not end so.
    """

    @wraps(draw)
    @styled
    def wrapper(*given: Any, **keywords: Any) -> Figure:
        path = given[1] if len(given) > 1 else None

        def drawn() -> Figure:
            return draw(*given[:1], *given[2:], **keywords)

        if WIDTH.get() is None:
            return finish(drawn(), path)
        return saved(fitted(drawn), path)

    return cast(Picture[D, P], wrapper)


def new_figure(width: float, height: float, layout: Literal["constrained"] | None = "constrained") -> Figure:
    """An empty figure of this size in inches that draws into memory: no window, no global state.

    layout: None where its axes are put where they belong.
    """
    from .figure import NotebookFigure

    wanted = WIDTH.get()
    # The aspect ratio changes with the power 0.35 alone: a page half as wide keeps 78 % of the height.
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
    if heading and _shown(heading):
        figure.suptitle(heading, fontsize=9, x=0.02, ha="left")
    return figure


def _shown(heading: str) -> bool:
    """Whether pictures have headings; where they have none, this one is left for their captions."""
    headings = HEADINGS.get()
    if headings is not None and not TITLED.get():
        headings.append(heading)
    return TITLED.get()


def entitle(axes: Axes, heading: str, **look: Any) -> None:
    """Put the heading of a picture above its one panel, to the left."""
    if _shown(heading):
        axes.set_title(heading, loc="left", **look)


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
    # Symmetric about the middle, so that a constant is a line across the panel.
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
    """Write `figure` as PNG or TIFF (200 dpi, 600 for a page), PDF, SVG or EPS, by the ending; whole, or not at all."""
    kind = picture_format(path)
    # A picture depends on its data alone, so that the same data give the same file.
    metadata = {"png": {"Software": None}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}.get(kind)
    packing: dict[str, Any] = {"png": {"compress_level": PNG_LEVEL}, "tiff": {"compression": "tiff_lzw"}}
    packed = {"pil_kwargs": packing[kind]} if kind in packing else {}
    with atomic_write(path) as temporary:
        figure.savefig(
            temporary, format=kind, dpi=DPI if WIDTH.get() is None else PAGE_DPI, metadata=metadata, **packed
        )
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


ATTEMPTS = tuple((letters, stacked) for letters in (1.0, 0.8, 0.65, 0.5, 0.4) for stacked in (True, False))
"""How a picture is tried to fit a page: the size of its letters, and whether its columns stand below each other."""


def finish(figure: Figure, path: str | PathLike[str] | None) -> Figure:
    """Return `figure`, laid out, and saved under `path` if that is given."""
    if WIDTH.get() is not None:
        arrange(figure, stacked=narrow())
    else:
        _settle(figure)
    return saved(figure, path)


def saved(figure: Figure, path: str | PathLike[str] | None) -> Figure:
    """Return a figure that is laid out, and save it under `path` if that is given."""
    from .figure import as_it_stands

    if path is not None:
        with as_it_stands(figure):
            save_figure(figure, path)
    figure.stale = False  # until somebody changes it, it need not be laid out again
    return figure


def fitted(draw: Callable[[], Figure]) -> Figure:
    """A figure laid out for the page, drawn anew with smaller letters until no text overlaps another or is clipped.

    Smaller letters are tried too where panels would fill less than `ROOMY` of the page. Of several attempts that are
    not free of both, the one with fewest faults and the largest panels is returned. A sheet of a given size keeps it.
    """
    from .figure import faults

    best: tuple[tuple[int, float], Figure] | None = None
    for letters, stacked in ATTEMPTS:
        # On a wide page columns have room side by side; stacking is tried only once letters are small.
        if stacked and not narrow() and letters > 0.7:
            continue
        figure = draw()
        if figure.get_layout_engine() is None:  # its parts have places of their own
            return figure
        if not arrange(figure, stacked=stacked, letters=letters):
            continue
        # Readable texts come first, then room for panels; beyond ROOMY larger panels count no more.
        merit = len(faults(figure)), -min(_filled(figure), ROOMY)
        if best is not None and best[0][0] == 0 and -best[0][1] > FAIR and merit[1] > GAIN * best[0][1]:
            break  # panels of a given shape do not grow with smaller letters
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


ROOMY = 0.25
"""Part of a page that panels fill at least, where smaller letters can reach it."""

FAIR, GAIN = 0.18, 1.1
"""Part of a page that is enough where smaller letters do not let panels fill more, and by how much more
they must."""


def _filled(figure: Figure) -> float:
    """Part of a figure that its panels fill."""
    return sum(float(np.prod(axes.get_position().size)) for axes in figure.axes)


def arrange(figure: Figure, *, stacked: bool, letters: float = 1.0) -> bool:
    """Lay a figure out for the page; whether its panels have any room."""
    from .figure import TALLEST, NotebookFigure, clipped, relieve, stack

    if stacked and isinstance(figure, NotebookFigure):
        stack(figure)
    width, height = figure.get_size_inches()
    figure.set_figheight(min(height, TALLEST * width))
    _tell_sizes(figure)
    if letters != 1.0:
        _scale_letters(figure, letters)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # before names are broken, panels may have no room
        _fold(figure)
        _lay_out(figure)
        _fold_labels(figure)
        _settle(figure)
        relieve(figure)
        if narrower := clipped(figure):
            for text, room in narrower:
                _fold_lines(text, room)
            _lay_out(figure)
            relieve(figure)
        # Matplotlib reports panels without room only by this warning.
        warnings.simplefilter("error", UserWarning)
        try:
            figure.draw_without_rendering()
        except UserWarning:
            return False
    figure.set_layout_engine("none")  # what was measured stays where it is
    return True


def _settle(figure: Figure) -> None:
    """Lay a figure out, and move legends off what is drawn."""
    _lay_out(figure)
    moved = [_uncover(axes) for axes in figure.axes]
    if any(moved):
        _lay_out(figure)


def _scale_letters(figure: Figure, scale: float) -> None:
    """Make all letters smaller, and with them the ticks, the gaps between texts and panels, and legends."""
    from matplotlib.text import Annotation, Text

    for found in figure.findobj(Text):
        text: Any = found
        text.set_fontsize(scale * text.get_fontsize())
        if isinstance(text, Annotation) and text.anncoords == "offset points":
            text.xyann = (scale * text.xyann[0], scale * text.xyann[1])
    _tell_sizes(figure)
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            axis.labelpad *= scale
            first: Any = next(iter(axis.get_major_ticks(1)))
            axis.set_tick_params(length=scale * first.tick1line.get_markersize(), pad=scale * first.get_pad())
        if axes.get_legend() is not None:
            _legend_anew(axes)
    # Gaps of the layout are in inches and do not follow the letters.
    engine: Any = figure.get_layout_engine()
    engine.set(**{name: scale * pad for name, pad in engine.get().items() if name in ("w_pad", "h_pad")})


def _tell_sizes(figure: Figure) -> None:
    """Let ticks that are made later, with other settings of Matplotlib too, have labels as large as those there are."""
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            labels = axis.get_ticklabels()
            if labels:
                axis.set_tick_params(labelsize=labels[0].get_fontsize())


def _legend_anew(axes: Axes, **other: Any) -> Legend:
    """The legend of a panel made again, as large as its letters are, where something of it is to be another."""
    legend: Any = axes.get_legend()
    texts, title = legend.get_texts(), legend.get_title()
    look: dict[str, Any] = {
        "ncols": legend._ncols,  # noqa: SLF001
        "loc": legend._loc,  # noqa: SLF001
        # The anchor is known in pixels, and a new legend takes parts of the panel.
        "bbox_to_anchor": legend.get_bbox_to_anchor().transformed(axes.transAxes.inverted()).bounds,
        "borderaxespad": legend.borderaxespad,
        "columnspacing": legend.columnspacing,
        "handlelength": min(legend.handlelength, 1.4),
        "title": title.get_text() or None,
        "title_fontsize": title.get_fontsize(),
    }
    if texts:
        look["fontsize"] = texts[0].get_fontsize()
    return axes.legend(legend.legend_handles, [text.get_text() for text in texts], **look | other)


def _lay_out(figure: Figure) -> None:
    """Let the layout of a figure come to rest."""
    engine = figure.get_layout_engine()
    if engine is None:
        return
    places = _places(figure)
    # Each pass places panels by sizes of the last one; panels of equal aspect change their size with their place.
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
    if axes.get_title() or axes.get_title("left"):
        _legend_anew(axes, loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return True
    own: Any = legend._ncols  # type: ignore[attr-defined]  # noqa: SLF001
    # As many columns as the panel is wide: above it, every row of a legend costs height.
    columns = int(np.clip(axes.bbox.width / box.width * own, 1, len(legend.get_texts())))
    where: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.1}
    _legend_anew(axes, ncols=columns, **where)
    return True


def _drawn_in(artist: Any, box: Any) -> bool:
    """Whether some of a line, of points, of a surface that is no shade, or of a text lies in a box of pixels."""
    from matplotlib.text import Text

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


def _places(figure: Figure) -> Array:
    """(A, 4) where the axes of a figure are, parts of it."""
    return np.array([axes.get_position(original=True).bounds for axes in figure.axes]).reshape(-1, 4)


def _fold(figure: Figure) -> None:
    """Break headings, and stack legends, that are wider than the room they have."""
    figure.draw_without_rendering()
    # The heading begins at 2 % of the width, and as much is left at its end.
    room = figure.bbox.width * 0.96
    for heading in figure.texts:
        _fold_lines(heading, room)
    for axes in figure.axes:
        inside = axes.get_subplotspec()
        # Titles of adjacent panels would overlap where each takes the whole width.
        columns = 1 if inside is None else inside.get_gridspec().ncols / len(inside.colspan)
        for title in (axes.title, axes._left_title):  # type: ignore[attr-defined]  # noqa: SLF001
            if title.get_text():
                _fold_lines(title, 0.85 * room / columns)
        _narrow_legend(axes, 0.85 * room / columns)
    for legend in list(figure.legends):
        entries = [text.get_text() for text in legend.get_texts()]
        columns = int(len(entries) * room / legend.get_window_extent().width)
        if columns < len(entries):
            handles: Any = legend.legend_handles
            size = legend.get_texts()[0].get_fontsize()
            legend.remove()
            made = figure.legend(handles, entries, loc="outside lower center", ncols=max(columns, 1), fontsize=size)
            for text in made.get_texts():
                _fold_lines(text, 0.85 * room)


def _narrow_legend(axes: Axes, room: float) -> None:
    """Give the legend of a panel fewer columns where it is wider than `room` pixels, and break its names."""
    legend = axes.get_legend()
    if legend is None or not legend.get_texts():
        return
    width, own = legend.get_window_extent().width, legend._ncols  # type: ignore[attr-defined]  # noqa: SLF001
    if width > room and own > 1:
        legend = _legend_anew(axes, ncols=max(int(own * room / width), 1), columnspacing=1.0)
    for text in legend.get_texts():
        _fold_lines(text, 0.4 * room if own == 1 else room)


def _fold_labels(figure: Figure) -> None:
    """Break names of axes that are longer than their axis."""
    for axes in figure.axes:
        spec = axes.get_subplotspec()
        own = axes.bbox if spec is None else spec.get_position(figure).transformed(figure.transFigure)
        for axis, room in ((axes.xaxis, own.width), (axes.yaxis, own.height)):
            if axes.axison and axis.label.get_text() and axes.name != "3d":
                _fold_lines(axis.label, 0.9 * room, upright=axis is axes.yaxis)


def _fold_lines(text: Text, room: float, *, upright: bool = False) -> None:
    """Break a text so that it is no wider than `room` pixels: where it says one thing after another, else at blanks."""
    done: list[str] = []
    for line in text.get_text().split("\n"):
        first, *others = re.split(r"(?<=:)  |(?<=,)  ", line)
        done += _broken(text, first, room, upright=upright)
        for part in others:
            joined = f"{done[-1]}  {part}"
            if _length(text, joined, upright=upright) < room:
                done[-1] = joined
            else:
                done[-1] = done[-1].rstrip(",:")
                done += _broken(text, part, room, upright=upright)
    # Two blanks separate statements of a heading; the comma before a break is left out.
    text.set_text("\n".join(done))


def _broken(text: Text, line: str, room: float, *, upright: bool) -> list[str]:
    """A line in as many as it needs."""
    done: list[str] = []
    for word in line.split(" "):
        if done and (joined := f"{done[-1]} {word}") and _length(text, joined, upright=upright) < room:
            done[-1] = joined
        else:
            done.append(word)
    return done


def _length(text: Text, words: str, *, upright: bool) -> float:
    """Pixels that words take along their line."""
    before = text.get_text()
    text.set_text(words)
    # Widths depend on letters, so words are measured by drawing them.
    box = text.get_window_extent()
    text.set_text(before)
    return float(box.height if upright else box.width)


def caption(equilibrium: Equilibrium, title: str = "", *, narrow: bool = False) -> str:
    """Heading of a picture: `title` or the robot's name, tip, margin and joint values, in two lines or one each;
    under a load, what pushes in a line more; and one more where another tube than the innermost is the tip."""
    kind = "Concentric" if equilibrium.robot.nested_pairs or equilibrium.robot.n_tubes == 1 else "Eccentric"
    name = title or equilibrium.robot.name or f"{kind} robot, {equilibrium.robot.n_tubes} tubes"
    joints = [rotations_in_words(equilibrium.rotations)]
    if np.any(equilibrium.translations):
        # Tubes on one carriage share a translation, which is named once.
        first = [tubes[0] for tubes in equilibrium.robot.moving_together]
        joints.append(f"translations ({millimetres(equilibrium.translations[first])}) mm")
    margin = f"margin {round(equilibrium.margin, 3) + 0.0:.3f}".replace("-", "\N{MINUS SIGN}")
    word = in_a_word(equilibrium.margin)
    verdict = f"{margin}, {word}" if word in ("unstable", "at a snap") else margin
    verdict = "margin unknown" if np.isnan(equilibrium.margin) else verdict
    state = [f"tip ({millimetres(equilibrium.tip_position)}) mm", verdict]
    load = "" if equilibrium.load is None else f"load: {load_in_words(equilibrium.load)}"
    # Only a hyphen in front of a number that begins a word is a minus: names such as "A-1" keep theirs.
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
