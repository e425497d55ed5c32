"""What a command reports besides its answer: messages of the library, warnings, and failures with their exit codes."""

from __future__ import annotations

import difflib
import logging
import re
import sys
import warnings as python_warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TextIO

import typer
from rich.console import Console

from ..errors import InputError, NotProvedError, SolveError
from ..files.units import as_typed, parted, unit_of

# --- logged messages and warnings -------------------------------------------------------------------------------------

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
        # Every point of a sweep may repeat the same warning.
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
    # An application that calls a command may have handlers of its own: they return at the end.
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


# --- failures: sentences on stderr, or with `--json` an object on stdout, and an exit code ----------------------------

BAD_INPUT, NO_SOLUTION, NOT_PROVED, INTERRUPTED = 2, 3, 4, 130

CODES: dict[type[Exception], tuple[int, str]] = {
    InputError: (BAD_INPUT, "input"),
    SolveError: (NO_SOLUTION, "no_solution"),
    NotProvedError: (NOT_PROVED, "not_proved"),
}
"""What is raised -> exit code, and what it is called in JSON."""


OF_FILE = re.compile(r"\S+\.\w+: ")
"""How a message on what stands in a file begins."""

ABSENT = re.compile(r"(\w+)(?: and (\w+))?(?= (?:is|are) (?:both )?(?:missing|given)\b)")
"""How a message begins on one or two keys that should be there, or should not."""


def failure(error: Exception) -> tuple[str, int, str] | None:
    """Message, exit code and kind of what a command raised; None of what is nobody's mistake but ours."""
    for kind, (code, name) in CODES.items():
        if isinstance(error, kind):
            # The library reports in m and rad; commands read mm and deg.
            return "\n".join(map(as_typed, str(error).splitlines())), code, name
    # What Typer says of arguments; the Click that it brings along has no public name.
    message, context = getattr(error, "format_message", None), getattr(error, "ctx", None)
    if message is None:
        return None
    words = _in_our_words(error) or message().rstrip(".")
    if words and context is not None:  # without words the help itself was shown
        words += f"{'' if words.endswith('?') else ';'} see {context.command_path} --help"
    return words, BAD_INPUT, "usage"


def _in_our_words(error: Any) -> str:
    """What is said of a flag that is not known, or of numbers with spaces between; nothing of other mistakes."""
    flag, context = getattr(error, "option_name", None), getattr(error, "ctx", None)
    if flag is not None and context is not None and error.message.startswith("No such option"):
        known = [name for part in context.command.params for name in part.opts if name.startswith("--")]
        return f"there is no option {flag}{_meant(flag, known)}"
    # "10, 20, 30" is three arguments for the shell.
    extra = re.search(r"unexpected extra argument.* \(([-+\d. e]+)\)$", getattr(error, "message", ""))
    if extra is None:
        return ""
    return f"{extra[1]} stands alone; several numbers of an option have commas between them and no spaces, as 10,20,30"


def _meant(flag: str, known: list[str]) -> str:
    """Flags that are called alike, whatever their unit; where there is none, those of the same unit."""
    units = {name: unit_of(name.strip("-").replace("-", "_")) for name in (flag, *known)}
    # --tip-mm and --tip-deg are alike: units are compared apart from names.
    stems = {name: name.strip("-")[: -len(unit) or None].rstrip("-") for name, unit in units.items()}
    own, others = stems.pop(flag), list(stems.values())
    close = [own] if own in others else []
    for cutoff in (0.85, 0.6):  # what is nearly the same leaves out what is only alike
        close = close or difflib.get_close_matches(own, others, cutoff=cutoff)
    alike = [name for stem in dict.fromkeys(close) for name in known if stems[name] == stem]
    if alike:
        return f"; did you mean {' or '.join(alike)}?"
    same = [name for name in known if units[flag] and units[name] == units[flag]]
    return f"; those in {units[flag]} are {', '.join(same)}" if same else ""


@contextmanager
def told_by_flag(typed: Mapping[str, str], known: Mapping[str, str]) -> Iterator[None]:
    """Say by which flag something came in that makes no sense, and in its unit.

    Args:
        typed: keys of the study -> flags that were given.   known: those that could be.
    """
    try:
        yield
    except InputError as error:
        told = "\n".join(_with_flag(_in_flags(line, known), typed) for line in str(error).splitlines())
        if told == str(error):
            raise
        raise InputError(told) from None


def _in_flags(line: str, flags: Mapping[str, str]) -> str:
    """A line with flags in place of keys, unless it is about a file; a key that is a plain word only beside another, or
    where it begins the line, or is what the line says to be missing or given."""
    if OF_FILE.match(line):
        return line
    begins = re.match(r"(\w+): ", line)
    if begins is not None and begins[1] in flags:
        return flags[begins[1]] + line[begins.end(1) :]
    absent = ABSENT.match(line)
    named = {key for key in absent.groups() if key} if absent is not None else set()
    out = line
    if absent is not None and named <= flags.keys():
        out = " and ".join(flags[key] for key in absent.groups() if key) + line[absent.end() :]
    # Keys with an underscore are unambiguous and go first. A plain word is replaced only where a key was.
    for key, flag in sorted(flags.items(), key=lambda item: "_" not in item[0]):
        if "_" in key:
            out = re.sub(rf"(?<![\w./-]){key}(?!\w)", flag, out)
        elif out != line:
            out = re.sub(rf"\b(and|or|without) {key}\b", rf"\1 {flag}", out)
    return out


def _with_flag(line: str, flags: Mapping[str, str]) -> str:
    """A line such as "slot is 0.03 s; ..." after the one flag whose name is in what is said to be something."""
    what, found, rest = re.match("(.*?)( is | has |$)(.*)", line).groups()  # type: ignore[union-attr]
    if not found or ":" in what or what.startswith("-"):
        return line
    words = _words(what)
    # The library says "speed of the tip", the flag is --tip-speed-mm-per-s: words are compared without order.
    named = [key for key, flag in flags.items() if flag and _words(parted(key)[0]) <= words]
    # With several candidates no flag is better than a wrong one.
    if len(named) != 1:
        return line
    stem, unit = parted(named[0])
    said = f"{flags[named[0]]}{found}{rest}" if words == _words(stem) else f"{flags[named[0]]}: {line}"
    return as_typed(said) if unit in ("mm", "deg") else said


def _words(text: str) -> set[str]:
    """Of a key or a phrase, in the singular."""
    return {word.removesuffix("s") for word in re.split(r"[^A-Za-z0-9]+", text) if word}


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
