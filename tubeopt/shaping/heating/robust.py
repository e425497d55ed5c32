"""A plan on uncertain rigs: band of temperatures, more likely schedule, other charges, feedback controller.

All are simulated on one ensemble (`Uncertainty.ensemble`): the nominal rig, which is the first member, and others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import scipy

from ...errors import InputError, instance
from ...solvers.blas import small
from ...solvers.time_limit import TIME_LIMIT, limited
from ...typing import Array
from .controller import Contribution, Feedback, HeatingLaw, LoopHistory, run_loop, shifted
from .counts import Counts, guarded_counts, sum_up_rounding
from .outcome import hold_slots
from .plan import HeatingPlan
from .rig import COUNTS
from .schedule import Run, checked
from .sensors import Felt, Sensor
from .simulation import State, current, resimulate, simulate, simulate_feedback
from .thermal import FINE, ThermalModel, seen, thermal_model
from .uncertainty import ENSEMBLE, Uncertainty

PROBES = (0.94, 1.06)
SCALES = np.linspace(0.8, 1.2, 401)
CHARGES = (1.0, 0.9, 0.8, 0.7, 0.6)


# --- charge -----------------------------------------------------------------------------------------------------------


def at_charge(plan: HeatingPlan, state_of_charge: float) -> HeatingPlan:
    """The plan for the same temperatures with the battery at another charge.

    The tube feels duty times current squared only: the ideal duties are scaled, slot by slot, so that it stays the
    same, as far as the current limit allows, and rounded and integrated anew. Where the battery is too weak for that,
    the duty is 255 and the plan is not feasible.

    Raises:
        InputError: a state of charge outside of (0, 1].
    """
    rig = plan.rig.with_charge(state_of_charge)
    levels = plan.ideal_duty[:-1] / COUNTS
    slot = plan.spec.slot
    nominal = simulate(thermal_model(plan.tube, plan.rig, FINE), slot, levels)
    lost = rig.circuit.lost_share
    # d I^2 is the heat of the tube but for its resistance, which follows its temperature.
    drive = np.maximum(levels - lost, 0.0) * nominal.current[:-1, 0] ** 2
    model = thermal_model(plan.tube, rig, FINE)

    def controller(time: float, state: State) -> float:
        now = current(model, state.cells[:, :, 0], state.lumped).total[0]
        wanted = float(drive[round(time / slot)] / now**2)
        return min(1.0, wanted + lost * (wanted > 0), rig.circuit.current_limit / float(now))

    exact, scaled = simulate_feedback(model, slot, len(levels), controller)
    run = Run(rig, model, scaled, exact, plan.outcome.mesh, plan.hold_start)
    found = checked(plan.spec, run, guarded_counts(model, plan.spec, rig, scaled))
    return HeatingPlan.of(plan.tube, plan.spec, found, plan.iterations)


def charge_tables(plan: HeatingPlan, charges: Sequence[float] = CHARGES) -> tuple[HeatingPlan, ...]:
    """Plans for several states of charge: the technician reads the battery's voltage at rest and picks one."""
    return tuple(at_charge(plan, charge) for charge in charges)


# --- what is not known ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Band:
    """What a schedule may do on S rigs that are not quite the one that it was planned for."""

    time: Array
    """(T,) s."""
    coldest: Array
    """(T, S) of the curved part, degC."""
    hottest: Array
    """(T, S) of the curved part, degC."""
    lowest: Array
    """(S,) of the curved part during the hold, degC."""
    highest: Array
    """(S,) of the curved part during the hold, degC."""
    top: Array
    """(S,) of all points at all times, degC."""
    probability: Annotated[float, "fraction that stays in the window"]
    too_cold: Annotated[float, "fraction that falls below the window"]
    too_hot: Annotated[float, "fraction that rises above window or limit"]

    def quantiles(self, fraction: float = 0.9) -> tuple[Array, Array]:
        """(T,) lower and (T,) upper limit, degC, of the curved part in this fraction of the samples."""
        tail = 0.5 * (1 - fraction)
        return np.quantile(self.coldest, tail, axis=1), np.quantile(self.hottest, 1 - tail, axis=1)


def assess(plan: HeatingPlan, uncertainty: Uncertainty | None = None, *, samples: int = 64) -> Band:
    """The band of temperatures of a plan over an ensemble of rigs, and the probability of staying in the window.

    Args:
        uncertainty: how far the rig may be from what its file says; by default `Uncertainty.of_a_workshop()`.
        samples: size of the ensemble, at least 2.

    Raises:
        InputError: fewer than 2 samples.
    """
    if samples < 2:
        raise InputError(f"samples is {samples}; it must be at least 2")
    rigs = (uncertainty or Uncertainty.of_a_workshop()).ensemble(plan.tube, plan.rig, samples)
    return _band(plan, rigs.model, plan.duty[:-1])


def _band(plan: HeatingPlan, model: ThermalModel, counts: Counts) -> Band:
    spec = plan.spec
    history = simulate(model, spec.slot, counts / COUNTS)
    reference = thermal_model(plan.tube, plan.rig, FINE)
    fine = resimulate(reference, spec.slot, counts / COUNTS)
    # The coarse grid's error is nearly the same in all members: the nominal one, which is the first, tells it.
    both = zip(seen(model, history.tube), seen(reference, fine.tube[:, 0]), strict=True)
    coldest, hottest, top = (rough[:, 1:] + (exact - rough[:, 0])[:, None] for rough, exact in both)
    first, last = hold_slots(spec, plan.hold_start)
    lowest, highest = coldest[first : last + 1].min(0), hottest[first : last + 1].max(0)
    cold = lowest < spec.window_degC[0]
    hot = (highest > spec.window_degC[1]) | (top.max(0) > spec.limit)
    return Band(
        time=history.time,
        coldest=coldest,
        hottest=hottest,
        lowest=lowest,
        highest=highest,
        top=top.max(0),
        probability=float(1 - (cold | hot).mean()),
        too_cold=float(cold.mean()),
        too_hot=float(hot.mean()),
    )


@dataclass(frozen=True, eq=False)
class RobustSchedule:
    """The schedule of those scaled from a plan's that is most likely to stay in the window."""

    scale: float
    """Of the plan's ideal duties."""
    plan: HeatingPlan
    """Of the nominal rig with it."""
    band: Band
    """With it."""
    before: Band
    """With the plan's own schedule."""


def most_likely(plan: HeatingPlan, uncertainty: Uncertainty | None = None, *, samples: int = 64) -> RobustSchedule:
    """Scale the duties of a plan so that the probability of staying in the window is greatest.

    Temperatures are nearly linear in the scale: two scales are simulated for every sample, the best one is read off and
    simulated for what is reported.

    Raises:
        InputError: fewer than 2 samples.
    """
    uncertainty = uncertainty or Uncertainty.of_a_workshop()
    before = assess(plan, uncertainty, samples=samples)
    model = uncertainty.ensemble(plan.tube, plan.rig, samples).model
    levels = plan.ideal_duty[:-1] / COUNTS
    low, high = (_band(plan, model, sum_up_rounding(np.minimum(scale * levels, 1.0))) for scale in PROBES)
    # Linear in the scale from two probes, 401 scales without another simulation.
    part = ((SCALES - PROBES[0]) / (PROBES[1] - PROBES[0]))[:, None]

    def between(name: str) -> Array:
        first, second = getattr(low, name), getattr(high, name)
        return np.asarray(first + part * (second - first))

    lower, upper = plan.spec.window_degC
    excess = np.maximum(between("highest") - upper, between("top") - plan.spec.limit)
    miss = np.maximum(np.maximum(lower - between("lowest"), excess), 0.0)
    # Where several scales keep as many samples, the one that misses the others by least.
    scale = float(SCALES[np.argmax((miss <= 0).mean(1) - 1e-4 * miss.mean(1))])
    scaled = np.minimum(scale * levels, 1.0)
    fine = thermal_model(plan.tube, plan.rig, FINE)
    counts = guarded_counts(fine, plan.spec, plan.rig, scaled)
    band = _band(plan, model, counts)
    if band.probability <= before.probability:
        return RobustSchedule(1.0, plan, before, before)
    exact = simulate(fine, plan.spec.slot, scaled)
    run = Run(plan.rig, fine, scaled, exact, plan.outcome.mesh, plan.hold_start)
    robust = HeatingPlan.of(plan.tube, plan.spec, checked(plan.spec, run, counts), plan.iterations)
    return RobustSchedule(scale, robust, band, before)


# --- feedback: gains and set-point from the model, chosen on uncertain rigs -------------------------------------------


# A quarter of a window of 50 K is 12 K: the bias is 2 K for a thermocouple, 9 K for a camera.
INSIDE = 0.25
"""Distance of the coldest point inside the window where a controlled hold begins, as a fraction of its width."""

# From 48 rigs the share in the window has a standard error of 7 %, enough to order five gains; the time grows with
# them.
RIGS = 48
"""Random rigs on which gains and set-point are chosen; others test them."""

SHIFTS = np.linspace(-15.0, 15.0, 121)
"""Set-points that are looked at, K from the plan's."""

PROBE = 0.02
"""Share by which the planned duties are raised to see what the reading does."""

RESET = 8.0
"""Time, s, in which an error that stays weighs as much as one at once: that of the mold's first shells, which fill up
and are why the tube needs less and less power."""


@small
@limited
def design_feedback(
    plan: HeatingPlan,
    sensor: Sensor,
    uncertainty: Uncertainty | None = None,
    *,
    samples: int = 200,
    seed: int = 0,
    time_limit: float = TIME_LIMIT,
) -> Feedback:
    """Feedback controller for a heating plan: feedforward, gains and set-point, with the probability of success.

    The schedule of the plan is the feedforward. Gains and set-point maximise the probability that the window is kept.
    That probability is estimated on rigs that were not used to choose them.

    Args:
        plan: the plan to control; one with objective "margin" leaves most room for feedback.
        uncertainty: uncertainty of rig and tube; by default `Uncertainty.of_a_workshop()`.
        samples: number of rigs for the probability, at least 20.
        time_limit: maximum run time, s.

    Raises:
        InputError: no sensor, fewer than 20 samples, or a sensor that is not on the tube.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import tubeopt
        >>> rig = tubeopt.load_rig("configs/rigs/thesis_calcium_silicate.yaml")
        >>> plan = tubeopt.plan_heating(rig.tube, rig, tubeopt.HeatingSpec(hold_time=5))
        >>> led = tubeopt.design_feedback(plan, tubeopt.Thermocouple(), samples=20)
        >>> led.probability > 0.8 > led.open_loop
        True
    """
    instance("sensor", sensor, Sensor)
    if samples < 20:
        raise InputError(f"samples is {samples}; it must be at least 20")
    unknown = Uncertainty.of_a_workshop() if uncertainty is None else uncertainty
    law = _tuned(plan, sensor, unknown, seed)
    rigs = unknown.ensemble(plan.tube, plan.rig, samples, sensor_bias=sensor.bias, seed=seed + 1)
    history = corrected(plan, law, sensor, run_loop(rigs.model, law, sensor, bias=rigs.bias, seed=seed))
    lowest, highest = (row[1:] for row in history.extremes(law))
    top = history.top.max(0)[1:]
    low, high = plan.spec.window_degC
    kept = history.finished[1:] & (lowest >= low) & (highest <= high) & (top <= plan.spec.limit)
    names = (*unknown.unknown, "sensor")
    return Feedback(
        sensor=sensor, law=law, uncertainty=unknown, history=history, lowest=lowest, highest=highest, top=top,
        kept=kept, open_loop=assess(plan, unknown, samples=samples).probability,
        contributions=_contributions(names, np.column_stack([rigs.draws, rigs.bias[1:]]), lowest, highest),
        window=plan.spec.window_degC, limit=plan.spec.limit,
    )  # fmt: skip


def nominal_law(plan: HeatingPlan, sensor: Sensor) -> HeatingLaw:
    """The plan's schedule and what the sensor should read of it, not yet corrected.

    The soonest hold begins where the coldest point has just reached the window, which another rig's has not: the law's
    begins once it is inside by `INSIDE`, or, where the plan never gets there, when the plan's does. The last duty
    continues for as long as it began later.
    """
    slot, planned = plan.spec.slot, round(plan.hold_start / plan.spec.slot)
    low, high = plan.spec.window_degC
    coldest = plan.temperature[planned : planned + plan.spec.hold_slots // 2][:, plan.curved].min(1)
    well = coldest >= low + INSIDE * (high - low)
    later = int(np.argmax(well)) if well.any() else 0
    last = planned + plan.spec.hold_slots
    model = thermal_model(plan.tube, plan.rig, FINE)
    lost = COUNTS * plan.rig.circuit.lost_share
    commanded = prolonged(plan, last + later)
    return HeatingLaw(
        slot=slot,
        planned=np.maximum(commanded - lost, 0.0),
        reference=readings(model, sensor, slot, commanded / COUNTS)[: last + later, 0],
        hold=(planned + later, last + later),
        proportional=0.0,
        integral=0.0,
        lost=lost,
    )


def prolonged(plan: HeatingPlan, slots: int) -> Array:
    """(slots,) mean counts of a plan's heating and hold, whose last goes on."""
    last = round(plan.hold_end / plan.spec.slot)
    return np.append(plan.ideal_duty[:last], np.full(slots - last, plan.ideal_duty[last - 1]))


def _tuned(plan: HeatingPlan, sensor: Sensor, unknown: Uncertainty, seed: int) -> HeatingLaw:
    """The law with the gains and the set-point that keep most of a fleet in the window, and that by most."""
    law = nominal_law(plan, sensor)
    nominal = thermal_model(plan.tube, plan.rig, ENSEMBLE)
    found = response(nominal, sensor, law)
    rigs = unknown.ensemble(plan.tube, plan.rig, RIGS, sensor_bias=sensor.bias, seed=seed)
    best: tuple[float, HeatingLaw] | None = None
    for share in (0.002, 0.005, 0.01, 0.02, 0.04):  # per K, from gentle to quick
        proportional, integral = regulator(found, law.slot, share)
        trial = replace(law, proportional=proportional, integral=integral)
        history = corrected(plan, trial, sensor, run_loop(rigs.model, trial, sensor, bias=rigs.bias, seed=seed))
        low, high = history.extremes(trial)
        value, shift = _best_shift(plan, low, high, history.top.max(0))
        if best is None or value > best[0]:
            best = value, shifted(trial, shift)
    assert best is not None
    return best[1]


def _best_shift(plan: HeatingPlan, low: Array, high: Array, top: Array) -> tuple[float, float]:
    """Of the set-points: share of rigs in the window, where temperatures move with it, plus a little of the least
    distance from its ends; and the set-point, K."""
    begin, end = plan.spec.window_degC
    # A set-point that moves by a shift moves all temperatures of the hold by it, to first order.
    below = low[:, None] + SHIFTS - begin
    above = np.minimum(end - high, plan.spec.limit - top)[:, None] - SHIFTS
    room = np.clip(np.minimum(below, above), -50.0, 50.0)
    # As many as possible; among equals those whose worst twentieth has most room.
    value = (room >= 0).mean(0) + 1e-3 * np.quantile(room, 0.05, axis=0)
    best = int(np.argmax(value))
    return float(value[best]), float(SHIFTS[best])


def corrected(plan: HeatingPlan, law: HeatingLaw, sensor: Sensor, history: LoopHistory) -> LoopHistory:
    """Temperatures of a fleet with what the fine grid adds to the first member, at every slot of the schedule."""
    models = (thermal_model(plan.tube, plan.rig, grid) for grid in (FINE, ENSEMBLE))
    fine, coarse = (run_loop(model, law, replace(sensor, noise=0.0)) for model in models)

    def added(name: str) -> Array:
        slots = range(len(law.planned) + 1)
        one, other = (np.interp(slots, h.place[:, 0], getattr(h, name)[:, 0]) for h in (fine, coarse))
        return np.asarray((one - other)[np.minimum(history.place, len(law.planned))])

    return replace(history, **{name: getattr(history, name) + added(name) for name in ("coldest", "hottest", "top")})


def _contributions(names: Sequence[str], draws: Array, lowest: Array, highest: Array) -> tuple[Contribution, ...]:
    """Standard deviations of the middle of the hold's temperatures by each of the draws, from a linear fit."""
    # A hold that never began has no temperatures.
    good = np.isfinite(lowest) & np.isfinite(highest)
    if good.sum() <= draws.shape[1] + 2:
        return ()
    middle, spread = 0.5 * (lowest[good] + highest[good]), draws[good].std(0)
    # The draws are independent, so a slope times its draw's deviation is that draw's own part.
    columns = np.column_stack([np.ones(int(good.sum())), draws[good]])
    slope = np.linalg.lstsq(columns, middle, rcond=None)[0][1:]
    found = [Contribution(name, float(abs(s) * w)) for name, s, w in zip(names, slope, spread, strict=True)]
    return tuple(sorted(found, key=lambda item: -item.deviation))


# --- gains: a linear-quadratic regulator of what the reading does after a share of power ------------------------------


@dataclass(frozen=True)
class Response:
    """What the reading does after a share of power: towards `gain`, K, with a time constant, s."""

    gain: float
    time_constant: float


def readings(model: ThermalModel, sensor: Sensor, slot: float, duty: Array) -> Array:
    """(T + 1, B) degC that a sensor without bias and noise shows under duties (T,) in [0, 1]."""
    felt = [Felt.at_rest(model, sensor)]
    for level in duty:
        felt.append(felt[-1].after(model, sensor, level, slot))
    return np.array([now.lagged for now in felt])


def response(model: ThermalModel, sensor: Sensor, law: HeatingLaw) -> Response:
    """The response of the first member's reading in the hold to a share of what a law plans."""
    first, last = law.hold
    duty = (law.planned + law.lost * (law.planned > 0)) / COUNTS
    plain = readings(model, sensor, law.slot, duty)[:, 0]
    raised = readings(model, sensor, law.slot, np.where(np.arange(len(duty)) < first, duty, duty * (1 + PROBE)))[:, 0]
    rise = (raised - plain)[first : last + 1] / PROBE
    gain = float(rise[-1])
    # The area between the step and its end is the time constant, whatever the shape is.
    return Response(gain, float(max(law.slot * np.sum(1 - rise / gain), law.slot)))


def regulator(found: Response, slot: float, share_per_kelvin: float) -> tuple[float, float]:
    """Proportional (1/K) and integral gain (1/(K s)) that balance errors with the share that they cost.

    The least sum over slots of e^2 + (sum of e / RESET)^2 + (share / share_per_kelvin)^2, the reading being the state:
    the algebraic Riccati equation of error and integrated error.
    """
    # First order over one slot: e' = a e - gain (1 - a) share, and the integral gains slot times e.
    kept = float(np.exp(-slot / found.time_constant))
    A = np.array([[kept, 0.0], [slot, 1.0]])
    B = np.array([[-found.gain * (1 - kept)], [0.0]])
    Q, R = np.diag([1.0, 1 / RESET**2]), np.array([[1 / share_per_kelvin**2]])
    P = scipy.linalg.solve_discrete_are(A, B, Q, R)
    # share = -K (e, integral) with K = (R + B' P B)^-1 B' P A, negative as power lessens e.
    gains = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)[0]
    return float(-gains[0]), float(-gains[1])
