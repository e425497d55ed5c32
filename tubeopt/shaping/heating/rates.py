"""The thermal model at one instant for many members: `physics.heat` on arrays, and where the energy goes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...block.transcription.buffered import mapped
from ...physics.heat_functions import CIRCUIT, CLAMP, DRAWN, LOST, LUMPED, instant_functions, step_function
from ...typing import Array
from .thermal import ThermalModel


@dataclass(frozen=True, eq=False)
class State:
    """cells: (B, n, 1+M) temperatures of the tube (first) and of the shells around it, K; lumped: (B, 6)."""

    cells: Array
    lumped: Array


def at_rest(model: ThermalModel) -> State:
    """Everything at the ambient temperature of its member, the battery rested."""
    lumped = np.zeros((model.members, LUMPED))
    lumped[:, CLAMP] = model.surroundings
    shape = model.members, model.resolution.cells, 1 + model.resolution.shells
    return State(np.broadcast_to(model.surroundings[:, None, None], shape).copy(), lumped)


@dataclass(frozen=True, eq=False)
class Current:
    """(B,) current while the MOSFET conducts, its part through the tube, the terminal voltage then, and half
    the tube's resistance, ohm."""

    total: Array
    tube: Array
    terminal_voltage: Array
    resistance: Array


def _evaluated(name: str, model: ThermalModel, cells: Array, *others: Array) -> list[Array]:
    """Outputs of a function, members first, at temperatures (B, ...) and others (B, ...); copies.

    One member may be asked in B states.
    """
    b = len(cells)
    function = mapped(instant_functions(model.resolution)[name], b)
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


def warming(model: ThermalModel, cells: Array, lumped: Array, duty: Array | float) -> Array:
    """(B, n, 2) of `rates`, K/s, those of what a current heats: the tube, and the shell next to it of a mold that
    conducts."""
    (rate,) = _evaluated("warming", model, cells, lumped, np.reshape(duty, (-1, 1)))
    return rate.reshape(*cells.shape[:2], 2)


def warming_span(model: ThermalModel, cells: Array, lumped: Array) -> tuple[Array, Array, Array]:
    """(B, n) rates of the tube at no duty and at full duty, K/s, and (B,) the current while the MOSFET conducts, A."""
    idle, full, ampere = _evaluated("span", model, cells, lumped)
    return idle, full, ampere[:, 0]


def stepped(model: ThermalModel, cells: Array, lumped: Array, duty: Array, span: float) -> tuple[Array, Array]:
    """(cells, lumped) after one step of the integrator over `span`, s, at a duty (1, 1) or (B, 1)."""
    function = mapped(step_function(model.resolution), len(cells))
    after, slow = function(cells.reshape(function.inputs[0].shape), lumped, duty, span, model.properties, model.volumes)
    return after.reshape(cells.shape).copy(), slow.copy()


def stored(model: ThermalModel, state: State) -> Array:
    """(B,) heat in the whole tube, mold and both clamps above ambient, J."""
    (heat,) = _evaluated("stored", model, state.cells, state.lumped)
    return heat[:, 0]


def imbalance(model: ThermalModel, state: State) -> Array:
    """(B,) energy that is not accounted for, as a fraction of what was drawn from the battery."""
    lumped = state.lumped
    missing = lumped[:, DRAWN] - lumped[:, CIRCUIT] - lumped[:, LOST] - stored(model, state)
    return np.asarray(np.abs(missing) / np.maximum(lumped[:, DRAWN], 1e-12))
