"""Derivatives of poses in which breakpoints of several tubes coincide and move at once, against poses solved anew."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.examples import CONFIGS
from tubeopt import ConcentricRobot, load_robot
from tubeopt.design import Free
from tubeopt.design.parameters import as_pieces, design_space
from tubeopt.design.state import DesignState, FixedPose, FreePose, Layout
from tubeopt.typing import Array

ROTATIONS = (0.3, 2.9, 0.5)


def _robot(name: str, *, pieces: bool) -> ConcentricRobot:
    robot = load_robot(CONFIGS / f"{name}.yaml")
    return ConcentricRobot(tuple(as_pieces(tube) for tube in robot.tubes)) if pieces else robot


def _towards(f: Callable[[float], Array], step: float) -> Array:
    """The derivative towards steps of this sign, by the polynomial through five values."""
    values = [f(k * step) for k in range(5)]
    return np.asarray(np.tensordot([-25 / 12, 4.0, -3.0, 4 / 3, -1 / 4], values, 1) / step)


def _checked(layout: Layout, x: Array, index: Any, side: int = 1) -> None:
    """Tip, heading and margin of a pose change with every unknown as those of poses solved anew do."""
    state = DesignState(layout, x)

    def there(at: Array) -> Array:
        pose = DesignState(layout, at, dict(state.guesses)).pose(index)
        return np.concatenate([pose.arm.position[-1], pose.arm.frame[-1][:, 2], [pose.margin]])

    pose, chain = state.pose(index), state.chain(index)
    heading = np.cross(pose.derivatives.tip_rotation @ chain, pose.arm.frame[-1][:, 2, None], axis=0)
    report = np.concatenate(
        [pose.derivatives.tip_position @ chain, heading, (pose.derivatives.one_margin @ chain)[None]]
    )
    for k, row in enumerate(np.eye(len(x))):
        expected = _towards(lambda step, row=row: there(x + step * row), side * 1e-4)  # type: ignore[misc]
        scale = max(1e-2, float(np.abs(expected).max()))
        assert np.abs(report[:6, k] - expected[:6]).max() < 1e-6 * scale
        # At a margin of almost 1 the mesh makes the difference of margins worse than the slope.
        assert pose.margin > 0.99 or abs(report[6, k] - expected[6]) < 1e-5 * max(1.0, abs(expected[6]))


@pytest.mark.parametrize("pieces", [False, True])
@pytest.mark.parametrize("share", [0.5, 0.8])
@pytest.mark.parametrize("name", ["two_tube", "thesis_ctr", "example_equal_ends"])
def test_a_pose_drawn_back_has_the_derivatives_of_all_its_tubes_at_once(name: str, share: float, pieces: bool) -> None:
    """The ends of all tubes that are drawn back coincide; added up tube by tube their derivatives were two or three
    times as large."""
    robot = _robot(name, pieces=pieces)
    n = robot.n_tubes
    free = Free("piece_curvature" if pieces else "curvature", tubes=(0,), lower=1.0, upper=40.0)
    layout = Layout(design_space(robot, [free]), (FreePose(0),), (), ())
    shift = np.array([-0.01, -0.013, -0.011])[:n] - [tube.straight_length for tube in robot.tubes]
    _checked(layout, np.concatenate([layout.space.start, ROTATIONS[:n], shift]), (0, share))


def _lengths(name: str, tie: str) -> Layout:
    """The curved lengths of all tubes are one unknown, in a pose in which all ends coincide."""
    robot = _robot(name, pieces=False)
    n = robot.n_tubes
    lower, upper = (0.5, 1.5) if tie == "scaled" else (0.02, 0.3)
    free = Free("curved_length", tubes=tuple(range(n)), lower=lower, upper=upper, tie=tie)
    pose = FixedPose(ROTATIONS[:n], tuple(0.09 - tube.curved_length for tube in robot.tubes))
    return Layout(design_space(robot, [free]), (pose,), (), ())


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("tie", ["equal", "scaled"])
@pytest.mark.parametrize("name", ["two_tube", "example_equal_ends"])
def test_tied_lengths_move_ends_that_coincide_at_once(name: str, tie: str, side: int) -> None:
    layout = _lengths(name, tie)
    _checked(layout, layout.space.start.copy(), 0, side)


def test_ends_that_coincide_and_move_at_different_speeds_have_the_derivative_of_an_unknown_that_grows() -> None:
    """A longer tube grows by more; what lies between the ends is the longer tubes alone."""
    layout = _lengths("thesis_ctr", "scaled")
    _checked(layout, layout.space.start.copy(), 0)
    with pytest.raises(AssertionError):
        _checked(layout, layout.space.start.copy(), 0, side=-1)
