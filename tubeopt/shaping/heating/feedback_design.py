"""The law by which a sensor leads a heating: gains and set-point from the model, chosen on uncertain rigs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from ...errors import InputError, instance
from ...solvers.blas import small
from ...solvers.time_limit import TIME_LIMIT, limited
from ...typing import Array
from .controller import Contribution, Feedback, HeatingLaw, LoopHistory, run_loop, shifted
from .plan import HeatingPlan
from .rig import COUNTS
from .robust import ENSEMBLE, assess
from .sensors import Felt, Sensor
from .thermal import FINE, ThermalModel, thermal_model
from .uncertainty import Uncertainty

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
    fleet, bias, draws = fleet_of(plan, sensor, unknown, samples, seed + 1)
    history = corrected(plan, law, sensor, run_loop(fleet, law, sensor, bias=bias, seed=seed))
    lowest, highest = (row[1:] for row in history.extremes(law))
    top = history.top.max(0)[1:]
    low, high = plan.spec.window_degC
    kept = history.finished[1:] & (lowest >= low) & (highest <= high) & (top <= plan.spec.limit)
    names = (*unknown.unknown, "sensor")
    return Feedback(
        sensor=sensor, law=law, uncertainty=unknown, history=history, lowest=lowest, highest=highest, top=top,
        kept=kept, open_loop=assess(plan, unknown, samples=samples).probability,
        contributions=_contributions(names, np.column_stack([draws, bias[1:]]), lowest, highest),
        window=plan.spec.window_degC, limit=plan.spec.limit,
    )  # fmt: skip


def fleet_of(
    plan: HeatingPlan, sensor: Sensor, unknown: Uncertainty, samples: int, seed: int
) -> tuple[ThermalModel, Array, Array]:
    """The rig of a plan and `samples` others, the biases of their sensors, and the draws of the others."""
    model, draws = unknown.models(plan.tube, plan.rig, samples, ENSEMBLE, seed)
    bias = sensor.bias * np.random.default_rng(seed).uniform(-1, 1, samples)
    return model, np.concatenate([[0.0], bias]), draws


def nominal_law(plan: HeatingPlan, sensor: Sensor) -> HeatingLaw:
    """The plan's schedule and what the sensor should read of it, not yet corrected.

    The soonest hold begins where the coldest point has just reached the window, which another rig's has not: the law's
    begins once it is inside by `law_inside`, or, where the plan never gets there, when the plan's does; the last duty
    goes on for as long as it began later.
    """
    slot, planned = plan.spec.slot, round(plan.hold_start / plan.spec.slot)
    low, high = plan.spec.window_degC
    coldest = plan.temperature[planned : planned + plan.spec.hold_slots // 2][:, plan.curved].min(1)
    well = coldest >= low + plan.spec.solver.law.inside * (high - low)
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
    fleet, bias, _ = fleet_of(plan, sensor, unknown, plan.spec.solver.law.rigs, seed)
    best: tuple[float, HeatingLaw] | None = None
    for share in (0.002, 0.005, 0.01, 0.02, 0.04):  # per K, from gentle to quick
        proportional, integral = regulator(found, law.slot, share)
        trial = replace(law, proportional=proportional, integral=integral)
        history = corrected(plan, trial, sensor, run_loop(fleet, trial, sensor, bias=bias, seed=seed))
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
    kept = float(np.exp(-slot / found.time_constant))
    A = np.array([[kept, 0.0], [slot, 1.0]])
    B = np.array([[-found.gain * (1 - kept)], [0.0]])
    Q, R = np.diag([1.0, 1 / RESET**2]), np.array([[1 / share_per_kelvin**2]])
    P = scipy.linalg.solve_discrete_are(A, B, Q, R)
    gains = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)[0]
    return float(-gains[0]), float(-gains[1])
