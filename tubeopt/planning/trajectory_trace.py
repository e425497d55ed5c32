"""Following a trajectory through equilibria, close enough that what lies between them is proved.

Equilibria are those of `forward_kinematics` (collocation and Newton's method). Where `branch` does not show that one
stable branch joins two neighbours, or where the bound of the clearance is not sharp, one more is put between them.

How far an arm that moves between equilibria stays from bodies is bounded from below.

A stretch of the centreline over a while is a cell: a part of a section times a part of an interval between two
equilibria. Its corners P_k are points whose distances D_k from the bodies are measured. Any point y of the patch that
goes linearly between them along either side is a mean of the corners with a variance of at most V, a quarter of the
squares of the patch's length along the arm and of its way in time; and for every point x of a body

    |x - y|^2 = mean |x - P_k|^2 - variance >= min D_k^2 - V.

The arm is off the patch by no more than its sagitta |u| ds^2 / 8, the bound of `branch` and the error of interpolation;
it is as thick as its outermost tube on the stretch, with half a ball at the end of every tube. Cells that might come
closest are halved until what the bound gives away is small.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Self

import numpy as np

from ..bodies.obstacles import Scene
from ..equilibrium.answer import linearised, sure_margin
from ..equilibrium.kinematics import forward_kinematics, one_step
from ..equilibrium.result import Equilibrium
from ..errors import SolveError
from ..inverse.clock import Clock
from ..robots.assembly import ROUND_OFF
from ..robots.load import Load
from ..robots.robot import Robot
from ..stability.following import find_snap
from ..typing import Array, Index, Mask
from .branch import Branch, branch
from .loaded_branch import loaded_branch
from .loaded_sections import LoadedArms, LoadedIntervals, Pull, uncovered
from .sections import PARTS, Arms, Constants, Intervals

# Halving cells in space costs no equilibrium, halving intervals in time costs one: the larger part is left to time.
SHARE = 1 / 3
"""Part of the tolerance that the size of cells may give away; the rest is left to the time between equilibria."""

# Inside a body nothing has to be sharp: the trajectory is refuted.
DEEP = 0.05
"""Share of the depth of an arm inside a body that the bound may give away: what it says then is that it is inside."""


@dataclass(frozen=True)
class Wanted:
    """Clearance that is to be shown, m; how far the bound may lie below the least distance that was measured; and cells
    that are looked at for it: where they do not suffice the bound is less sharp, and holds."""

    clearance: float
    tolerance: float
    cells: int

    def line(self, closest: float) -> float:
        """What bounds should reach where `closest` was measured: what is wanted, if it can be had and is more."""
        line = closest - max(self.tolerance, -DEEP * closest)
        return self.clearance if line < self.clearance < closest else line


@dataclass(frozen=True, eq=False)
class Table:
    """Arrays, or other tables, with a row for each of N; the first is an array."""

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))

    def __getitem__(self, rows: Mask | Index) -> Self:
        return type(self)(*(getattr(self, field.name)[rows] for field in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """All of several."""
        columns = ([getattr(part, field.name) for part in parts] for field in fields(cls))
        return cls(*(each[0].joined(each) if isinstance(each[0], Table) else np.concatenate(each) for each in columns))


@dataclass(frozen=True, eq=False)
class Cells(Table):
    """N cells: interval, section, fractions (N, 2) of the section and (N, 2) of the time, and at their corners
    (N, 2 along, 2 in time): points (..., 3) and distances of the centreline from bodies, m."""

    which: Index
    section: Index
    x: Array
    t: Array
    points: Array
    distance: Array


@dataclass(frozen=True, eq=False)
class Sizes(Table):
    """Of cells (N,): squares of their length and of their way in time, how far the arm bends off them, how far it may
    be off a straight line in time, and its radius, m."""

    along: Array
    time: Array
    sagitta: Array
    off: Array
    radius: Array

    @staticmethod
    def of(cells: Cells, intervals: Intervals, off: Array) -> Sizes:
        """Those of cells of intervals whose arms are off the straight line in time by `off` (B, K)."""
        at = cells.which, cells.section
        along = ((cells.points[:, 1] - cells.points[:, 0]) ** 2).sum(-1).max(1)
        time = ((cells.points[:, :, 1] - cells.points[:, :, 0]) ** 2).sum(-1).max(1)
        shape = np.maximum(*(intervals.arms.shape_error[e] for e in (intervals.one, intervals.other)))
        bend = intervals.sagitta(*at, cells.x)
        return Sizes(along, time, bend, off[at] + shape[cells.which], intervals.radius[at])

    def bound(self, distance: Array) -> Array:
        """(N,) lower bounds of the clearance without `off`, m, where (N,) is the least distance at corners."""
        # A point at the fraction x between two corners has the variance x (1 - x) |side|^2, at most a quarter.
        spread = (self.along + self.time) / 4
        far = distance**2 > spread
        # A corner lies no farther than the root of the variance from any point of the patch.
        nearest = np.where(far & (distance > 0), np.sqrt(np.maximum(distance**2 - spread, 0.0)), distance - spread**0.5)
        return np.asarray(nearest - self.sagitta - self.radius)

    def needed(self, line: float) -> float:
        """Distance of corners beyond which all cells are cleared."""
        # `bound` solved for the distance D: sqrt(D^2 - V) - sagitta - off - radius >= line.
        least = np.maximum(line + self.sagitta + self.off + self.radius, 0.0)
        return float(np.sqrt(least**2 + (self.along + self.time) / 4).max(initial=0.0))

    def longer(self, distance: Array) -> Mask:
        """(N,) whether cells give away more by their length than by their way in time."""
        # To first order sqrt(D^2 - V) lacks V / (2 D), and V is a quarter of the squares.
        far = 8 * np.maximum(distance, np.sqrt(np.maximum(self.along, self.time)) + 1e-12)
        return np.asarray(self.along / far + self.sagitta >= self.time / far)


def cleared(intervals: Intervals, off: Array, scene: Scene, wanted: Wanted, closest: float) -> tuple[Array, float]:
    """Lower bounds (B,) of the clearance between equilibria, sharp where it is the least; and the least distance that
    was measured, m.

    Args:
        off: (B, K) by how much, m, the arm may be off the straight line between both ends, from `branch`.
        closest: the least clearance, m, that was measured elsewhere; infinite where none was.
    """
    held = float(scene.nearest(np.zeros((1, 3)))[0] - intervals.arms.constants.radius.max())
    bound, closest = np.full(len(off), held), min(closest, held)
    cells = _first(intervals)
    sizes = Sizes.of(cells, intervals, off)
    if len(cells):
        # A few points tell how far it is worth looking.
        few = slice(None, None, max(1, len(cells) // 500))
        told = scene.nearest(cells.points[few, 0, 0]) - sizes.radius[few]
        closest = min(closest, float(told.min()))
        within = max(sizes.needed(closest), 0.0)
        cells.distance[...] = scene.nearest(cells.points.reshape(-1, 3), within).reshape(-1, 2, 2)
    total = 0
    while len(cells):
        total += len(cells)
        least = cells.distance.min((1, 2))
        closest = min(closest, float((least - sizes.radius).min()))
        line = wanted.line(closest)
        low = sizes.bound(least)
        gap = least - sizes.radius - low
        small = gap <= SHARE * max(closest - line, 0.0)
        over = (low - sizes.off >= line) | small | (total > wanted.cells)
        np.minimum.at(bound, cells.which[over], (low - sizes.off)[over])
        within = max(sizes[~over].needed(closest), 0.0)
        cells = _halved(cells[~over], intervals, sizes.longer(least)[~over], scene, within)
        sizes = Sizes.of(cells, intervals, off)
    return bound, closest


def _first(intervals: Intervals) -> Cells:
    """PARTS cells for every section that has a length."""
    which, section = np.nonzero(np.maximum(*intervals.length) > 0)
    which, section = np.repeat(which, PARTS), np.repeat(section, PARTS)
    x = np.tile(np.arange(PARTS), len(which) // PARTS)[:, None] / PARTS + np.array([0.0, 1 / PARTS])
    ends = intervals.places(which[:, None], section[:, None], x)
    points = np.stack(ends, axis=2)
    t = np.tile([0.0, 1.0], (len(which), 1))
    return Cells(which, section, x, t, points, np.zeros(points.shape[:3]))


def _halved(cells: Cells, intervals: Intervals, along: Mask, scene: Scene, within: float) -> Cells:
    """Both halves of all cells, in length or else in time; distances at new corners are told up to `within`."""
    parts: list[Cells] = []
    long, brief = cells[along], cells[~along]
    one, other = intervals.places(long.which, long.section, long.x.mean(1))
    new = (1 - long.t[..., None]) * one[:, None] + long.t[..., None] * other[:, None]
    for some, name, axis, middle in ((long, "x", 1, new), (brief, "t", 2, brief.points.mean(2))):
        told, share = scene.nearest(middle.reshape(-1, 3), within).reshape(-1, 2), getattr(some, name)
        tables = parted(share, 1, share.mean(1)), parted(some.points, axis, middle), parted(some.distance, axis, told)
        for own, points, distance in zip(*tables, strict=True):
            changed: dict[str, Any] = {name: own}
            parts.append(replace(some, **changed, points=points, distance=distance))
    return Cells.joined(parts)


def parted(table: Array, axis: int, middle: Array) -> tuple[Array, Array]:
    """What cells have at both ends of an axis of a table, as their halves have it, which meet in the middle."""
    low, high = np.take(table, 0, axis), np.take(table, 1, axis)
    return np.stack([low, middle], axis), np.stack([middle, high], axis)


# The bounds between neighbours are of second order in the step. Samples are as far apart, so that planned motions need
# no steps between them. Measured on six plans: half takes 1.4 times as many equilibria and 15 % more time, twice
# changes nothing.
LARGEST_TURN, LARGEST_SHIFT = 0.04, 0.004
"""Largest changes of joints between two equilibria, to begin with: rad, and as a share of the longest tube."""

# Near a fold the bounds ask for ever shorter steps.
MOST_EQUILIBRIA = 20_000
"""Maximum number of equilibria of a proof."""

# Shorter intervals hardly help a bound of the turn between samples along the arm; without a limit the proof of a robot
# without one would use all of its equilibria.
MOST_HALVINGS = 4
"""Maximum number of bisections of an interval without a bound on the rotation between arm samples."""

# Joint values so close differ by little more than round-off.
SHORTEST = 1e-9
"""Share of the time below which nothing is put between two equilibria."""

# Margins are reported to four digits.
DIP = 1e-7
"""Depth of a least margin between equilibria that does not matter."""

AT_A_MEETING = 1e-6
"""Fraction of the way between waypoints from a meeting within which no step is needed for the length of links."""

# The bounds have arrays of sections times tubes squared per interval.
BATCH = 2000
"""Intervals at once: bounds the memory."""


@dataclass(frozen=True, eq=False)
class Step:
    """An equilibrium, the fraction of the time, and the joint values (2n,)."""

    at: float
    equilibrium: Equilibrium
    joints: Array


@dataclass(frozen=True, eq=False)
class Link:
    """Two neighbouring steps; by how much (K,) m the arm is off the straight line in between; bound of the clearance
    there, m; of how many intervals, each half of the one before, nothing bounds the turn; bounds (2,) of the second and
    third derivative of the tip, over powers of the time between the steps, m; bound of the speed of the tip in what it
    is a part of, m/s."""

    one: Step
    other: Step
    off: Array = field(default_factory=lambda: np.zeros(0))
    bound: float = math.inf
    unbounded: int = 0
    rates: Array = field(default_factory=lambda: np.full(2, np.inf))
    fastest: float = math.inf


@dataclass(frozen=True, eq=False)
class TrajectoryTrace:
    """What was found on the way."""

    steps: tuple[Step, ...]
    """In order of time."""
    snap: float | None
    """Fraction of the time at which the branch ends."""
    lost: tuple[tuple[float, float], ...]
    """(from, to) fractions of the time between which nothing shows that one stable branch joins the equilibria."""
    margin: float
    """Least, numerically, of all times."""
    clearance: float
    """Bound of all times up to the last step, m; -inf where some is lost."""
    measured: float
    """Least distance that was measured, m."""
    links: tuple[Link, ...]
    """Between the steps."""


class BranchEndsError(Exception):
    """The branch ends at a fraction of the time."""

    def __init__(self, at: float) -> None:
        super().__init__()
        self.at = at


@dataclass(eq=False)
class TrajectoryVerifier:
    """Follows a robot past bodies, maybe one that bears a load, until the clock is over."""

    robot: Robot
    scene: Scene
    wanted: Wanted
    clock: Clock
    load: Load | None = None
    count: int = 0
    flutters: bool = False
    """Whether what ends the branch is flutter, as loads without an energy make it."""
    _known: dict[int, tuple[Equilibrium, float]] = field(default_factory=dict, repr=False)
    """Equilibria by their `id`, with the least singular values of their linearised equations, or `sure_margin`."""

    @cached_property
    def length(self) -> float:
        """Of the longest tube, m."""
        return max(tube.length for tube in self.robot.tubes)

    @cached_property
    def constants(self) -> Constants:
        """What no joint changes of the robot."""
        return Constants.of(self.robot)

    def cuts(self, translations: Array) -> Array:
        """(..., 1 + C n + F) the plate, breakpoints of tubes at translations (..., n), and places of the load, m."""
        moving = self.constants.breakpoints(translations)
        places = np.zeros(0) if self.load is None else np.unique(self.load.cuts())
        fixed = np.broadcast_to(places, (*moving.shape[:-1], len(places)))
        return np.concatenate([np.zeros((*moving.shape[:-1], 1)), moving, fixed], axis=-1)

    @cached_property
    def says(self) -> str:
        """What can be proved nowhere, in words; empty where nothing is known to stand against it."""
        what = "" if self.load is None else uncovered(self.load)
        return f"what lies between equilibria under {what} is not bounded" if what else ""

    @property
    def halvings(self) -> int:
        """Of an interval in which nothing bounds how tubes turn, before it is given up; none where nothing does."""
        return 0 if self.says else MOST_HALVINGS

    @property
    def over(self) -> bool:
        """Whether there is no more time, or no more equilibria to spend."""
        return self.count >= MOST_EQUILIBRIA or self.clock.over

    def step(self, here: Step, at: float, joints: Array) -> Step | None:
        """The stable equilibrium at joint values (2n,) next to a step; None where there is none that is found."""
        self.count += 1
        try:
            e = forward_kinematics(self.robot, *np.split(joints, 2), load=self.load, start=here.equilibrium)
        except SolveError:
            return None
        return Step(at, e, joints) if e.stable else None

    def near(self, here: Step, at: float, joints: Array) -> Step | None:
        """The same, by one solve; None also where that is not enough."""
        if self.load is not None:  # under which small changes of joints are one solve
            return self.step(here, at, joints)
        rotations, translations = np.split(joints, 2)
        e = one_step(self.robot, here.equilibrium, rotations, tuple(translations.tolist()))
        if e is None or not e.stable:
            return None
        self.count += 1
        return Step(at, e, joints)

    def onwards(self, here: Step, at: float, joints: Array) -> Step:
        """The stable equilibrium next to a step; raises BranchEndsError where the branch ends before it."""
        there = self.near(here, at, joints)
        if there is not None:
            return there
        end = self.ends(here, at, joints)
        there = self.step(here, at, joints) if end is None else None
        if there is None:
            # Without a snap it is stability that ends, where branches cross, or a solver that gives up.
            raise BranchEndsError(here.at if end is None else end)
        return there

    def between(self, one: Step, other: Step) -> Step | None:
        """The step half-way."""
        return self.step(one, (one.at + other.at) / 2, (one.joints + other.joints) / 2)

    def intervals(self, equilibria: Sequence[Equilibrium], one: Index, other: Index) -> Intervals:
        """Those between some of a list of equilibria."""
        if self.load is None or self.says:
            return Intervals.of(Arms.of(self.constants, equilibria), one, other)
        arms = LoadedArms.of(self.constants, equilibria, pull=Pull.of(self.robot, self.load))
        return LoadedIntervals.of(arms, one, other)

    def joined(self, intervals: Intervals) -> Branch:
        """What is known between neighbours: nothing of a load that the bounds do not cover."""
        if isinstance(intervals, LoadedIntervals):
            sure = np.array([self.sure(e) for e in intervals.arms.equilibria])
            found, poor = loaded_branch(intervals, sure), sure <= 0
            # Shorter intervals bound no more there.
            return replace(found, turned=found.turned & ~poor[intervals.one] & ~poor[intervals.other])
        if self.says:
            none = np.zeros(len(intervals.one), dtype=bool)
            return Branch(none, np.full(intervals.length[0].shape, np.inf), none, np.full((2, len(none)), np.inf))
        return branch(intervals, self._stiffness(intervals.arms))

    def _stiffness(self, arms: Arms) -> Array:
        """(E,) least singular values of the linearised equations: the margins, unless tubes run off the centreline."""
        if not arms.constants.offset.any():
            return np.array([min(e.margin, 1.0) for e in arms.equilibria])
        return np.array([self._once(e, _least_singular) for e in arms.equilibria])

    def sure(self, equilibrium: Equilibrium) -> float:
        """`sure_margin` of an equilibrium under the load."""
        return self._once(equilibrium, sure_margin)

    def _once(self, e: Equilibrium, value: Callable[[Equilibrium], float]) -> float:
        if id(e) not in self._known:
            self._known[id(e)] = e, value(e)
        return self._known[id(e)][1]

    def ends(self, here: Step, at: float, joints: Array) -> float | None:
        """Fraction of the time at which the branch that leads from here to joint values (2n,) ends by a snap."""
        e = here.equilibrium
        try:
            rotations, translations = np.split(joints, 2)
            begin, end = (e.rotations, e.translations), (rotations, translations)
            snap = find_snap(self.robot, begin, end, equilibrium=e, load=self.load)
        except SolveError as error:
            self.flutters = "flutter" in str(error)
            return None
        return None if snap is None else here.at + snap.fraction * (at - here.at)


def _least_singular(e: Equilibrium) -> float:
    return float(np.linalg.svd(linearised(e), compute_uv=False).min(initial=1.0))


def follow(verifier: TrajectoryVerifier, first: Equilibrium, t: Array, joints: Array) -> TrajectoryTrace:
    """Follow joint values (T, 2n), linear between times (T,), from an equilibrium at the first of them."""
    begin = Step(0.0 if len(joints) > 1 else 1.0, first, joints[0])
    steps, snap = _through(verifier, begin, t, joints)
    while True:
        pairs = pairwise([step for step in steps if snap is None or step.at < snap or step is begin])
        try:
            links, lost = joined(verifier, [Link(a, b) for a, b in pairs])
            break
        except BranchEndsError as error:
            snap = error.at
    clearance = measured = math.inf
    if verifier.scene.bodies:
        shown = [link for link in links if np.isfinite(link.off).all()]
        kept, more, measured = _kept_clear(verifier, shown or [Link(begin, begin)])
        lost += more
        clearance = min(link.bound for link in kept) if not lost else -math.inf
        links = links if lost else [link for link in kept if link.one is not link.other]
    steps = [begin, *(link.other for link in links)]
    margin = 0.0 if snap is not None else _least_margin(verifier, steps)
    return TrajectoryTrace(tuple(steps), snap, tuple(lost), margin, clearance, measured, tuple(links))


def _through(verifier: TrajectoryVerifier, here: Step, t: Array, joints: Array) -> tuple[list[Step], float | None]:
    """Steps all along, and the fraction of the time where the branch ends."""
    steps, n = [here], joints.shape[1] // 2
    span = float(t[-1] - t[0]) or 1.0
    size = np.array([LARGEST_TURN] * n + [LARGEST_SHIFT * verifier.length] * n)
    meetings = _meetings(verifier.cuts(joints[:, n:]))
    for k in range(len(joints) - 1):
        a, b = joints[k], joints[k + 1]
        count = max(1, int(np.ceil((np.abs(b - a) / size).max() - 1e-9)))
        parts = np.arange(1, count + 1) / count
        for x in _divided(parts, meetings[k]) if k in meetings else parts:
            there = b if x == 1 else a + (b - a) * x
            last = k == len(joints) - 2 and x == 1  # whole, however times are rounded
            at = 1.0 if last else float(t[k] + (t[k + 1] - t[k]) * x - t[0]) / span
            try:
                steps.append(verifier.onwards(steps[-1], at, there))
            except BranchEndsError as error:
                return steps, error.at
            if verifier.over:
                return steps, None
    return steps, None


def _meetings(points: Array) -> dict[int, Array]:
    """Fractions of the way between waypoints at which some of P points (T, P) meet: sections change there, and with
    them how the arm moves. Points closer than ROUND_OFF are one to the solver, and those that meet at the same time,
    but for round-off, meet at one fraction."""
    gap = points[:, :, None] - points[:, None, :]
    before, after = gap[:-1], gap[1:]
    found: dict[int, Array] = {}
    crossed = (before > ROUND_OFF) & (after < -ROUND_OFF)
    for k in np.flatnonzero(crossed.any((1, 2))):
        a, passed = before[k][crossed[k]], (before - after)[k][crossed[k]]
        order, kept = np.argsort(a / passed), list[float]()
        for x, same in zip((a / passed)[order].tolist(), (ROUND_OFF / passed)[order].tolist(), strict=True):
            if not kept or x - kept[-1] > same:
                kept.append(x)
        found[int(k)] = np.array(kept)
    return found


def _divided(parts: Array, meetings: Array) -> Array:
    """Fractions of the way with a step: meetings, and those parts (C,) that are not at one. The last part is 1."""
    apart = np.abs(parts[:, None] - meetings).min(1) > AT_A_MEETING
    return np.union1d(parts[apart | (parts == 1)], meetings)


def joined(verifier: TrajectoryVerifier, links: list[Link]) -> tuple[list[Link], list[tuple[float, float]]]:
    """Links that are joined by one stable branch, in order of time; and between which times none is shown."""
    done: list[Link] = []
    lost: list[tuple[float, float]] = []
    while links:
        fresh: list[Link] = []
        for some, intervals in batches(verifier, links):
            found = verifier.joined(intervals)
            told = zip(some, found.turned.tolist(), found.unbroken.tolist(), found.off, found.rates.T, strict=True)
            for link, turned, unbroken, off, rates in told:
                unbounded = 0 if turned else link.unbounded + 1
                short = link.other.at - link.one.at < SHORTEST or unbounded > verifier.halvings
                if unbroken:
                    done.append(replace(link, off=off, unbounded=unbounded, rates=rates))
                elif verifier.over or short:
                    lost.append((link.one.at, link.other.at))
                    done.append(replace(link, off=np.full_like(off, np.inf), unbounded=unbounded))
                else:
                    fresh += halves(verifier, replace(link, unbounded=unbounded))
        links = fresh
    return sorted(done, key=lambda link: link.one.at), lost


def halves(verifier: TrajectoryVerifier, link: Link) -> list[Link]:
    """Both halves of a link; raises BranchEndsError where the branch ends in it."""
    middle = verifier.between(link.one, link.other)
    if middle is None:
        end = verifier.ends(link.one, link.other.at, link.other.joints)
        raise BranchEndsError(link.one.at if end is None else end)
    parts = Link(link.one, middle), Link(middle, link.other)
    return [replace(half, unbounded=link.unbounded, fastest=link.fastest) for half in parts]


def batches(verifier: TrajectoryVerifier, links: Sequence[Link]) -> Iterator[tuple[Sequence[Link], Intervals]]:
    """Links, so many at once as memory allows, with the intervals between their ends."""
    for k in range(0, len(links), BATCH):
        some = links[k : k + BATCH]
        steps = {id(step): step for link in some for step in (link.one, link.other)}
        number = {key: j for j, key in enumerate(steps)}
        one, other = (np.array([number[id(getattr(link, end))] for link in some]) for end in ("one", "other"))
        yield some, verifier.intervals([step.equilibrium for step in steps.values()], one, other)


def _kept_clear(verifier: TrajectoryVerifier, links: list[Link]) -> tuple[list[Link], list[tuple[float, float]], float]:
    """Links with bounds of their clearance, as many as it takes for the least of them to be sharp; between which times
    no branch was shown; and the least distance that was measured."""
    done: dict[int, Link] = {}
    lost: list[tuple[float, float]] = []
    closest = math.inf
    while links:
        for some, intervals in batches(verifier, links):
            off = np.array([link.off if len(link.off) else np.zeros(intervals.begin.shape[1] - 1) for link in some])
            bounds, closest = cleared(intervals, off, verifier.scene, verifier.wanted, closest)
            for link, bound in zip(some, bounds.tolist(), strict=True):
                done[id(link)] = replace(link, bound=bound)
        line = verifier.wanted.line(closest)
        short = [key for key, link in done.items() if link.bound < line and link.other.at - link.one.at >= SHORTEST]
        if verifier.over:
            break
        try:
            links, more = joined(verifier, [half for key in short for half in halves(verifier, done[key])])
        except BranchEndsError as error:  # not where one branch was shown
            lost.append((error.at, error.at))
            break
        lost += more
        for key in short:
            del done[key]
    return sorted(done.values(), key=lambda link: link.one.at), lost, closest


def _least_margin(verifier: TrajectoryVerifier, steps: Sequence[Step]) -> float:
    """The least margin, also between steps: where three neighbours have it in their middle, halves are looked at."""
    margins = np.array([step.equilibrium.margin for step in steps])
    least = float(margins.min())
    padded = np.concatenate([[np.inf], margins, [np.inf]])
    dips = np.flatnonzero((margins <= padded[:-2]) & (margins <= padded[2:]))
    for k in dips[np.argsort(margins[dips], kind="stable")]:
        around = list(steps[max(k - 1, 0) : k + 2])
        while len(around) > 1 and not verifier.over:
            values = [step.equilibrium.margin for step in around]
            # A smooth dip is no deeper than an eighth of how much its sides rise; a fourth is safe.
            depth = 0.25 * (max(values) - min(values))
            if depth < DIP or min(values) - depth >= least or around[-1].at - around[0].at < SHORTEST:
                break
            finer = [around[0]]
            for one, other in pairwise(around):
                middle = verifier.between(one, other)
                finer += [other] if middle is None else [middle, other]
            best = int(np.argmin([step.equilibrium.margin for step in finer]))
            around = finer[max(best - 1, 0) : best + 2]
            least = min(least, finer[best].equilibrium.margin)
    return least
