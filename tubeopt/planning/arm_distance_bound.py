"""How far two arms that move at the same time stay from each other, from below, at all times and all along both.

A stretch of one arm, a stretch of the other and a while are a cell. Where both go linearly between its corners, the
vector D from a point of the one to a point of the other is linear along either arm and in time, so it is a mean of its
values D_k at the eight corners. With the variance of that mean (Efron and Stein: no more than a quarter of the square
of how much D changes along the one arm, along the other and in time, summed)

    |D|^2 = mean |D_k|^2 - variance >= min |D_k|^2 - V.

What moves with both arms alike does not count. Each arm is off the linear one by no more than its sagitta |u| ds^2 / 8,
the bound of `branch` and the error of interpolation, and as thick as its outermost tube there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Annotated

import numpy as np

from ..bodies.frames import Frame
from ..display import Displayed
from ..equilibrium.result import Equilibrium
from ..files.field_metadata import unit
from ..typing import Array, Index
from .clearance_bound import SHARE, Table, Wanted, parted
from .passage import SHORTEST, BranchEndsError, Follower, Link, Step, follow, halves, joined
from .sections import Intervals

MOST_ROUNDS = 12
"""Times that intervals in which nothing sharp is shown of two arms are halved."""

SHORT = 1e-12
"""Length (m) of a section that is none."""


@dataclass(frozen=True, eq=False)
class Track:
    """A robot that was followed through its motion, and then rests: links in order of time; where it stands; from when
    to when (s) it moves; whether all of it is one stable branch, as was shown."""

    follower: Follower
    links: tuple[Link, ...]
    frame: Frame
    begin: float
    end: float
    whole: bool = True

    @cached_property
    def times(self) -> Array:
        """(L + 1,) s at the ends of links."""
        at = [self.links[0].one.at, *(link.other.at for link in self.links)]
        return self.begin + np.array(at) * (self.end - self.begin)

    @cached_property
    def intervals(self) -> Intervals:
        """Those of the links."""
        steps = [self.links[0].one, *(link.other for link in self.links)]
        first = np.arange(len(self.links))
        return self.follower.intervals([step.equilibrium for step in steps], first, first + 1)

    @cached_property
    def off(self) -> Array:
        """(L, K) how far the arm may be off the straight line in time between both ends of a link, m."""
        shape = self.intervals.arms.shape_error
        return np.array([link.off for link in self.links]) + np.maximum(shape[:-1], shape[1:])[:, None]

    def link_at(self, t: Array) -> Index:
        """(...) number of the link that times (...) lie in; before and after, the first and the last."""
        k = np.searchsorted(self.times, t, side="right") - 1
        return np.asarray(np.clip(k, 0, len(self.links) - 1), dtype=np.intp)

    def places(self, link: Index, section: Index, x: Array, t: Array) -> Array:
        """(N, 2, 3) points of the linear arm at fractions x (N,) of sections, at times t (N, 2)."""
        one, other = self.intervals.places(link, section, x)
        low, high = self.times[link][:, None], self.times[link + 1][:, None]
        share = np.clip((t - low) / np.where(high > low, high - low, 1.0), 0.0, 1.0)[..., None]
        return self.frame.placed(one[:, None] + share * (other - one)[:, None])

    def finer(self, numbers: Index) -> Track:
        """The same with those of some links halved that are no rest and not too short to be."""
        chosen = {k: self.links[k] for k in np.unique(numbers).tolist()}
        moving = {
            k: link
            for k, link in chosen.items()
            if link.other.at - link.one.at >= SHORTEST and (link.one.joints != link.other.joints).any()
        }
        if not moving:
            return self
        try:
            split = [half for link in moving.values() for half in halves(self.follower, link)]
            more, lost = joined(self.follower, split)
        except BranchEndsError:  # not where one branch was shown
            return replace(self, whole=False)
        kept = [link for k, link in enumerate(self.links) if k not in moving]
        links = sorted([*kept, *more], key=lambda link: link.one.at)
        return replace(self, links=tuple(links), whole=self.whole and not lost)


def tracked(follower: Follower, first: Equilibrium, time: Array, joints: Array, frame: Frame) -> Track:
    """Follow joint values (T, 2n) at times (T,), s, of a robot that stands somewhere; the follower knows no bodies."""
    passage = follow(follower, first, time, joints)
    steps = passage.steps
    if len(steps) == 1:  # it only rests
        steps = (steps[0], Step(1.0, steps[0].equilibrium, steps[0].joints))
    links, lost = joined(follower, [Link(a, b) for a, b in pairwise(steps)])
    whole = passage.snap is None and not passage.lost and not lost and steps[-1].at == 1.0
    return Track(follower, tuple(links), frame, float(time[0]), float(time[-1]), whole)


@dataclass(frozen=True, eq=False)
class Side(Table):
    """Of N cells what belongs to one arm: link, section, fractions x (N, 2) of it, and points (N, 2 along, 2 in time,
    3), m."""

    link: Index
    section: Index
    x: Array
    points: Array

    def along(self) -> Array:
        """(N,) squares of their length, m^2."""
        return np.asarray(((self.points[:, 1] - self.points[:, 0]) ** 2).sum(-1).max(1))

    def halved(self, track: Track, t: Array) -> tuple[Side, Side]:
        """Both halves along the arm."""
        middle = self.x.mean(1)
        points = parted(self.points, 1, track.places(self.link, self.section, middle, t))
        one, other = (replace(self, x=x, points=p) for x, p in zip(parted(self.x, 1, middle), points, strict=True))
        return one, other

    def brief(self) -> tuple[Side, Side]:
        """Both halves in time."""
        one, other = (replace(self, points=points) for points in parted(self.points, 2, self.points.mean(2)))
        return one, other


@dataclass(frozen=True, eq=False)
class PairCells(Table):
    """N cells: which while they are of, their times (N, 2), s, and either arm's part of them."""

    which: Index
    t: Array
    one: Side
    other: Side

    @property
    def sides(self) -> tuple[Side, Side]:
        """Both parts."""
        return self.one, self.other

    def gaps(self) -> Array:
        """(N, 2, 2, 2, 3) from the one arm to the other at the corners: along either, and in time, m."""
        return np.asarray(self.other.points[:, None] - self.one.points[:, :, None])

    def halved(self, tracks: tuple[Track, Track], most: Index) -> PairCells:
        """Both halves of all, along the first arm (0), the second (1) or in time (2)."""
        long, wide, brief = (self[most == k] for k in range(3))
        parts = [replace(long, one=half) for half in long.one.halved(tracks[0], long.t)]
        parts += [replace(wide, other=half) for half in wide.other.halved(tracks[1], wide.t)]
        times = parted(brief.t, 1, brief.t.mean(1))
        for t, one, other in zip(times, brief.one.brief(), brief.other.brief(), strict=True):
            parts.append(replace(brief, t=t, one=one, other=other))
        return PairCells.joined(parts)


@dataclass(frozen=True, eq=False)
class PairProof(Displayed):
    """How far the surfaces of two arms stay from each other. What an arm needs at its plate is a body to the others:
    `ArmsProof.proofs` tell of it."""

    arms: tuple[int, int]
    """Their numbers, from 0."""
    least_clearance: Annotated[float, unit("mm"), "proved distance of the two arms at all times"]
    """-inf where no bound is proved."""
    measured_clearance: Annotated[float, unit("mm"), "smallest measured distance"]
    """Between the checked equilibria, linear in time there."""
    when: Annotated[float, unit("s"), "time of the smallest distance"]
    times: Array = field(repr=False)
    """(M + 1,) s."""
    bounds: Array = field(repr=False)
    """(M,) lower bounds in the whiles between them, m: each as sharp as it took to show the clearance, or to tell the
    least."""

    def at_least(self, begin: Array, end: Array) -> Array:
        """(T,) lower bounds of the distance from times (T,) to later ones (T,), s, m; before and after its own times
        both arms rest."""
        most = len(self.bounds) - 1
        first = np.clip(np.searchsorted(self.times, begin, "right") - 1, 0, most)
        last = np.clip(np.searchsorted(self.times, end, "left") - 1, 0, most)
        return np.array([self.bounds[a : max(a, b) + 1].min() for a, b in zip(first, last, strict=True)])


def apart(arms: tuple[int, int], tracks: tuple[Track, Track], wanted: Wanted, most: float = np.inf) -> PairProof:
    """Bound of the distance between the surfaces of two arms, as sharp as is wanted where it is the least, of which
    something that does not move is `most` apart, m."""
    one, other = tracks
    measured, when = np.inf, 0.0
    for _ in range(MOST_ROUNDS):
        times = np.union1d(one.times, other.times)
        times = times if len(times) > 1 else np.repeat(times, 2)
        bound, sides, closest, then = _bounds((one, other), times, wanted, measured)
        if closest < measured:
            measured, when = closest, then
        short = np.flatnonzero(bound < wanted.line(measured))
        over = one.follower.over or other.follower.over
        if not len(short) or over or not (one.whole and other.whole) or measured < wanted.clearance:
            break
        one, other = (track.finer(side[short]) for track, side in zip((one, other), sides, strict=True))
    if not (one.whole and other.whole):
        bound = np.full(len(bound), -np.inf)
    bound = np.minimum(bound, most)
    return PairProof(arms, float(bound.min()), min(float(measured), most), float(when), times, bound)


def _bounds(
    tracks: tuple[Track, Track], times: Array, wanted: Wanted, closest: float
) -> tuple[Array, list[Index], float, float]:
    """(M,) lower bounds of the distance in the whiles between times, the link of either arm there, the least distance
    that was measured, m, and when."""
    t = np.stack([times[:-1], times[1:]], axis=1)
    links = [track.link_at(t.mean(1)) for track in tracks]
    cells, when = _first(tracks, t, links), float(times[0])
    bound, total = np.full(len(t), np.inf), 0
    while len(cells):
        total += len(cells)
        gaps = cells.gaps()
        distance = np.sqrt((gaps**2).sum(-1))
        thick = sum(track.intervals.radius[s.link, s.section] for track, s in zip(tracks, cells.sides, strict=True))
        off = sum(track.off[s.link, s.section] for track, s in zip(tracks, cells.sides, strict=True))
        bows = (track.intervals.sagitta(s.link, s.section, s.x) for track, s in zip(tracks, cells.sides, strict=True))
        bend = np.stack(list(bows))
        along = [side.along() for side in cells.sides]
        spread = np.stack([*along, ((gaps[..., 1, :] - gaps[..., 0, :]) ** 2).sum(-1).max((1, 2))])
        least = distance.min((1, 2, 3))
        surface = least - thick
        if surface.min() < closest:
            row = int(surface.argmin())
            corner = int(distance[row].min((0, 1)).argmin())
            closest, when = float(surface[row]), float(cells.t[row, corner])
        low = np.sqrt(np.maximum(least**2 - spread.sum(0) / 4, 0.0)) - bend.sum(0) - thick
        line = wanted.line(closest)
        sharp = surface - low <= SHARE * max(closest - line, 0.0)
        over = (low - off >= line) | sharp | (total > wanted.cells)
        np.minimum.at(bound, cells.which[over], (low - off)[over])
        taken = spread / (8 * np.maximum(least, 1e-6)) + np.concatenate([bend, np.zeros((1, len(cells)))])
        cells = cells[~over].halved(tracks, taken[:, ~over].argmax(0))
    return bound, links, closest, when


def _first(tracks: tuple[Track, Track], t: Array, links: Sequence[Index]) -> PairCells:
    """A cell for every while and every two sections that have a length, or for the plate's own point without any."""
    shown = []
    for track, link in zip(tracks, links, strict=True):
        long = np.maximum(*track.intervals.length)[link] > SHORT
        long[~long.any(1), 0] = True
        shown.append(long)
    which, one, other = np.nonzero(shown[0][:, :, None] & shown[1][:, None, :])
    sides = []
    for track, link, section in zip(tracks, links, (one, other), strict=True):
        ends = [track.places(link[which], section, np.full(len(which), x), t[which]) for x in (0.0, 1.0)]
        x = np.tile([0.0, 1.0], (len(which), 1))
        sides.append(Side(link[which], section, x, np.stack(ends, axis=1)))
    return PairCells(which, t[which], *sides)
