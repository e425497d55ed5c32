"""How to heat a tube so that its curved part is shape-set, and what would help where that cannot be done.

Changes of rig and question are tried one after the other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from ...constants import ZERO_CELSIUS
from ...errors import InputError, SolveError, instance, without_unit_warnings
from ...robots.tubes import Tube
from ...solvers.blas import small
from ...solvers.time_limit import TIME_LIMIT, limited
from ..materials import CALCIUM_SILICATE, check_temperatures, warn_of_limit
from .counts import count_rate, full_current
from .optimal_schedule import Ideal, solve_ideal
from .outcome import Outcome, broken, hold_slots
from .plan import WORTH, Cure, HeatingPlan
from .rig import Rig
from .robust import design_feedback
from .schedule import Programmed, Schedule, best_schedule, foreseen, programmed, realised
from .sensors import Sensor
from .spec import LONGEST, HeatingSpec
from .thermal import PROGRAM, joined, thermal_data, thermal_model


@small
@limited
def plan_heating(
    tube: Tube,
    rig: Rig,
    spec: HeatingSpec | None = None,
    *,
    sensor: Sensor | None = None,
    cures: bool = True,
    time_limit: float = TIME_LIMIT,
) -> HeatingPlan:
    """Schedule of integer duties that keeps the curved part of a tube in the temperature window for the hold time.

    No point exceeds the temperature limit; ramp and currents stay within theirs. If that is impossible, the plan with
    the smallest miss is returned: `feasible` is False, `shortfall` is the miss, `broken` names other violated limits,
    and `cures` lists changes that would help.

    Args:
        tube: the tube; its straight part serves as a lead. Missing lead, and the lead at the tip, are extra tube.
        rig: battery, circuit, clamps, mold.
        spec: window, hold and limits; by default 500-550 degC for 60 s.
        sensor: a `Thermocouple`, `TubeResistance` or `Camera`. The plan's `feedback` is then the controller for it,
            with the probability that uncertain rigs keep the window (see `design_feedback`).
        cures: whether changes that would help are searched where the window is missed.
        time_limit: maximum run time, s.

    Raises:
        InputError: a tube without curved part, or an invalid rig or window. A material without thermal data or recipe
            (only nitinol has one), or that cannot be set in the window.
        SolveError: the optimal control problem did not converge.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import tubeopt
        >>> rig = tubeopt.load_rig("configs/rigs/thesis_calcium_silicate.yaml")
        >>> plan = tubeopt.plan_heating(rig.tube, rig, tubeopt.HeatingSpec(window_degC=(500, 550), hold_time=5))
        >>> plan.feasible, plan.lowest >= 500, plan.highest <= 550
        (True, True, True)
    """
    spec = HeatingSpec() if spec is None else spec
    for name, value, wanted in (("tube", tube, Tube), ("rig", rig, Rig), ("spec", spec, HeatingSpec)):
        instance(name, value, wanted)
    check_temperatures(tube.material, "window_degC", *spec.window_degC)
    warn_of_limit(tube.material, spec.limit)
    thermal_data(tube)
    if rig.ambient - ZERO_CELSIUS >= spec.window_degC[0]:
        raise InputError(
            f"ambient of the rig is {rig.ambient - ZERO_CELSIUS:g} degC; it must be below the window, which begins at "
            f"{spec.window_degC[0]:g} degC"
        )
    thermal_model(tube, rig, PROGRAM)  # refuses a tube and a mold that do not fit one another
    found = best_schedule(tube, rig, spec)
    changes = find_cures(tube, rig, spec, found) if cures and not found.kept else ()
    iterations = 0 if found.program is None else found.program.ideal.iterations
    plan = HeatingPlan.of(tube, spec, found, iterations, cures=changes)
    return plan if sensor is None else replace(plan, feedback=design_feedback(plan, sensor))


# --- changes that would help ------------------------------------------------------------------------------------------


# Each may take a plan of its own, some seconds. Candidates are ordered by the reason of the miss.
MOST_CURES = 3
"""Changes that are tried."""

# A MAX31855 converts in 100 ms: the firmware keeps no shorter slot under control.
QUICK_SLOT = 0.1
"""Slots that are proposed for a window too narrow for the requested ones, s."""

# A sixth of `RESERVE`: a larger miss of the program is not made up by counts.
SMALL_MISS = 0.05
"""Miss of the window by the program below which a schedule of whole counts is made as a check, K."""

# The default slot: one fifth of the counts that slots of 0.1 s need, where `SWING` allows it.
CHECKED_SLOT = 0.5
"""Longest duration of equal duties in that check, s."""

# A tenth of a window of 50 K is 5 K, twice the ripple of the default slot.
SWING = 0.1
"""Largest heating by half a count in that time, as a fraction of the window's width."""

Change = tuple[str, Rig, HeatingSpec]


def find_cures(tube: Tube, rig: Rig, spec: HeatingSpec, best: Schedule) -> tuple[Cure, ...]:
    """Changes that let everything be kept, or at least nearly; the best first, the search ends at the first that cures.

    Changes for the window that leave nothing of the rig free are first tried by the soonest schedule; the others, and
    those that it does not keep, by the program alone, and what seems to cure is confirmed. `best`: without any change.
    """
    plain = replace(spec, objective="time")
    if best.outcome.shortfall <= 0:
        return _ordered(_for_limits(tube, rig, plain, best.outcome))
    found: list[Cure] = []
    near, limited = best.program, bool(best.outcome.broken)
    answers: list[tuple[Rig, HeatingSpec, Ideal]] = []
    for change in _candidates(rig, plain, best)[:MOST_CURES]:
        cure = _kept(change, tube, limited)
        if cure is None and not answers:
            # Only what the soonest schedule does not keep needs the program.
            near = near or programmed(tube, rig, spec)
            if not spec.free and spec == plain:
                answers.append((rig, spec, near.ideal))
        if _in_vain(change, answers):
            continue
        if cure is None and near is not None and (tried := _tried(change, tube, spec, near)) is not None:
            answers.append((*change[1:], tried[1]))
            if near is not None and change[2].free:
                # What frees more begins with what less has made of it.
                near = replace(near, ideal=tried[1])
            cure = _settled(change, tube, tried, limited)
        if cure is not None and cure.shortfall < (1 - WORTH) * best.outcome.shortfall:
            found.append(cure)
            # No change for the window is one for limits.
            if cure.cures or (limited and cure.shortfall <= 0):
                break
    return _ordered(found)


def _in_vain(change: Change, answers: Sequence[tuple[Rig, HeatingSpec, Ideal]]) -> bool:
    """Whether a change frees the lead alone, upwards, where by an answer to the same without that no longer one is
    better: what is best with the lead fixed is best with it free then."""
    _, rig, asked = change
    if asked.free != ("lead",):
        return False
    return any(
        rig == other and replace(asked, free=(), lead_range=spec.lead_range) == spec and not ideal.lead_gains
        for other, spec, ideal in answers
    )


def _kept(change: Change, tube: Tube, anyway: bool) -> Cure | None:
    """The cure that a change is by the soonest schedule; None where that does not keep everything, or, where limits of
    ramp and currents are broken `anyway`, the window.

    A schedule of longer slots is one of short ones too, of which every few share their count.
    """
    words, rig, asked = change
    found: Cure | None = None
    for spec in () if asked.free else _slower(tube, rig, asked):
        outcome = foreseen(tube, rig, spec)
        if outcome is None or outcome.shortfall > 0:
            continue
        if outcome.kept:
            return Cure(words, 0.0)
        found = Cure(words, 0.0, outcome.broken) if anyway else None
    return found


def _slower(tube: Tube, rig: Rig, spec: HeatingSpec) -> tuple[HeatingSpec, ...]:
    """What is asked for with slots several times as long, where these fill the hold and half a count does not warm by
    much in one; and as it is."""
    longer = spec.slot * math.floor(CHECKED_SLOT / spec.slot + 1e-9)
    if longer <= spec.slot or abs(spec.hold_time / longer - round(spec.hold_time / longer)) > 1e-9:
        return (spec,)
    low, high = spec.window_degC
    swing = 0.5 * longer * count_rate(tube, rig)
    return (replace(spec, slot=longer), spec) if swing < SWING * (high - low) else (spec,)


def _settled(change: Change, tube: Tube, tried: tuple[Cure, Ideal], limited: bool) -> Cure:
    """What the program makes of a change, and whole counts of what it would cure."""
    cure, answer = tried
    if cure.shortfall >= SMALL_MISS:
        return cure
    fixed = replace(change[2], free=())
    if change[2].free and (kept := _kept((cure.change, answer.rig, fixed), tube, limited)) is not None:
        return kept
    for asked in _slower(tube, answer.rig, fixed):
        outcome = realised(tube, asked, answer)
        if outcome.kept or (limited and outcome.shortfall <= 0):
            break
    return replace(cure, shortfall=outcome.shortfall, broken=outcome.broken)


def _ordered(cures: Sequence[Cure]) -> tuple[Cure, ...]:
    return tuple(sorted(cures, key=lambda cure: (not cure.cures, cure.shortfall)))


def _tried(change: Change, tube: Tube, spec: HeatingSpec, near: Programmed) -> tuple[Cure, Ideal] | None:
    """By how much the program misses the window with a change, and its answer; None where it finds none, or would
    change nothing of the rig that it may."""
    words, rig, asked = change
    part = asked.slot / spec.slot
    low, high = near.reserve
    # Another material is farther from the answer than a new start is.
    guess = near.ideal if rig.mold.material == near.ideal.rig.mold.material else None
    try:
        answer = solve_ideal(tube, rig, asked, reserve=(part * low, part * high), shift=near.shift, guess=guess)
    except SolveError:
        return None
    chosen = _chosen(rig, answer.rig)
    if asked.free and not chosen:
        return None
    return Cure(words.format(chosen=chosen), max(answer.miss, 0.0)), answer


def _chosen(rig: Rig, other: Rig) -> str:
    """In words, what the program chose of lead and clearance, by more than a hundredth, and of vents that open."""
    mold, clearance = other.mold, other.clamps.clearance
    parts = []
    if not math.isclose(rig.mold.lead, mold.lead, rel_tol=0.01):
        parts.append(f"a lead of {1e3 * mold.lead:.1f} mm of extra tube in the mold at each end")
    if not math.isclose(rig.clamps.clearance, clearance, rel_tol=0.01):
        parts.append(f"a clearance of {1e3 * clearance:.1f} mm")
    if max(mold.vents) >= max(rig.mold.vents) + 0.01:
        parts.append(f"vents that leave up to {100 * max(mold.vents):.0f} % of the tube bare")
    return ", ".join(parts[:-1]) + " and " * (len(parts) > 1) + "".join(parts[-1:])


def _confirmed(change: Change, tube: Tube) -> list[Cure]:
    """What whole counts make of a change; nothing where there is no schedule."""
    words, rig, asked = change
    if (kept := _kept(change, tube, False)) is not None:
        return [kept]
    try:
        outcome = best_schedule(tube, rig, asked).outcome
    except SolveError:
        return []
    return [Cure(words, outcome.shortfall, outcome.broken)]


@without_unit_warnings()
def _for_limits(tube: Tube, rig: Rig, spec: HeatingSpec, outcome: Outcome) -> list[Cure]:
    """Changes where the window is held but ramp or currents are not: less current, or another limit."""
    now, count = full_current(tube, rig), count_rate(tube, rig)
    # One count should warm the tube by less than half of the ramp, and the peak stay below the circuit's.
    most = min(now * math.sqrt(min(0.4 * spec.ramp / count, 1.0)), 0.95 * rig.circuit.peak_limit)
    found: list[Cure] = []
    if most < now:
        ohm = 1e-3 * math.ceil(rig.battery.voltage * (1 / most - 1 / now) / 1e-3)
        circuit = replace(rig.circuit, cable_resistance=rig.circuit.cable_resistance + ohm)
        change = f"a resistor of {1e3 * ohm:.0f} mohm in series", replace(rig, circuit=circuit), spec
        found += _confirmed(change, tube)
    if outcome.steepest > spec.ramp:
        # The schedule that breaks the limit keeps another one.
        faster = replace(spec, ramp=float(5 * math.ceil(outcome.steepest / 5 + 1e-9)))
        found.append(Cure(f"a ramp of {faster.ramp:g} K/s", 0.0, broken(rig, faster, vars(outcome))))
    return found


def _candidates(rig: Rig, spec: HeatingSpec, best: Schedule) -> list[Change]:
    """The changes that fit the reason: the whole tube too cold, its ends too cold, or a window too narrow."""
    low, high = spec.window_degC
    if best.program is None:
        _, end = hold_slots(spec, best.run.start)
        last, heating = joined(best.run.model, best.checked.tube[end, 0]) - ZERO_CELSIUS, best.run.start
    else:
        ideal, shift = best.program.ideal, best.program.shift
        last, heating = ideal.held[-1] - ZERO_CELSIUS + (0.0 if shift is None else shift.held[-1]), ideal.heating
    if last.max() < low:
        return _for_power(rig, spec)
    # A mold that had no time to get warm is told by a heating as long as it may be.
    soon = _more_time(rig, spec) if heating > (1 - WORTH) * spec.longest_heating else []
    if last.max() - last.min() > 0.5 * (high - low):
        return soon + _for_ends(rig, spec)
    return soon + _for_narrow_window(rig, spec)


def _more_time(rig: Rig, spec: HeatingSpec) -> list[Change]:
    longer = replace(spec, longest_heating=min(3.0 * spec.longest_heating, LONGEST))
    if longer == spec:
        return []
    return [(f"a heating of up to {longer.longest_heating:g} s", rig, longer)]


def _for_power(rig: Rig, spec: HeatingSpec) -> list[Change]:
    found: list[Change] = []
    if rig.mold.material != CALCIUM_SILICATE:
        silicate = replace(rig, mold=replace(rig.mold, material=CALCIUM_SILICATE))
        name = rig.mold.material.name.replace("_", " ")
        found.append((f"a mold of calcium silicate in place of {name}", silicate, spec))
    circuit = replace(rig.circuit, current_limit=2.0 * rig.circuit.current_limit)
    words = f"a circuit that allows a mean current of {circuit.current_limit:g} A"
    found.append((words, replace(rig, circuit=circuit), spec))
    if rig.battery.state_of_charge < 0.95:
        found.append(("a full battery", rig.with_charge(1.0), spec))
    return found + _more_time(rig, spec)


def _for_ends(rig: Rig, spec: HeatingSpec) -> list[Change]:
    lead, clearance = rig.mold.lead, rig.clamps.clearance
    longer = replace(spec, free=("lead",), lead_range=(lead, max(60e-3, 1.5 * lead)))
    room = min(1e-3, 0.5 * clearance), max(20e-3, 1.01 * clearance)
    return [
        ("{chosen}", rig, longer),
        ("{chosen}", rig, replace(longer, free=("lead", "clearance", "vents"), clearance_range=room)),
    ]


def _for_narrow_window(rig: Rig, spec: HeatingSpec) -> list[Change]:
    lead = _for_ends(rig, spec)[0]
    wider = replace(spec, window_degC=(spec.window_degC[0] - 25.0, spec.window_degC[1]))
    wide = (f"a window that begins at {wider.window_degC[0]:g} degC", rig, wider)
    if spec.slot <= (short := QUICK_SLOT):
        return [lead, wide]
    quick = f"duties kept for {short:g} s instead of {spec.slot:g} s"
    both = (f"{lead[0]}, and {quick}", rig, replace(lead[2], slot=short))
    return [(quick, rig, replace(spec, slot=short)), both, wide]
