"""Result of planning: joint values over time with their proof; CSV files and ROS messages of it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from ..bodies.frames import Frame, Plane
from ..bodies.obstacles import Obstacle, scene_of
from ..display import Displayed
from ..equilibrium.arm_surface import ArmSurface
from ..equilibrium.readings import to_model, to_readings
from ..equilibrium.result import Equilibrium
from ..errors import InputError
from ..files.csv_file import decoded, read_csv, to_csv
from ..files.files import read_bytes, write_text
from ..files.shipped import resolve_file
from ..files.units import DEG, MM, RAD, in_unit
from ..inverse.joints import joint_space
from ..robots.file import check_joints, joint_cells, joint_columns, load_robot
from ..robots.load import Load
from ..robots.robot import Robot
from ..stability.equilibria import find_equilibria
from ..stability.snap_distance import least_snap_distance
from ..typing import Array
from .goals import loaded
from .motion import RateLimits
from .proof import Proof


@dataclass(frozen=True, kw_only=True)
class PlanStatistics:
    """Statistics of search, smoothing and proof."""

    how: str
    """Method that found the path: "straight", "detour", "search", ..."""
    smoothed: str = ""
    """Objective of the smoothing; "corners" if only corners are rounded; "" if the motion stops at them, since
    smoothing was not requested, not valid, or no better."""
    motions: int = 0
    """Number of motions that the search checked."""
    raw_length: float = 0.0
    """Length of the searched path in joint space, in units of the joints' scales (1 rad, half the longest tube)."""
    length: float = 0.0
    """Length of the final path, in the units of the search."""
    iterations: int = 0
    """Number of iterations of the smoothing."""
    knots: int = 0
    """Number of knots of the smoothing."""
    search_seconds: float = 0.0
    smooth_seconds: float = 0.0
    proof_seconds: float = 0.0
    seconds: float = 0.0
    """Total run time, s."""


@dataclass(frozen=True, eq=False)
class Entry(Displayed):
    """Chosen pose of the base plate."""

    frame: Frame
    """Pose in the frame of the given plate."""
    base: Frame
    """Pose in the frame of the patient (RAS); equal to `frame` without a patient."""
    considered: Annotated[int, "number of positions considered"]
    clear: Annotated[int, "number of them with a collision-free arm at the start"]
    tried: Annotated[int, "number of these that were tried as start of a plan"]


@dataclass(frozen=True, eq=False)
class Trajectory(Displayed):
    """A motion on one stable branch, T samples of n tubes; joint values are linear between samples."""

    _brief = ("robot", "status", "time")

    robot: Robot
    """Robot that moves."""
    time: Array
    """(T,) times of the samples, s; evenly spaced, except for the rests of `ArmsPlan.withdrawn_first`."""
    rotations: Array
    """(T, n) rotations of the tubes, rad, not wrapped."""
    translations: Array
    """(T, n) translations, m."""
    arms: tuple[Equilibrium, ...]
    """Equilibria at the samples."""
    start: Equilibrium
    """Equilibrium at the requested start."""
    turns: Annotated[tuple[int, ...], "full turns added to the rotations of the goal"]
    """(n,) full turns added to the rotations of the goal."""
    obstacles: tuple[Obstacle, ...]
    """Obstacles that the arm avoids."""
    min_margin: float
    """Required margin."""
    min_clearance: float
    """Required clearance, m."""
    rate_limits: RateLimits
    """Limits on speeds and accelerations."""
    proof: Annotated[Proof, "the proof"]
    """Proof by independent code: `.proved` is True if it finished in time, `.status` is a sentence."""
    statistics: PlanStatistics
    """Effort of the search."""
    deviation: Array | None = None
    """(T,) distance of the tip from its required path or, for follow-the-leader, of the arm from the path of its tip,
    m; None for other plans."""
    entry: Annotated[Entry | None, "chosen position of the plate; null if it was not free"] = None
    """Result of `plan_from_region`; None if the plate was not moved."""
    cut: Plane | None = None
    """Plane in the frame of the plate that cuts bodies open in pictures."""

    @property
    def end(self) -> Equilibrium:
        """Equilibrium at the end."""
        return self.arms[-1]

    @cached_property
    def tip_position(self) -> Array:
        """(T, 3) positions of the tip, m."""
        return np.array([e.tip_position for e in self.arms])

    @cached_property
    def margin(self) -> Array:
        """(T,) margins at the samples."""
        return np.array([e.margin for e in self.arms])

    @cached_property
    def least_snap_distance(self) -> float:
        """Smallest snap distance at the samples, rad; inf if no turn can snap.

        The snap distance is the turn of every tube that is proved to cause no snap. Under a load each sample takes
        0.1 s.

        Raises:
            InputError: a load without an energy, friction or eccentric tubes, for which no such distance is known.
        """
        return least_snap_distance(self.arms)

    @cached_property
    def clearance(self) -> Array:
        """(T,) distances of the arm from the obstacles at the samples, m."""
        scene = scene_of(self.obstacles)
        return np.array([ArmSurface(e).clearance(scene) for e in self.arms])

    @property
    def value(self) -> tuple[Array, Array]:
        """Joint values over time: rotations (T, n), rad, and translations (T, n), m."""
        return self.rotations, self.translations

    @property
    def proved(self) -> bool:
        """True if the whole trajectory is proved; else the time limit was reached before the proof was finished."""
        return self.proof.holds

    @property
    def quality(self) -> float:
        """Length of the straight joint path between its ends, relative to its own length: 1 at best.

        No motion between these ends is shorter than the straight path, so the shortest one has at least this fraction
        of the length. Lengths are in units of the joints' scales.
        """
        space = joint_space(self.robot).holding(*self.translations)
        rows = zip(self.rotations, self.translations, strict=True)
        q = np.array([space.join(*row) for row in rows]) / space.scale
        length = float(np.linalg.norm(np.diff(q, axis=0), axis=1).sum())
        return float(np.linalg.norm(q[-1] - q[0])) / length if length > 0 else 1.0

    @property
    def status(self) -> str:
        """Result of the proof: "proved", or its faults."""
        return "proved" if self.proved else "; ".join(self.proof.faults)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the joint values over time as CSV, with units in the header; `tubeopt verify` reads it."""
        save_trajectory(self, path)


TIME = "time_s"
ROBOT, BRANCH = "robot: ", "start tip rotations in deg: "


@dataclass(frozen=True, eq=False)
class TimedJoints:
    """Joint values over time, as read from a file."""

    robot: Robot
    time: Array
    """(T,) times of the joint values, s."""
    rotations: Array
    """(T, n) rotations, rad."""
    translations: Array
    """(T, n) translations, m."""
    start_tips: Array | None
    """(n,) tip rotations at the start, rad; None if the file has none."""

    def start(self, load: Load | None = None) -> Equilibrium | None:
        """Equilibrium at the first sample, under a load, with the tip rotations of the file; None without these.

        Raises:
            InputError: no equilibrium there has these tip rotations.
        """
        tips = self.start_tips
        if tips is None:
            return None
        equilibria = find_equilibria(self.robot, self.rotations[0], self.translations[0])
        if load is not None:
            equilibria = loaded([e for e in equilibria if e.stable], load)[0]
        best = min(equilibria, key=lambda e: float(np.abs(e.tip_rotations - tips).max()), default=None)
        if best is None or np.abs(best.tip_rotations - tips).max() > 1e-3:
            under = "" if load is None else " under this load"
            raise InputError(
                "no equilibrium at the first sample has the tip rotations of the "
                f"file{under}; verify a trajectory under the load of its plan"
            )
        return best


def save_trajectory(trajectory: Trajectory, path: str | PathLike[str], *, robot_file: str = "") -> None:
    """Write readings of the drives over time as CSV; `robot_file`: path of the robot's file, relative to this one.

    Raises:
        InputError: the file cannot be written.
    """
    t = trajectory
    comment = [f"{ROBOT}{robot_file}"] if robot_file else []
    comment += [branch_line(t.start), f"least margin {t.proof.least_margin:.6f}, {t.status}"]
    write_text(path, timed_csv(t.time, *to_readings(t.robot, t.rotations, t.translations), comment))


def timed_csv(time: Array, rotations: Array, translations: Array, comment: Sequence[str]) -> str:
    """CSV text for `load_trajectory`: time (T,) s, readings of rotations (T, n) rad and translations (T, n) m."""
    turns, shifts = joint_columns(rotations.shape[1])
    rows = (
        [in_unit(float(t), RAD), *joint_cells(*joints)]
        for t, *joints in zip(time, rotations, translations, strict=True)
    )
    return to_csv([TIME, *turns, *shifts], rows, "\n".join(comment))


def branch_line(start: Equilibrium) -> str:
    """Comment in a file of joint values that identifies the branch at its start."""
    return BRANCH + ", ".join(str(in_unit(float(angle), DEG)) for angle in start.tip_rotations)


def joint_trajectory(trajectory: Trajectory) -> dict[str, Any]:
    """Readings of the drives over time as plain data of the ROS message trajectory_msgs/JointTrajectory.

    SI units; joint names rotation_1, ... and translation_1, ...; rates and accelerations by central differences, at
    rest at both ends.
    """
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
    arm = robot if robot is not None else load_robot(resolve_file(named[0], Path(path).parent))
    turns, shifts = joint_columns(arm.n_tubes)
    table = read_csv(path, (TIME, *turns, *shifts))
    moved = table.expect([TIME, *turns], together=shifts)
    time, rotations = table.numbers([TIME], RAD)[:, 0], table.numbers(turns, DEG)
    home = np.tile(arm.home_readings, (len(table.rows), 1))
    translations = table.numbers(shifts, MM) if moved else home
    check_joints(table, arm)
    table.check()
    return TimedJoints(arm, time, *to_model(arm, rotations, translations), _tips(path, comments, arm.n_tubes))


def _tips(path: str | PathLike[str], comments: list[str], n: int) -> Array | None:
    values = [line.removeprefix(BRANCH) for line in comments if line.startswith(BRANCH)]
    if not values:
        return None
    try:
        tips = np.radians([float(part) for part in values[0].split(",")])
    except ValueError:
        tips = np.zeros(0)
    if len(tips) != n or not np.isfinite(tips).all():
        raise InputError(f"{path}: start tip rotations are {values[0]!r}; they must be {n} numbers")
    return tips
