"""The arrow of the force on the tip, and the marks at its head by which it is dragged."""

from __future__ import annotations

from functools import cached_property
from typing import Any, Protocol

import numpy as np

from ...equilibrium.result import Equilibrium
from ...robots.robot import Robot
from .push_panel import PushPanel
from .pushing import head_of, newtons_per_metre
from .scene import SCALE, Scene
from .view import View

HANDLE = 0.2
"""Size of marks that are dragged, over the longest curved part of a tube."""


def handle_size(robot: Robot) -> float:
    """Of marks that are dragged, m."""
    return HANDLE * max(tube.curved_length for tube in robot.tubes)


class Push(Protocol):
    """Lets a force act, N, with gravity, m/s^2."""

    def __call__(self, force: np.ndarray, gravity: tuple[float, float, float] | None, *, done: bool) -> None: ...


class ForceArrow:
    """Shows the force on the tip of a robot, and tells `push` where it is dragged; nothing without `controls`."""

    def __init__(self, scene: Scene, controls: PushPanel | None, view: View, push: Push) -> None:
        self._scene, self._controls, self._view, self._push = scene, controls, view, push
        self._head: Any = None
        self._tip = np.zeros(3)

    def mark(self, equilibrium: Equilibrium, on: bool) -> None:
        """Put marks at the head of the arrow, or take them away."""
        if self._head is not None:
            self._head.remove()
            self._head = None
        if on and self._controls is not None:
            place, size = head_of(equilibrium, self._newtons_per_metre), handle_size(equilibrium.robot)
            self._head = self._scene.handle("head", place, size, self._drawn)

    def show(self, equilibrium: Equilibrium, *, held: bool) -> None:
        """Draw the force that acts; the marks go to its head, unless the hand has them."""
        self._tip = equilibrium.tip_position
        if equilibrium.load is None and self._head is None:
            self._scene.show_force(self._tip, self._tip)
            return
        head = head_of(equilibrium, self._newtons_per_metre)
        self._scene.show_force(self._tip, head)
        if self._head is not None and not held:
            self._head.position = tuple(head * SCALE)

    def _drawn(self, head: np.ndarray, done: bool) -> None:
        assert self._controls is not None
        self._push(self._newtons_per_metre * (head - self._tip), self._controls.gravity, done=done)

    @cached_property
    def _newtons_per_metre(self) -> float:
        """By how soft the robot is where the view begins."""
        return newtons_per_metre(self._view.session().equilibrium)
