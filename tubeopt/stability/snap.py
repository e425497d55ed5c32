"""A snap: the equilibrium that vanishes, and the one in which the robot lands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..display import Displayed
from ..equilibrium.result import Equilibrium, Statistics
from ..typing import Array, Of, Sentence


class SnapStatus(Sentence):
    """How a snap ends; it reads as a sentence. One that does not land is no Snap, but raises SolveError."""

    LANDED = "the equilibrium was lost, and the robot landed in another one"


@dataclass(frozen=True, eq=False)
class Snap(Displayed):
    """One snap."""

    _brief = ("fraction", "rotations", "translations", "tip_jump", "energy_released")

    index: int
    """Of the waypoint before it."""
    fraction: float
    """Of the way to the next waypoint."""
    before: Equilibrium
    """That vanishes (margin 0), at the joint values of the snap."""
    after: Equilibrium
    """In which the robot lands."""

    rotations, translations = Of[Array]("before"), Of[Array]("before")

    @property
    def energy_released(self) -> float:
        """J."""
        return self.before.potential - self.after.potential

    @property
    def tip_jump(self) -> float:
        """m."""
        return float(np.linalg.norm(self.after.tip_position - self.before.tip_position))

    @property
    def value(self) -> float:
        """The fraction of the way."""
        return self.fraction

    @property
    def status(self) -> SnapStatus:
        """How it ends."""
        return SnapStatus.LANDED

    @property
    def statistics(self) -> Statistics:
        """What the equilibrium that vanishes took."""
        return self.before.statistics
