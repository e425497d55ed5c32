"""The force at the tip, told from where the arm is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

from tests.examples import CONFIGS, THESIS
from tubeopt import (
    ConcentricRobot,
    InputError,
    Load,
    Tube,
    estimate_force,
    estimate_forces,
    forward_kinematics,
    load_robot,
)
from tubeopt.robots.calibration import Calibration, SavedRegistration
from tubeopt.robots.concentric import Friction
from tubeopt.typing import Array
from tubeopt.validation import Measurements
from tubeopt.validation.force import ForceRecord
from tubeopt.validation.force_fit import Effort, Measured, trial_at

ROTATIONS = (0.0, 1.0, 2.0)
FORCES = ((0.1, 0.0, 0.0), (0.05, 0.1, -0.05), (0.0, 0.3, 0.2))


def shape(force: Array | tuple[float, ...], places: int) -> tuple[Array, list[tuple[float, Array]]]:
    """The tip, and some points of the arm under a force."""
    e = forward_kinematics(THESIS, ROTATIONS, load=Load(tuple(force)))  # type: ignore[arg-type]
    some = np.linspace(0, len(e.arc_length) - 1, places + 2).astype(int)[1:-1]
    return e.tip_position, [(float(e.arc_length[k]), e.position[k]) for k in some]


@pytest.mark.parametrize("force", FORCES)
def test_without_noise_the_force_comes_back(force: tuple[float, ...]) -> None:
    tip, points = shape(force, 4)
    for result in (
        estimate_force(THESIS, ROTATIONS, tip_position=tip, noise=1e-4),
        estimate_force(THESIS, ROTATIONS, tip_position=tip, points=points, noise=1e-4),
        estimate_force(THESIS, ROTATIONS, points=points, noise=1e-4),
    ):
        assert np.allclose(result.force, force, rtol=0, atol=1e-6)
        assert result.residual < 1e-8
        assert result.equilibrium.load == Load(tuple(result.force.tolist()))


def test_derivatives_are_those_of_differences_and_the_covariance_follows() -> None:
    force = np.array(FORCES[1])
    tip, points = shape(force, 3)
    noise, step = 2e-6, 1e-4  # so little that the covariance is that to first order
    result = estimate_force(THESIS, ROTATIONS, tip_position=tip, points=points, noise=noise)
    columns = []
    for k in range(3):
        sides = []
        for sign in (1, -1):
            reached, others = shape(force + sign * step * np.eye(3)[k], 3)
            sides.append(np.concatenate([*(p for _, p in others), reached]))
        columns.append((sides[0] - sides[1]) / (2 * step))
    jacobian = np.array(columns).T / noise
    assert np.allclose(result.covariance, np.linalg.inv(jacobian.T @ jacobian), rtol=1e-4)
    assert np.allclose(np.sort(result.errors**2), np.sort(np.linalg.eigvalsh(result.covariance)), rtol=1e-6)


def test_errors_are_as_large_as_the_covariance_says() -> None:
    random, noise, force = np.random.default_rng(4), 1e-4, np.array(FORCES[0])
    tip, points = shape(force, 5)
    distances, fits, guess = [], [], None
    for _ in range(20):
        noisy = [(s, p + noise * random.normal(size=3)) for s, p in points]
        at = tip + noise * random.normal(size=3)
        result = estimate_force(THESIS, ROTATIONS, tip_position=at, points=noisy, noise=noise, start=guess)
        guess = result.equilibrium
        error = result.force - force
        distances.append(float(error @ np.linalg.solve(result.covariance, error)))
        fits.append(result.fit[0] / result.fit[1])
    # A chi-squared of 3 degrees of freedom has the mean 3 and the variance 6.
    assert np.mean(distances) == pytest.approx(3, abs=3 * np.sqrt(6 / 20))
    assert np.mean(fits) == pytest.approx(1, abs=0.3)


def test_the_region_of_the_likelihood_is_that_of_the_measured_tip() -> None:
    """Where only the tip is measured a force is inside if its tip is within a ball of 2.7955 standard deviations."""
    noise, force = 3e-4, np.array(FORCES[1])
    tip, _ = shape(force, 1)
    result = estimate_force(THESIS, ROTATIONS, tip_position=tip, noise=noise)
    for away in ((1e-3, 0.0, 0.0), (0.0, -2e-3, 0.02), (0.0, 0.0, 0.05), (0.0, 0.0, -0.05)):
        other = force + np.array(away)
        reached, _ = shape(other, 1)
        distance = np.linalg.norm(reached - tip) / noise
        assert result.contains(other) == (distance < 2.7955)
        assert result.contains(other, 0.5) == (distance < 1.5382)


def test_what_cannot_be_told_is_said() -> None:
    tip, _ = shape((0.01, 0.0, 0.0), 1)
    result = estimate_force(THESIS, ROTATIONS, tip_position=tip, noise=1e-3)
    # Along the arm a force hardly moves the tip.
    assert result.errors[-1] > 10 * result.errors[0]
    assert "undetermined: along (" in result.undetermined
    sure = estimate_force(THESIS, ROTATIONS, tip_position=tip, noise=1e-7)
    assert sure.errors[0] < 1e-6


def test_a_short_arm_does_not_bound_the_force_along_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """It gives to 1 N along it by 0.004 standard deviations of what is measured: the fit settles across it only."""
    tubes = (Tube(1e-3, 0.66e-3, 0.175, 0.0372, 13.4), Tube(1.38e-3, 1.12e-3, 0.0998, 0.0575, 3.3))
    robot, turned = ConcentricRobot(tubes), (1.154, -0.787)
    true = np.array([0.02, 0.01, -0.01])
    tip = forward_kinematics(robot, turned, load=Load((0.02, 0.01, -0.01))).tip_position
    off = np.array([-1e-4, 1e-4, 2e-4])
    monkeypatch.setattr("tubeopt.validation.force.FULL", Effort(12, 1e-4))
    result = estimate_force(robot, turned, tip_position=tip + off, noise=1e-4)
    assert np.isfinite(result.errors).tolist() == [True, True, False]
    assert abs(result.directions[2, 2]) > 0.99
    across = result.directions[:2] @ (result.force - true)
    assert np.abs(across / result.errors[:2]).max() < 3
    assert "the measurement does not bound it" in result.undetermined


def test_no_force_along_a_stiff_arm_is_tried_that_no_measurement_shows() -> None:
    """One standard error along the arm is 1,300 N there, where 26 N buckle it straight; across it 0.12 N."""
    robot = load_robot(CONFIGS / "medlab_ctr.yaml")
    joints, true, noise = [0.3, -0.4, 1.2], np.array([-0.3, 0.1, 0.2]), 3e-4
    pushed = forward_kinematics(robot, joints, load=Load(tuple(true)))
    off = noise * np.array([1.0, -0.5, 0.8])
    result = estimate_force(robot, joints, tip_position=pushed.tip_position + off, noise=noise)
    assert np.isinf(result.errors[-1])
    assert result.iterations < 5
    assert np.linalg.norm(result.force) < 1.0
    flat = result.directions[:2]
    linear = np.linalg.pinv(forward_kinematics(robot, joints, load=result.equilibrium.load).compliance[:3, :3], 1e-2)
    assert flat @ (result.force - true) == pytest.approx(
        flat @ linear @ off, abs=0.2 * noise * np.linalg.norm(linear, 2)
    )


def test_other_loads_may_be_known() -> None:
    weight = Load(gravity=(0, 0, -9.81))
    tip = forward_kinematics(THESIS, ROTATIONS, load=Load((0.02, 0.03, 0), gravity=(0, 0, -9.81))).tip_position
    result = estimate_force(THESIS, ROTATIONS, tip_position=tip, noise=1e-5, known=weight)
    assert np.allclose(result.force, (0.02, 0.03, 0), atol=1e-6)


def test_force_beside_known_moments_is_found_with_the_errors_of_differences() -> None:
    known = Load(moment=(0.003, 0.002, 0.002), points=((0.06, (0, 0, 0), (0.004, 0, 0.002)),))
    force, noise = np.array((0.02, -0.01, 0.005)), 1e-7

    def tip(at: Array) -> Array:
        return forward_kinematics(THESIS, ROTATIONS, load=replace(known, force=tuple(at.tolist()))).tip_position

    result = estimate_force(THESIS, ROTATIONS, tip_position=tip(force), noise=noise, known=known)
    assert np.allclose(result.force, force, rtol=0, atol=1e-7)
    slope = np.transpose([(tip(force + d) - tip(force - d)) / 2e-4 for d in 1e-4 * np.eye(3)])
    assert np.abs(slope - slope.T).max() > 1e-5
    expected = noise**2 * np.linalg.inv(slope.T @ slope)
    assert np.allclose(result.covariance, expected, rtol=1e-3, atol=1e-3 * np.abs(expected).max())


def test_what_makes_no_sense_says_so() -> None:
    with pytest.raises(InputError, match="neither tip_position nor points"):
        estimate_force(THESIS, ROTATIONS)
    with pytest.raises(InputError, match=r"points\[0\] is at the arc length 1 m"):
        estimate_force(THESIS, ROTATIONS, points=[(1.0, (0, 0, 0))])
    with pytest.raises(InputError, match="noise is 0"):
        estimate_force(THESIS, ROTATIONS, tip_position=(0, 0, 0.2), noise=0)
    with pytest.raises(InputError, match="known has a force or moment that turns with the tip"):
        estimate_force(THESIS, ROTATIONS, tip_position=(0, 0, 0.2), known=Load(moment=(1, 0, 0), frame="tip"))


def test_what_the_estimates_leave_out_is_remarked() -> None:
    robot = replace(THESIS, clearance=(5e-5, 5e-5), friction=Friction(1e-3))
    made = [ForceRecord(each, None, 1e-4, (), ()).remarks for each in (THESIS, robot)]  # type: ignore[arg-type]
    assert made == [
        (),
        (
            "the room between the tubes (clearance) is left out of the estimates",
            "friction between the tubes is left out of the estimates",
        ),
    ]


def test_standard_errors_of_a_record_are_roots_of_variances() -> None:
    tip, points = shape(np.array(FORCES[0]), 2)
    result = estimate_force(THESIS, ROTATIONS, tip_position=tip, points=points, noise=1e-4)
    record = ForceRecord(THESIS, None, 1e-4, (result, None), ((1, "none"),))  # type: ignore[arg-type]
    assert record.standard_error[0] ** 2 == pytest.approx(np.diag(result.covariance), rel=1e-12)
    assert np.isnan(record.standard_error[1]).all()


def test_the_coverage_is_that_of_simulated_measurements() -> None:
    # So little noise that the force depends on it linearly: the ellipsoid is exact, and holds what it states.
    tip = forward_kinematics(THESIS, ROTATIONS, load=Load(FORCES[0])).tip_position
    result = estimate_force(THESIS, ROTATIONS, tip_position=tip, noise=2e-5)
    for confidence, draws in ((0.5, 60), (0.95, 30)):
        held = result.coverage(confidence, draws=draws, seed=5)
        assert abs(held - confidence) < 3 * np.sqrt(confidence * (1 - confidence) / draws)
    with pytest.raises(InputError, match="confidence is 95; it must be between 0 and 1"):
        result.coverage(95)
    with pytest.raises(InputError, match="draws is 0; it must be at least 1"):
        result.coverage(draws=0)


def recording(calibration: Calibration, forces: Array, places: tuple[float, ...] = (0.0,)) -> Measurements:
    """What a device sees of the calibrated robot under forces (N, 3): the truth by forward kinematics alone."""
    device = Rotation.from_rotvec([0.2, -0.4, 1.1])
    tilt = Rotation.from_rotvec([*calibration.plate_tilt, 0.0])
    rows, read = [], np.array([[0.1 * k, 1.0, 2.0 - 0.05 * k] for k in range(len(forces))])
    for turns, force in zip(read, forces, strict=True):
        alpha, shift = calibration.to_model(turns, [-3e-3, -2e-3, -1e-3])
        e = forward_kinematics(THESIS, alpha, shift, load=Load(tuple(force)))  # type: ignore[arg-type]
        innermost = e.tip_rotation @ Rotation.from_euler("z", e.rotation[0, -1]).as_matrix()
        arm = CubicHermiteSpline(e.arc_length, e.position, e.frame[:, :, 2])
        points = np.array([arm(e.arc_length[-1] - s) for s in places])
        points[0] = e.tip_position + innermost @ calibration.sensor_offset
        rows.append(device.inv().apply(tilt.apply(points) + calibration.plate_shift - [0.02, 0.03, -0.1]))
    shifts = np.tile([-3e-3, -2e-3, -1e-3], (len(forces), 1))
    return Measurements(read, shifts, np.array(rows), behind=np.array(places))


CALIBRATION = Calibration(
    rotation_offsets=(0.3, -0.1, 0.05),
    translation_offsets=(-1e-3, 0.5e-3, 0.0),
    rotation_gains=(1.01, 1.0, 0.99),
    translation_gains=(1.0, 1.02, 1.0),
    rotation_play=(0.0, 0.0, 0.0),
    sensor_offset=(0.5e-3, -0.3e-3, 1e-3),
    plate_shift=(1e-3, -2e-3, 0.5e-3),
    plate_tilt=(0.03, -0.02),
    registration=SavedRegistration(
        "", "rigid", tuple(map(tuple, Rotation.from_rotvec([0.2, -0.4, 1.1]).as_matrix())), (0.02, 0.03, -0.1)
    ),
)


@pytest.mark.parametrize("places", [(0.0,), (0.0, 0.03)])
def test_forces_of_a_calibrated_robot_come_back(places: tuple[float, ...]) -> None:
    """Offsets, gains, the sensor beside the tip, and where plate and device stand."""
    forces = np.array([[0.02, 0.005, 0.0], [0.0, 0.03, -0.01], [-0.02, 0.01, 0.01]])
    robot = replace(THESIS, calibration=CALIBRATION)
    m = recording(CALIBRATION, forces, places)
    result = estimate_forces(robot, m, noise=1e-5, registration="saved")
    # Between nodes the truth is interpolated by cubics.
    np.testing.assert_allclose(result.force, forces, rtol=0, atol=1e-6 if len(places) == 1 else 2e-4)
    with pytest.raises(InputError, match="registration is missing, and the robot's calibration"):
        estimate_forces(robot, m)
    with pytest.raises(InputError, match="registration is 'saved', but the robot's"):
        estimate_forces(replace(THESIS, calibration=replace(CALIBRATION, registration=None)), m, registration="saved")
    soft = replace(CALIBRATION, translation_compliance=(1e-3, 0.0, 0.0))
    with pytest.raises(InputError, match="the robot's calibration"):
        estimate_forces(replace(THESIS, calibration=soft), m, registration="saved")


def test_a_sensor_beside_the_tip_moves_as_the_tip_turns() -> None:
    """The derivative by the force, with the lever of the sensor, is that of differences."""
    offset, noise, step = np.array([5e-3, -3e-3, 10e-3]), 1e-3, 1e-4
    e = forward_kinematics(THESIS, ROTATIONS)
    for arcs in ([e.arc_length[-1]], [e.arc_length[-1], e.arc_length[-1] / 2]):
        measured = Measured(np.array(arcs), np.zeros((len(arcs), 3)), noise, offset)
        reached = [trial_at(e, Load(), force, measured).residual for force in step * np.vstack([np.eye(3), -np.eye(3)])]
        slopes = np.array([(a - b) / (2 * step) for a, b in zip(reached[3:], reached[:3], strict=True)]).T
        np.testing.assert_allclose(trial_at(e, Load(), np.zeros(3), measured).jacobian, slopes, rtol=1e-5, atol=1e-5)
