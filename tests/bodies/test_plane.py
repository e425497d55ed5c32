"""Planes in space: what lies on them, and in whose frame."""

from __future__ import annotations

import numpy as np
import pytest

from tubeopt import InputError
from tubeopt.bodies.frames import Plane, base_frame


def test_plane_contains_its_points_in_every_frame() -> None:
    three = np.random.default_rng(0).normal(size=(3, 3))
    plane, frame = Plane.through(*three), base_frame([0.1, -0.2, 0.3], [0.3, 0.2, 1.0], 0.7)
    assert plane.height(three) == pytest.approx(0, abs=1e-12)
    assert plane.seen_from(frame).height(frame.seen(three)) == pytest.approx(0, abs=1e-12)
    assert plane.height(plane.frame.placed([3.0, -2.0, 0.5])) == pytest.approx(0.5)
    for normal in ([0, 0, 2], [1, 0, 0], [0.1, 0, 1]):
        axes = Plane(np.zeros(3), np.array(normal)).frame.axes
        assert np.linalg.det(axes) == pytest.approx(1.0)
        np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-12)
    with pytest.raises(InputError, match="lie on one line"):
        Plane.through([0, 0, 0], [0, 0, 1], [0, 0, 3])
