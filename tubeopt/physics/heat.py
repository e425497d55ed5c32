"""Heat at one instant in half a tube that its own resistance warms in a mold: finite volumes as CasADi expressions.

Along the tube, from the outer end of a clamp to the middle of the curved part:

    rho c(T) A T_t = (k(T) A T_x)_x + d I^2 rho_e(T) / A - q

with q the heat loss per length: into the clamp where the tube is gripped, to the air (convection and radiation) where
it is bare, through the air gap into the mold where it is covered, and to the air through vents. Around every covered
cell lie shells of mold. They conduct heat to one another in radius and along the tube; the outermost cools in air. The
clamps are lumps. d is the duty, I the current while the MOSFET conducts:

    I (R_internal + R_series + R) = V_oc(charge) - V_sag,   charge' = d I / Q,   tau V_sag' = d I R_sag - V_sag

and R the resistance of the tube, in parallel with that of a conductive mold.

`energy_balance` and `state_rates` are the model. The simulation and the optimal control problem both call them, with
numbers or symbols. The optimal control problem keeps I and R as unknowns of their own, the simulation eliminates them.
Temperatures are in K.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..constants import ZERO_CELSIUS

GRIP, CLEARANCE, LEAD, CURVED = range(4)
"""Zones from the clamp to the middle of the curved part; the last two are in the mold."""


@dataclass(frozen=True, eq=False)
class Properties:
    """Parameters of tube and rig, SI; h_ are heat transfer coefficients per length of tube, W/(m K)."""

    # Tube, per length. Heat capacity, conductivity and resistance are linear in temperature.
    c_tube: Any
    """Heat capacity of the tube per length at T_ref, J/(m K)."""
    c_slope: Any
    """Relative slope of the heat capacity, 1/K."""
    T_ref: Any
    """Reference temperature of the material data of the tube, K."""
    kA: Any
    """Conductivity times cross-section of the tube at T_ref, W m/K."""
    k_slope: Any
    """Relative slope of the conductivity, 1/K."""
    r_tube: Any
    """Electrical resistance of the tube per length at T_ref, ohm/m."""
    r_slope: Any
    """Relative slope of the resistance, 1/K."""
    h_clamp: Any
    """Transfer into the clamp."""
    h_air: Any
    """Convection of the bare tube to air."""
    eps_sigma: Any
    """Radiation of the bare tube per length, W/(m K^4)."""
    h_gap: Any
    """Transfer through the air gap into the mold."""
    # Mold.
    R_wall: Any
    """Thermal resistance of the inner half of the innermost shell, m K/W; at k_mold."""
    k_mold: Any
    """Thermal conductivity of the mold where its factor is 1, W/(m K)."""
    f_mold: Any
    """Factor on the conductivity of the mold at and below the first of `BENDS`."""
    f_25: Any
    """Slope of this factor above 25 degC, 1/K."""
    f_200: Any
    """Change of the slope at 200 degC, 1/K; and so on at the other `BENDS`."""
    f_350: Any
    f_500: Any
    f_700: Any
    c_mold: Any
    """Heat capacity of the mold per volume, J/(m^3 K)."""
    h_outer: Any
    """Transfer from the outermost node of the mold to air."""
    G_leak: Any
    """Electrical conductance of the mold in parallel with the tube, 1/ohm."""
    # Circuit and clamps.
    R_series: Any
    """Resistance of cables, contacts and MOSFET, ohm."""
    R_contact: Any
    """Resistance of both contacts of the clamps together, part of R_series, ohm."""
    C_clamp: Any
    """Heat capacity of one clamp, J/K."""
    G_clamp_air: Any
    """Heat transfer from one clamp to air, W/K."""
    # Battery.
    V_start: Any
    """Open-circuit voltage before heating, V."""
    V_slope: Any
    """Change of the open-circuit voltage with the state of charge, V."""
    R_internal: Any
    """Immediate internal resistance, ohm."""
    R_sag: Any
    """Additional resistance after the voltage sag, ohm."""
    tau_sag: Any
    """Time constant of the sag, s."""
    Q_battery: Any
    """Charge of the full battery, C."""
    lost_duty: Any
    """Fraction of a PWM period that each pulse loses while the current rises."""
    T_amb: Any
    """Ambient temperature, K."""
    L_grip: Any
    """Length of tube in one clamp, m."""
    L_curved: Any
    """Half the length of the curved part, m."""
    G_wire: Any
    """Heat drawn by one leg of a thermocouple, per rise of the tube, W/K."""
    L_wire: Any
    """Length of the tube from the middle of the curved part that a leg lies on, m."""

    @classmethod
    def of(cls, column: Any) -> Properties:
        """Properties from a column of symbols in the order of the fields."""
        return cls(*ca.vertsplit(column))


PROPERTIES = tuple(item.name for item in fields(Properties))
"""Names of the properties in the order of their columns."""

BENDS = np.array([25.0, 200.0, 350.0, 500.0, 700.0]) + ZERO_CELSIUS
"""Temperatures, K, between which the conductivity of the mold is linear; constant outside."""

ROUNDED = 15.0
"""Distance from a bend, K, within which it is rounded."""


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
        """Number of cells of half the tube, n."""
        return sum(self.counts)

    @property
    def covered(self) -> int:
        """Number of cells in the mold, c; they are the last ones."""
        return self.lead + self.curved


@lru_cache(maxsize=16)
def zones(resolution: Resolution) -> NDArray[np.intp]:
    """(n,) zone of each cell: GRIP, CLEARANCE, LEAD or CURVED; read-only."""
    zone = np.repeat(np.arange(4), resolution.counts)
    zone.flags.writeable = False
    return zone


class Shells(NamedTuple):
    """Geometry of the M shells of the mold."""

    area: Any
    """(M,) cross-sections, m^2."""
    log_ratio: Any
    """(M-1,) logarithms of the ratios of neighbouring node radii."""


@dataclass(frozen=True, eq=False)
class Volumes:
    """Coefficients of the finite volumes: n cells of the tube, the last c of them in the mold, and M shells."""

    C_tube: Any
    """(n,) heat capacities of the cells at T_ref, J/K."""
    R_tube: Any
    """(n,) electrical resistances at T_ref, 0 in the clamp, ohm."""
    G_tube: Any
    """(n-1,) conductances between neighbouring cells at T_ref, W/K."""
    G_clamp: Any
    """(n,) conductances into the clamp, W/K."""
    G_air: Any
    """(n,) convection to air, W/K."""
    G_rad: Any
    """Coefficient (n,) of radiation of each cell, W/K^4."""
    G_gap: Any
    """(c,) conductances of the air gap, W/K."""
    G_wall: Any
    """(c,) conductances from the gap into the first shell at k_mold, W/K."""
    C_mold: Any
    """(c, M) heat capacities of the shells, J/K."""
    G_radial: Any
    """(c, M-1) conductances between shells of one cell at k_mold, W/K."""
    G_outer: Any
    """(c,) conductances from the outermost shell to air, W/K."""
    G_shell: Any
    """(c-1, M) conductances between shells of neighbouring cells at k_mold, W/K."""
    clamp_fraction: Any
    """(n,) fraction of the clamp around each cell."""
    mold_fraction: Any
    """(c,) fraction of the mold around each cell."""

    @property
    def column(self) -> Any:
        """All coefficients in one column, field after field."""
        return ca.veccat(*(ca.densify(getattr(self, item.name)) for item in fields(self)))

    @classmethod
    def of(cls, column: Any, resolution: Resolution) -> Volumes:
        """Coefficients from `column`."""
        shapes = volume_shapes(resolution)
        ends = np.cumsum([0, *(rows * columns for rows, columns in shapes.values())]).tolist()
        parts = zip(shapes.items(), ca.vertsplit(column, ends), strict=True)
        return cls(**{name: ca.reshape(part, *shape) for (name, shape), part in parts})


def volume_shapes(resolution: Resolution) -> dict[str, tuple[int, int]]:
    """Rows and columns of the fields of `Volumes`, in their order."""
    n, c, m = resolution.cells, resolution.covered, resolution.shells
    sizes = (n, n, n - 1, n, n, n, c, c, (c, m), (c, m - 1), c, (c - 1, m), n, c)
    shapes = (size if isinstance(size, tuple) else (size, 1) for size in sizes)
    return dict(zip((item.name for item in fields(Volumes)), shapes, strict=True))


def volumes(p: Properties, width: Any, vent: Any, shells: Shells, resolution: Resolution) -> Volumes:
    """Coefficients of the finite volumes.

    Args:
        p: tube and rig. width: (n,) of the cells, m.
        vent: (c,) fraction of the tube's surface that the mold leaves open.
    """
    zone, first = zones(resolution), resolution.cells - resolution.covered
    gripped = ca.DM((zone == GRIP).astype(float))
    bare = ca.vertcat(ca.DM((zone[:first] == CLEARANCE).astype(float)), vent) * width
    # A thermocouple draws heat from the middle: as much of a cell as lies within its leg.
    ends = ca.cumsum(width[::-1])[::-1]
    on_leg = ca.fmax(ca.fmin(ends, p.L_wire) - (ends - width), 0) / p.L_wire
    # Temperatures belong to the middle of a cell: neighbours are half of both widths apart.
    covered, distance = width[first:], 0.5 * (width[1:] + width[:-1])
    h_gap = p.h_gap * (1 - vent)
    return Volumes(
        C_tube=p.c_tube * width,
        R_tube=(1 - gripped) * p.r_tube * width,
        G_tube=p.kA / distance,
        G_clamp=gripped * p.h_clamp * width,
        G_air=p.h_air * bare + p.G_wire * on_leg,
        G_rad=p.eps_sigma * bare,
        G_gap=covered * h_gap,
        G_wall=covered / p.R_wall,
        C_mold=ca.mtimes(covered, (p.c_mold * shells.area).T),
        # Steady flow between the radii r < R of a ring: 2 pi k dx (T_r - T_R) / ln(R / r).
        G_radial=2 * math.pi * p.k_mold * ca.mtimes(covered, (1 / shells.log_ratio).T),
        G_outer=p.h_outer * covered,
        G_shell=p.k_mold * ca.mtimes(1 / distance[first:], shells.area.T),
        clamp_fraction=gripped * width / p.L_grip,
        mold_fraction=covered / ca.sum1(covered),
    )


# --- circuit ----------------------------------------------------------------------------------------------------------


class Drive(NamedTuple):
    """Electrical quantities that heat the rig."""

    R_half: Any
    """Resistance of half the tube, ohm."""
    I_mean: Any
    """Battery current, averaged over a PWM period, A."""
    I_sq: Any
    """Mean square of the battery current, A^2."""


def cell_resistance(T: Any, v: Volumes, p: Properties) -> Any:
    """(n,) resistances of the cells at temperatures (n,), ohm."""
    return v.R_tube * (1 + p.r_slope * (T - p.T_ref))


def tube_fraction(R_half: Any, p: Properties) -> Any:
    """Fraction of the current that flows through the tube and not through the mold."""
    # R = 2 R_half in parallel with 1 / G_leak: I_tube / I = (1 / R) / (1 / R + G_leak).
    return 1 / (1 + 2 * R_half * p.G_leak)


def open_circuit_voltage(charge: Any, p: Properties) -> Any:
    """Open-circuit voltage after drawing a fraction `charge` of the capacity, V."""
    return p.V_start - p.V_slope * charge


def loop_resistance(R_half: Any, p: Properties) -> Any:
    """Resistance of the whole loop: battery, circuit, and tube in parallel with the mold, ohm."""
    # R / (1 + R G_leak) is the resistance of tube and mold in parallel.
    return p.R_internal + p.R_series + 2 * R_half * tube_fraction(R_half, p)


def effective_duty(duty: Any, p: Properties) -> Any:
    """Fraction of time at full current that gives the power of pulses of this duty.

    It is less than the duty, since the inductance of the loop delays the current of each pulse. A switch that is always
    on loses nothing.
    """
    # Pulses shorter than the loss would otherwise give negative power.
    return ca.if_else(duty < 1, ca.fmax(duty - p.lost_duty, 0.0), duty)


class BatteryRates(NamedTuple):
    """Rates of the battery's states."""

    charge: Any
    """Rate of the fraction of the capacity that was drawn, 1/s."""
    V_sag: Any
    """Rate of the voltage sag, V/s."""


def battery_rates(drive: Drive, V_sag: Any, p: Properties) -> BatteryRates:
    """Rates of charge and sag under a mean current."""
    return BatteryRates(drive.I_mean / p.Q_battery, (drive.I_mean * p.R_sag - V_sag) / p.tau_sag)


# --- heat -------------------------------------------------------------------------------------------------------------


class Temperatures(NamedTuple):
    """Temperatures of half the rig, K."""

    tube: Any
    """(n,) cells."""
    mold: Any
    """(c, M) shells."""
    clamp: Any


class HeatFlows(NamedTuple):
    """Net heat flows into the parts of half the rig, W."""

    tube: Any
    """(n,) cells."""
    mold: Any
    """(c, M) shells."""
    clamp: Any
    """Heat flow into one clamp, W."""
    surroundings: Any
    """Air around half the rig."""


class MoldConductances(NamedTuple):
    """Conductances of the mold at its temperatures, W/K."""

    gap: Any
    """Conductances (c,) from the tube into the first shell."""
    radial: Any
    """Conductances (c, M-1) between shells of one cell."""
    along: Any
    """Conductances (c-1, M) between shells of neighbouring cells."""


def mold_factor(T: Any, p: Properties) -> Any:
    """Conductivity of the mold at temperatures T as a factor on k_mold: linear between `BENDS`."""
    changes = (p.f_25, p.f_200, p.f_350, p.f_500, p.f_700)
    # max(x, 0) = (x + |x|) / 2, rounded at the bend: without a corner, for the program of a schedule.
    beyond = [T - at + ca.sqrt((T - at) ** 2 + ROUNDED**2) for at in BENDS.tolist()]
    return p.f_mold + 0.5 * sum(change * x for change, x in zip(changes, beyond, strict=True))


def mold_conductances(mold: Any, v: Volumes, p: Properties) -> MoldConductances:
    """Conductances at temperatures (c, M) of the shells: the mean of the conductivities of two neighbours."""
    f = mold_factor(mold, p)
    return MoldConductances(
        gap_conductance(f[:, 0], v),
        0.5 * v.G_radial * (f[:, :-1] + f[:, 1:]),
        0.5 * v.G_shell * (f[:-1, :] + f[1:, :]),
    )


def gap_conductance(factor: Any, v: Volumes) -> Any:
    """Conductance of air gap and wall, whose conductivity has this factor, in series, W/K."""
    # 1 / (1 / G_gap + 1 / (factor G_wall)), without dividing by a G_gap that vents reduce to 0.
    return v.G_gap * factor * v.G_wall / (v.G_gap + factor * v.G_wall)


def energy_balance(
    T: Temperatures, drive: Drive, v: Volumes, p: Properties, mold: MoldConductances | None = None
) -> HeatFlows:
    """Net heat flows into the cells of half the tube, half of the mold, one clamp and the air.

    `mold`: conductances of the mold; by default those at its temperatures.
    """
    first = T.tube.numel() - T.mold.size1()
    mold = mold_conductances(T.mold, v, p) if mold is None else mold
    # Joule heat of the cells and contacts, less the losses into the clamp and to the air.
    cell = cell_balance(T.tube, T.clamp, drive, v, p)
    # Conduction along the tube.
    q_tube = conduction(T.tube[:-1], T.tube[1:], v.G_tube, p)
    # Through the air gap of the groove into the innermost shell.
    q_gap = mold.gap * (T.tube[first:] - T.mold[:, 0])
    # Joule heat of the current that bypasses the tube in a conductive mold, at its inner surface.
    q_leak = leak_heat(drive, v.mold_fraction, p)
    # Conduction in the mold, outwards and along the tube.
    q_radial = mold.radial * (T.mold[:, :-1] - T.mold[:, 1:])
    q_along = mold.along * (T.mold[1:, :] - T.mold[:-1, :])
    # From the outer surface of the mold to the air.
    q_outer = v.G_outer * (T.mold[:, -1] - p.T_amb)
    lump = clamp_balance(T.clamp, ca.sum1(cell.clamp), ca.sum1(cell.air) + ca.sum1(q_outer), drive, p)
    return HeatFlows(
        tube=cell.net + _net_inflow(q_tube) - ca.vertcat(ca.DM(first, 1), q_gap),
        mold=ca.horzcat(q_gap + q_leak, q_radial) - ca.horzcat(q_radial, q_outer) + _net_inflow(q_along),
        clamp=lump.clamp,
        surroundings=lump.surroundings,
    )


class CellFlows(NamedTuple):
    """Heat flows of cells of the tube, except those to neighbouring cells and into the mold, W."""

    net: Any
    """Net flow into the cell."""
    clamp: Any
    """Heat flow from the cell into the clamp, W."""
    air: Any
    """Heat flow from the cell to the air, W."""


def cell_balance(T: Any, T_clamp: Any, drive: Drive, v: Volumes, p: Properties) -> CellFlows:
    """Joule heat and losses of cells at temperatures T, each by itself."""
    # Joule heat follows the square of the tube's own current.
    q_joule = drive.I_sq * tube_fraction(drive.R_half, p) ** 2 * cell_resistance(T, v, p)
    # Heat of the contact, spread over the gripped cells.
    q_contact = contact_heat(drive, p) * v.clamp_fraction
    # Conduction into the clamp.
    q_clamp = v.G_clamp * (T - T_clamp)
    # Convection and radiation where the tube is bare.
    q_air = air_loss(T, p.T_amb, v.G_air, v.G_rad)
    return CellFlows(q_joule - q_clamp - q_air + q_contact, q_clamp, q_air)


def air_loss(T: Any, T_amb: Any, convection: Any, radiation: Any) -> Any:
    """Heat loss of surfaces to air by convection and radiation.

    Args:
        T, T_amb: temperatures of surface and surroundings, K.
        convection: W/K, or W/(m^2 K) for a heat flux. radiation: W/K^4, or W/(m^2 K^4).
    """
    return convection * (T - T_amb) + radiation * (T**4 - T_amb**4)


def conduction(T_left: Any, T_right: Any, G: Any, p: Properties) -> Any:
    """Conductive heat flow along the tube between neighbouring cells, right to left, W."""
    # k is linear in T, so its value at the mean is its exact average between both temperatures.
    slope = 1 + p.k_slope * (0.5 * (T_right + T_left) - p.T_ref)
    return G * slope * (T_right - T_left)


def contact_heat(drive: Drive, p: Properties) -> Any:
    """Joule heat of one contact that flows to each of its two sides, tube and clamp, W."""
    # Each of two contacts has half of the resistance, and half of its heat flows to either side.
    return 0.25 * drive.I_sq * p.R_contact


def leak_heat(drive: Drive, mold_fraction: Any, p: Properties) -> Any:
    """Joule heat, W, of the current that flows through parts of the mold in parallel to the tube."""
    # Half the mold carries the current (1 - f) I at the voltage f I R_half of half the tube.
    f = tube_fraction(drive.R_half, p)
    return drive.I_sq * (1 - f) * f * drive.R_half * mold_fraction


class ClampFlows(NamedTuple):
    """Net heat flows into the lumps of half the rig, W."""

    clamp: Any
    surroundings: Any


def clamp_balance(T_clamp: Any, q_clamp: Any, q_loss: Any, drive: Drive, p: Properties) -> ClampFlows:
    """Net heat of one clamp and of the air, W, for the heat into the clamp and the losses."""
    # Free convection of the clamp.
    q_cooling = p.G_clamp_air * (T_clamp - p.T_amb)
    return ClampFlows(q_clamp + contact_heat(drive, p) - q_cooling, q_loss + q_cooling)


def _net_inflow(flow: Any) -> Any:
    """Net flow into each cell, by row, from the flows (n-1, ...) from each cell to the one before."""
    closed = ca.DM(1, flow.size2())
    return ca.vertcat(flow, closed) - ca.vertcat(closed, flow)


# --- states -----------------------------------------------------------------------------------------------------------


class RigState(NamedTuple):
    """States of half the rig, or their rates per s."""

    T: Temperatures
    charge: Any
    """Fraction of the capacity that was drawn."""
    V_sag: Any
    """Voltage sag of the battery, V."""


def state_rates(x: RigState, q: HeatFlows, drive: Drive, v: Volumes, p: Properties) -> RigState:
    """Rates of all states from their `energy_balance`: K/s, 1/s and V/s."""
    battery = battery_rates(drive, x.V_sag, p)
    return RigState(
        Temperatures(q.tube / tube_capacity(x.T.tube, v, p), q.mold / v.C_mold, q.clamp / p.C_clamp),
        battery.charge,
        battery.V_sag,
    )


def tube_capacity(T: Any, v: Volumes, p: Properties) -> Any:
    """(n,) heat capacities of the cells at temperatures (n,), J/K; the capacities of the shells are constant."""
    return v.C_tube * (1 + p.c_slope * (T - p.T_ref))


def stored_heat(T: Temperatures, v: Volumes, p: Properties) -> Any:
    """Heat in half the tube, half of the mold and one clamp above ambient, J: the integral of the capacities."""
    # Integral of c_slope (T - T_ref) from T_amb to T.
    curve = 0.5 * p.c_slope * ((T.tube - p.T_ref) ** 2 - (p.T_amb - p.T_ref) ** 2)
    tube = ca.dot(v.C_tube, T.tube - p.T_amb + curve)
    return tube + ca.dot(v.C_mold, T.mold - p.T_amb) + p.C_clamp * (T.clamp - p.T_amb)


class FrozenJacobian(NamedTuple):
    """Entries of the Jacobian of the heat flows into cells and shells (1 + M, n), W/K."""

    same_cell: Any
    """(1 + M, n) derivatives by the cell's own temperature."""
    outward: Any
    """(1 + M, n) derivatives by the temperature of the next shell of the same cell, 0 in the last row."""
    along: Any
    """(1 + M, n-1) derivatives by the temperature of the next cell."""


def frozen_jacobian(T: Temperatures, cells: Any, v: Volumes, p: Properties) -> FrozenJacobian:
    """Approximate Jacobian for the implicit step: Joule heat and the slope of the mold's conductivity are left out.

    It is symmetric except for the slope of the tube's conductivity. `cells` (1 + M, n) are the symbols of which T
    consists.
    """
    now = mold_conductances(T.mold, v, p)
    frozen = MoldConductances(*(ca.SX.sym("frozen", value.shape) for value in now))
    # The current depends on the resistance of all cells: with it the Jacobian would be full.
    flows = energy_balance(T, Drive(0.0, 0.0, 0.0), v, p, frozen)
    rows, n = cells.shape
    J = ca.jacobian(ca.vec(by_cell(flows.tube, flows.mold)), ca.vec(cells))
    J = ca.substitute(J, ca.veccat(*frozen), ca.veccat(*now))
    # By columns, a shell is 1 entry from the next one outward and `rows` entries from the next cell.
    same_cell, outward, along = (_diagonal(J, offset) for offset in (0, 1, rows))
    return FrozenJacobian(
        ca.reshape(same_cell, rows, n), ca.reshape(ca.vertcat(outward, 0), rows, n), ca.reshape(along, rows, n - 1)
    )


def _diagonal(matrix: Any, offset: int) -> Any:
    """Entries (r, r + offset) of a square matrix."""
    size = matrix.size1()
    pattern = ca.Sparsity.triplet(size, size, list(range(size - offset)), list(range(offset, size)))
    return ca.project(matrix, pattern).nz[:]


def by_cell(tube: Any, mold: Any, bare: float = 0.0) -> Any:
    """(1 + M, n) values of the tube (first row) and the shells around it, `bare` outside the mold."""
    outside = bare * ca.DM.ones(mold.size2(), tube.numel() - mold.size1())
    return ca.densify(ca.vertcat(tube.T, ca.horzcat(outside, mold.T)))
