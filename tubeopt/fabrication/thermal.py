"""Temperature along a tube that is heated by its own resistance in a mold: finite volumes in space.

Along the tube, from the outer end of a clamp to the middle of the curved part (the rig is the same at both ends):

    rho c(T) A T_t = (k(T) A T_x)_x + d I^2 rho_e(T) / A - q

with q the heat that leaves per length: into the clamp where the tube is gripped, to the air (convection and radiation)
where it is bare, through the gap into the mold where it is covered, and to the air through vents. Around every covered
cell lie shells of mold, conducting to one another in radius and along the tube; the outermost cools in air. The clamps
are lumps. d is the duty, I the current while the MOSFET conducts:

    I (R_battery + R_series + R) = V(charge) - V_sag,   charge' = -d I / capacity,   tau V_sag' = d I R_sag - V_sag

and R the tube's resistance, beside that of a mold which conducts. The PWM period is far below every time constant of
the tube, so the duty counts as a mean power; `HeatingPlan.pwm_ripple` says how far that is true.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from ..errors import InputError
from ..materials import ThermalData
from ..robots.assembly import Array
from ..tubes import Tube
from .rig import HOT, Rig, gap_conductance, natural_convection

STEFAN_BOLTZMANN = 5.670374419e-8
"""W/(m^2 K^4)."""

SURFACE_TRANSFER = 10.0
"""Heat transfer of the outer surfaces of clamps and mold, W/(m^2 K): free convection of plates and radiation near room
temperature, assumed; they hardly warm up."""

GRADED = 12e-3
"""Length, m, in which the curved part gets as many cells as it would if it were no longer."""

DECAYS = 3.0
"""Decay lengths in which the clamp gets as many cells as it would if it were no longer."""

GRIP, CLEARANCE, LEAD, CURVED = range(4)


@dataclass(frozen=True)
class Resolution:
    """Number of cells in a clamp, in the clearance, in the lead and in half of the curved part, and of shells."""

    grip: int = 2
    clearance: int = 3
    lead: int = 7
    curved: int = 9
    shells: int = 7

    @property
    def counts(self) -> tuple[int, int, int, int]:
        """Cells of each zone, from the clamp to the middle."""
        return self.grip, self.clearance, self.lead, self.curved

    def refined(self, factor: int, shells: int | None = None) -> Resolution:
        """Every cell split into `factor`; the number of shells multiplied too, or as given."""
        grip, clearance, lead, curved = (factor * n for n in self.counts)
        return Resolution(grip, clearance, lead, curved, shells or factor * self.shells)


COARSE = Resolution()
PROGRAM = Resolution(2, 3, 4, 6, 4)
"""For the optimal control problem, whose bounds are then shifted by the difference from the fine model."""

FINE = Resolution(4, 6, 14, 18, 14)


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
    stretch = float(brentq(lambda a: a / math.sinh(a) - slope, 1e-3, 50.0))
    return np.asarray(np.sinh(stretch * at) / math.sinh(stretch))


def contact_decay(tube: Tube, rig: Rig) -> float:
    """Length in which the tube takes the temperature of a clamp, m."""
    per_length = rig.clamps.contact_conductance * math.pi * tube.outer_diameter
    return math.sqrt(thermal_data(tube).conductivity * cross_section(tube) / per_length)


def zones(resolution: Resolution) -> NDArray[np.intp]:
    """(n,) zone of each cell: GRIP, CLEARANCE, LEAD or CURVED."""
    return np.repeat(np.arange(4), resolution.counts)


def thermal_data(tube: Tube) -> ThermalData:
    """The tube's thermal data; raises InputError where its material has none."""
    if tube.material.thermal is None:
        raise InputError(
            f"material {tube.material.name!r} has no thermal data; it must have them for a tube that is to be heated"
        )
    return tube.material.thermal


@dataclass(frozen=True, eq=False)
class ThermalModel:
    """The numbers of the finite-volume model of half a tube, for B members at once; n cells, M shells.

    Attributes:
        position, width: (n,) middle of each cell from the outer end of the clamp, and its width, m. half_length: m.
        zone: (n,) GRIP, CLEARANCE, LEAD or CURVED.
        heat: (B, n) rho c A w at the reference temperature, J/K; heat_slope, reference: 1/K, K.
        conduction: (B, n-1) k A / distance between neighbours at the reference, W/K; conduction_slope: 1/K.
        resistance: (B, n) of each cell at the reference, 0 in the clamp, ohm; resistance_slope: 1/K.
        to_clamp, to_air, radiating: (B, n) W/K, W/K, W/K^4.
        to_mold: (B, n) into the first shell, W/K.
        shell_heat: (B, n, M) J/K, 1 where there is no mold. radial: (B, n, M-1) W/K. outer: (B, n) W/K.
        axial: (B, n-1, M) W/K between shells of neighbouring cells.
        leak: (B,) resistance of the mold beside the tube, ohm, infinite for an insulator.
        series: (B,) resistance in series with the tube, without the battery's, ohm; contact: (B,) clamps' part of it.
        clamp_heat, clamp_loss: (B,) of one clamp, J/K and W/K.
        voltage, voltage_slope, internal, sag, capacity: (B,) of the battery; sag_time: (B,) s.
        ambient: K.
    """

    position: Array
    width: Array
    half_length: float
    zone: NDArray[np.intp]
    heat: Array
    heat_slope: float
    reference: float
    conduction: Array
    conduction_slope: float
    resistance: Array
    resistance_slope: float
    to_clamp: Array
    to_air: Array
    radiating: Array
    to_mold: Array
    shell_heat: Array
    radial: Array
    outer: Array
    axial: Array
    leak: Array
    series: Array
    contact: Array
    clamp_heat: Array
    clamp_loss: Array
    voltage: Array
    voltage_slope: Array
    internal: Array
    sag: Array
    sag_time: Array
    capacity: Array
    ambient: float

    @property
    def members(self) -> int:
        """B."""
        return len(self.series)

    @property
    def curved(self) -> NDArray[np.bool_]:
        """(n,) which cells belong to the curved part."""
        return np.asarray(self.zone == CURVED)

    @cached_property
    def grip_share(self) -> Array:
        """(n,) part of the clamp that lies around each cell; sums to 1."""
        gripped = np.where(self.zone == GRIP, self.width, 0.0)
        return np.asarray(gripped / gripped.sum())

    @cached_property
    def cover_share(self) -> Array:
        """(n,) part of the mold that lies around each cell; sums to 1."""
        covered = np.where(self.zone >= LEAD, self.width, 0.0)
        return np.asarray(covered / covered.sum())

    @property
    def full_position(self) -> Array:
        """(2n,) positions of the cells of the whole tube, m."""
        return np.concatenate([self.position, 2 * self.half_length - self.position[::-1]])


_PER_MEMBER = {
    "heat", "conduction", "resistance", "to_clamp", "to_air", "radiating", "to_mold", "shell_heat", "radial", "outer",
    "axial", "leak", "series", "contact", "clamp_heat", "clamp_loss", "voltage", "voltage_slope", "internal", "sag",
    "sag_time", "capacity",
}  # fmt: skip


def stack(models: Sequence[ThermalModel]) -> ThermalModel:
    """Models on the same grid as the members of one."""
    values = {f.name: getattr(models[0], f.name) for f in fields(ThermalModel)}
    values |= {name: np.concatenate([getattr(model, name) for model in models]) for name in _PER_MEMBER}
    return ThermalModel(**values)


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


def cross_section(tube: Tube) -> float:
    """Metal of the tube's cross-section, m^2."""
    return math.pi / 4 * (tube.outer_diameter**2 - tube.inner_diameter**2)


def half_lengths(tube: Tube, rig: Rig) -> tuple[float, float, float, float]:
    """Lengths of the zones from the clamp to the middle of the curved part, m; raises InputError without a curve."""
    if tube.curved_length <= 0:
        raise InputError(f"curved_length is {tube.curved_length:g} m; a tube that is shape-set must have a curved part")
    return rig.clamps.grip, rig.clamps.clearance, rig.mold.lead, 0.5 * tube.curved_length


def bare_transfer(tube: Tube, rig: Rig) -> float:
    """Convective heat transfer of bare tube, W/(m^2 K), without the rig's loss factor."""
    if rig.convection is not None:
        return rig.convection
    return natural_convection(tube.outer_diameter, rig.ambient + HOT, rig.ambient)


def gap_transfer(rig: Rig) -> float:
    """Heat transfer through the air between tube and groove, W/(m^2 K), without the loss factor."""
    return gap_conductance(rig.mold.gap, rig.ambient)


def leak_resistance(tube: Tube, rig: Rig) -> float:
    """Resistance of the way through the mold beside the tube, ohm: its surface twice, and the plates."""
    covered = tube.curved_length + 2 * rig.mold.lead
    if rig.mold.material.electrically_insulating:
        return math.inf
    touching = 0.5 * math.pi * tube.outer_diameter * covered
    plates = rig.mold.material.resistivity * covered / (rig.mold.width * rig.mold.thickness)
    return 2 * rig.mold.leak_resistance / touching + plates


def thermal_model(tube: Tube, rig: Rig, resolution: Resolution = COARSE) -> ThermalModel:
    """The numbers of the model for one tube on one rig.

    Raises:
        InputError: the tube has no curved part or its material no thermal data, or the mold is too small.
    """
    data, mold, factor = thermal_data(tube), rig.mold, rig.loss_factor
    lengths = half_lengths(tube, rig)
    zone, width = zones(resolution), cell_widths(tube, rig, resolution)
    position = np.cumsum(width) - 0.5 * width
    section, surface = cross_section(tube), math.pi * tube.outer_diameter * width
    covered, distance = zone >= LEAD, np.diff(position)
    vents = np.zeros(len(zone))
    vents[covered] = vent_profile(rig, covered_fraction(tube, rig, resolution))
    bare = np.where(zone == CLEARANCE, 1.0, vents) * surface * factor
    faces, nodes = shell_radii(rig, tube, resolution.shells)
    k, heat = factor * mold.material.conductivity, factor * mold.material.density * mold.material.heat_capacity
    ring = math.pi * np.diff(faces**2)
    cover = np.where(covered, width, 0.0)
    touching = gap_transfer(rig) * factor * (1 - vents) * math.pi * tube.outer_diameter
    to_mold = cover / (1 / touching + math.log(nodes[0] / faces[0]) / (2 * math.pi * k))
    to_outside = math.log(faces[-1] / nodes[-1]) / (2 * math.pi * k) + 1 / (SURFACE_TRANSFER * 2 * math.pi * faces[-1])
    joined = (covered[1:] & covered[:-1]).astype(float)

    battery, circuit, clamps = rig.battery, rig.circuit, rig.clamps
    return ThermalModel(
        position=position,
        width=width,
        half_length=float(sum(lengths)),
        zone=zone,
        heat=(data.density * section * data.heat_capacity * width)[None],
        heat_slope=data.heat_capacity_slope,
        reference=data.reference_temperature,
        conduction=(data.conductivity * section / distance)[None],
        conduction_slope=data.conductivity_slope,
        resistance=np.where(zone == GRIP, 0.0, rig.resistivity_factor * data.resistivity * width / section)[None],
        resistance_slope=data.resistivity_slope,
        to_clamp=np.where(zone == GRIP, clamps.contact_conductance * surface, 0.0)[None],
        to_air=(bare_transfer(tube, rig) * bare)[None],
        radiating=(data.emissivity * STEFAN_BOLTZMANN * bare)[None],
        to_mold=to_mold[None],
        shell_heat=np.where(covered[:, None], heat * ring * cover[:, None], 1.0)[None],
        radial=(2 * math.pi * k * cover[:, None] / np.diff(np.log(nodes)))[None],
        outer=(cover / to_outside)[None],
        axial=(k * ring * (joined / distance)[:, None])[None],
        leak=np.array([leak_resistance(tube, rig)]),
        series=np.array([circuit.resistance]),
        contact=np.array([circuit.contact_resistance]),
        clamp_heat=np.array([clamps.mass * clamps.heat_capacity]),
        clamp_loss=np.array([SURFACE_TRANSFER * clamps.area]),
        voltage=np.array([battery.voltage]),
        voltage_slope=np.array([battery.voltage_slope]),
        internal=np.array([battery.internal_resistance]),
        sag=np.array([battery.sag_resistance]),
        sag_time=np.array([battery.sag_time]),
        capacity=np.array([battery.capacity]),
        ambient=rig.ambient,
    )
