"""YAML files of rigs and molds; CSV files of heating logs and spring-back trials."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from ..arguments import typed
from ..constants import ZERO_CELSIUS
from ..errors import InputError
from ..files.checked import Positive, check, check_kind
from ..files.csv_file import read_csv, refuse, to_csv
from ..files.fields import Part, entry_of, keys_from, to_data
from ..files.files import write_text
from ..files.shipped import find_file
from ..files.units import MM, TO_MM, decimal, in_unit, parse_number, to_si
from ..files.units import PER_M as ONE
from ..files.yaml_file import load_yaml, save_yaml
from ..shaping.heating.calibration import HeatingLog
from ..shaping.heating.oven import Oven
from ..shaping.heating.rig import LEAD_ACID, Battery, Rig
from ..shaping.mold.measured_tube import MeasuredTube
from ..shaping.mold.spec import MoldSpec
from ..shaping.mold.springback import RADII, Calibration, Springback
from ..typing import Array

OWN_NUMBERS = "open_circuit_V", "internal_resistance_mohm", "sag_resistance_mohm", "sag_time_s"
"""Keys that a battery must have unless it is a lead-acid one."""


@keys_from(Battery)
class BatteryEntry(Part):
    """A battery: open-circuit voltage over charge, a resistance, and a sag that builds up under load."""

    voltage_V: Positive | None = Field(None, description="voltage at rest, instead of state_of_charge_percent")

    def build(self) -> Battery:
        """Battery in SI; a given voltage at rest determines its state of charge."""
        chemistry = getattr(self, "chemistry", LEAD_ACID)
        missing = [name for name in OWN_NUMBERS if name not in self.model_fields_set]
        if chemistry != LEAD_ACID and missing:
            raise ValueError(f"is a {chemistry} battery without {missing[0]}; defaults are those of lead_acid")
        battery: Battery = super().build()
        if self.voltage_V is None:
            return battery
        # The state of charge has a default: only a key in the file contradicts the voltage.
        if "state_of_charge_percent" in self.model_fields_set:
            raise ValueError("gives both state_of_charge_percent and voltage_V; it must give one of them")
        return replace(battery, state_of_charge=battery.charge_at(self.si("voltage_V")))


RigEntry = entry_of(Rig, extra={"kind": (Literal["rig"], ...), "battery": (BatteryEntry, ...)})
"""A rig that heats tubes from a battery."""

RIG_KINDS: dict[str, type[Part]] = {"rig": RigEntry}
"""Kinds of rig files."""


@typed
def load_rig(path: str | PathLike[str]) -> Rig:
    """Load a rig by path or built-in name; a file of exactly this path has priority.

    Raises:
        InputError: no such file or name, not YAML, or invalid keys or values; one line per problem.

    Examples:
        >>> import tubeopt
        >>> rig = tubeopt.load_rig("thesis_steel")
        >>> rig.mold.material.name
        'steel'
    """
    path = find_file(path, "rigs")
    return rig_from_dict(load_yaml(path), path)


def rig_from_dict(data: object, where: str | PathLike[str] = "") -> Rig:
    """Build a rig from the keys of a rig file; raises InputError as `load_rig`."""
    rig: Rig = check_kind(RIG_KINDS, data, where).build()
    return rig


def save_rig(rig: Rig, path: str | PathLike[str], header: str = "A shape-setting rig for tubeopt.") -> None:
    """Write a rig as YAML that `load_rig` reads back as an equal rig; raises InputError if it cannot be written.

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
    """Convert a rig to the keys and units of a rig file."""
    return {"kind": "rig", "name": rig.name} | to_data(rig)


# --- ovens ------------------------------------------------------------------------------------------------------------

OvenEntry = entry_of(Oven, extra={"kind": (Literal["oven"], ...)})
"""An oven, furnace or salt bath, and the mold in it."""

OVEN_KINDS: dict[str, type[Part]] = {"oven": OvenEntry}
"""Models of an oven file by its key `kind`."""


@typed
def load_oven(path: str | PathLike[str]) -> Oven:
    """Oven in a YAML file, or the built-in oven of this name; an existing file of this path has priority.

    Raises:
        InputError: no such file or name, not YAML, or wrong keys or values: one line for every problem.

    Examples:
        >>> import tubeopt
        >>> tubeopt.load_oven("steel_slab").mold.material.name
        'steel'
    """
    path = find_file(path, "ovens")
    oven: Oven = check_kind(OVEN_KINDS, load_yaml(path), path).build()
    return oven


# --- logs -------------------------------------------------------------------------------------------------------------

EMPTY = ("",)
"""Cells without a reading."""

LOG_COLUMNS = ("time_s", "duty", "temperature_degC", "voltage_V", "current_A")
PLACED = re.compile(r"temperature_([-+]?[0-9.]+)_mm_degC")
"""Name of a column of one of several thermometers, with its position."""


def load_heating_log(path: str | PathLike[str], position: float = 0.0, lag: float = 0.0) -> HeatingLog:
    """Load a heating log from CSV: `time_s`, `duty`, and any of `temperature_degC`, `voltage_V`, `current_A`.

    Empty cells are missing readings. Each of several thermometers has a column with its position in mm:
    `temperature_-20_mm_degC`.

    Args:
        position: position of a single thermometer from the middle of the curved part, m.
        lag: time constant of the thermometers, s.

    Raises:
        InputError: no such file, unknown or missing columns, cells that are no numbers, or as `HeatingLog`.
    """
    table = read_csv(path, LOG_COLUMNS)
    # The name of a column contains the position.
    placed = {n: to_si(decimal(parse_number(match[1])), MM) for n in table.columns if (match := PLACED.fullmatch(n))}
    needed = LOG_COLUMNS[:2]
    table.expect(needed, (*LOG_COLUMNS[2:], *placed))
    values = {name: table.numbers([name], ONE, gaps=() if name in needed else EMPTY)[:, 0] for name in table.columns}
    table.check()
    positions = ({"temperature_degC": position} if "temperature_degC" in values else {}) | placed
    columns = [values[name] for name in positions]
    temperature = None if not columns else columns[0] if len(columns) == 1 else np.column_stack(columns)
    try:
        return HeatingLog(
            time=values["time_s"],
            duty=values["duty"],
            temperature=None if temperature is None else temperature + ZERO_CELSIUS,
            voltage=values.get("voltage_V"),
            current=values.get("current_A"),
            position=list(positions.values()) or position,
            lag=lag,
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


class CameraRecording(NamedTuple):
    """Recording of a thermal camera."""

    time: Array
    """Times (C,) of the images, s."""
    position: Array
    """(P,) positions along the tube from the middle of the curved part, m."""
    temperature: Array
    """(C, P) temperatures, K; NaN for a point that was not visible."""


def load_camera(path: str | PathLike[str]) -> CameraRecording:
    """Load a recording of a thermal camera from CSV: `time_s`, and a column of temperatures, degC, per point.

    The name of a column is its distance from the middle of the curved part, mm: `time_s,-40,-20,0,20,40`. Empty cells
    are points that were not visible.

    Raises:
        InputError: no such file, a column name that is no number, or cells that are no numbers.
    """
    table = read_csv(path, ("time_s",))
    placed = [name for name in table.columns if name != "time_s"]
    # A camera records many points, so that the names of their columns are plain numbers.
    unknown = [name for name in placed if not re.fullmatch(r"[-+]?[0-9.]+", name)]
    refuse(path, [f"column {name} is not known; it must be time_s or a place in mm" for name in unknown])
    table.expect(("time_s",), placed)
    if not placed:
        refuse(path, ["there is no column of temperatures; there must be one for every place, called by it in mm"])
    time, celsius = table.numbers(["time_s"], ONE), table.numbers(placed, ONE, gaps=EMPTY)
    table.check()
    position = np.array([to_si(decimal(parse_number(name)), MM) for name in placed])
    return CameraRecording(time[:, 0], position, celsius + ZERO_CELSIUS)


# --- molds: specification, material and spring-back; trials of spring-back --------------------------------------------

TRIAL_COLUMNS = ("mold_radius_mm", "obtained_radius_mm")
ERROR_COLUMN = "obtained_error_mm"
NOTE = "note"


@keys_from(Springback)
class SpringbackEntry(Part):
    """Fraction of the mold's curvature that a tube loses: obtained = mold (1 - fraction - slope mold)."""

    radius_range_mm: Annotated[list[Positive], Field(min_length=2, max_length=2)] | None = Field(
        default=None, description="smallest and largest mold radius of the trials"
    )

    def build(self) -> Springback:
        """Spring-back, with the range of mold curvatures of its trials."""
        back: Springback = super().build()
        if self.radius_range_mm is None:
            return back
        radii = self.si("radius_range_mm")
        # The smallest radius is the largest curvature.
        return replace(back, curvature_range=(1 / max(radii), 1 / min(radii)))


@keys_from(MoldSpec)
class MoldEntry(Part):
    """Material, fit, plates and tools of a mold; every key has a default."""

    kind: Literal["mold"]
    springback: SpringbackEntry = Field(default_factory=SpringbackEntry)


MOLD_KINDS = {"mold": MoldEntry}
"""Kinds of mold files."""


def load_mold_spec(path: str | PathLike[str]) -> MoldSpec:
    """Load a mold specification; raises InputError with one line per problem."""
    return mold_spec_from_dict(load_yaml(path), path)


def mold_spec_from_dict(data: object, where: str | PathLike[str] = "") -> MoldSpec:
    """Build a mold specification from the keys of a mold file; raises InputError as `load_mold_spec`."""
    spec: MoldSpec = check(MoldEntry, data, where).build()
    return spec


def load_springback(path: str | PathLike[str]) -> Springback:
    """Load spring-back from a file of `save_springback`; raises InputError for invalid keys or values."""
    return check(SpringbackEntry, load_yaml(path), path).build()


def springback_to_dict(back: Springback) -> dict[str, Any]:
    """Convert spring-back to the keys and units of a mold file."""
    data = to_data(back)
    if back.curvature_range is not None:
        low, high = back.curvature_range
        data["radius_range_mm"] = [in_unit(1 / high, MM), in_unit(1 / low, MM)]
    return data


def save_springback(calibration: Calibration, path: str | PathLike[str]) -> None:
    """Write the fitted spring-back as YAML for --springback or the key `springback` of a mold file.

    Raises:
        InputError: the file cannot be written.
    """
    trials = len(calibration.mold_curvature)
    save_yaml(path, springback_to_dict(calibration.springback), f"Spring-back of tubes, from {trials} trials.")


@dataclass(frozen=True, eq=False)
class Trials:
    """Radii of spring-back trials."""

    mold_radius: Array
    """Mold radii (N,), m."""
    obtained_radius: Array
    """(N,) radii of the finished tubes, m."""
    obtained_error: Array | None = None
    """(N,) standard errors of these radii, m; None without this column."""


def load_trials(path: str | PathLike[str]) -> Trials:
    """Load spring-back trials from CSV with columns `mold_radius_mm`, `obtained_radius_mm`, and optionally
    `obtained_error_mm` and `note`.

    Raises:
        InputError: no such file, an unknown or missing column, a cell that is no positive number; one line per problem.
    """
    table = read_csv(path, (*TRIAL_COLUMNS, ERROR_COLUMN, NOTE))
    table.expect(TRIAL_COLUMNS, [ERROR_COLUMN, NOTE])
    radii = table.numbers(TRIAL_COLUMNS, MM)
    errors = table.numbers([ERROR_COLUMN], MM)[:, 0] if ERROR_COLUMN in table.columns else None
    for row, error in enumerate(() if errors is None else errors):
        if not 0 < error <= 0.5 * radii[row, 1] and not table.problems:
            half = f"it must be greater than 0 and at most half the radius, {0.5 * radii[row, 1] * TO_MM:g}"
            table.complain(row, ERROR_COLUMN, f"is {table.cell(row, ERROR_COLUMN)}; {half}")
    for row in range(len(table.rows)):
        for k, column in enumerate(TRIAL_COLUMNS):
            # A cell that is no number has a problem already, and was read as 0.
            if not RADII[0] <= radii[row, k] <= RADII[1] and not any(
                f"row {row + 1} " in problem and column in problem for problem in table.problems
            ):
                allowed = f"it must be {RADII[0] * TO_MM:g} to {RADII[1] * TO_MM:g}, as radii of curved tubes are"
                table.complain(row, column, f"is {table.cell(row, column)}; {allowed}")
    table.check()
    return Trials(radii[:, 0], radii[:, 1], errors)


def save_trial(measured: MeasuredTube, mold_radius: float, path: Path) -> None:
    """Add a measured tube to a CSV file of trials, as `load_trials` reads it; its photo's name is the note.

    An older row of the same photo is replaced.

    Raises:
        InputError: the file exists and is no file of trials with these columns, or cannot be written.
    """
    columns = (*TRIAL_COLUMNS, ERROR_COLUMN, NOTE)
    rows: list[Sequence[object]] = []
    if path.exists():
        load_trials(path)
        table = read_csv(path, columns)
        if table.columns != columns:
            raise InputError(f"{path}: columns are {', '.join(table.columns)}; they must be {', '.join(columns)}")
        rows = [row for row in table.rows if row[-1] != measured.photo.name]
    numbers = mold_radius, measured.radius, measured.standard_error
    rows.append([*(f"{number * TO_MM:.6g}" for number in numbers), measured.photo.name])
    write_text(path, to_csv(columns, rows, "Trials of spring-back, measured in photos: `tubeopt mold calibrate`."))
