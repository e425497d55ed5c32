"""Distance from a surface of triangles, for many points at once; of a closed surface it has a sign.

Which triangles to ask is found with a tree of their centres, after the long ones are cut; and on which side a point
lies is what the winding number of the surface says.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from ..errors import InputError
from ..typing import Array, Index, Mask
from .distance_field import UP
from .obstacles import unit_vectors
from .winding import Rays, seen_along, winding_number

FINEST = 6
"""Edges are cut to the longest side of the body over this, so that triangles are of similar size."""

FIRST = 3
"""Triangles that are asked first; their distance tells which others can be nearer."""

CHUNK = 4096
"""Points at once: bounds the memory."""

TIE = 1e-9
"""Triangles are equally near to within this share of the size of the body."""

ON = 1e-12
"""Distance (m) up to which a point is on the surface."""

THIN = 1e-12
"""Height of a triangle over its longest side up to which it counts as its longest side."""


def bisected(corners: Array, longest: float) -> Array:
    """(g, 3, 3) a surface of triangles (f, 3, 3), cut across their longest sides until none is longer than this."""
    done = []
    while len(corners):
        side = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        most = side.argmax(1)
        long = side.max(1) > longest
        done.append(corners[~long])
        order = (most[long, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(np.take_along_axis(corners[long], order[..., None], axis=1), 1, 0)
        middle = (a + b) / 2
        corners = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate([corners, *done])


def oriented(vertices: Array, faces: Index) -> Index:
    """Faces (f, 3) of closed surfaces, each edge that of two, turned so that normals point out of what they bound.

    Neighbours are made to agree, as most of them in their body lie. The largest body is not a cavity, and of the others
    those that were turned against it are, where their box lies within that of another.

    Raises:
        InputError: a surface with one side, as a Moebius strip's.
    """
    count, faces = len(faces), np.array(faces)
    edges = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    pairs = np.lexsort(np.sort(edges, axis=1).T).reshape(-1, 2)
    one, other = pairs.T // 3
    forward = (edges[:, 0] < edges[:, 1])[pairs]
    differ = count * (forward[:, 0] == forward[:, 1])  # of neighbours that agree the one runs there, the other back
    # Every face stands for itself and, `count` further, for itself turned over.
    rows, columns = np.concatenate([one, one + count]), np.concatenate([other + differ, other + count - differ])
    graph = scipy.sparse.coo_array((np.ones(len(rows), dtype=bool), (rows, columns)), shape=(2 * count, 2 * count))
    _, part = scipy.sparse.csgraph.connected_components(graph, directed=False)
    if (part[:count] == part[count:]).any():
        raise InputError("the mesh is a one-sided surface; it must have an inside and an outside")
    _, body = np.unique(np.minimum(part[:count], part[count:]), return_inverse=True)
    turned = part[:count] > part[count:]
    turned ^= (np.bincount(body, turned) > np.bincount(body) / 2)[body]
    faces[turned] = faces[turned, ::-1]
    a, b, c = np.moveaxis(vertices[faces] - vertices[faces[:, 0]].mean(0), 1, 0)
    volume = np.bincount(body, (a * np.cross(b, c)).sum(1))
    against = volume * np.sign(volume[np.abs(volume).argmax()]) < 0
    low, high = np.full((len(volume), 3), np.inf), np.full((len(volume), 3), -np.inf)
    for corner in (a, b, c):
        np.minimum.at(low, body, corner)
        np.maximum.at(high, body, corner)
    around, beyond = low[~against], high[~against]
    cavity = against.copy()
    for k in np.flatnonzero(against):
        cavity[k] = ((around < low[k]) & (beyond > high[k])).all(1).any()
    inwards = ((volume > 0) == cavity)[body]
    faces[inwards] = faces[inwards, ::-1]
    return faces


def _areas(corners: Array) -> Array:
    """(f,) twice the areas of triangles (f, 3, 3), m^2."""
    square = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(np.linalg.norm(square, axis=1))


@dataclass(frozen=True, eq=False)
class Triangles:
    """A surface by the corners (f, 3, 3) of its triangles, m."""

    corners: Array
    closed: bool = True
    """Whether it bounds a body, its normals outwards; the distance from another surface has no sign."""
    hollow: bool = False
    """Whether the body is all that a closed surface does not go around."""

    @cached_property
    def size(self) -> float:
        """Longest side of the box around it, m."""
        return float(np.ptp(self.corners.reshape(-1, 3), axis=0).max())

    @cached_property
    def _cut(self) -> Array:
        """The same surface of smaller triangles."""
        corners = bisected(self.corners, max(self.size / FINEST, 1e-12))
        # Each side of a closed surface is that of another triangle too; an open one can end in one without area.
        return corners if not self.closed else np.asarray(corners[_areas(corners) > 0])

    @cached_property
    def _normals(self) -> Array:
        """(f, 3) unit vectors; 0 for a triangle without inside, which then lies in its disc however that is turned."""
        a, b, c = (self._cut[:, k] for k in range(3))
        normal: Array = np.cross(b - a, c - a)
        return np.where(self._flat[:, None], unit_vectors(normal, np.zeros(3)), 0.0)

    @cached_property
    def _flat(self) -> Mask:
        """(f,) whether a triangle has an inside, to which there are perpendiculars."""
        side = np.linalg.norm(np.roll(self._cut, -1, axis=1) - self._cut, axis=2).max(1)
        return np.asarray(_areas(self._cut) > THIN * side**2)

    @cached_property
    def _discs(self) -> tuple[Array, Array]:
        """Centres (f, 3) of the triangles, and the largest distance (f,) of a corner from each."""
        centre = self._cut.mean(1)
        return centre, np.linalg.norm(self._cut - centre[:, None], axis=2).max(1)

    @cached_property
    def _tree(self) -> tuple[Any, float]:
        """The tree of the centres, and the largest disc."""
        centre, size = self._discs
        return scipy.spatial.cKDTree(centre), float(size.max())

    @cached_property
    def _sides(self) -> tuple[Array, Array, Array]:
        """Of every triangle its sides (f, 3, 3), their squares (f, 3), and vectors (f, 3, 3) square to them that point
        into it."""
        side = np.roll(self._cut, -1, axis=1) - self._cut
        into = np.cross(self._normals[:, None], side)
        square = np.maximum((side**2).sum(-1), np.finfo(float).tiny)
        return side, square, into

    @cached_property
    def _rays(self) -> list[Rays]:
        return seen_along(self.corners)

    def _in_body(self, points: Array) -> Mask:
        """(N,) whether points (N, 3) are in the body: bodies that overlap are one, and a cavity is no part of it."""
        if not self.closed:
            return np.zeros(len(points), dtype=bool)
        return np.asarray((winding_number(self._rays, points) != 0) ^ self.hollow)

    def signed_distance(self, points: Array) -> Array:
        """(N,) distance of points (N, 3), m; negative inside a closed surface."""
        return self.nearest(points)[0]

    def nearest(self, points: Array) -> tuple[Array, Array, Array]:
        """(N,) distance of points (N, 3), m, negative inside a closed surface; their nearest places (N, 3), and normals
        there (N, 3)."""
        parts = [self._chunk(points[k : k + CHUNK]) for k in range(0, len(points), CHUNK)]
        empty = np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3))
        distance, place, normal = (np.concatenate(each) for each in zip(empty, *parts, strict=True))
        return distance, place, normal

    def gradient(self, points: Array) -> Array:
        """(N, 3) unit vectors along which the distance of points (N, 3) grows: on the surface its normals, and where
        several places are equally near, along the way from one of them."""
        distance, nearest, normal = self.nearest(points)
        far = np.abs(distance)[:, None] > ON
        at = unit_vectors(normal, UP)
        return np.asarray(np.where(far, (points - nearest) / np.where(far, distance[:, None], 1.0), at))

    def _chunk(self, points: Array) -> tuple[Array, Array, Array]:
        tree, radius = self._tree
        count = min(FIRST, len(self._cut))
        first = np.asarray(tree.query(points, k=count)[1]).reshape(len(points), count)
        _, distance = self._places(np.repeat(points, count, axis=0), first.ravel())
        bound = distance.reshape(-1, count).min(1)
        tie = TIE * self.size
        asked = tree.query_ball_point(points, bound + radius + tie)
        row = np.repeat(np.arange(len(points)), [len(each) for each in asked])
        face = np.concatenate([np.asarray(each, dtype=int) for each in asked])
        near = self._at_least(points[row], face) <= bound[row] + tie
        row, face = row[near], face[near]
        place, distance = self._places(points[row], face)
        # Rows are in order, and none is without a triangle.
        first = np.searchsorted(row, np.arange(len(points)))
        least = np.minimum.reduceat(distance, first)
        nearest = np.flatnonzero(distance <= least[row])
        one = nearest[np.searchsorted(row[nearest], np.arange(len(points)))]
        return np.where(self._in_body(points), -least, least), place[one], self._normals[face[one]]

    def _at_least(self, points: Array, face: Array) -> Array:
        """(K,) lower bounds of the distance of points (K, 3) from triangles (K,): that of the disc around each."""
        centre, size = self._discs
        away = points - centre[face]
        above = (away * self._normals[face]).sum(1) ** 2
        beside = np.sqrt(np.maximum((away**2).sum(1) - above, 0.0)) - size[face]
        return np.asarray(np.sqrt(above + np.maximum(beside, 0.0) ** 2))

    def _places(self, points: Array, face: Array) -> tuple[Array, Array]:
        """Nearest points (K, 3) of triangles (K,) to points (K, 3), and their distance: on one of the sides, but where
        the foot of the perpendicular lies between them."""
        sides, squares, into = self._sides
        corner, side = self._cut[face], sides[face]
        away = points[:, None] - corner
        share = np.clip((away * side).sum(2) / squares[face], 0.0, 1.0)
        on_sides = corner + share[..., None] * side
        gap = ((points[:, None] - on_sides) ** 2).sum(2)
        row = np.arange(len(face))
        place = on_sides[row, gap.argmin(1)]
        above = ((away * into[face]).sum(2) >= 0).all(1) & self._flat[face]
        normal = self._normals[face[above]]
        place[above] = points[above] - normal * (away[above, 0] * normal).sum(1)[:, None]
        return place, np.linalg.norm(points - place, axis=1)
