"""Bounds between two equilibria under a load: proof that one stable branch joins them, and of the arm in between.

As in `branch`, joint values are linear in time t, 0 to 1, and so are the lengths h of the sections. In torques t_i
and moment m, as the coordinates kt^-1/2 t_i and K^-1/2 m whose square is the elastic form T of docs/theory-loads.md,
the equations under a dead load are g = 0,

    g = (t_i - T_i, m - M),    M = (R' m_w)_xy,    m_w = m_c + int_s^L t x n,
    T_i = sum m_k.t(s_k) - int_s^(own end) V_i' - M.a_i' / K,

m_c the sum of all applied moments between s and the tip, and m_k those of them that act on tube i. Without applied
moments g is the gradient of the potential energy, and g_y its second variation; with them g_y is not symmetric, and
"second variation" means its symmetric part.

The chord goes linearly from the torques and moments of one equilibrium to those of the other, at fixed fractions of the
sections. On it g vanishes at both ends, so that |g| <= max |g_tt| / 8 in between. With mu the smaller margin of both,
and q0 + q1 r a bound on the distance of the second variation, relative to T, from one with margin mu, in a ball of
radius r around the chord,

    (mu - q0)^2 > 2 q1 |g|

makes the energy strictly convex (g strongly monotone) in a ball around the chord at all times, with exactly one
equilibrium in it, which is stable (Newton and Kantorovich; Browder and Minty). Along the chord the second variation is
compared with that at the end nearer in time, or with the one linear between both ends, whichever gives the better
bound. All bounds are in closed form. Where tubes vary, points at fixed fractions of sections move along them, which
changes |a_i|, K and kt: by `TransportBounds`, as in `branch`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..typing import Array, Mask
from .branch import AngleChange, ProvedBranch, least_root, rotating_tangent, tip_derivatives
from .loaded_sections import LoadedIntervals
from .sections import PARTS, DerivativeBounds, linear, pair_differences, unit_vector

# f - chord = -int G f'' with Green's function G: for |f''| <= T, T linear in time, at most T / 6 at each time, which is
# approached at an end where T vanishes (for constant T: T / 8).
CHORD_ERROR = 1 / 6
"""Largest distance of a function f of time from its chord, relative to T, for |f''| <= T.

T is linear in time, T >= 0.
"""

# Two rounds spread a change to all tubes, torques and moments of a section; six make the series small, see `_changes`.
ROUNDS = 2, 6
"""Rounds of the fixed-point iteration for changes between samples: the reference round, and the last one."""


def loaded_branch(intervals: LoadedIntervals, margins: Array) -> ProvedBranch:
    """Proof results for intervals; `margins` (E,): margins of the equilibria, `sure_margin` under moments."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        bounds = _Bounds(intervals)
        ball = bounds.ball(np.minimum(margins[intervals.start], margins[intervals.end]))
        error = bounds.chord_error(ball.radius)
        rates = tip_derivatives(bounds.length * bounds.tangent_derivatives(ball.radius, ball.convexity))
    bounded = bounds.changes.valid
    unbroken = bounded & ball.exists & intervals.ordered & np.isfinite(error).all(1)
    return ProvedBranch(np.asarray(unbroken), np.where(unbroken[:, None], error, np.inf), bounded, rates)


@dataclass(frozen=True, eq=False)
class _Changes:
    """Bounds on the differences between both ends."""

    angle: AngleChange
    torque: Array
    """(B, K, n) bound on the change of the torques, N m."""
    moment: Array
    """(B, K) bound on the change of the bending moment, N m."""
    valid: Mask
    """(B,) True where the bounds hold between samples along the arm too."""

    @property
    def parts(self) -> list[Array]:
        """Bounds on the rotations, their differences between tubes, torques (N m) and moments (N m)."""
        return [*self.angle, self.torque, self.moment]


@dataclass(frozen=True, eq=False)
class _Displacement:
    """Bounds on the differences between two configurations."""

    angle: AngleChange
    frame: Array
    """(B, K) rotation of the cross-sections, rad."""
    moment: Array
    """(B, K) bound on the moment m_w in world axes and on the bending moment M, N m."""


@dataclass(frozen=True, eq=False)
class _Samples:
    """Bounds on the changes between samples along the arm."""

    theta: Array
    """(B, K, n) bound on the change of theta between samples, rad."""
    torque: Array
    """(B, K, n) bound on the change of the torques between samples, N m."""
    moment: Array
    """(B, K) bound on the change of the bending moment between samples, N m."""


@dataclass(frozen=True, eq=False)
class _Chord:
    """Bounds, with time derivatives, along the chord of torques and moments."""

    theta: DerivativeBounds
    """(B, K, n) rotations of the tubes."""
    pair: DerivativeBounds
    """Bounds (B, K, n, n) on theta_i - theta_j."""
    tangent: DerivativeBounds
    """(B, K) unit tangents of the centreline."""
    torque: DerivativeBounds
    """(B, K, n) torques T_i of the tubes, from equilibrium with the load, N m."""
    moment: DerivativeBounds
    """(B, K) bending moment M of the arm, from equilibrium with the load, N m."""


@dataclass(frozen=True, eq=False)
class _Ball:
    """Ball around the chord that contains the equilibria; arrays (B,)."""

    radius: Array
    convexity: Array
    """Lower bound on the second variation over T in the ball."""
    exists: Mask


@dataclass(frozen=True, eq=False)
class _GeometryChange:
    """Differences between the chord and its nearer end, at constant torques and moments."""

    h: Array
    """(B, K) section lengths, m."""
    y: Array
    """(B, K, n) rotations of tubes where T = 1."""
    bending: Array
    """(B, K) bound on the integral of h |r| where T = 1."""
    force: Array
    """(B, K) force on the cross-sections, N."""


class _Bounds:
    """Bounds over B intervals with K sections of n tubes; a bound of a section is valid everywhere in it."""

    def __init__(self, intervals: LoadedIntervals) -> None:
        self.intervals, self.force, b = intervals, intervals.force, intervals.bending
        self.kt, self.stiffness, self.transport = intervals.torsional, b.stiffness, intervals.transport
        self.pairs, self.slope = b.pairs, b.moment / b.stiffness[..., None]
        """Couplings |a_i||a_j| / K (B, K, n, n), and slopes A_i = |a_i| / K (B, K, n), 1/m."""
        self.pairing = replace(self.transport.pairs, v=self.pairs)
        self.natural_curvature = replace(self.transport.natural_curvature, v=self.slope)
        """`pairs` and `slope` with their changes along tubes that vary."""
        self.length, self.spring = linear(*intervals.length), intervals.transmission
        self.lever, self.u = intervals.lever, b.max_u
        self.couple, (self.kick, self.along) = intervals.couple, intervals.twisting
        """Bounds on |m_c| (B, K); moments that twist a tube, at the ends of sections and per length (B, K, n)."""
        compliance = self.length.v[..., None] / self.kt
        # Cauchy-Schwarz, as in `branch`: |y_i| <= sqrt(int 1 / kt_i) where T = 1.
        single = np.sqrt(np.cumsum(compliance, axis=1) + self.spring.v[:, None])
        self.weight: AngleChange = single, np.hypot(single[..., :, None], single[..., None, :])
        """Bounds on |y_i| and |y_i - y_j| where T = 1."""
        self.swing = self._swing(compliance)
        """(B, K) bound on int |psi'| up to the end of every section where T = 1."""
        loads = intervals.loads
        slope = self.pairs.sum(3) + self.slope * self.lever[..., None] + self.along
        # Half of the sample distance times a bound on the slope of the torque.
        self.torque = loads.torque + self.length.v[..., None] * slope / (2 * PARTS)
        self.changes = self._changes(loads.torque_change, loads.moment_change)
        self.chord = self._chord(self.changes, self.torque)

    def _swing(self, compliance: Array) -> Array:
        """(B, K) maximum of int sum A_i |y_i| + |r| up to the end of every section where T = 1.

        By Cauchy-Schwarz its square is int m_i^2 / kt_i + int 1 / K, where m_i, the integral of A_i from a point to
        that end, is linear in every section. `compliance` (B, K, n): h / kt.
        """
        to_end = np.cumsum(self.length.v[..., None] * self.slope, axis=1)
        to_start = np.concatenate([np.zeros_like(to_end[:, :1]), to_end[:, :-1]], axis=1)
        high, low = (np.maximum(to_end[:, :, None] - each[:, None], 0.0) for each in (to_start, to_end))
        inside = compliance[:, None] * (high**2 + high * low + low**2) / 3
        transmissions = self.spring.v[:, None] * to_end**2
        bending = np.cumsum(self.length.v / self.stiffness, axis=1)
        return np.asarray(np.sqrt((inside.sum(2) + transmissions).sum(2) + bending))

    def _changes(self, torque: Array, moment: Array) -> _Changes:
        """Differences between both ends: those at samples, extended to all points between samples.

        Between samples they grow by at most L, half of the sample distance times a bound on their slope, which is
        affine in the differences x. Every x with x >= sampled + L(x) is a bound. With x_k+1 = sampled + L(x_k), one is
        2 x_6 - x_2 if 2 (x_7 - x_6) <= x_3 - x_2. (Two rounds spread a change to all tubes, torques and moments.)
        """
        single, pair = self.intervals.changes
        rounds = [_Changes((single, pair), torque, moment, np.ones(len(single), dtype=bool))]
        first, last = ROUNDS
        for _ in range(last + 1):
            error = self._between_samples(rounds[-1])
            angle = single + error.theta, pair + pair_differences(error.theta)
            rounds.append(_Changes(angle, torque + error.torque, moment + error.moment, rounds[0].valid))
        x_2, x_3, x_6, x_7 = (rounds[k].parts for k in (first, first + 1, last, last + 1))
        valid = [
            (2 * (d - c) <= b - a + 1e-15).reshape(len(single), -1).all(1)
            for a, b, c, d in zip(x_2, x_3, x_6, x_7, strict=True)
        ]
        theta, difference, torque, moment = (2 * c - a for a, c in zip(x_2, x_6, strict=True))
        return _Changes((theta, difference), torque, moment, np.logical_and.reduce(valid))

    def _between_samples(self, c: _Changes) -> _Samples:
        """Half of the sample distance times bounds on the slopes of the differences `c` along the arm."""
        h, dh, lever, du = self.length.v[..., None], self.length.d[..., None], self.lever, self._curvature_change(c)
        constants = self.intervals.arms.constants
        twist = constants.largest(constants.bounds.twist[0], self.intervals.stretch)
        # theta' = t / kt + u*_z.
        theta = dh * (self.torque / self.kt + twist) + h * c.torque / self.kt
        theta = theta + h * (
            self.torque * self.transport.compliance.d + self.transport.twist_slope.v * self.intervals.moved
        )
        # t_i' = u x a_i: of the other tubes, of the load, and of moments per length.
        torque_slope = self.pairs.sum(3) + self.slope * lever[..., None] + self.along
        change = (self.pairs * c.angle[1]).sum(3)
        change += self.slope * (c.moment[..., None] + lever[..., None] * c.angle[0])
        change += self.transport.gain(np.ones_like(self.pairs)) + self.natural_curvature.d * lever[..., None]
        frame = np.cumsum(self.length.d * self.u + self.length.v * du, axis=1)
        change += self.along * frame[..., None]
        # m' = u x t + n, with moments per length.
        torsion, torsion_change, along = self.torque.sum(2), c.torque.sum(2), self.along.sum(2)
        moment = self.length.d * (self.u * torsion + self.force.v + along)
        moment += self.length.v * (
            du * torsion + self.u * torsion_change + self.force.d + (self.force.v + along) * frame
        )
        half = 1 / (2 * PARTS)
        return _Samples(half * theta, half * (dh * torque_slope + h * change), half * moment)

    def _curvature_change(self, c: _Changes) -> Array:
        """(B, K) bound on the change of u = (M + sum a_i) / K."""
        by_tubes = (self.slope * c.angle[0] + self.natural_curvature.d).sum(2)
        return np.asarray(c.moment / self.stiffness + by_tubes + self.lever * self.transport.bending_compliance.d)

    def _twist(self, torque: DerivativeBounds) -> DerivativeBounds:
        """(B, K, n) time derivatives of theta, as torques twist the tubes."""
        base = self.spring * torque.map(lambda bound: bound[:, 0])
        along = self.length.map(lambda bound: bound[..., None]) * torque * self.transport.compliance
        along = along.map(lambda bound: np.cumsum(bound, axis=1))
        return base.map(lambda bound: bound[:, None]) + along + self.transport.twist_deviation

    def _bend(self, theta: DerivativeBounds, moment: DerivativeBounds) -> DerivativeBounds:
        """Bend of every section, h u (B, K), rad."""
        by_tubes = (self.natural_curvature * unit_vector(theta)).map(lambda bound: bound.sum(2))
        return self.length * replace(by_tubes + moment * self.transport.bending_compliance, v=self.u)

    def _balance(
        self, theta: DerivativeBounds, pair: DerivativeBounds, tangent: DerivativeBounds
    ) -> tuple[DerivativeBounds, DerivativeBounds]:
        """Torques T_i (B, K, n) and moment M (B, K) that balance the load, N m, with their derivatives."""
        # M(s) = int_s^L (R't) x (R'n) with R of s: derivatives of t relative to R, and of R relative to n, add up to
        # those of t.
        moment = (self.length * tangent * self.force).map(_to_tip) + tangent * self.couple
        by_load = unit_vector(theta) * moment.map(lambda bound: bound[..., None])
        by_tubes = (self.pairing * unit_vector(pair)).map(lambda bound: bound.sum(3))
        by_moments = tangent.map(lambda bound: bound[..., None] * self.along)
        each = self.length.map(lambda bound: bound[..., None]) * (
            self.natural_curvature * by_load + by_tubes + by_moments
        )
        return (each + tangent.map(lambda bound: bound[..., None] * self.kick)).map(_to_tip), moment

    def _size(self, torque: Array, moment: Array) -> Array:
        """(B,) sqrt(T) of torques (B, K, n) and moments (B, K)."""
        inside = (torque**2 / self.kt).sum(2) + moment**2 / self.stiffness
        transmissions = (self.spring.v * torque[:, 0] ** 2).sum(1)
        return np.asarray(np.sqrt((self.length.v * inside).sum(1) + transmissions))

    def _chord(self, c: _Changes, torque: Array) -> _Chord:
        """Bounds along a chord with torques of at most `torque` (B, K, n) and the change `c`."""
        twist_tt = self._twist(DerivativeBounds(torque, c.torque, np.zeros_like(c.torque))).dd
        # A parabola is steeper than its chord by at most half of its second derivative.
        theta = DerivativeBounds(np.ones_like(twist_tt), c.angle[0] + twist_tt / 2, twist_tt)
        differences = pair_differences(twist_tt)
        pair = DerivativeBounds(np.ones_like(differences), c.angle[1] + differences / 2, differences)
        u = self._bend(theta, DerivativeBounds(self.lever, c.moment, np.zeros_like(c.moment)))
        w = np.cumsum(u.d, axis=1)
        tangent = rotating_tangent(w, np.cumsum(w * u.d + u.dd, axis=1))
        return _Chord(theta, pair, tangent, *self._balance(theta, pair, tangent))

    def gradient(self) -> Array:
        """(B,) bound on |g| along the chord: g is 0 at both ends, so it is at most |g_tt| / 8."""
        return self._size(self.chord.torque.dd / 8, self.chord.moment.dd / 8)

    def _response(self, size: Array) -> _Changes:
        """Rotations due to torques and moments with sqrt(T) = `size` (B,), and the changes of T_i and M by these."""
        single, pair, h = (
            self.weight[0] * size[:, None, None],
            self.weight[1] * size[:, None, None, None],
            self.length.v,
        )
        frame = self.swing * size[:, None]
        moment = _to_tip(h * frame * self.force.v) + frame * self.couple.v
        by_load = self.slope * (single * self.lever[..., None] + moment[..., None])
        by_moments = (h[..., None] * self.along + self.kick) * frame[..., None]
        torque = _to_tip(h[..., None] * ((self.pairs * pair).sum(3) + by_load) + by_moments)
        return _Changes((single, pair), torque, moment, np.ones(len(size), dtype=bool))

    def tangent_derivatives(self, radius: Array, convexity: Array) -> DerivativeBounds:
        """(B, K) time derivatives of the tangent of the equilibria, to the third.

        They are within `radius` (B,) of the chord, where the second variation is at least `convexity` (B,) times T.
        With y = chord + e: g_y e' = -d/dt g(chord + e) at constant e, and g(chord) is 0 at both ends. The second and
        third derivative of y, multiplied by g_y, equal the part of -g_tt and -g_ttt with lower derivatives of y.
        """
        c, chord = self.changes, self.chord
        ball = self._response(radius)
        error = ball.torque + chord.torque.dd / 8
        wide = _Changes(
            (c.angle[0] + ball.angle[0], c.angle[1] + ball.angle[1]),
            c.torque + error,
            c.moment + ball.moment + chord.moment.dd / 8,
            c.valid,
        )
        # g_t at e: a function that is 0 at both ends has a slope of at most half of its second derivative; the mixed
        # derivative times e is half of what e adds to g_tt.
        perturbed = self._chord(wide, self.torque + error)
        torque_t, moment_t = perturbed.torque.dd / 2, perturbed.moment.dd / 2
        first = self._response(self._size(torque_t, moment_t) / convexity)
        y = _TimeDerivatives.at_rest(self)
        y.torque[0] = self.torque + error
        y.theta[1], y.pair[1] = chord.theta.d + first.angle[0], chord.pair.d + first.angle[1]
        y.torque[1] = c.torque + torque_t + first.torque
        y.moment[1] = c.moment + moment_t + first.moment
        y.frame[1] = np.cumsum(self._bend(y.bounds("theta"), y.bounds("moment")).d, axis=1)
        self._add_order(y, 2, convexity)
        self._add_order(y, 3, convexity)
        return rotating_tangent(*y.frame[1:])

    def _add_order(self, y: _TimeDerivatives, order: int, convexity: Array) -> None:
        """Add bounds of an order to `y`; all lower orders must be known.

        First without torques and moments of this order; the residual, over the convexity, bounds these.
        """
        theta = self._twist(y.bounds("torque")).order(order)
        y.theta[order], y.pair[order] = theta, pair_differences(theta)
        u, frame = self._bend(y.bounds("theta"), y.bounds("moment")), y.frame
        gain = u.order(order) + frame[1] * u.d
        if order == 3:
            gain = u.order(3) + (frame[2] + frame[1] ** 2) * u.d + 2 * frame[1] * u.dd
        frame[order] = np.cumsum(gain, axis=1)
        balance = self._balance(y.bounds("theta"), y.bounds("pair"), rotating_tangent(*frame[1:]))
        torque, moment = (bounds.order(order) for bounds in balance)
        size = self._size(torque, moment) / convexity
        response = self._response(size)
        y.theta[order], y.pair[order] = theta + response.angle[0], pair_differences(theta) + response.angle[1]
        frame[order] = frame[order] + self.swing * size[:, None]
        y.torque[order], y.moment[order] = torque + response.torque, moment + response.moment

    def hessian_change(self, moved: _Displacement, *, stretched: bool) -> Array:
        """(B,) bound on the change of the second variation relative to T.

        `stretched`: also from the chord to the sections, transmissions and load of the nearer end.
        """
        h, w, lever = self.length.v, self.weight, self.lever
        if stretched:
            geometry, dc, da = self._geometry_change(), self.pairing.d / 2, self.natural_curvature.d / 2
        else:
            none = np.zeros_like(h)
            geometry, dc, da = _GeometryChange(none, np.zeros_like(w[0]), none, none), np.zeros(()), np.zeros(())
        dh, dy, dn = geometry.h, geometry.y, geometry.force
        # sum c_ij (y_i - y_j)^2 / 2 over pairs of tubes.
        dpair = np.hypot(dy[..., :, None], dy[..., None, :])
        each = h[..., None, None] * (self.pairs * moved.angle[1] + dc) + dh[..., None, None] * self.pairs
        by_tubes = (each * w[1] ** 2 + 2 * h[..., None, None] * self.pairs * w[1] * dpair).sum((1, 2, 3)) / 2
        # A_i M y_i^2: in the frame of a cross-section the applied moments rotate too.
        bending = moved.moment + self.couple.v * moved.frame
        size = h[..., None] * (bending[..., None] + lever[..., None] * moved.angle[0]) + (dh * lever)[..., None]
        size = self.slope * size + da * (h * lever)[..., None]
        by_load = (size * w[0] ** 2 + 2 * self.slope * (h * lever)[..., None] * w[0] * dy).sum((1, 2))
        # dpsi, the change of psi: by frames, by the directions of a_i, by lengths, and by bending.
        turning = self.slope * (h[..., None] * (w[0] * moved.angle[0] + dy) + dh[..., None] * w[0])
        turning += da * h[..., None] * w[0]
        dpsi = moved.frame * self.swing + np.cumsum(turning.sum(2), axis=1) + geometry.bending
        # m.(psi x psi'): running totals P of |psi'| and D of its change have int |psi||psi'| <= P^2 / 2, and
        # int D dP + P dD = P D.
        total = self.swing[:, -1]
        by_turns = moved.moment.max(1) * total**2 / 2 + lever[:, 0] * total * dpsi[:, -1]
        # n |psi|^2.
        n = self.force.v
        by_force = (h * (dn + n * moved.frame) + dh * n) * self.swing**2 + 2 * h * n * self.swing * dpsi
        # Torques of applied moments, m.(psi x t) y.
        acts = h[..., None] * self.along + self.kick
        by_moments = acts * (w[0] * (moved.frame * self.swing + dpsi)[..., None] + self.swing[..., None] * dy)
        by_moments += (dh * self.swing)[..., None] * self.along * w[0]
        return np.asarray(by_tubes + by_load + by_turns + by_force.sum(1) + by_moments.sum((1, 2)))

    def hessian_chord_error(self) -> Array:
        """(B,) bound on how far the second variation along the chord is below its linear interpolation in time, over T.

        It is `CHORD_ERROR` times a bound on its second time derivative, at fixed torques and moments, relative to T.
        Infinite where tubes vary, since T is then not linear in time. See "Between loaded equilibria" in
        docs/theory-proofs.md.
        """
        if not self.transport.still:
            return np.full(len(self.lever), np.inf)
        h, zero, chord = self.length, np.zeros_like(self.length.v), self.chord
        start, end = self.intervals.length
        # Squares of the changes of y, of int h r and of the transmissions, where T = 1.
        grown = _square_over(h.d, np.minimum(start, end))
        base = _square_over(self.spring.d, self.spring.v - self.spring.d)
        single = np.sqrt(np.cumsum(grown[..., None] / self.kt, axis=1) + base[:, None])
        bending = np.cumsum(h.v / self.stiffness, axis=1), np.cumsum(grown / self.stiffness, axis=1)
        y = DerivativeBounds(self.weight[0], single, np.zeros_like(single))
        dpair = np.hypot(single[..., :, None], single[..., None, :])
        pair = DerivativeBounds(self.weight[1], dpair, np.zeros_like(dpair))
        by_tubes = (self.pairing * unit_vector(chord.pair) * pair * pair).map(lambda bound: bound.sum((2, 3)) / 2)
        moments = self.natural_curvature * unit_vector(chord.theta)
        by_load = (moments * chord.moment.map(lambda bound: bound[..., None]) * y * y).map(lambda bound: bound.sum(2))
        # psi, by the rotations of the tubes and by the moments.
        psi = (chord.tangent * h * (moments * y).map(lambda bound: bound.sum(2))).map(lambda b: np.cumsum(b, axis=1))
        psi = psi + chord.tangent * DerivativeBounds(np.sqrt(bending[0]), np.sqrt(bending[1]), zero)
        psi = replace(psi, v=self.swing)
        # Integrated by parts, m_w.(psi x psi') is n |psi|^2 / 2, besides n.(psi x (psi x e)): together 3 / 2.
        by_turns = (chord.tangent * self.force * psi * psi).map(lambda bound: 1.5 * bound)
        by_forces = (h * (by_tubes + by_load + by_turns)).dd.sum(1)
        # The same half of the applied moments: of their decrease from section to section towards the tip.
        decrease = self.couple.map(lambda bound: (bound - np.pad(bound[:, 1:], ((0, 0), (0, 1)))) / 2)
        acts = h.map(lambda bound: bound[..., None] * self.along)
        acts = replace(acts, v=acts.v + self.kick)
        by_twist = acts * (chord.tangent * psi).map(lambda bound: bound[..., None]) * y
        by_moments = (decrease * psi * psi).dd.sum(1) + by_twist.dd.sum((1, 2))
        return np.asarray(CHORD_ERROR * (by_forces + by_moments))

    def _geometry_change(self) -> _GeometryChange:
        """Differences between the chord and its nearer end, at most half of the time away."""
        root, spring = _root_change(*self.intervals.length), self.spring
        twisting, bending = self._compliance_change()
        tube = root[..., None] / np.sqrt(self.kt) + np.sqrt(self.length.v)[..., None] * twisting
        base = _root_change(np.maximum(spring.v - spring.d, 0.0), spring.v) + np.sqrt(spring.dd / 8)
        bundle = root / np.sqrt(self.stiffness) + np.sqrt(self.length.v) * bending
        return _GeometryChange(
            h=self.length.d / 2,
            y=np.sqrt(np.cumsum(tube**2, axis=1) + base[:, None] ** 2),
            bending=np.sqrt(np.cumsum(bundle**2, axis=1)),
            force=self.force.d / 2,
        )

    def _compliance_change(self) -> tuple[Array, Array]:
        """Bounds on the change of sqrt(1 / kt) (B, K, n) and of sqrt(1 / K) (B, K) from the nearer end."""
        if self.transport.still:
            return np.zeros(()), np.zeros(())
        c, stretch = self.intervals.arms.constants, self.intervals.stretch
        kb, kt = (c.largest(stiffness, stretch) for stiffness in c.bounds.stiffest)
        # Half of the time; and d sqrt(f) = df / (2 sqrt(f)), with the smallest f.
        bending = self.transport.bending_compliance.d * np.sqrt(kb.sum(-1)) / 4
        return self.transport.compliance.d * np.sqrt(kt) / 4, bending

    def ball(self, margin: Array) -> _Ball:
        """Ball around the chord that contains the equilibria, from the smaller `margin` (B,) of both ends."""
        chord = self.chord
        forces = (self.length * chord.tangent * self.force).map(_to_tip)
        # From the chord to its nearer end; and per unit of radius from the centre of the ball.
        by_time = _Displacement(
            (chord.theta.d / 2, chord.pair.d / 2), chord.tangent.d / 2, (forces.d + self.couple.d) / 2
        )
        by_radius = _Displacement(self.weight, self.swing, _to_tip(self.length.v * self.force.v * self.swing))
        q_0 = np.fmin(self.hessian_change(by_time, stretched=True), self.hessian_chord_error())
        q_1 = self.hessian_change(by_radius, stretched=False)
        contraction = margin - q_0
        radius, exists = least_root(self.gradient(), contraction, q_1)
        return _Ball(radius, np.asarray(contraction - q_1 * radius), exists)

    def chord_error(self, radius: Array) -> Array:
        """(B, K) bound on the distance of a point from the straight line between its positions at both ends, m."""
        tangent = self.chord.tangent
        # P_tt = int 2 h_t t_t + h t_tt, an eighth of it is the distance; the ball adds its rotations times the length.
        second = 2 * self.length.d * tangent.d + self.length.v * tangent.dd
        lever = self.length.v * self.swing * radius[:, None]
        return np.asarray(np.cumsum(second / 8 + lever, axis=1))


@dataclass(frozen=True, eq=False)
class _TimeDerivatives:
    """Bounds on values (0) and time derivatives (1 to 3) along the equilibria.

    For `frame` they bound the angular velocity (1) and its two derivatives.
    """

    theta: list[Array]
    pair: list[Array]
    torque: list[Array]
    moment: list[Array]
    frame: list[Array]

    @staticmethod
    def at_rest(of: _Bounds) -> _TimeDerivatives:
        """Values of the chord with time derivatives 0."""
        sizes = np.ones_like(of.torque), np.ones_like(of.pairs), of.torque, of.lever, np.ones_like(of.lever)
        return _TimeDerivatives(*([size, *(np.zeros_like(size) for _ in range(3))] for size in sizes))

    def bounds(self, name: str) -> DerivativeBounds:
        """Bounds of one quantity."""
        return DerivativeBounds(*getattr(self, name))


def _square_over(change: Array, lower: Array) -> Array:
    """Squares of `change` divided by `lower`; 0 where nothing changes, even if `lower` is 0."""
    return np.asarray(change**2 / np.maximum(lower, 1e-300))


def _to_tip(bound: Array) -> Array:
    """(B, K) sums over each section and all sections between it and the tip."""
    return np.cumsum(bound[:, ::-1], axis=1)[:, ::-1]


def _root_change(start: Array, end: Array) -> Array:
    """Largest change of sqrt(f) from the nearer end, for f linear in time between two values."""
    middle = np.sqrt((start + end) / 2)
    return np.asarray(np.maximum(np.abs(middle - np.sqrt(start)), np.abs(middle - np.sqrt(end))))
