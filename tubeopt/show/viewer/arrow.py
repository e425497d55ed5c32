"""The arrow of the force on the tip, and the marks at its head by which it is dragged."""

from __future__ import annotations

from functools import cached_property
from typing import Protocol

import numpy as np

from ...equilibrium.result import Equilibrium
from .mark import Mark
from .push_panel import PushPanel
from .pushing import head_of, newtons_per_metre
from .scene import Scene
from .view import View


class Push(Protocol):
    """Lets a force act, N, with gravity, m/s^2."""

    def __call__(self, force: np.ndarray, gravity: tuple[float, float, float] | None, *, done: bool) -> None: ...


class ForceArrow:
    """Shows the force on the tip of a robot, and tells `push` where it is dragged; nothing without `controls`."""

    def __init__(self, scene: Scene, controls: PushPanel | None, view: View, push: Push) -> None:
        self._scene, self._controls, self._view, self._push = scene, controls, view, push
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
        self._push(self._newtons_per_metre * (head - self._tip), self._controls.gravity, done=done)

    @cached_property
    def _newtons_per_metre(self) -> float:
        """By how soft the robot is where the view begins."""
        return newtons_per_metre(self._view.session().equilibrium)
