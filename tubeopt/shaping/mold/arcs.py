"""A planar bend of any curvature as a chain of tangent arcs (m, rad).

Where the curvature is constant an arc is the curve itself. Elsewhere each stretch is a biarc: two arcs, tangent to each
other, with the ends and tangents of the stretch (Bolton, Computer-Aided Design 7, 1975), halved until it lies on the
curve. Ends and tangents are integrated from the curvature, so that no error adds up along the chain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from ...robots.tubes import Tube
from ...typing import Array
from .groove import Arc, bounds
from .setting import signed_curvature
from .settings import MoldSolver

FLAT = 1e-9
"""Arcs that rise less than this (m) above their chord are lines: few cutters take a radius of kilometres."""

_GAUSS = np.polynomial.legendre.leggauss(16)


def bend_of(held: Tube, solver: MoldSolver) -> tuple[Arc, ...]:
    """The bend of a groove that holds a planar tube so, from left to right.

    The headings of its ends are opposite, and on the whole it turns to the right: one arc stands symmetrically about
    the vertical. Its top is at y = 0.
    """
    panels = _merged(signed_curvature(held))
    turn = math.fsum(_turn(length, c) for length, c in panels)
    side = -1.0 if turn >= 0 else 1.0
    at, heading = np.zeros(2), abs(turn) / 2
    pieces: list[Arc] = []
    for length, coefficients in panels:
        stretch = Stretch(length, side * coefficients, at, heading)
        pieces += stretch.arcs(solver)
        end = np.array([length])
        at, heading = stretch.points(end)[0], float(stretch.headings(end)[0])
    low, high = bounds(pieces)
    middle = (-(low[0] + high[0]) / 2, -high[1])
    return tuple(piece.moved(middle) for piece in pieces)


def _turn(length: float, coefficients: Array) -> float:
    whole = chebyshev.chebint(coefficients)
    return float(chebyshev.chebval(1.0, whole) - chebyshev.chebval(-1.0, whole)) * length / 2


def _merged(panels: list[tuple[float, Array]]) -> list[tuple[float, Array]]:
    """Neighbouring panels of the same constant curvature as one, without those that round-off has cut."""
    out: list[tuple[float, Array]] = []
    for length, coefficients in panels:
        if length < 1e-12:  # a kink and a change of sign beside each other
            continue
        if out and len(coefficients) == len(out[-1][1]) == 1 and coefficients[0] == out[-1][1][0]:
            out[-1] = (out[-1][0] + length, coefficients)
        else:
            out.append((length, coefficients))
    return out


@dataclass(frozen=True, eq=False)
class Stretch:
    """A stretch of length (m) and one polynomial of curvature (1/m, positive turns left): Chebyshev coefficients."""

    length: float
    coefficients: Array
    start: Array
    heading: float

    def headings(self, s: Array) -> Array:
        """(N,) headings (rad) at arc lengths (N,)."""
        whole = chebyshev.chebint(self.coefficients) * self.length / 2
        x = 2 * s / self.length - 1
        return np.asarray(self.heading + chebyshev.chebval(x, whole) - chebyshev.chebval(-1.0, whole))

    def points(self, s: Array) -> Array:
        """(N, 2) points at rising arc lengths (N,)."""
        most = np.abs(self.coefficients).sum()
        fine = np.linspace(0.0, self.length, math.ceil(2 * most * self.length) + 1)
        knots = np.unique(np.concatenate([fine, s]))
        half, middle = np.diff(knots) / 2, (knots[1:] + knots[:-1]) / 2
        nodes, weights = _GAUSS
        angle = self.headings((middle[:, None] + half[:, None] * nodes).ravel()).reshape(len(half), -1)
        steps = np.column_stack([(np.cos(angle) @ weights) * half, (np.sin(angle) @ weights) * half])
        corners = np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])
        return self.start + corners[np.searchsorted(knots, s)]

    def arcs(self, solver: MoldSolver) -> list[Arc]:
        """The stretch as tangent arcs."""
        if len(self.coefficients) == 1:
            return [_one_arc(self.start, self.heading, float(self.coefficients[0]), self.length)]
        pieces: list[Arc] = []
        stack = [(0.0, self.length)]
        while stack:
            low, high = stack.pop()
            s = np.linspace(low, high, solver.arc_places)
            points, headings = self.points(s), self.headings(s)
            if np.ptp(headings) <= solver.arc_turn:
                pair = _biarc(points[0], float(headings[0]), points[-1], float(headings[-1]))
                if np.min([piece.distance(points) for piece in pair], axis=0).max() <= solver.arc_tolerance:
                    pieces += pair
                    continue
            stack += [((low + high) / 2, high), (low, (low + high) / 2)]
        return pieces


def _one_arc(start: Array, heading: float, curvature: float, length: float) -> Arc:
    sweep = curvature * length
    flat = abs(sweep) * length / 8 <= FLAT
    at = float(start[0]), float(start[1])
    return Arc(at, heading + sweep / 2, length) if flat else Arc(at, heading, length, curvature)


def _biarc(start: Array, first: float, end: Array, last: float) -> tuple[Arc, Arc]:
    """The biarc from `start` with heading `first` to `end` with heading `last`, with equal arms."""
    t0, t1 = (np.array([math.cos(angle), math.sin(angle)]) for angle in (first, last))
    chord = end - start
    along = float(chord @ (t0 + t1))
    # Twice sin^2 of half the turn is 1 - cos, without cancellation.
    bent = 4 * math.sin((last - first) / 2) ** 2
    square = float(chord @ chord)
    arm = square / (along + math.sqrt(along**2 + bent * square))
    joint = (start + end + arm * (t0 - t1)) / 2
    return _arc_to(start, first, joint), _arc_to(joint, first + _sweep(start, first, joint), end)


def _sweep(start: Array, heading: float, end: Array) -> float:
    chord = end - start
    across = math.cos(heading) * chord[1] - math.sin(heading) * chord[0]
    along = math.cos(heading) * chord[0] + math.sin(heading) * chord[1]
    return 2 * math.atan2(across, along)


def _arc_to(start: Array, heading: float, end: Array) -> Arc:
    """The arc from `start` with `heading` to `end`."""
    half = _sweep(start, heading, end) / 2
    chord = float(np.linalg.norm(end - start))
    return _one_arc(start, heading, 2 * math.sin(half) / chord, chord / float(np.sinc(half / math.pi)))
