"""Stability map: margin over two relative rotations, and the boundary of the first snap on straight paths from home."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..display import Displayed
from ..equilibrium.continuation import Family, SampledJointPath
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import InputError
from ..files.field_metadata import Range
from ..robots.robot import Robot, shifts
from ..solvers.blas import small
from ..solvers.parallel import executor, run_all
from ..solvers.time_limit import LONG_TIME_LIMIT, limited
from ..typing import Array, Mask, StatusEnum
from .motion import Event, motion

TURN = 2 * np.pi

HALVINGS = 7
"""Number of bisections between two directions to locate an end of the boundary: to 1/128 of their distance."""

# The margin falls to 0 within less than two points of the map.
APPROACH = np.array([0.4, 0.28, 0.2, 0.14, 0.1, 0.07, 0.05, 0.035, 0.025])
"""Distances (rad) before the first snap for samples of the margin."""

MIRRORED = np.append([-1.0, -1.0], np.ones(len(APPROACH)))
"""Signs of a row of the boundary (2 + A,) in the opposite direction, for a robot with mirror symmetry."""

JUMP = 0.1
"""Largest difference (rad) of distances from home in neighbouring directions along one boundary curve."""

EDGE_ON = 3.0
"""Largest slope, in polar coordinates, of one boundary curve."""


class MapStatus(StatusEnum):
    """Outcome on the paths of a map, as a sentence."""

    SMOOTH = "the robot snaps on none of the paths"
    SNAPPED = "the robot snaps on some of the paths"


@dataclass(frozen=True)
class MapStatistics:
    """Effort of a map."""

    paths: int
    """Number of paths to its points."""
    directions: int
    """Number of directions of its boundary."""
    snaps: int
    """Number of snaps on the paths to its points."""


@dataclass(frozen=True, eq=False)
class StabilityMap(Displayed):
    """Margins and snaps for straight motions of all tubes from home to each pair of relative rotations."""

    tubes: tuple[int, int]
    """The two rotated tubes; all others stay at home."""
    angles: Array
    """(N,) rotations on both axes, rad."""
    margin: Array
    """(N, N) margin at the end of each path; row i at `angles[i]` of the first tube."""
    snaps: Array
    """(N, N) number of snaps on each path."""
    directions: Array
    """(D,) increasing angles from the axis of the first tube, rad.

    The requested ones, and more where the boundary ends or jumps between two of them.
    """
    boundary: Array
    """(D, 2) rotations at the first snap in each direction, rad; NaN without a snap."""
    approach: Array
    """(D, A) margins at the distances APPROACH (A,) before the first snap; NaN without a snap."""

    @property
    def value(self) -> Array:
        """(N, N) margins."""
        return self.margin

    @property
    def status(self) -> MapStatus:
        """Outcome on all paths, as a sentence."""
        snapped = (self.snaps > 0).any() or np.isfinite(self.boundary).any()
        return MapStatus.SNAPPED if snapped else MapStatus.SMOOTH

    @property
    def statistics(self) -> MapStatistics:
        """Numbers of points, boundary points and snaps."""
        return MapStatistics(self.margin.size, len(self.boundary), int(self.snaps.sum()))


@typed
@small
@limited
def stability_map(
    robot: Robot,
    translations: ArrayLike | None = None,
    *,
    tubes: tuple[int, int] = (0, 1),
    samples: Annotated[int, Range(minimum=2)] = 24,
    directions: Annotated[int, Range(minimum=4)] = 120,
    workers: Annotated[int, Range(minimum=0)] = 1,
    progress: Callable[[int, int], object] | None = None,
    time_limit: float = LONG_TIME_LIMIT,
) -> StabilityMap:
    """Margin and snaps over two rotations relative to the other tubes, +-180 deg each.

    Concentric tubes that are not made of pieces have mirror images at opposite rotations. Then half of the map is
    computed, if `directions` is even.

    Args:
        tubes: the rotated tubes, from 0.
        samples: number of samples of each rotation, between -180 and 180 deg.
        directions: number of directions for the snap boundary. They are evenly around home. Where the boundary ends or
            jumps between two of them, directions are added until that place is known to 1/100 of their distance.
        workers: number of processes; 0 for one per core.
        progress: called with the tasks done and their number.
        time_limit: maximum run time, s.

    Raises:
        InputError: fewer than three tubes, tubes that do not exist or are the same, a tube out of its actuator.
        SolveError: no stable equilibrium at home, or none where the robot lands.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> chart = tubeopt.stability_map(robot, samples=3, directions=4)
        >>> chart.margin.shape
        (3, 3)
    """
    if robot.n_tubes < 3:
        raise InputError(f"the robot has {robot.n_tubes} tubes; a map over two relative rotations needs at least 3")
    if len({*tubes} & {*range(robot.n_tubes)}) != 2:
        raise InputError(f"tubes is {tubes}; they must be two different tubes from 0 to {robot.n_tubes - 1}")
    shift = shifts(robot, translations)
    # Tubes curved in one plane: opposite rotations give mirror images.
    assembly = robot.assembly(shift) if robot.fixed_sections else None
    mirrored = assembly is not None and assembly.even and not assembly.eccentric and directions % 2 == 0
    origin = forward_kinematics(robot, np.zeros(robot.n_tubes), shift)
    angles = np.linspace(-np.pi, np.pi, samples)
    rows = [
        np.column_stack([np.full(samples, angle), angles]) for angle in angles[: samples - mirrored * (samples // 2)]
    ]
    period = np.pi if mirrored else TURN
    around = np.arange(directions // (1 + mirrored)) * TURN / directions
    parts = np.array_split(around, max(1, len(around) // 15))
    jobs = [_Job(origin, tubes, row, to_first_snap=False) for row in rows]
    jobs += [_Job(origin, tubes, rim(part), to_first_snap=True) for part in parts]
    with executor(workers) as pool:
        results = run_all(_run, jobs, pool, progress)
    table, boundary = np.array(results[: len(rows)]), np.concatenate(results[len(rows) :])
    around, boundary = _refine_boundary(
        around, period, boundary, lambda ends: _run(_Job(origin, tubes, ends, to_first_snap=True))
    )
    if mirrored:
        table = np.concatenate([table, table[: samples // 2][::-1, ::-1]])
        around, boundary = np.concatenate([around, around + np.pi]), np.vstack([boundary, boundary * MIRRORED])
    return StabilityMap(
        tubes=tubes,
        angles=angles,
        margin=table[:, :, 0],
        snaps=table[:, :, 1].astype(int),
        directions=around,
        boundary=boundary[:, :2],
        approach=boundary[:, 2:],
    )


def rim(directions: Array) -> Array:
    """(D, 2) rotations at the edge of the map on rays from home in directions (D,), rad."""
    ray = np.column_stack([np.cos(directions), np.sin(directions)])
    return np.asarray(ray * (np.pi / np.abs(ray).max(1, keepdims=True)))


class _Job(NamedTuple):
    """Straight paths from an equilibrium at home that turn two tubes."""

    origin: Equilibrium
    tubes: tuple[int, int]
    ends: Array
    """(k, 2) rotations of the two tubes at the ends, rad."""
    to_first_snap: bool


def _run(job: _Job) -> Array:
    """(k, 2) margins at the ends of paths, and numbers of snaps.

    With `to_first_snap` (k, 2 + A) rotations at the first snap and the margins before it, NaN without a snap.
    """
    origin, tubes, ends, to_first_snap = job
    out = np.full((len(ends), 2 + len(APPROACH) * to_first_snap), np.nan)
    for row, end in zip(out, ends, strict=True):
        goal = np.zeros(origin.robot.n_tubes)
        goal[list(tubes)] = end
        path = _turn_straight(origin, goal, to_first_snap=to_first_snap)
        if not to_first_snap:
            row[:] = path.pose.margin, path.snaps
        elif path.first is not None:
            row[:2], row[2:] = path.first[list(tubes)], _margins_ahead(path.before, path.first)
    return out


@dataclass(frozen=True, eq=False)
class _Turned:
    """Result of a straight motion."""

    pose: Equilibrium
    """Equilibrium at the end."""
    snaps: int
    """Number of snaps."""
    first: Array | None
    """(n,) joint rotations at the first snap, rad; None without one."""
    before: Sequence[Equilibrium]
    """Equilibria before the first snap, from the origin on."""


def _turn_straight(origin: Equilibrium, rotations: Array, *, to_first_snap: bool = False) -> _Turned:
    """Motion from a stable equilibrium straight to rotations (n,), rad, or to the landing after the first snap."""
    start, goal = (np.concatenate([angles, origin.translations]) for angles in (origin.rotations, rotations))
    family, pose, snaps, first, before = Family(SampledJointPath(origin.robot, start, goal)), origin, 0, None, [origin]
    for step in motion(family, origin):
        if isinstance(step, Event):
            snaps, first = snaps + 1, family.path.at(step.lost.t)[0] if first is None else first
            if to_first_snap:
                return _Turned(step.after, snaps, first, before)
            continue
        pose = step.pose
        if first is None:
            before.append(pose)
    return _Turned(pose, snaps, first, before)


def _margins_ahead(before: Sequence[Equilibrium], snap: Array) -> Array:
    """(A,) margins at the distances APPROACH before the first snap at rotations (n,), from equilibria on the path."""
    length, margins = float(np.linalg.norm(snap)), []
    distances = np.maximum(0.0, length - APPROACH)
    pose = [each for each in before if np.linalg.norm(each.rotations) <= distances[0]][-1]
    for distance in distances:
        pose = _turn_straight(pose, snap * (distance / length)).pose
        margins.append(pose.margin)
    return np.array(margins)


def _refine_boundary(
    directions: Array, period: float, boundary: Array, first_snaps: Callable[[Array], Array]
) -> tuple[Array, Array]:
    """Directions and rows of the snap boundary, with further ones where it ends or jumps.

    Args:
        directions: (D,) angles, rad; they repeat after `period`.   boundary: (D, 2 + A), a row for each.
        first_snaps: rows of the boundary on paths to rotations (k, 2).
    """
    if len(directions) * TURN / period < 3:
        return directions, boundary
    closest = period / len(directions) / 2**HALVINGS
    while True:
        after = np.append(directions[1:], directions[0] + period)
        apart = _torn(directions, after, boundary[:, :2]) & (after - directions > 1.5 * closest)
        if not apart.any():
            return directions, boundary
        middle = ((directions + after) / 2)[apart]
        order = np.argsort(np.append(directions, middle % period), kind="stable")
        directions = np.append(directions, middle % period)[order]
        boundary = np.vstack([boundary, first_snaps(rim(middle))])[order]


def _torn(directions: Array, after: Array, boundary: Array) -> Mask:
    """(D,) True where the boundary is not one curve from a direction to the one after.

    It is present in one of them only, or so much farther away in one that the curve would be seen edge-on.
    """
    distance = np.hypot(*boundary.T)
    distance_after = np.roll(distance, -1)
    with np.errstate(invalid="ignore"):
        max_jump = np.maximum(EDGE_ON * (after - directions) * np.minimum(distance, distance_after), JUMP)
        jump = np.abs(distance_after - distance) > max_jump
    return np.asarray((np.isfinite(distance) != np.isfinite(distance_after)) | jump)


class BoundaryCurve(NamedTuple):
    """Connected curve of the boundary."""

    directions: Array
    """(k,) increasing angles, rad."""
    rotations: Array
    """(k, 2) rotations at the first snap, rad."""
    approach: Array
    """(k, A) margins before it."""


def pieces(chart: StabilityMap) -> list[BoundaryCurve]:
    """Connected curves of the boundary.

    Behind an end inside the map the next curve begins, or paths continue without a snap.
    """
    count = len(chart.directions)
    after = np.append(chart.directions[1:], chart.directions[:1] + TURN)
    cut = _torn(chart.directions, after, chart.boundary)
    present = np.isfinite(chart.boundary).all(1)
    if not present.any():
        return []
    first = int(np.argmax(cut)) + 1 if cut.any() else 0
    order = (first + np.arange(count + (not cut.any()))) % count  # a closed curve returns to its start
    angle = np.unwrap(chart.directions[order])
    ends = np.flatnonzero(cut[order[:-1]]) + 1
    columns = angle, chart.boundary[order], chart.approach[order]
    parts = zip(*(np.split(column, ends) for column in columns), strict=True)
    return [BoundaryCurve(*part) for part in parts if np.isfinite(part[1]).all()]
