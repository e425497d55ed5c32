"""Bounds between two equilibria: proof that one stable branch joins them, and of the arm's position in between.

Joint values are linear in time t, 0 to 1. The chord theta~ goes linearly from one equilibrium to the other at fixed
fractions of the sections, whose lengths are linear in t. It nearly solves the equations

    F(theta, t) = theta - alpha - |beta| w(0) - int h g w = 0,    w = - int_s h M(theta) / kt   (to the tip),

since F(theta~, t) is 0 at both ends: in between |F| <= max |F_tt| / 8, which is of second order in the step. With
A = DF(theta_0)^-1, of norm 1 / mu in the norm of torsional energy (mu: the margin), theta~ + e solves them where

    e = e - A F(theta~ + e):    |e| <= |A F(theta~)| + q |e|,    q = |A (DF(theta_0) - DF(theta~ + e, t))|.

Newton and Kantorovich: where the right-hand side maps a ball into itself and q < 1, the ball contains exactly one
solution for every t, on which DF is never singular. So there is no fold, no bifurcation, and no loss of stability in
between. The half of the time nearer to the other end is reached from that end. Every bound is in closed form and holds
for all rotations. Bounds on u, from e and from the curved paths of theta, then bound the distance (`chord_error`) of
each point of the arm from the straight line between its positions at both ends.

Tubes made of pieces: theta~ is linear except for the natural twist, which is known and is added to both sides of F = 0.
Along arcs and helices of constant stiffness the twist is linear too, and nothing else changes. Where precurvature or
stiffness varies along a tube, a point at a fixed fraction of a section moves along the tube, by at most
`Intervals.moved`; `TransportBounds` bounds what this adds to the time derivatives of moments, of u and of 1 / kt.
Everything else uses the smallest stiffness and the largest curvature of each section.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from ..typing import Array, Mask
from .sections import PARTS, DerivativeBounds, Intervals, inverse, linear, pair_differences, unit_vector

AngleChange = tuple[Array, Array]
"""Bounds on changes of angles in every section: of theta_i (B, K, n), and of theta_i - theta_j (B, K, n, n)."""

AngleDerivatives = tuple[DerivativeBounds, DerivativeBounds]
"""Bounds on time derivatives of theta_i (B, K, n), and of theta_i - theta_j (B, K, n, n)."""


@dataclass(frozen=True, eq=False)
class ProvedBranch:
    """Proof results for B intervals between neighbouring equilibria."""

    unbroken: Mask
    """(B,) True where one stable branch is proved to join the equilibria."""
    chord_error: Array
    """(B, K) bound, m, on the distance of a point of a section from the straight line between its positions at both
    ends."""
    rotation_bounded: Mask
    """(B,) True if the rotation of the tubes is bounded between samples along the arm; otherwise shorter intervals
    hardly help."""
    rates: Array
    """(2, B) bounds on the second and third derivative of the tip by time, m; infinite without a proved branch."""


def branch(intervals: Intervals, stiffness: Array) -> ProvedBranch:
    """Proof results for intervals; `stiffness` (E,): least singular values of DF at the equilibria."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        bounds = _Bounds(intervals, np.minimum(stiffness[intervals.start], stiffness[intervals.end]))
        dtheta, bounded = bounds.angle_change()
        ball, contracts = bounds.ball(dtheta)
        unbroken = bounded & contracts & intervals.ordered
        error = bounds.chord_error(dtheta, ball.radius[:, None, None] * bounds.weight[0])
        rates = tip_derivatives(bounds.length * bounds.tangent_derivatives(dtheta, ball))
    proved = np.asarray(unbroken & np.isfinite(error).all(1))
    return ProvedBranch(proved, np.where(unbroken[:, None], error, np.inf), bounded, rates)


def least_root(residual: Array, contraction: Array, curvature: Array) -> tuple[Array, Mask]:
    """(B,) smallest root r of r = residual + curvature r^2 / 2, and (B,) True if it exists and is simple."""
    discriminant = contraction**2 - 2 * curvature * residual
    # The smaller root of curvature r^2 / 2 - contraction r + residual = 0; in this form nothing cancels for small
    # curvature. Kantorovich: residual < contraction^2 / (2 curvature) makes the root exist, and q < 1 in its ball.
    radius = 2 * residual / (contraction + np.sqrt(np.maximum(discriminant, 0.0)))
    return np.asarray(radius), np.asarray((contraction > 0) & (discriminant > 0))


def rotating_tangent(w: Array, dw: Array, ddw: Array | None = None) -> DerivativeBounds:
    """Bounds on a unit vector and its derivatives, from bounds on |phi|, |phi'| and |phi''| of its angular velocity
    phi.
    """
    # With t' = phi x t: t'' = phi' x t + phi x (phi x t); t''' has phi'', three products of phi and phi', and phi^3.
    return DerivativeBounds(np.ones_like(w), w, dw + w**2, None if ddw is None else ddw + 3 * w * dw + w**3)


def tip_derivatives(sections: DerivativeBounds) -> Array:
    """(2, B) bounds on the second and third derivative of the tip, as sums over sections (B, K)."""
    sums = np.stack([sections.order(2).sum(1), sections.order(3).sum(1)])
    return np.where(np.isfinite(sums), sums, np.inf)


def _at_ends(gain: Array) -> Array:
    """(2, B, K) sums of the increments `gain` (B, K) over sections, up to the start and the end of each section."""
    total = np.cumsum(gain, axis=1)
    return np.stack([total - gain, total])


def _with_pairs(single: Array) -> AngleChange:
    """Bounds on theta_i, and the bounds on theta_i - theta_j that follow from them."""
    return single, pair_differences(single)


@dataclass(frozen=True, eq=False)
class _Ball:
    """Ball around the chord theta~ that contains the solution theta, for B intervals, in units of `weight`."""

    radius: Array
    residual_tt: Array
    """Bound on |A F_tt| along the chord."""
    jacobian_t: Array
    """Bound on the change of A DF over the whole time."""
    contraction: Array
    """Lower bound on |A DF y| / |y| in the ball."""


class _Bounds:
    """Bounds over B intervals with K sections of n tubes; a bound of a section is valid everywhere in it."""

    def __init__(self, intervals: Intervals, stiffness: Array) -> None:
        self.intervals, self.bending, self.stiffness = intervals, intervals.bending, stiffness
        self.transport, self.offset = intervals.transport, intervals.arms.constants.offset
        self.compliance, self.length = self.transport.compliance, linear(*intervals.length)
        """Torsional compliance 1 / kt (B, K, n), and section lengths h (B, K)."""
        self.transmission = intervals.transmission
        # Cauchy-Schwarz: y_i(s) = int y_i' <= sqrt(int 1 / kt_i) sqrt(int kt_i y_i'^2). The energies of two tubes add,
        # so their bounds add as squares.
        flexibility = [np.cumsum(length[..., None] * self.compliance.v, axis=1) for length in intervals.length]
        single = np.sqrt(np.maximum(*flexibility) + self.transmission.v[:, None])
        self.weight: AngleChange = single, np.hypot(single[..., :, None], single[..., None, :])
        """Bounds sqrt((|beta_i| + s) / kt_i) on |y_i|, and those on |y_i - y_j|, for |y| = 1 in the energy norm."""
        self.torque = self.bending.pairs.sum(3)
        pairs, natural, b = self.transport.pairs, self.transport.natural_curvature, self.bending
        self.pairing = DerivativeBounds(b.pairs, pairs.d, pairs.dd, pairs.ddd)
        self.natural_curvature = DerivativeBounds(b.moment / b.stiffness[..., None], natural.d, natural.dd, natural.ddd)
        """m_i m_j / k (B, K, n, n) and m_i / k (B, K, n), with their changes along tubes that vary."""
        self.zero = np.zeros_like(self.torque)

    def steps(self) -> DerivativeBounds:
        """(B, K, 1) section lengths."""
        return self.length.map(lambda bound: bound[..., None])

    def torque_change(self, dtheta: AngleChange) -> Array:
        """(B, K, n) bound on the change of the moments M_i when theta changes by `dtheta`."""
        b = self.bending
        # M_i = sum_j m_i m_j sin(theta_i - theta_j) / k(u): a sine changes by at most its angle, and k changes with u.
        dk = b.k_u * b.change(dtheta[0])
        return np.asarray((b.pairs * dtheta[1]).sum(3) + self.torque * (dk / b.stiffness)[..., None])

    def torque_second(self, x: AngleChange, y: AngleChange) -> Array:
        """(B, K, n) bound on the second derivative of the moments M_i in the directions x and y."""
        b = self.bending
        u_x, u_y = b.change(x[0]), b.change(y[0])
        k_x, k_y = b.k_u * u_x / b.stiffness, b.k_u * u_y / b.stiffness
        # Product and quotient rule for S / k, with sine and cosine at most 1; k_xy is relative to k.
        k_xy = (b.k_u * b.second(x[0], y[0]) + b.k_uu * u_x * u_y) / b.stiffness
        mixed = (b.pairs * x[1]).sum(3) * k_y[..., None] + (b.pairs * y[1]).sum(3) * k_x[..., None]
        return np.asarray((b.pairs * x[1] * y[1]).sum(3) + mixed + self.torque * (k_xy + 2 * k_x * k_y)[..., None])

    def chord(self, dtheta: AngleChange) -> AngleDerivatives:
        """Time derivatives of the chord theta~: only the natural twist of tubes that vary is not linear in time."""
        twist_tt = self.transport.twist_deviation.dd
        single = DerivativeBounds(dtheta[0], dtheta[0], twist_tt)
        return single, DerivativeBounds(dtheta[1], dtheta[1], pair_differences(twist_tt))

    def cross_sections(self, angles: AngleDerivatives) -> tuple[DerivativeBounds, DerivativeBounds]:
        """Moments M (B, K, n) and curvature u (B, K) where the angles have these time derivatives."""
        u, k = self.bending.along((self.natural_curvature * unit_vector(angles[0])).map(lambda bound: bound.sum(2)))
        moment = (self.pairing * unit_vector(angles[1])).map(lambda bound: bound.sum(3))
        return (moment * inverse(k).map(lambda bound: bound[..., None]) if self.offset.any() else moment), u

    def torques(self, moment: DerivativeBounds) -> tuple[DerivativeBounds, DerivativeBounds]:
        """(B, K, n) torques of the tubes at the start and at the end of every section, N m."""
        gain = self.steps() * moment
        # A tube has no torque at its tip. Elsewhere its torque is the sum of the moments between there and the tip.
        start = gain.map(lambda bound: np.cumsum(bound[:, ::-1], axis=1)[:, ::-1])
        third = None if start.ddd is None or gain.ddd is None else start.ddd - gain.ddd
        return start, DerivativeBounds(start.v - gain.v, start.d - gain.d, start.dd - gain.dd, third)

    def rotation(self, moment: DerivativeBounds, stretch: DerivativeBounds) -> DerivativeBounds:
        """Bound (B, K, n) on the rotation of the tubes up to the end of every section, rad.

        It is |beta| w(0) + int h (1 + stretch) w, which bounds the rotation in all of the section.
        """
        start, end = self.torques(moment)
        mean = (start + end).map(lambda bound: bound / 2)
        g = replace(stretch, v=1 + stretch.v)
        along = (self.steps() * (g * mean * self.compliance)).map(lambda bound: np.cumsum(bound, axis=1))
        base = self.transmission * start.map(lambda bound: bound[:, 0])
        return along + base.map(lambda bound: bound[:, None])

    def _stretch(self, u: Array) -> Array:
        """(B, K, n) bound on |g - 1| = |d u.a| of tubes off the centreline."""
        return np.asarray(self.offset * u[..., None])

    def energy(self, dtheta: AngleChange) -> Array:
        """(B,) bound on (DF - 1) y in the energy norm, for any y within `dtheta`."""
        start, end = self.torques(DerivativeBounds(self.torque_change(dtheta), self.zero, self.zero))
        torque = self.torques(DerivativeBounds(self.torque, self.zero, self.zero))[0].v
        # Beside the centreline a tube is longer than the arm, by g = 1 + d u.a.
        g = 1 + self._stretch(self.bending.max_u)
        dg = self._stretch(self.bending.change(dtheta[0])) * torque
        a, b = g * start.v + dg, g * end.v + dg
        # The torque is linear from a to b along a section: int (a + (b - a) x)^2 dx = (a^2 + a b + b^2) / 3.
        along = (self.length.v[..., None] * self.compliance.v * (a**2 + a * b + b**2) / 3).sum((1, 2))
        transmissions = (self.transmission.v * start.v[:, 0] ** 2).sum(1)
        return np.asarray(np.sqrt(along + transmissions))

    def response(self, dtheta: AngleChange) -> AngleChange:
        """Bound on the linear response A f to any f within `dtheta`."""
        # A = 1 + A (1 - DF): the second part is bounded in energy, where A has the norm 1 / mu.
        size = (self.energy(dtheta) / self.stiffness)[:, None, None]
        return dtheta[0] + size * self.weight[0], dtheta[1] + size[..., None] * self.weight[1]

    def norm(self, dtheta: AngleChange) -> Array:
        """(B,) least factor of `weight` that bounds `dtheta` in all sections of positive length."""
        exists = self.length.v[..., None] > 0
        single = np.where(exists & (dtheta[0] > 0), dtheta[0] / self.weight[0], 0.0).max((1, 2), initial=0.0)
        ratio = dtheta[1] / self.weight[1]
        pair = np.where(exists[..., None] & (dtheta[1] > 0), ratio, 0.0).max((1, 2, 3), initial=0.0)
        return np.asarray(np.maximum(single, pair))

    def angle_change(self) -> tuple[AngleChange, Mask]:
        """Bound on the difference of theta between both ends, all along the arm, and (B,) True for valid bounds.

        It is sampled; in between, a function differs from its chord by at most h^2 / 8 times its second derivative.
        """
        single, pair = self.intervals.changes
        # The natural twist is not quite linear in time.
        twist = _with_pairs(self.transport.twist_deviation.d)
        single, pair = single + twist[0], pair + twist[1]
        error = self._between_samples((single, pair))
        wide = single + 2 * error, pair + 2 * pair_differences(error)
        # The error bound is linear in the change that it bounds. So if twice the first error covers the error of the
        # widened change, the widened change is a bound.
        valid = (self._between_samples(wide) <= 2 * error + 1e-15).all((1, 2))
        return wide, np.asarray(valid)

    def _between_samples(self, dtheta: AngleChange) -> Array:
        """Bound (B, K, n) on the change of theta between samples, rad.

        It is h^2 / 8, for the sample distance h, times the change of d^2 theta / dx^2 = h d (h g w) / ds.
        """
        h, (moment, _) = self.steps(), self.cross_sections(self.chord(dtheta))
        u, du = self.bending.max_u, self.bending.change(dtheta[0])
        g = DerivativeBounds(1 + self._stretch(u), self._stretch(du), self.zero)
        second = h * h * g * moment * self.compliance
        if not self.transport.still:
            twist = self.torques(moment)[0] * self.transport.compliance_slope + self.transport.twist_slope
            second = second + h * h * twist
        if self.offset.any():
            w = self.torques(moment)[0] * self.compliance
            theta_x, zero = h * g * w, np.zeros_like(u)
            # u changes along the arm as theta does; its change with time comes from both factors.
            u_xt = self.bending.second(dtheta[0], theta_x.v) + self.bending.change(theta_x.d)
            second = second + h * w * DerivativeBounds(self.bending.change(theta_x.v), u_xt, zero).map(self._stretch)
        return np.asarray(second.d / (8 * PARTS**2))

    def ball(self, dtheta: AngleChange) -> tuple[_Ball, Mask]:
        """Ball that contains e = theta - theta~, and (B,) True where the iteration maps it into itself."""
        b, zero = self.bending, np.zeros_like(self.bending.max_u)
        moment, u = self.cross_sections(self.chord(dtheta))
        # F(theta~, t) is 0 at both ends, so that in between it is at most max |F_tt| / 8.
        residual = self.norm(self.response(_with_pairs(self.rotation(moment, u.map(self._stretch)).dd / 8)))
        # How much A DF differs from 1: by the time from the nearer end, and by e (per unit of its norm).
        changes = []
        for direction, moving in ((dtheta, True), (self.weight, False)):
            y = self.weight
            u_y, u_yt = b.change(y[0]), b.second(y[0], direction[0])
            transport = self.transport.gain(y[1]) if moving else 0.0
            moments = DerivativeBounds(self.torque_change(y), self.torque_second(y, direction) + transport, self.zero)
            stretch = DerivativeBounds(u_y, u_yt, zero).map(self._stretch)
            change = self._jacobian_change(moments, stretch, direction, moving)
            changes.append(self.norm(self.response(_with_pairs(change))))
        jacobian_t, jacobian_e = changes
        # Half of the change in time, since each end has to reach only the middle.
        contraction = 1 - jacobian_t / 2
        radius, maps_into_itself = least_root(residual, contraction, jacobian_e)
        # The residual is an eighth of |A F_tt|.
        return _Ball(radius, 8 * residual, jacobian_t, contraction - jacobian_e * radius), maps_into_itself

    def solution_derivatives(self, dtheta: AngleChange, ball: _Ball) -> AngleDerivatives:
        """Time derivatives of the solution theta, to the third.

        DF e' = -d/dt F(theta~ + e, t) at constant e, and F(theta~, t) is 0 at both ends. DF e'' and DF e''' equal the
        part of -F_tt and -F_ttt that contains lower derivatives of e.
        """
        single = self.weight[0]
        # A function that is 0 at both ends has a slope of at most half of its largest second derivative.
        e_t = ((ball.residual_tt / 2 + ball.jacobian_t * ball.radius) / ball.contraction)[:, None, None]
        twist = self.transport.twist_deviation
        orders = [dtheta[0] + e_t * single, twist.order(2), twist.order(3)]
        pairs = [dtheta[1] + e_t[..., None] * self.weight[1], *(pair_differences(each) for each in orders[1:])]
        for order in (1, 2):
            moment, u = self.cross_sections((DerivativeBounds(single, *orders), DerivativeBounds(single, *pairs)))
            theta = self.rotation(moment, u.map(self._stretch)).order(order + 1)
            size = (self.norm(self.response(_with_pairs(theta))) / ball.contraction)[:, None, None]
            orders[order] = orders[order] + size * single
            pairs[order] = pairs[order] + size[..., None] * self.weight[1]
        return DerivativeBounds(single, *orders), DerivativeBounds(single, *pairs)

    def tangent_derivatives(self, dtheta: AngleChange, ball: _Ball) -> DerivativeBounds:
        """(B, K) time derivatives of the tangent along the solution, to the third, as means over each section."""
        u = self.length * self.cross_sections(self.solution_derivatives(dtheta, ball))[1]
        # The angular velocity phi of the frame has phi_s = R u_t. Its bounds are convex along a section, so that their
        # mean there is no more than the mean of both ends.
        w = _at_ends(u.d)
        dw = _at_ends(w.mean(0) * u.d + u.dd)
        ddw = _at_ends((dw + w**2).mean(0) * u.d + 2 * w.mean(0) * u.dd + u.order(3))
        return rotating_tangent(w, dw, ddw).map(lambda bound: bound.mean(0))

    def _jacobian_change(
        self, moments: DerivativeBounds, stretch: DerivativeBounds, direction: AngleChange, moving: bool
    ) -> Array:
        """(B, K, n) first derivative of (DF - 1) y as theta changes in a direction (and with time, if `moving`).

        `moments` and `stretch` (B, K, n) are the changes of M and g that y makes, with their first derivatives.
        """
        b, bounds = self.bending, self if moving else self._at_rest()
        g = DerivativeBounds(self._stretch(b.max_u), self._stretch(b.change(direction[0])), self.zero)
        change = bounds.rotation(moments, g).d
        if self.offset.any():
            torque = bounds.torques(DerivativeBounds(self.torque, self.torque_change(direction), self.zero))[0]
            along = bounds.steps() * stretch * (torque * bounds.compliance)
            change = change + along.map(lambda bound: np.cumsum(bound, axis=1)).d
        return np.asarray(change)

    def _at_rest(self) -> _Bounds:
        """Bounds without change of sections, transmissions and compliances over time."""
        resting = copy(self)
        resting.length, resting.transmission, resting.compliance = (
            DerivativeBounds(bounds.v, np.zeros_like(bounds.v), np.zeros_like(bounds.v))
            for bounds in (self.length, self.transmission, self.compliance)
        )
        return resting

    def chord_error(self, dtheta: AngleChange, error: Array) -> Array:
        """(B, K) bound on the distance of a point from the straight line between its positions at both ends, m.

        With U = h u and phi the rotation of the frame, phi_s = R U_t: |P_tt| <= int 2 |h_t| W + h (Phi + W^2), where W
        bounds |phi| and Phi its derivative; an eighth of it is the distance from the line. The curvature due to
        `error` (B, K, n), the bound on |theta - theta~|, acts on the lever ahead of it.
        """
        b, h = self.bending, self.length
        u = h * self.cross_sections(self.chord(dtheta))[1]
        w = np.cumsum(u.d, axis=1)
        w0 = w - u.d
        phi = np.cumsum((w + w0) / 2 * u.d + u.dd, axis=1)
        phi0 = np.concatenate([np.zeros_like(phi[:, :1]), phi[:, :-1]], axis=1)
        # Means over a section, along which the bounds grow linearly: of 2 W, w + w0; of W^2, (w^2 + w w0 + w0^2) / 3.
        second = h.d * (w + w0) + h.v * ((phi + phi0) / 2 + (w**2 + w * w0 + w0**2) / 3)
        du = b.change(error)
        slope = np.cumsum(h.v * du, axis=1)
        lever = h.v * (slope - h.v * du / 2)
        return np.asarray(np.cumsum(second / 8 + lever, axis=1))
