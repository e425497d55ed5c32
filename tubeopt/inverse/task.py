"""Space of path searches, with one point per equilibrium.

Joint values may have several equilibria. The rotations of the tubes at their own ends, together with the translations,
have exactly one: see `block.transcription.explicit`. A straight line of such points is a continuous
motion of the robot; if every point on it is stable, moving the joints accordingly makes the robot follow it without a
snap.

A `Task` checks batches of points: margin, clearance, ranges and order.
"""

from __future__ import annotations

import math
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ..block.transcription.arm import cubic
from ..block.transcription.buffered import Buffered
from ..block.transcription.explicit import (
    Kind,
    explicit_arm,
    explicit_kind,
    explicit_parameters,
    explicit_rotations,
    explicit_size,
)
from ..bodies.obstacles import Obstacle, Scene, scene_of
from ..equilibrium.arm_surface import outer_radius
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import SolveError
from ..robots.load import Load
from ..typing import Array, Mask
from .clock import Clock, OutOfTimeError
from .joints import JointSpace

BATCH = 8
"""Equilibria integrated per call: enough to hide the cost of calling, few enough to stop early where a motion fails."""

FINE = 128
"""Number of points along the arm that clearance is measured at during the search."""


@dataclass(frozen=True, eq=False)
class ArmBatch:
    """Arms of N equilibria, with p points each."""

    rotations: Array
    """Joint rotations (N, n), rad."""
    stable: Mask
    """Mask (N,) of the equilibria with the required margin."""
    points: Array
    """Points (N, p, 3) of the centrelines, m."""
    tangents: Array
    """Unit tangents (N, p, 3) at the points."""
    arc_length: Array
    """Arc lengths (N, p) of the points, m."""
    tube_end: Array
    """Ends (N, n) of the tubes, m."""

    @property
    def tip(self) -> Array:
        """Tip positions (N, 3), m."""
        return self.points[:, -1]

    def some(self, rows: NDArray[np.intp]) -> ArmBatch:
        """Arms of some rows (r,)."""
        return ArmBatch(*(getattr(self, field.name)[rows] for field in fields(self)))

    def fine(self) -> tuple[Array, Array]:
        """Arc lengths (N, FINE) and centreline (N, FINE, 3) at evenly spaced points."""
        s = np.linspace(0.0, 1.0, FINE) * self.arc_length[:, -1:]
        return s, self.at(s, np.arange(len(s)))

    def at(self, s: Array, rows: NDArray[np.intp]) -> Array:
        """Centrelines (r, p, 3) of the equilibria `rows` (r,) at arc lengths s (r, p), by cubic interpolation."""
        along = self.arc_length[rows]
        k = np.clip((along[:, None, :] <= s[:, :, None]).sum(2) - 1, 0, along.shape[1] - 2)
        row, index = rows[:, None], np.arange(len(rows))[:, None]
        start = along[index, k]
        h = along[index, k + 1] - start
        x = (np.where(h > 0, (s - start) / np.where(h > 0, h, 1.0), 1.0))[..., None]
        p, q, a, b = self.points[row, k], self.points[row, k + 1], self.tangents[row, k], self.tangents[row, k + 1]
        return np.asarray(cubic(p, q, a, b, x, h[..., None]))


@lru_cache(maxsize=128)
def _mapped(function: Callable[[Kind], Any], kind: Kind, count: int, thread: int) -> Buffered:
    return Buffered(function(kind).map(count))


@dataclass(frozen=True, eq=False)
class Coordinates(ABC):
    """Points z (m,) for equilibria of a joint space: n angles, rad, then the translation of every carriage, m.

    `load` acts on the arms of all points.
    """

    space: JointSpace
    load: Load | None = None

    @property
    @abstractmethod
    def proves(self) -> bool:
        """True if every equilibrium has a point with its exact margin: what no point keeps, no equilibrium does."""

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of operations per equilibrium."""

    @abstractmethod
    def of(self, equilibrium: Equilibrium) -> Array:
        """Point (m,) of an equilibrium."""

    @abstractmethod
    def rotations(self, z: Array) -> Array:
        """Joint rotations (N, n) at points z (N, m)."""

    @abstractmethod
    def arms(self, z: Array, margin: float | Array, clock: Clock | None = None) -> ArmBatch:
        """Arms of points z (N, m); stable are those with at least `margin`, one number or (N,).

        Raises:
            OutOfTimeError: the clock is over before all of them are computed.
        """

    @cached_property
    def parameters(self) -> Array:
        """Numbers of the robot for the integration; raises InputError for a bundle."""
        return explicit_parameters(self.space.robot)

    @cached_property
    def radius(self) -> Array:
        """Radius (n,) of the arm, m, where tube i is the outermost one."""
        return outer_radius(self.space.robot)

    def translations(self, z: Array) -> Array:
        """Translations (N, n) of points (N, m)."""
        return self.space.joint(z)[:, self.space.robot.n_tubes :]

    def joints(self, z: Array, arms: ArmBatch | None = None) -> Array:
        """Independent joint values (N, m) of points; `arms` are their arms if known."""
        rotations = self.rotations(z) if arms is None else arms.rotations
        return np.concatenate([rotations, z[:, self.space.robot.n_tubes :]], axis=1)


class TipCoordinates(Coordinates):
    """Points z (m,) with the rotations of the tubes at their own ends, which have exactly one equilibrium."""

    @property
    def proves(self) -> bool:
        """True unless tubes are eccentric: their margin is an indicator."""
        return not self.kind.eccentric

    @cached_property
    def kind(self) -> Kind:
        """Structure of a robot that selects the compiled integration."""
        return explicit_kind(self.space.robot)

    @cached_property
    def size(self) -> int:
        """Number of operations per equilibrium."""
        return explicit_size(self.kind)

    def of(self, equilibrium: Equilibrium) -> Array:
        """Point (m,) of an equilibrium."""
        return self.space.join(equilibrium.tip_rotations, equilibrium.translations)

    def rotations(self, z: Array) -> Array:
        """Joint rotations (N, n) at points z (N, m), equal to those of `arms`, in a sixth of the time."""
        tip, shift, thread = z[:, : self.space.robot.n_tubes], self.translations(z), threading.get_ident()
        out = np.empty(tip.shape)
        for k in range(0, len(z), BATCH):
            rows = slice(k, k + BATCH)
            function = _mapped(explicit_rotations, self.kind, len(tip[rows]), thread)
            out[rows] = function(tip[rows], shift[rows], self.parameters)[0]
        return out

    def arms(self, z: Array, margin: float | Array, clock: Clock | None = None) -> ArmBatch:
        """Arms of points z (N, m); stable are those with at least `margin`, one number or (N,).

        Raises:
            OutOfTimeError: the clock is over before all of them are computed.
        """
        n = self.space.robot.n_tubes
        shift = self.translations(z)
        required = np.broadcast_to(margin, len(z))
        parts = []
        for k in range(0, len(z), BATCH):
            if clock is not None and clock.over:
                raise OutOfTimeError
            parts.append(self._batch(z[k : k + BATCH, :n], shift[k : k + BATCH], required[k : k + BATCH, None]))
        rotations, fields, points, tangents, s = (np.concatenate(part) for part in zip(*parts, strict=True))
        tubes = self.space.robot.tubes
        end = shift + np.array([tube.length - tube.straight_length for tube in tubes])
        return ArmBatch(rotations, np.asarray((fields > 0).all(1)), points, tangents, s, end)

    def _batch(self, tip: Array, shift: Array, margin: Array) -> list[Array]:
        count = len(tip)
        function = _mapped(explicit_arm, self.kind, count, threading.get_ident())
        rotations, fields, points, tangents, s = (
            array.copy() for array in function(tip, shift, margin, self.parameters)
        )
        curves = [curve.reshape(count, -1, 3) for curve in (points, tangents)]
        return [rotations, fields, *curves, s.reshape(count, -1)]


class JointCoordinates(Coordinates):
    """Points of a robot without an explicit map from the tip, as of bundles: joint values, with cold solutions."""

    proves = False  # joint values may have further equilibria
    size = 120_000
    """Operations of the kernel of bundles: 0.3 ms."""

    def of(self, equilibrium: Equilibrium) -> Array:
        """Point (m,) of an equilibrium: its joint values."""
        return self.space.join(equilibrium.rotations, equilibrium.translations)

    def rotations(self, z: Array) -> Array:
        """Joint rotations (N, n) at points z (N, m)."""
        return z[:, : self.space.robot.n_tubes]

    def arms(self, z: Array, margin: float | Array, clock: Clock | None = None) -> ArmBatch:
        """Arms of points z (N, m); stable are those with at least `margin`, one number or (N,)."""
        robot, shift, required = self.space.robot, self.translations(z), np.broadcast_to(margin, len(z))
        found: list[Equilibrium | None] = []
        for rotations, translations in zip(self.rotations(z), shift, strict=True):
            if clock is not None and clock.over:
                raise OutOfTimeError
            try:
                found.append(forward_kinematics(robot, rotations, translations, load=self.load))
            except SolveError:
                found.append(None)
        width = max((len(e.arc_length) for e in found if e is not None), default=2)
        samples, s, ends = np.zeros((2, len(z), width, 3)), np.zeros((len(z), width)), np.zeros(shift.shape)
        for k, e in enumerate(found):
            if e is not None:
                # The last point is repeated.
                rows = np.minimum(np.arange(width), len(e.arc_length) - 1)
                samples[0, k], samples[1, k] = e.position[rows], e.frame[rows, :, 2]
                s[k], ends[k] = e.arc_length[rows], e.tube_end
        stable = [e is not None and e.margin >= least for e, least in zip(found, required.tolist(), strict=True)]
        return ArmBatch(self.rotations(z).copy(), np.array(stable, dtype=bool), samples[0], samples[1], s, ends)


# Between two points the arm deviates from the chord by the square of their distance: half the steps take twice the time
# for a quarter of the error, which `margin_reserve` and `clearance_reserve` cover.
STEP_TURN, STEP_JOINT, STEP_SHIFT = 0.15, 0.35, 0.02
"""Largest changes between two checked points of a motion.

A tip rotation and a joint rotation, rad, and a translation, relative to the longest tube.
"""

# Sixteen times as many points: a motion that needs more touches its bound.
HALVINGS = 4
"""Maximum number of bisections where the reserve is small."""

# Next to an end, which other code allows without reserve, no reserve can be required. It grows with the distance from
# there, as the error between points does.
CLEARANCE_SLOPE, MARGIN_SLOPE = 3e-4, 0.02
"""Required reserves of the clearance, m, and of the margin, per distance from an end of the motion.

The distance is in units of the joints' scales, up to full steps. No reserve is needed at the end itself.
"""

# An arm is closest to bodies in few places; windows lie around the smallest distances.
WINDOWS, WINDOW_POINTS = 12, 9
"""Intervals along an arm that are checked with finer points, and points of each."""

# Above the round-off of points that went through the units of OMPL.
SAME = 1e-9
"""Distance (joints' scales) of points that count as equal."""


# Measured on an idle core: 47 us for an equilibrium of 19,080 operations, 22 us for one of 6,464.
SECONDS_PER_OPERATION = 2.5e-9
"""Time per operation of counted work, s; it sets the duration of a search with a budget, not its result."""


@dataclass(eq=False)
class Work:
    """Counted operations of a search, independent of the load of the machine."""

    operations: int = 0

    @property
    def seconds(self) -> float:
        """Approximate time of the operations on an idle core, s."""
        return self.operations * SECONDS_PER_OPERATION


@dataclass(frozen=True, eq=False)
class Task:
    """Required margin and clearance of a path search, and reserves for the states between its points.

    Between two checked points the arm deviates from the chord by the square of their distance. So the reserve of a
    point decides how close its neighbours must be: one `margin_reserve` and one `clearance_reserve` at the longest
    steps, and a quarter of these at half the steps.
    """

    coordinates: Coordinates
    """Space that is searched."""
    obstacles: tuple[Obstacle, ...]
    min_margin: float
    clearance: float
    """Required clearance, m."""
    margin_reserve: float = 2e-3
    clearance_reserve: float = 3e-4
    """Reserve of clearance at the longest steps, m."""
    min_clearance_reserve: float = 3e-5
    """Smallest reserve of clearance (m), except next to `ends`."""
    ends: Array | None = None
    """Points (k, m) in tip coordinates that other code has checked."""
    clock: Clock = field(default_factory=lambda: Clock(math.inf))
    """Time limit: after it, evaluating points raises OutOfTimeError, and further motions count as invalid."""
    work: Work = field(default_factory=Work)
    """Counted work, shared with tasks made from this one by `replace`."""
    _valid: dict[tuple[bytes, bytes], int] = field(default_factory=dict, init=False, repr=False)
    """Values of `fineness` of valid motions: paths are checked more than once."""

    @cached_property
    def scene(self) -> Scene:
        """Obstacles as one scene."""
        return scene_of(self.obstacles)

    @property
    def scale(self) -> Array:
        """Unit (m,) of each coordinate."""
        return self.coordinates.space.scale

    def from_to(self, start: Array, *goals: Array) -> Self:
        """Task with the start (m,) and the possible goals of a plan as `ends`."""
        ends = np.stack([start, *goals])
        left = self.clearances(self.arms(ends)) - self.clearance
        # Where the plate itself is this close to an obstacle, no arm has a larger reserve.
        min_clearance_reserve = min(self.min_clearance_reserve, max(0.0, float(min(left[0], left[1:].max()) / 2)))
        return replace(self, ends=ends, min_clearance_reserve=min_clearance_reserve)

    def with_larger_reserves(self) -> Self:
        """Task with larger reserves between checked points."""
        return replace(
            self,
            margin_reserve=3 * self.margin_reserve,
            clearance_reserve=2 * self.clearance_reserve,
            min_clearance_reserve=4 * self.min_clearance_reserve,
        )

    def clearances(self, arms: ArmBatch, enough: float = np.inf) -> Array:
        """Smallest distance (N,) of the arms' surfaces from obstacles, m; infinite without obstacles.

        Above `enough`, and below the required clearance, the value is a bound only. Arms that may come closer between
        their points are evaluated on a finer grid there.
        """
        if not self.obstacles:
            return np.full(len(arms.points), np.inf)
        s, points = arms.fine()
        # A distance changes by no more than its point moves.
        step = s[:, 1]
        within = (
            max(enough, self.clearance + self.clearance_reserve)
            + float(step.max())
            + float(self.coordinates.radius.max())
        )
        distance = self._surface_distance(arms, s, points, np.arange(len(s)), within)
        smallest = distance.min(1)
        missed = smallest < (self.clearance if enough < np.inf else -np.inf)
        rows = np.flatnonzero(~missed & (smallest - step / 2 < self.clearance + self.clearance_reserve))
        if not len(rows):
            return np.asarray(smallest)
        step = step[rows, None, None]
        middle = np.take_along_axis(s[rows], np.argsort(distance[rows], axis=1)[:, :WINDOWS], axis=1)
        for _ in range(2):
            arc_lengths = middle[..., None] + np.linspace(-1, 1, WINDOW_POINTS) * step
            arc_lengths = np.clip(arc_lengths, 0.0, s[rows, -1, None, None]).reshape(len(rows), -1)
            distance = self._surface_distance(arms, arc_lengths, arms.at(arc_lengths, rows), rows)
            smallest[rows] = np.minimum(smallest[rows], distance.min(1))
            middle = np.take_along_axis(arc_lengths, distance.argmin(1)[:, None], axis=1)
            step = step * 2 / (WINDOW_POINTS - 1)
        return np.asarray(smallest)

    def _surface_distance(
        self, arms: ArmBatch, s: Array, points: Array, rows: NDArray[np.intp], within: float = np.inf
    ) -> Array:
        """Distances (r, p) of the surface from obstacles at arc lengths s (r, p) with centreline `points`, m.

        Distances of the centreline above `within` (m) count as `within`.
        """
        present = s[:, :, None] <= arms.tube_end[rows][:, None, :] + 1e-12
        radius = np.where(present, self.coordinates.radius, 0.0).max(2)
        distance = self.scene.nearest(points.reshape(-1, 3), within).reshape(points.shape[:-1])
        return np.asarray(distance - radius)

    def arms(self, z: Array) -> ArmBatch:
        """Arms of points (N, m), stable with the required margin and its reserve."""
        self.count(len(z))
        required = self.min_margin + np.minimum(self.margin_reserve, MARGIN_SLOPE * self._away(z))
        return self.coordinates.arms(z, required, self.clock)

    def count(self, states: int) -> None:
        """Count the work of `states` equilibria."""
        self.work.operations += states * self.coordinates.size

    def _away(self, z: Array) -> Array:
        """Distance (N,) of points from the nearest end, in units of the scales; infinite without ends."""
        if self.ends is None:
            return np.full(len(z), np.inf)
        return np.asarray(np.linalg.norm((z[:, None] - self.ends) / self.scale, axis=2).min(1))

    def needed(self, z: Array) -> Array:
        """Required reserve (N,) of clearance of points, m."""
        return np.minimum(self.min_clearance_reserve, CLEARANCE_SLOPE * self._away(z))

    def reserves(self, z: Array, *, arms: ArmBatch | None = None) -> Array:
        """Reserve (N,) of margin and clearance of points, relative to that at the longest steps.

        Negative if a point violates margin, clearance, joint limits or order.
        """
        arms = self.arms(z) if arms is None else arms
        space = self.coordinates.space
        q = self.coordinates.joints(z, arms)
        slack = 1e-6 * space.scale
        inside = ((q >= space.lower - slack) & (q <= space.upper + slack)).all(1) & space.ordered(q)
        away = self._away(z)
        known = away < SAME
        allowed = inside & (arms.stable | known)
        reserve = np.minimum(1.0, MARGIN_SLOPE * away / self.margin_reserve)
        if self.obstacles and allowed.any():
            rows = np.flatnonzero(allowed)
            left = self.clearances(arms.some(rows), self.clearance + self.clearance_reserve) - self.clearance
            allowed[rows] = (left >= self.needed(z[rows])) | known[rows]
            reserve[rows] = np.minimum(reserve[rows], np.maximum(left, 0.0) / self.clearance_reserve)
        return np.where(allowed, reserve, -1.0)

    def holds(self, z: Array) -> Mask:
        """Mask (N,) of the points that satisfy margin, clearance, joint limits and order."""
        return np.asarray(self.reserves(z) >= 0)

    def motion(self, start: Array, end: Array) -> bool:
        """True if the straight motion between two points is valid."""
        return self.fineness(start, end) is not None

    def fineness(self, start: Array, end: Array) -> int | None:
        """Number of bisections of the steps that show a straight motion to be valid; None if it is not."""
        key = start.tobytes(), end.tobytes()
        if key not in self._valid:
            try:
                fineness = self._fineness(start, end)
            except OutOfTimeError:
                return None
            if fineness is None:
                return None
            self._valid[key] = fineness
        return self._valid[key]

    def _fineness(self, start: Array, end: Array) -> int | None:
        ends = np.stack([start, end])
        arms = self.arms(ends)
        line = self.line(start, end, arms.rotations)
        reserve = np.empty(len(line))
        reserve[[0, -1]] = self.reserves(ends, arms=arms)
        if (reserve[[0, -1]] < 0).any():
            return None
        # Far points first: the middle of a motion is where most of them fail.
        inner = np.arange(1, len(line) - 1)
        order = inner[np.argsort(np.abs(inner - (len(line) - 1) / 2), kind="stable")]
        for k in range(0, len(order), BATCH):
            rows = order[k : k + BATCH]
            reserve[rows] = self.reserves(line[rows])
            if (reserve[rows] < 0).any():
                return None
        for halvings in range(HALVINGS + 1):
            # The error falls with the square of the step: half of it needs a quarter of the reserve.
            tight = np.flatnonzero(np.minimum(reserve[:-1], reserve[1:]) < 0.25**halvings)
            if not len(tight) or halvings == HALVINGS:
                return halvings
            middle = (line[tight] + line[tight + 1]) / 2
            new = self.reserves(middle)
            if (new < 0).any():
                return None
            line, reserve = np.insert(line, tight + 1, middle, axis=0), np.insert(reserve, tight + 1, new)
        return None

    def line(self, start: Array, end: Array, rotations: Array | None = None) -> Array:
        """Points (k, m) of a motion to check, from end to end; joint rotations (2, n) of the ends may be known."""
        n = self.coordinates.space.robot.n_tubes
        change = np.abs(end - start)
        turned = self.coordinates.rotations(np.stack([start, end])) if rotations is None else rotations
        joint = np.abs(turned[1] - turned[0]).max()
        shift = change[n:].max(initial=0.0) / (STEP_SHIFT * self.coordinates.space.length)
        # Tips and joints both count: near a fold joints turn far while tips hardly do, or the reverse.
        count = int(np.ceil(max(change[:n].max() / STEP_TURN, joint / STEP_JOINT, shift, 1.0)))
        x = np.arange(1, count)[:, None] / count
        return np.concatenate([start[None], start + x * (end - start), end[None]])

    def path(self, points: Sequence[Array] | Array) -> bool:
        """True if every motion from point to point is valid."""
        return all(self.motion(a, b) for a, b in pairwise(points))

    def length(self, points: Sequence[Array] | Array) -> float:
        """Length of a path in joint space, in the metric of the joints' scales, curved as its motions are there."""
        total = 0.0
        for a, b in pairwise(points):
            q = self.coordinates.joints(self.line(a, b)) / self.scale
            total += float(np.linalg.norm(np.diff(q, axis=0), axis=1).sum())
        return total
