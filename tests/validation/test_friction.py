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


def rubbing(
    noise: float = 0.2 * MM,
    drives: Calibration | None = None,
    law: Friction | None = None,
    way: tuple[Array, Array] | None = None,
) -> Measurements:
    """The tips of the robot with friction, followed along the way by the motion that the fit does not use."""
    time, read = way or readings()
    drives = drives or Calibration.none(2)
    alpha, shift = drives.to_model(read[:, :2], read[:, 2:])
    if any(drives.rotation_play):
        alpha = np.column_stack([loose(*each) for each in zip(alpha.T, drives.rotation_play, strict=True)])
    tips = np.array([e.tip_position for e in follow(robot(), alpha, shift, friction=law or Friction(TRUE)).equilibria])
    noisy = in_device(tips) + np.random.default_rng(0).normal(0, noise, tips.shape)
    return Measurements(read[:, :2], read[:, 2:], noisy, time=time, source="a way")


def loose(drive: Array, play: float) -> Array:
    """Rotations (T,) of a tube that its drive (T,) moves through a backlash."""
    tube = drive.copy()
    for k in range(1, len(tube)):
        tube[k] = np.clip(tube[k - 1], drive[k] - play, drive[k] + play)
    return tube


def turns_of_several_sizes() -> tuple[Array, Array]:
    """Times and joint readings of a way on which one tube turns back after turns from 5 to 80 degrees."""
    time = np.arange(120) / RATE
    corners = np.radians(np.cumsum([0, 5, 60, -10, -40, 20, -80, -5, 50]))
    read = np.zeros((len(time), 4))
    read[:, 1] = np.interp(np.linspace(0, len(corners) - 1, len(time)), np.arange(len(corners)), corners)
    read[:, 2] = -0.03 + 0.0015 * np.abs((np.arange(len(time)) + 20) % 40 - 20)
    read[:, 3] = -0.01
    return time, read


@pytest.mark.parametrize(("torque", "play"), [(0.006, 0.0), (0.0, 0.07), (0.006, 0.05)])
def test_play_and_friction_are_told_apart(torque: float, play: float) -> None:
    drives = replace(Calibration.none(2), rotation_play=(0.0, play))
    data = rubbing(drives=drives, law=Friction(torque), way=turns_of_several_sizes())
    fitted = fit(robot(), data, ["friction_1", "rotation_play_2"], FitOptions(folds=0))
    for found, true in zip(fitted.estimates, (torque, play), strict=True):
        # Play is known to 0.5 degrees, friction to a third.
        assert abs(found.value - true) < 2.5 * found.standard_error < 0.011
    assert not fitted.remarks


def test_friction_that_grows_with_the_bending_moment_is_found() -> None:
    data = rubbing(law=Friction(0.004, by_moment=0.3))
    names = ["friction_1", "friction_by_moment_1"]
    fitted = fit(robot(), data, names, FitOptions(folds=0))
    constant, growth = fitted.estimates
    assert growth.unit == "1/m"
    assert 0 < growth.low < 0.3 < growth.high
    assert constant.low < 0.004 < constant.high
    assert fitted.robot.friction.by_moment == (growth.value,)  # type: ignore[attr-defined, union-attr]
    # On this way bending moments change little, so that each explains most of the other.
    assert any(f"{names[0]} can hardly be distinguished from friction_by_moment" in each for each in fitted.remarks)


def test_friction_is_found_and_goes_into_the_robot() -> None:
    drives = replace(Calibration.none(2), translation_offsets=DRIVES.translation_offsets)
    data = rubbing(drives=drives)
    fitted = fit(robot(), data, ["translation_all", "friction_1"], FitOptions(folds=0))
    # Passes along the path, each of which costs as much as all shapes without friction.
    assert fitted.evaluations < 25 * len(data)
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
