"""A mark in the scene that the hand drags."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...robots.robot import Robot
from .scene import SCALE, Scene

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
