"""Materials of which molds are made: thermal and electrical constants, each with its source (SI)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from ..constants import ZERO_CELSIUS
from ..errors import choice
from ..files.field_metadata import POSITIVE, Absent, OneOf, Range, check_fields, key, unit

INSULATING_RESISTIVITY = 1e3
"""Resistivity (ohm m) from which a mold counts as an electrical insulator: beside a tube of 1e-6 ohm m whose section is
a thousandth of the mold's, less than 1e-6 of the current goes astray."""

ROOM = Range(least=ZERO_CELSIUS - 40.0, most=ZERO_CELSIUS + 60.0)
"""Temperatures of surroundings in which a tube is set, K."""

PRICE_CLASSES = ("low", "moderate", "high")


@dataclass(frozen=True)
class MoldMaterial:
    """Mold material, with constants at shape-setting temperatures where the sources give them.

    Raises:
        InputError: a constant is not positive, or the price class is unknown.
    """

    name: Annotated[str, "name in files and on the command line"]
    conductivity: Annotated[float, unit("W_per_m_K"), Range(above=0.0, most=2500.0), "thermal"]
    density: Annotated[float, unit("kg_per_m3"), Range(least=10.0, most=23000.0), "density"]
    heat_capacity: Annotated[float, unit("J_per_kg_K"), Range(above=0.0, most=10000.0), "heat capacity"]
    limit_temperature: Annotated[
        float,
        key("limit_degC"),
        Range(above=0.0, most=4000.0),
        "limit temperature; above it the mold surface chars, scales or softens",
    ]
    failure: Annotated[str, Absent("fails"), "effect above the limit, in a few words"]
    resistivity: Annotated[float, unit("ohm_m"), POSITIVE, "electrical"]
    emissivity: Annotated[float, Range(above=0.0, most=1.0), Absent(0.9), "total"]
    price_class: Annotated[str, OneOf(PRICE_CLASSES), Absent("moderate"), "low, moderate or high"]
    source: Annotated[str, "source of the numbers"]

    def __post_init__(self) -> None:
        check_fields(self, f"mold material {self.name!r}")

    @property
    def limit_temperature_degC(self) -> float:
        """The limit temperature in degC."""
        return self.limit_temperature - ZERO_CELSIUS

    @property
    def diffusivity(self) -> float:
        """k / (rho c), m^2/s."""
        return self.conductivity / (self.density * self.heat_capacity)

    @property
    def electrically_insulating(self) -> bool:
        """Whether practically no current leaves the tube through the mold."""
        return self.resistivity >= INSULATING_RESISTIVITY


STEEL = MoldMaterial(
    name="steel",
    conductivity=51.9,
    density=7870.0,
    heat_capacity=486.0,
    limit_temperature=570.0 + ZERO_CELSIUS,
    failure="scales quickly",
    resistivity=1.59e-7,
    emissivity=0.79,
    price_class="low",
    source="AISI 1018, MatWeb: 51.9 W/(m K), 7870 kg/m^3, 486 J/(kg K) at 50-100 degC, 1.59e-7 ohm m at 0 degC "
    "(annealed); limit: wustite forms above 570 degC (Birks, Meier, Pettit, High-Temperature Oxidation of Metals, "
    "2006); emissivity of oxidised steel, Incropera et al., Table A.11",
)
"""Low-carbon steel, the mold of the thesis' Figure 4.2."""

MDF = MoldMaterial(
    name="mdf",
    conductivity=0.14,
    density=750.0,
    heat_capacity=1700.0,
    limit_temperature=300.0 + ZERO_CELSIUS,
    failure="chars",
    resistivity=1e8,
    emissivity=0.9,
    price_class="low",
    source="0.12-0.15 W/(m K): Facts about particleboard and MDF (EWPAA). 750 kg/m^3, 1700 J/(kg K): makeitfrom.com "
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
    source="Macor, Corning data sheet: 1.46 W/(m K), 2520 kg/m^3, 790 J/(kg K), 800 degC continuous use, "
    "1e14 ohm m (more than 1e16 ohm cm) at 25 degC; emissivity assumed",
)
"""Machinable glass-mica ceramic, the mold of the thesis' Figure 4.4: up to a thousand dollars a slab."""

CALCIUM_SILICATE = MoldMaterial(
    name="calcium_silicate",
    conductivity=0.12,
    density=737.0,
    heat_capacity=1255.0,
    limit_temperature=927.0 + ZERO_CELSIUS,
    failure="loses its strength",
    resistivity=1e7,
    emissivity=0.9,
    price_class="moderate",
    source="Density, conductivity and heat capacity as usually quoted for Marinite I board (BNZ Materials) at 200 "
    "degC. Boards differ (0.08 to 0.29 W/(m K), 450 to 1200 kg/m^3): use the data of your board. Limit 927 degC "
    "(1700 degF) of ASTM C656. Resistivity of dry board is an order of magnitude, emissivity an assumption",
)
"""Machinable calcium silicate board, the mold of the thesis' Figure 4.5."""

MOLD_MATERIALS = {material.name: material for material in (STEEL, MDF, GLASS_MICA, CALCIUM_SILICATE)}
"""The materials of molds by name."""


def mold_material(name: str) -> MoldMaterial:
    """The mold material of that name; raises InputError with the names that there are."""
    return MOLD_MATERIALS[choice("mold material", name, MOLD_MATERIALS)]
