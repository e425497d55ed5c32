"""What the columns of a recorded table mean, and the arrays that they hold: times, joints, positions, orientations."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

import numpy as np
import scipy

from ..errors import nearest
from ..files.csv_file import CsvTable, refuse
from ..files.units import DEG, MM
from ..typing import Array, Mask

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
        for names, read in ((q, turn.from_quat), (v, turn.from_rotvec), (m, _from_rows)):
            if self.has(*names):
                return _turned(self.numbers(names, missing=True), read)
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


def _turned(table: Array, read: Callable[[Array], Any]) -> Array:
    """(rows, 3, 3) of rotations; NaN where one is missing, or a quaternion 0."""
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
        across = x[seen] if x is not None else np.eye(3)[np.argmin(np.abs(along), axis=1)]
        across = across - (across * along).sum(1, keepdims=True) * along
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        return np.stack([across, np.cross(along, across), along], axis=2)

    return _where(seen, _frames)


def _where(seen: Mask, frames: Callable[[], Array]) -> Array:
    out = np.full((len(seen), 3, 3), np.nan)
    if seen.any():
        out[seen] = frames()
    return out
