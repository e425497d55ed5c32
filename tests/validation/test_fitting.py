"""Fits: known parameters found again within their intervals, and in words what data do not tell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tubeopt import InputError, Tube, load_robot
from tubeopt.robots.robot import Robot
from tubeopt.solvers.robust_least_squares import LeastSquaresSolver
from tubeopt.validation import BasePose, FitOptions, Measurements, choose_parameters, fit, validate
from tubeopt.validation.effects import Setup
from tubeopt.validation.model import ArmModel, ParameterState
from tubeopt.validation.parameters import apply

from .laboratory import CONFIGS, DEVICE_BASE, MM, NOISE, ctr, etr, mirrored, noisy, turned

RUNS = 12
WITHIN = 11
"""Of 12 runs in which a 95 % interval must hold the truth."""

Case = tuple[Robot, Measurements, dict[str, float]]


@cache
def eccentric_case() -> Case:
    """The eccentric robot as given, tips of another one, and how the two differ."""
    inputs, offsets = etr(), np.radians([0.0, 4.0, -3.0])
    weaker = replace(inputs.tube, curvature=0.96 * inputs.tube.curvature)
    true = replace(inputs, tube=weaker, transmission_length=40 * MM)
    truth = {"curvature": 0.96, "transmission_length": 40 * MM, "rotation_2": offsets[1], "rotation_3": offsets[2]}
    return inputs, mirrored(true, 5, offsets), truth


@cache
def concentric_case() -> Case:
    """The concentric robot as given, tips of another one, and how the two differ."""
    inputs, offsets = ctr(), np.radians([0.0, 5.0])
    inner, outer = inputs.tubes

    def other(tube: Tube, curvature: float, modulus: float) -> Tube:
        alloy = replace(tube.material, youngs_modulus=modulus, shear_modulus=modulus / 2.5)
        return replace(tube, curvature=curvature, material=alloy)

    modulus = inner.material.youngs_modulus
    true = replace(inputs, tubes=(other(inner, 12.5, modulus), other(outer, 5.6, 1.2 * modulus)))
    measured = turned(true, 30)
    ratio = true.tubes[1].bending_stiffness / true.tubes[0].bending_stiffness
    truth = {"curvature_1": 12.5, "curvature_2": 5.6, "stiffness_ratio_2": ratio, "nu": 0.25, "rotation_2": offsets[1]}
    return inputs, replace(measured, rotations=measured.rotations - offsets), truth


CASES = pytest.mark.parametrize("case", [eccentric_case, concentric_case])


@CASES
def test_each_parameter_is_recovered_within_its_interval(case: Callable[[], Case]) -> None:
    inputs, perfect, truth = case()
    hits = dict.fromkeys(truth, 0)
    noises = []
    for seed in range(RUNS):
        fitted = fit(inputs, noisy(perfect, seed), list(truth), FitOptions(folds=0))
        assert not any(e.held for e in fitted.estimates)
        for e in fitted.estimates:
            hits[e.name] += bool(e.low <= truth[e.name] <= e.high)
        noises.append(fitted.noise)
    assert all(count >= WITHIN for count in hits.values()), hits
    assert np.mean(noises) == pytest.approx(NOISE, rel=0.05)


@CASES
def test_without_noise_the_parameters_are_found_exactly(case: Callable[[], Case]) -> None:
    inputs, perfect, truth = case()
    fitted = fit(inputs, perfect, list(truth), FitOptions(folds=0))
    for e in fitted.estimates:
        assert e.value == pytest.approx(truth[e.name], abs=1e-4 * max(abs(truth[e.name]), 0.1))
    assert fitted.after.summary.max < 1e-6
    assert fitted.before.summary.max > 1e-3
    again = validate(fitted.robot, perfect)
    assert again.summary.max == pytest.approx(fitted.after.summary.max, abs=1e-9)


@CASES
def test_the_jacobian_is_that_of_the_residuals(case: Callable[[], Case]) -> None:
    inputs, perfect, truth = case()
    data = noisy(perfect, 3)
    parameters = choose_parameters(inputs, data, list(truth))
    model = ArmModel(inputs, data, parameters, "rigid", BasePose())
    x = np.array([(p.start + truth[p.name]) / 2 for p in parameters])
    state = ParameterState(x, model.start.registration)
    slopes = model.jacobian(state)
    scales = [*(1e-3 * p.scale for p in parameters), *[1e-4] * 6]
    for k, size in enumerate(scales):
        step = np.zeros(len(scales))
        step[k] = size
        ahead, behind = (model.residuals(state.moved(side * step)) for side in (1, -1))
        np.testing.assert_allclose(
            (ahead - behind) / (2 * size), slopes[..., k], rtol=0, atol=2e-3 * np.abs(slopes[..., k]).max()
        )


def test_held_out_errors_are_a_little_larger_than_those_of_the_fit() -> None:
    inputs, perfect, _ = eccentric_case()
    data = noisy(perfect, 0)
    report: list[tuple[int, int]] = []
    fitted = fit(
        inputs, data, ["curvature"], FitOptions(folds=4), progress=lambda done, total: report.append((done, total))
    )
    assert fitted.held_out is not None
    assert fitted.held_out_errors is not None
    assert fitted.held_out_errors.shape == (20,)
    assert fitted.after.summary.rms < fitted.held_out.rms < 1.6 * fitted.after.summary.rms
    assert fitted.after.summary.rms < fitted.before.summary.rms
    assert report == [(k, 4) for k in (1, 2, 3, 4)]


def test_held_out_errors_unmask_parameters_that_only_fit_noise() -> None:
    inputs = etr()
    data = noisy(mirrored(inputs, 2), 5, noise=1.5 * MM)
    names = ["curvature", "rotation_1", "rotation_2", "transmission_length"]
    fitted = fit(inputs, data, names, FitOptions(folds=4))
    assert fitted.held_out is not None
    assert fitted.after.summary.rms < fitted.before.summary.rms < fitted.held_out.rms


# --- what data do not tell --------------------------------------------------------------------------------------------


def test_a_common_rotation_is_the_yaw_of_the_registration() -> None:
    inputs, perfect, _ = eccentric_case()
    data = noisy(perfect, 1)
    fitted = fit(inputs, data, ["curvature", "rotation_1", "rotation_2", "rotation_3"], FitOptions(folds=0))
    assert [e.held for e in fitted.estimates] == [False, False, False, True]
    assert fitted.remarks[0] == (
        "rotation_3 cannot be distinguished from a change of rotation_1 and rotation_2 together with the registration; "
        "fixed at 0 deg"
    )
    held = fitted.estimates[3]
    assert (held.value, held.standard_error, held.low, held.high) == (0.0, np.inf, -np.inf, np.inf)
    assert np.isnan(fitted.correlation[3]).all()


def test_without_registration_a_common_rotation_is_determined() -> None:
    inputs = ctr()
    perfect = turned(inputs, 12)
    offsets = np.radians([6.0, 2.0])
    reached = replace(perfect, rotations=perfect.rotations - offsets)
    local = replace(reached, sensors=validate(inputs, perfect).predicted)
    fitted = fit(inputs, noisy(local, 1), ["rotation_1", "rotation_2"], FitOptions(registration="none", folds=0))
    assert not fitted.remarks
    assert fitted.robot.calibration is not None
    np.testing.assert_allclose(fitted.robot.calibration.rotation_offsets, offsets, atol=np.radians(1.0))


def test_a_parameter_without_effect_is_named() -> None:
    concentric = ctr()
    straight = replace(concentric, tubes=tuple(replace(tube, curvature=0.0) for tube in concentric.tubes))
    with pytest.raises(InputError, match="predicted tips lie on a line"):
        fit(straight, turned(concentric, 5), ["curvature_1"], FitOptions(folds=0))
    inputs = etr()
    bent = mirrored(inputs, 4)
    together = bent.rows(np.isclose(bent.separation if bent.separation is not None else 0, 0.0))
    fitted = fit(inputs, noisy(together, 1), ["nu"], FitOptions(folds=0))
    assert fitted.estimates[0].held
    assert fitted.remarks[0].startswith("nu has next to no effect on the measured tips: a change by")
    known = FitOptions(registration="base-axis", base=DEVICE_BASE, folds=0)
    fitted = fit(inputs, noisy(together, 1), ["curvature", "nu"], known)
    assert [e.held for e in fitted.estimates] == [False, True]
    assert "fixed at 0.3488" in fitted.remarks[0]


def test_residuals_beyond_the_noise_that_was_given_are_said() -> None:
    options = FitOptions(registration="base-axis", base=DEVICE_BASE, folds=0, noise=(1e-6, None))
    inputs, measured = etr(), noisy(mirrored(etr(), 4), 1)
    fitted = fit(inputs, measured, ["curvature"], options)
    times = np.sqrt((fitted.after.residuals**2).mean()) / 1e-6
    (report,) = [float(text.split()[2]) for text in fitted.remarks if "times the noise that was given" in text]
    assert report == pytest.approx(times, rel=0.1)
    quiet = fit(inputs, measured, ["curvature"], replace(options, noise=(NOISE, None)))
    assert not any("times the noise" in text for text in quiet.remarks)


def test_what_is_hardly_determined_is_named() -> None:
    inputs, perfect, _ = eccentric_case()
    fitted = fit(inputs, noisy(perfect, 2), ["nu", "transmission_length"], FitOptions(folds=0))
    assert any("hardly determined" in remark or "ended at the edge" in remark for remark in fitted.remarks)


# --- parameters -------------------------------------------------------------------------------------------------------


def test_parameters_change_what_they_name() -> None:
    robot = ctr()
    data = turned(robot, 3)
    names = ["curvature_1", "stiffness_ratio_2", "nu_2", "transmission_length", "rotation_2"]
    chosen = choose_parameters(robot, data, names)
    changed = apply(Setup.of(robot), chosen, np.array([9.0, 2.0, 0.1, 0.01, 0.3])).robot(robot)
    inner, outer = changed.tubes
    assert inner.curvature == 9.0
    assert outer.curvature == robot.tubes[1].curvature
    assert outer.bending_stiffness / inner.bending_stiffness == pytest.approx(2.0)
    assert outer.bending_stiffness / outer.torsional_stiffness == pytest.approx(1.1)
    assert inner.material == robot.tubes[0].material
    assert [t.straight_length for t in changed.tubes] == pytest.approx([70 * MM, 60 * MM])
    assert changed.calibration is not None
    assert changed.calibration.rotation_offsets == pytest.approx([0.0, 0.3])


def test_parameters_at_their_start_change_nothing() -> None:
    for name in ("thesis_ctr", "thesis_etr", "example_three_segment_etr"):
        robot = load_robot(CONFIGS / "robots" / f"{name}.yaml")
        n = robot.n_tubes
        data = Measurements(np.zeros((2, n)), np.tile(robot.home_translations, (2, 1)), np.zeros((2, 3)))
        names = ["curvature", "nu", "transmission_length", "rotation_1"]
        names += ["stiffness_ratio_2"] if name != "thesis_etr" else []
        chosen = choose_parameters(robot, data, names)
        changed = apply(Setup.of(robot), chosen, np.array([p.start for p in chosen])).robot(robot)
        for a, b in zip(changed.tubes, robot.tubes, strict=True):
            assert (a.curvature, a.straight_length) == pytest.approx((b.curvature, b.straight_length))
            assert a.bending_stiffness == pytest.approx(b.bending_stiffness)
            assert a.torsional_stiffness == pytest.approx(b.torsional_stiffness)
        assert changed.calibration is None


@pytest.mark.parametrize(
    ("names", "problem"),
    [
        ([], "no parameters are given; choose from latency, translation_I"),
        ("curvature", "no parameters are"),
        (["curvatur"], "parameter 'curvatur' is not known; did you mean 'curvature'"),
        (["stiffness_ratio"], "parameter 'stiffness_ratio' is not known; did you mean 'stiffness_ratio_2'"),
        (["plate_shift_1"], "parameter 'plate_shift_1' is not known; did you mean 'plate_shift_z'"),
        (["stiffness_ratio_1"], "the robot has 2 tubes; the number must be 2 to 2"),
        (["rotation_3"], "the robot has 2 tubes; the number must be 1 to 2"),
        (["nu", "nu"], "parameter 'nu' is"),
        (["nu", "nu_1"], "parameters nu and nu_1 both set the nu; give"),
        (["Nu"], "parameter 'Nu' is not known; did you mean 'nu'"),
    ],
)
def test_wrong_parameters(names: list[str], problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        choose_parameters(ctr(), turned(ctr(), 3), names)


def test_an_eccentric_robot_has_one_kind_of_tube() -> None:
    data = mirrored(etr(), 2)
    with pytest.raises(InputError, match="the robot has 1 different tubes; it has no such parameter"):
        choose_parameters(etr(), data, ["stiffness_ratio_2"])
    assert choose_parameters(etr(), data, ["curvature_1"])[0].start == pytest.approx(1 / 0.12)


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"folds": 1}, "folds is 1; it must be 0, or 2 to the number of measurements, 5"),
        ({"folds": 6}, "folds is 6"),
        ({"confidence": 1.0}, "confidence is 1; it must lie between 0 and 1"),
        ({"registration": "loose"}, "registration is 'loose'"),
        ({"loss": "cubic"}, "loss is 'cubic'"),
        ({"noise": (0.0, None)}, "noise of the position is 0; it must be greater than 0"),
    ],
)
def test_wrong_options(options: dict[str, object], problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        fit(ctr(), turned(ctr(), 5), ["curvature"], FitOptions(**options))  # type: ignore[arg-type]


def test_too_few_measurements() -> None:
    with pytest.raises(InputError, match="3 measured tips are 9 numbers; 9 unknowns"):
        fit(ctr(), turned(ctr(), 3), ["curvature", "nu", "rotation_2"], FitOptions(folds=0))


def test_a_fit_that_does_not_converge_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tubeopt.validation.fitting.FITTING", LeastSquaresSolver(iterations=1))
    options = FitOptions(folds=0)
    inputs, perfect, _ = concentric_case()
    fitted = fit(inputs, perfect, ["curvature_1", "curvature_2"], options)
    assert any("had not settled after 1 steps" in remark for remark in fitted.remarks)


def test_steps_to_robots_that_cannot_be_are_shortened() -> None:
    """The outer tube would have to be longer than the inner one around which it lies."""
    inputs = ctr()
    inner, outer = inputs.tubes
    longer = replace(inputs, tubes=(replace(inner, straight_length=200 * MM), replace(outer, straight_length=180 * MM)))
    data = noisy(turned(longer, 20), 1, noise=0.05 * MM)
    fitted = fit(inputs, data, ["transmission_length_2", "rotation_2"], FitOptions(folds=2))
    added = fitted.robot.tubes[1].straight_length - outer.straight_length
    assert added <= inner.length - outer.length + 1e-12
    assert fitted.after.summary.rms <= fitted.before.summary.rms
