"""Bodies to stay inside of, or outside of, that are given by data: vessels along a centreline, triangle meshes."""

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
from ..errors import InputError, extra, instance, positive, triple
from ..files.csv_file import read_csv
from ..files.field_metadata import POSITIVE, check_size, check_usual, unit
from ..files.files import read_bytes
from ..files.units import MM
from ..typing import Array, Index
from .distance_field import DistanceField
from .frames import Frame, agreed, ras
from .obstacles import AWAY, THICK, Point3, RoundCone, Scene, as_points, distance_of_numbers, greater
from .polygons import read_polygons, read_vtk
from .triangles import Triangles, oriented

LOGGER = logging.getLogger(__name__)
logging.getLogger("trimesh").addHandler(logging.NullHandler())  # it logs tracebacks, which Python prints without one

# Cells along the longest side of a mesh in the lattice on which its distance is tabulated: 14,000 nodes, a fraction
# of a second. It only decides which points need the exact distance.
CELLS = 24

# Margin of the lattice around the mesh, as a fraction of its longest side: points farther away use the distance from
# the box.
AROUND = 0.25


@dataclass(frozen=True)
class Corridor(Displayed):
    """Everything outside a tube of `radius` around a polyline: a vessel in which the arm must stay.

    With a radius for every point it goes linearly between them: the vessel is the union of such balls. It is closed at
    both ends by half balls: let the centreline begin behind the plate and go on beyond the target. Inside, the distance
    is the depth in the ball in which a point lies deepest, which is not above that from the wall.

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
        check_usual(self, "the corridor")
        check_size("a point of the corridor", tuple(x for point in points for x in point), AWAY, "mm")

    @property
    def radii(self) -> Array:
        """(k,) radius at every point of the centreline, m."""
        return np.broadcast_to(np.array(self.radius), len(self.centreline))

    @cached_property
    def _parts(self) -> tuple[RoundCone, ...]:
        ends = zip(pairwise(self.centreline), pairwise(self.radii.tolist()), strict=True)
        return tuple(RoundCone(a, b, p, q) for (a, b), (p, q) in ends)

    def distance(self, x: Any, y: Any, z: Any) -> Any:
        """Smooth signed distance from the wall, m; positive inside the vessel."""
        inside = -self._parts[0].distance(x, y, z)
        for part in self._parts[1:]:
            inside = greater(inside, -part.distance(x, y, z))
        return inside

    @cached_property
    def _inside(self) -> Scene:
        return Scene(self._parts)

    def signed_distance(self, points: ArrayLike) -> Array:
        """(...) distance of points (..., 3) from the wall, m; positive inside the vessel."""
        array = as_points(points)
        return -self._inside.nearest(array.reshape(-1, 3)).reshape(array.shape[:-1])

    def gradient(self, points: ArrayLike) -> Array:
        """(..., 3) unit vectors along which the distance from the wall grows."""
        array = as_points(points)
        return -self._inside.gradient(array.reshape(-1, 3)).reshape(array.shape)


def _radius(radius: Any, count: int) -> float | tuple[float, ...]:
    """One radius of a corridor, or as many as its centreline has points."""
    if np.ndim(radius) == 0:
        return positive("radius of the corridor", radius)
    radii = tuple(positive(f"radius {k + 1} of the corridor", each) for k, each in enumerate(radius))
    if len(radii) != count:
        raise InputError(f"corridor has {len(radii)} radii for {count} points; it must have 1 or {count}")
    return radii


@dataclass(frozen=True)
class MeshObstacle(Displayed):
    """A surface of triangles. A closed one bounds a body; an open one is avoided by the distance from its triangles.

    Raises:
        InputError: tables of wrong shape, no triangles, trimesh is not installed.
    """

    vertices: tuple[Point3, ...] = field(repr=False)
    """(k, 3) corners of the triangles, m."""
    faces: tuple[tuple[int, int, int], ...] = field(repr=False)
    """(f, 3) corners of every triangle, from 0."""
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
        extra("trimesh", "planning", "meshes")

    @cached_property
    def _mesh(self) -> Any:
        trimesh = extra("trimesh", "planning", "meshes")
        return trimesh.Trimesh(np.array(self.vertices), np.array(self.faces))

    @cached_property
    def _outwards(self) -> Array | None:
        """(f, 3, 3) corners of the triangles of a closed surface, their normals outwards; None for an open surface."""
        mesh = self._mesh
        if not mesh.is_watertight:
            return None
        try:
            faces = oriented(np.asarray(mesh.vertices), np.asarray(mesh.faces))
        except InputError:  # of a surface with one side
            return None
        return np.asarray(mesh.vertices)[faces]

    @property
    def opened_by(self) -> str:
        """Why it bounds no body, in words; empty where it does."""
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
        """Reference of the distances of an open mesh, for messages; empty for a closed one."""
        return "" if self.closed else open_surface(self.name, len(self.faces))

    def distance(self, x: Any, y: Any, z: Any) -> Any:
        """Numbers only: symbols are interpolated in `lattice`."""
        refusal = "a mesh has no formula for its distance; it is for plans, not for inverse kinematics"
        return distance_of_numbers(self, x, y, z, refusal)

    def signed_distance(self, points: ArrayLike) -> Array:
        """(...) distance of points (..., 3), m: exact for the nearest of a call, farther away a lower bound."""
        array = as_points(points)
        flat = array.reshape(-1, 3)
        nearest = max(float(self.at_most(flat).min(initial=np.inf)), 0.0)
        return self.distance_within(flat, np.full(len(flat), np.nextafter(nearest, np.inf))).reshape(array.shape[:-1])

    def distance_within(self, points: Array, least: Array) -> Array:
        """(N,) distance of points (N, 3) from the surface where it is less than `least` (N,), else no less than it."""
        bound = self.lattice.signed_distance(points)
        near = bound < least
        bound[near] = self.surface.signed_distance(points[near])
        return bound

    SOLID = True

    def at_most(self, points: Array) -> Array:
        """(N,) what the distance of points (N, 3) from the surface is not above, from the table in `lattice`."""
        return self.lattice.at_most(points)

    @cached_property
    def surface(self) -> Triangles:
        """Its triangles, the normals of a closed surface outwards."""
        if self._outwards is not None:
            return Triangles(self._outwards)
        return Triangles(np.array(self.vertices)[np.array(self.faces)], closed=False)

    def gradient(self, points: ArrayLike) -> Array:
        """(..., 3) unit vectors away from the nearest point of the surface; into the open from inside."""
        array = as_points(points)
        return self.surface.gradient(array.reshape(-1, 3)).reshape(array.shape)

    @cached_property
    def lattice(self) -> DistanceField:
        """The body as a table of distances on a lattice around it."""
        low, high = self._mesh.bounds
        size = float((high - low).max())
        first, extent = low - AROUND * size, high - low + 2 * AROUND * size
        cells = np.ceil(CELLS * extent / size).astype(int)
        nodes = first + np.moveaxis(np.indices(cells + 1), 0, -1) * (extent / cells)
        distance = self.surface.signed_distance(nodes.reshape(-1, 3)).reshape(cells + 1)
        return DistanceField(distance, extent / cells, Frame(origin=first), bounded=True)


def open_surface(name: str, count: int) -> str:
    """What the distance from an open surface of `count` triangles is from, in words."""
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
    """As `load_mesh`, without its warning: for what may refuse an open surface."""
    own = agreed(path, axes) or "RAS"
    points, faces = _loaded(path, scale)
    if not len(faces):
        raise InputError(
            f"{path}: it has no triangles; give a file with faces, or the points under the key points of an anatomy, "
            "each as a ball"
        )
    # STL has corners in place of points; points of no face are left out.
    _, first, number = np.unique(points, axis=0, return_index=True, return_inverse=True)
    used, corners = np.unique(first[number.ravel()][faces], return_inverse=True)
    return _surface(path, ras(points[used], own), corners.reshape(-1, 3))


def warn_of_open(path: str | PathLike[str], body: MeshObstacle) -> None:
    """Warn of an open surface, which has no inside."""
    if not body.closed:
        LOGGER.warning(
            f"{path}: the surface bounds no body: {body.opened_by}. The arm keeps clear of its triangles, and may be "
            "inside; repair the surface to keep the arm outside"
        )


def load_points(path: str | PathLike[str], *, scale: float = 1e-3, axes: str | None = None) -> Array | MeshObstacle:
    """(N, 3) points of a PLY file, or of a CSV file with the columns x_mm, y_mm and z_mm, m.

    Unit and axes as in `load_mesh`. A file with triangles gives their surface, with other points as triangles without
    area.

    Raises:
        InputError: no such file, no points in it, numbers that are not finite, axes that contradict the file's.
    """
    own = agreed(path, axes) or "RAS"
    if str(path).lower().endswith(".csv"):
        table = read_csv(path, PLACE)
        table.expect(PLACE)
        points = table.numbers(PLACE, MM)
        table.check()
        return ras(points, own)
    places, faces = _loaded(path, scale)
    points = ras(places, own)
    if not len(faces):
        return points
    alone = np.setdiff1d(np.arange(len(points)), faces)
    return _surface(path, points, np.concatenate([faces, np.repeat(alone[:, None], 3, axis=1)]))


def _surface(path: str | PathLike[str], vertices: Array, faces: Any) -> MeshObstacle:
    """The surface of a file; what is wrong with it begins with its path."""
    rows = tuple(map(tuple, np.asarray(faces).tolist()))
    try:
        return MeshObstacle(tuple(map(tuple, vertices.tolist())), rows, Path(path).name)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


PLACE = ("x_mm", "y_mm", "z_mm")

# Sizes (m) between which bodies are: outside, the unit of the file is probably another.
SMALLEST, LARGEST = 2e-4, 5.0


def _loaded(path: str | PathLike[str], scale: float) -> tuple[Array, Index]:
    """(N, 3) all points of a file, m, and (f, 3) the triangles of its faces."""
    trimesh, kind = extra("trimesh", "anatomy", "meshes"), Path(path).suffix.lower()
    if kind not in (".stl", ".vtk", ".obj", ".off", ".ply"):
        # Others have a unit and axes of their own, as glTF has metres and y upwards.
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
        found = trimesh.load(str(path), force="mesh", process=False)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:  # the file is no STL
        words = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: no mesh can be read from it: {words}") from None
    return _lengths(path, found.vertices, scale), np.asarray(found.faces)


def _lengths(path: str | PathLike[str], vertices: Any, scale: float) -> Array:
    """(N, 3) m; raises InputError for no points, numbers that are not finite, and a size that no body has."""
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
