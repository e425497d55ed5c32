"""The chart of a robot that bears a load: points are equilibria without it, arms are what the load makes of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..equilibrium.kinematics import equilibrium_at, forward_kinematics
from ..equilibrium.problem import DEFAULT_DISCRETISATION, reduced_problem
from ..equilibrium.result import Equilibrium
from ..errors import SolveError
from ..inverse.clock import Clock, LateError
from ..inverse.tip_coordinates import Arms, TipCoordinates
from ..robots.load import Load
from ..stability.shooting import profiles
from ..typing import Array

SAME = 1e-6
"""Tips (rad) of equilibria that are one."""


@dataclass(frozen=True, eq=False)
class LoadedChart(TipCoordinates):
    """As `TipCoordinates`; every arm is that into which the stable equilibrium of its point grows with the load."""

    def of(self, equilibrium: Equilibrium) -> Array:
        """The point of an equilibrium: that of what is left of it without its load.

        Raises:
            SolveError: it snaps as the load is taken off.
        """
        known = equilibrium
        if known.load is not None:
            known = forward_kinematics(known.robot, known.rotations, known.translations, load=Load(), start=known)
        return super().of(known)

    def arms(self, z: Array, margin: float | Array, clock: Clock | None = None) -> Arms:
        """As those of `TipCoordinates`, under the load."""
        plain, shift = super().arms(z, 0.0, clock), self.translations(z)
        floor, found = np.broadcast_to(margin, len(z)), dict[int, Equilibrium]()
        for k in np.flatnonzero(plain.stable).tolist():
            if clock is not None and clock.over:
                raise LateError
            e = self._loaded(z[k, : shift.shape[1]], plain.rotations[k], shift[k])
            if e is not None:
                found[k] = e
        stable = np.array([k in found and found[k].margin > floor[k] for k in range(len(z))], dtype=bool)
        width = max((len(e.arc_length) for e in found.values()), default=plain.points.shape[1])
        points, tangents, s = (_widened(table, width) for table in (plain.points, plain.tangents, plain.arc_length))
        for k, e in found.items():
            own = e.position, e.frame[:, :, 2], e.arc_length
            points[k], tangents[k], s[k] = (_widened(table[None], width)[0] for table in own)
        return Arms(plain.rotations, stable, points, tangents, s, plain.tube_end)

    def _loaded(self, tips: Array, rotations: Array, translations: Array) -> Equilibrium | None:
        """The equilibrium under the load at joint values, grown from the one without it that has these tips."""
        robot = self.space.robot
        try:
            bare = forward_kinematics(robot, rotations, translations)
            if np.abs(bare.tip_rotations - tips).max() > SAME:
                problem = reduced_problem(robot, tuple(translations.tolist()), DEFAULT_DISCRETISATION)
                theta = profiles(problem, tips[None])[0]
                bare = equilibrium_at(robot, rotations, translations, lambda s: theta.T)
            return forward_kinematics(robot, rotations, translations, load=self.load, start=bare)
        except SolveError:
            return None


def _widened(table: Array, width: int) -> Array:
    """(N, width, ...) of a table (N, p, ...): its last points repeated, or left out."""
    more = [(0, 0)] * table.ndim
    more[1] = (0, max(0, width - table.shape[1]))
    return np.pad(table, more, mode="edge")[:, :width].copy()
