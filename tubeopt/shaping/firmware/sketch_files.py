"""Files of the sketch that runs a control law on a board: fixed sources, and two generated headers."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np

from ...constants import ZERO_CELSIUS
from ...files.files import write_text
from ...typing import Array
from ..heating.controller import HALF, MOST_COUNT, Feedback, HeatingLaw
from ..heating.counts import full_current
from ..heating.cutout import cut_out, stop_current
from ..heating.plan import HeatingPlan, slot_milliseconds
from ..heating.rig import COUNTS
from ..heating.robust import at_charge, prolonged
from .boards import CONVERTERS, Wiring, divider, hall_slope

NAME = "tube_heater"
SOURCES = (
    "heater.h", "heater.cpp", "hardware.h", "converter.h", "hardware_avr.cpp", "hardware_arduino.cpp", f"{NAME}.ino",
)  # fmt: skip
HOST = "host.cpp"
"""Simulated board, for tests on a computer."""

CENTS, TENTHS = 100, 10
"""Steps per count, and per kelvin, in the tables."""

COLDEST = -50.0
"""Zero of the table of temperatures, degC."""

TICK = 0.1
"""Longest time between two checks of the safety limits, s."""

LEAKING, LEAKING_STEPS = 4.0, 3
"""Current between pulses above which the switch counts as stuck, A; at least so many steps of the converter."""

STUCK_RISE, STUCK_MS = 3.0, 300
"""Rise of the schedule, K, and time, ms, after which a thermometer with a constant reading counts as detached.

More than the resolution of a converter, and longer than a conversion.
"""

CHARGES = (1.0, 0.8, 0.6)
"""States of charge with a schedule in the sketch; between them the feedback corrects."""


def tabled(law: HeatingLaw) -> HeatingLaw:
    """Law with its numbers rounded as in the tables of the sketch."""
    return replace(
        law,
        planned=np.round(law.planned * CENTS) / CENTS,
        reference=np.round((law.reference - COLDEST) * TENTHS) / TENTHS + COLDEST,
    )


def _float(value: float) -> str:
    """Number as a C++ literal."""
    return f"({float(f'{value:.8g}')!r}f)"


def _rows(name: str, values: Array) -> str:
    numbers = [str(int(value)) for value in values]
    lines = [", ".join(numbers[k : k + 16]) for k in range(0, len(numbers), 16)]
    body = ",\n".join(f"    {line}" for line in lines)
    return f"static const uint16_t {name}[{len(numbers)}] PROGMEM = {{\n{body}}};\n"


def schedule_header(
    plan: HeatingPlan, feedback: Feedback, tables: Sequence[tuple[float, Array]], fault: str = ""
) -> str:
    """Text of schedule.h: tables, law and safety limits.

    Args:
        tables: voltage at rest, V, and effective counts (T,) of each, the fullest battery first.
        fault: reason not to run the plan, for its top.
    """
    law, rig, sensor = tabled(feedback.law), plan.rig, feedback.sensor
    slot, ambient = slot_milliseconds(law.slot), rig.ambient - ZERO_CELSIUS
    ticks = next(n for n in range(math.ceil(law.slot / TICK), slot + 1) if slot % n == 0)
    full = full_current(plan.tube, rig)
    sagging = rig.battery.internal_resistance + rig.battery.sag_resistance
    numbers = {
        "SLOTS": f"{len(law.planned)}u",
        "WINDOW_LOW": str(round(plan.spec.window_degC[0])),
        "WINDOW_HIGH": str(round(plan.spec.window_degC[1])),
        "HOLD_FIRST": f"{law.hold[0]}u",
        "SLOT_MS": f"{slot}u",
        "TICKS_PER_SLOT": f"{ticks}u",
        "TICK_MS": f"{slot // ticks}u",
        "TABLES": f"{len(tables)}u",
        "PROPORTIONAL": _float(law.proportional),
        "INTEGRAL": _float(law.integral),
        "SHARE": _float(law.share),
        "BARE_COUNT": _float(min(law.bare_count, MOST_COUNT - law.lost)),
        "MOST_COUNT": f"{MOST_COUNT}u",
        "HALF": _float(HALF),
        "HOLDBACK": _float(law.holdback),
        "HOLD_FLOOR": _float(law.floor),
        "PATIENCE_MS": f"{round(1000 * law.patience)}ul",
        "LONGEST_MS": f"{round(1000 * law.longest)}ul",
        "LOST": _float(law.lost),
        "TOO_HOT": _float(law.ceiling),
        # By the reference before rounding, as the readings of the law: a thousandth of a kelvin adds up in `owed`.
        "CORRECTION": _float(sensor.correction / (float(feedback.law.reference.max()) - ambient)),
        "CORRECTED_FROM": _float(ambient),
        "LOWEST_READING": _float(sensor.lowest),
        "HIGHEST_READING": _float(sensor.highest),
        "START_BELOW": "80.0f",
        "STUCK_WITHIN": _float(max(0.5 * sensor.quantum, 0.02)),
        "STUCK_RISE": _float(max(STUCK_RISE, 8 * sensor.quantum)),
        "STUCK_MS": f"{STUCK_MS}ul",
        "STILL_MS": "700ul",
        "STUCK_HOLDING_MS": "20000ul",
        "MOST_AMPERE": _float(stop_current(plan.tube, rig)),
        "LEAST_AMPERE": _float(0.3 * full),
        "TEST_COUNT": "2u",
        "TEST_TICKS": "3u",
        "CUTOUT_MS": f"{math.floor(1000 * cut_out(plan).budget)}u",
        "LOWEST_VOLT": _float(rig.battery.open_circuit[0][1] - sagging * full),
    }
    body = "".join(_rows(f"PLANNED_{k}", np.round(planned * CENTS)) for k, (_, planned) in enumerate(tables))
    body += _rows("REFERENCE", np.round((law.reference - COLDEST) * TENTHS))
    volts = ", ".join(f"{volt:.3f}f" for volt, _ in tables)
    names = ", ".join(f"PLANNED_{k}" for k in range(len(tables)))
    lines = "".join(f"#define {name} {value}\n" for name, value in numbers.items())
    mark = hashlib.sha256((lines + body).encode()).hexdigest()[:12]
    return (f"// DO NOT RUN: {fault}\n#warning DO NOT RUN this heating: see schedule.h\n" if fault else "") + (
        f"""// Schedule and limits of one tube on one rig: {plan.rig.name or "rig"}.
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
    )


def board_header(wiring: Wiring, plan: HeatingPlan) -> str:
    """Text of board.h: pins, PWM frequency and measurements."""
    rig, board, frequency = plan.rig, wiring.known, plan.rig.circuit.pwm_frequency
    volt = board.reference / board.steps
    prescaler = min((1024, 256, 64), key=lambda p: abs(16e6 / p / 510 - frequency))
    ampere = volt / hall_slope(wiring, stop_current(plan.tube, rig))
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
    """Battery voltage at rest and PWM counts of the schedule for states of charge, the fullest battery first."""
    law, lost = feedback.law, COUNTS * plan.rig.circuit.lost_share
    tables = [(plan.rig.battery.voltage, law.planned)]
    for charge in sorted({c for c in CHARGES if c < plan.rig.battery.state_of_charge - 0.05}, reverse=True):
        scaled = at_charge(plan, charge)
        tables.append((scaled.rig.battery.voltage, np.maximum(prolonged(scaled, len(law.planned)) - lost, 0.0)))
    return tables


def write_sketch(
    plan: HeatingPlan, feedback: Feedback, wiring: Wiring, directory: Path, *, host: bool = False, fault: str = ""
) -> list[Path]:
    """Write the sketch into `directory`/tube_heater and return the paths.

    The PWM frequency is that of the plan's rig: the board must support it.

    Args:
        host: also write host.cpp, which runs the sketch on a computer. fault: reason not to run the plan.

    Raises:
        InputError: the slot is no whole number of milliseconds, or the pulse loss is too large.
    """
    folder = directory / NAME
    texts = {
        "schedule.h": schedule_header(plan, feedback, schedules(plan, feedback), fault),
        "board.h": board_header(wiring, plan),
    }
    sketch = resources.files(__package__) / "sketch"
    for name in (*SOURCES, *((HOST,) if host else ())):
        texts[name] = (sketch / name).read_text(encoding="utf-8")
    for name, text in texts.items():
        write_text(folder / name, text)
    return [folder / name for name in texts]
