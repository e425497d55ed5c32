"""Equilibria under a dead load along the arm: the torque and the moment that it bears, and the force on it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..robots.load import Load, masses
from ..robots.robot import Robot
from ..typing import Array, Index
from .cross_sections import Bending, Drift, Jet, turned
from .sections import JUMP, SHAPE_ERROR, Arms, Intervals


def uncovered(load: Load) -> str:
    """What of a load `Pull` has no words for; empty where it has."""
    if not load.has_energy:
        return "a moment, or a force that turns with the tip"
    if load.points:
        return "forces at points along the arm"
    return "" if load.distributed is None or _even(load) else "a load per length that changes along the arm"


def _even(load: Load) -> bool:
    along = load.distributed
    return isinstance(along, tuple) and all(isinstance(x, float) for x in along)


@dataclass(frozen=True, eq=False)
class Pull:
    """A dead load on n tubes: force (3,) on the tip, N, on the whole arm (3,), and on each tube (n, 3), N/m."""

    tip: Array
    along: Array
    weight: Array

    @property
    def per_length(self) -> float:
        """Bound of the force per length, N/m."""
        return float(np.linalg.norm(self.along) + np.linalg.norm(self.weight, axis=1).sum())

    @staticmethod
    def of(robot: Robot, load: Load) -> Pull:
        """Of a load all of which is covered."""
        along = np.array(load.distributed if _even(load) else np.zeros(3), dtype=float)
        gravity = np.zeros(3) if load.gravity is None else np.array(load.gravity)
        return Pull(np.array(load.force), along, masses(robot.tubes, load)[:, None] * gravity)

    def on(self, s: Array, ends: Array) -> Array:
        """(..., 3) force on the cross-section at arc lengths (...) of arms whose tubes end at (..., n)."""
        left = np.maximum(ends - s[..., None], 0.0)
        return np.asarray(self.tip + left.max(-1)[..., None] * self.along + left @ self.weight)


@dataclass(frozen=True, eq=False)
class LoadedArms(Arms):
    """Equilibria under a load, one after the other."""

    pull: Pull

    @cached_property
    def ends(self) -> Array:
        """(E, n) arc lengths of the ends of the tubes, m."""
        return np.array([e.tube_end for e in self.equilibria])

    @cached_property
    def _sides(self) -> tuple[Index, Index]:
        """Stretches (P, n) in which points lie, as seen from the tip and from the plate."""
        s, cuts = self.arc_length, self.breakpoints[self.owner]
        before = np.where(s > JUMP, s - JUMP, s + JUMP)
        return self.constants.stretch(s + JUMP, cuts), self.constants.stretch(before, cuts)

    @cached_property
    def _values(self) -> tuple[Array, Array]:
        """(6, P, n) what tubes are like at the points, as seen from the tip and from the plate; where they have ended
        with neither precurvature nor bending stiffness."""
        tables, sides = [], (np.array(1.0), np.where(self.arc_length > JUMP, -1.0, 1.0)[:, None])
        for side, stretch in zip(sides, self._sides, strict=True):
            table = self.along(side, np.arange(len(stretch)))
            table[[0, 2, 3, 4]] *= stretch < self.constants.ended
            tables.append(table)
        return tables[0], tables[1]

    def _pulls(self, values: Array) -> tuple[Array, Array]:
        """a_i (P, n, 2), N m, and K (P,), N m^2."""
        stiffness, _, x, y, *_ = values
        cos, sin = np.cos(self.rotation), np.sin(self.rotation)
        return stiffness[..., None] * np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1), stiffness.sum(-1)

    @cached_property
    def torque(self) -> Array:
        """(P, n) what each tube bears, N m."""
        _, kt, _, _, twist, _ = self._values[1]
        return np.asarray((self.torsion - twist) * kt * (self._sides[1] < self.constants.ended))

    @cached_property
    def moment(self) -> Array:
        """(P, 2) bending moment of the load, in the Bishop frame, N m."""
        pulls, stiffness = self._pulls(self._values[1])
        bent = np.concatenate([e.curvature for e in self.equilibria])
        return np.asarray(stiffness[:, None] * bent - pulls.sum(1))

    @cached_property
    def slopes(self) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """d torque / ds (P, n) and d moment / ds (P, 2), towards the tip and from the plate."""
        frame = np.concatenate([e.frame for e in self.equilibria])
        force = np.einsum("pij,pi->pj", frame, self.pull.on(self.arc_length, self.ends[self.owner]))
        sides = []
        for values in self._values:
            pulls, stiffness = self._pulls(values)
            straight = np.where(stiffness > 0, stiffness, 1.0)[:, None]
            x, y = ((self.moment + pulls.sum(1)) / straight).T
            torsion = self.torque.sum(1)
            twisting = x[:, None] * pulls[:, :, 1] - y[:, None] * pulls[:, :, 0]
            bending = np.stack([force[:, 1] - y * torsion, x * torsion - force[:, 0]], axis=1)
            sides.append((twisting, bending))
        (one, other), (three, four) = sides
        return (one, three), (other, four)

    def sampled(self, which: Index, s: Array) -> tuple[Array, Array]:
        """(..., n) torques and (..., 2) moments of equilibria (...) at arc lengths (...)."""
        torque, moment = (
            self.hermite(which, s, values, slopes)
            for values, slopes in zip((self.torque, self.moment), self.slopes, strict=True)
        )
        return torque, moment

    @property
    def shape_error(self) -> Array:
        """(E,) bound of the distance of `points` from the centreline, m."""
        return self._wrong[0]

    @property
    def turn_error(self) -> Array:
        """(E, n) bound of the error of interpolation of `rotations`, rad."""
        return self._wrong[1]

    @property
    def load_error(self) -> tuple[Array, Array]:
        """(E, n) and (E,) the same of torques and moments that are `sampled`, N m."""
        return self._wrong[2], self._wrong[3]

    @cached_property
    def _wrong(self) -> tuple[Array, ...]:
        """Of cubic Hermite interpolation, by third derivatives along the arm: |p'''| <= |u|^2 + |u'|."""
        c, inner, n = self.constants, self.inner, self.constants.offset.size
        count = len(self.equilibria)
        out = np.array([e.tip_error for e in self.equilibria])
        errors = out, np.zeros((count, n)), np.zeros((count, n)), np.zeros(count)
        if not len(inner):
            return errors
        h, owner = np.diff(self.arc_length)[inner], self.owner[inner]
        bend, ends = Bending.of(c, *self.crossed), self.ends[owner]
        drift, pull = Drift.of(c, np.array(1.0), *self.crossed), [c.most(each, *self.crossed) for each in c.bounds.pull]
        pulls = (self.pull.on(self.arc_length[k], ends) for k in (inner, inner + 1))
        force = np.maximum(*(np.linalg.norm(each, axis=1) for each in pulls))
        # No moment is larger than the forces ahead make on a straight arm; torque grows by |u| |a| per length.
        moment, along = self._lever[owner], self.pull.per_length
        u = bend.most + moment / bend.stiffness
        grows = u[:, None] * bend.moment
        torque = np.maximum(np.abs(self.torque[inner]), np.abs(self.torque[inner + 1])) + h[:, None] * grows
        ease, wound = drift.ease, drift.wound
        turn = torque * ease.v + c.most(c.bounds.twist[0], *self.crossed)
        turning = grows * ease.v + torque * ease.d + wound.v
        swing = turned(Jet(turn, turn, turning))
        whole, growing = torque.sum(1), grows.sum(1)
        bending = force + u * whole
        by_tubes = replace(drift.pulls, v=bend.moment / bend.stiffness[:, None], ddd=None) * swing
        du = bending / bend.stiffness + moment * drift.give.d + by_tubes.d.sum(1)
        a = Jet(*pull[:3]) * swing
        grown = du[:, None] * a.v + u[:, None] * a.d
        turned_on = grown * ease.v + 2 * grows * ease.d + torque * ease.dd + wound.d
        bent = force * u + along + du * whole + u * growing
        ddu = bent / bend.stiffness + 2 * bending * drift.give.d + moment * drift.give.dd + by_tubes.dd.sum(1)
        twisted = ddu[:, None] * a.v + 2 * du[:, None] * a.d + u[:, None] * a.dd
        lifted = force * (du + u**2) + 2 * u * along + ddu * whole + 2 * du * growing + u * grown.sum(1)
        share = SHAPE_ERROR[0] * h**3
        thirds = share * (u**2 + du) + out[owner], turned_on, twisted, share * lifted
        for error, third in zip(errors, thirds, strict=True):
            wide = self.wide if third.ndim == 1 else self.wide[:, None]
            third = third if third.ndim == 1 else share[:, None] * third
            np.maximum.at(error, owner, np.where(wide, np.inf, third))
        return errors

    @cached_property
    def _lever(self) -> Array:
        """(E,) bound of the bending moment of the load, N m."""
        length, p = self.ends.max(1), self.pull
        return np.asarray(length * np.linalg.norm(p.tip) + length**2 / 2 * p.per_length)


@dataclass(frozen=True, eq=False)
class LoadedIntervals(Intervals):
    """Neighbouring equilibria under a load."""

    arms: LoadedArms

    @cached_property
    def force(self) -> Jet:
        """(B, K) of the force on the cross-sections, N, in every section: it is linear in it, and in time."""
        ends = self.arms.ends
        tables = [
            self.arms.pull.on(np.stack([cuts[:, :-1], cuts[:, 1:]]), ends[e][:, None])
            for e, cuts in ((self.one, self.begin), (self.other, self.end))
        ]
        size = np.linalg.norm(tables, axis=-1).max((0, 1))
        change = np.linalg.norm(tables[1] - tables[0], axis=-1).max(0)
        return Jet(size, change, np.zeros_like(size), np.zeros_like(size))

    @cached_property
    def lever(self) -> Array:
        """(B, K) bound of |m_w|, N m, and so of the moment: of the forces ahead on an arm however it is bent."""
        each = np.maximum(*self.length) * self.force.v
        return np.asarray(np.cumsum(each[:, ::-1], axis=1)[:, ::-1])

    @cached_property
    def bending(self) -> Bending:
        """Bounds of curvature, (B, K), with what the load bends."""
        plain = Bending.of(self.arms.constants, self.stretch)
        return replace(plain, most=plain.most + self.lever / plain.stiffness)

    @cached_property
    def loads(self) -> tuple[Array, Array, Array]:
        """(B, K, n) sizes of torques, and by how much torques (B, K, n) and moments (B, K) differ at most between both
        ends, at the ends of PARTS stretches of every section, with the errors of interpolation there."""
        (torque, moment), (later, after) = (self.arms.sampled(*places) for places in self.parts)
        twisting, bending = (error[self.one] + error[self.other] for error in self.arms.load_error)
        twisting, bending = twisting[:, None], bending[:, None]
        size = np.maximum(np.abs(torque), np.abs(later)).max(2) + twisting
        change = np.linalg.norm(after - moment, axis=-1).max(2) + bending
        return size, np.abs(later - torque).max(2) + twisting, change
