"""A snap: the equilibrium that vanishes, and the one in which the robot lands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..display import Displayed
from ..equilibrium.result import Equilibrium, Statistics
from ..typing import Array, Sentence


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
    rotations: Array
    """(n,) at the fold, rad."""
    translations: Array
    """(n,) m."""
    before: Equilibrium
    """The equilibrium that vanishes there (margin 0)."""
    after: Equilibrium
    """Where the robot lands."""
    energy_released: float
    """J."""
    tip_jump: float
    """m."""

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


def snap_between(index: int, fraction: float, before: Equilibrium, after: Equilibrium) -> Snap:
    """A snap from one equilibrium to another."""
    return Snap(
        index=index,
        fraction=fraction,
        rotations=before.rotations,
        translations=before.translations,
        before=before,
        after=after,
        energy_released=before.potential - after.potential,
        tip_jump=float(np.linalg.norm(after.tip_position - before.tip_position)),
    )
