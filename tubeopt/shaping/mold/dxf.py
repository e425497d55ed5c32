"""A mold as DXF: mm, true arcs, layers OUTLINE, GROOVE, CENTERLINE, HOLES, TEXT; read back and compared."""

from __future__ import annotations

import math
from collections.abc import Sequence
from os import PathLike
from pathlib import Path

from ...errors import InputError, SolveError, extra
from ...files.files import atomic_write
from ...files.units import TO_MM
from .drawing import LAYERS, TEXT_HEIGHT_MM, Drawing, draw_plate
from .groove import Arc, Line, Piece, farthest
from .mold import Mold

COLOURS = {"OUTLINE": 7, "GROOVE": 5, "CENTERLINE": 1, "HOLES": 3, "TEXT": 8}
"""AutoCAD colour indices of the layers."""

TOLERANCE = 1e-6
"""Greatest distance (m) of the centreline in the file from the mold's."""


def write_dxf(mold: Mold, path: str | PathLike[str], *, part: str = "base") -> Path:
    """Write a plate of the mold as DXF (R2010, mm), whole or not at all, and return the path; it is read back."""
    own = [piece for groove in mold.grooves for piece in groove.centreline.pieces]
    return write_drawing(draw_plate(mold, part), own, path)


def write_drawing(drawing: Drawing, centreline: Sequence[Piece], path: str | PathLike[str]) -> Path:
    """Write a drawing as DXF; raises SolveError where its centreline, read back, lies 1 um or more from these."""
    ezdxf = extra("ezdxf", "fabrication", "DXF files")
    document = ezdxf.new("R2010")
    document.header["$INSUNITS"] = 4  # mm
    document.header["$MEASUREMENT"] = 1
    for name in LAYERS:
        document.layers.add(name, color=COLOURS[name])
    space = document.modelspace()
    for layer, pieces in drawing.pieces.items():
        for piece in pieces:
            _add(space, piece, layer)
    for centre, diameter in drawing.circles:
        space.add_circle(centre, diameter / 2, dxfattribs={"layer": "HOLES"})
    for place, text in drawing.texts:
        attributes = {"layer": "TEXT", "height": TEXT_HEIGHT_MM, "insert": place}
        space.add_text(text, dxfattribs=attributes)
    with atomic_write(path) as temporary:
        document.saveas(temporary)
        deviation = dxf_deviation(centreline, temporary)
        if deviation > TOLERANCE:
            raise SolveError(f"{path}: the centreline in the file lies {deviation * 1e6:.3g} um from the one wanted")
    return Path(path)


def read_centreline(path: str | PathLike[str]) -> tuple[Piece, ...]:
    """The lines and arcs on layer CENTERLINE of a DXF file, in m."""
    ezdxf = extra("ezdxf", "fabrication", "DXF files")
    try:
        document = ezdxf.readfile(path)
    except (OSError, ezdxf.DXFError) as error:
        raise InputError(f"{path}: not a DXF file that can be read: {error}") from None
    pieces: list[Piece] = []
    for entity in document.modelspace().query('*[layer=="CENTERLINE"]'):
        dxf = entity.dxf
        if entity.dxftype() == "LINE":
            pieces.append(Line((dxf.start.x / TO_MM, dxf.start.y / TO_MM), (dxf.end.x / TO_MM, dxf.end.y / TO_MM)))
        elif entity.dxftype() == "ARC":
            sweep = math.radians((dxf.end_angle - dxf.start_angle) % 360.0)
            centre = (dxf.center.x / TO_MM, dxf.center.y / TO_MM)
            pieces.append(Arc(centre, dxf.radius / TO_MM, math.radians(dxf.start_angle), sweep))
    return tuple(pieces)


def dxf_deviation(own: Sequence[Piece], path: str | PathLike[str]) -> float:
    """Greatest distance (m), either way, between centrelines and those in a DXF file, sampled every millimetre."""
    read = read_centreline(path)
    if not read:
        return math.inf
    return max(farthest(own, read), farthest(read, own))


def _add(space: object, piece: Piece, layer: str) -> None:
    attributes = {"layer": layer}
    if isinstance(piece, Line):
        space.add_line(piece.start, piece.end, dxfattribs=attributes)  # type: ignore[attr-defined]
        return
    # DXF arcs run counter-clockwise.
    first, last = piece.start_angle, piece.start_angle + piece.sweep
    start, end = (math.degrees(angle) for angle in ((first, last) if piece.sweep > 0 else (last, first)))
    space.add_arc(piece.centre, piece.radius, start, end, dxfattribs=attributes)  # type: ignore[attr-defined]
