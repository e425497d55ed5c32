"""How commands fail: what was raised becomes sentences on stderr, or with `--json` an object on stdout, and a code."""

from __future__ import annotations

import sys

from rich.console import Console

from ..errors import InputError, NotProvedError, SolveError
from .messages import warnings

BAD_INPUT, NO_SOLUTION, NOT_PROVED, INTERRUPTED = 2, 3, 4, 130

CODES: dict[type[Exception], tuple[int, str]] = {
    InputError: (BAD_INPUT, "input"),
    SolveError: (NO_SOLUTION, "no_solution"),
    NotProvedError: (NOT_PROVED, "not_proved"),
}
"""What is raised -> exit code, and what it is called in JSON."""


def failure(error: Exception) -> tuple[str, int, str] | None:
    """Message, exit code and kind of what a command raised; None of what is nobody's mistake but ours."""
    for kind, (code, name) in CODES.items():
        if isinstance(error, kind):
            return str(error), code, name
    # What Typer says of arguments; the Click that it brings along has no public name.
    message, context = getattr(error, "format_message", None), getattr(error, "ctx", None)
    if message is None:
        return None
    words = message().rstrip(".")
    if words and context is not None:  # without words the help itself was shown
        words += f"; see {context.command_path} --help"
    return words, BAD_INPUT, "usage"


def error_record(message: str, code: int, kind: str) -> dict[str, object]:
    """A failure as a part of what `--json` prints."""
    return {"kind": kind, "exit_code": code, "messages": message.splitlines()}


def complain(message: str, code: int, kind: str, as_json: bool) -> int:
    """Tell a failure; return its exit code."""
    if as_json:
        from ..show.report import to_text

        print(to_text({"error": error_record(message, code, kind), "warnings": warnings()}), end="")
        return code
    console = Console(stderr=True)
    for line in message.splitlines():
        console.print("[bold red]error:[/]", end=" ")
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    sys.stderr.flush()
    return code
