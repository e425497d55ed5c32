"""What a proof says of the time between its equilibria, along the arm and around it, against equilibria of its own."""

from __future__ import annotations

import time
from itertools import pairwise

import numpy as np
import pytest

from tests.examples import CONFIGS, DEG, PIECES, THESIS, TWO_TUBE, eccentric_robot
from tubeopt import EccentricRobot, find_snap, forward_kinematics, load_robot, verify_trajectory
from tubeopt.bodies.obstacles import Box, Capsule, HalfSpace, Obstacle, Scene, Sphere, nearest_distance
from tubeopt.equilibrium.arm_surface import ArmSurface
from tubeopt.equilibrium.result import Equilibrium
from tubeopt.inverse.joints import joint_space
from tubeopt.planning import trajectory_trace
from tubeopt.planning.branch import branch
from tubeopt.planning.sections import Constants, Intervals, SolvedArms
from tubeopt.robots.eccentric import SegmentedEccentricRobot
from tubeopt.robots.robot import Robot
from tubeopt.robots.tubes import Tube
from tubeopt.typing import Array

SEGMENTED = SegmentedEccentricRobot(
    (Tube(0.8e-3, 0.6e-3, 0.09, 0.05, 12.0), Tube(1.2e-3, 0.9e-3, 0.02, 0.05, 8.0)), name="segmented"
)
MOVED = np.array([0.35, -0.2, 0.15, 0.1, 0.2, -0.3])

FROM, TO = ([0.0, 0.3, -0.2], [-0.02, -0.02, -0.01]), ([0.5, 0.5, 0.0], [-0.015, -0.013, -0.01])


def between(robot: Robot, one: Equilibrium, other: Equilibrium, share: float) -> Equilibrium:
    alpha = (1 - share) * one.rotations + share * other.rotations
    shift = (1 - share) * one.translations + share * other.translations
    return forward_kinematics(robot, alpha, shift, start=one)


def surface(e: Equilibrium, step: float) -> tuple[Array, Array]:
    """Points of the centreline at most `step` apart, the ends of tubes among them, and the radius there."""
    s = np.linspace(0.0, e.arc_length[-1], int(e.arc_length[-1] / step) + 2)
    s = np.union1d(s, e.tube_end[(e.tube_end > 0) & (e.tube_end < s[-1])])
    arms = SolvedArms.of(Constants.of(e.robot), [e])
    return arms.points(np.zeros(len(s), dtype=np.intp), s), ArmSurface(e).radius(s)


@pytest.mark.parametrize(
    "robot", [THESIS, TWO_TUBE, PIECES, eccentric_robot(0.2), SEGMENTED], ids=lambda r: r.name or "etr"
)
def test_arms_between_two_equilibria_are_where_the_bound_says(robot: Robot) -> None:
    n = robot.n_tubes
    moved = MOVED[:n] / 2 if robot is PIECES else MOVED[:n]
    shift = -0.02 * np.ones(n) if isinstance(robot, SegmentedEccentricRobot) else -0.01 * np.ones(n)
    first = forward_kinematics(robot, np.linspace(0.4, -0.8, n), robot.home_translations + shift)
    last = between(robot, first, forward_kinematics(robot, first.rotations + moved, first.translations + 0.004), 1)
    chain = [between(robot, first, last, fraction) for fraction in np.linspace(0, 1, 17)]
    arms = SolvedArms.of(Constants.of(robot), chain)
    one = np.arange(16)
    intervals = Intervals.of(arms, one, one + 1)
    stiffness = np.array([min(e.margin, 1.0) for e in chain]) * (0.9 if arms.constants.offset.any() else 1.0)
    result = branch(intervals, stiffness)
    assert result.unbroken.all()
    assert result.chord_error.max() < 3e-4
    x = np.linspace(0, 1, 9)
    for k in (0, 7, 15):
        for fraction in (0.25, 0.5):
            e = between(robot, chain[k], chain[k + 1], fraction)
            true = SolvedArms.of(arms.constants, [e])
            for section in np.flatnonzero(np.maximum(*intervals.length)[k] > 0):
                cut = (1 - fraction) * intervals.start_cuts[k] + fraction * intervals.end_cuts[k]
                s = cut[section] + x * (cut[section + 1] - cut[section])
                a, b = intervals.positions(np.full(9, k), np.full(9, section), x)
                off = np.linalg.norm(
                    true.points(np.zeros(9, dtype=np.intp), s) - (1 - fraction) * a - fraction * b, axis=1
                )
                allowed = result.chord_error[k, section] + 2 * arms.shape_error.max() + true.shape_error[0]
                assert off.max() <= allowed
    # Of second order: twice the step, four times the bound.
    coarse = branch(Intervals.of(arms, np.array([6]), np.array([8])), stiffness).chord_error[0, -1]
    assert 3 < coarse / result.chord_error[6:8, -1].mean() < 6


@pytest.mark.parametrize("robot", [THESIS, PIECES], ids=lambda r: r.name)
def test_the_error_of_interpolation_along_the_arm_is_bounded(robot: Robot) -> None:
    e = forward_kinematics(robot, [2.0, 0.5, -1.0])
    arms = SolvedArms.of(Constants.of(robot), [e])
    finer = forward_kinematics(robot, [2.0, 0.5, -1.0], tolerance=1e-12)
    assert len(finer.arc_length) > 1.5 * len(e.arc_length)
    off = arms.points(np.zeros(len(finer.arc_length), dtype=np.intp), finer.arc_length) - finer.position
    assert 1e-9 < np.linalg.norm(off, axis=1).max() <= arms.shape_error[0] < 5e-6


@pytest.fixture(scope="module")
def moving() -> list[Equilibrium]:
    first, last = forward_kinematics(THESIS, *FROM), forward_kinematics(THESIS, *TO)
    return [between(THESIS, first, last, fraction) for fraction in np.linspace(0, 1, 241)]


def body_at(place: Array, radius: float, random: np.random.Generator) -> Obstacle:
    """A tiny sphere, the side of a thin capsule, or the corner of a box with (all but) the given clearance."""
    away = random.normal(size=3)
    away /= np.linalg.norm(away)
    size, gap = 10 ** random.uniform(-6, -4), random.uniform(-1e-4, 4e-4)
    centre = place + (radius + gap + size) * away
    kind = random.integers(3)
    if kind == 0:
        return Sphere(tuple(centre.tolist()), size)
    if kind == 1:
        along = np.cross(away, random.normal(size=3)) * 10 ** random.uniform(-4, -2)
        return Capsule(tuple((centre - along).tolist()), tuple((centre + along).tolist()), size)
    corner, other = place + (radius + gap) * away, place + (radius + gap) * away + np.sign(away) * [0.004, 0.009, 0.002]
    return Box(tuple(np.minimum(corner, other).tolist()), tuple(np.maximum(corner, other).tolist()))


@pytest.mark.parametrize("at_rest", [True, False])
def test_no_body_between_samples_is_closer_than_the_bound(moving: list[Equilibrium], at_rest: bool) -> None:
    random = np.random.default_rng(4)
    arms = moving[:1] if at_rest else moving
    ends = arms[0], arms[-1]
    table = [e.rotations for e in ends][: 2 - at_rest], [e.translations for e in ends][: 2 - at_rest]
    lines = [surface(e, 1e-4) for e in arms]
    points, radius = (np.concatenate(part) for part in zip(*lines, strict=True))
    for _ in range(10):
        k = int(random.integers(len(points)))
        body = body_at(points[k], float(radius[k]), random)
        true = float((body.signed_distance(points) - radius).min())
        desired = max(true - 2e-5, 0.0)
        proof = verify_trajectory(THESIS, [0.0, 1.0][: 2 - at_rest], *table, obstacles=[body], clearance=desired)
        assert proof.least_clearance <= true + 1e-9
        assert proof.holds == (true - 2e-5 >= 0) or 0 <= true < 2e-5
        if true > 0:
            # Points of the centreline 0.1 mm apart, times 1/240 apart: they may miss the least by a few micrometres.
            assert proof.least_clearance >= true - 2e-5


def test_a_cloud_of_4_000_points_is_proved() -> None:
    random = np.random.default_rng(1)
    first, last = forward_kinematics(THESIS, *FROM), forward_kinematics(THESIS, *TO)
    lines = [surface(between(THESIS, first, last, fraction), 2e-4) for fraction in np.linspace(0, 1, 31)]
    points, radius = (np.concatenate(part) for part in zip(*lines, strict=True))
    centres = points[random.integers(len(points), size=16_000)] + random.normal(size=(16_000, 3)) * 0.006
    from scipy.spatial import cKDTree

    far, nearest = cKDTree(points).query(centres)
    chosen = np.flatnonzero(far > 3e-3)[:4_000]
    assert len(chosen) == 4_000
    cloud = [Sphere(tuple(centre), 1e-4) for centre in centres[chosen].tolist()]
    true = float((far[chosen] - radius[nearest[chosen]] - 1e-4).min())
    start_time = time.process_time()
    proof = verify_trajectory(THESIS, [0.0, 1.0], [FROM[0], TO[0]], [FROM[1], TO[1]], obstacles=cloud, clearance=2e-3)
    assert time.process_time() - start_time < 10
    assert proof.holds
    # Radii fall along the arm, so that the nearest point need not be the one with the least clearance.
    assert true - 2.5e-4 <= proof.least_clearance <= true + 1e-6


def test_a_scene_tells_the_least_distance_of_all_its_bodies() -> None:
    random = np.random.default_rng(2)
    bodies: list[Obstacle] = [
        Sphere(tuple(p), r)
        for p, r in zip(random.normal(size=(300, 3)).tolist(), 10 ** random.uniform(-4, 0, 300), strict=True)
    ]
    bodies += [Capsule(tuple(p[:3]), tuple(p[3:]), 0.01) for p in random.normal(size=(50, 6)).tolist()]
    bodies += [
        Box(tuple(p), tuple(q))
        for p, q in zip(*(np.sort(random.normal(size=(2, 40, 3)), axis=0)).tolist(), strict=True)
    ]
    bodies += [HalfSpace((0.0, 0.0, -2.0), (0.0, 0.0, 1.0))]
    points = random.normal(size=(2000, 3)) * 2
    exact = np.min([body.signed_distance(points) for body in bodies], axis=0)
    np.testing.assert_allclose(Scene(tuple(bodies)).nearest(points), exact, atol=1e-12)
    np.testing.assert_allclose(Scene(tuple(bodies)).nearest(points, 0.3), np.minimum(exact, 0.3), atol=1e-12)
    np.testing.assert_allclose(nearest_distance(bodies, points), exact, atol=1e-12)


@pytest.mark.parametrize("samples", [2, 40])
def test_a_snap_is_put_where_it_is(samples: int) -> None:
    snap = find_snap(THESIS, ([0.0, 0.0, 0.0], None), ([270 * DEG, 0.0, 0.0], None))
    assert snap is not None
    table = np.linspace(0, 1, samples)[:, None] * [270 * DEG, 0.0, 0.0]
    proof = verify_trajectory(THESIS, np.linspace(0, 1, samples), table)
    assert proof.snap is not None
    assert proof.snap * 270 == pytest.approx(snap.fraction * 270, abs=1e-6)
    assert proof.least_margin == 0.0
    assert "79.3 %" in proof.faults[0]


def test_the_least_margin_is_that_of_all_times() -> None:
    table = np.array([[0.0, 0.0, 0.0], [190.0, 0.0, 0.0], [160.0, 5.0, 0.0]]) * DEG
    proof = verify_trajectory(THESIS, [0.0, 1.0, 2.0], table)
    assert proof.holds
    dense = [forward_kinematics(THESIS, table[0])]
    for a, b in pairwise(table):
        for fraction in np.linspace(0, 1, 300)[1:]:
            dense.append(forward_kinematics(THESIS, a + fraction * (b - a), start=dense[-1]))
    assert proof.least_margin == pytest.approx(min(e.margin for e in dense), abs=1e-6)


def test_rotations_of_a_robot_without_limits_are_free() -> None:
    proof = verify_trajectory(THESIS, [0.0, 1.0], [[7.0, 7.0, 7.0], [7.5, 7.4, 7.3]])
    assert proof.holds
    limited = verify_trajectory(THESIS, [0.0, 1.0], [[7.0, 7.0, 7.0], [7.5, 7.4, 7.3]], limits=THESIS.limits)
    assert any("leaves its range" in fault for fault in limited.faults)


def test_equilibria_are_as_close_as_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twice as many at half the turn, and the same least margin; with too few nothing is proved."""
    path = [0.0, 1.0], [[0.0, 0.0], [1.0, 0.0]]
    turns = []
    for turn in (0.01, 0.005):
        monkeypatch.setattr(trajectory_trace, "LARGEST_TURN", turn)
        turns.append(verify_trajectory(TWO_TUBE, *path))
    assert turns[0].least_margin == pytest.approx(turns[1].least_margin, abs=1e-9)
    assert [proof.equilibria for proof in turns] == [101, 201]
    monkeypatch.setattr(trajectory_trace, "MAX_EQUILIBRIA", 5)
    assert not verify_trajectory(TWO_TUBE, *path).holds


def test_what_is_not_shown_in_time_is_a_fault() -> None:
    table = np.linspace(0, 3, 200)[:, None] * [1.0, 0.2, 0.1]
    proof = verify_trajectory(THESIS, np.arange(200.0), table, time_limit=1e-6)
    assert any("the time limit was reached" in fault for fault in proof.faults)
    assert proof.open


def test_a_place_beside_a_sharp_edge_is_outside_of_the_mesh() -> None:
    """Also where its nearest place, on the edge, is 0.3 um from a corner of the triangles of the cut surface."""
    pytest.importorskip("trimesh")
    from tubeopt.bodies.corridors import MeshObstacle

    vertices = (
        (-0.02771995870219761, -0.01584811465260669, -0.03460622922090869),
        (-0.02721096353571429, -0.03089150235831294, -0.021436665437081108),
        (-0.04443723082978886, -0.023424461895428576, -0.04261446092761187),
        (-0.04392823566330553, -0.03846784960113482, -0.02944489714378429),
        (-0.043255358536564786, -0.024464395476986197, -0.0438480394733308),
        (-0.04274636337008146, -0.03950778318269245, -0.03067847568950321),
    )
    faces = ((3, 5, 1), (2, 0, 4), (1, 0, 3), (3, 0, 2), (4, 3, 2), (5, 3, 4), (4, 0, 1), (1, 5, 4))
    position = np.array([[-0.03769968883307912, 0.0009783603408262155, -0.011203743255827826]])
    corners, flat = np.array(vertices), np.array(faces)
    normals = np.cross(corners[flat[:, 1]] - corners[flat[:, 0]], corners[flat[:, 2]] - corners[flat[:, 0]])
    side = np.sign(((corners.mean(0) - corners[flat[:, 0]]) * normals).sum(1))
    # The body is convex: a place beyond the plane of a face is outside.
    assert (side * ((position - corners[flat[:, 0]]) * normals).sum(1) < 0).any()
    assert MeshObstacle(vertices, faces).surface.signed_distance(position)[0] == pytest.approx(0.0303998881, abs=1e-9)


def test_what_cannot_be_bounded_is_given_up_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three tubes so curved and so far off their middle that no interval, however short, bounds how they turn."""
    robot = EccentricRobot(Tube(1.9e-3, 1.6e-3, 0.02, 0.12, 60.0))
    monkeypatch.setattr(trajectory_trace, "MAX_HALVINGS", 2)
    proof = verify_trajectory(robot, [0, 1], [[0.5, -0.3, 0.1], [0.54, -0.3, 0.1]])
    assert proof.snap is None
    assert "nothing shows that one stable branch" in proof.faults[0]
    assert proof.equilibria < 50


def test_a_tube_without_a_curved_part_is_followed() -> None:
    robot = load_robot(CONFIGS / "straight_sheath_ctr.yaml")
    space = joint_space(robot)
    rotations, translations = space.split(space.inside())
    proof = verify_trajectory(robot, [0.0, 1.0], [rotations, rotations + 0.2], [translations, translations])
    assert proof.holds
