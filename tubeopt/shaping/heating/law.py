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

from dataclasses import dataclass, replace

import numpy as np

from ...typing import Array
from .rig import COUNTS


@dataclass(frozen=True, eq=False)
class HeatingLaw:
    """A schedule and how it is corrected.

    Attributes:
        slot: s, for which a count is kept.
        planned: (T,) mean counts of the planned schedule in every slot, 0 to 255. reference: (T,) degC that the sensor
            should read as the slot begins. hold: first slot of the hold, and the slot before which it ends.
        proportional: 1/K. integral: 1/(K s).
        share: greatest correction, as a fraction of what was planned. holdback: K. patience: s that it waits in all.
        lost: counts that every pulse loses to the loop's inductance, given on top of what is wanted.
    """

    slot: float
    planned: Array
    reference: Array
    hold: tuple[int, int]
    proportional: float
    integral: float
    share: float = 0.5
    holdback: float = 15.0
    patience: float = 60.0
    lost: float = 0.0

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
    waits = (error > law.holdback) & (place <= law.hold[0])
    total = np.clip(state.total + law.integral * law.slot * error, -law.share, law.share)
    share = np.clip(law.proportional * error + total, -law.share, law.share)
    planned = law.planned[place]
    led = np.isfinite(lead) & (planned > 0)
    said = np.clip(np.where(led, lead, 0.0) / np.where(led, planned, 1.0) - 1, -law.share, law.share)
    total = np.where(led, np.clip(said - law.proportional * error, -law.share, law.share), total)
    share = np.where(led, said, share)
    wanted = np.where(running, planned * (1 + share), 0.0)
    due = wanted + state.owed
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
