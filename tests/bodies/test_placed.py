"""Bodies as another frame sees them are at the distance that they are at."""

from __future__ import annotations

import numpy as np
import pytest
import scipy

from tubeopt.bodies.anatomy import TransformedBody, bodies_in_frame
from tubeopt.bodies.corridors import Corridor, MeshObstacle
from tubeopt.bodies.distance_field import DistanceField
from tubeopt.bodies.frames import Frame
from tubeopt.bodies.obstacles import Box, Capsule, HalfSpace, Obstacle, RoundCone, Scene, Sphere

TABLE = DistanceField(np.random.default_rng(1).uniform(0.01, 0.02, (3, 4, 5)), np.full(3, 5e-3), stands_for="points")

BODIES: tuple[Obstacle, ...] = (
    Sphere((0.01, -0.02, 0.05), 0.013),
    Capsule((0.0, 0.01, 0.02), (0.03, -0.01, 0.06), 0.007),
    RoundCone((0.0, 0.01, 0.02), (0.03, -0.01, 0.06), 0.007, 0.003),
    HalfSpace((0.0, 0.0, 0.01), (0.3, -0.2, 2.0)),
    Box((-0.01, -0.02, 0.03), (0.02, 0.01, 0.05)),
    Corridor(((0.0, 0.0, 0.0), (0.0, 0.01, 0.03), (0.01, 0.0, 0.05)), 0.01),
    MeshObstacle(((0.0, 0.0, 0.0), (0.02, 0.0, 0.0), (0.0, 0.02, 0.01)), ((0, 1, 2),)),
    TABLE,
    TransformedBody(TABLE, Frame()),
)


@pytest.mark.parametrize("body", BODIES, ids=lambda body: type(body).__name__)
def test_a_body_is_as_far_from_a_point_in_whatever_frame_both_are(body: Obstacle) -> None:
    axes = scipy.spatial.transform.Rotation.from_euler("xyz", [0.4, -0.7, 1.1]).as_matrix()
    frame = Frame(axes, np.array([0.03, -0.02, 0.05]))
    points = np.random.default_rng(0).uniform(-0.05, 0.08, (300, 3))
    observed = bodies_in_frame(frame, [body])[0]
    # What a mesh says of points far from it depends on its table.
    one, other = (each.surface if isinstance(each, MeshObstacle) else each for each in (observed, body))
    assert one.signed_distance(frame.seen(points)) == pytest.approx(other.signed_distance(points), abs=1e-9)
    scenes = [Scene((each,)) for each in (observed, body.body if isinstance(body, TransformedBody) else body)]
    assert scenes[0].solid == scenes[1].solid
    assert scenes[0].stands_for == scenes[1].stands_for
