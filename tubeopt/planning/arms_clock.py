"""When arms begin to move: as early as the distance between those that move by then allows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import scipy

from ..equilibrium.result import Equilibrium
from ..inverse.outline import Outline
from ..inverse.way_settings import WaySearch
from ..typing import Array
from .arms import PlacedRobot
from .trajectory import Trajectory

Move = tuple[int, Trajectory]
"""Of an arm, from time 0."""


def sooner(
    arms: Sequence[PlacedRobot],
    first: Sequence[Equilibrium],
    moves: Sequence[Move],
    clearance: float,
    effort: WaySearch,
) -> Iterator[tuple[Trajectory, ...]]:
    """Motions on one clock, each move begun as early as those before it leave room; then with more room; at last one
    after the other."""
    lines = [Lines.of(arms[k], motion, effort.delay_points) for k, motion in moves]
    for room in (effort.delay_room, 4 * effort.delay_room, np.inf):
        whole = [Lines.at(arm, [e], effort.delay_points) for arm, e in zip(arms, first, strict=True)]
        parts: list[list[Trajectory]] = [[] for _ in arms]
        for (k, motion), line in zip(moves, lines, strict=True):
            earliest, latest = float(whole[k].time[-1]), max(float(each.time[-1]) for each in whole)
            delays = np.linspace(earliest, latest, effort.delays)[:-1].tolist() if np.isfinite(room) else []
            others = [each for j, each in enumerate(whole) if j != k]
            moved = (at for at in delays if _clear(line.later(at), others, at, clearance + room, effort))
            at = next(moved, latest)
            whole[k] = whole[k].then(line.later(at))
            parts[k].append(replace(motion, time=motion.time + at))
        yield tuple(_joined(each) for each in parts)


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
class Lines:
    """An arm at T instants in the frame that arms share: times (T,), s, points (T, P, 3) and radii (T, P), m."""

    time: Array
    points: Array
    radius: Array

    @staticmethod
    def at(arm: PlacedRobot, equilibria: Sequence[Equilibrium], points: int, time: Array | None = None) -> Lines:
        """Those of equilibria, with so many points along each."""
        told = []
        for e in equilibria:
            outline = Outline(e)
            told.append(outline.at(np.linspace(0.0, e.arc_length[-1], points)))
        lines = arm.base.placed(np.array([each for each, _ in told]))
        return Lines(np.zeros(len(told)) if time is None else time, lines, np.array([r for _, r in told]))

    @staticmethod
    def of(arm: PlacedRobot, motion: Trajectory, points: int) -> Lines:
        """Those of a motion, at all of its samples."""
        return Lines.at(arm, motion.arms, points, motion.time)

    def later(self, delay: float) -> Lines:
        """The same, so many s later."""
        return replace(self, time=self.time + delay)

    def then(self, other: Lines) -> Lines:
        """This and what comes after it, with rest in between."""
        return Lines(
            np.concatenate([self.time, other.time]),
            np.concatenate([self.points, other.points]),
            np.concatenate([self.radius, other.radius]),
        )

    def at_times(self, times: Array) -> Lines:
        """The same at other times (T,), linear between instants, at rest before and after."""
        row = np.clip(np.searchsorted(self.time, times, side="right") - 1, 0, len(self.time) - 1)
        after = np.minimum(row + 1, len(self.time) - 1)
        step = np.where(after > row, self.time[after] - self.time[row], 1.0)
        share = np.clip((times - self.time[row]) / step, 0.0, 1.0)[:, None]
        parts = [
            a[row] + share.reshape(-1, *[1] * (a.ndim - 1)) * (a[after] - a[row]) for a in (self.points, self.radius)
        ]
        return Lines(times, *parts)

    def gaps(self, other: Lines) -> Array:
        """(T,) distances between the surfaces of two arms at the same instants, m."""
        both = zip(self.points, self.radius, other.points, other.radius, strict=True)
        return np.array([(scipy.spatial.distance.cdist(a, b) - r[:, None] - q).min() for a, r, b, q in both])
