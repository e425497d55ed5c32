"""PI feedback with feedforward from a temperature sensor.

The planned schedule is corrected by a fraction. In every slot, with e = reference - reading:

    fraction = proportional e + s,   s' = integral e,   duty = planned duty (1 + fraction)

The fraction is bounded, and so is s: there is no windup. Losses, battery and resistance change the required power by a
factor, so a fraction corrects them, in the ramp as in the hold. The bound is what the ensemble of rigs requires: a
thermometer that reads too little gets no more power than that. A mold that draws more heat than planned gets more
power, and the bare tube beside the clamps, which no thermometer sees, gets hotter: no correction raises the count above
`bare_count`. While the reading is more than `holdback` below its
reference the schedule waits, and in the hold while it is below `floor`: only time in the window counts. If it waits too
long, the heating stops: "behind schedule" before the hold, "too cold" in it.
Whole counts come from error diffusion: the remainder of rounding is added in the next slot.

The firmware computes the same, number by number.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from ...display import Displayed
from ...files.field_metadata import form, unit
from ...typing import Array
from .rig import COUNTS
from .sensors import MeasuredRig, Sensor
from .thermal import ThermalModel, TubeExtremes, tube_extremes
from .uncertainty import Uncertainty

# Leads and planned counts are hundredths: at 0.5 they meet ties, which single precision of the boards rounds otherwise.
HALF = 0.5 + 2**-8
"""Part of a count that is not rounded up."""

MOST_EXCESS = 10.0
"""Excess of the tube over the limit, K, that must stop the firmware whatever the bias of its sensor."""

ENOUGH = 0.95
"""Fraction of uncertain rigs that must keep the window with a sensor."""

MOST_COUNT = 249
"""Largest count of a controlled heating: in every period a pause remains, in which the cut-out is retriggered."""


@dataclass(frozen=True, eq=False)
class HeatingLaw:
    """Control law: planned schedule, reference and gains."""

    slot: float
    """Duration of a slot, with one count, s."""
    planned: Array
    """(T,) mean counts of the planned schedule in every slot, 0 to 255."""
    reference: Array
    """(T,) planned reading of the sensor at the start of each slot, degC."""
    hold: tuple[int, int]
    """First slot of the hold, and the first slot after it."""
    proportional: float
    """Proportional gain, 1/K."""
    integral: float
    """Integral gain, 1/(K s)."""
    share: float = 0.5
    """Largest correction, as a fraction of the planned count."""
    bare_count: float = math.inf
    """Largest effective count by a correction, at which the bare tube beside the clamps keeps its limit."""
    holdback: float = 15.0
    """Largest error below the reference without waiting, before the hold, K."""
    floor: float = -math.inf
    """Smallest reading in the hold without waiting, degC."""
    ceiling: float = math.inf
    """Reading that stops the heating, degC."""
    patience: float = 60.0
    """Longest total time of waiting, s."""
    lost: float = 0.0
    """Counts that inductance takes from every pulse; they are added to the effective count."""

    def largest(self, planned: Array) -> Array:
        """Largest corrections at planned counts, as fractions of them."""
        # A correction beyond the largest count would only wind up, and heat too much later.
        most = min(self.bare_count, MOST_COUNT - self.lost)
        allowed = most / np.where(planned > 0, planned, math.inf) - 1
        return np.where(planned > 0, np.clip(allowed, 0.0, self.share), self.share)

    @property
    def longest(self) -> float:
        """Longest time of a heating, s."""
        return self.slot * len(self.planned) + self.patience


@dataclass(frozen=True, eq=False)
class LawState:
    """State of the control law between slots, for B rigs."""

    index: Array
    """(B,) slot of the schedule."""
    total: Array
    """(B,) integral part of the correction."""
    owed: Array
    """(B,) counts that rounding left out."""
    waited: Array
    """(B,) time of waiting up to now, s."""

    @classmethod
    def start(cls, members: int) -> LawState:
        """State before the first slot."""
        return cls(np.zeros(members, dtype=np.int64), *(np.zeros(members) for _ in range(3)))


def decide(
    law: HeatingLaw, state: LawState, reading: Array, override: Array | float = np.nan
) -> tuple[Array, LawState]:
    """PWM counts (B,) of the next slot from the readings (B,), degC, and the next state of the law.

    After the end of the schedule, and after waiting longer than its patience, the count is 0.

    Args:
        override: external effective mean count of this slot, (B,) or one; NaN for none. It has
            the limits of the law. The integral of the law follows it, so that the law continues with the same count.
    """
    index = np.minimum(state.index, len(law.planned) - 1)
    running = (state.index < len(law.planned)) & (state.waited <= law.patience)
    error = law.reference[index] - reading
    waits = waiting(law, index, reading)
    # Both the integral and the sum are limited: after a long error it does not overshoot (windup).
    planned = law.planned[index]
    most = law.largest(planned)
    total = np.clip(state.total + law.integral * law.slot * error, -law.share, most)
    correction = np.clip(law.proportional * error + total, -law.share, most)
    overridden = np.isfinite(override) & (planned > 0)
    external = np.where(overridden, override, 0.0) / np.where(overridden, planned, 1.0) - 1
    external = np.clip(external, -law.share, most)
    # The integral that would have given this correction: no jump when the override ends.
    total = np.where(overridden, np.clip(external - law.proportional * error, -law.share, most), total)
    correction = np.where(overridden, external, correction)
    effective = np.where(running, planned * np.maximum(1 + correction, 0.0), 0.0)
    due = effective + state.owed
    # The part of a pulse that inductance takes is added first.
    count = np.where(due > HALF, np.clip(np.floor(due + law.lost + 1 - HALF), 0, MOST_COUNT), 0.0)
    realised = np.maximum(count - law.lost, 0.0)
    return count.astype(np.int64), LawState(
        index=np.where(waits, state.index, state.index + 1),
        total=np.where(running, total, 0.0),
        owed=np.where(effective > 0, np.clip(due - realised, -1.0 - law.lost, 1.0), 0.0),
        waited=state.waited + np.where(waits, law.slot, 0.0),
    )


def waiting(law: HeatingLaw, index: Array, reading: Array) -> NDArray[np.bool_]:
    """True if the schedule waits at slots `index` because of these readings, degC."""
    index = np.minimum(index, len(law.planned) - 1)
    behind = (law.reference[index] - reading > law.holdback) & (index <= law.hold[0])
    return np.asarray(behind | ((reading < law.floor) & (index >= law.hold[0])))


def shifted(law: HeatingLaw, shift: float) -> HeatingLaw:
    """Law with its reference shifted where the tube is hot, K: in proportion to the rise."""
    rise = law.reference - law.reference.min()
    return replace(law, reference=law.reference + shift * rise / rise.max())


# --- simulated control loops ------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class LoopHistory:
    """Simulated control loops of B rigs."""

    time: Array
    """(T,) start of every slot, s."""
    reading: Array
    """(T, B) readings of the sensors, degC."""
    count: Array
    """(T, B) counts of the slots, 0 to 255."""
    index: Array
    """(T, B) slot of the schedule."""
    coldest: Array
    """(T, B) coldest point of the curved part, degC."""
    hottest: Array
    """(T, B) hottest point of the curved part, degC."""
    top: Array
    """(T, B) hottest point of the tube, degC."""
    total: Array
    """(T, B) integral part of the correction."""
    finished: NDArray[np.bool_]
    """(B,) True for rigs that completed the schedule."""

    def in_hold(self, law: HeatingLaw) -> Array:
        """(T, B) True for times in the hold, its end included, while the schedule does not wait."""
        first, last = law.hold
        return np.asarray((self.index >= first) & (self.index <= last) & ~waiting(law, self.index, self.reading))

    def extremes(self, law: HeatingLaw) -> tuple[Array, Array]:
        """(B,) lowest and highest temperature of the curved part in the hold, degC; infinite without a hold."""
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
    """Simulate the control loop of every member until the last has ended.

    Args:
        bias: of the sensor where the tube is hottest, (B,) or one, K.
        seed: of the sensor's noise.
        dies: time from which the sensor is broken, s: the firmware then stops, and the count is 0.
    """
    rng = np.random.default_rng(seed)
    rig, state = MeasuredRig.at_rest(model, sensor), LawState.start(model.members)
    readings, counts, indices, totals, extremes = [], [], [], [], []
    ends, broken = (law.reference.min(), law.reference.max()), np.zeros(model.members, dtype=bool)
    slots = math.ceil(law.longest / law.slot)
    for k in range(slots + 1):
        reading = sensor.shown(rig.lagged, bias, ends, rng)
        broken |= (k * law.slot >= dies) | (reading < sensor.lowest) | (reading > min(sensor.highest, law.ceiling))
        indices.append(state.index)
        count, state = decide(law, state, reading)
        count = np.where(broken, 0, count)
        readings.append(reading)
        counts.append(count)
        totals.append(state.total)
        extremes.append(tube_extremes(model, rig.state.cells[:, :, 0]))
        if (state.index > len(law.planned)).all() or k == slots:
            break
        rig = rig.after(model, sensor, count / COUNTS, law.slot)
    temperatures = TubeExtremes(*(np.array(column) for column in zip(*extremes, strict=True)))
    return LoopHistory(
        time=np.asarray(law.slot * np.arange(len(readings))),
        reading=np.array(readings),
        count=np.array(counts),
        index=np.array(indices),
        coldest=temperatures.coldest,
        hottest=temperatures.hottest,
        top=temperatures.peak,
        total=np.array(totals),
        finished=(state.index >= len(law.planned)) & ~broken,
    )


@dataclass(frozen=True)
class Contribution:
    """Effect of one uncertain parameter on the temperature of the hold."""

    name: Annotated[str, "uncertain parameter"]
    deviation: Annotated[
        float,
        unit("K"),
        form(".2f", label="effect on the hold >"),
        "standard deviation of the hold temperature by this parameter",
    ]


class ExpectedReading(NamedTuple):
    """Corrected reading of the sensor at one slot of a schedule, as the board shows it."""

    reading: float
    """Planned reading, degC."""
    deviation: float
    """Largest deviation from it of an uncertain rig, K."""
    delay: float
    """Longest delay of an uncertain rig, s."""


@dataclass(frozen=True, eq=False)
class Feedback(Displayed):
    """Feedback controller of a heating, and its simulation on S uncertain rigs."""

    sensor: Sensor
    """Sensor of the control loop."""
    law: HeatingLaw
    """Control law with gains and set-point."""
    uncertainty: Uncertainty
    """Uncertainty of rig and tube."""
    history: LoopHistory
    """Simulated control loops: the nominal rig first, then the sampled rigs."""
    lowest: Array
    """(S,) lowest temperature of the curved part in the hold, degC."""
    highest: Array
    """(S,) highest temperature of the curved part in the hold, degC."""
    top: Array
    """(S,) highest temperature of any point at any time, degC."""
    kept: NDArray[np.bool_]
    """(S,) True for rigs that stay in the window for the whole hold, and below the limit at all times."""
    open_loop: Annotated[float, "the same fraction with the schedule alone, without sensor"]
    contributions: Annotated[tuple[Contribution, ...], "effects on the hold temperature, largest first"]
    """The entry "sensor" is the bias of the sensor."""
    window: tuple[float, float]
    """Smallest and largest allowed temperature, degC."""
    limit: float
    """Largest allowed temperature of any point, degC."""
    bare: tuple[float, float] = (0.0, math.inf)
    """Length of bare tube beside a clamp, and the longest that keeps the limit where molds draw most heat, m."""
    volts: tuple[float, float] = (0.0, 0.0)
    """Voltage of the battery at rest, and the smallest with enough power in full pulses for all of these rigs, V."""

    @property
    def samples(self) -> int:
        """Number of sampled rigs S."""
        return len(self.kept)

    def expected(self, place: int) -> ExpectedReading:
        """Reading at the start of a slot of the schedule, with the deviations of the rigs that complete it."""
        index, finished = self.history.index[:, self.history.finished], self.history.finished
        begins = (index >= place).argmax(0)
        readings = np.take_along_axis(self.history.reading[:, finished], begins[None], 0)[0]
        reference = float(self.law.reference[place])
        deviation = float(np.abs(readings - reference).max(initial=0.0))
        return ExpectedReading(reference, deviation, self.law.slot * float((begins - place).max(initial=0)))

    @property
    def probability(self) -> float:
        """Fraction of the rigs that stay in the window."""
        return float(self.kept.mean())

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval of the probability (Wilson)."""
        return wilson(int(self.kept.sum()), self.samples)

    @property
    def silent(self) -> float:
        """Fraction of the rigs that miss window or limit without an error message."""
        return float((self.history.finished[1:] & ~self.kept).mean())

    @property
    def too_cold(self) -> float:
        """Fraction of the rigs that fall below the window or never reach the hold."""
        return float((self.lowest < self.window[0]).mean())

    @property
    def too_hot(self) -> float:
        """Fraction of the rigs that exceed the window in the hold, or the limit at any time."""
        return float(((self.highest > self.window[1]) | (self.top > self.limit)).mean())

    @property
    def problems(self) -> tuple[str, ...]:
        """Messages, with cures, if the bare tube is too long for some molds, or rigs miss without a report.

        No thermometer sees the bare tube beside the clamps.
        """
        problems = []
        hot = self.top > self.limit + MOST_EXCESS
        length, longest = (1e3 * value for value in self.bare)
        # The bound on the count keeps a bare tube that is a little too long below the limit on nearly all rigs.
        if hot.any() or (length > longest and self.probability < ENOUGH):
            cure = "Give the conductivity of the mold's board"
            if 0 < longest < length:
                cure = f"Make it at most {longest:.1f} mm long (clearance_mm of the clamps), or g{cure[1:]}"
            problems.append(
                f"{length:.1f} mm of bare tube beside each clamp are too long for molds that take much heat. It gets "
                f"hotter than {self.limit + MOST_EXCESS:.0f} degC on {100 * hot.mean():.0f} % of the uncertain rigs, "
                f"up to {self.top.max():.0f}. No thermometer sees it. {cure}"
            )
        given, needed = self.volts
        if needed > given and self.probability < ENOUGH:
            problems.append(
                f"the battery of {given:.1f} V is too weak for molds that take much heat: there full pulses leave the "
                f"tube behind its schedule. Take at least {needed:.1f} V, shorter leads, or a board that conducts less"
            )
        return (*problems, *((self.unreported,) if self.silent else ()))

    @property
    def unreported(self) -> str:
        """Message on the rigs that miss without a report."""
        return (
            f"{100 * self.silent:.1f} % of the uncertain rigs miss window or limit, and the board does not report "
            "it: measure the radius and Af of every tube, or calibrate the rig"
        )


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """95 % confidence interval of a probability (E. B. Wilson, J. Am. Stat. Assoc. 22 (1927))."""
    interval = scipy.stats.binomtest(successes, trials).proportion_ci(0.95, method="wilson")
    return float(interval.low), float(interval.high)
