"""Plans and the loss to snapping of robots whose tubes are chains of arcs and helices."""

from __future__ import annotations

import numpy as np
import pytest

from tests.examples import PIECES
from tubeopt import (
    ConcentricRobot,
    InputError,
    Piece,
    Tube,
    follow,
    forward_kinematics,
    in_steps,
    plan_trajectory,
    verify_trajectory,
)
from tubeopt.bodies.obstacles import Sphere
from tubeopt.workspaces import snapping_loss

START, GOAL = (np.zeros(3), np.array([-0.03, -0.02, 0.0])), (np.array([0.4, -0.5, 0.7]), np.array([-0.02, -0.01, 0.0]))


def test_a_way_around_a_ball_is_planned_and_proved() -> None:
    """And is what `follow` finds: no snap, the tip at the goal, the ball never closer than the proof says."""
    ends = [forward_kinematics(PIECES, *at) for at in (START, GOAL)]
    middle = (ends[0].tip_position + ends[1].tip_position) / 2
    ball = Sphere(tuple((middle + np.array([0.0, 0.0, 0.02])).tolist()), 0.004)
    found = plan_trajectory(PIECES, START, GOAL, obstacles=[ball])
    proof = verify_trajectory(PIECES, found.time, found.rotations, found.translations, obstacles=[ball])
    assert proof.holds
    passed = follow(PIECES, found.rotations, found.translations)
    assert not passed.snaps
    assert np.linalg.norm(passed.equilibria[-1].tip_position - ends[1].tip_position) < 1e-9
    apart = [ball.signed_distance(e.position).min() for e in passed.equilibria]
    assert proof.least_clearance <= min(apart)


def test_a_snap_on_the_way_is_told() -> None:
    bent = forward_kinematics(PIECES, [0.0, 0.0, 0.0])
    turn = np.array([2.5, 0.0, -2.5])
    proof = verify_trajectory(PIECES, [0.0, 1.0], [np.zeros(3), turn], [np.zeros(3)] * 2, start=bent)
    passed = follow(PIECES, [np.zeros(3), turn], [np.zeros(3)] * 2)
    assert (proof.snap is not None) == bool(passed.snaps)


def test_what_snapping_takes_from_the_workspace_is_told() -> None:
    loss = snapping_loss(PIECES, 2000, size=0.02)
    assert 0.0 <= loss.fraction <= 1.0


def test_tubes_that_vary_are_planned_for_in_steps() -> None:
    """Half as long steps bring the tip about four times as near or more, and what is found is proved for these."""
    table = Piece.table(np.array([0.0, 0.02, 0.04, 0.06]), [[8, 0, 0], [9, 1, 10], [6, 2, 20], [4, 0, 0]])
    soft = Piece(0.04, 6.0, bending_stiffness=lambda s: 0.012 + 0.1 * s, torsional_stiffness=lambda s: 0.01 - 0.1 * s)
    tubes = (
        Tube.of_pieces(1e-3, 0.7e-3, [table], straight_length=0.06),
        Tube.of_pieces(1.6e-3, 1.2e-3, [soft], straight_length=0.02),
    )
    robot = ConcentricRobot(tubes)
    start, goal = (np.zeros(2), np.array([-0.02, -0.005])), (np.array([1.0, -0.5]), np.array([-0.005, -0.002]))
    with pytest.raises(InputError, match=r"varies along its length; planning takes .* `in_steps`"):
        plan_trajectory(robot, start, goal)
    tips = [forward_kinematics(in_steps(robot, h), *goal).tip_position for h in (5e-3, 2.5e-3)]
    true = forward_kinematics(robot, *goal).tip_position
    far = [float(np.linalg.norm(tip - true)) for tip in tips]
    assert far[1] < far[0] / 3.5
    assert far[0] < 6e-6
    rough = in_steps(robot, 1e-2)
    assert [len(tube.pieces) for tube in rough.tubes] == [6, 4]
    plan = plan_trajectory(rough, start, goal)
    assert plan.proved
    assert in_steps(rough, 1e-3) == rough
