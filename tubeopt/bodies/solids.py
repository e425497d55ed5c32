"""Distance fields of triangle meshes and point clouds.

The samples of a surface are the corners of its triangles after these are cut to sides of at most e. Let p be the point
of the surface nearest to x. On its face, side or corner, to which x - p is perpendicular, a sample lies within
r = e/sqrt(3) of p. So the distance d of x and the distance D of its nearest sample satisfy D^2 <= d^2 + r^2. Nodes near
the surface have exact distances, all others this bound. The sign of a region that no surface crosses is computed once.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.util import find_spec
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..errors import InputError, choice, positive
from ..typing import Array
from .corridors import MeshObstacle, open_surface
from .distance_field import UP, DistanceField
from .frames import Frame
from .obstacles import unit_vectors
from .triangles import Triangles, bisected

LOGGER = logging.getLogger(__name__)

# Sides of a closed surface on which the arm may stay.
KEEP = ("out", "in")

# Default number of nodes, for a few seconds of computation and 3 MB.
MAX_NODES = 400_000

# Default size (m) of cells, if it does not need too many nodes.
DEFAULT_CELL = 5e-4

# Number of nodes around the body, or around the lumen.
BORDER = {"out": 10, "in": 2}

# Distance from the surface, in cells, below which nodes have exact distances: in cells that the surface crosses and in
# their neighbours.
BAND = 2.0

# Radius r of the samples, and distance below which the next finer samples are used, in cells.
SAMPLING = ((1.0, 8.0), (0.5, 0.0))

# Error of the surface of a union over the size of the bodies; distances are reduced by it.
UNION_ROUND_OFF = 1e-9

# Largest number of samples of a surface.
MAX_SAMPLES = 2_000_000

# Largest number of cells along a side.
MAX_CELLS = 1_000


def field_of_mesh(
    mesh: MeshObstacle, *, keep: str = "out", cell: float | None = None, name: str = "mesh"
) -> DistanceField:
    """Distance field of the body in a closed mesh, or of the distance from the triangles of an open one.

    Args:
        keep: "out": the arm stays outside; "in": it stays inside, and the body is everything outside of the mesh.
        cell: size of the cells, m; by default 0.5 mm, or more for a large body.

    Raises:
        InputError: a cell that is not greater than 0, or far too small; keep "in" for an open mesh.
    """
    choice("keep", keep, KEEP)
    if keep == "in" and not mesh.closed:
        raise InputError(
            f"{name}: the surface bounds no body: {mesh.opened_by}. It has no inside to stay in; repair the "
            "surface, or give keep: out, and the arm keeps clear of its triangles"
        )
    inner = union_surface(mesh.surface.corners) if keep == "in" else None
    corners = mesh.surface.corners if inner is None else inner
    surface = Triangles(corners, mesh.closed, hollow=keep == "in")
    return _field(
        surface,
        0.0 if inner is None else UNION_ROUND_OFF * surface.size,
        BORDER[keep],
        cell,
        name=name,
        stands_for="" if mesh.closed else open_surface(name, len(mesh.faces)),
    )


def union_surface(corners: Array) -> Array | None:
    """Surface (g, 3, 3) of the union of overlapping bodies with surfaces (f, 3, 3), m.

    Without it, surfaces inside another body would be walls between the bodies. None if no bodies overlap, if one is a
    cavity, or if manifold3d is not installed or fails.
    """
    if find_spec("manifold3d") is None:
        return None
    vertices, number = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    faces = number.reshape(-1, 3)
    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = scipy.sparse.coo_array((np.ones(len(edges)), edges.T), shape=(len(vertices),) * 2)
    count, part = scipy.sparse.csgraph.connected_components(graph, directed=False)
    body = part[faces[:, 0]]
    a, b, c = np.moveaxis(corners - corners.mean((0, 1)), 1, 0)
    volume = np.bincount(body, (a * np.cross(b, c)).sum(1), count)
    boxes = [(corners[body == k].min((0, 1)), corners[body == k].max((0, 1))) for k in range(count)]
    pairs = combinations(boxes, 2)
    if (volume <= 0).any() or not any((np.maximum(p[0], q[0]) < np.minimum(p[1], q[1])).all() for p, q in pairs):
        return None
    manifold3d = import_module("manifold3d")
    solids = [
        manifold3d.Manifold(manifold3d.Mesh64(vertices, faces[body == k].astype(np.uint64))) for k in range(count)
    ]
    union = manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add)
    if union.status() != manifold3d.Error.NoError or union.is_empty():
        return None
    mesh = union.to_mesh64()
    return np.asarray(np.asarray(mesh.vert_properties)[:, :3][np.asarray(mesh.tri_verts).astype(int)])


def field_of_surface(
    mesh: MeshObstacle, radius: float, *, cell: float | None = None, name: str = "surface"
) -> DistanceField:
    """Distance field of the points within `radius`, m, of the triangles of a mesh, open or closed.

    Raises:
        InputError: a radius that is not greater than 0; a cell that is not, or is far too small.
    """
    positive(f"radius of {name}", radius)
    stands_for = f"{open_surface(name, len(mesh.faces))}; it counts as {radius * 1e3:g} mm thick to either side"
    surface = Triangles(mesh.surface.corners, False)
    return _field(surface, radius, BORDER["out"], cell, name=name, stands_for=stands_for)


def _field(
    surface: Triangles, radius: float, border: int, cell: float | None, *, name: str, stands_for: str
) -> DistanceField:
    """Distance field of a surface, its distances reduced by a radius, with `border` nodes around it."""
    corners = surface.corners.reshape(-1, 3)
    ends = corners if not radius else np.concatenate([corners - radius, corners + radius])
    lattice = _lattice(ends, cell, name, border)
    moved = replace(surface, corners=surface.corners - lattice.origin)
    lower, upper = _bounds(moved.corners, lattice.nodes, lattice.size)
    near = lower < BAND * lattice.size
    exact = moved.signed_distance(lattice.nodes[near])
    # No surface crosses the line between neighbours that are farther from it than half a cell.
    parts, count = scipy.ndimage.label(~near.reshape(lattice.shape))
    part, node = np.unique(parts.ravel(), return_index=True)
    outside = np.ones(count + 1, dtype=bool)
    outside[part] = moved.signed_distance(lattice.nodes[node]) > 0
    values = np.where(outside[parts.ravel()], lower, -upper)
    values[near] = exact
    return DistanceField(
        values.reshape(lattice.shape) - radius,
        np.full(3, lattice.size),
        Frame(origin=lattice.origin),
        node_error=float((upper - lower)[~near].max(initial=0.0)),
        bounded=border == BORDER["out"],
        name=name,
        source=moved,
        stands_for=stands_for,
    )


@dataclass(frozen=True, eq=False)
class Centres:
    """Balls of one radius, given by the tree of their centres, m."""

    tree: Any

    def gradient(self, points: Array) -> Array:
        """Gradients (N, 3) of the distance at points (N, 3): away from the nearest centre."""
        return unit_vectors(points - self.tree.data[self.tree.query(points)[1]], UP)


def field_of_points(
    points: ArrayLike, radius: float, *, cell: float | None = None, name: str = "cloud"
) -> DistanceField:
    """Distance field of balls of one radius, m, around points (N, 3).

    Raises:
        InputError: no points, numbers that are not finite, a radius that is not greater than 0.
    """
    positive(f"radius of {name}", radius)
    array = np.asarray(points, dtype=float)
    if array.ndim != 2 or array.shape[1] != 3 or not len(array):
        raise InputError(f"{name} has no points; it must be a table of x, y, z")
    if not np.isfinite(array).all():
        raise InputError(f"{name} has points that are NaN or infinite; every number must be finite")
    ends = np.concatenate([array - radius, array + radius])
    lattice = _lattice(ends, cell, name, BORDER["out"])
    tree = scipy.spatial.cKDTree(array - lattice.origin)
    distance, _ = tree.query(lattice.nodes)
    return DistanceField(
        distance.reshape(lattice.shape) - radius,
        np.full(3, lattice.size),
        Frame(origin=lattice.origin),
        bounded=True,
        name=name,
        source=Centres(tree),
        stands_for=_points_as_text(array, radius, name),
    )


def _points_as_text(points: Array, radius: float, name: str) -> str:
    """Text that says from what distances are measured: balls around points. Warns if an arm may pass between them."""
    balls = f"the {len(points)} points of {name}, each a ball of {radius * 1e3:g} mm"
    gap = largest_gap(points)
    if gap is None:
        return f"{balls}; how far neighbours are apart was not computed, and nothing is proved between points"
    # Balls that touch each other close a line; a square of points needs 0.71 of its side. The largest gap of a tree
    # cannot exclude wider holes.
    if gap > radius:
        LOGGER.warning(
            f"{name}: neighbouring points are up to {gap * 1e3:.3g} mm apart, so the arm may pass between balls of "
            f"radius {radius * 1e3:g} mm, and nothing is proved there; give a file with faces, or more points"
        )
    return f"{balls}; the largest gap between neighbours is {gap * 1e3:.3g} mm, and nothing is proved between points"


class Lattice(NamedTuple):
    """Nodes of a distance field."""

    nodes: Array
    """Positions (N, 3) relative to the first node, m."""
    shape: tuple[int, ...]
    """Number of nodes along x, y and z."""
    size: float
    """Spacing, m."""
    origin: Array
    """Position of the first node (3,), m."""


def _lattice(points: Array, cell: float | None, name: str, border: int) -> Lattice:
    """Lattice around points, with `border` nodes on every side."""
    low, high = points.min(0), points.max(0)
    extent = np.maximum(high - low, 1e-6)
    min_size = float((extent.prod() / MAX_NODES) ** (1 / 3))
    size = max(DEFAULT_CELL, min_size) if cell is None else positive(f"cell of {name}", cell)
    count = np.ceil(extent / size).astype(int) + 2 * border + 1
    if count.max() > MAX_CELLS or count.prod() > 20 * MAX_NODES:
        larger = 1.1 * size * max(count.max() / MAX_CELLS, (count.prod() / (20 * MAX_NODES)) ** (1 / 3))
        raise InputError(
            f"{name} would have {' x '.join(map(str, count))} cells of {size * 1e3:g} mm; give cell_mm of at least "
            f"{larger * 1e3:.2g}"
        )
    nodes = np.moveaxis(np.indices(count), 0, -1).reshape(-1, 3) * size
    return Lattice(nodes, tuple(count.tolist()), size, (low + high) / 2 - (count - 1) / 2 * size)


def _bounds(corners: Array, nodes: Array, size: float) -> tuple[Array, Array]:
    """Lower and upper bounds (N,) of the distances of nodes (N, 3) from triangles (f, 3, 3), m.

    Coarser samples are enough for farther nodes: the difference of the bounds decreases with the distance.
    """
    lower, upper, rows = np.zeros(len(nodes)), np.zeros(len(nodes)), np.arange(len(nodes))
    for radius, finer_below in SAMPLING:
        samples, r = _samples(corners, radius * size)
        upper[rows], _ = scipy.spatial.cKDTree(samples).query(nodes[rows])
        lower[rows] = np.sqrt(np.maximum(upper[rows] ** 2 - r**2, 0.0))
        rows = rows[upper[rows] < finer_below * size]
    return lower, upper


def _samples(corners: Array, radius: float) -> tuple[Array, float]:
    """Samples (k, 3) of a surface of triangles (f, 3, 3), and their radius r, at least `radius`, m."""
    square = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = float(np.linalg.norm(square, axis=1).sum() / 2)
    side = np.sqrt(3) * max(radius, float(np.sqrt(area / MAX_SAMPLES)))
    points = bisected(corners, side).reshape(-1, 3)
    points = points[np.lexsort(points.T)]
    new = np.append(True, (points[1:] != points[:-1]).any(1))
    return points[new], float(side / np.sqrt(3))


# Number of neighbours of each point for the spanning tree: for points on a surface, nearly all of its edges are among
# them.
NEIGHBOURS = 8

# Largest number of distances that are computed to join separate parts.
MAX_DISTANCES = 200_000_000


def largest_gap(points: Array) -> float | None:
    """Smallest step length, m, that connects all points (N, 3), or slightly more; 0 for one point.

    The spanning tree is built from the nearest neighbours of each point; separate parts are joined at their nearest
    points. None if that takes too long.
    """
    points = np.unique(points, axis=0)
    if len(points) < 2:
        return 0.0
    count = min(NEIGHBOURS + 1, len(points))
    tree = scipy.spatial.cKDTree(points)
    distance, neighbour = (each[:, 1:] for each in tree.query(points, k=count))
    row = np.repeat(np.arange(len(points)), count - 1)
    graph = scipy.sparse.csr_array((distance.ravel(), (row, neighbour.ravel())), shape=(len(points),) * 2)
    longest = float(scipy.sparse.csgraph.minimum_spanning_tree(graph).data.max())
    _, part = scipy.sparse.csgraph.connected_components(graph, directed=False)
    computed = 0
    while (size := np.bincount(part)).size and (size > 0).sum() > 1:
        smallest = int(np.where(size > 0, size, len(points) + 1).argmin())
        members = part == smallest
        computed += len(points)
        if computed > MAX_DISTANCES:
            return None
        separation = np.asarray(scipy.spatial.cKDTree(points[members]).query(points[~members])[0])
        nearest = int(np.argmin(separation))
        longest = max(longest, float(separation[nearest]))
        part[members] = part[~members][nearest]
    return longest
