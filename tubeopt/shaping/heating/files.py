"""The schedule as text: a table in CSV and a header for an Arduino."""

from __future__ import annotations

from ...errors import InputError
from ...files.csv_file import to_csv
from .plan import HeatingPlan

PER_LINE = 16


def schedule_csv(plan: HeatingPlan) -> str:
    """A row for every slot: its beginning, the duty (0-255), and what the simulation tells.

    `coldest_degC` and `hottest_degC` are of the curved part, `limit_point_degC` is the hottest of the whole tube;
    voltage and current are those while the MOSFET conducts.
    """
    curved = plan.temperature[:, plan.curved]
    columns = {
        "time_s": (plan.time, ".3f"),
        "duty": (plan.duty, "d"),
        "ideal_duty": (plan.ideal_duty, ".3f"),
        "coldest_degC": (curved.min(1), ".2f"),
        "hottest_degC": (curved.max(1), ".2f"),
        "limit_point_degC": (plan.temperature.max(1), ".2f"),
        "voltage_V": (plan.voltage, ".3f"),
        "current_A": (plan.current, ".2f"),
    }
    rows = zip(*([f"{value:{form}}" for value in values] for values, form in columns.values()), strict=True)
    comment = (
        f"{plan.rig.name or 'rig'}: every duty holds for {plan.spec.slot:g} s; hold from {plan.hold_start:g} to "
        f"{plan.hold_end:g} s; battery at {plan.rig.battery.voltage:.2f} V at rest"
    )
    return to_csv(tuple(columns), rows, comment)


def arduino_header(plan: HeatingPlan) -> str:
    """A C header with the duties as bytes, for `analogWrite` every SLOT_MS ms; errors as `slot_milliseconds`."""
    duty, milliseconds = plan.duty.tolist(), slot_milliseconds(plan.spec.slot)
    lines = [", ".join(f"{d:3d}" for d in duty[k : k + PER_LINE]) for k in range(0, len(duty), PER_LINE)]
    body = ",\n".join(f"    {line}" for line in lines)
    return f"""/* Heating schedule for a shape-setting rig: duty (0-255) of the PWM, one byte for every slot.
   For a battery of {plan.rig.battery.voltage:.2f} V at rest. The last duty is 0: the tube is off. */
#ifndef HEATING_SCHEDULE_H
#define HEATING_SCHEDULE_H

#include <stdint.h>
#ifdef __AVR__
#include <avr/pgmspace.h> /* pgm_read_byte(&HEATING_DUTY[k]) */
#else
#define PROGMEM
#endif

#define HEATING_SLOT_MS {milliseconds}u
#define HEATING_SLOTS {len(duty)}u

static const uint8_t HEATING_DUTY[HEATING_SLOTS] PROGMEM = {{
{body}
}};

#endif
"""


def slot_milliseconds(slot: float) -> int:
    """A slot (s) in ms; raises InputError where that is no whole number."""
    milliseconds = round(1000 * slot)
    if abs(milliseconds - 1000 * slot) > 1e-9 or milliseconds < 1:
        raise InputError(f"slot is {slot:g} s; for an Arduino it must be a whole number of milliseconds")
    return milliseconds
