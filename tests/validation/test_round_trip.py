"""A saved fit predicts what the fit reported: every effect, alone and together, for every shipped robot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tubeopt import ConcentricRobot, InputError, load_robot
from tubeopt.robots.calibration import Calibration
from tubeopt.robots.robot import Robot
from tubeopt.solvers.robust_least_squares import LeastSquaresSolver
from tubeopt.validation import BasePose, FitOptions, Measurements, compare_effects, fit, validate
from tubeopt.validation.comparison import distances
from tubeopt.validation.fitting import FitProblem
from tubeopt.validation.model import solve_poses
from tubeopt.validation.parameters import choose_parameters, groups
from tubeopt.validation.sessions import Sessions

from .laboratory import BASE, CONFIGS, MM, TURN

ROBOTS = sorted(path.stem for path in (CONFIGS / "robots").glob("*.yaml"))

pytestmark = pytest.mark.filterwarnings("ignore:.*usual is")  # soft tubes of Braunschweig
ALIKE = 1e-3 * MM
ASKED = ("clearance", "translation_compliance")
QUICK = FitOptions(folds=0)


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tubeopt.validation.fitting.FITTING", LeastSquaresSolver(iterations=2))


def recording(robot: Robot, *, poses: bool = True, count: int = 14) -> Measurements:
    """A way of a few rows, whose sensor is off the tip and tilted, with noise."""
    random, n = np.random.default_rng(0), robot.n_tubes
    time = np.arange(count) / 4
    phase = np.minimum(time, time[-1] - time)
    rotations = 0.5 * np.sin(0.6 * np.outer(phase, 1 + 0.2 * np.arange(n)) + np.arange(n))
    rotations += 2.5 * np.sin(0.9 * phase)[:, None]  # all together, so that the tips tell the frame
    shift = np.tile(robot.home_translations, (count, 1))
    for tubes in robot.moving_together if isinstance(robot, ConcentricRobot) else ():
        if min(robot.tubes[i].straight_length for i in tubes) > 5 * MM:
            shift[:, list(tubes)] += (2e-3 + 1e-3 * np.sin(0.8 * phase + len(tubes)))[:, None]
    result = solve_poses(robot, rotations, shift, np.zeros(1))
    tips = (result.position[:, 0] + result.frame @ [1 * MM, 2 * MM, -3 * MM]) @ TURN.T + BASE
    wobble = Rotation.from_rotvec(random.normal([0.05, -0.03, 0.0], 0.01, (count, 3))).as_matrix()
    return Measurements(
        rotations,
        shift,
        tips + random.normal(0, 0.2 * MM, tips.shape),
        time=time,
        orientation=TURN @ result.frame @ wobble if poses else None,
        source="a way",
    )


def check_saved_fit(robot: Robot, m: Measurements, names: tuple[str, ...], options: FitOptions, folder: Path) -> None:
    """Assert that the saved robot has the errors of the fit, row by row."""
    chosen = choose_parameters(robot, m, names, options.registration)
    model = Sessions(robot, [m], options.registration, options.base).with_parameters(chosen)
    problem = FitProblem(model, options)
    result = problem.answer(lambda done, total: None)
    result.robot.save(folder / "robot.yaml")
    again = validate(load_robot(folder / "robot.yaml"), m)
    np.testing.assert_allclose(again.along, distances(problem.model, problem.fit.residuals)[0], atol=ALIKE)
    np.testing.assert_allclose(result.after.along, again.along, atol=1e-9)


@pytest.mark.parametrize("name", ROBOTS)
def test_all_effects_together_come_back(name: str, tmp_path: Path) -> None:
    robot = load_robot(CONFIGS / "robots" / f"{name}.yaml")
    m = recording(robot)
    known = groups(robot, m, "none", ())
    names = tuple(name for some in known.values() for name in some)
    check_saved_fit(robot, m, names, replace(QUICK, registration="none"), tmp_path)


@pytest.mark.parametrize("name", ROBOTS)
def test_each_effect_comes_back(name: str, tmp_path: Path) -> None:
    robot = load_robot(CONFIGS / "robots" / f"{name}.yaml")
    for poses in (False, True):
        m = recording(robot, poses=poses)
        for names in groups(robot, m, "rigid", ASKED).values():
            check_saved_fit(robot, m, names, QUICK, tmp_path)


OPTIONS = {
    "rigid": FitOptions(folds=0),
    "robust": FitOptions(folds=0, loss="huber"),
    "priors": FitOptions(folds=0, priors=True),
    "noise": FitOptions(folds=0, noise=(1e-3, 1e-3)),
    "base": FitOptions(folds=0, registration="base-axis", base=BasePose(tuple(BASE), tuple(TURN[:, 2]))),
    "none": FitOptions(folds=0, registration="none"),
}


@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS.keys())
def test_every_kind_of_fit_comes_back(options: FitOptions, tmp_path: Path) -> None:
    robot = load_robot(CONFIGS / "robots" / "two_tube.yaml")
    check_saved_fit(robot, recording(robot), ("rotation_2", "sensor_offset_all", "sensor_tilt_all"), options, tmp_path)


def test_a_fit_comes_back_by_least_squares_too() -> None:
    """The registration of a fit is the least-squares one: without the saved one the errors are the same."""
    robot = load_robot(CONFIGS / "robots" / "two_tube.yaml")
    m = recording(robot)
    fitted = fit(robot, m, ["curvature", "sensor_offset_all", "sensor_tilt_all"], FitOptions(folds=0))
    anew = validate(fitted.robot, m, registration="rigid")
    np.testing.assert_allclose(anew.along, fitted.after.along, atol=ALIKE)
    # Without the sensor where it was found to be the tips are off by what it is off.
    calibration = fitted.robot.calibration
    assert calibration is not None
    bare = replace(fitted.robot, calibration=replace(calibration, sensor_offset=(0.0, 0.0, 0.0)))
    assert validate(bare, m, registration="saved").summary.rms > 2 * fitted.after.summary.rms


def test_effects_that_pay_come_back(tmp_path: Path) -> None:
    robot = load_robot(CONFIGS / "robots" / "two_tube.yaml")
    m = recording(robot, count=40)
    result = compare_effects(robot, m, ["sensor_offset", "sensor_tilt", "latency"], FitOptions(folds=5))
    assert result.fit is not None
    result.fit.robot.save(tmp_path / "robot.yaml")
    again = validate(load_robot(tmp_path / "robot.yaml"), m)
    assert again.summary.rms == pytest.approx(result.fit.after.summary.rms, abs=1e-9)


def test_a_saved_registration_belongs_to_its_recording() -> None:
    robot = load_robot(CONFIGS / "robots" / "two_tube.yaml")
    m = recording(robot, poses=False)
    fitted = fit(robot, m, ["curvature"], FitOptions(folds=0))
    assert validate(fitted.robot, m).registration.method == "saved"
    moved = replace(m, sensors=m.sensors + 0.1)  # the device stands elsewhere
    assert validate(fitted.robot, moved).registration.method == "rigid"
    assert validate(fitted.robot, moved).summary.rms == pytest.approx(fitted.after.summary.rms)
    assert validate(fitted.robot, moved, registration="saved").summary.rms > 0.1
    with pytest.raises(InputError, match="registration is 'saved', but the robot's"):
        validate(robot, m, registration="saved")


def test_what_is_saved_of_a_measurement_changes_no_joint_value() -> None:
    bare = Calibration.none(2)
    off = replace(bare, sensor_offset=(1e-3, 0.0, 0.0), plate_tilt=(0.1, 0.0), rotation_middles=(1.0, 2.0))
    assert off.reads_true
    assert not off.trivial
    for a, b in zip(off.to_model([0.1, 0.2], [0.0, 0.0]), bare.to_model([0.1, 0.2], [0.0, 0.0]), strict=True):
        np.testing.assert_array_equal(a, b)
    with pytest.raises(InputError, match="sensor_offset has 2 numbers"):
        replace(bare, sensor_offset=(0.0, 0.0))


def test_straight_tubes_are_left_out_with_the_reason() -> None:
    robot = load_robot(CONFIGS / "robots" / "straight_sheath_ctr.yaml")
    m = recording(robot)
    fitted = fit(robot, m, ["friction_all", "curvature_3", "curved_length_3"], QUICK)
    assert [e.held for e in fitted.estimates] == [False, False, True, True]
    assert "curvature_3 has no influence on the tips and was left out: tube 3 has no curved part" in fitted.remarks
    compared = compare_effects(robot, m, ["friction", "curvature"], FitOptions(folds=4))
    assert any(remark.startswith("curvature_3 has no influence") for remark in compared.remarks)
    inside = replace(m, translations=m.translations - [0.0, 0.0, 5 * MM])
    fitted = fit(robot, inside, ["friction_all"], QUICK)
    assert fitted.estimates[1].held
    assert any("friction_2" in remark and "nowhere in front of the plate" in remark for remark in fitted.remarks)


def test_robots_of_straight_tubes_only_can_be_compared() -> None:
    inputs = load_robot(CONFIGS / "robots" / "straight_sheath_ctr.yaml")
    assert isinstance(inputs, ConcentricRobot)
    straight = replace(inputs, tubes=tuple(replace(tube, curvature=0.0) for tube in inputs.tubes))
    random = np.random.default_rng(0)
    rows = recording(inputs, poses=False)
    m = replace(rows, sensors=random.normal(0, 0.01, (len(rows), 1, 3)))
    compared = compare_effects(straight, m, (), FitOptions(folds=4, registration="none"))
    assert any("all tubes are straight" in remark or "no curved part" in remark for remark in compared.remarks)
