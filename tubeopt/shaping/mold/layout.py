"""Layout of a plate: grooves in a row, bolts and dowels along the edge, vents over the bends (m).

Grooves stand one above the other or side by side, no nearer than the wall between them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Annotated

import numpy as np

from ...errors import InputError
from ...files.field_metadata import form, unit
from ...robots.tubes import Tube
from ...typing import Array
from .groove import Arc, Centreline, Point, bounds, crosses_itself, leads_to_edge, least_distance, with_leads
from .heat import ColdEnd
from .spec import EndMill, MoldSpec, VentSpec

# A finer step saves at most itself for each groove, and plates come in steps of 5 mm. The search bisects: twice as many
# steps cost one try more. 1024 steps are half a metre, more than a mill reaches.
NEST_STEP, NEST_STEPS = 0.5e-3, 1024
"""Step of the shifts that separate grooves, m, and their number."""

# What a saw sets; a tenth of the smallest plates.
PLATE_STEP = 5e-3
"""Step of the sides of a plate of free size, m."""

# A sixth of the wall that stays around them: a finer step moves no hole by more than that.
FASTENER_STEP = 0.5e-3
"""Distance of the places along the edge at which bolts and dowels are tried, m."""

SLACK = 1e-12
"""Lengths (m) and strains are compared with this slack, so that a plate exactly thick enough passes."""

DIRECTIONS = ((0.0, 1.0), (1.0, 0.0))
"""Directions of a row of grooves: one above the other, side by side."""


@dataclass(frozen=True)
class Blank:
    """Groove without a position on a plate."""

    number: int
    """Number of the tube in texts and drawings."""
    tube: Tube
    """Finished tube."""
    held: Tube
    """The tube as the groove holds it, with the curvatures and the length of its bend."""
    cold: ColdEnd
    """Cold end of the tube; its length is that of the specification, if given."""
    mill: EndMill
    """End mill of the groove."""
    width: Annotated[float, unit("mm"), form(".4g", label="groove, width"), "width of the groove"]
    bend: tuple[Arc, ...]
    """Pieces of the bend; its top is at y = 0."""
    least_lead: float
    """Least length of the lead at either end, from the bend to the edge of the plate, m."""

    @cached_property
    def core(self) -> Centreline:
        """The least groove: bend and least leads."""
        return with_leads(self.bend, self.least_lead, self.least_lead)

    @cached_property
    def boxes(self) -> tuple[Array, Array]:
        """(2, 2) least and greatest coordinates of the bend, and of the core."""
        return np.array(bounds(self.bend)), np.array(bounds(self.core.pieces))

    @property
    def bend_angle(self) -> float:
        """Total bending angle, to either side, rad."""
        return sum(abs(piece.sweep) for piece in self.bend)


@dataclass(frozen=True)
class Layout:
    """Size of the plate (m), the centreline of every groove on it, and the least wall between grooves (m)."""

    size: Point
    centrelines: tuple[Centreline, ...]
    least_wall: float


def nest(blanks: Sequence[Blank], spec: MoldSpec) -> Layout:
    """The arrangement with the smallest plate in which all grooves reach the edge and none meets another."""
    for blank in blanks:
        # Where the plate is free the leads are at least as long as this, and a plate only makes them longer.
        if crosses_itself(blank.core, blank.width + spec.groove.wall):
            raise _crossing(blank)
    found = []
    for way in DIRECTIONS:
        for order in _orders(blanks):
            layout = _arrange([blanks[k] for k in order], spec, np.array(way))
            if layout is not None:
                curves = tuple(layout.centrelines[order.index(k)] for k in range(len(blanks)))
                found.append(Layout(layout.size, curves, layout.least_wall))
    if found:
        return min(found, key=lambda layout: layout.size[0] * layout.size[1])
    raise _why_not(blanks, spec)


def _orders(blanks: Sequence[Blank]) -> list[list[int]]:
    """Orders that are tried, each once: as given; flatter bends over sharper ones; wider ones over narrower ones."""
    turn = [blank.bend_angle for blank in blanks]
    wide = [high[0] - low[0] for low, high in (blank.boxes[0] for blank in blanks)]
    given = list(range(len(blanks)))
    orders = [given, sorted(given, key=lambda k: -turn[k]), sorted(given, key=lambda k: wide[k])]
    return [order for k, order in enumerate(orders) if order not in orders[:k]]


def _arrange(blanks: Sequence[Blank], spec: MoldSpec, way: Array) -> Layout | None:
    """The blanks in a row along `way`, each as near to the one before as the wall allows; None where none is found."""
    shifts = [np.zeros(2)]
    layout = _placed(blanks[:1], shifts, spec)
    for count in range(2, len(blanks) + 1):
        before, here = blanks[count - 2 : count]
        start = shifts[-1] + way * ((before.width + here.width) / 2 + spec.groove.wall)

        def tried(steps: int, count: int = count, start: Array = start) -> Layout | None:
            return _placed(blanks[:count], [*shifts, start + steps * NEST_STEP * way], spec)

        # Doubled until there is room, then halved back: the last place that is too near is one step away.
        near, far = -1, 0
        while (layout := tried(far)) is None:
            near, far = far, max(1, 2 * far)
            if far > NEST_STEPS:
                return None
        while far - near > 1:
            middle = (near + far) // 2
            closer = tried(middle)
            near, far, layout = (near, middle, closer) if closer is not None else (middle, far, layout)
        shifts.append(start + far * NEST_STEP * way)
    return layout


def _placed(blanks: Sequence[Blank], shifts: Sequence[Array], spec: MoldSpec) -> Layout | None:
    """The plate with the blanks moved by `shifts`; None where they meet or do not fit."""
    size, origin = _plate(blanks, shifts, spec)
    inside = _inside(blanks, shifts, origin, size, spec)
    if not inside:
        return None
    curves = []
    for blank, shift in zip(blanks, shifts, strict=True):
        x, y = shift - origin
        curves.append(leads_to_edge([piece.moved((float(x), float(y))) for piece in blank.bend], size))
    if any(crosses_itself(c, b.width + spec.groove.wall) for c, b in zip(curves, blanks, strict=True)):
        return None
    wall = math.inf
    for (first, a), (second, b) in combinations(zip(curves, blanks, strict=True), 2):
        wall = min(wall, least_distance(first, second) - (a.width + b.width) / 2)
        if wall < spec.groove.wall - SLACK:
            return None
    return Layout(size, tuple(curves), wall)


def _plate(blanks: Sequence[Blank], shifts: Sequence[Array], spec: MoldSpec) -> tuple[Point, Array]:
    """Size of the plate, and its lower left corner where the shifts are from the origin."""
    low, high = _extent(blanks, shifts)
    if spec.plate.size is not None:
        size = spec.plate.size
    else:
        step = PLATE_STEP
        wide, tall = (math.ceil((x + 2 * spec.plate.margin) / step - 1e-9) for x in high - low)
        size = (round(wide * step, 9), round(tall * step, 9))
    return size, (low + high) / 2 - np.array(size) / 2


def _extent(blanks: Sequence[Blank], shifts: Sequence[Array]) -> tuple[Array, Array]:
    """Least and greatest coordinates of the cores, walls of the grooves included."""
    corners = [(blank.boxes[1], blank.width / 2, shift) for blank, shift in zip(blanks, shifts, strict=True)]
    low = np.min([box[0] - half + shift for box, half, shift in corners], axis=0)
    high = np.max([box[1] + half + shift for box, half, shift in corners], axis=0)
    return np.asarray(low), np.asarray(high)


def _inside(blanks: Sequence[Blank], shifts: Sequence[Array], origin: Array, size: Point, spec: MoldSpec) -> bool:
    """Whether the bends keep a wall from the edge, and the ends of the least leads lie on the plate."""
    for blank, shift in zip(blanks, shifts, strict=True):
        rim = blank.width / 2 + spec.groove.wall
        for box, room in zip(blank.boxes, (rim, 0.0), strict=True):
            low, high = box + shift - origin
            if (low < room - SLACK).any() or (high > np.array(size) - room + SLACK).any():
                return False
    return True


def _why_not(blanks: Sequence[Blank], spec: MoldSpec) -> InputError:
    """Why no arrangement was found: a groove that is in the way of itself, or the grooves of one another."""
    here = [np.zeros(2)]
    plate = "" if spec.plate.size is None else " of {:g} x {:g} mm".format(*(x * 1e3 for x in spec.plate.size))
    for blank in blanks:
        if _placed([blank], here, spec) is not None:
            continue
        size, origin = _plate([blank], here, spec)
        if _inside([blank], here, origin, size, spec):
            return _crossing(blank)
        low, high = _extent([blank], here)
        wide, tall = (high - low) * 1e3
        return InputError(
            f"the groove of tube {blank.number} does not fit on the plate{plate}: bend and "
            f"leads need {wide:.1f} x {tall:.1f} mm, plus a wall of "
            f"{spec.groove.wall * 1e3:g} mm"
        )
    numbers = ", ".join(str(blank.number) for blank in blanks)
    return InputError(
        f"the grooves of tubes {numbers} cross on a plate{plate} in every arrangement; they "
        f"need {spec.groove.wall * 1e3:g} mm between them: use a larger plate or one plate "
        "per tube"
    )


def _crossing(blank: Blank) -> InputError:
    turn = math.degrees(blank.bend_angle)
    return InputError(
        f"the groove of tube {blank.number} crosses itself: it bends by {turn:.1f} deg, with "
        f"leads of at least {blank.least_lead * 1e3:.1f} mm; shorten the curved part or the "
        "leads, or use two molds"
    )


# --- holes ------------------------------------------------------------------------------------------------------------


LEAST_BOLTS = 4
DOWEL_PLACES = ((0.22, 0.0), (0.65, 1.0))
"""Where the dowels are aimed at, in parts of width and height: not point symmetric, so that the lid goes on one way."""

VENT_BRIDGE = 0.5e-3
"""Least material between vents, m."""


@dataclass(frozen=True)
class Hole:
    """A round hole: what for ("bolt", "dowel" or "vent"), centre and diameter (m)."""

    purpose: Annotated[str, "purpose of the hole"]
    centre: Annotated[Point, unit("mm"), "centre of the hole"]
    diameter: Annotated[float, unit("mm"), "diameter of the hole"]


def place_fasteners(
    size: Point, curves: Sequence[Centreline], widths: Sequence[float], spec: MoldSpec
) -> tuple[Hole, ...]:
    """Bolts in the corners and along the edges, two dowels between them; clear of the grooves and of one another."""
    plate, wall = spec.plate, spec.groove.wall
    inset = max(plate.bolt_diameter, plate.dowel_diameter) / 2 + wall
    rim = _rim(size, inset, FASTENER_STEP)
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
