"""Surfaces of polygons in OBJ, OFF and PLY files, with all their points and the corners of every face."""

from __future__ import annotations

import re
from os import PathLike
from typing import Any

import numpy as np

from ..errors import InputError
from ..files.files import read_bytes
from ..typing import Array, Index
from .polygons import Polygons

UNREAD = {
    ".obj": ((rb"(?m)^\s*l\s+-?\d", "lines between points"), (rb"(?m)^\s*(?:curv2?|surf)\s", "curves with knots")),
    ".ply": (
        (rb"(?m)^element edge\s+[1-9]", "lines between points"),
        (rb"(?m)^element tristrips\s+[1-9]", "strips of triangles"),
    ),
}
"""What files of surfaces may have besides: lines have no thickness, and nothing is left out without a word."""

NUMBERS = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "int64": "i8", "uint64": "u8", "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
"""Kinds of numbers in PLY files."""

ORDER = {"binary_little_endian": "<", "binary_big_endian": ">"}
"""Order of bytes of binary PLY files."""

LARGEST = 2.0**53
"""Below which whole numbers are exact."""


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
