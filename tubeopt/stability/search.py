"""A way on which a concentric robot snaps: inside its joint limits if search finds one there, else beyond them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from ..continuation import JointPath, Point
from ..errors import SolveError
from ..robots.assembly import Array, Mask
from ..robots.robot import Robot
from ..solution import DEFAULT_DISCRETISATION, Solution, reduced_problem
from ..solvers.newton import NewtonResult
from ..transcription.reduced import Index, ReducedProblem, evaluate, margin
from .folds import Fold
from .following import Event, Snap, follow, to_snap
from .landing import land
from .pair import PairFold, pair_fold
from .sheet import OVERSHOOT, TURN, edges, stable_sheet
from .snapping import find_snap
from .turning import clipped, inside, placed, relaxed_rotations

RANDOM_WAYS_LOG2 = 5
"""Base-2 logarithm of the number of random directions in which a snap is looked for in the end."""

FOLDS = 12
"""Folds that end the sheet of stable equilibria to which ways are tried."""

WAYPOINTS = (1, 3, 7)
"""Waypoints of ways to a fold that the straight way misses."""


@dataclass(frozen=True, eq=False)
class Found:
    """A snap, and the way (W, n) of rotations, rad, on whose last part it lies; `followed` says whether it was met on it,
    or is known from its fold alone."""

    way: Array
    snap: Snap
    followed: bool = True


@dataclass
class Search:
    """A search for a snap: the robot at translations (n,) m, its coupled tubes, and what was tried.

    ways: on which the robot was followed.  failed: those of them on which its equilibria were lost.
    """

    robot: Robot
    translations: Array
    progress: Callable[[int, int], object] | None
    ways: int = 0
    failed: int = 0
    problem: ReducedProblem = field(init=False)
    coupled: Index = field(init=False)

    def __post_init__(self) -> None:
        self.problem = reduced_problem(self.robot, tuple(self.translations.tolist()), DEFAULT_DISCRETISATION)
        self.coupled = np.unique(self.problem.tube)

    def follow(self, way: Array) -> Found | None:
        """The first snap on a way (W, n), which is turned into the joint limits as a whole where it fits."""
        if self.progress is not None:
            self.progress(self.ways, max(self.ways + 1, 2 ** (RANDOM_WAYS_LOG2 + 1)))
        self.ways += 1
        way = placed(self.robot, self.coupled, way)
        try:
            if len(way) == 2:
                snap = find_snap(self.robot, (way[0], self.translations), (way[1], self.translations))
                return None if snap is None else Found(way, snap)
            snaps = follow(self.robot, way, np.tile(self.translations, (len(way), 1))).snaps
            return Found(way[: snaps[0].index + 2], snaps[0]) if snaps else None
        except SolveError:
            self.failed += 1
            return None


def search_snap(
    robot: Robot,
    translations: Array,
    unstable: Array,
    progress: Callable[[int, int], object] | None = None,
) -> tuple[Found | None, Search]:
    """Look for a way from the relaxed pose on which a robot with concentric tubes snaps, and say what was tried.

    Two coupled tubes are decided: the snap is found if there is one, however far away. For more, a robot is turned
    inside its joint limits along full turns of every tube; across the folds at which the sheet of stable equilibria
    around its relaxed pose ends (see `stability.sheet`), straight, or along the sheet where the straight way leads
    around the fold; and along other full turns and random directions as far as the limits allow. Then it is turned
    beyond the limits, unless no unstable equilibrium is known.

    Args:
        translations: (n,) m.  unstable: (B, n) tip angles of unstable equilibria.
        progress: called with the ways tried and their likely number.
    """
    search = Search(robot, translations, progress)
    if len(search.coupled) < 2:
        return None, search
    if len(search.coupled) == 2:
        return _pair(search), search
    start, *_ = relaxed_rotations(robot, search.coupled)
    if inside(robot, search.coupled, start):
        found = _within(search, start, unstable)
        if found is not None:
            return found, search
    return (_beyond(search, start, unstable) if len(unstable) else None), search


def _within(search: Search, start: Array, unstable: Array) -> Found | None:
    """A snap inside the joint limits."""

    def limited(end: Array) -> Array:
        return np.stack([start, clipped(search.robot, search.coupled, start, end)])

    for end in _turns(search, start):
        if (found := search.follow(limited(end))) is not None:
            return found
    if len(unstable):

        def allowed(joints: Array) -> Mask:
            return inside(search.robot, search.coupled, _absolute(search, start, joints))

        for way in _to_folds(search, start, unstable, allowed):
            if (found := search.follow(np.array([*way[:-1], *limited(way[-1])[1:]]))) is not None:
                return found
    for end in _others(search, start):
        if (found := search.follow(limited(end))) is not None:
            return found
    return None


def _beyond(search: Search, start: Array, unstable: Array) -> Found | None:
    """A snap wherever it is."""
    ways = _to_folds(search, start, unstable, lambda joints: np.ones(joints.shape[:-1], dtype=bool))
    turns = (np.stack([start, end]) for end in _turns(search, start))
    return next((found for way in itertools.chain(ways, turns) if (found := search.follow(way)) is not None), None)


def _absolute(search: Search, start: Array, joints: NDArray[np.float64]) -> Array:
    """(..., n) rotations that lie by `joints` (..., d) from the relaxed pose."""
    out = np.zeros((*joints.shape[:-1], len(start))) + start
    out[..., search.coupled[:-1]] += joints
    return out


def _to_folds(search: Search, start: Array, unstable: Array, allowed: Callable[[Array], Mask]) -> Iterator[Array]:
    """Ways (W, n) across folds at which the sheet ends: all of them straight, then all with ever more waypoints."""
    sheet = stable_sheet(search.problem, search.coupled, start, unstable)
    found = edges(sheet, allowed, FOLDS)
    for edge in found:
        reach = np.abs(edge.fold).max()
        yield np.stack([start, _absolute(search, start, edge.fold * (1 + OVERSHOOT / reach))])
    for count in WAYPOINTS:
        for edge in found:
            places = np.linspace(0, len(edge.way) - 1, count + 1).round().astype(int)
            yield _absolute(search, start, np.array([*edge.way[places], edge.beyond]))


def _turns(search: Search, start: Array) -> Iterator[Array]:
    """(n,) rotations a turn from `start` of each coupled tube but the outermost, to a side on which it may turn."""
    low, high = np.array(search.robot.limits.rotations).T
    for tube in search.coupled[:-1]:
        turn = TURN * (np.arange(len(start)) == tube)
        fits = [end for end in (start + turn, start - turn) if ((end >= low) & (end <= high)).all()]
        yield fits[0] if fits else start + turn


def _others(search: Search, start: Array) -> Iterator[Array]:
    """(n,) rotations further turns of groups of tubes, and random ones, from `start`."""
    group = search.coupled[:-1]
    for signs in itertools.product((0, 1, -1), repeat=len(group)):
        if next((sign for sign in signs if sign), -1) > 0 and sum(map(abs, signs)) > 1:
            yield _absolute(search, start, 2 * TURN * np.array(signs))
    for unit in 2 * qmc.Sobol(len(group), rng=0).random_base2(RANDOM_WAYS_LOG2) - 1:
        if np.abs(unit).max() > 1e-3:
            yield _absolute(search, start, np.radians(np.round(720 * unit / np.abs(unit).max(), 1)))


def _pair(search: Search) -> Found | None:
    """The snap of two coupled tubes."""
    poses = relaxed_rotations(search.robot, search.coupled)
    fold = pair_fold(search.problem, search.coupled, poses[0])
    if fold is None:
        return None
    way = _pair_way(search, poses, fold)
    found = search.follow(way)
    turned = None if found is None else np.ptp(found.snap.rotations[search.coupled] - found.way[0][search.coupled])
    return found if turned is not None and abs(turned - fold.turn) < 1e-6 else _exact(search, way, fold)


def _pair_way(search: Search, poses: list[Array], fold: PairFold) -> Array:
    """(2, n) straight way across the fold: inside the joint limits if from any pose to any side the fold is."""
    low, high = np.array(search.robot.limits.rotations).T
    one = (np.arange(len(low)) == search.coupled[0]).astype(float)
    # A full turn reads best; where that is not enough, to the next multiple of 10 deg.
    length = TURN if fold.turn < TURN else np.radians(10 * (1 + np.ceil(np.degrees(fold.turn) / 10)))
    ways = [(pose, sign) for pose in poses for sign in (1, -1)]

    def fitness(way: tuple[Array, int]) -> tuple[bool, bool]:
        pose, sign = way
        both = bool(inside(search.robot, search.coupled, np.stack([pose, pose + sign * fold.turn * one])).all())
        end = pose + sign * length * one
        return both, both and bool(((end >= low) & (end <= high)).all())

    pose, sign = max(ways, key=fitness)
    end = pose + sign * length * one
    return np.stack([pose, clipped(search.robot, search.coupled, pose, end) if fitness((pose, sign))[0] else end])


def _exact(search: Search, way: Array, fold: PairFold) -> Found | None:
    """The snap built from the fold itself, which may be too shallow to be met on the way."""
    first = int(search.coupled[0])
    way = placed(search.robot, search.coupled, way)
    ends = [np.concatenate([rotations, search.translations]) for rotations in way]
    path = JointPath(search.robot, ends[0], ends[1])
    relative = way[:, first] - way[:, int(search.coupled[1])]
    sign, t = np.sign(relative[1] - relative[0]), fold.turn / abs(relative[1] - relative[0])
    rotations = path.at(t)[0]

    def solution(z: Array) -> Solution:
        state = evaluate(search.problem, rotations, z)
        return Solution(search.problem, rotations, NewtonResult(state, True, 0, 0.0), margin(search.problem, state))

    vanishing = Fold(t, solution(sign * fold.z), fold.direction)
    after = land(vanishing.solution, fold.direction) if fold.beyond is None else solution(sign * fold.beyond)
    return None if after is None else Found(way, to_snap(path, Event(vanishing, Point(t, after)), 0), followed=False)
