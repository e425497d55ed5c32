"""The plane geometry of a groove: straight pieces and true arcs (m, rad)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...typing import Array

Point = tuple[float, float]

STRAIGHT = 1e-9
"""Curvature (1/m) below which a bend is drawn as a straight line: its radius would exceed a million kilometres."""


@dataclass(frozen=True)
class Line:
    """A straight piece from `start` to `end` (m)."""

    start: Point
    end: Point

    @property
    def length(self) -> float:
        """Length, m."""
        return math.dist(self.start, self.end)

    def point(self, s: Array) -> Array:
        """(N, 2) points at arc lengths `s` (N,), also beyond the ends."""
        return np.asarray(self.start) + np.asarray(s)[:, None] * self.tangent(np.zeros(1))

    def tangent(self, s: Array) -> Array:
        """(N, 2) unit tangents."""
        step = (np.asarray(self.end) - np.asarray(self.start)) / self.length
        return np.tile(step, (len(s), 1))

    def offset(self, distance: float) -> Line:
        """The parallel piece at `distance` (m) to the left."""
        (tx, ty) = self.tangent(np.zeros(1))[0]
        shift = np.array([-ty, tx]) * distance
        return Line(_point(np.asarray(self.start) + shift), _point(np.asarray(self.end) + shift))

    def distance(self, points: Array) -> Array:
        """(N,) distances (m) of `points` (N, 2) from the piece."""
        start, way = np.asarray(self.start), np.asarray(self.end) - np.asarray(self.start)
        along = np.clip((points - start) @ way / (way @ way), 0.0, 1.0)
        return np.asarray(np.linalg.norm(points - start - along[:, None] * way, axis=1))

    def moved(self, shift: Point) -> Line:
        """The piece, moved by `shift` (m)."""
        return Line(_sum(self.start, shift), _sum(self.end, shift))


@dataclass(frozen=True)
class Arc:
    """A circular piece: centre and radius (m), angle of its start and sweep (rad, positive turns left)."""

    centre: Point
    radius: float
    start_angle: float
    sweep: float

    @property
    def length(self) -> float:
        """Length, m."""
        return self.radius * abs(self.sweep)

    @property
    def start(self) -> Point:
        """Where the arc begins, m."""
        return _point(self.point(np.zeros(1))[0])

    @property
    def end(self) -> Point:
        """Where the arc ends, m."""
        return _point(self.point(np.array([self.length]))[0])

    def _angle(self, s: Array) -> Array:
        return np.asarray(self.start_angle + math.copysign(1.0, self.sweep) * np.asarray(s) / self.radius)

    def point(self, s: Array) -> Array:
        """(N, 2) points at arc lengths `s` (N,)."""
        angle = self._angle(s)
        return np.asarray(self.centre) + self.radius * np.column_stack([np.cos(angle), np.sin(angle)])

    def tangent(self, s: Array) -> Array:
        """(N, 2) unit tangents."""
        angle = self._angle(s)
        return math.copysign(1.0, self.sweep) * np.column_stack([-np.sin(angle), np.cos(angle)])

    def offset(self, distance: float) -> Arc:
        """The parallel piece at `distance` (m) to the left; its radius must stay positive."""
        radius = self.radius - math.copysign(distance, distance * self.sweep)
        return Arc(self.centre, radius, self.start_angle, self.sweep)

    def distance(self, points: Array) -> Array:
        """(N,) distances (m) of `points` (N, 2) from the piece."""
        away = points - np.asarray(self.centre)
        turned = (np.arctan2(away[:, 1], away[:, 0]) - self.start_angle) * math.copysign(1.0, self.sweep)
        inside = np.mod(turned, 2 * math.pi) <= abs(self.sweep)
        to_circle = np.abs(np.linalg.norm(away, axis=1) - self.radius)
        ends = [np.linalg.norm(points - np.asarray(end), axis=1) for end in (self.start, self.end)]
        return np.asarray(np.where(inside, to_circle, np.minimum(*ends)))

    def moved(self, shift: Point) -> Arc:
        """The piece, moved by `shift` (m)."""
        return Arc(_sum(self.centre, shift), self.radius, self.start_angle, self.sweep)


Piece = Line | Arc


@dataclass(frozen=True)
class Centreline:
    """Lead-in, bend and lead-out of a groove, tangent to one another, from the tube's proximal to its distal end."""

    lead_in: Line
    bend: Piece
    lead_out: Line

    @property
    def pieces(self) -> tuple[Line, Piece, Line]:
        """The three pieces in order."""
        return self.lead_in, self.bend, self.lead_out

    @property
    def length(self) -> float:
        """Length, m."""
        return sum(piece.length for piece in self.pieces)

    def offset(self, distance: float) -> Centreline:
        """The parallel centreline at `distance` (m) to the left."""
        first, bend, last = (piece.offset(distance) for piece in self.pieces)
        assert isinstance(first, Line)
        assert isinstance(last, Line)
        return Centreline(first, bend, last)

    def lengthened(self, extra: float) -> Centreline:
        """With both leads `extra` (m) longer, outwards."""
        a, b = self.lead_in, self.lead_out
        start = a.point(np.array([-extra]))[0]
        end = b.point(np.array([b.length + extra]))[0]
        return Centreline(Line(_point(start), a.end), self.bend, Line(b.start, _point(end)))

    def sample(self, step: float) -> Array:
        """(N, 2) points (m) at most `step` (m) apart, with the ends of all pieces."""
        return np.vstack([piece.point(_spaced(piece.length, step)) for piece in self.pieces])

    def distance(self, points: Array) -> Array:
        """(N,) distances (m) of `points` (N, 2) from the centreline."""
        return np.asarray(np.min([piece.distance(points) for piece in self.pieces], axis=0))


def bend_at(curvature: float, length: float, apex: Point = (0.0, 0.0)) -> Piece:
    """A bend of this curvature (1/m, its size counts) and length (m), symmetric about the vertical through its top.

    It runs from left to right and turns right; one that is straight runs along x.
    """
    if abs(curvature) <= STRAIGHT:
        return Line((apex[0] - length / 2, apex[1]), (apex[0] + length / 2, apex[1]))
    radius, angle = 1 / abs(curvature), length * abs(curvature)
    return Arc((apex[0], apex[1] - radius), radius, math.pi / 2 + angle / 2, -angle)


def with_leads(bend: Piece, lead_in: float, lead_out: float) -> Centreline:
    """The bend with tangent leads of these lengths (m)."""
    (t0, t1) = bend.tangent(np.array([0.0, bend.length]))
    start = _point(np.asarray(bend.start) - lead_in * t0)
    end = _point(np.asarray(bend.end) + lead_out * t1)
    return Centreline(Line(start, bend.start), bend, Line(bend.end, end))


def leads_to_edge(bend: Piece, size: Point) -> Centreline:
    """The bend with tangent leads that end at the edge of the plate [0, width] x [0, height]; the bend lies inside."""
    (t0, t1) = bend.tangent(np.array([0.0, bend.length]))
    return with_leads(bend, way_to_edge(bend.start, -t0, size), way_to_edge(bend.end, t1, size))


def way_to_edge(start: Point, direction: Array, size: Point) -> float:
    """Length (m) of the way from a point inside the plate [0, width] x [0, height] to its edge; `direction` is unit."""
    ways = []
    for position, component, extent in zip(start, direction, size, strict=True):
        if abs(component) > 1e-12:
            ways.append(((extent if component > 0 else 0.0) - position) / component)
    return float(min(ways))


def bounds(curve: Centreline) -> tuple[Point, Point]:
    """Least and greatest coordinates of the centreline, exact for arcs."""
    points = [curve.lead_in.start, curve.lead_in.end, curve.lead_out.start, curve.lead_out.end]
    if isinstance(curve.bend, Arc):
        centre, radius = np.asarray(curve.bend.centre), curve.bend.radius
        compass = centre + radius * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
        points += [_point(p) for p in compass[curve.bend.distance(compass) < 1e-12]]
    array = np.array(points)
    return _point(array.min(axis=0)), _point(array.max(axis=0))


def least_distance(first: Centreline, second: Centreline, step: float = 5e-4) -> float:
    """Least distance (m) between two centrelines, from samples at `step` (m) of the first to the second.

    A distance d is reported as at most sqrt(d^2 + step^2/4), so that curves which cross are at most step/2 apart.
    """
    return float(second.distance(first.sample(step)).min())


def crosses_itself(curve: Centreline, width: float) -> bool:
    """Whether a groove of this width (m) runs into itself: its leads meet, or it turns full circle."""
    bend = curve.bend
    if isinstance(bend, Line):
        return False
    if abs(bend.sweep) >= 2 * math.pi or _cross(curve.lead_in, curve.lead_out):
        return True
    if abs(bend.sweep) <= math.pi / 2:  # the leads are nearest where the bend parts them, however short it is
        return False
    leads = curve.lead_out.distance(curve.lead_in.point(_spaced(curve.lead_in.length, 2.5e-4)))
    return bool(leads.min() < width)


def polygon(curve: Centreline, width: float, sagitta: float = 1e-6) -> Array:
    """(N, 2) corners, counter-clockwise, of a groove of this width (m); chords leave arcs by `sagitta` (m) at most."""
    left, right = (_polyline(curve.offset(side * width / 2), sagitta) for side in (1, -1))
    return np.vstack([right, left[::-1]])


def _polyline(curve: Centreline, sagitta: float) -> Array:
    bend = curve.bend
    count = 1
    if isinstance(bend, Arc):
        step = 2 * math.acos(max(1 - sagitta / bend.radius, -1.0))
        count = max(2, math.ceil(abs(bend.sweep) / step))
    middle = bend.point(np.linspace(0.0, bend.length, count + 1))
    return np.vstack([[curve.lead_in.start], middle, [curve.lead_out.end]])


def _cross(first: Line, second: Line) -> bool:
    """Whether two straight pieces cross."""

    def side(line: Line, point: Point) -> float:
        (x0, y0), (x1, y1) = line.start, line.end
        return (x1 - x0) * (point[1] - y0) - (y1 - y0) * (point[0] - x0)

    return (
        side(first, second.start) * side(first, second.end) < 0
        and side(second, first.start) * side(second, first.end) < 0
    )


def _spaced(length: float, step: float) -> Array:
    return np.linspace(0.0, length, max(2, math.ceil(length / step) + 1))


def _point(array: Array | Sequence[float]) -> Point:
    return float(array[0]), float(array[1])


def _sum(a: Point, b: Point) -> Point:
    return a[0] + b[0], a[1] + b[1]
