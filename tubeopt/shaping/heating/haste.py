"""The soonest schedule of whole counts: at every slot the greatest count that keeps the limits, then the hold.

More power never makes any point of the rig colder, so nothing warms up sooner than the greatest count that ramp,
current and the upper limit allow. The ideal schedule leaves room below the ramp for counts that it does not know; this
one knows them.
"""

from __future__ import annotations

import numpy as np

from ...robots.materials import ZERO_CELSIUS
from ...typing import Array
from .counts import most_count
from .ideal import joined
from .rates import State, at_rest
from .rig import COUNTS, Rig
from .schedule import Counts, sum_up_rounding
from .simulation import advance
from .spec import HeatingSpec
from .thermal import ThermalModel

DECIDED = 0.5
"""Least time, s, for which a duty of the hold is chosen; slots that are shorter share it."""

PROBE = 8.0
"""Counts between which temperatures at the end of a slot are taken to be linear."""


def soonest(model: ThermalModel, spec: HeatingSpec, rig: Rig, reserve: float) -> tuple[Counts, Array, float] | None:
    """Counts and mean duties (T,) of heating and hold, and when the hold begins, s; None where the window is not
    reached in time.

    Args:
        model: one member. reserve: kept from the window's ends and the limit, K.
    """
    low, high = spec.window_degC[0] + reserve, min(spec.window_degC[1], spec.limit) - reserve
    state, counts = at_rest(model), []
    for _ in range(int(spec.longest_heating / spec.slot)):
        if _curved(model, state)[0] >= low:
            break
        most = most_count(model, state, spec, rig)
        count, state = _greatest(model, state, most, (spec.slot, high))
        counts.append(count)
    else:
        return None
    held = _hold(model, spec, rig, state, high)
    heating = np.array(counts, dtype=np.int64)
    levels = np.concatenate([heating / COUNTS, held])
    return np.concatenate([heating, sum_up_rounding(held)]), levels, spec.slot * len(heating)


def _greatest(model: ThermalModel, state: State, most: int, goal: tuple[float, float]) -> tuple[int, State]:
    """Greatest count, up to `most`, that keeps every point below a temperature after a time (`goal`: s, degC), and the
    state then."""
    after = advance(model, state, most / COUNTS, goal[0])
    if _hottest(after) <= goal[1]:
        return most, after
    count = int(COUNTS * _level(model, state, most / COUNTS, goal) + 1e-9)
    return count, advance(model, state, count / COUNTS, goal[0])


def _hold(model: ThermalModel, spec: HeatingSpec, rig: Rig, state: State, high: float) -> Array:
    """(H,) duties that bring the curved part to the middle of the window and keep it there."""
    middle = 0.5 * sum(spec.window_degC)
    together = max(round(DECIDED / spec.slot), 1)
    levels: list[float] = []
    while len(levels) < spec.hold_slots:
        span = together * spec.slot
        coldest, hottest = _curved(model, state)
        most = (most_count(model, state, spec, rig) - 1) / COUNTS
        target = min(middle + 0.5 * (hottest - coldest), high)
        levels += [_level(model, state, max(most, 0.0), (span, target))] * together
        state = advance(model, state, levels[-1], span)
    return np.array(levels[: spec.hold_slots])


def _curved(model: ThermalModel, state: State) -> tuple[float, float]:
    """Coldest and hottest of the curved part, degC."""
    found = joined(model, state.cells[:, :, 0]) - ZERO_CELSIUS
    return float(found.min()), float(found.max())


def _hottest(state: State) -> float:
    """Of any point of the tube, degC."""
    return float(state.cells[0, :, 0].max()) - ZERO_CELSIUS


def _level(model: ThermalModel, state: State, most: float, goal: tuple[float, float]) -> float:
    """Duty up to `most` with which the hottest point has a temperature after a time (`goal`: s, degC), or less."""
    span, target = goal
    less = max(most - PROBE / COUNTS, 0.0)
    top, bottom = (_hottest(advance(model, state, level, span)) for level in (most, less))
    if top <= target or most <= less:
        return most
    return max(less + (target - bottom) / (top - bottom) * (most - less), 0.0)
