"""Messages of commands: log, warnings, and errors with their exit codes."""

from __future__ import annotations

import difflib
import logging
import re
import sys
import warnings as python_warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple, TextIO

import typer
from rich.console import Console

from ..errors import InputError, NotProvedError, SolveError
from ..files.units import in_input_units, split_unit, unit_of

# --- logged messages and warnings -------------------------------------------------------------------------------------

LIBRARY = logging.getLogger("tubeopt")
LOGGER = logging.getLogger("tubeopt.cli")
KERNEL = logging.getLogger("tubeopt.kernel")
LEVELS = ("debug", "info", "warning", "error")


class Messages(logging.Handler):
    """Log handler that prints messages, each warning once, and stores warnings.

    Args:
        quiet: print nothing; warnings are still stored.
    """

    def __init__(self, quiet: bool) -> None:
        super().__init__()
        self.quiet = quiet
        self.warnings: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Print and store one message."""
        text, warned = record.getMessage(), record.levelno >= logging.WARNING
        # Every point of a sweep may repeat the same warning.
        if warned and text in self.warnings:
            return
        if warned:
            self.warnings.append(text)
        if not self.quiet:
            console = Console(stderr=True)
            with console.capture() as printed:
                console.print(f"[bold yellow]{'warning' if warned else record.name}:[/]", end=" ")
                console.print(text, markup=False, highlight=False, soft_wrap=True)
            sys.stderr.write(printed.get())  # a progress bar redirects stderr and prints above itself


def _log_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Log a Python warning: as a sentence if it is of tubeopt, otherwise for debugging."""
    if category.__module__.partition(".")[0] == LIBRARY.name:
        LOGGER.warning(in_input_units(str(message)))
    else:
        LOGGER.debug(f"{filename}:{lineno}: {category.__name__}: {message}")


@contextmanager
def listening(*, quiet: bool) -> Iterator[None]:
    """Print log messages and Python warnings until the end of the block."""
    before, level = LIBRARY.handlers[:], LIBRARY.level
    # An application that calls a command may have its own handlers: they are restored at the end.
    LIBRARY.handlers[:] = [Messages(quiet)]
    if sys.stderr.isatty():
        KERNEL.setLevel(logging.INFO)  # the first compilation takes seconds
    shown = python_warnings.showwarning
    python_warnings.showwarning = _log_warning
    try:
        yield
    finally:
        python_warnings.showwarning = shown
        LIBRARY.handlers[:] = before
        LIBRARY.setLevel(level)
        KERNEL.setLevel(logging.NOTSET)


def log_level(value: str) -> str:
    """Set the lowest level of printed messages; callback of `--log`."""
    if value not in LEVELS:
        raise typer.BadParameter(f"{value!r}; it must be {', '.join(LEVELS)}")
    LIBRARY.setLevel(value.upper())
    return value


def warnings() -> list[str]:
    """Warnings of the running command up to now."""
    messages: Any = next((handler for handler in LIBRARY.handlers if isinstance(handler, Messages)), None)
    return [] if messages is None else list(messages.warnings)


# --- failures: sentences on stderr, or with `--json` an object on stdout, and an exit code ----------------------------

BAD_INPUT, NO_SOLUTION, NOT_PROVED, INTERRUPTED = 2, 3, 4, 130

CODES: dict[type[Exception], tuple[int, str]] = {
    InputError: (BAD_INPUT, "input"),
    SolveError: (NO_SOLUTION, "no_solution"),
    NotProvedError: (NOT_PROVED, "not_proved"),
}
"""Error -> exit code, and its kind in JSON."""


OF_FILE = re.compile(r"\S+\.\w+: ")
"""Start of a message about a file."""

ABSENT = re.compile(r"(\w+)(?: and (\w+))?(?= (?:is|are) (?:both )?(?:missing|given)\b)")
"""Start of a message about one or two missing or superfluous keys."""


class Failure(NamedTuple):
    """Error as the command line reports it."""

    message: str
    code: int
    """Exit code."""
    kind: str
    """Kind in JSON."""


def failure(error: Exception) -> Failure | None:
    """Report of an error; None for an unexpected one."""
    for kind, (code, name) in CODES.items():
        if isinstance(error, kind):
            # The library reports in m and rad; commands read mm and deg. Every time limit of theirs has this flag.
            text = str(error).replace("increase time_limit", "increase --time-limit-s")
            return Failure("\n".join(map(in_input_units, text.splitlines())), code, name)
    # Errors of Typer about arguments: their class has no public name.
    message, context = getattr(error, "format_message", None), getattr(error, "ctx", None)
    if message is None:
        return None
    text = _usage_message(error) or message().rstrip(".")
    if text and context is not None:  # without a message the help itself was shown
        text += f"{'' if text.endswith('?') else ';'} see {context.command_path} --help"
    return Failure(text, BAD_INPUT, "usage")


def _usage_message(error: Any) -> str:
    """Message about an unknown flag, or about numbers separated by spaces; "" for other errors."""
    flag, context = getattr(error, "option_name", None), getattr(error, "ctx", None)
    if flag is not None and context is not None and error.message.startswith("No such option"):
        known = [name for part in context.command.params for name in part.opts if name.startswith("--")]
        return f"there is no option {flag}{_similar_flags(flag, known)}"
    # "10, 20, 30" is three arguments for the shell.
    extra = re.search(r"unexpected extra argument.* \(([-+\d. e]+)\)$", getattr(error, "message", ""))
    if extra is None:
        return ""
    return f"{extra[1]} stands alone; several numbers of an option have commas between them and no spaces, as 10,20,30"


def _similar_flags(flag: str, known: list[str]) -> str:
    """Hint with flags of similar names, whatever their unit; otherwise with flags of the same unit."""
    units = {name: unit_of(name.strip("-").replace("-", "_")) for name in (flag, *known)}
    # --tip-mm and --tip-deg are similar: names are compared without units.
    stems = {name: name.strip("-")[: -len(unit) or None].rstrip("-") for name, unit in units.items()}
    flag_stem, known_stems = stems.pop(flag), list(stems.values())
    close = [flag_stem] if flag_stem in known_stems else []
    for cutoff in (0.85, 0.6):  # weaker matches only without strong ones
        close = close or difflib.get_close_matches(flag_stem, known_stems, cutoff=cutoff)
    alike = [name for stem in dict.fromkeys(close) for name in known if stems[name] == stem]
    if alike:
        return f"; did you mean {' or '.join(alike)}?"
    same = [name for name in known if units[flag] and units[name] == units[flag]]
    return f"; those in {units[flag]} are {', '.join(same)}" if same else ""


@contextmanager
def naming_flags(typed: Mapping[str, str], known: Mapping[str, str]) -> Iterator[None]:
    """Replace keys by flags, and SI units by those of the flags, in an InputError.

    Args:
        typed: keys of the study -> flags on the command line.
        known: keys of the study -> all flags.
    """
    try:
        yield
    except InputError as error:
        text = "\n".join(_with_flag(_in_flags(line, known), typed) for line in str(error).splitlines())
        if text == str(error):
            raise
        raise InputError(text) from None


def _in_flags(line: str, flags: Mapping[str, str]) -> str:
    """Replace keys by flags in a line that is not about a file.

    A key that is a plain word is replaced at the start of the line, as a missing or superfluous key, or next to another
    key; elsewhere it may be a word of the sentence.
    """
    if OF_FILE.match(line):
        return line
    start = re.match(r"(\w+): ", line)
    if start is not None and start[1] in flags:
        return flags[start[1]] + line[start.end(1) :]
    absent = ABSENT.match(line)
    keys = {key for key in absent.groups() if key} if absent is not None else set()
    out = line
    if absent is not None and keys <= flags.keys():
        out = " and ".join(flags[key] for key in absent.groups() if key) + line[absent.end() :]
    # Keys with an underscore are unambiguous and go first. A plain word is replaced only where a key was.
    for key, flag in sorted(flags.items(), key=lambda item: "_" not in item[0]):
        if "_" in key:
            out = re.sub(rf"(?<![\w./-]){key}(?!\w)", flag, out)
        elif out != line:
            out = re.sub(rf"\b(and|or|without) {key}\b", rf"\1 {flag}", out)
    return out


def _with_flag(line: str, flags: Mapping[str, str]) -> str:
    """Line such as "slot is 0.03 s; ..." with the flag inserted; its subject contains the words of one key."""
    subject, verb, predicate = re.match("(.*?)( is | has |$)(.*)", line).groups()  # type: ignore[union-attr]
    if not verb or ":" in subject or subject.startswith("-"):
        return line
    keywords = _words(subject)
    # The library says "speed of the tip", the flag is --tip-speed-mm-per-s: words are compared without order.
    keys = [key for key, flag in flags.items() if flag and _words(split_unit(key)[0]) <= keywords]
    # With several candidates no flag is better than a wrong one.
    if len(keys) != 1:
        return line
    stem, unit = split_unit(keys[0])
    text = f"{flags[keys[0]]}{verb}{predicate}" if keywords == _words(stem) else f"{flags[keys[0]]}: {line}"
    return in_input_units(text) if unit in ("mm", "deg") else text


def _words(text: str) -> set[str]:
    """Words of a key or a phrase, in the singular."""
    return {word.removesuffix("s") for word in re.split(r"[^A-Za-z0-9]+", text) if word}


def error_record(message: str, code: int, kind: str) -> dict[str, object]:
    """Error as an object for `--json`."""
    return {"kind": kind, "exit_code": code, "messages": message.splitlines()}


def print_error(message: str, code: int, kind: str, as_json: bool) -> int:
    """Print an error and return its exit code."""
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
