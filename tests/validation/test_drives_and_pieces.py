"""Play and compliance of carriages, and curvature piece by piece, among what is fitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tubeopt import ConcentricRobot, InputError, Piece, Tube
from tubeopt.equilibrium.readings import to_model
from tubeopt.robots.calibration import Calibration
from tubeopt.validation import FitOptions, Measurements, fit
from tubeopt.validation.effects import Setup
from tubeopt.validation.measurements import Timeline
from tubeopt.validation.model import solve_poses
from tubeopt.validation.parameters import KINDS, choose_parameters

from .drives import driven, joints, robot, trivial
from .laboratory import MM, in_device

EXACT = FitOptions(folds=0)


def data_of(given: ConcentricRobot, drives: Calibration, count: int, noise: float = 0.05 * MM) -> Measurements:
    """Rows of the way of a robot with drives that play, and whose carriages yield."""
    time = np.arange(count) / 4
    read = joints(time, time[-1])
    clean = Measurements(read[:, :2], read[:, 2:], np.zeros((count, 3)), time=time)
    shift = Timeline.of(clean).with_play(read[:, 2:], np.array(drives.translation_play))
    alpha, model = to_model(replace(given, calibration=drives), read[:, :2], shift)
    tips = in_device(solve_poses(given, alpha, model, np.zeros(1)).position[:, 0])
    return replace(clean, sensors=tips[:, None] + np.random.default_rng(2).normal(0, noise, (count, 1, 3)))


def stacked() -> ConcentricRobot:
    """An S in a tube with a turned second bend, the stiffness of its first piece its own."""
    pieces = (Piece(40 * MM, 9.0, 0.02, 0.016), Piece(30 * MM, 0.0), Piece(35 * MM, (-4.0, 7.0, 0.0)))
    inner = Tube.of_pieces(1.0 * MM, 0.75 * MM, pieces, straight_length=150 * MM)
    return ConcentricRobot((inner, Tube(1.5 * MM, 1.15 * MM, 70 * MM, 60 * MM, 5.0)))


def test_play_of_carriages_is_found_and_written_down() -> None:
    truth = trivial(translation_play=(0.4 * MM, 0.9 * MM))
    fitted = fit(robot(), data_of(robot(), truth, 160), ["translation_play_all"], EXACT)
    for e, value in zip(fitted.estimates, truth.translation_play, strict=True):
        assert abs(e.value - value) < 3 * e.standard_error < 0.05 * MM
    assert fitted.robot.calibration is not None
    np.testing.assert_allclose(fitted.robot.calibration.translation_play, truth.translation_play, atol=0.1 * MM)


def test_compliance_of_carriages_is_found() -> None:
    truth = trivial(translation_compliance=(0.0, 0.01))
    fitted = fit(robot(), data_of(robot(), truth, 40), ["translation_compliance_2"], EXACT)
    (e,) = fitted.estimates
    assert e.unit == "m/N"
    assert abs(e.value - 0.01) < 3 * e.standard_error < 4e-3
    with pytest.raises(InputError, match="carriages that yield"):
        choose_parameters(robot(), driven(count=10), ["translation_compliance_3"])


def test_curvature_is_found_piece_by_piece() -> None:
    drawn, names = stacked(), ["piece_curvature_1_1", "piece_curvature_1_2", "piece_curvature_1_3"]
    data = data_of(drawn, trivial(), 60)
    parameters = choose_parameters(drawn, data, ["piece_curvature_all"])
    assert [p.name for p in parameters] == names
    setup = Setup.of(drawn)
    for p, value in zip(parameters, (0.5, -0.3, 0.8), strict=True):
        p.effect.change(setup, setup.copy(), p.which, value, False)
    made = setup.robot(drawn)
    assert isinstance(made, ConcentricRobot)
    first, straight, last = made.tubes[0].pieces
    assert first.precurvature == (9.5, 0.0, 0.0)
    assert straight.precurvature == (-0.3, 0.0, 0.0)
    np.testing.assert_allclose(last.precurvature, np.array([-4.0, 7.0, 0.0]) * (1 + 0.8 / np.hypot(4, 7)))
    fitted = fit(drawn, data_of(made, trivial(), 60), ["piece_curvature_all"], EXACT)
    assert [e.name for e in fitted.estimates] == names
    for e, value in zip(fitted.estimates, (0.5, -0.3, 0.8), strict=True):
        assert abs(e.value - value) < 3 * e.standard_error < 0.7


def test_lengths_and_stiffnesses_of_tubes_of_pieces_are_changed_piece_by_piece() -> None:
    setup = Setup.of(stacked())
    setup.curved_length[0] *= 1.1
    setup.bending_stiffness[0] *= 2
    setup.torsional_stiffness[0] *= 3
    setup.curvature[0] *= 0.5
    tube = setup.robot(stacked()).tubes[0]
    assert tube.curved_length == pytest.approx(1.1 * 105 * MM)
    first = tube.pieces[0]
    assert first.length == pytest.approx(44 * MM)
    assert (first.bending_stiffness, first.torsional_stiffness) == pytest.approx((0.04, 0.048))
    assert first.precurvature[0] == pytest.approx(4.5)


def test_pieces_that_are_not_there_are_refused() -> None:
    data = driven(count=10)
    assert "piece_curvature_I_J" in KINDS
    with pytest.raises(InputError, match="no tube of two or more pieces"):
        choose_parameters(robot(), data, ["piece_curvature_1_1"])
    with pytest.raises(InputError, match="choose from 1_1, 1_2, 1_3"):
        choose_parameters(stacked(), data, ["piece_curvature_2_1"])
    for wrong in ("piece_curvature_1", "rotation_1_1", "piece_curvature"):
        with pytest.raises(InputError, match=f"parameter '{wrong}' is not known"):
            choose_parameters(stacked(), data, [wrong])
