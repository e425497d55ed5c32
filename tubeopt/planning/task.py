"""What must hold all along a plan, checked in batches of points of the chart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..obstacles import Obstacle, nearest_distance
from ..robots.assembly import Array, Mask
from .chart import Arms, Chart

TURN_STEP = 0.15
"""Largest change (rad) of a tip rotation between points of a motion that are checked."""

JOINT_STEP = 0.35
"""Largest change (rad) of a joint rotation between points of a motion that are checked."""

SHIFT_STEP = 0.02
"""Largest change of a translation between points that are checked, as a share of the longest tube."""


@dataclass(frozen=True, eq=False)
class Task:
    """Margin and clearance to keep, with the room that the search leaves for what is between its points.

    min_margin, margin_room; clearance, clearance_room (m); obstacles.
    """

    chart: Chart
    obstacles: tuple[Obstacle, ...]
    min_margin: float
    clearance: float
    margin_room: float = 2e-3
    clearance_room: float = 3e-4

    @property
    def scale(self) -> Array:
        """(m,) one unit of each coordinate."""
        return self.chart.space.scale

    def clearances(self, arms: Arms) -> Array:
        """(N,) least distance of the arms' surfaces from obstacles, m; infinite without obstacles."""
        if not self.obstacles:
            return np.full(len(arms.points), np.inf)
        s, points = arms.fine()
        shown = s[:, :, None] <= arms.tube_end[:, None, :] + 1e-12
        radius = np.where(shown, self.chart.radius, 0.0).max(2)
        return np.asarray((nearest_distance(self.obstacles, points) - radius).min(1))

    def arms(self, z: Array) -> Arms:
        """The equilibria of points (N, m), `stable` by the margin to keep and its room."""
        return self.chart.arms(z, self.min_margin + self.margin_room)

    def holds(self, z: Array, *, arms: Arms | None = None) -> Mask:
        """(N,) whether points keep margin, clearance, ranges and order."""
        arms = self.arms(z) if arms is None else arms
        space = self.chart.space
        q = self.chart.joints(z, arms)
        slack = 1e-6 * space.scale
        inside = ((q >= space.lower - slack) & (q <= space.upper + slack)).all(1)
        if len(space.least):
            inside &= (q @ space.rows.T >= space.least - 1e-9 * space.length).all(1)
        good: Mask = arms.stable & inside
        if self.obstacles and good.any():
            good = good & (self.clearances(arms) >= self.clearance + self.clearance_room)
        return good

    def motion(self, start: Array, end: Array) -> bool:
        """Whether the straight motion between two points holds all the way."""
        ends = np.stack([start, end])
        arms = self.arms(ends)
        if not self.holds(ends, arms=arms).all():
            return False
        inner = self.between(start, end, arms)
        # Far points first: the middle of a motion is where most of them fail.
        order = np.argsort(np.abs(np.arange(len(inner)) - (len(inner) - 1) / 2), kind="stable")
        return all(self.holds(inner[order[k : k + 8]]).all() for k in range(0, len(inner), 8))

    def between(self, start: Array, end: Array, arms: Arms) -> Array:
        """(k, m) points of a motion that are to be checked beside its ends, whose arms are given."""
        n = self.chart.space.robot.n_tubes
        change = np.abs(end - start)
        joint = np.abs(arms.rotations[1] - arms.rotations[0]).max()
        shift = change[n:].max(initial=0.0) / (SHIFT_STEP * self.chart.space.length)
        count = int(np.ceil(max(change[:n].max() / TURN_STEP, joint / JOINT_STEP, shift, 1.0)))
        x = np.arange(1, count)[:, None] / count
        return np.asarray(start + x * (end - start))

    def path(self, points: Sequence[Array] | Array) -> bool:
        """Whether every motion from point to point holds."""
        return all(self.motion(a, b) for a, b in pairwise(points))

    def length(self, points: Sequence[Array] | Array) -> float:
        """Length of a path in joint space, in the metric of the joints' scales, curved as its motions are there."""
        total = 0.0
        for a, b in pairwise(points):
            ends = np.stack([a, b])
            line = np.concatenate([a[None], self.between(a, b, self.arms(ends)), b[None]])
            q = self.chart.joints(line, self.arms(line)) / self.scale
            total += float(np.linalg.norm(np.diff(q, axis=0), axis=1).sum())
        return total
