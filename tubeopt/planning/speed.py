"""How fast the tip is, from above: what its second and third derivatives by time leave it between equilibria.

See "Speed of the tip" in `docs/theory-proofs.md`. In the middle of a link the velocity is the mean one but for a 24th
of the third derivative; between two places where it is known it is linear but for an eighth of that. Where it is
known at both ends of a link, the cubic through both tips with these velocities leaves a 31st."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from ..equilibrium.jacobian import position_slopes
from ..equilibrium.problem import TOLERANCE
from ..equilibrium.result import Equilibrium
from ..errors import SolveError
from ..robots.assembly import ROUND_OFF
from ..solvers.compiled.binding import Carriages
from ..typing import Array, Mask
from .passage import SHORTEST, Follower, Link, Step, halves, joined

TIGHT = 0.029
"""Share of the speed of the tip by which its bound may lie above what was measured."""

HERMITE = 0.03231
"""The derivative of a function differs at most by this, times a bound of its third derivative and the square of the
length, from that of the cubic with the same values and slopes at both ends."""

SAMPLES = 8
"""Parts of a link at the ends of which the speed along that cubic is evaluated."""

STEADY = 1e-9
"""Share of the largest joint rate by which directions of motion may differ where they are the same."""

MOST_HALVINGS = 2
"""At a time."""

FINEST = 12
"""Times that links are halved for that at most."""


Slopes = dict[tuple[Equilibrium, Carriages, int], Array]
"""(3, 2n) J of equilibria, by the carriages on which tubes move together, and the side."""


@dataclass(frozen=True)
class Pace:
    """Speed of the tip, m/s: an upper bound `most`, infinite where nothing is proved, and what was `measured`."""

    most: float
    measured: float


def paced(follower: Follower, links: Sequence[Link], span: float, limit: float) -> Pace:
    """The pace of a motion that takes `span`, s, along links that follow each other, halved where its bound is not
    sharp, or does not show that a `limit`, m/s, is kept."""
    links, most, measured = list(links), 0.0, 0.0
    slopes: Slopes = {}
    for _ in range(FINEST):
        row = _Row(follower, links, span, slopes)
        measured = float((row.speed - row.wrong).max(initial=0.0))
        if not all(len(link.off) and np.isfinite(link.off).all() for link in links):
            return Pace(math.inf, measured)
        rates = np.array([link.rates for link in links]).reshape(-1, 2).T / row.passed ** np.array([[2], [3]])
        own, reached = row.fastest(rates, min(measured * (1 + TIGHT), limit))
        most, reached = float(own.max(initial=0.0)), max(measured, reached)
        line = reached * (1 + TIGHT)
        loose = own > (min(line, limit) if reached <= limit else line)
        loose &= np.array([link.other.at - link.one.at >= SHORTEST for link in links], dtype=bool)
        # The speed over less than the accuracy of the tips is not known better.
        loose &= own * row.passed > TOLERANCE * follower.length
        if not loose.any() or follower.over:
            break
        # What the bound gives away falls with the square of the length, and faster near folds; halves get the cubic.
        best = np.minimum(own, row.speed + HERMITE * rates[1] * row.passed**2)
        wide = np.maximum(best - reached, TIGHT * reached) / (TIGHT * reached or 1.0)
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
    slopes: Slopes
    """What was computed of J."""

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
    def wrong(self) -> Array:
        """(B,) by how much the errors of both tips may change that size."""
        error = np.array([step.equilibrium.tip_error for step in self.steps])
        return np.asarray(2 * np.maximum(error[1:], error[:-1]) / self.passed)

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
        return np.asarray(same & ~((gap[:-2] > ROUND_OFF) & (gap[2:] < -ROUND_OFF)).any((1, 2)))

    def _gaps(self, translations: Array) -> Array:
        """(S, P, P) between breakpoints, the plate and places of the load, at translations (S, n)."""
        points = self.follower.cuts(translations)
        return np.asarray(points[:, :, None] - points[:, None, :])

    def velocity(self, step: int, link: int) -> Array | None:
        """(3,) velocity of the tip at the first or last step of a link, m/s, in the limit from inside the link; None at
        a fold.

        It is J q'. But where breakpoints meet, each column of J has another order of the sections, and columns do not
        add up. There q' is a sum of parts that keep the order which the sections have in the link: all moving tubes
        together at the rate of the slowest, then all others by what the next is faster, and so on.
        """
        e, inwards, n = self.steps[step].equilibrium, 1 if step == link else -1, self.follower.robot.n_tubes
        turn, shift = np.split(inwards * self.rate[link], 2)
        parts: list[tuple[int, float, Mask]] = []
        if shift.any() and self._meeting(step, shift):
            for side in (1, -1):
                paces = np.unique(np.append(0.0, side * shift).clip(0))
                parts += [(side, side * (b - a), side * shift >= b) for a, b in pairwise(paces.tolist())]
        try:
            if not parts:
                return np.asarray(self._slopes(e) @ self.rate[link])
            velocity = self._slopes(e)[:, :n] @ turn
            for side, pace, tubes in parts:
                velocity += pace * self._slopes(e, tubes, side)[:, n:][:, tubes].sum(1)
        except SolveError:
            return None
        return np.asarray(inwards * velocity)

    def _meeting(self, step: int, shift: Array) -> bool:
        """Whether moving breakpoints of tubes at rates (n,) meet others, the plate or a place of the load at a step."""
        n, ended = self.follower.robot.n_tubes, self.follower.constants.ended
        meet = np.abs(self._gaps(self.steps[step].joints[None, n:])[0]) <= ROUND_OFF
        owner = np.full(len(meet), -1)
        owner[1 : 1 + n * ended] = np.tile(np.arange(n), ended)
        moves = np.append(shift, 0.0)[owner] != 0
        return bool((meet & (owner[:, None] != owner) & (moves[:, None] | moves)).any())

    def _slopes(self, e: Equilibrium, together: Mask | None = None, side: int = 1) -> Array:
        """(3, 2n) J to one side, in which some tubes (n,) share a carriage, and so do the others."""
        carriages = self.follower.robot.moving_together
        if together is not None:
            groups = (np.flatnonzero(mask).tolist() for mask in (together, ~together))
            carriages = tuple(tuple(tubes) for tubes in groups if tubes)
        key = e, carriages, side
        if key not in self.slopes:
            self.slopes[key] = position_slopes(e, carriages, side=side)
        return self.slopes[key]

    def fastest(self, rates: Array, line: float) -> tuple[Array, float]:
        """(B,) bounds of the speed in links where the second and third derivatives of the tip are at most `rates`
        (2, B); J is asked for where they are above a `line`, m/s, without it, and tells a speed that is reached."""
        if not self.links:
            return np.zeros(0), 0.0
        h, third, speed = self.passed, rates[1], self.speed
        wrong = self.wrong
        plain = np.minimum(speed + rates[0] * h / 2 + wrong, [link.fastest for link in self.links])
        middle = speed + third * h**2 / 24 + wrong
        # From the middle of a link to that of the next, by what the joints go instead of time: at other rates too.
        pace = self.pace
        far, slow, bent = h * pace, middle / pace, third / pace**3
        long, both = (far[1:] + far[:-1]) / 2, np.maximum(bent[1:], bent[:-1])
        inner = np.where(self.alike, np.maximum(slow[1:], slow[:-1]) + both * long**2 / 8, np.inf)
        sides = np.stack([np.append(np.inf, inner), np.append(inner, np.inf)]) * pace
        out, reached = np.minimum(plain, sides.max(0)), 0.0
        enough = speed + HERMITE * third * h**2 <= line
        for k in np.flatnonzero((out > line) & np.isfinite(third)).tolist():
            ends: list[Array | None] = [None, None]
            for side in np.argsort(np.isfinite(sides[:, k]), kind="stable").tolist():
                missing = not np.isfinite(sides[side, k])
                if not missing and (not enough[k] or min(plain[k], sides[:, k].max()) <= line):
                    break
                ends[side] = end = self.velocity(k + side, k)
                there = 0.0 if end is None else float(np.linalg.norm(end))
                reached = max(reached, there)
                if missing and end is not None:
                    sides[side, k] = max(middle[k], there) + third[k] * h[k] ** 2 / 32
            if ends[0] is not None and ends[1] is not None:
                cubic = fastest_on_cubic(self.chord[k], ends[0], ends[1]) + 1.5 * wrong[k]
                plain[k] = min(plain[k], cubic + HERMITE * third[k] * h[k] ** 2)
        return np.asarray(np.minimum(plain, sides.max(0))), reached


def fastest_on_cubic(mean: Array, begin: Array, end: Array) -> float:
    """Upper bound of the speed along the cubic with velocities (3,) `begin` and `end` at its ends and this `mean`."""
    x, bow = np.linspace(0.0, 1.0, SAMPLES + 1)[:, None], mean - (begin + end) / 2
    velocity = begin + (end - begin) * x + 6 * x * (1 - x) * bow
    return float(np.linalg.norm(velocity, axis=1).max() + 12 * np.linalg.norm(bow) / (8 * SAMPLES**2))
