"""The plates of a mold as G-code (mm, absolute, mm/min), and the programs read again.

Zero of the workpiece is the lower left corner of the plate, z = 0 its upper face. End mills of grooves enter and leave
beyond the plate's edge. Nothing moves at rapid speed below the upper face: tools are drawn out at their feed. The
reader knows what is written here: G0 to G3 with I and J, the drill cycle G83, arcs in the plane.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Annotated

import numpy as np

from ...errors import InputError, SolveError
from ...files.units import TO_MM
from .checks import THROUGH, beyond_edge, overrun
from .groove import Arc, Centreline, Point, farthest
from .layout import Hole
from .mold import PARTS, Groove, Mold
from .spec import WORK_OFFSETS, MoldSpec

NEAR = 1e-3
"""Height (m) above the plate down to which tools move at rapid speed."""

POINT = 0.3
"""Length of a drill's point (118 deg) in diameters."""

PROBING = 1.0
"""Feed (mm/s) towards a touch plate."""

LONGEST = 7 * 86400.0
"""Time (s) that a program may take: longer ones come from a number in another unit."""

CANNED = ("linuxcnc", "mach")
"""Dialects that know the drill cycle G83."""


@dataclass(frozen=True)
class Stage:
    """Machining of a plate by one tool.   tool: in words.   diameter: m.   spindle: 1/s.   lines: of the program."""

    tool: str
    diameter: float
    spindle: float
    lines: tuple[str, ...]


@dataclass(frozen=True)
class Program:
    """A program: its file, the plate, the tool that it begins with, and what it says."""

    file: Annotated[str, "name of the file"]
    part: str
    tool: Annotated[str, "first tool"]
    text: str

    @cached_property
    def motions(self) -> tuple[Motion, ...]:
        """Its moves, read again from the text."""
        return read_gcode(self.text)

    @property
    def time(self) -> float:
        """Duration of the moves, s, without dwells and tool changes."""
        return sum(motion.time for motion in self.motions)


def programs_of(mold: Mold) -> list[Program]:
    """The programs of both plates."""
    return [each for part in PARTS for each in programs(mold, part)]


def checked_programs(mold: Mold, part: str) -> list[Program]:
    """The programs of a plate; raises SolveError where, read again, a cutter leaves its groove by more than 10 um."""
    made = programs(mold, part)
    deviation = toolpath_deviation(mold, groove_gcode(mold)) if part == "base" else 0.0
    if deviation > TOLERANCE:
        raise SolveError(f"{made[0].file}: a cutter path deviates from its groove by {deviation * 1e6:.3g} um")
    return made


def clear_room(mold: Mold) -> float:
    """Distance (m) of the stock's clamps from the plates' edges."""
    return beyond_edge([groove.width for groove in mold.grooves], mold.spec)


def programs(mold: Mold, part: str) -> list[Program]:
    """The programs of a plate: one, or one for each tool where there is no touch plate.

    Raises SolveError where, read again, one moves where it must not.
    """
    stages, title = stages_of(mold, part), f"{part} of a mold, {mold.spec.material.name}"
    files: dict[str, Sequence[Stage]] = {f"{part}_{k}.nc": [stage] for k, stage in enumerate(stages, start=1)}
    if mold.spec.workshop.touch_plate is not None:
        files = {f"{part}.nc": stages}
    clear = clear_room(mold)
    made = [Program(n, part, some[0].tool, program(title, clear, mold.spec, some)) for n, some in files.items()]
    for each in made:
        for wrong in hazards(each.motions):
            raise SolveError(f"{each.file}: {wrong}")
        check_duration(each.file, each.time)
    return made


def check_duration(file: str, time: float) -> None:
    """Raise InputError for a program whose moves take longer than any is run, s."""
    if time > LONGEST:
        raise InputError(
            f"the program {file} takes {time / 86400:.3g} days; it must take at most "
            f"{LONGEST / 86400:.0f} days: use larger feeds or deeper cuts"
        )


def stages_of(mold: Mold, part: str) -> list[Stage]:
    """Machining stages of a plate in order: grooves, a stage for every drill; what cuts it out is last."""
    spec, shop, base = mold.spec, mold.spec.workshop, part == "base"
    thickness = spec.plate.thickness if base else spec.plate.lid_thickness
    holes = mold.holes if base else (*mold.vents, *mold.holes)
    stages = groove_stages(mold) if base else []
    for diameter in sorted({hole.diameter for hole in holes}):
        lines = tuple(drilled([hole for hole in holes if hole.diameter == diameter], thickness, spec))
        stages.append(Stage(f"drill {diameter * TO_MM:g} mm", diameter, shop.drill_spindle, lines))
    if shop.cut_out:
        cutter, lines = shop.outline_diameter, tuple(outlined(mold.size, thickness, spec))
        stages.append(Stage(f"end mill {cutter * TO_MM:g} mm", cutter, spec.milling.spindle, lines))
    return stages


def groove_stages(mold: Mold) -> list[Stage]:
    """A stage for every end mill of the grooves."""
    stages = []
    for mill in sorted({groove.mill for groove in mold.grooves}, key=lambda mill: mill.diameter):
        some = sorted((g for g in mold.grooves if g.mill == mill), key=lambda g: g.number)
        lines = tuple(line for groove in some for line in _passes(groove, mold))
        stages.append(Stage(f"end mill {mill.diameter * TO_MM:g} mm", mill.diameter, mold.spec.milling.spindle, lines))
    return stages


def groove_gcode(mold: Mold) -> str:
    """The moves of all grooves."""
    return "\n".join(line for stage in groove_stages(mold) for line in stage.lines)


# --- what the tools do ------------------------------------------------------------------------------------------------


def pass_depths(depth: float, step: float) -> tuple[float, ...]:
    """Depths (m) of the passes, equal steps, none greater than `step`."""
    count = math.ceil(depth / step - 1e-9)
    return tuple(depth * (k + 1) / count for k in range(count))


def _passes(groove: Groove, mold: Mold) -> Iterator[str]:
    milling = mold.spec.milling
    yield f"(tube {groove.number}: width {_mm(groove.width)}, depth {_mm(groove.depth)})"
    for depth in pass_depths(groove.depth, milling.step_down):
        for way in cutter_ways(groove):
            yield from _down(way.lead_in.start, depth, mold.spec)
            for k, piece in enumerate(way.pieces):
                yield _move(piece) + (_feed(milling.feed) if k == 0 else "")
            yield from _up(mold.spec)


def drilled(holes: Sequence[Hole], thickness: float, spec: MoldSpec) -> Iterator[str]:
    """Holes of one diameter through a plate of this thickness, m."""
    shop, milling = spec.workshop, spec.milling
    for purpose in dict.fromkeys(hole.purpose for hole in holes):
        yield f"({purpose}s)"
        some = [hole for hole in holes if hole.purpose == purpose]
        depth = thickness + THROUGH + POINT * some[0].diameter
        canned = shop.dialect in CANNED
        if canned:
            yield f"G0 Z{_mm(milling.safe_height)}"
        for k, hole in enumerate(some):
            x, y = hole.centre
            if canned:
                cycle = f"G98 G83 Z{_mm(-depth)} R{_mm(NEAR)} Q{_mm(shop.peck)}{_feed(shop.drill_feed)} "
                yield f"{cycle if k == 0 else ''}X{_mm(x)} Y{_mm(y)}"
                continue
            before = 0.0
            for goal in pass_depths(depth, shop.peck):
                yield from _down(hole.centre, before, spec, quick=True) if before else _above(hole.centre, spec)
                yield f"G1 Z{_mm(-goal)}{_feed(shop.drill_feed)}"
                yield f"G1 Z{_mm(NEAR)}{_feed(milling.feed)}"
                before = goal
        if canned:
            yield "G80"


def outlined(size: Point, thickness: float, spec: MoldSpec) -> Iterator[str]:
    """Around the plate, clockwise: the cutter's teeth run down into the material."""
    shop = spec.workshop
    radius, top = shop.outline_diameter / 2, thickness - shop.tab_height
    low, (x, y) = -radius, (size[0] + radius, size[1] + radius)
    corners = [(low, low), (low, y), (x, y), (x, low), (low, low)]
    for depth in pass_depths(thickness + THROUGH, shop.outline_step):
        yield from _down(corners[0], depth, spec)
        for start, end in pairwise(corners):
            for part in _tabs(start, end, spec) if depth > top else ():
                yield _move(Arc.between(start, part.start)) + _feed(shop.outline_feed)
                yield f"G1 Z{_mm(-top)}"
                yield _move(part)
                yield f"G1 Z{_mm(-depth)}{_feed(spec.milling.plunge_feed)}"
            yield _move(Arc.between(start, end)) + _feed(shop.outline_feed)
        yield from _up(spec)


def _tabs(start: Point, end: Point, spec: MoldSpec) -> Iterator[Arc]:
    """Tabs on one side of the outline, where the cutter is lifted."""
    shop, side = spec.workshop, Arc.between(start, end)
    count = max(1, round(side.length / shop.tab_pitch))
    half = 0.5 * min(shop.tab_width + shop.outline_diameter, 0.9 * side.length / count)
    for k in range(count):
        middle = (k + 0.5) / count * side.length
        yield Arc.between(*side.point(np.array([middle - half, middle + half])))


def _above(place: Point, spec: MoldSpec) -> Iterator[str]:
    yield f"G0 Z{_mm(spec.milling.safe_height)}"
    yield f"G0 X{_mm(place[0])} Y{_mm(place[1])}"
    yield f"G0 Z{_mm(NEAR)}"


def _down(place: Point, depth: float, spec: MoldSpec, *, quick: bool = False) -> Iterator[str]:
    """To a depth (m) at a place; `quick` where that was drilled before, and the drill stands above it."""
    if not quick:
        yield from _above(place, spec)
    milling = spec.milling
    yield f"G1 Z{_mm(-depth)}{_feed(milling.feed if quick else milling.plunge_feed)}"


def _up(spec: MoldSpec) -> Iterator[str]:
    yield f"G1 Z{_mm(NEAR)}{_feed(spec.milling.feed)}"


# --- the program around it --------------------------------------------------------------------------------------------


def program(title: str, clear: float, spec: MoldSpec, stages: Sequence[Stage]) -> str:
    """A whole program; clamps of the stock are to stay `clear` (m) from the plate."""
    shop = spec.workshop
    high = f"G0 Z{_mm(shop.change_height)}"
    path = {"linuxcnc": ["G64 P0.005"], "mach": ["G64"], "grbl": []}[shop.dialect]
    lines = [
        f"({title}, for {shop.dialect})",
        "(zero: lower left corner and upper face of the plate)",
        f"(clamps: {math.ceil(clear * TO_MM)} mm and more from the plate)",
        f"G21 G90 G91.1 G94 G17 G40 G49 G80 {shop.work_offset}",
        *path,
    ]
    for k, stage in enumerate(stages):
        lines += _changed(spec, stage, k + 1, high)
        lines += [high, f"M3 S{stage.spindle * PER_MINUTE:.0f}", f"G4 P{shop.spin_up:g}", *stage.lines]
        lines += [high, "M5"]
    return "\n".join([*lines, "M30", ""])


def _changed(spec: MoldSpec, stage: Stage, number: int, high: str) -> Iterator[str]:
    """The tool is in the spindle, and Z is set for it."""
    shop = spec.workshop
    yield f"(tool {number}: {stage.tool})"
    if shop.touch_plate is None:
        yield "(set Z to 0 on the plate's upper face with this tool)"
        return
    # The first tool has been set by hand; those that follow find the plate by the touch plate.
    if number == 1:
        return
    # Nothing is cut as near to a corner as that.
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
    return f" F{feed * TO_MM * PER_MINUTE:.1f}"


def _move(piece: Arc) -> str:
    x, y = piece.end
    if not piece.curvature:
        return f"G1 X{_mm(x)} Y{_mm(y)}"
    i, j = piece.centre[0] - piece.start[0], piece.centre[1] - piece.start[1]
    return f"G{2 if piece.sweep < 0 else 3} X{_mm(x)} Y{_mm(y)} I{_mm(i)} J{_mm(j)}"


def _mm(length: float) -> str:
    """A length (m) in mm with 0.1 um, and never -0."""
    return f"{round(length * TO_MM, 4) + 0.0:.4f}"


# --- programs read again ----------------------------------------------------------------------------------------------


PER_MINUTE = 60.0
TOLERANCE = 1e-5
"""Greatest distance (m) of the cutter's way from where it is meant to be."""

RAPID = 50e-3
"""Speed of rapid moves that is reckoned with, m/s."""

WORD = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))")
IN_FORCE = {0, 1, 2, 3, 83}
"""Motions that stay in force."""


@dataclass(frozen=True)
class Motion:
    """A move.   line: number.   piece: in the plane (m), a point's where it only goes up or down.   start, end: z (m).
    feed: m/s, None for a rapid one.   spindle: whether it turns.   cycle: whether it is a drill cycle."""

    line: int
    piece: Arc
    start: float
    end: float
    feed: float | None
    spindle: bool
    cycle: bool = False

    @property
    def time(self) -> float:
        """Duration, s; a drill cycle at its feed, down and up."""
        way = math.hypot(self.piece.length, self.end - self.start) * (2 if self.cycle else 1)
        return way / (RAPID if self.feed is None else self.feed)


@dataclass
class _Machine:
    """What is in force: motion, place (m), feed (m/s), spindle; height above which drill cycles are quick (m)."""

    motion: int = 0
    place: Point = (0.0, 0.0)
    z: float = 0.0
    feed: float = 0.0
    spindle: bool = False
    depth: float = 0.0
    above: float = 0.0


def read_gcode(text: str) -> tuple[Motion, ...]:
    """The moves of a program."""
    machine = _Machine()
    found: list[Motion] = []
    for number, line in enumerate(text.splitlines(), start=1):
        bare = re.sub(r"\([^)]*\)", "", line).strip()
        words = [(letter, float(value)) for letter, value in WORD.findall(bare)]
        if re.sub(r"\s", "", WORD.sub("", bare)):
            raise InputError(f"line {number} of the G-code is {line!r}; it must be words of a letter and a number")
        found += _motions(machine, number, words)
    return tuple(found)


def _motions(machine: _Machine, number: int, words: list[tuple[str, float]]) -> Iterator[Motion]:
    """Moves of a line; the modal state of the machine is updated."""
    for letter, value in words:
        if letter == "M" and value in (3, 5, 30):
            machine.spindle = value == 3
        if letter == "G" and value in IN_FORCE:
            machine.motion = int(value)
        if letter == "G" and value == 80:
            machine.motion = 0
    # What sets offsets, dwells or probes moves nothing that cuts.
    if any(letter == "G" and value in (4, 10, 31, 38.2, 92) for letter, value in words):
        return
    given = {letter: value / TO_MM for letter, value in words if letter in "XYZIJRF"}
    machine.feed = given.get("F", machine.feed * PER_MINUTE) / PER_MINUTE
    if not given.keys() & set("XYZ"):
        return
    end = given.get("X", machine.place[0]), given.get("Y", machine.place[1])
    if machine.motion == 83:
        machine.depth, machine.above = given.get("Z", machine.depth), given.get("R", machine.above)
        yield Motion(number, Arc.between(machine.place, end), machine.z, machine.z, None, machine.spindle)
        machine.place = end
        yield Motion(
            number, Arc.between(end, end), machine.above, machine.depth, machine.feed, machine.spindle, cycle=True
        )
        return
    z = given.get("Z", machine.z)
    piece = Arc.between(machine.place, end)
    if machine.motion > 1:
        centre = machine.place[0] + given.get("I", 0.0), machine.place[1] + given.get("J", 0.0)
        piece = _arc(number, machine.place, end, centre=centre, left=machine.motion == 3)
    yield Motion(number, piece, machine.z, z, machine.feed if machine.motion else None, machine.spindle)
    machine.place, machine.z = end, z


def _arc(number: int, start: Point, end: Point, *, centre: Point, left: bool) -> Arc:
    radius, other = math.dist(start, centre), math.dist(end, centre)
    if abs(radius - other) > 5e-6:
        raise InputError(
            f"line {number} of the G-code: the arc's ends lie {radius * TO_MM:g} and {other * TO_MM:g} mm off centre"
        )
    first, last = (math.atan2(place[1] - centre[1], place[0] - centre[0]) for place in (start, end))
    side = 1 if left else -1
    turn = side * (last - first) % (2 * math.pi)
    return Arc(start, first + side * math.pi / 2, radius * turn, side / radius)


def hazards(motions: Iterable[Motion]) -> list[str]:
    """What a program must not do: rapid moves below the plate's face, cuts without feed or with the spindle still."""
    found = []
    for motion in motions:
        if min(motion.start, motion.end) >= 0:
            continue
        if motion.feed is None:
            found.append(f"line {motion.line} moves at rapid speed below the plate's face")
        elif not motion.spindle or motion.feed <= 0:
            found.append(f"line {motion.line} cuts with the spindle still, or without a feed")
    return found


def cutter_ways(groove: Groove) -> tuple[Centreline, ...]:
    """The ways of the cutter in one pass (m), with the overrun beyond the plate's edge."""
    return tuple(groove.centreline.offset(d).lengthened(overrun(groove.width)) for d in groove.cutter_offsets)


def toolpath_deviation(mold: Mold, text: str) -> float:
    """Greatest distance (m), either way, between where cutters of grooves go and where they are meant to; inf if too
    shallow.

    At full depth, every way of every groove must be there.
    """
    cuts = [m for m in read_gcode(text) if m.feed is not None and m.piece.length > 0]
    worst = 0.0
    for groove in mold.grooves:
        deep = [cut.piece for cut in cuts if abs(cut.end + groove.depth) < 1e-6]
        if not deep:
            return math.inf
        worst = max(worst, *(farthest(way.pieces, deep) for way in cutter_ways(groove)))
    meant = [piece for groove in mold.grooves for way in cutter_ways(groove) for piece in way.pieces]
    return max(worst, farthest({cut.piece for cut in cuts}, meant))
