"""Mandrels for tubes that are space curves: a turned cylinder with a helical groove, or a printed block (SI).

The curvature springs back as in a plate; torsion and natural twist are unchanged. The groove has a round bottom, as
wide as tube and clearance, and its centreline is the curve. Tangent leads run out of the solid at both ends.
"""

from __future__ import annotations

import io
import math
import re
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import scipy

from ...block.transcription.tableau import tableau
from ...display import Displayed
from ...errors import InputError, SolveError, instance
from ...files.csv_file import to_csv
from ...files.field_metadata import form, key, unit
from ...files.units import TO_MM
from ...physics.shape import GAUSS_POINTS, carry_function
from ...robots.pieces import breaks_of, values, vary
from ...robots.tubes import Tube
from ...typing import Array, StatusEnum
from ..materials import mold_remarks
from .checks import (
    Check,
    as_held,
    choose_mill,
    material_remarks,
    refuse_failed,
    springback_remarks,
    stiffness_remarks,
    strain_check,
)
from .files import Part, manifold, trimesh, write_parts
from .gcode import Stage, check_duration, milled, pass_depths
from .groove import SAGITTA, distance_to_edge, meets_itself, turn_distance
from .spec import MoldSpec
from .springback import Springback, bend_direction, tube_from_mold

# Facets of 5 deg leave the walls of a groove flat to a thousandth of its radius; half the angle doubles the solid.
CHORD_TURN = math.radians(5.0)
"""Largest angle between neighbouring segments of a groove in space, rad."""

# Spread evenly over the sphere, 200 directions are sqrt(4 pi / 200), 14 deg, apart, so that one is within 10 deg of the
# best. There a block is higher by less than 1 / cos(10 deg), 2 %.
BLOCK_SIDES = 200
"""Number of candidate directions for the open side of a block."""

# Walls rise along the open side. On a slope of 53 deg they meet the bottom at 37 deg: on steeper ones the edge is too
# thin to be printed.
BLOCK_SLOPE = 0.8
"""Largest slope of a groove towards the open side of its block, as a sine."""

SHANK = 25e-3
"""Length of a turned mandrel in the chuck, m."""

# A brush, and a strip that presses the tube to the floor, need some mm. Turns that pass near each other allow less.
SLOTS = (6e-3, 4e-3, 3e-3, 2e-3)
"""Widths (m) of the slot above the groove of a printed block, the preferred one first."""


@dataclass(frozen=True, eq=False)
class Winding:
    """Centreline of a groove in space."""

    arc_length: Array
    """(N,) arc lengths, m; 0 at the start of the bend."""
    points: Array
    """(N, 3) points on the centreline, m."""
    tangents: Array
    """(N, 3) unit tangents."""
    bend: slice
    """Indices of the points of the bend; all others belong to the leads."""

    def moved(self, rotation: Array, shift: Array) -> Winding:
        """Curve rotated by a matrix (3, 3), then moved by `shift` (3,), m."""
        return Winding(self.arc_length, self.points @ rotation.T + shift, self.tangents @ rotation.T, self.bend)

    def lengthened(self, extra: float, step: float = 1e-3) -> Winding:
        """Curve with both leads `extra` (m) longer, in points about `step` (m) apart."""
        s = self.arc_length
        return self.with_leads(extra - s[0], extra + s[-1] - s[self.bend][-1], step)

    def with_leads(self, before: float, after: float, step: float = 1e-3) -> Winding:
        """Bend with straight tangent leads of lengths `before` and `after` (m) instead of its own."""
        s, p, t = (field[self.bend] for field in (self.arc_length, self.points, self.tangents))
        counts = [max(2, math.ceil(length / step)) for length in (before, after)]
        lead_in, lead_out = np.linspace(-before, 0.0, counts[0])[:-1], np.linspace(0.0, after, counts[1])[1:]
        return Winding(
            np.concatenate([s[0] + lead_in, s, s[-1] + lead_out]),
            np.vstack([p[0] + lead_in[:, None] * t[0], p, p[-1] + lead_out[:, None] * t[-1]]),
            np.vstack([np.tile(t[0], (len(lead_in), 1)), t, np.tile(t[-1], (len(lead_out), 1))]),
            slice(len(lead_in), len(lead_in) + len(s)),
        )


def helix_of(held: Tube) -> tuple[float, float] | None:
    """Curvature and torsion (1/m) of a curved part that is one helix with constant precurvature; None for others."""
    if any(vary(piece.precurvature) for piece in held.chain):
        return None
    u = np.array([piece.precurvature for piece in held.chain])
    if np.abs(u - u[0]).max() > 1e-12 * np.abs(u[0]).max():
        return None
    curvature, torsion = float(np.hypot(u[0, 0], u[0, 1])), float(u[0, 2])
    return (curvature, torsion) if curvature > 0 and torsion != 0 else None


def bend_in_space(held: Tube) -> Winding:
    """Bend that starts at the origin along z, by the integrator of arms in frames without the tube's own twist."""
    s, turn, poses = np.zeros(1), 0.0, np.append(np.eye(3).ravel(), np.zeros(3))[:, None]
    curvature, rule = max(held.curvature, 1.0), tableau("gauss", len(GAUSS_POINTS))
    # An arc of length c rises by kappa c^2 / 8 over its chord.
    step = min(math.sqrt(8 * SAGITTA / curvature), CHORD_TURN / curvature, 1e-3)
    for piece in held.chain:
        breaks = breaks_of(piece.precurvature, piece.length)
        for low, high in pairwise(breaks):
            count = max(1, math.ceil((high - low) / step))
            h = (high - low) / count
            points = low + h * (np.arange(count)[:, None] + GAUSS_POINTS)
            x, y, z = (values(q, points.ravel()).reshape(points.shape) for q in piece.precurvature)
            before = turn + h * np.append(0.0, np.cumsum(z @ rule.weights))
            angle = before[:-1, None] + h * z @ rule.matrix.T
            bend = np.stack([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)], axis=2)
            carried = carry_function().mapaccum(count)(poses[:, -1], bend.reshape(count, -1).T, np.full(count, h)[None])
            turn, poses = float(before[-1]), np.hstack([poses, carried.full()])
            s = np.append(s, s[-1] + h * np.arange(1, count + 1))
    return Winding(s, poses[9:].T, poses[6:9].T, slice(0, len(s)))


@dataclass(frozen=True)
class Cylinder:
    """Turned cylinder along x, with a helical groove."""

    radius: float
    """Radius of the cylinder, m."""
    length: float
    """Length with the part in the chuck, m."""
    helix_radius: float
    """Radius of the groove's centreline, m."""
    advance: float
    """Advance of the helix per rad, m; negative: left-handed."""

    @property
    def pitch(self) -> float:
        """Advance of the helix per turn, m."""
        return 2 * math.pi * abs(self.advance)

    @property
    def handed(self) -> str:
        """Hand of the helix, "left" or "right"."""
        return "left" if self.advance < 0 else "right"


@dataclass(frozen=True)
class Block:
    """Printed block with a groove that is open above."""

    size: tuple[float, float, float]
    """Lengths along x, y and z, m."""
    slot: float
    """Width of the slot above the groove, m: its walls rise at 45 deg from the top of the tube, then upright."""


@dataclass(frozen=True)
class Exit:
    """Place where a straight end of the tube leaves a printed block."""

    point: Array
    """Centreline there (3,), m."""
    upper: bool
    """True if it leaves through the upper face, where a flat lid has an opening."""
    notch: Array | None
    """Ends (2, 2) of the opening from above, m: it runs to the edge of the block. None without one."""


class MandrelStatus(StatusEnum):
    """Status of a planned mandrel; every value reads as a sentence."""

    TURNED = "the mandrel is turned, and passes all checks"
    PRINTED = "the mandrel is a block to be printed, and passes all checks"


@dataclass(frozen=True)
class MandrelStatistics:
    """Numbers of checks and remarks."""

    checks: int
    remarks: int


@dataclass(frozen=True, eq=False)
class Mandrel(Displayed):
    """A mandrel for one tube."""

    number: Annotated[int, key("tube"), "number of the tube, 1 for the innermost"]
    tube: Tube
    """Tube after shape-setting and trimming."""
    held: Tube
    """Tube as the mandrel holds it."""
    spec: MoldSpec
    """Specification of the mandrel."""
    body: Cylinder | Block
    """Solid that is turned or printed."""
    winding: Winding
    """Centreline of the groove in it, leads included."""
    width: Annotated[float, unit("mm"), form(".4g", label="groove, width"), "width of the groove"]
    """Also the diameter of its round bottom."""
    checks: tuple[Check, ...]
    """Checks with numbers and limits."""
    remarks: Annotated[tuple[str, ...], "remarks for making and using it"]

    @property
    def value(self) -> Winding:
        """Centreline of its groove."""
        return self.winding

    @property
    def status(self) -> MandrelStatus:
        """Status with the kind of mandrel: turned or printed."""
        return MandrelStatus.TURNED if isinstance(self.body, Cylinder) else MandrelStatus.PRINTED

    @property
    def statistics(self) -> MandrelStatistics:
        """Numbers of checks and remarks."""
        return MandrelStatistics(len(self.checks), len(self.remarks))

    @property
    def stock_length(self) -> float:
        """Length of straight tube to cut, m."""
        before, after = self.tube_leads
        return before + self.held.curved_length + after

    @property
    def tube_leads(self) -> tuple[float, float]:
        """Lengths (m) of straight tube before and after the bend: in the groove, and as much more as clamps grip."""
        s, grip = self.winding.arc_length, self.spec.clamps.grip
        before, after = grip - s[0], s[-1] - s[self.winding.bend][-1] + grip
        return max(float(before), self.tube.straight_length), float(after)

    @property
    def envelope(self) -> tuple[Array, Array]:
        """Smallest and largest coordinates (3,) of body and tube with its straight ends, m."""
        points, radius = self.winding.with_leads(*self.tube_leads).points, self.tube.outer_diameter / 2
        body, low, high = self.body, points.min(axis=0) - radius, points.max(axis=0) + radius
        if isinstance(body, Block):
            return np.minimum(low, 0.0), np.maximum(high, body.size)
        ends = np.array([(0.0, -body.radius, -body.radius), (body.length, body.radius, body.radius)])
        return np.minimum(low, ends[0]), np.maximum(high, ends[1])


def plan_mandrel(tube: Tube, mold: MoldSpec | None = None, *, number: int = 1) -> Mandrel:
    """Mandrel for a tube that is a space curve: turned for a helix with space for a core, otherwise printed.

    Args:
        tube: a tube made of pieces; planar tubes take a plate (`plan_mold`).
        mold: material, fit and tools, as for `plan_mold`; of the plate, only margin and wall are used.
        number: number of the tube in texts.

    Raises:
        InputError: the tube is planar or strained too far, no mandrel yields its curvature, turns of the groove
            overlap, or no side of a block gives access to the whole groove.
    """
    spec = MoldSpec() if mold is None else mold
    instance("tube", tube, Tube)
    if bend_direction(tube) is not None:
        raise InputError(f"tube {number} is planar; use a plate, not a mandrel")
    held = as_held(number, tube, spec)
    process = "wound into the groove"
    checks = [strain_check(number, held, spec, process, f"when it is {process}", "set it in steps")]
    refuse_failed(checks)
    helix = helix_of(held)
    width = tube.outer_diameter + spec.groove.clearance
    # A core remains if the bottom of the groove is at least the floor of a plate from the axis.
    turned = helix is not None and helix[0] / (helix[0] ** 2 + helix[1] ** 2) >= width / 2 + spec.groove.floor
    tool_remarks: list[str] = []
    body: Cylinder | Block
    if helix is not None and turned:
        mill, width = choose_mill(number, tube, spec)
        if abs(mill.diameter - width) > 1e-9:
            tool_remarks.append(
                f"none of the end mills at hand is {width * 1e3:g} mm wide; the groove takes a tool ground so"
            )
        body, winding = _cylinder(held, helix, width, spec)
        checks += _wall_checks(number, held, helix, body, width, spec)
    else:
        # The middle of the limits: a print shrinks, and deviates to both sides.
        width = tube.outer_diameter + 0.5 * (spec.groove.clearance + spec.groove.most_clearance)
        body, winding = _block(number, held, spec.clamps.least_lead, width, spec)
        wall = slot_wall(body, winding)
        if wall < spec.groove.wall:
            tool_remarks.append(f"the wall between turns of the slot is {wall * 1e3:.2f} mm thick where it is thinnest")
    refuse_failed(checks)
    return Mandrel(
        number=number,
        tube=tube,
        held=held,
        spec=spec,
        body=body,
        winding=winding,
        width=width,
        checks=tuple(checks),
        remarks=(*_remarks(tube, spec, turned), *tool_remarks, *material_remarks(spec)),
    )


def exits_of(mandrel: Mandrel) -> tuple[Exit, Exit]:
    """Places where both ends of the tube leave the block of a printed mandrel."""
    assert isinstance(mandrel.body, Block)
    size, fine = np.array(mandrel.body.size), mandrel.winding.lengthened(mandrel.body.size[2], FINE)
    found = []
    for way in (fine.points[fine.bend.start :: -1], fine.points[fine.bend.stop - 1 :]):
        beside = ((way[:, :2] < 0) | (way[:, :2] > size[:2])).any(axis=1)
        edge, above = int(np.argmax(beside)), way[:, 2] > size[2]
        upper = bool(above[:edge].any())
        # The upper side of the tube is as far above its centreline as the groove's walls are steep.
        rise = abs(way[1, 2] - way[0, 2]) / float(np.linalg.norm(way[1] - way[0]))
        lifted = way[:, 2] + 0.5 * mandrel.tube.outer_diameter / math.sqrt(1 - rise**2) > size[2]
        notch = way[[int(np.argmax(lifted)), edge], :2] if lifted[:edge].any() else None
        found.append(Exit(way[int(np.argmax(above)) if upper else edge], upper, notch))
    return found[0], found[1]


def slot_wall(body: Block, winding: Winding) -> float:
    """Least thickness (m) of the walls between turns of the slot of a printed block; inf for a single turn."""
    # An end that rises out may pass above other turns.
    inside = winding.points[:, 2] <= body.size[2]
    points, tangents = winding.points[inside], winding.tangents[inside]
    return turn_distance(points[:, :2], np.unwrap(np.arctan2(tangents[:, 1], tangents[:, 0]))) - body.slot


def deepest_point(mandrel: Mandrel) -> Array:
    """Point (3,) of the bend that is deepest in a printed block, m."""
    points = mandrel.winding.points[mandrel.winding.bend]
    return np.asarray(points[int(points[:, 2].argmin())])


def slot_depths(mandrel: Mandrel) -> tuple[float, float]:
    """Least depth (m) of the groove's floor in the bend below the upper face of a printed block, and the greatest."""
    assert isinstance(mandrel.body, Block)
    w = mandrel.winding
    slope = np.sqrt(1 - w.tangents[:, 2] ** 2)
    depth = mandrel.body.size[2] - w.points[:, 2] + 0.5 * mandrel.width / slope
    return float(depth[w.bend].min()), float(depth.max())


def predict_wound_tube(mandrel: Mandrel, *, springback: Springback | None = None) -> Tube:
    """Tube that a mandrel produces after spring-back: the inverse of `plan_mandrel`.

    Args:
        springback: spring-back model; by default that of the mandrel.
    """
    instance("mandrel", mandrel, Mandrel)
    return tube_from_mold(mandrel.held, springback or mandrel.spec.springback)


def _cylinder(held: Tube, helix: tuple[float, float], width: float, spec: MoldSpec) -> tuple[Cylinder, Winding]:
    """Cylinder with the helix about x from angle 0, and tangent leads until they are outside it."""
    curvature, torsion = helix
    size = curvature**2 + torsion**2
    # Helix of curvature k and torsion t: radius k / (k^2 + t^2), advance per rad t / (k^2 + t^2), and sqrt(k^2 + t^2)
    # rad per arc length.
    radius, advance, turn_rate = curvature / size, torsion / size, math.sqrt(size)
    # A straight lead ends at the radius at which the bottom of its groove is at the surface.
    lead = math.sqrt((radius + width) ** 2 - radius**2) / (radius * turn_rate)
    axial = abs(advance) * turn_rate  # advance per arc length
    first = SHANK + spec.plate.margin + lead * axial
    length = first + (held.curved_length + lead) * axial + spec.plate.margin
    count = math.ceil(held.curved_length * turn_rate / math.radians(2.0)) + 1
    s = np.linspace(0.0, held.curved_length, count)
    side = math.copysign(1.0, advance)
    angle = side * s * turn_rate
    points = np.column_stack([first + axial * s, radius * np.cos(angle), radius * np.sin(angle)])
    around = side * radius * turn_rate
    tangents = np.column_stack([np.full(count, axial), -around * np.sin(angle), around * np.cos(angle)])
    bend = Winding(s, points, tangents, slice(0, count))
    return Cylinder(radius + width / 2, length, radius, advance), bend.with_leads(lead, lead)


def _wall_checks(
    number: int, held: Tube, helix: tuple[float, float], body: Cylinder, width: float, spec: MoldSpec
) -> list[Check]:
    """Check of the wall between turns of the groove; none for a single turn."""
    turn_rate = math.hypot(*helix)
    if held.curved_length * turn_rate <= 2 * math.pi:
        return []
    # The pitch along the axis, times the cosine of the slope, is the distance perpendicular to the groove.
    wall = body.pitch * body.helix_radius * turn_rate - width
    failure = (
        f"the turns of the groove of tube {number} leave {wall * 1e3:.4g} mm of wall between them; it must be at least "
        f"{spec.groove.wall * 1e3:.4g} mm: set fewer turns at a time"
    )
    return [
        Check(
            name=f"tube {number}: wall between turns of the groove",
            value=wall,
            limit=spec.groove.wall,
            unit="m",
            at_most=False,
            failure=failure,
        )
    ]


def _block(number: int, held: Tube, lead: float, width: float, spec: MoldSpec) -> tuple[Block, Winding]:
    """Smallest block with the widest slot, over the open sides that make the whole groove accessible.

    The height under the tube's straight ends counts, too.
    """
    ends = max(held.straight_length, lead + spec.clamps.grip), lead + spec.clamps.grip

    def space(block: tuple[Block, Winding]) -> float:
        body, winding = block
        beneath = min(0.0, float(winding.with_leads(*ends).points[:, 2].min()))
        return body.size[0] * body.size[1] * (body.size[2] - beneath)

    bend = bend_in_space(held).with_leads(lead, lead)
    flat = [up for up in _sides(bend.points, BLOCK_SIDES) if np.abs(bend.tangents @ up).max() <= BLOCK_SLOPE]
    # Without room for a wider one the slot is as wide as the groove.
    for slot in (*(each for each in SLOTS if each > width), width):
        # A wall stays between a slot and the groove beside it, and no slot cuts its own inner wall.
        apart = max(slot, (slot + width) / 2 + spec.groove.wall)
        blocks = [_block_below(bend, up, lead, (width, slot), spec) for up in flat if not _overlaps(bend, up, apart)]
        # Leads are longer than those of the bend alone: to the sides of the block.
        blocks = [(body, winding) for body, winding in blocks if slot_wall(body, winding) >= apart - slot]
        if blocks:
            return min(blocks, key=space)
    raise InputError(
        f"the groove of tube {number} is not accessible from any side of a block. Use a "
        f"helix of at least {(width / 2 + spec.groove.floor) * 1e3:.3g} mm radius on a "
        "turned mandrel, or a curve without overlap in one view"
    )


def _block_below(
    bend: Winding, up: Array, lead: float, widths: tuple[float, float], spec: MoldSpec
) -> tuple[Block, Winding]:
    """Smallest block with its open side along `up`, and the groove in it; widths of groove and slot, m."""
    width, slot = widths
    chord = bend.points[-1] - bend.points[0]
    x = chord - (chord @ up) * up
    x = x / np.linalg.norm(x)
    turned = bend.moved(np.vstack([x, np.cross(up, x), up]), np.zeros(3))
    rim = slot / 2 + spec.groove.wall
    # The leads end at the sides of the block, clear of its corners.
    low, high = turned.points.min(axis=0), turned.points.max(axis=0)
    inner = turned.points[turned.bend]
    low[0], high[0] = min(low[0], inner[:, 0].min() - rim), max(high[0], inner[:, 0].max() + rim)
    low[1], high[1] = low[1] - rim, high[1] + rim
    sides = tuple(high[:2] - low[:2])
    extra = []
    for k, sign in ((0, -1), (-1, 1)):
        end, outward = turned.points[k, :2] - low[:2], sign * turned.tangents[k, :2]
        extra.append(max(distance_to_edge(end, outward, sides), 0.0))
    winding = turned.with_leads(lead + extra[0], lead + extra[1])
    # A lead that falls towards its side leaves a floor, too.
    low[2] = winding.points[:, 2].min() - width / 2 - spec.groove.floor
    high[2] += width / 2
    size, winding = high - low, winding.moved(np.eye(3), -low)
    return Block((float(size[0]), float(size[1]), float(size[2])), slot), winding


def _sides(points: Array, count: int) -> Array:
    """(N, 3) unit vectors: the principal axes of the points, then `count` spread evenly over the sphere (Fibonacci)."""
    # Seen along its axis of smallest extent a curve is flattest: the most probable side comes first.
    axes = np.linalg.svd(points - points.mean(axis=0))[2][::-1]
    k = np.arange(count) + 0.5
    z, angle = 1 - 2 * k / count, math.pi * (1 + math.sqrt(5)) * k
    ring = np.sqrt(1 - z**2)
    return np.vstack([axes, -axes, np.column_stack([ring * np.cos(angle), ring * np.sin(angle), z])])


def _overlaps(curve: Winding, up: Array, width: float) -> bool:
    """True if a band of `width` (m), seen along `up`, overlaps itself or bends tighter than half its width."""
    first = np.cross(up, [1.0, 0.0, 0.0] if abs(up[0]) < 0.9 else [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    plane = np.column_stack([first, np.cross(up, first)])
    points, tangents = curve.points @ plane, curve.tangents @ plane
    heading = np.unwrap(np.arctan2(tangents[:, 1], tangents[:, 0]))
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    # A bend tighter than half the width would cut its own inner wall.
    too_tight = (np.abs(np.diff(heading)) > 2 * steps / width).any()
    return bool(too_tight) or meets_itself(points, heading, width)


def _remarks(tube: Tube, spec: MoldSpec, turned: bool) -> list[str]:
    """Remarks on spring-back, making the mandrel, and materials."""
    remarks = [
        "the natural twist and torsion are as given: trials of planar bends say nothing about their spring-back",
        *springback_remarks(spec),
    ]
    if turned:
        remarks.append(
            "cut with a ball-nose end mill. A is the rotation of the tool about the work. Reverse its sign if your "
            "machine uses the rotation of the chuck; otherwise the helix has the opposite hand"
        )
    else:
        remarks.append("print it from a material for the set temperature: ceramic or metal")
    return [*remarks, *stiffness_remarks(tube), *mold_remarks(tube.material, spec.heat.set_temperature)]


# --- files ------------------------------------------------------------------------------------------------------------


TOLERANCE = 1e-5
"""Largest distance of the groove in a file from the curve, m."""

COLUMNS = ("arc_length_mm", "feed_mm", "rotation_deg", "tip_radius_mm")
SIDES = 720
"""Corners of the cross-section of a turned mandrel's solid."""

FINE = 1e-4
"""Distance of points along the leads, where feed and rotation are not proportional, m."""


def write_mandrel(mandrel: Mandrel, directory: str | PathLike[str]) -> list[Path]:
    """Write mandrel.stl, and for a turned mandrel mandrel.csv and mandrel.nc, as `write_parts`; return the paths.

    Raises SolveError also if a groove, read back, deviates from its curve by more than 10 um.
    """
    return write_parts([mandrel_part(mandrel)], directory)


def mandrel_part(mandrel: Mandrel) -> Part:
    """Mandrel as a part; a cylinder has a table of rotation and feed, and a program."""
    texts: tuple[tuple[str, str], ...] = ()
    if isinstance(mandrel.body, Cylinder):
        rows = rotation_table(mandrel) * np.array([TO_MM, TO_MM, 180 / math.pi, TO_MM])
        table, text = to_csv(COLUMNS, [[f"{x:.5f}" for x in row] for row in rows]), mandrel_gcode(mandrel)
        read = np.loadtxt(io.StringIO(table), delimiter=",", skiprows=1)[:, 1:]
        texts = (("mandrel.csv", table), ("mandrel.nc", text))
        for (name, _), rows in zip(texts, (read, _read_rotary(text)), strict=True):
            feed, angle, tip = rows[:, 0] / TO_MM, np.radians(rows[:, 1]), rows[:, 2] / TO_MM + mandrel.width / 2
            points = np.column_stack([feed, tip * np.cos(angle), tip * np.sin(angle)])
            if fault := _off_curve(mandrel, points):
                raise SolveError(f"{name}: {fault}")
    return Part("mandrel", partial(_solid, mandrel), partial(solid_off_curve, mandrel), texts)


def rotation_table(mandrel: Mandrel) -> Array:
    """(N, 4) arc length, feed (m), rotation (rad) and radius of the tool's tip (m) for a turned mandrel."""
    fine = mandrel.winding.lengthened(0.0, FINE)
    feed, y, z = fine.points.T
    angle = np.unwrap(np.arctan2(z, y))
    return np.column_stack([fine.arc_length, feed, angle - angle[fine.bend.start], np.hypot(y, z) - mandrel.width / 2])


def mandrel_gcode(mandrel: Mandrel) -> str:
    """G-code of a turned mandrel for a rotary axis: X along it, A about it (deg), Z the tip's distance from it.

    Feeds are in inverse time, since the speed over ground is not that of X and A.
    """
    table, spec, cutter = rotation_table(mandrel), mandrel.spec, mandrel_cutter(mandrel)
    assert isinstance(mandrel.body, Cylinder)
    outer = mandrel.body.radius
    check_duration("mandrel.nc", mandrel_time(mandrel))
    safe = f"G0 Z{(outer + mandrel.width + spec.milling.safe_height) * TO_MM:.4f}"
    lines = [
        f"(mandrel of tube {mandrel.number}: cylinder {2 * outer * TO_MM:.4f} mm of {spec.material.name})",
        f"({cutter.data})",
        f"(X is {SHANK * TO_MM:g} at the face of the jaws)",
        f"(Z is 0 on the axis and {outer * TO_MM:.4f} on the cylinder)",
        "(A is 0 anywhere; it turns the tool about the work)",
        f"G21 G90 G94 {spec.workshop.work_offset}",
        safe,
        f"M3 S{cutter.spindle * 60:.0f}",
        f"G4 P{spec.workshop.spin_up:g}",
    ]
    for depth in pass_depths(mandrel.width, cutter.step):
        tip = np.maximum(table[:, 3], outer - depth)
        x, a = table[0, 1] * TO_MM, math.degrees(table[0, 2])
        lines += [
            safe,
            f"G0 X{x:.4f} A{a:.5f}",
            f"G1 Z{tip[0] * TO_MM:.4f} F{cutter.plunge * TO_MM * 60:.1f}",
            "G93",
        ]
        for start, end, z in zip(table[:-1], table[1:], tip[1:], strict=True):
            rate = 60 * cutter.feed / (end[0] - start[0])  # moves per minute
            lines.append(f"G1 X{end[1] * TO_MM:.4f} A{math.degrees(end[2]):.5f} Z{z * TO_MM:.4f} F{rate:.2f}")
        lines.append("G94")
    return "\n".join([*lines, safe, "M5", "M30", ""])


def mandrel_cutter(mandrel: Mandrel) -> Stage:
    """Ball-nose end mill of a turned mandrel, with its cutting data."""
    milling = mandrel.spec.milling
    cutter = milled(mandrel.width, milling.feed, milling.step_down, mandrel.spec)
    return replace(cutter, tool=f"ball-nose {cutter.tool}")


def mandrel_time(mandrel: Mandrel) -> float:
    """Duration of the cuts of a turned mandrel, s."""
    cutter, s = mandrel_cutter(mandrel), mandrel.winding.arc_length
    return len(pass_depths(mandrel.width, cutter.step)) * float(s[-1] - s[0]) / cutter.feed


def _read_rotary(text: str) -> Array:
    """(N, 3) feed (mm), rotation (deg) and radius of the tip (mm) in the last, deepest pass of a program."""
    deepest = text.rsplit("G93", 1)[-1]
    rows = re.findall(r"^G1 X([-\d.]+) A([-\d.]+) Z([-\d.]+)", deepest, re.MULTILINE)
    return np.array([[float(x) for x in row] for row in rows])


def _off_curve(mandrel: Mandrel, points: Array, distance: float = 0.0) -> str:
    """Message for a groove that deviates from the bend by more than 10 um; otherwise "".

    Args:
        points: (N, 3) points of the groove, m.
        distance: distance of every point of the bend from the nearest of them, m.
    """
    nearest = scipy.spatial.KDTree(points).query(mandrel.winding.points[mandrel.winding.bend])[0]
    deviation = float(np.abs(nearest - distance).max())
    return f"the groove lies {deviation * 1e6:.3g} um from the curve" if deviation > TOLERANCE else ""


def solid_off_curve(mandrel: Mandrel, mesh: Any) -> str:
    """Message for a mesh (mm) with a groove bottom that is not half a width from the bend everywhere; otherwise ""."""
    return _off_curve(mandrel, np.asarray(mesh.vertices) / TO_MM, mandrel.width / 2)


def _solid(mandrel: Mandrel) -> Any:
    """Solid of a mandrel (manifold3d, mm)."""
    library, w, body = manifold().Manifold, mandrel.winding, mandrel.body
    if isinstance(body, Cylinder):
        solid = library.cylinder(body.length * TO_MM, body.radius * TO_MM, -1.0, SIDES).rotate((0.0, 90.0, 0.0))
        radial = w.points * np.array([0.0, 1.0, 1.0])
        radius = np.linalg.norm(radial, axis=1)
        heights = np.maximum(body.radius + mandrel.width - radius, mandrel.width)
        return solid - channel(w.points, w.tangents, radial / radius[:, None], heights, mandrel.width / 2, SAGITTA)
    solid = library.cube(tuple(x * TO_MM for x in body.size))
    beyond = w.lengthened(max(10 * mandrel.width, 2 * body.slot))
    ups = np.tile([0.0, 0.0, 1.0], (len(beyond.points), 1))
    heights = np.maximum(body.size[2] - beyond.points[:, 2], 0.0) + mandrel.width
    solid -= channel(beyond.points, beyond.tangents, ups, heights, mandrel.width / 2, SAGITTA)
    if body.slot <= mandrel.width:
        return solid
    # From the top of the tube the walls recede at 45 deg, so that they are printed and lead the tube to its groove.
    narrow, wide = mandrel.width / 2, body.slot / 2
    lower = 0.5 * mandrel.tube.outer_diameter
    upper = lower + wide - narrow
    across = np.cross(beyond.tangents, ups)
    across /= np.linalg.norm(across, axis=1)[:, None]
    tops = np.maximum(heights, upper + mandrel.width)
    level = np.ones_like(tops)
    half = ((narrow, lower * level), (wide, upper * level), (wide, tops))
    sides = [*((-x, z) for x, z in half), *half[::-1]]
    corners = [beyond.points + x * across + z[:, None] * ups for x, z in sides]
    return solid - swept(np.stack(corners, axis=1))


def channel(points: Array, tangents: Array, ups: Array, heights: Array, radius: float, sagitta: float) -> Any:
    """Solid (manifold3d, mm) that cuts a groove: half a circle below, walls that rise along `ups`.

    Args:
        points: (N, 3) centreline, m.
        tangents: (N, 3) unit tangents.
        ups: (N, 3) unit directions of the walls, not necessarily perpendicular to the tangents.
        heights: (N,) heights of the walls above the points, m.
        radius: radius of the circle, m.
        sagitta: largest distance of its chords from the circle, m.
    """
    # Perpendicular to the curve even where `ups` is not, so that the bottom is round.
    across = np.cross(tangents, ups)
    across /= np.linalg.norm(across, axis=1)[:, None]
    up = np.cross(across, tangents)
    count = max(8, math.ceil(math.pi / (2 * math.acos(1 - sagitta / radius))))
    angle = np.linspace(0.0, math.pi, 2 * math.ceil(count / 2) + 1)
    round_ = np.cos(angle)[:, None] * across[:, None] - np.sin(angle)[:, None] * up[:, None]
    below = points[:, None] + radius * round_
    lift = heights[:, None] * ups
    return swept(np.concatenate([below, (below[:, -1] + lift)[:, None], (below[:, 0] + lift)[:, None]], axis=1))


def swept(rings: Array) -> Any:
    """Solid (manifold3d, mm) between the corners of convex sections (N, M, 3) along a curve, m."""
    n, m = rings.shape[:2]
    grid = np.arange(n * m).reshape(n, m)
    a, b = grid[:-1], np.roll(grid[:-1], -1, axis=1)
    c, d = grid[1:], np.roll(grid[1:], -1, axis=1)
    sides = np.stack([np.stack([a, b, d], -1), np.stack([a, d, c], -1)]).reshape(-1, 3)
    # Ends are closed by fans from one corner.
    fan = np.column_stack([np.zeros(m - 2, int), np.arange(1, m - 1), np.arange(2, m)])
    faces = np.vstack([sides, grid[0][fan][:, ::-1], grid[-1][fan]])
    corners = rings.reshape(-1, 3) * TO_MM
    if trimesh().Trimesh(corners, faces, process=False).volume < 0:
        faces = faces[:, ::-1]
    library = manifold()
    mesh = library.Mesh(vert_properties=corners.astype(np.float32), tri_verts=np.ascontiguousarray(faces, np.uint32))
    return library.Manifold(mesh)
