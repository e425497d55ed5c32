"""Equilibria as arrays, the sections that neighbouring equilibria share, and bounds on their cross-sections.

`CurvatureBounds` and `TransportBounds` are written by hand and independent of `physics`, by which motions are planned,
since they are part of the proof. Tests compare them with equilibria in between.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any, NamedTuple, Self

import numpy as np

from ..block.transcription.arm import cubic
from ..equilibrium.result import Equilibrium
from ..robots.lengthwise import Lengthwise, Variation, lengthwise, variation
from ..robots.robot import Robot
from ..typing import Array, Index, Mask


@dataclass(frozen=True, eq=False)
class DerivativeBounds:
    """Bounds on |f|, |f'|, |f''| and, if known, |f'''| over an interval of time, as arrays of equal shape.

    Sums and products follow the product rule, with all terms added by size: they are attained where nothing cancels.
    """

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

    def order(self, order: int) -> Array:
        """Bound on the derivative of an order, 0 to 3."""
        bound = (self.v, self.d, self.dd, self.ddd)[order]
        assert bound is not None
        return bound

    def map(self, function: Callable[[Array], Array]) -> DerivativeBounds:
        """Bounds on a linear function of f with no negative weights."""
        third = None if self.ddd is None else function(self.ddd)
        return DerivativeBounds(function(self.v), function(self.d), function(self.dd), third)


def linear(start: Array, end: Array) -> DerivativeBounds:
    """Bounds for a function that is linear in time between two values."""
    zero = np.zeros_like(start)
    return DerivativeBounds(np.maximum(np.abs(start), np.abs(end)), np.abs(end - start), zero, zero)


def unit_vector(angle: DerivativeBounds) -> DerivativeBounds:
    """Bounds for a unit vector at an angle in a plane, or for the sine of the angle; `angle.v` does not matter."""
    # e(phi)''' = phi''' e' + 3 phi' phi'' e'' + phi'^3 e''', and all derivatives of e by phi have length 1.
    third = None if angle.ddd is None else angle.d**3 + 3 * angle.d * angle.dd + angle.ddd
    return DerivativeBounds(np.ones_like(angle.d), angle.d, angle.d**2 + angle.dd, third)


def pair_differences(single: Array) -> Array:
    """(..., n, n) bounds on theta_i - theta_j from those on theta_i (..., n), by the triangle inequality."""
    return single[..., :, None] + single[..., None, :] if single.ndim else single


def inverse(size: DerivativeBounds) -> DerivativeBounds:
    """Bounds for 1 / f, for f of at least `size.v` and derivatives bounded by the other fields."""
    # (1/f)'' = 2 f'^2 / f^3 - f'' / f^2, and (1/f)''' = -6 f'^3 / f^4 + 6 f' f'' / f^3 - f''' / f^2.
    first, two = size.d / size.v, size.dd / size.v
    third = None if size.ddd is None else (size.ddd / size.v + 6 * first * two + 6 * first**3) / size.v
    return DerivativeBounds(1 / size.v, first / size.v, (two + 2 * first**2) / size.v, third)


@dataclass(frozen=True, eq=False)
class Constants:
    """Properties of n tubes, of C stretches each, that do not depend on joint values."""

    along: Lengthwise
    """Stiffness and precurvature as functions of arc length."""
    bounds: Variation
    """Bounds of stiffness and precurvature on every stretch."""
    offset: Array
    """(n,) distance of the tubes from the centreline, m."""
    direction: Array
    """(n, 2) offset vector, rotated by 90 deg: g_i = 1 + direction_i . u."""
    radius: Array
    """(n,) distance of the outer side of each tube from the centreline, m."""

    @staticmethod
    def of(robot: Robot) -> Constants:
        """Constants of a robot."""
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
        """Number of the stretch behind the end of a tube, C."""
        return int(self.bounds.cuts.shape[1])

    @cached_property
    def still(self) -> bool:
        """True if stiffness and precurvature are constant on every stretch."""
        return self.bounds.still

    def held(self, translations: Array) -> Array:
        """(..., n) clamped ends of tubes at translations (..., n), m; negative behind the plate."""
        return np.minimum(translations - self.bounds.cuts[:, 0], 0.0)

    def breakpoints(self, translations: Array) -> Array:
        """(..., C n) ends of the stretches of tubes at translations (..., n), m; negative behind the plate."""
        positions = self.held(translations)[..., None, :] + self.bounds.cuts.T
        return np.asarray(positions.reshape(*positions.shape[:-2], -1))

    def stretch(self, s: Array, breakpoints: Array) -> Index:
        """(..., n) number of the stretch of each tube at arc lengths (...), for breakpoints (..., C n)."""
        positions = breakpoints.reshape(*breakpoints.shape[:-1], self.ended, -1)
        return np.asarray((s[..., None, None] >= positions).sum(-2), dtype=np.intp)

    def largest(self, table: Array, *stretches: Index) -> Array:
        """(..., n) largest value of a table (n, C + 1) over the given stretches (..., n) of each tube."""
        tube = np.arange(len(table))
        return np.asarray(reduce(np.maximum, (table[tube, stretch] for stretch in stretches)))

    def smallest(self, table: Array, *stretches: Index) -> Array:
        """(..., n) smallest value of a table (n, C + 1) over the given stretches (..., n) of each tube."""
        return -self.largest(-table, *stretches)


@dataclass(frozen=True, eq=False)
class CurvatureBounds:
    """Bounds on the curvature u of cross-sections (...) at any rotations, and on its derivatives by rotations.

    u k(u) = S, S = sum m_i e(theta_i), k = sum kb_i / g_i, g_i = 1 + d_i u.a_i; where d = 0, k is a constant. k is
    convex, so that k >= k(0) - |grad k(0)| |u|; for tubes evenly spaced around the centreline grad k(0) = 0.
    """

    moment: Array
    """(..., n) moments m_i = kb_i |u*_i|, 0 where tube i is not curved, N m."""
    pairs: Array
    """(..., n, n) upper bound on m_i m_j / k, 0 for i = j."""
    max_u: Array
    """(...) upper bound on |u|."""
    stiffness: Array
    """(...) lower bound on k."""
    k_u: Array
    """(...) upper bound on the first derivative of k by u, and on the second and third:"""
    k_uu: Array
    k_uuu: Array
    tangent_stiffness: Array
    """(...) lower bound on |d(u k)| / |du|."""

    @staticmethod
    def of(c: Constants, *stretches: Index) -> CurvatureBounds:
        """Bounds for cross-sections where each tube is in any of the given stretches (..., n)."""
        moment, kb = c.largest(c.bounds.moment[0], *stretches), c.smallest(c.bounds.bending[0], *stretches)
        # k(0); any positive number where no tube is present, since nothing bends there.
        k_0 = np.where(kb.any(-1), kb.sum(-1), 1.0)
        k_u_0 = np.linalg.norm(kb @ c.direction, axis=-1)
        s = moment.sum(-1)
        # |u| (k(0) - |grad k(0)| |u|) <= |S|: iterated from below, |u| grows towards the least root.
        max_u = s / k_0
        for _ in range(50 if k_u_0.any() else 0):
            max_u = s / np.maximum(k_0 - k_u_0 * max_u, 1e-300)
        stiffness = k_0 - k_u_0 * max_u
        # k_i = kb_i / g_i: the second and third derivatives by u are 2 kb d^2 / g^3 and 6 kb d^3 / g^4 in size.
        g = np.maximum(1 - c.offset * max_u[..., None], 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            k_uu = np.where(kb * c.offset > 0, 2 * kb * c.offset**2 / g**3, 0.0).sum(-1)
            k_uuu = np.where(kb * c.offset > 0, 6 * kb * c.offset**3 / g**4, 0.0).sum(-1)
        # The gradient of k at 0, and its growth up to |u|.
        k_u = k_u_0 + max_u * k_uu
        # d(u k) = k du + u (grad k . du), of which the second part may oppose the first.
        tangent_stiffness = stiffness - max_u * k_u
        pairs = moment[..., :, None] * moment[..., None, :] / stiffness[..., None, None]
        n = moment.shape[-1]
        pairs[..., np.arange(n), np.arange(n)] = 0.0
        return CurvatureBounds(moment, pairs, max_u, stiffness, k_u, k_uu, k_uuu, tangent_stiffness)

    def change(self, dtheta: Array) -> Array:
        """(...) bound on |du| where theta_i changes by at most `dtheta` (..., n)."""
        return np.asarray((self.moment * dtheta).sum(-1) / self.tangent_stiffness)

    def along(self, s: DerivativeBounds) -> tuple[DerivativeBounds, DerivativeBounds]:
        """Curvature u and k / `stiffness` (...), with time derivatives; `s` has the derivatives of S / `stiffness`."""
        # u k(u) = S, differentiated up to three times and solved for the highest derivative of u:
        # (k + u k_u) u' = S',  (k + u k_u) u'' = S'' - (2 k_u + u k_uu) u'^2, and so on.
        ratio, k = self.stiffness / self.tangent_stiffness, self.stiffness
        two, three = 2 * self.k_u / k + self.max_u * self.k_uu / k, (3 * self.k_uu + self.max_u * self.k_uuu) / k
        d = ratio * s.d
        dd = ratio * (s.dd + two * d**2)
        ddd = k_ddd = None
        if s.ddd is not None:
            ddd = ratio * (s.ddd + 3 * two * d * dd + three * d**3)
            k_ddd = (self.k_u * ddd + 3 * self.k_uu * d * dd + self.k_uuu * d**3) / k
        size = DerivativeBounds(np.ones_like(k), self.k_u * d / k, (self.k_u * dd + self.k_uu * d**2) / k, k_ddd)
        return DerivativeBounds(self.max_u, d, dd, ddd), size

    def second(self, x: Array, y: Array) -> Array:
        """(...) bound on the second derivative of u by theta in the directions x and y (..., n)."""
        # (u k)_xy = k u_xy + k_x u_y + k_y u_x + u k_xy, solved for u_xy.
        by_stiffness = (2 * self.k_u + self.max_u * self.k_uu) * self.change(x) * self.change(y)
        return np.asarray(((self.moment * x * y).sum(-1) + by_stiffness) / self.tangent_stiffness)


@dataclass(frozen=True, eq=False)
class TransportBounds:
    """Bounds on the changes of cross-sections (...) that move along n tubes at constant rotations.

    Tubes that vary add them to the time derivatives of curvature and moments. For tubes on the centreline; others do
    not vary.
    """

    still: bool
    """True if nothing varies; everything but 1 / kt and 1 / k is then a 0 without shape."""
    natural_curvature: DerivativeBounds
    """(..., n) bending a_i / k by each tube, with a_i = kb_i u*_xy in the tube's own frame, 1/m."""
    pairs: DerivativeBounds
    """Couplings a_i a_j / k (..., n, n), 0 for i = j."""
    compliance: DerivativeBounds
    """Torsional compliance 1 / kt (..., n)."""
    compliance_slope: DerivativeBounds
    """Derivative d(1 / kt) / ds (..., n) of the torsional compliance."""
    twist_slope: DerivativeBounds
    """(..., n) slopes d u*_z / ds of the natural twist, with one time derivative, rad/m^2."""
    twist_deviation: DerivativeBounds
    """(..., n) difference of the natural twist from a linear function of time; derivatives only."""
    bending_compliance: DerivativeBounds
    """Bending compliance 1 / k (...) of all tubes."""

    @staticmethod
    def of(c: Constants, move: Array, *stretches: Index) -> TransportBounds:
        """Bounds for cross-sections in the given stretches (..., n) that move by `move` (..., n), m, in unit time."""
        b, none = c.bounds, np.zeros(())
        kb = c.smallest(b.bending[0], *stretches)
        kb = np.where(kb.any(-1, keepdims=True), kb, 1.0)
        if c.still:
            nothing, bending_compliance = (
                DerivativeBounds(none, none, none, none),
                DerivativeBounds(1 / kb.sum(-1), none, none, none),
            )
            compliance = DerivativeBounds(1 / c.smallest(b.torsional, *stretches), none, none, none)
            return TransportBounds(
                still=True,
                natural_curvature=nothing,
                pairs=nothing,
                compliance=compliance,
                compliance_slope=nothing,
                twist_slope=nothing,
                twist_deviation=nothing,
                bending_compliance=bending_compliance,
            )

        def by_time(value: Array, *rates: Array) -> DerivativeBounds:
            # d/dt = move d/ds, for every order.
            rows = [c.largest(rate, *stretches) * move ** (k + 1) for k, rate in enumerate(rates)]
            return DerivativeBounds(value, *rows, *(np.zeros_like(value) for _ in range(3 - len(rows))))

        bending_compliance = inverse(by_time(kb, *b.bending[1:]).map(lambda part: part.sum(-1)))
        moment = by_time(c.largest(b.moment[0], *stretches), *b.moment[1:])
        natural = moment * bending_compliance.map(lambda part: part[..., None])
        pairs = natural.map(lambda part: part[..., :, None]) * moment.map(lambda part: part[..., None, :])
        pairs = pairs.map(lambda part: part * (1 - np.eye(part.shape[-1])))
        compliance = by_time(1 / c.smallest(b.torsional, *stretches), *b.compliance)
        slope, bend, third = (c.largest(rate, *stretches) for rate in b.compliance)
        compliance_slope = DerivativeBounds(slope, bend * move, third * move**2)
        twist_slope = by_time(c.largest(b.twist[1], *stretches), b.twist[2])
        twist_deviation = DerivativeBounds(
            np.zeros_like(move), twist_slope.v * move**2 / 2, twist_slope.v * move**2, twist_slope.d * move**2
        )
        return TransportBounds(
            False, natural, pairs, compliance, compliance_slope, twist_slope, twist_deviation, bending_compliance
        )

    def bend(self, turn: Array, second_derivative: Array) -> tuple[Array, Array]:
        """(...) additions to the derivatives u_t, u_tt; `turn` bounds |theta_t|, `second_derivative` |theta_tt|."""
        # (a e)'' without a theta'^2, which is there for tubes that do not vary as well.
        a = self.natural_curvature
        return (
            (a.d, a.dd)
            if self.still
            else (a.d.sum(-1), np.asarray((2 * a.d * turn + a.dd + a.v * second_derivative).sum(-1)))
        )

    def moment(self, pair: Array, second_derivative: Array) -> tuple[Array, Array]:
        """(..., n) additions to those of the moments; the arguments bound derivatives of theta_i - theta_j."""
        a = self.pairs
        return (
            (a.d, a.dd)
            if self.still
            else (a.d.sum(-1), np.asarray((2 * a.d * pair + a.dd + a.v * second_derivative).sum(-1)))
        )

    def gain(self, pair: Array) -> Array:
        """(..., n) time derivative of a_i a_j sin(theta_i - theta_j) / k, where the angle is at most `pair`."""
        return self.pairs.d if self.still else np.asarray((self.pairs.d * pair).sum(-1))


# Breakpoints are sums of lengths, exact to round-off of these.
SWAPPED = 1e-9
"""Largest round-off (m) of the order of breakpoints at the ends of an interval."""

# Stiffness and torsion jump where a piece of a tube ends.
JUMP = 1e-9
"""Offset for one-sided limits at breakpoints, m."""

PARTS = 4
"""Number of stretches between samples of every section."""

# Torques jump at the ends of sections where moments act.
EDGE = 1e-6
"""Distance of the end samples of a section from its ends, as a fraction of it; below half a stretch."""

# Integrals of the Peano kernels of the interpolation.
SHAPE_ERROR = 1 / 96, 1 / 384
"""Factors of h^3 |p'''| and of h^4 |p''''| in two bounds on the error of cubic Hermite interpolation, step h."""

WITHIN = 1 / 6
"""Factor of x^2 (1 - x)^2 h^3 |p'''| in the bound at a fraction x of the step.

In the middle it is 1 / 96.
"""


class _Steps(NamedTuple):
    """Interpolation steps between neighbouring points of a solution, and positions (...) within them."""

    first: Index
    """(...) point at the start of the step."""
    last: Index
    """(...) point at its end."""
    length: Array
    """(...) lengths of the steps, m."""
    fraction: Array
    """(...) fractions of the step, 0 to 1."""


@dataclass(frozen=True, eq=False)
class SolvedArms:
    """Arrays of E equilibria, with their P points along the arm in one row."""

    constants: Constants
    equilibria: tuple[Equilibrium, ...]
    first: Index
    """(E + 1,) number of the first point of every equilibrium, and P."""
    arc_length: Array
    """(P,) arc lengths of the points, m."""
    position: Array
    """(P, 3) positions of the points, m."""
    tangent: Array
    """(P, 3) unit tangents."""
    rotation: Array
    """(P, n) rotations theta of the tubes, rad."""
    torsion: Array
    """(P, n) torsion theta', rad/m; where it jumps, the value on the side of the plate."""

    @classmethod
    def of(cls, constants: Constants, equilibria: Sequence[Equilibrium], **more: Any) -> Self:
        """Arrays of a list of equilibria; `more`: fields of a subclass."""
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
        """(E, n) translations of the equilibria, m."""
        return np.array([e.translations for e in self.equilibria])

    @cached_property
    def breakpoints(self) -> Array:
        """(E, C n) arc lengths of the breakpoints, m."""
        return self.constants.breakpoints(self.translations)

    @property
    def load_positions(self) -> Array:
        """(F,) further arc lengths of section ends, m, clipped to the length of each arm."""
        return np.zeros(0)

    @property
    def kicks(self) -> Array:
        """(P, n) decrease of the torque at the points, N m."""
        return np.zeros(self.rotation.shape)

    @cached_property
    def _key(self) -> tuple[Array, float]:
        stride = 2.0 * float(self.arc_length.max(initial=0.0)) + 1e-3
        return self.arc_length + self.owner * stride, stride

    @cached_property
    def owner(self) -> Index:
        """(P,) number of the equilibrium of every point."""
        return np.repeat(np.arange(len(self.equilibria)), np.diff(self.first))

    def along(self, side: float | Array, rows: Index) -> Array:
        """(6, P, n) properties of the tubes (`Lengthwise.values`) at points (P,), as limits from one side."""
        held = self.constants.held(self.translations)[self.owner[rows]]
        s = self.arc_length[rows, None]
        return self.constants.along.values(s - held, s + side * JUMP - held)

    @cached_property
    def _onwards(self) -> Array:
        """(P, n) torsion theta' at the points on the tip side, rad/m.

        It jumps at ends of pieces and at applied moments.
        """
        c, cuts = self.constants, self.breakpoints[self.owner]
        before, after = (c.stretch(self.arc_length + side * JUMP, cuts) for side in (-1, 1))
        jumps = (before != after) & (self.arc_length > JUMP)[:, None]
        jumps |= self.kicks != 0
        rows, out = np.flatnonzero(jumps.any(1)), self.torsion.copy()
        (_, kt, *_, twist, _), (_, kt_after, *_, twist_after, _) = self.along(-1, rows), self.along(1, rows)
        exists, exists_after = (stretch[rows] < c.ended for stretch in (before, after))
        # The torque kt (theta' - u*_z) is continuous except for the moments that act at a point.
        torque = (out[rows] - twist * exists) * kt - self.kicks[rows]
        onwards = torque / kt_after + twist_after * exists_after
        out[rows] = np.where(jumps[rows], onwards, out[rows])
        return out

    def _steps(self, which: Index, s: Array) -> _Steps:
        """Steps that contain arc lengths (...) of equilibria (...)."""
        key, stride = self._key
        low, high = self.first[which], np.maximum(self.first[which + 1] - 2, self.first[which])
        k = np.clip(np.searchsorted(key, s + which * stride, side="right") - 1, low, high)
        after = np.minimum(k + 1, self.first[which + 1] - 1)
        h = self.arc_length[after] - self.arc_length[k]
        x = np.where(h > 0, (s - self.arc_length[k]) / np.where(h > 0, h, 1.0), 0.0)
        return _Steps(k, after, h, np.clip(x, 0.0, 1.0))

    def hermite(self, which: Index, s: Array, values: tuple[Array, Array], slopes: tuple[Array, Array]) -> Array:
        """(..., c) cubic interpolation at arc lengths (...) of equilibria (...).

        `values` and `slopes` (P, c) at all points, each as seen from the tip and from the plate.
        """
        step = self._steps(which, s)
        a, b, x, h = step.first, step.last, step.fraction[..., None], step.length[..., None]
        return np.asarray(cubic(values[0][a], values[1][b], slopes[0][a], slopes[1][b], x, h))

    def hermite_error(self, which: Index, s: Array, third: Array) -> Array:
        """(..., c) bound on the error of `hermite`; `third` (P, c): h^3 |f'''| in the steps after the points."""
        step = self._steps(which, s)
        x = step.fraction
        factor = (WITHIN * x**2 * (1 - x) ** 2)[..., None]
        with np.errstate(invalid="ignore"):  # 0 times an infinite bound
            return np.where(factor > 0, factor * third[step.first], 0.0)

    def points(self, which: Index, s: Array) -> Array:
        """(..., 3) centreline of equilibria (...) at arc lengths (...), m; cubic between the points of the solution."""
        return self.hermite(which, s, (self.position, self.position), (self.tangent, self.tangent))

    def rotations(self, which: Index, s: Array) -> Array:
        """(..., n) rotations theta of equilibria (...) at arc lengths (...), rad."""
        return self.hermite(which, s, (self.rotation, self.rotation), (self._onwards, self.torsion))

    @cached_property
    def inner(self) -> Index:
        """(S,) numbers of the points that are followed by another point of the same equilibrium."""
        return np.flatnonzero(self.owner[1:] == self.owner[:-1])

    @cached_property
    def crossed(self) -> tuple[Index, ...]:
        """Stretches (S, n) of each tube in the step after an `inner` point: one, or up to three for tubes that vary."""
        c, s, cuts = self.constants, self.arc_length, self.breakpoints[self.owner[self.inner]]
        a, b = s[self.inner], s[self.inner + 1]
        if c.still:
            return (c.stretch((a + b) / 2, cuts),)
        low, high = c.stretch(a + JUMP, cuts), c.stretch(b - JUMP, cuts)
        return low, np.maximum((low + high) // 2, low), np.maximum(high, low)

    @property
    def wide(self) -> Mask:
        """(S,) True if the step after an `inner` point contains too many stretches for `crossed`."""
        return np.asarray((self.crossed[-1] - self.crossed[0] >= len(self.crossed)).any(1))

    @cached_property
    def _errors(self) -> tuple[Array, Array]:
        """Bounds `shape_error` (E,), m, and h^3 |theta'''| (P, n) in the steps after the points.

        p'' = R (u_y, -u_x, 0), so that |p'''| <= |u|^2 + |u'| and |p''''| <= |u|^3 + 3 |u| |u'| + |u''|. u' follows
        from the torsion, which is at most its larger end value plus its change over the step.
        """
        c, n = self.constants, self.constants.offset.size
        out, turned = np.array([e.tip_error for e in self.equilibria]), np.zeros((len(self.arc_length), n))
        if not len(self.inner):
            return out, turned
        h, owner = np.diff(self.arc_length)[self.inner], self.owner[self.inner]
        bend, transport = CurvatureBounds.of(c, *self.crossed), TransportBounds.of(c, np.array(1.0), *self.crossed)
        largest, kt = bend.pairs.sum(2), c.smallest(c.bounds.torsional, *self.crossed)
        torque = self._torque(h[:, None] * largest)
        gain = largest / kt + torque * transport.compliance.d + transport.twist_slope.v
        speed = np.maximum(np.abs(self._onwards[self.inner]), np.abs(self.torsion[self.inner + 1])) + h[:, None] * gain
        pair = speed[:, :, None] + speed[:, None, :]
        faster = ((bend.pairs * pair).sum(2) + transport.moment(pair, np.zeros(()))[0]) / kt
        if not c.still:
            faster += 2 * largest * transport.compliance.d + torque * transport.compliance.dd + transport.twist_slope.d
        # Tubes off the centreline: theta' = g w, whose change along the arm has that of g as well.
        twist_slope, gain = gain, gain * (1 + c.offset * bend.max_u[:, None])
        u, (first, second) = bend.max_u, transport.bend(speed, np.zeros(()))
        du = bend.change(speed) + first
        gain += speed * c.offset * du[:, None] / (1 - c.offset * u[:, None])
        ddu = bend.second(speed, speed) + bend.change(gain) + second
        # There theta' = g w, g = 1 - d u: of both.
        lower = 1 - c.offset * u[:, None]
        faster = (1 + c.offset * u[:, None]) * faster + c.offset * (
            2 * du[:, None] * twist_slope + ddu[:, None] * speed / lower
        )
        third, fourth = u**2 + du, u**3 + 3 * u * du + ddu
        error = np.minimum(SHAPE_ERROR[0] * h**3 * third, SHAPE_ERROR[1] * h**4 * fourth)
        np.maximum.at(out, owner, np.where(self.wide, np.inf, error + out[owner]))
        turned[self.inner] = np.where(self.wide[:, None], np.inf, h[:, None] ** 3 * faster)
        return out, turned

    def _torque(self, gain: Array) -> Array:
        """(S, n) bound on the torque in the steps after the `inner` points, N m, where it changes by at most `gain`.

        0 where nothing varies, since nothing needs it there.
        """
        if self.constants.still:
            return np.zeros(())
        torque = []
        for side, slope, rows in ((1, self._onwards, self.inner), (-1, self.torsion, self.inner + 1)):
            _, kt, _, _, twist, _ = self.along(side, rows)
            torque.append(np.abs(slope[rows] - twist) * kt)
        return np.asarray(np.maximum(*torque) + gain)

    @property
    def shape_error(self) -> Array:
        """(E,) bound on the distance of `points` from the exact centreline, m: interpolation and solution error."""
        return self._errors[0]

    def turn_error(self, which: Index, s: Array) -> Array:
        """(..., n) bound on the error of `rotations`, rad."""
        return self.hermite_error(which, s, self._errors[1])


@dataclass(frozen=True, eq=False)
class Intervals:
    """B intervals of time between two equilibria of `arms`, with K = C n + F sections, some of length 0.

    A place of an interval is a section with a fraction x of it: its arc length changes linearly with time.
    """

    arms: SolvedArms
    start: Index
    """(B,) equilibrium at the start."""
    end: Index
    """(B,) equilibrium at the end."""
    start_cuts: Array
    """(B, K + 1) ends of the sections at the start, m."""
    end_cuts: Array
    """(B, K + 1) ends of the sections at the end, m."""
    stretch: Index
    """(B, K, n) stretch of each tube in each section."""
    ordered: Mask
    """(B,) True for intervals in which no breakpoints pass each other, the plate, or a load point."""

    @classmethod
    def of(cls, arms: SolvedArms, start: Index, end: Index) -> Self:
        """Intervals between equilibria (B,) and (B,)."""
        tubes = [arms.breakpoints[e] for e in (start, end)]
        tips = np.stack(tubes).max(2, keepdims=True)
        a, b = (
            np.concatenate([cuts, np.minimum(arms.load_positions, tip)], axis=1)
            for cuts, tip in zip(tubes, tips, strict=True)
        )
        middle = (a + b) / 2
        order = np.argsort(middle, axis=1, kind="stable")
        zero = np.zeros((len(start), 1))
        sides, ordered = [], np.ones(len(start), dtype=bool)
        for points in (a, b, middle):
            sorted_points = np.concatenate([zero, np.maximum(np.take_along_axis(points, order, axis=1), 0.0)], axis=1)
            ordered &= (np.diff(sorted_points, axis=1) >= -SWAPPED).all(1)
            sides.append(np.maximum.accumulate(sorted_points, axis=1))
        # A breakpoint behind the plate at one end and in front of it at the other passes the plate in between.
        ordered &= ~((a < -SWAPPED) & (b > SWAPPED) | (a > SWAPPED) & (b < -SWAPPED)).any(1)
        # Nor may the tip pass a place of the load.
        beyond = arms.load_positions - tips
        ordered &= ~((beyond.min(0) < -SWAPPED) & (beyond.max(0) > SWAPPED)).any(1)
        breakpoints = (tubes[0] + tubes[1])[:, None] / 2
        stretch = arms.constants.stretch((sides[2][:, :-1] + sides[2][:, 1:]) / 2, breakpoints)
        return cls(arms, start, end, sides[0], sides[1], stretch, ordered)

    @cached_property
    def bending(self) -> CurvatureBounds:
        """Bounds on the curvature in every section, (B, K)."""
        return CurvatureBounds.of(self.arms.constants, self.stretch)

    @cached_property
    def moved(self) -> Array:
        """(B, K, n) bound on how far a point moves along each tube during the interval, m."""
        c, shift = self.arms.constants, self.arms.translations
        held = c.held(shift[self.end]) - c.held(shift[self.start])
        ends = np.abs((self.end_cuts - self.start_cuts)[:, :, None] - held[:, None])
        return np.asarray(np.maximum(ends[:, :-1], ends[:, 1:]))

    @cached_property
    def transport(self) -> TransportBounds:
        """Bounds (B, K) on the changes of cross-sections because tubes that vary along their length move."""
        return TransportBounds.of(self.arms.constants, self.moved, self.stretch)

    @cached_property
    def torsional(self) -> Array:
        """(B, K, n) lower bound on kt, N m^2."""
        return self.arms.constants.smallest(self.arms.constants.bounds.torsional, self.stretch)

    @cached_property
    def transmission(self) -> DerivativeBounds:
        """(B, n) compliances int ds / kt from the clamped end to the plate, 1/(N m)."""
        c = self.arms.constants
        compliance = c.along.compliant(-c.held(self.arms.translations))
        plain = linear(compliance[self.start], compliance[self.end])
        if self.transport.still:
            return plain
        # Its rate is 1 / kt at the plate, times the speed of the tube there.
        moved = self.transport.compliance_slope.map(lambda bound: bound[:, 0] * self.moved[:, 0] ** 2)
        return DerivativeBounds(plain.v, plain.d + moved.v / 2, moved.v, moved.d)

    @cached_property
    def radius(self) -> Array:
        """(B, K) outer radius of the arm in each section, m."""
        present = self.stretch < self.arms.constants.ended
        return np.asarray(np.where(present, self.arms.constants.radius, 0.0).max(2))

    @cached_property
    def length(self) -> tuple[Array, Array]:
        """(B, K) lengths of the sections at the start and at the end, m."""
        return np.diff(self.start_cuts, axis=1), np.diff(self.end_cuts, axis=1)

    def positions(self, which: Index, section: Index, x: Array) -> tuple[Array, Array]:
        """(..., 3) points of both equilibria at fractions x (...) of sections (...) of intervals `which` (...), m."""
        points = []
        for e, cuts in ((self.start, self.start_cuts), (self.end, self.end_cuts)):
            low, high = cuts[which, section], cuts[which, section + 1]
            points.append(self.arms.points(e[which], low + x * (high - low)))
        return points[0], points[1]

    def sagitta(self, which: Index, section: Index, x: Array) -> Array:
        """(N,) bound on the distance of arms from their chords between fractions x (N, 2) of sections, m."""
        long = np.maximum(*self.length)[which, section] * (x[:, 1] - x[:, 0])
        return np.asarray(self.bending.max_u[which, section] * long**2 / 8)

    @property
    def parts(self) -> tuple[tuple[Index, Array], tuple[Index, Array]]:
        """Equilibria and arc lengths (B, K, PARTS + 1) of the samples along each section, at both ends
        of the interval.
        """
        x = np.linspace(0.0, 1.0, PARTS + 1).clip(EDGE, 1 - EDGE)
        before, after = (
            cuts[:, :-1, None] + x * np.diff(cuts, axis=1)[:, :, None] for cuts in (self.start_cuts, self.end_cuts)
        )
        start, end = (np.broadcast_to(e[:, None, None], before.shape) for e in (self.start, self.end))
        return (start, before), (end, after)

    @cached_property
    def changes(self) -> tuple[Array, Array]:
        """Bounds on the changes of theta_i (B, K, n) and of theta_i - theta_j (B, K, n, n) during the interval.

        They hold at the samples, and contain the errors of interpolation there.
        """
        start, end = self.parts
        change = self.arms.rotations(*end) - self.arms.rotations(*start)
        wrong = self.arms.turn_error(*start) + self.arms.turn_error(*end)
        pairs = np.abs(change[..., :, None] - change[..., None, :]) + wrong[..., :, None] + wrong[..., None, :]
        return (np.abs(change) + wrong).max(2), pairs.max(2)
