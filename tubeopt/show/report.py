"""How an answer leaves the program: a table or a JSON object on stdout, files in a directory."""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import typer
from pydantic_core import to_json
from rich.console import Console, RenderableType
from rich.table import Table

from ..errors import InputError


class Report(Protocol):
    """An answer, ready to be shown and saved. Keys and columns carry their unit."""

    def record(self) -> dict[str, Any]:
        """What `--json` prints: plain numbers, text, lists and mappings."""

    def table(self) -> RenderableType:
        """What a person reads."""

    def save(self, directory: Path) -> list[Path]:
        """Write everything but the pictures into `directory`; return the paths."""

    def draw(self, directory: Path) -> list[Path]:
        """Write the pictures into `directory`; return the paths."""


@functools.singledispatch
def report(answer: object) -> Report:
    """The report on an answer; every kind of answer registers its own."""
    raise TypeError(f"there is no report on a {type(answer).__name__}")


def present(answer: Report, *, out: Path | None, as_json: bool, plot: bool = False) -> None:
    """Save `answer` into `out` where that is given, and print it.

    With `plot` and no `out` the pictures go into the current directory. Where there is a display they are opened.
    """
    files = answer.save(out) if out else []
    pictures = answer.draw(out or Path()) if out or plot else []
    files += pictures
    if as_json:
        print(to_text(answer.record() | {"files": [str(path) for path in files]}), end="")
        return
    console = Console()
    console.print(answer.table(), crop=False)
    for path in files:
        console.print(f"saved {path}", markup=False, highlight=False, soft_wrap=True)
    if plot and has_display():
        for path in pictures:
            typer.launch(str(path))


def can_be_saved(out: Path | None) -> None:
    """Raise InputError, before any work is done, where nothing can be written into `out`; None passes."""
    place = out
    while place is not None and not place.exists() and place != place.parent:
        place = place.parent
    if place is not None and not (place.is_dir() and os.access(place, os.W_OK)):
        why = "it is a file" if place.is_file() else f"{place} is no directory that can be written to"
        raise InputError(f"{out}: nothing can be saved there: {why if place == out else f'{place} is in the way'}")


def to_text(data: dict[str, Any]) -> str:
    """`data` as one JSON object; numbers that are not finite become null."""
    return to_json(data, indent=2, inf_nan_mode="null").decode() + "\n"


def two_columns(title: str, rows: Sequence[tuple[str, str]]) -> Table:
    """A table of names and values."""
    table = Table(title=title, title_justify="left", show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_column(style="bold", no_wrap=True)
    table.add_column()
    for name, value in rows:
        table.add_row(name, value)
    return table


def has_display() -> bool:
    """Whether a picture can be opened in a window."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
