"""The hold that misses a window by least, by mean duties: searched over when it is, and at what temperature."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...constants import ZERO_CELSIUS
from ...robots.tubes import Tube
from ...typing import Array
from .counts import Pace, paced, ripple, would_centre
from .outcome import mesh_error
from .rig import Rig
from .simulation import at_rest, simulate
from .spec import HeatingSpec
from .thermal import COARSE, FINE, ThermalModel, thermal_model


@dataclass(frozen=True, eq=False)
class Nearest:
    """Mean duties to the end of a hold, with which of them it begins, and by how much it misses the window, K."""

    pace: Pace
    first: int
    missed: float


def nearest_hold(tube: Tube, rig: Rig, spec: HeatingSpec) -> Nearest:
    """The mean duties that miss the window by least, wherever the hold is and at whatever temperature.

    More power never makes anything colder. So it heats as fast as ramp and currents allow, until the hottest point is
    at the limit; at some time it lets the curved part spread evenly about the window's middle, as far as the limit
    allows; and it holds where that misses by least. All times are searched on a grid over all that may be; then holds
    that rise to the limit, and short ones after a colder wait, in which the tube is more even.
    """
    (model, rough), swing = (thermal_model(tube, rig, grid) for grid in (FINE, COARSE)), ripple(tube, rig, spec)
    guess = spec.solver.first_error * (spec.limit + ZERO_CELSIUS - rig.ambient)
    found = placed(model, rig, spec, spec.limit - guess - swing)
    # What the mesh adds is known of these duties.
    runs = ((m, simulate(m, found.pace.span, found.pace.levels)) for m in (rough, model))
    start = found.first * found.pace.span
    error = mesh_error(next(runs), next(runs), replace(spec, slot=found.pace.span), start)
    return capped(model, rig, spec, found, guess - error.hottest - spec.solver.reserve)


def capped(model: ThermalModel, rig: Rig, spec: HeatingSpec, found: Nearest, higher: float) -> Nearest:
    """The same policy with caps that are so much `higher`, K."""
    policy = found.pace.caps + higher, found.pace.centred
    pace = paced(model, spec, rig, policy, at_start(model, found.pace.span))
    return Nearest(pace, found.first, float(missed_by(model, spec, pace, len(pace.levels) - found.first)[-1]))


def at_start(model: ThermalModel, span: float) -> Pace:
    """Before the first duty."""
    return Pace(span, np.zeros(0), np.zeros(0), np.zeros(0, dtype=bool), (at_rest(model),))


def placed(model: ThermalModel, rig: Rig, spec: HeatingSpec, cap: float) -> Nearest:
    """The mean duties with which no point is hotter than `cap`, degC, that miss the window by least."""
    slots, nearest = int(spec.longest_heating / spec.slot), spec.solver.nearest
    each = max(round(spec.solver.counts.decided / spec.slot), math.ceil(slots / nearest.places), 1)
    span, longest, hold = each * spec.slot, slots // each, -(-spec.hold_slots // each)
    rest, places = at_start(model, span), np.arange(longest + hold)
    tried: list[tuple[float, int, Pace]] = []

    def follow(caps: Array, centred: NDArray[np.bool_], known: Pace, least: int = 1) -> Pace:
        pace = paced(model, spec, rig, (caps, centred), known)
        missed = missed_by(model, spec, pace, hold)[: longest + 1]
        missed[:least] = np.inf
        # The soonest of those that are as good.
        first = int(np.argmax(missed <= missed.min() + nearest.same))
        tried.append((float(missed[first]), first, pace))
        return pace

    hottest = follow(np.full(len(places), cap), places < 0, rest)
    free = np.flatnonzero(would_centre(model, spec, hottest)[: longest + 1])
    if len(free):
        settle = round(nearest.settling / span)
        spread = np.geomspace(1, longest + 1, nearest.branches).astype(int) - 1
        for at in sorted({int(free[0]), *(int(at) for at in spread if at >= free[0])}):
            until = at + settle + hold if at > free[0] else len(places)
            follow(hottest.caps[:until], places[:until] >= at, hottest, max(at, 1))
    if spec.hold_time <= nearest.burst:
        ambient = model.ambient - ZERO_CELSIUS
        for share in nearest.waits:
            rise = math.ceil((1 - share) * (cap - ambient) / spec.ramp / span)
            waiting = places < longest - 2 * rise
            follow(
                np.where(waiting, ambient + share * (cap - ambient), cap), places < 0, rest, max(longest - 2 * rise, 1)
            )
    _, first, pace = min(tried, key=lambda one: one[0])
    last, before = first + hold, round(nearest.before / span)
    for lower in nearest.rises:
        rising = np.clip((last - places[:last]) / hold, 0.0, 1.0) * lower
        caps = pace.caps[:last] - np.where(places[:last] >= first - before, rising, 0.0)
        follow(caps, pace.centred[:last], pace, max(first - before, 1))
    missed, first, pace = min(tried, key=lambda one: one[0])
    last = first + hold
    kept = Pace(span, pace.levels[:last], pace.caps[:last], pace.centred[:last], pace.states[: last + 1])
    return Nearest(kept, first, missed)


def missed_by(model: ThermalModel, spec: HeatingSpec, pace: Pace, hold: int) -> Array:
    """(P,) by how much the window is missed where the hold, `hold` duties long, begins with each of the duties, K."""
    coldest, hottest, _ = np.lib.stride_tricks.sliding_window_view(pace.seen(model), hold + 1, axis=1)
    low, high = spec.window_degC
    return np.asarray(np.maximum(low - coldest.min(1), hottest.max(1) - high))
