"""Centrelines against the formulas of the ways that they run through."""

from __future__ import annotations

import numpy as np
import pytest

from tubeopt import InputError, SolveError
from tubeopt.bodies.centreline import centreline
from tubeopt.bodies.images import LabelImage, field_of_image
from tubeopt.bodies.phantoms import LUMEN, TARGET, bronchial_tree


def test_centreline_is_in_the_middle_with_radius() -> None:
    phantom = bronchial_tree()
    image = phantom.image(1e-3)
    field = field_of_image(image, lumen=image.chosen([LUMEN, TARGET]))
    end = np.array([-42.0, 8.0, 90.0]) * 1e-3
    line = centreline(field, [0, 0, 0], end)
    assert np.allclose(line.points[[0, -1]], [[0, 0, 0], end])
    assert np.diff(line.arc_length).max() < 1.5e-3
    assert line.arc_length[-1] == pytest.approx((42 + 37.2 + 28.1) * 1e-3, rel=0.05)
    depth = phantom.depth(line.points)
    assert (line.radius <= depth + image.spacing[0]).all()  # voxels count by their centres
    assert np.abs(line.radius - depth).max() < 1.8e-3  # a voxel and a cell
    trachea = line.points[(line.points[:, 2] > 5e-3) & (line.points[:, 2] < 30e-3)]
    assert np.linalg.norm(trachea[:, :2], axis=1).max() < 1.2e-3


def test_ends_must_be_free_and_joined() -> None:
    labels = np.zeros((16, 8, 8), dtype=np.uint8)
    labels[1:6, 1:7, 1:7] = labels[10:15, 1:7, 1:7] = 1
    image = LabelImage(labels, np.full(3, 1e-3))
    field = field_of_image(image, lumen=image.chosen([1]))
    with pytest.raises(SolveError, match="no free path"):
        centreline(field, np.array([3, 4, 4]) * 1e-3, np.array([12, 4, 4]) * 1e-3)
    with pytest.raises(InputError, match=r"start of the centreline lies .* mm in the wall; it must be free"):
        centreline(field, np.array([7.5, 4, 4]) * 1e-3, np.array([12, 4, 4]) * 1e-3)
