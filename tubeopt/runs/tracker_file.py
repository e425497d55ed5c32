"""Tables of measured positions as trackers and laboratories write them: plain CSV, exports of NDI and OptiTrack.

An export becomes a table whose columns have meanings of their own: `time`, `x_1`, `qw_1`, ... for the first tool or
rigid body, and so on, in the order of the file.

- NDI (Track, ToolBox, the recorders of the CAPI samples): one header line in which every tool has the columns Frame,
  State, Q0, Qx, Qy, Qz, Tx, Ty, Tz, between commas or tabs; positions in mm. With Euler angles, Rz, Ry and Rx stand in
  place of the quaternion: degrees, R = Rz Ry Rx. Not seen is what has a state other than OK or Enabled, the word
  MISSING or NDI's number for it, or a quaternion of zeros.
- OptiTrack Motive: "Format Version" in the first line with the units of length and the kind of rotation, then lines
  that name type, body and quantity of every column.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike

from scipy.spatial.transform import Rotation

from ..errors import InputError
from ..files.csv_file import CsvTable, read_csv
from ..files.files import read_text

QUATERNIONS, EULER = ("q0", "qx", "qy", "qz"), ("rz", "ry", "rx")
"""Names of NDI for the parts of a rotation."""

QUATERNION = ("qw", "qx", "qy", "qz")
BAD_FLOAT = 1e20
"""NDI writes -3.697314e28 for a number that there is not."""

SEEN = ("ok", "enabled", "valid", "")
"""States in which an NDI tool is seen."""

LENGTHS = {"meters": "m", "metres": "m", "centimeters": "cm", "millimeters": "mm"}
"""Units of length that Motive names."""


@dataclass(frozen=True)
class Recorded:
    """A table as it was recorded."""

    table: CsvTable
    meaning: dict[str, str]
    """Name of a column -> "meaning, unit": the header says it, or nothing does."""
    remarks: tuple[str, ...] = ()
    """What was noticed when it was read."""
    tools: tuple[str, ...] = ()
    """Names of the tools or rigid bodies, in the order of their numbers from 1; empty where the file has none."""


def read_recorded(path: str | PathLike[str], frame_rate: float | None = None) -> Recorded:
    """The table in a CSV file or an export.

    Args:
        frame_rate: Hz, for exports that count frames and give no time.

    Raises:
        InputError: no such file, or a file that is none of these.
    """
    lines = read_text(path).removeprefix("\N{ZERO WIDTH NO-BREAK SPACE}").splitlines()
    tabs = bool(lines) and "\t" in lines[0] and "," not in lines[0]
    cells = list(csv.reader(lines, delimiter="\t" if tabs else ","))
    first = [cell.strip() for cell in cells[0]] if cells else []
    if first and first[0].lower() == "format version":
        return _optitrack(path, cells)
    lowered = [cell.lower() for cell in first]
    if "tx" in lowered and ("q0" in lowered or {*EULER} <= {*lowered}):
        return _ndi(path, cells, frame_rate)
    return Recorded(read_csv(path), {})


def _ndi(path: str | PathLike[str], cells: list[list[str]], frame_rate: float | None) -> Recorded:
    header = [cell.strip().lower().rstrip("#") for cell in cells[0]]
    angles = "q0" not in header
    width = 3 if angles else 4
    tools = [
        k for k in range(len(header) - width + 1) if {*header[k : k + width]} == {*(EULER if angles else QUATERNIONS)}
    ]
    rows, lines = [], []
    for number, row in enumerate(cells[1:], start=2):
        padded = [cell.strip() for cell in row] + [""] * (len(header) - len(row))
        if not any(padded):
            continue
        rows.append([_ndi_time(f"{path}: line {number}", padded, header, tools[0], frame_rate)])
        lines.append(number)
        for k in tools:
            state = _before(header, k, ("state", "transformstatus"))
            pose = padded[k : k + width + 3]
            if angles:
                pose = [*_turned(dict(zip(header[k : k + 3], pose, strict=False))), *pose[3:]]
            seen = (state is None or padded[state].lower() in SEEN) and _is_pose(pose)
            rows[-1] += pose if seen else [""] * 7
    names = ["time", *(f"{name}_{i + 1}" for i in range(len(tools)) for name in (*QUATERNION, "x", "y", "z"))]
    if not rows or not rows[0][0]:  # nothing to tell the time by
        rows, names = [row[1:] for row in rows], names[1:]
    found = _recorded(path, names, rows, lines, {"time": "s", "x": "mm", "y": "mm", "z": "mm"})
    return replace(found, tools=tuple(_ndi_name(cells[0], cells[1:], header, k) for k in tools))


def _ndi_name(titles: Sequence[str], rows: Sequence[Sequence[str]], header: Sequence[str], k: int) -> str:
    """What the columns of a tool before its quaternion call it: text in the column that begins them, or its title."""
    frame = _before(header, k, ("frame",))
    if not frame:
        return ""
    cell = next((row[frame - 1].strip() for row in rows if len(row) >= frame), "")
    return cell or titles[frame - 1].strip()


def _turned(angles: dict[str, str]) -> list[str]:
    """The quaternion of Euler angles in deg; words in place of a number are left to the table."""
    try:
        turn = Rotation.from_euler("ZYX", [float(angles[name]) for name in EULER], degrees=True)
    except ValueError:
        return next(([cell] * 4 for cell in angles.values() if not _is_number(cell)), [""] * 4)
    x, y, z, w = turn.as_quat().tolist()
    return [repr(each) for each in (w, x, y, z)]


def _is_number(cell: str) -> bool:
    try:
        return math.isfinite(float(cell))
    except ValueError:
        return False


def _is_pose(cells: Sequence[str]) -> bool:
    """Whether quaternion and position are ones that NDI writes for a tool that it sees; words are left to the table."""
    try:
        values = [float(cell) for cell in cells]
    except ValueError:
        return not any(cell.lower() == "missing" for cell in cells)
    return any(values[:4]) and max(map(abs, values)) < BAD_FLOAT


def _before(header: Sequence[str], k: int, names: Sequence[str]) -> int | None:
    """The nearest column with one of these names before column k, of the same tool."""
    return next((j for j in range(k - 1, max(k - 9, -1), -1) if header[j] in names), None)


def _ndi_time(where: str, row: Sequence[str], header: Sequence[str], k: int, frame_rate: float | None) -> str:
    whole, part = (_before(header, k, (name,)) for name in ("timespec_s", "timespec_ns"))
    if whole is not None and part is not None and row[whole]:
        return f"{row[whole]}.{_whole(where, 'timespec_ns', row[part] or '0'):09d}"
    frame = _before(header, k, ("frame",))
    if frame is None or frame_rate is None or not row[frame]:
        return ""
    return repr(_whole(where, "Frame", row[frame]) / frame_rate)


def _whole(where: str, name: str, cell: str) -> int:
    """A whole number of a cell, also one that a spreadsheet wrote as 12.0."""
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not value.is_integer():
        raise InputError(f"{where}, column {name} is {cell!r}; it must be a whole number")
    return int(value)


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
    found = _recorded(path, [name for _, name in wanted], rows, lines, {"time": "s", "x": unit, "y": unit, "z": unit})
    found = replace(found, tools=tuple(tools))
    turned = any(cell.strip().lower() == "rotation" for cell in quantity)
    if not turned or any(name.startswith("q") for _, name in wanted):
        return found
    kind_of_rotation = facts.get("rotation type", "") or "not named"
    told = f"orientations are left out: Rotation Type is {kind_of_rotation}; export it as Quaternion to use them"
    return replace(found, remarks=(told,))


def _recorded(
    path: str | PathLike[str], names: list[str], rows: list[list[str]], lines: list[int], units: dict[str, str]
) -> Recorded:
    if not rows:
        raise InputError(f"{path}: there are no rows below the header")
    meaning = {name: ", ".join([name, *filter(None, [units.get(name.split("_")[0])])]) for name in names}
    return Recorded(CsvTable(str(path), tuple(names), tuple(map(tuple, rows)), tuple(lines)), meaning)
