"""The soonest schedule of whole counts: at every slot the greatest count that keeps the limits, then the hold.

More power never makes any point of the rig colder, so nothing warms up sooner than the greatest count that ramp,
current and the upper limit allow. The ideal schedule leaves room below the ramp for counts that it does not know; this
one knows them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...robots.materials import ZERO_CELSIUS
from ...typing import Array
from .counts import Counts, most_count, sum_up_rounding
from .rates import State, at_rest
from .rig import COUNTS, Rig
from .simulation import advance
from .spec import HeatingSpec
from .thermal import ThermalModel, seen


def soonest(model: ThermalModel, spec: HeatingSpec, rig: Rig, reserve: float) -> tuple[Counts, Array, float] | None:
    """Counts and mean duties (T,) of heating and hold, and when the hold begins, s; None where the window is not
    reached in time, or the coldest point warms ever slower and far too slowly for it.

    Args:
        model: one member. reserve: kept from the window's ends and the limit, K.
    """
    low, high = spec.window_degC[0] + reserve, min(spec.window_degC[1], spec.limit) - reserve
    state, counts, looked = at_rest(model), [], []
    slots, apart = int(spec.longest_heating / spec.slot), max(round(spec.solver.stall / spec.slot), 1)
    for k in range(slots):
        coldest = float(seen(model, state.cells[0, :, 0])[0])
        if coldest >= low:
            break
        if k % apart == 0:
            looked.append(coldest)
            if _stalls(looked, low, spec.solver.sooner * (slots - k) / apart):
                return None
        most = most_count(model, state, spec, rig)
        count, state = _greatest(model, state, most, (spec.slot, high, spec.solver.probe))
        counts.append(count)
    else:
        return None
    held = _hold(model, spec, rig, state, high)
    heating = np.array(counts, dtype=np.int64)
    levels = np.concatenate([heating / COUNTS, held])
    return np.concatenate([heating, sum_up_rounding(held)]), levels, spec.slot * len(heating)


def _stalls(seen: Sequence[float], goal: float, left: float) -> bool:
    """Whether temperatures at equal distances in time, which rise less and less, would not reach a goal by as many more
    rises as there are left, no smaller than the last one."""
    if len(seen) < 3:
        return False
    before, rise = seen[-2] - seen[-3], seen[-1] - seen[-2]
    return rise <= before and seen[-1] + left * rise < goal


def _greatest(model: ThermalModel, state: State, most: int, goal: tuple[float, float, float]) -> tuple[int, State]:
    """Greatest count, up to `most`, that keeps every point below a temperature after a time (`goal`: s, degC, and
    counts between which it is taken to be linear), and the state then."""
    after = advance(model, state, most / COUNTS, goal[0])
    if _hottest(after) <= goal[1]:
        return most, after
    count = int(COUNTS * _level(model, state, most / COUNTS, goal) + 1e-9)
    return count, advance(model, state, count / COUNTS, goal[0])


def _hold(model: ThermalModel, spec: HeatingSpec, rig: Rig, state: State, high: float) -> Array:
    """(H,) duties that bring the curved part to the middle of the window and keep it there."""
    middle = 0.5 * sum(spec.window_degC)
    together = max(round(spec.solver.decided / spec.slot), 1)
    levels: list[float] = []
    while len(levels) < spec.hold_slots:
        span = together * spec.slot
        coldest, hottest, top = seen(model, state.cells[0, :, 0])
        # A bare part may be hotter than the curved one.
        target = min(float(middle + 0.5 * (hottest - coldest) + top - hottest), high)
        most = most_count(model, state, spec, rig)
        # One count is left for what changes within the slots that share a duty, but the tube need not cool for it.
        for spared in (1, 0):
            level = _level(model, state, max(most - spared, 0) / COUNTS, (span, target, spec.solver.probe))
            after = advance(model, state, level, span)
            if level < (most - spared) / COUNTS or seen(model, after.cells[0, :, 0])[0] >= coldest:
                break
        levels += [level] * together
        state = after
    return np.array(levels[: spec.hold_slots])


def _hottest(state: State) -> float:
    """Of any point of the tube, degC."""
    return float(state.cells[0, :, 0].max()) - ZERO_CELSIUS


def _level(model: ThermalModel, state: State, most: float, goal: tuple[float, float, float]) -> float:
    """Duty up to `most` with which the hottest point has a temperature after a time (`goal` as above), or less."""
    span, target, probe = goal
    less = max(most - probe / COUNTS, 0.0)
    top, bottom = (_hottest(advance(model, state, level, span)) for level in (most, less))
    if top <= target or most <= less:
        return most
    return max(less + (target - bottom) / (top - bottom) * (most - less), 0.0)
