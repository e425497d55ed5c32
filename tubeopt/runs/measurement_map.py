"""Measurements as labs record them: a YAML file names the tables and says what their columns mean."""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal
from os import PathLike
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from ..errors import InputError
from ..files.checked import Entry, NotNegative, Positive, check
from ..files.units import MM, to_si
from ..files.yaml_file import load_yaml
from ..robots.robot import Robot
from ..typing import Array, Mask
from ..validation.measurements import JointLog, Measurements
from ..validation.timeline import Timeline
from .measurement_checks import doubts_of, unwrapped
from .measurement_columns import Columns, columns_of
from .tracker_file import read_recorded

AXES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1), "-x": (-1, 0, 0), "-y": (0, -1, 0), "-z": (0, 0, -1)}


class MeasurementMap(Entry):
    """Tables of measured positions and of joint readings, and what their columns mean."""

    kind: Literal["measurements"]
    tips: str = Field(description="CSV file, or export of NDI or OptiTrack, of the measured positions")
    joints: str | None = Field(None, description="CSV file of the joint readings, where they were recorded apart")
    columns: dict[str, str] = Field({}, description="column: meaning, unit; an export of a tracker needs none")
    joint_columns: dict[str, str] | None = Field(None, description="the same for joints; `columns` where not given")
    frame_rate_Hz: Positive | None = Field(None, description="of an export that counts frames")
    behind_mm: list[NotNegative] | None = Field(None, description="distance of each sensor behind the tip; all 0")
    axis: Literal["x", "y", "z", "-x", "-y", "-z"] | None = Field(
        None, description="axis of the tip's sensor along the tube, towards the tip; found out where not given"
    )


def load_mapped(path: str | PathLike[str], robot: Robot) -> Measurements:
    """The measurements of `robot` that a YAML file of the kind `measurements` describes.

    Rows in which nothing was seen, or for which there are no joint readings, are left out and counted in the remarks.

    Raises:
        InputError: a file, column or unit that is not there or unknown, or cells that are not what they must be.
    """
    entry = check(MeasurementMap, load_yaml(path), path)
    folder = Path(path).parent
    rate = None if entry.frame_rate_Hz is None else float(entry.frame_rate_Hz)
    recorded = read_recorded(folder / entry.tips, rate)
    # A column that is of the other file alone says nothing of this one.
    mine = {k: v for k, v in entry.columns.items() if k in recorded.table.columns or entry.joints is None}
    meanings = {**recorded.meaning, **mine}
    tips = columns_of(recorded.table, meanings, str(path), robot.n_tubes)
    joints = tips
    if entry.joints is not None:
        table = read_recorded(folder / entry.joints).table
        own = entry.joint_columns or {k: v for k, v in entry.columns.items() if k in table.columns}
        joints = columns_of(table, own, str(path), robot.n_tubes)
    _complete(path, entry, tips, joints, robot)
    positions = tips.positions()
    time = tips.numbers(["time"])[:, 0] if tips.has("time") else None
    rotations = joints.numbers([f"rotation_{i + 1}" for i in range(robot.n_tubes)])
    translations = joints.translations(robot.home_translations)
    stamps = joints.numbers(["time"])[:, 0] if joints is not tips else None
    frames = tips.orientation(_foremost(tips, entry))
    for columns in (tips, joints):
        columns.table.check()
    found = _assemble(entry, robot, positions, time, (rotations, translations), stamps, frames)
    return replace(found, remarks=(*recorded.remarks, *found.remarks))


def _complete(path: str | PathLike[str], entry: MeasurementMap, tips: Columns, joints: Columns, robot: Robot) -> None:
    """Raise InputError naming every quantity that is needed and has no column."""
    missing = [f"rotation_{i + 1}" for i in range(robot.n_tubes) if not joints.has(f"rotation_{i + 1}")]
    sensors = tips.sensors() or [1]
    missing += [f"{axis}_{k}" for k in sensors for axis in "xyz" if not tips.has(f"{axis}_{k}")]
    if joints is not tips and not (tips.has("time") and joints.has("time")):
        missing.append("time, in both files")
    if missing:
        raise InputError("\n".join(f"{path}: no column is said to hold {name}" for name in missing))
    if entry.behind_mm is not None and len(entry.behind_mm) != len(sensors):
        raise InputError(f"{path}: behind_mm has {len(entry.behind_mm)} numbers; there are {len(sensors)} sensors")


def _foremost(tips: Columns, entry: MeasurementMap) -> int:
    sensors = tips.sensors()
    behind = entry.behind_mm or [Decimal(0)] * len(sensors)
    return min(zip(behind, sensors, strict=True))[1]


def _assemble(
    entry: MeasurementMap,
    robot: Robot,
    positions: Array,
    time: Array | None,
    joints: tuple[Array, Array],
    stamps: Array | None,
    frames: Array | None,
) -> Measurements:
    words: list[str] = []
    kept = seen_rows(positions, entry.tips, words)
    rotations, translations = joints
    turning = stamps if stamps is not None else time
    if turning is not None:
        rotations = unwrapped(turning, rotations, words)
    log = None
    if stamps is not None and time is not None:
        log = JointLog(stamps, rotations, translations)
        covered = (time >= stamps[0]) & (time <= stamps[-1])
        _count(words, kept & ~covered, "lie before or after all joint readings and were left out")
        kept &= covered
        if not kept.any():
            raise InputError(
                f"{entry.tips} and {entry.joints} have no time in common: tips from {time[0]:g} to {time[-1]:g} s, "
                f"joints from {stamps[0]:g} to {stamps[-1]:g} s; both must be of one clock"
            )
        rotations = translations = np.zeros((len(time), robot.n_tubes))
    found = Measurements(
        rotations[kept],
        translations[kept],
        positions[kept],
        source=Path(entry.tips).name,
        time=None if time is None else time[kept],
        behind=None if entry.behind_mm is None else np.array([to_si(x, MM) for x in entry.behind_mm]),
        orientation=None if frames is None else frames[kept],
        sensor_axis=None if entry.axis is None else np.array(AXES[entry.axis], dtype=float),
        log=log,
    )
    return finished(found, robot, words)


def seen_rows(positions: Array, where: str | PathLike[str], words: list[str]) -> Mask:
    """(rows,) whether any of the sensors (rows, S, 3) was seen; `words` tell how many rows are left out."""
    seen = np.asarray(np.isfinite(positions[..., 0]).any(1))
    if not seen.any():
        raise InputError(f"{where}: no row has a measured position")
    _count(words, ~seen, "have no measured position and were left out")
    return seen


def finished(found: Measurements, robot: Robot, words: list[str]) -> Measurements:
    """Measurements with joints at the times of their rows, and what was noticed when they were read."""
    if found.log is not None:
        rotations, translations = Timeline.of(found).readings(0.0)
        found = replace(found, rotations=rotations, translations=translations)
    for k in range(found.sensors.shape[1]):
        _count(words, np.isnan(found.sensors[:, k, 0]), f"have no position of sensor {k + 1}")
    return replace(found, remarks=(*words, *doubts_of(found, robot)))


def _count(words: list[str], mask: Mask, what: str) -> None:
    if mask.any():
        words.append(f"{int(mask.sum())} of {len(mask)} rows {what}")
