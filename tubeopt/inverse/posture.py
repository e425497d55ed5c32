"""Solved configuration of a search: tip, margin, and their derivatives by the joints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import ceil
from typing import NamedTuple

import numpy as np

from ..block.transcription.arm import between
from ..block.transcription.reduced import ReducedProblem
from ..bodies.obstacles import Scene
from ..equilibrium.arm_surface import ArmSurface, Contacts
from ..equilibrium.jacobian import compiled_slopes, derivatives_of
from ..equilibrium.kinematics import forward_kinematics, one_step, point_of, reference_length
from ..equilibrium.member import PlainPoint
from ..equilibrium.result import Derivatives, Equilibrium, refuse_load
from ..errors import InputError, SolveError
from ..solvers.settings import LARGEST_SHIFT, LARGEST_TURN
from ..typing import Array, Delegate
from .joints import Configuration, JointSpace, configuration


class TipJacobian(NamedTuple):
    """Derivatives of the tip by independent joint values (m,)."""

    tip: Array
    """Derivative (3, m) of the position."""
    rotation: Array
    """Derivative (3, m) of the frame, as rotation vectors."""
    margin: Array
    """Derivative (m,) of the margin."""


class _Slopes(NamedTuple):
    jacobian: TipJacobian
    sides: tuple[int, ...]
    """Sides (n,) of the translations."""
    shape: Array | None
    """Derivatives (p, 3, 2 n) of the shape points by rotations and translations; None without a compiled kernel."""


# Round-off of arc lengths, which are sums of lengths of pieces.
EDGE = 1e-9
"""Largest distance (m) along the arm from the end of a tube for a contact at this end."""

# Ten times the distance at which a target counts as met.
SAME_TIP = 1e-7
"""Largest distance (m) of two tips at the same joint values for one equilibrium."""


@dataclass(frozen=True, eq=False)
class Posture:
    """Equilibrium at independent joint values q (m,)."""

    space: JointSpace
    q: Array
    equilibrium: Equilibrium

    margin = Delegate[float]("equilibrium")

    @cached_property
    def step_bounds(self) -> Array:
        """Bounds (2m + k,) of an admissible step: joint ranges and tube order."""
        return self.space.inequalities(self.q)[1]

    @cached_property
    def admissible(self) -> bool:
        """True if the joint values satisfy ranges and tube order."""
        return self.space.admissible(self.q)

    @property
    def tip(self) -> Array:
        """Position (3,) of the tip, m."""
        return self.equilibrium.tip_position

    @property
    def direction(self) -> Array:
        """Direction (3,) of the tip, a unit vector."""
        return np.asarray(self.equilibrium.tip_rotation[:, 2])

    @cached_property
    def solution(self) -> PlainPoint:
        """Solved torsion problem of the equilibrium, on the default mesh."""
        refuse_load(self.equilibrium)
        return point_of(self.equilibrium)

    @property
    def problem(self) -> ReducedProblem:
        """Torsion problem of the equilibrium."""
        return self.solution.member.problem

    @cached_property
    def derivatives(self) -> Derivatives:
        """Derivatives by rotations and translations; one-sided, for growing translations, if both sides differ."""
        return self._derivatives(1)

    def _derivatives(self, side: int) -> Derivatives:
        return derivatives_of(self.equilibrium, side=side, carriages=self.space.carriages)

    @cached_property
    def _free(self) -> _Slopes:
        """Derivatives towards the free side of each joint."""
        return self._slopes(self.space.free_sides(self.step_bounds))

    def _slopes(self, sides: tuple[int, ...]) -> _Slopes:
        """Derivatives to the given sides, by the compiled kernel if it has them."""
        compiled = compiled_slopes(self.equilibrium, sides, self.space.carriages)
        if compiled is not None and compiled.along is not None:
            parts, along = [compiled.position, compiled.turn, compiled.margin], compiled.along
        else:
            parts, along = [self._by_side(sides, name) for name in ("tip_position", "tip_rotation", "margin")], None
        return _Slopes(TipJacobian(*map(self.space.by_joints, parts)), sides, along)

    def _by_side(self, sides: tuple[int, ...], name: str) -> Array:
        """Derivatives (..., 2 n) of a quantity of `Linearised`, of every translation to its side."""
        of = [getattr(self.derivatives if side > 0 else self._derivatives(-1), name) for side in sorted({*sides})]
        return np.asarray(np.where(np.array([*[1] * len(sides), *sides]) > 0, of[-1], of[0]))

    @property
    def jacobian(self) -> TipJacobian:
        """Derivatives of the tip by q.

        Where breakpoints coincide, derivatives differ to either side: each joint has those of the side to which it can
        move.
        """
        return self._free.jacobian

    @cached_property
    def backward(self) -> TipJacobian:
        """Derivatives of the tip by q, for shrinking translations."""
        return self._slopes((-1,) * self.space.robot.n_tubes).jacobian

    def slope(self, name: str) -> Array:
        """Derivatives (..., m) of one quantity of `Linearised` by q, each to its free side as in `jacobian`."""
        return self.space.by_joints(self._by_side(self.space.free_sides(self.step_bounds), name))

    @property
    def two_sided(self) -> bool:
        """True if derivatives differ to either side by more than round-off, as where breakpoints coincide."""
        pairs = zip(self.jacobian, self.backward, strict=True)
        return not all(
            np.allclose(a, b, rtol=0, atol=1e-6 * np.abs(np.nan_to_num(a)).max(), equal_nan=True) for a, b in pairs
        )

    @property
    def along(self) -> Array:
        """Derivatives (p, 3, 2n) of the shape points by rotations and translations, one-sided as in `jacobian`."""
        free = self._free
        return free.shape if free.shape is not None else self._by_side(free.sides, "position")

    @cached_property
    def bend(self) -> float:
        """Integral of the squared curvature, int |u|^2 ds, 1/m."""
        return self.derivatives.total_bend

    @cached_property
    def bend_slope(self) -> Array:
        """Gradient (m,) of `bend`."""
        return self.space.by_joints(self.derivatives.bend)

    def margin_slope(self) -> Array:
        """Gradient (m,) of the margin; 0 where it has none (a double eigenvalue)."""
        slope, known = self.jacobian.margin, np.isfinite(self.jacobian.margin)
        return slope if known.all() else np.where(known, slope, 0.0)

    @cached_property
    def surface(self) -> ArmSurface:
        """Surface of the arm."""
        return ArmSurface(self.equilibrium)

    def contact_slopes(self, scene: Scene, contacts: Contacts) -> Array:
        """Derivatives (c, m) of the distances of contacts by q; a contact at the end of a tube moves with it."""
        away, arm = scene.gradients(contacts.body, contacts.point), self.equilibrium
        slope = (away[:, None] @ _interpolated(arm.arc_length, self.along, contacts.arc_length))[:, 0]
        # The end of the arm is the last of the shape points, which moves along by itself.
        ends = np.where((arm.tube_end > 0) & (arm.tube_end < arm.arc_length[-1] - EDGE), arm.tube_end, np.nan)
        ahead = (away * _interpolated(arm.arc_length, arm.frame[:, :, 2], contacts.arc_length)).sum(1)
        slope[:, len(ends) :] += ahead[:, None] * (np.abs(contacts.arc_length[:, None] - ends) <= EDGE)
        return self.space.by_joints(slope)

    def to(self, q: Array) -> Posture | None:
        """Posture at q after a quasi-static straight motion from here.

        None if the robot snaps, or is too close to a snap for steps of ordinary length.
        """
        current, moved = self.equilibrium, np.abs(q - self.q)
        longest = LARGEST_SHIFT * reference_length(current)
        angle, shift = moved[: self.space.robot.n_tubes].max(), moved[self.space.robot.n_tubes :].max(initial=0.0)
        steps = max(1, ceil(max(angle / LARGEST_TURN, shift / longest) - 1e-9))
        try:
            for k in range(1, steps + 1):
                rotations, shift = self.space.split(self.q + (q - self.q) * (k / steps) if k < steps else q)
                following = one_step(self.space.robot, current, rotations, shift)
                if following is None or not following.stable:
                    return None
                current = following
        except (SolveError, InputError):
            return None
        return Posture(self.space, q, current)


def _interpolated(s: Array, table: Array, at: Array) -> Array:
    """Linear interpolation (c, ..) in a table (m, ..) at arc lengths (c,)."""
    if len(s) < 2:
        return np.repeat(table[:1], len(at), axis=0)
    k, _, fraction = between(s, at)
    x = fraction.reshape(-1, *[1] * (table.ndim - 1))
    return np.asarray((1 - x) * table[k] + x * table[k + 1])


def start_at(space: JointSpace, q: Array) -> Posture | None:
    """Posture at q by forward kinematics without a start; None without a stable equilibrium."""
    rotations, shift = space.split(q)
    try:
        return Posture(space, q, forward_kinematics(space.robot, rotations, shift))
    except (SolveError, InputError):
        return None


def same_posture(a: Posture | None, b: Posture) -> bool:
    """True if two postures at the same joint values are the same equilibrium."""
    return a is not None and bool(np.linalg.norm(a.tip - b.tip) <= SAME_TIP)


def posture_of(space: JointSpace, equilibrium: Equilibrium, name: str = "") -> Posture:
    """Posture of an equilibrium; raises InputError, with `name`, if it is not in the joint space."""
    return Posture(space, space.join(equilibrium.rotations, equilibrium.translations, name), equilibrium)


def start_posture(space: JointSpace, start: Configuration) -> Posture:
    """Posture of a start: its equilibrium, or forward kinematics at its joint values."""
    q = configuration(space, "start", start)
    known = start if isinstance(start, Equilibrium) else getattr(start, "equilibrium", None)
    if isinstance(known, Equilibrium) and known.robot == space.robot:
        return posture_of(space, known)
    rotations, shift = space.split(q)
    return posture_of(space, forward_kinematics(space.robot, rotations, shift))
