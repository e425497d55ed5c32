"""Holes of a mold: bolts and dowels along the edge, vents in the lid over the bends (m)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...errors import InputError
from ...typing import Array
from .groove import Centreline, Point
from .spec import MoldSpec, VentSpec

LEAST_BOLTS = 4
DOWEL_PLACES = ((0.22, 0.0), (0.65, 1.0))
"""Where the dowels are aimed at, in parts of width and height: not point symmetric, so that the lid goes on one way."""

VENT_BRIDGE = 0.5e-3
"""Least material between vents, m."""


@dataclass(frozen=True)
class Hole:
    """A round hole: what for ("bolt", "dowel" or "vent"), centre and diameter (m)."""

    purpose: str
    centre: Point
    diameter: float


def place_fasteners(
    size: Point, curves: Sequence[Centreline], widths: Sequence[float], spec: MoldSpec
) -> tuple[Hole, ...]:
    """Bolts in the corners and along the edges, two dowels between them; clear of the grooves and of one another."""
    plate, wall = spec.plate, spec.groove.wall
    inset = max(plate.bolt_diameter, plate.dowel_diameter) / 2 + wall
    rim = _rim(size, inset, spec.solver.fastener_step)
    holes: list[Hole] = []
    aims = [("bolt", plate.bolt_diameter, aim, math.inf) for aim in _corners(size, inset)]
    aims += [
        ("dowel", plate.dowel_diameter, (size[0] * x, inset + y * (size[1] - 2 * inset)), math.inf)
        for x, y in DOWEL_PLACES
    ]
    aims += [
        ("bolt", plate.bolt_diameter, aim, plate.bolt_pitch / 3) for aim in _between(size, inset, plate.bolt_pitch)
    ]
    for purpose, diameter, aim, reach in aims:
        room = np.ones(len(rim), dtype=bool)
        for curve, width in zip(curves, widths, strict=True):
            room &= curve.distance(rim) >= (width + diameter) / 2 + wall
        for hole in holes:
            room &= np.linalg.norm(rim - hole.centre, axis=1) >= (hole.diameter + diameter) / 2 + wall
        away = np.where(room, np.linalg.norm(rim - np.asarray(aim), axis=1), np.inf)
        best = int(away.argmin())
        if away[best] < reach:
            holes.append(Hole(purpose, (float(rim[best, 0]), float(rim[best, 1])), diameter))
    bolts, dowels = (sum(hole.purpose == purpose for hole in holes) for purpose in ("bolt", "dowel"))
    if bolts < LEAST_BOLTS or dowels < 2:
        raise InputError(
            f"the plate of {size[0] * 1e3:g} x {size[1] * 1e3:g} mm fits {bolts} bolts and "
            f"{dowels} dowels next to the grooves; it needs {LEAST_BOLTS} and 2: use a "
            "larger plate or smaller holes"
        )
    return tuple(holes)


def place_vents(curve: Centreline, width: float, vents: VentSpec) -> tuple[Hole, ...]:
    """Vents of one size along the bend, as dense as the profile asks: their area follows it."""
    length = curve.bend_length
    each = open_area(width, vents.diameter)
    cells = np.linspace(0.0, length, len(vents.profile) + 1)
    area = np.concatenate([[0.0], np.cumsum(np.asarray(vents.profile) * width * np.diff(cells))])
    count = math.floor(area[-1] / each + 0.5)
    if count == 0:
        return ()
    places = np.interp((np.arange(count) + 0.5) / count * area[-1], area, cells)
    nearest = float(np.diff(places).min()) if count > 1 else math.inf
    if nearest < vents.diameter + VENT_BRIDGE - 1e-12:
        raise InputError(
            f"the profile of the vents needs {vents.diameter * 1e3:g} mm holes every "
            f"{nearest * 1e3:.3g} mm; the distance must be at least "
            f"{(vents.diameter + VENT_BRIDGE) * 1e3:.3g} mm: use a smaller open fraction or "
            "larger vents"
        )
    return tuple(Hole("vent", (float(x), float(y)), vents.diameter) for x, y in curve.bend_point(places))


def open_area(width: float, diameter: float) -> float:
    """Area (m^2) that a hole over a groove opens of it: of a circle, what lies between the walls."""
    radius, half = diameter / 2, min(width, diameter) / 2
    return 2 * (half * math.sqrt(radius**2 - half**2) + radius**2 * math.asin(half / radius))


def _rim(size: Point, inset: float, step: float) -> Array:
    """(N, 2) places for holes, `step` (m) apart: a rectangle, `inset` from the edge."""
    (x0, y0), (x1, y1) = (inset, inset), (size[0] - inset, size[1] - inset)
    if x1 <= x0 or y1 <= y0:
        raise InputError(
            f"the plate is {size[0] * 1e3:g} x {size[1] * 1e3:g} mm; it is too small for "
            f"bolts {inset * 1e3:g} mm from its edges"
        )
    across, up = np.arange(x0, x1 + step / 2, step), np.arange(y0, y1 + step / 2, step)
    sides = [[(x, y) for x in across] for y in (y0, y1)] + [[(x, y) for y in up] for x in (x0, x1)]
    return np.array([place for side in sides for place in side])


def _corners(size: Point, inset: float) -> list[Point]:
    return [(x, y) for x in (inset, size[0] - inset) for y in (inset, size[1] - inset)]


def _between(size: Point, inset: float, pitch: float) -> list[Point]:
    """Places between the corners, at most `pitch` apart along the upper and lower, then the left and right edge."""
    places: list[Point] = []
    for axis in (0, 1):
        count = math.ceil((size[axis] - 2 * inset) / pitch) - 1
        along = np.linspace(inset, size[axis] - inset, count + 2)[1:-1]
        for across in (inset, size[1 - axis] - inset):
            places += [(float(a), across) if axis == 0 else (across, float(a)) for a in along]
    return places
