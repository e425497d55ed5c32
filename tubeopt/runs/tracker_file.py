"""Tables of measured positions as trackers and laboratories write them: plain CSV, exports of NDI and OptiTrack.

An export becomes a table whose columns have meanings of their own: `time`, `x_1`, `qw_1`, ... for the first tool or
rigid body, and so on, in the order of the file.

- NDI (Track, ToolBox, the recorders of the CAPI samples): one header line in which every tool has the columns Frame,
  State, Q0, Qx, Qy, Qz, Tx, Ty, Tz; positions in mm; a state other than OK or Enabled is not seen.
- OptiTrack Motive: "Format Version" in the first line with the units of length and the kind of rotation, then lines
  that name type, body and quantity of every column.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike

from ..errors import InputError
from ..files.csv_file import CsvTable, read_csv
from ..files.files import read_text

QUATERNION = ("qw", "qx", "qy", "qz")
SEEN = ("ok", "enabled", "valid", "")
"""States in which an NDI tool is seen."""

LENGTHS = {"meters": "m", "metres": "m", "centimeters": "cm", "millimeters": "mm"}
"""Units of length that Motive names."""


@dataclass(frozen=True)
class Recorded:
    """A table, and what its columns mean: name -> "meaning, unit". The header says it, or nothing does."""

    table: CsvTable
    meaning: dict[str, str]


def read_recorded(path: str | PathLike[str], frame_rate: float | None = None) -> Recorded:
    """The table in a CSV file or an export.

    Args:
        frame_rate: Hz, for exports that count frames and give no time.

    Raises:
        InputError: no such file, or a file that is none of these.
    """
    cells = list(csv.reader(read_text(path).removeprefix("\N{ZERO WIDTH NO-BREAK SPACE}").splitlines()))
    first = [cell.strip() for cell in cells[0]] if cells else []
    if first and first[0].lower() == "format version":
        return _optitrack(path, cells)
    lowered = [cell.lower() for cell in first]
    if "q0" in lowered and "tx" in lowered:
        return _ndi(path, cells, frame_rate)
    return Recorded(read_csv(path), {})


def _ndi(path: str | PathLike[str], cells: list[list[str]], frame_rate: float | None) -> Recorded:
    header = [cell.strip().lower().rstrip("#") for cell in cells[0]]
    tools = [k for k, name in enumerate(header) if name == "q0"]
    rows, lines = [], []
    for number, row in enumerate(cells[1:], start=2):
        padded = [cell.strip() for cell in row] + [""] * (len(header) - len(row))
        if not any(padded):
            continue
        rows.append([_ndi_time(padded, header, tools[0], frame_rate)])
        lines.append(number)
        for k in tools:
            state = _before(header, k, ("state", "transformstatus"))
            seen = state is None or padded[state].lower() in SEEN
            rows[-1] += padded[k : k + 7] if seen else [""] * 7
    names = ["time", *(f"{name}_{i + 1}" for i in range(len(tools)) for name in (*QUATERNION, "x", "y", "z"))]
    if not rows or not rows[0][0]:  # nothing to tell the time by
        rows, names = [row[1:] for row in rows], names[1:]
    return _recorded(path, names, rows, lines, {"time": "s", "x": "mm", "y": "mm", "z": "mm"})


def _before(header: Sequence[str], k: int, names: Sequence[str]) -> int | None:
    """The nearest column with one of these names before column k, of the same tool."""
    return next((j for j in range(k - 1, max(k - 9, -1), -1) if header[j] in names), None)


def _ndi_time(row: Sequence[str], header: Sequence[str], k: int, frame_rate: float | None) -> str:
    whole, part = (_before(header, k, (name,)) for name in ("timespec_s", "timespec_ns"))
    if whole is not None and part is not None and row[whole]:
        return f"{row[whole]}.{int(row[part] or 0):09d}"
    frame = _before(header, k, ("frame",))
    if frame is None or frame_rate is None or not row[frame]:
        return ""
    return repr(int(row[frame]) / frame_rate)


def _optitrack(path: str | PathLike[str], cells: list[list[str]]) -> Recorded:
    head = [cell.strip() for cell in cells[0]]
    facts = {key.lower(): value for key, value in zip(head[::2], head[1::2], strict=False)}
    unit = LENGTHS.get(facts.get("length units", "meters").lower())
    if unit is None:
        raise InputError(f"{path}: Length Units is {facts['length units']!r}; it must be {', '.join(LENGTHS)}")
    start = next((k for k, row in enumerate(cells) if len(row) > 1 and row[1].strip().lower().startswith("time")), None)
    if start is None or start < 3:
        raise InputError(f"{path}: this export of OptiTrack has no line that names the columns Frame and Time")
    quantity, names = cells[start - 1], cells[start]
    kind = next((row for row in cells[1:start] if any("rigid body" in cell.lower() for cell in row)), [])
    body = next((row for row in cells[1:start] if row and len(row) > 1 and row[1].strip().lower() == "name"), kind)
    wanted, tools = [(1, "time")], list[str]()
    for k in range(2, len(names)):
        if k >= len(kind) or kind[k].strip().lower() != "rigid body" or k >= len(quantity):
            continue
        if body[k] not in tools:
            tools.append(body[k])
        number, axis = tools.index(body[k]) + 1, names[k].strip().lower()
        if quantity[k].strip().lower() == "position" and axis in ("x", "y", "z"):
            wanted.append((k, f"{axis}_{number}"))
        elif quantity[k].strip().lower() == "rotation" and facts.get("rotation type", "").lower() == "quaternion":
            wanted.append((k, f"q{axis}_{number}"))
    if not tools:
        raise InputError(f"{path}: this export of OptiTrack has no rigid body; export the positions of rigid bodies")
    kept = [(number, row) for number, row in enumerate(cells[start + 1 :], start=start + 2) if any(map(str.strip, row))]
    rows = [[row[k].strip() if k < len(row) else "" for k, _ in wanted] for _, row in kept]
    lines = [number for number, _ in kept]
    return _recorded(path, [name for _, name in wanted], rows, lines, {"time": "s", "x": unit, "y": unit, "z": unit})


def _recorded(
    path: str | PathLike[str], names: list[str], rows: list[list[str]], lines: list[int], units: dict[str, str]
) -> Recorded:
    if not rows:
        raise InputError(f"{path}: there are no rows below the header")
    meaning = {name: ", ".join([name, *filter(None, [units.get(name.split("_")[0])])]) for name in names}
    return Recorded(CsvTable(str(path), tuple(names), tuple(map(tuple, rows)), tuple(lines)), meaning)
