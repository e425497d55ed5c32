"""Friction as an effect of calibration: found on a way that a robot with friction was driven along."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.validation.drives import DRIVES, MM, RATE, joints, robot
from tests.validation.laboratory import in_device
from tubeopt import Friction, InputError, follow
from tubeopt.robots.calibration import Calibration
from tubeopt.typing import Array
from tubeopt.validation import FitOptions, Measurements, fit, validate
from tubeopt.validation.model import ArmModel, ParameterState
from tubeopt.validation.parameters import choose_parameters

TRUE = 0.012
COUNT = 70


def readings() -> tuple[Array, Array]:
    """Times and joint readings of a way that leads back from half way; slow, so that it is not all latency."""
    time = np.arange(COUNT) / RATE
    return time, joints(6 * time, 6 * time[-1])


def rubbing(noise: float = 0.2 * MM, drives: Calibration | None = None) -> Measurements:
    """The tips of the robot with friction, followed along the way by the motion that the fit does not use."""
    time, read = readings()
    drives = drives or Calibration.none(2)
    alpha, shift = drives.to_model(read[:, :2], read[:, 2:])
    tips = np.array([e.tip_position for e in follow(robot(), alpha, shift, friction=Friction(TRUE)).equilibria])
    noisy = in_device(tips) + np.random.default_rng(0).normal(0, noise, tips.shape)
    return Measurements(read[:, :2], read[:, 2:], noisy, time=time, source="a way")


def test_friction_is_found_and_goes_into_the_robot() -> None:
    drives = replace(Calibration.none(2), translation_offsets=DRIVES.translation_offsets)
    fitted = fit(robot(), rubbing(drives=drives), ["translation_all", "friction_1"], FitOptions(folds=0))
    torque = fitted.estimates[-1]
    assert torque.unit == "N"
    assert torque.low < TRUE < torque.high
    assert torque.standard_error < 0.1 * TRUE
    assert fitted.noise == pytest.approx(0.2 * MM, rel=0.2)
    assert fitted.robot.friction is not None  # type: ignore[attr-defined]
    assert fitted.robot.friction.torque == (torque.value,)  # type: ignore[attr-defined]
    assert fitted.robot.friction.refinement == 0  # type: ignore[attr-defined]


def test_robot_with_friction_is_compared_along_the_way() -> None:
    data = rubbing(noise=1e-9)
    assert validate(robot(), data).summary.rms > 0.5 * MM
    assert validate(replace(robot(), friction=Friction(TRUE)), data).summary.rms < 0.02 * MM


def test_wrong_input() -> None:
    with pytest.raises(InputError, match=r"friction_2'.*1 pairs of tubes that rub"):
        fit(robot(), rubbing(), ["friction_2"])
    data = rubbing()
    timeless = Measurements(data.rotations, data.translations, data.sensors[:, 0], source="no times")
    with pytest.raises(InputError, match="needs the time of every row"):
        fit(robot(), timeless, ["friction_1"])


def test_slopes_are_those_of_the_way_with_friction() -> None:
    data = rubbing(0.0)
    names = ["latency", "translation_2", "rotation_2", "rotation_gain_1", "friction_1", "torsional_stiffness_1"]
    chosen = choose_parameters(robot(), data, names)
    model = ArmModel(robot(), data, chosen)
    current = ParameterState(np.array([0.02, 1 * MM, 0.03, 1.004, 0.9 * TRUE, 1.05]), model.start.registration)
    slopes = model.jacobian(current)
    for k, p in enumerate(chosen):
        step = np.zeros(len(chosen))
        step[k] = 1e-4 * p.scale
        ahead, behind = (model.residuals(ParameterState(current.x + s * step, current.registration)) for s in (1, -1))
        wrong = np.abs((ahead - behind) / (2 * step[k]) - slopes[..., k]).max(1)
        assert np.quantile(wrong, 0.8) < 1e-5 * np.abs(slopes[..., k]).max()  # other rows stick or slip anew between
