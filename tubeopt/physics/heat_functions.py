"""Heat balance at one instant and over a time step, as functions for a simulation that eliminates the current."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields
from functools import lru_cache
from typing import Any

import casadi as ca

from . import heat
from .heat import PROPERTIES, Resolution, named

CLAMP, CHARGE, SAG, DRAWN, CIRCUIT, LOST = range(6)
"""Entries of the lumped state: clamp temperature (K), charge used (fraction), sag (V), and energies of the rig
(J): drawn from the battery's chemistry, turned to heat in battery, cables and MOSFET, lost to the surroundings."""

LUMPED = 6

GAMMA = 1 - 1 / math.sqrt(2)
"""Coefficient gamma of ROS2 (Verwer, Spee, Blom and Hundsdorfer, SIAM J. Sci. Comput. 20 (1999)).

The method has order 2 for any approximation of the Jacobian, and is L-stable with the exact one. Of its two values this
one has the smaller error; the Jacobian may then be at most a sixth too small."""


OF_A_CELL = ("heat", "resistance", "to_clamp", "to_air", "radiating", "grip_share")
"""Entries of `Volumes` that belong to one cell of the tube, in the order in which laws and kernel take them."""


@lru_cache(maxsize=16)
def volumes_function(resolution: Resolution) -> ca.Function:
    """Function (properties, widths, vents, rings, log ratios) -> column of all coefficients."""
    m = resolution.shells
    sizes = (len(PROPERTIES), resolution.cells, resolution.covered, m, m - 1)
    symbols = [ca.SX.sym(name, size) for name, size in zip("pwvrl", sizes, strict=True)]
    p, width, vent, *shells = symbols
    volumes = heat.volumes(named(p), width, vent, (shells[0], shells[1]), resolution)
    return ca.Function("volumes", symbols, [volumes.column])


@lru_cache(maxsize=16)
def instant_functions(resolution: Resolution) -> dict[str, ca.Function]:
    """Functions of one rig at an instant, by name.

    Arguments are those of temperatures, lumped state and duty on which a function depends, then properties and the
    column of volumes. Cells are (1 + M, n); entries of shells without a mold have no effect.

    rates: rates of cells and lumped state. warming: rates of the first two rows, which a current heats. span: rates of
    the tube at duty 0 and 1, and the current while the MOSFET conducts. current, at temperatures of the tube (n,): this
    current, its part through the tube, the terminal voltage, and the resistance of half the tube. linearised: heat
    capacities, 1 where there is no mold, and the `frozen_jacobian`. stored: heat above ambient in the whole rig.
    """
    rows, n = 1 + resolution.shells, resolution.cells
    cells, tube = ca.SX.sym("cells", rows, n), ca.SX.sym("tube", n)
    lumped, duty = ca.SX.sym("lumped", LUMPED), ca.SX.sym("duty")
    p = ca.SX.sym("p", len(PROPERTIES))
    q = ca.SX.sym("q", sum(rows * columns for rows, columns in heat.volume_shapes(resolution).values()))
    g, v = named(p), heat.Volumes.of(q, resolution)
    at = heat.Temperatures(cells[0, :].T, cells[1:, n - resolution.covered :].T, lumped[CLAMP])

    load, total = _loaded(ca.sum1(heat.resistances(at.tube, v, g)), lumped, duty, g)
    flows = heat.heat_flows(at, load, v, g)
    capacity = heat.by_cell(heat.tube_capacity(at.tube, v, g), v.shell_heat, bare=1.0)
    slow = _slow(flows.clamp, flows.surroundings, load, total, lumped, g)
    cell_rates = heat.by_cell(flows.tube, flows.mold) / capacity
    half = ca.sum1(heat.resistances(tube, v, g))
    now = _loaded(half, lumped, duty, g)[1]
    terminal = heat.source_voltage(lumped[CHARGE], g) - lumped[SAG] - g["internal"] * now
    measured = ca.vertcat(now, now * heat.tube_share(half, g), terminal, half)
    table = {
        "rates": ([cells, lumped, duty, p, q], [cell_rates, slow]),
        # Joule heat enters the tube, stray heat the first shell; the other rows do not depend on duty.
        "warming": ([cells, lumped, duty, p, q], [cell_rates[:2, :]]),
        "current": ([tube, lumped, p, q], [measured]),
        "linearised": ([cells, p, q], [capacity, *heat.frozen_jacobian(at, cells, v, g)]),
        "stored": ([cells, lumped, p, q], [2 * heat.stored_heat(at, v, g)]),
    }
    warming = ca.Function("warming", *table["warming"])
    ends = [warming(cells, lumped, level, p, q)[0, :].T for level in (0.0, 1.0)]
    table["span"] = [cells, lumped, p, q], [*ends, total]
    return {
        name: ca.Function(name, inputs, [ca.densify(value) for value in outputs], {"cse": True})
        for name, (inputs, outputs) in table.items()
    }


def _loaded(half: ca.SX, lumped: ca.SX, duty: ca.SX, g: heat.Properties) -> tuple[heat.Load, ca.SX]:
    """Electric load at a duty, and the current while the MOSFET conducts, A; `half` of the tube has that many ohm."""
    total = (heat.source_voltage(lumped[CHARGE], g) - lumped[SAG]) / heat.loop_resistance(half, g)
    on = heat.conducting(duty, g)
    # The mean square of a pulsed current is d I^2, not (d I)^2.
    return heat.Load(half, on * total, on * total**2), total


def _slow(clamp: ca.SX, surroundings: ca.SX, load: heat.Load, total: ca.SX, lumped: ca.SX, g: heat.Properties) -> ca.SX:
    """Rates of the lumped state, with the heat flows into a clamp, and from half the rig to its surroundings, W."""
    discharge, sagging = heat.battery_rates(load, lumped[SAG], g)
    # The contacts' heat goes into tube and clamps, not into cables.
    outside_tube = g["internal"] + g["series"] - g["contact"]
    return ca.vertcat(
        clamp / g["clamp_heat"],
        discharge,
        sagging,
        load.mean * heat.source_voltage(lumped[CHARGE], g),
        # d I (V_sag + I R): what the voltage at rest loses before it reaches the tube.
        load.mean * (lumped[SAG] + total * outside_tube),
        # The flows are those of half the rig.
        2 * surroundings,
    )


@lru_cache(maxsize=1)
def cell_functions() -> tuple[ca.Function, ...]:
    """Functions of one cell, from which the compiled kernel makes the step of `step_function` on grids of any size.

    ohm: resistance of a cell. load: electric load of a duty, with the current while the MOSFET conducts. cell: net heat
    flow of a cell, Joule heat in its part of the mold, heat flows to clamp and air, heat capacity, and derivative of
    the losses by its temperature. link: heat flow from the next cell, and its slopes in both temperatures. lumps: rates
    of the lumped state.
    """
    scalars = ("tube", "other", "clamp", "into_clamp", "off", "half", "duty", "coefficient")
    tube, other, clamp, into_clamp, off, half, duty, coefficient = (ca.SX.sym(name) for name in scalars)
    lumped, seen, p = ca.SX.sym("lumped", LUMPED), ca.SX.sym("load", 4), ca.SX.sym("p", len(PROPERTIES))
    g, load = named(p), heat.Load(seen[0], seen[1], seen[2])
    own = {name: ca.SX.sym(name) for name in OF_A_CELL}
    # A law of one cell that took another coefficient would fail at once on None.
    v = heat.Volumes(**{item.name: own.get(item.name) for item in fields(heat.Volumes)})
    gain, given, air = heat.cell_flows(tube, clamp, load, v, g)
    stray = heat.stray_heat(load, coefficient, g)
    begun, total = _loaded(half, lumped, duty, g)
    link = heat.heat_along(tube, other, coefficient, g)
    gains = heat.lump_flows(clamp, into_clamp, off, load, g)
    laws = {
        "ohm": ([tube, own["resistance"], p], [heat.resistances(tube, v, g)]),
        "load": ([half, lumped, duty, p], [ca.vertcat(begun.half, begun.mean, begun.drive, total)]),
        "cell": (
            [tube, clamp, seen, *own.values(), coefficient, p],
            [gain, stray, given, air, heat.tube_capacity(tube, v, g), ca.jacobian(given + air, tube)],
        ),
        "link": ([tube, other, coefficient, p], [link, ca.jacobian(link, tube), ca.jacobian(link, other)]),
        "lumps": ([clamp, into_clamp, off, seen, lumped, p], [_slow(*gains, load, seen[3], lumped, g)]),
    }
    return tuple(
        ca.Function(f"law_{name}", inputs, [ca.densify(value) for value in outputs], {"cse": True})
        for name, (inputs, outputs) in laws.items()
    )


@lru_cache(maxsize=16)
def step_function(resolution: Resolution) -> ca.Function:
    """(cells, lumped, duty, span, properties, volumes) -> (cells, lumped) after a span, s, at constant duty: ROS2.

    The matrix of a stage is that of the shells times that of the tube's direction (approximate factorisation), each
    of which is many small tridiagonal ones. The lumped states are slow: their Jacobian is left out, and they follow the
    cells by the trapezoidal rule.
    """
    functions = instant_functions(resolution)
    rates, inputs = functions["rates"], functions["rates"].sx_in()
    cells, lumped, duty, p, q = inputs
    h = ca.SX.sym("span")
    capacity, own, inward, along = functions["linearised"](cells, p, q)
    # What leaves to clamp and air stands in the second, which is exact where a cell has no shells.
    across = -inward - ca.vertcat(ca.DM(1, cells.size2()), inward[:-1, :])
    # C - gamma h (A + B) = (C - gamma h A) C^-1 (C - gamma h B) but for gamma^2 h^2 A C^-1 B.
    outward = _tridiagonal(capacity - GAMMA * h * across, -GAMMA * h * inward[:-1, :])
    sideways = _tridiagonal((capacity - GAMMA * h * (own - across)).T, -GAMMA * h * along.T)

    def stage(rate: Any) -> Any:
        return sideways((capacity * outward(capacity * rate)).T).T

    rate, slow = rates(cells, lumped, duty, p, q)
    first = stage(rate)
    later = lumped + h * slow
    # ROS2: (1 - gamma h J) k_2 = F(u + h k_1) - 2 k_1, and u + h (3 k_1 + k_2) / 2 is the end.
    second = stage(rates(cells + h * first, later, duty, p, q)[0] - 2 * first)
    after = cells + h * (1.5 * first + 0.5 * second)
    # The stage in between overshoots what is stiff: the clamps would feel it.
    lumped_after = lumped + 0.5 * h * (slow + rates(after, later, duty, p, q)[1])
    return ca.Function("step", [cells, lumped, duty, h, p, q], [after, lumped_after], {"cse": True})


def _tridiagonal(diagonal: ca.SX, beside: ca.SX) -> Callable[[Any], Any]:
    """Solver of many symmetric tridiagonal systems, of which every column (N) of `diagonal` and (N-1) of `beside` is
    one, for right-hand sides in columns."""
    count = diagonal.size1()
    # No pivots: C - gamma h J is diagonally dominant, as heat flows from hot to cold.
    inverse, ratio = [1 / diagonal[0, :]], []
    for k in range(1, count):
        ratio.append(beside[k - 1, :] * inverse[-1])
        inverse.append(1 / (diagonal[k, :] - ratio[-1] * beside[k - 1, :]))

    def solve(load: Any) -> Any:
        rows = [load[0, :]]
        for k in range(1, count):
            rows.append(load[k, :] - ratio[k - 1] * rows[-1])
        rows[-1] = rows[-1] * inverse[-1]
        for k in range(count - 2, -1, -1):
            rows[k] = rows[k] * inverse[k] - ratio[k] * rows[k + 1]
        return ca.vertcat(*rows)

    return solve
