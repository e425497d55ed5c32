"""Concentric robots: what may be put together, the home position, and the limits that follow from the lengths."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given

from tests.examples import CRL, THESIS, TWO_TUBE, robots
from tubeopt import ConcentricRobot, InputError, JointLimits, Tube
from tubeopt.robots.limits import default_limits

INNER = Tube(1e-3, 0.8e-3, 0.1, 0.1, 10.0)
OUTER = Tube(1.3e-3, 1.1e-3, 0.05, 0.1, 5.0)


def test_number_of_tubes_and_home() -> None:
    robot = ConcentricRobot((INNER, OUTER), name="pair")
    assert robot.n_tubes == 2
    assert robot.home_translations.tolist() == [0.0, 0.0]
    # At home every transition from straight to curved lies at the plate.
    assert robot.assembly(robot.home_translations).transition.tolist() == [0.0, 0.0]


def test_any_sequence_of_tubes_is_kept_as_a_tuple() -> None:
    assert ConcentricRobot([INNER, OUTER]) == ConcentricRobot((INNER, OUTER))  # type: ignore[arg-type]
    assert hash(ConcentricRobot([INNER, OUTER])) == hash(ConcentricRobot((INNER, OUTER)))  # type: ignore[arg-type]


def test_tubes_may_fit_exactly_and_be_equally_long() -> None:
    outer = Tube(1.3e-3, 1e-3, 0.05, 0.15, 5.0)
    assert ConcentricRobot((INNER, outer)).n_tubes == 2


@pytest.mark.parametrize(
    ("tubes", "message"),
    [
        ((), "tubes is empty; a robot needs at least one tube"),
        (
            (OUTER, INNER),
            "tube 1 does not fit into tube 2: its outer_diameter is 0.0013 m; "
            "it must be at most the other's inner_diameter, 0.0008 m",
        ),
        (
            (INNER, Tube(1.3e-3, 1.1e-3, 0.1, 0.101, 5.0)),
            "tube 1 is shorter than tube 2 around it: its overall length is 0.2 m; it must be at least 0.201 m",
        ),
        (
            (INNER, OUTER, Tube(1.6e-3, 1.2e-3, 0.05, 0.05, 5.0)),
            "tube 2 does not fit into tube 3: its outer_diameter is 0.0013 m; "
            "it must be at most the other's inner_diameter, 0.0012 m",
        ),
    ],
)
def test_tubes_that_do_not_go_together(tubes: tuple[Tube, ...], message: str) -> None:
    with pytest.raises(InputError) as caught:
        ConcentricRobot(tubes)
    assert str(caught.value) == message


@pytest.mark.parametrize("robot", [THESIS, CRL, TWO_TUBE], ids=lambda robot: robot.name)
def test_default_limits_reach_from_withdrawn_to_advanced(robot: ConcentricRobot) -> None:
    low, high = np.array(robot.limits.translations).T
    withdrawn, advanced = robot.assembly(low), robot.assembly(high)
    assert withdrawn.end == pytest.approx(np.zeros(robot.n_tubes), abs=1e-15)
    assert withdrawn.n_sections == 0
    assert advanced.transmission == pytest.approx(np.zeros(robot.n_tubes), abs=1e-15)
    assert advanced.total_length == pytest.approx(robot.tubes[0].length)
    assert np.array(robot.limits.rotations).tolist() == [[-2 * np.pi, 2 * np.pi]] * robot.n_tubes


def test_limits_of_its_own_are_kept() -> None:
    limits = JointLimits(((-1, 1), (-2, 2)), ((0, 0.01), (-0.02, 0)))
    assert ConcentricRobot((INNER, OUTER), joint_limits=limits).limits is limits
    assert default_limits((INNER,)).translations == ((-0.1, 0.1),)


def test_limits_for_another_number_of_tubes() -> None:
    with pytest.raises(InputError, match=r"^limits are given for 1 tubes; the robot has 2$"):
        ConcentricRobot((INNER, OUTER), joint_limits=JointLimits(((-1, 1),), ((0, 0.01),)))


@pytest.mark.parametrize(
    ("rotations", "translations", "message"),
    [
        (((1, -1),), ((0, 1),), "limit of rotation 1 is 1 rad to -1 rad; it must be least, greatest"),
        (((-1, 1),), ((0, float("nan")),), "limit of translation 1 is 0 m to nan m; it must be least, greatest"),
        (
            ((-1, 1), (-np.inf, 1)),
            ((0, 1),) * 2,
            "limit of rotation 2 is -inf rad to 1 rad; it must be least, greatest",
        ),
        (
            ((-1, 1), (-1, 1)),
            ((0, 1),),
            "limits name 2 rotations and 1 translations; they must be as many as there are tubes",
        ),
    ],
)
def test_impossible_limits(rotations: Any, translations: Any, message: str) -> None:
    with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
        JointLimits(rotations, translations)


@given(robots())
def test_random_robots_nest_and_have_a_home(robot: ConcentricRobot) -> None:
    assembly = robot.assembly(robot.home_translations)
    assert assembly.total_length == pytest.approx(max(tube.curved_length for tube in robot.tubes))
    assert assembly.transmission == pytest.approx([tube.straight_length for tube in robot.tubes])
