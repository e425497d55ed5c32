"""Several robots on one plate or endoscope: their motions past each other, proved; and what is known of a pair.

How far two arms that move at the same time stay from each other, from below, at all times and all along both.

A stretch of one arm, a stretch of the other and a while are a cell. Where both go linearly between its corners, the
vector D from a point of the one to a point of the other is linear along either arm and in time, so it is a mean of its
values D_k at the eight corners. With the variance of that mean (Efron and Stein: no more than a quarter of the square
of how much D changes along the one arm, along the other and in time, summed)

    |D|^2 = mean |D_k|^2 - variance >= min |D_k|^2 - V.

What moves with both arms alike does not count. Each arm is off the linear one by no more than its sagitta |u| ds^2 / 8,
the bound of `branch` and the error of interpolation, and as thick as its outermost tube there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations, pairwise
from typing import Annotated, Protocol

import numpy as np
import scipy

from ..arguments import typed
from ..bodies.anatomy import seen_from
from ..bodies.frames import Frame
from ..bodies.obstacles import Capsule, Obstacle, Sphere, checked_obstacles, scene_of
from ..display import Displayed
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import InputError, instance, positive, vector
from ..files.field_metadata import unit
from ..inverse.arm_surface import ArmSurface
from ..inverse.clock import Clock
from ..robots.robot import Robot, check_robot
from ..solvers.time_limit import LEAST_SECONDS, LONG_TIME_LIMIT
from ..typing import Array, Index
from .motion import RateLimits
from .proof import Proof, ProofStatus, verify_trajectory
from .sections import Constants, Intervals
from .trajectory_trace import (
    SHARE,
    SHORTEST,
    BranchEndsError,
    Link,
    Step,
    Table,
    TrajectoryVerifier,
    Wanted,
    follow,
    halves,
    joined,
    parted,
)

# Each halves the intervals in which the bound is not sharp.
MOST_ROUNDS = 12
"""Times that intervals in which nothing sharp is shown of two arms are halved."""

# Round-off of breakpoints that coincide.
SHORT = 1e-12
"""Length (m) of a section that is none."""


@dataclass(frozen=True, eq=False)
class Track:
    """A robot that was followed through its motion, and then rests: links in order of time; where it stands; from when
    to when (s) it moves; whether all of it is one stable branch, as was shown."""

    verifier: TrajectoryVerifier
    links: tuple[Link, ...]
    frame: Frame
    begin: float
    end: float
    whole: bool = True

    @cached_property
    def times(self) -> Array:
        """(L + 1,) s at the ends of links."""
        at = [self.links[0].one.at, *(link.other.at for link in self.links)]
        return self.begin + np.array(at) * (self.end - self.begin)

    @cached_property
    def intervals(self) -> Intervals:
        """Those of the links."""
        steps = [self.links[0].one, *(link.other for link in self.links)]
        first = np.arange(len(self.links))
        return self.verifier.intervals([step.equilibrium for step in steps], first, first + 1)

    @cached_property
    def off(self) -> Array:
        """(L, K) how far the arm may be off the straight line in time between both ends of a link, m."""
        shape = self.intervals.arms.shape_error
        return np.array([link.off for link in self.links]) + np.maximum(shape[:-1], shape[1:])[:, None]

    def link_at(self, t: Array) -> Index:
        """(...) number of the link that times (...) lie in; before and after, the first and the last."""
        k = np.searchsorted(self.times, t, side="right") - 1
        return np.asarray(np.clip(k, 0, len(self.links) - 1), dtype=np.intp)

    def places(self, link: Index, section: Index, x: Array, t: Array) -> Array:
        """(N, 2, 3) points of the linear arm at fractions x (N,) of sections, at times t (N, 2)."""
        one, other = self.intervals.places(link, section, x)
        low, high = self.times[link][:, None], self.times[link + 1][:, None]
        # A rest without duration: its first arm stands for all of it.
        share = np.clip((t - low) / np.where(high > low, high - low, 1.0), 0.0, 1.0)[..., None]
        return self.frame.placed(one[:, None] + share * (other - one)[:, None])

    def finer(self, numbers: Index) -> Track:
        """The same with those of some links halved that are no rest and not too short to be."""
        chosen = {k: self.links[k] for k in np.unique(numbers).tolist()}
        moving = {
            k: link
            for k, link in chosen.items()
            if link.other.at - link.one.at >= SHORTEST and (link.one.joints != link.other.joints).any()
        }
        if not moving:
            return self
        try:
            split = [half for link in moving.values() for half in halves(self.verifier, link)]
            more, lost = joined(self.verifier, split)
        except BranchEndsError:  # not where one branch was shown
            return replace(self, whole=False)
        kept = [link for k, link in enumerate(self.links) if k not in moving]
        links = sorted([*kept, *more], key=lambda link: link.one.at)
        return replace(self, links=tuple(links), whole=self.whole and not lost)


def tracked(verifier: TrajectoryVerifier, first: Equilibrium, time: Array, joints: Array, frame: Frame) -> Track:
    """Follow joint values (T, 2n) at times (T,), s, of a robot that stands somewhere; the verifier knows no bodies."""
    trace = follow(verifier, first, time, joints)
    steps = trace.steps
    if len(steps) == 1:  # it only rests
        # A second step at the same joint values makes a link, so that a rest has bounds like any motion.
        steps = (steps[0], Step(1.0, steps[0].equilibrium, steps[0].joints))
    links, lost = joined(verifier, [Link(a, b) for a, b in pairwise(steps)])
    whole = trace.snap is None and not trace.lost and not lost and steps[-1].at == 1.0
    return Track(verifier, tuple(links), frame, float(time[0]), float(time[-1]), whole)


@dataclass(frozen=True, eq=False)
class Side(Table):
    """Of N cells what belongs to one arm: link, section, fractions x (N, 2) of it, and points (N, 2 along, 2 in time,
    3), m."""

    link: Index
    section: Index
    x: Array
    points: Array

    def along(self) -> Array:
        """(N,) squares of their length, m^2."""
        # Of both instants the longer: the length of a vector that is linear in time is convex.
        return np.asarray(((self.points[:, 1] - self.points[:, 0]) ** 2).sum(-1).max(1))

    def halved(self, track: Track, t: Array) -> tuple[Side, Side]:
        """Both halves along the arm."""
        middle = self.x.mean(1)
        points = parted(self.points, 1, track.places(self.link, self.section, middle, t))
        one, other = (replace(self, x=x, points=p) for x, p in zip(parted(self.x, 1, middle), points, strict=True))
        return one, other

    def brief(self) -> tuple[Side, Side]:
        """Both halves in time."""
        one, other = (replace(self, points=points) for points in parted(self.points, 2, self.points.mean(2)))
        return one, other


@dataclass(frozen=True, eq=False)
class PairCells(Table):
    """N cells: which while they are of, their times (N, 2), s, and either arm's part of them."""

    which: Index
    t: Array
    one: Side
    other: Side

    @property
    def sides(self) -> tuple[Side, Side]:
        """Both parts."""
        return self.one, self.other

    def gaps(self) -> Array:
        """(N, 2, 2, 2, 3) from the one arm to the other at the corners: along either, and in time, m."""
        return np.asarray(self.other.points[:, None] - self.one.points[:, :, None])

    def halved(self, tracks: tuple[Track, Track], most: Index) -> PairCells:
        """Both halves of all, along the first arm (0), the second (1) or in time (2)."""
        long, wide, brief = (self[most == k] for k in range(3))
        parts = [replace(long, one=half) for half in long.one.halved(tracks[0], long.t)]
        parts += [replace(wide, other=half) for half in wide.other.halved(tracks[1], wide.t)]
        times = parted(brief.t, 1, brief.t.mean(1))
        for t, one, other in zip(times, brief.one.brief(), brief.other.brief(), strict=True):
            parts.append(replace(brief, t=t, one=one, other=other))
        return PairCells.joined(parts)


@dataclass(frozen=True, eq=False)
class PairProof(Displayed):
    """How far the surfaces of two arms stay from each other. What an arm needs at its plate is a body to the others:
    `ArmsProof.proofs` tell of it."""

    arms: tuple[int, int]
    """Their numbers, from 0."""
    least_clearance: Annotated[float, unit("mm"), "proved distance of the two arms at all times"]
    """-inf where no bound is proved."""
    measured_clearance: Annotated[float, unit("mm"), "smallest measured distance"]
    """Between the checked equilibria, linear in time there."""
    when: Annotated[float, unit("s"), "time of the smallest distance"]
    times: Array = field(repr=False)
    """(M + 1,) s."""
    bounds: Array = field(repr=False)
    """(M,) lower bounds in the whiles between them, m: each as sharp as it took to show the clearance, or to tell the
    least."""

    def at_least(self, begin: Array, end: Array) -> Array:
        """(T,) lower bounds of the distance from times (T,) to later ones (T,), s, m; before and after its own times
        both arms rest."""
        most = len(self.bounds) - 1
        first = np.clip(np.searchsorted(self.times, begin, "right") - 1, 0, most)
        last = np.clip(np.searchsorted(self.times, end, "left") - 1, 0, most)
        return np.array([self.bounds[a : max(a, b) + 1].min() for a, b in zip(first, last, strict=True)])


def apart(arms: tuple[int, int], tracks: tuple[Track, Track], wanted: Wanted, most: float = np.inf) -> PairProof:
    """Bound of the distance between the surfaces of two arms, as sharp as is wanted where it is the least, of which
    something that does not move is `most` apart, m."""
    one, other = tracks
    measured, when = np.inf, 0.0
    for _ in range(MOST_ROUNDS):
        times = np.union1d(one.times, other.times)
        times = times if len(times) > 1 else np.repeat(times, 2)
        bound, sides, closest, then = _bounds((one, other), times, wanted, measured)
        if closest < measured:
            measured, when = closest, then
        short = np.flatnonzero(bound < wanted.line(measured))
        over = one.verifier.over or other.verifier.over
        # A measured distance below the clearance refutes it, and no sharper bound is necessary.
        if not len(short) or over or not (one.whole and other.whole) or measured < wanted.clearance:
            break
        one, other = (track.finer(side[short]) for track, side in zip((one, other), sides, strict=True))
    if not (one.whole and other.whole):
        bound = np.full(len(bound), -np.inf)
    bound = np.minimum(bound, most)
    return PairProof(arms, float(bound.min()), min(float(measured), most), float(when), times, bound)


def _bounds(
    tracks: tuple[Track, Track], times: Array, wanted: Wanted, closest: float
) -> tuple[Array, list[Index], float, float]:
    """(M,) lower bounds of the distance in the whiles between times, the link of either arm there, the least distance
    that was measured, m, and when."""
    t = np.stack([times[:-1], times[1:]], axis=1)
    links = [track.link_at(t.mean(1)) for track in tracks]
    cells, when = _first(tracks, t, links), float(times[0])
    bound, total = np.full(len(t), np.inf), 0
    while len(cells):
        total += len(cells)
        gaps = cells.gaps()
        distance = np.sqrt((gaps**2).sum(-1))
        thick = sum(track.intervals.radius[s.link, s.section] for track, s in zip(tracks, cells.sides, strict=True))
        off = sum(track.off[s.link, s.section] for track, s in zip(tracks, cells.sides, strict=True))
        bows = (track.intervals.sagitta(s.link, s.section, s.x) for track, s in zip(tracks, cells.sides, strict=True))
        bend = np.stack(list(bows))
        along = [side.along() for side in cells.sides]
        # The terms of Efron and Stein: squares of the change along either arm and in time.
        spread = np.stack([*along, ((gaps[..., 1, :] - gaps[..., 0, :]) ** 2).sum(-1).max((1, 2))])
        least = distance.min((1, 2, 3))
        surface = least - thick
        if surface.min() < closest:
            row = int(surface.argmin())
            corner = int(distance[row].min((0, 1)).argmin())
            closest, when = float(surface[row]), float(cells.t[row, corner])
        # |D|^2 >= min |D_k|^2 - V, then both sagittas and both radii are taken off.
        low = np.sqrt(np.maximum(least**2 - spread.sum(0) / 4, 0.0)) - bend.sum(0) - thick
        line = wanted.line(closest)
        sharp = surface - low <= SHARE * max(closest - line, 0.0)
        # Beyond the limit of cells all count as they are: less sharp, still a bound.
        over = (low - off >= line) | sharp | (total > wanted.cells)
        np.minimum.at(bound, cells.which[over], (low - off)[over])
        # sqrt(d^2 - q / 4) = d - q / (8 d) to first order: the direction that takes most off the bound is halved.
        taken = spread / (8 * np.maximum(least, 1e-6)) + np.concatenate([bend, np.zeros((1, len(cells)))])
        cells = cells[~over].halved(tracks, taken[:, ~over].argmax(0))
    return bound, links, closest, when


def _first(tracks: tuple[Track, Track], t: Array, links: Sequence[Index]) -> PairCells:
    """A cell for every while and every two sections that have a length, or for the plate's own point without any."""
    shown = []
    for track, link in zip(tracks, links, strict=True):
        long = np.maximum(*track.intervals.length)[link] > SHORT
        long[~long.any(1), 0] = True
        shown.append(long)
    which, one, other = np.nonzero(shown[0][:, :, None] & shown[1][:, None, :])
    sides = []
    for track, link, section in zip(tracks, links, (one, other), strict=True):
        ends = [track.places(link[which], section, np.full(len(which), x), t[which]) for x in (0.0, 1.0)]
        x = np.tile([0.0, 1.0], (len(which), 1))
        sides.append(Side(link[which], section, x, np.stack(ends, axis=1)))
    return PairCells(which, t[which], *sides)


PLATE = Frame()

# Coarser than that of an arm and bodies: cells of two arms have eight corners and are halved in three directions.
ACCURACY = 5e-5
"""Largest distance of the bound of the distance of two arms below the smallest measured one, m."""

MOST_CELLS = 4_000_000
"""Maximum number of space-time cells of two arms. With too few the bound is less sharp, but still valid."""

CLOSE = "come as close as about"
"""How a fault of two arms begins that is one, not only nothing that is shown."""


@dataclass(frozen=True, eq=False)
class PlacedRobot(Displayed):
    """A robot, and where its plate is in the frame that all robots share.

    Raises:
        InputError: no robot, or no frame.
    """

    robot: Robot
    """A concentric or eccentric robot."""
    base: Frame = field(default_factory=Frame)
    """The frame of its plate in the shared one."""
    name: str = ""
    """Name in tables and messages."""

    def __post_init__(self) -> None:
        check_robot(self.robot)
        instance("base", self.base, Frame)
        instance("name", self.name, str)
        vector("origin of the base", self.base.origin, 3, "x, y, z")
        axes = np.asarray(self.base.axes, dtype=float)
        if axes.shape != (3, 3) or not np.allclose(axes.T @ axes, np.eye(3), atol=1e-6) or np.linalg.det(axes) < 0:
            raise InputError("axes of the base are no right-handed frame; they must be three unit vectors as columns")

    @property
    def called(self) -> str:
        """Name in messages: `name`, else that of the robot."""
        return self.name or self.robot.name or "robot"


class TimedMotion(Protocol):
    """Joint values over time: (T,) s, (T, n) rad, (T, n) m; a `Trajectory`, or what a file holds."""

    @property
    def time(self) -> Array: ...

    @property
    def rotations(self) -> Array: ...

    @property
    def translations(self) -> Array: ...


@dataclass(frozen=True, eq=False)
class ArmsProof(Displayed):
    """Proofs of the motions of several arms: of each arm, of each pair, and the faults as text."""

    proofs: tuple[Proof, ...]
    """One for each arm."""
    pairs: tuple[PairProof, ...]
    """One for each two arms."""
    faults: tuple[str, ...]
    """Violated or unproved requirements, as text; empty if everything is proved."""

    @property
    def holds(self) -> bool:
        """True if everything is proved."""
        return not self.faults

    @property
    def least_clearance(self) -> float:
        """Bound of the least distance between two arms, m."""
        return min(pair.least_clearance for pair in self.pairs)

    @property
    def value(self) -> float:
        """Smallest clearance, m."""
        return self.least_clearance

    @property
    def status(self) -> ProofStatus:
        """Whether everything is proved, as a sentence."""
        if self.holds:
            return ProofStatus.PROVED
        refuted = any(proof.faults and not proof.open for proof in self.proofs)
        refuted |= any(CLOSE in fault for fault in self.faults)
        late = any(proof.open for proof in self.proofs)
        return ProofStatus.OPEN if late and not refuted else ProofStatus.FAULTY


def checked_arms(arms: Sequence[PlacedRobot]) -> tuple[PlacedRobot, ...]:
    """Two arms at least; raises InputError for fewer, or what is none."""
    try:
        found = tuple(arms)
    except TypeError:
        raise InputError(f"arms is {arms!r}; it must be a list of PlacedRobot") from None
    for k, arm in enumerate(found):
        instance(f"arm {k + 1}", arm, PlacedRobot)
    if len(found) < 2:
        raise InputError(f"arms has {len(found)}; several robots are at least 2")
    return found


def one_each(name: str, values: Sequence[object], arms: Sequence[PlacedRobot]) -> None:
    """Raise InputError unless there is one for every arm."""
    if len(values) != len(arms):
        raise InputError(f"{name} has {len(values)} for {len(arms)} arms; it must have one for each")


def plate_of(arm: PlacedRobot) -> Sphere:
    """What all tubes need where they leave the plate, in the frame that arms share: they are there when withdrawn."""
    x, y, z = np.asarray(arm.base.origin, dtype=float).tolist()
    return Sphere((x, y, z), float(Constants.of(arm.robot).radius.max()))


def between_plates(one: PlacedRobot, other: PlacedRobot) -> float:
    """Distance of what two arms need at their plates, m."""
    a, b = plate_of(one), plate_of(other)
    return float(np.linalg.norm(np.subtract(a.centre, b.centre))) - a.radius - b.radius


@contextmanager
def of_arm(arms: Sequence[PlacedRobot], k: int) -> Iterator[None]:
    """Name the arm in what is wrong with an argument."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{called(arms, k)}: {error}") from error


def called(arms: Sequence[PlacedRobot], k: int) -> str:
    """What messages call an arm: its number, and its name."""
    return f"arm {k + 1} ({arms[k].called})"


@typed
def verify_arms(
    arms: Sequence[PlacedRobot],
    motions: Sequence[TimedMotion],
    *,
    starts: Sequence[Equilibrium | None] | None = None,
    obstacles: Sequence[Obstacle] = (),
    min_margin: float = 0.0,
    clearance: float = 0.0,
    rate_limits: RateLimits | None = None,
    time_limit: float = LONG_TIME_LIMIT,
) -> ArmsProof:
    """Follow motions of several robots, and say whether any of them snaps, hits a body, or touches another.

    Every arm is followed by `verify_trajectory` and, between its equilibria, bounded as there; the distance of two arms
    is bounded from below at all times and all along both (`apart`). Before and after its own times an arm rests.

    Args:
        motions: one for each arm, their times on one clock.   starts: stable equilibria at the first samples.
        obstacles: in the frame that the arms share; each arm keeps `clearance` (m) from them and from all other arms.
        min_margin, rate_limits: as in `verify_trajectory`, of every arm.
        time_limit: s, for all arms together.

    Raises:
        InputError: fewer than two arms, not one motion for each, tables that `verify_trajectory` refuses.
        SolveError: there is no stable equilibrium at a first sample.

    Examples:
        >>> import tubeopt
        >>> from tubeopt.bodies.frames import base_frame
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> plan = tubeopt.plan_trajectory(robot, ([0, 0, 0], None), ([0.5, 0, 0], None))
        >>> arms = [tubeopt.PlacedRobot(robot, base_frame([x, 0, 0], [x, 0, 1])) for x in (-0.05, 0.05)]
        >>> tubeopt.verify_arms(arms, [plan, plan]).holds
        True
    """
    clock = Clock(positive("time_limit", time_limit))
    known = checked_arms(arms)
    one_each("motions", motions, known)
    begins = [None] * len(known) if starts is None else list(starts)
    one_each("starts", begins, known)
    bodies = checked_obstacles(obstacles)
    plates = [plate_of(arm) for arm in known]
    proofs, tracks = [], []
    for k, (arm, motion, begin) in enumerate(zip(known, motions, begins, strict=True)):
        others = [plate for j, plate in enumerate(plates) if j != k]
        with of_arm(known, k):
            time, *joints = _tables(motion)
            first = begin or forward_kinematics(arm.robot, *(part[0] for part in joints))
            proofs.append(
                verify_trajectory(
                    arm.robot,
                    time,
                    *joints,
                    start=first,
                    obstacles=seen_from(arm.base, [*bodies, *others]),
                    min_margin=min_margin,
                    clearance=clearance,
                    rate_limits=rate_limits,
                    time_limit=max(clock.left, LEAST_SECONDS),
                )
            )
        # No bodies: the proof above kept them off, and a track needs the branch and its bounds only.
        wanted = Wanted(0.0, ACCURACY, MOST_CELLS)
        verifier = TrajectoryVerifier(arm.robot, scene_of(()), wanted, clock)
        tracks.append(tracked(verifier, first, time, np.concatenate(joints, axis=1), arm.base))
    faults = [f"{called(known, k)}: {fault}" for k, proof in enumerate(proofs) for fault in proof.faults]
    pairs = []
    for i, j in combinations(range(len(known)), 2):
        wanted = Wanted(clearance, ACCURACY, MOST_CELLS)
        most = between_plates(known[i], known[j])
        pairs.append(apart((i, j), (tracks[i], tracks[j]), wanted, most))
        faults += _between(known, pairs[-1], clearance)
    return ArmsProof(tuple(proofs), tuple(pairs), tuple(faults))


def _tables(motion: TimedMotion) -> tuple[Array, Array, Array]:
    """Times, rotations and translations of a motion; InputError where it has none, or no row."""
    try:
        found = [np.asarray(getattr(motion, name), dtype=float) for name in ("time", "rotations", "translations")]
    except (AttributeError, TypeError, ValueError):
        raise InputError(
            "motion is missing; it must have time, rotations and translations, a row for each time"
        ) from None
    if any(part.ndim < 1 or not len(part) for part in found):
        raise InputError("motion has no rows; it must have one for each time, one time at least")
    return found[0], found[1], found[2]


def _between(arms: Sequence[PlacedRobot], found: PairProof, clearance: float) -> list[str]:
    """What is wrong with two arms, or is not shown of them."""
    words = " and ".join(called(arms, k) for k in found.arms)
    if found.measured_clearance < clearance:
        return [
            f"{words} {CLOSE} {found.measured_clearance * 1e3:.4g} mm at {found.when:.4g} s; they must keep "
            f"{clearance * 1e3:.6g} mm"
        ]
    if found.least_clearance == -math.inf:
        return [f"not proved: no bound of the distance of {words} at all times"]
    if found.least_clearance < clearance:
        bound = f"a distance of {found.least_clearance * 1e3:.4g} mm is proved for {words}"
        return [f"not proved: {bound}; the required clearance is {clearance * 1e3:.6g} mm"]
    return []


def at_rest(equilibrium: Equilibrium, base: Frame, chord: float) -> tuple[Capsule, ...]:
    """Capsules that hold all of an arm, in the frame that arms share: what others keep away from while it rests.
    Pieces as long as `chord`, m, are taken as straight."""
    ends = equilibrium.tube_end
    length = float(equilibrium.arc_length[-1])
    # Radii step at the ends of tubes: no capsule spans such a step.
    s = np.union1d(np.linspace(0.0, length, 2 + int(length / chord)), ends[(ends > 0) & (ends < length)])
    outline = ArmSurface(equilibrium)
    points = outline.centreline(s)
    places = base.placed(points)
    radius = outline.radius((s[:-1] + s[1:]) / 2) + outline.bend * np.diff(s) ** 2 / 8
    return tuple(
        Capsule(tuple(a), tuple(b), float(r))
        for a, b, r in zip(places[:-1].tolist(), places[1:].tolist(), radius, strict=True)
    )


@dataclass(frozen=True, eq=False)
class Lines(Table):
    """N arms, or one at N instants: points (N, P, 3) and radii (N, P), m; times (N,), s, where they count."""

    points: Array
    radius: Array
    time: Array = field(default_factory=lambda: np.zeros(1))

    @staticmethod
    def of(equilibria: Sequence[Equilibrium], count: int, base: Frame = PLATE) -> Lines:
        """Those of equilibria of a robot whose plate stands somewhere, with so many points along each."""
        points, radius = zip(*(ArmSurface(e).line(count) for e in equilibria), strict=True)
        return Lines(np.array(points), np.array(radius)).placed(base)

    def placed(self, frame: Frame) -> Lines:
        """The same, of plates that stand in a frame."""
        return replace(self, points=frame.placed(self.points))

    def later(self, delay: float) -> Lines:
        """The same, so many s later."""
        return replace(self, time=self.time + delay)

    def at_times(self, times: Array) -> Lines:
        """The same at other times (T,), linear between instants, at rest before and after."""
        row = np.clip(np.searchsorted(self.time, times, side="right") - 1, 0, len(self.time) - 1)
        after = np.minimum(row + 1, len(self.time) - 1)
        step = np.where(after > row, self.time[after] - self.time[row], 1.0)
        share = np.clip((times - self.time[row]) / step, 0.0, 1.0)[:, None]
        points, radius = (
            a[row] + share.reshape(-1, *[1] * (a.ndim - 1)) * (a[after] - a[row]) for a in (self.points, self.radius)
        )
        return Lines(points, radius, times)

    def gaps(self, other: Lines) -> Array:
        """(T,) distances between the surfaces of two arms at the same instants, m."""
        both = zip(self.points, self.radius, other.points, other.radius, strict=True)
        return np.array([(scipy.spatial.distance.cdist(a, b) - r[:, None] - q).min() for a, r, b, q in both])
