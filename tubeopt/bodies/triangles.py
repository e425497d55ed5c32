"""Signed distance from a closed surface of triangles, for many points at once.

trimesh finds the nearest point of one triangle, to rounding error where the body is of size 1; which triangles to ask
is found here with a tree of their centres, after the long ones are cut; and on which side a point lies follows from the
normals of all triangles that are equally near, weighted by their angles there (Baerentzen and Aanaes, 2005): that is
right at edges and corners too.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from ..typing import Array

FINEST = 6
"""Edges are cut to the longest side of the body over this, so that triangles are of similar size."""

FIRST = 3
"""Triangles that are asked first; their distance tells which others can be nearer."""

CHUNK = 4096
"""Points at once: bounds the memory."""

TIE = 1e-9
"""Triangles are equally near to within this share of the size of the body."""


@dataclass(frozen=True, eq=False)
class Triangles:
    """A closed surface, its normals outwards: corners (f, 3, 3) of the triangles, m."""

    corners: Array

    @cached_property
    def size(self) -> float:
        """Longest side of the box around it, m."""
        return float(np.ptp(self.corners.reshape(-1, 3), axis=0).max())

    @cached_property
    def _cut(self) -> Array:
        """The same surface of smaller triangles."""
        from trimesh.remesh import subdivide_to_size

        faces = np.arange(3 * len(self.corners)).reshape(-1, 3)
        longest = max(self.size / FINEST, 1e-12)
        points = self.corners.reshape(-1, 3)
        vertices, cut = subdivide_to_size(points, faces, longest, max_iter=40)  # type: ignore[no-untyped-call]
        corners: Array = np.asarray(vertices)[np.asarray(cut)]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        return np.asarray(corners[area > 0])

    @cached_property
    def _normals(self) -> Array:
        a, b, c = (self._cut[:, k] for k in range(3))
        normal: Array = np.cross(b - a, c - a)
        return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))

    @cached_property
    def _tree(self) -> tuple[Any, float]:
        """Centres of the triangles, and the largest distance of a corner from its centre."""
        centre = self._cut.mean(1)
        return scipy.spatial.cKDTree(centre), float(np.linalg.norm(self._cut - centre[:, None], axis=2).max())

    def signed_distance(self, points: Array) -> Array:
        """(N,) distance of points (N, 3), m; negative inside."""
        parts = [self._chunk(points[k : k + CHUNK]) for k in range(0, len(points), CHUNK)]
        return np.concatenate(parts) if parts else np.zeros(0)

    def _chunk(self, points: Array) -> Array:
        tree, radius = self._tree
        count = min(FIRST, len(self._cut))
        first = np.asarray(tree.query(points, k=count)[1]).reshape(len(points), count)
        _, distance = self._nearest(np.repeat(points, count, axis=0), first.ravel())
        bound = distance.reshape(-1, count).min(1)
        tie = TIE * self.size
        asked = tree.query_ball_point(points, bound + radius + tie)
        row = np.repeat(np.arange(len(points)), [len(each) for each in asked])
        face = np.concatenate([np.asarray(each, dtype=int) for each in asked])
        place, distance = self._nearest(points[row], face)
        least = np.full(len(points), np.inf)
        np.minimum.at(least, row, distance)
        # All triangles at a corner count by their angles there, or none: whether it is as near as the nearest place is
        # decided by the distance of the corner itself, which is the same number for all of them.
        corner, angle, there = self._corner(face, place)
        to_corner = np.linalg.norm(points[row] - corner, axis=1)
        tied = np.where(there, to_corner, distance) <= least[row] + tie
        row, face, place, angle = row[tied], face[tied], place[tied], angle[tied]
        angle = np.where(to_corner[tied] <= least[row] + tie, angle, np.pi)
        facing = (self._normals[face] * (points[row] - place)).sum(1) * angle
        side = np.bincount(row, facing, len(points))
        return np.where(side < 0, -least, least)

    def _nearest(self, points: Array, face: Array) -> tuple[Array, Array]:
        """Nearest points (K, 3) of triangles (K,) to points (K, 3), and their distance."""
        from trimesh.triangles import closest_point

        place = np.asarray(closest_point(self._cut[face] / self.size, points / self.size)) * self.size  # type: ignore[no-untyped-call]
        return place, np.linalg.norm(points - place, axis=1)

    def _corner(self, face: Array, place: Array) -> tuple[Array, Array, Array]:
        """(K, 3) the corner of triangles nearest to points of them, (K,) their angle there, and whether it is there.

        Elsewhere a triangle counts by pi: on an edge, and (as good) inside.
        """
        corner = self._cut[face]
        gap = np.linalg.norm(corner - place[:, None], axis=2)
        k, row = gap.argmin(1), np.arange(len(face))
        one, other = (corner[row, (k + j) % 3] - corner[row, k] for j in (1, 2))
        cosine = (one * other).sum(1) / (np.linalg.norm(one, axis=1) * np.linalg.norm(other, axis=1))
        return corner[row, k], np.arccos(np.clip(cosine, -1, 1)), gap[row, k] <= TIE * self.size
