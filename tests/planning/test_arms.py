"""Several arms: bounds of their distance held against dense sampling by other code, and plans that pass each other."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

import tubeopt
from tubeopt import InputError, PlacedRobot, PlanOptions, SolveError, plan_arms, verify_arms
from tubeopt.bodies.anatomy import bodies_in_frame
from tubeopt.bodies.corridors import Corridor, MeshObstacle
from tubeopt.bodies.distance_field import DistanceField
from tubeopt.bodies.frames import Frame, base_frame, roll_of
from tubeopt.bodies.obstacles import Box, Capsule, HalfSpace, Obstacle, Sphere
from tubeopt.equilibrium.result import Equilibrium
from tubeopt.planning import arms_plan
from tubeopt.planning.arms import ACCURACY, at_rest
from tubeopt.planning.goals import goal_seen
from tubeopt.typing import Array

ROBOT = tubeopt.load_robot(Path(__file__).parents[2] / "configs" / "robots" / "crl_ctr.yaml")
REST = (np.zeros(3), np.array([-0.02, -0.08, -0.09]))
PLATE = base_frame([0.01, -0.02, 0.005], [0.3, -0.2, 1.0], 0.4)


class Motion:
    """A straight motion between joint values (6,)."""

    def __init__(self, begin: Array, end: Array, time: tuple[float, float]) -> None:
        self.time = np.linspace(*time, 11)
        table = begin + np.linspace(0, 1, 11)[:, None] * (end - begin)
        self.rotations, self.translations = table[:, :3], table[:, 3:]

    def joints(self, t: float) -> tuple[Array, Array]:
        table = np.concatenate([self.rotations, self.translations], axis=1)
        q = np.array([np.interp(t, self.time, column) for column in table.T])
        return q[:3], q[3:]


def surface_points(arm: Equilibrium, base: Frame, count: int = 160) -> tuple[Array, Array]:
    """Centreline through the points of the solution with their tangents, and the radius of the outermost tube."""
    s = np.linspace(0, arm.arc_length[-1], count)
    at, first = np.unique(arm.arc_length, return_index=True)
    fine = CubicHermiteSpline(at, arm.position[first], arm.frame[first, :, 2])(s)
    radius = np.zeros(count)
    for tube, end in zip(arm.robot.tubes, arm.tube_end, strict=True):
        radius = np.maximum(radius, np.where(s <= end + 1e-12, tube.outer_diameter / 2, 0.0))
    return base.placed(fine), radius


def gap(one: tuple[Array, Array], other: tuple[Array, Array]) -> float:
    away = np.linalg.norm(one[0][:, None] - other[0], axis=2)
    return float((away - one[1][:, None] - other[1]).min())


def sampled(arms: list[PlacedRobot], motions: list[Motion], count: int) -> float:
    """Least distance of two arms at instants, all points of one from all of the other."""
    end = max(motion.time[-1] for motion in motions)
    smallest, near = math.inf, [None, None]
    for t in np.linspace(0, end, count):
        shapes = []
        for k, (arm, motion) in enumerate(zip(arms, motions, strict=True)):
            near[k] = tubeopt.forward_kinematics(arm.robot, *motion.joints(float(t)), start=near[k])
            shapes.append(surface_points(near[k], arm.base))
        smallest = min(smallest, gap(*shapes))
    return smallest


@pytest.mark.parametrize("seed", range(4))
def test_the_bound_of_moving_arms_is_below_what_is_sampled_and_close_to_it(seed: int) -> None:
    random = np.random.default_rng(seed)
    arms, motions = [], []
    for k in range(2):
        position = base_frame([0.02 * k, 0.0, 0.0], [0.25 * (1 - 2 * k), 0.05, 1.0])
        arms.append(PlacedRobot(ROBOT, position))
        angle = random.uniform(-np.pi, np.pi, (2, 1)) + random.uniform(-0.3, 0.3, (2, 3))
        shift = np.array([[-0.03, -0.08, -0.09], [0.03, -0.045, -0.085]])
        ends = np.concatenate([angle, shift], axis=1)
        motions.append(Motion(ends[0], ends[1], (0.0, 4.0) if k == 0 else (1.0, 5.0)))
    proof = verify_arms(arms, motions, min_margin=0.01)
    (pair,) = proof.pairs
    dense = sampled(arms, motions, 90)
    assert pair.least_clearance <= dense
    assert pair.measured_clearance - pair.least_clearance <= 1.05 * max(ACCURACY, -0.05 * pair.measured_clearance)
    assert dense - pair.measured_clearance < 4e-4  # samples are 50 ms and half a millimetre apart
    assert proof.holds == (pair.least_clearance >= 0 and all(each.holds for each in proof.proofs))
    if pair.measured_clearance < 0:
        assert "arm 1 (CRL CTR) and arm 2 (CRL CTR) come as close as" in proof.faults[-1]


def moments(plan: arms_plan.ArmsPlan, arms: list[PlacedRobot], count: int) -> Iterator[list[tuple[Array, Array]]]:
    """`surface_points` of all arms at instants of a plan, solved from its joint values alone."""
    near: list[Any] = [None] * len(arms)
    for t in np.linspace(0, plan.duration, count):
        for k, moved in enumerate(plan.trajectories):
            table = np.concatenate([moved.rotations, moved.translations], axis=1)
            q = np.array([np.interp(t, moved.time, column) for column in table.T])
            near[k] = tubeopt.forward_kinematics(ROBOT, q[:3], q[3:], start=near[k])
        yield [surface_points(each, arm.base) for each, arm in zip(near, arms, strict=True)]


def test_two_arms_cross_over_without_touching() -> None:
    """Either tip goes to the other's side: one after the other there is room, and by the proof even at once."""
    arms = [PlacedRobot(ROBOT, base_frame([x, 0, 0], [-8 * x, 0, 1])) for x in (-0.008, 0.008)]
    shift = [0.012, -0.05, -0.085]
    goals = [(np.radians([60, 50, 75]), shift), (np.radians([-120, -130, -105]), shift)]
    ball = Sphere((0.0, 0.03, 0.03), 0.004)
    options = PlanOptions(clearance=5e-4, smoothing_intervals=8)
    plan = plan_arms(arms, [REST] * 2, goals, obstacles=[ball], options=options)
    assert plan.proved
    assert plan.status == "proved"
    assert plan.proof.least_clearance >= 5e-4
    assert plan.duration < 0.9 * sum(float(t.time[-1] - t.time[0]) for t in plan.trajectories)
    tips = [arm.base.placed(t.tip_position[[0, -1]]) for arm, t in zip(arms, plan.trajectories, strict=True)]
    assert all(tip[0, 0] * tip[1, 0] < 0 for tip in tips)
    # Once more by other code: what was planned, at instants, from the joint values alone.
    smallest = math.inf
    for shapes in moments(plan, arms, 40):
        for points, radius in shapes:
            assert (np.linalg.norm(points - ball.centre, axis=1) - 0.004 - radius).min() >= 5e-4
        smallest = min(smallest, gap(*shapes))
    assert smallest >= plan.proof.least_clearance
    assert plan.clearance(np.linspace(0, plan.duration, 5)).shape == (5, 1)
    assert plan.clearance([0.0])[0, 0] > smallest - 1e-4


def test_arms_whose_tips_change_places_make_way_for_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where either tip is to go, the other is: one arm withdraws, and comes back when that place is free."""
    arms = [PlacedRobot(ROBOT, base_frame([x, 0, 0], [0, 0, 1])) for x in (-0.008, 0.008)]
    first = tubeopt.forward_kinematics(ROBOT, [1.994, -1.2828, 0.0], [0.0126, -0.083, -0.1])
    # The second is the first, half a turn about the middle between both.
    starts = [(first.rotations + turned, first.translations) for turned in (0.0, np.pi)]
    positions = arms[0].base.placed(first.tip_position) * [[1, 1, 1], [-1, -1, 1]]
    options = PlanOptions(clearance=5e-4, objective="none")
    plan = plan_arms(arms, starts, list(positions[::-1]), options=options)
    assert plan.proved
    assert plan.withdrawn_first == plan.order[1:] == (1,)
    assert plan.proof.least_clearance >= 5e-4
    tips = [arm.base.placed(t.tip_position[[0, -1]]) for arm, t in zip(arms, plan.trajectories, strict=True)]
    np.testing.assert_allclose(tips, [positions, positions[::-1]], atol=1e-8)
    came = plan.trajectories[1]
    assert came.proved
    assert came.proof is plan.proof.proofs[1]
    assert (np.diff(came.time) > 0).all()
    assert came.translations.min(0)[0] < first.translations[0] - 0.02
    # Once more by other code, from the joint values alone.
    smallest = min(gap(*shapes) for shapes in moments(plan, arms, 60))
    assert smallest >= plan.proof.least_clearance
    # Without making way there is no order in which it can be done.
    monkeypatch.setattr(arms_plan, "_retracted", lambda arm, at, options: (at.rotations, at.translations))
    with pytest.raises(SolveError, match=r"arm 1 .*: no plan exists: with its tip at the goal"):
        plan_arms(arms, starts, list(positions[::-1]), options=options)


def test_an_arm_at_rest_lies_within_its_capsules() -> None:
    arm = tubeopt.forward_kinematics(ROBOT, [0.4, 1.0, -0.5], [0.02, -0.04, -0.08])
    bodies = at_rest(arm, PLATE, arms_plan.REST_CHORD)
    points, radius = surface_points(arm, PLATE, 500)
    deep = np.min([body.signed_distance(points) for body in bodies], axis=0)
    assert (deep <= -radius + 1e-9).all()


def bodies() -> list[Obstacle]:
    corners = ((0.0, 0.0, 0.0), (0.01, 0.0, 0.0), (0.0, 0.02, 0.0), (0.0, 0.0, 0.015))
    table = np.random.default_rng(0).random((4, 5, 6)) * 1e-2
    return [
        Sphere((0.01, 0.0, 0.02), 0.003),
        Capsule((0.0, 0.0, 0.0), (0.0, 0.01, 0.02), 0.002),
        HalfSpace((0.0, 0.0, 0.01), (0.0, 1.0, 1.0)),
        Box((0.0, 0.0, 0.0), (0.01, 0.02, 0.005)),
        Corridor(((0.0, 0.0, -0.01), (0.0, 0.01, 0.03)), (0.004, 0.006)),
        MeshObstacle(corners, ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3))),
        DistanceField(table, np.full(3, 2e-3), Frame(origin=np.full(3, -2e-3))),
    ]


@pytest.mark.parametrize("body", bodies(), ids=lambda body: type(body).__name__)
def test_bodies_are_where_they_were_for_whoever_looks(body: Obstacle, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tubeopt.bodies.corridors.CELLS", 6)  # the table of a mesh tells what is far
    points = np.random.default_rng(1).uniform(-5e-3, 8e-3, (40, 3))
    (observed,) = bodies_in_frame(PLATE, [body])
    for k in range(40):  # one by one: a mesh bounds what is not the nearest of a call
        report = observed.signed_distance(PLATE.seen(points[k]))
        assert report == pytest.approx(body.signed_distance(points[k]), abs=1e-9)
    assert observed.gradient(PLATE.seen(points)) == pytest.approx(body.gradient(points) @ PLATE.axes, abs=1e-6)
    if not isinstance(body, (MeshObstacle, DistanceField)):
        x, y, z = PLATE.seen(points).T
        assert observed.distance(x, y, z) == pytest.approx(body.distance(*points.T), abs=1e-6)


def test_what_makes_no_question_is_refused() -> None:
    arm = PlacedRobot(ROBOT)
    with pytest.raises(InputError, match="arms has 1; several robots are at least 2"):
        plan_arms([arm], [REST], [REST])
    with pytest.raises(InputError, match="goals has 1 for 2 arms; it must have one for each"):
        plan_arms([arm] * 2, [REST] * 2, [REST])
    with pytest.raises(InputError, match="roadmap and max_force are given; they are supported for plans of one robot"):
        plan_arms([arm] * 2, [REST] * 2, [REST] * 2, options=PlanOptions(max_force=0.01))
    with pytest.raises(SolveError, match=r"arm 1 \(CRL CTR\) and arm 2 \(CRL CTR\) at the start is -1.5 mm"):
        plan_arms([arm] * 2, [REST] * 2, [REST] * 2)


def test_withdrawn_arms_need_room_at_their_plates() -> None:
    """All tubes end at the plate: nothing stands out, but 1.5 mm of tube fill each of two holes 0.2 mm apart."""
    arms = [PlacedRobot(ROBOT, Frame(origin=np.array([x, 0.0, 0.0]))) for x in (0.0, 0.2e-3)]
    flush = np.array([-0.041, -0.1, -0.1])
    rest = SimpleNamespace(time=np.zeros(1), rotations=np.zeros((1, 3)), translations=flush[None])
    proof = verify_arms(arms, [rest, rest])
    assert not proof.holds
    assert proof.least_clearance == pytest.approx(0.2e-3 - 1.5e-3, abs=1e-9)


@pytest.mark.parametrize("kind", [list, tuple, np.array])
def test_a_goal_of_the_tip_is_in_the_frame_that_arms_share(kind: Any) -> None:
    arm = PlacedRobot(ROBOT, base_frame([0.01, 0.02, 0], [0.1, 0, 1]))
    position = np.array([0.004, -0.01, 0.05])
    assert goal_seen(kind(position.tolist()), arm.base).position == pytest.approx(arm.base.seen(position))
    joints = [[0, 0, 0], [-0.02, -0.05, -0.06]]
    assert goal_seen(joints, arm.base) is joints


def test_orders_begin_with_every_arm() -> None:
    for n in (2, 3, 4, 7):
        orders = arms_plan._orders(n)
        assert {order[0] for order in orders} == set(range(n))
        assert all(sorted(order) == list(range(n)) for order in orders)


@pytest.mark.parametrize("direction", [[0, 0, 1], [0.3, -0.2, 1], [1, 0, 0]])
def test_a_base_tells_its_roll(direction: list[float]) -> None:
    assert roll_of(base_frame([1, 2, 3], direction, -2.0)) == pytest.approx(-2.0)


def test_a_base_is_a_right_handed_frame() -> None:
    for axes in (2 * np.eye(3), np.diag([1.0, 1.0, -1.0]), np.ones(3)):
        with pytest.raises(InputError, match="axes of the base are no right-handed frame"):
            PlacedRobot(ROBOT, Frame(axes, np.zeros(3)))
