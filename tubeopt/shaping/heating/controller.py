"""The law that leads a heating by what a sensor reads: the planned schedule, corrected by a share that the error sets.

In every slot, with e = reference - reading:

    share = proportional e + s,   s' = integral e,   duty = planned duty (1 + share)

The share is bounded, and the sum s rests where it is: nothing winds up. Losses, battery and resistance change the power
that is needed by a factor, so a share is what corrects them, in the ramp as in the hold. While the reading is more than
`holdback` below its reference the schedule waits, so that the hold begins when the tube is warm; where it waits too
long, the law stops. Whole counts come from error diffusion: what rounding leaves out is given in the next slot.

It is what the firmware computes, number by number.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import scipy
from numpy.typing import NDArray

from ...display import Displayed
from ...files.field_metadata import form, unit
from ...typing import Array
from .rig import COUNTS
from .sensors import Felt, Sensor
from .thermal import ThermalModel, seen
from .uncertainty import Uncertainty


@dataclass(frozen=True, eq=False)
class HeatingLaw:
    """A schedule and how it is corrected."""

    slot: float
    """For which a count is kept, s."""
    planned: Array
    """(T,) mean counts of the planned schedule in every slot, 0 to 255."""
    reference: Array
    """(T,) that the sensor should read as the slot begins, degC."""
    hold: tuple[int, int]
    """First slot of the hold, and the slot before which it ends."""
    proportional: float
    """1/K."""
    integral: float
    """1/(K s)."""
    share: float = 0.5
    """Greatest correction, as a fraction of what was planned."""
    holdback: float = 15.0
    """By which the reading may be below its reference without a wait, K."""
    patience: float = 60.0
    """That it waits in all, s."""
    lost: float = 0.0
    """Counts that every pulse loses to the loop's inductance, given on top of what is wanted."""

    @property
    def longest(self) -> float:
        """Time after which it has ended in any case, s."""
        return self.slot * len(self.planned) + self.patience


@dataclass(frozen=True, eq=False)
class LawState:
    """What the law remembers between slots, for B rigs at once: (B,) each.

    place: slot of the schedule. total: s, the integral share. owed: counts that rounding left out. waited: s.
    """

    place: Array
    total: Array
    owed: Array
    waited: Array


def begin(members: int) -> LawState:
    """Before the first slot."""
    return LawState(np.zeros(members, dtype=np.int64), *(np.zeros(members) for _ in range(3)))


def decide(law: HeatingLaw, state: LawState, reading: Array, lead: Array | float = np.nan) -> tuple[Array, LawState]:
    """Whole counts (B,) for the slot that begins, from the readings (B,), degC; and what is remembered.

    After the schedule's end, and where it waited longer than its patience, the count is 0.

    Args:
        lead: mean counts of effect that somebody else wants of this slot, (B,) or one; NaN where nobody does. They are
            given as far as the share allows, and the sum becomes the one with which the law would have said the same,
            so that it goes on from there.
    """
    place = np.minimum(state.place, len(law.planned) - 1)
    running = (state.place < len(law.planned)) & (state.waited <= law.patience)
    error = law.reference[place] - reading
    # A tube that is behind waits before the hold: within it the time must count.
    waits = (error > law.holdback) & (place <= law.hold[0])
    # Both the integral and the sum are limited: after a long error it does not overshoot (windup).
    total = np.clip(state.total + law.integral * law.slot * error, -law.share, law.share)
    share = np.clip(law.proportional * error + total, -law.share, law.share)
    planned = law.planned[place]
    led = np.isfinite(lead) & (planned > 0)
    said = np.clip(np.where(led, lead, 0.0) / np.where(led, planned, 1.0) - 1, -law.share, law.share)
    # The integral that would have given this share: no jump when the lead ends.
    total = np.where(led, np.clip(said - law.proportional * error, -law.share, law.share), total)
    share = np.where(led, said, share)
    wanted = np.where(running, planned * (1 + share), 0.0)
    due = wanted + state.owed
    # Half a count rounds to one; what a pulse loses while the current rises is added first.
    count = np.where(due > 0.5, np.clip(np.floor(due + law.lost + 0.5), 0, COUNTS), 0.0)
    given = np.maximum(count - law.lost, 0.0)
    return count.astype(np.int64), LawState(
        place=np.where(waits, state.place, state.place + 1),
        total=np.where(running, total, 0.0),
        owed=np.where(wanted > 0, np.clip(due - given, -1.0 - law.lost, 1.0), 0.0),
        waited=state.waited + np.where(waits, law.slot, 0.0),
    )


def shifted(law: HeatingLaw, by: float) -> HeatingLaw:
    """The law with its reference moved by `by`, K, where the tube is hot: in proportion to the rise."""
    rise = law.reference - law.reference.min()
    return replace(law, reference=law.reference + by * rise / rise.max())


# --- heatings under it ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class LoopHistory:
    """What B rigs did in a closed loop."""

    time: Array
    """(T,) s."""
    reading: Array
    """(T, B) as the law saw them, degC."""
    count: Array
    """(T, B)."""
    place: Array
    """(T, B) slot of the schedule."""
    coldest: Array
    """(T, B) of the curved part, degC."""
    hottest: Array
    """(T, B) of the curved part, degC."""
    top: Array
    """(T, B) of any point, degC."""
    finished: NDArray[np.bool_]
    """(B,) whether the whole schedule was run through."""

    def in_hold(self, law: HeatingLaw) -> Array:
        """(T, B) whether a time lies in the hold, its end included."""
        first, last = law.hold
        return np.asarray((self.place >= first) & (self.place <= last))

    def extremes(self, law: HeatingLaw) -> tuple[Array, Array]:
        """(B,) coldest and hottest of the curved part in the hold, degC; infinite where there was none."""
        inside = self.in_hold(law)
        low = np.where(inside, self.coldest, math.inf).min(0)
        high = np.where(inside, self.hottest, -math.inf).max(0)
        return np.where(np.isfinite(low), low, -math.inf), np.where(np.isfinite(high), high, math.inf)


def run_loop(
    model: ThermalModel,
    law: HeatingLaw,
    sensor: Sensor,
    *,
    bias: Array | float = 0.0,
    seed: int = 0,
    dies: float = math.inf,
) -> LoopHistory:
    """Run every member of a model under the law until the last has ended.

    Args:
        bias: (B,) or one, of the sensor, K, where the tube is as hot as it gets.
        seed: of the sensor's noise.
        dies: s, time from which the sensor is dead: the firmware then stops, and the count is 0.
    """
    rng = np.random.default_rng(seed)
    felt, memory, rows = Felt.at_rest(model, sensor), begin(model.members), []
    ends, dead = (law.reference.min(), law.reference.max()), np.zeros(model.members, dtype=bool)
    slots = math.ceil(law.longest / law.slot)
    for k in range(slots + 1):
        reading = sensor.shown(felt.lagged, bias, ends, rng)
        dead |= (k * law.slot >= dies) | (reading < sensor.lowest) | (reading > sensor.highest)
        place = memory.place
        count, memory = decide(law, memory, reading)
        count = np.where(dead, 0, count)
        rows.append((reading, count, place, *seen(model, felt.state.cells[:, :, 0])))
        if (memory.place > len(law.planned)).all() or k == slots:
            break
        felt = felt.after(model, sensor, count / COUNTS, law.slot)
    finished = (memory.place >= len(law.planned)) & ~dead
    time = np.asarray(law.slot * np.arange(len(rows)))
    reading, count, place, coldest, hottest, top = (np.array(column) for column in zip(*rows, strict=True))
    return LoopHistory(time, reading, count, place, coldest, hottest, top, finished)


@dataclass(frozen=True)
class Contribution:
    """How much one thing that is not known moves the temperature of the hold: its name, and a standard deviation, K."""

    name: Annotated[str, "uncertain parameter"]
    deviation: Annotated[
        float,
        unit("K"),
        form(".2f", label="moves the hold by >"),
        "standard deviation of the hold temperature by this parameter",
    ]


@dataclass(frozen=True, eq=False)
class Feedback(Displayed):
    """A heating in a closed loop, and what becomes of it on S rigs that are not quite the one it was planned for."""

    sensor: Sensor
    """Sensor of the control loop."""
    law: HeatingLaw
    """Control law."""
    uncertainty: Uncertainty
    """Uncertainty of rig and tube."""
    history: LoopHistory
    """Simulated control loops: the nominal rig first, then the sampled ones."""
    lowest: Array
    """(S,) of the curved part in the hold, degC."""
    highest: Array
    """(S,) of the curved part in the hold, degC."""
    top: Array
    """(S,) of any point ever, degC."""
    kept: NDArray[np.bool_]
    """(S,) whether the window was kept through a whole hold, and the limit always."""
    open_loop: Annotated[float, "the same fraction with the schedule alone, without sensor"]
    contributions: Annotated[tuple[Contribution, ...], "effects on the hold temperature, largest first"]
    """ "sensor" is its bias."""
    window: tuple[float, float]
    """Smallest and largest allowed temperature, degC."""
    limit: float
    """Largest allowed temperature of any point, degC."""

    @property
    def samples(self) -> int:
        """Number of sampled rigs S."""
        return len(self.kept)

    @property
    def probability(self) -> float:
        """Share of the rigs that keep the window."""
        return float(self.kept.mean())

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval of the probability (Wilson)."""
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
