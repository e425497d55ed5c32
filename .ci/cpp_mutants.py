"""One-line mutants of C++ by a list of operators: numbers, comparisons, signs, logic, guards that are left out."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

SWAPS = (
    ("<=", "<"), (">=", ">"), ("==", "!="), ("!=", "=="), ("&&", "||"), ("||", "&&"),
    (" < ", " <= "), (" > ", " >= "), (" < ", " > "), (" > ", " < "), (" + ", " - "), (" - ", " + "), (" * ", " / "),
    (" / ", " * "), (" % ", " / "), ("+= ", "-= "), ("++", "--"), ("--", "++"), ("true", "false"), ("false", "true"),
    ("!", ""),
)  # fmt: skip
"""Text -> text in its place; wherever it stands, one place at a time."""

LINES = (
    (re.compile(r"^(\s*)if \(.*\) return .*;(\s*//.*)?$"), "a guard is left out"),
    (re.compile(r"^(\s*)[A-Za-z_][\w.\[\]]* (?:[-+*/]?=) .*;(\s*//.*)?$"), "an assignment is left out"),
    (re.compile(r"^(\s*)[a-z_]+\(.*\);(\s*//.*)?$"), "a call is left out"),
)
"""Whole lines that are left out."""

NUMBER = re.compile(r"(?<![\w.\"])(\d+\.\d+f?|\d+)(?![\w.\"])")
NAME = re.compile(r"\b(SHARE|HOLDBACK|START_BELOW|TOO_HOT|MOST_AMPERE|LEAST_AMPERE|LEAKING_AMPERE|LOWEST_VOLT|LOST|"
                  r"PROPORTIONAL|INTEGRAL|PATIENCE_MS|LONGEST_MS|STUCK_MS|STUCK_HOLDING_MS|STUCK_RISE|STUCK_WITHIN|"
                  r"LOWEST_READING|HIGHEST_READING|HOLD_FIRST|SLOT_MS|TICK_MS|TICKS_PER_SLOT)\b")  # fmt: skip
"""Limits that a header defines: twice as much, and a little more."""


@dataclass(frozen=True)
class Mutant:
    """A source with one line changed."""

    line: int
    """From 1."""
    change: str
    """In words: what stood there, and what does."""
    text: str
    """The whole source."""


def mutants(text: str) -> Iterator[Mutant]:
    """All mutants of a source; comments, strings and preprocessor lines stay as they are."""
    lines = text.splitlines(keepends=True)

    def with_line(k: int, new: str, change: str) -> Mutant:
        return Mutant(k + 1, change, "".join([*lines[:k], new, *lines[k + 1 :]]))

    for k, line in enumerate(lines):
        code = line.split("//")[0]
        if not code.strip() or code.lstrip().startswith(("#", "//", "namespace", "const char", "using")):
            continue
        plain = re.sub(r'"(?:\\.|[^"\\])*"', lambda found: "\x00" * len(found[0]), code)
        for old, new in SWAPS:
            for found in re.finditer(re.escape(old), plain):
                if old in ("<", ">", "!") and plain[found.end() : found.end() + 1] == "=":
                    continue
                changed = code[: found.start()] + new + line[found.end() :]
                yield with_line(k, changed, f"{old.strip()} -> {new.strip() or 'nothing'}")
        for found in NUMBER.finditer(plain):
            value = found[0].rstrip("f")
            other = f"{float(value) * 2 + 1:g}.0f" if "." in value else str(int(value) + 1)
            yield with_line(k, code[: found.start()] + other + line[found.end() :], f"{found[0]} -> {other}")
        for found in NAME.finditer(plain):
            for factor in ("2", "1.05f"):
                changed = f"{code[: found.start()]}({factor} * {found[0]}){line[found.end() :]}"
                yield with_line(k, changed, f"{found[0]} -> {factor} {found[0]}")
        for pattern, change in LINES:
            if pattern.match(line.rstrip("\n")):
                yield with_line(k, f"{line[: len(line) - len(line.lstrip())]};\n", f"{change}: {line.strip()}")
