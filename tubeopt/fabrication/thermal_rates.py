"""The thermal model at one instant for many members: `mechanics.heat` on arrays, and where the energy goes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from ..mechanics.heat import (
    PROPERTIES,
    Load,
    Resolution,
    Temperatures,
    Volumes,
    battery_rates,
    by_cell,
    frozen_jacobian,
    heat_flows,
    loop_resistance,
    resistances,
    source_voltage,
    stored_heat,
    tube_capacity,
    tube_share,
    volume_shapes,
)
from ..robots.assembly import Array
from ..transcription.buffered import mapped
from .thermal import ThermalModel, named

CLAMP, CHARGE, SAG, DRAWN, CIRCUIT, LOST = range(6)
"""Entries of the lumped state: clamp temperature (K), charge used (fraction), sag (V), and energies of the rig
(J): drawn from the battery's chemistry, turned to heat in battery, cables and MOSFET, given off to the surroundings."""

LUMPED = 6


@dataclass(frozen=True, eq=False)
class State:
    """cells: (B, n, 1+M) temperatures of the tube (first) and of the shells around it, K; lumped: (B, 6)."""

    cells: Array
    lumped: Array


def at_rest(model: ThermalModel) -> State:
    """Everything at ambient temperature, the battery rested."""
    lumped = np.zeros((model.members, LUMPED))
    lumped[:, CLAMP] = model.ambient
    shape = model.members, model.resolution.cells, 1 + model.resolution.shells
    return State(np.full(shape, model.ambient), lumped)


@dataclass(frozen=True, eq=False)
class Current:
    """(B,) current while the MOSFET conducts, its part through the tube, the terminal voltage then, and half
    the tube's resistance, ohm."""

    total: Array
    tube: Array
    terminal_voltage: Array
    resistance: Array


@lru_cache(maxsize=16)
def _functions(resolution: Resolution) -> dict[str, ca.Function]:
    """What the simulation asks, as functions of one member: its state, the duty, its properties and volumes."""
    rows, n = 1 + resolution.shells, resolution.cells
    cells, tube = ca.SX.sym("cells", rows, n), ca.SX.sym("tube", n)
    lumped, duty = ca.SX.sym("lumped", LUMPED), ca.SX.sym("duty")
    p = ca.SX.sym("p", len(PROPERTIES))
    q = ca.SX.sym("q", sum(rows * columns for rows, columns in volume_shapes(resolution).values()))
    g, v = named(p), Volumes.of(q, resolution)
    at = Temperatures(cells[0, :].T, cells[1:, n - resolution.covered :].T, lumped[CLAMP])

    def circuit(tube: ca.SX) -> tuple[ca.SX, ca.SX]:
        half = ca.sum1(resistances(tube, v, g))
        return half, (source_voltage(lumped[CHARGE], g) - lumped[SAG]) / loop_resistance(half, g)

    half, total = circuit(at.tube)
    load = Load(half, duty * total, duty * total**2)
    flows = heat_flows(at, load, v, g)
    discharge, sagging = battery_rates(load, lumped[SAG], g)
    heat = by_cell(tube_capacity(at.tube, v, g), v.shell_heat, bare=1.0)
    outside_tube = g["internal"] + g["series"] - g["contact"]
    slow = ca.vertcat(
        flows.clamp / g["clamp_heat"],
        discharge,
        sagging,
        load.mean * source_voltage(lumped[CHARGE], g),
        load.mean * (lumped[SAG] + total * outside_tube),
        2 * flows.surroundings,
    )
    half, total = circuit(tube)
    terminal = source_voltage(lumped[CHARGE], g) - lumped[SAG] - g["internal"] * total
    seen = ca.vertcat(total, total * tube_share(half, g), terminal, half)
    found = {
        "rates": ([cells, lumped, duty, p, q], [by_cell(flows.tube, flows.mold) / heat, slow]),
        "current": ([tube, lumped, p, q], [seen]),
        "linearised": ([cells, p, q], [heat, *frozen_jacobian(at, cells, v, g)]),
        "stored": ([cells, lumped, p, q], [2 * stored_heat(at, v, g)]),
    }
    return {
        name: ca.Function(name, inputs, [ca.densify(value) for value in outputs], {"cse": True})
        for name, (inputs, outputs) in found.items()
    }


def _evaluated(name: str, model: ThermalModel, cells: Array, *others: Array) -> list[Array]:
    """Outputs of a function, members first, at temperatures (B, ...) and others (B, ...); copies.

    One member may be asked in B states.
    """
    b = len(cells)
    function = mapped(_functions(model.resolution)[name], b)
    flat = cells.reshape(function.inputs[0].shape)
    return [value.reshape(b, -1).copy() for value in function(flat, *others, model.properties, model.volumes)]


def current(model: ThermalModel, tube: Array, lumped: Array) -> Current:
    """The circuit at tube temperatures (B, n) and lumped states (B, 6)."""
    (seen,) = _evaluated("current", model, tube, lumped)
    return Current(*seen.T)


def rates(model: ThermalModel, cells: Array, lumped: Array, duty: Array | float) -> tuple[Array, Array]:
    """Rates of (cells, lumped) in K/s and per s, at a duty in [0, 1], one number or (B,)."""
    rate, slow = _evaluated("rates", model, cells, lumped, np.reshape(duty, (-1, 1)))
    return rate.reshape(cells.shape), slow


def linearised(model: ThermalModel, cells: Array) -> tuple[Array, Array, Array, Array]:
    """Heat capacities (B, n, 1+M), J/K, and the `frozen_jacobian` of the flows: own and inward (B, n, 1+M), along
    (B, n-1, 1+M), W/K."""
    heat, own, inward, along = _evaluated("linearised", model, cells)
    b, n, m = cells.shape
    return heat.reshape(b, n, m), own.reshape(b, n, m), inward.reshape(b, n, m), along.reshape(b, n - 1, m)


def stored(model: ThermalModel, state: State) -> Array:
    """(B,) heat in the whole tube, mold and both clamps above ambient, J."""
    (heat,) = _evaluated("stored", model, state.cells, state.lumped)
    return heat[:, 0]


def imbalance(model: ThermalModel, state: State) -> Array:
    """(B,) energy that is not accounted for, as a fraction of what was drawn from the battery."""
    lumped = state.lumped
    missing = lumped[:, DRAWN] - lumped[:, CIRCUIT] - lumped[:, LOST] - stored(model, state)
    return np.asarray(np.abs(missing) / np.maximum(lumped[:, DRAWN], 1e-12))
