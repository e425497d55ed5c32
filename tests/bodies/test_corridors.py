"""Corridors whose radius varies: their distance against the balls they are made of, in numbers and in symbols."""

from __future__ import annotations

from itertools import pairwise

import casadi as ca
import numpy as np
import pytest

import tubeopt
from tests.command_line import ROOT
from tubeopt import InputError, PlanOptions
from tubeopt.bodies.centreline import centreline
from tubeopt.bodies.corridors import Corridor
from tubeopt.bodies.images import field_of_image
from tubeopt.bodies.obstacles import RoundCone
from tubeopt.bodies.phantoms import LUMEN, TARGET, bronchial_tree
from tubeopt.planning import plan_trajectory
from tubeopt.typing import Array

LINE = ((0.0, 0.0, -0.01), (0.0, 0.002, 0.03), (0.01, 0.0, 0.05), (0.03, -0.01, 0.06), (0.031, -0.01, 0.06))
RADII = (8e-3, 6e-3, 6e-3, 3e-3, 6e-3)
"""The last ball holds the one before it."""

VESSEL = Corridor(LINE, RADII)


def samples(count: int) -> Array:
    """Points (count, 3) inside and around the vessel."""
    return np.random.default_rng(3).uniform([-0.02, -0.02, -0.03], [0.05, 0.02, 0.08], (count, 3))


def by_balls(points: Array) -> Array:
    """How deep points lie in the deepest of very many balls, m; around the deepest of some it is looked again."""
    best = np.full(len(points), -np.inf)
    for (a, b), (p, q) in zip(pairwise(np.array(LINE)), pairwise(RADII), strict=True):
        low, high = np.zeros(len(points)), np.ones(len(points))
        for _ in range(5):
            t = np.linspace(low, high, 41)
            depth = p + t * (q - p) - np.linalg.norm(points - a - t[..., None] * (b - a), axis=2)
            k = depth.argmax(0)
            low, high = (np.take_along_axis(t, np.clip(k + side, 0, 40)[None], 0)[0] for side in (-1, 1))
        best = np.maximum(best, depth.max(0))
    return best


def test_the_distance_is_that_of_the_balls() -> None:
    points = samples(2000)
    assert VESSEL.signed_distance(points) == pytest.approx(by_balls(points), abs=1e-12)


def test_the_smooth_distance_and_the_gradient_are_those_of_the_distance() -> None:
    points = samples(300)
    x = ca.MX.sym("x", 3)
    smooth = ca.Function("distance", [x], [VESSEL.distance(x[0], x[1], x[2])])
    assert smooth(points.T).full().ravel() == pytest.approx(VESSEL.signed_distance(points), abs=1e-6)
    h = 1e-7
    moved = points[:, None] + h * np.vstack([np.eye(3), -np.eye(3)])
    sides = VESSEL.signed_distance(moved)
    slope = (sides[:, :3] - sides[:, 3:]) / (2 * h)
    smoothly = np.abs(np.linalg.norm(slope, axis=1) - 1) < 1e-5  # not across a kink
    assert smoothly.mean() > 0.95
    assert VESSEL.gradient(points)[smoothly] == pytest.approx(slope[smoothly], abs=1e-4)


def test_a_distance_changes_by_no_more_than_its_point_moves() -> None:
    random = np.random.default_rng(5)
    points = samples(20_000)
    moved = points + random.normal(0, 2e-3, points.shape)
    change = np.abs(VESSEL.signed_distance(moved) - VESSEL.signed_distance(points))
    assert (change <= np.linalg.norm(moved - points, axis=1) + 1e-12).all()


def test_balls_cover_a_cone() -> None:
    cone = RoundCone((0, 0, 0), (0, 0, 0.05), 1e-3, 4e-3)
    centre, radius = cone.balls()
    points = samples(5000)
    near = (np.linalg.norm(points[:, None] - centre, axis=2) - radius).min(1)
    assert (near <= cone.signed_distance(points) + 1e-12).all()


def test_one_radius_for_all_points_is_that_radius() -> None:
    points = samples(500)
    one, many = Corridor(LINE, 4e-3), Corridor(LINE, (4e-3,) * len(LINE))
    assert np.array_equal(one.signed_distance(points), many.signed_distance(points))


@pytest.mark.parametrize(
    ("radius", "message"),
    [
        ((1e-3, 2e-3), "corridor has 2 radii for 5 points; it must have 1 or 5"),
        ((1e-3, 0.0, 1e-3, 1e-3, 1e-3), "radius 2 of the corridor is 0; it must be greater than 0"),
        ("wide", "radius of the corridor is 'wide'"),
    ],
)
def test_radii_that_make_no_sense(radius: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Corridor(LINE, radius)  # type: ignore[arg-type]


def test_a_plan_within_the_corridor_of_a_centreline() -> None:
    phantom = bronchial_tree()
    image = phantom.image(1e-3)
    lung = field_of_image(image, lumen=image.chosen([LUMEN, TARGET]))
    line = centreline(lung, [0, 0, -0.008], phantom.stretches[2][1] * np.array(1e-3))
    vessel = line.corridor
    points = line.points[np.random.default_rng(1).integers(len(line.points), size=20_000)]
    points = points + np.random.default_rng(2).normal(0, 4e-3, points.shape)
    depth = vessel.signed_distance(points)
    assert (depth > 0).sum() > 1000
    # A ball within the way: what the lattice says of its centre falls short by its error at most.
    assert (lung.signed_distance(points) >= depth - lung.error - 1e-9)[depth > 0].all()
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "crl_ctr.yaml")
    withdrawn = (np.zeros(3), [-0.033, -0.092, -0.096])
    options = PlanOptions(objective="none")
    # The tip at the eighth point from the end; to look for it is not what is asked here.
    goal = ([0.1395, 1.9669, -0.6243], [0.023981, -0.036204, -0.082435])
    plan = plan_trajectory(robot, withdrawn, goal, obstacles=[vessel], options=options)
    assert plan.proved
    np.testing.assert_allclose(plan.end.tip_position, line.points[-8], atol=1e-5)
    arm = plan.end.position[1:]
    assert (phantom.depth(arm) > 0).all()
