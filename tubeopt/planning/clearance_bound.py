"""How far an arm that moves between equilibria stays from bodies, from below.

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

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np

from ..bodies.scene import Scene
from ..typing import Array, Index, Mask
from .sections import PARTS, Intervals

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
        spread = (self.along + self.time) / 4
        far = distance**2 > spread
        # A corner lies no farther than the root of the variance from any point of the patch.
        nearest = np.where(far & (distance > 0), np.sqrt(np.maximum(distance**2 - spread, 0.0)), distance - spread**0.5)
        return np.asarray(nearest - self.sagitta - self.radius)

    def needed(self, line: float) -> float:
        """Distance of corners beyond which all cells are cleared."""
        least = np.maximum(line + self.sagitta + self.off + self.radius, 0.0)
        return float(np.sqrt(least**2 + (self.along + self.time) / 4).max(initial=0.0))

    def longer(self, distance: Array) -> Mask:
        """(N,) whether cells give away more by their length than by their way in time."""
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
