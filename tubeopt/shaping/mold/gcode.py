"""The grooves of a mold as G-code (mm, absolute, mm/min), parsed again and compared with the centrelines.

Zero of the workpiece is the lower left corner of the base plate, z = 0 its upper face. The cutter enters and leaves
beyond the plate's edge, so that it never plunges into material.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from ...errors import InputError, SolveError
from ...files.files import write_text
from ...files.units import TO_MM
from .groove import Arc, Centreline, Line, Piece
from .mold import Groove, Mold

PER_MINUTE = 60.0
OVERRUN = 1e-3
"""The cutter's edge clears the plate by this much (m) before it goes down or up."""

TOLERANCE = 1e-5
"""Greatest distance (m) of the cutter's way from where it is meant to be."""

WORD = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))")


@dataclass(frozen=True)
class Cut:
    """A move that cuts: a piece in the plane (m), the cutter's depth z (m) and the feed (m/s)."""

    piece: Piece
    z: float
    feed: float


def write_gcode(mold: Mold, path: str | PathLike[str]) -> Path:
    """Write the G-code of all grooves, whole or not at all, and return the path.

    Raises:
        InputError: the file cannot be written.
        SolveError: the moves, parsed again, leave their way by more than 10 um, or do not reach the depth.
    """
    text = gcode(mold)
    deviation = toolpath_deviation(mold, text)
    if deviation > TOLERANCE:
        raise SolveError(f"{path}: the cutter's way lies {deviation * 1e6:.3g} um from the groove's")
    write_text(path, text)
    return Path(path)


def gcode(mold: Mold) -> str:
    """The program: a block of passes per groove, deepest last, with a stop for each change of the end mill."""
    milling = mold.spec.milling
    lines = [
        f"(grooves of {len(mold.grooves)} tubes in {mold.spec.material.name})",
        "(zero: lower left corner, upper face of the base plate)",
        "G21 G90 G17 G40 G94",
    ]
    cutter = None
    for groove in sorted(mold.grooves, key=lambda groove: (groove.mill.diameter, groove.number)):
        if groove.mill != cutter:
            cutter = groove.mill
            lines += [f"G0 Z{_mm(milling.safe_height)}", "M5", f"M0 (end mill {cutter.diameter * TO_MM:g} mm)"]
            lines += [f"M3 S{milling.spindle * PER_MINUTE:.0f}"]
        lines.append(f"(tube {groove.number}: width {_mm(groove.width)}, depth {_mm(groove.depth)})")
        lines += _passes(groove, mold)
    return "\n".join([*lines, f"G0 Z{_mm(milling.safe_height)}", "M5", "M30", ""])


def pass_depths(groove: Groove, mold: Mold) -> tuple[float, ...]:
    """Depths (m) of the passes, equal steps, none greater than the step down."""
    count = math.ceil(groove.depth / mold.spec.milling.step_down - 1e-9)
    return tuple(groove.depth * (k + 1) / count for k in range(count))


def cutter_ways(groove: Groove) -> tuple[Centreline, ...]:
    """The ways of the cutter in one pass (m), with the overrun beyond the plate's edge."""
    # An oblique exit: the cutter clears the edge only when the whole groove has left the plate.
    beyond = 3 * groove.width + OVERRUN
    return tuple(groove.centreline.offset(offset).lengthened(beyond) for offset in groove.cutter_offsets)


def _passes(groove: Groove, mold: Mold) -> Iterator[str]:
    milling = mold.spec.milling
    for depth in pass_depths(groove, mold):
        for way in cutter_ways(groove):
            x, y = way.lead_in.start
            yield f"G0 Z{_mm(milling.safe_height)}"
            yield f"G0 X{_mm(x)} Y{_mm(y)}"
            yield f"G1 Z{_mm(-depth)} F{milling.plunge_feed * TO_MM * PER_MINUTE:.1f}"
            for k, piece in enumerate(way.pieces):
                yield _move(piece) + (f" F{milling.feed * TO_MM * PER_MINUTE:.1f}" if k == 0 else "")
    yield f"G0 Z{_mm(milling.safe_height)}"


def _move(piece: Piece) -> str:
    x, y = piece.end
    if isinstance(piece, Line):
        return f"G1 X{_mm(x)} Y{_mm(y)}"
    i, j = piece.centre[0] - piece.start[0], piece.centre[1] - piece.start[1]
    return f"G{2 if piece.sweep < 0 else 3} X{_mm(x)} Y{_mm(y)} I{_mm(i)} J{_mm(j)}"


def read_gcode(text: str) -> tuple[Cut, ...]:
    """The cutting moves in the plane of a program in mm with absolute coordinates; G0 to G3, arcs with I and J.

    Raises:
        InputError: a line that is none of these, or an arc whose ends are not on one circle.
    """
    x = y = z = feed = 0.0
    motion = 0
    cuts: list[Cut] = []
    for number, line in enumerate(text.splitlines(), start=1):
        bare = re.sub(r"\([^)]*\)", "", line).strip()
        words = [(letter, float(value)) for letter, value in WORD.findall(bare)]
        if re.sub(r"\s", "", WORD.sub("", bare)):
            raise InputError(f"line {number} of the G-code is {line!r}; it must be words of a letter and a number")
        for letter, value in words:
            if letter == "G" and value in (0, 1, 2, 3):
                motion = int(value)
        given = dict(words)
        feed = given.get("F", feed * TO_MM * PER_MINUTE) / TO_MM / PER_MINUTE
        z = given.get("Z", z * TO_MM) / TO_MM
        if "X" not in given and "Y" not in given:
            continue
        end = (given.get("X", x * TO_MM) / TO_MM, given.get("Y", y * TO_MM) / TO_MM)
        if motion == 1:
            cuts.append(Cut(Line((x, y), end), z, feed))
        elif motion > 1:
            centre = (x + given.get("I", 0.0) / TO_MM, y + given.get("J", 0.0) / TO_MM)
            cuts.append(Cut(_arc(number, (x, y), end, centre=centre, left=motion == 3), z, feed))
        x, y = end
    return tuple(cuts)


def _arc(
    number: int, start: tuple[float, float], end: tuple[float, float], *, centre: tuple[float, float], left: bool
) -> Arc:
    radius, other = math.dist(start, centre), math.dist(end, centre)
    if abs(radius - other) > 5e-6:
        raise InputError(
            f"line {number} of the G-code: the arc's ends lie {radius * TO_MM:g} and {other * TO_MM:g} mm off centre"
        )
    first = math.atan2(start[1] - centre[1], start[0] - centre[0])
    turn = (math.atan2(end[1] - centre[1], end[0] - centre[0]) - first) % (2 * math.pi)
    return Arc(centre, radius, first, turn if left else turn - 2 * math.pi)


def toolpath_deviation(mold: Mold, text: str, step: float = 1e-3) -> float:
    """Greatest distance (m), either way, between where the cutter goes and where it is meant to; inf if too shallow.

    The moves are parsed from the program. At full depth, every way of every groove must be there.
    """
    cuts = read_gcode(text)
    worst = 0.0
    for groove in mold.grooves:
        deep = [cut.piece for cut in cuts if abs(cut.z + groove.depth) < 1e-6]
        if not deep:
            return math.inf
        for way in cutter_ways(groove):
            there = np.min([piece.distance(way.sample(step)) for piece in deep], axis=0)
            worst = max(worst, float(there.max()))
    ways = [way for groove in mold.grooves for way in cutter_ways(groove)]
    for cut in cuts:
        points = cut.piece.point(np.linspace(0.0, cut.piece.length, max(2, math.ceil(cut.piece.length / step))))
        worst = max(worst, float(np.min([way.distance(points) for way in ways], axis=0).max()))
    return worst


def _mm(length: float) -> str:
    """A length (m) in mm with 0.1 um, and never -0."""
    return f"{round(length * TO_MM, 4) + 0.0:.4f}"
