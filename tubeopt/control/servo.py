"""A servo: one small step of the joints after another towards what is commanded, on the branch, with the snap guarded.

Each step is a sequence of small quadratic programs, one per priority, in what the ones before leave free (Kanoun,
Lamiraux and Wieber, IEEE T-RO 27 (2011)): the tip's way in least squares with a little damping, within rates and
ranges of the joints, the order of tubes and carriages, a floor for the margin by its gradient, and distances from
bodies by theirs. Then its equilibrium is solved for from the last one, and the step is halved, and at last not made,
where the guard objects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..bodies.obstacles import Obstacle
from ..bodies.scene import scene_of
from ..display import Displayed
from ..equilibrium.kinematics import one_step
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, vector
from ..inverse.goal import NEAR, angle
from ..inverse.joints import Configuration, JointSpace, configuration, joint_space
from ..inverse.least_squares import constrained_least_squares
from ..inverse.posture import Posture
from ..inverse.question import seed_posture
from ..robots.limits import JointLimits
from ..robots.robot import Robot
from ..solvers.compiled.binding import Slopes, Start, slopes_compiled
from ..solvers.parallel.blas import small
from ..typing import Array
from .why import Why

DAMPING = 1e-3
"""Of a joint's way over its scale against the tip's over the robot's length."""

HALVINGS = 4
"""Times that a step is halved which the guard does not let pass."""

APPROACH = 0.5
"""Share of what is left of margin and clearance that one step may take."""

ROOM, RISE = 0.01, 0.3
"""Margin above its floor at which the tip slides, as a step along the floor bends away from it; and the share of what
the joints could do for the margin that a step must do at most."""

TURN, SHIFT = 0.3, 0.05
"""Longest step whatever the rates: rad, and share of the longest tube."""

FREE = 1e-6
"""Singular value of a task below which it leaves a motion free."""

TASKS = ("position", "velocity", "direction", "pivot", "joints")
OBJECTIVES = ("margin", "centre", "compliance")


@dataclass(frozen=True, eq=False)
class Command:
    """What the tip shall do; what is None is free.

    position (3,) m, or velocity (3,) m/s of the tip; direction (3,) along which it shall point; pivot (3,) m: a point
    that the arm shall pass through, as at an incision; joints: rotations and translations to go to, as a configuration.
    """

    position: ArrayLike | None = None
    velocity: ArrayLike | None = None
    direction: ArrayLike | None = None
    pivot: ArrayLike | None = None
    joints: Configuration | None = None

    def __post_init__(self) -> None:
        for name in TASKS[:4]:
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, vector(name, value, 3, "x, y, z"))
        if self.position is not None and self.velocity is not None:
            raise InputError("position and velocity are both given; a command has one of them")
        if self.direction is not None and not np.linalg.norm(self.direction) > 0:
            raise InputError("direction has no length")


@dataclass(frozen=True)
class ServoOptions:
    """How a servo moves.

    speed: most that the tip is asked to move, m/s.   turn_rate, shift_rate: most of every joint, rad/s and m/s.
    min_margin: floor of the margin.   clearance: of bodies, m.   priorities: tasks of TASKS, the most important first;
    those of one word, as "position+direction", count alike.   objective: one of OBJECTIVES, to which goes what the
    tasks leave free: margin, the middle of the ranges, or the compliance of the tip, which is made small.   push:
    share of the rates that goes there.
    """

    speed: float = 0.05
    turn_rate: float = 3.0
    shift_rate: float = 0.05
    min_margin: float = 0.1
    clearance: float = 0.0
    priorities: tuple[str, ...] = ("pivot", "position+velocity+direction+joints")
    objective: str | None = None
    push: float = 0.2

    def __post_init__(self) -> None:
        for name in ("speed", "turn_rate", "shift_rate", "clearance", "push"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise InputError(f"{name} is {value:g}; it must be at least 0")
        if not 0 < self.min_margin < 1:
            raise InputError(f"min_margin is {self.min_margin:g}; it must be between 0 and 1")
        named = [name for group in self.priorities for name in group.split("+")]
        if sorted(set(named)) != sorted(named) or not set(named) <= set(TASKS):
            raise InputError(f"priorities are {list(self.priorities)}; each of {', '.join(TASKS)} may stand there once")
        if self.objective is not None and self.objective not in OBJECTIVES:
            raise InputError(f"objective is {self.objective!r}; it must be one of {', '.join(OBJECTIVES)}")


@dataclass(frozen=True, eq=False)
class ServoStep(Displayed):
    """A step that was made.

    equilibrium: where the robot is to be, with its joint values.   why: what was in the way.   distance, angle: from
    the tip to where it shall be (m), and from its direction to the wanted one (rad), before the step; NaN where not
    asked.
    """

    equilibrium: Equilibrium
    why: Why
    distance: float
    angle: float

    @property
    def rotations(self) -> Array:
        """(n,) to be sent, rad."""
        return self.equilibrium.rotations

    @property
    def translations(self) -> Array:
        """(n,) to be sent, m."""
        return self.equilibrium.translations


class Servo:
    """The servo of one robot.

    Args:
        seed: where the robot is: a configuration or an equilibrium, whose branch is kept.
        limits, obstacles: as for `inverse_kinematics`.   options: see `ServoOptions`.

    Raises:
        InputError: the seed is outside the limits, or closer to a snap than the floor of the margin.
        SolveError: no stable equilibrium is found at the seed.
    """

    def __init__(
        self,
        robot: Robot,
        seed: Configuration,
        *,
        limits: JointLimits | None = None,
        obstacles: Sequence[Obstacle] = (),
        options: ServoOptions | None = None,
    ) -> None:
        self.options = options or ServoOptions()
        self.space: JointSpace = joint_space(robot, limits)
        self._scene = scene_of(tuple(obstacles))
        self._here = seed_posture(self.space, seed)
        if not self.space.admissible(self._here.q):
            raise InputError("seed lies outside the limits of the joints or the order of the tubes")
        if self._here.margin < self.options.min_margin:
            raise InputError(
                f"seed has margin {self._here.margin:.3g}; it must be min_margin, {self.options.min_margin:g}, or more"
            )
        if self.options.objective == "compliance" and _compiled_slopes(self._here.equilibrium) is None:
            raise InputError("objective is 'compliance', which needs a compiled kernel for the robot; take another one")

    @property
    def equilibrium(self) -> Equilibrium:
        """Where the robot is."""
        return self._here.equilibrium

    @small
    def step(self, command: Command, dt: float) -> ServoStep:
        """One step of `dt` seconds; it always answers, with the joint values to hold where nothing else is safe."""
        if not (np.isfinite(dt) and dt > 0):
            raise InputError(f"dt is {dt:g} s; it must be more than 0")
        here, look = self._here, _Look(self._here)
        rows, bounds, kinds = self._hedges(look, dt)
        told = self._left(command)
        groups = (self._task(group, command, look, dt) for group in [*self.options.priorities, ""])
        tasks = [task for task in groups if task is not None]
        if not tasks:
            return ServoStep(here.equilibrium, Why(0), *told)
        # Where the margin cannot be raised, it is at least not lowered: then to stay keeps all.
        found = _in_turn(tasks, rows, bounds) or _in_turn(tasks, rows, np.minimum(bounds, 0.0))
        if found is None:
            return ServoStep(here.equilibrium, Why.HELD, *told)
        why = Why(0)
        for kind in {kinds[k] for k in found[1]}:
            why |= kind
        return ServoStep(*self._guarded(here, found[0] * self.space.scale, why), *told)

    def _guarded(self, here: Posture, change: Array, why: Why) -> tuple[Equilibrium, Why]:
        """The equilibrium after a change of the joints, of as much of it as the guard lets pass."""
        if not np.abs(change / self.space.scale).max() > 1e-14:
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
            if self._scene.bodies and self._missing(posture) > max(0.0, self._missing(here)):
                continue
            self._here = posture
            return there, why | (Why.SHORTENED if halving else Why(0))
        return here.equilibrium, why | Why.HELD

    def _missing(self, at: Posture) -> float:
        """Clearance (m) that is missing."""
        return self.options.clearance - at.outline.clearance(self._scene, self.options.clearance)

    def _left(self, command: Command) -> tuple[float, float]:
        """Distance (m) and angle (rad) from what is commanded; NaN where nothing is."""
        here = self._here
        away = np.nan if command.position is None else float(np.linalg.norm(np.asarray(command.position) - here.tip))
        if command.direction is None:
            return away, np.nan
        return away, angle(here.direction, np.asarray(command.direction) / np.linalg.norm(command.direction))

    def _hedges(self, look: _Look, dt: float) -> tuple[Array, Array, list[Why]]:
        """Rows and bounds of a step over the joints' scales, and what each stands for; what is missed already must not
        get worse."""
        space, options, here = self.space, self.options, look.at
        n, m = space.robot.n_tubes, len(here.q)
        rate = np.full(m, min(options.turn_rate * dt, TURN))
        rate[n:] = min(options.shift_rate * dt, SHIFT * space.length)
        low, high = np.minimum(space.lower - here.q, 0.0), np.maximum(space.upper - here.q, 0.0)
        kinds = [Why.RANGE if a > -r else Why.RATE for a, r in zip(low, rate, strict=True)]
        kinds += [Why.RANGE if a < r else Why.RATE for a, r in zip(high, rate, strict=True)]
        unit = np.eye(m)
        rows = [unit, -unit, space.rows * space.scale]
        bounds = [np.maximum(low, -rate) / space.scale, -np.minimum(high, rate) / space.scale]
        bounds.append(np.minimum(space.least - space.rows @ here.q, 0.0))
        kinds += [Why.ORDER] * len(space.least)
        if look.margin.any():
            raised = look.margin * space.scale
            rows.append(raised[None])
            most = RISE * float(np.maximum(-raised * bounds[1], raised * bounds[0]).sum())
            bounds.append(np.array([min(APPROACH * (options.min_margin + ROOM - here.margin), most)]))
            kinds.append(Why.MARGIN)
        if self._scene.bodies:
            contacts = here.outline.contacts(self._scene, options.clearance + NEAR * space.length)
            rows.append(here.contact_slopes(self._scene, contacts) * space.scale)
            bounds.append(np.minimum(APPROACH * (options.clearance - contacts.distance), 0.0))
            kinds += [Why.OBSTACLE] * len(contacts.distance)
        return np.vstack(rows), np.concatenate(bounds), kinds

    def _task(self, group: str, command: Command, look: _Look, dt: float) -> tuple[Array, Array, bool] | None:
        """Rows and right-hand sides of a priority, over the joints' scales, and whether it uses up what it moves; None
        where nothing of it is commanded. Of the last, "", the objective."""
        if not group:
            pull = self._objective(look, dt)
            return None if pull is None else (np.eye(len(pull)), pull, False)
        rows, right = [], []
        for name in group.split("+"):
            if getattr(command, name) is not None:
                row, gap = getattr(self, f"_{name}")(getattr(command, name), look, dt)
                rows.append(row * self.space.scale)
                right.append(gap)
        return (np.vstack(rows), np.concatenate(right), True) if rows else None

    def _position(self, target: Array, look: _Look, dt: float) -> tuple[Array, Array]:
        gap = target - look.at.tip
        most = self.options.speed * dt / max(float(np.linalg.norm(gap)), 1e-300)
        return look.tip / self.space.length, min(most, 1.0) * gap / self.space.length

    def _velocity(self, velocity: Array, look: _Look, dt: float) -> tuple[Array, Array]:
        most = self.options.speed / max(float(np.linalg.norm(velocity)), 1e-300)
        return look.tip / self.space.length, min(most, 1.0) * velocity * dt / self.space.length

    def _direction(self, direction: Array, look: _Look, dt: float) -> tuple[Array, Array]:
        here = look.at.direction
        gap = direction / np.linalg.norm(direction) - here
        # As fast as the tip would turn about a tenth of the robot.
        most = 10 * self.options.speed * dt / self.space.length / max(float(np.linalg.norm(gap)), 1e-300)
        return np.cross(look.turn, here[:, None], axis=0), min(most, 1.0) * gap

    def _pivot(self, pivot: Array, look: _Look, dt: float) -> tuple[Array, Array]:
        """The arm where it passes the point closest is to come to it, across its tangent."""
        arm = look.at.equilibrium
        along = [
            float(np.clip((pivot - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-300), 0, 1))
            for a, b in pairwise(arm.position)
        ]
        feet = [a + x * (b - a) for x, (a, b) in zip(along, pairwise(arm.position), strict=True)]
        k = int(np.argmin([np.linalg.norm(pivot - foot) for foot in feet]))
        moved = (1 - along[k]) * look.at.along[k] + along[k] * look.at.along[k + 1]
        across = arm.frame[k][:, :2].T / self.space.length
        gap = across @ (pivot - feet[k])
        most = self.options.speed * dt / self.space.length / max(float(np.linalg.norm(gap)), 1e-300)
        return across @ moved @ self.space.spread, min(most, 1.0) * gap

    def _joints(self, goal: Configuration, look: _Look, dt: float) -> tuple[Array, Array]:
        """Straight there, as fast as the slowest joint allows."""
        space, n = self.space, self.space.robot.n_tubes
        gap = configuration(space, "joints", goal) - look.at.q
        rate = np.where(np.arange(len(gap)) < n, self.options.turn_rate, self.options.shift_rate) * dt
        share = float((np.abs(gap) / np.maximum(rate, 1e-300)).max())
        return np.diag(1 / space.scale), gap / max(share, 1.0) / space.scale

    def _objective(self, look: _Look, dt: float) -> Array | None:
        """(m,) the step over the joints' scales that is best for the objective, as long as `push` of the rates."""
        space, name = self.space, self.options.objective
        if name is None:
            return None
        if name == "margin":
            pull = look.margin * space.scale
        elif name == "centre":
            middle = np.where(np.isfinite(space.lower + space.upper), (space.lower + space.upper) / 2, look.at.q)
            pull = (middle - look.at.q) / space.scale
        else:
            pull = -look.softness(self.space) * space.scale
        size = float(np.linalg.norm(pull))
        longest = self.options.push * min(self.options.turn_rate * dt, TURN)
        return pull * min(1.0, longest / size) if name == "centre" and size else pull * (longest / max(size, 1e-300))


class _Look:
    """Derivatives at a posture by its joints: of the tip (3, m), its turn vector (3, m) and the margin (m,); by the
    compiled kernel where it has them."""

    def __init__(self, at: Posture) -> None:
        self.at = at
        found = self._compiled()
        known = (at.jacobian[0], at.jacobian[1], at.margin_slope()) if found is None else found
        self.tip, self.turn, self.margin = known

    def _compiled(self) -> tuple[Array, Array, Array] | None:
        """All three by the kernel, of the side to which each joint is free to move; None where it has none."""
        at, tables = self.at, []
        blocked = at.space.only_backward(at.q)
        for side in (1, -1) if blocked.any() else (1,):
            slopes = _compiled_slopes(at.equilibrium, side)
            if slopes is None:
                return None
            tables.append([part @ at.space.spread for part in (slopes.position, slopes.turn, slopes.margin)])
        tip, turn, margin = (np.where(blocked, back, on) for on, back in zip(tables[0], tables[-1], strict=True))
        return tip, turn, margin

    def softness(self, space: JointSpace, turn: float = 1e-4) -> Array:
        """(m,) relative change of the translational compliance of the tip by the joints, by differences; 0 without a
        kernel, and where a difference cannot be had."""
        here = _compiled_slopes(self.at.equilibrium)
        out = np.zeros(len(self.at.q))
        for k in range(len(out)) if here is not None else ():
            q = self.at.q.copy()
            q[k] += turn * space.scale[k] * (1 if q[k] < space.upper[k] else -1)
            there = one_step(space.robot, self.at.equilibrium, *space.split(q))
            slopes = None if there is None else _compiled_slopes(there)
            if here is not None and slopes is not None:
                stiff, soft = (float(np.trace(each.compliance[:3, :3])) for each in (here, slopes))
                out[k] = (soft / stiff - 1) / (q[k] - self.at.q[k])
        return out


def _compiled_slopes(at: Equilibrium, side: int = 1) -> Slopes | None:
    still = np.zeros(at.robot.n_tubes)
    arm = at.arc_length, at.rotation, at.torsion, at.point, at.point_rotation
    return slopes_compiled(at.robot, at.rotations, at.translations, Start(*arm, still, at.translations), side)


def _in_turn(
    tasks: Sequence[tuple[Array, Array, bool]], rows: Array, bounds: Array
) -> tuple[Array, NDArray[np.intp]] | None:
    """A step that does one task after the other, each in what those before it leave free, and which rows hold it; None
    where no step keeps them."""
    wanted, free = np.zeros(rows.shape[1]), np.eye(rows.shape[1])
    held: NDArray[np.intp] = np.zeros(0, dtype=np.intp)
    for matrix, right, uses in tasks:
        if not free.shape[1]:
            break
        inside, damping = matrix @ free, DAMPING if uses else 0.0
        found = constrained_least_squares(
            np.vstack([inside, damping * np.eye(free.shape[1])]),
            np.concatenate([right - matrix @ wanted, np.zeros(free.shape[1])]),
            rows @ free,
            # What rounding has taken from a step that keeps them all.
            bounds - rows @ wanted - (1e-12 if held.size or wanted.any() else 0.0),
        )
        if found is None:
            return None
        wanted, held = wanted + free @ found.x, np.flatnonzero(found.active)
        if uses:
            _, size, basis = np.linalg.svd(inside)
            free = free @ basis[np.count_nonzero(size > FREE) :].T
    return wanted, held
