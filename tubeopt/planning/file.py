"""Trajectories in CSV: a column of time in s, then one per joint, with units; comments say of which robot they are."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ..equilibrium.readings import to_model, to_readings
from ..equilibrium.result import Equilibrium
from ..errors import InputError
from ..files.csv_file import decoded, read_csv, to_csv
from ..files.files import read_bytes, write_text
from ..files.shipped import resolved
from ..files.units import DEG, MM, RAD, in_unit
from ..robots.file import check_joints, joint_cells, joint_columns, load_robot
from ..robots.load import Load
from ..robots.robot import Robot
from ..stability.equilibria import find_equilibria
from ..typing import Array
from .goals import loaded
from .trajectory import Trajectory

TIME = "time_s"
ROBOT, BRANCH = "robot: ", "start tip rotations in deg: "


@dataclass(frozen=True, eq=False)
class TimedJoints:
    """What a file of joint values over time holds."""

    robot: Robot
    time: Array
    """(T,) s."""
    rotations: Array
    """(T, n) rad."""
    translations: Array
    """(T, n) m."""
    start_tips: Array | None
    """(n,) tip rotations at the start, rad, where the file tells them."""

    def start(self, load: Load | None = None) -> Equilibrium | None:
        """The equilibrium at the first sample, under a load, with the tip rotations of the file; None where it tells
        none.

        Raises:
            InputError: no equilibrium there has these tip rotations.
        """
        tips = self.start_tips
        if tips is None:
            return None
        found = find_equilibria(self.robot, self.rotations[0], self.translations[0])
        if load is not None:
            found = loaded([e for e in found if e.stable], load)[0]
        best = min(found, key=lambda e: float(np.abs(e.tip_rotations - tips).max()), default=None)
        if best is None or np.abs(best.tip_rotations - tips).max() > 1e-3:
            under = "" if load is None else " under this load"
            raise InputError(
                "no equilibrium at the first sample has the tip rotations of the "
                f"file{under}; verify a trajectory under the load of its plan"
            )
        return best


def save_trajectory(trajectory: Trajectory, path: str | PathLike[str], *, robot_file: str = "") -> None:
    """Write what the drives read over time; `robot_file` is where the robot is, relative to the file.

    Raises:
        InputError: the file cannot be written.
    """
    t = trajectory
    comment = [f"{ROBOT}{robot_file}"] if robot_file else []
    comment += [branch_line(t.start), f"least margin {t.proof.least_margin:.6f}, {t.status}"]
    write_text(path, timed_csv(t.time, *to_readings(t.robot, t.rotations, t.translations), comment))


def timed_csv(time: Array, rotations: Array, translations: Array, comment: Sequence[str]) -> str:
    """The text of a file that `load_trajectory` reads: time (T,) s, and what the drives read, rotations (T, n) rad and
    translations (T, n) m."""
    turns, shifts = joint_columns(rotations.shape[1])
    rows = (
        [in_unit(float(t), RAD), *joint_cells(*joints)]
        for t, *joints in zip(time, rotations, translations, strict=True)
    )
    return to_csv([TIME, *turns, *shifts], rows, "\n".join(comment))


def branch_line(start: Equilibrium) -> str:
    """The comment that tells on which branch a file of joint values begins."""
    return BRANCH + ", ".join(str(in_unit(float(angle), DEG)) for angle in start.tip_rotations)


def joint_trajectory(trajectory: Trajectory) -> dict[str, Any]:
    """What drives read over time as a message trajectory_msgs/JointTrajectory of ROS, in plain data: SI units, names
    rotation_1, ... and translation_1, ...; rates and accelerations are those of central differences, at rest at both
    ends."""
    t = trajectory
    table = np.concatenate(to_readings(t.robot, t.rotations, t.translations), axis=1)
    names = [f"{kind}_{i + 1}" for kind in ("rotation", "translation") for i in range(t.robot.n_tubes)]
    if len(t.time) > 1:
        rates = np.gradient(table, t.time, axis=0)
        rates[[0, -1]] = 0.0
        accelerations = np.gradient(rates, t.time, axis=0)
    else:
        rates = accelerations = np.zeros_like(table)
    points = []
    for time, *rows in zip(t.time, table, rates, accelerations, strict=True):
        nanoseconds = round(float(time) * 1e9)
        point: dict[str, Any] = {
            name: [float(x) + 0.0 for x in row]
            for name, row in zip(("positions", "velocities", "accelerations"), rows, strict=True)
        }
        point["effort"] = []
        point["time_from_start"] = {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}
        points.append(point)
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    return {"header": header, "joint_names": names, "points": points}


def save_joint_trajectory(trajectory: Trajectory, path: str | PathLike[str]) -> None:
    """Write the joint values over time as JSON: the fields of a message trajectory_msgs/JointTrajectory of ROS.

    Raises:
        InputError: the file cannot be written.
    """
    write_text(path, json.dumps(joint_trajectory(trajectory)) + "\n")


def load_trajectory(path: str | PathLike[str], robot: Robot | None = None) -> TimedJoints:
    """The trajectory in a CSV file, with the model's joint values.

    Columns: time_s, rotation_1_deg, ... and translation_1_mm, ... (by default home), as readings of the drives.

    Args:
        robot: the robot; by default that of the file named in a comment `# robot: FILE`.

    Raises:
        InputError: no such file, no robot, columns that are unknown or missing, cells that are no numbers.
    """
    comments = [line.lstrip("# ").strip() for line in decoded(read_bytes(path)).splitlines() if line.startswith("#")]
    named = [line.removeprefix(ROBOT) for line in comments if line.startswith(ROBOT)]
    read_csv(path)  # first: an empty file names no robot, either
    if robot is None and not named:
        raise InputError(f"{path}: the file has no robot; give --robot ROBOT.yaml")
    own = robot if robot is not None else load_robot(resolved(named[0], Path(path).parent))
    turns, shifts = joint_columns(own.n_tubes)
    table = read_csv(path, (TIME, *turns, *shifts))
    moved = table.expect([TIME, *turns], together=shifts)
    time, rotations = table.numbers([TIME], RAD)[:, 0], table.numbers(turns, DEG)
    home = np.tile(own.home_readings, (len(table.rows), 1))
    translations = table.numbers(shifts, MM) if moved else home
    check_joints(table, own)
    table.check()
    return TimedJoints(own, time, *to_model(own, rotations, translations), _tips(path, comments, own.n_tubes))


def _tips(path: str | PathLike[str], comments: list[str], n: int) -> Array | None:
    told = [line.removeprefix(BRANCH) for line in comments if line.startswith(BRANCH)]
    if not told:
        return None
    try:
        tips = np.radians([float(part) for part in told[0].split(",")])
    except ValueError:
        tips = np.zeros(0)
    if len(tips) != n or not np.isfinite(tips).all():
        raise InputError(f"{path}: start tip rotations are {told[0]!r}; they must be {n} numbers")
    return tips
