"""Surfaces of triangles and clouds of points as distance fields.

Samples of a surface, the corners of its triangles after these were cut to sides of at most e, lie within r = e/sqrt(3)
of every point p of it that is the nearest to some x, on the same face, side or corner, to which x - p is square: the
distance d of x and that of the nearest sample, D, keep D^2 <= d^2 + r^2. Nodes near the surface are told exactly, all
others by that bound; and which side they are on by a way to another node that no surface can cross.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.util import find_spec
from itertools import combinations
from typing import Any

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

# Ways to keep to a closed surface.
KEEP = ("out", "in")

# Nodes of a field by default, which take some seconds to compute and 3 MB.
MOST_NODES = 400_000

# Size (m) of cells by default where that does not take too many nodes.
FINEST = 5e-4

# Nodes beside the body, or beside the way within it.
AROUND = {"out": 10, "in": 2}

# Sizes of a cell from the surface up to which distances at nodes are exact: cells that the surface crosses and their
# neighbours.
BAND = 2.0

# Sizes r of the uncovered parts between samples, and distances below which finer samples are asked, by that of a
# cell.
COVERED = ((1.0, 8.0), (0.5, 0.0))

# Share of the size of bodies by which the surface of their union may be off: distances are less by it.
ROUND_OFF = 1e-9

# Samples of a surface at most.
MOST_SAMPLES = 2_000_000

# Cells along a side at most.
LARGEST = 1_000


def field_of_mesh(
    mesh: MeshObstacle, *, keep: str = "out", cell: float | None = None, name: str = "mesh"
) -> DistanceField:
    """The distance field of the body that a closed mesh bounds, or with keep "in" of all that it does not hold: the
    arm then stays within it. Of an open mesh it is that of the distance from its triangles.

    Args:
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
    said = "" if mesh.closed else open_surface(name, len(mesh.faces))
    inner = united(mesh.surface.corners) if keep == "in" else None
    corners = mesh.surface.corners if inner is None else inner
    surface = Triangles(corners, mesh.closed, hollow=keep == "in")
    return _field(surface, 0.0 if inner is None else ROUND_OFF * surface.size, AROUND[keep], cell, (name, said))


def united(corners: Array) -> Array | None:
    """(g, 3, 3) corners of the surface of the union of overlapping bodies, of the corners (f, 3, 3) of their surfaces;
    None where no bodies overlap, where one is a cavity, and where manifold3d is not installed or fails.

    Surfaces inside another body would else be walls: nothing would pass from one body to the next.
    """
    if find_spec("manifold3d") is None:
        return None
    places, number = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    faces = number.reshape(-1, 3)
    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = scipy.sparse.coo_array((np.ones(len(edges)), edges.T), shape=(len(places),) * 2)
    count, part = scipy.sparse.csgraph.connected_components(graph, directed=False)
    body = part[faces[:, 0]]
    a, b, c = np.moveaxis(corners - corners.mean((0, 1)), 1, 0)
    volume = np.bincount(body, (a * np.cross(b, c)).sum(1), count)
    boxes = [(corners[body == k].min((0, 1)), corners[body == k].max((0, 1))) for k in range(count)]
    pairs = combinations(boxes, 2)
    if (volume <= 0).any() or not any((np.maximum(p[0], q[0]) < np.minimum(p[1], q[1])).all() for p, q in pairs):
        return None
    manifold3d = import_module("manifold3d")
    solids = [manifold3d.Manifold(manifold3d.Mesh64(places, faces[body == k].astype(np.uint64))) for k in range(count)]
    whole = manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add)
    if whole.status() != manifold3d.Error.NoError or whole.is_empty():
        return None
    mesh = whole.to_mesh64()
    return np.asarray(np.asarray(mesh.vert_properties)[:, :3][np.asarray(mesh.tri_verts).astype(int)])


def field_of_surface(
    mesh: MeshObstacle, radius: float, *, cell: float | None = None, name: str = "surface"
) -> DistanceField:
    """The distance field of all that is no farther than `radius`, m, from the triangles of a mesh, open or closed.

    Raises:
        InputError: a radius that is not greater than 0; a cell that is not, or is far too small.
    """
    positive(f"radius of {name}", radius)
    said = f"{open_surface(name, len(mesh.faces))}; it counts as {radius * 1e3:g} mm thick to either side"
    return _field(Triangles(mesh.surface.corners, False), radius, AROUND["out"], cell, (name, said))


def _field(
    surface: Triangles, radius: float, around: int, cell: float | None, called: tuple[str, str]
) -> DistanceField:
    """The field of a surface, its distances less a radius, with nodes around it; `called`: its name, and what its
    distances are from where it bounds no body."""
    name, said = called
    corners = surface.corners.reshape(-1, 3)
    ends = corners if not radius else np.concatenate([corners - radius, corners + radius])
    nodes, shape, size, origin = _lattice(ends, cell, name, around)
    moved = replace(surface, corners=surface.corners - origin)
    least, most = _bounds(moved.corners, nodes, size)
    near = least < BAND * size
    exact = moved.signed_distance(nodes[near])
    # No surface crosses the way between neighbours that are farther from it than half a cell.
    parts, count = scipy.ndimage.label(~near.reshape(shape))
    part, node = np.unique(parts.ravel(), return_index=True)
    free = np.ones(count + 1, dtype=bool)
    free[part] = moved.signed_distance(nodes[node]) > 0
    values = np.where(free[parts.ravel()], least, -most)
    values[near] = exact
    lost = float((most - least)[~near].max(initial=0.0))
    outside = around == AROUND["out"]
    table = values.reshape(shape) - radius
    return DistanceField(table, np.full(3, size), Frame(origin=origin), lost, outside, name, moved, said)


@dataclass(frozen=True, eq=False)
class Centres:
    """Balls of one radius by the tree of their centres, m."""

    tree: Any

    def gradient(self, points: Array) -> Array:
        """(N, 3) unit vectors to points (N, 3) from the nearest centre."""
        return unit_vectors(points - self.tree.data[self.tree.query(points)[1]], UP)


def field_of_points(
    points: ArrayLike, radius: float, *, cell: float | None = None, name: str = "cloud"
) -> DistanceField:
    """The distance field of balls of one radius, m, about points (N, 3).

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
    nodes, shape, size, origin = _lattice(ends, cell, name, AROUND["out"])
    tree = scipy.spatial.cKDTree(array - origin)
    far, _ = tree.query(nodes)
    values, placed = far.reshape(shape) - radius, Frame(origin=origin)
    said = _points_in_words(array, radius, name)
    return DistanceField(values, np.full(3, size), placed, 0.0, True, name, Centres(tree), said)


def _points_in_words(points: Array, radius: float, name: str) -> str:
    """What the distance from balls about points is from; a warning where an arm may pass between them."""
    balls = f"the {len(points)} points of {name}, each a ball of {radius * 1e3:g} mm"
    gap = largest_gap(points)
    if gap is None:
        return f"{balls}; how far neighbours are apart was not computed, and nothing is proved between points"
    # Balls that touch close a line: a square of points takes 0.71 of its side. Wider holes no gap of a tree excludes.
    if gap > radius:
        LOGGER.warning(
            f"{name}: neighbouring points are up to {gap * 1e3:.3g} mm apart, so the arm may pass between balls of "
            f"radius {radius * 1e3:g} mm, and nothing is proved there; give a file with faces, or more points"
        )
    return f"{balls}; the largest gap between neighbours is {gap * 1e3:.3g} mm, and nothing is proved between points"


def _lattice(points: Array, cell: float | None, name: str, around: int) -> tuple[Array, tuple[int, ...], float, Array]:
    """Nodes (N, 3) around points, from the first of them, m; how many along x, y and z, their spacing, and where (3,)
    the first is."""
    low, high = points.min(0), points.max(0)
    extent = np.maximum(high - low, 1e-6)
    least = float((extent.prod() / MOST_NODES) ** (1 / 3))
    size = max(FINEST, least) if cell is None else positive(f"cell of {name}", cell)
    count = np.ceil(extent / size).astype(int) + 2 * around + 1
    if count.max() > LARGEST or count.prod() > 20 * MOST_NODES:
        larger = 1.1 * size * max(count.max() / LARGEST, (count.prod() / (20 * MOST_NODES)) ** (1 / 3))
        raise InputError(
            f"{name} would have {' x '.join(map(str, count))} cells of {size * 1e3:g} mm; give cell_mm of at least "
            f"{larger * 1e3:.2g}"
        )
    nodes = np.moveaxis(np.indices(count), 0, -1).reshape(-1, 3) * size
    return nodes, tuple(count.tolist()), size, (low + high) / 2 - (count - 1) / 2 * size


def _bounds(corners: Array, nodes: Array, size: float) -> tuple[Array, Array]:
    """(N,) least and most that the distances of nodes (N, 3) from a surface of triangles can be, the farther the
    coarser: what samples give away falls with the distance."""
    least, most, rows = np.zeros(len(nodes)), np.zeros(len(nodes)), np.arange(len(nodes))
    for gap, closer in COVERED:
        samples, uncovered = _samples(corners, gap * size)
        most[rows], _ = scipy.spatial.cKDTree(samples).query(nodes[rows])
        least[rows] = np.sqrt(np.maximum(most[rows] ** 2 - uncovered**2, 0.0))
        rows = rows[most[rows] < closer * size]
    return least, most


def _samples(corners: Array, gap: float) -> tuple[Array, float]:
    """Points (k, 3) of a surface of triangles (f, 3, 3), and the r that they keep, `gap` or more."""
    square = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = float(np.linalg.norm(square, axis=1).sum() / 2)
    side = np.sqrt(3) * max(gap, float(np.sqrt(area / MOST_SAMPLES)))
    points = bisected(corners, side).reshape(-1, 3)
    points = points[np.lexsort(points.T)]
    new = np.append(True, (points[1:] != points[:-1]).any(1))
    return points[new], float(side / np.sqrt(3))


# Neighbours of each point from which the tree is made first: of points on a surface nearly all edges of the shortest
# tree are among them.
NEIGHBOURS = 8

# Distances that are computed at most to join what the nearest neighbours leave apart.
MOST = 200_000_000


def largest_gap(points: Array) -> float | None:
    """The least d, m, for which points (N, 3) are joined by steps no longer than d; 0 for one point.

    It is no less than that: the tree is made of the nearest neighbours of each point, and the parts that these leave
    are joined at their nearest points. None where that takes too long.
    """
    points = np.unique(points, axis=0)
    if len(points) < 2:
        return 0.0
    count = min(NEIGHBOURS + 1, len(points))
    tree = scipy.spatial.cKDTree(points)
    far, near = (each[:, 1:] for each in tree.query(points, k=count))
    row = np.repeat(np.arange(len(points)), count - 1)
    graph = scipy.sparse.csr_array((far.ravel(), (row, near.ravel())), shape=(len(points),) * 2)
    longest = float(scipy.sparse.csgraph.minimum_spanning_tree(graph).data.max())
    _, part = scipy.sparse.csgraph.connected_components(graph, directed=False)
    spent = 0
    while (size := np.bincount(part)).size and (size > 0).sum() > 1:
        smallest = int(np.where(size > 0, size, len(points) + 1).argmin())
        mine = part == smallest
        spent += len(points)
        if spent > MOST:
            return None
        apart = np.asarray(scipy.spatial.cKDTree(points[mine]).query(points[~mine])[0])
        nearest = int(np.argmin(apart))
        longest = max(longest, float(apart[nearest]))
        part[mine] = part[~mine][nearest]
    return longest
