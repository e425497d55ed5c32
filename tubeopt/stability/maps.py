"""The margin over two relative rotations, and the curve at which a robot that comes straight from home snaps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..display import Displayed
from ..equilibrium.continuation import Family, JointPath
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import InputError
from ..files.field_metadata import Range
from ..robots.assembly import Assembly
from ..robots.robot import Robot, shifts
from ..solvers.blas import small
from ..solvers.parallel import executor, run_all
from ..solvers.time_limit import LONG_TIME_LIMIT, limited
from ..typing import Array, Mask, StatusEnum
from .motion import Event, motion

TURN = 2 * np.pi

HALVINGS = 7
"""Of what lies between two directions, in search of the end of the boundary."""

APPROACH = np.array([0.4, 0.28, 0.2, 0.14, 0.1, 0.07, 0.05, 0.035, 0.025])
"""Turns (rad) ahead of the first snap at which the margin is told: it falls to 0 within less than two points of the
map."""

MIRRORED = np.append([-1.0, -1.0], np.ones(len(APPROACH)))
"""Signs of what is found in a direction (2 + A,) in the opposite one, of a robot that is its own mirror image."""

JUMP, EDGE_ON = 0.1, 3.0
"""Neighbouring directions see two pieces of the boundary if their distances from home differ by more than the first,
rad, and by more than the second, the slope of a curve in polar coordinates, allows."""


class MapStatus(StatusEnum):
    """What a robot did on the paths of a map; every value reads as a sentence."""

    SMOOTH = "the robot snaps on none of the paths"
    SNAPPED = "the robot snaps on some of the paths"


@dataclass(frozen=True)
class MapStatistics:
    """What a map took."""

    ways: int
    """To its points."""
    directions: int
    """Of its boundary."""
    snaps: int
    """On the paths to the points."""


@dataclass(frozen=True, eq=False)
class StabilityMap(Displayed):
    """Margins and snaps for straight motions of all tubes from home to each pair of relative rotations."""

    tubes: tuple[int, int]
    """The two rotated tubes; all others stay at home."""
    angles: Array
    """(N,) of both axes, rad."""
    margin: Array
    """(N, N) at the end, rows by the first tube."""
    snaps: Array
    """(N, N) number of snaps on the path."""
    directions: Array
    """(D,) angles from the axis of the first tube, increasing, rad: the requested ones, and more where the boundary
    ends or jumps between two of them.
    """
    boundary: Array
    """(D, 2) rotations at the first snap in each, rad; NaN in those without."""
    approach: Array
    """(D, A) margins at a turn of APPROACH (A,) rad ahead of it, where it falls; NaN likewise."""

    @property
    def value(self) -> Array:
        """(N, N) the margins."""
        return self.margin

    @property
    def status(self) -> MapStatus:
        """Whether the robot snapped on any path, as a sentence."""
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
    samples: Annotated[int, Range(least=2)] = 24,
    directions: Annotated[int, Range(least=4)] = 120,
    workers: Annotated[int, Range(least=1)] = 1,
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
    mirrored = own_mirror_image(robot.assembly(shift)) and directions % 2 == 0
    origin = forward_kinematics(robot, np.zeros(robot.n_tubes), shift)
    angles = np.linspace(-np.pi, np.pi, samples)
    rows = [
        np.column_stack([np.full(samples, angle), angles]) for angle in angles[: samples - mirrored * (samples // 2)]
    ]
    period = np.pi if mirrored else TURN
    around = np.arange(directions // (1 + mirrored)) * TURN / directions
    parts = np.array_split(around, max(1, len(around) // 15))
    jobs = [(origin, tubes, row, False) for row in rows] + [(origin, tubes, rim(part), True) for part in parts]
    with executor(workers) as pool:
        results = run_all(_done, jobs, pool, progress)
    table, result = np.array(results[: len(rows)]), np.concatenate(results[len(rows) :])
    around, result = _closed_in(around, period, result, lambda ends: _done((origin, tubes, ends, True)))
    if mirrored:
        table = np.concatenate([table, table[: samples // 2][::-1, ::-1]])
        around, result = np.concatenate([around, around + np.pi]), np.vstack([result, result * MIRRORED])
    whole = table[:, :, 0], table[:, :, 1].astype(int)
    return StabilityMap(tubes, angles, *whole, around, result[:, :2], result[:, 2:])


def own_mirror_image(assembly: Assembly) -> bool:
    """Whether opposite rotations give mirror images: concentric tubes, each of them curved in one plane."""
    return assembly.even and not assembly.eccentric


def rim(directions: Array) -> Array:
    """(D, 2) where rays from home in directions (D,) leave the map, rad."""
    ray = np.column_stack([np.cos(directions), np.sin(directions)])
    return np.asarray(ray * (np.pi / np.abs(ray).max(1, keepdims=True)))


def _done(job: tuple[Equilibrium, tuple[int, int], Array, bool]) -> Array:
    """Ends of paths from home, on which two tubes turn, to pairs of rotations (k, 2): margin and number of snaps
    (k, 2). On `rays`, (k, 2 + A) rotations at the first snap and the margins ahead of it, NaN without a snap."""
    origin, tubes, ends, rays = job
    out = np.full((len(ends), 2 + len(APPROACH) * rays), np.nan)
    for row, end in zip(out, ends, strict=True):
        goal = np.zeros(origin.robot.n_tubes)
        goal[list(tubes)] = end
        result = straight_way(origin, goal, to_first_snap=rays)
        if not rays:
            row[:] = result.pose.margin, result.snaps
        elif result.first is not None:
            row[:2], row[2:] = result.first[list(tubes)], _margins_ahead(result.before, result.first)
    return out


@dataclass(frozen=True, eq=False)
class End:
    """Where a path ends: in which equilibrium, after how many snaps, and the joint rotations (n,), rad, at the first of
    them, None without; `before`: equilibria on the path to it, from the origin on."""

    pose: Equilibrium
    snaps: int
    first: Array | None
    before: Sequence[Equilibrium]


def straight_way(origin: Equilibrium, rotations: Array, *, to_first_snap: bool = False) -> End:
    """What a robot does that turns straight from a stable equilibrium to other rotations (n,), rad.
    With `to_first_snap` the path ends where the robot lands from it.
    """
    start, goal = (np.concatenate([turned, origin.translations]) for turned in (origin.rotations, rotations))
    family, here, snaps, first, before = Family(JointPath(origin.robot, start, goal)), origin, 0, None, [origin]
    for step in motion(family, origin):
        if isinstance(step, Event):
            snaps, first = snaps + 1, family.path.at(step.lost.t)[0] if first is None else first
            if to_first_snap:
                return End(step.after, snaps, first, before)
            continue
        here = step.pose
        if first is None:
            before.append(here)
    return End(here, snaps, first, before)


def _margins_ahead(before: Sequence[Equilibrium], snap: Array) -> Array:
    """(A,) margins on the path to joint rotations (n,) at the first snap, APPROACH before these; `before`:
    equilibria on that path, from home on."""
    whole, margins = float(np.linalg.norm(snap)), []
    places = np.maximum(0.0, whole - APPROACH)
    here = [each for each in before if np.linalg.norm(each.rotations) <= places[0]][-1]
    for place in places:
        here = straight_way(here, snap * (place / whole)).pose
        margins.append(here.margin)
    return np.array(margins)


def _closed_in(
    directions: Array, period: float, result: Array, first_snaps: Callable[[Array], Array]
) -> tuple[Array, Array]:
    """Directions, and what is found in them, with more where two neighbours do not see one piece of boundary; after a
    `period`, rad, all is as it was."""
    if len(directions) * TURN / period < 3:
        return directions, result
    closest = period / len(directions) / 2**HALVINGS
    while True:
        after = np.append(directions[1:], directions[0] + period)
        apart = _torn(directions, after, result[:, :2]) & (after - directions > 1.5 * closest)
        if not apart.any():
            return directions, result
        between = ((directions + after) / 2)[apart]
        order = np.argsort(np.append(directions, between % period), kind="stable")
        directions = np.append(directions, between % period)[order]
        result = np.vstack([result, first_snaps(rim(between))])[order]


def _torn(directions: Array, after: Array, boundary: Array) -> Mask:
    """(D,) whether the boundary is not one curve from a direction to the one after: it is in one of them only, or so
    much further away in one that the curve between would be seen edge-on."""
    near = np.hypot(*boundary.T)
    far = np.roll(near, -1)
    with np.errstate(invalid="ignore"):
        jump = np.abs(far - near) > np.maximum(EDGE_ON * (after - directions) * np.minimum(near, far), JUMP)
    return np.asarray((np.isfinite(near) != np.isfinite(far)) | jump)


def pieces(chart: StabilityMap) -> list[tuple[Array, Array, Array]]:
    """The boundary as curves: directions (k,), rising, rotations (k, 2) at the first snap, rad, and the margins (k, A)
    ahead of it, of each.

    Where a curve ends inside the map, behind its end the next one begins, or paths lead on without a snap.
    """
    count = len(chart.directions)
    after = np.append(chart.directions[1:], chart.directions[:1] + TURN)
    cut = _torn(chart.directions, after, chart.boundary)
    there = np.isfinite(chart.boundary).all(1)
    if not there.any():
        return []
    first = int(np.argmax(cut)) + 1 if cut.any() else 0
    order = (first + np.arange(count + (not cut.any()))) % count  # a closed curve comes back to where it begins
    angle = np.unwrap(chart.directions[order])
    ends = np.flatnonzero(cut[order[:-1]]) + 1
    columns = angle, chart.boundary[order], chart.approach[order]
    parts = zip(*(np.split(column, ends) for column in columns), strict=True)
    return [part for part in parts if np.isfinite(part[1]).all()]
