"""Many equilibria as one set of arrays, and the sections that neighbours among them share.

What `Bending` bounds is written here by hand, apart from the physics by which motions are found, since it is part of
their proof: whatever the rotations, in intervals of translations. Tests hold it against equilibria in between.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from ..equilibrium.result import Equilibrium
from ..robots.robot import Robot
from ..robots.steps import Steps, steps_of
from ..typing import Array, Index, Mask

SWAPPED = 1e-9
"""Breakpoints (m) may be so much out of order at the ends of an interval, which is round-off."""

JUMP = 1e-9
"""So far (m) to either side of a point one looks for what jumps there."""

PARTS = 4
"""Stretches into which every section is cut to begin with."""

SHAPE_ERROR = 1 / 96, 1 / 384
"""Error of cubic Hermite interpolation over a step h is at most these times h^3 |p'''| and h^4 |p''''| (Peano)."""


@dataclass(frozen=True, eq=False)
class Constants:
    """What no joint changes of n tubes of C stretches: `steps` of the tubes; kb and |kb u*_xy| (n, C + 1), 0 where a
    tube has ended, and kt; (n,) offset and its direction (n, 2), outer radius of the arm.
    """

    steps: Steps
    bending: Array
    torsional: Array
    moment: Array
    offset: Array
    direction: Array
    radius: Array

    @staticmethod
    def of(robot: Robot) -> Constants:
        """Those of a robot.

        Raises:
            InputError: tubes made of pieces that vary along their length.
        """
        home, steps = robot.assembly(robot.home_translations), steps_of(robot.tubes, "planning")
        return Constants(
            steps=steps,
            bending=np.pad(steps.bending, ((0, 0), (0, 1))),
            torsional=np.pad(steps.torsional, ((0, 0), (0, 1)), mode="edge"),
            moment=np.pad(steps.bending * steps.curvature, ((0, 0), (0, 1))),
            offset=np.abs(home.offset),
            direction=home.across[:, ::-1] * [1.0, -1.0],
            radius=np.array([tube.outer_diameter / 2 for tube in robot.tubes]) + home.offset,
        )

    @property
    def ended(self) -> int:
        """The stretch behind the end of a tube, C."""
        return int(self.steps.cuts.shape[1])

    def breakpoints(self, translations: Array) -> Array:
        """(..., C n) places where stretches of tubes at translations (..., n) end, behind the plate below 0."""
        beta = np.minimum(translations - self.steps.cuts[:, 0], 0.0)
        places = beta[..., None, :] + self.steps.cuts.T
        return np.asarray(places.reshape(*places.shape[:-2], -1))

    def stretch(self, s: Array, breakpoints: Array) -> Index:
        """(..., n) in which stretch of each tube arc lengths (...) lie, whose breakpoints are (..., C n)."""
        places = breakpoints.reshape(*breakpoints.shape[:-1], self.ended, -1)
        return np.asarray((s[..., None, None] >= places).sum(-2), dtype=np.intp)

    def at(self, table: Array, stretch: Index) -> Array:
        """(..., n) of a table (n, C + 1) in these stretches."""
        return np.asarray(table[np.arange(len(table)), stretch])

    def transmission(self, translations: Array) -> Array:
        """(..., n) int ds / kt from where tubes are held to the plate, times kt at the plate, m."""
        held = np.maximum(self.steps.cuts[:, 0] - translations, 0.0)
        begin = np.pad(self.steps.cuts, ((0, 0), (1, 0)))[:, :-1]
        inside = np.clip(held[..., None] - begin, 0.0, self.steps.cuts - begin)
        at = np.minimum((held[..., None] >= self.steps.cuts).sum(-1), self.ended - 1)
        return np.asarray((inside / self.steps.torsional).sum(-1) * self.at(self.torsional, at))


@dataclass(frozen=True, eq=False)
class Arms:
    """Equilibria one after the other; of their points along the arm: equilibrium, arc length, p, tangent, theta (n,)
    and theta' (n,)."""

    constants: Constants
    equilibria: tuple[Equilibrium, ...]
    first: Index
    arc_length: Array
    position: Array
    tangent: Array
    rotation: Array
    torsion: Array

    @staticmethod
    def of(constants: Constants, equilibria: Sequence[Equilibrium]) -> Arms:
        """Those of a list of equilibria."""
        sizes = [len(e.arc_length) for e in equilibria]
        return Arms(
            constants=constants,
            equilibria=tuple(equilibria),
            first=np.concatenate([[0], np.cumsum(sizes)]).astype(np.intp),
            arc_length=np.concatenate([e.arc_length for e in equilibria]),
            position=np.concatenate([e.position for e in equilibria]),
            tangent=np.concatenate([e.frame[:, :, 2] for e in equilibria]),
            rotation=np.concatenate([e.rotation.T for e in equilibria]),
            torsion=np.concatenate([e.torsion.T for e in equilibria]),
        )

    @cached_property
    def translations(self) -> Array:
        """(E, n) m."""
        return np.array([e.translations for e in self.equilibria])

    @cached_property
    def breakpoints(self) -> Array:
        """(E, C n) m."""
        return self.constants.breakpoints(self.translations)

    @cached_property
    def _key(self) -> tuple[Array, float]:
        stride = 2.0 * float(self.arc_length.max(initial=0.0)) + 1e-3
        owner = np.repeat(np.arange(len(self.equilibria)), np.diff(self.first))
        return self.arc_length + owner * stride, stride

    @cached_property
    def _onwards(self) -> Array:
        """theta' at the points on the side away from the plate, where it jumps between pieces of a tube."""
        c, owner = self.constants, np.repeat(np.arange(len(self.equilibria)), np.diff(self.first))
        cuts, kt, twist = self.breakpoints[owner], c.torsional, np.pad(c.steps.twist, ((0, 0), (0, 1)))
        sides = [c.stretch(self.arc_length + side * JUMP, cuts) for side in (-1, 1)]
        torque = (self.torsion - c.at(twist, sides[0])) * c.at(kt, sides[0])
        jumps = (sides[0] != sides[1]) & (self.arc_length > JUMP)[:, None]
        return np.where(jumps, torque / c.at(kt, sides[1]) + c.at(twist, sides[1]), self.torsion)

    def hermite(self, which: Index, s: Array, value: Array, slopes: tuple[Array, Array]) -> Array:
        key, stride = self._key
        low, high = self.first[which], np.maximum(self.first[which + 1] - 2, self.first[which])
        k = np.clip(np.searchsorted(key, s + which * stride, side="right") - 1, low, high)
        after = np.minimum(k + 1, self.first[which + 1] - 1)
        h = self.arc_length[after] - self.arc_length[k]
        x = np.clip(np.where(h > 0, (s - self.arc_length[k]) / np.where(h > 0, h, 1.0), 0.0), 0.0, 1.0)[..., None]
        ends = value[k] * (1 + 2 * x) * (1 - x) ** 2 + value[after] * x**2 * (3 - 2 * x)
        return np.asarray(ends + h[..., None] * (slopes[0][k] * x * (1 - x) ** 2 - slopes[1][after] * x**2 * (1 - x)))

    def points(self, which: Index, s: Array) -> Array:
        """(..., 3) centreline of equilibria (...) at arc lengths (...), cubic between the points of the solution."""
        return self.hermite(which, s, self.position, (self.tangent, self.tangent))

    def rotations(self, which: Index, s: Array) -> Array:
        """(..., n) theta of equilibria (...) at arc lengths (...)."""
        return self.hermite(which, s, self.rotation, (self._onwards, self.torsion))

    @cached_property
    def shape_error(self) -> Array:
        """(E,) bound of the distance of `points` from the centreline, m: of interpolation, and as solved for.

        p'' = R (u_y, -u_x, 0), so that |p'''| <= |u|^2 + |u'| and |p''''| <= |u|^3 + 3 |u| |u'| + |u''|; and u' follows
        from torsion, which is largest at an end of a step but for what it gains in it.
        """
        c, owner = self.constants, np.repeat(np.arange(len(self.equilibria)), np.diff(self.first))
        out = np.array([e.tip_error for e in self.equilibria])
        inner = np.flatnonzero(owner[1:] == owner[:-1])
        if not len(inner):
            return out
        h, middle = np.diff(self.arc_length)[inner], (self.arc_length[inner] + self.arc_length[inner + 1]) / 2
        stretch = c.stretch(middle, self.breakpoints[owner[inner]])
        bend = Bending.of(c, stretch)
        gain = bend.pairs.sum(2) / c.at(c.torsional, stretch)
        speed = np.maximum(np.abs(self._onwards[inner]), np.abs(self.torsion[inner + 1])) + h[:, None] * gain
        # Tubes off the centreline: theta' = g w, whose change along the arm has that of g as well.
        gain = gain * (1 + c.offset * bend.most[:, None])
        u = bend.most
        du = bend.change(speed)
        gain += speed * c.offset * du[:, None] / (1 - c.offset * u[:, None])
        ddu = bend.second(speed, speed) + bend.change(gain)
        third, fourth = u**2 + du, u**3 + 3 * u * du + ddu
        error = np.minimum(SHAPE_ERROR[0] * h**3 * third, SHAPE_ERROR[1] * h**4 * fourth)
        np.maximum.at(out, owner[inner], error + out[owner[inner]])
        return out


@dataclass(frozen=True, eq=False)
class Bending:
    """Bounds of the curvature u of cross-sections (...), whatever the rotations, and of how it changes with them.

    u k(u) = S, S = sum m_i e(theta_i), k = sum kb_i / g_i, g_i = 1 + d_i u.a_i; where d = 0, k is a constant. k is
    convex, so that k >= k(0) - |grad k(0)| |u|; between tubes that lie evenly around the centreline grad k(0) = 0.

    Attributes:
        moment: (..., n) m_i, 0 where tube i is not curved.   pairs: (..., n, n) bounds of m_i m_j / k, i unlike j.
        most: (...) bound of |u|.   stiffness: of k from below.   slope, bow: of |grad k| and of its derivative.
        yielding: of |d(u k)| over |du| from below.
    """

    moment: Array
    pairs: Array
    most: Array
    stiffness: Array
    slope: Array
    bow: Array
    yielding: Array

    @staticmethod
    def of(c: Constants, stretch: Index) -> Bending:
        """Of cross-sections in these stretches (..., n) of the tubes."""
        moment, kb = c.at(c.moment, stretch), c.at(c.bending, stretch)
        # Where no tube is present there is nothing to bend.
        straight = np.where((stretch < c.ended).any(-1), kb.sum(-1), 1.0)
        tilt = np.linalg.norm(kb @ c.direction, axis=-1)
        pull = moment.sum(-1)
        most = pull / straight
        for _ in range(50 if tilt.any() else 0):
            most = pull / np.maximum(straight - tilt * most, 1e-300)
        stiffness = straight - tilt * most
        squeeze = np.maximum(1 - c.offset * most[..., None], 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            bow = np.where(kb * c.offset > 0, 2 * kb * c.offset**2 / squeeze**3, 0.0).sum(-1)
        slope = tilt + most * bow
        yielding = stiffness - most * slope
        pairs = moment[..., :, None] * moment[..., None, :] / stiffness[..., None, None]
        n = moment.shape[-1]
        pairs[..., np.arange(n), np.arange(n)] = 0.0
        return Bending(moment, pairs, most, stiffness, slope, bow, yielding)

    def change(self, turn: Array) -> Array:
        """(...) bound of |du| where theta_i changes by at most turn (..., n)."""
        return np.asarray((self.moment * turn).sum(-1) / self.yielding)

    def second(self, one: Array, other: Array) -> Array:
        """(...) bound of the second derivative of u in directions that turn theta_i by at most these (..., n)."""
        curving = (2 * self.slope + self.most * self.bow) * self.change(one) * self.change(other)
        return np.asarray(((self.moment * one * other).sum(-1) + curving) / self.yielding)


@dataclass(frozen=True, eq=False)
class Intervals:
    """Neighbouring equilibria `one` and `other` (B,) of `arms`: K = C n sections, some without length, of which `begin`
    and `end` (B, K + 1) are the breakpoints at either; in which stretch each tube is there (B, K, n).

    A place of an interval is a section with a fraction x of it: its arc length changes linearly with time.
    """

    arms: Arms
    one: Index
    other: Index
    begin: Array
    end: Array
    stretch: Index
    ordered: Mask

    @classmethod
    def of(cls, arms: Arms, one: Index, other: Index) -> Self:
        """Those between equilibria (B,) and (B,); `ordered` (B,) tells where no breakpoints meet in between."""
        a, b = arms.breakpoints[one], arms.breakpoints[other]
        middle = (a + b) / 2
        order = np.argsort(middle, axis=1, kind="stable")
        zero = np.zeros((len(one), 1))
        sides, ordered = [], np.ones(len(one), dtype=bool)
        for points in (a, b, middle):
            sorted_points = np.concatenate([zero, np.maximum(np.take_along_axis(points, order, axis=1), 0.0)], axis=1)
            ordered &= (np.diff(sorted_points, axis=1) >= -SWAPPED).all(1)
            sides.append(np.maximum.accumulate(sorted_points, axis=1))
        # One that is behind the plate at one end and in front of it at the other meets the plate in between.
        ordered &= ~((a < -SWAPPED) & (b > SWAPPED) | (a > SWAPPED) & (b < -SWAPPED)).any(1)
        stretch = arms.constants.stretch((sides[2][:, :-1] + sides[2][:, 1:]) / 2, middle[:, None])
        return cls(arms, one, other, sides[0], sides[1], stretch, ordered)

    @cached_property
    def bending(self) -> Bending:
        """Bounds of curvature, (B, K)."""
        return Bending.of(self.arms.constants, self.stretch)

    @cached_property
    def torsional(self) -> Array:
        """(B, K, n) kt, N m^2."""
        return self.arms.constants.at(self.arms.constants.torsional, self.stretch)

    @cached_property
    def transmission(self) -> tuple[Array, Array]:
        """(B, n) at either end: int ds / kt from where tubes are held to the plate, times kt there, m."""
        constants, shift = self.arms.constants, self.arms.translations
        return constants.transmission(shift[self.one]), constants.transmission(shift[self.other])

    @cached_property
    def radius(self) -> Array:
        """(B, K) radius of the arm in each section, m."""
        present = self.stretch < self.arms.constants.ended
        return np.asarray(np.where(present, self.arms.constants.radius, 0.0).max(2))

    @cached_property
    def length(self) -> tuple[Array, Array]:
        """(B, K) of the sections at either end, m."""
        return np.diff(self.begin, axis=1), np.diff(self.end, axis=1)

    def places(self, which: Index, section: Index, x: Array) -> tuple[Array, Array]:
        """(..., 3) points of the centreline of both equilibria at fractions x of sections of intervals `which`."""
        points = []
        for e, cuts in ((self.one, self.begin), (self.other, self.end)):
            low, high = cuts[which, section], cuts[which, section + 1]
            points.append(self.arms.points(e[which], low + x * (high - low)))
        return points[0], points[1]

    @cached_property
    def changes(self) -> tuple[Array, Array]:
        """(B, K, n) and (B, K, n, n): by how much theta_i, and theta_i - theta_j, differ at most between both ends, at
        the ends of PARTS stretches of every section."""
        x = np.linspace(0.0, 1.0, PARTS + 1)
        tables = []
        for e, cuts in ((self.one, self.begin), (self.other, self.end)):
            s = cuts[:, :-1, None] + x * np.diff(cuts, axis=1)[:, :, None]
            tables.append(self.arms.rotations(np.broadcast_to(e[:, None, None], s.shape), s))
        change = tables[1] - tables[0]
        return np.abs(change).max(2), np.abs(change[..., :, None] - change[..., None, :]).max(2)
