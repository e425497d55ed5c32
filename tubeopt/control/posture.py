"""A solved configuration on the way to a target: where the tip is, how stable it is, and how both change."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from math import ceil

import numpy as np

from ..bodies.obstacles import Obstacle
from ..equilibrium.continuation import LARGEST_SHIFT, LARGEST_TURN
from ..equilibrium.derivatives import Derivatives
from ..equilibrium.general_motion import GeneralMotion
from ..equilibrium.kinematics import forward_kinematics, one_step
from ..equilibrium.result import Equilibrium
from ..equilibrium.solving import DEFAULT_DISCRETISATION, Solution, polish
from ..equilibrium.state import arm_of_equilibrium, problem_of
from ..errors import InputError, SolveError
from ..robots.robot import is_general
from ..typing import Array, Mask
from .joints import JointSpace

FINE = 400
"""Points along the arm at which its distance from obstacles is measured."""

FINER = 17
"""Points between the two neighbours of one at which it is closest."""

SAME_TIP = 1e-7
"""Distance (m) of two tips at the same joint values that are one equilibrium."""

MOST_CONTACTS = 6
"""Places where the arm comes closest to one obstacle that a step looks at."""


@dataclass(frozen=True, eq=False)
class Posture:
    """An equilibrium at independent joint values q (m,)."""

    space: JointSpace
    q: Array
    equilibrium: Equilibrium

    @property
    def margin(self) -> float:
        """Stability margin."""
        return self.equilibrium.margin

    @property
    def tip(self) -> Array:
        """(3,) m."""
        return self.equilibrium.tip_position

    @property
    def direction(self) -> Array:
        """(3,) unit vector along which the tip points."""
        return np.asarray(self.equilibrium.tip_rotation[:, 2])

    @cached_property
    def solution(self) -> Solution:
        """The solved problem behind the equilibrium, on the default mesh."""
        return polish(self.equilibrium, DEFAULT_DISCRETISATION)

    @cached_property
    def _forward(self) -> Derivatives | GeneralMotion:
        """Derivatives for translations that grow, where they differ to either side."""
        return self._derivatives(1)

    @property
    def derivatives(self) -> Derivatives | GeneralMotion:
        """Those by rotations and translations, which grow."""
        return self._forward

    def _derivatives(self, side: int) -> Derivatives | GeneralMotion:
        if is_general(self.space.robot):
            return GeneralMotion(self.equilibrium, side)
        assembly = self.space.robot.assembly(self.equilibrium.translations)
        arm = arm_of_equilibrium(self.equilibrium, assembly)
        own = partial(problem_of, self.equilibrium)
        return Derivatives(arm, assembly, self.space.carriages, side=side, margin=self.margin, problem=own)

    @cached_property
    def jacobian(self) -> tuple[Array, Array, Array]:
        """(3, m) of the tip, (3, m) of its turn vector, (m,) of the margin, with respect to q.

        Where breakpoints coincide, as where one tube ends in its order at the end of another, derivatives differ to
        either side: each joint has those of the side to which it is free to move.
        """
        forward = _reduced(self._forward, self.space)
        blocked = self.space.only_backward(self.q)
        return self._mixed(blocked, forward) if blocked.any() else forward

    @cached_property
    def backward(self) -> tuple[Array, Array, Array]:
        """As `jacobian`, with the derivatives of translations that shrink."""
        return _reduced(self._derivatives(-1), self.space)

    def _mixed(self, backward: Mask, forward: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        a, b, c = (np.where(backward, low, high) for low, high in zip(self.backward, forward, strict=True))
        return a, b, c

    @property
    def along(self) -> Array:
        """(p, 3, 2n) change of the shape points by rotations and translations."""
        return self._forward.position

    @cached_property
    def bend(self) -> float:
        """int |u|^2 ds, 1/m."""
        return self._forward.total_bend

    @cached_property
    def bend_slope(self) -> Array:
        """(m,) change of `bend` per joint."""
        return np.asarray(self._forward.bend @ self.space.spread)

    def margin_slope(self) -> Array:
        """(m,) change of the margin per joint; 0 where it has none (a double eigenvalue)."""
        return np.nan_to_num(self.jacobian[2])

    @cached_property
    def fine(self) -> tuple[Array, Array, Array]:
        """Arc length (p,), centreline (p, 3) and radius of the arm (p,) at points close enough for obstacles: evenly
        spaced, and the ends of the tubes, where the radius falls."""
        ends = self.equilibrium.tube_end
        s = np.linspace(0.0, self.equilibrium.arc_length[-1], FINE)
        return self._at(np.union1d(s, ends[(ends > 0) & (ends < s[-1])]))

    def _at(self, s: Array) -> tuple[Array, Array, Array]:
        arm = self.equilibrium
        points = _hermite(arm.arc_length, arm.position, arm.frame[:, :, 2], s)
        return s, points, arm_radius(arm, s)

    def contacts(self, obstacle: Obstacle) -> tuple[Array, Array, Array]:
        """Where the arm comes closest to an obstacle: arc lengths (c,), points of the centreline (c, 3), and distances
        of the surface of the arm from the obstacle (c,) in m, the least first."""
        s, points, radius = self.fine
        distance = np.asarray(obstacle.signed_distance(points) - radius)
        padded = np.concatenate([[np.inf], distance, [np.inf]])
        least = np.flatnonzero((distance <= padded[:-2]) & (distance <= padded[2:]))
        chosen = least[np.argsort(distance[least], kind="stable")[:MOST_CONTACTS]]
        # Near a small obstacle the arm comes closer between two of the points than a clearance may be off.
        low, high = s[np.maximum(chosen - 1, 0)], s[np.minimum(chosen + 1, len(s) - 1)]
        finer, points, radius = self._at((low + (high - low) * np.linspace(0.0, 1.0, FINER)[:, None]).T.ravel())
        finer, points = finer.reshape(-1, FINER), points.reshape(-1, FINER, 3)
        between = np.asarray(obstacle.signed_distance(points.reshape(-1, 3)) - radius).reshape(-1, FINER)
        rows, best = np.arange(len(chosen)), between.argmin(1)
        closer = between[rows, best] < distance[chosen]
        place = np.where(closer, finer[rows, best], s[chosen])
        centre = np.where(closer[:, None], points[rows, best], self.fine[1][chosen])
        value = np.where(closer, between[rows, best], distance[chosen])
        order = np.argsort(value, kind="stable")
        return place[order], centre[order], value[order]

    def clearance(self, obstacle: Obstacle) -> float:
        """Least distance of the surface of the arm from an obstacle, m."""
        return float(self.contacts(obstacle)[2][0])

    def clearance_rows(self, obstacle: Obstacle, within: float) -> tuple[Array, Array]:
        """Clearances (r,) where the arm comes closest, if closer than `within`, and their change (r, m) with q."""
        place, points, distance = self.contacts(obstacle)
        near = distance <= within
        rows = [
            obstacle.gradient(point) @ _between(self.equilibrium.arc_length, self.along, s) @ self.space.spread
            for s, point in zip(place[near], points[near], strict=True)
        ]
        return distance[near], np.reshape(rows, (-1, len(self.q)))

    def to(self, q: Array) -> Posture | None:
        """The stable equilibrium at q that a slow straight motion from here leads to; None where the robot snaps, or is
        so close to it that steps of ordinary length do not tell."""
        here, moved = self.equilibrium, np.abs(q - self.q)
        longest = LARGEST_SHIFT * max(float(here.arc_length[-1]), 0.1 * self.space.length)
        turn, shift = moved[: self.space.robot.n_tubes].max(), moved[self.space.robot.n_tubes :].max(initial=0.0)
        steps = max(1, ceil(max(turn / LARGEST_TURN, shift / longest) - 1e-9))
        try:
            for k in range(1, steps + 1):
                rotations, shift = self.space.split(self.q + (q - self.q) * (k / steps) if k < steps else q)
                there = one_step(self.space.robot, here, rotations, shift)
                if there is None or not there.stable:
                    return None
                here = there
        except (SolveError, InputError):
            return None
        return Posture(self.space, q, here)


def _hermite(s: Array, value: Array, slope: Array, at: Array) -> Array:
    """(p, 3) cubic interpolation of a curve given with its tangents at arc lengths s (m,)."""
    if len(s) < 2:
        return np.repeat(value, len(at), axis=0)
    k = np.clip(np.searchsorted(s, at, side="right") - 1, 0, len(s) - 2)
    h = (s[k + 1] - s[k])[:, None]
    x = (at - s[k])[:, None] / h
    ends = value[k] * (1 + 2 * x) * (1 - x) ** 2 + value[k + 1] * x**2 * (3 - 2 * x)
    return np.asarray(ends + h * (slope[k] * x * (1 - x) ** 2 - slope[k + 1] * x**2 * (1 - x)))


def _between(s: Array, table: Array, at: float) -> Array:
    """Linear interpolation in a table (m, ...) at arc length `at`."""
    if len(s) < 2:
        return np.asarray(table[0])
    k = int(np.clip(np.searchsorted(s, at, side="right") - 1, 0, len(s) - 2))
    x = (at - s[k]) / (s[k + 1] - s[k])
    return np.asarray((1 - x) * table[k] + x * table[k + 1])


def arm_radius(equilibrium: Equilibrium, arc_length: Array) -> Array:
    """(p,) radius of the arm at arc lengths: of the outermost tube there, for eccentric tubes of what holds them."""
    robot = equilibrium.robot
    outer = (
        np.array([tube.outer_diameter / 2 for tube in robot.tubes]) + robot.assembly(equilibrium.translations).offset
    )
    shown = arc_length[:, None] <= equilibrium.tube_end + 1e-12
    return np.asarray(np.where(shown, outer, 0.0).max(1))


def start_at(space: JointSpace, q: Array) -> Posture | None:
    """The stable equilibrium that a cold forward kinematics finds at q, or None."""
    rotations, shift = space.split(q)
    try:
        return Posture(space, q, forward_kinematics(space.robot, rotations, shift))
    except (SolveError, InputError):
        return None


def same_place(one: Posture | None, other: Posture) -> bool:
    """Whether two postures at the same joint values are one equilibrium."""
    return one is not None and bool(np.linalg.norm(one.tip - other.tip) <= SAME_TIP)


def posture_of(space: JointSpace, equilibrium: Equilibrium) -> Posture:
    """The posture of an equilibrium."""
    return Posture(space, space.join(equilibrium.rotations, equilibrium.translations), equilibrium)


def _reduced(of: Derivatives | GeneralMotion, space: JointSpace) -> tuple[Array, Array, Array]:
    return of.tip_position @ space.spread, of.tip_rotation @ space.spread, of.margin @ space.spread
