"""The share of places that are reached: what is reached is there, what cannot be reached is not."""

from __future__ import annotations

import numpy as np
import pytest

import tubeopt
from tests.command_line import ROOT
from tubeopt import InputError, PlanOptions, RegionReach
from tubeopt.bodies.obstacles import HalfSpace
from tubeopt.planning import evaluate_reach, plan_trajectory
from tubeopt.stability import find_equilibria
from tubeopt.typing import Array

ROBOT = tubeopt.load_robot(ROOT / "configs" / "robots" / "two_tube.yaml")
WITHDRAWN = ([0.0, 0.0], [-0.01, -0.03])


def places(count: int) -> Array:
    """Tips (count, 3) of equilibria by forward kinematics, and a place that is twice as far as the robot is long."""
    random = np.random.default_rng(4)
    home = ROBOT.home_translations
    tips = []
    while len(tips) < count:
        inner = random.uniform(-np.pi, np.pi)
        arm = tubeopt.forward_kinematics(ROBOT, [inner, inner + random.uniform(-1, 1)], home)
        if arm.margin > 0.3:
            tips.append(arm.tip_position)
    return np.array([*tips, [0.0, 0.0, 2 * max(tube.length for tube in ROBOT.tubes)]])


def test_what_is_reached_is_there_and_plans_lead_to_it() -> None:
    targets = places(5)
    start = (np.zeros(2), ROBOT.home_translations)
    result = evaluate_reach(ROBOT, start, targets, count=40)
    assert result.reached[:-1].all()
    assert not result.reached[-1]
    assert result.fraction == pytest.approx(5 / 6)
    assert result.miss[-1] > 0.5 * targets[-1, 2]
    for k in np.flatnonzero(result.reached):
        arms = find_equilibria(ROBOT, result.rotations[k], result.translations[k])
        gaps = [np.linalg.norm(arm.tip_position - targets[k]) for arm in arms]
        assert min(gaps) == pytest.approx(result.miss[k], abs=1e-6)
    k = int(result.miss.argmin())
    joints = (result.rotations[k], result.translations[k])
    assert plan_trajectory(ROBOT, start, joints, options=PlanOptions(objective="none")).proved


def test_a_wall_takes_away_what_is_behind_it() -> None:
    start = (np.zeros(2), ROBOT.home_translations)
    tip = tubeopt.forward_kinematics(ROBOT, *start).tip_position
    targets = np.array([tip, tip * [-1.0, -1.0, 1.0]])  # all tubes turned by half a turn
    assert evaluate_reach(ROBOT, start, targets, count=20).fraction == 1.0
    away = tip * [1.0, 1.0, 0.0]
    wall = HalfSpace(tuple((-0.2 * away).tolist()), tuple(away.tolist()))
    assert evaluate_reach(ROBOT, start, targets, obstacles=[wall], count=20).reached.tolist() == [True, False]


@pytest.mark.parametrize(
    ("targets", "message"),
    [
        ([[0.0, 1.0]], r"targets has shape \(1, 2\); it must be rows of finite x, y, z in m, at least one"),
        (np.zeros((0, 3)), "at least one"),
        ([["a", "b", "c"]], "targets is not a table of numbers"),
    ],
)
def test_what_is_no_table_of_places_is_refused(targets: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        evaluate_reach(ROBOT, WITHDRAWN, targets)  # type: ignore[arg-type]


def test_time_ends_the_search() -> None:
    result = evaluate_reach(
        ROBOT, (np.zeros(2), ROBOT.home_translations), places(1), options=PlanOptions(time_limit=1e-6)
    )
    assert result.examined == 0
    assert np.isfinite(result.miss).all()


@pytest.mark.parametrize("name", ["shift", "tilt"])
def test_a_plate_is_moved_by_no_less_than_nothing(name: str) -> None:
    region = RegionReach(WITHDRAWN, [[0.0, 0.0, 0.1]], **{name: 0.0})  # type: ignore[arg-type]
    assert region.ranges.shape == (0, 2)
    with pytest.raises(InputError, match=f"{name} of the plate is -0.01; it must be at least 0"):
        RegionReach(WITHDRAWN, [[0.0, 0.0, 0.1]], **{name: -0.01})  # type: ignore[arg-type]
