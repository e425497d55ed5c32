"""What there is to show: a robot, where it begins, and what stands around it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ...bodies.obstacles import Obstacle
from ...robots.robot import Robot
from ...typing import Array
from .playback import Waypoints
from .session import Session, open_session


@dataclass(frozen=True, eq=False)
class View:
    """What to show.

    Args:
        robot: in every tab, from `rotations`, `translations` (n,) rad and m; by default from home.
        obstacles: drawn, and kept away from when the tip is dragged.
        waypoints: of a trajectory to be played, or None.
        min_margin: to keep when the tip is dragged; the slider's first value.
        out: directory into which exports are saved besides being sent to the browser.
    """

    robot: Robot
    rotations: Array | None = None
    translations: Array | None = None
    obstacles: tuple[Obstacle, ...] = ()
    waypoints: Waypoints | None = None
    min_margin: float = 0.05
    out: Path | None = None

    def session(self) -> Session:
        """A new session; raises InputError and SolveError as `open_session` does."""
        return open_session(self.robot, self.rotations, self.translations)
