"""Planning the rest of a heating anew, on a computer beside the rig, from what its sensor reads.

An observer carries a coarse thermal model along with the counts that were given. What it predicts wrongly corrects the
tube's temperatures and a share by which the heating is stronger than the model says: a disturbance at the input, with
which no error stays (Pannocchia and Rawlings, AIChE J. 49 (2003)). From that state the duties are planned with which
the sensor reads what the law wants, to the end of the hold; the board gets the first of them every few seconds.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy

from ...typing import Array
from .controller import HeatingLaw
from .counts import most_count
from .plan import HeatingPlan
from .rig import COUNTS
from .robust import Response, response
from .sensors import Felt, Sensor
from .simulation import State
from .thermal import PROGRAM, ThermalModel, thermal_model

# The law may change duties by half (`HeatingLaw.share`), and so may the estimate of their strength.
MOST_STRENGTH, STRENGTH_CHANGE = 0.5, 0.01
"""Largest relative deviation of the heating power from the model, and its change in a slot."""

# With these weights the gains of the thesis' rig are 0.46 for the temperature and 0.35 % of strength per K: one wrong
# reading of 10 K moves the strength by 4 %.
DRIFT, ROUGH = 1.0, 2.0
"""Drift of the temperature in a slot, and error of the model in a reading beside the sensor's noise, K."""

# Large beside round-off, small beside the half that the law may change.
PROBE = 0.05
"""Relative increase of a planned duty that tests the response."""

MOST_SLOTS = 12
"""Of one lead: the board goes on alone where no other comes before it ends; it takes no more than 20."""

STRAIGHT = 0.3
"""Counts by which a lead, which is a line, may differ from what was planned."""

STEADY = 2.0
"""K by which what the board wants may differ from the law that is planned with."""


@dataclass(frozen=True, eq=False)
class Planner:
    """What is planned with: the plan, the law that its board has, the sensor, a coarse model of one member, and the
    gains of the observer: K of temperature, and share of strength, per K of error."""

    plan: HeatingPlan
    law: HeatingLaw
    sensor: Sensor
    model: ThermalModel
    gains: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Estimate:
    """What is thought of a rig: its state, and the share by which the heating is stronger than the model says."""

    felt: Felt
    strength: float = 0.0


@dataclass(frozen=True, eq=False)
class Rest:
    """The rest of a heating, planned anew: (N,) mean counts of effect from a slot of the schedule to its end, and what
    the sensor should read as each ends, degC."""

    place: int
    planned: Array
    reading: Array


def planner_for(plan: HeatingPlan, law: HeatingLaw, sensor: Sensor) -> Planner:
    """The planner for a rig that a law leads."""
    model = thermal_model(plan.tube, plan.rig, PROGRAM)
    found = response(model, sensor, law)
    return Planner(plan, law, sensor, model, observer_gains(found, law.slot, sensor.noise))


def observer_gains(found: Response, slot: float, noise: float) -> tuple[float, float]:
    """Gains of the Kalman filter in the long run, of temperature and strength."""
    kept = float(np.exp(-slot / found.time_constant))
    A = np.array([[kept, found.gain * (1 - kept)], [0.0, 1.0]])
    C = np.array([[1.0, 0.0]])
    expected, wrong = np.diag([DRIFT**2, STRENGTH_CHANGE**2]), noise**2 + ROUGH**2
    P = scipy.linalg.solve_discrete_are(A.T, C.T, expected, [[wrong]])
    gain = P @ C.T / (C @ P @ C.T + wrong)
    return float(gain[0, 0]), float(gain[1, 0])


def observed(planner: Planner, before: Estimate, reading: float, count: float, span: float) -> Estimate:
    """The estimate after `span` seconds, s, at a count, from the reading (degC) with which they began."""
    felt = before.felt
    error = float(np.clip(reading - felt.lagged[0], -50.0, 50.0))
    ambient, tube = planner.model.ambient, felt.state.cells[0, :, 0]
    # Where the tube is hotter than its surroundings it is so by a factor; a cold tube is left alone.
    rise = np.maximum(tube - ambient, 0.0) / max(float(tube.max()) - ambient, 50.0)
    change = planner.gains[0] * error
    cells = felt.state.cells.copy()
    cells[0, :, 0] += change * rise
    strength = float(np.clip(before.strength + planner.gains[1] * error * rise.max(), -MOST_STRENGTH, MOST_STRENGTH))
    part = float(rise.max()) * change
    now = Felt(State(cells, felt.state.lumped), felt.target + part, felt.lagged + part)
    return _after(planner, Estimate(now, strength), max(count - planner.law.lost, 0.0), span)


def _after(planner: Planner, now: Estimate, planned: float, span: float) -> Estimate:
    """The estimate `span` seconds later, at a mean count of effect."""
    count = planned * (1 + now.strength) + planner.law.lost * (planned > 0)
    return replace(now, felt=now.felt.after(planner.model, planner.sensor, min(count / COUNTS, 1.0), span))


def replanned(planner: Planner, now: Estimate, place: int) -> Rest:
    """The rest of the heating from a slot of the schedule on: counts with which the sensor reads what the law wants as
    each slot ends, within what the law may change and what ramp and current allow."""
    law, share = planner.law, planner.law.share
    planned, reading = [], []
    for k in range(place, len(law.planned)):
        ends, begins = (float(law.reference[min(at, len(law.reference) - 1)]) for at in (k + 1, k))
        # The reference is that of a reading that lags behind.
        wanted = ends + planner.sensor.lag * (ends - begins) / law.slot
        usual = float(law.planned[k])
        low, high = usual * (1 - share), usual * (1 + share)
        probes = usual, usual * (1 + PROBE)
        first, second = (float(_after(planner, now, level, law.slot).felt.target[0]) for level in probes)
        slope = (second - first) / max(PROBE * usual, 1e-9)
        level = float(np.clip(usual + (wanted - first) / max(slope, 1e-6), low, high))
        if k < law.hold[0]:
            most = most_count(planner.model, now.felt.state, planner.plan.spec, planner.plan.rig)
            level = max(min(level, (most - law.lost) / (1 + now.strength)), low)
        now = _after(planner, now, level, law.slot)
        planned.append(level)
        reading.append(float(now.felt.lagged[0]))
    return Rest(place, np.array(planned), np.array(reading))


@dataclass
class Leader:
    """What leads a board by its reports."""

    planner: Planner
    every: float = 3.0
    """From one plan to the next, s."""
    rest: Rest | None = field(default=None, init=False)
    """The last plan."""

    def __post_init__(self) -> None:
        self._estimate = Estimate(Felt.at_rest(self.planner.model, self.planner.sensor))
        self._left, self._time = 0, float("-inf")

    @property
    def strength(self) -> float:
        """By how much the rig heats more than its model, as a fraction."""
        return self._estimate.strength

    def advise(self, row: dict[str, Any]) -> dict[str, Any] | None:
        """What to tell the board after one of its reports on a slot that begins: a lead, or nothing.

        Nothing is told to a board whose schedule is another one, or to one that is dry.
        """
        law, place = self.planner.law, int(row["place"])
        if row["dry"] or row["state"] not in ("heating", "holding"):
            return None
        self._estimate = observed(self.planner, self._estimate, row["temperature_degC"], row["count"], law.slot)
        self._left -= 1
        due = row["time_s"] - self._time >= self.every or self._left <= 1
        if not due or place >= len(law.planned) or not self._is_ours(row):
            return None
        self.rest = replanned(self.planner, self._estimate, place)
        slots = straight(self.rest.planned)
        self._left, self._time = slots, row["time_s"]
        first, last = (round(100 * float(self.rest.planned[k])) for k in (0, slots - 1))
        return {"slots": slots, "from": min(first, 25500), "to": min(last, 25500)}

    def _is_ours(self, row: dict[str, Any]) -> bool:
        reference = self.planner.law.reference
        place = np.clip([row["place"] - 1, row["place"]], 0, len(reference) - 1)
        return bool(np.abs(reference[place] - row["reference_degC"]).min() < STEADY)


def straight(planned: Array) -> int:
    """How many of the first counts a line from the first to the last of them tells."""
    most = min(len(planned), MOST_SLOTS)
    for slots in range(most, 2, -1):
        line = np.linspace(planned[0], planned[slots - 1], slots)
        if np.abs(line - planned[:slots]).max() <= STRAIGHT:
            return slots
    return min(most, 2)
