"""Heating plan for a tube, and changes of rig or question that would help where it is infeasible."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ...block.custom import CustomObjective, CustomRequirement
from ...constants import ZERO_CELSIUS
from ...errors import InputError, SolveError, instance, without_unit_warnings
from ...robots.tubes import Tube
from ...solvers.blas import small
from ...solvers.time_limit import TIME_LIMIT, limited
from ..materials import CALCIUM_SILICATE, check_temperatures, warn_of_limit
from .counts import count_rate, full_current
from .optimal_control import NO_TERMS, CustomTerms
from .optimal_schedule import Ideal, solve_ideal
from .outcome import Outcome, broken, hold_slots
from .plan import MIN_GAIN, Cure, HeatingPlan
from .rig import Rig
from .rig_course import GridPlaces, RigCourse, grid_places
from .robust import design_feedback
from .schedule import Programmed, Schedule, best_schedule, minimum_time_outcome, programmed, realised_outcome
from .sensors import Sensor
from .spec import LONGEST, HeatingSpec
from .thermal import PROGRAM, curved_temperatures, thermal_data, thermal_model


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
    requirements: Sequence[CustomRequirement | Callable[[RigCourse], Any]] = (),
    objective: CustomObjective | Callable[[RigCourse], Any] | None = None,
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
        requirements: objects, or functions of the course of the rig (attributes as of `HeatingBlock`) that
            return expressions, each entry at least 0. The plan is corrected until its counts satisfy them on the
            fine grid; no cures are searched.
        objective: custom objective, an object or a function of the course, of the order of 1; replaces that of `spec`.

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
    for name, value, kind in (("tube", tube, Tube), ("rig", rig, Rig), ("spec", spec, HeatingSpec)):
        instance(name, value, kind)
    check_temperatures(tube.material, "window_degC", *spec.window_degC)
    warn_of_limit(tube.material, spec.limit)
    thermal_data(tube)
    if rig.ambient - ZERO_CELSIUS >= spec.window_degC[0]:
        raise InputError(
            f"ambient of the rig is {rig.ambient - ZERO_CELSIUS:g} degC; it must be below the window, which begins at "
            f"{spec.window_degC[0]:g} degC"
        )
    thermal_model(tube, rig, PROGRAM)  # raises InputError if tube and mold do not fit
    custom = _custom_terms(requirements, objective, grid_places(tube, rig, PROGRAM, fixed=not spec.free))
    schedule = best_schedule(tube, rig, spec, custom)
    changes = find_cures(tube, rig, spec, schedule) if cures and custom is NO_TERMS and not schedule.feasible else ()
    iterations = 0 if schedule.program is None else schedule.program.ideal.iterations
    plan = HeatingPlan.of(tube, spec, schedule, iterations, cures=changes)
    return plan if sensor is None else replace(plan, feedback=design_feedback(plan, sensor))


def _custom_terms(requirements: Sequence[Any], objective: Any, grid: GridPlaces) -> CustomTerms:
    """User's requirements and objective as scaled functions of the temperature course."""
    if not requirements and objective is None:
        return NO_TERMS
    for name, values, kind in (
        ("requirements", requirements, CustomRequirement),
        ("objective", () if objective is None else (objective,), CustomObjective),
    ):
        for value in values:
            if isinstance(value, kind):
                value.checked()
            elif not callable(value):
                raise InputError(f"{name} has {value!r}; it must be a {kind.__name__} or a function of the course")

    def requirement(value: Any) -> Callable[[RigCourse], Any]:
        if isinstance(value, CustomRequirement):
            return lambda course: value.expression(course) / value.size  # type: ignore[arg-type]
        return value  # type: ignore[no-any-return]

    minimised = objective
    if isinstance(objective, CustomObjective):
        factor = objective.sign * objective.weight

        def minimised(course: RigCourse) -> Any:
            return factor * objective.expression(course)  # type: ignore[arg-type]

    return CustomTerms(tuple(requirement(value) for value in requirements), minimised, grid)


# --- changes that would help ------------------------------------------------------------------------------------------


# Each may take a plan of its own, some seconds. Candidates are ordered by the reason of the miss.
MAX_CHANGES = 3
"""Number of changes that are tried."""

# A MAX31855 converts in 100 ms: the firmware keeps no shorter slot under control.
QUICK_SLOT = 0.1
"""Slot that is proposed for a window too narrow for the requested one, s."""

# A sixth of `RESERVE`: whole counts do not compensate a larger miss of the program.
SMALL_MISS = 0.05
"""Miss of the window by the program below which whole counts are computed as a check, K."""

# The default slot: one fifth of the counts that slots of 0.1 s need, where `MAX_SWING` allows it.
CHECK_SLOT = 0.5
"""Longest slot in that check, s."""

# A tenth of a window of 50 K is 5 K, twice the ripple of the default slot.
MAX_SWING = 0.1
"""Largest heating by half a count in a slot of that check, as a fraction of the window's width."""


@dataclass(frozen=True)
class Change:
    """Change of rig or specification that may make a plan feasible."""

    description: str
    """Text for users; "{chosen}" stands for what the program chooses."""
    rig: Rig
    spec: HeatingSpec


@dataclass(frozen=True, eq=False)
class TriedChange:
    """Change with the solution of its optimal control problem."""

    change: Change
    ideal: Ideal
    description: str
    """Description with what the program chose."""


def find_cures(tube: Tube, rig: Rig, spec: HeatingSpec, best: Schedule) -> tuple[Cure, ...]:
    """Changes that would make a schedule feasible, or nearly so; the best first.

    The search ends at the first change that makes the schedule feasible. A change that frees no parameter of the rig is
    first tried with the minimum-time schedule. If this fails, or parameters are free, the optimal control program tries
    the change, and whole counts confirm it.

    Args:
        best: schedule without any change.
    """
    plain = replace(spec, objective="time")
    if best.outcome.shortfall <= 0:
        return _sorted(_for_limits(tube, rig, plain, best.outcome))
    cures: list[Cure] = []
    near, limits_broken = best.program, bool(best.outcome.broken)
    tried: list[TriedChange] = []
    for change in _candidates(rig, plain, best)[:MAX_CHANGES]:
        cure = _by_minimum_time(change, tube, limits_broken)
        if cure is None and not tried:
            # Only a change that the minimum-time schedule does not satisfy needs the program.
            near = near or programmed(tube, rig, spec)
            if not spec.free and spec == plain:
                tried.append(TriedChange(Change("", rig, spec), near.ideal, ""))
        if _lead_alone_is_useless(change, tried):
            continue
        if cure is None and near is not None and (attempt := _by_program(change, tube, spec, near)) is not None:
            tried.append(attempt)
            if change.spec.free:
                # A change that frees more parameters starts at the solution with fewer.
                near = replace(near, ideal=attempt.ideal)
            cure = _confirmed(attempt, tube, limits_broken)
        if cure is not None and cure.shortfall < (1 - MIN_GAIN) * best.outcome.shortfall:
            cures.append(cure)
            # A change for the window does not help against broken limits.
            if cure.cures or (limits_broken and cure.shortfall <= 0):
                break
    return _sorted(cures)


def _sorted(cures: Sequence[Cure]) -> tuple[Cure, ...]:
    return tuple(sorted(cures, key=lambda cure: (not cure.cures, cure.shortfall)))


def _lead_alone_is_useless(change: Change, tried: Sequence[TriedChange]) -> bool:
    """True if a change frees only the lead, and a longer lead would not improve the solution.

    The solution with the fixed lead shows it.

    The solution with the lead fixed at its lower bound is then also the one with the lead free.
    """
    spec = change.spec
    if spec.free != ("lead",):
        return False
    return any(
        change.rig == other.change.rig
        and replace(spec, free=(), lead_range=other.change.spec.lead_range) == other.change.spec
        and not other.ideal.longer_lead_helps
        for other in tried
    )


def _by_minimum_time(change: Change, tube: Tube, despite_limits: bool) -> Cure | None:
    """Proposed change with the minimum-time schedule; None if that violates a requirement.

    With `despite_limits`, ramp and currents may be exceeded. A schedule of longer slots is also one of short slots.
    """
    cure: Cure | None = None
    for spec in () if change.spec.free else _with_check_slot(tube, change.rig, change.spec):
        outcome = minimum_time_outcome(tube, change.rig, spec)
        if outcome is None or outcome.shortfall > 0:
            continue
        if outcome.feasible:
            return Cure(change.description, 0.0)
        cure = Cure(change.description, 0.0, outcome.broken) if despite_limits else None
    return cure


def _with_check_slot(tube: Tube, rig: Rig, spec: HeatingSpec) -> tuple[HeatingSpec, ...]:
    """Specifications to try: with longer slots, if these fit the hold and heat little at half a count, and the
    original.
    """
    longer = spec.slot * math.floor(CHECK_SLOT / spec.slot + 1e-9)
    if longer <= spec.slot or abs(spec.hold_time / longer - round(spec.hold_time / longer)) > 1e-9:
        return (spec,)
    low, high = spec.window_degC
    swing = 0.5 * longer * count_rate(tube, rig)
    return (replace(spec, slot=longer), spec) if swing < MAX_SWING * (high - low) else (spec,)


def _by_program(change: Change, tube: Tube, spec: HeatingSpec, near: Programmed) -> TriedChange | None:
    """Change solved by the optimal control program; None without a solution or without an effect on the rig."""
    rig, task = change.rig, change.spec
    # Rounding in a slot is proportional to its length.
    part = task.slot / spec.slot
    low, high = near.reserve
    # Another material is farther from the solution than a new start is.
    guess = near.ideal if rig.mold.material == near.ideal.rig.mold.material else None
    try:
        ideal = solve_ideal(tube, rig, task, reserve=(part * low, part * high), shift=near.shift, guess=guess)
    except SolveError:
        return None
    chosen = _describe_choice(rig, ideal.rig)
    if task.free and not chosen:
        return None
    return TriedChange(change, ideal, change.description.format(chosen=chosen))


def _confirmed(tried: TriedChange, tube: Tube, despite_limits: bool) -> Cure:
    """Proposed change, confirmed by a schedule of whole counts if its miss is small."""
    ideal, miss = tried.ideal, max(tried.ideal.miss, 0.0)
    if miss >= SMALL_MISS:
        return Cure(tried.description, miss)
    fixed = replace(tried.change.spec, free=())
    if tried.change.spec.free:
        cure = _by_minimum_time(Change(tried.description, ideal.rig, fixed), tube, despite_limits)
        if cure is not None:
            return cure
    for spec in _with_check_slot(tube, ideal.rig, fixed):
        outcome = realised_outcome(tube, spec, ideal)
        if outcome.feasible or (despite_limits and outcome.shortfall <= 0):
            break
    return Cure(tried.description, outcome.shortfall, outcome.broken)


def _describe_choice(rig: Rig, chosen: Rig) -> str:
    """Description of the chosen lead and clearance, if changed by more than a hundredth, and of opened vents."""
    mold, clearance = chosen.mold, chosen.clamps.clearance
    parts = []
    if not math.isclose(rig.mold.lead, mold.lead, rel_tol=0.01):
        parts.append(f"a lead of {1e3 * mold.lead:.1f} mm of extra tube in the mold at each end")
    if not math.isclose(rig.clamps.clearance, clearance, rel_tol=0.01):
        parts.append(f"a clearance of {1e3 * clearance:.1f} mm")
    if max(mold.vents) >= max(rig.mold.vents) + 0.01:
        parts.append(f"vents that leave up to {100 * max(mold.vents):.0f} % of the tube bare")
    return ", ".join(parts[:-1]) + " and " * (len(parts) > 1) + "".join(parts[-1:])


@without_unit_warnings()
def _for_limits(tube: Tube, rig: Rig, spec: HeatingSpec, outcome: Outcome) -> list[Cure]:
    """Changes to try if the window is reached but ramp or currents are exceeded: less current, or another limit."""
    current, rate = full_current(tube, rig), count_rate(tube, rig)
    # One count should heat the tube by less than half of the ramp, and the peak stay below the circuit's limit.
    target = min(current * math.sqrt(min(0.4 * spec.ramp / rate, 1.0)), 0.95 * rig.circuit.peak_limit)
    cures: list[Cure] = []
    if target < current:
        R = 1e-3 * math.ceil(rig.battery.voltage * (1 / target - 1 / current) / 1e-3)
        circuit = replace(rig.circuit, cable_resistance=rig.circuit.cable_resistance + R)
        change = Change(f"a resistor of {1e3 * R:.0f} mohm in series", replace(rig, circuit=circuit), spec)
        cure = _by_minimum_time(change, tube, False)
        if cure is None:
            try:
                best = best_schedule(tube, change.rig, spec).outcome
                cure = Cure(change.description, best.shortfall, best.broken)
            except SolveError:
                pass
        cures += [] if cure is None else [cure]
    if outcome.steepest > spec.ramp:
        # The schedule that exceeds the limit satisfies a higher one.
        faster = replace(spec, ramp=float(5 * math.ceil(outcome.steepest / 5 + 1e-9)))
        cures.append(Cure(f"a ramp of {faster.ramp:g} K/s", 0.0, broken(rig, faster, vars(outcome))))
    return cures


def _candidates(rig: Rig, spec: HeatingSpec, best: Schedule) -> list[Change]:
    """Changes to try for the reason of the miss: whole tube too cold, ends too cold, or window too narrow."""
    low, high = spec.window_degC
    if best.program is None:
        _, end = hold_slots(spec, best.run.start)
        T_end, heating = curved_temperatures(best.run.model, best.history.tube[end, 0]) - ZERO_CELSIUS, best.run.start
    else:
        ideal, shift = best.program.ideal, best.program.shift
        T_end = ideal.hold[-1] - ZERO_CELSIUS + (0.0 if shift is None else shift.hold[-1])
        heating = ideal.heating

    more_time: list[Change] = []
    longer = replace(spec, longest_heating=min(3.0 * spec.longest_heating, LONGEST))
    if longer != spec:
        more_time.append(Change(f"a heating of up to {longer.longest_heating:g} s", rig, longer))
    if T_end.max() < low:
        return [*_for_power(rig, spec), *more_time]
    # A heating as long as allowed shows that the mold had no time to get warm.
    if heating <= (1 - MIN_GAIN) * spec.longest_heating:
        more_time = []
    if T_end.max() - T_end.min() > 0.5 * (high - low):
        return [*more_time, *_for_ends(rig, spec)]
    return [*more_time, *_for_narrow_window(rig, spec)]


def _for_power(rig: Rig, spec: HeatingSpec) -> list[Change]:
    changes: list[Change] = []
    if rig.mold.material != CALCIUM_SILICATE:
        silicate = replace(rig, mold=replace(rig.mold, material=CALCIUM_SILICATE))
        name = rig.mold.material.name.replace("_", " ")
        changes.append(Change(f"a mold of calcium silicate in place of {name}", silicate, spec))
    circuit = replace(rig.circuit, current_limit=2.0 * rig.circuit.current_limit)
    description = f"a circuit that allows a mean current of {circuit.current_limit:g} A"
    changes.append(Change(description, replace(rig, circuit=circuit), spec))
    if rig.battery.state_of_charge < 0.95:
        changes.append(Change("a full battery", rig.with_charge(1.0), spec))
    return changes


def _for_ends(rig: Rig, spec: HeatingSpec) -> list[Change]:
    lead, clearance = rig.mold.lead, rig.clamps.clearance
    longer = replace(spec, free=("lead",), lead_range=(lead, max(60e-3, 1.5 * lead)))
    clearances = min(1e-3, 0.5 * clearance), max(20e-3, 1.01 * clearance)
    return [
        Change("{chosen}", rig, longer),
        Change("{chosen}", rig, replace(longer, free=("lead", "clearance", "vents"), clearance_range=clearances)),
    ]


def _for_narrow_window(rig: Rig, spec: HeatingSpec) -> list[Change]:
    lead = _for_ends(rig, spec)[0]
    wider = replace(spec, window_degC=(spec.window_degC[0] - 25.0, spec.window_degC[1]))
    wide = Change(f"a window that begins at {wider.window_degC[0]:g} degC", rig, wider)
    if spec.slot <= QUICK_SLOT:
        return [lead, wide]
    quick = Change(f"slots of {QUICK_SLOT:g} s instead of {spec.slot:g} s", rig, replace(spec, slot=QUICK_SLOT))
    both = replace(
        lead, description=f"{lead.description}, and {quick.description}", spec=replace(lead.spec, slot=QUICK_SLOT)
    )
    return [quick, both, wide]
