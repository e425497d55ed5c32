"""Winding numbers beside solid angles, and what they make of bodies that overlap, hollow ones, and folded surfaces."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from tests.examples import TWO_TUBE
from tubeopt import verify_trajectory
from tubeopt.bodies.corridors import MeshObstacle
from tubeopt.bodies.solids import field_of_mesh
from tubeopt.bodies.triangles import Triangles, rays_of, winding_number
from tubeopt.typing import Array


def sphere(centre: tuple[float, float, float], radius: float) -> trimesh.Trimesh:
    """A sphere of 320 triangles."""
    return trimesh.creation.icosphere(2, radius).apply_translation(centre)


def together(*bodies: trimesh.Trimesh) -> MeshObstacle:
    """Bodies as one mesh."""
    mesh = trimesh.util.concatenate(bodies)
    return MeshObstacle(tuple(map(tuple, mesh.vertices.tolist())), tuple(map(tuple, mesh.faces.tolist())))


def folded() -> trimesh.Trimesh:
    """A ring whose cross-section is a limacon: its inner loop is gone around twice."""
    around, along = np.meshgrid(np.arange(24) * np.pi / 12, np.arange(50) * np.pi / 25, indexing="ij")
    out, up = (0.5 + np.cos(along)) * np.cos(along), (0.5 + np.cos(along)) * np.sin(along)
    vertices = np.stack([(4 + out) * np.cos(around), (4 + out) * np.sin(around), up], axis=-1).reshape(-1, 3)
    i, j = (k.ravel() for k in np.meshgrid(np.arange(24), np.arange(50), indexing="ij"))
    a, b = i * 50 + j, (i + 1) % 24 * 50 + j
    c, d = i * 50 + (j + 1) % 50, (i + 1) % 24 * 50 + (j + 1) % 50
    return trimesh.Trimesh(vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)]), process=False)


def by_solid_angle(corners: Array, points: Array) -> Array:
    """(N,) winding numbers as sums of solid angles (van Oosterom and Strackee 1983)."""
    a, b, c = (corners[None, :, k] - points[:, None] for k in range(3))
    size = [np.linalg.norm(each, axis=2) for each in (a, b, c)]
    volume = (a * np.cross(b, c)).sum(2)
    by = size[0] * size[1] * size[2] + (a * b).sum(2) * size[2] + (b * c).sum(2) * size[0] + (c * a).sum(2) * size[1]
    return np.asarray(np.arctan2(volume, by).sum(1) / (2 * np.pi))


@pytest.mark.parametrize(
    "mesh",
    [
        trimesh.creation.box((2, 2, 2)),
        trimesh.util.concatenate([sphere((0, 0, 0), 1.0), sphere((0.6, 0, 0), 0.7)]),
        trimesh.util.concatenate([sphere((0, 0, 0), 1.0), sphere((0, 0.1, 0), 0.5)]),
        folded(),
    ],
)
def test_winding_numbers_are_sums_of_solid_angles(mesh: trimesh.Trimesh) -> None:
    """Among random points are those of a lattice, above and below edges and corners."""
    rng, corners = np.random.default_rng(1), np.asarray(mesh.triangles)
    points = rng.uniform(*mesh.bounds, (600, 3)) * 1.1
    points[:200] = np.round(points[:200] * 4) / 4
    corner = mesh.vertices[rng.integers(0, len(mesh.vertices), 100)]
    points[200:300] = corner + rng.uniform(0.01, 1.0, (100, 1)) * [0, 0, 1]
    # The sum has no sign in the line of an edge: it is that beside it.
    truth = by_solid_angle(corners, points + rng.normal(size=points.shape) * 1e-7)
    clear = Triangles(corners, closed=False).signed_distance(points) > 1e-6
    assert clear.sum() > 400
    np.testing.assert_array_equal(winding_number(rays_of(corners), points)[clear], np.round(truth[clear]))


def test_bodies_that_overlap_are_one() -> None:
    """The surface of one lies within the other: the normal of the nearest triangle told a point there to be outside."""
    both = together(sphere((0, 0, 0), 1.0), sphere((0.8, 0, 0), 0.6))
    points = np.random.default_rng(2).uniform(-1.5, 1.5, (4000, 3))
    away = np.minimum(np.linalg.norm(points, axis=1) - 1.0, np.linalg.norm(points - [0.8, 0, 0], axis=1) - 0.6)
    sure = np.abs(away) > 0.05  # triangles cut a sphere's caps off
    for body in (both, field_of_mesh(both, cell=0.05)):
        np.testing.assert_array_equal(body.signed_distance(points)[sure] < 0, away[sure] < 0)
    kept_in = field_of_mesh(both, keep="in", cell=0.05)
    room = kept_in.signed_distance(points)[sure]
    assert (room[away[sure] > 0] < 0).all()
    assert (room[away[sure] < 0] > 0).mean() > 0.9  # what lies within counts as a wall


@pytest.mark.parametrize(("turned", "solid"), [(False, True), (True, False)])
def test_a_surface_within_another_bounds_a_cavity_where_it_is_turned_against_it(turned: bool, solid: bool) -> None:
    inner = sphere((0.1, 0, 0), 0.5)
    if turned:
        inner.invert()
    body = together(sphere((0, 0, 0), 1.0), inner)
    distance = body.signed_distance(np.array([[0.1, 0, 0], [0.8, 0, 0], [1.5, 0, 0]]))
    assert (distance < 0).tolist() == [solid, True, False]


def test_a_folded_surface_bounds_all_that_it_goes_around() -> None:
    """Between both loops the nearest triangle is one of the inner loop, which looks outwards there."""
    ring = together(folded())
    assert ring.closed
    inside = np.array([[4.6, 0, 0], [4.25, 0, 0], [0, 4.6, 0]])
    outside = np.array([[3.9, 0, 0.6], [0, 0, 0], [5.6, 0, 0]])
    assert (ring.signed_distance(inside) < 0).all()
    assert (ring.signed_distance(outside) > 0).all()


def test_an_arm_within_bodies_that_overlap_is_not_clear() -> None:
    """The arm is 170 mm within one body; the surface of the other, 42 mm away, was taken for the nearest wall."""
    body = together(sphere((0, 0, 0.075), 0.2), sphere((0, 0.13, 0.075), 0.1))
    proof = verify_trajectory(TWO_TUBE, [0, 10], [[0, 0], [0.5, 0.5]], obstacles=[body], clearance=1e-3)
    assert not proof.holds
    assert proof.least_clearance < -0.02
