"""The thermal model in time: many members at once by a Rosenbrock method, or one with SciPy's stiff integrator."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import SolveError
from ...physics.heat import GRIP
from ...physics.heat_functions import CLAMP, LUMPED
from ...typing import Array
from .rates import State, at_rest, current, imbalance, linearised, rates
from .thermal import ThermalModel

GAMMA = 1 + 1 / math.sqrt(2)
"""Of ROS2, which is of order 2 for any approximation of the Jacobian and L-stable with the exact one (Verwer, Spee,
Blom and Hundsdorfer, SIAM J. Sci. Comput. 20 (1999))."""


LOOKS = 5
"""Times within every slot, beside its beginning, at which `integrate` looks for extremes."""


@dataclass(frozen=True, eq=False)
class Extremes:
    """The extremes within every slot (T-1,) of one member, looked for at its beginning and at `LOOKS` more times.

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
        within: the extremes within the slots, where `integrate` made the history.
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


def _history(model: ThermalModel, slot: float, states: Sequence[State]) -> History:
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
    """Block elimination of heat - gamma h J: blocks of a cell and its shells, coupled along the tube by diagonals."""

    def __init__(self, model: ThermalModel, cells: Array, h: float) -> None:
        self.heat, own, inward, along = linearised(model, cells)
        b, n, m = cells.shape
        block = np.zeros((b, n, m, m))
        row = np.arange(m)
        block[:, :, row, row] = self.heat - GAMMA * h * own
        block[:, :, row[:-1], row[1:]] = block[:, :, row[1:], row[:-1]] = -GAMMA * h * inward[:, :, :-1]
        self.coupling = GAMMA * h * along
        self.inverse = np.empty_like(block)
        for i in range(n):
            pivot = block[:, i]
            if i:
                e = self.coupling[:, i - 1]
                pivot = pivot - e[:, :, None] * self.inverse[:, i - 1] * e[:, None, :]
            self.inverse[:, i] = np.linalg.inv(pivot)

    def solve(self, rate: Array) -> Array:
        """The stage for the right-hand side `rate` (B, n, m)."""
        x = self.heat * rate
        n = x.shape[1]
        for i in range(1, n):
            x[:, i] += self.coupling[:, i - 1] * (self.inverse[:, i - 1] @ x[:, i - 1, :, None])[:, :, 0]
        x[:, -1] = (self.inverse[:, -1] @ x[:, -1, :, None])[:, :, 0]
        for i in range(n - 2, -1, -1):
            x[:, i] = (self.inverse[:, i] @ (x[:, i] + self.coupling[:, i] * x[:, i + 1])[:, :, None])[:, :, 0]
        return x


def advance(model: ThermalModel, state: State, duty: Array | float, span: float, steps: int = 3) -> State:
    """The state after `span` seconds at constant duty, by ROS2 in equal steps."""
    h = span / steps
    cells, lumped = state.cells, state.lumped
    factor = _Factor(model, cells, h)
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
    model: ThermalModel, slot: float, duty: ArrayLike, *, start: State | None = None, steps: int = 3
) -> History:
    """The members under a schedule, in which duty[k] (T,) or (T, B) in [0, 1] holds from k slots to k + 1.

    The times of the history are the slots' ends, with the start.
    """
    levels = np.asarray(duty, dtype=float)
    states = [start or at_rest(model)]
    for level in levels:
        states.append(advance(model, states[-1], level, slot, steps))
    return _history(model, slot, states)


def simulate_feedback(
    model: ThermalModel, slot: float, count: int, controller: Callable[[float, State], float]
) -> tuple[History, Array]:
    """One member under a duty that `controller` chooses at every slot from time and state; also the duties (count,)."""
    states, duties = [at_rest(model)], []
    for k in range(count):
        duties.append(controller(k * slot, states[-1]))
        states.append(advance(model, states[-1], duties[-1], slot))
    return _history(model, slot, states), np.array(duties)


# --- SciPy --------------------------------------------------------------------------------------------------------


def runs(duty: NDArray[np.float64]) -> Iterator[tuple[int, int]]:
    """First and last slot + 1 of every run of equal duties."""
    edges = np.flatnonzero(np.diff(duty)) + 1
    yield from zip([0, *edges.tolist()], [*edges.tolist(), len(duty)], strict=True)


def integrate(
    model: ThermalModel,
    slot: float,
    duty: ArrayLike,
    *,
    method: str = "LSODA",
    rtol: float = 1e-6,
    atol: float = 1e-3,
) -> History:
    """One member under a schedule with an adaptive, stiff integrator of SciPy, started anew where the duty changes.

    The history is at the slots' ends; it knows the extremes within them.

    Args:
        slot: s; duty: (T,) in [0, 1].
        method: "LSODA", "BDF" or "Radau".

    Raises:
        SolveError: the integrator gave up.
    """
    from scipy.integrate import solve_ivp

    levels = np.asarray(duty, dtype=float)
    initial = at_rest(model)
    shape = initial.cells.shape
    size = initial.cells.size
    y = np.concatenate([initial.cells.ravel(), initial.lumped.ravel()])
    band = {"lband": shape[2], "uband": shape[2]} if method == "LSODA" else {}
    trace, within = [y], []
    for first, last in runs(levels):
        level = float(levels[first])

        def slope(_: float, y: Array, level: float = level) -> Array:
            rate, lumped = rates(model, y[:size].reshape(shape), y[size:].reshape(1, LUMPED), level)
            return np.concatenate([rate.ravel(), lumped.ravel()])

        span = slot * (last - first)
        at = slot / LOOKS * np.arange(1, LOOKS * (last - first) + 1)
        at[-1] = span
        found = solve_ivp(slope, (0.0, span), y, method=method, t_eval=at, rtol=rtol, atol=atol, **band)
        if not found.success:
            raise SolveError(
                f"the re-simulation gave up {slot * first + found.t[-1]:.2f} s into the schedule: {found.message}"
            )
        fine = np.vstack([y, found.y.T])
        within.append(_extremes(model, fine[:, :size].reshape(-1, *shape[1:]), fine[:, size:], level))
        trace += list(fine[LOOKS::LOOKS])
        y = trace[-1]
    states = [State(z[:size].reshape(shape), z[size:].reshape(1, LUMPED)) for z in trace]
    names = [item.name for item in fields(Extremes)]
    joined = {name: np.concatenate([getattr(run, name) for run in within]) for name in names}
    return replace(_history(model, slot, states), within=Extremes(**joined))


def _extremes(model: ThermalModel, cells: Array, lumped: Array, duty: float) -> Extremes:
    """Of a run of slots at one duty, from states at its beginning and `LOOKS` times in every slot."""
    count = (len(cells) - 1) // LOOKS
    looks = LOOKS * np.arange(count)[:, None] + np.arange(LOOKS + 1)
    tube = cells[:, :, 0]
    free = model.zone > GRIP
    # Slot by slot: a batch of all would hold the model's numbers once for every state.
    rate = np.array([rates(model, cells[k], lumped[k], duty)[0][:, free, 0].max() for k in looks])
    ampere = np.array([current(model, tube[k], lumped[k]).total.max() for k in looks])
    return Extremes(tube[looks].min(1), tube[looks].max(1), rate, ampere, duty * ampere)


def clamp_temperature(history: History) -> Array:
    """(T, B) temperature of the clamps, K."""
    return np.asarray(history.lumped[:, :, CLAMP])
