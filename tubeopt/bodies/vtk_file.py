"""Surfaces in legacy VTK files, text or binary, as 3D Slicer saves models."""

from __future__ import annotations

from itertools import pairwise
from os import PathLike

import numpy as np

from ..errors import InputError
from ..files.files import read_bytes
from ..typing import Array
from .polygons import Polygons

NUMBERS = {"float": ">f4", "double": ">f8", "int": ">i4", "vtktypeint32": ">i4", "vtktypeint64": ">i8"}
"""Kinds of numbers, and how a binary file writes them."""

LARGEST = 2.0**53
"""Below which whole numbers are exact."""

CELLS = ("VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS")
"""What a surface may be made of."""


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
        form = np.dtype(NUMBERS[kind.lower()])
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
