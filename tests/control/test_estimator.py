"""State estimation: the filter against closed forms, derivatives against differences, simulated robots."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy
from scipy.spatial.transform import Rotation

from tests.examples import PIECES, THESIS
from tubeopt import ConcentricRobot, Equilibrium, InputError, Load, Newton, SolveError, forward_kinematics, load_robot
from tubeopt.control.command import Command, ServoOptions
from tubeopt.control.estimator import (
    BaseReading,
    CurvatureReading,
    EstimatorOptions,
    Reading,
    StateEstimator,
    TipReading,
    potter,
)
from tubeopt.control.servo import Servo
from tubeopt.inverse.joints import joint_space
from tubeopt.typing import Array

SEED = ([0.0, 1.0, 2.0], [-0.05, -0.03, -0.02])
BIAS = np.radians([3.0, 3.0, 3.0])
STIFFER = (1.05, 0.95, 1.05)
QUICK = Newton(margin_tolerance=1e-3)
MODEL = EstimatorOptions(force=0.0, rotation=np.radians(3.0), translation=0.0, stiffness=0.05, tip_offset=1e-4)
"""What is estimated of a robot without load whose model is wrong."""


def real(robot: ConcentricRobot = THESIS) -> ConcentricRobot:
    tubes = (
        replace(
            tube,
            bending_stiffness=float(tube.bending_stiffness) * f,
            torsional_stiffness=float(tube.torsional_stiffness) * f,
            pieces=tuple(piece.stiffened(f) for piece in tube.pieces),
        )
        for tube, f in zip(robot.tubes, STIFFER, strict=True)
    )
    return replace(robot, tubes=tuple(tubes))


def test_an_estimator_closes_the_loop_below_a_tenth_of_a_millimetre_in_twenty_updates() -> None:
    # 40 Hz, 50 ms late, a third of the measurements lost, 0.05 mm of noise; the robot moves at 20 mm/s meanwhile.
    random, truth = np.random.default_rng(3), real()
    seed = forward_kinematics(THESIS, *SEED)
    servo = Servo(THESIS, seed, options=ServoOptions(speed=0.02))
    estimator = StateEstimator(seed, MODEL)
    estimator.encoders(0.0, *SEED)
    centre, arm, updates, k, missed, late = seed.tip_position, seed, 0, 0, [], []
    while updates < 20:
        k += 1
        target = centre + 0.01 * np.array([np.sin(k / 40), np.cos(k / 40) - 1, 0.3 * np.sin(k / 25)])
        for _ in range(5):
            step = servo.step(Command(position=target - estimator.shift(servo.equilibrium)), 5e-3)
        now = 25e-3 * k
        estimator.encoders(now, step.rotations, step.translations)
        arm = forward_kinematics(truth, step.rotations + BIAS, step.translations)
        late.append((now, TipReading(arm.tip_position + random.normal(0, 5e-5, 3), 5e-5)))
        missed.append(float(np.linalg.norm(arm.tip_position - target)))
        if len(late) > 2 and random.random() > 1 / 3:
            updates += estimator.measured(*late[-3]).used
    assert missed[0] > 1e-3
    assert max(missed[-2:]) < 1e-4
    _, tip = estimator.predict(step.rotations, step.translations)
    assert np.linalg.norm(tip - arm.tip_position) < 1e-4


def test_errors_of_tubes_of_pieces_are_estimated_too() -> None:
    random, truth = np.random.default_rng(1), real(PIECES)
    space = joint_space(PIECES)
    turn, shift = space.split(0.9 * space.sample(4)[1] + 0.1 * space.inside())
    estimator = StateEstimator(forward_kinematics(PIECES, turn, shift), MODEL)
    errors = []
    for k in range(20):
        now = turn + 0.3 * np.array([np.sin(k / 3), np.cos(k / 4), np.sin(k / 5 + 1)])
        estimator.encoders(float(k), now, shift)
        arm = forward_kinematics(truth, now + BIAS, shift)
        errors.append(float(np.linalg.norm(estimator.predict(now, shift)[1] - arm.tip_position)))
        assert estimator.measured(float(k), TipReading(arm.tip_position + random.normal(0, 5e-5, 3), 5e-5)).used
    assert errors[0] > 1e-3
    assert max(errors[-3:]) < 1e-4


def test_what_cannot_be_is_left_out_and_what_is_late_is_compared_with_its_own_time() -> None:
    seed = forward_kinematics(THESIS, *SEED)
    estimator = StateEstimator(seed, replace(MODEL, tip_offset=1e-3))
    here = TipReading(seed.tip_position)
    assert "no joint values" in estimator.measured(0.0, here).message
    with pytest.raises(InputError, match="call `encoders` first"):
        estimator.estimate()
    estimator.encoders(0.0, *SEED)
    estimator.encoders(1.0, np.array(SEED[0]) + 0.2, SEED[1])
    then = estimator.measured(0.0, here)
    assert then.used
    assert then.before < 1e-9
    far = estimator.measured(0.0, TipReading(seed.tip_position + np.array([0.2, 0, 0])))
    assert "farther off" in far.message
    for _ in range(9):
        far = estimator.measured(0.0, TipReading(seed.tip_position + np.array([0.2, 0, 0])))
    assert "10 in a row: the robot may have snapped" in far.message
    assert estimator.estimate().rotation_offsets == pytest.approx(0, abs=1e-9)
    assert "no joint values" in estimator.measured(2.0, here).message
    with pytest.raises(InputError, match="more than that of the last"):
        estimator.encoders(0.5, *SEED)


def test_a_branch_that_ends_is_said() -> None:
    # From home the inner tube snaps at 214 deg; the model cannot pass that.
    start = forward_kinematics(THESIS, [0.0, 0.0, 0.0])
    estimator = StateEstimator(start, EstimatorOptions(rotation=1e-4, translation=1e-5))
    home = np.zeros(3)
    estimator.encoders(0.0, home, home)
    estimator.encoders(0.1, np.radians([200.0, 0.0, 0.0]), home)
    before = estimator.estimate().equilibrium
    assert estimator.measured(0.1, TipReading(before.tip_position)).used
    estimator.encoders(0.2, np.radians([230.0, 0.0, 0.0]), home)
    assert "may have snapped" in estimator.measured(0.2, TipReading(before.tip_position)).message
    with pytest.raises(SolveError, match="branch"):
        estimator.estimate()
    estimator.encoders(0.3, np.radians([190.0, 0.0, 0.0]), home)
    assert estimator.estimate().equilibrium.stable


def test_a_square_root_filter_is_the_kalman_filter() -> None:
    random = np.random.default_rng(0)
    seed = forward_kinematics(THESIS, *SEED)
    states = StateEstimator(seed, EstimatorOptions(force_time=0.3, drift_time=2.0)).states
    sigma, tau = states.sigma, states.tau
    x, root = np.zeros(9), np.diag(sigma)
    mean, covariance = x, np.diag(sigma**2)
    for _ in range(30):
        dt, h, y = random.uniform(0.01, 0.2), random.normal(size=(4, 9)) / sigma, random.normal(size=4)
        x, root = states.predict(x, root, dt)
        x, root = potter(x, root, h, y)
        phi = np.exp(-dt / tau)
        mean = phi * mean
        covariance = np.outer(phi, phi) * covariance + np.diag((1 - phi**2) * sigma**2)
        gain = covariance @ h.T @ np.linalg.inv(h @ covariance @ h.T + np.eye(4))
        mean, covariance = mean + gain @ (y - h @ mean), (np.eye(9) - gain @ h) @ covariance
        assert x / sigma == pytest.approx(mean / sigma, abs=1e-10)
        assert root @ root.T / np.outer(sigma, sigma) == pytest.approx(covariance / np.outer(sigma, sigma), abs=1e-10)


def readings_of(arm: Equilibrium, random: np.random.Generator | None = None) -> list[Reading]:
    """Readings of all sensors at an equilibrium, exact or with their noise."""
    noise = random.normal if random else lambda mean, deviation, size: np.zeros(size)
    tip = TipReading(arm.tip_position, direction=arm.tip_rotation[:, 2])
    axes = arm.tip_rotation @ Rotation.from_rotvec([0, 0, arm.rotation[0, -1]]).as_matrix()
    turned = Rotation.from_rotvec(noise(0, tip.angle_noise, 3)).as_matrix()
    fibre = CurvatureReading((0.004, 0.02, 0.05, 0.08, 0.11), np.zeros((5, 2)))
    base = BaseReading(arm.base_wrench + noise(0, 1.0, 6) * np.repeat([5e-3, 1e-3], 3))
    model = StateEstimator(arm).states.model(arm, np.zeros(9))
    expected = -fibre.rows(model).innovation.reshape(-1, 2)
    return [
        replace(tip, position=arm.tip_position + noise(0, tip.noise, 3), direction=turned @ arm.tip_rotation[:, 2]),
        TipReading(arm.tip_position + noise(0, tip.noise, 3), rotation=turned @ axes),
        replace(fibre, curvature=expected + noise(0, fibre.noise, expected.shape)),
        base,
    ]


@pytest.mark.parametrize("pieces", [False, True])
def test_derivatives_of_all_readings(*, pieces: bool) -> None:
    robot, (turn, shift) = (PIECES if pieces else THESIS), SEED
    if pieces:
        space = joint_space(PIECES)
        turn, shift = space.split(0.9 * space.sample(4)[1] + 0.1 * space.inside())
    heavy = Load(gravity=(1.0, -9.0, 2.0))
    if not pieces:
        robot = replace(robot, tubes=tuple(replace(tube, mass_per_length=0.02) for tube in robot.tubes))
    options = EstimatorOptions(stiffness=0.05, tip_offset=1e-3, known=None if pieces else heavy)
    start = forward_kinematics(robot, turn, shift)
    states = StateEstimator(start, options).states
    x0 = 0.2 * states.sigma * np.cos(np.arange(len(states.sigma)))

    def arm_at(x: Array) -> Equilibrium:
        return StateEstimator(start, options).at(x, np.array(turn), np.array(shift))

    here = arm_at(x0)
    readings = readings_of(here)
    # A grating over a breakpoint, and one that is partly behind the plate.
    cut, end = float(here.section_start[1]), float(here.tube_end[0])
    readings.append(CurvatureReading((end - cut - 1e-3, end + 1e-3), np.zeros((2, 2)), tube=0, length=6e-3))
    readings.append(CurvatureReading((0.02,), np.zeros((1, 2)), tube=2))
    slopes = [reading.rows(states.model(here, x0)).slopes for reading in readings]
    for k, step in enumerate(1e-3 * states.sigma):
        sides = []
        for sign in (1, -1):
            x = x0.copy()
            x[k] += sign * step
            model = states.model(arm_at(x), x)
            sides.append([reading.rows(model).innovation for reading in readings])
        for known, ahead, behind in zip(slopes, *sides, strict=True):
            scale = np.abs(known * states.sigma).max()
            assert known[:, k] * states.sigma[k] == pytest.approx((behind - ahead) / 2e-3, abs=1e-4 * scale)


def move(time: float) -> tuple[Array, Array]:
    """Measured joint values at a time."""
    turn = SEED[0] + 0.6 * np.sin(np.array([2.0, 1.3, 1.7]) * time)
    return turn, SEED[1] + 4e-3 * np.sin(np.array([2.2, 1.5, 1.1]) * time)


def simulated(seed: int, steps: int, options: EstimatorOptions) -> tuple[StateEstimator, Array]:
    """An estimator after some steps of 10 ms of a simulated robot that is drawn from its priors, and the true state."""
    random = np.random.default_rng(seed)
    turned, shifted = random.normal(0, options.rotation, 3), random.normal(0, options.translation, 3)
    force, phi = random.normal(0, options.force, 3), np.exp(-0.01 / options.force_time)
    arm = forward_kinematics(THESIS, *SEED)
    estimator, late = StateEstimator(arm, options), []
    for k in range(steps):
        turn, shift = move(0.01 * k)
        if k:
            force = phi * force + np.sqrt(1 - phi**2) * random.normal(0, options.force, 3)
        load = Load(tuple(force.tolist()))
        arm = forward_kinematics(THESIS, turn + turned, shift + shifted, load=load, start=arm, method=QUICK)
        tip, _, fibre, base = readings_of(arm, random)
        estimator.encoders(0.01 * k, turn, shift)
        estimator.measured(0.01 * k, fibre, base)
        late.append((0.01 * k, tip))
        if len(late) > 5 and random.random() > 1 / 3:
            estimator.measured(*late[-6])
    return estimator, np.concatenate([force, turned, shifted])


def test_errors_are_as_large_as_the_covariance_says() -> None:
    errors = []
    for seed in range(4):
        estimator, truth = simulated(seed, 12, EstimatorOptions())
        estimate = estimator.estimate()
        errors.append((estimate.state - truth) @ np.linalg.solve(estimate.covariance, estimate.state - truth))
    low, high = scipy.stats.chi2.ppf([0.025, 0.975], 9 * len(errors))
    assert low < sum(errors) < high


def test_late_readings_count_as_much_as_those_in_time() -> None:
    options = EstimatorOptions()
    random, seed = np.random.default_rng(5), forward_kinematics(THESIS, *SEED)
    in_time, late = StateEstimator(seed, options), StateEstimator(seed, options)
    held, arm = [], seed
    for k in range(7):
        turn, shift = move(0.01 * k)
        load = Load((0.02, -0.01, 0.01))
        arm = forward_kinematics(THESIS, turn + 0.01, shift - 3e-4, load=load, start=arm, method=QUICK)
        tip, _, _, base = readings_of(arm, random)
        for estimator in (in_time, late):
            estimator.encoders(0.01 * k, turn, shift)
        assert in_time.measured(0.01 * k, base).used
        assert late.measured(0.01 * k, base).used
        assert in_time.measured(0.01 * k, tip).used
        held.append((0.01 * k, tip))
        if k >= 3:
            late.measured(*held[k - 3])
    for each in held[-3:]:
        late.measured(*each)
    one, two = in_time.estimate(), late.estimate()
    spread = np.sqrt(np.diag(one.covariance))
    # The linearisations differ by what was known at their time.
    assert two.state / spread == pytest.approx(one.state / spread, abs=0.1)
    assert np.diag(two.covariance) == pytest.approx(np.diag(one.covariance), rel=0.02)


def test_what_is_not_measured_returns_to_its_prior_and_is_called_not_observed() -> None:
    seed = forward_kinematics(THESIS, *SEED)
    estimator = StateEstimator(seed, EstimatorOptions(rotation=1e-3, translation=1e-4))
    pushed = forward_kinematics(THESIS, *SEED, load=Load((0.03, 0.02, 0.0)))
    estimator.encoders(0.0, *SEED)
    for _ in range(10):
        assert estimator.measured(0.0, TipReading(pushed.tip_position)).used
    estimate = estimator.estimate()
    assert (estimate.force_errors[:2] < 2e-3).all()
    assert estimate.force[:2] == pytest.approx([0.03, 0.02], abs=3e-3)
    tip = np.sqrt(np.linalg.eigvalsh(estimate.shape_covariance[-1]))
    assert (tip < 3e-4 / np.sqrt(10) * 1.05).all()
    assert estimate.shape_covariance[0] == pytest.approx(0, abs=1e-15)
    assert "the rotation offset of tube 1" in estimate.unobserved
    # After ten correlation times without a reading nothing is known of the force.
    estimator.encoders(0.9, *SEED)
    estimator.encoders(10.0, *SEED)
    later = estimator.estimate()
    assert later.force == pytest.approx(0, abs=1e-5)
    assert later.force_errors == pytest.approx(0.05, rel=1e-3)
    assert not later.force_observed.any()
    assert "the force along" in later.unobserved


def test_other_robots_and_senseless_input_are_refused() -> None:
    etr = load_robot("configs/robots/thesis_etr.yaml")
    with pytest.raises(InputError, match="concentric robots only"):
        StateEstimator(forward_kinematics(etr, np.zeros(3)))
    with pytest.raises(InputError, match="rotation is -1"):
        EstimatorOptions(rotation=-1.0)
    with pytest.raises(InputError, match="nothing to estimate"):
        StateEstimator(forward_kinematics(THESIS, *SEED), EstimatorOptions(force=0, rotation=0, translation=0))
    with pytest.raises(InputError, match="its frame must be 'world'"):
        EstimatorOptions(known=Load((0.1, 0, 0), frame="tip"))
    estimator = StateEstimator(forward_kinematics(THESIS, *SEED))
    estimator.encoders(0.0, *SEED)
    for reading, words in (
        (TipReading((0, 0, np.nan)), "position"),
        (TipReading((0, 0, 0), noise=0.0), "noise"),
        (CurvatureReading((0.01,), np.zeros((1, 2)), tube=3), "0 to 2"),
        (CurvatureReading((0.0,), np.zeros((1, 2))), "half a grating"),
        (CurvatureReading((0.01,), np.zeros((2, 2))), "two finite numbers"),
        (BaseReading(np.zeros(3)), "wrench"),
    ):
        with pytest.raises(InputError, match=words):
            estimator.measured(0.0, reading)
