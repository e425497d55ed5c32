"""What a schedule of whole counts keeps and what it breaks: window, limit, ramp and currents, within slots too."""

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
from .rig import COUNTS, Rig
from .simulation import History, resimulate
from .spec import HeatingSpec
from .thermal import ThermalModel, joined, seen

LEAST_CHARGE = 0.2
"""State of charge below which lead-acid batteries suffer."""

BROKEN = {
    "steepest": "the tube warms at up to {} K/s, beyond the ramp of {:g} K/s",
    "peak_current": "while the MOSFET conducts the current is {} A; the circuit allows {:g} A at any duty",
    "mean_current": "the mean current reaches {} A; the circuit allows {:g} A",
}
"""What is said of a limit that is not kept: the value, and the limit."""

COARSE_COUNT = (
    ": a single count is too coarse for it; a battery of less voltage, or a resistor in series, makes counts finer"
)
"""What is added where one count alone breaks the ramp of the cold tube."""


@dataclass(frozen=True)
class MeshError:
    """Error of the temperatures of the fine grid, K, from a grid half as fine (Richardson): the methods are of second
    order."""

    held: float
    """Of the coldest and of the hottest place of the curved part during the hold."""
    hottest: float
    """Of the hottest point at any time."""

    @property
    def most(self) -> float:
        """The greater of the two."""
        return max(self.held, self.hottest)


NO_ERROR = MeshError(0.0, 0.0)


@dataclass(frozen=True)
class Outcome:
    """What became of what was asked, within slots too."""

    lowest: Annotated[float, unit("degC"), "lowest temperature of the curved part in the hold"]
    highest: Annotated[float, unit("degC"), "highest temperature of the curved part in the hold"]
    hottest: Annotated[float, unit("degC"), "highest temperature of any point at any time"]
    shortfall: Annotated[float, unit("K"), "miss of window and limit"]
    """Each with its mesh error."""
    excess: float
    """By how much the hottest point is above the limit, its mesh error included, K."""
    mesh: MeshError
    """Error of these temperatures by the grid."""
    ramp: Annotated[float, unit("K_per_s"), "largest heating rate, mean over a slot"]
    """Of any point outside the clamps."""
    steepest: Annotated[float, unit("K_per_s"), "largest heating rate at any instant"]
    """With the duty taken as a mean power: what the specification limits."""
    mean_current: Annotated[float, unit("A"), "largest product of current and duty"]
    peak_current: Annotated[float, unit("A"), "largest current while the MOSFET conducts"]
    broken: Annotated[tuple[str, ...], "ramp or currents that exceed their limits"]
    """As text, with the excess."""

    @property
    def kept(self) -> bool:
        """Whether window, limit, ramp and currents are all kept."""
        return self.shortfall <= 0.0 and not self.broken


def outcome_of(
    model: ThermalModel, rig: Rig, spec: HeatingSpec, history: History, start: float, mesh: MeshError = NO_ERROR
) -> Outcome:
    """The outcome of what `resimulate` simulated, whose hold begins at `start`, s; with the error of its mesh."""
    within = history.within
    assert within is not None
    first, last = hold_slots(spec, start)
    lowest = float(joined(model, within.coldest[first:last]).min()) - ZERO_CELSIUS
    highest = float(joined(model, within.hottest[first:last]).max()) - ZERO_CELSIUS
    hottest = float(within.hottest.max()) - ZERO_CELSIUS
    low, high = spec.window_degC
    excess = max(hottest + mesh.hottest - spec.limit, 0.0)
    miss = max(low - lowest + mesh.held, highest - high + mesh.held, excess)
    warming = history.tube[1:, 0] - history.tube[:-1, 0]
    ramp = float(warming[:, model.zone > GRIP].max() / (history.time[1] - history.time[0]))
    found = {"steepest": within.rate, "mean_current": within.mean_current, "peak_current": within.current}
    return Outcome(
        lowest, highest, hottest, max(miss, 0.0), excess, mesh, ramp, **found, broken=broken(rig, spec, found, model)
    )


def hold_slots(spec: HeatingSpec, start: float) -> tuple[int, int]:
    """First slot of the hold, and the slot before which it ends."""
    first = round(start / spec.slot)
    return first, first + spec.hold_slots


def broken(
    rig: Rig, spec: HeatingSpec, found: Mapping[str, float], model: ThermalModel | None = None
) -> tuple[str, ...]:
    """In words, which of ramp and currents are beyond their limits; K/s and A by their names in `Outcome`. With a
    model, also whether a single count is too coarse for the ramp."""
    circuit = rig.circuit
    limits = {"steepest": spec.ramp, "peak_current": circuit.peak_limit, "mean_current": circuit.current_limit}
    beyond = {name: limit for name, limit in limits.items() if found[name] > limit}
    words = {name: BROKEN[name].format(_above(found[name], limit), limit) for name, limit in beyond.items()}
    if "steepest" in words and model is not None and count_warms(model, rig, spec) > spec.ramp:
        words["steepest"] += COARSE_COUNT
    return tuple(words.values())


def one_count(rig: Rig) -> int:
    """The least count that heats as much as one does where no pulse loses anything."""
    return math.ceil(1 + COUNTS * rig.circuit.lost_share - 1e-9)


def count_warms(model: ThermalModel, rig: Rig, spec: HeatingSpec) -> float:
    """Fastest warming of the cold tube outside of the clamps by one count in one slot, K/s.

    It is not fastest at once where contacts heat the tube in the clamps, which warms the tube beside them.
    """
    within = resimulate(model, spec.slot, [one_count(rig) / COUNTS]).within
    assert within is not None
    return within.rate


def _above(value: float, limit: float) -> str:
    """A value with as many digits as show that it is above its limit."""
    for digits in range(1, 6):
        if float(f"{value:.{digits}f}") > limit:
            return f"{value:.{digits}f}"
    return repr(value)


def remarks(rig: Rig, history: History, wall: float) -> tuple[str, ...]:
    """What else rig and mold suffer, in words; `wall` is the hottest temperature of the groove, K."""
    found = []
    mold = rig.mold.material
    if wall > mold.limit_temperature:
        found.append(
            f"the mold of {mold.name.replace('_', ' ')} {mold.failure} above {mold.limit_temperature_degC:.0f} degC; "
            f"its groove reaches {math.ceil(wall - ZERO_CELSIUS)} degC"
        )
    left = rig.battery.state_of_charge - float(history.lumped[-1, 0, CHARGE])
    if left < 0:
        used = rig.battery.state_of_charge - left
        found.append(
            f"the heating takes {100 * used:.0f} % of the battery's capacity; the battery holds "
            f"{100 * rig.battery.state_of_charge:.0f} %"
        )
    elif left < LEAST_CHARGE:
        found.append(
            f"the battery is left with {100 * left:.0f} % of its charge; below {100 * LEAST_CHARGE:.0f} % lead-acid "
            "batteries suffer"
        )
    return tuple(found)


Simulated = tuple[ThermalModel, History]
"""A model, and what a schedule does to it."""


def mesh_error(coarse: Simulated, fine: Simulated, spec: HeatingSpec, start: float) -> MeshError:
    """Error of a simulation whose hold begins at `start`, s, from one on a grid half as fine."""
    first, last = hold_slots(spec, start)
    ends = [np.array(seen(model, history.tube[: last + 1, 0])) for model, history in (coarse, fine)]
    change = np.abs(ends[0] - ends[1]) / 3
    return MeshError(float(change[:2, first:].max()), float(change[2].max()))
