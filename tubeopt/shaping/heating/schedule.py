"""Schedule of whole counts that satisfies every requirement, or has the smallest miss of the window.

For objective "time" the minimum-time counts are tried first. If these do not satisfy every requirement, and for other
objectives, the ideal schedule solves an optimal control problem on a coarse grid. It is rounded to whole counts and
simulated in steps of a tenth of a second on a grid with three times as many cells and shells. If that misses the
window, the bounds of the program are shifted by the difference between the two grids, and it is solved again (deferred
correction): the result holds on the fine grid. Counts never break the ramp where one count alone keeps it. If they fall
behind the ideal schedule for that, it is solved again with a larger reserve below the ramp. If one count alone exceeds
the ramp no schedule keeps it, and no program is solved: the search for the smallest miss takes the lowest ramp of a
count in its place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...constants import ZERO_CELSIUS
from ...robots.tubes import Tube
from ...typing import Array
from .counts import (
    MIN_INTERVAL,
    Counts,
    MinimumTime,
    Rollout,
    achievable_limits,
    guarded_counts,
    minimum_time_counts,
    ripple,
    rollout,
    would_centre,
)
from .optimal_control import NO_TERMS, CustomTerms
from .optimal_schedule import CustomRun, Ideal, Shift, custom_start, custom_values, planned_ramp, solve_ideal
from .outcome import MeshError, Outcome, count_breaks_limits, hold_slots, mesh_error, outcome_of
from .rig import COUNTS, Rig
from .simulation import History, at_rest, resimulate, simulate
from .spec import HeatingSpec
from .thermal import COARSE, FINE, ThermalModel, curved_temperatures, thermal_model

# --- mean duties with the smallest miss: search over the start and the temperature of the hold ------------------------


# At the lowest ramp of coarse counts, a second count must wait until the tube is hot. With 1.1 all windows are reached
# that 1.25 reaches.
COARSE_RAMPS = 1.0, 1.1
"""Ramps of coarse counts, as multiples of the lowest."""

# The default longest heating is 360 s: 800 starts keep its grid at 0.5 s. With half of them a hold begins 1.5 s later.
MAX_STARTS = 800
"""Number of possible start times of the hold, at least half a second apart."""

# In geometric steps up to 360 s, each is 2.1 times the one before. Half and twice change no plan.
BRANCHES = 9
"""Number of start times after which the curved part is centred about the middle of the window."""

# The reading of the thesis' tube settles with a time constant of 2.3 s, thick tubes in metal take longer. Half and
# twice change no plan.
SETTLING = 60.0
"""Longest time from the start of centring to the hold, s."""

# In longer holds the tube is no more even after a wait, but the mold is warmer.
SHORT_HOLD = 20.0
"""Longest hold that a colder wait before it may help, s."""

# After a colder wait the rise takes longer than the ends need to cool; a hotter wait is the hold.
WAIT_LEVELS = 0.6, 0.85
"""Temperatures of the wait above ambient, as fractions of the limit above ambient."""

# Geometric, from half of what one count changes in a slot to what the ramp of 20 K/s makes in two seconds.
RISES, RISE_TIME = (2.0, 5.0, 10.0, 20.0, 40.0), 5.0
"""Rises of the hottest point up to the limit, K, from so long before the hold (s) to its end."""

# Far below the 2.3 K of half a count in a slot. Half and twice change no plan.
SAME_MISS = 0.02
"""Difference below which misses are equal, K: the soonest hold is taken."""

# Each try corrects the error of the hottest point. In two missed plans one try suffices; half and twice change none.
CAP_TRIES = 4
"""Number of limits of the hottest point that are tried until its counts come to just below the limit."""

# Rounding adds up to half a count to a duty. With half of the reserve counts fall behind, and the plan of least energy
# begins its hold 9 s later; with twice the reserve 50 s later. "Margin" gets a whole count: with half of it the hold is
# up to 8 K colder, with twice it begins 117 s later.
RAMP_RESERVE, LARGE_RAMP_RESERVE = 0.75, 1.0
"""Reserve below the ramp, as the heating rate of so many counts; and the larger one, if counts fall behind with it."""

# Each round repeats the program with the difference of the grids. Two suffice in the six plans.
ROUNDS = 4
"""Number of solutions of the optimal control problem, each corrected by the difference of the grids."""

# The error after one trim is of second order. Half suffices in the six plans.
TRIMS = 8
"""Number of times that duties are scaled down until no point is above the limit."""

# The plan also shows how the tube cools in its mold, if it is not quenched.
COOLING = 10.0
"""Simulated time after the hold, the tube still in the mold, s."""

# As much as `RESERVE`. Half and twice change no plan.
SAME_SHIFT = 0.3
"""Change of the correction below which another round would change nothing, K."""

# The grids of the program and the result differ by less, so that a larger miss on one is a miss on the other. Half and
# twice change no plan.
HOPELESS = 5.0
"""Miss of the window after the first round that no correction repairs, K."""

# As `HOPELESS`, after a correction. Half and twice change no plan.
SETTLED = 2.0
"""Miss of the window by the corrected program that no further round repairs, K."""

# Above it counts decide whether the window is kept, and are computed in every round. Half and twice change no plan.
FINE_SWING = 0.5
"""Largest ripple by the rounding of duties for a sufficiently accurate estimate without counts, K."""

# In board 0.17 % of the rise, in glass mica 1.4 %. With half of it a plan at 8 K/s is 2 K hotter, with twice a hold
# begins half a second later.
FIRST_ERROR = 0.004
"""Mesh error before it is known, as a fraction of the rise in temperature."""

# Counts for other charges are rounded anew. Twice changes a window of 10 K by 0.1 K; half lets the plan keep it without
# a reserve for that.
RESERVE = 0.3
"""Distance from the window's ends in addition to rounding and mesh error, K."""


# Whole counts change values of the order of 1 by 2e-3 from round to round, and by 6e-3 between the points of the
# program. With a third, plans end with a miss of 3e-4.
CUSTOM_RESERVE = 1e-2
"""Reserve of custom requirements for whole counts, scaled."""


@dataclass(frozen=True, eq=False)
class NearestHold:
    """Mean duties until the end of the hold that miss the window least."""

    course: Rollout
    first: int
    """Index of the first duty of the hold."""
    miss: float
    """Miss of the window, K."""


def nearest_hold(tube: Tube, rig: Rig, spec: HeatingSpec) -> NearestHold:
    """Mean duties that miss the window least, over all starts and temperatures of the hold.

    More power never makes anything colder. So the policy heats as fast as ramp and currents allow, until the hottest
    point is at the limit; from some time on it centres the curved part about the middle of the window, as far as the
    limit allows; and it holds where the miss is smallest. All times are searched on a grid; then holds that rise to the
    limit, and short ones after a colder wait, in which the tube is more even.
    """
    (fine, coarse), swing = (thermal_model(tube, rig, grid) for grid in (FINE, COARSE)), ripple(tube, rig, spec)
    guess = FIRST_ERROR * (spec.limit + ZERO_CELSIUS - rig.ambient)
    nearest = search_hold(fine, rig, spec, spec.limit - guess - swing)
    # With these duties the mesh error is known.
    course = nearest.course
    runs = ((model, simulate(model, course.span, course.levels)) for model in (coarse, fine))
    error = mesh_error(next(runs), next(runs), replace(spec, slot=course.span), nearest.first * course.span)
    return with_raised_caps(fine, rig, spec, nearest, guess - error.hottest - RESERVE)


def with_raised_caps(
    model: ThermalModel, rig: Rig, spec: HeatingSpec, nearest: NearestHold, rise: float
) -> NearestHold:
    """Hold of the same policy with all caps raised, K."""
    course = nearest.course
    course = rollout(model, spec, rig, course.caps + rise, course.centred, no_duties(model, course.span))
    miss = float(misses(model, spec, course, len(course.levels) - nearest.first)[-1])
    return NearestHold(course, nearest.first, miss)


def no_duties(model: ThermalModel, span: float) -> Rollout:
    """Rollout before the first duty."""
    return Rollout(span, np.zeros(0), np.zeros(0), np.zeros(0, dtype=bool), (at_rest(model),))


def search_hold(model: ThermalModel, rig: Rig, spec: HeatingSpec, cap: float) -> NearestHold:
    """Mean duties that miss the window least with no point above `cap`, degC."""
    slots = int(spec.longest_heating / spec.slot)
    slots_per_duty = max(round(MIN_INTERVAL / spec.slot), math.ceil(slots / MAX_STARTS), 1)
    span = slots_per_duty * spec.slot
    longest, hold = slots // slots_per_duty, -(-spec.hold_slots // slots_per_duty)
    start, index = no_duties(model, span), np.arange(longest + hold)
    candidates: list[NearestHold] = []

    def try_policy(caps: Array, centred: NDArray[np.bool_], known: Rollout, earliest: int = 1) -> Rollout:
        """Add the best hold under a policy that starts at duty number `earliest` or later."""
        course = rollout(model, spec, rig, caps, centred, known)
        miss = misses(model, spec, course, hold)[: longest + 1]
        miss[:earliest] = np.inf
        # Among equal misses the soonest hold.
        first = int(np.argmax(miss <= miss.min() + SAME_MISS))
        candidates.append(NearestHold(course, first, float(miss[first])))
        return course

    # Always as hot as allowed.
    hottest = try_policy(np.full(len(index), cap), index < 0, start)
    # Centred from some time on.
    free = np.flatnonzero(would_centre(model, spec, hottest)[: longest + 1])
    if len(free):
        settle = round(SETTLING / span)
        spread = np.geomspace(1, longest + 1, BRANCHES).astype(int) - 1
        for k in sorted({int(free[0]), *(int(k) for k in spread if k >= free[0])}):
            until = k + settle + hold if k > free[0] else len(index)
            try_policy(hottest.caps[:until], index[:until] >= k, hottest, max(k, 1))
    # After a colder wait.
    if spec.hold_time <= SHORT_HOLD:
        T_amb = model.T_amb - ZERO_CELSIUS
        for level in WAIT_LEVELS:
            rise = math.ceil((1 - level) * (cap - T_amb) / spec.ramp / span)
            caps = np.where(index < longest - 2 * rise, T_amb + level * (cap - T_amb), cap)
            try_policy(caps, index < 0, start, max(longest - 2 * rise, 1))
    # The best of these, rising during the hold.
    best = min(candidates, key=lambda candidate: candidate.miss)
    course, last, before = best.course, best.first + hold, round(RISE_TIME / span)
    for rise_to_cap in RISES:
        below = np.clip((last - index[:last]) / hold, 0.0, 1.0) * rise_to_cap
        caps = course.caps[:last] - np.where(index[:last] >= best.first - before, below, 0.0)
        try_policy(caps, course.centred[:last], course, max(best.first - before, 1))
    best = min(candidates, key=lambda candidate: candidate.miss)
    course, last = best.course, best.first + hold
    until_end = Rollout(
        span, course.levels[:last], course.caps[:last], course.centred[:last], course.states[: last + 1]
    )
    return NearestHold(until_end, best.first, best.miss)


def misses(model: ThermalModel, spec: HeatingSpec, course: Rollout, hold: int) -> Array:
    """Miss of the window, K, for a hold of a number of duties that starts at each duty."""
    coldest, hottest, _ = np.lib.stride_tricks.sliding_window_view(course.extremes(model), hold + 1, axis=1)
    low, high = spec.window_degC
    return np.asarray(np.maximum(low - coldest.min(1), hottest.max(1) - high))


# --- schedules of whole counts ----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Run:
    """Mean duties and the simulation at them."""

    rig: Rig
    """Rig with clearance, lead and vents as chosen."""
    model: ThermalModel
    """Fine model of the rig."""
    levels: Array
    """(T,) mean duty of every slot."""
    history: History
    """Simulation of the mean duties."""
    error: MeshError
    """Error of the temperatures by the mesh."""
    start: float
    """Start of the hold, s."""


class WindowReserve(NamedTuple):
    """Distance from the window's ends that is reserved for rounding and mesh error, K."""

    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Programmed:
    """Solution of the optimal control problem behind a schedule."""

    ideal: Ideal
    shift: Shift | None
    """Temperature correction of the solve."""
    reserve: WindowReserve


@dataclass(frozen=True, eq=False)
class Schedule:
    """Schedule of whole counts, its simulation and outcome."""

    spec: HeatingSpec
    run: Run
    """Mean duties that the counts realise."""
    counts: Counts
    """(T,) count of every slot."""
    history: History
    """Simulation of the counts."""
    outcome: Outcome
    """Comparison with the requirements."""
    program: Programmed | None = None
    """Optimal control problem, if it was solved."""
    custom: Array = field(default_factory=lambda: np.zeros(0))
    """Values of custom requirements, scaled, which must be at least 0."""

    @property
    def feasible(self) -> bool:
        """True if every requirement is satisfied."""
        return self.outcome.feasible and not self.custom_miss

    @property
    def custom_miss(self) -> float:
        """Largest violation of custom requirements, scaled; 0 if all are satisfied."""
        return max(0.0, -float(self.custom.min(initial=0.0)))

    @property
    def breaks_limits(self) -> bool:
        """True if ramp or mean current exceed their limits; other counts may satisfy them."""
        outcome = self.outcome
        return outcome.steepest > self.spec.ramp or outcome.mean_current > self.run.rig.circuit.current_limit

    @property
    def violation(self) -> tuple[float, ...]:
        """Violation of the requirements, to be compared in order: hard limits before the window.

        Excess of ramp and mean current counts in steps of a quarter, since whole counts exceed them by chance.
        """
        outcome, circuit = self.outcome, self.run.rig.circuit
        excess = max(outcome.steepest / self.spec.ramp, outcome.mean_current / circuit.current_limit, 1.0)
        return len(outcome.broken), int(math.log(excess, 1.25)), outcome.excess > 0, self.custom_miss, outcome.shortfall


def checked(spec: HeatingSpec, run: Run, counts: Counts, program: Programmed | None = None) -> Schedule:
    """Schedule of counts that realise mean duties, simulated and compared with the requirements."""
    history = resimulate(run.model, spec.slot, counts / COUNTS)
    outcome = outcome_of(run.model, run.rig, spec, history, run.start, run.error)
    return Schedule(spec, run, counts, history, outcome, program)


def best_schedule(tube: Tube, rig: Rig, spec: HeatingSpec, custom: CustomTerms = NO_TERMS) -> Schedule:
    """Schedule that satisfies every requirement, or the one with the smallest miss of the window."""
    if custom is not NO_TERMS:
        # The other methods know nothing of custom requirements and objectives.
        return _corrected(tube, rig, spec, RAMP_RESERVE, rounds=ROUNDS, custom=custom)
    minimum_time, rig_given = spec.objective == "time", not spec.free
    if rig_given and count_breaks_limits(thermal_model(tube, rig, FINE), rig, spec):
        return _coarse_schedule(tube, rig, spec)
    if minimum_time and rig_given and (soonest := _minimum_time_schedule(tube, rig, spec)) is not None:
        return soonest
    # The largest distance from the window's ends needs counts that do not fall behind.
    ramp_reserve = LARGE_RAMP_RESERVE if spec.objective == "margin" else RAMP_RESERVE
    nearest, counted = (nearest_hold(tube, rig, spec) if rig_given else None), None
    hopeless = nearest is not None and nearest.miss > HOPELESS
    if nearest is not None and hopeless:
        # No program had a smaller miss than this search.
        counted = _nearest_schedule(tube, rig, spec, nearest, None)
        if not counted.breaks_limits and not counted.outcome.excess:
            return counted
    best = _corrected(tube, rig, spec, ramp_reserve, rounds=1 if hopeless else ROUNDS)
    if minimum_time and not rig_given and best.outcome.shortfall <= HOPELESS:
        soonest = _minimum_time_schedule(tube, best.run.rig, spec)
        if soonest is not None and not (best.feasible and soonest.run.start >= best.run.start):
            return soonest
    if best.feasible:
        return best
    ramps = [planned_ramp(tube, rig, spec, reserve) for reserve in (ramp_reserve, LARGE_RAMP_RESERVE)]
    if not hopeless and ramps[0] != ramps[1] and _fell_behind(best, spec):
        second = _corrected(tube, rig, spec, LARGE_RAMP_RESERVE, rounds=ROUNDS, start=best.program)
        best = min(best, second, key=lambda schedule: schedule.violation)
    if nearest is None and best.outcome.shortfall > 0:
        nearest = nearest_hold(tube, best.run.rig, spec)
    no_better = nearest is None or nearest.miss > best.outcome.shortfall
    if nearest is None or (no_better and not best.outcome.excess and not best.breaks_limits):
        return best
    counted = counted or _nearest_schedule(tube, best.run.rig, spec, nearest, best.program)
    return min(best, replace(counted, program=best.program), key=lambda schedule: schedule.violation)


def programmed(tube: Tube, rig: Rig, spec: HeatingSpec) -> Programmed:
    """Solution of the optimal control problem before any correction."""
    reserve = _first_reserve(tube, rig, spec)
    return Programmed(solve_ideal(tube, rig, spec, reserve=reserve, ramp_reserve=RAMP_RESERVE), None, reserve)


def _first_reserve(tube: Tube, rig: Rig, spec: HeatingSpec) -> WindowReserve:
    """Reserve before rounding and mesh error are known."""
    error = FIRST_ERROR * (spec.limit + ZERO_CELSIUS - rig.ambient)
    return WindowReserve(*2 * (ripple(tube, rig, spec) + error,))


def _minimum_time_schedule(tube: Tube, rig: Rig, spec: HeatingSpec) -> Schedule | None:
    """Minimum-time schedule; None if it violates a requirement."""
    fastest = _minimum_time(tube, rig, spec)
    if fastest is None:
        return None
    schedule = checked(spec, _run(tube, rig, spec, fastest.levels, fastest.start), fastest.counts)
    return schedule if schedule.feasible else None


def minimum_time_outcome(tube: Tube, rig: Rig, spec: HeatingSpec) -> Outcome | None:
    """Outcome of the minimum-time schedule; None if it misses the window."""
    fastest = _minimum_time(tube, rig, spec)
    return None if fastest is None else _outcome_of_counts(tube, rig, spec, fastest.counts, fastest.start)


def _minimum_time(tube: Tube, rig: Rig, spec: HeatingSpec) -> MinimumTime | None:
    """Minimum-time counts on the fine grid, with the cooling; None if they miss the window."""
    # Other charges are rounded anew: half a count is reserved for that.
    reserve, coarse = RESERVE + ripple(tube, rig, spec), thermal_model(tube, rig, COARSE)
    # The mesh error is that of the counts of a coarse grid.
    first = minimum_time_counts(coarse, spec, rig, reserve)
    if first is None:
        return None
    history, fine = simulate(coarse, spec.slot, first.levels), thermal_model(tube, rig, FINE)
    if _far(coarse, spec, history, first.start):
        return None
    error = mesh_error((coarse, history), (fine, simulate(fine, spec.slot, first.levels)), spec, first.start)
    fastest = minimum_time_counts(fine, spec, rig, error.largest + reserve)
    if fastest is None:
        return None
    cooling = np.zeros(math.ceil(COOLING / spec.slot))
    counts = np.concatenate([fastest.counts, cooling.astype(np.int64)])
    return MinimumTime(counts, np.concatenate([fastest.levels, cooling]), fastest.start)


# --- the smallest miss ------------------------------------------------------------------------------------------------


def _nearest_schedule(
    tube: Tube, rig: Rig, spec: HeatingSpec, nearest: NearestHold, program: Programmed | None
) -> Schedule:
    """Schedule of whole counts that brings the hottest point just below the limit."""
    model, best = thermal_model(tube, rig, FINE), None
    for _ in range(CAP_TRIES):
        course, first = nearest.course, nearest.first
        slots_per_duty = round(course.span / spec.slot)
        heated = np.repeat(course.levels, slots_per_duty)[: first * slots_per_duty + spec.hold_slots]
        levels = np.append(heated, np.zeros(math.ceil(COOLING / spec.slot)))
        schedule = _guarded(tube, spec, _run(tube, rig, spec, levels, first * course.span), 1.0, program)
        best = schedule if best is None else min(best, schedule, key=lambda each: each.violation)
        margin = spec.limit - schedule.outcome.hottest - schedule.outcome.mesh.hottest
        reached_cap = float(course.extremes(model)[2].max()) > course.caps.max() - SAME_SHIFT
        if 0 <= margin <= 4 * RESERVE or (margin > 0 and not reached_cap):
            break
        nearest = with_raised_caps(model, rig, spec, nearest, margin - RESERVE)
    assert best is not None
    return best


def _coarse_schedule(tube: Tube, rig: Rig, spec: HeatingSpec) -> Schedule:
    """Schedule for a rig with a count that exceeds ramp or mean current: at the lowest limits that its counts keep.

    A larger ramp is tried where the window is missed, and taken where that halves the miss.
    """
    lowest = achievable_limits(thermal_model(tube, rig, FINE), spec, rig)
    best: Schedule | None = None
    for factor in COARSE_RAMPS:
        eased = replace(lowest.spec, ramp=factor * lowest.spec.ramp)
        nearest = nearest_hold(tube, lowest.rig, eased)
        found = _nearest_schedule(tube, lowest.rig, eased, nearest, None)
        schedule = checked(spec, replace(found.run, rig=rig), found.counts)
        if best is None or schedule.outcome.shortfall < 0.5 * best.outcome.shortfall:
            best = schedule
        if best.outcome.shortfall <= 0:
            break
    assert best is not None
    return best


def _far(model: ThermalModel, spec: HeatingSpec, history: History, start: float) -> bool:
    """True if the window is missed by so much that a finer grid would not change that."""
    (low, high), (first, last) = spec.window_degC, hold_slots(spec, start)
    hold = curved_temperatures(model, history.tube[first : last + 1, 0]) - ZERO_CELSIUS
    return bool(max(low - hold.min(), hold.max() - high) > HOPELESS)


def _run(tube: Tube, rig: Rig, spec: HeatingSpec, levels: Array, start: float) -> Run:
    """Simulation of mean duties with a hold that starts at `start`, s."""
    models = (thermal_model(tube, rig, grid) for grid in (FINE, COARSE))
    fine, coarse = ((model, simulate(model, spec.slot, levels)) for model in models)
    return Run(rig, fine[0], levels, fine[1], mesh_error(coarse, fine, spec, start), start)


def _fell_behind(schedule: Schedule, spec: HeatingSpec) -> bool:
    """True if the counts omitted because of the ramp may cause the miss."""
    run = schedule.run
    start = round(run.start / spec.slot)
    lag = curved_temperatures(run.model, run.history.tube[start, 0] - schedule.history.tube[start, 0])
    return 0 < schedule.outcome.shortfall < float(lag.max()) + HOPELESS


def _corrected(
    tube: Tube,
    rig: Rig,
    spec: HeatingSpec,
    ramp_reserve: float,
    *,
    rounds: int,
    custom: CustomTerms = NO_TERMS,
    start: Programmed | None = None,
) -> Schedule:
    """Schedule of the optimal control problem after deferred correction, in at most so many rounds.

    `start` is an earlier solution with its correction.
    """
    swing = ripple(tube, rig, spec)
    ideal: Ideal | None = None
    shift: Shift | None = None
    best: Schedule | None = None
    reserve = _first_reserve(tube, rig, spec)
    if start is not None:
        ideal, shift, reserve = start.ideal, start.shift, start.reserve
    if custom.requirements:
        # With the correction at a start the first solution needs little more.
        ideal = custom_start(tube, rig, spec, custom)
        shift = _shift_at(ideal, tube, spec, custom)
    for round_ in range(rounds):
        # The rig is chosen in the first round: a correction belongs to the rig on which it was computed.
        on, task = (ideal.rig, replace(spec, free=())) if ideal is not None and round_ else (rig, spec)
        ideal = solve_ideal(
            tube, on, task, reserve=reserve, ramp_reserve=ramp_reserve, shift=shift, guess=ideal, custom=custom
        )
        duties = commanded_duties(ideal_duties(ideal, spec), ideal.rig)
        run = _run(tube, ideal.rig, spec, duties, hold_start(ideal, spec))
        rounding, schedule = WindowReserve(swing, 4 * swing), None
        # No counts repair a large miss of the mean duties: none are computed before the correction, which may.
        if round_ or rounds == 1 or custom.requirements or swing > FINE_SWING or not _hopeless(ideal, run, spec):
            schedule = _guarded(tube, spec, run, 1.0, Programmed(ideal, shift, reserve))
            if custom.requirements:
                schedule = replace(schedule, custom=_custom_values_of(schedule, tube, ideal, custom))
            # The margin is that of the fine grid only after a correction.
            if best is None or spec.objective == "margin" or _no_worse(schedule, best):
                best = schedule
            if schedule.outcome.shortfall <= 0 and not schedule.custom_miss and (spec.objective != "margin" or round_):
                break
            if ideal.miss > (SETTLED if round_ else 10 * HOPELESS):
                break
            rounding = _rounding_loss(schedule, spec)
        values = ideal.custom if schedule is None else schedule.custom
        if custom.requirements and schedule is not None:
            # Whole counts differ from round to round: the worst difference so far is corrected, and a little more.
            values = values - CUSTOM_RESERVE
            if round_ and shift is not None:
                values = np.minimum(values, ideal.custom + shift.custom)
        slots = heated_slots(ideal, spec)
        previous, shift = shift, Shift.between(ideal, tube, run.model, run.history, slots, values)
        settled = schedule is None or not schedule.custom_miss
        if previous is not None and settled and np.abs(previous.hold - shift.hold).max() < SAME_SHIFT:
            break
        reserve = WindowReserve(*(loss + run.error.largest + RESERVE for loss in rounding))
    assert best is not None
    # Scale duties down until no point is above the limit, less the mesh error.
    scale = 1.0
    for _ in range(TRIMS):
        excess = best.outcome.excess
        if excess <= 0:
            break
        # Temperatures rise nearly in proportion to the duty.
        scale *= 1 - (excess + RESERVE) / (spec.limit + ZERO_CELSIUS - best.run.model.T_amb)
        best = replace(_guarded(tube, spec, best.run, scale, best.program), custom=best.custom)
    return best


def _shift_at(ideal: Ideal, tube: Tube, spec: HeatingSpec, custom: CustomTerms) -> Shift:
    """Correction of the program by the simulation of an ideal schedule without counts."""
    duties = commanded_duties(ideal_duties(ideal, spec), ideal.rig)
    start = hold_start(ideal, spec)
    run = _run(tube, ideal.rig, spec, duties, start)
    values = custom_values(tube, spec, ideal, custom, CustomRun(run.model, run.history, duties, start))
    return Shift.between(ideal, tube, run.model, run.history, heated_slots(ideal, spec), values - CUSTOM_RESERVE)


def _custom_values_of(schedule: Schedule, tube: Tube, ideal: Ideal, custom: CustomTerms) -> Array:
    """Values of custom requirements under the counts of a schedule."""
    run = CustomRun(schedule.run.model, schedule.history, schedule.counts / COUNTS, schedule.run.start)
    return custom_values(tube, schedule.spec, ideal, custom, run)


def _no_worse(schedule: Schedule, best: Schedule) -> bool:
    """True if a schedule misses the user's requirements and the window by no more than the best one."""
    return (schedule.custom_miss, schedule.outcome.shortfall) <= (best.custom_miss, best.outcome.shortfall)


def _guarded(tube: Tube, spec: HeatingSpec, run: Run, scale: float, program: Programmed | None) -> Schedule:
    """Schedule of counts that realise mean duties, times a scale."""
    levels = scale * run.levels
    schedule = checked(spec, run, guarded_counts(run.model, spec, run.rig, levels), program)
    if not schedule.breaks_limits or schedule.outcome.shortfall <= 0:
        return schedule
    # Limits that one count breaks already are exceeded by more only if that reduces the miss much.
    hurried = checked(spec, run, guarded_counts(run.model, spec, run.rig, levels, hurried=True), program)
    return hurried if hurried.outcome.shortfall < schedule.outcome.shortfall - HOPELESS else schedule


def _hopeless(ideal: Ideal, run: Run, spec: HeatingSpec) -> bool:
    """True if the miss of the window is too large for a correction."""
    hottest = float(run.history.tube.max()) - ZERO_CELSIUS + run.error.hottest
    correctable = ideal.miss <= 10 * HOPELESS or hottest > spec.limit
    return ideal.miss > HOPELESS and correctable and _far(run.model, spec, run.history, run.start)


def realised_outcome(tube: Tube, spec: HeatingSpec, ideal: Ideal) -> Outcome:
    """Outcome of whole counts that realise an ideal schedule."""
    fine, duties = thermal_model(tube, ideal.rig, FINE), commanded_duties(ideal_duties(ideal, spec), ideal.rig)
    counts = guarded_counts(fine, spec, ideal.rig, duties, hurried=True)
    return _outcome_of_counts(tube, ideal.rig, spec, counts, hold_start(ideal, spec))


def realised_schedule(tube: Tube, spec: HeatingSpec, ideal: Ideal) -> Schedule:
    """Schedule of whole counts that realise an ideal schedule, without any correction."""
    duties = commanded_duties(ideal_duties(ideal, spec), ideal.rig)
    return _guarded(tube, spec, _run(tube, ideal.rig, spec, duties, hold_start(ideal, spec)), 1.0, None)


def _outcome_of_counts(tube: Tube, rig: Rig, spec: HeatingSpec, counts: Counts, start: float) -> Outcome:
    """Outcome of PWM counts with a hold that starts at `start`, s, and the mesh error of this simulation."""
    fine, coarse = (thermal_model(tube, rig, grid) for grid in (FINE, COARSE))
    history = resimulate(fine, spec.slot, counts / COUNTS)
    error = mesh_error((coarse, simulate(coarse, spec.slot, counts / COUNTS)), (fine, history), spec, start)
    return outcome_of(fine, rig, spec, history, start, error)


def ideal_duties(ideal: Ideal, spec: HeatingSpec) -> Array:
    """(T,) ideal mean duty in every slot: heating, hold, and 0 while the tube cools in the mold."""
    levels = ideal.duty(spec.slot, heated_slots(ideal, spec))
    return np.concatenate([levels, np.zeros(math.ceil(COOLING / spec.slot))])


def commanded_duties(duty: Array, rig: Rig) -> Array:
    """Duties of the switch for effective duties: the part of each pulse that inductance absorbs is added."""
    return np.where(duty > 0, np.minimum(duty + rig.circuit.lost_share, 1.0), 0.0)


def heated_slots(ideal: Ideal, spec: HeatingSpec) -> int:
    """Number of slots of heating and hold."""
    return round(hold_start(ideal, spec) / spec.slot) + spec.hold_slots


def hold_start(ideal: Ideal, spec: HeatingSpec) -> float:
    """Start of the first slot of the hold, s."""
    return spec.slot * math.ceil(ideal.heating / spec.slot - 1e-9)


def _rounding_loss(schedule: Schedule, spec: HeatingSpec) -> WindowReserve:
    """Reserves at both ends of the window for rounding, K: at the low end in the hold, at the high end always."""
    run = schedule.run
    first, last = hold_slots(spec, run.start)
    change = schedule.history.tube[:, 0] - run.history.tube[:, 0]
    low = -float(change[first : last + 1][:, run.model.curved].min())
    return WindowReserve(max(low, 0.0), max(float(change.max()), 0.0))
