"""Bounds of distances from bodies, where they are attained: by closed forms, so that no smaller constant passes."""

from __future__ import annotations

import numpy as np
import pytest

from tubeopt.bodies.corridors import MeshObstacle
from tubeopt.bodies.distance_field import TABLE_ROUND_OFF, DistanceField
from tubeopt.bodies.solids import (
    SAMPLING,
    _bounds,
    _samples,
    field_of_mesh,
    field_of_points,
    field_of_surface,
    largest_gap,
)
from tubeopt.typing import Array

CELL = np.array([2e-3, 3e-3, 1e-3])

NODES = np.moveaxis(np.indices((2, 2, 2)), 0, -1) * CELL

MIDDLE = CELL / 2

CLOSE = 5 * TABLE_ROUND_OFF


def away(points: Array, place: Array) -> Array:
    return np.asarray(np.linalg.norm(points - place, axis=-1))


def inside_the_cell(count: int = 200) -> Array:
    return np.asarray(np.random.default_rng(0).uniform(0, 1, (count, 3)) * CELL)


@pytest.mark.parametrize("place", [MIDDLE, np.array([5e-3, -4e-3, 2e-3]), np.array([1e-3, 1e-3, 0.5e-3])])
def test_the_distance_from_a_point_is_the_root_of_mean_squares_less_their_variance(place: Array) -> None:
    """sum w |v_k - p|^2 - V is |y - p|^2: a table of a point holds its distance, but for rounding of squares."""
    table, points = DistanceField(away(NODES, place), CELL), inside_the_cell()
    true = away(points, place)
    result = table.signed_distance(points)
    assert (result <= true).all()
    assert result == pytest.approx(true, abs=2e-6)
    far = true > 1e-3
    assert result[far] == pytest.approx(true[far], abs=1e-8)


@pytest.mark.parametrize("radius", [0.0, 1e-3, 0.5])
def test_within_a_ball_the_bound_is_attained_at_its_centre(radius: float) -> None:
    """All corners are as far as the centre is from them, which is the root of V."""
    table = DistanceField(away(NODES, MIDDLE) - radius, CELL)
    assert -CLOSE - 1e-7 * radius <= table.signed_distance(MIDDLE) + radius <= 0


@pytest.mark.parametrize("lowered", [0.0, 1e-4])
def test_the_error_of_a_table_is_attained_in_the_middle_of_a_hollow_ball(lowered: float) -> None:
    """Corners lie in the wall: their mean is short of the centre by the root of V, and the bound by twice that."""
    radius = 1e-3
    table = DistanceField(radius - away(NODES, MIDDLE) - lowered, CELL, node_error=lowered)
    short = radius - float(table.signed_distance(MIDDLE))
    assert table.error - 2 * CLOSE <= short <= table.error
    largest = float(table.at_most(MIDDLE[None])[0])
    assert radius <= largest <= radius + CLOSE


def test_beyond_a_table_the_distance_falls_by_the_way_at_most_and_grows_by_it_at_most() -> None:
    """To a point straight ahead it falls by the way, and to one straight behind it grows by it."""
    border = np.array([CELL[0], 0.0, 0.0])
    for fraction in (2.5, 0.5):
        position = fraction * border
        ahead = position[0] > border[0]
        table, point = DistanceField(away(NODES, position), CELL), 2 * border
        true = float(away(point, position))
        low, high = float(table.signed_distance(point)), float(table.at_most(point[None])[0])
        assert low <= true <= high
        assert (true - low if ahead else high - true) < CLOSE


def test_beyond_a_table_that_holds_all_of_a_body_the_way_on_is_square_at_most() -> None:
    """The body is a point of the border, and the point lies straight in front of another."""
    position, foot = np.array([CELL[0], 0.0, 0.0]), np.array([CELL[0], CELL[1], 0.0])
    table = DistanceField(away(NODES, position), CELL, bounded=True)
    for path in (1e-3, 4e-3, 0.1):
        point = foot + np.array([path, 0.0, 0.0])
        true = np.hypot(path, CELL[1])
        assert true - CLOSE <= table.signed_distance(point) <= true


def test_numbers_of_a_table_are_rounded_to_the_safe_side() -> None:
    random = np.random.default_rng(1).uniform(-0.1, 0.1, (20, 20, 20))
    table = DistanceField(random, CELL)
    low = table.values.astype(float)
    assert (low < random).all()
    assert (low > random - 3e-8).all()
    assert (table._squares.astype(float) <= np.maximum(low, 0.0) ** 2).all()


@pytest.mark.parametrize(("share", "gap"), [(1.0, 8.0 + 1e-9), (0.5, 1.1)])
def test_the_middle_of_an_equilateral_triangle_is_as_far_from_samples_as_is_said(share: float, gap: float) -> None:
    """r = e / 3^(1/2) for the longest side e that is not cut; straight above it D^2 = d^2 + r^2."""
    size, side = 1e-3, np.sqrt(3) * share * 1e-3
    turn = np.arange(3) * 2 * np.pi / 3
    corners = side / np.sqrt(3) * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)[None] * (1 - 1e-12)
    samples, uncovered = _samples(corners, share * size)
    assert len(samples) == 3
    assert uncovered == pytest.approx(np.linalg.norm(samples, axis=1).min(), rel=1e-9)
    height = gap * size * (1.001 if share == 1.0 else 1.0)
    smallest, largest = _bounds(corners, np.array([[0.0, 0.0, height]]), size)
    assert smallest == pytest.approx([height], rel=1e-9)
    assert largest == pytest.approx([np.hypot(height, side / np.sqrt(3))], rel=1e-9)
    assert SAMPLING == ((1.0, 8.0), (0.5, 0.0))


def test_a_thick_cloud_and_a_thick_surface_lie_within_their_tables() -> None:
    """From afar no point is farther than it is, however thick they are against the cells."""
    radius, points = 0.03, np.random.default_rng(2).uniform(-0.1, 0.1, (200, 3))
    triangle = np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.0, 0.01, 0.0]])
    surface = MeshObstacle(tuple(map(tuple, triangle.tolist())), ((0, 1, 2),))
    true = surface.surface.signed_distance(points) - radius
    thick = field_of_surface(surface, radius, cell=2e-3)
    assert (thick.signed_distance(points) <= true + 1e-12).all()
    assert (thick.signed_distance(points) >= true - thick.error)[true < 0.01].all()
    ball = field_of_points(np.zeros((1, 3)), radius, cell=2e-3)
    true = np.linalg.norm(points, axis=1) - radius
    assert (ball.signed_distance(points) <= true).all()
    assert (ball.signed_distance(points) >= true - ball.error)[true < 0.01].all()


@pytest.mark.parametrize(("share", "warned"), [(0.999, False), (1.001, True)])
def test_a_cloud_is_warned_of_where_neighbours_are_farther_apart_than_the_radius(
    share: float, warned: bool, caplog: pytest.LogCaptureFixture
) -> None:
    field_of_points([[0.0, 0.0, 0.0], [share * 2e-3, 0.0, 0.0]], 2e-3)
    assert ("the arm may pass between balls" in caplog.text) == warned


def test_what_lies_deep_in_a_surface_is_bounded_by_the_farthest_that_it_may_be() -> None:
    """Nodes that are not asked one by one: inside -most, outside least; `error` says by how much these are short."""
    side, cell = 0.008, 1e-3
    x, y, z = (np.array([0.0, side])[np.array(bits)] for bits in zip(*np.ndindex(2, 2, 2), strict=True))
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = tuple(each for a, b, c, d in sides for each in ((a, b, c), (a, c, d)))
    mesh = MeshObstacle(tuple(zip(x.tolist(), y.tolist(), z.tolist(), strict=True)), faces)
    for keep, sign in (("out", 1.0), ("in", -1.0)):
        field = field_of_mesh(mesh, keep=keep, cell=cell)
        nodes = np.moveaxis(np.indices(field.values.shape), 0, -1) * field.spacing + field.frame.origin
        beyond = np.abs(nodes - side / 2) - side / 2
        true = sign * (np.linalg.norm(np.maximum(beyond, 0.0), axis=-1) + np.minimum(beyond.max(-1), 0.0))
        short = true - field.values
        assert short.min() > 0
        assert 0.5 * field.node_error < short.max() <= field.node_error + 2 * CLOSE
        assert short[np.abs(true) < 1.9 * cell].max() < 2 * CLOSE
        far = np.array([side / 2, side / 2, 10 * side])
        assert (field.signed_distance(far) > 0) == (keep == "out")


def test_the_largest_gap_of_two_rows_is_that_between_them() -> None:
    """Each row has more points than neighbours are asked for."""
    along = np.concatenate([np.arange(20.0), np.arange(69.0, 89.0)])
    assert largest_gap(np.stack([along, 0 * along, 0 * along], axis=1)) == 50.0
    assert largest_gap(np.stack([along[:20], 0 * along[:20], 0 * along[:20]], axis=1)) == 1.0
