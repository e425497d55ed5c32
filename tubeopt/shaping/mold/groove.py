"""Plane geometry of a groove: lines, arcs, and a bend of any curvature as a chain of arcs (m, rad).

Where the curvature is constant an arc is the curve itself. Elsewhere each stretch is a biarc: two arcs, tangent to each
other, with the ends and tangents of the stretch (Bolton, Computer-Aided Design 7, 1975), halved until it lies on the
curve. Ends and tangents are integrated from the curvature, so that no error adds up along the chain.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from ...robots.tubes import Tube
from ...typing import Array
from .springback import Panel, signed_curvature

Point = tuple[float, float]

# Machines repeat to about 5 um, and STL files hold 0.01 um. The number of chords goes with 1 / sqrt(sagitta): a quarter
# of it doubles the files.
SAGITTA = 1e-6
"""Largest distance of chords from curves in solids and polygons, m."""


@dataclass(frozen=True)
class Arc:
    """A stretch of one curvature: an arc of a circle, or a line where that is 0."""

    start: Point
    """Start point, m."""
    heading: float
    """Heading at the start, rad."""
    length: float
    """Arc length, m."""
    curvature: float = 0.0
    """Signed curvature, 1/m; positive: the piece turns left."""

    @classmethod
    def between(cls, start: Array | Point, end: Array | Point) -> Arc:
        """The line from one point (2,) to another."""
        x, y = _point(start)
        dx, dy = float(end[0]) - x, float(end[1]) - y
        return cls((x, y), math.atan2(dy, dx), math.hypot(dx, dy))

    @property
    def sweep(self) -> float:
        """Signed turning angle, rad."""
        return self.curvature * self.length

    @property
    def radius(self) -> float:
        """Radius, m; inf for a line."""
        return 1 / abs(self.curvature) if self.curvature else math.inf

    @cached_property
    def centre(self) -> Point:
        """Centre of the circle, m; only for an arc."""
        x, y = self.start
        return x - math.sin(self.heading) / self.curvature, y + math.cos(self.heading) / self.curvature

    @cached_property
    def end(self) -> Point:
        """End point, m."""
        return _point(self.point(np.array([self.length]))[0])

    def point(self, s: Array) -> Array:
        """(N, 2) points at arc lengths `s` (N,), also beyond the ends."""
        half = 0.5 * self.curvature * np.asarray(s)
        # The chord to a point has half the turn of its arc, and NumPy's sinc is sin(pi x) / (pi x).
        chord, angle = s * np.sinc(half / math.pi), self.heading + half
        return np.asarray(self.start) + np.column_stack([chord * np.cos(angle), chord * np.sin(angle)])

    def tangent(self, s: Array) -> Array:
        """(N, 2) unit tangents."""
        angle = self.heading + self.curvature * np.asarray(s)
        return np.column_stack([np.cos(angle), np.sin(angle)])

    def offset(self, distance: float) -> Arc:
        """Parallel piece at `distance` (m) to the left; the radius of an arc must stay positive."""
        # Length and radius both scale by 1 - kappa d, and the turn stays.
        shrink = 1 - self.curvature * distance
        (x, y), h = self.start, self.heading
        start = x - distance * math.sin(h), y + distance * math.cos(h)
        return Arc(start, h, shrink * self.length, self.curvature / shrink)

    def distance(self, points: Array) -> Array:
        """(N,) distances (m) of `points` (N, 2) from the piece."""
        if not self.curvature:
            relative, direction = points - np.asarray(self.start), self.tangent(np.zeros(1))[0]
            # Nearest point of the line, or the nearer one of its ends.
            along = np.clip(relative @ direction, 0.0, self.length)
            return np.asarray(np.linalg.norm(relative - along[:, None] * direction, axis=1))
        relative, side = points - np.asarray(self.centre), math.copysign(1.0, self.curvature)
        # Angle about the centre from the start, counted in the sense of the arc.
        angle = side * (np.arctan2(relative[:, 1], relative[:, 0]) - self.heading) + math.pi / 2
        inside = np.mod(angle, 2 * math.pi) <= abs(self.sweep)
        to_circle = np.abs(np.linalg.norm(relative, axis=1) - self.radius)
        ends = [np.linalg.norm(points - np.asarray(end), axis=1) for end in (self.start, self.end)]
        return np.asarray(np.where(inside, to_circle, np.minimum(*ends)))

    def moved(self, shift: Point) -> Arc:
        """Piece moved by `shift` (m)."""
        return replace(self, start=(self.start[0] + shift[0], self.start[1] + shift[1]))


class Samples(NamedTuple):
    """Samples of a curve."""

    arc_length: Array
    """(N,) arc lengths, m."""
    points: Array
    """(N, 2) points on the curve, m."""
    tangents: Array
    """(N, 2) unit tangents."""


@dataclass(frozen=True)
class Centreline:
    """Lead-in, bend and lead-out of a groove, tangent to one another, from the tube's proximal to its distal end.

    The bend is a chain of tangent pieces: one arc for a tube of one curvature.
    """

    lead_in: Arc
    """Line before the bend."""
    bend: tuple[Arc, ...]
    lead_out: Arc
    """Line behind the bend."""

    @property
    def pieces(self) -> tuple[Arc, ...]:
        """Lead-in, pieces of the bend, and lead-out."""
        return self.lead_in, *self.bend, self.lead_out

    @property
    def length(self) -> float:
        """Arc length from end to end, m."""
        return sum(piece.length for piece in self.pieces)

    @property
    def bend_length(self) -> float:
        """Length of the bend, m."""
        return sum(piece.length for piece in self.bend)

    def offset(self, distance: float) -> Centreline:
        """Parallel centreline at `distance` (m) to the left."""
        bend = tuple(piece.offset(distance) for piece in self.bend)
        return Centreline(self.lead_in.offset(distance), bend, self.lead_out.offset(distance))

    def moved(self, shift: Point) -> Centreline:
        """Centreline moved by `shift` (m)."""
        bend = tuple(piece.moved(shift) for piece in self.bend)
        return Centreline(self.lead_in.moved(shift), bend, self.lead_out.moved(shift))

    def lengthened(self, extra: float) -> Centreline:
        """Centreline with both leads `extra` (m) longer, outwards."""
        return with_leads(self.bend, self.lead_in.length + extra, self.lead_out.length + extra)

    def sample(self, step: float) -> Array:
        """(N, 2) points (m) at most `step` (m) apart, with the ends of all pieces."""
        return self.along(step).points

    def along(self, step: float) -> Samples:
        """Samples at most `step` (m) apart, with the ends of all pieces."""
        s = [spaced(piece.length, step) for piece in self.pieces]
        starts = np.cumsum([0.0, *(piece.length for piece in self.pieces[:-1])])
        return Samples(
            arc_length=np.concatenate([start + local for start, local in zip(starts, s, strict=True)]),
            points=np.vstack([piece.point(local) for piece, local in zip(self.pieces, s, strict=True)]),
            tangents=np.vstack([piece.tangent(local) for piece, local in zip(self.pieces, s, strict=True)]),
        )

    def bend_point(self, s: Array) -> Array:
        """(N, 2) points at arc lengths `s` (N,) of the bend, m."""
        ends = np.cumsum([piece.length for piece in self.bend])
        index = np.minimum(np.searchsorted(ends, s), len(self.bend) - 1)
        starts = ends - [piece.length for piece in self.bend]
        points = [self.bend[k].point(np.array([x - starts[k]])) for k, x in zip(index, s, strict=True)]
        return np.vstack(points) if points else np.zeros((0, 2))

    def distance(self, points: Array) -> Array:
        """(N,) distances (m) of `points` (N, 2) from the centreline."""
        return np.asarray(np.min([piece.distance(points) for piece in self.pieces], axis=0))


def with_leads(bend: Sequence[Arc], lead_in: float, lead_out: float) -> Centreline:
    """Centreline of a bend and tangent leads of lengths `lead_in` and `lead_out` (m)."""
    first, last = bend[0], bend[-1]
    start = _point(np.asarray(first.start) - lead_in * first.tangent(np.zeros(1))[0])
    out = Arc(last.end, last.heading + last.sweep, lead_out)
    return Centreline(Arc(start, first.heading, lead_in), tuple(bend), out)


def between(pieces: Sequence[Arc], first: float, last: float) -> tuple[Arc, ...]:
    """Part of a chain of pieces between two arc lengths from its start, m."""
    parts, start = [], 0.0
    for piece in pieces:
        low, high = max(first - start, 0.0), min(last - start, piece.length)
        if high - low > 1e-9:
            x, y = piece.point(np.array([low]))[0]
            parts.append(Arc((float(x), float(y)), piece.heading + low * piece.curvature, high - low, piece.curvature))
        start += piece.length
    return tuple(parts)


def reversed_piece(piece: Arc) -> Arc:
    """Piece from its end to its start."""
    return Arc(piece.end, piece.heading + piece.sweep + math.pi, piece.length, -piece.curvature)


def outline_of(centreline: Sequence[Arc], half: float) -> tuple[Arc, ...]:
    """Closed outline of a channel `half` (m) to each side of a chain of pieces, clockwise."""
    return closed(*([piece.offset(side * half) for piece in centreline] for side in (1, -1)))


def closed(left: Sequence[Arc], right: Sequence[Arc]) -> tuple[Arc, ...]:
    """Closed outline between two chains of pieces in one direction, with lines across their ends."""
    back = [reversed_piece(piece) for piece in reversed(right)]
    return (*left, Arc.between(left[-1].end, back[0].start), *back, Arc.between(back[-1].end, left[0].start))


def mirrored(piece: Arc, width: float) -> Arc:
    """Piece on a plate of a width (m) that is turned over about its vertical middle line."""
    return Arc((width - piece.start[0], piece.start[1]), math.pi - piece.heading, piece.length, -piece.curvature)


def leads_to_edge(bend: Sequence[Arc], size: Point) -> Centreline:
    """Centreline of a bend inside the plate [0, width] x [0, height], with tangent leads that end at its edge."""
    first, last = bend[0].tangent(np.zeros(1))[0], bend[-1].tangent(np.array([bend[-1].length]))[0]
    lead_in = distance_to_edge(bend[0].start, -first, size)
    return with_leads(bend, lead_in, distance_to_edge(bend[-1].end, last, size))


def distance_to_edge(start: Point, direction: Array, size: Point) -> float:
    """Distance (m) along a unit vector (2,) from a point inside the plate [0, width] x [0, height] to its edge."""
    distances = []
    for position, component, extent in zip(start, direction, size, strict=True):
        if abs(component) > 1e-12:
            distances.append(((extent if component > 0 else 0.0) - position) / component)
    return float(min(distances))


def bounds(pieces: Sequence[Arc]) -> tuple[Point, Point]:
    """Corners of the bounding box of pieces, m; exact for arcs."""
    points = [end for piece in pieces for end in (piece.start, piece.end)]
    for piece in pieces:
        if piece.curvature:
            # An arc is widest at its ends or where its tangent is along an axis: at a compass point.
            compass = np.asarray(piece.centre) + piece.radius * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
            points += [_point(p) for p in compass[piece.distance(compass) < 1e-12]]
    array = np.array(points)
    return _point(array.min(axis=0)), _point(array.max(axis=0))


def min_distance(first: Centreline, second: Centreline) -> float:
    """Smallest distance (m) between two centrelines, too large by less than 0.25 mm.

    It is taken from samples of the first, half a millimetre apart, to the second: curves that cross are at most a
    quarter of a millimetre apart.
    """
    return float(second.distance(first.sample(5e-4)).min())


def directed_distance(pieces: Iterable[Arc], reference: Iterable[Arc]) -> float:
    """Directed Hausdorff distance (m) from pieces, sampled every millimetre, to reference pieces."""
    points = np.vstack([piece.point(spaced(piece.length, 1e-3)) for piece in pieces])
    return float(np.min([piece.distance(points) for piece in reference], axis=0).max())


def crosses_itself(curve: Centreline, width: float) -> bool:
    """True for a groove of `width` (m) that runs into itself."""
    step = 1.5e-3
    _, points, tangents = curve.along(step)
    # Between two samples a curve may come nearer by half a step.
    return meets_itself(points, np.unwrap(np.arctan2(tangents[:, 1], tangents[:, 0])), math.hypot(width, step / 2))


def meets_itself(points: Array, heading: Array, distance: float) -> bool:
    """True for a planar curve of points (N, 2) and headings (N,) with turns nearer than `distance` (m)."""
    return turn_distance(points, heading) < distance


def turn_distance(points: Array, heading: Array) -> float:
    """Smallest distance (m) between turns of a planar curve of points (N, 2) and headings (N,); inf for a single one.

    Only points between which the heading changes by more than a quarter turn are compared: along a bend, however tight,
    neighbours are always near.
    """
    least = math.inf
    if np.ptp(heading) <= math.pi / 2:
        return least
    for k in range(len(points) - 1):
        later = np.maximum.accumulate(heading[k:]) - np.minimum.accumulate(heading[k:]) > math.pi / 2
        least = min(least, float(np.linalg.norm(points[k:][later] - points[k], axis=1).min(initial=math.inf)))
    return least


def polygon(curve: Centreline, width: float, sagitta: float = SAGITTA) -> Array:
    """(N, 2) corners, counter-clockwise, of a groove of `width` (m); chords leave arcs by at most `sagitta` (m)."""
    left, right = (_polyline(curve.offset(side * width / 2), sagitta) for side in (1, -1))
    return np.vstack([right, left[::-1]])


def _polyline(curve: Centreline, sagitta: float) -> Array:
    """(N, 2) ends of chords that deviate from a curve by at most `sagitta`, m."""
    parts = [np.asarray([curve.lead_in.start])]
    for k, piece in enumerate(curve.bend):
        count = 1
        if piece.curvature:
            # A chord over the angle a leaves its arc by r (1 - cos(a / 2)).
            step = 2 * math.acos(max(1 - sagitta / piece.radius, -1.0))
            count = max(2 if len(curve.bend) == 1 else 1, math.ceil(abs(piece.sweep) / step))
        s = np.linspace(0.0, piece.length, count + 1)
        parts.append(piece.point(s if k == 0 else s[1:]))
    return np.vstack([*parts, [curve.lead_out.end]])


def clipped_area(corners: Array, size: Point) -> float:
    """Area (m^2) of a polygon within [0, width] x [0, height] (Sutherland and Hodgman, Commun. ACM 17, 1974)."""
    for axis in (0, 1):
        for sign, bound in ((1.0, 0.0), (-1.0, -size[axis])):
            value = sign * corners[:, axis] - bound
            clipped = []
            for k in range(len(corners)):
                if (value[k - 1] < 0) != (value[k] < 0):
                    part = value[k - 1] / (value[k - 1] - value[k])
                    clipped.append(corners[k - 1] + part * (corners[k] - corners[k - 1]))
                if value[k] >= 0:
                    clipped.append(corners[k])
            corners = np.array(clipped)
    x, y = corners[:, 0] - corners[0, 0], corners[:, 1] - corners[0, 1]
    # Shoelace formula, from the first corner, so that distant polygons lose no digits.
    return 0.5 * abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))))


def spaced(length: float, step: float) -> Array:
    """(N,) arc lengths (m) from 0 to a length, at most `step` apart."""
    return np.linspace(0.0, length, max(2, math.ceil(length / step) + 1))


def _point(array: Array | Sequence[float]) -> Point:
    return float(array[0]), float(array[1])


# --- a bend of any curvature as arcs ----------------------------------------------------------------------------------


# Half of what a DXF file may deviate when it is read back. A biarc deviates by third order in its length: half of the
# tolerance takes 1.26 times as many arcs, ten times the tolerance less than half of them.
ARC_TOLERANCE = 0.5e-6
"""Largest distance of the arcs of a groove from its curve, m."""

# The deviation rises and falls once on each arc. Eight steps to a half-wave miss its height by 1 - cos(pi / 16), 2 %.
ARC_POINTS = 17
"""Checked points on a pair of arcs."""

# Beyond it the deviation of a biarc with equal arms is not yet of third order, and 17 points need not see its peak.
ARC_TURN = 0.5
"""Largest turn of one pair of arcs, rad."""

# Few milling machines take an arc with a radius of kilometres.
FLAT = 1e-9
"""Largest rise above the chord, m, of an arc that is replaced by a line."""

_GAUSS = np.polynomial.legendre.leggauss(16)


def bend_of(held: Tube) -> tuple[Arc, ...]:
    """Bend of a groove for a planar tube, from left to right.

    The headings of its ends are opposite, and in total it turns to the right: a single arc is symmetric about the
    vertical. Its top is at y = 0.

    Args:
        held: tube as the mold holds it.
    """
    panels: list[Panel] = []
    for panel in signed_curvature(held):
        if panel.length < 1e-12:  # round-off between a kink and a change of sign
            continue
        if panels and len(panel.coefficients) == 1 and np.array_equal(panel.coefficients, panels[-1].coefficients):
            # Neighbouring panels of the same constant curvature are one arc.
            panels[-1] = Panel(panels[-1].length + panel.length, panel.coefficients)
        else:
            panels.append(panel)
    turn = math.fsum(_turn(panel) for panel in panels)
    side = -1.0 if turn >= 0 else 1.0
    start, heading = np.zeros(2), abs(turn) / 2
    pieces: list[Arc] = []
    for length, coefficients in panels:
        stretch = Stretch(length, side * coefficients, start, heading)
        pieces += stretch.arcs()
        end = np.array([length])
        start, heading = stretch.points(end)[0], float(stretch.headings(end)[0])
    low, high = bounds(pieces)
    to_middle = (-(low[0] + high[0]) / 2, -high[1])
    return tuple(piece.moved(to_middle) for piece in pieces)


def _turn(panel: Panel) -> float:
    """Integral of the curvature over a panel, rad."""
    integral = chebyshev.chebint(panel.coefficients)
    return float(chebyshev.chebval(1.0, integral) - chebyshev.chebval(-1.0, integral)) * panel.length / 2


@dataclass(frozen=True, eq=False)
class Stretch:
    """Stretch of a bend with a curvature polynomial in the arc length."""

    length: float
    """Arc length, m."""
    coefficients: Array
    """Chebyshev coefficients of the curvature, 1/m; positive: it turns left."""
    start: Array
    """(2,) start point, m."""
    heading: float
    """Heading at the start, rad."""

    def headings(self, s: Array) -> Array:
        """(N,) headings (rad) at arc lengths (N,)."""
        integral = chebyshev.chebint(self.coefficients) * self.length / 2
        x = 2 * s / self.length - 1
        return np.asarray(self.heading + chebyshev.chebval(x, integral) - chebyshev.chebval(-1.0, integral))

    def points(self, s: Array) -> Array:
        """(N, 2) points at rising arc lengths (N,)."""
        max_curvature = np.abs(self.coefficients).sum()
        # At most half a radian an interval: 16 Gauss points then integrate cos and sin to round-off.
        fine = np.linspace(0.0, self.length, math.ceil(2 * max_curvature * self.length) + 1)
        knots = np.unique(np.concatenate([fine, s]))
        half, middle = np.diff(knots) / 2, (knots[1:] + knots[:-1]) / 2
        nodes, weights = _GAUSS
        angle = self.headings((middle[:, None] + half[:, None] * nodes).ravel()).reshape(len(half), -1)
        steps = np.column_stack([(np.cos(angle) @ weights) * half, (np.sin(angle) @ weights) * half])
        corners = np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])
        return self.start + corners[np.searchsorted(knots, s)]

    def arcs(self) -> list[Arc]:
        """Tangent arcs, as biarcs that are halved until they lie on the curve."""
        if len(self.coefficients) == 1:
            return [_one_arc(self.start, self.heading, float(self.coefficients[0]), self.length)]
        pieces: list[Arc] = []
        stack = [(0.0, self.length)]
        while stack:
            low, high = stack.pop()
            s = np.linspace(low, high, ARC_POINTS)
            points, headings = self.points(s), self.headings(s)
            if np.ptp(headings) <= ARC_TURN:
                pair = _biarc(points[0], float(headings[0]), points[-1], float(headings[-1]))
                if np.min([piece.distance(points) for piece in pair], axis=0).max() <= ARC_TOLERANCE:
                    pieces += pair
                    continue
            # The left half is last, so it comes off the stack first: arcs are in order.
            stack += [((low + high) / 2, high), (low, (low + high) / 2)]
        return pieces


def _one_arc(start: Array, heading: float, curvature: float, length: float) -> Arc:
    """Arc, or a line where the arc is flat."""
    sweep = curvature * length
    # Rise of an arc over its chord: r (1 - cos(sweep / 2)), about sweep * length / 8.
    flat = abs(sweep) * length / 8 <= FLAT
    point = _point(start)
    return Arc(point, heading + sweep / 2, length) if flat else Arc(point, heading, length, curvature)


def _biarc(start: Array, first: float, end: Array, last: float) -> tuple[Arc, Arc]:
    """Biarc from `start` with heading `first` to `end` with heading `last`, with equal arms."""
    t0, t1 = (np.array([math.cos(angle), math.sin(angle)]) for angle in (first, last))
    chord = end - start
    along = float(chord @ (t0 + t1))
    # 2 (1 - cos) of the turn, by the half angle, without cancellation.
    bending = 4 * math.sin((last - first) / 2) ** 2
    square = float(chord @ chord)
    # Positive root of bending a^2 / 2 + along a = |chord|^2 / 2 with equal arms, free of cancellation.
    arm = square / (along + math.sqrt(along**2 + bending * square))
    joint = (start + end + arm * (t0 - t1)) / 2
    return _arc_to(start, first, joint), _arc_to(joint, first + _sweep(start, first, joint), end)


def _sweep(start: Array, heading: float, end: Array) -> float:
    """Signed turning angle of the arc from `start` with `heading` to `end`, rad: twice that to its chord."""
    chord = end - start
    across = math.cos(heading) * chord[1] - math.sin(heading) * chord[0]
    along = math.cos(heading) * chord[0] + math.sin(heading) * chord[1]
    return 2 * math.atan2(across, along)


def _arc_to(start: Array, heading: float, end: Array) -> Arc:
    """Arc from `start` with `heading` to `end`."""
    half = _sweep(start, heading, end) / 2
    chord = float(np.linalg.norm(end - start))
    return _one_arc(start, heading, 2 * math.sin(half) / chord, chord / float(np.sinc(half / math.pi)))
