"""What there is to show: a robot, where it begins, and what stands around it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ...bodies.obstacles import Obstacle
from ...errors import InputError
from ...robots.load import Load
from ...robots.robot import Robot
from ...typing import Array
from .external_load import push_on
from .playback import Waypoints
from .session import Session, open_session


@dataclass(frozen=True, eq=False)
class View:
    """What every tab begins with."""

    robot: Robot
    rotations: Array | None = None
    """(n,) rad; None: as at home."""
    translations: Array | None = None
    """(n,) m; None: home."""
    obstacles: tuple[Obstacle, ...] = ()
    """Drawn, and kept away from when the tip is led."""
    waypoints: Waypoints | None = None
    """Of a trajectory to be played."""
    min_margin: float = 0.05
    """To keep when the tip is led; the slider's first value."""
    load: Load | None = None
    """A force on the tip and gravity that act from the beginning."""
    out: Path | None = None
    """Directory into which exports are saved besides being sent to the browser."""

    def session(self) -> Session:
        """A new session; raises InputError and SolveError as `open_session` and `push_on` do."""
        begun = open_session(self.robot, self.rotations, self.translations)
        if self.load is None:
            return begun
        if self.load != Load(self.load.force, gravity=self.load.gravity):
            raise InputError("load is more than a force on the tip and gravity, which is what can be shown and dragged")
        return push_on(begun, self.load)
