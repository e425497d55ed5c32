"""A milling machine that takes a program's word: an interpreter of its own, and a block of material on a grid."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np

from tubeopt.typing import Array

WORD = re.compile(r"([A-Z])\s*([-+]?[0-9]*\.?[0-9]+)")
STEP = 0.2
"""Greatest way between two looks at the tool, mm."""


@dataclass
class Milling:
    """What a machine saw: errors, places (x, y, z) of the tool's tip at cutting feed, (x, y) of what was drilled, mm;
    dwells after the spindle was started; pauses and changes of the tool; offsets that were in force."""

    errors: list[str] = field(default_factory=list)
    cuts: list[Array] = field(default_factory=list)
    dwelt: bool = True
    pauses: int = 0
    offsets: set[str] = field(default_factory=set)
    ended: bool = False


def mill(text: str) -> Milling:
    """Run a program from (0, 0, 50), the spindle still."""
    seen, at, motion, feed, spinning = Milling(), np.array([0.0, 0.0, 50.0]), 0, 0.0, False
    cycle = {"Z": 0.0, "R": 0.0}
    for number, line in enumerate(text.splitlines(), 1):
        words = [(letter, float(value)) for letter, value in WORD.findall(re.sub(r"\(.*?\)", "", line))]
        codes = {letter + f"{value:g}" for letter, value in words if letter in "GM"}
        given = {letter: value for letter, value in words if letter not in "GM"}
        feed = given.get("F", feed)
        if "M3" in codes:
            spinning, seen.dwelt = True, False
        if codes & {"M5", "M30"}:
            spinning = False
        seen.pauses += len(codes & {"M0", "M6"})
        seen.ended |= "M30" in codes
        seen.offsets |= codes & {f"G{k}" for k in range(54, 60)}
        if "G4" in codes:
            seen.dwelt |= given["P"] > 0
            continue
        if codes & {"G10", "G92"}:
            at[2] = given["Z"]
            continue
        if codes & {"G38.2", "G31"}:
            if spinning:
                seen.errors.append(f"{number}: probes with a turning tool")
            continue
        for code in ("G0", "G1", "G2", "G3", "G83", "G80"):
            if code in codes:
                motion = int(code[1:])
        target = np.array([given.get(axis, old) for axis, old in zip("XYZ", at, strict=True)])
        if not given.keys() & set("XYZ"):
            continue
        if motion == 83:
            cycle |= {letter: given[letter] for letter in "ZR" if letter in given}
            way = np.array([[*target[:2], z] for z in np.linspace(cycle["R"], cycle["Z"], 30)])
            if at[2] < cycle["R"]:
                seen.errors.append(f"{number}: goes to the next hole too low")
            at = np.array([*target[:2], at[2]])
        else:
            way = line_or_arc(at, target, motion, (given.get("I", 0.0), given.get("J", 0.0)))
            at = target
        if motion == 0:
            if way[:, 2].min() < -1e-9:
                seen.errors.append(f"{number}: rapid below the surface")
        elif way[:, 2].min() < 0:
            if not spinning or not seen.dwelt:
                seen.errors.append(f"{number}: cuts with the spindle still")
            if feed <= 0:
                seen.errors.append(f"{number}: cuts without a feed")
            seen.cuts.append(way)
    return seen


def line_or_arc(start: Array, end: Array, motion: int, to_centre: tuple[float, float]) -> Array:
    """(N, 3) places on a straight way or an arc in the plane."""
    if motion < 2:
        count = max(2, int(np.ceil(np.linalg.norm(end - start) / STEP)) + 1)
        return np.asarray(start + np.linspace(0, 1, count)[:, None] * (end - start))
    centre = complex(*start[:2]) + complex(*to_centre)
    first, last = complex(*start[:2]) - centre, complex(*end[:2]) - centre
    turn = np.angle(last / first) % (2 * np.pi) - (2 * np.pi if motion == 2 else 0.0)
    count = max(2, int(np.ceil(abs(first * turn) / STEP)) + 1)
    places = centre + first * np.exp(1j * np.linspace(0, turn, count))
    return np.column_stack([places.real, places.imag, np.linspace(start[2], end[2], count)])


class Block:
    """Material (mm) on a grid of columns, whose tops are lowered by what passes over them; z = 0 is its upper face."""

    def __init__(self, size: tuple[float, float], thickness: float, pixel: float = 0.1) -> None:
        self.pixel, self.thickness = pixel, thickness
        self.x, self.y = (np.arange(pixel / 2, side, pixel) for side in size)
        self.top = np.zeros((len(self.y), len(self.x)))

    def cut(self, way: Array, diameter: float) -> None:
        """Move a flat tool along (N, 3) places."""
        r = diameter / 2
        if np.ptp(way[:, 0]) == np.ptp(way[:, 1]) == 0:
            way = way[way[:, 2].argmin()][None]
        for x, y, z in way:
            i = slice(*np.searchsorted(self.y, [y - r, y + r]))
            j = slice(*np.searchsorted(self.x, [x - r, x + r]))
            inside = (self.x[j] - x) ** 2 + (self.y[i, None] - y) ** 2 <= r**2
            self.top[i, j] = np.where(inside, np.minimum(self.top[i, j], z), self.top[i, j])

    @property
    def removed(self) -> float:
        """Volume that is gone, mm^3."""
        return float(np.minimum(-self.top, self.thickness).sum() * self.pixel**2)
