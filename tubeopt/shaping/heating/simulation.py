"""The thermal model for many members at once: at one instant, `physics.heat` on arrays, and in time by a Rosenbrock
method; and where the energy goes."""

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
from ...physics.heat_functions import CIRCUIT, CLAMP, DRAWN, LOST, LUMPED, instant_functions, step_function
from ...solvers.compiled.heating import Marcher, Windows, heating_kernel
from ...solvers.time_limit import check_time
from ...typing import Array
from .thermal import ThermalModel

STEP, LOOK = 0.25, 0.1
"""Greatest step, s, of a simulation, and of one that looks for extremes."""

BATCH = 60
"""States of one member that are looked at together; each holds the model's numbers once."""


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


class WarmingSpan(NamedTuple):
    """Between which rates a duty warms the tube of B members."""

    idle: Array
    """(B, n) at no duty, K/s."""
    full: Array
    """(B, n) at full duty, K/s."""
    current: Array
    """(B,) while the MOSFET conducts, A."""


def warming_span(model: ThermalModel, cells: Array, lumped: Array) -> WarmingSpan:
    """The rates of the tube at no duty and at full duty, and the current, at cells (B, n, 1+M) and lumped (B, 6)."""
    marcher = marcher_of(model) if len(cells) == model.members == 1 else None
    if marcher is not None:
        n = model.resolution.cells
        found = marcher.spread(cells, lumped)
        return WarmingSpan(found[None, :n], found[None, n:-1], found[-1:])
    idle, full, ampere = _evaluated("span", model, cells, lumped)
    return WarmingSpan(idle, full, ampere[:, 0])


_bound = threading.local()
"""`marchers`: models bound to the compiled kernel, of every thread."""


def marcher_of(model: ThermalModel) -> Marcher | None:
    """A model bound to the compiled kernel, of this thread; None where there is no kernel."""
    kernel = heating_kernel()
    if kernel is None:
        return None
    # By thread, since a marcher writes into buffers of its own; weak, so that it ends with its model.
    known: WeakKeyDictionary[ThermalModel, Marcher] = _bound.__dict__.setdefault("marchers", WeakKeyDictionary())
    if (found := known.get(model)) is None:
        found = known[model] = Marcher(kernel, model.resolution, model.properties, model.volumes)
    return found


def march(model: ThermalModel, course: State, windows: Windows) -> None:
    """Write the states after windows of time at constant duties into a course (T, B, ...) whose first one in place is
    given: in the compiled kernel, or where there is none by steps one by one, to the same states."""
    check_time()
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
    # Energy from the battery is in the circuit, given off, or stored; what is left is error of the steps.
    missing = lumped[:, DRAWN] - lumped[:, CIRCUIT] - lumped[:, LOST] - stored(model, state)
    return np.asarray(np.abs(missing) / np.maximum(lumped[:, DRAWN], 1e-12))


@dataclass(frozen=True, eq=False)
class Extremes:
    """The extremes of one member, looked for every `LOOK` seconds at least and at the slots' ends."""

    coldest: Array
    """(T-1, n) of the tube's cells within every slot, K."""
    hottest: Array
    """(T-1, n) of the tube's cells within every slot, K."""
    rate: float
    """Fastest warming of any cell outside of the clamps, K/s, the duty taken for a mean power."""
    current: float
    """Greatest current while the MOSFET conducts, A."""
    mean_current: float
    """Greatest current times duty, A."""


@dataclass(frozen=True, eq=False)
class History:
    """A simulation of B members."""

    time: Array
    """(T,) s."""
    tube: Array
    """(T, B, n) temperatures of the tube's cells, K."""
    walls: Array
    """(T, B, n, M) temperatures of the mold's shells, K."""
    lumped: Array
    """(T, B, 6) by the places in `physics.heat_functions`."""
    voltage: Array
    """(T, B) at the battery's terminals while the MOSFET conducts, V."""
    current: Array
    """(T, B) through them then, A."""
    resistance: Array
    """(T, B) of the tube between the clamps, ohm."""
    imbalance: Array
    """(B,) energy unaccounted for, as a fraction of what the battery gave."""
    within: Extremes | None = None
    """Within the slots, where `resimulate` made the history."""

    def state(self, k: int) -> State:
        """Temperatures and lumped states at time k."""
        return State(np.concatenate([self.tube[k][..., None], self.walls[k]], axis=-1), self.lumped[k])


def history_of(model: ThermalModel, slot: float, course: State) -> History:
    """What a simulation tells of its states (T, B, ...) at the slots' ends."""
    cells, lumped = course.cells, course.lumped
    tube = np.ascontiguousarray(cells[..., 0])
    # One member is asked in many states at once.
    together = BATCH if model.members == 1 else 1
    batches = [slice(first, first + together) for first in range(0, len(tube), together)]
    now = [current(model, np.concatenate(tube[some]), np.concatenate(lumped[some])) for some in batches]

    def seen(name: str) -> Array:
        return np.concatenate([getattr(one, name) for one in now]).reshape(tube.shape[:2])

    return History(
        time=np.asarray(slot * np.arange(len(tube)), dtype=float),
        tube=tube,
        walls=cells[..., 1:],
        lumped=lumped,
        voltage=seen("terminal_voltage"),
        current=seen("total"),
        resistance=2 * seen("resistance"),
        imbalance=imbalance(model, State(cells[-1], lumped[-1])),
    )


# --- many members at once ---------------------------------------------------------------------------------------------


def advance(model: ThermalModel, state: State, duty: Array | float, span: float, steps: int | None = None) -> State:
    """The state after `span` seconds at constant duty, one number or (B,): equal steps of ROS2, as many as `STEP` asks
    for unless told."""
    count, marcher = steps_of(span) if steps is None else steps, marcher_of(model)
    if marcher is not None:
        return State(*marcher.advance(state.cells, state.lumped, duty, span, count))
    course, level = _begun(state, 2), np.empty((1, len(state.cells)))
    level[0] = duty
    step_by_step(model, course, Windows(np.array([span]), np.array([count]), level, np.arange(2)))
    return State(course.cells[1], course.lumped[1])


def _begun(start: State, rows: int) -> State:
    """A course (rows, B, ...) that begins with a state."""
    course = State(*(np.empty((rows, *row.shape)) for row in (start.cells, start.lumped)))
    course.cells[0], course.lumped[0] = start.cells, start.lumped
    return course


def steps_of(span: float) -> int:
    """Steps that a span, s, takes."""
    return max(math.ceil(span / STEP - 1e-9), 1)


def simulate(
    model: ThermalModel, slot: float, duty: ArrayLike, *, start: State | None = None, steps: int | None = None
) -> History:
    """The members under a schedule, in which duty[k] (T,) or (T, B) in [0, 1] holds from k slots to k + 1.

    The times of the history are the slots' ends, with the start.

    Args:
        steps: in every slot; by default as many as `STEP` asks for.
    """
    return history_of(model, slot, _trace(model, slot, np.asarray(duty, dtype=float), start or at_rest(model), steps))


def _trace(model: ThermalModel, slot: float, levels: Array, start: State, steps: int | None = None) -> State:
    """The states (T + 1, B, ...) at the slots' ends, with the start."""
    course, slots = _begun(start, len(levels) + 1), len(levels)
    duties = np.broadcast_to(levels.reshape(slots, -1), (slots, len(start.cells)))
    each = np.full(slots, steps_of(slot) if steps is None else steps)
    march(model, course, Windows(np.full(slots, slot), each, duties, np.arange(slots + 1)))
    return course


def resimulate(model: ThermalModel, slot: float, duty: ArrayLike) -> History:
    """One member under a schedule, in steps of at most `LOOK`; the history knows the extremes within the slots."""
    levels = np.asarray(duty, dtype=float)
    # 1e-9 is round-off: a slot of exactly one look stays one.
    looks = math.ceil(slot / LOOK - 1e-9)
    course = _trace(model, slot / looks, np.repeat(levels, looks), at_rest(model))
    whole = history_of(model, slot / looks, course)
    seen = ("time", "tube", "walls", "lumped", "voltage", "current", "resistance")
    ends = {name: getattr(whole, name)[::looks] for name in seen}
    return replace(whole, **ends, within=_extremes(model, course, whole.current[:, 0], levels, looks))


def _extremes(model: ThermalModel, course: State, ampere: Array, duty: Array, looks: int) -> Extremes:
    """Of slots (T-1,) at these duties, from states, and currents while the MOSFET conducts, at `looks` times in every
    slot and at the start."""
    # Where one duty ends and another begins, the greater one warms faster.
    either = np.repeat(duty, looks)
    level = np.maximum(np.append(either, 0.0), np.append(0.0, either))
    rate, free = 0.0, model.zone > GRIP
    for first in range(0, len(level), BATCH):
        some = slice(first, first + BATCH)
        found = warming(model, course.cells[some, 0], course.lumped[some, 0], level[some])
        rate = max(rate, float(found[:, free, 0].max()))
    tube, slots = course.cells[:, 0, :, 0], (len(duty), looks, -1)
    starts, ends = (part.reshape(slots) for part in (tube[:-1], tube[1:]))
    # Within a look temperatures are nearly monotonic, so that its ends are its extremes.
    coldest, hottest = np.minimum(starts, ends).min(1), np.maximum(starts, ends).max(1)
    return Extremes(coldest, hottest, rate, float(ampere.max()), float((level * ampere).max()))


def simulate_feedback(
    model: ThermalModel, slot: float, count: int, controller: Callable[[float, State], float]
) -> tuple[History, Array]:
    """One member under a duty that `controller` chooses at every slot from time and state; also the duties (count,)."""
    states, duties = [at_rest(model)], []
    for k in range(count):
        check_time()
        duties.append(controller(k * slot, states[-1]))
        states.append(advance(model, states[-1], duties[-1], slot))
    course = State(*(np.array([getattr(state, name) for state in states]) for name in ("cells", "lumped")))
    return history_of(model, slot, course), np.array(duties)
