"""The space in which plans are searched: one point per equilibrium, so that no point has two branches.

Joint values do not tell in which of several equilibria a robot is. The rotations of the tubes at their own ends do,
together with the translations: see `block.transcription.explicit`. A straight line of such points is a continuous
motion of the robot; if every point on it is stable, moving the joints accordingly makes the robot follow it without a
snap.

A `Task` checks batches of points: margin, clearance, ranges and order.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

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
from ..equilibrium.result import Equilibrium
from ..robots.load import Load
from ..typing import Array, Delegate, Mask
from .arm_surface import cubic, outer_radius
from .clock import Clock, LateError
from .joints import JointSpace

BATCH = 8
"""Equilibria integrated per call: enough to hide the cost of calling, few enough to stop early where a motion fails."""

FINE = 128
"""Points along the arm at which clearance is measured during the search."""


@dataclass(frozen=True, eq=False)
class Arms:
    """N equilibria."""

    rotations: Array
    """(N, n) of the joints, rad."""
    stable: Mask
    """(N,) whether the margin is above the one asked for."""
    points: Array
    """(N, p, 3) of the centrelines, m."""
    tangents: Array
    """(N, p, 3) there."""
    arc_length: Array
    """(N, p) there, m."""
    tube_end: Array
    """(N, n) m."""

    @property
    def tip(self) -> Array:
        """(N, 3) m."""
        return self.points[:, -1]

    def some(self, rows: NDArray[np.intp]) -> Arms:
        """Those in some rows (r,)."""
        return Arms(*(getattr(self, field.name)[rows] for field in fields(self)))

    def fine(self) -> tuple[Array, Array]:
        """Arc lengths (N, FINE) and centreline (N, FINE, 3) at evenly spaced points."""
        s = np.linspace(0.0, 1.0, FINE) * self.arc_length[:, -1:]
        return s, self.at(s, np.arange(len(s)))

    def at(self, s: Array, rows: NDArray[np.intp]) -> Array:
        """(r, p, 3) centrelines of the equilibria `rows` (r,) at arc lengths s (r, p), by cubic interpolation."""
        along = self.arc_length[rows]
        k = np.clip((along[:, None, :] <= s[:, :, None]).sum(2) - 1, 0, along.shape[1] - 2)
        row, own = rows[:, None], np.arange(len(rows))[:, None]
        start = along[own, k]
        h = along[own, k + 1] - start
        x = (np.where(h > 0, (s - start) / np.where(h > 0, h, 1.0), 1.0))[..., None]
        p, q, a, b = self.points[row, k], self.points[row, k + 1], self.tangents[row, k], self.tangents[row, k + 1]
        return np.asarray(cubic(p, q, a, b, x, h[..., None]))


@lru_cache(maxsize=128)
def _mapped(function: Callable[[Kind], Any], kind: Kind, count: int, thread: int) -> Buffered:
    return Buffered(function(kind).map(count))


@dataclass(frozen=True, eq=False)
class TipCoordinates:
    """Points z (m,): tip rotations (n,), rad, then the translation of every carriage, m, of a joint space; `load`: what
    the arms of its points bear, None for arms that bear none."""

    space: JointSpace
    load: Load | None = None

    eccentric = Delegate[bool]("kind")

    @cached_property
    def parameters(self) -> Array:
        """The robot as numbers."""
        return explicit_parameters(self.space.robot)

    @cached_property
    def kind(self) -> Kind:
        """Which function its arms are."""
        return explicit_kind(self.space.robot)

    @cached_property
    def radius(self) -> Array:
        """(n,) radius of the arm where tube i is the outermost, m."""
        return outer_radius(self.space.robot)

    @cached_property
    def size(self) -> int:
        """Operations that one equilibrium takes."""
        return explicit_size(self.kind)

    def of(self, equilibrium: Equilibrium) -> Array:
        """The point of an equilibrium."""
        return self.space.join(equilibrium.tip_rotations, equilibrium.translations)

    def translations(self, z: Array) -> Array:
        """(N, n) translations of points (N, m)."""
        return self.space.joint(z)[:, self.space.robot.n_tubes :]

    def joints(self, z: Array, arms: Arms | None = None) -> Array:
        """(N, m) independent joint values of points, whose arms may be known."""
        rotations = self.rotations(z) if arms is None else arms.rotations
        return np.concatenate([rotations, z[:, self.space.robot.n_tubes :]], axis=1)

    def rotations(self, z: Array) -> Array:
        """(N, n) rotations of the joints at points z (N, m): those of `arms`, in a sixth of the time."""
        tip, shift, thread = z[:, : self.space.robot.n_tubes], self.translations(z), threading.get_ident()
        out = np.empty(tip.shape)
        for k in range(0, len(z), BATCH):
            some = slice(k, k + BATCH)
            function = _mapped(explicit_rotations, self.kind, len(tip[some]), thread)
            out[some] = function(tip[some], shift[some], self.parameters)[0]
        return out

    def arms(self, z: Array, margin: float | Array, clock: Clock | None = None) -> Arms:
        """The equilibria of points z (N, m), and whether their margin is above `margin`, one number or (N,).

        Raises:
            LateError: the clock is over before all of them are known.
        """
        n = self.space.robot.n_tubes
        shift = self.translations(z)
        floor = np.broadcast_to(margin, len(z))
        parts = []
        for k in range(0, len(z), BATCH):
            if clock is not None and clock.over:
                raise LateError
            parts.append(self._batch(z[k : k + BATCH, :n], shift[k : k + BATCH], floor[k : k + BATCH, None]))
        rotations, fields, points, tangents, s = (np.concatenate(part) for part in zip(*parts, strict=True))
        tubes = self.space.robot.tubes
        end = shift + np.array([tube.length - tube.straight_length for tube in tubes])
        return Arms(rotations, np.asarray((fields > 0).all(1)), points, tangents, s, end)

    def _batch(self, tip: Array, shift: Array, margin: Array) -> list[Array]:
        count = len(tip)
        function = _mapped(explicit_arm, self.kind, count, threading.get_ident())
        rotations, fields, points, tangents, s = (
            array.copy() for array in function(tip, shift, margin, self.parameters)
        )
        curves = [curve.reshape(count, -1, 3) for curve in (points, tangents)]
        return [rotations, fields, *curves, s.reshape(count, -1)]


# What lies between two points leaves the chord by the square of their distance: half the steps take twice the time for
# a quarter of the error, which `margin_room` and `clearance_room` cover.
STEP_TURN, STEP_JOINT, STEP_SHIFT = 0.15, 0.35, 0.02
"""Largest changes between two checked points of a motion: of a tip rotation and of a joint rotation, rad, and of a
translation, as a share of the longest tube."""

# Sixteen times as many points: what needs more grazes its bound.
HALVINGS = 4
"""Maximum number of bisections where the reserve is small."""

# Next to an end, which other code found allowed to the last digit, no reserve can be asked for. It grows with the
# distance from there, as the error between points does.
CLEARANCE_SLOPE, MARGIN_SLOPE = 3e-4, 0.02
"""Required reserves of the clearance, m, and of the margin, per distance from an end in units of the joints' scales, up
to those of full steps. No reserve is needed at the end itself."""

# An arm is closest to bodies in few places; windows lie around the smallest distances.
WINDOWS, WINDOW_POINTS = 12, 9
"""Intervals along an arm that are checked with finer points, and points of each."""

# Above the round-off of points that went through the units of OMPL.
SAME = 1e-9
"""Distance (joints' scales) of points that are one."""


# Measured on an idle core: 47 us for an equilibrium of 19,080 operations, 22 us for one of 6,464.
SECONDS_PER_OPERATION = 2.5e-9
"""Time of counted work; it sets how long a search with a budget lasts, and not what it finds by then."""


@dataclass(eq=False)
class Work:
    """Computations of a search, counted in operations, whose number does not depend on the load of the machine."""

    operations: int = 0

    @property
    def seconds(self) -> float:
        """About the time that they take on an idle core, s."""
        return self.operations * SECONDS_PER_OPERATION


@dataclass(frozen=True, eq=False)
class Task:
    """Margin and clearance to keep, and what a search leaves for what is between its points.

    What lies between two points that are checked deviates from the chord by the square of their distance. So a point
    is allowed if it keeps what is asked, and how much it has to spare decides how close its neighbours must be: one
    `margin_room` and one `clearance_room` at the longest steps, a quarter at half of these.
    """

    chart: TipCoordinates
    obstacles: tuple[Obstacle, ...]
    min_margin: float
    clearance: float
    """m."""
    margin_room: float = 2e-3
    clearance_room: float = 3e-4
    """m."""
    floor: float = 3e-5
    """Clearance (m) to spare at least, but for the neighbourhood of `ends`."""
    ends: Array | None = None
    """(k, m) points of the chart that were found to be allowed by other code."""
    clock: Clock = field(default_factory=lambda: Clock(math.inf))
    """When it is over, looking at points raises LateError, and no further motion is found to hold."""
    work: Work = field(default_factory=Work)
    """What looking at points has cost, also in tasks made from this one by `replace`."""
    _held: dict[tuple[bytes, bytes], int] = field(default_factory=dict, init=False, repr=False)
    """`fineness` of motions that hold: a way is asked for more than once."""

    @cached_property
    def scene(self) -> Scene:
        """The obstacles as one."""
        return scene_of(self.obstacles)

    @property
    def scale(self) -> Array:
        """(m,) one unit of each coordinate."""
        return self.chart.space.scale

    def from_to(self, start: Array, *goals: Array) -> Self:
        """The same with the point of the chart (m,) at which a plan begins, and those at which it may end."""
        ends = np.stack([start, *goals])
        left = self.clearances(self.arms(ends)) - self.clearance
        # Where the plate itself is this close to an obstacle, no arm has more to spare.
        floor = min(self.floor, max(0.0, float(min(left[0], left[1:].max()) / 2)))
        return replace(self, ends=ends, floor=floor)

    def roomier(self) -> Self:
        """The same with more room between what is checked and what must hold."""
        return replace(
            self,
            margin_room=3 * self.margin_room,
            clearance_room=2 * self.clearance_room,
            floor=4 * self.floor,
        )

    def clearances(self, arms: Arms, enough: float = np.inf) -> Array:
        """(N,) least distance of the arms' surfaces from obstacles, m; infinite without obstacles. Given what is
        `enough`, a number above it where it is more, and one below the clearance to keep where it is less than that.

        Arms that may come closer than is asked between points along them are looked at more closely there.
        """
        if not self.obstacles:
            return np.full(len(arms.points), np.inf)
        s, points = arms.fine()
        # A distance changes by no more than its point moves.
        step = s[:, 1]
        within = max(enough, self.clearance + self.clearance_room) + float(step.max()) + float(self.chart.radius.max())
        gap = self._gap(arms, s, points, np.arange(len(s)), within)
        least = gap.min(1)
        missed = least < (self.clearance if enough < np.inf else -np.inf)
        rows = np.flatnonzero(~missed & (least - step / 2 < self.clearance + self.clearance_room))
        if not len(rows):
            return np.asarray(least)
        step = step[rows, None, None]
        middle = np.take_along_axis(s[rows], np.argsort(gap[rows], axis=1)[:, :WINDOWS], axis=1)
        for _ in range(2):
            near = middle[..., None] + np.linspace(-1, 1, WINDOW_POINTS) * step
            near = np.clip(near, 0.0, s[rows, -1, None, None]).reshape(len(rows), -1)
            gap = self._gap(arms, near, arms.at(near, rows), rows)
            least[rows] = np.minimum(least[rows], gap.min(1))
            middle = np.take_along_axis(near, gap.argmin(1)[:, None], axis=1)
            step = step * 2 / (WINDOW_POINTS - 1)
        return np.asarray(least)

    def _gap(self, arms: Arms, s: Array, points: Array, rows: NDArray[np.intp], within: float = np.inf) -> Array:
        """(r, p) distances of the surface of arms from obstacles at arc lengths s (r, p), whose centreline is given; as
        if it were `within` (m) from them where it is farther."""
        shown = s[:, :, None] <= arms.tube_end[rows][:, None, :] + 1e-12
        radius = np.where(shown, self.chart.radius, 0.0).max(2)
        distance = self.scene.nearest(points.reshape(-1, 3), within).reshape(points.shape[:-1])
        return np.asarray(distance - radius)

    def arms(self, z: Array) -> Arms:
        """The equilibria of points (N, m), `stable` by the margin to keep and its room."""
        self.count(len(z))
        floor = self.min_margin + np.minimum(self.margin_room, MARGIN_SLOPE * self._away(z))
        return self.chart.arms(z, floor, self.clock)

    def count(self, states: int) -> None:
        """Adds the work of so many equilibria."""
        self.work.operations += states * self.chart.size

    def _away(self, z: Array) -> Array:
        """(N,) distance of points from the nearest of the ends, in units of the scales; infinite without ends."""
        if self.ends is None:
            return np.full(len(z), np.inf)
        return np.asarray(np.linalg.norm((z[:, None] - self.ends) / self.scale, axis=2).min(1))

    def needed(self, z: Array) -> Array:
        """(N,) clearance (m) that points must have to spare."""
        return np.minimum(self.floor, CLEARANCE_SLOPE * self._away(z))

    def spare(self, z: Array, *, arms: Arms | None = None) -> Array:
        """(N,) what points have to spare of margin and clearance, as a share of the room; negative where they do not
        keep margin, clearance, ranges and order."""
        arms = self.arms(z) if arms is None else arms
        space = self.chart.space
        q = self.chart.joints(z, arms)
        slack = 1e-6 * space.scale
        inside = ((q >= space.lower - slack) & (q <= space.upper + slack)).all(1) & space.ordered(q)
        away = self._away(z)
        known = away < SAME
        allowed = inside & (arms.stable | known)
        spare = np.minimum(1.0, MARGIN_SLOPE * away / self.margin_room)
        if self.obstacles and allowed.any():
            rows = np.flatnonzero(allowed)
            left = self.clearances(arms.some(rows), self.clearance + self.clearance_room) - self.clearance
            allowed[rows] = (left >= self.needed(z[rows])) | known[rows]
            spare[rows] = np.minimum(spare[rows], np.maximum(left, 0.0) / self.clearance_room)
        return np.where(allowed, spare, -1.0)

    def holds(self, z: Array) -> Mask:
        """(N,) whether points keep margin, clearance, ranges and order."""
        return np.asarray(self.spare(z) >= 0)

    def motion(self, start: Array, end: Array) -> bool:
        """Whether the straight motion between two points holds all the way."""
        return self.fineness(start, end) is not None

    def fineness(self, start: Array, end: Array) -> int | None:
        """Times that the steps of a straight motion had to be halved to tell that it holds; None where it does not."""
        key = start.tobytes(), end.tobytes()
        if key not in self._held:
            try:
                found = self._fineness(start, end)
            except LateError:
                return None
            if found is None:
                return None
            self._held[key] = found
        return self._held[key]

    def _fineness(self, start: Array, end: Array) -> int | None:
        ends = np.stack([start, end])
        arms = self.arms(ends)
        line = self.line(start, end, arms.rotations)
        spare = np.empty(len(line))
        spare[[0, -1]] = self.spare(ends, arms=arms)
        if (spare[[0, -1]] < 0).any():
            return None
        # Far points first: the middle of a motion is where most of them fail.
        inner = np.arange(1, len(line) - 1)
        order = inner[np.argsort(np.abs(inner - (len(line) - 1) / 2), kind="stable")]
        for k in range(0, len(order), BATCH):
            some = order[k : k + BATCH]
            spare[some] = self.spare(line[some])
            if (spare[some] < 0).any():
                return None
        return self._halved(line, spare)

    def _halved(self, line: Array, spare: Array) -> int | None:
        """`fineness` of a motion whose points (k, m) have something to spare."""
        for halvings in range(HALVINGS + 1):
            # The error falls with the square of the step: half of it needs a quarter of the reserve.
            tight = np.flatnonzero(np.minimum(spare[:-1], spare[1:]) < 0.25**halvings)
            if not len(tight) or halvings == HALVINGS:
                return halvings
            middle = (line[tight] + line[tight + 1]) / 2
            found = self.spare(middle)
            if (found < 0).any():
                return None
            line, spare = np.insert(line, tight + 1, middle, axis=0), np.insert(spare, tight + 1, found)
        return None

    def line(self, start: Array, end: Array, rotations: Array | None = None) -> Array:
        """(k, m) points of a motion that are to be checked, from end to end, whose `rotations` (2, n) may be known."""
        n = self.chart.space.robot.n_tubes
        change = np.abs(end - start)
        turned = self.chart.rotations(np.stack([start, end])) if rotations is None else rotations
        joint = np.abs(turned[1] - turned[0]).max()
        shift = change[n:].max(initial=0.0) / (STEP_SHIFT * self.chart.space.length)
        # Tips and joints both count: near a fold joints turn far while tips hardly do, or the reverse.
        count = int(np.ceil(max(change[:n].max() / STEP_TURN, joint / STEP_JOINT, shift, 1.0)))
        x = np.arange(1, count)[:, None] / count
        return np.concatenate([start[None], start + x * (end - start), end[None]])

    def path(self, points: Sequence[Array] | Array) -> bool:
        """Whether every motion from point to point holds."""
        return all(self.motion(a, b) for a, b in pairwise(points))

    def length(self, points: Sequence[Array] | Array) -> float:
        """Length of a path in joint space, in the metric of the joints' scales, curved as its motions are there."""
        total = 0.0
        for a, b in pairwise(points):
            q = self.chart.joints(self.line(a, b)) / self.scale
            total += float(np.linalg.norm(np.diff(q, axis=0), axis=1).sum())
        return total
