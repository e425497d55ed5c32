"""Proof of the motions of several robots on one plate or endoscope: each by itself, and the distances between arms.

The distance bound of two arms, at all times and all along both. A stretch of one arm, a stretch of the other and an
interval of time are a cell. Between its corners the arms are replaced by patches that are linear along the arm and in
time. Then the vector D from a point of one to a point of the other is trilinear, so it is a mean of its values D_k at
the eight corners. By the inequality of Efron and Stein, the variance of that mean is at most V, a quarter of the sum of
the squared changes of D along the first arm, along the second and in time:

    |D|^2 = mean |D_k|^2 - variance >= min |D_k|^2 - V.

A motion common to both arms does not count. The distance of each arm from its patch is at most its sagitta
|u| ds^2 / 8, plus the chord error of `branch`, plus the error of interpolation; it is as thick as its outermost tube.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations, pairwise
from typing import Annotated, NamedTuple, Protocol

import numpy as np
import scipy

from ..arguments import typed
from ..bodies.anatomy import bodies_in_frame
from ..bodies.frames import Frame
from ..bodies.obstacles import Capsule, Obstacle, Sphere, checked_obstacles, scene_of
from ..display import Displayed
from ..equilibrium.arm_surface import ArmSurface
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import InputError, instance, positive, vector
from ..files.field_metadata import unit
from ..inverse.clock import Clock
from ..robots.robot import Robot, check_robot
from ..solvers.time_limit import LONG_TIME_LIMIT, MIN_SECONDS
from ..typing import Array, Index
from .motion import RateLimits
from .proof import Proof, ProofStatus, verify_trajectory
from .sections import Constants, Intervals
from .trajectory_trace import (
    SHORTEST,
    SIZE_FRACTION,
    BranchEndsError,
    ClearanceTarget,
    Link,
    TraceStep,
    TraceTable,
    TrajectoryVerifier,
    bisect,
    distance_on_patch,
    follow,
    parted,
    prove_branch,
)

# Each halves the intervals in which the bound is not sharp.
MAX_ROUNDS = 12
"""Maximum number of times that intervals without a sharp distance bound are bisected."""

# Round-off of breakpoints that coincide.
SHORT = 1e-12
"""Largest length (m) of a section that counts as none."""


@dataclass(frozen=True, eq=False)
class Track:
    """Verified motion of a robot, which rests before and after."""

    verifier: TrajectoryVerifier
    links: tuple[Link, ...]
    """Intervals of the motion in order of time."""
    frame: Frame
    """Frame of its plate in the frame that the arms share."""
    start: float
    """Start of the motion, s."""
    end: float
    """End of the motion, s."""
    complete: bool = True
    """True if one stable branch is proved for all of it."""

    @cached_property
    def times(self) -> Array:
        """(L + 1,) times at the ends of links, s."""
        at = [self.links[0].start.at, *(link.end.at for link in self.links)]
        return self.start + np.array(at) * (self.end - self.start)

    @cached_property
    def intervals(self) -> Intervals:
        """Intervals of time between the equilibria at the ends of the links."""
        steps = [self.links[0].start, *(link.end for link in self.links)]
        first = np.arange(len(self.links))
        return self.verifier.intervals([step.equilibrium for step in steps], first, first + 1)

    @cached_property
    def chord_error(self) -> Array:
        """(L, K) bound on the distance of the arm from a straight line in time, with interpolation, m."""
        shape = self.intervals.arms.shape_error
        return np.array([link.chord_error for link in self.links]) + np.maximum(shape[:-1], shape[1:])[:, None]

    def link_at(self, t: Array) -> Index:
        """(...) number of the link at times (...); the first or last link before or after the motion."""
        k = np.searchsorted(self.times, t, side="right") - 1
        return np.asarray(np.clip(k, 0, len(self.links) - 1), dtype=np.intp)

    def positions(self, link: Index, section: Index, x: Array, t: Array) -> Array:
        """(N, 2, 3) positions, m, at fractions x (N,) of sections and times t (N, 2); links are linear in time."""
        start, end = self.intervals.positions(link, section, x)
        low, high = self.times[link][:, None], self.times[link + 1][:, None]
        # A rest has no duration: its first arm is used.
        fraction = np.clip((t - low) / np.where(high > low, high - low, 1.0), 0.0, 1.0)[..., None]
        return self.frame.placed(start[:, None] + fraction * (end - start)[:, None])

    def finer(self, numbers: Index) -> Track:
        """Track with the given links bisected, except for rests and links that are too short."""
        chosen = {k: self.links[k] for k in np.unique(numbers).tolist()}
        moving = {
            k: link
            for k, link in chosen.items()
            if link.end.at - link.start.at >= SHORTEST and (link.start.joints != link.end.joints).any()
        }
        if not moving:
            return self
        try:
            split = [half for link in moving.values() for half in bisect(self.verifier, link)]
            more, lost = prove_branch(self.verifier, split)
        except BranchEndsError:  # a contradiction to the proved branch
            return replace(self, complete=False)
        unchanged = [link for k, link in enumerate(self.links) if k not in moving]
        links = sorted([*unchanged, *more], key=lambda link: link.start.at)
        return replace(self, links=tuple(links), complete=self.complete and not lost)


def tracked(verifier: TrajectoryVerifier, first: Equilibrium, time: Array, joints: Array, frame: Frame) -> Track:
    """Track of joint values (T, 2n) at times (T,), s, of a robot with its plate in a frame; without bodies."""
    trace = follow(verifier, first, time, joints)
    steps = trace.steps
    if len(steps) == 1:  # it only rests
        # A second step at the same joint values makes a link, so that a rest has bounds like any motion.
        steps = (steps[0], TraceStep(1.0, steps[0].equilibrium, steps[0].joints))
    links, lost = prove_branch(verifier, [Link(a, b) for a, b in pairwise(steps)])
    complete = trace.snap is None and not trace.unproved and not lost and steps[-1].at == 1.0
    return Track(verifier, tuple(links), frame, float(time[0]), float(time[-1]), complete)


@dataclass(frozen=True, eq=False)
class Side(TraceTable):
    """Stretches of one arm over links of its motion, one for each of N cells."""

    link: Index
    """(N,) number of the link."""
    section: Index
    """(N,) number of the section."""
    x: Array
    """(N, 2) fractions of the section."""
    points: Array
    """(N, 2 along, 2 in time, 3) corners, m."""

    def along(self) -> Array:
        """(N,) squares of the lengths of the stretches, m^2."""
        # Of both instants the longer: the length of a vector that is linear in time is convex.
        return np.asarray(((self.points[:, 1] - self.points[:, 0]) ** 2).sum(-1).max(1))

    def halved(self, track: Track, t: Array) -> tuple[Side, Side]:
        """Two halves of each stretch, split along the arm."""
        middle = self.x.mean(1)
        points = parted(self.points, 1, track.positions(self.link, self.section, middle, t))
        first, second = (replace(self, x=x, points=p) for x, p in zip(parted(self.x, 1, middle), points, strict=True))
        return first, second

    def brief(self) -> tuple[Side, Side]:
        """Two halves of each stretch, split in time."""
        first, second = (replace(self, points=points) for points in parted(self.points, 2, self.points.mean(2)))
        return first, second


@dataclass(frozen=True, eq=False)
class PairCells(TraceTable):
    """N cells: a stretch of one arm, a stretch of the other and an interval of time each."""

    which: Index
    """(N,) interval of time."""
    t: Array
    """(N, 2) times at the start and end of each cell, s."""
    first: Side
    second: Side

    @property
    def sides(self) -> tuple[Side, Side]:
        """Stretches of the first and of the second arm."""
        return self.first, self.second

    def differences(self) -> Array:
        """(N, 2, 2, 2, 3) vectors from the first to the second arm at the corners of the cells, m: ends of both
        stretches, times.
        """
        return np.asarray(self.second.points[:, None] - self.first.points[:, :, None])

    def halved(self, tracks: tuple[Track, Track], direction: Index) -> PairCells:
        """Both halves of all cells, along the first arm (0), along the second (1) or in time (2)."""
        long, wide, brief = (self[direction == k] for k in range(3))
        parts = [replace(long, first=half) for half in long.first.halved(tracks[0], long.t)]
        parts += [replace(wide, second=half) for half in wide.second.halved(tracks[1], wide.t)]
        times = parted(brief.t, 1, brief.t.mean(1))
        for t, first, second in zip(times, brief.first.brief(), brief.second.brief(), strict=True):
            parts.append(replace(brief, t=t, first=first, second=second))
        return PairCells.concatenated(parts)


@dataclass(frozen=True, eq=False)
class PairProof(Displayed):
    """Proof of the distance between the surfaces of two arms.

    The tubes at the plate of an arm are a body to the other arms; that clearance is part of `ArmsProof.proofs`.
    """

    arms: tuple[int, int]
    """Numbers of the arms, from 0."""
    least_clearance: Annotated[float, unit("mm"), "proved distance of the two arms at all times"]
    """-inf if no bound is proved."""
    measured_clearance: Annotated[float, unit("mm"), "smallest measured distance"]
    """Smallest distance at instants that include the checked equilibria, m."""
    when: Annotated[float, unit("s"), "time of the smallest distance"]
    times: Array = field(repr=False)
    """(M + 1,) ends of the intervals of time, s."""
    bounds: Array = field(repr=False)
    """(M,) lower bounds on the distance between `times`, m.

    They are sharp only where they decide about the clearance or the minimum.
    """

    def at_least(self, start: Array, end: Array) -> Array:
        """(T,) lower bounds on the distance between times (T,) and later ones (T,), s; outside both arms rest."""
        last_interval = len(self.bounds) - 1
        first = np.clip(np.searchsorted(self.times, start, "right") - 1, 0, last_interval)
        last = np.clip(np.searchsorted(self.times, end, "left") - 1, 0, last_interval)
        return np.array([self.bounds[a : max(a, b) + 1].min() for a, b in zip(first, last, strict=True)])


def apart(
    arms: tuple[int, int], tracks: tuple[Track, Track], target: ClearanceTarget, max_distance: float = np.inf
) -> PairProof:
    """Lower bound on the distance between the surfaces of two arms, sharp at the smallest distance.

    `max_distance`: distance of parts that do not move, m, which no bound exceeds.
    """
    first, second = tracks
    measured, when = np.inf, 0.0
    for _ in range(MAX_ROUNDS):
        times = np.union1d(first.times, second.times)
        times = times if len(times) > 1 else np.repeat(times, 2)
        rounds = _bounds((first, second), times, target, measured)
        bound = rounds.bound
        if rounds.measured < measured:
            measured, when = rounds.measured, rounds.when
        short = np.flatnonzero(bound < target.threshold(measured))
        over = first.verifier.exhausted or second.verifier.exhausted
        # A measured distance below the clearance refutes it, and no sharper bound is necessary.
        if not len(short) or over or not (first.complete and second.complete) or measured < target.clearance:
            break
        first, second = (track.finer(side[short]) for track, side in zip((first, second), rounds.links, strict=True))
    if not (first.complete and second.complete):
        bound = np.full(len(bound), -np.inf)
    bound = np.minimum(bound, max_distance)
    return PairProof(arms, float(bound.min()), min(float(measured), max_distance), float(when), times, bound)


class _Distances(NamedTuple):
    """Bounds on the distance of two arms in M intervals of time."""

    bound: Array
    """(M,) lower bounds, m."""
    links: list[Index]
    """(M,) link of either arm."""
    measured: float
    """Smallest measured distance, m."""
    when: float
    """Time of the smallest distance, s."""


def _bounds(tracks: tuple[Track, Track], times: Array, target: ClearanceTarget, closest: float) -> _Distances:
    """Distances of two arms in the intervals between times (M + 1,); `closest`: smallest one measured before, m."""
    t = np.stack([times[:-1], times[1:]], axis=1)
    links = [track.link_at(t.mean(1)) for track in tracks]
    cells, when = _first(tracks, t, links), float(times[0])
    bound, total = np.full(len(t), np.inf), 0
    while len(cells):
        total += len(cells)
        differences = cells.differences()
        distance = np.sqrt((differences**2).sum(-1))
        thick = sum(track.intervals.radius[s.link, s.section] for track, s in zip(tracks, cells.sides, strict=True))
        error = sum(track.chord_error[s.link, s.section] for track, s in zip(tracks, cells.sides, strict=True))
        sagitta = np.stack(
            [track.intervals.sagitta(s.link, s.section, s.x) for track, s in zip(tracks, cells.sides, strict=True)]
        )
        along = [side.along() for side in cells.sides]
        # The terms of Efron and Stein: squares of the change along either arm and in time.
        in_time = ((differences[..., 1, :] - differences[..., 0, :]) ** 2).sum(-1).max((1, 2))
        squares = np.stack([*along, in_time])
        nearest = distance.min((1, 2, 3))
        surface = nearest - thick
        if surface.min() < closest:
            row = int(surface.argmin())
            corner = int(distance[row].min((0, 1)).argmin())
            closest, when = float(surface[row]), float(cells.t[row, corner])
        # Less both sagittas, both radii and both chord errors; two centrelines are never inside one another.
        low = np.maximum(distance_on_patch(nearest, squares.sum(0) / 4), 0.0) - sagitta.sum(0) - thick - error
        threshold = target.threshold(closest)
        lost = surface - error - low
        # Beyond the maximum number of cells all are taken as they are: less sharp, but still a bound.
        decided = (low >= threshold) | (lost <= SIZE_FRACTION * max(closest - threshold, 0.0)) | (total > target.cells)
        np.minimum.at(bound, cells.which[decided], low[decided])
        # sqrt(d^2 - q / 4) = d - q / (8 d) to first order: halve in the direction that weakens the bound most.
        weakening = squares / (8 * np.maximum(nearest, 1e-6)) + np.concatenate([sagitta, np.zeros((1, len(cells)))])
        cells = cells[~decided].halved(tracks, weakening[:, ~decided].argmax(0))
    return _Distances(bound, links, closest, when)


def _first(tracks: tuple[Track, Track], t: Array, links: Sequence[Index]) -> PairCells:
    """Initial cells: one for every interval of time and pair of sections; an arm without length is a point."""
    exists = []
    for track, link in zip(tracks, links, strict=True):
        long = np.maximum(*track.intervals.length)[link] > SHORT
        long[~long.any(1), 0] = True
        exists.append(long)
    which, *sections = np.nonzero(exists[0][:, :, None] & exists[1][:, None, :])
    sides = []
    for track, link, section in zip(tracks, links, sections, strict=True):
        ends = [track.positions(link[which], section, np.full(len(which), x), t[which]) for x in (0.0, 1.0)]
        x = np.tile([0.0, 1.0], (len(which), 1))
        sides.append(Side(link[which], section, x, np.stack(ends, axis=1)))
    return PairCells(which, t[which], *sides)


PLATE = Frame()

# Coarser than that of an arm and bodies: cells of two arms have eight corners and are halved in three directions.
ACCURACY = 5e-5
"""Largest distance of the bound for two arms below their smallest measured distance, m."""

MAX_CELLS = 4_000_000
"""Maximum number of space-time cells of two arms. With too few the bound is less sharp, but still valid."""

CLOSE = "come as close as about"
"""Words in the fault of two arms that are too close, as opposed to an unproved distance."""


@dataclass(frozen=True, eq=False)
class PlacedRobot(Displayed):
    """A robot and the frame of its plate, in the frame that all robots share.

    Raises:
        InputError: no robot, or no frame.
    """

    robot: Robot
    """A concentric or eccentric robot."""
    base: Frame = field(default_factory=Frame)
    """Frame of its plate in the shared frame."""
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
        """Name in messages: `name`, else the robot's."""
        return self.name or self.robot.name or "robot"


class TimedMotion(Protocol):
    """Joint values over time: times (T,), s, rotations (T, n), rad, translations (T, n), m."""

    @property
    def time(self) -> Array: ...

    @property
    def rotations(self) -> Array: ...

    @property
    def translations(self) -> Array: ...


@dataclass(frozen=True, eq=False)
class ArmsProof(Displayed):
    """Proofs of the motions of several arms: of each arm, of each pair, and messages on faults."""

    proofs: tuple[Proof, ...]
    """Proof of each arm."""
    pairs: tuple[PairProof, ...]
    """Proof of the distance between each two arms."""
    faults: tuple[str, ...]
    """Violated or unproved requirements, as text; empty if everything is proved."""

    @property
    def holds(self) -> bool:
        """True if everything is proved."""
        return not self.faults

    @property
    def least_clearance(self) -> float:
        """Lower bound on the smallest distance between two arms, m."""
        return min(pair.least_clearance for pair in self.pairs)

    @property
    def value(self) -> float:
        """Smallest bound on the distance between two arms, m."""
        return self.least_clearance

    @property
    def status(self) -> ProofStatus:
        """Result of the proof, as a sentence."""
        if self.holds:
            return ProofStatus.PROVED
        refuted = any(proof.faults and not proof.open for proof in self.proofs)
        refuted |= any(CLOSE in fault for fault in self.faults)
        unfinished = any(proof.open for proof in self.proofs)
        return ProofStatus.OPEN if unfinished and not refuted else ProofStatus.FAULTY


def checked_arms(arms: Sequence[PlacedRobot]) -> tuple[PlacedRobot, ...]:
    """Arms as a tuple; raises InputError for fewer than two, or for other objects."""
    try:
        checked = tuple(arms)
    except TypeError:
        raise InputError(f"arms is {arms!r}; it must be a list of PlacedRobot") from None
    for k, arm in enumerate(checked):
        instance(f"arm {k + 1}", arm, PlacedRobot)
    if len(checked) < 2:
        raise InputError(f"arms has {len(checked)}; several robots are at least 2")
    return checked


def one_each(name: str, values: Sequence[object], arms: Sequence[PlacedRobot]) -> None:
    """Raise InputError unless a list has one value for every arm."""
    if len(values) != len(arms):
        raise InputError(f"{name} has {len(values)} for {len(arms)} arms; it must have one for each")


def plate_of(arm: PlacedRobot) -> Sphere:
    """Sphere in the shared frame around the point where the tubes leave the plate; it contains a retracted arm."""
    x, y, z = np.asarray(arm.base.origin, dtype=float).tolist()
    return Sphere((x, y, z), float(Constants.of(arm.robot).radius.max()))


def between_plates(first: PlacedRobot, second: PlacedRobot) -> float:
    """Distance between the surfaces of the spheres at the base plates of two arms, m."""
    a, b = plate_of(first), plate_of(second)
    return float(np.linalg.norm(np.subtract(a.centre, b.centre))) - a.radius - b.radius


@contextmanager
def of_arm(arms: Sequence[PlacedRobot], k: int) -> Iterator[None]:
    """Context that prefixes the messages of InputErrors with the name of an arm."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{called(arms, k)}: {error}") from error


def called(arms: Sequence[PlacedRobot], k: int) -> str:
    """Number and name of an arm, for messages."""
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
    """Prove that several robots neither snap, nor hit a body, nor touch each other during their motions.

    Every arm is verified by `verify_trajectory`. The distance of two arms is bounded from below at all times and all
    along both (`apart`). Before and after its own times an arm rests.

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
    for k, (arm, motion, start) in enumerate(zip(known, motions, begins, strict=True)):
        other_plates = [plate for j, plate in enumerate(plates) if j != k]
        with of_arm(known, k):
            motion = _checked(motion)
            joints = motion.rotations, motion.translations
            first = start or forward_kinematics(arm.robot, *(part[0] for part in joints))
            proofs.append(
                verify_trajectory(
                    arm.robot,
                    motion.time,
                    *joints,
                    start=first,
                    obstacles=bodies_in_frame(arm.base, [*bodies, *other_plates]),
                    min_margin=min_margin,
                    clearance=clearance,
                    rate_limits=rate_limits,
                    time_limit=max(clock.left, MIN_SECONDS),
                )
            )
        # Without bodies: their clearance is proved above; a track needs only the branch and its bounds.
        target = ClearanceTarget(0.0, ACCURACY, MAX_CELLS)
        verifier = TrajectoryVerifier(arm.robot, scene_of(()), target, clock)
        tracks.append(tracked(verifier, first, motion.time, np.concatenate(joints, axis=1), arm.base))
    faults = [f"{called(known, k)}: {fault}" for k, proof in enumerate(proofs) for fault in proof.faults]
    pairs = []
    for i, j in combinations(range(len(known)), 2):
        target = ClearanceTarget(clearance, ACCURACY, MAX_CELLS)
        max_distance = between_plates(known[i], known[j])
        pairs.append(apart((i, j), (tracks[i], tracks[j]), target, max_distance))
        faults += _pair_faults(known, pairs[-1], clearance)
    return ArmsProof(tuple(proofs), tuple(pairs), tuple(faults))


class _Motion(NamedTuple):
    """Joint values over time, as arrays."""

    time: Array
    rotations: Array
    translations: Array


def _checked(motion: TimedMotion) -> _Motion:
    """Arrays of a motion; raises InputError if it has none, or no row."""
    try:
        tables = [np.asarray(getattr(motion, name), dtype=float) for name in ("time", "rotations", "translations")]
    except (AttributeError, TypeError, ValueError):
        raise InputError(
            "motion is missing; it must have time, rotations and translations, a row for each time"
        ) from None
    if any(part.ndim < 1 or not len(part) for part in tables):
        raise InputError("motion has no rows; it must have one for each time, one time at least")
    return _Motion(*tables)


def _pair_faults(arms: Sequence[PlacedRobot], proof: PairProof, clearance: float) -> list[str]:
    """Messages on a violated or unproved clearance between two arms."""
    names = " and ".join(called(arms, k) for k in proof.arms)
    if proof.measured_clearance < clearance:
        return [
            f"{names} {CLOSE} {proof.measured_clearance * 1e3:.4g} mm at {proof.when:.4g} s; they must keep "
            f"{clearance * 1e3:.6g} mm"
        ]
    if proof.least_clearance == -math.inf:
        return [f"not proved: no bound of the distance of {names} at all times"]
    if proof.least_clearance < clearance:
        bound = f"a distance of {proof.least_clearance * 1e3:.4g} mm is proved for {names}"
        return [f"not proved: {bound}; the required clearance is {clearance * 1e3:.6g} mm"]
    return []


def at_rest(equilibrium: Equilibrium, base: Frame, chord: float) -> tuple[Capsule, ...]:
    """Capsules that contain an arm at rest, in the shared frame; pieces of length `chord`, m, become straight."""
    ends = equilibrium.tube_end
    length = float(equilibrium.arc_length[-1])
    # Radii step at the ends of tubes: no capsule spans such a step.
    s = np.union1d(np.linspace(0.0, length, 2 + int(length / chord)), ends[(ends > 0) & (ends < length)])
    surface = ArmSurface(equilibrium)
    points = surface.centreline(s)
    world = base.placed(points)
    radius = surface.radius((s[:-1] + s[1:]) / 2) + surface.bend * np.diff(s) ** 2 / 8
    return tuple(
        Capsule(tuple(a), tuple(b), float(r))
        for a, b, r in zip(world[:-1].tolist(), world[1:].tolist(), radius, strict=True)
    )


@dataclass(frozen=True, eq=False)
class Lines(TraceTable):
    """Centrelines of N arms, or of one arm at N instants, as points with radii."""

    points: Array
    """(N, P, 3) points of the centrelines, m."""
    radius: Array
    """(N, P) radii of the arms, m."""
    time: Array = field(default_factory=lambda: np.zeros(1))

    @staticmethod
    def of(equilibria: Sequence[Equilibrium], count: int, base: Frame = PLATE) -> Lines:
        """Lines of equilibria of a robot with its plate in a frame, with `count` points each."""
        points, radius = zip(*(ArmSurface(e).line(count) for e in equilibria), strict=True)
        return Lines(np.array(points), np.array(radius)).placed(base)

    def placed(self, frame: Frame) -> Lines:
        """Lines with their plates in a frame."""
        return replace(self, points=frame.placed(self.points))

    def later(self, delay: float) -> Lines:
        """The same lines, delayed by a time, s."""
        return replace(self, time=self.time + delay)

    def at_times(self, times: Array) -> Lines:
        """Lines at other times (T,), linear between instants, at rest before and after."""
        row = np.clip(np.searchsorted(self.time, times, side="right") - 1, 0, len(self.time) - 1)
        after = np.minimum(row + 1, len(self.time) - 1)
        step = np.where(after > row, self.time[after] - self.time[row], 1.0)
        fraction = np.clip((times - self.time[row]) / step, 0.0, 1.0)[:, None]
        points, radius = (
            a[row] + fraction.reshape(-1, *[1] * (a.ndim - 1)) * (a[after] - a[row]) for a in (self.points, self.radius)
        )
        return Lines(points, radius, times)

    def distances(self, other: Lines) -> Array:
        """(T,) distances between the surfaces of two arms at the same instants, m."""
        pairs = zip(self.points, self.radius, other.points, other.radius, strict=True)
        return np.array([(scipy.spatial.distance.cdist(a, b) - r[:, None] - q).min() for a, r, b, q in pairs])
