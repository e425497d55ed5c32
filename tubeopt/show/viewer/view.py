"""What there is to show: a robot, where it begins, and what stands around it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ...bodies.obstacles import Obstacle
from ...errors import InputError
from ...robots.load import Load
from ...robots.robot import Robot
from ...typing import Array
from .playback import Waypoints
from .pushing import push_on
from .session import Session, open_session


@dataclass(frozen=True, eq=False)
class View:
    """What to show.

    Args:
        robot: in every tab, from `rotations`, `translations` (n,) rad and m; by default from home.
        obstacles: drawn, and kept away from when the tip is dragged.
        waypoints: of a trajectory to be played, or None.
        min_margin: to keep when the tip is dragged; the slider's first value.
        load: a force on the tip and gravity that act from the beginning, or None.
        out: directory into which exports are saved besides being sent to the browser.
    """

    robot: Robot
    rotations: Array | None = None
    translations: Array | None = None
    obstacles: tuple[Obstacle, ...] = ()
    waypoints: Waypoints | None = None
    min_margin: float = 0.05
    load: Load | None = None
    out: Path | None = None

    def session(self) -> Session:
        """A new session; raises InputError and SolveError as `open_session` and `push_on` do."""
        begun = open_session(self.robot, self.rotations, self.translations)
        if self.load is None:
            return begun
        if self.load != Load(self.load.force, gravity=self.load.gravity):
            raise InputError("load is more than a force on the tip and gravity, which is what can be shown and dragged")
        return push_on(begun, self.load)
