"""Tables of measured positions as trackers and laboratories write them, and the meaning of their columns.

An export becomes a table whose columns have meanings of their own: `time`, `x_1`, `qw_1`, ... for the first tool or
rigid body, and so on, in the order of the file.

- NDI (Track, ToolBox, the recorders of the CAPI samples): one header line in which every tool has the columns Frame,
  State, Q0, Qx, Qy, Qz, Tx, Ty, Tz, between commas or tabs; positions in mm. With Euler angles, Rz, Ry and Rx stand in
  place of the quaternion: degrees, R = Rz Ry Rx. Not seen is what has a state other than OK or Enabled, the word
  MISSING or NDI's number for it, or a quaternion of zeros. Spreadsheets write semicolons, decimal commas and units in
  the names of columns: `Tx (mm)`, `Rz [deg]`.
- OptiTrack Motive: "Format Version" in the first line with the units of length and the kind of rotation, then lines
  that name type, body and quantity of every column.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from os import PathLike
from typing import Any

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

from ..errors import InputError, nearest
from ..files.csv_file import CsvTable, decoded, read_csv, refuse, separator_of, with_points
from ..files.files import read_bytes
from ..files.units import DEG, MM
from ..typing import Array, Mask

# --- files: plain CSV, exports of NDI and OptiTrack -------------------------------------------------------------------

QUATERNIONS, EULER = ("q0", "qx", "qy", "qz"), ("rz", "ry", "rx")
"""Names of NDI for the parts of a rotation."""

QUATERNION = ("qw", "qx", "qy", "qz")
# Positions in mm are below 1e5 and quaternions below 1, so any bound up to 1e28 tells them apart.
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
    lines = decoded(read_bytes(path)).splitlines()
    separator = separator_of(lines[0]) if lines else ","
    first = [cell.strip() for cell in next(csv.reader(lines[:1], delimiter=separator), [])]
    # Only the header tells NDI from a plain table: neither format has a signature.
    names = [_ndi_column(title)[0] for title in first]
    ndi = "tx" in names and ("q0" in names or {*EULER} <= {*names})
    if not ndi and names[:1] != ["format version"]:
        return Recorded(read_csv(path), {})
    cells = list(csv.reader(lines, delimiter=separator))
    # Exports have many cells: they are searched for decimal commas only where there is a comma.
    if separator != "," and any("," in line for line in lines[1:]):
        cells = [cells[0], *with_points(path, cells[1:])]
    return _ndi(path, cells, frame_rate) if ndi else _optitrack(path, cells)


def _ndi_column(title: str) -> tuple[str, str]:
    """What NDI calls a column, in small letters, and the unit that its title names: tx and mm of "Tx (mm)"."""
    found = re.fullmatch(r"\s*(.*?)\s*[\[(](.*?)[\])]\s*", title)
    name, unit = (found[1], found[2].strip()) if found else (title.strip(), "")
    return name.lower().rstrip("# "), unit


def _ndi(path: str | PathLike[str], cells: list[list[str]], frame_rate: float | None) -> Recorded:
    columns = [_ndi_column(title) for title in cells[0]]
    header = [name for name, _ in columns]
    length = _ndi_unit(path, columns, ("tx", "ty", "tz"), tuple(LENGTH))
    degrees = _ndi_unit(path, columns, EULER, ("deg", "rad")) == "deg"
    angles = "q0" not in header
    # Every tool repeats its columns. The parts of its rotation, in any order, mark where it is.
    width = 3 if angles else 4
    tools = [
        k for k in range(len(header) - width + 1) if {*header[k : k + width]} == {*(EULER if angles else QUATERNIONS)}
    ]
    rows, lines = [], []
    for number, row in enumerate(cells[1:], start=2):
        # Recorders leave out empty cells at the end of a row.
        padded = [cell.strip() for cell in row] + [""] * (len(header) - len(row))
        if not any(padded):
            continue
        rows.append([_ndi_time(f"{path}: line {number}", padded, header, tools[0], frame_rate)])
        lines.append(number)
        for k in tools:
            state = _before(header, k, ("state", "transformstatus"))
            pose = padded[k : k + width + 3]
            if angles:
                pose = [*_quaternion_of(dict(zip(header[k : k + 3], pose, strict=False)), degrees), *pose[3:]]
            seen = (state is None or padded[state].lower() in SEEN) and _is_pose(pose)
            # A tool that is not seen has no pose, whatever its cells hold.
            rows[-1] += pose if seen else [""] * 7
    names = ["time", *(f"{name}_{i + 1}" for i in range(len(tools)) for name in (*QUATERNION, "x", "y", "z"))]
    if not rows or not rows[0][0]:  # nothing to tell the time by
        rows, names = [row[1:] for row in rows], names[1:]
    found = _recorded(path, names, rows, lines, {"time": "s", **dict.fromkeys("xyz", length)})
    return replace(found, tools=tuple(_ndi_name(cells[0], cells[1:], header, k) for k in tools))


def _ndi_unit(
    path: str | PathLike[str], columns: Sequence[tuple[str, str]], names: Sequence[str], known: Sequence[str]
) -> str:
    """The unit that the titles of columns with these names state, the first that is known where they state none."""
    stated = dict.fromkeys(unit for name, unit in columns if name in names)
    if len(stated) > 1 or not {*stated} <= {"", *known}:
        shown = ", ".join(
            f"{name.title()} ({unit})" if unit else name.title() for name, unit in columns if name in names
        )
        raise InputError(f"{path}: the NDI export has columns {shown}; all must have one unit of {', '.join(known)}")
    return "".join(stated) or known[0]


def _ndi_name(titles: Sequence[str], rows: Sequence[Sequence[str]], header: Sequence[str], k: int) -> str:
    """What the columns of a tool before its quaternion call it: text in the column that begins them, or its title."""
    frame = _before(header, k, ("frame",))
    if not frame:
        return ""
    # The column before Frame holds the name of the tool, in its cells or as its title.
    cell = next((row[frame - 1].strip() for row in rows if len(row) >= frame), "")
    return cell or titles[frame - 1].strip()


def _quaternion_of(angles: dict[str, str], degrees: bool) -> list[str]:
    """The quaternion of Euler angles; words in place of a number are left to the table."""
    try:
        # Capital letters are turns about moving axes: R = Rz Ry Rx.
        turn = Rotation.from_euler("ZYX", [float(angles[name]) for name in EULER], degrees=degrees)
    except ValueError:
        # The word goes on as it is: the table complains of it, with row and column.
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
    # No rotation has a quaternion of zeros.
    return any(values[:4]) and max(map(abs, values)) < BAD_FLOAT


def _before(header: Sequence[str], k: int, names: Sequence[str]) -> int | None:
    """The nearest column with one of these names before column k, of the same tool."""
    # A tool has at most nine columns, so that the search does not reach the tool before.
    return next((j for j in range(k - 1, max(k - 9, -1), -1) if header[j] in names), None)


def _ndi_time(where: str, row: Sequence[str], header: Sequence[str], k: int, frame_rate: float | None) -> str:
    whole, part = (_before(header, k, (name,)) for name in ("timespec_s", "timespec_ns"))
    if whole is not None and part is not None and row[whole]:
        # As text: a float has 16 digits, and seconds since 1970 with ns need 19.
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
    # The first line alternates names and values.
    facts = {key.lower(): value for key, value in zip(head[::2], head[1::2], strict=False)}
    unit = LENGTHS.get(facts.get("length units", "meters").lower())
    if unit is None:
        raise InputError(f"{path}: Length Units is {facts['length units']!r}; it must be {', '.join(LENGTHS)}")
    start = next((k for k, row in enumerate(cells) if len(row) > 1 and row[1].strip().lower().startswith("time")), None)
    if start is None or start < 3:
        raise InputError(f"{path}: this export of OptiTrack has no line that names the columns Frame and Time")
    quantity, names = cells[start - 1], cells[start]
    # Lines of type and name are found by their words, not by their place.
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
    # Numbers are lines of the file, for messages.
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


# --- columns: times, joints, positions, orientations ------------------------------------------------------------------

NOTHING = ("", "nan", "na", "null")
"""What a cell says where nothing was measured."""

ONE = Decimal(1)
TIME = {"s": ONE, "ms": Decimal("1e-3"), "us": Decimal("1e-6"), "ns": Decimal("1e-9")}
LENGTH = {"mm": MM, "m": ONE, "cm": Decimal("1e-2"), "um": Decimal("1e-6")}
ANGLE = {"deg": DEG, "rad": ONE, "turn": 360 * DEG}

NO_UNIT: dict[str, Decimal] = {}

MEANINGS = {
    "time": TIME,
    "rotation_I": ANGLE,
    "translation_I": LENGTH,
    **dict.fromkeys(("x_I", "y_I", "z_I"), LENGTH),
    **{f"q{part}_I": NO_UNIT for part in "wxyz"},
    **dict.fromkeys(("rx_I", "ry_I", "rz_I"), ANGLE),
    **{f"r{i}{j}_I": NO_UNIT for i in "123" for j in "123"},
    **{f"{axis}axis_{k}_I": NO_UNIT for axis in "zx" for k in "xyz"},
}
"""What a column may hold, and its units, the first where none is given: joint values of tube I; of sensor I (without a
number, of sensor 1) position, quaternion, rotation vector, rotation matrix by rows, or its z and x axes."""


@dataclass(frozen=True, eq=False)
class Columns:
    """A table with the meaning of its columns."""

    table: CsvTable
    known: Mapping[str, tuple[str, Decimal]]
    """Meaning -> column, and what one of its unit is in SI, sign included."""
    reference: int | None = None
    """Number of the sensor in whose frame all others are, row by row; None for that of the device."""

    def has(self, *meanings: str) -> bool:
        """Whether there is a column for each of these."""
        return all(meaning in self.known for meaning in meanings)

    def numbers(self, meanings: Sequence[str], *, missing: bool = False) -> Array:
        """(rows, M) numbers in SI; with `missing`, NaN where a cell is empty or NaN."""
        columns, units = zip(*(self.known[meaning] for meaning in meanings), strict=True)
        return self.table.numbers(columns, units, gaps=NOTHING if missing else ())

    def time(self) -> Array | None:
        """(rows,) s; None where no column has it."""
        return self.numbers(["time"])[:, 0] if self.has("time") else None

    def translations(self, home: Array) -> Array:
        """(rows, n) m; those of `home` (n,) where there is no column."""
        found = np.tile(home, (len(self.table.rows), 1))
        for i in range(len(home)):
            if self.has(f"translation_{i + 1}"):
                found[:, i] = self.numbers([f"translation_{i + 1}"])[:, 0]
        return found

    def sensors(self) -> list[int]:
        """Numbers of the sensors that have a position, the reference left out."""
        found = {int(m[1]) for meaning in self.known if (m := re.fullmatch(r"[xyz]_(\d+)", meaning))}
        return sorted(found - {self.reference})

    def positions(self) -> Array:
        """(rows, S, 3) positions, m; NaN where a sensor was not seen, which takes all three cells, or the reference."""
        found = self._positions(self.sensors())
        if self.reference is None:
            return found
        turn, place = self._orientation(self.reference), self._positions([self.reference])
        assert turn is not None
        # p = R^T (x - o) in the frame of the reference, row by row.
        return np.asarray(np.einsum("rji,rsj->rsi", turn, found - place))

    def unseen_reference(self) -> Mask:
        """(rows,) where there is no pose of the reference."""
        if self.reference is None:
            return np.zeros(len(self.table.rows), dtype=bool)
        turn, place = self._orientation(self.reference), self._positions([self.reference])
        assert turn is not None
        return np.isnan(turn[:, 0, 0]) | np.isnan(place[:, 0, 0])

    def orientation(self, sensor: int) -> Array | None:
        """(rows, 3, 3) frames of a sensor, NaN where it or the reference was not seen; None where no columns tell."""
        turn = self._orientation(sensor)
        if turn is None or self.reference is None:
            return turn
        base = self._orientation(self.reference)
        assert base is not None
        # R_reference^T R_sensor.
        return np.asarray(np.swapaxes(base, 1, 2) @ turn)

    def turns(self, sensor: int) -> bool:
        """Whether columns tell the orientation of a sensor."""
        return self._orientation(sensor) is not None

    def _positions(self, sensors: Sequence[int]) -> Array:
        """(rows, S, 3) positions of sensors in the frame of the device, m."""
        parts = [self.numbers([f"{axis}_{k}" for axis in "xyz"], missing=True) for k in sensors]
        for k, part in zip(sensors, parts, strict=True):
            for row in np.flatnonzero(np.isnan(part).any(1) & ~np.isnan(part).all(1)).tolist():
                for axis in "xyz":
                    column = self.known[f"{axis}_{k}"][0]
                    if self.table.cell(row, column).lower() in NOTHING:
                        self.table.complain(row, column, "is missing; a sensor has x, y and z, or none of them")
        return np.stack(parts, axis=1)

    def _orientation(self, sensor: int) -> Array | None:
        """(rows, 3, 3) frames of a sensor in that of the device, NaN where it was not seen; None for no columns."""
        q = [f"{name}_{sensor}" for name in ("qx", "qy", "qz", "qw")]
        v = [f"{name}_{sensor}" for name in ("rx", "ry", "rz")]
        m = [f"r{i}{j}_{sensor}" for i in "123" for j in "123"]
        z, x = ([f"{axis}axis_{k}_{sensor}" for k in "xyz"] for axis in "zx")
        turn = scipy.spatial.transform.Rotation
        # One description suffices; quaternions go first, since trackers write them.
        for names, read in ((q, turn.from_quat), (v, turn.from_rotvec), (m, _from_rows)):
            if self.has(*names):
                return _matrices(self.numbers(names, missing=True), read)
        if self.has(*z):
            across = self.numbers(x, missing=True) if self.has(*x) else None
            return _of_axes(self.numbers(z, missing=True), across)
        return None


def columns_of(table: CsvTable, meanings: Mapping[str, str], where: str, tubes: int) -> Columns:
    """The columns that `meanings` ("rotation_1, deg") speak of; a leading minus turns the sign.

    Raises:
        InputError: a column that is not there, a meaning or unit that is unknown, one that is given twice.
    """
    problems, known = [], dict[str, tuple[str, Decimal]]()
    for column, text in meanings.items():
        meaning, _, unit = (part.strip() for part in text.partition(","))
        # Some devices count turns in the opposite direction.
        sign = -1 if meaning.startswith("-") else 1
        meaning = _numbered(meaning.lstrip("-").strip())
        units = MEANINGS.get(re.sub(r"_\d+$", "_I", meaning))
        if column not in table.columns:
            problems.append(f"columns: {table.path} has no column {column}{nearest(column, table.columns)}")
        elif units is None:
            problems.append(
                f"columns.{column} is {text!r}; it must be one of {', '.join(MEANINGS)}{nearest(meaning, MEANINGS)}"
            )
        elif unit and unit not in units:
            allowed = f"it must be {', '.join(units)}" if units else "it has none"
            problems.append(f"columns.{column}: the unit of {meaning} is {unit!r}; {allowed}")
        elif meaning in known:
            problems.append(f"columns.{column}: {meaning} is column {known[meaning][0]} already")
        elif meaning.startswith(("rotation_", "translation_")) and not 1 <= int(meaning.split("_")[1]) <= tubes:
            problems.append(f"columns.{column} is {text!r}; the robot has {tubes} tubes")
        else:
            scale = units[unit or next(iter(units))] if units else ONE
            known[meaning] = column, scale if sign > 0 else scale.copy_negate()
    refuse(where, problems)
    return Columns(table, known)


def _numbered(meaning: str) -> str:
    """With the number of its sensor: x is x_1."""
    return meaning if meaning == "time" or re.search(r"_\d+$", meaning) else f"{meaning}_1"


def _matrices(table: Array, read: Callable[[Array], Any]) -> Array:
    """(rows, 3, 3) of rotations; NaN where one is missing, or a quaternion 0."""
    # Four columns are a quaternion; a rotation vector of zeros is a valid rotation.
    seen = np.isfinite(table).all(1) & (np.nan_to_num(table).any(1) | (table.shape[1] != 4))
    return _where(seen, lambda: read(table[seen]).as_matrix())


def _from_rows(table: Array) -> Any:
    return scipy.spatial.transform.Rotation.from_matrix(table.reshape(-1, 3, 3))


def _of_axes(z: Array, x: Array | None) -> Array:
    """Frames with this z axis, and the x axis in the plane of z and x; any x where none is given."""
    seen = np.isfinite(z).all(1) & (np.linalg.norm(np.nan_to_num(z), axis=1) > 0)
    if x is not None:
        seen &= np.isfinite(x).all(1)

    def _frames() -> Array:
        along = z[seen] / np.linalg.norm(z[seen], axis=1, keepdims=True)
        # Without x any direction does. The unit vector most perpendicular to z divides by the largest number.
        across = x[seen] if x is not None else np.eye(3)[np.argmin(np.abs(along), axis=1)]
        # Gram-Schmidt: measured axes are perpendicular only up to noise.
        across = across - (across * along).sum(1, keepdims=True) * along
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        return np.stack([across, np.cross(along, across), along], axis=2)

    return _where(seen, _frames)


def _where(seen: Mask, frames: Callable[[], Array]) -> Array:
    out = np.full((len(seen), 3, 3), np.nan)
    if seen.any():
        out[seen] = frames()
    return out
