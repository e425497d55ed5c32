"""The holes of a board for pegs, and the pegs that stand in them beside a curve (SI).

Frame as in `pegs`: the origin is the lower left corner of the board, x to the right, y up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from ...robots.tubes import Tube
from ...typing import Array
from .groove import Centreline, Point
from .settings import DEFAULT_MOLD
from .spec import PegSpec

LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"


@dataclass(frozen=True)
class Peg:
    """One peg."""

    hole: str
    """Its name: letters for the row from below, number in the row from the left."""
    place: Point
    """Of the hole, m."""
    pin: Point
    """Where its pin stands, m."""
    angle: float
    """At which it is set, rad, from x."""
    left: bool
    """Whether it stands to the left of the tube, seen from its proximal end."""
    arc_length: float
    """Of the tube beside it, m, from the proximal clamp."""
    room: float
    """Between it and the tube on its curve, m."""
    force: float = 0.0
    """With which it pushes against the tube while that is cold and straight by itself, N."""


@dataclass(frozen=True, eq=False)
class Sampled:
    """The curve at many places: arc length (N,), points and unit normals to the left (N, 2)."""

    s: Array
    points: Array
    normals: Array
    tree: scipy.spatial.cKDTree

    @classmethod
    def of(cls, curve: Centreline, step: float) -> Sampled:
        """A curve, `step` (m) apart."""
        s, points, tangents = curve.along(step)
        normals = np.column_stack([-tangents[:, 1], tangents[:, 0]])
        return cls(s, points, normals, scipy.spatial.cKDTree(points))

    def seen(self, places: Array) -> tuple[Array, Array]:
        """Arc lengths of the feet of places (..., 2), and how far to the left of the curve they lie."""
        near = self.tree.query(places)[1]
        away, normal = places - self.points[near], self.normals[near]
        along = away[..., 0] * normal[..., 1] - away[..., 1] * normal[..., 0]
        return self.s[near] + along, (away * normal).sum(-1)


@dataclass(frozen=True, eq=False)
class Lattice:
    """The holes of a board.   places: (N, 2), m. names: in this order. reach: part of a pin's circle that is used."""

    places: Array
    names: tuple[str, ...]
    reach: float

    @classmethod
    def of(cls, size: Point, spec: PegSpec, reach: float = DEFAULT_MOLD.pegs.reach) -> Lattice:
        """Rows half a diagonal of the lattice apart, every other one shifted by as much; as far as the margin."""
        half, margin = spec.pitch / math.sqrt(2), 0.5 * spec.pitch + 0.5 * spec.shank
        rows = int((size[1] - 2 * margin) / half + 1e-9) + 1
        found, names = [], []
        for row in range(rows):
            first = margin + (row % 2) * half
            count = int((size[0] - margin - first) / (2 * half) + 1e-9) + 1
            letter = LETTERS[row % 26] if row < 26 else LETTERS[row // 26 - 1] + LETTERS[row % 26]
            for column in range(count):
                found.append((first + 2 * half * column, margin + half * row))
                names.append(f"{letter}{column + 1}")
        return cls(np.array(found), tuple(names), reach)

    @property
    def named(self) -> dict[str, Point]:
        """Places by names."""
        return {name: (float(x), float(y)) for name, (x, y) in zip(self.names, self.places, strict=True)}

    def serving(self, curve: Sampled, tube: Tube, spec: PegSpec, side: int) -> tuple[NDArray[np.intp], Array]:
        """Holes from which a pin reaches the tube from one side, and the arc lengths (m) where it does."""
        s, left = curve.seen(self.places)
        near = np.abs(side * left - spec.reach(tube.outer_diameter)) <= self.reach * spec.eccentricity
        inside = (s > spec.pitch) & (s < curve.s[-1] - spec.pitch)
        chosen = np.flatnonzero(near & inside)
        return chosen, s[chosen]

    def all_pegs(self, curve: Sampled, tube: Tube, spec: PegSpec) -> list[Peg]:
        """One in every hole that serves, for either side."""
        sides = {side: self.serving(curve, tube, spec, side)[0] for side in (1, -1)}
        return [self._set(int(hole), curve, tube, spec, side) for side, holes in sides.items() for hole in holes]

    def _set(self, hole: int, curve: Sampled, tube: Tube, spec: PegSpec, side: int) -> Peg:
        """The peg of a hole, turned in its steps to where its pin is nearest to touching the tube from outside."""
        angles = np.arange(0.0, 2 * math.pi - 1e-9, spec.angle_step)
        pins = self.places[hole] + spec.eccentricity * np.column_stack([np.cos(angles), np.sin(angles)])
        s, left = curve.seen(pins)
        room = side * left - 0.5 * (tube.outer_diameter + spec.pin)
        best = int(np.argmin(np.where(room >= 0, room, np.inf)))
        place, pin = (tuple(float(x) for x in p) for p in (self.places[hole], pins[best]))
        return Peg(
            hole=self.names[hole], place=(place[0], place[1]), pin=(pin[0], pin[1]), angle=float(angles[best]),
            left=side > 0, arc_length=float(s[best]), room=float(room[best]),
        )  # fmt: skip
