"""Programs of a mold read again: where the tools go, how fast, and what they must not do.

It reads what `gcode` writes: mm, absolute coordinates, G0 to G3 with I and J, the drill cycle G83; arcs in the plane.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from ...errors import InputError
from ...files.units import TO_MM
from .checks import overrun
from .groove import Arc, Centreline, Point, farthest
from .mold import Groove, Mold

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
        """How long it takes, s; a drill cycle at its feed, down and up."""
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
    """What a line moves, and what it leaves in force."""
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
