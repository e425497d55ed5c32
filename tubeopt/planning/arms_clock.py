"""When arms begin to move: as early as the distance between those that move by then allows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
import scipy

from ..bodies.frames import Frame
from ..equilibrium.result import Equilibrium
from ..inverse.outline import Outline
from ..inverse.way_settings import WaySearch
from ..typing import Array
from .arms import PlacedRobot
from .clearing import Table
from .trajectory import Trajectory

Move = tuple[int, Trajectory]
"""Of an arm, from time 0."""

PLATE = Frame()


def sooner(
    arms: Sequence[PlacedRobot],
    first: Sequence[Equilibrium],
    moves: Sequence[Move],
    clearance: float,
    effort: WaySearch,
) -> Iterator[tuple[Trajectory, ...]]:
    """Motions on one clock, each move begun as early as those before it leave room; then with more room; at last one
    after the other."""
    lines = [moving(arms[k], motion, effort.delay_points) for k, motion in moves]
    for room in (effort.delay_room, 4 * effort.delay_room, np.inf):
        whole = [Lines.of([e], effort.delay_points, arm.base) for arm, e in zip(arms, first, strict=True)]
        parts: list[list[Trajectory]] = [[] for _ in arms]
        for (k, motion), line in zip(moves, lines, strict=True):
            earliest, latest = float(whole[k].time[-1]), max(float(each.time[-1]) for each in whole)
            delays = np.linspace(earliest, latest, effort.delays)[:-1].tolist() if np.isfinite(room) else []
            others = [each for j, each in enumerate(whole) if j != k]
            moved = (at for at in delays if _clear(line.later(at), others, at, clearance + room, effort))
            at = next(moved, latest)
            whole[k] = Lines.joined([whole[k], line.later(at)])  # with rest in between
            parts[k].append(replace(motion, time=motion.time + at))
        yield tuple(_joined(each) for each in parts)


def moving(arm: PlacedRobot, motion: Trajectory, count: int) -> Lines:
    """An arm at all samples of its motion, in the frame that arms share."""
    return replace(Lines.of(motion.arms, count, arm.base), time=motion.time)


def _clear(line: Lines, others: Sequence[Lines], since: float, room: float, effort: WaySearch) -> bool:
    """Whether an arm that begins to move at a time keeps its distance from the others until they rest, as they did when
    it was planned for."""
    for other in others:
        if other.time[-1] > since:
            times = np.linspace(since, other.time[-1], effort.delay_instants)
            if line.at_times(times).gaps(other.at_times(times)).min() < room:
                return False
    return True


def _joined(parts: Sequence[Trajectory]) -> Trajectory:
    """Motions of one robot, each from where the one before ends, as one, with rest in between."""
    whole = parts[0]
    for part in parts[1:]:
        rests = part.time[0] > whole.time[-1]
        kept = slice(0 if rests else 1, None)
        one, other = whole.statistics, part.statistics
        summed = {
            each.name: getattr(one, each.name) + getattr(other, each.name)
            for each in fields(one)
            if not isinstance(getattr(one, each.name), str)
        }
        tables = ("time", "rotations", "translations", "tip_position", "margin")
        joined: dict[str, Any] = {
            name: np.concatenate([getattr(whole, name), getattr(part, name)[kept]]) for name in tables
        }
        turns = tuple(a + b for a, b in zip(whole.turns, part.turns, strict=True))
        arms, summary = (*whole.arms, *part.arms[kept]), replace(other, **summed)
        whole = replace(whole, **joined, arms=arms, end=part.end, turns=turns, statistics=summary)
    return whole


@dataclass(frozen=True, eq=False)
class Lines(Table):
    """N arms, or one at N instants: points (N, P, 3) and radii (N, P), m; times (N,), s, where they count."""

    points: Array
    radius: Array
    time: Array = field(default_factory=lambda: np.zeros(1))

    @staticmethod
    def of(equilibria: Sequence[Equilibrium], count: int, base: Frame = PLATE) -> Lines:
        """Those of equilibria of a robot whose plate stands somewhere, with so many points along each."""
        points, radius = zip(*(Outline(e).line(count) for e in equilibria), strict=True)
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
