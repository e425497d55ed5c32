"""Rigs as YAML, logs and trials of heatings as CSV."""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from ..errors import InputError, nearest
from ..files.checked import Entry, NotNegative, Number, Positive, check_kind
from ..files.csv_file import CsvTable, read_csv, refuse
from ..files.units import MM, PERCENT, in_unit, to_si
from ..files.yaml_file import load_yaml, save_yaml
from ..robots.file import Part, TubeEntry, tube_to_dict
from ..robots.materials import ZERO_CELSIUS
from ..shaping.heating.calibration import HeatingLog
from ..shaping.heating.rig import AMPERE_HOUR, OPEN_CIRCUIT, Battery, Circuit, Clamps, MoldBed, Rig
from ..shaping.heating.trials import RESULTS, Trial
from ..shaping.mold.materials import MOLD_MATERIALS, mold_material
from ..typing import Array
from .mold_file import MoldMaterialChoice

MILLIOHM, GRAM, CM2, UM, AH = Decimal("1e-3"), Decimal("1e-3"), Decimal("1e-4"), Decimal("1e-6"), Decimal(3600)
SPRING_BACK_TOLERANCE = 5.0
"""Spring-back, percent, up to which a trial counts as set."""

Point = Annotated[list[Number], Field(min_length=2, max_length=2)]


def _default(value: float, unit: Decimal) -> Decimal:
    return Decimal(str(in_unit(value, unit)))


class BatteryEntry(Part):
    """The lead-acid battery."""

    capacity_Ah: Positive = Decimal(str(Battery.capacity / AMPERE_HOUR))
    state_of_charge_percent: Positive | None = None
    voltage_V: Positive | None = Field(None, description="at rest, in place of state_of_charge_percent")
    open_circuit_V: list[Point] = Field(
        default=[[Decimal(str(s)), Decimal(str(v))] for s, v in OPEN_CIRCUIT],
        description="pairs of state of charge (0 to 1) and voltage at rest",
    )
    internal_resistance_mohm: Positive = _default(Battery.internal_resistance, MILLIOHM)
    sag_resistance_mohm: NotNegative = _default(Battery.sag_resistance, MILLIOHM)
    sag_time_s: Positive = Decimal(str(Battery.sag_time))

    def build(self) -> Battery:
        """The battery in SI."""
        if self.state_of_charge_percent is not None and self.voltage_V is not None:
            raise ValueError("gives both state_of_charge_percent and voltage_V; it must give one of them")
        battery = Battery(
            capacity=to_si(self.capacity_Ah, AH),
            state_of_charge=to_si(self.state_of_charge_percent or Decimal(100), PERCENT),
            open_circuit=tuple((float(s), float(v)) for s, v in self.open_circuit_V),
            internal_resistance=to_si(self.internal_resistance_mohm, MILLIOHM),
            sag_resistance=to_si(self.sag_resistance_mohm, MILLIOHM),
            sag_time=float(self.sag_time_s),
        )
        if self.voltage_V is not None:
            return replace(battery, state_of_charge=battery.charge_at(float(self.voltage_V)))
        return battery


class CircuitEntry(Part):
    """Cables, contacts, MOSFET, and what they bear."""

    cable_resistance_mohm: NotNegative = _default(Circuit.cable_resistance, MILLIOHM)
    contact_resistance_mohm: NotNegative = _default(Circuit.contact_resistance, MILLIOHM)
    mosfet_resistance_mohm: NotNegative = _default(Circuit.mosfet_resistance, MILLIOHM)
    pwm_frequency_Hz: Positive = Decimal(str(Circuit.pwm_frequency))
    current_limit_A: Positive = Decimal(str(Circuit.current_limit))
    peak_limit_A: Positive = Decimal(str(Circuit.peak_limit))

    def build(self) -> Circuit:
        """The circuit in SI."""
        return Circuit(
            cable_resistance=to_si(self.cable_resistance_mohm, MILLIOHM),
            contact_resistance=to_si(self.contact_resistance_mohm, MILLIOHM),
            mosfet_resistance=to_si(self.mosfet_resistance_mohm, MILLIOHM),
            pwm_frequency=float(self.pwm_frequency_Hz),
            current_limit=float(self.current_limit_A),
            peak_limit=float(self.peak_limit_A),
        )


class ClampsEntry(Part):
    """The two equal clamps."""

    mass_g: Positive = _default(Clamps.mass, GRAM)
    heat_capacity_J_per_kg_K: Positive = Decimal(str(Clamps.heat_capacity))
    area_cm2: Positive = _default(Clamps.area, CM2)
    contact_conductance_W_per_m2_K: Positive = Decimal(str(Clamps.contact_conductance))
    grip_mm: Positive = _default(Clamps.grip, MM)
    clearance_mm: Positive = _default(Clamps.clearance, MM)

    def build(self) -> Clamps:
        """The clamps in SI."""
        return Clamps(
            mass=to_si(self.mass_g, GRAM),
            heat_capacity=float(self.heat_capacity_J_per_kg_K),
            area=to_si(self.area_cm2, CM2),
            contact_conductance=float(self.contact_conductance_W_per_m2_K),
            grip=to_si(self.grip_mm, MM),
            clearance=to_si(self.clearance_mm, MM),
        )


class BedEntry(Part):
    """The mold as the tube's surroundings."""

    material: MoldMaterialChoice = "calcium_silicate"
    width_mm: Positive = _default(MoldBed.width, MM)
    thickness_mm: Positive = _default(MoldBed.thickness, MM)
    lead_mm: Positive = _default(MoldBed.lead, MM)
    gap_um: Positive = _default(MoldBed.gap, UM)
    leak_resistance_ohm_m2: Positive = Decimal(str(MoldBed.leak_resistance))
    vents_percent: list[NotNegative] = Field(
        default=[Decimal(0)], min_length=1, description="open part of the tube's surface, end of the mold to middle"
    )

    def build(self) -> MoldBed:
        """The mold in SI."""
        return MoldBed(
            material=mold_material(self.material) if isinstance(self.material, str) else self.material.build(),
            width=to_si(self.width_mm, MM),
            thickness=to_si(self.thickness_mm, MM),
            lead=to_si(self.lead_mm, MM),
            gap=to_si(self.gap_um, UM),
            leak_resistance=float(self.leak_resistance_ohm_m2),
            vents=tuple(to_si(part, PERCENT) for part in self.vents_percent),
        )


class RigEntry(Part):
    """A rig that heats tubes from a battery."""

    kind: Literal["rig"]
    name: str = ""
    battery: BatteryEntry = Field(description="there is no rig without; {} for all defaults")
    circuit: CircuitEntry = Field(default_factory=CircuitEntry)
    clamps: ClampsEntry = Field(default_factory=ClampsEntry)
    mold: BedEntry = Field(default_factory=BedEntry)
    ambient_degC: Number = Decimal(25)
    convection_W_per_m2_K: Positive | None = Field(None, description="of bare tube; by default computed")
    loss_factor: Positive = Decimal(1)
    resistivity_factor: Positive = Decimal(1)
    tube: TubeEntry | None = Field(None, description="the tube that is usually heated on it")

    def build(self) -> Rig:
        """The rig in SI."""
        return Rig(
            battery=self.battery.build(),
            circuit=self.circuit.build(),
            clamps=self.clamps.build(),
            mold=self.mold.build(),
            ambient=float(self.ambient_degC + Decimal(str(ZERO_CELSIUS))),
            convection=None if self.convection_W_per_m2_K is None else float(self.convection_W_per_m2_K),
            loss_factor=float(self.loss_factor),
            resistivity_factor=float(self.resistivity_factor),
            tube=None if self.tube is None else self.tube.build(),
            name=self.name,
        )


RIG_KINDS: dict[str, type[Entry]] = {"rig": RigEntry}
"""What the key `kind` of a rig file may say."""


def load_rig(path: str | PathLike[str]) -> Rig:
    """The rig in a YAML file.

    Raises:
        InputError: no such file, not YAML, or keys or values that make no rig: one line for every problem.
    """
    return rig_from_dict(load_yaml(path), path)


def rig_from_dict(data: object, where: str | PathLike[str] = "") -> Rig:
    """The rig that `data`, with the keys of a rig file, describes; raises InputError as `load_rig`."""
    entry = check_kind(RIG_KINDS, data, where)
    assert isinstance(entry, RigEntry)
    return entry.build()


def save_rig(rig: Rig, path: str | PathLike[str], header: str = "A shape-setting rig for tubeopt.") -> None:
    """Write `rig` as YAML that `load_rig` turns into an equal rig; raises InputError where that cannot be."""
    save_yaml(path, rig_to_dict(rig), header)


def rig_to_dict(rig: Rig) -> dict[str, Any]:
    """`rig` with the keys and units of a rig file."""
    b, c, k, m = rig.battery, rig.circuit, rig.clamps, rig.mold
    data: dict[str, Any] = {
        "kind": "rig",
        "name": rig.name,
        "battery": {
            "capacity_Ah": in_unit(b.capacity, AH),
            "state_of_charge_percent": in_unit(b.state_of_charge, PERCENT),
            "open_circuit_V": [list(point) for point in b.open_circuit],
            "internal_resistance_mohm": in_unit(b.internal_resistance, MILLIOHM),
            "sag_resistance_mohm": in_unit(b.sag_resistance, MILLIOHM),
            "sag_time_s": b.sag_time,
        },
        "circuit": {
            "cable_resistance_mohm": in_unit(c.cable_resistance, MILLIOHM),
            "contact_resistance_mohm": in_unit(c.contact_resistance, MILLIOHM),
            "mosfet_resistance_mohm": in_unit(c.mosfet_resistance, MILLIOHM),
            "pwm_frequency_Hz": c.pwm_frequency,
            "current_limit_A": c.current_limit,
            "peak_limit_A": c.peak_limit,
        },
        "clamps": {
            "mass_g": in_unit(k.mass, GRAM),
            "heat_capacity_J_per_kg_K": k.heat_capacity,
            "area_cm2": in_unit(k.area, CM2),
            "contact_conductance_W_per_m2_K": k.contact_conductance,
            "grip_mm": in_unit(k.grip, MM),
            "clearance_mm": in_unit(k.clearance, MM),
        },
        "mold": {
            "material": material_to_data(m),
            "width_mm": in_unit(m.width, MM),
            "thickness_mm": in_unit(m.thickness, MM),
            "lead_mm": in_unit(m.lead, MM),
            "gap_um": in_unit(m.gap, UM),
            "leak_resistance_ohm_m2": m.leak_resistance,
            "vents_percent": [in_unit(part, PERCENT) for part in m.vents],
        },
        "ambient_degC": _degC(rig.ambient),
        "loss_factor": rig.loss_factor,
        "resistivity_factor": rig.resistivity_factor,
    }
    if rig.convection is not None:
        data["convection_W_per_m2_K"] = rig.convection
    if rig.tube is not None:
        data["tube"] = tube_to_dict(rig.tube)
    return data


def _degC(temperature: float) -> Decimal:
    """A temperature in K in degC, so that the way back gives the same float."""
    return Decimal(repr(temperature)) - Decimal(str(ZERO_CELSIUS))


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
    _columns(path, table, LOG_COLUMNS, ("time_s", "duty"))
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
    _columns(path, table, TRIAL_COLUMNS, ("duty", "time_s"))
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


def _columns(path: str | PathLike[str], table: CsvTable, known: tuple[str, ...], needed: tuple[str, ...]) -> None:
    problems = [
        f"column {name} is not known; columns are {', '.join(known)}{nearest(name, known)}"
        for name in table.columns
        if name not in known
    ]
    problems += [f"column {name} is missing" for name in needed if name not in table.columns]
    refuse(Path(path), problems)


def material_to_data(mold: MoldBed) -> Any:
    """The mold's material by name where it is a known one, else by its constants."""
    m = mold.material
    if MOLD_MATERIALS.get(m.name) == m:
        return m.name
    return {
        "name": m.name,
        "conductivity_W_per_m_K": m.conductivity,
        "density_kg_per_m3": m.density,
        "heat_capacity_J_per_kg_K": m.heat_capacity,
        "limit_degC": m.limit_temperature_degC,
        "failure": m.failure,
        "resistivity_ohm_m": m.resistivity,
        "emissivity": m.emissivity,
        "price_class": m.price_class,
        "source": m.source,
    }
