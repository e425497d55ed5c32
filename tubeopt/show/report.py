"""Reports on answers: quantities, a table, a JSON object, files in a directory, pictures."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterable, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Literal, TypeVar, get_args

from pydantic_core import to_json
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ..files.files import write_text
from . import quantities
from .quantities import Quantity

if TYPE_CHECKING:
    from ..equilibrium.result import Equilibrium

A = TypeVar("A")

Drawing = Callable[..., Any]
"""Function that draws a picture, saves it if a path is given, and returns the figure."""


PICTURE_FORMATS = ("png", "pdf", "svg", "eps", "tiff")
FILM_FORMATS = ("gif", "mp4")
TABLE_FORMATS = ("parquet", "mat")
SOLID_FORMATS = ("stl", "glb", "urdf", "mjcf")

FORMATS: ContextVar[tuple[str, ...]] = ContextVar("FORMATS", default=("png",))
"""File formats of reports: one of `PICTURE_FORMATS`, and any table and arm formats."""


def file_name(picture: str) -> str:
    """Name of the file of a picture: with the suffix of its format, unless it has one."""
    chosen = next((form for form in FORMATS.get() if form in PICTURE_FORMATS), PICTURE_FORMATS[0])
    return picture if "." in picture else f"{picture}.{chosen}"


def drawing(plot: str, what: Any, **options: Any) -> Drawing:
    """Function that draws `what`, with the path of the picture as its only argument.

    Args:
        plot: the function of `show.plots` that draws it, as "mold.plot_mold", loaded with Matplotlib when it is wanted:
            that takes longer than a solve.
        options: what it takes besides.
    """
    module, _, name = plot.rpartition(".")
    # Imported by the call, since Matplotlib takes longer to load than a solve.
    return lambda path=None: getattr(import_module(f".plots.{module}", __package__), name)(what, path, **options)


@dataclass(frozen=True)
class Report(Generic[A]):
    """Report on an answer: its quantities, files, pictures and exit code."""

    answer: A

    command: ClassVar[str] = ""
    """Command that gives such an answer, without `tubeopt`."""

    quantities: ClassVar[tuple[Quantity[Any], ...]] = ()
    """Quantities for `--json` and for the rows of the table."""

    file: ClassVar[str] = ""
    """File name of the record; "" if it is not saved."""

    drawn: ClassVar[tuple[tuple[str, ...], ...]] = ()
    """Pictures: name, drawing function as for `drawing`, and attribute of the answer that it draws.

    No picture if the attribute is None; without an attribute, the answer itself is drawn.
    """

    def __init_subclass__(cls) -> None:
        """Register the class for the type of answers in its brackets."""
        for base in cls.__dict__.get("__orig_bases__", ()):
            # The class in the brackets, as of Report[Trajectory]: no second table of kinds is needed.
            report.register(get_args(base)[0], cls)

    def record(self) -> dict[str, Any]:
        """Record for `--json`: plain numbers, text, lists and mappings; keys carry their unit."""
        return quantities.record(self.answer, self.quantities)

    def rows(self) -> list[tuple[str, str]]:
        """Rows of the table, as names and texts."""
        return quantities.rows(self.answer, self.quantities)

    def title(self) -> str:
        """Title of the table."""
        answer: Any = self.answer
        return answer.robot.name or "robot"

    def table(self) -> RenderableType:
        """Table for the terminal."""
        return Group(two_columns(self.title(), self.rows()), *self.below())

    def below(self) -> Sequence[RenderableType]:
        """Texts below the table; by default the remarks among the quantities."""
        lines = (quantity.si_value(self.answer) for quantity in self.quantities if quantity.key == "remarks")
        return remarks(itertools.chain.from_iterable(each or () for each in lines), what="remark")

    def save(self, directory: Path) -> list[Path]:
        """Write everything but the pictures into `directory`; return the paths."""
        return [self.save_record(directory)] if self.file else []

    def save_record(self, directory: Path) -> Path:
        """Write the record as JSON under its name in `directory`."""
        write_text(directory / self.file, to_text(self.record()))
        return directory / self.file

    def pictures(self) -> dict[str, Drawing]:
        """Name of every picture -> drawing function; a name without a suffix gets the suffix of the format."""
        parts = [
            (name, plot, attrgetter(*part)(self.answer) if part else self.answer) for name, plot, *part in self.drawn
        ]
        return {name: drawing(plot, what) for name, plot, what in parts if what is not None}

    def draw(self, directory: Path) -> list[Path]:
        """Write the pictures into `directory`, in the format of the command; return the paths."""
        drawings = {directory / file_name(name): draw for name, draw in self.pictures().items()}
        for path, draw in drawings.items():
            draw(path)
        return list(drawings)

    def tables(self) -> dict[str, Any]:
        """Name -> data of many rows that can be saved as a table of another format."""
        return {}

    def films(self) -> dict[str, Drawing]:
        """Name of every film -> function that makes it; films are made only in requested formats."""
        return {}

    def solids(self) -> dict[str, Equilibrium]:
        """Name -> arms that can be saved as meshes and rigid bodies."""
        return {}

    def convert(self, directory: Path) -> list[Path]:
        """Write films, tables and arms into `directory` in their formats among `FORMATS`; return the paths."""
        # What they are converted with is loaded only where it is asked for.
        formats, paths = FORMATS.get(), list[Path]()
        for form in (form for form in FILM_FORMATS if form in formats):
            for name, film in self.films().items():
                paths.append(directory / f"{name}.{form}")
                film(paths[-1])
        if forms := [form for form in TABLE_FORMATS if form in formats]:
            from .tables import save_table

            made = [(form, *each) for form in forms for each in self.tables().items()]
            paths += [save_table(table, directory / f"{name}.{form}") for form, name, table in made]
        if forms := [form for form in SOLID_FORMATS if form in formats]:
            from .surfaces import save_solid

            built = [("xml" if form == "mjcf" else form, *each) for form in forms for each in self.solids().items()]
            paths += [save_solid(arm, directory / f"{name}.{suffix}") for suffix, name, arm in built]
        return paths

    def conclude(self) -> None:
        """Raise the error or exit code of the command, once all is shown and saved."""


@functools.singledispatch
def report(answer: object) -> Report[Any]:
    """The report on an answer: of the class `Report[...]` of its kind."""
    raise TypeError(f"there is no report on a {type(answer).__name__}")


def to_text(data: dict[str, Any]) -> str:
    """`data` as one JSON object; numbers that are not finite become null."""
    # JSON has no NaN and no infinity; the standard library would write them anyway.
    return to_json(data, indent=2, inf_nan_mode="null").decode() + "\n"


def two_columns(title: str, rows: Sequence[tuple[str, str]]) -> Group:
    """A table of names and values below its title, which may be wider than the table."""
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_column(style="bold", no_wrap=True)
    table.add_column()
    for name, value in rows:
        table.add_row(name, Text(value))  # as it is: a name may have brackets, which rich takes for markup
    return Group(*_titled(title), table)


def grid(columns: Sequence[str], rows: Iterable[Sequence[str]], *, title: str = "", key: bool = False) -> Group:
    """Table with a heading for every column, right-aligned for a heading that ends in " >".

    `key`: the first column is bold.
    """
    table = Table(box=None, padding=(0, 2, 0, 0))
    for k, name in enumerate(columns):
        bold = key and k == 0
        justify: Literal["left", "right"] = "right" if name.endswith(" >") else "left"
        table.add_column(name.removesuffix(" >"), justify=justify, style="bold" if bold else None, no_wrap=bold)
    for row in rows:
        table.add_row(*row)
    return Group(*_titled(title), table)


def _titled(title: str) -> list[Text]:
    return [Text(title, style="italic")] if title else []


def remarks(lines: Iterable[str], *, what: str = "") -> list[Text]:
    """Texts below a table, each with an optional kind in front."""
    return [Text(f"{what}: {text}" if what else text, style="yellow") for text in lines]
