"""Measured tips and published tables of tip errors, in CSV. Columns carry their unit; the library behind is in SI."""

from __future__ import annotations

import re
from collections.abc import Sequence
from os import PathLike
from pathlib import Path

import numpy as np
import scipy

from ..arguments import typed
from ..errors import InputError, nearest
from ..files.csv_file import CsvTable, read_csv, refuse, to_csv
from ..files.files import write_text
from ..files.shipped import resolved
from ..files.units import DEG, MM, RAD, in_unit, to_si
from ..inverse.mirror import ASSIGNMENTS, mirror_rotations
from ..robots.eccentric import EccentricRobot
from ..robots.path_file import check_joints, joint_columns
from ..robots.robot import Robot
from ..typing import Array
from ..validation.comparison import ErrorTable
from ..validation.measurements import Measurements
from .measurement_columns import Columns, columns_of
from .measurement_map import load_mapped, measured
from .tracker_file import QUATERNION

MIRROR = {"direction_deg": "direction", "separation_deg": "separation"}
ASSIGNMENT, NOTE = "assignment", "note"
POSITION = ("x_mm", "y_mm", "z_mm")


@typed
def load_measurements(path: str | PathLike[str], robot: Robot) -> Measurements:
    """The measurements of `robot` in a CSV file, or those that a YAML file describes (see `load_mapped`).

    Columns:

    - `rotation_1_deg` to `rotation_n_deg`: rotations. For the mirror actuation of a one-segment eccentric robot
      `direction_deg`, `separation_deg` and optionally `assignment` replace them, or label the rows next to them.
    - `translation_1_mm` and so on: translations; home if absent.
    - `x_mm`, `y_mm`, `z_mm`, or `x1_mm`, `y1_mm`, `z1_mm`, `x2_mm`, ... for several sensors; empty where a sensor was
      not seen.
    - `time_s`; `qw`, `qx`, `qy`, `qz` of the (first) sensor; `note` for any text.

    An assignment "132" turns tube 1 by the direction, tube 3 by direction plus separation and tube 2 by direction minus
    separation; the default is "123". Rows without any sensor are left out and counted in the remarks.

    Raises:
        InputError: no such file, columns that are unknown or missing, or invalid cells: one line per problem, with row
            and column.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("thesis_etr")
        >>> tubeopt.load_measurements("synthetic_etr", robot).rotations.shape
        (48, 3)
    """
    path = resolved(path)
    if Path(path).suffix.lower() in (".yaml", ".yml"):
        return load_mapped(path, robot)
    joints = (name for columns in joint_columns(robot.n_tubes) for name in columns)
    table = read_csv(path, (*joints, *POSITION, *MIRROR, "time_s"))
    columns, mirrored = _columns(path, table, robot)
    check_joints(table, robot)
    table.check()
    labels = {name: table.numbers([c], DEG)[:, 0] for c, name in MIRROR.items() if c in table.columns}
    turned = _mirrored(table, **labels) if mirrored and len(labels) == 2 else None
    return measured(columns, columns, robot, (str(path), ""), turned=turned, labels=labels)


def _columns(path: str | PathLike[str], table: CsvTable, robot: Robot) -> tuple[Columns, bool]:
    """What the columns mean, and whether the rotations come from mirror actuation."""
    n = robot.n_tubes
    rotations = [f"rotation_{i + 1}_deg" for i in range(n)]
    translations = [f"translation_{i + 1}_mm" for i in range(n)]
    positions = [name for sensor in _sensors(table.columns) for name in sensor]
    turned = [name for name in QUATERNION if set(QUATERNION) & set(table.columns)]
    known = {*rotations, *translations, *positions, *MIRROR, ASSIGNMENT, NOTE, "time_s", *QUATERNION}
    problems = [f"column {c} is not known{nearest(c, known)}" for c in table.columns if c not in known]
    problems += [f"column {c} is missing" for c in (*positions, *turned) if c not in table.columns]
    mirrored = not any(c in table.columns for c in rotations) and any(c in table.columns for c in MIRROR)
    problems += [f"column {c} is missing" for c in (MIRROR if mirrored else rotations) if c not in table.columns]
    if mirrored and not isinstance(robot, EccentricRobot):
        problems.append(
            f"{' and '.join(MIRROR)} are for an eccentric robot of one segment; this robot needs "
            f"{rotations[0]} to {rotations[-1]}"
        )
    refuse(path, problems)
    meanings = {name: name.rsplit("_", 1)[0] + ", " + name.rsplit("_", 1)[1] for name in (*rotations, *translations)}
    meanings |= {name: f"{name[0]}_{name[1:-3] or 1}, mm" for name in positions}
    meanings |= {"time_s": "time, s", **{name: name for name in QUATERNION}}
    if "x_mm" not in table.columns and turned:
        first = _sensors(table.columns)[0][0][1:-3]
        meanings |= {name: f"{name}_{first}" for name in QUATERNION}
    return columns_of(table, {c: m for c, m in meanings.items() if c in table.columns}, str(path), n), mirrored


def _sensors(columns: Sequence[str]) -> list[tuple[str, str, str]]:
    """Names of the position columns of every sensor that the header speaks of."""
    found = sorted({int(match[1]) for c in columns if (match := re.fullmatch(r"[xyz]([1-9]\d*)_mm", c))})
    several = [(f"x{k}_mm", f"y{k}_mm", f"z{k}_mm") for k in found]
    plain = ("x_mm", "y_mm", "z_mm")
    return [plain, *several] if not several or any(c in columns for c in plain) else several


def _mirrored(table: CsvTable, direction: Array, separation: Array) -> Array:
    """(N, 3) rotations of the mirror actuation; bad assignments are noted in the table."""
    rows = zip(direction, separation, strict=True)
    return np.array([mirror_rotations(d, apart, _assignment(table, k)) for k, (d, apart) in enumerate(rows)])


def _assignment(table: CsvTable, row: int) -> tuple[int, ...]:
    """Tubes (from 0) that turn by the direction, by direction plus separation, and by direction minus separation."""
    if ASSIGNMENT not in table.columns:
        return ASSIGNMENTS[0]
    text = table.cell(row, ASSIGNMENT)
    if sorted(text) != ["1", "2", "3"]:
        table.complain(row, ASSIGNMENT, f"is {text!r}; it must be 123, 132, 213, 231, 312 or 321")
        return ASSIGNMENTS[0]
    return tuple(int(digit) - 1 for digit in text)


def save_measurements(measurements: Measurements, path: str | PathLike[str], comment: str = "") -> None:
    """Write measurements as CSV that `load_measurements` reads back, to the last bit but for orientations.

    Distances of sensors behind the tip, the sensor's axis and a log of the joints have no place in it.

    Raises:
        InputError: the file cannot be written.
    """
    m = measurements
    count = m.sensors.shape[1]
    names = [""] if count == 1 else [str(k + 1) for k in range(count)]
    blocks: list[tuple[list[str], Array]] = [
        ([f"rotation_{i + 1}_deg" for i in range(m.n_tubes)], m.rotations),
        ([f"translation_{i + 1}_mm" for i in range(m.n_tubes)], m.translations),
        ([f"{axis}{name}_mm" for name in names for axis in "xyz"], m.sensors.reshape(len(m), -1)),
    ]
    if m.time is not None:
        blocks.insert(0, (["time_s"], m.time[:, None]))
    if m.orientation is not None:
        turns = scipy.spatial.transform.Rotation.from_matrix(
            np.where(np.isnan(m.orientation), np.eye(3), m.orientation)
        )
        quaternion = np.where(np.isnan(m.orientation[:, :1, 0]), np.nan, turns.as_quat(scalar_first=True))
        blocks.append((list(QUATERNION), quaternion))
    blocks += [([c], v[:, None]) for c, v in zip(MIRROR, (m.direction, m.separation), strict=True) if v is not None]
    columns = [c for header, _ in blocks for c in header]
    values = np.hstack([block for _, block in blocks])
    units = [DEG if c.endswith("_deg") else MM if c.endswith("_mm") else RAD for c in columns]
    rows = [
        ["" if np.isnan(v) else in_unit(v, unit) for v, unit in zip(row, units, strict=True)] for row in values.tolist()
    ]
    write_text(path, to_csv(columns, rows, comment))


def load_error_table(path: str | PathLike[str]) -> ErrorTable:
    """A published table of tip errors: columns `separation_deg`, `error_at_D_deg_mm` for every direction D, `mean_mm`.

    A row for every separation, and a last one, `mean`, with the means over the separations.

    Raises:
        InputError: no such file, other columns, no last row of means, or cells that are not numbers.
    """
    table = read_csv(path)
    matches = [re.fullmatch(r"error_at_(-?\d+(?:\.\d+)?)_deg_mm", c) for c in table.columns[1:-1]]
    directions = [match[1] for match in matches if match]
    if table.columns[0] != "separation_deg" or table.columns[-1] != "mean_mm" or len(directions) < len(matches):
        raise InputError(f"{path}: the columns must be separation_deg, error_at_D_deg_mm for directions D, mean_mm")
    last = len(table.rows) - 1
    if table.cell(last, "separation_deg") != "mean" or last < 1:
        raise InputError(f"{path}: the last row must begin with mean, below a row for every separation")
    separation = np.array([to_si(table.number(k, "separation_deg"), DEG) for k in range(last)])
    values = table.numbers(table.columns[1:], MM)
    table.check()
    return ErrorTable(
        direction=np.radians([float(d) for d in directions]),
        separation=separation,
        error=values[:-1, :-1],
        mean_by_direction=values[-1, :-1],
        mean_by_separation=values[:-1, -1],
        mean=float(values[-1, -1]),
    )
