"""The balance of heat at one instant, and a step in time, as functions for a simulation that eliminates the current."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca

from . import heat
from .heat import PROPERTIES, Properties, Resolution, Shells

CLAMP, CHARGE, SAG, DRAWN, CIRCUIT, LOST = range(6)
"""Entries of the lumped state: clamp temperature (K), charge drawn (fraction), sag (V), and energies of the rig (J).

The energies are drawn from the battery's chemistry, turned to heat in battery, cables and MOSFET, and lost to the air.
"""

LUMPED = 6

GAMMA = 1 - 1 / math.sqrt(2)
"""Parameter of ROS2, which is of order 2 for any approximate Jacobian and L-stable with the exact one (Verwer, Spee,
Blom and Hundsdorfer, SIAM J. Sci. Comput. 20 (1999)): the root with the small error, which needs a Jacobian that is at
most a sixth too small."""


GROWTH = 1.15
"""Largest factor by which a conductance of the mold exceeds that of the Jacobian in the second stage of a step: where
temperatures change a lot within a step, the stage overshoots, and a Jacobian that is too small would not be stable."""

OF_A_CELL = ("C_tube", "R_tube", "G_clamp", "G_air", "G_rad", "clamp_fraction")
"""Entries of `Volumes` for one cell of the tube, in the argument order of laws and kernel."""


@lru_cache(maxsize=16)
def volumes_function(resolution: Resolution) -> ca.Function:
    """Function (properties, widths, vents, areas and log ratios of shells) -> column of all coefficients."""
    m = resolution.shells
    sizes = (len(PROPERTIES), resolution.cells, resolution.covered, m, m - 1)
    symbols = [ca.SX.sym(name, size) for name, size in zip("pwvrl", sizes, strict=True)]
    p, width, vent, area, log_ratio = symbols
    v = heat.volumes(Properties.of(p), width, vent, Shells(area, log_ratio), resolution)
    return ca.Function("volumes", symbols, [v.column])


class _Expressions(NamedTuple):
    """Inputs and outputs of a function."""

    inputs: list[ca.SX]
    outputs: list[ca.SX]


@lru_cache(maxsize=128)
def instant_function(resolution: Resolution, name: str) -> ca.Function:
    """Function of the state of one rig, for its simulation.

    Inputs, where they matter: temperatures, lumped state, duty, properties, column of volumes. Temperatures of cells
    are (1 + M, n); shells without a mold have no effect.

    rates: of cells and lumped state. warming: rates of the first two rows, which a current heats. span: rates of the
    tube without and with full duty, and the current while the MOSFET conducts. stage: rates with conductances of the
    mold that are at most GROWTH times those at temperatures given last. current, at temperatures of the tube
    (n,): this one, its part through the tube, the terminal voltage, and the resistance of half the tube. linearised:
    heat capacities, 1 where there is no mold, and the `frozen_jacobian`. stored: heat above ambient in the whole rig.
    """
    inputs, outputs = _instant(resolution)[name]
    return ca.Function(name, inputs, [ca.densify(value) for value in outputs], {"cse": True})


@lru_cache(maxsize=16)
def _instant(resolution: Resolution) -> dict[str, _Expressions]:
    """Expressions of each `instant_function`; functions of all of them would take eight times as long."""
    rows, n = 1 + resolution.shells, resolution.cells
    cells, tube = ca.SX.sym("cells", rows, n), ca.SX.sym("tube", n)
    lumped, duty = ca.SX.sym("lumped", LUMPED), ca.SX.sym("duty")
    column = ca.SX.sym("p", len(PROPERTIES))
    q = ca.SX.sym("q", sum(rows * columns for rows, columns in heat.volume_shapes(resolution).values()))
    p, v = Properties.of(column), heat.Volumes.of(q, resolution)
    T = heat.Temperatures(cells[0, :].T, cells[1:, n - resolution.covered :].T, lumped[CLAMP])
    x = heat.RigState(T, lumped[CHARGE], lumped[SAG])

    I_on, drive = _circuit(ca.sum1(heat.cell_resistance(T.tube, v, p)), lumped, duty, p)
    flows = heat.energy_balance(T, drive, v, p)
    rates = heat.state_rates(x, flows, drive, v, p)
    cell_rates = heat.by_cell(rates.T.tube, rates.T.mold)
    battery = heat.BatteryRates(rates.charge, rates.V_sag)
    lumped_rates = _lumped_rates(rates.T.clamp, battery, flows.surroundings, drive, I_on, lumped, p)
    start = ca.SX.sym("start", rows, n)
    before = heat.mold_conductances(start[1:, n - resolution.covered :].T, v, p)
    pairs = zip(heat.mold_conductances(T.mold, v, p), before, strict=True)
    bounded = heat.MoldConductances(*(ca.fmin(now, GROWTH * then) for now, then in pairs))
    staged = heat.state_rates(x, heat.energy_balance(T, drive, v, p, bounded), drive, v, p)
    capacity = heat.by_cell(heat.tube_capacity(T.tube, v, p), v.C_mold, bare=1.0)

    R_half = ca.sum1(heat.cell_resistance(tube, v, p))
    current = _circuit(R_half, lumped, duty, p).I_on
    terminal = heat.open_circuit_voltage(lumped[CHARGE], p) - lumped[SAG] - p.R_internal * current
    circuit = ca.vertcat(current, current * heat.tube_fraction(R_half, p), terminal, R_half)
    expressions = {
        "rates": ([cells, lumped, duty, column, q], [cell_rates, lumped_rates]),
        "stage": ([cells, lumped, duty, column, q, start], [heat.by_cell(staged.T.tube, staged.T.mold)]),
        # Joule heat enters the tube, leak heat the first shell; the other rows do not depend on duty.
        "warming": ([cells, lumped, duty, column, q], [cell_rates[:2, :]]),
        "current": ([tube, lumped, column, q], [circuit]),
        "linearised": ([cells, column, q], [capacity, *heat.frozen_jacobian(T, cells, v, p)]),
        "stored": ([cells, lumped, column, q], [2 * heat.stored_heat(T, v, p)]),
    }
    warming = ca.Function("warming", *expressions["warming"])
    ends = [warming(cells, lumped, level, column, q)[0, :].T for level in (0.0, 1.0)]
    expressions["span"] = [cells, lumped, column, q], [*ends, I_on]
    return {name: _Expressions(*each) for name, each in expressions.items()}


class _Circuit(NamedTuple):
    I_on: ca.SX
    """Current while the MOSFET conducts, A."""
    drive: heat.Drive


def _circuit(R_half: ca.SX, lumped: ca.SX, duty: ca.SX, p: Properties) -> _Circuit:
    """Currents at a duty, A, if half the tube has the resistance R_half, ohm."""
    I_on = (heat.open_circuit_voltage(lumped[CHARGE], p) - lumped[SAG]) / heat.loop_resistance(R_half, p)
    on = heat.effective_duty(duty, p)
    # The mean square of a pulsed current is d I^2, not (d I)^2.
    return _Circuit(I_on, heat.Drive(R_half, on * I_on, on * I_on**2))


def _lumped_rates(
    T_clamp: ca.SX,
    battery: heat.BatteryRates,
    q_surroundings: ca.SX,
    drive: heat.Drive,
    I_on: ca.SX,
    lumped: ca.SX,
    p: Properties,
) -> ca.SX:
    """Rates of the lumped state, from the rates of clamp (K/s) and battery and the heat flow into the air, W."""
    # The contacts' heat goes into tube and clamps, not into cables.
    R_circuit = p.R_internal + p.R_series - p.R_contact
    return ca.vertcat(
        T_clamp,
        battery.charge,
        battery.V_sag,
        drive.I_mean * heat.open_circuit_voltage(lumped[CHARGE], p),
        # d I (V_sag + I R): what the open-circuit voltage loses before it reaches the tube.
        drive.I_mean * (lumped[SAG] + I_on * R_circuit),
        # The flows are those of half the rig.
        2 * q_surroundings,
    )


@lru_cache(maxsize=1)
def cell_functions() -> tuple[ca.Function, ...]:
    """Laws of one cell: the compiled kernel makes the step of `step_function` from them, on grids of any size.

    ohm: resistance of a cell. load: `Drive` at a duty, with the current while the MOSFET conducts. cell: net heat flow
    of a cell by itself, heat of its part of the mold by the current beside the tube, heat flows into the clamp and to
    the air, its heat capacity, and the slope of these losses in its temperature. link: heat flow from the next cell,
    and its slopes in both temperatures. lumps: rates of the lumped state. factor: of the mold's conductivity at a
    temperature. gap: conductance of gap and wall, for this factor.
    """
    scalars = ("T", "T_next", "T_clamp", "q_clamp", "q_loss", "R_half", "duty", "coefficient", "factor")
    T, T_next, T_clamp, q_clamp, q_loss, R_half, duty, coefficient, factor = (ca.SX.sym(name) for name in scalars)
    lumped, load, column = ca.SX.sym("lumped", LUMPED), ca.SX.sym("load", 4), ca.SX.sym("p", len(PROPERTIES))
    p, drive, I_on = Properties.of(column), heat.Drive(load[0], load[1], load[2]), load[3]
    of_cell = {name: ca.SX.sym(name) for name in OF_A_CELL}
    of_gap = {name: ca.SX.sym(name) for name in ("G_gap", "G_wall")}
    # A law of one cell that took another coefficient would fail at once on None.
    v = heat.Volumes(**{item.name: (of_cell | of_gap).get(item.name) for item in fields(heat.Volumes)})
    cell = heat.cell_balance(T, T_clamp, drive, v, p)
    leak = heat.leak_heat(drive, coefficient, p)
    start = _circuit(R_half, lumped, duty, p)
    link = heat.conduction(T, T_next, coefficient, p)
    lumps = heat.clamp_balance(T_clamp, q_clamp, q_loss, drive, p)
    battery = heat.battery_rates(drive, lumped[SAG], p)
    rates = _lumped_rates(lumps.clamp / p.C_clamp, battery, lumps.surroundings, drive, I_on, lumped, p)
    laws = {
        "ohm": ([T, of_cell["R_tube"], column], [heat.cell_resistance(T, v, p)]),
        "load": ([R_half, lumped, duty, column], [ca.vertcat(*start.drive, start.I_on)]),
        "cell": (
            [T, T_clamp, load, *of_cell.values(), coefficient, column],
            [cell.net, leak, cell.clamp, cell.air, heat.tube_capacity(T, v, p), ca.jacobian(cell.clamp + cell.air, T)],
        ),
        "link": ([T, T_next, coefficient, column], [link, ca.jacobian(link, T), ca.jacobian(link, T_next)]),
        "lumps": ([T_clamp, q_clamp, q_loss, load, lumped, column], [rates]),
        "factor": ([T, column], [heat.mold_factor(T, p)]),
        "gap": ([factor, *of_gap.values()], [heat.gap_conductance(factor, v)]),
    }
    return tuple(
        ca.Function(f"law_{name}", inputs, [ca.densify(value) for value in outputs], {"cse": True})
        for name, (inputs, outputs) in laws.items()
    )


@lru_cache(maxsize=16)
def step_function(resolution: Resolution) -> ca.Function:
    """Function (cells, lumped, duty, span, properties, volumes) -> (cells, lumped) after a span, s: one step of ROS2.

    The matrix of a stage is the product of that of the shells and that along the tube (approximate factorisation).
    Both consist of many small tridiagonal matrices. The lumped states are slow: their Jacobian is left out, and they
    follow the cells by the trapezoidal rule.
    """
    rates, linearised, staged = (instant_function(resolution, name) for name in ("rates", "linearised", "stage"))
    inputs = rates.sx_in()
    cells, lumped, duty, p, q = inputs
    h = ca.SX.sym("span")
    capacity, same_cell, outward, along = linearised(cells, p, q)
    # Losses to clamp and air are in the second factor, which is exact where a cell has no shells.
    across = -outward - ca.vertcat(ca.DM(1, cells.size2()), outward[:-1, :])
    # C - gamma h (A + B) = (C - gamma h A) C^-1 (C - gamma h B) but for gamma^2 h^2 A C^-1 B.
    solve_outward = _tridiagonal(capacity - GAMMA * h * across, -GAMMA * h * outward[:-1, :])
    solve_along = _tridiagonal((capacity - GAMMA * h * (same_cell - across)).T, -GAMMA * h * along.T)

    def stage(rate: Any) -> Any:
        return solve_along((capacity * solve_outward(capacity * rate)).T).T

    # ROS2: (1 - gamma h J) k_1 = F(u), (1 - gamma h J) k_2 = F(u + h k_1) - 2 k_1, u_next = u + h (3 k_1 + k_2) / 2.
    rate, lumped_rate = rates(cells, lumped, duty, p, q)
    k_1 = stage(rate)
    predicted = lumped + h * lumped_rate
    k_2 = stage(staged(cells + h * k_1, predicted, duty, p, q, cells) - 2 * k_1)
    cells_next = cells + h * (1.5 * k_1 + 0.5 * k_2)
    # Rates at the end and not at u + h k_1, which overshoots where the equations are stiff.
    lumped_next = lumped + 0.5 * h * (lumped_rate + rates(cells_next, predicted, duty, p, q)[1])
    return ca.Function("step", [cells, lumped, duty, h, p, q], [cells_next, lumped_next], {"cse": True})


def _tridiagonal(diagonal: ca.SX, off_diagonal: ca.SX) -> Callable[[Any], Any]:
    """Solver of symmetric tridiagonal systems for right-hand sides in columns.

    Every column (N) of `diagonal` and (N-1) of `off_diagonal` is one system.
    """
    count = diagonal.size1()
    # No pivots: C - gamma h J is diagonally dominant, as heat flows from hot to cold.
    inverse, ratio = [1 / diagonal[0, :]], []
    for k in range(1, count):
        ratio.append(off_diagonal[k - 1, :] * inverse[-1])
        inverse.append(1 / (diagonal[k, :] - ratio[-1] * off_diagonal[k - 1, :]))

    def solve(right_hand_side: Any) -> Any:
        rows = [right_hand_side[0, :]]
        for k in range(1, count):
            rows.append(right_hand_side[k, :] - ratio[k - 1] * rows[-1])
        rows[-1] = rows[-1] * inverse[-1]
        for k in range(count - 2, -1, -1):
            rows[k] = rows[k] * inverse[k] - ratio[k] * rows[k + 1]
        return ca.vertcat(*rows)

    return solve
