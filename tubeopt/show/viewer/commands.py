"""What the hand may want of a tab: the panel passes it on and does not know who does it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from ...bodies.frames import Plane
from .session import Session

Verb = Callable[[Session], Session | tuple[Session, str]]
"""Changes a session; it may also tell in words what stopped it."""


class Wishes(Protocol):
    """Every method returns at once."""

    def change(self, verb: Verb, *, held: int | str | None = None, key: str | None = None, pause: bool = True) -> None:
        """Do something to the robot.

        Args:
            held: the joint, or by a name the other thing, that the hand has and does not let go of.
            key: what waits under the same key is not done any more; by default a name that is held.
            pause: whether a trajectory that is being played pauses for it.
        """

    def undo(self) -> None:
        """Take the last change back: joint values, branch and tubes."""

    def lead(self, target: np.ndarray, *, done: bool) -> None:
        """Lead the tip towards a target, m; `done` puts the target's mark back onto the tip."""

    def ghosts(self) -> None:
        """Show all other equilibria, or hide them."""

    def show(self, layer: str, on: bool) -> None:
        """Show or hide a layer: trail, workspace, obstacles, swept, target, hand, force, map, beside."""

    def cut(self, plane: Plane | None) -> None:
        """Show bodies up to a plane, with what it cuts; None: all of them."""

    def load(self, what: str, name: str, content: bytes) -> None:
        """Take a file: a trajectory, bodies to keep clear of, the robot beside."""

    def play(self) -> None:
        """Play, or pause."""

    def replay(self) -> None:
        """Play what was recorded."""

    def look(self, side: str) -> None:
        """Look from a side: side, front, above, corner."""

    def scrub(self, seconds: float) -> None:
        """Go to a time of the trajectory."""

    def save(self, what: str) -> None:
        """Send an export to the browser: joints, robot, recording, picture, page."""
