"""Whether a robot can snap: what is proved, what search finds, and a path that repeats the snap."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..arguments import typed
from ..block.transcription.reduced import ReducedProblem
from ..display import Displayed
from ..equilibrium.member import Point, Unloaded
from ..equilibrium.problem import DEFAULT_DISCRETISATION, reduced_problem
from ..errors import SolveError
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

# The sheet of stable equilibria around the relaxed pose, and the folds that bound it: where a robot can snap.
#
# Tip angles name equilibria (see `stability.shooting`). Those that a robot reaches from its relaxed pose without a snap
# are the connected set of stable ones around that pose, and where the set ends, at a fold, the robot snaps. Relative to
# the pose F(tau) - tau has the period of a turn in each relative tip angle, so that F and the sign of det F', negative
# beyond a fold, are computed on a grid over one turn and known on all turns around.

TURN = 2 * np.pi

# The nodes of one turn of all angles are shot at once: 256 to 4,096 of them take less than a second. Unstable regions
# smaller than a cell enter by the known unstable equilibria.
GRID = (256, 64, 16, 8, 5)
"""Nodes per turn with one, two, .. relative tip angles; the last number is for all that are more."""

MOST_TURNS = 3
"""Maximum number of turns of the tips around the relaxed pose in which folds are searched. The joints of a fold may
have turned further."""

MOST_NODES = 1_000_000
"""Maximum number of nodes of all turns together: 8 MB for each number of a node."""

FOLDS = 12
"""Number of folds at the edge of the stable surface that are tried as targets."""

APART = 0.2
"""Relative difference between the directions of two folds from the relaxed pose below which they count as one."""

# A fold is interpolated in a cell: the true one lies up to a cell away, and the path must cross it.
OVERSHOOT = 0.3
"""Length of the path beyond a fold, rad."""


@dataclass(frozen=True, eq=False)
class Sheet:
    """A grid over turns of the d relative tip angles around the relaxed pose.

    joints (M..., d): relative joint rotations, rad, from the relaxed pose.  determinant (M...): of F', 0 or less where
    the equilibrium is unstable.  centre: place of the relaxed pose.
    """

    joints: Array
    determinant: Array
    centre: tuple[int, ...]


def stable_sheet(problem: ReducedProblem, coupled: Index, start: Array, unstable: Array) -> Sheet:
    """The grid around relaxed rotations `start` (n,), in which the tip angles `unstable` (B, n), each an unstable
    equilibrium, take the place of the nodes next to them: so an unstable region smaller than a cell is not missed."""
    d = len(coupled) - 1
    size = GRID[min(d, len(GRID)) - 1]
    shape, origin = (size,) * d, relative(start[None], coupled)
    axis = np.arange(size) * TURN / size
    tips = np.stack(np.meshgrid(*[axis] * d, indexing="ij"), axis=-1).reshape(-1, d)
    seeds = relative(unstable, coupled) - origin
    seeds -= TURN * np.floor(seeds / TURN + 0.5 / size)
    places = np.ravel_multi_index(tuple(np.round(seeds * size / TURN).astype(int).T), shape)
    tips[places] = seeds
    angles = np.tile(start, (len(tips), 1))
    angles[:, coupled[:-1]] += tips
    joints, slope = relative_joints(problem, coupled, angles)
    determinant = np.linalg.det(slope)
    determinant[places] = np.minimum(determinant[places], 0.0)
    turns = min(MOST_TURNS, int(((MOST_NODES / len(tips)) ** (1 / d) - 1) / 2))
    whole = (2 * turns + 1,) * d
    offset = np.stack(np.meshgrid(*[np.repeat(np.arange(-turns, turns + 1), size)] * d, indexing="ij"), axis=-1)
    return Sheet(
        np.tile((joints - origin).reshape(*shape, d), (*whole, 1)) + TURN * offset,
        np.tile(determinant.reshape(shape), whole),
        (turns * size,) * d,
    )


def folds(sheet: Sheet, allowed: Callable[[Array], Mask], most: int = FOLDS) -> Array:
    """(E, d) about the relative joint rotations of folds at which the sheet ends, from the relaxed pose.

    The nearest come first, each in a direction of its own. `allowed`, (..., d) -> (...), admits the joint rotations of
    the fold and of a path to it on the surface.
    """
    free = (sheet.determinant > 0) & allowed(sheet.joints)
    if not free[sheet.centre]:
        return np.empty((0, sheet.joints.shape[-1]))
    labels = scipy.ndimage.label(free)[0]
    result = _ends(sheet, labels == labels[sheet.centre])
    result = result[allowed(result)]
    size = np.abs(result).max(1, initial=0.0)
    chosen: list[int] = []
    for k in np.argsort(size, kind="stable"):
        apart = np.abs(result[k] / size[k] - result[chosen] / size[chosen][:, None]).max(1)
        if (apart > APART).all():
            chosen.append(int(k))
        if len(chosen) == most:
            break
    return np.asarray(result[chosen])


def _ends(sheet: Sheet, reached: Mask) -> Array:
    """(E, d) joint rotations about where F' turns singular between nodes that are reached and unstable ones beside."""
    out = []
    for axis, size in enumerate(reached.shape):
        sides = [np.arange(size - 1), np.arange(1, size)]
        for here, there in (sides, sides[::-1]):
            high, low = (np.take(sheet.determinant, side, axis) for side in (here, there))
            edge = np.take(reached, here, axis) & (low <= 0)
            first, second = (np.take(sheet.joints, side, axis)[edge] for side in (here, there))
            fraction = (high[edge] / (high[edge] - low[edge]))[:, None]
            out.append(first + fraction * (second - first))
    return np.concatenate(out)


# --- Search for a path on which a concentric robot snaps --------------------------------------------------------------

# A path on which a concentric robot snaps: inside its joint limits if search finds one there, else beyond them.


@dataclass(frozen=True, eq=False)
class SnapOnPath:
    """A snap, and the straight path (2, n) of rotations, rad, on which it lies.

    followed: whether it was met there, or is known from its fold alone.
    """

    path: Array
    snap: Snap
    followed: bool = True


@dataclass
class Search:
    """A search for a snap: the robot at translations (n,) m, its coupled tubes, and what was tried.

    paths: on which the robot was followed.  failed: those of them on which its equilibria were lost.
    """

    robot: Robot
    translations: Array
    random_paths: int
    progress: Callable[[int, int], object] | None
    paths: int = 0
    failed: int = 0

    def __post_init__(self) -> None:
        self.problem = reduced_problem(self.robot, tuple(self.translations.tolist()), DEFAULT_DISCRETISATION)
        self.coupled = np.unique(self.problem.tube)
        self.low, self.high = np.array(self.robot.limits.rotations).T

    def follow(self, start: Array, end: Array) -> SnapOnPath | None:
        """The first snap on a straight path, which is turned into the joint limits as a whole where it fits."""
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
        """The last rotations (n,) inside the joint limits on the straight path from `start`, which is inside."""
        here, rate = start[self.coupled], (end - start)[self.coupled]
        closing = rate[:, None] - rate
        left = self.high[self.coupled, None] - self.low[self.coupled] - (here[:, None] - here)
        most = np.min(left[closing > 0] / closing[closing > 0], initial=1.0)
        return np.asarray(end if most >= 1 else start + max(most, 0.0) * (end - start))

    def placed(self, path: Array) -> Array:
        """Waypoints (W, n) with all tubes turned together where that brings each inside the joint limits.

        Where limits differ from tube to tube this is the least turn. A tube that is not coupled goes to its rotation
        nearest to home. Limits are a box, so straight path between waypoints inside are inside.
        """
        out = np.clip(np.zeros_like(path), self.low, self.high)
        angles = path[:, self.coupled]
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
    random_paths: int = DEFAULT_SEARCH.random_paths,
    progress: Callable[[int, int], object] | None = None,
) -> tuple[SnapOnPath | None, Search]:
    """Search a path from the relaxed pose on which a robot with concentric tubes snaps, and say what was tried.

    Two coupled tubes are decided: the snap is found if there is one, however far away, of tubes made of pieces unless
    it is too shallow to be followed. For more, a robot is turned inside its joint limits along full turns of every
    tube; across folds at the edge of the stable equilibria around its relaxed pose (see above);
    and along other full turns and random directions, up to 720 deg where the limits allow it. Then it is turned beyond
    the limits, unless no unstable equilibrium is known.
    `unstable` (B, n): tip angles of unstable equilibria.
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
    """A snap of tubes made of pieces on full turns from home, inside the joint limits: they have no relaxed pose, and
    two of them need not be symmetric about one. Of two coupled ones, wherever it is: on a path up from any equilibrium
    a fold is met before the tip angle has turned once, if there is one."""
    start = np.clip(np.zeros(search.robot.n_tubes), search.low, search.high)
    result = _on_paths(search, start, itertools.chain(_turns(search, start), _others(search, start)), within=True)
    if result is not None:
        return result
    pair = pair_of(search.problem)
    return None if pair is None else search.follow(start, search.relative(start, np.array([farthest_fold(pair)])))


def _from_relaxed(search: Search, start: Array, unstable: Array, *, within: bool) -> SnapOnPath | None:
    """A snap inside the joint limits, or wherever it is."""

    def allowed(joints: Array) -> Mask:
        if within:
            return search.inside(search.relative(start, joints))
        return np.ones(joints.shape[:-1], dtype=bool)

    across, turns = _across_folds(search, start, unstable, allowed), _turns(search, start)
    ends = [turns, across, _others(search, start)] if within else [across, turns]
    return _on_paths(search, start, itertools.chain.from_iterable(ends), within=within)


def _on_paths(search: Search, start: Array, ends: Iterable[Array], *, within: bool) -> SnapOnPath | None:
    """The first snap on straight path from `start` to rotations (n,), cut off at the joint limits if `within`."""
    for end in ends:
        goal = search.clipped(start, end) if within else end
        if (result := search.follow(start, goal)) is not None:
            return result
    return None


def _across_folds(search: Search, start: Array, unstable: Array, allowed: Callable[[Array], Mask]) -> Iterator[Array]:
    """(n,) rotations a little beyond folds at which the sheet ends; none where no equilibrium is known unstable."""
    if len(unstable):
        sheet = stable_sheet(search.problem, search.coupled, start, unstable)
        for fold in folds(sheet, allowed):
            yield search.relative(start, fold * (1 + OVERSHOOT / np.abs(fold).max()))


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
    for unit in 2 * sobol(len(group), search.random_paths) - 1:
        if np.abs(unit).max() > 1e-3:
            yield search.relative(start, np.radians(np.round(720 * unit / np.abs(unit).max(), 1)))


def _pair(search: Search) -> SnapOnPath | None:
    """The snap of two coupled tubes."""
    poses, pair = search.relaxed(), pair_of(search.problem)
    fold = None if pair is None else pair_fold(pair)
    if fold is None:
        return None
    path = _pair_path(search, poses, fold)
    result = search.follow(*path)
    turned = None if result is None else np.ptp(result.snap.rotations[search.coupled] - result.path[0][search.coupled])
    return result if turned is not None and abs(turned - fold.turn) < 1e-6 else _exact(search, path, fold)


def _pair_path(search: Search, poses: list[Array], fold: PairFold) -> Array:
    """(2, n) straight path across the fold: inside the joint limits if from any pose to any side the fold is."""
    one = (np.arange(search.robot.n_tubes) == search.coupled[0]).astype(float)
    # A full turn reads best; where that is not enough, to the next multiple of 10 deg.
    length = TURN if fold.turn < TURN else np.radians(10 * (1 + np.ceil(np.degrees(fold.turn) / 10)))
    paths = [(pose, sign) for pose in poses for sign in (1, -1)]

    def fitness(path: tuple[Array, int]) -> tuple[bool, bool]:
        pose, sign = path
        both = bool(search.inside(np.stack([pose, pose + sign * fold.turn * one])).all())
        end = pose + sign * length * one
        return both, both and search.within(end)

    pose, sign = max(paths, key=fitness)
    end = pose + sign * length * one
    return np.stack([pose, search.clipped(pose, end) if fitness((pose, sign))[0] else end])


def _exact(search: Search, path: Array, fold: PairFold) -> SnapOnPath | None:
    """The snap built from the fold itself, which may be too shallow to be met on the path."""
    first = int(search.coupled[0])
    path = search.placed(path)
    relative = path[:, first] - path[:, int(search.coupled[1])]
    sign, t = np.sign(relative[1] - relative[0]), fold.turn / abs(relative[1] - relative[0])
    rotations = path[0] + t * (path[1] - path[0])

    member = Unloaded(search.robot, search.problem, rotations, tuple(search.translations.tolist()))
    lost = Point.at(member, sign * fold.z, t)
    after = fall(lost, fold.direction) if fold.beyond is None else Point.at(member, sign * fold.beyond, t)
    return None if after is None else SnapOnPath(path, Event(lost, after).snap(0), followed=False)


ASSUMING = "assuming no external load, weight or friction"
"""What every statement about snapping leaves out, in a clause."""


class Finding(StatusEnum):
    """Knowledge about snapping; every value reads as a sentence."""

    SNAP_FREE = "cannot snap at any rotation"
    CAN_SNAP = "can snap"
    OPEN = "it is not proved that the robot cannot snap, and search found no snap"


class SnapAssessmentStatus(StatusEnum):
    """A finding as a sentence by itself."""

    SNAP_FREE = f"the robot {Finding.SNAP_FREE.value}"
    CAN_SNAP = f"the robot {Finding.CAN_SNAP.value}"
    OPEN = Finding.OPEN.value


@dataclass(frozen=True)
class SnapAssessmentStatistics:
    """Numbers of paths tried for a snap, and of those where the equilibrium was lost."""

    paths: int
    """Number of paths tried."""
    failed: int
    """Number of these paths where the equilibrium was lost."""


@dataclass(frozen=True, eq=False)
class SnapAssessment(Displayed):
    """Whether a robot can snap at given translations, with the proof or the snap."""

    _brief = ("robot", "finding", "certificate")

    robot: Robot
    """The robot."""
    certificate: Certificate
    """The lower bound of the margin over all rotations: proved."""
    worst: WorstMargin | None
    """The least margin that search found, None where it ended on a fold (margin 0)."""
    start: Array | None = None
    """(n,) rotations at the start of a straight path with a snap, rad; None if no snap is known."""
    end: Array | None = None
    """(n,) where it ends."""
    snap: Snap | None = None
    """Snap on that path, or None."""
    paths: int = 0
    """Number of paths tried."""
    failed: int = 0
    """Number of these paths where the equilibrium was lost."""
    followed: bool = True
    """True if the snap occurs when the path is followed. False for a snap of two tubes too shallow for that, known from
    its fold.
    """
    decided: bool = False
    """True if no more than two tubes are coupled. The certificate is then exact: below 0 a snap is known. For tubes of
    one curvature each it is the nearest snap.
    """

    @property
    def value(self) -> bool | None:
        """True if the robot can snap, False if it cannot, None if unknown."""
        return None if self.finding is Finding.OPEN else self.finding is Finding.CAN_SNAP

    @property
    def status(self) -> SnapAssessmentStatus:
        """The finding, as a sentence."""
        return SnapAssessmentStatus[self.finding.name]

    @property
    def statistics(self) -> SnapAssessmentStatistics:
        """Numbers of paths tried and lost."""
        return SnapAssessmentStatistics(self.paths, self.failed)

    @property
    def finding(self) -> Finding:
        """The verdict in a word."""
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
    """A `SnapAssessment` that knows a closed form too."""

    untwisted: float | None = None
    """Margin of the softest shape with one tube of a segment against the two others, all of them equilibria. Below 0
    two more equilibria have its joint rotations, and the robot snaps on some path, shown or not. None where the robot
    is not made of segments of three equal tubes."""

    @property
    def finding(self) -> Finding:
        """The verdict in a word."""
        known = self.untwisted is not None and self.untwisted < 0 and not self.certificate.snap_free
        return Finding.CAN_SNAP if known else super().finding


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
      all other segments curve to one side. Half-way are the untwisted shapes of the closed form (see
      `eccentric_certificate`).

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
    if robot.assembly(certificate.translations).eccentric:
        return _eccentric(robot, certificate, worst, progress)
    if certificate.snap_free:
        return SnapAssessment(robot, certificate, worst)
    unstable = np.empty((0, robot.n_tubes)) if worst is None else worst.unstable
    result, search = search_snap(robot, certificate.translations, unstable, effort.random_paths, progress)
    decided = len(search.coupled) == 2 and (result is not None or robot.even)
    verdict = SnapAssessment(robot, certificate, worst, paths=search.paths, failed=search.failed, decided=decided)
    if result is None:
        return verdict
    start, end = result.path
    return replace(verdict, start=start, end=end, snap=result.snap, followed=result.followed)


def _eccentric(
    robot: Robot, certificate: Certificate, worst: WorstMargin | None, progress: Callable[[int, int], object] | None
) -> EccentricSnapAssessment:
    """The verdict on tubes off the centreline."""
    segments = segments_of(robot.assembly(certificate.translations))
    shapes = sorted(map(softest_untwisted, segments or ()), key=lambda shape: shape.margin)
    verdict = EccentricSnapAssessment(robot, certificate, worst, untwisted=shapes[0].margin if shapes else None)
    if certificate.snap_free:
        return verdict
    bends = np.array([np.sign(tube.curvature) for tube in robot.tubes])
    paths = list(_paths(robot.n_tubes, shapes, bends))
    for k, (start, end) in enumerate(paths):
        if progress is not None:
            progress(k, len(paths))
        try:
            snap = find_snap(robot, (start, certificate.translations), (end, certificate.translations))
        except SolveError:
            continue
        if snap is not None:
            return replace(verdict, start=start, end=end, snap=snap, paths=k + 1)
    return replace(verdict, paths=len(paths))


def _paths(n: int, shapes: list[Untwisted], bends: Array) -> Iterator[tuple[Array, Array]]:
    """Rotations (n,) to start from and to turn to, the likeliest to snap first."""
    for shape in shapes:
        for k in range(len(DIRECTIONS) if shape.margin < 0 else 1):
            further = float(DIRECTIONS[k])
            tips, odd = untwisted_tips(n, shape, bends)
            # All segments turn alike: the outer ones keep their direction relative to this one.
            start = tips + further
            start[odd] -= np.pi
            for turn in (TURN, -TURN):
                end = start.copy()
                end[odd] += turn
                yield _rounded(start), _rounded(end)


def _rounded(angles: Array) -> Array:
    """Angles (rad) that are whole degrees exactly, so that they can be told and typed."""
    return np.asarray(np.radians(np.round(np.degrees(angles), 6)))
