"""Home is admissible for every robot and the same for all; which tube is the tip where ends are out of order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tubeopt
from tests.examples import CONFIGS, CRL, THESIS, TWO_TUBE
from tubeopt.inverse.joints import joint_space
from tubeopt.robots.limits import JointLimits
from tubeopt.robots.order import demands, ends_inside, in_order, tip_tube, translation_ranges
from tubeopt.robots.robot import Robot
from tubeopt.runs.robot_keys import joints_of
from tubeopt.show.plots.style import caption
from tubeopt.show.viewer import open_session

ROBOTS = {path.stem: path for path in sorted(CONFIGS.glob("*.yaml"))}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", ROBOTS)
def test_home_keeps_limits_and_order_and_is_one_for_all(name: str) -> None:
    robot = tubeopt.load_robot(ROBOTS[name])
    space, home = joint_space(robot), robot.home_translations
    q = space.join(robot.home_rotations, home)
    assert space.admissible(q)
    np.testing.assert_array_equal(space.middle(), q)
    np.testing.assert_array_equal(joints_of(robot, None, None)[1], home)
    np.testing.assert_array_equal(open_session(robot).equilibrium.translations, home)
    np.testing.assert_array_equal(tubeopt.forward_kinematics(robot, np.zeros(robot.n_tubes)).translations, home)
    zero = np.zeros(robot.n_tubes)
    assert home.any() != space.admissible(space.join(zero, zero))
    # Nearest to 0, from the outermost tube inwards: a little nearer is out of order.
    for tube in np.flatnonzero(home):
        nearer = home.copy()
        nearer[tube] *= 1 - 1e-6
        moved = next(tubes for tubes in robot.moving_together if tube in tubes)
        nearer[list(moved)] = nearer[tube]
        assert space.outside(space.join(zero, nearer))


def test_home_of_the_crl_robot_moves_the_inner_tube_to_the_end_of_the_next() -> None:
    # Curved parts of 41, 100 and 100 mm.
    np.testing.assert_array_equal(CRL.home_translations, [0.059, 0.0, 0.0])


def test_limits_move_home_and_a_robot_that_has_nothing_in_order_has_the_home_of_its_lengths() -> None:
    turns = ((0.5, 1.0), (-1.0, 1.0), (-1.0, -0.5))
    limits = JointLimits(turns, ((-0.2, 0.2), (-0.15, -0.02), (-0.1, 0.1)))
    robot = replace(THESIS, joint_limits=limits)
    np.testing.assert_array_equal(robot.home_rotations, [0.5, 0.0, -0.5])
    # The middle tube ends with the outer one at best: the outer one goes back with it, the inner one may stay.
    np.testing.assert_allclose(robot.home_translations, [0.0, -0.02, 0.0], atol=1e-15)
    assert joint_space(robot).admissible(joint_space(robot).middle())
    none = JointLimits(turns, ((-0.2, -0.19), (-0.15, 0.15), (0.09, 0.1)))
    np.testing.assert_array_equal(replace(THESIS, joint_limits=none).home_translations, np.zeros(3))


@pytest.mark.parametrize(
    ("robot", "translations", "tip", "words"),
    [
        (THESIS, (0.0, 0.0, 0.0), 1, ""),
        (TWO_TUBE, (0.0, 0.0), 1, ""),
        (TWO_TUBE, (-0.02, -0.005), 2, "the end of tube 2; tube 1 ends 15 mm inside tube 2"),
        (CRL, (0.0, 0.0, 0.0), 2, "the end of tube 2; tube 1 ends 59 mm inside tube 2"),
        (CRL, (0.06, -0.01, 0.0), 1, "the end of tube 1; tube 2 ends 10 mm inside tube 3"),
    ],
)
def test_the_tip_is_the_tube_that_ends_farthest(
    robot: Robot, translations: tuple[float, ...], tip: int, words: str
) -> None:
    from tubeopt.show.formatting import tip_number, tip_text

    e = tubeopt.forward_kinematics(robot, np.zeros(robot.n_tubes), translations)
    assert tip_number(e) == tip
    assert tip_text(robot, e.tube_end) == words
    assert ("the tip is the end of tube" in caption(e)) is bool(words)
    # The arm ends where that tube does.
    assert e.tube_end[tip - 1] == pytest.approx(e.arc_length[-1], abs=1e-12)


def test_tubes_that_are_wholly_withdrawn_have_no_tip() -> None:
    assert tip_tube(np.array([-0.01, 0.0])) is None
    assert ends_inside(TWO_TUBE, np.array([-0.01, 0.0])) == ()


def test_carriages_out_of_order_are_a_remark() -> None:
    from tubeopt.show.equilibrium_report import EquilibriumReport
    from tubeopt.show.snap_report import PathReport

    e = tubeopt.forward_kinematics(THESIS, np.zeros(3), (0.0, -0.15, 0.0))
    # Carriages are at -0.2 m and -0.3 m: the inner one is 0.1 m in front of the outer one.
    (text,) = EquilibriumReport(e).record()["remarks"]
    assert text.startswith("the carriage of tube 1 would be in front of the carriage of tube 2, by 100 mm")
    assert "remarks" not in EquilibriumReport(tubeopt.forward_kinematics(THESIS, np.zeros(3))).record()
    with pytest.raises(tubeopt.InputError, match=r"start is out of range: tube 2 would end inside tube 3, by 100 mm"):
        tubeopt.plan_trajectory(THESIS, (np.zeros(3), (0.0, -0.15, 0.0)), (np.zeros(3), None))

    path = tubeopt.follow(THESIS, np.zeros((3, 3)), [(0, 0, 0), (0, -0.15, 0), (-0.2, 0, 0)])
    assert PathReport(path).record()["remarks"] == [
        "the carriage of tube 1 would be in front of the carriage of tube 2, at waypoint 2",
        "the tip is the end of tube 1, and tube 2 ends inside an outer tube, at waypoint 2",
        "the tip is the end of tube 2, and tube 1 ends inside an outer tube, at waypoint 3",
    ]


def test_carriages_of_segments_may_be_one_per_tube() -> None:
    robot = tubeopt.load_robot("example_three_segment_etr")
    assert isinstance(robot, tubeopt.SegmentedEccentricRobot)
    own = replace(robot.bundle(), carriages=None)
    assert own.home_translations == pytest.approx(robot.home_translations, abs=1e-12)
    rng = np.random.default_rng(0)
    low, high = translation_ranges(own.tubes, own.limits)
    for _ in range(20):
        shift = in_order(own, (low, high), demands(own), lambda a, b: rng.uniform(a, max(a, b)))
        assert shift is not None
        assert (shift >= low - 1e-12).all()
        assert (shift <= high + 1e-12).all()
        for each in demands(own):
            assert shift[each.ahead] - shift[each.behind] >= each.distance - 1e-12
    # The outermost tube of one stack, drawn in, leaves no place to those inside of it.
    assert in_order(own, (np.append(low[:-1], 0.1), np.append(high[:-1], 0.1)), demands(own), max) is None
