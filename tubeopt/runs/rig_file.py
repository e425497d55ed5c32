"""Rigs as YAML, logs and trials of heatings as CSV."""

from __future__ import annotations

from dataclasses import replace
from os import PathLike
from typing import Any, Literal

import numpy as np
from pydantic import Field

from ..errors import InputError, nearest
from ..files.checked import Positive, check_kind
from ..files.csv_file import CsvTable, read_csv, refuse
from ..files.fields import Part, entry_of, to_data
from ..files.yaml_file import load_yaml, save_yaml
from ..robots.materials import ZERO_CELSIUS
from ..shaping.heating.calibration import HeatingLog
from ..shaping.heating.rig import Battery, Rig
from ..shaping.heating.trials import RESULTS, Trial
from ..typing import Array

SPRING_BACK_TOLERANCE = 5.0
"""Spring-back, percent, up to which a trial counts as set."""


def _charged(entry: Any, battery: Battery) -> Battery:
    """The battery as its voltage at rest tells, where that is given."""
    if entry.voltage_V is None:
        return battery
    if "state_of_charge_percent" in entry.model_fields_set:
        raise ValueError("gives both state_of_charge_percent and voltage_V; it must give one of them")
    return replace(battery, state_of_charge=battery.charge_at(float(entry.voltage_V)))


BatteryEntry = entry_of(
    Battery,
    extra={"voltage_V": (Positive | None, Field(None, description="at rest, in place of state_of_charge_percent"))},
    finish=_charged,
)
"""The lead-acid battery."""

RigEntry = entry_of(Rig, extra={"kind": (Literal["rig"], ...), "battery": (BatteryEntry, ...)})
"""A rig that heats tubes from a battery."""

RIG_KINDS: dict[str, type[Part]] = {"rig": RigEntry}
"""What the key `kind` of a rig file may say."""


def load_rig(path: str | PathLike[str]) -> Rig:
    """The rig in a YAML file.

    Raises:
        InputError: no such file, not YAML, or keys or values that make no rig: one line for every problem.

    Examples:
        >>> import tubeopt
        >>> rig = tubeopt.load_rig("configs/rigs/thesis_steel.yaml")
        >>> rig.mold.material.name
        'steel'
    """
    return rig_from_dict(load_yaml(path), path)


def rig_from_dict(data: object, where: str | PathLike[str] = "") -> Rig:
    """The rig that `data`, with the keys of a rig file, describes; raises InputError as `load_rig`."""
    rig: Rig = check_kind(RIG_KINDS, data, where).build()
    return rig


def save_rig(rig: Rig, path: str | PathLike[str], header: str = "A shape-setting rig for tubeopt.") -> None:
    """Write `rig` as YAML that `load_rig` turns into an equal rig; raises InputError where that cannot be.

    Examples:
        >>> import tempfile
        >>> import tubeopt
        >>> rig = tubeopt.load_rig("configs/rigs/thesis_steel.yaml")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     tubeopt.save_rig(rig, f"{folder}/rig.yaml")
        ...     tubeopt.load_rig(f"{folder}/rig.yaml") == rig
        True
    """
    save_yaml(path, rig_to_dict(rig), header)


def rig_to_dict(rig: Rig) -> dict[str, Any]:
    """`rig` with the keys and units of a rig file."""
    return {"kind": "rig", "name": rig.name} | to_data(rig)


# --- logs and trials --------------------------------------------------------------------------------------------------

LOG_COLUMNS = ("time_s", "duty", "temperature_degC", "voltage_V", "current_A")
TRIAL_COLUMNS = ("duty", "time_s", "ramp_s", "spring_back_percent", "result", "note")


def load_heating_log(path: str | PathLike[str], position: float = 0.0) -> HeatingLog:
    """A logged heating in CSV: `time_s`, `duty`, and any of `temperature_degC`, `voltage_V`, `current_A`.

    Empty cells are readings that were not taken. `position` (m): of the thermometer from the middle of the curve.

    Raises:
        InputError: no such file, columns unknown or missing, cells that are no numbers, or no log (see `HeatingLog`).
    """
    table = read_csv(path)
    table.expect(LOG_COLUMNS[:2], LOG_COLUMNS[2:])
    values = {name: _readings(table, name) for name in table.columns}
    table.check()
    temperature = values.get("temperature_degC")
    try:
        return HeatingLog(
            time=values["time_s"],
            duty=values["duty"],
            temperature=None if temperature is None else temperature + ZERO_CELSIUS,
            voltage=values.get("voltage_V"),
            current=values.get("current_A"),
            position=position,
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _readings(table: CsvTable, column: str) -> Array:
    needed = column in ("time_s", "duty")
    return np.array(
        [
            float(table.number(k, column)) if needed or table.cell(k, column) else float("nan")
            for k in range(len(table.rows))
        ]
    )


def load_heating_trials(path: str | PathLike[str]) -> tuple[Trial, ...]:
    """Trials in CSV: `duty`, `time_s`, optionally `ramp_s` and `note`, and `result` or `spring_back_percent`.

    `result` is under, good, over or set; a spring-back above 5 % means under, below it set.

    Raises:
        InputError: no such file, columns unknown or missing, or cells that make no trial: one line for every problem.
    """
    table = read_csv(path)
    table.expect(TRIAL_COLUMNS[:2], TRIAL_COLUMNS[2:])
    if not {"result", "spring_back_percent"} & set(table.columns):
        refuse(path, ["column result or spring_back_percent is missing"])
    trials = []
    for k in range(len(table.rows)):
        result = _result(table, k)
        duty, time = float(table.number(k, "duty")), float(table.number(k, "time_s"))
        ramp = float(table.number(k, "ramp_s")) if "ramp_s" in table.columns and table.cell(k, "ramp_s") else 0.0
        try:
            trials.append(Trial(duty, time, result, ramp))
        except InputError as error:
            table.problems.append(f"row {k + 1} (line {table.line[k]}): {error}")
    table.check()
    return tuple(trials)


def _result(table: CsvTable, row: int) -> str:
    text = table.cell(row, "result") if "result" in table.columns else ""
    if text:
        if text not in (*RESULTS, "set"):
            table.complain(row, "result", f"is {text!r}; it must be under, good, over or set{nearest(text, RESULTS)}")
            return "set"
        return text
    if "spring_back_percent" not in table.columns:
        table.complain(row, "result", "is empty; it must be under, good, over or set")
        return "set"
    return "under" if float(table.number(row, "spring_back_percent")) > SPRING_BACK_TOLERANCE else "set"
