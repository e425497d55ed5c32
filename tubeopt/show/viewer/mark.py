"""A mark in the scene that the hand drags, and the arrow of the force on the tip with marks at its head."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from ...equilibrium.result import Equilibrium
from ...robots.robot import Robot
from .push_panel import PushPanel
from .pushing import head_of, newtons_per_metre
from .scene import SCALE, Scene
from .view import View
from .wishes import Wishes

SIZE = 0.2
"""Of a mark, over the longest curved part of a tube."""


class Mark:
    """A mark that may be put somewhere; `dragged` is told where the hand has it, m, and whether it was let go."""

    def __init__(self, scene: Scene, name: str, dragged: Callable[[np.ndarray, bool], None]) -> None:
        self._scene, self._name, self._dragged = scene, name, dragged
        self._handle: Any = None

    @property
    def there(self) -> bool:
        """Whether it is in the scene."""
        return self._handle is not None

    def put(self, place: np.ndarray, robot: Robot, on: bool) -> None:
        """Put it at a place, m, as large as suits the robot, or take it away."""
        if self._handle is not None:
            self._handle.remove()
            self._handle = None
        if on:
            size = SIZE * max(tube.curved_length for tube in robot.tubes)
            self._handle = self._scene.handle(self._name, place, size, self._dragged)

    def follow(self, place: np.ndarray) -> None:
        """Move it to a place, m, where it is in the scene."""
        if self._handle is not None:
            self._handle.position = tuple(place * SCALE)


class ForceArrow:
    """Shows the force on the tip of a robot, and tells the tab where it is dragged; nothing without `controls`."""

    def __init__(self, scene: Scene, controls: PushPanel | None, view: View, tab: Wishes) -> None:
        self._scene, self._controls, self._view, self._tab = scene, controls, view, tab
        self._head = Mark(scene, "head", self._drawn)
        self._tip = np.zeros(3)

    def mark(self, equilibrium: Equilibrium, on: bool) -> None:
        """Put marks at the head of the arrow, or take them away."""
        if self._controls is not None:
            self._head.put(head_of(equilibrium, self._newtons_per_metre), equilibrium.robot, on)

    def show(self, equilibrium: Equilibrium, *, held: bool) -> None:
        """Draw the force that acts; the marks go to its head, unless the hand has them."""
        self._tip = equilibrium.tip_position
        if equilibrium.load is None and not self._head.there:
            self._scene.show_force(self._tip, self._tip)
            return
        head = head_of(equilibrium, self._newtons_per_metre)
        self._scene.show_force(self._tip, head)
        if not held:
            self._head.follow(head)

    def _drawn(self, head: np.ndarray, done: bool) -> None:
        assert self._controls is not None
        self._tab.push(self._newtons_per_metre * (head - self._tip), self._controls.gravity, done=done)

    @cached_property
    def _newtons_per_metre(self) -> float:
        """By how soft the robot is where the view begins."""
        return newtons_per_metre(self._view.session().equilibrium)
