"""Comparison of a simulated schedule with its requirements: window, limit, ramp and currents, also within slots."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ...constants import ZERO_CELSIUS
from ...files.field_metadata import unit
from ...physics.heat import GRIP
from ...physics.heat_functions import CHARGE
from .rig import COUNTS, LEAD_ACID, Rig
from .simulation import History, resimulate
from .spec import HeatingSpec
from .thermal import ThermalModel, curved_temperatures, tube_extremes

MIN_CHARGE = 0.2
"""State of charge below which lead-acid batteries suffer."""

BROKEN = {
    "steepest": "the tube warms at up to {} K/s, beyond the ramp of {:g} K/s",
    "peak_current": "while the MOSFET conducts the current is {} A; the circuit allows {:g} A at any duty",
    "mean_current": "the mean current reaches {} A; the circuit allows {:g} A",
}
"""Message for a violated limit, with the value and the limit."""

COARSE_COUNT = (
    ": a single count is too coarse for it; a battery of less voltage, or a resistor in series, makes counts finer"
)
"""Addition to the message where one count alone exceeds the ramp of the cold tube."""


@dataclass(frozen=True)
class MeshError:
    """Error of the temperatures of the fine grid by Richardson extrapolation from a grid half as fine, K."""

    hold: float
    """Error of the coldest and hottest point of the curved part during the hold."""
    hottest: float
    """Error of the hottest point at any time."""

    @property
    def largest(self) -> float:
        """Larger one of the two errors, K."""
        return max(self.hold, self.hottest)


NO_ERROR = MeshError(0.0, 0.0)


@dataclass(frozen=True)
class Outcome:
    """Temperatures, heating rate and currents of a schedule compared with their limits, also within slots."""

    lowest: Annotated[float, unit("degC"), "lowest temperature of the curved part in the hold"]
    highest: Annotated[float, unit("degC"), "highest temperature of the curved part in the hold"]
    hottest: Annotated[float, unit("degC"), "highest temperature of any point at any time"]
    shortfall: Annotated[float, unit("K"), "miss of window and limit"]
    """Mesh errors are included."""
    excess: float
    """Excess of the hottest point over the limit, mesh error included, K."""
    mesh: MeshError
    """Error of the temperatures caused by the grid."""
    ramp: Annotated[float, unit("K_per_s"), "largest heating rate, mean over a slot"]
    """Largest over all points outside the clamps."""
    steepest: Annotated[float, unit("K_per_s"), "largest heating rate at any instant"]
    """The duty is taken as a mean power; this rate is limited by the specification."""
    mean_current: Annotated[float, unit("A"), "largest product of current and duty"]
    peak_current: Annotated[float, unit("A"), "largest current while the MOSFET conducts"]
    broken: Annotated[tuple[str, ...], "ramp or currents that exceed their limits"]
    """Messages with value and limit."""

    @property
    def feasible(self) -> bool:
        """True if window, limit, ramp and currents are all satisfied."""
        return self.shortfall <= 0.0 and not self.broken


def outcome_of(
    model: ThermalModel, rig: Rig, spec: HeatingSpec, history: History, start: float, mesh: MeshError = NO_ERROR
) -> Outcome:
    """Outcome of a history of `resimulate`, with the hold from `start`, s."""
    within = history.within
    assert within is not None
    first, last = hold_slots(spec, start)
    lowest = float(curved_temperatures(model, within.coldest[first:last]).min()) - ZERO_CELSIUS
    highest = float(curved_temperatures(model, within.hottest[first:last]).max()) - ZERO_CELSIUS
    hottest = float(within.hottest.max()) - ZERO_CELSIUS
    low, high = spec.window_degC
    excess = max(hottest + mesh.hottest - spec.limit, 0.0)
    miss = max(low - lowest + mesh.hold, highest - high + mesh.hold, excess)
    rises = history.tube[1:, 0] - history.tube[:-1, 0]
    limited = {"steepest": within.rate, "mean_current": within.mean_current, "peak_current": within.current}
    return Outcome(
        lowest=lowest,
        highest=highest,
        hottest=hottest,
        shortfall=max(miss, 0.0),
        excess=excess,
        mesh=mesh,
        ramp=float(rises[:, model.zone > GRIP].max() / (history.time[1] - history.time[0])),
        **limited,
        broken=broken(rig, spec, limited, model),
    )


def hold_slots(spec: HeatingSpec, start: float) -> tuple[int, int]:
    """First slot of the hold, and the first slot after it."""
    first = round(start / spec.slot)
    return first, first + spec.hold_slots


def broken(
    rig: Rig, spec: HeatingSpec, values: Mapping[str, float], model: ThermalModel | None = None
) -> tuple[str, ...]:
    """Messages on ramp and currents that exceed their limits.

    With a model, the message for the ramp says whether a single count is too coarse for it.
    """
    circuit = rig.circuit
    limits = {"steepest": spec.ramp, "peak_current": circuit.peak_limit, "mean_current": circuit.current_limit}
    messages = {
        name: BROKEN[name].format(_distinct(values[name], limit), limit)
        for name, limit in limits.items()
        if values[name] > limit
    }
    if "steepest" in messages and model is not None and count_rate_of(model, rig, spec) > spec.ramp:
        messages["steepest"] += COARSE_COUNT
    return tuple(messages.values())


def effective_count(rig: Rig) -> int:
    """Smallest count that heats at least as much as one count of a circuit without inductance."""
    return math.ceil(1 + COUNTS * rig.circuit.lost_share - 1e-9)


def count_rate_of(model: ThermalModel, rig: Rig, spec: HeatingSpec) -> float:
    """Largest heating rate of the cold tube outside the clamps by one count in one slot, K/s.

    It may occur late: contacts heat the tube in the clamps, which warms the tube beside them.
    """
    within = resimulate(model, spec.slot, [effective_count(rig) / COUNTS]).within
    assert within is not None
    return within.rate


def count_breaks_limits(model: ThermalModel, rig: Rig, spec: HeatingSpec) -> bool:
    """True if the smallest count that heats exceeds ramp or mean current: no schedule keeps these limits.

    The first slot that heats begins at rest, and a larger count heats more.
    """
    smallest = math.floor(1 + COUNTS * rig.circuit.lost_share + 1e-9)
    within = resimulate(model, spec.slot, [smallest / COUNTS]).within
    assert within is not None
    return bool(within.rate > spec.ramp or within.mean_current > rig.circuit.current_limit)


def _distinct(value: float, limit: float) -> str:
    """Text of a value with as many digits as it needs to differ from its limit."""
    for digits in range(1, 6):
        if float(f"{value:.{digits}f}") > limit:
            return f"{value:.{digits}f}"
    return repr(value)


def remarks(rig: Rig, history: History, mold_temperature: float) -> tuple[str, ...]:
    """Remarks on mold and battery; `mold_temperature` is the hottest temperature of the groove, K."""
    messages = []
    mold = rig.mold.material
    if mold_temperature > mold.limit_temperature:
        messages.append(
            f"the mold of {mold.name.replace('_', ' ')} {mold.failure} above {mold.limit_temperature_degC:.0f} degC; "
            f"its groove reaches {math.ceil(mold_temperature - ZERO_CELSIUS)} degC"
        )
    left = rig.battery.state_of_charge - float(history.lumped[-1, 0, CHARGE])
    if left < 0:
        used = rig.battery.state_of_charge - left
        messages.append(
            f"the heating takes {100 * used:.0f} % of the battery's capacity; the battery has "
            f"{100 * rig.battery.state_of_charge:.0f} %"
        )
    elif left < MIN_CHARGE and rig.battery.chemistry == LEAD_ACID:
        messages.append(
            f"the battery is left with {100 * left:.0f} % of its charge; below {100 * MIN_CHARGE:.0f} % lead-acid "
            "batteries suffer"
        )
    return tuple(messages)


Simulated = tuple[ThermalModel, History]
"""Model, and its history under a schedule."""


def mesh_error(coarse: Simulated, fine: Simulated, spec: HeatingSpec, start: float) -> MeshError:
    """Mesh error of a simulation with the hold from `start`, s, from one on a grid half as fine."""
    first, last = hold_slots(spec, start)
    extremes = [np.array(tube_extremes(model, history.tube[: last + 1, 0])) for model, history in (coarse, fine)]
    # Of second order: the error of half as many cells is 4 times that of the fine grid, their difference 3 times.
    change = np.abs(extremes[0] - extremes[1]) / 3
    return MeshError(float(change[:2, first:].max()), float(change[2].max()))
