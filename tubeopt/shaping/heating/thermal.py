"""The numbers of the thermal model for tubes on rigs: grids, properties, and batches of perturbed rigs.

The physics is that of `physics.heat`. The PWM period is far below every time constant of the tube, so the duty counts
as a mean power; `HeatingPlan.pwm_ripple` says how far that is true.
"""

from __future__ import annotations

import functools
import itertools
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
    # d/dx sinh(a x) / sinh(a) at 0 is a / sinh(a): the first cells are that times a uniform one.
    stretch = float(scipy.optimize.brentq(lambda a: a / math.sinh(a) - slope, 1e-3, 50.0))
    return np.asarray(np.sinh(stretch * at) / math.sinh(stretch))


def contact_decay(tube: Tube, rig: Rig) -> float:
    """Length in which the tube takes the temperature of a clamp, m."""
    per_length = rig.clamps.contact_conductance * math.pi * tube.outer_diameter
    # A fin: k A T'' = h p (T - T_clamp) falls as exp(-x / l) with l^2 = k A / (h p).
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
    # Cells of equal log r have equal resistance to heat; their nodes are the geometric means.
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
    # Half of the surface counts for each direction: current enters the mold and leaves it.
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
    # From the last node to the mold's surface by conduction, then by transfer to the air, in series.
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
    # Linear between the middles of two cells: weights are the distances to the other one's middle.
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


# --- Air in a groove --------------------------------------------------------------------------------------------------

# How well the air conducts heat between a round tube and the groove in which it lies, by a solution in the plane.
#
# The model above has shells of mold around the tube behind an even gap of air. A groove is square and wider than the
# tube, which lies on its floor and against a wall. The mold conducts three times (board) to a thousand times (steel) as
# well as air. Heat flows in the plane across the tube, steady,
#
#     div(k grad T) = 0,   T = 1 on the tube,  0 on a circle far away,  k that of air in the groove, else of the mold,
#
# by linear finite elements on rays from the tube's axis. The even gap is the one that makes the model's total
# resistance to heat that of this solution. Where a tube touches a wall that conducts well, nearly all heat flows there.
# A board spreads it first, so that the place of the tube hardly matters.

STANDOFF = 10e-6
"""Air between the tube and what it lies on, m: the roughness of a milled face, and oxide; assumed."""

FAR = 4.0
"""Least radius of the circle far away, in diameters of the tube: what tells a square from a circle dies out before."""

RAYS, AIR_RINGS, MOLD_RINGS = 240, 8, 24
GRADING = 3.0
"""How much finer the rings of the mold are at the groove than far away, as a logarithm."""

LEAST_PLAY = 1e-3
"""Least air on any side, in diameters of the tube, for which the elements are fine enough."""


@dataclass(frozen=True)
class Lie:
    """Where a tube lies in the cross-section of its groove: air at the right wall, lid, left wall and floor, m."""

    right: float
    top: float
    left: float
    bottom: float

    @classmethod
    def leaning(cls, diameter: float, width: float, depth: float, standoff: float = STANDOFF) -> Lie:
        """On the floor and against one wall, as a bent tube lies that is pressed into its groove."""
        side, up = min(standoff, 0.5 * (width - diameter)), min(standoff, 0.5 * (depth - diameter))
        return cls(width - diameter - side, depth - diameter - up, side, up)


@functools.lru_cache(maxsize=256)
def even_gap(diameter: float, lie: Lie, ratio: float) -> float:
    """Even gap of air (m) around a tube that conducts to the mold as much as the air of its groove does.

    Air nearer than `LEAST_PLAY` diameters counts as that.

    Args:
        diameter: of the tube, m. ratio: of the mold's conductivity to that of air.
    """
    air = [max(x / diameter, LEAST_PLAY) for x in (lie.right, lie.top, lie.left, lie.bottom)]
    sides = [0.5 + x for x in air]
    angle, wall = _rays(sides)
    # The same elements filled with mold alone say what they make of it, so that their error cancels.
    resistance, alone = (_resistance(angle, wall, k, ratio) for k in (1.0, ratio))
    return float(math.pi * diameter * (resistance - alone))


def _rays(sides: list[float]) -> tuple[Array, Array]:
    """(n,) angles from 0 to 2 pi, dense where air is thin, with the corners, and (n,) ways to the wall in diameters."""
    right, top, left, bottom = sides
    corners = [(right, top), (-left, top), (-left, -bottom), (right, -bottom)]
    dense = np.linspace(0.0, 2 * math.pi, 16 * RAYS + 1)
    # Rays are dense where the gap is thin: there the field changes fastest along the tube.
    weight = 1 / np.minimum(_wall(dense, sides) - 0.5, 0.3) + 2.0
    share = np.concatenate([[0.0], np.cumsum(0.5 * (weight[1:] + weight[:-1]) * np.diff(dense))])
    spread = np.interp(np.linspace(0.0, share[-1], RAYS, endpoint=False), share, dense)
    exact = np.mod([math.atan2(y, x) for x, y in corners], 2 * math.pi)
    angle = np.unique(np.concatenate([spread, exact]))
    # A ray that nearly coincides with a corner would make slivers.
    apart = np.abs(angle[:, None] - exact).min(1)
    angle = angle[(apart == 0) | (apart > 1e-4)]
    return angle, _wall(angle, sides)


def _wall(angle: Array, sides: list[float]) -> Array:
    right, top, left, bottom = sides
    x, y = np.cos(angle), np.sin(angle)
    across = np.where(x > 0, right, left) / np.maximum(np.abs(x), 1e-12)
    along = np.where(y > 0, top, bottom) / np.maximum(np.abs(y), 1e-12)
    return np.minimum(across, along)


def _resistance(angle: Array, wall: Array, air: float, mold: float) -> float:
    """Between the tube, of diameter 1, and the circle far away, for these conductivities."""
    inner = 0.5 + np.linspace(0.0, 1.0, AIR_RINGS + 1)[:, None] * (wall - 0.5)
    # Geometric rings, as a field in the plane falls like the logarithm of the radius.
    outward = np.expm1(GRADING * np.linspace(0.0, 1.0, MOLD_RINGS + 1)[1:]) / math.expm1(GRADING)
    far = max(FAR, 2 * float(wall.max()))
    radius = np.vstack([inner, wall + outward[:, None] * (far - wall)])
    place = np.stack([radius * np.cos(angle), radius * np.sin(angle)])
    number = np.arange(radius.size).reshape(radius.shape)
    after = np.roll(number, -1, axis=1)
    corners = [grid.ravel() for grid in (number[:-1], number[1:], after[1:], after[:-1])]
    conductivity = np.repeat([air, mold], [AIR_RINGS * len(angle), MOLD_RINGS * len(angle)])
    first, second = (
        _triangles(place.reshape(2, -1), [corners[k] for k in triangle], conductivity)
        for triangle in ((0, 1, 2), (0, 2, 3))
    )
    stiffness = first + second
    field = np.zeros(radius.size)
    field[number[0]] = 1.0
    free = number[1:-1].ravel()
    matrix = stiffness[free]
    field[free] = scipy.sparse.linalg.spsolve(matrix[:, free].tocsc(), -(matrix @ field))
    # With a difference of 1 the energy int k |grad T|^2 is the heat flow, the inverse of the resistance.
    return 1 / float(field @ (stiffness @ field))


def _triangles(place: Array, nodes: list[NDArray[np.intp]], conductivity: Array) -> scipy.sparse.csr_array:
    """Stiffness of linear triangles with corners at `place` (2, N)."""
    x, y = (np.array([axis[node] for node in nodes]) for axis in place)
    # Gradients of the linear shape functions, times twice the area of the triangle.
    slope = np.stack([np.roll(y, -1, 0) - np.roll(y, -2, 0), np.roll(x, -2, 0) - np.roll(x, -1, 0)])
    twice = np.abs((x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]))
    pairs = list(itertools.product(range(3), repeat=2))
    values = [conductivity * (slope[:, a] * slope[:, b]).sum(0) / (2 * twice) for a, b in pairs]
    rows, columns = (np.concatenate([nodes[pair[side]] for pair in pairs]) for side in (0, 1))
    return scipy.sparse.csr_array((np.concatenate(values), (rows, columns)), shape=(place.shape[1],) * 2)
