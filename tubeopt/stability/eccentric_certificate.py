"""Certificate of segments of three equal tubes off the centreline, and a closed form below which they snap.

Each segment is one problem of three tubes (see below): inner segments only add the stiffness of their straight tubes,
and outer ones only change the length of its tubes behind its curved part. The robot cannot snap if no segment can.

*Proof.* A segment with transmissions lam_i (in units of 1 / omega) cannot snap if R(X) < lam^-1. Outer segments
stretch them to lam + d cos(c), lam + d cos(c + 120 deg) and lam + d cos(c - 120 deg), with d at most D, the sum of
delta omega L over these segments. So tan(phi(X)) < 1 / lam_eff, lam_eff = lam + D/2 + (D^2/2) / (1 / (delta X) - lam),
is sufficient, and necessary where c is 0.

*Closed form.* Two tubes turned to c and the third to c + pi neither twist nor turn one another: an equilibrium at every
length, whose linearisation has constant coefficients. If one of these is unstable, with all other segments curving to
one side, the joint rotations have more than one equilibrium, and the robot snaps on some path.

Both results are numbers that are positive where the robot is stable: the fraction of torsional stiffness that all tubes
may lose before the proof fails, or before the untwisted shape is a fold.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy

from ..block.transcription.buffered import section_function
from ..errors import InputError
from ..physics.certificate import PARAMETERS
from ..robots.assembly import LENGTH_ROUND_OFF, Assembly
from ..robots.eccentric import PLACES
from ..robots.robot import Robot
from ..robots.tubes import Tube
from ..typing import Array

# --- Bound of the length of a segment ---------------------------------------------------------------------------------

# Length up to which a segment of three equal tubes off the centreline cannot snap at any rotation.
#
# Three equal tubes at 0 and +-120 deg obey, in x = omega (L - s) with omega^2 = m^2 / (K kt) (m = kb kappa, K the sum
# of kb at one offset), equations with the single parameter delta = d m / K:
#
#     theta_x = g p,   p_x = M,   p(0) = 0;     linearised   y_x = g v + p (g' y),   v_x = M' y,   v(0) = 0,
#
# with g and M those of a cross-section with K = m = 1 and offset delta. Joint rotations, alpha = theta(X) + lam p(X),
# are a smooth one-to-one function of the tip rotations unless some y has y(X) + lam v(X) = 0: a conjugate point. v_x =
# M' y, multiplied by y and integrated, shows that such a y makes
#
#     Q[y] = y(X)' lam^-1 y(X) + int y_x' G^-1 y_x - y_x' B y + y' C y,
#     B_ij = p_i g'_ij / g_i,   C = sym M',   G = diag g,
#
# zero. If a matrix R(x) with R(0) = 0 obeys, for every theta and every p that is possible at x, the Riccati inequality
#
#     R_x >= (R - B/2)' G (R - B/2) - C,                                                                         (*)
#
# then Q is at least y(X)' (lam^-1 - R(X)) y(X), and positive. The right-hand side of (*) is convex in p, and p, an
# integral of M, lies in x times the convex hull of all M, which a polygon of twelve corners encloses. R = tan(phi(x)) P
# + delta x J, with J the projection on equal rotations of all tubes and P = 1 - J, satisfies (*) if phi_x is at least
# the value of `Slope` at every corner.
#
# The table in the package has the x at which phi reaches an angle, for delta up to 0.2525; it is made by
# `python -m tubeopt.stability.eccentric_certificate`. Every number errs on the safe side: phi_x is the larger value of
# both ends of each step, the largest over all corners of the polygon, and over a grid of rotations raised by
# GRID_ALLOWANCE; values read are lowered by TABLE_ALLOWANCE. Towards delta = 0, where phi = x is exact, both go to 0.
# The maximum over rotations is a search, not an enclosure by intervals.

FILE = Path(__file__).with_name("eccentric_bound.csv")

DELTAS = np.array([0.0, 0.0025, 0.005, *np.arange(0.01, 0.2501, 0.01), 0.2525])
"""Values of delta of the rows of the table."""

ANGLES = np.linspace(0.0, np.pi / 2, 65)
"""Values of phi of the columns of the table, rad."""

CORNERS = (0.8169, 0.8301)
"""Support of all moments M in the directions (2, -1, -1) / sqrt 6 and (1, -1, 0) / sqrt 2, rounded up.

Twelve sides alternate between both. For three equal tubes M_i = sum_j sin(theta_i - theta_j) / k with k >= 3: exactly
sqrt(2/3) and 0.82973.
"""

BASIS = np.column_stack([np.array([2.0, -1.0, -1.0]) / np.sqrt(6), np.array([0.0, 1.0, -1.0]) / np.sqrt(2)])
"""(3, 2) basis of the rotations of three tubes against one another: the range of the projection P."""

GRID = 24
"""Number of rotations per turn and tube for the maximum slope of phi: every 15 deg."""

GRID_ALLOWANCE = (1e-4, 4e-3)
"""Relative increase of the slope, and the same per delta: at least twice the error of the grid of rotations."""

TABLE_ALLOWANCE = 5e-5
"""Reduction of the lengths x in the table: bound on the error of linear interpolation in delta and phi."""

ARC_STEPS = 1600
"""Number of steps of x up to pi / 2."""


def corners() -> Array:
    """(12, 3) corners, in order, of the polygon that encloses all values M."""
    angle = np.arange(12) * np.pi / 6
    normals = np.column_stack([np.cos(angle), np.sin(angle)]) @ BASIS.T
    support = np.array(CORNERS)[np.arange(12) % 2]
    out = []
    for k in range(12):
        rows, limits = normals[[k, (k + 1) % 12]], support[[k, (k + 1) % 12]]
        out.append(rows.T @ np.linalg.solve(rows @ rows.T, limits))
    return np.array(out)


class Slope:
    """Smallest slope phi_x that satisfies condition (*) of the module, for one delta, at rotations (T, 3) and corners p
    (V, 3).

    The parts that do not depend on x and phi are computed once. With the Schur complement of the equal rotations, (*)
    is a bound on the larger eigenvalue of a matrix (2, 2) on the range of P.
    """

    def __init__(self, theta: Array, delta: float, vertices: Array) -> None:
        moments, g, g_slope = cross_sections(theta, delta)
        relative = g_slope / g[:, :, None]
        basis, common = BASIS, np.full(3, 1 / np.sqrt(3))
        # Per unit of x: B on the range of P (T, V, 3, 2), and delta J - B/2 on equal rotations (T, V, 3).
        across = vertices[None, :, :, None] * (relative @ basis)[:, None]
        alike = delta * common - vertices * (relative @ common)[:, None] / 2
        self.delta = delta
        self.coupling = _form(basis.T @ moments @ basis)[:, :, None]
        self.alone = _form(np.einsum("ia,ti,ib->tab", basis, g, basis))[:, :, None]
        self.mixed = _form(np.einsum("ia,ti,tvib->tvab", basis, g, across))
        self.square = _form(np.einsum("tvia,ti,tvib->tvab", across, g, across))
        self.first = np.einsum("ia,ti,tvi->atv", basis, g, alike)
        self.second = np.einsum("tvia,ti,tvi->atv", across, g, alike)
        self.shear = (basis.T @ moments @ common / 2).T[:, :, None]
        self.common = np.einsum("tvi,ti,tvi->tv", alike, g, alike)

    def __call__(self, x: float, phi: float) -> Array:
        """(T, V) smallest slope phi_x at x and phi."""
        sine, cosine = np.sin(phi), np.cos(phi)
        form = sine**2 * self.alone - sine * cosine * x * self.mixed + (cosine * x / 2) ** 2 * self.square
        form = form - cosine**2 * self.coupling
        cross = sine * x * self.first - cosine * x**2 / 2 * self.second - cosine * self.shear
        corner = self.delta - x**2 * self.common
        if (corner <= 0).any():
            raise ArithmeticError(f"equal rotations of all tubes are not bounded at x = {x:g}")
        a = form[0] + cross[0] ** 2 / corner
        b = form[1] + cross[0] * cross[1] / corner
        c = form[2] + cross[1] ** 2 / corner
        return np.asarray((a + c) / 2 + np.hypot((a - c) / 2, b))


class CrossSections(NamedTuple):
    """Cross-sections of three equal tubes with K = m = 1 at N sets of rotations."""

    moment_slope: Array
    """(N, 3, 3) derivatives M' of the moments with respect to the rotations."""
    g: Array
    """(N, 3) arc length of each tube per arc length of the centreline."""
    g_slope: Array
    """(N, 3, 3) derivatives g' of g with respect to the rotations."""


def cross_sections(theta: Array, delta: float) -> CrossSections:
    """Cross-sections at rotations (N, 3)."""
    balance = section_function("balance", len(theta), 3, True)
    _, moment_slope, _, g, g_slope = balance(theta, 1.0, 1.0, delta, np.array(PLACES))
    moment_slope, g_slope = (part.reshape(-1, 3, 3).swapaxes(1, 2).copy() for part in (moment_slope, g_slope))
    return CrossSections(moment_slope, g.copy(), g_slope)


def _form(matrix: Array) -> Array:
    """Entries (3, ...) of the symmetric part of matrices (..., 2, 2): xx, xy, yy."""
    return np.stack([matrix[..., 0, 0], (matrix[..., 0, 1] + matrix[..., 1, 0]) / 2, matrix[..., 1, 1]])


def all_rotations() -> Array:
    """(GRID^3, 3) rotations on a grid over one turn of each of three tubes, rad."""
    axis = np.arange(GRID) * 2 * np.pi / GRID
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)


def length_curve(delta: float, steps: int = ARC_STEPS) -> Array:
    """(65,) lower bounds on the x at which phi reaches each of ANGLES, for one delta."""
    if delta == 0.0:
        return ANGLES.copy()
    # Turning all by 120 deg and renaming the tubes turns the polygon by four corners: a third of them is enough.
    slope = Slope(all_rotations(), delta, corners()[:4])
    allowance = 1 + GRID_ALLOWANCE[0] + GRID_ALLOWANCE[1] * delta
    h = np.pi / 2 / steps
    x, phi = [0.0], [0.0]
    while phi[-1] < np.pi / 2:
        # At the end of the step in x; of both ends in phi, the larger one.
        start, x_next = phi[-1], x[-1] + h
        phi_x = float(slope(x_next, start).max())
        phi_x = max(phi_x, float(slope(x_next, min(np.pi / 2, start + h * allowance * phi_x)).max()))
        x.append(x_next)
        phi.append(start + h * allowance * phi_x)
    return np.asarray(np.interp(ANGLES, phi, x))


@lru_cache(maxsize=1)
def table() -> Array:
    """Table of lengths x over (deltas, angles), rounded down; row 0 is exact for tubes on the centreline: x = phi."""
    rows = np.loadtxt(FILE, delimiter=",")
    return np.maximum(rows - np.where(DELTAS > 0, TABLE_ALLOWANCE, 0.0)[:, None], 0.0)


def longest(delta: float, angle: float) -> float:
    """Largest length x with phi below `angle` (rad, at most pi / 2): a shorter segment cannot snap."""
    if not 0 <= delta <= DELTAS[-1]:
        raise InputError(f"delta is {delta:g}; the bound is valid from 0 to {DELTAS[-1]:g}")
    i = min(int(np.searchsorted(DELTAS, delta, side="right")) - 1, len(DELTAS) - 2)
    row = (delta - DELTAS[i]) / (DELTAS[i + 1] - DELTAS[i])
    position = angle / ANGLES[1]
    j = min(int(position), len(ANGLES) - 2)
    column = position - j
    corners = table()[i : i + 2, j : j + 2]
    left, right = (1 - row) * corners[0] + row * corners[1]
    return float((1 - column) * left + column * right)


# --- Segments of a robot ----------------------------------------------------------------------------------------------

SHORT = 2e-9
"""Length (m) below which a section is a tolerance of lengths: its effect is far below TABLE_ALLOWANCE."""

EQUAL = 1e-9
"""Largest relative difference of tube properties that count as equal."""

# Some intervals of the table are wider than this: the derivative is that of the interpolation.
STEP = 1e-4
"""Relative step of the differences for derivatives."""

LENGTHS = ("straight_length", "curved_length", "translation")
"""PARAMETERS that are lengths."""

DIRECTIONS = np.arange(12) * np.pi / 6
"""Directions c of the untwisted shapes: the softest lie at 30 deg and every 60 deg from there."""


@dataclass(frozen=True)
class Segment:
    """Three equal tubes on one section, in units with K = m = 1."""

    tubes: tuple[int, int, int]
    """Numbers of the tubes, in the order of PLACES."""
    section: tuple[float, float]
    """Arc lengths (start, end) of the section, m."""
    rate: float
    """Rate omega that makes arc length dimensionless, 1/m."""
    delta: float
    """Dimensionless offset delta = d m / K."""
    length: float
    """Dimensionless length omega L."""
    transmission: float
    """omega times the mean length from the clamped ends to the section."""
    outer: tuple[tuple[float, float], ...] = ()
    """Pairs (delta, omega L) of all outer segments, with omega of this one."""

    @property
    def spread(self) -> float:
        """Upper bound D on the deviation of the three transmissions from their mean."""
        return sum(delta * length for delta, length in self.outer)


def segments_of(assembly: Assembly) -> tuple[Segment, ...] | None:
    """Segments of a robot, base to tip; None if nothing can be proved for it.

    Nothing is proved if a segment is not made of three equal tubes, or curves too tightly for the table.
    """
    result: list[Segment] = []
    used: set[int] = set()
    for k in np.flatnonzero(assembly.curved.any(1) & (assembly.length > SHORT)):
        segment = _segment(assembly, int(k))
        if segment is None or used & set(segment.tubes):
            return None
        used |= set(segment.tubes)
        outer = tuple((other.delta, other.length / other.rate * segment.rate) for other in result)
        result.append(replace(segment, outer=outer))
    return tuple(result)


def _segment(assembly: Assembly, k: int) -> Segment | None:
    """Segment that is curved on section k: three equal tubes, with equal straight tubes inside; None otherwise."""
    tubes = np.flatnonzero(assembly.curved[k])
    if len(tubes) != 3:
        return None
    same = ("bending_stiffness", "torsional_stiffness", "curvature", "offset", "transmission")
    table = np.array([getattr(assembly, name)[tubes] for name in same])
    if (np.ptp(table, axis=1) > EQUAL * np.abs(table).max(1) + np.array([0, 0, 0, 0, LENGTH_ROUND_OFF])).any():
        return None
    kb, kt, curvature, offset, transmission = table[:, 0]
    sector_angle = (assembly.offset_angle - assembly.offset_angle[tubes[0]]) / (2 * np.pi / 3)
    sector = np.round(sector_angle).astype(int) % 3
    present = assembly.present[k]
    wrong_angle = np.abs(sector_angle - np.round(sector_angle)) > EQUAL
    if offset <= 0 or (present & (wrong_angle | (np.abs(assembly.offset - offset) > EQUAL * offset))).any():
        return None
    stiffness = np.bincount(sector, weights=assembly.bending_stiffness * present, minlength=3)
    if len(set(sector[tubes].tolist())) != 3 or np.ptp(stiffness) > EQUAL * stiffness.max():
        return None
    moment = kb * abs(curvature)
    rate, delta = float(moment / np.sqrt(float(stiffness.max()) * kt)), float(offset * moment / stiffness.min())
    if delta > DELTAS[-1]:
        return None
    first, second, third = (int(tubes[sector[tubes] == p][0]) for p in range(3))
    start, length = float(assembly.start[k]), float(assembly.length[k])
    return Segment(
        tubes=(first, second, third),
        section=(start, start + length),
        rate=rate,
        delta=delta,
        length=rate * length,
        transmission=rate * (float(transmission) + start),
    )


def proved_margin(segment: Segment) -> float:
    """Fraction of torsional stiffness that the tubes may lose before the proof fails; above 0 the proof is valid.

    A stiffness lower by 1 - 1 / soft^2 multiplies omega by `soft`: the root of the condition in `soft` is the answer.
    """

    def excess(soft: float) -> float:
        x, lam, spread = (soft * part for part in (segment.length, segment.transmission, segment.spread))
        denominator = 1 / (segment.delta * x) - lam
        if denominator <= 0:
            return 1.0
        lam_eff = lam + spread / 2 + spread**2 / 2 / denominator
        return x - longest(segment.delta, np.pi / 2 if lam_eff <= 0 else np.arctan(1 / lam_eff))

    highest = np.pi / 2 / segment.length  # no segment of the table is that long: `longest` stays below pi / 2
    return 1 - 1 / float(scipy.optimize.brentq(excess, 1e-9 * highest, highest, xtol=1e-14 * highest, rtol=1e-13)) ** 2


@dataclass(frozen=True)
class Untwisted:
    """Softest untwisted shape of a segment. Directions of tubes with negative curvature are turned by pi."""

    segment: Segment
    margin: float
    """Margin of the equilibrium."""
    direction: float
    """Direction c of two of its tubes, rad; the third has c + pi."""
    outer_direction: float
    """Direction of all outer segments, rad."""


def softest_untwisted(segment: Segment) -> Untwisted:
    """Softest of the shapes with one tube against two, by their exact linearisation."""
    count = len(DIRECTIONS)
    opposed = DIRECTIONS[:, None] + np.array([0.0, 0.0, np.pi])
    slope, g, _ = cross_sections(opposed, segment.delta)
    root = np.sqrt(g)
    # With y = sqrt(g) z the Jacobi equation is z'' = -A z with a symmetric A.
    values, vectors = np.linalg.eigh(-root[:, :, None] * (slope + slope.swapaxes(1, 2)) / 2 * root[:, None, :])
    stretch = np.zeros((count, 3))
    for delta, length in segment.outer:
        stretch += length * (cross_sections(np.repeat(DIRECTIONS[:, None], 3, axis=1), delta).g - 1)
    if not segment.outer:
        stretch = stretch[:1]
    lever = np.sqrt(np.maximum(segment.transmission + stretch[:, None, :], 0.0)) / root

    def excess(soft: float) -> Array:
        """(outer, c) largest eigenvalue of the condition y(X)' lam Y' Y^-1 y(X) < 1 of stability."""
        wave = soft * segment.length * np.sqrt(np.abs(values))
        # z' / z of the solution that starts with z' = 0 at the tip: a tangent or, where stable, a hyperbolic one.
        ratio = np.where(values > 0, np.tan(np.minimum(wave, np.pi / 2 - 1e-12)), -np.tanh(wave))
        field = vectors @ (vectors * (np.sqrt(np.abs(values)) * ratio)[:, None, :]).swapaxes(1, 2)
        form = soft * lever[..., :, None] * field * lever[..., None, :]
        # At wave = pi / 2 there is a conjugate point inside, whatever the transmissions.
        inside = (wave * (values > 0)).max(1) / (np.pi / 2)
        return np.maximum(np.linalg.eigvalsh(form)[..., -1], np.where(inside >= 1, 1e9, inside))

    highest = np.pi / 2 / (segment.length * np.sqrt(values.max())) * (1 + 1e-12)
    soft = scipy.optimize.brentq(
        lambda s: float(excess(s).max()) - 1, 1e-9 * highest, highest, xtol=1e-14 * highest, rtol=1e-13
    )
    o, c = np.unravel_index(int(np.argmax(excess(soft * (1 - 1e-9)))), (len(lever), count))
    return Untwisted(segment, 1 - 1 / float(soft) ** 2, float(DIRECTIONS[c]), float(DIRECTIONS[o]))


def untwisted_tips(n: int, shape: Untwisted, bends: Array) -> tuple[Array, int]:
    """(n,) rotations of an untwisted shape, and its odd tube, which is opposed to the two others of its segment.

    All other segments curve to one side. bends (n,): signs of the precurvatures.
    """
    tips = np.where(bends < 0, np.pi, 0.0) + shape.outer_direction
    tips[list(shape.segment.tubes)] += shape.direction - shape.outer_direction
    odd = shape.segment.tubes[2]
    tips[odd] += np.pi
    return tips, odd


def proof_gradient(
    robot: Robot, translations: Array, proved: Callable[[Sequence[Tube], Array], float], groups: Sequence[Sequence[int]]
) -> dict[str, Array]:
    """Derivatives of a certificate with respect to each of PARAMETERS, (n,), by central differences.

    `proved` is the certificate of tubes at translations (n,). Tubes of one of the `groups` change together, and those
    that move together move together; each has an equal part of the derivative. One-sided where the other side has no
    proof; NaN if neither has one.
    """

    def changed(name: str, group: Sequence[int], change: float) -> float:
        tubes, shift = list(robot.tubes), translations.copy()
        try:
            if name == "translation":
                shift[[*group]] += change
            else:
                for i in group:
                    tubes[i] = replace(tubes[i], **{name: getattr(tubes[i], name) + change})
            return proved(tubes, shift)
        except InputError:  # no such tubes
            return -np.inf

    value, out = proved(robot.tubes, translations), {name: np.full(robot.n_tubes, np.nan) for name in PARAMETERS}
    longest = max(tube.length for tube in robot.tubes)
    for name in PARAMETERS if np.isfinite(value) else ():
        for group in robot.moving_together if name == "translation" else groups:
            size = longest if name in LENGTHS else abs(float(getattr(robot.tubes[group[0]], name)))
            h = STEP * max(size, 1e-300)
            values = ((-h, changed(name, group, -h)), (0.0, value), (h, changed(name, group, h)))
            finite = [(x, y) for x, y in values if np.isfinite(y)]
            if len(finite) > 1:
                (low, first), *_, (high, last) = finite
                out[name][[*group]] = (last - first) / (high - low) / len(group)
    return out


def proof(assembly: Assembly) -> tuple[float, Segment | None]:
    """Smallest `proved_margin` of all segments, at most 1, and its segment.

    -inf if nothing can be proved, 1 where nothing is curved.
    """
    segments = segments_of(assembly)
    if segments is None:
        return -np.inf, None
    values = [(proved_margin(segment), k) for k, segment in enumerate(segments)]
    if not values:
        return 1.0, None
    smallest, k = min(values)
    return min(1.0, smallest), segments[k]


if __name__ == "__main__":
    # Some minutes.
    header = "largest x with phi below 0, pi/128, .. pi/2 (columns), by delta (rows); see eccentric_certificate.py"
    curves = [length_curve(delta) for delta in DELTAS]
    np.savetxt(FILE, curves, fmt="%.7f", delimiter=",", header=header)
