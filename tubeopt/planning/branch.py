"""Between two equilibria: that one unbroken branch of stable equilibria joins them, and where the arm is on the way.

Between them joint values are linear in time t, 0 to 1. theta~ is what goes linearly from the one to the other at fixed
fractions of the sections, whose lengths are linear in t. It all but solves the equations

    F(theta, t) = theta - alpha - |beta| w(0) - int h g w = 0,    w = - int_s h M(theta) / kt   (to the tip),

since F(theta~, t) is 0 at both ends: in between |F| <= max |F_tt| / 8, which is of second order in the step. With
A = DF(theta_0)^-1, of norm 1 / mu in the norm of torsional energy (mu: the margin), theta~ + e solves them where

    e = e - A F(theta~ + e):    |e| <= |A F(theta~)| + q |e|,    q = |A (DF(theta_0) - DF(theta~ + e, t))|.

Where the right-hand side maps a ball into itself and q < 1 (Newton and Kantorovich), the ball holds exactly one
solution for every t, on which DF is never singular: no fold, no crossing, and no loss of stability in between. The
half of the time nearer to the other end is reached from there. Every bound is in closed form and holds for all
rotations. Then, |u| being known to within what e and curved paths of theta make of it, the points of the arm are no
farther than `off` from the straight line between where they are at both ends.

Of tubes made of pieces theta~ is linear but for their natural turn, which is known: it is added to both sides of F = 0.
Along arcs and helices of constant stiffness it is linear too, and nothing else changes. Where precurvature or stiffness
varies along a tube, a place at a fixed fraction of a section moves along it, by no more than `Intervals.moved`; what
that adds to the derivatives by time of moments, of u and of 1 / kt is `TransportBounds`. All else is as for the least
stiffness and the largest bend of each section.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from ..typing import Array, Mask
from .sections import PARTS, DerivativeBounds, Intervals, inverse, linear, part, turned

Turn = tuple[Array, Array]
"""Bounds (B, K, n) of the changes of theta_i in every section, and (B, K, n, n) of theta_i - theta_j."""

Course = tuple[DerivativeBounds, DerivativeBounds]
"""The same of their derivatives by time."""


@dataclass(frozen=True, eq=False)
class Branch:
    """What is known between neighbouring equilibria."""

    unbroken: Mask
    """(B,) whether one stable branch joins them."""
    off: Array
    """(B, K) by how much, m, a point in a section may be off the straight line between its places at both ends."""
    turned: Mask
    """(B,) whether the turn of the tubes is bounded between its samples along the arm, which shorter intervals hardly
    help."""
    rates: Array
    """(2, B) bounds of the second and third derivative of the tip by time, m, where one stable branch joins the
    equilibria; infinite where nothing bounds them."""


def branch(intervals: Intervals, stiffness: Array) -> Branch:
    """What is known between equilibria whose linearised equations have least singular values `stiffness` (E,)."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        found = _Bounds(intervals, np.minimum(stiffness[intervals.one], stiffness[intervals.other]))
        turn, sure = found.turn()
        ball, kept = found.ball(turn)
        unbroken = sure & kept & intervals.ordered
        off = found.off(turn, ball.radius[:, None, None] * found.weight[0])
        rates = tip_of(found.long * found.whirl(turn, ball))
    return Branch(np.asarray(unbroken & np.isfinite(off).all(1)), np.where(unbroken[:, None], off, np.inf), sure, rates)


def least_root(first: Array, left: Array, bow: Array) -> tuple[Array, Mask]:
    """(B,) the least r with left r = first + bow r^2 / 2, and whether there is one (Newton and Kantorovich)."""
    root = left**2 - 2 * bow * first
    # The smaller root of bow r^2 / 2 - left r + first = 0. In this form nothing cancels where bow is small.
    radius = 2 * first / (left + np.sqrt(np.maximum(root, 0.0)))
    return np.asarray(radius), np.asarray((left > 0) & (root > 0))


def whirled(w: Array, spin: Array, jerk: Array | None = None) -> DerivativeBounds:
    """Of what turns at phi, and so of the tangent, where |phi|, |phi'| and maybe |phi''| have these bounds."""
    # With t' = w x t: t'' = w' x t + w x (w x t), and t''' has w'', three products of w and w', and w three times.
    return DerivativeBounds(np.ones_like(w), w, spin + w**2, None if jerk is None else jerk + 3 * w * spin + w**3)


def tip_of(sections: DerivativeBounds) -> Array:
    """(2, B) of the second and third derivative of the tip, of those of sections (B, K)."""
    assert sections.ddd is not None
    found = np.stack([sections.dd.sum(1), sections.ddd.sum(1)])
    return np.where(np.isfinite(found), found, np.inf)


def _ends(gain: Array) -> Array:
    """(2, B, K) at both ends of every section, of what gains (B, K) in it."""
    total = np.cumsum(gain, axis=1)
    return np.stack([total - gain, total])


@dataclass(frozen=True, eq=False)
class _Ball:
    """Around theta~, (B,), in units of `weight`: its radius; |A F_tt| along theta~; what A DF changes by in the time;
    and how much less than 1 nothing in it is stretched by A DF."""

    radius: Array
    bow: Array
    drift: Array
    stretch: Array


class _Bounds:
    """Bounds over intervals (B,) with sections (K,) of n tubes; those of a section hold all over it."""

    def __init__(self, intervals: Intervals, stiffness: Array) -> None:
        self.intervals, self.bending, self.stiffness = intervals, intervals.bending, stiffness
        self.drift, self.offset = intervals.drift, intervals.arms.constants.offset
        self.ease, self.long = self.drift.ease, linear(*intervals.length)
        """1 / kt (B, K, n); h (B, K)."""
        self.transmission = intervals.transmission
        # Cauchy and Schwarz: y_i(s) = int y_i' <= sqrt(int 1 / kt_i) sqrt(int kt_i y_i'^2). Energies of two tubes add,
        # so that their bounds add as squares.
        reach = [np.cumsum(length[..., None] * self.ease.v, axis=1) for length in intervals.length]
        own = np.sqrt(np.maximum(*reach) + self.transmission.v[:, None])
        self.weight: Turn = own, np.hypot(own[..., :, None], own[..., None, :])
        """|y_i| <= sqrt((|beta_i| + s) / kt_i) and so on, for |y| = 1 in the norm of torsional energy."""
        self.torque = self.bending.pairs.sum(3)
        pairs, pulls, b = self.drift.pairs, self.drift.pulls, self.bending
        self.pairing = DerivativeBounds(b.pairs, pairs.d, pairs.dd, pairs.ddd)
        self.pull = DerivativeBounds(b.moment / b.stiffness[..., None], pulls.d, pulls.dd, pulls.ddd)
        """m_i m_j / k (B, K, n, n) and m_i / k (B, K, n), where places move along tubes that vary."""
        self.zero = np.zeros_like(self.torque)

    def steps(self) -> DerivativeBounds:
        """(B, K, 1) lengths of the pieces."""
        return self.long.map(lambda bound: bound[..., None])

    def torque_change(self, turn: Turn) -> Array:
        """(B, K, n) of the moment M where theta changes."""
        b = self.bending
        # M_i = sum_j m_i m_j sin(theta_i - theta_j) / k(u): a sine changes by no more than its angle, and k changes
        # with u.
        k = b.slope * b.change(turn[0])
        return np.asarray((b.pairs * turn[1]).sum(3) + self.torque * (k / b.stiffness)[..., None])

    def torque_second(self, one: Turn, other: Turn) -> Array:
        """(B, K, n) second derivative of M in two directions."""
        b = self.bending
        u = b.change(one[0]), b.change(other[0])
        k = [b.slope * each / b.stiffness for each in u]
        # Product and quotient rule for S / k, with sine and cosine at most 1; kk is k'' / k.
        kk = (b.slope * b.second(one[0], other[0]) + b.bow * u[0] * u[1]) / b.stiffness
        mixed = (b.pairs * one[1]).sum(3) * k[1][..., None] + (b.pairs * other[1]).sum(3) * k[0][..., None]
        return np.asarray(
            (b.pairs * one[1] * other[1]).sum(3) + mixed + self.torque * (kk + 2 * k[0] * k[1])[..., None]
        )

    def chord(self, turn: Turn) -> Course:
        """That of theta~."""
        bow = self.drift.bow.dd
        return DerivativeBounds(turn[0], turn[0], bow), DerivativeBounds(turn[1], turn[1], _both(bow)[1])

    def cross_sections(self, course: Course) -> tuple[DerivativeBounds, DerivativeBounds]:
        """(B, K, n) of the moment M, and (B, K) of u, along a course."""
        bent, k = self.bending.along((self.pull * turned(course[0])).map(lambda bound: bound.sum(2)))
        moment = (self.pairing * turned(course[1])).map(lambda bound: bound.sum(3))
        return (moment * inverse(k).map(lambda bound: bound[..., None]) if self.offset.any() else moment), bent

    def torques(self, moment: DerivativeBounds) -> tuple[DerivativeBounds, DerivativeBounds]:
        """(B, K, n) what tubes bear at both ends of every section, N m, of moments with these bounds."""
        gain = self.steps() * moment
        # A tube bears no torque at its tip. Elsewhere it bears the sum of the moments ahead.
        begin = gain.map(lambda bound: np.cumsum(bound[:, ::-1], axis=1)[:, ::-1])
        less = None if begin.ddd is None or gain.ddd is None else begin.ddd - gain.ddd
        return begin, DerivativeBounds(begin.v - gain.v, begin.d - gain.d, begin.dd - gain.dd, less)

    def rotation(self, moment: DerivativeBounds, stretch: DerivativeBounds) -> DerivativeBounds:
        """|beta| w(0) + int h (1 + stretch) w (B, K, n) at the end of every section, and so all over it."""
        begin, end = self.torques(moment)
        mean = (begin + end).map(lambda bound: bound / 2)
        one = replace(stretch, v=1 + stretch.v)
        along = (self.steps() * (one * mean * self.ease)).map(lambda bound: np.cumsum(bound, axis=1))
        base = self.transmission * begin.map(lambda bound: bound[:, 0])
        return along + base.map(lambda bound: bound[:, None])

    def _stretch(self, u: Array) -> Array:
        return np.asarray(self.offset * u[..., None])

    def energy(self, turn: Turn) -> Array:
        """(B,) norm, in torsional energy, of (DF - 1) of what turns theta by at most this."""
        begin, end = self.torques(DerivativeBounds(self.torque_change(turn), self.zero, self.zero))
        whole = self.torques(DerivativeBounds(self.torque, self.zero, self.zero))[0].v
        # Off the centreline a tube is longer than the arm, by g = 1 + d u.a.
        grown = 1 + self._stretch(self.bending.most)
        more = self._stretch(self.bending.change(turn[0])) * whole
        a, b = grown * begin.v + more, grown * end.v + more
        # The torque is linear from a to b along a section: int (a + (b - a) x)^2 dx = (a^2 + a b + b^2) / 3.
        along = (self.long.v[..., None] * self.ease.v * (a**2 + a * b + b**2) / 3).sum((1, 2))
        held = (self.transmission.v * begin.v[:, 0] ** 2).sum(1)
        return np.asarray(np.sqrt(along + held))

    def response(self, turn: Turn) -> Turn:
        """A f of an f that turns theta by at most this: f, and what it calls forth."""
        # A = 1 + A (1 - DF): the second part has a bound in energy, in which A has the norm 1 / mu.
        size = (self.energy(turn) / self.stiffness)[:, None, None]
        return turn[0] + size * self.weight[0], turn[1] + size[..., None] * self.weight[1]

    def norm(self, turn: Turn) -> Array:
        """(B,) the least factor of `weight` that is as much as this in all sections of any length."""
        there = self.long.v[..., None] > 0
        own = np.where(there & (turn[0] > 0), turn[0] / self.weight[0], 0.0).max((1, 2), initial=0.0)
        pair = np.where(there[..., None] & (turn[1] > 0), turn[1] / self.weight[1], 0.0).max((1, 2, 3), initial=0.0)
        return np.asarray(np.maximum(own, pair))

    def turn(self) -> tuple[Turn, Mask]:
        """By how much theta differs between both ends, sampled, with what lies between samples: a function differs from
        its chord by at most an eighth of the square of their distance times its second derivative."""
        own, pair = self.intervals.changes
        # The natural turn is not quite linear in time.
        least = _both(self.drift.bow.d)
        own, pair = own + least[0], pair + least[1]
        more = self._between((own, pair))
        wide = own + 2 * more, pair + 2 * _both(more)[1]
        # The bound is linear in what it bounds: if it holds for more than it gives, it holds.
        sure = (self._between(wide) <= 2 * more + 1e-15).all((1, 2))
        return wide, np.asarray(sure)

    def _between(self, turn: Turn) -> Array:
        """(B, K, n) an eighth of the square of a stretch times the change of d^2 theta / dx^2 = h d (h g w) / ds."""
        h, (moment, _) = self.steps(), self.cross_sections(self.chord(turn))
        u, du = self.bending.most, self.bending.change(turn[0])
        g = DerivativeBounds(1 + self._stretch(u), self._stretch(du), self.zero)
        second = h * h * g * moment * self.ease
        if not self.drift.still:
            second = second + h * h * (self.torques(moment)[0] * self.drift.eased + self.drift.wound)
        if self.offset.any():
            w = self.torques(moment)[0] * self.ease
            speed = h * g * w
            bent = DerivativeBounds(
                self.bending.change(speed.v), self.bending.second(turn[0], speed.v), np.zeros_like(u)
            )
            bent = DerivativeBounds(bent.v, bent.d + self.bending.change(speed.d), bent.dd)
            second = second + h * w * bent.map(self._stretch)
        return np.asarray(second.d / (8 * PARTS**2))

    def ball(self, turn: Turn) -> tuple[_Ball, Mask]:
        """That in which e is, and (B,) whether it is mapped into itself."""
        b, du = self.bending, np.zeros_like(self.bending.most)
        moment, bent = self.cross_sections(self.chord(turn))
        # F(theta~, t) is 0 at both ends, so that in between it is at most max |F_tt| / 8.
        residual = self.rotation(moment, bent.map(self._stretch)).dd / 8
        first = self.norm(self.response(_both(residual)))
        # What DF(theta~, t) - DF(theta_0) makes of |y| <= weight by half of the time, and what e adds to it per unit.
        added = []
        for by, moving in ((turn, True), (self.weight, False)):
            y = self.weight
            dy, ddy = b.change(y[0]), b.second(y[0], by[0])
            drifting = self.drift.gain(y[1]) if moving else 0.0
            varied = DerivativeBounds(self.torque_change(y), self.torque_second(y, by) + drifting, self.zero)
            gained = DerivativeBounds(dy, ddy, du).map(self._stretch)
            made = self._varied(varied, gained, by, moving)
            added.append(self.norm(self.response(_both(made))))
        # Half, since each end reaches to the middle of the time only.
        q, bow = added[0] / 2, added[1]
        radius, kept = least_root(first, 1 - q, bow)
        # `first` has an eighth of F_tt.
        return _Ball(radius, 8 * first, added[0], 1 - q - bow * radius), kept

    def course(self, turn: Turn, ball: _Ball) -> Course:
        """That of theta, to the third derivative.

        DF e' = -d/dt F(theta~ + e, t), e at rest, and F(theta~, t) is 0 at both ends; DF e'' and DF e''' are what lower
        derivatives make of -F_tt and -F_ttt.
        """
        own = self.weight[0]
        # A function that is 0 at both ends has a slope of at most half of its largest second derivative.
        first = ((ball.bow / 2 + ball.drift * ball.radius) / ball.stretch)[:, None, None]
        orders = [turn[0] + first * own, part(self.drift.bow, 2), part(self.drift.bow, 3)]
        pairs = [turn[1] + first[..., None] * self.weight[1], *(_both(each)[1] for each in orders[1:])]
        for order in (1, 2):
            moment, bent = self.cross_sections((DerivativeBounds(own, *orders), DerivativeBounds(own, *pairs)))
            along = self.rotation(moment, bent.map(self._stretch))
            size = (self.norm(self.response(_both(part(along, order + 1)))) / ball.stretch)[:, None, None]
            orders[order] = orders[order] + size * own
            pairs[order] = pairs[order] + size[..., None] * self.weight[1]
        return DerivativeBounds(own, *orders), DerivativeBounds(own, *pairs)

    def whirl(self, turn: Turn, ball: _Ball) -> DerivativeBounds:
        """(B, K) of the tangent of the equilibria themselves, to the third derivative."""
        bent = self.long * self.cross_sections(self.course(turn, ball))[1]
        assert bent.ddd is not None
        # Bounds are convex along a section, so that their mean there is no more than that of both ends.
        w = _ends(bent.d)
        spin = _ends(w.mean(0) * bent.d + bent.dd)
        jerk = _ends((spin + w**2).mean(0) * bent.d + 2 * w.mean(0) * bent.dd + bent.ddd)
        return whirled(w, spin, jerk).map(lambda bound: bound.mean(0))

    def _varied(self, varied: DerivativeBounds, gained: DerivativeBounds, by: Turn, moving: bool) -> Array:
        """(B, K, n) first derivative, as theta turns `by` (and sections and transmissions move), of DF - 1 applied to
        what changes moments by `varied` and stretch by `gained`."""
        b, still = self.bending, self if moving else self._still()
        plain = DerivativeBounds(self._stretch(b.most), self._stretch(b.change(by[0])), self.zero)
        made = still.rotation(varied, plain).d
        if self.offset.any():
            twist = still.torques(DerivativeBounds(self.torque, self.torque_change(by), self.zero))[0] * still.ease
            made = made + (still.steps() * gained * twist).map(lambda bound: np.cumsum(bound, axis=1)).d
        return np.asarray(made)

    def _still(self) -> _Bounds:
        """The same with sections and transmissions at rest."""
        other = copy(self)
        other.long, other.transmission, other.ease = (
            DerivativeBounds(jet.v, np.zeros_like(jet.v), np.zeros_like(jet.v))
            for jet in (self.long, self.transmission, self.ease)
        )
        return other

    def off(self, turn: Turn, error: Array) -> Array:
        """(B, K) bound of the distance of a point from the straight line between its places at both ends, m.

        With U = h u and phi the turn of the frame, phi_s = R U_t: |P_tt| <= int 2 |h_t| W + h (Phi + W^2), where W
        bounds |phi| and Phi its derivative; an eighth of it is off the line. What e makes of u adds its lever.
        """
        b, h = self.bending, self.long
        bent = h * self.cross_sections(self.chord(turn))[1]
        w = np.cumsum(bent.d, axis=1)
        w0 = w - bent.d
        phi = np.cumsum((w + w0) / 2 * bent.d + bent.dd, axis=1)
        phi0 = np.concatenate([np.zeros_like(phi[:, :1]), phi[:, :-1]], axis=1)
        # Means over a section, along which the bounds grow linearly: of 2 W, w + w0; of W^2, (w^2 + w w0 + w0^2) / 3.
        second = h.d * (w + w0) + h.v * ((phi + phi0) / 2 + (w**2 + w * w0 + w0**2) / 3)
        wrong = b.change(error)
        slope = np.cumsum(h.v * wrong, axis=1)
        lever = h.v * (slope - h.v * wrong / 2)
        return np.asarray(np.cumsum(second / 8 + lever, axis=1))


def _both(own: Array) -> Turn:
    """Bounds of theta_i as those of their differences."""
    return own, own[..., :, None] + own[..., None, :] if own.ndim else own
