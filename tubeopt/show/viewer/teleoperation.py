"""The tip led by keys, a gamepad or a 3-D mouse: what the page says, and the servo that does it.

Over a socket of the same server, `/hand`, the page sends JSON objects {"tab": ..., "velocity": [x, y, z]}: which robot
is meant, by a word that its own page alone was told, and the velocity of the tip along the axes of the plate as a share
of `SPEED`. A message moves the tip for the time since the last one, and for no longer than `LONGEST`: who falls silent
stands still.
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
from ...errors import InputError
from ...files.units import TO_MM
from ...inverse.answer import InverseOptions
from ...inverse.gauss_newton import reach
from ...inverse.goal import Goal, pose_question
from ...inverse.miss import active_constraints
from ...inverse.posture import Posture, start_posture
from ...typing import Array
from .session import Session, moved_to

PATH = "/hand"
"""Path of the socket."""

SPEED = 0.03
"""Greatest speed of the tip, m/s."""

LONGEST = 0.1
"""s that one message moves the tip."""

LEAST_MARGIN = 0.01
"""Floor of the margin where less is asked for."""

KEYS = "J L, K I, O U: along x, y, z; Shift: slower. Or the sticks of a gamepad, or a 3-D mouse."

Drive = Callable[[Array], None]


class Hands:
    """Robots that pages may move: secret tokens, and the functions that move the robots."""

    def __init__(self) -> None:
        self._led: dict[str, Drive] = {}

    def admit(self, drive: Drive) -> str:
        """Token for a robot; `drive` receives velocities (3,) over the largest speed."""
        # 128 random bits: no other page can guess which robot to move.
        word = secrets.token_urlsafe(16)
        self._led[word] = drive
        return word

    def dismiss(self, word: str) -> None:
        """The word means nothing any more."""
        self._led.pop(word, None)

    async def attend(self, messages: AsyncIterable[str | bytes]) -> None:
        """Do what the messages of a socket say; those that make no sense are left out."""
        async for message in messages:
            try:
                word, velocity = read(message)
            except InputError:
                continue
            if word in self._led:
                self._led[word](velocity)


def read(message: str | bytes) -> tuple[str, Array]:
    """The word and the velocity (3,) of a message.

    Raises:
        InputError: it is something else.
    """
    try:
        said = json.loads(message)
        velocity = np.array(said["velocity"], dtype=float)
        word = said["tab"]
    except (ValueError, KeyError, TypeError):
        raise InputError("the message has no tab and velocity") from None
    if not isinstance(word, str) or velocity.shape != (3,) or not np.isfinite(velocity).all():
        raise InputError("the velocity is not three finite numbers")
    # Two keys at once are no faster than one; slower velocities stay as they are.
    return word, velocity / max(1.0, float(np.linalg.norm(velocity)))


class Hand:
    """Leads the robot of a session by a servo of its own."""

    def __init__(self) -> None:
        self._servo: Servo | None = None
        self._bodies: tuple[Obstacle, ...] = ()
        self._last = -np.inf

    def lead(
        self, session: Session, velocity: Array, min_margin: float, obstacles: tuple[Obstacle, ...] = ()
    ) -> tuple[Session, str]:
        """The session after a message with a velocity (3,), a share of the greatest; and what is in the way, in words.

        Raises:
            InputError: the robot bears a load, or is closer to a snap than the margin to keep.
        """
        now = time.monotonic()
        # After a pause the first message would otherwise move the tip by the whole time of rest.
        passed, self._last = min(now - self._last, LONGEST), now
        if not velocity.any():
            return session, ""
        if session.equilibrium.load is not None:
            raise InputError("the tip can be moved without load only; remove the load first")
        options = ServoOptions(speed=SPEED, min_margin=max(min_margin, LEAST_MARGIN))
        known = self._servo
        current = session.equilibrium
        # The robot may have been moved by sliders meanwhile: a servo knows only what it did itself.
        if known is None or known.equilibrium is not current or (known.options, self._bodies) != (options, obstacles):
            known = Servo(session.robot, current, obstacles=obstacles, options=options)
            self._servo, self._bodies = known, obstacles
        # Two messages may come at once; a step of no duration has no velocity.
        step = known.step(Command(velocity=SPEED * velocity), max(passed, 1e-3))
        return moved_to(session, step.equilibrium), step.why.words


LONGEST_PULL = 0.05
"""The tip is led along a straight line in parts of this share of the longest tube."""

CLOSE_ENOUGH = 1e-6
"""Distance (m) at which a target counts as reached."""

QUICK = InverseOptions(steps=20)
"""A step towards the target follows the hand, and there will be another one."""


def pull(
    session: Session, target: ArrayLike, *, min_margin: float = 0.05, obstacles: Sequence[Obstacle] = ()
) -> tuple[Session, str]:
    """The session after moving the tip towards `target` (3,), m, on its branch, by Gauss-Newton steps within all
    limits.

    Every step is a stable equilibrium on the same branch with a margin of at least `min_margin` (or that of the start):
    the robot does not snap. The motion ends when the tip comes no nearer.

    Returns:
        The session, and the reason why the tip stopped, "" on target.

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
            # From the current tip straight at the target, which may lie around the corner.
            current = reach(goal, current).posture
            session = moved_to(session, current.equilibrium)
            break
    error = float(np.linalg.norm(goal.position - current.tip))
    if error <= CLOSE_ENOUGH:
        return session, ""
    return session, f"the tip stops {error * TO_MM:.2f} mm short of the target: {', '.join(_held(goal, current))}"


def _parts(goal: Goal, tip: Array) -> list[Array]:
    path = goal.position - tip
    # Short parts keep the tip near the straight line: Gauss-Newton steps over a long path may go around.
    count = max(1, int(np.ceil(float(np.linalg.norm(path)) / (LONGEST_PULL * goal.space.length))))
    return [tip + path * k / count for k in range(1, count + 1)]


def _held(goal: Goal, current: Posture) -> list[str]:
    """Constraints that stop the tip, without joints near their limits: margin and obstacles come first."""
    words = active_constraints(goal, current)
    # False sorts before True: margin and arm come first.
    return sorted(words, key=lambda word: not word.startswith(("margin", "arm"))) or ["no joint leads nearer to it"]
