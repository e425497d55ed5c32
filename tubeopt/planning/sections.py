"""Many equilibria as one set of arrays, the sections that neighbours share, and bounds of their cross-sections.

What `CurvatureBounds` and `TransportBounds` bound is written here by hand, apart from the physics by which motions are
found, since it is part of their proof. Tests compare it with equilibria in between.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any, Self

import numpy as np

from ..equilibrium.result import Equilibrium
from ..inverse.arm_surface import cubic
from ..robots.lengthwise import Lengthwise, Variation, lengthwise, variation
from ..robots.robot import Robot
from ..typing import Array, Index, Mask


@dataclass(frozen=True, eq=False)
class DerivativeBounds:
    """Bounds of |f|, |f'|, |f''| and, where it is known, |f'''| by time over an interval: arrays of any shape that go
    together."""

    v: Array
    d: Array
    dd: Array
    ddd: Array | None = None

    def __add__(self, other: DerivativeBounds) -> DerivativeBounds:
        third = None if self.ddd is None or other.ddd is None else self.ddd + other.ddd
        return DerivativeBounds(self.v + other.v, self.d + other.d, self.dd + other.dd, third)

    def __mul__(self, other: DerivativeBounds) -> DerivativeBounds:
        third = None
        if self.ddd is not None and other.ddd is not None:
            third = self.ddd * other.v + 3 * (self.dd * other.d + self.d * other.dd) + self.v * other.ddd
        return DerivativeBounds(
            self.v * other.v,
            self.d * other.v + self.v * other.d,
            self.dd * other.v + 2 * self.d * other.d + self.v * other.dd,
            third,
        )

    def map(self, function: Callable[[Array], Array]) -> DerivativeBounds:
        """A linear function with no negative weights, of all of them."""
        third = None if self.ddd is None else function(self.ddd)
        return DerivativeBounds(function(self.v), function(self.d), function(self.dd), third)


def part(jet: DerivativeBounds, order: int) -> Array:
    """A derivative of it."""
    found = (jet.v, jet.d, jet.dd, jet.ddd)[order]
    assert found is not None
    return found


def linear(begin: Array, end: Array) -> DerivativeBounds:
    """Of what goes linearly from one value to another while time goes from 0 to 1."""
    zero = np.zeros_like(begin)
    return DerivativeBounds(np.maximum(np.abs(begin), np.abs(end)), np.abs(end - begin), zero, zero)


def turned(angle: DerivativeBounds) -> DerivativeBounds:
    """Of a unit vector that turns by an angle in a plane, or its sine; of the angle only derivatives count."""
    # e(phi)''' = phi''' e' + 3 phi' phi'' e'' + phi'^3 e''', and all derivatives of e by phi have length 1.
    third = None if angle.ddd is None else angle.d**3 + 3 * angle.d * angle.dd + angle.ddd
    return DerivativeBounds(np.ones_like(angle.d), angle.d, angle.d**2 + angle.dd, third)


def inverse(size: DerivativeBounds) -> DerivativeBounds:
    """Of 1 / f, where f is at least `size.v`."""
    # (1/f)'' = 2 f'^2 / f^3 - f'' / f^2, and (1/f)''' = -6 f'^3 / f^4 + 6 f' f'' / f^3 - f''' / f^2.
    one, two = size.d / size.v, size.dd / size.v
    third = None if size.ddd is None else (size.ddd / size.v + 6 * one * two + 6 * one**3) / size.v
    return DerivativeBounds(1 / size.v, one / size.v, (two + 2 * one**2) / size.v, third)


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
class CurvatureBounds:
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
    def of(c: Constants, *stretches: Index) -> CurvatureBounds:
        """Of cross-sections in any of these stretches (..., n) of the tubes."""
        moment, kb = c.most(c.bounds.pull[0], *stretches), c.least(c.bounds.bending[0], *stretches)
        # Where no tube is present there is nothing to bend.
        straight = np.where(kb.any(-1), kb.sum(-1), 1.0)
        tilt = np.linalg.norm(kb @ c.direction, axis=-1)
        pull = moment.sum(-1)
        # |u| (k(0) - |grad k(0)| |u|) <= |S|: iterated from below, |u| grows towards the least root.
        most = pull / straight
        for _ in range(50 if tilt.any() else 0):
            most = pull / np.maximum(straight - tilt * most, 1e-300)
        stiffness = straight - tilt * most
        # k_i = kb_i / g_i: the second and third derivatives by u are 2 kb d^2 / g^3 and 6 kb d^3 / g^4 in size.
        squeeze = np.maximum(1 - c.offset * most[..., None], 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            bow = np.where(kb * c.offset > 0, 2 * kb * c.offset**2 / squeeze**3, 0.0).sum(-1)
            hook = np.where(kb * c.offset > 0, 6 * kb * c.offset**3 / squeeze**4, 0.0).sum(-1)
        # The gradient of k at 0, and how much it grows over |u|.
        slope = tilt + most * bow
        # d(u k) = k du + u (grad k . du).
        yielding = stiffness - most * slope
        pairs = moment[..., :, None] * moment[..., None, :] / stiffness[..., None, None]
        n = moment.shape[-1]
        pairs[..., np.arange(n), np.arange(n)] = 0.0
        return CurvatureBounds(moment, pairs, most, stiffness, slope, bow, hook, yielding)

    def change(self, turn: Array) -> Array:
        """(...) bound of |du| where theta_i changes by at most turn (..., n)."""
        return np.asarray((self.moment * turn).sum(-1) / self.yielding)

    def along(self, pulled: DerivativeBounds) -> tuple[DerivativeBounds, DerivativeBounds]:
        """(...) of u, and of k over what it is at least, where S over that has the derivatives of `pulled`."""
        ratio, k = self.stiffness / self.yielding, self.stiffness
        two, three = 2 * self.slope / k + self.most * self.bow / k, (3 * self.bow + self.most * self.hook) / k
        d = ratio * pulled.d
        dd = ratio * (pulled.dd + two * d**2)
        third = stiff = None
        if pulled.ddd is not None:
            third = ratio * (pulled.ddd + 3 * two * d * dd + three * d**3)
            stiff = (self.slope * third + 3 * self.bow * d * dd + self.hook * d**3) / k
        size = DerivativeBounds(np.ones_like(k), self.slope * d / k, (self.slope * dd + self.bow * d**2) / k, stiff)
        return DerivativeBounds(self.most, d, dd, third), size

    def second(self, one: Array, other: Array) -> Array:
        """(...) bound of the second derivative of u in directions that turn theta_i by at most these (..., n)."""
        # (u k)'' = k u'' + 2 k' u' + u k'', solved for u''.
        curving = (2 * self.slope + self.most * self.bow) * self.change(one) * self.change(other)
        return np.asarray(((self.moment * one * other).sum(-1) + curving) / self.yielding)


@dataclass(frozen=True, eq=False)
class TransportBounds:
    """Bounds of how cross-sections (...) change where they move along n tubes, all else at rest: what tubes that vary
    add to the derivatives by time of curvature and moments. Tubes on the centreline, else there is none."""

    still: bool
    """Whether nothing varies; all but 1 / kt is then a 0 of no shape."""
    pulls: DerivativeBounds
    """(..., n) of a_i / k, a_i = kb_i u*_xy in the tube's own frame."""
    pairs: DerivativeBounds
    """(..., n, n) of a_i a_j / k, i unlike j."""
    ease: DerivativeBounds
    """(..., n) of 1 / kt."""
    eased: DerivativeBounds
    """(..., n) of its derivative by arc length."""
    wound: DerivativeBounds
    """(..., n) of that of u*_z, with one derivative by time."""
    bow: DerivativeBounds
    """(..., n) of what the natural turn is off a straight line in time, derivatives only."""
    give: DerivativeBounds
    """(...) of 1 / k."""

    @staticmethod
    def of(c: Constants, move: Array, *stretches: Index) -> TransportBounds:
        """Of cross-sections in any of these stretches (..., n), that move by `move` (..., n), m, in the time."""
        b, none = c.bounds, np.zeros(())
        kb = c.least(b.bending[0], *stretches)
        kb = np.where(kb.any(-1, keepdims=True), kb, 1.0)
        if c.still:
            nothing, give = DerivativeBounds(none, none, none, none), DerivativeBounds(1 / kb.sum(-1), none, none, none)
            ease = DerivativeBounds(1 / c.least(b.torsional, *stretches), none, none, none)
            return TransportBounds(True, nothing, nothing, ease, nothing, nothing, nothing, give)

        def jet(value: Array, *rates: Array) -> DerivativeBounds:
            rows = [c.most(rate, *stretches) * move ** (k + 1) for k, rate in enumerate(rates)]
            return DerivativeBounds(value, *rows, *(np.zeros_like(value) for _ in range(3 - len(rows))))

        give = inverse(jet(kb, *b.bending[1:]).map(lambda part: part.sum(-1)))
        pull = jet(c.most(b.pull[0], *stretches), *b.pull[1:])
        pulls = pull * give.map(lambda part: part[..., None])
        pairs = pulls.map(lambda part: part[..., :, None]) * pull.map(lambda part: part[..., None, :])
        pairs = pairs.map(lambda part: part * (1 - np.eye(part.shape[-1])))
        ease = jet(1 / c.least(b.torsional, *stretches), *b.ease)
        slope, bend, third = (c.most(rate, *stretches) for rate in b.ease)
        eased = DerivativeBounds(slope, bend * move, third * move**2)
        wound = jet(c.most(b.twist[1], *stretches), b.twist[2])
        bow = DerivativeBounds(np.zeros_like(move), wound.v * move**2 / 2, wound.v * move**2, wound.d * move**2)
        return TransportBounds(False, pulls, pairs, ease, eased, wound, bow, give)

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


# Breakpoints are sums of lengths, exact to round-off of these.
SWAPPED = 1e-9
"""Breakpoints (m) may be so much out of order at the ends of an interval, which is round-off."""

# Stiffness and torsion jump where a piece of a tube ends, and values are wanted on either side.
JUMP = 1e-9
"""So far (m) to either side of a point one looks for what jumps there."""

PARTS = 4
"""Stretches into which every section is cut to begin with."""

# Torques jump at the ends of sections where moments act.
EDGE = 1e-6
"""Share of a section by which samples at its ends lie inside: there torques may jump. Less than half of a stretch."""

SHAPE_ERROR = 1 / 96, 1 / 384
"""Error of cubic Hermite interpolation over a step h is at most these times h^3 |p'''| and h^4 |p''''| (Peano)."""

WITHIN = 1 / 6
"""At a fraction x of the step it is at most this times x^2 (1 - x)^2 h^3 |p'''|, which is the first in the middle."""


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

    @classmethod
    def of(cls, constants: Constants, equilibria: Sequence[Equilibrium], **more: Any) -> Self:
        """Those of a list of equilibria; with `more` of what bears a load."""
        sizes = [len(e.arc_length) for e in equilibria]
        return cls(
            constants=constants,
            equilibria=tuple(equilibria),
            first=np.concatenate([[0], np.cumsum(sizes)]).astype(np.intp),
            arc_length=np.concatenate([e.arc_length for e in equilibria]),
            position=np.concatenate([e.position for e in equilibria]),
            tangent=np.concatenate([e.frame[:, :, 2] for e in equilibria]),
            rotation=np.concatenate([e.rotation.T for e in equilibria]),
            torsion=np.concatenate([e.torsion.T for e in equilibria]),
            **more,
        )

    @cached_property
    def translations(self) -> Array:
        """(E, n) m."""
        return np.array([e.translations for e in self.equilibria])

    @cached_property
    def breakpoints(self) -> Array:
        """(E, C n) m."""
        return self.constants.breakpoints(self.translations)

    @property
    def places(self) -> Array:
        """(F,) arc lengths at which sections end besides, m; beyond an arm it ends there."""
        return np.zeros(0)

    @property
    def kicks(self) -> Array:
        """(P, n) by how much the torque falls at the points, N m."""
        return np.zeros(self.rotation.shape)

    @cached_property
    def _key(self) -> tuple[Array, float]:
        stride = 2.0 * float(self.arc_length.max(initial=0.0)) + 1e-3
        return self.arc_length + self.owner * stride, stride

    @cached_property
    def owner(self) -> Index:
        """(P,) equilibrium of every point."""
        return np.repeat(np.arange(len(self.equilibria)), np.diff(self.first))

    def along(self, side: float | Array, rows: Index) -> Array:
        """(6, P, n) what tubes are like at points (P,), as seen from one side: `Lengthwise.values`."""
        held = self.constants.held(self.translations)[self.owner[rows]]
        s = self.arc_length[rows, None]
        return self.constants.along.values(s - held, s + side * JUMP - held)

    @cached_property
    def _onwards(self) -> Array:
        """theta' at the points on the side away from the plate, where it jumps between pieces of a tube."""
        c, cuts = self.constants, self.breakpoints[self.owner]
        before, after = (c.stretch(self.arc_length + side * JUMP, cuts) for side in (-1, 1))
        jumps = (before != after) & (self.arc_length > JUMP)[:, None]
        jumps |= self.kicks != 0
        rows, out = np.flatnonzero(jumps.any(1)), self.torsion.copy()
        (_, kt, *_, twist, _), (_, other, *_, ahead, _) = self.along(-1, rows), self.along(1, rows)
        there, later = (stretch[rows] < c.ended for stretch in (before, after))
        onwards = ((out[rows] - twist * there) * kt - self.kicks[rows]) / other + ahead * later
        out[rows] = np.where(jumps[rows], onwards, out[rows])
        return out

    def _steps(self, which: Index, s: Array) -> tuple[Index, Index, Array, Array]:
        """Points (...) at the begin and at the end of the steps in which arc lengths (...) of equilibria (...) lie, the
        lengths of these steps, and the fractions of them."""
        key, stride = self._key
        low, high = self.first[which], np.maximum(self.first[which + 1] - 2, self.first[which])
        k = np.clip(np.searchsorted(key, s + which * stride, side="right") - 1, low, high)
        after = np.minimum(k + 1, self.first[which + 1] - 1)
        h = self.arc_length[after] - self.arc_length[k]
        x = np.where(h > 0, (s - self.arc_length[k]) / np.where(h > 0, h, 1.0), 0.0)
        return k, after, h, np.clip(x, 0.0, 1.0)

    def hermite(self, which: Index, s: Array, values: tuple[Array, Array], slopes: tuple[Array, Array]) -> Array:
        """(..., c) at arc lengths (...) of equilibria (...), from values and slopes at all points (P, c), each as seen
        from the tip and from the plate."""
        k, after, h, fraction = self._steps(which, s)
        x = fraction[..., None]
        return np.asarray(cubic(values[0][k], values[1][after], slopes[0][k], slopes[1][after], x, h[..., None]))

    def hermite_error(self, which: Index, s: Array, third: Array) -> Array:
        """(..., c) bound of the error of `hermite`, from h^3 |f'''| (P, c) in the steps that follow the points; 0 at
        the points themselves."""
        k, _, _, x = self._steps(which, s)
        share = (WITHIN * x**2 * (1 - x) ** 2)[..., None]
        with np.errstate(invalid="ignore"):  # 0 of what nothing bounds
            return np.where(share > 0, share * third[k], 0.0)

    def points(self, which: Index, s: Array) -> Array:
        """(..., 3) centreline of equilibria (...) at arc lengths (...), cubic between the points of the solution."""
        return self.hermite(which, s, (self.position, self.position), (self.tangent, self.tangent))

    def rotations(self, which: Index, s: Array) -> Array:
        """(..., n) theta of equilibria (...) at arc lengths (...)."""
        return self.hermite(which, s, (self.rotation, self.rotation), (self._onwards, self.torsion))

    @cached_property
    def inner(self) -> Index:
        """Points that are followed by another of the same equilibrium."""
        return np.flatnonzero(self.owner[1:] == self.owner[:-1])

    @cached_property
    def crossed(self) -> tuple[Index, ...]:
        """Stretches (S, n) in which what follows an `inner` point lies: where something varies, up to three."""
        c, s, cuts = self.constants, self.arc_length, self.breakpoints[self.owner[self.inner]]
        a, b = s[self.inner], s[self.inner + 1]
        if c.still:
            return (c.stretch((a + b) / 2, cuts),)
        low, high = c.stretch(a + JUMP, cuts), c.stretch(b - JUMP, cuts)
        return low, np.maximum((low + high) // 2, low), np.maximum(high, low)

    @property
    def wide(self) -> Mask:
        """(S,) whether what follows an `inner` point lies in more stretches than that."""
        return np.asarray((self.crossed[-1] - self.crossed[0] >= len(self.crossed)).any(1))

    @cached_property
    def _errors(self) -> tuple[Array, Array]:
        """`shape_error`; and h^3 |theta'''| (P, n) in the steps that follow the points.

        p'' = R (u_y, -u_x, 0), so that |p'''| <= |u|^2 + |u'| and |p''''| <= |u|^3 + 3 |u| |u'| + |u''|; and u' follows
        from torsion, which is largest at an end of a step but for what it gains in it.
        """
        c, n = self.constants, self.constants.offset.size
        out, turned = np.array([e.tip_error for e in self.equilibria]), np.zeros((len(self.arc_length), n))
        if not len(self.inner):
            return out, turned
        h, owner = np.diff(self.arc_length)[self.inner], self.owner[self.inner]
        bend, drift = CurvatureBounds.of(c, *self.crossed), TransportBounds.of(c, np.array(1.0), *self.crossed)
        most, kt = bend.pairs.sum(2), c.least(c.bounds.torsional, *self.crossed)
        torque = self._torque(h[:, None] * most)
        gain = most / kt + torque * drift.ease.d + drift.wound.v
        speed = np.maximum(np.abs(self._onwards[self.inner]), np.abs(self.torsion[self.inner + 1])) + h[:, None] * gain
        pair = speed[:, :, None] + speed[:, None, :]
        faster = ((bend.pairs * pair).sum(2) + drift.moment(pair, np.zeros(()))[0]) / kt
        if not c.still:
            faster += 2 * most * drift.ease.d + torque * drift.ease.dd + drift.wound.d
        # Tubes off the centreline: theta' = g w, whose change along the arm has that of g as well.
        wound, gain = gain, gain * (1 + c.offset * bend.most[:, None])
        u, (first, second) = bend.most, drift.bend(speed, np.zeros(()))
        du = bend.change(speed) + first
        gain += speed * c.offset * du[:, None] / (1 - c.offset * u[:, None])
        ddu = bend.second(speed, speed) + bend.change(gain) + second
        # There theta' = g w, g = 1 - d u: of both.
        least = 1 - c.offset * u[:, None]
        faster = (1 + c.offset * u[:, None]) * faster + c.offset * (
            2 * du[:, None] * wound + ddu[:, None] * speed / least
        )
        third, fourth = u**2 + du, u**3 + 3 * u * du + ddu
        error = np.minimum(SHAPE_ERROR[0] * h**3 * third, SHAPE_ERROR[1] * h**4 * fourth)
        np.maximum.at(out, owner, np.where(self.wide, np.inf, error + out[owner]))
        turned[self.inner] = np.where(self.wide[:, None], np.inf, h[:, None] ** 3 * faster)
        return out, turned

    def _torque(self, gain: Array) -> Array:
        """(S, n) the most along what follows the `inner` points, N m, on which it gains at most `gain`; 0 where nothing
        varies and none is asked for."""
        if self.constants.still:
            return np.zeros(())
        torque = []
        for side, slope, rows in ((1, self._onwards, self.inner), (-1, self.torsion, self.inner + 1)):
            _, kt, _, _, twist, _ = self.along(side, rows)
            torque.append(np.abs(slope[rows] - twist) * kt)
        return np.asarray(np.maximum(*torque) + gain)

    @property
    def shape_error(self) -> Array:
        """(E,) bound of the distance of `points` from the centreline, m: of interpolation, and as solved for."""
        return self._errors[0]

    def turn_error(self, which: Index, s: Array) -> Array:
        """(..., n) bound of the error of `rotations`, rad."""
        return self.hermite_error(which, s, self._errors[1])


@dataclass(frozen=True, eq=False)
class Intervals:
    """Neighbouring equilibria `one` and `other` (B,) of `arms`: K = C n + F sections, some without length, of which
    `begin` and `end` (B, K + 1) are the breakpoints at either; in which stretch each tube is there (B, K, n).

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
        begin, end = (arms.breakpoints[e] for e in (one, other))
        tips = np.stack([begin, end]).max(2, keepdims=True)
        a, b = (
            np.concatenate([cuts, np.minimum(arms.places, tip)], axis=1)
            for cuts, tip in zip((begin, end), tips, strict=True)
        )
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
        # Nor may the tip meet a place of the load.
        beyond = arms.places - tips
        ordered &= ~((beyond.min(0) < -SWAPPED) & (beyond.max(0) > SWAPPED)).any(1)
        tubes = (begin + end)[:, None] / 2
        stretch = arms.constants.stretch((sides[2][:, :-1] + sides[2][:, 1:]) / 2, tubes)
        return cls(arms, one, other, sides[0], sides[1], stretch, ordered)

    @cached_property
    def bending(self) -> CurvatureBounds:
        """Bounds of curvature, (B, K)."""
        return CurvatureBounds.of(self.arms.constants, self.stretch)

    @cached_property
    def moved(self) -> Array:
        """(B, K, n) by how much places at fixed fractions of sections move along each tube at most, m."""
        c, shift = self.arms.constants, self.arms.translations
        held = c.held(shift[self.other]) - c.held(shift[self.one])
        ends = np.abs((self.end - self.begin)[:, :, None] - held[:, None])
        return np.asarray(np.maximum(ends[:, :-1], ends[:, 1:]))

    @cached_property
    def drift(self) -> TransportBounds:
        """What moving along tubes that vary adds, (B, K)."""
        return TransportBounds.of(self.arms.constants, self.moved, self.stretch)

    @cached_property
    def torsional(self) -> Array:
        """(B, K, n) kt from below, N m^2."""
        return self.arms.constants.least(self.arms.constants.bounds.torsional, self.stretch)

    @cached_property
    def transmission(self) -> DerivativeBounds:
        """(B, n) of int ds / kt from where tubes are held to the plate, 1/(N m); its rate is 1 / kt in section 0."""
        c = self.arms.constants
        whole = c.along.compliant(-c.held(self.arms.translations))
        plain = linear(whole[self.one], whole[self.other])
        if self.drift.still:
            return plain
        moved = self.drift.eased.map(lambda bound: bound[:, 0] * self.moved[:, 0] ** 2)
        return DerivativeBounds(plain.v, plain.d + moved.v / 2, moved.v, moved.d)

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

    def sagitta(self, which: Index, section: Index, x: Array) -> Array:
        """(N,) how far arms bend off straight lines between fractions x (N, 2) of sections of intervals `which`, m."""
        long = np.maximum(*self.length)[which, section] * (x[:, 1] - x[:, 0])
        return np.asarray(self.bending.most[which, section] * long**2 / 8)

    @property
    def parts(self) -> tuple[tuple[Index, Array], tuple[Index, Array]]:
        """At either end equilibria and arc lengths (B, K, PARTS + 1), of the ends of PARTS stretches of a section."""
        x = np.linspace(0.0, 1.0, PARTS + 1).clip(EDGE, 1 - EDGE)
        before, after = (cuts[:, :-1, None] + x * np.diff(cuts, axis=1)[:, :, None] for cuts in (self.begin, self.end))
        one, other = (np.broadcast_to(e[:, None, None], before.shape) for e in (self.one, self.other))
        return (one, before), (other, after)

    @cached_property
    def changes(self) -> tuple[Array, Array]:
        """(B, K, n) and (B, K, n, n): by how much theta_i, and theta_i - theta_j, differ at most between both ends, at
        the ends of PARTS stretches of every section, with the errors of interpolation there."""
        one, other = self.parts
        change = self.arms.rotations(*other) - self.arms.rotations(*one)
        wrong = self.arms.turn_error(*one) + self.arms.turn_error(*other)
        pairs = np.abs(change[..., :, None] - change[..., None, :]) + wrong[..., :, None] + wrong[..., None, :]
        return (np.abs(change) + wrong).max(2), pairs.max(2)
