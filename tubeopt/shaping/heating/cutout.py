"""Cut-out in series with the switch of a rig: a shorted switch, its fuse, and supplies that need no cut-out.

A monostable holds the cut-out closed. A tick of the board retriggers it in every pause of the pulses, through a gate
that is open only while the drain of the switch is high. A shorted switch keeps the drain low, a board that hangs sends
no tick: both open the cut-out without the board. The tube is at full current from the short until the cut-out has
opened, so its temperature then is the highest one.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from ...constants import ZERO_CELSIUS
from ...errors import without_unit_warnings
from ...files.field_metadata import form, key, unit
from ...physics.heat import GRIP
from ...robots.tubes import Tube
from .controller import MOST_COUNT
from .counts import full_current, heating_rate
from .plan import HeatingPlan
from .rig import COUNTS, Rig
from .simulation import State, advance, at_rest, circuit_state, resimulate, simulate
from .thermal import FINE, ThermalModel, stack, thermal_data, thermal_model
from .uncertainty import ENSEMBLE

SHORTED_LIMIT = 650.0
"""Highest allowed temperature of a tube with a shorted switch, degC: 50 K below the annealing of nitinol."""

OVERSHOOT = 8.0
"""Reading above the limit, K, that stops the firmware."""

MARGIN = 1.25
"""Largest current before the firmware stops, as a multiple of the current of the cold tube; factor on ratings."""

MONOSTABLE_PERIODS, MONOSTABLE_TOLERANCE = 1.5, 0.2
"""Time of the monostable in periods of the pulses, and its relative tolerance (resistor, capacitor, chip)."""

STEP = 1e-3
"""Time step of the simulation of a short, s: tubes warm by 1 to 3 K in it."""

LONGEST_SHORT = 1.0
"""Longest simulated short, s."""

SAFE_TIME = 600.0
"""Time at full current that an inherently safe supply must allow, s: an operator is back by then."""

# A fuse element ages by pulses: makers allow 100,000 of a fifth of its melting i2t.
PULSE_FACTOR = 5.0
"""Smallest melting i2t of a fuse, as a multiple of that of one pulse."""


def cutout_delay(rig: Rig, frequency: float | None = None) -> float:
    """Longest time from a short of the switch until the current has ended, s: monostable, then cut-out.

    Args:
        frequency: of the pulses, Hz; by default that of the rig.
    """
    monostable = MONOSTABLE_PERIODS * (1 + MONOSTABLE_TOLERANCE) / (frequency or rig.circuit.pwm_frequency)
    return monostable + rig.circuit.cutout_opening


def short_rise(tube: Tube, rig: Rig, frequency: float) -> float:
    """Temperature rise (K) of a tube by a shorted switch with pulses of a frequency (Hz), without losses.

    Of the bare tube, or of the gripped tube by the contact where a conductive mold draws more current than the tube.
    """
    data = thermal_data(tube)
    gripped = data.density * tube.cross_section * data.heat_capacity * rig.clamps.grip
    contact = 0.25 * full_current(tube, rig) ** 2 * rig.circuit.contact_resistance / gripped
    rate = max(heating_rate(tube, rig, full_current(tube, rig, leaking=False)), contact)
    return rate * cutout_delay(rig, frequency)


def stop_current(tube: Tube, rig: Rig) -> float:
    """Current that stops the firmware, A: 1.25 times that of the cold tube, or the limit of the circuit."""
    return min(rig.circuit.peak_limit, MARGIN * full_current(tube, rig))


@dataclass(frozen=True)
class Short:
    """Tube with a switch that shorts in one state of the heating."""

    state: Annotated[str, form("s", label="switch shorts"), "state of the heating"]
    time: Annotated[float | None, unit("s"), form("g", label="after >"), "time of the short"]
    before: Annotated[float, unit("degC"), form(".0f", label="tube >"), "hottest point before it"]
    peak: Annotated[float, unit("degC"), form(".0f", label="peak >"), "hottest point at any later time"]


@dataclass(frozen=True)
class CutOut:
    """Shorted switch of a rig under a plan: peak temperatures, delay of the cut-out, fuse."""

    shorts: Annotated[tuple[Short, ...], "switch shorts in five states of the heating"]
    peak: Annotated[
        float, key("shorted_degC"), "highest temperature of the tube by a short in any slot, or at the stop limit"
    ]
    delay: Annotated[float, key("cutout_delay_ms"), "longest time from a short until the current has ended"]
    budget: Annotated[float, key("cutout_budget_ms"), "delay that lets the tube reach 650 degC"]
    current: Annotated[float, key("shorted_A"), "largest current through the shorted switch"]
    pulse: Annotated[float, key("pulse_A2_s"), "i2t of the longest pulse, with corrections"]
    withstood: Annotated[float, key("withstood_A2_s"), "i2t that takes the tube from the stop limit to 650 degC"]

    @property
    def least_melting(self) -> float:
        """Smallest melting i2t of the fuse, A^2 s: it must outlive the pulses."""
        return PULSE_FACTOR * self.pulse

    @property
    def problems(self) -> tuple[str, ...]:
        """Violated safety limits, each with its cure."""
        problems = []
        if self.peak >= SHORTED_LIMIT:
            problems.append(
                f"with a shorted switch the tube reaches {self.peak:.0f} degC before the cut-out opens after "
                f"{1e3 * self.delay:.0f} ms; it must open within {1e3 * self.budget:.0f} ms: use a high-side switch "
                "(cutout_opening_ms: 1) or faster pulses"
            )
        if self.least_melting >= self.withstood:
            problems.append(
                f"no fuse melts before the tube and survives the pulses: it must melt between {self.least_melting:.0f} "
                f"and {self.withstood:.0f} A2s; use faster pulses, or a supply of less voltage"
            )
        return tuple(problems)


@functools.lru_cache(maxsize=8)
def cut_out(plan: HeatingPlan) -> CutOut:
    """Temperatures by a shorted switch in every slot of a plan, and the time that the cut-out may take."""
    model = thermal_model(plan.tube, plan.rig, FINE)
    slot, duty = plan.spec.slot, plan.duty[:-1] / COUNTS
    history = resimulate(model, slot, duty)
    last = round(plan.hold_end / slot)
    start, delay = round(plan.hold_start / slot), cutout_delay(plan.rig)
    states = [history.state(k) for k in range(last + 1)]
    # The controller allows a tube at the stop limit: all cells of the hottest state by as much hotter.
    hottest = max(states, key=lambda state: float(state.cells[..., 0].max()))
    stop = plan.spec.limit + OVERSHOOT + ZERO_CELSIUS
    raised = hottest.cells.copy()
    raised[..., 0] += max(stop - float(raised[..., 0].max()), 0.0)
    limit = State(raised, hottest.lumped)
    every = State(*(np.concatenate([getattr(s, name) for s in (*states, limit)]) for name in ("cells", "lumped")))
    after = advance(stack([model] * (last + 2)), every, 1.0, delay, math.ceil(delay / STEP))
    # Without current nothing in the tube gets hotter than its hottest point.
    before, peaks = (part.cells[..., 0].max(1) - ZERO_CELSIUS for part in (every, after))
    middle = 0.5 * (before[0] + before[start])
    named = {
        "cold": 0,
        "half warm": int(np.argmax(before >= middle)),
        "as the hold begins": start,
        "as the hold ends": last,
        "at the stop limit": last + 1,
    }
    budget, withstood = _short_budget(model, limit)
    on = largest_count(plan) / COUNTS / plan.rig.circuit.pwm_frequency
    return CutOut(
        shorts=tuple(
            Short(name, slot * k if k <= last else None, float(before[k]), float(peaks[k])) for name, k in named.items()
        ),
        peak=float(peaks.max()),
        delay=delay,
        budget=budget,
        current=max(plan.peak_current, float(_current(model, at_rest(model)))),
        pulse=plan.peak_current**2 * on,
        withstood=withstood,
    )


def largest_count(plan: HeatingPlan) -> float:
    """Largest count of a pulse of a plan, with the corrections of its feedback."""
    planned = float(plan.duty.max())
    if plan.feedback is None:
        return planned
    law = plan.feedback.law
    corrected = law.planned * (1 + law.largest(law.planned)) + law.lost
    # Error diffusion adds up to a count.
    return max(planned, min(math.ceil(float(corrected.max())), MOST_COUNT))


def _current(model: ThermalModel, state: State) -> float:
    return float(circuit_state(model, state.cells[:, :, 0], state.lumped).I_on[0])


def _short_budget(model: ThermalModel, state: State) -> tuple[float, float]:
    """Time (s) at full current, and its i2t (A^2 s), until the tube reaches `SHORTED_LIMIT`; at most
    `LONGEST_SHORT`.
    """
    time, i2t, hottest = 0.0, 0.0, float(state.cells[..., 0].max()) - ZERO_CELSIUS
    while hottest < SHORTED_LIMIT and time < LONGEST_SHORT:
        before, current = hottest, _current(model, state)
        state = advance(model, state, 1.0, STEP, 1)
        hottest = float(state.cells[..., 0].max()) - ZERO_CELSIUS
        # The last step only as far as the limit.
        part = min(1.0, (SHORTED_LIMIT - before) / max(hottest - before, 1e-9))
        time, i2t = time + part * STEP, i2t + current**2 * part * STEP
    return time, i2t


def digits(value: float) -> str:
    """Number with two digits, without an exponent, as text."""
    return f"{float(f'{value:.2g}'):g}"


def upward(value: float) -> str:
    """Number above 0, rounded up to two digits, without an exponent, as text."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return digits(math.ceil(value / step - 1e-9) * step)


# --- supplies that need no cut-out ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SafeSupply:
    """Supply that cannot overheat the tube: at full current for `SAFE_TIME` it stays below `SHORTED_LIMIT`."""

    name: Annotated[str, form("s", label="instead of a cut-out"), "kind of supply"]
    rating: Annotated[str, form("s", label="rating"), "its rating"]
    peak: Annotated[float, unit("degC"), form(".0f", label="10 min on >"), "hottest point after ten minutes"]
    warm_up: Annotated[
        float | None, unit("s"), form(".0f", label="warm after >"), "time until the curved part is in the window"
    ]
    """None if it does not get there in this time."""
    longer: Annotated[
        float | None, unit("s"), form("+.0f", label="than planned >"), "additional time, relative to the plan"
    ]


@without_unit_warnings()
def safe_supplies(plan: HeatingPlan) -> tuple[SafeSupply, ...]:
    """Resistor in series with the battery, and a supply of limited current: the largest current that is safe."""
    low = plan.spec.window_degC[0] + ZERO_CELSIUS
    slots = round(SAFE_TIME / plan.spec.slot)

    def full(resistor: float) -> tuple[float, float | None, float]:
        """Hottest point, K, time to the window, s, and initial current, A, at full current through a resistor, ohm."""
        circuit = replace(plan.rig.circuit, cable_resistance=plan.rig.circuit.cable_resistance + resistor)
        model = thermal_model(plan.tube, replace(plan.rig, circuit=circuit), ENSEMBLE)
        history = simulate(model, plan.spec.slot, np.ones(slots))
        warm = (history.tube[:, 0, model.curved] >= low).all(1)
        reached = float(history.time[np.argmax(warm)]) if warm.any() else None
        return float(history.tube[:, 0, model.zone > GRIP].max()), reached, float(history.current[0, 0])

    # Bisection in the logarithm: the hottest point falls as the resistor grows.
    bounds = [1e-3, 100.0]
    for _ in range(16):
        middle = math.sqrt(bounds[0] * bounds[1])
        bounds[int(full(middle)[0] - ZERO_CELSIUS < SHORTED_LIMIT)] = middle
    resistor = bounds[1]
    peak, warm_up, current = full(resistor)
    longer = None if warm_up is None else warm_up - plan.hold_start
    rating = f"{resistor:.3g} ohm, {MARGIN * current**2 * resistor:.0f} W"
    limited = f"{digits(current)} A, {plan.rig.battery.voltage:.0f} V"
    return tuple(
        SafeSupply(name, words, peak - ZERO_CELSIUS, warm_up, longer)
        for name, words in (("resistor in series with the battery", rating), ("supply of limited current", limited))
    )
