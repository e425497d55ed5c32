"""Logs of encoders and trackers, read without a description: columns by their names, units and directions by the tips.

A log is a CSV file or an export of a tracker (`recorded_table`). What is found is a file of kind `measurements`, which
`load_mapped` reads, so that a user can check it, correct it, and give it in place of the log.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ..errors import InputError
from ..files.csv_file import CsvTable, read_name
from ..files.units import TO_MM
from ..files.yaml_file import to_yaml
from ..robots.robot import Robot
from ..typing import Array, Progress
from ..validation.measurements import Measurements
from ..validation.model import AXES, solve_poses
from ..validation.reading import ALL, ANGLES, LENGTHS, Decision, Detection, RawLog, Reading, detect
from ..validation.registration import register
from .measurement_file import MeasurementMap, load_recordings, mapped
from .recorded_table import TIME, Columns, Recorded, read_recorded

# Time between two rows of a recording, s: trackers and drives write 1 to 1000 rows a second.
PERIODS = (1e-3, 2.0)

# Zeros up to this size are errors of homing, which a fit finds; larger ones are a zero elsewhere (rad and m).
HOMED = math.radians(10.0), 4e-3

# Angle between measured and predicted directions, root mean square, beyond which a quaternion is not understood, and
# by how much the right one is the closest.
POINTS, CLEARLY = math.radians(25.0), 1.5

# Rows for the order of a quaternion.
DIRECTED_ROWS = 40

QUATERNIONS = {"w first": (0, 1, 2, 3), "w last": (3, 0, 1, 2)}
"""Order of the four columns -> places of w, x, y and z in them."""


@dataclass(frozen=True, eq=False)
class LogColumns:
    """A log with the meaning of its columns, as far as their names say it."""

    path: Path
    recorded: Recorded
    known: dict[str, tuple[str, str]]
    """Meaning -> column and stated unit, "" for none."""
    quaternion: tuple[str, ...] = ()
    """Four columns of a quaternion, as they stand in the file."""

    @property
    def table(self) -> CsvTable:
        """The table of the log."""
        return self.recorded.table

    def has(self, start: str) -> bool:
        """True if a column has a meaning that begins so."""
        return any(re.match(rf"{start}_\d", meaning) for meaning in self.known)


@dataclass(frozen=True)
class ReadLog:
    """A recording as it was read, and how certain that is."""

    name: str
    """Name of the recording."""
    measurements: Measurements
    detection: Detection | None
    """None where a YAML file names the columns of the recording."""
    decisions: tuple[Decision, ...] = ()
    """Decisions on clocks and on the sensor."""
    mapping: Mapping[str, Any] = field(default_factory=dict)
    """Keys of the file of kind measurements that reads it so; empty for a file that was given."""

    @property
    def every_decision(self) -> tuple[Decision, ...]:
        """Decisions on all columns."""
        return (*self.decisions, *(self.detection.decisions if self.detection else ()))

    def text(self, directory: Path) -> str:
        """Text of that file in a directory."""
        paths = {
            key: os.path.relpath(self.mapping[key], directory) for key in ("tips", "joints") if key in self.mapping
        }
        return to_yaml(
            {**self.mapping, **paths},
            f"How {self.name} is read. Correct it where it is wrong, and give it in place of the log.",
        )


def columns_by_name(path: Path, robot: Robot) -> LogColumns:
    """A log with the meaning of its columns by their names.

    Raises:
        InputError: no such file, or two columns of one meaning.
    """
    recorded = read_recorded(path)
    known: dict[str, tuple[str, str]] = {}
    parts: dict[str, str] = {}
    for column in recorded.table.columns:
        if column in recorded.meaning:
            word, _, unit = (part.strip() for part in recorded.meaning[column].partition(","))
        else:
            word, unit = read_name(column)
        word = f"{word}_1" if word in ("x", "y", "z") else word
        if (part := re.fullmatch(r"q_?([wxyz0-4])(?:_1)?", word)) and column not in recorded.meaning:
            parts[f"q{part[1]}"] = column
            continue
        kind, _, number = word.rpartition("_")
        tube = kind in ("rotation", "translation") and number.isdigit() and 1 <= int(number) <= robot.n_tubes
        if not (tube or word == "time" or re.fullmatch(r"[xyz]_\d+|q[wxyz]_\d+", word)):
            continue
        if word in known:
            raise InputError(f"{path}: columns {known[word][0]} and {column} both are {word.replace('_', ' ')}")
        known[word] = column, unit
    named = [parts[name] for name in ("qw", "qx", "qy", "qz", "q0", "q1", "q2", "q3", "q4") if name in parts]
    return LogColumns(
        path, recorded, known, tuple(sorted(named, key=recorded.table.columns.index)) if len(named) == 4 else ()
    )


def paired(logs: Sequence[Path], robot: Robot) -> list[tuple[LogColumns, LogColumns] | Path]:
    """Logs of tips and of joints, in one file or in two that follow each other; YAML files as they are.

    Raises:
        InputError: a log of joints or of tips alone, or without either.
    """
    out: list[tuple[LogColumns, LogColumns] | Path] = []
    waiting: LogColumns | None = None
    for path in logs:
        if path.suffix.lower() in (".yaml", ".yml"):
            out.append(path)
            continue
        log = columns_by_name(path, robot)
        joints, tips = log.has("rotation"), log.has("x")
        if joints:
            missing = [f"rotation_{i + 1}" for i in range(robot.n_tubes) if f"rotation_{i + 1}" not in log.known]
            if missing:
                raise InputError(
                    f"{path}: no column is named {' or '.join(missing)}; the robot has {robot.n_tubes} tubes"
                )
        if joints and tips:
            out.append((log, log))
        elif not joints and not tips:
            raise InputError(
                f"{path}: no column is named rotation_1 or x; its columns are {', '.join(log.table.columns)}. Rename "
                "them, or map them by a file of kind measurements"
            )
        elif waiting is None:
            waiting = log
        elif waiting.has("x") == tips:
            what, other = ("positions", "rotations") if tips else ("rotations", "positions")
            raise InputError(f"{waiting.path} and {path} both have {what} and no {other}; give them in pairs")
        else:
            out.append((log, waiting) if tips else (waiting, log))
            waiting = None
    if waiting is not None:
        what, other = ("positions", "rotations") if waiting.has("x") else ("rotations", "positions")
        raise InputError(f"{waiting.path} has {what} and no {other}; give the log of {other} of the same recording too")
    return out


def read_log(
    pair: tuple[LogColumns, LogColumns] | Path,
    robot: Robot,
    before: Sequence[ReadLog],
    answers: Sequence[tuple[str, str]],
    progress: Progress | None = None,
) -> list[ReadLog]:
    """Recordings of a log, with columns read as the tips require; a YAML file may list several.

    Args:
        pair: of tips and joints, or a YAML file.   before: recordings read before, whose reading is tried first.
        answers: pairs such as ("rotation_2", "reversed").

    Raises:
        InputError: columns that could be read in two ways, invalid cells.
        SolveError: no reading explains the tips.
    """
    if isinstance(pair, Path):
        return [ReadLog(m.source or pair.name, m, None) for m in load_recordings(pair, robot)]
    tips, joints = pair
    raw, decisions = raw_log(tips, joints, robot, dict(answers))
    known = next((each.detection.reading for each in reversed(before) if each.detection is not None), None)
    try:
        found = detect(robot, raw, known, answers=answers, progress=progress)
    except InputError as error:
        raise InputError(f"{tips.path}: {error}") from None
    clocks = {meaning: decision.chosen for meaning, decision in decisions.items()}
    mapping = _mapping(tips, joints, robot, found.reading, clocks)
    if tips.quaternion:
        oriented, decision = _oriented(tips, mapping, robot)
        mapping = {**mapping, "columns": {**mapping["columns"], **oriented}}
        decisions["quaternion"] = decision
    refuse_doubt(tips.path, [*decisions.values(), *found.decisions])
    measurements = mapped(MeasurementMap.model_validate(mapping), str(tips.path), Path(), robot)
    return [ReadLog(tips.path.name, measurements, found, tuple(decisions.values()), mapping)]


def refuse_doubt(path: Path, decisions: Sequence[Decision]) -> None:
    """Raise InputError with a question for every decision that is not certain."""
    lines = []
    for d in decisions:
        if d.certain:
            continue
        why = d.reason or f"both fit the tips, and leave {d.rms * TO_MM:.2f} or {d.other_rms * TO_MM:.2f} mm"
        hint = "; measure tips out of one plane" if d.about.startswith(ALL) else ""
        name = d.about.removeprefix(f"{ALL} ")
        lines.append(
            f"{path}: is {d.about} {d.chosen} or {d.other}? {why[:1].upper()}{why[1:]}{hint}. Answer by "
            f"--answer {name}={d.chosen} or --answer {name}={d.other}"
        )
    if lines:
        raise InputError("\n".join(lines))


def raw_log(
    tips: LogColumns, joints: LogColumns, robot: Robot, answers: Mapping[str, str]
) -> tuple[RawLog, dict[str, Decision]]:
    """Numbers of a recording, and the units of its clocks."""
    n, together = robot.n_tubes, tips is joints
    decisions: dict[str, Decision] = {}
    times = []
    for log, name in ((tips, "time"), (joints, "joint_time")):
        time = None
        if "time" in log.known:
            numbers = _numbers(log, ["time"])[:, 0]
            decision = _clock(name, numbers, log.known["time"][1], answers)
            decisions[name] = decision
            time = numbers * float(TIME[decision.chosen])
        times.append(time)
    if together:
        decisions.pop("joint_time", None)
    elif times[0] is None or times[1] is None:
        log = tips if times[0] is None else joints
        raise InputError(f"{log.path}: no column is named time; two files of a recording need times of one clock")
    rotations = _numbers(joints, [f"rotation_{i + 1}" for i in range(n)])
    translations = np.full((len(rotations), n), np.nan)
    for i in range(n):
        if f"translation_{i + 1}" in joints.known:
            translations[:, i] = _numbers(joints, [f"translation_{i + 1}"])[:, 0]
    tools = sorted({int(m[1]) for meaning in tips.known if (m := re.fullmatch(r"x_(\d+)", meaning))})
    sensors = np.stack([_numbers(tips, [f"{axis}_{k}" for axis in "xyz"], missing=True) for k in tools], axis=1)
    for log in (tips,) if together else (tips, joints):
        log.table.check()
    order = [_units(joints, "rotation", ANGLES), _units(joints, "translation", LENGTHS), _units(tips, "x", LENGTHS)]
    return RawLog(rotations, translations, times[1], sensors, times[0], *order), decisions


def _numbers(log: LogColumns, meanings: Sequence[str], *, missing: bool = False) -> Array:
    """(rows, M) numbers as they are written."""
    absent = [meaning for meaning in meanings if meaning not in log.known]
    if absent:
        raise InputError(f"{log.path}: no column is named {' or '.join(absent)}")
    plain = {meaning: (log.known[meaning][0], TIME["s"]) for meaning in meanings}
    return Columns(log.table, plain, {}).numbers(meanings, missing=missing)


def _units(log: LogColumns, start: str, known: Mapping[str, float]) -> tuple[str, ...]:
    """Units that columns may have, the stated one first.

    Raises:
        InputError: columns of a kind with different units.
    """
    stated = {unit: column for meaning, (column, unit) in log.known.items() if re.match(rf"{start}_\d", meaning)}
    if len(stated) > 1:
        raise InputError(
            f"{log.path}: columns {' and '.join(stated.values())} have different units; they must have one"
        )
    (unit,) = stated or ("",)
    if unit and unit not in known:
        allowed = ", ".join(known)
        raise InputError(f"{log.path}: column {stated[unit]} is in {unit}; it must be in {allowed}")
    return tuple(sorted(known, key=lambda name: name != unit)) if unit else tuple(known)


def _clock(name: str, numbers: Array, stated: str, answers: Mapping[str, str]) -> Decision:
    """Unit of times, by the period of the rows."""
    steps = np.diff(numbers)
    period = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
    possible = [unit for unit, size in TIME.items() if PERIODS[0] <= period * float(size) <= PERIODS[1]]
    if name in answers:
        return Decision(
            about=name,
            chosen=answers[name],
            other="",
            rms=math.nan,
            other_rms=math.nan,
            certain=True,
            reason="as answered",
        )
    if stated and (stated in possible or not possible):
        return Decision(
            about=name, chosen=stated, other="", rms=math.nan, other_rms=math.nan, certain=True, reason="as named"
        )
    if not possible:
        raise InputError(
            f"the rows of {name} are {period:g} apart; that must be {PERIODS[0]:g} to {PERIODS[1]:g} s in a unit of "
            f"{', '.join(TIME)}"
        )
    chosen, other = (
        possible[0],
        possible[1] if len(possible) > 1 else stated or next(u for u in TIME if u != possible[0]),
    )
    reason = f"rows are {period * float(TIME[chosen]):.3g} s apart"
    return Decision(
        about=name,
        chosen=chosen,
        other=other,
        rms=math.nan,
        other_rms=math.nan,
        certain=len(possible) == 1,
        reason=reason,
    )


def _mapping(
    tips: LogColumns, joints: LogColumns, robot: Robot, reading: Reading, clocks: Mapping[str, str]
) -> dict[str, Any]:
    """Keys of a file of kind measurements that reads a recording so."""
    in_tips: dict[str, str] = {}
    in_joints: dict[str, str] = in_tips if tips is joints else {}
    formulas: dict[str, str] = {}
    if "time" in clocks:
        in_tips[tips.known["time"][0]] = f"time, {clocks['time']}"
    if tips is not joints:
        in_joints[joints.known["time"][0]] = f"time, {clocks['joint_time']}"
    for meaning, (column, _) in tips.known.items():
        if re.fullmatch(r"[xyz]_\d+", meaning):
            in_tips[column] = f"{meaning}, {reading.position_unit}"
        elif re.fullmatch(r"q[wxyz]_\d+", meaning):
            in_tips[column] = meaning
    sizes = {"rotation": (ANGLES, HOMED[0]), "translation": (LENGTHS, HOMED[1])}
    for kind, (units, homed) in sizes.items():
        unit, signs, zeros = (getattr(reading, f"{kind}_{what}") for what in ("unit", "signs", "zeros"))
        for i in range(robot.n_tubes):
            meaning = f"{kind}_{i + 1}"
            if meaning not in joints.known:
                continue
            column, minus = joints.known[meaning][0], "-" if signs[i] < 0 else ""
            zero = math.remainder(zeros[i], 2 * math.pi) if kind == "rotation" else zeros[i]
            if abs(zero) <= homed:
                in_joints[column] = f"{minus}{meaning}, {unit}"
            else:
                shown = f"{abs(zero) / units[unit]:.5g}"
                formulas[meaning] = f"{minus}1 * {column} {'-' if zero < 0 else '+'} {shown}, {unit}"
    out: dict[str, Any] = {"kind": "measurements", "tips": str(tips.path.absolute()), "columns": in_tips}
    if tips is not joints:
        out |= {"joints": str(joints.path.absolute()), "joint_columns": in_joints}
    return out | ({"formulas": formulas} if formulas else {})


def _oriented(tips: LogColumns, mapping: Mapping[str, Any], robot: Robot) -> tuple[dict[str, str], Decision]:
    """Meaning of the columns of a quaternion: order, and whether it turns from the device to the sensor.

    The tube's direction in the frame of the sensor is one of its axes: the best one counts.
    """
    names = ("qw_1", "qx_1", "qy_1", "qz_1")
    as_written = {**mapping["columns"], **dict(zip(tips.quaternion, names, strict=True))}
    m = mapped(MeasurementMap.model_validate({**mapping, "columns": as_written}), str(tips.path), Path(), robot)
    assert m.orientation is not None
    seen = np.flatnonzero(np.isfinite(m.orientation).all((1, 2)) & np.isfinite(m.tip_position[:, 0]))
    rows = seen[np.unique(np.linspace(0, len(seen) - 1, DIRECTED_ROWS).astype(int))] if len(seen) else seen
    poses = solve_poses(robot, m.rotations[rows], m.translations[rows], np.zeros(1))
    rows, tip, frame = (each[poses.solved] for each in (rows, poses.position[:, 0], poses.frame))
    tangent = frame[:, :, 2] @ register(m.tip_position[rows], tip).rotation
    written = Rotation.from_matrix(m.orientation[rows]).as_quat(scalar_first=True)
    angles: dict[tuple[str, str], float] = {}
    for order, places in QUATERNIONS.items():
        turns = Rotation.from_quat(written[:, list(places)], scalar_first=True)
        for way, frames in (("sensor to device", turns), ("device to sensor", turns.inv())):
            along = np.einsum("nij,kj->kni", frames.as_matrix(), AXES)
            apart = np.arccos(np.clip(np.einsum("kni,ni->kn", along, tangent), -1, 1))
            angles[order, way] = float(np.sqrt((apart**2).mean(1)).min())
    best, second = sorted(angles, key=lambda key: angles[key])[:2]
    least, other = math.degrees(angles[best]), math.degrees(angles[second])
    text = f"directions are {least:.1f} deg off; as {', '.join(second)} {other:.0f} deg"
    if angles[best] > POINTS:
        return {}, Decision(
            about="quaternion",
            chosen="left out",
            other="",
            rms=math.nan,
            other_rms=math.nan,
            certain=True,
            reason=f"no order fits: {text}",
        )
    named = zip(names, QUATERNIONS[best[0]], strict=True)
    sign = "-" if best[1] == "device to sensor" else ""
    meanings = {tips.quaternion[k]: name if name == "qw_1" else f"{sign}{name}" for name, k in named}
    certain = other > CLEARLY * max(least, 2.0)
    return meanings, Decision(
        about="quaternion",
        chosen=", ".join(best),
        other=", ".join(second),
        rms=math.nan,
        other_rms=math.nan,
        certain=certain,
        reason=text,
    )
