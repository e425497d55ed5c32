"""Two tubes of equal length, transmission and Poisson's ratio, for which elliptic functions give everything."""

from __future__ import annotations

import numpy as np
import pytest

from tests.examples import DEG, THESIS
from tests.stability.reference import TURN, closed_form
from tests.stability.robots import inner_and_middle, unit_pair
from tubeopt import find_equilibria, find_snap, follow
from tubeopt.stability import trace_branch

FOLDS = (
    # c, transmission, tip and input angle at the fold, deg
    (3.0, 0.0, 139.19242930, 184.38397018),
    (4.0, 0.0, 116.72100858, 197.78561425),
    (1.0, 1.0, 132.57393506, 189.54408069),
    (2.0, 0.5, 114.79735263, 203.90356628),
)


@pytest.mark.parametrize(("c", "lever", "tip", "turn"), FOLDS)
def test_folds_of_two_tubes(c: float, lever: float, tip: float, turn: float) -> None:
    robot = unit_pair(c, lever)
    snap = find_snap(robot, ([0.0, 0.0], None), ([TURN, 0.0], None))
    assert snap is not None
    assert snap.rotations / DEG == pytest.approx([turn, 0.0], abs=1e-6)
    assert snap.fraction * 360 == pytest.approx(turn, abs=1e-6)
    first, second = snap.before.tip_rotations / DEG
    assert first - second == pytest.approx(tip, abs=1e-6)
    assert abs(snap.before.margin) < 1e-8
    assert snap.after.margin > 0
    # Where it lands is the other branch at the same input.
    landed = float(np.subtract(*snap.after.tip_rotations))
    assert closed_form(c, 1.0, lever, np.array(landed)) / DEG == pytest.approx(turn, abs=1e-6)


@pytest.mark.parametrize(("c", "lever", "tip", "turn"), FOLDS)
def test_folds_by_following_and_by_tracing(c: float, lever: float, tip: float, turn: float) -> None:
    robot = unit_pair(c, lever)
    reached = follow(robot, [[0.0, 0.0], [TURN, 0.0]])
    back = follow(robot, [[0.0, 0.0], [0.0, TURN]])
    assert [snap.rotations[0] / DEG for snap in reached.snaps] == pytest.approx([turn], abs=1e-6)
    assert [snap.rotations[1] / DEG for snap in back.snaps] == pytest.approx([turn], abs=1e-6)
    branch = trace_branch(robot, [0.0, 0.0], [TURN, 0.0])
    # The S-curve from 0 to a turn passes the second fold, the mirror image of the first, on its way.
    assert [fold.rotations[0] / DEG for fold in branch.folds] == pytest.approx([turn, 360 - turn], abs=1e-6)
    assert [np.subtract(*fold.tip_rotations) / DEG for fold in branch.folds] == pytest.approx(
        [tip, 360 - tip], abs=1e-6
    )


@pytest.mark.parametrize(("c", "lever"), [(1.0, 0.0), (2.0, 0.5), (4.0, 0.0), (1.0, 1.0), (7.0, 0.3), (0.5, 4.0)])
def test_tip_angles_of_the_closed_form(c: float, lever: float) -> None:
    robot = unit_pair(c, lever)
    unstable = 0
    for tip in np.arange(7.5, 720.0, 52.5) * DEG:
        turn = float(closed_form(c, 1.0, lever, tip))
        equilibria = find_equilibria(robot, [turn + 0.4, 0.4])
        apart = np.array([np.subtract(*equilibrium.tip_rotations) for equilibrium in equilibria])
        current = int(np.argmin(np.abs(apart - tip)))
        assert apart[current] == pytest.approx(tip, abs=1e-9)
        assert closed_form(c, 1.0, lever, apart) == pytest.approx(turn, abs=1e-8)
        # Stable exactly where the input grows with the tip angle.
        rises = np.diff(closed_form(c, 1.0, lever, apart[:, None] + [-1e-5, 1e-5])).ravel() > 0
        unstable += not rises[current]
        for equilibrium, rise in zip(equilibria, rises, strict=True):
            assert ((-1) ** equilibrium.index > 0) == rise
    assert unstable > 0 or c < 2


def test_three_equilibria_of_the_inner_and_middle_tube() -> None:
    equilibria = find_equilibria(inner_and_middle(), [150 * DEG, 0.0])
    apart = [np.subtract(*equilibrium.tip_rotations) / DEG for equilibrium in equilibria]
    assert sorted(apart) == pytest.approx([39.43309191, 208.31500100, 294.34122683], abs=1e-7)
    assert {round(a): e.stable for a, e in zip(apart, equilibria, strict=True)} == {39: True, 208: False, 294: True}
    assert [equilibrium.index for equilibrium in equilibria] == [0, 0, 1]


def test_snap_of_the_thesis_robot() -> None:
    snap = find_snap(THESIS, ([0.0, 0.0, 0.0], None), ([TURN, 0.0, 0.0], None))
    assert snap is not None
    assert snap.rotations / DEG == pytest.approx([214.222427, 0.0, 0.0], abs=1e-5)
    assert snap.before.tip_rotations / DEG == pytest.approx([130.231722, 20.009537, 3.579333], abs=2e-6)
    assert abs(snap.before.margin) < 1e-8
    path = follow(THESIS, [[0.0, 0.0, 0.0], [TURN, 0.0, 0.0]])
    assert [s.rotations[0] / DEG for s in path.snaps] == pytest.approx([214.222427], abs=1e-5)
