"""On which side of closed surfaces points lie, however their triangles are turned."""

from __future__ import annotations

import numpy as np
import pytest

from tubeopt import InputError
from tubeopt.bodies.corridors import MeshObstacle
from tubeopt.bodies.triangles import Triangles, oriented
from tubeopt.typing import Array, Index

trimesh = pytest.importorskip("trimesh")

RNG = np.random.default_rng(0)
POINTS = RNG.uniform(-0.07, 0.07, (2000, 3))


def ball(radius: float, turned: float = 0.0) -> tuple[Array, Index]:
    """Corners and faces of a ball, a share of which are turned inwards."""
    mesh = trimesh.creation.icosphere(2, radius)
    faces = np.array(mesh.faces)
    some = RNG.random(len(faces)) < turned
    faces[some] = faces[some, ::-1]
    return np.array(mesh.vertices), faces


def joined(*parts: tuple[Array, Index]) -> MeshObstacle:
    first = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    faces = np.concatenate([part + k for (_, part), k in zip(parts, first, strict=False)])
    vertices = np.concatenate([part for part, _ in parts])
    return MeshObstacle(tuple(map(tuple, vertices.tolist())), tuple(map(tuple, faces.tolist())))


@pytest.mark.parametrize("turned", [(0.0, 1.0, 0.0), (1.0, 0.0, 1.0), (0.2, 0.7, 0.3)])
def test_cavities_are_turned_against_what_is_around_them(turned: tuple[float, float, float]) -> None:
    """A ball, a cavity in it, and an island in that, of triangles that are turned as they should, all the other way, or
    now so, now so."""
    body = joined(*(ball(radius, fraction) for radius, fraction in zip((0.05, 0.03, 0.01), turned, strict=True)))
    far = np.linalg.norm(POINTS, axis=1)
    true = np.minimum(np.maximum(far - 0.05, 0.03 - far), far - 0.01)
    clear = np.abs(true) > 2e-3
    report = body.surface.signed_distance(POINTS[clear])
    assert np.abs(report - true[clear]).max() < 1.5e-3


def test_bodies_that_overlap_are_one_however_they_are_turned() -> None:
    """A smaller ball reaches out of a larger one, its triangles turned inwards: it is no cavity."""
    (large, faces), (small, turned) = ball(0.04), ball(0.03, 1.0)
    aside = np.array([0.035, 0.0, 0.0])
    body = joined((large, faces), (small + aside, turned))
    depth = np.maximum(0.04 - np.linalg.norm(POINTS, axis=1), 0.03 - np.linalg.norm(POINTS - aside, axis=1))
    clear = np.abs(depth) > 2e-3
    assert ((body.surface.signed_distance(POINTS[clear]) < 0) == (depth[clear] > 0)).all()


def test_a_surface_with_one_side_is_refused() -> None:
    """Klein's bottle: a strip whose ends are joined after it was turned over."""
    n = 8
    corner = [[((i + a) % n) * n + (j + b if i + a < n else -j - b) % n for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))]
              for i in range(n) for j in range(n)]  # fmt: skip
    quads = np.array(corner)
    with pytest.raises(InputError, match="one-sided"):
        oriented(RNG.normal(size=(n * n, 3)), np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))


def test_triangles_without_area_are_the_segments_and_points_that_they_are() -> None:
    """An open surface of a triangle, of one that is a segment, and of one that is a point."""
    a, b, c, d = 0.05 * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.5, 0.0, 1.0]])
    surface = Triangles(np.array([[a, b, c], [c, d, c], [-d, -d, -d]]), closed=False)
    along = np.clip((POINTS - c) @ (d - c) / ((d - c) @ (d - c)), 0.0, 1.0)
    point, segment = (np.linalg.norm(POINTS - position, axis=1) for position in (-d, c + along[:, None] * (d - c)))
    every = np.repeat(np.array([[a, b, c]]), len(POINTS), axis=0)
    triangle = np.linalg.norm(trimesh.triangles.closest_point(every, POINTS) - POINTS, axis=1)
    true = np.min([point, segment, triangle], axis=0)
    assert (np.argmin([point, segment, triangle], axis=0) == np.arange(3)[:, None]).any(1).all()
    assert surface.signed_distance(POINTS) == pytest.approx(true, abs=1e-12)
