"""Between two equilibria under a load: that one unbroken branch of stable ones joins them, and where the arm is.

As in `branch`, joint values are linear in time t, 0 to 1, and so are the lengths h of the sections. In torques t_i
and moment m, as the coordinates kt^-1/2 t_i and K^-1/2 m whose square is the elastic form T of docs/theory-loads.md,
the equations under a dead load are g = 0,

    g = (t_i - T_i, m - M),    M = (R' m_w)_xy,    m_w = m_c + int_s^L t x n,
    T_i = sum m_k.t(s_k) - int_s^(own end) V_i' - M.a_i' / K,

m_c the sum of all moments ahead, and m_k those that act ahead on tube i. Without moments g is the gradient of the
potential energy, and g_y its second variation; with them g_y is not symmetric, and `second variation` means its
symmetric part.

Along what goes linearly from the torques and moments of the one equilibrium to those of the other, at fixed fractions
of the sections, it vanishes at both ends, so that |g| <= max |g_tt| / 8 in between. With mu the lesser margin of both,
and q0 + q1 r a bound of how far the second variation, relative to T, is from one with margin mu, in a ball of radius r
around the chord,

    (mu - q0)^2 > 2 q1 |g|

makes the energy strictly convex in a ball around the chord at all times, or g strongly monotone, with exactly one
equilibrium in it, a stable one (Newton and Kantorovich; Browder and Minty). Along the chord it is compared with that at
the end nearer in time, or with what is linear between both ends, whichever shows more. All bounds are in closed form,
of what is known of both equilibria. Where tubes vary, places at fixed fractions of sections move along them, which
changes |a_i|, K and kt: by `TransportBounds`, as in `branch`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..typing import Array, Mask
from .branch import Branch, Turn, least_root, tip_of, whirled
from .loaded_sections import LoadedIntervals
from .sections import PARTS, DerivativeBounds, linear, part, turned

SIXTH = 1 / 6
"""Share of T by which a function of time may be off a straight line, where its second derivative is at most T, and T is
linear in time and nowhere negative."""

# The first two spread a change to all tubes, torques and moments of a section, see `_changes`.
ROUNDS = 2, 6
"""Rounds in which what lies between samples is found from itself: until all has its share, and until it suffices."""


def loaded_branch(intervals: LoadedIntervals, margins: Array) -> Branch:
    """What is known between equilibria of margins (E,), `sure_margin` where there are moments."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        bounds = _Bounds(intervals)
        least = np.minimum(margins[intervals.one], margins[intervals.other])
        radius, convex, kept = bounds.ball(least)
        off = bounds.off(radius)
        rates = tip_of(bounds.long * bounds.whirl(radius, convex))
    sure = bounds.changes.sure
    unbroken = sure & kept & intervals.ordered & np.isfinite(off).all(1)
    return Branch(np.asarray(unbroken), np.where(unbroken[:, None], off, np.inf), sure, rates)


@dataclass(frozen=True, eq=False)
class _Changes:
    """By how much theta (a `Turn`), torques (B, K, n) and moments (B, K) differ at most between both ends; whether that
    is sure (B,) between samples along the arm too."""

    turn: Turn
    torque: Array
    moment: Array
    sure: Mask

    @property
    def parts(self) -> tuple[Array, Array, Array, Array]:
        """All of them."""
        return *self.turn, self.torque, self.moment

    def less(self, other: _Changes) -> list[Array]:
        """By how much all of them are more than another's."""
        return [a - b for a, b in zip(self.parts, other.parts, strict=True)]


@dataclass(frozen=True, eq=False)
class _Moved:
    """How far a configuration is from another at most: theta, the frames (B, K), rad, m_w and M (B, K), N m."""

    turn: Turn
    frame: Array
    moment: Array


class _Bounds:
    """Bounds over intervals (B,) with sections (K,) of n tubes; those of a section hold all over it."""

    def __init__(self, intervals: LoadedIntervals) -> None:
        self.intervals, self.force, b = intervals, intervals.force, intervals.bending
        self.kt, self.stiffness, self.drift = intervals.torsional, b.stiffness, intervals.drift
        self.pairs, self.slope = b.pairs, b.moment / b.stiffness[..., None]
        """|a_i||a_j| / K (B, K, n, n), and A_i = |a_i| / K (B, K, n), 1/m."""
        self.pairing = replace(self.drift.pairs, v=self.pairs)
        self.pull = replace(self.drift.pulls, v=self.slope)
        """The same where places move along tubes that vary."""
        self.long, self.spring = linear(*intervals.length), intervals.transmission
        self.lever, self.u = intervals.lever, b.most
        self.couple, (self.kick, self.along) = intervals.couple, intervals.twisting
        """|m_c| (B, K); and moments that twist a tube, at the ends of sections and per length (B, K, n)."""
        give = self.long.v[..., None] / self.kt
        own = np.sqrt(np.cumsum(give, axis=1) + self.spring.v[:, None])
        self.weight: Turn = own, np.hypot(own[..., :, None], own[..., None, :])
        """|y_i| <= weight_i, and so on, where T = 1."""
        self.swing = self._swing(give)
        """(B, K) int |psi'| up to the end of every section is at most this where T = 1."""
        size, torque, moment = intervals.loads
        bound = self.pairs.sum(3) + self.slope * self.lever[..., None] + self.along
        self.torque = size + self.long.v[..., None] * bound / (2 * PARTS)
        self.changes = self._changes(torque, moment)
        self.theta, self.pair, self.tangent, self.answer = self._chord(self.changes, self.torque)

    def _swing(self, give: Array) -> Array:
        """The most of int sum A_i |y_i| + |r| up to the end of every section where T = 1; `give` (B, K, n) is h / kt.

        Its square is int m_i^2 / kt_i + int 1 / K, with m_i int A_i from there on, linear in every section.
        """
        here = np.cumsum(self.long.v[..., None] * self.slope, axis=1)
        before = np.concatenate([np.zeros_like(here[:, :1]), here[:, :-1]], axis=1)
        high, low = (np.maximum(here[:, :, None] - each[:, None], 0.0) for each in (before, here))
        inside = give[:, None] * (high**2 + high * low + low**2) / 3
        held = self.spring.v[:, None] * here**2
        return np.asarray(np.sqrt((inside.sum(2) + held).sum(2) + np.cumsum(self.long.v / self.stiffness, axis=1)))

    def _changes(self, torque: Array, moment: Array) -> _Changes:
        """What differs between both ends, sampled, with what lies between samples.

        That is at most half of their distance times a bound L of the slope, which is affine in what differs, x. All x
        that satisfy x >= sampled + L(x) are bounds. With x_k+1 = sampled + L(x_k) one is 2 x_6 - x_2, if
        2 (x_7 - x_6) <= x_3 - x_2. The first two rounds spread a change to all tubes, torques and moments of a section.
        """
        own, pair = self.intervals.changes
        rounds = [_Changes((own, pair), torque, moment, np.ones(len(own), dtype=bool))]
        for _ in range(ROUNDS[1] + 1):
            theta, twisting, bending = self._between(rounds[-1])
            turn = own + theta, pair + _both(theta)
            rounds.append(_Changes(turn, torque + twisting, moment + bending, rounds[0].sure))
        early, late = ROUNDS
        gained, left = (rounds[k + 1].less(rounds[k]) for k in ROUNDS)
        held = [(2 * b <= a + 1e-15).reshape(len(own), -1).all(1) for a, b in zip(gained, left, strict=True)]
        first, last = rounds[early].parts, rounds[late].parts
        theta, both, twisting, bending = (2 * b - a for a, b in zip(first, last, strict=True))
        return _Changes((theta, both), twisting, bending, np.logical_and.reduce(held))

    def _between(self, c: _Changes) -> tuple[Array, Array, Array]:
        """Of theta, torques and moments: half the distance of samples times a bound of the slope of what differs."""
        h, dh, lever, du = self.long.v[..., None], self.long.d[..., None], self.lever, self._bent(c)
        known = self.intervals.arms.constants
        twist = known.most(known.bounds.twist[0], self.intervals.stretch)
        theta = dh * (self.torque / self.kt + twist) + h * c.torque / self.kt
        theta = theta + h * (self.torque * self.drift.ease.d + self.drift.wound.v * self.intervals.moved)
        twisting = self.pairs.sum(3) + self.slope * lever[..., None] + self.along
        turned = (self.pairs * c.turn[1]).sum(3)
        turned += self.slope * (c.moment[..., None] + lever[..., None] * c.turn[0])
        turned += self.drift.gain(np.ones_like(self.pairs)) + self.pull.d * lever[..., None]
        torsion, changed, along = self.torque.sum(2), c.torque.sum(2), self.along.sum(2)
        frame = np.cumsum(self.long.d * self.u + self.long.v * du, axis=1)
        turned += self.along * frame[..., None]
        moment = self.long.d * (self.u * torsion + self.force.v + along)
        moment += self.long.v * (du * torsion + self.u * changed + self.force.d + (self.force.v + along) * frame)
        share = 1 / (2 * PARTS)
        return share * theta, share * (dh * twisting + h * turned), share * moment

    def _bent(self, c: _Changes) -> Array:
        """(B, K) by how much the curvature differs."""
        by_tubes = (self.slope * c.turn[0] + self.pull.d).sum(2)
        return np.asarray(c.moment / self.stiffness + by_tubes + self.lever * self.drift.give.d)

    def _wound(self, torque: DerivativeBounds) -> DerivativeBounds:
        """(B, K, n) of theta, derivatives only, as torques twist the tubes."""
        begin = self.spring * torque.map(lambda bound: bound[:, 0])
        along = self.long.map(lambda bound: bound[..., None]) * torque * self.drift.ease
        return begin.map(lambda bound: bound[:, None]) + along.map(lambda b: np.cumsum(b, axis=1)) + self.drift.bow

    def _bends(self, theta: DerivativeBounds, moment: DerivativeBounds) -> DerivativeBounds:
        """(B, K) of h u."""
        by_tubes = (self.pull * turned(theta)).map(lambda bound: bound.sum(2))
        return self.long * replace(by_tubes + moment * self.drift.give, v=self.u)

    def _answer(
        self, theta: DerivativeBounds, pair: DerivativeBounds, tangent: DerivativeBounds
    ) -> tuple[DerivativeBounds, DerivativeBounds]:
        """T_i (B, K, n); and M, as m_w (B, K)."""
        # M(s) = int_s^L (R't) x (R'n), R of s. How far t turns against R, and R against n, makes how far t turns.
        moment = (self.long * tangent * self.force).map(_ahead) + tangent * self.couple
        by_load = turned(theta) * moment.map(lambda bound: bound[..., None])
        by_tubes = (self.pairing * turned(pair)).map(lambda bound: bound.sum(3))
        leaning = tangent.map(lambda bound: bound[..., None] * self.along)
        each = self.long.map(lambda bound: bound[..., None]) * (self.pull * by_load + by_tubes + leaning)
        return (each + tangent.map(lambda bound: bound[..., None] * self.kick)).map(_ahead), moment

    def _size(self, torque: Array, moment: Array) -> Array:
        """(B,) root of T of torques (B, K, n) and moments (B, K)."""
        inside = (torque**2 / self.kt).sum(2) + moment**2 / self.stiffness
        held = (self.spring.v * torque[:, 0] ** 2).sum(1)
        return np.asarray(np.sqrt((self.long.v * inside).sum(1) + held))

    def _chord(
        self, c: _Changes, torque: Array
    ) -> tuple[DerivativeBounds, DerivativeBounds, DerivativeBounds, tuple[DerivativeBounds, DerivativeBounds]]:
        """What goes linearly in torques, of at most `torque`, and moments, which change by c: theta, differences of
        theta, tangents, and the answer to it."""
        bow = self._wound(DerivativeBounds(torque, c.torque, np.zeros_like(c.torque))).dd
        theta, both = DerivativeBounds(np.ones_like(bow), c.turn[0] + bow / 2, bow), _both(bow)
        pair = DerivativeBounds(np.ones_like(both), c.turn[1] + both / 2, both)
        bent = self._bends(theta, DerivativeBounds(self.lever, c.moment, np.zeros_like(c.moment)))
        turn = np.cumsum(bent.d, axis=1)
        tangent = whirled(turn, np.cumsum(turn * bent.d + bent.dd, axis=1))
        return theta, pair, tangent, self._answer(theta, pair, tangent)

    def gradient(self) -> Array:
        """(B,) bound of |g| along the chord."""
        torque, moment = self.answer
        return self._size(torque.dd / 8, moment.dd / 8)

    def _response(self, size: Array) -> _Changes:
        """What torques and moments of a root of T of `size` (B,) turn, and how much T_i and M differ by that."""
        own, pair, h = self.weight[0] * size[:, None, None], self.weight[1] * size[:, None, None, None], self.long.v
        frame = self.swing * size[:, None]
        moment = _ahead(h * frame * self.force.v) + frame * self.couple.v
        by_load = self.slope * (own * self.lever[..., None] + moment[..., None])
        leaning = (h[..., None] * self.along + self.kick) * frame[..., None]
        torque = _ahead(h[..., None] * ((self.pairs * pair).sum(3) + by_load) + leaning)
        return _Changes((own, pair), torque, moment, np.ones(len(size), dtype=bool))

    def whirl(self, radius: Array, convex: Array) -> DerivativeBounds:
        """(B, K) of the tangent of the equilibria themselves, to the third derivative, where they are within `radius`
        (B,) of the chord, and the second variation is at least `convex` (B,) times T.

        With e what they are off the chord, g_y e' = -d/dt g(chord + e), e at rest, and g(chord) is 0 at both ends. What
        g_y makes of y'' and y''' is what lower derivatives make of -g.
        """
        c, (torque, moment) = self.changes, self.answer
        ball = self._response(radius)
        off = ball.torque + torque.dd / 8
        wide = _Changes(
            (c.turn[0] + ball.turn[0], c.turn[1] + ball.turn[1]),
            c.torque + off,
            c.moment + ball.moment + moment.dd / 8,
            c.sure,
        )
        # The mixed derivative by time and e: what e makes of the second one, of which it is half.
        both = self._chord(wide, self.torque + off)[3]
        twisting, bending = both[0].dd / 2, both[1].dd / 2
        first = self._response(self._size(twisting, bending) / convex)
        course = _Course.still(self)
        course.torque[0] = self.torque + off
        course.theta[1], course.pair[1] = self.theta.d + first.turn[0], self.pair.d + first.turn[1]
        course.torque[1] = c.torque + twisting + first.torque
        course.moment[1] = c.moment + bending + first.moment
        course.frame[1] = np.cumsum(self._bends(course.jet("theta"), course.jet("moment")).d, axis=1)
        self._path(course, 2, convex)
        self._path(course, 3, convex)
        return whirled(*course.frame[1:])

    def _path(self, course: _Course, order: int, convex: Array) -> None:
        """Bounds of a derivative of a course, where lower ones are known: what these make of it, where torques and
        moments have none of this order, and then what those have."""
        theta = part(self._wound(course.jet("torque")), order)
        course.theta[order], course.pair[order] = theta, _both(theta)
        bent, frame = self._bends(course.jet("theta"), course.jet("moment")), course.frame
        gain = part(bent, order) + frame[1] * bent.d
        if order == 3:
            gain = part(bent, order) + (frame[2] + frame[1] ** 2) * bent.d + 2 * frame[1] * bent.dd
        frame[order] = np.cumsum(gain, axis=1)
        made = self._answer(course.jet("theta"), course.jet("pair"), whirled(*frame[1:]))
        torque, moment = part(made[0], order), part(made[1], order)
        size = self._size(torque, moment) / convex
        more = self._response(size)
        course.theta[order], course.pair[order] = theta + more.turn[0], _both(theta) + more.turn[1]
        frame[order] = frame[order] + self.swing * size[:, None]
        course.torque[order], course.moment[order] = torque + more.torque, moment + more.moment

    def variation(self, moved: _Moved, *, stretched: bool) -> Array:
        """(B,) by how much the second variation relative to T differs; `stretched`: with sections as they are at the
        nearer end, and with the load there."""
        b, h, w, lever = self, self.long.v, self.weight, self.lever
        zero = np.zeros_like(h)
        dh, own, bend, dn = b._stretched() if stretched else (zero, np.zeros_like(w[0]), zero, zero)
        dc, da = (b.pairing.d / 2, b.pull.d / 2) if stretched else (np.zeros(()), np.zeros(()))
        pair = np.hypot(own[..., :, None], own[..., None, :])
        each = h[..., None, None] * (b.pairs * moved.turn[1] + dc) + dh[..., None, None] * b.pairs
        by_tubes = (each * w[1] ** 2 + 2 * h[..., None, None] * b.pairs * w[1] * pair).sum((1, 2, 3)) / 2
        # In the frame of a cross-section the moments that act ahead turn too.
        bending = moved.moment + self.couple.v * moved.frame
        size = h[..., None] * (bending[..., None] + lever[..., None] * moved.turn[0]) + (dh * lever)[..., None]
        size = b.slope * size + da * (h * lever)[..., None]
        by_load = (size * w[0] ** 2 + 2 * b.slope * (h * lever)[..., None] * w[0] * own).sum((1, 2))
        # By how much psi differs, and all of its way: frames, the directions of a_i, and lengths.
        way = b.slope * (h[..., None] * (w[0] * moved.turn[0] + own) + dh[..., None] * w[0]) + da * h[..., None] * w[0]
        differs = moved.frame * b.swing + np.cumsum(way.sum(2), axis=1) + bend
        whole, far = b.swing[:, -1], differs[:, -1]
        # Both are running totals P and D: int |psi||psi'| is at most P^2 / 2, and int D dP + P dD is P D.
        by_turns = moved.moment.max(1) * whole**2 / 2 + lever[:, 0] * whole * far
        n = b.force.v
        form = (h * (dn + n * moved.frame) + dh * n) * b.swing**2 + 2 * h * n * b.swing * differs
        # Of the torques of moments, m.(psi x t) y.
        acts = h[..., None] * b.along + b.kick
        twist = acts * (w[0] * (moved.frame * b.swing + differs)[..., None] + b.swing[..., None] * own)
        twist += (dh * b.swing)[..., None] * b.along * w[0]
        return np.asarray(by_tubes + by_load + by_turns + form.sum(1) + twist.sum((1, 2)))

    def curving(self) -> Array:
        """(B,) bound of how far the second variation relative to T is, along the chord, below what is linear in time
        between both ends: `SIXTH` of a bound of its second derivative by time, at fixed torques and moments. Infinite
        where tubes vary, whose T is not linear in time. See "Between loaded equilibria" in docs/theory-proofs.md."""
        if not self.drift.still:
            return np.full(len(self.lever), np.inf)
        h, none = self.long, np.zeros_like(self.long.v)
        begin, end = self.intervals.length
        # Squares of the changes of y, of int h r and of the transmissions where T = 1.
        grown, held = _over(h.d, np.minimum(begin, end)), _over(self.spring.d, self.spring.v - self.spring.d)
        own = np.sqrt(np.cumsum(grown[..., None] / self.kt, axis=1) + held[:, None])
        bent = np.cumsum(h.v / self.stiffness, axis=1), np.cumsum(grown / self.stiffness, axis=1)
        y = DerivativeBounds(self.weight[0], own, np.zeros_like(own))
        pair = DerivativeBounds(
            self.weight[1], np.hypot(own[..., :, None], own[..., None, :]), np.zeros_like(self.weight[1])
        )
        theta, both, tangent, moment = self.theta, self.pair, self.tangent, self.answer[1]
        by_tubes = (self.pairing * turned(both) * pair * pair).map(lambda bound: bound.sum((2, 3)) / 2)
        pulled = self.pull * turned(theta)
        by_load = (pulled * moment.map(lambda bound: bound[..., None]) * y * y).map(lambda bound: bound.sum(2))
        # Of psi: by the turns of the tubes, and by the moments.
        swing = (tangent * h * (pulled * y).map(lambda bound: bound.sum(2))).map(lambda b: np.cumsum(b, axis=1))
        swing = replace(swing + tangent * DerivativeBounds(np.sqrt(bent[0]), np.sqrt(bent[1]), none), v=self.swing)
        # By parts m_w.(psi x psi') is half of what n makes of |psi|^2, beside n.(psi x (psi x e)).
        by_turns = (tangent * self.force * swing * swing).map(lambda bound: 1.5 * bound)
        by_forces = (h * (by_tubes + by_load + by_turns)).dd.sum(1)
        # Of the moments that act ahead the same half is of what falls away from section to section.
        falls = self.couple.map(lambda bound: (bound - np.append(bound[:, 1:], np.zeros((len(bound), 1)), axis=1)) / 2)
        acts = h.map(lambda bound: bound[..., None] * self.along)
        acts = replace(acts, v=acts.v + self.kick)
        twist = acts * (tangent * swing).map(lambda bound: bound[..., None]) * y
        by_couples = (falls * swing * swing).dd.sum(1) + twist.dd.sum((1, 2))
        return np.asarray(SIXTH * (by_forces + by_couples))

    def _stretched(self) -> tuple[Array, Array, Array, Array]:
        """Between the chord and its nearer end: h (B, K), y_i (B, K, n) and int h r (B, K) at equal coordinates, n."""
        root, spring = _roots(*self.intervals.length), self.spring
        twisting, bending = self._easier()
        one = root[..., None] / np.sqrt(self.kt) + np.sqrt(self.long.v)[..., None] * twisting
        held = _roots(np.maximum(spring.v - spring.d, 0.0), spring.v) + np.sqrt(spring.dd / 8)
        own = np.sqrt(np.cumsum(one**2, axis=1) + held[:, None] ** 2)
        two = root / np.sqrt(self.stiffness) + np.sqrt(self.long.v) * bending
        return self.long.d / 2, own, np.sqrt(np.cumsum(two**2, axis=1)), self.force.d / 2

    def _easier(self) -> tuple[Array, Array]:
        """By how much the square roots of 1 / kt (B, K, n) and 1 / K (B, K) differ from those at the nearer end: half
        of the time, and a root changes by what its square does, over twice the least of it."""
        if self.drift.still:
            return np.zeros(()), np.zeros(())
        c, stretch = self.intervals.arms.constants, self.intervals.stretch
        kb, kt = (c.most(most, stretch) for most in c.bounds.stiffest)
        return self.drift.ease.d * np.sqrt(kt) / 4, self.drift.give.d * np.sqrt(kb.sum(-1)) / 4

    def ball(self, margin: Array) -> tuple[Array, Array, Mask]:
        """(B,) radius of the ball in which the equilibria are, the least of the second variation over T in it, and
        whether that is more than 0."""
        # How far the chord is from its nearer end; and what is in a ball from its centre, per its radius.
        forces = (self.long * self.tangent * self.force).map(_ahead)
        by_time = _Moved((self.theta.d / 2, self.pair.d / 2), self.tangent.d / 2, (forces.d + self.couple.d) / 2)
        each = self.long.v * self.force.v * self.swing
        by_ball = _Moved(self.weight, self.swing, np.cumsum(each[:, ::-1], axis=1)[:, ::-1])
        q = np.fmin(self.variation(by_time, stretched=True), self.curving())
        bow = self.variation(by_ball, stretched=False)
        first, left = self.gradient(), margin - q
        radius, kept = least_root(first, left, bow)
        return radius, np.asarray(left - bow * radius), kept

    def off(self, radius: Array) -> Array:
        """(B, K) bound of the distance of a point from the straight line between its places at both ends, m."""
        second = 2 * self.long.d * self.tangent.d + self.long.v * self.tangent.dd
        lever = self.long.v * self.swing * radius[:, None]
        return np.asarray(np.cumsum(second / 8 + lever, axis=1))


@dataclass(frozen=True, eq=False)
class _Course:
    """Sizes (0) and derivatives (1 to 3) by time of theta_i and theta_i - theta_j, of torques, moments, and the frames:
    of these how fast they turn (1), and two derivatives of that."""

    theta: list[Array]
    pair: list[Array]
    torque: list[Array]
    moment: list[Array]
    frame: list[Array]

    @staticmethod
    def still(of: _Bounds) -> _Course:
        """One at rest."""
        sizes = np.ones_like(of.torque), np.ones_like(of.pairs), of.torque, of.lever, np.ones_like(of.lever)
        return _Course(*([size, *(np.zeros_like(size) for _ in range(3))] for size in sizes))

    def jet(self, name: str) -> DerivativeBounds:
        """One of them."""
        return DerivativeBounds(*getattr(self, name))


def _over(change: Array, least: Array) -> Array:
    """Squares of changes over what there is at least, which may be nothing; 0 where nothing changes."""
    return np.asarray(change**2 / np.maximum(least, 1e-300))


def _ahead(bound: Array) -> Array:
    """Sums over the sections from each on, to the tip."""
    return np.cumsum(bound[:, ::-1], axis=1)[:, ::-1]


def _both(own: Array) -> Array:
    """Bounds of theta_i as those of their differences."""
    return own[..., :, None] + own[..., None, :]


def _roots(one: Array, other: Array) -> Array:
    """By how much the square root of what is linear in time differs at most from that at the nearer end."""
    middle = np.sqrt((one + other) / 2)
    return np.asarray(np.maximum(np.abs(middle - np.sqrt(one)), np.abs(middle - np.sqrt(other))))
