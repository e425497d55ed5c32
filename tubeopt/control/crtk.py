"""A robot with the commands of CRTK: effects of messages and of time steps.

Names, states and meanings are those of the Collaborative Robotics Toolkit (Su et al., IEEE ISMR 2020): servo commands
are a stream and act at once; a move stays busy until it has arrived. The server and the node of ROS 2 read COMMANDS, so
both have the same commands. Times are those of a monotonic clock that is given. It is asked before a step and again
once the step is there: what a process that was put aside in between would send too late is never sent, and no joint
moves farther than its rate allows in the time that has passed since the last step was there.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from ..arguments import typed
from ..errors import InputError, SolveError, finite, nearest, vector
from ..files.units import TO_MM
from ..inverse.joints import configuration
from ..typing import Array
from .c_binding import CServo
from .command import Command, Why, at_most
from .servo import Servo

# Distance (m) and angle (rad) at which a move ends: far below the accuracy of drives.
ARRIVED = 1e-6

# A move that comes no closer than by CLOSER (m or rad), or half of what is left where that is less, for so long (s)
# ends.
STUCK, CLOSER = 0.5, 1e-4

# Margin above its lower bound below which a snap is reported as near: the margin falls steeply towards a snap.
WARNING = 0.1

# Largest snap distance that is reported, rad: further proofs take longer.
FAR_FROM_SNAP = 0.5

# Share of the time which the quicker of the last two steps took that the next one is sure to take as well. What is
# missing to the truth a joint does not move, so that steps need not be taken back.
SURE = 0.8

# Tolerance (m and rad) on the limits of a target.
ROUND_OFF = 1e-9

# Text of the event when the watchdog stops a stream.
LATE = "no command arrived in time; the robot stops"

# Keys of each kind of motion: p position, v velocity, r relative to now; c of the tip, j of the joints.
KINDS = {
    "cp": ("position", "direction"),
    "cr": ("translation", "turn"),
    "cv": ("linear", "angular"),
    "jp": ("rotations", "translations"),
    "jr": ("rotations", "translations"),
    "jv": ("rotations", "translations"),
}

# Every command, and its keys besides "op".
COMMANDS: dict[str, tuple[str, ...]] = {
    **{f"servo_{kind}": keys for kind, keys in KINDS.items()},
    **{f"move_{kind}": keys for kind, keys in KINDS.items() if kind[1] != "v"},
    **{f"{kind}_cp": (*KINDS["cp"], "closest") for kind in ("servo", "move")},
    "set_js": KINDS["jp"],
    "hold": (),
    "free": (),
    "state_command": ("command",),
}

# State commands that change `homed`, and its value after them. Joint values of drives that are not homed mean nothing,
# so that only a homed robot moves.
HOMING = {"home": True, "unhome": False}

# State after a state command in a state, as the table of CRTK; pairs that are missing are rejected.
TRANSITIONS = {
    ("enable", "DISABLED"): "ENABLED",
    ("enable", "ENABLED"): "ENABLED",
    ("enable", "FAULT"): "ENABLED",
    **{("disable", state): "DISABLED" for state in ("DISABLED", "ENABLED", "PAUSED", "FAULT")},
    ("pause", "ENABLED"): "PAUSED",
    ("pause", "PAUSED"): "PAUSED",
    ("resume", "PAUSED"): "ENABLED",
}

STATE_COMMANDS = tuple(dict.fromkeys([command for command, _ in TRANSITIONS] + list(HOMING)))

# Events that are kept until they are published: more at once say nothing new.
MOST_EVENTS = 16


AnyServo = Servo | CServo
"""A servo, in Python or in C."""


@dataclass
class _Goal:
    """Current command: its start, whether it is a stream, and its smallest distance with the time of it."""

    command: Command
    since: float
    stream: bool
    rates: Array | None = None
    """(2n,) velocities of the joints, rad/s and m/s, in place of the command."""
    angular: Array | None = None
    """(3,) angular velocity of the tip direction in addition to the command, rad/s."""
    closest: float = math.inf
    closer: float = 0.0

    def stale(self, now: float, watchdog: float) -> bool:
        """True for a stream without recent messages; clock jumps have no influence."""
        return self.stream and not 0 <= now - self.since <= watchdog


@typed
class CrtkRobot:
    """One robot, its state and its command.

    Args:
        servo: moves the robot.   watchdog: s after which a stream without a new command is held.
    """

    def __init__(self, servo: AnyServo, *, watchdog: float = 0.1) -> None:
        if not finite("watchdog", watchdog) > 0:
            raise InputError(f"watchdog is {watchdog:g} s; it must be more than 0")
        self.servo, self.watchdog = servo, watchdog
        self.state, self.homed = "DISABLED", True
        self._goal: _Goal | None = None
        self._why = Why(0)
        self._message = ""
        self._before = servo.equilibrium
        self._moved, self._took = 0.0, (0.0, 0.0)
        self.sent: float | None = None
        """Time of the last step on the clock; None before the first."""
        self.events: deque[tuple[str, str]] = deque(maxlen=MOST_EVENTS)
        """Events that are not published yet: kind (error, warning or status) and text."""
        self._unreported = False  # a move that no report has called busy yet

    @property
    def busy(self) -> bool:
        """True while a `move_...` command is running."""
        return self._goal is not None and not self._goal.stream

    def command(self, message: Mapping[str, Any], now: float) -> None:
        """Execute a message {"op": name, ...}: start a motion, stop, or change the state.

        Raises:
            InputError: a command that is invalid, or not allowed in this state; nothing changes.
        """
        name = message.get("op")
        if not (isinstance(name, str) and name in COMMANDS):
            raise InputError(f"op is {name!r}; it must be one of {', '.join(COMMANDS)}")
        _check_keys(name, message)
        if name == "state_command":
            self._change(message.get("command"))
        elif name == "hold":
            self.hold("stopped by command")
        elif name == "set_js":
            self._resume(self._joints(message))
        elif name == "free":
            self.hold("free by command: send the state command home before the next motion")
            self.homed = False
        else:
            goal = self._goal_of(name, message, now)
            if self.state != "ENABLED":
                raise InputError(f"{name} is rejected: the robot is {self.state}; enable it first")
            if not self.homed:
                raise InputError(f"{name} is rejected: the robot is not homed; send the state command home first")
            self._goal, self._unreported = goal, not goal.stream

    def _goal_of(self, name: str, message: Mapping[str, Any], now: float) -> _Goal:
        """The goal of a motion command."""
        kind, rates, angular = name[-2:], None, None
        if kind == "jv":
            desired, rates = Command(), self._rates(message)
        elif kind == "cv":
            desired, angular = Command(velocity=_numbers(message, "linear", "m/s")), _turn(message, "angular", "rad/s")
        else:
            read = {"cp": self._pose, "cr": self._pose_from_here, "jp": self._joints, "jr": self._joints_from_here}
            desired = read[kind](message)
        return _Goal(desired, now, name.startswith("servo"), rates, angular, closer=now)

    def release(self) -> None:
        """Stop and keep the position after the commander has disconnected."""
        self._goal = None

    def hold(self, message: str) -> None:
        """Stop and keep the position, and report the reason."""
        self._goal, self._why, self._message = None, Why(0), message

    def fault(self, message: str) -> None:
        """Stop after an internal error; only the commands enable and disable end this state."""
        if (self.state, self._message) != ("FAULT", message):
            self.events.append(("error", message))
        self.hold(message)
        self.state = "FAULT"

    def tick(self, clock: Callable[[], float], dt: float) -> None:
        """Make one step of at most `dt` seconds, or of the time since the last step if that is less.

        A stream without new commands stops the robot. If its watchdog expires during the step, the step is undone.
        """
        goal = self._goal
        self._before, self._moved = self.servo.equilibrium, dt
        if (goal is None or self.state != "ENABLED") and not self.servo.moving:
            return
        now = clock()
        if goal is not None and goal.stale(now, self.watchdog):
            self._late()
            if not self.servo.moving:
                return
        brakes = self._goal is None or self.state != "ENABLED"
        if goal is None or brakes:
            goal = _Goal(Command(), now, True)
        if self.sent is not None and now < self.sent:  # the clock has gone back
            self.sent = now
        why, limit, begun = None, Why(0), now
        span = min(dt, self._passed(now) + SURE * min(self._took))
        while why is None and span > 0:
            command, limit = self._command_of(goal, span)
            why, now = self.servo.step(command, span).why, clock()
            if goal.stale(now, self.watchdog) and not brakes:
                self._late()
                if not self.servo.limited:  # else it brakes from here
                    self.servo.undo()
                    return
            if span > self._passed(now) * (1 + 1e-12):  # it took less time than steps do
                self.servo.undo()
                why, span = None, self._passed(now)
        if why is None:
            return
        self._took, self._moved = (self._took[1], now - begun), span
        self.sent = now
        if brakes or self._goal is None:
            return
        self._why, self._message = why | limit, (why | limit).text
        if not goal.stream:
            self._arrive(goal, now)

    def _late(self) -> None:
        self.hold(LATE)
        self.events.append(("warning", LATE))

    def _command_of(self, goal: _Goal, span: float) -> tuple[Command, Why]:
        """The command of a step of `span` seconds, and the limit at which it ends early."""
        arm, space = self.servo.equilibrium, self.servo.space
        if goal.angular is not None and goal.angular.any():
            return replace(goal.command, direction=_turned(arm, goal.angular * span)), Why(0)
        if goal.rates is None:
            return goal.command, Why(0)
        n, o = space.robot.n_tubes, self.servo.options
        # With limited accelerations the target is the stop point of the robot, beyond the end of the step.
        most = np.repeat([o.turn_acceleration or np.inf, o.shift_acceleration or np.inf], n)
        change = goal.rates * span + goal.rates * np.abs(goal.rates) / (2 * most)
        current = space.join(arm.rotations, arm.translations)
        free = space.join(arm.rotations + change[:n], arm.translations + change[n:])
        q = space.clip(free)
        limit = Why(0) if np.array_equal(q, free) else Why.RANGE
        if not space.ordered(q):  # all joints stop together: none is pushed by another
            slack, closing = np.maximum(space.rows @ current - space.row_lower, 0.0), space.rows @ (current - q)
            q, limit = current + (q - current) * np.min(slack[closing > 0] / closing[closing > 0]), limit | Why.ORDER
        rotations, shift = space.split(q)
        return Command(joints=(rotations, np.array(shift))), limit

    def _passed(self, now: float) -> float:
        """Time since the last step, s; infinite before the first."""
        return math.inf if self.sent is None else now - self.sent

    def _arrive(self, goal: _Goal, now: float) -> None:
        """End a move that has reached its target or no longer comes closer."""
        angle, shift = self._missing(goal.command)
        left = max(angle, shift)
        # A move to the closest pose ends at rest, after the search.
        seeks = goal.command.closest and (Why.SEEKING in self._why or not self._why & (Why.NO_CLOSER | Why.HELD))
        if seeks or left < goal.closest - min(CLOSER, goal.closest / 2) or goal.closest == math.inf:
            goal.closest, goal.closer = left, now
        if left < ARRIVED:
            self._goal, self._message = None, ""
        elif now - goal.closer > STUCK:
            self._goal = None
            parts = {f"{math.degrees(angle):.3g} deg": angle, f"{shift * TO_MM:.3g} mm": shift}
            far = " and ".join(part for part, missing in parts.items() if missing >= ARRIVED)
            if goal.command.closest:
                self._message = f"the closest pose found is {far} away"
                self.events.append(("status", self._message))
                return
            self._message = f"the move has ended {far} short: {self._message or 'it comes no closer'}"
            self.events.append(("warning", self._message))

    def _missing(self, command: Command) -> tuple[float, float]:
        """Remaining distance of a move to its target, rad and m."""
        arm = self.servo.equilibrium
        if command.joints is not None:
            angle, shift = command.joints
            return float(np.abs(angle - arm.rotations).max()), float(np.abs(shift - arm.translations).max())
        angle = 0.0 if command.direction is None else math.dist(command.direction, arm.tip_rotation[:, 2])
        return angle, 0.0 if command.position is None else math.dist(command.position, arm.tip_position)

    def _change(self, desired: Any) -> None:
        if not (isinstance(desired, str) and desired in STATE_COMMANDS):
            raise InputError(f"command is {desired!r}; it must be one of {', '.join(STATE_COMMANDS)}")
        before = self.state, self.homed
        if desired in HOMING:
            self.homed = HOMING[desired]
        elif (desired, self.state) in TRANSITIONS:
            self.state = TRANSITIONS[desired, self.state]
        else:
            allowed = [command for command, state in TRANSITIONS if state == self.state]
            raise InputError(f"{desired} is rejected: the robot is {self.state}, which allows {', '.join(allowed)}")
        self._goal = None
        if (self.state, self.homed) != before:
            self._why, self._message = Why(0), ""
            self.events.append(("status", f"{self.state}, {'homed' if self.homed else 'not homed'}"))

    def _resume(self, at: Command) -> None:
        """Continue from joint values that the drives have reached without commands.

        Raises:
            InputError: the robot is enabled or brakes, or cannot be there.
        """
        if self.state == "ENABLED" or self.servo.moving:
            raise InputError("set_js is rejected: the robot is ENABLED; disable it first")
        try:
            self.servo.resume(at.joints)
        except SolveError as error:
            raise InputError(f"set_js is rejected: {error}") from None
        self._goal, self._before, self._message = None, self.servo.equilibrium, ""

    def _joints_from_here(self, message: Mapping[str, Any]) -> Command:
        """Command of joint values relative to the current ones."""
        arm, changes = self.servo.equilibrium, self._pairs(message)
        now = {"rotations": arm.rotations, "translations": arm.translations}
        return self._joints({name: (now[name] + changes[name]).tolist() for name in now})

    def _pairs(self, message: Mapping[str, Any]) -> dict[str, Array]:
        """Rotations and translations (n,) of a message."""
        n = self.servo.space.robot.n_tubes
        return {name: vector(name, message.get(name, ()), n) for name in KINDS["jp"]}

    def _rates(self, message: Mapping[str, Any]) -> Array:
        """(2n,) velocities of the joints."""
        arm, rates = self.servo.equilibrium, self._pairs(message)
        rotation_rates, shift = (at_most(rates[name], name) for name in KINDS["jv"])
        self.servo.space.join(arm.rotations + rotation_rates, arm.translations + shift, "the commanded velocities")
        return np.concatenate([rotation_rates, shift])

    def _pose_from_here(self, message: Mapping[str, Any]) -> Command:
        """Command of a pose relative to the current one, along and about the axes of the plate."""
        arm, rotation = self.servo.equilibrium, _turn(message, "turn", "rad")
        position = arm.tip_position + _numbers(message, "translation", "m")
        turned = _turned(arm, rotation).tolist() if rotation is not None and rotation.any() else None
        return self._pose({"position": position.tolist(), "direction": turned})

    def _joints(self, message: Mapping[str, Any]) -> Command:
        n = self.servo.space.robot.n_tubes
        low, high = self.servo.space.ranges
        joints = []
        for name, unit, tubes in (("rotations", "rad", slice(n)), ("translations", "m", slice(n, None))):
            values = vector(name, message.get(name, ()), n, unit)
            for i in np.flatnonzero((values < low[tubes] - ROUND_OFF) | (values > high[tubes] + ROUND_OFF))[:1]:
                raise InputError(
                    f"{name} of tube {i + 1} is {values[i]:g} {unit}; it must lie between {low[tubes][i]:g} and "
                    f"{high[tubes][i]:g} {unit}"
                )
            joints.append(values)
        q = configuration(
            self.servo.space, "joints", (joints[0], joints[1])
        )  # raises InputError for what no joint gives
        if violation := self.servo.space.outside(q):
            raise InputError(f"the commanded joint values are out of range: {violation}")
        return Command(joints=(joints[0], joints[1]))

    def _pose(self, message: Mapping[str, Any]) -> Command:
        position, pointing = _numbers(message, "position", "m"), message.get("direction")
        direction = None if pointing is None else _numbers(message, "direction", "")
        command = Command(position=position, direction=direction, closest=message.get("closest", False))
        far, longest = math.hypot(*position), self.servo.space.longest
        if far > longest + ROUND_OFF:
            raise InputError(
                f"position is {far:g} m from the plate; it must be at most {longest:g} m, the length of the longest arm"
            )
        return command

    def report(self, now: float) -> dict[str, Any]:
        """State for observers: plain data in SI units under the names of CRTK, with margin and warning."""
        arm, before = self.servo.equilibrium, self._before
        n, floor = self.servo.space.robot.n_tubes, self.servo.options.min_margin
        joints = np.concatenate([arm.rotations, arm.translations])
        last = np.concatenate([before.rotations, before.translations])
        names = [f"{kind}_{i + 1}" for kind in ("rotation", "translation") for i in range(n)]
        pose = {"position": arm.tip_position.tolist(), "rotation": arm.tip_rotation.tolist()}
        speed = (joints - last) / self._moved if self._moved else 0 * joints
        state = {"name": names, "position": joints.tolist(), "velocity": speed.tolist()}
        goal = None if self._goal is None else self._goal.command.joints
        goal_joints = joints if goal is None else np.concatenate(goal)
        busy, self._unreported = self.busy or self._unreported, False  # clients wait for a move to become busy
        return {
            "op": "state",
            "time": now,
            "setpoint_time": self.sent,
            "operating_state": {"state": self.state, "is_homed": self.homed, "is_busy": busy},
            # Without a sensor the measured values are the setpoints.
            "setpoint_js": state,
            "measured_js": state,
            # The joint values of a tip motion are known only at its end.
            "goal_js": {"name": names, "position": goal_joints.tolist(), "velocity": [0.0] * (2 * n)},
            "setpoint_cp": pose,
            "measured_cp": pose,
            "measured_cv": self._velocity(),
            "margin": arm.margin,
            "snap_warning": bool(arm.margin < floor + WARNING or Why.HELD in self._why),
            "why": self._message,
            "shape": np.round(arm.position, 7).tolist(),
        }

    def snap_distance(self) -> float | None:
        """Proved snap distance at the present pose, rad, at most FAR_FROM_SNAP; None if unknown."""
        distance = self.servo.snap_distance(FAR_FROM_SNAP)
        return None if distance is None else min(distance, FAR_FROM_SNAP)

    def _velocity(self) -> dict[str, Any]:
        """Velocity of the tip in the last step, m/s and rad/s, in the plate frame."""
        arm, before = self.servo.equilibrium, self._before
        if not self._moved:
            return {"linear": [0.0] * 3, "angular": [0.0] * 3}
        rotation = scipy.spatial.transform.Rotation.from_matrix(arm.tip_rotation @ before.tip_rotation.T).as_rotvec()
        linear = (arm.tip_position - before.tip_position) / self._moved
        return {"linear": linear.tolist(), "angular": (rotation / self._moved).tolist()}


def _check_keys(name: str, message: Mapping[str, Any]) -> None:
    """Raise InputError if a message has keys that its "op" does not define."""
    for key in message:
        if key != "op" and key not in COMMANDS[name]:
            allowed = " and ".join(COMMANDS[name])
            raise InputError(
                f"{key!r} is not a key of {name}; allowed keys are {allowed}{nearest(str(key), COMMANDS[name])}"
            )


def _turned(arm: Any, rotation: Array) -> Array:
    """(3,) direction of the tip after a turn (3,), rad, about axes of the plate."""
    return np.asarray(scipy.spatial.transform.Rotation.from_rotvec(rotation).apply(arm.tip_rotation[:, 2]))


def _turn(message: Mapping[str, Any], name: str, unit: str) -> Array | None:
    """(3,) rotation vector in a message, rad; None if the direction is free."""
    return None if message.get(name) is None else at_most(_numbers(message, name, unit), name)


def _numbers(message: Mapping[str, Any], name: str, unit: str) -> Array:
    return vector(name, message.get(name, ()), 3, f"x, y, z{f' in {unit}' if unit else ''}")
