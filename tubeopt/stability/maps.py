"""Maps: elastic energy over two tip angles, and the margin over two relative rotations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..block.transcription.green import ahead, reach
from ..block.transcription.reduced import ReducedProblem, evaluate, on_centreline
from ..display import Displayed
from ..equilibrium.continuation import JointPath, Point
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..equilibrium.solving import DEFAULT_DISCRETISATION, polish, reduced_problem
from ..errors import InputError, vector
from ..robots.robot import Robot
from ..solvers.parallel.blas import small
from ..typing import Array, Sentence
from .equilibria import find_equilibria
from .following import Event, motion_along
from .snapping import find_snap


@dataclass(frozen=True, eq=False)
class EnergyMap(Displayed):
    """Least elastic energy (J) with the tips of two tubes held at given angles; its stationary points are equilibria.

    first, second: (N,) tip angles (rad) of tubes `tubes`.  energy: (N, N), rows by `first`.  equilibria: all of them.
    """

    tubes: tuple[int, int]
    first: Array
    second: Array
    energy: Array
    equilibria: tuple[Equilibrium, ...]


@small
def energy_map(
    robot: Robot,
    rotations: ArrayLike,
    translations: ArrayLike | None = None,
    *,
    tubes: tuple[int, int] = (0, 1),
    samples: int = 61,
    window: ArrayLike | None = None,
) -> EnergyMap:
    """Energy over the tip angles of two tubes at given joint values.

    Everything else, the torsion inside and the tips of other tubes, takes the values of least energy, followed from
    point to point.

    Args:
        tubes: the two whose tips are held, from 0.   samples: points per axis.
        window: (2, 2) least and largest tip angle of each of them, rad; by default around all equilibria.

    Raises:
        InputError: wrong number of joint values; tubes that are the same, do not exist, or have no coupled part; a
            window that is not two ranges.
        SolveError: the equilibria at these joint values are not complete.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> tubeopt.energy_map(robot, [1.0, 0.0], samples=11).energy.shape
        (11, 11)
    """
    alpha = vector("rotations", rotations, robot.n_tubes)
    home = robot.home_translations if translations is None else translations
    shift = vector("translations", home, robot.n_tubes)
    problem = on_centreline(reduced_problem(robot, tuple(shift.tolist()), DEFAULT_DISCRETISATION))
    for tube in tubes:
        if tube not in problem.tube:
            raise InputError(f"tubes is {tubes}; each must be a tube, from 0, that is coupled to another one")
    if tubes[0] == tubes[1]:
        raise InputError(f"tubes is {tubes}; they must be two different tubes")
    found = find_equilibria(robot, alpha, shift)
    tips = np.array([e.tip_rotations for e in found])[:, list(tubes)]
    first, second = (np.linspace(low, high, samples) for low, high in _window(tips, window))
    holds = [_hold(problem, tube) for tube in tubes]
    # Held is the elastic rotation; what natural twist adds to it is known.
    ends = np.maximum(problem.assembly.end, 0.0)[list(tubes)]
    wound = problem.assembly.wound(ends)[[0, 1], list(tubes)]
    base = alpha[list(tubes)] + wound
    energy = np.empty((samples, samples))
    row = np.zeros(problem.size)
    for i in range(samples):
        z = row
        order = range(samples)
        for j in order:
            z, energy[i, j] = _held_minimum(problem, alpha, z, holds, (first[i] - base[0], second[j] - base[1]))
            if j == 0:
                row = z
    return EnergyMap(tubes, first, second, energy, tuple(found))


def _window(tips: Array, window: ArrayLike | None) -> Array:
    """(2, 2) ranges of two tip angles: as given, or around `tips` (k, 2)."""
    if window is not None:
        ranges = np.array(window, dtype=float)
        if ranges.shape != (2, 2) or not np.isfinite(ranges).all() or not (ranges[:, 0] < ranges[:, 1]).all():
            raise InputError(f"window is {window!r}; it must be two ranges, (least, largest) tip angle in rad each")
        return ranges
    low, high = tips.min(0), tips.max(0)
    reach = np.maximum(0.6 * (high - low), np.radians(60))
    return np.column_stack([low - reach, high + reach])


def _hold(problem: ReducedProblem, tube: int) -> tuple[Array, float]:
    """The tip angle of a tube given z: alpha + a . z + d zeta, with zeta a further coordinate of unit stiffness.

    (a, d) is the next row of the Cholesky factor when the tube's end joins the collocation points.
    """
    assembly = problem.assembly
    mine = problem.tube == tube
    end = float(assembly.end[tube])
    # theta(end) responds to the moment at a point by |beta| + s, which the collocated integral has exactly.
    across = problem.arc_length[problem.point[mine]]
    if problem.here is None:
        beta, kt = assembly.transmission[tube], assembly.torsional_stiffness[tube]
        soft, whole = (beta + across) / kt, (beta + end) / kt
    else:
        places = np.append(problem.mesh.start, assembly.total_length)
        whole = reach(problem.mesh, problem.here)[int(np.abs(places - end).argmin()), tube]
        soft = ahead(problem.mesh, problem.here)[:, tube][problem.point[mine]]
    a = np.zeros(problem.size)
    a[mine] = np.linalg.solve(problem.factor[np.ix_(mine, mine)], soft)
    return a, float(np.sqrt(max(whole - a @ a, 1e-30)))


def _held_minimum(
    problem: ReducedProblem,
    rotations: Array,
    z: Array,
    holds: Sequence[tuple[Array, float]],
    twists: tuple[float, float],
) -> tuple[Array, float]:
    """Newton on the energy with both tips held; z and the energy there."""

    def total(at: Array) -> tuple[float, Array, Array]:
        state = evaluate(problem, rotations, at)
        energy, gradient, hessian = state.energy, state.gradient, state.hessian
        for (a, d), twist in zip(holds, twists, strict=True):
            zeta = (twist - float(a @ at)) / d
            energy += zeta**2 / 2
            gradient = gradient - a * (zeta / d)
            hessian = hessian + np.outer(a, a) / d**2
        return energy, gradient, hessian

    energy, gradient, hessian = total(z)
    for _ in range(60):
        values, vectors = np.linalg.eigh(hessian)
        step = -vectors @ ((vectors.T @ gradient) / np.maximum(np.abs(values), 1e-2))
        turn = float(np.abs(problem.factor @ step).max())
        if turn < 1e-7:
            break
        step *= min(1.0, 0.5 / turn)
        for _ in range(30):
            trial = total(z + step)
            if trial[0] <= energy + 1e-4 * float(gradient @ step) + 1e-13 * abs(energy):
                break
            step /= 2
        z = z + step
        energy, gradient, hessian = trial
    return z, energy


class MapStatus(Sentence):
    """What a robot did on the ways of a map; every value reads as a sentence."""

    SMOOTH = "the robot snaps on none of the ways"
    SNAPPED = "the robot snaps on some of the ways"


@dataclass(frozen=True)
class MapStatistics:
    """Ways to the points of the map, directions of its boundary, and snaps on the ways to the points."""

    ways: int
    directions: int
    snaps: int


@dataclass(frozen=True, eq=False)
class StabilityMap(Displayed):
    """What a robot does that turns its tubes together, straight from home, to each pair of relative rotations.

    tubes: the two that turn; all others stay at home.  angles: (N,) rad, of both axes.
    margin: (N, N) at the end, rows by the first tube.  snaps: (N, N) snaps on the way.
    boundary: (D, 2) rotations (rad) at the first snap in D directions; NaN in directions without.
    """

    tubes: tuple[int, int]
    angles: Array
    margin: Array
    snaps: Array
    boundary: Array

    @property
    def value(self) -> Array:
        """(N, N) the margins."""
        return self.margin

    @property
    def status(self) -> MapStatus:
        """Whether the robot snapped on any way."""
        snapped = (self.snaps > 0).any() or np.isfinite(self.boundary).any()
        return MapStatus.SNAPPED if snapped else MapStatus.SMOOTH

    @property
    def statistics(self) -> MapStatistics:
        """What it took."""
        return MapStatistics(self.margin.size, len(self.boundary), int(self.snaps.sum()))


@small
def stability_map(
    robot: Robot,
    translations: ArrayLike | None = None,
    *,
    tubes: tuple[int, int] = (0, 1),
    samples: int = 24,
    directions: int = 120,
    workers: int = 2,
    progress: Callable[[int, int], object] | None = None,
) -> StabilityMap:
    """Margin and snaps over two rotations relative to the other tubes, +-180 deg each.

    Args:
        tubes: the tubes that turn, from 0.   samples: points per axis.   directions: of the snap boundary.
        workers: processes.   progress: called with the tasks done and their number.

    Raises:
        InputError: fewer than three tubes, tubes that do not exist or are the same, a tube out of its actuator.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> chart = tubeopt.stability_map(robot, samples=3, directions=4, workers=1)
        >>> chart.margin.shape
        (3, 3)
    """
    if robot.n_tubes < 3:
        raise InputError(f"the robot has {robot.n_tubes} tubes; a map over two relative rotations needs at least 3")
    if len({*tubes} & {*range(robot.n_tubes)}) != 2:
        raise InputError(f"tubes is {tubes}; they must be two different tubes from 0 to {robot.n_tubes - 1}")
    home = robot.home_translations if translations is None else translations
    shift = vector("translations", home, robot.n_tubes)
    robot.assembly(shift)
    angles = np.linspace(-np.pi, np.pi, samples)
    phi = np.arange(directions) * 2 * np.pi / directions
    reach = np.pi / np.maximum(np.abs(np.cos(phi)), np.abs(np.sin(phi)))
    rows = [np.column_stack([np.full(samples, angle), angles]) for angle in angles]
    rays = np.array_split(np.column_stack([np.cos(phi), np.sin(phi)]) * reach[:, None], max(1, directions // 15))
    jobs = [(robot, shift, tubes, row, False) for row in rows] + [
        (robot, shift, tubes, ray, True) for ray in rays if len(ray)
    ]
    results = []
    if workers > 1:
        with ProcessPoolExecutor(workers) as pool:
            for result in pool.map(_map_job, jobs):
                results.append(result)
                if progress is not None:
                    progress(len(results), len(jobs))
    else:
        for job in jobs:
            results.append(_map_job(job))
            if progress is not None:
                progress(len(results), len(jobs))
    table = np.array(results[:samples])
    boundary = np.concatenate([np.zeros((0, 2)), *results[samples:]])
    return StabilityMap(tubes, angles, table[:, :, 0], table[:, :, 1].astype(int), boundary)


def _map_job(job: tuple[Robot, Array, tuple[int, int], Array, bool]) -> Array:
    """(k, 2) margin and number of snaps at each pair of rotations, or, for rays, the rotations at the first snap."""
    robot, shift, tubes, ends, rays = job
    n = robot.n_tubes
    origin = forward_kinematics(robot, np.zeros(n), shift)
    start = polish(origin)
    out = np.full((len(ends), 2), np.nan)
    for row, end in zip(out, ends, strict=True):
        goal = np.zeros(n)
        goal[list(tubes)] = end
        if rays:
            snap = find_snap(robot, (np.zeros(n), shift), (goal, shift), equilibrium=origin)
            if snap is not None:
                row[:] = snap.rotations[list(tubes)]
            continue
        here, snaps = Point(0.0, start), 0
        path = JointPath(robot, np.concatenate([np.zeros(n), shift]), np.concatenate([goal, shift]))
        for step in motion_along(path, start):
            if isinstance(step, Event):
                snaps += 1
            else:
                here = step
        row[:] = here.solution.margin, snaps
    return out
