"""A plan that shortfall_of its window names what stopped it, and never answers with no heating at all."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from tests.command_line import ROOT
from tubeopt import HeatingPlan, HeatingSpec, Rig, Tube, load_rig, load_robot, plan_heating
from tubeopt.shaping.heating.counts import guarded_counts
from tubeopt.shaping.heating.simulation import resimulate
from tubeopt.shaping.heating.thermal import FINE, thermal_model
from tubeopt.shaping.materials import GLASS_MICA, STEEL

from .heating_reference import TUBE, thesis_rig, with_mold
from .test_heating_least_miss import shortfall_of

RIG = load_rig(ROOT / "configs" / "rigs" / "thesis_mdf.yaml")
THIN = load_robot(ROOT / "configs" / "robots" / "crl_ctr.yaml").tubes[1]
SHORT = HeatingSpec(hold_time=10.0, longest_heating=30.0)


def with_circuit(rig: Rig, **limits: float) -> Rig:
    return replace(rig, circuit=replace(rig.circuit, **limits))


def with_volts(rig: Rig, factor: float) -> Rig:
    table = tuple((charge, factor * volt) for charge, volt in rig.battery.open_circuit)
    return replace(rig, battery=replace(rig.battery, open_circuit=table))


def fastest(rig: Rig, tube: Tube, spec: HeatingSpec, counts: list[int]) -> float:
    """Fastest warming of a tube by counts, K/s."""
    within = resimulate(thermal_model(tube, rig, FINE), spec.slot, np.array(counts) / 255).within
    assert within is not None
    return within.rate


@lru_cache(maxsize=1)
def thin_in_steel() -> tuple[Rig, HeatingPlan]:
    rig = with_circuit(with_mold(RIG, material=STEEL), peak_limit=600.0)
    return rig, plan_heating(THIN, rig, SHORT, cures=False)


def test_a_rig_on_which_one_count_breaks_the_ramp_late_in_its_slot_is_heated() -> None:
    # At rest 14 counts keep the ramp; what contacts give the tube in the clamps breaks it a tenth of a second later.
    rig, plan = thin_in_steel()
    assert plan.duty.any()
    assert plan.lowest > 30.0
    (words,) = plan.broken
    assert f"the tube warms at up to {plan.steepest:.1f} K/s, beyond the ramp of 20 K/s" in words
    assert "a single count is too coarse for it" in words
    # No schedule that heats breaks the ramp by less than one count does in one slot.
    one = fastest(rig, THIN, SHORT, [1])
    assert one > SHORT.ramp
    assert one <= plan.steepest + 1e-6 < 1.01 * one
    assert plan.mean_current <= rig.circuit.current_limit


@pytest.mark.parametrize("rise", [0.2, 0.5, 0.8])
def test_no_line_of_counts_on_that_rig_misses_by_less(rise: float) -> None:
    rig, plan = thin_in_steel()
    counts = np.floor(23 * np.minimum((1 + np.arange(80)) / (rise * 80), 1.0))
    assert shortfall_of(rig, THIN, replace(SHORT, ramp=1.02 * plan.steepest), counts, plan) > 0.99 * plan.shortfall


def test_a_mean_current_below_that_of_one_count_is_broken_by_one_count() -> None:
    rig = with_circuit(thesis_rig(), current_limit=0.2)
    plan = plan_heating(TUBE, rig, SHORT, cures=False)
    assert set(plan.duty.tolist()) == {0, 1}
    assert "the mean current reaches" in " ".join(plan.broken)


CASES = [
    (with_mold(thesis_rig(), material=STEEL), TUBE, SHORT, {"current"}),
    (with_circuit(thesis_rig(), current_limit=1.0), TUBE, SHORT, {"current"}),
    (thesis_rig(), TUBE, replace(SHORT, ramp=12.0), {"ramp"}),
    (with_volts(thesis_rig(), 0.16), TUBE, SHORT, {"duty"}),
    (with_mold(thesis_rig(), lead=4e-3), TUBE, HeatingSpec((480.0, 500.0), 20.0), {"limit"}),
    (with_mold(thesis_rig(), material=GLASS_MICA), TUBE, replace(SHORT, longest_heating=60.0), {"limit"}),
]
WORDS = {
    "current": "the mean current of",
    "ramp": "the ramp of",
    "duty": "the switch conducts all the time",
    "limit": "the hottest point of the tube reaches",
}


@pytest.mark.parametrize(("rig", "tube", "spec", "named"), CASES)
def test_a_missed_window_names_what_stopped_it(rig: Rig, tube: Tube, spec: HeatingSpec, named: set[str]) -> None:
    plan = plan_heating(tube, rig, spec, cures=False)
    assert plan.shortfall > 0
    assert plan.duty.any()
    said = {limit for limit, words in WORDS.items() if any(words in reason for reason in plan.reasons)}
    assert named <= said
    (problem,) = (words for words in plan.problems if words.startswith("the window is missed by"))
    assert all(reason in problem for reason in plan.reasons)
    # What is named stops the plan: with more of it the window is missed by less.
    more = {
        "current": (with_circuit(rig, current_limit=1.5 * rig.circuit.current_limit), spec),
        "ramp": (rig, replace(spec, ramp=1.5 * spec.ramp)),
        "duty": (with_volts(rig, 1.3), spec),
        "limit": (rig, replace(spec, limit_degC=spec.limit + 30.0)),
    }
    for limit in named:
        other, asked = more[limit]
        assert plan_heating(tube, other, asked, cures=False).shortfall < plan.shortfall - 1.0
    near = plan.hottest + plan.outcome.mesh.hottest > spec.limit - 5.0
    assert near == ("limit" in said)
    if not near:
        # What is not named does not.
        for limit in {"current", "ramp"} - said:
            other, asked = more[limit]
            assert plan_heating(tube, other, asked, cures=False).shortfall > plan.shortfall - 1.0


@pytest.mark.parametrize("slot", [0.05, 0.5, 2.0])
@pytest.mark.parametrize("rig", [thesis_rig(), with_volts(thesis_rig(), 2.0), with_mold(RIG, material=STEEL)])
@pytest.mark.parametrize("lost", [0.0, 31e-6])
def test_counts_never_stop_heating_for_ever(rig: Rig, slot: float, lost: float) -> None:
    # A tube that needs heat gets counts after any time, whatever the slot, the battery and the mold.
    spec, rig = replace(SHORT, slot=slot), with_circuit(rig, lost_on_time=lost)
    for tube in (TUBE, THIN):
        duty = np.full(round(20.0 / slot), 2 / 255 + rig.circuit.lost_share)
        counts = guarded_counts(thermal_model(tube, rig, FINE), spec, rig, duty)
        assert counts.max() / 255 > rig.circuit.lost_share
        assert counts[len(counts) // 2 :].max() / 255 > rig.circuit.lost_share


def test_a_window_that_is_kept_needs_no_reason() -> None:
    plan = plan_heating(TUBE, thesis_rig(), HeatingSpec(hold_time=5.0), cures=False)
    assert plan.feasible
    assert plan.reasons == plan.problems == ()
