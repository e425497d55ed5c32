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
from tubeopt.validation.model import ArmModel, State
from tubeopt.validation.parameters import apply

from .laboratory import CONFIGS, DEVICE_BASE, MM, NOISE, ctr, etr, mirrored, noisy, turned

RUNS = 12
WITHIN = 11
"""Of 12 runs in which a 95 % interval must hold the truth."""

Case = tuple[Robot, Measurements, dict[str, float]]


@cache
def eccentric_case() -> Case:
    """The eccentric robot as given, tips of another one, and how the two differ."""
    given, offsets = etr(), np.radians([0.0, 4.0, -3.0])
    weaker = replace(given.tube, curvature=0.96 * given.tube.curvature)
    true = replace(given, tube=weaker, transmission_length=40 * MM)
    truth = {"curvature": 0.96, "transmission_length": 40 * MM, "rotation_2": offsets[1], "rotation_3": offsets[2]}
    return given, mirrored(true, 5, offsets), truth


@cache
def concentric_case() -> Case:
    """The concentric robot as given, tips of another one, and how the two differ."""
    given, offsets = ctr(), np.radians([0.0, 5.0])
    inner, outer = given.tubes

    def other(tube: Tube, curvature: float, modulus: float) -> Tube:
        alloy = replace(tube.material, youngs_modulus=modulus, shear_modulus=modulus / 2.5)
        return replace(tube, curvature=curvature, material=alloy)

    modulus = inner.material.youngs_modulus
    true = replace(given, tubes=(other(inner, 12.5, modulus), other(outer, 5.6, 1.2 * modulus)))
    measured = turned(true, 30)
    ratio = true.tubes[1].bending_stiffness / true.tubes[0].bending_stiffness
    truth = {"curvature_1": 12.5, "curvature_2": 5.6, "stiffness_ratio_2": ratio, "nu": 0.25, "rotation_2": offsets[1]}
    return given, replace(measured, rotations=measured.rotations - offsets), truth


CASES = pytest.mark.parametrize("case", [eccentric_case, concentric_case])


@CASES
def test_each_parameter_is_recovered_within_its_interval(case: Callable[[], Case]) -> None:
    given, perfect, truth = case()
    hits = dict.fromkeys(truth, 0)
    noises = []
    for seed in range(RUNS):
        found = fit(given, noisy(perfect, seed), list(truth), FitOptions(folds=0))
        assert not any(e.held for e in found.estimates)
        for e in found.estimates:
            hits[e.name] += bool(e.low <= truth[e.name] <= e.high)
        noises.append(found.noise)
    assert all(count >= WITHIN for count in hits.values()), hits
    assert np.mean(noises) == pytest.approx(NOISE, rel=0.05)


@CASES
def test_without_noise_the_parameters_are_found_exactly(case: Callable[[], Case]) -> None:
    given, perfect, truth = case()
    found = fit(given, perfect, list(truth), FitOptions(folds=0))
    for e in found.estimates:
        assert e.value == pytest.approx(truth[e.name], abs=1e-4 * max(abs(truth[e.name]), 0.1))
    assert found.after.summary.max < 1e-6
    assert found.before.summary.max > 1e-3
    again = validate(found.robot, perfect)
    assert again.summary.max == pytest.approx(found.after.summary.max, abs=1e-9)


@CASES
def test_the_jacobian_is_that_of_the_residuals(case: Callable[[], Case]) -> None:
    given, perfect, truth = case()
    data = noisy(perfect, 3)
    parameters = choose_parameters(given, data, list(truth))
    model = ArmModel(given, data, parameters, "rigid", BasePose())
    x = np.array([(p.start + truth[p.name]) / 2 for p in parameters])
    state = State(x, model.start.registration)
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
    given, perfect, _ = eccentric_case()
    data = noisy(perfect, 0)
    told: list[tuple[int, int]] = []
    found = fit(
        given, data, ["curvature"], FitOptions(folds=4), progress=lambda done, total: told.append((done, total))
    )
    assert found.held_out is not None
    assert found.held_out_errors is not None
    assert found.held_out_errors.shape == (20,)
    assert found.after.summary.rms < found.held_out.rms < 1.6 * found.after.summary.rms
    assert found.after.summary.rms < found.before.summary.rms
    assert told == [(k, 4) for k in (1, 2, 3, 4)]


def test_held_out_errors_unmask_parameters_that_only_fit_noise() -> None:
    given = etr()
    data = noisy(mirrored(given, 2), 5, noise=1.5 * MM)
    names = ["curvature", "rotation_1", "rotation_2", "transmission_length"]
    found = fit(given, data, names, FitOptions(folds=4))
    assert found.held_out is not None
    assert found.after.summary.rms < found.before.summary.rms < found.held_out.rms


# --- what data do not tell --------------------------------------------------------------------------------------------


def test_a_common_rotation_is_the_yaw_of_the_registration() -> None:
    given, perfect, _ = eccentric_case()
    data = noisy(perfect, 1)
    found = fit(given, data, ["curvature", "rotation_1", "rotation_2", "rotation_3"], FitOptions(folds=0))
    assert [e.held for e in found.estimates] == [False, False, False, True]
    assert found.remarks[0] == (
        "rotation_3 cannot be distinguished from a change of rotation_1 and rotation_2 together with the registration; "
        "held at 0 deg"
    )
    held = found.estimates[3]
    assert (held.value, held.standard_error, held.low, held.high) == (0.0, np.inf, -np.inf, np.inf)
    assert np.isnan(found.correlation[3]).all()


def test_without_registration_a_common_rotation_is_determined() -> None:
    given = ctr()
    perfect = turned(given, 12)
    offsets = np.radians([6.0, 2.0])
    there = replace(perfect, rotations=perfect.rotations - offsets)
    local = replace(there, sensors=validate(given, perfect).predicted)
    found = fit(given, noisy(local, 1), ["rotation_1", "rotation_2"], FitOptions(registration="none", folds=0))
    assert not found.remarks
    assert found.robot.calibration is not None
    np.testing.assert_allclose(found.robot.calibration.rotation_offsets, offsets, atol=np.radians(1.0))


def test_a_parameter_without_effect_is_named() -> None:
    concentric = ctr()
    straight = replace(concentric, tubes=tuple(replace(tube, curvature=0.0) for tube in concentric.tubes))
    with pytest.raises(InputError, match="predicted tips lie on a line"):
        fit(straight, turned(concentric, 5), ["curvature_1"], FitOptions(folds=0))
    given = etr()
    bent = mirrored(given, 4)
    together = bent.rows(np.isclose(bent.separation if bent.separation is not None else 0, 0.0))
    found = fit(given, noisy(together, 1), ["nu"], FitOptions(folds=0))
    assert found.estimates[0].held
    assert found.remarks[0].startswith("nu has next to no effect on the measured tips: a change by")
    known = FitOptions(registration="base-axis", base=DEVICE_BASE, folds=0)
    found = fit(given, noisy(together, 1), ["curvature", "nu"], known)
    assert [e.held for e in found.estimates] == [False, True]
    assert "held at 0.3488" in found.remarks[0]


def test_residuals_beyond_the_noise_that_was_given_are_said() -> None:
    options = FitOptions(registration="base-axis", base=DEVICE_BASE, folds=0, noise=(1e-6, None))
    given, measured = etr(), noisy(mirrored(etr(), 4), 1)
    found = fit(given, measured, ["curvature"], options)
    times = np.sqrt((found.after.residuals**2).mean()) / 1e-6
    (told,) = [float(words.split()[2]) for words in found.remarks if "times the noise that was given" in words]
    assert told == pytest.approx(times, rel=0.1)
    quiet = fit(given, measured, ["curvature"], replace(options, noise=(NOISE, None)))
    assert not any("times the noise" in words for words in quiet.remarks)


def test_what_is_hardly_determined_is_named() -> None:
    given, perfect, _ = eccentric_case()
    found = fit(given, noisy(perfect, 2), ["nu", "transmission_length"], FitOptions(folds=0))
    assert any("hardly determined" in remark or "ended at the edge" in remark for remark in found.remarks)


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
    given, perfect, _ = concentric_case()
    found = fit(given, perfect, ["curvature_1", "curvature_2"], options)
    assert any("had not settled after 1 steps" in remark for remark in found.remarks)


def test_steps_to_robots_that_cannot_be_are_shortened() -> None:
    """The outer tube would have to be longer than the inner one around which it lies."""
    given = ctr()
    inner, outer = given.tubes
    longer = replace(given, tubes=(replace(inner, straight_length=200 * MM), replace(outer, straight_length=180 * MM)))
    data = noisy(turned(longer, 20), 1, noise=0.05 * MM)
    found = fit(given, data, ["transmission_length_2", "rotation_2"], FitOptions(folds=2))
    added = found.robot.tubes[1].straight_length - outer.straight_length
    assert added <= inner.length - outer.length + 1e-12
    assert found.after.summary.rms <= found.before.summary.rms
