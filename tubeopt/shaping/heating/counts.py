"""Whole counts: in place of real duties by sum-up rounding, with a look at the tube, which keeps limits; the soonest.

The soonest schedule has at every slot the greatest count that keeps the limits, then the hold. More power never makes
any point of the rig colder, so nothing warms up sooner. The ideal schedule leaves room below the ramp for counts that
it does not know; this one knows them.
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
from .outcome import count_warms, one_count
from .rig import COUNTS, Rig
from .simulation import LOOK, State, advance, at_rest, warming_span
from .spec import HeatingSpec
from .thermal import ThermalModel, leak_resistance, seen, thermal_data

Counts = NDArray[np.int64]

# "Half" and "twice" below: the value halved and doubled in six plans of the thesis' tube (60 s; most margin; a window
# of 10 K; glass mica; least energy; a ramp of 8 K/s). What is owed for longer is given when the tube has forgotten it.
# At 8 K/s half and twice make the coldest point 1 K colder; other plans stay.
COLDER = 4.0
"""Largest loss of temperature by counts left out for the ramp, K."""

# Duties fall after the hold has begun, away from the ramp. Half and twice change no plan.
WATCHED = 10.0
"""Time of the hold for which every count is checked, s: later no duty comes near the ramp."""

# The rate beside the counts is that of steps of 0.25 s, the check uses 0.1 s. Twice delays the hold by half a second;
# with half of it other counts are chosen, and glass mica misses by 0.5 K more.
SPARED = 0.005
"""Share of the ramp that counts leave unused, for the error of the quick simulation beside them."""

# One count warms a tube by 4.6 K in 0.5 s. Half of it changes no plan; with twice the window of 10 K is reached 1.5 s
# later, and glass mica misses by 0.4 K more.
DECIDED = 0.5
"""Least time for which a duty of the hold is chosen, s; shorter slots share it."""

# Where a mold draws ever more heat the coldest point warms ever more slowly: the search then ends after three looks
# instead of at the longest heating. Half and twice change no plan.
STALL, SOONER = 10.0, 2.0
"""Time over which the warming of the coldest point is checked, s, and how much faster it may warm later."""

# Radiation and resistance bend the line a little. Half and twice move temperatures by up to 0.4 K.
PROBE = 8.0
"""Counts between which temperatures at the end of a slot are taken as linear."""

CLOSE = 0.05
"""Counts by which one that need not be whole may be below the greatest that is kept."""


def sum_up_rounding(duty: ArrayLike) -> Counts:
    """Counts (T,) whose running sum never differs from that of 255 times the duty by more than a half.

    Every slot gets the count that brings the sums together again, so that between two counts the schedule dithers in
    the right proportion, and the tube, which integrates, hardly sees it: the combinatorial integral approximation with
    equal slots (Sager, Math. Program. 118 (2009)).

    Args:
        duty: (T,) in [0, 1], mean over each slot.

    Raises:
        InputError: a duty outside of [0, 1].
    """
    levels = np.asarray(duty, dtype=float)
    if levels.ndim != 1 or not np.isfinite(levels).all() or (levels < 0).any() or (levels > 1).any():
        raise InputError("duty must be a list of numbers from 0 to 1")
    # Rounding the running sums themselves leaves no more than a half; their differences are the counts. Where the
    # duty is 0 a count may still be owed: it is dropped, rather than heat after the end.
    sums = np.floor(COUNTS * np.cumsum(levels) + 0.5)
    counts = np.diff(sums, prepend=0.0)
    return np.asarray(np.clip(counts, 0, COUNTS) * (levels > 0), dtype=np.int64)


def full_current(tube: Tube, rig: Rig, *, leaking: bool = True) -> float:
    """Current while the MOSFET conducts and the tube is cold, A; with or without what a mold that conducts takes."""
    whole = 2 * (rig.mold.lead + rig.clamps.clearance) + tube.curved_length
    ohm = rig.resistivity_factor * thermal_data(tube).resistivity / tube.cross_section * whole
    if leaking:
        # The mold that conducts is in parallel with the tube.
        ohm = 1 / (1 / ohm + 1 / leak_resistance(tube, rig))
    return rig.battery.voltage / (rig.battery.internal_resistance + rig.circuit.resistance + ohm)


def heating_rate(tube: Tube, rig: Rig, ampere: float) -> float:
    """Rate (K/s) at which a current (A) warms a tube, without any loss."""
    data, section = thermal_data(tube), tube.cross_section
    power = ampere**2 * rig.resistivity_factor * data.resistivity / section
    return power / (data.density * section * data.heat_capacity)


def count_rate(tube: Tube, rig: Rig) -> float:
    """Rate (K/s) at which one count of the duty warms a tube in an insulating mold, without any loss."""
    return heating_rate(tube, rig, full_current(tube, rig, leaking=False)) / COUNTS


def ripple(tube: Tube, rig: Rig, spec: HeatingSpec) -> float:
    """Temperature (K) by which rounding to counts makes the tube swing: half a count for one slot, without any loss."""
    return 0.5 * spec.slot * count_rate(tube, rig)


def guarded_counts(model: ThermalModel, spec: HeatingSpec, rig: Rig, duty: Array, *, hurried: bool = False) -> Counts:
    """Counts (T,) of sum-up rounding, fewer in a slot where they would break ramp or current limit in it.

    What is left out is given in later slots, but for what the tube has forgotten by then: the sum falls behind by no
    more than half a count and what makes the tube colder by what the solver allows. One count is worth several K/s:
    without the guard rounding alone breaks the ramp by as much. Where not even one count keeps the limits from rest,
    nothing would ever be heated: there the counts break them by as much as one does.

    Args:
        model: one member, whose temperatures are simulated along.
        duty: (T,) in [0, 1], mean over each slot.
        hurried: whether counts that break the limits anyway break the ramp by more rather than fall behind.
    """
    sums = COUNTS * np.cumsum(duty)
    counts = np.zeros(len(duty), dtype=np.int64)
    given, limits = 0.0, kept_by_one(model, spec, rig)
    now = Instant.of(model, at_rest(model), limits)
    slow, fast = idle_rates(model, now.state)
    # The counts that make the tube colder by COLDER in one slot, beside half a count of rounding.
    owed = 0.5 + COLDER * COUNTS / (spec.slot * float((fast - slow).max()))
    hurried = hurried and limits != (spec, rig)
    heated = int(np.count_nonzero(duty))
    watched = heated - spec.hold_slots + math.ceil(WATCHED / spec.slot)
    k = 0
    # Without a look, all that is owed would be given at once.
    # After the time that is watched plain rounding is enough, if nothing is owed any more.
    while k < heated and (k < watched or sums[k - 1] - given > 0.5 + 1e-9):
        due = math.floor(sums[k] - given + 0.5)
        before, now = now, sustained(model, now, limits, float(min(max(due, 0), int(now.most))), spec.slot)
        more = now.count + 1
        if hurried and more <= before.by_current and now.count < sums[k] - given - owed - 1e-9:
            now = Instant.of(model, advance(model, before.state, more / COUNTS, spec.slot), limits, more)
        counts[k] = int(now.count)
        given += now.count
        if not hurried:
            # What the tube has forgotten is dropped, so that it is not given at once later.
            given = max(given, sums[k] - owed)
        k += 1
    rest = np.maximum(np.floor(sums[k:heated] - given + 0.5), 0.0)
    counts[k:heated] = np.minimum(np.diff(rest, prepend=0.0), COUNTS)
    return counts


class Limits(NamedTuple):
    """What counts must keep: ramp and window of the question, and the mean current of the rig."""

    spec: HeatingSpec
    rig: Rig


@dataclass(frozen=True, eq=False)
class Instant:
    """A state, and the counts that ramp and mean current allow in it; they need not be whole."""

    state: State
    most: float
    """Greatest that the limits allow now."""
    calm: float
    """Greatest with which no cell warms faster than the ramp, those in the clamps included: none does later either, for
    under constant power the fastest warming of all cells never grows."""
    by_current: float
    """Greatest that the mean current alone allows now."""
    count: float = 0.0
    """That was kept until now."""

    @classmethod
    def of(cls, model: ThermalModel, state: State, limits: Limits, count: float = 0.0) -> Instant:
        """That of a state."""
        spec, rig = limits
        slow, fast, now = warming_span(model, state.cells, state.lumped)
        # Warming is linear in the duty: slow + duty (fast - slow) = ramp, cell by cell.
        room = ((1 - SPARED) * spec.ramp - slow[0]) / np.maximum(fast[0] - slow[0], 1e-9)
        # What a pulse loses does not warm, but it flows.
        lost, bound = rig.circuit.lost_share, min(rig.circuit.current_limit / float(now[0]), 1.0)
        free = model.resolution.grip
        most, calm = (COUNTS * max(min(float(cells.min()) + lost, bound), 0.0) for cells in (room[free:], room))
        return cls(state, most, calm, COUNTS * bound, count)


def sustained(
    model: ThermalModel, now: Instant, limits: Limits, count: float, span: float, *, whole: bool = True
) -> Instant:
    """What follows `span` s with the greatest count, up to `count`, that keeps ramp and mean current all the time.

    Contacts heat the tube in the clamps, and that warms the tube beside them soon after the count was chosen.
    """

    def tried(count: float) -> tuple[Instant, float]:
        course = _followed(model, now, limits, count, span)
        return course[-1], min(at.most for at in course) - count

    above, spare = tried(count)
    if spare >= 0:
        return above
    (found, room), lack = tried(0.0), -spare
    close = 1.0 if whole else CLOSE
    while above.count - found.count > close and room > 0:
        # Regula falsi between a count that keeps the limits and one that does not.
        between = found.count + (above.count - found.count) * room / (room + lack)
        last, spare = tried(max(float(int(between)), found.count + 1) if whole else between)
        if spare >= 0:
            # Halving the other end's value keeps one end from standing still (the Illinois rule).
            found, room, lack = last, spare, 0.5 * lack
        else:
            above, room, lack = last, 0.5 * room, -spare
        if 0 <= spare < close and not whole:
            break
    return found


def _followed(model: ThermalModel, now: Instant, limits: Limits, count: float, span: float) -> list[Instant]:
    """What follows at a count, looked at as often as ramp and mean current need, the end of `span` s last."""
    looks, course = math.ceil(span / LOOK - 1e-9) if count > now.calm else 1, [now]
    for _ in range(looks):
        state = advance(model, course[-1].state, count / COUNTS, span / looks)
        course.append(Instant.of(model, state, limits, count))
    return course[1:]


def most_count(model: ThermalModel, state: State, spec: HeatingSpec, rig: Rig) -> int:
    """Greatest count that keeps the ramp, less what is `spared`, and the mean current at a state."""
    return int(Instant.of(model, state, Limits(spec, rig)).most)


def kept_by_one(model: ThermalModel, spec: HeatingSpec, rig: Rig) -> Limits:
    """The limits, with the least ramp and mean current that one count keeps for a slot from rest where it breaks
    the limits: no count that heats breaks them by less."""
    kept = 1 - SPARED
    warms = count_warms(model, rig, spec)
    if warms > kept * spec.ramp:
        spec = replace(spec, ramp=(1 + 1e-6) * warms / kept)
    allowed = Instant.of(model, at_rest(model), Limits(spec, rig)).by_current
    if allowed < one_count(rig):
        limit = (1 + 1e-6) * rig.circuit.current_limit * one_count(rig) / allowed
        rig = replace(rig, circuit=replace(rig.circuit, current_limit=limit))
    return Limits(spec, rig)


def stops(model: ThermalModel, spec: HeatingSpec, rig: Rig, counts: Counts, states: Sequence[State]) -> list[str]:
    """(T,) what allows no count more from each of the states for a slot: "duty", "current" or "ramp"; "" where all
    allow one more."""
    found, limits = [], Limits(spec, rig)
    for count, state in zip((counts + 1).tolist(), states, strict=True):
        now = Instant.of(model, state, limits)
        course = [now, *_followed(model, now, limits, count, spec.slot)] if count <= COUNTS else []
        if not course:
            found.append("duty")
        elif min(at.by_current for at in course) < count:
            found.append("current")
        else:
            found.append("ramp" if min(at.most for at in course) < count else "")
    return found


def idle_rates(model: ThermalModel, state: State) -> tuple[Array, Array]:
    """Rates of warming of the cells outside of the clamps at no duty and at full duty, K/s."""
    idle, full, _ = warming_span(model, state.cells, state.lumped)
    free = model.resolution.grip
    return idle[0, free:], full[0, free:]


# --- the soonest schedule ---------------------------------------------------------------------------------------------


class Soonest(NamedTuple):
    """A schedule of the soonest hold."""

    counts: Counts
    """(T,) of heating and hold."""
    levels: Array
    """(T,) mean duties in their place."""
    start: float
    """Of the hold, s."""


def soonest(model: ThermalModel, spec: HeatingSpec, rig: Rig, reserve: float) -> Soonest | None:
    """The greatest counts that keep the limits until the window is reached, then the hold; None where it is not
    reached in time, or the coldest point warms ever slower and far too slowly for it.

    Args:
        model: one member. reserve: kept from the window's ends and the limit, K.
    """
    low, high = spec.window_degC[0] + reserve, min(spec.window_degC[1], spec.limit) - reserve
    counts, looked, limits = [], [], Limits(spec, rig)
    now = Instant.of(model, at_rest(model), limits)
    slots, apart = int(spec.longest_heating / spec.slot), max(round(STALL / spec.slot), 1)
    for k in range(slots):
        coldest = float(seen(model, now.state.cells[0, :, 0])[0])
        if coldest >= low:
            break
        if k % apart == 0:
            looked.append(coldest)
            if _stalls(looked, low, SOONER * (slots - k) / apart):
                return None
        now = _greatest(model, now, limits, float(int(now.most)), spec.slot, high)
        counts.append(int(now.count))
    else:
        return None
    held = _hold(model, spec, rig, now.state, high)
    heating = np.array(counts, dtype=np.int64)
    levels = np.concatenate([heating / COUNTS, held])
    return Soonest(np.concatenate([heating, sum_up_rounding(held)]), levels, spec.slot * len(heating))


def _stalls(seen: Sequence[float], goal: float, left: float) -> bool:
    """Whether temperatures at equal distances in time, which rise less and less, would not reach a goal by as many more
    rises as there are left, no smaller than the last one."""
    if len(seen) < 3:
        return False
    before, rise = seen[-2] - seen[-3], seen[-1] - seen[-2]
    return rise <= before and seen[-1] + left * rise < goal


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
    """What follows the greatest count, up to `most`, that keeps ramp and mean current, and every point below a
    temperature `target` (degC) after `span` s."""
    found = sustained(model, now, limits, most, span, whole=whole)
    if _hottest(found.state) <= target:
        return found
    count = COUNTS * _level(model, now.state, found.count / COUNTS, span, target)
    return sustained(model, now, limits, float(int(count + 1e-9)) if whole else count, span, whole=whole)


def _hold(model: ThermalModel, spec: HeatingSpec, rig: Rig, state: State, high: float) -> Array:
    """(H,) duties that bring the curved part to the middle of the window and keep it there."""
    middle = 0.5 * sum(spec.window_degC)
    together = max(round(DECIDED / spec.slot), 1)
    levels: list[float] = []
    while len(levels) < spec.hold_slots:
        span = together * spec.slot
        coldest = seen(model, state.cells[0, :, 0])[0]
        target = min(_centred(model, state, middle), high)
        most = most_count(model, state, spec, rig)
        # One count is left for what changes within the slots that share a duty, but the tube need not cool for it.
        for spared in (1, 0):
            level = _level(model, state, max(most - spared, 0) / COUNTS, span, target)
            after = advance(model, state, level, span)
            if level < (most - spared) / COUNTS or seen(model, after.cells[0, :, 0])[0] >= coldest:
                break
        levels += [level] * together
        state = after
    return np.array(levels[: spec.hold_slots])


def _centred(model: ThermalModel, state: State, middle: float) -> float:
    """Temperature of the hottest point, degC, with which the curved part spreads evenly about `middle`."""
    coldest, hottest, top = seen(model, state.cells[0, :, 0])
    # A bare part may be hotter than the curved one.
    return float(middle + 0.5 * (hottest - coldest) + top - hottest)


@dataclass(frozen=True, eq=False)
class Pace:
    """Mean duties, each for `span` s, the policy that chose them, and the states between them."""

    span: float
    levels: Array
    """(K,) in [0, 1]."""
    caps: Array
    """(K,) degC that no point may exceed after each of them."""
    centred: NDArray[np.bool_]
    """(K,) which of them spread the curved part evenly about the middle of the window, as far as the cap lets them."""
    states: tuple[State, ...]
    """K + 1, the first at the beginning."""

    def seen(self, model: ThermalModel) -> Array:
        """(3, K + 1) degC of the coldest and the hottest place of the curved part, and of the hottest point."""
        return np.array(seen(model, np.array([state.cells[0, :, 0] for state in self.states])))


def paced(
    model: ThermalModel,
    spec: HeatingSpec,
    rig: Rig,
    caps: Array,
    centred: NDArray[np.bool_],
    known: Pace,
) -> Pace:
    """The greatest duties within ramp and current that a policy, caps and whether to centre, allows.

    As far as the policy is that of a `known` pace, its states are taken over.
    """
    shared = min(len(caps), len(known.levels))
    other = np.flatnonzero((caps[:shared] != known.caps[:shared]) | (centred[:shared] != known.centred[:shared]))
    first, middle = int(other[0]) if len(other) else shared, 0.5 * sum(spec.window_degC)
    states, levels, limits = list(known.states[: first + 1]), known.levels[:first].tolist(), Limits(spec, rig)
    hopeless = kept_by_one(model, spec, rig) != limits
    now = Instant.of(model, states[-1], limits)
    for cap, centre in zip(caps[first:].tolist(), centred[first:].tolist(), strict=True):
        target = min(cap, _centred(model, now.state, middle)) if centre else cap
        # Counts that change within the span would break at the greater ones what their mean keeps.
        most = now.most if hopeless else float(int(now.most))
        now = _greatest(model, now, limits, most, known.span, target, whole=False)
        levels.append(now.count / COUNTS)
        states.append(now.state)
    return Pace(known.span, np.array(levels), caps, centred, tuple(states))


def would_centre(model: ThermalModel, spec: HeatingSpec, pace: Pace) -> NDArray[np.bool_]:
    """(K,) which duties of a pace would be less if the curved part spread evenly about the window's middle."""
    middle, tops = 0.5 * sum(spec.window_degC), pace.seen(model)[2, 1:]
    return np.array([_centred(model, state, middle) for state in pace.states[:-1]]) < tops


def _hottest(state: State) -> float:
    """Of any point of the tube, degC."""
    return float(state.cells[0, :, 0].max()) - ZERO_CELSIUS


def _level(model: ThermalModel, state: State, most: float, span: float, target: float) -> float:
    """Duty up to `most` with which the hottest point is at `target` (degC) after `span` s, or less."""
    less = max(most - PROBE / COUNTS, 0.0)
    top, bottom = (_hottest(advance(model, state, level, span)) for level in (most, less))
    if top <= target or most <= less:
        return most
    # The line through both duties: temperatures are nearly linear over a few counts.
    return max(less + (target - bottom) / (top - bottom) * (most - less), 0.0)
