"""A trajectory played by a robot: what it does at every waypoint, and at any time between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from os import PathLike

import numpy as np

from ...equilibrium.readings import to_model
from ...equilibrium.result import Equilibrium
from ...errors import InputError
from ...files.csv_file import read_csv
from ...planning.trajectory import TIME, load_trajectory
from ...robots.file import Waypoints as Way
from ...robots.file import load_waypoints as load_path
from ...robots.robot import Robot
from ...stability import Path, Snap, follow
from ...stability.following import place_of
from ...typing import Array
from .session import Session, check, moved_to, record, strides

TURN_SPEED = np.radians(45.0)
"""Speed (rad/s) of the fastest tube where a file gives no times."""

SLIDE_SPEED = 0.02
"""Speed (m/s) likewise."""


@dataclass(frozen=True, eq=False)
class Waypoints:
    """Joint values over time."""

    time: Array
    """(T,) s, from 0, increasing."""
    rotations: Array
    """(T, n) rad."""
    translations: Array
    """(T, n) m."""
    start: Equilibrium | None = None
    """At the first of them; None: where the robot settles there by itself."""


@dataclass(frozen=True, eq=False)
class Playback:
    """Waypoints and what the robot does along them."""

    waypoints: Waypoints
    path: Path
    """From the start of the waypoints: one equilibrium for each, and the snaps."""

    @property
    def duration(self) -> float:
        """Time of the last waypoint, s."""
        return float(self.waypoints.time[-1])


def load_waypoints(path: str | PathLike[str], robot: Robot) -> Waypoints:
    """Waypoints from CSV: a trajectory of `tubeopt plan` with time_s, or a path of `tubeopt follow` without.

    Without times the fastest tube rotates by 45 deg/s, or slides by 20 mm/s.

    Raises:
        InputError: no such file, a column that is unknown or missing, a cell that is no number, or times that do not
            increase. Joint values out of the robot's limits, or no equilibrium at the start with the given tip
            rotations.
    """
    if TIME not in read_csv(path).columns:
        found = without_times(robot, load_path(path, robot))
    else:
        timed = load_trajectory(path, robot)
        found = Waypoints(timed.time - timed.time[0], timed.rotations, timed.translations, timed.start())
    for k in np.flatnonzero(np.diff(found.time) <= 0):
        raise InputError(f"{path}: row {k + 2}, column {TIME} does not increase; every time must be after the last")
    for row, (alpha, shift) in enumerate(zip(found.rotations, found.translations, strict=True)):
        try:
            check(robot, alpha, shift, order=False)
        except InputError as error:
            raise InputError(f"{path}: row {row + 1}: {error}") from None
    return found


def without_times(robot: Robot, way: Way) -> Waypoints:
    """The waypoints of a path, in the model's joint values, passed at the speeds of a file without times."""
    rotations, translations = to_model(robot, way.rotations, way.translations)
    return Waypoints(paced(rotations, translations), rotations, translations)


def recorded(session: Session) -> Waypoints:
    """What a session has recorded, where the robot stood still but once, as waypoints that are passed at the speeds of
    a file without times.

    Raises:
        InputError: nothing was recorded, or the robot did not move.
    """
    rows = np.array(session.recording or [np.zeros(2 * session.robot.n_tubes)])
    moved = np.append(True, np.abs(np.diff(rows, axis=0)).max(1) > 0)
    if moved.sum() < 2:
        raise InputError("nothing was recorded: tick 'record what the robot passes', and move the robot")
    rotations, translations = np.split(rows[moved], 2, axis=1)
    return Waypoints(paced(rotations, translations), rotations, translations, session.recorded_from)


def paced(rotations: Array, translations: Array) -> Array:
    """(T,) times at which waypoints are passed at `TURN_SPEED` and `SLIDE_SPEED`, s."""
    seconds = strides(rotations, translations, turn=TURN_SPEED, slide=SLIDE_SPEED)
    return np.concatenate([[0.0], np.cumsum(np.maximum(seconds, 1e-3))])


@lru_cache(maxsize=4)
def make_playback(robot: Robot, waypoints: Waypoints) -> Playback:
    """Motion through the waypoints from their start; computed once for all tabs.

    Raises:
        SolveError: the branch was lost on the path.
    """
    way = waypoints.rotations, waypoints.translations
    return Playback(waypoints, follow(robot, *way, start=waypoints.start))


def play_to(session: Session, playback: Playback, time: float, *, since: float | None = None) -> Session:
    """The session with its robot at a time of the trajectory, in the state that the trajectory's own history leads to.

    Args:
        since: where the robot was before, s: the snaps in between then go into the log. None is a leap: it logs none,
            and a recording begins anew.
    """
    t = min(max(float(time), 0.0), playback.duration)
    snaps = () if since is None else snaps_between(playback, since, t)
    there = state_at(playback, t)
    moved = moved_to(session, there, snaps)
    # A leap is no motion that could be recorded: what was before it did not lead here.
    leapt = since is None and session.recording is not None and not _same(session.equilibrium, there)
    return record(moved, True) if leapt else moved


def _same(one: Equilibrium, other: Equilibrium) -> bool:
    """Whether two equilibria of a robot are at the same joint values, and on the same branch."""
    pairs = ((getattr(each, name) for each in (one, other)) for name in ("rotations", "translations", "tip_rotations"))
    return all(np.allclose(a, b, rtol=0, atol=1e-7) for a, b in pairs)


def state_at(playback: Playback, time: float) -> Equilibrium:
    """Where the robot is at a time within the trajectory, s."""
    points = playback.waypoints
    k = min(max(int(np.searchsorted(points.time, time, side="right")) - 1, 0), len(points.time) - 1)
    here = playback.path.equilibria[k]
    if k == len(points.time) - 1 or time <= points.time[k]:
        return here
    part = (time - points.time[k]) / (points.time[k + 1] - points.time[k])
    parts = np.array([[0.0], [part]])
    way = [table[k] + parts * (table[k + 1] - table[k]) for table in (points.rotations, points.translations)]
    return follow(here.robot, *way, start=here).equilibria[-1]


def snaps_between(playback: Playback, start: float, end: float) -> tuple[Snap, ...]:
    """The snaps of a trajectory that happen after `start` and not after `end`, s."""
    times = playback.waypoints.time
    return tuple(snap for snap in playback.path.snaps if start < place_of(snap, times) <= end)
