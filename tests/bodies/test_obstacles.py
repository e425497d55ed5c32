"""Obstacles: distances to the nearest surface point, gradients, the smooth form against the exact one."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from tubeopt import InputError
from tubeopt.bodies.distance_field import DistanceField
from tubeopt.bodies.obstacles import (
    Box,
    Capsule,
    ClearanceMonitor,
    HalfSpace,
    Obstacle,
    Scene,
    Sphere,
    nearest_distance,
    scene_of,
)

BODIES: tuple[Obstacle, ...] = (
    Sphere((0.01, -0.02, 0.05), 0.013),
    Capsule((0.0, 0.01, 0.02), (0.03, -0.01, 0.06), 0.007),
    Capsule((0.01, 0.01, 0.02), (0.01, 0.01, 0.02), 0.007),
    HalfSpace((0.0, 0.0, 0.01), (0.3, -0.2, 2.0)),
    Box((-0.01, -0.02, 0.03), (0.02, 0.01, 0.05)),
)

POINTS = np.random.default_rng(0).uniform([-0.06, -0.06, -0.02], [0.06, 0.06, 0.1], (400, 3))


@pytest.mark.parametrize("body", BODIES, ids=lambda body: type(body).__name__)
def test_distance_is_that_of_the_nearest_surface_point(body: Obstacle) -> None:
    """Stepping back along the gradient by the distance lands on the surface, and no shorter way does."""
    distance, gradient = body.signed_distance(POINTS), body.gradient(POINTS)
    landed = POINTS - distance[:, None] * gradient
    np.testing.assert_allclose(body.signed_distance(landed), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(gradient, axis=1), 1.0, atol=1e-12)
    paths = np.random.default_rng(1).normal(size=(50, 3))
    paths /= np.linalg.norm(paths, axis=1)[:, None]
    for path in paths:
        beside = body.signed_distance(POINTS + 0.5 * np.abs(distance)[:, None] * path)
        assert (np.sign(beside) == np.sign(distance)).all()


@pytest.mark.parametrize("body", BODIES, ids=lambda body: type(body).__name__)
def test_smooth_form_agrees_on_arrays_and_symbols(body: Obstacle) -> None:
    exact = body.signed_distance(POINTS)
    np.testing.assert_allclose(body.distance(*POINTS.T), exact, atol=5e-7)
    x = ca.SX.sym("x", 3)
    value = ca.Function("distance", [x], [body.distance(x[0], x[1], x[2])])
    slope = ca.Function("slope", [x], [ca.gradient(value(x), x)])
    for point, desired in zip(POINTS[:40], exact, strict=False):
        assert float(value(point)) == pytest.approx(desired, abs=5e-7)
        # Away from edges and middles, where the exact distance has kinks.
        step = 1e-5 * np.eye(3)
        ahead, behind = body.gradient(point + step), body.gradient(point - step)
        if np.abs(ahead - behind).max() < 0.05:
            np.testing.assert_allclose(slope(point).full().ravel(), body.gradient(point), atol=2e-3)


def test_nearest_of_several() -> None:
    distance = nearest_distance(BODIES, POINTS)
    np.testing.assert_array_equal(distance, np.min([body.signed_distance(POINTS) for body in BODIES], axis=0))
    assert np.isinf(nearest_distance([], POINTS)).all()


def test_bodies_that_are_none_are_refused() -> None:
    with pytest.raises(InputError, match=r"radius of the sphere is -1; it must be greater than 0"):
        Sphere((0, 0, 0), -1)
    with pytest.raises(InputError, match=r"centre of the sphere has 2 numbers"):
        Sphere((0, 0), 1)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"normal of the half-space is \(0, 0, 0\)"):
        HalfSpace((0, 0, 0), (0, 0, 0))
    with pytest.raises(InputError, match=r"corners of the box are 1 and 0 m along y"):
        Box((0, 1, 0), (1, 0, 1))
    with pytest.raises(InputError, match=r"the last axis must be x, y"):
        Sphere((0, 0, 0), 1).signed_distance([1.0, 2.0])


def test_they_are_hashable_and_equal_by_value() -> None:
    assert len({Sphere((0, 0, 0), 1), Sphere((0.0, 0.0, 0.0), 1.0)}) == 1


def test_a_scene_knows_which_bodies_are_close() -> None:
    random = np.random.default_rng(0)
    points = random.normal(size=(40, 3)) * 0.03
    spheres = [Sphere(tuple(c.tolist()), random.uniform(1e-3, 1e-2)) for c in random.normal(size=(80, 3)) * 0.1]
    boxes = [Box(tuple(c.tolist()), tuple((c + 5e-3).tolist())) for c in random.normal(size=(20, 3)) * 0.1]
    bodies = (*spheres, *boxes, HalfSpace((0.0, 0.0, -0.2), (0.0, 0.0, 1.0)))
    close = [bodies[k] for k in scene_of(bodies).close(points, 0.01)]
    near = [body for body in bodies if body.signed_distance(points).min() < 0.01]
    far = [body for body in bodies if body.signed_distance(points).min() > 0.03]
    assert near
    assert far
    assert set(near) <= set(close)
    assert not set(far) & set(close)


def test_clearance_monitor_agrees_with_search_and_searches_seldom(monkeypatch: pytest.MonkeyPatch) -> None:
    random, scene = np.random.default_rng(0), scene_of(BODIES)
    points, reach = POINTS[:12] + np.array([0.1, 0.0, 0.05]), random.uniform(1e-3, 2e-2, 12)
    requested, nearest = [0], Scene.nearest

    def counted(scene: Scene, points: np.ndarray, within: np.ndarray | float = np.inf) -> np.ndarray:
        requested[0] += 1
        return nearest(scene, points, within)

    monkeypatch.setattr(Scene, "nearest", counted)
    monitor, report = ClearanceMonitor(scene), []
    for _ in range(400):
        points = points + random.normal(size=points.shape) * 1e-4 - np.array([3e-4, 0.0, 1e-4])
        report.append(monitor.far(points, reach))
        assert report[-1] == bool((nearest(scene, points) > reach).all())
    assert 50 < sum(report) < 350
    assert requested[0] < 60


def test_clearance_monitor_reuses_distance_within_motion() -> None:
    """Of 5 mm, where 1 mm are asked for, a way of 4 mm straight towards a plane leaves nothing to spare."""
    wall = Scene((HalfSpace((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),))
    for path, far in ((3.99e-3, True), (4.01e-3, False)):
        monitor, reach = ClearanceMonitor(wall), np.array([1e-3])
        assert monitor.far(np.array([[0.0, 0.0, 5e-3]]), reach)
        assert monitor.far(np.array([[0.0, 0.0, 5e-3 - path]]), reach) == far


def test_a_scene_names_all_bodies_that_are_closer_than_a_reach() -> None:
    """A ball, a plane and a ball far away, of which each distance is known."""
    plane = HalfSpace((0.0, 0.0, -5e-3), (0.0, 0.0, 1.0))
    scene = Scene((Sphere((0.0, 0.0, 0.0), 1e-3), plane, Sphere((1.0, 0.0, 0.0), 1e-3)))
    point = np.array([[0.0, 0.0, 4e-3]])
    for reach, close in ((2.999e-3, []), (3.001e-3, [0]), (8.999e-3, [0]), (9.001e-3, [0, 1])):
        assert scene.close(point, reach) == close
    assert scene.distances([2, 0, 1], point).ravel() == pytest.approx([np.hypot(1, 4e-3) - 1e-3, 3e-3, 9e-3])


def test_the_nearest_of_long_bodies_is_not_the_one_with_the_nearest_centre() -> None:
    random = np.random.default_rng(0)
    size, positions = (
        np.array([128, 1, 1]) / 1024,
        np.round(random.normal(size=(40, 3)) * 100) / 1024,
    )  # without round-off
    boxes = [Box(tuple(c.tolist()), tuple((c + size).tolist())) for c in positions]
    points = random.normal(size=(300, 3)) * 0.1
    true = np.min([body.signed_distance(points) for body in boxes], axis=0)
    assert boxes[0].balls()[1] == pytest.approx(np.linalg.norm(boxes[0].balls()[0] - boxes[0].low, axis=1))
    assert Scene(tuple(boxes)).nearest(points) == pytest.approx(true, abs=1e-12)


def test_a_scene_is_solid_where_all_its_bodies_are() -> None:
    ball = Sphere((0.0, 0.0, 0.0), 1e-3)
    table = DistanceField(np.ones((2, 2, 2)), np.ones(3))
    assert [Scene(bodies).solid for bodies in ((ball,), (ball, table), (table,))] == [True, False, False]
