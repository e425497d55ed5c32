"""The numbers of the thermal model for tubes on rigs: grids, properties, and batches of perturbed rigs.

The physics is that of `physics.heat`. The PWM period is far below every time constant of the tube, so the duty counts
as a mean power; `HeatingPlan.pwm_ripple` says how far that is true.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from ...constants import STEFAN_BOLTZMANN, ZERO_CELSIUS
from ...errors import InputError
from ...physics.heat import CLEARANCE, CURVED, GRIP, LEAD, PROPERTIES, Properties, Resolution, zones
from ...physics.heat_functions import volumes_function
from ...robots.materials import ThermalData
from ...robots.tubes import Tube
from ...typing import Array
from .groove_air import Lie, even_gap
from .rig import HOT, Rig, air_conductivity, gap_conductance, natural_convection

SURFACE_TRANSFER = 10.0
"""Heat transfer of the outer surfaces of clamps and mold, W/(m^2 K): free convection of plates and radiation near room
temperature, assumed; they hardly warm up."""

GRADED = 12e-3
"""Length, m, in which the curved part gets as many cells as it would if it were no longer."""

DECAYS = 3.0
"""Decay lengths in which the clamp gets as many cells as it would if it were no longer."""

COARSE = Resolution(grip=4)
PROGRAM = Resolution(2, 3, 4, 6, 4)
"""For the optimal control problem, whose bounds are then shifted by the difference from the fine model."""

FINE = Resolution(8, 6, 14, 18, 14)
"""The bare tube beside a clamp is the hottest point in a mold that draws much: half as many cells in the clamp make it
4 K too hot there."""


def cell_widths(tube: Tube, rig: Rig, resolution: Resolution) -> Array:
    """(n,) m. Uniform in clearance and lead; graded towards the middle in the curved part, and in the clamp, where the
    temperature falls within the decay length of a fin, away from its edge."""
    lengths = half_lengths(tube, rig)
    fractions = cell_fractions(resolution, lengths, contact_decay(tube, rig))
    return np.asarray(fractions * np.array(lengths)[zones(resolution)])


def cell_fractions(resolution: Resolution, lengths: Sequence[float], decay: float) -> Array:
    """(n,) width of each cell as a fraction of its zone; the zones' lengths and the decay in the clamp in m."""
    grip = np.diff(_graded(resolution.grip, DECAYS * decay / lengths[GRIP]))[::-1]
    uniform = [np.full(n, 1.0 / n) for n in (resolution.clearance, resolution.lead)]
    return np.concatenate([grip, *uniform, np.diff(_graded(resolution.curved, GRADED / lengths[CURVED]))])


def _graded(cells: int, slope: float) -> Array:
    """(cells + 1,) faces from 0 to 1 whose first cells are `slope` times as wide as uniform ones."""
    at = np.linspace(0.0, 1.0, cells + 1)
    if slope > 0.999:
        return at
    stretch = float(scipy.optimize.brentq(lambda a: a / math.sinh(a) - slope, 1e-3, 50.0))
    return np.asarray(np.sinh(stretch * at) / math.sinh(stretch))


def contact_decay(tube: Tube, rig: Rig) -> float:
    """Length in which the tube takes the temperature of a clamp, m."""
    per_length = rig.clamps.contact_conductance * math.pi * tube.outer_diameter
    return math.sqrt(thermal_data(tube).conductivity * tube.cross_section / per_length)


def thermal_data(tube: Tube) -> ThermalData:
    """The tube's thermal data; raises InputError where its material has none."""
    if tube.material.thermal is None:
        raise InputError(f"material {tube.material.name!r} has no thermal data; they are required to heat a tube")
    return tube.material.thermal


@dataclass(frozen=True, eq=False)
class ThermalModel:
    """The numbers of the finite-volume model of half a tube, for B members at once; n cells."""

    resolution: Resolution
    """The grid."""
    position: Array
    """(n,) middle of each cell from the outer end of the clamp, m."""
    width: Array
    """(n,) of each cell, m."""
    half_length: float
    """m."""
    properties: Array
    """(B, P) by the names of `physics.heat.PROPERTIES`."""
    volumes: Array
    """(B, V) columns of `physics.heat.Volumes`."""

    @property
    def members(self) -> int:
        """B."""
        return len(self.properties)

    @property
    def ambient(self) -> float:
        """K, that of the first member."""
        return float(self.surroundings[0])

    @property
    def surroundings(self) -> Array:
        """(B,) ambient temperature of every member, K."""
        return np.asarray(self.properties[:, PROPERTIES.index("ambient")])

    @property
    def zone(self) -> NDArray[np.intp]:
        """(n,) GRIP, CLEARANCE, LEAD or CURVED."""
        return zones(self.resolution)

    @property
    def curved(self) -> NDArray[np.bool_]:
        """(n,) which cells belong to the curved part."""
        return np.asarray(self.zone == CURVED)

    @property
    def full_position(self) -> Array:
        """(2n,) positions of the cells of the whole tube, m."""
        return np.concatenate([self.position, 2 * self.half_length - self.position[::-1]])


def stack(models: Sequence[ThermalModel]) -> ThermalModel:
    """Models on the same grid as the members of one."""
    columns = [np.vstack([m.properties for m in models]), np.vstack([m.volumes for m in models])]
    return replace(models[0], properties=columns[0], volumes=columns[1])


def vent_profile(rig: Rig, fraction: Array) -> Array:
    """Vents at `fraction` (c,) of the way from the end of the mold to its middle."""
    vents = np.array(rig.mold.vents)
    places = np.linspace(0.0, 1.0, len(vents)) if len(vents) > 1 else np.zeros(1)
    return np.asarray(np.interp(fraction, places, vents))


def covered_fraction(tube: Tube, rig: Rig, resolution: Resolution) -> Array:
    """(c,) places of the covered cells on the way from the end of the mold (0) to its middle (1)."""
    lengths, zone = half_lengths(tube, rig), zones(resolution)
    width = cell_widths(tube, rig, resolution)
    place = np.cumsum(width) - 0.5 * width - lengths[GRIP] - lengths[CLEARANCE]
    return np.asarray(place[zone >= LEAD] / (lengths[LEAD] + lengths[CURVED]))


def shell_radii(rig: Rig, tube: Tube, shells: int) -> tuple[Array, Array]:
    """Faces (M+1,) and nodes (M,) of the shells, m; geometric, since a hot wire's field is linear in log r."""
    inner, outer = 0.5 * tube.outer_diameter, rig.mold.radius
    if outer < 2 * inner:
        raise InputError(
            f"the mold is {rig.mold.width * 1e3:g} mm by {rig.mold.thickness * 1e3:g} mm; that is too small to "
            f"surround a tube of {tube.outer_diameter * 1e3:g} mm"
        )
    faces = np.geomspace(inner, outer, shells + 1)
    return faces, np.sqrt(faces[:-1] * faces[1:])


class HalfLengths(NamedTuple):
    """Lengths of half the tube, from a clamp to its middle, m; in the order of the zones of `physics.heat`."""

    grip: float
    clearance: float
    lead: float
    curved: float


def half_lengths(tube: Tube, rig: Rig) -> HalfLengths:
    """Lengths of the zones from the clamp to the middle of the curved part, m; raises InputError without a curve."""
    if tube.curved_length <= 0:
        raise InputError(f"curved_length is {tube.curved_length:g} m; a tube to be shape-set must have a curved part")
    return HalfLengths(rig.clamps.grip, rig.clamps.clearance, rig.mold.lead, 0.5 * tube.curved_length)


def gap_of(tube: Tube, rig: Rig) -> float:
    """Even gap of air (m) that conducts as much as that of the groove: the rig's own, or of the groove as milled."""
    return own_gap(tube, rig) if rig.mold.gap is None else rig.mold.gap


def own_gap(tube: Tube, rig: Rig) -> float:
    """The even gap (m) of a square groove with the rig's side clearance."""
    side = tube.outer_diameter + 2 * rig.mold.play
    return groove_gap(tube, rig, side, side)


def groove_gap(tube: Tube, rig: Rig, width: float, depth: float) -> float:
    """The even gap (m) that conducts as much as the air of a groove of this width and depth, m, in the rig's mold."""
    ratio = rig.mold.material.conductivity / air_conductivity(rig.ambient + 0.5 * HOT)
    return even_gap(tube.outer_diameter, Lie.leaning(tube.outer_diameter, width, depth), ratio)


def gap_transfer(tube: Tube, rig: Rig) -> float:
    """Heat transfer through the air between tube and groove, W/(m^2 K), without the loss factor."""
    return gap_conductance(gap_of(tube, rig), rig.ambient)


def leak_resistance(tube: Tube, rig: Rig) -> float:
    """Resistance of the way through the mold beside the tube, ohm: its surface twice, and the plates."""
    covered = tube.curved_length + 2 * rig.mold.lead
    if rig.mold.material.electrically_insulating:
        return math.inf
    touching = 0.5 * math.pi * tube.outer_diameter * covered
    plates = rig.mold.material.resistivity * covered / (rig.mold.width * rig.mold.thickness)
    return 2 * rig.mold.leak_resistance / touching + plates


def properties(tube: Tube, rig: Rig) -> Properties:
    """What `physics.heat` must know of tube and rig, but the shells' last half, which depends on their number."""
    data, section, girth = thermal_data(tube), tube.cross_section, math.pi * tube.outer_diameter
    mold, battery, circuit, clamps = rig.mold.material, rig.battery, rig.circuit, rig.clamps
    factor, lengths, leak = rig.loss_factor, half_lengths(tube, rig), leak_resistance(tube, rig)
    bare = rig.convection or natural_convection(tube.outer_diameter, rig.ambient + HOT, rig.ambient)
    return {
        "heat": data.density * section * data.heat_capacity,
        "heat_slope": data.heat_capacity_slope,
        "reference": data.reference_temperature,
        "conduction": data.conductivity * section,
        "conduction_slope": data.conductivity_slope,
        "resistance": rig.resistivity_factor * data.resistivity / section,
        "resistance_slope": data.resistivity_slope,
        "to_clamp": clamps.contact_conductance * girth,
        "to_air": bare * girth * factor,
        "radiating": data.emissivity * STEFAN_BOLTZMANN * girth * factor,
        "gap": gap_transfer(tube, rig) * girth * factor,
        "mold_k": factor * mold.conductivity,
        "mold_heat": factor * mold.density * mold.heat_capacity,
        "leak": 0.0 if math.isinf(leak) else 1 / leak,
        "series": circuit.resistance,
        "contact": circuit.contact_resistance,
        "clamp_heat": clamps.mass * clamps.heat_capacity,
        "clamp_loss": SURFACE_TRANSFER * clamps.area,
        "voltage": battery.voltage,
        "voltage_slope": battery.voltage_slope,
        "internal": battery.internal_resistance,
        "sag": battery.sag_resistance,
        "sag_time": battery.sag_time,
        "capacity": battery.capacity,
        "lost": circuit.lost_share,
        "ambient": rig.ambient,
        "grip": lengths[GRIP],
        "curved": lengths[CURVED],
    }


def model_numbers(tube: Tube, rig: Rig, shells: int) -> tuple[Array, tuple[Array, Array]]:
    """The values of `physics.heat.PROPERTIES`, and of the shells cross-sections (M,), m^2, and log ratios (M-1,)."""
    faces, nodes = shell_radii(rig, tube, shells)
    values = properties(tube, rig)
    k = values["mold_k"]
    values["wall"] = math.log(nodes[0] / faces[0]) / (2 * math.pi * k)
    to_air = SURFACE_TRANSFER * 2 * math.pi * faces[-1]
    values["outer"] = 1 / (math.log(faces[-1] / nodes[-1]) / (2 * math.pi * k) + 1 / to_air)
    return np.array([values[name] for name in PROPERTIES]), (math.pi * np.diff(faces**2), np.diff(np.log(nodes)))


def thermal_model(tube: Tube, rig: Rig, resolution: Resolution = COARSE) -> ThermalModel:
    """The numbers of the model for one tube on one rig."""
    numbers, shells = model_numbers(tube, rig, resolution.shells)
    width = cell_widths(tube, rig, resolution)
    vent = vent_profile(rig, covered_fraction(tube, rig, resolution))
    return ThermalModel(
        resolution=resolution,
        position=np.cumsum(width) - 0.5 * width,
        width=width,
        half_length=float(sum(half_lengths(tube, rig))),
        properties=numbers[None],
        volumes=volumes_function(resolution)(numbers, width, vent, *shells).full().T,
    )


def curve_start(model: ThermalModel) -> float:
    """Where the curved part begins, m from the outer end of the clamp."""
    first = int(np.argmax(model.curved))
    return float(model.position[first] - 0.5 * model.width[first])


def joined(model: ThermalModel, tube: Array) -> Array:
    """(..., 1 + c) temperatures where the curved part begins, and at its cells, from those of the cells (..., n)."""
    first = int(np.argmax(model.curved))
    before, after = model.width[first - 1], model.width[first]
    edge = (after * tube[..., first - 1] + before * tube[..., first]) / (before + after)
    return np.concatenate([edge[..., None], tube[..., first:]], axis=-1)


class Seen(NamedTuple):
    """Temperatures of the tube that limits are about, (...,) degC."""

    coldest: Array
    """Of the curved part."""
    hottest: Array
    """Of the curved part."""
    top: Array
    """Of all points."""


def seen(model: ThermalModel, tube: Array) -> Seen:
    """(...,) coldest and hottest of the curved part, and the hottest point, degC, where the cells have (..., n), K."""
    curved = joined(model, tube) - ZERO_CELSIUS
    return Seen(curved.min(-1), curved.max(-1), tube.max(-1) - ZERO_CELSIUS)
