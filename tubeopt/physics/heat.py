"""Heat at one instant in half a tube that its own resistance warms in a mold: finite volumes as CasADi expressions.

Along the tube, from the outer end of a clamp to the middle of the curved part:

    rho c(T) A T_t = (k(T) A T_x)_x + d I^2 rho_e(T) / A - q

with q the heat that leaves per length: into the clamp where the tube is gripped, to the air (convection and radiation)
where it is bare, through the gap into the mold where it is covered, and to the air through vents. Around every covered
cell lie shells of mold, conducting to one another in radius and along the tube; the outermost cools in air. The clamps
are lumps. d is the duty, I the current while the MOSFET conducts:

    I (R_battery + R_series + R) = V(charge) - V_sag,   charge' = -d I / capacity,   tau V_sag' = d I R_sag - V_sag

and R the tube's resistance, beside that of a mold which conducts.

Everything here takes numbers or symbols: the program of the ideal schedule keeps current and resistance as unknowns of
their own, the simulation eliminates them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any

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
"""Numbers of tube and rig, SI. Of the tube per length, at the temperature `reference`: heat capacity, conductivity
times section, resistance, with their relative slopes per K; heat transfer per length to clamp, air (and radiation) and
through the gap. Of the mold: resistance of its innermost half shell to heat, conductivity, heat capacity per volume,
transfer from the outermost shell per length, and conductance beside the tube to current. Resistances in series with
the tube, and the contacts' part of them; heat capacity and loss of a clamp; the battery; the part of a period
that every pulse loses while the current rises; lengths of clamp and half of the curved part."""

Properties = dict[str, Any]


def named(column: Any) -> Properties:
    """Properties by name, from a column of their values."""
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
    def counts(self) -> tuple[int, int, int, int]:
        """Cells of each zone, from the clamp to the middle."""
        return self.grip, self.clearance, self.lead, self.curved

    @property
    def cells(self) -> int:
        """n."""
        return sum(self.counts)

    @property
    def covered(self) -> int:
        """c, cells in the mold, the last ones."""
        return self.lead + self.curved


@lru_cache(maxsize=16)
def zones(resolution: Resolution) -> NDArray[np.intp]:
    """(n,) zone of each cell: GRIP, CLEARANCE, LEAD or CURVED; not to be written to."""
    found = np.repeat(np.arange(4), resolution.counts)
    found.flags.writeable = False
    return found


@dataclass(frozen=True, eq=False)
class Volumes:
    """Coefficients of the finite volumes; n cells of the tube, of which the last c are in the mold, and M shells.

    Attributes:
        heat: (n,) heat capacity at the reference temperature, J/K. resistance: (n,) then, 0 in the clamp, ohm.
        conduction: (n-1,) between neighbours then, W/K.
        to_clamp, to_air, radiating: (n,) W/K, W/K, W/K^4. to_mold: (c,) into the first shell, W/K.
        shell_heat: (c, M) J/K. radial: (c, M-1) W/K. outer: (c,) W/K.
        axial: (c-1, M) W/K between shells of neighbouring cells.
        grip_share: (n,) part of the clamp around each cell. cover_share: (c,) part of the mold.
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
        """All of them, by column in this order."""
        return ca.veccat(*(ca.densify(getattr(self, item.name)) for item in fields(self)))

    @classmethod
    def of(cls, column: Any, resolution: Resolution) -> Volumes:
        """From `column`."""
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
    """The coefficients.

    Args:
        g: numbers by the names of PROPERTIES. width: (n,) of the cells, m.
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
    """half: resistance of half the tube, ohm. mean: current of the battery, A. drive: duty times current squared,
    A^2."""

    half: Any
    mean: Any
    drive: Any


def resistances(tube: Any, v: Volumes, g: Properties) -> Any:
    """(n,) ohm of the cells at temperatures (n,), K."""
    return v.resistance * (1 + g["resistance_slope"] * (tube - g["reference"]))


def tube_share(half: Any, g: Properties) -> Any:
    """Part of the current that flows through the tube and not through the mold."""
    # R = 2 half in parallel with 1 / leak: I_tube / I = (1 / R) / (1 / R + leak).
    return 1 / (1 + 2 * half * g["leak"])


def source_voltage(used: Any, g: Properties) -> Any:
    """Of the battery at rest, V, when `used` of its charge was drawn."""
    return g["voltage"] - g["voltage_slope"] * used


def loop_resistance(half: Any, g: Properties) -> Any:
    """Everything that the battery feeds, with its own resistance, ohm."""
    # R / (1 + R leak) is the resistance of tube and mold in parallel.
    return g["internal"] + g["series"] + 2 * half * tube_share(half, g)


def conducting(duty: Any, g: Properties) -> Any:
    """Part of the time in which the full current would give the power of pulses of this duty: less than the duty, since
    the loop's inductance lets the current rise late; a switch that is never off loses nothing."""
    # Pulses shorter than the loss would else give negative power.
    return ca.if_else(duty < 1, ca.fmax(duty - g["lost"], 0.0), duty)


def battery_rates(load: Load, sagged: Any, g: Properties) -> tuple[Any, Any]:
    """Rates of charge used (1/s) and sag (V/s)."""
    return load.mean / g["capacity"], (load.mean * g["sag"] - sagged) / g["sag_time"]


# --- heat -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Temperatures:
    """tube (n,), mold (c, M), clamp; K."""

    tube: Any
    mold: Any
    clamp: Any


@dataclass(frozen=True, eq=False)
class Flows:
    """What tube (n,), mold (c, M) and one clamp gain, and half of the rig gives off to the surroundings, W."""

    tube: Any
    mold: Any
    clamp: Any
    surroundings: Any


def heat_flows(at: Temperatures, load: Load, v: Volumes, g: Properties) -> Flows:
    """The balance of half the tube, half the mold and one clamp."""
    first, ambient = at.tube.numel() - at.mold.size1(), g["ambient"]
    into_mold = v.to_mold * (at.tube[first:] - at.mold[:, 0])
    gain, into_clamp, air = cell_gains(at.tube, at.clamp, load, v, g)
    along = _gain(heat_along(at.tube[:-1], at.tube[1:], v.conduction, g))
    outward = v.radial * (at.mold[:, :-1] - at.mold[:, 1:])
    outside = v.outer * (at.mold[:, -1] - ambient)
    sideways = _gain(v.axial * (at.mold[1:, :] - at.mold[:-1, :]))
    clamp, surroundings = lump_gains(at.clamp, ca.sum1(into_clamp), ca.sum1(air) + ca.sum1(outside), load, g)
    return Flows(
        tube=gain + along - ca.vertcat(ca.DM(first, 1), into_mold),
        mold=ca.horzcat(into_mold + stray_heat(load, v.cover_share, g), outward)
        - ca.horzcat(outward, outside)
        + sideways,
        clamp=clamp,
        surroundings=surroundings,
    )


def cell_gains(tube: Any, clamp: Any, load: Load, v: Volumes, g: Properties) -> tuple[Any, Any, Any]:
    """What cells gain but for what passes to the next ones and into the mold, and of that, what goes into the clamp and
    to the air, W."""
    ambient = g["ambient"]
    into_clamp = v.to_clamp * (tube - clamp)
    air = heat_to_air(tube, ambient, v.to_air, v.radiating)
    # Heat follows the square of the tube's own current, hence its share squared.
    joule = load.drive * tube_share(load.half, g) ** 2 * resistances(tube, v, g)
    return joule - into_clamp - air + contact_heat(load, g) * v.grip_share, into_clamp, air


def heat_to_air(hot: Any, ambient: Any, convection: Any, radiation: Any) -> Any:
    """What passes to air, W or W/m^2, from surfaces at `hot` into surroundings at `ambient`, K, by convection (W/K or
    W/(m^2 K)) and by radiation (W/K^4 or W/(m^2 K^4))."""
    return convection * (hot - ambient) + radiation * (hot**4 - ambient**4)


def heat_along(left: Any, right: Any, conduction: Any, g: Properties) -> Any:
    """What passes along the tube from a cell at `right` to the one before at `left`, W."""
    # k is linear in T, so its value at the mean is its exact average between both temperatures.
    slope = 1 + g["conduction_slope"] * (0.5 * (right + left) - g["reference"])
    return conduction * slope * (right - left)


def contact_heat(load: Load, g: Properties) -> Any:
    """What a contact of the clamps makes, W: half into the tube's end, half into the clamp."""
    # Two contacts have half of the resistance each, and half of each one's heat goes to either side.
    return 0.25 * load.drive * g["contact"]


def stray_heat(load: Load, cover_share: Any, g: Properties) -> Any:
    """What the current beside the tube makes in parts of the mold, W."""
    # The current I (1 - share) beside half of the tube falls by its voltage, I share R / 2.
    share = tube_share(load.half, g)
    return load.drive * (1 - share) * share * load.half * cover_share


def lump_gains(clamp: Any, into_clamp: Any, off: Any, load: Load, g: Properties) -> tuple[Any, Any]:
    """What one clamp and the surroundings of half the rig gain, W, where the tube gives so much into the clamp, and
    tube and mold so much `off`."""
    cooling = g["clamp_loss"] * (clamp - g["ambient"])
    return into_clamp + contact_heat(load, g) - cooling, off + cooling


def _gain(flow: Any) -> Any:
    """What cells gain, by row, from flows (n-1, ...) that run from every next one to the one before."""
    nothing = ca.DM(1, flow.size2())
    return ca.vertcat(flow, nothing) - ca.vertcat(nothing, flow)


def tube_capacity(tube: Any, v: Volumes, g: Properties) -> Any:
    """(n,) J/K at temperatures (n,), K; that of the shells does not depend on them."""
    return v.heat * (1 + g["heat_slope"] * (tube - g["reference"]))


def stored_heat(at: Temperatures, v: Volumes, g: Properties) -> Any:
    """Heat in half the tube, half the mold and one clamp above ambient, J: the integral of the capacities."""
    ambient, reference = g["ambient"], g["reference"]
    # Integral of heat_slope (T - T_ref) from ambient to the temperature.
    curve = 0.5 * g["heat_slope"] * ((at.tube - reference) ** 2 - (ambient - reference) ** 2)
    metal = ca.dot(v.heat, at.tube - ambient + curve)
    return metal + ca.dot(v.shell_heat, at.mold - ambient) + g["clamp_heat"] * (at.clamp - ambient)


def frozen_jacobian(at: Temperatures, cells: Any, v: Volumes, g: Properties) -> tuple[Any, Any, Any]:
    """Jacobian of the flows into `cells` (1 + M, n) of which `at` consists, at no current: what an implicit step needs,
    short of what it can do without. Symmetric but for the slope of the conductivity.

    Returns:
        own: (1 + M, n) W/K. inward: (1 + M, n) with the next in the same cell, 0 in the last row.
        along: (1 + M, n-1) with the same in the next cell.
    """
    # The current depends on the resistance of all cells, so that with it the Jacobian would be full.
    nothing = Load(0.0, 0.0, 0.0)
    flows = heat_flows(at, nothing, v, g)
    rows, n = cells.shape
    J = ca.jacobian(ca.vec(by_cell(flows.tube, flows.mold)), ca.vec(cells))
    # By columns, a shell is 1 entry from the next one outward and `rows` entries from the next cell.
    own, inward, along = (_diagonal(J, offset) for offset in (0, 1, rows))
    return ca.reshape(own, rows, n), ca.reshape(ca.vertcat(inward, 0), rows, n), ca.reshape(along, rows, n - 1)


def _diagonal(matrix: Any, offset: int) -> Any:
    """Entries (r, r + offset) of a square matrix."""
    size = matrix.size1()
    pattern = ca.Sparsity.triplet(size, size, list(range(size - offset)), list(range(offset, size)))
    return ca.project(matrix, pattern).nz[:]


def by_cell(tube: Any, mold: Any, bare: float = 0.0) -> Any:
    """(1 + M, n) values of the tube (first row) and the shells around it, `bare` where there is no mold."""
    outside = bare * ca.DM.ones(mold.size2(), tube.numel() - mold.size1())
    return ca.densify(ca.vertcat(tube.T, ca.horzcat(outside, mold.T)))
