"""The thermal model in time: many members at once by a Rosenbrock method."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dpbtrf, dpbtrs

from ...physics.heat import GRIP
from ...physics.heat_functions import CLAMP
from ...typing import Array
from .rates import State, at_rest, current, imbalance, linearised, rates
from .thermal import ThermalModel

GAMMA = 1 + 1 / math.sqrt(2)
"""Of ROS2, which is of order 2 for any approximation of the Jacobian and L-stable with the exact one (Verwer, Spee,
Blom and Hundsdorfer, SIAM J. Sci. Comput. 20 (1999))."""


STEP, LOOK = 1 / 6, 0.1
"""Greatest step, s, of a simulation in slots of up to half a second, and of one that looks for extremes."""

FORGOTTEN = 0.03 / 255
"""Duty times s by which the duties of slots that are stepped over together may run away from their mean: what half a
count does in the shortest of slots."""

REUSED = 10.0
"""Change of temperature, K, up to which factors of the Jacobian serve again."""

BATCH = 60
"""States of one member that are looked at together; each holds the model's numbers once."""


@dataclass(frozen=True, eq=False)
class Extremes:
    """The extremes within every slot (T-1,) of one member, looked for every `LOOK` seconds at least and at its ends.

    Attributes:
        coldest, hottest: (T-1, n) of the tube's cells, K.
        rate: (T-1,) fastest warming of any cell outside of the clamps, K/s, the duty taken for a mean power.
        current: (T-1,) greatest current while the MOSFET conducts, A; mean_current: the same times the duty.
    """

    coldest: Array
    hottest: Array
    rate: Array
    current: Array
    mean_current: Array


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


def history_of(model: ThermalModel, slot: float, states: Sequence[State]) -> History:
    """What a simulation tells of its states at the slots' ends."""
    tube = np.array([s.cells[:, :, 0] for s in states])
    now = [current(model, s.cells[:, :, 0], s.lumped) for s in states]
    return History(
        time=np.asarray(slot * np.arange(len(states)), dtype=float),
        tube=tube,
        walls=np.array([s.cells[:, :, 1:] for s in states]),
        lumped=np.array([s.lumped for s in states]),
        voltage=np.array([n.terminal_voltage for n in now]),
        current=np.array([n.total for n in now]),
        resistance=np.array([2 * n.resistance for n in now]),
        final=states[-1],
        imbalance=imbalance(model, states[-1]),
    )


# --- many members at once ---------------------------------------------------------------------------------------------


class _Factor:
    """Cholesky factors of heat - gamma h J, member by member: banded, since a cell's shells and the next cell are all
    that it couples."""

    def __init__(self, model: ThermalModel, cells: Array, h: float) -> None:
        self._at, self._h = np.full_like(cells, np.inf), h
        self.heat = np.empty_like(cells)
        self._factors: list[Array] = [np.empty(0)] * len(cells)
        self.renew(model, cells)

    def serves(self, h: float) -> bool:
        """Whether these are factors for steps of `h`."""
        return h == self._h

    def renew(self, model: ThermalModel, cells: Array) -> None:
        """Factor anew what belongs to members whose temperatures (B, n, m) have left those of their factors."""
        stale = np.flatnonzero(~(np.abs(cells - self._at).max((1, 2)) < REUSED))
        if not len(stale):
            return
        heat, own, inward, along = linearised(model, cells)
        n, m = cells.shape[1:]
        for b in stale:
            band = np.zeros((m + 1, n * m))
            band[0] = (heat[b] - GAMMA * self._h * own[b]).ravel()
            band[1] = (-GAMMA * self._h * inward[b]).ravel()
            band[m, : (n - 1) * m] = (-GAMMA * self._h * along[b]).ravel()
            self._factors[b] = dpbtrf(band, lower=1)[0]
        self._at[stale], self.heat[stale] = cells[stale], heat[stale]

    def solve(self, rate: Array) -> Array:
        """The stage for the right-hand side `rate` (B, n, m)."""
        load = (self.heat * rate).reshape(len(rate), -1)
        found = [dpbtrs(factor, one, lower=1)[0] for factor, one in zip(self._factors, load, strict=True)]
        return np.reshape(found, rate.shape)


def advance(model: ThermalModel, state: State, duty: Array | float, span: float, steps: int = 3) -> State:
    """The state after `span` seconds at constant duty, by ROS2 in equal steps."""
    return _advance(model, state, duty, span / steps, steps, _Factor(model, state.cells, span / steps))


def _advance(model: ThermalModel, state: State, duty: Array | float, h: float, steps: int, factor: _Factor) -> State:
    cells, lumped = state.cells, state.lumped
    for _ in range(steps):
        rate, slow = rates(model, cells, lumped, duty)
        first = factor.solve(rate)
        # The lumped states are slow: their Jacobian is left out, and the method is that of Heun for them.
        rate, later = rates(model, cells + h * first, lumped + h * slow, duty)
        second = factor.solve(rate - 2 * first)
        cells = cells + h * (1.5 * first + 0.5 * second)
        lumped = lumped + 0.5 * h * (slow + later)
    return State(cells, lumped)


def simulate(
    model: ThermalModel, slot: float, duty: ArrayLike, *, start: State | None = None, steps: int | None = None
) -> History:
    """The members under a schedule, in which duty[k] (T,) or (T, B) in [0, 1] holds from k slots to k + 1.

    The times of the history are the slots' ends, with the start.

    Args:
        steps: in every slot; by default as many as `STEP` asks for, at most 3. Without it, slots far shorter than that
            are stepped over together where their duties hardly differ.
    """
    return history_of(model, slot, _trace(model, slot, np.asarray(duty, dtype=float), start or at_rest(model), steps))


def _trace(model: ThermalModel, slot: float, levels: Array, start: State, steps: int | None = None) -> list[State]:
    """The states at the slots' ends, with the start."""
    states = [start]
    count = min(math.ceil(slot / STEP - 1e-9), 3) if steps is None else steps
    together = max(int(STEP / slot + 1e-9), 1) if steps is None else 1
    factor: _Factor | None = None
    for first, last in _windows(levels, slot, together):
        state, part = states[-1], levels[first:last]
        h, mean = slot * (last - first) / count, part.mean(0)
        if factor is None or not factor.serves(h):
            factor = _Factor(model, state.cells, h)
        factor.renew(model, state.cells)
        after = _advance(model, state, mean, h, count, factor)
        states += [*_between(model, state, after, slot * np.cumsum(part - mean, 0)[:-1], part), after]
    return states


def _windows(levels: Array, slot: float, most: int) -> Iterator[tuple[int, int]]:
    """First and last slot + 1 of those that are stepped over together: at most so many, and of nearly the same duty."""
    first = 0
    while first < len(levels):
        last = first + 1
        while last < min(first + most, len(levels)):
            part = levels[first : last + 1]
            if np.abs(slot * np.cumsum(part - part.mean(0), 0)).max() > FORGOTTEN:
                break
            last += 1
        yield first, last
        first = last


def _between(model: ThermalModel, before: State, after: State, ahead: Array, duty: Array) -> Iterator[State]:
    """States at the ends of slots within a window: linear in time, and what duty was given `ahead` of the mean (duty
    times s) has warmed and not yet left."""
    if not len(ahead):
        return
    low, high = duty.min(0), duty.max(0)
    rows = [rates(model, before.cells, before.lumped, level)[0] for level in (low, high)]
    response = (rows[1] - rows[0]) / np.maximum(np.reshape(high - low, (-1, 1, 1)), 1e-12)
    for k, extra in enumerate(ahead, start=1):
        part = k / len(duty)
        cells = before.cells + part * (after.cells - before.cells) + response * np.reshape(extra, (-1, 1, 1))
        yield State(cells, before.lumped + part * (after.lumped - before.lumped))


def resimulate(model: ThermalModel, slot: float, duty: ArrayLike) -> History:
    """One member under a schedule, in steps of at most `LOOK`; the history knows the extremes within the slots."""
    levels = np.asarray(duty, dtype=float)
    looks = math.ceil(slot / LOOK - 1e-9)
    states = _trace(model, slot / looks, np.repeat(levels, looks), at_rest(model))
    return replace(history_of(model, slot, states[::looks]), within=_extremes(model, states, levels, looks))


def _extremes(model: ThermalModel, states: Sequence[State], duty: Array, looks: int) -> Extremes:
    """Of slots (T-1,) at these duties, from states at `looks` times in every slot and at the start."""
    at = (looks * np.arange(len(duty))[:, None] + np.arange(looks + 1)).ravel()
    level = np.repeat(duty, looks + 1)
    free = model.zone > GRIP
    rate, ampere = [], []
    for first in range(0, len(at), BATCH):
        some = [states[k] for k in at[first : first + BATCH]]
        cells, lumped = (np.concatenate([getattr(s, name) for s in some]) for name in ("cells", "lumped"))
        found = rates(model, cells, lumped, level[first : first + BATCH])[0]
        rate.append(found[:, free, 0].max(1))
        ampere.append(current(model, cells[:, :, 0], lumped).total)
    shape = len(duty), looks + 1
    tube = np.array([s.cells[0, :, 0] for s in states])[at].reshape(*shape, -1)
    most = np.concatenate(ampere).reshape(shape).max(1)
    return Extremes(tube.min(1), tube.max(1), np.concatenate(rate).reshape(shape).max(1), most, duty * most)


def simulate_feedback(
    model: ThermalModel, slot: float, count: int, controller: Callable[[float, State], float]
) -> tuple[History, Array]:
    """One member under a duty that `controller` chooses at every slot from time and state; also the duties (count,)."""
    states, duties = [at_rest(model)], []
    for k in range(count):
        duties.append(controller(k * slot, states[-1]))
        states.append(advance(model, states[-1], duties[-1], slot))
    return history_of(model, slot, states), np.array(duties)


def clamp_temperature(history: History) -> Array:
    """(T, B) temperature of the clamps, K."""
    return np.asarray(history.lumped[:, :, CLAMP])
