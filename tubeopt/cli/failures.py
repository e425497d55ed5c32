"""How commands fail: what was raised becomes sentences on stderr, or with `--json` an object on stdout, and a code."""

from __future__ import annotations

import difflib
import re
import sys
from typing import Any

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
    words = _in_our_words(error) or message().rstrip(".")
    if words and context is not None:  # without words the help itself was shown
        words += f"; see {context.command_path} --help"
    return words, BAD_INPUT, "usage"


def _in_our_words(error: Any) -> str:
    """What is said of a flag that is not known, or of numbers with spaces between; nothing of other mistakes."""
    flag, context = getattr(error, "option_name", None), getattr(error, "ctx", None)
    if flag is not None and context is not None and error.message.startswith("No such option"):
        known = [name for part in context.command.params for name in part.opts if name.startswith("--")]
        return f"there is no option {flag}{_meant(flag, known)}"
    extra = re.search(r"unexpected extra argument.* \(([-+\d. e]+)\)$", getattr(error, "message", ""))
    if extra is None:
        return ""
    return f"{extra[1]} stands alone; several numbers of an option have commas between them and no spaces, as 10,20,30"


def _meant(flag: str, known: list[str]) -> str:
    """Flags that are called alike, whatever their unit; where there is none, those of the same unit."""
    from ..files.units import unit_of

    units = {name: unit_of(name.strip("-").replace("-", "_")) for name in (flag, *known)}
    stems = {name: name.strip("-")[: -len(unit) or None].rstrip("-") for name, unit in units.items()}
    own, others = stems.pop(flag), list(stems.values())
    close = [own] if own in others else difflib.get_close_matches(own, others)
    alike = [name for stem in dict.fromkeys(close) for name in known if stems[name] == stem]
    if alike:
        return f"; did you mean {' or '.join(alike)}?"
    same = [name for name in known if units[flag] and units[name] == units[flag]]
    return f"; those in {units[flag]} are {', '.join(same)}" if same else ""


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
