"""Equilibria under a dead load as arrays: torques, moments and forces along the arm, with their bounds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from ..robots.load import FORCE, MOMENT, Load, Stretch, masses
from ..robots.order import outermost, twisted_tube
from ..robots.robot import Robot
from ..typing import Array, Index, Mask
from .sections import (
    JUMP,
    SHAPE_ERROR,
    CurvatureBounds,
    DerivativeBounds,
    Intervals,
    SolvedArms,
    TransportBounds,
    unit_vector,
)


def uncovered(load: Load) -> str:
    """Description of a part of a load that the bounds do not cover; "" if all is covered."""
    if load.frame == "tip" and (any(load.force) or any(load.moment)):
        return "a force or a moment that turns with the tip"
    return "a load per length that is a function of the arc length" if callable(load.distributed) else ""


@dataclass(frozen=True, eq=False)
class DeadLoad:
    """Dead load on n tubes: forces and moments in world axes."""

    at: Array
    """(Q,) arc lengths of point loads, m; the last is the tip, at infinity."""
    points: Array
    """(Q, 6) forces (N) and moments (N m) of the point loads."""
    stretches: Array
    """(R, 2) start and end of loads per length, m."""
    along: Array
    """(R, 6) forces, N/m, and moments, N, per length."""
    weight: Array
    """(n, 3) weight of each tube per length, N/m."""

    @property
    def per_length(self) -> tuple[float, float]:
        """Bounds on the force, N/m, and on the moment, N, per length."""
        force = np.linalg.norm(self.along[:, FORCE], axis=1).sum() + np.linalg.norm(self.weight, axis=1).sum()
        return float(force), float(np.linalg.norm(self.along[:, MOMENT], axis=1).sum())

    @staticmethod
    def of(robot: Robot, load: Load) -> DeadLoad:
        """Arrays of a load that is covered completely."""
        distributed: Any = load.distributed or ()
        uniform = [Stretch(0.0, np.inf, distributed)] * bool(distributed)
        parts = distributed if distributed and isinstance(distributed[0], Stretch) else uniform
        gravity = np.zeros(3) if load.gravity is None else np.array(load.gravity)
        return DeadLoad(
            at=np.array([part.at for part in load.acting]),
            points=np.array([(*part.force, *part.moment) for part in load.acting]),
            stretches=np.array([(part.start, part.end) for part in parts]).reshape(-1, 2),
            along=np.array([(*part.force, *part.moment) for part in parts]).reshape(-1, 6),
            weight=masses(robot.tubes, load)[:, None] * gravity,
        )

    @cached_property
    def load_positions(self) -> Array:
        """(F,) arc lengths where the load or its derivative jumps, m."""
        return np.unique(np.concatenate([self.at[:-1], self.stretches.ravel()]))

    def twists(self, ends: Array) -> Mask:
        """(E, Q, n) True for the tube that each point moment twists, for ends of the tubes (E, n)."""
        return np.asarray(twisted_tube(ends[:, None], self.at)[..., None] == np.arange(ends.shape[1]))

    def on(self, s: Array, ends: Array, inside: Array) -> Array:
        """(..., 6) total force and moment between arc lengths s (...) and the tip, for tubes that end at `ends` (...,
        n).

        At jumps the limit from the side of the arc lengths `inside` (...).
        """
        out = (self.at > inside[..., None]) @ self.points
        out[..., FORCE] += np.maximum(ends - s[..., None], 0.0) @ self.weight
        # A load per length ends with the longest tube, even if its stretch is longer.
        far = np.minimum(self.stretches[:, 1], ends.max(-1)[..., None]) - np.maximum(self.stretches[:, 0], s[..., None])
        return np.asarray(out + np.maximum(far, 0.0) @ self.along)

    def per_length_at(self, s: Array) -> Array:
        """(..., 3) applied moment per length at arc lengths (...), N."""
        inside = (self.stretches[:, 0] < s[..., None]) & (s[..., None] < self.stretches[:, 1])
        return np.asarray(inside @ self.along[:, MOMENT])


def _on_outermost(size: Array, exists: Mask) -> Array:
    """(..., n) value `size` (...) for the outermost existing tube, 0 for all others."""
    return np.asarray(size[..., None] * (exists & (outermost(exists)[..., None] == np.arange(exists.shape[-1]))))


@dataclass(frozen=True, eq=False)
class LoadedArms(SolvedArms):
    """Arrays of equilibria under a load."""

    load: DeadLoad

    @cached_property
    def ends(self) -> Array:
        """(E, n) arc lengths of the ends of the tubes, m."""
        return np.array([e.tube_end for e in self.equilibria])

    @property
    def load_positions(self) -> Array:
        """(F,) arc lengths at which the load acts, m."""
        return self.load.load_positions

    @cached_property
    def _inside(self) -> tuple[Array, Array]:
        """(P,) arc lengths next to the points, slightly towards the tip and towards the plate, m."""
        s = self.arc_length
        return s + JUMP, np.where(s > JUMP, s - JUMP, s + JUMP)

    @cached_property
    def _sides(self) -> tuple[Index, Index]:
        """(P, n) stretches of the tubes on either side of each point, towards the tip and the plate."""
        cuts = self.breakpoints[self.owner]
        ahead, before = (self.constants.stretch(s, cuts) for s in self._inside)
        return ahead, before

    @cached_property
    def _felt(self) -> tuple[Array, Array]:
        """(P, 6) total force and moment between each point and the tip, on either side of the point."""
        ahead, before = (self.load.on(self.arc_length, self.ends[self.owner], s) for s in self._inside)
        return ahead, before

    @cached_property
    def _frames(self) -> Array:
        """(P, 3, 3) frames at the points."""
        return np.concatenate([e.frame for e in self.equilibria])

    @cached_property
    def kicks(self) -> Array:
        """(P, n) decrease of the torques by point moments, N m."""
        torque = self.tangent @ self.load.points[:, MOMENT].T
        torque *= np.abs(self.arc_length[:, None] - self.load.at) <= JUMP
        return np.asarray((torque[..., None] * self.load.twists(self.ends)[self.owner]).sum(1))

    @cached_property
    def _values(self) -> tuple[Array, Array]:
        """(6, P, n) `Lengthwise.values` at the points, on the side of the tip and of the plate.

        Without precurvature and bending stiffness beyond the end of a tube.
        """
        tables, sides = [], (np.array(1.0), np.where(self.arc_length > JUMP, -1.0, 1.0)[:, None])
        for side, stretch in zip(sides, self._sides, strict=True):
            table = self.along(side, np.arange(len(stretch)))
            table[[0, 2, 3, 4]] *= stretch < self.constants.ended
            tables.append(table)
        return tables[0], tables[1]

    def _moments(self, values: Array) -> tuple[Array, Array]:
        """Moments a_i (P, n, 2) of the tubes, N m, and total bending stiffness K (P,), N m^2."""
        stiffness, _, x, y, *_ = values
        cos, sin = np.cos(self.rotation), np.sin(self.rotation)
        return stiffness[..., None] * np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1), stiffness.sum(-1)

    @cached_property
    def torque(self) -> Array:
        """(P, n) torques of the tubes, N m."""
        _, kt, _, _, twist, _ = self._values[1]
        return np.asarray((self.torsion - twist) * kt * (self._sides[1] < self.constants.ended))

    @cached_property
    def moment(self) -> Array:
        """(P, 2) bending moment of the bundle in the Bishop frame, N m."""
        moments, stiffness = self._moments(self._values[1])
        bent = np.concatenate([e.curvature for e in self.equilibria])
        return np.asarray(stiffness[:, None] * bent - moments.sum(1))

    @cached_property
    def reactions(self) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """Torques (P, n) and moments (P, 2) on either side of each point; point moments make them jump."""
        # In the cross-section's own frame, of which the first two axes bend.
        jump = np.einsum("pij,pi->pj", self._frames, (self._felt[1] - self._felt[0])[:, MOMENT])[:, :2]
        return (self.torque - self.kicks, self.torque), (self.moment - jump, self.moment)

    @cached_property
    def slopes(self) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """Slopes d torque / ds (P, n) and d moment / ds (P, 2), one-sided.

        Each on the side of the tip and of the plate.
        """
        sides = []
        for k, values in enumerate(self._values):
            moments, stiffness = self._moments(values)
            straight = np.where(stiffness > 0, stiffness, 1.0)[:, None]
            torque, moment = (each[k] for each in self.reactions)
            x, y = ((moment + moments.sum(1)) / straight).T
            force = np.einsum("pij,pi->pj", self._frames, self._felt[k][:, FORCE])
            along = np.einsum("pij,pi->pj", self._frames, self.load.per_length_at(self._inside[k]))
            # Balance of torques of a tube: t' = u_x a_y - u_y a_x; moments per length act on the outermost tube.
            twisting = x[:, None] * moments[:, :, 1] - y[:, None] * moments[:, :, 0]
            twisting -= _on_outermost(along[:, 2], self._sides[k] < self.constants.ended)
            torsion = torque.sum(1)
            # Balance of bending moments: m' = (n_y, -n_x) + t (-u_y, u_x), with the total torque t of the tubes.
            bending = np.stack([force[:, 1] - y * torsion, x * torsion - force[:, 0]], axis=1) - along[:, :2]
            sides.append((twisting, bending))
        (torque_tip, moment_tip), (torque_plate, moment_plate) = sides
        return (torque_tip, torque_plate), (moment_tip, moment_plate)

    def sampled(self, which: Index, s: Array) -> tuple[Array, Array]:
        """(..., n) torques and (..., 2) moments of equilibria (...) at arc lengths (...)."""
        torque, moment = (
            self.hermite(which, s, values, slopes) for values, slopes in zip(self.reactions, self.slopes, strict=True)
        )
        return torque, moment

    @property
    def shape_error(self) -> Array:
        """(E,) bound on the distance of `points` from the exact centreline, m."""
        return self._wrong[0]

    def turn_error(self, which: Index, s: Array) -> Array:
        """(..., n) bound on the error of `rotations`, rad."""
        return self.hermite_error(which, s, self._wrong[1])

    def load_error(self, which: Index, s: Array) -> tuple[Array, Array]:
        """Bounds on the errors of `sampled` torques (..., n) and moments (...), N m."""
        return self.hermite_error(which, s, self._wrong[2]), self.hermite_error(which, s, self._wrong[3])[..., 0]

    @cached_property
    def _wrong(self) -> tuple[Array, ...]:
        """`shape_error` (E,), and h^3 |f'''| of rotations (P, n), torques (P, n) and moments (P, 1) in the steps.

        Each value is of the step after its point.
        """
        c, inner, n = self.constants, self.inner, self.constants.offset.size
        count = len(self.arc_length)
        out = np.array([e.tip_error for e in self.equilibria])
        errors = out, np.zeros((count, n)), np.zeros((count, n)), np.zeros((count, 1))
        if not len(inner):
            return errors
        h, owner = np.diff(self.arc_length)[inner], self.owner[inner]
        bend = CurvatureBounds.of(c, *self.crossed)
        transport, moment_rates = (
            TransportBounds.of(c, np.array(1.0), *self.crossed),
            [c.largest(each, *self.crossed) for each in c.bounds.moment],
        )
        loads = self._felt[0][inner], self._felt[1][inner + 1]
        force = np.maximum(*(np.linalg.norm(each[:, FORCE], axis=1) for each in loads))
        # The moment is at most that of the load on a straight arm. A torque grows by |u| |a| per length, and by applied
        # moments on its tube.
        moment, (along, couple) = self._lever[owner], self.load.per_length
        u = bend.max_u + moment / bend.stiffness
        grows = u[:, None] * bend.moment + couple
        torque = np.maximum(np.abs(self.reactions[0][0][inner]), np.abs(self.torque[inner + 1])) + h[:, None] * grows
        compliance, twist_slope = transport.compliance, transport.twist_slope
        turn = torque * compliance.v + c.largest(c.bounds.twist[0], *self.crossed)
        turning = grows * compliance.v + torque * compliance.d + twist_slope.v
        swing = unit_vector(DerivativeBounds(turn, turn, turning))
        total, growing = torque.sum(1), grows.sum(1)
        bending = force + u * total + couple
        by_tubes = replace(transport.natural_curvature, v=bend.moment / bend.stiffness[:, None], ddd=None) * swing
        du = bending / bend.stiffness + moment * transport.bending_compliance.d + by_tubes.d.sum(1)
        a = DerivativeBounds(*moment_rates[:3]) * swing
        grown = du[:, None] * a.v + u[:, None] * a.d + couple * u[:, None]
        turned_on = grown * compliance.v + 2 * grows * compliance.d + torque * compliance.dd + twist_slope.d
        bent = force * u + along + du * total + u * growing + couple * u
        ddu = (
            bent / bend.stiffness
            + 2 * bending * transport.bending_compliance.d
            + moment * transport.bending_compliance.dd
            + by_tubes.dd.sum(1)
        )
        turning_along = couple * (du + u**2)
        twisted = ddu[:, None] * a.v + 2 * du[:, None] * a.d + u[:, None] * a.dd + turning_along[:, None]
        lifted = force * (du + u**2) + 2 * u * along + ddu * total + 2 * du * growing + u * grown.sum(1) + turning_along
        # The third derivative of the centreline is at most |u|^2 + |u'|.
        shape = SHAPE_ERROR[0] * h**3 * (u**2 + du) + out[owner]
        np.maximum.at(out, owner, np.where(self.wide, np.inf, shape))
        for error, third in zip(errors[1:], (turned_on, twisted, lifted[:, None]), strict=True):
            error[inner] = np.where(self.wide[:, None], np.inf, h[:, None] ** 3 * third)
        return errors

    @cached_property
    def _lever(self) -> Array:
        """(E,) bound on the moment that the load exerts on the bundle, N m."""
        length, p = self.ends.max(1), self.load
        force, moment = (np.linalg.norm(p.points[:, k], axis=1) for k in (FORCE, MOMENT))
        start, end = (np.minimum(each, length[:, None]) for each in p.stretches.T[:, None])
        per_length, couple = (np.linalg.norm(p.along[:, k], axis=1) for k in (FORCE, MOMENT))
        # However an arm is bent, a force at s has a lever of at most s; a weight over all of it has L^2 / 2.
        out = np.minimum(p.at, length[:, None]) @ force + moment.sum()
        out += length**2 / 2 * np.linalg.norm(p.weight, axis=1).sum()
        return np.asarray(out + (end**2 - start**2) @ per_length / 2 + (end - start) @ couple)


@dataclass(frozen=True, eq=False)
class SampledLoads:
    """Bounds at the samples along the arm at both ends of B intervals with K sections."""

    torque: Array
    """(B, K, n) torques of the tubes, N m."""
    torque_change: Array
    """(B, K, n) differences of torques between both ends, N m."""
    moment_change: Array
    """(B, K) differences of moments between both ends, N m."""


@dataclass(frozen=True, eq=False)
class LoadedIntervals(Intervals):
    """Intervals between neighbouring equilibria under a load."""

    arms: LoadedArms

    @classmethod
    def of(cls, arms: SolvedArms, start: Index, end: Index) -> Self:
        """Intervals between equilibria (B,) and (B,); not `ordered` where a moment passes to another tube."""
        intervals = super().of(arms, start, end)
        assert isinstance(arms, LoadedArms)
        twists = arms.load.twists(arms.ends)[:, arms.load.points[:, MOMENT].any(1)]
        same = (twists[start] == twists[end]).all((1, 2))
        return replace(intervals, ordered=intervals.ordered & same)

    @cached_property
    def _loads(self) -> tuple[DerivativeBounds, DerivativeBounds]:
        """(B, K) total force, N, and applied moment, N m, up to the tip; linear along sections and in time."""
        tables = []
        for e, cuts in ((self.start, self.start_cuts), (self.end, self.end_cuts)):
            ends, inside = self.arms.ends[e][:, None], (cuts[:, :-1] + cuts[:, 1:]) / 2
            tables.append([self.arms.load.on(s, ends, inside) for s in (cuts[:, :-1], cuts[:, 1:])])
        table, jets = np.array(tables), []
        for part in (FORCE, MOMENT):
            size = np.linalg.norm(table[..., part], axis=-1).max((0, 1))
            change = np.linalg.norm((table[1] - table[0])[..., part], axis=-1).max(0)
            jets.append(DerivativeBounds(size, change, np.zeros_like(size), np.zeros_like(size)))
        return jets[0], jets[1]

    @property
    def force(self) -> DerivativeBounds:
        """(B, K) force on the cross-sections, N."""
        return self._loads[0]

    @cached_property
    def couple(self) -> DerivativeBounds:
        """(B, K) bound on the applied moments between each section and the tip, N m; never larger towards the tip."""
        return self._loads[1].map(lambda bound: np.maximum.accumulate(bound[:, ::-1], axis=1)[:, ::-1])

    @cached_property
    def twisting(self) -> tuple[Array, Array]:
        """(B, K, n) sizes of applied moments on each tube, at the ends of the sections, N m, and per length, N."""
        load, cuts = self.arms.load, (self.start_cuts + self.end_cuts) / 2
        middle, moment = (cuts[:, :-1] + cuts[:, 1:]) / 2, np.linalg.norm(load.points[:, MOMENT], axis=1)
        # Number of sections before each moment; at the plate a moment twists nothing.
        before = (middle[..., None] < np.minimum(load.at, cuts[:, -1:])[:, None]).sum(1)
        acts = np.arange(1, middle.shape[1] + 1)[:, None] == before[:, None]
        at_ends = acts @ (moment[:, None] * load.twists(self.arms.ends[self.start]))
        size = np.linalg.norm(load.per_length_at(middle), axis=-1)
        return at_ends, _on_outermost(size, self.stretch < self.arms.constants.ended)

    @cached_property
    def lever(self) -> Array:
        """(B, K) bound on the bending moment of the load, N m, for any shape of the arm."""
        each = np.maximum(*self.length) * self.force.v
        return np.asarray(np.cumsum(each[:, ::-1], axis=1)[:, ::-1] + self.couple.v)

    @cached_property
    def bending(self) -> CurvatureBounds:
        """Bounds on the curvature in every section, (B, K), with the load."""
        plain = CurvatureBounds.of(self.arms.constants, self.stretch)
        return replace(plain, max_u=plain.max_u + self.lever / plain.stiffness)

    @cached_property
    def loads(self) -> SampledLoads:
        """Torques and moments at the ends of PARTS stretches of each section, with interpolation errors."""
        (torque, moment), (torque_end, moment_end) = (self.arms.sampled(*positions) for positions in self.parts)
        errors = zip(*(self.arms.load_error(*positions) for positions in self.parts), strict=True)
        torque_error, moment_error = (start + end for start, end in errors)
        return SampledLoads(
            torque=(np.maximum(np.abs(torque), np.abs(torque_end)) + torque_error).max(2),
            torque_change=(np.abs(torque_end - torque) + torque_error).max(2),
            moment_change=(np.linalg.norm(moment_end - moment, axis=-1) + moment_error).max(2),
        )
