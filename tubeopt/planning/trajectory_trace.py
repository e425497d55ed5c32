"""Follow a trajectory through equilibria, close enough to prove its branch and its clearance between them.

Equilibria are those of `forward_kinematics` (collocation and Newton's method). Where `branch` does not prove that one
stable branch joins two neighbours, or where the bound on the clearance is not sharp, their interval is bisected.

The clearance bound. A cell is a stretch of the centreline over an interval of time: a part of a section times a part of
the time between two equilibria. The distances D_k of its corners P_k from the bodies are measured. Any point y of the
patch that is bilinear between the corners is a mean of them, with a variance of at most V: a quarter of the squares of
the patch's length along the arm and of its displacement in time. For every point x of a body

    |x - y|^2 = mean |x - P_k|^2 - variance >= min D_k^2 - V.

The distance of the arm from the patch is at most its sagitta |u| ds^2 / 8, plus the chord error of `branch`, plus the
error of interpolation. The arm is as thick as its outermost tube on the stretch, with half a ball at the end of every
tube. The cells that may be the closest are halved until the bound is sharp.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple, Self

import numpy as np

from ..bodies.obstacles import Scene
from ..equilibrium.arm_surface import ArmSurface
from ..equilibrium.continuation import meetings
from ..equilibrium.kinematics import forward_kinematics, linearised, one_step, sure_margin
from ..equilibrium.result import Equilibrium
from ..errors import FlutterError, SolveError
from ..inverse.clock import Clock
from ..robots.load import Load
from ..robots.robot import Robot
from ..stability.following import find_snap
from ..typing import Array, Index, Mask
from .branch import ProvedBranch, branch
from .loaded_branch import loaded_branch
from .loaded_sections import DeadLoad, LoadedArms, LoadedIntervals, uncovered
from .sections import PARTS, Constants, Intervals, SolvedArms

# Halving cells in space costs no equilibrium, halving intervals in time costs one: the larger part is left to time.
SIZE_FRACTION = 1 / 3
"""Part of the tolerance for the size of the cells; the rest is for the time between equilibria."""

# Inside a body nothing has to be sharp: the trajectory is refuted.
DEEP = 0.05
"""Relative tolerance on the penetration depth when the arm is inside a body."""

Times = tuple[float, float]
"""Start and end of an interval, as fractions of the time."""


@dataclass(frozen=True)
class ClearanceTarget:
    """Clearance to prove, and accuracy of the bound."""

    clearance: float
    """Required clearance, m."""
    tolerance: float
    """Largest distance of the bound below the smallest measured clearance, m."""
    cells: int
    """Maximum number of cells; beyond it the bound is less sharp, but valid."""

    def threshold(self, closest: float) -> float:
        """Bound to reach where the smallest measured clearance is `closest`: the requirement, if that is enough, m."""
        sharp = closest - max(self.tolerance, -DEEP * closest)
        return self.clearance if sharp < self.clearance < closest else sharp


@dataclass(frozen=True, eq=False)
class TraceTable:
    """Arrays, or other tables, with one row for each of N cells; the first field is an array."""

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))

    def __getitem__(self, rows: Mask | Index) -> Self:
        return type(self)(*(getattr(self, field.name)[rows] for field in fields(self)))

    @classmethod
    def concatenated(cls, parts: Sequence[Self]) -> Self:
        """One table with the rows of several tables."""
        columns = ([getattr(part, field.name) for part in parts] for field in fields(cls))
        return cls(
            *(
                each[0].concatenated(each) if isinstance(each[0], TraceTable) else np.concatenate(each)
                for each in columns
            )
        )


@dataclass(frozen=True, eq=False)
class Cells(TraceTable):
    """N cells of arms in intervals."""

    which: Index
    """(N,) number of the interval."""
    section: Index
    """(N,) number of the section."""
    x: Array
    """(N, 2) fractions of the section."""
    t: Array
    """(N, 2) fractions of the interval."""
    points: Array
    """(N, 2 along, 2 in time, 3) corners, m."""
    distance: Array
    """(N, 2, 2) distances of the corners from bodies, m."""


@dataclass(frozen=True, eq=False)
class Sizes(TraceTable):
    """Quantities of N cells that enter the clearance bound."""

    along: Array
    """(N,) squares of their length, m^2."""
    time: Array
    """(N,) squares of their displacement in time, m^2."""
    sagitta: Array
    """(N,) bound on the distance of the arm from its chord, m."""
    chord_error: Array
    """(N,) bound on the distance from a straight line in time, m."""
    radius: Array
    """(N,) radius of the arm, m."""

    @staticmethod
    def of(cells: Cells, intervals: Intervals, chord_error: Array) -> Sizes:
        """Sizes of cells; `chord_error` (B, K): distance from a straight line in time, without interpolation, m."""
        at = cells.which, cells.section
        # Of both sides the longer: the length of a vector that is linear in time, or along the arm, is convex.
        along = ((cells.points[:, 1] - cells.points[:, 0]) ** 2).sum(-1).max(1)
        time = ((cells.points[:, :, 1] - cells.points[:, :, 0]) ** 2).sum(-1).max(1)
        shape = np.maximum(*(intervals.arms.shape_error[e] for e in (intervals.start, intervals.end)))
        sagitta = intervals.sagitta(*at, cells.x)
        return Sizes(along, time, sagitta, chord_error[at] + shape[cells.which], intervals.radius[at])

    @property
    def variance(self) -> Array:
        """(N,) bound on the variance V of a point of the patch over its corners, m^2."""
        # A point at the fraction x between two corners has the variance x (1 - x) |side|^2, at most a quarter.
        return np.asarray((self.along + self.time) / 4)

    def bound(self, distance: Array) -> Array:
        """(N,) lower bounds on the clearance, m; `distance` (N,): smallest of the corners."""
        return distance_on_patch(distance, self.variance) - self.sagitta - self.radius - self.chord_error

    def needed(self, threshold: float) -> float:
        """Distance of the corners for which all cells reach a threshold, m: `bound` solved for it."""
        distance = np.maximum(threshold + self.sagitta + self.radius + self.chord_error, 0.0)
        return float(np.sqrt(distance**2 + self.variance).max(initial=0.0))

    def longer(self, distance: Array) -> Mask:
        """(N,) True where the length of a cell weakens the bound more than its displacement in time."""
        # To first order D - sqrt(D^2 - V) = V / (2 D), and V is a quarter of the squares.
        far = 8 * np.maximum(distance, np.sqrt(np.maximum(self.along, self.time)) + 1e-12)
        return np.asarray(self.along / far + self.sagitta >= self.time / far)


def distance_on_patch(distance: Array, variance: Array) -> Array:
    """(N,) lower bounds on the distance of all points of patches, m, from the smallest distance of their corners.

    For a point p of a patch, with weights w_k of the corners c_k, and the point b of a body that is nearest to p:
    sum w_k |c_k - b|^2 = |p - b|^2 + V with the variance V of the corners. No |c_k - b| is below `distance`.

    Args:
        distance: (N,) smallest of the corners, m; negative inside a body. variance: (N,) bounds on V, m^2.
    """
    outside = (distance**2 > variance) & (distance > 0)
    # Inside a body by the triangle inequality: a corner is within sqrt(V) of any point of the patch.
    return np.where(outside, np.sqrt(np.maximum(distance**2 - variance, 0.0)), distance - variance**0.5)


def clearance_bounds(
    intervals: Intervals, chord_error: Array, scene: Scene, target: ClearanceTarget, closest: float
) -> tuple[Array, float]:
    """Lower bounds (B,) on the clearance in intervals, sharp at the smallest; and the smallest measured clearance, m.

    Args:
        chord_error: (B, K) distance of the arm from the straight line between both ends, m, from `branch`.
        closest: smallest clearance measured elsewhere, m; infinite if none was.
    """
    # The point of the centreline at the plate belongs to every arm.
    plate = float(scene.nearest(np.zeros((1, 3)))[0] - intervals.arms.constants.radius.max())
    bound, closest = np.full(len(chord_error), plate), min(closest, plate)
    # PARTS cells for every section that has a length.
    which, section = (np.repeat(k, PARTS) for k in np.nonzero(np.maximum(*intervals.length) > 0))
    x = np.tile(np.arange(PARTS), len(which) // PARTS)[:, None] / PARTS + np.array([0.0, 1 / PARTS])
    points = np.stack(intervals.positions(which[:, None], section[:, None], x), axis=2)
    cells = Cells(which, section, x, np.tile([0.0, 1.0], (len(which), 1)), points, np.zeros(points.shape[:3]))
    sizes = Sizes.of(cells, intervals, chord_error)
    if len(cells):
        # Distances of a few corners limit how far bodies must be searched for the others.
        few = slice(None, None, max(1, len(cells) // 500))
        measured = scene.nearest(cells.points[few, 0, 0]) - sizes.radius[few]
        closest = min(closest, float(measured.min()))
        cells.distance[...] = scene.nearest(cells.points.reshape(-1, 3), sizes.needed(closest)).reshape(-1, 2, 2)
    total = 0
    while len(cells):
        total += len(cells)
        nearest = cells.distance.min((1, 2))
        closest = min(closest, float((nearest - sizes.radius).min()))
        threshold = target.threshold(closest)
        low = sizes.bound(nearest)
        # Cells whose chord error alone keeps them below the threshold need shorter intervals, not smaller cells.
        lost = nearest - sizes.radius - sizes.chord_error - low
        decided = (low >= threshold) | (lost <= SIZE_FRACTION * max(closest - threshold, 0.0)) | (total > target.cells)
        np.minimum.at(bound, cells.which[decided], low[decided])
        within = sizes[~decided].needed(closest)
        cells = _halve(cells[~decided], intervals, sizes.longer(nearest)[~decided], scene, within)
        sizes = Sizes.of(cells, intervals, chord_error)
    return bound, closest


def _halve(cells: Cells, intervals: Intervals, along: Mask, scene: Scene, within: float) -> Cells:
    """Both halves of all cells, in length or else in time; distances of new corners are exact up to `within`."""
    parts: list[Cells] = []
    long, brief = cells[along], cells[~along]
    start, end = intervals.positions(long.which, long.section, long.x.mean(1))
    middle = (1 - long.t[..., None]) * start[:, None] + long.t[..., None] * end[:, None]
    for some, name, axis, new in ((long, "x", 1, middle), (brief, "t", 2, brief.points.mean(2))):
        distances, fraction = scene.nearest(new.reshape(-1, 3), within).reshape(-1, 2), getattr(some, name)
        tables = (
            parted(fraction, 1, fraction.mean(1)),
            parted(some.points, axis, new),
            parted(some.distance, axis, distances),
        )
        for values, points, distance in zip(*tables, strict=True):
            changed: dict[str, Any] = {name: values}
            parts.append(replace(some, **changed, points=points, distance=distance))
    return Cells.concatenated(parts)


def parted(table: Array, axis: int, middle: Array) -> tuple[Array, Array]:
    """Two tables of half cells: values from the first end to the middle of an axis, and from there to the last end."""
    low, high = np.take(table, 0, axis), np.take(table, 1, axis)
    return np.stack([low, middle], axis), np.stack([middle, high], axis)


# The bounds between neighbours are of second order in the step. Samples are as far apart, so that planned motions need
# no steps between them. Measured on six plans: half takes 1.4 times as many equilibria and 15 % more time, twice
# changes nothing.
LARGEST_TURN, LARGEST_SHIFT = 0.04, 0.004
"""Largest changes of joints between two equilibria, to begin with: rad, and relative to the longest tube."""

# Near a fold the bounds need ever shorter steps.
MAX_EQUILIBRIA = 20_000
"""Maximum number of equilibria of a proof."""

# Shorter intervals hardly help a bound on the rotation between samples along the arm; without a limit the proof of a
# robot without one would use all of its equilibria.
MAX_HALVINGS = 4
"""Maximum number of bisections of an interval without a bound on the rotation between arm samples."""

# Joint values so close differ by little more than round-off.
SHORTEST = 1e-9
"""Duration, as a fraction of the time, below which an interval is not bisected."""

# Margins are reported to four digits.
DIP = 1e-7
"""Depth below which a minimum of the margin between equilibria is not refined."""

AT_A_MEETING = 1e-6
"""Distance from a meeting of breakpoints, as a fraction of the path between waypoints, where steps are omitted."""

# The bounds have arrays of sections times tubes squared per interval.
BATCH = 2000
"""Maximum number of intervals in one batch, which limits the memory."""


@dataclass(frozen=True, eq=False)
class TraceStep:
    """An equilibrium of the trajectory."""

    at: float
    """Fraction of the time."""
    equilibrium: Equilibrium
    joints: Array
    """(2n,) joint values at the step."""


@dataclass(frozen=True, eq=False)
class Link:
    """The interval between two neighbouring steps."""

    start: TraceStep
    end: TraceStep
    chord_error: Array = field(default_factory=lambda: np.zeros(0))
    """(K,) bound on the distance of the arm from a straight line in time, m; empty before the proof."""
    bound: float = math.inf
    """Lower bound on the clearance, m."""
    unbounded: int = 0
    """Number of consecutive bisections without a rotation bound."""
    rates: Array = field(default_factory=lambda: np.full(2, np.inf))
    """(2,) bounds on the second and third derivative of the tip by the fraction of the link, m."""
    fastest: float = math.inf
    """Bound on the speed of the tip in the link that this is a part of, m/s."""


class Proved(NamedTuple):
    """Links in order of time, and unproved intervals."""

    links: list[Link]
    unproved: list[Times]
    """Intervals without a proved stable branch."""


@dataclass(frozen=True, eq=False)
class TrajectoryTrace:
    """Equilibria along a trajectory, and the proof between them."""

    steps: tuple[TraceStep, ...]
    """Equilibria in order of time."""
    snap: float | None
    """Fraction of the time at the end of the branch; None without a snap."""
    unproved: tuple[Times, ...]
    """Intervals without a proved stable branch between the equilibria."""
    margin: float
    """Smallest margin at all times, found numerically."""
    clearance: float
    """Lower bound on the clearance up to the last step, m; -inf if a part is unproved."""
    measured: float
    """Smallest measured clearance, m."""
    links: tuple[Link, ...]
    """Intervals between the steps."""


class BranchEndsError(Exception):
    """The branch ends at a fraction of the time."""

    def __init__(self, at: float) -> None:
        super().__init__()
        self.at = at


@dataclass(eq=False)
class TrajectoryVerifier:
    """Computes the equilibria and the bounds of a proof, until its time or its equilibria are used up."""

    robot: Robot
    scene: Scene
    target: ClearanceTarget
    clock: Clock
    load: Load | None = None
    count: int = 0
    """Number of computed equilibria."""
    flutters: bool = False
    """True if the branch ends by flutter, which occurs under loads without an energy."""
    _known: dict[int, tuple[Equilibrium, float]] = field(default_factory=dict, repr=False)
    """Stiffness or `sure_margin` of equilibria by `id`; the equilibrium is stored so that its `id` stays unique."""

    @cached_property
    def length(self) -> float:
        """Length of the longest tube, m."""
        return max(tube.length for tube in self.robot.tubes)

    @cached_property
    def constants(self) -> Constants:
        """Properties of the tubes that do not depend on joint values."""
        return Constants.of(self.robot)

    def cuts(self, translations: Array) -> Array:
        """(..., 1 + C n + F) arc lengths of plate, breakpoints at translations (..., n), and load points, m."""
        if not self.robot.fixed_sections:
            return np.zeros((*translations.shape[:-1], 1))
        moving = self.constants.breakpoints(translations)
        positions = np.zeros(0) if self.load is None else np.unique(self.load.cuts())
        fixed = np.broadcast_to(positions, (*moving.shape[:-1], len(positions)))
        return np.concatenate([np.zeros((*moving.shape[:-1], 1)), moving, fixed], axis=-1)

    @cached_property
    def unprovable(self) -> str:
        """Reason why no proof is possible for this robot or load, or ''."""
        if not self.robot.fixed_sections:
            return "what lies between equilibria of a bundle is not bounded"
        what = "" if self.load is None else uncovered(self.load)
        return f"what lies between equilibria under {what} is not bounded" if what else ""

    @property
    def exhausted(self) -> bool:
        """True if the time or the number of equilibria is used up."""
        return self.count >= MAX_EQUILIBRIA or self.clock.over

    def step(self, start: TraceStep, at: float, joints: Array) -> TraceStep | None:
        """Stable equilibrium at joint values (2n,), solved from another step; None without any."""
        self.count += 1
        try:
            e = forward_kinematics(self.robot, *np.split(joints, 2), load=self.load, start=start.equilibrium)
        except SolveError:
            return None
        return TraceStep(at, e, joints) if e.stable else None

    def step_by_one_solve(self, start: TraceStep, at: float, joints: Array) -> TraceStep | None:
        """Stable equilibrium at joint values (2n,) by a single Newton solve; None if that fails."""
        if self.load is not None:  # under which small changes of joints are one solve
            return self.step(start, at, joints)
        rotations, translations = np.split(joints, 2)
        e = one_step(self.robot, start.equilibrium, rotations, tuple(translations.tolist()))
        if e is None or not e.stable:
            return None
        self.count += 1
        return TraceStep(at, e, joints)

    def advance(self, start: TraceStep, at: float, joints: Array) -> TraceStep:
        """Stable equilibrium at the next joint values (2n,); raises BranchEndsError if the branch ends before it."""
        step = self.step_by_one_solve(start, at, joints)
        if step is not None:
            return step
        end = self.branch_end(start, at, joints)
        step = self.step(start, at, joints) if end is None else None
        if step is None:
            # Without a snap, stability ends at a bifurcation, or the solver fails.
            raise BranchEndsError(start.at if end is None else end)
        return step

    def midway(self, start: TraceStep, end: TraceStep) -> TraceStep | None:
        """Step at the middle of the time between two steps; None without an equilibrium."""
        return self.step(start, (start.at + end.at) / 2, (start.joints + end.joints) / 2)

    def intervals(self, equilibria: Sequence[Equilibrium], start: Index, end: Index) -> Intervals:
        """Intervals between pairs of a list of equilibria."""
        if self.load is None:
            return Intervals.of(SolvedArms.of(self.constants, equilibria), start, end)
        arms = LoadedArms.of(self.constants, equilibria, load=DeadLoad.of(self.robot, self.load))
        return LoadedIntervals.of(arms, start, end)

    def prove(self, intervals: Intervals) -> ProvedBranch:
        """Proof results for intervals."""
        if isinstance(intervals, LoadedIntervals):
            margin = np.array([self.sure_margin(e) for e in intervals.arms.equilibria])
            result, unstable = loaded_branch(intervals, margin), margin <= 0
            # Shorter intervals do not help at an equilibrium without a positive `sure_margin`.
            bounded = result.rotation_bounded & ~unstable[intervals.start] & ~unstable[intervals.end]
            return replace(result, rotation_bounded=bounded)
        return branch(intervals, self._stiffness(intervals.arms))

    def _stiffness(self, arms: SolvedArms) -> Array:
        """(E,) least singular values of the linearised equations; the margins, if all tubes are on the centreline."""
        if not arms.constants.offset.any():
            return np.array([min(e.margin, 1.0) for e in arms.equilibria])
        return np.array([self._cached(e, _least_singular_value) for e in arms.equilibria])

    def sure_margin(self, equilibrium: Equilibrium) -> float:
        """`kinematics.sure_margin` of an equilibrium under the load."""
        return self._cached(equilibrium, sure_margin)

    def _cached(self, e: Equilibrium, value: Callable[[Equilibrium], float]) -> float:
        if id(e) not in self._known:
            self._known[id(e)] = e, value(e)
        return self._known[id(e)][1]

    def branch_end(self, start: TraceStep, at: float, joints: Array) -> float | None:
        """Fraction of the time of a snap on the straight joint path from a step; None without a snap."""
        e = start.equilibrium
        try:
            target = np.split(joints, 2)
            path = (e.rotations, e.translations), (target[0], target[1])
            snap = find_snap(self.robot, *path, equilibrium=e, load=self.load)
        except SolveError as error:
            self.flutters = isinstance(error, FlutterError)
            return None
        return None if snap is None else start.at + snap.fraction * (at - start.at)


def _least_singular_value(e: Equilibrium) -> float:
    return float(np.linalg.svd(linearised(e), compute_uv=False).min(initial=1.0))


def follow(verifier: TrajectoryVerifier, first: Equilibrium, t: Array, joints: Array) -> TrajectoryTrace:
    """Follow joint values (T, 2n), linear between times (T,), from an equilibrium at the first of them."""
    origin = TraceStep(0.0 if len(joints) > 1 else 1.0, first, joints[0])
    steps, snap = _take_steps(verifier, origin, t, joints)
    if verifier.unprovable:
        return _unproved(verifier, steps, snap)
    while True:
        pairs = pairwise([step for step in steps if snap is None or step.at < snap or step is origin])
        try:
            links, unproved = prove_branch(verifier, [Link(a, b) for a, b in pairs])
            break
        except BranchEndsError as error:
            snap = error.at
    clearance = measured = math.inf
    if verifier.scene.bodies:
        with_branch = [link for link in links if np.isfinite(link.chord_error).all()]
        # Without a motion the only arm is bounded, as a link from its step to itself.
        cleared = _prove_clearance(verifier, with_branch or [Link(origin, origin)])
        unproved += cleared.unproved
        measured = cleared.measured
        clearance = min(link.bound for link in cleared.links) if not unproved else -math.inf
        links = links if unproved else [link for link in cleared.links if link.start is not link.end]
    steps = [origin, *(link.end for link in links)]
    margin = 0.0 if snap is not None else _least_margin(verifier, steps)
    return TrajectoryTrace(
        steps=tuple(steps),
        snap=snap,
        unproved=tuple(unproved),
        margin=margin,
        clearance=clearance,
        measured=measured,
        links=tuple(links),
    )


def _unproved(verifier: TrajectoryVerifier, steps: list[TraceStep], snap: float | None) -> TrajectoryTrace:
    """Margin and clearance at the equilibria of a motion, without a proof between them."""
    links = tuple(Link(a, b) for a, b in pairwise(steps))
    distances = [ArmSurface(step.equilibrium).clearance(verifier.scene) for step in steps]
    margin = 0.0 if snap is not None else _least_margin(verifier, steps)
    clearance = -math.inf if verifier.scene.bodies else math.inf
    return TrajectoryTrace(
        steps=tuple(steps),
        snap=snap,
        unproved=((0.0, steps[-1].at),),
        margin=margin,
        clearance=clearance,
        measured=min(distances),
        links=links,
    )


def _take_steps(
    verifier: TrajectoryVerifier, origin: TraceStep, t: Array, joints: Array
) -> tuple[list[TraceStep], float | None]:
    """Steps along the whole trajectory, and the fraction of the time where the branch ends; None if it does not."""
    steps, n = [origin], joints.shape[1] // 2
    span = float(t[-1] - t[0]) or 1.0
    size = np.array([LARGEST_TURN] * n + [LARGEST_SHIFT * verifier.length] * n)
    meeting_at = meetings(verifier.cuts(joints[:, n:]))
    for k in range(len(joints) - 1):
        a, b = joints[k], joints[k + 1]
        count = max(1, int(np.ceil((np.abs(b - a) / size).max() - 1e-9)))
        parts = np.arange(1, count + 1) / count
        for x in _divided(parts, meeting_at[k]) if k in meeting_at else parts:
            q = b if x == 1 else a + (b - a) * x
            last = k == len(joints) - 2 and x == 1  # exactly 1, however times are rounded
            at = 1.0 if last else float(t[k] + (t[k + 1] - t[k]) * x - t[0]) / span
            try:
                steps.append(verifier.advance(steps[-1], at, q))
            except BranchEndsError as error:
                return steps, error.at
            if verifier.exhausted:
                return steps, None
    return steps, None


def _divided(parts: Array, meetings: Array) -> Array:
    """Fractions of the path with a step: all meetings, and each of `parts` (C,) that is not close to one."""
    apart = np.abs(parts[:, None] - meetings).min(1) > AT_A_MEETING
    return np.union1d(parts[apart | (parts == 1)], meetings)


def prove_branch(verifier: TrajectoryVerifier, links: list[Link]) -> Proved:
    """Prove one stable branch along links, which are bisected as often as necessary."""
    proved: list[Link] = []
    unproved: list[Times] = []
    while links:
        fresh: list[Link] = []
        for some, intervals in batches(verifier, links):
            result = verifier.prove(intervals)
            rows = zip(some, result.rotation_bounded, result.unbroken, result.chord_error, result.rates.T, strict=True)
            for link, bounded, unbroken, error, rates in rows:
                unbounded = 0 if bounded else link.unbounded + 1
                short = link.end.at - link.start.at < SHORTEST or unbounded > MAX_HALVINGS
                if unbroken:
                    proved.append(replace(link, chord_error=error, unbounded=unbounded, rates=rates))
                elif verifier.exhausted or short:
                    unproved.append((link.start.at, link.end.at))
                    proved.append(replace(link, chord_error=np.full_like(error, np.inf), unbounded=unbounded))
                else:
                    fresh += bisect(verifier, replace(link, unbounded=unbounded))
        links = fresh
    return Proved(sorted(proved, key=lambda link: link.start.at), unproved)


def bisect(verifier: TrajectoryVerifier, link: Link) -> list[Link]:
    """Both halves of a link; raises BranchEndsError if the branch ends in it."""
    middle = verifier.midway(link.start, link.end)
    if middle is None:
        end = verifier.branch_end(link.start, link.end.at, link.end.joints)
        raise BranchEndsError(link.start.at if end is None else end)
    parts = Link(link.start, middle), Link(middle, link.end)
    return [replace(half, unbounded=link.unbounded, fastest=link.fastest) for half in parts]


def batches(verifier: TrajectoryVerifier, links: Sequence[Link]) -> Iterator[tuple[Sequence[Link], Intervals]]:
    """Links in batches that fit into memory, with the intervals between their ends."""
    for k in range(0, len(links), BATCH):
        some = links[k : k + BATCH]
        steps = {id(step): step for link in some for step in (link.start, link.end)}
        number = {key: j for j, key in enumerate(steps)}
        start = np.array([number[id(link.start)] for link in some])
        end = np.array([number[id(link.end)] for link in some])
        yield some, verifier.intervals([step.equilibrium for step in steps.values()], start, end)


class _Cleared(NamedTuple):
    """Links with clearance bounds in order of time."""

    links: list[Link]
    unproved: list[Times]
    """Intervals without a proved branch."""
    measured: float
    """Smallest measured clearance, m."""


def _prove_clearance(verifier: TrajectoryVerifier, links: list[Link]) -> _Cleared:
    """Bound the clearance of links, bisected until the smallest bound is sharp."""
    proved: dict[int, Link] = {}
    unproved: list[Times] = []
    closest = math.inf
    while links:
        for some, intervals in batches(verifier, links):
            at_rest = np.zeros(intervals.start_cuts.shape[1] - 1)
            error = np.array([link.chord_error if len(link.chord_error) else at_rest for link in some])
            bounds, closest = clearance_bounds(intervals, error, verifier.scene, verifier.target, closest)
            for link, bound in zip(some, bounds.tolist(), strict=True):
                proved[id(link)] = replace(link, bound=bound)
        threshold = verifier.target.threshold(closest)
        loose = [
            key for key, link in proved.items() if link.bound < threshold and link.end.at - link.start.at >= SHORTEST
        ]
        if verifier.exhausted:
            break
        try:
            links, more = prove_branch(verifier, [half for key in loose for half in bisect(verifier, proved[key])])
        except BranchEndsError as error:  # a contradiction to the proved branch: nothing is proved here
            unproved.append((error.at, error.at))
            break
        unproved += more
        for key in loose:
            del proved[key]
    return _Cleared(sorted(proved.values(), key=lambda link: link.start.at), unproved, closest)


def _least_margin(verifier: TrajectoryVerifier, steps: Sequence[TraceStep]) -> float:
    """Smallest margin, also between steps: around local minima, intervals are bisected."""
    margins = np.array([step.equilibrium.margin for step in steps])
    smallest = float(margins.min())
    padded = np.concatenate([[np.inf], margins, [np.inf]])
    dips = np.flatnonzero((margins <= padded[:-2]) & (margins <= padded[2:]))
    for k in dips[np.argsort(margins[dips], kind="stable")]:
        around = list(steps[max(k - 1, 0) : k + 2])
        while len(around) > 1 and not verifier.exhausted:
            values = [step.equilibrium.margin for step in around]
            # A smooth minimum is at most an eighth of the rise of its sides below the samples; a fourth is safe.
            depth = 0.25 * (max(values) - min(values))
            if depth < DIP or min(values) - depth >= smallest or around[-1].at - around[0].at < SHORTEST:
                break
            finer = [around[0]]
            for start, end in pairwise(around):
                middle = verifier.midway(start, end)
                finer += [end] if middle is None else [middle, end]
            best = int(np.argmin([step.equilibrium.margin for step in finer]))
            around = finer[max(best - 1, 0) : best + 2]
            smallest = min(smallest, finer[best].equilibrium.margin)
    return smallest
