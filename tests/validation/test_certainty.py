"""How well a registration is known: against draws of the noise, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tubeopt import InputError
from tubeopt.validation import BasePose, Measurements, validate
from tubeopt.validation.comparison import registration_error, remark
from tubeopt.validation.model import ArmModel

from .laboratory import BASE, DEVICE_BASE, MM, TURN, ctr, in_device, tips, turned


def spreads(m: Measurements, method: str, base: BasePose) -> tuple[float, float, float, float]:
    """Standard deviations of turn (deg) and reach (mm) over draws of the noise, and the medians of those told."""
    robot, turns, points, report = ctr(), [], [], []
    for seed in range(60):
        noise = np.random.default_rng(seed).normal(0, 0.5 * MM, m.sensors.shape)
        model = ArmModel(robot, replace(m, sensors=m.sensors + noise), (), method, base)
        error = registration_error(model, model.start)
        assert error is not None
        result = model.start.registration
        turns.append(Rotation.from_matrix(result.rotation @ TURN).as_rotvec())
        points.append(result.apply(in_device(model.length * np.vstack([np.eye(3), -np.eye(3)]))))
        report.append((np.degrees(error.turn), error.reach / MM))
    turn, reach = (np.array(each) for each in (turns, points))
    worst = max(np.linalg.eigvalsh(np.cov(reach[:, k].T))[-1] for k in range(6))
    return (
        float(np.degrees(np.sqrt(np.linalg.eigvalsh(np.cov(turn.T))[-1]))),
        np.sqrt(worst) / MM,
        *np.median(report, 0),
    )


@pytest.mark.parametrize("method", ["rigid", "base-axis"])
def test_the_errors_told_are_those_of_the_noise(method: str) -> None:
    turn, reach, told_turn, told_reach = spreads(turned(ctr(), 24), method, DEVICE_BASE)
    assert told_turn == pytest.approx(turn, rel=0.25)
    assert told_reach == pytest.approx(reach, rel=0.25)


def nearly_planar() -> Measurements:
    """An inner tube that only advances: tips on a short, flat arc."""
    robot, count = ctr(), 40
    forth = np.linspace(0, 15 * MM, count)
    reached = Measurements(np.zeros((count, 2)), np.column_stack([forth, np.zeros(count)]), np.zeros((count, 3)))
    return replace(reached, sensors=in_device(tips(robot, reached)))


def test_a_registration_from_a_line_is_refused_with_what_to_measure() -> None:
    m = nearly_planar()
    noisy = replace(m, sensors=m.sensors + np.random.default_rng(0).normal(0, 1 * MM, m.sensors.shape))
    with pytest.raises(InputError, match=r"to \d+ deg only .*configurations bent in at least three"):
        validate(ctr(), noisy)
    # The same tips with a base that was measured, or without noise, are enough.
    assert validate(ctr(), noisy, registration="base-axis", base=DEVICE_BASE).registration_error is not None
    exact = validate(ctr(), m).registration_error
    assert exact is not None
    assert exact.turn < 1e-6


def test_a_registration_that_was_given_has_no_error() -> None:
    m = turned(ctr(), 6)
    plate = replace(m, sensors=(m.sensors - BASE) @ TURN)
    assert validate(ctr(), plate, registration="none").registration_error is None


def test_a_mirror_image_is_remarked_upon() -> None:
    m = turned(ctr(), 24)
    mirrored = replace(m, sensors=m.sensors * [-1.0, 1.0, 1.0])
    model = ArmModel(ctr(), mirrored)
    error = registration_error(model, model.start)
    assert error is not None
    assert error.mirrored == pytest.approx(0.0, abs=1e-6)
    assert "does a rotation or an axis of the device have the wrong sign?" in remark(error)
    right = validate(ctr(), m).registration_error
    assert right is not None
    assert not remark(right)
