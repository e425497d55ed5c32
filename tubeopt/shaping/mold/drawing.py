"""What is drawn of a mold, in mm and by layer, whatever the format: lines, true arcs, circles, lines of text."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...files.units import TO_MM
from ...typing import Array
from .groove import Arc, Point, leads_to_edge
from .mold import Clamp, Groove, Mold

LAYERS = ("OUTLINE", "GROOVE", "CENTERLINE", "HOLES", "TEXT")
PARTS = ("base", "lid")
TEXT_HEIGHT_MM = 2.2


@dataclass(frozen=True)
class Drawing:
    """A plate in mm: per layer its lines and arcs; circles (centre, diameter) and texts (place, text)."""

    size: Point
    pieces: dict[str, tuple[Arc, ...]]
    circles: tuple[tuple[Point, float], ...]
    texts: tuple[tuple[Point, str], ...]


def draw_plate(mold: Mold, part: str) -> Drawing:
    """The drawing of the lower plate ("base") or the top plate ("lid"), both seen from above, as they lie when closed.

    Centrelines are on both, grooves only on the base, vents only on the lid; clamps are drawn with the texts.
    """
    width, height = (extent * TO_MM for extent in mold.size)
    outline = rectangle(width, height)
    centre = tuple(in_mm(piece) for groove in mold.grooves for piece in groove.centreline.pieces)
    walls = tuple(in_mm(piece) for groove in mold.grooves for piece in groove_walls(groove, mold.size))
    jaws = tuple(in_mm(line) for groove in mold.grooves for clamp in groove.clamps for line in _jaws(clamp, mold))
    holes = (*mold.holes, *(mold.vents if part == "lid" else ()))
    base = part == "base"
    return Drawing(
        size=(width, height),
        pieces={
            "OUTLINE": outline,
            "GROOVE": walls if base else (),
            "CENTERLINE": centre,
            "TEXT": jaws if base else (),
        },
        circles=tuple(((hole.centre[0] * TO_MM, hole.centre[1] * TO_MM), hole.diameter * TO_MM) for hole in holes),
        texts=tuple(_texts(mold, part)),
    )


def groove_walls(groove: Groove, size: Point) -> tuple[Arc, ...]:
    """Both walls of a groove (m), lead, bend, lead, from plate edge to plate edge."""
    walls = (groove.centreline.offset(side * groove.width / 2) for side in (1, -1))
    return tuple(piece for wall in walls for piece in leads_to_edge(wall.bend, size).pieces)


def _jaws(clamp: Clamp, mold: Mold) -> list[Arc]:
    """ArmSurface of a clamp's jaws (m), and of where its far side comes to when it slides."""
    along = np.asarray(clamp.direction)
    across = np.array([-along[1], along[0]]) * mold.spec.clamps.width / 2
    near, far = np.asarray(clamp.face), np.asarray(clamp.face) + along * mold.spec.clamps.grip
    lines = _around([near - across, far - across, far + across, near + across])
    if clamp.slides:
        beyond = far + along * clamp.travel
        lines.append(Arc.between(beyond - across, beyond + across))
    return lines


def _texts(mold: Mold, part: str) -> list[tuple[Point, str]]:
    """Lines of text below the plate: what it is, and a line per groove."""
    plate, spec = mold.spec.plate, mold.spec
    thickness = (plate.thickness if part == "base" else plate.lid_thickness) * TO_MM
    lines = [
        f"{part} plate, {spec.material.name}, {mold.size[0] * TO_MM:g} x {mold.size[1] * TO_MM:g} x {thickness:g} mm"
    ]
    lines += [
        f"tube {groove.number}: OD {groove.tube.outer_diameter * TO_MM:g}, mold radius {groove.radius * TO_MM:.3f}, "
        f"bend {math.degrees(groove.bend_angle):.3f} deg, groove {groove.width * TO_MM:.3f} wide "
        f"{groove.depth * TO_MM:.3f} deep, end mill {groove.mill.diameter * TO_MM:g}, cut tube to "
        f"{groove.stock_length * TO_MM:.1f} mm"
        for groove in mold.grooves
    ]
    step = 1.6 * TEXT_HEIGHT_MM
    jaws = (line for groove in mold.grooves for clamp in groove.clamps for line in _jaws(clamp, mold))
    below = min(-3 * TEXT_HEIGHT_MM, min(line.start[1] for line in jaws) * TO_MM - 2 * TEXT_HEIGHT_MM)
    return [((0.0, below - k * step), line) for k, line in enumerate(lines)]


def rectangle(width: float, height: float) -> tuple[Arc, ...]:
    """The outline of a plate whose lower left corner is the origin."""
    return tuple(_around(np.array([(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)])))


def _around(corners: Sequence[Array] | Array) -> list[Arc]:
    return [Arc.between(a, b) for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)]


def in_mm(piece: Arc) -> Arc:
    """A piece in m, in mm."""
    (x, y), length = piece.start, piece.length * TO_MM
    return Arc((x * TO_MM, y * TO_MM), piece.heading, length, piece.curvature / TO_MM)
