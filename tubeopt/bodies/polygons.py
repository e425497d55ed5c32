"""Surfaces of plane polygons: files of them (OBJ, OFF, PLY, legacy VTK), cut into triangles that cover each polygon.

A convex polygon is cut into a fan. Another loses its ears one by one (manifold3d): a fan would cover what lies outside.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError, extra
from ..files.files import read_bytes
from ..typing import Array, Index, Mask

# Distance (m) of corners from their plane that rounding explains: two decimals of a mm, or six digits of a metre.
FLAT = 1e-5

# A turn (rad) to the other side, and the excess over a full turn, up to which a polygon is convex.
ROUND = 1e-6

# Pairs of sides that are compared at once: bounds the memory.
PAIRS = 1 << 22


@dataclass(frozen=True, eq=False)
class Polygons:
    """A surface as a file has it."""

    points: Array
    """(N, 3) in the unit of the file."""
    corners: Index
    """(sum of counts,) points of all polygons one behind the other, from 0."""
    counts: Index
    """(f,) corners of each."""

    @classmethod
    def of_faces(cls, points: ArrayLike, faces: list[list[int]]) -> Polygons:
        """A surface by points (N, 3) and the corners of each face."""
        corners = np.array([corner for face in faces for corner in face], dtype=int)
        return cls(np.array(points, dtype=float).reshape(-1, 3), corners, np.array(list(map(len, faces)), dtype=int))

    def triangles(self, scale: float) -> Index:
        """(g, 3) triangles, from 0, in the order of the polygons; `scale` is the unit of the points, m.

        Raises:
            InputError: a polygon with fewer than three corners, with a corner that is no point, that is not plane or
                that crosses itself; manifold3d is not installed and a polygon is not convex.
        """
        if len(self.corners) and not ((self.corners >= 0) & (self.corners < len(self.points))).all():
            raise InputError(f"it has polygons with corners outside its {len(self.points)} points")
        begins = np.cumsum(self.counts) - self.counts
        found, of = [np.zeros((0, 3), dtype=int)], [np.zeros(0, dtype=int)]
        for count in np.unique(self.counts):
            face = np.flatnonzero(self.counts == count)
            if count < 3:
                raise InputError(f"face {face[0] + 1} has {count} corners; it must have at least 3")
            corners = self.corners[begins[face, None] + np.arange(count)]
            cut = np.stack([np.zeros(count - 2, int), np.arange(1, count - 1), np.arange(2, count)], axis=1)
            fans = np.broadcast_to(cut, (len(face), count - 2, 3)).copy()
            if count > 3:
                plane, off = in_their_planes(self.points[corners] * scale)
                if off.max() > FLAT:
                    raise InputError(
                        f"face {face[off.argmax()] + 1} is not plane: one of its {count} corners is "
                        f"{off.max() * 1e3:.3g} mm from their plane, and at most {FLAT * 1e3:g} mm are allowed; "
                        "save the surface as triangles"
                    )
                for k in np.flatnonzero(~convex(plane)):
                    try:
                        fans[k] = without_ears(plane[k])
                    except InputError as error:
                        raise InputError(f"face {face[k] + 1} {error}") from None
            found.append(np.take_along_axis(corners[:, None], fans, axis=2).reshape(-1, 3))
            of.append(np.repeat(face, count - 2))
        return np.concatenate(found)[np.argsort(np.concatenate(of), kind="stable")]


def in_their_planes(corners: Array) -> tuple[Array, Array]:
    """(f, k, 2) polygons (f, k, 3) in the planes nearest to their corners, and (f,) how far a corner is from its plane;
    m."""
    away = corners - corners.mean(1, keepdims=True)
    axes = np.linalg.eigh(np.swapaxes(away, 1, 2) @ away)[1]
    seen = away @ axes
    return seen[..., 1:], np.abs(seen[..., 0]).max(1)


def convex(plane: Array) -> Mask:
    """(f,) whether polygons (f, k, 2) turn to one side everywhere, and once around."""
    side = np.roll(plane, -1, axis=1) - plane
    after = np.roll(side, -1, axis=1)
    turn = np.arctan2(_cross(side, after), (side * after).sum(-1))
    once = np.abs(np.abs(turn.sum(1)) - 2 * np.pi) < ROUND
    return np.asarray(once & ((turn > -ROUND).all(1) | (turn < ROUND).all(1)))


def without_ears(plane: Array) -> Index:
    """(k - 2, 3) triangles of one polygon (k, 2), turned as it is; its sides may touch.

    Raises:
        InputError: it crosses itself; manifold3d is not installed.
    """
    library = extra("manifold3d", "anatomy", "polygons that are not convex")
    turned = _cross(plane, np.roll(plane, -1, axis=0)).sum() < 0
    cut = np.asarray(library.triangulate([plane[::-1] if turned else plane]), dtype=int)
    cut = (len(plane) - 1 - cut)[:, ::-1] if turned else cut
    # A triangulation without a triangle that is turned over covers a polygon once where its sides do not cross.
    corner = plane[cut]
    area = _cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]) * (-1 if turned else 1)
    longest = np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2).max(1)
    if cut.shape != (len(plane) - 2, 3) or (area < -FLAT * longest).any() or crosses_itself(plane):
        raise InputError("crosses itself; its sides may meet at its corners only")
    return cut


def crosses_itself(plane: Array) -> bool:
    """Whether two sides of a polygon (k, 2) cross; those that only touch do not."""
    start, end = plane, np.roll(plane, -1, axis=0)
    size = float(np.ptp(plane, axis=0).max())
    rows = max(1, PAIRS // len(plane))
    for k in range(0, len(plane), rows):
        a, b = start[k : k + rows, None], end[k : k + rows, None]
        apart = _side(a, b, start, size) * _side(a, b, end, size) < 0
        if (apart & (_side(start, end, a, size) * _side(start, end, b, size) < 0)).any():
            return True
    return False


def _side(start: Array, end: Array, point: Array, size: float) -> Array:
    """On which side of lines points lie: 1, -1, or 0 within rounding of a polygon of this size."""
    across = _cross(end - start, point - start)
    return np.where(np.abs(across) <= 1e-9 * size * np.linalg.norm(end - start, axis=-1), 0.0, np.sign(across))


def _cross(a: Array, b: Array) -> Array:
    """(...) the vector product of vectors (..., 2)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


# What files of surfaces may have besides: lines have no thickness, and nothing is left out without a word.
UNREAD = {
    ".obj": ((rb"(?m)^\s*l\s+-?\d", "lines between points"), (rb"(?m)^\s*(?:curv2?|surf)\s", "curves with knots")),
    ".ply": (
        (rb"(?m)^element edge\s+[1-9]", "lines between points"),
        (rb"(?m)^element tristrips\s+[1-9]", "strips of triangles"),
    ),
}

# Kinds of numbers in PLY files.
NUMBERS = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "int64": "i8", "uint64": "u8", "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip

# Order of bytes of binary PLY files.
ORDER = {"binary_little_endian": "<", "binary_big_endian": ">"}

# Below which whole numbers are exact.
LARGEST = 2.0**53


def read_polygons(path: str | PathLike[str]) -> Polygons:
    """The surface in an OBJ, OFF or PLY file; raises InputError for what is none, and for what would be left out."""
    kind, content = str(path)[-4:].lower(), read_bytes(path)
    for pattern, words in UNREAD.get(kind, ()):
        if re.search(pattern, content):
            raise InputError(f"{path}: it has {words}, which are not read; give faces, or points along them")
    try:
        return {".obj": _obj, ".off": _off, ".ply": _ply}[kind](content)
    except (ValueError, IndexError, KeyError, OverflowError) as error:
        words = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: no mesh can be read from it: {words}") from None


def _obj(content: bytes) -> Polygons:
    """Of a file of lines `v x y z` and `f 1/2/3 ...`: numbers of points from 1, or back from the last one so far."""
    points: list[list[float]] = []
    faces: list[list[int]] = []
    for line in content.decode("utf-8", "replace").replace("\\\r\n", " ").replace("\\\n", " ").splitlines():
        words = line.split("#", 1)[0].split()
        if words[:1] == ["v"]:
            points.append([float(words[k]) for k in (1, 2, 3)])
        elif words[:1] == ["f"]:
            named = [int(word.split("/", 1)[0]) for word in words[1:]]
            if any(number == 0 or -number > len(points) for number in named):
                raise ValueError(f"face {len(faces) + 1} has a corner that is no point")
            faces.append([number - 1 if number > 0 else len(points) + number for number in named])
    return Polygons.of_faces(points, faces)


def _off(content: bytes) -> Polygons:
    """Of a text file: how many points and faces, the points, and of each face how many corners and which."""
    lines = [line for row in content.decode("utf-8", "replace").splitlines() if (line := row.split("#", 1)[0].split())]
    name, *rest = lines.pop(0)
    if not re.fullmatch(r"(ST)?C?N?OFF", name) or rest[:1] == ["BINARY"]:
        raise ValueError(f"it begins with {' '.join([name, *rest])[:20]!r}; it must begin with OFF")
    n_points, n_faces = map(int, (rest or lines.pop(0))[:2])
    if min(n_points, n_faces) < 0 or len(lines) < n_points + n_faces:
        raise ValueError(f"it states {n_points} points and {n_faces} faces, and has {len(lines)} lines for them")
    faces = [[int(word) for word in row[1 : 1 + int(row[0])]] for row in lines[n_points : n_points + n_faces]]
    short = [k for k, row in enumerate(lines[n_points : n_points + n_faces]) if len(faces[k]) != int(row[0])]
    if short:
        raise ValueError(f"face {short[0] + 1} has fewer corners than it states")
    return Polygons.of_faces([[float(row[k]) for k in (0, 1, 2)] for row in lines[:n_points]], faces)


def _ply(content: bytes) -> Polygons:
    """Of a file with a header that says which numbers follow, as text or binary."""
    end = re.search(rb"(?m)^end_header[ \t]*\r?\n?", content)
    if end is None or not content.startswith(b"ply"):
        raise ValueError("it begins with no header of a PLY file")
    form, elements = _header(content[: end.start()].decode("ascii", "replace"))
    body = content[end.end() :]
    if form not in ORDER:  # text: every number as one of eight bytes
        body = np.array(body.split(), dtype="<f8").tobytes()
    points, corners, counts, at = np.zeros((0, 3)), np.zeros(0, dtype=int), np.zeros(0, dtype=int), 0
    for name, length, properties in elements:
        if length > len(body):
            raise ValueError(f"it states {length} rows of {name} and ends before them")
        columns, at = _columns(body, at, length, properties)
        if name == "vertex":
            points = np.stack([columns[axis][0] for axis in "xyz"], axis=1)
        if name == "face":
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


Properties = dict[str, tuple[str, ...]]
"""Kinds of the numbers of a row by their names: that of a number, or those of the length and the entries of a list."""


def _header(text: str) -> tuple[str, list[tuple[str, int, Properties]]]:
    """The format of a PLY file, and of its elements the name, the number and the properties."""
    form, elements = "", list[tuple[str, int, Properties]]()
    for words in map(str.split, text.splitlines()[1:]):
        if words[:1] == ["format"]:
            form = words[1]
        elif words[:1] == ["element"]:
            elements.append((words[1], int(words[2]), {}))
        elif words[:1] == ["property"]:
            kinds = words[2:4] if words[1] == "list" else words[1:2]
            order = ORDER.get(form)
            elements[-1][2][words[-1]] = tuple("<f8" if order is None else order + NUMBERS[kind] for kind in kinds)
    if form not in (*ORDER, "ascii") or any(length < 0 for _, length, _ in elements):
        raise ValueError(f"its format is {form!r}; it must be ascii, {' or '.join(ORDER)}")
    return form, elements


def _columns(body: bytes, at: int, length: int, properties: Properties) -> tuple[dict[str, tuple[Array, Index]], int]:
    """The numbers of an element by property, with how many each row has, and where the next element begins.

    Rows of the same lengths are read at once; others one by one.
    """
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
        named = [name for name, kinds in properties.items() if len(kinds) == 2]
        if all((rows[f"{name} length"] == len(first[name])).all() for name in named):
            same = {name: (rows[name].astype(float).ravel(), np.full(length, len(first[name]))) for name in properties}
            return same, at + length * form.itemsize
    values: dict[str, list[Array]] = {name: [] for name in properties}
    for k in range(length):
        row, at = _row(body, at, properties)
        for name, found in row.items():
            values[name].append(found)
            lists[name][k] = len(found)
    return {name: (np.concatenate(values[name]).astype(float), lists[name]) for name in properties}, at


def _row(body: bytes, at: int, properties: Properties) -> tuple[dict[str, Array], int]:
    """The numbers of one row by property, and where the next one begins."""
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


# Kinds of numbers, and how a binary file writes them.
VTK_NUMBERS = {"float": ">f4", "double": ">f8", "int": ">i4", "vtktypeint32": ">i4", "vtktypeint64": ">i8"}

# What a surface may be made of.
CELLS = ("VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS")


def read_vtk(path: str | PathLike[str]) -> Polygons:
    """The points and polygons of a file.

    Raises:
        InputError: no such file, one that is no legacy VTK file of a surface, or one with lines or strips of triangles.
    """
    try:
        return _Reader(read_bytes(path)).surface()
    except UnreadError as error:
        raise InputError(f"{path}: it has {error}; save its surface as polygons (triangle filter)") from None
    except (ValueError, IndexError, KeyError, UnicodeDecodeError):
        raise InputError(f"{path}: no mesh can be read from it: it is no legacy VTK file of polygons") from None


class UnreadError(Exception):
    """A file has cells that are not read; its text names them."""


class _Reader:
    """The content of a file, and how far it is read."""

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
        """The next line; ValueError at the end."""
        end = self.content.find(b"\n", self.at)
        if self.at >= len(self.content):
            raise ValueError("the file ends")
        end = len(self.content) if end < 0 else end
        text, self.at = self.content[self.at : end], end + 1
        return text.decode("ascii", "replace").strip()

    def numbers(self, count: int, kind: str) -> Array:
        """(count,) the next numbers."""
        form = np.dtype(VTK_NUMBERS[kind.lower()])
        if self.binary:
            found = np.frombuffer(self.content, form, count, self.at)
            self.at += count * form.itemsize
            return found.astype(float)
        words: list[str] = []
        while len(words) < count:
            words += self.line().split()
        return np.array(words[:count], dtype=float)

    def whole(self, count: int, kind: str) -> list[int]:
        """The next whole numbers, at least 0; ValueError for others."""
        found = self.numbers(count, kind)
        if not ((found >= 0) & (found == np.rint(found)) & (found < LARGEST)).all():
            raise ValueError("no whole number")
        numbers: list[int] = found.astype(int).tolist()
        return numbers

    def surface(self) -> Polygons:
        """Its points and polygons."""
        points, faces = np.zeros((0, 3)), list[list[int]]()
        while self.at < len(self.content):
            words = self.line().split()
            if not words or words[0] not in (*CELLS, "POINTS", "POINT_DATA", "CELL_DATA"):
                continue
            if words[0].endswith("_DATA"):
                break
            if words[0] == "POINTS":
                points = self.numbers(3 * int(words[1]), words[2]).reshape(-1, 3)
                continue
            cells = self.cells(int(words[1]), int(words[2]))
            if words[0] in ("LINES", "TRIANGLE_STRIPS") and cells:
                raise UnreadError(f"{words[0]}, which are not read")
            if words[0] == "POLYGONS":
                faces += cells
        return Polygons.of_faces(points, faces)

    def cells(self, first: int, second: int) -> list[list[int]]:
        """Corners of cells: each behind their number, or, from version 5 on, all of them behind where each begins."""
        begun = self.at
        words = self.line().split() if not self.binary or self.content[begun : begun + 7] == b"OFFSETS" else []
        if words[:1] == ["OFFSETS"]:
            ends = self.whole(first, words[1])
            while (words := self.line().split())[:1] != ["CONNECTIVITY"]:
                continue
            row = self.whole(second, words[1])
            return [row[a:b] for a, b in pairwise(ends)]
        self.at = begun
        row, found, k = self.whole(second, "int"), list[list[int]](), 0
        while k < len(row):
            found.append(row[k + 1 : k + 1 + row[k]])
            k += 1 + row[k]
        return found
