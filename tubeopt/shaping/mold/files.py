"""The files of a mold: drawings (DXF, SVG), solids (STL), G-code; in mm, read back and compared with the mold."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np

from ...errors import InputError, SolveError, import_extra
from ...files.files import atomic_write, left_out_where_missing, write_text
from ...files.units import TO_MM
from ...typing import Array
from .checks import fit_tolerance
from .gcode import checked_programs
from .groove import Arc, Point, closed, directed_distance, leads_to_edge, outline_of, polygon
from .mold import PARTS, Clamp, Groove, Mold, clamp_corners

# --- drawing of a plate -----------------------------------------------------------------------------------------------


LAYERS = ("OUTLINE", "GROOVE", "CENTERLINE", "HOLES", "TEXT")
TEXT_HEIGHT_MM = 2.2


@dataclass(frozen=True)
class Drawing:
    """Drawing of a plate, in mm."""

    size: Point
    """Width and height of the plate."""
    pieces: dict[str, tuple[Arc, ...]]
    """Lines and arcs of each layer."""
    circles: tuple[tuple[Point, float], ...]
    """Centres and diameters of the holes."""
    texts: tuple[tuple[Point, str], ...]
    """Positions and texts of the lines below the plate."""


def draw_plate(mold: Mold, part: str) -> Drawing:
    """Drawing of the lower plate ("base") or the top plate ("lid"), both seen from above, as they lie when closed.

    Centrelines are on both, grooves only on the base, vents only on the lid; clamps are drawn with the texts.
    """
    width, height = (extent * TO_MM for extent in mold.size)
    outline = rectangle(width, height)
    if part == "lid" and mold.hinge:
        outline = tuple(piece for low, high in halves(mold) for piece in _strip(width, low * TO_MM, high * TO_MM))
    centre = tuple(in_mm(piece) for groove in mold.grooves for piece in groove.centreline.pieces)
    walls = [in_mm(piece) for groove in mold.grooves for piece in _groove_outline(groove, mold.size)]
    slots = [in_mm(piece) for slot in mold.slots for piece in outline_of(slot.centreline.bend, slot.mill.diameter / 2)]
    jaws = tuple(in_mm(line) for groove in mold.grooves for clamp in groove.clamps for line in _jaws(clamp, mold))
    holes = mold.lid_holes if part == "lid" else mold.base_holes
    base = part == "base"
    return Drawing(
        size=(width, height),
        pieces={
            "OUTLINE": outline,
            "GROOVE": tuple(walls if base else slots),
            "CENTERLINE": centre,
            "TEXT": jaws if base else (),
        },
        circles=tuple(((hole.centre[0] * TO_MM, hole.centre[1] * TO_MM), hole.diameter * TO_MM) for hole in holes),
        texts=tuple(_texts(mold, part)),
    )


def asymmetric(mold: Mold) -> bool:
    """True if a lid that is turned over about a vertical line differs from the lid."""
    holes = {(*np.round(hole.centre, 6).tolist(), hole.diameter) for hole in mold.lid_holes}
    mirrored = {(round(mold.size[0] - x, 6), y, diameter) for x, y, diameter in holes}
    return bool(mold.slots) or mirrored != holes


def halves(mold: Mold) -> tuple[tuple[float, float], ...]:
    """Lower and upper edge (m) of a hinged lid, and of its strip; of a bolted lid alone."""
    if mold.hinge is None:
        return ((0.0, mold.size[1]),)
    pin, cut = mold.hinge.pin, mold.spec.gap / 2
    return (0.0, pin - cut), (pin + cut, mold.size[1])


def _strip(width: float, low: float, high: float) -> list[Arc]:
    """Outline of a rectangle from the left edge to the right one, between two heights."""
    return _around(np.array([(0.0, low), (width, low), (width, high), (0.0, high)]))


def _groove_outline(groove: Groove, size: Point) -> tuple[Arc, ...]:
    """Closed outline of a groove from edge to edge of the plate, clockwise, m."""
    left, right = (
        leads_to_edge(groove.centreline.offset(side * groove.width / 2).bend, size).pieces for side in (1, -1)
    )
    return closed(left, right)


def _jaws(clamp: Clamp, mold: Mold) -> list[Arc]:
    """Outline of a clamp's jaws (m), and its far side after the travel."""
    spec = mold.spec.clamps
    lines = _around(clamp_corners(clamp, spec))
    if clamp.slides:
        right, left = clamp_corners(clamp, spec, clamp.travel)[2:4]
        lines.append(Arc.between(right, left))
    return lines


def _texts(mold: Mold, part: str) -> list[tuple[Point, str]]:
    """Lines of text below the plate: its material and size, and a line per groove."""
    plate, spec = mold.spec.plate, mold.spec
    thickness = (plate.thickness if part == "base" else plate.lid_thickness) * TO_MM
    lines = [
        f"{part} plate, {spec.material.name}, {mold.size[0] * TO_MM:g} x {mold.size[1] * TO_MM:g} x {thickness:g} mm"
    ]
    lines += [
        f"tube {groove.number}: OD {groove.tube.outer_diameter * TO_MM:g}, mold radius {groove.radius * TO_MM:.3f}, "
        f"bend {math.degrees(groove.bend_angle):.3f} deg, groove {groove.width * TO_MM:.3f} wide "
        f"{groove.depth * TO_MM:.3f} deep (both +-{fit_tolerance(spec) * TO_MM:.3f}), end mill "
        f"{groove.mill.diameter * TO_MM:g}, cut tube to {groove.stock_length * TO_MM:.1f} mm"
        for groove in mold.grooves
    ]
    if part == "lid":
        mirror = "; mirror it to mill the lower face" if asymmetric(mold) else ""
        if mold.slots:
            mirror += ", as lid_holes.pdf and the programs do"
        lines.append(f"seen from above, closed{mirror}")
        lines += [
            f"slot for a thermocouple in the lower face: {slot.mill.diameter * TO_MM:g} wide, "
            f"{slot.depth * TO_MM:g} deep, {slot.centreline.length * TO_MM:.1f} mm long"
            for slot in mold.slots
        ]
    if mold.hinge:
        screws, reach = spec.hinge.screw_diameter * TO_MM, spec.hinge.reach * TO_MM
        lines.append(
            f"hinges: pins {mold.hinge.pin * TO_MM:.2f} mm above the lower edge; screws {screws:g}, {reach:g} mm from "
            "the pins, countersunk from the lower face"
            + (f"; the upper strip stays on the base, {spec.gap * TO_MM:g} mm from the lid" if part == "lid" else "")
        )
        latch = spec.hinge.latch_diameter if part == "lid" else plate.bolt_diameter
        lines.append(f"latches: holes of {latch * TO_MM:g} mm for a bolt with nut and slotted washer")
    step = 1.6 * TEXT_HEIGHT_MM
    jaws = (line for groove in mold.grooves for clamp in groove.clamps for line in _jaws(clamp, mold))
    below = min(-3 * TEXT_HEIGHT_MM, min(line.start[1] for line in jaws) * TO_MM - 2 * TEXT_HEIGHT_MM)
    return [((0.0, below - k * step), line) for k, line in enumerate(lines)]


def rectangle(width: float, height: float) -> tuple[Arc, ...]:
    """Outline of a plate with its lower left corner at the origin."""
    return tuple(_around(np.array([(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)])))


def _around(corners: Sequence[Array] | Array) -> list[Arc]:
    """Lines of the closed polygon with these corners (N, 2)."""
    return [Arc.between(a, b) for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)]


def in_mm(piece: Arc) -> Arc:
    """Convert a piece from m to mm."""
    (x, y), length = piece.start, piece.length * TO_MM
    return Arc((x * TO_MM, y * TO_MM), piece.heading, length, piece.curvature / TO_MM)


COLOURS = {
    "OUTLINE": (7, "#222222"),
    "GROOVE": (5, "#0072B2"),
    "CENTERLINE": (1, "#D55E00"),
    "HOLES": (3, "#009E73"),
    "TEXT": (8, "#6A6A6A"),
}
"""Colours of the layers: index in DXF, hexadecimal in SVG."""

MARGIN_MM = 25.0

TOLERANCE = 1e-6
"""Largest distance of the centreline in a DXF file from the centreline of the mold, m."""

# A polygon of n corners has less area than its circle by a fraction of (2 pi / n)^2 / 6: 0.02 %. With half of them it
# is 0.07 %, close to the tolerance of the volume, 0.1 %.
HOLE_SIDES = 192
"""Corners of a hole in a solid."""

ABOVE = 1e-3
"""Height of cutting solids above the plate, m, so that no faces coincide."""


@dataclass(frozen=True, eq=False)
class Part:
    """Plate, cylinder or block to be made, with the contents of its files."""

    name: str
    """Name of its files, without their ending."""
    solid: Callable[[], Any]
    """Function that makes the solid (manifold3d, mm)."""
    fault: Callable[[Any], str]
    """Function that checks the mesh (mm) read from its file: message of a fault, or ""."""
    texts: tuple[tuple[str, str], ...]
    """Names and contents of its programs and tables, which were read back and compared."""
    drawing: Drawing | None = None
    """Drawing of a plate; None for another part."""
    centreline: tuple[Arc, ...] = ()
    """Centrelines that the drawing must contain, m."""


def write_parts(parts: Sequence[Part], directory: str | PathLike[str]) -> list[Path]:
    """Write the drawings (DXF, SVG) and solids (STL) of parts, then their programs and tables; return the paths.

    Drawings and solids whose package (ezdxf, manifold3d, trimesh) is not installed are left out with a warning.

    Raises:
        InputError: a file cannot be written.
        SolveError: a drawing or a solid does not agree with its part when it is read back.
    """
    out, paths = Path(directory), list[Path]()
    for part in parts:
        if part.drawing is not None:
            with left_out_where_missing():
                paths.append(write_dxf(part.drawing, part.centreline, out / f"{part.name}.dxf"))
            write_text(out / f"{part.name}.svg", svg_of(part.drawing))
            paths.append(out / f"{part.name}.svg")
        with left_out_where_missing():
            paths.append(write_solid(part, out / f"{part.name}.stl"))
    for name, text in (file for part in parts for file in part.texts):
        write_text(out / name, text)
        paths.append(out / name)
    return paths


def write_mold(mold: Mold, directory: str | Path) -> list[Path]:
    """Write base and lid as DXF, SVG and STL and their G-code, as `write_parts`; return the paths.

    Raises SolveError also if a program, read back, deviates from its groove by more than 10 um, or moves at rapid speed
    in the plate.
    """
    return write_parts([plate_part(mold, name) for name in PARTS], directory)


def plate_part(mold: Mold, name: str) -> Part:
    """Plate of a mold, "base" or "lid", as a part.

    The upper face of the base is at z = 0, the lid on it.
    """
    return Part(
        name=name,
        solid=partial(_plate_solid, mold, name),
        fault=partial(volume_fault, mold, name),
        texts=tuple((program.file, program.text) for program in checked_programs(mold, name)),
        drawing=draw_plate(mold, name),
        centreline=tuple(piece for groove in mold.grooves for piece in groove.centreline.pieces),
    )


# --- drawings ---------------------------------------------------------------------------------------------------------


def write_dxf(drawing: Drawing, centreline: Sequence[Arc], path: Path) -> Path:
    """Write a drawing as DXF (R2010, true arcs), completely or not at all, and return the path.

    Raises:
        SolveError: the centreline in the file deviates from `centreline` by more than 1 um.
    """
    ezdxf = import_extra("ezdxf", "fabrication", "DXF files")
    document = ezdxf.new("R2010")
    document.header["$INSUNITS"] = 4  # mm
    document.header["$MEASUREMENT"] = 1
    for name in LAYERS:
        document.layers.add(name, color=COLOURS[name][0])
    space = document.modelspace()
    for layer, pieces in drawing.pieces.items():
        if layer in CLOSED:
            for loop in _loops(pieces):
                # Programs of lasers take closed polylines; the bulge of an arc is the tangent of a quarter of its turn.
                points = [(*piece.start, math.tan(piece.sweep / 4)) for piece in loop]
                space.add_lwpolyline(points, format="xyb", close=True, dxfattribs={"layer": layer})
            continue
        for piece in pieces:
            _add(space, piece, layer)
    for centre, diameter in drawing.circles:
        space.add_circle(centre, diameter / 2, dxfattribs={"layer": "HOLES"})
    for position, text in drawing.texts:
        attributes = {"layer": "TEXT", "height": TEXT_HEIGHT_MM, "insert": position}
        space.add_text(text, dxfattribs=attributes)
    with atomic_write(path) as temporary:
        document.saveas(temporary)
        deviation = dxf_deviation(centreline, temporary)
        if deviation > TOLERANCE:
            raise SolveError(f"{path}: the centreline in the file deviates by {deviation * 1e6:.3g} um")
    return path


CLOSED = ("OUTLINE", "GROOVE")
"""Layers of closed outlines."""


def _loops(pieces: Sequence[Arc]) -> list[list[Arc]]:
    """Closed outlines, mm, in a sequence of pieces."""
    loops: list[list[Arc]] = [[]]
    for piece in pieces:
        loops[-1].append(piece)
        if math.dist(piece.end, loops[-1][0].start) < TOLERANCE * TO_MM:
            loops.append([])
    return loops[:-1]


def read_centreline(path: str | PathLike[str]) -> tuple[Arc, ...]:
    """Lines and arcs on layer CENTERLINE of a DXF file, in m."""
    ezdxf = import_extra("ezdxf", "fabrication", "DXF files")
    try:
        document = ezdxf.readfile(path)
    except (OSError, ezdxf.DXFError) as error:
        raise InputError(f"{path}: not a DXF file that can be read: {error}") from None
    pieces: list[Arc] = []
    for entity in document.modelspace().query('*[layer=="CENTERLINE"]'):
        dxf = entity.dxf
        if entity.dxftype() == "LINE":
            ends = ((end.x / TO_MM, end.y / TO_MM) for end in (dxf.start, dxf.end))
            pieces.append(Arc.between(*ends))
        elif entity.dxftype() == "ARC":
            sweep = math.radians((dxf.end_angle - dxf.start_angle) % 360.0)
            first, radius = math.radians(dxf.start_angle), dxf.radius / TO_MM
            start = dxf.center.x / TO_MM + radius * math.cos(first), dxf.center.y / TO_MM + radius * math.sin(first)
            pieces.append(Arc(start, first + math.pi / 2, radius * sweep, 1 / radius))
    return tuple(pieces)


def dxf_deviation(pieces: Sequence[Arc], path: str | PathLike[str]) -> float:
    """Hausdorff distance (m) between centrelines and those in a DXF file, by samples 1 mm apart; inf without any."""
    read = read_centreline(path)
    return max(directed_distance(pieces, read), directed_distance(read, pieces)) if read else math.inf


def _add(space: object, piece: Arc, layer: str) -> None:
    """Add a line or an arc to the model space of a DXF document."""
    attributes = {"layer": layer}
    if not piece.curvature:
        space.add_line(piece.start, piece.end, dxfattribs=attributes)  # type: ignore[attr-defined]
        return
    # DXF arcs run counter-clockwise.
    low, high = sorted((piece.heading, piece.heading + piece.sweep))
    start, end = (math.degrees(angle - math.copysign(math.pi / 2, piece.curvature)) for angle in (low, high))
    space.add_arc(piece.centre, piece.radius, start, end, dxfattribs=attributes)  # type: ignore[attr-defined]


def svg_of(drawing: Drawing) -> str:
    """SVG of a drawing in its true size, with a group for every layer."""
    low = min([0.0, *(position[1] for position, _ in drawing.texts)]) - MARGIN_MM / 2
    longest = max(len(text) for _, text in drawing.texts) * 0.6 * TEXT_HEIGHT_MM
    right = max(drawing.size[0] + MARGIN_MM, longest)
    width, height = right + MARGIN_MM, drawing.size[1] + MARGIN_MM - low
    # SVG's y points down: everything is flipped at once, the letters back again.
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.3f}mm" height="{height:.3f}mm" '
        f'viewBox="{-MARGIN_MM:.3f} {-(drawing.size[1] + MARGIN_MM):.3f} {width:.3f} {height:.3f}">\n'
        '<g transform="scale(1,-1)" fill="none" stroke-width="0.15">\n'
    )
    groups = []
    for layer in LAYERS:
        dash = ' stroke-dasharray="3 0.7 0.5 0.7"' if layer == "CENTERLINE" else ""
        body = [f'<path d="{_path(piece)}"/>' for piece in drawing.pieces.get(layer, ())]
        if layer == "HOLES":
            body += [f'<circle cx="{x:.6f}" cy="{y:.6f}" r="{d / 2:.6f}"/>' for (x, y), d in drawing.circles]
        if layer == "TEXT":
            body += [
                f'<text transform="translate({x:.3f},{y:.3f}) scale(1,-1)" font-size="{TEXT_HEIGHT_MM}" '
                f'font-family="sans-serif" fill="{COLOURS[layer][1]}" stroke="none">{escape(text)}</text>'
                for (x, y), text in drawing.texts
            ]
        groups.append(f'<g id="{layer}" stroke="{COLOURS[layer][1]}"{dash}>\n' + "\n".join(body) + "\n</g>\n")
    return head + "".join(groups) + "</g>\n</svg>\n"


def _path(piece: Arc) -> str:
    """Path data of a line or an arc in SVG."""
    (x0, y0), (x1, y1) = piece.start, piece.end
    if not piece.curvature:
        return f"M{x0:.6f},{y0:.6f} L{x1:.6f},{y1:.6f}"
    large, sweep = int(abs(piece.sweep) > math.pi), int(piece.sweep > 0)
    return f"M{x0:.6f},{y0:.6f} A{piece.radius:.6f},{piece.radius:.6f} 0 {large} {sweep} {x1:.6f},{y1:.6f}"


# --- solids -----------------------------------------------------------------------------------------------------------


def write_solid(part: Part, path: Path) -> Path:
    """Write the solid of a part as binary STL, completely or not at all, and return the path.

    Raises:
        SolveError: the solid is not watertight, or its mesh, read back, has a fault.
    """
    mesh = part.solid().to_mesh()
    # In the precision of STL; vertices that then coincide are merged, so that the mesh stays closed.
    faces = trimesh().Trimesh(np.asarray(mesh.vert_properties, dtype=np.float32)[:, :3], mesh.tri_verts, process=True)
    with atomic_write(path) as temporary:
        temporary.write_bytes(faces.export(file_type="stl"))
        read = trimesh().load_mesh(str(temporary), file_type="stl")
        fault = part.fault(read) if read.is_watertight else f"the solid of the {part.name} is not watertight"
        if fault:
            raise SolveError(f"{path}: {fault}")
    return path


def volume_fault(mold: Mold, part: str, mesh: Any) -> str:
    """Message for a mesh (mm) of a plate with a volume that deviates by more than 0.1 %; otherwise ""."""
    error = float(mesh.volume) / TO_MM**3 / (mold.base_volume if part == "base" else mold.lid_volume) - 1
    return f"the volume of the {part} is off by {error * 100:.3g} %" if abs(error) > 1e-3 else ""


def _plate_solid(mold: Mold, part: str) -> Any:
    """Solid of a plate (mm): its outline with holes, extruded; from the base the grooves are cut."""
    library, plate = manifold(), mold.spec.plate
    base = part == "base"
    holes = mold.base_holes if base else mold.lid_holes
    drills = [
        library.CrossSection.circle(hole.diameter / 2 * TO_MM, HOLE_SIDES).translate(
            (hole.centre[0] * TO_MM, hole.centre[1] * TO_MM)
        )
        for hole in holes
    ]
    outline = library.CrossSection()
    for low, high in halves(mold) if not base else ((0.0, mold.size[1]),):
        outline += library.CrossSection.square((mold.size[0] * TO_MM, (high - low) * TO_MM)).translate(
            (0.0, low * TO_MM)
        )
    drilled = library.CrossSection.batch_boolean([outline, *drills], library.OpType.Subtract)
    if not base:
        solid = library.Manifold.extrude(drilled, plate.lid_thickness * TO_MM)
        for slot in mold.slots:
            corners = polygon(slot.centreline, slot.mill.diameter)
            cutter = library.Manifold.extrude(library.CrossSection([corners * TO_MM]), (slot.depth + ABOVE) * TO_MM)
            solid -= cutter.translate((0.0, 0.0, -ABOVE * TO_MM))
        return solid
    solid = library.Manifold.extrude(drilled, plate.thickness * TO_MM).translate((0.0, 0.0, -plate.thickness * TO_MM))
    for groove in mold.grooves:
        # Long enough for a groove that leaves the plate at a small angle.
        corners = polygon(groove.centreline.lengthened(20 * groove.width), groove.width)
        cutter = library.Manifold.extrude(library.CrossSection([corners * TO_MM]), (groove.depth + ABOVE) * TO_MM)
        solid -= cutter.translate((0.0, 0.0, -groove.depth * TO_MM))
    return solid


def manifold() -> Any:
    """Module manifold3d for solids; raises MissingExtraError if it is not installed."""
    return import_extra("manifold3d", "fabrication", "STL files")


def trimesh() -> Any:
    """Module trimesh for meshes; raises MissingExtraError if it is not installed."""
    return import_extra("trimesh", "fabrication", "STL files")
