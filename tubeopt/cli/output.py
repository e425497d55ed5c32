"""Output of answers: a table or a JSON object on stdout, files in a directory."""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from ..errors import InputError, NotProvedError, SolveError, nearest
from ..files.units import TO_MM, parse_number
from ..show.page import TITLED, WIDTH
from ..show.report import FORMATS, PICTURE_FORMATS, Report, to_text
from ..show.reports import formats_of, report
from .interruption import reporting_saved
from .messages import LOGGER, error_record, failure, warnings

NARROWEST_MM, WIDEST_MM = 50, 300


OF_PICTURES = ("plot", "formats", "width_mm", "no_title")
"""Fields of `Output` that only commands with plots have."""


@dataclass(frozen=True)
class Output:
    """Output options of an answer: the flags that all commands share.

    Raises:
        InputError: a width that is no number or out of its range.
    """

    plot: Annotated[
        bool,
        typer.Option(
            "--plot",
            help="Save plots in the current directory, or in DIR of --out, and open them if there is a display.",
        ),
    ] = False
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="DIR",
            help="Directory for result files and plots, created if missing; without it, no result file is saved.",
            show_default=False,
        ),
    ] = None
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout instead of the table.")] = (
        False
    )
    quiet: Annotated[
        bool,
        typer.Option("--quiet", help="Print errors only, besides the JSON object (--json) or the address of a server."),
    ] = False
    formats: Annotated[
        str,
        typer.Option(
            "--format",
            metavar="F,..",
            help="File formats to save, separated by commas: png, pdf, svg, eps or tiff for plots. "
            "An unknown one prints all formats of the command. Films, tables and robot models need --out.",
        ),
    ] = PICTURE_FORMATS[0]
    width_mm: Annotated[
        str | None,
        typer.Option(
            "--width-mm",
            metavar="MM",
            help="Width of saved plots in mm, 50 to 300, at 600 dpi; a journal column has about 88, a page 180. "
            "By default every plot has its own width, at 200 dpi, or that of --journal.",
        ),
    ] = None
    no_title: Annotated[
        bool, typer.Option("--no-title", help="Save plots without a heading, for a paper with captions.")
    ] = False

    def __post_init__(self) -> None:
        if self.width_mm is not None:
            # Typer would say "not a valid float", without the range.
            number = parse_number(self.width_mm)
            if isinstance(number, str) or not NARROWEST_MM <= number <= WIDEST_MM:
                raise InputError(
                    f"--width-mm is {self.width_mm}; it must be a number from {NARROWEST_MM} to {WIDEST_MM}"
                )
        if self.out is None and not self.plot:
            flags = {
                "--format": self.formats != PICTURE_FORMATS[0],
                "--width-mm": self.width_mm is not None,
                "--no-title": self.no_title,
            }
            for flag, used in flags.items():
                if used:
                    LOGGER.warning(f"{flag} has no effect without --out or --plot: nothing is saved")

    @property
    def format_names(self) -> tuple[str, ...]:
        """Names of the file formats."""
        return tuple(part.strip().lower() for part in self.formats.split(","))

    @property
    def pictures(self) -> tuple[str, ...]:
        """Picture formats among them; by default the first known one."""
        return (
            tuple(form for form in dict.fromkeys(self.format_names) if form in PICTURE_FORMATS) or PICTURE_FORMATS[:1]
        )

    @property
    def width(self) -> float | None:
        """Width of pictures, m."""
        return None if self.width_mm is None else float(self.width_mm) / TO_MM


@contextmanager
def _saved_as(output: Output, picture: str) -> Iterator[None]:
    """Set formats, width and titles for the reports in the block; `picture` is the format of pictures."""
    format_token, width_token = FORMATS.set((picture, *output.format_names)), WIDTH.set(output.width)
    title_token = TITLED.set(not output.no_title)
    try:
        yield
    finally:
        FORMATS.reset(format_token)
        WIDTH.reset(width_token)
        TITLED.reset(title_token)


def present(answer: Report[Any], output: Output, *, written: Iterable[Path] = ()) -> None:
    """Save and print an answer, and raise its error for an unsuccessful status.

    With `plot` and without `out`, pictures are saved in the current directory. They are opened if there is a display.
    An answer that cannot be saved is still printed. Files `written` before are listed with its own.
    """
    files: list[Path] = [*written]
    pictures: list[Path] = []
    ending: Exception | None = None
    try:
        with reporting_saved(
            "nothing was saved" if output.out is None else f"{output.out} may contain a part of the answer"
        ):
            _write(answer, output, files, pictures)
        # After saving: a design that misses its goal is still written, and then ends with code 3.
        answer.conclude()
    except (InputError, SolveError, NotProvedError, typer.Exit) as error:
        ending = error
    except OSError as error:
        ending = InputError(f"{error.filename or output.out}: cannot be written: {error.strerror or error}")
    if output.as_json:
        ending = _print_json(answer, [*files, *pictures], ending)
    elif not output.quiet:
        _print_table(answer, [*files, *pictures])
    if output.plot and has_display() and not output.as_json:
        for path in pictures:
            typer.launch(str(path))
    if ending is not None:
        raise ending


def _write(answer: Report[Any], output: Output, files: list[Path], pictures: list[Path]) -> None:
    """Save an answer and draw its pictures; appends their paths to `files` and `pictures`."""
    with _saved_as(output, output.pictures[0]):
        # Files are appended step by step: those before an error are still reported.
        files += answer.save(output.out) if output.out else []
        files += answer.convert(output.out) if output.out else []
    for form in output.pictures if output.out or output.plot else ():
        with _saved_as(output, form):
            pictures += answer.draw(output.out or Path())


def print_address(answer: object, output: Output, *, event: str = "") -> None:
    """Print the address of a server, also with --quiet; as JSON with an event, in one line."""
    shown = report(answer)
    if output.as_json and event:
        print(json.dumps({"event": event} | json.loads(to_text(shown.record()))))
    elif output.as_json:
        _print_json(shown, [], None)
    else:
        _print_table(shown, [])
    sys.stdout.flush()


def _print_table(answer: Report[Any], files: list[Path]) -> None:
    console = Console()
    shown = answer.table()
    if isinstance(shown, str):  # plain text, for other programs
        print(shown)
    else:
        console.print(shown, crop=False)
    for path in files:
        console.print(f"saved {path}", markup=False, highlight=False, soft_wrap=True)


def _print_json(answer: Report[Any], files: list[Path], ending: Exception | None) -> Exception | None:
    """Print the JSON object with the error; returns an error without a message to raise."""
    record = answer.record()
    record |= {"files": [str(path) for path in files], "warnings": [*record.get("warnings", ()), *warnings()]}
    known = None if ending is None else failure(ending)
    if known is not None:
        record["error"] = error_record(*known)
        # The object on stdout has the message: stderr stays empty for programs.
        ending = typer.Exit(known.code)
    print(to_text(record), end="")
    return ending


def check_formats(output: Output, command: str) -> None:
    """Raise InputError for a format that a command does not save."""
    if output.formats == PICTURE_FORMATS[0]:
        return
    known = formats_of(command)
    for form in output.format_names:
        if form not in known:
            allowed = (
                f"`tubeopt {command}` saves {', '.join(known)}" if known else f"`tubeopt {command}` has no formats"
            )
            raise InputError(f"--format is {form!r}; {allowed}{nearest(form, known)}")


def can_be_saved(out: Path | None) -> None:
    """Raise InputError if nothing can be written into a directory."""
    if out is None:
        return
    # The directory may be new: its nearest existing parent decides.
    parent = out
    while not parent.exists() and parent != parent.parent:
        parent = parent.parent
    if parent.is_file():
        reason = "it is a file" if parent == out else f"{parent} is a file, not a directory"
    else:
        try:
            # Permissions alone do not show a read-only file system.
            with tempfile.TemporaryFile(dir=parent):
                return
        except OSError as error:
            reason = error.strerror or str(error)
            if parent != out:
                reason = f"{parent}: {reason}"
    raise InputError(f"{out}: nothing can be saved there: {reason}")


def has_display() -> bool:
    """True if a picture can be opened in a window."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
