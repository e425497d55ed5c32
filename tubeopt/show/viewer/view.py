"""Initial state of a tab, its trajectory, and files that are loaded in the page."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from functools import lru_cache
from os import PathLike
from pathlib import Path, PurePosixPath

import numpy as np

from ...bodies.corridors import load_mesh
from ...bodies.images import field_of_image, read_image
from ...bodies.obstacles import Obstacle, scene_of
from ...equilibrium.readings import to_model
from ...equilibrium.result import MIN_MARGIN, Equilibrium
from ...errors import InputError
from ...files.csv_file import read_csv
from ...files.yaml_file import load_yaml
from ...planning.trajectory import TIME, load_trajectory
from ...robots.file import Waypoints
from ...robots.file import load_waypoints as load_path
from ...robots.load import Load
from ...robots.robot import Robot
from ...runs.surroundings_file import load_anatomy, load_obstacles
from ...stability import Path as JointPath
from ...stability import Snap, follow
from ...stability.following import value_at_snap
from ...typing import Array
from .session import Session, check, moved_to, open_session, push_on, record, strides

TURN_SPEED = np.radians(45.0)
"""Speed (rad/s) of the fastest tube where a file gives no times."""

SLIDE_SPEED = 0.02
"""Speed of translations, m/s, of a file without times."""


@dataclass(frozen=True, eq=False)
class ViewerWaypoints:
    """Joint values over time."""

    time: Array
    """(T,) increasing times from 0, s."""
    rotations: Array
    """(T, n) rotations, rad."""
    translations: Array
    """(T, n) translations, m."""
    start: Equilibrium | None = None
    """Equilibrium at the first waypoint; None: the one reached from home."""


@dataclass(frozen=True, eq=False)
class Playback:
    """Waypoints, and the motion of the robot along them."""

    waypoints: ViewerWaypoints
    path: JointPath
    """Path through the waypoints: one equilibrium for each, and the snaps."""

    @property
    def duration(self) -> float:
        """Time of the last waypoint, s."""
        return float(self.waypoints.time[-1])


def load_waypoints(path: str | PathLike[str], robot: Robot) -> ViewerWaypoints:
    """Waypoints from CSV: a trajectory of `tubeopt plan` with time_s, or a path of `tubeopt follow` without.

    Without times the fastest tube rotates by 45 deg/s, or slides by 20 mm/s.

    Raises:
        InputError: no such file, a column that is unknown or missing, a cell that is no number, or times that do not
            increase. Joint values out of the robot's limits, or no equilibrium at the start with the given tip
            rotations.
    """
    # The column of times decides between both kinds of files.
    if TIME not in read_csv(path).columns:
        waypoints = without_times(robot, load_path(path, robot))
    else:
        timed = load_trajectory(path, robot)
        waypoints = ViewerWaypoints(timed.time - timed.time[0], timed.rotations, timed.translations, timed.start())
    for k in np.flatnonzero(np.diff(waypoints.time) <= 0):
        raise InputError(f"{path}: row {k + 2}, column {TIME} does not increase; every time must be after the last")
    for row, (alpha, shift) in enumerate(zip(waypoints.rotations, waypoints.translations, strict=True)):
        try:
            check(robot, alpha, shift, order=False)
        except InputError as error:
            raise InputError(f"{path}: row {row + 1}: {error}") from None
    return waypoints


def without_times(robot: Robot, path: Waypoints) -> ViewerWaypoints:
    """Waypoints of a path in the model's joint values, at the speeds of a file without times."""
    rotations, translations = to_model(robot, path.rotations, path.translations)
    return ViewerWaypoints(paced(rotations, translations), rotations, translations)


def recorded(session: Session) -> ViewerWaypoints:
    """Recording of a session as waypoints, without pauses, at the default speeds.

    Raises:
        InputError: nothing was recorded, or the robot did not move.
    """
    rows = np.array(session.recording or [np.zeros(2 * session.robot.n_tubes)])
    # Equal rows would be waypoints at one time.
    moved = np.append(True, np.abs(np.diff(rows, axis=0)).max(1) > 0)
    if moved.sum() < 2:
        raise InputError("nothing was recorded: tick 'record what the robot passes', and move the robot")
    rotations, translations = np.split(rows[moved], 2, axis=1)
    return ViewerWaypoints(paced(rotations, translations), rotations, translations, session.recorded_from)


def paced(rotations: Array, translations: Array) -> Array:
    """(T,) times of waypoints at `TURN_SPEED` and `SLIDE_SPEED`, s."""
    seconds = strides(rotations, translations, turn=TURN_SPEED, slide=SLIDE_SPEED)
    # Times must increase: 1 ms is far below a picture of the player.
    return np.concatenate([[0.0], np.cumsum(np.maximum(seconds, 1e-3))])


@lru_cache(maxsize=4)
def make_playback(robot: Robot, waypoints: ViewerWaypoints) -> Playback:
    """Motion through the waypoints from their start; computed once for all tabs.

    Raises:
        SolveError: the branch was lost on the path.
    """
    joints = waypoints.rotations, waypoints.translations
    return Playback(waypoints, follow(robot, *joints, start=waypoints.start))


def play_to(session: Session, playback: Playback, time: float, *, since: float | None = None) -> Session:
    """Session with its robot at a time of the trajectory, in the state of the trajectory's own history.

    Args:
        since: time of the robot before, s: the snaps since then go into the log. None: the robot jumps, logs no snap,
            and starts a new recording.
    """
    t = min(max(float(time), 0.0), playback.duration)
    snaps = () if since is None else snaps_between(playback, since, t)
    state = state_at(playback, t)
    moved = moved_to(session, state, snaps)
    # A jump is no motion that could be recorded.
    jumped = since is None and session.recording is not None and not _same(session.equilibrium, state)
    return record(moved, True) if jumped else moved


def _same(first: Equilibrium, second: Equilibrium) -> bool:
    """True for two equilibria at the same joint values on the same branch."""
    pairs = (
        (getattr(each, name) for each in (first, second)) for name in ("rotations", "translations", "tip_rotations")
    )
    return all(np.allclose(a, b, rtol=0, atol=1e-7) for a, b in pairs)


def state_at(playback: Playback, time: float) -> Equilibrium:
    """Equilibrium at a time within the trajectory, s."""
    points = playback.waypoints
    # The last waypoint not after `time`.
    k = min(max(int(np.searchsorted(points.time, time, side="right")) - 1, 0), len(points.time) - 1)
    waypoint = playback.path.equilibria[k]
    if k == len(points.time) - 1 or time <= points.time[k]:
        return waypoint
    part = (time - points.time[k]) / (points.time[k + 1] - points.time[k])
    parts = np.array([[0.0], [part]])
    joints = [table[k] + parts * (table[k + 1] - table[k]) for table in (points.rotations, points.translations)]
    # From the waypoint's equilibrium, which has the branch; a solve from home could end on another.
    return follow(waypoint.robot, *joints, start=waypoint).equilibria[-1]


def snaps_between(playback: Playback, start: float, end: float) -> tuple[Snap, ...]:
    """The snaps of a trajectory that happen after `start` and not after `end`, s."""
    times = playback.waypoints.time
    # Half-open, so that a snap at the time of a tick is counted once.
    return tuple(snap for snap in playback.path.snaps if start < value_at_snap(snap, times) <= end)


TABLES, IMAGES, MESHES = (".yaml", ".yml"), (".nii", ".nii.gz", ".mgz", ".nrrd"), (".stl", ".ply", ".obj", ".vtk")

YAML = ".yaml,.yml,application/yaml"
"""Files that a browser offers to be loaded as YAML."""

BODIES = ",".join((*TABLES, *IMAGES, ".gz", *MESHES))
"""File endings in the dialog of a browser, which reads only the last part of a name with two dots."""


class LoadedFiles:
    """Folder of loaded files with their original names, so that references between the files work."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)

    def keep(self, name: str, content: bytes) -> Path:
        """Path of a stored file; it replaces one of the same name.

        Raises:
            InputError: a name that no file can have.
        """
        # The name comes from a browser: with directories, or "..", it could leave the folder.
        last = PurePosixPath(name.replace("\\", "/")).name
        if not last or last == ".." or "\0" in last:
            raise InputError(f"{name!r} is no name of a file")
        path = Path(self._folder.name) / last
        path.write_bytes(content)
        return path

    def message(self, error: Exception) -> str:
        """Error message, with the names of files as they were loaded."""
        # The user does not know the temporary folder.
        return str(error).replace(f"{self._folder.name}/", "").replace(self._folder.name, "the files loaded here")

    def close(self) -> None:
        """Remove all files of the folder."""
        self._folder.cleanup()


def load_bodies(path: Path) -> tuple[tuple[Obstacle, ...], str]:
    """Bodies in a file of obstacles, of an anatomy, of a mesh (mm) or of labelled voxels, and a description.

    A mesh or an image alone is placed as in its file, with the plate at its origin, and the arm avoids all labels. A
    file with the key `anatomy` names meshes and images, the lumen, and the position of the robot.

    Raises:
        InputError: as `load_obstacles`, `load_anatomy`, `load_mesh` and `read_image`.
    """
    name = path.name.lower()
    if name.endswith(MESHES):
        mesh = load_mesh(path)
        return (mesh,), mesh.stands_for or "a mesh where its file has it"
    if name.endswith((*IMAGES, ".gz")):
        image = read_image(path)
        if not image.labels:
            raise InputError(f"{path} has only label 0; forbidden regions must have another label")
        field = field_of_image(image, forbidden=image.chosen(image.labels, "label"), name=path.name)
        labels = ", ".join(map(str, image.labels))
        return (field,), f"all that has a label ({labels}), where the file has it"
    content = load_yaml(path)
    bodies = load_anatomy(path).bodies if isinstance(content, dict) and "anatomy" in content else load_obstacles(path)
    return bodies, "; ".join([f"obstacles, {len(bodies)}", *scene_of(bodies).stands_for])


@dataclass(frozen=True, eq=False)
class View:
    """Initial state of every tab."""

    robot: Robot
    rotations: Array | None = None
    """(n,) initial rotations, rad; None: as at home."""
    translations: Array | None = None
    """(n,) initial translations, m; None: home."""
    obstacles: tuple[Obstacle, ...] = ()
    """Obstacles, which motions of the tip avoid."""
    waypoints: ViewerWaypoints | None = None
    """Waypoints of a trajectory to be played."""
    min_margin: float = MIN_MARGIN
    """Smallest margin during motions of the tip; first value of the slider."""
    load: Load | None = None
    """Force on the tip and gravity at the start."""
    out: Path | None = None
    """Optional directory of exports, which are always sent to the browser."""

    def session(self) -> Session:
        """A new session; raises InputError and SolveError as `open_session` and `push_on` do."""
        session = open_session(self.robot, self.rotations, self.translations)
        if self.load is None:
            return session
        if self.load != Load(self.load.force, gravity=self.load.gravity):
            raise InputError("load is more than a force on the tip and gravity, which is what can be shown and dragged")
        return push_on(session, self.load)
