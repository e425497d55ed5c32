"""The guard: no step is given out that leaves the branch, the floor of the margin, or the clearance of bodies.

The equilibrium of a step is solved for from the last one. Where Newton's method is not at ease, where the tubes twist
farther than a small motion twists them, where margin or clearance fall short, the step is halved, and at last not made.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import dist

import numpy as np

from ..bodies.obstacles import Obstacle, checked_obstacles
from ..bodies.scene import Lookout, Scene, scene_of
from ..equilibrium.kinematics import one_step
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError
from ..inverse.configurations import Configuration, shift_of
from ..inverse.goal import angle
from ..inverse.joints import JointSpace, joint_space
from ..inverse.posture import Posture, start_posture
from ..robots.limits import JointLimits
from ..robots.robot import Robot
from ..typing import Array
from .command import Command, ServoOptions, Why

HALVINGS = 4
"""Times that a step is halved which the guard does not let pass."""


class Guard:
    """Where a robot is, and whether it may go on from there; arguments and errors as of `Servo`."""

    def __init__(
        self,
        robot: Robot,
        start: Configuration,
        limits: JointLimits | None,
        obstacles: Sequence[Obstacle],
        options: ServoOptions,
    ) -> None:
        self.options = options
        self.space: JointSpace = joint_space(robot, limits).holding(*shift_of(robot, start))
        self.scene: Scene = scene_of(checked_obstacles(obstacles))
        self._lookout = Lookout(self.scene)
        self.here = self.before = start_posture(self.space, start)
        """Where the robot is, and where it was before the last step."""
        self.sight = 0.0
        """Distance (m) up to which bodies are looked at where a step leads: once for the guard and the next step."""
        if words := self.space.outside(self.here.q):
            raise InputError(f"start is out of range: {words}")
        if self.here.margin < options.min_margin:
            raise InputError(
                f"start has margin {self.here.margin:.3g}; it must be min_margin, {options.min_margin:g}, or more"
            )

    def go(self, change: Array, why: Why) -> tuple[Equilibrium, Why]:
        """The equilibrium after a change of the joints (m,), of as much of it as passes, and what is in the way."""
        here = self.here
        if not any(abs(by) > 1e-14 for by in (change / self.space.scale).tolist()):
            return here.equilibrium, why
        floor = min(self.options.min_margin, here.margin)
        for halving in range(HALVINGS + 1):
            q = here.q + change / 2**halving
            rotations, shift = self.space.split(q)
            try:
                there = one_step(self.space.robot, here.equilibrium, rotations, shift)
            except (SolveError, InputError):
                continue
            if there is None or there.margin < floor:
                continue
            posture = Posture(self.space, q, there)
            if self.scene.bodies:
                posture.outline.look_around(self._lookout, self.sight)
                if (missing := self._missing(posture)) > 0 and missing > self._missing(here):
                    continue
            self.here = posture
            return there, why | Why.SHORTENED if halving else why
        return here.equilibrium, why | Why.HELD

    def _missing(self, at: Posture) -> float:
        """Clearance (m) that is missing."""
        return self.options.clearance - at.outline.clearance(self.scene, self.options.clearance)

    def left(self, command: Command) -> tuple[float, float]:
        """Distance (m) and angle (rad) from what is commanded; NaN where nothing is."""
        here = self.here
        away = np.nan if command.position is None else dist(command.position, here.tip)
        return away, np.nan if command.direction is None else angle(here.direction, command.direction)
