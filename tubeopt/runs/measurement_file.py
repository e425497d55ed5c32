"""Measurements in files: CSV with columns of tubeopt, tables of other programs that a YAML file maps, published tables.

Whether the numbers can be what their columns say is checked too: angles that were wrapped are unwrapped, and units
that cannot be right are reported.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations, pairwise
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
from ..files.shipped import resolved
from ..files.units import DEG, MM, RAD, in_unit, shown, to_si
from ..files.yaml_file import load_yaml
from ..inverse.mirror import ASSIGNMENTS, mirror_rotations
from ..robots.eccentric import EccentricRobot, SheathedRobot, sheath_inner_diameter
from ..robots.file import check_joints, joint_columns
from ..robots.robot import Robot
from ..typing import Array, Mask
from ..validation.comparison import ErrorTable
from ..validation.measurements import SAME_PLACE, JointLog, Measurements, Timeline, runs_of
from .recorded_table import QUATERNION, Columns, Recorded, columns_of, read_recorded

# --- tables that a YAML file maps -------------------------------------------------------------------------------------

AXES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1), "-x": (-1, 0, 0), "-y": (0, -1, 0), "-z": (0, 0, -1)}

# A wrapped angle jumps by a turn less the step of the path. At pi, the default of NumPy, a drive that moves by half a
# turn between rows would be unwrapped; at two turns no jump would be found.
A_TURN = 1.5 * math.pi
"""rad: between rows on end, a larger step of a rotation is a turn that was counted away."""

# Tips of an arm of length L spread by at most 2 sqrt(3) L. Metres taken for millimetres change that by 1000, so half or
# twice these bounds separate the two as well.
SMALL, LARGE = 0.02, 8.0
"""Parts of the arm's length between which the spread of tips that move must lie."""

MOVES = 0.3
"""rad: a robot whose tubes turn by more against each other moves its tip."""

STEADY = 2e-3
"""m, of the noise of trackers: two sensors on one piece of the arm stay so close to its thickness, or their distance
changes by no more."""

# Trackers record 10 to 1000 rows a second. Times in ms that are taken for s are 1 to 100 s apart.
SLOW = 1.0
"""s: recorders of a moving arm are faster."""

# A path shares out its range over its rows; configurations in random order step by a third of it on average.
PATH, ROWS = 0.1, 20
"""Rows that are at least so many are a path where the joints usually move by less than this part of their range."""


def _number_or_name(value: object) -> object:
    if value is None or isinstance(value, str) or (isinstance(value, int) and not isinstance(value, bool)):
        return value
    raise ValueError(f"is {shown(value)}; it must be the number or the name of a tool")


class MeasurementMap(Entry):
    """Tables of measured positions and of joint readings, and what their columns mean."""

    kind: Literal["measurements"]
    tips: str = Field(description="file of measured positions: CSV, or export of NDI or OptiTrack")
    joints: str | None = Field(None, description="CSV file of joint readings, if recorded separately")
    columns: dict[str, str] = Field(
        {}, description="for each column its meaning and unit; not needed for tracker exports"
    )
    joint_columns: dict[str, str] | None = Field(None, description="the same for joints; default `columns`")
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


def load_mapped(path: str | PathLike[str], robot: Robot) -> Measurements:
    """The measurements of `robot` that a YAML file of the kind `measurements` describes.

    Rows in which nothing was seen, or for which there are no joint readings, are left out and counted in the remarks.

    Raises:
        InputError: a file, column or unit that is not there or unknown, or cells that are not what they must be.
    """
    entry = check(MeasurementMap, load_yaml(path), path)
    folder = Path(path).parent
    recorded = read_recorded(folder / entry.tips, entry.si("frame_rate_Hz"))
    if recorded.meaning and entry.joints is None:
        raise InputError(
            f"{path}: joints is missing; the tracker export {entry.tips} has no joint "
            "readings; give them in a separate CSV file"
        )
    # A column that is of the other file alone says nothing of this one.
    mine = {k: v for k, v in entry.columns.items() if k in recorded.table.columns or entry.joints is None}
    meanings = {**recorded.meaning, **mine}
    tips = columns_of(recorded.table, meanings, str(path), robot.n_tubes)
    joints = tips
    if entry.reference is not None:
        tips = replace(tips, reference=_reference(path, entry.reference, tips, recorded))
        joints = tips
    if entry.joints is not None:
        table = read_recorded(folder / entry.joints).table
        own = entry.joint_columns or {k: v for k, v in entry.columns.items() if k in table.columns}
        joints = columns_of(table, own, str(path), robot.n_tubes)
    _complete(path, entry, tips, joints, robot)
    found = measured(
        tips,
        joints,
        robot,
        (entry.tips, entry.joints or ""),
        behind=None if entry.behind_mm is None else np.array(entry.si("behind_mm")),
        axis=None if entry.axis is None else np.array(AXES[entry.axis], dtype=float),
    )
    return replace(found, remarks=(*recorded.remarks, *found.remarks))


def _reference(path: str | PathLike[str], wanted: int | str, tips: Columns, recorded: Recorded) -> int:
    """The number of the reference tool; raises InputError for one that is not there, is one of two, or has no pose."""
    sensors, tools = tips.sensors(), recorded.tools
    # A number may be the number of one tool and the name of another: then the user must decide.
    named_so = [k for k, name in enumerate(tools, start=1) if name == str(wanted)]
    number = wanted if wanted in sensors else named_so[0] if len(named_so) == 1 else None
    if isinstance(wanted, int) and named_so not in ([], [wanted]):
        raise InputError(
            f"{path}: reference is {wanted}, and tool {named_so[0]} has that name; it must be '{wanted}' in quotes for "
            f"the name, or the name '{tools[wanted - 1] if wanted <= len(tools) else ''}' for tool {wanted}"
        )
    if number not in sensors:
        named = f", or the names {', '.join(tools)}" if any(tools) else ""
        known = f"the tools of {tips.table.path} are {', '.join(map(str, sensors)) or 'none'}{named}"
        raise InputError(f"{path}: reference is {wanted!r}; {known}")
    if not all(tips.has(f"{axis}_{number}") for axis in "xyz") or not tips.turns(number):
        raise InputError(
            f"{path}: reference is {wanted!r}, which has no pose; it must have position and orientation"
            + "".join(f" ({remark})" for remark in recorded.remarks)
        )
    if len(sensors) < 2:
        raise InputError(f"{path}: reference is {wanted!r}, the only tool; there must be another one, at the tip")
    return number


def _complete(path: str | PathLike[str], entry: MeasurementMap, tips: Columns, joints: Columns, robot: Robot) -> None:
    """Raise InputError naming every quantity that is needed and has no column."""
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
    """The measurements that columns hold, with joints at the times of their rows, and what was noticed.

    Args:
        joints: columns of the joint readings; the same as `tips` where they stand beside the positions.
        where: what messages call the two tables.
        turned: (rows, n) rotations, rad, where no columns hold them.   labels: further fields of `Measurements`.
        behind, axis: `behind` and `sensor_axis` of `Measurements`.

    Raises:
        InputError: cells that are not what they must be, no row with a position, no time in common.
    """
    words: list[str] = []
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
    kept, lost = np.asarray(np.isfinite(positions[..., 0]).any(1)), tips.unseen_reference()
    if not kept.any():
        raise InputError(
            f"{where[0]}: no row has a measured position{' and a pose of the reference' if lost.any() else ''}"
        )
    _count(words, lost, "have no pose of the reference tool and were left out")
    _count(words, ~kept & ~lost, "have no measured position and were left out")
    # Turns are counted on the clock of the joints: between tips they would be missed.
    turning = time if stamps is None else stamps
    wrapped: tuple[bool, ...] = ()
    if turning is not None:
        rotations, wrapped = _unwrapped(turning, rotations, words)
    log = None
    if stamps is not None and time is not None:
        log = JointLog(stamps, rotations, translations)
        # Readings are interpolated, never extrapolated.
        covered = (time >= stamps[0]) & (time <= stamps[-1])
        _count(words, kept & ~covered, "lie before or after all joint readings and were left out")
        kept &= covered
        if not kept.any():
            raise InputError(
                f"{' and '.join(where)} have no time in common: tips from {time[0]:g} to "
                f"{time[-1]:g} s, joints from {stamps[0]:g} to {stamps[-1]:g} s; both must "
                "use the same clock"
            )
        # Placeholders: the timeline below needs the measurements to find the readings at their times.
        rotations = translations = np.zeros((len(time), robot.n_tubes))
    rows = {"time": time, "orientation": frames, **(labels or {})}
    picked: dict[str, Any] = {name: None if value is None else value[kept] for name, value in rows.items()}
    found = Measurements(
        rotations[kept],
        translations[kept],
        positions[kept],
        source=Path(where[0]).name,
        behind=behind,
        sensor_axis=axis,
        log=log,
        wrapped=wrapped,
        **picked,
    )
    if log is not None:
        rotations, translations = Timeline.of(found).readings(0.0)
        found = replace(found, rotations=rotations, translations=translations)
    for k in range(found.sensors.shape[1]):
        _count(words, np.isnan(found.sensors[:, k, 0]), f"have no position of sensor {k + 1}")
    return replace(found, remarks=(*words, *_doubts_of(found, robot)))


def _count(words: list[str], mask: Mask, what: str) -> None:
    if mask.any():
        words.append(f"{int(mask.sum())} of {len(mask)} rows {what}")


def _unwrapped(time: Array, rotations: Array, words: list[str]) -> tuple[Array, tuple[bool, ...]]:
    """Rotations (N, n) without the jumps by full turns between rows of a run, and which tubes had any; adds remarks.

    A run of an angle that was wrapped begins in the turn in which the run before it ended.
    """
    out, runs = rotations.copy(), runs_of(time)
    for rows in runs:
        out[rows] = np.unwrap(rotations[rows], discont=A_TURN, axis=0)
    # Corrections are multiples of 2 pi, so that 1 rad separates them from round-off.
    jumps = np.diff(rotations - out, axis=0)
    wrapped = np.any([np.abs(jumps[rows[:-1]]).max(0, initial=0.0) > 1.0 for rows in runs], axis=0)
    for before, rows in pairwise(runs):
        # A gap in time hides how far the drive turned: the nearest turn is assumed, for wrapped tubes only.
        turns = np.round((out[before[-1]] - out[rows[0]]) / (2 * math.pi))
        out[rows] += np.where(wrapped, 2 * math.pi * turns, 0.0)
    steps = np.abs(np.diff(rotations - out, axis=0)) > 1.0
    for tube in np.flatnonzero(steps.any(0)).tolist():
        count = int(steps[:, tube].sum())
        often = "once" if count == 1 else f"{count} times"
        words.append(
            f"rotation_{tube + 1} jumps by a full turn {often}: taken as an angle that was wrapped, and unwrapped"
        )
    return out, tuple(wrapped.tolist())


def _doubts_of(found: Measurements, robot: Robot) -> list[str]:
    """Remarks on units that the numbers speak against."""
    words = []
    turned = np.abs(found.rotations).max()
    # A whole turn in rad that is read in deg is 57 times too small.
    if 0 < turned <= 2 * math.pi / 57:
        words.append(
            f"no rotation is beyond {math.degrees(turned):.2g} deg: are they in rad, in a column that says deg?"
        )
    # Ten turns: one turn in deg that is read in rad is 57 turns.
    if turned > 20 * math.pi:
        words.append(f"rotations reach {turned / (2 * math.pi):.0f} turns: are they in deg, in a column that says rad?")
    length = max(tube.length for tube in robot.tubes)
    tips = found.tip_position[np.isfinite(found.tip_position[:, 0])]
    # Diagonal of the box around all tips.
    spread = float(np.linalg.norm(np.ptp(tips, axis=0))) if len(tips) else 0.0
    moving = np.ptp(found.rotations, axis=0).max() > MOVES or np.ptp(found.translations, axis=0).max() > 0.1 * length
    if len(tips) > 1 and moving and spread < SMALL * length:
        words.append(
            f"the tips lie within {1e3 * spread:.2g} mm of each other, and the tubes are up to {1e3 * length:.0f} mm "
            "long. Are positions in m in columns for mm, or was the sensor not on the tip?"
        )
    if spread > LARGE * length:
        words.append(
            f"the tips lie up to {1e3 * spread:.0f} mm apart, and the tubes are up to {1e3 * length:.0f} mm long. Are "
            "positions in mm in columns for m?"
        )
    reach = np.abs(found.translations).max()
    if 0 < reach < 1e-3 * length and np.ptp(found.translations) > 0:
        words.append(f"no translation is beyond {1e3 * reach:.2g} mm: are they in m, in columns that say mm?")
    return words + _doubts_of_sensors(found, robot) + _doubts_of_clock(found) + _doubts_of_time(found)


def _doubts_of_sensors(found: Measurements, robot: Robot) -> list[str]:
    """Remarks on sensors at one station that cannot be on one piece of the arm."""
    thick = max(tube.outer_diameter for tube in robot.tubes)
    if isinstance(robot, SheathedRobot):
        thick = sheath_inner_diameter(thick)
    behind, words = found.behind if found.behind is not None else np.zeros(found.sensors.shape[1]), []
    for i, j in combinations(range(len(behind)), 2):
        apart = np.linalg.norm(found.sensors[:, i] - found.sensors[:, j], axis=1)
        apart = apart[np.isfinite(apart)]
        if abs(behind[i] - behind[j]) > SAME_PLACE:
            continue
        if not len(apart):
            words.append(
                f"sensors {i + 1} and {j + 1} of the tip never appear in one row, so their distance is unknown. Each "
                "is used as the tip. If one is a reference tool, name it by reference in a file of kind measurements"
            )
            continue
        # Quantiles, since single outliers of a tracker are no evidence.
        low, middle, high = np.quantile(apart, (0.05, 0.5, 0.95)).tolist()
        faults = [f"are {1e3 * middle:.3g} mm apart, and the arm is {1e3 * thick:.3g} mm thick"] * (middle > thick)
        if high - low > STEADY and high > thick + STEADY:
            faults.append(f"have distances from {1e3 * low:.3g} to {1e3 * high:.3g} mm")
        if faults:
            words.append(
                f"sensors {i + 1} and {j + 1} of the tip {' and '.join(faults)}: they are averaged anyway; if "
                "one is a reference tool, name it by reference in a file of kind measurements"
            )
    return words


def _doubts_of_clock(found: Measurements) -> list[str]:
    """Remarks on times that stand still, or that go back where joint readings are found by them."""
    if found.time is None:
        return []
    steps, words = np.diff(found.time), []
    still, back = int((steps == 0).sum()), np.flatnonzero(steps < 0)
    if still:
        rows = "row has" if still == 1 else "rows have"
        words.append(f"{still} {rows} the time of the row before: was it recorded twice, or is the clock too coarse?")
    if found.log is not None and len(back):
        words.append(
            f"the time of the positions goes back from {found.time[back[0]]:.3f} to {found.time[back[0] + 1]:.3f} s: "
            "did the clock restart? Joint readings are searched at these times"
        )
    return words


def _doubts_of_time(found: Measurements) -> list[str]:
    if found.time is None or len(found) < ROWS:
        return []
    # The median ignores pauses between runs.
    step = float(np.median(np.abs(np.diff(found.time))))
    joints = np.hstack([found.rotations, found.translations])
    extent = np.ptp(joints, axis=0)
    moved = np.abs(np.diff(joints, axis=0))[:, extent > 0] / extent[extent > 0]
    if step <= SLOW or not moved.size or np.median(moved.max(1)) > PATH:
        return []
    return [f"rows follow each other after {step:.3g} s on a path of the joints: are times in ms, taken for s?"]


# --- tables with columns of tubeopt -----------------------------------------------------------------------------------

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
        # Without a plain x_mm the quaternion is that of the first numbered sensor.
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
