"""The schedule of whole counts that keeps everything, or misses the window by least.

Where the soonest hold is asked for, the greatest counts that keep the limits come first (`soonest`). Where these do not
keep everything, or something else is asked for, the ideal schedule solves an optimal control problem on a coarse
grid. It is rounded to whole counts and simulated in steps of a tenth of a second on a grid of three times as many cells
and shells. Where that misses the window, the program's bounds are shifted by the difference between the two grids, and
it is solved again (deferred correction): what holds in the end holds on the fine grid, for the schedule that is
returned. Counts never break the ramp where one count alone keeps it; where they fall behind the ideal schedule for
that, it is solved again with more room below the ramp.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...constants import ZERO_CELSIUS
from ...robots.tubes import Tube
from ...typing import Array
from .counts import DECIDED, Counts, Pace, Soonest, guarded_counts, paced, ripple, soonest, would_centre
from .optimal_schedule import Ideal, Shift, planned_ramp, solve_ideal
from .outcome import MeshError, Outcome, hold_slots, mesh_error, outcome_of
from .rig import COUNTS, Rig
from .simulation import History, at_rest, resimulate, simulate
from .spec import HeatingSpec
from .thermal import COARSE, FINE, ThermalModel, joined, thermal_model

# --- the hold that misses a window by least, by mean duties: searched over when it is, and how hot --------------------


# The default longest heating is 360 s: 800 places keep its grid at 0.5 s. With half of them a hold begins 1.5 s later.
PLACES = 800
"""Times at which the hold may begin, at least half a second apart."""

# In geometric steps up to 360 s, each is 2.1 times the one before. Half and twice change no plan.
BRANCHES = 9
"""Times from which on the curved part is brought to the window's middle."""

# The reading of the thesis' tube settles with a time constant of 2.3 s, thick tubes in metal take longer. Half and
# twice change no plan.
SETTLING = 60.0
"""Time after which such a hold begins at the latest, s."""

# In longer holds the tube is no more even after a wait, but the mold is warmer.
BURST = 20.0
"""Length of a hold up to which a colder wait before it may pay, s."""

# From a wait below the first, the rise takes longer than the ends need to cool; a wait above the second is the hold.
WAITS = 0.6, 0.85
"""Temperatures of the wait, as shares of the limit's rise over ambient."""

# Geometric, from half of what one count changes in a slot to what the ramp of 20 K/s makes in two seconds.
RISES, BEFORE = (2.0, 5.0, 10.0, 20.0, 40.0), 5.0
"""By how much the hold begins below the limit, to which it rises, K; and how long before the hold, s."""

# Far below the 2.3 K of half a count in a slot. Half and twice change no plan.
SAME_MISS = 0.02
"""Misses that differ by less are equal, K: the soonest is taken."""

# Each try moves the hottest point by what it was off. In two missed plans one try suffices; half and twice change none.
CAPS = 4
"""Limits of the hottest point that are tried until its counts come to just below the limit."""

# Rounding adds up to half a count to a duty. With half of the room counts fall behind, and the plan of least energy
# begins its hold 9 s later; with twice the room 50 s later. "Margin" gets a whole count: with half of it the hold is up
# to 8 K colder, with twice it begins 117 s later.
ROOM, MORE_ROOM = 0.75, 1.0
"""Reserve below the ramp, as the warming by so many counts; and the larger one, if counts fall behind with it."""

# Each round repeats the program with the difference of the grids. Two suffice in the six plans.
ROUNDS = 4
"""Rounds of the optimal control problem; each is corrected by the difference of its grid from the fine one."""

# What one trim leaves is of second order. Half suffices in the six plans.
TRIMS = 8
"""How often duties are scaled down until no point is above the limit."""

# The plan also says how the tube cools in its mold, if it is not quenched.
COOLING = 10.0
"""Simulated time after the hold, the tube still in the mold, s."""

# As much as `RESERVE`. Half and twice change no plan.
SAME_SHIFT = 0.3
"""Change of the correction below which another round would change nothing, K."""

# The grids of the program and the result differ by less, so that what misses by more on one misses on the other. Half
# and twice change no plan.
HOPELESS = 5.0
"""Miss of the window after the first round that no correction repairs, K."""

# As `HOPELESS`, after a correction. Half and twice change no plan.
SETTLED = 2.0
"""Miss of the window by the corrected program that no further round repairs, K."""

# Above it counts decide whether the window is kept, and are made in every round. Half and twice change no plan.
FINE_SWING = 0.5
"""Largest ripple by the rounding of duties with which the estimate without counts is accurate enough, K."""

# In board 0.17 % of the rise, in glass mica 1.4 %. With half of it a plan at 8 K/s is 2 K hotter, with twice a hold
# begins half a second later.
FIRST_ERROR = 0.004
"""Mesh error before it is known, as a fraction of the rise in temperature."""

# Counts for other charges are rounded anew. Twice changes a window of 10 K by 0.1 K; half lets the plan keep it, with
# nothing to spare for that.
RESERVE = 0.3
"""Kept from the window's ends beyond rounding and mesh error, K."""


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
    guess = FIRST_ERROR * (spec.limit + ZERO_CELSIUS - rig.ambient)
    found = placed(model, rig, spec, spec.limit - guess - swing)
    # What the mesh adds is known of these duties.
    runs = ((m, simulate(m, found.pace.span, found.pace.levels)) for m in (rough, model))
    start = found.first * found.pace.span
    error = mesh_error(next(runs), next(runs), replace(spec, slot=found.pace.span), start)
    return capped(model, rig, spec, found, guess - error.hottest - RESERVE)


def capped(model: ThermalModel, rig: Rig, spec: HeatingSpec, found: Nearest, higher: float) -> Nearest:
    """The same policy with caps that are so much `higher`, K."""
    caps = found.pace.caps + higher
    pace = paced(model, spec, rig, caps, found.pace.centred, at_start(model, found.pace.span))
    return Nearest(pace, found.first, float(missed_by(model, spec, pace, len(pace.levels) - found.first)[-1]))


def at_start(model: ThermalModel, span: float) -> Pace:
    """Before the first duty."""
    return Pace(span, np.zeros(0), np.zeros(0), np.zeros(0, dtype=bool), (at_rest(model),))


def placed(model: ThermalModel, rig: Rig, spec: HeatingSpec, cap: float) -> Nearest:
    """The mean duties with which no point is hotter than `cap`, degC, that miss the window by least."""
    slots = int(spec.longest_heating / spec.slot)
    each = max(round(DECIDED / spec.slot), math.ceil(slots / PLACES), 1)
    span, longest, hold = each * spec.slot, slots // each, -(-spec.hold_slots // each)
    rest, places = at_start(model, span), np.arange(longest + hold)
    tried: list[tuple[float, int, Pace]] = []

    def follow(caps: Array, centred: NDArray[np.bool_], known: Pace, least: int = 1) -> Pace:
        pace = paced(model, spec, rig, caps, centred, known)
        missed = missed_by(model, spec, pace, hold)[: longest + 1]
        missed[:least] = np.inf
        # The soonest of those that are as good.
        first = int(np.argmax(missed <= missed.min() + SAME_MISS))
        tried.append((float(missed[first]), first, pace))
        return pace

    hottest = follow(np.full(len(places), cap), places < 0, rest)
    free = np.flatnonzero(would_centre(model, spec, hottest)[: longest + 1])
    if len(free):
        settle = round(SETTLING / span)
        spread = np.geomspace(1, longest + 1, BRANCHES).astype(int) - 1
        for at in sorted({int(free[0]), *(int(at) for at in spread if at >= free[0])}):
            until = at + settle + hold if at > free[0] else len(places)
            follow(hottest.caps[:until], places[:until] >= at, hottest, max(at, 1))
    if spec.hold_time <= BURST:
        ambient = model.ambient - ZERO_CELSIUS
        for share in WAITS:
            rise = math.ceil((1 - share) * (cap - ambient) / spec.ramp / span)
            waiting = places < longest - 2 * rise
            follow(
                np.where(waiting, ambient + share * (cap - ambient), cap), places < 0, rest, max(longest - 2 * rise, 1)
            )
    _, first, pace = min(tried, key=lambda one: one[0])
    last, before = first + hold, round(BEFORE / span)
    for lower in RISES:
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


# --- schedules of whole counts ----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Run:
    """Mean duties, and what they do."""

    rig: Rig
    """With clearance, lead and vents as chosen."""
    model: ThermalModel
    """Its fine one."""
    levels: Array
    """(T,) mean duties in every slot."""
    exact: History
    """What they do."""
    error: MeshError
    """Of the mesh."""
    start: float
    """Of the hold, s."""


@dataclass(frozen=True, eq=False)
class Programmed:
    """What the program said of a schedule."""

    ideal: Ideal
    """Its answer."""
    shift: Shift | None
    """Of its temperatures, by which it was corrected."""
    reserve: tuple[float, float]
    """Kept from the window's ends, K."""


@dataclass(frozen=True, eq=False)
class Schedule:
    """A schedule: mean duties, the counts in their place, what these do, and what is kept."""

    spec: HeatingSpec
    """What was asked for."""
    run: Run
    """Of the mean duties."""
    counts: Counts
    """(T,) in their place."""
    checked: History
    """What they do."""
    outcome: Outcome
    """What is kept."""
    program: Programmed | None = None
    """What the program said of it, where it was asked."""

    @property
    def kept(self) -> bool:
        """Whether everything is."""
        return self.outcome.kept

    @property
    def breaks(self) -> bool:
        """Whether ramp or mean current are beyond their limits, which other counts may keep."""
        outcome = self.outcome
        return outcome.steepest > self.spec.ramp or outcome.mean_current > self.run.rig.circuit.current_limit


def checked(spec: HeatingSpec, run: Run, counts: Counts, program: Programmed | None = None) -> Schedule:
    """What counts in the place of mean duties do, and what is kept."""
    done = resimulate(run.model, spec.slot, counts / COUNTS)
    return Schedule(spec, run, counts, done, outcome_of(run.model, run.rig, spec, done, run.start, run.error), program)


def best_schedule(tube: Tube, rig: Rig, spec: HeatingSpec) -> Schedule:
    """The schedule that keeps everything, or the one that misses the window by least."""
    room, more = ROOM, MORE_ROOM
    hasty, fixed = spec.objective == "time", not spec.free
    if hasty and fixed and (sooner := _hastened(tube, rig, spec)) is not None:
        return sooner
    # Nothing is farther from the window's ends than what does not fall behind.
    first = more if spec.objective == "margin" else room
    nearest = nearest_hold(tube, rig, spec) if hasty and fixed else None
    far, counted = nearest is not None and nearest.missed > HOPELESS, None
    if nearest is not None and far:
        # No program missed by less than this search where one count alone keeps the limits.
        counted = _counted(tube, rig, spec, nearest, None)
        if not counted.breaks and not counted.outcome.excess:
            return counted
    found = _corrected(tube, rig, spec, first, rounds=1 if far else ROUNDS)
    if hasty and not fixed and found.outcome.shortfall <= HOPELESS:
        sooner = _hastened(tube, found.run.rig, spec)
        if sooner is not None and not (found.kept and sooner.run.start >= found.run.start):
            return sooner
    if found.kept:
        return found
    same = planned_ramp(tube, rig, spec, first) == planned_ramp(tube, rig, spec, more)
    if not (far or same) and _behind(found, spec):
        found = min(found, _corrected(tube, rig, spec, more, rounds=ROUNDS), key=_missing)
    if nearest is None and found.outcome.shortfall > 0:
        nearest = nearest_hold(tube, found.run.rig, spec)
    hopeless = nearest is None or nearest.missed > found.outcome.shortfall
    if nearest is None or (hopeless and not found.outcome.excess and not found.breaks):
        return found
    counted = counted or _counted(tube, found.run.rig, spec, nearest, found.program)
    return min(found, replace(counted, program=found.program), key=_missing)


def programmed(tube: Tube, rig: Rig, spec: HeatingSpec) -> Programmed:
    """What the program says of a schedule before any correction."""
    reserve = _first_reserve(tube, rig, spec)
    return Programmed(solve_ideal(tube, rig, spec, reserve=reserve, room=ROOM), None, reserve)


def _first_reserve(tube: Tube, rig: Rig, spec: HeatingSpec) -> tuple[float, float]:
    """What is kept from the window's ends before rounding and mesh error are known, K."""
    error = FIRST_ERROR * (spec.limit + ZERO_CELSIUS - rig.ambient)
    return 2 * (ripple(tube, rig, spec) + error,)


def _missing(found: Schedule) -> tuple[int, int, bool, float]:
    """How far a schedule is from keeping everything: what must not be comes before the window, limits of ramp and mean
    current in steps of a quarter, since whole counts break them by chance."""
    outcome, circuit = found.outcome, found.run.rig.circuit
    beyond = max(outcome.steepest / found.spec.ramp, outcome.mean_current / circuit.current_limit, 1.0)
    return len(outcome.broken), int(math.log(beyond, 1.25)), outcome.excess > 0, outcome.shortfall


def _hastened(tube: Tube, rig: Rig, spec: HeatingSpec) -> Schedule | None:
    """The soonest schedule of whole counts; None where it does not keep everything."""
    answer = _soonest(tube, rig, spec)
    if answer is None:
        return None
    found = checked(spec, _run(tube, rig, spec, answer.levels, answer.start), answer.counts)
    return found if found.kept else None


def foreseen(tube: Tube, rig: Rig, spec: HeatingSpec) -> Outcome | None:
    """What the soonest schedule of whole counts keeps; None where it misses the window."""
    answer = _soonest(tube, rig, spec)
    return None if answer is None else _outcome(tube, rig, spec, answer.counts, answer.start)


def _soonest(tube: Tube, rig: Rig, spec: HeatingSpec) -> Soonest | None:
    """The soonest schedule on the fine grid, with its cooling; None where it misses the window."""
    # Other charges are rounded anew: half a count is left for that.
    least, model = RESERVE + ripple(tube, rig, spec), thermal_model(tube, rig, COARSE)
    # What the mesh adds is told by the same on a coarse one.
    rough = soonest(model, spec, rig, least)
    if rough is None:
        return None
    coarse, fine = simulate(model, spec.slot, rough.levels), thermal_model(tube, rig, FINE)
    if _far(model, spec, coarse, rough.start):
        return None
    error = mesh_error((model, coarse), (fine, simulate(fine, spec.slot, rough.levels)), spec, rough.start)
    answer = soonest(fine, spec, rig, error.most + least)
    if answer is None:
        return None
    cooling = np.zeros(math.ceil(COOLING / spec.slot))
    counts = np.concatenate([answer.counts, cooling.astype(np.int64)])
    return Soonest(counts, np.concatenate([answer.levels, cooling]), answer.start)


# --- the least miss ---------------------------------------------------------------------------------------------------


def _counted(tube: Tube, rig: Rig, spec: HeatingSpec, nearest: Nearest, program: Programmed | None) -> Schedule:
    """The schedule of whole counts in the place of mean duties, whose hottest point comes to just below the limit."""
    model, best = thermal_model(tube, rig, FINE), None
    for _ in range(CAPS):
        pace, first = nearest.pace, nearest.first
        each = round(pace.span / spec.slot)
        heated = np.repeat(pace.levels, each)[: first * each + spec.hold_slots]
        levels = np.append(heated, np.zeros(math.ceil(COOLING / spec.slot)))
        found = _guarded(tube, spec, _run(tube, rig, spec, levels, first * pace.span), 1.0, program)
        best = found if best is None else min(best, found, key=_missing)
        spare = spec.limit - found.outcome.hottest - found.outcome.mesh.hottest
        reached = float(pace.seen(model)[2].max()) > pace.caps.max() - SAME_SHIFT
        if 0 <= spare <= 4 * RESERVE or (spare > 0 and not reached):
            break
        nearest = capped(model, rig, spec, nearest, spare - RESERVE)
    assert best is not None
    return best


def _far(model: ThermalModel, spec: HeatingSpec, history: History, start: float) -> bool:
    """Whether the window is missed by so much that no grid would change it."""
    (low, high), (first, last) = spec.window_degC, hold_slots(spec, start)
    held = joined(model, history.tube[first : last + 1, 0]) - ZERO_CELSIUS
    return bool(max(low - held.min(), held.max() - high) > HOPELESS)


def _run(tube: Tube, rig: Rig, spec: HeatingSpec, levels: Array, start: float) -> Run:
    """What mean duties do where the hold begins at `start`, s."""
    fine, coarse = ((m, simulate(m, spec.slot, levels)) for m in (thermal_model(tube, rig, g) for g in (FINE, COARSE)))
    return Run(rig, fine[0], levels, fine[1], mesh_error(coarse, fine, spec, start), start)


def _behind(found: Schedule, spec: HeatingSpec) -> bool:
    """Whether the counts, held back for the sake of the ramp, cost what the window is missed by."""
    run = found.run
    start = round(run.start / spec.slot)
    lag = joined(run.model, run.exact.tube[start, 0] - found.checked.tube[start, 0])
    return 0 < found.outcome.shortfall < float(lag.max()) + HOPELESS


def _corrected(tube: Tube, rig: Rig, spec: HeatingSpec, room: float, *, rounds: int) -> Schedule:
    """The schedule after as many corrections as it takes, in so many rounds at most, with `room` below the ramp."""
    swing = ripple(tube, rig, spec)
    reserve = _first_reserve(tube, rig, spec)
    ideal: Ideal | None = None
    shift: Shift | None = None
    best: Schedule | None = None
    for round_ in range(rounds):
        # What may be chosen of the rig is chosen once: a correction belongs to the rig that it was found on.
        on, asked = (rig, spec) if ideal is None else (ideal.rig, replace(spec, free=()))
        ideal = solve_ideal(tube, on, asked, reserve=reserve, room=room, shift=shift, guess=ideal)
        run = _run(tube, ideal.rig, spec, commanded(slots(ideal, spec), ideal.rig), hold_start(ideal, spec))
        lost = (swing, 4 * swing)
        # No counts keep what mean duties miss by far: before the correction, which may keep the limit, none are asked.
        if round_ or rounds == 1 or swing > FINE_SWING or not _hopeless(ideal, run, spec):
            found = _guarded(tube, spec, run, 1.0, Programmed(ideal, shift, reserve))
            # The margin is that of the fine grid only after a correction.
            if best is None or spec.objective == "margin" or found.outcome.shortfall <= best.outcome.shortfall:
                best = found
            if found.outcome.shortfall <= 0 and (spec.objective != "margin" or round_):
                break
            if ideal.miss > (SETTLED if round_ else 10 * HOPELESS):
                break
            lost = _rounded(found, spec)
        before, shift = shift, Shift.between(ideal, tube, run.model, run.exact, slots_on(ideal, spec))
        if before is not None and before.near(shift, SAME_SHIFT):
            break
        reserve = (lost[0] + run.error.most + RESERVE, lost[1] + run.error.most + RESERVE)
    assert best is not None
    return _trimmed(tube, spec, best)


def _guarded(tube: Tube, spec: HeatingSpec, run: Run, scale: float, program: Programmed | None) -> Schedule:
    """The schedule of counts in the place of mean duties, times a scale."""
    levels = scale * run.levels
    found = checked(spec, run, guarded_counts(run.model, spec, run.rig, levels), program)
    if not found.breaks or found.outcome.shortfall <= 0:
        return found
    # Limits that one count breaks already are broken by more only where that keeps much more of the window.
    hurried = checked(spec, run, guarded_counts(run.model, spec, run.rig, levels, hurried=True), program)
    return hurried if hurried.outcome.shortfall < found.outcome.shortfall - HOPELESS else found


def _hopeless(ideal: Ideal, run: Run, spec: HeatingSpec) -> bool:
    """Whether the window is missed by far, but by so little, or with so hot a point, that a correction changes much."""
    hottest = float(run.exact.tube.max()) - ZERO_CELSIUS + run.error.hottest
    corrigible = ideal.miss <= 10 * HOPELESS or hottest > spec.limit
    return ideal.miss > HOPELESS and corrigible and _far(run.model, spec, run.exact, run.start)


def realised(tube: Tube, spec: HeatingSpec, ideal: Ideal) -> Outcome:
    """What whole counts in the place of an ideal schedule keep."""
    fine, levels = thermal_model(tube, ideal.rig, FINE), slots(ideal, spec)
    counts = guarded_counts(fine, spec, ideal.rig, commanded(levels, ideal.rig), hurried=True)
    return _outcome(tube, ideal.rig, spec, counts, hold_start(ideal, spec))


def _outcome(tube: Tube, rig: Rig, spec: HeatingSpec, counts: Counts, start: float) -> Outcome:
    """What counts keep, by themselves, where the hold begins at `start`, s."""
    fine, coarse = (thermal_model(tube, rig, grid) for grid in (FINE, COARSE))
    done = resimulate(fine, spec.slot, counts / COUNTS)
    error = mesh_error((coarse, simulate(coarse, spec.slot, counts / COUNTS)), (fine, done), spec, start)
    return outcome_of(fine, rig, spec, done, start, error)


def _trimmed(tube: Tube, spec: HeatingSpec, found: Schedule) -> Schedule:
    """With counts of the duties scaled down until no point is above the limit, less the mesh's error."""
    run, scale = found.run, 1.0
    for _ in range(TRIMS):
        excess = found.outcome.excess
        if excess <= 0:
            break
        # Temperatures rise nearly in proportion to the duty.
        scale *= 1 - (excess + RESERVE) / (spec.limit + ZERO_CELSIUS - run.model.ambient)
        found = _guarded(tube, spec, run, scale, found.program)
    return found


def slots(ideal: Ideal, spec: HeatingSpec) -> Array:
    """(T,) ideal mean duty in every slot: heating, hold, and 0 while the tube cools in the mold."""
    levels = ideal.duty(spec.slot, slots_on(ideal, spec))
    return np.concatenate([levels, np.zeros(math.ceil(COOLING / spec.slot))])


def commanded(duty: Array, rig: Rig) -> Array:
    """Duties to be switched for these of effect: what every pulse loses on top."""
    return np.where(duty > 0, np.minimum(duty + rig.circuit.lost_share, 1.0), 0.0)


def slots_on(ideal: Ideal, spec: HeatingSpec) -> int:
    """Number of slots of heating and hold."""
    return round(hold_start(ideal, spec) / spec.slot) + spec.hold_slots


def hold_start(ideal: Ideal, spec: HeatingSpec) -> float:
    """Beginning of the first slot of the hold, s."""
    return spec.slot * math.ceil(ideal.heating / spec.slot - 1e-9)


def _rounded(found: Schedule, spec: HeatingSpec) -> tuple[float, float]:
    """What rounding took from the window at its low end (during the hold) and at its high end (at any time), K."""
    run = found.run
    first, last = hold_slots(spec, run.start)
    change = found.checked.tube[:, 0] - run.exact.tube[:, 0]
    low = -float(change[first : last + 1][:, run.model.curved].min())
    return max(low, 0.0), max(float(change.max()), 0.0)
