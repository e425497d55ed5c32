"""The physics of heating at one instant, for the optimal control problem: written apart from the simulation's, which
checks it, and in a form that keeps the program sparse and nearly linear.

The control is the drive, duty times current squared. The current and the tube's resistance are unknowns of their own:
eliminated, they would couple every temperature with every other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from ..materials import ThermalData
from ..robots.assembly import Array
from ..tubes import Tube
from .rig import Rig
from .thermal import (
    CLEARANCE,
    CURVED,
    GRIP,
    LEAD,
    STEFAN_BOLTZMANN,
    SURFACE_TRANSFER,
    Resolution,
    bare_transfer,
    cell_fractions,
    contact_decay,
    covered_fraction,
    cross_section,
    gap_transfer,
    half_lengths,
    leak_resistance,
    shell_radii,
    thermal_data,
    zones,
)

RISE = 500.0
"""Size of a temperature, K."""

CHARGE, SAG, AMPERE, OHM, LENGTH, DURATION, DRIVE = 1e-2, 0.1, 100.0, 0.1, 1e-2, 30.0, 100.0
"""Sizes of the other unknowns, by which they are scaled: fraction, V, A, ohm, m, s and A^2."""

VOLT = 10.0
"""Size of the residual of the circuit, V."""

VENTS = 6
"""Places from the end of the mold to its middle at which vents may be chosen; linear between them."""

SCALARS = (
    "heat", "heat_slope", "reference", "conduction", "conduction_slope", "resistance", "resistance_slope", "to_clamp",
    "to_air", "radiating", "gap", "wall", "mold_k", "mold_heat", "outer", "leak", "series", "contact", "clamp_heat",
    "clamp_loss", "voltage", "voltage_slope", "internal", "sag", "sag_time", "capacity", "ambient", "grip", "curved",
)  # fmt: skip
"""Numbers per length (or as they are) that the physics at one instant needs."""


def physics(tube: Tube, rig: Rig, resolution: Resolution) -> Array:
    """The numbers of tube and rig, as `Numbers` takes them apart again.

    Values of `SCALARS`, the cells' fractions (n,), the shells' rings (M,) in m^2 and log ratios (M-1,), and the weights
    of the vents at the covered cells, by column.
    """
    data: ThermalData = thermal_data(tube)
    section, girth, factor = cross_section(tube), math.pi * tube.outer_diameter, rig.loss_factor
    faces, nodes = shell_radii(rig, tube, resolution.shells)
    mold, battery, circuit, clamps = rig.mold.material, rig.battery, rig.circuit, rig.clamps
    k = factor * mold.conductivity
    outer = math.log(faces[-1] / nodes[-1]) / (2 * math.pi * k) + 1 / (SURFACE_TRANSFER * 2 * math.pi * faces[-1])
    lengths = half_lengths(tube, rig)
    leak = leak_resistance(tube, rig)
    values = {
        "heat": data.density * section * data.heat_capacity,
        "heat_slope": data.heat_capacity_slope,
        "reference": data.reference_temperature,
        "conduction": data.conductivity * section,
        "conduction_slope": data.conductivity_slope,
        "resistance": rig.resistivity_factor * data.resistivity / section,
        "resistance_slope": data.resistivity_slope,
        "to_clamp": clamps.contact_conductance * girth,
        "to_air": bare_transfer(tube, rig) * girth * factor,
        "radiating": data.emissivity * STEFAN_BOLTZMANN * girth * factor,
        "gap": gap_transfer(rig) * girth * factor,
        "wall": math.log(nodes[0] / faces[0]) / (2 * math.pi * k),
        "mold_k": k,
        "mold_heat": factor * mold.density * mold.heat_capacity,
        "outer": 1 / outer,
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
        "ambient": rig.ambient,
        "grip": lengths[GRIP],
        "curved": lengths[CURVED],
    }
    scalars = [values[name] for name in SCALARS]
    rings = math.pi * np.diff(faces**2)
    place = covered_fraction(tube, rig, resolution)
    weights = np.array([np.interp(place, np.linspace(0.0, 1.0, VENTS), unit) for unit in np.eye(VENTS)])
    fractions = cell_fractions(resolution, lengths, contact_decay(tube, rig))
    return np.concatenate([scalars, fractions, rings, np.diff(np.log(nodes)), weights.ravel()])


def number_count(resolution: Resolution) -> int:
    """Length of what `physics` returns."""
    cells, covered = sum(resolution.counts), resolution.lead + resolution.curved
    return len(SCALARS) + cells + 2 * resolution.shells - 1 + covered * VENTS


@dataclass(frozen=True, eq=False)
class Numbers:
    """What `physics` returns, as symbols: scalars by name, and columns."""

    scalar: dict[str, Any]
    fraction: Any
    ring: Any
    ratio: Any
    vents: Any

    @classmethod
    def of(cls, p: Any, resolution: Resolution) -> Numbers:
        """From the column of all numbers."""
        n, m, covered = sum(resolution.counts), resolution.shells, resolution.lead + resolution.curved
        ends = np.cumsum([0, len(SCALARS), n, m, m - 1, covered * VENTS]).tolist()
        scalars, fraction, ring, ratio, vents = ca.vertsplit(p, ends)
        by_name = dict(zip(SCALARS, ca.vertsplit(scalars), strict=True))
        return cls(by_name, fraction, ring, ratio, ca.reshape(vents, covered, VENTS))

    def widths(self, resolution: Resolution, design: Any) -> Any:
        """(n,) widths of the cells, m, at a scaled design."""
        g = self.scalar
        lengths = {GRIP: g["grip"], CLEARANCE: LENGTH * design[0], LEAD: LENGTH * design[1], CURVED: g["curved"]}
        return self.fraction * ca.vertcat(*(lengths[int(zone)] for zone in zones(resolution)))


@dataclass(frozen=True, eq=False)
class _Instant:
    """Temperatures (K) of tube (n,), mold (c, M) and clamp, and the circuit, at one instant; widths (n,) m."""

    tube: Any
    mold: Any
    clamp: Any
    used: Any
    sagged: Any
    ampere: Any
    half: Any
    drive: Any
    width: Any
    vent: Any

    @property
    def covered(self) -> int:
        """Number of cells in the mold."""
        return int(self.mold.size1())


def _gain(flow: Any) -> Any:
    """What cells gain, by row, from flows (n-1, ...) that run from every next one to the one before."""
    nothing = ca.SX(1, flow.size2())
    return ca.vertcat(flow, nothing) - ca.vertcat(nothing, flow)


def _resistances(at: _Instant, g: dict[str, Any], resolution: Resolution) -> Any:
    """(n,) ohm, none in the clamp."""
    outside = ca.DM((zones(resolution) != GRIP).astype(float))
    return outside * g["resistance"] * at.width * (1 + g["resistance_slope"] * (at.tube - g["reference"]))


def _tube_heat(at: _Instant, g: dict[str, Any], resolution: Resolution) -> tuple[Any, Any, Any]:
    """(n,) W into the tube's cells, (c,) W from them into the mold, and W into the clamp."""
    zone, first = zones(resolution), len(zones(resolution)) - at.covered
    share = 1 / (1 + 2 * at.half * g["leak"])
    distance = 0.5 * (at.width[1:] + at.width[:-1])
    slope = 1 + g["conduction_slope"] * (0.5 * (at.tube[1:] + at.tube[:-1]) - g["reference"])
    along = g["conduction"] * slope * (at.tube[1:] - at.tube[:-1]) / distance
    gripped = ca.DM((zone == GRIP).astype(float))
    contact = 0.5 * at.drive * g["contact"]
    into_clamp = gripped * g["to_clamp"] * at.width * (at.tube - at.clamp)
    bare = ca.vertcat(ca.DM((zone[:first] == CLEARANCE).astype(float)), at.vent) * at.width
    air = g["to_air"] * (at.tube - g["ambient"]) + g["radiating"] * (at.tube**4 - g["ambient"] ** 4)
    # 1 / (1 / gap + wall), without dividing by a gap that vents take away.
    gap = g["gap"] * (1 - at.vent)
    into_mold = at.width[first:] * gap / (1 + gap * g["wall"]) * (at.tube[first:] - at.mold[:, 0])
    heat = at.drive * share**2 * _resistances(at, g, resolution) + _gain(along) - into_clamp - bare * air
    heat += 0.5 * contact * gripped * at.width / g["grip"] - ca.vertcat(ca.SX(first, 1), into_mold)
    return heat, into_mold, ca.sum1(into_clamp) + 0.5 * contact


def _mold_heat(at: _Instant, numbers: Numbers, into_mold: Any) -> Any:
    """(c, M) W into the shells."""
    g, shells = numbers.scalar, at.mold.size2()
    width = at.width[at.width.numel() - at.covered :]
    share = 1 / (1 + 2 * at.half * g["leak"])
    stray = at.drive * (1 - share) * share * at.half * width / ca.sum1(width)
    per_K = 2 * math.pi * g["mold_k"] * ca.mtimes(width, (1 / numbers.ratio).T)
    outward = per_K * (at.mold[:, :-1] - at.mold[:, 1:])
    outside = g["outer"] * width * (at.mold[:, -1] - g["ambient"])
    along = g["mold_k"] * ca.mtimes(2 / (width[1:] + width[:-1]), numbers.ring.T) * (at.mold[1:, :] - at.mold[:-1, :])
    edges = ca.horzcat(into_mold + stray, ca.SX(at.covered, shells - 2), -outside)
    return edges - _gain(outward.T).T + _gain(along)


@lru_cache(maxsize=8)
def instant(resolution: Resolution) -> ca.Function:
    """(z, z', circuit, drive, design, numbers) -> (equations, power from the battery) at one instant.

    All but numbers and power are scaled. z: temperatures of tube, shells cell by cell and clamp above ambient, charge
    used, sag; z' is per s. circuit: current while the MOSFET conducts, half the tube's resistance. design: clearance,
    lead, and vents at equal distances.
    """
    n, m, covered = sum(resolution.counts), resolution.shells, resolution.lead + resolution.curved
    names = {"z": n + covered * m + 3, "rate": n + covered * m + 3, "circuit": 2, "drive": 1, "design": 2 + VENTS}
    z, rate, circuit, drive, design = (ca.SX.sym(name, size) for name, size in names.items())
    p = ca.SX.sym("p", number_count(resolution))
    numbers = Numbers.of(p, resolution)
    g = numbers.scalar
    at = _Instant(
        tube=g["ambient"] + RISE * z[:n],
        mold=g["ambient"] + RISE * ca.reshape(z[n : n + covered * m], m, covered).T,
        clamp=g["ambient"] + RISE * z[-3],
        used=CHARGE * z[-2],
        sagged=SAG * z[-1],
        ampere=AMPERE * circuit[0],
        half=OHM * circuit[1],
        drive=DRIVE * drive,
        width=numbers.widths(resolution, design),
        vent=ca.mtimes(numbers.vents, design[2:]),
    )
    heat, into_mold, into_clamp = _tube_heat(at, g, resolution)
    shells = _mold_heat(at, numbers, into_mold)
    mean = at.drive / at.ampere
    capacity = g["heat"] * at.width * (1 + g["heat_slope"] * (at.tube - g["reference"]))
    rates = ca.vertcat(
        heat / capacity / RISE,
        ca.vec((shells / ca.mtimes(at.width[n - covered :], g["mold_heat"] * numbers.ring.T)).T) / RISE,
        (into_clamp - g["clamp_loss"] * (at.clamp - g["ambient"])) / g["clamp_heat"] / RISE,
        mean / g["capacity"] / CHARGE,
        (mean * g["sag"] - at.sagged) / g["sag_time"] / SAG,
    )
    source = g["voltage"] - g["voltage_slope"] * at.used
    load = g["internal"] + g["series"] + 2 * at.half / (1 + 2 * at.half * g["leak"])
    resistance = ca.sum1(_resistances(at, g, resolution)) / OHM - circuit[1]
    equations = ca.vertcat(rate - rates, (at.ampere * load - source + at.sagged) / VOLT, resistance)
    return ca.Function("instant", [z, rate, circuit, drive, design, p], [equations, mean * source])
