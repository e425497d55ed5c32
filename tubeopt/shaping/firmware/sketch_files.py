"""The sketch that runs a law on a board: sources that are the same for all, and two headers of numbers."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np

from ...files.files import write_text
from ...typing import Array
from ..heating.controller import Feedback, HeatingLaw
from ..heating.counts import full_current
from ..heating.plan import HeatingPlan, slot_milliseconds
from ..heating.rig import COUNTS, Rig
from ..heating.robust import at_charge, prolonged
from .boards import CONVERTERS, Wiring, divider, hall_slope

NAME = "tube_heater"
SOURCES = (
    "heater.h", "heater.cpp", "hardware.h", "converter.h", "hardware_avr.cpp", "hardware_arduino.cpp", f"{NAME}.ino",
)  # fmt: skip
HOST = "host.cpp"
"""The board in place of a board, for tests on a computer."""

CENTS, TENTHS = 100, 10
"""Steps of a count, and of a kelvin, in the tables."""

COLDEST = -50.0
"""degC, zero of the table of temperatures."""

TICK = 0.1
"""Time between two looks at what must never be, s, at most."""

OVERSHOOT = 8.0
"""Reading above the limit, K, at which the firmware stops."""

LEAKING, LEAKING_STEPS = 4.0, 3
"""Current beside the pulses, A, above which the switch is stuck; and so many steps of the converter at least."""

STUCK_RISE, STUCK_MS = 3.0, 300
"""A reading that did not move for so long, ms, while the schedule rose by so much, K, is of a thermometer that lost
touch: longer than a conversion takes, and more than the steps of a converter."""

CHARGES = (1.0, 0.8, 0.6)
"""States of charge for which the sketch holds a schedule; the sensor's law sees to what lies between."""


def tabled(law: HeatingLaw) -> HeatingLaw:
    """The law with the numbers that the tables of the sketch hold."""
    return replace(
        law,
        planned=np.round(law.planned * CENTS) / CENTS,
        reference=np.round((law.reference - COLDEST) * TENTHS) / TENTHS + COLDEST,
    )


def _float(value: float) -> str:
    """A number as a literal of C++."""
    return f"({float(f'{value:.8g}')!r}f)"


def _rows(name: str, values: Array) -> str:
    numbers = [str(int(value)) for value in values]
    lines = [", ".join(numbers[k : k + 16]) for k in range(0, len(numbers), 16)]
    body = ",\n".join(f"    {line}" for line in lines)
    return f"static const uint16_t {name}[{len(numbers)}] PROGMEM = {{\n{body}}};\n"


def schedule_header(plan: HeatingPlan, feedback: Feedback, tables: Sequence[tuple[float, Array]]) -> str:
    """schedule.h.   tables: voltage at rest, V, and counts of effect (T,) of each, the fullest battery first."""
    law = tabled(feedback.law)
    slot = slot_milliseconds(law.slot)
    ticks = next(n for n in range(math.ceil(law.slot / TICK), slot + 1) if slot % n == 0)
    numbers = _numbers(plan, feedback, slot, ticks, len(tables))
    body = "".join(_rows(f"PLANNED_{k}", np.round(planned * CENTS)) for k, (_, planned) in enumerate(tables))
    body += _rows("REFERENCE", np.round((law.reference - COLDEST) * TENTHS))
    volts = ", ".join(f"{volt:.3f}f" for volt, _ in tables)
    names = ", ".join(f"PLANNED_{k}" for k in range(len(tables)))
    lines = "".join(f"#define {name} {value}\n" for name, value in numbers.items())
    mark = hashlib.sha256((lines + body).encode()).hexdigest()[:12]
    return f"""// Schedule and limits of one tube on one rig: {plan.rig.name or "rig"}.
// Times in ms, temperatures in degC, currents in A. Planned counts in 1/{CENTS}; temperatures of reference in
// 1/{TENTHS} K above {COLDEST:g} degC.
#ifndef SCHEDULE_H
#define SCHEDULE_H

#include <stdint.h>
#ifdef __AVR__
#include <avr/pgmspace.h>
#define TABLE_ENTRY(table, k) pgm_read_word(&(table)[k])
#else
#ifndef PROGMEM
#define PROGMEM
#endif
#define TABLE_ENTRY(table, k) ((table)[k])
#endif

#define SCHEDULE_ID "{mark}"
{lines}
{body}
static const uint16_t *const PLANNED[TABLES] = {{{names}}};
static const float VOLTS[TABLES] = {{{volts}}};

static inline float voltage_of(uint8_t table) {{ return VOLTS[table]; }}
static inline float planned_at(uint8_t table, uint16_t k) {{ return TABLE_ENTRY(PLANNED[table], k) / {CENTS}.0f; }}
static inline float reference_at(uint16_t k) {{
  return TABLE_ENTRY(REFERENCE, k < SLOTS ? k : SLOTS - 1) / {TENTHS}.0f + {COLDEST:.1f}f;
}}

#endif
"""


def _numbers(plan: HeatingPlan, feedback: Feedback, slot: int, ticks: int, tables: int) -> dict[str, str]:
    """What schedule.h defines: the law, and where it must stop."""
    law, rig, sensor = tabled(feedback.law), plan.rig, feedback.sensor
    first, _ = law.hold
    full = full_current(plan.tube, rig)
    sagging = rig.battery.internal_resistance + rig.battery.sag_resistance
    lowest = rig.battery.open_circuit[0][1] - sagging * full
    return {
        "SLOTS": f"{len(law.planned)}u",
        "WINDOW_LOW": str(round(plan.spec.window_degC[0])),
        "WINDOW_HIGH": str(round(plan.spec.window_degC[1])),
        "HOLD_FIRST": f"{first}u",
        "SLOT_MS": f"{slot}u",
        "TICKS_PER_SLOT": f"{ticks}u",
        "TICK_MS": f"{slot // ticks}u",
        "TABLES": f"{tables}u",
        "PROPORTIONAL": _float(law.proportional),
        "INTEGRAL": _float(law.integral),
        "SHARE": _float(law.share),
        "HOLDBACK": _float(law.holdback),
        "PATIENCE_MS": f"{round(1000 * law.patience)}ul",
        "LONGEST_MS": f"{round(1000 * law.longest)}ul",
        "LOST": _float(law.lost),
        "TOO_HOT": _float(plan.spec.limit + OVERSHOOT),
        "LOWEST_READING": _float(sensor.lowest),
        "HIGHEST_READING": _float(sensor.highest),
        "START_BELOW": "80.0f",
        "STUCK_WITHIN": _float(max(0.5 * sensor.quantum, 0.02)),
        "STUCK_RISE": _float(max(STUCK_RISE, 8 * sensor.quantum)),
        "STUCK_MS": f"{STUCK_MS}ul",
        "STUCK_HOLDING_MS": "20000ul",
        "MOST_AMPERE": _float(rig.circuit.peak_limit),
        "LEAST_AMPERE": _float(0.3 * full),
        "LOWEST_VOLT": _float(lowest),
    }


def board_header(wiring: Wiring, rig: Rig) -> str:
    """board.h: pins, frequency, and how the board measures."""
    board, frequency = wiring.known, rig.circuit.pwm_frequency
    volt = board.reference / board.steps
    prescaler = min((1024, 256, 64), key=lambda p: abs(16e6 / p / 510 - frequency))
    ampere = volt / hall_slope(wiring, rig.circuit)
    numbers = {
        "SENSOR": f"SENSOR_{wiring.converter.upper()}",
        "SENSOR_MS": str(CONVERTERS[wiring.converter]),
        "MEASURES_ELECTRICS": str(int(wiring.measures_electrics)),
        "PWM_HZ": f"{frequency:.2f}f",
        "PWM_PRESCALER": str(prescaler),
        "VOLT_PER_STEP": _float(volt * divider(wiring, rig.battery)),
        "AMPERE_PER_STEP": _float(ampere),
        "AMPERE_ZERO": f"{round(wiring.current_zero / volt)}",
        "LEAKING_AMPERE": _float(max(LEAKING, LEAKING_STEPS * ampere)),
        "ANALOG_ZERO": _float(wiring.analog_low),
        "ANALOG_PER_STEP": _float(wiring.analog_per_volt * volt),
        "ANALOG_STEPS": str(board.steps),
    } | {f"PIN_{name.upper()}": pin for name, pin in board.pins.items()}
    lines = "".join(f"#define {name} {value}\n" for name, value in numbers.items())
    return f"""// {board.title}: pins and measurements.
#ifndef BOARD_H
#define BOARD_H

#define SENSOR_MAX31855 1
#define SENSOR_MAX6675 2
#define SENSOR_ANALOG 3

{lines}
#endif
"""


def schedules(plan: HeatingPlan, feedback: Feedback) -> list[tuple[float, Array]]:
    """Voltage at rest and counts of effect for several states of charge, the fullest battery first."""
    law, lost = feedback.law, COUNTS * plan.rig.circuit.lost_share
    found = [(plan.rig.battery.voltage, law.planned)]
    for charge in sorted({c for c in CHARGES if c < plan.rig.battery.state_of_charge - 0.05}, reverse=True):
        other = at_charge(plan, charge)
        found.append((other.rig.battery.voltage, np.maximum(prolonged(other, len(law.planned)) - lost, 0.0)))
    return found


def write_sketch(
    plan: HeatingPlan, feedback: Feedback, wiring: Wiring, directory: Path, *, host: bool = False
) -> list[Path]:
    """Write the sketch into `directory`/tube_heater; return the paths.

    The pulses have the frequency of the plan's rig: it must be one that the board has.

    Args:
        host: also host.cpp, with which it runs on a computer.

    Raises:
        InputError: the slot is no whole number of milliseconds, or pulses lose too much.
    """
    folder = directory / NAME
    texts = {
        "schedule.h": schedule_header(plan, feedback, schedules(plan, feedback)),
        "board.h": board_header(wiring, plan.rig),
    }
    sketch = resources.files(__package__) / "sketch"
    for name in (*SOURCES, *((HOST,) if host else ())):
        texts[name] = (sketch / name).read_text(encoding="utf-8")
    for name, text in texts.items():
        write_text(folder / name, text)
    return [folder / name for name in texts]
