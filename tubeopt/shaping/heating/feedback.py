"""A heating that a sensor leads, and how likely uncertain rigs keep the window: what is told of it."""

from __future__ import annotations

from dataclasses import dataclass

import scipy

from ...display import Displayed
from ...typing import Array
from .law import HeatingLaw
from .loop import LoopHistory
from .sensors import Sensor
from .uncertainty import Uncertainty


@dataclass(frozen=True)
class Contribution:
    """How much one thing that is not known moves the temperature of the hold: its name, and a standard deviation, K."""

    name: str
    deviation: float


@dataclass(frozen=True, eq=False)
class Feedback(Displayed):
    """A heating in a closed loop, and what becomes of it on rigs that are not quite the one that it was planned for.

    Attributes:
        sensor, law: what reads, and what answers.
        uncertainty: of the rigs. history: of the rig itself (first) and of S others.
        lowest, highest: (S,) of the curved part in the hold, degC; top: (S,) of any point ever, degC.
        kept: (S,) whether the window was kept through a whole hold, and the limit always.
        open_loop: share of rigs that keep it with the schedule alone.
        contributions: of what is not known, largest first; "sensor" is its bias.
        window: degC. limit: degC.
    """

    sensor: Sensor
    law: HeatingLaw
    uncertainty: Uncertainty
    history: LoopHistory
    lowest: Array
    highest: Array
    top: Array
    kept: Array
    open_loop: float
    contributions: tuple[Contribution, ...]
    window: tuple[float, float]
    limit: float

    @property
    def samples(self) -> int:
        """S."""
        return len(self.kept)

    @property
    def probability(self) -> float:
        """Share of the rigs that keep the window."""
        return float(self.kept.mean())

    @property
    def interval(self) -> tuple[float, float]:
        """Of the probability, 95 % (Wilson's)."""
        return wilson(int(self.kept.sum()), self.samples)

    @property
    def too_cold(self) -> float:
        """Share that falls below the window, or never holds it."""
        return float((self.lowest < self.window[0]).mean())

    @property
    def too_hot(self) -> float:
        """Share that rises above the window's end in the hold, or above the limit at any time."""
        return float(((self.highest > self.window[1]) | (self.top > self.limit)).mean())


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """95 % interval of a probability (E. B. Wilson, J. Am. Stat. Assoc. 22 (1927))."""
    found = scipy.stats.binomtest(successes, trials).proportion_ci(0.95, method="wilson")
    return float(found.low), float(found.high)
