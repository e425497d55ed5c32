"""CSV files: comments, a header with units, rows of cells; invalid cells are reported with row and column."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from decimal import Context, Decimal
from os import PathLike
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..typing import Array
from .files import read_bytes
from .units import UNITS, ZERO_CELSIUS, alternative_units, decimal, parse_number, split_unit, suggest_key, to_si

# 60 digits: a number of 17 digits times a unit of 50 is exact before it becomes a float.
CONTEXT = Context(prec=60)

MAX_PROBLEMS = 20
"""Largest number of reported problems; the others are counted."""


@dataclass(frozen=True)
class CsvTable:
    """Table of text cells."""

    path: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    line: tuple[int, ...]
    """Line number in the file of each row, from 1."""
    problems: list[str] = field(default_factory=list)
    """Problems with cells, for `check`."""

    def cell(self, row: int, column: str) -> str:
        """Text of a cell, "" for a missing column; rows from 0."""
        return self.rows[row][self.columns.index(column)] if column in self.columns else ""

    def complain(self, row: int, column: str, problem: str) -> None:
        """Add a problem with a cell; the text continues the name of the cell."""
        self.problems.append(f"row {row + 1} (line {self.line[row]}), column {column} {problem}")

    def number(self, row: int, column: str) -> Decimal:
        """Number in a cell, as written; for other text a problem is added, and the result is 0."""
        text = self.cell(row, column)
        try:
            return decimal(parse_number(text) if text else None)
        except ValueError as error:
            self.complain(row, column, str(error))
            return Decimal(0)

    def numbers(
        self, columns: Sequence[str], unit: Decimal | Sequence[Decimal], *, gaps: Collection[str] = ()
    ) -> Array:
        """Numbers in SI, shape (rows, columns), with one unit for all columns or each; NaN for cells of `gaps`."""
        units = [unit] * len(columns) if isinstance(unit, Decimal) else unit
        known = list(zip(columns, units, strict=True))
        return np.array(
            [
                [math.nan if self.cell(k, c).lower() in gaps else to_si(self.number(k, c), size) for c, size in known]
                for k in range(len(self.rows))
            ]
        )

    def expect(
        self, needed: Sequence[str], optional: Sequence[str] = (), together: Sequence[str] = (), *, shown: str = ""
    ) -> bool:
        """Check the names of the columns; returns True if the columns `together` exist.

        Args:
            together: optional columns that must exist together.
            shown: list of the known columns in messages.

        Raises:
            InputError: unknown or missing columns; one line for each.
        """
        known = (*needed, *optional, *together)
        listed = shown or ", ".join(known)
        present = [name for name in together if name in self.columns]
        refuse(
            self.path,
            [
                *(
                    f"column {name} is not known; columns are {listed}{suggest_key(name, known)}"
                    for name in self.columns
                    if name not in known
                ),
                *(f"column {name} is missing" for name in needed if name not in self.columns),
                *(
                    f"column {name} is missing; it must be there since {present[0]} is"
                    for name in together
                    if present and name not in present
                ),
            ],
        )
        return bool(present)

    def check(self) -> None:
        """Raise InputError with one line per problem, if there are any."""
        refuse(self.path, self.problems)


def refuse(path: str | PathLike[str], problems: Sequence[str]) -> None:
    """Raise InputError with one line for each problem of a file."""
    if not problems:
        return
    more = len(problems) - MAX_PROBLEMS
    lines = [*problems[:MAX_PROBLEMS], *([f"and {more} more"] if more > 0 else [])]
    raise InputError("\n".join(f"{path}: {line}" for line in lines))


def read_csv(path: str | PathLike[str], known: Collection[str] = ()) -> CsvTable:
    """Table of a text file; its first line has the names of the columns.

    Cells are separated by commas, semicolons, tabs or blanks; numbers may have decimal commas unless commas separate
    cells. Text is UTF-8, UTF-16 or Latin-1, with any line ends. Empty lines, lines that begin with #, and empty
    columns at the end are skipped. Columns with other names or units for columns of `known` are renamed and converted.

    Raises:
        InputError: no such file, another kind of file, no header, a column without a name or with a repeated one, no
            rows, rows with another number of cells than the header, both decimal commas and decimal points.
    """
    content = read_bytes(path)
    if kind := kind_of(content):
        raise InputError(f"{path}: this is {kind}; it must be a table as text, such as CSV")
    lines = [line.strip(" ") for line in re.split(r"\r\n|\r|\n", decoded(content))]
    # Line numbers are those of the file, comments and empty lines included.
    numbered = [(k, line) for k, line in enumerate(lines, start=1) if line.strip(",; \t") and not line.startswith("#")]
    separator = ""
    if numbered and (excel := re.fullmatch(r'"?sep=(.)"?', numbered[0][1])):  # a line that Excel writes and reads
        separator = excel[1]
        numbered = numbered[1:]
    if not numbered:
        raise InputError(f"{path}: the file is empty; its first line must name the columns")
    separator = separator or separator_of(numbered[0][1])
    cells = [_cells(line, separator) for _, line in numbered]
    # Spreadsheets end lines with separators: columns that are empty in every row are none.
    width = max(len(row) - next((k for k, cell in enumerate(reversed(row)) if cell), len(row)) for row in cells)
    header, *rows = [row[:width] for row in cells]
    problems = [f"column {k} has no name" for k, name in enumerate(header, start=1) if not name]
    problems += [f"column {name} is given twice" for name in sorted({c for c in header if c and header.count(c) > 1})]
    if not rows:
        problems.append("there are no rows below the header")
    for k, (row, (line, _)) in enumerate(zip(rows, numbered[1:], strict=True), start=1):
        if len(row) != len(header):
            # Two cells a column: every number was cut at its decimal comma.
            hint = "; decimal commas need semicolons between the cells" if len(row) == 2 * len(header) else ""
            problems.append(f"row {k} (line {line}) has {len(row)} cells; the header names {len(header)} columns{hint}")
    refuse(path, problems)
    if separator != ",":
        rows = with_points(path, rows)
    table = CsvTable(str(path), tuple(header), tuple(map(tuple, rows)), tuple(line for line, _ in numbered[1:]))
    return _renamed(table, known)


SIGNATURES = {
    b"PK\x03\x04": "an Excel workbook or another ZIP archive",
    b"\xd0\xcf\x11\xe0": "an old Excel workbook",
    b"%PDF": "a PDF document",
    b"\x89PNG": "a picture (PNG)",
    b"\xff\xd8\xff": "a picture (JPEG)",
    b"\x89HDF": "an HDF5 file, such as MATLAB writes",
    b"MATLAB": "a MATLAB file",
    b"PAR1": "a Parquet file",
    b"\x93NUMPY": "a NumPy file",
    b"\x1f\x8b": "a gzip archive",
    b"{": "a JSON file",
    b"<": "an HTML or XML file",
}
"""First bytes of files that are no text tables -> their kind."""


def kind_of(content: bytes) -> str:
    """Kind of a file that cannot be a text table, such as a PDF; "" for a possible table."""
    start = content.removeprefix(b"\xef\xbb\xbf").lstrip()
    for signature, kind in SIGNATURES.items():
        if start.startswith(signature):
            return kind
    if b"\0" in content and not _wide(content):
        return "a binary file"
    return ""


def _wide(content: bytes) -> str:
    """UTF-16 encoding of a text, by its byte order mark or its zeros; "" for other encodings."""
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "utf-16"
    # Latin letters and digits in UTF-16 have a zero as one of their two bytes. 0.9 allows a few other signs such as
    # a degree sign or Greek letters; text in UTF-8 has no zeros, and binary files have them in both places.
    even, odd = content[:400:2].count(0), content[1:400:2].count(0)
    half = len(content[:400]) / 2
    return "utf-16-le" if odd > 0.9 * half and not even else "utf-16-be" if even > 0.9 * half and not odd else ""


def decoded(content: bytes) -> str:
    """Decode UTF-8 or UTF-16, with or without a byte order mark, otherwise Windows Latin-1."""
    if wide := _wide(content):
        return content.decode(wide, errors="replace").removeprefix("\N{ZERO WIDTH NO-BREAK SPACE}")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace")


def separator_of(header: str) -> str:
    """Separator of the cells in a header: tab, semicolon, comma or blank."""
    bare = re.sub(r'"[^"]*"', "", header)
    # A comma may be a decimal comma where cells are separated by tabs or semicolons, never the reverse.
    for separator in ("\t", ";", ","):
        if separator in bare:
            return separator
    names = bare.split()
    return " " if len(names) > 1 and all(re.fullmatch(r"\w+", name) for name in names) else ","


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]


DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?|[-+]?\d+,(?:[eE][-+]?\d+)?")
DECIMAL_POINT = re.compile(r"[-+]?\d*\.\d+(?:[eE][-+]?\d+)?")


def with_points(path: str | PathLike[str], rows: list[list[str]]) -> list[list[str]]:
    """Replace decimal commas by decimal points in rows of cells."""
    cells = [cell for row in rows for cell in row]
    if not any(DECIMAL_COMMA.fullmatch(cell) for cell in cells):
        return rows
    if any(DECIMAL_POINT.fullmatch(cell) for cell in cells):
        refuse(path, ["some numbers have a decimal comma and others a decimal point; it must be one of them"])
    return [[cell.replace(",", ".") if DECIMAL_COMMA.fullmatch(cell) else cell for cell in row] for row in rows]


NAMES = {
    "t": "time",
    **dict.fromkeys(("timestamp", "stamp", "clock"), "time"),
    **dict.fromkeys(("alpha", "rot", "angle", "theta", "motor", "roll"), "rotation"),
    **dict.fromkeys(("trans", "insertion", "displacement", "slide", "carriage", "stage"), "translation"),
    "temp": "temperature",
    **dict.fromkeys(("u", "volt"), "voltage"),
    **dict.fromkeys(("i", "amp"), "current"),
    **dict.fromkeys(("pwm", "duty_cycle"), "duty"),
    "springback": "spring_back",
    **dict.fromkeys(("s", "arclength", "arc"), "arc_length"),
    **{f"{word}{axis}": f"curvature_{axis}" for word in ("u_", "u", "kappa_", "kappa", "curv_") for axis in "xy"},
    **{f"{word}_{axis}": axis for word in ("pos", "position", "tip", "p", "target") for axis in "xyz"},
    **{f"{axis}_{word}": axis for word in ("pos", "position", "tip", "target") for axis in "xyz"},
    **{f"{word}{axis}": axis for word in ("p", "t") for axis in "xyz"},
}
"""Alternative names of columns -> names in tubeopt, without unit and number."""

SPELLED = {
    **dict.fromkeys(("degree", "degrees", "°"), "deg"),
    **dict.fromkeys(("radian", "radians"), "rad"),
    **dict.fromkeys(("sec", "seconds"), "s"),
    **dict.fromkeys(("c", "°c", "celsius"), "degC"),
    **dict.fromkeys(("volt", "volts"), "V"),
    **dict.fromkeys(("amp", "amps", "ampere"), "A"),
    **dict.fromkeys(("k", "kelvin"), "K"),
    **{f"1/{length}": f"per_{length}" for length in ("m", "cm", "mm")},
    "%": "percent",
}
"""Alternative spellings of units."""


def _renamed(table: CsvTable, known: Collection[str]) -> CsvTable:
    """Rename columns with other names or units for columns of `known`, and convert their numbers."""
    # Columns are compared without their units, which may differ from those of tubeopt.
    known_names = {split_unit(name)[0]: name for name in known}
    columns, problems = list(table.columns), list[str]()
    scales = [AS_IT_IS] * len(columns)
    for k, name in enumerate(table.columns):
        if name in known or not known:
            continue
        word, unit = read_name(name)
        target = known_names.get(word, "")
        if not target or target in columns:
            continue
        target_unit = split_unit(target)[1]
        if not unit and target_unit:
            # A number without unit could be in mm or in m: no guess.
            problems.append(f"column {name} has no unit; call it {target}, or {word} with another unit")
        elif unit == target_unit:
            columns[k] = target
        elif (unit, target_unit) == ("K", "degC"):
            # The offset is no factor: Kelvin is not among the units of `CONFUSED_UNITS`.
            columns[k], scales[k] = target, Scale(Decimal(1), ZERO_CELSIUS)
        elif (size := dict(alternative_units(target_unit)).get(unit)) is not None:
            columns[k], scales[k] = target, Scale(CONTEXT.divide(size, dict(alternative_units(unit))[target_unit]))
    refuse(table.path, problems)
    if tuple(columns) == table.columns:
        return table
    rows = tuple(tuple(_scaled(cell, scale) for cell, scale in zip(row, scales, strict=True)) for row in table.rows)
    return replace(table, columns=tuple(columns), rows=rows)


def read_name(name: str) -> tuple[str, str]:
    """Name and unit of a column in tubeopt: "Rot1 [°]" is rotation_1 in deg."""
    match = re.fullmatch(r"(.*?)\s*[\[(/]\s*([^\])]+?)\s*[\])]?", name.strip())
    word, unit = (match[1], match[2]) if match else _with_unit(name)
    word = re.sub(r"[\s.\-]+", "_", word.strip().lower()).strip("_")
    # Rot1, rot_1 and rotation_1 are the same column.
    numbered = re.fullmatch(r"([a-z_]+?)_?(\d+)", word)
    base, number = (numbered[1], f"_{numbered[2]}") if numbered else (word, "")
    return NAMES.get(base, base) + number, SPELLED.get(unit.lower(), unit)


def _with_unit(name: str) -> tuple[str, str]:
    """Split the longest unit from the end of a name, after a blank or underscore: u_x and per_m of "u_x_per_m"."""
    parts = re.split(r"[_\s]+", name.strip())
    # From the longest ending on: "mm_per_s" would otherwise be read as "s".
    for k in range(1, len(parts)):
        unit = "_".join(parts[k:])
        unit = SPELLED.get(unit.lower(), unit)
        if unit in UNITS or any(True for _ in alternative_units(unit)):
            return "_".join(parts[:k]), unit
    return name, ""


class Scale(NamedTuple):
    """Conversion of units: number times size, minus zero."""

    size: Decimal = Decimal(1)
    zero: Decimal = Decimal(0)


AS_IT_IS = Scale()


def _scaled(cell: str, scale: Scale) -> str:
    """Convert the number in a cell to another unit; other text is unchanged."""
    value = parse_number(cell) if cell and scale != AS_IT_IS else cell
    if not isinstance(value, Decimal):
        return cell
    return str(CONTEXT.subtract(CONTEXT.multiply(decimal(value), scale.size), scale.zero))


def to_csv(columns: Sequence[str], rows: Iterable[Sequence[object]], comment: str = "") -> str:
    """Text of a CSV file: comment lines, header, rows."""
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    return head + "".join(",".join(map(str, cells)) + "\n" for cells in [columns, *rows])
