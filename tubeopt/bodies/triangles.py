"""Distance from a surface of triangles, for many points at once; of a closed surface it has a sign.

Which triangles to ask is found with a tree of their centres, after the long ones are cut. On which side a point lies
follows from the winding number: how often the surface goes around the point. A ray from the point crosses the surface;
each crossing counts 1 where the surface is left and -1 where it is entered. The sum is 1 in a body, 0 outside and in
its cavities, and 2 where two bodies overlap. Unlike the normal of the nearest triangle it is right where surfaces cross
each other or lie within one another.

A ray through an edge or a corner is taken for one beside it, by the same rule for all triangles there (simulation of
simplicity, Edelsbrunner and Muecke 1990). Where round-off may decide, another direction is taken.
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

_ANGLES = [0.7, 0.4, 1.1], [2.3, 0.5, 0.2], [1.2, 2.9, 0.8]
# (3, 3, 3) axes of rays, asked one after the other: none are those along which many surfaces have edges.
DIRECTIONS = scipy.spatial.transform.Rotation.from_euler("xyz", _ANGLES).as_matrix()

# Share of the square of the size below which round-off may decide on which side of an edge a ray passes.
ROUND_OFF = 1e-13

# Columns in which triangles are looked up, along either side: a ray then meets a few triangles, and the table has
# 260,000 entries at most.
MOST_COLUMNS = 512


@dataclass(frozen=True, eq=False)
class Rays:
    """A surface as parallel rays see it: corners (f, 3, 3) of its triangles, the third coordinate along the rays."""

    corners: Array

    @cached_property
    def _grid(self) -> tuple[Array, Array, int]:
        """Where columns begin (2,), their widths (2,), and how many there are along either side."""
        flat = self.corners[..., :2].reshape(-1, 2)
        low, count = flat.min(0), int(np.clip(np.sqrt(len(self.corners)), 1, MOST_COLUMNS))
        return low, np.maximum(np.ptp(flat, axis=0), 1e-300) / count, count

    @cached_property
    def _columns(self) -> tuple[Index, Index]:
        """Where the triangles of every column begin in a list (columns + 1,), and that list."""
        low, width, count = self._grid
        flat = self.corners[..., :2]
        first, last = (
            np.clip(np.floor((ends - low) / width).astype(int), 0, count - 1) for ends in (flat.min(1), flat.max(1))
        )
        spans = last - first + 1
        each = spans.prod(1)
        face = np.repeat(np.arange(len(each)), each)
        step = np.arange(len(face)) - np.repeat(np.cumsum(each) - each, each)
        x, y = first[face, 0] + step % spans[face, 0], first[face, 1] + step // spans[face, 0]
        column = y * count + x
        order = np.argsort(column, kind="stable")
        return np.searchsorted(column[order], np.arange(count * count + 1)), face[order]

    @cached_property
    def _sides(self) -> tuple[Array, Array, Array]:
        """Of every triangle, where its three sides begin and end (f, 3, 2), each from the lesser to the greater corner,
        so that two triangles compute the same of a side that they share; and 1, or -1 where that turns it (f, 3)."""
        begin = self.corners[..., :2]
        end = np.roll(begin, -1, axis=1)
        back = (begin[..., 0] > end[..., 0]) | ((begin[..., 0] == end[..., 0]) & (begin[..., 1] > end[..., 1]))
        return np.where(back[..., None], end, begin), np.where(back[..., None], begin, end), np.where(back, -1.0, 1.0)

    def winding(self, points: Array) -> tuple[Array, Mask]:
        """(N,) how often the surface goes around points (N, 3), and where round-off may have decided."""
        low, width, count = self._grid
        places = np.floor((points[:, :2] - low) / width).astype(int)
        seen = ((places >= 0) & (places <= count)).all(1)
        column = np.clip(places[:, 1], 0, count - 1) * count + np.clip(places[:, 0], 0, count - 1)
        starts, faces = self._columns
        each = np.where(seen, starts[column + 1] - starts[column], 0)
        row = np.repeat(np.arange(len(points)), each)
        face = faces[np.arange(len(row)) + np.repeat(starts[column] - np.cumsum(each) + each, each)]
        begin, end, sense = (table[face] for table in self._sides)
        side, away = end - begin, points[row, None, :2] - begin
        area = side[..., 0] * away[..., 1] - side[..., 1] * away[..., 0]
        left = np.where(area >= 0, sense, -sense)  # a ray through a side passes to the left of it
        hit = np.abs(left.sum(1)) == 3
        size = float(np.ptp(self.corners.reshape(-1, 3), axis=0).max())
        doubtful = (np.abs(area) <= ROUND_OFF * size**2).any(1)
        row_doubtful = np.bincount(row[doubtful], minlength=len(points)) > 0
        row, face, weight = row[hit], face[hit], np.roll((sense * area)[hit], -1, axis=1)
        height = (weight * self.corners[face, :, 2]).sum(1) / weight.sum(1)
        crossed = np.where(height > points[row, 2], left[hit, 0], 0.0)
        return np.asarray(np.bincount(row, crossed, len(points)), dtype=float), row_doubtful


def winding_number(rays: list[Rays], points: Array) -> Array:
    """(N,) winding numbers at points (N, 3) of a surface as `seen_along` has it."""
    out, asked = np.zeros(len(points)), np.arange(len(points))
    for direction, seen in zip(DIRECTIONS, rays, strict=True):
        out[asked], doubtful = seen.winding(_turned(points[asked], direction))
        asked = asked[doubtful]
        if not len(asked):
            break
    return out


def seen_along(corners: Array) -> list[Rays]:
    """A surface of triangles (f, 3, 3), by the rays of all DIRECTIONS."""
    return [Rays(_turned(corners, direction)) for direction in DIRECTIONS]


def _turned(points: Array, axes: Array) -> Array:
    """Points (..., 3) by their coordinates along axes (3, 3), number by number: equal points stay equal to the last
    digit, wherever they stand."""
    x, y, z = np.moveaxis(points, -1, 0)
    return np.stack([x * axis[0] + y * axis[1] + z * axis[2] for axis in axes], axis=-1)


# Edges are cut to the longest side of the body over this, so that triangles are of similar size.
FINEST = 6

# Triangles that are asked first; their distance tells which others can be nearer.
FIRST = 3

# Points at once: bounds the memory.
CHUNK = 4096

# Triangles are equally near within this fraction of the size of the body: at an edge or corner both neighbours are,
# to round-off.
TIE = 1e-9

# Distance (m) up to which a point is on the surface.
ON = 1e-12

# Height of a triangle over its longest side up to which it counts as that side: its normal would be round-off.
THIN = 1e-12


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
