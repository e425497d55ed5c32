"""Plans and the loss to snapping of robots whose tubes are made of pieces."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from tests.examples import PIECES
from tubeopt import (
    ConcentricRobot,
    Load,
    Piece,
    PlanOptions,
    Tube,
    follow,
    forward_kinematics,
    plan_trajectory,
    verify_trajectory,
)
from tubeopt.bodies.obstacles import Sphere
from tubeopt.equilibrium.result import Equilibrium
from tubeopt.planning.branch import ProvedBranch, branch
from tubeopt.planning.loaded_branch import loaded_branch
from tubeopt.planning.loaded_sections import DeadLoad, LoadedArms, LoadedIntervals
from tubeopt.planning.sections import Constants, Intervals, SolvedArms
from tubeopt.robots.lengthwise import lengthwise, variation
from tubeopt.workspaces import snapping_loss

START, GOAL = (np.zeros(3), np.array([-0.03, -0.02, 0.0])), (np.array([0.4, -0.5, 0.7]), np.array([-0.02, -0.01, 0.0]))


def test_a_way_around_a_ball_is_planned_and_proved() -> None:
    """And is what `follow` finds: no snap, the tip at the goal, the ball never closer than the proof says."""
    ends = [forward_kinematics(PIECES, *at) for at in (START, GOAL)]
    middle = (ends[0].tip_position + ends[1].tip_position) / 2
    ball = Sphere(tuple((middle + np.array([0.0, 0.0, 0.02])).tolist()), 0.004)
    plan = plan_trajectory(PIECES, START, GOAL, obstacles=[ball], options=PlanOptions(objective="none"))
    proof = verify_trajectory(PIECES, plan.time, plan.rotations, plan.translations, obstacles=[ball])
    assert proof.holds
    passed = follow(PIECES, plan.rotations[::-3][::-1], plan.translations[::-3][::-1], start=plan.start)
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
    loss = snapping_loss(PIECES, 1000, size=0.02)
    assert 0.0 <= loss.fraction <= 1.0


def pair_that_varies() -> ConcentricRobot:
    """Precurvature by a table, natural twist, and stiffnesses that change along the tubes."""
    table = Piece.table(np.array([0.0, 0.02, 0.04, 0.06]), [[8, 0, 0], [9, 1, 10], [6, 2, 20], [4, 0, 0]])
    soft = Piece(0.04, 6.0, bending_stiffness=lambda s: 0.012 + 0.1 * s, torsional_stiffness=lambda s: 0.01 - 0.1 * s)
    tubes = (
        Tube.of_pieces(1e-3, 0.7e-3, [table], straight_length=0.06),
        Tube.of_pieces(1.6e-3, 1.2e-3, [soft], straight_length=0.02),
    )
    return ConcentricRobot(tubes)


def test_tubes_that_vary_are_planned_for() -> None:
    """Past a ball that the straight way hits; and no arm by shooting comes closer than the proof says."""
    robot = pair_that_varies()
    shift = np.array([-0.005, -0.002])
    start, goal = (np.zeros(2), shift), (np.array([1.4, 1.2]), shift)
    middle = forward_kinematics(robot, goal[0] / 2, shift)
    ball = Sphere(tuple(middle.tip_position.tolist()), 1e-3)
    table = [start[0], goal[0]], [shift, shift]
    straight = verify_trajectory(robot, [0.0, 1.0], *table, obstacles=[ball])
    assert straight.faults[0].startswith("the arm comes as close as -")
    plan = plan_trajectory(robot, start, goal, obstacles=[ball])
    assert plan.proved
    assert plan.proof.measured_clearance - 2e-5 < plan.proof.least_clearance
    for k in range(0, len(plan.time), 20):
        e = forward_kinematics(robot, plan.rotations[k], plan.translations[k], start=plan.start, verify=True)
        assert e.verification is not None
        assert e.verification.tip_position < 1e-9
        near = np.linalg.norm(e.position - ball.centre, axis=1) - ball.radius
        assert near.min() >= plan.proof.least_clearance


def test_tubes_that_vary_are_planned_for_under_a_load() -> None:
    robot, load = pair_that_varies(), Load(force=(0.0, 2e-3, 0.0))
    start, goal = (np.zeros(2), np.array([-0.012, -0.005])), (np.array([0.1, 0.0]), np.array([-0.01, -0.005]))
    plan = plan_trajectory(robot, start, goal, load=load)
    assert plan.proved
    assert plan.proof.end.load == load


@pytest.mark.parametrize("load", [None, Load(force=(0.0, 5e-3, 0.0))], ids=["free", "loaded"])
@pytest.mark.parametrize("soft", [False, True])
def test_the_bound_knows_that_coefficients_move_along_the_tubes(soft: bool, load: Load | None) -> None:
    """Of a tube that varies over millimetres and is pushed by tenths, what varies is the most of the bound; the true
    way of the arm comes close to it and does not pass it."""
    size = Tube(1e-3, 0.7e-3, 0.1, 0.1, 1.0).bending_stiffness
    wave = Piece(
        0.05,
        lambda s: (8 + 6 * np.cos(s / 1.5e-3), 6 * np.sin(s / 1.5e-3), 30 * np.cos(s / 3e-3)),
        torsional_stiffness=(lambda s: size * (0.6 + 0.3 * np.sin(s / 2e-3))) if soft else None,
    )
    robot = ConcentricRobot(
        (Tube.of_pieces(1e-3, 0.7e-3, [wave], straight_length=0.06), Tube(1.6e-3, 1.2e-3, 0.02, 0.04, 8.0))
    )
    at = np.array([0.3, -0.8]), np.array([-0.03, -0.012])
    for turn, shift in ((0.0, 2e-4), (0.04, 3e-4), (0.06, 0.0)):
        chain = [
            forward_kinematics(robot, at[0] + [fraction * turn, 0.0], at[1] + [fraction * shift, 0.0], load=load)
            for fraction in (0.0, 1.0, 0.25, 0.5, 0.75)
        ]
        arms, intervals, result = between(chain, load)
        assert result.unbroken.all()
        fractions, x, used = (0.25, 0.5, 0.75), np.linspace(0, 1, 9), []
        for k in np.flatnonzero(np.maximum(*intervals.length)[0] > 0):
            ends = intervals.positions(np.zeros(9, dtype=np.intp), np.full(9, k), x)
            for number, fraction in enumerate(fractions):
                cut = (1 - fraction) * intervals.start_cuts[0] + fraction * intervals.end_cuts[0]
                true = arms.points(np.full(9, 2 + number), cut[k] + x * (cut[k + 1] - cut[k]))
                off = np.linalg.norm(true - (1 - fraction) * ends[0] - fraction * ends[1], axis=1).max()
                assert off <= result.chord_error[0, k] + 3 * arms.shape_error.max()
                used.append(off / result.chord_error[0, k])
        assert max(used) > (0.6 if shift else 0.1) / (1 if load is None else 2)


def between(chain: list[Equilibrium], load: Load | None) -> tuple[SolvedArms, Intervals, ProvedBranch]:
    """Of the first two of some equilibria."""
    ends, constants = (np.array([0]), np.array([1])), Constants.of(chain[0].robot)
    margins = np.array([min(e.margin, 1.0) for e in chain])
    if load is None:
        arms = SolvedArms.of(constants, chain)
        intervals = Intervals.of(arms, *ends)
        return arms, intervals, branch(intervals, margins)
    loaded = LoadedArms.of(constants, chain, load=DeadLoad.of(chain[0].robot, load))
    pair = LoadedIntervals.of(loaded, *ends)
    return loaded, pair, loaded_branch(pair, margins)


def test_bounds_of_what_varies_hold() -> None:
    """Against values and differences of the quantities themselves, and closely."""
    robot = pair_that_varies()
    bounds, table, step = variation(robot.tubes), lengthwise(robot.tubes), 1e-6
    for i in range(2):
        for c, (low, high) in enumerate(pairwise(bounds.cuts[i])):
            if low == high:  # by which the tube of fewer cells is filled up
                continue
            s = np.linspace(low + 2 * step, high - 2 * step, 200)
            at = [np.tile((s + k * step)[:, None], 2) for k in (-1, 0, 1)]
            rows = np.array([table.values(position)[:, :, i] for position in at])
            kb, kt, x, y, z = rows[:, :5].transpose(1, 0, 2)
            for true, largest in (
                (kb, np.array([-1, *bounds.bending[1:, i, c + 1]])),
                (1 / kt, np.array([1 / bounds.torsional[i, c + 1], *bounds.compliance[:, i, c + 1]])),
                (kb * (x + 1j * y), bounds.moment[:, i, c + 1]),
                (z, bounds.twist[:, i, c + 1]),
            ):
                size = np.abs(true).max()
                first = np.abs(true[2] - true[0]).max() / (2 * step)
                second = np.abs(true[2] - 2 * true[1] + true[0]).max() / step**2
                assert largest[0] < 0 or size <= largest[0] <= 1.15 * size + 1e-15
                assert first * (1 - 1e-6) <= largest[1] + 1e-9 * size / step
                assert largest[1] <= 2 * first + 1e-9 * size / step
                assert second * (1 - 1e-3) <= largest[2] + 1e-14 * size / step**2
            assert 0.9 * kb.min() <= bounds.bending[0, i, c + 1] <= kb.min()
