"""Distance of many points from a surface of triangles, with a sign for a closed surface.

Candidate triangles come from a tree of their centres, after long triangles are cut. The side of a point follows from
its winding number, the number of times that the surface encloses it. A ray from the point counts 1 for every crossing
that leaves the surface and -1 for every one that enters it. The sum is 1 in a body, 0 outside and in its cavities, and
2 where two bodies overlap. Unlike the normal of the nearest triangle, it is correct for intersecting and nested
surfaces.

A ray through an edge or a corner is treated as a neighbouring ray, by the same rule for all triangles there (simulation
of simplicity, Edelsbrunner and Muecke 1990). If round-off may decide, another direction is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
import scipy

from ..errors import InputError
from ..typing import Array, Index, Mask
from .distance_field import UP
from .obstacles import unit_vectors

_ANGLES = [0.7, 0.4, 1.1], [2.3, 0.5, 0.2], [1.2, 2.9, 0.8]


@lru_cache(maxsize=1)
def ray_axes() -> Array:
    """Axes of rays (3, 3, 3), used one after the other: many surfaces have edges along the coordinate axes."""
    return np.asarray(scipy.spatial.transform.Rotation.from_euler("xyz", _ANGLES).as_matrix())


# Area over the squared size of the surface below which round-off may decide on which side of an edge a ray passes.
AREA_ROUND_OFF = 1e-13

# Largest number of columns of the lookup table along each side: a ray then meets a few triangles, and the table has at
# most 260,000 entries.
MAX_COLUMNS = 512


class TriangleGrid(NamedTuple):
    """Columns of the lookup table, perpendicular to the rays."""

    low: Array
    """Start of the first column (2,), m."""
    width: Array
    """Widths of a column (2,), m."""
    side: int
    """Number of columns along each side."""


class Sides(NamedTuple):
    """Sides of triangles, projected along the rays, directed from the smaller to the larger corner number.

    So two triangles compute the same numbers for a common side.
    """

    start: Array
    """Starts (f, 3, 2) of the sides of triangles in a plane, m."""
    end: Array
    """Ends (f, 3, 2) of the sides of triangles in a plane, m."""
    sense: Array
    """1, or -1 for a side against the orientation of its triangle; shape (f, 3)."""


@dataclass(frozen=True, eq=False)
class Rays:
    """Surface with the corners (f, 3, 3) of its triangles, m, in axes with the third along parallel rays."""

    corners: Array

    @cached_property
    def _grid(self) -> TriangleGrid:
        flat = self.corners[..., :2].reshape(-1, 2)
        count = int(np.clip(np.sqrt(len(self.corners)), 1, MAX_COLUMNS))
        return TriangleGrid(flat.min(0), np.maximum(np.ptp(flat, axis=0), 1e-300) / count, count)

    @cached_property
    def _columns(self) -> tuple[Index, Index]:
        """List of the triangles sorted by column, preceded by the start of every column in it (columns + 1,)."""
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
    def _sides(self) -> Sides:
        start = self.corners[..., :2]
        end = np.roll(start, -1, axis=1)
        back = (start[..., 0] > end[..., 0]) | ((start[..., 0] == end[..., 0]) & (start[..., 1] > end[..., 1]))
        swap = back[..., None]
        return Sides(np.where(swap, end, start), np.where(swap, start, end), np.where(back, -1.0, 1.0))

    def winding(self, points: Array) -> tuple[Array, Mask]:
        """Winding numbers (N,) of points (N, 3), and a mask (N,) of those that round-off may have decided."""
        low, width, count = self._grid
        cell = np.floor((points[:, :2] - low) / width).astype(int)
        inside = ((cell >= 0) & (cell <= count)).all(1)
        column = np.clip(cell[:, 1], 0, count - 1) * count + np.clip(cell[:, 0], 0, count - 1)
        starts, faces = self._columns
        each = np.where(inside, starts[column + 1] - starts[column], 0)
        row = np.repeat(np.arange(len(points)), each)
        face = faces[np.arange(len(row)) + np.repeat(starts[column] - np.cumsum(each) + each, each)]
        start, end, sense = (table[face] for table in self._sides)
        side, away = end - start, points[row, None, :2] - start
        area = side[..., 0] * away[..., 1] - side[..., 1] * away[..., 0]
        left = np.where(area >= 0, sense, -sense)  # a ray through a side counts as left of it
        hit = np.abs(left.sum(1)) == 3
        size = float(np.ptp(self.corners.reshape(-1, 3), axis=0).max())
        doubtful = (np.abs(area) <= AREA_ROUND_OFF * size**2).any(1)
        row_doubtful = np.bincount(row[doubtful], minlength=len(points)) > 0
        row, face, weight = row[hit], face[hit], np.roll((sense * area)[hit], -1, axis=1)
        height = (weight * self.corners[face, :, 2]).sum(1) / weight.sum(1)
        crossed = np.where(height > points[row, 2], left[hit, 0], 0.0)
        return np.asarray(np.bincount(row, crossed, len(points)), dtype=float), row_doubtful


def winding_number(rays: list[Rays], points: Array) -> Array:
    """Winding numbers (N,) of points (N, 3) in a surface, given by its rays from `rays_of`."""
    out, open_rows = np.zeros(len(points)), np.arange(len(points))
    for direction, surface in zip(ray_axes(), rays, strict=True):
        out[open_rows], doubtful = surface.winding(_rotated(points[open_rows], direction))
        open_rows = open_rows[doubtful]
        if not len(open_rows):
            break
    return out


def rays_of(corners: Array) -> list[Rays]:
    """Surface of triangles (f, 3, 3) in all `ray_axes`."""
    return [Rays(_rotated(corners, direction)) for direction in ray_axes()]


def _rotated(points: Array, axes: Array) -> Array:
    """Coordinates of points (..., 3) along axes (3, 3).

    Computed without matrix products, whose sums depend on the position in the array: equal points must remain equal.
    """
    x, y, z = np.moveaxis(points, -1, 0)
    return np.stack([x * axis[0] + y * axis[1] + z * axis[2] for axis in axes], axis=-1)


# Size of the body over the longest allowed edge: triangles of similar size need few candidates.
EDGES_PER_SIZE = 6

# Number of the first candidate triangles, whose distance bounds the search of others.
FIRST_CANDIDATES = 3

# Number of points per chunk, which bounds the memory.
CHUNK = 4096

# Tolerance over the size of the body within which triangles are equally near: at an edge or corner the distances of
# both neighbours differ by round-off.
TIE = 1e-9

# Distance (m) up to which a point is on the surface.
ON = 1e-12

# Height of a triangle over its longest side below which it counts as that side: its normal would be round-off.
THIN = 1e-12


def bisected(corners: Array, longest: float) -> Array:
    """Cut triangles (f, 3, 3) across their longest sides until none is longer than `longest`, m."""
    short = []
    while len(corners):
        side = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        long = side.max(1) > longest
        short.append(corners[~long])
        order = (side.argmax(1)[long, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(np.take_along_axis(corners[long], order[..., None], axis=1), 1, 0)
        middle = (a + b) / 2
        corners = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate([corners, *short])


def oriented(vertices: Array, faces: Index) -> Index:
    """Orient the faces (f, 3) of closed surfaces so that their normals point out of the bodies.

    Two faces share every edge. Neighbours are made consistent by the majority of each body. The largest body is not a
    cavity. Another body is one if its orientation is opposite and its box lies within that of another body.

    Raises:
        InputError: a one-sided surface, as a Moebius strip.
    """
    count, faces = len(faces), np.array(faces)
    edges = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    pairs = np.lexsort(np.sort(edges, axis=1).T).reshape(-1, 2)
    first, second = pairs.T // 3
    forward = (edges[:, 0] < edges[:, 1])[pairs]
    # Consistent neighbours run along their common edge in opposite directions.
    differ = count * (forward[:, 0] == forward[:, 1])
    # Nodes of the graph: every face, and, shifted by `count`, every face flipped.
    rows, columns = np.concatenate([first, first + count]), np.concatenate([second + differ, second + count - differ])
    graph = scipy.sparse.coo_array((np.ones(len(rows), dtype=bool), (rows, columns)), shape=(2 * count, 2 * count))
    _, part = scipy.sparse.csgraph.connected_components(graph, directed=False)
    if (part[:count] == part[count:]).any():
        raise InputError("the mesh is a one-sided surface; it must have an inside and an outside")
    _, body = np.unique(np.minimum(part[:count], part[count:]), return_inverse=True)
    flipped = part[:count] > part[count:]
    flipped ^= (np.bincount(body, flipped) > np.bincount(body) / 2)[body]
    faces[flipped] = faces[flipped, ::-1]
    a, b, c = np.moveaxis(vertices[faces] - vertices[faces[:, 0]].mean(0), 1, 0)
    volume = np.bincount(body, (a * np.cross(b, c)).sum(1))
    against = volume * np.sign(volume[np.abs(volume).argmax()]) < 0
    low, high = np.full((len(volume), 3), np.inf), np.full((len(volume), 3), -np.inf)
    for corner in (a, b, c):
        np.minimum.at(low, body, corner)
        np.maximum.at(high, body, corner)
    outer_low, outer_high = low[~against], high[~against]
    cavity = against.copy()
    for k in np.flatnonzero(against):
        cavity[k] = ((outer_low < low[k]) & (outer_high > high[k])).all(1).any()
    inwards = ((volume > 0) == cavity)[body]
    faces[inwards] = faces[inwards, ::-1]
    return faces


def _areas(corners: Array) -> Array:
    """Twice the areas (f,) of triangles (f, 3, 3), m^2."""
    square = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(np.linalg.norm(square, axis=1))


class SideVectors(NamedTuple):
    """Vectors along the sides of triangles."""

    side: Array
    """Vectors along the sides (f, 3, 3), m."""
    square: Array
    """Squared lengths (f, 3), m^2."""
    inward: Array
    """Vectors perpendicular to the sides, into the triangle (f, 3, 3)."""


class NearestPoints(NamedTuple):
    """Nearest points of a surface."""

    distance: Array
    """Distances (N,), m; negative inside a closed surface."""
    point: Array
    """Nearest points (N, 3), m."""
    normal: Array
    """Normals of their triangles (N, 3)."""


@dataclass(frozen=True, eq=False)
class Triangles:
    """Surface of triangles with corners (f, 3, 3), m."""

    corners: Array
    closed: bool = True
    """True if the surface bounds a body, with normals outwards; the distance from an open surface has no sign."""
    hollow: bool = False
    """True if the body is everything that the closed surface does not enclose."""

    @cached_property
    def size(self) -> float:
        """Longest side of the bounding box, m."""
        return float(np.ptp(self.corners.reshape(-1, 3), axis=0).max())

    @cached_property
    def _cut(self) -> Array:
        """Corners of the surface with smaller triangles."""
        corners = bisected(self.corners, max(self.size / EDGES_PER_SIZE, 1e-12))
        # A triangle without area is redundant in a closed surface. An open one may consist of it.
        return corners if not self.closed else np.asarray(corners[_areas(corners) > 0])

    @cached_property
    def _normals(self) -> Array:
        """Unit normals (f, 3); 0 for a triangle without area, which may have a disc of any orientation."""
        a, b, c = (self._cut[:, k] for k in range(3))
        normal: Array = np.cross(b - a, c - a)
        return np.where(self._flat[:, None], unit_vectors(normal, np.zeros(3)), 0.0)

    @cached_property
    def _flat(self) -> Mask:
        """Mask (f,) of the triangles with an area."""
        side = np.linalg.norm(np.roll(self._cut, -1, axis=1) - self._cut, axis=2).max(1)
        return np.asarray(_areas(self._cut) > THIN * side**2)

    @cached_property
    def _discs(self) -> tuple[Array, Array]:
        """Discs around the triangles: centres (f, 3) and radii (f,), m."""
        centre = self._cut.mean(1)
        return centre, np.linalg.norm(self._cut - centre[:, None], axis=2).max(1)

    @cached_property
    def _tree(self) -> tuple[Any, float]:
        """Tree of the centres, and the largest radius of a disc, m."""
        centre, size = self._discs
        return scipy.spatial.cKDTree(centre), float(size.max())

    @cached_property
    def _sides(self) -> SideVectors:
        side = np.roll(self._cut, -1, axis=1) - self._cut
        square = np.maximum((side**2).sum(-1), np.finfo(float).tiny)
        return SideVectors(side, square, np.cross(self._normals[:, None], side))

    @cached_property
    def _rays(self) -> list[Rays]:
        return rays_of(self.corners)

    def signed_distance(self, points: Array) -> Array:
        """Distances (N,) of points (N, 3), m; negative inside a closed surface."""
        return self.nearest(points).distance

    def nearest(self, points: Array) -> NearestPoints:
        """Nearest points of the surface to points (N, 3), m."""
        parts = [self._chunk(points[k : k + CHUNK]) for k in range(0, len(points), CHUNK)]
        empty = NearestPoints(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)))
        return NearestPoints(*(np.concatenate(each) for each in zip(empty, *parts, strict=True)))

    def gradient(self, points: Array) -> Array:
        """Gradients (N, 3) of the distance of points (N, 3): on the surface its normals.

        If several points of the surface are equally near, the gradient belongs to one of them.
        """
        distance, nearest, normal = self.nearest(points)
        far = np.abs(distance)[:, None] > ON
        at = unit_vectors(normal, UP)
        return np.asarray(np.where(far, (points - nearest) / np.where(far, distance[:, None], 1.0), at))

    def _chunk(self, points: Array) -> NearestPoints:
        """Nearest points of the surface for a chunk of points (N, 3): candidates by bounds, then exact distances."""
        tree, radius = self._tree
        # An upper bound of the distance from a few triangles with near centres.
        count = min(FIRST_CANDIDATES, len(self._cut))
        first = np.asarray(tree.query(points, k=count)[1]).reshape(len(points), count)
        _, distance = self._nearest_of(np.repeat(points, count, axis=0), first.ravel())
        bound = distance.reshape(-1, count).min(1)
        # All triangles whose disc is not farther than the bound.
        tie = TIE * self.size
        candidates = tree.query_ball_point(points, bound + radius + tie)
        row = np.repeat(np.arange(len(points)), [len(each) for each in candidates])
        face = np.concatenate([np.asarray(each, dtype=int) for each in candidates])
        near = self._disc_distance(points[row], face) <= bound[row] + tie
        row, face = row[near], face[near]
        point, distance = self._nearest_of(points[row], face)
        # Rows are sorted, and every row has a triangle.
        first = np.searchsorted(row, np.arange(len(points)))
        smallest = np.minimum.reduceat(distance, first)
        nearest = np.flatnonzero(distance <= smallest[row])
        one = nearest[np.searchsorted(row[nearest], np.arange(len(points)))]
        if self.closed:
            # Overlapping bodies are one, and a cavity is no part of its body.
            inside = (winding_number(self._rays, points) != 0) ^ self.hollow
            smallest = np.where(inside, -smallest, smallest)
        return NearestPoints(smallest, point[one], self._normals[face[one]])

    def _disc_distance(self, points: Array, face: Array) -> Array:
        """Lower bounds (K,) of the distances of points (K, 3) from triangles (K,), m: distances from their discs."""
        centre, size = self._discs
        away = points - centre[face]
        above = (away * self._normals[face]).sum(1) ** 2
        lateral = np.sqrt(np.maximum((away**2).sum(1) - above, 0.0)) - size[face]
        return np.asarray(np.sqrt(above + np.maximum(lateral, 0.0) ** 2))

    def _nearest_of(self, points: Array, face: Array) -> tuple[Array, Array]:
        """Nearest points (K, 3) of triangles (K,) to points (K, 3), and their distances (K,), m."""
        corner, side = self._cut[face], self._sides.side[face]
        away = points[:, None] - corner
        t = np.clip((away * side).sum(2) / self._sides.square[face], 0.0, 1.0)
        on_sides = corner + t[..., None] * side
        squared = ((points[:, None] - on_sides) ** 2).sum(2)
        nearest = on_sides[np.arange(len(face)), squared.argmin(1)]
        # The foot of the perpendicular is nearer, if it lies in the triangle.
        above = ((away * self._sides.inward[face]).sum(2) >= 0).all(1) & self._flat[face]
        normal = self._normals[face[above]]
        nearest[above] = points[above] - normal * (away[above, 0] * normal).sum(1)[:, None]
        return nearest, np.linalg.norm(points - nearest, axis=1)
