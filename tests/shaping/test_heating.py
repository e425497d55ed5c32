"""Heating plans: what they promise holds for another integrator on a finer grid, and what they cannot do they say."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tubeopt import HeatingPlan, HeatingSpec, InputError, Material, Rig, Tube, plan_heating
from tubeopt.physics.heat import GRIP
from tubeopt.shaping.heating.counts import sum_up_rounding
from tubeopt.shaping.heating.outcome import outcome_of
from tubeopt.shaping.heating.plan import arduino_header, schedule_csv
from tubeopt.shaping.heating.rig import Battery, Circuit, Clamps, MoldBed
from tubeopt.shaping.heating.robust import Uncertainty, assess, at_charge, charge_tables, most_likely
from tubeopt.shaping.heating.simulation import History, resimulate, warming
from tubeopt.shaping.heating.thermal import FINE, ThermalModel, curved_temperatures, thermal_model
from tubeopt.shaping.materials import GLASS_MICA, MDF

from .heating_reference import TUBE, header_duties, integrate, thesis_plan, thesis_rig, with_mold

ZERO = 273.15


PARTS = 20
"""Times in every slot at which a plan is looked at on a finer grid."""


@lru_cache(maxsize=8)
def finer(plan: HeatingPlan) -> tuple[ThermalModel, History]:
    """What the counts of a plan do on a finer grid."""
    model = thermal_model(plan.tube, plan.rig, replace(FINE, clearance=8, lead=18, curved=24, shells=18))
    return model, integrate(model, plan.spec.slot / PARTS, np.repeat(plan.duty[:-1] / 255, PARTS), rtol=1e-5)


def resimulated(plan: HeatingPlan) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Temperatures (degC) of the curved part in the hold, and of all at all times, on a finer grid."""
    model, history = finer(plan)
    tube = history.tube[::PARTS, 0]
    return curved_temperatures(model, tube[plan.in_hold]) - ZERO, tube - ZERO


def with_resistor(rig: Rig, ohm: float) -> Rig:
    """The rig with a resistor in series."""
    return replace(rig, circuit=replace(rig.circuit, cable_resistance=rig.circuit.cable_resistance + ohm))


def replayed(plan: HeatingPlan) -> tuple[float, float, float]:
    """Fastest warming (K/s) outside of the clamps, greatest mean current and current (A), at fine times, finer grid."""
    model, history = finer(plan)
    duty = np.repeat(plan.duty[:-1] / 255, PARTS)
    warming = np.diff(history.tube[:, 0][:, model.zone > 0], axis=0).max() / (plan.spec.slot / PARTS)
    return float(warming), float((history.current[:-1, 0] * duty).max()), float(history.current.max())


def test_the_thesis_tube_is_held_in_the_window() -> None:
    plan = thesis_plan()
    assert plan.feasible
    assert plan.shortfall == 0.0
    held, everything = resimulated(plan)
    assert held.min() >= 500.0
    assert held.max() <= 550.0
    assert everything.max() <= 550.0
    assert np.abs(held.max() - plan.highest) < 2 * plan.mesh_error


def test_its_arrays_belong_together() -> None:
    plan = thesis_plan()
    t, x = len(plan.time), len(plan.position)
    assert plan.duty.shape == plan.ideal_duty.shape == plan.voltage.shape == (t,)
    assert plan.temperature.shape == plan.ideal_temperature.shape == (t, x)
    assert plan.duty.dtype == np.int64
    assert plan.duty.min() >= 0
    assert plan.duty.max() <= 255
    assert plan.duty[-1] == 0
    np.testing.assert_allclose(np.diff(plan.time), 0.5)
    np.testing.assert_allclose(plan.temperature, plan.temperature[:, ::-1])
    assert plan.temperature[0] == pytest.approx(25.0)
    held = plan.temperature[plan.in_hold][:, plan.curved]
    assert held.min() >= plan.lowest - 1e-9
    assert held.max() == pytest.approx(plan.highest)
    assert plan.hold_end - plan.hold_start == 60.0
    assert plan.position[plan.curved][0] > 0.035
    assert plan.table_length == round(plan.hold_end / 0.5)


def test_counts_follow_the_ideal_duty() -> None:
    plan = thesis_plan()
    assert plan.rounding_error < 10.0
    owed = np.cumsum(plan.duty - plan.ideal_duty)[: plan.table_length]
    # The ramp may hold counts back while the tube warms up; the sum is never ahead by more than half a count.
    assert owed.max() <= 0.5 + 1e-9
    assert owed.min() >= -1.5 - 1e-9
    assert np.abs(owed[round((plan.hold_start + 10) / 0.5) :]).max() <= 0.5 + 1e-9
    hold = plan.duty[plan.in_hold][:-1]
    assert 5 <= hold.min() <= hold.max() <= 30


def test_energy_balance_and_mesh_error() -> None:
    plan = thesis_plan()
    assert plan.energy_error < 1e-3
    assert 0 < plan.mesh_error < 3.0
    assert plan.pwm_ripple < 1.0
    assert 0 < plan.tube_energy < plan.energy


def test_cold_ends_reach_some_way_from_the_clamps() -> None:
    plan = thesis_plan()
    row = plan.temperature[plan.in_hold][-1]
    from_clamp = plan.position - plan.rig.clamps.grip
    half = len(row) // 2
    assert np.interp(500.0, row[:half], from_clamp[:half]) == pytest.approx(plan.cold_end, abs=1e-4)
    assert 5e-3 < plan.cold_end < 25e-3
    assert plan.extra_length == pytest.approx(70e-3)
    assert 0.5e-3 < plan.growth < 2e-3
    assert plan.quench_time < 2.0


def test_mdf_chars() -> None:
    mdf = plan_heating(TUBE, with_mold(thesis_rig(), material=MDF), HeatingSpec(hold_time=3))
    assert any("mdf chars above 300 degC" in words for words in mdf.problems)
    assert mdf.mold_temperature.max() > 300


def test_a_window_that_cannot_be_held_is_answered_with_the_best_and_a_cure() -> None:
    plan = plan_heating(TUBE, with_mold(thesis_rig(), lead=4e-3), HeatingSpec(hold_time=5))
    assert not plan.feasible
    assert plan.hottest + plan.mesh_error <= 550.0 + 1e-9
    assert plan.shortfall == pytest.approx(500 - plan.lowest + plan.outcome.mesh.hold)
    cured = [cure for cure in plan.cures if cure.cures]
    assert cured
    assert "lead of" in cured[0].change
    lead = float(cured[0].change.split("lead of ")[1].split(" mm")[0]) / 1e3
    assert 4e-3 < lead <= 60e-3


@pytest.mark.parametrize(
    ("tube", "spec", "ohm"),
    [
        (Tube(0.9e-3, 0.6e-3, 0.2, 0.04, 25.0), HeatingSpec(hold_time=5, slot=0.25), 0.2),
        (Tube(2.6e-3, 2.2e-3, 0.1, 0.12, 6.0), HeatingSpec(hold_time=5, objective="energy"), 0.0),
        (Tube(1.92e-3, 1.57e-3, 0.0, 0.06, 8.0), HeatingSpec((510, 540), 8.3, limit_degC=545), 0.0),
    ],
)
def test_other_tubes_and_windows(tube: Tube, spec: HeatingSpec, ohm: float) -> None:
    plan = plan_heating(tube, with_resistor(thesis_rig(), ohm), spec)
    assert plan.feasible, plan.cures
    held, everything = resimulated(plan)
    low, high = spec.window_degC
    assert held.min() >= low
    assert held.max() <= high
    assert everything.max() <= spec.limit
    assert plan.energy_error < 1e-3


def test_free_lead_and_vents_even_out_the_temperature() -> None:
    """With a lead of 12 mm the curved part has 11 K of difference, most of it at its ends."""
    spec = HeatingSpec(hold_time=5, objective="margin", free=("lead", "vents"))
    free = plan_heating(TUBE, with_mold(thesis_rig(), lead=12e-3), spec)
    assert free.highest - free.lowest < 6.0
    assert free.rig.mold.lead > 12e-3
    assert len(free.rig.mold.vents) == 6
    assert 0 <= min(free.rig.mold.vents) <= max(free.rig.mold.vents) <= 0.4
    assert free.feasible


def test_the_ramp_is_kept_by_whole_counts() -> None:
    plan = thesis_plan()
    warming = np.diff(plan.temperature[:, plan.zone > 0], axis=0) / plan.spec.slot
    assert warming.max() == pytest.approx(plan.ramp)
    assert plan.ramp <= plan.spec.ramp
    assert not plan.problems


def test_no_other_counts_are_sooner() -> None:
    plan = thesis_plan()
    first = round(plan.hold_start / plan.spec.slot)
    model = thermal_model(TUBE, thesis_rig(), FINE)
    # More power never makes anything colder: one more count in any slot breaks the ramp, so that no schedule is more
    # than a slot sooner, but for what is kept below the ramp and above the window's low end.
    for k in range(0, first, 7):
        more = plan.duty[:-1] / 255
        more[k] += 1 / 255
        there = resimulate(model, plan.spec.slot, more[: k + 1])
        ends = (warming(model, *vars(there.state(at)).values(), more[k]) for at in (k, k + 1))
        assert max(rate[0, model.zone > GRIP, 0].max() for rate in ends) > 0.97 * plan.spec.ramp
    before = plan.temperature[first - 2][plan.curved]
    assert before.min() < plan.spec.window_degC[0]


def test_counts_too_coarse_for_the_ramp_are_told() -> None:
    """At 24 V a count is worth four times the power: the window is kept, but nobody may call that held."""
    rig = thesis_rig()
    table = tuple((charge, 2 * volt) for charge, volt in rig.battery.open_circuit)
    plan = plan_heating(TUBE, replace(rig, battery=replace(rig.battery, open_circuit=table)), HeatingSpec(hold_time=5))
    assert plan.shortfall == 0
    assert not plan.feasible
    assert plan.steepest >= plan.ramp > plan.spec.ramp
    (words,) = plan.broken
    assert f"warms at up to {plan.steepest:.1f} K/s, beyond the ramp of 20 K/s" in words
    assert words in plan.problems
    assert plan.verdict == f"exceeds limits: {plan.steepest:.1f} K/s (limit 20)"
    resistor = plan.cures[0]
    assert resistor.cures
    ohm = float(resistor.change.split(" of ")[1].split(" mohm")[0]) / 1e3
    cured = plan_heating(TUBE, with_resistor(plan.rig, ohm), HeatingSpec(hold_time=5))
    assert cured.feasible
    assert replayed(cured)[0] <= 20.0


@pytest.mark.parametrize(("limit", "value"), [("current_limit", 0.5), ("peak_limit", 80.0)])
def test_what_the_circuit_does_not_bear_is_not_held(limit: str, value: float) -> None:
    rig = thesis_rig()
    strained = replace(thesis_plan(), rig=replace(rig, circuit=replace(rig.circuit, **{limit: value})))
    outcome = outcome_of(
        thermal_model(TUBE, rig, FINE),
        strained.rig,
        strained.spec,
        resimulate(thermal_model(TUBE, rig, FINE), 0.5, strained.duty[:-1] / 255),
        strained.hold_start,
    )
    assert outcome.shortfall == 0
    assert not outcome.feasible
    assert f"{value:g} A" in outcome.broken[0]


def test_limits_hold_at_all_times_for_another_grid() -> None:
    plan = thesis_plan()
    warming, mean, peak = replayed(plan)
    assert warming <= plan.spec.ramp
    assert warming == pytest.approx(plan.steepest, abs=0.5)
    assert mean == pytest.approx(plan.mean_current, rel=0.01)
    assert peak == pytest.approx(plan.peak_current, rel=0.01)


def test_a_thick_tube_and_a_mold_that_draws_too_much_are_answered() -> None:
    strong = replace(thesis_rig(), circuit=replace(thesis_rig().circuit, peak_limit=500.0))
    thick = plan_heating(Tube(4e-3, 3.2e-3, 0.0, 0.12, 10.0), strong, HeatingSpec(hold_time=5))
    assert thick.feasible
    assert thick.iterations < 60
    mica = plan_heating(TUBE, with_mold(thesis_rig(), material=GLASS_MICA), HeatingSpec(hold_time=5))
    assert not mica.feasible
    assert mica.hottest <= 550.0
    assert mica.iterations < 100


def test_the_current_limit_is_kept() -> None:
    rig = thesis_rig()
    rig = replace(rig, circuit=replace(rig.circuit, current_limit=4.0))
    plan = plan_heating(TUBE, rig, HeatingSpec(hold_time=5))
    mean = plan.current * plan.duty / 255
    assert mean.max() <= 4.0
    assert not plan.problems
    assert plan.hold_start >= thesis_plan().hold_start


# --- counts -----------------------------------------------------------------------------------------------------------


@given(st.lists(st.floats(0, 1), min_size=1, max_size=200))
def test_sum_up_rounding_never_owes_more_than_half_a_count(duty: list[float]) -> None:
    duty = [max(value, 1e-9) for value in duty]
    counts = sum_up_rounding(duty)
    assert ((counts >= 0) & (counts <= 255)).all()
    assert np.abs(np.cumsum(counts) - 255 * np.cumsum(duty)).max() <= 0.5 + 1e-6
    assert np.abs(counts - 255 * np.array(duty)).max() <= 1 + 1e-6


@pytest.mark.parametrize("duty", [[-0.1], [1.1], [math.nan], [[0.1]]])
def test_sum_up_rounding_refuses_what_is_no_duty(duty: Any) -> None:
    with pytest.raises(InputError, match="duty must be a list of numbers from 0 to 1"):
        sum_up_rounding(duty)


# --- charge and uncertainty -------------------------------------------------------------------------------------------


def test_tables_for_every_charge_hold_the_window() -> None:
    tables = charge_tables(thesis_plan(), (1.0, 0.6))
    volts = [table.rig.battery.voltage for table in tables]
    assert volts == pytest.approx([12.73, 12.24])
    for table in tables:
        assert table.feasible
        assert 500 <= table.lowest <= table.highest <= table.hottest <= 550
    # The same heat from less voltage takes more duty.
    assert tables[1].ideal_duty.sum() / tables[0].ideal_duty.sum() == pytest.approx((12.73 / 12.24) ** 2, rel=0.02)
    np.testing.assert_allclose(tables[1].ideal_temperature, tables[0].ideal_temperature, atol=2.0)


def test_a_battery_that_is_too_weak_is_told() -> None:
    rig = thesis_rig()
    tube = Tube(1.92e-3, 1.57e-3, 0.0, 0.4, 2.0)
    strong = replace(rig, battery=replace(rig.battery, open_circuit=((0.1, 4.0), (1.0, 16.0))))
    plan = plan_heating(tube, strong, HeatingSpec(hold_time=5))
    assert plan.feasible
    assert not at_charge(plan, 0.1).feasible


def test_the_band_over_uncertain_rigs() -> None:
    plan = thesis_plan()
    band = assess(plan, Uncertainty(), samples=16)
    assert band.coldest.shape == band.hottest.shape == (len(plan.time), 16)
    assert band.probability + band.too_cold + band.too_hot >= 1 - 1e-9
    assert 0 < band.probability < 0.6  # 15 % of loss are some 75 K of 500, the window has 50
    lower, upper = band.quantiles()
    assert (lower <= upper + 1e-9).all()
    certain = assess(plan, Uncertainty(1e-6, 1e-6, 1e-6), samples=2)
    assert certain.probability == 1.0
    assert certain.lowest == pytest.approx(plan.lowest, abs=0.05)
    assert certain.highest == pytest.approx(plan.highest, abs=0.05)


def test_the_most_likely_schedule_is_no_worse() -> None:
    plan = thesis_plan()
    better = most_likely(plan, Uncertainty(0.05, 0.1, 0.01), samples=8)
    assert better.band.probability >= better.before.probability
    assert better.band.probability > 0.3
    assert 0.8 < better.scale < 1.2


def test_ensembles_refuse_nonsense() -> None:
    with pytest.raises(InputError, match="samples is 1; it must be at least 2"):
        assess(thesis_plan(), samples=1)
    with pytest.raises(InputError, match=r"loss of the uncertainty is 1; it must be at most 0\.99"):
        Uncertainty(loss=1.0)


# --- files ------------------------------------------------------------------------------------------------------------


def test_header_and_table_hold_the_same_bytes() -> None:
    plan = thesis_plan()
    lines = [line for line in schedule_csv(plan).splitlines() if not line.startswith("#")]
    column = lines[0].split(",").index("duty")
    duties = [int(line.split(",")[column]) for line in lines[1:]]
    assert duties == plan.duty.tolist() == header_duties(arduino_header(plan))


def test_a_header_needs_whole_milliseconds() -> None:
    with pytest.raises(
        InputError, match=r"slot is 0.0333333 s; for an Arduino it must be a whole number of milliseconds"
    ):
        arduino_header(replace(thesis_plan(), spec=HeatingSpec(slot=1 / 30)))


# --- what is refused --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"window_degC": (550, 500)}, "window_degC is 550 degC to 500 degC; the first must be below the second"),
        ({"limit_degC": 540}, "window_degC is 500 to 550 degC; it must end below the limit of 540 degC"),
        ({"window_degC": 500}, "window_degC is 500; it must be 2 numbers (the least and the greatest)"),
        ({"window_degC": (20, 40)}, "it must begin at 50 degC or above"),
        ({"window_degC": (1000, 1300)}, "window_degC ends at 1300 degC; it must be at most 1200 degC"),
        ({"hold_time": 0.5}, "hold_time is 0.5 s; it must be at least 1 s"),
        ({"hold_time": 1e6}, "hold_time is 1e+06 s; it must be at most 1800 s"),
        ({"free": None}, "free is None; it must be a list of any of clearance, lead, vents"),
        ({"free": "lead"}, "free is 'lead'; it must be a list of any of clearance, lead, vents"),
        ({"hold_time": math.nan}, "hold_time is nan; it must be a finite number"),
        ({"ramp": 0}, "ramp is 0; it must be greater than 0"),
        ({"slot": 10}, "slot is 10 s; it must be 0.02 to 5 s"),
        ({"objective": "speed"}, "objective is 'speed'; it must be one of time, energy, margin"),
        ({"quench": "oil"}, "quench is 'oil'; it must be one of water, air"),
        ({"free": ("leads",)}, "free is 'leads'; it must be one of clearance, lead, vents; did you mean 'lead'?"),
        ({"most_vent": 0.7}, "most_vent is 0.7; it must be at most 0.5"),
    ],
)
def test_bad_specifications(values: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        HeatingSpec(**values)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Rig(battery=None), "battery of the rig is None; it must be a Battery"),  # type: ignore[arg-type]
        (lambda: Battery(internal_resistance=-0.01), "internal_resistance of the battery is -0.01; it must be greater"),
        (lambda: Battery(state_of_charge=1.2), "state_of_charge of the battery is 1.2; it must be at most 1"),
        (lambda: Battery(open_circuit=((0.1, 12.0),)), "open_circuit of the battery must be at least 2 pairs"),
        (lambda: Battery(open_circuit=((0.1, 12.0), (1.0, 11.0))), "must increase in charge and in voltage"),
        (lambda: Circuit(contact_resistance=-1), "contact_resistance of the circuit is -1; it must be at least 0"),
        (lambda: Clamps(grip=0), "grip of the clamps is 0; it must be greater than 0"),
        (lambda: MoldBed(vents=(0.7,)), "vents of the mold are [0.7]; they must be fractions from 0 to 0.5"),
        (lambda: Rig(loss_factor=0), "loss_factor of the rig is 0; it must be greater than 0"),
        (lambda: Battery(open_circuit="abc"), "open_circuit of the battery must be at least 2 pairs"),  # type: ignore[arg-type]
        (lambda: MoldBed(material="wood"), "mold material is 'wood'; it must be one of steel"),  # type: ignore[arg-type]
        (lambda: MoldBed(material=None), "material of the mold is None; it must be a MoldMaterial"),  # type: ignore[arg-type]
        (lambda: Rig(tube=5), "tube of the rig is 5; it must be a Tube"),  # type: ignore[arg-type]
        (lambda: plan_heating(None, Rig()), "tube is None; it must be a Tube"),  # type: ignore[arg-type]
        (lambda: plan_heating(TUBE, Rig(), 5), "spec is 5; it must be a HeatingSpec"),  # type: ignore[arg-type]
        (lambda: Battery().charge_at(14.0), "voltage of the battery is 14 V; it must be 11.51 to 12.73 V"),
    ],
)
def test_bad_rigs(make: Any, message: str) -> None:
    with pytest.raises(InputError) as caught:
        make()
    assert message in str(caught.value)


def test_bad_tubes() -> None:
    steel = Material("steel", 200e9, 80e9)
    with pytest.raises(InputError, match="material 'steel' is"):
        plan_heating(replace(TUBE, material=steel), thesis_rig())
    with pytest.raises(InputError, match="shape-set must have a curved part"):
        plan_heating(Tube(1e-3, 0.8e-3, 0.1, 0.0, 0.0), thesis_rig())
    with pytest.raises(InputError, match="that is too small to surround"):
        plan_heating(TUBE, with_mold(thesis_rig(), width=3e-3, thickness=3e-3))
    plain = replace(TUBE, material=replace(TUBE.material, thermal=None))
    with pytest.raises(InputError, match="material 'nitinol' has no thermal data"):
        plan_heating(plain, thesis_rig())
    with pytest.raises(InputError, match=r"ambient of the rig is 873\.15; it must be at most 333\.15"):
        replace(thesis_rig(), ambient=873.15)
    with pytest.raises(InputError, match="ambient of the rig is 55 degC; it must be below the window"):
        plan_heating(TUBE, replace(thesis_rig(), ambient=328.15), HeatingSpec(window_degC=(52.0, 90.0), hold_time=2))
    with pytest.raises(InputError, match="rig is None; it must be a Rig"):
        plan_heating(TUBE, None)  # type: ignore[arg-type]


def test_open_circuit_voltage_there_and_back(caplog: pytest.LogCaptureFixture) -> None:
    battery = Battery()
    for charge in (0.1, 0.37, 1.0):
        assert battery.charge_at(replace(battery, state_of_charge=charge).voltage) == pytest.approx(charge)
    assert battery.charge_at(13.1) == 1.0
    assert "voltage is 13.1 V, above 12.73 V" in caplog.text
    assert Battery(state_of_charge=0.65).voltage_slope == pytest.approx(1.3)
