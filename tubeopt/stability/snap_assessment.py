"""Snap assessment of a robot: a proof that it cannot snap, or a path with a snap.

The certificate is the proof. Where it is not above 0, a snap is searched: of two coupled tubes at their exact fold,
otherwise across the folds that bound the stable equilibria around the relaxed pose, then on random paths.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..arguments import typed
from ..block.transcription.reduced import ReducedProblem
from ..display import Displayed
from ..equilibrium.member import Point, Unloaded
from ..equilibrium.problem import DEFAULT_DISCRETISATION, reduced_problem
from ..errors import SolveError
from ..robots.eccentric import BundleRobot
from ..robots.robot import Robot
from ..solvers.blas import small
from ..solvers.sampling import sobol
from ..solvers.time_limit import TIME_LIMIT, limited
from ..typing import Array, Index, Mask, StatusEnum
from .certificate import Certificate, certify
from .eccentric_certificate import DIRECTIONS, Untwisted, segments_of, softest_untwisted, untwisted_tips
from .folds import fall
from .following import find_snap
from .motion import Event, Snap
from .pair import PairFold, farthest_fold, pair_fold, pair_of
from .shooting import relative, relative_joints
from .worst import DEFAULT_SEARCH, SnapSearch, WorstMargin, worst_margin

# --- Stable surface of equilibria around the relaxed pose -------------------------------------------------------------

# Every set of tip angles tau has exactly one equilibrium (see `stability.shooting`). The equilibria that a robot can
# reach from its relaxed pose without a snap are the connected set of stable ones around that pose. Where the set ends,
# at a fold, the robot snaps. With joints F(tau), F(tau) - tau has the period of one turn in each relative tip angle: F
# and the sign of det F', negative beyond a fold, are computed on a grid over one turn and continued to all turns.

TURN = 2 * np.pi

# All nodes of one turn are integrated at once: 256 to 4,096 of them take less than a second. Unstable regions smaller
# than a cell enter as known unstable equilibria.
GRID = (256, 64, 16, 8, 5)
"""Nodes per turn for one, two, .. relative tip angles; the last number for all larger counts."""

MAX_TURNS = 3
"""Largest number of turns of the tips around the relaxed pose in the search for folds; joints may turn farther."""

MAX_NODES = 1_000_000
"""Maximum number of nodes of all turns together: 8 MB for each component."""

MAX_FOLDS = 12
"""Number of folds at the edge of the stable surface that are tried as targets."""

APART = 0.2
"""Relative difference between the directions of two folds from the relaxed pose below which they count as one."""

# A fold is interpolated in a cell: the true one lies up to a cell away, and the path must cross it.
OVERSHOOT = 0.3
"""Length of the path beyond a fold, rad."""


@dataclass(frozen=True, eq=False)
class EquilibriumGrid:
    """Equilibria on a grid over several turns of the d relative tip angles around the relaxed pose."""

    joints: Array
    """(M..., d) joint rotations relative to the relaxed pose, rad."""
    determinant: Array
    """(M...) determinants of the derivative of `joints` by the tip angles; 0 or negative if unstable."""
    centre: tuple[int, ...]
    """Index of the relaxed pose."""


def equilibrium_grid(problem: ReducedProblem, coupled: Index, start: Array, unstable: Array) -> EquilibriumGrid:
    """Grid around relaxed rotations `start` (n,).

    The tip angles `unstable` (B, n) of unstable equilibria replace the nodes next to them, so that an unstable region
    smaller than a cell is not missed.
    """
    d = len(coupled) - 1
    size = GRID[min(d, len(GRID)) - 1]
    shape, origin = (size,) * d, relative(start[None], coupled)
    axis = np.arange(size) * TURN / size
    tips = np.stack(np.meshgrid(*[axis] * d, indexing="ij"), axis=-1).reshape(-1, d)
    seeds = relative(unstable, coupled) - origin
    seeds -= TURN * np.floor(seeds / TURN + 0.5 / size)
    nodes = np.ravel_multi_index(tuple(np.round(seeds * size / TURN).astype(int).T), shape)
    tips[nodes] = seeds
    angles = np.tile(start, (len(tips), 1))
    angles[:, coupled[:-1]] += tips
    joints, slope = relative_joints(problem, coupled, angles)
    determinant = np.linalg.det(slope)
    determinant[nodes] = np.minimum(determinant[nodes], 0.0)
    turns = min(MAX_TURNS, int(((MAX_NODES / len(tips)) ** (1 / d) - 1) / 2))
    repeats = (2 * turns + 1,) * d
    offset = np.stack(np.meshgrid(*[np.repeat(np.arange(-turns, turns + 1), size)] * d, indexing="ij"), axis=-1)
    return EquilibriumGrid(
        joints=np.tile((joints - origin).reshape(*shape, d), (*repeats, 1)) + TURN * offset,
        determinant=np.tile(determinant.reshape(shape), repeats),
        centre=(turns * size,) * d,
    )


def folds(grid: EquilibriumGrid, allowed: Callable[[Array], Mask], max_folds: int = MAX_FOLDS) -> Array:
    """(E, d) approximate folds that bound the stable set around the relaxed pose: joint rotations relative to it.

    The nearest come first, each in a direction of its own. `allowed`, (..., d) -> (...), is True for joint rotations
    that the fold, and a path of equilibria to it, may have.
    """
    free = (grid.determinant > 0) & allowed(grid.joints)
    if not free[grid.centre]:
        return np.empty((0, grid.joints.shape[-1]))
    labels = scipy.ndimage.label(free)[0]
    reached = labels == labels[grid.centre]
    # det F' changes sign between a reached node and an unstable neighbour: linear interpolation.
    ends = []
    for axis, size in enumerate(reached.shape):
        sides = [np.arange(size - 1), np.arange(1, size)]
        for side, neighbour in (sides, sides[::-1]):
            high, low = (np.take(grid.determinant, index, axis) for index in (side, neighbour))
            edge = np.take(reached, side, axis) & (low <= 0)
            stable, unstable = (np.take(grid.joints, index, axis)[edge] for index in (side, neighbour))
            fraction = (high[edge] / (high[edge] - low[edge]))[:, None]
            ends.append(stable + fraction * (unstable - stable))
    joints = np.concatenate(ends)
    joints = joints[allowed(joints)]
    distance = np.abs(joints).max(1, initial=0.0)
    chosen: list[int] = []
    for k in np.argsort(distance, kind="stable"):
        apart = np.abs(joints[k] / distance[k] - joints[chosen] / distance[chosen][:, None]).max(1)
        if (apart > APART).all():
            chosen.append(int(k))
        if len(chosen) == max_folds:
            break
    return np.asarray(joints[chosen])


# --- Search for a path on which a concentric robot snaps --------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SnapOnPath:
    """Snap on a straight path of rotations."""

    path: Array
    """(2, n) rotations at start and end, rad."""
    snap: Snap
    followed: bool = True
    """True if continuation along the path meets the snap; False if it is too shallow, and known from its fold."""


@dataclass
class Search:
    """Search for a snap at fixed translations, with the paths already tried."""

    robot: Robot
    translations: Array
    random_paths: int
    progress: Callable[[int, int], object] | None
    paths: int = 0
    """Number of paths that were followed."""
    failed: int = 0
    """Number of followed paths with a lost equilibrium."""

    def __post_init__(self) -> None:
        self.problem = reduced_problem(self.robot, tuple(self.translations.tolist()), DEFAULT_DISCRETISATION)
        self.coupled = np.unique(self.problem.tube)
        self.low, self.high = np.array(self.robot.limits.rotations).T

    def follow(self, start: Array, end: Array) -> SnapOnPath | None:
        """First snap on a straight path, after the path is turned into the joint limits if it fits."""
        if self.progress is not None:
            self.progress(self.paths, max(self.paths + 1, 2 * self.random_paths))
        self.paths += 1
        path = self.placed(np.stack([start, end]))
        try:
            snap = find_snap(self.robot, (path[0], self.translations), (path[1], self.translations))
        except SolveError:
            self.failed += 1
            return None
        return None if snap is None else SnapOnPath(path, snap)

    def relaxed(self) -> list[Array]:
        """(n,) rotations nearest to home with all tubes curved to one side, so that none is twisted.

        A tube with a curvature opposite to that of the outermost coupled one is turned by half a turn, in one or the
        other direction: two poses, mirror images. Those inside the joint limits come first.
        """
        curvature = np.array([tube.curvature for tube in self.robot.tubes])[self.coupled]
        other_side = np.zeros(self.robot.n_tubes)
        other_side[self.coupled] = np.pi * (curvature * curvature[-1] < 0)
        poses = [other_side, -other_side] if other_side.any() else [other_side]
        return sorted(poses, key=lambda pose: not self.inside(pose))

    def inside(self, rotations: Array) -> Mask:
        """(...) True if rotations (..., n) can be turned together into the joint limits, to round-off."""
        angles = rotations[..., self.coupled]
        high, low = self.high[self.coupled] - angles, self.low[self.coupled] - angles
        return np.asarray(high.min(-1) - low.max(-1) >= -1e-9)

    def within(self, rotations: Array) -> bool:
        """True if rotations (n,) are inside the joint limits, without full turns added."""
        return bool(((rotations >= self.low) & (rotations <= self.high)).all())

    def clipped(self, start: Array, end: Array) -> Array:
        """(n,) last rotations on the straight path from `start` that fit into the joint limits after a common turn."""
        angle, rate = start[self.coupled], (end - start)[self.coupled]
        # Two tubes may differ by at most high_i - low_j: the first pair to do so ends the path.
        closing = rate[:, None] - rate
        distance = self.high[self.coupled, None] - self.low[self.coupled] - (angle[:, None] - angle)
        t = np.min(distance[closing > 0] / closing[closing > 0], initial=1.0)
        return np.asarray(end if t >= 1 else start + max(t, 0.0) * (end - start))

    def placed(self, path: Array) -> Array:
        """(W, n) waypoints with all coupled tubes turned together into the joint limits, by as little as possible.

        Waypoints that do not fit stay. Tubes that are not coupled go to their rotation nearest to home. Limits are a
        box, so that straight paths between waypoints inside are inside.
        """
        out = np.clip(np.zeros_like(path), self.low, self.high)
        angles = path[:, self.coupled]
        low, high = (self.low[self.coupled] - angles).max(1), (self.high[self.coupled] - angles).min(1)
        shift = np.where(low <= high, np.clip(0.0, low, high), 0.0)
        out[:, self.coupled] = angles + shift[:, None]
        return np.asarray(out)

    def relative(self, start: Array, joints: Array) -> Array:
        """(..., n) rotations at `joints` (..., d) relative to `start` (n,)."""
        out = np.zeros((*joints.shape[:-1], len(start))) + start
        out[..., self.coupled[:-1]] += joints
        return out


def search_snap(
    robot: Robot,
    translations: Array,
    unstable: Array,
    random_paths: int = DEFAULT_SEARCH.random_paths,
    progress: Callable[[int, int], object] | None = None,
) -> tuple[SnapOnPath | None, Search]:
    """Path from the relaxed pose on which a robot of concentric tubes snaps, found by a search.

    Two coupled tubes are decided: the snap is found if one exists, however far away; for tubes made of pieces, unless
    it is too shallow to be followed. More tubes are turned inside the joint limits: a full turn of every tube; across
    the folds at the edge of the stable equilibria around the relaxed pose; other full turns, and random directions up
    to 720 deg. Then they are turned beyond the limits, if an unstable equilibrium is known.

    Args:
        unstable: (B, n) tip angles of unstable equilibria.
    """
    search = Search(robot, translations, random_paths, progress)
    if len(search.coupled) < 2:
        return None, search
    if not robot.even:
        return _of_pieces(search), search
    if len(search.coupled) == 2:
        return _pair(search), search
    start, *_ = search.relaxed()
    if search.inside(start):
        result = _from_relaxed(search, start, unstable, within=True)
        if result is not None:
            return result, search
    return (_from_relaxed(search, start, unstable, within=False) if len(unstable) else None), search


def _of_pieces(search: Search) -> SnapOnPath | None:
    """Snap of tubes made of pieces on full turns from home, inside the joint limits.

    They have no relaxed pose. Two coupled ones are also turned beyond the limits: from any equilibrium the path crosses
    a fold, if one exists, before the tip angle has turned once.
    """
    start = np.clip(np.zeros(search.robot.n_tubes), search.low, search.high)
    ends = itertools.chain(_turns(search, start), _further_turns(search, start))
    result = _on_paths(search, start, ends, within=True)
    if result is not None:
        return result
    pair = pair_of(search.problem)
    return None if pair is None else search.follow(start, search.relative(start, np.array([farthest_fold(pair)])))


def _from_relaxed(search: Search, start: Array, unstable: Array, *, within: bool) -> SnapOnPath | None:
    """Snap on paths from the relaxed pose `start`, `within` the joint limits or anywhere."""

    def allowed(joints: Array) -> Mask:
        if within:
            return search.inside(search.relative(start, joints))
        return np.ones(joints.shape[:-1], dtype=bool)

    def across_folds() -> Iterator[Array]:
        # Without a known unstable equilibrium there is no fold to aim at.
        if len(unstable):
            grid = equilibrium_grid(search.problem, search.coupled, start, unstable)
            for fold in folds(grid, allowed):
                yield search.relative(start, fold * (1 + OVERSHOOT / np.abs(fold).max()))

    turns = _turns(search, start)
    ends = [turns, across_folds(), _further_turns(search, start)] if within else [across_folds(), turns]
    return _on_paths(search, start, itertools.chain.from_iterable(ends), within=within)


def _on_paths(search: Search, start: Array, ends: Iterable[Array], *, within: bool) -> SnapOnPath | None:
    """First snap on straight paths from `start` to rotations (n,), cut off at the joint limits if `within`."""
    for end in ends:
        goal = search.clipped(start, end) if within else end
        if (result := search.follow(start, goal)) is not None:
            return result
    return None


def _turns(search: Search, start: Array) -> Iterator[Array]:
    """(n,) rotations after a full turn of one coupled tube, for each of them but the outermost."""
    for tube in search.coupled[:-1]:
        full_turn = TURN * (np.arange(len(start)) == tube)
        fits = [end for end in (start + full_turn, start - full_turn) if search.within(end)]
        yield fits[0] if fits else start + full_turn


def _further_turns(search: Search, start: Array) -> Iterator[Array]:
    """(n,) rotations after two turns of several tubes, then in random directions, from `start`."""
    group = search.coupled[:-1]
    for signs in itertools.product((0, 1, -1), repeat=len(group)):
        if next((sign for sign in signs if sign), -1) > 0 and sum(map(abs, signs)) > 1:
            yield search.relative(start, 2 * TURN * np.array(signs))
    for unit in 2 * sobol(len(group), search.random_paths) - 1:
        if np.abs(unit).max() > 1e-3:
            yield search.relative(start, np.radians(np.round(720 * unit / np.abs(unit).max(), 1)))


def _pair(search: Search) -> SnapOnPath | None:
    """Snap of two coupled tubes: met on a path across their exact fold, or built from the fold."""
    poses, pair = search.relaxed(), pair_of(search.problem)
    fold = None if pair is None else pair_fold(pair)
    if fold is None:
        return None
    path = _pair_path(search, poses, fold)
    result = search.follow(*path)
    if result is not None:
        angle = np.ptp(result.snap.rotations[search.coupled] - result.path[0][search.coupled])
        if abs(angle - fold.turn) < 1e-6:
            return result
    return _from_fold(search, path, fold)


def _pair_path(search: Search, poses: list[Array], fold: PairFold) -> Array:
    """(2, n) straight path across the fold: from a pose and in a direction with the fold inside the joint limits."""
    first_tube = (np.arange(search.robot.n_tubes) == search.coupled[0]).astype(float)
    # A full turn reads best; where that is not enough, to the next multiple of 10 deg.
    length = TURN if fold.turn < TURN else np.radians(10 * (1 + np.ceil(np.degrees(fold.turn) / 10)))
    paths = [(pose, sign) for pose in poses for sign in (1, -1)]

    def fitness(path: tuple[Array, int]) -> tuple[bool, bool]:
        pose, sign = path
        fold_inside = bool(search.inside(np.stack([pose, pose + sign * fold.turn * first_tube])).all())
        return fold_inside, fold_inside and search.within(pose + sign * length * first_tube)

    pose, sign = max(paths, key=fitness)
    end = pose + sign * length * first_tube
    return np.stack([pose, search.clipped(pose, end) if fitness((pose, sign))[0] else end])


def _from_fold(search: Search, path: Array, fold: PairFold) -> SnapOnPath | None:
    """Snap built from the exact fold, which may be too shallow to be met by continuation."""
    first = int(search.coupled[0])
    path = search.placed(path)
    relative = path[:, first] - path[:, int(search.coupled[1])]
    sign, t = np.sign(relative[1] - relative[0]), fold.turn / abs(relative[1] - relative[0])
    rotations = path[0] + t * (path[1] - path[0])

    member = Unloaded.of(search.robot, rotations, tuple(search.translations.tolist()))
    lost = Point.at(member, sign * fold.z, t)
    after = fall(lost, fold.direction) if fold.beyond is None else Point.at(member, sign * fold.beyond, t)
    return None if after is None else SnapOnPath(path, Event(lost, after).snap(0), followed=False)


# --- Assessment -------------------------------------------------------------------------------------------------------

ASSUMING = "assuming no external load, weight or friction"
"""Assumptions of every statement about snapping, as a clause."""


class Finding(StatusEnum):
    """Finding on snapping, as a clause about the robot."""

    SNAP_FREE = "cannot snap at any rotation"
    CAN_SNAP = "can snap"
    OPEN = "it is not proved that the robot cannot snap, and search found no snap"


class SnapAssessmentStatus(StatusEnum):
    """Finding as a complete sentence."""

    SNAP_FREE = f"the robot {Finding.SNAP_FREE.value}"
    CAN_SNAP = f"the robot {Finding.CAN_SNAP.value}"
    OPEN = Finding.OPEN.value


@dataclass(frozen=True)
class SnapAssessmentStatistics:
    """Effort of the search for a snap."""

    paths: int
    """Number of paths followed."""
    failed: int
    """Number of followed paths with a lost equilibrium."""


@dataclass(frozen=True, eq=False)
class SnapAssessment(Displayed):
    """Answer to whether a robot can snap at its translations, with the proof or the snap."""

    _brief = ("robot", "finding", "certificate")

    robot: Robot
    """Robot as assessed."""
    certificate: Certificate
    """Proved lower bound on the margin over all rotations."""
    worst: WorstMargin | None
    """Smallest margin found by search; None if the search ended on a fold (margin 0)."""
    start: Array | None = None
    """(n,) rotations at the start of a straight path with a snap, rad; None if no snap is known."""
    end: Array | None = None
    """(n,) rotations at the end of the straight path with a snap, rad."""
    snap: Snap | None = None
    """Snap on that path, or None."""
    paths: int = 0
    """Number of paths tried."""
    failed: int = 0
    """Number of tried paths where the equilibrium was lost."""
    followed: bool = True
    """True if the snap occurs in continuation along the path.

    False for a snap of two tubes that is known from its fold and too shallow for that.
    """
    decided: bool = False
    """True if at most two tubes are coupled: the certificate is exact, and below 0 a snap is known.

    For tubes of one curvature each it is the nearest snap.
    """

    @property
    def value(self) -> bool | None:
        """True if the robot can snap, False if it cannot, None if unknown."""
        return None if self.finding is Finding.OPEN else self.finding is Finding.CAN_SNAP

    @property
    def status(self) -> SnapAssessmentStatus:
        """Finding as a sentence."""
        return SnapAssessmentStatus[self.finding.name]

    @property
    def statistics(self) -> SnapAssessmentStatistics:
        """Numbers of paths tried and lost."""
        return SnapAssessmentStatistics(self.paths, self.failed)

    @property
    def finding(self) -> Finding:
        """Finding about snapping."""
        if self.certificate.snap_free:
            return Finding.SNAP_FREE
        return Finding.OPEN if self.snap is None else Finding.CAN_SNAP

    @property
    def within_limits(self) -> bool | None:
        """True if the snap lies inside the limits of the rotations; None if no snap is known."""
        if self.snap is None or self.start is None:
            return None
        low, high = np.array(self.robot.limits.rotations).T
        joints = np.array([self.start, self.snap.rotations])
        return bool(((joints >= low - 1e-9) & (joints <= high + 1e-9)).all())


@dataclass(frozen=True, eq=False)
class EccentricSnapAssessment(SnapAssessment):
    """`SnapAssessment` of eccentric tubes, with the closed form of their untwisted shapes."""

    untwisted: float | None = None
    """Margin of the softest untwisted shape, with one tube of a segment against the two others.

    Below 0 two more equilibria have its joint rotations, and the robot snaps on some path, shown or not. None if the
    robot is not made of segments of three equal tubes.
    """

    @property
    def finding(self) -> Finding:
        """Finding about snapping."""
        unstable = self.untwisted is not None and self.untwisted < 0 and not self.certificate.snap_free
        return Finding.CAN_SNAP if unstable else super().finding


@typed
@small
@limited
def assess_snapping(
    robot: Robot,
    translations: ArrayLike | None = None,
    *,
    effort: SnapSearch = DEFAULT_SEARCH,
    progress: Callable[[int, int], object] | None = None,
    time_limit: float = TIME_LIMIT,
) -> SnapAssessment:
    """Proof that a robot cannot snap at given translations, or a snap.

    If the certificate is not above 0, rotations are searched for a snap. The paths start at the relaxed pose, with all
    tubes curving to one side. Snaps inside the joint limits come first, then those beyond (see `search_snap`).

    - Two coupled tubes are always decided: they can snap if and only if the certificate is below 0.
    - Tubes made of pieces start at home and stay inside their limits. More than two of them are decided only by a
      certificate above 0.
    - Tubes off the centreline: one tube of a segment is turned once back and forth. Its other two tubes are fixed, and
      all other segments curve to one side. In the middle are the untwisted shapes of the closed form (see
      `eccentric_certificate`).
    - Bundles are decided only by a certificate above 0. Paths are random, between rotations inside the limits.

    Args:
        translations: (n,) m; default home.
        effort: settings of the search where no proof decides.
        progress: called with the steps done and their likely number.
        time_limit: maximum run time, s.

    Raises:
        InputError: wrong number of translations, one that is not finite, a tube out of its actuator.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> print(tubeopt.assess_snapping(robot).finding)
        can snap
    """
    certificate = certify(robot, translations)
    try:
        worst = worst_margin(robot, translations, effort=effort)
    except SolveError:
        worst = None
    if isinstance(robot, BundleRobot) or not robot.assembly(certificate.translations).eccentric:
        assessment = SnapAssessment(robot, certificate, worst)
    else:
        return _eccentric(robot, certificate, worst, progress)
    if certificate.snap_free:
        return assessment
    if isinstance(robot, BundleRobot):
        low, high = np.array(robot.limits.rotations).T
        paths = low + (high - low) * sobol(2 * robot.n_tubes, effort.random_paths).reshape(-1, 2, robot.n_tubes)
        return _on_given_paths(assessment, [(_rounded(start), _rounded(end)) for start, end in paths], progress)
    unstable = np.empty((0, robot.n_tubes)) if worst is None else worst.unstable
    result, search = search_snap(robot, certificate.translations, unstable, effort.random_paths, progress)
    decided = len(search.coupled) == 2 and (result is not None or robot.even)
    assessment = replace(assessment, paths=search.paths, failed=search.failed, decided=decided)
    if result is None:
        return assessment
    start, end = result.path
    return replace(assessment, start=start, end=end, snap=result.snap, followed=result.followed)


def _eccentric(
    robot: Robot, certificate: Certificate, worst: WorstMargin | None, progress: Callable[[int, int], object] | None
) -> EccentricSnapAssessment:
    """Assessment of tubes off the centreline."""
    segments = segments_of(robot.assembly(certificate.translations))
    shapes = sorted(map(softest_untwisted, segments or ()), key=lambda shape: shape.margin)
    assessment = EccentricSnapAssessment(robot, certificate, worst, untwisted=shapes[0].margin if shapes else None)
    if certificate.snap_free:
        return assessment
    bends = np.array([np.sign(tube.curvature) for tube in robot.tubes])
    return _on_given_paths(assessment, list(_paths(robot.n_tubes, shapes, bends)), progress)


Assessment = TypeVar("Assessment", bound=SnapAssessment)


def _on_given_paths(
    assessment: Assessment, paths: list[tuple[Array, Array]], progress: Callable[[int, int], object] | None
) -> Assessment:
    """Assessment with the first snap on straight paths between rotations (n,)."""
    robot, shift, failed = assessment.robot, assessment.certificate.translations, 0
    for k, (start, end) in enumerate(paths):
        if progress is not None:
            progress(k, len(paths))
        try:
            snap = find_snap(robot, (start, shift), (end, shift))
        except SolveError:
            failed += 1
            continue
        if snap is not None:
            return replace(assessment, start=start, end=end, snap=snap, paths=k + 1, failed=failed)
    return replace(assessment, paths=len(paths), failed=failed)


def _paths(n: int, shapes: list[Untwisted], bends: Array) -> Iterator[tuple[Array, Array]]:
    """(n,) rotations at start and end of paths around the untwisted shapes, the softest shape first."""
    for shape in shapes:
        for k in range(len(DIRECTIONS) if shape.margin < 0 else 1):
            further = float(DIRECTIONS[k])
            tips, odd = untwisted_tips(n, shape, bends)
            # All segments turn alike: the outer ones keep their direction relative to this one.
            start = tips + further
            start[odd] -= np.pi
            for angle in (TURN, -TURN):
                end = start.copy()
                end[odd] += angle
                yield _rounded(start), _rounded(end)


def _rounded(angles: Array) -> Array:
    """Angles (rad) rounded to 1e-6 deg, so that they print and can be entered as whole degrees."""
    return np.asarray(np.radians(np.round(np.degrees(angles), 6)))
