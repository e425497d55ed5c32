"""The thermal model at one instant for many members: `physics.heat` on arrays, and where the energy goes."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from ...block.transcription.buffered import mapped
from ...physics.heat_functions import CIRCUIT, CLAMP, DRAWN, LOST, LUMPED, instant_functions, step_function
from ...solvers.compiled.heating import Marcher, Windows, heating_kernel
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
    marcher = marcher_of(model) if len(cells) == model.members == 1 else None
    if marcher is not None:
        n = model.resolution.cells
        found = marcher.spread(cells, lumped)
        return found[None, :n], found[None, n:-1], found[-1:]
    idle, full, ampere = _evaluated("span", model, cells, lumped)
    return idle, full, ampere[:, 0]


_bound = threading.local()
"""`marchers`: models bound to the compiled kernel, of every thread."""


def marcher_of(model: ThermalModel) -> Marcher | None:
    """A model bound to the compiled kernel, of this thread; None where there is no kernel."""
    kernel = heating_kernel()
    if kernel is None:
        return None
    known: WeakKeyDictionary[ThermalModel, Marcher] = _bound.__dict__.setdefault("marchers", WeakKeyDictionary())
    if (found := known.get(model)) is None:
        found = known[model] = Marcher(kernel, model.resolution, model.properties, model.volumes)
    return found


def march(model: ThermalModel, course: State, windows: Windows) -> None:
    """Write the states after windows of time at constant duties into a course (T, B, ...) whose first one in place is
    given: in the compiled kernel, or where there is none by steps one by one, to the same states."""
    marcher = marcher_of(model)
    if marcher is None:
        step_by_step(model, course, windows)
    else:
        marcher.march(windows, course.cells, course.lumped)


def step_by_step(model: ThermalModel, course: State, windows: Windows) -> None:
    """`march` without a compiler."""
    function = mapped(step_function(model.resolution), course.cells.shape[1])
    shape, spans = function.inputs[0].shape, windows.span / windows.steps
    cells, lumped = (row[windows.place[0]] for row in (course.cells, course.lumped))
    for place, span, count, duty in zip(windows.place[1:], spans, windows.steps, windows.duty, strict=True):
        for _ in range(count):
            numbers = model.properties, model.volumes
            cells, lumped = function(cells.reshape(shape), lumped, duty[:, None], span, *numbers)
        course.cells[place], course.lumped[place] = cells.reshape(course.cells.shape[1:]), lumped


def stored(model: ThermalModel, state: State) -> Array:
    """(B,) heat in the whole tube, mold and both clamps above ambient, J."""
    (heat,) = _evaluated("stored", model, state.cells, state.lumped)
    return heat[:, 0]


def imbalance(model: ThermalModel, state: State) -> Array:
    """(B,) energy that is not accounted for, as a fraction of what was drawn from the battery."""
    lumped = state.lumped
    missing = lumped[:, DRAWN] - lumped[:, CIRCUIT] - lumped[:, LOST] - stored(model, state)
    return np.asarray(np.abs(missing) / np.maximum(lumped[:, DRAWN], 1e-12))
