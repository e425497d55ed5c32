"""The equilibria along a table of joint values, followed from the first one, as forward kinematics finds them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import SolveError
from ..inverse.clock import Clock
from ..inverse.outline import Outline
from ..typing import Array
from .effort import PlanTask


@dataclass(frozen=True, eq=False)
class Tracked:
    """Equilibria in the order of the table; `lost` where the branch ended early, or time did."""

    equilibria: tuple[Equilibrium, ...]
    lost: bool

    @property
    def margin(self) -> Array:
        """(T,) margins."""
        return np.array([e.margin for e in self.equilibria])

    @property
    def tip(self) -> Array:
        """(T, 3) m."""
        return np.array([e.tip_position for e in self.equilibria])

    def short(self, task: PlanTask) -> Array:
        """(2, T) what margin and clearance (m) lack of what is to be kept and to be left; 0 or less where nothing. Both
        ends of the table are as they are."""
        joints = [task.chart.space.join(e.rotations, e.translations) for e in self.equilibria]
        q = np.reshape(joints, (-1, len(task.scale))) / task.scale
        step = np.append(np.abs(np.diff(q, axis=0)).max(1), 0.0)[: len(q)]
        most = task.effort.smoothing.left
        left = most * np.minimum(1.0, np.maximum(step, np.roll(step, 1)) / task.effort.timing.sample_step) ** 2
        clear = [Outline(e).clearance(task.scene, task.clearance + most) for e in self.equilibria]
        out = np.array([task.min_margin + left - self.margin, task.clearance + left - np.array(clear)])
        for end in {0, len(q) - 1} if len(q) else ():
            out[:, end] = np.minimum(out[:, end], 0.0)
        return out


def track(task: PlanTask, start: Equilibrium, q: Array, clock: Clock | None = None) -> Tracked:
    """Follow the branch of `start` through joint values q (T, m), until the clock is over."""
    space = task.chart.space
    here = start
    found: list[Equilibrium] = []
    for row in q:
        rotations, shift = space.split(row)
        try:
            here = forward_kinematics(space.robot, rotations, shift, load=task.chart.load, guess=here)
        except SolveError:
            break
        if not here.stable or (clock is not None and clock.over):
            break
        found.append(here)
    return Tracked(tuple(found), len(found) < len(q))
