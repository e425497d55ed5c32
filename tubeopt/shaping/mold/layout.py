"""Layout of a plate: grooves in a row, bolts and dowels along the edge, vents over the bends (m).

Grooves stand one above the other or side by side, no nearer than the wall between them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Annotated, NamedTuple

import numpy as np

from ...errors import InputError
from ...files.field_metadata import form, unit
from ...robots.tubes import Tube
from ...typing import Array
from .groove import (
    Arc,
    Centreline,
    Point,
    between,
    bounds,
    crosses_itself,
    leads_to_edge,
    min_distance,
    spaced,
    with_leads,
)
from .heat import ColdEnd
from .spec import EndMill, MoldSpec, VentSpec

# A finer step saves at most one step per groove, and plates come in steps of 5 mm. The search bisects: twice as many
# steps cost one more try. 1024 steps are half a metre, more than a milling machine reaches.
NEST_STEP, NEST_STEPS = 0.5e-3, 1024
"""Step of the shifts that separate grooves, m, and their largest number."""

# The resolution of a saw; a tenth of the smallest plates.
PLATE_STEP = 5e-3
"""Step of the sides of a plate of free size, m."""

# A sixth of the default wall around holes: a finer step moves no hole by more than that.
FASTENER_STEP = 0.5e-3
"""Distance between candidate positions of bolts and dowels along the edge, m."""

SLACK = 1e-12
"""Tolerance of comparisons of lengths (m) and strains: a plate that is exactly thick enough passes."""

DIRECTIONS = ((0.0, 1.0), (1.0, 0.0))
"""Directions of a row of grooves: one above the other, side by side."""


@dataclass(frozen=True)
class Blank:
    """Groove without a position on a plate."""

    number: int
    """Number of the tube in texts and drawings."""
    tube: Tube
    """Tube after shape-setting and trimming."""
    held: Tube
    """Tube as the groove holds it, with the curvatures and the length of its bend."""
    cold: ColdEnd
    """Cold end of the tube; its length is that of the specification, if given."""
    mill: EndMill
    """End mill of the groove."""
    width: Annotated[float, unit("mm"), form(".4g", label="groove, width"), "width of the groove"]
    bend: tuple[Arc, ...]
    """Pieces of the bend; its top is at y = 0."""
    min_lead: float
    """Smallest length of the lead at either end, from the bend to the edge of the plate, m."""

    @cached_property
    def core(self) -> Centreline:
        """Shortest groove of a blank: the bend with the shortest leads."""
        return with_leads(self.bend, self.min_lead, self.min_lead)

    @cached_property
    def boxes(self) -> tuple[Array, Array]:
        """(2, 2) corners of the bounding boxes of the bend and of the core, m."""
        return np.array(bounds(self.bend)), np.array(bounds(self.core.pieces))

    @property
    def bend_angle(self) -> float:
        """Total bending angle, to either side, rad."""
        return sum(abs(piece.sweep) for piece in self.bend)


@dataclass(frozen=True)
class Layout:
    """Arrangement of grooves on a plate."""

    size: Point
    """Width and height of the plate, m."""
    centrelines: tuple[Centreline, ...]
    """Centreline of each groove on the plate."""
    min_wall: float
    """Thickness of the thinnest wall between grooves, m."""


def nest(blanks: Sequence[Blank], spec: MoldSpec) -> Layout:
    """Arrange grooves on the smallest plate on which all grooves reach the edge without meeting.

    Raises:
        InputError: a groove crosses itself or does not fit on the plate, or grooves cross in every arrangement.
    """
    for blank in blanks:
        # Leads on a plate are at least as long as those of the core, so that a crossing core cannot be mended.
        if crosses_itself(blank.core, blank.width + spec.groove.wall):
            raise _crossing(blank)
    # Orders: as given; flatter bends over sharper ones; wider ones over narrower ones.
    turn = [blank.bend_angle for blank in blanks]
    width = [high[0] - low[0] for low, high in (blank.boxes[0] for blank in blanks)]
    original = list(range(len(blanks)))
    orders = [original, sorted(original, key=lambda k: -turn[k]), sorted(original, key=lambda k: width[k])]
    layouts = []
    for direction in DIRECTIONS:
        for order in (order for k, order in enumerate(orders) if order not in orders[:k]):
            layout = _arrange([blanks[k] for k in order], spec, np.array(direction))
            if layout is not None:
                curves = tuple(layout.centrelines[order.index(k)] for k in range(len(blanks)))
                layouts.append(replace(layout, centrelines=curves))
    if not layouts:
        raise _no_arrangement(blanks, spec)
    return min(layouts, key=lambda layout: layout.size[0] * layout.size[1])


def _arrange(blanks: Sequence[Blank], spec: MoldSpec, direction: Array) -> Layout | None:
    """Row of grooves along `direction`, each as near to the previous one as the wall allows; None if none fits."""
    shifts = [np.zeros(2)]
    layout = _placed(blanks[:1], shifts, spec)
    for count in range(2, len(blanks) + 1):
        previous, added = blanks[count - 2 : count]
        start = shifts[-1] + direction * ((previous.width + added.width) / 2 + spec.groove.wall)

        def shifted(steps: int, count: int = count, start: Array = start) -> Layout | None:
            return _placed(blanks[:count], [*shifts, start + steps * NEST_STEP * direction], spec)

        # The distance is doubled until the groove fits, then bisected: one step less is too near.
        near, far = -1, 0
        while (layout := shifted(far)) is None:
            near, far = far, max(1, 2 * far)
            if far > NEST_STEPS:
                return None
        while far - near > 1:
            middle = (near + far) // 2
            closer = shifted(middle)
            near, far, layout = (near, middle, closer) if closer is not None else (middle, far, layout)
        shifts.append(start + far * NEST_STEP * direction)
    return layout


def _placed(blanks: Sequence[Blank], shifts: Sequence[Array], spec: MoldSpec) -> Layout | None:
    """Plate with the blanks moved by `shifts` (m); None if they meet or do not fit."""
    size, origin = _plate(blanks, shifts, spec)
    if not _inside(blanks, shifts, origin, size, spec):
        return None
    curves = []
    for blank, shift in zip(blanks, shifts, strict=True):
        x, y = shift - origin
        curves.append(leads_to_edge([piece.moved((float(x), float(y))) for piece in blank.bend], size))
    if any(crosses_itself(c, b.width + spec.groove.wall) for c, b in zip(curves, blanks, strict=True)):
        return None
    wall = math.inf
    for (first, a), (second, b) in combinations(zip(curves, blanks, strict=True), 2):
        wall = min(wall, min_distance(first, second) - (a.width + b.width) / 2)
        if wall < spec.groove.wall - SLACK:
            return None
    return Layout(size, tuple(curves), wall)


def _plate(blanks: Sequence[Blank], shifts: Sequence[Array], spec: MoldSpec) -> tuple[Point, Array]:
    """Size of the plate, and its lower left corner in the frame of the shifts, m."""
    low, high = _extent(blanks, shifts)
    more = np.array([0.0, spec.upper_margin - spec.plate.margin])
    if spec.plate.size is not None:
        size = spec.plate.size
    else:
        width, height = (math.ceil((x + 2 * spec.plate.margin) / PLATE_STEP - 1e-9) for x in high - low + more)
        size = (round(width * PLATE_STEP, 9), round(height * PLATE_STEP, 9))
    return size, (low + high + more) / 2 - np.array(size) / 2


def _extent(blanks: Sequence[Blank], shifts: Sequence[Array]) -> tuple[Array, Array]:
    """Corners of the bounding box of the cores, with the widths of their grooves, m."""
    moved = list(zip(blanks, shifts, strict=True))
    low = np.min([blank.boxes[1][0] - blank.width / 2 + shift for blank, shift in moved], axis=0)
    high = np.max([blank.boxes[1][1] + blank.width / 2 + shift for blank, shift in moved], axis=0)
    return np.asarray(low), np.asarray(high)


def _inside(blanks: Sequence[Blank], shifts: Sequence[Array], origin: Array, size: Point, spec: MoldSpec) -> bool:
    """True if every bend has a wall to the edge, and the ends of the shortest leads lie on the plate."""
    for blank, shift in zip(blanks, shifts, strict=True):
        rim = blank.width / 2 + spec.groove.wall
        for box, distance in zip(blank.boxes, (rim, 0.0), strict=True):
            low, high = box + shift - origin
            if (low < distance - SLACK).any() or (high > np.array(size) - distance + SLACK).any():
                return False
    return True


def _no_arrangement(blanks: Sequence[Blank], spec: MoldSpec) -> InputError:
    """Error for grooves without an arrangement: one does not fit by itself, or they cross each other."""
    unmoved = [np.zeros(2)]
    plate = "" if spec.plate.size is None else " of {:g} x {:g} mm".format(*(x * 1e3 for x in spec.plate.size))
    for blank in blanks:
        if _placed([blank], unmoved, spec) is not None:
            continue
        size, origin = _plate([blank], unmoved, spec)
        if _inside([blank], unmoved, origin, size, spec):
            return _crossing(blank)
        low, high = _extent([blank], unmoved)
        width, height = (high - low) * 1e3
        return InputError(
            f"the groove of tube {blank.number} does not fit on the plate{plate}: bend and "
            f"leads need {width:.1f} x {height:.1f} mm, plus a wall of "
            f"{spec.groove.wall * 1e3:g} mm"
        )
    numbers = ", ".join(str(blank.number) for blank in blanks)
    return InputError(
        f"the grooves of tubes {numbers} cross on a plate{plate} in every arrangement; they "
        f"need {spec.groove.wall * 1e3:g} mm between them: use a larger plate or one plate "
        "per tube"
    )


def _crossing(blank: Blank) -> InputError:
    """Error for a groove that crosses itself."""
    turn = math.degrees(blank.bend_angle)
    return InputError(
        f"the groove of tube {blank.number} crosses itself: it bends by {turn:.1f} deg, with "
        f"leads of at least {blank.min_lead * 1e3:.1f} mm; shorten the curved part or the "
        "leads, or use two molds"
    )


# --- holes ------------------------------------------------------------------------------------------------------------


MIN_BOLTS = 4

# Not point symmetric, so that the lid fits in one orientation only.
DOWEL_TARGETS = ((0.22, 0.0), (0.65, 1.0))
"""Target positions of the dowels, as fractions of width and height."""

SLOT_SHARE = 0.4
"""Largest length of a slot to each side, as a fraction of the bend."""

VENT_BRIDGE = 0.5e-3
"""Smallest material between vents, m."""


@dataclass(frozen=True)
class Hole:
    """Round hole through a plate, for a "bolt", "dowel", "vent", "wire", "hinge" or "latch"."""

    purpose: Annotated[str, "purpose of the hole"]
    centre: Annotated[Point, unit("mm"), "centre of the hole"]
    diameter: Annotated[float, unit("mm"), "diameter of the hole"]


class _Target(NamedTuple):
    """Target of a hole."""

    purpose: str
    diameter: float
    """Diameter of the hole, m."""
    centre: Point
    """Target position, m."""
    max_distance: float
    """Largest distance of the hole from its target, m; without a free position so near, it is left out."""


def place_fasteners(
    size: Point, curves: Sequence[Centreline], widths: Sequence[float], spec: MoldSpec
) -> tuple[Hole, ...]:
    """Place bolts in the corners and along the edges, and two dowels between them, clear of grooves and each other.

    Each hole is at the free position next to its target, in the order corners, dowels, edges.

    Raises:
        InputError: too few bolts or dowels fit.
    """
    plate, wall = spec.plate, spec.groove.wall
    inset = max(plate.bolt_diameter, plate.dowel_diameter) / 2 + wall
    rim = _rim(size, inset, FASTENER_STEP)
    ends = [(inset, extent - inset) for extent in size]
    targets = [_Target("bolt", plate.bolt_diameter, (x, y), math.inf) for x in ends[0] for y in ends[1]]
    for x, y in DOWEL_TARGETS:
        centre = size[0] * x, inset + y * (size[1] - 2 * inset)
        targets.append(_Target("dowel", plate.dowel_diameter, centre, math.inf))
    for axis in (0, 1):  # bolts between the corners: along the lower and upper edge, then along the left and right one
        count = math.ceil((size[axis] - 2 * inset) / plate.bolt_pitch) - 1
        for across in ends[1 - axis]:
            for along in np.linspace(*ends[axis], count + 2)[1:-1].tolist():
                centre = (along, across) if axis == 0 else (across, along)
                targets.append(_Target("bolt", plate.bolt_diameter, centre, plate.bolt_pitch / 3))
    holes: list[Hole] = []
    for purpose, diameter, centre, max_distance in targets:
        free = np.ones(len(rim), dtype=bool)
        for curve, width in zip(curves, widths, strict=True):
            free &= curve.distance(rim) >= (width + diameter) / 2 + wall
        for hole in holes:
            free &= np.linalg.norm(rim - hole.centre, axis=1) >= (hole.diameter + diameter) / 2 + wall
        distance = np.where(free, np.linalg.norm(rim - np.asarray(centre), axis=1), np.inf)
        nearest = int(distance.argmin())
        if distance[nearest] < max_distance:
            holes.append(Hole(purpose, (float(rim[nearest, 0]), float(rim[nearest, 1])), diameter))
    bolts, dowels = (sum(hole.purpose == purpose for hole in holes) for purpose in ("bolt", "dowel"))
    if bolts < MIN_BOLTS or dowels < 2:
        raise InputError(
            f"the plate of {size[0] * 1e3:g} x {size[1] * 1e3:g} mm fits {bolts} bolts and "
            f"{dowels} dowels next to the grooves; it needs {MIN_BOLTS} and 2: use a "
            "larger plate or smaller holes"
        )
    return tuple(holes)


@dataclass(frozen=True)
class Hinge:
    """Hinges along the upper edge of a lid, and its latches."""

    pin: float
    """Height of the pin's axis above the plate's lower edge, m; it is over the upper face of the lid."""
    on_lid: tuple[Hole, ...]
    """Screws of the leaves on the lid."""
    on_strip: tuple[Hole, ...]
    """Screws of the leaves on the strip, through the lower plate as well."""
    latches: tuple[Hole, ...]
    """Bolts of the latches in the lower plate."""
    openings: tuple[Hole, ...]
    """Holes of the lid around them."""

    @property
    def base_holes(self) -> tuple[Hole, ...]:
        """Holes of the lower plate."""
        return (*self.on_strip, *self.latches)

    @property
    def lid_holes(self) -> tuple[Hole, ...]:
        """Holes of lid and strip."""
        return (*self.on_lid, *self.on_strip, *self.openings)


HINGES = 0.2, 0.8
"""Middles of the hinges, as fractions of the lid's width."""

LATCHES = 0.12, 0.88
"""Targets of the latches, likewise."""


NUT, PIN_ABOVE_LID = 1.6, 1e-3
"""Width of a nut over the hole of its bolt, and height of a hinge's pin above the lid, m."""


def place_hinge(size: Point, curves: Sequence[Centreline], widths: Sequence[float], spec: MoldSpec) -> Hinge:
    """Hinges of a lid, and a latch near either lower corner, clear of grooves and of each other.

    Raises:
        InputError: a groove is too near to the screws or leaves the plate by its upper edge, or the plate is too small.
    """
    hinge, wall, bolt = spec.hinge, spec.groove.wall, spec.plate.bolt_diameter
    pin = size[1] - spec.behind
    half = 0.5 * hinge.screw_distance
    places = [size[0] * part + side for part in HINGES for side in (-half, half)]
    on_lid, on_strip = (
        tuple(Hole("hinge", (x, pin + side * hinge.reach), hinge.screw_diameter) for x in places) for side in (-1, 1)
    )
    # On the lid countersunk from below, on the strip nothing may be under it.
    heads = [(np.array([hole.centre for hole in on_lid]), hinge.screw_diameter)]
    heads.append((np.column_stack([np.linspace(0.0, size[0], 200), np.full(200, pin - spec.gap / 2)]), 0.0))
    close = any(
        (curve.distance(points) < width / 2 + radius + wall - SLACK).any()
        for curve, width in zip(curves, widths, strict=True)
        for points, radius in heads
    )
    if close or places[2] - places[1] < 2 * hinge.screw_diameter + wall:
        raise InputError(
            f"the plate of {size[0] * 1e3:g} x {size[1] * 1e3:g} mm has no room for hinges along its upper edge; they "
            f"need {spec.upper_margin * 1e3:.3g} mm between it and the grooves: use a larger plate, or a bolted lid"
        )
    # The lower edge of an opening, L before the pin and h below it, swings out to hypot(L, h): it must clear the nut.
    room, below = hinge.latch_diameter / 2 - NUT / 2 * bolt, spec.plate.lid_thickness + PIN_ABOVE_LID
    before_pin = max(0.0, (below**2 - room**2) / (2 * max(room, SLACK)))
    inset = hinge.latch_diameter / 2 + wall
    rim = _rim(size, inset, FASTENER_STEP)
    free = (rim[:, 1] < 0.5 * size[1]) & (rim[:, 1] + hinge.latch_diameter / 2 + before_pin <= pin)
    for curve, width in zip(curves, widths, strict=True):
        free &= curve.distance(rim) >= (width + hinge.latch_diameter) / 2 + wall
    centres: list[Point] = []
    for part in LATCHES:
        for centre in centres:
            free &= np.linalg.norm(rim - centre, axis=1) >= hinge.latch_diameter + wall
        distance = np.where(free, np.linalg.norm(rim - np.array([part * size[0], inset]), axis=1), np.inf)
        nearest = int(distance.argmin())
        if not np.isfinite(distance[nearest]):
            raise InputError(
                f"the plate of {size[0] * 1e3:g} x {size[1] * 1e3:g} mm has no room for two latches of "
                f"{hinge.latch_diameter * 1e3:g} mm in its lower half: use a larger plate, or a bolted lid"
            )
        centres.append((float(rim[nearest, 0]), float(rim[nearest, 1])))
    latches, openings = (tuple(Hole("latch", c, d) for c in centres) for d in (bolt, hinge.latch_diameter))
    return Hinge(pin, on_lid, on_strip, latches, openings)


def place_vents(curve: Centreline, width: float, vents: VentSpec) -> tuple[Hole, ...]:
    """Place vents of one size along the bend, with a density that follows the profile of the open fraction.

    Raises:
        InputError: the profile needs vents that are too near to each other.
    """
    cells = np.linspace(0.0, curve.bend_length, len(vents.profile) + 1)
    area = np.concatenate([[0.0], np.cumsum(np.asarray(vents.profile) * width * np.diff(cells))])
    count = math.floor(area[-1] / open_area(width, vents.diameter) + 0.5)
    if count == 0:
        return ()
    # Vents stand at equal steps of the open area up to there, not of the arc length.
    s = np.interp((np.arange(count) + 0.5) / count * area[-1], area, cells)
    pitch = float(np.diff(s).min()) if count > 1 else math.inf
    if pitch < vents.diameter + VENT_BRIDGE - 1e-12:
        raise InputError(
            f"the profile of the vents needs {vents.diameter * 1e3:g} mm holes every "
            f"{pitch * 1e3:.3g} mm; the distance must be at least "
            f"{(vents.diameter + VENT_BRIDGE) * 1e3:.3g} mm: use a smaller open fraction or "
            "larger vents"
        )
    return tuple(Hole("vent", (float(x), float(y)), vents.diameter) for x, y in curve.bend_point(s))


@dataclass(frozen=True)
class Slot:
    """Slot in the lower face of the lid, over the groove, for a thermocouple; it ends in holes."""

    centreline: Centreline
    """Centreline as seen from above; leads have no length."""
    mill: EndMill
    """End mill as wide as the slot."""
    depth: float
    """Depth from the lower face of the lid, m."""
    exits: tuple[Hole, ...]
    """Own holes at its ends; the others are vents."""


SLOT_PLAY = 0.15e-3
"""Extra width and depth of a slot over its wire, m: insulation and cement."""


def place_slot(curve: Centreline, vents: Sequence[Hole], spec: MoldSpec) -> Slot | None:
    """Slot about the middle of a bend; None if the specification has none, or no end mill is narrow enough.

    It ends in the vents nearest to its anchor length, or in holes of its own where they meet no vent.
    """
    slot = spec.slot
    mill = next((m for m in spec.milling.end_mills if m.diameter >= slot.wire + SLOT_PLAY - 1e-9), None)
    if slot.wire == 0 or mill is None or mill.diameter > 2 * slot.wire + 2 * SLOT_PLAY:
        return None
    middle, grid = curve.bend_length / 2, spaced(curve.bend_length, 2e-4)
    points = curve.bend_point(grid)
    at_vents = [float(grid[np.linalg.norm(points - vent.centre, axis=1).argmin()]) for vent in vents]
    ends, exits = [], []
    for side in (-1.0, 1.0):
        end = middle + side * min(slot.anchor, SLOT_SHARE * curve.bend_length)
        nearest = min(at_vents, key=lambda s, end=end: abs(s - end), default=math.inf)  # type: ignore[misc]
        meets = (spec.vents.diameter + slot.exit_diameter) / 2 + VENT_BRIDGE
        if abs(nearest - end) < meets:
            end = nearest
        else:
            ((x, y),) = curve.bend_point(np.array([end]))
            exits.append(Hole("wire", (float(x), float(y)), slot.exit_diameter))
        ends.append(end)
    bend = between(curve.bend, ends[0], ends[1])
    return Slot(with_leads(bend, 0.0, 0.0), mill, slot.wire + SLOT_PLAY, tuple(exits))


def open_area(width: float, diameter: float) -> float:
    """Area (m^2) of a groove below a hole: the part of the hole's circle between the walls."""
    radius, half = diameter / 2, min(width, diameter) / 2
    return 2 * (half * math.sqrt(radius**2 - half**2) + radius**2 * math.asin(half / radius))


def _rim(size: Point, inset: float, step: float) -> Array:
    """(N, 2) candidate centres of holes, `step` (m) apart on a rectangle `inset` (m) from the edge."""
    (x0, y0), (x1, y1) = (inset, inset), (size[0] - inset, size[1] - inset)
    if x1 <= x0 or y1 <= y0:
        raise InputError(
            f"the plate is {size[0] * 1e3:g} x {size[1] * 1e3:g} mm; it is too small for "
            f"bolts {inset * 1e3:g} mm from its edges"
        )
    across, up = np.arange(x0, x1 + step / 2, step), np.arange(y0, y1 + step / 2, step)
    sides = [[(x, y) for x in across] for y in (y0, y1)] + [[(x, y) for y in up] for x in (x0, x1)]
    return np.array([point for side in sides for point in side])
