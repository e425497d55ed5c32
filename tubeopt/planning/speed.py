"""How fast the tip is, from above: what its second and third derivatives by time leave it between equilibria.

See "Speed of the tip" in `docs/theory.md`. In the middle of a link the velocity is the mean one but for a 24th of the
third derivative; between two places where it is known it is linear but for an eighth of that.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..errors import SolveError
from ..typing import Array, Mask
from .passage import SHORTEST, Follower, Link, Step, halves, joined
from .sections import SWAPPED

TIGHT = 0.029
"""Share of the speed of the tip by which its bound may lie above what was measured."""

STEADY = 1e-9
"""Share of the largest joint rate by which directions of motion may differ where they are the same."""

MOST_HALVINGS = 2
"""At a time."""

FINEST = 12
"""Times that links are halved for that at most."""


@dataclass(frozen=True)
class Pace:
    """Speed of the tip, m/s: an upper bound `most`, infinite where nothing is proved, and what was `measured`."""

    most: float
    measured: float


def paced(follower: Follower, links: Sequence[Link], span: float, limit: float) -> Pace:
    """The pace of a motion that takes `span`, s, along links that follow each other, halved where its bound is not
    sharp, or does not show that a `limit`, m/s, is kept."""
    links, most, measured = list(links), 0.0, 0.0
    for _ in range(FINEST):
        row = _Row(follower, links, span)
        measured = float(row.speed.max(initial=0.0))
        if not all(len(link.off) and np.isfinite(link.off).all() for link in links):
            return Pace(math.inf, measured)
        rates = np.array([link.rates for link in links]).reshape(-1, 2).T / row.passed ** np.array([[2], [3]])
        own, reached = row.fastest(rates, min(measured * (1 + TIGHT), limit))
        most, reached = float(own.max(initial=0.0)), max(measured, reached)
        line = reached * (1 + TIGHT)
        loose = own > (min(line, limit) if reached <= limit else line)
        loose &= np.array([link.other.at - link.one.at >= SHORTEST for link in links], dtype=bool)
        if not loose.any() or follower.over:
            break
        # What the bound gives away falls with the square of the length, and faster near folds.
        wide = np.maximum(own - reached, TIGHT * reached) / (TIGHT * reached or 1.0)
        times = np.where(loose, np.ceil(np.log2(wide) / 3).clip(1, MOST_HALVINGS), 0).tolist()
        parts: list[Link] = []
        for link, count, bound in zip(links, times, own.tolist(), strict=True):
            more = [replace(link, fastest=bound)] if count else []
            for _ in range(int(count)):
                more = [half for each in more for half in halves(follower, each)]
            parts += more
        links = [link for link, count in zip(links, times, strict=True) if not count]
        links += joined(follower, parts)[0]
        links.sort(key=lambda link: link.one.at)
    return Pace(most, measured)


@dataclass(frozen=True, eq=False)
class _Row:
    """B links that follow each other, in a motion that takes `span`, s."""

    follower: Follower
    links: list[Link]
    span: float

    @cached_property
    def passed(self) -> Array:
        """(B,) s."""
        return np.array([self.span * (link.other.at - link.one.at) for link in self.links])

    @cached_property
    def steps(self) -> list[Step]:
        """(B + 1,)."""
        return [self.links[0].one, *(link.other for link in self.links)] if self.links else []

    @cached_property
    def chord(self) -> Array:
        """(B, 3) mean velocities of the tip, m/s."""
        tips = np.array([step.equilibrium.tip_position for step in self.steps]).reshape(-1, 3)
        return np.diff(tips, axis=0) / self.passed[:, None]

    @cached_property
    def speed(self) -> Array:
        """(B,) their sizes."""
        return np.asarray(np.linalg.norm(self.chord, axis=1))

    @cached_property
    def rate(self) -> Array:
        """(B, 2n) of the joints."""
        return np.diff([step.joints for step in self.steps], axis=0) / self.passed[:, None]

    @cached_property
    def pace(self) -> Array:
        """(B,) the largest rate of a joint; 1 at rest."""
        most = np.abs(self.rate).max(1)
        return np.where(most > 0, most, 1.0)

    @cached_property
    def alike(self) -> Mask:
        """(B - 1,) whether joints go on along the same straight line at the inner steps, and so do the sections of the
        arm."""
        n, along = self.follower.robot.n_tubes, self.rate / self.pace[:, None]
        same = (np.abs(np.diff(along, axis=0)) <= STEADY).all(1)
        if not self.rate[:, n:].any():
            return np.asarray(same)
        gap = self._gaps(np.array([step.joints[n:] for step in self.steps]))
        return np.asarray(same & ~((gap[:-2] > SWAPPED) & (gap[2:] < -SWAPPED)).any((1, 2)))

    def _gaps(self, translations: Array) -> Array:
        """(S, P, P) between breakpoints, and the plate, at translations (S, n)."""
        points = self.follower.constants.breakpoints(translations)
        points = np.concatenate([np.zeros((len(points), 1)), points], axis=1)
        return np.asarray(points[:, :, None] - points[:, None, :])

    def velocity(self, step: int, link: int) -> Array | None:
        """(3,) m/s of the tip at a step, J q' with the joint rates of a link; None where breakpoints that meet there
        move apart, or under a load, under which J costs more than steps."""
        here, rate, n = self.steps[step], self.rate[link], self.follower.robot.n_tubes
        if self.follower.load is not None:
            return None
        if rate[n:].any():
            moving = np.concatenate([[0.0], np.tile(rate[n:], self.follower.constants.ended)])
            meet = np.abs(self._gaps(here.joints[None, n:])[0]) <= 2 * SWAPPED
            if (meet & (moving[:, None] != moving)).any():
                return None
        try:
            return np.asarray(here.equilibrium.jacobian().position @ rate)
        except SolveError:
            return None

    def fastest(self, rates: Array, line: float) -> tuple[Array, float]:
        """(B,) bounds of the speed in links where the second and third derivatives of the tip are at most `rates`
        (2, B); J is asked for where they are above a `line`, m/s, without it, and tells a speed that is reached."""
        if not self.links:
            return np.zeros(0), 0.0
        h, third, speed = self.passed, rates[1], self.speed
        error = np.array([step.equilibrium.tip_error for step in self.steps])
        wrong = 2 * np.maximum(error[1:], error[:-1]) / h
        plain = np.minimum(speed + rates[0] * h / 2 + wrong, [link.fastest for link in self.links])
        middle = speed + third * h**2 / 24 + wrong
        # From the middle of a link to that of the next, by what the joints go instead of time: at other rates too.
        pace = self.pace
        far, slow, bent = h * pace, middle / pace, third / pace**3
        long, both = (far[1:] + far[:-1]) / 2, np.maximum(bent[1:], bent[:-1])
        inner = np.where(self.alike, np.maximum(slow[1:], slow[:-1]) + both * long**2 / 8, np.inf)
        sides = np.stack([np.append(np.inf, inner), np.append(inner, np.inf)]) * pace
        out, reached = np.minimum(plain, sides.max(0)), 0.0
        for k in np.flatnonzero((out > line) & np.isfinite(third)).tolist():
            for side in np.flatnonzero(~np.isfinite(sides[:, k])).tolist():
                end = self.velocity(k + side, k)
                if end is not None:
                    there = float(np.linalg.norm(end))
                    sides[side, k], reached = max(middle[k], there) + third[k] * h[k] ** 2 / 32, max(reached, there)
        return np.asarray(np.minimum(plain, sides.max(0))), reached
