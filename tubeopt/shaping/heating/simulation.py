"""Simulation of the thermal model for many members at once: rates at one instant, Rosenbrock steps, energy balance."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

from ...block.transcription.buffered import mapped
from ...physics.heat import GRIP
from ...physics.heat_functions import CIRCUIT, CLAMP, DRAWN, LOST, LUMPED, instant_function, step_function
from ...solvers.compiled.heating import Marcher, Windows, heating_kernel
from ...solvers.time_limit import check_time
from ...typing import Array
from .thermal import ThermalModel

STEP, FINE_STEP = 0.25, 0.1
"""Largest step of a simulation, and of one that records extremes within slots, s."""

BATCH = 60
"""Number of states of one member that are evaluated together; each has a copy of the model's numbers."""


@dataclass(frozen=True, eq=False)
class State:
    """Temperatures and battery state of B rigs."""

    cells: Array
    """(B, n, 1+M) temperatures of the tube (first) and of the shells around it, K."""
    lumped: Array
    """(B, 6) clamp, battery and energies, by the indices of `physics.heat_functions`."""


def at_rest(model: ThermalModel) -> State:
    """State with everything at the ambient temperature of its member, and the battery rested."""
    T_amb = model.parameter("T_amb")
    lumped = np.zeros((model.members, LUMPED))
    lumped[:, CLAMP] = T_amb
    shape = model.members, model.resolution.cells, 1 + model.resolution.shells
    return State(np.broadcast_to(T_amb[:, None, None], shape).copy(), lumped)


class CircuitState(NamedTuple):
    """Electrical quantities of B members while the MOSFET conducts."""

    I_on: Array
    """(B,) current of the battery, A."""
    I_tube: Array
    """(B,) part of it through the tube, A."""
    V_terminal: Array
    """(B,) voltage at the battery's terminals, V."""
    R_half: Array
    """(B,) resistance of half the tube, ohm."""


def _evaluate(name: str, model: ThermalModel, cells: Array, *inputs: Array) -> list[Array]:
    """Outputs of a function, members first, at temperatures (B, ...) and other inputs (B, ...); copies.

    A model of one member may be evaluated in B states.
    """
    b = len(cells)
    function = mapped(instant_function(model.resolution, name), b)
    flat = cells.reshape(function.inputs[0].shape)
    return [value.reshape(b, -1).copy() for value in function(flat, *inputs, model.properties, model.volumes)]


def circuit_state(model: ThermalModel, tube: Array, lumped: Array) -> CircuitState:
    """Circuit at tube temperatures (B, n) and lumped states (B, 6)."""
    (columns,) = _evaluate("current", model, tube, lumped)
    return CircuitState(*columns.T)


def rates(model: ThermalModel, cells: Array, lumped: Array, duty: Array | float) -> tuple[Array, Array]:
    """Rates of (cells, lumped) in K/s and per s, at a duty in [0, 1], one number or (B,)."""
    cell_rates, lumped_rates = _evaluate("rates", model, cells, lumped, np.reshape(duty, (-1, 1)))
    return cell_rates.reshape(cells.shape), lumped_rates


def warming(model: ThermalModel, cells: Array, lumped: Array, duty: Array | float) -> Array:
    """(B, n, 2) heating rates by a current, K/s: of the tube, and of the shell next to it of a conductive mold."""
    (rate,) = _evaluate("warming", model, cells, lumped, np.reshape(duty, (-1, 1)))
    return rate.reshape(*cells.shape[:2], 2)


class WarmingSpan(NamedTuple):
    """Range of heating rates of the tube of B members."""

    idle: Array
    """(B, n) rates without current, K/s."""
    full: Array
    """(B, n) rates at full duty, K/s."""
    I_on: Array
    """(B,) current while the MOSFET conducts, A."""


def warming_span(model: ThermalModel, cells: Array, lumped: Array) -> WarmingSpan:
    """Heating rates at no duty and at full duty, at cells (B, n, 1+M) and lumped states (B, 6)."""
    marcher = marcher_of(model) if len(cells) == model.members == 1 else None
    if marcher is not None:
        n = model.resolution.cells
        values = marcher.spread(cells, lumped)
        return WarmingSpan(values[None, :n], values[None, n:-1], values[-1:])
    idle, full, I_on = _evaluate("span", model, cells, lumped)
    return WarmingSpan(idle, full, I_on[:, 0])


_bound = threading.local()
"""`marchers`: models bound to the compiled kernel, of every thread."""


def marcher_of(model: ThermalModel) -> Marcher | None:
    """Model bound to the compiled kernel in this thread; None without a kernel."""
    kernel = heating_kernel()
    if kernel is None:
        return None
    # By thread, since a marcher writes into buffers of its own; weak, so that it ends with its model.
    marchers: WeakKeyDictionary[ThermalModel, Marcher] = _bound.__dict__.setdefault("marchers", WeakKeyDictionary())
    if model not in marchers:
        marchers[model] = Marcher(kernel, model.resolution, model.properties, model.volumes)
    return marchers[model]


def march(model: ThermalModel, course: State, windows: Windows) -> None:
    """Write the states after windows of time at constant duties into a course (T, B, ...) that has the first one.

    The compiled kernel and, without it, `step_by_step` give the same states.
    """
    check_time()
    marcher = marcher_of(model)
    if marcher is None:
        step_by_step(model, course, windows)
    else:
        marcher.march(windows, course.cells, course.lumped)


def step_by_step(model: ThermalModel, course: State, windows: Windows) -> None:
    """March as `march` does, without the compiled kernel."""
    function = mapped(step_function(model.resolution), course.cells.shape[1])
    shape, spans = function.inputs[0].shape, windows.span / windows.steps
    cells, lumped = (row[windows.place[0]] for row in (course.cells, course.lumped))
    for row, span, count, duty in zip(windows.place[1:], spans, windows.steps, windows.duty, strict=True):
        for _ in range(count):
            numbers = model.properties, model.volumes
            cells, lumped = function(cells.reshape(shape), lumped, duty[:, None], span, *numbers)
        course.cells[row], course.lumped[row] = cells.reshape(course.cells.shape[1:]), lumped


def stored(model: ThermalModel, state: State) -> Array:
    """(B,) heat in the whole tube, mold and both clamps above ambient, J."""
    (heat,) = _evaluate("stored", model, state.cells, state.lumped)
    return heat[:, 0]


def imbalance(model: ThermalModel, state: State) -> Array:
    """(B,) error of the energy balance as a fraction of the energy from the battery."""
    lumped = state.lumped
    # Energy from the battery is in the circuit, lost to the air, or stored; the rest is the error of the steps.
    error = lumped[:, DRAWN] - lumped[:, CIRCUIT] - lumped[:, LOST] - stored(model, state)
    return np.asarray(np.abs(error) / np.maximum(lumped[:, DRAWN], 1e-12))


@dataclass(frozen=True, eq=False)
class SlotExtremes:
    """Extremes of one member within its slots, from steps of at most `FINE_STEP`."""

    coldest: Array
    """(T-1, n) lowest temperature of each cell of the tube in each slot, K."""
    hottest: Array
    """(T-1, n) highest temperature of each cell of the tube in each slot, K."""
    rate: float
    """Largest heating rate of any cell outside the clamps, K/s, the duty taken as a mean power."""
    current: float
    """Largest current while the MOSFET conducts, A."""
    mean_current: float
    """Largest product of current and duty, A."""


@dataclass(frozen=True, eq=False)
class History:
    """Simulation of B members at T times."""

    time: Array
    """(T,) times of the simulation, s."""
    tube: Array
    """(T, B, n) temperatures of the tube's cells, K."""
    walls: Array
    """(T, B, n, M) temperatures of the mold's shells, K."""
    lumped: Array
    """(T, B, 6) lumped states by the indices of `physics.heat_functions`."""
    voltage: Array
    """(T, B) voltage at the battery's terminals while the MOSFET conducts, V."""
    current: Array
    """(T, B) current of the battery while the MOSFET conducts, A."""
    resistance: Array
    """(T, B) resistance of the tube between the clamps, ohm."""
    imbalance: Array
    """(B,) error of the energy balance as a fraction of the energy from the battery."""
    within: SlotExtremes | None = None
    """Extremes within the slots; only `resimulate` records them."""

    def state(self, k: int) -> State:
        """Temperatures and lumped states at time k."""
        return State(np.concatenate([self.tube[k][..., None], self.walls[k]], axis=-1), self.lumped[k])


def history_of(model: ThermalModel, slot: float, course: State) -> History:
    """History of the states (T, B, ...) at the ends of the slots."""
    cells, lumped = course.cells, course.lumped
    tube = np.ascontiguousarray(cells[..., 0])
    # One member is evaluated in many states at once.
    size = BATCH if model.members == 1 else 1
    batches = [slice(first, first + size) for first in range(0, len(tube), size)]
    circuits = [circuit_state(model, np.concatenate(tube[batch]), np.concatenate(lumped[batch])) for batch in batches]
    circuit = CircuitState(*(np.concatenate(part).reshape(tube.shape[:2]) for part in zip(*circuits, strict=True)))
    return History(
        time=np.asarray(slot * np.arange(len(tube)), dtype=float),
        tube=tube,
        walls=cells[..., 1:],
        lumped=lumped,
        voltage=circuit.V_terminal,
        current=circuit.I_on,
        resistance=2 * circuit.R_half,
        imbalance=imbalance(model, State(cells[-1], lumped[-1])),
    )


# --- many members at once ---------------------------------------------------------------------------------------------


def advance(model: ThermalModel, state: State, duty: Array | float, span: float, steps: int | None = None) -> State:
    """State after `span` seconds at a constant duty, one number or (B,), in equal steps; by default `steps_of` many."""
    count, marcher = steps_of(span) if steps is None else steps, marcher_of(model)
    if marcher is not None:
        return State(*marcher.advance(state.cells, state.lumped, duty, span, count))
    course, level = _course(state, 2), np.empty((1, len(state.cells)))
    level[0] = duty
    step_by_step(model, course, Windows(np.array([span]), np.array([count]), level, np.arange(2)))
    return State(course.cells[1], course.lumped[1])


def _course(start: State, rows: int) -> State:
    """Course (rows, B, ...) with its first state; the others are not yet set."""
    course = State(*(np.empty((rows, *part.shape)) for part in (start.cells, start.lumped)))
    course.cells[0], course.lumped[0] = start.cells, start.lumped
    return course


def steps_of(span: float) -> int:
    """Number of steps of at most `STEP` in a span, s."""
    return max(math.ceil(span / STEP - 1e-9), 1)


def simulate(
    model: ThermalModel, slot: float, duty: ArrayLike, *, start: State | None = None, steps: int | None = None
) -> History:
    """Simulate the members under a schedule, with duty[k] (T,) or (T, B) in [0, 1] from slot k to k + 1.

    The history has the start and the ends of the slots.

    Args:
        steps: in every slot; by default `steps_of` many.
    """
    levels = np.asarray(duty, dtype=float)
    return history_of(model, slot, _trace(model, slot, levels, start or at_rest(model), steps or steps_of(slot)))


def _trace(model: ThermalModel, slot: float, levels: Array, start: State, steps: int) -> State:
    """States (T + 1, B, ...) at the start and at the ends of the slots."""
    course, slots = _course(start, len(levels) + 1), len(levels)
    duties = np.broadcast_to(levels.reshape(slots, -1), (slots, len(start.cells)))
    march(model, course, Windows(np.full(slots, slot), np.full(slots, steps), duties, np.arange(slots + 1)))
    return course


def resimulate(model: ThermalModel, slot: float, duty: ArrayLike) -> History:
    """Simulate one member under a schedule in steps of at most `FINE_STEP`, with the extremes within the slots."""
    levels = np.asarray(duty, dtype=float)
    # 1e-9 is round-off: a slot of exactly one step stays one.
    parts = math.ceil(slot / FINE_STEP - 1e-9)
    span = slot / parts
    course = _trace(model, span, np.repeat(levels, parts), at_rest(model), steps_of(span))
    history = history_of(model, span, course)
    sampled = ("time", "tube", "walls", "lumped", "voltage", "current", "resistance")
    ends = {name: getattr(history, name)[::parts] for name in sampled}
    return replace(history, **ends, within=_slot_extremes(model, course, history.current[:, 0], levels, parts))


def _slot_extremes(model: ThermalModel, course: State, I_on: Array, duty: Array, parts: int) -> SlotExtremes:
    """Extremes within slots at duties (T-1,), from states and currents at the start and `parts` times per slot."""
    # Where one duty ends and another begins, the greater one heats faster.
    level = np.repeat(duty, parts)
    level = np.maximum(np.append(level, 0.0), np.append(0.0, level))
    rate, free = 0.0, model.zone > GRIP
    for first in range(0, len(level), BATCH):
        batch = slice(first, first + BATCH)
        rates_of_batch = warming(model, course.cells[batch, 0], course.lumped[batch, 0], level[batch])
        rate = max(rate, float(rates_of_batch[:, free, 0].max()))
    tube, shape = course.cells[:, 0, :, 0], (len(duty), parts, -1)
    starts, ends = tube[:-1].reshape(shape), tube[1:].reshape(shape)
    # Within a step temperatures are nearly monotonic, so that its ends are its extremes.
    coldest, hottest = np.minimum(starts, ends).min(1), np.maximum(starts, ends).max(1)
    return SlotExtremes(coldest, hottest, rate, float(I_on.max()), float((level * I_on).max()))


def simulate_feedback(
    model: ThermalModel, slot: float, count: int, controller: Callable[[float, State], float]
) -> tuple[History, Array]:
    """Simulate one member with a `controller` (time, state) -> duty; returns history and duties (count,)."""
    states, duties = [at_rest(model)], []
    for k in range(count):
        check_time()
        duties.append(controller(k * slot, states[-1]))
        states.append(advance(model, states[-1], duties[-1], slot))
    course = State(*(np.array([getattr(state, name) for state in states]) for name in ("cells", "lumped")))
    return history_of(model, slot, course), np.array(duties)
