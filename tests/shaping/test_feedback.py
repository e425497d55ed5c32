"""Heatings that a sensor leads: the law, its gains, and what becomes of rigs that are not as filed."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tubeopt import (
    Camera,
    Feedback,
    HeatingPlan,
    HeatingSpec,
    InputError,
    Thermocouple,
    Tube,
    TubeResistance,
    design_feedback,
)
from tubeopt.constants import ZERO_CELSIUS
from tubeopt.runs.heating_run import run_heating
from tubeopt.runs.heating_study import Success
from tubeopt.shaping.firmware.line import SimulatedLine, SimulatedRig
from tubeopt.shaping.heating.controller import HALF, LawState, decide, run_loop, wilson
from tubeopt.shaping.heating.optimal_schedule import solve_ideal
from tubeopt.shaping.heating.planning import plan_heating
from tubeopt.shaping.heating.replanning import Replanner, planner_for
from tubeopt.shaping.heating.robust import RESET, Response, lacking_power, nominal_law, regulator
from tubeopt.shaping.heating.sensors import lagged_reading
from tubeopt.shaping.heating.simulation import at_rest
from tubeopt.shaping.heating.thermal import curved_temperatures, stack, thermal_model
from tubeopt.shaping.heating.uncertainty import ENSEMBLE, Uncertainty
from tubeopt.shaping.materials import MDF, STEEL
from tubeopt.show.heat_report import unlikely
from tubeopt.show.plots.sheets import safety

from .heating_reference import TUBE, integrate, thesis_rig


@functools.lru_cache(maxsize=1)
def plan() -> HeatingPlan:
    """The thesis' tube, held for 10 s with most distance from the ends of the window."""
    return plan_heating(TUBE, thesis_rig(), HeatingSpec(hold_time=10.0, objective="margin"))


@pytest.fixture(autouse=True)
def _few_rigs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gains are chosen on fewer rigs than usual."""
    monkeypatch.setattr("tubeopt.shaping.heating.robust.RIGS", 12)


@functools.lru_cache(maxsize=1)
def led() -> Feedback:
    """It, led by a thermocouple."""
    return design_feedback(plan(), Thermocouple(), samples=60)


def test_a_thermocouple_keeps_rigs_in_the_window_that_the_schedule_alone_does_not() -> None:
    feedback = led()
    assert feedback.probability >= 0.95
    assert feedback.open_loop < 0.4
    assert feedback.top.max() <= plan().spec.limit + 10
    low, high = feedback.interval
    assert low < feedback.probability <= high
    assert feedback.contributions[0].name == "sensor"


def test_a_bare_tube_that_no_thermometer_sees_is_named_with_its_cure() -> None:
    """A tube of a thin wall: on boards that draw much heat its bare part beside the clamps gets hottest."""
    assert not led().problems
    rig, thin = thesis_rig(), Tube(1.0e-3, 0.9e-3, 0.2, 0.2, 10.0)
    found = []
    for bare in (6e-3, 2e-3):
        short = replace(rig, clamps=replace(rig.clamps, clearance=bare), mold=replace(rig.mold, lead=0.042))
        planned = plan_heating(thin, short, HeatingSpec(hold_time=30.0, objective="margin"))
        found.append(replace(planned, feedback=design_feedback(planned, Thermocouple(), samples=60)))
    long, cured = found
    assert long.feedback is not None
    assert cured.feedback is not None
    assert long.feedback.top.max() > 560 > cured.feedback.top.max()
    assert cured.feedback.probability > long.feedback.probability + 0.2
    hot = 100 * np.mean(long.feedback.top > 560)
    (told,) = [line for line in long.concerns if "clearance_mm" in line]
    assert "6.0 mm of bare tube" in told
    assert f"on {hot:.0f} % of the uncertain rigs, up to" in told
    length, longest = long.feedback.bare
    assert 2e-3 < longest < length == 6e-3
    assert f"at most {1e3 * longest:.1f} mm" in told
    # The tube is no longer too hot. What is left is that molds that take much heat need more voltage.
    given, needed = cured.feedback.volts
    (weak,) = cured.concerns
    assert needed > given
    assert f"the battery of {given:.1f} V is too weak" in weak
    assert f"at least {needed:.1f} V" in weak
    assert not cured.problems
    assert f"The board stops by itself at {cured.feedback.law.ceiling:.0f} °C." in safety(cured)
    assert told in safety(long)
    assert not any("by itself" in line for line in safety(replace(cured, feedback=None)))
    few = Success(0.3, 60, "thermocouple", 0.05)
    assert "at least 95 % must: " in unlikely(few)
    assert "clearance_mm" in unlikely(few)
    assert "--sensor" not in unlikely(few)
    assert not unlikely(Success(0.94, 200, "thermocouple"))
    assert unlikely(Success(0.9, 200, "thermocouple"))
    assert not unlikely(Success(0.6, 60))
    assert "--sensor thermocouple" in unlikely(Success(0.3, 60))


def test_a_battery_too_weak_is_named_with_the_voltage_it_takes() -> None:
    """Losses are in proportion to the rise, and power to the square of the voltage: 400 of 500 K take V sqrt(5 / 4)."""
    f = led()
    wanted = float(f.law.reference[f.law.hold[0]] - f.law.reference.min())
    stuck = f.law.reference.min() + 0.8 * wanted
    members = len(f.history.finished)
    weak = replace(
        f.history,
        finished=np.arange(members) > 0,
        count=np.where(np.arange(members) > 0, f.history.count, 249),
        reading=np.where(np.arange(members) > 0, f.history.reading, np.minimum(f.history.reading, stuck)),
    )
    assert lacking_power(f.law, f.history) == 0.0
    assert lacking_power(f.law, weak) == pytest.approx(0.25, abs=1e-6)
    told = replace(f, volts=(12.7, 12.7 * np.sqrt(1.25)), kept=np.arange(f.samples) < 0.9 * f.samples)
    assert any("Take at least 14.2 V" in line for line in told.problems)
    assert not any("battery" in line for line in replace(told, kept=f.kept).problems)


def test_a_led_rig_does_what_an_adaptive_integrator_says_of_its_counts() -> None:
    law, sensor = led().law, Thermocouple()
    rigs = Uncertainty.of_a_workshop().ensemble(plan().tube, plan().rig, 3, sensor_bias=sensor.bias, seed=5)
    fleet, bias = rigs.model, rigs.bias
    history = run_loop(fleet, law, sensor, bias=bias)
    for b in range(1, 4):
        member = replace(fleet, properties=fleet.properties[b : b + 1], volumes=fleet.volumes[b : b + 1])
        last = len(history.time) - 1
        exact = integrate(member, law.slot, history.count[:last, b] / 255)
        curved = curved_temperatures(member, exact.tube[:, 0]) - ZERO_CELSIUS
        assert np.abs(curved.max(1) - history.hottest[: last + 1, b]).max() < 0.5
        assert np.abs(curved.min(1) - history.coldest[: last + 1, b]).max() < 0.5


def test_resistance_alone_is_told_to_be_no_thermometer() -> None:
    told = design_feedback(
        plan(), TubeResistance(), replace(Uncertainty.of_a_workshop(), board=False, slope=False), samples=40
    )
    assert told.probability < 0.5
    assert told.contributions[0].name == "resistivity_slope"
    assert told.contributions[0].deviation > 20


def test_the_law_without_gains_gives_what_was_planned() -> None:
    law = replace(nominal_law(plan(), Thermocouple()), holdback=math.inf, floor=-math.inf)
    state, given = LawState.start(1), []
    for _ in law.planned:
        count, state = decide(law, state, np.array([25.0]))
        given.append(count[0])
    assert np.abs(np.cumsum(given) - np.cumsum(law.planned)).max() <= HALF + 1e-9


def test_the_law_waits_for_a_cold_tube_and_gives_up_in_the_end() -> None:
    law = replace(nominal_law(plan(), Thermocouple()), patience=5.0)
    state, counts = LawState.start(1), []
    for _ in range(60):
        count, state = decide(law, state, np.array([25.0]))
        counts.append(int(count[0]))
    assert state.index[0] < law.hold[0]
    assert counts[-1] == 0


def test_a_sensor_lags_as_its_equation_says() -> None:
    sensor = Thermocouple(lag=0.7)
    exact = solve_ivp(lambda t, y: (20 + 30 * t - y) / 0.7, (0, 0.5), [5.0], rtol=1e-10, atol=1e-10).y[0, -1]
    (found,) = lagged_reading(sensor.lag, np.array([5.0]), np.array([20.0]), np.array([35.0]), 0.5)
    assert abs(found - exact) < 1e-8


def test_gains_are_those_of_least_cost() -> None:
    found, slot, share = Response(gain=500.0, time_constant=12.0), 0.5, 0.01
    proportional, integral = regulator(found, slot, share)

    def cost(p: float, i: float) -> float:
        error, total, value = 1.0, 0.0, 0.0
        kept = math.exp(-slot / found.time_constant)
        for _ in range(4000):
            power = p * error + i * total
            value += error**2 + (total / RESET) ** 2 + (power / share) ** 2
            total += slot * error
            error = kept * error - found.gain * (1 - kept) * power
        return value

    best = cost(proportional, integral)
    for p, i in ((1.05, 1.0), (0.95, 1.0), (1.0, 1.05), (1.0, 0.95)):
        assert cost(p * proportional, i * integral) > best


def test_a_dead_sensor_ends_the_heating() -> None:
    alone = thermal_model(TUBE, thesis_rig(), ENSEMBLE)
    history = run_loop(alone, led().law, Thermocouple(), dies=20.0)
    after = history.time >= 20.0
    assert not history.count[after].any()
    assert not history.finished[0]
    assert history.top[after].argmax() == 0


def test_uncertain_rigs_begin_at_their_own_ambient() -> None:
    rigs = Uncertainty(0, 0, 0, ambient=5.0).ensemble(TUBE, thesis_rig(), 4)
    model, draws = rigs.model, rigs.draws
    assert np.allclose(at_rest(model).cells[1:, 0, 0] - thesis_rig().ambient, 5.0 * draws[:, 0])


def test_what_pulses_lose_is_planned_for() -> None:
    rig = thesis_rig()
    losing = replace(rig, circuit=replace(rig.circuit, lost_on_time=16e-6))
    planned = plan_heating(TUBE, losing, HeatingSpec(hold_time=10.0))
    assert planned.feasible
    # The same counts on a rig that loses nothing are two counts of 490 Hz too many.
    exact = integrate(thermal_model(TUBE, rig), planned.spec.slot, planned.duty[:-1] / 255)
    assert exact.tube.max() - ZERO_CELSIUS > planned.hottest + 30
    same = stack([thermal_model(TUBE, losing), thermal_model(TUBE, rig)])
    assert same.members == 2


def test_intervals_of_probabilities() -> None:
    low, high = wilson(60, 60)
    assert 0.93 < low < 0.95
    assert high == pytest.approx(1.0)


def test_nonsense_is_refused() -> None:
    with pytest.raises(InputError, match="samples is 3; it must be at least 20"):
        design_feedback(plan(), Thermocouple(), samples=3)
    with pytest.raises(InputError, match="position of the thermocouple is 400 mm"):
        design_feedback(plan(), Thermocouple(position=0.4), samples=20)
    with pytest.raises(InputError, match="lag of the thermocouple is -1"):
        Thermocouple(lag=-1)
    with pytest.raises(InputError, match="lowest of the camera"):
        Camera(lowest=300.0, highest=100.0)
    with pytest.raises(InputError, match="lost_on_time of the circuit is 1500 us"):
        replace(thesis_rig().circuit, lost_on_time=1.5e-3)


def test_the_rest_is_planned_anew_and_perturbed_rigs_stay_in_the_window() -> None:
    """Rigs that lose less and more than filed are recognised as stronger and weaker."""
    law, sensor = led().law, Thermocouple()
    planner = planner_for(plan(), law, sensor)
    strengths = []
    for factor, bias in ((0.85, 2.0), (1.15, -2.0)):
        other = replace(thesis_rig(), loss_factor=factor)
        rig = SimulatedRig(thermal_model(TUBE, other, ENSEMBLE), sensor, bias=bias, hot=float(law.reference.max()))
        held: list[tuple[float, float]] = []

        def seen(_: object, row: dict[str, Any], rig: SimulatedRig = rig, held: list[Any] = held) -> None:
            curved = curved_temperatures(rig.model, rig.state.cells[0, :, 0]) - ZERO_CELSIUS
            held.extend([(curved.min(), curved.max())] * (row["state"] == "holding"))

        leader = Replanner(planner)
        found = run_heating(SimulatedLine(rig, law, plan().spec.limit + 8), show=seen, leader=leader)
        assert found.done
        assert sum(row["led"] for row in found.rows) > 0.5 * len(found.rows)
        assert 500 <= np.min(held) <= np.max(held) <= 550
        strengths.append(leader.strength)
    assert strengths[0] > 0.03
    assert strengths[1] < -0.03


def test_a_computer_that_is_late_leaves_the_board_to_its_own_law() -> None:
    """A lead ends by itself, and the law goes on from it; no lead takes a count beyond the share."""
    law, sensor = led().law, Thermocouple()
    rig = SimulatedRig(thermal_model(TUBE, thesis_rig(), ENSEMBLE), sensor)
    line = SimulatedLine(rig, law, plan().spec.limit + 8)
    first = law.hold[0] + 2
    lead = round(110 * float(law.planned[first]))

    def seen(_: object, row: dict[str, Any]) -> None:
        if row["place"] == first:
            line.send("lead", **{"slots": 4, "from": lead, "to": lead})

    found = run_heating(line, show=seen)
    assert found.done
    assert sum(row["led"] for row in found.rows) == 3
    hold = [row["temperature_degC"] for row in found.rows if row["state"] == "holding"]
    assert 500 < min(hold) <= max(hold) < 550
    memory = replace(LawState.start(1), index=np.array([first]))
    count, after = decide(law, memory, law.reference[first : first + 1], 255.0)
    assert count[0] <= law.planned[first] * (1 + law.share) + law.lost + 1
    # Left alone, the law says the same again.
    again, _ = decide(law, replace(after, owed=memory.owed), law.reference[first + 1 : first + 2])
    assert abs(again[0] - count[0]) <= 1


def test_margin_keeps_off_the_limit_too() -> None:
    """A thin tube is hottest where it lies bare, beside the clamps, which is not of the window."""
    tube, spec = Tube(1.0e-3, 0.9e-3, 0.0, 100e-3, 5.0), HeatingSpec(hold_time=10, objective="margin")
    found = solve_ideal(tube, thesis_rig(), spec)
    low, high = spec.window_degC
    held, margin = found.hold - ZERO_CELSIUS, -found.miss
    assert margin > 10
    assert min(held.min() - low, high - held.max()) == pytest.approx(margin, abs=0.01)
    assert spec.limit - (found.tube.max() - ZERO_CELSIUS) == pytest.approx(margin, abs=0.01)


def test_a_wire_has_no_bore_that_could_be_another() -> None:
    wire = Tube(1e-3, 0.0, 0.0, 0.1, 2.0)
    unknown = Uncertainty(inner_diameter=2e-5)
    for draw in unknown.draws(4, 0):
        assert unknown.member(wire, thesis_rig(), draw)[0].inner_diameter == 0.0


def test_the_authority_is_what_dense_boards_require() -> None:
    """The densest board of the material's range needs 87 % more than the planned power; 30 % more leave it cold."""
    law, sensor = led().law, Thermocouple()
    alone = Uncertainty(0, 0, 0, board=True)
    members = [thermal_model(*alone.member(TUBE, plan().rig, [draw]), ENSEMBLE) for draw in (-1.0, 1.0)]
    found = run_loop(stack(members), law, sensor)
    assert found.finished.all()
    low, high = found.extremes(law)
    assert 500 <= low.min() <= high.max() <= 550
    weak = run_loop(stack(members), replace(law, share=0.3), sensor)
    # The board that is left cold is no success: its hold does not count, and the heating ends as "too cold".
    assert weak.finished.tolist() == [True, False]
    assert law.share > 1


def test_boards_are_drawn_as_wide_as_their_table() -> None:
    material = thesis_rig().mold.material
    light, dense = material.board(-1.0), material.board(1.0)
    assert (light.conductivity, dense.conductivity) == pytest.approx((0.08, 0.29))
    assert (light.density, dense.density) == pytest.approx((450.0, 1200.0))
    assert all(made.board(1.0).conductivity == made.conductivity_range[1] for made in (material, MDF))
    assert material.board(0.0).conductivity == pytest.approx(math.sqrt(0.08 * 0.29))
    with pytest.raises(InputError, match=r"conductivity_range of mold material 'calcium_silicate' is 0\.2 to 0\.3"):
        replace(material, conductivity_range=(0.2, 0.3))
    assert (material.sloped(-1.0).conductivity_slope, material.sloped(1.0).conductivity_slope) == (-3e-4, 15e-4)
    with pytest.raises(InputError, match=r"conductivity_slope_range .* is 0\.0001 to 0\.002 per K"):
        replace(material, conductivity_slope_range=(1e-4, 2e-3))


def test_a_board_conducts_as_its_data_sheet_says() -> None:
    """Marinite I: 0.127 W/(m K) at 24 degC, 0.124 at 538; scaled, a board of another conductivity keeps the shape."""
    material = thesis_rig().mold.material
    at = np.array([24.0, 149.0, 205.0, 316.0, 425.0, 538.0, 900.0]) + 273.15
    measured = [0.127, 0.118, 0.117, 0.114, 0.117, 0.124, 0.124]
    assert material.conductivity * material.conductivity_factor(at) == pytest.approx(measured, rel=2e-3)
    light = material.board(-1.0)
    assert light.conductivity_factor(at) == pytest.approx(material.conductivity_factor(at))
    growing = replace(material, conductivity_curve=(), conductivity_slope=1.5e-3)
    assert growing.conductivity_factor(np.array([298.15, 673.15])) == pytest.approx([1 - 0.2625, 1.3])
    assert STEEL.conductivity * STEEL.conductivity_factor(773.15) == pytest.approx(54 - 0.0333 * 500, rel=1e-3)
    for wrong in (((20.0, 0.1), (20.0, 0.2)), ((20.0, -0.1),), ((20.0, 0.1, 3.0),)):
        with pytest.raises(InputError, match="conductivity_curve of mold material 'calcium_silicate' must be pairs"):
            replace(material, conductivity_curve=wrong)
