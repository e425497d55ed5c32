"""Parameters of the thermal model for tubes on rigs: grids, properties, and batches of perturbed rigs.

The physics is that of `physics.heat`. The PWM period is far below every time constant of the tube, so the duty counts
as a mean power; `HeatingPlan.pwm_ripple` is the error of this assumption.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy
from numpy.typing import NDArray

from ...constants import STEFAN_BOLTZMANN, ZERO_CELSIUS
from ...errors import InputError
from ...physics.heat import BENDS, CURVED, GRIP, LEAD, PROPERTIES, Properties, Resolution, Shells, zones
from ...physics.heat_functions import volumes_function
from ...robots.materials import ThermalData
from ...robots.tubes import Tube
from ...typing import Array
from .rig import HOT, Rig, air_conductivity, gap_conductance, natural_convection
from .thermocouple import stem_loss

SURFACE_TRANSFER = 10.0
"""Heat transfer coefficient of the outer surfaces of clamps and mold, W/(m^2 K): free convection of plates and
radiation near room temperature, assumed; they hardly warm up."""

GRADED = 12e-3
"""Largest length of the curved part with cells of equal width, m; in a longer one they grow."""

DECAYS = 3.0
"""Largest length of the clamp with cells of equal width, in decay lengths of the temperature."""

COARSE = Resolution(grip=4)
PROGRAM = Resolution(2, 3, 4, 6, 4)
"""Grid of the optimal control problem; its bounds are then shifted by the difference from the fine model."""

FINE = Resolution(8, 6, 14, 18, 14)
"""Grid of results. With half as many cells in the clamp, the bare tube next to it is 4 K too hot in a conductive
mold."""


def cell_widths(tube: Tube, rig: Rig, resolution: Resolution) -> Array:
    """(n,) widths of the cells, m.

    Uniform in clearance and lead; growing towards the middle in the curved part, and away from the edge in the clamp,
    where the temperature falls within the decay length of a fin.
    """
    lengths = half_lengths(tube, rig)
    fractions = cell_fractions(resolution, lengths, contact_decay(tube, rig))
    return np.asarray(fractions * np.array(lengths)[zones(resolution)])


def cell_fractions(resolution: Resolution, lengths: Sequence[float], decay: float) -> Array:
    """(n,) width of each cell as a fraction of its zone; `lengths` of the zones and `decay` in the clamp in m."""
    grip = np.diff(_graded(resolution.grip, DECAYS * decay / lengths[GRIP]))[::-1]
    uniform = [np.full(n, 1.0 / n) for n in (resolution.clearance, resolution.lead)]
    return np.concatenate([grip, *uniform, np.diff(_graded(resolution.curved, GRADED / lengths[CURVED]))])


def _graded(cells: int, slope: float) -> Array:
    """(cells + 1,) faces from 0 to 1, with first cells `slope` times as wide as uniform ones."""
    uniform = np.linspace(0.0, 1.0, cells + 1)
    if slope > 0.999:
        return uniform
    # d/dx sinh(a x) / sinh(a) at 0 is a / sinh(a): the first cells are that times a uniform one.
    stretch = float(scipy.optimize.brentq(lambda a: a / math.sinh(a) - slope, 1e-3, 50.0))
    return np.asarray(np.sinh(stretch * uniform) / math.sinh(stretch))


def contact_decay(tube: Tube, rig: Rig) -> float:
    """Decay length of the tube's temperature towards the clamp's, m."""
    per_length = rig.clamps.contact_conductance * math.pi * tube.outer_diameter
    # A fin: k A T'' = h p (T - T_clamp) falls as exp(-x / l) with l^2 = k A / (h p).
    return math.sqrt(thermal_data(tube).conductivity * tube.cross_section / per_length)


def thermal_data(tube: Tube) -> ThermalData:
    """Thermal data of the tube; raises InputError for a material without."""
    if tube.material.thermal is None:
        raise InputError(f"material {tube.material.name!r} has no thermal data; they are required to heat a tube")
    return tube.material.thermal


@dataclass(frozen=True, eq=False)
class ThermalModel:
    """Finite-volume model of half a tube for B members at once: parameters on a grid of n cells."""

    resolution: Resolution
    position: Array
    """(n,) middle of each cell from the outer end of the clamp, m."""
    width: Array
    """(n,) width of each cell, m."""
    half_length: float
    """Length of half the tube, clamp included, m."""
    properties: Array
    """(B, P) values by the names of `physics.heat.PROPERTIES`."""
    volumes: Array
    """(B, V) columns of `physics.heat.Volumes`."""

    @property
    def members(self) -> int:
        """Number of members, B."""
        return len(self.properties)

    def parameter(self, name: str) -> Array:
        """(B,) values of a property of `physics.heat.Properties`."""
        return np.asarray(self.properties[:, PROPERTIES.index(name)])

    @property
    def T_amb(self) -> float:
        """Ambient temperature of the first member, K."""
        return float(self.parameter("T_amb")[0])

    @property
    def zone(self) -> NDArray[np.intp]:
        """(n,) zone of each cell: GRIP, CLEARANCE, LEAD or CURVED."""
        return zones(self.resolution)

    @property
    def curved(self) -> NDArray[np.bool_]:
        """(n,) True for cells in the curved part."""
        return np.asarray(self.zone == CURVED)

    @property
    def full_position(self) -> Array:
        """(2n,) positions of the cells of the whole tube, m."""
        return np.concatenate([self.position, 2 * self.half_length - self.position[::-1]])


def stack(models: Sequence[ThermalModel]) -> ThermalModel:
    """Model that combines models on the same grid as its members."""
    return replace(
        models[0],
        properties=np.vstack([m.properties for m in models]),
        volumes=np.vstack([m.volumes for m in models]),
    )


def vent_profile(rig: Rig, fraction: Array) -> Array:
    """Open fraction of the tube's surface at positions (c,) from the end of the mold (0) to its middle (1)."""
    vents = np.array(rig.mold.vents)
    given = np.linspace(0.0, 1.0, len(vents)) if len(vents) > 1 else np.zeros(1)
    return np.asarray(np.interp(fraction, given, vents))


def covered_fraction(tube: Tube, rig: Rig, resolution: Resolution) -> Array:
    """(c,) positions of the covered cells between the end of the mold (0) and its middle (1)."""
    lengths, zone = half_lengths(tube, rig), zones(resolution)
    width = cell_widths(tube, rig, resolution)
    position = np.cumsum(width) - 0.5 * width - lengths.grip - lengths.clearance
    return np.asarray(position[zone >= LEAD] / (lengths.lead + lengths.curved))


class ShellRadii(NamedTuple):
    """Radii of M shells of mold around the tube, m; numbers, or expressions for a mold of free thickness."""

    faces: Any
    """(M+1,) radii of the faces."""
    nodes: Any
    """(M,) radii of the nodes."""


def shell_radii(rig: Rig, tube: Tube, shells: int) -> ShellRadii:
    """Radii of the shells, from the surface of the tube to the surface of the mold."""
    # The field of a hot wire is linear in log r: shells of equal ratio have equal thermal resistance.
    inner = 0.5 * tube.outer_diameter
    faces = inner * ca.exp(ca.log(rig.mold.radius / inner) * ca.DM(np.linspace(0.0, 1.0, shells + 1)))
    return ShellRadii(faces, ca.sqrt(faces[:-1] * faces[1:]))


def check_mold(rig: Rig, tube: Tube) -> None:
    """Raise InputError for a mold that is too small for the tube."""
    if rig.mold.radius < tube.outer_diameter:
        raise InputError(
            f"the mold is {rig.mold.width * 1e3:g} mm by {rig.mold.thickness * 1e3:g} mm; that is too small to "
            f"surround a tube of {tube.outer_diameter * 1e3:g} mm"
        )


class HalfLengths(NamedTuple):
    """Lengths of the zones of half the tube, from a clamp to the middle, m; in the order of `physics.heat`."""

    grip: float
    clearance: float
    lead: float
    curved: float


def half_lengths(tube: Tube, rig: Rig) -> HalfLengths:
    """Lengths of the zones of half the tube, m; raises InputError for a tube without a curved part."""
    if tube.curved_length <= 0:
        raise InputError(f"curved_length is {tube.curved_length:g} m; a tube to be shape-set must have a curved part")
    return HalfLengths(rig.clamps.grip, rig.clamps.clearance, rig.mold.lead, 0.5 * tube.curved_length)


def uniform_gap_of(tube: Tube, rig: Rig) -> float:
    """Uniform gap (m) that conducts as much as the air in the groove.

    It is the gap of the rig, if that has one, or follows from the groove as milled.
    """
    return square_groove_gap(tube, rig) if rig.mold.gap is None else rig.mold.gap


def square_groove_gap(tube: Tube, rig: Rig) -> float:
    """Uniform gap (m) of a square groove with the rig's side clearance."""
    side = tube.outer_diameter + 2 * rig.mold.play
    return groove_gap(tube, rig, side, side)


def groove_gap(tube: Tube, rig: Rig, width: float, depth: float) -> float:
    """Uniform gap (m) that conducts as much as the air of a groove of given width and depth (m).

    In the rig's mold.
    """
    ratio = rig.mold.material.conductivity / air_conductivity(rig.ambient + 0.5 * HOT)
    return uniform_gap(tube.outer_diameter, GrooveAir.tube_on_floor_and_wall(tube.outer_diameter, width, depth), ratio)


def gap_transfer(tube: Tube, rig: Rig) -> float:
    """Heat transfer coefficient of the air between tube and groove, W/(m^2 K), without the loss factor."""
    return gap_conductance(uniform_gap_of(tube, rig), rig.ambient)


def leak_resistance(tube: Tube, rig: Rig) -> float:
    """Electrical resistance of the mold in parallel with the tube, ohm: two contacts with the tube, and the plates."""
    covered = tube.curved_length + 2 * rig.mold.lead
    if rig.mold.material.electrically_insulating:
        return math.inf
    # Half of the surface counts for each direction: current enters the mold and leaves it.
    contact_area = 0.5 * math.pi * tube.outer_diameter * covered
    plates = rig.mold.material.resistivity * covered / (rig.mold.width * rig.mold.thickness)
    return 2 * rig.mold.leak_resistance / contact_area + plates


def properties(tube: Tube, rig: Rig, shells: int) -> Properties:
    """Parameters of `physics.heat` for a mold of this number of shells."""
    data, section, girth = thermal_data(tube), tube.cross_section, math.pi * tube.outer_diameter
    mold, battery, circuit, clamps = rig.mold.material, rig.battery, rig.circuit, rig.clamps
    factor, lengths = rig.loss_factor, half_lengths(tube, rig)
    h_bare = rig.convection or natural_convection(tube.outer_diameter, rig.ambient + HOT, rig.ambient)
    faces, nodes = shell_radii(rig, tube, shells)
    k_mold = factor * mold.conductivity
    at_bends = mold.conductivity_factor(BENDS)
    # Slopes between the bends, none outside; and their changes.
    changes = np.diff(np.diff(at_bends) / np.diff(BENDS), prepend=0.0, append=0.0)
    # From the last node to the mold's surface by conduction, then by transfer to the air, in series. The surface hardly
    # warms up.
    k_cold = k_mold * float(mold.conductivity_factor(rig.ambient))
    R_outer = ca.log(faces[-1] / nodes[-1]) / (2 * math.pi * k_cold) + 1 / (SURFACE_TRANSFER * 2 * math.pi * faces[-1])
    return Properties(
        c_tube=data.density * section * data.heat_capacity,
        c_slope=data.heat_capacity_slope,
        T_ref=data.reference_temperature,
        kA=data.conductivity * section,
        k_slope=data.conductivity_slope,
        r_tube=rig.resistivity_factor * data.resistivity / section,
        r_slope=data.resistivity_slope,
        h_clamp=clamps.contact_conductance * girth,
        h_air=h_bare * girth * factor,
        eps_sigma=data.emissivity * STEFAN_BOLTZMANN * girth * factor,
        h_gap=gap_transfer(tube, rig) * girth * factor,
        R_wall=ca.log(nodes[0] / faces[0]) / (2 * math.pi * k_mold),
        k_mold=k_mold,
        f_mold=at_bends[0],
        **{f"f_{bend - ZERO_CELSIUS:.0f}": change for bend, change in zip(BENDS, changes, strict=True)},
        c_mold=factor * mold.density * mold.heat_capacity,
        h_outer=1 / R_outer,
        G_leak=0.0 if mold.electrically_insulating else 1 / leak_resistance(tube, rig),
        R_series=circuit.resistance,
        R_contact=circuit.contact_resistance,
        C_clamp=clamps.mass * clamps.heat_capacity,
        G_clamp_air=SURFACE_TRANSFER * clamps.area,
        V_start=battery.voltage,
        V_slope=battery.voltage_slope,
        R_internal=battery.internal_resistance,
        R_sag=battery.sag_resistance,
        tau_sag=battery.sag_time,
        Q_battery=battery.capacity,
        lost_duty=circuit.lost_share,
        T_amb=rig.ambient,
        L_grip=lengths.grip,
        L_curved=lengths.curved,
        G_wire=0.5 * stem_loss(rig.mold.wire, rig.mold.anchor).conductance if rig.mold.wire else 0.0,
        L_wire=rig.mold.anchor,
    )


def shells_of(tube: Tube, rig: Rig, shells: int) -> Shells:
    """Geometry of the shells for `physics.heat`."""
    faces, nodes = shell_radii(rig, tube, shells)
    return Shells(math.pi * (faces[1:] ** 2 - faces[:-1] ** 2), ca.log(nodes[1:] / nodes[:-1]))


class RigNumbers(NamedTuple):
    """Parameters of `physics.heat` as arrays."""

    properties: Array
    """(P,) values by the names of `physics.heat.PROPERTIES`."""
    shells: Shells


def rig_numbers(tube: Tube, rig: Rig, shells: int) -> RigNumbers:
    """Parameters of tube and rig, and the geometry of the shells; raises InputError for a mold that is too small."""
    check_mold(rig, tube)
    values = vars(properties(tube, rig, shells))
    geometry = Shells(*(part.full().ravel() for part in shells_of(tube, rig, shells)))
    return RigNumbers(np.array([float(values[name]) for name in PROPERTIES]), geometry)


def thermal_model(tube: Tube, rig: Rig, resolution: Resolution = COARSE) -> ThermalModel:
    """Thermal model of one tube on one rig."""
    numbers = rig_numbers(tube, rig, resolution.shells)
    width = cell_widths(tube, rig, resolution)
    vent = vent_profile(rig, covered_fraction(tube, rig, resolution))
    return ThermalModel(
        resolution=resolution,
        position=np.cumsum(width) - 0.5 * width,
        width=width,
        half_length=float(sum(half_lengths(tube, rig))),
        properties=numbers.properties[None],
        volumes=volumes_function(resolution)(numbers.properties, width, vent, *numbers.shells).full().T,
    )


def curve_start(model: ThermalModel) -> float:
    """Position where the curved part begins, m from the outer end of the clamp."""
    first = int(np.argmax(model.curved))
    return float(model.position[first] - 0.5 * model.width[first])


def curved_temperatures(model: ThermalModel, tube: Array) -> Array:
    """(..., 1 + c) temperatures at the start of the curved part and at its cells, K.

    `tube` (..., n): temperatures of all cells, K.
    """
    first = int(np.argmax(model.curved))
    before, after = model.width[first - 1], model.width[first]
    # Linear between the middles of two cells: weights are the distances to the middle of the other one.
    edge = (after * tube[..., first - 1] + before * tube[..., first]) / (before + after)
    return np.concatenate([edge[..., None], tube[..., first:]], axis=-1)


class TubeExtremes(NamedTuple):
    """Temperatures of the tube that window and limit apply to, (...,) degC."""

    coldest: Array
    """Coldest point of the curved part."""
    hottest: Array
    """Hottest point of the curved part."""
    peak: Array
    """Hottest point of the tube."""


def tube_extremes(model: ThermalModel, tube: Array) -> TubeExtremes:
    """Extreme temperatures (...,), degC, from the temperatures of the cells (..., n), K."""
    curved = curved_temperatures(model, tube) - ZERO_CELSIUS
    return TubeExtremes(curved.min(-1), curved.max(-1), tube.max(-1) - ZERO_CELSIUS)


# --- Air in a groove --------------------------------------------------------------------------------------------------

# The model above has shells of mold around the tube behind a uniform gap of air. A real groove is square and wider than
# the tube, which touches its floor and one wall. The mold conducts three times (board) to a thousand times (steel) as
# well as air. Steady heat flow in the plane across the tube,
#
#     div(k grad T) = 0,   T = 1 on the tube,  0 on a circle far away,  k that of air in the groove, else of the mold,
#
# is solved by linear finite elements on rays from the tube's axis. The uniform gap is the one that gives the model the
# total thermal resistance of this solution. If a tube touches a wall that conducts well, nearly all heat flows there. A
# board spreads it first, so that the position of the tube hardly matters.

STANDOFF = 10e-6
"""Air gap between the tube and the wall that it touches, m: roughness of a milled face, and oxide; assumed."""

FAR = 4.0
"""Smallest radius of the circle far away, in tube diameters: the field of a square is round before."""

RAYS, AIR_RINGS, MOLD_RINGS = 240, 8, 24
GRADING = 3.0
"""Logarithm of the ratio of ring widths in the mold, far away to at the groove."""

MIN_AIR = 1e-3
"""Smallest air gap on any side, in tube diameters, for sufficiently fine elements."""


@dataclass(frozen=True)
class GrooveAir:
    """Air around a tube in the cross-section of its groove: distances to right wall, lid, left wall and floor, m."""

    right: float
    top: float
    left: float
    bottom: float

    @classmethod
    def tube_on_floor_and_wall(
        cls, diameter: float, width: float, depth: float, standoff: float = STANDOFF
    ) -> GrooveAir:
        """Air around a tube on the floor and against one wall, as a bent tube pressed into its groove."""
        side, bottom = min(standoff, 0.5 * (width - diameter)), min(standoff, 0.5 * (depth - diameter))
        return cls(width - diameter - side, depth - diameter - bottom, side, bottom)


@functools.lru_cache(maxsize=256)
def uniform_gap(diameter: float, air: GrooveAir, ratio: float) -> float:
    """Uniform air gap (m) around a tube that conducts as much heat to the mold as the air of its groove.

    Air gaps below `MIN_AIR` diameters count as that.

    Args:
        diameter: of the tube, m. ratio: of the mold's conductivity to that of air.
    """
    gaps = [max(x / diameter, MIN_AIR) for x in (air.right, air.top, air.left, air.bottom)]
    angle, wall = _rays([0.5 + x for x in gaps])
    # The resistance of the same elements filled with mold alone is subtracted, so that their error cancels.
    resistance, filled = (_resistance(angle, wall, k, ratio) for k in (1.0, ratio))
    return float(math.pi * diameter * (resistance - filled))


def _rays(sides: list[float]) -> tuple[Array, Array]:
    """(n,) angles from 0 to 2 pi, with the corners, dense where air is thin, and (n,) distances to the wall."""
    right, top, left, bottom = sides
    corners = [(right, top), (-left, top), (-left, -bottom), (right, -bottom)]
    dense = np.linspace(0.0, 2 * math.pi, 16 * RAYS + 1)
    # Rays are dense where the gap is thin: there the field changes fastest along the tube.
    weight = 1 / np.minimum(_wall_distance(dense, sides) - 0.5, 0.3) + 2.0
    cumulative = np.concatenate([[0.0], np.cumsum(0.5 * (weight[1:] + weight[:-1]) * np.diff(dense))])
    spread = np.interp(np.linspace(0.0, cumulative[-1], RAYS, endpoint=False), cumulative, dense)
    exact = np.mod([math.atan2(y, x) for x, y in corners], 2 * math.pi)
    angle = np.unique(np.concatenate([spread, exact]))
    # A ray that nearly coincides with a corner would make slivers.
    to_corner = np.abs(angle[:, None] - exact).min(1)
    angle = angle[(to_corner == 0) | (to_corner > 1e-4)]
    return angle, _wall_distance(angle, sides)


def _wall_distance(angle: Array, sides: list[float]) -> Array:
    right, top, left, bottom = sides
    x, y = np.cos(angle), np.sin(angle)
    across = np.where(x > 0, right, left) / np.maximum(np.abs(x), 1e-12)
    along = np.where(y > 0, top, bottom) / np.maximum(np.abs(y), 1e-12)
    return np.minimum(across, along)


def _resistance(angle: Array, wall: Array, k_air: float, k_mold: float) -> float:
    """Thermal resistance between the tube, of diameter 1, and the circle far away."""
    inner = 0.5 + np.linspace(0.0, 1.0, AIR_RINGS + 1)[:, None] * (wall - 0.5)
    # Geometric rings, as a field in the plane falls like the logarithm of the radius.
    outward = np.expm1(GRADING * np.linspace(0.0, 1.0, MOLD_RINGS + 1)[1:]) / math.expm1(GRADING)
    far = max(FAR, 2 * float(wall.max()))
    radius = np.vstack([inner, wall + outward[:, None] * (far - wall)])
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)]).reshape(2, -1)
    node = np.arange(radius.size).reshape(radius.shape)
    node_next = np.roll(node, -1, axis=1)
    a, b, c, d = (grid.ravel() for grid in (node[:-1], node[1:], node_next[1:], node_next[:-1]))
    k = np.repeat([k_air, k_mold], [AIR_RINGS * len(angle), MOLD_RINGS * len(angle)])
    stiffness = _triangles(points, [a, b, c], k) + _triangles(points, [a, c, d], k)
    T = np.zeros(radius.size)
    T[node[0]] = 1.0
    free = node[1:-1].ravel()
    rows = stiffness[free]
    T[free] = scipy.sparse.linalg.spsolve(rows[:, free].tocsc(), -(rows @ T))
    # With a difference of 1 the energy int k |grad T|^2 is the heat flow, the inverse of the resistance.
    return 1 / float(T @ (stiffness @ T))


def _triangles(points: Array, nodes: list[NDArray[np.intp]], conductivity: Array) -> scipy.sparse.csr_array:
    """Stiffness matrix of linear triangles with corners among `points` (2, N)."""
    x, y = (np.array([axis[corner] for corner in nodes]) for axis in points)
    # Gradients of the linear shape functions, times twice the area of the triangle.
    slope = np.stack([np.roll(y, -1, 0) - np.roll(y, -2, 0), np.roll(x, -2, 0) - np.roll(x, -1, 0)])
    twice_area = np.abs((x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]))
    pairs = list(itertools.product(range(3), repeat=2))
    values = [conductivity * (slope[:, a] * slope[:, b]).sum(0) / (2 * twice_area) for a, b in pairs]
    rows, columns = (np.concatenate([nodes[pair[side]] for pair in pairs]) for side in (0, 1))
    return scipy.sparse.csr_array((np.concatenate(values), (rows, columns)), shape=(points.shape[1],) * 2)
