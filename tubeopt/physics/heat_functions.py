"""The balance of heat at one instant as compiled functions, for a simulation that eliminates the current."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca

from . import heat
from .heat import PROPERTIES, Resolution, named

CLAMP, CHARGE, SAG, DRAWN, CIRCUIT, LOST = range(6)
"""Entries of the lumped state: clamp temperature (K), charge used (fraction), sag (V), and energies of the rig
(J): drawn from the battery's chemistry, turned to heat in battery, cables and MOSFET, given off to the surroundings."""

LUMPED = 6


@lru_cache(maxsize=16)
def volumes_function(resolution: Resolution) -> ca.Function:
    """(properties, widths, vents, rings, log ratios) -> the column of all coefficients."""
    m = resolution.shells
    sizes = (len(PROPERTIES), resolution.cells, resolution.covered, m, m - 1)
    symbols = [ca.SX.sym(name, size) for name, size in zip("pwvrl", sizes, strict=True)]
    p, width, vent, *shells = symbols
    found = heat.volumes(named(p), width, vent, (shells[0], shells[1]), resolution)
    return ca.Function("volumes", symbols, [found.column])


@lru_cache(maxsize=16)
def instant_functions(resolution: Resolution) -> dict[str, ca.Function]:
    """What a simulation asks of one rig, as functions of temperatures, lumped state and duty (those that matter),
    properties and the column of volumes; cells are (1 + M, n), of which the shells without a mold do not count.

    rates: of cells and lumped state. current, at temperatures of the tube (n,): while the MOSFET conducts, its part
    through the tube, the terminal voltage, and the resistance of half the tube. linearised: heat capacities, 1 where
    there is no mold, and the `frozen_jacobian`. stored: heat above ambient in the whole rig.
    """
    rows, n = 1 + resolution.shells, resolution.cells
    cells, tube = ca.SX.sym("cells", rows, n), ca.SX.sym("tube", n)
    lumped, duty = ca.SX.sym("lumped", LUMPED), ca.SX.sym("duty")
    p = ca.SX.sym("p", len(PROPERTIES))
    q = ca.SX.sym("q", sum(rows * columns for rows, columns in heat.volume_shapes(resolution).values()))
    g, v = named(p), heat.Volumes.of(q, resolution)
    at = heat.Temperatures(cells[0, :].T, cells[1:, n - resolution.covered :].T, lumped[CLAMP])

    def circuit(tube: ca.SX) -> tuple[ca.SX, ca.SX]:
        half = ca.sum1(heat.resistances(tube, v, g))
        return half, (heat.source_voltage(lumped[CHARGE], g) - lumped[SAG]) / heat.loop_resistance(half, g)

    half, total = circuit(at.tube)
    on = heat.conducting(duty, g)
    load = heat.Load(half, on * total, on * total**2)
    flows = heat.heat_flows(at, load, v, g)
    discharge, sagging = heat.battery_rates(load, lumped[SAG], g)
    capacity = heat.by_cell(heat.tube_capacity(at.tube, v, g), v.shell_heat, bare=1.0)
    outside_tube = g["internal"] + g["series"] - g["contact"]
    slow = ca.vertcat(
        flows.clamp / g["clamp_heat"],
        discharge,
        sagging,
        load.mean * heat.source_voltage(lumped[CHARGE], g),
        load.mean * (lumped[SAG] + total * outside_tube),
        2 * flows.surroundings,
    )
    half, total = circuit(tube)
    terminal = heat.source_voltage(lumped[CHARGE], g) - lumped[SAG] - g["internal"] * total
    seen = ca.vertcat(total, total * heat.tube_share(half, g), terminal, half)
    found = {
        "rates": ([cells, lumped, duty, p, q], [heat.by_cell(flows.tube, flows.mold) / capacity, slow]),
        "current": ([tube, lumped, p, q], [seen]),
        "linearised": ([cells, p, q], [capacity, *heat.frozen_jacobian(at, cells, v, g)]),
        "stored": ([cells, lumped, p, q], [2 * heat.stored_heat(at, v, g)]),
    }
    return {
        name: ca.Function(name, inputs, [ca.densify(value) for value in outputs], {"cse": True})
        for name, (inputs, outputs) in found.items()
    }
