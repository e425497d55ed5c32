"""The thermal model in time: many members at once by a Rosenbrock method."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...physics.heat import GRIP
from ...physics.heat_functions import CLAMP
from ...typing import Array
from .rates import State, at_rest, current, imbalance, stepped, warming
from .thermal import ThermalModel

STEP, TOGETHER, LOOK = 0.25, 0.2, 0.1
"""Greatest step, s, of a simulation, of one in which slots are stepped over together, and of one that looks for
extremes."""

FORGOTTEN = 0.03 / 255
"""Duty times s by which the duties of slots that are stepped over together may run away from their mean: what half a
count does in the shortest of slots."""

BATCH = 60
"""States of one member that are looked at together; each holds the model's numbers once."""


@dataclass(frozen=True, eq=False)
class Extremes:
    """The extremes of one member, looked for every `LOOK` seconds at least and at the slots' ends.

    Attributes:
        coldest, hottest: (T-1, n) of the tube's cells within every slot, K.
        rate: fastest warming of any cell outside of the clamps, K/s, the duty taken for a mean power.
        current: greatest current while the MOSFET conducts, A; mean_current: the same times the duty.
    """

    coldest: Array
    hottest: Array
    rate: float
    current: float
    mean_current: float


@dataclass(frozen=True, eq=False)
class History:
    """A simulation of B members at times (T,), s.

    Attributes:
        time: (T,).
        tube: (T, B, n) temperatures of the tube's cells, K; walls: (T, B, n, M) of the mold's shells.
        lumped: (T, B, 6), see `thermal_rates`.
        voltage, current: (T, B) at the battery's terminals and through them while the MOSFET conducts.
        resistance: (T, B) of the tube between the clamps, ohm.
        final: the state at the end.
        imbalance: (B,) energy unaccounted for, as a fraction of what the battery gave.
        within: the extremes within the slots, where `resimulate` made the history.
    """

    time: Array
    tube: Array
    walls: Array
    lumped: Array
    voltage: Array
    current: Array
    resistance: Array
    final: State
    imbalance: Array
    within: Extremes | None = None

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
        final=State(cells[-1], lumped[-1]),
        imbalance=imbalance(model, State(cells[-1], lumped[-1])),
    )


# --- many members at once ---------------------------------------------------------------------------------------------


def advance(model: ThermalModel, state: State, duty: Array | float, span: float, steps: int | None = None) -> State:
    """The state after `span` seconds at constant duty, one number or (B,): equal steps of ROS2, as many as `STEP` asks
    for unless told."""
    count = steps_of(span) if steps is None else steps
    cells, lumped, level = state.cells, state.lumped, np.reshape(duty, (-1, 1))
    for _ in range(count):
        cells, lumped = stepped(model, cells, lumped, level, span / count)
    return State(cells, lumped)


def steps_of(span: float) -> int:
    """Steps that a span, s, takes."""
    return max(math.ceil(span / STEP - 1e-9), 1)


def simulate(
    model: ThermalModel, slot: float, duty: ArrayLike, *, start: State | None = None, steps: int | None = None
) -> History:
    """The members under a schedule, in which duty[k] (T,) or (T, B) in [0, 1] holds from k slots to k + 1.

    The times of the history are the slots' ends, with the start.

    Args:
        steps: in every slot; by default as many as `STEP` asks for. Without it, slots far shorter than that are stepped
            over together where their duties hardly differ.
    """
    return history_of(model, slot, _trace(model, slot, np.asarray(duty, dtype=float), start or at_rest(model), steps))


def _trace(model: ThermalModel, slot: float, levels: Array, start: State, steps: int | None = None) -> State:
    """The states (T + 1, B, ...) at the slots' ends, with the start."""
    course = State(*(np.empty((len(levels) + 1, *row.shape)) for row in (start.cells, start.lumped)))
    course.cells[0], course.lumped[0] = start.cells, start.lumped
    together = max(int(TOGETHER / slot + 1e-9), 1) if steps is None else 1
    state, windows = start, list(_windows(levels, slot, together))
    means = [levels[first:last].mean(0) for first, last in windows]
    for (first, last), mean in zip(windows, means, strict=True):
        state = advance(model, state, mean, slot * (last - first), steps)
        course.cells[last], course.lumped[last] = state.cells, state.lumped
    ends, mean = np.array(windows).reshape(-1, 2), np.array(means)
    for count in range(2, together + 1):
        some = np.flatnonzero(ends[:, 1] - ends[:, 0] == count)
        # One member is asked in many states at once.
        for batch in range(0, len(some), size := BATCH if model.members == 1 else 1):
            which = some[batch : batch + size]
            _fill(model, course, (slot, levels), mean[which], ends[which, 0][:, None] + np.arange(count + 1))
    return course


def _windows(levels: Array, slot: float, most: int) -> Iterator[tuple[int, int]]:
    """First and last slot + 1 of those that are stepped over together: at most so many, and of nearly the same duty."""
    given = slot * np.concatenate([0 * levels[:1], np.cumsum(levels, 0)])
    alike = {count: _alike(given, count) for count in range(2, most + 1)}
    first = 0
    while first < len(levels):
        count = next((n for n in range(min(most, len(levels) - first), 1, -1) if alike[n][first]), 1)
        yield first, first + count
        first += count


def _alike(given: Array, count: int) -> NDArray[np.bool_]:
    """(T + 1 - count,) whether what was given (T + 1, ...) until the ends of `count` slots from each on hardly differs
    from what their mean duty would have given."""
    size = max(len(given) - count, 0)
    whole = given[count:] - given[:size]
    away = np.zeros(size)
    for k, part in enumerate(np.linspace(0.0, 1.0, count + 1)):
        off = np.abs(given[k : k + size] - given[:size] - part * whole)
        away = np.maximum(away, off.max(axis=tuple(range(1, off.ndim))))
    return np.asarray(away <= FORGOTTEN)


def _fill(model: ThermalModel, course: State, given: tuple[float, Array], mean: Array, at: NDArray[np.intp]) -> None:
    """Write the states at the ends of slots within windows into a course that has those at the windows' ends: linear in
    time, and what duty was given ahead of the mean has warmed and not yet left.

    Args:
        given: the slot and the duties (T, ...). mean: (W, ...) in the windows. at: (W, 1 + slots) their slots' ends.
    """
    slot, levels = given
    duty = levels[at[:, :-1]]
    ahead = slot * np.cumsum(duty - mean[:, None], 1)
    before, after = (State(course.cells[at[:, k]], course.lumped[at[:, k]]) for k in (0, -1))
    low, high = duty.min(1), duty.max(1)
    response = _response(model, before, low, high) if (high > low).any() else None
    for k in range(1, at.shape[1] - 1):
        part = k / (at.shape[1] - 1)
        cells = before.cells + part * (after.cells - before.cells)
        if response is not None:
            cells[..., :2] += response * np.reshape(ahead[:, k - 1], (len(at), -1, 1, 1))
        course.cells[at[:, k]] = cells
        course.lumped[at[:, k]] = before.lumped + part * (after.lumped - before.lumped)


def _response(model: ThermalModel, state: State, low: Array, high: Array) -> Array:
    """(W, B, n, 2) by how much faster, K/s, what a current heats warms per duty between two in states (W, B, ...)."""
    cells, lumped = np.concatenate(state.cells), np.concatenate(state.lumped)
    slow, fast = (
        warming(model, cells, lumped, np.broadcast_to(duty.reshape(len(duty), -1), state.cells.shape[:2]).reshape(-1))
        for duty in (low, high)
    )
    rise = np.maximum(np.reshape(high - low, (len(low), -1, 1, 1)), 1e-12)
    return np.asarray((fast - slow).reshape(*state.cells.shape[:3], 2) / rise)


def resimulate(model: ThermalModel, slot: float, duty: ArrayLike) -> History:
    """One member under a schedule, in steps of at most `LOOK`; the history knows the extremes within the slots."""
    levels = np.asarray(duty, dtype=float)
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
    coldest, hottest = np.minimum(starts, ends).min(1), np.maximum(starts, ends).max(1)
    return Extremes(coldest, hottest, rate, float(ampere.max()), float((level * ampere).max()))


def simulate_feedback(
    model: ThermalModel, slot: float, count: int, controller: Callable[[float, State], float]
) -> tuple[History, Array]:
    """One member under a duty that `controller` chooses at every slot from time and state; also the duties (count,)."""
    states, duties = [at_rest(model)], []
    for k in range(count):
        duties.append(controller(k * slot, states[-1]))
        states.append(advance(model, states[-1], duties[-1], slot))
    course = State(*(np.array([getattr(state, name) for state in states]) for name in ("cells", "lumped")))
    return history_of(model, slot, course), np.array(duties)


def clamp_temperature(history: History) -> Array:
    """(T, B) temperature of the clamps, K."""
    return np.asarray(history.lumped[:, :, CLAMP])
