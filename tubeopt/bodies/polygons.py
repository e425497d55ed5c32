"""Surfaces of plane polygons in OBJ, OFF, PLY and legacy VTK files, and their triangulation.

A convex polygon is cut into a fan. For others a fan would cover points outside: they are cut by ear clipping
(manifold3d).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise
from os import PathLike
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError, import_extra
from ..files.files import read_bytes
from ..typing import Array, Index, Mask

# Largest distance (m) of corners from their plane: coordinates are rounded to two decimals of mm, or six digits of m.
FLAT = 1e-5

# Tolerance (rad) on the turning angles of a convex polygon.
ROUND = 1e-6

# Number of pairs of sides per chunk, which bounds the memory.
PAIRS = 1 << 22


@dataclass(frozen=True, eq=False)
class Polygons:
    """Surface of polygons, as in a file."""

    points: Array
    """Points (N, 3) in the unit of the file."""
    corners: Index
    """Numbers of the points of all polygons, one after the other, from 0 (sum of counts,)."""
    counts: Index
    """Numbers of corners of the polygons (f,)."""

    @classmethod
    def of_faces(cls, points: ArrayLike, faces: list[list[int]]) -> Polygons:
        """Surface of points (N, 3) and faces, given as lists of their corners."""
        corners = np.array([corner for face in faces for corner in face], dtype=int)
        return cls(np.array(points, dtype=float).reshape(-1, 3), corners, np.array(list(map(len, faces)), dtype=int))

    def triangles(self, scale: float) -> Index:
        """Cut the polygons into triangles (g, 3), in their order; `scale` is the unit of the points, m.

        Raises:
            InputError: a polygon with fewer than three corners, with an unknown corner, that is not plane or that
                crosses itself; a polygon that is not convex without manifold3d.
        """
        if len(self.corners) and not ((self.corners >= 0) & (self.corners < len(self.points))).all():
            raise InputError(f"it has polygons with corners outside its {len(self.points)} points")
        starts = np.cumsum(self.counts) - self.counts
        triangles, of = [np.zeros((0, 3), dtype=int)], [np.zeros(0, dtype=int)]
        for count in np.unique(self.counts):
            face = np.flatnonzero(self.counts == count)
            if count < 3:
                raise InputError(f"face {face[0] + 1} has {count} corners; it must have at least 3")
            corners = self.corners[starts[face, None] + np.arange(count)]
            cut = np.stack([np.zeros(count - 2, int), np.arange(1, count - 1), np.arange(2, count)], axis=1)
            fans = np.broadcast_to(cut, (len(face), count - 2, 3)).copy()
            if count > 3:
                # Coordinates in the plane that is nearest to the corners: the eigenvectors of their covariance.
                away = self.points[corners] * scale
                away = away - away.mean(1, keepdims=True)
                local = away @ np.linalg.eigh(np.swapaxes(away, 1, 2) @ away)[1]
                plane, deviation = local[..., 1:], np.abs(local[..., 0]).max(1)
                if deviation.max() > FLAT:
                    raise InputError(
                        f"face {face[deviation.argmax()] + 1} is not plane: one of its {count} corners is "
                        f"{deviation.max() * 1e3:.3g} mm from their plane, and at most {FLAT * 1e3:g} mm are allowed; "
                        "save the surface as triangles"
                    )
                for k in np.flatnonzero(~convex(plane)):
                    try:
                        fans[k] = ear_clipped(plane[k])
                    except InputError as error:
                        raise InputError(f"face {face[k] + 1} {error}") from None
            triangles.append(np.take_along_axis(corners[:, None], fans, axis=2).reshape(-1, 3))
            of.append(np.repeat(face, count - 2))
        return np.concatenate(triangles)[np.argsort(np.concatenate(of), kind="stable")]


def convex(plane: Array) -> Mask:
    """Mask (f,) of the convex polygons (f, k, 2): they turn to one side only, and once around."""
    side = np.roll(plane, -1, axis=1) - plane
    after = np.roll(side, -1, axis=1)
    exterior_angle = np.arctan2(_cross(side, after), (side * after).sum(-1))
    once = np.abs(np.abs(exterior_angle.sum(1)) - 2 * np.pi) < ROUND
    return np.asarray(once & ((exterior_angle > -ROUND).all(1) | (exterior_angle < ROUND).all(1)))


def ear_clipped(plane: Array) -> Index:
    """Triangles (k - 2, 3) of a polygon (k, 2), with its orientation; its sides may touch.

    Raises:
        InputError: a polygon that crosses itself; manifold3d is not installed.
    """
    library = import_extra("manifold3d", "anatomy", "polygons that are not convex")
    clockwise = _cross(plane, np.roll(plane, -1, axis=0)).sum() < 0
    cut = np.asarray(library.triangulate([plane[::-1] if clockwise else plane]), dtype=int)
    cut = (len(plane) - 1 - cut)[:, ::-1] if clockwise else cut
    # If no sides cross and no triangle is flipped, the triangles cover the polygon exactly once.
    corner = plane[cut]
    area = _cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]) * (-1 if clockwise else 1)
    longest = np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2).max(1)
    if cut.shape != (len(plane) - 2, 3) or (area < -FLAT * longest).any() or crosses_itself(plane):
        raise InputError("crosses itself; its sides may meet at its corners only")
    return cut


def crosses_itself(plane: Array) -> bool:
    """True if two sides of a polygon (k, 2) cross; sides that touch do not."""
    start, end = plane, np.roll(plane, -1, axis=0)
    size = float(np.ptp(plane, axis=0).max())
    rows = max(1, PAIRS // len(plane))
    for k in range(0, len(plane), rows):
        a, b = start[k : k + rows, None], end[k : k + rows, None]
        separated = _side(a, b, start, size) * _side(a, b, end, size) < 0
        if (separated & (_side(start, end, a, size) * _side(start, end, b, size) < 0)).any():
            return True
    return False


def _side(start: Array, end: Array, point: Array, size: float) -> Array:
    """Sides of points relative to lines: 1, -1, or 0 within rounding for a polygon of this size."""
    across = _cross(end - start, point - start)
    return np.where(np.abs(across) <= 1e-9 * size * np.linalg.norm(end - start, axis=-1), 0.0, np.sign(across))


def _cross(a: Array, b: Array) -> Array:
    """Cross product (...) of vectors (..., 2)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


# Contents of surface files that are refused: lines have no thickness, and nothing is omitted silently.
UNREAD = {
    ".obj": ((rb"(?m)^\s*l\s+-?\d", "lines between points"), (rb"(?m)^\s*(?:curv2?|surf)\s", "curves with knots")),
    ".ply": (
        (rb"(?m)^element edge\s+[1-9]", "lines between points"),
        (rb"(?m)^element tristrips\s+[1-9]", "strips of triangles"),
    ),
}

# Number types in PLY files.
NUMBERS = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "int64": "i8", "uint64": "u8", "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip

# Byte orders of binary PLY files.
ORDER = {"binary_little_endian": "<", "binary_big_endian": ">"}

# Whole numbers below this are exact as floats.
LARGEST = 2.0**53


def read_polygons(path: str | PathLike[str]) -> Polygons:
    """Read the surface of an OBJ, OFF or PLY file; raises InputError for invalid or unsupported contents."""
    kind, content = str(path)[-4:].lower(), read_bytes(path)
    for pattern, contents in UNREAD.get(kind, ()):
        if re.search(pattern, content):
            raise InputError(f"{path}: it has {contents}, which are not read; give faces, or points along them")
    try:
        return {".obj": _obj, ".off": _off, ".ply": _ply}[kind](content)
    except (ValueError, IndexError, KeyError, OverflowError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: no mesh can be read from it: {reason}") from None


def _obj(content: bytes) -> Polygons:
    """Parse lines `v x y z` and `f 1/2/3 ...`; points are numbered from 1, or backwards from the latest point."""
    points: list[list[float]] = []
    faces: list[list[int]] = []
    for line in content.decode("utf-8", "replace").replace("\\\r\n", " ").replace("\\\n", " ").splitlines():
        tokens = line.split("#", 1)[0].split()
        if tokens[:1] == ["v"]:
            points.append([float(tokens[k]) for k in (1, 2, 3)])
        elif tokens[:1] == ["f"]:
            named = [int(word.split("/", 1)[0]) for word in tokens[1:]]
            if any(number == 0 or -number > len(points) for number in named):
                raise ValueError(f"face {len(faces) + 1} has a corner that is no point")
            faces.append([number - 1 if number > 0 else len(points) + number for number in named])
    return Polygons.of_faces(points, faces)


def _off(content: bytes) -> Polygons:
    """Parse the numbers of points and faces, the points, and the faces with their numbers of corners."""
    lines = [line for row in content.decode("utf-8", "replace").splitlines() if (line := row.split("#", 1)[0].split())]
    name, *counts = lines.pop(0)
    if not re.fullmatch(r"(ST)?C?N?OFF", name) or counts[:1] == ["BINARY"]:
        raise ValueError(f"it begins with {' '.join([name, *counts])[:20]!r}; it must begin with OFF")
    n_points, n_faces = map(int, (counts or lines.pop(0))[:2])
    if min(n_points, n_faces) < 0 or len(lines) < n_points + n_faces:
        raise ValueError(f"it states {n_points} points and {n_faces} faces, and has {len(lines)} lines for them")
    faces = [[int(word) for word in row[1 : 1 + int(row[0])]] for row in lines[n_points : n_points + n_faces]]
    short = [k for k, row in enumerate(lines[n_points : n_points + n_faces]) if len(faces[k]) != int(row[0])]
    if short:
        raise ValueError(f"face {short[0] + 1} has fewer corners than it states")
    return Polygons.of_faces([[float(row[k]) for k in (0, 1, 2)] for row in lines[:n_points]], faces)


def _ply(content: bytes) -> Polygons:
    """Parse a file with a header that describes the following numbers, as text or binary."""
    end = re.search(rb"(?m)^end_header[ \t]*\r?\n?", content)
    if end is None or not content.startswith(b"ply"):
        raise ValueError("it begins with no header of a PLY file")
    form, elements = _header(content[: end.start()].decode("ascii", "replace"))
    body = content[end.end() :]
    if form not in ORDER:  # text: all numbers are converted to eight bytes
        body = np.array(body.split(), dtype="<f8").tobytes()
    points, corners, counts, at = np.zeros((0, 3)), np.zeros(0, dtype=int), np.zeros(0, dtype=int), 0
    for element in elements:
        if element.length > len(body):
            raise ValueError(f"it states {element.length} rows of {element.name} and ends before them")
        columns, at = _columns(body, at, element)
        if element.name == "vertex":
            points = np.stack([columns[axis][0] for axis in "xyz"], axis=1)
        if element.name == "face":
            (key,) = {"vertex_indices", "vertex_index"} & columns.keys() or {""}
            if not key:
                raise ValueError("its faces have no vertex_indices")
            values, counts = columns[key]
            if not (np.abs(values) < LARGEST).all() or (values != np.rint(values)).any():
                raise ValueError("a corner of a face is no whole number")
            corners = values.astype(int)
    if form not in ORDER and at != len(body):
        raise ValueError("its lines have other numbers than its header states")
    return Polygons(points, corners, counts)


class Element(NamedTuple):
    """Element of a PLY file: a table of rows."""

    name: str
    length: int
    """Number of rows."""
    properties: dict[str, tuple[str, ...]]
    """Property -> type of its number, or types of the length and the entries of a list."""


def _header(text: str) -> tuple[str, list[Element]]:
    """Format and elements of a PLY file."""
    form, elements = "", list[Element]()
    for tokens in map(str.split, text.splitlines()[1:]):
        if tokens[:1] == ["format"]:
            form = tokens[1]
        elif tokens[:1] == ["element"]:
            elements.append(Element(tokens[1], int(tokens[2]), {}))
        elif tokens[:1] == ["property"]:
            kinds = tokens[2:4] if tokens[1] == "list" else tokens[1:2]
            order = ORDER.get(form)
            types = tuple("<f8" if order is None else order + NUMBERS[kind] for kind in kinds)
            elements[-1].properties[tokens[-1]] = types
    if form not in (*ORDER, "ascii") or any(element.length < 0 for element in elements):
        raise ValueError(f"its format is {form!r}; it must be ascii, {' or '.join(ORDER)}")
    return form, elements


def _columns(body: bytes, at: int, element: Element) -> tuple[dict[str, tuple[Array, Index]], int]:
    """Numbers of an element by property, with the length of each row, and the position of the next element.

    Rows of equal length are read at once; others one by one.
    """
    _, length, properties = element
    lists = {name: np.zeros(length, dtype=int) for name in properties}
    if not length:
        return {name: (np.zeros(0), count) for name, count in lists.items()}, at
    first = _row(body, at, properties)[0]
    fields: list[Any] = []
    for name, kinds in properties.items():
        fields += [(f"{name} length", kinds[0])] if len(kinds) == 2 else []
        fields.append((name, kinds[-1], (len(first[name]),)))
    form = np.dtype(fields)
    if len(body) - at >= length * form.itemsize:
        rows = np.frombuffer(body, form, length, at)
        lists_in_row = [name for name, kinds in properties.items() if len(kinds) == 2]
        if all((rows[f"{name} length"] == len(first[name])).all() for name in lists_in_row):
            equal = {name: (rows[name].astype(float).ravel(), np.full(length, len(first[name]))) for name in properties}
            return equal, at + length * form.itemsize
    values: dict[str, list[Array]] = {name: [] for name in properties}
    for k in range(length):
        row, at = _row(body, at, properties)
        for name, numbers in row.items():
            values[name].append(numbers)
            lists[name][k] = len(numbers)
    return {name: (np.concatenate(values[name]).astype(float), lists[name]) for name in properties}, at


def _row(body: bytes, at: int, properties: dict[str, tuple[str, ...]]) -> tuple[dict[str, Array], int]:
    """Numbers of a row by property, and the position of the next row."""
    row = {}
    for name, kinds in properties.items():
        count = 1
        if len(kinds) == 2:
            count = int(np.frombuffer(body, kinds[0], 1, at)[0])
            at += np.dtype(kinds[0]).itemsize
            if count < 0:
                raise ValueError(f"{name} has a negative length")
        row[name] = np.frombuffer(body, kinds[1] if len(kinds) == 2 else kinds[0], count, at)
        at += count * np.dtype(kinds[-1]).itemsize
    return row, at


# Number types of VTK -> types in binary files.
VTK_NUMBERS = {"float": ">f4", "double": ">f8", "int": ">i4", "vtktypeint32": ">i4", "vtktypeint64": ">i8"}

# Cells of a surface.
CELLS = ("VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS")


def read_vtk(path: str | PathLike[str]) -> Polygons:
    """Read the points and polygons of a legacy VTK file.

    Raises:
        InputError: no such file, no legacy VTK file of a surface, or a file with lines or strips of triangles.
    """
    try:
        return _Reader(read_bytes(path)).surface()
    except UnreadError as error:
        raise InputError(f"{path}: it has {error}; save its surface as polygons (triangle filter)") from None
    except (ValueError, IndexError, KeyError, UnicodeDecodeError):
        raise InputError(f"{path}: no mesh can be read from it: it is no legacy VTK file of polygons") from None


class UnreadError(Exception):
    """Unsupported cells in a file; the text has their names."""


class _Reader:
    """Content of a file with the current position."""

    def __init__(self, content: bytes) -> None:
        self.content, self.at = content, 0
        head = [self.line() for _ in range(4)]
        kind = head[3].upper().split()
        if not head[0].startswith("# vtk DataFile") or len(kind) != 2 or kind[0] != "DATASET":
            raise ValueError(head)
        if kind[1] != "POLYDATA":
            raise UnreadError(f"a data set of kind {kind[1]}, which is not read")
        self.binary = {"ASCII": False, "BINARY": True}[head[2].upper()]

    def line(self) -> str:
        """Read the next line; raises ValueError at the end."""
        end = self.content.find(b"\n", self.at)
        if self.at >= len(self.content):
            raise ValueError("the file ends")
        end = len(self.content) if end < 0 else end
        text, self.at = self.content[self.at : end], end + 1
        return text.decode("ascii", "replace").strip()

    def numbers(self, count: int, kind: str) -> Array:
        """Read the next numbers (count,)."""
        form = np.dtype(VTK_NUMBERS[kind.lower()])
        if self.binary:
            values = np.frombuffer(self.content, form, count, self.at)
            self.at += count * form.itemsize
            return values.astype(float)
        tokens: list[str] = []
        while len(tokens) < count:
            tokens += self.line().split()
        return np.array(tokens[:count], dtype=float)

    def whole(self, count: int, kind: str) -> list[int]:
        """Read the next whole numbers of at least 0; raises ValueError for others."""
        values = self.numbers(count, kind)
        if not ((values >= 0) & (values == np.rint(values)) & (values < LARGEST)).all():
            raise ValueError("no whole number")
        numbers: list[int] = values.astype(int).tolist()
        return numbers

    def surface(self) -> Polygons:
        """Read the points and polygons."""
        points, faces = np.zeros((0, 3)), list[list[int]]()
        while self.at < len(self.content):
            tokens = self.line().split()
            if not tokens or tokens[0] not in (*CELLS, "POINTS", "POINT_DATA", "CELL_DATA"):
                continue
            if tokens[0].endswith("_DATA"):
                break
            if tokens[0] == "POINTS":
                points = self.numbers(3 * int(tokens[1]), tokens[2]).reshape(-1, 3)
                continue
            cells = self.cells(int(tokens[1]), int(tokens[2]))
            if tokens[0] in ("LINES", "TRIANGLE_STRIPS") and cells:
                raise UnreadError(f"{tokens[0]}, which are not read")
            if tokens[0] == "POLYGONS":
                faces += cells
        return Polygons.of_faces(points, faces)

    def cells(self, first: int, second: int) -> list[list[int]]:
        """Read the corners of cells: each after its number of corners, or, since version 5, all after their offsets."""
        start = self.at
        tokens = self.line().split() if not self.binary or self.content[start : start + 7] == b"OFFSETS" else []
        if tokens[:1] == ["OFFSETS"]:
            ends = self.whole(first, tokens[1])
            while (tokens := self.line().split())[:1] != ["CONNECTIVITY"]:
                continue
            row = self.whole(second, tokens[1])
            return [row[a:b] for a, b in pairwise(ends)]
        self.at = start
        row, cells, k = self.whole(second, "int"), list[list[int]](), 0
        while k < len(row):
            cells.append(row[k + 1 : k + 1 + row[k]])
            k += 1 + row[k]
        return cells
