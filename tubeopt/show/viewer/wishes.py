"""What the hand may want of a tab: the panel passes it on and does not know who does it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from ...bodies.plane import Plane
from .designs import Knob

MIRROR = -1
"""Stands for the joint that is dragged where it is the direction or the separation."""


class Wishes(Protocol):
    """Every method returns at once."""

    def slide(self, joint: int, value: float) -> None:
        """Move one joint to a value (rad or m)."""

    def go_to(self, rotations: Sequence[float], translations: Sequence[float]) -> None:
        """Move to joint values, rad and m."""

    def mirror(self, direction: float, separation: float) -> None:
        """Turn an eccentric robot's three tubes by the mirror law, rad."""

    def home(self) -> None:
        """Go home."""

    def undo(self) -> None:
        """Take the last change back: joint values, branch and tubes."""

    def lead(self, target: np.ndarray, margin: float, *, done: bool) -> None:
        """Lead the tip towards a target, m; `done` puts the target's mark back onto the tip."""

    def drive(self, velocity: np.ndarray) -> None:
        """Move the tip with a velocity (3,), a share of the greatest, for as long as messages keep coming."""

    def push(self, force: np.ndarray, gravity: tuple[float, float, float] | None, *, done: bool) -> None:
        """Let a force act on the tip, N, and gravity, m/s^2; `done` puts the arrow's mark back onto its head."""

    def turn(self, knob: Knob, value: float) -> None:
        """Change a dimension of a tube, in the knob's unit."""

    def reset_design(self) -> None:
        """The robot as it was loaded."""

    def ghosts(self) -> None:
        """Show all other equilibria, or hide them."""

    def show(self, layer: str, on: bool) -> None:
        """Show or hide a layer: trail, workspace, obstacles, swept, target, hand, force, map, beside."""

    def cut(self, plane: Plane | None) -> None:
        """Show bodies up to a plane, with what it cuts; None: all of them."""

    def forget_trail(self) -> None:
        """Begin the trail anew."""

    def record(self, on: bool) -> None:
        """Record from here, or forget what was recorded."""

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
