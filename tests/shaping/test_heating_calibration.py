"""Calibration: from logs made by a known rig with noise."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from tubeopt import InputError, Rig
from tubeopt.shaping.heating.calibration import FACTORS, HeatingLog, calibrate, predict
from tubeopt.shaping.heating.thermal import FINE, thermal_model

from .heating_reference import TUBE, integrate, thesis_rig

TIME = np.arange(0.0, 61.0, 2.0)
DUTY = np.interp(TIME, [0, 24, 26, 61], [3, 16, 11, 9]).round()
TRUTH = {"loss": 1.12, "resistivity": 1.05}


def true_rig() -> Rig:
    rig = thesis_rig()
    for name, factor in TRUTH.items():
        rig = FACTORS[name](rig, factor)
    return rig


@lru_cache(maxsize=1)
def log() -> HeatingLog:
    """What the true rig would log, with noise, by another integrator than that of the fit."""
    model = thermal_model(TUBE, true_rig(), FINE)
    history = integrate(model, 2.0, np.append(DUTY[:-1] / 255, 0.0))
    generator = np.random.default_rng(3)
    noisy = {
        "temperature": history.tube[: len(TIME), 0, -1] + generator.normal(0, 2.0, len(TIME)),
        "voltage": history.voltage[: len(TIME), 0] + generator.normal(0, 0.01, len(TIME)),
        "current": history.current[: len(TIME), 0] + generator.normal(0, 0.2, len(TIME)),
    }
    return HeatingLog(TIME, DUTY, **noisy)


def test_a_log_gives_back_the_rig_that_made_it() -> None:
    found = calibrate(TUBE, thesis_rig(), log(), ["loss", "resistivity"])
    for estimate in found.estimates:
        assert not estimate.held
        assert estimate.low < estimate.factor < estimate.high
        assert estimate.factor == pytest.approx(TRUTH[estimate.name], rel=0.015)
    assert found.rig.loss_factor == pytest.approx(found.estimates[0].factor)
    assert found.noise["temperature"] < 5.0
    before = np.abs(found.before["temperature"] - found.log.temperature).mean()
    after = np.abs(found.after["temperature"] - found.log.temperature).mean()
    assert after < 0.2 * before


def test_any_subset_of_channels_will_do() -> None:
    only = HeatingLog(TIME, DUTY, temperature=np.where(np.arange(len(TIME)) % 3 == 0, log().temperature, np.nan))
    found = calibrate(TUBE, thesis_rig(), only, ["loss"])
    # Without the current, loss makes up for the resistivity: the file's rig, 5 % too low, heats 3.4 % too much.
    assert found.estimates[0].factor == pytest.approx(1.12 / 0.966, abs=0.03)
    electrical = HeatingLog(TIME, DUTY, current=log().current)
    found = calibrate(TUBE, thesis_rig(), electrical, ["resistivity"])
    assert found.estimates[0].factor == pytest.approx(1.05, abs=0.02)


def test_what_a_log_does_not_determine_is_held() -> None:
    cold = HeatingLog(TIME[:6], np.zeros(6), voltage=np.full(6, 12.0) + 0.01 * np.arange(6))
    found = calibrate(TUBE, thesis_rig(), cold, ["gap", "loss"])
    assert all(estimate.held and estimate.factor == 1.0 for estimate in found.estimates)
    assert any("gap is not determined by the log" in words for words in found.remarks)
    assert found.rig == thesis_rig()


def test_prediction_at_a_place() -> None:
    rigs = [thesis_rig(), true_rig()]
    middle = predict(TUBE, rigs, log())["temperature"]
    aside = predict(TUBE, rigs, replace(log(), position=0.055))["temperature"]
    assert middle.shape == (len(TIME), 2)
    assert (aside[-1] < middle[-1] - 5).all()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: HeatingLog(TIME[:2], DUTY[:2], voltage=DUTY[:2]), "the log has 2 rows; it must have at least 3"),
        (lambda: HeatingLog(TIME, DUTY), "neither temperature nor voltage nor current"),
        (lambda: HeatingLog(TIME[::-1], DUTY, voltage=TIME), "time of the log must increase"),
        (lambda: HeatingLog(TIME, DUTY + 300, voltage=TIME), "duty of the log must be from 0 to 255"),
        (lambda: HeatingLog(TIME, DUTY, voltage=TIME[:4]), "voltage of the log has shape (4,)"),
        (lambda: calibrate(TUBE, thesis_rig(), log(), ["los"]), "parameter is 'los'; it must be one of loss"),
        (lambda: calibrate(TUBE, thesis_rig(), log(), []), "one of loss"),
        (
            lambda: predict(TUBE, [thesis_rig()], replace(log(), position=0.5)),
            "position of a thermometer is 500 mm from the middle of the tube; it must be less than",
        ),
        (lambda: calibrate(TUBE, thesis_rig(), log(), confidence=1.0), "confidence is 1; it must be between 0 and 1"),
    ],
)
def test_nonsense_is_refused(make: object, message: str) -> None:
    with pytest.raises(InputError) as caught:
        make()  # type: ignore[operator]
    assert message in str(caught.value)
