"""Tables in CSV: comments, a header of names with units, rows of cells; every bad cell named with row and column."""

from __future__ import annotations

import csv
import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from os import PathLike

import numpy as np

from ..errors import InputError
from ..typing import Array
from .files import read_text
from .units import decimal, meant, parse_number, to_si

MOST_PROBLEMS = 20
"""Problems told at once; the others are counted."""


@dataclass(frozen=True)
class CsvTable:
    """A table of text."""

    path: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    line: tuple[int, ...]
    """Where each row stands in the file, from 1."""
    problems: list[str] = field(default_factory=list)
    """What is wrong with its cells."""

    def cell(self, row: int, column: str) -> str:
        """One cell, without blanks around it, empty where there is no such column; row from 0."""
        return self.rows[row][self.columns.index(column)] if column in self.columns else ""

    def complain(self, row: int, column: str, problem: str) -> None:
        """Note a problem with a cell; `problem` continues its name."""
        self.problems.append(f"row {row + 1} (line {self.line[row]}), column {column} {problem}")

    def number(self, row: int, column: str) -> Decimal:
        """The number in a cell, as it was written; 0, and a note, where there is none."""
        text = self.cell(row, column)
        try:
            return decimal(parse_number(text) if text else None)
        except ValueError as error:
            self.complain(row, column, str(error))
            return Decimal(0)

    def numbers(
        self, columns: Sequence[str], unit: Decimal | Sequence[Decimal], *, gaps: Collection[str] = ()
    ) -> Array:
        """(rows, columns) numbers in SI, given the unit of all or of each; NaN where a cell is one of `gaps`."""
        units = [unit] * len(columns) if isinstance(unit, Decimal) else unit
        known = list(zip(columns, units, strict=True))
        return np.array(
            [
                [math.nan if self.cell(k, c).lower() in gaps else to_si(self.number(k, c), one) for c, one in known]
                for k in range(len(self.rows))
            ]
        )

    def expect(
        self, needed: Sequence[str], optional: Sequence[str] = (), together: Sequence[str] = (), *, shown: str = ""
    ) -> bool:
        """Whether there are the columns that stand `together`: all of them, or none.

        `shown`: how messages list the known columns.

        Raises:
            InputError: a column that is none of these, or that is missing: one line for each.
        """
        known = (*needed, *optional, *together)
        listed = shown or ", ".join(known)
        given = [name for name in together if name in self.columns]
        refuse(
            self.path,
            [
                *(
                    f"column {name} is not known; columns are {listed}{meant(name, known)}"
                    for name in self.columns
                    if name not in known
                ),
                *(f"column {name} is missing" for name in needed if name not in self.columns),
                *(
                    f"column {name} is missing; it must be there since {given[0]} is"
                    for name in together
                    if given and name not in given
                ),
            ],
        )
        return bool(given)

    def check(self) -> None:
        """Raise InputError with one line for every problem noted, if there are any."""
        refuse(self.path, self.problems)


def refuse(path: str | PathLike[str], problems: Sequence[str]) -> None:
    """Raise InputError with one line for each of `problems` of a file, if there are any."""
    if not problems:
        return
    more = len(problems) - MOST_PROBLEMS
    lines = [*problems[:MOST_PROBLEMS], *([f"and {more} more"] if more > 0 else [])]
    raise InputError("\n".join(f"{path}: {line}" for line in lines))


def read_csv(path: str | PathLike[str]) -> CsvTable:
    """The table in a CSV file: cells separated by commas, the first line names the columns.

    Empty lines and lines that begin with # are skipped.

    Raises:
        InputError: no such file, not text, no header, a column without a name or named twice, no rows, rows with
            another number of cells than the header.
    """
    lines = [line.strip() for line in read_text(path).removeprefix("\N{ZERO WIDTH NO-BREAK SPACE}").splitlines()]
    numbered = [(k, line) for k, line in enumerate(lines, start=1) if line.strip(", ") and not line.startswith("#")]
    if not numbered:
        raise InputError(f"{path}: the file is empty; its first line must name the columns")
    header = _cells(numbered[0][1])
    if len(header) == 1 and ";" in header[0]:
        raise InputError(f"{path}: the columns are separated by semicolons; they must be separated by commas")
    problems = [f"column {k} has no name" for k, name in enumerate(header, start=1) if not name]
    problems += [f"column {name} is given twice" for name in sorted({c for c in header if c and header.count(c) > 1})]
    if len(numbered) == 1:
        problems.append("there are no rows below the header")
    rows = [_cells(line) for _, line in numbered[1:]]
    for k, (row, (line, _)) in enumerate(zip(rows, numbered[1:], strict=True), start=1):
        if len(row) != len(header):
            problems.append(f"row {k} (line {line}) has {len(row)} cells; the header names {len(header)} columns")
    refuse(path, problems)
    return CsvTable(str(path), tuple(header), tuple(map(tuple, rows)), tuple(line for line, _ in numbered[1:]))


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in next(csv.reader([line]))]


def to_csv(columns: Sequence[str], rows: Iterable[Sequence[object]], comment: str = "") -> str:
    """A CSV file as text: `comment` behind #, the header, the rows."""
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    return head + "".join(",".join(map(str, cells)) + "\n" for cells in [columns, *rows])
