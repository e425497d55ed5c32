"""Two tubes of equal length: their order leaves the carriages no play, but each has a carriage of its own."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import tubeopt
from tests.examples import TWO_TUBE
from tubeopt.control.c_binding import CServo
from tubeopt.control.c_library import c_library
from tubeopt.control.command import Command
from tubeopt.control.servo import Servo
from tubeopt.design.parameters import as_pieces
from tubeopt.errors import InputError
from tubeopt.inverse.joints import joint_space
from tubeopt.inverse.posture import start_at
from tubeopt.planning.roadmap import build_roadmap
from tubeopt.show.viewer import open_session

APART = (-0.02, -0.005)
"""Translations (m) at which tube 1 ends 15 mm inside tube 2."""

CROSSED = (-0.005, -0.02)
"""Translations (m) at which the carriage of tube 1 would be 15 mm before that of tube 2."""

REFUSED = (
    "translations of {} of tubes 1 and 2 are -5 mm and -20 mm: the carriage of tube 1 would be in front of the "
    "carriage of tube 2"
)


def test_a_plan_begins_and_ends_with_the_carriages_where_they_were_asked_for() -> None:
    plan = tubeopt.plan_trajectory(TWO_TUBE, ([0, 0], APART), ([0.4, 0], (-0.01, -0.01)))
    assert plan.proved
    np.testing.assert_array_equal(plan.translations[0], APART)
    np.testing.assert_array_equal(plan.translations[-1], (-0.01, -0.01))
    back = tubeopt.plan_trajectory(TWO_TUBE, ([0, 0], (-0.01, -0.01)), ([0.4, 0], APART))
    assert back.proved
    np.testing.assert_array_equal(back.translations[-1], APART)
    # The order of the tubes is kept on the way, as far as start and goal keep it.
    assert (plan.translations[:, 1] >= plan.translations[:, 0] - 1e-12).all()


def test_a_plan_without_play_moves_both_carriages_as_one() -> None:
    plan = tubeopt.plan_trajectory(TWO_TUBE, ([0, 0], (-0.03, -0.03)), ([0.4, 0], (-0.01, -0.01)))
    np.testing.assert_array_equal(plan.translations[:, 0], plan.translations[:, 1])


@pytest.mark.parametrize(("relative", "straight"), [(0.8, True), (3.2, False)])
@pytest.mark.parametrize("shift", [(-0.02, -0.005), (-0.04, 0.0), (-0.05, -0.01)])
def test_a_way_from_a_seed_is_one_that_find_snap_finds_free(
    shift: tuple[float, float], relative: float, straight: bool
) -> None:
    """Straight where the tubes are turned little against each other, around where they oppose each other."""
    target = tubeopt.forward_kinematics(TWO_TUBE, [0.0, relative - 0.2], (-0.01, -0.01)).tip_position
    seed = (np.array([0.0, relative]), np.array(shift))
    solution = tubeopt.inverse_kinematics(TWO_TUBE, target, start=seed, reachable=True)
    assert solution.reached
    assert solution.straight_from_seed == straight
    if straight:
        assert tubeopt.find_snap(TWO_TUBE, seed, (solution.rotations, solution.translations)) is None
    assert solution.path is not None
    np.testing.assert_array_equal(solution.path.rotations[0], seed[0])
    np.testing.assert_array_equal(solution.path.translations[0], seed[1])
    assert not tubeopt.follow(TWO_TUBE, solution.path.rotations, solution.path.translations).snaps


def test_a_step_of_a_servo_is_no_longer_than_its_rates_allow() -> None:
    servo = Servo(TWO_TUBE, ([0.0, 0.3], APART))
    start = servo.equilibrium.translations
    np.testing.assert_array_equal(start, APART)
    servo.step(Command(position=servo.equilibrium.tip_position + np.array([0.0, 0.0, 1e-3])), 1e-3)
    moved = np.abs(servo.equilibrium.translations - start)
    assert 0 < moved.max() <= servo.options.shift_rate * 1e-3 * (1 + 1e-9)


def test_trajectories_with_carriages_apart_are_followed_and_have_no_fault() -> None:
    proof = tubeopt.verify_trajectory(TWO_TUBE, [0, 5], [[0, 0], [0.5, 0]], [APART, (-0.01, -0.01)])
    assert proof.holds
    crossed = tubeopt.verify_trajectory(TWO_TUBE, [0, 5], [[0, 0], [0.5, 0]], [CROSSED, (-0.01, -0.01)])
    assert "the carriage of tube 1 would be in front of the carriage of tube 2, by 15 mm" in crossed.faults[0]


def test_reach_from_a_start_with_carriages_apart() -> None:
    start = tubeopt.forward_kinematics(TWO_TUBE, [0.0, 0.0], APART)
    goal = tubeopt.forward_kinematics(TWO_TUBE, [0.3, 0.2], (-0.025, -0.01))
    reach = tubeopt.evaluate_reach(TWO_TUBE, start, [goal.tip_position], count=20)
    assert reach.fraction == 1.0
    reached = tubeopt.forward_kinematics(TWO_TUBE, reach.rotations[0], reach.translations[0])
    np.testing.assert_allclose(reached.tip_position, goal.tip_position, atol=5e-4)
    stays = tubeopt.evaluate_reach(TWO_TUBE, ([0.0, 0.0], APART), [start.tip_position], count=20)
    assert stays.miss == 0.0  # the tip is there before the robot moves


@pytest.mark.parametrize(
    ("name", "enter"),
    [
        ("start", lambda q: tubeopt.plan_trajectory(TWO_TUBE, q, ([0.4, 0], None))),
        (
            "start",
            lambda q: tubeopt.plan_trajectory(TWO_TUBE, tubeopt.forward_kinematics(TWO_TUBE, *q), ([0, 1], None)),
        ),
        ("goal", lambda q: tubeopt.plan_trajectory(TWO_TUBE, ([0.4, 0], None), q)),
        ("start", lambda q: tubeopt.inverse_kinematics(TWO_TUBE, [0, -0.02, 0.09], start=q)),
        ("reference", lambda q: tubeopt.inverse_kinematics(TWO_TUBE, [0, -0.02, 0.09], reference=q)),
        ("start", lambda q: tubeopt.IkSession(TWO_TUBE, start=q)),
        ("start", lambda q: Servo(TWO_TUBE, q)),
        ("joints", lambda q: Servo(TWO_TUBE, ([0, 0], None)).step(Command(joints=q), 1e-3)),
        ("goal", lambda q: tubeopt.follow_the_leader(TWO_TUBE, q)),
        ("start", lambda q: tubeopt.follow_tip_path(TWO_TUBE, [[0, -0.02, 0.09], [0, -0.02, 0.08]], start=q)),
        ("start", lambda q: tubeopt.evaluate_reach(TWO_TUBE, q, [[0, -0.02, 0.09]], count=20)),
        ("", lambda q: open_session(TWO_TUBE, *q)),
    ],
)
def test_joint_values_out_of_order_are_refused_where_they_enter(name: str, enter: Callable[[Any], Any]) -> None:
    with pytest.raises(InputError) as refused:
        enter(([0.0, 0.0], CROSSED))
    assert (REFUSED.format(name) if name else REFUSED.replace(" of {}", "")) in str(refused.value)
    assert "by 15 mm" in str(refused.value)


def test_a_servo_in_c_takes_no_seed_and_no_joints_that_it_cannot_keep() -> None:
    library = c_library(TWO_TUBE)
    with pytest.raises(
        InputError, match="translations of start of tubes 1 and 2 are -20 mm and -5 mm: tube 1 would end"
    ):
        CServo(library, ([0.0, 0.0], APART))
    servo = CServo(library, ([0.0, 0.0], (-0.02, -0.02)))
    with pytest.raises(InputError, match="translations of joints of tubes 1 and 2"):
        servo.step(Command(joints=(np.zeros(2), np.array(APART))), 1e-3)


def test_a_roadmap_in_which_carriages_are_one_is_refused_where_they_are_apart() -> None:
    options = tubeopt.PlanOptions(roadmap=build_roadmap(TWO_TUBE, count=20))
    with pytest.raises(InputError, match="carriages that move together in the roadmap"):
        tubeopt.plan_trajectory(TWO_TUBE, ([0, 0], APART), ([0.4, 0], None), options=options)


def test_weights_are_one_per_tube_where_carriages_are_one_joint() -> None:
    target = tubeopt.forward_kinematics(TWO_TUBE, [0.0, 1.0]).tip_position
    weights = ([1.0, 1.0], [20.0, 20.0])
    assert tubeopt.inverse_kinematics(TWO_TUBE, target, start=([0, 0.5], None), weights=weights).reached


def test_tubes_of_one_segment_have_one_carriage() -> None:
    robot = tubeopt.load_robot("configs/robots/thesis_etr.yaml")
    with pytest.raises(InputError, match="must be equal"):
        joint_space(robot).join(np.zeros(3), np.array([0.0, 0.0, -0.01]))


@pytest.mark.parametrize("gap", [0.0, 2e-3])
def test_spaces_have_the_translations_they_are_made_for(gap: float) -> None:
    tubes = (tubeopt.Tube(1e-3, 0.8e-3, 0.05, 0.1, 12.5), tubeopt.Tube(1.25e-3, 1.05e-3, 0.05 - gap, 0.1, 12.5))
    space = joint_space(tubeopt.ConcentricRobot(tubes), carriage_gap=gap)
    assert space.carriages == ((0, 1),)
    shift = np.array([-0.03, -0.01])
    apart = space.holding(shift)
    q = apart.join(np.zeros(2), shift)
    np.testing.assert_array_equal(apart.split(q)[1], shift)
    assert apart.outside(q) == ""
    assert space.holding(apart.joint(apart.inside())[2:] * 0 + space.joint(space.inside())[2:]) is space


def nearly_equal(eps: float, n: int = 2) -> tubeopt.ConcentricRobot:
    """Tubes of 150 mm, each longer than the next one by `eps` (m)."""
    tubes, diameter = [], 1e-3
    for i in range(n):
        straight = 0.08 - 0.03 * i
        length = 0.15 + (n - 1 - i) * eps
        tubes.append(tubeopt.Tube(diameter, 0.8 * diameter, straight, length - straight, 10.0 - 2 * i))
        diameter *= 1.35
    return tubeopt.ConcentricRobot(tuple(tubes))


@pytest.mark.parametrize("eps", [0.0, 1e-12, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-3])
def test_targets_are_reached_as_soon_by_tubes_of_nearly_equal_length(eps: float) -> None:
    robot = nearly_equal(eps)
    space = joint_space(robot)
    assert (len(space.carriages) == 1) is (eps <= 1e-9)
    few = space.sample(24)
    assert np.ptp(few[:, 2]) > 0.05  # the starts are spread over all insertions, however little the play
    for k in range(4):
        pose = tubeopt.forward_kinematics(robot, *space.split(few[k]))
        solution = tubeopt.inverse_kinematics(robot, pose.tip_position, start=space.split(few[12 + k]), min_margin=0.0)
        assert solution.reached
        assert space.outside(space.join(solution.rotations, solution.translations)) == ""
        assert solution.statistics.solves < 400


@pytest.mark.parametrize("width", [0.0, 1e-12, 1e-9, 1e-6])
@pytest.mark.parametrize("k", [5, 7])
def test_joints_whose_ranges_have_no_width_are_solved_for_with_the_others(width: float, k: int) -> None:
    free = nearly_equal(1e-6, 3)
    space = joint_space(free)
    rotations, shift = space.split(space.sample(8)[k])
    shifts = list(free.limits.translations)
    shifts[1] = shift[1] - width, shift[1] + width
    robot = tubeopt.ConcentricRobot(free.tubes, joint_limits=tubeopt.JointLimits(free.limits.rotations, tuple(shifts)))
    pose = tubeopt.forward_kinematics(robot, rotations, shift)
    solution = tubeopt.inverse_kinematics(robot, pose.tip_position, min_margin=0.0)
    assert solution.reached
    assert abs(solution.translations[1] - shift[1]) <= width + 2e-9


@pytest.mark.parametrize("off", [0.0, -0.0037, 0.0041])
@pytest.mark.parametrize("pieces", [False, True])
def test_tubes_on_one_joint_have_the_derivatives_of_their_motion_together(pieces: bool, off: float) -> None:
    """Their ends always coincide; at `off` 0 a transition lies at the plate too, and the sides differ."""
    inner, outer = TWO_TUBE.tubes
    tubes = (
        dataclasses.replace(inner, straight_length=0.06, curved_length=0.08),
        dataclasses.replace(outer, straight_length=0.09, curved_length=0.05),
    )
    if pieces:
        tubes = (as_pieces(tubes[0]), as_pieces(tubes[1]))
    space = joint_space(dataclasses.replace(TWO_TUBE, tubes=tubes, calibration=None))
    q = np.array([0.5, -1.3, space.middle()[2] + off])
    posture = start_at(space, q)
    assert posture is not None
    for side, report in ((1, posture.jacobian), (-1, posture.backward)):
        for k in range(3):

            def there(step: float, k: int = k) -> Any:
                at = start_at(space, q + step * np.eye(3)[k])
                assert at is not None
                return np.append(at.tip, at.margin)

            values = [there(side * 1e-4 * m) for m in range(5)]
            expected = np.tensordot([-25 / 12, 4.0, -3.0, 4 / 3, -1 / 4], values, 1) / (side * 1e-4)
            result = np.append(report[0][:, k], report[2][k])
            assert np.abs(result - expected).max() < 2e-6 * max(1.0, np.abs(expected).max())
