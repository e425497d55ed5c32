"""Heat flows at one instant in half a tube that is heated by its resistance in a mold: finite volumes in CasADi.

Along the tube, from the outer end of a clamp to the middle of the curved part:

    rho c(T) A T_t = (k(T) A T_x)_x + d I^2 rho_e(T) / A - q

with the heat loss q per length: to the clamp where the tube is gripped, to the air (convection and radiation) where it
is bare, through the gap to the mold where it is covered, and to the air through vents. Shells of mold around every
covered cell conduct heat in radial direction and along the tube; the outermost cools in air. The clamps are lumped. The
duty is d, and I is the current while the MOSFET conducts:

    I (R_battery + R_series + R) = V(charge) - V_sag,   charge' = -d I / capacity,   tau V_sag' = d I R_sag - V_sag

and R the resistance of the tube, in parallel with that of a conducting mold.

All functions take numbers or symbols: the program of the ideal schedule keeps current and resistance as unknowns, the
simulation eliminates them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

GRIP, CLEARANCE, LEAD, CURVED = range(4)
"""Zones from the clamp to the middle of the curved part; the last two are in the mold."""

PROPERTIES = (
    "heat", "heat_slope", "reference", "conduction", "conduction_slope", "resistance", "resistance_slope", "to_clamp",
    "to_air", "radiating", "gap", "wall", "mold_k", "mold_heat", "outer", "leak", "series", "contact", "clamp_heat",
    "clamp_loss", "voltage", "voltage_slope", "internal", "sag", "sag_time", "capacity", "lost", "ambient", "grip",
    "curved",
)  # fmt: skip
"""Constants of tube and rig, SI.

Tube, per length, at the temperature `reference`: heat capacity, conductivity times section, electric resistance, with
their relative slopes per K; heat transfer to clamp, to air, by radiation and through the gap. Mold: thermal resistance
of its innermost half shell, conductivity, heat capacity per volume, heat transfer from the outermost shell per length,
and electric conductance in parallel with the tube. Circuit: resistances in series with the tube, and of the contacts
alone. Heat capacity and heat loss of a clamp; the battery; the part of a period that every pulse loses while the
current rises; lengths of clamp and half of the curved part."""

Properties = dict[str, Any]


def named(column: Any) -> Properties:
    """PROPERTIES by name, from a column of their values."""
    return dict(zip(PROPERTIES, ca.vertsplit(column), strict=True))


@dataclass(frozen=True)
class Resolution:
    """Number of cells in a clamp, in the clearance, in the lead and in half of the curved part, and of shells."""

    grip: int = 2
    clearance: int = 3
    lead: int = 7
    curved: int = 9
    shells: int = 7

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of cells (4,) of each zone, from the clamp to the middle."""
        return self.grip, self.clearance, self.lead, self.curved

    @property
    def cells(self) -> int:
        """Number n of cells."""
        return sum(self.counts)

    @property
    def covered(self) -> int:
        """Number c of cells in the mold, the last ones."""
        return self.lead + self.curved


@lru_cache(maxsize=16)
def zones(resolution: Resolution) -> NDArray[np.intp]:
    """Zone (n,) of each cell: GRIP, CLEARANCE, LEAD or CURVED; a read-only array."""
    zone = np.repeat(np.arange(4), resolution.counts)
    zone.flags.writeable = False
    return zone


@dataclass(frozen=True, eq=False)
class Volumes:
    """Coefficients of the finite volumes; n cells of the tube, of which the last c are in the mold, and M shells.

    Attributes:
        heat: heat capacity (n,) at the reference temperature, J/K.
        resistance: electric resistance (n,) at the reference temperature, 0 in the clamp, ohm.
        conduction: conductance (n-1,) between neighbours at the reference temperature, W/K.
        to_clamp, to_air, radiating: heat transfer (n,), W/K, W/K, W/K^4. to_mold: to the first shell (c,), W/K.
        shell_heat: heat capacity (c, M) of the shells, J/K.
        radial: conductance (c, M-1) between shells, W/K. outer: heat transfer (c,) to the air, W/K.
        axial: conductance (c-1, M) between shells of neighbouring cells, W/K.
        grip_share: fraction (n,) of the clamp around each cell. cover_share: fraction (c,) of the mold.
    """

    heat: Any
    resistance: Any
    conduction: Any
    to_clamp: Any
    to_air: Any
    radiating: Any
    to_mold: Any
    shell_heat: Any
    radial: Any
    outer: Any
    axial: Any
    grip_share: Any
    cover_share: Any

    @property
    def column(self) -> Any:
        """All coefficients in one column, in the order of the fields."""
        return ca.veccat(*(ca.densify(getattr(self, item.name)) for item in fields(self)))

    @classmethod
    def of(cls, column: Any, resolution: Resolution) -> Volumes:
        """Coefficients from their `column`."""
        shapes = volume_shapes(resolution)
        ends = np.cumsum([0, *(rows * columns for rows, columns in shapes.values())]).tolist()
        parts = zip(shapes.items(), ca.vertsplit(column, ends), strict=True)
        return cls(**{name: ca.reshape(part, *shape) for (name, shape), part in parts})


def volume_shapes(resolution: Resolution) -> dict[str, tuple[int, int]]:
    """Rows and columns of the entries of `Volumes`, in their order."""
    n, c, m = resolution.cells, resolution.covered, resolution.shells
    columns = {
        "heat": n, "resistance": n, "conduction": n - 1, "to_clamp": n, "to_air": n, "radiating": n, "to_mold": c,
        "shell_heat": (c, m), "radial": (c, m - 1), "outer": c, "axial": (c - 1, m), "grip_share": n, "cover_share": c,
    }  # fmt: skip
    return {name: size if isinstance(size, tuple) else (size, 1) for name, size in columns.items()}


def volumes(g: Properties, width: Any, vent: Any, shells: tuple[Any, Any], resolution: Resolution) -> Volumes:
    """Coefficients of the finite volumes.

    Args:
        g: constants by the names of PROPERTIES. width: (n,) of the cells, m.
        vent: (c,) fraction of the tube's surface that the mold leaves open.
        shells: (M,) cross-section of each, m^2, and (M-1,) logarithms of the ratios of their radii.
    """
    zone, first = zones(resolution), resolution.cells - resolution.covered
    ring, ratio = shells
    gripped = ca.DM((zone == GRIP).astype(float))
    bare = ca.vertcat(ca.DM((zone[:first] == CLEARANCE).astype(float)), vent) * width
    # Temperatures belong to the middle of a cell: neighbours are half of both widths apart.
    cover, distance = width[first:], 0.5 * (width[1:] + width[:-1])
    gap = g["gap"] * (1 - vent)
    return Volumes(
        heat=g["heat"] * width,
        resistance=(1 - gripped) * g["resistance"] * width,
        conduction=g["conduction"] / distance,
        to_clamp=gripped * g["to_clamp"] * width,
        to_air=g["to_air"] * bare,
        radiating=g["radiating"] * bare,
        # 1 / (1 / gap + wall), without dividing by a gap that vents take away.
        to_mold=cover * gap / (1 + gap * g["wall"]),
        shell_heat=ca.mtimes(cover, (g["mold_heat"] * ring).T),
        # Steady flow between the radii r < R of a ring: 2 pi k dx (T_r - T_R) / ln(R / r).
        radial=2 * math.pi * g["mold_k"] * ca.mtimes(cover, (1 / ratio).T),
        outer=g["outer"] * cover,
        axial=g["mold_k"] * ca.mtimes(1 / distance[first:], ring.T),
        grip_share=gripped * width / g["grip"],
        cover_share=cover / ca.sum1(cover),
    )


# --- the circuit ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Load:
    """Electric load of the battery."""

    half: Any
    """Resistance of half the tube, ohm."""
    mean: Any
    """Mean current of the battery, A."""
    drive: Any
    """Mean square of the current: duty times current squared, A^2."""


def resistances(tube: Any, v: Volumes, g: Properties) -> Any:
    """Resistances (n,) of the cells at temperatures (n,), K, in ohm."""
    return v.resistance * (1 + g["resistance_slope"] * (tube - g["reference"]))


def tube_share(half: Any, g: Properties) -> Any:
    """Fraction of the current that flows through the tube; the rest flows through the mold."""
    # R = 2 half in parallel with 1 / leak: I_tube / I = (1 / R) / (1 / R + leak).
    return 1 / (1 + 2 * half * g["leak"])


def source_voltage(used: Any, g: Properties) -> Any:
    """Open-circuit voltage of the battery, V, after the fraction `used` of its charge was drawn."""
    return g["voltage"] - g["voltage_slope"] * used


def loop_resistance(half: Any, g: Properties) -> Any:
    """Resistance of the whole circuit, including that of the battery, ohm."""
    # R / (1 + R leak) is the resistance of tube and mold in parallel.
    return g["internal"] + g["series"] + 2 * half * tube_share(half, g)


def conducting(duty: Any, g: Properties) -> Any:
    """Effective duty: fraction of the time in which the full current gives the power of the pulses.

    The inductance of the circuit delays the rise of the current in every pulse; at a duty of 1 there are no pulses.
    """
    # A pulse shorter than the delay has no power.
    return ca.if_else(duty < 1, ca.fmax(duty - g["lost"], 0.0), duty)


def battery_rates(load: Load, sagged: Any, g: Properties) -> tuple[Any, Any]:
    """Rates of the used charge (1/s) and of the voltage sag (V/s)."""
    return load.mean / g["capacity"], (load.mean * g["sag"] - sagged) / g["sag_time"]


# --- heat -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Temperatures:
    """Temperatures of tube (n,), mold (c, M) and clamp, K."""

    tube: Any
    mold: Any
    clamp: Any


@dataclass(frozen=True, eq=False)
class Flows:
    """Net heat flows into tube (n,), mold (c, M) and one clamp, and from half of the rig to the surroundings, W."""

    tube: Any
    mold: Any
    clamp: Any
    surroundings: Any


def heat_flows(at: Temperatures, load: Load, v: Volumes, g: Properties) -> Flows:
    """Heat balance of half the tube, half the mold and one clamp."""
    first, ambient = at.tube.numel() - at.mold.size1(), g["ambient"]
    into_mold = v.to_mold * (at.tube[first:] - at.mold[:, 0])
    cells = cell_flows(at.tube, at.clamp, load, v, g)
    along = _net(heat_along(at.tube[:-1], at.tube[1:], v.conduction, g))
    outward = v.radial * (at.mold[:, :-1] - at.mold[:, 1:])
    outside = v.outer * (at.mold[:, -1] - ambient)
    sideways = _net(v.axial * (at.mold[1:, :] - at.mold[:-1, :]))
    q_clamp, q_air = ca.sum1(cells.q_clamp), ca.sum1(cells.q_air) + ca.sum1(outside)
    clamp, surroundings = lump_flows(at.clamp, q_clamp, q_air, load, g)
    return Flows(
        tube=cells.net + along - ca.vertcat(ca.DM(first, 1), into_mold),
        mold=ca.horzcat(into_mold + stray_heat(load, v.cover_share, g), outward)
        - ca.horzcat(outward, outside)
        + sideways,
        clamp=clamp,
        surroundings=surroundings,
    )


class CellFlows(NamedTuple):
    """Heat flows of cells of the tube, W, without conduction along the tube and into the mold."""

    net: Any
    """Joule heat and contact heat, less the losses."""
    q_clamp: Any
    """Loss to the clamp."""
    q_air: Any
    """Loss to the air."""


def cell_flows(tube: Any, clamp: Any, load: Load, v: Volumes, g: Properties) -> CellFlows:
    """Heat flows of cells at temperatures `tube`, K."""
    q_clamp = v.to_clamp * (tube - clamp)
    q_air = heat_to_air(tube, g["ambient"], v.to_air, v.radiating)
    # Joule heat is quadratic in the tube's current, which is the fraction `tube_share` of the whole current.
    q_joule = load.drive * tube_share(load.half, g) ** 2 * resistances(tube, v, g)
    return CellFlows(q_joule - q_clamp - q_air + contact_heat(load, g) * v.grip_share, q_clamp, q_air)


def heat_to_air(hot: Any, ambient: Any, convection: Any, radiation: Any) -> Any:
    """Heat flow to the air, W or W/m^2, from surfaces at `hot`, K, into surroundings at `ambient`, K.

    Args:
        convection: W/K or W/(m^2 K).  radiation: W/K^4 or W/(m^2 K^4).
    """
    return convection * (hot - ambient) + radiation * (hot**4 - ambient**4)


def heat_along(left: Any, right: Any, conduction: Any, g: Properties) -> Any:
    """Conductive heat flow between neighbouring cells of the tube, from `right` to `left`, W."""
    # k is linear in T, so its value at the mean is its exact average between both temperatures.
    slope = 1 + g["conduction_slope"] * (0.5 * (right + left) - g["reference"])
    return conduction * slope * (right - left)


def contact_heat(load: Load, g: Properties) -> Any:
    """Heat of one clamp contact that flows into the tube, W; the same flows into the clamp."""
    # Two contacts have half of the resistance each, and half of the heat of each goes to either side.
    return 0.25 * load.drive * g["contact"]


def stray_heat(load: Load, cover_share: Any, g: Properties) -> Any:
    """Joule heat in parts of the mold, by the current that flows through it, W."""
    # The current I (1 - f) flows through half of the mold at the voltage I f R / 2 of half of the tube.
    fraction = tube_share(load.half, g)
    return load.drive * (1 - fraction) * fraction * load.half * cover_share


def lump_flows(clamp: Any, q_clamp: Any, q_air: Any, load: Load, g: Properties) -> tuple[Any, Any]:
    """Net heat flows into one clamp, and from half of the rig to its surroundings, W.

    Args:
        clamp: temperature of the clamp, K.
        q_clamp: heat flow from tube to clamp, W.  q_air: heat flow from tube and mold to the air, W.
    """
    cooling = g["clamp_loss"] * (clamp - g["ambient"])
    return q_clamp + contact_heat(load, g) - cooling, q_air + cooling


def _net(flow: Any) -> Any:
    """Net inflow (n, ...) of cells from flows (n-1, ...) between them, each from the next cell to the one before."""
    none = ca.DM(1, flow.size2())
    return ca.vertcat(flow, none) - ca.vertcat(none, flow)


def tube_capacity(tube: Any, v: Volumes, g: Properties) -> Any:
    """Heat capacities (n,) of the cells at temperatures (n,), K, in J/K; those of the shells are constant."""
    return v.heat * (1 + g["heat_slope"] * (tube - g["reference"]))


def stored_heat(at: Temperatures, v: Volumes, g: Properties) -> Any:
    """Heat in half the tube, half the mold and one clamp above ambient, J: the integral of the capacities."""
    ambient, reference = g["ambient"], g["reference"]
    # Integral of heat_slope (T - T_ref) from ambient to the temperature.
    curve = 0.5 * g["heat_slope"] * ((at.tube - reference) ** 2 - (ambient - reference) ** 2)
    metal = ca.dot(v.heat, at.tube - ambient + curve)
    return metal + ca.dot(v.shell_heat, at.mold - ambient) + g["clamp_heat"] * (at.clamp - ambient)


class FrozenJacobian(NamedTuple):
    """Entries of the Jacobian of the heat flows into cells (1 + M, n), W/K, above its diagonal and on it."""

    diagonal: Any
    """Entries (1 + M, n) of a cell with itself."""
    outward: Any
    """Entries (1 + M, n) with the next shell of the same cell, 0 in the last row."""
    along: Any
    """Entries (1 + M, n-1) with the same shell of the next cell."""


def frozen_jacobian(at: Temperatures, cells: Any, v: Volumes, g: Properties) -> FrozenJacobian:
    """Approximate Jacobian of the heat flows for an implicit step: without Joule heat.

    It is symmetric but for the slope of the conductivity. `cells` (1 + M, n) are the symbols in `at`.
    """
    # The current depends on the resistance of all cells, so that with it the Jacobian would be full.
    flows = heat_flows(at, Load(0.0, 0.0, 0.0), v, g)
    rows, n = cells.shape
    J = ca.jacobian(ca.vec(by_cell(flows.tube, flows.mold)), ca.vec(cells))
    # By columns, a shell is 1 entry from the next one outward and `rows` entries from the next cell.
    diagonal, outward, along = (_diagonal(J, offset) for offset in (0, 1, rows))
    return FrozenJacobian(
        diagonal=ca.reshape(diagonal, rows, n),
        outward=ca.reshape(ca.vertcat(outward, 0), rows, n),
        along=ca.reshape(along, rows, n - 1),
    )


def _diagonal(matrix: Any, offset: int) -> Any:
    """Entries (r, r + offset) of a square matrix."""
    size = matrix.size1()
    pattern = ca.Sparsity.triplet(size, size, list(range(size - offset)), list(range(offset, size)))
    return ca.project(matrix, pattern).nz[:]


def by_cell(tube: Any, mold: Any, bare: float = 0.0) -> Any:
    """Values (1 + M, n) of the tube (first row) and the shells around it; `bare` where there is no mold."""
    outside = bare * ca.DM.ones(mold.size2(), tube.numel() - mold.size1())
    return ca.densify(ca.vertcat(tube.T, ca.horzcat(outside, mold.T)))
