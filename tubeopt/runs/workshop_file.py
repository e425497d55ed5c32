"""Rigs and molds as YAML, logs of heatings and trials of spring-back as CSV."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from os import PathLike
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from ..arguments import typed
from ..constants import ZERO_CELSIUS
from ..errors import InputError
from ..files.checked import Positive, check, check_kind
from ..files.csv_file import read_csv, refuse
from ..files.fields import Part, asking, entry_of, to_data
from ..files.shipped import found
from ..files.units import MM, TO_MM, decimal, in_unit, parse_number, to_si
from ..files.units import PER_M as ONE
from ..files.yaml_file import load_yaml, save_yaml
from ..shaping.heating.calibration import HeatingLog
from ..shaping.heating.oven import Oven
from ..shaping.heating.rig import Battery, Rig
from ..shaping.mold.spec import MoldSpec
from ..shaping.mold.springback import RADII, Calibration, Springback
from ..typing import Array


@asking(Battery)
class BatteryEntry(Part):
    """A lead-acid battery: open-circuit voltage over charge, a resistance, and a sag that builds up under load."""

    voltage_V: Positive | None = Field(None, description="voltage at rest, instead of state_of_charge_percent")

    def build(self) -> Battery:
        """The battery in SI, charged as its voltage at rest tells where that is given."""
        battery: Battery = super().build()
        if self.voltage_V is None:
            return battery
        # A default value is no contradiction, only a key that was written.
        if "state_of_charge_percent" in self.model_fields_set:
            raise ValueError("gives both state_of_charge_percent and voltage_V; it must give one of them")
        return replace(battery, state_of_charge=battery.charge_at(self.si("voltage_V")))


RigEntry = entry_of(Rig, extra={"kind": (Literal["rig"], ...), "battery": (BatteryEntry, ...)})
"""A rig that heats tubes from a battery."""

RIG_KINDS: dict[str, type[Part]] = {"rig": RigEntry}
"""What the key `kind` of a rig file may say."""


@typed
def load_rig(path: str | PathLike[str]) -> Rig:
    """The rig in a YAML file, or the one of this name that comes with tubeopt; a file of exactly this path goes first.

    Raises:
        InputError: no such file or name, not YAML, or keys or values that make no rig: one line for every problem.

    Examples:
        >>> import tubeopt
        >>> rig = tubeopt.load_rig("thesis_steel")
        >>> rig.mold.material.name
        'steel'
    """
    path = found(path, "rigs")
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


# --- ovens ------------------------------------------------------------------------------------------------------------

OvenEntry = entry_of(Oven, extra={"kind": (Literal["oven"], ...)})
"""An oven, furnace or salt bath, and the mold in it."""

OVEN_KINDS: dict[str, type[Part]] = {"oven": OvenEntry}
"""Models of an oven file by its key `kind`."""


@typed
def load_oven(path: str | PathLike[str]) -> Oven:
    """Oven in a YAML file, or the built-in oven of this name; a file of exactly this path goes first.

    Raises:
        InputError: no such file or name, not YAML, or wrong keys or values: one line for every problem.

    Examples:
        >>> import tubeopt
        >>> tubeopt.load_oven("steel_slab").mold.material.name
        'steel'
    """
    path = found(path, "ovens")
    oven: Oven = check_kind(OVEN_KINDS, load_yaml(path), path).build()
    return oven


# --- logs -------------------------------------------------------------------------------------------------------------

EMPTY = ("",)
"""Cells of readings that were not taken."""

LOG_COLUMNS = ("time_s", "duty", "temperature_degC", "voltage_V", "current_A")
PLACED = re.compile(r"temperature_([-+]?[0-9.]+)_mm_degC")
"""Columns of several thermometers, each with its place."""


def load_heating_log(path: str | PathLike[str], position: float = 0.0, lag: float = 0.0) -> HeatingLog:
    """A logged heating in CSV: `time_s`, `duty`, and any of `temperature_degC`, `voltage_V`, `current_A`.

    Empty cells are readings that were not taken. `position` (m): of the thermometer from the middle of the curve;
    `lag` (s): its time constant. Several have columns with their places: `temperature_-20_mm_degC`.

    Raises:
        InputError: no such file, columns unknown or missing, cells that are no numbers, or no log (see `HeatingLog`).
    """
    table = read_csv(path, LOG_COLUMNS)
    # Each column of a thermometer has its place in its name.
    placed = {n: to_si(decimal(parse_number(found[1])), MM) for n in table.columns if (found := PLACED.fullmatch(n))}
    needed = LOG_COLUMNS[:2]
    table.expect(needed, (*LOG_COLUMNS[2:], *placed))
    values = {name: table.numbers([name], ONE, gaps=() if name in needed else EMPTY)[:, 0] for name in table.columns}
    table.check()
    places = ({"temperature_degC": position} if "temperature_degC" in values else {}) | placed
    columns = [values[name] for name in places]
    temperature = None if not columns else columns[0] if len(columns) == 1 else np.column_stack(columns)
    try:
        return HeatingLog(
            time=values["time_s"],
            duty=values["duty"],
            temperature=None if temperature is None else temperature + ZERO_CELSIUS,
            voltage=values.get("voltage_V"),
            current=values.get("current_A"),
            position=list(places.values()) or position,
            lag=lag,
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def load_camera(path: str | PathLike[str]) -> tuple[Array, Array, Array]:
    """Recording of a thermal camera in CSV: `time_s`, and a column of temperatures, degC, per point of the tube.

    Columns are called by their place from the middle of the curved part, mm: `time_s,-40,-20,0,20,40`. Empty cells are
    places that were not seen.

    Returns:
        Times (C,), s, places (P,), m, and temperatures (C, P), K, NaN where nothing was seen.

    Raises:
        InputError: no such file, a column that is no place, or cells that are no numbers.
    """
    table = read_csv(path, ("time_s",))
    placed = [name for name in table.columns if name != "time_s"]
    # A camera sees many points, so that their columns are plain numbers.
    strange = [name for name in placed if not re.fullmatch(r"[-+]?[0-9.]+", name)]
    refuse(path, [f"column {name} is not known; it must be time_s or a place in mm" for name in strange])
    table.expect(("time_s",), placed)
    if not placed:
        refuse(path, ["there is no column of temperatures; there must be one for every place, called by it in mm"])
    time, seen = table.numbers(["time_s"], ONE), table.numbers(placed, ONE, gaps=EMPTY)
    table.check()
    return time[:, 0], np.array([to_si(decimal(parse_number(name)), MM) for name in placed]), seen + ZERO_CELSIUS


# --- molds: what is asked of a mold, its material and spring-back; trials of spring-back ------------------------------

TRIAL_COLUMNS = ("mold_radius_mm", "obtained_radius_mm")
NOTE = "note"


@asking(Springback)
class SpringbackEntry(Part):
    """Fraction of the mold's curvature that a tube loses: obtained = mold (1 - fraction - slope mold)."""

    radius_range_mm: Annotated[list[Positive], Field(min_length=2, max_length=2)] | None = Field(
        default=None, description="smallest and largest mold radius of the trials"
    )

    def build(self) -> Springback:
        """The spring-back, with the range of the trials that it is from."""
        back: Springback = super().build()
        if self.radius_range_mm is None:
            return back
        radii = self.si("radius_range_mm")
        # The smallest radius is the largest curvature.
        return replace(back, curvature_range=(1 / max(radii), 1 / min(radii)))


@asking(MoldSpec)
class MoldEntry(Part):
    """Material, fit, plates and tools of a mold; every key has a default."""

    kind: Literal["mold"]
    springback: SpringbackEntry = Field(default_factory=SpringbackEntry)


MOLD_KINDS = {"mold": MoldEntry}
"""What the key `kind` of a mold file may say."""


def load_mold_spec(path: str | PathLike[str]) -> MoldSpec:
    """The specification in a YAML file; raises InputError for what makes none: one line for every problem."""
    return mold_spec_from_dict(load_yaml(path), path)


def mold_spec_from_dict(data: object, where: str | PathLike[str] = "") -> MoldSpec:
    """The specification that `data`, with the keys of a mold file, describes; raises InputError as `load_mold_spec`."""
    spec: MoldSpec = check(MoldEntry, data, where).build()
    return spec


def load_springback(path: str | PathLike[str]) -> Springback:
    """The spring-back in a YAML file that `save_springback` wrote; raises InputError for what makes none."""
    return check(SpringbackEntry, load_yaml(path), path).build()


def springback_to_dict(back: Springback) -> dict[str, Any]:
    """A spring-back with the keys and units of a mold file."""
    data = to_data(back)
    if back.curvature_range is not None:
        low, high = back.curvature_range
        data["radius_range_mm"] = [in_unit(1 / high, MM), in_unit(1 / low, MM)]
    return data


def save_springback(calibration: Calibration, path: str | PathLike[str]) -> None:
    """Write the fitted spring-back as YAML, to stand under the key `springback` of a mold file or for --springback;
    raises InputError where that cannot be."""
    trials = len(calibration.mold_curvature)
    save_yaml(path, springback_to_dict(calibration.springback), f"Spring-back of tubes, from {trials} trials.")


@dataclass(frozen=True, eq=False)
class Trials:
    """Trials of spring-back."""

    mold_radius: Array
    """(N,) m."""
    obtained_radius: Array
    """(N,) m, of the tubes that came out."""


def load_trials(path: str | PathLike[str]) -> Trials:
    """The trials in a CSV file with the columns `mold_radius_mm`, `obtained_radius_mm` and, for any text, `note`.

    Raises:
        InputError: no such file, a column that is unknown or missing, a cell that is no positive number: one line for
            every problem.
    """
    table = read_csv(path, (*TRIAL_COLUMNS, NOTE))
    table.expect(TRIAL_COLUMNS, [NOTE])
    radii = table.numbers(TRIAL_COLUMNS, MM)
    for row in range(len(table.rows)):
        for k, column in enumerate(TRIAL_COLUMNS):
            # A cell that is no number was noted before, and read as 0.
            if not RADII[0] <= radii[row, k] <= RADII[1] and not any(
                f"row {row + 1} " in problem and column in problem for problem in table.problems
            ):
                allowed = f"it must be {RADII[0] * TO_MM:g} to {RADII[1] * TO_MM:g}, as radii of curved tubes are"
                table.complain(row, column, f"is {table.cell(row, column)}; {allowed}")
    table.check()
    return Trials(radii[:, 0], radii[:, 1])
