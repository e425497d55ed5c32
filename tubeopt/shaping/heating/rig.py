"""The rig that heats a tube by its own resistance: battery, circuit, clamps, mold, surroundings (SI).

Gilbert and Webster, Rapid, reliable shape setting of superelastic nitinol for prototyping robots, IEEE Robotics and
Automation Letters 1 (2016); thesis, section 4.2.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import numpy as np

from ...constants import GRAVITY, ZERO_CELSIUS
from ...display import Displayed
from ...errors import InputError, finite, numbers
from ...files.field_metadata import (
    NOT_NEGATIVE,
    POSITIVE,
    REQUIRED,
    Named,
    OneOf,
    Range,
    Typical,
    Written,
    check_fields,
    unit,
)
from ...robots.file import TubeEntry, tube_to_dict
from ...robots.tubes import Tube
from ..materials import AMBIENT_RANGE, CALCIUM_SILICATE, MOLD_MATERIALS, MoldMaterial, mold_material
from .thermocouple import ANCHOR

COUNTS = 255
"""The largest duty of an 8-bit PWM: always on."""

AMPERE_HOUR = 3600.0
"""1 A h in C."""

OHMS = Typical(1e-5, 0.5)
"""Typical resistances of cables, contacts and batteries, ohm; tubes have more."""

HOT = 500.0
"""Rise over ambient, K, for the heat transfer of tubes into air; in free convection it changes with the sixth root of
it."""

MOST_VOLT = 120.0
"""Largest battery voltage, V: above it, it is no low voltage, which switches and safety rules of a workshop assume."""

CHARGED = 1.08
"""Voltage of a freshly charged battery, as a multiple of the rest voltage when full.

Up to 13.7 V of 12.7 V.
"""

SIDE_CLEARANCE = 50e-6
"""Default side clearance, m."""

LOGGER = logging.getLogger(__name__)

OPEN_CIRCUIT = (
    (0.1, 11.51),
    (0.2, 11.66),
    (0.3, 11.81),
    (0.4, 11.96),
    (0.5, 12.10),
    (0.6, 12.24),
    (0.7, 12.37),
    (0.8, 12.50),
    (0.9, 12.62),
    (1.0, 12.73),
)
"""Pairs (state of charge, V) of a rested 12 V flooded lead-acid battery: Trojan Battery Company, User's Guide."""


LEAD_ACID = "lead_acid"
CHEMISTRIES = (LEAD_ACID, "lithium_iron_phosphate", "lithium_ion", "other")
"""Chemistries of batteries; only of lead-acid ones there are default numbers."""


@dataclass(frozen=True)
class Battery:
    """A battery: open-circuit voltage over charge, a resistance, and a sag that builds up under load.

    Without numbers it is a 12 V lead-acid battery.

    Raises:
        InputError: a value is out of its range, or the table is not increasing.
    """

    chemistry: Annotated[
        str,
        OneOf(CHEMISTRIES),
        "chemistry of the cells; defaults of other keys are those of lead_acid. Another chemistry requires "
        "open_circuit_V, internal_resistance_mohm, sag_resistance_mohm and sag_time_s",
    ] = LEAD_ACID
    capacity: Annotated[
        float,
        unit("Ah"),
        Range(above=0.0, maximum=1e6 * AMPERE_HOUR),
        Typical(0.5 * AMPERE_HOUR, 1000 * AMPERE_HOUR),
        "capacity",
    ] = 60.0 * AMPERE_HOUR
    state_of_charge: Annotated[
        float, unit("percent"), Range(above=0.0, maximum=1.0), "state of charge, percent of the capacity"
    ] = 1.0
    open_circuit: Annotated[
        tuple[tuple[float, float], ...],
        unit("V"),
        "pairs of state of charge (0 to 1) and voltage at rest, both increasing; linear interpolation",
    ] = OPEN_CIRCUIT
    internal_resistance: Annotated[
        float, unit("mohm"), Range(above=0.0, maximum=10.0), OHMS, "immediate internal resistance"
    ] = 0.008
    sag_resistance: Annotated[
        float, unit("mohm"), Range(minimum=0.0, maximum=10.0), OHMS, "additional resistance after the voltage sag"
    ] = 0.006
    sag_time: Annotated[float, unit("s"), Range(above=0.0, maximum=1e4), "time constant of the sag (63 %)"] = 30.0

    def __post_init__(self) -> None:
        check_fields(self, "the battery")
        if self.chemistry != LEAD_ACID and self.open_circuit == OPEN_CIRCUIT:
            raise InputError(f"chemistry of the battery is {self.chemistry}, and open_circuit is not given; it must be")
        try:
            table = np.array(self.open_circuit, dtype=float)
        except (TypeError, ValueError):
            table = np.zeros(0)
        if table.ndim != 2 or table.shape[1] != 2 or len(table) < 2 or not np.isfinite(table).all():
            raise InputError("open_circuit of the battery must be at least 2 pairs (state of charge, voltage)")
        if (np.diff(table[:, 0]) <= 0).any() or (np.diff(table[:, 1]) <= 0).any() or (table[:, 1] <= 0).any():
            raise InputError("open_circuit of the battery must increase in charge and in voltage, and be above 0 V")
        if table[-1, 1] > MOST_VOLT or table[0, 0] < 0 or table[-1, 0] > 1:
            raise InputError(
                f"open_circuit of the battery goes from a charge of {table[0, 0]:g} to {table[-1, 0]:g} and up to "
                f"{table[-1, 1]:g} V; it must go from 0 to 1 at most, and up to {MOST_VOLT:g} V at most"
            )
        object.__setattr__(self, "open_circuit", tuple((float(s), float(v)) for s, v in table))

    @property
    def voltage(self) -> float:
        """Open-circuit voltage at the state of charge, V: what a voltmeter shows before heating."""
        table = np.array(self.open_circuit)
        return float(np.interp(self.state_of_charge, table[:, 0], table[:, 1]))

    @property
    def voltage_slope(self) -> float:
        """Change of the open-circuit voltage with the state of charge, just below the current state, V."""
        table = np.array(self.open_circuit)
        k = min(max(int(np.searchsorted(table[:, 0], self.state_of_charge)), 1), len(table) - 1)
        return float((table[k, 1] - table[k - 1, 1]) / (table[k, 0] - table[k - 1, 0]))

    def charge_at(self, voltage: float) -> float:
        """State of charge at a voltage at rest.

        A battery that has just been charged shows more than it does at rest: up to `CHARGED` more than the table ends
        with is taken as full, with a warning. Raises InputError beyond that, or below the table.
        """
        table = np.array(self.open_circuit)
        most = float(table[-1, 1])
        if not table[0, 1] <= finite("voltage", voltage) <= CHARGED * most:
            raise InputError(f"voltage of the battery is {voltage:g} V; it must be {table[0, 1]:g} to {most:g} V")
        if voltage > most:
            LOGGER.warning(
                f"the battery voltage is {voltage:g} V, above {most:g} V of a full battery "
                "at rest; it is assumed full; let it rest, or it heats less than planned"
            )
        return float(np.interp(voltage, table[:, 1], table[:, 0]))


@dataclass(frozen=True)
class Circuit:
    """Resistances between battery and tube, and current limits."""

    cable_resistance: Annotated[
        float, unit("mohm"), Range(minimum=0.0, maximum=10.0), OHMS, "total resistance of the cables"
    ] = 0.005
    contact_resistance: Annotated[
        float, unit("mohm"), Range(minimum=0.0, maximum=10.0), OHMS, "total contact resistance of both clamps"
    ] = 0.004
    mosfet_resistance: Annotated[float, unit("mohm"), Range(minimum=0.0, maximum=10.0), OHMS, "R_DS(on)"] = 0.002
    pwm_frequency: Annotated[float, unit("Hz"), Range(above=0.0, maximum=1e6), Typical(10.0, 1e5), "PWM frequency"] = (
        490.0
    )
    lost_on_time: Annotated[
        float,
        unit("us"),
        NOT_NEGATIVE,
        "effective time lost per pulse by inductance: L/R, minus the time that current "
        "still flows through a diode across the tube",
    ] = 0.0
    cutout_opening: Annotated[
        float,
        unit("ms"),
        Range(above=0.0, maximum=0.5),
        Typical(1e-4, 0.2),
        "opening time of the cut-out in series with the MOSFET: a contactor with a Zener diode at its coil takes 10 to "
        "15 ms, a high-side switch below 1 ms",
    ] = 0.015
    current_limit: Annotated[float, unit("A"), Range(above=0.0, maximum=2000.0), "limit of the mean current"] = 40.0
    peak_limit: Annotated[
        float, unit("A"), Range(above=0.0, maximum=5000.0), "limit of the current while the MOSFET conducts"
    ] = 200.0
    hall_sensitivity: Annotated[
        float | None,
        unit("mV_per_A"),
        Range(above=0.0, maximum=1.0),
        "sensitivity of the built circuit's current sensor; with it, sketches keep this scale and pwm_frequency_Hz. "
        "Default: no circuit is built yet, and both are chosen for the tube",
    ] = None

    def __post_init__(self) -> None:
        check_fields(self, "the circuit")
        if self.lost_share >= 0.5:
            raise InputError(
                f"lost_on_time of the circuit is {1e6 * self.lost_on_time:g} us; it must be below half a period of the "
                f"PWM, {0.5e6 / self.pwm_frequency:g} us"
            )

    @property
    def lost_share(self) -> float:
        """Fraction of a PWM period that every pulse loses."""
        return self.lost_on_time * self.pwm_frequency

    @property
    def resistance(self) -> float:
        """Resistance in series with the tube, without the battery, ohm."""
        return self.cable_resistance + self.contact_resistance + self.mosfet_resistance


@dataclass(frozen=True)
class Clamps:
    """The two equal clamps, as lumped heat capacities."""

    mass: Annotated[float, unit("g"), Range(above=0.0, maximum=50.0), Typical(5e-4, 5.0), "mass of one clamp"] = 0.05
    heat_capacity: Annotated[
        float, unit("J_per_kg_K"), Range(above=0.0, maximum=5000.0), "heat capacity of the clamp metal"
    ] = 896.0
    area: Annotated[
        float, unit("cm2"), Range(above=0.0, maximum=1.0), "surface area of one clamp that is cooled by air"
    ] = 4e-3
    contact_conductance: Annotated[
        float, unit("W_per_m2_K"), Range(above=0.0, maximum=1e6), "thermal conductance between tube and clamp"
    ] = 3000.0
    grip: Annotated[float, unit("mm"), Range(above=0.0, maximum=0.2), "length of tube in each clamp"] = 10e-3
    clearance: Annotated[
        float, unit("mm"), Range(above=0.0, maximum=0.2), "length of uncovered tube between clamp and mold at each end"
    ] = 5e-3

    def __post_init__(self) -> None:
        check_fields(self, "the clamps")


@dataclass(frozen=True)
class MoldBed:
    """The mold as the tube's surroundings."""

    material: Annotated[MoldMaterial, Named(MOLD_MATERIALS), "mold material: keys, or its name"] = CALCIUM_SILICATE
    width: Annotated[
        float,
        unit("mm"),
        Range(above=0.0, maximum=2.0),
        Typical(2e-3, 2.0),
        "width of the mold around the tube",
    ] = 0.1
    thickness: Annotated[
        float, unit("mm"), Range(above=0.0, maximum=2.0), Typical(1e-3, 1.0), "thickness of both plates together"
    ] = 25.4e-3
    lead: Annotated[
        float,
        unit("mm"),
        Range(above=0.0, maximum=2.0),
        Typical(5e-4, 1.0),
        "length of straight tube in the mold on each side of the curved part",
    ] = 20e-3
    side_clearance: Annotated[
        float | None,
        unit("um"),
        Range(above=0.0, maximum=5e-3),
        "side clearance: air gap on each side of a tube in the middle of its groove. "
        "Default gap_um, or 50 um without gap_um",
    ] = None
    gap: Annotated[
        float | None,
        unit("um"),
        Range(above=0.0, maximum=5e-3),
        "uniform air gap that conducts as much heat as the air in the groove; it limits the "
        "heat flow at first. By default computed for a square groove with this side "
        "clearance and the tube on its floor and wall",
    ] = None
    leak_resistance: Annotated[
        float, unit("ohm_m2"), POSITIVE, "electrical contact resistance between tube surface and a conductive mold"
    ] = 1e-6
    wire: Annotated[
        float,
        unit("mm"),
        Range(minimum=0.0, maximum=2e-3),
        Typical(2e-5, 1e-3),
        "diameter of the wires of a thermocouple in the slot of the lid; it draws heat from the middle. 0: none",
    ] = 0.0
    anchor: Annotated[
        float,
        unit("mm"),
        Range(above=0.0, maximum=0.2),
        Typical(1e-3, 0.1),
        "length of each wire on the tube, from the middle of the curved part",
    ] = ANCHOR
    vents: Annotated[
        tuple[float, ...],
        unit("percent"),
        NOT_NEGATIVE,
        "open fraction of the tube's surface under the top plate: one number, or several "
        "equally spaced from the end of the mold to its middle",
    ] = (0.0,)

    def __post_init__(self) -> None:
        if isinstance(self.material, str):
            object.__setattr__(self, "material", mold_material(self.material))
        check_fields(self, "the mold")
        vents = numbers("vents of the mold", self.vents)
        if not vents or min(vents) < 0 or max(vents) > 0.5:
            raise InputError(f"vents of the mold are {list(vents)}; they must be fractions from 0 to 0.5")
        object.__setattr__(self, "vents", vents)

    @property
    def play(self) -> float:
        """Side clearance, m; if not given, the default."""
        return next((x for x in (self.side_clearance, self.gap) if x is not None), SIDE_CLEARANCE)

    @property
    def radius(self) -> float:
        """Radius of the cylinder with the cross-section of the plates, m."""
        square: Any = self.width * self.thickness / math.pi
        return square**0.5  # type: ignore[no-any-return]  # also of expressions


@dataclass(frozen=True)
class Rig(Displayed):
    """A battery-driven shape-setting rig, the same at both ends of the tube.

    Raises:
        InputError: a part is missing, or a value is out of its range.
    """

    battery: Annotated[Battery, REQUIRED, "the battery; {} for all defaults"] = field(default_factory=Battery)
    circuit: Annotated[Circuit, "cables, contacts, MOSFET and their current limits"] = field(default_factory=Circuit)
    clamps: Annotated[Clamps, "the two equal clamps"] = field(default_factory=Clamps)
    mold: Annotated[MoldBed, "the mold as the tube's surroundings"] = field(default_factory=MoldBed)
    ambient: Annotated[float, unit("degC"), AMBIENT_RANGE, "ambient temperature"] = 25.0 + ZERO_CELSIUS
    convection: Annotated[
        float | None,
        unit("W_per_m2_K"),
        Range(above=0.0, maximum=1e4),
        "heat transfer coefficient of uncovered surfaces in air; by default computed for the tube",
    ] = None
    loss_factor: Annotated[
        float, POSITIVE, "factor on the heat loss of the tube to mold and air; 1 if uncalibrated"
    ] = 1.0
    resistivity_factor: Annotated[float, POSITIVE, "factor on the resistivity of the tube; 1 if uncalibrated"] = 1.0
    tube: Annotated[Tube | None, Written(TubeEntry, tube_to_dict), "default tube of the rig"] = None
    name: Annotated[str, "name for headings"] = ""

    def __post_init__(self) -> None:
        check_fields(self, "the rig")

    def with_charge(self, state_of_charge: float) -> Rig:
        """A copy of the rig with its battery at another state of charge, 0 to 1."""
        return replace(self, battery=replace(self.battery, state_of_charge=state_of_charge))


def natural_convection(diameter: float, surface: float, ambient: float) -> float:
    """Heat transfer coefficient (W/(m^2 K)) of a horizontal cylinder, m, in still air; temperatures in K.

    Churchill and Chu, Int. J. Heat Mass Transfer 18 (1975), with the air's properties at the film temperature after
    Sutherland's laws at 1 atm.
    """
    film = 0.5 * (surface + ambient)
    viscosity = 1.458e-6 * film**1.5 / (film + 110.4)
    conductivity = air_conductivity(film)
    density = 101325.0 / (287.05 * film)
    prandtl = viscosity * 1030.0 / conductivity
    buoyancy = GRAVITY * abs(surface - ambient) / film * diameter**3
    rayleigh = buoyancy * (density / viscosity) ** 2 * prandtl
    nusselt = (0.60 + 0.387 * rayleigh ** (1 / 6) / (1 + (0.559 / prandtl) ** (9 / 16)) ** (8 / 27)) ** 2
    return float(nusselt * conductivity / diameter)


def air_conductivity(temperature: float) -> float:
    """Thermal conductivity of air, W/(m K), at a temperature in K (Sutherland's law, U.S. Standard Atmosphere 1976)."""
    return float(2.64638e-3 * temperature**1.5 / (temperature + 245.4 * 10.0 ** (-12.0 / temperature)))


def gap_conductance(gap: float, ambient: float) -> float:
    """Heat transfer, W/(m^2 K), through a gap of air (m) between a hot tube and a mold near `ambient` (K)."""
    return air_conductivity(ambient + 0.5 * HOT) / gap
