"""Branches of bundles through folds, and through places where ends of tubes meet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.equilibrium.test_bundle import long_bundle
from tubeopt import BundleRobot, ConcentricRobot, EccentricRobot, find_equilibria, find_snap, load_robot, trace_branch
from tubeopt.equilibrium.kinematics import unsolved
from tubeopt.errors import SolveError


def steep() -> BundleRobot:
    """Three equal tubes that curve tightly enough for jumps where their ends pass each other."""
    thesis = load_robot("thesis_etr")
    assert isinstance(thesis, EccentricRobot)
    slender = replace(thesis.tube, outer_diameter=1.421e-3, inner_diameter=1.162e-3, curvature=13.98)
    return replace(thesis, tube=slender, offset=1.31e-3).bundle()


def test_without_offsets_it_is_the_branch_of_nested_tubes() -> None:
    nested = load_robot("two_tube")
    assert isinstance(nested, ConcentricRobot)
    bundle, turn = BundleRobot(nested.tubes, (0.0,) * 2, (0.0,) * 2), np.radians([360.0, 0.0])
    mine, known = (trace_branch(each, [0.0, 0.0], turn, nested.home_translations) for each in (bundle, nested))
    assert len(known.folds) == 2
    for one, other in zip(mine.folds, known.folds, strict=True):
        assert one.rotations == pytest.approx(other.rotations, abs=1e-8)


def test_without_offsets_all_equilibria_are_those_of_nested_tubes() -> None:
    nested = load_robot("two_tube")
    bundle, turns = BundleRobot(nested.tubes, (0.0,) * 2, (0.0,) * 2), np.radians([190.0, 0.0])
    mine, known = (find_equilibria(each, turns, nested.home_translations) for each in (bundle, nested))
    assert [e.margin for e in mine] == pytest.approx([e.margin for e in known], abs=1e-6)
    assert [e.energy for e in mine] == pytest.approx([e.energy for e in known], rel=1e-9)


@pytest.mark.parametrize(("degrees", "stable"), [((30, 210.25, 30.5), 2), ((30, 210, 30), 2)])
def test_all_equilibria_between_two_folds(degrees: tuple[float, ...], stable: int) -> None:
    found = find_equilibria(long_bundle(), np.radians(degrees))
    assert [e.margin > 0 for e in found] == [True] * stable + [False]


def test_a_ridge_lies_between_two_orders_of_the_ends() -> None:
    lower, upper, ridge = find_equilibria(steep(), np.radians([-131.338, 55.8818, 39.1552]))
    assert lower.margin > 0.05
    assert upper.margin > 0.05
    assert np.isneginf(ridge.margin)
    assert ridge.energy > upper.energy
    assert (lower.tube_end.argsort() != upper.tube_end.argsort()).any()


def test_a_branch_turns_at_its_folds_and_mirrors_itself() -> None:
    robot, start, end = long_bundle(), np.radians([30.0, 205.0, 30.0]), np.radians([30.0, 215.0, 30.0])
    branch, snap = trace_branch(robot, start, end), find_snap(robot, (start, None), (end, None))
    assert snap is not None
    there, back = branch.folds
    assert there.rotations == pytest.approx(snap.rotations, abs=1e-9)
    assert there.rotations[1] + back.rotations[1] == pytest.approx(np.radians(420.0), abs=1e-9)
    assert branch.margin.min() < -1e-3
    beyond = robot.fk(end, start=snap.after)
    assert branch.tip_rotations[-1] == pytest.approx(beyond.tip_rotations, abs=1e-8)


def test_a_branch_crosses_a_ridge_where_ends_meet() -> None:
    """Two stable parts, and between them the order of the ends changes while the arm stands on a ridge."""
    robot = steep()
    start = np.radians([-125.85, 48.13, 19.81])
    end = np.radians([-137.05, 63.95, 59.29])
    branch, snap = trace_branch(robot, start, end), find_snap(robot, (start, None), (end, None))
    assert snap is not None
    there, back = branch.folds
    assert there.rotations == pytest.approx(snap.rotations, abs=1e-7)
    assert there.margin > 0.1
    assert branch.tip_rotations[-1] == pytest.approx(robot.fk(end).tip_rotations, abs=1e-8)
    ridge = np.flatnonzero(np.isneginf(branch.margin))
    assert len(ridge) >= 1
    assert (np.delete(branch.margin, ridge) > 0).all()
    for pose in (there, back):
        member, x = unsolved(pose)
        assert member.residual(member.at(x)) < 1e-9
    # Motion back along the second part holds up to its end, and no farther.
    ends_at = float((back.rotations - start) @ (end - start) / ((end - start) @ (end - start)))
    pose = robot.fk(end)
    for t in (0.9, 0.8, 0.7, 0.65, 0.6, 0.56, 0.53, 0.51, 0.49, 0.48, 0.475, ends_at + 1e-5):
        pose = robot.fk(start + t * (end - start), start=pose)
    assert np.linalg.norm(pose.tip_position - back.tip_position) < 5e-6
    with pytest.raises(SolveError, match="the robot snaps"):
        robot.fk(start + (ends_at - 1e-5) * (end - start), start=pose)
    # The other way the branch is the same, and so are its folds.
    reverse = trace_branch(robot, end, start)
    assert reverse.folds[0].rotations == pytest.approx(back.rotations, abs=1e-6)
    assert reverse.folds[1].rotations == pytest.approx(there.rotations, abs=1e-6)


def test_both_jumps_of_ends_that_pass_are_found() -> None:
    """The smaller one, of 2.6 mm, lies within a step of the branch: where ends pass, steps must be short."""
    robot, start, end = steep(), np.radians([-125.85, 48.13, 19.81]), np.radians([-137.05, 63.95, 59.29])
    there, back = (snap.rotations for snap in trace_branch(robot, start, end).folds)
    for way, fold, jump in (((start, end), there, 4.51e-3), ((end, start), back, 2.63e-3)):
        snap = find_snap(robot, (way[0], None), (way[1], None))
        assert snap is not None
        assert snap.rotations == pytest.approx(fold, abs=1e-6)
        assert snap.tip_jump == pytest.approx(jump, rel=5e-3)


def test_three_ends_at_one_place_are_named() -> None:
    """Three stable orders of ends by symmetry, and between them a kink of the energy in two directions."""
    robot = load_robot("thesis_etr")
    assert isinstance(robot, EccentricRobot)
    with pytest.raises(SolveError, match=r"tubes 1, 2 and 3 end within .* stable in 3 orders"):
        find_equilibria(robot.bundle(), np.radians([0.0, 120.0, -120.0]))
