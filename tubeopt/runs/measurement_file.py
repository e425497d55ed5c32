"""Files of measurements: CSV with columns of tubeopt, tables of other programs mapped by a YAML file, published tables.

Wrapped angles are unwrapped, and implausible units are reported.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import scipy
from pydantic import BeforeValidator, Field

from ..arguments import typed
from ..errors import InputError, nearest
from ..files.checked import Entry, NotNegative, Positive, check
from ..files.csv_file import CsvTable, read_csv, refuse, to_csv
from ..files.files import write_text
from ..files.shipped import resolve_file
from ..files.units import DEG, MM, RAD, in_unit, shown, to_si
from ..files.yaml_file import load_yaml
from ..inverse.mirror import ASSIGNMENTS, mirror_rotations
from ..robots.eccentric import EccentricRobot, SheathedRobot, sheath_inner_diameter
from ..robots.file import check_joints, joint_columns
from ..robots.robot import Robot
from ..typing import Array, Mask
from ..validation.comparison import ErrorTable
from ..validation.measurements import SAME_POSITION, JointLog, Measurements, Timeline, unwrapped
from .recorded_table import QUATERNION, Columns, Recorded, columns_of, read_recorded

# --- tables mapped by a YAML file -------------------------------------------------------------------------------------

AXES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1), "-x": (-1, 0, 0), "-y": (0, -1, 0), "-z": (0, 0, -1)}

# Tips of an arm of length L spread by at most 2 sqrt(3) L. Metres taken for millimetres change that by 1000, so half or
# twice these bounds separate the two as well.
SMALL, LARGE = 0.02, 8.0
"""Smallest and largest plausible spread of moving tips, as a fraction of the arm's length."""

MOVING_ROTATION = 0.3
"""Range of a rotation above which the tip must move, rad."""

TRACKER_NOISE = 2e-3
"""Tolerance on the distance of two sensors on one piece of the arm, m."""

# Trackers record 10 to 1000 rows a second. Times in ms that are read as s are 1 to 100 s apart.
MAX_PERIOD = 1.0
"""Longest plausible time between two rows of a moving arm, s."""

# On a path, a step is a small fraction of the range; in random order it is a third of it on average.
PATH_STEP, PATH_ROWS = 0.1, 20
"""Criterion of a path: at least PATH_ROWS rows with a median step below PATH_STEP of the range."""


def _number_or_name(value: object) -> object:
    if value is None or isinstance(value, str) or (isinstance(value, int) and not isinstance(value, bool)):
        return value
    raise ValueError(f"is {shown(value)}; it must be the number or the name of a tool")


class MeasurementMap(Entry):
    """Tables of measured positions and joint readings, with the meaning of their columns."""

    kind: Literal["measurements"]
    tips: str = Field(description="file of measured positions: CSV, or export of NDI or OptiTrack")
    joints: str | None = Field(None, description="CSV file of joint readings, if recorded separately")
    columns: dict[str, str] = Field(
        {}, description="for each column its meaning and unit; not needed for tracker exports"
    )
    joint_columns: dict[str, str] | None = Field(None, description="the same for joints; default `columns`")
    formulas: dict[str, str] = Field(
        {},
        description="joint values from several columns, with factors and constants, then the unit. In a translation, "
        "`home` is the position of the tube's clamped end at home, minus its straight length",
        examples=["{rotation_1: 0.5 * motor_1 - motor_2 + 12.5, deg}"],
    )
    frame_rate_Hz: Positive | None = Field(None, description="frame rate of an export that counts frames")
    reference: Annotated[int | str | None, BeforeValidator(_number_or_name)] = Field(
        None,
        description="number or name of the reference tool; all other tools are expressed in "
        "its frame. It needs an orientation and is not the tip sensor",
    )
    behind_mm: list[NotNegative] | None = Field(
        None, description="distance of each sensor behind the tip; default all 0"
    )
    axis: Literal["x", "y", "z", "-x", "-y", "-z"] | None = Field(
        None, description="axis of the tip sensor along the tube, towards the tip; default detected"
    )


class RecordingList(Entry):
    """Recordings of one robot that are fitted together."""

    kind: Literal["recordings"]
    files: list[str] = Field(min_length=1, description="files of the recordings, CSV or YAML, relative to this file")


@typed
def load_recordings(path: str | PathLike[str], robot: Robot) -> tuple[Measurements, ...]:
    """Load recordings of a robot: those that a YAML file of kind `recordings` lists, or the one of another file.

    Raises:
        InputError: as `load_measurements`.
    """
    path = resolve_file(path)
    if Path(path).suffix.lower() in (".yaml", ".yml"):
        data = load_yaml(path)
        if isinstance(data, dict) and data.get("kind") == "recordings":
            files = check(RecordingList, data, path).files
            return tuple(load_measurements(Path(path).parent / name, robot) for name in files)
    return (load_measurements(path, robot),)


def load_mapped(path: str | PathLike[str], robot: Robot) -> Measurements:
    """Load measurements of a robot from a YAML file of kind `measurements`.

    Rows without a visible sensor or without joint readings are omitted and counted in the remarks.

    Raises:
        InputError: a missing file or column, an unknown column or unit, or invalid cells.
    """
    return mapped(check(MeasurementMap, load_yaml(path), path), path, Path(path).parent, robot)


def mapped(entry: MeasurementMap, path: str | PathLike[str], folder: Path, robot: Robot) -> Measurements:
    """Measurements of a robot as a file of kind `measurements` at `path` says, of tables in a folder.

    Raises:
        InputError: as `load_mapped`.
    """
    recorded = read_recorded(folder / entry.tips, entry.si("frame_rate_Hz"))
    if recorded.meaning and entry.joints is None:
        raise InputError(
            f"{path}: joints is missing; the tracker export {entry.tips} has no joint "
            "readings; give them in a separate CSV file"
        )
    # Columns that only the other file has do not belong to this one.
    mine = {k: v for k, v in entry.columns.items() if k in recorded.table.columns or entry.joints is None}
    meanings = {**recorded.meaning, **mine}
    # Where a drive reports the place of the clamped end, that of home is to be taken off.
    home = [-tube.straight_length for tube in robot.tubes]
    own_formulas = entry.formulas if entry.joints is None else {}
    tips = columns_of(recorded.table, meanings, str(path), home, own_formulas)
    joints = tips
    if entry.reference is not None:
        tips = replace(tips, reference=_reference(path, entry.reference, tips, recorded))
        joints = tips
    if entry.joints is not None:
        table = read_recorded(folder / entry.joints).table
        joint_columns = entry.joint_columns or {k: v for k, v in entry.columns.items() if k in table.columns}
        joints = columns_of(table, joint_columns, str(path), home, entry.formulas)
    _complete(path, entry, tips, joints, robot)
    measurements = measured(
        tips,
        joints,
        robot,
        (entry.tips, entry.joints or ""),
        behind=None if entry.behind_mm is None else np.array(entry.si("behind_mm")),
        axis=None if entry.axis is None else np.array(AXES[entry.axis], dtype=float),
    )
    return replace(measurements, remarks=(*recorded.remarks, *measurements.remarks))


def _reference(path: str | PathLike[str], reference: int | str, tips: Columns, recorded: Recorded) -> int:
    """Number of the reference tool; raises InputError if it is unknown, ambiguous or has no pose."""
    sensors, tools = tips.sensors(), recorded.tools
    # A number may be the number of one tool and the name of another: then the user must decide.
    with_name = [k for k, name in enumerate(tools, start=1) if name == str(reference)]
    number = reference if reference in sensors else with_name[0] if len(with_name) == 1 else None
    if isinstance(reference, int) and with_name not in ([], [reference]):
        name = tools[reference - 1] if reference <= len(tools) else ""
        raise InputError(
            f"{path}: reference is {reference}, and tool {with_name[0]} has that name; it must be '{reference}' in "
            f"quotes for the name, or the name '{name}' for tool {reference}"
        )
    if number not in sensors:
        named = f", or the names {', '.join(tools)}" if any(tools) else ""
        known = f"the tools of {tips.table.path} are {', '.join(map(str, sensors)) or 'none'}{named}"
        raise InputError(f"{path}: reference is {reference!r}; {known}")
    if not all(tips.has(f"{axis}_{number}") for axis in "xyz") or not tips.has_orientation(number):
        raise InputError(
            f"{path}: reference is {reference!r}, which has no pose; it must have position and orientation"
            + "".join(f" ({remark})" for remark in recorded.remarks)
        )
    if len(sensors) < 2:
        raise InputError(f"{path}: reference is {reference!r}, the only tool; there must be another one, at the tip")
    return number


def _complete(path: str | PathLike[str], entry: MeasurementMap, tips: Columns, joints: Columns, robot: Robot) -> None:
    """Raise InputError with every required quantity that has no column."""
    missing = [f"rotation_{i + 1}" for i in range(robot.n_tubes) if not joints.has(f"rotation_{i + 1}")]
    sensors = tips.sensors() or [1]
    missing += [f"{axis}_{k}" for k in sensors for axis in "xyz" if not tips.has(f"{axis}_{k}")]
    if joints is not tips and not (tips.has("time") and joints.has("time")):
        missing.append("time, in both files")
    if missing:
        raise InputError("\n".join(f"{path}: no column contains {name}" for name in missing))
    if entry.behind_mm is not None and len(entry.behind_mm) != len(sensors):
        raise InputError(f"{path}: behind_mm has {len(entry.behind_mm)} numbers; there are {len(sensors)} sensors")


def measured(
    tips: Columns,
    joints: Columns,
    robot: Robot,
    where: tuple[str, str],
    *,
    turned: Array | None = None,
    labels: Mapping[str, Array] | None = None,
    behind: Array | None = None,
    axis: Array | None = None,
) -> Measurements:
    """Build measurements from columns, with joint readings interpolated at the times of the positions.

    Args:
        joints: columns of the joint readings; `tips` if they are in the same table.
        where: names of the two tables in messages.
        turned: rotations (rows, n), rad, if no columns contain them.
        labels: further fields of `Measurements`.
        behind: `behind` of `Measurements`.
        axis: `sensor_axis` of `Measurements`.

    Raises:
        InputError: invalid cells, no row with a position, no common times.
    """
    remarks: list[str] = []
    time = tips.time()
    stamps = joints.time() if joints is not tips else None
    rotations = joints.numbers([f"rotation_{i + 1}" for i in range(robot.n_tubes)]) if turned is None else turned
    translations = joints.translations(robot.home_readings)
    positions = tips.positions()
    # The orientation is that of the sensor nearest to the tip.
    frames = tips.orientation(tips.sensors()[0 if behind is None else int(np.argmin(behind))])
    for columns in (tips, joints):
        columns.table.check()
    # A row with one visible sensor is still a measurement.
    used, lost = np.asarray(np.isfinite(positions[..., 0]).any(1)), tips.unseen_reference()
    if not used.any():
        raise InputError(
            f"{where[0]}: no row has a measured position{' and a pose of the reference' if lost.any() else ''}"
        )
    _count(remarks, lost, "have no pose of the reference tool and were left out")
    _count(remarks, ~used & ~lost, "have no measured position and were left out")
    # Rotations are unwrapped at the times of the joint readings: between tips full turns would be missed.
    clock = time if stamps is None else stamps
    wrapped: tuple[bool, ...] = ()
    if clock is not None:
        rotations, wrapped, jumps = unwrapped(clock, rotations)
        for tube in np.flatnonzero(jumps).tolist():
            often = "once" if jumps[tube] == 1 else f"{jumps[tube]} times"
            remarks.append(
                f"rotation_{tube + 1} jumps by a full turn {often}: taken as an angle that was wrapped, and unwrapped"
            )
    log = None
    if stamps is not None and time is not None:
        log = JointLog(stamps, rotations, translations)
        # Readings are interpolated, never extrapolated.
        covered = (time >= stamps[0]) & (time <= stamps[-1])
        _count(remarks, used & ~covered, "lie before or after all joint readings and were left out")
        used &= covered
        if not used.any():
            raise InputError(
                f"{' and '.join(where)} have no time in common: tips from {time[0]:g} to "
                f"{time[-1]:g} s, joints from {stamps[0]:g} to {stamps[-1]:g} s; both must "
                "use the same clock"
            )
        # Placeholders: the timeline below needs the measurements to find the readings at their times.
        rotations = translations = np.zeros((len(time), robot.n_tubes))
    rows = {"time": time, "orientation": frames, **(labels or {})}
    picked: dict[str, Any] = {name: None if value is None else value[used] for name, value in rows.items()}
    measurements = Measurements(
        rotations[used],
        translations[used],
        positions[used],
        source=Path(where[0]).name,
        behind=behind,
        sensor_axis=axis,
        log=log,
        wrapped=wrapped,
        **picked,
    )
    if log is not None:
        rotations, translations = Timeline.of(measurements).readings(0.0)
        measurements = replace(measurements, rotations=rotations, translations=translations)
    for k in range(measurements.sensors.shape[1]):
        _count(remarks, np.isnan(measurements.sensors[:, k, 0]), f"have no position of sensor {k + 1}")
    return replace(measurements, remarks=(*remarks, *_doubts_of(measurements, robot)))


def _count(remarks: list[str], mask: Mask, what: str) -> None:
    if mask.any():
        remarks.append(f"{int(mask.sum())} of {len(mask)} rows {what}")


def _doubts_of(measurements: Measurements, robot: Robot) -> list[str]:
    """Remarks on implausible units."""
    remarks = []
    turned = np.abs(measurements.rotations).max()
    # A full turn in rad that is read in deg is 57 times too small.
    if 0 < turned <= 2 * math.pi / 57:
        remarks.append(
            f"no rotation is beyond {math.degrees(turned):.2g} deg: are they in rad, in a column that says deg?"
        )
    # Ten turns: one turn in deg that is read in rad is 57 turns.
    if turned > 20 * math.pi:
        remarks.append(
            f"rotations reach {turned / (2 * math.pi):.0f} turns: are they in deg, in a column that says rad?"
        )
    length = max(tube.length for tube in robot.tubes)
    tips = measurements.tip_position[np.isfinite(measurements.tip_position[:, 0])]
    # Diagonal of the box around all tips.
    spread = float(np.linalg.norm(np.ptp(tips, axis=0))) if len(tips) else 0.0
    moving = (
        np.ptp(measurements.rotations, axis=0).max() > MOVING_ROTATION
        or np.ptp(measurements.translations, axis=0).max() > 0.1 * length
    )
    if len(tips) > 1 and moving and spread < SMALL * length:
        remarks.append(
            f"the tips lie within {1e3 * spread:.2g} mm of each other, and the tubes are up to {1e3 * length:.0f} mm "
            "long. Are positions in m in columns for mm, or was the sensor not on the tip?"
        )
    if spread > LARGE * length:
        remarks.append(
            f"the tips lie up to {1e3 * spread:.0f} mm apart, and the tubes are up to {1e3 * length:.0f} mm long. Are "
            "positions in mm in columns for m?"
        )
    reach = np.abs(measurements.translations).max()
    if 0 < reach < 1e-3 * length and np.ptp(measurements.translations) > 0:
        remarks.append(f"no translation is beyond {1e3 * reach:.2g} mm: are they in m, in columns that say mm?")
    return (
        remarks
        + _doubts_of_sensors(measurements, robot)
        + _doubts_of_clock(measurements)
        + _doubts_of_time(measurements)
    )


def _doubts_of_sensors(measurements: Measurements, robot: Robot) -> list[str]:
    """Remarks on sensors at one position along the arm that cannot be on one piece of it."""
    thickness = max(tube.outer_diameter for tube in robot.tubes)
    if isinstance(robot, SheathedRobot):
        thickness = sheath_inner_diameter(thickness)
    sensors, behind, remarks = measurements.sensors, measurements.behind, list[str]()
    if behind is None:
        behind = np.zeros(sensors.shape[1])
    for i, j in combinations(range(len(behind)), 2):
        distance = np.linalg.norm(sensors[:, i] - sensors[:, j], axis=1)
        distance = distance[np.isfinite(distance)]
        if abs(behind[i] - behind[j]) > SAME_POSITION:
            continue
        if not len(distance):
            remarks.append(
                f"sensors {i + 1} and {j + 1} of the tip never appear in one row, so their distance is unknown. Each "
                "is used as the tip. If one is a reference tool, name it by reference in a file of kind measurements"
            )
            continue
        # Quantiles, since single outliers of a tracker are no evidence.
        low, middle, high = np.quantile(distance, (0.05, 0.5, 0.95)).tolist()
        faults = [f"are {1e3 * middle:.3g} mm apart, and the arm is {1e3 * thickness:.3g} mm thick"] * (
            middle > thickness
        )
        if high - low > TRACKER_NOISE and high > thickness + TRACKER_NOISE:
            faults.append(f"have distances from {1e3 * low:.3g} to {1e3 * high:.3g} mm")
        if faults:
            remarks.append(
                f"sensors {i + 1} and {j + 1} of the tip {' and '.join(faults)}: they are averaged anyway; if "
                "one is a reference tool, name it by reference in a file of kind measurements"
            )
    return remarks


def _doubts_of_clock(measurements: Measurements) -> list[str]:
    """Remarks on repeated times, and on decreasing times if joint readings are interpolated by them."""
    if measurements.time is None:
        return []
    time, remarks = measurements.time, []
    steps = np.diff(time)
    repeated, back = int((steps == 0).sum()), np.flatnonzero(steps < 0)
    if repeated:
        rows = "row has" if repeated == 1 else "rows have"
        remarks.append(
            f"{repeated} {rows} the time of the row before: was it recorded twice, or is the clock too coarse?"
        )
    if measurements.log is not None and len(back):
        remarks.append(
            f"the time of the positions goes back from {time[back[0]]:.3f} to {time[back[0] + 1]:.3f} s: "
            "did the clock restart? Joint readings are searched at these times"
        )
    return remarks


def _doubts_of_time(measurements: Measurements) -> list[str]:
    """Remark on times that are probably in ms."""
    if measurements.time is None or len(measurements) < PATH_ROWS:
        return []
    # The median ignores pauses between runs.
    step = float(np.median(np.abs(np.diff(measurements.time))))
    joints = np.hstack([measurements.rotations, measurements.translations])
    extent = np.ptp(joints, axis=0)
    moved = np.abs(np.diff(joints, axis=0))[:, extent > 0] / extent[extent > 0]
    if step <= MAX_PERIOD or not moved.size or np.median(moved.max(1)) > PATH_STEP:
        return []
    return [f"rows follow each other after {step:.3g} s on a path of the joints: are times in ms, taken for s?"]


# --- tables with columns of tubeopt -----------------------------------------------------------------------------------

MIRROR = {"direction_deg": "direction", "separation_deg": "separation"}
ASSIGNMENT, NOTE = "assignment", "note"
POSITION = ("x_mm", "y_mm", "z_mm")


@typed
def load_measurements(path: str | PathLike[str], robot: Robot) -> Measurements:
    """Load measurements of a robot from a CSV file, or from a YAML file as `load_mapped`.

    Columns:

    - `rotation_1_deg` to `rotation_n_deg`: rotations. For the mirror actuation of a one-segment eccentric robot
      `direction_deg`, `separation_deg` and optionally `assignment` replace them, or label the rows next to them.
    - `translation_1_mm` and so on: translations; home if absent.
    - `x_mm`, `y_mm`, `z_mm`, or `x1_mm`, `y1_mm`, `z1_mm`, `x2_mm`, ... for several sensors; empty if a sensor was
      not visible.
    - `time_s`; `qw`, `qx`, `qy`, `qz` of the (first) sensor; `note` for any text.

    An assignment "132" turns tube 1 by the direction, tube 3 by direction plus separation and tube 2 by direction minus
    separation; the default is "123". Rows without any sensor are omitted and counted in the remarks.

    Raises:
        InputError: no such file, unknown or missing columns, or invalid cells; one line per problem, with row
            and column.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("thesis_etr")
        >>> tubeopt.load_measurements("synthetic_etr", robot).rotations.shape
        (48, 3)
    """
    path = resolve_file(path)
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
    """Meaning of the columns, and True if the rotations come from mirror actuation."""
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
        # Without a plain x_mm the quaternion is that of the first numbered sensor.
        first = _sensors(table.columns)[0][0][1:-3]
        meanings |= {name: f"{name}_{first}" for name in QUATERNION}
    return columns_of(table, {c: m for c, m in meanings.items() if c in table.columns}, str(path), [0.0] * n), mirrored


def _sensors(columns: Sequence[str]) -> list[tuple[str, str, str]]:
    """Names of the position columns of every sensor in the header."""
    numbers = sorted({int(match[1]) for c in columns if (match := re.fullmatch(r"[xyz]([1-9]\d*)_mm", c))})
    several = [(f"x{k}_mm", f"y{k}_mm", f"z{k}_mm") for k in numbers]
    plain = ("x_mm", "y_mm", "z_mm")
    return [plain, *several] if not several or any(c in columns for c in plain) else several


def _mirrored(table: CsvTable, direction: Array, separation: Array) -> Array:
    """Rotations (N, 3) of mirror actuation, rad; invalid assignments are added to the problems of the table."""
    rows = enumerate(zip(direction, separation, strict=True))
    return np.array([mirror_rotations(phi, gamma, _assignment(table, k)) for k, (phi, gamma) in rows])


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
    """Write measurements as CSV that `load_measurements` reads back, bit for bit except orientations.

    The file has no sensor offsets behind the tip, no sensor axis and no log of the joints.

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
            # SciPy refuses NaN: unseen rows are the identity, and NaN again below.
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
    """Load a published table of tip errors: `separation_deg`, `error_at_D_deg_mm` for every direction D, `mean_mm`.

    The table has one row per separation, and a last row `mean` with the means over the separations.

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
