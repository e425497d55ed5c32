"""Boards that can run the firmware, and how they measure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from ...errors import InputError, choice
from ...files.marks import POSITIVE, OneOf, check_fields, key, unit
from ..heating.rig import Battery, Circuit, Rig

CONVERTERS = ("max31855", "max6675", "analog")
"""Converter of a thermocouple, or an analog line such as a camera's."""

READS = {"thermocouple": ("max31855", "max6675"), "camera": ("analog",)}
"""Sensor -> converters with which the sketch reads it, the usual one first. It reads no temperature from resistance."""

CONVERSION_MS = {"max31855": 125, "max6675": 250, "analog": 20}
"""Least time between two readings, ms: data sheets of Maxim, 100 and 220 ms at most, and what is left to be sure."""

LOWER = 10e3
"""Resistor of the divider from the pin to ground, ohm: whatever is above it, the pin sees less than the 10 kohm that
the ATmega's converter wants of a source (data sheet of the ATmega328P)."""

SURPLUS = 1.5
"""Greatest voltage that can be read, as a multiple of a full battery's at rest: for chargers and peaks of switching,
and as the ESP32's converter is straight up to about three quarters of its reference."""

HALL = (0.04, 0.02, 0.01, 0.008, 0.005, 0.004, 0.002)
"""Volt per ampere of Hall sensors that are sold for 100 to 2000 A, whose line rises by 4 V."""

READABLE = 1.2
"""Greatest current that can be read, at least, as a multiple of the one at which the sketch stops."""

E24 = (
    1.0, 1.1, 1.2, 1.3, 1.5, 1.6, 1.8, 2.0, 2.2, 2.4, 2.7, 3.0, 3.3, 3.6, 3.9, 4.3, 4.7, 5.1, 5.6, 6.2, 6.8, 7.5, 8.2,
    9.1,
)  # fmt: skip
"""Resistors of a decade (IEC 60063)."""


@dataclass(frozen=True)
class Board:
    """A board: how its core is called, its PWM frequencies (Hz), the steps and the reference (V) of its converter, and
    what its pins are called: gate, stop button, chip select, voltage, current, analog temperature."""

    name: str
    title: str
    frequencies: tuple[float, ...]
    steps: int
    reference: float
    pins: dict[str, str]


AVR_PINS = {"gate": "9", "stop": "2", "select": "10", "voltage": "A0", "current": "A1", "temperature": "A2"}
ATMEGA = (16e6 / 1024 / 510, 16e6 / 256 / 510)
"""Of timer 1, phase-correct in 8 bits; a third, 490 Hz, loses more of every pulse to the loop's inductance."""

BOARDS = {
    "uno": Board("uno", "Arduino Uno", ATMEGA, 1024, 5.0, AVR_PINS),
    "nano": Board("nano", "Arduino Nano", ATMEGA, 1024, 5.0, AVR_PINS),
    "esp32": Board(
        "esp32", "ESP32", (31.0, 122.0), 4096, 3.3,
        {"gate": "25", "stop": "27", "select": "5", "voltage": "34", "current": "35", "temperature": "32"},
    ),
    "pico": Board(
        "pico", "Raspberry Pi Pico", (122.0,), 1024, 3.3,
        {"gate": "15", "stop": "14", "select": "17", "voltage": "26", "current": "27", "temperature": "28"},
    ),
}  # fmt: skip
"""By their names. The Pico's core has no PWM below 100 Hz."""


@dataclass(frozen=True)
class Wiring:
    """How a board is connected.

    Raises:
        InputError: a value is out of its range, or no board of this name.
    """

    board: Annotated[str, OneOf(tuple(BOARDS)), "which board"] = "uno"
    converter: Annotated[str, OneOf(CONVERTERS), "what reads the thermometer"] = "max31855"
    measures_electrics: Annotated[bool, "whether battery voltage and current are wired to it"] = True
    shunt_V_per_A: Annotated[
        float | None,
        POSITIVE,
        "volt at the pin per ampere, of a Hall sensor; by default what the circuit's limit asks for",
    ] = None
    current_zero: Annotated[float, unit("V"), "at the pin without current"] = 0.5
    analog_low: Annotated[float, key("analog_low_degC"), "temperature at 0 V of an analog line"] = 0.0
    analog_per_volt: Annotated[float, key("analog_per_volt_K"), POSITIVE, "rise of an analog line per volt"] = 200.0

    def __post_init__(self) -> None:
        check_fields(self, "the wiring")

    @property
    def known(self) -> Board:
        """The board."""
        return BOARDS[self.board]


def converter_for(sensor: str, wanted: str | None = None) -> str:
    """The converter with which the sketch reads a sensor: `wanted`, or the usual one.

    Raises:
        InputError: the sketch does not read such a sensor, or not by the converter that is wanted.
    """
    if sensor not in READS:
        raise InputError(
            f"sensor is {sensor!r}; for a sketch it must be one of {', '.join(READS)}; what it would make of the "
            "heating tells plan_heating(..., sensor=) in Python"
        )
    return READS[sensor][0] if wanted is None else choice(f"converter of a {sensor}", wanted, READS[sensor])


def upper_resistor(wiring: Wiring, battery: Battery) -> float:
    """Resistor of the divider from the battery to the pin, ohm: the least of E24 with which `SURPLUS` times the voltage
    of the full battery is no more than the board's reference; 1 kohm or more."""
    _, full = battery.open_circuit[-1]
    least = max(LOWER * (SURPLUS * full / wiring.known.reference - 1), 1e3)
    decade = 10.0 ** math.floor(math.log10(least))
    return next(value * decade for value in (*E24, 10.0) if value * decade >= least)


def divider(wiring: Wiring, battery: Battery) -> float:
    """Voltage of the battery per volt at the pin."""
    return 1 + upper_resistor(wiring, battery) / LOWER


def hall_slope(wiring: Wiring, circuit: Circuit) -> float:
    """Volt per ampere of the Hall sensor: as wired, or the greatest of `HALL` with which the over-current limit, times
    `READABLE`, is no more than the board's reference.

    Raises:
        InputError: the limit cannot be read: by the sensor as wired, or by any.
    """
    board, limit = wiring.known, circuit.peak_limit
    steepest = (board.reference - wiring.current_zero) / (READABLE * limit)
    wired = HALL if wiring.shunt_V_per_A is None else (wiring.shunt_V_per_A,)
    found = next((slope for slope in wired if slope <= steepest), None)
    if found is None and wiring.measures_electrics:
        most = steepest * limit / wired[-1]
        raise InputError(
            f"peak_limit of the circuit is {limit:g} A; for the {board.title} it must be at most {most:.0f} A, what it "
            f"reads of a Hall sensor of {1e3 * wired[-1]:g} mV/A with a fifth to spare: above that no over-current "
            "would be seen"
        )
    return wired[-1] if found is None else found


def pwm_frequency(wiring: Wiring, rig: Rig, wanted: float | None = None) -> float:
    """The frequency (Hz) of the board that is nearest to `wanted`; by default the lowest, which loses least of a pulse.

    Raises:
        InputError: `wanted` is more than twice or less than half of that, or pulses of the rig lose a tenth of a period
            or more even so.
    """
    board = wiring.known
    found = board.frequencies[0]
    if wanted is not None:
        found = min(board.frequencies, key=lambda f: abs(math.log(f / wanted)))
        if not 0.5 < found / wanted < 2:
            known = " or ".join(f"{f:.4g}" for f in board.frequencies)
            raise InputError(f"pwm_Hz is {wanted:.10g}; the sketch sets pulses of this board to {known} Hz")
    if rig.circuit.lost_on_time * found >= 0.1:
        raise InputError(
            f"lost_on_time of the circuit is {1e6 * rig.circuit.lost_on_time:g} us; at {found:.0f} Hz it must be below "
            f"{1e5 / found:.0f} us, a tenth of a period"
        )
    return found
