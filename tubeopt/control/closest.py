"""The closest pose to a target, for a servo that by itself rests at a local minimum of the distance.

While the robot rests, a second servo, the scout, goes from there straight to joint values spread over the ranges, as
far as the guard lets it, and descends to the target. The robot then follows the path of the scout that came closest.
This is repeated until no scout comes closer, or until the robot rests where it did before: it returns from a pose
closer to the floor of the margin. The scout takes few steps in each step of the robot, so their time is
bounded.
The C library has the same search (`control/c/seek.c`).
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import replace
from math import dist
from typing import Protocol

import numpy as np

from ..equilibrium.result import Equilibrium
from ..errors import InputError
from ..inverse.goal import angle
from ..inverse.joints import JointSpace
from ..solvers.settings import LARGEST_SHIFT, LARGEST_TURN
from ..typing import Array
from .command import Command, ServoOptions, ServoStep, Why

# Starts of a scout: out of reach most descents end at one of few minima.
TRIALS = 48

# Part of a cycle, s, for one step of the scout, which takes 0.5 ms: most searches then take less than 2 s.
SCOUT_TIME = 0.65e-3

# Searches for one target at most; each but the last has found a closer pose.
ROUNDS = 4

# Largest numbers of steps: of a scout to its start (half a turn takes 11, the length of the longest tube 20), and of a
# descent.
OUTWARD, DESCENT_STEPS = 20, 300

# Steps without motion after which a servo rests: the order of breakpoints is kept and released meanwhile.
STILL = 6

# Number of steps between two checks of a descent. Between them it must cover this fraction of the distance that still
# separates it from a closer pose, or it ends: it leads to another minimum.
COMPARED_EVERY, PROMISING = 4, 0.15

# Motion over the joints' scales between stored places of a path, their largest number, and motion of a robot at rest.
SPACED, MOST_PLACES, UNMOVED = 0.1, 64, 1e-9

# Decrease of the distance over the robot's length that counts as closer.
MUCH_CLOSER = 2e-5

# Margin by which a scout stays farther above the floor: the robot cuts the corners of its path.
PATH_ROOM = 2e-3


class Stage(enum.Enum):
    """Phase of the search."""

    TOWARDS = "the robot moves to its target"
    OUT = "the scout goes to its start"
    DOWN = "the scout descends to the target"
    STRAIGHT = "the scout tries the straight path to its last pose"
    ALONG = "the robot follows the best path of a scout"


class Mover(Protocol):
    """Servo that is a scout, or is led by one."""

    @property
    def equilibrium(self) -> Equilibrium: ...

    @property
    def stop(self) -> Array:
        """(m,) joint values of the stop point."""

    def step(self, command: Command, dt: float) -> ServoStep[Equilibrium]: ...

    def restart(self, at: Equilibrium) -> None: ...


class ClosestSearch:
    """Search of the closest pose for one servo.

    Args:
        servo: moves the robot.   space, options: its joints and options.
        scout_of: a second servo at an equilibrium, with options; raises InputError where it cannot start.
    """

    def __init__(
        self,
        servo: Mover,
        space: JointSpace,
        options: ServoOptions,
        scout_of: Callable[[Equilibrium, ServoOptions], Mover],
    ) -> None:
        self._servo, self._space, self._options, self._scout_of = servo, space, options, scout_of
        self._starts = space.sample(TRIALS)
        self.reset()

    def reset(self) -> None:
        """Forget target and paths."""
        self._command: Command | None = None
        self._stage = Stage.TOWARDS
        self._round = self._trial = self._steps = self._still = 0
        self._best = self._before = self._rested = np.inf
        self._rest = self._servo.equilibrium
        self._path: list[Array] = []
        """Places (m,) of the scout."""
        self._best_path: list[Array] = []
        self._start: Array = self._starts[0]
        self._scout: Mover | None = None

    def step(self, command: Command, dt: float) -> ServoStep[Equilibrium]:
        """One step of the robot towards its target, or of the search and on the path that it has found."""
        assert command.position is not None
        if not _same(self._command, command):
            self.reset()
            self._command = command
        before = self._servo.equilibrium
        step = self._servo.step(self._led(command), dt)
        if self._stage is not Stage.TOWARDS:
            turned = np.nan if command.direction is None else angle(command.direction, before.tip_rotation[:, 2])
            step = replace(step, distance=dist(command.position, before.tip_position), angle=turned)
        rests = self._moved(self._joints(before), self._joints(step.equilibrium)) < UNMOVED
        blocked = bool(step.why & (Why.NO_CLOSER | Why.HELD))
        if self._stage in (Stage.TOWARDS, Stage.ALONG):
            self._still = self._still + 1 if rests and blocked else 0
        if self._stage is Stage.ALONG:
            if self._moved(self._servo.stop, self._best_path[0]) < UNMOVED:
                self._best_path.pop(0)
            if not self._best_path or self._still == STILL:
                self._stage, self._still = Stage.TOWARDS, 0
        elif self._stage is not Stage.TOWARDS:
            for _ in range(max(1, int(dt / SCOUT_TIME))):
                if self._stage in (Stage.OUT, Stage.DOWN, Stage.STRAIGHT):
                    self._seek(command)
        elif self._still == STILL and self._round < ROUNDS:
            self._begin(command)
        return step if self._stage is Stage.TOWARDS else replace(step, why=step.why | Why.SEEKING)

    def _led(self, command: Command) -> Command:
        """Command of the robot in this stage."""
        if self._stage is Stage.TOWARDS:
            return replace(command, closest=False)
        if self._stage is Stage.ALONG:
            return Command(joints=self._space.split(self._best_path[0]))
        return Command()

    def _begin(self, command: Command) -> None:
        """Start a search from the place of rest, or end it where the last one began there."""
        rest, last = self._servo.equilibrium, self._rest
        miss = self._miss(command, rest)
        near = self._moved(self._joints(rest), self._joints(last)) < SPACED
        if self._round and near and miss > self._rested - MUCH_CLOSER:
            self._round = ROUNDS
            return
        self._rest, self._trial, self._best_path = rest, 0, []
        self._best = self._rested = miss
        o = self._options
        options = replace(
            o,
            speed=self._space.length / 8,
            turn_rate=LARGEST_TURN,
            shift_rate=LARGEST_SHIFT * self._space.length,
            turn_acceleration=None,
            shift_acceleration=None,
            objective=None,
            min_margin=min(o.min_margin + PATH_ROOM, self._rest.margin),
        )
        try:
            self._scout = self._scout_of(self._rest, options)
        except InputError:  # the robot rests where it may not begin
            self._round = ROUNDS
            return
        self._send()

    def _send(self) -> None:
        """Send the next scout; after the last one the robot follows the best path."""
        if self._trial == len(self._starts):
            self._stage = Stage.ALONG if self._best_path else Stage.TOWARDS
            self._round = self._round + 1 if self._best_path else ROUNDS
            self._still = 0
            return
        # At the end of a range the nearest turn may be outside: then the start is a whole turn away.
        start = self._space.wrap(self._starts[self._trial], self._joints(self._rest))
        self._start = self._space.clip(start)
        self._trial += 1
        self._recall(Stage.OUT)

    def _recall(self, stage: Stage) -> None:
        """Bring the scout to the place of rest."""
        assert self._scout is not None
        self._scout.restart(self._rest)
        self._stage, self._steps, self._still = stage, 0, 0

    def _seek(self, command: Command) -> None:
        """One step of the scout."""
        scout = self._scout
        assert scout is not None
        goal = {Stage.OUT: self._start, Stage.STRAIGHT: self._path[-1] if self._path else None}.get(self._stage)
        before = scout.stop
        sent = replace(command, closest=False) if goal is None else Command(joints=self._space.split(goal))
        why = scout.step(sent, 1.0).why
        self._steps += 1
        there = goal is not None and self._moved(scout.stop, goal) < UNMOVED
        ended = there or self._steps >= OUTWARD or Why.HELD in why
        if self._stage is Stage.STRAIGHT:
            if ended:  # the shortest path, where it leads to the same pose
                same = there and abs(self._miss(command, scout.equilibrium) - self._best) < MUCH_CLOSER
                self._best_path = [self._path[-1]] if same else self._path
                self._send()
        elif self._stage is Stage.OUT:
            if ended:
                self._path, self._stage, self._steps, self._still = [scout.stop], Stage.DOWN, 0, 0
                self._before = np.inf
        else:
            self._still = self._still + 1 if self._moved(before, scout.stop) < UNMOVED else 0
            if self._moved(self._path[-1], scout.stop) > SPACED:
                self._path.append(scout.stop)
            if len(self._path) == MOST_PLACES or self._is_hopeless(command, scout):
                self._send()
            elif self._still == STILL or self._steps == DESCENT_STEPS:
                self._compare(command, scout)

    def _is_hopeless(self, command: Command, scout: Mover) -> bool:
        """True if a descent slows down far from a closer pose."""
        if self._steps % COMPARED_EVERY:
            return False
        miss, before = self._miss(command, scout.equilibrium), self._before
        self._before = miss
        return before - miss < PROMISING * (miss - self._best + MUCH_CLOSER)

    def _compare(self, command: Command, scout: Mover) -> None:
        """Keep the path of a scout that came closer."""
        miss = self._miss(command, scout.equilibrium)
        if miss > self._best - MUCH_CLOSER:
            self._send()
            return
        self._best = miss
        self._path.append(scout.stop)
        self._recall(Stage.STRAIGHT)

    def _joints(self, arm: Equilibrium) -> Array:
        return self._space.join(arm.rotations, arm.translations)

    def _moved(self, a: Array, b: Array) -> float:
        """Largest motion of a joint over its scale."""
        return float(np.abs((b - a) / self._space.scale).max())

    def _miss(self, command: Command, arm: Equilibrium) -> float:
        """Distance over the robot's length, and difference of the directions, as one length."""
        assert command.position is not None
        away = dist(command.position, arm.tip_position) / self._space.length
        turned = 0.0 if command.direction is None else np.linalg.norm(command.direction - arm.tip_rotation[:, 2])
        return float(np.hypot(away, turned))


def _same(last: Command | None, command: Command) -> bool:
    """True for commands of one target."""
    if last is None:
        return False
    pairs = ((getattr(last, name), getattr(command, name)) for name in ("position", "direction", "pivot"))
    return all(a is b or (a is not None and b is not None and np.array_equal(a, b)) for a, b in pairs)
