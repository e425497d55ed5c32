"""The rig that heats a tube by its own resistance: battery, circuit, clamps, mold, surroundings (SI).

Gilbert and Webster, Rapid, reliable shape setting of superelastic nitinol for prototyping robots, IEEE Robotics and
Automation Letters 1 (2016); thesis, section 4.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from ...errors import InputError, finite, instance, numbers, positive
from ...robots.materials import ZERO_CELSIUS
from ...robots.tubes import Tube
from ..mold.materials import CALCIUM_SILICATE, MoldMaterial, mold_material

COUNTS = 255
"""The largest duty of an 8-bit PWM: always on."""

AMPERE_HOUR = 3600.0
"""1 A h in C."""

HOT = 500.0
"""Rise over ambient, K, at which the heat transfer of tubes into air is taken; in free convection it changes with the
sixth root of it."""

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
"""(state of charge, V) of a rested 12 V flooded lead-acid battery: Trojan Battery Company, User's Guide."""


def _check(owner: str, what: Any, zero: tuple[str, ...] = ()) -> None:
    """Make every float of a dataclass positive (not negative for `zero`), or raise InputError naming it."""
    for item in fields(what):
        value = getattr(what, item.name)
        if isinstance(value, (int, float)) or item.type == "float":
            checked = positive(f"{item.name} of the {owner}", value, zero=item.name in zero)
            object.__setattr__(what, item.name, checked)


@dataclass(frozen=True)
class Battery:
    """A lead-acid battery: open-circuit voltage over charge, a resistance, and a sag that builds up under load.

    Args:
        capacity: C (1 A h = 3600 C).
        state_of_charge: in (0, 1].
        open_circuit: pairs (state of charge, V), both increasing; linear between them.
        internal_resistance: ohm, at once.
        sag_resistance: ohm, on top of it once the sag has built up.
        sag_time: s, in which it does, to 63 %.

    Raises:
        InputError: a value is out of its range, or the table is not increasing.
    """

    capacity: float = 60.0 * AMPERE_HOUR
    state_of_charge: float = 1.0
    open_circuit: tuple[tuple[float, float], ...] = OPEN_CIRCUIT
    internal_resistance: float = 0.008
    sag_resistance: float = 0.006
    sag_time: float = 30.0

    def __post_init__(self) -> None:
        _check("battery", self, zero=("sag_resistance",))
        if self.state_of_charge > 1:
            raise InputError(f"state_of_charge of the battery is {self.state_of_charge:g}; it must be at most 1")
        try:
            table = np.array(self.open_circuit, dtype=float)
        except (TypeError, ValueError):
            table = np.zeros(0)
        if table.ndim != 2 or table.shape[1] != 2 or len(table) < 2 or not np.isfinite(table).all():
            raise InputError("open_circuit of the battery must be at least 2 pairs (state of charge, voltage)")
        if (np.diff(table[:, 0]) <= 0).any() or (np.diff(table[:, 1]) <= 0).any() or (table[:, 1] <= 0).any():
            raise InputError("open_circuit of the battery must increase in charge and in voltage, and be above 0 V")
        object.__setattr__(self, "open_circuit", tuple((float(s), float(v)) for s, v in table))

    @property
    def voltage(self) -> float:
        """Open-circuit voltage at the state of charge, V: what a voltmeter shows before heating."""
        table = np.array(self.open_circuit)
        return float(np.interp(self.state_of_charge, table[:, 0], table[:, 1]))

    @property
    def voltage_slope(self) -> float:
        """Change of the open-circuit voltage with the state of charge, below where it stands, V."""
        table = np.array(self.open_circuit)
        k = min(max(int(np.searchsorted(table[:, 0], self.state_of_charge)), 1), len(table) - 1)
        return float((table[k, 1] - table[k - 1, 1]) / (table[k, 0] - table[k - 1, 0]))

    def charge_at(self, voltage: float) -> float:
        """State of charge that belongs to an open-circuit voltage; raises InputError outside of the table."""
        table = np.array(self.open_circuit)
        if not table[0, 1] <= finite("voltage", voltage) <= table[-1, 1]:
            raise InputError(f"voltage is {voltage:g} V; it must be {table[0, 1]:g} to {table[-1, 1]:g} V")
        return float(np.interp(voltage, table[:, 1], table[:, 0]))


@dataclass(frozen=True)
class Circuit:
    """What lies between battery and tube, and what it bears.

    Args:
        cable_resistance: of all cables, ohm.
        contact_resistance: of both clamps on the tube together, ohm.
        mosfet_resistance: R_DS(on), ohm.
        pwm_frequency: Hz.
        current_limit: of the mean current, A.
        peak_limit: of the current while the MOSFET conducts, A.
    """

    cable_resistance: float = 0.005
    contact_resistance: float = 0.004
    mosfet_resistance: float = 0.002
    pwm_frequency: float = 490.0
    current_limit: float = 40.0
    peak_limit: float = 200.0

    def __post_init__(self) -> None:
        _check("circuit", self, zero=("cable_resistance", "contact_resistance", "mosfet_resistance"))

    @property
    def resistance(self) -> float:
        """Everything in series with the tube but the battery, ohm."""
        return self.cable_resistance + self.contact_resistance + self.mosfet_resistance


@dataclass(frozen=True)
class Clamps:
    """The two equal clamps, each a lump of metal that warms up.

    Args:
        mass: of one, kg.
        heat_capacity: J/(kg K).
        area: of the surface of one that cools in air, m^2.
        contact_conductance: between tube and clamp, W/(m^2 K).
        grip: length of tube in each clamp, m.
        clearance: bare tube between clamp and mold at each end, m.
    """

    mass: float = 0.05
    heat_capacity: float = 896.0
    area: float = 4e-3
    contact_conductance: float = 3000.0
    grip: float = 10e-3
    clearance: float = 5e-3

    def __post_init__(self) -> None:
        _check("clamps", self)


@dataclass(frozen=True)
class MoldBed:
    """The mold as the tube's surroundings.

    Args:
        material: what it is made of, or its name.
        width, thickness: of both plates together, m; as much material as surrounds the tube.
        lead: straight tube in the mold on each side of the curved part, m.
        gap: of air between tube and groove, m: what limits the heat that enters the mold at first.
        leak_resistance: electrical, of the tube's surface against a mold that conducts, ohm m^2.
        vents: fraction of the tube's surface that the top plate leaves open along the covered part: one number, or
            several at equal distances from the end of the mold to its middle.
    """

    material: MoldMaterial = CALCIUM_SILICATE
    width: float = 0.1
    thickness: float = 25.4e-3
    lead: float = 20e-3
    gap: float = 50e-6
    leak_resistance: float = 1e-6
    vents: tuple[float, ...] = (0.0,)

    def __post_init__(self) -> None:
        _check("mold", self)
        if isinstance(self.material, str):
            object.__setattr__(self, "material", mold_material(self.material))
        instance("material of the mold", self.material, MoldMaterial)
        vents = numbers("vents of the mold", self.vents)
        if not vents or min(vents) < 0 or max(vents) > 0.5:
            raise InputError(f"vents of the mold are {list(vents)}; they must be fractions from 0 to 0.5")
        object.__setattr__(self, "vents", vents)

    @property
    def radius(self) -> float:
        """Of the cylinder with the same cross-section, which stands for the plates, m."""
        return math.sqrt(self.width * self.thickness / math.pi)


@dataclass(frozen=True)
class Rig:
    """A battery-driven shape-setting rig, the same at both ends of the tube.

    Args:
        battery, circuit, clamps, mold: the parts.
        ambient: temperature, K.
        convection: heat transfer coefficient of bare surfaces in air, W/(m^2 K); None computes that of the tube.
        loss_factor: scales all that the tube loses to mold and air; 1 uncalibrated.
        resistivity_factor: scales the tube's resistivity; 1 uncalibrated.
        tube: the tube that is usually heated on it, or None.
        name: for headings.

    Raises:
        InputError: a part is missing, or a value is out of its range.
    """

    battery: Battery = field(default_factory=Battery)
    circuit: Circuit = field(default_factory=Circuit)
    clamps: Clamps = field(default_factory=Clamps)
    mold: MoldBed = field(default_factory=MoldBed)
    ambient: float = 25.0 + ZERO_CELSIUS
    convection: float | None = None
    loss_factor: float = 1.0
    resistivity_factor: float = 1.0
    tube: Tube | None = None
    name: str = ""

    def __post_init__(self) -> None:
        parts = {"battery": Battery, "circuit": Circuit, "clamps": Clamps, "mold": MoldBed}
        for name, kind in parts.items():
            value = getattr(self, name)
            if not isinstance(value, kind):
                raise InputError(f"{name} of the rig is {value!r}; it must be a {kind.__name__}, no rig works without")
        for name in ("ambient", "loss_factor", "resistivity_factor"):
            object.__setattr__(self, name, positive(f"{name} of the rig", getattr(self, name)))
        if self.tube is not None:
            instance("tube of the rig", self.tube, Tube)
        if self.convection is not None:
            object.__setattr__(self, "convection", positive("convection of the rig", self.convection))

    def with_charge(self, state_of_charge: float) -> Rig:
        """The same rig with its battery at another state of charge."""
        return replace(self, battery=replace(self.battery, state_of_charge=state_of_charge))


def natural_convection(diameter: float, surface: float, ambient: float) -> float:
    """Heat transfer coefficient (W/(m^2 K)) of a horizontal cylinder in still air.

    Churchill and Chu, Int. J. Heat Mass Transfer 18 (1975), with the air's properties at the film temperature after
    Sutherland's laws at 1 atm.

    Args:
        diameter: m.
        surface, ambient: temperatures, K.
    """
    film = 0.5 * (surface + ambient)
    viscosity = 1.458e-6 * film**1.5 / (film + 110.4)
    conductivity = air_conductivity(film)
    density = 101325.0 / (287.05 * film)
    prandtl = viscosity * 1030.0 / conductivity
    buoyancy = 9.80665 * abs(surface - ambient) / film * diameter**3
    rayleigh = buoyancy * (density / viscosity) ** 2 * prandtl
    nusselt = (0.60 + 0.387 * rayleigh ** (1 / 6) / (1 + (0.559 / prandtl) ** (9 / 16)) ** (8 / 27)) ** 2
    return float(nusselt * conductivity / diameter)


def air_conductivity(temperature: float) -> float:
    """Thermal conductivity of air, W/(m K), at a temperature in K (Sutherland's law, U.S. Standard Atmosphere 1976)."""
    return float(2.64638e-3 * temperature**1.5 / (temperature + 245.4 * 10.0 ** (-12.0 / temperature)))


def gap_conductance(gap: float, ambient: float) -> float:
    """Heat transfer, W/(m^2 K), through a gap of air (m) between a hot tube and a mold near `ambient` (K)."""
    return air_conductivity(ambient + 0.5 * HOT) / gap
