"""Logs that lie, several thermometers, cameras, ageing: what calibration makes of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tubeopt import InputError
from tubeopt.runs.workshop_file import load_camera, load_heating_log
from tubeopt.shaping.firmware.line import SimulatedRig
from tubeopt.shaping.heating.calibration import (
    FACTORS,
    HeatingLog,
    calibrate,
    predict,
    resolution_of,
    unexplained,
    without_saturated,
)
from tubeopt.shaping.heating.plan import ageing, ageing_remarks
from tubeopt.shaping.heating.sensors import Thermocouple
from tubeopt.shaping.heating.simulation import simulate
from tubeopt.shaping.heating.thermal import FINE, thermal_model
from tubeopt.typing import Array

from .heating_reference import TUBE, thesis_plan, thesis_rig

TIME = np.arange(0.0, 60.0, 4.0)
DUTY = np.interp(TIME, [0, 24, 28, 60], [3, 16, 11, 9]).round()
PLACES = np.array([0.0, 0.03, 0.046])
RNG = np.random.default_rng(5)


def seen(clamps: float = 1.0, loss: float = 1.1) -> Array:
    """(T, 3) what thermometers at PLACES show, by the fine model."""
    rig = FACTORS["clamps"](FACTORS["loss"](thesis_rig(), loss), clamps)
    model = thermal_model(TUBE, rig, FINE)
    history = simulate(model, 4.0, np.append(DUTY[:-1] / 255, 0.0))
    tube = history.tube[: len(TIME), 0]
    return np.column_stack([[np.interp(model.half_length - x, model.position, row) for row in tube] for x in PLACES])


TRUE = seen()
EXPECTED = {"temperature": TRUE[:, 0]}


def test_a_dead_thermometer_is_refused() -> None:
    dead = HeatingLog(TIME, DUTY, np.full(len(TIME), 298.15))
    with pytest.raises(InputError, match=r"log is 25.0 degC in all 15 readings.*the thermometer is broken"):
        without_saturated(dead, thesis_rig(), EXPECTED)
    cold = HeatingLog(TIME, 0 * DUTY, np.full(len(TIME), 298.15))
    assert without_saturated(cold, thesis_rig(), {"temperature": np.full(len(TIME), 298.15)})[1] == ()


def test_a_saturated_thermometer_is_left_out_where_it_is() -> None:
    log, words = without_saturated(HeatingLog(TIME, DUTY, np.minimum(TRUE[:, 0], 600.0)), thesis_rig(), EXPECTED)
    high = TRUE[:, 0] > 600.0
    assert (np.isnan(log.channels["temperature"]) == high).all()
    assert f"stays at 326.9 degC for {high.sum()} readings" in words[0]


def test_a_shifted_thermometer_is_told_and_its_bias_found() -> None:
    noisy = TRUE[:, 0] + RNG.normal(0, 1.0, len(TIME))
    log = HeatingLog(TIME, DUTY, noisy + 12.0)
    found = calibrate(TUBE, thesis_rig(), log, ["loss", "bias"], noise={"temperature": 1.5})
    assert any("above the rig's ambient temperature" in words for words in found.remarks)
    loss, bias = found.estimates
    assert bias.name == "bias of temperature"
    assert bias.low - 1.5 < 12.0 < bias.high + 1.5
    assert loss.factor == pytest.approx(1.1, abs=0.03)


def test_a_simulated_rig_is_found_as_its_file_says() -> None:
    rig, sensor = SimulatedRig(thermal_model(TUBE, thesis_rig(), FINE), Thermocouple()), Thermocouple()
    rows = []
    for count in DUTY:
        volt, ampere = rig.electrics(conducting=True)
        rows.append((rig.time, count, rig.reading + 273.15, round(volt, 2), round(ampere, 1)))
        for _ in range(8):
            rig.pass_time(int(count), 0.5)
    log = HeatingLog(*np.transpose(rows), lag=sensor.lag)
    found = calibrate(TUBE, thesis_rig(), log, noise={"temperature": 0.6})
    assert found.remarks == ()
    assert all(each.low < 1.0 < each.high for each in found.estimates)
    (words,) = calibrate(TUBE, thesis_rig(), replace(log, lag=0.0), ["loss"], noise={"temperature": 0.6}).remarks
    assert "residuals of temperature are" in words


def test_residuals_are_held_to_the_noise_that_was_stated() -> None:
    noise = RNG.normal(0, 2.0, 200)
    assert unexplained("temperature", noise, 2.0, 2.0) == ()
    assert unexplained("temperature", noise, None, 2.0) == ()
    assert "times the stated noise of 1 K" in unexplained("temperature", noise, 1.0, 2.0)[0]
    steps = np.round(12.0 + 0.1 * np.sin(np.linspace(0, 12, 200)), 2)
    assert (
        unexplained("voltage", 12.0 + 0.1 * np.sin(np.linspace(0, 12, 200)) - steps, None, 2.0, resolution_of(steps))
        == ()
    )
    wave = 3 * np.sin(np.linspace(0, 12, 200))
    told = unexplained("voltage", wave, None, 2.0)
    assert len(told) == 1
    assert "change sign 4 times in 200 readings" in told[0]


def test_false_alarms_are_rare() -> None:
    alarms = sum(len(unexplained("current", RNG.normal(0, 1, 60), 1.0, 0.0)) for _ in range(1000))
    assert alarms <= 2


def test_thermometers_along_the_tube_tell_how_the_clamps_cool() -> None:
    table = seen(clamps=0.5, loss=1.0) + RNG.normal(0, 1.0, (len(TIME), 3))
    places = np.array([0.0, 0.03, 0.062])
    rig = FACTORS["clamps"](thesis_rig(), 0.5)
    model = thermal_model(TUBE, rig, FINE)
    tube = simulate(model, 4.0, np.append(DUTY[:-1] / 255, 0.0)).tube[: len(TIME), 0]
    table[:, 2] = [np.interp(model.half_length - places[2], model.position, row) for row in tube]
    found = calibrate(TUBE, thesis_rig(), HeatingLog(TIME, DUTY, table, position=places), ["loss", "clamps"])
    values = {e.name: e for e in found.estimates}
    assert not values["clamps"].held
    assert values["clamps"].factor == pytest.approx(0.5, rel=0.25)
    assert set(found.noise) == {"temperature 1 at 0 mm", "temperature 2 at 30 mm", "temperature 3 at 62 mm"}


def test_a_camera_has_times_of_its_own() -> None:
    log = HeatingLog(TIME, DUTY, voltage=np.full(len(TIME), 12.0))
    times = np.array([-1.0, 2.0, 4.0, 6.0, 99.0])
    both = log.with_camera(times, PLACES, np.arange(15.0).reshape(5, 3) + 300.0)
    assert both.time.tolist() == sorted({*TIME.tolist(), 2.0, 6.0})
    assert both.duty[both.time == 2.0] == DUTY[0]
    assert both.duty[both.time == 6.0] == DUTY[1]
    assert both.temperature is not None
    assert both.temperature[both.time == 4.0][0].tolist() == [306.0, 307.0, 308.0]
    assert np.isnan(both.temperature[both.time == 8.0]).all()
    assert both.voltage is not None
    assert np.isnan(both.voltage[both.time == 2.0]).all()
    one = predict(TUBE, [thesis_rig()], HeatingLog(TIME, DUTY, voltage=TIME))["voltage"][:, 0]
    two = predict(TUBE, [thesis_rig()], both)["voltage"][:, 0]
    assert two[np.isin(both.time, TIME)] == pytest.approx(one, abs=1e-3)


def test_files_of_cameras_and_of_several_thermometers(tmp_path: Path) -> None:
    camera = tmp_path / "camera.csv"
    camera.write_text("time_s,-40,0,12.5\n0,25,26,\n1,30,40,35\n")
    time, places, table = load_camera(camera)
    assert time.tolist() == [0.0, 1.0]
    assert places.tolist() == [-0.04, 0.0, 0.0125]
    assert table[1].tolist() == [303.15, 313.15, 308.15]
    assert np.isnan(table[0, 2])
    camera.write_text("time_s,middle\n0,25\n")
    with pytest.raises(InputError, match="column middle is not known; it must be time_s or a place in mm"):
        load_camera(camera)
    log = tmp_path / "log.csv"
    log.write_text("time_s,duty,temperature_-20_mm_degC,temperature_0_mm_degC\n0,1,25,25\n1,1,26,27\n2,1,27,\n")
    read = load_heating_log(log)
    assert read.positions.tolist() == [0.02, 0.0]
    assert read.channels["temperature 2 at 0 mm"][1] == pytest.approx(300.15)


def test_cold_ends_age_as_long_as_they_are_near_450_degC() -> None:
    plan = thesis_plan()
    near, far, longest = ageing(plan)
    end = plan.temperature[int(np.flatnonzero(plan.in_hold)[-1])]
    half = len(end) // 2
    outside = np.flatnonzero(~plan.curved[:half])
    bend = 0.5 * plan.position[outside[-1] : outside[-1] + 2].sum()
    colder, hotter = np.interp([400.0, 500.0], end[outside], bend - plan.position[outside])
    assert [near, far] == pytest.approx([hotter, colder], abs=0.3e-3)
    assert far - near > 5e-3
    assert 10 < longest < plan.hold_end
    # Nothing is said of a tube whose ends are trimmed off, or trimmed before this stretch.
    assert ageing_remarks(plan) == ()
    long = [replace(plan, tube=replace(plan.tube, straight_length=length)) for length in (near - 2e-3, 0.1)]
    assert ageing_remarks(long[0]) == ()
    assert f"from {1e3 * near:.0f} to {1e3 * far:.0f} mm before the bend" in ageing_remarks(long[1])[0]
    assert f"for up to {longest:.0f} s" in ageing_remarks(long[1])[0]
    assert ageing(plan, 0.5 * (near + far)).far == pytest.approx(0.5 * (near + far))
    cold = replace(long[1], course=replace(plan.course, temperature=np.full_like(plan.temperature, 25.0)))
    assert ageing_remarks(cold) == ()
