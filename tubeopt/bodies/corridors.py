"""Corridors (vessels along a centreline) and triangle meshes, with readers of mesh files."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from ..display import Displayed
from ..errors import InputError, import_extra, instance, positive, triple
from ..files.csv_file import read_csv
from ..files.field_metadata import POSITIVE, check_size, check_typical, unit
from ..files.files import read_bytes
from ..files.units import MM
from ..typing import Array, Index
from .distance_field import DistanceField
from .frames import Frame, file_axes, ras
from .obstacles import AWAY, THICK, Point3, RoundCone, Scene, as_points, distance_of_numbers, greater
from .polygons import read_polygons, read_vtk
from .triangles import Triangles, oriented

LOGGER = logging.getLogger(__name__)
logging.getLogger("trimesh").addHandler(logging.NullHandler())  # without a handler Python would print its tracebacks

# Cells along the longest side of a mesh in the table of its distance: 14,000 nodes, a fraction of a second. The table
# only decides which points need the exact distance.
CELLS = 24

# Margin of the lattice around the mesh, as a fraction of its longest side: points farther away use the distance from
# the box.
AROUND = 0.25


@dataclass(frozen=True)
class Corridor(Displayed):
    """Vessel that the arm must stay in: the outside of a tube of `radius` around a polyline.

    Radii at the points are interpolated linearly, and the vessel is the union of the balls. Half balls close both ends:
    the centreline should start behind the base plate and continue beyond the target. Inside, the distance is the
    largest depth in a ball, which is at most the distance from the wall.

    Raises:
        InputError: fewer than two points, numbers that are not finite, a radius that is not greater than 0, several
            radii that are not as many as the points.
    """

    centreline: Annotated[tuple[Point3, ...], unit("mm"), "at least two points"]
    radius: Annotated[
        float | tuple[float, ...], unit("mm"), POSITIVE, THICK, "one number for all points, or one per point"
    ]

    def __post_init__(self) -> None:
        try:
            rows = tuple(self.centreline)
        except TypeError:
            raise InputError(
                f"centreline of the corridor is {self.centreline!r}; it must be a table of points"
            ) from None
        points = tuple(triple(f"point {k + 1} of the centreline", p) for k, p in enumerate(rows))
        if len(points) < 2:
            raise InputError(f"centreline of the corridor has {len(points)} points; it must have at least 2")
        object.__setattr__(self, "centreline", points)
        object.__setattr__(self, "radius", _radius(self.radius, len(points)))
        check_typical(self, "the corridor")
        check_size("a point of the corridor", tuple(x for point in points for x in point), AWAY, "mm")

    @property
    def radii(self) -> Array:
        """Radii (k,) at the points of the centreline, m."""
        return np.broadcast_to(np.array(self.radius), len(self.centreline))

    @cached_property
    def _inside(self) -> Scene:
        """Cones between the points of the centreline."""
        ends = zip(pairwise(self.centreline), pairwise(self.radii.tolist()), strict=True)
        return Scene(tuple(RoundCone(a, b, p, q) for (a, b), (p, q) in ends))

    @cached_property
    def pieces(self) -> tuple[Corridor, ...]:
        """Vessels between two points each, without an edge: where two meet, the wall may have one."""
        radii = self.radii.tolist()
        return tuple(
            Corridor(ends, width) for ends, width in zip(pairwise(self.centreline), pairwise(radii), strict=True)
        )

    def depths(self, points: Array) -> Array:
        """Distances (k, N) of points (N, 3) from the walls of all pieces, m; the largest is that from the wall."""
        return -self._inside.distances(range(len(self._inside.bodies)), points)

    def distance(self, x: Any, y: Any, z: Any) -> Any:
        """Smooth signed distance from the wall, m; positive inside the vessel."""
        first, *following = self._inside.bodies
        depth = -first.distance(x, y, z)
        for cone in following:
            depth = greater(depth, -cone.distance(x, y, z))
        return depth

    def signed_distance(self, points: ArrayLike) -> Array:
        """Distances (...) of points (..., 3) from the wall, m; positive inside the vessel."""
        array = as_points(points)
        return -self._inside.nearest(array.reshape(-1, 3)).reshape(array.shape[:-1])

    def gradient(self, points: ArrayLike) -> Array:
        """Gradients (..., 3) of the distance from the wall at points (..., 3)."""
        array = as_points(points)
        return -self._inside.gradient(array.reshape(-1, 3)).reshape(array.shape)


def _radius(radius: Any, count: int) -> float | tuple[float, ...]:
    """Check the radius of a corridor, or its radii at `count` points."""
    if np.ndim(radius) == 0:
        return positive("radius of the corridor", radius)
    radii = tuple(positive(f"radius {k + 1} of the corridor", each) for k, each in enumerate(radius))
    if len(radii) != count:
        raise InputError(f"corridor has {len(radii)} radii for {count} points; it must have 1 or {count}")
    return radii


@dataclass(frozen=True)
class MeshObstacle(Displayed):
    """Surface of triangles. A closed one bounds a body; from an open one the distance has no sign.

    Raises:
        InputError: tables of wrong shape, no triangles, trimesh is not installed.
    """

    vertices: tuple[Point3, ...] = field(repr=False)
    """Corners of the triangles (k, 3), m."""
    faces: tuple[tuple[int, int, int], ...] = field(repr=False)
    """Numbers of the corners of every triangle (f, 3), from 0."""
    name: str = "the mesh"
    """Name in messages."""

    def __post_init__(self) -> None:
        try:
            vertices, faces = np.array(self.vertices, dtype=float), np.array(self.faces, dtype=int)
        except (TypeError, ValueError):
            raise InputError("vertices and faces of the mesh must be tables of numbers") from None
        if vertices.ndim != 2 or vertices.shape[1:] != (3,) or not np.isfinite(vertices).all():
            raise InputError("vertices of the mesh must be a table of finite numbers, x, y, z in m")
        if faces.ndim != 2 or faces.shape[1:] != (3,) or not ((faces >= 0) & (faces < len(vertices))).all():
            raise InputError("faces of the mesh must be a table of three numbers of vertices each, from 0")
        object.__setattr__(self, "vertices", tuple(map(tuple, vertices.tolist())))
        object.__setattr__(self, "faces", tuple(map(tuple, faces.astype(int).tolist())))
        if not len(faces):
            raise InputError(f"{self.name} has no triangles; it must have at least one")
        instance("name of the mesh", self.name, str)
        import_extra("trimesh", "planning", "meshes")

    @cached_property
    def _mesh(self) -> Any:
        trimesh = import_extra("trimesh", "planning", "meshes")
        return trimesh.Trimesh(np.array(self.vertices), np.array(self.faces))

    @cached_property
    def _outwards(self) -> Array | None:
        """Corners (f, 3, 3) of the triangles of a closed surface with normals outwards; None for an open surface."""
        mesh = self._mesh
        if not mesh.is_watertight:
            return None
        try:
            faces = oriented(np.asarray(mesh.vertices), np.asarray(mesh.faces))
        except InputError:  # a one-sided surface
            return None
        return np.asarray(mesh.vertices)[faces]

    @property
    def opened_by(self) -> str:
        """Reason why the surface bounds no body; "" if it bounds one."""
        if self.closed:
            return ""
        edges = np.sort(self._mesh.edges, axis=1)
        count = np.unique(edges, axis=0, return_counts=True)[1]
        single, crowded = int((count == 1).sum()), int((count > 2).sum())
        parts = [f"{single} of its edges belong{'s' * (single == 1)} to one triangle only (a hole)"] * bool(single)
        parts += [f"{crowded} of its edges belong{'s' * (crowded == 1)} to more than two triangles"] * bool(crowded)
        return " and ".join(parts) or "its triangles have no consistent outer side"

    @property
    def closed(self) -> bool:
        """True if the mesh bounds a body: two triangles share each edge, and the surface has two sides."""
        return self._outwards is not None

    @property
    def stands_for(self) -> str:
        """Text that says from what distances of an open mesh are measured; "" for a closed mesh."""
        return "" if self.closed else open_surface(self.name, len(self.faces))

    def distance(self, x: Any, y: Any, z: Any) -> Any:
        """Signed distance for numbers; for symbols, programs interpolate the table `lattice`."""
        refusal = "a mesh has no formula for its distance; it is for plans, not for inverse kinematics"
        return distance_of_numbers(self, x, y, z, refusal)

    def signed_distance(self, points: ArrayLike) -> Array:
        """Distances (...) of points (..., 3), m: exact for the nearest point of a call, lower bounds for others."""
        array = as_points(points)
        flat = array.reshape(-1, 3)
        nearest = max(float(self.at_most(flat).min(initial=np.inf)), 0.0)
        return self.distance_within(flat, np.full(len(flat), np.nextafter(nearest, np.inf))).reshape(array.shape[:-1])

    def distance_within(self, points: Array, within: Array) -> Array:
        """Distances (N,) of points (N, 3) from the surface, exact below `within` (N,), otherwise at least that."""
        bound = self.lattice.signed_distance(points)
        is_close = bound < within
        bound[is_close] = self.surface.signed_distance(points[is_close])
        return bound

    SOLID = True

    def at_most(self, points: Array) -> Array:
        """Upper bounds (N,) of the distance of points (N, 3) from the surface, from the table `lattice`."""
        return self.lattice.at_most(points)

    @cached_property
    def surface(self) -> Triangles:
        """Triangles of the surface; the normals of a closed one are outwards."""
        if self._outwards is not None:
            return Triangles(self._outwards)
        return Triangles(np.array(self.vertices)[np.array(self.faces)], closed=False)

    def gradient(self, points: ArrayLike) -> Array:
        """Gradients (..., 3) of the distance at points (..., 3); inside, they point to the surface."""
        array = as_points(points)
        return self.surface.gradient(array.reshape(-1, 3)).reshape(array.shape)

    @cached_property
    def lattice(self) -> DistanceField:
        """Table of distances on a lattice around the body."""
        low, high = self._mesh.bounds
        size = float((high - low).max())
        first, extent = low - AROUND * size, high - low + 2 * AROUND * size
        cells = np.ceil(CELLS * extent / size).astype(int)
        nodes = first + np.moveaxis(np.indices(cells + 1), 0, -1) * (extent / cells)
        distance = self.surface.signed_distance(nodes.reshape(-1, 3)).reshape(cells + 1)
        return DistanceField(distance, extent / cells, Frame(origin=first), bounded=True)


def open_surface(name: str, count: int) -> str:
    """Text that says from what distances are measured: an open surface of `count` triangles, by its name."""
    return f"the {count} triangle{'' if count == 1 else 's'} of {name}, an open surface: it has no inside"


def load_mesh(path: str | PathLike[str], *, scale: float = 1e-3, axes: str | None = None) -> MeshObstacle:
    """Surface from an STL, PLY, OBJ, OFF or legacy VTK file in units of `scale` m; by default mm.

    Args:
        axes: axes of the file, RAS or LPS; they must agree with those that the file states. Without either they are not
            changed.

    Raises:
        InputError: no such file, another format, lines or no triangles in it, an implausible size, axes that contradict
            the file, or trimesh is not installed.
    """
    body = read_mesh(path, scale=scale, axes=axes)
    warn_of_open(path, body)
    return body


def read_mesh(path: str | PathLike[str], *, scale: float = 1e-3, axes: str | None = None) -> MeshObstacle:
    """Read a mesh as `load_mesh`, without its warning of an open surface."""
    letters = file_axes(path, axes) or "RAS"
    points, faces = _loaded(path, scale)
    if not len(faces):
        raise InputError(
            f"{path}: it has no triangles; give a file with faces, or the points under the key points of an anatomy, "
            "each as a ball"
        )
    # STL repeats common corners; points without a face are omitted.
    _, first, number = np.unique(points, axis=0, return_index=True, return_inverse=True)
    used, corners = np.unique(first[number.ravel()][faces], return_inverse=True)
    return _surface(path, ras(points[used], letters), corners.reshape(-1, 3))


def warn_of_open(path: str | PathLike[str], body: MeshObstacle) -> None:
    """Warn of an open surface, which has no inside."""
    if not body.closed:
        LOGGER.warning(
            f"{path}: the surface bounds no body: {body.opened_by}. The arm keeps clear of its triangles, and may be "
            "inside; repair the surface to keep the arm outside"
        )


def load_points(path: str | PathLike[str], *, scale: float = 1e-3, axes: str | None = None) -> Array | MeshObstacle:
    """Load points (N, 3), m, from a PLY file or a CSV file with the columns x_mm, y_mm and z_mm.

    Unit and axes are as in `load_mesh`. A file with triangles returns their surface, with other points as triangles
    without area.

    Raises:
        InputError: no such file, no points in it, numbers that are not finite, axes that contradict the file's.
    """
    letters = file_axes(path, axes) or "RAS"
    if str(path).lower().endswith(".csv"):
        table = read_csv(path, PLACE)
        table.expect(PLACE)
        points = table.numbers(PLACE, MM)
        table.check()
        return ras(points, letters)
    vertices, faces = _loaded(path, scale)
    points = ras(vertices, letters)
    if not len(faces):
        return points
    isolated = np.setdiff1d(np.arange(len(points)), faces)
    return _surface(path, points, np.concatenate([faces, np.repeat(isolated[:, None], 3, axis=1)]))


def _surface(path: str | PathLike[str], vertices: Array, faces: Any) -> MeshObstacle:
    """Build the surface of a file; error messages begin with its path."""
    rows = tuple(map(tuple, np.asarray(faces).tolist()))
    try:
        return MeshObstacle(tuple(map(tuple, vertices.tolist())), rows, Path(path).name)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


PLACE = ("x_mm", "y_mm", "z_mm")

# Range of plausible sizes (m): otherwise the file probably has another unit.
SMALLEST, LARGEST = 2e-4, 5.0


def _loaded(path: str | PathLike[str], scale: float) -> tuple[Array, Index]:
    """Points (N, 3) of a file, m, and the triangles (f, 3) of its faces."""
    trimesh, kind = import_extra("trimesh", "anatomy", "meshes"), Path(path).suffix.lower()
    if kind not in (".stl", ".vtk", ".obj", ".off", ".ply"):
        # Other formats define their unit and axes, such as glTF: metres and y upwards.
        raise InputError(f"{path}: the format is {kind!r}; it must be STL, PLY, OBJ, OFF or legacy VTK")
    if kind != ".stl":
        polygons = read_vtk(path) if kind == ".vtk" else read_polygons(path)
        points = _lengths(path, polygons.points, scale)
        try:
            return points, polygons.triangles(scale)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    read_bytes(path)
    try:
        mesh = trimesh.load(str(path), force="mesh", process=False)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:  # the file is no STL
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: no mesh can be read from it: {reason}") from None
    return _lengths(path, mesh.vertices, scale), np.asarray(mesh.faces)


def _lengths(path: str | PathLike[str], vertices: Any, scale: float) -> Array:
    """Points (N, 3), m; raises InputError for none, numbers that are not finite, and implausible sizes."""
    points = np.asarray(vertices, dtype=float) * positive("scale", scale)
    if not len(points):
        raise InputError(f"{path}: it has no points")
    if not np.isfinite(points).all():
        raise InputError(f"{path}: it has points that are NaN or infinite; every number must be finite")
    size = float(np.ptp(points, axis=0).max())
    if not SMALLEST <= size <= LARGEST:
        raise InputError(
            f"{path}: the mesh is {size * 1e3:.3g} mm across with a unit of {scale * 1e3:g} mm; check the unit"
        )
    return points
