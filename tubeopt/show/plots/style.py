"""Common style of pictures: colours, type, headings, layout and saving."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import wraps
from inspect import signature
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Concatenate, Literal, ParamSpec, Protocol, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from ...equilibrium.result import Equilibrium
from ...errors import InputError
from ...files.files import atomic_write
from ...files.units import TO_MILLI, TO_MM
from ...typing import Array
from ..formatting import in_a_word, tip_text
from ..page import FAINT as FAINT
from ..page import FONTS, HEADINGS, TITLED, WIDTH
from ..page import INK as INK
from ..page import narrow as narrow
from ..quantities import load_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.axis import Axis
    from matplotlib.colorbar import Colorbar
    from matplotlib.figure import Figure as Figure
else:
    Axes = Figure = Any  # only types of pictures: Matplotlib takes longer to load than a solve

P = ParamSpec("P")
T = TypeVar("T")
D = TypeVar("D", contravariant=True)

DPI, PAGE_DPI = 200, 600
"""Resolution of PNG and TIFF, dots per inch: of ordinary pictures, and of those for a page."""

PNG_LEVEL = 1
"""Compression level of PNG: the next levels take half as long again for a sixth less."""

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

# Letters keep their size, so that a narrower picture needs more of its height: half as wide, it keeps 78 %.
HEIGHT_POWER = 0.35
"""Exponent of the change of width in the change of height."""


def styled(draw: Callable[P, T]) -> Callable[P, T]:
    """Decorate `draw` so that it uses the style of this module, independent of the caller's Matplotlib settings."""

    @wraps(draw)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> T:
        import matplotlib

        with matplotlib.rc_context():
            matplotlib.rcdefaults()
            matplotlib.rcParams.update(cast(Any, RC | {"font.sans-serif": families()}))
            return draw(*args, **kwargs)

    return wrapper


def families() -> list[str]:
    """Installed font families of pictures, in order of preference; later ones supply missing letters."""
    if not FONTS.get():
        return list(RC["font.sans-serif"])
    from matplotlib.font_manager import fontManager

    installed = {font.name for font in fontManager.ttflist}
    return [*(name for name in FONTS.get() if name in installed), *RC["font.sans-serif"]]


class Picture(Protocol[D, P]):
    """Function that draws data, saves the picture if a path is given, and returns the figure."""

    def __call__(
        self, data: D, path: str | PathLike[str] | None = None, /, *args: P.args, **kwargs: P.kwargs
    ) -> Figure: ...


def picture(draw: Callable[Concatenate[D, P], Figure]) -> Picture[D, P]:
    """Decorate a function that draws data: the result has the common style, is laid out, and can be saved.

    The decorated function takes a further argument `path` after the data: file to save the picture in, whose ending
    selects PNG, TIFF, PDF, SVG or EPS (InputError for another); None, the default, saves nothing.
    """
    data_name = next(iter(signature(draw).parameters))

    @styled
    def drawn(data: D, path: Any = None, /, *args: P.args, **keywords: P.kwargs) -> Figure:
        if WIDTH.get() is None:
            return finish(draw(data, *args, **keywords), path)
        from .layout import fitted

        return saved(fitted(lambda: draw(data, *args, **keywords)), path)

    @wraps(draw)
    def wrapper(*args: Any, **keywords: Any) -> Figure:
        if not args and data_name in keywords:
            args = (keywords.pop(data_name),)
        return drawn(*args, **keywords)

    return cast(Picture[D, P], wrapper)


def new_figure(width: float, height: float, layout: Literal["constrained"] | None = "constrained") -> Figure:
    """Empty figure of a size in inches, or of the width of the page; it needs no window and no global state.

    layout: None for panels with positions of their own.
    """
    from .figure import NotebookFigure

    page_width = WIDTH.get()
    scale = 1.0 if page_width is None else page_width / INCH / width
    return NotebookFigure(
        figsize=(scale * width, scale**HEIGHT_POWER * height),
        drawn_for=(width, height),
        dpi=DPI,
        layout=layout,
        facecolor="white",
    )


def headed(figure: Figure, heading: str) -> Figure:
    """Put a heading, unless it is empty, at the upper left of a figure."""
    if heading and _shown(heading):
        figure.suptitle(heading, fontsize=9, x=0.02, ha="left")
    return figure


def _shown(heading: str) -> bool:
    """True if headings are drawn; otherwise the heading is stored for the captions."""
    headings = HEADINGS.get()
    if headings is not None and not TITLED.get():
        headings.append(heading)
    return TITLED.get()


def entitle(axes: Axes, heading: str, **look: Any) -> None:
    """Put the heading of a picture above its only panel, to the left."""
    if _shown(heading):
        axes.set_title(heading, loc="left", **look)


def disk(axes: Axes, centre: ArrayLike, radius: float, **look: Any) -> None:
    """Draw a disk about a point (2,), in the units of the panel."""
    from matplotlib.patches import Circle

    x, y = np.asarray(centre, dtype=float)
    axes.add_patch(Circle((float(x), float(y)), radius, **look))


def picture_format(path: str | PathLike[str]) -> str:
    """Format selected by the ending of a file name; raises InputError if it is none of `FORMATS`."""
    suffix = Path(path).suffix.lower().removeprefix(".")
    if suffix not in FORMATS:
        raise InputError(f"the file name of the plot is {str(path)!r}; it must end in .{', .'.join(FORMATS)}")
    return suffix


@styled
def save_figure(figure: Figure, path: str | PathLike[str]) -> Path:
    """Path of the saved figure, which is written completely or not at all.

    The ending selects PNG or TIFF (200 dpi, 600 for a page), PDF, SVG or EPS.
    """
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
    """Put the ticks of axes in deg at round fractions of a turn."""
    from matplotlib.ticker import MaxNLocator

    for scale in scales:
        scale.set_major_locator(MaxNLocator(nbins=5 if narrow() else 9, steps=[1, 1.5, 3, 4.5, 6, 9, 10]))


def colour_bar(figure: Figure, drawn: Any, label: str, **where: Any) -> Colorbar:
    """Colour bar without a frame."""
    bar = figure.colorbar(drawn, label=label, **where)
    bar.outline.set_visible(False)
    return bar


def finish(figure: Figure, path: str | PathLike[str] | None) -> Figure:
    """The figure, laid out, and saved if a path is given."""
    from . import layout

    layout.finish(figure)
    return saved(figure, path)


def saved(figure: Figure, path: str | PathLike[str] | None) -> Figure:
    """Figure that is laid out already, saved if a path is given."""
    from .figure import without_layout

    if path is not None:
        with without_layout(figure):
            save_figure(figure, path)
    figure.stale = False  # until somebody changes it, it need not be laid out again
    return figure


def caption(equilibrium: Equilibrium, title: str = "", *, narrow: bool = False) -> str:
    """Heading of a picture of an equilibrium: name, tip, margin, joint values, load, and an unusual tip tube.

    Args:
        title: instead of the robot's name.   narrow: a line for each, not one for several.
    """
    kind = "Concentric" if equilibrium.robot.nested_pairs or equilibrium.robot.n_tubes == 1 else "Eccentric"
    name = title or equilibrium.robot.name or f"{kind} robot, {equilibrium.robot.n_tubes} tubes"
    joints = [rotations_text(equilibrium.rotations)]
    if np.any(equilibrium.translations):
        # Tubes on one carriage share a translation, which is named once.
        first = [tubes[0] for tubes in equilibrium.robot.moving_together]
        joints.append(f"translations ({millimetres(equilibrium.translations[first])}) mm")
    margin = f"margin {round(equilibrium.margin, 3) + 0.0:.3f}".replace("-", "\N{MINUS SIGN}")
    word = in_a_word(equilibrium.margin)
    verdict = f"{margin}, {word}" if word in ("unstable", "at a snap") else margin
    verdict = "margin unknown" if np.isnan(equilibrium.margin) else verdict
    state = [f"tip ({millimetres(equilibrium.tip_position)}) mm", verdict]
    load = "" if equilibrium.given_load is None else f"load: {load_text(equilibrium.given_load)}"
    # Only a hyphen in front of a number that begins a word is a minus: names such as "A-1" keep theirs.
    more = [re.sub(r"(?<![\w.])-(?=\d)", "\N{MINUS SIGN}", load)] if load else []
    if equilibrium.walls is not None and equilibrium.walls.contacts:
        forces = [number(TO_MILLI * contact.size, 3) for contact in equilibrium.walls.contacts]
        more.append(f"contact with walls: {', '.join(forces)} mN")
    if tip := tip_text(equilibrium.robot, equilibrium.tube_end):
        more.append(f"the tip is {tip}")
    if narrow:
        return "\n".join([name, *joints, *state, *more])
    return "\n".join([f"{name}:  {',  '.join(state)}", ",  ".join(joints), *more])


def rotations_text(rotations: Array, digits: int = 1) -> str:
    """Rotations (n,), rad, in deg, for a heading."""
    return f"rotations ({', '.join(f'{number(angle, digits)}°' for angle in np.degrees(rotations))})"


def millimetres(lengths: Array) -> str:
    """Lengths (n,), m, in mm without the unit, for a heading."""
    return ", ".join(number(length * TO_MM, 1) for length in lengths)


def number(value: float, digits: int) -> str:
    """Number with at most `digits` decimals, without trailing zeros, with a true minus sign, and never "-0"."""
    text = f"{value:.{digits}f}"
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return "0" if text in ("-0", "") else text.replace("-", "\N{MINUS SIGN}")
