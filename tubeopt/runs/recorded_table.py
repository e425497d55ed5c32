"""Tables of measured positions from trackers and laboratories, and the meaning of their columns.

An export becomes a table with the columns `time`, `x_1`, `qw_1`, ... for the first tool or rigid body, and so on, in
the order of the file.

- NDI (Track, ToolBox, the recorders of the CAPI samples): one header line in which every tool has the columns Frame,
  State, Q0, Qx, Qy, Qz, Tx, Ty, Tz, separated by commas or tabs; positions in mm. Euler angles Rz, Ry and Rx may
  replace the quaternion: degrees, R = Rz Ry Rx. A tool is not visible if its state is not OK or Enabled, with the word
  MISSING or NDI's number for it, or with a quaternion of zeros. Spreadsheets write semicolons, decimal commas and units
  in the names of columns: `Tx (mm)`, `Rz [deg]`.
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

import numpy as np
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
# Positions in mm are below 1e5 and quaternions below 1, so any bound up to 1e28 separates them.
BAD_FLOAT = 1e20
"""NDI writes -3.697314e28 for a missing number."""

VISIBLE = ("ok", "enabled", "valid", "")
"""States of a visible NDI tool."""

LENGTHS = {"meters": "m", "metres": "m", "centimeters": "cm", "millimeters": "mm"}
"""Names of units of length in exports of Motive."""


@dataclass(frozen=True)
class Recorded:
    """Recorded table with the meaning of its columns."""

    table: CsvTable
    meaning: dict[str, str]
    """Name of a column -> "meaning, unit", as far as the header states it."""
    remarks: tuple[str, ...] = ()
    """Remarks on the content."""
    tools: tuple[str, ...] = ()
    """Names of the tools or rigid bodies, numbered from 1; empty if the file has none."""


def read_recorded(path: str | PathLike[str], frame_rate: float | None = None) -> Recorded:
    """Read the table of a CSV file or of a tracker export.

    Args:
        frame_rate: frame rate of an export without times, Hz.

    Raises:
        InputError: no such file, or a file of another format.
    """
    lines = decoded(read_bytes(path)).splitlines()
    separator = separator_of(lines[0]) if lines else ","
    first = [cell.strip() for cell in next(csv.reader(lines[:1], delimiter=separator), [])]
    # Only the header distinguishes NDI from a plain table: neither format has a signature.
    names = [_ndi_column(title)[0] for title in first]
    ndi = "tx" in names and ({*QUATERNIONS} <= {*names} or {*EULER} <= {*names})
    if not ndi and names[:1] != ["format version"]:
        return Recorded(read_csv(path), {})
    cells = list(csv.reader(lines, delimiter=separator))
    # Exports have many cells: they are searched for decimal commas only where there is a comma.
    if separator != "," and any("," in line for line in lines[1:]):
        cells = [cells[0], *with_points(path, cells[1:])]
    return _ndi(path, cells, frame_rate) if ndi else _optitrack(path, cells)


def _ndi_column(title: str) -> tuple[str, str]:
    """Split the title of an NDI column into its name in lower case and its unit: "Tx (mm)" is tx, mm."""
    match = re.fullmatch(r"\s*(.*?)\s*[\[(](.*?)[\])]\s*", title)
    name, unit = (match[1], match[2].strip()) if match else (title.strip(), "")
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
            visible = (state is None or padded[state].lower() in VISIBLE) and _is_pose(pose)
            # A tool that is not visible has no pose, whatever its cells contain.
            rows[-1] += pose if visible else [""] * 7
    names = ["time", *(f"{name}_{i + 1}" for i in range(len(tools)) for name in (*QUATERNION, "x", "y", "z"))]
    if not rows or not rows[0][0]:  # the file has no times
        rows, names = [row[1:] for row in rows], names[1:]
    recorded = _recorded(path, names, rows, lines, {"time": "s", **dict.fromkeys("xyz", length)})
    return replace(recorded, tools=tuple(_ndi_name(cells[0], cells[1:], header, k) for k in tools))


def _ndi_unit(
    path: str | PathLike[str], columns: Sequence[tuple[str, str]], names: Sequence[str], known: Sequence[str]
) -> str:
    """Unit in the titles of columns with these names; the first of `known` if they have none."""
    stated = dict.fromkeys(unit for name, unit in columns if name in names)
    if len(stated) > 1 or not {*stated} <= {"", *known}:
        shown = ", ".join(
            f"{name.title()} ({unit})" if unit else name.title() for name, unit in columns if name in names
        )
        raise InputError(f"{path}: the NDI export has columns {shown}; all must have one unit of {', '.join(known)}")
    return "".join(stated) or known[0]


def _ndi_name(titles: Sequence[str], rows: Sequence[Sequence[str]], header: Sequence[str], k: int) -> str:
    """Name of a tool: text in its column before Frame, or the title of that column."""
    frame = _before(header, k, ("frame",))
    if not frame:
        return ""

    cell = next((row[frame - 1].strip() for row in rows if len(row) >= frame), "")
    return cell or titles[frame - 1].strip()


def _quaternion_of(angles: dict[str, str], degrees: bool) -> list[str]:
    """Quaternion of Euler angles; a cell that is no number is returned unchanged."""
    try:
        # Capital letters are rotations about moving axes: R = Rz Ry Rx.
        rotation = Rotation.from_euler("ZYX", [float(angles[name]) for name in EULER], degrees=degrees)
    except ValueError:
        # The table reports this cell later, with row and column.
        return next(([cell] * 4 for cell in angles.values() if not _is_number(cell)), [""] * 4)
    return [repr(part) for part in rotation.as_quat(scalar_first=True).tolist()]


def _is_number(cell: str) -> bool:
    try:
        return math.isfinite(float(cell))
    except ValueError:
        return False


def _is_pose(cells: Sequence[str]) -> bool:
    """True unless the cells mark an invisible tool; cells that are no numbers are left to the table."""
    try:
        values = [float(cell) for cell in cells]
    except ValueError:
        return not any(cell.lower() == "missing" for cell in cells)
    # No rotation has a quaternion of zeros.
    return any(values[:4]) and max(map(abs, values)) < BAD_FLOAT


def _before(header: Sequence[str], k: int, names: Sequence[str]) -> int | None:
    """Nearest column before column k with one of these names, for the same tool."""
    # A tool has at most nine columns, so that the search does not reach the previous tool.
    return next((j for j in range(k - 1, max(k - 9, -1), -1) if header[j] in names), None)


def _ndi_time(where: str, row: Sequence[str], header: Sequence[str], k: int, frame_rate: float | None) -> str:
    seconds, part = (_before(header, k, (name,)) for name in ("timespec_s", "timespec_ns"))
    if seconds is not None and part is not None and row[seconds]:
        # As text: a float has 16 digits, and seconds since 1970 with ns need 19.
        return f"{row[seconds]}.{_whole(where, 'timespec_ns', row[part] or '0'):09d}"
    frame = _before(header, k, ("frame",))
    if frame is None or frame_rate is None or not row[frame]:
        return ""
    return repr(_whole(where, "Frame", row[frame]) / frame_rate)


def _whole(where: str, name: str, cell: str) -> int:
    """Whole number in a cell, also as 12.0 from a spreadsheet."""
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
    # Lines of type and name are recognised by their words, not by their line number.
    kind = next((row for row in cells[1:start] if any("rigid body" in cell.lower() for cell in row)), [])
    body = next((row for row in cells[1:start] if row and len(row) > 1 and row[1].strip().lower() == "name"), kind)
    # Number and meaning of the columns that are read.
    selected, tools = [(1, "time")], list[str]()
    for k in range(2, len(names)):
        if k >= len(kind) or kind[k].strip().lower() != "rigid body" or k >= len(quantity):
            continue
        if body[k] not in tools:
            tools.append(body[k])
        number, axis = tools.index(body[k]) + 1, names[k].strip().lower()
        if quantity[k].strip().lower() == "position" and axis in ("x", "y", "z"):
            selected.append((k, f"{axis}_{number}"))
        elif quantity[k].strip().lower() == "rotation" and facts.get("rotation type", "").lower() == "quaternion":
            selected.append((k, f"q{axis}_{number}"))
    if not tools:
        raise InputError(f"{path}: this export of OptiTrack has no rigid body; export the positions of rigid bodies")
    # Line numbers of the file, for messages.
    full = [(number, row) for number, row in enumerate(cells[start + 1 :], start=start + 2) if any(map(str.strip, row))]
    rows = [[row[k].strip() if k < len(row) else "" for k, _ in selected] for _, row in full]
    lines = [number for number, _ in full]
    recorded = _recorded(path, [name for _, name in selected], rows, lines, {"time": "s", **dict.fromkeys("xyz", unit)})
    recorded = replace(recorded, tools=tuple(tools))
    has_rotation = any(cell.strip().lower() == "rotation" for cell in quantity)
    if not has_rotation or any(name.startswith("q") for _, name in selected):
        return recorded
    kind_of_rotation = facts.get("rotation type", "") or "not named"
    remark = f"orientations are left out: Rotation Type is {kind_of_rotation}; export it as Quaternion to use them"
    return replace(recorded, remarks=(remark,))


def _recorded(
    path: str | PathLike[str], names: list[str], rows: list[list[str]], lines: list[int], units: dict[str, str]
) -> Recorded:
    if not rows:
        raise InputError(f"{path}: there are no rows below the header")
    meaning = {name: ", ".join([name, *filter(None, [units.get(name.split("_")[0])])]) for name in names}
    return Recorded(CsvTable(str(path), tuple(names), tuple(map(tuple, rows)), tuple(lines)), meaning)


# --- columns: times, joints, positions, orientations ------------------------------------------------------------------

NOTHING = ("", "nan", "na", "null")
"""Cells of missing measurements."""

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
"""Meanings of columns -> allowed units, the default first. I is the number of a tube for joint values, otherwise of a
sensor (default 1): position, quaternion, rotation vector, rotation matrix by rows, or z and x axes."""


@dataclass(frozen=True)
class Formula:
    """Sum of columns with factors, and a constant."""

    terms: tuple[tuple[str, Decimal], ...]
    """Pairs (column, factor in SI)."""
    constant: float = 0.0
    """SI."""


def formula_of(text: str, unit: Decimal, columns: Sequence[str], home: float | None) -> Formula:
    """Formula such as "0.5 * motor_1 - motor_2 + 12.5": a sum of columns with factors, numbers, and `home`.

    Args:
        unit: unit of the result and of its constants, in SI.   home: value of the word home, SI; None for none.

    Raises:
        ValueError: another text, or one without a column.
    """
    # Names of columns may have any sign in them: the longest that fits is taken.
    names = "|".join(re.escape(name) for name in sorted(columns, key=len, reverse=True))
    number = r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
    term = re.compile(rf"\s*([+-]?)\s*(?:({number})\s*\*\s*)?(?:({names})|(home)|({number}))\s*(?=[+-]|$)")
    terms, constant, at = [], 0.0, 0
    while at < len(text):
        match = term.match(text, at)
        if match is None or (at and not match[1]) or (match[4] and home is None):
            allowed = (
                "a sum of columns, of numbers and, for a translation, of home, each with a factor: 0.5 * a - b + 3"
            )
            raise ValueError(f"is {text!r}, and {text[at:].strip()!r} cannot be read; it must be {allowed}")
        factor = Decimal(match[2] or 1) * (-1 if match[1] == "-" else 1)
        if match[3]:
            terms.append((match[3], factor * unit))
        else:
            constant += float(factor) * (home or 0.0) if match[4] else float(factor * Decimal(match[5]) * unit)
        at = match.end()
    if not terms:
        raise ValueError(f"is {text!r}; it must name a column")
    return Formula(tuple(terms), constant)


@dataclass(frozen=True, eq=False)
class Columns:
    """Table with the meaning of its columns."""

    table: CsvTable
    known: Mapping[str, tuple[str, Decimal]]
    """Meaning -> name of the column, and its unit in SI, negative for a reversed sign."""
    formulas: Mapping[str, Formula]
    """Meaning -> formula of columns, for joint values."""
    reference: int | None = None
    """Number of the reference sensor; its frame is used in every row. None for the device frame."""

    def has(self, *meanings: str) -> bool:
        """True if every one of these meanings has a column."""
        return all(meaning in self.known or meaning in self.formulas for meaning in meanings)

    def numbers(self, meanings: Sequence[str], *, missing: bool = False) -> Array:
        """Numbers in SI, shape (rows, M); with `missing`, NaN for cells of `NOTHING`."""
        out = np.empty((len(self.table.rows), len(meanings)))
        for k, meaning in enumerate(meanings):
            formula = self.formulas.get(meaning) or Formula((self.known[meaning],))
            columns, units = zip(*formula.terms, strict=True)
            out[:, k] = self.table.numbers(columns, units, gaps=NOTHING if missing else ()).sum(1) + formula.constant
        return out

    def time(self) -> Array | None:
        """Times (rows,), s; None without such a column."""
        return self.numbers(["time"])[:, 0] if self.has("time") else None

    def translations(self, home: Array) -> Array:
        """Translations (rows, n), m; tubes without a column have those of `home` (n,)."""
        translations = np.tile(home, (len(self.table.rows), 1))
        for i in range(len(home)):
            if self.has(f"translation_{i + 1}"):
                translations[:, i] = self.numbers([f"translation_{i + 1}"])[:, 0]
        return translations

    def sensors(self) -> list[int]:
        """Numbers of the sensors with a position, except the reference."""
        numbers = {int(m[1]) for meaning in self.known if (m := re.fullmatch(r"[xyz]_(\d+)", meaning))}
        return sorted(numbers - {self.reference})

    def positions(self) -> Array:
        """Positions of the sensors (rows, S, 3), m; NaN if the sensor or the reference was not visible."""
        x = self._positions(self.sensors())
        if self.reference is None:
            return x
        R, o = self._reference_pose(self.reference)
        # p = R^T (x - o) in the frame of the reference, row by row.
        return np.asarray(np.einsum("rji,rsj->rsi", R, x - o))

    def unseen_reference(self) -> Mask:
        """Rows (rows,) without a pose of the reference."""
        if self.reference is None:
            return np.zeros(len(self.table.rows), dtype=bool)
        R, o = self._reference_pose(self.reference)
        return np.isnan(R[:, 0, 0]) | np.isnan(o[:, 0, 0])

    def orientation(self, sensor: int) -> Array | None:
        """Frames of a sensor (rows, 3, 3), NaN if it or the reference was not visible; None without such columns."""
        R_sensor = self._orientation(sensor)
        if R_sensor is None or self.reference is None:
            return R_sensor
        R, _ = self._reference_pose(self.reference)
        return np.asarray(np.swapaxes(R, 1, 2) @ R_sensor)

    def has_orientation(self, sensor: int) -> bool:
        """True if a sensor has columns for its orientation."""
        return self._orientation(sensor) is not None

    def _reference_pose(self, reference: int) -> tuple[Array, Array]:
        """Frames (rows, 3, 3) and positions (rows, 1, 3), m, of the reference in the device frame."""
        R = self._orientation(reference)
        assert R is not None
        return R, self._positions([reference])

    def _positions(self, sensors: Sequence[int]) -> Array:
        """Positions (rows, S, 3) of sensors in the device frame, m."""
        parts = [self.numbers([f"{axis}_{k}" for axis in "xyz"], missing=True) for k in sensors]
        for k, part in zip(sensors, parts, strict=True):
            for row in np.flatnonzero(np.isnan(part).any(1) & ~np.isnan(part).all(1)).tolist():
                for axis in "xyz":
                    column = self.known[f"{axis}_{k}"][0]
                    if self.table.cell(row, column).lower() in NOTHING:
                        self.table.complain(row, column, "is missing; a sensor has x, y and z, or none of them")
        return np.stack(parts, axis=1)

    def _orientation(self, sensor: int) -> Array | None:
        """Frames (rows, 3, 3) of a sensor in the device frame, NaN if it was not visible; None without such columns."""
        q = [f"{name}_{sensor}" for name in ("qx", "qy", "qz", "qw")]
        v = [f"{name}_{sensor}" for name in ("rx", "ry", "rz")]
        m = [f"r{i}{j}_{sensor}" for i in "123" for j in "123"]
        z, x = ([f"{axis}axis_{k}_{sensor}" for k in "xyz"] for axis in "zx")
        # Quaternions first, since trackers write them.
        for names, read in ((q, Rotation.from_quat), (v, Rotation.from_rotvec), (m, _from_rows)):
            if self.has(*names):
                return _matrices(self.numbers(names, missing=True), read)
        if self.has(*z):
            across = self.numbers(x, missing=True) if self.has(*x) else None
            return _frames_of_axes(self.numbers(z, missing=True), across)
        return None


def columns_of(
    table: CsvTable,
    meanings: Mapping[str, str],
    where: str,
    home: Sequence[float],
    formulas: Mapping[str, str] | None = None,
) -> Columns:
    """Assign meanings such as "rotation_1, deg" to the columns of a table; a leading minus reverses the sign.

    Args:
        home: (n,) value of the word home in formulas of translations, m.
        formulas: joint values from several columns: {"rotation_1": "0.5 * motor_1 - motor_2 + 12.5, deg"}.

    Raises:
        InputError: a missing column, an unknown meaning or unit, a meaning given twice.
    """
    problems, known = [], dict[str, tuple[str, Decimal]]()
    for column, text in meanings.items():
        meaning, _, unit = (part.strip() for part in text.partition(","))
        # Some devices count turns in the opposite direction.
        sign = -1 if meaning.startswith("-") else 1
        meaning = meaning.lstrip("-").strip()
        if meaning != "time" and not re.search(r"_\d+$", meaning):
            meaning = f"{meaning}_1"  # the first sensor
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
        elif meaning.startswith(("rotation_", "translation_")) and not 1 <= int(meaning.split("_")[1]) <= len(home):
            problems.append(f"columns.{column} is {text!r}; the robot has {len(home)} tubes")
        else:
            scale = units[unit or next(iter(units))] if units else ONE
            known[meaning] = column, scale if sign > 0 else scale.copy_negate()
    sums: dict[str, Formula] = {}
    for meaning, text in (formulas or {}).items():
        rule, _, unit = (part.strip() for part in text.rpartition(","))
        match = re.fullmatch(r"(rotation|translation)_([1-9]\d*)", meaning)
        units = MEANINGS[f"{match[1]}_I"] if match else NO_UNIT
        if match is None or int(match[2]) > len(home):
            problems.append(
                f"formulas.{meaning} is not known; it must be a rotation or translation of {len(home)} tubes"
            )
        elif meaning in known:
            problems.append(f"formulas.{meaning}: {meaning} is column {known[meaning][0]} already")
        elif unit not in units:
            problems.append(f"formulas.{meaning} is {text!r}; it must end with a comma and {', '.join(units)}")
        else:
            home_value = home[int(match[2]) - 1] if match[1] == "translation" else None
            try:
                sums[meaning] = formula_of(rule, units[unit], table.columns, home_value)
            except ValueError as error:
                problems.append(f"formulas.{meaning} {error}")
    refuse(where, problems)
    return Columns(table, known, sums)


def _matrices(table: Array, read: Callable[[Array], Rotation]) -> Array:
    """Rotation matrices (rows, 3, 3); NaN for missing rotations."""
    # A quaternion of zeros is a missing one; a rotation vector of zeros is a valid rotation.
    visible = np.isfinite(table).all(1) & (np.nan_to_num(table).any(1) | (table.shape[1] != 4))
    return _where(visible, lambda: read(table[visible]).as_matrix())


def _from_rows(table: Array) -> Rotation:
    return Rotation.from_matrix(table.reshape(-1, 3, 3))


def _frames_of_axes(z: Array, x: Array | None) -> Array:
    """Frames with the z axis `z` and the x axis in the plane of z and x.

    Any x axis if `x` is None.
    """
    visible = np.isfinite(z).all(1) & (np.linalg.norm(np.nan_to_num(z), axis=1) > 0)
    if x is not None:
        visible &= np.isfinite(x).all(1)

    def _frames() -> Array:
        e3 = z[visible] / np.linalg.norm(z[visible], axis=1, keepdims=True)
        # Without x, the unit vector most perpendicular to z gives the smallest rounding error.
        e1 = x[visible] if x is not None else np.eye(3)[np.argmin(np.abs(e3), axis=1)]
        # Gram-Schmidt: measured axes are perpendicular only up to noise.
        e1 = e1 - (e1 * e3).sum(1, keepdims=True) * e3
        e1 /= np.linalg.norm(e1, axis=1, keepdims=True)
        return np.stack([e1, np.cross(e3, e1), e3], axis=2)

    return _where(visible, _frames)


def _where(visible: Mask, frames: Callable[[], Array]) -> Array:
    """Frames in visible rows, NaN in the others."""
    out = np.full((len(visible), 3, 3), np.nan)
    if visible.any():
        out[visible] = frames()
    return out
