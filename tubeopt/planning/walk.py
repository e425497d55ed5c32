"""The equilibria along a table of joint values, followed from the first one, as forward kinematics finds them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..equilibrium import Equilibrium
from ..errors import SolveError
from ..inverse.posture import posture_of
from ..kinematics import forward_kinematics
from ..robots.assembly import Array
from .motion import SAMPLE_STEP
from .task import Task

LEFT = 1e-5
"""What must be left of margin (and, m, of clearance) where samples are as far apart as they may be: more than what
lies between them can be off. It falls with the square of their distance."""


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

    def short(self, task: Task) -> Array:
        """(2, T) what margin and clearance (m) lack of what is to be kept and to be left; 0 or less where nothing. Both
        ends of the table are as they are."""
        q = np.array([task.chart.space.join(e.rotations, e.translations) for e in self.equilibria]) / task.scale
        step = np.append(np.abs(np.diff(q, axis=0)).max(1), 0.0)
        left = LEFT * np.minimum(1.0, np.maximum(step, np.roll(step, 1)) / SAMPLE_STEP) ** 2
        out = np.array([task.min_margin + left - self.margin, task.clearance + left - self.clearance])
        out[:, [0, -1]] = np.minimum(out[:, [0, -1]], 0.0)
        return out


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
