"""Heating plans on uncertain rigs: temperature band, robust schedule, states of charge, feedback design.

All are simulated on one ensemble (`Uncertainty.ensemble`), whose first member is the nominal rig.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import numpy as np
import scipy

from ...errors import InputError, instance
from ...solvers.blas import small
from ...solvers.time_limit import TIME_LIMIT, limited
from ...typing import Array
from .controller import MOST_COUNT, MOST_EXCESS, Contribution, Feedback, HeatingLaw, LoopHistory, run_loop, shifted
from .counts import Counts, guarded_counts, sum_up_rounding
from .cutout import OVERSHOOT
from .outcome import hold_slots
from .plan import HeatingPlan
from .rig import COUNTS
from .schedule import Run, checked
from .sensors import MeasuredRig, Sensor
from .simulation import State, circuit_state, resimulate, simulate, simulate_feedback
from .thermal import FINE, ThermalModel, thermal_model, tube_extremes
from .uncertainty import ENSEMBLE, Uncertainty

SIMULATED_SCALES = (0.94, 1.06)
"""Scales of a schedule that are simulated; temperatures are nearly linear in the scale."""

SCALES = np.linspace(0.8, 1.2, 401)
"""Scales among which the best is chosen."""

CHARGES = (1.0, 0.9, 0.8, 0.7, 0.6)
"""States of charge of the tables for the technician."""


# --- charge -----------------------------------------------------------------------------------------------------------


def at_charge(plan: HeatingPlan, state_of_charge: float) -> HeatingPlan:
    """Plan for the same temperatures with the battery at another state of charge.

    Only duty times current squared heats the tube: the ideal duties are scaled slot by slot so that it stays the same,
    as far as the current limit allows, then rounded and simulated again. If the battery is too weak for that, the duty
    is 255 and the plan is not feasible.

    Raises:
        InputError: a state of charge outside of (0, 1].
    """
    rig = plan.rig.with_charge(state_of_charge)
    levels = plan.ideal_duty[:-1] / COUNTS
    slot = plan.spec.slot
    nominal = simulate(thermal_model(plan.tube, plan.rig, FINE), slot, levels)
    lost = rig.circuit.lost_share
    # d I^2 determines the heat: the resistance of the tube follows from its temperature.
    I_sq = np.maximum(levels - lost, 0.0) * nominal.current[:-1, 0] ** 2
    model = thermal_model(plan.tube, rig, FINE)

    def controller(time: float, state: State) -> float:
        I_on = circuit_state(model, state.cells[:, :, 0], state.lumped).I_on[0]
        effective = float(I_sq[round(time / slot)] / I_on**2)
        return min(1.0, effective + lost * (effective > 0), rig.circuit.current_limit / float(I_on))

    history, scaled = simulate_feedback(model, slot, len(levels), controller)
    run = Run(rig, model, scaled, history, plan.outcome.mesh, plan.hold_start)
    schedule = checked(plan.spec, run, guarded_counts(model, plan.spec, rig, scaled))
    return HeatingPlan.of(plan.tube, plan.spec, schedule, plan.iterations)


def charge_tables(plan: HeatingPlan, charges: Sequence[float] = CHARGES) -> tuple[HeatingPlan, ...]:
    """Plans for several states of charge, to be chosen by the battery's voltage at rest."""
    return tuple(at_charge(plan, charge) for charge in charges)


# --- temperature band -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Band:
    """Temperatures of a schedule on S uncertain rigs."""

    time: Array
    """(T,) start of every slot, s."""
    coldest: Array
    """(T, S) coldest point of the curved part, degC."""
    hottest: Array
    """(T, S) hottest point of the curved part, degC."""
    lowest: Array
    """(S,) lowest temperature of the curved part during the hold, degC."""
    highest: Array
    """(S,) highest temperature of the curved part during the hold, degC."""
    top: Array
    """(S,) highest temperature of any point at any time, degC."""
    probability: Annotated[float, "fraction that stays in the window"]
    too_cold: Annotated[float, "fraction that falls below the window"]
    too_hot: Annotated[float, "fraction that rises above window or limit"]

    def quantiles(self, fraction: float = 0.9) -> tuple[Array, Array]:
        """Lower and upper temperature (T,), degC, that this fraction of the rigs does not exceed in the curved part."""
        tail = 0.5 * (1 - fraction)
        return np.quantile(self.coldest, tail, axis=1), np.quantile(self.hottest, 1 - tail, axis=1)


def assess(plan: HeatingPlan, uncertainty: Uncertainty | None = None, *, samples: int = 64) -> Band:
    """Temperature band of a plan on an ensemble of rigs, and the probability of staying in the window.

    Args:
        uncertainty: of rig and tube; by default `Uncertainty.of_a_workshop()`.
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
    # The error of the coarse grid is nearly the same in all members: that of the nominal one corrects them.
    grids = zip(tube_extremes(model, history.tube), tube_extremes(reference, fine.tube[:, 0]), strict=True)
    coldest, hottest, top = (coarse[:, 1:] + (exact - coarse[:, 0])[:, None] for coarse, exact in grids)
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
    """Schedule with the scale of a plan's duties that is most likely to stay in the window."""

    scale: float
    """Factor on the plan's ideal duties."""
    plan: HeatingPlan
    """Plan of the nominal rig with the scaled schedule."""
    band: Band
    """Temperature band of the scaled schedule."""
    before: Band
    """Temperature band of the plan's own schedule."""


def most_likely(plan: HeatingPlan, uncertainty: Uncertainty | None = None, *, samples: int = 64) -> RobustSchedule:
    """Schedule with the scale of a plan's duties that maximises the probability of staying in the window.

    Temperatures are nearly linear in the scale: two scales are simulated for every sample, and the best one by
    interpolation is simulated again for the result.

    Raises:
        InputError: fewer than 2 samples.
    """
    uncertainty = uncertainty or Uncertainty.of_a_workshop()
    before = assess(plan, uncertainty, samples=samples)
    model = uncertainty.ensemble(plan.tube, plan.rig, samples).model
    levels = plan.ideal_duty[:-1] / COUNTS
    first, second = SIMULATED_SCALES
    low, high = (_band(plan, model, sum_up_rounding(np.minimum(scale * levels, 1.0))) for scale in SIMULATED_SCALES)
    part = ((SCALES - first) / (second - first))[:, None]

    def interpolated(name: str) -> Array:
        at_first, at_second = getattr(low, name), getattr(high, name)
        return np.asarray(at_first + part * (at_second - at_first))

    lower, upper = plan.spec.window_degC
    excess = np.maximum(interpolated("highest") - upper, interpolated("top") - plan.spec.limit)
    miss = np.maximum(np.maximum(lower - interpolated("lowest"), excess), 0.0)
    # Among scales that keep equally many samples, the one with the smallest mean miss.
    scale = float(SCALES[np.argmax((miss <= 0).mean(1) - 1e-4 * miss.mean(1))])
    scaled = np.minimum(scale * levels, 1.0)
    fine = thermal_model(plan.tube, plan.rig, FINE)
    counts = guarded_counts(fine, plan.spec, plan.rig, scaled)
    band = _band(plan, model, counts)
    if band.probability <= before.probability:
        return RobustSchedule(1.0, plan, before, before)
    history = simulate(fine, plan.spec.slot, scaled)
    run = Run(plan.rig, fine, scaled, history, plan.outcome.mesh, plan.hold_start)
    robust = HeatingPlan.of(plan.tube, plan.spec, checked(plan.spec, run, counts), plan.iterations)
    return RobustSchedule(scale, robust, band, before)


# --- feedback: gains and set-point, chosen on uncertain rigs ----------------------------------------------------------


# A quarter of a window of 50 K is 12 K: the bias is 2 K for a thermocouple, 9 K for a camera.
INSIDE = 0.25
"""Distance of the coldest point inside the window where a controlled hold begins, as a fraction of its width."""

# With 48 rigs the fraction in the window has a standard error of 7 %, enough to order five gains; the time is
# proportional to their number.
WIDE, RESERVE = 4.0, 1.25
"""Largest correction in the choice of gains, a fraction of the planned count, and factor on those that rigs require."""

DRAWING, DRAWING_RIGS = {"board": 1.0, "slope": 1.0, "conductivity": 1.0, "gap": -1.0}, 12
"""Draws with which a mold takes most heat, and number of such rigs for the largest count of a correction."""

BELOW_REFERENCE = 4.0
"""Smallest distance of the hold's floor below its reference, K: eight deviations of a thermocouple's noise."""

BARE_EXCESS, BARE_STEPS = 5.0, 5
"""Excess of the bare tube over the limit on these rigs, K: half of `MOST_EXCESS`; and bisections of that count."""

SHORTEST_BARE, BARE_STEP = 1e-3, 0.1e-3
"""Shortest length of bare tube that clamps leave, and the step of longer ones, m."""

BARE_RESERVE = 5.0
"""Distance of its hottest point from the limit on these rigs, K: 500 rigs on an independent model were up to 3.5 K
hotter. Twice as much forbids some tubes any length, as the curved part itself gets that hot."""

USUAL_GAIN = 2
"""Index in `KELVIN_GAINS` of the gains before any are chosen."""

RIGS = 48
"""Number of random rigs for the choice of gains and set-point; other rigs test them."""

SHIFTS = np.linspace(-25.0, 25.0, 201)
"""Set-points among which the best is chosen, K from the plan's."""

PROBE = 0.02
"""Relative increase of the planned duties for the simulated response of the reading."""

# The first shells of the mold warm up in about this time, and the power that the tube needs falls with it.
RESET = 8.0
"""Time after which a lasting error has cost as much as its instantaneous value, s."""

KELVIN_GAINS = (0.002, 0.005, 0.01, 0.02, 0.04)
"""Corrections that cost as much as an error of 1 K, 1/K, from gentle to quick gains."""


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

    The schedule of the plan is the feedforward. Gains and set-point maximise the probability of staying in the window.
    That probability is estimated on rigs that were not used to choose them.

    Args:
        plan: the plan to control; objective "margin" leaves the largest margin for feedback.
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
        >>> feedback = tubeopt.design_feedback(plan, tubeopt.Thermocouple(), samples=20)
        >>> feedback.probability > 0.8 > feedback.open_loop
        True
    """
    instance("sensor", sensor, Sensor)
    if samples < 20:
        raise InputError(f"samples is {samples}; it must be at least 20")
    uncertainty = Uncertainty.of_a_workshop() if uncertainty is None else uncertainty
    law = _tuned(plan, sensor, uncertainty, seed)
    rigs = uncertainty.ensemble(plan.tube, plan.rig, samples, sensor_bias=sensor.bias, seed=seed + 1)
    history = corrected(plan, law, sensor, run_loop(rigs.model, law, sensor, bias=rigs.bias, seed=seed))
    lowest, highest = (row[1:] for row in history.extremes(law))
    top = history.top.max(0)[1:]
    low, high = plan.spec.window_degC
    names = (*uncertainty.unknown, "sensor")
    longest, rest = math.inf, plan.rig.battery.voltage
    if math.isfinite(law.bare_count) or top.max() > plan.spec.limit + MOST_EXCESS:
        longest = longest_bare_tube(plan, sensor, uncertainty, law=law, seed=seed)
    return Feedback(
        sensor=sensor,
        law=law,
        uncertainty=uncertainty,
        history=history,
        lowest=lowest,
        highest=highest,
        top=top,
        kept=history.finished[1:] & (lowest >= low) & (highest <= high) & (top <= plan.spec.limit),
        open_loop=assess(plan, uncertainty, samples=samples).probability,
        contributions=_contributions(names, np.column_stack([rigs.draws, rigs.bias[1:]]), lowest, highest),
        window=plan.spec.window_degC,
        limit=plan.spec.limit,
        bare=(plan.rig.clamps.clearance, longest),
        volts=(rest, rest * math.sqrt(1 + lacking_power(law, history))),
    )


def lacking_power(law: HeatingLaw, history: LoopHistory) -> float:
    """Power that the rig lacks that full pulses leave coldest, as a fraction of its power; 0 if they suffice.

    Losses are in proportion to the rise over the surroundings, which full pulses held for the longest wait.
    """
    full = (history.count == MOST_COUNT).any(0) & ~history.finished
    start, last = law.reference.min(), law.hold[0]
    waited = np.where(history.index <= last, history.reading, -math.inf).max(0)
    risen = np.maximum(waited - start, 1.0)
    wanted = law.reference[min(last, len(law.reference) - 1)] - start
    return float(np.max(wanted / risen - 1, initial=0.0, where=full))


def nominal_law(plan: HeatingPlan, sensor: Sensor) -> HeatingLaw:
    """Law without feedback: the plan's schedule and the readings of the sensor under it.

    The minimum-time hold begins where the coldest point of the nominal rig has just reached the window. The law's hold
    begins once it is inside by `INSIDE`, so that other rigs have reached it too; if the plan never gets there, with the
    plan's hold. The last duty is prolonged by this delay.
    """
    slot, planned = plan.spec.slot, round(plan.hold_start / plan.spec.slot)
    low, high = plan.spec.window_degC
    coldest = plan.temperature[planned : planned + plan.spec.hold_slots // 2][:, plan.curved].min(1)
    inside = coldest >= low + INSIDE * (high - low)
    delay = int(np.argmax(inside)) if inside.any() else 0
    last = planned + plan.spec.hold_slots
    model = thermal_model(plan.tube, plan.rig, FINE)
    lost = COUNTS * plan.rig.circuit.lost_share
    commanded = prolonged(plan, last + delay)
    reference = readings(model, sensor, slot, commanded / COUNTS)[: last + delay, 0]
    held = slice(planned + delay, last)
    beyond = max(float(plan.temperature[held].max() - reference[held].max()), 0.0)
    above = max(float(reference[planned + delay] - plan.temperature[planned + delay, plan.curved].min()), 0.0)
    return HeatingLaw(
        slot=slot,
        planned=np.maximum(commanded - lost, 0.0),
        reference=reference,
        hold=(planned + delay, last + delay),
        proportional=0.0,
        integral=0.0,
        # Where the coldest point enters the window, the sensor of the nominal rig reads as much more.
        floor=low + above - 0.5 * sensor.quantum,
        # Also where the thermometer reads too little by its bias, and the hottest point is another one.
        ceiling=plan.spec.limit + min(OVERSHOOT, MOST_EXCESS - sensor.bias - beyond),
        lost=lost,
    )


def prolonged(plan: HeatingPlan, slots: int) -> Array:
    """(slots,) mean PWM counts of a plan's heating and hold; the last one is repeated."""
    last = round(plan.hold_end / plan.spec.slot)
    return np.append(plan.ideal_duty[:last], np.full(slots - last, plan.ideal_duty[last - 1]))


def _tuned(plan: HeatingPlan, sensor: Sensor, uncertainty: Uncertainty, seed: int) -> HeatingLaw:
    """Law with the gains and the set-point that keep most uncertain rigs in the window."""
    law = nominal_law(plan, sensor)
    plant = response(thermal_model(plan.tube, plan.rig, ENSEMBLE), sensor, law)
    rigs = uncertainty.ensemble(plan.tube, plan.rig, RIGS, sensor_bias=sensor.bias, seed=seed)
    best: tuple[float, HeatingLaw, LoopHistory] | None = None
    for correction_per_kelvin in KELVIN_GAINS:
        proportional, integral = regulator(plant, law.slot, correction_per_kelvin)
        trial = replace(law, proportional=proportional, integral=integral, share=WIDE)
        history = corrected(plan, trial, sensor, run_loop(rigs.model, trial, sensor, bias=rigs.bias, seed=seed))
        lowest, highest = history.extremes(trial)
        value, shift = _best_shift(plan, lowest, highest, history.top.max(0))
        if best is None or value > best[0]:
            best = value, shifted(trial, shift), history
    assert best is not None
    _, law, history = best
    # The authority that these rigs require: their lasting corrections, and the answer to an error without waiting.
    lasting = float(np.abs(history.total[:, history.finished]).max(initial=0.0))
    share = min(RESERVE * lasting + law.proportional * law.holdback, WIDE)
    # Time counts only where the tube is in the window although the sensor reads too much by its bias; a floor that the
    # reference hardly exceeds would never be reached.
    reachable = float(law.reference[slice(*law.hold)].min()) - BELOW_REFERENCE
    law = replace(law, share=share, floor=min(law.floor + sensor.bias, max(law.floor, reachable)))
    return replace(law, bare_count=_bare_count(plan, law, sensor, uncertainty, seed))


def _bare_count(plan: HeatingPlan, law: HeatingLaw, sensor: Sensor, uncertainty: Uncertainty, seed: int) -> float:
    """Largest effective count at which the bare tube keeps the limit on rigs whose molds draw most heat.

    Infinite if it keeps it at any correction.
    """
    model = uncertainty.model(plan.tube, plan.rig, _drawing(uncertainty, seed))
    limit = plan.spec.limit + BARE_EXCESS

    def hottest(count: float) -> float:
        trial = replace(law, bare_count=count)
        return float(run_loop(model, trial, sensor, bias=-sensor.bias, seed=seed).top.max())

    if hottest(math.inf) <= limit:
        return math.inf
    low = float(law.planned[law.hold[0] :].max())
    high = (1 + law.share) * float(law.planned.max())
    for _ in range(BARE_STEPS):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if hottest(middle) <= limit else (low, middle)
    return low


def _drawing(uncertainty: Uncertainty, seed: int) -> Array:
    """(S, number of `Uncertainty.unknown`) samples of rigs whose molds draw most heat."""
    draws = uncertainty.draws(DRAWING_RIGS, seed)
    for name, end in DRAWING.items():
        if name in uncertainty.unknown:
            draws[:, uncertainty.unknown.index(name)] = end
    return draws


@small
def longest_bare_tube(
    plan: HeatingPlan,
    sensor: Sensor,
    uncertainty: Uncertainty | None = None,
    *,
    law: HeatingLaw | None = None,
    seed: int = 0,
) -> float:
    """Longest bare tube (m) beside a clamp that keeps the limit on rigs whose molds draw most heat.

    A controller raises the power until the curved part has its temperature. Beside the clamps the same power meets no
    mold, and heats a long bare tube more. Infinite if the bare tube of the plan's rig keeps the limit; 0 if none of at
    least `SHORTEST_BARE` does.

    Args:
        uncertainty: of rig and tube; by default `Uncertainty.of_a_workshop()`.
        law: control law of the plan; by default one with usual gains.
    """
    uncertainty = Uncertainty.of_a_workshop() if uncertainty is None else uncertainty
    if law is None:
        law = nominal_law(plan, sensor)
        plant = response(thermal_model(plan.tube, plan.rig, ENSEMBLE), sensor, law)
        proportional, integral = regulator(plant, law.slot, KELVIN_GAINS[USUAL_GAIN])
        law = replace(law, proportional=proportional, integral=integral, share=WIDE)
    law, draws = replace(law, bare_count=math.inf), _drawing(uncertainty, seed)

    def keeps(length: float) -> bool:
        rig = replace(plan.rig, clamps=replace(plan.rig.clamps, clearance=length))
        history = run_loop(uncertainty.model(plan.tube, rig, draws), law, sensor, bias=-sensor.bias, seed=seed)
        return float(history.top.max()) <= plan.spec.limit - BARE_RESERVE

    if keeps(plan.rig.clamps.clearance):
        return math.inf
    # Bisection in whole steps: the hottest point rises with the length.
    low, high = SHORTEST_BARE, plan.rig.clamps.clearance
    if low >= high or not keeps(low):
        return 0.0
    while high - low > 1.5 * BARE_STEP:
        middle = BARE_STEP * round(0.5 * (low + high) / BARE_STEP)
        low, high = (middle, high) if keeps(middle) else (low, middle)
    return low


def _best_shift(plan: HeatingPlan, lowest: Array, highest: Array, top: Array) -> tuple[float, float]:
    """Best value over all set-points, and the shift (K) that has it.

    The value is the fraction of rigs in the window plus a little of the distance from the window's ends.
    """
    low, high = plan.spec.window_degC
    # A shift of the set-point moves all temperatures of the hold by it, to first order.
    below = lowest[:, None] + SHIFTS - low
    above = np.minimum(high - highest, plan.spec.limit - top)[:, None] - SHIFTS
    margin = np.clip(np.minimum(below, above), -50.0, 50.0)
    # Among equal fractions the one whose worst twentieth has the largest margin.
    value = (margin >= 0).mean(0) + 1e-3 * np.quantile(margin, 0.05, axis=0)
    best = int(np.argmax(value))
    return float(value[best]), float(SHIFTS[best])


def corrected(plan: HeatingPlan, law: HeatingLaw, sensor: Sensor, history: LoopHistory) -> LoopHistory:
    """History corrected by the difference of the fine grid on the nominal rig, at every slot of the schedule."""
    models = (thermal_model(plan.tube, plan.rig, grid) for grid in (FINE, ENSEMBLE))
    nominal = [run_loop(model, law, replace(sensor, noise=0.0)) for model in models]

    def difference(name: str) -> Array:
        slots = range(len(law.planned) + 1)
        fine, coarse = (np.interp(slots, h.index[:, 0], getattr(h, name)[:, 0]) for h in nominal)
        return np.asarray((fine - coarse)[np.minimum(history.index, len(law.planned))])

    names = ("coldest", "hottest", "top")
    return replace(history, **{name: getattr(history, name) + difference(name) for name in names})


def _contributions(names: Sequence[str], draws: Array, lowest: Array, highest: Array) -> tuple[Contribution, ...]:
    """Standard deviations of the mid-range temperature of the hold by each uncertain parameter, from a linear fit."""
    # A rig that never reached the hold has no temperatures.
    good = np.isfinite(lowest) & np.isfinite(highest)
    if good.sum() <= draws.shape[1] + 2:
        return ()
    middle, spread = 0.5 * (lowest[good] + highest[good]), draws[good].std(0)
    # The draws are independent, so a slope times its draw's deviation is that draw's own part.
    columns = np.column_stack([np.ones(int(good.sum())), draws[good]])
    slope = np.linalg.lstsq(columns, middle, rcond=None)[0][1:]
    contributions = [Contribution(name, float(abs(s) * w)) for name, s, w in zip(names, slope, spread, strict=True)]
    return tuple(sorted(contributions, key=lambda item: -item.deviation))


# --- gains: linear-quadratic regulator of the reading -----------------------------------------------------------------


@dataclass(frozen=True)
class Response:
    """First-order response of the reading to a relative change of the power."""

    gain: float
    """Final change of the reading per relative change of the power, K."""
    time_constant: float
    """Time constant, s."""


def readings(model: ThermalModel, sensor: Sensor, slot: float, duty: Array) -> Array:
    """(T + 1, B) readings of a sensor without bias and noise under duties (T,) in [0, 1], degC."""
    rigs = [MeasuredRig.at_rest(model, sensor)]
    for level in duty:
        rigs.append(rigs[-1].after(model, sensor, level, slot))
    return np.array([rig.lagged for rig in rigs])


def response(model: ThermalModel, sensor: Sensor, law: HeatingLaw) -> Response:
    """Response of the first member's reading in the hold to a relative change of the planned power."""
    first, last = law.hold
    duty = (law.planned + law.lost * (law.planned > 0)) / COUNTS
    raised = np.where(np.arange(len(duty)) < first, duty, duty * (1 + PROBE))
    nominal, stepped = (readings(model, sensor, law.slot, levels)[:, 0] for levels in (duty, raised))
    rise = (stepped - nominal)[first : last + 1] / PROBE
    gain = float(rise[-1])
    # The area between the step and its end is the time constant, whatever the shape is.
    return Response(gain, float(max(law.slot * np.sum(1 - rise / gain), law.slot)))


class Gains(NamedTuple):
    """Gains of a PI controller."""

    proportional: float
    """1/K."""
    integral: float
    """1/(K s)."""


def regulator(plant: Response, slot: float, correction_per_kelvin: float) -> Gains:
    """Gains of the linear-quadratic regulator of error and integrated error.

    They minimise the sum over slots of e^2 + (sum of e / RESET)^2 + (correction / correction_per_kelvin)^2 by the
    algebraic Riccati equation.
    """
    # First order over one slot: e' = a e - gain (1 - a) correction, and the integral grows by slot times e.
    a = float(np.exp(-slot / plant.time_constant))
    A = np.array([[a, 0.0], [slot, 1.0]])
    B = np.array([[-plant.gain * (1 - a)], [0.0]])
    Q, R = np.diag([1.0, 1 / RESET**2]), np.array([[1 / correction_per_kelvin**2]])
    P = scipy.linalg.solve_discrete_are(A, B, Q, R)
    # correction = -K (e, integral) with K = (R + B' P B)^-1 B' P A, negative as power reduces e.
    K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)[0]
    return Gains(float(-K[0]), float(-K[1]))
