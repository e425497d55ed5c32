"""Boards that run the firmware, their measurements, and the electrical parts of a rig."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from ...errors import InputError, choice
from ...files.field_metadata import POSITIVE, OneOf, check_fields, form, key, unit
from ...files.units import TO_MM
from ...robots.tubes import Tube
from ..heating.cutout import (
    MARGIN,
    MONOSTABLE_PERIODS,
    SHORTED_LIMIT,
    cut_out,
    digits,
    short_rise,
    stop_current,
    upward,
)
from ..heating.plan import HeatingPlan
from ..heating.rig import CHARGED, COUNTS, Battery, Rig
from ..heating.thermocouple import WIRE

CONVERTERS = {"max31855": 125, "max6675": 250, "analog": 20}
"""Converter of a thermocouple, or an analog line such as a camera's, and the smallest time between readings, ms.

Data sheets of Maxim: 100 and 220 ms at most; with a reserve.
"""

READS = {"thermocouple": ("max31855", "max6675"), "camera": ("analog",)}
"""Converters in the sketch for each sensor, the default first. It reads no temperature from resistance."""

LOWER = 10e3
"""Resistor of the divider from the pin to ground, ohm. With any upper resistor the source resistance is below the
10 kohm that the converter of the ATmega requires (data sheet of the ATmega328P)."""

VOLTAGE_RANGE = 1.5
"""Range of the voltage measurement, as a multiple of a full battery at rest: for chargers and switching peaks; the
converter of the ESP32 is linear up to about three quarters of its reference."""

HALL = (0.04, 0.02, 0.01, 0.008, 0.005, 0.004, 0.002)
"""Sensitivities of common Hall sensors for 100 to 2000 A, V/A."""

HALL_SPAN = 4.0
"""Voltage of these sensors from no current to the end of their range, V."""

CURRENT_RANGE = 1.2
"""Smallest range of the current measurement, as a multiple of the current that stops the sketch."""

LOOP_INDUCTANCE = 2e-6
"""Inductance of the cables between battery and MOSFET, H: about 2 m of a pair (assumed).

A diode across the tube does not clamp it.
"""

MOSFET_HEAT = 3.0
"""Largest loss of a MOSFET on a board without a heat sink, W (assumed)."""

TVS_HEAT = 5.0
"""Largest mean loss of a TVS diode on a board, W (data sheets of SMBJ diodes)."""

MOST_COIL = 15.0
"""Largest voltage of a charged battery that feeds a coil and a gate driver of 12 V, V: that of a vehicle's supply."""

MOST_BIMETAL = 180.0
"""Highest temperature of common bimetallic switches, degC; capillaries reach 500 (assumed)."""

CLAMP_RESERVE = 30.0
"""Rise of the thermal cut-out above the hottest planned clamp, K."""

HOT_TUBE = 560.0
"""Tube when the switch shorts, degC, to choose the PWM frequency: above the stop limit of a window up to 550."""

PULSE_FACTORS, TIMING_CAPACITOR = ((2.0, 0.55), (5.0, 0.45)), 470e-9
"""Time of a 74HC123 over resistor times capacitor at a supply, V (NXP, Rev. 9, 2015), and its film capacitor, F."""

E24 = (
    1.0, 1.1, 1.2, 1.3, 1.5, 1.6, 1.8, 2.0, 2.2, 2.4, 2.7, 3.0, 3.3, 3.6, 3.9, 4.3, 4.7, 5.1, 5.6, 6.2, 6.8, 7.5, 8.2,
    9.1,
)  # fmt: skip
"""Resistors of a decade (IEC 60063)."""


@dataclass(frozen=True)
class Board:
    """Microcontroller board."""

    name: str
    title: str
    frequencies: tuple[float, ...]
    """PWM frequencies that the sketch sets, Hz."""
    steps: int
    """Number of steps of the analog-digital converter."""
    reference: float
    """Reference voltage of the converter, V."""
    pins: dict[str, str]
    """Pins of gate, tick of the cut-out, stop button, chip select, voltage, current and analog temperature; clock and
    data of the converter are those of SPI in the board's core.
    """
    prefix: str = "pin "
    """Name of its pins before their number."""
    feed: str = "5V"
    """Name of its pin that takes 5 V."""
    core: str = ""
    """Arduino core of the board that has to be installed; "" for that of the Arduino IDE."""

    def pin(self, use: str) -> str:
        """Name of the pin for a key of `pins`, as text."""
        return f"{self.prefix}{self.pins[use]}"


AVR_PINS = {
    "gate": "9",
    "tick": "8",
    "stop": "2",
    "select": "10",
    "voltage": "A0",
    "current": "A1",
    "temperature": "A2",
    "clock": "13",
    "data": "12",
}
ATMEGA = (16e6 / 1024 / 510, 16e6 / 256 / 510, 16e6 / 64 / 510)
"""Frequencies of timer 1, phase-correct in 8 bits, Hz."""

BOARDS = {
    "uno": Board("uno", "Arduino Uno", ATMEGA, 1024, 5.0, AVR_PINS),
    "nano": Board("nano", "Arduino Nano", ATMEGA, 1024, 5.0, AVR_PINS),
    "esp32": Board(
        "esp32", "ESP32", (31.0, 122.0, 490.0), 4096, 3.3,
        {"gate": "25", "tick": "26", "stop": "27", "select": "5", "voltage": "34", "current": "35",
         "temperature": "32", "clock": "18", "data": "19"}, "IO", core="core esp32 of Espressif, version 3",
    ),
    "pico": Board(
        "pico", "Raspberry Pi Pico", (122.0, 490.0), 1024, 3.3,
        {"gate": "15", "tick": "13", "stop": "14", "select": "17", "voltage": "26", "current": "27",
         "temperature": "28", "clock": "18", "data": "16"}, "GP", "VSYS",
        "core Raspberry Pi Pico/RP2040 of E. Philhower",
    ),
}  # fmt: skip
"""Boards by name. The Pico's core has no PWM below 100 Hz."""


@dataclass(frozen=True)
class Wiring:
    """Connections between a board, its sensors and the rig.

    Raises:
        InputError: a value is out of its range, or an unknown board.
    """

    board: Annotated[str, OneOf(tuple(BOARDS)), "board: uno, nano, esp32 or pico"] = "uno"
    converter: Annotated[str, OneOf(tuple(CONVERTERS)), "converter of the thermometer signal"] = "max31855"
    measures_electrics: Annotated[bool, "battery voltage and current are connected to the board"] = True
    shunt_V_per_A: Annotated[
        float | None,
        POSITIVE,
        "sensitivity of the Hall sensor at the pin; default chosen from the current limit of the circuit",
    ] = None
    current_zero: Annotated[float, unit("V"), "voltage at the pin at zero current"] = 0.5
    analog_low: Annotated[float, key("analog_low_degC"), "temperature at 0 V of an analog line"] = 0.0
    analog_per_volt: Annotated[float, key("analog_per_volt_K"), POSITIVE, "slope of an analog line per volt"] = 200.0

    def __post_init__(self) -> None:
        check_fields(self, "the wiring")

    @property
    def known(self) -> Board:
        """Board of this wiring, with its pins and converter."""
        return BOARDS[self.board]


def converter_for(sensor: str, requested: str | None = None) -> str:
    """Converter in the sketch for a sensor: the requested or the default one.

    Raises:
        InputError: the sketch does not read such a sensor, or not by the requested converter.
    """
    if sensor not in READS:
        raise InputError(
            f"sensor is {sensor!r}; for a sketch it must be one of {', '.join(READS)}; "
            "plan_heating(..., sensor=) in Python evaluates other sensors"
        )
    return READS[sensor][0] if requested is None else choice(f"converter of a {sensor}", requested, READS[sensor])


def upper_resistor(wiring: Wiring, battery: Battery) -> float:
    """Resistor of the divider from the battery to the pin, ohm: the smallest of E24 for the range; at least 1 kohm."""
    _, full = battery.open_circuit[-1]
    smallest = max(LOWER * (VOLTAGE_RANGE * full / wiring.known.reference - 1), 1e3)
    decade = 10.0 ** math.floor(math.log10(smallest))
    return next(value * decade for value in (*E24, 10.0) if value * decade >= smallest)


def timing_resistor(wiring: Wiring, frequency: float) -> float:
    """Resistor (ohm) of the monostable for pulses of a frequency (Hz): the nearest of E24."""
    factor = float(np.interp(wiring.known.reference, *np.array(PULSE_FACTORS).T))
    desired = MONOSTABLE_PERIODS / frequency / (factor * TIMING_CAPACITOR)
    decade = 10.0 ** math.floor(math.log10(desired))
    return min((value * decade for value in (*E24, 10.0)), key=lambda value: abs(math.log(value / desired)))


GATE_HIGH = (2.0, 1.5), (4.5, 3.15), (6.0, 4.2)
"""Largest rising threshold of a 74HC132, V, at its supply, V (data sheet of NXP, from memory)."""


def gate_threshold(wiring: Wiring) -> float:
    """Voltage (V) that the gate takes as high at the supply of its logic, whatever the chip."""
    return float(np.interp(wiring.known.reference, *np.array(GATE_HIGH).T))


def divider(wiring: Wiring, battery: Battery) -> float:
    """Ratio of the battery voltage to the voltage at the pin."""
    return 1 + upper_resistor(wiring, battery) / LOWER


def hall_slope(wiring: Wiring, limit: float) -> float:
    """Sensitivity of the Hall sensor, V/A: as wired, or the largest of `HALL` with a range above a limit, A.

    Raises:
        InputError: the range does not include the limit.
    """
    board = wiring.known
    largest = min(board.reference - wiring.current_zero, HALL_SPAN) / (CURRENT_RANGE * limit)
    sensors = HALL if wiring.shunt_V_per_A is None else (wiring.shunt_V_per_A,)
    slope = next((slope for slope in sensors if slope <= largest), None)
    if slope is None and wiring.measures_electrics:
        max_limit = largest * limit / sensors[-1]
        raise InputError(
            f"the sketch stops at {limit:.0f} A; for the {board.title} this must be at "
            f"most {max_limit:.0f} A (80 % of the range of a Hall sensor of {1e3 * sensors[-1]:g} "
            "mV/A), so that over-current is detected: lower peak_limit of the circuit"
        )
    return sensors[-1] if slope is None else slope


def pwm_frequency(wiring: Wiring, rig: Rig, requested: float | None = None) -> float:
    """PWM frequency (Hz) of the board nearest to the requested one; default the lowest that is safe.

    A low frequency has the smallest pulse loss. It is safe if a shorted switch leaves the tube of the rig below 650
    degC from 560 degC, with the cut-out of the rig. A built circuit, with a known current sensor, keeps its frequency.

    Raises:
        InputError: the board has no frequency within a factor of 2, or pulses of the rig lose a tenth of a period.
    """
    board = wiring.known
    if requested is None and rig.circuit.hall_sensitivity is not None:
        requested = rig.circuit.pwm_frequency
    frequency = board.frequencies[-1]
    if rig.tube is not None:
        for slow in reversed(board.frequencies):
            frequency = slow if short_rise(rig.tube, rig, slow) < SHORTED_LIMIT - HOT_TUBE else frequency
    if requested is not None:
        frequency = min(board.frequencies, key=lambda f: abs(math.log(f / requested)))
        if not 0.5 < frequency / requested < 2:
            known = " or ".join(f"{f:.4g}" for f in board.frequencies)
            raise InputError(f"pwm_Hz is {requested:.10g}; the sketch sets pulses of this board to {known} Hz")
    if rig.circuit.lost_on_time * frequency >= 0.1:
        raise InputError(
            f"lost_on_time of the circuit is {1e6 * rig.circuit.lost_on_time:g} us; at {frequency:.0f} Hz it must be "
            f"below {1e5 / frequency:.0f} us, a tenth of a period"
        )
    return frequency


def with_pulses(rig: Rig, tube: Tube, wiring: Wiring, requested: float | None = None) -> Rig:
    """Rig that heats a tube with the PWM frequency of its board, as `pwm_frequency`."""
    frequency = pwm_frequency(wiring, replace(rig, tube=tube), requested)
    return replace(rig, circuit=replace(rig.circuit, pwm_frequency=frequency))


# --- parts of a rig ---------------------------------------------------------------------------------------------------


FUSES = (5, 10, 15, 20, 25, 30, 40, 50, 60, 70, 80, 100, 125, 150, 175, 200)
"""Ratings of blade and bolt fuses (ISO 8820), A."""

CURRENT_DENSITY = 6.0
"""Largest continuous current of copper cables of some metres in free air, A/mm2 rms.

Assumed, on the safe side of IEC 60364-5-52 for single cores up to 25 mm2.
"""

CONTROL, COIL = 1.0, 0.5
"""Rating of the control fuse, and largest current of the coil of the cut-out when it pulls in, A."""

THIN = (0.25, 0.5)
"""Sections of the wires to the pins, and of those behind the control fuse, mm2 (IEC 60228; chosen for strength)."""

CABLES = (1.5, 2.5, 4, 6, 10, 16, 25, 35, 50)
"""Sections of stranded cables (IEC 60228), mm2."""


@dataclass(frozen=True)
class Part:
    """Electrical part of a rig."""

    name: Annotated[str, form("s", label="part"), "name of the part"]
    rating: Annotated[str, form("s", label="rating"), "required rating"]
    why: Annotated[str, form("s", label="why"), "reason for the rating"]


def root_mean_square(plan: HeatingPlan) -> float:
    """Largest root mean square current over 10 s, A, of the plan and of uncertain rigs: it heats cables and fuses."""
    courses = [plan.duty / COUNTS * plan.current**2]
    if plan.feedback is not None:  # corrections may last
        history = plan.feedback.history
        current = plan.current[np.minimum(history.index, len(plan.current) - 1)]
        courses += list((history.count / COUNTS * current**2).T)
    window = max(round(10.0 / plan.spec.slot), 1)
    means = (np.convolve(square, np.ones(window) / window, mode="valid") for square in courses)
    return math.sqrt(max(float(mean.max()) for mean in means))


def fuse_of(plan: HeatingPlan) -> float:
    """Rating of the fuse for the currents of a plan, A."""
    return next((size for size in FUSES if size >= MARGIN * root_mean_square(plan)), FUSES[-1])


def cable_of(plan: HeatingPlan) -> float:
    """Section of the copper cables for the currents of a plan, mm2: they must outlive the fuse."""
    largest = max(MARGIN * root_mean_square(plan), fuse_of(plan))
    return next((size for size in CABLES if CURRENT_DENSITY * size >= largest), CABLES[-1])


def shared_parts(plans: Mapping[int, HeatingPlan], wiring: Wiring) -> tuple[Part, ...]:
    """Parts of one circuit that heats several tubes, by their numbers.

    A part that every tube has for itself has the ratings of all.
    """
    lists = {number: parts_list(plan, wiring, tuple(plans.values())) for number, plan in plans.items()}
    shared = []
    for parts in zip(*lists.values(), strict=True):
        ratings = dict(zip(lists, (part.rating for part in parts), strict=True))
        one = parts[0].rating
        if len(set(ratings.values())) > 1:
            one = "; ".join(f"tube {number}: {rating}" for number, rating in ratings.items())
        shared.append(replace(parts[0], rating=one))
    return tuple(shared)


def clamped_energy(current: float, battery: float, clamp: float) -> float:
    """Energy (J) that a TVS diode takes as a switch opens: that of the loop, and what the battery adds meanwhile.

    With resistance R = battery / current the loop has L i' = battery - R i - clamp. The energy is the integral of
    clamp i.

    Args:
        current: at the opening, A. battery, clamp: voltages, V; the clamp has the larger one.
    """
    a = battery / clamp
    return LOOP_INDUCTANCE * current**2 * (1 / a + (1 - a) / a**2 * math.log1p(-a))


COIL_ZENERS = 24.0, 18.0, 15.0, 12.0, 10.0, 6.8, 5.1
"""Voltages of Zener diodes across a coil, V: the larger, the faster the contactor opens."""


def coil_zener(transistor: float, charged: float) -> float:
    """Voltage (V) of the Zener diode across a coil: with supply and diode below 90 % of the coil's transistor."""
    supply = charged if charged <= MOST_COIL else 12.0
    return next((zener for zener in COIL_ZENERS if supply + zener + 1 <= 0.9 * transistor), COIL_ZENERS[-1])


def parts_list(plan: HeatingPlan, wiring: Wiring, plans: Sequence[HeatingPlan] = ()) -> tuple[Part, ...]:
    """Parts between battery and tube, rated for the plan's currents and a shorted switch, and those of the board.

    Args:
        plans: heatings of all tubes of the circuit. Ratings are the largest of them. Only fuse, thermal cut-out and
            thermometer are those of `plan`.
    """
    rig, safety, plans = plan.rig, cut_out(plan), (plan, *plans)
    short = CHARGED * rig.battery.open_circuit[-1][1] / rig.battery.internal_resistance
    rms, peak = max(map(root_mean_square, plans)), max(cut_out(each).current for each in plans)
    rest, circuit = rig.battery.voltage, rig.circuit
    fuse, cable = fuse_of(plan), max(map(cable_of, plans))
    # In parallel each has a part of the current, so that all together warm by less.
    many = next(n for n in itertools.count(1) if (rms / n) ** 2 * circuit.mosfet_resistance <= MOSFET_HEAT)
    heat, rated = (rms / many) ** 2 * circuit.mosfet_resistance, math.ceil(MARGIN * peak / 10) * 10
    current = f"{rms:.0f} A rms, {peak:.0f} A while on"
    board = wiring.known
    module = (
        f"for {board.reference:g} V, fed by the board; its minus leg (magnetic) at T-; CS {board.pin('select')}, "
        f"CLK {board.pin('clock')}, DO {board.pin('data')}"
    )
    wires = 1e3 * (rig.mold.wire or WIRE)
    couple = f"thermocouple type K {wires:g} mm, butt-welded, its junction insulated"
    sensor = {
        "max31855": f"{couple}, with MAX31855 on a module {module}",
        "max6675": f"{couple}, with MAX6675 on a module {module}",
        "analog": f"0 to {board.reference:g} V line of a camera or amplifier",
    }[wiring.converter]
    charged = CHARGED * rig.battery.open_circuit[-1][1]
    voltage, standoff = math.ceil(2.5 * rest / 10) * 10, math.ceil(charged)
    resistance = 1e3 * circuit.mosfet_resistance
    reference, ratio = board.reference, divider(wiring, rig.battery)
    upper = f"{upper_resistor(wiring, rig.battery) / 1e3:g}"
    limit = max(stop_current(each.tube, each.rig) for each in plans)
    slope = hall_slope(wiring, limit)
    low_volt = reference < 5
    hall = f"Hall, {HALL_SPAN / slope:.0f} A, {1e3 * slope:g} mV/A, {wiring.current_zero:g} V at no current; at 5 V of "
    hall += "the supply, ground at the board"
    # A sensor of 5 V gives up to 5 V in a short.
    hall += f"; 1 kohm to the pin, Schottky diode from there to {reference:g} V, bar there" if low_volt else ""
    logic = f"5 V regulator for the board (pin {board.feed})"
    logic += ", its 3.3 V for the logic" if low_volt else " and the logic"
    logic += f", {COIL:g} A, 100 uF at its input"
    driving = "battery" if charged <= MOST_COIL else "12 V regulator"
    clamp = math.ceil((plan.clamp_temperature.max() + CLAMP_RESERVE) / 10) * 10
    avalanche = 0.5 * LOOP_INDUCTANCE * peak**2
    clamped = clamped_energy(peak, rig.battery.open_circuit[-1][1], standoff)
    clamped_heat = clamped * circuit.pwm_frequency
    monostable = 1e3 * MONOSTABLE_PERIODS / circuit.pwm_frequency
    timing = timing_resistor(wiring, circuit.pwm_frequency)
    battery, clamps = rig.battery, rig.clamps
    metal = ", as aluminium" if 850 <= clamps.heat_capacity <= 950 else ""
    flexible = f"slides by {max(each.growth for each in plans) * TO_MM:.1f} mm and more"
    diode_at = (
        "from the 5 V regulator to VSYS (the board has its own from USB)"
        if board.name == "pico"
        else ("in its 5 V line towards the board")
    )
    return (
        Part("battery", f"{battery.chemistry.replace('_', '-')}, {battery.capacity / 3600:g} Ah, "
             f"{1e3 * battery.internal_resistance:g} mohm and {1e3 * battery.sag_resistance:g} more after "
             f"{battery.sag_time:g} s, {battery.open_circuit[-1][1]:.1f} V when full",
             "as in the rig file: another one needs another plan"),
        Part("clamps", f"2, {1e3 * clamps.mass:g} g each with body and lug, {1e4 * clamps.area:g} cm2 in air, of "
             f"{clamps.heat_capacity:g} J/(kg K){metal}; a flexible lead to the sliding one",
             f"as in the rig file; the sliding one {flexible}"),
        Part("fuse", f"{fuse} A, fast (gR), at the battery's plus; pre-arcing I2t of at least "
             f"{upward(safety.least_melting)} A2s, or pulses of {safety.current:.0f} A age it; breaks "
             f"{math.ceil(short / 1e3)} kA at {math.ceil(charged)} V DC",
             f"{root_mean_square(plan):.0f} A rms, {safety.current:.0f} A while on; backs up the cut-out: "
             f"{safety.withstood:.0f} A2s ({math.floor(1e3 * safety.budget)} ms of a short) "
             "take the tube to 650 degC"),
        Part("main switch", f"battery isolator, lockable, {rated} A DC, behind the fuse",
             "cuts tube, cut-out and board off for work on the rig"),
        Part("control fuse", f"{CONTROL:g} A, at the lug of the main switch, in the wire to the supply",
             f"thin wires do not survive {fuse} A"),
        Part("supply", f"{logic}; {driving} for driver and coil; behind the control fuse",
             "USB alone drives neither coil nor gate"),
        Part("cut-out", f"contactor, normally open, {rated} A DC; coil 12 V, at most {COIL:g} A at pull-in, no "
             f"economizer. It opens within {1e3 * circuit.cutout_opening:g} ms, measured with a Zener diode of "
             f"{coil_zener(voltage, charged):g} V, 5 W, across the coil in series with a diode: bars together, Zener "
             "at the coil's plus",
             f"shorted switch: tube at {safety.peak:.0f} degC after {math.ceil(1e3 * safety.delay)} ms, 650 degC after "
             f"{math.floor(1e3 * safety.budget)} ms"),
        Part("monostable", f"{monostable:.3g} ms (74HC123, +-20 %): {timing / 1e3:g} kohm, "
             f"{1e9 * TIMING_CAPACITOR:g} nF film, 1N4148 from pin 15 to 16, bar at 16; at {reference:g} V; 100 nF "
             "from pin 16 to 8",
             "a shorted switch keeps the drain low, a dead board sends no tick: both open the cut-out"),
        Part("gate", f"74HC132 at {reference:g} V, of {board.pin('tick')} and the drain; 10 kohm at the drain's lug, "
             f"Schottky diode (BAT54) from its input to {reference:g} V, bar there; 10 kohm from the tick to ground; "
             "100 nF from pin 14 to 7",
             "retriggers the monostable while the drain is high; a board in reset sends no tick; above "
             f"{gate_threshold(wiring):.2f} V every chip reads high"),
        Part("coil switch", f"transistor, on at {2.5 if low_volt else 4.5:g} V of gate, {voltage} V, {CONTROL:g} A, "
             "10 kohm from gate to source, between coil and ground",
             "the monostable drives no coil; without it the coil is off"),
        Part("pull-up", f"1 kohm, {math.ceil(charged**2 / 500) / 2:g} W, across the open cut-out",
             "the drain is high before the cut-out closes, unless the switch is shorted"),
        Part("thermal cut-out", f"normally closed, {clamp} degC{', with a capillary' if clamp > MOST_BIMETAL else ''}, "
             "on the fixed clamp, in the supply of the cut-out",
             f"clamps reach {plan.clamp_temperature.max():.0f} degC"),
        Part("emergency stop", "normally closed, in the supply of the cut-out; second contact normally closed, from "
             f"{board.pin('stop')} to ground: open is a stop",
             "stops without the board too"),
        Part("cable", f"{cable:g} mm2 copper, as short as can be; crimped and bolted lugs, no plugs", current),
        Part("thin wires", f"{THIN[1]:g} mm2 behind the control fuse, {THIN[0]:g} mm2 to the pins, twisted with "
             "their ground; driver to gate at most 10 cm",
             f"{CONTROL:g} A at {CURRENT_DENSITY:g} A/mm2 need {CONTROL / CURRENT_DENSITY:.2f} mm2"),
        Part("MOSFET", f"{'' if many == 1 else f'{many} in parallel, each '}{voltage} V, {rated} A, logic level, gate "
             f"+-20 V, at most {resistance:g} mohm, avalanche {digits(1e3 * MARGIN * avalanche)} mJ",
             f"{peak:.0f} A while on; warms by {heat:.1f} W, up to {MOSFET_HEAT:g} W need no heat sink"),
        Part("TVS diode", f"{standoff} V standoff, clamps below {voltage} V, at least "
             f"{math.ceil(peak * voltage / 100) / 10:g} kW (10/1000 us) and "
             f"{math.ceil(2 * MARGIN * clamped_heat) / 2:g} W continuous on copper, at the MOSFET's lugs",
             f"{peak:.0f} A at up to {voltage} V; cables of {1e6 * LOOP_INDUCTANCE:g} uH and battery give it at most "
             f"{digits(1e3 * clamped)} mJ a pulse: {digits(clamped_heat)} W on average"
             + (f", more than {TVS_HEAT:g} W: slower pulses, or a supply of less voltage"
                if clamped_heat > TVS_HEAT else "")),
        Part("gate driver", f"2 A or more, inputs for {reference:g} V logic, 10 kohm from input to ground; "
             "10 ohm to the gate, 10 kohm from gate to "
             "source, 1 uF at its supply",
             "without signal the switch must stay off"),
        Part("diode", f"Schottky, {voltage} V, {math.ceil(peak / 10) * 10} A of pulse, across the tube",
             "the loop's inductance"),
        Part("reverse polarity", "diode in the supply of cut-out and board",
             "a reversed battery does not close the cut-out"),
        Part("current sensor", hall, f"{current}; the board stops at {stop_current(plan.tube, rig):.0f} A"),
        Part("divider", f"{upper} kohm, at the wire behind the cut-out, {LOWER / 1e3:g} kohm and 1 nF to ground",
             f"1 : {ratio:g}, {rest:.1f} V at rest are {rest / ratio:.2f} of {reference:g} V"),
        Part("thermometer", sensor, f"at the middle of the curved part, which is at {rest:.1f} V between pulses"),
        Part("isolation", f"USB isolator between computer and board, a Schottky diode {diode_at}",
             "the battery's minus is the board's ground; two supplies of 5 V meet at the board"),
        Part("board", ", ".join(filter(None, (board.title, board.core))), "runs the sketch"),
    )  # fmt: skip
