"""Motion of the tip by keys, a gamepad or a 3-D mouse: messages of the page, and the servo.

Over a socket of the same server, `/hand`, the page sends JSON objects {"tab": ..., "velocity": [x, y, z]}: the token of
a robot, which only its own page has, and the velocity of the tip along the axes of the plate over `SPEED`. A message
moves the tip for the time since the last one, and at most for `MAX_STEP`: without messages, the tip rests.
"""

from __future__ import annotations

import json
import secrets
import time
from collections.abc import AsyncIterable, Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ...bodies.obstacles import Obstacle
from ...control.command import Command, ServoOptions
from ...control.servo import Servo
from ...equilibrium.result import MIN_MARGIN
from ...errors import InputError
from ...files.units import TO_MM
from ...inverse.answer import InverseOptions
from ...inverse.gauss_newton import reach
from ...inverse.goal import Goal, pose_question
from ...inverse.miss import active_constraints
from ...inverse.posture import start_posture
from ...typing import Array
from .session import Session, moved_to

PATH = "/hand"
"""Path of the socket."""

SPEED = 0.03
"""Largest speed of the tip, m/s."""

MAX_STEP = 0.1
"""Largest duration of the motion by one message, s."""

MOVING_MARGIN = 0.01
"""Smallest margin during motions, also if the user requests less."""

KEYS = "J L, K I, O U: along x, y, z; Shift: slower. Or the sticks of a gamepad, or a 3-D mouse."

Drive = Callable[[Array], None]


class Channel:
    """Robots that pages may move: secret tokens, and the functions that move the robots."""

    def __init__(self) -> None:
        self._drives: dict[str, Drive] = {}

    def register(self, drive: Drive) -> str:
        """Token for a robot; `drive` receives velocities (3,) over the largest speed."""
        # 128 random bits: no other page can guess which robot to move.
        token = secrets.token_urlsafe(16)
        self._drives[token] = drive
        return token

    def remove(self, token: str) -> None:
        """Make a token invalid."""
        self._drives.pop(token, None)

    async def receive(self, messages: AsyncIterable[str | bytes]) -> None:
        """Execute the messages of a socket; invalid messages are ignored."""
        async for message in messages:
            try:
                token, velocity = read(message)
            except InputError:
                continue
            if token in self._drives:
                self._drives[token](velocity)


def read(message: str | bytes) -> tuple[str, Array]:
    """Token and velocity (3,) of a message.

    Raises:
        InputError: the message is invalid.
    """
    try:
        data = json.loads(message)
        velocity = np.array(data["velocity"], dtype=float)
        token = data["tab"]
    except (ValueError, KeyError, TypeError):
        raise InputError("the message has no tab and velocity") from None
    if not isinstance(token, str) or velocity.shape != (3,) or not np.isfinite(velocity).all():
        raise InputError("the velocity is not three finite numbers")
    # Two keys at once are no faster than one; slower velocities stay as they are.
    return token, velocity / max(1.0, float(np.linalg.norm(velocity)))


class TipServo:
    """Servo that moves the tip of a session by velocities."""

    def __init__(self) -> None:
        self._servo: Servo | None = None
        self._bodies: tuple[Obstacle, ...] = ()
        self._last = -np.inf

    def move(
        self, session: Session, velocity: Array, min_margin: float, obstacles: tuple[Obstacle, ...] = ()
    ) -> tuple[Session, str]:
        """Session after a velocity command, and the reason if the tip moved less than requested, or "".

        velocity: (3,) velocity of the tip over the largest speed.

        Raises:
            InputError: the robot has a load, or its margin is below the smallest one.
        """
        now = time.monotonic()
        # After a pause the first message would otherwise move the tip for the whole time of rest.
        duration, self._last = min(now - self._last, MAX_STEP), now
        if not velocity.any():
            return session, ""
        if session.equilibrium.load is not None:
            raise InputError("the tip can be moved without load only; remove the load first")
        options = ServoOptions(speed=SPEED, min_margin=max(min_margin, MOVING_MARGIN))
        servo, current = self._servo, session.equilibrium
        # Sliders may have moved the robot since the last message: a servo knows only its own steps.
        if servo is None or servo.equilibrium is not current or (servo.options, self._bodies) != (options, obstacles):
            servo = Servo(session.robot, current, obstacles=obstacles, options=options)
            self._servo, self._bodies = servo, obstacles
        # Two messages may come at once; a step of no duration has no velocity.
        step = servo.step(Command(velocity=SPEED * velocity), max(duration, 1e-3))
        return moved_to(session, step.equilibrium), step.why.text


PART_LENGTH = 0.05
"""Length of the parts of a straight motion of the tip, over the length of the longest tube."""

CLOSE_ENOUGH = 1e-6
"""Largest distance (m) from a reached target."""

# While the user drags the target, each step is soon followed by another one.
QUICK = InverseOptions(steps=20)
"""Options of a step towards the target, with few iterations."""


def drag_tip(
    session: Session, target: ArrayLike, *, min_margin: float = MIN_MARGIN, obstacles: Sequence[Obstacle] = ()
) -> tuple[Session, str]:
    """Session after moving the tip towards `target` (3,), m, by Gauss-Newton steps within all limits.

    Every step is a stable equilibrium on the same branch with a margin of at least `min_margin` (or that of the start):
    the robot does not snap. The motion ends when the tip comes no nearer.

    Returns:
        The session, and the reason why the tip stopped, or "" on target.

    Raises:
        InputError: a target that is not three finite numbers, a margin that is not from 0 to 1; a load.
    """
    if session.equilibrium.load is not None:
        raise InputError("the tip can be moved without load only; remove the load first")
    goal = pose_question(
        session.robot, target, start=session.equilibrium, min_margin=min_margin, obstacles=obstacles, options=QUICK
    )
    current = start_posture(goal.space, session.equilibrium)
    for part in _parts(goal, current.tip):
        result = reach(replace(goal, position=part), current)
        current = result.posture
        session = moved_to(session, current.equilibrium)
        if not result.reached and float(np.linalg.norm(part - current.tip)) > CLOSE_ENOUGH:
            # The straight path is blocked: the last step aims at the target itself, which may still be nearer.
            current = reach(goal, current).posture
            session = moved_to(session, current.equilibrium)
            break
    error = float(np.linalg.norm(goal.position - current.tip))
    if error <= CLOSE_ENOUGH:
        return session, ""
    # Margin and obstacles come first, before joints at their limits.
    active = sorted(active_constraints(goal, current), key=lambda text: not text.startswith(("margin", "arm")))
    reasons = ", ".join(active) or "no joint motion brings the tip closer"
    return session, f"the tip stops {error * TO_MM:.2f} mm short of the target: {reasons}"


def _parts(goal: Goal, tip: Array) -> list[Array]:
    """End points (3,) of the parts of the straight path from the tip to the target, m."""
    path = goal.position - tip
    # Short parts keep the tip near the straight line: Gauss-Newton steps over a long path may go around.
    count = max(1, int(np.ceil(float(np.linalg.norm(path)) / (PART_LENGTH * goal.space.length))))
    return [tip + path * k / count for k in range(1, count + 1)]
