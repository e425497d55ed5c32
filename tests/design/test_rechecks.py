"""What is computed again of a design, at either side of its limits."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.examples import nested
from tubeopt import ConcentricRobot, Piece, Tube, forward_kinematics
from tubeopt.block.quantities import Quantity
from tubeopt.bodies.obstacles import HalfSpace
from tubeopt.design import rechecks
from tubeopt.design.requirements import Length, Nesting, Strain, Stroke, Wall

ROBOT = nested((0.01, 0.05, 3.0), (0.01, 0.04, 5.0))


def arms(*translations: list[float]) -> Any:
    return tuple(SimpleNamespace(translations=np.array(each)) for each in translations)


@pytest.mark.parametrize(
    ("make", "limit", "sign"),
    [
        (lambda limit: Length("curved_length", 0, limit), 0.05, 1),
        (lambda limit: Length("curved_length", 1, limit, least=True), 0.04, -1),
        (lambda limit: Wall(limit), 1e-4, -1),
        (lambda limit: Nesting(limit), 1e-4, -1),
        (lambda limit: Stroke(limit), 0.03, 1),
        (lambda limit: Strain((limit,), in_poses=False), max(tube.straightened_strain for tube in ROBOT.tubes), 1),
    ],
    ids=["length", "least length", "wall", "nesting", "stroke", "strain"],
)
def test_a_promise_about_tubes_is_kept_up_to_its_limit(make: Any, limit: float, sign: int) -> None:
    """The carriages travel 30 mm and 10 mm."""
    moved = arms([0.0, 0.0], [-0.03, -0.01])
    for beyond, kept in ((2e-5, True), (-2e-5, False)):
        assert rechecks.check_tubes(make(limit * (1 + sign * beyond)), ROBOT, moved)[0].kept == kept


def test_the_room_of_an_arm_is_that_of_its_closest_place_less_the_tube_that_is_there() -> None:
    wall, radius = HalfSpace((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)), [tube.outer_diameter / 2 for tube in ROBOT.tubes]
    for heights, room in (([1e-3, 9e-3, 3e-3], 3e-3 - radius[0]), ([1e-3, 3e-3, 3.1e-3], 3e-3 - radius[1])):
        arm: Any = SimpleNamespace(
            tube_end=np.array([0.05, 0.02]),
            arc_length=np.array([0.0, 0.02, 0.03]),
            position=np.array([[0.0, 0.0, height] for height in heights]),
        )
        assert rechecks.least_room(wall, ROBOT, arm) == pytest.approx(room, rel=1e-12)


def test_the_strain_of_several_poses_is_the_largest_of_each() -> None:
    one = Strain((0.01,), straightened=False)
    poses = [forward_kinematics(ROBOT, angles) for angles in ([np.pi, 0.0], [0.0, 0.0])]
    each = [rechecks.largest_strain(one, ROBOT, (pose,)) for pose in poses]
    assert each[0].max() > 1.5 * each[1].max()
    assert rechecks.largest_strain(one, ROBOT, tuple(poses)) == pytest.approx(np.max(each, axis=0), rel=1e-12)


def test_an_own_requirement_is_kept_to_a_millionth_of_its_step(monkeypatch: pytest.MonkeyPatch) -> None:
    one: Any = SimpleNamespace(expression=None, words="own", most=False, limit=1.0, factor=1.0, unit="", size=2.0)
    for left, kept in ((-1.9e-6, True), (-2.1e-6, False)):
        monkeypatch.setattr(rechecks, "recorded", lambda *_, left=left: lambda look: np.array([0.5, left]))
        assert rechecks.check_own(one, ROBOT, ()).kept == kept


def test_a_stroke_force_is_that_at_which_the_arm_buckles(monkeypatch: pytest.MonkeyPatch) -> None:
    arm: Any = SimpleNamespace(rotations=None, translations=None)
    for found, force in ((SimpleNamespace(factor=0.3), 0.3), (None, rechecks.STRONGEST)):
        monkeypatch.setattr(rechecks, "find_stroke_force", lambda *_, found=found, **__: found)
        assert rechecks.numbers_of(ROBOT, [arm])(Quantity("stroke_force", 0)).tolist() == [force]


@pytest.mark.parametrize("rising", [True, False])
def test_the_strain_counts_the_arm_on_both_sides_of_a_breakpoint(rising: bool) -> None:
    """The precurvature of the outer tube rises to 20/m where it ends, or begins with 20/m and falls.

    The straight inner tube is bent most on one side of that breakpoint. In one plane it has k2 20 / (k1 + k2) there.
    """
    law = (lambda s: 20.0 * s / 0.04) if rising else (lambda s: 20.0 * (1 - s / 0.04))
    outer = Tube.of_pieces(1.3e-3, 1.1e-3, [Piece(0.02, 0.0), Piece(0.04, law)], straight_length=0.01)
    inner = Tube(1.0e-3, 0.8e-3, 0.01, 0.08, 0.0)
    robot = ConcentricRobot((inner, outer))
    one, (k1, k2) = Strain((0.01,), straightened=False), (tube.bending_stiffness for tube in robot.tubes)
    arm = forward_kinematics(robot, [0.0, 0.0])
    exact = inner.outer_diameter / 2 * 20.0 * k2 / (k1 + k2)
    assert rechecks.largest_strain(one, robot, (arm,))[0] == pytest.approx(exact, rel=1e-6)
