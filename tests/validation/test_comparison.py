"""Measured tips beside predicted ones: errors, groups, and rows that cannot be solved."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tubeopt import InputError, SolveError, load_robot
from tubeopt.runs.measurement_file import load_measurements
from tubeopt.validation import ErrorSummary, group_errors, model, validate

from .laboratory import BASE, CONFIGS, DEVICE_BASE, MM, TURN, ctr, etr, mirrored, noisy, turned


@pytest.mark.parametrize("concentric", [True, False])
def test_a_perfect_robot_has_no_error(concentric: bool) -> None:
    robot = ctr() if concentric else etr()
    measurements = turned(robot, 8) if concentric else mirrored(robot, 3)
    result = validate(robot, measurements)
    assert result.summary.max < 1e-11
    np.testing.assert_allclose(result.registration.rotation, TURN.T, atol=1e-9)
    np.testing.assert_allclose(result.registration.translation, -TURN.T @ BASE, atol=1e-10)
    assert (result.margin > 0).all()
    assert result.length == pytest.approx((140 if concentric else 94) * MM, abs=35 * MM if concentric else 1e-12)


def test_registrations_agree_on_perfect_data() -> None:
    robot = etr()
    measurements = mirrored(robot, 3)
    assert validate(robot, measurements, registration="base-axis", base=DEVICE_BASE).summary.max < 1e-11
    reached = replace(measurements, sensors=(measurements.tip_position - BASE) @ TURN)
    assert validate(robot, reached, registration="none").summary.max < 1e-11


def test_errors_by_direction_and_separation() -> None:
    robot = etr()
    measurements = mirrored(robot, 4)
    assert measurements.direction is not None
    assert measurements.separation is not None
    worse = np.isclose(measurements.separation, np.pi / 2) & np.isclose(measurements.direction, np.pi)
    away = np.where(worse, 12.7 * MM, 0.0)[:, None] * [1.0, 0.0, 0.0]
    reached = replace(measurements, sensors=measurements.tip_position + away)
    result = validate(robot, reached, registration="base-axis", base=DEVICE_BASE)
    assert np.degrees([g.value for g in result.by_direction]) == pytest.approx([0, 90, 180, 270])
    assert np.degrees([g.value for g in result.by_separation]) == pytest.approx([0, 30, 60, 90])
    assert [g.summary.count for g in result.by_direction] == [4] * 4
    assert max(result.by_direction, key=lambda g: g.summary.max).value == pytest.approx(np.pi)
    assert max(result.by_separation, key=lambda g: g.summary.max).value == pytest.approx(np.pi / 2)
    assert result.errors.argmax() == worse.argmax()


def test_summary_of_errors() -> None:
    errors = np.arange(1.0, 101.0)
    summary = ErrorSummary.of(errors)
    assert (summary.count, summary.mean, summary.max) == (100, 50.5, 100.0)
    assert summary.rms == pytest.approx(np.sqrt(101 * 201 / 6))
    assert summary.p95 == pytest.approx(95.05)
    assert group_errors(None, errors) == ()


def test_residuals_point_from_predicted_to_measured() -> None:
    robot = ctr()
    result = validate(robot, noisy(turned(robot, 10), seed=1))
    np.testing.assert_allclose(result.residuals, result.measured - result.predicted)
    np.testing.assert_allclose(result.residuals.mean(0), 0.0, atol=1e-15)  # of a rigid registration
    np.testing.assert_allclose(result.errors, np.linalg.norm(result.residuals, axis=1))
    assert 0.3 * MM < result.summary.rms < 1.2 * MM


def test_rows_are_named() -> None:
    robot, measurements = ctr(), turned(ctr(), 4)
    out = measurements.translations.copy()
    out[2, 0] = 0.2
    with pytest.raises(InputError, match=r"row 3: translation of tube 1 is 0\.2 m"):
        validate(robot, replace(measurements, translations=out))
    with pytest.raises(InputError, match="the measurements are of 2 tubes; the robot has 3"):
        validate(etr(), measurements)


def test_a_row_without_a_shape_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    solve = model.ArmModel.__init__

    def fail(self: model.ArmModel, *arguments: Any, **options: Any) -> None:
        solve(self, *arguments, **options)
        self.failures = ((0, "no stable equilibrium was found"),)

    monkeypatch.setattr(model.ArmModel, "__init__", fail)
    with pytest.raises(SolveError, match="row 1: no stable equilibrium was found"):
        validate(ctr(), turned(ctr(), 4))


def test_three_sensors_of_the_synthetic_file_average_to_the_centreline() -> None:
    robot = load_robot(CONFIGS / "robots" / "thesis_etr.yaml")
    m = load_measurements(CONFIGS / "experiments" / "synthetic_etr.csv", robot)
    assert m.sensors.shape == (48, 3, 3)
    # Each sensor is off by its tube's distance and, of 0.5 sqrt(3) mm per coordinate, by what averaging leaves.
    spread = np.hypot(1.1085, 0.5 * np.sqrt(3) * np.sqrt(2)) * MM
    assert np.sqrt((m.sensor_spread**2).mean()) == pytest.approx(spread, rel=0.1)
    one = replace(m, sensors=m.sensors[:, :1])
    assert validate(robot, one).summary.rms > validate(robot, m).summary.rms
