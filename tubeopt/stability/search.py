"""A way on which a concentric robot snaps: inside its joint limits if search finds one there, else beyond them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from ..equilibrium.member import Point
from ..equilibrium.problem import DEFAULT_DISCRETISATION, reduced_problem
from ..equilibrium.unloaded import Unloaded
from ..errors import SolveError
from ..robots.robot import Robot
from ..solvers.sampling import sobol
from ..typing import Array, Mask
from .branch_surface import TURN, folds, stable_sheet
from .folds import fall
from .following import find_snap
from .motion import Event, Snap
from .pair import PairFold, farthest_fold, pair_fold, pair_of
from .settings import DEFAULT_SEARCH, SnapSearch


@dataclass(frozen=True, eq=False)
class Found:
    """A snap, and the straight way (2, n) of rotations, rad, on which it lies.

    followed: whether it was met there, or is known from its fold alone.
    """

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
    effort: SnapSearch
    progress: Callable[[int, int], object] | None
    ways: int = 0
    failed: int = 0

    def __post_init__(self) -> None:
        self.problem = reduced_problem(self.robot, tuple(self.translations.tolist()), DEFAULT_DISCRETISATION)
        self.coupled = np.unique(self.problem.tube)
        self.low, self.high = np.array(self.robot.limits.rotations).T

    def follow(self, start: Array, end: Array) -> Found | None:
        """The first snap on a straight way, which is turned into the joint limits as a whole where it fits."""
        if self.progress is not None:
            self.progress(self.ways, max(self.ways + 1, 2 * self.effort.random_ways))
        self.ways += 1
        way = self.placed(np.stack([start, end]))
        try:
            snap = find_snap(self.robot, (way[0], self.translations), (way[1], self.translations))
        except SolveError:
            self.failed += 1
            return None
        return None if snap is None else Found(way, snap)

    def relaxed(self) -> list[Array]:
        """(n,) rotations, nearest to home, at which all tubes curve to one side, so that none is twisted.

        A tube that curves to the other side than the outermost coupled one is turned by half a turn, to one side or the
        other: these are two poses, mirror images. Those inside the joint limits come first.
        """
        curvature = np.array([tube.curvature for tube in self.robot.tubes])[self.coupled]
        other_side = np.zeros(self.robot.n_tubes)
        other_side[self.coupled] = np.pi * (curvature * curvature[-1] < 0)
        poses = [other_side, -other_side] if other_side.any() else [other_side]
        return sorted(poses, key=lambda pose: not self.inside(pose))

    def inside(self, rotations: Array) -> Mask:
        """(...) whether rotations (..., n), turned together, are inside the joint limits to round-off."""
        angles = rotations[..., self.coupled]
        high, low = self.high[self.coupled] - angles, self.low[self.coupled] - angles
        return np.asarray(high.min(-1) - low.max(-1) >= -1e-9)

    def within(self, rotations: Array) -> bool:
        """Whether rotations (n,) are inside the joint limits as they are."""
        return bool(((rotations >= self.low) & (rotations <= self.high)).all())

    def clipped(self, start: Array, end: Array) -> Array:
        """The last rotations (n,) inside the joint limits on the straight way from `start`, which is inside."""
        here, rate = start[self.coupled], (end - start)[self.coupled]
        closing = rate[:, None] - rate
        left = self.high[self.coupled, None] - self.low[self.coupled] - (here[:, None] - here)
        most = np.min(left[closing > 0] / closing[closing > 0], initial=1.0)
        return np.asarray(end if most >= 1 else start + max(most, 0.0) * (end - start))

    def placed(self, way: Array) -> Array:
        """Waypoints (W, n) with all tubes turned together where that brings each inside the joint limits.

        Where limits differ from tube to tube this is the least turn. A tube that is not coupled goes to its rotation
        nearest to home. Limits are a box, so straight ways between waypoints inside are inside.
        """
        out = np.clip(np.zeros_like(way), self.low, self.high)
        angles = way[:, self.coupled]
        least, most = (self.low[self.coupled] - angles).max(1), (self.high[self.coupled] - angles).min(1)
        turn = np.where(least <= most, np.clip(0.0, least, most), 0.0)
        out[:, self.coupled] = angles + turn[:, None]
        return np.asarray(out)

    def relative(self, start: Array, joints: Array) -> Array:
        """(..., n) rotations that lie by `joints` (..., d) from `start` (n,)."""
        out = np.zeros((*joints.shape[:-1], len(start))) + start
        out[..., self.coupled[:-1]] += joints
        return out


def search_snap(
    robot: Robot,
    translations: Array,
    unstable: Array,
    effort: SnapSearch = DEFAULT_SEARCH,
    progress: Callable[[int, int], object] | None = None,
) -> tuple[Found | None, Search]:
    """Look for a way from the relaxed pose on which a robot with concentric tubes snaps, and say what was tried.

    Two coupled tubes are decided: the snap is found if there is one, however far away, of tubes made of pieces unless
    it is too shallow to be followed. For more, a robot is turned inside its joint limits along full turns of every
    tube; across folds at the edge of the stable equilibria around its relaxed pose (see `stability.branch_surface`);
    and along other full turns and random directions, up to 720 deg where the limits allow it. Then it is turned beyond
    the limits, unless no unstable equilibrium is known.
    `unstable` (B, n): tip angles of unstable equilibria.
    """
    search = Search(robot, translations, effort, progress)
    if len(search.coupled) < 2:
        return None, search
    if not robot.even:
        return _of_pieces(search), search
    if len(search.coupled) == 2:
        return _pair(search), search
    start, *_ = search.relaxed()
    if search.inside(start):
        found = _from_relaxed(search, start, unstable, within=True)
        if found is not None:
            return found, search
    return (_from_relaxed(search, start, unstable, within=False) if len(unstable) else None), search


def _of_pieces(search: Search) -> Found | None:
    """A snap of tubes made of pieces on full turns from home, inside the joint limits: they have no relaxed pose, and
    two of them need not be symmetric about one. Of two coupled ones, wherever it is: on a way up from any equilibrium
    a fold is met before the tip angle has turned once, if there is one."""
    start = np.clip(np.zeros(search.robot.n_tubes), search.low, search.high)
    found = _on_ways(search, start, itertools.chain(_turns(search, start), _others(search, start)), within=True)
    if found is not None:
        return found
    pair = pair_of(search.problem)
    return None if pair is None else search.follow(start, search.relative(start, np.array([farthest_fold(pair)])))


def _from_relaxed(search: Search, start: Array, unstable: Array, *, within: bool) -> Found | None:
    """A snap inside the joint limits, or wherever it is."""

    def allowed(joints: Array) -> Mask:
        if within:
            return search.inside(search.relative(start, joints))
        return np.ones(joints.shape[:-1], dtype=bool)

    across, turns = _across_folds(search, start, unstable, allowed), _turns(search, start)
    ends = [turns, across, _others(search, start)] if within else [across, turns]
    return _on_ways(search, start, itertools.chain.from_iterable(ends), within=within)


def _on_ways(search: Search, start: Array, ends: Iterable[Array], *, within: bool) -> Found | None:
    """The first snap on straight ways from `start` to rotations (n,), cut off at the joint limits if `within`."""
    for end in ends:
        goal = search.clipped(start, end) if within else end
        if (found := search.follow(start, goal)) is not None:
            return found
    return None


def _across_folds(search: Search, start: Array, unstable: Array, allowed: Callable[[Array], Mask]) -> Iterator[Array]:
    """(n,) rotations a little beyond folds at which the sheet ends; none where no equilibrium is known unstable."""
    if len(unstable):
        sheet = stable_sheet(search.problem, search.coupled, start, unstable, search.effort)
        for fold in folds(sheet, allowed, search.effort):
            yield search.relative(start, fold * (1 + search.effort.overshoot / np.abs(fold).max()))


def _turns(search: Search, start: Array) -> Iterator[Array]:
    """(n,) rotations a turn from `start` of each coupled tube but the outermost, to a side on which it may turn."""
    for tube in search.coupled[:-1]:
        turn = TURN * (np.arange(len(start)) == tube)
        fits = [end for end in (start + turn, start - turn) if search.within(end)]
        yield fits[0] if fits else start + turn


def _others(search: Search, start: Array) -> Iterator[Array]:
    """(n,) rotations further turns of groups of tubes, and random ones, from `start`."""
    group = search.coupled[:-1]
    for signs in itertools.product((0, 1, -1), repeat=len(group)):
        if next((sign for sign in signs if sign), -1) > 0 and sum(map(abs, signs)) > 1:
            yield search.relative(start, 2 * TURN * np.array(signs))
    for unit in 2 * sobol(len(group), search.effort.random_ways) - 1:
        if np.abs(unit).max() > 1e-3:
            yield search.relative(start, np.radians(np.round(720 * unit / np.abs(unit).max(), 1)))


def _pair(search: Search) -> Found | None:
    """The snap of two coupled tubes."""
    poses, pair = search.relaxed(), pair_of(search.problem)
    fold = None if pair is None else pair_fold(pair)
    if fold is None:
        return None
    way = _pair_way(search, poses, fold)
    found = search.follow(*way)
    turned = None if found is None else np.ptp(found.snap.rotations[search.coupled] - found.way[0][search.coupled])
    return found if turned is not None and abs(turned - fold.turn) < 1e-6 else _exact(search, way, fold)


def _pair_way(search: Search, poses: list[Array], fold: PairFold) -> Array:
    """(2, n) straight way across the fold: inside the joint limits if from any pose to any side the fold is."""
    one = (np.arange(search.robot.n_tubes) == search.coupled[0]).astype(float)
    # A full turn reads best; where that is not enough, to the next multiple of 10 deg.
    length = TURN if fold.turn < TURN else np.radians(10 * (1 + np.ceil(np.degrees(fold.turn) / 10)))
    ways = [(pose, sign) for pose in poses for sign in (1, -1)]

    def fitness(way: tuple[Array, int]) -> tuple[bool, bool]:
        pose, sign = way
        both = bool(search.inside(np.stack([pose, pose + sign * fold.turn * one])).all())
        end = pose + sign * length * one
        return both, both and search.within(end)

    pose, sign = max(ways, key=fitness)
    end = pose + sign * length * one
    return np.stack([pose, search.clipped(pose, end) if fitness((pose, sign))[0] else end])


def _exact(search: Search, way: Array, fold: PairFold) -> Found | None:
    """The snap built from the fold itself, which may be too shallow to be met on the way."""
    first = int(search.coupled[0])
    way = search.placed(way)
    relative = way[:, first] - way[:, int(search.coupled[1])]
    sign, t = np.sign(relative[1] - relative[0]), fold.turn / abs(relative[1] - relative[0])
    rotations = way[0] + t * (way[1] - way[0])

    member = Unloaded(search.robot, search.problem, rotations, tuple(search.translations.tolist()))
    lost = Point.at(member, sign * fold.z, t)
    after = fall(lost, fold.direction) if fold.beyond is None else Point.at(member, sign * fold.beyond, t)
    return None if after is None else Found(way, Event(lost, after).snap(0), followed=False)
