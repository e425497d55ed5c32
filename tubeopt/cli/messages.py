"""What the library logs while a command runs: shown on stderr as it comes, and warnings kept for `--json`."""

from __future__ import annotations

import logging
import sys
import warnings as python_warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO

import typer
from rich.console import Console

from ..files.units import as_typed

LIBRARY = logging.getLogger("tubeopt")
LOGGER = logging.getLogger("tubeopt.cli")
KERNEL = logging.getLogger("tubeopt.kernel")
LEVELS = ("debug", "info", "warning", "error")


class Messages(logging.Handler):
    """Shows what is logged, each warning once, unless nobody wants to see it.

    Args:
        quiet: nothing is shown; warnings are kept all the same.
    """

    def __init__(self, quiet: bool) -> None:
        super().__init__()
        self.quiet = quiet
        self.warnings: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Show, and keep, one message."""
        text, warned = record.getMessage(), record.levelno >= logging.WARNING
        if warned and text in self.warnings:
            return
        if warned:
            self.warnings.append(text)
        if not self.quiet:
            console = Console(stderr=True)
            with console.capture() as told:
                console.print(f"[bold yellow]{'warning' if warned else record.name}:[/]", end=" ")
                console.print(text, markup=False, highlight=False, soft_wrap=True)
            sys.stderr.write(told.get())  # which a bar, where one is shown, puts above it


def _heard(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Log what Python warns of: in a sentence where it is ours, else for who debugs."""
    if category.__module__.partition(".")[0] == LIBRARY.name:
        LOGGER.warning(as_typed(str(message)))
    else:
        LOGGER.debug(f"{filename}:{lineno}: {category.__name__}: {message}")


@contextmanager
def listening(*, quiet: bool) -> Iterator[None]:
    """Hear what the library logs, and what Python warns of, until the end of the block."""
    heard, before, level = Messages(quiet), LIBRARY.handlers[:], LIBRARY.level
    LIBRARY.handlers[:] = [heard]
    if sys.stderr.isatty():
        KERNEL.setLevel(logging.INFO)  # who waits sees why
    shown = python_warnings.showwarning
    python_warnings.showwarning = _heard
    try:
        yield
    finally:
        python_warnings.showwarning = shown
        LIBRARY.handlers[:] = before
        LIBRARY.setLevel(level)
        KERNEL.setLevel(logging.NOTSET)


def log_level(value: str) -> str:
    """Let what is logged from a level on be heard; the callback of `--log`."""
    if value not in LEVELS:
        raise typer.BadParameter(f"{value!r}; it must be {', '.join(LEVELS)}")
    LIBRARY.setLevel(value.upper())
    return value


def warnings() -> list[str]:
    """The warnings that were heard so far."""
    heard: Any = next((handler for handler in LIBRARY.handlers if isinstance(handler, Messages)), None)
    return [] if heard is None else list(heard.warnings)
