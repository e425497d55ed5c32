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
from collections.abc import AsyncIterable, Callable

import numpy as np

from ...bodies.obstacles import Obstacle
from ...control.command import Command, ServoOptions
from ...control.servo import Servo
from ...errors import InputError
from ...typing import Array
from .session import Session, moved_to

PATH = "/hand"
"""Of the socket."""

SPEED = 0.03
"""Greatest speed of the tip, m/s."""

LONGEST = 0.1
"""s that one message moves the tip."""

LEAST_MARGIN = 0.01
"""Floor of the margin where less is asked for."""

KEYS = "J L, K I, O U: along x, y, z; Shift: slower. Or the sticks of a gamepad, or a 3-D mouse."

Drive = Callable[[Array], None]


class Hands:
    """Who may be led: words that pages were told, and what leads their robots."""

    def __init__(self) -> None:
        self._led: dict[str, Drive] = {}

    def admit(self, drive: Drive) -> str:
        """A word for a robot, which `drive` is told velocities (3,) of, as shares of the greatest speed."""
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
        passed, self._last = min(now - self._last, LONGEST), now
        if not velocity.any():
            return session, ""
        if session.equilibrium.load is not None:
            raise InputError("the tip can be moved without load only; remove the load first")
        options = ServoOptions(speed=SPEED, min_margin=max(min_margin, LEAST_MARGIN))
        known = self._servo
        here = session.equilibrium
        if known is None or known.equilibrium is not here or (known.options, self._bodies) != (options, obstacles):
            known = Servo(session.robot, here, obstacles=obstacles, options=options)
            self._servo, self._bodies = known, obstacles
        step = known.step(Command(velocity=SPEED * velocity), max(passed, 1e-3))
        return moved_to(session, step.equilibrium), step.why.words
