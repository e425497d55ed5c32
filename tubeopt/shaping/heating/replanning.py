"""Replanning of the rest of a heating on a computer next to the rig, from the readings of its sensor.

An observer runs a coarse thermal model in parallel with the counts of the board. Its prediction errors correct the
temperatures of the tube and the strength of the heating relative to the model: an input disturbance, which removes
steady-state errors (Pannocchia and Rawlings, AIChE J. 49 (2003)). From that state the duties are planned with which the
sensor follows the reference of the control law to the end of the hold. The board gets the first of them every few
seconds.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import scipy

from ...typing import Array
from .controller import HeatingLaw
from .counts import max_count
from .plan import HeatingPlan
from .rig import COUNTS
from .robust import Response, response
from .sensors import MeasuredRig, Sensor
from .simulation import State
from .thermal import PROGRAM, ThermalModel, thermal_model

# The law may change duties by half (`HeatingLaw.share`), and so may the estimate of their strength.
MAX_STRENGTH, STRENGTH_CHANGE = 0.5, 0.01
"""Largest relative deviation of the heating power from the model, and standard deviation of its change in a slot."""

# With these weights the gains of the thesis' rig are 0.46 for the temperature and 0.35 % of strength per K: one wrong
# reading of 10 K moves the strength by 4 %.
PROCESS_NOISE, MODEL_NOISE = 1.0, 2.0
"""Standard deviations, K: drift of the temperature in a slot, and model error of a reading besides its noise."""

# Large beside round-off, small beside the half that the law may change.
PROBE = 0.05
"""Relative increase of a planned duty for the simulated response."""

MAX_SLOTS = 12
"""Longest override, slots: the board continues alone when it ends. The firmware accepts at most 20."""

STRAIGHT = 0.3
"""Largest difference of an override, which is linear in time, from the planned counts."""

SAME_REFERENCE = 2.0
"""Difference from the reference of the board's law above which its schedule is another one, K."""


class ObserverGains(NamedTuple):
    """Gains of the observer per K of prediction error."""

    temperature: float
    """Change of the estimated temperature, K/K."""
    strength: float
    """Relative change of the estimated strength of the heating, 1/K."""


@dataclass(frozen=True, eq=False)
class Planner:
    """Constant parts of the replanning: plan, control law of the board, sensor, coarse model and observer."""

    plan: HeatingPlan
    law: HeatingLaw
    sensor: Sensor
    model: ThermalModel
    gains: ObserverGains


@dataclass(frozen=True, eq=False)
class Estimate:
    """Estimated state of a rig."""

    rig: MeasuredRig
    strength: float = 0.0
    """Relative deviation of the heating power from the model."""


@dataclass(frozen=True, eq=False)
class Rest:
    """Replanned rest of a heating, N slots."""

    index: int
    """Index of its first slot in the schedule."""
    planned: Array
    """(N,) effective mean counts."""
    reading: Array
    """(N,) predicted readings at the ends of the slots, degC."""


def planner_for(plan: HeatingPlan, law: HeatingLaw, sensor: Sensor) -> Planner:
    """Planner for a rig under a control law."""
    model = thermal_model(plan.tube, plan.rig, PROGRAM)
    return Planner(plan, law, sensor, model, observer_gains(response(model, sensor, law), law.slot, sensor.noise))


def observer_gains(plant: Response, slot: float, noise: float) -> ObserverGains:
    """Steady-state gains of the Kalman filter for temperature and strength."""
    a = float(np.exp(-slot / plant.time_constant))
    A = np.array([[a, plant.gain * (1 - a)], [0.0, 1.0]])
    C = np.array([[1.0, 0.0]])
    Q, R = np.diag([PROCESS_NOISE**2, STRENGTH_CHANGE**2]), noise**2 + MODEL_NOISE**2
    P = scipy.linalg.solve_discrete_are(A.T, C.T, Q, [[R]])
    K = P @ C.T / (C @ P @ C.T + R)
    return ObserverGains(float(K[0, 0]), float(K[1, 0]))


def observed(planner: Planner, before: Estimate, reading: float, count: float, span: float) -> Estimate:
    """Estimate after `span` seconds at a count, from the reading (degC) at their start."""
    rig = before.rig
    error = float(np.clip(reading - rig.lagged[0], -50.0, 50.0))
    T_amb, tube = planner.model.T_amb, rig.state.cells[0, :, 0]
    # A prediction error is proportional to the rise above ambient; a cold tube is not corrected.
    rise = np.maximum(tube - T_amb, 0.0) / max(float(tube.max()) - T_amb, 50.0)
    change = planner.gains.temperature * error
    cells = rig.state.cells.copy()
    cells[0, :, 0] += change * rise
    strength = float(
        np.clip(before.strength + planner.gains.strength * error * rise.max(), -MAX_STRENGTH, MAX_STRENGTH)
    )
    change = float(rise.max()) * change
    corrected = MeasuredRig(State(cells, rig.state.lumped), rig.target + change, rig.lagged + change)
    return _after(planner, Estimate(corrected, strength), max(count - planner.law.lost, 0.0), span)


def _after(planner: Planner, now: Estimate, planned: float, span: float) -> Estimate:
    """Estimate `span` seconds later at an effective mean count."""
    count = planned * (1 + now.strength) + planner.law.lost * (planned > 0)
    return replace(now, rig=now.rig.after(planner.model, planner.sensor, min(count / COUNTS, 1.0), span))


def replanned(planner: Planner, now: Estimate, index: int) -> Rest:
    """Rest of the heating from a slot of the schedule on.

    At the end of each slot the sensor reads the reference of the law, as far as the bound of its correction, ramp and
    current allow.
    """
    law = planner.law
    planned, reading = [], []
    for k in range(index, len(law.planned)):
        after, before = (float(law.reference[min(j, len(law.reference) - 1)]) for j in (k + 1, k))
        # The reference is that of a reading that lags behind.
        target = after + planner.sensor.lag * (after - before) / law.slot
        nominal = float(law.planned[k])
        low, high = nominal * (1 - law.share), nominal * (1 + law.share)
        first, second = (
            float(_after(planner, now, level, law.slot).rig.target[0]) for level in (nominal, nominal * (1 + PROBE))
        )
        slope = (second - first) / max(PROBE * nominal, 1e-9)
        level = float(np.clip(nominal + (target - first) / max(slope, 1e-6), low, high))
        if k < law.hold[0]:
            most = max_count(planner.model, now.rig.state, planner.plan.spec, planner.plan.rig)
            level = max(min(level, (most - law.lost) / (1 + now.strength)), low)
        now = _after(planner, now, level, law.slot)
        planned.append(level)
        reading.append(float(now.rig.lagged[0]))
    return Rest(index, np.array(planned), np.array(reading))


@dataclass
class Replanner:
    """Supervisor that overrides the counts of a board, from its reports."""

    planner: Planner
    period: float = 3.0
    """Time between two plans, s."""
    rest: Rest | None = field(default=None, init=False)
    """Last plan; None before the first."""

    def __post_init__(self) -> None:
        self._estimate = Estimate(MeasuredRig.at_rest(self.planner.model, self.planner.sensor))
        self._slots_left, self._last_time = 0, float("-inf")

    @property
    def strength(self) -> float:
        """Relative deviation of the heating power from the model."""
        return self._estimate.strength

    def advise(self, row: dict[str, Any]) -> dict[str, Any] | None:
        """Arguments of the command "lead" after a report of the board on the start of a slot, or None.

        None for a board with another schedule, and for one in a dry run.
        """
        law, index = self.planner.law, int(row["place"])
        if row["dry"] or row["state"] not in ("heating", "holding"):
            return None
        self._estimate = observed(self.planner, self._estimate, row["temperature_degC"], row["count"], law.slot)
        self._slots_left -= 1
        due = row["time_s"] - self._last_time >= self.period or self._slots_left <= 1
        reported = np.clip([row["place"] - 1, row["place"]], 0, len(law.reference) - 1)
        same_schedule = np.abs(law.reference[reported] - row["reference_degC"]).min() < SAME_REFERENCE
        if not due or index >= len(law.planned) or not same_schedule:
            return None
        self.rest = replanned(self.planner, self._estimate, index)
        slots = straight_slots(self.rest.planned)
        self._slots_left, self._last_time = slots, row["time_s"]
        first, last = (round(100 * float(self.rest.planned[k])) for k in (0, slots - 1))
        return {"slots": slots, "from": min(first, 25500), "to": min(last, 25500)}


def straight_slots(planned: Array) -> int:
    """Number of planned counts, from the first on, that a straight line approximates."""
    longest = min(len(planned), MAX_SLOTS)
    for slots in range(longest, 2, -1):
        line = np.linspace(planned[0], planned[slots - 1], slots)
        if np.abs(line - planned[:slots]).max() <= STRAIGHT:
            return slots
    return min(longest, 2)
