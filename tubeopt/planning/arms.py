"""Several robots on one plate or endoscope: their motions past each other, proved; and what is known of a pair."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Protocol

import numpy as np
import scipy

from ..arguments import typed
from ..bodies.anatomy import seen_from
from ..bodies.frames import Frame
from ..bodies.obstacles import Capsule, Obstacle, Sphere, checked_obstacles
from ..bodies.scene import scene_of
from ..display import Displayed
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import InputError, instance, positive, vector
from ..inverse.arm_surface import ArmSurface
from ..inverse.clock import Clock
from ..robots.robot import Robot, check_robot
from ..solvers.time_limit import LEAST_SECONDS, LONG_TIME_LIMIT
from ..typing import Array
from .arm_distance_bound import PairProof, apart, tracked
from .clearance_bound import Table, Wanted
from .cross_sections import Constants
from .motion import RateLimits
from .passage import Follower
from .proof import Proof, ProofStatus, verify_trajectory

PLATE = Frame()

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
        wanted = Wanted(0.0, ACCURACY, MOST_CELLS)
        follower = Follower(arm.robot, scene_of(()), wanted, clock)
        tracks.append(tracked(follower, first, time, np.concatenate(joints, axis=1), arm.base))
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
