"""Circle through the bend of a traced tube: where the bend begins and ends, its radius and the error of the fit.

A tube that was set by heat has straight leads, and its curvature fades towards them. So the curvature along the tube is
first fitted as a trapezoid: zero, a ramp, constant, a ramp, zero. The circle then goes through the constant part alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from numpy.polynomial import legendre

from ...typing import Array

GRID = 24
"""Number of positions along the tube at which the bend may begin or end, in the search of a start."""

MARGIN = 0.04
"""Part of the constant curvature that is left out at either end: the ramps are not known exactly."""

LESS = 1.5
"""Smallest reduction of the sum of squares by straight ends; with less, the whole tube counts as curved."""

SHAPES = 5
"""Number of shapes beyond a circle that describe the deviations."""

RANDOM_CORRELATION = 1.5
"""Factor on the standard error: deviations of long waves are larger than those of the shapes that are read."""


@dataclass(frozen=True, eq=False)
class FittedArc:
    """Circle through the bend of a tube."""

    centre: Array
    """(2,) centre, m."""
    radius: float
    """Radius, m."""
    standard_error: float
    """Standard error of the radius from deviations of the centreline from the circle, m."""
    half_width: float
    """Half of the 95 % interval of the radius from these deviations, m."""
    used: Array
    """(N,) mask of the points on the circle."""
    bend: tuple[float, float]
    """Arc lengths (m) along the trace where the curvature has half its value."""
    fades: tuple[float, float]
    """Lengths (m) of the ramps of the curvature at both ends; 0 without a lead."""
    leads: tuple[float, float]
    """Lengths (m) of the straight parts at both ends."""
    rms: float
    """Root mean square of the deviations of the points from the circle, m."""
    largest: float
    """Largest smooth deviation of the centreline from the circle, m."""

    @property
    def length(self) -> float:
        """Length of the bend, m."""
        return self.bend[1] - self.bend[0]


class Circle(NamedTuple):
    """Circle of least squares."""

    centre: Array
    radius: float


def fit_circle(points: Array) -> Circle:
    """Circle with the least squares of the distances of points (N, 2)."""
    middle = points.mean(axis=0)
    local = points - middle
    scale = float(np.abs(local).max())
    x, y = (local / scale).T
    # Linear start: x^2 + y^2 = 2 a x + 2 b y + c.
    a, b, c = np.linalg.lstsq(np.column_stack([2 * x, 2 * y, np.ones(len(x))]), x * x + y * y, rcond=None)[0]
    start = np.array([a, b, math.sqrt(c + a * a + b * b)])
    solved = scipy.optimize.least_squares(
        lambda p: np.hypot(x - p[0], y - p[1]) - p[2], start, method="lm", xtol=1e-14
    ).x
    return Circle(middle + scale * solved[:2], float(scale * solved[2]))


def fit_arc(points: Array) -> FittedArc:
    """Fit the bend of a traced centreline, (N, 2) points in order, m."""
    s = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    total = float(s[-1])
    whole = fit_circle(points)
    of_whole = _from_circle(points, whole)
    start, end, first, last, misfit = _trapezoid(points, s)
    bend, fades, leads = (0.0, total), (0.0, 0.0), (0.0, 0.0)
    used = np.ones(len(s), dtype=bool)
    if float(of_whole @ of_whole) > LESS * misfit:
        bend, leads = (start, end), (max(0.0, start - first / 2), max(0.0, total - end - last / 2))
        fades = (first if leads[0] else 0.0, last if leads[1] else 0.0)
        low, high = max(start + first / 2, 0.0), min(end - last / 2, total)
        margin = MARGIN * (high - low)
        inside = (s >= low + margin * bool(leads[0])) & (s <= high - margin * bool(leads[1]))
        # A bend that fades everywhere has no constant part: its middle half is the nearest to one.
        middle = np.abs(s - (start + end) / 2) < (end - start) / 4
        used = inside if inside.sum() >= max(12, 0.5 * middle.sum()) else middle
    circle = fit_circle(points[used])
    deviation = _from_circle(points[used], circle)
    shapes = _shapes(points[used], circle)
    coefficients = shapes.extra.T @ deviation
    sigma = RANDOM_CORRELATION * math.sqrt(float(np.mean(coefficients**2)))
    standard_error = sigma * math.sqrt(float(np.linalg.inv(shapes.circle.T @ shapes.circle)[0, 0]))
    return FittedArc(
        *circle,
        standard_error,
        float(scipy.special.stdtrit(SHAPES, 0.975)) * standard_error,
        used,
        bend,
        fades,
        leads,
        float(np.sqrt(np.mean(deviation**2))),
        float(np.abs(shapes.extra @ coefficients).max()),
    )


class Shapes(NamedTuple):
    """Shapes of deviations from a circle along its arc."""

    circle: Array
    """(N, 3) deviations that another radius or centre causes."""
    extra: Array
    """(N, SHAPES) orthonormal deviations of the next orders, which no circle has."""


def _shapes(points: Array, circle: Circle) -> Shapes:
    """Shapes of deviations at points of a circle.

    Errors of the centreline have all orders. Those of the next orders remain as deviations from the circle, and tell
    how large those must be that the fit has taken for another radius.
    """
    angle = np.unwrap(np.arctan2(*(points - circle.centre).T[::-1]))
    angle -= angle.mean()
    along = angle / np.abs(angle).max()
    of_circle = np.column_stack([np.ones(len(angle)), np.cos(angle), np.sin(angle)])
    orthonormal = np.linalg.qr(np.column_stack([of_circle, legendre.legvander(along, 2 + SHAPES)[:, 3:]]))[0]
    return Shapes(of_circle, orthonormal[:, 3:])


def _from_circle(points: Array, circle: Circle) -> Array:
    """(N,) distances of points from a circle, positive outside."""
    return np.asarray(np.hypot(*(points - circle.centre).T) - circle.radius)


class Trapezoid(NamedTuple):
    """Curvature along a tube: zero, a ramp, constant, a ramp, zero."""

    start: float
    """Arc length of half the curvature at the beginning, m."""
    end: float
    first: float
    """Length of the first ramp, m."""
    last: float
    misfit: float
    """Sum of squares of the distances of the points, m^2."""


def _trapezoid(points: Array, s: Array) -> Trapezoid:
    """Fit the curvature along points at arc lengths `s` by a trapezoid."""
    total = float(s[-1])
    start, end, curvature = _rough_bend(points, s)
    middle = points[len(s) // 2]
    at_middle = s[len(s) // 2]
    tangent = np.gradient(points, axis=0)[len(s) // 2]
    direction = math.atan2(tangent[1], tangent[0])
    dense = np.linspace(0.0, total, 4 * len(s))
    step = dense[1]

    def distances(p: Array) -> Array:
        x, y, angle, kappa, begin, stop, first, last = p
        bend = kappa / total * _ramps(dense, total * begin, total * stop, total * first, total * last)
        theta = _cumulative(bend, step)
        theta += direction + angle - np.interp(at_middle, dense, theta)
        cx, cy = _cumulative(np.cos(theta), step), _cumulative(np.sin(theta), step)
        ux, uy = (np.interp(s, dense, c) - np.interp(at_middle, dense, c) for c in (cx, cy))
        across = np.interp(s, dense, theta)
        dx, dy = points[:, 0] - middle[0] - total * x - ux, points[:, 1] - middle[1] - total * y - uy
        return np.asarray((dy * np.cos(across) - dx * np.sin(across)) / total)

    first_guess = [0.0, 0.0, 0.0, curvature * total, start / total, end / total, 0.03, 0.03]
    lower = [-1, -1, -4, -50, -0.02, 0.3, 0.005, 0.005]
    upper = [1, 1, 4, 50, 0.7, 1.02, 0.6, 0.6]
    guess = np.clip(first_guess, np.array(lower) + 1e-6, np.array(upper) - 1e-6)
    sizes = [0.01, 0.01, 0.1, 1, 0.1, 0.1, 0.1, 0.1]
    # Without a lead the length of its ramp has no effect, and the search would not end.
    p = scipy.optimize.least_squares(distances, guess, bounds=(lower, upper), x_scale=sizes, ftol=1e-5, max_nfev=50).x
    start, end, *lengths = (float(x * total) for x in p[4:])
    return Trapezoid(start, end, lengths[0], lengths[1], float(total**2 * np.sum(distances(p) ** 2)))


def _ramps(s: Array, start: float, end: float, first: float, last: float) -> Array:
    """Part of the curvature at arc lengths `s`."""
    return np.clip((s - start) / first + 0.5, 0, 1) * np.clip((end - s) / last + 0.5, 0, 1)


def _cumulative(values: Array, step: float) -> Array:
    """Integral of values at even steps, from 0."""
    return np.append(0.0, np.cumsum(0.5 * (values[1:] + values[:-1]) * step))


def _rough_bend(points: Array, s: Array) -> tuple[float, float, float]:
    """Begin and end of the bend (arc lengths, m) and its curvature (1/m) that fit the directions best."""
    # Chords of a fortieth of the tube average the noise of the points.
    reach = max(2, len(s) // 40)
    chord = points[reach:] - points[:-reach]
    theta = np.unwrap(np.arctan2(chord[:, 1], chord[:, 0]))
    at = 0.5 * (s[reach:] + s[:-reach])
    places = np.linspace(0.0, s[-1], GRID)
    best = (0.0, 0.0, float(s[-1]), 0.0)
    for i, start in enumerate(places):
        for end in places[i + 3 :]:
            # The direction grows with the arc length within the bend: the line of least squares.
            within = np.clip(at, start, end)
            within -= within.mean()
            slope = float(within @ theta / (within @ within))
            best = max(best, (slope * float(within @ theta), float(start), float(end), slope))
    return best[1:]
