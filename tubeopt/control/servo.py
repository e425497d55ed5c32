"""The guard: no step is given out that leaves the branch, the floor of the margin, or the clearance of bodies.

The equilibrium of a step is solved for from the last one. Where Newton's method is not at ease, where the tubes twist
farther than a small motion twists them, where margin or clearance fall short, the step is halved, and at last not made.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from math import dist, hypot
from typing import Any, NamedTuple

import numpy as np

from ..arguments import typed
from ..bodies.obstacles import ClearanceMonitor, Obstacle, Scene, checked_obstacles, scene_of
from ..equilibrium.jacobian import compiled_slopes, compiled_turn
from ..equilibrium.kinematics import forward_kinematics, one_step
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError
from ..inverse.breakpoint_order import breakpoint_order, breakpoints_at_zero
from ..inverse.goal import BODY_REACH, angle
from ..inverse.joints import Configuration, JointSpace, configuration, joint_space, shift_of
from ..inverse.posture import Posture, start_posture
from ..robots.assembly import LENGTH_ROUND_OFF
from ..robots.limits import JointLimits
from ..robots.robot import Robot
from ..solvers.blas import small
from ..solvers.compiled.quadratic import constrained_least_squares
from ..stability.snap_distance import proved_turn
from ..typing import Array, Index
from .closest import ClosestSearch
from .command import Command, ServoOptions, ServoStep, Why, at_most, check_places, time_step

# Times that a step is halved which the guard rejects: a sixteenth of a step is not worth its equilibrium.
HALVINGS = 4


class Ball(NamedTuple):
    """Joint values around which a rotation of every tube by up to `radius` is proved to cause no snap."""

    rotations: Array
    """(n,) rotations of the joints, rad."""
    translations: Array
    """(n,) translations of the tubes, m."""
    radius: float
    """Largest turn of every tube that is proved to cause no snap, rad; 0 without a proof."""

    def left(self, arm: Equilibrium) -> float:
        """Turn that the proof still allows for all tubes at joint values, rad; -1 outside of its range."""
        if np.abs(arm.translations - self.translations).max() > LENGTH_ROUND_OFF:
            return -1.0
        return max(-1.0, self.radius - float(np.ptp(arm.rotations - self.rotations)) / 2)


class GuardState(NamedTuple):
    """State that `undo` restores."""

    posture: Posture
    """Stop point of the robot."""
    arm: Equilibrium
    speed: Array
    """(m,) speeds of the joints, rad/s and m/s."""


class Guard:
    """State of a robot and the safety check of its next step; arguments and errors as of `Servo`."""

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
        self.posture: Posture
        """Posture of rest after braking from now on; without accelerations, the current one."""
        self.arm: Equilibrium
        """Current equilibrium of the robot."""
        self.speed: Array
        """(m,) speeds of the joints after the last step, rad/s and m/s."""
        self.before: GuardState
        eccentric = bool(robot.axes.any()) or not robot.fixed_sections
        self.min_distance: float | None = None if eccentric else options.min_snap_distance
        """Turn (rad) that must be proved to cause no snap where the robot stops; None if the margin counts."""
        self.ball: Ball
        """Last proof of it."""
        self.margin_limit = 0.0
        """Margin that the next step keeps in its place, since less was closer to a snap."""
        self.restart(start)
        rotation = np.arange(len(self.posture.q)) < robot.n_tubes
        accelerations = [getattr(options, f"{name}_acceleration") or np.inf for name in ("turn", "shift")]
        self.acceleration: Array = np.where(rotation, *accelerations)
        self.rate: Array = np.where(rotation, options.turn_rate, options.shift_rate)
        self.limited = bool(np.isfinite(self.acceleration).any())
        breaks = [*breakpoints_at_zero(self.space), (0, None)]
        one, two = np.triu_indices(len(breaks), 1)
        moved = np.array([np.eye(len(self.posture.q))[robot.n_tubes + c] * (s is not None) for c, s in breaks])
        zero = np.array([s or 0.0 for _, s in breaks])
        self._apart: tuple[Array, Array] = ((moved[one] - moved[two]).T, zero[one] - zero[two])
        """(m, p) slopes and (p,) distances at joint values 0, m, of pairs of breakpoints, the plate among them."""
        self.sight = 0.0
        """Distance (m) up to which bodies are searched at the end of a step: once for the guard and the next step."""

    def restart(self, start: Configuration) -> None:
        """Set the state to rest at a start; errors as of `Servo`."""
        current, least = start_posture(self.space, start), self.options.min_margin
        if violation := self.space.outside(current.q):
            raise InputError(f"start is out of range: {violation}")
        self.ball, self.margin_limit = Ball(current.equilibrium.rotations, current.equilibrium.translations, 0.0), 0.0
        if self.min_distance is not None:
            if proved_turn(current.equilibrium, self.min_distance) < self.min_distance:
                raise InputError(
                    f"start has a snap distance below min_snap_distance, {np.degrees(self.min_distance):g} deg; "
                    "start where no such turn of the tubes snaps"
                )
            self.ball = self.ball._replace(radius=self.min_distance)
        elif current.margin < least:
            raise InputError(f"start has margin {current.margin:.3g}; it must be min_margin, {least:g}, or more")
        self.posture, self.arm, self.speed = current, current.equilibrium, np.zeros(len(current.q))
        self.keep()

    def keep(self) -> None:
        """Store the state that `undo` restores."""
        self.before = GuardState(self.posture, self.arm, self.speed)

    def undo(self) -> None:
        """Restore the state before the last step."""
        self.posture, self.arm, self.speed = self.before

    def ends(self, dt: float) -> tuple[Array, Array]:
        """(m,) smallest and largest change of the stop point in a cycle, within rates and accelerations.

        The robot q follows its stop point s = q + v |v| / (2 a). A new speed v' leads to s = q + v' dt + v' |v'| / 2a.
        """
        if not self.limited:
            return -self.rate * dt, self.rate * dt
        v, most = self.speed, self.acceleration * dt
        fast = np.minimum(v + most, np.maximum(self.rate, v - most))
        slow = np.maximum(v - most, np.minimum(-self.rate, v + most))
        ahead = self.posture.q - self._joints(self.arm)
        low, high = (by * dt + by * np.abs(by) / (2 * self.acceleration) - ahead for by in (slow, fast))
        return low, high

    def go(
        self, change: Array, why: Why, dt: float, closer: Callable[[Posture, float], bool] = lambda _, __: True
    ) -> tuple[Equilibrium, Why]:
        """Equilibrium after the largest safe part of a change (m,) of the stop point, and the reasons for shortening.

        `closer` decides whether a part of the change brings the tip closer to its target; where none does, the robot
        rests.
        """
        current = self.posture
        self.keep()
        if not any(abs(by) > 1e-14 for by in (change / self.space.scale).tolist()):
            return self._follow(dt), why
        floor, guarded, passed = min(self.options.min_margin, current.margin), False, False
        for halving in range(HALVINGS + 1):
            q = current.q + change / 2**halving
            posture = self._passes(q, floor)
            if posture is not None and not self.limited and not self._keeps_at_kinks(current.q, q, floor):
                posture = None
            ball = None if posture is None else self._proved(posture)
            if posture is None or ball is None:
                guarded = True
            elif closer(posture, 1 / 2**halving):
                reserve = min(floor + ROOM / 2, posture.margin, self.arm.margin)
                if not self.limited or ball.left(self.arm) > 0 or self._can_brake(posture, reserve, dt):
                    self.posture, self.ball, passed = posture, ball, True
                    break
                guarded = True
        self.margin_limit = current.margin if guarded else self.margin_limit if Why.MARGIN in why else 0.0
        if passed:
            why |= Why.SHORTENED if guarded else Why(0)
        else:
            why = Why.HELD if guarded else why & ~Why.RATE | Why.NO_CLOSER
        return self._follow(dt), why

    def _passes(self, q: Array, floor: float) -> Posture | None:
        """Posture at joint values q (m,) of a stop point; None if the posture, or the motion to it, is not allowed."""
        rotations, shift = self.space.split(q)
        try:
            reached = one_step(self.space.robot, self.posture.equilibrium, rotations, shift)
        except (SolveError, InputError):
            return None
        if reached is None or (self.min_distance is None and reached.margin < floor):
            return None
        posture = Posture(self.space, q, reached)
        if self.scene.bodies:
            posture.surface.look_around(self._monitor, self.sight)
            if (missing := self._missing(posture)) > 0 and missing > self._missing(self.posture):
                return None
        return posture

    def _proved(self, at: Posture) -> Ball | None:
        """Last proof, or a new one for a posture, of a turn of at least `self.min_distance`; None without a proof.

        While tubes only turn, a ball WIDER as large is tried first: further steps in it need no proof.
        """
        arm, distance = at.equilibrium, self.min_distance
        if distance is None or self.ball.left(arm) >= distance:
            return self.ball
        turns = np.array_equal(arm.translations, self.posture.equilibrium.translations)
        wide = min(WIDER * distance, FARTHEST_TURN) if turns else distance
        proved = proved_turn(arm, wide)
        if proved < distance < wide:
            proved = proved_turn(arm, distance)
        return Ball(arm.rotations, arm.translations, proved) if proved >= distance else None

    def _can_brake(self, rest: Posture, floor: float, dt: float) -> bool:
        """True if the margin stays above `floor` at the next position of the robot and while it brakes to rest.

        In a ball about its stop point, without slides, it does so without a check. Further places are those where
        breakpoints meet: there the margin has kinks, and falls steeply towards them. Where the least margin is close to
        the floor, there are two more about it.
        """
        q, speed = self._next(rest.q, dt)
        longest = float((np.abs(speed) / self.acceleration).max())

        def place(time: float) -> Array:
            left = np.maximum(0.0, 1 - time * longest * self.acceleration / np.maximum(np.abs(speed), 1e-300))
            return np.asarray(rest.q - (rest.q - q) * np.where(speed == 0, 1.0, left**2))

        def margin(time: float) -> float:
            return self._margin(place(time), self.arm)

        if not self._keeps_at_kinks(self._joints(self.arm), q, floor):
            return False
        least, at, here = rest.margin, len(BRAKING) - 1, q
        for k, (time, next_time) in enumerate(pairwise(BRAKING)):
            there = place(next_time)
            found = self._margin(here, self.arm)
            if found < floor:
                return False
            if self._meet(here, there) and any(margin(kink) < floor for kink in self._kinks(place, time, next_time)):
                return False
            least, at, here = *min((least, at), (found, k)), there
        neighbours = BRAKING[max(at - 1, 0) : at + 2] if least < floor + 4 * ROOM else ()
        return all(margin((one + two) / 2) >= floor for one, two in pairwise(neighbours))

    def _margin(self, q: Array, arm: Equilibrium) -> float:
        """Margin at joint values q (m,) close to those of an arm; -1 if no equilibrium is found."""
        try:
            reached = one_step(self.space.robot, arm, *self.space.split(q))
        except (SolveError, InputError):
            return -1.0
        return -1.0 if reached is None else reached.margin

    def _keeps_at_kinks(self, start: Array, q: Array, floor: float) -> bool:
        """True if the margin keeps a floor where breakpoints meet on a straight path of the robot to q (m,).

        There it has kinks, and falls steeply towards them: the robot can snap there, between two places with margins
        above the floor.
        """
        if not self._meet(start, q):
            return True
        least = floor if self.min_distance is None else 0.0

        def place(time: float) -> Array:
            return start + time * (q - start)

        return all(self._margin(place(time), self.arm) >= least for time in self._kinks(place, 0.0, 1.0))

    def _kinks(self, place: Callable[[float], Array], start: float, end: float) -> Iterator[float]:
        """Times between two at which breakpoints meet each other or the plate on a path."""
        last = place(end)
        while self._meet(first := place(start), last):
            low, high = start, end
            for _ in range(20):
                middle = (low + high) / 2
                low, high = (low, middle) if self._meet(first, place(middle)) else (middle, high)
            yield high
            start = high

    def _meet(self, one: Array, two: Array) -> bool:
        """True if a pair of breakpoints changes its order between joint values (m,)."""
        slopes, zero = self._apart
        before, after = one @ slopes + zero, two @ slopes + zero
        changed = before * after < 0
        return bool(changed.any() and (np.minimum(np.abs(before), np.abs(after))[changed] > KEPT).any())

    def _next(self, stop: Array, dt: float) -> tuple[Array, Array]:
        """(m,) joint values after a cycle, from which the robot can brake to its stop point s.

        Speeds are v = sgn(d) (sqrt((a dt)^2 + 2 a |d|) - a dt), of d = s - q, with d' = v |v| / (2 a).
        """
        q = self._joints(self.arm)
        d = stop - q
        speed = 2 * d / (dt + np.sqrt(dt**2 + 2 * np.abs(d) / self.acceleration))
        return np.where(np.isfinite(self.acceleration), q + dt * speed, stop), speed

    def _follow(self, dt: float) -> Equilibrium:
        """Equilibrium of the robot after moving for one cycle towards its stop point."""
        if not self.limited:
            self.arm = self.posture.equilibrium
            return self.arm
        q, self.speed = self._next(self.posture.q, dt)
        reached = Posture(self.space, self._joints(self.arm), self.arm).to(q)
        if reached is None:  # the guard has looked ahead: it does not happen
            self.posture, self.speed = start_posture(self.space, self.arm), 0 * self.speed
        else:
            self.arm = reached.equilibrium
        return self.arm

    def _joints(self, arm: Equilibrium) -> Array:
        return self.space.join(arm.rotations, arm.translations)

    def _missing(self, at: Posture) -> float:
        """Missing clearance, m."""
        return self.options.clearance - at.surface.clearance(self.scene, self.options.clearance)

    def left(self, command: Command) -> tuple[float, float]:
        """Remaining distance (m) and angle (rad) to a command; NaN for parts that it does not have."""
        arm = self.arm
        away = np.nan if command.position is None else dist(command.position, arm.tip_position)
        pointing = arm.tip_rotation[:, 2]
        return away, np.nan if command.direction is None else angle(pointing, command.direction)


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

# Largest of this room over the length of the last step over the scales: as steps become short, so does their error, and
# the robot rests close to the lower bound. A quarter of this held it where no further step was safe.
ROOM_PER_STEP = 20.0

# Largest required rise of margin or distance, as a fraction of what the joints can do within their rates. With 1 the
# rows would leave no step but one, and no joint motion for the task.
RISE = 0.3

# Factor on the least snap distance that is tried first, and largest turn (rad) that is tried.
WIDER, FARTHEST_TURN = 4.0, 3.0

# Factor on the distance within which this step searched bodies: the next step searches again only beyond it.
FARTHER = 1.2

# Longest step whatever the rates: rad, and fraction of the longest tube. Newton's method follows a branch over such
# steps; the guard would reject most longer ones.
TURN, SHIFT = 0.3, 0.05

# Speed (rad/s, m/s) below which a joint rests.
RESTS = 1e-9

# Relative precision of a snap distance that is reported: five checks.
TURN_PRECISION = 0.02

# Times at which the margin of a braking robot is checked, as fractions of the braking time: denser where it is fast.
BRAKING = 0.0, 0.13, 0.3, 0.5, 0.75, 1.0

# Distance (m) and angle (rad) at which a target is met.
MET = 1e-6

# Fraction of the predicted decrease of the distance that a step must have. Steps back and forth across a singular pose,
# at the edge of the reach, have none.
DESCENT = 0.25

# Largest curvature of the squared distance over the scales that damps a step, and largest factor on it of a joint that
# goes back and forth: where breakpoints coincide, the distance has kinks.
MOST_CURVED, MOST_STIFF = 4.0, 1e6

# Damped steps far from rest before one without damping, which is faster; twice as many each time.
PATIENCE = 8

# Fraction of the asked decrease of the distance below which the next step is damped, and solves for the whole distance.
SLOW = 0.01

# Motions of the target in a cycle below which its distance is that of tracking it. Where breakpoints meet, a step may
# miss by that much: damping would let the target run away.
TRACKED = 3.0

# Length of a step over the scales below which the curvature of the distance drowns in round-off.
SEEN = 1e-6

# Change over the scales below which a joint rests: its second-order effect on the tip is below round-off. Decrease of
# the distance over the robot's length, times two, below which the robot rests: 0.1 nm for an arm of 0.2 m.
DEAD, GAIN = 1e-7, 1e-9

# Length (m) of a section between breakpoints that steps keep open where they keep the order: derivatives are those of
# this side, and the tip is as close as at the kink to less than a micrometre.
KEPT = 1e-7

# Singular value of a task below which it leaves a motion free: above round-off of the Jacobian, below any motion that
# counts.
FREE = 1e-6


class Part(NamedTuple):
    """One part of a command."""

    name: str
    target: Any
    rows: Array
    """Derivatives of the part by the joints."""
    error: Array
    """Error to the target."""
    max_step: float
    """Largest motion in a cycle, in the norm of the error."""
    met: float
    """Largest norm of the error of a target that is met."""


class Task(NamedTuple):
    """One priority of a step as least squares over the joints' scales: matrix @ step = target."""

    matrix: Array
    target: Array
    damped: bool
    """False for the objective, which must not be slowed down by damping."""
    parts: tuple[Part, ...] = ()


class _Trial(NamedTuple):
    """Part of a step that the guard tried."""

    made: Array
    """(m,) step, over the scales; joints that it leaves alone have their last one."""
    whole: bool
    """True for the step without reduction."""
    descends: bool
    """True if the distance becomes so much shorter that the step is taken."""
    grows: bool
    """True if the step asks for more damping: it does not descend, or it turns back."""
    slow: bool
    """True if the distance decreases much less than far from its target."""
    curvature: float | None
    """Curvature of half the squared distance that Gauss-Newton leaves out; None for too short a step."""


class Constraints(NamedTuple):
    """Linear constraints rows @ step >= bounds on a step of the joints over their scales."""

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
        """Names of the tasks of each priority; with an objective, the last priority has none."""
        unit = np.eye(len(self.space.scale))
        self._sides = np.vstack([unit, -unit, self.space.rows * self.space.scale])
        """(2m + k, m) rows of rates and ranges, then of the order, over the joints' scales."""
        self._twice, self._unit = np.tile(self.space.scale, 2), unit
        self._damping = 0.0
        """Square of the additional damping; more than 0 after a step that did not bring the tip closer."""
        self._damped, self._patience = 0, PATIENCE
        """Number of damped steps far from rest, and number of those before a step without damping."""
        self._stiff: Array = np.ones(len(self.space.scale))
        """(m,) factors on it."""
        self._last: Array = np.zeros(len(self.space.scale))
        """(m,) last step over the scales."""
        self._ordered = self._progress = False
        """True if steps keep the order of breakpoints, and if one of them was taken."""
        self._first_order = 0
        """Number of the first row of the order of breakpoints."""
        self._tracked = 0.0
        """Distance (m) from a target below which the robot tracks it: it moves about as far in each cycle."""
        self._ease = 1.0
        """Part of the push of the objective: it halves where the push goes back and forth."""
        self._goal: Array | None = None

        def scout_of(at: Equilibrium, of: ServoOptions) -> Servo:
            return Servo(robot, at, limits=limits, obstacles=obstacles, options=of)

        self._closest = ClosestSearch(self, self.space, self.options, scout_of)
        if self.options.objective == "compliance" and compiled_slopes(self.equilibrium) is None:
            raise InputError(
                "objective is 'compliance'; it needs a compiled kernel for the robot; choose another objective"
            )

    @property
    def equilibrium(self) -> Equilibrium:
        """Current equilibrium of the robot."""
        return self.guard.arm

    @property
    def stop(self) -> Array:
        """(m,) joint values at which the robot comes to rest if it brakes from now on."""
        return self.guard.posture.q

    @property
    def limited(self) -> bool:
        """True if accelerations are limited."""
        return self.guard.limited

    @property
    def moving(self) -> bool:
        """True if the robot has to brake before it rests."""
        return bool((np.abs(self.guard.speed) > RESTS).any())

    @small
    def step(self, command: Command, dt: float) -> ServoStep[Equilibrium]:
        """Result of one step of `dt` seconds; if no motion is safe, the joint values do not change.

        Raises:
            InputError: `dt` or the joint values of the command are invalid.
        """
        dt = time_step(dt)
        check_places(command, self.space.robot)
        if command.closest:
            return self._closest.step(command, dt)
        guard, m = self.guard, len(self.space.scale)
        current = guard.posture
        remaining = guard.left(command)
        self._note_target(command, dt)
        groups = [group for group in self._groups if group or not self._damping]
        tasks = [task for group in groups if (task := self._task(group, command, current, dt)) is not None]
        if not tasks:
            return ServoStep(*guard.go(np.zeros(m), Why(0), dt), *remaining)
        limits = guard.ends(dt)
        low, high = self._box(limits, dt)
        rows, bounds, kinds = self._constraints(current, low, high)
        # Where the margin cannot be raised, it is at least not lowered: then to stay keeps all.
        solved = self._by_priority(tasks, rows, bounds) or self._by_priority(tasks, rows, np.minimum(bounds, 0.0))
        if solved is None:
            return ServoStep(guard.go(np.zeros(m), Why(0), dt)[0], Why.HELD, *remaining)
        step, active = solved
        why = self._why(active, current, low, high, kinds)
        # The first rows are rates and ranges, which nothing exceeds, not by rounding either.
        step = np.minimum(np.maximum(step, bounds[:m]), -bounds[m : 2 * m])
        arm, why = self._take(step, [part for task in tasks for part in task.parts], limits, why, dt)
        missed = any(float(np.linalg.norm(part.error)) > part.met for task in tasks for part in task.parts)
        if missed and guard.posture is current and Why.HELD not in why:
            why |= Why.NO_CLOSER
        self._choose_order(guard.posture is current, Why.NO_CLOSER in why, bool((active >= self._first_order).any()))
        return ServoStep(arm, why, *remaining)

    def snap_distance(self, most: float) -> float | None:
        """Rotation of all tubes that is proved to cause no snap, rad, at most `most`; inf if none can snap, None if
        unknown.
        """
        found = compiled_turn(self.equilibrium, most=most, precision=TURN_PRECISION)
        return None if found is None else found.turn

    def undo(self) -> None:
        """Undo the last step, which was not sent to the drives."""
        self.guard.undo()

    def resume(self, joints: Configuration) -> None:
        """Continue at rest from joint values reached by another motion, on the branch of the straight path to them.

        Raises:
            InputError: they are out of range, or the margin there is below the smallest allowed one.
            SolveError: that motion snaps.
        """
        rotations, translations = self.space.split(configuration(self.space, "joints", joints))
        self.restart(forward_kinematics(self.space.robot, rotations, translations, start=self.equilibrium))
        self._closest.reset()

    def restart(self, at: Equilibrium) -> None:
        """Continue at rest at an equilibrium; raises InputError if it is out of range, or too close to a snap."""
        self.guard.restart(at)
        self._damping, self._goal = 0.0, None

    def _note_target(self, command: Command, dt: float) -> None:
        """Reset the damping if the target jumps."""
        last, self._goal = self._goal, command.position
        moved = np.inf if last is None or self._goal is None else dist(last, self._goal)
        another = moved > 2 * self.options.speed * dt
        self._tracked = 0.0 if another else TRACKED * moved
        if another:
            self._damping, self._damped, self._patience = 0.0, 0, PATIENCE
            self._ordered = False

    def _choose_order(self, rests: bool, no_closer: bool, at_kink: bool) -> None:
        """Keep the order of breakpoints after a step that brings the tip no closer; release it where it is not needed.

        Where breakpoints coincide the distance has kinks: a step across one may not descend although another step on
        this side does. At rest on this side, a step across is tried again.
        """
        if not self._ordered:
            self._ordered, self._progress = no_closer, False
        elif self._progress if rests else not at_kink:
            self._ordered = False
        self._progress |= not rests

    def _box(self, limits: tuple[Array, Array], dt: float) -> tuple[Array, Array]:
        """(m,) smallest and largest joint change in the quadratic program within the `limits` of a cycle.

        A damped step is shortened as a whole once it is known: at its corners a box would turn it. Only a joint that
        moves the other way, and first has to brake, stays.
        """
        most = np.full(len(self.space.scale), SHIFT * self.space.length)
        most[: self.space.robot.n_tubes] = TURN
        if not self._damping:
            return np.maximum(limits[0], -most), np.minimum(limits[1], most)
        brakes = np.where(np.isfinite(self.guard.acceleration), 0.51 * self.guard.acceleration * dt**2, 0.0)
        return np.where(limits[0] < -brakes, -most, 0.0), np.where(limits[1] > brakes, most, 0.0)

    def _take(
        self, step: Array, parts: Sequence[Part], limits: tuple[Array, Array], why: Why, dt: float
    ) -> tuple[Equilibrium, Why]:
        """Equilibrium after the largest part of a step (m,), over the scales, that is safe and reduces the distance.

        The damping is the curvature of half the squared distance along the step, which Gauss-Newton leaves out. Within
        reach it vanishes with the distance; out of reach it lets the steps converge.
        """
        portion, scale, last = 1.0, self.space.scale, self._last
        if self._damping:
            step = self._resting(step)
            portion = min([1.0, *(_fraction(part.max_step, part.rows @ (step * scale)) for part in parts)])
            ends = np.where(step > 0, limits[1], limits[0]) / scale
            portion = min(portion, float(np.divide(ends, step, out=np.ones_like(step), where=step != 0).min()))
            portion = max(portion, 0.0)
        reverses = step * last < 0
        self._stiff = np.where(reverses, np.minimum(4 * self._stiff, MOST_STIFF), np.maximum(1.0, self._stiff / 1.2))
        turned, size = float(step @ last), float(np.abs(step).max())
        fraction = min([1.0, *(_fraction(part.max_step, part.error) for part in parts)])
        far, rated = not self._damping and fraction < 1, Why.RATE in why
        if self._damping:
            back = turned < -0.5 * float(np.linalg.norm(step) * np.linalg.norm(last))
        else:
            self._stiff[:] = 1.0
            back = far and bool(((portion * step * last < -0.5 * last**2) & (np.abs(last) > 10 * DEAD)).any())
        # A velocity has no distance, and that of a pivot has kinks at the points of the shape.
        by_velocity = any(part.name == "velocity" for part in parts)
        with_error = [part for part in parts if part.name != "pivot" and not by_velocity]
        before = sum(float(part.error @ part.error) for part in with_error)
        whole = sum(_square(part.error - part.rows @ (step * scale)) for part in with_error)
        if (self._damping and with_error and before - whole < GAIN * before**0.5) or portion * size < DEAD**2:
            return self.guard.go(0 * step, why & ~Why.RATE, dt)

        trials: list[_Trial] = []
        tracks = before < (self._tracked / self.space.length) ** 2

        def closer(posture: Posture, part_of: float) -> bool:
            made = portion * part_of * step
            model = sum(_square(part.error - part.rows @ (made * scale)) for part in with_error)
            after = sum(_square(self._error(part.name, part.target, posture)) for part in with_error)
            square = float(made @ made)
            seen = square > SEEN**2
            descends = tracks or model >= before or before < DEAD**2 or before - after >= DESCENT * (before - model)
            trials.append(
                _Trial(
                    made=np.where(step == 0, last, made),
                    whole=portion * part_of == 1,
                    descends=descends,
                    grows=not descends or back,
                    slow=far and not rated and before - after < SLOW * fraction * before,
                    curvature=min((after - model) / square, MOST_CURVED) if seen else None,
                )
            )
            return descends

        arm, why = self.guard.go(portion * step * scale, why, dt, closer)
        for trial in trials:
            self._adapt(trial, turns_back=turned < 0)
        if Why.HELD in why:
            self._damping = 0.0  # another direction may pass
        return arm, why

    def _resting(self, step: Array) -> Array:
        """Step (m,), over the scales, that leaves joints at their place which it moves by less than DEAD.

        These do not tremble while others move. The step stays as it is where that would break the order of the tubes,
        as of two that slide together at about DEAD.
        """
        still, rows = np.where(np.abs(step) < DEAD, 0.0, step), self.space.rows * self.space.scale
        moved, after = rows @ step, rows @ still
        bounds = np.minimum(self.guard.posture.step_bounds[2 * len(step) :], 0.0)
        return step if ((after < moved) & (after < bounds)).any() else still

    def _adapt(self, trial: _Trial, *, turns_back: bool) -> None:
        """Change the damping, the ease of the objective and the last step after a trial of a step."""
        curved = 0.0 if trial.curvature is None else trial.curvature
        if trial.grows or trial.slow or (self._damping and curved > self._damping):
            self._damping = max(curved, min(4 * self._damping * trial.grows, MOST_CURVED), DAMPING**2)
        elif self._damping and trial.whole and trial.curvature is not None:
            self._damping = max(curved, self._damping / 2) if self._damping > 2 * DAMPING**2 else 0.0
        if trial.descends and self._damping and not trial.whole:  # far from rest: perhaps it does without again
            self._damped += 1
            if self._damped >= self._patience:
                self._damping, self._damped, self._patience = 0.0, 0, 2 * self._patience
        if trial.descends:
            self._ease = min(1.0, (0.5 if turns_back else 1.2) * self._ease)
            self._last = trial.made

    def _constraints(self, current: Posture, low: Array, high: Array) -> Constraints:
        """Constraints of a step: rates and ranges, order, margin, bodies. Those violated already must not get worse."""
        options, m = self.options, len(current.q)
        bounds = np.minimum(current.step_bounds, 0.0)
        ends = np.maximum(bounds[: 2 * m], np.concatenate([low, -high]))
        bounds[: 2 * m] = np.minimum(ends, 0.0) / self._twice
        rows, more, kinds = [self._sides], [bounds], [(2 * m, Why.ORDER)]
        slope = current.margin_slope() * self.space.scale
        if any(up := slope.tolist()):
            # The most that the margin can rise within rates and ranges: a required rise above it has no solution.
            ends = bounds.tolist()
            rise = RISE * sum(-by * ends[m + k] if by > 0 else by * ends[k] for k, by in enumerate(up))
            kinds.append((len(bounds), Why.MARGIN))
            rows.append(slope[None])
            least = options.min_margin if self.guard.min_distance is None else self.guard.margin_limit
            room = min(ROOM, ROOM_PER_STEP * float(np.linalg.norm(self._last)))
            more.append(np.array([min(APPROACH * (least + room - current.margin), rise)]))
        if self.guard.scene.bodies:
            body_rows, lower = self._body_rows(current, np.maximum(high, -low))
            kinds.append((sum(map(len, more)), Why.OBSTACLE))
            rows.append(body_rows)
            more.append(lower)
        self._first_order = sum(map(len, more))
        if self._ordered:
            row, bound = breakpoint_order(self.space, current).kept(current.q, KEPT)
            kinds.append((self._first_order, Why(0)))
            rows.append(row * self.space.scale)
            more.append(bound)
        return Constraints(np.concatenate(rows), np.concatenate(more), kinds)

    def _why(self, active: Index, current: Posture, low: Array, high: Array, kinds: Sequence[tuple[int, Why]]) -> Why:
        """Reasons (flags of `Why`) for the active rows of the constraints."""
        m, reasons, ends = len(current.q), set[Why](), np.concatenate([low, -high])
        for row in active.tolist():
            if row < 2 * m:
                reasons.add(Why.RANGE if current.step_bounds[row] > ends[row] else Why.RATE)
            else:
                reasons.add(next(kind for first, kind in reversed(kinds) if row >= first))
        return Why(sum(reasons))

    def _by_priority(self, tasks: Sequence[Task], rows: Array, bounds: Array) -> tuple[Array, Index] | None:
        """Step and active rows of tasks by priority, each in the null space of those before it.

        None if no step satisfies the rows.
        """
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
            if self._damping and n == len(self._unit):
                damping = np.diag(np.sqrt(DAMPING**2 + self._damping * self._stiff))
            else:
                damping = np.sqrt(DAMPING**2 + self._damping) * self._unit[:n, :n]
            matrix = np.concatenate([matrix, damping])
            target = np.concatenate([target, np.zeros(n)])
        solved = constrained_least_squares(matrix, target, rows, bounds)
        return None if solved is None else (solved.x, solved.active)

    def _body_rows(self, at: Posture, rate: Array) -> tuple[Array, Array]:
        """Rows (c, m) and bounds (c,) of the constraints on distances from bodies, m, in a step of the joints.

        Distances are included if the step could make them too small. The guard checks the others.
        """
        scene, clearance = self.guard.scene, self.options.clearance
        moved = np.linalg.norm(self.space.by_joints(at.along), axis=1) @ rate
        farthest = BODY_REACH * self.space.length
        reach = clearance + APART + min(float(moved.max()) / APPROACH, farthest)
        self.guard.sight = FARTHER * reach
        contacts = at.surface.contacts(scene, reach)
        if not len(contacts.body):
            return np.zeros((0, len(rate))), np.zeros(0)
        slope = at.contact_slopes(scene, contacts)
        least, most = APPROACH * (clearance + APART - contacts.distance), np.abs(slope) @ rate
        counts = most >= -least
        return slope[counts] * self.space.scale, np.minimum(least, RISE * most)[counts]

    def _task(self, group: Sequence[str], command: Command, at: Posture, dt: float) -> Task | None:
        """Task of a priority; None if the command has none of its parts. An empty priority is the objective."""
        if not group:
            step = self._objective(at, dt)
            return Task(np.eye(len(step)), step, damped=False)
        parts = [self._part(name, target, at, dt) for name in group if (target := getattr(command, name)) is not None]
        if not parts:
            return None
        factors = [1.0 if self._damping else _fraction(part.max_step, part.error) for part in parts]
        targets = [factor * part.error for factor, part in zip(factors, parts, strict=True)]
        matrix = np.concatenate([part.rows * self.space.scale for part in parts])
        return Task(matrix, np.concatenate(targets), True, tuple(parts))

    def _error(self, name: str, target: Any, at: Posture) -> Array:
        """Difference from one part of a command, in units of the robot's length or of the joints' scales."""
        if name == "position":
            return np.asarray((target - at.tip) / self.space.length)
        if name == "direction":
            return np.asarray(target - at.direction)
        if name == "joints":
            return np.asarray((target - at.q) / self.space.scale)
        _, across, away = self._foot(target, at)
        return across @ away

    def _foot(self, pivot: Array, at: Posture) -> tuple[tuple[int, float], Array, Array]:
        """Position of the point of the arm closest to a pivot, and vector (3,) from it to the pivot, m.

        The two directions (2, 3) across the arm are over its length.
        """
        arm = at.equilibrium
        start, chord = arm.position[:-1], np.diff(arm.position, axis=0)
        square = np.maximum((chord**2).sum(1), 1e-300)
        along = np.clip(((pivot - start) * chord).sum(1) / square, 0, 1)
        feet = start + along[:, None] * chord
        k = int(np.argmin(((pivot - feet) ** 2).sum(1)))
        return (k, float(along[k])), arm.frame[k][:, :2].T / self.space.length, pivot - feet[k]

    def _part(self, name: str, target: Any, at: Posture, dt: float) -> Part:
        """One part of a command, with the largest motion of the tip in a cycle."""
        length, speed = self.space.length, self.options.speed * dt / self.space.length
        met = MET / length
        if name == "velocity":
            error = _shortened(self.options.speed, target) * (dt / length)
            return Part(name, target, at.jacobian.tip / length, error, np.inf, np.inf)
        if name == "joints":
            target = at_most(configuration(self.space, "joints", target), "joints")
        error = self._error(name, target, at)
        if name == "position":
            return Part(name, target, at.jacobian.tip / length, error, speed, met)
        if name == "direction":
            # As fast as the tip would turn about a tenth of the robot.
            return Part(
                name, target, np.cross(at.jacobian.rotation, at.direction[:, None], axis=0), error, 10 * speed, MET
            )
        if name == "joints":
            # Straight there, as fast as the slowest joint allows.
            rate = self.guard.rate * dt / self.space.scale
            steps = float((np.abs(error) / np.maximum(rate, 1e-300)).max())
            return Part(
                name, target, self._unit / self.space.scale, error, float(np.linalg.norm(error)) / max(steps, 1.0), MET
            )
        (k, along), across, _ = self._foot(target, at)
        moved = (1 - along) * at.along[k] + along * at.along[k + 1]
        return Part(name, target, self.space.by_joints(across @ moved), error, speed, met)

    def _objective(self, at: Posture, dt: float) -> Array:
        """(m,) joint step, in units of the scales, that best improves the objective; its length is `push` times the
        rates.
        """
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
        if name != "centre":
            longest *= self._ease
        return pull * min(1.0, longest / size) if name == "centre" and size else pull * (longest / max(size, 1e-300))


def _fraction(length: float, vector: Array) -> float:
    """Fraction of a vector, at most 1, that is no longer than a length."""
    return min(length / max(hypot(*vector.tolist()), 1e-300), 1.0)


def _square(vector: Array) -> float:
    return float(vector @ vector)


def _shortened(length: float, vector: Array) -> Array:
    """Vector, shortened to a length if it is longer."""
    return vector * _fraction(length, vector)


def _softness(at: Posture, fraction: float = 1e-4) -> Array:
    """(m,) relative change of the translational compliance of the tip by the joints, by differences.

    0 without a kernel, and where a difference cannot be computed.
    """
    space, current = at.space, _yield(at.equilibrium)
    out = np.zeros(len(at.q))
    for k in range(len(out)) if current is not None else ():
        q = at.q.copy()
        q[k] += fraction * space.scale[k] * (1 if q[k] < space.upper[k] else -1)
        reached = one_step(space.robot, at.equilibrium, *space.split(q))
        found = None if reached is None else _yield(reached)
        if current is not None and found is not None:
            out[k] = (found / current - 1) / (q[k] - at.q[k])
    return out


def _yield(at: Equilibrium) -> float | None:
    """Trace of the translational compliance of the tip, m/N; None without a kernel."""
    slopes = compiled_slopes(at, compliance=True)
    return None if slopes is None or slopes.compliance is None else float(np.trace(slopes.compliance[:3, :3]))
