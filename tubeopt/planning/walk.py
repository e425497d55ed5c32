"""The equilibria along a table of joint values, followed from the first one, as forward kinematics finds them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..equilibrium import Equilibrium
from ..errors import SolveError
from ..inverse.posture import posture_of
from ..kinematics import forward_kinematics
from ..robots.assembly import Array, Mask
from .task import Task

LEFT = 1e-5
"""What must be left of the room for margin (and, m, of clearance): more than forward kinematics is off."""


@dataclass(frozen=True, eq=False)
class Walked:
    """Equilibria in the order of the table, their margins and clearances (m); `lost` where the branch ended early."""

    equilibria: tuple[Equilibrium, ...]
    clearance: Array
    lost: bool

    @property
    def margin(self) -> Array:
        """(T,) margins."""
        return np.array([e.margin for e in self.equilibria])

    @property
    def tip(self) -> Array:
        """(T, 3) m."""
        return np.array([e.tip_position for e in self.equilibria])

    def allowed(self, task: Task) -> Mask:
        """(T,) whether margin and clearance are kept."""
        kept: Mask = (self.margin >= task.min_margin + LEFT) & (self.clearance >= task.clearance + LEFT)
        return kept


def walk(task: Task, start: Equilibrium, q: Array) -> Walked:
    """Follow the branch of `start` through joint values q (T, m)."""
    space = task.chart.space
    here = start
    found: list[Equilibrium] = []
    for row in q:
        rotations, shift = space.split(row)
        try:
            here = forward_kinematics(space.robot, rotations, shift, guess=here)
        except SolveError:
            return Walked(tuple(found), clearances(task, found), True)
        if not here.stable:
            return Walked(tuple(found), clearances(task, found), True)
        found.append(here)
    return Walked(tuple(found), clearances(task, found), False)


def clearances(task: Task, equilibria: list[Equilibrium]) -> Array:
    """(T,) least distance of the arms from obstacles, m; infinite without."""
    out = np.full(len(equilibria), np.inf)
    if task.obstacles:
        for k, e in enumerate(equilibria):
            posture = posture_of(task.chart.space, e)
            out[k] = min(posture.clearance(obstacle) for obstacle in task.obstacles)
    return out
