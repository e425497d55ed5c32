"""Recipes by which heat sets the shape of a tube: of nitinol alone, and what is needed instead for another metal."""

from __future__ import annotations

import logging
import re
from dataclasses import dataclass

from ..constants import ZERO_CELSIUS
from ..errors import InputError
from ..robots.materials import Material

LOGGER = logging.getLogger(__name__)

NITINOL_NAMES = re.compile(r"nitinol|ni-?ti\b|ti-?ni\b|nickel.titanium", re.IGNORECASE)

OTHER_NAMES = re.compile(r"steel|titan|alumin|brass|copper|cobalt|inconel|tungsten|magnesium", re.IGNORECASE)

NITINOL_DENSITY = 6200.0, 6700.0
"""kg/m^3: 6450 (SMA Inc., Selected Properties of NiTi); steels have 7700 and more, titanium 4500."""

NITINOL_STIFFNESS = 20e9, 95e9
"""Young's modulus, Pa, of martensite and austenite: 28 to 83 GPa (SMA Inc.), with some to spare; steels: 190 GPa."""

METAL = 10e9
"""Young's modulus, Pa, below which nothing is a metal."""


@dataclass(frozen=True)
class Recipe:
    """Temperatures, degC, at which a metal is set."""

    metal: str
    usual: tuple[float, float]
    """Between which it is set: beyond, it takes the shape badly, or loses its elasticity within a minute."""
    most: float
    """From which on it cannot be set, whatever the time."""
    lost: str
    """What becomes of it there."""


NITINOL_RECIPE = Recipe("nitinol", (400.0, 600.0), 700.0, "it is annealed there and springs back no more")
"""Shape setting at 400 to 550 degC (Pelton, DiCello, Miyazaki, Min. Invas. Ther. & Allied Technol. 9 (2000)), at 500 to
550 degC by the maker of the thesis' tubes; above 700 degC nitinol is annealed, and its cold work is gone."""


def recipe_for(material: Material) -> Recipe:
    """The recipe for a material; raises InputError with what is needed instead where there is none."""
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
        raise InputError(
            f"material {name!r} is not nitinol (Young's modulus {1e-9 * stiffness:.3g} "
            f"GPa{'' if thermal is None else f', {thermal.density:g} kg/m^3'}); heat recipes "
            "exist for nitinol only. Alternatively bend the tube beyond its yield point "
            "over a smaller radius, and relieve its stress"
        )
    return NITINOL_RECIPE


def check_temperatures(material: Material, name: str, low: float, high: float) -> None:
    """Raise InputError where a metal cannot be set at `low` to `high`, degC, which a field of that `name` says; warn
    where that is implausible."""
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


def warn_of_limit(material: Material, limit: float) -> None:
    """Warn of a limit of the temperature, degC, at which a metal is no longer what it is to be."""
    recipe = recipe_for(material)
    if limit > recipe.most:
        LOGGER.warning(
            f"limit_degC is {limit:g} degC; it must be at most {recipe.most:g} degC for {recipe.metal}: {recipe.lost}"
        )


def mold_remarks(material: Material, temperature: float) -> tuple[str, ...]:
    """What to keep in mind of a mold in which a tube is set at a temperature, K: why there is no recipe for its
    material; raises InputError where there is one, and the temperature is too high for it."""
    try:
        recipe_for(material)
    except InputError as error:
        return (str(error),)
    degrees = temperature - ZERO_CELSIUS
    check_temperatures(material, "set_temperature", degrees, degrees)
    return ()
