"""Linear-elastic tube materials, and their thermal data for heating (SI)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

from ..constants import ZERO_CELSIUS
from ..display import Displayed
from ..errors import InputError, instance, without_unit_warnings
from ..files.field_metadata import POSITIVE, Named, Range, Typical, check_fields, check_size, key, unit


@dataclass(frozen=True)
class ThermalData:
    """Thermal and electrical constants of a tube material; a `_slope` is the relative change per K.

    A property with a slope is value * (1 + slope * (T - reference_temperature)).

    Raises:
        InputError: a constant is not positive, a slope is not finite, or the emissivity is above 1.
    """

    density: Annotated[float, unit("kg_per_m3"), Range(minimum=100.0, maximum=23000.0)]
    heat_capacity: Annotated[float, unit("J_per_kg_K"), Range(above=0.0, maximum=10000.0)]
    conductivity: Annotated[float, unit("W_per_m_K"), Range(above=0.0, maximum=2500.0), "thermal conductivity"]
    resistivity: Annotated[float, unit("ohm_m"), POSITIVE, Typical(1e-9, 1e-4), "electrical resistivity"]
    expansion: Annotated[float, unit("per_K"), POSITIVE, Typical(1e-7, 1e-3), "coefficient of thermal expansion"]
    emissivity: Annotated[float, Range(above=0.0, maximum=1.0), "total emissivity"]
    heat_capacity_slope: Annotated[float, unit("per_K"), "relative change of the property per K"] = 0.0
    conductivity_slope: Annotated[float, unit("per_K"), "relative change of the property per K"] = 0.0
    resistivity_slope: Annotated[float, unit("per_K"), "relative change of the property per K"] = 0.0
    reference_temperature: Annotated[
        float, key("reference_degC"), POSITIVE, "reference temperature of the properties"
    ] = 25.0 + ZERO_CELSIUS
    austenite_finish: Annotated[
        float | None,
        key("austenite_finish_degC"),
        POSITIVE,
        "austenite finish temperature (Af) of nitinol, as delivered or measured; default unknown",
    ] = None

    def __post_init__(self) -> None:
        check_fields(self)

    def at(self, name: str, temperature: float) -> float:
        """The property of that name at a temperature, K, in SI."""
        slope = getattr(self, f"{name}_slope") * (temperature - self.reference_temperature)
        return float(getattr(self, name) * (1 + slope))


THERMAL_DATA = {
    "nitinol": ThermalData(
        density=6450.0,
        heat_capacity=470.0,
        heat_capacity_slope=2.5e-4,
        conductivity=18.0,
        resistivity=0.82e-6,
        resistivity_slope=5e-4,
        expansion=11e-6,
        emissivity=0.5,
    ),
    "stainless_steel": ThermalData(
        density=8000.0,
        heat_capacity=500.0,
        heat_capacity_slope=2.5e-4,
        conductivity=16.2,
        conductivity_slope=7e-4,
        resistivity=0.72e-6,
        resistivity_slope=9e-4,
        expansion=17.2e-6,
        emissivity=0.5,
    ),
}
"""Thermal data of metals, by names that a material in a file may use instead of its own data.

Nitinol (austenite): density, conductivity and expansion from SMA Inc., Selected Properties of NiTi. Resistivity:
suppliers give 0.82 (austenite, the usual data sheet) to 1.0 micro-ohm m (SMA Inc.); the slope is assumed, calibrate:
with it the lower value at 25 degC becomes 1.03 at 525 degC. Heat capacity: 3R per mole of atoms (Dulong and Petit) is
468 J/(kg K); the slope is assumed. The 837 J/(kg K) (0.20 cal/(g K)) of many data sheets is 1.8 times that of a solid
of these atoms. Emissivity of the oxidised surface: assumed, calibrate.

Stainless steel 304: AK Steel, 304/304L Stainless Steel Product Data Bulletin: density 8.03 g/cm3, heat capacity 500
J/(kg K) from 0 to 100 degC, conductivity 16.2 W/(m K) at 100 and 21.5 at 500 degC, resistivity 0.72 micro-ohm m at
20 degC, expansion 16.9 to 18.7e-6; slopes of heat capacity and resistivity (1.0 micro-ohm m near 500 degC) and the
emissivity: assumed, calibrate."""


# Least and greatest Young's modulus, Pa, of metals by what is in their names: of nitinol from half of martensite's
# (20 to 50 GPa) to austenite's (up to 90 GPa), of steels by their handbooks.
USUAL_MODULUS = {"nitinol": (10e9, 90e9), "niti": (10e9, 90e9), "steel": (150e9, 220e9)}

# Of materials that are cycled, or spring back.
STRAIN = Typical(5e-4, 0.5)

# The same of a material of another name: from soft plastics on. What is stiffer may be a model's.
SOLID = (1e7, math.inf)


@dataclass(frozen=True)
class Material(Displayed):
    """An isotropic, linear-elastic tube material.

    Poisson's ratio E / (2 G) - 1 lies in [0, 1/2), so E/3 < G <= E/2.

    Raises:
        InputError: a modulus or strain is not positive, or Poisson's ratio lies outside [0, 1/2).
    """

    name: Annotated[str, "name of the material"]
    youngs_modulus: Annotated[float, unit("GPa"), POSITIVE, Typical(1e8, 5e11), "E"]
    shear_modulus: Annotated[
        float, unit("GPa"), POSITIVE, Typical(3e7, 2e11), "shear modulus G; alternatively Poisson's ratio"
    ]
    working_strain: Annotated[float, unit("percent"), POSITIVE, STRAIN, "strain limit for unlimited cycles"] = 0.01
    superelastic_strain: Annotated[float, unit("percent"), POSITIVE, STRAIN, "strain limit of superelasticity"] = 0.06
    thermal: Annotated[
        ThermalData | None,
        Named(THERMAL_DATA),
        "thermal constants, or the name of the metal",
    ] = None

    def __post_init__(self) -> None:
        instance("name of a material", self.name, str)
        label = f"material {self.name!r}"
        with without_unit_warnings():  # of moduli a robot warns, by the name of the metal: those of a model may be any
            check_fields(self, label)
        for name in ("working_strain", "superelastic_strain"):
            check_size(f"{name} of {label}", getattr(self, name), STRAIN, "percent")
        if not -1e-9 <= self.poisson_ratio < 0.5:
            raise InputError(
                f"shear_modulus of material {self.name!r} is {self.shear_modulus:g} Pa, which makes Poisson's ratio "
                f"{self.poisson_ratio:.3g}; it must lie in [0, 0.5), so the modulus between E/3 and E/2 "
                f"({self.youngs_modulus / 3:g} to {self.youngs_modulus / 2:g} Pa)"
            )

    @property
    def poisson_ratio(self) -> float:
        """Poisson's ratio nu = E / (2 G) - 1."""
        return self.youngs_modulus / (2.0 * self.shear_modulus) - 1.0

    @classmethod
    def from_poisson_ratio(cls, name: str, youngs_modulus: float, poisson_ratio: float) -> Material:
        """Material with shear modulus E / (2 (1 + nu)); raises InputError as the constructor does."""
        if not 0.0 <= poisson_ratio < 0.5:
            raise InputError(f"poisson_ratio of material {name!r} is {poisson_ratio:g}; it must lie in [0, 0.5)")
        return cls(name, youngs_modulus, youngs_modulus / (2.0 * (1.0 + poisson_ratio)))


NITINOL = Material(
    "nitinol",
    youngs_modulus=58e9,
    shear_modulus=21.5e9,
    thermal=THERMAL_DATA["nitinol"],
)
"""Superelastic nitinol with the moduli of Tables 2.1 and 3.1 of the thesis (nu = 0.3488).

The working strain of 1 % and the recoverable strain of 6 % are the usual figures for superelastic nitinol in fatigue
and in a single loading (Pelton et al., J. Mech. Behav. Biomed. Mater. 1 (2008); Duerig et al., Mater. Sci. Eng. A
273-275 (1999))."""

# Materials that a file may name.
MATERIALS = {NITINOL.name: NITINOL}


def modulus_doubts(material: Material) -> Iterator[str]:
    """Warning of a Young's modulus that no metal of the material's name has, or no solid."""
    lower, upper = next((bounds for name, bounds in USUAL_MODULUS.items() if name in material.name.lower()), SOLID)
    modulus = material.youngs_modulus
    if not lower <= modulus <= upper:
        bounds = f"{lower:g} to {upper:g}" if upper < math.inf else f"at least {lower:g}"
        guess = f": was {modulus:g} GPa meant?" if lower <= 1e9 * modulus <= upper else ""
        yield (f"youngs_modulus of material {material.name!r} is {modulus:g} Pa; usual is {bounds} Pa{guess}")
