"""Materials of molds, each constant with its source (SI), and recipes for setting the shape of a tube by heat."""

from __future__ import annotations

import logging
import re
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from ..constants import ZERO_CELSIUS
from ..errors import InputError, choice
from ..files.field_metadata import POSITIVE, Absent, OneOf, Range, check_fields, key, unit
from ..robots.materials import Material
from ..typing import Array

INSULATING_RESISTIVITY = 1e3
"""Smallest resistivity (ohm m) of an electrical insulator.

Next to a tube of 1e-6 ohm m with a thousandth of the mold's section, less than 1e-6 of the current leaks into the mold.
"""

AMBIENT_RANGE = Range(minimum=ZERO_CELSIUS - 40.0, maximum=ZERO_CELSIUS + 60.0)
"""Allowed ambient temperatures, K."""

CONDUCTIVITY_AT = 200.0
"""Temperature, degC, at which a material has its `conductivity`."""

LEAST_FACTOR = 0.2
"""Smallest factor of a slope on the conductivity: at no temperature a mold conducts nothing."""

PRICE_CLASSES = ("low", "moderate", "high")


@dataclass(frozen=True)
class MoldMaterial:
    """Mold material, with constants at shape-setting temperatures where the sources give them.

    Raises:
        InputError: a constant is not positive, or the price class is unknown.
    """

    name: Annotated[str, "name in files and on the command line"]
    conductivity: Annotated[
        float, unit("W_per_m_K"), Range(above=0.0, maximum=2500.0), "thermal; with a curve or a slope, at 200 degC"
    ]
    density: Annotated[float, unit("kg_per_m3"), Range(minimum=10.0, maximum=23000.0), "density"]
    heat_capacity: Annotated[float, unit("J_per_kg_K"), Range(above=0.0, maximum=10000.0), "heat capacity"]
    limit_temperature: Annotated[
        float,
        key("limit_degC"),
        Range(above=0.0, maximum=4000.0),
        "limit temperature; above it the mold surface chars, scales or softens",
    ]
    failure: Annotated[str, Absent("fails"), "effect above the limit, in a few words"]
    resistivity: Annotated[float, unit("ohm_m"), POSITIVE, "electrical"]
    emissivity: Annotated[float, Range(above=0.0, maximum=1.0), Absent(0.9), "total"]
    price_class: Annotated[str, OneOf(PRICE_CLASSES), Absent("moderate"), "low, moderate or high"]
    source: Annotated[str, "source of the numbers"]
    expansion: Annotated[float, unit("per_K"), POSITIVE, "mean coefficient of thermal expansion up to 500 degC"] = 8e-6
    heat_capacity_slope: Annotated[
        float, unit("per_K"), "relative change of the heat capacity per K, for oven heating"
    ] = 0.0
    reference_temperature: Annotated[
        float, key("reference_degC"), POSITIVE, "reference temperature of the heat capacity"
    ] = 75.0 + ZERO_CELSIUS
    conductivity_range: Annotated[
        tuple[float, float] | None,
        unit("W_per_m_K"),
        "smallest and largest conductivity of boards of this name; default the uncertainty alone",
    ] = None
    density_range: Annotated[
        tuple[float, float] | None,
        unit("kg_per_m3"),
        "densities of these boards: the densest conducts best; default the density",
    ] = None
    conductivity_curve: Annotated[
        tuple[tuple[float, float], ...],
        unit("W_per_m_K"),
        "pairs of temperature (degC, increasing) and conductivity, as of a data sheet; linear between them, constant "
        "outside, scaled to the conductivity at 200 degC; default constant",
    ] = ()
    conductivity_slope: Annotated[
        float,
        unit("per_K"),
        Range(minimum=-1e-2, maximum=1e-2),
        "relative change of the conductivity per K, in addition to the curve",
    ] = 0.0
    conductivity_slope_range: Annotated[
        tuple[float, float] | None,
        unit("per_K"),
        "smallest and largest slope of boards of this name; default the slope",
    ] = None
    cutting_speed: Annotated[
        float | None,
        unit("m_per_min"),
        Range(minimum=1.0 / 60, maximum=50.0),
        "largest cutting speed of mills and drills, for materials that are cut wet; default none: cut dry, at the "
        "speeds of the machine",
    ] = None

    def __post_init__(self) -> None:
        check_fields(self, f"mold material {self.name!r}")
        owner = f"of mold material {self.name!r}"
        try:
            curve = np.array(self.conductivity_curve, dtype=float).reshape(-1, 2)
        except (TypeError, ValueError):
            curve = np.zeros((1, 2))
        if not np.isfinite(curve).all() or (np.diff(curve[:, 0]) <= 0).any() or (curve[:, 1] <= 0).any():
            raise InputError(
                f"conductivity_curve {owner} must be pairs (degC, W/(m K)) with increasing temperatures and "
                "conductivities above 0"
            )
        object.__setattr__(self, "conductivity_curve", tuple((float(t), float(k)) for t, k in curve))
        slopes = self.conductivity_slope_range
        if slopes is not None and not -1e-2 <= slopes[0] <= self.conductivity_slope <= slopes[1] <= 1e-2:
            raise InputError(
                f"conductivity_slope_range {owner} is {slopes[0]:g} to {slopes[1]:g} per K; it must be within 0.01 per "
                f"K of 0 and include its slope, {self.conductivity_slope:g}"
            )
        for name in ("conductivity", "density"):
            span = getattr(self, f"{name}_range")
            if span is not None and not 0 < span[0] <= getattr(self, name) <= span[1]:
                raise InputError(
                    f"{name}_range of mold material {self.name!r} is {span[0]:g} to {span[1]:g}; it must be above 0 "
                    f"and include its {name}, {getattr(self, name):g}"
                )

    def conductivity_factor(self, temperature: Array | float) -> Array:
        """Conductivity at temperatures in K, as a factor on `conductivity`; at least `LEAST_FACTOR`."""
        degrees = np.asarray(temperature, dtype=float) - ZERO_CELSIUS
        factor = np.asarray(1 + self.conductivity_slope * (degrees - CONDUCTIVITY_AT))
        if self.conductivity_curve:
            at, value = np.array(self.conductivity_curve).T
            factor = factor * np.interp(degrees, at, value) / np.interp(CONDUCTIVITY_AT, at, value)
        return np.maximum(factor, LEAST_FACTOR)

    def sloped(self, draw: float) -> MoldMaterial:
        """This material with the least slope of its conductivity at -1, and the largest one at 1."""
        low, high = self.conductivity_slope_range or (self.conductivity_slope,) * 2
        return replace(self, conductivity_slope=low + 0.5 * (draw + 1) * (high - low))

    def board(self, draw: float) -> MoldMaterial:
        """Board of this material: the lightest and least conductive at -1, the densest and most conductive at 1."""
        spans = {name: getattr(self, f"{name}_range") for name in ("conductivity", "density")}
        # Geometric: a board of twice the conductivity is as likely as one of half.
        drawn = {
            name: min(span[0] * (span[1] / span[0]) ** (0.5 * (draw + 1)), span[1])
            for name, span in spans.items()
            if span is not None
        }
        return replace(self, **drawn)

    @property
    def limit_temperature_degC(self) -> float:
        """The limit temperature in degC."""
        return self.limit_temperature - ZERO_CELSIUS

    @property
    def diffusivity(self) -> float:
        """Thermal diffusivity k / (rho c), m^2/s."""
        return self.conductivity / (self.density * self.heat_capacity)

    @property
    def electrically_insulating(self) -> bool:
        """True if practically no current leaves the tube through the mold."""
        return self.resistivity >= INSULATING_RESISTIVITY


STEEL = MoldMaterial(
    name="steel",
    conductivity=47.3,
    density=7870.0,
    heat_capacity=486.0,
    limit_temperature=570.0 + ZERO_CELSIUS,
    failure="scales quickly",
    resistivity=1.59e-7,
    emissivity=0.79,
    price_class="low",
    expansion=14.2e-6,
    heat_capacity_slope=8.7e-4,
    conductivity_curve=((20.0, 53.3), (800.0, 27.4)),
    cutting_speed=27.0 / 60,
    source="AISI 1018, MatWeb: 7870 kg/m^3, 486 J/(kg K) at 50-100 degC, 1.59e-7 ohm m at 0 degC (annealed). "
    "Conductivity of carbon steel, 54 - 0.0333 T/degC: EN 1993-1-2, section 3.4.1.3 (MatWeb has 51.9 W/(m K) at 100 "
    "degC, the standard 50.7). Limit: wustite forms above 570 degC (Birks, Meier, Pettit, High-Temperature Oxidation "
    "of Metals, 2006); emissivity of oxidised steel, Incropera et al., Table A.11. Expansion from 20 to 525 degC, and "
    "the slope of the heat capacity to 666 J/(kg K) at 500 degC, of carbon steel: EN 1993-1-2, section 3.4.1. Cutting "
    "speed: 90 ft/min of drills of high-speed steel in 1018 of 125 to 175 HB (protocutter.com, Feed Rates: Plain "
    "Carbon and Alloy Steels). Carbide could be faster",
)
"""Low-carbon steel, the mold of the thesis' Figure 4.2."""

MDF = MoldMaterial(
    name="mdf",
    conductivity=0.17,
    density=750.0,
    heat_capacity=1700.0,
    limit_temperature=300.0 + ZERO_CELSIUS,
    failure="chars",
    resistivity=1e8,
    emissivity=0.9,
    price_class="low",
    conductivity_range=(0.15, 0.19),
    conductivity_curve=((20.0, 0.12), (200.0, 0.15), (350.0, 0.07), (500.0, 0.09), (800.0, 0.35)),
    source="0.12-0.15 W/(m K) when cold: Facts about particleboard and MDF (EWPAA). Over temperature as wood and its "
    "char, a quarter more at 200 degC: EN 1995-1-2, Annex B. 750 kg/m^3, 1700 J/(kg K): makeitfrom.com "
    "after Wood Handbook, USDA Forest Service. Limit: charring isotherm 300 degC of EN 1995-1-2. Resistivity of wood "
    "at about 8 % moisture, order of magnitude, Wood Handbook. Emissivity of wood: Incropera et al., Table A.11",
)
"""Medium-density fibreboard, the mold of the thesis' Figure 4.3, which charred."""

GLASS_MICA = MoldMaterial(
    name="glass_mica",
    conductivity=1.46,
    density=2520.0,
    heat_capacity=790.0,
    limit_temperature=800.0 + ZERO_CELSIUS,
    failure="softens",
    resistivity=1e14,
    emissivity=0.8,
    price_class="high",
    expansion=11.2e-6,
    cutting_speed=6.0 / 60,
    source="Macor, Corning data sheet: 1.46 W/(m K), 2520 kg/m^3, 790 J/(kg K), 800 degC continuous use, "
    "1e14 ohm m (more than 1e16 ohm cm) at 25 degC, expansion from 25 to 600 degC; emissivity assumed. No source was "
    "found for the conductivity over temperature: it is constant, within the uncertainty of the rig (20 %). The CRC "
    "Materials Science and Engineering Handbook has 1.2 W/(m K) for such ceramics. Cutting speed of "
    "mills 6.1 to 10.7 m/min, of a drill of 6.4 mm 6 m/min (300 rpm): MACOR machining specifications, pgo-online.com",
)
"""Machinable glass-mica ceramic, the mold of the thesis' Figure 4.4: up to a thousand dollars a slab."""

CALCIUM_SILICATE = MoldMaterial(
    name="calcium_silicate",
    conductivity=0.117,
    density=737.0,
    heat_capacity=1255.0,
    limit_temperature=927.0 + ZERO_CELSIUS,
    failure="loses its strength",
    resistivity=1e7,
    emissivity=0.9,
    price_class="moderate",
    expansion=6e-6,
    conductivity_range=(0.08, 0.29),
    density_range=(450.0, 1200.0),
    conductivity_curve=((24.0, 0.127), (149.0, 0.118), (205.0, 0.117), (316.0, 0.114), (425.0, 0.117), (538.0, 0.124)),
    conductivity_slope_range=(-3e-4, 15e-4),
    source="Density, heat capacity at 200 degC and measured conductivity: data sheet of Marinite I board, BNZ "
    "Materials, as in table 3 of the NIST Parallel Panel experiments (MaCFP, github.com/MaCFP/macfp-db). Boards differ "
    "(0.08 to 0.29 W/(m K), 450 to 1200 kg/m^3): use the data of your board. The conductivity of light ones grows by "
    "15e-4 per K: 0.055, 0.074, 0.098 W/(m K) at 25, 200, 400 degC, 240 kg/m^3 (ASTM C533, from secondary sources). "
    "That of crystalline ones falls; that of Marinite I by 4e-4 per K up to 316 degC. Limit 927 degC (1700 degF) of "
    "ASTM C656. Resistivity of dry board is an order of magnitude; emissivity and expansion are assumptions",
)
"""Machinable calcium silicate board, the mold of the thesis' Figure 4.5."""

MOLD_MATERIALS = {material.name: material for material in (STEEL, MDF, GLASS_MICA, CALCIUM_SILICATE)}
"""The materials of molds by name."""


def mold_material(name: str) -> MoldMaterial:
    """The mold material of that name; raises InputError with the names that there are."""
    return MOLD_MATERIALS[choice("mold material", name, MOLD_MATERIALS)]


# --- recipes: of nitinol alone, and what is needed instead for another metal ------------------------------------------


LOGGER = logging.getLogger(__name__)

NITINOL_NAMES = re.compile(r"nitinol|ni-?ti\b|ti-?ni\b|nickel.titanium", re.IGNORECASE)

OTHER_NAMES = re.compile(
    r"steel|titan|alumin|brass|copper|cobalt|mp35n|elgiloy|conichrome|inconel|tungsten|magnesium", re.IGNORECASE
)

NITINOL_DENSITY = 6200.0, 6700.0
"""Densities of nitinol, kg/m^3: 6450 (SMA Inc., Selected Properties of NiTi).

Steels have 7700 and more, titanium 4500.
"""

NITINOL_STIFFNESS = 20e9, 95e9
"""Young's modulus, Pa, of martensite and austenite: 28 to 83 GPa (SMA Inc.), with some to spare; steels: 190 GPa."""

METAL = 10e9
"""Young's modulus, Pa, below which nothing is a metal."""


@dataclass(frozen=True)
class Recipe:
    """Temperatures for setting the shape of a metal, degC."""

    metal: str
    usual: tuple[float, float]
    """Usual range of the setting temperature. Outside it the metal takes the shape badly, or soon loses its
    elasticity."""
    most: float
    """Temperature, degC, above which the shape cannot be set, whatever the time."""
    lost: str
    """Damage to the metal above this temperature, as text."""


SUPERELASTIC = -20.0, 37.0
"""Af, degC, of nitinol that is superelastic in the body: below body temperature; and not more than 57 K below it, where
the stress at which martensite forms, 6.5 MPa/K above Af, is that of slip (Duerig, Pelton, Stoeckel, Mater. Sci. Eng. A
273-275 (1999))."""

NEEDED = {
    "steel": "1 h at 350 to 400 degC, of austenitic steels",
    "titan": "1 to 4 h at 480 to 650 degC in vacuum or argon, of Ti-6Al-4V",
    "cobalt|mp35n|elgiloy|conichrome": "4 to 5 h at 480 to 540 degC, which also hardens cold-worked Co-Cr-Ni alloys",
    "brass|copper": "1 h at 200 to 275 degC",
    "alumin": "none; bend it solution-treated (T4), and age it afterwards",
    "inconel": "1 h at 760 to 870 degC, of solution-strengthened nickel alloys",
}
"""Usual stress relief of metals, by what their names contain (ASM Handbook, vol. 4, Heat Treating)."""

NITINOL_RECIPE = Recipe("nitinol", (400.0, 600.0), 700.0, "it is annealed there and springs back no more")
"""Shape setting at 400 to 550 degC (Pelton, DiCello, Miyazaki, Min. Invas. Ther. & Allied Technol. 9 (2000)), at 500 to
550 degC by the maker of the thesis' tubes; above 700 degC nitinol is annealed, and its cold work is gone."""


def recipe_for(material: Material) -> Recipe:
    """Recipe for a material; raises InputError with the required input if there is none."""
    name, stiffness, thermal = material.name, material.youngs_modulus, material.thermal
    if stiffness < METAL:
        raise InputError(
            f"{name} has no thermal constants, and its Young's modulus of "
            f"{1e-9 * stiffness:.2g} GPa is not that of a metal; it cannot be heated by "
            "current, and heat recipes exist for nitinol only"
        )
    if NITINOL_NAMES.search(name):
        if not NITINOL_STIFFNESS[0] <= stiffness <= NITINOL_STIFFNESS[1]:
            LOGGER.warning(
                f"material {name!r} has a Young's modulus of {1e-9 * stiffness:.3g} GPa; nitinol has 20 to 95 GPa"
            )
        return NITINOL_RECIPE
    low, high = NITINOL_DENSITY
    by_density = thermal is not None and low <= thermal.density <= high
    by_stiffness = thermal is None and NITINOL_STIFFNESS[0] <= stiffness <= NITINOL_STIFFNESS[1]
    # Aluminium and brass are about as stiff, but called so.
    if OTHER_NAMES.search(name) or not (by_density or by_stiffness):
        relief = next((words for pattern, words in NEEDED.items() if re.search(pattern, name, re.IGNORECASE)), "")
        raise InputError(
            f"material {name!r} is not nitinol (Young's modulus {1e-9 * stiffness:.3g} "
            f"GPa{'' if thermal is None else f', {thermal.density:g} kg/m^3'}); heat recipes "
            "exist for nitinol only. Alternatively bend the tube beyond its yield point "
            "over a smaller radius, and relieve its stress" + (f": {relief}" if relief else "")
        )
    return NITINOL_RECIPE


def check_temperatures(material: Material, name: str, low: float, high: float) -> None:
    """Raise InputError for a metal that cannot be set at `low` to `high`, degC; warn where that is implausible.

    The message has the field `name`.
    """
    recipe = recipe_for(material)
    given = f"{high:g} degC" if low == high else f"{low:g} to {high:g} degC"
    least, most = recipe.usual
    if high > recipe.most:
        cooler, hotter = low - ZERO_CELSIUS, high - ZERO_CELSIUS
        in_celsius = f"{cooler:g}" if cooler == hotter else f"{cooler:g} to {hotter:g}"
        hint = f"; if these are K, give {in_celsius} degC" if least <= cooler <= hotter <= most else ""
        raise InputError(
            f"{name} is {given}; it must be at most {recipe.most:g} degC for {recipe.metal}: {recipe.lost}{hint}"
        )
    if low < least or high > most:
        LOGGER.warning(f"{name} is {given}; {recipe.metal} is shape-set at {least:g} to {most:g} degC")
    finish = None if material.thermal is None else material.thermal.austenite_finish
    if finish is not None and not SUPERELASTIC[0] <= finish - ZERO_CELSIUS <= SUPERELASTIC[1]:
        coldest, hottest = SUPERELASTIC
        LOGGER.warning(
            f"austenite_finish_degC of {material.name!r} is {finish - ZERO_CELSIUS:.0f}; it must be {coldest:g} to "
            f"{hottest:g} degC for a tube that is superelastic in the body"
        )


def warn_of_limit(material: Material, limit: float) -> None:
    """Warn of a temperature limit, degC, that damages a metal."""
    recipe = recipe_for(material)
    if limit > recipe.most:
        LOGGER.warning(
            f"limit_degC is {limit:g} degC; it must be at most {recipe.most:g} degC for {recipe.metal}: {recipe.lost}"
        )


def mold_remarks(material: Material, temperature: float) -> tuple[str, ...]:
    """Remarks on a mold for setting a tube at a temperature, K: the reason for a missing recipe.

    Raises InputError if there is a recipe and the temperature is too high for it.
    """
    try:
        recipe_for(material)
    except InputError as error:
        return (str(error),)
    degrees = temperature - ZERO_CELSIUS
    check_temperatures(material, "set_temperature", degrees, degrees)
    return ()
