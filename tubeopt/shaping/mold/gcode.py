"""G-code for the plates of a mold (mm, absolute, mm/min), and a reader that checks it.

Zero of the workpiece is the lower left corner of the plate, z = 0 its upper face. End mills of grooves enter and leave
beyond the plate's edge. Nothing moves at rapid speed below the upper face: tools retract at their feed. The reader
interprets the commands written here: G0 to G3 with I and J, the drill cycle G83, arcs in the plane.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Annotated, NamedTuple

import numpy as np

from ...errors import InputError, SolveError
from ...files.units import TO_MM
from ..materials import MoldMaterial
from .checks import OVERRUN, THROUGH, beyond_edge, overrun
from .groove import Arc, Centreline, Point, directed_distance, mirrored
from .layout import Hole
from .mold import PARTS, Groove, Mold
from .spec import WORK_OFFSETS, MoldSpec

NEAR = 1e-3
"""Height (m) above the plate down to which tools move at rapid speed."""

POINT = 0.3
"""Length of a drill's point (118 deg) in diameters."""

SLOT_PASS = 0.5
"""Depth of one pass of a slot, in diameters of its end mill."""

CHIP = 0.02
"""Largest feed per revolution, in diameters of the tool.

A hundredth for each of two teeth: end mills of carbide in soft steel take 0.005 to 0.01 (Iscar, Multi-Master user
guide), drills of 3 to 12 mm together 0.008 to 0.016 (Navy training manual 14345)."""

REAMED = 0.2e-3
"""Diameter (m) that holes of dowels are drilled smaller by, for a reamer (common for 3 to 6 mm)."""

LARGEST_DRILL = 7e-3
"""Largest diameter of a drill, m, that common routers (ER11) hold: wider holes are milled."""

PROBING = 1.0
"""Feed (mm/s) towards a touch plate."""

MAX_DURATION = 7 * 86400.0
"""Largest duration of a program, s; a longer one probably has a number in another unit."""

CANNED = ("linuxcnc", "mach")
"""Dialects with the drill cycle G83."""


@dataclass(frozen=True)
class Stage:
    """Machining of a plate by one tool."""

    tool: str
    """Name of the tool, such as "drill 3 mm"."""
    diameter: float
    """Diameter of the tool, m."""
    spindle: float
    """Spindle speed, 1/s."""
    feed: float
    """Feed along the path, or of a drill, m/s."""
    plunge: float
    """Feed into the material, m/s: that of a drill is its feed."""
    step: float
    """Largest depth of a pass, or of a drilling step, m."""
    lines: tuple[str, ...]
    """Lines of the program."""

    @property
    def data(self) -> str:
        """Tool with its cutting data, as text."""
        feed, step = self.feed * TO_MM * PER_MINUTE, self.step * TO_MM
        speed = f"{self.spindle * PER_MINUTE:.0f} rpm, {self.cutting_speed * PER_MINUTE:.0f} m/min"
        return f"{self.tool}, {speed}, {feed:.0f} mm/min, step {step:g} mm"

    @property
    def depth(self) -> float:
        """Depth of its deepest cut below the plate's face, m."""
        return -min(motion.end for motion in read_gcode("\n".join(self.lines)))

    @property
    def cutting_speed(self) -> float:
        """Speed of the tool's rim, m/s."""
        return math.pi * self.diameter * self.spindle

    def slowed(self, material: MoldMaterial) -> Stage:
        """This stage, as slow as material and tool require; its numbers are the largest ones."""
        fastest = material.cutting_speed or math.inf
        spindle = min(self.spindle, fastest / (math.pi * self.diameter))
        feed = min(self.feed, CHIP * self.diameter * spindle)
        return replace(self, spindle=spindle, feed=feed, plunge=self.plunge * feed / self.feed)


@dataclass(frozen=True)
class Program:
    """G-code program of a plate."""

    file: Annotated[str, "name of the file"]
    part: str
    """Plate, "base" or "lid"."""
    tool: Annotated[str, "first tool"]
    text: str
    """G-code."""

    @cached_property
    def motions(self) -> tuple[Motion, ...]:
        """Moves of the program, read from its text."""
        return read_gcode(self.text)

    @property
    def time(self) -> float:
        """Duration of the moves, s, without dwells and tool changes."""
        return sum(motion.time for motion in self.motions)


def programs_of(mold: Mold) -> list[Program]:
    """Programs of both plates."""
    return [each for part in PARTS for each in programs(mold, part)]


def checked_programs(mold: Mold, part: str) -> list[Program]:
    """Programs of a plate, read back and compared with the grooves.

    Raises:
        SolveError: a cutter deviates from its groove by more than 10 um.
    """
    checked = programs(mold, part)
    deviation = toolpath_deviation(mold, groove_gcode(mold)) if part == "base" else slot_deviation(mold)
    if deviation > TOLERANCE:
        raise SolveError(f"{checked[0].file}: a cutter path deviates from its groove by {deviation * 1e6:.3g} um")
    return checked


def clamp_distance(mold: Mold) -> float:
    """Smallest distance (m) of the stock's clamps from the plates' edges."""
    return beyond_edge([groove.width for groove in mold.grooves], mold.spec)


class StockSize(NamedTuple):
    """Size of the stock of a plate, m."""

    width: float
    height: float
    thickness: float


def stock_size(mold: Mold, part: str) -> StockSize:
    """Size of the stock of a plate, in whole mm with room for tools and clamps."""
    shop, plate = mold.spec.workshop, mold.spec.plate
    thickness = plate.thickness if part == "base" else plate.lid_thickness
    beside = 2 * clamp_distance(mold) * TO_MM
    width, height = (math.ceil(side * TO_MM + beside) / TO_MM for side in mold.size) if shop.cut_out else mold.size
    return StockSize(width, height, thickness)


def drill_diameter(hole: Hole) -> float:
    """Diameter (m) of the drill of a hole: smaller by `REAMED` for a dowel."""
    return round(hole.diameter - REAMED, 6) if hole.purpose == "dowel" else hole.diameter


def drill_depth(diameter: float, thickness: float) -> float:
    """Depth (m) of the point of a drill of a `diameter` below the face of a plate of a `thickness`, m.

    Rounded up to 0.1 mm here, so that sheets and programs have the same number.
    """
    return math.ceil((thickness + THROUGH + POINT * diameter) * 1e4 - 1e-6) / 1e4


def is_milled(hole: Hole, spec: MoldSpec) -> bool:
    """True for a hole too wide for a drill: the end mill of the outline cuts it in circles."""
    return drill_diameter(hole) > max(LARGEST_DRILL, spec.workshop.outline_diameter)


def hole_depth(hole: Hole, thickness: float, spec: MoldSpec) -> float:
    """Depth (m) of the tool of a hole below the face of a plate of a `thickness`, m."""
    return thickness + THROUGH if is_milled(hole, spec) else drill_depth(drill_diameter(hole), thickness)


def programs(mold: Mold, part: str) -> list[Program]:
    """Programs of a plate: one, or without a touch plate one for each tool.

    Raises:
        InputError: a program takes too long.
        SolveError: a program, read back, has a hazardous move.
    """
    stages, numbers = stages_of(mold, part), ", ".join(str(groove.number) for groove in mold.grooves)
    title = f"{part}, mold of tube {numbers}, {mold.spec.material.name}"
    zero = ["zero: lower left corner and upper face of the plate"]
    if part == "lid" and mold.slots:
        zero = [
            "lower face up, turned over about its left edge",
            "zero: lower left corner as it lies, lower right one when closed",
            "z = 0: its lower face, which lies on top",
        ]
    size = " x ".join(f"{side * TO_MM:g}" for side in stock_size(mold, part))
    header = [f"{title}, for {mold.spec.workshop.dialect}", *zero, f"stock: {size} mm, and what the clamps hold"]
    files: dict[str, Sequence[Stage]] = {f"{part}_{k}.nc": [stage] for k, stage in enumerate(stages, start=1)}
    if mold.spec.workshop.touch_plate is not None:
        files = {f"{part}.nc": stages}
    of_plate = []
    for file, of_file in files.items():
        each = Program(file, part, of_file[0].tool, program(header, clamp_distance(mold), mold.spec, of_file))
        for hazard in hazards(each.motions):
            raise SolveError(f"{each.file}: {hazard}")
        check_duration(each.file, each.time)
        of_plate.append(each)
    return of_plate


def check_duration(file: str, time: float) -> None:
    """Raise InputError for a program that takes more than `MAX_DURATION`; time: duration, s."""
    if time > MAX_DURATION:
        raise InputError(
            f"the program {file} takes {time / 86400:.3g} days; it must take at most "
            f"{MAX_DURATION / 86400:.0f} days: use larger feeds or deeper cuts"
        )


def placed_holes(mold: Mold, part: str) -> list[Hole]:
    """Holes of a plate as it lies on the machine: a lid with slots has its lower face up."""
    if part == "base" or not mold.slots:
        return list(mold.base_holes if part == "base" else mold.lid_holes)
    return [replace(hole, centre=(mold.size[0] - hole.centre[0], hole.centre[1])) for hole in mold.lid_holes]


def stages_of(mold: Mold, part: str) -> list[Stage]:
    """Machining stages of a plate, in order: grooves, a stage for each drill, then wide holes and the outline."""
    spec, shop, base = mold.spec, mold.spec.workshop, part == "base"
    thickness = spec.plate.thickness if base else spec.plate.lid_thickness
    holes = placed_holes(mold, part)
    stages = groove_stages(mold) if base else slot_stages(mold)
    wide = [hole for hole in holes if is_milled(hole, spec)]
    for diameter in sorted({drill_diameter(hole) for hole in holes if hole not in wide}):
        of_drill = [hole for hole in holes if drill_diameter(hole) == diameter]
        tool, feed = f"drill {diameter * TO_MM:g} mm", shop.drill_feed
        drill = Stage(
            tool=tool, diameter=diameter, spindle=shop.drill_spindle, feed=feed, plunge=feed, step=shop.peck, lines=()
        ).slowed(spec.material)
        stages.append(replace(drill, lines=tuple(drilled(of_drill, drill, thickness, spec))))
    cut = [line for hole in wide for line in bored(hole, thickness, spec)]
    if not base and mold.hinge is not None:
        cut += across(mold.size[0], mold.hinge.pin, thickness, spec)
    if shop.cut_out:
        cut += outlined(mold.size, thickness, spec)
    if cut:
        cutter = milled(shop.outline_diameter, shop.outline_feed, shop.outline_step, spec)
        stages.append(replace(cutter, lines=tuple(cut)))
    return stages


def milled(diameter: float, feed: float, step: float, spec: MoldSpec) -> Stage:
    """Stage of an end mill without lines, at most at the `feed`, m/s."""
    milling, tool = spec.milling, f"end mill {diameter * TO_MM:g} mm"
    return Stage(tool, diameter, milling.spindle, feed, milling.plunge_feed, step, ()).slowed(spec.material)


def groove_stages(mold: Mold) -> list[Stage]:
    """Stages that cut the grooves, one for each end mill."""
    stages = []
    for mill in sorted({groove.mill for groove in mold.grooves}, key=lambda mill: mill.diameter):
        grooves = sorted((g for g in mold.grooves if g.mill == mill), key=lambda g: g.number)
        cutter = milled(mill.diameter, mold.spec.milling.feed, mold.spec.milling.step_down, mold.spec)
        lines = tuple(line for groove in grooves for line in _passes(groove, cutter, mold))
        stages.append(replace(cutter, lines=lines))
    return stages


def slot_paths(mold: Mold) -> list[tuple[Arc, ...]]:
    """Cutter paths of all slots, m, for the lid turned over: x is measured from its other side."""
    return [tuple(mirrored(piece, mold.size[0]) for piece in slot.centreline.bend) for slot in mold.slots]


def slot_stages(mold: Mold) -> list[Stage]:
    """Stage that cuts the slots of the lid, if it has any."""
    if not mold.slots:
        return []
    diameter, milling, lines = mold.slots[0].mill.diameter, mold.spec.milling, []
    cutter = milled(diameter, milling.feed, min(milling.step_down, SLOT_PASS * diameter), mold.spec)
    for slot, path in zip(mold.slots, slot_paths(mold), strict=True):
        lines.append(f"(slot for a thermocouple, depth {_mm(slot.depth)})")
        for depth in pass_depths(slot.depth, cutter.step):
            lines += _plunge(path[0].start, depth, cutter, mold.spec)
            lines += [_move(piece) + (_feed(cutter.feed) if k == 0 else "") for k, piece in enumerate(path)]
            lines += _retract(mold.spec)
    return [replace(cutter, lines=tuple(lines))]


def groove_gcode(mold: Mold) -> str:
    """Lines of G-code that cut all grooves."""
    return "\n".join(line for stage in groove_stages(mold) for line in stage.lines)


# --- moves of the tools -----------------------------------------------------------------------------------------------


def pass_depths(depth: float, step: float) -> tuple[float, ...]:
    """Depths (m) of passes in equal steps of at most `step` (m)."""
    count = math.ceil(depth / step - 1e-9)
    return tuple(depth * (k + 1) / count for k in range(count))


def _passes(groove: Groove, cutter: Stage, mold: Mold) -> Iterator[str]:
    """Lines of G-code that cut a groove, pass by pass."""
    yield f"(tube {groove.number}: width {_mm(groove.width)}, depth {_mm(groove.depth)})"
    for depth in pass_depths(groove.depth, cutter.step):
        for path in cutter_paths(groove):
            yield from _plunge(path.lead_in.start, depth, cutter, mold.spec)
            for k, piece in enumerate(path.pieces):
                yield _move(piece) + (_feed(cutter.feed) if k == 0 else "")
            yield from _retract(mold.spec)


def drilled(holes: Sequence[Hole], drill: Stage, thickness: float, spec: MoldSpec) -> Iterator[str]:
    """Lines of G-code that drill holes through a plate of a `thickness`, m."""
    shop, milling = spec.workshop, spec.milling
    has_cycle = shop.dialect in CANNED
    for purpose in dict.fromkeys(hole.purpose for hole in holes):
        yield "(latches)" if purpose == "latch" else f"({purpose}s)"
        of_purpose = [hole for hole in holes if hole.purpose == purpose]
        depth = drill_depth(drill.diameter, thickness)
        if has_cycle:
            yield f"G0 Z{_mm(milling.safe_height)}"
            for k, hole in enumerate(of_purpose):
                cycle = f"G98 G83 Z{_mm(-depth)} R{_mm(NEAR)} Q{_mm(shop.peck)}{_feed(drill.feed)} "
                yield f"{cycle if k == 0 else ''}X{_mm(hole.centre[0])} Y{_mm(hole.centre[1])}"
            yield "G80"
            continue
        for hole in of_purpose:
            yield from _approach(hole.centre, spec)
            drilled_depth = 0.0
            for peck in pass_depths(depth, shop.peck):
                if drilled_depth:  # back in the hole down to the last peck, faster than into the material
                    yield f"G1 Z{_mm(-drilled_depth)}{_feed(milling.feed)}"
                yield f"G1 Z{_mm(-peck)}{_feed(drill.feed)}"
                yield from _retract(spec)
                drilled_depth = peck


def bored(hole: Hole, thickness: float, spec: MoldSpec) -> Iterator[str]:
    """Lines of G-code that mill a hole through a plate of a `thickness`, m, in circles from its middle outwards.

    The circles are at most a cutter's radius apart, so that no core is left, and counter-clockwise: climb milling.
    """
    shop = spec.workshop
    cutter = milled(shop.outline_diameter, shop.outline_feed, shop.outline_step, spec)
    widest = (drill_diameter(hole) - cutter.diameter) / 2
    count = math.ceil(2 * widest / cutter.diameter - 1e-9)
    x, y = hole.centre
    yield f"({hole.purpose}, diameter {_mm(drill_diameter(hole))})"
    for depth in pass_depths(thickness + THROUGH, cutter.step):
        yield from _plunge((x + widest / count, y), depth, cutter, spec)
        for k in range(1, count + 1):
            radius = widest * k / count
            yield _move(Arc.between((x + widest / count, y), (x + radius, y))) + _feed(cutter.feed)
            # A reader takes an arc with equal ends for none.
            for side in (1, -1):
                yield _move(Arc((x + side * radius, y), side * math.pi / 2, math.pi * radius, 1 / radius))
        yield from _retract(spec)


def outlined(size: Point, thickness: float, spec: MoldSpec) -> Iterator[str]:
    """Lines of G-code that cut out a plate of a `thickness`, m, clockwise: climb milling."""
    radius = spec.workshop.outline_diameter / 2
    low, (x, y) = -radius, (size[0] + radius, size[1] + radius)
    yield from _cut_through([(low, low), (low, y), (x, y), (x, low), (low, low)], thickness, spec)


def across(width: float, height: float, thickness: float, spec: MoldSpec) -> Iterator[str]:
    """Lines of G-code that cut a hinged lid from its strip, at a height above the lower edge, m."""
    beyond = spec.workshop.outline_diameter / 2 + OVERRUN
    yield "(cut between the hinged lid and its strip)"
    yield from _cut_through([(-beyond, height), (width + beyond, height)], thickness, spec)


def _cut_through(corners: Sequence[Point], thickness: float, spec: MoldSpec) -> Iterator[str]:
    """Lines of G-code that cut through a plate along a chain of lines, with tabs."""
    shop = spec.workshop
    cutter = milled(shop.outline_diameter, shop.outline_feed, shop.outline_step, spec)
    top = thickness - shop.tab_height
    for depth in pass_depths(thickness + THROUGH, cutter.step):
        yield from _plunge(corners[0], depth, cutter, spec)
        for start, end in pairwise(corners):
            for tab in _tabs(start, end, spec) if depth > top else ():
                yield _move(Arc.between(start, tab.start)) + _feed(cutter.feed)
                yield f"G1 Z{_mm(-top)}"
                yield _move(tab)
                yield f"G1 Z{_mm(-depth)}{_feed(cutter.plunge)}"
            yield _move(Arc.between(start, end)) + _feed(cutter.feed)
        yield from _retract(spec)


def _tabs(start: Point, end: Point, spec: MoldSpec) -> Iterator[Arc]:
    """Intervals on one side of the outline, m, where the cutter is lifted to leave tabs."""
    shop, side = spec.workshop, Arc.between(start, end)
    count = max(1, round(side.length / shop.tab_pitch))
    half = 0.5 * min(shop.tab_width + shop.outline_diameter, 0.9 * side.length / count)
    for k in range(count):
        middle = (k + 0.5) / count * side.length
        yield Arc.between(*side.point(np.array([middle - half, middle + half])))


def _approach(point: Point, spec: MoldSpec) -> Iterator[str]:
    """Lines of G-code that move rapidly to a point just above the plate."""
    yield f"G0 Z{_mm(spec.milling.safe_height)}"
    yield f"G0 X{_mm(point[0])} Y{_mm(point[1])}"
    yield f"G0 Z{_mm(NEAR)}"


def _plunge(point: Point, depth: float, cutter: Stage, spec: MoldSpec) -> Iterator[str]:
    """Lines of G-code that approach a point and plunge to a depth (m)."""
    yield from _approach(point, spec)
    yield f"G1 Z{_mm(-depth)}{_feed(cutter.plunge)}"


def _retract(spec: MoldSpec) -> Iterator[str]:
    """Line of G-code that moves the tool out of the plate at its feed."""
    yield f"G1 Z{_mm(NEAR)}{_feed(spec.milling.feed)}"


# --- programs ---------------------------------------------------------------------------------------------------------


def program(header: Sequence[str], clear: float, spec: MoldSpec, stages: Sequence[Stage]) -> str:
    """Text of a G-code program with its `header`; clear: smallest distance of the stock's clamps from the plate, m."""
    shop = spec.workshop
    high = f"G0 Z{_mm(shop.change_height)}"
    path_control = {"linuxcnc": ["G64 P0.005"], "mach": ["G64"], "grbl": []}[shop.dialect]
    lines = [
        *(f"({line})" for line in header),
        f"(clamps: {math.ceil(clear * TO_MM)} mm and more from the plate)",
        f"G21 G90 G91.1 G94 G17 G40 G49 G80 {shop.work_offset}",
        *path_control,
    ]
    for k, stage in enumerate(stages):
        lines += _tool_change(spec, stage, k + 1, high)
        lines += [high, f"M3 S{stage.spindle * PER_MINUTE:.0f}", f"G4 P{shop.spin_up:g}", *stage.lines]
        lines += [high, "M5"]
    return "\n".join([*lines, "M30", ""])


def _tool_change(spec: MoldSpec, stage: Stage, number: int, high: str) -> Iterator[str]:
    """Lines of G-code that change to the tool of a stage and set Z for it; high: move to the height of tool changes."""
    shop = spec.workshop
    yield f"(tool {number}: {stage.data})"
    if shop.touch_plate is None:
        yield "(set Z to 0 on the plate's upper face with this tool)"
        return
    # The first tool is set by hand; the others probe the touch plate.
    if number == 1:
        return
    # Neither grooves nor holes are so near to a corner.
    corner = _mm(0.5 * spec.groove.wall)
    yield f"G0 X{corner} Y{corner}"
    yield f"M0 ({stage.tool}, touch plate under it)" if shop.dialect == "grbl" else f"T{number} M6"
    if shop.dialect != "grbl":
        yield "M0 (touch plate under the tool)"
    down = f"Z{_mm(-shop.change_height)} F{PROBING * PER_MINUTE:.0f}"
    height = _mm(shop.touch_plate)
    yield f"G31 {down}" if shop.dialect == "mach" else f"G38.2 {down}"
    yield (
        f"G92 Z{height}" if shop.dialect == "mach" else f"G10 L20 P{WORK_OFFSETS.index(shop.work_offset) + 1} Z{height}"
    )
    yield high
    yield "M0 (take the touch plate away)"


def _feed(feed: float) -> str:
    """G-code word for a feed, m/s."""
    return f" F{feed * TO_MM * PER_MINUTE:.1f}"


def _move(piece: Arc) -> str:
    """Line of G-code that moves along a line or an arc."""
    x, y = piece.end
    if not piece.curvature:
        return f"G1 X{_mm(x)} Y{_mm(y)}"
    i, j = piece.centre[0] - piece.start[0], piece.centre[1] - piece.start[1]
    return f"G{2 if piece.sweep < 0 else 3} X{_mm(x)} Y{_mm(y)} I{_mm(i)} J{_mm(j)}"


def _mm(length: float) -> str:
    """Text of a length (m) in mm, rounded to 0.1 um, and never -0."""
    return f"{round(length * TO_MM, 4) + 0.0:.4f}"


# --- reading back -----------------------------------------------------------------------------------------------------


PER_MINUTE = 60.0
TOLERANCE = 1e-5
"""Largest deviation of a cutter path from its groove, m."""

RAPID = 50e-3
"""Assumed speed of rapid moves, m/s."""

WORD = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))")
MODAL = {0, 1, 2, 3, 83}
"""Modal motion commands: they apply to the following lines as well."""


@dataclass(frozen=True)
class Motion:
    """Move of a tool."""

    line: int
    """Number of the line, from 1."""
    piece: Arc
    """Path in the plane, m; of length 0 for a vertical move."""
    start: float
    """Height z at the start, m."""
    end: float
    """Height z at the end, m."""
    feed: float | None
    """Speed, m/s; None for a rapid move."""
    spindle: bool
    """True if the spindle turns."""
    cycle: bool = False
    """True for a drill cycle."""

    @property
    def time(self) -> float:
        """Duration, s; a drill cycle moves down and up at its feed."""
        length = math.hypot(self.piece.length, self.end - self.start) * (2 if self.cycle else 1)
        return length / (RAPID if self.feed is None else self.feed)


@dataclass
class _Machine:
    """Modal state of a machine."""

    motion: int = 0
    """Number of the motion command, such as 1 for G1."""
    position: Point = (0.0, 0.0)
    """Position x, y, m."""
    z: float = 0.0
    """Height, m."""
    feed: float = 0.0
    """Feed, m/s."""
    spindle: bool = False
    """True if the spindle turns."""
    cycle_depth: float = 0.0
    """Height of the bottom of drill cycles, m."""
    cycle_start: float = 0.0
    """Start height of drill cycles, m."""


def read_gcode(text: str) -> tuple[Motion, ...]:
    """Moves of a program.

    Raises:
        InputError: a line is not words of a letter and a number, or an arc does not end on its circle.
    """
    machine = _Machine()
    motions: list[Motion] = []
    for number, line in enumerate(text.splitlines(), start=1):
        bare = re.sub(r"\([^)]*\)", "", line).strip()
        words = [(letter, float(value)) for letter, value in WORD.findall(bare)]
        if re.sub(r"\s", "", WORD.sub("", bare)):
            raise InputError(f"line {number} of the G-code is {line!r}; it must be words of a letter and a number")
        motions += _motions(machine, number, words)
    return tuple(motions)


def _motions(machine: _Machine, line: int, words: list[tuple[str, float]]) -> Iterator[Motion]:
    """Moves of a line; the modal state of the machine is updated."""
    for letter, value in words:
        if letter == "M" and value in (3, 5, 30):
            machine.spindle = value == 3
        if letter == "G" and value in MODAL:
            machine.motion = int(value)
        if letter == "G" and value == 80:
            machine.motion = 0
    # Offsets, dwells and probing cut nothing.
    if any(letter == "G" and value in (4, 10, 31, 38.2, 92) for letter, value in words):
        return
    values = {letter: value / TO_MM for letter, value in words if letter in "XYZIJRF"}
    machine.feed = values.get("F", machine.feed * PER_MINUTE) / PER_MINUTE
    if not values.keys() & set("XYZ"):
        return
    start, spindle = machine.position, machine.spindle
    end = values.get("X", start[0]), values.get("Y", start[1])
    if machine.motion == 83:
        machine.cycle_depth = values.get("Z", machine.cycle_depth)
        machine.cycle_start = values.get("R", machine.cycle_start)
        yield Motion(
            line=line, piece=Arc.between(start, end), start=machine.z, end=machine.z, feed=None, spindle=spindle
        )
        machine.position = end
        hole = Arc.between(end, end)
        yield Motion(line, hole, machine.cycle_start, machine.cycle_depth, machine.feed, spindle, cycle=True)
        return
    z = values.get("Z", machine.z)
    piece = Arc.between(start, end)
    if machine.motion > 1:
        centre = start[0] + values.get("I", 0.0), start[1] + values.get("J", 0.0)
        piece = _arc(line, start, end, centre=centre, left=machine.motion == 3)
    yield Motion(line, piece, machine.z, z, machine.feed if machine.motion else None, spindle)
    machine.position, machine.z = end, z


def _arc(line: int, start: Point, end: Point, *, centre: Point, left: bool) -> Arc:
    """Arc in the plane for a G2 or G3 line of the program; left: counter-clockwise."""
    radius, end_radius = math.dist(start, centre), math.dist(end, centre)
    if abs(radius - end_radius) > 5e-6:
        raise InputError(
            f"line {line} of the G-code: the arc's ends lie {radius * TO_MM:g} and {end_radius * TO_MM:g} mm off centre"
        )
    first, last = (math.atan2(point[1] - centre[1], point[0] - centre[0]) for point in (start, end))
    side = 1 if left else -1
    turn = side * (last - first) % (2 * math.pi)
    return Arc(start, first + side * math.pi / 2, radius * turn, side / radius)


def hazards(motions: Iterable[Motion]) -> list[str]:
    """Messages for rapid moves below the plate's face, and for cuts without feed or with the spindle still."""
    messages = []
    for motion in motions:
        if min(motion.start, motion.end) >= 0:
            continue
        if motion.feed is None:
            messages.append(f"line {motion.line} moves at rapid speed below the plate's face")
        elif not motion.spindle or motion.feed <= 0:
            messages.append(f"line {motion.line} cuts with the spindle still, or without a feed")
    return messages


def cutter_paths(groove: Groove) -> tuple[Centreline, ...]:
    """Paths of the cutter in one pass, with the overrun beyond the plate's edge."""
    return tuple(groove.centreline.offset(d).lengthened(overrun(groove.width)) for d in groove.cutter_offsets)


def slot_deviation(mold: Mold) -> float:
    """Hausdorff distance (m) between the cuts of the slots' program, read back, and the slots; 0 without slots."""
    paths = [piece for path in slot_paths(mold) for piece in path]
    if not paths:
        return 0.0
    text = "\n".join(line for stage in slot_stages(mold) for line in stage.lines)
    cuts = [motion for motion in read_gcode(text) if motion.feed is not None and motion.piece.length > 0]
    if max(abs(cut.end + mold.slots[0].depth) for cut in cuts[-1:]) > 1e-6:
        return math.inf
    pieces = [cut.piece for cut in cuts]
    return max(directed_distance(pieces, paths), directed_distance(paths, pieces))


def toolpath_deviation(mold: Mold, text: str) -> float:
    """Hausdorff distance (m) between the cuts of a program and the cutter paths of the grooves; inf if too shallow.

    Every cutter path of every groove must be cut at full depth.
    """
    cuts = [motion for motion in read_gcode(text) if motion.feed is not None and motion.piece.length > 0]
    paths = [(groove, path) for groove in mold.grooves for path in cutter_paths(groove)]
    deviation = 0.0
    for groove, path in paths:
        at_depth = [cut.piece for cut in cuts if abs(cut.end + groove.depth) < 1e-6]
        if not at_depth:
            return math.inf
        deviation = max(deviation, directed_distance(path.pieces, at_depth))
    return max(deviation, directed_distance({cut.piece for cut in cuts}, [p for _, path in paths for p in path.pieces]))
