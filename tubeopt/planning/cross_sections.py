"""Bounds of what cross-sections of a robot are like, whatever the rotations: stiffness, curvature, and how they change.

What `Bending` and `Drift` bound is written here by hand, apart from the physics by which motions are found, since it is
part of their proof. Tests hold it against equilibria in between.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np

from ..robots.lengthwise import Lengthwise, Variation, lengthwise, variation
from ..robots.robot import Robot
from ..typing import Array, Index


@dataclass(frozen=True, eq=False)
class Jet:
    """Bounds of |f|, |f'|, |f''| and, where it is known, |f'''| by time over an interval: arrays of any shape that go
    together."""

    v: Array
    d: Array
    dd: Array
    ddd: Array | None = None

    def __add__(self, other: Jet) -> Jet:
        third = None if self.ddd is None or other.ddd is None else self.ddd + other.ddd
        return Jet(self.v + other.v, self.d + other.d, self.dd + other.dd, third)

    def __mul__(self, other: Jet) -> Jet:
        third = None
        if self.ddd is not None and other.ddd is not None:
            third = self.ddd * other.v + 3 * (self.dd * other.d + self.d * other.dd) + self.v * other.ddd
        return Jet(
            self.v * other.v,
            self.d * other.v + self.v * other.d,
            self.dd * other.v + 2 * self.d * other.d + self.v * other.dd,
            third,
        )

    def map(self, function: Callable[[Array], Array]) -> Jet:
        """A linear function with no negative weights, of all of them."""
        third = None if self.ddd is None else function(self.ddd)
        return Jet(function(self.v), function(self.d), function(self.dd), third)


def part(jet: Jet, order: int) -> Array:
    """A derivative of it."""
    found = (jet.v, jet.d, jet.dd, jet.ddd)[order]
    assert found is not None
    return found


def linear(begin: Array, end: Array) -> Jet:
    """Of what goes linearly from one value to another while time goes from 0 to 1."""
    zero = np.zeros_like(begin)
    return Jet(np.maximum(np.abs(begin), np.abs(end)), np.abs(end - begin), zero, zero)


def turned(angle: Jet) -> Jet:
    """Of a unit vector that turns by an angle in a plane, or its sine; of the angle only derivatives count."""
    third = None if angle.ddd is None else angle.d**3 + 3 * angle.d * angle.dd + angle.ddd
    return Jet(np.ones_like(angle.d), angle.d, angle.d**2 + angle.dd, third)


def inverse(size: Jet) -> Jet:
    """Of 1 / f, where f is at least `size.v`."""
    one, two = size.d / size.v, size.dd / size.v
    third = None if size.ddd is None else (size.ddd / size.v + 6 * one * two + 6 * one**3) / size.v
    return Jet(1 / size.v, one / size.v, (two + 2 * one**2) / size.v, third)


@dataclass(frozen=True, eq=False)
class Constants:
    """What no joint changes of n tubes of C stretches: what they are like `along`, and its bounds on stretches, which
    are the cells of `bounds`; (n,) offset and its direction (n, 2), outer radius of the arm.
    """

    along: Lengthwise
    bounds: Variation
    offset: Array
    direction: Array
    radius: Array

    @staticmethod
    def of(robot: Robot) -> Constants:
        """Those of a robot."""
        home = robot.assembly(robot.home_translations)
        return Constants(
            along=lengthwise(robot.tubes),
            bounds=variation(robot.tubes),
            offset=np.abs(home.offset),
            direction=home.across[:, ::-1] * [1.0, -1.0],
            radius=np.array([tube.outer_diameter / 2 for tube in robot.tubes]) + home.offset,
        )

    @property
    def ended(self) -> int:
        """The stretch behind the end of a tube, C."""
        return int(self.bounds.cuts.shape[1])

    @cached_property
    def still(self) -> bool:
        """Whether nothing varies along any stretch."""
        return self.bounds.still

    def held(self, translations: Array) -> Array:
        """(..., n) where tubes at translations (..., n) are held, m, behind the plate below 0."""
        return np.minimum(translations - self.bounds.cuts[:, 0], 0.0)

    def breakpoints(self, translations: Array) -> Array:
        """(..., C n) places where stretches of tubes at translations (..., n) end, behind the plate below 0."""
        places = self.held(translations)[..., None, :] + self.bounds.cuts.T
        return np.asarray(places.reshape(*places.shape[:-2], -1))

    def stretch(self, s: Array, breakpoints: Array) -> Index:
        """(..., n) in which stretch of each tube arc lengths (...) lie, whose breakpoints are (..., C n)."""
        places = breakpoints.reshape(*breakpoints.shape[:-1], self.ended, -1)
        return np.asarray((s[..., None, None] >= places).sum(-2), dtype=np.intp)

    def most(self, table: Array, *stretches: Index) -> Array:
        """(..., n) the most of a table (n, C + 1) in any of some stretches (..., n) each."""
        tube = np.arange(len(table))
        return np.asarray(reduce(np.maximum, (table[tube, stretch] for stretch in stretches)))

    def least(self, table: Array, *stretches: Index) -> Array:
        """(..., n) the least of a table (n, C + 1) in any of some stretches (..., n) each."""
        return -self.most(-table, *stretches)


@dataclass(frozen=True, eq=False)
class Bending:
    """Bounds of the curvature u of cross-sections (...), whatever the rotations, and of how it changes with them.

    u k(u) = S, S = sum m_i e(theta_i), k = sum kb_i / g_i, g_i = 1 + d_i u.a_i; where d = 0, k is a constant. k is
    convex, so that k >= k(0) - |grad k(0)| |u|; between tubes that lie evenly around the centreline grad k(0) = 0.
    """

    moment: Array
    """(..., n) m_i, 0 where tube i is not curved."""
    pairs: Array
    """(..., n, n) of m_i m_j / k, i unlike j."""
    most: Array
    """(...) of |u|."""
    stiffness: Array
    """(...) of k from below."""
    slope: Array
    """(...) of |grad k|."""
    bow: Array
    """(...) of its derivative, and `hook` of that of this."""
    hook: Array
    yielding: Array
    """(...) of |d(u k)| over |du| from below."""

    @staticmethod
    def of(c: Constants, *stretches: Index) -> Bending:
        """Of cross-sections in any of these stretches (..., n) of the tubes."""
        moment, kb = c.most(c.bounds.pull[0], *stretches), c.least(c.bounds.bending[0], *stretches)
        # Where no tube is present there is nothing to bend.
        straight = np.where(kb.any(-1), kb.sum(-1), 1.0)
        tilt = np.linalg.norm(kb @ c.direction, axis=-1)
        pull = moment.sum(-1)
        most = pull / straight
        for _ in range(50 if tilt.any() else 0):
            most = pull / np.maximum(straight - tilt * most, 1e-300)
        stiffness = straight - tilt * most
        squeeze = np.maximum(1 - c.offset * most[..., None], 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            bow = np.where(kb * c.offset > 0, 2 * kb * c.offset**2 / squeeze**3, 0.0).sum(-1)
            hook = np.where(kb * c.offset > 0, 6 * kb * c.offset**3 / squeeze**4, 0.0).sum(-1)
        slope = tilt + most * bow
        yielding = stiffness - most * slope
        pairs = moment[..., :, None] * moment[..., None, :] / stiffness[..., None, None]
        n = moment.shape[-1]
        pairs[..., np.arange(n), np.arange(n)] = 0.0
        return Bending(moment, pairs, most, stiffness, slope, bow, hook, yielding)

    def change(self, turn: Array) -> Array:
        """(...) bound of |du| where theta_i changes by at most turn (..., n)."""
        return np.asarray((self.moment * turn).sum(-1) / self.yielding)

    def along(self, pulled: Jet) -> tuple[Jet, Jet]:
        """(...) of u, and of k over what it is at least, where S over that has the derivatives of `pulled`."""
        ratio, k = self.stiffness / self.yielding, self.stiffness
        two, three = 2 * self.slope / k + self.most * self.bow / k, (3 * self.bow + self.most * self.hook) / k
        d = ratio * pulled.d
        dd = ratio * (pulled.dd + two * d**2)
        third = stiff = None
        if pulled.ddd is not None:
            third = ratio * (pulled.ddd + 3 * two * d * dd + three * d**3)
            stiff = (self.slope * third + 3 * self.bow * d * dd + self.hook * d**3) / k
        size = Jet(np.ones_like(k), self.slope * d / k, (self.slope * dd + self.bow * d**2) / k, stiff)
        return Jet(self.most, d, dd, third), size

    def second(self, one: Array, other: Array) -> Array:
        """(...) bound of the second derivative of u in directions that turn theta_i by at most these (..., n)."""
        curving = (2 * self.slope + self.most * self.bow) * self.change(one) * self.change(other)
        return np.asarray(((self.moment * one * other).sum(-1) + curving) / self.yielding)


@dataclass(frozen=True, eq=False)
class Drift:
    """Bounds of how cross-sections (...) change where they move along n tubes, all else at rest: what tubes that vary
    add to the derivatives by time of curvature and moments. Tubes on the centreline, else there is none."""

    still: bool
    """Whether nothing varies; all but 1 / kt is then a 0 of no shape."""
    pulls: Jet
    """(..., n) of a_i / k, a_i = kb_i u*_xy in the tube's own frame."""
    pairs: Jet
    """(..., n, n) of a_i a_j / k, i unlike j."""
    ease: Jet
    """(..., n) of 1 / kt."""
    eased: Jet
    """(..., n) of its derivative by arc length."""
    wound: Jet
    """(..., n) of that of u*_z, with one derivative by time."""
    bow: Jet
    """(..., n) of what the natural turn is off a straight line in time, derivatives only."""
    give: Jet
    """(...) of 1 / k."""

    @staticmethod
    def of(c: Constants, move: Array, *stretches: Index) -> Drift:
        """Of cross-sections in any of these stretches (..., n), that move by `move` (..., n), m, in the time."""
        b, none = c.bounds, np.zeros(())
        kb = c.least(b.bending[0], *stretches)
        kb = np.where(kb.any(-1, keepdims=True), kb, 1.0)
        if c.still:
            nothing, give = Jet(none, none, none, none), Jet(1 / kb.sum(-1), none, none, none)
            ease = Jet(1 / c.least(b.torsional, *stretches), none, none, none)
            return Drift(True, nothing, nothing, ease, nothing, nothing, nothing, give)

        def jet(value: Array, *rates: Array) -> Jet:
            rows = [c.most(rate, *stretches) * move ** (k + 1) for k, rate in enumerate(rates)]
            return Jet(value, *rows, *(np.zeros_like(value) for _ in range(3 - len(rows))))

        give = inverse(jet(kb, *b.bending[1:]).map(lambda part: part.sum(-1)))
        pull = jet(c.most(b.pull[0], *stretches), *b.pull[1:])
        pulls = pull * give.map(lambda part: part[..., None])
        pairs = pulls.map(lambda part: part[..., :, None]) * pull.map(lambda part: part[..., None, :])
        pairs = pairs.map(lambda part: part * (1 - np.eye(part.shape[-1])))
        ease = jet(1 / c.least(b.torsional, *stretches), *b.ease)
        slope, bend, third = (c.most(rate, *stretches) for rate in b.ease)
        eased = Jet(slope, bend * move, third * move**2)
        wound = jet(c.most(b.twist[1], *stretches), b.twist[2])
        bow = Jet(np.zeros_like(move), wound.v * move**2 / 2, wound.v * move**2, wound.d * move**2)
        return Drift(False, pulls, pairs, ease, eased, wound, bow, give)

    def bend(self, turn: Array, bow: Array) -> tuple[Array, Array]:
        """(...) what it adds to the first and second derivative of u, theta' by time being `turn` and theta'' `bow`."""
        a = self.pulls
        return (a.d, a.dd) if self.still else (a.d.sum(-1), np.asarray((2 * a.d * turn + a.dd + a.v * bow).sum(-1)))

    def moment(self, pair: Array, bow: Array) -> tuple[Array, Array]:
        """(..., n) what it adds to those of the moments, those of theta_i - theta_j being `pair` and `bow`."""
        a = self.pairs
        return (a.d, a.dd) if self.still else (a.d.sum(-1), np.asarray((2 * a.d * pair + a.dd + a.v * bow).sum(-1)))

    def gain(self, pair: Array) -> Array:
        """(..., n) first derivative by time of what theta_i - theta_j, unlike by `pair`, makes of the moments."""
        return self.pairs.d if self.still else np.asarray((self.pairs.d * pair).sum(-1))
