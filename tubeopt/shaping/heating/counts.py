"""Schedules of whole PWM counts: sum-up rounding that respects limits, and the minimum-time schedule.

The minimum-time schedule has in every slot the greatest count that keeps the limits, then the hold. More power never
makes any point of the rig colder, so nothing warms up sooner. The ideal schedule needs a reserve in the ramp for
rounding to counts; this one does not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...constants import ZERO_CELSIUS
from ...errors import InputError
from ...robots.tubes import Tube
from ...typing import Array
from .outcome import count_rate_of, effective_count
from .rig import COUNTS, Rig
from .simulation import FINE_STEP, State, advance, at_rest, warming_span
from .spec import HeatingSpec
from .thermal import ThermalModel, leak_resistance, thermal_data, tube_extremes

Counts = NDArray[np.int64]

# "Half" and "twice" below: the value halved and doubled in six plans of the thesis' tube (60 s; most margin; a window
# of 10 K; glass mica; least energy; a ramp of 8 K/s). Counts that are owed for longer would come when the tube has
# forgotten the loss. At 8 K/s half and twice make the coldest point 1 K colder; other plans stay.
MAX_COLDER = 4.0
"""Largest loss of temperature by counts left out for the ramp, K."""

# Duties fall after the hold has begun, away from the ramp. Half and twice change no plan.
WATCHED = 10.0
"""Time of the hold with a check of every count, s: later no duty comes near the ramp."""

# Between two instants that are checked the rate may be greater. Twice delays the hold by half a second; with half of it
# other counts are chosen, and glass mica misses by 0.5 K more.
RAMP_MARGIN = 0.005
"""Fraction of the ramp that counts leave unused."""

# One count warms a tube by 4.6 K in 0.5 s. Half of it changes no plan; with twice the window of 10 K is reached 1.5 s
# later, and glass mica misses by 0.4 K more.
MIN_INTERVAL = 0.5
"""Smallest time with a duty of its own in the hold, s; shorter slots share it."""

# Where a mold draws ever more heat the coldest point warms ever more slowly: the search then ends after three checks
# instead of at the longest heating. Half and twice change no plan.
STALL, MAX_SPEED_UP = 10.0, 2.0
"""Time between checks of the coldest point, s, and largest factor of its warming speed later."""

# Radiation and resistance bend the line a little. Half and twice move temperatures by up to 0.4 K.
PROBE = 8.0
"""Counts between which temperatures at the end of a slot are taken as linear."""

CLOSE = 0.05
"""Tolerance of the greatest mean count that keeps the limits, counts."""


def sum_up_rounding(duty: ArrayLike) -> Counts:
    """Counts (T,) with a running sum within a half of that of 255 times the duty.

    Every slot gets the count that brings the sums together again. Between two counts the schedule dithers in the right
    proportion, which the tube averages: the combinatorial integral approximation with equal slots (Sager, Math.
    Program. 118 (2009)).

    Args:
        duty: (T,) in [0, 1], mean over each slot.

    Raises:
        InputError: a duty outside of [0, 1].
    """
    levels = np.asarray(duty, dtype=float)
    if levels.ndim != 1 or not np.isfinite(levels).all() or (levels < 0).any() or (levels > 1).any():
        raise InputError("duty must be a list of numbers from 0 to 1")
    # Rounding the running sums leaves at most a half; their differences are the counts. Where the duty is 0 a count
    # may still be owed: it is dropped, since it would heat after the end.
    sums = np.floor(COUNTS * np.cumsum(levels) + 0.5)
    counts = np.diff(sums, prepend=0.0)
    return np.asarray(np.clip(counts, 0, COUNTS) * (levels > 0), dtype=np.int64)


def full_current(tube: Tube, rig: Rig, *, leaking: bool = True) -> float:
    """Current while the MOSFET conducts and the tube is cold, A; with or without the leak through a conductive mold."""
    length = 2 * (rig.mold.lead + rig.clamps.clearance) + tube.curved_length
    R = rig.resistivity_factor * thermal_data(tube).resistivity / tube.cross_section * length
    if leaking:
        # A conductive mold is in parallel with the tube.
        R = 1 / (1 / R + 1 / leak_resistance(tube, rig))
    return rig.battery.voltage / (rig.battery.internal_resistance + rig.circuit.resistance + R)


def heating_rate(tube: Tube, rig: Rig, current: float) -> float:
    """Heating rate (K/s) of a tube by a current (A), without losses."""
    data, section = thermal_data(tube), tube.cross_section
    power = current**2 * rig.resistivity_factor * data.resistivity / section
    return power / (data.density * section * data.heat_capacity)


def count_rate(tube: Tube, rig: Rig) -> float:
    """Heating rate (K/s) of a tube in an insulating mold at a PWM count of 1, without losses."""
    return heating_rate(tube, rig, full_current(tube, rig, leaking=False)) / COUNTS


def ripple(tube: Tube, rig: Rig, spec: HeatingSpec) -> float:
    """Temperature ripple (K) by rounding to counts: half a count for one slot, without losses."""
    return 0.5 * spec.slot * count_rate(tube, rig)


def guarded_counts(model: ThermalModel, spec: HeatingSpec, rig: Rig, duty: Array, *, hurried: bool = False) -> Counts:
    """PWM counts (T,) by sum-up rounding, reduced where they would exceed ramp or current limit.

    Omitted counts follow in later slots, unless the tube has lost their heat by then: the sum falls behind by at most
    half a count and what makes the tube `MAX_COLDER` colder. One count is worth several K/s, so rounding alone breaks
    the ramp by as much. Where one count breaks the limits from rest, counts break them by as much as it does.

    Args:
        model: one member, simulated in parallel.
        duty: (T,) in [0, 1], mean over each slot.
        hurried: where one count breaks the limits, break the ramp by more rather than fall behind.
    """
    sums = COUNTS * np.cumsum(duty)
    counts = np.zeros(len(duty), dtype=np.int64)
    total, limits = 0.0, achievable_limits(model, spec, rig)
    now = Instant.of(model, at_rest(model), limits)
    idle, full, _ = warming_span(model, now.state.cells, now.state.lumped)
    free = slice(model.resolution.grip, None)
    # The counts that make the tube colder by MAX_COLDER in one slot, in addition to half a count of rounding.
    max_owed = 0.5 + MAX_COLDER * COUNTS / (spec.slot * float((full[0, free] - idle[0, free]).max()))
    hurried = hurried and limits != (spec, rig)
    heated = int(np.count_nonzero(duty))
    watched = heated - spec.hold_slots + math.ceil(WATCHED / spec.slot)
    k = 0
    # After the watched time plain rounding suffices once nothing is owed, which would come at once otherwise.
    while k < heated and (k < watched or sums[k - 1] - total > 0.5 + 1e-9):
        due = math.floor(sums[k] - total + 0.5)
        before = now
        now = sustained(model, before, limits, float(min(max(due, 0), int(before.max_count))), spec.slot)
        more = now.count + 1
        if hurried and more <= before.max_by_current and now.count < sums[k] - total - max_owed - 1e-9:
            steps = math.ceil(spec.slot / FINE_STEP - 1e-9)
            state = advance(model, before.state, more / COUNTS, spec.slot, steps)
            now = Instant.of(model, state, limits, more)
        counts[k] = int(now.count)
        total += now.count
        if not hurried:
            # The tube has forgotten what is owed beyond this: it must not come at once later.
            total = max(total, sums[k] - max_owed)
        k += 1
    rest = np.maximum(np.floor(sums[k:heated] - total + 0.5), 0.0)
    counts[k:heated] = np.minimum(np.diff(rest, prepend=0.0), COUNTS)
    return counts


class Limits(NamedTuple):
    """Limits on PWM counts: ramp and window of the specification, and mean current of the rig."""

    spec: HeatingSpec
    rig: Rig


@dataclass(frozen=True, eq=False)
class Instant:
    """State of one rig, and the PWM counts that ramp and mean current allow in it; these need not be whole."""

    state: State
    max_count: float
    """Greatest count that the limits allow now."""
    max_calm: float
    """Greatest count for which no cell, those in the clamps included, warms faster than the ramp.

    With it none does later either: under constant power the fastest warming of all cells never grows.
    """
    max_by_current: float
    """Greatest count that the mean current alone allows now."""
    count: float = 0.0
    """Count of the slot before."""

    @classmethod
    def of(cls, model: ThermalModel, state: State, limits: Limits, count: float = 0.0) -> Instant:
        """Largest counts in a state that the ramp and the mean current allow."""
        spec, rig = limits
        idle, full, I_on = warming_span(model, state.cells, state.lumped)
        # Warming is linear in the duty: idle + duty (full - idle) = ramp, cell by cell.
        duty = ((1 - RAMP_MARGIN) * spec.ramp - idle[0]) / np.maximum(full[0] - idle[0], 1e-9)
        # The part of a pulse that inductance takes does not warm, but counts as current.
        lost, by_current = rig.circuit.lost_share, min(rig.circuit.current_limit / float(I_on[0]), 1.0)
        free = model.resolution.grip
        max_count, max_calm = (
            COUNTS * max(min(float(cells.min()) + lost, by_current), 0.0) for cells in (duty[free:], duty)
        )
        return cls(state, max_count, max_calm, COUNTS * by_current, count)


def sustained(
    model: ThermalModel, now: Instant, limits: Limits, count: float, span: float, *, whole: bool = True
) -> Instant:
    """State after `span` s at the largest PWM count, up to `count`, that satisfies ramp and mean current throughout.

    Contacts heat the tube in the clamps, and that warms the tube beside them soon after the count was chosen.
    """

    def end_and_margin(count: float) -> tuple[Instant, float]:
        course = _followed(model, now, limits, count, span)
        return course[-1], min(instant.max_count for instant in course) - count

    above, margin = end_and_margin(count)
    if margin >= 0:
        return above
    # Regula falsi between a count that keeps the limits and one that does not.
    (below, margin_below), excess = end_and_margin(0.0), -margin
    tolerance = 1.0 if whole else CLOSE
    while above.count - below.count > tolerance and margin_below > 0:
        between = below.count + (above.count - below.count) * margin_below / (margin_below + excess)
        last, margin = end_and_margin(max(float(int(between)), below.count + 1) if whole else between)
        if margin >= 0:
            # Halving the value of the other end keeps one end from standing still (the Illinois rule).
            below, margin_below, excess = last, margin, 0.5 * excess
        else:
            above, margin_below, excess = last, 0.5 * margin_below, -margin
        if 0 <= margin < tolerance and not whole:
            break
    return below


def _followed(model: ThermalModel, now: Instant, limits: Limits, count: float, span: float) -> list[Instant]:
    """States at a PWM count, at the end of `span` s and at intermediate times if ramp and mean current need them."""
    # Steps as those of the check: the rates after the first counts of a fast ramp depend on them by a hundredth.
    steps, course = math.ceil(span / FINE_STEP - 1e-9), [now]
    parts = steps if count > now.max_calm else 1
    for _ in range(parts):
        state = advance(model, course[-1].state, count / COUNTS, span / parts, steps // parts)
        course.append(Instant.of(model, state, limits, count))
    return course[1:]


def max_count(model: ThermalModel, state: State, spec: HeatingSpec, rig: Rig) -> int:
    """Largest whole PWM count that satisfies ramp, with its margin, and mean current in a state."""
    return int(Instant.of(model, state, Limits(spec, rig)).max_count)


def achievable_limits(model: ThermalModel, spec: HeatingSpec, rig: Rig) -> Limits:
    """Limits, raised if necessary so that a PWM count of 1 is allowed at rest; no smaller count heats."""
    usable = 1 - RAMP_MARGIN
    rate = count_rate_of(model, rig, spec)
    if rate > usable * spec.ramp:
        spec = replace(spec, ramp=(1 + 1e-6) * rate / usable)
    allowed = Instant.of(model, at_rest(model), Limits(spec, rig)).max_by_current
    if allowed < effective_count(rig):
        limit = (1 + 1e-6) * rig.circuit.current_limit * effective_count(rig) / allowed
        rig = replace(rig, circuit=replace(rig.circuit, current_limit=limit))
    return Limits(spec, rig)


def blocking_limits(
    model: ThermalModel, spec: HeatingSpec, rig: Rig, counts: Counts, states: Sequence[State]
) -> list[str]:
    """(T,) limit that prevents a larger PWM count in each slot: "duty", "current" or "ramp"; "" for none."""
    blocking, limits = [], Limits(spec, rig)
    for count, state in zip((counts + 1).tolist(), states, strict=True):
        now = Instant.of(model, state, limits)
        course = [now, *_followed(model, now, limits, count, spec.slot)] if count <= COUNTS else []
        if not course:
            blocking.append("duty")
        elif min(instant.max_by_current for instant in course) < count:
            blocking.append("current")
        else:
            blocking.append("ramp" if min(instant.max_count for instant in course) < count else "")
    return blocking


# --- minimum time -----------------------------------------------------------------------------------------------------


class MinimumTime(NamedTuple):
    """Schedule that reaches the hold soonest."""

    counts: Counts
    """(T,) counts of heating and hold."""
    levels: Array
    """(T,) mean duties that the counts realise."""
    start: float
    """Start of the hold, s."""


def minimum_time_counts(model: ThermalModel, spec: HeatingSpec, rig: Rig, reserve: float) -> MinimumTime | None:
    """Largest PWM counts within the limits until the window is reached, then the hold; None if it is not reached.

    It is not reached if the time is too short, or if the coldest point warms more and more slowly and far too slowly.

    Args:
        model: one member. reserve: distance from the window's ends and the limit, K.
    """
    low, high = spec.window_degC[0] + reserve, min(spec.window_degC[1], spec.limit) - reserve
    counts, checks, limits = [], [], Limits(spec, rig)
    now = Instant.of(model, at_rest(model), limits)
    slots, period = int(spec.longest_heating / spec.slot), max(round(STALL / spec.slot), 1)
    for k in range(slots):
        coldest = float(tube_extremes(model, now.state.cells[0, :, 0]).coldest)
        if coldest >= low:
            break
        if k % period == 0:
            checks.append(coldest)
            if len(checks) >= 3:
                rise_before, rise = np.diff(checks[-3:]).tolist()
                remaining = MAX_SPEED_UP * (slots - k) / period
                if rise <= rise_before and coldest + remaining * rise < low:
                    return None
        now = _greatest(model, now, limits, float(int(now.max_count)), spec.slot, high)
        counts.append(int(now.count))
    else:
        return None
    hold = _hold(model, spec, rig, now.state, high)
    heating = np.array(counts, dtype=np.int64)
    levels = np.concatenate([heating / COUNTS, hold])
    return MinimumTime(np.concatenate([heating, sum_up_rounding(hold)]), levels, spec.slot * len(heating))


def _greatest(
    model: ThermalModel,
    now: Instant,
    limits: Limits,
    most: float,
    span: float,
    target: float,
    *,
    whole: bool = True,
) -> Instant:
    """State after `span` s at the largest PWM count, up to `most`, that satisfies all limits.

    These are ramp, mean current, and a temperature `target` (degC) of the hottest point at the end.
    """
    end = sustained(model, now, limits, most, span, whole=whole)
    if _hottest(end.state) <= target:
        return end
    count = COUNTS * _duty_for_target(model, now.state, end.count / COUNTS, span, target)
    return sustained(model, now, limits, float(int(count + 1e-9)) if whole else count, span, whole=whole)


def _hold(model: ThermalModel, spec: HeatingSpec, rig: Rig, state: State, high: float) -> Array:
    """(H,) duties that bring the curved part to the middle of the window and hold it there."""
    middle = 0.5 * sum(spec.window_degC)
    together = max(round(MIN_INTERVAL / spec.slot), 1)
    levels: list[float] = []
    while len(levels) < spec.hold_slots:
        span = together * spec.slot
        coldest = tube_extremes(model, state.cells[0, :, 0]).coldest
        target = min(_centring_target(model, state, middle), high)
        most = max_count(model, state, spec, rig)
        # One count is a reserve for changes within the slots that share a duty, unless the tube cools without it.
        for reserve in (1, 0):
            level = _duty_for_target(model, state, max(most - reserve, 0) / COUNTS, span, target)
            after = advance(model, state, level, span)
            if level < (most - reserve) / COUNTS or tube_extremes(model, after.cells[0, :, 0]).coldest >= coldest:
                break
        levels += [level] * together
        state = after
    return np.array(levels[: spec.hold_slots])


def _centring_target(model: ThermalModel, state: State, middle: float) -> float:
    """Temperature of the hottest point, degC, for which the curved part is centred about `middle`."""
    coldest, hottest, peak = tube_extremes(model, state.cells[0, :, 0])
    # A bare part may be hotter than the curved one.
    return float(middle + 0.5 * (hottest - coldest) + peak - hottest)


@dataclass(frozen=True, eq=False)
class Rollout:
    """Mean duties that a policy chooses, each for `span` s, and the states in between."""

    span: float
    levels: Array
    """(K,) duties in [0, 1]."""
    caps: Array
    """(K,) temperature limit of all points after each duty, degC."""
    centred: NDArray[np.bool_]
    """(K,) True for duties that centre the curved part about the middle of the window, as far as the cap allows."""
    states: tuple[State, ...]
    """States (K + 1) from the start."""

    def extremes(self, model: ThermalModel) -> Array:
        """(3, K + 1) coldest and hottest point of the curved part, and hottest point of the tube, degC."""
        return np.array(tube_extremes(model, np.array([state.cells[0, :, 0] for state in self.states])))


def rollout(
    model: ThermalModel,
    spec: HeatingSpec,
    rig: Rig,
    caps: Array,
    centred: NDArray[np.bool_],
    known: Rollout,
) -> Rollout:
    """Simulate the greatest duties within ramp and current that a policy of caps and centring allows.

    As far as the policy is that of a `known` rollout, its states are reused.
    """
    shared = min(len(caps), len(known.levels))
    changed = np.flatnonzero((caps[:shared] != known.caps[:shared]) | (centred[:shared] != known.centred[:shared]))
    first, middle = int(changed[0]) if len(changed) else shared, 0.5 * sum(spec.window_degC)
    states, levels, limits = list(known.states[: first + 1]), known.levels[:first].tolist(), Limits(spec, rig)
    limits_achievable = achievable_limits(model, spec, rig) == limits
    now = Instant.of(model, states[-1], limits)
    for cap, centre in zip(caps[first:].tolist(), centred[first:].tolist(), strict=True):
        target = min(cap, _centring_target(model, now.state, middle)) if centre else cap
        # The mean may keep limits that the greater of its counts breaks: the greatest whole count bounds it.
        most = float(int(now.max_count)) if limits_achievable else now.max_count
        now = _greatest(model, now, limits, most, known.span, target, whole=False)
        levels.append(now.count / COUNTS)
        states.append(now.state)
    return Rollout(known.span, np.array(levels), caps, centred, tuple(states))


def would_centre(model: ThermalModel, spec: HeatingSpec, course: Rollout) -> NDArray[np.bool_]:
    """(K,) True for duties that centring the curved part in the window would reduce."""
    middle, peaks = 0.5 * sum(spec.window_degC), course.extremes(model)[2, 1:]
    return np.array([_centring_target(model, state, middle) for state in course.states[:-1]]) < peaks


def _hottest(state: State) -> float:
    """Temperature of the hottest point of the tube, degC."""
    return float(state.cells[0, :, 0].max()) - ZERO_CELSIUS


def _duty_for_target(model: ThermalModel, state: State, most: float, span: float, target: float) -> float:
    """Largest duty, up to `most`, at which all points are below `target` (degC) after `span` s."""
    less = max(most - PROBE / COUNTS, 0.0)
    top, bottom = (_hottest(advance(model, state, level, span)) for level in (most, less))
    if top <= target or most <= less:
        return most
    # The line through both duties: temperatures are nearly linear over a few counts.
    return max(less + (target - bottom) / (top - bottom) * (most - less), 0.0)
