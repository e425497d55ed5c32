"""The axes of a patient that files state themselves: SPACE=LPS in headers and comments, as 3D Slicer writes them.

STL has it in its header, PLY, OBJ, OFF and CSV in comments, VTK in its second line, Slicer's .fcsv as
`# CoordinateSystem = LPS` (0 for RAS and 1 for LPS in old ones), and .mrk.json under `coordinateSystem`.
"""

from __future__ import annotations

import re
from os import PathLike
from pathlib import Path

from ..errors import InputError
from ..files.files import read_bytes
from .frames import AXES

STATED = re.compile(
    rb"""\bSPACE=([A-Za-z0-9-]+)|(?i:\bCoordinateSystem)["']?\s*[=:]\s*["']?([A-Za-z0-9-]+)|"""
    rb"""(?i:\bspace\s*[=:]\s*(ras|lps|right-anterior-superior|left-posterior-superior)\b)"""
)
"""A statement, and its word; of other spellings of SPACE only the words that are known, since "space" is common."""

WORDS = {
    "ras": "RAS", "right-anterior-superior": "RAS", "0": "RAS",
    "lps": "LPS", "left-posterior-superior": "LPS", "1": "LPS",
}  # fmt: skip
"""What files call the axes that are known."""

HEAD = 4096
"""Bytes at the beginning of a file in which it is stated."""

STL_HEADER = 80
"""Bytes of the header of a binary STL file."""

COMMENTS = {".ply": b"comment obj_info", ".obj": b"#", ".off": b"#", ".csv": b"#", ".fcsv": b"#", ".txt": b"#"}
"""How lines that are comments begin, by the kind of file."""


def stated_axes(path: str | PathLike[str]) -> str | None:
    """RAS or LPS: the axes that a file states itself; None where it states none.

    Raises:
        InputError: no such file, axes that are not known, or two of them.
    """
    found = {"".join(word.decode() for word in one).lower() for one in STATED.findall(_statements(path))}
    unknown = sorted(found - WORDS.keys())
    if unknown:
        raise InputError(f"{path}: it states the axes {unknown[0]!r}; they must be {' or '.join(AXES)}")
    known = sorted({WORDS[word] for word in found})
    if len(known) > 1:
        raise InputError(f"{path}: it states two kinds of axes, {' and '.join(known)}; it must state one")
    return known[0] if known else None


def _statements(path: str | PathLike[str]) -> bytes:
    """The parts of a file in which axes may be stated."""
    suffix, content = Path(path).suffix.lower(), read_bytes(path)
    if suffix == ".json":
        return content
    if suffix == ".stl" and not content[:STL_HEADER].lstrip().lower().startswith(b"solid"):
        return content[:STL_HEADER]
    head = content[:HEAD]
    if suffix == ".stl":  # text, or a binary one whose header begins as text does
        return head.split(b"\n", 1)[0][:HEAD]
    if suffix == ".vtk":
        return b"\n".join(head.split(b"\n")[:2])
    begins = tuple(COMMENTS.get(suffix, b"").split())
    if not begins:
        return b""
    return b"\n".join(line for line in head.splitlines() if line.lstrip().startswith(begins))


def agreed(path: str | PathLike[str], axes: str | None) -> str | None:
    """RAS or LPS: the axes that a file states, or else those that are given with it; None where neither says anything.

    Raises:
        InputError: as `stated_axes`; axes that are given and contradict those that the file states.
    """
    stated = stated_axes(path)
    if stated is not None and axes is not None and stated != axes:
        raise InputError(f"{path}: axes is {axes}, but the file states {stated}; leave axes out, or correct the file")
    return stated or axes


def needed(path: str | PathLike[str], axes: str | None) -> str:
    """The same where one must be known: raises InputError where neither says anything."""
    known = agreed(path, axes)
    if known is None:
        raise InputError(
            f"{path}: the file does not state its axes, and none are given; give axes: RAS (x to the right, y to the "
            "front) or axes: LPS (x to the left, y to the back)"
        )
    return known
