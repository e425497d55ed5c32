"""Heatings in a closed loop, simulated for many rigs at once."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...typing import Array
from .law import HeatingLaw, begin, decide
from .rig import COUNTS
from .sensors import Felt, Sensor
from .thermal import ThermalModel, seen


@dataclass(frozen=True, eq=False)
class Fleet:
    """B rigs as they may be, beside the one of the file.

    model: of all members. bias: (B,) of the sensor, K, where the tube is as hot as it gets.
    """

    model: ThermalModel
    bias: Array


@dataclass(frozen=True, eq=False)
class LoopHistory:
    """What B rigs did in a closed loop, at times (T,), s.

    Attributes:
        time: (T,). reading: (T, B) degC as the law saw them. count: (T, B). place: (T, B) slot of the schedule.
        coldest, hottest: (T, B) of the curved part, degC; top: (T, B) of any point.
        finished: (B,), bool, whether the whole schedule was run through.
    """

    time: Array
    reading: Array
    count: Array
    place: Array
    coldest: Array
    hottest: Array
    top: Array
    finished: NDArray[np.bool_]

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


def run_loop(fleet: Fleet, law: HeatingLaw, sensor: Sensor, *, seed: int = 0, dies: float = math.inf) -> LoopHistory:
    """Run every rig of a fleet under the law until the last has ended.

    Args:
        seed: of the sensor's noise.
        dies: s, time from which the sensor is dead: the firmware then stops, and the count is 0.
    """
    model, rng = fleet.model, np.random.default_rng(seed)
    felt, memory, rows = Felt.at_rest(model, sensor), begin(model.members), []
    ends, dead = (law.reference.min(), law.reference.max()), np.zeros(model.members, dtype=bool)
    slots = math.ceil(law.longest / law.slot)
    for k in range(slots + 1):
        reading = sensor.shown(felt.lagged, fleet.bias, ends, rng)
        dead |= (k * law.slot >= dies) | (reading < sensor.lowest) | (reading > sensor.highest)
        place = memory.place
        count, memory = decide(law, memory, reading)
        count = np.where(dead, 0, count)
        rows.append((reading, count, place, *seen(model, felt.state.cells[:, :, 0])))
        if (memory.place > len(law.planned)).all() or k == slots:
            break
        felt = felt.after(model, sensor, count / COUNTS, law.slot)
    names = ("reading", "count", "place", "coldest", "hottest", "top")
    columns = {name: np.array(column) for name, column in zip(names, zip(*rows, strict=True), strict=True)}
    finished = (memory.place >= len(law.planned)) & ~dead
    return LoopHistory(np.asarray(law.slot * np.arange(len(rows))), finished=finished, **columns)
