"""How the columns of a recording are read: units, directions and zeros that were drawn, and open questions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tubeopt import InputError, SolveError
from tubeopt.typing import Array
from tubeopt.validation.reading import ANGLES, LENGTHS, RawLog, Reading, detect
from tubeopt.validation.registration import register, registered_residuals

from .drives import RATE, joints, poses, robot, trivial
from .laboratory import MM, in_device

TRUE = Reading("rad", "m", "mm", (1, -1), (-1, 1), (0.0, 2.1), (0.043, -0.021), 0.11)


def written(reading: Reading, count: int = 240, *, still: bool = False, seed: int = 0) -> RawLog:
    """Columns of a way as a laboratory with such drives writes them; `still` turns no tube."""
    time = np.arange(count) / RATE
    now, late = (joints(time - delay, time[-1]) for delay in (0.0, reading.latency))
    if still:
        now[:, :2], late[:, :2] = 0.0, 0.0
    tips = in_device(poses(robot(), trivial(), late).position[:, 0])
    tips += np.random.default_rng(seed).normal(0, 0.3 * MM, tips.shape)
    raw_turns = (now[:, :2] - reading.rotation_zeros) * reading.rotation_signs / ANGLES[reading.rotation_unit]
    raw_shifts = (now[:, 2:] - reading.translation_zeros) * reading.translation_signs
    raw_shifts /= LENGTHS[reading.translation_unit]
    return RawLog(raw_turns, raw_shifts, time, tips[:, None] / LENGTHS[reading.position_unit], time)


def read_as(reading: Reading) -> tuple[object, ...]:
    return (
        reading.rotation_unit,
        reading.translation_unit,
        reading.position_unit,
        reading.rotation_signs,
        reading.translation_signs,
    )


def test_units_directions_and_zeros_are_found() -> None:
    found = detect(robot(), written(TRUE))
    assert read_as(found.reading) == read_as(TRUE)
    assert all(decision.certain for decision in found.decisions)
    assert found.rms < 0.8 * MM
    zero = found.reading.rotation_zeros[1] - TRUE.rotation_zeros[1]
    assert abs((zero + np.pi) % (2 * np.pi) - np.pi) < np.radians(2)
    np.testing.assert_allclose(found.reading.translation_zeros, TRUE.translation_zeros, atol=2 * MM)
    assert found.reading.latency == pytest.approx(TRUE.latency, abs=0.03)
    # Another recording of these drives, homed elsewhere, takes no second search.
    moved = replace(TRUE, translation_zeros=(0.035, -0.015), rotation_zeros=(0.0, 1.8))
    again = detect(robot(), written(moved, seed=1), found.reading)
    assert read_as(again.reading) == read_as(TRUE)
    np.testing.assert_allclose(again.reading.translation_zeros, moved.translation_zeros, atol=2 * MM)


def test_what_does_not_move_is_asked_for() -> None:
    log = written(replace(TRUE, rotation_zeros=(0.0, 0.0)), still=True)
    found = detect(robot(), log)
    open_ones = {d.about: d.reason for d in found.decisions if not d.certain}
    assert {name: open_ones[name] for name in ("rotation_1", "rotation_2")} == dict.fromkeys(
        ("rotation_1", "rotation_2"), "it does not move"
    )
    answered = detect(robot(), log, answers=[("rotation_1", "forward"), ("rotation_2", "reversed")])
    assert answered.reading.rotation_signs == (1, -1)
    assert not {d.about for d in answered.decisions if not d.certain} & {"rotation_1", "rotation_2"}


def test_sizes_that_fit_no_unit_are_refused() -> None:
    log = written(TRUE)
    with pytest.raises(InputError, match=r"translations range over .* mm in mm or .* mm in m; they must range over"):
        detect(robot(), replace(log, translations=log.translations * 12.0))
    with pytest.raises(InputError, match="there are 11 rows with a position"):
        detect(robot(), replace(log, sensors=np.where(np.arange(240)[:, None, None] < 11, log.sensors, np.nan)))


def test_tips_of_something_else_are_refused() -> None:
    log = written(TRUE)
    other = np.random.default_rng(3).normal(size=log.sensors.shape) * 30.0
    with pytest.raises(SolveError, match="no units and directions of the columns explain the tips"):
        detect(robot(), replace(log, sensors=other), answers=[("rotation_1", "forward"), ("rotation_2", "forward")])


def motions(random: np.random.Generator) -> Array:
    return np.asarray(random.normal(size=(9, 3)) * [30 * MM, 20 * MM, 10 * MM])


def test_many_registrations_are_those_one_by_one() -> None:
    random = np.random.default_rng(0)
    measured = motions(random)
    turned = measured @ Rotation.random(random_state=1).as_matrix().T + [0.1, 0.2, 0.3]
    predicted = np.stack([turned + random.normal(0, MM, (9, 3)), motions(random), measured * [1, 1, -1]])
    found = registered_residuals(measured, predicted)
    for residuals, some in zip(found, predicted, strict=True):
        motion = register(measured, some)
        np.testing.assert_allclose(residuals, (motion.apply(measured) - some) @ motion.rotation, atol=1e-12)
    # A mirror image is not matched.
    assert np.sqrt((found[2] ** 2).sum(1).mean()) > 5 * MM
    predicted[0, 4] = np.nan
    with_gap = registered_residuals(measured, predicted)
    assert np.isnan(with_gap[0, 4]).all()
    np.testing.assert_allclose(
        np.delete(with_gap[0], 4, 0),
        registered_residuals(np.delete(measured, 4, 0), np.delete(predicted[:1], 4, 1))[0],
        atol=1e-12,
    )
