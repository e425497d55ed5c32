"""A robot whose tubes are stiffer and turned otherwise than its model: what measured tips make of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.examples import PIECES, THESIS
from tubeopt import ConcentricRobot, InputError, forward_kinematics, load_robot
from tubeopt.control.command import Command, ServoOptions
from tubeopt.control.observer import Observer, ObserverOptions
from tubeopt.control.servo import Servo
from tubeopt.inverse.joints import joint_space

SEED = ([0.0, 1.0, 2.0], [-0.05, -0.03, -0.02])
BIAS = np.radians([3.0, 3.0, 3.0])
STIFFER = (1.05, 0.95, 1.05)


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


def test_an_observer_closes_the_loop_below_a_tenth_of_a_millimetre_in_twenty_updates() -> None:
    # 40 Hz, 50 ms late, a third of the measurements lost, 0.05 mm of noise; the robot moves at 20 mm/s meanwhile.
    random, truth = np.random.default_rng(3), real()
    seed = forward_kinematics(THESIS, *SEED)
    servo = Servo(THESIS, seed, options=ServoOptions(speed=0.02))
    observer = Observer(seed, ObserverOptions(noise=5e-5))
    observer.sent(0.0, *SEED)
    centre, arm, updates, k, missed, late = seed.tip_position, seed, 0, 0, [], []
    while updates < 20:
        k += 1
        target = centre + 0.01 * np.array([np.sin(k / 40), np.cos(k / 40) - 1, 0.3 * np.sin(k / 25)])
        for _ in range(5):
            step = servo.step(Command(position=target - observer.shift(servo.equilibrium)), 5e-3)
        now = 25e-3 * k
        observer.sent(now, step.rotations, step.translations)
        arm = forward_kinematics(truth, step.rotations + BIAS, step.translations)
        late.append((now, arm.tip_position + random.normal(0, 5e-5, 3)))
        missed.append(float(np.linalg.norm(arm.tip_position - target)))
        if len(late) > 2 and random.random() > 1 / 3:
            updates += observer.measured(*late[-3]).used
    assert missed[0] > 1e-3
    assert max(missed[-2:]) < 1e-4
    _, tip = observer.predict(step.rotations, step.translations)
    assert np.linalg.norm(tip - arm.tip_position) < 1e-4


def test_tubes_of_pieces_are_observed_too() -> None:
    random, truth = np.random.default_rng(1), real(PIECES)
    space = joint_space(PIECES)
    turn, shift = space.split(0.9 * space.sample(4)[1] + 0.1 * space.inside())
    observer = Observer(forward_kinematics(PIECES, turn, shift), ObserverOptions(noise=5e-5))
    errors = []
    for k in range(20):
        now = turn + 0.3 * np.array([np.sin(k / 3), np.cos(k / 4), np.sin(k / 5 + 1)])
        observer.sent(float(k), now, shift)
        arm = forward_kinematics(truth, now + BIAS, shift)
        errors.append(float(np.linalg.norm(observer.predict(now, shift)[1] - arm.tip_position)))
        assert observer.measured(float(k), arm.tip_position + random.normal(0, 5e-5, 3)).used
    assert errors[0] > 1e-3
    assert max(errors[-3:]) < 1e-4


def test_what_cannot_be_is_left_out_and_what_is_late_is_compared_with_its_own_time() -> None:
    seed = forward_kinematics(THESIS, *SEED)
    observer = Observer(seed)
    assert "no joint values" in observer.measured(0.0, seed.tip_position).words
    observer.sent(0.0, *SEED)
    observer.sent(1.0, np.array(SEED[0]) + 0.2, SEED[1])
    then = observer.measured(0.0, seed.tip_position)
    assert then.used
    assert then.before < 1e-9
    far = observer.measured(0.0, seed.tip_position + np.array([0.1, 0, 0]))
    assert "farther off" in far.words
    assert observer.rotation_offsets == pytest.approx(0, abs=1e-9)
    assert "no joint values" in observer.measured(2.0, seed.tip_position).words
    with pytest.raises(InputError, match="more than that of the last"):
        observer.sent(0.5, *SEED)


def test_other_robots_and_senseless_options_are_refused() -> None:
    etr = load_robot("configs/robots/thesis_etr.yaml")
    with pytest.raises(InputError, match="concentric robots only"):
        Observer(forward_kinematics(etr, np.zeros(3)))
    with pytest.raises(InputError, match="noise is 0"):
        ObserverOptions(noise=0.0)
