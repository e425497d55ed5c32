"""A channel along a curve in space, round below and open above, as a closed solid to be cut out of another (mm)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...files.units import TO_MM
from ...typing import Array
from .stl import manifold
from .winding import SAGITTA


def channel(points: Array, tangents: Array, ups: Array, heights: Array, radius: float) -> Any:
    """The manifold3d solid swept along `points` (N, 3), m: half a circle below, walls that rise along `ups`.

    Args:
        tangents, ups: (N, 3) unit; ups may lean along the curve.
        heights: (N,) of the walls above the points, m.
        radius: of the circle, m: that of the groove.
    """
    across = np.cross(tangents, ups)
    across /= np.linalg.norm(across, axis=1)[:, None]
    up = np.cross(across, tangents)
    count = max(8, math.ceil(math.pi / (2 * math.acos(1 - SAGITTA / radius))))
    angle = np.linspace(0.0, math.pi, 2 * math.ceil(count / 2) + 1)
    round_ = np.cos(angle)[:, None] * across[:, None] - np.sin(angle)[:, None] * up[:, None]
    below = points[:, None] + radius * round_
    lift = heights[:, None] * ups
    rings = np.concatenate([below, (below[:, -1] + lift)[:, None], (below[:, 0] + lift)[:, None]], axis=1)
    n, m = rings.shape[:2]
    grid = np.arange(n * m).reshape(n, m)
    a, b = grid[:-1], np.roll(grid[:-1], -1, axis=1)
    c, d = grid[1:], np.roll(grid[1:], -1, axis=1)
    sides = np.stack([np.stack([a, b, d], -1), np.stack([a, d, c], -1)]).reshape(-1, 3)
    fan = np.column_stack([np.zeros(m - 2, int), np.arange(1, m - 1), np.arange(2, m)])
    faces = np.vstack([sides, grid[0][fan][:, ::-1], grid[-1][fan]])
    corners = rings.reshape(-1, 3) * TO_MM
    if _volume(corners, faces) < 0:
        faces = faces[:, ::-1]
    library = manifold()
    mesh = library.Mesh(vert_properties=corners.astype(np.float32), tri_verts=np.ascontiguousarray(faces, np.uint32))
    return library.Manifold(mesh)


def _volume(corners: Array, faces: Array) -> float:
    p, q, r = (corners[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", p, np.cross(q, r))) / 6
