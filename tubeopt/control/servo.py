"""The guard: no step is given out that leaves the branch, the floor of the margin, or the clearance of bodies.

The equilibrium of a step is solved for from the last one. Where Newton's method is not at ease, where the tubes twist
farther than a small motion twists them, where margin or clearance fall short, the step is halved, and at last not made.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import dist, hypot
from typing import NamedTuple

import numpy as np

from ..arguments import typed
from ..bodies.obstacles import ClearanceMonitor, Obstacle, Scene, checked_obstacles, scene_of
from ..equilibrium.jacobian import compiled_slopes
from ..equilibrium.kinematics import one_step
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError
from ..inverse.goal import BODY_REACH, angle
from ..inverse.joints import Configuration, JointSpace, configuration, joint_space, shift_of
from ..inverse.posture import Posture, start_posture
from ..robots.limits import JointLimits
from ..robots.robot import Robot
from ..solvers.blas import small
from ..solvers.quadratic import constrained_least_squares
from ..typing import Array, Index
from .command import Command, ServoOptions, ServoStep, Why, at_most, check_places, time_step

# Times that a step is halved which the guard rejects: a sixteenth of a step is not worth its equilibrium.
HALVINGS = 4


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
        self._monitor = ClearanceMonitor(self.scene)
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
                posture.outline.look_around(self._monitor, self.sight)
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


# Weight of joint motion over its scale against the tip's motion over the robot's length. It matters where the
# Jacobian has a singular value below it: there joints would move far for nothing. Elsewhere the tip is off by its
# square, 1e-6 of a step.
DAMPING = 1e-3

# Fraction of the remaining margin and clearance that one step may use. Both are linearised: with 1 the error of
# second order would violate them; the distance still halves every step.
APPROACH = 0.5

# Margin above its lower bound, and distance (m) from bodies above the clearance, at which the arm moves along these: a
# straight step bends away from what it moves along, and would violate it by the error of second order.
ROOM, APART = 0.01, 1e-5

# Largest required rise of margin or distance, as a fraction of what the joints can do within their rates. With 1 the
# rows would leave no step but one, and no joint motion for the task.
RISE = 0.3

# Factor on the distance within which this step searched bodies: the next step searches again only beyond it.
FARTHER = 1.2

# Longest step whatever the rates: rad, and fraction of the longest tube. Newton's method follows a branch over such
# steps; the guard would reject most longer ones.
TURN, SHIFT = 0.3, 0.05

# Singular value of a task below which it leaves a motion free: above round-off of the Jacobian, below any motion that
# counts.
FREE = 1e-6


class Task(NamedTuple):
    """One priority of a step as least squares over the joints' scales: matrix @ step = target."""

    matrix: Array
    target: Array
    damped: bool
    """False for the objective, which must not be slowed down by damping."""


class Constraints(NamedTuple):
    """rows @ step >= bounds, over the joints' scales."""

    rows: Array
    bounds: Array
    kinds: list[tuple[int, Why]]
    """First row of each kind. Rows before the first one are rates and ranges."""


@typed
class Servo:
    """Servo of one robot: joint rates that move the tip to a commanded pose.

    Args:
        start: current configuration or equilibrium of the robot; the servo stays on its branch.
        limits, obstacles: as for `inverse_kinematics`.   options: see `ServoOptions`.

    Raises:
        InputError: the start is outside the limits, or its margin is below the smallest allowed one.
        SolveError: no stable equilibrium is found at the start.
    """

    def __init__(
        self,
        robot: Robot,
        start: Configuration,
        *,
        limits: JointLimits | None = None,
        obstacles: Sequence[Obstacle] = (),
        options: ServoOptions | None = None,
    ) -> None:
        self.options = options or ServoOptions()
        self.guard = Guard(robot, start, limits, obstacles, self.options)
        self.space = self.guard.space
        groups = [tuple(group.split("+")) for group in self.options.priorities]
        self._groups = groups if self.options.objective is None else [*groups, ()]
        """Names of what is asked at each priority; at the last of them nothing, for the objective."""
        unit = np.eye(len(self.space.scale))
        self._sides = np.vstack([unit, -unit, self.space.rows * self.space.scale])
        """(2m + k, m) rows of rates and ranges, then of the order, over the joints' scales."""
        self._twice, self._damping = np.tile(self.space.scale, 2), DAMPING * unit
        if self.options.objective == "compliance" and compiled_slopes(self.equilibrium) is None:
            raise InputError(
                "objective is 'compliance'; it needs a compiled kernel for the robot; choose another objective"
            )

    @property
    def equilibrium(self) -> Equilibrium:
        """Current equilibrium of the robot."""
        return self.guard.here.equilibrium

    @small
    def step(self, command: Command, dt: float) -> ServoStep[Equilibrium]:
        """One step of `dt` seconds; it always answers, with the joint values to hold where nothing else is safe.

        Raises:
            InputError: `dt` or the joint values of the command make no sense.
        """
        dt = time_step(dt)
        check_places(command, self.space.robot)
        here = self.guard.before = self.guard.here
        remaining = self.guard.left(command)
        groups = (self._task(group, command, here, dt) for group in self._groups)
        tasks = [task for task in groups if task is not None]
        if not tasks:
            return ServoStep(here.equilibrium, Why(0), *remaining)
        rate = self._rate(dt)
        rows, bounds, kinds = self._constraints(here, rate)
        # Where the margin cannot be raised, it is at least not lowered: then to stay keeps all.
        solved = self._by_priority(tasks, rows, bounds) or self._by_priority(tasks, rows, np.minimum(bounds, 0.0))
        if solved is None:
            return ServoStep(here.equilibrium, Why.HELD, *remaining)
        step, active = solved
        # The first rows are rates and ranges, which nothing exceeds, not by rounding either.
        m = len(here.q)
        change = np.minimum(np.maximum(step, bounds[:m]), -bounds[m : 2 * m]) * self.space.scale
        return ServoStep(*self.guard.go(change, self._why(active, here, rate, kinds)), *remaining)

    def undo(self) -> None:
        """Take the last step back, which was not sent."""
        self.guard.here = self.guard.before

    def _rate(self, dt: float) -> Array:
        """(m,) most that each joint moves in a step."""
        options, space = self.options, self.space
        rate = np.full(len(space.scale), min(options.shift_rate * dt, SHIFT * space.length))
        rate[: space.robot.n_tubes] = min(options.turn_rate * dt, TURN)
        return rate

    def _constraints(self, here: Posture, rate: Array) -> Constraints:
        """Constraints of a step: rates and ranges, order, margin, bodies. Those violated already must not get worse."""
        options, m = self.options, len(here.q)
        bounds = np.minimum(here.step_bounds, 0.0)
        bounds[: 2 * m] = np.maximum(bounds[: 2 * m].reshape(2, m), -rate).ravel() / self._twice
        rows, more, kinds = [self._sides], [bounds], [(2 * m, Why.ORDER)]
        slope = here.margin_slope() * self.space.scale
        if any(up := slope.tolist()):
            # The most that the margin can rise within rates and ranges: a required rise above it has no solution.
            ends = bounds.tolist()
            rise = RISE * sum(-by * ends[m + k] if by > 0 else by * ends[k] for k, by in enumerate(up))
            kinds.append((len(bounds), Why.MARGIN))
            rows.append(slope[None])
            more.append(np.array([min(APPROACH * (options.min_margin + ROOM - here.margin), rise)]))
        if self.guard.scene.bodies:
            near, least = self._body_rows(here, rate)
            kinds.append((sum(map(len, more)), Why.OBSTACLE))
            rows.append(near)
            more.append(least)
        return Constraints(np.concatenate(rows), np.concatenate(more), kinds)

    def _why(self, active: Index, here: Posture, rate: Array, kinds: Sequence[tuple[int, Why]]) -> Why:
        """Meaning of the active rows."""
        m, reasons = len(here.q), set[Why]()
        for row in active.tolist():
            if row < 2 * m:
                reasons.add(Why.RANGE if here.step_bounds[row] > -rate[row % m] else Why.RATE)
            else:
                reasons.add(next(kind for first, kind in reversed(kinds) if row >= first))
        return Why(sum(reasons))

    def _by_priority(self, tasks: Sequence[Task], rows: Array, bounds: Array) -> tuple[Array, Index] | None:
        """Step and active rows of one task after the other, each in the null space of those before it; None where no
        step satisfies the rows."""
        solved = self._least_squares(tasks[0], rows, bounds)
        if solved is None or len(tasks) == 1:
            return solved
        (step, active), used, null_space = solved, tasks[0].matrix, np.eye(rows.shape[1])
        for task in tasks[1:]:
            _, size, basis = np.linalg.svd(used)
            null_space = null_space @ basis[np.count_nonzero(size > FREE) :].T
            if not null_space.shape[1]:
                break
            used = task.matrix @ null_space
            rest = Task(used, task.target - task.matrix @ step, task.damped)
            # 1e-12: the step satisfies all rows, but for rounding.
            solved = self._least_squares(rest, rows @ null_space, bounds - rows @ step - 1e-12)
            if solved is None:  # the step of the tasks before satisfies all rows as it is
                break
            step, active = step + null_space @ solved[0], solved[1]
        return step, active

    def _least_squares(self, task: Task, rows: Array, bounds: Array) -> tuple[Array, Index] | None:
        """Step and active rows of one task. Damping bounds the joint rates where the Jacobian is nearly singular."""
        matrix, target = task.matrix, task.target
        if task.damped:
            n = matrix.shape[1]
            matrix = np.concatenate([matrix, self._damping[:n, :n]])
            target = np.concatenate([target, np.zeros(n)])
        solved = constrained_least_squares(matrix, target, rows, bounds)
        return None if solved is None else (solved.x, solved.active)

    def _body_rows(self, at: Posture, rate: Array) -> tuple[Array, Array]:
        """Rows (c, m), over the joints' scales, and bounds (c,), m, of the distances from bodies that a step within
        `rate` (m,) could make too small; the guard sees what is more."""
        scene, clearance = self.guard.scene, self.options.clearance
        moved = np.linalg.norm(self.space.by_joints(at.along), axis=1) @ rate
        farthest = BODY_REACH * self.space.length
        reach = clearance + APART + min(float(moved.max()) / APPROACH, farthest)
        self.guard.sight = FARTHER * reach
        contacts = at.outline.contacts(scene, reach)
        if not len(contacts.body):
            return np.zeros((0, len(rate))), np.zeros(0)
        slope = at.contact_slopes(scene, contacts)
        least, most = APPROACH * (clearance + APART - contacts.distance), np.abs(slope) @ rate
        counts = most >= -least
        return slope[counts] * self.space.scale, np.minimum(least, RISE * most)[counts]

    def _task(self, group: Sequence[str], command: Command, at: Posture, dt: float) -> Task | None:
        """The task of a priority; None where nothing of it is commanded. Of an empty one, the objective."""
        if not group:
            step = self._objective(at, dt)
            return Task(np.eye(len(step)), step, damped=False)
        of_kind = {
            "position": self._position,
            "velocity": self._velocity,
            "direction": self._direction,
            "pivot": self._pivot,
            "joints": self._joints,
        }
        rows, targets = [], []
        for name in group:
            if (target := getattr(command, name)) is not None:
                row, gap = of_kind[name](target, at, dt)
                rows.append(row * self.space.scale)
                targets.append(gap)
        return Task(np.concatenate(rows), np.concatenate(targets), damped=True) if rows else None

    def _position(self, target: Array, at: Posture, dt: float) -> tuple[Array, Array]:
        length = self.space.length
        return at.jacobian.tip / length, _at_most(self.options.speed * dt, target - at.tip) / length

    def _velocity(self, velocity: Array, at: Posture, dt: float) -> tuple[Array, Array]:
        return at.jacobian.tip / self.space.length, _at_most(self.options.speed, velocity) * (dt / self.space.length)

    def _direction(self, direction: Array, at: Posture, dt: float) -> tuple[Array, Array]:
        here = at.direction
        # As fast as the tip would turn about a tenth of the robot.
        most = 10 * self.options.speed * dt / self.space.length
        return np.cross(at.jacobian.turn, here[:, None], axis=0), _at_most(most, direction - here)

    def _pivot(self, pivot: Array, at: Posture, dt: float) -> tuple[Array, Array]:
        """The closest point of the arm moves onto the pivot, in the plane normal to the arm."""
        arm = at.equilibrium
        start, chord = arm.position[:-1], np.diff(arm.position, axis=0)
        square = np.maximum((chord**2).sum(1), 1e-300)
        along = np.clip(((pivot - start) * chord).sum(1) / square, 0, 1)
        feet = start + along[:, None] * chord
        k = int(np.argmin(((pivot - feet) ** 2).sum(1)))
        moved = (1 - along[k]) * at.along[k] + along[k] * at.along[k + 1]
        across = arm.frame[k][:, :2].T / self.space.length
        gap = _at_most(self.options.speed * dt / self.space.length, across @ (pivot - feet[k]))
        return self.space.by_joints(across @ moved), gap

    def _joints(self, goal: Configuration, at: Posture, dt: float) -> tuple[Array, Array]:
        """Straight there, as fast as the slowest joint allows."""
        space, n = self.space, self.space.robot.n_tubes
        gap = at_most(configuration(space, "joints", goal), "joints") - at.q
        rate = np.where(np.arange(len(gap)) < n, self.options.turn_rate, self.options.shift_rate) * dt
        steps = float((np.abs(gap) / np.maximum(rate, 1e-300)).max())
        return np.diag(1 / space.scale), gap / max(steps, 1.0) / space.scale

    def _objective(self, at: Posture, dt: float) -> Array:
        """(m,) the step over the joints' scales that is best for the objective, as long as `push` of the rates."""
        space, name = self.space, self.options.objective
        if name == "margin":
            pull = at.margin_slope() * space.scale
        elif name == "centre":
            middle = np.where(np.isfinite(space.lower + space.upper), (space.lower + space.upper) / 2, at.q)
            pull = (middle - at.q) / space.scale
        else:
            pull = -_softness(at) * space.scale
        size = float(np.linalg.norm(pull))
        longest = self.options.push * min(self.options.turn_rate * dt, TURN)
        return pull * min(1.0, longest / size) if name == "centre" and size else pull * (longest / max(size, 1e-300))


def _at_most(length: float, vector: Array) -> Array:
    """A vector, shortened to a length where it is longer."""
    return vector * min(length / max(hypot(*vector.tolist()), 1e-300), 1.0)


def _softness(at: Posture, turn: float = 1e-4) -> Array:
    """(m,) relative change of the translational compliance of the tip by the joints, by differences; 0 without a
    kernel, and where a difference cannot be had."""
    space, here = at.space, _yield(at.equilibrium)
    out = np.zeros(len(at.q))
    for k in range(len(out)) if here is not None else ():
        q = at.q.copy()
        q[k] += turn * space.scale[k] * (1 if q[k] < space.upper[k] else -1)
        there = one_step(space.robot, at.equilibrium, *space.split(q))
        found = None if there is None else _yield(there)
        if here is not None and found is not None:
            out[k] = (found / here - 1) / (q[k] - at.q[k])
    return out


def _yield(at: Equilibrium) -> float | None:
    """Trace of the translational compliance of the tip, m/N; None without a kernel."""
    slopes = compiled_slopes(at, compliance=True)
    return None if slopes is None or slopes.compliance is None else float(np.trace(slopes.compliance[:3, :3]))
