"""Why there may be no way: sections that every way must cross and on which nothing is allowed, and closed pockets.

A way is continuous, so that whatever changes from one value to another takes every value in between: the tip rotation
of a tube, that of one tube against another, a translation. If no state with one of these values is allowed, there is no
way. Where nothing but that value is free, one state decides, and that is a proof. Else states are looked at on a grid,
or at random: what is found then is a reason to give up and not a proof, and says how many states were looked at.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ..typing import Array
from .clock import Clock
from .task import STEP_SHIFT, STEP_TURN, Task

LEVELS = 9
"""Checked sections between start and goal, of every coordinate."""

SCREENED = 48
"""Random states that screen a section; most sections have an allowed one."""

GRID_STATES = 20_000
"""Maximum number of grid states; larger sections are not decided."""

DOUBT = 2e-3
"""Margin that states must lack to count as not allowed: more than the integration is off."""

POCKET_STATES, POCKET_APART = 60, 0.02
"""Number of states at which a region counts as open, and distance of two states in units of the joints' scales."""

FAILED_MOTIONS = 1500
"""Successive failed motions at which a region counts as closed."""


@dataclass(frozen=True)
class Wall:
    """What separates start and goal."""

    words: str
    proved: bool


@dataclass(frozen=True, eq=False)
class _Section:
    """All states z with row @ z = level; `name` in words.

    free: axes (k, m) along which states of the section differ.   low, high, step (k,) along them; base (m,) is one.
    """

    name: str
    base: Array
    free: Array
    low: Array
    high: Array
    step: Array

    def points(self, shares: Array) -> Array:
        """(N, m) states at shares (N, k) of the ranges."""
        return np.asarray(self.base + (self.low + shares * (self.high - self.low)) @ self.free)

    def grid(self, most: int) -> Array | None:
        """(N, m) all states, as close as the points of a motion that are checked; None of more than `most`."""
        counts = [int(np.ceil(x - 1e-9)) + 1 for x in (self.high - self.low) / self.step]
        if np.prod(np.array(counts, dtype=float)) > most:
            return None
        axes = np.meshgrid(*(np.linspace(0, 1, count) for count in counts), indexing="ij")
        return self.points(np.stack([axis.ravel() for axis in axes], axis=1)) if counts else self.base[None]


def wall(task: Task, start: Array, goals: Sequence[Array], clock: Clock, *, seed: int = 0) -> Wall | None:
    """What keeps a start from all goals, points (m,); None where nothing was found before the clock was over. Of
    several goals the one is told of which least is proved."""
    margin, space = task.min_margin - DOUBT, task.chart.space
    if not task.obstacles:  # turned as a whole, the robot is as it was: its joints may be turned at will
        lower, upper, n = space.lower.copy(), space.upper.copy(), space.robot.n_tubes
        lower[:n], upper[:n] = -np.inf, np.inf
        space = replace(space, lower=lower, upper=upper)
    chart = replace(task.chart, space=space)
    bare = replace(task, chart=chart, min_margin=margin, margin_room=0.0, floor=0.0, ends=None)
    random = np.random.default_rng(seed)
    found = []
    for goal in goals:
        between = next(iter(_walls(bare, start, goal, clock, random)), None)
        if between is None:
            return None
        found.append(between)
    return min(found, key=lambda each: each.proved, default=None)


def _walls(task: Task, start: Array, goal: Array, clock: Clock, random: np.random.Generator) -> Iterator[Wall]:
    for section in _sections(task, start, goal):
        if clock.over:
            return
        k = len(section.free)
        if k and _any(task, section.points(random.random((SCREENED, k))), clock):
            continue
        grid = section.grid(GRID_STATES)
        if grid is None or _any(task, grid, clock) or clock.over:
            continue
        what = "margin and clearance" if task.obstacles else "the margin"
        if k == 0:
            words = f"every path passes {section.name}, where {what} cannot be kept"
            yield Wall(words, not task.chart.eccentric)
        else:
            words = f"{what} are kept at none" if task.obstacles else "the margin is kept at none"
            words = f"every path passes {section.name}, where {words} of {len(grid)} states on a grid"
            yield Wall(f"{words} (evidence, not a proof)", False)


def _any(task: Task, z: Array, clock: Clock) -> bool:
    """Whether some state (N, m) is allowed, of which most sections have one among the first."""
    parts = np.split(z, range(16, len(z), 16))
    return any(bool(task.holds(some).any()) for some in parts if not clock.over)


def _sections(task: Task, start: Array, goal: Array) -> Iterator[_Section]:
    """Sections between two points, the middle ones first."""
    space = task.chart.space
    n, m = space.robot.n_tubes, len(start)
    unit = np.eye(m)
    rows = [
        (unit[i] - unit[j], f"tube {i + 1} turned by {{:.4g}} deg at its tip against tube {j + 1}")
        for i, j in combinations(range(n), 2)
    ]
    if task.obstacles:
        rows += [(unit[i], f"tube {i + 1} turned to {{:.4g}} deg at its tip") for i in range(n)]
    rows += [
        (unit[n + k], f"tube {tubes[0] + 1} moved to {{:.4g}} mm from home") for k, tubes in enumerate(space.carriages)
    ]
    moved = np.flatnonzero(space.upper[n:] - space.lower[n:] > 1e-9) + n
    low = np.append(np.minimum(space.lower[:n], np.minimum(start, goal)[:n]) - np.pi, space.lower[n:])
    high = np.append(np.maximum(space.upper[:n], np.maximum(start, goal)[:n]) + np.pi, space.upper[n:])
    shares = np.arange(1, LEVELS + 1) / (LEVELS + 1)
    for share in shares[np.argsort(np.abs(shares - 0.5), kind="stable")]:
        base = start + share * (goal - start)
        for row, name in rows:
            if abs(row @ (goal - start)) < 1e-6:
                continue
            value = float(row @ base) * (180 / np.pi if np.abs(row[:n]).any() else 1e3)
            axes = [axis for axis in unit[:n] if row @ axis == 0]
            if row.any() and not row.sum():
                axes.append(np.abs(row))  # both of two tubes turned by the same
            if not task.obstacles:
                axes.pop()  # turned as a whole, the robot is as it was
            axes += [unit[k] for k in moved if row[k] == 0]
            yield _section(name.format(value), base, np.reshape(axes, (-1, m)), (low, high), task)


def _section(name: str, base: Array, free: Array, box: tuple[Array, Array], task: Task) -> _Section:
    n = task.chart.space.robot.n_tubes
    low, high, step = [], [], []
    for axis in free:
        i = int(np.argmax(axis != 0))
        turns = i < n
        # Without anything to collide with a whole turn is all that there is.
        whole = turns and not task.obstacles
        low.append(0.0 if whole else box[0][i] - base[i])
        high.append(2 * np.pi if whole else box[1][i] - base[i])
        step.append(STEP_TURN if turns else STEP_SHIFT * task.chart.space.length)
    return _Section(name, base, free, np.array(low), np.array(high), np.array(step))


def pocket(task: Task, point: Array, clock: Clock, *, seed: int = 0) -> int | None:
    """How many states fill the place around a point that no motion was found to leave; None where it is open, or the
    clock is over. Evidence, and no proof: motions of random length and direction are tried."""
    random = np.random.default_rng(seed)
    states, failed = [point], 0
    while failed < FAILED_MOTIONS:
        if clock.over or len(states) >= POCKET_STATES:
            return None
        at = states[random.integers(len(states))]
        way = random.normal(size=len(point))
        there = at + 10 ** random.uniform(-2.5, 0.0) * way / np.linalg.norm(way) * task.scale
        apart = np.linalg.norm((np.array(states) - there) / task.scale, axis=1).min()
        if task.motion(at, there):
            if apart > POCKET_APART:
                states, failed = [*states, there], 0
        else:
            failed += 1
    return len(states)
