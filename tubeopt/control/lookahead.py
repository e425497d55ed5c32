"""A servo that looks ahead: for goals behind a valley of the margin, or a body, at which one step after another ends.

The way to the target is kept as knots, each an equilibrium (see `horizon`). Every step solves for them once and
improves them by one quadratic program (real-time iteration; Diehl, Bock and Schloeder, SIAM J. Control Optim. 43
(2005)), then goes along as far as rates allow, if all of the way is allowed, and if the guard agrees. A new target
begins with the straight line to the joint values that inverse kinematics finds for it, through whatever is between.
Where no way becomes allowed, or no joint values are known, and close to the target, one step ahead is looked.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..bodies.obstacles import Obstacle
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, instance
from ..inverse.configurations import Configuration
from ..inverse.settings import InverseOptions
from ..inverse.solving import inverse_kinematics
from ..inverse.tip_coordinates import TipCoordinates
from ..robots.limits import JointLimits
from ..robots.robot import Robot
from ..solvers.blas import small
from ..typing import Array
from .command import Command, ServoOptions, ServoStep, Why, check_places, time_step
from .horizon import DEFAULT_HORIZON, Aim, HorizonSolver, Knots, improvement
from .servo import Servo


class PredictiveServo:
    """Servo of one robot with look-ahead: it plans several knots to the target.

    Args:
        start, limits, obstacles: as for `Servo`.   options: see `ServoOptions`; priorities and objective apply where a
            single step suffices.
        knots: number of knots of the planned path.   solver: settings of the planner.

    Raises:
        InputError, SolveError: as `Servo` does; fewer than 2 knots.
    """

    def __init__(
        self,
        robot: Robot,
        start: Configuration,
        *,
        limits: JointLimits | None = None,
        obstacles: Sequence[Obstacle] = (),
        options: ServoOptions | None = None,
        knots: int = 20,
        solver: HorizonSolver = DEFAULT_HORIZON,
    ) -> None:
        if knots < 2:
            raise InputError(f"knots is {knots}; it must be at least 2")
        instance("solver", solver, HorizonSolver)
        self.options, self.solver = options or ServoOptions(), solver
        self._servo = Servo(robot, start, limits=limits, obstacles=obstacles, options=self.options)
        self._guard = self._servo.guard
        self._bodies, self._limits = tuple(obstacles), limits
        self._floor = self.options.min_margin + solver.margin_room
        self._clearance = self.options.clearance + solver.clearance_room
        self._chart = TipCoordinates(self._guard.space)
        self._count = knots
        self._way: Array | None = None
        self._aim: Aim | None = None
        self._trust, self._last = self.solver.trust, np.zeros((knots, len(self._guard.here.q)))
        self._waited, self._near = 0, True

    @property
    def equilibrium(self) -> Equilibrium:
        """Current equilibrium of the robot."""
        return self._guard.here.equilibrium

    @property
    def way(self) -> Array | None:
        """(K, m) tip rotations (rad) and carriage translations (m) of the planned path; None without one."""
        return None if self._way is None else self._way.copy()

    @small
    def step(self, command: Command, dt: float) -> ServoStep[Equilibrium]:
        """One step of `dt` seconds towards a position, and a direction if given; always returns a step.

        The robot does not move until the planned path is allowed; `why` then names the violated constraints.

        Raises:
            InputError: a command without a position, or with more than position and direction.
        """
        dt = time_step(dt)
        check_places(command, self._guard.space.robot)
        if command.position is None or command.pivot is not None or command.joints is not None:
            raise InputError("a servo with look-ahead follows a position, and a direction if one is given")
        aim = Aim(command.position, command.direction)
        told, here = self._guard.left(command), self._guard.here
        if self._near and told[0] < self.solver.close * self._guard.space.length and not self._new(aim):
            step = self._servo.step(command, dt)
            # Where that comes to rest before it is there, one step ahead will not do.
            self._near = step.why & Why.HELD == 0
            return step
        knots = self._knots(aim)
        if knots is None:
            return self._servo.step(command, dt)
        lacking = self._renew(knots)
        if not lacking:
            change, passed = self._along(knots, dt)
            there, lacking = self._guard.go(change, Why.RATE if passed < self._count else Why(0))
            if Why.HELD not in lacking:
                self._waited = 0
                # What is left of the way is cut into as many knots again.
                if self._way is not None:
                    self._way = _places(self._way, np.linspace(passed, self._count, self._count + 1))
                return ServoStep(there, lacking, *told)
        self._waited += 1
        if self._waited <= self.solver.patience:
            return ServoStep(here.equilibrium, lacking | Why.HELD, *told)
        return self._servo.step(command, dt)

    def _renew(self, knots: Knots) -> Why:
        """Improve the way; what the knots lack as they are."""
        assert self._aim is not None
        contacts = knots.contacts(self._guard.scene, self._clearance, self.solver)
        change = improvement(knots, self._aim, contacts, self._trust, self.solver)
        if change is None:  # it is begun anew
            self._aim = None
        else:
            undone = float((change * self._last).sum()) < 0
            self._trust = float(np.clip(self._trust * (0.5 if undone else 2.0), self.solver.calm, self.solver.trust))
            self._last = change
            self._way = np.concatenate([knots.z[:1], knots.z[1:] + change * self._guard.space.scale])
        lacking = Why(0)
        if knots.fields[1:].min() < -self.solver.lacking:
            lacking |= Why.MARGIN
        if contacts[0].min(initial=np.inf) < -self.solver.clearance_room * (1 + self.solver.lacking):
            lacking |= Why.OBSTACLE
        return lacking

    def _knots(self, aim: Aim) -> Knots | None:
        """The way to an aim as it is; None where no joint values are known for it."""
        here = self._guard.here
        begin, floor = self._chart.of(here.equilibrium), min(self._floor, here.margin)
        if self._new(aim):
            self._aim, end = aim, self._goal(aim)
            self._way = None
            if end is None:
                return None
            self._trust, self._last = self.solver.trust, np.zeros_like(self._last)
            self._waited, self._near = 0, True
            self._way = begin + np.linspace(0, 1, self._count + 1)[:, None] * (end - begin)
        if self._way is None:
            return None
        self._aim = aim
        return Knots.at(self._chart, np.concatenate([begin[None], self._way[1:]]), floor)

    def _new(self, aim: Aim) -> bool:
        """Whether no way was looked for, or one to another aim."""
        if self._aim is None:
            return True
        moved = float(np.linalg.norm(aim.position - self._aim.position)) / self._guard.space.length
        if aim.direction is not None and self._aim.direction is not None:
            moved = max(moved, float(np.linalg.norm(aim.direction - self._aim.direction)))
        return moved > self.solver.elsewhere or (aim.direction is None) != (self._aim.direction is None)

    def _goal(self, aim: Aim) -> Array | None:
        """The point of the chart of joint values that meet an aim, near the robot; None where none are known."""
        try:
            found = inverse_kinematics(
                self._guard.space.robot,
                aim.position,
                direction=aim.direction,
                start=self.equilibrium,
                min_margin=self._floor,
                limits=self._limits,
                obstacles=self._bodies,
                options=InverseOptions(clearance=self._clearance, time_limit=self.solver.seconds),
            )
        except SolveError:
            return None
        return self._chart.of(found.equilibrium)

    def _along(self, knots: Knots, dt: float) -> tuple[Array, float]:
        """The change of the joints (m,) that goes along the knots for `dt` seconds as fast as joints and tip may; and
        how many knots that passes."""
        space, here, options = self._guard.space, self._guard.here, self.options
        rate = np.where(np.arange(len(here.q)) < space.robot.n_tubes, options.turn_rate, options.shift_rate)
        turned = np.abs(np.diff(knots.joints, axis=0)) / np.maximum(rate, 1e-300)
        moved = np.linalg.norm(np.diff(knots.tip, axis=0), axis=1) / max(options.speed, 1e-300)
        time = np.concatenate([[0.0], np.cumsum(np.maximum(turned.max(1), moved))])
        passed = float(np.interp(dt, time, np.arange(len(time))))
        at = _places(knots.z, np.array([passed]))
        change = np.clip(self._chart.joints(at)[0], space.lower, space.upper) - here.q
        share = float((np.abs(change) / np.maximum(rate * dt, 1e-300)).max())
        return change / max(share, 1.0), passed


def _places(z: Array, at: Array) -> Array:
    """(k, m) places on a polyline (K, m), by numbers (k,) of its points."""
    return np.column_stack([np.interp(at, np.arange(len(z)), column) for column in z.T])
