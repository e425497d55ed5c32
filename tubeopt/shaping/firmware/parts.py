"""What a rig is built of: ratings of fuse, cable and MOSFET for the currents of a plan."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..heating.plan import HeatingPlan
from ..heating.rig import COUNTS
from .boards import LOWER, READABLE, Wiring, divider, hall_slope, upper_resistor

FUSES = (5, 10, 15, 20, 25, 30, 40, 50, 60, 70, 80, 100, 125, 150, 175, 200)
"""A, of blade and bolt fuses (ISO 8820)."""

DENSITY = 6.0
"""Lasting current that copper in free air bears, A/mm2 rms, for cables of some metres: assumed, on the safe side of IEC
60364-5-52 for single cores up to 25 mm2."""

CABLES = (1.5, 2.5, 4, 6, 10, 16, 25, 35, 50)
"""mm2, of stranded cables (IEC 60228)."""

SPARE = 1.25
"""By which a fuse, a cable and a MOSFET are rated above what flows."""


@dataclass(frozen=True)
class Part:
    """name: what is needed. rating: what it must be, in words. why: from what that follows."""

    name: str
    rating: str
    why: str


def root_mean_square(plan: HeatingPlan) -> float:
    """Greatest current of the plan as a root mean square over 10 s, A: what warms cables and fuses."""
    square = plan.duty / COUNTS * plan.current**2
    window = max(round(10.0 / plan.spec.slot), 1)
    return float(math.sqrt(np.convolve(square, np.ones(window) / window, mode="valid").max()))


def parts_list(plan: HeatingPlan, wiring: Wiring) -> tuple[Part, ...]:
    """Everything between battery and tube, rated for the plan's currents, and the board's own parts."""
    rms, peak, rest = root_mean_square(plan), plan.peak_current, plan.rig.battery.voltage
    fuse = next((size for size in FUSES if size >= SPARE * rms), FUSES[-1])
    # A cable must outlive its fuse.
    cable = next((size for size in CABLES if DENSITY * size >= max(SPARE * rms, fuse)), CABLES[-1])
    heat = rms**2 * plan.rig.circuit.mosfet_resistance
    current = f"{rms:.0f} A rms, {peak:.0f} A while on"
    sensor = {
        "max31855": "thermocouple type K 0.25 mm, its bead insulated, with MAX31855",
        "max6675": "thermocouple type K 0.25 mm, its bead insulated, with MAX6675",
        "analog": f"0 to {wiring.known.reference:g} V line of a camera or amplifier",
    }[wiring.converter]
    bears = math.ceil(2.5 * rest / 10) * 10
    resistance = 1e3 * plan.rig.circuit.mosfet_resistance
    reference, ratio = wiring.known.reference, divider(wiring, plan.rig.battery)
    upper = f"{upper_resistor(wiring, plan.rig.battery) / 1e3:g}"
    slope, limit = hall_slope(wiring, plan.rig.circuit), plan.rig.circuit.peak_limit
    hall = f"Hall, {math.ceil(max(SPARE * peak, READABLE * limit) / 50) * 50} A, {1e3 * slope:g} mV/A"
    return (
        Part("fuse", f"{fuse} A, slow, at the battery's plus", current),
        Part("cable", f"{cable:g} mm2 copper, as short as can be", current),
        Part("MOSFET", f"{bears} V, {math.ceil(SPARE * peak / 10) * 10} A, logic level, at most {resistance:g} mohm",
             f"{peak:.0f} A while on; warms by {heat:.1f} W"),
        Part("gate driver", "2 A or more, 10 kohm from gate to source", "without signal the switch must stay off"),
        Part("diode", f"Schottky, {bears} V, {math.ceil(peak / 10) * 10} A of pulse, across the tube",
             "the loop's inductance"),
        Part("emergency stop", "normally closed, in the gate driver's supply, second contact to the board",
             "stops without the board too"),
        Part("current sensor", hall, f"{current}; the board stops at {limit:g} A"),
        Part("divider", f"{upper} kohm to the battery, {LOWER / 1e3:g} kohm and 1 nF to ground",
             f"1 : {ratio:g}, {rest:.1f} V at rest are {rest / ratio:.2f} of {reference:g} V"),
        Part("thermometer", sensor, f"at the middle of the curved part, which is at {rest:.1f} V between pulses"),
        Part("board", wiring.known.title, "runs the sketch"),
    )  # fmt: skip
