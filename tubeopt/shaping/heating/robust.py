"""How sure a heating schedule is: tables by the battery's charge, and an ensemble over what is not known of the rig."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...errors import InputError
from ...physics.heat import Resolution
from ...typing import Array
from .counts import Counts, guarded_counts, sum_up_rounding
from .outcome import hold_slots
from .plan import HeatingPlan
from .rig import COUNTS
from .schedule import Run, checked
from .simulation import State, current, resimulate, simulate, simulate_feedback
from .thermal import FINE, ThermalModel, seen, thermal_model
from .uncertainty import Uncertainty

ENSEMBLE = Resolution(2, 4, 6, 8, 6)
"""Grid of the ensemble; what the fine grid adds is taken from the nominal member."""

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
    probability: float
    """Of keeping window and limit."""
    too_cold: float
    """Probability of falling below the window."""
    too_hot: float
    """Probability of exceeding its upper end or the limit."""

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
    model, _ = (uncertainty or Uncertainty.of_a_workshop()).models(plan.tube, plan.rig, samples, ENSEMBLE)
    return _band(plan, model, plan.duty[:-1])


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
    model, _ = uncertainty.models(plan.tube, plan.rig, samples, ENSEMBLE)
    levels = plan.ideal_duty[:-1] / COUNTS
    low, high = (_band(plan, model, sum_up_rounding(np.minimum(scale * levels, 1.0))) for scale in PROBES)
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
